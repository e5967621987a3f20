r"""Where on a face the last contact closes the grasp: a polygon, exactly.

Given at least six contacts whose wrenches have rank 6, one more contact at p on a plane face with
the inward normal :math:`e_7` gives form closure when its wrench is on the outer side of all facets
of the cone of the others (see `wrench_cone`),

.. math::
    n_f \cdot \begin{bmatrix} e_7 \\ p \times e_7 \end{bmatrix} < 0 \quad \text{for all } f .

The wrench is affine in p, so that each facet leaves a half-plane of the face.  For six contacts the
:math:`n_f` are the rows of :math:`W_6^{-1}` (thesis, eq. 2.3).  The polygon is what the half-planes
leave of the face; its border is not in the region.  The same region follows from the moments of the
contacts (eq. 2.4), by other arithmetic: ``method="moments"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face import Face, as_face
from multiarm.grasp.moment_region import moment_half_planes
from multiarm.grasp.wrench_cone import wrench_cone

if TYPE_CHECKING:
    from shapely.geometry import MultiPolygon, Polygon

# A half-plane whose border is farther away than 1 / FAR_BORDER face sizes holds everywhere or
# nowhere on the face; where its level is no larger than this either, it is not strictly negative.
FAR_BORDER = 1e-12
# A region below this part of its face's area is empty: no finger could be placed on it.
NO_AREA = 1e-12
# Corners of a region closer than this, in face sizes, are one.
SAME_CORNER = 1e-12
# How well the middle of a region is found, in sizes of the region.
MIDDLE = 1e-4


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
        Why the region is empty, or what is special about it; often nothing.
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

        The border is as wide as the rounding of face coordinates, 1e-12 of the largest.
        """
        y = self.face.coordinates(points)
        if not self:
            return np.zeros(y.shape[:-1], dtype=bool)
        border = SAME_CORNER * float(np.abs(self.face.outline).max())  # rounding of y
        inside = np.all(y @ self.half_planes[:, :2].T < self.half_planes[:, 2] - border, axis=-1)
        return inside & self.face.contains(points)

    def depth(self, points: Any) -> np.ndarray:
        """Distance (...) of points (..., 3) of the face from the region's border [m].

        So far a contact may slip in any direction of the face and the grasp stays closed.  It is
        negative outside the region, and minus infinity everywhere when there is no region.
        """
        import shapely

        at = shapely.points(self.face.coordinates(points))
        if not self:
            return np.full(np.shape(at), -np.inf)
        away = shapely.distance(self.shape.boundary, at)
        return np.where(shapely.contains(self.shape, at), away, -away)

    def best_point(self) -> np.ndarray:
        """The point farthest from the border: centre of the largest circle inside; shape (3,) [m].

        Raises
        ------
        GraspError
            There is no region.
        """
        import shapely

        if not self:
            raise GraspError(f"no contact on {self.face.name} closes the grasp: {self.reason}")
        centres = []
        for k, piece in enumerate(self.shape.geoms):
            size = float(np.ptp(self.outlines[k], axis=0).max())
            circle = shapely.maximum_inscribed_circle(piece, tolerance=MIDDLE * size)
            centres.append(self.face.at(circle.coords[0]))
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
        return wrench_cone(self.contacts).levels(point, -self.face.normal)

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
    contacts: Contacts, face: Face | Any, method: Literal["inverse", "moments"] = "inverse"
) -> ContactRegion:
    """The part of a face where one more contact makes the grasp form-closed.

    Parameters
    ----------
    contacts : Contacts
        At least six contacts in space with wrenches of rank 6.
    face : Face, or array-like, shape (K, 3)
        The face, or its corners counter-clockwise as seen from outside.  It need not be convex and
        may have holes.
    method : {"inverse", "moments"}
        By the facets of the cone of wrenches (eq. 2.3 of the thesis, any number of contacts), or by
        forces that balance and their moments (eq. 2.4, up to twelve contacts).  They agree.

    Returns
    -------
    ContactRegion

    Raises
    ------
    GraspError
        Contacts of a rank below 6; a face that is none; an unknown method.
    """
    plane = as_face(face)
    cone = wrench_cone(contacts)
    y0, unit = plane.coordinates(plane.centre), contacts.length
    if method == "inverse":
        e, (u, v) = -plane.normal, plane.frame[:3, :2].T
        level = cone.levels(plane.centre, e)  # at the centre of the face
        slope = [cone.facets[:, 3:] @ np.cross(along, e) for along in (u, v)]
        rows = np.column_stack([*slope, -level])
        rows /= np.linalg.norm(cone.facets, axis=1)[:, None]
    elif method == "moments":
        found = moment_half_planes(contacts, plane)
        rows = np.array([[0.0, 0.0, -1.0]]) if found is None else found
    else:
        raise GraspError(f'method {method!r} is unknown; methods are "inverse" and "moments"')
    outlines, holes = _cut(plane, rows * [1.0, 1.0, unit], y0)
    lengths = np.linalg.norm(rows[:, :2], axis=1)
    proper = lengths > FAR_BORDER
    half_planes = _distinct(rows[proper] / lengths[proper, None]) * [1.0, 1.0, unit]
    half_planes[:, 2] += half_planes[:, :2] @ y0
    return ContactRegion(contacts, plane, half_planes, outlines, holes, _reason(cone, outlines))


