"""Boundaries of polyhedra from a few numbers: boxes, prisms, wedges, pyramids, half-spaces, hulls.

A polygon may be given either way round; faces always come out with their normals outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.face import PLANE_TOLERANCE
from multiarm.grasp.solid import faces_of_triangles
from multiarm.scene.object import hull_triangles

AXIS_NAMES = ("+x", "+y", "+z", "-x", "-y", "-z")
# Corners are the same when they are closer than this part of the body's size: duals of half-spaces,
# and corners that several triples of half-spaces give.
SAME_CORNER = 1e-9


class Boundary(NamedTuple):
    """The arguments of a `Polyhedron`: corners, loops of their numbers for each face, names."""

    vertices: Any
    loops: Sequence[Sequence[Sequence[int]]]
    names: Sequence[str] | None = None


def box(lengths: Any) -> Boundary:
    """A block with full edge lengths, centred; faces +x, +y, +z, -x, -y, -z."""
    half = 0.5 * _positive(lengths, 3, "the edge lengths of a block")
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    loops = [(4, 6, 7, 5), (2, 3, 7, 6), (1, 5, 7, 3), (0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4)]
    return Boundary(signs * half, [[loop] for loop in loops], AXIS_NAMES)


def prism(polygon: Any, height: float) -> Boundary:
    """A polygon from z = -height / 2 to height / 2."""
    outline = _polygon(polygon)
    z = 0.5 * float(_positive([height], 1, "the height of a prism")[0])
    n = len(outline)
    vertices = [[*xy, -z] for xy in outline] + [[*xy, z] for xy in outline]
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    loops = [*sides, [n + k for k in range(n)], list(reversed(range(n)))]
    names = [*(f"side {k + 1}" for k in range(n)), "top", "bottom"]
    return Boundary(vertices, [[loop] for loop in loops], names)


def wedge(lengths: Any, top: float) -> Boundary:
    """A block whose top is cut down to the length ``top`` along x by a slope toward +x."""
    lx, ly, lz = _positive(lengths, 3, "the edge lengths of a wedge")
    if not 0.0 <= top < lx:
        raise GraspError(f"the top of a wedge is at least 0 and shorter than {lx:g} m, not {top!r}")
    section = [(-lx / 2, -lz / 2), (lx / 2, -lz / 2), (top - lx / 2, lz / 2)]
    section += [(-lx / 2, lz / 2)] if top else []
    n = len(section)
    vertices = [[x, -ly / 2, z] for x, z in section] + [[x, ly / 2, z] for x, z in section]
    around = [[(k + 1) % n, k, n + k, n + (k + 1) % n] for k in range(n)]
    loops = [*around, [n + k for k in reversed(range(n))], list(range(n))]
    names = ["-z", "slope", *(["+z"] if top else []), "-x", "+y", "-y"]
    return Boundary(vertices, [[loop] for loop in loops], names)


def pyramid(base: Any, apex: Any) -> Boundary:
    """A pyramid on a polygon in the plane z = 0."""
    outline = _polygon(base)
    top = np.array(apex, dtype=float)
    if top.shape != (3,) or not np.all(np.isfinite(top)) or top[2] == 0.0:
        raise GraspError(f"the apex of a pyramid is a point (x, y, z) with z not 0, not {apex!r}")
    if top[2] < 0.0:
        outline = outline[::-1]
    n = len(outline)
    vertices = [[x, y, 0.0] for x, y in outline] + [top.tolist()]
    loops = [*([k, (k + 1) % n, n] for k in range(n)), list(reversed(range(n)))]
    names = [*(f"side {k + 1}" for k in range(n)), "base"]
    return Boundary(vertices, [[loop] for loop in loops], names)


def hull(points: Any) -> Boundary:
    """The convex hull of points."""
    cloud = _finite(points, "the points of a hull")
    try:
        triangles = hull_triangles(cloud)
    except ValueError as error:
        raise GraspError(str(error)) from error
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    scaled = (cloud - middle) / np.ptp(cloud, axis=0).max()
    kept, numbers = np.unique(triangles, return_inverse=True)
    faces = faces_of_triangles(scaled[kept], numbers.reshape(triangles.shape), PLANE_TOLERANCE)
    return compacted(cloud[kept], faces)


def halfspaces(normals: Any, offsets: Any) -> Boundary:
    """All x with normals[k] . x <= offsets[k]; those that cut nothing, or no more, make no face."""
    directions = _finite(normals, "the normals of half-spaces")
    levels = np.array(offsets, dtype=float)
    lengths = np.linalg.norm(directions, axis=1)
    if levels.shape != (len(directions),) or not np.all(np.isfinite(levels)) or not lengths.all():
        raise GraspError(
            "half-spaces need one finite offset for each normal, and no normal is zero"
        )
    n, h = directions / lengths[:, None], levels / lengths
    inside = _deepest_point(n, h)
    corners = _cut_corners(n, h - n @ inside)
    size = float(np.ptp(corners, axis=0).max())
    faces: list[list[int]] = []
    for normal, level in zip(n, h - n @ inside, strict=True):
        on = np.flatnonzero(np.abs(corners @ normal - level) <= 1e2 * SAME_CORNER * size)
        # Two faces of a convex body have two corners in common at most.
        known = any(np.isin(on, face).sum() > 2 for face in faces)
        if len(on) > 2 and not known:
            faces.append(_around(corners, on, normal))
    return Boundary(corners + inside, [[face] for face in faces])


def _deepest_point(n: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Centre of the largest ball inside the half-spaces, shape (3,)."""
    from scipy.optimize import linprog

    unit = float(np.abs(h).max()) or 1.0
    A = np.column_stack([n, np.ones(len(n))])
    best = linprog([0, 0, 0, -1], A_ub=A, b_ub=h / unit, bounds=[(None, None)] * 3 + [(0, None)])
    if best.status == 3:
        raise GraspError("the half-spaces leave an unbounded body; add the faces that close it")
    if best.x is None or not best.x[3] > SAME_CORNER:
        raise GraspError("no point is inside all half-spaces: turn the normals outward")
    return best.x[:3] * unit


