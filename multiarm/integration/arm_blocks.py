r"""Derivatives of the accelerations arm by arm, at a cost linear in the arms.

The accelerations and contact forces :math:`y = (\dot v_o, \ddot q_i, \lambda_i)` of a state ``x``
solve :math:`F(x, y) = 0` (:mod:`multiarm.dynamics.derivatives`),

.. math::
    F_i &= M_i \ddot q_i - f_i - W_i \lambda_i, \qquad
    F_{\varphi i} = W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i, \\
    F_o &= M_o \dot v_o - f_o + \sum_i g_i, \qquad g_i = -W_{oi} \lambda_i ,

so that :math:`dy = -K^{-1}\, \partial F`.  The derivatives of these equations at fixed ``y`` are
exact (:mod:`multiarm.dynamics.equation_derivatives`), up to those of the forces of control and
effects, which are as these state them (:mod:`multiarm.dynamics.force_derivatives`).  Where control
and effects are *local*, an arm's :math:`F_i, F_{\varphi i}, g_i` depend on the states of this arm
and of the object only, and :math:`f_o` on the object's.

*Gravity compensation* couples the arms by six numbers s: the contact forces of least norm that
carry the weight w are :math:`W_{oi}^T s`.  With s among the unknowns, an arm's torques
:math:`\tau_i = \tau^g_i(q_i) - W_i W_{oi}^T s` are local too, and there is one more equation,

.. math:: F_s = \sum_i r_i - w = 0, \qquad r_i = W_{oi} W_{oi}^T s .

The derivatives of :math:`\tau^g_i - W_i \lambda_i` and :math:`W_{oi} \lambda_i` at fixed
:math:`\lambda_i`, and of :math:`W_{oi}^T s`, are those of an arm at rest under these forces and of
the rates of its gaps while the object moves with the twist s.

*Each arm* is solved on its own for its columns x_i, the object's 12, the time, and the six of
:math:`\alpha = d\dot v_o`, and then the object by its mobility,

.. math::
    d\ddot q_i &= A_i\, dx_i + A_{oi}\, dx_o + U_i\, \alpha, \qquad
    d\lambda_i = A^\lambda_i\, dx_i + A^\lambda_{oi}\, dx_o + U^\lambda_i\, \alpha, \\
    \alpha &= \sum_i B_i\, dx_i + B_o\, dx_o, \qquad
    S = M_o - \sum_i W_{oi} U^\lambda_i, \\
    B_i &= S^{-1} (W_{oi} A^\lambda_i - \partial g_i), \qquad
    B_o = S^{-1} \Big(\sum_i (W_{oi} A^\lambda_{oi} - \partial_o g_i)
          - \partial_o (M_o \dot v_o - f_o)\Big) .

Where the control carries the weight, the *shared* unknowns are twelve: :math:`\alpha` has ds below
it, U the columns of s beside its own, S the rows :math:`(0, \sum_i W_{oi} W_{oi}^T)`, and the right
sides of B the rows :math:`-\partial r_i, -\sum_i \partial_o r_i`.

The rates of effects' states have rows in :math:`A_i`, whose columns contain these states.  The
linear systems of a step with these blocks: :mod:`multiarm.integration.arm_stages`.

*Powers* of local forces are those of the forces on each joint and on the object, so that each arm
has its own share of them; their derivatives follow by the product rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import CARRYING, open_data, open_system
from multiarm.dynamics.contact_derivatives import arm_columns
from multiarm.dynamics.coordinates import chart_places, force_columns, state_columns
from multiarm.dynamics.equation_derivatives import (
    add_drift_feedback,
    open_equations,
    write_derivatives,
    write_derivatives_at_rest,
)
from multiarm.dynamics.force_derivatives import (
    Differences,
    begin_differences,
    clear_slopes,
    clear_table,
    differentiate_forces,
    torques_are_held,
)
from multiarm.dynamics.forces.compiled import factor_wrench_products, solve_wrench_products
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.factors import factor_lu, solve_rows
from multiarm.dynamics.solver.solution import WHOLE
from multiarm.dynamics.status import NOT_FINITE, OK
from multiarm.integration.step import Step
from multiarm.jit.kernels import clear, copy, inlined, kernel, plain
from multiarm.jit.structs import Floats1, Floats2, Floats3, Int, Ints1, Ints2


class ArmBlocks(NamedTuple):
    """Arrays for ``n`` arms; ``d`` joints, ``m`` contacts and ``e`` effects' states of the largest.

    An arm has ``P = 2 d + e`` columns of its own.  Its ``R = d + m + e + w`` rows are those of its
    joints, right after them those of its contacts, from row ``d + m`` on the rates of its states,
    and from ``d + m + e`` on its ``w`` powers.
    """

    d: Int
    m: Int
    e: Int
    works: Int  # powers: of the effects that do work, last of control and effects
    frames: Int  # velocities of the object, o
    shared: Int  # unknowns that all arms share: accelerations of the object, as many more of s
    share: Floats1  # (o,) s, fixed in the derivatives of F
    # (o, o), (o,): factors of ``W_o W_o^T`` scaled, for s; scales and pivots
    products: Floats2
    scale: Floats1
    product_pivots: Ints1
    used: Ints1  # (1,) whether the derivatives of the last step are here
    counts: Ints1  # (n,) effects' states of each arm
    states: Ints2  # (n, e) their places among all
    powers: Ints1  # (effects that are called,) the place of each one's power, -1 without
    # struct of multiarm.dynamics.equation_derivatives, for all arms; its K has the factors of each
    equations: Ints1
    differences: Differences
    # for u shared unknowns: A, A_o, U, before the solution those of F, (n, R, P + 2 o + 1 + u); B_i
    # (n, u, P); B_o, then the powers of the forces on the object (u + w, 2 o + 1)
    derivatives: Floats3
    on_object: Floats3
    by_object: Floats2
    Wo: Floats2  # (N, o) at the beginning of the step
    # factors: of S (u, u), of E (n, d + e, d + e), of the system for alpha (u, u); pivots of each
    # arm's equations
    K_pivots: Ints2
    S: Floats2
    S_pivots: Ints1
    E: Floats3
    E_pivots: Ints2
    V: Floats3  # (n, d + e, u)
    D: Floats3  # (n, u, d + e)
    node: Floats2
    node_pivots: Ints1
    # of a stage: derivatives of the shared unknowns (u,), rates of the object (2 o,), unknowns of
    # each arm (n, d + e)
    alpha: Floats1
    rates: Floats1
    unknowns: Floats2

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        derivatives = self.derivatives, self.on_object, self.by_object, self.Wo, self.share
        factors = self.products, self.S, self.E, self.V, self.D, self.node
        return (*derivatives, *factors, self.scale, self.alpha, self.rates, self.unknowns)


class BlockColumns(NamedTuple):
    """First columns of ``ArmBlocks.derivatives``; the arm's positions begin at zero.

    Those of the object's pose, its twist and the time are all that ``ArmBlocks.by_object`` has.
    """

    rates: int
    states: int
    pose: int
    twist: int
    time: int
    accelerations: int  # of the object; here the shared unknowns begin
    share: int
    end: int


@plain
def block_columns(blocks):
    """The columns for the sizes of these blocks."""
    pose = 2 * blocks.d + blocks.e
    time = pose + 2 * blocks.frames
    shared = time + 1
    return BlockColumns(
        blocks.d,
        2 * blocks.d,
        pose,
        pose + blocks.frames,
        time,
        shared,
        shared + blocks.frames,
        shared + blocks.shared,
    )


def make_arm_blocks(data: Data, step: Step, equations: np.ndarray) -> ArmBlocks:
    """Allocate the blocks of a system; see :func:`acts_locally` for when they are used.

    ``equations`` is the struct of the derivatives of its equations.
    """
    layout, effects = data.model.layout, data.model.effects
    n, d = len(layout.dofs) - 1, int(np.max(np.diff(layout.dofs)))
    m, works = int(np.max(np.diff(layout.rows))), step.z.size - step.tolerance.size
    owned: list[list[int]] = [[] for _ in range(n)]
    if effects.local:
        joints = [joint for own in effects.kernels for joint in own.state_joints]
        for state, joint in enumerate(joints):
            owned[int(np.searchsorted(layout.dofs, joint, side="right")) - 1].append(state)
    e = max(map(len, owned))
    states = np.full((n, e), -1, dtype=np.int64)
    for row, own in zip(states, owned, strict=True):
        row[: len(own)] = own
    own_columns, rows, frames = 2 * d + e, d + m + e + works, layout.nv - layout.joints
    constants = data.model.constants
    carries = len(constants.control) > 0 and constants.control_reach == CARRYING
    u, of_object = (2 if carries else 1) * frames, 2 * frames + 1
    return ArmBlocks(
        d=d,
        m=m,
        e=e,
        works=works,
        frames=frames,
        shared=u,
        share=np.zeros(frames),
        products=np.zeros((frames, frames)),
        scale=np.zeros(frames),
        product_pivots=np.zeros(frames, dtype=np.int64),
        used=np.zeros(1, dtype=np.int64),
        counts=np.array([len(own) for own in owned], dtype=np.int64),
        states=states,
        powers=effects.powers,
        equations=equations,
        differences=Differences(local=1, laws=len(constants.control) - carries, order=1),
        derivatives=np.zeros((n, rows, own_columns + of_object + u)),
        on_object=np.zeros((n, u, own_columns)),
        by_object=np.zeros((u + works, of_object)),
        Wo=np.zeros((layout.contacts, frames)),
        K_pivots=np.zeros((n, d + m), dtype=np.int64),
        S=np.zeros((u, u)),
        S_pivots=np.zeros(u, dtype=np.int64),
        E=np.zeros((n, d + e, d + e)),
        E_pivots=np.zeros((n, d + e), dtype=np.int64),
        V=np.zeros((n, d + e, u)),
        D=np.zeros((n, u, d + e)),
        node=np.zeros((u, u)),
        node_pivots=np.zeros(u, dtype=np.int64),
        alpha=np.zeros(u),
        rates=np.zeros(2 * frames),
        unknowns=np.zeros((n, d + e)),
    )


@kernel
def acts_locally(step):
    """Whether control and effects are local now, in a scene that the node algorithm solves."""
    model, data, _ = open_system(step.system)
    controlled = model.control.shape[0] > 0 and not torques_are_held(model, data)
    if not model.local_effects or (controlled and model.control_reach > CARRYING):
        return False
    # contacts of modes need not be those of arms
    return not (model.dense or data.modes.active)


@kernel
def is_regular(struct):
    """Whether the last evaluation has eliminated every arm as a whole."""
    return open_data(struct).solution.elimination == WHOLE


# --- derivatives ---------------------------------------------------------------------------------


@kernel
def differentiate_arms(step, blocks, t, h):
    """Write the derivatives at the beginning of a step, right after its evaluation.

    Returns a status; ``NOT_FINITE`` also where a matrix of an arm is singular, ``SINGULAR`` where
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
    if blocks.shared > blocks.frames:
        status = differentiate_carrying(step.system, blocks)
        if status != OK:
            return status
    usable, differences = factor_arms(blocks, data, work), blocks.differences
    begin_differences(model, data, differences, h)
    status = differentiate_forces(step.system, differences, blocks.powers, gather, blocks)
    step.stage.evaluations += differences.evaluations
    if status != OK:
        return status
    return OK if usable and solve_arms(blocks, work) else NOT_FINITE


