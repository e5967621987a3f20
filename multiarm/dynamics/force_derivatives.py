r"""Derivatives of the forces of control and effects.

They are what laws and effects state (:mod:`multiarm.dynamics.effect_kernels`,
:mod:`multiarm.control.program`), and differences of the forces of those that state none.  Torques
of the control come to the first actuator, and what this makes of them to the next one; so do their
derivatives, ``data.slopes.torque``.  All other derivatives are those of one effect at a time,
``data.slopes.force``.  Columns are those of the state, then the effects' states, the time, and the
multipliers of a law (:mod:`multiarm.dynamics.control_laws`).

*Differences* (:mod:`multiarm.geometry.stencils`) are of order four, or of order one where many
evaluations cost more than an error is worth; those by the time look forward, with order two.  An
actuator is displaced along the derivatives of the torques that come to it.  Where forces are
*local*, those on a block by its own state and those on the object by the object's, joint number j
of all blocks is displaced at once.  Functions of users know the state alone: for them no kinematics
are computed.

*Powers* are those of the forces, :math:`f\cdot v`, so that their derivatives follow by the product
rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import (
    DERIVATIVE,
    OPEN_LOOP,
    SHARE_DERIVATIVE,
    STATE_ALONE,
    call_derivative,
    call_listed,
    failure_of_kernel,
    open_data,
    open_system,
)
from multiarm.dynamics.contact_derivatives import STEP
from multiarm.dynamics.coordinates import (
    chart_places,
    column_of_velocity,
    force_columns,
    place_in_chart,
    retract_into,
)
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import (
    command_torques,
    control_torques,
    load_gravity_torque,
    passive_forces,
    update_kinematics,
)
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.held_control import without_samples
from multiarm.dynamics.kinematics import object_terms
from multiarm.dynamics.status import CALLBACK_FAILED, OK, SINGULAR
from multiarm.dynamics.variables import HELD
from multiarm.geometry.stencils import CENTRAL_4, FORWARD_1, FORWARD_2
from multiarm.jit.kernels import (
    INTS,
    TABLE,
    Kernel,
    allocating,
    clear,
    copy,
    greatest,
    inlined,
    kernel,
)
from multiarm.jit.pointers import address_of, call_cfunc
from multiarm.jit.structs import Flag, Float, Int, Numbers, referenced

# Displacement of a difference of order one [m, rad], of velocities and of states of effects
# relative to the largest one or to 1: roundings are 1e-9 of the forces.
CHANGE = 1e-7
# Change of the time, relative to the step or to 1 s.
TIME_CHANGE = 1e-5
# Row of all control laws, among those of effects.
CONTROL = -1


class ForceDifferences(Numbers):
    """How forces are differentiated, and those by differences that have no derivatives."""

    local: Flag  # each block by its own state, the object by its own
    laws: Int  # control laws, the first ones
    follows: Flag  # the torques of the laws follow the state, they are not held
    order: Int  # 1 or 4
    held: Flag  # the torques of the control, between two samples
    time_change: Float  # [s]; 0: without the column of the time
    evaluations: Int  # kinematics that were computed


@inlined
def begin_differences(model, data, differences, h):
    """Set what derivatives in a step of length ``h`` need."""
    differences.held = torques_are_held(model, data)
    differences.follows = model.control_reach > OPEN_LOOP and not differences.held
    differences.time_change = TIME_CHANGE * min(h, 1.0)  # [s]
    differences.evaluations = 0


@inlined
def torques_are_held(model, data):
    """Whether the control is sampled, and this is not the time of a sample."""
    return model.sampled.shape[0] > 0 and data.control.sampling.due == HELD


def prepare_derivatives(data: Data, of_laws: bool = True) -> None:
    """Compile the derivatives that effects and laws state, and make what those of the laws need.

    To be called before they are taken; those of the laws only with ``of_laws``.
    """
    model, constants = data.model, data.model.constants
    for row, effect in zip(constants.effects, model.effects.called, strict=True):
        row[DERIVATIVE] = _address(effect.derivative)
    if not of_laws:
        return
    laws = constants.sampled if len(constants.sampled) else constants.control
    for row, law in zip(laws, model.laws, strict=False):  # a controller in Python is no law
        row[DERIVATIVE] = _address(law.derivative)
        row[SHARE_DERIVATIVE] = _address(law.share_derivative)
    for law, work in zip(model.laws, data.of_laws.law_works, strict=True):
        if law.prepare is not None:
            law.prepare(data.of_laws, work)


def _address(derivative: Kernel | None) -> int:
    return 0 if derivative is None else address_of(derivative)


def applied_derivatives(data: Data, closed_loop: bool) -> np.ndarray | None:
    """Derivatives of what control and effects add to the forces, at the state in the data.

    Of generalised forces and rates of effects' states (e), by the columns of the state
    (:mod:`multiarm.dynamics.layout`) and effects' states, shape (6 F + n + e, 12 F + 2 n + e);
    None
    where nothing depends on these.  Without ``closed_loop`` the control's torques are held, and
    drives with states follow these; with it, sampled control is taken as continuous.
    """
    model, layout, e = data.model, data.model.layout, data.arrays.effects.states.size
    constants, columns = model.constants, data.arrays.slopes.torque.shape[1]
    follows = len(constants.control) > 0 and constants.control_reach > OPEN_LOOP
    follows &= closed_loop
    if not (follows or model.effects.kernels):
        return None
    prepare_derivatives(data, follows)
    differences = ForceDifferences(laws=len(constants.control), follows=follows, order=4)
    applied = np.zeros((layout.nv + e + data.arrays.effects.power.size, columns))
    with without_samples(data.arrays.control):
        status = write_applied(data.struct, differences, model.effects.powers, applied)
    require_ok(data, status)
    return applied[: layout.nv + e, : 2 * layout.nv + e]


@kernel
def write_applied(struct: INTS, differences: ForceDifferences, powers: INTS, applied: TABLE):
    """Write what :func:`applied_derivatives` describes; returns a status.

    At the end the data are as they were.
    """
    clear_table(open_data(struct).slopes.torque)
    status = differentiate_forces(struct, differences, powers, add_slopes, applied)
    if status == OK:
        status = update_kinematics(struct)
    if status != OK:
        return status
    return call_cfunc(open_data(struct).functions.forces, struct, 0.0, 0.0)


@kernel
def differentiate_forces(struct, differences, powers, gather, out):
    """Differentiate what control and effects do, in the order in which they act; returns a status.

    The derivatives of the torques of the drives, and those of each effect, are handed to
    ``gather(out, data, work, power, of_drives)``, a kernel, as they stand in the data: in
    ``slopes.torque`` (``of_drives``) or ``slopes.force``.  ``power`` is the place of the power of
    these forces, -1 without; ``powers`` are those of the effects, the last one is that of all.
    Laws beyond ``differences.laws`` are differentiated at fixed multipliers, and the wrench balance
    that determines these in ``slopes.balance``.
    """
    model, data, work = open_system(struct)
    controlled, status, total = model.control.shape[0] > 0, OK, data.effects.power.size - 1
    if data.slopes.passive.shape[0] > 0:
        clear_slopes(model, data, work, differences.local, data.slopes.passive, 0)
    for k in range(model.applied_end + 1):
        if k == model.passive_end and controlled:
            status = differentiate_control(struct, differences)
        if status == OK and k == model.actuator_end and controlled:
            gather(out, data, work, total, True)
        acts = controlled or not actuates(model, k)
        if status == OK and k < model.applied_end and acts:
            status = differentiate_effect(struct, differences, k)
            if k < model.passive_end:
                add_passive_slopes(data)
            gather(out, data, work, powers[k], False)
        if status != OK:
            break
    return status


@inlined
def actuates(model, k):
    """Whether an effect changes the torques of the control."""
    return model.passive_end <= k < model.actuator_end


@inlined
def add_passive_slopes(data):
    """Add the derivatives of one effect to those of all that act on the joints before control."""
    first = chart_places(data).joints
    for j in range(data.slopes.passive.shape[0]):
        slopes, row = data.slopes.force[first + j], data.slopes.passive[j]
        for c in range(row.size):
            row[c] += slopes[c]


@kernel
def add_slopes(applied, data, _work, power, of_drives):
    """Add derivatives of generalised forces, rates of effects' states, and powers to ``applied``.

    Its rows are these; the powers are those of each effect and of all.
    """
    first, columns = chart_places(data).joints, force_columns(data)
    slopes = data.slopes.torque if of_drives else data.slopes.force
    begin = first if of_drives else 0
    for i in range(slopes.shape[0]):
        row = applied[begin + i]
        for c in range(row.size):
            row[c] += slopes[i, c]
    if power < 0:
        return
    powers, total = data.slopes.force.shape[0], data.effects.power.size - 1
    last = data.control.torque.size if of_drives else data.state.velocity.size
    for place in range(power, total + 1, max(total - power, 1)):
        row = applied[powers + place]
        for i in range(last):
            l = begin + i
            for c in range(row.size):
                row[c] += slopes[i, c] * data.state.velocity[l]
            force = data.control.torque[i] if of_drives else data.forces.f[i]
            row[column_of_velocity(columns, l)] += force


@kernel
def differentiate_control(struct, differences):
    """Add the derivatives of the torques of the control laws, and compute these.

    By the time, and, where they follow the state, by this: as the laws state them, or all by
    differences where one states none.  Returns a status; ``SINGULAR`` where forces are local and a
    law has no derivative at this state.
    """
    model, data, work = open_system(struct)
    columns, differs = force_columns(data), False
    clear_slopes(model, data, work, differences.local, data.slopes.force, chart_places(data).joints)
    status = act(struct, differences, CONTROL, model, data, work)
    if status == OK and differences.follows:
        for k in range(differences.laws):
            differs = differs or model.control[k, DERIVATIVE] == 0
        if not differs:
            status = differentiate_laws(struct, differences, model, data)
        if status == SINGULAR and not differences.local:
            clear_table(data.slopes.torque)
            status, differs = OK, True
    if differs:
        status = add_differences(struct, differences, CONTROL, True)
        take_torque_slopes(data, 0, columns.end)
    elif status == OK and differences.time_change > 0.0 and not differences.held:
        status = add_differences(struct, differences, CONTROL, False)
        take_torque_slopes(data, columns.time, columns.time + 1)
    for u in range(model.undriven.size):
        clear(data.slopes.torque[model.undriven[u]])
    acted = act(struct, differences, CONTROL, model, data, work)
    for k in range(differences.laws, model.control.shape[0]):
        if acted == OK:
            acted = call_listed(model.control, k, struct, data)
        if status == OK and acted == OK:
            clear_table(data.slopes.balance)
            status = call_derivative(model.control, k, SHARE_DERIVATIVE, struct, data)
    return acted if status == OK else status


@inlined
def differentiate_laws(struct, differences, model, data):
    """Let the laws add their derivatives; returns a status, ``SINGULAR`` where one has none."""
    status = OK
    of_laws = referenced(data.modes.of_laws) if data.modes.active else struct
    for k in range(differences.laws):
        if status == OK:
            status = call_derivative(model.control, k, DERIVATIVE, of_laws, data)
    return status


@inlined
def take_torque_slopes(data, begin, end):
    """Add columns of the differences of torques to the derivatives of the torques."""
    first = chart_places(data).joints
    for j in range(data.control.torque.size):
        for c in range(begin, end):
            data.slopes.torque[j, c] += data.slopes.force[first + j, c]


@kernel
def differentiate_effect(struct, differences, k):
    """Write the derivatives of effect number k, and let it act; returns a status.

    Those of an actuator change ``data.slopes.torque``, as it changes ``data.control.torque``; else
    forces of this effect alone are in ``data.forces.f``.
    """
    model, data, work = open_system(struct)
    status, first = OK, chart_places(data).joints
    stated = model.effects[k, DERIVATIVE] != 0
    clear_slopes(model, data, work, differences.local, data.slopes.force, first)
    if stated:
        status = call_derivative(model.effects, k, DERIVATIVE, struct, data)
        if status == SINGULAR:  # differences take the place of those of laws only
            status = failure_of_kernel(model.effects[k, DERIVATIVE], status, data)
    by_time = differences.time_change > 0.0 and not actuates(model, k)
    if status == OK and (not stated or by_time):
        status = add_differences(struct, differences, k, not stated)
    if actuates(model, k) and not stated:
        for j in range(data.control.torque.size):
            copy(data.slopes.force[first + j], data.slopes.torque[j])
            clear(data.slopes.force[first + j])
    acted = act(struct, differences, k, model, data, work)
    return acted if status == OK else status


@kernel
def clear_slopes(model, data, work, local, table, first):
    """Write zeros into a table of derivatives whose rows of joints begin at ``first``.

    Where forces are local, into those columns of each row only that are read: the cost is linear.
    """
    if not local:
        clear_table(table)
        return
    at = force_columns(data)
    for l in range(first):
        clear(table[l, : at.positions])
        clear(table[l, at.states :])
    for i in range(work.first_joint.size - 1):
        for j in range(work.first_joint[i], work.first_joint[i + 1]):
            clear_columns(at, work.first_joint[i], work.first_joint[i + 1], table[first + j])
        for s in range(table.shape[0] - first - data.state.joint_rates.size):
            if work.first_joint[i] <= model.state_joints[s] < work.first_joint[i + 1]:
                row = table[first + data.state.joint_rates.size + s]
                clear_columns(at, work.first_joint[i], work.first_joint[i + 1], row)


@inlined
def clear_columns(at, begin, end, row):
    """Write zeros into the columns of a block's joints, of the object, and of what follows."""
    clear(row[: at.positions])
    clear(row[at.positions + begin : at.positions + end])
    clear(row[at.rates + begin : at.rates + end])
    clear(row[at.states :])


