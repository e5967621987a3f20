r"""Where on a face the last contact closes the grasp: a polygon, exactly.

Given at least six contacts whose wrenches have rank 6, one more contact at p on a plane face with
the inward normal :math:`e_7` gives form closure when its wrench is on the outer side of all facets
of the cone of the others (see `wrench_cones`),

.. math::
    n_f \cdot \begin{bmatrix} e_7 \\ p \times e_7 \end{bmatrix} < 0 \quad \text{for all } f .

The wrench is affine in p, so that each facet leaves a half-plane of the face.  For six contacts the
:math:`n_f` are the rows of :math:`W_6^{-1}` (thesis, eq. 2.3).  The polygon is what the half-planes
leave of the face; its border is not in the region.  The same region follows from the moments of the
contacts (eq. 2.4), by other arithmetic: ``method="moments"``
(:mod:`multiarm.grasp.seventh_contact.moment_route`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.deepest import middle_of
from multiarm.grasp.body.face import Face, as_face, cut_face, distinct, room_in
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts
from multiarm.grasp.seventh_contact.moment_route import moment_half_planes
from multiarm.grasp.seventh_contact.wrench_cones import WrenchCone, strictness, wrench_cone

if TYPE_CHECKING:
    from shapely.geometry import MultiPolygon

# A half-plane whose border is farther away than 1 / FAR_BORDER face sizes holds everywhere or
# nowhere on the face.
FAR_BORDER = 1e-12
# Where a level stays below this multiple of what counts as zero all over the face, the border of
# its half-plane is drawn where it is no longer zero.
LEVEL = 1e5


@dataclass(frozen=True, eq=False)
class ContactRegion:
    """The part of a face where one more contact gives form closure; its border is not in it.

    Attributes
    ----------
    contacts : Contacts
        The contacts that are there already.
    face : Face
    half_planes : ndarray, shape (F, 3)
        Rows (a_x, a_y, b) with ``a_x x + a_y y < b`` in face coordinates (see `Face.frame`),
        (a_x, a_y) of unit length [1, 1, m].  They do not contain the edges of the face.
    outlines : tuple of ndarray, shape (K, 2)
        Outer corners of each piece in face coordinates, counter-clockwise; one piece when the face
        is convex, none when no contact on the face closes the grasp.
    holes : tuple of tuple of ndarray, shape (H, 2)
        For each piece the corners of its holes.
    reason : str
        Why the region is empty, or a remark on it; often empty.
    """

    contacts: Contacts
    face: Face
    half_planes: np.ndarray
    outlines: tuple[np.ndarray, ...]
    holes: tuple[tuple[np.ndarray, ...], ...]
    reason: str

    def __bool__(self) -> bool:
        return bool(self.outlines)

    @cached_property
    def _cone(self) -> WrenchCone:
        return wrench_cone(self.contacts)

    @cached_property
    def polygons(self) -> tuple[np.ndarray, ...]:
        """Outer corners (K, 3) of each piece in the body's frame [m], the largest piece first."""
        return tuple(self.face.at(outline) for outline in self.outlines)

    @cached_property
    def vertices(self) -> np.ndarray:
        """Corners (M, 3) of all pieces in the body's frame [m], one piece after the other."""
        return np.vstack([np.empty((0, 3)), *self.polygons])

    @property
    def area(self) -> float:
        """Area of all pieces [m^2]."""
        return float(self.shape.area)

    @cached_property
    def shape(self) -> MultiPolygon:
        """The region as polygons of shapely, in face coordinates."""
        from shapely.geometry import MultiPolygon

        return MultiPolygon(list(zip(self.outlines, self.holes, strict=True)))

    def contains(self, points: Any) -> np.ndarray:
        """Which of the points (..., 3), projected onto the face, are inside and not on the border.

        A point counts as on the border by the criterion of `WrenchCone.closes`.
        """
        y = self.face.coordinates(points)
        if not self:
            return np.zeros(y.shape[:-1], dtype=bool)
        inside = np.all(y @ self.half_planes[:, :2].T < self.half_planes[:, 2], axis=-1)
        inside &= self._cone.closes(self.face.at(y), -self.face.normal)
        return inside & self.face.contains(points)

    def depth(self, points: Any) -> np.ndarray:
        """Distance (...) of points (..., 3) of the face from the region's border [m].

        So far a contact may slip in any direction of the face and the grasp stays closed.  It is
        negative outside the region, and minus infinity everywhere when there is no region.
        """
        places = self.face.coordinates(points)
        return room_in(self.shape, places) if self else np.full(places.shape[:-1], -np.inf)

    def best_point(self) -> np.ndarray:
        """The point farthest from the border: centre of the largest circle inside; shape (3,) [m].

        Where circles of one size fit between parallel borders, it is the middle of their centres,
        which does not hang on rounding.

        Raises
        ------
        GraspError
            There is no region.
        """
        if not self:
            raise GraspError(f"no contact on {self.face.name} closes the grasp: {self.reason}")
        centres = [self.face.at(middle_of(piece)) for piece in self.shape.geoms]
        return centres[int(np.argmax([self.depth(centre) for centre in centres]))]

    def coefficients(self, point: Any) -> np.ndarray:
        """``W6^-1 w7`` of the last contact at a point (3,): minus the forces of the six, (6,).

        All are negative inside the region.

        Raises
        ------
        GraspError
            More than six contacts: their forces are not determined by the last one.
        """
        if self.contacts.count != 6:
            raise GraspError(
                f"the balance of {self.contacts.count} contacts with one more is not unique; it is "
                f"for six"
            )
        return self._cone.levels(point, -self.face.normal)

    def contact(self, point: Any) -> Contacts:
        """All contacts, with one more at a point (3,) of the region, projected onto the face.

        Raises
        ------
        GraspError
            The point is not in the region.
        """
        depth = float(self.depth(point))
        if not bool(self.contains(point)):
            raise GraspError(
                f"a contact at {np.asarray(point).tolist()} does not close the grasp: it is "
                f"{-depth:.4g} m outside the region on {self.face.name}"
                if self
                else f"no contact on {self.face.name} closes the grasp: {self.reason}"
            )
        at = self.face.at(self.face.coordinates(point))
        return self.contacts.joined(Contacts.along([at], [-self.face.normal]))


