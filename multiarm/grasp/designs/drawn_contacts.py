r"""Seven contacts anywhere on a body, found by drawing and improving (thesis, 2.2.2).

A tetrahedron is in none of the classes of the thesis, yet seven frictionless contacts on its four
faces can close it, as they can any body without an axis of revolution (Markenscoff, Ni and
Papadimitriou 1990).  The search has two steps.

1. Places are drawn evenly over the body's surface.  Seven of them close it when the only balance of
   their wrenches has positive pushes alone (see `smallest_pushes`): one small linear system a draw,
   solved for many draws at once.
2. Draws with the largest smallest push are improved.  One contact after the other goes to the
   middle of the region where it may be, given the six others (see `region_of`), as long as the
   grasp becomes firmer.

The caller passes the generator of the draws, so that a search can be repeated.
"""

from __future__ import annotations

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.boundaries import face_triangles
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.assembling import assembled, crosses_border, proven, smallest_pushes
from multiarm.grasp.designs.grippers import nearest_corner_frame, two_groups
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import region_of, seventh_contact_region

# Draws in a batch, batches at most, draws that are improved, and rounds of improvement.
DRAWS, BATCHES, IMPROVED, ROUNDS = 8192, 12, 4, 4
# Gain in firmness for which another round is worth while.
GAIN = 1.01


def search_grasp(body: Polyhedron, generator: np.random.Generator | None = None) -> Grasp:
    """Seven contacts that hold a body, found by drawing and improving.

    Parameters
    ----------
    body : Polyhedron
    generator : numpy.random.Generator, optional
        Where the draws come from; the same one each time otherwise.

    Returns
    -------
    Grasp
        The contacts in two groups that hands reach, as compact as can be; gripper 1 carries the
        larger.

    Raises
    ------
    GraspError
        No draw closed the body.
    """
    draw = np.random.default_rng(0) if generator is None else generator
    best: tuple[Contacts, tuple[int, ...]] | None = None
    for faces, points in _draws(body, draw):
        contacts = Contacts.along(points, -body.normals[list(faces)])
        contacts = _improved(body, contacts, faces)
        if best is None or _firmness(contacts) > _firmness(best[0]):
            best = contacts, faces
    if best is None:
        raise GraspError(
            f"none of {DRAWS * BATCHES} draws of seven contacts closes the body; if it is nearly a "
            f"body of revolution, nothing can; otherwise pass another generator"
        )
    return _grasp(body, *best)


def _draws(
    body: Polyhedron, generator: np.random.Generator
) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """Faces and places of the closed draws with the largest smallest push."""
    draws: list[tuple[float, tuple[int, ...], np.ndarray]] = []
    for _ in range(BATCHES):
        faces, points = _surface_points(body, (DRAWS, 7), generator)
        smallest = smallest_pushes(body, points, -body.normals[faces])
        order = np.argsort(-smallest)[:IMPROVED]
        draws.extend(
            (float(smallest[k]), tuple(faces[k].tolist()), points[k])
            for k in order
            if smallest[k] > 0.0
        )
        if len(draws) >= IMPROVED:
            break
    draws.sort(key=lambda draw: -draw[0])
    return [(faces, points) for _, faces, points in draws[:IMPROVED]]


def _surface_points(
    body: Polyhedron, shape: tuple[int, int], generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Faces (K, 7) and points (K, 7, 3), evenly over the surface."""
    triangles, owner = [], []
    for number, face in enumerate(body.faces):
        corners = np.vstack([face.vertices, *face.holes])
        for triangle in face_triangles(face):
            triangles.append(corners[list(triangle)])
            owner.append(number)
    T = np.array(triangles)  # (M, 3 corners, 3)
    areas = np.linalg.norm(np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0]), axis=1)
    chosen = generator.choice(len(T), size=shape, p=areas / areas.sum())
    u, v = np.sqrt(generator.random(shape)), generator.random(shape)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=-1)
    numbers = np.array(owner)[chosen]
    return numbers, body.on_faces(numbers, np.einsum("knc,kncx->knx", weights, T[chosen]))


def _improved(body: Polyhedron, contacts: Contacts, faces: tuple[int, ...]) -> Contacts:
    """Each contact in turn in the middle of its region, while that makes the grasp firmer."""
    firmness = _firmness(contacts)
    for _ in range(ROUNDS):
        before = firmness
        for j, number in enumerate(faces):
            moved = _centred(body, contacts, j, number)
            if _firmness(moved) > firmness:
                contacts, firmness = moved, _firmness(moved)
        if firmness <= GAIN * before:
            break
    return contacts


def _centred(body: Polyhedron, contacts: Contacts, j: int, number: int) -> Contacts:
    """The contacts with number j in the middle of its region."""
    region = region_of(contacts, j, body.faces[number])
    if not region:
        return contacts
    points = contacts.points.copy()
    points[j] = region.best_point()
    return Contacts.along(points, contacts.normals)


def _firmness(contacts: Contacts) -> float:
    return is_form_closure(contacts).distance


def _grasp(body: Polyhedron, contacts: Contacts, faces: tuple[int, ...]) -> Grasp:
    first, second = two_groups(contacts)
    order = [*first, *second]
    on = [faces[j] for j in order]
    points = contacts.points[order]
    split = [tuple(range(len(first))), tuple(range(len(first), len(order)))]
    frames = [nearest_corner_frame(body, points[list(part)], on[part[0]]) for part in split]
    note = "found by search: the contacts fit this body, and not others of its shape"
    grasp = assembled(body, points, on, split, frames, (note,))
    region = seventh_contact_region(grasp.contacts.subset(range(6)), body.faces[on[6]])
    return proven(grasp, crosses_border(grasp, region), "pass another generator")
