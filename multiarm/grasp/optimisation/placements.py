r"""Placements of seven fingertips: regions that can be touched, choices of faces, coordinates.

A gripper sits at a place, as a rule a corner of the body; its fingertips reach so far from there.
On a face they touch a plane region: the face, less a rim along its edges as wide as the tip needs,
cut by the disc in which the ball of reach meets the face's plane. Regions are kept convex: a face
that is not is cut into triangles.

A disc is no polygon. Placements stay in an inscribed polygon of 32 sides, bounds are taken over the
circumscribed one, which is larger by half a per cent; so a bound holds for the disc itself.

**Choices of faces.**  A choice is a multiset of regions for each gripper, which its hand reaches
from one side (:mod:`multiarm.grasp.designs.grippers`). It can close only if the normals span space
positively, as wrenches that close do (:mod:`multiarm.grasp.closure.balances`); and no more
than three normals are parallel (thesis, 2.2.1: of seven contacts that close any six are
independent).

**Coordinates.**  A placement is seven pairs of face coordinates y, shape (7, 2), in units of the
body's size from the middle of each region. On a face the wrench is affine in them,

.. math:: w_i(y) = w_i^0 + \sum_a y_a w_i^a, \qquad w_i^a = \begin{bmatrix} 0 \\ t_a \times e_i
          \end{bmatrix},

moments about the middle of the body over its size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise, permutations
from math import comb
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of
from multiarm.grasp.body.face import across, cut_into_triangles
from multiarm.grasp.closure.balances import balance
from multiarm.grasp.contacts import wrenches_of
from multiarm.grasp.designs.grippers import hand_reaches

if TYPE_CHECKING:
    from shapely.geometry import Polygon

    from multiarm.grasp.body.face import Face
    from multiarm.grasp.body.polyhedron import Polyhedron

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

    numbers = range(len(body.faces)) if faces is None else faces
    if not isinstance(numbers, Iterable):
        raise GraspError(f"faces are the numbers of some, not {faces!r}")
    allowed = numbers if isinstance(numbers, dict) else dict.fromkeys(sorted(set(numbers)))
    shapes = {}
    for number, corners in allowed.items():
        if number not in range(len(body.faces)):
            raise GraspError(f"the body has faces 0 to {len(body.faces) - 1}, not {number!r}")
        face = body.faces[int(number)]
        shape = face.shape.buffer(-clearance, join_style="mitre") if clearance else face.shape
        if corners is not None:
            needed = f"face {number}: the part to be touched has corners (K, 3)"
            part = Polygon(face.coordinates(numbers_of(corners, needed, (-3, 3))))
            if not part.is_valid:
                raise GraspError(f"face {number}: the corners do not go round a polygon")
            shape = shape.intersection(part)
        shapes[number] = shape
    return shapes


def _regions(
    face: Face, number: int, shape: Polygon, index: int, place: np.ndarray, reach: float
) -> list[TouchRegion]:
    """The parts of one face within reach of one place."""
    from shapely.geometry import Polygon

    height = float(face.normal @ place) - face.offset
    if abs(height) >= reach:
        return []
    radius = float(np.sqrt(reach**2 - height**2))
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    middle = face.coordinates(place)
    around = Polygon(middle + radius / np.cos(np.pi / SIDES) * circle)
    reached = []
    for piece in _convex(shape.intersection(around), reach):
        inner = Polygon(piece).intersection(Polygon(middle + radius * circle))
        if inner.area > SMALLEST * reach**2:
            reached.append(_region(face, number, index, _ring(inner), piece))
    return reached


def _region(
    face: Face, number: int, index: int, inner: np.ndarray, outer: np.ndarray
) -> TouchRegion:
    return TouchRegion(index, number, -face.normal, face.at(inner), face.at(outer))


def _convex(shape: Any, reach: float) -> list[np.ndarray]:
    """Convex pieces (V, 2) of a region of any form; triangles where it is not convex."""
    from shapely.geometry import Polygon

    pieces = []
    for part in getattr(shape, "geoms", [shape]):
        if part.geom_type != "Polygon" or not part.area > SMALLEST * reach**2:
            continue
        hull = part.convex_hull
        if hull.area <= part.area * (1.0 + 1e-9):
            pieces.append(_ring(hull))
            continue
        triangles = map(Polygon, cut_into_triangles(part))
        pieces.extend(_ring(t) for t in triangles if t.area > SMALLEST * reach**2)
    return pieces


def _ring(polygon: Polygon) -> np.ndarray:
    """Corners once, counter-clockwise."""
    from shapely.geometry.polygon import orient

    return np.array(orient(polygon.convex_hull).exterior.coords)[:-1]


# --- Choices of faces that can close --------------------------------------------------------------

# Normals are parallel within this.
PARALLEL = 1e-9
# Most normals that may be parallel, either sense.
MOST_PARALLEL = 3
# Choices that are looked at one by one, at most.
MOST_CHOICES = 500_000


@dataclass(frozen=True, eq=False)
class FaceChoices:
    """Choices of seven regions that may close.

    Attributes
    ----------
    regions : list of TouchRegion
    numbers : ndarray, shape (K, 7)
        The regions of each choice, the first gripper's in front; in a fixed order.
    """

    regions: list[TouchRegion]
    numbers: np.ndarray

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, number: int) -> list[TouchRegion]:
        return [self.regions[k] for k in self.numbers[number]]


def face_choices(regions: Sequence[Sequence[TouchRegion]], fingers: tuple[int, int]) -> FaceChoices:
    """Choices of two places, and of regions there, from which seven contacts may close.

    Parameters
    ----------
    regions : sequence of sequences of TouchRegion
        Of each place.
    fingers : (int, int)
        Contacts of the first and of the second gripper.

    Raises
    ------
    GraspError
        There are too many of them.
    """
    flat = [region for at_place in regions for region in at_place]
    ends = np.cumsum([0, *map(len, regions)]).tolist()
    places = [range(*limits) for limits in pairwise(ends)]
    spanning = _OfFaces(flat, positively_spanning)
    pairs, total = [], 0
    for a, b in permutations(places, 2):
        if a and b and spanning([*a, *b]):
            pairs.append((a, b))
            total += _multisets(len(a), fingers[0]) * _multisets(len(b), fingers[1])
        if total > MOST_CHOICES:
            raise GraspError(
                f"there are more than {MOST_CHOICES:,} choices of faces, too many to bound them "
                f"all; smaller grippers, or named faces or places, leave fewer"
            )
    blocks = [_all_choices(a, b, fingers) for a, b in pairs]
    numbers = np.concatenate([np.zeros((0, 7), dtype=int), *blocks])
    numbers = numbers[_few_parallel(spanning.directions[numbers])]
    reachable = _OfFaces(flat, hand_reaches)
    for hand in (slice(0, fingers[0]), slice(fingers[0], 7)):
        numbers = numbers[reachable.of_rows(numbers[:, hand])]
    return FaceChoices(flat, numbers[spanning.of_rows(numbers)])


def positively_spanning(normals: np.ndarray) -> bool:
    """Whether nonnegative combinations of normals (K, 3) fill space: they span it and balance."""
    return len(normals) > 3 and balance(normals.T, 0.0).closed


def _multisets(size: int, count: int) -> int:
    return comb(size + count - 1, count)


def _all_choices(a: range, b: range, fingers: tuple[int, int]) -> np.ndarray:
    first, second = (
        np.array(list(combinations_with_replacement(place, count)))
        for place, count in zip((a, b), fingers, strict=True)
    )
    return np.hstack([np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))])


def _few_parallel(directions: np.ndarray) -> np.ndarray:
    """Whether each row (K, 7) has no more than ``MOST_PARALLEL`` of one direction, (K,)."""
    rows = np.sort(directions, axis=1)
    return np.all(rows[:, MOST_PARALLEL:] != rows[:, :-MOST_PARALLEL], axis=1)


class _OfFaces:
    """A property of the normals of a set of faces, computed once for each set."""

    def __init__(
        self, regions: Sequence[TouchRegion], question: Callable[[np.ndarray], bool]
    ) -> None:
        self.faces = np.array([region.face for region in regions], dtype=int)
        self.normals = {region.face: region.normal for region in regions}
        self.question = question
        self.answers: dict[frozenset[int], bool] = {}

    @property
    def directions(self) -> np.ndarray:
        """For each region the first face whose normal is parallel to its own, shape (R,)."""
        faces = np.array(list(self.normals), dtype=int)
        n = np.array(list(self.normals.values())).reshape(-1, 3)
        first = np.argmax(np.abs(n @ n.T) > 1.0 - PARALLEL, axis=1) if len(n) else faces
        place = np.zeros(faces.max(initial=-1) + 1, dtype=int)
        place[faces] = faces[first]
        return place[self.faces]

    def __call__(self, numbers: Sequence[int]) -> bool:
        return self._of(frozenset(self.faces[numbers].tolist()))

    def of_rows(self, numbers: np.ndarray) -> np.ndarray:
        """The answers for rows of regions (K, n), shape (K,)."""
        rows, which = np.unique(np.sort(self.faces[numbers], axis=1), axis=0, return_inverse=True)
        answers = np.array([self._of(frozenset(row)) for row in rows.tolist()], dtype=bool)
        return answers[which.reshape(-1)]

    def _of(self, faces: frozenset[int]) -> bool:
        if faces not in self.answers:
            self.answers[faces] = self.question(np.array([self.normals[k] for k in sorted(faces)]))
        return self.answers[faces]


# --- Seven touches in scaled coordinates ----------------------------------------------------------

# Points this part of the body's size outside a region still are in it.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class SevenTouches:
    """Regions of seven fingertips, in scaled coordinates.

    Attributes
    ----------
    regions : tuple of TouchRegion
    normals : ndarray, shape (7, 3)
        Into the body.
    middles : ndarray, shape (7, 3)
        Origins of the face coordinates, from the middle of the body over its size.
    tangents : ndarray, shape (7, 2, 3)
    base, rates : ndarray, shape (7, 6) and (7, 2, 6)
        ``w_i^0`` and ``w_i^a``.
    outer : tuple of ndarray, shape (V, 2)
        Corners of the outer regions, which contain all that can be touched.
    inner : tuple of ndarray, shape (V, 2)
        The inner regions, in which placements lie.
    sides, limits : ndarray, shape (7, H, 2) and (7, H)
        The inner regions as ``sides @ y <= limits``; filled up with rows that always hold.
    """

    regions: tuple[TouchRegion, ...]
    normals: np.ndarray
    middles: np.ndarray
    tangents: np.ndarray
    base: np.ndarray
    rates: np.ndarray
    outer: tuple[np.ndarray, ...]
    inner: tuple[np.ndarray, ...]
    sides: np.ndarray
    limits: np.ndarray

    def points(self, y: np.ndarray) -> np.ndarray:
        """Scaled points (..., 7, 3) of placements (..., 7, 2)."""
        return self.middles + np.einsum("...ia,iax->...ix", y, self.tangents)

    def wrenches(self, y: np.ndarray) -> np.ndarray:
        """Wrenches (..., 7, 6), one in a row."""
        return self.base + np.einsum("...ia,iaf->...if", y, self.rates)

    def towards(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """``end``, or where the way to it from ``start`` (inside) leaves the inner regions."""
        way = end - start
        speed = np.einsum("iha,...ia->...ih", self.sides, way)
        room = (self.limits - np.einsum("iha,...ia->...ih", self.sides, start)).clip(0.0)
        part = np.where(speed > 1e-300, room / np.maximum(speed, 1e-300), np.inf)
        return start + part.min(axis=-1).clip(0.0, 1.0)[..., None] * way

    def within(self, y: np.ndarray) -> np.ndarray:
        """Placements (..., 7, 2) drawn into the inner regions along the line to their middles."""
        return self.towards(np.zeros_like(y), y)

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random placements (count, 7, 2), more of them near the corners of the regions."""
        places = [rng.dirichlet(np.full(len(c), 0.5), count) @ c for c in self.inner]
        return np.stack(places, axis=1)


