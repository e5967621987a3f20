r"""Inverse kinematics: joint positions with which an arm holds its tip at wanted poses.

A posture makes the pose error zero,

.. math:: e(q) = S \begin{bmatrix} (x(q) - x_r) / \ell \\ \theta(q) \end{bmatrix} ,

``x`` the tip's position and ``theta`` the rotation vector from the wanted orientation to the tip's,
both in the axes of a frame at the wanted pose, ``S`` the components that count: a joint that leaves
a motion free does not ask for it.

*The method* is Levenberg and Marquardt's within the limits of the joints, from starts spread over
them,

.. math:: \delta q = -J^T (J J^T + \mu I)^{-1} e ,

where a joint at a limit that it presses on rests, and :math:`\mu` falls with the error, so that the
method converges quadratically, at redundant arms to a posture near the start.  Of the postures
found, the best is farthest from singular ones and from its limits, at every pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.terms import ArmStructure
from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.jit.kernels import INTS, NUMBERS, TABLE, allocating, copy, inlined, kernel
from multiarm.spatial import difference, matrix_to_quaternion

# Length that compares shifts with turns [m]: about half an arm.
LENGTH = 0.5
# A posture reaches a place when shift [m] and turn [rad] are off by less.
REACHED = 1e-8
# Joints without limits are sought within a turn either way, all others this far inside them [rad].
TURN, MARGIN = math.pi, 0.05
# Steps from one start, the longest change of a joint in a step [rad, m].
STEPS, LONGEST = 60, 0.5
# Qualities closer than this part are equal, as those of postures that mirror each other.
TIE = 1e-6
# Damping at the start, least damping, and where the search gives up, as parts of the squared error.
DAMPING, LEAST_DAMPING, STUCK = 1e-2, 1e-6, 1e6
# Joints should keep this far from things that are in the way [m].
APART = 0.1


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


@dataclass(frozen=True)
class Miss:
    """The nearest posture to a place that is out of reach.

    Attributes
    ----------
    posture : ndarray, shape (n,)
        [rad or m]
    shift : ndarray, shape (3,)
        From the tip there to the wanted place, world axes [m].
    turn : float
        Angle between the orientations there [rad].
    """

    posture: np.ndarray
    shift: np.ndarray
    turn: float


class InverseKinematics:
    """The search for postures of one arm.

    Parameters
    ----------
    arm : Arm
    free : sequence of int
        Components of the pose that do not count, in the axes of the wanted frame: 0 to 2 are shifts
        along, 3 to 5 turns about x, y, z.
    frame : ndarray, shape (4, 4), optional
        The frame of the tip that is brought to the wanted places, in the tip's frame.

    Attributes
    ----------
    lower, upper : ndarray, shape (n,)
        Bounds of the search [rad, m].
    """

    def __init__(self, arm: Arm, free: Sequence[int] = (), frame: np.ndarray | None = None) -> None:
        self.arm = arm
        self.lower, self.upper = _bounds(arm)
        self._counted = np.setdiff1d(np.arange(6), free)
        tip = np.eye(4)
        tip[:3, :3], tip[:3, 3] = arm.tip_rotation, arm.tip_translation
        self._chain = _chain(arm.structure(), tip if frame is None else tip @ frame)

    def search(
        self,
        places: Sequence[np.ndarray],
        rng: np.random.Generator,
        starts: int = 24,
        clear: Callable[[np.ndarray, int], float] | None = None,
    ) -> Reach | None:
        """The best posture found that reaches a place, and then others.

        Parameters
        ----------
        places : sequence of ndarray, shape (4, 4)
            Poses of the frame in the world; the second is reached from the posture at the first.
        rng : numpy.random.Generator
            Where the search starts.
        starts : int
            How many postures the search begins at.
        clear : callable, optional
            Of the origins of all joints and of the tip in the world, shape (n + 1, 3) [m], and of
            the number of the place: a factor on the quality, 1 where the arm is out of the way of
            everything, less where it is not.

        Returns
        -------
        Reach or None
            None where no start leads to a posture that reaches all places.
        """
        best: Reach | None = None
        for _ in range(starts):
            course = self._follow(rng.uniform(self.lower, self.upper), places)
            if course is None:
                continue
            reach = self._judge(course, clear)
            if best is None or reach.quality > best.quality * (1.0 + TIE):
                best = reach
        return best

    def nearest(self, place: np.ndarray, rng: np.random.Generator, starts: int = 24) -> Miss:
        """The posture nearest to a place that none reaches."""
        found = [self._solve(place, rng.uniform(self.lower, self.upper)) for _ in range(starts)]
        posture, _ = min(found, key=lambda one: one[1])
        there, _ = self.pose(posture)
        turn = difference(*(matrix_to_quaternion(X[:3, :3]) for X in (there, place)))
        return Miss(posture, place[:3, 3] - there[:3, 3], float(np.linalg.norm(turn)))

    def pose(self, posture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) of the frame in the world, and its Jacobian (6, n), world axes."""
        pose, J = np.eye(4), np.zeros((6, len(posture)))
        write_pose(self._chain, np.array(posture, dtype=float), pose, J)
        return pose, J

    def _follow(self, start: np.ndarray, places: Sequence[np.ndarray]) -> np.ndarray | None:
        course = []
        for place in places:
            start, error = self._solve(place, start)
            if not error < REACHED:
                return None
            course.append(start)
        return np.array(course)

    def _solve(self, place: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, float]:
        """A posture, and the largest component of its error."""
        q = start.copy()
        error = reach_place(
            self._chain, np.ascontiguousarray(place), self._counted, self.lower, self.upper, q
        )
        return q, error

    def _judge(self, course: np.ndarray, clear: Callable[[np.ndarray, int], float] | None) -> Reach:
        dexterity, clearance = np.inf, 1.0
        for number, q in enumerate(course):
            if clear is not None:
                clearance = min(clearance, clear(self.arm.skeleton(q), number))
            pose, J = self.pose(q)
            J = (pose[:3, :3].T @ J.reshape(2, 3, -1)).reshape(6, -1)
            J[:3] /= LENGTH
            values = np.linalg.svd(J[self._counted], compute_uv=False)
            dexterity = min(dexterity, float(values[-1]))
        limited = np.isfinite(self.arm.position_limits).all(axis=1)
        half = np.maximum(0.5 * (self.upper - self.lower), 1e-9)
        room = np.minimum(course - self.lower, self.upper - course) / half
        return Reach(course, dexterity, float(np.min(room[:, limited], initial=1.0)), clearance)


