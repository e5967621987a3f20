"""Rotational inertia: the forms in which it is written, and whether a body can have it.

A rigid body's inertia about its centre of mass is I = integral of (|r|^2 E - r r^T) dm. So it is
symmetric and positive, and its principal moments satisfy the triangle inequality a + b >= c, since
a + b - c = 2 * integral of z^2 dm along the principal axis of c.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.grasp.polyhedron import Polyhedron
from multiarm.scene.values import fault, number_list
from multiarm.scene.words import shown

__all__ = ["Matrix3", "inertia_matrix", "uniform_inertia"]

Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

_FORMS = (
    "write three principal moments [ixx, iyy, izz], six entries "
    "[ixx, ixy, ixz, iyy, iyz, izz] or the 3x3 matrix, in kg m^2"
)
_RELATIVE_ROUNDING = 1e-6  # hand-copied inertias carry about so many digits


def inertia_matrix(value: Any) -> Matrix3:
    """Return the 3x3 matrix that ``value`` stands for, refusing what no body can have.

    Parameters
    ----------
    value : 3, 6 or 3x3 numbers
        Inertia [kg m^2] about the centre of mass.

    Returns
    -------
    3x3 tuple
        The symmetric matrix.

    Raises
    ------
    PydanticCustomError
        If the form is unknown, or the matrix is not symmetric, not positive definite or violates
        the triangle inequality.
    """
    matrix = _matrix(value)
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > _RELATIVE_ROUNDING * size:
        raise fault(f"the inertia must be symmetric, got {shown(matrix.tolist())}")
    matrix = (matrix + matrix.T) / 2
    low, middle, high = np.linalg.eigvalsh(matrix)
    moments = f"principal moments {low:.6g}, {middle:.6g}, {high:.6g} kg m^2"
    if not low > 0.0:
        raise fault(f"the inertia must be positive definite, got {moments}")
    if low + middle < high * (1 - _RELATIVE_ROUNDING):
        raise fault(
            f"no rigid body has this inertia: of its {moments} the largest exceeds the sum of the "
            "others; check the units and the signs of the products of inertia"
        )
    return tuple(tuple(float(x) for x in row) for row in matrix)  # type: ignore[return-value]


def uniform_inertia(
    mass: float,
    *,
    box: tuple[float, ...] | None = None,
    sphere: float | None = None,
    radius_height: tuple[float, float] | None = None,
    hull: np.ndarray | None = None,
) -> np.ndarray:
    """Return the inertia of a solid of uniform density about its centre of mass.

    Parameters
    ----------
    mass : float
        [kg]
    box : 3 floats, optional
        Edge lengths [m].
    sphere : float, optional
        Radius [m].
    radius_height : 2 floats, optional
        Radius and height [m] of a cylinder about z.
    hull : ndarray, shape (K, 3), optional
        Corners of a convex polyhedron [m].

    Returns
    -------
    ndarray, shape (3, 3)
        [kg m^2]
    """
    if box is not None:
        squares = np.square(box)
        return np.diag(mass / 12.0 * (squares.sum() - squares))
    if sphere is not None:
        return 0.4 * mass * sphere**2 * np.eye(3)
    if hull is not None:
        return Polyhedron.hull(hull).mass_properties(mass).inertia
    assert radius_height is not None
    radius, height = radius_height
    across = mass * (3.0 * radius**2 + height**2) / 12.0
    return np.diag([across, across, mass * radius**2 / 2.0])


def _matrix(value: Any) -> np.ndarray:
    rows = value.tolist() if isinstance(value, np.ndarray) else value
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
