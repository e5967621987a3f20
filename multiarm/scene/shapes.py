"""Shapes of objects: what a scene says of them, and all that depends on which one it is.

A :class:`Solid` is the convex hull of balls of one radius about some points, except for cylinders,
which have no corners, and meshes, which may have dents.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema
from typing_extensions import override

from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.scene.faults import invalid, shown
from multiarm.scene.meshes import read_mesh
from multiarm.scene.solids import (
    hull_corners,
    hull_mass_properties,
    hull_triangles,
    nearest_in,
)
from multiarm.scene.spec import FilePath, OneOf, Spec
from multiarm.scene.text import written_yaml
from multiarm.scene.values import Positive, Vec3, items_of, list_of, number_list

# Every corner that may touch something is a contact; a hull with more of them is a rounded body.
MOST_CORNERS = 64


class NoCornersError(ValueError):
    """A shape has no corners that are known.

    Attributes
    ----------
    reason : str
    remedy : str
        Which points stand for its corners, or what to do.
    """

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(reason)
        self.reason, self.remedy = reason, remedy


Bounds = tuple[np.ndarray, np.ndarray]


class Solid:
    """A shape: its measures in the object's frame [m]."""

    @property
    def words(self) -> str:
        """A few words on it."""
        raise NotImplementedError

    def inertia(self, mass: float) -> np.ndarray:
        """Inertia about the centre of mass at uniform density, shape (3, 3) [kg m^2]."""
        raise NotImplementedError

    def nearest(self, point: np.ndarray) -> np.ndarray | None:
        """The point of the solid nearest to a point (3,); one inside is the nearest to itself.

        None of a mesh that cannot be read.
        """
        raise NotImplementedError

    def corners(self) -> tuple[np.ndarray, float]:
        """Points (N, 3) and radius of the balls whose convex hull it is.

        Raises
        ------
        NoCornersError
            When there are none, or they are unknown.
        """
        raise NotImplementedError

    def bounding_box(self) -> Bounds | None:
        """Least and largest coordinates; None of a mesh that cannot be read."""
        points, radius = self.corners()
        return points.min(axis=0) - radius, points.max(axis=0) + radius


def _scale(value: Any) -> tuple[float, ...]:
    scale = number_list(value if isinstance(value, (list, tuple)) else [value] * 3)
    if len(scale) != 3 or min(scale) <= 0.0:
        raise invalid(f"must be one or three numbers greater than 0, got {shown(value)}")
    return scale


