r"""Derivatives of the accelerations block by block, at a cost linear in the blocks.

The accelerations and contact forces :math:`y = (\dot v_o, \ddot q_i, \lambda_i)` of a state ``x``
solve :math:`F(x, y) = 0` (:mod:`multiarm.dynamics.derivatives`),

.. math::
    F_i &= M_i \ddot q_i - f_i - W_i \lambda_i, \qquad
    F_{\varphi i} = W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i, \\
    F_o &= M_o \dot v_o - f_o + \sum_i g_i, \qquad g_i = -W_{oi} \lambda_i ,

so that :math:`dy = -K^{-1}\, \partial F`.  The derivatives of these equations at fixed ``y`` are
exact (:mod:`multiarm.dynamics.equation_derivatives`), up to those of the forces of control and
effects, which are as these state them (:mod:`multiarm.dynamics.force_derivatives`).  Where control
and effects are *local*, a block's :math:`F_i, F_{\varphi i}, g_i` depend on the states of this
block and of the object only, and :math:`f_o` on the object's.

*The multipliers* s of a control law (:mod:`multiarm.dynamics.control_laws`) are six more unknowns
an object: with them a block's torques are local too, and the wrench balance
:math:`F_s = \sum_i r_i - w = 0` is as many more equations.

*Each block* is solved on its own for its columns x_i, the 12 F of the objects, the time, and the
6 F of :math:`\chi = d\dot v_o`, and then the objects by their mobility,

.. math::
    d\ddot q_i &= A_i\, dx_i + A_{oi}\, dx_o + U_i\, \chi, \qquad
    d\lambda_i = A^\lambda_i\, dx_i + A^\lambda_{oi}\, dx_o + U^\lambda_i\, \chi, \\
    \chi &= \sum_i B_i\, dx_i + B_o\, dx_o, \qquad
    S = M_o - \sum_i W_{oi} U^\lambda_i, \\
    B_i &= S^{-1} (W_{oi} A^\lambda_i - \partial g_i), \qquad
    B_o = S^{-1} \Big(\sum_i (W_{oi} A^\lambda_{oi} - \partial_o g_i)
          - \partial_o (M_o \dot v_o - f_o)\Big) .

With s the *couplings* are 12 F: :math:`\chi` has ds below it, U the columns of s beside
its own, S the rows :math:`(0, \partial F_s / \partial s)`, and the right sides of B the rows
:math:`-\partial r_i, -\sum_i \partial_o r_i`.

*Powers* of local forces are those of the forces on each joint and on the object, so that each block
has its own part of them; their derivatives follow by the product rule.
"""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.coordinates import (
    block_columns,
    chart_places,
    equation_columns,
    force_columns,
)
from multiarm.dynamics.equation_derivatives import (
    add_drift_feedback,
    open_equations,
    write_derivatives,
)
from multiarm.dynamics.force_derivatives import (
    begin_differences,
    clear_slopes,
    clear_table,
    differentiate_forces,
)
from multiarm.dynamics.solver.factors import factor_lu, solve_rows
from multiarm.dynamics.status import NOT_FINITE, OK
from multiarm.integration.block_matrices import derivative_columns
from multiarm.jit.kernels import clear, inlined, kernel


@kernel
def differentiate_blocks(step, blocks, h):
    """Write the derivatives at the beginning of a step, right after its evaluation.

    Returns a status; ``NOT_FINITE`` also where a matrix of a block is singular, ``SINGULAR`` where
    a law has no derivative at this state.
    """
    model, data, work = open_system(step.system)
    for i in range(blocks.counts.size):
        clear_table(blocks.derivatives[i])
        clear_table(blocks.on_object[i])
    clear_table(blocks.by_object)
    clear_slopes(model, data, work, 1, data.slopes.torque, 0)
    status = write_derivatives(step.system, blocks.equations)
    if status != OK:
        return status
    add_drift_feedback(step.system, blocks.equations, step.stage.alpha, step.stage.beta)
    add_equations(step, blocks)
    usable, differences = factor_blocks(blocks, data, work), blocks.differences
    begin_differences(model, data, differences, h)
    status = differentiate_forces(step.system, differences, blocks.powers, gather, blocks)
    step.stage.evaluations += differences.evaluations
    if status != OK:
        return status
    gather_balance(blocks, data)
    return OK if usable and solve_blocks(blocks, work) else NOT_FINITE