@kernel
def add_equations(step, blocks):
    """Add the derivatives of the arms and their contacts."""
    _, data, work = open_system(step.system)
    equations, at = open_equations(blocks.equations), block_columns(blocks)
    of_state = state_columns(data)
    for l in range(blocks.frames):
        for c in range(of_state.positions):
            blocks.by_object[l, c] += equations.dF_o[l, c]
    for i in range(blocks.counts.size):
        d0, r0, A, dF = work.dofs[i], work.rows[i], blocks.derivatives[i], equations.dF[i]
        n, m = work.dofs[i + 1] - d0, work.rows[i + 1] - r0
        columns = arm_columns(n, False)
        for c in range(columns.end):
            column = column_of_block(at, columns, c)
            for k in range(n + m):
                A[k, column] += dF[k, c]
        for l in range(blocks.frames):
            for j in range(n):
                blocks.on_object[i, l, j] += equations.dF_o[l, of_state.positions + d0 + j]
            for k in range(m):
                blocks.Wo[r0 + k, l] = A[n + k, at.accelerations + l] = data.rows.Wo[r0 + k, l]


@inlined
def column_of_block(at, columns, c):
    """Place in an arm's block of a column of its equations."""
    if c < columns.positions:
        return at.pose + c
    return c - columns.positions if c < columns.velocities else at.rates + c - columns.velocities


