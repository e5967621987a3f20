r"""Derivatives of arms: of the motion of the link that carries the tip, of the inverse dynamics.

An arm is a chain of joints that turn or slide.  Twists :math:`(v, \omega)`, accelerations and
wrenches are in world axes and about the arm's base; :math:`\times` is the product of two twists,
:math:`\times^*` that of a twist and a wrench.  Outwards, with the column :math:`S_j` of a joint,
and with the base accelerated by minus gravity,

.. math::
    v_j = v_{j-1} + S_j \dot q_j, \qquad
    a_j = a_{j-1} + S_j \ddot q_j + v_j \times S_j \dot q_j, \\
    \dot\Psi_j = v_j \times S_j, \qquad
    \ddot\Psi_j = a_j \times S_j + v_j \times \dot\Psi_j .

*The link* with twist v and acceleration a moves, for a displacement of one joint before it,

.. math::
    \delta v &= \dot\Psi_j + S_j\times v, \qquad
    \delta a = \ddot\Psi_j + \dot\Psi_j\times v + S_j\times a \quad &&\text{(of its position)} \\
    \delta v &= S_j, \qquad \delta a = 2\dot\Psi_j + S_j\times v \quad &&\text{(of its rate)} .

*Inverse dynamics.*  The force that moves a link, :math:`f = I a + v\times^* I v`, changes with its
twist by :math:`2 B m + I (v\times m)`.  With linear momentum p and first moment h of the link, B
depends on the angular part of m only,

.. math::
    2 B m = \begin{bmatrix} 2\,\omega_m\times p\\ G\,\omega_m\end{bmatrix}, \qquad
    G = [\omega] I_0 + ([\omega] I_0)^T - [I_0 \omega] - 2\,v h^T + 2\,(h\cdot v)\,1,

as its other terms cancel by Jacobi's identity.  Inwards, I, B and f of all links beyond a joint are
summed, f without a load that is fixed in its link.  For j at or before i,

.. math::
    \frac{\partial\tau_j}{\partial q_i} &= S_j\cdot(I\ddot\Psi_i + 2B\dot\Psi_i + S_i\times^* f),
    \qquad & \frac{\partial\tau_i}{\partial q_j} &= S_i\cdot(I\ddot\Psi_j + 2B\dot\Psi_j) \\
    \frac{\partial\tau_j}{\partial\dot q_i} &= S_j\cdot 2(I\dot\Psi_i + B S_i),
    \qquad & \frac{\partial\tau_i}{\partial\dot q_j} &= S_i\cdot 2(I\dot\Psi_j + B S_j) .

Reference: S. Singh, R.P. Russell, P.M. Wensing, Efficient Analytical Derivatives of Rigid-Body
Dynamics Using Spatial Vector Algebra, IEEE Robotics and Automation Letters 7, 2022; written out
here for joints with one degree of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.arms.terms import ArmStructure
from multiarm.jit.kernels import clear, inlined, kernel
from multiarm.jit.structs import Floats1, Floats2, Ints1
from multiarm.jit.vectors import (
    ZERO,
    add,
    add_cross,
    add_rotated,
    add_scaled,
    add_symmetric,
    add_times,
    compose,
    cross,
    dot,
    put,
    put_rotation,
    put_symmetric,
    rotate,
    rotate_symmetric,
    rotation,
    scale,
    sub,
    symmetric,
    times,
    vec,
)

# A body: rotation (9, row by row), then its motion: origin, a turn (zero), velocity of the origin,
# angular velocity, acceleration of the origin, angular acceleration.  A displacement of a motion
# has the same parts.
MOTION, BODY_SIZE = 9, 27
PLACE, TURN, LINEAR, ANGULAR, LINEAR_RATE, ANGULAR_RATE, MOTION_WIDTH = range(0, 21, 3)

# Columns of ``ArmLinks.frames`` and ``ArmLinks.bodies``.
_AXES, _ORIGIN, _SLIDE, _AXIS, _FRAME_WIDTH = 0, 9, 12, 15, 18
_MASS, _CENTRE, _INERTIA, _BODY_WIDTH = 0, 1, 4, 10

# Numbers of a joint and its link in the scratch: rotation and origin; pairs of vectors S, v, a,
# and the rates of S; of all links beyond: mass, first and second moment, momentum, G, force.
(
    _R, _P, _S, _V, _A, _PSI, _PSI_RATE, _M, _MOMENT, _SECOND, _MOMENTUM, _G, _F, LINK_SCRATCH
) = 0, 9, 12, 18, 24, 30, 36, 42, 43, 46, 52, 55, 64, 70  # fmt: skip


class ArmLinks(NamedTuple):
    """Joints and links of all arms, chains of joints that turn or slide.

    Attributes
    ----------
    first : int64 ndarray, shape (n + 1,)
        First joint of each arm.
    frames : ndarray, shape (joints, 18)
        At zero, in the frame of the joint before or in the world: rotation and origin; the joint's
        slide and turn for a unit of its coordinate, own axes.
    bodies : ndarray, shape (joints, 10)
        Mass, centre, inertia about it (xx, xy, xz, yy, yz, zz), own axes.
    gravity : ndarray, shape (3,)
    """

    first: Ints1
    frames: Floats2
    bodies: Floats2
    gravity: Floats1


def arm_links(arms: Sequence[ArmStructure], gravity: np.ndarray) -> ArmLinks:
    """The joints and links of some arms."""
    frames, bodies = [], []
    for arm in arms:
        for k, slides in enumerate(arm.slides):
            slide, axis = (arm.axes[k] * part for part in (slides, not slides))
            frames.append([*arm.rotations[k].ravel(), *arm.translations[k], *slide, *axis])
            inertia = arm.inertias[k][np.triu_indices(3)]
            bodies.append([arm.masses[k], *arm.centres[k], *inertia])
    return ArmLinks(
        np.cumsum([0, *(arm.slides.size for arm in arms)]).astype(np.int64),
        np.array(frames),
        np.array(bodies),
        np.array(gravity, dtype=float),
    )


@kernel
def write_motions(links, i, angles, rates, accelerations, scratch, link, moved):
    """Write the motions of an arm's links, and how the one that carries the tip is displaced.

    Parameters
    ----------
    links : view of ArmLinks
    i : int
        Number of the arm.
    angles, rates, accelerations : (joints,)
        Of all arms.
    scratch : (n_i, 70), written
    link : (27,), written
        Rotation and motion of the link, world axes.
    moved : (2 n_i, 18), written
        Its displacement by the positions, and by the velocities, world axes.
    """
    d0, n = links.first[i], links.first[i + 1] - links.first[i]
    base, gravity = vec(links.frames[d0], _ORIGIN), vec(links.gravity, 0)
    for k in range(n):
        j = d0 + k
        _place_joint(links.frames[j], angles[j], base, scratch, k)
        s = scratch[k]
        v, w, a, alpha = ZERO, ZERO, scale(-1.0, gravity), ZERO
        if k > 0:
            (v, w), (a, alpha) = _pair(scratch[k - 1], _V), _pair(scratch[k - 1], _A)
        S = _pair(s, _S)
        v, w = add_scaled(v, rates[j], S[0]), add_scaled(w, rates[j], S[1])
        rate = twist_product((v, w), S)
        a = add_scaled(add_scaled(a, accelerations[j], S[0]), rates[j], rate[0])
        alpha = add_scaled(add_scaled(alpha, accelerations[j], S[1]), rates[j], rate[1])
        _put_pair(s, _V, (v, w))
        _put_pair(s, _A, (a, alpha))
        _put_pair(s, _PSI, rate)
        _put_pair(s, _PSI_RATE, _plus(twist_product((a, alpha), S), twist_product((v, w), rate)))
    _write_link(n, base, gravity, scratch, link, moved)


@inlined
def _place_joint(frame, q, base, scratch, k):
    """Write the rotation and origin of a joint's frame, and its column."""
    R, p = rotation(frame, _AXES), vec(frame, _ORIGIN)
    if k > 0:
        before = rotation(scratch[k - 1], _R)
        p = add_rotated(vec(scratch[k - 1], _P), before, p)
        R = compose(before, R)
    else:
        p = sub(p, base)
    slide, axis = rotate(R, vec(frame, _SLIDE)), rotate(R, vec(frame, _AXIS))
    p = add_scaled(p, q, slide)
    c, s = math.cos(q), math.sin(q)
    R = _turned(R[0], axis, c, s), _turned(R[1], axis, c, s), _turned(R[2], axis, c, s)
    put_rotation(scratch[k], _R, R)
    put(scratch[k], _P, p)
    _put_pair(scratch[k], _S, (add_cross(slide, p, axis), axis))


