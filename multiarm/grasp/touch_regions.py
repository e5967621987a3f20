r"""Where the fingertips of a small gripper may touch a body.

A gripper sits at a place, as a rule a corner of the body; its fingertips reach so far from there.
On a face they touch a plane region: the face, less a rim along its edges as wide as the tip needs,
cut by the disc in which the ball of reach meets the face's plane. Regions are kept convex: a face
that is not is cut into triangles.

A disc is no polygon. Placements stay in an inscribed polygon of 32 sides, bounds are taken over the
circumscribed one, which is larger by half a per cent; so a bound holds for the disc itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError

if TYPE_CHECKING:
    from shapely.geometry import Polygon

    from multiarm.grasp.face import Face
    from multiarm.grasp.polyhedron import Polyhedron

# Sides of the polygons that stand for a disc.
SIDES = 32
# Regions with less area than this part of the squared reach are points or lines: left out.
SMALLEST = 1e-6


@dataclass(frozen=True, eq=False)
class TouchRegion:
    """A convex plane region that one gripper can touch.

    Attributes
    ----------
    place : int
        Number of the place where the gripper sits.
    face : int
        Number of the face.
    normal : ndarray, shape (3,)
        Into the body.
    inner : ndarray, shape (V, 3)
        Corners of the region that placements are taken from [m].
    outer : ndarray, shape (V, 3)
        Corners of the region that bounds are taken over; it contains all that can be touched [m].
    """

    place: int
    face: int
    normal: np.ndarray
    inner: np.ndarray
    outer: np.ndarray


def touch_regions(
    body: Polyhedron,
    places: np.ndarray,
    reach: float,
    *,
    clearance: float = 0.0,
    faces: Iterable[int] | dict[int, Any] | None = None,
) -> list[list[TouchRegion]]:
    """Regions of each place, a list for each.

    Parameters
    ----------
    body : Polyhedron
    places : ndarray, shape (M, 3)
        Where grippers may sit [m].
    reach : float
        Distance from the place to its fingertips, at most [m].
    clearance : float
        Distance of fingertips from the edges of faces, at least [m].
    faces : iterable of int, or dict, optional
        Faces that may be touched; a dict also says where: corners (K, 3) of a polygon in the face,
        or None for all of it.

    Raises
    ------
    GraspError
        A face that the body has not, a polygon that is not one.
    """
    shapes = _shapes(body, clearance, faces)
    return [
        [
            region
            for number, shape in shapes.items()
            for region in _regions(body.faces[number], number, shape, index, place, reach)
        ]
        for index, place in enumerate(places)
    ]


def _shapes(
    body: Polyhedron, clearance: float, faces: Iterable[int] | dict[int, Any] | None
) -> dict[int, Polygon]:
    """The part of each face that may be touched, in face coordinates."""
    from shapely.geometry import Polygon

    allowed = faces if isinstance(faces, dict) else dict.fromkeys(_numbers(body, faces))
    shapes = {}
    for number, corners in allowed.items():
        if not 0 <= number < len(body.faces):
            raise GraspError(f"the body has faces 0 to {len(body.faces) - 1}, not {number}")
        face = body.faces[number]
        shape = face.shape.buffer(-clearance, join_style="mitre") if clearance else face.shape
        if corners is not None:
            given = np.asarray(corners, dtype=float)
            if given.ndim != 2 or given.shape[1] != 3 or len(given) < 3:
                raise GraspError(f"face {number}: the part to be touched has corners (K, 3)")
            part = Polygon(face.coordinates(given))
            if not part.is_valid:
                raise GraspError(f"face {number}: the corners do not go round a polygon")
            shape = shape.intersection(part)
        shapes[number] = shape
    return shapes


def _numbers(body: Polyhedron, faces: Iterable[int] | None) -> list[int]:
    return list(range(len(body.faces))) if faces is None else sorted(set(faces))


def _regions(
    face: Face, number: int, shape: Polygon, index: int, place: np.ndarray, reach: float
) -> list[TouchRegion]:
    """The parts of one face within reach of one place."""
    from shapely.geometry import Polygon

    height = float(face.normal @ place) - face.offset
    if abs(height) >= reach:
        return []
    radius = float(np.sqrt(reach**2 - height**2)) if np.isfinite(reach) else np.inf
    if not np.isfinite(radius):
        return [_region(face, number, index, piece, piece) for piece in _convex(shape, 1.0)]
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    middle = face.coordinates(place)
    around = Polygon(middle + radius / np.cos(np.pi / SIDES) * circle)
    found = []
    for piece in _convex(shape.intersection(around), reach):
        inner = Polygon(piece).intersection(Polygon(middle + radius * circle))
        if inner.area > SMALLEST * reach**2:
            found.append(_region(face, number, index, _ring(inner), piece))
    return found


def _region(
    face: Face, number: int, index: int, inner: np.ndarray, outer: np.ndarray
) -> TouchRegion:
    return TouchRegion(index, number, -face.normal, face.at(inner), face.at(outer))


def _convex(shape: Any, reach: float) -> list[np.ndarray]:
    """Convex pieces (V, 2) of a region of any form; triangles where it is not convex."""
    import shapely

    pieces = []
    for part in getattr(shape, "geoms", [shape]):
        if part.geom_type != "Polygon" or not part.area > SMALLEST * reach**2:
            continue
        hull = part.convex_hull
        if hull.area <= part.area * (1.0 + 1e-9):
            pieces.append(_ring(hull))
            continue
        triangles = shapely.constrained_delaunay_triangles(part).geoms
        pieces.extend(_ring(t) for t in triangles if t.area > SMALLEST * reach**2)
    return pieces


def _ring(polygon: Polygon) -> np.ndarray:
    """Corners once, counter-clockwise."""
    from shapely.geometry.polygon import orient

    return np.array(orient(polygon.convex_hull).exterior.coords)[:-1]