def seventh_contact_region(
    contacts: Contacts | HeldByContacts,
    face: Face | Any,
    method: Literal["inverse", "moments"] = "inverse",
) -> ContactRegion:
    """The part of a face where one more contact makes the grasp form-closed.

    Parameters
    ----------
    contacts : Contacts, or a grasp
        At least six contacts in space with wrenches of rank 6.
    face : Face, or array-like, shape (K, 3)
        The face, or its corners counter-clockwise as seen from outside.  It need not be convex and
        may have holes.
    method : {"inverse", "moments"}
        By the facets of the cone of wrenches (eq. 2.3 of the thesis, any number of contacts), or by
        forces that balance and their moments (eq. 2.4, up to twelve contacts).  They agree; the
        second refuses normals that are nearly, but not quite, parallel or in one plane.

    Returns
    -------
    ContactRegion

    Raises
    ------
    GraspError
        Contacts of a rank below 6; a face that is none; an unknown method, or one that does not
        take these contacts.
    """
    contacts, plane = as_contacts(contacts), as_face(face)
    cone = wrench_cone(contacts)
    rows = _rows(cone, plane, method)
    y0, unit = plane.coordinates(plane.centre), contacts.length
    values = rows[:, :2] @ (plane.outline - y0).T / unit - rows[:, 2:]  # (F, K) at the corners
    largest, room = np.abs(values).max(axis=1), _rounding_room(contacts, plane)
    somewhere = np.all(values.min(axis=1) < -room)
    rows[:, 2] -= np.where(largest < LEVEL * room, room, 0.0)
    proper = (np.ptp(values, axis=1) > FAR_BORDER * largest) & (largest > room)
    lines = rows[proper] / np.linalg.norm(rows[proper, :2], axis=1)[:, None] * [1.0, 1.0, unit]
    outlines, holes = cut_face(plane, lines, y0) if somewhere else ((), ())
    half_planes = distinct(lines / [1.0, 1.0, unit]) * [1.0, 1.0, unit]
    half_planes[:, 2] += half_planes[:, :2] @ y0
    return ContactRegion(contacts, plane, half_planes, outlines, holes, _reason(cone, outlines))


def region_of(contacts: Contacts, number: int, face: Face | Any) -> ContactRegion | None:
    """Where on its face one contact of a grasp may be while all others stay as they are.

    Parameters
    ----------
    contacts : Contacts
        All of them.
    number : int
        The one that moves, counted from 0.
    face : Face, or array-like, shape (K, 3)
        The face that it is on.

    Returns
    -------
    ContactRegion or None
        None where the others are dependent, or nearly: wherever it is, it cannot close the grasp.
    """
    plane = as_face(face)
    remaining = [j for j in range(contacts.count) if j != number]
    try:
        return seventh_contact_region(contacts.subset(remaining), plane)
    except GraspError:  # a rank below 6, or a cone too flat to have an inside
        return None


def _rows(cone: WrenchCone, plane: Face, method: str) -> np.ndarray:
    """Half-planes ``a . (y - y0) / length < b`` of facets of unit length, about the centre y0."""
    if method == "inverse":
        e, (u, v) = -plane.normal, plane.frame[:3, :2].T
        level = cone.levels(plane.centre, e)
        slope = [cone.facets[:, 3:] @ np.cross(along, e) for along in (u, v)]
        sizes = np.linalg.norm(cone.facets, axis=1)
        return np.column_stack([*slope, -level]) / sizes[:, None]
    if method == "moments":
        half_planes = moment_half_planes(cone.contacts, plane)
        return np.array([[0.0, 0.0, -1.0]]) if half_planes is None else half_planes
    raise GraspError(f'method {method!r} is unknown; methods are "inverse" and "moments"')


def _rounding_room(contacts: Contacts, plane: Face) -> float:
    """The tolerance of zero for the longest wrench of a unit push on the face."""
    offsets = plane.outline - plane.coordinates(contacts.centre)
    reach = float(np.linalg.norm(offsets, axis=1).max()) / contacts.length
    return strictness(contacts, plane.vertices) * float(np.hypot(1.0, reach))


def _reason(cone: WrenchCone, outlines: tuple[np.ndarray, ...]) -> str:
    if cone.closed:
        return "the contacts give form closure already, so that one more may be anywhere"
    if not outlines:
        return (
            "whatever its place there, the given contacts cannot balance its push with positive "
            "forces; try another face or move a contact"
        )
    return ""
