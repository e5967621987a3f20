r"""The common object: shape, mass, inertia and start.

A rigid body's inertia about its centre of mass is :math:`I = \int (|r|^2 E - r r^T) dm`.  So it is
symmetric and positive, and its principal moments satisfy the triangle inequality a + b >= c, since
:math:`a + b - c = 2 \int z^2 dm` along the principal axis of c.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema, model_validator
from typing_extensions import Self

from multiarm.scene.faults import invalid, shown
from multiarm.scene.shapes import NO_SHAPE, Shape
from multiarm.scene.solids import hull_mass_properties
from multiarm.scene.spec import Spec
from multiarm.scene.values import Color, Pose, Positive, Vec6, as_list, items_of, number_list

# The centre of mass of a hull may be off the origin by so much of its size.
_CENTRED = 1e-6
_FORMS = (
    "write three principal moments [ixx, iyy, izz], six entries "
    "[ixx, ixy, ixz, iyy, iyz, izz] or the 3x3 matrix, in kg m^2"
)
_RELATIVE_ROUNDING = 1e-6  # hand-copied inertias carry about so many digits


def _inertia_matrix(value: Any) -> tuple[tuple[float, ...], ...]:
    """The 3x3 matrix that ``value`` stands for; a fault if no body can have it."""
    matrix = _matrix(value)
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > _RELATIVE_ROUNDING * size:
        raise invalid(f"the inertia must be symmetric, got {shown(matrix.tolist())}")
    matrix = (matrix + matrix.T) / 2
    low, middle, high = np.linalg.eigvalsh(matrix)
    text = f"principal moments {low:.6g}, {middle:.6g}, {high:.6g} kg m^2"
    if not low > 0.0:
        raise invalid(f"the inertia must be positive definite, got {text}")
    if low + middle < high * (1 - _RELATIVE_ROUNDING):
        raise invalid(
            f"no rigid body has this inertia: of its {text} the largest exceeds the sum of the "
            "others; check the units and the signs of the products of inertia"
        )
    return tuple(tuple(row) for row in matrix.tolist())


def _matrix(value: Any) -> np.ndarray:
    rows = as_list(value)
    if not isinstance(rows, (list, tuple)) or len(rows) not in (3, 6):
        raise invalid(f"got {shown(value)}; {_FORMS}")
    if all(isinstance(row, (list, tuple)) for row in rows):
        if len(rows) != 3 or any(len(row) != 3 for row in rows):
            raise invalid(f"got {shown(value)}; {_FORMS}")
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
    """Of the object frame in the world at the start. Absent: the origin; of several objects, where
    the first joint with 'at' and a body that has a place puts it."""
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
            raise invalid("a mesh needs 'inertia' (about the centre of mass, in kg m^2)")
        if self.shape == NO_SHAPE:
            raise invalid("needs its 'shape', or 'inertia' (about the centre of mass, in kg m^2)")
        if self.shape.hull is None:
            try:
                moments = np.diag(self.inertia_matrix())
            except OverflowError:
                moments = np.array([np.inf])
            if not (np.isfinite(moments).all() and moments.min() > 0.0):
                raise invalid(
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
            raise invalid(
                f"the centre of mass of the hull is at {[round(float(x), 9) for x in centre]}, but "
                f"the object's frame has its origin there; take this off every corner"
            )
        return self

    def inertia_matrix(self) -> np.ndarray:
        """Inertia about the centre of mass in object axes, shape (3, 3) [kg m^2]."""
        if self.inertia is not None:
            return np.array(self.inertia)
        solid = self.shape.solid
        assert solid is not None, "an object without a shape comes with an inertia"
        return solid.inertia(self.mass)