@kernel
def differentiate_carrying(struct, blocks):
    """Write the derivatives of gravity compensation, s fixed, and by s; and those of ``F_s``.

    Returns a status.
    """
    _, data, work = open_system(struct)
    equations, columns = open_equations(blocks.equations), force_columns(data)
    for k in range(data.rows.static_force.size):
        data.rows.static_force[k] = 0.0
        for l in range(blocks.frames):
            data.rows.static_force[k] += data.rows.Wo[k, l] * blocks.share[l]
    copy(data.rows.static_force, equations.force)
    clear(equations.a_j)
    status = write_derivatives_at_rest(struct, blocks.equations, blocks.share)
    if status != OK:
        return status
    for i in range(blocks.counts.size):
        d0, r0, dF, W = work.dofs[i], work.rows[i], equations.dF[i], work.W[i]
        n, m = work.dofs[i + 1] - d0, work.rows[i + 1] - r0
        at = arm_columns(n, False)
        for c in range(at.velocities):
            if at.twist <= c < at.positions:
                continue
            of_object = c < at.twist
            column = c if of_object else columns.positions + d0 + c - at.positions
            for j in range(n):
                slope = dF[j, c]
                for k in range(m):
                    slope -= W[j, k] * equations.rates[r0 + k, c]
                data.slopes.torque[d0 + j, column] += slope
            for l in range(blocks.frames):
                change = 0.0
                for k in range(m):
                    change += data.rows.Wo[r0 + k, l] * equations.rates[r0 + k, c]
                if of_object:
                    blocks.by_object[blocks.frames + l, c] += change
                else:
                    change -= equations.dF_o[l, columns.positions + d0 + c - at.positions]
                    blocks.on_object[i, blocks.frames + l, c - at.positions] += change
        for j in range(n):
            for l in range(blocks.frames):
                for k in range(m):
                    change = W[j, k] * data.rows.Wo[r0 + k, l]
                    data.slopes.torque[d0 + j, columns.share + l] -= change
    for l in range(blocks.frames):
        for c in range(blocks.frames):
            blocks.by_object[blocks.frames + l, c] -= equations.dF_o[l, c]
    return OK


