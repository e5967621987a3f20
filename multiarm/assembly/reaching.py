r"""Reaching places: the kernel of inverse kinematics.

A connection brings a frame on a link of a robot to another frame: to one at rest, the connection's
place in the world, or to one on another link.  Its error is

.. math:: e_c(q) = S_c \begin{bmatrix} R_2^T (x_1 - x_2) / \ell \\ R_2^T \theta \end{bmatrix} ,

``x`` the positions of the frames, ``theta`` the rotation vector from the orientation of the second
to that of the first, world axes, ``S`` the components that count, in the axes of the second.  With
the twists :math:`J_1, J_2` of both links, each taken at :math:`x_1`, its derivative is

.. math::
    \frac{\partial e_c}{\partial q} = S_c
    \begin{bmatrix} R_2^T / \ell & \\ & R_2^T \end{bmatrix} (J_1 - J_2)

up to terms of the order of the error: joints that move both links do not count.  Joints may follow
others, :math:`q = a\,x + b`; what is sought is ``x``, the positions of those that follow none.

The errors ``e`` of all connections are closed at once.  The method is Levenberg and Marquardt's
within the limits of the joints,

.. math:: \delta x = -J^T (J J^T + \mu I)^{-1} e ,

where a joint at a limit that it presses on rests, and :math:`\mu` falls with the error, so that the
method converges quadratically, at redundant robots to a posture near the start.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.jit.kernels import (
    INT,
    INTS,
    NUMBER,
    NUMBERS,
    TABLE,
    allocating,
    copy,
    greatest,
    inlined,
    kernel,
    named_tuple_of,
)
from multiarm.jit.rows import Pair, row_of, width
from multiarm.jit.vectors import AXES, ZERO, add_cross, compose, rotation_vector, sub
from multiarm.robots.chain import (
    ChainJoint,
    column_of,
    frame_after,
    next_frame,
)
from multiarm.robots.terms import POSE_WIDTH, open_pose

# Frames coincide when shift, in lengths of the search, and turn [rad] are off by less.
REACHED = 1e-8
# Steps from one start, the longest change of a joint in a step [rad, m].
STEPS, LONGEST = 60, 0.5
# Damping at the start, least damping, and where the search gives up, as parts of the squared error.
DAMPING, LEAST_DAMPING, STUCK = 1e-2, 1e-6, 1e6


class Tree(NamedTuple):
    """A robot's joints, and the frames that its connections bring together.

    joints : (n + F, 34)
        Rows of :class:`multiarm.robots.chain.ChainJoint`: of the joints, parents first, then of the
        frames, as joints at rest on their links or in the world.
    parents : int (n + F,)
        Number of the joint that carries each of them, -1 for the world.
    first, second : int (C,)
        Numbers of the two frames of each connection, as rows of ``joints``.
    counted : int (m,)
        Components of the errors that count: ``6 c + component`` of connection ``c``; components 0
        to 2 are shifts along, 3 to 5 turns about x, y, z of its second frame.
    moves : (C, n)
        1 for joints that move the first link of a connection, less 1 for those of its second.
    independent : int (d,)
        The joints that follow none, whose positions are ``x``.
    leaders : int (n,)
        Which of the numbers ``x`` moves a joint.
    multipliers, offsets : (n,)
        The joint is at ``multiplier * x + offset`` [rad or m].
    """

    joints: np.ndarray
    parents: np.ndarray
    first: np.ndarray
    second: np.ndarray
    counted: np.ndarray
    moves: np.ndarray
    independent: np.ndarray
    leaders: np.ndarray
    multipliers: np.ndarray
    offsets: np.ndarray


class Column(NamedTuple):
    """A joint's column of the Jacobian: the velocity of its link for a unit rate."""

    twist: Pair  # about the world's origin


TREE: Any = named_tuple_of(Tree, TABLE, INTS, INTS, INTS, INTS, TABLE, INTS, INTS, NUMBERS, NUMBERS)
COLUMN_WIDTH = width(Column)
open_joint, open_column = row_of(ChainJoint), row_of(Column)


class Trial(NamedTuple):
    """Arrays for the error of a posture.

    poses : (n + F, 12)
        Rows of :class:`multiarm.robots.terms.LinkPose`: of the joints and the frames.
    columns : (n, 6)
        Rows of :class:`Column`.
    J : (6, d)
        Twist of the first frame of a connection, seen from the link of its second, for unit rates
        of the numbers ``x``; world axes.
    error : (m,)
    rows : (m, d)
        Derivative of the error.
    """

    poses: np.ndarray
    columns: np.ndarray
    J: np.ndarray
    error: np.ndarray
    rows: np.ndarray


