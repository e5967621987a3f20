r"""The compiled part of a mode: its arrays, sliding friction, guards.

*Sliding.*  A sliding contact has a normal force, and friction against its slip: with the slip
velocity :math:`s = |s|\,d` in its two tangents, the force on them is :math:`-\mu\lambda_n d`, so
that its columns of the reaction matrices are

.. math:: \tilde W = W_n - \mu\,(d_1 W_{t1} + d_2 W_{t2}),

of object and arm alike, while its constraint stays along the normal (thesis, footnote to 4.9).  Its
power is :math:`-\mu\lambda_n |s|`.  A contact that holds both ways has the friction
:math:`\mu|\lambda_n|`: while its force pulls, :math:`-\mu` stands for :math:`\mu`.

Where slip comes to rest the direction of :math:`s` reverses.  Within a step the force must be
smooth, so that the step can pass that point and the time be located: of :math:`\pm s` the one
nearer to the last step's direction :math:`d_0` is taken.  Where slip begins, velocities orthogonal
to it decay at the rate :math:`\mu a_n / |s|`, which no method can follow.  With
:math:`s = a d_0 + p`, p orthogonal to :math:`d_0`, and a speed :math:`s_0` that depends on the
accuracy of the run, the direction is therefore that of

.. math:: \sqrt{a^2 + s_0^2}\; d_0 + \frac{a}{\sqrt{a^2 + s_0^2}}\; p ,

which is :math:`\pm s` except for speeds near :math:`s_0`.  The force has full size at any speed.

*Redundant contacts.*  Minimum-norm forces may pull or leave the friction cones where other forces
of the same motion do not.  The mode then begins with forces :math:`\lambda_0` that obey the contact
laws, and :math:`\lambda = \lambda_0 + \delta` with :math:`\delta` of minimum norm.

*Guards* are functions that are positive as long as the mode holds.  They are checked at the end of
every step; those of forces also at its stages, and those of gaps by a cubic between its ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import AT, GAP, GAP_RATE, depth_in_patch
from multiarm.dynamics.arrays import CALLBACK_FAILED, OK, open_coupled, open_data, open_system
from multiarm.dynamics.equations import (
    imbalance,
    renew_kinematics,
    update_rows,
    write_wrenches,
)
from multiarm.dynamics.solver.node import IMBALANCE_BOUND
from multiarm.dynamics.solver.reactions import (
    ReactionWork,
    eliminate_with_reactions,
    solve_for_reactions,
)
from multiarm.jit.kernels import INTS, cfunc, inlined, kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.jit.structs import (
    Flag,
    Float,
    Floats1,
    Floats2,
    Int,
    Ints1,
    Ints2,
    Numbers,
    make_struct,
    struct_at,
    view,
)
from multiarm.jit.vectors import vec

# Columns of ModeArrays.slides: held row, its arm, first tangent among the tangents' rows, and among
# all rows.
HELD, ARM, TANGENT_AT, TANGENT_OF_ALL, SLIDE_WIDTH = range(5)

# Kinds of guards, and the meaning of their numbers a, b, c and parameter.
GAP_GUARD = 0  # gap of row a of all rows [m]
PUSH_GUARD = 1  # parameter (1; -1 where it pulls) times the force of held row a [N]
CONE_GUARD = 2  # parameter (mu; -mu where it pulls) times force of row a, minus that of b, c [N]
SLIP_GUARD = 3  # speed of slide a along its direction [m/s]
RATE_GUARD = 4  # speed of joint a times the parameter [rad/s, m/s]
HOLD_GUARD = 5  # parameter, minus the magnitude of the force of held row a [N m, N]
REST_GUARD = 6  # gap of row a of all rows, plus the parameter (largest gap at contact) [m]
PATCH_GUARD = 7  # c times the distance of the contact of row a from the edge of its patch [m]
LIFT_GUARD = 8  # parameter (largest gap at contact), minus the gap of row a of all rows [m]
ONSET_GUARD = 9  # parameter (largest speed at rest), minus that of slip in tangents a, a + 1 [m/s]
SPRING_GUARD = 10  # c times the extension of the spring in row a, see spring_length [m]
# Columns of ModeArrays.guards and .levels.
GUARD_KIND, A, B, C, CONSTRAINT, GUARD_WIDTH = range(6)
PARAMETER, THRESHOLD, LEVEL_WIDTH = range(3)
# Result of a guard for a step: no event, a sign change, perhaps two sign changes.
QUIET, FIRED, DIPPED = range(3)


class ModeNumbers(Numbers):
    """Numbers of one mode."""

    slow: Float  # the speed ``s_0`` [m/s]
    power: Int  # index of the power of sliding friction in ``data.power``
    muted: Flag  # the current step ends at an event that has been located
    stressed: Flag  # there are forces ``lambda_0``
    begin: Float  # of the last step [s]
    end: Float


class ModeArrays(NamedTuple):
    """Numbers and arrays of one mode.

    held : int64 (m,)
        The held rows, among all rows.
    slides : int64 (s, 4), slide_mu : (s,), direction, turning : (s, 2), speed : (s,)
        Sliding contacts: rows, coefficients of friction (negative where the force pulls), direction
        of slip at the end of the last step and at the state evaluated last, and the speed along it
        [m/s].
    states : (u,)
        State of every contact, as it is recorded.
    guards : int64 (g, 5), levels : (g, 2)
        Kind, a, b, c, constraint; parameter, and the value above which a guard that was at zero
        when the mode began counts as positive.
    values, before, rates, least : (g,)
        Values at the state evaluated last and at the end of the last step, rate of a gap then,
        least value in the stages since.
    armed, found : int64 (g,)
        Whether it has been positive in this mode; its result for the last step.
    patches : (g, 18)
        Of patch guards: frame of the patch (rotation row by row, origin) in its body, and corners.
    Wr : (m, 6)
        The object's rows of the reaction matrices.
    prestress : (m,)
        The forces ``lambda_0``.
    springs : int64 (s,), spring_force : (s,)
        Compliant contacts: their rows among all, and their forces.
    """

    numbers: ModeNumbers
    held: Ints1
    slides: Ints2
    slide_mu: Floats1
    direction: Floats2
    turning: Floats2
    speed: Floats1
    states: Floats1
    guards: Ints2
    levels: Floats2
    values: Floats1
    before: Floats1
    rates: Floats1
    least: Floats1
    armed: Ints1
    found: Ints1
    patches: Floats2
    Wr: Floats2
    prestress: Floats1
    springs: Ints1
    spring_force: Floats1


def mode_struct(arrays: ModeArrays, reactions: ReactionWork | None) -> np.ndarray:
    """Struct of a mode; :func:`open_mode` and :func:`open_reactions` are its inverse."""
    return make_struct([*arrays, *(reactions or ())])


# Views of a mode's struct: its own arrays, and those of the node algorithm with friction.
open_mode, open_reactions = view(ModeArrays), view(ReactionWork, len(ModeArrays._fields))


@cfunc
def solve_held(address, size, _a, _b):
    """Solve a mode without sliding contacts, and update the least values of its guards."""
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    mode = open_mode(struct_at(data.modes.guards, 0))
    if mode.numbers.stressed:
        add_prestress(mode, data.Wo, work.Y, data, work)
    status = call_cfunc(data.functions.project, struct, 0.0, 0.0)
    if mode.numbers.stressed:
        restore_forces(mode, data)
    update_least(data)
    return status


@kernel
def add_prestress(mode, on_object, on_arms, data, work):
    """Add the generalised forces of ``mode.prestress`` to the right-hand sides."""
    for i in range(work.dofs.size - 1):
        d0, first = work.dofs[i], work.rows[i]
        for k in range(first, work.rows[i + 1]):
            force = mode.prestress[k]
            for l in range(6):  # noqa: E741
                data.h_o[l] += on_object[k, l] * force
            for j in range(work.dofs[i + 1] - d0):
                data.h[d0 + j] += on_arms[i, j, k - first] * force


@kernel
def restore_forces(mode, data):
    """Add the forces of ``mode.prestress`` to the solution."""
    for k in range(data.force.size):
        data.force[k] += mode.prestress[k]


@cfunc
def solve_sliding(address, size, _a, _b):
    """Solve a mode with sliding contacts."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    own = struct_at(data.modes.guards, 0)
    mode, reactions = open_mode(own), open_reactions(own)
    write_reactions(data, work, mode, reactions)
    if mode.numbers.stressed:
        add_prestress(mode, mode.Wr, reactions.Yr, data, work)
    data.status.imbalance = 0.0
    coupled = open_coupled(struct)
    coupled.status.arms = 0
    if model.dense:
        call_python(data.functions.dense)
        if data.status.failed:
            return CALLBACK_FAILED
    else:
        status = solve_reactions(data, work, mode, reactions, False)
        if status == OK and not data.status.imbalance <= IMBALANCE_BOUND:
            status = renew_kinematics(struct)
            if status == OK:
                write_reactions(data, work, mode, reactions)
                status = solve_reactions(data, work, mode, reactions, True)
        if status != OK:
            return status
        lacking = reactions.status.rows - reactions.status.rank
        if lacking > 0:
            coupled.status.arms = 1
            coupled.status.unknowns = reactions.status.rows
            coupled.status.rank = reactions.status.rank
            coupled.status.margin = math.inf
    if mode.numbers.stressed:
        restore_forces(mode, data)
    power = 0.0
    for s in range(mode.slides.shape[0]):
        power -= mode.slide_mu[s] * data.force[mode.slides[s, HELD]] * mode.speed[s]
    data.power[mode.numbers.power] = power
    data.power[data.power.size - 1] += power
    update_least(data)
    return OK


