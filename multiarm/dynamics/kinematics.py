r"""From joint positions and the object's pose to motions, inertias and the rows of W.

First the terms of all arms, with the motion of the links that carry their tips; then the object's;
then every arm's contacts.  The results are in :mod:`multiarm.dynamics.variables`, in world axes.
"""

from __future__ import annotations

import ctypes

import numpy as np

from multiarm.arms.terms import POSE_WIDTH, TermAddresses, open_addresses, open_pose
from multiarm.contacts.kernel import open_contact, write_rows_in_closed_form
from multiarm.contacts.motion import open_body
from multiarm.contacts.table import open_joint
from multiarm.jit.kernels import inlined
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
from multiarm.spatial import write_matrix


@inlined
def fill_configuration(model, data):
    """Write Pinocchio's configuration from the positions of its arms' joints."""
    for j in range(data.state.joint_positions.size):
        slot = model.q_slots[j]
        if slot < 0:
            continue
        if model.circular[j] != 0:
            data.bodies.pinocchio_configuration[slot] = np.cos(data.state.joint_positions[j])
            data.bodies.pinocchio_configuration[slot + 1] = np.sin(data.state.joint_positions[j])
        else:
            data.bodies.pinocchio_configuration[slot] = data.state.joint_positions[j]


@inlined
def arm_terms(model, data):
    """All terms of the arms, and the motion of the links that carry their tips."""
    functions = data.functions
    if functions.arms != 0:
        arms = struct_at(functions.arms_struct, functions.arms_size)
        call_cfunc(functions.arms, arms, 0.0, 0.0)
    if functions.pinocchio != 0:
        fill_configuration(model, data)
        call_python(functions.pinocchio)
    for i in range(data.bodies.pointers.shape[0]):
        addresses = open_addresses(data.bodies.pointers[i])
        if addresses.twist != 0:
            link_motion(addresses, model.gravity, open_body(data.bodies.links[i]))


@inlined
def object_terms(model, data):
    """Pose, motion, inertia ``blkdiag(m I, R I R^T)`` and bias of the object (thesis, 3.2)."""
    body, mass = open_body(data.bodies.object), model.object_mass
    write_matrix(data.state.object_pose[3:7], data.bodies.object)
    R, omega = body.rotation, vec(data.state.object_twist, 3)
    A = model.object_inertia
    I = rotate_symmetric(R, (A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]))
    body.origin, body.spin = vec(data.state.object_pose, 0), omega
    body.velocity = vec(data.state.object_twist, 0)
    for k in range(3):
        data.bodies.object_inertia[k, k] = mass
    put(data.bodies.object_inertia[3], 3, I[0:3])
    put(data.bodies.object_inertia[4], 3, (I[1], I[3], I[4]))
    put(data.bodies.object_inertia[5], 3, (I[2], I[4], I[5]))
    put(data.forces.f_o, 0, scale(mass, vec(model.gravity, 0)))
    put(data.forces.f_o, 3, cross(times(I, omega), omega))


