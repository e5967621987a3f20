r"""Plane faces: their own coordinates, and what half-planes leave of them.

A face with the outward unit normal n is a part of the plane

.. math::  n \cdot x = h

bounded by a loop of corners that runs counter-clockwise as seen from outside, and by loops around
holes that run clockwise, so that the material is always on the left.  Area and normal follow from
the loops alone (Newell): :math:`2 A n = \sum_k v_k \times v_{k+1}`.

A contact on the face pushes along :math:`e = -n`.  Its moment about the origin depends on where the
contact is in the face and not on h, :math:`p \times e = c \times e` with the offset c from the
origin's projection onto the face (thesis, A.3).  Face coordinates therefore start at that
projection: (x, y) of a contact is its offset c, and on a horizontal top x and y are the body's own.

**Cutting.**  A convex face is cut by one half-plane :math:`a \cdot y \le b` after the other, in
coordinates about a point in the middle of the face: corners on the far side go, and where an edge
crosses the line a corner is added.  Of any other face a rectangle around it is cut so, which has
few corners, and then cut with the face by shapely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.geometry.poses import pose_matrix
from multiarm.grasp.arguments import numbers_of

if TYPE_CHECKING:
    from shapely.geometry import MultiPolygon, Polygon

# Corners of one face may be off their plane by this part of the largest distance between them: the
# rounding of coordinates to single precision, as files hold them, with room for some digits.
PLANE_TOLERANCE = 1e-6
# Or by this many roundings of a coordinate: a small face far from the origin has coarse corners.
OFF_PLANE = 8.0
# A face steeper than this has its y axis up; a flatter one has its x axis along the body's.
STEEP = 0.9


@dataclass(frozen=True, eq=False)
class Face:
    """A plane face of a body, in the body's frame.

    Parameters
    ----------
    vertices : array-like, shape (K, 3)
        Its corners [m], counter-clockwise as seen from outside.
    holes : sequence of array-like, shape (H, 3)
        Corners of holes, clockwise as seen from outside.
    name : str
        Its name in messages and figures.
    rounding : float
        Coordinates of the corners may be off by this [m].

    Raises
    ------
    GraspError
        Fewer than three corners, corners in a line, or corners that are not in one plane.
    """

    vertices: np.ndarray
    holes: tuple[np.ndarray, ...] = ()
    name: str = "the face"
    rounding: float = 0.0

    def __post_init__(self) -> None:
        loops = [_loop(loop, self.name) for loop in (self.vertices, *self.holes)]
        object.__setattr__(self, "vertices", loops[0])
        object.__setattr__(self, "holes", tuple(loops[1:]))
        spread = float(np.ptp(loops[0], axis=0).max())
        if not np.linalg.norm(self._area_vector) > 1e-12 * spread**2:
            raise GraspError(f"{self.name}: its corners lie in a line, they bound no area")
        off = max(float(np.abs((loop - self.centre) @ self.normal).max()) for loop in loops)
        if off > max(PLANE_TOLERANCE * spread, OFF_PLANE * self.rounding):
            raise GraspError(
                f"{self.name}: its corners are up to {off:.3g} m out of one plane; split it into "
                f"plane faces"
            )

    @cached_property
    def _area_vector(self) -> np.ndarray:
        middle = self.vertices.mean(axis=0)
        return np.add.reduce([area_vector(loop - middle) for loop in (self.vertices, *self.holes)])

    @cached_property
    def normal(self) -> np.ndarray:
        """Outward unit normal n, shape (3,)."""
        return _fixed(self._area_vector / np.linalg.norm(self._area_vector))

    @cached_property
    def centre(self) -> np.ndarray:
        """Mean of the outer corners, shape (3,) [m]."""
        return _fixed(self.vertices.mean(axis=0))

    @property
    def offset(self) -> float:
        """``h`` with ``n . x = h`` on the face [m]."""
        return float(self.normal @ self.centre)

    @property
    def area(self) -> float:
        """Area without the holes [m^2]."""
        return float(np.linalg.norm(self._area_vector))

    @property
    def tilt(self) -> float:
        """Angle by which the normal may be off: the rounding over the width of the face [rad]."""
        return self.rounding * float(np.ptp(self.vertices, axis=0).max()) / self.area

    @cached_property
    def frame(self) -> np.ndarray:
        """Pose of the face coordinates in the body's frame, shape (4, 4).

        z is the outward normal, the origin is the projection of the body's origin.  A flat face
        (:math:`|n_z| > 0.9`) has its x axis along the body's; any other has its y axis up, so that
        it is seen upright from outside.
        """
        n = self.normal
        along = np.eye(3)[0] if abs(n[2]) > STEEP else np.array([-n[1], n[0], 0.0])
        return _fixed(frame_of(n, along, self.offset * n))

    def coordinates(self, points: Any) -> np.ndarray:
        """Face coordinates (..., 2) of points (..., 3), which are projected along the normal.

        Raises
        ------
        GraspError
            Something else than finite points of three coordinates.
        """
        at = numbers_of(points, "points are finite, of shape (..., 3)", (..., 3))
        return (at - self.frame[:3, 3]) @ self.frame[:3, :2]

    def at(self, coordinates: Any) -> np.ndarray:
        """Points (..., 3) of the plane with the face coordinates (..., 2)."""
        return np.asarray(coordinates, dtype=float) @ self.frame[:3, :2].T + self.frame[:3, 3]

    @cached_property
    def outline(self) -> np.ndarray:
        """The outer corners in face coordinates, shape (K, 2), counter-clockwise [m]."""
        return _fixed(self.coordinates(self.vertices))

    @cached_property
    def convex(self) -> bool:
        """Whether the face is convex and has no hole; corners in the middle of an edge are fine."""
        along = np.roll(self.outline, -1, axis=0) - self.outline
        into = np.roll(along, -1, axis=0)
        turn = along[:, 0] * into[:, 1] - along[:, 1] * into[:, 0]
        steps = np.linalg.norm(along, axis=1) * np.linalg.norm(into, axis=1)
        angles = np.arctan2(turn, np.sum(along * into, axis=1))
        once = abs(float(angles.sum()) - 2.0 * np.pi) < 1.0
        return not self.holes and once and bool(np.all(turn >= -PLANE_TOLERANCE * steps))

    @cached_property
    def shape(self) -> Polygon | MultiPolygon:
        """The face as a polygon of shapely, in face coordinates; several where it is pinched.

        Raises
        ------
        GraspError
            An outline that crosses itself.
        """
        from shapely import make_valid
        from shapely.geometry import Polygon

        polygon = Polygon(self.outline, [self.coordinates(hole) for hole in self.holes])
        if polygon.is_valid:
            return polygon
        parted = make_valid(polygon, method="structure")
        if abs(parted.area - self.area) > PLANE_TOLERANCE * self.area:
            raise GraspError(f"{self.name}: its outline crosses itself; list its corners in order")
        return parted

    def room(self, points: Any) -> np.ndarray:
        """Distance of points (..., 3) from the nearest edge [m], negative when not on the face.

        Points are projected along the normal first.
        """
        return room_in(self.shape, self.coordinates(points))

    def contains(self, points: Any) -> np.ndarray:
        """Which of the points (..., 3), projected along the normal, are inside the face."""
        return self.room(points) > 0.0

    def room_along(self, start: np.ndarray, direction: np.ndarray) -> float:
        """How far a point of the face may move in a direction of unit length until an edge [m]."""
        from shapely.geometry import LineString, Point

        p = self.coordinates(start)
        far = p + 2.0 * self.shape.length * (self.coordinates(start + direction) - p)
        return float(self.shape.boundary.intersection(LineString([p, far])).distance(Point(p)))


def room_in(shape: Polygon | MultiPolygon, places: np.ndarray) -> np.ndarray:
    """Distance (...) of places (..., 2) from the edge of a plane shape [m], negative outside."""
    import shapely

    at = shapely.points(places)
    away = shapely.distance(shape.boundary, at)
    return np.where(shapely.contains(shape, at), away, -away)


def cut_into_triangles(shape: Polygon | MultiPolygon) -> np.ndarray:
    """A plane shape cut into triangles at its corners, (T, 3, 2), each counter-clockwise."""
    import shapely

    pieces = shapely.constrained_delaunay_triangles(shape).geoms
    triangles = []
    for ring in (piece.exterior for piece in pieces):
        corners = np.array(ring.coords)[:3]
        triangles.append(corners if ring.is_ccw else corners[::-1])
    return np.array(triangles).reshape(-1, 3, 2)


def frame_of(z: np.ndarray, along: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Pose (4, 4) at a point with the z axis given, and x as nearly along a vector as can be."""
    x = along - (along @ z) * z
    x /= np.linalg.norm(x)
    return pose_matrix(np.column_stack([x, np.cross(z, x), z]), origin) + 0.0  # no -0