@kernel
def solve_reactions(data, work, mode, reactions, couple_all):
    """Eliminate and solve for one right-hand side, with the reaction matrices; returns a status."""
    work.factored[0] = 1
    failed = eliminate_with_reactions(reactions, data.Wo, mode.Wr, data.inertia, couple_all)
    if failed >= 0:
        return failed
    solve_for_reactions(
        reactions, data.Wo, mode.Wr, data.h_o, data.h, data.c, data.q_o,
        data.qdd, data.force,
    )  # fmt: skip
    data.status.imbalance = imbalance(data, work, mode.Wr)
    return OK


@kernel
def write_reactions(data, work, mode, reactions):
    """Reaction matrices at the kinematics in ``data``, into ``mode.Wr`` and ``reactions.Yr``."""
    update_rows(struct_at(data.modes.tangents, 0))
    _, aside, tangents = open_system(struct_at(data.modes.tangents, 0))
    for k in range(data.Wo.shape[0]):
        for l in range(6):  # noqa: E741
            mode.Wr[k, l] = data.Wo[k, l]
    for i in range(work.dofs.size - 1):
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            for a in range(work.rows[i + 1] - work.rows[i]):
                reactions.Yr[i, j, a] = work.Y[i, j, a]
    for s in range(mode.slides.shape[0]):
        row, i, t = mode.slides[s, HELD], mode.slides[s, ARM], mode.slides[s, TANGENT_AT]
        write_direction(s, mode, aside.contacts[t, GAP_RATE], aside.contacts[t + 1, GAP_RATE])
        first, second = mode.slide_mu[s] * mode.turning[s, 0], mode.slide_mu[s] * mode.turning[s, 1]
        for k in range(6):
            mode.Wr[row, k] -= first * aside.Wo[t, k] + second * aside.Wo[t + 1, k]
        own, other = row - work.rows[i], t - tangents.rows[i]
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            pull = first * tangents.Y[i, j, other] + second * tangents.Y[i, j, other + 1]
            reactions.Yr[i, j, own] -= pull