@inlined
def link_motion(addresses, gravity, body):
    """Motion of the link that carries an arm's tip, in world axes, from Pinocchio's own arrays.

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
    """Contact kinematics of all arms; ``model, data, work`` are the views of ``struct``."""
    bodies, complete = data.bodies, True
    for i in range(bodies.pointers.shape[0]):
        complete &= write_rows_in_closed_form(
            work.first_contact[i], work.first_contact[i + 1], bodies.links[i], bodies.object,
            model.contacts, bodies.relative, data.rows.kinematics,
        )  # fmt: skip
    if not complete:
        call_cfunc(data.functions.general_rows, struct, 0.0, 0.0)


@inlined
def arm_rows(i, data, work):
    """Rows of ``W_o`` of arm ``i``, and its ``W``, from the kinematics of its contacts."""
    d = work.first_joint[i + 1] - work.first_joint[i]
    first = work.first_contact[i]
    m = work.first_contact[i + 1] - first
    bodies = data.bodies
    J = floats_at(open_addresses(bodies.pointers[i]).jacobian, 6 * d)  # column by column
    x_o, W, wrench = open_body(bodies.object).origin, work.W[i], data.rows.arm_wrenches
    for k in range(m):
        row, W_o = open_contact(data.rows.kinematics[first + k]), data.rows.W_o[first + k]
        e, p, couple = row.normal, row.point, row.couple
        put(W_o, 0, e)
        put(W_o, 3, add(cross(sub(p, x_o), e), couple))
        # the arm takes the opposite wrench; its Jacobian is about the world's origin
        force, moment = scale(-1.0, e), sub(cross(e, p), couple)
        if m < LANES:
            for j in range(d):
                W[j, k] = dot(vec(J, 6 * j), force) + dot(vec(J, 6 * j + 3), moment)
        else:
            wrench[0, k], wrench[1, k], wrench[2, k] = force
            wrench[3, k], wrench[4, k], wrench[5, k] = moment
    if m < LANES:
        return
    k = 0
    while k < m:
        k = min(k, m - LANES)  # the last four may overlap those before
        write_four_columns(i, k, d, J, wrench, work)
        k += LANES


@inlined
def write_four_columns(i, k, d, J, wrench, work):
    """Four columns of ``W``, contacts ``k`` to ``k + 3``, in SIMD packs."""
    N, W = wrench.shape[1], work.W
    w0, w1, w2 = load_pack(wrench, k), load_pack(wrench, N + k), load_pack(wrench, 2 * N + k)
    w3, w4, w5 = (
        load_pack(wrench, 3 * N + k),
        load_pack(wrench, 4 * N + k),
        load_pack(wrench, 5 * N + k),
    )
    at = i * W.shape[1] * W.shape[2] + k
    for j in range(d):
        a = broadcast(J[6 * j]) * w0 + broadcast(J[6 * j + 1]) * w1 + broadcast(J[6 * j + 2]) * w2
        b = (
            broadcast(J[6 * j + 3]) * w3
            + broadcast(J[6 * j + 4]) * w4
            + broadcast(J[6 * j + 5]) * w5
        )
        store_pack(W, at, a + b)
        at += W.shape[2]


@inlined
def write_joint_rows(model, data, work):
    """Rows that belong to joints: their gaps, and their columns of ``W``."""
    joint_rows = model.joint_rows
    for k in range(joint_rows.row.size):
        i, row, joint = joint_rows.arm[k], joint_rows.row[k], joint_rows.joint[k]
        geometry = open_joint(model.contacts.geometry[row])
        contact = open_contact(data.rows.kinematics[row])
        side, beyond = geometry.side, data.state.joint_positions[joint] - geometry.bound
        contact.gap = geometry.has_bound * side * beyond
        contact.gap_rate = side * data.state.joint_rates[joint]
        work.W[i, joint - work.first_joint[i], row - work.first_contact[i]] = side


@inlined
def load_inertia(i, data, work):
    """Copy the arm's inertia (lower triangle of the C-ordered view) into ``work.M``."""
    d = work.first_joint[i + 1] - work.first_joint[i]
    addresses = open_addresses(data.bodies.pointers[i])
    stride = addresses.stride
    inertia, M = floats_at(addresses.inertia, d * stride), work.M[i]
    for a in range(d):
        for b in range(a + 1):
            M[a, b] = inertia[a * stride + b]


def read_inertia(pointers: np.ndarray, n: int) -> np.ndarray:
    """A copy of an arm's inertia, symmetric, shape (n, n); ``pointers`` of the arm."""
    if n == 0:  # the surroundings
        return np.zeros((0, 0))
    addresses = TermAddresses(*pointers.tolist())
    stride = addresses.stride
    size = (n - 1) * stride + n
    numbers = (ctypes.c_double * size).from_address(addresses.inertia)
    flat = np.frombuffer(memoryview(numbers), dtype=float)
    lower = np.lib.stride_tricks.as_strided(flat, (n, n), (8 * stride, 8))
    return np.tril(lower) + np.tril(lower, -1).T