@kernel
def add_equations(step, blocks):
    """Add the derivatives of the blocks and their contacts."""
    _, data, work = open_system(step.system)
    equations, at = open_equations(blocks.equations), derivative_columns(blocks)
    of_state = equation_columns(data)
    for l in range(blocks.frames):
        for c in range(of_state.positions):
            blocks.by_object[l, c] += equations.dF_o[l, c]
    for i in range(blocks.counts.size):
        d0, r0, A, dF = (
            work.first_joint[i],
            work.first_contact[i],
            blocks.derivatives[i],
            equations.dF[i],
        )
        n, m = work.first_joint[i + 1] - d0, work.first_contact[i + 1] - r0
        columns = block_columns(blocks.frames, n, 0)
        for c in range(columns.end):
            column = column_of_block(at, columns, c)
            for k in range(n + m):
                A[k, column] += dF[k, c]
        for l in range(blocks.frames):
            for j in range(n):
                blocks.on_object[i, l, j] += equations.dF_o[l, of_state.positions + d0 + j]
            for k in range(m):
                blocks.W_o[r0 + k, l] = A[n + k, at.accelerations + l] = data.rows.W_o[r0 + k, l]


@inlined
def column_of_block(at, columns, c):
    """Place in a block's block of a column of its equations."""
    if c < columns.positions:
        return at.pose + c
    return c - columns.positions if c < columns.rates else at.rates + c - columns.rates


# --- forces --------------------------------------------------------------------------------------


@kernel
def gather(blocks, data, work, power, of_drives):
    """Add the derivatives in the data, of torques of the drives or of one effect, to the blocks.

    ``power`` is the place of the power of these, whose derivatives follow; -1: it does not count.
    See :func:`multiarm.dynamics.force_derivatives.differentiate_forces`.
    """
    total, frames = blocks.works - 1, blocks.frames
    places, at = chart_places(data), derivative_columns(blocks)
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    slopes = data.slopes.torque if of_drives else data.slopes.force
    force, first = (data.control.torque, 0) if of_drives else (data.forces.f_j, places.joints)
    for i in range(blocks.counts.size):
        A, d0, sources = blocks.derivatives[i], work.first_joint[i], blocks.sources[i]
        joints = work.first_joint[i + 1] - d0
        for c in range(at.end):
            source = sources[c]
            if source < 0:
                continue
            power_slope = 0.0
            for j in range(joints):
                slope = slopes[first + d0 + j, source]
                A[j, c] -= slope
                power_slope += slope * data.state.joint_rates[d0 + j]
            if at.rates <= c < at.rates + joints:
                power_slope += force[d0 + c - at.rates]
            for k in range(0 if of_drives else blocks.counts[i]):
                A[rates + k, c] += slopes[places.velocity + blocks.states[i, k], source]
            if power >= 0:
                A[powers + total, c] += power_slope
            if 0 <= power < total:
                A[powers + power, c] += power_slope
    for c in range(0 if of_drives else 2 * frames + 1):
        source = blocks.sources[0, at.pose + c]
        power_slope = data.forces.f_o[c - frames] if frames <= c < 2 * frames else 0.0
        for l in range(frames):
            slope = slopes[l, source]
            blocks.by_object[l, c] -= slope
            power_slope += slope * data.state.velocity[l]
        if power >= 0:
            blocks.by_object[blocks.couplings + total, c] += power_slope
        if 0 <= power < total:
            blocks.by_object[blocks.couplings + power, c] += power_slope


