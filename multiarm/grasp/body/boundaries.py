r"""Boundaries of solids: hulls, half-spaces, triangles, files; and the check of one.

**One solid.**  Loops bound a solid when each edge is run along once in each direction: once by the
face on its left and once by the face on its right.  A missing partner is an open edge; a second run
in one direction means that faces are turned the wrong way round or that more than two of them share
the edge.

**Faces from triangles** by growing: the largest triangle that is left spreads over its neighbours
as long as their corners stay near its plane; the plane is then fitted to all of them, and they grow
once more, until nothing changes.  A small triangle thus does not decide for a large face.

**Mesh files.**  A mesh file holds triangles, often with separate corners and in single precision.
Corners that coincide within that precision are merged; triangles in one plane are one face.  A
result that is not a closed surface with its normals outward is an error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import number_of, numbers_of
from multiarm.grasp.body.deepest import largest_ball
from multiarm.grasp.body.face import PLANE_TOLERANCE, Face, area_vector, cut_into_triangles
from multiarm.notation import count_of
from multiarm.scene import meshes
from multiarm.scene.solids import TOO_THIN, hull_triangles, moments

# A body of half-spaces is bounded when the origin is inside the hull of their duals by more than
# this; it has a ball inside that is larger.
INSIDE = 1e-9
# Faces of triangles are grown within this many roundings of a plane: they add up.
GROWN = 4.0

Loops = list[list[list[int]]]
"""For each face, loops of the numbers of its corners."""


class Boundary(NamedTuple):
    """What a `Polyhedron` is made of."""

    vertices: np.ndarray
    loops: Loops
    names: list[str] | None
    rounding: float


def hull(points: Any) -> Boundary:
    """The convex hull of points."""
    cloud = numbers_of(points, "a hull is of four or more rows of three finite numbers", (-4, 3))
    try:
        triangles = hull_triangles(cloud)
    except ValueError as error:
        raise GraspError(str(error)) from error
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    size = float(np.ptp(cloud, axis=0).max())
    scaled = (cloud - middle) / size
    used, numbers = np.unique(triangles, return_inverse=True)
    faces = faces_of_triangles(scaled[used], numbers.reshape(triangles.shape), PLANE_TOLERANCE)
    return Boundary(*_compacted(cloud[used], faces), None, PLANE_TOLERANCE * size / GROWN)


def halfspaces(normals: Any, offsets: Any) -> Boundary:
    """All x with normals[k] . x <= offsets[k]; those that cut nothing, or no more, make no face."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    needed = "half-spaces need four or more normals of three finite numbers"
    directions = numbers_of(normals, needed, (-4, 3))
    needed = "half-spaces need one finite offset for each normal"
    levels = numbers_of(offsets, needed, (len(directions),))
    lengths = np.linalg.norm(directions, axis=1)
    if not lengths.all():
        raise GraspError("half-spaces have directions: no normal is zero")
    n, h = directions / lengths[:, None], levels / lengths
    inside = _centre_of_largest_ball(n, h)
    depths = h - n @ inside
    reach = float(depths.min())
    try:
        cut = HalfspaceIntersection(np.column_stack([n, -depths / reach]), np.zeros(3))
        bounded = bool(np.all(cut.dual_equations[:, 3] < -INSIDE))
    except QhullError:
        bounded = False
    if not bounded:
        raise GraspError("the half-spaces leave an unbounded body; add the faces that close it")
    corners = [np.linalg.lstsq(n[k], depths[k], rcond=None)[0] for k in cut.dual_facets]
    vertices, faces, _, rounding = hull(corners)
    areas = np.array([area_vector(vertices[face[0]]) for face in faces])
    seen = areas @ n.T / np.linalg.norm(areas, axis=1)[:, None]
    numbers = seen.argmax(axis=1)
    order = np.argsort(numbers, kind="stable")
    names = [f"face {number}" for number in numbers[order]]
    return Boundary(vertices + inside, [faces[k] for k in order], names, rounding)