@inlined
def _turned(a, axis, c, s):
    """A vector turned about a unit axis, or left where the axis is zero."""
    b = cross(axis, a)
    return add_scaled(add_scaled(a, s, b), 1.0 - c, cross(axis, b))


@inlined
def _write_link(n, base, gravity, scratch, link, moved):
    """Write the motion of the last link, which carries the tip, and its displacements."""
    tip = scratch[n - 1]
    r, (v, w), (a, alpha) = vec(tip, _P), _pair(tip, _V), _pair(tip, _A)
    u = add_cross(v, w, r)  # velocity of the link's origin
    put_rotation(link, 0, rotation(tip, _R))
    motion = link[MOTION:]
    put(motion, PLACE, add(r, base))
    put(motion, TURN, ZERO)
    put(motion, LINEAR, u)
    put(motion, ANGULAR, w)
    put(motion, LINEAR_RATE, add_cross(add_cross(add(a, gravity), alpha, r), w, u))
    put(motion, ANGULAR_RATE, alpha)
    for j in range(n):
        clear(moved[n + j])
        s = scratch[j]
        S, rate, second = _pair(s, _S), _pair(s, _PSI), _pair(s, _PSI_RATE)
        shift, along = add_cross(S[0], S[1], r), twist_product(S, (v, w))
        # by the position
        of_v, around = _plus(rate, along), twist_product(S, (a, alpha))
        of_a = _plus(second, _plus(twist_product(rate, (v, w)), around))
        of_u = add_cross(add_cross(of_v[0], of_v[1], r), w, shift)
        rate_of_u = add_cross(add_cross(of_a[0], of_a[1], r), alpha, shift)
        out = moved[j]
        put(out, PLACE, shift)
        put(out, TURN, S[1])
        put(out, LINEAR, of_u)
        put(out, ANGULAR, of_v[1])
        put(out, LINEAR_RATE, add_cross(add_cross(rate_of_u, of_v[1], u), w, of_u))
        put(out, ANGULAR_RATE, of_a[1])
        # by the velocity, for which the origin moves by ``shift`` in a unit of time
        of_a = add_scaled(along[0], 2.0, rate[0]), add_scaled(along[1], 2.0, rate[1])
        rate_of_u = add_cross(add_cross(of_a[0], of_a[1], r), S[1], u)
        out = moved[n + j]
        put(out, LINEAR, shift)
        put(out, ANGULAR, S[1])
        put(out, LINEAR_RATE, add_cross(rate_of_u, w, shift))
        put(out, ANGULAR_RATE, of_a[1])


