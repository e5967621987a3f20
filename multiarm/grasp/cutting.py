r"""A face cut by half-planes: one polygon, or several pieces of a face that is not convex.

A convex face is cut by one half-plane :math:`a \cdot y \le b` after the other, in coordinates about
a point in the middle of the face: corners on the far side go, and where an edge crosses the line a
corner is added.  Of any other face a rectangle around it is cut so, which has few corners, and then
cut with the face by shapely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.grasp.face import Face

if TYPE_CHECKING:
    from shapely.geometry import Polygon

# Pieces below this part of the face's area are dropped: no finger could be placed on them.
NO_AREA = 1e-9
# Corners closer than this, in face sizes, are one.
SAME_CORNER = 1e-12
# Rows of numbers of the size of 1 that agree to so many digits are one.
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
    own = face.outline - middle
    size = float(np.ptp(own, axis=0).max())
    low, high = own.min(axis=0), own.max(axis=0)
    polygon = own if face.convex else _rectangle(low - size, high + size)
    for row in half_planes:
        polygon = _clipped(polygon, row, SAME_CORNER * size)
    if not _area(polygon) > NO_AREA * face.area:
        return (), ()
    if face.convex:
        return (polygon + middle,), ((),)
    return _pieces(face, polygon, middle)


def distinct(rows: np.ndarray) -> np.ndarray:
    """Rows that differ by more than rounding, in their order."""
    return rows[np.sort(np.unique(rows.round(DIGITS) + 0.0, axis=0, return_index=True)[1])]


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
