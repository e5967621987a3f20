r"""Where small grippers sit, and which contacts rigid hands reach (thesis, 2.2.3).

**Corners.**  A gripper with three fingers reaches a corner where exactly three faces meet and each
edge between them is convex.  Its frame is tied to the corner and to one of the faces, so that a
gripper has the same coordinates of its fingertips on every body that has the same corner.

**Hands that come from one side.**  A rigid hand that comes along d clears faces with the inward
normals :math:`e_i` when :math:`e_i \cdot d > 0` for all of them.  The smallest of these sines is
its *clearance*; the largest clearance belongs to the direction of

.. math:: \min |y| \quad\text{with}\quad e_i \cdot y \ge 1 ,

and is :math:`1 / |y|`.  Seven contacts can always be shared by two hands with clearances of 1/7 at
least: directions with :math:`|e_i \cdot d| < s` cover the part s of the unit sphere, so that below
s = 1/7 some d is left over by all seven, and its sign tells to which hand a contact belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import BodyClass
from multiarm.grasp.body.face import frame_of
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.programs import least_distance

Three = tuple[int, int, int]
"""Numbers of three faces."""


def convex_corner(body: Polyhedron, vertex: int) -> bool:
    """Whether exactly three faces meet at a vertex, each edge between them convex.

    Three fingers of a gripper reach such a corner from outside.
    """
    meeting = body.corners[vertex]
    if len(meeting) != 3:
        return False
    for number in meeting:
        loop = next((loop for loop in body.loops[number] if vertex in loop), ())
        at = loop.index(vertex)
        ends = body.vertices[[loop[at - 1], loop[(at + 1) % len(loop)]]] - body.vertices[vertex]
        if (ends @ body.normals[list(meeting)].T).max() > body.off_plane:
            return False
    return True


def opposite_corner(body_class: BodyClass, body: Polyhedron, faces: Sequence[int]) -> Three:
    """The faces opposite to three that meet at a corner, of a body with parallel faces.

    Raises
    ------
    GraspError
        The faces do not meet at a corner.
    """
    if len(faces) != 3 or shared_corner(body, faces) is None:
        raise GraspError(f"faces {faces} do not meet at a corner; each of the pairs gives one")
    across = dict(body_class.pairs) | {j: i for i, j in body_class.pairs}
    i, j, k = faces
    return across[i], across[j], across[k]


def shared_corner(body: Polyhedron, faces: Sequence[int]) -> int | None:
    """The convex corner where exactly these faces meet, or None."""
    for vertex, meeting in enumerate(body.corners):
        if set(faces) == set(meeting) and convex_corner(body, vertex):
            return vertex
    return None


def nearest_corner_frame(body: Polyhedron, points: np.ndarray, seat: int) -> np.ndarray:
    """Frame of a gripper at the corner of a face that is nearest to its contacts."""
    ends = list(body.loops[seat][0])
    away = np.linalg.norm(body.vertices[ends] - points.mean(axis=0), axis=1)
    return corner_frame(body, ends[int(np.argmin(away))], seat)


def corner_frame(body: Polyhedron, vertex: int, seat: int) -> np.ndarray:
    """A gripper's frame at a corner, shape (4, 4): the same wherever the corner is the same.

    The origin is the corner, z points into the body along the normal of the face ``seat``, x runs
    along the edge of this face that arrives at the corner (counter-clockwise from outside), and
    y points into the face.
    """
    loop = next(loop for loop in body.loops[seat] if vertex in loop)
    at = loop.index(vertex)
    before = body.vertices[loop[at - 1]] - body.vertices[vertex]
    return frame_of(-body.faces[seat].normal, before, body.vertices[vertex])


def gripper_frame(body: Polyhedron, faces: Sequence[int], points: np.ndarray) -> np.ndarray:
    """Frame of a gripper at the corner that the faces of its contacts share, or else near them."""
    corner = shared_corner(body, faces)
    if corner is None:
        return nearest_corner_frame(body, points, faces[-1])
    return corner_frame(body, corner, faces[-1])


def feet(body: Polyhedron, faces: Three, point: np.ndarray) -> np.ndarray:
    """Feet of a point on the planes of faces, shape (3, 3): contacts whose lines meet in it."""
    n = body.normals[list(faces)]
    heights = np.array([body.faces[k].offset for k in faces]) - n @ point
    return point + heights[:, None] * n


# --- Hands that come from one side ----------------------------------------------------------------

# Clearances are rounded by less than this part of themselves.
ROUNDED = 1e-9


def clearest_approach(inward: np.ndarray) -> tuple[np.ndarray, float]:
    """The direction (3,) in which a hand clears faces best, and how well.

    Parameters
    ----------
    inward : ndarray, shape (N, 3)
        Normals of the faces, into the body.

    Returns
    -------
    direction : ndarray, shape (3,)
        Towards the body, a unit vector.
    clearance : float
        The smallest ``e . direction``, the sine of the angle between the direction and a face; 0
        where no direction clears all faces.
    """
    shortest = least_distance(inward, np.ones(len(inward)))
    if not shortest.solved:
        return np.zeros(3), 0.0
    length = float(np.linalg.norm(shortest.point))
    return shortest.point / length, 1.0 / length


def hands_reach(inward: np.ndarray, groups: Sequence[tuple[int, ...]]) -> bool:
    """Whether a hand reaches each group of contacts with normals (N, 3) from one side."""
    return all(hand_reaches(inward[list(group)], len(inward)) for group in groups)


def hand_reaches(inward: np.ndarray, contacts: int = 7) -> bool:
    """Whether a hand clears faces with normals (K, 3) by one over the number of all contacts."""
    return clearest_approach(inward)[1] >= (1.0 - ROUNDED) / contacts


def two_groups(contacts: Contacts) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The split in two groups with the smallest larger diameter, of those that hands can reach.

    Each hand comes from one side, with a clearance of one over the number of contacts at least.
    """
    points, inward = contacts.points, contacts.normals
    away = np.linalg.norm(points[:, None] - points[None], axis=-1)
    numbers = range(len(points))
    splits = []
    for count in range(1, len(points) // 2 + 1):
        for second in combinations(numbers, count):
            first = tuple(j for j in numbers if j not in second)
            largest = max(away[np.ix_(group, group)].max() for group in (first, second))
            splits.append((float(largest), first, second))
    splits.sort(key=lambda split: (split[0], split[2]))
    return next(split[1:] for split in splits if hands_reach(inward, split[1:]))
