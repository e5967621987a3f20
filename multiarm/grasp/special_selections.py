r"""Three ways to six independent contacts by a look at three moments (thesis, 2.2.1, A.5).

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
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.moment_rules import meeting_point, point_of, three_moments
from multiarm.grasp.necessary_conditions import INCIDENCE, incidence, named, six_in_space


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
    three = _contacts(points, normals, 3)
    middle = point_of(centre)
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
    six = _contacts(points, normals, 6)
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
    six = _contacts(points, normals, 6)
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


def _contacts(points: Any, normals: Any, count: int) -> Contacts:
    given = Contacts(points, normals)
    if count == 6:
        six_in_space(given)
    elif given.dimension != 3 or given.count != count:
        raise GraspError(f"Case I takes {count} contacts in space, not {given.count}")
    return given


def _check_normals(three: Contacts, case: str, what: str) -> None:
    if abs(np.linalg.det(three.normals)) <= INCIDENCE:
        raise GraspError(f"{case} takes {what}; those of {named(three, (0, 1, 2))} lie in a plane")


def _check_moments(three: Contacts, about: np.ndarray, case: str) -> None:
    found = three_moments(three, about)
    if not found:
        broken = "; ".join(f"rule {v.condition}: {v.words}" for v in found.violations)
        point = ", ".join(f"{x:.4g}" for x in about)
        raise GraspError(
            f"{case}: the moments of {named(three, (0, 1, 2))} about ({point}) are dependent "
            f"({broken})"
        )
