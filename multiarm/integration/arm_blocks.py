r"""Derivatives of the accelerations arm by arm, at a cost linear in the arms.

The accelerations and contact forces :math:`y = (\dot v_o, \ddot q_i, \lambda_i)` of a state ``x``
solve :math:`F(x, y) = 0` (:mod:`multiarm.dynamics.derivatives`),

.. math::
    F_i &= M_i \ddot q_i - h_i - W_i \lambda_i, \qquad
    F_{\varphi i} = W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i, \\
    F_o &= M_o \dot v_o - h_o + \sum_i g_i, \qquad g_i = -W_{oi} \lambda_i ,

so that :math:`dy = -K^{-1}\, \partial F`.  Where control and effects are *local*, an arm's
:math:`F_i, F_{\varphi i}, g_i` at fixed ``y`` depend on the states of this arm and of the object
only, and :math:`h_o` on the object's.

*Gravity compensation* couples the arms by six numbers s: the contact forces of least norm that
carry the weight w are :math:`W_{oi}^T s`.  With s among the unknowns, an arm's torques
:math:`\tau_i = \tau^g_i(q_i) - W_i W_{oi}^T s` are local too, and there is one more equation,

.. math:: F_s = \sum_i r_i - w = 0, \qquad r_i = W_{oi} W_{oi}^T s .

*Differences* of these residuals therefore displace joint number j of all arms at once: as many
columns as the largest arm has, whatever the number of arms.  Nothing is solved for them, so that
their roundings are small enough for forward differences with short displacements.  Those by
positions are central where drift feedback acts: its gains grow as steps get shorter, so that the
error of :math:`\beta^2 \varphi` would not decrease with them.  The columns of the object and of the
time leave the terms of the arms as they are.

*Each arm* is solved on its own for its columns x_i, the object's 12, the time, and the six of
:math:`\alpha = d\dot v_o`, and then the object by its mobility,

.. math::
    d\ddot q_i &= A_i\, dx_i + A_{oi}\, dx_o + U_i\, \alpha, \qquad
    d\lambda_i = A^\lambda_i\, dx_i + A^\lambda_{oi}\, dx_o + U^\lambda_i\, \alpha, \\
    \alpha &= \sum_i B_i\, dx_i + B_o\, dx_o, \qquad
    S = M_o - \sum_i W_{oi} U^\lambda_i, \\
    B_i &= S^{-1} (W_{oi} A^\lambda_i - \partial g_i), \qquad
    B_o = S^{-1} \Big(\sum_i (W_{oi} A^\lambda_{oi} - \partial_o g_i)
          - \partial_o (M_o \dot v_o - h_o)\Big) .

Where the control carries the weight, the *shared* unknowns are twelve: :math:`\alpha` has ds below
it, U the columns of s beside its own, S the rows :math:`(0, \sum_i W_{oi} W_{oi}^T)`, and the right
sides of B the rows :math:`-\partial r_i, -\sum_i \partial_o r_i`.

The rates of effects' states have rows in :math:`A_i`, whose columns contain these states.  The
linear systems of a step with these blocks: :mod:`multiarm.integration.arm_stages`.

*Powers* of local forces are those of the forces on each joint and on the object, so that each arm
has its own share of them, and its own derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.arms.terms import BIAS_AT
from multiarm.dynamics.arrays import CARRYING, HELD, open_coupled, open_data, open_system
from multiarm.dynamics.coordinates import chart_places, load_chart
from multiarm.dynamics.equations import (
    drift_terms,
    load_gravity_torque,
    update_kinematics,
    update_rows,
)
from multiarm.dynamics.forces.compiled import write_wrench_products
from multiarm.dynamics.kinematics import object_terms
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.factors import factor_lu, solve_lu, solve_rows
from multiarm.dynamics.status import CALLBACK_FAILED, NOT_FINITE, OK
from multiarm.integration.projection import greatest
from multiarm.integration.step import Step
from multiarm.jit.kernels import clear, copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import (
    Floats1,
    Floats2,
    Floats3,
    Int,
    Ints1,
    Ints2,
    floats_at,
)

# Change of a forward difference [m, rad]; of velocities and of effects' states relative to the
# largest one, or to 1.  Residuals are sums of few terms: roundings are 1e-9 of these.
CHANGE = 1e-7
# Change of a central difference by positions [m, rad].
CENTRAL_CHANGE = 2e-6
# The same of the time, relative to the step or to 1 s.
TIME_CHANGE = 1e-5
# Columns of the object in ``ArmBlocks.by_object``, and after the arm's own ones in
# ``ArmBlocks.derivatives``: pose, twist, time; there the shared unknowns follow.
POSE, TWIST, TIME, SHARED = 0, 6, 12, 13
# Contacts that carry wrenches in some direction by so much less than in others leave s to rounding.
CARRIED = 1e-10


class ArmBlocks(NamedTuple):
    """Arrays for ``n`` arms; ``d`` joints, ``m`` contacts and ``e`` effects' states of the largest.

    An arm has ``P = 2 d + e`` columns of its own: positions, velocities, states.  Its
    ``R = d + m + e + w`` rows are those of its joints, right after them those of its contacts, from
    row ``d + m`` on the rates of its states, and from ``d + m + e`` on its ``w`` powers.
    """

    d: Int
    m: Int
    e: Int
    shared: Int  # unknowns that all arms share: 6 of the object's acceleration, 6 more of s
    share: Floats1  # (6,) s, fixed in residuals
    used: Ints1  # (1,) whether the derivatives of the last step are here
    counts: Ints1  # (n,) effects' states of each arm
    states: Ints2  # (n, e) their places among all
    powers: Ints1  # (effects that are called,) the place of each one's power, -1 without
    # (n + 1, w) powers of the forces on each arm, and last on the object [W]; forces before those
    # of an effect, on the object and on all joints
    power: Floats2
    before: Floats1
    # products of matrices in the residuals at the beginning of the step; residuals there, and
    # elsewhere: (n, R + 12) with g_i, r_i at the end of each arm's rows, (6 + w,) of the object
    products: Floats2
    products_o: Floats1
    base: Floats2
    base_o: Floats1
    found: Floats2
    found_o: Floats1
    # for u shared unknowns: A, A_o, U, before the solution of the residuals, (n, R, P + 13 + u);
    # B_i (n, u, P); B_o, then the powers of the forces on the object (u + w, 13)
    derivatives: Floats3
    on_object: Floats3
    by_object: Floats2
    Wo: Floats2  # (N, 6) at the beginning of the step
    # factors: of each arm's equations (n, d + m, d + m), of S (u, u), of E (n, d + e, d + e), of
    # the system for alpha (u, u)
    K: Floats3
    K_pivots: Ints2
    S: Floats2
    S_pivots: Ints1
    E: Floats3
    E_pivots: Ints2
    V: Floats3  # (n, d + e, u)
    D: Floats3  # (n, u, d + e)
    node: Floats2
    node_pivots: Ints1
    # of a stage: derivatives of the shared unknowns (u,), rates of the object (12,), unknowns of
    # each arm (n, d + e)
    alpha: Floats1
    rates: Floats1
    unknowns: Floats2


def make_arm_blocks(data: Data, step: Step) -> ArmBlocks:
    """Allocate the blocks of a system; see :func:`acts_locally` for when they are used."""
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
    places = np.cumsum([0, *(own.works for own in effects.kernels)])
    powers = [
        int(place) if own.works else -1
        for own, place in zip(effects.kernels, places, strict=False)
        if own.kernel is not None
    ]
    own_columns, rows = 2 * d + e, d + m + e + works
    u = 12 if data.model.constants.control_reach == CARRYING else 6
    return ArmBlocks(
        d=d,
        m=m,
        e=e,
        shared=u,
        share=np.zeros(6),
        used=np.zeros(1, dtype=np.int64),
        counts=np.array([len(own) for own in owned], dtype=np.int64),
        states=states,
        powers=np.array(powers, dtype=np.int64),
        power=np.zeros((n + 1, works)),
        before=np.zeros(layout.nv),
        products=np.zeros((n, rows + 12)),
        products_o=np.zeros(6 + works),
        base=np.zeros((n, rows + 12)),
        base_o=np.zeros(6 + works),
        found=np.zeros((n, rows + 12)),
        found_o=np.zeros(6 + works),
        derivatives=np.zeros((n, rows, own_columns + SHARED + u)),
        on_object=np.zeros((n, u, own_columns)),
        by_object=np.zeros((u + works, SHARED)),
        Wo=np.zeros((layout.contacts, 6)),
        K=np.zeros((n, d + m, d + m)),
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
        rates=np.zeros(12),
        unknowns=np.zeros((n, d + e)),
    )


@kernel
def acts_locally(step):
    """Whether control and effects are local now, in a scene that the node algorithm solves."""
    model, data, _ = open_system(step.system)
    held = model.sampled.shape[0] > 0 and data.sampling.due == HELD
    controlled = model.control.shape[0] > 0 and not held
    if not model.local_effects or (controlled and model.control_reach > CARRYING):
        return False
    # modes have solutions of their own, and projected stages depend on all arms
    plain = data.functions.solve == data.functions.project and not model.dense
    return plain and step.stage.gap < 0.0


@kernel
def is_regular(struct):
    """Whether the last evaluation has eliminated all arms, and left their matrices."""
    _, _, work = open_system(struct)
    return open_coupled(struct).status.arms == 0 and work.factored[0] == 0


# --- derivatives ---------------------------------------------------------------------------------


@kernel
def differentiate_arms(step, blocks, t, h):
    """Write the derivatives at the beginning of a step, right after its evaluation.

    Returns a status; ``NOT_FINITE`` also where a matrix of an arm is singular.
    """
    _, data, work = open_system(step.system)
    clear_derivatives(blocks)
    write_products(blocks, data, work, blocks.products, blocks.products_o)
    status = differentiate_by_time(step, blocks, t, h)
    if status == OK and not factor_arms(blocks, data, work):
        status = NOT_FINITE
    if status == OK:
        status = differentiate_by_state(step, blocks, t)
    if status == OK and not solve_arms(blocks, work):
        status = NOT_FINITE
    return status


@inlined
def clear_derivatives(blocks):
    """Prepare for :func:`add_difference`."""
    for i in range(blocks.counts.size):
        for k in range(blocks.derivatives.shape[1]):
            clear(blocks.derivatives[i, k])
        for k in range(blocks.shared):
            clear(blocks.on_object[i, k])
    for k in range(blocks.by_object.shape[0]):
        clear(blocks.by_object[k])


@kernel
def differentiate_by_time(step, blocks, t, h):
    """Write the residuals of the beginning, and their derivatives by time where they have any.

    These come from two later times, inside the step: its beginning may be a kink.  Returns a
    status.
    """
    model, _, _ = open_system(step.system)
    column = 2 * blocks.d + blocks.e + TIME
    change = TIME_CHANGE * min(h, 1.0)  # [s]
    steady = model.control.shape[0] == 0 and model.effects.shape[0] == 0
    for k in range(1 if steady else 3):
        status = write_residuals(step, blocks, t + k * change, step.z, False, False)
        if status != OK:
            return status
        if k == 0:
            for i in range(blocks.counts.size):
                copy(blocks.found[i], blocks.base[i])
            copy(blocks.found_o, blocks.base_o)
        else:
            add_difference(blocks, (2.0 if k == 1 else -0.5) / change, column)
    return OK


@kernel
def differentiate_by_state(step, blocks, t):
    """Displace the object; then one joint, or one effect's state, of all arms at once.

    As the object's columns need the arms' terms at the beginning of the step, they come first.
    Returns a status.
    """
    _, data, work = open_system(step.system)
    places, d, own = chart_places(data), blocks.d, 2 * blocks.d + blocks.e
    status = differentiate_by_share(step, blocks, t)
    if status != OK:
        return status
    fast = CHANGE * max(1.0, greatest(step.z[places.velocity : places.states]))
    strong = CHANGE * max(1.0, greatest(step.z[places.states : places.works]))
    central = step.stage.beta != 0.0
    copy(step.z, step.z_stage)
    for k in range(TIME + own):
        of_arms = k >= TIME
        column = k - TIME if of_arms else own + k
        of_position = column < d or own <= column < own + TWIST
        if of_position:
            change = CENTRAL_CHANGE if central else CHANGE
        else:
            change = strong if 2 * d <= column < own else fast
        sides = 2 if central and of_position else 1
        for side in range(sides):
            offset = change if side == 0 else -change
            displace(step, blocks, work, places, column, offset)
            status = write_residuals(step, blocks, t, step.z_stage, of_arms, of_position)
            if status != OK:
                return status
            add_difference(blocks, 1.0 / (sides * offset), column)
        displace(step, blocks, work, places, column, 0.0)
    return OK


@kernel
def differentiate_by_share(step, blocks, t):
    """Displace s, by so little that drives within their limits stay there; returns a status."""
    own = 2 * blocks.d + blocks.e
    change = CHANGE * max(1.0, greatest(blocks.share))
    for l in range(blocks.shared - 6):  # noqa: E741
        before = blocks.share[l]
        blocks.share[l] += change
        status = write_residuals(step, blocks, t, step.z, False, False)
        blocks.share[l] = before
        if status != OK:
            return status
        add_difference(blocks, 1.0 / change, own + SHARED + 6 + l)
    return OK


@inlined
def displace(step, blocks, work, places, column, change):
    """Displace the entry of the state that a column belongs to, of every arm that has it."""
    d, z, own = blocks.d, step.z_stage, 2 * blocks.d + blocks.e
    if column >= own:
        at = column - own
        if at >= TWIST:
            at += places.velocity - TWIST
        z[at] = step.z[at] + change
        return
    for i in range(blocks.counts.size):
        first, joints = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        at = -1
        if column < d and column < joints:
            at = places.joints + first + column
        elif d <= column < d + joints:
            at = places.rates + first + column - d
        elif 2 * d <= column < 2 * d + blocks.counts[i]:
            at = places.states + blocks.states[i, column - 2 * d]
        if at >= 0:
            z[at] = step.z[at] + change


@kernel
def write_residuals(step, blocks, t, z, arms_move, positions_move):
    """Write F at a state, for the accelerations and forces in the data; returns a status.

    Without ``arms_move`` the arms' terms are those in the data, without ``positions_move`` all
    products of matrices are those of the beginning.
    """
    struct, stage = step.system, step.stage
    model, data, work = open_system(struct)
    found, found_o = blocks.found, blocks.found_o
    load_chart(z, step.base, data)
    data.time.now = min(t, stage.latest)
    if arms_move:
        stage.evaluations += 1
        status = update_kinematics(struct)
        if status != OK:
            return status
    else:
        object_terms(model, data)
        update_rows(struct)
    write_local_forces(struct, blocks)
    drift_terms(data, stage.alpha, stage.beta)
    if data.status.failed:
        return CALLBACK_FAILED
    if positions_move:
        write_products(blocks, data, work, found, found_o)
    else:
        for i in range(blocks.counts.size):
            copy(blocks.products[i], found[i])
        copy(blocks.products_o, found_o)
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    for i in range(blocks.counts.size):
        row, d0, r0 = found[i], work.dofs[i], work.rows[i]
        n = work.dofs[i + 1] - d0
        for a in range(n):
            row[a] -= data.h[d0 + a]
        for k in range(work.rows[i + 1] - r0):
            row[n + k] -= data.c[r0 + k]
        for k in range(blocks.counts[i]):
            row[rates + k] = data.inner_rate[blocks.states[i, k]]
        for k in range(blocks.power.shape[1]):
            row[powers + k] = blocks.power[i, k]
    for l in range(6):  # noqa: E741
        found_o[l] -= data.h_o[l]
    for k in range(blocks.power.shape[1]):
        found_o[6 + k] = blocks.power[blocks.counts.size, k]
    return OK


@kernel
def write_products(blocks, data, work, found, found_o):
    """Write the products of matrices in F: all but ``h, h_o, c``, and g of the arms."""
    end = blocks.derivatives.shape[1]
    for i in range(blocks.counts.size):
        row, d0, r0, M, W = found[i], work.dofs[i], work.rows[i], work.L[i], work.Y[i]
        n, m = work.dofs[i + 1] - d0, work.rows[i + 1] - r0
        for l in range(12):  # noqa: E741
            row[end + l] = 0.0
        for k in range(m):
            contact, force, s, carried = data.Wo[r0 + k], data.force[r0 + k], 0.0, 0.0
            for l in range(6):  # noqa: E741
                s += contact[l] * data.q_o[l]
                carried += contact[l] * blocks.share[l]
            for l in range(6):  # noqa: E741
                row[end + l] -= contact[l] * force
                row[end + 6 + l] += contact[l] * carried
            row[n + k] = s
        for a in range(n):
            own, s = data.qdd[d0 + a], 0.0
            for b in range(a):
                s += M[a, b] * data.qdd[d0 + b]
                row[b] += M[a, b] * own
            s += M[a, a] * own
            for k in range(m):
                s -= W[a, k] * data.force[r0 + k]
                row[n + k] += W[a, k] * own
            row[a] = s
    for l in range(6):  # noqa: E741
        s = 0.0
        for k in range(6):
            s += data.inertia[l, k] * data.q_o[k]
        found_o[l] = s


@inlined
def add_difference(blocks, weight, column):
    """Add the change of the residuals, times a weight, to one column of the derivatives."""
    own, end = 2 * blocks.d + blocks.e, blocks.derivatives.shape[1]
    base, found = blocks.base, blocks.found
    for i in range(blocks.counts.size):
        for k in range(end):
            blocks.derivatives[i, k, column] += weight * (found[i, k] - base[i, k])
        for l in range(blocks.shared if column < own + SHARED else 0):  # noqa: E741
            change = weight * (found[i, end + l] - base[i, end + l])
            if column < own:
                blocks.on_object[i, l, column] += change
            else:
                blocks.by_object[l, column - own] += change
    if own <= column < own + SHARED:
        for k in range(blocks.found_o.size):
            change = weight * (blocks.found_o[k] - blocks.base_o[k])
            row = k if k < 6 else k - 6 + blocks.shared
            blocks.by_object[row, column - own] += change


@kernel
def write_local_forces(struct, blocks):
    """The right-hand sides ``h`` and ``h_o`` of local control and effects, and the powers by arm.

    As :func:`multiarm.dynamics.equations.right_hand_sides` in scenes whose effects are local.
    """
    model, data, work = open_system(struct)
    arms, total = blocks.counts.size, blocks.power.shape[1] - 1
    for i in range(arms + 1):
        clear(blocks.power[i])
    for i in range(arms):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        bias = floats_at(data.pointers[i, BIAS_AT], d)
        for j in range(d):
            data.h[d0 + j] = -bias[j]
    call_local_effects(struct, model, data, work, blocks, 0, model.passive_end)
    if model.control.shape[0] > 0:
        load_gravity_torque(data, work)
        clear(data.torque)
        carries = 1 if blocks.shared > 6 else 0
        for k in range(model.control.shape[0] - carries):
            law, place = model.control[k, 0], float(model.control[k, 1])
            call_cfunc(law, struct, place, data.time.now)
        if carries == 1:
            carry(blocks, data, work)
        call_local_effects(struct, model, data, work, blocks, model.passive_end, model.actuator_end)
        for i in range(arms):
            for j in range(work.dofs[i], work.dofs[i + 1]):
                data.h[j] += data.torque[j]
                blocks.power[i, total] += data.torque[j] * data.v[j]
    call_local_effects(struct, model, data, work, blocks, model.actuator_end, model.applied_end)


@kernel
def share_weight(struct, blocks):
    """Write s of the state in the data; returns whether the contacts carry any wrench."""
    if blocks.shared == 6:
        return True
    data = open_data(struct)
    A, s, scale = blocks.node, blocks.share, blocks.alpha
    write_wrench_products(data.Wo, A, scale)
    for l in range(6):  # noqa: E741
        s[l] = scale[l] * data.weight[l]
    if not factor_lu(A, 6, blocks.node_pivots) > CARRIED:
        return False
    solve_lu(A, 6, blocks.node_pivots, s)
    for l in range(6):  # noqa: E741
        s[l] *= scale[l]
    return True


@kernel
def carry(blocks, data, work):
    """Add the torques of gravity compensation for the wrench that s distributes."""
    for i in range(blocks.counts.size):
        d0, r0, W = work.dofs[i], work.rows[i], work.Y[i]
        for j in range(work.dofs[i + 1] - d0):
            data.torque[d0 + j] += data.gravity_torque[d0 + j]
            for k in range(work.rows[i + 1] - r0):
                for l in range(6):  # noqa: E741
                    data.torque[d0 + j] -= W[j, k] * data.Wo[r0 + k, l] * blocks.share[l]


@inlined
def call_local_effects(struct, model, data, work, blocks, first, end):
    """Call the effects of one phase, and add the powers of their forces by arm."""
    arms, total, before = blocks.counts.size, blocks.power.shape[1] - 1, blocks.before
    first_joint = chart_places(data).joints
    for k in range(first, end):
        power = blocks.powers[k]
        copy(data.generalised_forces, before)
        call_cfunc(model.effects[k, 0], struct, float(model.effects[k, 1]), data.time.now)
        if power < 0:
            continue
        for i in range(arms):
            s = 0.0
            for j in range(work.dofs[i], work.dofs[i + 1]):
                s += (data.h[j] - before[first_joint + j]) * data.v[j]
            blocks.power[i, power] += s
            blocks.power[i, total] += s
        s = 0.0
        for l in range(6):  # noqa: E741
            s += (data.h_o[l] - before[l]) * data.twist[l]
        blocks.power[arms, power] += s
        blocks.power[arms, total] += s


# --- solution for the derivatives ----------------------------------------------------------------


@kernel
def factor_arms(blocks, data, work):
    """Factors of the arms' equations at the matrices in the data, and ``M_o`` and ``W_o`` of the
    solution; returns whether they can be used.
    """
    usable, first, S = True, 2 * blocks.d + blocks.e + SHARED, blocks.S
    for l in range(blocks.shared):  # noqa: E741
        clear(S[l])
        for c in range(6):
            S[l, c] = data.inertia[l, c] if l < 6 else 0.0
            for k in range(data.Wo.shape[0] if l >= 6 else 0):
                S[l, 6 + c] += data.Wo[k, l - 6] * data.Wo[k, c]
    for i in range(blocks.counts.size):
        r0, n = work.rows[i], work.dofs[i + 1] - work.dofs[i]
        m, K, M, W = work.rows[i + 1] - r0, blocks.K[i], work.L[i], work.Y[i]
        for a in range(n):
            for b in range(a + 1):
                K[a, b] = K[b, a] = M[a, b]
            for k in range(m):
                K[a, n + k], K[n + k, a] = -W[a, k], W[a, k]
        for k in range(m):
            copy(data.Wo[r0 + k], blocks.Wo[r0 + k])
            for l in range(6):  # noqa: E741
                blocks.derivatives[i, n + k, first + l] = data.Wo[r0 + k, l]
            for b in range(m):
                K[n + k, n + b] = 0.0
        usable = usable and factor_lu(K, n + m, blocks.K_pivots[i]) > 0.0
    return usable


@kernel
def solve_arms(blocks, work):
    """From the derivatives of the residuals to those of the accelerations; returns whether it
    succeeded.
    """
    own = 2 * blocks.d + blocks.e
    first, S, u = own + SHARED, blocks.S, blocks.shared
    for l in range(u):  # noqa: E741
        for c in range(SHARED):
            blocks.by_object[l, c] = -blocks.by_object[l, c]
    for i in range(blocks.counts.size):
        r0, n, A = work.rows[i], work.dofs[i + 1] - work.dofs[i], blocks.derivatives[i]
        m, B = work.rows[i + 1] - r0, blocks.on_object[i]
        for k in range(n + m):
            row = A[k]
            for c in range(row.size):
                row[c] = -row[c]
        solve_rows(blocks.K[i], n + m, blocks.K_pivots[i], A)
        for l in range(u):  # noqa: E741
            row = B[l]
            for c in range(own):
                row[c] = -row[c]
            for k in range(m if l < 6 else 0):
                weight, forces = blocks.Wo[r0 + k, l], A[n + k]
                for c in range(own):
                    row[c] += weight * forces[c]
                for c in range(SHARED):
                    blocks.by_object[l, c] += weight * forces[own + c]
                for c in range(u):
                    S[l, c] -= weight * forces[first + c]
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
    places, time = chart_places(data), 2 * blocks.d + blocks.e + TIME
    rates, powers = blocks.d + blocks.m, blocks.d + blocks.m + blocks.e
    clear(slope)
    for l in range(6):  # noqa: E741
        slope[places.velocity + l] = blocks.by_object[l, TIME]
    for k in range(blocks.power.shape[1]):
        slope[places.works + k] = blocks.by_object[blocks.shared + k, TIME]
    for i in range(blocks.counts.size):
        A, first = blocks.derivatives[i], places.rates + work.dofs[i]
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            s = A[j, time]
            for l in range(blocks.shared):  # noqa: E741
                s += A[j, time + 1 + l] * blocks.by_object[l, TIME]
            slope[first + j] = s
        for k in range(blocks.counts[i]):
            slope[places.states + blocks.states[i, k]] = A[rates + k, time]
        for k in range(blocks.power.shape[1]):
            slope[places.works + k] += A[powers + k, time]
