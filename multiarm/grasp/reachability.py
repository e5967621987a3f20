r"""Which contacts rigid hands reach, each from one side.

A rigid hand that comes along d clears faces with the inward normals :math:`e_i` when
:math:`e_i \cdot d > 0` for all of them.  The smallest of these sines is its *clearance*; the
largest clearance belongs to the direction of

.. math:: \min |y| \quad\text{with}\quad e_i \cdot y \ge 1 ,

and is :math:`1 / |y|`.  Seven contacts can always be shared by two hands with clearances of 1/7 at
least: directions with :math:`|e_i \cdot d| < s` cover the part s of the unit sphere, so that below
s = 1/7 some d is left over by all seven, and its sign tells to which hand a contact belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from multiarm.grasp.contacts import Contacts
from multiarm.programs import least_distance

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
