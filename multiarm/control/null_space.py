r"""Null-space control: a robot holds its poses on the object in the free motions of its joints.

Frictionless fingertips slide and hinges turn; only the robot itself can keep them in place.  The
joint frame on its link follows the one on the object as if on springs: with the displacement
:math:`x` and the rotation vector :math:`\theta` from the object's frame to the link's
(:mod:`multiarm.contacts.joint`), in axes of the object's joint frame,

.. math:: \ddot x = -k x - \delta \dot x, \qquad \dot\omega = -k\,\theta - \delta\,\omega .

With the object's acceleration this is the acceleration of the joint frame on the link

.. math::
    a_M &= \dot v_o + \dot\omega_o \times j + \omega_o \times (\omega_o \times j)
           + 2\,\omega_o \times R_J\dot x + R_J\ddot x, \\
    \dot\omega_M &= \dot\omega_o + \omega_o \times R_J\omega + R_J\dot\omega

(thesis, 3.6; ``j`` from the object's centre of mass to the frame).  The joint accelerations are
those with this property at all tips that hold the object, nearest to the preferred ones in the
metric of the inertia.  Connections of a robot with the world, its inner loops and couplings are
obeyed; nothing draws back what they leave free.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.contacts.joint import open_frames
from multiarm.contacts.motion import open_body
from multiarm.contacts.table import JOINT, open_code
from multiarm.dynamics.kinematics import object_of, write_connection_motion
from multiarm.dynamics.solver.bounds import IMMOVABLE
from multiarm.dynamics.solver.factors import factor_cholesky, forward_columns, solve_semidefinite
from multiarm.jit.kernels import allocating, clear, copy, inlined, kernel
from multiarm.jit.structs import floats_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_scaled,
    compose,
    cross,
    put,
    rotate,
    scale,
    sub,
    vec,
)
from multiarm.robots.terms import open_addresses


@allocating
def nearest_accelerations(inertia, W, preferred, target, result, multipliers):
    r"""Write the accelerations nearest to ``preferred`` among those with :math:`W^T\ddot q = r`.

    Nearest in the metric of M: :math:`M(\ddot q - a) = W\kappa` with
    :math:`W^T M^{-1} W \kappa = r - W^T a`.  Returns whether the conditions are independent.

    Parameters
    ----------
    inertia, W : float64
        M (lower triangle) and W (one column a condition) in their first rows and columns.
    preferred, target : (n,), (m,)
        ``a`` and ``r``.
    result, multipliers : (n,), (m,), written
        :math:`\ddot q` and :math:`\kappa`.
    """
    n, m = preferred.size, target.size
    L, Y, K = np.empty((n, n)), np.empty((n, m)), np.zeros((m, m))
    rest, scale = np.empty(m), np.empty(m)
    for j in range(n):
        copy(inertia[j, :n], L[j])
        copy(W[j, :m], Y[j])
    for a in range(m):
        rest[a] = target[a]
        for j in range(n):
            rest[a] -= Y[j, a] * preferred[j]
    factor_cholesky(L, n)
    forward_columns(L, Y, n, m)
    for j in range(n):
        for a in range(m):
            for b in range(a + 1):
                K[a, b] += Y[j, a] * Y[j, b]
    largest = 0.0
    for a in range(m):
        largest = max(largest, K[a, a])
    if largest == 0.0:
        largest = 1.0
    for a in range(m):
        # a row of roundings, as those across the plane of a linkage, is not scaled up
        moves = K[a, a] > IMMOVABLE * IMMOVABLE * largest
        scale[a] = 1.0 / math.sqrt(K[a, a] if moves else largest)
        rest[a] *= scale[a]
    for a in range(m):
        for b in range(a + 1):
            K[a, b] *= scale[a] * scale[b]
            K[b, a] = K[a, b]
    rank = solve_semidefinite(K, rest, multipliers)
    for a in range(m):
        multipliers[a] *= scale[a]
    for j in range(n - 1, -1, -1):
        change = 0.0
        for a in range(m):
            change += Y[j, a] * multipliers[a]
        for k in range(j + 1, n):
            change -= L[k, j] * (result[k] - preferred[k])
        result[j] = preferred[j] + L[j, j] * change
    return rank == m


@inlined
def holds_pose(c, i, model, data):
    """Whether owner ``c`` of rows connects a link of block ``i`` with an object."""
    pairs = model.connections
    moves = pairs.first[c] < data.bodies.links.shape[0]
    return pairs.block[c] == i and moves and object_of(pairs.second[c], data) >= 0


@kernel
def count_held(i, model, data):
    """Number of connections of block ``i`` with objects."""
    held = 0
    for c in range(model.connections.block.size):
        if holds_pose(c, i, model, data):
            held += 1
    return held


@allocating
def hold_poses(i, law, command, feedforward, model, data, work):
    """Change the preferred accelerations of block ``i`` to those that hold all its poses.

    Among those that its other rows allow, if it has any.  Returns whether the conditions are
    independent, and have derivatives in closed form: where there are no other rows.

    Parameters
    ----------
    law : view of ObjectLaw
        ``k`` [1/s^2] and ``delta`` [1/s] are those of the free motions.
    command : view of ObjectCommand
        ``preferred`` is changed; ``held`` gets the multipliers of the held connections, world axes.
    feedforward : bool
        Of the object's acceleration and of all velocity terms; else the accelerations are those of
        the springs and dampers alone.
    """
    d0, n = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
    first, end = work.first_contact[i], work.first_contact[i + 1]
    held = 6 * count_held(i, model, data)
    if held == 0:
        return True
    preferred, result = command.preferred[d0 : d0 + n], np.empty(n)
    W, target = np.empty((n, held + end - first)), np.empty(held + end - first)
    m = 0
    for c in range(model.connections.block.size):
        if holds_pose(c, i, model, data):
            write_pose_target(c, law, command.acceleration, feedforward, model, data, target[m:])
            write_frame_jacobian(c, n, model, data, W, m)
            m += 6
    for c in range(model.connections.block.size):
        for k in range(data.rows.first[c], data.rows.first[c + 1]):
            kind = open_code(model.contacts.codes[k]).kind
            if model.connections.block[c] != i or (holds_pose(c, i, model, data) and kind != JOINT):
                continue
            target[m] = command.target[k]
            for j in range(n):
                W[j, m] = work.W[i, j, k - first]
            m += 1
    multipliers = np.empty(m)
    independent = nearest_accelerations(work.M[i], W, preferred, target[:m], result, multipliers)
    copy(result, preferred)
    at = 0
    for c in range(model.connections.block.size):
        if holds_pose(c, i, model, data):
            copy(multipliers[at : at + 6], command.held[c])
            at += 6
    return independent and m == held


@allocating
def write_pose_target(c, law, acceleration, feedforward, model, data, target):
    """Write the acceleration that the joint frame of connection ``c`` is to have on its link (6,).

    World axes, less that of the link without joint accelerations.  The objects have
    ``acceleration`` (6 F,).
    """
    bodies, frames = data.bodies, open_frames(model.joint_frames[c])
    first, stiffness, rate = model.connections.first[c], law.free_stiffness, law.free_rate
    second = model.connections.second[c]
    link, body = open_body(bodies.motion[first]), open_body(bodies.motion[second])
    rates, places = np.empty(6), np.empty(9)
    write_connection_motion(model, data, c, rates, places)
    R_J = compose(body.rotation, frames.on_object)
    shift_rate, turn_rate = rotate(R_J, vec(rates, 0)), rotate(R_J, vec(rates, 3))
    shift, turn = rotate(R_J, vec(places, 0)), rotate(R_J, vec(places, 3))
    a = add_scaled(scale(-stiffness, shift), -rate, shift_rate)
    alpha = add_scaled(scale(-stiffness, turn), -rate, turn_rate)
    if feedforward:
        m = rotate(link.rotation, frames.origin_on_link)
        j, omega = sub(add(link.origin, m), body.origin), body.spin
        at = 6 * object_of(second, data)
        a_o, alpha_o = vec(acceleration, at), vec(acceleration, at + 3)
        inner = add_scaled(cross(omega, j), 2.0, shift_rate)
        a = add_cross(add_cross(add(a, a_o), alpha_o, j), omega, inner)
        alpha = add_cross(add(alpha, alpha_o), omega, turn_rate)
        # less the acceleration of the link without joint accelerations
        omega_m, alpha_m = link.spin, link.spin_rate
        of_link = add_cross(link.acceleration, alpha_m, m)
        a = sub(a, add_cross(of_link, omega_m, cross(omega_m, m)))
        alpha = sub(alpha, alpha_m)
    put(target, 0, a)
    put(target, 3, alpha)


@kernel
def write_frame_jacobian(c, n, model, data, W, m):
    """Write the Jacobian of the joint frame of connection ``c`` on its link into ``W[:, m:m + 6]``.

    Transposed, (n, 6).
    """
    first, frames = model.connections.first[c], open_frames(model.joint_frames[c])
    link = open_body(data.bodies.motion[first])
    p = add(link.origin, rotate(link.rotation, frames.origin_on_link))
    J = floats_at(open_addresses(data.bodies.pointers[model.links.block[first]]).jacobian, 6 * n)
    for j in range(n):
        clear(W[j, m : m + 6])
    for l in range(model.links.length[first]):
        j = model.links.chain[first, l]
        v, w = vec(J, 6 * j), vec(J, 6 * j + 3)  # Pinocchio's Jacobian is about the world's origin
        put(W[j], m, add_cross(v, w, p))
        put(W[j], m + 3, w)
