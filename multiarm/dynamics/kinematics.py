r"""From joint positions and the object's pose to motions, inertias and the rows of W.

First the terms of all robots, with the motion of the links that carry their tips; then the
object's; then the contacts of every connection.  The results are in
:mod:`multiarm.dynamics.variables`, in world axes.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.contacts.joint import write_relative
from multiarm.contacts.kernel import open_contact, write_rows_in_closed_form
from multiarm.contacts.motion import open_body
from multiarm.contacts.table import WHEELS, open_joint
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.dynamics.solver.node import NodeWork
from multiarm.jit.kernels import copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.jit.simd import LANES, broadcast, load_pack, store_pack
from multiarm.jit.structs import floats_at, struct_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    cross,
    dot,
    put,
    rotate,
    rotate_symmetric,
    scale,
    sub,
    times,
    vec,
)
from multiarm.robots.joined import copy_matrices
from multiarm.robots.terms import (
    POSE_WIDTH,
    open_addresses,
    open_link_addresses,
    open_pose,
)
from multiarm.spatial import rotation_of, write_matrix


@inlined
def fill_configuration(model, data):
    """Write Pinocchio's configuration from the positions of its robots' joints and bases."""
    for j in range(data.state.joint_positions.size):
        slot = model.q_slots[j]
        if slot < 0:
            continue
        if model.circular[j] != 0:
            data.bodies.pinocchio_configuration[slot] = np.cos(data.state.joint_positions[j])
            data.bodies.pinocchio_configuration[slot + 1] = np.sin(data.state.joint_positions[j])
        else:
            data.bodies.pinocchio_configuration[slot] = data.state.joint_positions[j]
    for b in range(data.state.floating_bases.size):
        slot = model.floating_bases.slot[b]
        if slot < 0:
            continue
        for k in range(7):
            data.bodies.pinocchio_configuration[slot + k] = data.state.base_poses[b, k]
    if data.state.floating_bases.size > 0:
        fill_velocity(data)


@kernel
def fill_velocity(data):
    """Write Pinocchio's velocity, where there are floating bases."""
    rates, v = data.state.joint_rates, data.bodies.pinocchio_velocity
    copy(rates, v)
    for b in range(data.state.floating_bases.size):
        (x, y, z), omega = (
            rotation_of(data.state.base_poses[b, 3:7]),
            vec(rates, data.state.floating_bases[b] + 3),
        )
        put(v, data.state.floating_bases[b] + 3, (dot(x, omega), dot(y, omega), dot(z, omega)))


@kernel
def turn_base_terms(b, model, data):
    r"""Write what Pinocchio has of a floating base in world axes, where it stands.

    Pinocchio's base slides along world axes, then turns with an angular velocity in its own:
    :math:`\omega = R\,\omega_b` and :math:`\dot\omega = R\,\dot\omega_b`.  So rows and columns of
    the inertia, and entries of the bias and of gravity's forces, are turned by R, and columns of
    the Jacobian by :math:`R^T` from the right.  Of the symmetric inertia the lower triangle is
    filled.
    """
    i, R = model.floating_bases.robot[b], rotation_of(data.state.base_poses[b, 3:7])
    d = model.first_joint[i + 1] - model.first_joint[i]
    addresses = open_addresses(data.bodies.base_pointers[b])
    stride = addresses.stride
    x, y, z = 3 * stride, 4 * stride, 5 * stride  # rows of the angular velocity
    M, bias = floats_at(addresses.inertia, d * stride), floats_at(addresses.bias, d)
    J = floats_at(addresses.jacobian, 6 * d)
    gravity_torque = floats_at(addresses.gravity_torque, d)
    put(bias, 3, rotate(R, vec(bias, 3)))
    put(gravity_torque, 3, rotate(R, vec(gravity_torque, 3)))
    for c in range(3):  # columns of the base's shift
        M[x + c], M[y + c], M[z + c] = rotate(R, (M[x + c], M[y + c], M[z + c]))
    lower = M[x + 3], M[y + 3], M[z + 3], M[y + 4], M[z + 4], M[z + 5]
    M[x + 3], M[y + 3], M[z + 3], M[y + 4], M[z + 4], M[z + 5] = rotate_symmetric(R, lower)
    for r in range(6, d):
        put(M, r * stride + 3, rotate(R, vec(M, r * stride + 3)))
    for k in range(6):
        J[18 + k], J[24 + k], J[30 + k] = rotate(R, (J[18 + k], J[24 + k], J[30 + k]))


