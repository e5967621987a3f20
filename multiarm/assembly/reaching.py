r"""Reaching a place: the kernel of inverse kinematics.

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

import numpy as np

from multiarm.arms.chain import (
    ChainJoint,
    chain_joints,
    column_of,
    frame_after,
    joints_at_rest,
    next_frame,
)
from multiarm.arms.terms import ArmStructure
from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.jit.kernels import (
    INTS,
    NUMBER,
    NUMBERS,
    TABLE,
    allocating,
    copy,
    greatest,
    inlined,
    kernel,
)
from multiarm.jit.rows import fields_of, row_of
from multiarm.jit.vectors import AXES, ZERO, add_cross, compose, rotation_vector

# A posture reaches a place when shift, in lengths of the search, and turn [rad] are off by less.
REACHED = 1e-8
# Steps from one start, the longest change of a joint in a step [rad, m].
STEPS, LONGEST = 60, 0.5
# Damping at the start, least damping, and where the search gives up, as parts of the squared error.
DAMPING, LEAST_DAMPING, STUCK = 1e-2, 1e-6, 1e6

open_joint = row_of(ChainJoint)


def chain_to(arm: ArmStructure, end: np.ndarray) -> np.ndarray:
    """The joints of an arm from the world's origin, and its end as one that does not move.

    Rows of :class:`multiarm.arms.chain.ChainJoint`, shape (n + 1, 34); ``end`` (4, 4) is a frame on
    the last link.
    """
    chain = np.vstack([chain_joints(arm), joints_at_rest(1)])
    joints = fields_of(ChainJoint, chain)
    joints.offset[0] = arm.translations[0]
    joints.axes[-1] = joints.link_axes[-2] @ end[:3, :3]
    joints.offset[-1] = joints.link_axes[-2] @ end[:3, 3]
    return chain


@kernel
def write_pose(chain: TABLE, q: NUMBERS, pose: TABLE, J: TABLE):
    """Write the pose (4, 4) of a chain's end in the world, and its Jacobian (6, n), world axes.

    The last row of the pose is left as it is.
    """
    n, axes, p = q.size, AXES, ZERO
    for k in range(n):
        joint = open_joint(chain[k])
        angle = joint.turns * q[k]
        axes, p = next_frame(joint, axes, p, q[k], math.sin(angle), math.cos(angle))
        linear, angular = column_of(joint, axes[2], p)
        J[0, k], J[1, k], J[2, k] = linear
        J[3, k], J[4, k], J[5, k] = angular
    axes, p = frame_after(open_joint(chain[n]), axes, p)
    for k in range(n):  # about the end
        linear, angular = (J[0, k], J[1, k], J[2, k]), (J[3, k], J[4, k], J[5, k])
        J[0, k], J[1, k], J[2, k] = add_cross(linear, angular, p)
    for i in range(3):
        pose[i, 0], pose[i, 1], pose[i, 2], pose[i, 3] = axes[0][i], axes[1][i], axes[2][i], p[i]


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
    error, trial_error, rows, trial_rows = (
        np.empty(m),
        np.empty(m),
        np.empty((m, n)),
        np.empty((m, n)),
    )
    A, step, y = np.empty((m, m)), np.empty(n), np.empty(m)
    damping = DAMPING
    size = write_error(chain, place, counted, length, q, pose, J, error, rows)
    for _ in range(STEPS):
        longest = write_step(error, rows, lower, upper, q, damping * size, A, y, step)
        scale = min(1.0, LONGEST / max(longest, 1e-300))
        for k in range(n):
            trial[k] = min(max(q[k] + scale * step[k], lower[k]), upper[k])
        trial_size = write_error(
            chain, place, counted, length, trial, pose, J, trial_error, trial_rows
        )
        if trial_size < size:
            size = trial_size
            copy(trial, q)
            copy(trial_error, error)
            for i in range(m):
                copy(trial_rows[i], rows[i])
            damping = max(0.3 * damping, LEAST_DAMPING)
        else:
            damping *= 5.0
            if damping > STUCK or greatest(error) < REACHED:  # as near as rounding lets it come
                break
    return greatest(error)


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
    for k in range(n):
        change = 0.0
        for i in range(m):
            change -= rows[i, k] * y[i]
        step[k] *= change
    return greatest(step)


@inlined
def turn_between(a, b):
    """Rotation vector from the orientation in a pose to that in another, world axes [rad]."""
    back = (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])
    B = (b[0, 0], b[1, 0], b[2, 0]), (b[0, 1], b[1, 1], b[2, 1]), (b[0, 2], b[1, 2], b[2, 2])
    return rotation_vector(compose(B, back))


@kernel
def write_error(chain, place, counted, length, q, pose, J, error, rows):
    """Write the error of a posture and its derivatives; returns the square of the error."""
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