@kernel
def write_inverse_dynamics(links, i, load, scratch, by_q, by_v):
    """Write the derivatives of an arm's inverse dynamics, ``M q'' + b - J^T f``.

    By positions and velocities, (n_i, n_i) each, after :func:`write_motions` with the same scratch,
    which is used up.  ``load`` (6,) is the wrench f on the link that carries the tip, about its
    origin in its axes [N, N m]; it stays constant in these.
    """
    d0, n = links.first[i], links.first[i + 1] - links.first[i]
    for k in range(n):
        _write_body(links.bodies[d0 + k], scratch[k])
    tip = scratch[n - 1]
    force, couple = _about_base(tip, load)
    _put_pair(tip, _F, (sub(vec(tip, _F), force), sub(vec(tip, _F + 3), couple)))
    for k in range(n - 1, -1, -1):
        s = scratch[k]
        S, rate, second, f = _pair(s, _S), _pair(s, _PSI), _pair(s, _PSI_RATE), _pair(s, _F)
        m, h, inertia = s[_M], vec(s, _MOMENT), symmetric(s, _SECOND)
        P, G = vec(s, _MOMENTUM), rotation(s, _G)
        # the columns of the joint
        of_q = _times_inertia(m, h, inertia, second)
        of_q = (
            add_cross(add_scaled(of_q[0], 2.0, cross(rate[1], P)), S[1], f[0]),
            add_rotated(add_cross(add_cross(of_q[1], S[1], f[1]), S[0], f[0]), G, rate[1]),
        )
        of_v = _times_inertia(m, h, inertia, rate)
        of_v = (
            scale(2.0, add_cross(of_v[0], S[1], P)),
            add_rotated(scale(2.0, of_v[1]), G, S[1]),
        )
        # its rows, by twists and accelerations of the joints before
        momentum = _times_inertia(m, h, inertia, S)
        turning = add_scaled(
            (dot(G[0], S[1]), dot(G[1], S[1]), dot(G[2], S[1])), 2.0, cross(P, S[0])
        )
        by_q[k, k], by_v[k, k] = _power(S, of_q), _power(S, of_v)
        for j in range(k):
            joint = scratch[j]
            S_j, rate_j = _pair(joint, _S), _pair(joint, _PSI)
            by_q[j, k], by_v[j, k] = _power(S_j, of_q), _power(S_j, of_v)
            by_q[k, j] = _power(_pair(joint, _PSI_RATE), momentum) + dot(rate_j[1], turning)
            by_v[k, j] = 2.0 * _power(rate_j, momentum) + dot(S_j[1], turning)
        if k > 0:
            before = scratch[k - 1]
            for c in range(_M, LINK_SCRATCH):
                before[c] += s[c]