@inlined
def block_terms(model, data):
    """All terms of the robots, and the motion of the links that carry their tips."""
    functions = data.functions
    if functions.robots != 0:
        robots = struct_at(functions.robots_struct, functions.robots_size)
        call_cfunc(functions.robots, robots, 0.0, 0.0)
    if functions.pinocchio != 0:
        fill_configuration(model, data)
        call_python(functions.pinocchio)
        for b in range(data.state.floating_bases.size):
            if model.floating_bases.slot[b] >= 0:
                turn_base_terms(b, model, data)
    copy_matrices(data.bodies.copies)
    for l in range(data.bodies.link_pointers.shape[0]):
        addresses = open_link_addresses(data.bodies.link_pointers[l])
        if addresses.twist != 0:
            link_motion(addresses, model.gravity, open_body(data.bodies.links[l]))


@inlined
def object_terms(model, data):
    """Pose, motion, inertia ``blkdiag(m I, R I R^T)`` and bias of the objects (thesis, 3.2)."""
    inertia = data.bodies.object_inertia
    for o in range(data.state.poses.shape[0]):
        body, mass, at = open_body(data.bodies.objects[o]), model.object_masses[o], 6 * o
        pose, twist = data.state.poses[o], data.state.twists[o]
        write_matrix(pose[3:7], data.bodies.objects[o])
        R, omega = body.rotation, vec(twist, 3)
        A = model.object_inertias[o]
        I = rotate_symmetric(R, (A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]))
        body.origin, body.spin, body.velocity = vec(pose, 0), omega, vec(twist, 0)
        for k in range(3):
            inertia[at + k, at + k] = mass
        put(inertia[at + 3], at + 3, I[0:3])
        put(inertia[at + 4], at + 3, (I[1], I[3], I[4]))
        put(inertia[at + 5], at + 3, (I[2], I[4], I[5]))
        put(data.forces.f_o, at, scale(mass, vec(model.gravity, 0)))
        put(data.forces.f_o, at + 3, cross(times(I, omega), omega))


@inlined
def link_motion(addresses, gravity, body):
    """Motion of a link that carries a tip, in world axes, from Pinocchio's own arrays.

    Pinocchio gives twist and spatial acceleration in link axes, the latter minus gravity;
    the classical acceleration of the origin is ``a + omega x v``.
    """
    pose = open_pose(floats_at(addresses.pose, POSE_WIDTH))
    twist = floats_at(addresses.twist, 6)
    drift = floats_at(addresses.drift, 6)
    R = pose.axes
    v, omega = vec(twist, 0), vec(twist, 3)
    a, alpha = add_cross(vec(drift, 0), omega, v), vec(drift, 3)
    a = add(rotate(R, a), vec(gravity, 0))
    body.rotation, body.origin = R, pose.origin
    body.velocity, body.spin = rotate(R, v), rotate(R, omega)
    body.acceleration, body.spin_rate = a, rotate(R, alpha)


@inlined
def contact_rows(struct, model, data, work):
    """Contact kinematics of all rows; ``model, data, work`` are the views of ``struct``."""
    bodies, pairs, first, complete = data.bodies, model.connections, data.rows.first, True
    for c in range(pairs.block.size):
        complete &= write_rows_in_closed_form(
            first[c], first[c + 1], bodies.motion[pairs.first[c]], bodies.motion[pairs.second[c]],
            model.contacts, bodies.relative, data.rows.packs, data.rows.kinematics,
        )  # fmt: skip
    if not complete:
        call_cfunc(data.functions.general_rows, struct, 0.0, 0.0)


@inlined
def constraint_matrices(model, data, work):
    """Rows of ``W_o``, and ``W`` of every block, from the kinematics of the contacts."""
    links, pairs = data.bodies.links.shape[0], model.connections
    for c in range(pairs.block.size):
        if pairs.serial[c]:
            rows_of_serial_block(c, model, data, work)
        elif pairs.first[c] < links <= pairs.second[c] and rows_of(c, data) >= LANES:
            rows_of_link(c, model, data, work)
        else:
            rows_of_connection(c, model, data, work)
    write_joint_rows(model, data, work)


