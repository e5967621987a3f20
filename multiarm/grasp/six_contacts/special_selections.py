r"""Six contacts whose independence three moments decide (thesis, 2.2.1, A.3 to A.5).

* **Case I**: three contacts on faces of different directions, and the same three mirrored in the
  middle of a body with parallel faces.  Then :math:`T_1 = I`, :math:`a = 2 a_A`: independent when
  the normals are, and the moments of the three about the middle.
* **Case II**: three independent normals whose lines meet at a point.  About it :math:`a_A = 0` and
  :math:`a = a_B`: independent when the moments of the other three about it are.
* **Case III**: two normal lines that meet at a point, three parallel normals
  :math:`e_{3,4,5} = s_k e` and a sixth contact.  With moments about that point

  .. math::
      \det W = \pm\det[e_1\,e_2\,e] \; e \cdot \big((\tilde m_4 - \tilde m_3) \times
      (\tilde m_5 - \tilde m_3)\big) \; e \cdot m_6, \qquad \tilde m_k = s_k m_k :

  independent when (a) e is not in the plane of the first two normals; (b) the three contacts,
  seen along e, are not on a line; (c) the sixth normal is not parallel to e, and its line does not
  lie in a plane with the line along e through the point.

The printed conditions of Case III are weaker in (a) and (b) and let dependent contacts pass.

**Three independent moments.**  The moment of a push at p along e about a point o is
:math:`m = (p - o) \times e = c \times e`, where :math:`c = (p - o) - (e \cdot (p - o)) e` leads
from the projection of o onto the face to the contact: m is c turned by -90 degrees about e (thesis,
A.3).  The three moments are independent exactly when :math:`\det [m_1\,m_2\,m_3] \ne 0`; in the
faces this reads (thesis, 2.2.1, A.4)

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
from multiarm.grasp.arguments import numbers_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space, nearest_to_lines
from multiarm.grasp.six_contacts.necessary_conditions import INCIDENCE, Violation, incidence, named

POINT = "a point has three finite coordinates"


def case_I(points: Any, normals: Any, centre: Any = (0.0, 0.0, 0.0)) -> Contacts:
    """Six independent contacts: three, and their mirror images in a point.

    Parameters
    ----------
    points : array-like, shape (3, 3)
        One contact on each of three faces [m].
    normals : array-like, shape (3, 3)
        Unit vectors into the body.
    centre : array-like, shape (3,)
        Middle of a body with parallel faces [m].

    Raises
    ------
    GraspError
        Dependent normals, or moments that break the rules for three moments; which, in words.
    """
    three = contacts_in_space(Contacts(points, normals), 3, 3)
    middle = numbers_of(centre, POINT, (3,))
    _check_normals(three, "Case I", "three faces of independent directions")
    _check_moments(three, middle, "Case I")
    return three.joined(Contacts(2.0 * middle - three.points, -three.normals))


def case_II(points: Any, normals: Any) -> Contacts:
    """Six independent contacts, the first three with normal lines through one point.

    Parameters
    ----------
    points, normals : array-like, shape (6, 3)
        [m]; unit vectors into the body.  The first three may be on curved faces.

    Raises
    ------
    GraspError
        First three normals that are dependent or whose lines do not meet, or other three whose
        moments about that point break the rules for three moments; which, in words.
    """
    six = contacts_in_space(Contacts(points, normals), 6, 6)
    first, last = six.subset(range(3)), six.subset(range(3, 6))
    _check_normals(first, "Case II", "first three normals that are independent")
    meeting = _meeting(first)
    if meeting is None:
        raise GraspError(
            f"Case II takes three normal lines that meet at a point; those of "
            f"{named(six, (0, 1, 2))} do not"
        )
    _check_moments(last, meeting, "Case II")
    return six


def case_III(points: Any, normals: Any) -> Contacts:
    """Six independent contacts: two normal lines that meet, three parallel ones, and one more.

    Parameters
    ----------
    points, normals : array-like, shape (6, 3)
        [m]; unit vectors into the body.  Contacts 3 to 5 have parallel normals of either sense.

    Raises
    ------
    GraspError
        Lines 1 and 2 that do not meet, normals 3 to 5 that are not parallel, or one of the
        conditions (a), (b), (c) of the module; which, in words.
    """
    six = contacts_in_space(Contacts(points, normals), 6, 6)
    e, e1, e2 = six.normals[2], six.normals[0], six.normals[1]
    meeting = None
    if np.linalg.norm(np.cross(e1, e2)) > INCIDENCE:
        meeting = _meeting(six.subset((0, 1)))
    if meeting is None:
        raise GraspError(
            f"Case III takes two normal lines that meet at one point; those of "
            f"{named(six, (0, 1))} do not"
        )
    if np.linalg.norm(np.cross(e, six.normals[3:5]), axis=1).max() > INCIDENCE:
        raise GraspError(
            f"Case III takes three parallel normals; those of {named(six, (2, 3, 4))} are not"
        )
    broken = [words for words in _faults_of_case_III(six, e, meeting) if words]
    if broken:
        raise GraspError(f"the six wrenches are dependent: {'; '.join(broken)}")
    return six


def _faults_of_case_III(six: Contacts, e: np.ndarray, meeting: np.ndarray) -> list[str]:
    arms = six.points - meeting
    size = float(np.linalg.norm(arms, axis=1).max())
    tolerance = incidence(six.points, size)
    e1, e2, e6 = six.normals[0], six.normals[1], six.normals[5]
    across = arms[3:5] - arms[2]
    across -= np.outer(across @ e, e)
    widths = np.linalg.norm(across, axis=1)
    area = np.linalg.norm(np.cross(*across))
    lever = float(e @ np.cross(arms[5], e6))
    faults = []
    if abs(np.linalg.det([e1, e2, e])) <= tolerance * np.linalg.norm(np.cross(e1, e2)):
        faults.append(
            f"(a) the parallel normals of {named(six, (2, 3, 4))} lie in the plane of the "
            f"normals of {named(six, (0, 1))}"
        )
    if widths.min() <= tolerance * size or area <= tolerance * widths.max() ** 2:
        faults.append(f"(b) {named(six, (2, 3, 4))}, seen along their normals, are on one line")
    if abs(lever) <= tolerance * size:
        faults.append(
            f"(c) the normal line of {six.names[5]} lies in a plane with the line along the "
            f"parallel normals through the point where the first two meet"
        )
    return faults


def _meeting(contacts: Contacts) -> np.ndarray | None:
    tolerance = incidence(contacts.points, contacts.length)
    return meeting_point(contacts.points, contacts.normals, tolerance)


def _check_normals(three: Contacts, case: str, what: str) -> None:
    if abs(np.linalg.det(three.normals)) <= INCIDENCE:
        raise GraspError(f"{case} takes {what}; those of {named(three, (0, 1, 2))} lie in a plane")


def _check_moments(three: Contacts, about: np.ndarray, case: str) -> None:
    moments = three_moments(three, about)
    if not moments:
        broken = "; ".join(f"rule {v.condition}: {v.words}" for v in moments.violations)
        point = ", ".join(f"{x:.4g}" for x in about)
        raise GraspError(
            f"{case}: the moments of {named(three, (0, 1, 2))} about ({point}) are dependent "
            f"({broken})"
        )


# --- Rules for three moments ----------------------------------------------------------------------


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
    contacts, o = contacts_in_space(contacts, 3, 3), numbers_of(about, POINT, (3,))
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


def meeting_point(
    points: np.ndarray, normals: np.ndarray, tolerance: float = INCIDENCE
) -> np.ndarray | None:
    """Point where lines of not all parallel directions meet, or None.

    ``tolerance`` is a part of the distances between the points, and from them.
    """
    middle = points.mean(axis=0)
    arms = points - middle
    nearest, off = nearest_to_lines(arms, normals)
    size = max(float(np.abs(arms).max()), float(np.abs(nearest).max()))
    return nearest + middle if np.abs(off).max() <= tolerance * size else None


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