@kernel
def write_direction(s, mode, first, second):
    """Direction of slip from its two components, near to the last step's."""
    d0, d1, slow = mode.direction[s, 0], mode.direction[s, 1], mode.numbers.slow
    along = first * d0 + second * d1
    p0, p1 = first - along * d0, second - along * d1
    root = math.sqrt(along * along + slow * slow)
    e0, e1 = root * d0 + along / root * p0, root * d1 + along / root * p1
    size = math.sqrt(e0 * e0 + e1 * e1)
    d0, d1 = e0 / size, e1 / size
    mode.turning[s, 0], mode.turning[s, 1] = d0, d1
    mode.speed[s] = first * d0 + second * d1


@cfunc
def record_forces(address, size, _t, _b):
    """Write the forces of all rows and the states of contacts, ``data.shown``, and the wrenches."""
    data = open_data(struct_at(address, size))
    mode = open_mode(struct_at(data.modes.guards, 0))
    shown = data.shown
    shown[:] = 0.0
    for k in range(mode.held.size):
        shown[mode.held[k]] = data.force[k]
    for s in range(mode.slides.shape[0]):
        drag = -mode.slide_mu[s] * data.force[mode.slides[s, HELD]]
        t = mode.slides[s, TANGENT_OF_ALL]
        shown[t], shown[t + 1] = drag * mode.turning[s, 0], drag * mode.turning[s, 1]
    for k in range(mode.springs.size):
        shown[mode.springs[k]] = mode.spring_force[k]
    first = shown.size - mode.states.size
    for k in range(mode.states.size):
        shown[first + k] = mode.states[k]
    struct = struct_at(data.modes.full, 0)
    update_rows(struct)
    _, full, work = open_system(struct)
    write_wrenches(full.Wo, work.rows, shown, data.wrenches)
    return CALLBACK_FAILED if data.status.failed else OK


