r"""Grasps of the wider class of polyhedra (thesis, 2.2.3.3).

Three faces with independent normals oppose at least two others (see `body_class`).  Contacts 1, 2
and 3 are on the three, their normal lines through one point O, which is taken as the origin: their
moments vanish.  Contacts 4, 5, 6 are on opposed faces, and contact 7 on the face of contact 6.
Then :math:`b_1 = 0`, and a last contact on that face closes the grasp at

.. math::  p_7 = D_1 (e, f) + D_2 (p_x, p_y), \qquad D_1 < 0, \; D_2 < 0 .

When contacts 4, 5, 6 are on three faces of one corner, in the pattern of `corner_pattern`, this
leaves on the line :math:`y = f` the places farther from contact 6 than

.. math::  D_x = |Q| ,

half of what bodies with parallel faces need, because :math:`1 - D_1 > 1` and not 2.  O is chosen
equally deep below the three faces, which share a corner, so that a small gripper holds contacts
1, 2 and 3.  Where the corners for this are missing, see `wide_region`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.assembling import assembled, crosses, size_of_gripper, sized
from multiarm.grasp.body_class import Triple, classify
from multiarm.grasp.corner_pattern import CornerPattern, corner_pattern, even_offsets, right_handed
from multiarm.grasp.corners import convex_corner, feet, gripper_frame, shared_corner
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.parallel_bodies import OPEN, Three, usual_distance
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.wide_region import region_grasps

# Depth of the patterns as a part of the shortest edge at their corners, and G1 - G2 as parts of it.
USUAL_DEPTH, USUAL_STEPS = 0.2, (0.5, -0.5)
# So many triples are worked out, those first whose three faces share a corner.
MOST_TRIPLES = 24


@dataclass(frozen=True, eq=False)
class WideDesign:
    """A grasp of the wider class with two grippers at corners.

    Attributes
    ----------
    body : Polyhedron
    triple : (int, int, int)
        Faces of contacts 1, 2, 3; they share a corner.
    faces : (int, int, int)
        Front, side and top: of contacts 4, 5 and 6; contact 7 is on the top.
    pattern : CornerPattern
        Contacts 4, 5, 6, about O.
    distance : float
        Of contact 7 from contact 6 [m].
    """

    body: Polyhedron
    triple: Three
    faces: Three
    pattern: CornerPattern
    distance: float

    @property
    def minimum_distance(self) -> float:
        """``D_x = |Q|``: the grasp is closed beyond it [m]."""
        return abs(self.pattern.reach)

    def grasp(self) -> Grasp:
        """The grasp, verified.

        Raises
        ------
        GraspError
            No contact on the line y = f closes; contacts outside their faces; a distance that is
            not beyond its bound.
        """
        p, body = self.pattern, self.body
        if p.faulty:
            raise GraspError(f"{OPEN} closes the grasp: {p.faulty}")
        if not self.distance > self.minimum_distance:
            raise GraspError(
                f"contact 7 is {self.distance:.6g} m from contact 6, but the grasp is closed only "
                f"beyond |Q| = {self.minimum_distance:.6g} m"
            )
        first = feet(body, self.triple, p.frame[:3, 3])
        points = np.vstack([first, p.points, p.last_point(self.distance)])
        frames = [
            gripper_frame(body, self.triple, points[:3]),
            gripper_frame(body, self.faces, points[3:]),
        ]
        on = (*self.triple, *self.faces, self.faces[2])
        made = assembled(body, points, on, [(0, 1, 2), (3, 4, 5, 6)], frames, self._notes())
        if not (made.closure and crosses(made, p.last_point, self.minimum_distance)):
            raise GraspError("these faces and offsets give no form closure")
        return made

    def _notes(self) -> tuple[str, ...]:
        return (
            f"contact 7 is {self.distance:.6g} m from contact 6; the grasp is closed beyond "
            f"|Q| = {self.minimum_distance:.6g} m",
        )


def design_wide_grasp(body: Polyhedron, *, gripper_size: float | None = None) -> Grasp:
    """A form-closure grasp of a polyhedron of the wider class.

    Parameters
    ----------
    body : Polyhedron
        Three of its faces oppose at least two others; every convex body with more than four faces.
    gripper_size : float, optional
        Largest distance between contacts of a gripper [m].

    Returns
    -------
    Grasp
        Gripper 1 carries contacts 1, 2 and 3, gripper 2 contacts 4 to 7.  Where corners allow it,
        both are small; else gripper 2 reaches over two faces.

    Raises
    ------
    GraspError
        A body outside the class, or one on which no such grasp was found.
    """
    found, gripper_size = classify(body), size_of_gripper(gripper_size)
    if not found.triples:
        raise GraspError(f"the construction for the wider class does not fit: {found.words}")
    triples = sorted(found.triples, key=lambda t: shared_corner(body, t.faces) is None)
    best = _firmest(_corner_grasps(body, triples[:MOST_TRIPLES], gripper_size))
    if best is None and gripper_size is None:
        best = _firmest(region_grasps(body, triples[:MOST_TRIPLES]))
    if best is None:
        small = "" if gripper_size is None else f" with grippers of {gripper_size:g} m"
        raise GraspError(
            f"no grasp of the wider class{small} was found: the body is {found.words}, but its "
            f"faces leave no room for the contacts; larger faces or another size may help"
        )
    return best


def wide_design(
    body: Polyhedron, triple: Three, faces: Three, depth: float, step: float
) -> WideDesign:
    """The design with both patterns equally deep below their faces.

    Parameters
    ----------
    body : Polyhedron
    triple, faces : (int, int, int)
        Of contacts 1, 2, 3, and front, side and top (right-handed) of contacts 4, 5, 6.
    depth, step : float
        Of the patterns below the faces, and G1 - G2 [m].
    """
    n = body.normals[list(triple)]
    offsets = np.array([body.faces[k].offset for k in triple])
    origin = np.linalg.solve(n, offsets - depth)
    planes = np.array([body.faces[k].offset for k in faces])
    blank = corner_pattern(body.normals[list(faces)], planes, origin, (0.0, 0.0, 0.0, 0.0))
    lengths = even_offsets(blank, depth, step * depth)
    pattern = corner_pattern(body.normals[list(faces)], planes, origin, lengths)
    distance = usual_distance(body, faces[2], pattern, 1.0)
    return WideDesign(body, triple, faces, pattern, distance)


def _shortest_edge(body: Polyhedron, faces: tuple[int, ...]) -> float:
    loops = [body.loops[k][0] for k in faces]
    ends = [body.vertices[list(loop)] for loop in loops]
    return min(float(np.linalg.norm(v - np.roll(v, 1, axis=0), axis=1).min()) for v in ends)


def _corner_grasps(
    body: Polyhedron, triples: list[Triple], gripper_size: float | None
) -> Iterator[Grasp]:
    """Grasps with both grippers at corners, their patterns equally deep."""
    for triple in triples:
        if shared_corner(body, triple.faces) is None:
            continue
        for vertex, meeting in enumerate(body.corners):
            if set(meeting) <= set(triple.opposed) and convex_corner(body, vertex):
                yield from _with_corner(body, triple.faces, meeting, gripper_size)


def _with_corner(
    body: Polyhedron, triple: Three, meeting: tuple[int, ...], gripper_size: float | None
) -> Iterator[Grasp]:
    usual = USUAL_DEPTH * min(_shortest_edge(body, triple), _shortest_edge(body, meeting))
    for top in range(3):
        three = right_handed(body, (meeting[top - 2], meeting[top - 1], meeting[top]))
        for step in USUAL_STEPS:

            def made(depth: float, faces: Three = three, step: float = step) -> Grasp:
                return wide_design(body, triple, faces, depth, step).grasp()

            try:
                yield sized(made, usual, gripper_size)
            except GraspError:
                continue


def _firmest(grasps: Iterator[Grasp]) -> Grasp | None:
    return max(grasps, key=lambda grasp: grasp.closure.distance, default=None)
