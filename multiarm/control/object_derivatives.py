r"""Derivatives of the laws that move the object (:mod:`multiarm.control.object_control`).

What they command is differentiated here, by the pose and twist of the object, and what follows from
it in :mod:`multiarm.control.command_derivatives`.  With the rotation vector :math:`\theta` to the
reference, :math:`\exp\theta = R_r R_o^T`, a turn :math:`\delta` of the object gives

.. math:: d\theta = -J_r^{-1}(\theta)\,\delta = -J_l^{-1}(-\theta)\,\delta,

*computed torque* :math:`d\dot\omega_o = K\,d\theta - D\,d\omega_o` and the *impedance* the
moment :math:`d(J_l^{-1}(\theta) K\theta) - D\,d\omega_o`, with :math:`J_l^{-1}` of
:func:`multiarm.spatial.write_chart_rate`.

The accelerations of robots that hold their poses: :mod:`multiarm.control.null_space_derivatives`.
"""

from __future__ import annotations

import numpy as np

from multiarm.control.command_derivatives import (
    add_inverse_dynamics,
    add_motion_derivatives,
    begin_command,
    call_derivatives,
    differentiate_contact_forces,
    open_derivatives,
    subtract_passive_slopes,
)
from multiarm.control.null_space_derivatives import differentiate_holds
from multiarm.control.object_law import open_command, open_object_law
from multiarm.control.object_path import path_of, reference_pose
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.coordinates import block_columns, column_of_state, force_columns
from multiarm.dynamics.equation_derivatives import (
    add_object_equation,
    differentiate_bodies,
    open_equations,
    write_derivatives_at_rest,
    write_object,
)
from multiarm.dynamics.forces.compiled import CARRIED, pressing_wrench, write_multipliers
from multiarm.dynamics.solver.factors import norm
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.jit.kernels import allocating, cfunc, clear, copy, inlined, kernel
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import AXES, add_cross, put, scale, vec
from multiarm.spatial import rotation_between, write_chart_rate, write_chart_rate_slopes


@cfunc
def differentiate_command(address, size, at, t):
    """Call the derivative that has been prepared."""
    struct = struct_at(address, size)
    return call_derivatives(open_command(struct, at).derivatives, struct, at, t)


@cfunc
def write_computed_torque_derivatives(address, size, at, t):
    """Add the derivatives of the torques of computed torque; returns a status."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    derivatives = open_derivatives(command.derivatives)
    motion = open_equations(derivatives.motion)
    if not begin(law, command, data, work, derivatives):
        return SINGULAR
    for p in range(law.objects.size):
        differentiate_acceleration(t, law, p, data, derivatives.acceleration)
    inertia, acceleration = data.bodies.object_inertia, derivatives.acceleration
    for l in range(inertia.shape[0]):
        for k in range(acceleration.shape[0]):
            for c in range(acceleration.shape[1]):
                derivatives.wrench[l, c] += inertia[l, k] * acceleration[k, c]
    copy(data.state.joint_rates, motion.v)
    copy(command.a_j, motion.a_j)
    copy(data.rows.static_force, motion.force)
    twists, commanded = data.state.twists, command.acceleration
    for o in range(twists.shape[0]):
        write_object(o, data, twists[o], commanded[6 * o :], motion)
    status = differentiate_bodies(struct, derivatives.motion)
    for o in range(twists.shape[0]):
        add_object_equation(o, inertia, twists[o], commanded[6 * o :], motion)
    if status == OK:
        status = differentiate_torques(law, command, True, struct, model, data, work, derivatives)
        subtract_passive_slopes(data)
    return status


@cfunc
def write_object_impedance_derivatives(address, size, at, t):
    """Add the derivatives of the torques of the object impedance; returns a status."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    derivatives = open_derivatives(command.derivatives)
    motion = open_equations(derivatives.motion)
    if not begin(law, command, data, work, derivatives):
        return SINGULAR
    for p in range(law.objects.size):
        differentiate_spring_wrench(t, law, p, data, derivatives.wrench)
    copy(command.a_j, motion.a_j)
    copy(data.rows.static_force, motion.force)
    status = write_derivatives_at_rest(struct, derivatives.motion, motion.at_rest)
    if status == OK:
        status = differentiate_torques(law, command, False, struct, model, data, work, derivatives)
    return status