def points_on_links(origins: np.ndarray) -> np.ndarray:
    """Points on the lines between origins of joints, (5 (n - 1), 3) of (n, 3) [m]."""
    steps = np.linspace(0.0, 1.0, 5)[:, None, None]
    return (origins[:-1] + steps * np.diff(origins, axis=0)).reshape(-1, 3)


def clearance(*distances: np.ndarray) -> float:
    """A factor of the quality: 1 where all distances [m] are at least ``APART``, never zero."""
    nearest = min(float(np.min(own, initial=APART)) for own in distances)
    return float(np.clip(nearest / APART, 0.02, 1.0))


def _bounds(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    endless = ~np.isfinite(arm.position_limits).all(axis=1)
    low, high = np.where(endless, 0.0, arm.position_limits.T)
    middle = 0.5 * (low + high)
    half = np.where(endless, TURN, 0.5 * (high - low) - MARGIN)
    half = np.minimum(np.maximum(half, 0.0), TURN)
    return middle - half, middle + half


# --- the kernel -----------------------------------------------------------------------------------

# Columns of a chain's table, a row for each joint and one for the end: whether it slides, its axis,
# and its frame at zero in the one before: rotation row by row, origin.
SLIDES, AXIS, ROTATION, ORIGIN, CHAIN_WIDTH = 0, 1, 4, 13, 16


def _chain(arm: ArmStructure, end: np.ndarray) -> np.ndarray:
    joints = len(arm.slides)
    table = np.zeros((joints + 1, CHAIN_WIDTH))
    table[:joints, SLIDES] = arm.slides
    table[:joints, AXIS:ROTATION] = arm.axes
    table[:joints, ROTATION:ORIGIN] = arm.rotations.reshape(joints, 9)
    table[:joints, ORIGIN:] = arm.translations
    table[joints, ROTATION:ORIGIN], table[joints, ORIGIN:] = end[:3, :3].ravel(), end[:3, 3]
    return table


@kernel
def write_pose(chain: TABLE, q: NUMBERS, pose: TABLE, J: TABLE):
    """Write the pose (4, 4) of a chain's end in the world, and its Jacobian (6, n), world axes."""
    n = q.size
    for k in range(n + 1):
        row = chain[k]
        # origin and rotation of the next frame at zero
        for i in range(3):
            for j in range(3):
                pose[i, 3] += pose[i, j] * row[ORIGIN + j]
        for i in range(3):
            a, b, c = pose[i, 0], pose[i, 1], pose[i, 2]
            for j in range(3):
                pose[i, j] = (
                    a * row[ROTATION + j] + b * row[ROTATION + 3 + j] + c * row[ROTATION + 6 + j]
                )
        if k == n:
            break
        x, y, z = row[AXIS], row[AXIS + 1], row[AXIS + 2]
        slides = row[SLIDES] != 0.0
        for i in range(3):
            along = pose[i, 0] * x + pose[i, 1] * y + pose[i, 2] * z
            J[i, k] = along if slides else pose[i, 3]  # of a turning joint its origin, for now
            J[3 + i, k] = 0.0 if slides else along
            if slides:
                pose[i, 3] += along * q[k]
        if not slides:
            turn_columns(pose, x, y, z, q[k])
    for k in range(n):
        if chain[k, SLIDES] == 0.0:
            a, b, c = J[3, k], J[4, k], J[5, k]
            x, y, z = pose[0, 3] - J[0, k], pose[1, 3] - J[1, k], pose[2, 3] - J[2, k]
            J[0, k], J[1, k], J[2, k] = b * z - c * y, c * x - a * z, a * y - b * x


@inlined
def turn_columns(pose, x, y, z, angle):
    """Turn a rotation about an axis of its own by an angle (Rodrigues' formula)."""
    sine, rest = math.sin(angle), 1.0 - math.cos(angle)
    for i in range(3):
        a, b, c = pose[i, 0], pose[i, 1], pose[i, 2]
        # a row times (1 + sine K + rest K K), K the matrix of the cross product with the axis
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        pose[i, 0] = a + sine * u + rest * (v * z - w * y)
        pose[i, 1] = b + sine * v + rest * (w * x - u * z)
        pose[i, 2] = c + sine * w + rest * (u * y - v * x)


@allocating
def reach_place(
    chain: TABLE, place: TABLE, counted: INTS, lower: NUMBERS, upper: NUMBERS, q: NUMBERS
):
    """Move a posture to a place; returns the largest component of the error that is left."""
    n, m = q.size, counted.size
    trial, pose, J = np.empty(n), np.empty((4, 4)), np.empty((6, n))
    error, there, rows, rows_there = np.empty(m), np.empty(m), np.empty((m, n)), np.empty((m, n))
    A, step, y = np.empty((m, m)), np.empty(n), np.empty(m)
    damping = DAMPING
    size = write_error(chain, place, counted, q, pose, J, error, rows)
    for _ in range(STEPS):
        longest = write_step(error, rows, lower, upper, q, damping * size, A, y, step)
        scale = min(1.0, LONGEST / max(longest, 1e-300))
        for k in range(n):
            trial[k] = min(max(q[k] + scale * step[k], lower[k]), upper[k])
        size_there = write_error(chain, place, counted, trial, pose, J, there, rows_there)
        if size_there < size:
            size = size_there
            copy(trial, q)
            copy(there, error)
            for i in range(m):
                copy(rows_there[i], rows[i])
            damping = max(0.3 * damping, LEAST_DAMPING)
        else:
            damping *= 5.0
            if damping > STUCK or largest(error) < REACHED:  # as near as rounding lets it come
                break
    return largest(error)


@allocating
def write_step(error, rows, lower, upper, q, damping, A, y, step):
    """Write the step of Levenberg and Marquardt, zero for joints at rest; returns the longest."""
    m, n = rows.shape
    for k in range(n):
        gradient = 0.0
        for i in range(m):
            gradient += rows[i, k] * error[i]
        rests = (q[k] <= lower[k] and gradient > 0.0) or (q[k] >= upper[k] and gradient < 0.0)
        step[k] = 0.0 if rests else 1.0
    for i in range(m):
        for j in range(m):
            A[i, j] = damping if i == j else 0.0
            for k in range(n):
                A[i, j] += step[k] * rows[i, k] * rows[j, k]
    solve_semidefinite(A, error, y)
    longest = 0.0
    for k in range(n):
        change = 0.0
        for i in range(m):
            change -= rows[i, k] * y[i]
        step[k] *= change
        longest = max(longest, abs(step[k]))
    return longest


@kernel
def largest(vector):
    """Largest magnitude of an entry."""
    size = 0.0
    for value in vector:
        size = max(size, abs(value))
    return size


@inlined
def turn_between(a, b):
    """Rotation vector from the orientation in a pose to that in another, world axes [rad]."""
    x = y = z = trace = 0.0
    for k in range(3):  # of the product R = R_b R_a^T
        x += b[2, k] * a[1, k] - b[1, k] * a[2, k]
        y += b[0, k] * a[2, k] - b[2, k] * a[0, k]
        z += b[1, k] * a[0, k] - b[0, k] * a[1, k]
        trace += b[0, k] * a[0, k] + b[1, k] * a[1, k] + b[2, k] * a[2, k]
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 0.5 if sine == 0.0 else math.atan2(sine, trace - 1.0) / sine
    return factor * x, factor * y, factor * z


@kernel
def write_error(chain, place, counted, q, pose, J, error, rows):
    """Write the error of a posture and its derivatives; returns the square of the error."""
    for i in range(4):
        for j in range(4):
            pose[i, j] = 1.0 if i == j else 0.0
    write_pose(chain, q, pose, J)
    turn = turn_between(place, pose)
    square = 0.0
    for c in range(counted.size):
        part, axis = counted[c] // 3, counted[c] % 3
        value = 0.0
        for i in range(3):
            world = (pose[i, 3] - place[i, 3]) / LENGTH if part == 0 else turn[i]
            value += place[i, axis] * world
        error[c] = value
        square += value * value
        for k in range(q.size):
            value = 0.0
            for i in range(3):
                value += place[i, axis] * J[3 * part + i, k]
            rows[c, k] = value / LENGTH if part == 0 else value
    return square
