r"""How far all contacts may slide at once before some choice of displacements loses the grasp.

Seven contacts close exactly when the null vector of their wrenches,

.. math:: v_i = (-1)^i \det [w_1 \dots w_{i-1}\; w_{i+1} \dots w_7],

has entries of one sign, none zero. A contact that slides in its face by :math:`d_j` changes its own
column only, and linearly. So every entry is affine in each :math:`d_j` when the others are held:
over a product of convex sets it is smallest at extreme points. For squares of half width r these
are :math:`4^6` corners, for polygons of m sides :math:`m^6`. They are all looked at, and cheaply:
by Laplace's expansion along two groups of three columns

.. math:: \det [A \; B] = \sum_T \pm (a_1 \wedge a_2 \wedge a_3)_T (b_1 \wedge b_2 \wedge b_3)_{T^c}

the :math:`m^6` determinants are one product of matrices :math:`(m^3, 20) (20, m^3)`. The smallest
value falls as r grows; where it reaches zero is the **closure radius**.

A square needs axes; a disc does not, and is what "at most r in any direction" means. A disc lies
between an inscribed and a circumscribed polygon. From the worst corner of the inscribed octagon a
descent, contact by contact, reaches a choice of displacements that breaks the grasp (``upper``).
The circumscribed octagon whose sides touch the disc in those very directions does not reach beyond
the disc to first order there, and gives a radius that no choice can break (``lower``).

The same for six contacts and their one determinant: up to which displacements they stay independent
(thesis, 2.3.1, which gives a lower bound).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of
from multiarm.grasp.body.face import across
from multiarm.grasp.closure.balances import rank_of
from multiarm.grasp.closure.form_closure import closed_many, is_form_closure
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space

# Sides of the polygons that stand for a disc.
SIDES = 8
# Subsets of seven of more contacts that are examined, the most firmly closed ones; of so many sets
# at most, which are drawn where there are more: those of 21 contacts.
SUBSETS, MOST_SETS = 40, 120_000
# Corners of a square of half width 1 for each of six contacts.
SQUARE = np.tile([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]], (6, 1, 1))


@dataclass(frozen=True, eq=False)
class ClosureRadius:
    """Largest displacement of all contacts at once that cannot lose the grasp.

    Attributes
    ----------
    lower : float
        No displacements within it lose the grasp [m]; 0 when the contacts do not close.
    upper : float
        ``displacements`` of this size do, or reach the limit [m]; equal to ``lower`` for squares,
        infinite where no such choice is known.
    displacements : ndarray, shape (N, 3), or None
        In the faces [m].
    shape : str
        ``disc`` or ``square``.
    message : str
    """

    lower: float
    upper: float
    displacements: np.ndarray | None
    shape: str
    message: str


def closure_radius(
    contacts: Contacts | HeldByContacts, *, shape: str = "disc", axes: Any = None
) -> ClosureRadius:
    """Largest r such that contacts which each slide by at most r still hold the body.

    Parameters
    ----------
    contacts : Contacts
        Seven or more, in space.  Faces are planes, so that normals stay.
    shape : {"disc", "square"}
        At most r in any direction, or at most r along each of two axes in the face.
    axes : array-like, shape (N, 2, 3), optional
        Those axes, orthonormal and in the faces; by default the first points away from the middle
        of the contacts.

    Returns
    -------
    ClosureRadius
        For seven contacts squares are exact and discs are between two bounds.  For more the lower
        bound is that of the best subset of seven (any subset is enough; of more than 21 contacts
        some are drawn, always the same), and there is no upper one.

    Raises
    ------
    GraspError
        Fewer than seven contacts, contacts in the plane, another shape, axes out of the face.
    """
    contacts = contacts_in_space(contacts, 7)
    tangents = _tangents(contacts, shape, axes)
    if not is_form_closure(contacts):
        return ClosureRadius(0.0, 0.0, np.zeros_like(contacts.points), shape, "not a grasp at all")
    if contacts.count > 7:
        return _of_subsets(contacts, tangents, shape)
    minors = [Minor(contacts, tangents, i) for i in range(7)]
    return _radius(minors, contacts, shape, "the grasp is lost")


def independence_radius(
    contacts: Contacts | HeldByContacts, *, shape: str = "disc", axes: Any = None
) -> ClosureRadius:
    """Largest r such that six contacts which each slide by at most r stay independent.

    Parameters and result as those of :func:`closure_radius`, for six contacts.

    Raises
    ------
    GraspError
        Not six contacts, or contacts in the plane.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    tangents = _tangents(contacts, shape, axes)
    if rank_of(contacts) < 6:
        return ClosureRadius(0.0, 0.0, np.zeros((6, 3)), shape, "they are dependent as they are")
    return _radius([Minor(contacts, tangents, None)], contacts, shape, "they become dependent")