@kernel
def force_guard(g, mode, data):
    """Value of a force guard."""
    kind, a = mode.guards[g, GUARD_KIND], mode.guards[g, A]
    parameter, force = mode.levels[g, PARAMETER], data.force
    if kind == PUSH_GUARD:
        return parameter * force[a]
    if kind == HOLD_GUARD:
        return parameter - abs(force[a])
    square = 0.0
    for column in (B, C):
        if mode.guards[g, column] >= 0:
            square += force[mode.guards[g, column]] ** 2
    return parameter * force[a] - math.sqrt(square)


@kernel
def is_force_guard(kind):
    """Whether the value of a guard depends on forces."""
    return kind in (PUSH_GUARD, HOLD_GUARD, CONE_GUARD)


@kernel
def is_gap_guard(g, mode):
    """Whether a guard is the gap of an open contact."""
    kind = mode.guards[g, GUARD_KIND]
    return kind == GAP_GUARD or (kind == SPRING_GUARD and mode.guards[g, C] > 0)


@kernel
def update_least(data):
    """Update the least values of force guards at a stage of a step."""
    mode = open_mode(struct_at(data.modes.guards, 0))
    for g in range(mode.guards.shape[0]):
        if is_force_guard(mode.guards[g, GUARD_KIND]):
            mode.least[g] = min(mode.least[g], force_guard(g, mode, data))


@inlined
def spring_length(gap, rate, lag):
    """Extension of a spring and damper that only push [m]; they push where it is negative.

    They push while they are compressed and their force ``-k (gap + lag rate)`` is positive, with
    ``lag`` the damping over the stiffness ``k`` [s].
    """
    return max(gap, gap + lag * rate)


@kernel
def guard_value(g, mode, data, full):
    """Value of a guard at the state evaluated last; ``full`` are the data of all rows."""
    kind, a, parameter = mode.guards[g, GUARD_KIND], mode.guards[g, A], mode.levels[g, PARAMETER]
    if kind == GAP_GUARD:
        return full.contacts[a, GAP]
    if kind == REST_GUARD:
        return parameter + full.contacts[a, GAP]
    if kind == LIFT_GUARD:
        return parameter - full.contacts[a, GAP]
    if kind == SLIP_GUARD:
        t = mode.slides[a, TANGENT_OF_ALL]
        first, second = full.contacts[t, GAP_RATE], full.contacts[t + 1, GAP_RATE]
        return first * mode.direction[a, 0] + second * mode.direction[a, 1]
    if kind == ONSET_GUARD:
        first, second = full.contacts[a, GAP_RATE], full.contacts[a + 1, GAP_RATE]
        return parameter - math.sqrt(first * first + second * second)
    if kind == RATE_GUARD:
        return parameter * data.v[a]
    if kind == SPRING_GUARD:
        row = full.contacts[a]
        return mode.guards[g, C] * spring_length(row[GAP], row[GAP_RATE], parameter)
    if kind == PATCH_GUARD:
        return mode.guards[g, C] * depth_in_patch(mode.patches[g], vec(full.contacts[a], AT))
    return force_guard(g, mode, data)


