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
1, 2 and 3.  Where the corners for this are missing, the second construction helps.

**The last contact anywhere in its region** (thesis, 2.2.3.3, 2.4).  Only two faces need to be
opposed by three others.  Contacts 1, 2, 3 are the feet of one point O on the three faces, contacts
4 and 5 share one opposed face, contact 6 is on another, and contact 7 is in the middle of its
region on that one (see `seventh_contact`).

The feet of O are as far as possible from the edges of their faces.  The places of the others are
those that balance most evenly (see `smallest_pushes`); only a few such choices are made grasps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import Triple, classify
from multiarm.grasp.body.deepest import deepest_point
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.assembling import (
    assembled,
    crosses_border,
    size_of_gripper,
    sized,
    smallest_pushes,
)
from multiarm.grasp.designs.corner_design import USUAL_STEPS, CornerDesign, usual_distance
from multiarm.grasp.designs.corner_pattern import corner_pattern
from multiarm.grasp.designs.grippers import (
    Three,
    convex_corner,
    feet,
    gripper_frame,
    hands_reach,
    shared_corner,
    two_groups,
)
from multiarm.grasp.designs.parallel_bodies import right_handed
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import seventh_contact_region
from multiarm.grasp.seventh_contact.wrench_cones import is_independent
from multiarm.terminal.progress import Progress, displayed

# Depth of the patterns as a part of the shortest edge at their corners.
USUAL_DEPTH = 0.2
# Triples that are tried, at most; those whose three faces share a corner come first.
MOST_TRIPLES = 24