# --- forces --------------------------------------------------------------------------------------


@kernel
def gather(blocks, data, work, power, of_drives):
    """Add the derivatives in the data, of torques of the drives or of one effect, to the blocks.

    ``power`` is the place of the power of these, whose derivatives follow; -1: it does not count.
    See :func:`multiarm.dynamics.force_derivatives.differentiate_forces`.
    """
    total, frames = blocks.works - 1, blocks.frames
    of_forces, places, at = force_columns(data), chart_places(data), block_columns(blocks)
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    slopes = data.slopes.torque if of_drives else data.slopes.force
    force, first = (data.control.torque, 0) if of_drives else (data.forces.f_j, places.joints)
    for i in range(blocks.counts.size):
        A, d0, d1 = blocks.derivatives[i], work.dofs[i], work.dofs[i + 1]
        joints, states = d1 - d0, blocks.counts[i]
        for c in range(2 * joints + states + 2 * frames + 1 + blocks.shared - frames):
            if c < joints:
                source, column = of_forces.positions + d0 + c, c
            elif c < 2 * joints:
                k = c - joints
                source, column = of_forces.rates + d0 + k, at.rates + k
            elif c < 2 * joints + states:
                k = c - 2 * joints
                source, column = of_forces.states + blocks.states[i, k], at.states + k
            elif c < 2 * joints + states + 2 * frames:
                source = c - 2 * joints - states
                column = at.pose + source
            else:
                k = c - 2 * joints - states - 2 * frames
                source = of_forces.time + k
                column = at.time if k == 0 else at.share + k - 1
            power_slope = 0.0
            for j in range(joints):
                slope = slopes[first + d0 + j, source]
                A[j, column] -= slope
                power_slope += slope * data.state.joint_rates[d0 + j]
            if joints <= c < 2 * joints:
                power_slope += force[d0 + c - joints]
            for k in range(0 if of_drives else states):
                A[rates + k, column] += slopes[places.velocity + blocks.states[i, k], source]
            if power >= 0:
                A[powers + total, column] += power_slope
            if 0 <= power < total:
                A[powers + power, column] += power_slope
    for c in range(0 if of_drives else 2 * frames + 1):
        source = c if c < 2 * frames else of_forces.time
        power_slope = data.forces.f_o[c - frames] if frames <= c < 2 * frames else 0.0
        for l in range(frames):
            slope = slopes[l, source]
            blocks.by_object[l, c] -= slope
            power_slope += slope * data.state.object_twist[l]
        if power >= 0:
            blocks.by_object[blocks.shared + total, c] += power_slope
        if 0 <= power < total:
            blocks.by_object[blocks.shared + power, c] += power_slope