@inlined
def rows_of_serial_block(c, model, data, work):
    """``W_o`` and ``W`` of a connection of a link that all joints of its block move."""
    i = model.connections.block[c]
    d = work.first_joint[i + 1] - work.first_joint[i]
    first = data.rows.first[c]
    m, before = data.rows.first[c + 1] - first, first - work.first_contact[i]
    bodies, second = data.bodies, model.connections.second[c]
    o = object_of(second, data)
    J = floats_at(open_addresses(bodies.pointers[i]).jacobian, 6 * d)  # column by column
    x_o, W, wrench = open_body(bodies.motion[second]).origin, work.W[i], data.rows.block_wrenches
    for k in range(m):
        row = open_contact(data.rows.kinematics[first + k])
        e, p, couple = row.normal, row.point, row.couple
        if o >= 0:
            write_object_row(row, x_o, data.rows.W_o[first + k], 6 * o)
        # the robot takes the opposite wrench; its Jacobian is about the world's origin
        force, moment = scale(-1.0, e), sub(cross(e, p), couple)
        if m < LANES:
            for j in range(d):
                W[j, before + k] = dot(vec(J, 6 * j), force) + dot(vec(J, 6 * j + 3), moment)
        else:
            wrench[0, k], wrench[1, k], wrench[2, k] = force
            wrench[3, k], wrench[4, k], wrench[5, k] = moment
    if m < LANES:
        return
    k = 0
    while k < m:
        k = min(k, m - LANES)  # the last four may overlap those before
        write_four_columns(i, before, k, d, J, wrench, work)
        k += LANES


@inlined
def rows_of(c, data):
    """Number of rows of a connection."""
    return data.rows.first[c + 1] - data.rows.first[c]


@kernel
def rows_of_link(c, model, data, work):
    """``W_o`` and ``W`` of a connection of a link with an object or the world, in SIMD packs.

    Entries of W of joints that do not move the link are never written: they are zero.
    """
    i, link, second = (
        model.connections.block[c],
        model.connections.first[c],
        model.connections.second[c],
    )
    d = work.first_joint[i + 1] - work.first_joint[i]
    first, m, o = data.rows.first[c], rows_of(c, data), object_of(second, data)
    J = floats_at(open_addresses(data.bodies.pointers[i]).jacobian, 6 * d)
    x_o, wrench = open_body(data.bodies.motion[second]).origin, data.rows.block_wrenches
    for k in range(m):
        row = open_contact(data.rows.kinematics[first + k])
        if o >= 0:
            write_object_row(row, x_o, data.rows.W_o[first + k], 6 * o)
        wrench[0, k], wrench[1, k], wrench[2, k] = scale(-1.0, row.normal)
        wrench[3, k], wrench[4, k], wrench[5, k] = sub(cross(row.normal, row.point), row.couple)
    N, W, chain = wrench.shape[1], work.W, model.links.chain[link]
    block = i * W.shape[1] * W.shape[2] + first - work.first_contact[i]
    k = 0
    while k < m:
        k = min(k, m - LANES)  # the last four may overlap those before
        forces = load_pack(wrench, k), load_pack(wrench, N + k), load_pack(wrench, 2 * N + k)
        moments = (
            load_pack(wrench, 3 * N + k),
            load_pack(wrench, 4 * N + k),
            load_pack(wrench, 5 * N + k),
        )
        for l in range(model.links.length[link]):
            j = chain[l]
            store_pack(W, block + k + j * W.shape[2], four_entries(J, 6 * j, forces, moments))
        k += LANES


@inlined
def four_entries(J, at, forces, moments):
    """Powers of four wrenches at a column of a Jacobian."""
    a = broadcast(J[at]) * forces[0] + broadcast(J[at + 1]) * forces[1]
    b = broadcast(J[at + 3]) * moments[0] + broadcast(J[at + 4]) * moments[1]
    a = a + broadcast(J[at + 2]) * forces[2]
    return a + (b + broadcast(J[at + 5]) * moments[2])


