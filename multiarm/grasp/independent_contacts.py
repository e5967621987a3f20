r"""Six contacts whose wrenches are independent: the base of every grasp with seven (thesis, 2.2).

With :math:`e_A = [e_1\,e_2\,e_3]`, :math:`e_B = [e_4\,e_5\,e_6]` and the moments
:math:`a_A = [p_1 \times e_1 \;..]`, :math:`a_B` likewise,

.. math::
    T_1 = -e_A^{-1} e_B, \qquad a = a_A T_1 + a_B, \qquad T_2 = -a^{-1} a_A,

.. math::
    \begin{bmatrix} e_A & e_B \\ a_A & a_B \end{bmatrix}^{-1} =
    \begin{bmatrix} (I + T_1 T_2) e_A^{-1} & T_1 a^{-1} \\ T_2 e_A^{-1} & a^{-1} \end{bmatrix},
    \qquad \det W = \det e_A \, \det a

(thesis, 2.2): the wrenches are independent exactly when :math:`e_A` and :math:`a` are regular.
Conditions on the normal lines say more about a failure than a determinant does.

**Necessary conditions** on the normal lines (thesis, 2.2.1, A.2).  Each violation leaves a rank of
5 or less:

1. no four normal lines meet at a point;
2. no four normals are parallel;
3. no four normal lines lie in a plane;
4. if three meet at X, the others are not parallel, do not meet at a point, and no two of them lie
   in a plane with X;
5. if three are parallel, the others do not meet at a point;
6. if three lie in a plane, no two of the others meet at a point of it.

They are not sufficient; the rank decides.  The rank of
lines does not change under projective maps, so parallel lines, which meet at infinity, obey 4, 5
and 6 as well, and the scan includes them.  With Plücker coordinates (e, m) of a line, the point
(x, w) is on it when ``x cross e = w m`` and ``x . m = 0``, and the plane ``n . y + c = 0`` holds it
when ``n . e = 0`` and ``m cross n + c e = 0``: a common point or plane of lines is a null vector of
these equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.balances import rounding, tolerance_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space


@dataclass(frozen=True, eq=False)
class BlockInverse:
    """Inverse of six wrenches by blocks.

    Attributes
    ----------
    order : tuple of int
        The contacts (numbers from 0) of e_A, then those of e_B: 0 to 5, unless the first three
        normals are dependent or nearly so.
    T1, a, T2 : ndarray, shape (3, 3)
        [1], [m], [1], of the contacts in that order; moments about the frame's origin.
    inverse : ndarray, shape (6, 6)
        ``W^-1``; row j belongs to contact j of the set as given.
    determinant : float
        ``det W`` of the set as given [m^3].
    """

    order: tuple[int, ...]
    T1: np.ndarray
    a: np.ndarray
    T2: np.ndarray
    inverse: np.ndarray
    determinant: float


@dataclass(frozen=True, eq=False)
class Independence:
    """Whether six wrenches are independent; its truth value is ``independent``.

    Attributes
    ----------
    independent : bool
    rank : int
    determinant : float
        ``det W`` [m^3]; it does not depend on the frame's origin.
    smallest_singular_value : float
        Of the scaled wrenches: how far the nearest dependent ones are.
    violations : tuple of Violation
        Necessary conditions that are not met; possibly none although the wrenches are dependent.
    dependent : tuple of int
        Contacts (numbers from 0) that take part in a dependency.
    message : str
    """

    independent: bool
    rank: int
    determinant: float
    smallest_singular_value: float
    violations: tuple[Violation, ...]
    dependent: tuple[int, ...]
    message: str

    def __bool__(self) -> bool:
        return self.independent


def block_inverse(contacts: Contacts | HeldByContacts) -> BlockInverse:
    """Invert the wrenches of six contacts by blocks (thesis, 2.2).

    Raises
    ------
    GraspError
        Not six contacts in space, or dependent ones; the message says why.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    found = independence(contacts)
    if not found:
        raise GraspError(f"{found.message}: there is no inverse")
    order = _leading_order(contacts.normals)
    picked = list(order)
    e, m = contacts.normals[picked].T, np.cross(contacts.points, contacts.normals)[picked].T
    e_A_inverse = np.linalg.inv(e[:, :3])
    T1, a = blocks_of(contacts.points[picked], contacts.normals[picked])
    a_inverse = np.linalg.inv(a)
    T2 = -a_inverse @ m[:, :3]
    inverse = np.empty((6, 6))
    inverse[picked[:3]] = np.hstack([(np.eye(3) + T1 @ T2) @ e_A_inverse, T1 @ a_inverse])
    inverse[picked[3:]] = np.hstack([T2 @ e_A_inverse, a_inverse])
    sign = float(np.round(np.linalg.det(np.eye(6)[picked])))
    determinant = sign * float(np.linalg.det(e[:, :3]) * np.linalg.det(a))
    return BlockInverse(order, T1, a, T2, inverse, determinant)