@inlined
def clear_table(table):
    """Write zeros into all rows."""
    for i in range(table.shape[0]):
        clear(table[i])


@inlined
def act(struct, differences, k, model, data, work):
    """Let one effect write its forces alone, an actuator its torques, or the control these.

    Returns a status.
    """
    if k != CONTROL:
        clear(data.forces.f)
        return call_listed(model.effects, k, struct, data)
    object_terms(model, data)  # laws may compensate the forces before them
    status = passive_forces(struct, model, data, work)
    if status != OK:
        return status
    if differences.laws == model.control.shape[0]:
        return command_torques(struct, model, data, work)
    load_gravity_torque(data, work)
    return control_torques(struct, differences.laws, model, data)


# --- differences ---------------------------------------------------------------------------------


class Undisplaced(NamedTuple):
    """The values of what differences displace."""

    configuration: np.ndarray
    velocity: np.ndarray
    states: np.ndarray
    torque: np.ndarray
    time: float


@allocating
def add_differences(struct, differences, k, by_state):
    """Add derivatives of one effect, or of the control, by the time, and ``by_state`` by all else.

    They are written to ``data.slopes.force``, also those of torques.  Returns a status.
    """
    model, data, work = open_system(struct)
    at, first, state = force_columns(data), chart_places(data).joints, data.state
    start = Undisplaced(
        state.configuration.copy(), state.velocity.copy(), data.effects.states.copy(),
        data.control.torque.copy(), data.time.now,
    )  # fmt: skip
    of_drives = k != CONTROL and actuates(model, k)
    of_torques, moves = of_drives or k == CONTROL, not knows_state_alone(model, data, k)
    columns = np.zeros(start.velocity.size + start.states.size, dtype=np.int64)
    direction, offsets, weights = np.zeros(2 * start.velocity.size), np.empty(4), np.empty(4)
    base, value = np.zeros(columns.size), np.zeros(columns.size)
    status = act(struct, differences, k, model, data, work)
    read_forces(data, of_torques, first, base)
    for column in range(at.end if status == OK else 0):
        wanted = by_state and (column < at.time or of_drives)
        if column == at.time:
            wanted = differences.time_change > 0.0
        if wanted:
            wanted = choose_columns(differences, column, model, data, work, columns, direction)
        if not wanted:
            continue
        for point in range(write_points(differences, at, column, start, offsets, weights)):
            status = displace(
                struct, differences, column, offsets[point], direction, moves, start, data
            )
            for j in range(start.torque.size if of_drives else 0):
                row = columns[first + j]
                data.control.torque[j] = start.torque[j]
                if row >= 0:
                    data.control.torque[j] += offsets[point] * data.slopes.torque[j, row]
            if status == OK:
                status = act(struct, differences, k, model, data, work)
            if data.status.failed:
                status = CALLBACK_FAILED
            read_forces(data, of_torques, first, value)
            for i in range(columns.size):
                if columns[i] >= 0:
                    change = weights[point] * (value[i] - base[i])
                    data.slopes.force[i, columns[i]] += change
            if status != OK:
                break
        copy(start.configuration, data.state.configuration)
        copy(start.velocity, data.state.velocity)
        copy(start.states, data.effects.states)
        data.time.now = start.time
        if status != OK:
            break
    copy(start.torque, data.control.torque)
    if by_state and moves and status == OK:
        differences.evaluations += 1
        status = update_kinematics(struct)
    return status


