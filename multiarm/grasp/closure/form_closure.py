r"""Form closure: do the contacts hold the body against every motion, by pushing alone?

With the wrenches ``W = [w_1 ... w_N]`` of unit pushes (:mod:`multiarm.grasp.contacts`),

.. math::
    \text{form closure} \iff \operatorname{rank} W = 6 \;\text{ and }\;
    \exists\, \lambda > 0 : \; W \lambda = 0 ,

all N entries of :math:`\lambda` positive (thesis, 2.1; in the plane the rank is 3).  All contacts
must enter: a set of 7 to 12 contacts may close although none of its proper subsets does, so testing
seven at a time is not enough.  The margin is

.. math::
    t^* = \max_\lambda \min_j \lambda_j \quad\text{with}\quad W\lambda = 0, \; \sum_j \lambda_j = 1.

Every answer carries its proof: the pushes :math:`\lambda`, or a motion of the body that no
contact resists.  Wrenches are taken about the middle of the contacts, moments over their spread, so
that neither size nor place of the body matters.  A grasp that closes by less than the tolerance
(see :class:`FormClosure`) counts as open, and borderline.

**Many sets at once**, for searches and for random changes: the same decision as
:func:`is_form_closure`, without the proofs.  For
sets of seven contacts in space, or four in the plane, one batch of small inverses (see
:mod:`multiarm.grasp.closure.balances`), microseconds for each set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of, unit_vectors
from multiarm.grasp.closure.balances import (
    BAND,
    Balance,
    balance,
    evenest,
    floor_of,
    rounding,
    simplices,
)
from multiarm.grasp.closure.exact_balances import exact_balance
from multiarm.grasp.closure.immobility import Immobility, immobility
from multiarm.grasp.closure.motions import explanation, leaving_contacts, twist_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts, wrenches_of
from multiarm.notation import count_of
from multiarm.public import facts_html


@dataclass(frozen=True, eq=False)
class FormClosure:
    """Whether contacts hold a body, with the proof; its truth value is ``closed``.

    Attributes
    ----------
    contacts : Contacts
    closed : bool
    coefficients : ndarray, shape (N,), or None
        Pushes of sum 1, all positive, with ``W coefficients = 0``: proof of closure.
    motion : ndarray, shape (6,), or None
        Proof of the contrary: a twist [linear; angular] about the frame's origin, in the plane
        [vx, vy, omega], with ``W.T @ motion >= 0``.  The fastest contact point of the body has
        the speed 1 [m/s] (when all points rest, angular velocity times ``contacts.length`` is 1).
    rank : int
        Of the wrenches; 6 (3) is needed.
    distance : float
        Closure survives every change of each scaled wrench by less than this; 0 when open.
    tolerance : float
        Bound that ``distance`` must exceed: 1e-10, and the rounding of points far from the origin.
    borderline : bool
        Open, but within the tolerance of closure (or closed by less than it): so small a change
        of points or normals may close it.  Wrenches that lack rank except for rounding are open
        without doubt.
    exact : bool
        Decided in rational arithmetic, without tolerance.
    exact_coefficients, exact_motion : tuple of Fraction, or None
        Then the proof without rounding; coefficients are of the directions as given, whatever
        their length, and the motion has any length.
    """

    contacts: Contacts
    closed: bool
    coefficients: np.ndarray | None
    motion: np.ndarray | None
    rank: int
    distance: float
    tolerance: float
    borderline: bool
    exact: bool = False
    exact_coefficients: tuple[Fraction, ...] | None = None
    exact_motion: tuple[Fraction, ...] | None = None

    def __bool__(self) -> bool:
        return self.closed

    def _repr_html_(self) -> str:
        facts = {
            "contacts": len(self.contacts),
            "rank": self.rank,
            "margin": f"{self.margin:.3g}" if self.closed else "",
            "message": self.message,
        }
        return facts_html("Form closure" if self.closed else "No form closure", facts)

    def __str__(self) -> str:
        return self.message

    @cached_property
    def margin(self) -> float:
        """``t*``: the smallest of the pushes (of sum 1), when the evenest ones are taken.

        Positive when closed.  When open, not positive: 0 when only the rank is missing, and never
        less than -1e10, the value when no pushes of sum 1 balance, not even pulling ones.  Should
        the linear program give up, the margin of the pushes nearest to equal ones: a lower bound.
        """
        if self.closed and self.contacts.count == self.contacts.freedoms + 1:
            assert self.coefficients is not None  # the balance is unique
            return float(self.coefficients.min())
        smallest = evenest(self.contacts.scaled_wrenches, self.rank).smallest
        if self.coefficients is None:
            return min(smallest, 0.0)
        return max(smallest, float(self.coefficients.min()))

    @cached_property
    def conditioning(self) -> float:
        """Smallest over largest singular value of the scaled wrenches: 0 when rank is missing."""
        s = np.linalg.svd(self.contacts.scaled_wrenches, compute_uv=False)
        return float(s[-1] / s[0]) if len(s) == self.contacts.freedoms else 0.0

    @cached_property
    def immobility(self) -> Immobility:
        """Form closure, held to second order by the flat faces, or movable."""
        return immobility(self.contacts, self.closed)

    @property
    def order(self) -> int:
        """1: form closure; 2: immobile by second-order effects of turning; 0: not immobile.

        Second order presumes flat faces and point fingers; 0 with several free motions is no proof
        (:mod:`multiarm.grasp.closure.immobility`).
        """
        return self.immobility.order

    @cached_property
    def leaving(self) -> tuple[int, ...]:
        """Contacts, numbers from 0, that ``motion`` takes off the body; none when closed."""
        return () if self.motion is None else leaving_contacts(self.contacts, self.motion)

    @cached_property
    def message(self) -> str:
        """The verdict and its reason in a sentence or two."""
        if self.motion is None:
            return f"{count_of(self.contacts.count, 'contact')} hold the body: form closure"
        sentence = explanation(self.contacts, self.motion, self.rank, self.borderline)
        if self.order == 2:
            sentence += (
                ". Fingers on flat faces hold it all the same, to second order: turning on presses "
                "them into the faces"
            )
        return sentence


def is_form_closure(contacts: Contacts | HeldByContacts, *, exact: bool = False) -> FormClosure:
    """Decide whether contacts hold a body against every motion.

    Parameters
    ----------
    contacts : Contacts, or a grasp
        Any number, in space or in the plane.
    exact : bool
        Decide without tolerance, in rational arithmetic on the numbers as given (slower).

    Raises
    ------
    GraspError
        Something else than contacts.
    """
    contacts = as_contacts(contacts)
    floor = floor_of(contacts)
    verdict = balance(contacts.scaled_wrenches, floor)
    closure = FormClosure(
        contacts=contacts,
        closed=verdict.closed,
        coefficients=verdict.pushes,
        motion=None if verdict.direction is None else twist_of(contacts, verdict.direction),
        rank=verdict.rank,
        distance=verdict.distance,
        tolerance=BAND + floor,
        borderline=verdict.borderline,
    )
    return _exactly(closure) if exact else closure


def _exactly(rounded: FormClosure) -> FormClosure:
    """The same decision without rounding; floats in the result are those nearest to the proof."""
    contacts, proof = rounded.contacts, exact_balance(rounded.contacts)
    coefficients = motion = None
    if proof.pushes is not None:
        sizes = [float(sum(x * x for x in along)) ** 0.5 for along in contacts.exact_directions]
        coefficients = np.array([float(push) for push in proof.pushes]) * sizes
        coefficients /= coefficients.sum()
    if proof.motion is not None:
        largest = max(abs(x) for x in proof.motion)
        direction = np.array([float(x / largest) for x in proof.motion])
        direction[contacts.dimension :] *= contacts.length
        motion = twist_of(contacts, direction)
    closed = proof.pushes is not None
    return replace(
        rounded,
        closed=closed,
        coefficients=coefficients,
        motion=motion,
        rank=proof.rank,
        borderline=rounded.borderline or closed != rounded.closed,
        exact=True,
        exact_coefficients=proof.pushes,
        exact_motion=proof.motion_about_origin,
    )


# --- Many sets of contacts at once ----------------------------------------------------------------

# Sets whose wrenches are assembled together: memory stays small.
CHUNK = 20_000


@dataclass(frozen=True, eq=False)
class ManyClosures:
    """Verdicts on M sets of contacts.

    Attributes
    ----------
    closed : ndarray of bool, shape (M,)
    distances : ndarray, shape (M,)
        Closure survives every change of each scaled wrench by less than this; 0 when open.
    borderline : ndarray of bool, shape (M,)
        Open, but within the tolerance of closure.
    """

    closed: np.ndarray
    distances: np.ndarray
    borderline: np.ndarray

    def __len__(self) -> int:
        return len(self.closed)


def closed_many(points: Any, normals: Any) -> ManyClosures:
    """Decide M sets of N contacts each.

    Parameters
    ----------
    points : array-like, shape (M, N, 3) or (M, N, 2)
        [m]
    normals : array-like, same shape
        Unit vectors into the body.

    Raises
    ------
    GraspError
        Shapes that do not match, numbers that are not finite, normals that are not of unit length.
    """
    p, e = _checked(points, normals)
    count, n = p.shape[1], 6 if p.shape[2] == 3 else 3
    closed, borderline = np.zeros(len(p), dtype=bool), np.zeros(len(p), dtype=bool)
    distances = np.zeros(len(p))
    for first in range(0, len(p), CHUNK):
        part = slice(first, first + CHUNK)
        W, floors = scaled_wrenches_of(p[part], e[part])
        if count == n + 1:
            _, distances_in, unclear = simplices(W, BAND + floors)
            inside, doubtful = distances_in.min(axis=1), np.flatnonzero(unclear)
            closed[part] = inside > BAND + floors
            borderline[part] = np.abs(inside) <= BAND + floors
            distances[part] = np.where(closed[part], inside, 0.0)
        else:
            doubtful = np.arange(len(W))
        for j in doubtful:
            verdict: Balance = balance(W[j], float(floors[j]))
            closed[first + j], borderline[first + j] = verdict.closed, verdict.borderline
            distances[first + j] = verdict.distance
    return ManyClosures(closed, distances, borderline)


def _checked(points: Any, normals: Any) -> tuple[np.ndarray, np.ndarray]:
    needed = (
        "M sets of N contacts have points and normals of finite numbers, of shape (M, N, 3) in "
        "space or (M, N, 2) in the plane"
    )
    p, e = (
        numbers_of(values, needed, (None, -1, 3), (None, -1, 2)) for values in (points, normals)
    )
    if p.shape != e.shape:
        raise GraspError(f"{needed}, not {p.shape} and {e.shape}")
    return p, unit_vectors(e)


def scaled_wrenches_of(p: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (M, n, N) about the middle of each set, moments over its spread; their rounding."""
    arms = p - p.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.mean(np.sum(arms**2, axis=2), axis=1))
    length = np.where(spread > 0.0, spread, 1.0)
    W = np.moveaxis(wrenches_of(arms / length[:, None, None], e), 0, 1)
    reach = np.abs(p).max(axis=(1, 2))
    return W, rounding(reach, length)
