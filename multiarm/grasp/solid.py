"""Whether loops of corners bound one solid, and faces from triangles that lie in one plane.

Loops bound a solid when each edge is run along once in each direction: once by the face on its left
and once by the face on its right.  A missing partner is an open edge; a second run in one direction
means that faces are turned the wrong way round or that more than two of them share the edge.

Triangles become faces by growing: the largest triangle that is left spreads over its neighbours as
long as their corners stay near its plane; the plane is then fitted to all of them, and they grow
once more, until nothing changes.  A small triangle thus does not decide for a large face.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from multiarm.errors import GraspError
from multiarm.scene.object import TOO_THIN

Edge = tuple[int, int]
# Fits of a plane before its face is taken as it is; two are nearly always enough.
FITS = 5
# A triangle is of a face only if its normal is within 60 degrees of the face's: two sides of a thin
# sheet are two faces.
SAME_SIDE = 0.5


def check_one_solid(
    count: int, loops: Sequence[Sequence[Sequence[int]]], what: str, remedy: str = ""
) -> None:
    """Raise `GraspError` unless the loops of all faces, over ``count`` corners, bound one solid."""
    runs = Counter(edge for face in loops for loop in face for edge in edges_of(loop))
    used = {v for edge in runs for v in edge}
    if not used or min(used) < 0 or max(used) >= count:
        raise GraspError(f"{what}: faces name corners 0 to {count - 1}, and there are some faces")
    twice = sum(1 for run in runs.values() if run > 1)
    opened = sum(1 for u, v in runs if (v, u) not in runs)
    if twice:
        raise GraspError(
            f"{what}: {twice} edges are run along twice in one direction, so that faces are turned "
            f"the wrong way round or more than two share an edge ({opened} edges are open)"
            + (remedy or "; list the corners of each face counter-clockwise as seen from outside")
        )
    if opened:
        raise GraspError(
            f"{what} is not closed: {opened} open edges belong to one face only"
            + (remedy or "; add the faces that are missing")
        )
    across = [(face[0][0], hole[0]) for face in loops for hole in face[1:]]
    part = _parts(count, [*runs, *across])
    parts = len({part[v] for v in used})
    if parts > 1:
        raise GraspError(
            f"{what}: {parts} separate surfaces; a body has one surface without cavities, so make "
            f"a body of each"
        )


def edges_of(loop: Sequence[int]) -> Iterable[Edge]:
    """Directed edges of a closed loop."""
    return zip(loop, [*loop[1:], loop[0]], strict=True)


def faces_of_triangles(
    vertices: np.ndarray, triangles: np.ndarray, tolerance: float
) -> list[list[list[int]]]:
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
    kept = [[loop for loop in face if len(loop) > 2] for face in thin]
    if not all(kept):
        raise GraspError(TOO_THIN)
    return kept


def _parts(count: int, edges: Iterable[Edge]) -> list[int]:
    """For each corner the smallest corner that edges connect it to."""
    parent = list(range(count))

    def root(v: int) -> int:
        while parent[v] != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        return v

    for u, v in edges:
        a, b = root(u), root(v)
        parent[max(a, b)] = min(a, b)
    return [root(v) for v in range(count)]


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
        found, seen, ahead = {seed}, {seed}, [seed]
        while ahead:
            for t in self.neighbours[ahead.pop()]:
                if t not in seen and free[t] and self._in_plane(t, n, middle):
                    found.add(t)
                    ahead.append(t)
                seen.add(t)
        return sorted(found)

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
    about = loop - loop.mean(axis=0)
    return float(0.5 * np.cross(about, np.roll(about, -1, axis=0)).sum(axis=0) @ n)
