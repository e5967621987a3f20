r"""The equations of motion of a compiled scene, evaluated in compiled code.

.. math::
    M_i \ddot q_i = f_i + W_i \lambda_i, \qquad
    M_o \dot v_o = f_o + \sum_i W_{oi} \lambda_i, \qquad
    W_{oi}^T \dot v_o + W_i^T \ddot q_i = c_i

(thesis, 4.9; blocks ``i``, object ``o``, contact forces :math:`\lambda`).  An evaluation has three
parts, all in world axes:

.. code-block:: text

    kinematics        positions, velocities -> M, b, J of blocks and object -> W_o, W, c, phi
    right_hand_sides  control, effects -> f_j, c
    solve             node algorithm -> accelerations, contact forces

The arrays are those of :mod:`multiarm.dynamics.variables`.  The parts are called by address.  So
each is compiled once, and scenes with unilateral contacts can replace the solution.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import open_contact, write_row
from multiarm.contacts.table import is_in_closed_form, open_code
from multiarm.dynamics.arrays import (
    call_listed,
    open_coupled,
    open_data,
    open_system,
)
from multiarm.dynamics.kinematics import (
    block_terms,
    constraint_matrices,
    contact_rows,
    load_inertia,
    load_inertias,
    object_terms,
)
from multiarm.dynamics.residuals import imbalance
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.dynamics.solver.node import NODE, eliminate_blocks
from multiarm.dynamics.solver.singular import (
    couple,
    lever_length,
    rank_tolerance,
    solve_coupled,
)
from multiarm.dynamics.solver.solution import SPLIT, WHOLE, write_solution
from multiarm.dynamics.status import CALLBACK_FAILED, NOT_FINITE, OBJECT_INERTIA, OK
from multiarm.jit.kernels import INTS, NUMBER, cfunc, clear, inlined, kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.jit.structs import floats_at, referenced, struct_at
from multiarm.robots.compiled.tables import energy_of_robots
from multiarm.robots.terms import open_addresses


@kernel
def evaluate_state(struct: INTS, alpha: NUMBER, beta: NUMBER):
    """Accelerations and contact forces at the state in ``data``; returns a status.

    Calls :func:`kinematics`, :func:`right_hand_sides` and :func:`solve`, or what replaces them.
    Reads time and state, those of effects too, and torques that are held; writes the terms of the
    equations and their solution.  ``alpha`` [1/s] and ``beta`` [1/s] are the gains of the drift
    feedback (0: none).
    """
    status = write_equations(struct, alpha, beta)
    if status == OK:
        status = call_cfunc(open_data(struct).functions.solve, struct, 0.0, 0.0)
    return status


@kernel
def evaluate_projected(struct: INTS, alpha: NUMBER, beta: NUMBER):
    """:func:`evaluate_state` right after its velocities have been projected.

    The configuration is the same: blocks that were eliminated by directions keep their factors.
    """
    status, data = write_equations(struct, alpha, beta), open_data(struct)
    if status != OK:
        return status
    functions = data.functions
    solver = functions.solve_again if keeps_factors(data) else functions.solve
    return call_cfunc(solver, struct, 0.0, 0.0)


@kernel
def keeps_factors(data):
    """Whether the factors of the last projection are those of an evaluation that follows.

    In a mode they are not: its solution adds forces that are given, and friction.
    """
    return data.solution.elimination == SPLIT and not data.modes.active


@kernel
def write_equations(struct: INTS, alpha: NUMBER, beta: NUMBER):
    """Write the terms of the equations at the state in ``data``; returns a status."""
    functions = open_data(struct).functions
    status = call_cfunc(functions.kinematics, struct, 0.0, 0.0)
    if status == OK:
        status = call_cfunc(functions.forces, struct, alpha, beta)
    return status


@kernel
def update_kinematics(struct: INTS):
    """Terms of blocks and object, and all contact rows, at the state in ``data``.

    Writes the inertias to ``work.M``, but for those of blocks with factors, and the blocks' rows to
    ``work.W``.  Returns ``OK`` or ``CALLBACK_FAILED``.
    """
    return call_cfunc(open_data(struct).functions.kinematics, struct, 0.0, 0.0)


@kernel
def write_inertias(struct: INTS):
    """Write the inertias of all blocks, at the last terms of the robots, to ``work.M``."""
    _, data, work = open_system(struct)
    load_inertias(data, work)


@kernel
def solve_frictionless(struct: INTS, gap: NUMBER):
    """Solve for ``a_o, a_j, force`` with the right-hand sides ``f_o, f_j, c`` in ``data``.

    Contact forces act along their normals, without friction, as projections need.  Call
    :func:`update_kinematics` before.  ``gap`` is the largest one [m] that the solution closes, 0
    where it closes none.  Returns a status.
    """
    return call_cfunc(open_data(struct).functions.solve_frictionless, struct, gap, 0.0)


@cfunc
def kinematics(address, size, _a, _b):
    """Compute what :func:`update_kinematics` describes."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    block_terms(model, data)
    if data.status.failed:
        return CALLBACK_FAILED
    object_terms(model, data)
    contact_rows(struct, model, data, work)
    constraint_matrices(model, data, work)
    for i in range(data.bodies.pointers.shape[0]):
        load_inertia(i, data, work)
    # a user-defined surface may have failed
    return CALLBACK_FAILED if data.status.failed else OK


