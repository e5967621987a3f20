r"""Three contacts with independent moments: the remaining conditions of independence.

The moment of a push at p along e about a point o is :math:`m = (p - o) \times e = c \times e`,
where :math:`c = (p - o) - (e \cdot (p - o)) e` leads from the projection of o onto the face to the
contact: m is c turned by -90 degrees about e (thesis, A.3).  The three moments are independent
exactly when :math:`\det [m_1\,m_2\,m_3] \ne 0`; in the faces this reads (thesis, 2.2.1, A.4)

1. no contact is at the projection of o: c is not zero;
2. for two faces that are not parallel, not both c are perpendicular to the faces' intersection;
3. for two parallel faces, the same or different ones, the two c are not parallel;
4. the three normal lines do not meet at one point;
5. the faces are not all parallel;
6. with A the plane of two of the moments, not parallel to the third face, the third c is not
   perpendicular to the line in which A meets that face; A may not be parallel to it.

With rule 3 extended to different parallel faces, which the thesis leaves out, the rules together
are equivalent to the determinant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts
from multiarm.grasp.necessary_conditions import INCIDENCE, Violation, incidence, named


@dataclass(frozen=True, eq=False)
class ThreeMoments:
    """Moments of three pushes; the truth value is ``independent``.

    Attributes
    ----------
    independent : bool
        ``det != 0``, of the moments' directions: more than 1e-9.
    moments : ndarray, shape (3, 3)
        Row i is ``m_i`` [m].
    offsets : ndarray, shape (3, 3)
        Row i is ``c_i``: from the projection of o onto the face to contact i [m].
    determinant : float
        ``det [m_1 m_2 m_3]`` [m^3].
    violations : tuple of Violation
        Rules that are broken; none when independent, but for the tolerance.
    """

    independent: bool
    moments: np.ndarray
    offsets: np.ndarray
    determinant: float
    violations: tuple[Violation, ...]

    def __bool__(self) -> bool:
        return self.independent


def three_moments(
    contacts: Contacts | HeldByContacts, about: Any = (0.0, 0.0, 0.0)
) -> ThreeMoments:
    """Decide whether the moments of three contacts are independent, and which rules say no.

    Parameters
    ----------
    contacts : Contacts
        Three, in space.
    about : array-like, shape (3,)
        The point o [m].

    Raises
    ------
    GraspError
        Not three contacts in space, or no point.
    """
    contacts = as_contacts(contacts)
    if contacts.dimension != 3 or contacts.count != 3:
        raise GraspError(f"the rules are about three contacts in space, not {contacts.count}")
    o = point_of(about)
    e, arms = contacts.normals, contacts.points - o
    offsets = arms - np.sum(arms * e, axis=1)[:, None] * e
    moments = np.cross(arms, e)
    reach = float(np.linalg.norm(arms, axis=1).max()) or 1.0
    tolerance = incidence(contacts.points, reach)
    sizes = np.linalg.norm(offsets, axis=1)
    absent = sizes <= tolerance * reach
    c = np.where(absent[:, None], 0.0, offsets / np.where(absent, 1.0, sizes)[:, None])
    broken = sorted(_broken(contacts, c, arms / reach, tolerance), key=lambda rule: rule.condition)
    independent = bool(abs(np.linalg.det(np.cross(c, e))) > tolerance)
    determinant = float(np.linalg.det(moments))
    return ThreeMoments(independent, moments, offsets, determinant, tuple(broken))


def point_of(values: Any) -> np.ndarray:
    """A point of space; a GraspError if it is none."""
    point = np.asarray(values, dtype=float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise GraspError(f"a point has three finite coordinates, not {values!r}")
    return point


def meeting_point(
    points: np.ndarray, normals: np.ndarray, tolerance: float = INCIDENCE
) -> np.ndarray | None:
    """Point where lines of not all parallel directions meet, or None.

    ``tolerance`` is a part of the distances between the points, and from them.
    """
    projectors = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    middle = points.mean(axis=0)
    arms = points - middle
    sides = np.einsum("jab,jb->a", projectors, arms)
    found = np.linalg.solve(projectors.sum(axis=0), sides)
    off = np.einsum("jab,jb->ja", projectors, arms - found)
    size = max(float(np.abs(arms).max()), float(np.abs(found).max()))
    return found + middle if np.abs(off).max() <= tolerance * size else None


def _broken(
    contacts: Contacts, c: np.ndarray, arms: np.ndarray, tolerance: float
) -> Iterator[Violation]:
    """Broken rules, from directions of the offsets (or zeros) and points about o."""
    e = contacts.normals
    for i in np.flatnonzero(~c.any(axis=1)).tolist():
        name = contacts.names[i]
        yield Violation(1, (i,), f"the normal line of {name} passes through the point of reference")
    for i, j in combinations(range(3), 2):
        yield from _pair(contacts, c, (i, j), tolerance)
    sines = np.linalg.norm(np.cross(e[0], e[1:]), axis=1)
    if sines.max() <= tolerance:
        yield Violation(5, (0, 1, 2), "all three faces are parallel")
    elif meeting_point(arms, e, tolerance) is not None:
        yield Violation(4, (0, 1, 2), "the three normal lines meet at a point")
    for i in range(3):
        yield from _third(contacts, c, i, tolerance)


def _pair(
    contacts: Contacts, c: np.ndarray, pair: tuple[int, int], tolerance: float
) -> Iterator[Violation]:
    """Rules 2 and 3 for two contacts."""
    i, j = pair
    along = np.cross(contacts.normals[i], contacts.normals[j])
    sine = float(np.linalg.norm(along))
    who = named(contacts, pair)
    if sine <= tolerance:
        if np.linalg.norm(np.cross(c[i], c[j])) <= tolerance:
            yield Violation(3, pair, f"{who} are on parallel faces and their offsets are parallel")
    elif max(abs(c[i] @ along), abs(c[j] @ along)) <= tolerance * sine:
        words = f"the offsets of {who} are both perpendicular to the intersection of their faces"
        yield Violation(2, pair, words)


def _third(contacts: Contacts, c: np.ndarray, i: int, tolerance: float) -> Iterator[Violation]:
    """Rule 6 for contact i: its offset and the plane of the other two moments."""
    e = contacts.normals
    j, k = (number for number in range(3) if number != i)
    normal = np.cross(np.cross(c[j], e[j]), np.cross(c[k], e[k]))
    if np.linalg.norm(normal) <= tolerance:
        return  # rules 1 to 3 have said so
    name = contacts.names[i]
    along = np.cross(e[i], normal)
    if np.linalg.norm(along) <= tolerance:
        words = f"the plane of the other two moments is parallel to the face of {name}"
        yield Violation(6, (i,), words)
    elif abs(c[i] @ along) <= tolerance:
        words = (
            f"the offset of {name} is perpendicular to the line in which the plane of the other "
            f"two moments meets its face"
        )
        yield Violation(6, (i,), words)