@kernel
def write_points(differences, at, column, start, offsets, weights):
    """Write the displacements of a column and the weights of their values; returns their number."""
    if column == at.time:
        return scale_stencil(FORWARD_2, differences.time_change, offsets, weights)
    if differences.order == 4:
        return scale_stencil(CENTRAL_4, STEP, offsets, weights)
    change = CHANGE
    if at.twists <= column < at.positions or at.rates <= column < at.states:
        change *= max(1.0, greatest(start.velocity))
    elif at.states <= column < at.time:
        change *= max(1.0, greatest(start.states))
    return scale_stencil(FORWARD_1, change, offsets, weights)


@inlined
def scale_stencil(stencil, step, offsets, weights):
    """Write the points of a stencil for a step; returns their number."""
    for point in range(len(stencil.offsets)):
        offsets[point] = stencil.offsets[point] * step
        weights[point] = stencil.weights[point] / step
    return len(stencil.offsets)


@kernel
def displace(struct, differences, column, offset, direction, moves, start, data):
    """Displace the state, an effect's state or the time by an offset; returns a status.

    ``moves``: with the kinematics, of the object alone where forces are local.
    """
    at, places, status = force_columns(data), chart_places(data), OK
    if column == at.time:
        data.time.now = start.time + offset
    elif at.states <= column < at.time:
        entry = column - at.states
        data.effects.states[entry] = start.states[entry] + offset
    if column >= at.states:
        return status
    frames = data.state.poses.shape[0]
    bases, moved = data.state.floating_bases, data.state.configuration
    retract_into(frames, bases, start.configuration, offset, direction, moved)
    for l in range(start.velocity.size):
        data.state.velocity[l] = start.velocity[l] + offset * direction[places.velocity + l]
    if moves and differences.local and column < at.positions:
        object_terms(open_system(struct)[0], data)
    elif moves:
        differences.evaluations += 1
        status = update_kinematics(struct)
    return status