def _centre_of_largest_ball(n: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Centre of the largest ball inside the half-spaces, shape (3,).

    Far from the origin the first one is rough; the second is solved for about it.
    """
    inside, radius = np.zeros(3), 0.0
    for _ in range(2):
        levels = h - n @ inside
        unit = float(np.abs(levels).max()) or 1.0
        best = largest_ball(n, levels / unit)
        if best.unbounded:
            raise GraspError("the half-spaces leave an unbounded body; add the faces that close it")
        if best.x is None:
            break
        inside, radius = inside + best.x[:3] * unit, float(best.x[3])
    if best.x is None or not radius > INSIDE:
        raise GraspError("no point is inside all half-spaces: turn the normals outward")
    return inside


def _compacted(vertices: np.ndarray, faces: Loops) -> tuple[np.ndarray, Loops]:
    """The corners that these faces use, and the faces in their numbers."""
    used = sorted({v for face in faces for loop in face for v in loop})
    number = {v: k for k, v in enumerate(used)}
    return vertices[used], [[[number[v] for v in loop] for loop in face] for face in faces]


def outline_of(corners: Any) -> np.ndarray:
    """A simple polygon (K, 2), counter-clockwise."""
    from shapely.geometry import Polygon

    outline = numbers_of(corners, "a polygon has three corners (x, y) or more", (-3, 2))
    if np.array_equal(outline[0], outline[-1]):
        raise GraspError("the polygon closes by itself: leave out the repeated corner at its end")
    shape = Polygon(outline)
    if not shape.is_valid or not shape.area > 0.0:
        raise GraspError("the polygon crosses itself or has no area; list its corners in order")
    return outline if shape.exterior.is_ccw else outline[::-1]


def positive(values: Any, count: int, what: str) -> np.ndarray:
    """So many positive numbers; a GraspError if they are not."""
    needed = f"{what}: {count} positive numbers in metres"
    numbers = numbers_of(values, needed, (count,))
    if not np.all(numbers > 0.0):
        raise GraspError(f"{needed}, not {values!r}")
    return numbers


# --- One solid, and plane faces from its triangles ------------------------------------------------

Edge = tuple[int, int]
# Fits of a plane to one face, at most; two are nearly always enough.
FITS = 5
# A triangle is of a face only if its normal is within 60 degrees of the face's: two sides of a thin
# sheet are two faces.
SAME_SIDE = 0.5


def check_one_solid(
    count: int, loops: Sequence[Sequence[Sequence[int]]], what: str, remedy: str = ""
) -> None:
    """Raise `GraspError` unless the loops of all faces, over ``count`` corners, bound one solid."""
    if not all(face and all(len(loop) >= 3 for loop in face) for face in loops):
        raise GraspError(f"{what}: a face has one loop or more, each of three corners or more")
    runs = Counter(edge for face in loops for loop in face for edge in edges_of(loop))
    used = {v for edge in runs for v in edge}
    if not used or min(used) < 0 or max(used) >= count:
        raise GraspError(f"{what}: faces name corners 0 to {count - 1}, and there are some faces")
    twice = sum(1 for run in runs.values() if run > 1)
    opened = sum(1 for u, v in runs if (v, u) not in runs)
    if twice:
        raise GraspError(
            f"{what}: run along twice in one direction: {count_of(twice, 'edge')}, so that faces "
            f"are turned the wrong way round or more than two share an edge (open: "
            f"{count_of(opened, 'edge')})"
            + (remedy or "; list the corners of each face counter-clockwise as seen from outside")
        )
    if opened:
        raise GraspError(
            f"{what} is not closed: {opened} open edges belong to one face only"
            + (remedy or "; add the faces that are missing")
        )
    across = [(face[0][0], hole[0]) for face in loops for hole in face[1:]]
    part = _connected(count, np.array([*runs, *across]))
    parts = len(set(part[sorted(used)].tolist()))
    if parts > 1:
        raise GraspError(
            f"{what}: {parts} separate surfaces; a body has one surface without cavities, so make "
            f"a body of each"
        )


def edges_of(loop: Sequence[int]) -> Iterable[Edge]:
    """Directed edges of a closed loop."""
    return zip(loop, [*loop[1:], loop[0]], strict=True)


def faces_of_triangles(vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> Loops:
    """Loops of the plane faces that triangles (T, 3) make up; the tolerance is a distance [m].

    Corners in the middle of an edge, where two faces meet and no third, are left out.

    Raises
    ------
    GraspError
        Two sides of the body are nearer than the tolerance.
    """
    groups = _plane_groups(vertices, triangles, tolerance)
    faces = [_loops(vertices, triangles[group]) for group in groups]
    meeting = Counter(v for face in faces for v in {v for loop in face for v in loop})
    thin = [[[v for v in loop if meeting[v] > 2] for loop in face] for face in faces]
    faces_without_middles = [[loop for loop in face if len(loop) > 2] for face in thin]
    if not all(faces_without_middles):
        raise GraspError(TOO_THIN)
    return faces_without_middles


def _connected(count: int, pairs: np.ndarray) -> np.ndarray:
    """For each of ``count`` corners the number of the part that pairs (P, 2) connect it to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def _plane_groups(vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> list[list[int]]:
    """Numbers of the triangles of each plane face."""
    sheet = _Sheet(vertices, triangles, tolerance)
    free = np.ones(len(triangles), dtype=bool)
    groups = []
    for seed in np.argsort(-sheet.sizes, kind="stable").tolist():
        if not free[seed]:
            continue
        group = [seed]
        for _ in range(FITS):
            grown = sheet.grown(seed, group, free)
            if grown == group:
                break
            group = grown
        free[group] = False
        groups.append(group)
    return groups


class _Sheet:
    """Triangles with the data that growing faces needs."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> None:
        self.corners = vertices[triangles]  # (T, 3, 3)
        a, b, c = np.moveaxis(self.corners, 1, 0)
        self.areas = 0.5 * np.cross(b - a, c - a)
        self.sizes = np.linalg.norm(self.areas, axis=1)
        self.slivers = self.sizes <= tolerance * np.ptp(self.corners, axis=1).max(axis=1)
        owner = {edge: t for t, tri in enumerate(triangles.tolist()) for edge in edges_of(tri)}
        self.neighbours = [[owner[v, u] for u, v in edges_of(tri)] for tri in triangles.tolist()]
        self.tolerance = tolerance

    def grown(self, seed: int, group: list[int], free: np.ndarray) -> list[int]:
        """Free triangles that the seed reaches over neighbours in the plane of the group."""
        total, weights = self.areas[group].sum(axis=0), self.sizes[group]
        n = total / np.linalg.norm(total)
        middle = weights @ self.corners[group].mean(axis=1) / weights.sum()
        inside, seen, ahead = {seed}, {seed}, [seed]
        while ahead:
            for t in self.neighbours[ahead.pop()]:
                if t not in seen and free[t] and self._in_plane(t, n, middle):
                    inside.add(t)
                    ahead.append(t)
                seen.add(t)
        return sorted(inside)

    def _in_plane(self, t: int, n: np.ndarray, middle: np.ndarray) -> bool:
        if np.abs((self.corners[t] - middle) @ n).max() > self.tolerance:
            return False
        return bool(self.slivers[t] or self.areas[t] @ n > SAME_SIDE * self.sizes[t])


def _loops(vertices: np.ndarray, triangles: np.ndarray) -> list[list[int]]:
    """Loops around a group of triangles: the outer one first."""
    runs = {edge for tri in triangles.tolist() for edge in edges_of(tri)}
    border = [(u, v) for u, v in sorted(runs) if (v, u) not in runs]
    onward: dict[int, list[int]] = {}
    for u, v in border:
        onward.setdefault(u, []).append(v)
    corners = vertices[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    n = area / np.linalg.norm(area)
    left = set(border)
    loops = []
    while left:
        first = min(left)
        loop, edge = [first[0]], first
        while True:
            left.discard(edge)
            edge = (edge[1], _next(vertices, n, edge, onward[edge[1]]))
            if edge == first:
                break
            loop.append(edge[0])
        loops.append(loop)
    return sorted(loops, key=lambda loop: -_turned_area(vertices[loop], n))


def _next(vertices: np.ndarray, n: np.ndarray, edge: Edge, ways: list[int]) -> int:
    """The next edge of a border: the material on its left ends at the first way out, clockwise."""
    if len(ways) == 1:
        return ways[0]
    back = vertices[edge[0]] - vertices[edge[1]]
    side = np.cross(back, n)

    def clockwise(w: int) -> float:
        step = vertices[w] - vertices[edge[1]]
        return float(np.arctan2(step @ side, step @ back)) % (2.0 * np.pi)

    return min(ways, key=clockwise)


def _turned_area(loop: np.ndarray, n: np.ndarray) -> float:
    return float(area_vector(loop - loop.mean(axis=0)) @ n)


# --- Mesh files -----------------------------------------------------------------------------------

# Rounding of a coordinate in single precision, with room for one operation on it.
SINGLE = 2.0 * float(np.finfo(np.float32).eps)
REPAIR = "; repair the mesh (in Blender: 3D-Print Toolbox, Make Manifold) or rebuild the body"


def read_mesh(file: str | Path, scale: float) -> Boundary:
    """The body in a mesh file; see `Polyhedron.mesh`."""
    factor = number_of(scale, f"{file}: a mesh is scaled by a positive factor", above=0.0)
    try:
        mesh = meshes.read_mesh(Path(file))
    except ValueError as error:
        raise GraspError(f"{file}: {error}; a body is read from STL or OBJ") from error
    rounding = SINGLE * float(np.abs(mesh.vertices).max())
    vertices, triangles = _joined(mesh.vertices, mesh.triangles, rounding)
    what = f"the mesh of {Path(file).name}"
    if not len(triangles):
        raise GraspError(f"{file}: {TOO_THIN}")
    check_one_solid(len(vertices), [[tri] for tri in triangles.tolist()], what, REPAIR)
    tolerance = GROWN * rounding
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    volume = moments(vertices, triangles).volume
    surface = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2.0
    if abs(volume) <= 0.1 * tolerance * surface:
        raise GraspError(f"{file}: {TOO_THIN}")
    if volume < 0.0:
        raise GraspError(
            f"{what} is inside out: its triangles run clockwise as seen from outside; turn all of "
            f"them round (in Blender: Mesh, Normals, Recalculate Outside)"
        )
    faces = faces_of_triangles(vertices, triangles, tolerance)
    return Boundary(*_compacted(vertices * factor, faces), None, rounding * factor)


def write_mesh(vertices: np.ndarray, triangles: np.ndarray, path: str | Path) -> None:
    """Write triangles to a file; its ending is the format."""
    import trimesh

    solid = trimesh.Trimesh(vertices, triangles, process=False)
    try:
        solid.export(str(path))
    except (OSError, ValueError, KeyError) as error:
        raise GraspError(
            f"{path}: cannot be written ({error}); use a name that ends in .stl"
        ) from error


def triangles_of(
    faces: Sequence[Face], loops_of_faces: Sequence[Sequence[Sequence[int]]]
) -> np.ndarray:
    """Numbers of corners (T, 3) of triangles that make up a body's faces, normals outward."""
    triangles: list[list[int]] = []
    for face, loops in zip(faces, loops_of_faces, strict=True):
        numbers = [v for loop in loops for v in loop]
        triangles.extend([[numbers[k] for k in tri] for tri in face_triangles(face)])
    return np.array(triangles)


def face_triangles(face: Face) -> list[tuple[int, int, int]]:
    """Triangles of one face, numbers into its outer corners followed by those of its holes."""
    corners = np.vstack([face.outline, *(face.coordinates(hole) for hole in face.holes)])
    if len(corners) == 3:
        return [(0, 1, 2)]
    triangles = []
    for triangle in cut_into_triangles(face.shape):
        a, b, c = (int(np.argmin(np.abs(corners - at).max(axis=1))) for at in triangle)
        triangles.append((a, b, c))
    return triangles


def _joined(
    points: np.ndarray, triangles: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points that coincide become one; triangles that lose a corner by it are left out."""
    from scipy.spatial import cKDTree

    distinct, at = np.unique(points, axis=0, return_inverse=True)
    pairs = cKDTree(distinct).query_pairs(tolerance, output_type="ndarray")
    label = _connected(len(distinct), pairs)
    vertices = np.empty((label.max() + 1, 3))
    vertices[label[::-1]] = distinct[::-1]  # the first of each cluster stands for it
    numbers = label[at.ravel()[triangles]]
    a, b, c = numbers.T
    return vertices, numbers[(a != b) & (b != c) & (c != a)]
