r"""The common object: shape, mass, inertia and start; mass properties of solids.

Volume, centre and inertia of a solid are sums over the signed tetrahedra between a point inside and
the triangles :math:`(v_1, v_k, v_{k+1})` of the loops around its faces; those of dents and of
holes, whose loops run the other way round, are negative, so that no face has to be cut up.  With
corners a, b, c of a triangle about the point and :math:`s = a + b + c`

.. math::
    V = \sum \tfrac{1}{6} a \cdot (b \times c), \qquad
    \int x \, dV = \sum \tfrac{V_i}{4} s, \qquad
    \int x x^T dV = \sum \tfrac{V_i}{20} (a a^T + b b^T + c c^T + s s^T).

A rigid body's inertia about its centre of mass is :math:`I = \int (|r|^2 E - r r^T) dm`.  So it is
symmetric and positive, and its principal moments satisfy the triangle inequality a + b >= c, since
:math:`a + b - c = 2 \int z^2 dm` along the principal axis of c.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault, shown
from multiarm.scene.meshes import read_mesh
from multiarm.scene.text import written_yaml
from multiarm.scene.values import (
    Color,
    FilePath,
    OneOf,
    Pose,
    Positive,
    Spec,
    Vec3,
    Vec6,
    as_list,
    items_of,
    list_of,
    number_list,
)

# The centre of mass of a hull may be off the origin by so much of its size.
_CENTRED = 1e-6
# A body thinner than this part of its size is flat: its corners may be given in single precision.
_FLAT = 1e-6
TOO_THIN = (
    "the body is thinner than its coordinates resolve, about a millionth of its size: give it "
    "more thickness"
)
_FORMS = (
    "write three principal moments [ixx, iyy, izz], six entries "
    "[ixx, ixy, ixz, iyy, iyz, izz] or the 3x3 matrix, in kg m^2"
)
_RELATIVE_ROUNDING = 1e-6  # hand-copied inertias carry about so many digits


# --- solids of uniform density --------------------------------------------------------------------


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a solid of constant density.

    Attributes
    ----------
    mass : float
        [kg]
    centre : ndarray, shape (3,)
        Centre of mass in the body's frame [m].
    inertia : ndarray, shape (3, 3)
        About the centre of mass, in the body's axes [kg m^2].
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Moments:
    """Moments of the volume of a solid.

    Attributes
    ----------
    volume : float
        [m^3]
    centre : ndarray, shape (3,)
        [m]
    second : ndarray, shape (3, 3)
        Integral of ``x x^T`` about the centre [m^5].
    """

    volume: float
    centre: np.ndarray
    second: np.ndarray

    def of_mass(self, mass: float) -> MassProperties:
        """Mass properties when a mass is spread evenly over the volume."""
        inertia = np.trace(self.second) * np.eye(3) - self.second
        return MassProperties(mass, self.centre, inertia * (mass / self.volume))


def moments(vertices: np.ndarray, loops: Sequence[Sequence[int]] | np.ndarray) -> Moments:
    """Moments of the solid that loops of corners (V, 3) bound."""
    middle = vertices.mean(axis=0)
    fans = [(loop[0], loop[k], loop[k + 1]) for loop in loops for k in range(1, len(loop) - 1)]
    corners = (vertices - middle)[np.array(fans)]  # (T, 3 corners, 3)
    volumes = np.linalg.det(corners) / 6.0
    sums = corners.sum(axis=1)
    volume = float(volumes.sum())
    centre = volumes @ sums / (4.0 * volume) if volume else np.zeros(3)
    about = np.einsum("t,tki,tkj->ij", volumes, corners, corners)
    about += np.einsum("t,ti,tj->ij", volumes, sums, sums)
    return Moments(volume, centre + middle, about / 20.0 - volume * np.outer(centre, centre))


def hull_triangles(points: np.ndarray) -> np.ndarray:
    """Triangles (T, 3), seen counter-clockwise from outside, of the convex hull of points (N, 3).

    Raises
    ------
    ValueError
        When the hull has no thickness.
    """
    from scipy.spatial import ConvexHull, QhullError

    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    size = float(np.ptp(points, axis=0).max())
    try:
        hull = ConvexHull((points - middle) / (size or 1.0))
    except QhullError as error:
        raise ValueError(
            "the points of a hull lie in a plane, or there are fewer than four of them: they "
            "enclose no volume"
        ) from error
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3:]
    depths = (normals @ hull.points.T + offsets).min(axis=1)  # below each face
    if depths.max() > -_FLAT:
        raise ValueError(TOO_THIN)
    triangles = hull.simplices.copy()
    a, b, c = np.moveaxis(hull.points[triangles], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * normals, axis=1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles


def hull_mass_properties(points: np.ndarray, mass: float) -> MassProperties:
    """Mass properties of the convex hull of points (N, 3) [m] of uniform density, ``mass`` [kg]."""
    return moments(points, hull_triangles(points)).of_mass(mass)


def nearest_in(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The point nearest to ``point`` (3,) of the solid inside triangles (T, 3), seen from outside.

    Inside the solid angles of the triangles add up to a full one: with corners a, b, c about the
    point, each is 2 atan2(a . (b x c), |a||b||c| + a.b |c| + b.c |a| + c.a |b|).
    """
    import trimesh

    corners = vertices[triangles]
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    ab, bc, ca = (np.sum(u * v, axis=1) for u, v in ((a, b), (b, c), (c, a)))
    volume = np.sum(a * np.cross(b, c), axis=1)
    angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum()
    if angle > 2.0 * np.pi:  # half of a full one
        return point
    near = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
    return near[np.argmin(np.sum((near - point) ** 2, axis=1))]