def _solid(points: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    try:
        hull_triangles(np.array(points))
    except ValueError as error:
        raise invalid(str(error)) from None
    return points


_LENGTH: dict[str, Any] = {"type": "number", "exclusiveMinimum": 0}
_LENGTHS = {"type": "array", "items": _LENGTH, **items_of(3)}
Edges = Annotated[
    tuple[Positive, Positive, Positive], list_of("must be three lengths greater than 0", 3)
]
Points = Annotated[
    tuple[Vec3, ...],
    list_of("must be a list of at least four points", least=4),
    AfterValidator(_solid),
]


@dataclass(frozen=True)
class Box(Solid):
    """A block, by its full edge lengths [m] along x, y, z."""

    edges: tuple[float, float, float]

    @property
    def half(self) -> np.ndarray:
        """Half its edges."""
        return 0.5 * np.array(self.edges)

    @property
    @override
    def words(self) -> str:
        return f"box {' x '.join(f'{edge:g}' for edge in self.edges)} m"

    @override
    def inertia(self, mass: float) -> np.ndarray:
        squares = np.square(self.edges)
        return np.diag(mass / 12.0 * (squares.sum() - squares))

    @override
    def nearest(self, point: np.ndarray) -> np.ndarray:
        return np.clip(point, -self.half, self.half)

    @override
    def corners(self) -> tuple[np.ndarray, float]:
        return np.array(list(product((-1.0, 1.0), repeat=3))) * self.half, 0.0


@dataclass(frozen=True)
class Sphere(Solid):
    """A ball."""

    radius: float

    @property
    @override
    def words(self) -> str:
        return f"sphere of radius {self.radius:g} m"

    @override
    def inertia(self, mass: float) -> np.ndarray:
        return 0.4 * mass * self.radius**2 * np.eye(3)

    @override
    def nearest(self, point: np.ndarray) -> np.ndarray:
        return point * min(1.0, self.radius / max(float(np.linalg.norm(point)), 1e-300))

    @override
    def corners(self) -> tuple[np.ndarray, float]:
        return np.zeros((1, 3)), self.radius


@dataclass(frozen=True)
class Hull(Solid):
    """The convex hull of points."""

    points: tuple[tuple[float, float, float], ...]

    @property
    @override
    def words(self) -> str:
        return f"convex polyhedron of {len(self.points)} corners"

    @override
    def inertia(self, mass: float) -> np.ndarray:
        return hull_mass_properties(np.array(self.points), mass).inertia

    @override
    def nearest(self, point: np.ndarray) -> np.ndarray:
        points = np.array(self.points)
        return nearest_in(points, hull_triangles(points), point)

    @override
    def corners(self) -> tuple[np.ndarray, float]:
        return hull_corners(np.array(self.points)), 0.0


class Cylinder(Spec, Solid):
    """A cylinder about the z axis."""

    radius: Positive
    """[m]"""
    height: Positive
    """Along z [m]."""

    @property
    @override
    def words(self) -> str:
        return f"cylinder of radius {self.radius:g} m, height {self.height:g} m"

    @override
    def inertia(self, mass: float) -> np.ndarray:
        across = mass * (3.0 * self.radius**2 + self.height**2) / 12.0
        return np.diag([across, across, mass * self.radius**2 / 2.0])

    @override
    def nearest(self, point: np.ndarray) -> np.ndarray:
        across = min(1.0, self.radius / max(float(np.hypot(*point[:2])), 1e-300))
        end = 0.5 * self.height
        return np.array([*(across * point[:2]), np.clip(point[2], -end, end)])

    @override
    def bounding_box(self) -> Bounds:
        half = np.array([self.radius, self.radius, 0.5 * self.height])
        return -half, half

    @override
    def corners(self) -> tuple[np.ndarray, float]:
        raise NoCornersError("a cylinder has no corners", "such as eight or more around each rim")


class Mesh(Spec, Solid):
    """A mesh, its origin at the centre of mass."""

    file: FilePath
    """An STL, OBJ, PLY, OFF or Collada file."""
    scale: Annotated[
        tuple[float, float, float],
        BeforeValidator(_scale),
        WithJsonSchema({"anyOf": [_LENGTH, _LENGTHS]}),
    ] = (1.0, 1.0, 1.0)
    """Metres for each unit of the file, for all axes or one for each."""

    def triangle_mesh(self) -> TriangleMesh | None:
        """The mesh in the object's frame; None if the file cannot be read."""
        try:
            return read_mesh(self.file, self.scale)
        except ValueError:  # the replay says so
            return None

    @property
    @override
    def words(self) -> str:
        return f"mesh {self.file.name}"

    @override
    def nearest(self, point: np.ndarray) -> np.ndarray | None:
        mesh = self.triangle_mesh()
        return None if mesh is None else nearest_in(mesh.vertices, mesh.triangles, point)

    @override
    def bounding_box(self) -> Bounds | None:
        mesh = self.triangle_mesh()
        return None if mesh is None else (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))

    @override
    def corners(self) -> tuple[np.ndarray, float]:
        if not self.file.is_file():
            raise NoCornersError(f"there is no mesh at {self.file}", "or correct the path")
        try:
            mesh = read_mesh(self.file, self.scale)
        except ValueError as error:
            raise NoCornersError(
                f"{self.file} cannot be read ({error})", "or repair the file"
            ) from None
        try:
            corners = hull_corners(mesh.vertices[np.unique(mesh.triangles)])
        except ValueError:
            raise NoCornersError("the mesh is flat", "on both of its sides") from None
        if len(corners) > MOST_CORNERS:
            raise NoCornersError(
                f"the hull of {self.file.name} has {len(corners)} corners, which is too many",
                f"at most {MOST_CORNERS}",
            )
        return corners, 0.0


class Shape(OneOf):
    """The shape of the object: exactly one of these."""

    box: Edges | None = Field(None, examples=[[0.6, 0.5, 0.4]])
    """A block, by its full edge lengths [m] along x, y, z."""
    sphere: Positive | None = Field(None, examples=[0.25])
    """A ball, by its radius [m]."""
    cylinder: Cylinder | None = Field(None, examples=[{"radius": 0.2, "height": 0.5}])
    """A round bar or a disc, its axis along z."""
    hull: Points | None = Field(
        None, examples=[[[0.3, 0, -0.1], [-0.15, 0.26, -0.1], [-0.15, -0.26, -0.1], [0, 0, 0.3]]]
    )
    """Corners of a convex polyhedron [m] whose centre of mass is the origin."""
    mesh: Mesh | None = Field(None, examples=[{"file": "part.stl", "scale": 0.001}])
    """A mesh from a file, for the eye only; then ``inertia`` must be given."""

    @classmethod
    def example_text(cls, name: str) -> str:
        """An object of one of the shapes, as lines of a scene."""
        shapes = cls.model_fields[name].examples or []
        body: dict[str, Any] = {"shape": {name: shapes[0]}, "mass": 5.0}
        if name == "mesh":
            body["inertia"] = [0.1, 0.1, 0.1]
        return written_yaml({"object": body}).strip()

    @property
    def solid(self) -> Solid | None:
        """The one that it is; None where it is unknown."""
        if self.box is not None:
            return Box(self.box)
        if self.sphere is not None:
            return Sphere(self.sphere)
        if self.hull is not None:
            return Hull(self.hull)
        return self.cylinder or self.mesh


NO_SHAPE = Shape.model_construct()
"""Of an object of which mass and inertia are known only: none of the five."""