@cfunc
def right_hand_sides(address, size, alpha, beta):
    """Forces ``f_j, f_o`` from bias, control and effects, and ``c`` with feedback on the drift.

    Returns ``OK``, ``CALLBACK_FAILED`` or ``KERNEL_FAILED``.
    """
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    clear(data.effects.power)
    status, power = passive_forces(struct, model, data, work), 0.0
    if status == OK and model.control.shape[0] > 0:
        status = command_torques(struct, model, data, work)
        clear_undriven(model, data)
        if status == OK:
            status = call_effects(model.passive_end, model.actuator_end, struct, model, data)
        power = add_torques(model, data)
    if status == OK:
        status = applied_forces(struct, model, data, power)
    if status != OK:
        return status
    drift_terms(data, alpha, beta)
    return CALLBACK_FAILED if data.status.failed else OK


@inlined
def clear_undriven(model, data):
    """Joints without drives get no torque, whatever a law writes."""
    for u in range(model.undriven.size):
        data.control.torque[model.undriven[u]] = 0.0


@inlined
def command_torques(struct, model, data, work):
    """Let the control laws write ``data.control.torque``; returns a status."""
    if data.modes.active:
        return call_cfunc(data.functions.command, struct, 0.0, 0.0)
    load_gravity_torque(data, work)
    return control_torques(struct, model.control.shape[0], model, data)


@cfunc
def control_of_closed(address, size, _a, _b):
    """Let the laws write ``data.control.torque`` as if all contacts of the joints were closed.

    Returns a status.
    """
    data = open_data(struct_at(address, size))
    of_laws = referenced(data.modes.of_laws)
    model, of_closed, work = open_system(of_laws)
    contact_rows(of_laws, model, of_closed, work)
    constraint_matrices(model, of_closed, work)
    load_inertias(of_closed, work)
    load_gravity_torque(of_closed, work)
    return control_torques(of_laws, model.control.shape[0], model, of_closed)


@inlined
def passive_forces(struct, model, data, work):
    """``f_j = -b`` and the passive effects of the joints; returns a status."""
    for i in range(data.bodies.pointers.shape[0]):
        d0, d = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        bias = floats_at(open_addresses(data.bodies.pointers[i]).bias, d)
        for j in range(d):
            data.forces.f_j[d0 + j] = -bias[j]
    return call_effects(0, model.passive_end, struct, model, data)


@inlined
def load_gravity_torque(data, work):
    """Copy the joints' gravity forces, which backends compute only for control that needs them."""
    for i in range(data.bodies.pointers.shape[0]):
        d0, d = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        g = floats_at(open_addresses(data.bodies.pointers[i]).gravity_torque, d)
        for j in range(d):
            data.control.gravity_torque[d0 + j] = g[j]


@inlined
def control_torques(struct, laws, model, data):
    """Let a number of control laws write ``data.control.torque``; returns a status."""
    clear(data.control.torque)
    status = OK
    for k in range(laws):
        if status == OK:
            status = call_listed(model.control, k, struct, data)
    return status


