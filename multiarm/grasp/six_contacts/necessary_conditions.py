r"""Necessary conditions on the normal lines of six independent contacts (thesis, 2.2.1, A.2).

They say more about a failure than a determinant does.  Each violation leaves the wrenches a rank of
5 or less:

1. no four normal lines meet at a point;
2. no four normals are parallel;
3. no four normal lines lie in a plane;
4. if three meet at X, the others are not parallel, do not meet at a point, and no two of them lie
   in a plane with X;
5. if three are parallel, the others do not meet at a point;
6. if three lie in a plane, no two of the others meet at a point of it.

They are not sufficient; the rank decides (:mod:`multiarm.grasp.six_contacts.independent_contacts`).
The rank of lines does not change under projective maps, so parallel lines, which meet at infinity,
obey 4, 5 and 6 as well, and the scan includes them.  With Plücker coordinates (e, m) of a line, the
point (x, w) is on it when ``x cross e = w m`` and ``x . m = 0``, and the plane ``n . y + c = 0``
holds it when ``n . e = 0`` and ``m cross n + c e = 0``: a common point or plane of lines is a null
vector of these equations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from multiarm.geometry.screws import skew
from multiarm.grasp.closure.balances import rounding
from multiarm.grasp.closure.motions import point_in_words
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space

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
    the sine of an angle) and the rounding of points far from the origin.  Only the largest set of
    lines is reported, not its subsets, and 4 to 6 only where they do not follow from 1 to 3.

    Raises
    ------
    GraspError
        Not six contacts in space.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    lines = _Lines(contacts)
    crowds = [*_crowds(contacts, lines)]
    crowded = [set(crowd.contacts) for crowd in crowds]
    violations = list(crowds)
    for three in combinations(range(6), 3):
        if any(set(three) <= crowd for crowd in crowded):
            continue
        remaining = tuple(j for j in range(6) if j not in three)
        violations += _around_point(contacts, lines, three, remaining)
        violations += _around_plane(contacts, lines, three, remaining)
    return tuple(sorted(violations, key=lambda violation: violation.condition))


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
        self.contacts, self.centre, self.length = contacts, contacts.centre, contacts.length
        self.tolerance = incidence(contacts.points, contacts.length)
        points = (contacts.points - contacts.centre) / contacts.length
        self.through, self.within = [], []
        for e, m in zip(contacts.normals, np.cross(points, contacts.normals), strict=True):
            size = np.sqrt(1.0 + m @ m)
            through = np.column_stack([skew(-e), -m])  # x cross e - w m
            within = np.column_stack([skew(m), e])  # m cross n + c e
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
        return point_in_words(self.contacts, self.centre + self.length * point[:3] / point[3])


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
    contacts: Contacts, lines: _Lines, three: tuple[int, ...], remaining: tuple[int, ...]
) -> Iterator[Violation]:
    """Conditions 4 and 5, for three lines that meet at X, perhaps at infinity."""
    X = lines.point(three)
    if X is None:
        return
    parallel = lines.at_infinity(X)
    meet = "are parallel" if parallel else f"meet at {lines.place(X)}"
    who = f"the normal lines of {named(contacts, three)} {meet}"
    Y = lines.point(remaining)
    if Y is not None:
        theirs = "are parallel" if lines.at_infinity(Y) else f"meet at {lines.place(Y)}"
        condition = 5 if parallel else 4
        yield Violation(condition, (*three, *remaining), f"{who}, and the other three {theirs}")
    for pair in combinations(remaining, 2):
        if lines.plane(pair, X) is not None:
            spot = "parallel to them" if parallel else "with that point"
            words = f"{who}, and those of {named(contacts, pair)} lie in a plane {spot}"
            yield Violation(4, (*three, *pair), words)


def _around_plane(
    contacts: Contacts, lines: _Lines, three: tuple[int, ...], remaining: tuple[int, ...]
) -> Iterator[Violation]:
    """Condition 6, for three lines in a plane."""
    plane = lines.plane(three)
    if plane is None:
        return
    for pair in combinations(remaining, 2):
        point = lines.point(pair)
        if point is not None and abs(float(plane @ point)) <= lines.tolerance:
            who = f"the normal lines of {named(contacts, three)} lie in a plane"
            spot = "are parallel to it and to each other"
            if not lines.at_infinity(point):
                spot = f"meet at {lines.place(point)}, a point of it"
            words = f"{who}, and those of {named(contacts, pair)} {spot}"
            yield Violation(6, (*three, *pair), words)
