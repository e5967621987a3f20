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

**Motions in words.**  A twist ``[v; omega]`` about the frame's origin moves the body's point p with
:math:`u = v + \omega \times p` and opens the gap at contact j at the rate
:math:`w_j^T [v; \omega] = e_j \cdot u_j`.  It is a translation, a turn about a line, or a screw
about a line, with the pitch :math:`v \cdot \omega / |\omega|^2`.  A turn about a line leaves every
gap as it is exactly when every normal line meets that line or is parallel to it: so it is with
bodies of revolution, which frictionless contacts can never hold (thesis, 2.1).

**Many sets at once**, for searches and for random changes: the same decision as
:func:`is_form_closure`, without the proofs.  For
sets of seven contacts in space, or four in the plane, one batch of small inverses (see
:mod:`multiarm.grasp.balances`), microseconds for each set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.balances import (
    BAND,
    Balance,
    balance,
    evenest,
    exact_balance,
    floor_of,
    rounding,
    simplices,
)
from multiarm.grasp.contacts import (
    Contacts,
    HeldByContacts,
    as_contacts,
    nearest_to_lines,
    numbers_of,
    unit_vectors,
    wrenches_of,
)
from multiarm.grasp.immobility import Immobility, immobility
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


# --- Motions in words -----------------------------------------------------------------------------

# Part of the fastest contact's speed that counts as none.
STILL = 1e-7


def twist_of(contacts: Contacts, direction: np.ndarray) -> np.ndarray:
    """Twist about the frame's origin of a direction in scaled wrench coordinates.

    Its fastest contact point has the speed 1; when all of them rest, ``|omega| length`` is 1.
    """
    direction = direction / np.linalg.norm(direction)
    linear, angular = _split(contacts, direction)
    arms = contacts.points - contacts.centre
    scale = float(np.linalg.norm(linear + _across(angular, arms), axis=1).max())
    if scale <= STILL:
        scale = float(np.linalg.norm(direction[contacts.dimension :]))
    return about_origin(contacts, direction) / scale


def about_origin(contacts: Contacts, direction: np.ndarray) -> np.ndarray:
    """Twist about the frame's origin of scaled coordinates, as long as it is.

    What is dual to wrenches transforms so: prices of force and moment, too.
    """
    linear, angular = _split(contacts, direction)
    return np.concatenate([linear - _across(angular, contacts.centre), angular])


def leaving_contacts(contacts: Contacts, motion: np.ndarray) -> tuple[int, ...]:
    """Numbers of the contacts whose gap opens under a twist."""
    velocities = _velocities(contacts, motion)
    turning = float(np.linalg.norm(motion[contacts.dimension :])) * contacts.length
    size = max(float(np.linalg.norm(velocities, axis=1).max()), turning)
    opening = np.sum(contacts.normals * velocities, axis=1)
    return tuple(np.flatnonzero(opening > _still(contacts) * size).tolist())


def motion_in_words(contacts: Contacts, motion: np.ndarray) -> str:
    """A twist as text: ``slide along (1, 0, 0)``, ``turn about the line through ...``."""
    d = contacts.dimension
    angular = motion[d:]
    middle = motion[:d] + _across(angular, contacts.centre)
    turning = float(np.linalg.norm(angular)) * contacts.length
    if turning <= STILL * float(np.linalg.norm(middle)):
        return f"slide along {vector_in_words(middle / np.linalg.norm(middle))}"
    foot = contacts.centre + _across(angular, middle) / float(angular @ angular)
    size = max(float(np.abs(contacts.points).max()), contacts.length)
    through = vector_in_words(foot, size)
    if d == 2:
        return f"turn about the point {through}"
    axis = angular / np.linalg.norm(angular)
    advance = float(middle @ angular) / float(angular @ angular)
    line = f"the line through {through} along {vector_in_words(axis)}"
    if abs(advance) <= _still(contacts) * contacts.length:
        return f"turn about {line}"
    return f"screw about {line}, {advance:.4g} m for each radian"