def _cut_corners(n: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Corners of the body {x: n x <= levels} around the origin, each once, shape (V, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    reach = float(levels.min())
    try:
        dual = ConvexHull(n / (levels[:, None] / reach))
    except QhullError as error:
        raise GraspError(
            "the half-spaces leave an unbounded body; add the missing faces"
        ) from error
    if np.any(dual.equations[:, 3] > -SAME_CORNER):
        raise GraspError("the half-spaces leave an unbounded body; add the faces that close it")
    triples = dual.simplices
    found = np.linalg.solve(n[triples], levels[triples][..., None])[..., 0]
    size = float(np.ptp(found, axis=0).max())
    kept: list[np.ndarray] = []
    for corner in found:
        if all(np.abs(corner - other).max() > 10.0 * SAME_CORNER * size for other in kept):
            kept.append(corner)
    return np.array(kept)


def _around(corners: np.ndarray, on: np.ndarray, normal: np.ndarray) -> list[int]:
    """Corners of a convex face in their order, counter-clockwise about its normal."""
    about = corners[on] - corners[on].mean(axis=0)
    x = about[0]
    angles = np.arctan2(about @ np.cross(normal, x), about @ x)
    return on[np.argsort(angles)].tolist()


def compacted(vertices: np.ndarray, faces: list[list[list[int]]]) -> Boundary:
    """The boundary of these faces, without unused corners."""
    used = sorted({v for face in faces for loop in face for v in loop})
    number = {v: k for k, v in enumerate(used)}
    loops = [[[number[v] for v in loop] for loop in face] for face in faces]
    return Boundary(vertices[used], loops)


def _polygon(corners: Any) -> np.ndarray:
    """A simple polygon (K, 2), counter-clockwise."""
    from shapely.geometry import Polygon

    try:
        outline = np.array(corners, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError("a polygon is a list of corners (x, y)") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise GraspError(
            f"a polygon has shape (K, 2) with three corners or more, not {outline.shape}"
        )
    shape = Polygon(outline) if np.all(np.isfinite(outline)) else Polygon()
    if not shape.is_valid or not shape.area > 0.0:
        raise GraspError("the polygon crosses itself or has no area; list its corners in order")
    return outline if shape.exterior.is_ccw else outline[::-1]


def _positive(values: Any, count: int, what: str) -> np.ndarray:
    try:
        numbers = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{what}: {count} positive numbers in metres, not {values!r}") from error
    if numbers.shape != (count,) or not np.all(np.isfinite(numbers) & (numbers > 0.0)):
        raise GraspError(f"{what}: {count} positive numbers in metres, not {values!r}")
    return numbers


def _finite(values: Any, what: str) -> np.ndarray:
    try:
        table = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{what} are rows of three numbers") from error
    if table.ndim != 2 or table.shape[1] != 3 or len(table) < 4 or not np.all(np.isfinite(table)):
        raise GraspError(
            f"{what} are four or more rows of three finite numbers, not of shape {table.shape}"
        )
    return table