# --- the object as it is written ------------------------------------------------------------------


def _inertia_matrix(value: Any) -> tuple[tuple[float, ...], ...]:
    """The 3x3 matrix that ``value`` stands for; a fault if no body can have it."""
    matrix = _matrix(value)
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > _RELATIVE_ROUNDING * size:
        raise fault(f"the inertia must be symmetric, got {shown(matrix.tolist())}")
    matrix = (matrix + matrix.T) / 2
    low, middle, high = np.linalg.eigvalsh(matrix)
    text = f"principal moments {low:.6g}, {middle:.6g}, {high:.6g} kg m^2"
    if not low > 0.0:
        raise fault(f"the inertia must be positive definite, got {text}")
    if low + middle < high * (1 - _RELATIVE_ROUNDING):
        raise fault(
            f"no rigid body has this inertia: of its {text} the largest exceeds the sum of the "
            "others; check the units and the signs of the products of inertia"
        )
    return tuple(tuple(row) for row in matrix.tolist())


def _matrix(value: Any) -> np.ndarray:
    rows = as_list(value)
    if not isinstance(rows, (list, tuple)) or len(rows) not in (3, 6):
        raise fault(f"got {shown(value)}; {_FORMS}")
    if all(isinstance(row, (list, tuple)) for row in rows):
        if len(rows) != 3 or any(len(row) != 3 for row in rows):
            raise fault(f"got {shown(value)}; {_FORMS}")
        return np.array([number_list(row) for row in rows])
    entries = number_list(rows)
    if len(entries) == 3:
        return np.diag(entries)
    xx, xy, xz, yy, yz, zz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


Row = tuple[float, float, float]
_NUMBERS = {"type": "array", "items": {"type": "number"}}
Inertia = Annotated[
    tuple[Row, Row, Row],
    BeforeValidator(_inertia_matrix),
    WithJsonSchema(
        {
            "anyOf": [
                {**_NUMBERS, **items_of(3)},
                {**_NUMBERS, **items_of(6)},
                {"type": "array", "items": {**_NUMBERS, **items_of(3)}, **items_of(3)},
            ]
        }
    ),
]
"""Rotational inertia [kg m^2]: principal moments, six entries or the matrix."""


def _scale(value: Any) -> tuple[float, ...]:
    scale = number_list(value if isinstance(value, (list, tuple)) else [value] * 3)
    if len(scale) != 3 or min(scale) <= 0.0:
        raise fault(f"must be one or three numbers greater than 0, got {shown(value)}")
    return scale