@kernel
def differentiate_torques(law, command, feedforward, struct, model, data, work, derivatives):
    """Add the derivatives of the torques, after those of the commanded motion; returns a status.

    ``feedforward`` as in :func:`multiarm.control.null_space.hold_poses`.
    """
    motion, excess = open_equations(derivatives.motion), open_equations(derivatives.excess)
    for c in range(law.wrenches_of_connections.shape[0]):
        status = differentiate_press(c, law, struct, model, data, work, derivatives)
        if status != OK:
            return status
    for j in range(command.a_j.size):
        excess.a_j[j] = command.a_j[j] - command.preferred[j]
    copy(command.multipliers, excess.force)
    status = write_derivatives_at_rest(struct, derivatives.excess, derivatives.twist)
    differentiate_contact_forces(data, work, motion, excess, derivatives)
    add_inverse_dynamics(data, work, motion)
    for i in range(work.first_joint.size - 1):
        n = work.first_joint[i + 1] - work.first_joint[i]
        if n == 0:  # the surroundings
            continue
        rates = block_columns(motion.dF_o.shape[0], n, 0).rates
        for j in range(n):
            clear(derivatives.preferred[j])
            derivatives.preferred[j, rates + j] = -law.free_rate
        if status == OK and law.free_stiffness > 0.0:
            status = differentiate_holds(
                i, law, command, feedforward, model, data, work, derivatives
            )
        if status == OK:
            status = add_motion_derivatives(data, work, i, motion, excess, derivatives)
    return status


@inlined
def begin(law, command, data, work, derivatives):
    """Write y without the internal forces, and clear the results; see :func:`begin_command`.

    Returns whether there is a closed form.
    """
    if not command.targets.independent:
        return False
    copy(data.control.object_wrench, derivatives.twist)
    for k in range(data.rows.W_o.shape[0]):
        subtract_wrench(data.rows.W_o[k], law.forces_of_contacts[k], derivatives.twist)
    subtract_presses(law, data, derivatives.twist)
    return begin_command(data, derivatives)


@inlined
def subtract_wrench(row, force, wrench):
    """Subtract the wrench of a contact force."""
    for l in range(row.size):
        wrench[l] -= row[l] * force


@allocating
def subtract_presses(law, data, wrench):
    """Subtract what the forces with which connections press put on the object."""
    world, y = np.zeros(wrench.size), np.empty(wrench.size)
    for c in range(law.wrenches_of_connections.shape[0]):
        if write_press(c, law, data, world):
            W_o = data.rows.W_o[data.rows.first[c] : data.rows.first[c + 1]]
            write_multipliers(W_o, world, y)
            for k in range(W_o.shape[0]):
                subtract_wrench(W_o[k], force_of(W_o[k], y), wrench)


@inlined
def write_press(c, law, data, world):
    """Write the wrenches (6 F,) with which connection ``c`` presses; returns whether it does."""
    o, of_connection = law.pressed[c], law.wrenches_of_connections[c]
    clear(world)
    return pressing_wrench(data.bodies.objects[o], of_connection, world[6 * o : 6 * o + 6])


@inlined
def force_of(row, y):
    """The force ``W_o^T y`` of one contact."""
    force = 0.0
    for l in range(row.size):
        force += row[l] * y[l]
    return force