@inlined
def object_of(body, data):
    """The object that a body is; -1 for a link and for the world."""
    o = body - data.bodies.links.shape[0]
    return o if o < data.bodies.objects.shape[0] else -1


@inlined
def write_object_row(row, x_o, W_o, at):
    """Write ``[e; (P - x_o) x e]`` into a row of ``W_o``; ``x_o`` is the centre of mass."""
    put(W_o, at, row.normal)
    put(W_o, at + 3, add(cross(sub(row.point, x_o), row.normal), row.couple))


@kernel
def rows_of_connection(c, model, data, work):
    """``W_o`` and ``W`` of a connection of any two bodies."""
    pairs, links, motion = model.connections, data.bodies.links.shape[0], data.bodies.motion
    first, second = pairs.first[c], pairs.second[c]
    against, pushed = object_of(first, data), object_of(second, data)
    for k in range(data.rows.first[c], data.rows.first[c + 1]):
        column = k - work.first_contact[pairs.block[c]]
        row, W_o = open_contact(data.rows.kinematics[k]), data.rows.W_o[k]
        if pushed >= 0:
            write_object_row(row, open_body(motion[second]).origin, W_o, 6 * pushed)
        if against >= 0:
            write_object_row(row, open_body(motion[first]).origin, W_o, 6 * against)
            for l in range(6 * against, 6 * against + 6):
                W_o[l] *= -1.0
        clear_column(pairs.block[c], column, work)
        if first < links:
            add_link_column(first, k, column, -1.0, model, data, work)
        if second < links:
            add_link_column(second, k, column, 1.0, model, data, work)


@inlined
def clear_column(i, column, work):
    """Set a column of ``W`` of block ``i`` to zero."""
    for j in range(work.first_joint[i + 1] - work.first_joint[i]):
        work.W[i, j, column] = 0.0


@inlined
def add_link_column(link, k, column, sign, model, data, work):
    """Add what the force of row ``k``, times a sign, does on a link to a column of ``W``."""
    i, row = model.links.block[link], open_contact(data.rows.kinematics[k])
    d = work.first_joint[i + 1] - work.first_joint[i]
    J = floats_at(open_addresses(data.bodies.pointers[i]).jacobian, 6 * d)
    force = scale(sign, row.normal)
    moment = scale(sign, add(cross(row.point, row.normal), row.couple))
    for l in range(model.links.length[link]):
        j = model.links.chain[link, l]
        work.W[i, j, column] += dot(vec(J, 6 * j), force) + dot(vec(J, 6 * j + 3), moment)


@inlined
def write_four_columns(i, before, k, d, J, wrench, work):
    """Four columns of ``W``, contacts ``k`` to ``k + 3`` of one connection, in SIMD packs.

    ``before`` is the number of contacts of the block that stand before this connection's.
    """
    N, W = wrench.shape[1], work.W
    forces = load_pack(wrench, k), load_pack(wrench, N + k), load_pack(wrench, 2 * N + k)
    moments = (
        load_pack(wrench, 3 * N + k),
        load_pack(wrench, 4 * N + k),
        load_pack(wrench, 5 * N + k),
    )
    at = i * W.shape[1] * W.shape[2] + before + k
    for j in range(d):
        store_pack(W, at, four_entries(J, 6 * j, forces, moments))
        at += W.shape[2]


@inlined
def write_connection_motion(model, data, c, rates, coordinates):
    """Write the relative motion of the bodies of connection ``c``: (6,) rates, (9,) coordinates.

    See :func:`multiarm.contacts.joint.write_relative`.
    """
    pairs, motion = model.connections, data.bodies.motion
    first, second = motion[pairs.first[c]], motion[pairs.second[c]]
    write_relative(model.joint_frames[c], first, second, rates, coordinates)