@inlined
def knows_state_alone(model, data, k):
    """Whether an effect, or the control, is a function ``f(t, state)`` of a user."""
    return data.functions.control != 0 if k == CONTROL else model.effects[k, STATE_ALONE] != 0


@inlined
def read_forces(data, torques, joints, out):
    """Copy generalised forces, or torques in their place, and the rates of effects' states."""
    size = data.state.velocity.size
    for k in range(size):
        out[k] = data.forces.f[k]
        if torques:
            out[k] = data.control.torque[k - joints] if k >= joints else 0.0
    for k in range(data.effects.state_rates.size):
        out[size + k] = data.effects.state_rates[k]


@inlined
def choose_columns(differences, column, model, data, work, columns, direction):
    """Write which positions and velocities are displaced, and the column of each row, -1 without.

    It is one column, or, where forces are local, a joint's of the longest block and those of the
    joints of this number of all others.  Returns False for columns that come with others.
    """
    at, places = force_columns(data), chart_places(data)
    clear(direction)
    of_joint = at.positions <= column < at.states
    if not (differences.local and of_joint):
        for i in range(columns.size):
            columns[i] = column
        if column < at.states:
            direction[place_in_chart(at, places, column)] = 1.0
        return True
    first, longest = at.positions if column < at.rates else at.rates, 0
    for i in range(work.first_joint.size - 1):
        if (
            work.first_joint[i + 1] - work.first_joint[i]
            > work.first_joint[longest + 1] - work.first_joint[longest]
        ):
            longest = i
    number = column - first - work.first_joint[longest]
    if not 0 <= number < work.first_joint[longest + 1] - work.first_joint[longest]:
        return False
    for i in range(columns.size):
        columns[i] = -1
    for i in range(work.first_joint.size - 1):
        if number >= work.first_joint[i + 1] - work.first_joint[i]:
            continue
        moved = first + work.first_joint[i] + number
        direction[place_in_chart(at, places, moved)] = 1.0
        for j in range(work.first_joint[i], work.first_joint[i + 1]):
            columns[places.joints + j] = moved
        for s in range(model.state_joints.size):
            if work.first_joint[i] <= model.state_joints[s] < work.first_joint[i + 1]:
                columns[places.velocity + s] = moved
    return True