@kernel
def gather_balance(blocks, data):
    """Add the derivatives of the wrench balance that determines a law's multipliers."""
    of_forces, at, o = force_columns(data), derivative_columns(blocks), blocks.frames
    for l in range(blocks.couplings - o):
        slopes = data.slopes.balance[l]
        for c in range(2 * o):
            blocks.by_object[o + l, c] += slopes[c]
        for c in range(blocks.couplings - o):
            blocks.S[o + l, o + c] += slopes[of_forces.multipliers + c]
        for i in range(blocks.counts.size):
            for c in range(at.states):
                source = blocks.sources[i, c]
                if source >= 0:
                    blocks.on_object[i, o + l, c] += slopes[source]


# --- solution for the derivatives ----------------------------------------------------------------


@kernel
def factor_blocks(blocks, data, work):
    """Factors of the blocks' equations, and ``M_o`` in S; returns whether they can be used."""
    usable, S, K = True, blocks.S, open_equations(blocks.equations).K
    frames = blocks.frames
    for l in range(blocks.couplings):
        clear(S[l])
        for c in range(frames):
            S[l, c] = data.bodies.object_inertia[l, c] if l < frames else 0.0
    for i in range(blocks.counts.size):
        size = (
            work.first_joint[i + 1]
            - work.first_joint[i]
            + work.first_contact[i + 1]
            - work.first_contact[i]
        )
        usable = usable and factor_lu(K[i], size, blocks.K_pivots[i]) > 0.0
    return usable


@kernel
def solve_blocks(blocks, work):
    """From the derivatives of F to those of the accelerations; returns whether it succeeded."""
    S, u, K = blocks.S, blocks.couplings, open_equations(blocks.equations).K
    at, of_object = derivative_columns(blocks), blocks.by_object.shape[1]
    for l in range(u):
        for c in range(of_object):
            blocks.by_object[l, c] = -blocks.by_object[l, c]
    for i in range(blocks.counts.size):
        r0, n, A = (
            work.first_contact[i],
            work.first_joint[i + 1] - work.first_joint[i],
            blocks.derivatives[i],
        )
        m, B = work.first_contact[i + 1] - r0, blocks.on_object[i]
        for k in range(n + m):
            row = A[k]
            for c in range(row.size):
                row[c] = -row[c]
        solve_rows(K[i], n + m, blocks.K_pivots[i], A)
        for l in range(u):
            row = B[l]
            for c in range(at.pose):
                row[c] = -row[c]
            for k in range(m if l < blocks.frames else 0):
                weight, forces = blocks.W_o[r0 + k, l], A[n + k]
                for c in range(at.pose):
                    row[c] += weight * forces[c]
                for c in range(of_object):
                    blocks.by_object[l, c] += weight * forces[at.pose + c]
                for c in range(u):
                    S[l, c] -= weight * forces[at.accelerations + c]
    if not factor_lu(S, u, blocks.S_pivots) > 0.0:
        return False
    for i in range(blocks.counts.size):
        solve_rows(S, u, blocks.S_pivots, blocks.on_object[i])
    solve_rows(S, u, blocks.S_pivots, blocks.by_object)
    return True


@kernel
def write_time_slope(blocks, struct, slope):
    """Write the derivative of the whole slope with respect to time."""
    _, data, work = open_system(struct)
    places, at = chart_places(data), derivative_columns(blocks)
    time = at.time - at.pose
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    clear(slope)
    for l in range(blocks.frames):
        slope[places.velocity + l] = blocks.by_object[l, time]
    for k in range(blocks.works):
        slope[places.works + k] = blocks.by_object[blocks.couplings + k, time]
    for i in range(blocks.counts.size):
        A, first = blocks.derivatives[i], places.rates + work.first_joint[i]
        for j in range(work.first_joint[i + 1] - work.first_joint[i]):
            s = A[j, at.time]
            for l in range(blocks.couplings):
                s += A[j, at.accelerations + l] * blocks.by_object[l, time]
            slope[first + j] = s
        for k in range(blocks.counts[i]):
            slope[places.states + blocks.states[i, k]] = A[rates + k, at.time]
        for k in range(blocks.works):
            slope[places.works + k] += A[powers + k, at.time]
