r"""Grasps of the wider class with the last contact anywhere in its region (thesis, 2.2.3.3, 2.4).

Only two faces need to be opposed by three others.  Contacts 1, 2, 3 are the feet of one point O on
the three faces, contacts 4 and 5 share one opposed face, contact 6 is on another, and contact 7 is
in the middle of its region on that one (see `seventh_contact`).

O is where its feet are farthest from the edges of their faces.  Among places for the others, those
are taken from which the smallest push of the balance :math:`W \lambda = 0, \sum \lambda = 1` is
largest; only a few such choices are worked out.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np

from multiarm.grasp.assembling import assembled, crosses_border
from multiarm.grasp.body_class import Triple
from multiarm.grasp.contacts import Contacts, wrenches_of
from multiarm.grasp.corners import feet, gripper_frame, nearest_corner_frame
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.seventh_contact import seventh_contact_region
from multiarm.grasp.wrench_cone import is_independent

Three = tuple[int, int, int]

# Places on a face that are tried for contacts 4 to 7: its middle, and this part of the way from
# there to each corner.
TOWARD_CORNER = 0.7
# So many choices with the largest smallest push are worked out.
FINISHED = 4


def region_grasps(body: Polyhedron, triples: list[Triple]) -> Iterator[Grasp]:
    """Grasps for each triple, verified; contacts 4 to 7 are on two opposed faces."""
    for triple in triples:
        origin = deep_point(body, triple.faces)
        if origin is None:
            continue
        first = Contacts.along(feet(body, triple.faces, origin), -body.normals[list(triple.faces)])
        for faces, points in _firmest_three(body, first, triple.opposed):
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
    body: Polyhedron, first: Contacts, opposed: tuple[int, ...]
) -> list[tuple[Three, np.ndarray]]:
    """Faces and places of contacts 4, 5, 6 with which some place of contact 7 balances best."""
    tried: list[tuple[float, Three, np.ndarray]] = []
    W123 = first.wrenches
    unit = body.size
    for u, w in permutations(opposed, 2):
        a, b = _places(body, u), _places(body, w)
        n = -body.normals[[u, u, w, w]]
        for (i, j), (k, m) in (
            (p, q) for p in combinations(range(len(a)), 2) for q in permutations(range(len(b)), 2)
        ):
            four = np.array([a[i], a[j], b[k], b[m]]) - body.centre
            W = np.column_stack([_about(W123, body.centre), wrenches_of(four, n)])
            W[3:] /= unit
            smallest = _smallest_push(W)
            if smallest > 0.0:
                tried.append((smallest, (u, u, w), four[:3] + body.centre))
    tried.sort(key=lambda t: -t[0])
    return [(faces, points) for _, faces, points in tried[:FINISHED]]


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
    places = np.vstack([face.centre, face.centre + TOWARD_CORNER * (face.vertices - face.centre)])
    return places[face.contains(places)]


def _smallest_push(W: np.ndarray) -> float:
    """Smallest of the pushes (of sum 1) that balance seven wrenches (6, 7)."""
    try:
        pushes = np.linalg.solve(np.vstack([W, np.ones(7)]), np.r_[np.zeros(6), 1.0])
    except np.linalg.LinAlgError:
        return 0.0
    return float(pushes.min())


def _about(W: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Wrenches (6, N) about another point."""
    return np.vstack([W[:3], W[3:] - np.cross(point, W[:3], axisb=0).T])
