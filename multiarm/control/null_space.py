r"""Null-space control: an arm holds its pose on the object in the free motions of its joint.

Frictionless fingertips slide and hinges turn; only the arm itself can keep them in place.  The
joint frame on the arm follows the one on the object as if on springs: with the displacement
:math:`x` and the rotation vector :math:`\theta` from the object's frame to the arm's
(:mod:`multiarm.contacts.joint`), in axes of the object's joint frame,

.. math:: \ddot x = -k x - \delta \dot x, \qquad \dot\omega = -k\,\theta - \delta\,\omega .

With the object's acceleration this is the acceleration of the joint frame on the arm

.. math::
    a_M &= \dot v_o + \dot\omega_o \times j + \omega_o \times (\omega_o \times j)
           + 2\,\omega_o \times R_J\dot x + R_J\ddot x, \\
    \dot\omega_M &= \dot\omega_o + \omega_o \times R_J\omega + R_J\dot\omega

(thesis, 3.6; ``j`` from the object's centre of mass to the frame).  The joint accelerations are
those with this property that are nearest to the preferred ones in the metric of the inertia.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.arms.terms import open_addresses
from multiarm.contacts.joint import open_frames, write_relative
from multiarm.contacts.motion import open_body
from multiarm.dynamics.solver.factors import factor_cholesky, forward_columns, solve_semidefinite
from multiarm.jit.kernels import allocating, copy
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
    for a in range(m):
        scale[a] = 1.0 / math.sqrt(K[a, a]) if K[a, a] > 0.0 else 1.0
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


@allocating
def hold_pose(
    i, stiffness, rate, feedforward, acceleration, model, data, work, preferred, multipliers
):
    """Change the preferred accelerations (n,) of arm ``i`` to those that hold its pose.

    Returns whether the arm can hold any pose.

    Parameters
    ----------
    stiffness, rate : float
        ``k`` [1/s^2] and ``delta`` [1/s].
    feedforward : bool
        Of the object's acceleration and of all velocity terms; else the accelerations are those of
        the springs and dampers alone.
    acceleration : (6,)
        Of the object.
    multipliers : (6,), written
        Of the nearest accelerations, in world axes.
    """
    n = work.first_joint[i + 1] - work.first_joint[i]
    bodies, frames = data.bodies, open_frames(model.joint_frames[i])
    link, body = open_body(bodies.links[i]), open_body(bodies.object)
    rates, places, target = np.empty(6), np.empty(9), np.empty(6)
    write_relative(model.joint_frames[i], bodies.links[i], bodies.object, rates, places)
    R_J = compose(body.rotation, frames.on_object)
    shift_rate, turn_rate = rotate(R_J, vec(rates, 0)), rotate(R_J, vec(rates, 3))
    shift, turn = rotate(R_J, vec(places, 0)), rotate(R_J, vec(places, 3))
    a = add_scaled(scale(-stiffness, shift), -rate, shift_rate)
    alpha = add_scaled(scale(-stiffness, turn), -rate, turn_rate)
    m = rotate(link.rotation, frames.origin_on_link)
    p = add(link.origin, m)
    if feedforward:
        j, omega = sub(p, body.origin), body.spin
        a_o, alpha_o = vec(acceleration, 0), vec(acceleration, 3)
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
    J = floats_at(open_addresses(bodies.pointers[i]).jacobian, 6 * n)
    W, result = np.empty((n, 6)), np.empty(n)
    for column in range(n):  # Pinocchio's Jacobian is about the world's origin
        v, w = vec(J, 6 * column), vec(J, 6 * column + 3)
        put(W[column], 0, add_cross(v, w, p))
        put(W[column], 3, w)
    holds = nearest_accelerations(work.M[i], W, preferred, target, result, multipliers)
    copy(result, preferred)
    return holds