def explanation(contacts: Contacts, motion: np.ndarray, rank: int, borderline: bool) -> str:
    """Why contacts do not hold the body, and how it can move."""
    n, space = contacts.freedoms, "in space" if contacts.dimension == 3 else "in the plane"
    does = motion_in_words(contacts, motion)
    off = leaving_contacts(contacts, motion)
    if contacts.count <= n:
        count = contacts.count
        few = f"{count_of(count, 'contact')} never {'closes' if count == 1 else 'close'}"
        why = f"{few} {space}, at least {n + 1} are needed"
    elif rank < n:
        why = f"the wrenches of the {contacts.count} contacts have rank {rank} of {n}"
    else:
        why = f"no pushes of all {contacts.count} contacts balance"
    how = f"the body can {does}{_which(contacts, off)}"
    sentences = [f"no form closure: {why}; {how}"]
    if not off:
        sentences += [pattern for pattern in (_pattern(contacts, motion),) if pattern]
    if borderline:
        sentences.append("It is borderline: a change within the tolerance may close it")
    return ". ".join(sentences)


def vector_in_words(vector: np.ndarray, size: float = 1.0) -> str:
    """Components with four digits; those that are negligible next to ``size`` are 0."""
    shown = np.where(np.abs(vector) > STILL * size, vector, 0.0)
    return "(" + ", ".join(f"{value:.4g}" for value in shown) + ")"


def _pattern(contacts: Contacts, motion: np.ndarray) -> str | None:
    """The common property of the normal lines when a motion leaves every gap unchanged."""
    d, p, e = contacts.dimension, contacts.points, contacts.normals
    across = e - np.outer(e @ e[0], e[0])
    if np.abs(across).max() <= STILL:
        return "All normals are parallel: nothing resists a motion across them"
    arms = p - contacts.centre
    meeting, off = nearest_to_lines(arms, e)
    if np.abs(off).max() <= _still(contacts) * contacts.length:
        kind = "sphere" if d == 3 else "circle"
        at = vector_in_words(meeting + contacts.centre, float(np.abs(p).max()))
        return (
            f"All normal lines meet at {at}: no contact with such a normal stops a turn about that "
            f"point, and a {kind} around it cannot be held"
        )
    turns = np.linalg.norm(motion[d:]) * contacts.length > STILL
    if d == 3 and turns and motion_in_words(contacts, motion).startswith("turn"):
        return (
            "All normal lines meet this axis or are parallel to it: contacts of that kind, the "
            "only ones on a body of revolution, never stop the turn"
        )
    return None


def _still(contacts: Contacts) -> float:
    """``STILL``, and the rounding of points far from the origin."""
    return STILL + floor_of(contacts)


def _split(contacts: Contacts, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the middle of the contacts and angular velocity of a scaled direction."""
    d = contacts.dimension
    return direction[:d], direction[d:] / contacts.length


def _velocities(contacts: Contacts, motion: np.ndarray) -> np.ndarray:
    """Velocities (N, d) of the contact points of the body."""
    d = contacts.dimension
    middle = motion[:d] + _across(motion[d:], contacts.centre)
    return middle + _across(motion[d:], contacts.points - contacts.centre)


def _across(angular: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """``omega x r``, in the plane too, where omega is the one number ``angular[0]``."""
    if len(angular) == 3:
        return np.cross(angular, arms)
    return angular[0] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)


def _which(contacts: Contacts, numbers: tuple[int, ...]) -> str:
    """Which contacts a motion leaves, as a subordinate clause."""
    if not numbers:
        return ", all contacts sliding or resting" if contacts.count > 1 else ", the contact slides"
    if len(numbers) == contacts.count:
        return ", away from every contact" if contacts.count > 1 else ", away from the contact"
    return f", away from {', '.join(contacts.names[j] for j in numbers)}"


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
            found: Balance = balance(W[j], float(floors[j]))
            closed[first + j], borderline[first + j] = found.closed, found.borderline
            distances[first + j] = found.distance
    return ManyClosures(closed, distances, borderline)


def _checked(points: Any, normals: Any) -> tuple[np.ndarray, np.ndarray]:
    needed = (
        "M sets of N contacts have points and normals of finite numbers, of shape (M, N, 3) in "
        "space or (M, N, 2) in the plane"
    )
    p, e = (numbers_of(given, needed, (None, -1, 3), (None, -1, 2)) for given in (points, normals))
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