def across(z: np.ndarray) -> np.ndarray:
    """A unit vector across another, (3,): across the axis that it is least along, too."""
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    return x / np.linalg.norm(x)


def area_vector(loop: np.ndarray) -> np.ndarray:
    """Area of a closed loop (K, 3) times its unit normal, shape (3,)."""
    return 0.5 * np.cross(loop, np.roll(loop, -1, axis=0)).sum(axis=0)


def as_face(face: Face | Any) -> Face:
    """A face as it is, or the face with the corners (K, 3), counter-clockwise from outside."""
    return face if isinstance(face, Face) else Face(face)


def _loop(corners: Sequence[Any] | np.ndarray, name: str) -> np.ndarray:
    needed = f"{name}: a face needs three or more corners of three finite coordinates"
    return _fixed(numbers_of(corners, needed, (-3, 3)))


def _fixed(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


# --- A face cut by half-planes --------------------------------------------------------------------

# Pieces narrower than this part of the face's size are dropped: they may be rounding.
NO_WIDTH = 1e-9
# Corners closer than this, in face sizes, are the same.
SAME_CORNER = 1e-12
# Rows, with numbers of the size of 1, that agree to this many digits are equal.
DIGITS = 10

Pieces = tuple[tuple[np.ndarray, ...], tuple[tuple[np.ndarray, ...], ...]]


def cut_face(face: Face, half_planes: np.ndarray, middle: np.ndarray) -> Pieces:
    """Outlines and holes, in face coordinates, of a face cut by half-planes.

    Parameters
    ----------
    face : Face
    half_planes : ndarray, shape (F, 3)
        Rows (a_x, a_y, b) with ``a . (y - middle) <= b``, (a_x, a_y) of unit length [1, 1, m].
    middle : ndarray, shape (2,)
        Face coordinates of a point in the middle [m].
    """
    outline = face.outline - middle
    size = float(np.ptp(outline, axis=0).max())
    low, high = outline.min(axis=0), outline.max(axis=0)
    polygon = outline if face.convex else _rectangle(low - size, high + size)
    for row in half_planes:
        polygon = clipped(polygon, row, SAME_CORNER * size)
    if not len(polygon) or not _wide(_signed_area(polygon), polygon, size):
        return (), ()
    if face.convex:
        return (polygon + middle,), ((),)
    return _pieces(face, polygon, middle, size)


def distinct(rows: np.ndarray) -> np.ndarray:
    """Rows that differ by more than rounding, in their order."""
    return rows[np.sort(np.unique(rows.round(DIGITS) + 0.0, axis=0, return_index=True)[1])]


def clipped(polygon: np.ndarray, row: np.ndarray, same: float = 0.0) -> np.ndarray:
    """The part (K, 2) of a convex polygon with ``a . y <= b``, for a row (a_x, a_y, b).

    Corners closer than ``same`` become one.  Shapely's cuts do not join them, and a region would
    gain corners that differ by rounding where half-planes meet in one point.
    """
    if not len(polygon):
        return polygon
    over = polygon @ row[:2] - row[2]
    over[np.abs(over) <= same] = 0.0
    corners: list[np.ndarray] = []
    for k in range(len(polygon)):
        a, b = over[k - 1], over[k]
        if (a < 0.0 < b) or (b < 0.0 < a):
            corners.append(polygon[k - 1] + a / (a - b) * (polygon[k] - polygon[k - 1]))
        if b <= 0.0:
            corners.append(polygon[k])
    apart = [p for k, p in enumerate(corners) if np.abs(p - corners[k - 1]).max() > same]
    return np.array(apart).reshape(-1, 2)


def _pieces(face: Face, polygon: np.ndarray, y0: np.ndarray, size: float) -> Pieces:
    """A convex polygon about y0 cut with a face that is not convex; the largest piece first."""
    from shapely.affinity import translate
    from shapely.geometry import Polygon
    from shapely.geometry.polygon import orient

    shape = translate(face.shape, -y0[0], -y0[1]).intersection(Polygon(polygon))
    pieces = [
        orient(piece)
        for piece in getattr(shape, "geoms", [shape])
        if piece.geom_type == "Polygon" and _wide(piece.area, piece.exterior.coords, size)
    ]
    pieces.sort(key=lambda piece: -piece.area)
    outlines = tuple(_ring_corners(piece.exterior.coords) + y0 for piece in pieces)
    holes = tuple(tuple(_ring_corners(hole.coords) + y0 for hole in p.interiors) for p in pieces)
    return outlines, holes


def _wide(area: float, corners: Sequence[Any] | np.ndarray, size: float) -> bool:
    return area > NO_WIDTH * size * float(np.ptp(np.array(corners), axis=0).max())


def _ring_corners(ring: Sequence[Any]) -> np.ndarray:
    return np.array(ring)[:-1, :2]


def _rectangle(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _signed_area(polygon: np.ndarray) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon.mean(axis=0)).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