def blocks_of(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``T_1`` and ``a`` (3, 3) of six contacts, of which the first three make up ``e_A``."""
    e, m = normals.T, np.cross(points, normals).T
    T1 = -np.linalg.solve(e[:, :3], e[:, 3:])
    return T1, m[:, :3] @ T1 + m[:, 3:]


def independence(contacts: Contacts | HeldByContacts) -> Independence:
    """Decide whether the wrenches of six contacts are independent, and say why if not.

    They are dependent when the smallest singular value of the scaled wrenches is no more than
    1e-10 of the largest, and the rounding of points far from the origin.

    Raises
    ------
    GraspError
        Not six contacts in space.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    W = contacts.scaled_wrenches
    _, s, Vt = np.linalg.svd(W)
    rank = int(np.count_nonzero(s > tolerance_of(contacts) * s[0]))
    determinant = float(np.linalg.det(W)) * contacts.length**3
    if rank == 6:
        words = "the six wrenches are independent"
        return Independence(True, 6, determinant, float(s[-1]), (), (), words)
    violations = violated_conditions(contacts)
    parts = np.linalg.norm(Vt[rank:], axis=0)
    dependent = tuple(np.flatnonzero(parts > INCIDENCE * parts.max()).tolist())
    reason = "; ".join(violation.words for violation in violations)
    if not reason:
        reason = f"the wrenches of {named(contacts, dependent)} depend on each other"
    words = f"the six wrenches are dependent (rank {rank}): {reason}"
    return Independence(False, rank, determinant, float(s[-1]), violations, dependent, words)


def _leading_order(normals: np.ndarray) -> tuple[int, ...]:
    """Contacts of e_A first: the first three unless others are far more independent."""
    triples = list(combinations(range(6), 3))
    sizes = np.abs(np.linalg.det(normals[np.array(triples)]))
    chosen = triples[0] if sizes[0] > 1e-3 * sizes.max() else triples[int(np.argmax(sizes))]
    return (*chosen, *(j for j in range(6) if j not in chosen))


# --- Necessary conditions on the normal lines -----------------------------------------------------

# Sine of an angle, or distance over the spread of the contacts, that counts as none.
INCIDENCE = 1e-9


@dataclass(frozen=True)
class Violation:
    """A condition on contacts that is not met.

    Attributes
    ----------
    condition : int
        Its number in the thesis.
    contacts : tuple of int
        Numbers from 0 of those concerned.
    words : str
    """

    condition: int
    contacts: tuple[int, ...]
    words: str


def violated_conditions(contacts: Contacts | HeldByContacts) -> tuple[Violation, ...]:
    """Necessary conditions 1 to 6 that six contacts do not meet, with the contacts concerned.

    Lines count as meeting, parallel or coplanar within 1e-9 (of the spread of the contacts, or as
    the sine of an angle), and what rounding does to points far from the origin.  Of sets
    in sets only the largest is reported, and 4 to 6 only where they do not follow from 1 to 3.

    Raises
    ------
    GraspError
        Not six contacts in space.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    lines = _Lines(contacts)
    crowds = [*_crowds(contacts, lines)]
    crowded = [set(crowd.contacts) for crowd in crowds]
    found = list(crowds)
    for three in combinations(range(6), 3):
        if any(set(three) <= crowd for crowd in crowded):
            continue
        others = tuple(j for j in range(6) if j not in three)
        found += _around_point(contacts, lines, three, others)
        found += _around_plane(contacts, lines, three, others)
    return tuple(sorted(found, key=lambda violation: violation.condition))


def incidence(points: np.ndarray, length: float) -> float:
    """Tolerance of incidence: 1e-9, and the rounding of points far from the origin."""
    return INCIDENCE + rounding(float(np.abs(points).max()), length)


def named(contacts: Contacts, numbers: tuple[int, ...]) -> str:
    """Names of contacts, as in a sentence."""
    names = [contacts.names[j] for j in numbers]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


class _Lines:
    """Normal lines in scaled coordinates, and common points and planes of sets of them."""

    def __init__(self, contacts: Contacts) -> None:
        self.centre, self.length = contacts.centre, contacts.length
        self.tolerance = incidence(contacts.points, contacts.length)
        points = (contacts.points - contacts.centre) / contacts.length
        self.through, self.within = [], []
        for e, m in zip(contacts.normals, np.cross(points, contacts.normals), strict=True):
            size = np.sqrt(1.0 + m @ m)
            # rows of cross(I, a) are those of the matrix whose product with b is a x b
            through = np.column_stack([np.cross(e, np.eye(3)), -m])
            within = np.column_stack([np.cross(np.eye(3), m), e])
            self.through.append(np.vstack([through, [*m, 0.0]]) / size)
            self.within.append(np.vstack([[*e, 0.0], within]) / size)

    def point(self, numbers: tuple[int, ...]) -> np.ndarray | None:
        """Point (x, w), of length 1, that lines have in common; at infinity ``w`` is 0."""
        return self._null_vector([self.through[j] for j in numbers])

    def plane(self, numbers: tuple[int, ...], *points: np.ndarray) -> np.ndarray | None:
        """Plane (n, c), of length 1, that holds lines and points."""
        return self._null_vector([self.within[j] for j in numbers] + [x[None] for x in points])

    def _null_vector(self, rows: list[np.ndarray]) -> np.ndarray | None:
        _, s, Vt = np.linalg.svd(np.vstack(rows), full_matrices=False)
        return Vt[-1] if s[-1] <= self.tolerance else None

    def at_infinity(self, point: np.ndarray) -> bool:
        """Whether a common point is a direction."""
        return abs(float(point[3])) <= self.tolerance

    def place(self, point: np.ndarray) -> str:
        """Where a common point is, in words."""
        if self.at_infinity(point):
            return "at infinity"
        at = self.centre + self.length * point[:3] / point[3]
        return "(" + ", ".join(f"{x:.4g}" for x in np.round(at, 12) + 0.0) + ")"


def _crowds(contacts: Contacts, lines: _Lines) -> Iterator[Violation]:
    """Conditions 1 to 3: four lines or more with a common point or plane."""
    meeting: list[set[int]] = []
    flat: list[set[int]] = []
    for some in (s for size in (6, 5, 4) for s in combinations(range(6), size)):
        who = f"the normal lines of {named(contacts, some)}"
        point = None if any(set(some) <= m for m in meeting) else lines.point(some)
        if point is not None:
            meeting.append(set(some))
            if lines.at_infinity(point):
                yield Violation(2, some, f"{who} are parallel; no more than 3 may be")
            else:
                words = f"{who} meet at {lines.place(point)}; no more than 3 may meet"
                yield Violation(1, some, words)
        if not any(set(some) <= f for f in flat) and lines.plane(some) is not None:
            flat.append(set(some))
            yield Violation(3, some, f"{who} lie in one plane; no more than 3 may")


def _around_point(
    contacts: Contacts, lines: _Lines, three: tuple[int, ...], others: tuple[int, ...]
) -> Iterator[Violation]:
    """Conditions 4 and 5, for three lines that meet at X, perhaps at infinity."""
    X = lines.point(three)
    if X is None:
        return
    parallel = lines.at_infinity(X)
    meet = "are parallel" if parallel else f"meet at {lines.place(X)}"
    who = f"the normal lines of {named(contacts, three)} {meet}"
    Y = lines.point(others)
    if Y is not None:
        theirs = "are parallel" if lines.at_infinity(Y) else f"meet at {lines.place(Y)}"
        condition = 5 if parallel else 4
        yield Violation(condition, (*three, *others), f"{who}, and the other three {theirs}")
    for pair in combinations(others, 2):
        if lines.plane(pair, X) is not None:
            spot = "parallel to them" if parallel else "with that point"
            words = f"{who}, and those of {named(contacts, pair)} lie in a plane {spot}"
            yield Violation(4, (*three, *pair), words)


def _around_plane(
    contacts: Contacts, lines: _Lines, three: tuple[int, ...], others: tuple[int, ...]
) -> Iterator[Violation]:
    """Condition 6, for three lines in a plane."""
    plane = lines.plane(three)
    if plane is None:
        return
    for pair in combinations(others, 2):
        point = lines.point(pair)
        if point is not None and abs(float(plane @ point)) <= lines.tolerance:
            who = f"the normal lines of {named(contacts, three)} lie in a plane"
            spot = "are parallel to it and to each other"
            if not lines.at_infinity(point):
                spot = f"meet at {lines.place(point)}, a point of it"
            words = f"{who}, and those of {named(contacts, pair)} {spot}"
            yield Violation(6, (*three, *pair), words)