def _distinct(rows: np.ndarray) -> np.ndarray:
    """Rows that differ by more than rounding, in their order."""
    return rows[np.sort(np.unique(rows.round(9) + 0.0, axis=0, return_index=True)[1])]


Pieces = tuple[tuple[np.ndarray, ...], tuple[tuple[np.ndarray, ...], ...]]


def _cut(face: Face, rows: np.ndarray, y0: np.ndarray) -> Pieces:
    """What the half-planes, about y0, leave of a face: outlines and holes in face coordinates."""
    own = face.outline - y0
    size = float(np.ptp(own, axis=0).max())
    slopes = np.linalg.norm(rows[:, :2], axis=1) * size
    constant = slopes <= FAR_BORDER * np.abs(rows[:, 2]).max(initial=size)
    if np.any(rows[constant, 2] <= FAR_BORDER * size):
        return (), ()
    low, high = own.min(axis=0), own.max(axis=0)
    polygon = own if face.convex else _rectangle(low - size, high + size)
    for row in rows[~constant] / slopes[~constant, None] * size:
        polygon = _clipped(polygon, row, SAME_CORNER * size)
    if not _area(polygon) > NO_AREA * face.area:
        return (), ()
    if face.convex:
        return (polygon + y0,), ((),)
    return _pieces(face, polygon, y0)


def _clipped(polygon: np.ndarray, row: np.ndarray, same: float) -> np.ndarray:
    """The part (K, 2) of a convex polygon with ``a . y <= b``, without corners that coincide."""
    if not len(polygon):
        return polygon
    over = polygon @ row[:2] - row[2]
    over[np.abs(over) <= same] = 0.0
    kept: list[np.ndarray] = []
    for k in range(len(polygon)):
        a, b = over[k - 1], over[k]
        if (a < 0.0 < b) or (b < 0.0 < a):
            kept.append(polygon[k - 1] + a / (a - b) * (polygon[k] - polygon[k - 1]))
        if b <= 0.0:
            kept.append(polygon[k])
    apart = [p for k, p in enumerate(kept) if np.abs(p - kept[k - 1]).max() > same]
    return np.array(apart).reshape(-1, 2)


def _pieces(face: Face, polygon: np.ndarray, y0: np.ndarray) -> Pieces:
    """A convex polygon about y0 cut with a face that is not convex; the largest piece first."""
    from shapely.affinity import translate
    from shapely.geometry import Polygon
    from shapely.geometry.polygon import orient

    shape = translate(face.shape, -y0[0], -y0[1]).intersection(Polygon(polygon))
    pieces = [orient(piece) for piece in getattr(shape, "geoms", [shape]) if _usable(piece, face)]
    pieces.sort(key=lambda piece: -piece.area)
    outlines = tuple(_corners(piece.exterior.coords) + y0 for piece in pieces)
    holes = tuple(tuple(_corners(hole.coords) + y0 for hole in p.interiors) for p in pieces)
    return outlines, holes


def _usable(piece: Polygon, face: Face) -> bool:
    return bool(piece.geom_type == "Polygon" and piece.area > NO_AREA * face.area)


def _corners(ring: Sequence[Any]) -> np.ndarray:
    return np.array(ring)[:-1, :2]


def _rectangle(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _area(polygon: np.ndarray) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon.mean(axis=0)).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _reason(cone: Any, outlines: tuple[np.ndarray, ...]) -> str:
    if cone.closed:
        return "the contacts give form closure already, so that one more may be anywhere"
    if not outlines:
        return (
            "whatever its place there, the given contacts cannot balance its push with positive "
            "forces; try another face or move a contact"
        )
    return ""