@cfunc
def write_guards(address, size, _a, _b):
    """Write the values of all guards at the state evaluated last."""
    data = open_data(struct_at(address, size))
    write_values(open_mode(struct_at(data.modes.guards, 0)), data)
    return CALLBACK_FAILED if data.status.failed else OK


@kernel
def write_values(mode, data):
    """Kinematics of all rows, and the values of all guards."""
    struct = struct_at(data.modes.full, 0)
    update_rows(struct)
    full = open_data(struct)
    for g in range(mode.guards.shape[0]):
        mode.values[g] = guard_value(g, mode, data, full)


@cfunc
def check_guards(address, size, begin, end):
    """Check all guards at the end of a step; ``FIRED`` when one of them reports an event."""
    data = open_data(struct_at(address, size))
    mode = open_mode(struct_at(data.modes.guards, 0))
    write_values(mode, data)
    if data.status.failed:
        return OK  # the time loop checks the flag
    full = open_data(struct_at(data.modes.full, 0))
    mode.numbers.begin, mode.numbers.end = begin, end
    events = 0
    for g in range(mode.guards.shape[0]):
        mode.found[g] = judge_guard(g, mode, full, end - begin)
        events += 1 if mode.found[g] != QUIET else 0
    if events > 0 and not mode.numbers.muted:
        return FIRED
    mode.numbers.muted = False
    accept_guards(mode, full)
    return OK


@kernel
def judge_guard(g, mode, full, h):
    """Result of a guard for a step of length ``h``."""
    now, least, kind = mode.values[g], mode.levels[g, THRESHOLD], mode.guards[g, GUARD_KIND]
    if now < (0.0 if mode.armed[g] != 0 else -least):
        return FIRED
    if is_force_guard(kind):
        return DIPPED if mode.least[g] < -least else QUIET
    if is_gap_guard(g, mode) and mode.armed[g] != 0:
        # a cubic through both ends and their rates has a minimum below zero
        end = full.contacts[mode.guards[g, A]]
        before, gap, rate = mode.before[g], end[GAP], end[GAP_RATE]
        if mode.rates[g] < 0.0 < rate and dips(before, mode.rates[g], gap, rate, h):
            return DIPPED
    return QUIET


@kernel
def dips(p, m, q, n, h):
    """Whether the cubic from ``p`` with slope ``m`` to ``q`` with slope ``n`` gets near zero."""
    # its derivative is m + 2 b x + 3 a x^2 with x from 0 to 1
    m, n = m * h, n * h
    a, b = 2.0 * (p - q) + m + n, 3.0 * (q - p) - 2.0 * m - n
    square = b * b - 3.0 * a * m
    if square <= 0.0:
        return False
    x = -m / (b + math.sqrt(square))
    if not 0.0 < x < 1.0:
        return False
    lowest = p + x * (m + x * (b + x * a))
    return lowest < 0.05 * min(p, q)


@kernel
def accept_guards(mode, full):
    """Make the end of a step the beginning of the next one."""
    for g in range(mode.guards.shape[0]):
        mode.before[g] = mode.values[g]
        mode.least[g] = math.inf
        if is_gap_guard(g, mode):
            mode.rates[g] = full.contacts[mode.guards[g, A], GAP_RATE]
        if mode.values[g] > mode.levels[g, THRESHOLD]:
            mode.armed[g] = 1
    for s in range(mode.slides.shape[0]):
        t = mode.slides[s, TANGENT_OF_ALL]
        first, second = full.contacts[t, GAP_RATE], full.contacts[t + 1, GAP_RATE]
        write_direction(s, mode, first, second)
        mode.direction[s, 0], mode.direction[s, 1] = mode.turning[s, 0], mode.turning[s, 1]


@kernel
def start_guards(struct: INTS):
    """Initialise the guards and the solver monitor at the state evaluated last."""
    data = open_data(struct)
    call_cfunc(data.functions.record, struct, 0.0, 0.0)
    call_cfunc(data.functions.compare, struct, 0.0, 0.0)
    mode = open_mode(struct_at(data.modes.guards, 0))
    write_values(mode, data)
    accept_guards(mode, open_data(struct_at(data.modes.full, 0)))
