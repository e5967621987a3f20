r"""Keeping an arm at its place on the object, in the motions that its joint leaves free.

Frictionless fingertips slide, hinges turn: nothing but the arm itself holds them where they are.
The joint frame on the arm shall follow the one on the object like a body on springs: with the shift
:math:`x` and the rotation vector :math:`\theta` from the object's frame to the arm's
(:mod:`multiarm.contacts.frames`), in axes of the object's joint frame,

.. math:: \ddot x = -k x - \delta \dot x, \qquad \dot\omega = -k\,\theta - \delta\,\omega .

With the object's acceleration this is the acceleration of the joint frame on the arm

.. math::
    a_M &= \dot v_o + \dot\omega_o \times j + \omega_o \times (\omega_o \times j)
           + 2\,\omega_o \times R_J\dot x + R_J\ddot x, \\
    \dot\omega_M &= \dot\omega_o + \omega_o \times R_J\omega + R_J\dot\omega

(thesis, 3.6; ``j`` from the object's centre of mass to the frame), and of all joint accelerations
that have it those are taken that are nearest to the preferred ones in the metric of the inertia.
"""

from __future__ import annotations

import numpy as np

from multiarm.books import floats_at
from multiarm.contacts.frames import ON_LINK, ON_OBJECT, write_relative
from multiarm.contacts.kernel import ACCELERATION, ORIGIN_AT, SPIN, SPIN_RATE
from multiarm.load_sharing import solve_semidefinite
from multiarm.lowlevel import allocating
from multiarm.node.regular import factor_in_place
from multiarm.terms import J_AT


@allocating
def turned(body, frame, at, vector, out):
    """Write a vector (3,) in axes of a joint frame at ``at`` of ``frame`` in world axes, (3,)."""
    for k in range(3):
        out[k] = 0.0
        for j in range(3):
            axis = 0.0
            for a in range(3):
                axis += body[3 * k + a] * frame[at + 3 * a + j]
            out[k] += axis * vector[j]


@allocating
def add_cross(a, b, factor, out):
    """Add ``factor a x b`` to ``out`` (3,)."""
    out[0] += factor * (a[1] * b[2] - a[2] * b[1])
    out[1] += factor * (a[2] * b[0] - a[0] * b[2])
    out[2] += factor * (a[0] * b[1] - a[1] * b[0])


@allocating
def nearest_accelerations(inertia, W, preferred, target, result):
    r"""Write the accelerations nearest to ``preferred`` among those with :math:`W^T\ddot q = r`.

    Nearest in the metric of M: :math:`\ddot q = a + M^{-1}W (W^T M^{-1} W)^{-1}(r - W^T a)`.

    Parameters
    ----------
    inertia, W : float64
        M (lower triangle) and W (one column a condition) in their first rows and columns.
    preferred, target : (n,), (m,)
        ``a`` and ``r``.
    result : (n,), written
    """
    n, m = preferred.size, target.size
    L, Y = inertia[:n, :n].copy(), W[:n, :m].copy()
    K, rest, kappa, scale = np.zeros((m, m)), target.copy(), np.zeros(m), np.ones(m)
    for a in range(m):
        for j in range(n):
            rest[a] -= Y[j, a] * preferred[j]
    factor_in_place(L, n)
    for j in range(n):
        for a in range(m):
            for k in range(j):
                Y[j, a] -= L[j, k] * Y[k, a]
            Y[j, a] *= L[j, j]
            for b in range(a + 1):
                K[a, b] += Y[j, a] * Y[j, b]
    for a in range(m):
        if K[a, a] > 0.0:
            scale[a] = 1.0 / np.sqrt(K[a, a])
        rest[a] *= scale[a]
    for a in range(m):
        for b in range(a + 1):
            K[a, b] *= scale[a] * scale[b]
            K[b, a] = K[a, b]
    solve_semidefinite(K, rest, kappa)
    for j in range(n - 1, -1, -1):
        change = 0.0
        for a in range(m):
            change += Y[j, a] * scale[a] * kappa[a]
        for k in range(j + 1, n):
            change -= L[k, j] * (result[k] - preferred[k])
        result[j] = preferred[j] + L[j, j] * change


@allocating
def keep_place(i, stiffness, rate, along, plant, buffers, work, preferred):
    """Change the preferred accelerations (n,) of arm ``i`` to those that keep its place.

    Parameters
    ----------
    stiffness, rate : float
        ``k`` [1/s^2] and ``delta`` [1/s].
    along : bool
        Whether the object has the acceleration in ``buffers.q_o`` and everything that moves is
        accounted for; else the law lets velocities have their own effect, and asks for the
        springs' part alone.
    """
    n = work.dofs[i + 1] - work.dofs[i]
    frame, link, body = plant.frames[i], buffers.arms[i], buffers.body
    rates, places, spring = np.empty(6), np.empty(9), np.empty(6)
    write_relative(frame, link, body, rates, places)
    for k in range(6):
        spring[k] = -stiffness * places[k] - rate * rates[k]
    m, target, sliding = np.empty(3), np.empty(6), np.empty(3)
    turned(body, frame, ON_OBJECT, spring[:3], target[:3])
    turned(body, frame, ON_OBJECT, spring[3:], target[3:])
    for k in range(3):
        m[k] = (
            link[3 * k] * frame[ON_LINK + 9]
            + link[3 * k + 1] * frame[ON_LINK + 10]
            + link[3 * k + 2] * frame[ON_LINK + 11]
        )
    p = link[ORIGIN_AT : ORIGIN_AT + 3] + m
    if along:
        j, inner = p - body[ORIGIN_AT : ORIGIN_AT + 3], np.zeros(3)
        spin, twirl = body[SPIN : SPIN + 3], link[SPIN : SPIN + 3]
        for k in range(6):
            target[k] += buffers.q_o[k]
        add_cross(buffers.q_o[3:], j, 1.0, target[:3])
        add_cross(spin, j, 1.0, inner)
        turned(body, frame, ON_OBJECT, rates[:3], sliding)
        for k in range(3):
            inner[k] += 2.0 * sliding[k]
        add_cross(spin, inner, 1.0, target[:3])
        turned(body, frame, ON_OBJECT, rates[3:], sliding)
        add_cross(spin, sliding, 1.0, target[3:])
        # less what the link does by itself, without joint accelerations
        for k in range(3):
            inner[k] = 0.0
            target[k] -= link[ACCELERATION + k]
            target[3 + k] -= link[SPIN_RATE + k]
        add_cross(twirl, m, 1.0, inner)
        add_cross(twirl, inner, -1.0, target[:3])
        add_cross(link[SPIN_RATE : SPIN_RATE + 3], m, -1.0, target[:3])
    J, W, result = floats_at(plant.pointers[i, J_AT], 6 * n), np.empty((n, 6)), np.empty(n)
    for column in range(n):
        for k in range(6):  # Pinocchio's Jacobian is about the world's origin
            W[column, k] = J[6 * column + k]
        add_cross(J[6 * column + 3 : 6 * column + 6], p, 1.0, W[column, :3])
    nearest_accelerations(work.L[i], W, preferred, target, result)
    preferred[:] = result