def tangents_of(contacts: Contacts) -> np.ndarray:
    """Two orthonormal axes in the plane of each contact, shape (N, 2, 3).

    The first points away from the middle of the contacts, so that the axes move with the body.
    """
    e = contacts.normals
    away = contacts.points - contacts.centre
    away = away - np.sum(away * e, axis=1, keepdims=True) * e
    for j in np.flatnonzero(np.linalg.norm(away, axis=1) <= 1e-9 * contacts.length):
        crossed = np.cross(e[j], e)
        k = int(np.argmax(np.linalg.norm(crossed, axis=1)))
        away[j] = crossed[k]
        if not np.linalg.norm(crossed[k]) > 0.0:  # all normals parallel: any axis will do
            away[j] = across(e[j])
    first = away / np.linalg.norm(away, axis=1, keepdims=True)
    return np.stack([first, np.cross(e, first)], axis=1)


def _radius(minors: list[Minor], contacts: Contacts, shape: str, what: str) -> ClosureRadius:
    """The smallest radius of several determinants."""
    minors = sorted(minors, key=Minor.estimate)
    bounds = _of_squares if shape == "square" else _of_discs
    around = SQUARE if shape == "square" else _polygon(np.zeros(6)) / np.cos(np.pi / SIDES)
    lower = upper = float("inf")
    moves, first = np.zeros((6, 2)), minors[0]
    for minor in minors:
        if np.isfinite(lower) and minor.worst(lower * around)[0] > 0.0:
            continue  # this one is not lost within what is known already
        least, most, at = bounds(minor)
        lower = min(lower, least)
        if most < upper:
            upper, moves, first = most, at, minor
    lower = min(lower, upper)
    L = contacts.length
    displacements = np.zeros_like(contacts.points)
    tangents = first.rates  # the turned tangents: t x e
    for k, j in enumerate(first.numbers):
        turned = moves[k] @ tangents[k, :, 3:]
        displacements[j] = np.cross(contacts.normals[j], turned) * L
    words = (
        f"contacts that slide by {lower * L:.4g} m or less cannot harm; at {upper * L:.4g} m {what}"
    )
    return ClosureRadius(lower * L, upper * L, displacements, shape, words)


def _of_squares(minor: Minor) -> tuple[float, float, np.ndarray]:
    """The radius of squares, twice, and displacements that reach it."""
    r = minor.smallest_on(SQUARE, minor.estimate())
    return r, r, minor.worst(r * SQUARE)[1] if np.isfinite(r) else np.zeros((6, 2))


def _of_discs(minor: Minor) -> tuple[float, float, np.ndarray]:
    """Bounds on the radius of discs, and displacements at the upper one."""
    inscribed = _polygon(np.zeros(6))
    r = minor.smallest_on(inscribed, minor.estimate())
    if not np.isfinite(r):
        return r, r, np.zeros((6, 2))
    upper, along = minor.broken_by(minor.worst(r * inscribed)[1], r)
    touching = np.arctan2(along[:, 1], along[:, 0]) + np.pi / SIDES
    around = _polygon(touching) / np.cos(np.pi / SIDES)
    lower = max(minor.smallest_on(around, upper), r * np.cos(np.pi / SIDES))
    return min(lower, upper), upper, upper * along


def _polygon(turned: np.ndarray) -> np.ndarray:
    """Regular polygons in the unit disc, turned by angles (6,), shape (6, SIDES, 2)."""
    angles = turned[:, None] + 2.0 * np.pi * np.arange(SIDES) / SIDES
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _of_subsets(contacts: Contacts, tangents: np.ndarray, shape: str) -> ClosureRadius:
    """Lower bound for more than seven contacts: any seven of them that close are enough."""
    drawn = comb(contacts.count, 7) > MOST_SETS
    if drawn:
        order = np.random.default_rng(0).random((MOST_SETS, contacts.count)).argsort(axis=1)
        sets = np.unique(np.sort(order[:, :7], axis=1), axis=0)
    else:
        sets = np.array(list(combinations(range(contacts.count), 7)))
    verdicts = closed_many(contacts.points[sets], contacts.normals[sets])
    order = np.argsort(-verdicts.distances, kind="stable")[:SUBSETS]
    best = 0.0
    for number in order[verdicts.closed[order]]:
        chosen = list(sets[number])
        radius = closure_radius(contacts.subset(chosen), shape=shape, axes=tangents[chosen])
        best = max(best, radius.lower)
    words = f"seven of the contacts hold the body while all slide by {best:.4g} m or less"
    if best == 0.0:
        which = f"none of {len(sets)} drawn sets of seven" if drawn else "no seven"
        words = f"{which} of these contacts hold the body by themselves, so no radius is known"
    return ClosureRadius(best, float("inf"), None, shape, words)


def _tangents(contacts: Contacts, shape: str, axes: Any) -> np.ndarray:
    """Two axes in the plane of each contact, the caller's or the usual ones, shape (N, 2, 3)."""
    if shape not in ("disc", "square"):
        raise GraspError(f"shape is 'disc' or 'square', not {shape!r}")
    if axes is None:
        return tangents_of(contacts)
    wanted = (contacts.count, 2, 3)
    tangents = numbers_of(axes, f"axes have shape {wanted}, two in the face of each", wanted)
    gram = np.einsum("jax,jbx->jab", tangents, tangents) - np.eye(2)
    out = np.einsum("jax,jx->ja", tangents, contacts.normals)
    if not max(np.abs(gram).max(), np.abs(out).max()) < 1e-6:
        raise GraspError("axes must be orthonormal and lie in the faces")
    return tangents


