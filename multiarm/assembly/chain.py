r"""A step towards a place: the kernel of inverse kinematics.

The error of a posture is

.. math:: e(q) = S \begin{bmatrix} (x(q) - x_r) / \ell \\ \theta(q) \end{bmatrix} ,

``x`` the position of the chain's end and ``theta`` the rotation vector from the wanted orientation
to that of the end, both in the axes of a frame at the wanted pose, ``S`` the components that count.
The method is Levenberg and Marquardt's within the limits of the joints,

.. math:: \delta q = -J^T (J J^T + \mu I)^{-1} e ,

where a joint at a limit that it presses on rests, and :math:`\mu` falls with the error, so that the
method converges quadratically, at redundant arms to a posture near the start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from multiarm.arms.terms import ArmStructure
from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.jit.kernels import INTS, NUMBER, NUMBERS, TABLE, allocating, copy, inlined, kernel
from multiarm.jit.vectors import compose, rotation_vector

# A posture reaches a place when shift, in lengths of the search, and turn [rad] are off by less.
REACHED = 1e-8
# Steps from one start, the longest change of a joint in a step [rad, m].
STEPS, LONGEST = 60, 0.5
# Damping at the start, least damping, and where the search gives up, as parts of the squared error.
DAMPING, LEAST_DAMPING, STUCK = 1e-2, 1e-6, 1e6

# Columns of a chain's table, a row for each joint and one for the end: whether it slides, its axis,
# and its frame at zero in the one before: rotation row by row, origin.
SLIDES, AXIS, ROTATION, ORIGIN, CHAIN_WIDTH = 0, 1, 4, 13, 16


def chain_table(arm: ArmStructure, end: np.ndarray) -> np.ndarray:
    """The table of an arm whose end is a frame (4, 4) on its last link."""
    rows = zip(arm.rotations, arm.translations, arm.slides, arm.axes, strict=True)
    joints = [chain_row(R, p, slides, axis) for R, p, slides, axis in rows]
    return np.array([*joints, chain_row(end[:3, :3], end[:3, 3])])


def chain_row(
    rotation: np.ndarray,
    origin: np.ndarray,
    slides: bool = False,
    axis: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """A row of the table."""
    return np.concatenate([[slides], axis, rotation.ravel(), origin])


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
    chain: TABLE,
    place: TABLE,
    counted: INTS,
    lower: NUMBERS,
    upper: NUMBERS,
    length: NUMBER,
    q: NUMBERS,
):
    """Move a posture to a place; returns the largest component of the error that is left."""
    n, m = q.size, counted.size
    trial, pose, J = np.empty(n), np.empty((4, 4)), np.empty((6, n))
    error, there, rows, rows_there = np.empty(m), np.empty(m), np.empty((m, n)), np.empty((m, n))
    A, step, y = np.empty((m, m)), np.empty(n), np.empty(m)
    damping = DAMPING
    size = write_error(chain, place, counted, length, q, pose, J, error, rows)
    for _ in range(STEPS):
        longest = write_step(error, rows, lower, upper, q, damping * size, A, y, step)
        scale = min(1.0, LONGEST / max(longest, 1e-300))
        for k in range(n):
            trial[k] = min(max(q[k] + scale * step[k], lower[k]), upper[k])
        size_there = write_error(chain, place, counted, length, trial, pose, J, there, rows_there)
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
    back = (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])
    B = (b[0, 0], b[1, 0], b[2, 0]), (b[0, 1], b[1, 1], b[2, 1]), (b[0, 2], b[1, 2], b[2, 2])
    return rotation_vector(compose(B, back))


@kernel
def write_error(chain, place, counted, length, q, pose, J, error, rows):
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
            world = (pose[i, 3] - place[i, 3]) / length if part == 0 else turn[i]
            value += place[i, axis] * world
        error[c] = value
        square += value * value
        for k in range(q.size):
            value = 0.0
            for i in range(3):
                value += place[i, axis] * J[3 * part + i, k]
            rows[c, k] = value / length if part == 0 else value
    return square
