r"""Postures for wanted places of an arm's tip: inverse kinematics with many starts.

A posture is found by least squares on the pose error

.. math:: \begin{bmatrix} (x(q) - x_r) / \ell \\ \theta(q) \end{bmatrix} ,

``theta`` the rotation vector from the wanted orientation to the tip's, within the joints' limits,
from starts spread over them.  Of the postures found the one is best that is farthest from singular
postures and from its limits, in every requested place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.spatial import difference, matrix_to_quaternion

# Length that compares shifts with turns [m]: about half an arm.
LENGTH = 0.5
# A posture reaches a place when shift [m] and turn [rad] are off by less.
REACHED = 1e-8
# Joints without limits are sought within a turn either way, all others this far inside them [rad].
TURN, MARGIN = np.pi, 0.05
# Steps of Levenberg and Marquardt's method from one start.
_STEPS = 60


@dataclass(frozen=True)
class Reach:
    """A posture that reaches one or several places.

    Attributes
    ----------
    postures : ndarray, shape (K, n)
        Joint positions, place after place [rad or m].
    dexterity : float
        Smallest singular value of the Jacobian, lengths over 0.5 m, at the worst place.
    room : float
        Smallest distance of a joint from its limits, as a part of half its range (1 in the middle).
    clearance : float
        Worst factor for being in the way of something, 1 where there is nothing.
    """

    postures: np.ndarray
    dexterity: float
    room: float
    clearance: float = 1.0

    @property
    def quality(self) -> float:
        """The score that the best posture maximises."""
        return self.dexterity * min(1.0, 2.0 * self.room) * self.clearance


def find_posture(
    arm: Arm,
    places: Sequence[np.ndarray],
    rng: np.random.Generator,
    starts: int = 24,
    clear: Callable[[np.ndarray, int], float] | None = None,
) -> Reach | None:
    """The best posture found with which an arm reaches a place, and then others.

    Parameters
    ----------
    arm : Arm
    places : sequence of ndarray, shape (4, 4)
        Poses of the tip in the world; the second is reached from the posture at the first, ...
    rng : numpy.random.Generator
        Where the search starts.
    starts : int
        How many postures the search begins at.
    clear : callable, optional
        Of the origins of all joints and of the tip in the world, shape (n + 1, 3) [m], and of the
        number of the place: a factor on the quality, 1 where the arm is out of the way of
        everything, less where it is not.

    Returns
    -------
    Reach or None
        None where no start leads to a posture that reaches all places.
    """
    low, high = _bounds(arm)
    best: Reach | None = None
    for _ in range(starts):
        q = rng.uniform(low, high)
        course = []
        for place in places:
            found = _solve(arm, place, q, low, high)
            if found is None:
                break
            q = found
            course.append(q)
        if len(course) < len(places):
            continue
        reach = _judged(arm, np.array(course), low, high, clear)
        if best is None or reach.quality > best.quality:
            best = reach
    return best


def _bounds(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    low, high = arm.position_limits.T
    middle = 0.5 * (low + high)
    endless = ~np.isfinite(middle)
    middle[endless] = 0.0
    half = np.where(endless, TURN, 0.5 * (high - low) - MARGIN)
    half = np.minimum(np.maximum(half, 0.0), TURN)
    return middle - half, middle + half


def _error(arm: Arm, place: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose error (6,) and its Jacobian (6, n), lengths over :data:`LENGTH`."""
    terms = arm.terms(q, np.zeros(arm.dof))
    wanted = matrix_to_quaternion(place[:3, :3])
    turn = difference(wanted, matrix_to_quaternion(terms.tip_rotation))
    error = np.concatenate([(terms.tip_position - place[:3, 3]) / LENGTH, turn])
    J = terms.J.copy()
    J[:3] /= LENGTH
    return error, J


def _solve(
    arm: Arm, place: np.ndarray, start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray | None:
    """Levenberg and Marquardt's method within bounds: a joint at a bound it presses on rests."""
    q, mu = start.copy(), 1e-2
    error, J = _error(arm, place, q)
    for _ in range(_STEPS):
        size = float(error @ error)
        if np.max(np.abs(error)) < REACHED:
            return q
        gradient = J.T @ error
        free = ~(((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0)))
        step = np.zeros(q.size)
        A = J[:, free]
        rows = np.vstack([A, np.sqrt(mu * size) * np.eye(A.shape[1])])
        step[free] = -np.linalg.lstsq(rows, np.append(error, np.zeros(A.shape[1])))[0]
        step *= min(1.0, 0.5 / max(float(np.max(np.abs(step))), 1e-300))
        trial = np.clip(q + step, low, high)
        there, J_there = _error(arm, place, trial)
        if there @ there < size:
            q, error, J, mu = trial, there, J_there, max(0.3 * mu, 1e-6)
        else:
            mu *= 5.0
            if mu > 1e6:
                return None
    return None


def _judged(
    arm: Arm,
    course: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    clear: Callable[[np.ndarray, int], float] | None,
) -> Reach:
    dexterity, clearance = np.inf, 1.0
    for number, q in enumerate(course):
        if clear is not None:
            clearance = min(clearance, clear(arm.skeleton(q), number))
        J = arm.terms(q, np.zeros(arm.dof)).J.copy()
        J[:3] /= LENGTH
        dexterity = min(dexterity, float(np.linalg.svd(J, compute_uv=False)[-1]))
    limited = np.isfinite(arm.position_limits).all(axis=1)
    half = np.maximum(0.5 * (high - low), 1e-9)
    room = np.minimum(course - low, high - course) / half
    nearest = float(np.min(room[:, limited], initial=1.0))
    return Reach(course, dexterity, nearest, clearance)