@kernel
def subtract_torques(n, wrench, scratch, table, column):
    """Subtract the torques of a wrench (6,) on the link that carries the tip from a column.

    The wrench is about the link's origin in its axes.
    """
    force, couple = _about_base(scratch[n - 1], wrench)
    for j in range(n):
        table[j, column] -= _power(_pair(scratch[j], _S), (force, couple))


@inlined
def _about_base(tip, wrench):
    R = rotation(tip, _R)
    force = rotate(R, vec(wrench, 0))
    return force, add_cross(rotate(R, vec(wrench, 3)), vec(tip, _P), force)


@inlined
def _write_body(body, s):
    """Write the moments of one link, its momentum, G, and the force that moves it."""
    R, mass = rotation(s, _R), body[_MASS]
    c = add_rotated(vec(s, _P), R, vec(body, _CENTRE))
    h = scale(mass, c)
    xx, yy, zz = h[0] * c[0], h[1] * c[1], h[2] * c[2]
    around = (yy + zz, -h[0] * c[1], -h[0] * c[2], xx + zz, -h[1] * c[2], xx + yy)
    inertia = add_symmetric(rotate_symmetric(R, symmetric(body, _INERTIA)), around)
    v, a = _pair(s, _V), _pair(s, _A)
    w, u = v[1], v[0]
    p, l = _times_inertia(mass, h, inertia, v)
    f, n = _times_inertia(mass, h, inertia, a)
    s[_M] = mass
    put(s, _MOMENT, h)
    put_symmetric(s, _SECOND, inertia)
    put(s, _MOMENTUM, p)
    _put_pair(s, _F, (add_cross(f, w, p), add_cross(add_cross(n, w, l), u, p)))
    # columns of [w] I_0, whose sum with its transpose is symmetric
    X = cross(w, inertia[0:3])
    Y = cross(w, (inertia[1], inertia[3], inertia[4]))
    Z = cross(w, (inertia[2], inertia[4], inertia[5]))
    o, along = times(inertia, w), 2.0 * dot(h, u)
    xy, xz, yz = X[1] + Y[0], X[2] + Z[0], Y[2] + Z[1]
    t = scale(-2.0, u)
    put(s, _G, (2.0 * X[0] + along + t[0] * h[0], xy + o[2] + t[0] * h[1], xz - o[1] + t[0] * h[2]))
    put(
        s,
        _G + 3,
        (xy - o[2] + t[1] * h[0], 2.0 * Y[1] + along + t[1] * h[1], yz + o[0] + t[1] * h[2]),
    )
    put(
        s,
        _G + 6,
        (xz + o[1] + t[2] * h[0], yz - o[0] + t[2] * h[1], 2.0 * Z[2] + along + t[2] * h[2]),
    )


@inlined
def twist_product(a, b):
    """``a x b`` of two twists, pairs of vectors."""
    return add_cross(cross(a[1], b[0]), a[0], b[1]), cross(a[1], b[1])


@inlined
def _times_inertia(mass, moment, second, twist):
    """Momentum of a body at a twist."""
    linear = add_cross(scale(mass, twist[0]), twist[1], moment)
    return linear, add_times(cross(moment, twist[0]), second, twist[1])


@inlined
def _plus(a, b):
    """``a + b`` of two pairs of vectors."""
    return add(a[0], b[0]), add(a[1], b[1])


@inlined
def _power(twist, wrench):
    return dot(twist[0], wrench[0]) + dot(twist[1], wrench[1])


@inlined
def _pair(row, at):
    """Two vectors, one after the other."""
    return vec(row, at), vec(row, at + 3)


@inlined
def _put_pair(row, at, pair):
    put(row, at, pair[0])
    put(row, at + 3, pair[1])
