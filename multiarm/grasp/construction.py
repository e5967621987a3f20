r"""A grasp for a given body: the construction that fits its class, or a search.

===============================  ==============================  ==========================
body                             construction                    source
===============================  ==============================  ==========================
block                            `design_block_grasp`            thesis, 2.2.3.1
three pairs of parallel faces    `design_parallel_grasp`         2.2.3.2, Example 2.3
wider class                      `design_wide_grasp`             2.2.3.3
others, such as a tetrahedron    `search_grasp`                  2.2.2, region by region
===============================  ==============================  ==========================

A body of revolution is refused: no frictionless contacts hold it.  So is a mesh of such a body,
although its facets would give the contacts a little lever.

**Search.**  A tetrahedron is in none of the classes of the thesis, yet seven frictionless contacts
on its four faces can close it, as they can any body without an axis of revolution (Markenscoff, Ni
and Papadimitriou 1990).  The search has two steps.

1. Places are drawn evenly over the body's surface.  Seven of them close it when the only balance of
   their wrenches has positive pushes alone (see `smallest_pushes`): one small linear system a draw,
   solved for many draws at once.
2. Draws with the largest smallest push are improved.  One contact after the other goes to the
   middle of the region where it may be, given the six others (see `seventh_contact`), as long as
   the grasp becomes firmer.

The draws come from a generator that is passed in, so that a search can be repeated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.assembling import (
    assembled,
    crosses_border,
    largest_gripper,
    nearest_corner_frame,
    proven,
    size_of_gripper,
    sized,
    smallest_pushes,
)
from multiarm.grasp.blocks import USUAL_OFFSET, design_block_grasp
from multiarm.grasp.body_class import BodyClass, as_polyhedron, classify, roundness
from multiarm.grasp.boundaries import face_triangles
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.form_closure import is_form_closure
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.parallel_bodies import design_parallel_grasp
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.reachability import two_groups
from multiarm.grasp.seventh_contact import region_of, seventh_contact_region
from multiarm.grasp.wide_design import design_wide_grasp


def design_grasp(
    body: Polyhedron,
    *,
    gripper_size: float | None = None,
    offset: float | None = None,
    seventh: float | None = None,
    generator: np.random.Generator | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Grasp:
    """A form-closure grasp of a polyhedron by two grippers, without friction.

    Parameters
    ----------
    body : Polyhedron
        Of any size and anywhere.
    gripper_size : float, optional
        Largest distance between two contacts of one gripper [m]; the constructions give grippers
        of this size, a search gives smaller ones or none.
    offset, seventh : float, optional
        A and E of the construction for blocks [m] (see `design_block_grasp`).
    generator : numpy.random.Generator, optional
        For the search, where one is needed.
    progress : bool or callable, optional
        Of the wider class, as in `design_wide_grasp`.

    Returns
    -------
    Grasp
        Seven contacts.  It is form-closed, and it opens where its last contact comes nearer than
        the bound in its notes.

    Raises
    ------
    GraspError
        A body of revolution; grippers that are too large for the body; offsets for a body that is
        no block; no grasp found.
    """
    body, gripper_size = as_polyhedron(body), size_of_gripper(gripper_size)
    nearly_round = _refuse_round(body)
    body_class = classify(body)
    if body_class.kind == "block":
        grasp = _block_grasp(body, gripper_size, offset, seventh)
    elif offset is not None or seventh is not None:
        raise GraspError(
            f"offset and seventh are lengths of the construction for blocks; this body is "
            f"{body_class.words}.  Give gripper_size, or nothing"
        )
    elif body_class.kind == "three pairs of parallel faces":
        grasp = design_parallel_grasp(body, gripper_size=gripper_size)
    else:
        grasp = _general_grasp(body, body_class, gripper_size, generator, progress)
    return grasp.noted(*nearly_round, f"the body is {body_class.words}")


def _refuse_round(body: Polyhedron) -> tuple[str, ...]:
    """Refuse a body of revolution; return a remark on one that may approximate such a body."""
    revolution = roundness(body)
    axis = ", ".join(f"{x:.3g}" for x in np.round(revolution.axis, 3) + 0.0)
    if revolution:
        raise GraspError(
            f"the body is one of revolution about the axis ({axis}) through its centre, or a mesh "
            f"of one: all normal lines pass within {revolution.distance:.3g} m of the axis, so "
            f"that no frictionless contact keeps it from turning; give it a flat, a groove or a key"
        )
    if not revolution.nearly:
        return ()
    return (
        f"the body is nearly one of revolution about the axis ({axis}): contacts have levers of "
        f"{revolution.distance:.3g} m at most; if it is a mesh of a round body, nothing holds that",
    )


def _block_grasp(
    body: Polyhedron, gripper_size: float | None, offset: float | None, seventh: float | None
) -> Grasp:
    if gripper_size is None or offset is not None:
        if gripper_size is not None:
            raise GraspError("give the size of the grippers or the offset, not both")
        return design_block_grasp(body, offset=offset, seventh=seventh)
    edges = [body.faces[i].offset + body.faces[j].offset for i, j in classify(body).pairs]

    def with_offset(A: float) -> Grasp:
        return design_block_grasp(body, offset=A, seventh=seventh)

    return sized(with_offset, USUAL_OFFSET * min(edges), gripper_size)


def _general_grasp(
    body: Polyhedron,
    body_class: BodyClass,
    gripper_size: float | None,
    generator: np.random.Generator | None,
    progress: bool | Callable[[int, int, str], None] | None,
) -> Grasp:
    """The wider class when it can be, and a search otherwise."""
    if body_class.triples:
        try:
            return design_wide_grasp(body, gripper_size=gripper_size, progress=progress)
        except GraspError:
            pass  # the search may still find one; its notes say that it was a search
    grasp = search_grasp(body, generator)
    if gripper_size is not None and largest_gripper(grasp) > gripper_size:
        raise GraspError(
            f"the smallest grippers found for this body are {largest_gripper(grasp):.4g} m, not "
            f"{gripper_size:g} m; it is {body_class.words}, and small grippers need two corners "
            f"whose faces oppose each other"
        )
    return grasp


# --- Seven contacts anywhere on a body ------------------------------------------------------------

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