# --- Determinants of six wrenches whose contacts slide --------------------------------------------

# Relative accuracy of radii.
ACCURACY = 1e-12
# Rounds of the descent; each takes every contact once.
ROUNDS = 12
# A radius of more than this many sizes of the grasp counts as infinite.
ENDLESS = 1e9


class Minor:
    """Determinant of six contacts' wrenches as a function of their displacements.

    It is divided by its value without displacements: 1 there, and the grasp is lost at 0.
    Displacements are (6, 2), along each contact's tangents, over the length of the contacts.
    """

    def __init__(self, contacts: Contacts, tangents: np.ndarray, left_out: int | None) -> None:
        self.numbers = [j for j in range(contacts.count) if j != left_out]
        W = contacts.scaled_wrenches.T[self.numbers]  # (6, 6), a contact in each row
        e = contacts.normals[self.numbers, None]
        turned = np.cross(tangents[self.numbers], e)  # (6, 2, 3)
        self.base = W
        self.rates = np.concatenate([np.zeros_like(turned), turned], axis=2)  # (6, 2, 6)
        self.nominal = float(np.linalg.det(W))

    def at(self, moves: np.ndarray) -> np.ndarray:
        """Values for displacements (..., 6, 2)."""
        W = self.base + np.einsum("...ka,kab->...kb", moves, self.rates)
        return np.linalg.det(W) / self.nominal

    def worst(self, corners: np.ndarray) -> tuple[float, np.ndarray]:
        """Smallest value over a product of polygons (6, m, 2), and where (6, 2)."""
        columns = self.base[:, None] + np.einsum("kma,kab->kmb", corners, self.rates)
        left, right = _wedge(*columns[:3]), _wedge(*columns[3:])
        values = (
            (left * _SIGNS) @ right[:, ::-1].T / self.nominal
        )  # complements are in reverse order
        place = int(np.argmin(values))
        m = corners.shape[1]
        which = np.unravel_index(place, (m,) * 6)
        return float(values.flat[place]), corners[np.arange(6), list(which)]

    def gradient(self, moves: np.ndarray) -> np.ndarray:
        """Derivative with respect to each displacement, shape (6, 2); exact, being affine."""
        steps = np.eye(12).reshape(12, 6, 2)
        return (self.at(moves + steps) - self.at(moves)).reshape(6, 2)

    def estimate(self) -> float:
        """Radius to first order."""
        slope = float(np.sum(np.linalg.norm(self.gradient(np.zeros((6, 2))), axis=1)))
        return 1.0 / max(slope, 1.0 / ENDLESS)

    def smallest_on(self, polygons: np.ndarray, guess: float) -> float:
        """Smallest r at which polygons r times as large reach zero; infinite if none does."""
        from scipy.optimize import brentq

        def value(r: float) -> float:
            return self.worst(r * polygons)[0]

        high = guess
        while value(high) > 0.0:
            high *= 2.0
            if high > ENDLESS:
                return float("inf")
        return float(brentq(value, 0.0, high, xtol=ACCURACY * high, rtol=ACCURACY))

    def broken_by(self, start: np.ndarray, r: float) -> tuple[float, np.ndarray]:
        """A smaller radius, and directions (6, 2), at which the value is zero: descent on discs."""
        along = start / np.linalg.norm(start, axis=1, keepdims=True)
        for _ in range(ROUNDS):
            for k in range(6):
                slope = self.gradient(r * along)[k]
                size = np.linalg.norm(slope)
                if size > 0.0:
                    along[k] = -slope / size
            better = self.smallest_on(along[:, None], r)
            if better >= r * (1.0 - 1e-9):
                break
            r = better
        return r, along


def _wedge(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """All products ``a ^ b ^ c``, shape (m^3, 20), of vectors (m, 6)."""
    i, j = _PAIRS
    two = a[:, None, i] * b[None, :, j] - a[:, None, j] * b[None, :, i]  # (m, m, 15)
    ij, ik, jk, p, q, r = _TRIPLES
    three = (
        two[:, :, None, ij] * c[:, r]
        - two[:, :, None, ik] * c[:, q]
        + two[:, :, None, jk] * c[:, p]
    )
    return three.reshape(-1, 20)


def _index_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pairs = list(combinations(range(6), 2))
    triples = list(combinations(range(6), 3))
    place = {pair: k for k, pair in enumerate(pairs)}
    rows = [(place[i, j], place[i, k], place[j, k], i, j, k) for i, j, k in triples]
    signs = [(-1.0) ** (i + j + k - 3) for i, j, k in triples]
    return np.array(pairs).T, np.array(rows).T, np.array(signs)


_PAIRS, _TRIPLES, _SIGNS = _index_tables()
