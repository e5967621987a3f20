r"""One step of a Rosenbrock method: linearly implicit, for scenes with fast damped motions.

With ``u' = f(t, u)``, ``J`` its Jacobian and ``f_t`` its time derivative at the beginning of the
step, the stages of Rodas5P solve linear systems with one and the same matrix,

.. math::
    \Big(\frac{1}{\gamma} - hJ\Big) k_i = f\Big(t + c_i h,\ u + h\sum_{j<i} a_{ij} k_j\Big)
        + \sum_{j<i} C_{ij} k_j + h\, d_i f_t, \qquad u_1 = u + h \sum_i b_i k_i ,

and the last of them is the error estimate (G. Steinebach, BIT Numer. Math. 63:27, 2023; E. Hairer,
G. Wanner, Solving Ordinary Differential Equations II, IV.7).  The method is of order 5 and
L-stable: motions that damping, stiff springs or stiff gains make fast do not limit the step once
they have died out.

*The matrix.*  The state is ``[positions, velocities, inner states, works]``; inner states are those
of effects, and are treated like velocities that move no position.  Only accelerations, inner rates
and powers need differences; the positions' rates are known.  At the beginning of a step, where the
chart's rotation vector is zero, they are ``B p + v`` with ``B = blkdiag(0, S(omega)/2, 0)``, and so
with ``R = (1/gamma - hB)^{-1}``, which is written down,

.. math::
    k_p = R\,(r_p + h k_v), \qquad
    \Big(\frac1\gamma - h J_v - h^2 J_p R\Big) k_v = r_v + h J_p R\, r_p, \qquad
    k_w = \gamma\,\big(r_w + h (J_{wp} k_p + J_{wv} k_v)\big):

one matrix as large as there are velocities, half as large as the state, without inner states.

*The derivatives* are exact, arm by arm, where control and effects are local, gravity compensation
besides (:mod:`multiarm.integration.arm_blocks`): no further evaluation, and a cost linear in the
arms.  A law or effect that states no derivative adds 2 n + 1 evaluations of the kinematics, for n
joints of the largest arm.  Elsewhere they are differences of whole evaluations, central in the
positions, on which everything depends in the most curved way, and forward in the velocities, of
which accelerations are quadratic functions: 3 (6 + n) evaluations for n joints of all arms, two
more when something depends on time.  The cost of a step then grows with the square of the number of
arms, that of the matrix with its cube; for few arms both are small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.factors import factor_lu, solve_lu
from multiarm.dynamics.status import NOT_FINITE, OK
from multiarm.integration.arm_blocks import (
    TIME_CHANGE,
    ArmBlocks,
    acts_locally,
    differentiate_arms,
    is_regular,
    make_arm_blocks,
    share_weight,
    write_time_slope,
)
from multiarm.integration.arm_stages import factor_stages, solve_arm_stage, turn
from multiarm.integration.projection import greatest
from multiarm.integration.step import METHOD_WORK, Step, combine, open_step, slope_at, stage_slope
from multiarm.jit.kernels import cfunc, clear, copy, kernel
from multiarm.jit.structs import Floats1, Floats2, Ints1, struct_at, view


class RosenbrockWork(NamedTuple):
    """A step's arrays for ``D = N + M + w`` entries of the chart's vector.

    They are N positions, ``M = N + e`` velocities and states of effects, and ``w`` works.
    """

    slope: Floats1  # (D,), the first slope
    other: Floats1  # (D,), scratch
    time_slope: Floats1  # (D,), derivative with respect to time
    # derivatives of the accelerations, inner rates and, last, of the powers
    by_position: Floats2  # (M + w, N)
    by_velocity: Floats2  # (M + w, M)
    turned: Floats2  # (M, N), J_p R
    # factors of the linear system
    matrix: Floats2  # (M, M)
    pivots: Ints1  # (M,)


def make_rosenbrock(data: Data, step: Step) -> tuple[RosenbrockWork, ArmBlocks]:
    """Allocate the arrays of a Rosenbrock method's steps."""
    size, n = step.z.size, data.model.layout.nv
    m = step.tolerance.size - n
    work = RosenbrockWork(
        slope=np.zeros(size),
        other=np.zeros(size),
        time_slope=np.zeros(size),
        by_position=np.zeros((size - n, n)),
        by_velocity=np.zeros((size - n, m)),
        turned=np.zeros((m, n)),
        matrix=np.zeros((m, m)),
        pivots=np.zeros(m, dtype=np.int64),
    )
    return work, make_arm_blocks(data, step)


_view_work = view(RosenbrockWork, METHOD_WORK)
_view_blocks = view(ArmBlocks, METHOD_WORK + len(RosenbrockWork._fields))