@kernel
def share_weight(struct, blocks):
    """Write s of the state in the data; returns whether the contacts carry any wrench."""
    if blocks.shared == blocks.frames:
        return True
    data, s = open_data(struct), blocks.share
    copy(data.control.object_wrench, s)
    products, scale, pivots = blocks.products, blocks.scale, blocks.product_pivots
    if not factor_wrench_products(data.rows.Wo, products, scale, pivots):
        return False
    solve_wrench_products(products, scale, pivots, s)
    return True


# --- solution for the derivatives ----------------------------------------------------------------


@kernel
def factor_arms(blocks, data, work):
    """Factors of the arms' equations, and ``M_o`` and products of ``W_o`` of the solution.

    Returns whether they can be used.
    """
    usable, S, K = True, blocks.S, open_equations(blocks.equations).K
    frames = blocks.frames
    for l in range(blocks.shared):
        clear(S[l])
        for c in range(frames):
            S[l, c] = data.bodies.object_inertia[l, c] if l < frames else 0.0
            for k in range(data.rows.Wo.shape[0] if l >= frames else 0):
                S[l, frames + c] += data.rows.Wo[k, l - frames] * data.rows.Wo[k, c]
    for i in range(blocks.counts.size):
        size = work.dofs[i + 1] - work.dofs[i] + work.rows[i + 1] - work.rows[i]
        usable = usable and factor_lu(K[i], size, blocks.K_pivots[i]) > 0.0
    return usable


@kernel
def solve_arms(blocks, work):
    """From the derivatives of F to those of the accelerations; returns whether it succeeded."""
    S, u, K = blocks.S, blocks.shared, open_equations(blocks.equations).K
    at, of_object = block_columns(blocks), blocks.by_object.shape[1]
    for l in range(u):
        for c in range(of_object):
            blocks.by_object[l, c] = -blocks.by_object[l, c]
    for i in range(blocks.counts.size):
        r0, n, A = work.rows[i], work.dofs[i + 1] - work.dofs[i], blocks.derivatives[i]
        m, B = work.rows[i + 1] - r0, blocks.on_object[i]
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
                weight, forces = blocks.Wo[r0 + k, l], A[n + k]
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
    places, at = chart_places(data), block_columns(blocks)
    time = at.time - at.pose
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    clear(slope)
    for l in range(blocks.frames):
        slope[places.velocity + l] = blocks.by_object[l, time]
    for k in range(blocks.works):
        slope[places.works + k] = blocks.by_object[blocks.shared + k, time]
    for i in range(blocks.counts.size):
        A, first = blocks.derivatives[i], places.rates + work.dofs[i]
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            s = A[j, at.time]
            for l in range(blocks.shared):
                s += A[j, at.accelerations + l] * blocks.by_object[l, time]
            slope[first + j] = s
        for k in range(blocks.counts[i]):
            slope[places.states + blocks.states[i, k]] = A[rates + k, at.time]
        for k in range(blocks.works):
            slope[places.works + k] += A[powers + k, at.time]
