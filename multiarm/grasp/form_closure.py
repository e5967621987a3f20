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
that neither size nor place of the body matters.  What closes by less than the tolerance (see
:class:`FormClosure`) is called open, and borderline.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from multiarm.grasp.balances import BAND, balance, evenest, rounding
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts
from multiarm.grasp.free_motions import explanation, leaving_contacts, twist_of
from multiarm.grasp.immobility import Immobility, immobility


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
        Open, but within the tolerance of closure (or closed by less than it): a change of
        the points or normals that small may decide otherwise.  Wrenches whose rank is missing
        but for rounding are plainly open.
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

        Second order presumes flat faces and point fingers; see :mod:`multiarm.grasp.immobility`
        for what 0 means when several motions are free.
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
            return f"{self.contacts.count} contacts hold the body: form closure"
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
    floor = rounding(float(np.abs(contacts.points).max()), contacts.length)
    found = balance(contacts.scaled_wrenches, floor)
    closure = FormClosure(
        contacts=contacts,
        closed=found.closed,
        coefficients=found.pushes,
        motion=None if found.direction is None else twist_of(contacts, found.direction),
        rank=found.rank,
        distance=found.distance,
        tolerance=BAND + floor,
        borderline=found.borderline,
    )
    return _exactly(closure) if exact else closure


def _exactly(rounded: FormClosure) -> FormClosure:
    """The same decision without rounding; floats in the result are those nearest to the proof."""
    from multiarm.grasp.exact import exact_balance

    contacts, found = rounded.contacts, exact_balance(rounded.contacts)
    coefficients = motion = None
    if found.pushes is not None:
        sizes = [float(sum(x * x for x in along)) ** 0.5 for along in contacts.exact_directions]
        coefficients = np.array([float(push) for push in found.pushes]) * sizes
        coefficients /= coefficients.sum()
    if found.motion is not None:
        largest = max(abs(x) for x in found.motion)
        direction = np.array([float(x / largest) for x in found.motion])
        direction[contacts.dimension :] *= contacts.length
        motion = twist_of(contacts, direction)
    closed = found.pushes is not None
    return replace(
        rounded,
        closed=closed,
        coefficients=coefficients,
        motion=motion,
        rank=found.rank,
        borderline=rounded.borderline or closed != rounded.closed,
        exact=True,
        exact_coefficients=found.pushes,
        exact_motion=found.motion_about_origin,
    )