@allocating
def differentiate_press(owner, law, struct, model, data, work, derivatives):
    r"""Write the derivatives of the forces with which a connection presses; returns a status.

    They are :math:`\lambda = W_o^+ w` of its contacts, :math:`\lambda = W_o^T y`, so that
    :math:`d\lambda = \partial(W_o^T y) + W_o^+ (dw - \partial(W_o\lambda)
    - W_o\,\partial(W_o^T y))`, where these carry the wrench; ``SINGULAR`` elsewhere.
    """
    excess, node = open_equations(derivatives.excess), data.control.object_wrench.size
    world, y, left = np.empty(node), np.empty(node), np.empty(node)
    if not write_press(owner, law, data, world):
        return OK
    at = 6 * law.pressed[owner]
    r0, r1, i = data.rows.first[owner], data.rows.first[owner + 1], model.connections.block[owner]
    W_o, d0 = data.rows.W_o[r0:r1], work.first_joint[i]
    write_multipliers(W_o, world, y)
    clear(excess.a_j)
    clear(excess.force)
    copy(world, left)
    for k in range(r1 - r0):
        excess.force[r0 + k] = force_of(W_o[k], y)
        subtract_wrench(W_o[k], excess.force[r0 + k], left)
    for l in range(left.size):
        if not abs(left[l]) <= CARRIED * (abs(world[l]) + norm(world, node)):
            return SINGULAR
    status = write_derivatives_at_rest(struct, derivatives.excess, y)
    of_block, columns = block_columns(node, work.first_joint[i + 1] - d0, 0), force_columns(data)
    for c in range(of_block.rates):
        if of_block.twists <= c < of_block.positions:
            continue
        column = column_of_state(columns, of_block, d0, c)
        for l in range(left.size):
            left[l] = excess.dF_o[l, column]
        if at + 3 <= c < at + 6:
            axis = AXES[c - at - 3]
            put(left, at, add_cross(vec(left, at), axis, vec(world, at)))
            put(left, at + 3, add_cross(vec(left, at + 3), axis, vec(world, at + 3)))
        for k in range(r1 - r0):
            subtract_wrench(W_o[k], excess.rates[r0 + k, c], left)
        write_multipliers(W_o, left, y)
        for k in range(r1 - r0):
            derivatives.desired[r0 + k, column] = excess.rates[r0 + k, c] + force_of(W_o[k], y)
    return status


@allocating
def differentiate_acceleration(t, law, p, data, acceleration):
    """Write the derivatives of a commanded acceleration by the object's pose and twist."""
    twists, first = force_columns(data).twists, 6 * law.objects[p]
    _, quaternion, _, _, _, _ = reference_pose(t, path_of(law, p))
    quaternion_now, by_turn = data.state.poses[law.objects[p]][3:7], np.empty((3, 3))
    differentiate_turn(rotation_between(quaternion_now, quaternion), by_turn)
    for k in range(3):
        row, turn = first + k, first + 3 + k
        acceleration[row, row] = -law.stiffness[k]
        acceleration[row, twists + row] = -law.damping[k]
        for axis in range(3):
            acceleration[turn, first + 3 + axis] = law.stiffness[3 + k] * by_turn[axis, k]
        acceleration[turn, twists + turn] = -law.damping[3 + k]


@allocating
def differentiate_spring_wrench(t, law, p, data, wrench):
    """Write the derivatives of the wrench of the impedance's spring and damper into ``wrench``."""
    twists, first = force_columns(data).twists, 6 * law.objects[p]
    _, quaternion, _, _, _, _ = reference_pose(t, path_of(law, p))
    quaternion_now = data.state.poses[law.objects[p]][3:7]
    turned, by_turn = rotation_between(quaternion_now, quaternion), np.empty((3, 3))
    differentiate_turn(turned, by_turn)
    pull, change, of_change, slopes = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    for k in range(3):
        pull[k] = law.stiffness[3 + k] * turned[k]
        row, turn = first + k, first + 3 + k
        wrench[row, row], wrench[row, twists + row] = -law.stiffness[k], -law.damping[k]
        wrench[turn, twists + turn] = -law.damping[3 + k]
    write_chart_rate_slopes(turned, pull, slopes)
    for axis in range(3):
        for k in range(3):
            change[k] = law.stiffness[3 + k] * by_turn[axis, k]
        write_chart_rate(turned, change, of_change)
        for r in range(3):
            wrench[first + 3 + r, first + 3 + axis] = of_change[r]
            for k in range(3):
                wrench[first + 3 + r, first + 3 + axis] += slopes[k, r] * by_turn[axis, k]


@kernel
def differentiate_turn(turned, by_turn):
    """Write the derivatives of the rotation vector to the reference, a row for each turn (3, 3)."""
    back = scale(-1.0, turned)
    for axis in range(3):
        write_chart_rate(back, scale(-1.0, AXES[axis]), by_turn[axis])