@inlined
def write_joint_rows(model, data, work):
    """Rows that belong to joints: their gaps, and their columns of ``W``."""
    joint_rows = model.joint_rows
    for k in range(joint_rows.row.size):
        if joint_rows.kind[k] == WHEELS:
            write_wheels(k, model, data, work)
            continue
        i, row, joint = joint_rows.block[k], joint_rows.row[k], joint_rows.joint[k]
        geometry = open_joint(model.contacts.geometry[row])
        contact = open_contact(data.rows.kinematics[row])
        side, column = geometry.side, row - work.first_contact[i]
        position, rate = data.state.joint_positions[joint], data.state.joint_rates[joint]
        leader = joint_rows.leader[k]
        if leader >= 0:
            position -= geometry.multiplier * data.state.joint_positions[leader]
            rate -= geometry.multiplier * data.state.joint_rates[leader]
            work.W[i, leader - work.first_joint[i], column] = -side * geometry.multiplier
        contact.gap = geometry.has_bound * side * (position - geometry.bound)
        contact.gap_rate = side * rate
        work.W[i, joint - work.first_joint[i], column] = side


@inlined
def write_wheels(k, model, data, work):
    """Rate, bias and column of ``W`` of the wheels in row ``k`` of ``model.joint_rows``."""
    joint_rows, state = model.joint_rows, data.state
    i, row, x = joint_rows.block[k], joint_rows.row[k], joint_rows.joint[k]
    yaw, v_x, v_y = state.joint_positions[x + 2], state.joint_rates[x], state.joint_rates[x + 1]
    sine, cosine = math.sin(yaw), math.cos(yaw)
    contact = open_contact(data.rows.kinematics[row])
    contact.gap_rate = cosine * v_y - sine * v_x
    contact.gap_bias = -(cosine * v_x + sine * v_y) * state.joint_rates[x + 2]
    first, column = x - work.first_joint[i], row - work.first_contact[i]
    work.W[i, first, column], work.W[i, first + 1, column] = -sine, cosine


@inlined
def release_wheels(model, work):
    """Set the columns of ``W`` of wheels to zero, which take no part then; returns how many.

    :func:`constraint_matrices` writes them again.
    """
    joint_rows, count = model.joint_rows, 0
    for k in range(joint_rows.row.size):
        if joint_rows.kind[k] == WHEELS:
            i = joint_rows.block[k]
            clear_column(i, joint_rows.row[k] - work.first_contact[i], work)
            count += 1
    return count


@inlined
def rate_by_object(row, data, a_o):
    """``W_o^T a_o`` of a row."""
    rate = 0.0
    for k in range(a_o.size):
        rate += data.rows.W_o[row, k] * a_o[k]
    return rate


@inlined
def rate_by_block(i, row, work, a):
    """``W^T a`` of a row of block ``i``."""
    rate = 0.0
    for j in range(work.first_joint[i + 1] - work.first_joint[i]):
        rate += work.W[i, j, row - work.first_contact[i]] * a[work.first_joint[i] + j]
    return rate


@kernel
def load_inertias(data, work):
    """Write the inertias of all blocks to ``work.M``."""
    for i in range(data.bodies.pointers.shape[0]):
        load_inertia(i, data, work)
    complete_inertias(work)


@inlined
def load_inertia(i, data, work):
    """Copy a block's inertia (lower triangle of the C-ordered view) into ``work.M``.

    In packs, whose numbers above the diagonal mean nothing.  That of a block with factors is
    written where it is wanted
    (:func:`multiarm.dynamics.solver.factored_trees.complete_inertias`).
    """
    d = work.first_joint[i + 1] - work.first_joint[i]
    addresses = open_addresses(data.bodies.pointers[i])
    if addresses.factors != 0:
        return
    stride, M = addresses.stride, work.M
    inertia, row, block = floats_at(addresses.inertia, d * stride), M.shape[2], i * M[0].size
    for a in range(d):
        if d < LANES:
            for b in range(a + 1):
                M[i, a, b] = inertia[a * stride + b]
            continue
        b = 0
        while b <= a:
            b = min(b, d - LANES)  # the last four may overlap those before
            store_pack(M, block + a * row + b, load_pack(inertia, a * stride + b))
            b += LANES


def inertias_in(work: NodeWork) -> list[np.ndarray]:
    """Copies of the inertias of all blocks in ``work.M``, symmetric, shape (n, n) each."""
    blocks = [M[:n, :n] for M, n in zip(work.M, np.diff(work.first_joint), strict=True)]
    return [np.where(np.tri(len(M), dtype=bool), M, M.T) for M in blocks]