def seven_touches(regions: Sequence[TouchRegion], middle: np.ndarray, size: float) -> SevenTouches:
    """Scaled coordinates of seven regions of a body with this middle and size."""
    normals = np.array([region.normal for region in regions])
    middles = np.array([(region.inner.mean(axis=0) - middle) / size for region in regions])
    tangents = np.array([_tangents(e) for e in normals])
    flat = [
        tuple(
            ((corners - middle) / size - origin) @ t.T
            for corners, origin, t in zip(sets, middles, tangents, strict=True)
        )
        for sets in ([r.outer for r in regions], [r.inner for r in regions])
    ]
    sides, limits = _half_planes(flat[1])
    moments = np.cross(tangents, normals[:, None])
    return SevenTouches(
        regions=tuple(regions),
        normals=normals,
        middles=middles,
        tangents=tangents,
        base=wrenches_of(middles, normals).T,
        rates=np.concatenate([np.zeros_like(moments), moments], axis=2),
        outer=flat[0],
        inner=flat[1],
        sides=sides,
        limits=limits,
    )


def _sides_of(cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (H, 2) and levels (H,) of the sides of a counter-clockwise polygon."""
    along = np.roll(cell, -1, axis=0) - cell
    length = np.linalg.norm(along, axis=1)
    real = length > ROUNDING
    out = np.stack([along[real, 1], -along[real, 0]], axis=1) / length[real, None]
    return out, np.sum(out * cell[real], axis=1)


def _half_planes(polygons: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    rows = [_sides_of(polygon) for polygon in polygons]
    most = max(len(levels) for _, levels in rows)
    sides, limits = np.zeros((7, most, 2)), np.ones((7, most))
    for i, (out, levels) in enumerate(rows):
        sides[i, : len(out)], limits[i, : len(out)] = out, levels
    return sides, limits


def _tangents(e: np.ndarray) -> np.ndarray:
    """Axes in the face, so that polygons counter-clockwise from outside stay so."""
    first = across(e)
    return np.array([first, np.cross(-e, first)])
