"""A body bounded by plane faces: its faces, mass properties and constructors.

The body is a list of corners and, for each face, loops of their numbers: around the face
counter-clockwise as seen from outside, around holes clockwise.  Every edge then belongs to two
faces, which run along it in opposite directions; that is checked, so that a `Polyhedron` is a
solid.  Faces need not be convex.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import number_of, numbers_of, pose_of
from multiarm.grasp.body import boundaries
from multiarm.grasp.body.face import OFF_PLANE, PLANE_TOLERANCE, Face
from multiarm.notation import count_of
from multiarm.scene.solids import MassProperties, Moments, moments

Loop = tuple[int, ...]
"""Numbers of corners, in the order in which an edge runs through them."""


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A solid bounded by plane faces.

    Parameters
    ----------
    vertices : array-like, shape (V, 3)
        Its corners [m].
    loops : sequence of sequences of loops
        For each face the numbers of its corners, counter-clockwise as seen from outside; then one
        clockwise loop for each hole.
    names : sequence of str, optional
        Names of the faces in messages and figures; by default ``face 0`` and so on.
    rounding : float
        Coordinates of the corners may be off by this [m], as those from a file are.  Faces count as
        plane, parallel or perpendicular when no more than that keeps them from it.

    Raises
    ------
    GraspError
        Faces that are not plane, edges that do not belong to two faces, faces that point inward,
        several separate boundaries.

    See Also
    --------
    box, prism, wedge, pyramid, halfspaces, hull, mesh : the usual ways to make one.
    """

    vertices: np.ndarray
    loops: tuple[tuple[Loop, ...], ...]
    names: tuple[str, ...]
    rounding: float

    def __init__(
        self,
        vertices: Any,
        loops: Sequence[Sequence[Sequence[int]]],
        names: Sequence[str] | None = None,
        rounding: float = 0.0,
    ) -> None:
        corners = numbers_of(vertices, "corners are finite, of shape (V, 3)", (-1, 3))
        try:
            numbers = tuple(tuple(tuple(map(index, loop)) for loop in face) for face in loops)
        except TypeError as error:
            raise GraspError(
                "a body needs for each face a list of loops of the numbers of its corners"
            ) from error
        corners.setflags(write=False)
        called = (
            tuple(names) if names is not None else tuple(f"face {k}" for k in range(len(loops)))
        )
        if len(called) != len(numbers):
            raise GraspError(
                f"{count_of(len(numbers), 'face')} must have as many names, not {len(called)}"
            )
        object.__setattr__(self, "vertices", corners)
        object.__setattr__(self, "loops", numbers)
        object.__setattr__(self, "names", called)
        object.__setattr__(self, "rounding", rounding)
        boundaries.check_one_solid(len(corners), numbers, "the body")
        if not self.volume > 0.0:
            raise GraspError(
                "the faces point inward; list the corners of a face counter-clockwise as seen from "
                "outside"
            )
        _ = self.faces  # refuses faces that are not plane now rather than later

    # --- ways to make one ----------------------------------------------------------------------

    @classmethod
    def box(cls, lengths: Any) -> Polyhedron:
        """A block with the full edge lengths (3,) [m], centred at the origin.

        Its faces are +x, +y, +z, -x, -y, -z, in this order.
        """
        half = 0.5 * boundaries.positive(lengths, 3, "the edge lengths of a block")
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        loops = [(4, 6, 7, 5), (2, 3, 7, 6), (1, 5, 7, 3), (0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4)]
        return cls(signs * half, [[loop] for loop in loops], ("+x", "+y", "+z", "-x", "-y", "-z"))

    @classmethod
    def prism(cls, polygon: Any, height: float) -> Polyhedron:
        """A polygon (K, 2) in x and y, either way round, from z = -height / 2 to height / 2 [m].

        Face k contains the polygon's edge from corner k; then come the top and the bottom.
        """
        outline = boundaries.outline_of(polygon)
        z = 0.5 * float(boundaries.positive([height], 1, "the height of a prism")[0])
        n = len(outline)
        vertices = [[*xy, -z] for xy in outline] + [[*xy, z] for xy in outline]
        sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
        loops = [*sides, [n + k for k in range(n)], list(reversed(range(n)))]
        names = [*(f"side {k + 1}" for k in range(n)), "top", "bottom"]
        return cls(vertices, [[loop] for loop in loops], names)

    @classmethod
    def wedge(cls, lengths: Any, top: float = 0.0) -> Polyhedron:
        """A block (3,) whose top is cut down to the length ``top`` along x by one slope [m].

        The slope falls toward +x; ``top = 0`` leaves a sharp ridge.  The origin is the centre of
        the block.
        """
        lx, ly, lz = boundaries.positive(lengths, 3, "the edge lengths of a wedge")
        if not 0.0 <= top < lx:
            raise GraspError(
                f"the top of a wedge is at least 0 and shorter than {lx:g} m, not {top!r}"
            )
        section = [(-lx / 2, -lz / 2), (lx / 2, -lz / 2), (top - lx / 2, lz / 2)]
        section += [(-lx / 2, lz / 2)] if top else []
        n = len(section)
        vertices = [[x, -ly / 2, z] for x, z in section] + [[x, ly / 2, z] for x, z in section]
        around = [[(k + 1) % n, k, n + k, n + (k + 1) % n] for k in range(n)]
        loops = [*around, [n + k for k in reversed(range(n))], list(range(n))]
        names = ["-z", "slope", *(["+z"] if top else []), "-x", "+y", "-y"]
        return cls(vertices, [[loop] for loop in loops], names)

    @classmethod
    def pyramid(cls, base: Any, apex: Any) -> Polyhedron:
        """A pyramid on a polygon (K, 2) in the plane z = 0, with its apex (3,) above or below."""
        outline = boundaries.outline_of(base)
        needed = "the apex of a pyramid is a point (x, y, z) with z other than 0"
        top = numbers_of(apex, needed, (3,))
        if top[2] == 0.0:
            raise GraspError(f"{needed}, not {apex!r}")
        if top[2] < 0.0:
            outline = outline[::-1]
        n = len(outline)
        vertices = [[x, y, 0.0] for x, y in outline] + [top.tolist()]
        loops = [*([k, (k + 1) % n, n] for k in range(n)), list(reversed(range(n)))]
        names = [*(f"side {k + 1}" for k in range(n)), "base"]
        return cls(vertices, [[loop] for loop in loops], names)

    @classmethod
    def halfspaces(cls, normals: Any, offsets: Any) -> Polyhedron:
        """All x with ``normals[k] . x <= offsets[k]``: "face k" has the outward normal k.

        Normals (F, 3) are of any length.  Half-spaces that bound no face are left out; the names of
        the faces have the numbers of theirs.
        """
        return cls(*boundaries.halfspaces(normals, offsets))

    @classmethod
    def hull(cls, points: Any) -> Polyhedron:
        """The convex hull of points (N, 3) [m]."""
        return cls(*boundaries.hull(points))

    @classmethod
    def mesh(cls, file: str | Path, scale: float = 1.0) -> Polyhedron:
        """A body from an STL or OBJ file, whose numbers times ``scale`` are metres.

        Triangles in one plane become one face, which may have holes.

        Raises
        ------
        GraspError
            A file that cannot be read; a mesh that is open, inside out, not a manifold, or more
            than one body.
        """
        return cls(*boundaries.read_mesh(file, scale))

    # --- properties ----------------------------------------------------------------------------

    @cached_property
    def faces(self) -> tuple[Face, ...]:
        """The faces, in the body's frame."""
        v = self.vertices
        return tuple(
            Face(v[list(loops[0])], tuple(v[list(loop)] for loop in loops[1:]), name, self.rounding)
            for loops, name in zip(self.loops, self.names, strict=True)
        )

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals of the faces, shape (F, 3)."""
        return np.array([face.normal for face in self.faces])

    @cached_property
    def corners(self) -> tuple[tuple[int, ...], ...]:
        """For each vertex the numbers of the faces that meet there."""
        meeting: list[list[int]] = [[] for _ in self.vertices]
        for number, loops in enumerate(self.loops):
            for v in sorted({v for loop in loops for v in loop}):
                meeting[v].append(number)
        return tuple(map(tuple, meeting))

    @cached_property
    def edges(self) -> dict[tuple[int, int], tuple[int, int]]:
        """For each edge (u, v), u < v, its faces: on the left of u to v, and on the right."""
        left = {
            edge: number
            for number, loops in enumerate(self.loops)
            for loop in loops
            for edge in boundaries.edges_of(loop)
        }
        return {(u, v): (left[u, v], left[v, u]) for u, v in left if u < v}

    @cached_property
    def size(self) -> float:
        """Diagonal of the box around the body [m]: the unit of relative tolerances."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    @property
    def off_plane(self) -> float:
        """Distance from the plane of a face within which corners of others are on it [m]."""
        return max(PLANE_TOLERANCE * self.size, OFF_PLANE * self.rounding)

    @cached_property
    def convex(self) -> bool:
        """Whether no corner stands out over the plane of a face."""
        heights = self.normals @ self.vertices.T - [[face.offset] for face in self.faces]
        return bool(heights.max() <= self.off_plane)

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return self._moments.volume

    @property
    def centre(self) -> np.ndarray:
        """Centre of mass at constant density, shape (3,) [m]."""
        return self._moments.centre

    def mass_properties(self, mass: float) -> MassProperties:
        """Mass, centre of mass and inertia when the mass [kg] is spread evenly.

        Raises
        ------
        GraspError
            A mass that is not a positive number.
        """
        what = "the mass of a body is a positive number of kilograms"
        return self._moments.of_mass(number_of(mass, what, above=0.0))

    @cached_property
    def _moments(self) -> Moments:
        return moments(self.vertices, [loop for loops in self.loops for loop in loops])

    def on_faces(self, numbers: Any, points: Any) -> np.ndarray:
        """Points (..., 3) moved along the normals onto the planes of their faces ``numbers`` (...).

        Corners of a body from a file are off their planes by the rounding of the file; contacts
        are on the planes.
        """
        which, at = np.asarray(numbers), np.asarray(points, dtype=float)
        n, h = self.normals, np.array([face.offset for face in self.faces])
        heights = h[which] - np.sum(n[which] * at, axis=-1)
        return at + heights[..., None] * n[which]

    # --- the same body elsewhere ---------------------------------------------------------------

    def placed(self, pose: Any) -> Polyhedron:
        """The body in another frame; ``pose`` (4, 4) is this frame in it.

        Raises
        ------
        GraspError
            A pose that is not a rotation and a displacement.
        """
        X = pose_of(pose, "a pose has shape (4, 4): a rotation matrix and a displacement in it")
        return self._with(self.vertices @ X[:3, :3].T + X[:3, 3], self.rounding)

    def centred(self) -> Polyhedron:
        """The body with its centre of mass at the origin."""
        return self._with(self.vertices - self.centre, self.rounding)

    def scaled(self, factor: float) -> Polyhedron:
        """The body with all lengths multiplied."""
        times = number_of(factor, "a body is scaled by a positive factor", above=0.0)
        return self._with(self.vertices * times, self.rounding * times)

    def _with(self, vertices: np.ndarray, rounding: float) -> Polyhedron:
        return Polyhedron(vertices, self.loops, self.names, rounding)

    def save(self, path: str | Path) -> None:
        """Write the body as STL (or another format that trimesh knows by its ending).

        A scene names the file as the mesh of its object.  STL keeps some seven digits.
        """
        boundaries.write_mesh(self.vertices, boundaries.triangles_of(self.faces, self.loops), path)

    def __repr__(self) -> str:
        kinds = Counter(len(face.vertices) for face in self.faces)
        faces = ", ".join(f"{count} with {k} corners" for k, count in sorted(kinds.items()))
        return f"<Polyhedron: {len(self.vertices)} corners, {len(self.loops)} faces ({faces})>"