@cfunc
def rosenbrock_step(address, size, t, h):
    """All stages of a step of length ``h`` from time ``t``, then ``z_new``; returns a status.

    ``step.k[0]`` holds the first slope.
    """
    struct = struct_at(address, size)
    method, step = open_step(struct)
    work, blocks = _view_work(struct), _view_blocks(struct)
    copy(step.k[0], work.slope)
    status = differentiate(step, work, blocks, t, h)
    if status != OK:
        return status
    n = work.by_position.shape[1]
    omega, gamma = step.z[n + 3 : n + 6], method.gamma
    if blocks.used[0] != 0:
        usable = factor_stages(gamma, blocks, step.system, omega, h)
    else:
        usable = factor(method, step, work, h)
    if not usable:
        return NOT_FINITE
    for i in range(method.stages):
        copy(work.slope, work.other)
        if i > 0:
            combine(step, method.A[i], i, h, step.z_stage)
            status = stage_slope(step, t + method.c[i] * h, step.z_stage, work.other)
            if status != OK:
                return status
        for j in range(i):
            weight = method.C[i, j]
            for l in range(work.other.size):  # noqa: E741
                work.other[l] += weight * step.k[j, l]
        for l in range(work.other.size):  # noqa: E741
            work.other[l] += h * method.d[i] * work.time_slope[l]
        if blocks.used[0] != 0:
            solve_arm_stage(gamma, blocks, step.system, omega, h, work.other, step.k[i])
        else:
            solve_stage(method, step, work, h, work.other, step.k[i])
    combine(step, method.b, method.stages, h, step.z_new)
    return OK


@kernel
def differentiate(step, work, blocks, t, h):
    """Derivatives at the beginning of the step, arm by arm where possible; returns a status."""
    blocks.used[0] = 0
    if acts_locally(step):
        status = slope_at(step, t, step.z, work.other)
        if status != OK:
            return status
        if is_regular(step.system) and share_weight(step.system, blocks):
            blocks.used[0] = 1
            status = differentiate_arms(step, blocks, t, h)
            write_time_slope(blocks, step.system, work.time_slope)
            return status
    return differentiate_whole(step, work, t, h)


@kernel
def differentiate_whole(step, work, t, h):
    """Derivatives from differences of whole evaluations; returns a status."""
    # changes of a position [m, rad]; of a velocity and of a state of effects, relative to the
    # largest one or to 1
    position_change, relative_change = 2e-6, 1e-6
    z, n, other, below = step.z_stage, work.by_position.shape[1], work.other, work.time_slope
    m, rows = work.matrix.shape[0], work.by_position.shape[0]
    fast = max(1.0, greatest(step.z[n : 2 * n]))
    strong = max(1.0, greatest(step.z[2 * n : n + m]))
    copy(step.z, z)
    for j in range(n):
        z[j] = step.z[j] - position_change
        status = slope_at(step, t, z, below)
        if status != OK:
            return status
        z[j] = step.z[j] + position_change
        status = slope_at(step, t, z, other)
        if status != OK:
            return status
        z[j] = step.z[j]
        for i in range(rows):
            work.by_position[i, j] = (other[n + i] - below[n + i]) / (2.0 * position_change)
    for j in range(m):
        change = relative_change * (fast if j < n else strong)
        z[n + j] = step.z[n + j] + change
        status = slope_at(step, t, z, other)
        if status != OK:
            return status
        z[n + j] = step.z[n + j]
        for i in range(rows):
            work.by_velocity[i, j] = (other[n + i] - work.slope[n + i]) / change
    return differentiate_by_time(step, work, t, h)


@kernel
def differentiate_by_time(step, work, t, h):
    """``f_t`` from two later times, inside the step: its beginning may be a kink."""
    model, _, _ = open_system(step.system)
    rate, other = work.time_slope, work.other
    clear(rate)
    if model.control.shape[0] == 0 and model.effects.shape[0] == 0:
        return OK
    change = TIME_CHANGE * min(h, 1.0)  # [s]
    status = slope_at(step, t + 2.0 * change, step.z, other)
    if status != OK:
        return status
    copy(other, rate)
    status = slope_at(step, t + change, step.z, other)
    if status != OK:
        return status
    for i in range(rate.size):
        rate[i] = (4.0 * other[i] - rate[i] - 3.0 * work.slope[i]) / (2.0 * change)
    return OK


@kernel
def factor(method, step, work, h):
    """Factors of the linear system; returns whether they can be used."""
    n, m, a = work.by_position.shape[1], work.matrix.shape[0], 1.0 / method.gamma
    for i in range(m):
        row = work.turned[i]
        for j in range(n):
            row[j] = work.by_position[i, j] / a
        turn(a, -0.5 * h, step.z[n + 3 : n + 6], work.by_position[i, 3:6], row[3:6])
        for j in range(m):
            work.matrix[i, j] = -h * work.by_velocity[i, j]
        for j in range(n):
            work.matrix[i, j] -= h * h * row[j]
        work.matrix[i, i] += a
    return factor_lu(work.matrix, m, work.pivots) > 0.0


@kernel
def solve_stage(method, step, work, h, right, out):
    """Solve the stage's system for the right-hand side ``right``, which is overwritten."""
    n, m, a = work.by_position.shape[1], work.matrix.shape[0], 1.0 / method.gamma
    velocity = out[n : n + m]
    for i in range(m):
        s = right[n + i]
        for j in range(n):
            s += h * work.turned[i, j] * right[j]
        velocity[i] = s
    solve_lu(work.matrix, m, work.pivots, velocity)
    for i in range(n):
        right[i] += h * velocity[i]
        out[i] = right[i] / a
    turn(a, 0.5 * h, step.z[n + 3 : n + 6], right[3:6], out[3:6])
    for i in range(m, work.by_position.shape[0]):
        s = right[n + i]
        for j in range(n):
            s += h * work.by_position[i, j] * out[j]
        for j in range(m):
            s += h * work.by_velocity[i, j] * velocity[j]
        out[n + i] = s / a