@inlined
def add_torques(model, data):
    r"""Add the control torques, changed by the actuators, to ``f_j``, and write the robots' powers.

    That of a robot is :math:`P_i = \tau_i \cdot \dot q_i`; returns their sum [W].
    """
    total = 0.0
    for i in range(data.control.power.size):
        power = 0.0
        for j in range(model.first_joint[i], model.first_joint[i + 1]):
            data.forces.f_j[j] += data.control.torque[j]
            power += data.control.torque[j] * data.state.joint_rates[j]
        data.control.power[i] = power
        total += power
    return total


@inlined
def applied_forces(struct, model, data, power):
    """Add the external loads, and write the total power; returns a status.

    ``power`` [W] is that of the control.
    """
    status = call_effects(model.actuator_end, model.applied_end, struct, model, data)
    last = data.effects.power.size - 1
    for k in range(last):
        power += data.effects.power[k]
    data.effects.power[last] = power
    return status


@inlined
def call_effects(first, end, struct, model, data):
    """Call the effects of one phase, rows ``first`` to ``end`` of ``Constants.effects``.

    Returns a status.
    """
    status = OK
    for k in range(first, end):
        if status == OK:
            status = call_listed(model.effects, k, struct, data)
    return status


@inlined
def drift_terms(data, alpha, beta):
    """``c = -phi''|_0 - 2 alpha phi' - beta^2 phi`` (thesis, 4.3 and Example 4.2)."""
    for k in range(data.rows.c.size):
        row = open_contact(data.rows.kinematics[k])
        data.rows.c[k] = -(row.gap_bias + 2.0 * alpha * row.gap_rate + beta * beta * row.gap)


@cfunc
def solve(address, size, gap, _b):
    """Solve for one object as :func:`solve_frictionless` describes.

    Four blocks at a time; else block by block.
    """
    return solve_node_of(NODE, struct_at(address, size), gap)


@cfunc
def solve_several(address, size, gap, _b):
    """:func:`solve` for any number of objects."""
    struct = struct_at(address, size)
    return solve_node_of(open_data(struct).accelerations.a_o.size, struct, gap)


@inlined
def solve_node_of(node, struct, gap):
    """:func:`solve` for a number of unknowns of the node, which is best a constant."""
    model, data, work = open_system(struct)
    if model.dense:
        return call_dense_solver(data.functions.dense, data, data.rows.W_o, gap)
    rows, forces, accelerations = data.rows, data.forces, data.accelerations
    result = solve_batched(
        work, rows.W_o, data.bodies.object_inertia, forces.f_o, forces.f_j, rows.c,
        accelerations.a_o, accelerations.a_j, rows.force, node,
    )  # fmt: skip
    if result == OK:
        write_solution(data, WHOLE, 0, 0, math.inf, 1)
        data.solution.imbalance = imbalance(data, data.rows.W_o)
        if data.solution.imbalance <= IMBALANCE_BOUND:
            return OK
    return call_cfunc(data.functions.coupled, struct, gap, 0.0)


@kernel
def call_dense_solver(function, data, W_o, gap):
    """Solve by the dense solver at an address; forces act along ``W_o`` (N, 6 F).

    ``gap`` [m] as in :func:`solve_frictionless`.  Returns a status.
    """
    data.dense.tolerance = rank_tolerance(gap, lever_length(W_o))
    call_python(function)
    data.solution.imbalance = imbalance(data, W_o)
    return CALLBACK_FAILED if data.status.failed else data.dense.status


@cfunc
def solve_deficient(address, size, gap, _b):
    """Solve a system with deficient blocks, block by block; returns a status.

    Where the residual of the object's equation is too large, no block is eliminated as a whole.
    """
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    status = solve_coupled_blocks(data, work, open_coupled(struct), False, gap)
    if status != OK or data.solution.imbalance <= IMBALANCE_BOUND:
        return status
    if data.solution.coupled_blocks == data.bodies.pointers.shape[0]:
        return status
    return call_cfunc(data.functions.decomposed, struct, gap, 0.0)


