r"""From places on faces to a grasp that is known to hold: assembly and verification.

Every designed grasp is verified.  It has to pass the test of form closure, and its last contact is
moved across the bound that the design's formula gives: just beyond the bound the grasp must be
closed, just before it open.

**How evenly seven contacts balance**, for many choices at once.  Seven wrenches of rank 6 have one
balance of sum 1,

.. math::
    \begin{bmatrix} W \\ 1 \cdots 1 \end{bmatrix} \lambda =
    \begin{bmatrix} 0 \\ 1 \end{bmatrix} ,

and close the body when all of it is positive.  The smallest push ranks choices;
`is_form_closure` then judges those that are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import number_of
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.balances import balance_inverses
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts, wrenches_of
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import ContactRegion

# Rounds in which a pattern is scaled to the wanted size, which is nearly proportional to its depth,
# beginning with a pattern that is small against its usual depth.
ROUNDS, SIZE_TOLERANCE, BEGINNING = 12, 1e-6, 1e-2
# A bound is crossed by this part of itself.
ACROSS = 1e-3
# The remedy where lengths are given, and rounding decides about closure.
OTHER_LENGTHS = (
    "choose a larger distance of contact 7, or offsets that are larger or more different"
)


def assembled(
    body: Polyhedron,
    points: np.ndarray,
    faces: Sequence[int],
    split: Sequence[tuple[int, ...]],
    frames: Sequence[np.ndarray],
    notes: Sequence[str] = (),
) -> Grasp:
    """A grasp of contacts at points of the faces, carried by grippers with the given frames.

    Points are moved onto the planes of their faces: those of a body from a file are parallel or
    perpendicular to some seven digits only.

    Raises
    ------
    GraspError
        A contact outside its face.
    """
    places = body.on_faces(faces, points)
    for j, (point, number) in enumerate(zip(places, faces, strict=True)):
        face = body.faces[number]
        room = float(face.room(point))
        if not room > 0.0:
            raise GraspError(
                f"the grippers are too large for the object: contact {j + 1} would be "
                f"{-room:.4g} m outside {face.name}; choose smaller offsets"
            )
    contacts = Contacts.along(places, -body.normals[list(faces)])
    grippers = tuple(
        Gripper(f"gripper {k + 1}", numbers, frame)
        for k, (numbers, frame) in enumerate(zip(split, frames, strict=True))
    )
    return Grasp(body, contacts, tuple(faces), grippers, tuple(notes))


def proven(grasp: Grasp, crosses_bound: bool, remedy: str = OTHER_LENGTHS) -> Grasp:
    """A grasp that is closed and opens where its design says so.

    Raises
    ------
    GraspError
        It does not: the design is right, so that rounding must have decided.
    """
    if not (grasp.closure and crosses_bound):
        raise GraspError(f"the grasp hangs on rounding: {remedy}")
    return grasp


def crosses(grasp: Grasp, point_at: Callable[[float], np.ndarray], bound: float) -> bool:
    """Whether the grasp opens where the last contact comes nearer than its bound.

    Parameters
    ----------
    grasp : Grasp
        Its last contact is moved in its plane.
    point_at : callable
        The contact's place at a distance [m].
    bound : float
        The distance beyond which the grasp is closed [m].
    """
    six, e7 = grasp.contacts.subset(range(6)), grasp.contacts.normals[6]

    def closed(distance: float) -> bool:
        seven = six.joined(Contacts.along([point_at(distance)], [e7]))
        closure = is_form_closure(seven)
        return is_form_closure(seven, exact=True).closed if closure.borderline else closure.closed

    return closed((1.0 + ACROSS) * bound) and not closed((1.0 - ACROSS) * bound)


def crosses_border(grasp: Grasp, region: ContactRegion) -> bool:
    """Whether the grasp opens where its last contact crosses the nearest border of its region.

    That is the nearest line of ``region.half_planes``; a region without any cannot be left.
    """
    if not len(region.half_planes):
        return True
    last, face = grasp.contacts.points[6], region.face
    slopes, levels = region.half_planes[:, :2], region.half_planes[:, 2]
    rooms = levels - slopes @ face.coordinates(last)
    nearest = int(np.argmin(rooms))
    bound = float(rooms[nearest])
    outward = face.frame[:3, :2] @ slopes[nearest]
    return crosses(grasp, lambda room: last + (2.0 * bound - room) * outward, bound)


def largest_gripper(grasp: Grasp) -> float:
    """Largest distance between two contacts of one gripper [m]."""
    return max(grasp.gripper_size(gripper.name) for gripper in grasp.grippers)


def length_of(value: Any, what: str) -> float:
    """A length [m]; a GraspError if it is no finite number."""
    return number_of(value, f"{what} is a finite length in metres")


def size_of_gripper(value: Any) -> float | None:
    """The requested size of a gripper [m] or None; a GraspError if it is not positive."""
    if value is None:
        return None
    length_of(value, "the size of a gripper")
    return number_of(value, "the size of a gripper is a positive length", above=0.0)


def sized(at_depth: Callable[[float], Grasp], depth: float, gripper_size: float | None) -> Grasp:
    """The grasp ``at_depth(depth)``, or the one whose largest gripper has the wanted size.

    Raises
    ------
    GraspError
        A size that does not fit, or one that no depth was found for.
    """
    if gripper_size is None:
        return at_depth(depth)
    deep = BEGINNING * depth
    for _ in range(ROUNDS):
        grasp = at_depth(deep)
        size = largest_gripper(grasp)
        if abs(size - gripper_size) <= SIZE_TOLERANCE * gripper_size:
            return grasp
        deep *= gripper_size / size
    raise GraspError(
        f"no grasp with grippers of {gripper_size:g} m was found: the last one of {ROUNDS} has "
        f"{size:.4g} m; choose another size, or leave it out"
    )


# --- How evenly seven contacts balance ------------------------------------------------------------

# Choices in one go: some 50 MB.
CHOICES = 50_000


def smallest_pushes(body: Polyhedron, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Smallest push of each choice of seven contacts, shape (K,); 0 when they are dependent.

    Parameters
    ----------
    body : Polyhedron
        Its centre and size make wrenches comparable.
    points, normals : ndarray, shape (K, 7, 3)
        Places, and unit normals into the body.
    """
    smallest = []
    for part in np.array_split(np.arange(len(points)), 1 + len(points) // CHOICES):
        W = wrenches_of((points[part] - body.centre) / body.size, normals[part])  # (6, K, 7)
        smallest.append(balance_inverses(np.moveaxis(W, 0, 2))[..., 6].min(axis=1))
    return np.concatenate(smallest)