@allocating
def arrays_for(tree, d):
    """Arrays for the error of a posture of ``d`` numbers."""
    n, m = tree.leaders.size, tree.counted.size
    return Trial(
        np.empty((tree.parents.size, POSE_WIDTH)),
        np.empty((n, COLUMN_WIDTH)),
        np.empty((6, d)),
        np.empty(m),
        np.empty((m, d)),
    )


@kernel
def write_poses(tree: TREE, x: NUMBERS, poses: TABLE, columns: TABLE):
    """Write the poses of all joints and frames, and the columns of the joints."""
    n = tree.leaders.size
    for k in range(tree.parents.size):
        joint, axes, p = open_joint(tree.joints[k]), AXES, ZERO
        if tree.parents[k] >= 0:
            parent = open_pose(poses[tree.parents[k]])
            axes, p = parent.axes, parent.origin
        if k < n:
            position = tree.multipliers[k] * x[tree.leaders[k]] + tree.offsets[k]
            angle = joint.turns * position
            axes, p = next_frame(joint, axes, p, position, math.sin(angle), math.cos(angle))
            column = open_column(columns[k])
            column.twist = column_of(joint, axes[2], p)
        else:
            axes, p = frame_after(joint, axes, p)
        pose = open_pose(poses[k])
        pose.axes, pose.origin = axes, p


@kernel
def write_jacobian(tree: TREE, c: INT, poses: TABLE, columns: TABLE, J: TABLE):
    """Write the twist of a connection's first frame, seen from its second link, by unit rates."""
    p = open_pose(poses[tree.first[c]]).origin
    for i in range(6):
        for k in range(J.shape[1]):
            J[i, k] = 0.0
    for k in range(tree.leaders.size):
        if tree.moves[c, k] != 0.0:
            linear, angular = open_column(columns[k]).twist
            linear, factor = add_cross(linear, angular, p), tree.moves[c, k] * tree.multipliers[k]
            for i in range(3):
                J[i, tree.leaders[k]] += factor * linear[i]
                J[3 + i, tree.leaders[k]] += factor * angular[i]


@allocating
def reach_places(tree: TREE, lower: NUMBERS, upper: NUMBERS, length: NUMBER, x: NUMBERS):
    """Close the errors from a posture ``x`` (d,); returns the largest component that is left."""
    d, m = x.size, tree.counted.size
    here, there = arrays_for(tree, d), arrays_for(tree, d)
    trial, A, step, y = np.empty(d), np.empty((m, m)), np.empty(d), np.empty(m)
    damping = DAMPING
    size = write_error(tree, length, x, here)
    for _ in range(STEPS):
        longest = write_step(here.error, here.rows, lower, upper, x, damping * size, A, y, step)
        scale = min(1.0, LONGEST / max(longest, 1e-300))
        for k in range(d):
            trial[k] = min(max(x[k] + scale * step[k], lower[k]), upper[k])
        trial_size = write_error(tree, length, trial, there)
        if trial_size < size:
            size = trial_size
            copy(trial, x)
            copy(there.error, here.error)
            for i in range(m):
                copy(there.rows[i], here.rows[i])
            damping = max(0.3 * damping, LEAST_DAMPING)
        else:
            damping *= 5.0
            if damping > STUCK or greatest(here.error) < REACHED:  # as near as rounding lets it
                break
    return greatest(here.error)


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
    """Rotation vector from an orientation to another, both as their axes [rad]."""
    back = (a[0][0], a[1][0], a[2][0]), (a[0][1], a[1][1], a[2][1]), (a[0][2], a[1][2], a[2][2])
    return rotation_vector(compose(b, back))


@kernel
def write_error(tree, length, x, trial):
    """Write the error of a posture and its derivatives; returns the square of the error."""
    write_poses(tree, x, trial.poses, trial.columns)
    square, r = 0.0, 0
    for c in range(tree.first.size):
        write_jacobian(tree, c, trial.poses, trial.columns, trial.J)
        first = open_pose(trial.poses[tree.first[c]])
        second = open_pose(trial.poses[tree.second[c]])
        shift, turn = sub(first.origin, second.origin), turn_between(second.axes, first.axes)
        while r < tree.counted.size and tree.counted[r] // 6 == c:
            part, axis = tree.counted[r] % 6 // 3, tree.counted[r] % 3
            along, value = second.axes[axis], 0.0
            for i in range(3):
                value += along[i] * (shift[i] / length if part == 0 else turn[i])
            trial.error[r] = value
            square += value * value
            for k in range(x.size):
                value = 0.0
                for i in range(3):
                    value += along[i] * trial.J[3 * part + i, k]
                trial.rows[r, k] = value / length if part == 0 else value
            r += 1
    return square