def _solid(points: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    try:
        hull_triangles(np.array(points))
    except ValueError as error:
        raise fault(str(error)) from None
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


class Cylinder(Spec):
    """A cylinder about the z axis."""

    radius: Positive
    """[m]"""
    height: Positive
    """Along z [m]."""


class Mesh(Spec):
    """A mesh, its origin at the centre of mass."""

    file: FilePath
    """An STL, OBJ, PLY, OFF or Collada file."""
    scale: Annotated[
        tuple[float, float, float],
        BeforeValidator(_scale),
        WithJsonSchema({"anyOf": [_LENGTH, _LENGTHS]}),
    ] = (1.0, 1.0, 1.0)
    """Metres for each unit of the file, for all axes or one for each."""

    def triangles(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Corners (N, 3) in the object's frame [m] and triangles (T, 3); None if unreadable."""
        try:
            return read_mesh(self.file, self.scale)[:2]
        except ValueError:  # the replay says so
            return None


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

    def uniform_inertia(self, mass: float) -> np.ndarray:
        """Inertia about the centre of mass at uniform density, shape (3, 3) [kg m^2]."""
        if self.box is not None:
            squares = np.square(self.box)
            return np.diag(mass / 12.0 * (squares.sum() - squares))
        if self.sphere is not None:
            return 0.4 * mass * self.sphere**2 * np.eye(3)
        if self.hull is not None:
            return hull_mass_properties(np.array(self.hull), mass).inertia
        assert self.cylinder is not None, "a mesh, or no shape, comes with an inertia"
        radius, height = self.cylinder.radius, self.cylinder.height
        across = mass * (3.0 * radius**2 + height**2) / 12.0
        return np.diag([across, across, mass * radius**2 / 2.0])

    def corners(self) -> np.ndarray | None:
        """The corners (N, 3) of a hull, or of a mesh that can be read, object frame [m]."""
        if self.hull is not None:
            return np.array(self.hull)
        triangles = None if self.mesh is None else self.mesh.triangles()
        return None if triangles is None else triangles[0]

    def bounding_box(self) -> np.ndarray | None:
        """Least and largest coordinates (2, 3), object frame [m]; None without a shape."""
        if self.box is not None:
            half = 0.5 * np.array(self.box)
        elif self.sphere is not None:
            half = np.full(3, self.sphere)
        elif self.cylinder is not None:
            half = np.array([self.cylinder.radius] * 2 + [0.5 * self.cylinder.height])
        else:
            points = self.corners()
            return None if points is None else np.array([points.min(axis=0), points.max(axis=0)])
        return np.array([-half, half])

    def nearest(self, point: np.ndarray) -> np.ndarray | None:
        """The point of the solid that is nearest to a point (3,) [m], object frame.

        A point inside is the nearest to itself; None without a shape, or of a mesh that cannot be
        read.
        """
        if self.box is not None:
            half = 0.5 * np.array(self.box)
            return np.clip(point, -half, half)
        if self.sphere is not None:
            return point * min(1.0, self.sphere / max(float(np.linalg.norm(point)), 1e-300))
        if self.cylinder is not None:
            across = self.cylinder.radius / max(float(np.hypot(*point[:2])), 1e-300)
            end = 0.5 * self.cylinder.height
            return np.array([*(min(1.0, across) * point[:2]), np.clip(point[2], -end, end)])
        if self.hull is not None:
            points = np.array(self.hull)
            return nearest_in(points, hull_triangles(points), point)
        triangles = None if self.mesh is None else self.mesh.triangles()
        return None if triangles is None else nearest_in(*triangles, point)


NO_SHAPE = Shape.model_construct()
"""Of an object of which mass and inertia are known only: none of the five."""


class ObjectSpec(Spec):
    """The common object. Its frame has the origin at the centre of mass."""

    shape: Shape = NO_SHAPE
    """Such as {box: [1.0, 0.5, 0.2]}. For the eye, and for the inertia where that is not given;
    absent: the replay shows the box of that mass and inertia."""
    mass: Positive
    """Its mass [kg]."""
    inertia: Inertia | None = None
    """About the centre of mass in object axes [kg m^2]: principal moments, the entries ixx, ixy,
    ixz, iyy, iyz, izz, or the matrix. Absent: uniform density."""
    pose: Pose = Pose()
    """Of the object frame in the world at the start."""
    twist: Vec6 | None = None
    """Velocity of the centre of mass [m/s] and angular velocity [rad/s], world axes, at the start.
    Absent: at rest."""
    color: Color | None = None
    """Red, green, blue, opacity from 0 to 1."""

    @model_validator(mode="after")
    def _inertia_is_known(self) -> Self:
        if self.inertia is not None:
            return self
        if self.shape.mesh is not None:
            raise fault("a mesh needs 'inertia' (about the centre of mass, in kg m^2)")
        if self.shape == NO_SHAPE:
            raise fault("needs its 'shape', or 'inertia' (about the centre of mass, in kg m^2)")
        if self.shape.hull is None:
            try:
                moments = np.diag(self.shape.uniform_inertia(self.mass))
            except OverflowError:
                moments = np.array([np.inf])
            if not (np.isfinite(moments).all() and moments.min() > 0.0):
                raise fault(
                    "its size and mass are beyond the numbers of a computer; SI units are m, kg"
                )
        return self

    @model_validator(mode="after")
    def _hull_is_centred(self) -> Self:
        if self.shape.hull is None:
            return self
        corners = np.array(self.shape.hull)
        centre = hull_mass_properties(corners, self.mass).centre
        if np.linalg.norm(centre) > _CENTRED * np.linalg.norm(np.ptp(corners, axis=0)):
            raise fault(
                f"the centre of mass of the hull is at {[round(float(x), 9) for x in centre]}, but "
                f"the object's frame has its origin there; take this off every corner"
            )
        return self

    def inertia_matrix(self) -> np.ndarray:
        """Inertia about the centre of mass in object axes, shape (3, 3) [kg m^2]."""
        if self.inertia is not None:
            return np.array(self.inertia)
        return self.shape.uniform_inertia(self.mass)