def design_wide_grasp(
    body: Polyhedron,
    *,
    gripper_size: float | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Grasp:
    """A form-closure grasp of a polyhedron of the wider class.

    Parameters
    ----------
    body : Polyhedron
        Three of its faces oppose at least two others; every convex body with more than four faces.
    gripper_size : float, optional
        Largest distance between contacts of a gripper [m].
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called as ``progress(done, total, words)``, in triples of faces.

    Returns
    -------
    Grasp
        Gripper 1 carries contacts 1, 2 and 3, gripper 2 contacts 4 to 7.  Where corners allow it,
        both are small; else gripper 2 reaches over two faces, or both share the contacts as hands
        that come from one side can reach them.

    Raises
    ------
    GraspError
        A body outside the class, or one on which no such grasp was found.
    """
    body_class, gripper_size = classify(body), size_of_gripper(gripper_size)
    if not body_class.triples:
        raise GraspError(f"the construction for the wider class does not fit: {body_class.words}")
    triples = sorted(body_class.triples, key=lambda t: shared_corner(body, t.faces) is None)
    triples = triples[:MOST_TRIPLES]
    with displayed(progress, Progress) as show:
        best = _firmest(_corner_grasps(body, _told(triples, show, "corners"), gripper_size))
        if best is None and gripper_size is None:
            best = _firmest(region_grasps(body, _told(triples, show, "places on faces")))
    if best is None:
        small = "" if gripper_size is None else f" with grippers of {gripper_size:g} m"
        raise GraspError(
            f"no grasp of the wider class{small} was found: the body is {body_class.words}, but "
            f"its faces leave no room for the contacts; larger faces or another size may help"
        )
    return best


def wide_design(
    body: Polyhedron, triple: Three, faces: Three, depth: float, step: float
) -> CornerDesign:
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
    levels = np.array([body.faces[k].offset for k in triple])
    origin = np.linalg.solve(n, levels - depth)
    planes = np.array([body.faces[k].offset for k in faces])
    corner = corner_pattern(body.normals[list(faces)], planes, origin)
    pattern = corner.stepped(*corner.even_offsets(depth, step * depth))
    design = CornerDesign(body, faces, triple, pattern, np.nan, mirrored=False)
    return replace(design, distance=usual_distance(design))


def _told(
    triples: list[Triple], show: Callable[[int, int, str], None], where: str
) -> Iterator[Triple]:
    """The triples one after the other, and how many of them are done."""
    for number, triple in enumerate(triples):
        show(number, len(triples), f"looking for a grasp at {where}")
        yield triple


def _shortest_edge(body: Polyhedron, faces: tuple[int, ...]) -> float:
    loops = [body.loops[k][0] for k in faces]
    ends = [body.vertices[list(loop)] for loop in loops]
    return min(float(np.linalg.norm(v - np.roll(v, 1, axis=0), axis=1).min()) for v in ends)


def _corner_grasps(
    body: Polyhedron, triples: Iterable[Triple], gripper_size: float | None
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

            def at_depth(depth: float, faces: Three = three, step: float = step) -> Grasp:
                return wide_design(body, triple, faces, depth, step).grasp()

            try:
                yield sized(at_depth, usual, gripper_size)
            except GraspError:
                continue


def _firmest(grasps: Iterator[Grasp]) -> Grasp | None:
    return max(grasps, key=lambda grasp: grasp.closure.distance, default=None)


# --- The last contact anywhere in its region ------------------------------------------------------

# Feet that are nearer to an edge, in sizes of the body, are not on the face.
LEAST_ROOM = 1e-9
# Contacts 4 to 7 are tried in the middle of a face, and this part of the way to each corner.
TOWARD_CORNER = 0.7
# Corners of a face that are tried, and opposed faces (the largest), at most.
MOST_CORNERS, MOST_OPPOSED = 8, 5
# Choices, with the largest smallest push, that are made grasps; and those that differ from the last
# of them by this part only: symmetric bodies have several, among which rounding would choose.
FINISHED, EQUAL = 4, 1e-9


def region_grasps(body: Polyhedron, triples: Iterable[Triple]) -> Iterator[Grasp]:
    """Grasps for each triple, verified; contacts 4 to 7 are on two opposed faces."""
    for triple in triples:
        origin = deep_point(body, triple.faces)
        if origin is None:
            continue
        first = Contacts.along(feet(body, triple.faces, origin), -body.normals[list(triple.faces)])
        largest = sorted(triple.opposed, key=lambda k: -body.faces[k].area)[:MOST_OPPOSED]
        for faces, points in _firmest_three(body, first, largest):
            yield from _finished(body, triple.faces, first, faces, points)


def deep_point(body: Polyhedron, faces: Three) -> np.ndarray | None:
    """The point whose feet on three faces are farthest from their edges, or None.

    maximise r  subject to  t . (foot_k(O) - v) >= r  for each edge of each of the faces, with t
    its normal in the face, towards the material: linear in O and r.
    """
    rows, levels = [], []
    for k in faces:
        face = body.faces[k]
        along = np.roll(face.vertices, -1, axis=0) - face.vertices
        inward = np.cross(face.normal, along)
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        rows.append(inward)  # inward . normal = 0: the foot counts as the point does
        levels.append(np.sum(inward * (face.vertices - body.centre), axis=1))
    unit = 2.0 ** np.round(np.log2(body.size))  # of lengths; division by it rounds nothing
    deepest = deepest_point(-np.vstack(rows), -np.concatenate(levels) / unit, LEAST_ROOM)
    return None if deepest is None else deepest * unit + body.centre


def _firmest_three(
    body: Polyhedron, first: Contacts, opposed: list[int]
) -> list[tuple[Three, np.ndarray]]:
    """Faces and places of contacts 4, 5, 6 with which some place of contact 7 balances best."""
    tried: list[tuple[float, Three, np.ndarray]] = []
    for u, w in permutations(opposed, 2):
        fours = _fours(_places(body, u), _places(body, w))  # (K, 4, 3)
        points = np.concatenate([np.broadcast_to(first.points, (len(fours), 3, 3)), fours], axis=1)
        normals = np.vstack([first.normals, -body.normals[[u, u, w, w]]])
        smallest = smallest_pushes(body, points, np.broadcast_to(normals, points.shape))
        largest = np.flatnonzero(_among_largest(smallest))
        tried.extend((smallest[k], (u, u, w), fours[k, :3]) for k in largest if smallest[k] > 0.0)
    taken = _among_largest(np.array([push for push, _, _ in tried]))
    return [choice[1:] for choice, take in zip(tried, taken, strict=True) if take]


def _among_largest(pushes: np.ndarray) -> np.ndarray:
    """Which pushes (K,) are among the largest ``FINISHED``, or as large as the last of these."""
    if len(pushes) <= FINISHED:
        return np.ones(len(pushes), dtype=bool)
    return pushes >= (1.0 - EQUAL) * np.partition(pushes, -FINISHED)[-FINISHED]


def _fours(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """All choices of contacts 4, 5 among places a and 6, 7 among places b, shape (K, 4, 3)."""
    pairs = list(combinations(range(len(a)), 2))
    ordered = list(permutations(range(len(b)), 2))
    fours = [[a[i], a[j], b[k], b[m]] for i, j in pairs for k, m in ordered]
    return np.array(fours).reshape(-1, 4, 3)


def _finished(
    body: Polyhedron, triple: Three, first: Contacts, faces: Three, points: np.ndarray
) -> Iterator[Grasp]:
    six = first.joined(Contacts.along(points, -body.normals[list(faces)]))
    if not is_independent(six):
        return
    region = seventh_contact_region(six, body.faces[faces[2]])
    if not region:
        return
    places, on = np.vstack([six.points, region.best_point()]), (*triple, *faces, faces[2])
    seven = Contacts.along(places, -body.normals[list(on)])
    split: Sequence[tuple[int, ...]] = [(0, 1, 2), (3, 4, 5, 6)]
    note = "contacts 4 and 5 share a face, so that gripper 2 reaches over two faces"
    if not hands_reach(seven.normals, split):
        split = two_groups(seven)
        note = "contacts 4 to 7 are on faces that no hand reaches together, so that gripper 1 helps"
    frames = [gripper_frame(body, [on[j] for j in part], places[list(part)]) for part in split]
    note += (
        "; contact 7 is in the middle of its region, "
        f"{float(region.depth(places[6])):.4g} m from its border"
    )
    grasp = assembled(body, places, on, split, frames, (note,))
    if grasp.closure and crosses_border(grasp, region):
        yield grasp


def _places(body: Polyhedron, number: int) -> np.ndarray:
    """The middle of a face, and places toward its corners, shape (K, 3), those that are on it."""
    face = body.faces[number]
    corners = face.vertices[:: -(-len(face.vertices) // MOST_CORNERS)]
    places = np.vstack([face.centre, face.centre + TOWARD_CORNER * (corners - face.centre)])
    return face.at(face.coordinates(places))[face.contains(places)]