@cfunc
def solve_again(address, size, _a, _b):
    """Solve with the factors of the last solution, which eliminated some blocks by directions.

    Returns a status.
    """
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    solve_factored(data, work, open_coupled(struct))
    if data.solution.imbalance <= IMBALANCE_BOUND:
        return OK
    return call_cfunc(data.functions.coupled, struct, 0.0, 0.0)


@cfunc
def solve_decomposed(address, size, gap, _b):
    """Solve a system with no block eliminated as a whole; returns a status."""
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    return solve_coupled_blocks(data, work, open_coupled(struct), True, gap)


@kernel
def solve_coupled_blocks(data, work, coupled, decompose_all, gap):
    """Eliminate and couple all blocks at the kinematics in ``data``; returns a status."""
    complete_inertias(work)
    status, data.status.block = eliminate_blocks(work, data.rows.W_o)
    if status != OK:
        return status
    inertia = data.bodies.object_inertia
    pivot = couple(work, coupled, data.rows.W_o, inertia, decompose_all, gap)
    work.pivot[data.bodies.pointers.shape[0]] = pivot
    if not pivot > 0.0:
        return OBJECT_INERTIA if pivot == pivot else NOT_FINITE
    write_coupled_solution(data, coupled)
    solve_factored(data, work, coupled)
    return OK


@kernel
def solve_factored(data, work, coupled):
    """Solve for the right-hand sides in ``data`` with the factors of coupled blocks."""
    rows, forces, accelerations = data.rows, data.forces, data.accelerations
    solve_coupled(
        work, coupled, forces.f_o, forces.f_j, rows.c,
        accelerations.a_o, accelerations.a_j, rows.force,
    )  # fmt: skip
    data.solution.imbalance = imbalance(data, rows.W_o)


@inlined
def write_coupled_solution(data, coupled):
    """What the solver of deficient blocks has found out; all blocks may turn out to be regular."""
    status = coupled.status
    if status.blocks == 0:
        write_solution(data, WHOLE, 0, 0, math.inf, 1)
        return
    for i in range(data.deficient.coupled.size):
        data.deficient.coupled[i] = coupled.deficient[i]
    write_solution(data, SPLIT, status.blocks, status.unknowns - status.rank, status.margin, 1)


@kernel
def update_rows(struct: INTS):
    """Contact rows alone; the motion of the bodies is that of a Data which shares it.

    Returns ``OK`` or ``CALLBACK_FAILED``.
    """
    model, data, work = open_system(struct)
    contact_rows(struct, model, data, work)
    constraint_matrices(model, data, work)
    return CALLBACK_FAILED if data.status.failed else OK


@cfunc
def write_general_rows(address, size, _a, _b):
    """Write the rows of all connections that are not in closed form, after those that are."""
    model, data, _ = open_system(struct_at(address, size))
    rows, contacts, motion = data.rows, model.contacts, data.bodies.motion
    for c in range(model.connections.block.size):
        first, second = motion[model.connections.first[c]], motion[model.connections.second[c]]
        for k in range(rows.first[c], rows.first[c + 1]):
            if not is_in_closed_form(open_code(contacts.codes[k]).kind):
                write_row(k, first, second, contacts, rows.kinematics, rows.parts, data.search)
    return OK


@kernel
def potential_energy(struct: INTS):
    """Potential energy of robots and objects [J] at the last state, zero at the origin."""
    model, data, _ = open_system(struct)
    functions, energy = data.functions, 0.0
    for k in range(3):
        for o in range(data.state.poses.shape[0]):
            energy -= model.object_masses[o] * model.gravity[k] * data.state.poses[o, k]
    if functions.robots != 0:
        robots = struct_at(functions.robots_struct, functions.robots_size)
        energy += energy_of_robots(robots)
    if functions.pinocchio_energy != 0:
        call_python(functions.pinocchio_energy)
        energy += data.status.potential_energy
    return energy


@kernel
def finite(vector):
    """Whether all entries are finite."""
    for i in range(vector.size):  # noqa: SIM110  compiled code has no generators
        if not math.isfinite(vector[i]):
            return False
    return True
