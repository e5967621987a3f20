r"""Grasps of the wider class with the last contact anywhere in its region (thesis, 2.2.3.3, 2.4).

Only two faces need to be opposed by three others.  Contacts 1, 2, 3 are the feet of one point O on
the three faces, contacts 4 and 5 share one opposed face, contact 6 is on another, and contact 7 is
in the middle of its region on that one (see `seventh_contact`).

O is where its feet are farthest from the edges of their faces.  Among places for the others, those
are taken that balance most evenly (see `seven_pushes`); only a few such choices are worked out.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np

from multiarm.grasp.assembling import assembled, crosses_border
from multiarm.grasp.body_class import Triple
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.corners import feet, gripper_frame, nearest_corner_frame
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.seven_pushes import smallest_pushes
from multiarm.grasp.seventh_contact import seventh_contact_region
from multiarm.grasp.wrench_cones import is_independent

Three = tuple[int, int, int]

# Places on a face that are tried for contacts 4 to 7: its middle, and this part of the way from
# there to each corner.
TOWARD_CORNER = 0.7
# Of so many corners at most, and of so many opposed faces, the largest.
MOST_CORNERS, MOST_OPPOSED = 8, 5
# So many choices with the largest smallest push are worked out.
FINISHED = 4


def region_grasps(body: Polyhedron, triples: list[Triple]) -> Iterator[Grasp]:
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
    from scipy.optimize import linprog

    rows, levels = [], []
    for k in faces:
        face = body.faces[k]
        along = np.roll(face.vertices, -1, axis=0) - face.vertices
        inward = np.cross(face.normal, along)
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        rows.append(inward)  # inward . normal = 0: the foot counts as the point does
        levels.append(np.sum(inward * (face.vertices - body.centre), axis=1))
    A = np.vstack(rows)
    bounds = [(-body.size, body.size)] * 3 + [(0.0, None)]
    limits = -np.concatenate(levels)
    best = linprog([0, 0, 0, -1], np.column_stack([-A, np.ones(len(A))]), limits, bounds=bounds)
    return None if best.x is None or best.x[3] <= 1e-9 * body.size else best.x[:3] + body.centre


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
        order = np.argsort(-smallest)[:FINISHED]
        tried.extend((smallest[k], (u, u, w), fours[k, :3]) for k in order if smallest[k] > 0.0)
    tried.sort(key=lambda choice: -choice[0])
    return [(faces, points) for _, faces, points in tried[:FINISHED]]


def _fours(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """All choices of contacts 4, 5 among places a and 6, 7 among places b, shape (K, 4, 3)."""
    pairs = list(combinations(range(len(a)), 2))
    ordered = list(permutations(range(len(b)), 2))
    made = [[a[i], a[j], b[k], b[m]] for i, j in pairs for k, m in ordered]
    return np.array(made).reshape(-1, 4, 3)


def _finished(
    body: Polyhedron, triple: Three, first: Contacts, faces: Three, points: np.ndarray
) -> Iterator[Grasp]:
    six = first.joined(Contacts.along(points, -body.normals[list(faces)]))
    if not is_independent(six):
        return
    region = seventh_contact_region(six, body.faces[faces[2]])
    if not region:
        return
    places = np.vstack([six.points, region.best_point()])
    frames = [
        gripper_frame(body, triple, places[:3]),
        nearest_corner_frame(body, places[3:], faces[2]),
    ]
    note = (
        "contacts 4 and 5 share a face, so that gripper 2 reaches over two faces; contact 7 is in "
        f"the middle of its region, {float(region.depth(places[6])):.4g} m from its border"
    )
    split = [(0, 1, 2), (3, 4, 5, 6)]
    made = assembled(body, places, (*triple, *faces, faces[2]), split, frames, (note,))
    if made.closure and crosses_border(made, region):
        yield made


def _places(body: Polyhedron, number: int) -> np.ndarray:
    """The middle of a face, and places toward its corners, shape (K, 3), those that are on it."""
    face = body.faces[number]
    corners = face.vertices[:: -(-len(face.vertices) // MOST_CORNERS)]
    places = np.vstack([face.centre, face.centre + TOWARD_CORNER * (corners - face.centre)])
    return face.at(face.coordinates(places))[face.contains(places)]
