"""The common object: its shape, mass, inertia and start."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from typing_extensions import Self

from multiarm.errors import GraspError
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.scene.base import Pose, Spec, absolute
from multiarm.scene.inertia import Matrix3, inertia_matrix, uniform_inertia
from multiarm.scene.values import Color, Positive, Vec6, fault, number_list
from multiarm.scene.words import shown

__all__ = ["Cylinder", "Mesh", "ObjectSpec", "Shape"]

# The centre of mass of a hull may be off the origin by so much of its size.
CENTRED = 1e-6

Inertia = Annotated[Matrix3, BeforeValidator(inertia_matrix)]


def _scale(value: Any) -> tuple[float, ...]:
    scale = tuple(number_list(value if isinstance(value, (list, tuple)) else [value] * 3))
    if len(scale) != 3 or min(scale) <= 0.0:
        raise fault(f"must be one or three numbers greater than 0, got {shown(value)}")
    return scale


def _edges(value: Any) -> tuple[float, ...]:
    edges = tuple(number_list(value)) if isinstance(value, (list, tuple)) else ()
    if len(edges) != 3 or min(edges) <= 0.0:
        raise fault(f"must be three lengths greater than 0, got {shown(value)}")
    return edges


class Cylinder(Spec):
    """A cylinder about the z axis: radius and height [m]."""

    radius: Positive
    height: Positive


def _corners(value: Any) -> tuple[tuple[float, ...], ...]:
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(rows, (list, tuple)) or len(rows) < 4:
        raise fault(f"must be a list of at least four points, got {shown(value)}")
    points = tuple(tuple(number_list(row)) for row in rows)
    if any(len(point) != 3 for point in points):
        raise fault(f"must be points of three numbers each, got {shown(value)}")
    try:
        Polyhedron.hull(np.array(points))
    except GraspError as error:
        raise fault(str(error)) from None
    return points


class Mesh(Spec):
    """A mesh file, its origin at the centre of mass, and its scale (number or 3 numbers)."""

    file: Path
    scale: Annotated[tuple[float, float, float], BeforeValidator(_scale)] = (1.0, 1.0, 1.0)


class Shape(Spec):
    """The shape of the object: exactly one of these.

    Attributes
    ----------
    box : 3 numbers
        Full edge lengths [m] along x, y, z.
    sphere : float
        Radius [m].
    cylinder : Cylinder
        Axis along z.
    hull : list of 3 numbers
        Corners of a convex polyhedron [m] whose centre of mass is the origin.
    mesh : Mesh
        For the eye only; then ``inertia`` must be given.
    """

    box: Annotated[tuple[float, float, float], BeforeValidator(_edges)] | None = None
    sphere: Positive | None = None
    cylinder: Cylinder | None = None
    hull: Annotated[tuple[tuple[float, float, float], ...], BeforeValidator(_corners)] | None = None
    mesh: Mesh | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            names = ", ".join(f"'{name}'" for name in type(self).model_fields)
            raise fault(f"needs exactly one of {names}, got {given}")
        return self


class ObjectSpec(Spec):
    """The common object. Its frame has the origin at the centre of mass.

    Attributes
    ----------
    shape : Shape
        For the eye, and for the inertia where that is not given.
    mass : float
        [kg]
    inertia : 3, 6 or 3x3 numbers, optional
        About the centre of mass in object axes [kg m^2]: principal moments, the entries
        ixx, ixy, ixz, iyy, iyz, izz, or the matrix. Absent: uniform density.
    pose : Pose
        Of the object frame in the world at the start.
    twist : 6 numbers, optional
        Velocity of the centre of mass [m/s] and angular velocity [rad/s], world axes, at the
        start. Absent: at rest.
    color : '#rrggbb' or 3 or 4 numbers, optional
        Red, green, blue, opacity from 0 to 1.
    """

    shape: Shape = Field(description="such as {box: [1.0, 0.5, 0.2]}")
    mass: Positive = Field(description="in kg")
    inertia: Inertia | None = None
    pose: Pose = Pose()
    twist: Vec6 | None = None
    color: Color | None = None

    @model_validator(mode="after")
    def _inertia_is_known(self) -> Self:
        if self.shape.mesh is not None and self.inertia is None:
            raise fault("a mesh needs 'inertia' (about the centre of mass, in kg m^2)")
        return self

    @model_validator(mode="after")
    def _hull_is_centred(self) -> Self:
        if self.shape.hull is None:
            return self
        body = Polyhedron.hull(np.array(self.shape.hull))
        centre = body.mass_properties(self.mass).centre
        if np.linalg.norm(centre) > CENTRED * body.size:
            raise fault(
                f"the centre of mass of the hull is at {[round(float(x), 9) for x in centre]}, but "
                f"the object's frame has its origin there; take this off every corner"
            )
        return self

    def inertia_matrix(self) -> np.ndarray:
        """Return the inertia about the centre of mass in object axes, shape (3, 3) [kg m^2]."""
        if self.inertia is not None:
            return np.array(self.inertia)
        cylinder = self.shape.cylinder
        return uniform_inertia(
            self.mass,
            box=self.shape.box,
            sphere=self.shape.sphere,
            radius_height=None if cylinder is None else (cylinder.radius, cylinder.height),
            hull=None if self.shape.hull is None else np.array(self.shape.hull),
        )

    def located(self, folder: Path) -> Self:
        """Return this object with file paths made absolute, relative ones below ``folder``."""
        if self.shape.mesh is None:
            return self
        mesh = self.shape.mesh.model_copy(update={"file": absolute(self.shape.mesh.file, folder)})
        return self.model_copy(update={"shape": self.shape.model_copy(update={"mesh": mesh})})
