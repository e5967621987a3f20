"""A joint is data: the record of one frictionless point contact, and tables of records.

Each record says which body carries the *point* (a sharp point, or the centre of a spherical
fingertip), which carries the *surface*, and the local geometry of both.  Everything the dynamics
need (W, dW/dt, c, phi) follows from the records in one kernel, see :mod:`multiarm.contacts.kernel`.

Geometry is given in the frame of the body that carries it: on the arm in the tip frame, on the
object in the object frame.  The normal of a surface is the outward normal of its body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

# Codes used by the compiled kernel.
PLANE, SPHERE, CYLINDER = 0, 1, 2
SURFACE_ON_OBJECT, SURFACE_ON_ARM = 0, 1

# Columns of ContactTable.geometry.
POINT, ORIGIN, AXIS, RADIUS, SIDE, TIP_RADIUS, GEOMETRY_WIDTH = 0, 3, 6, 9, 10, 11, 12


@dataclass(frozen=True)
class Contact:
    """One frictionless, bilateral point contact between an arm's tip and the object.

    Attributes
    ----------
    name : str
        Shown in messages and results.
    surface : int
        ``PLANE``, ``SPHERE`` or ``CYLINDER``.
    surface_body : int
        ``SURFACE_ON_OBJECT`` (the arm carries the point) or ``SURFACE_ON_ARM``.
    point : ndarray, shape (3,)
        Point or fingertip centre, in the frame of the body that carries it [m].
    origin, axis : ndarray, shape (3,)
        A point of the plane and its outward unit normal; the centre of the sphere (axis unused);
        a point of the cylinder's axis and its unit direction.  Frame of the surface's body.
    radius : float
        Of the sphere or cylinder [m]; 0 for a plane.
    inside : bool
        The surface is hollow and touched from inside.
    tip_radius : float
        Radius of the spherical fingertip [m]; 0 for a sharp point.
    """

    name: str
    surface: int
    surface_body: int
    point: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    radius: float = 0.0
    inside: bool = False
    tip_radius: float = 0.0

    def moved_on_arm(self, rotation: np.ndarray, translation: np.ndarray) -> Contact:
        """The same contact with the arm's geometry re-expressed: ``p -> rotation p + translation``.

        Used to store it in the frame of the joint that carries the tip.
        """
        if self.surface_body == SURFACE_ON_OBJECT:
            return replace(self, point=rotation @ self.point + translation)
        return replace(self, origin=rotation @ self.origin + translation, axis=rotation @ self.axis)


class ContactTable(NamedTuple):
    """Records packed for the kernel, one row a contact, arm after arm.

    codes : int64 (N, 2)
        Surface kind, and the body that carries the surface.
    geometry : float64 (N, 12)
        Point (3), origin (3), axis (3), radius, side (+1 outer, -1 hollow), tip radius.
    """

    codes: np.ndarray
    geometry: np.ndarray


def pack(contacts: list[Contact]) -> ContactTable:
    """Pack records for the kernel."""
    codes = np.zeros((len(contacts), 2), dtype=np.int64)
    geometry = np.zeros((len(contacts), GEOMETRY_WIDTH))
    for row, contact in enumerate(contacts):
        codes[row] = contact.surface, contact.surface_body
        geometry[row, POINT : POINT + 3] = contact.point
        geometry[row, ORIGIN : ORIGIN + 3] = contact.origin
        geometry[row, AXIS : AXIS + 3] = contact.axis
        geometry[row, RADIUS] = contact.radius
        geometry[row, SIDE] = -1.0 if contact.inside else 1.0
        geometry[row, TIP_RADIUS] = contact.tip_radius
    return ContactTable(codes, geometry)
