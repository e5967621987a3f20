r"""From contact records, poses and velocities to W, dW/dt, c and phi: one compiled kernel.

A contact joins a point ``P`` carried by body A with a surface of body B (arm and object, either way
round).  Everything is written in world axes, as seen by an observer who rides on B.  The motion of
A relative to B is the same for all contacts of a joint (:func:`relative_motion`):

.. math::
    V_0 &= \dot x_A - \dot x_B - \omega_B \times r_0, \qquad
    \Omega = \omega_A - \omega_B, \qquad
    \Omega' = \dot\omega_A - \dot\omega_B - \omega_B\times\omega_A \\
    A_0 &= \ddot x_A - \ddot x_B - \dot\omega_B\times r_0 - \omega_B\times(\omega_B\times r_0)
         - 2\,\omega_B\times V_0, \qquad r_0 = x_A - x_B

so that a point at ``d = P - x_A`` moves with

.. math::
    V = V_0 + \Omega\times d, \qquad A = A_0 + \Omega'\times d + \Omega\times(\Omega\times d)

and a surface with outward unit normal ``n`` (a function of the point only, once B stands still) has

.. math::
    \varphi = \text{gap}, \qquad \dot\varphi = n\cdot V, \qquad
    \ddot\varphi = \dot n\cdot V + n\cdot A .

The contact force acts along ``e``, the unit normal pointing *into the object*: ``e = -n`` when the
surface is the object's, ``e = n`` when it is the arm's.  Its wrench on the object, about the centre
of mass in world axes, is the row ``[e; (P - x_o) x e]``; the arm takes the opposite force at the
same point.  Hence with ``q_o`` the object's acceleration and ``q`` the joints',

.. math:: W_o^T q_o + W^T q = c, \qquad c = -\ddot\varphi\,|_{q_o = 0,\,q = 0}

which is the thesis's (4.9).  A spherical fingertip is the sharp point at its centre with the gap
reduced by its radius.

Reference: S.Y. Ho, Analysis and Design of Multi-Arm Robotic Systems Manipulating Large Objects,
CUHK 1995, sections 3.7, 3.9 and Example 4.1.
"""

from __future__ import annotations

import math

from multiarm.contacts.records import (
    AXIS,
    CYLINDER,
    ORIGIN,
    PLANE,
    POINT,
    RADIUS,
    SIDE,
    TIP_RADIUS,
)
from multiarm.jit.kernels import inlined
from multiarm.jit.vectors import (
    ZERO,
    across,
    add,
    add_cross,
    add_scaled,
    cross,
    dot,
    norm,
    put,
    rotate,
    rotation,
    scale,
    sub,
    vec,
)

# A row of body kinematics: rotation (9, row by row), origin, velocity of the origin, angular
# velocity, classical acceleration of the origin and angular acceleration; all in world axes.
ORIGIN_AT, VELOCITY, SPIN, ACCELERATION, SPIN_RATE = 9, 12, 15, 18, 21
BODY_WIDTH = 24

# A row of relative motion, A as seen from B, world axes: r_0, V_0, Omega, A_0, Omega'.
R_0, V_0, OMEGA, A_0, OMEGA_RATE = 0, 3, 6, 9, 12
RELATIVE_WIDTH = 15

# A row of contact kinematics, world axes: P, e, V, rate of n seen from B, three scalars, rate of P
# seen from B.  A combined row has a couple in the place of V.
AT, NORMAL, SLIP, NORMAL_RATE, GAP, GAP_RATE, GAP_BIAS = 0, 3, 6, 9, 12, 13, 14
POINT_RATE, COUPLE = 15, SLIP
CONTACT_WIDTH = 18


@inlined
def relative_motion(a, b, out):
    """Write the motion of body A seen from body B (``RELATIVE_WIDTH`` numbers) into ``out``.

    ``a`` and ``b`` (24,) are rows of body kinematics whose accelerations are those at ``q'' = 0``.
    """
    r = sub(vec(a, ORIGIN_AT), vec(b, ORIGIN_AT))
    w_a, w, w_rate = vec(a, SPIN), vec(b, SPIN), vec(b, SPIN_RATE)
    c = cross(w, r)
    V = sub(sub(vec(a, VELOCITY), vec(b, VELOCITY)), c)
    A = sub(sub(vec(a, ACCELERATION), vec(b, ACCELERATION)), cross(w_rate, r))
    # w x (w x r) + 2 w x V = w x (c + 2 V)
    A = sub(A, cross(w, add_scaled(c, 2.0, V)))
    Omega_rate = sub(sub(vec(a, SPIN_RATE), w_rate), cross(w, w_a))
    put(out, R_0, r)
    put(out, V_0, V)
    put(out, OMEGA, sub(w_a, w))
    put(out, A_0, A)
    put(out, OMEGA_RATE, Omega_rate)


@inlined
def motion_at(relative, d):
    """Velocity and acceleration, seen from B, of A's material point at ``d`` from A's origin."""
    Omega = vec(relative, OMEGA)
    turning = cross(Omega, d)
    A = add_cross(vec(relative, A_0), vec(relative, OMEGA_RATE), d)
    return add(vec(relative, V_0), turning), add_cross(A, Omega, turning)


@inlined
def put_contact(row, sign, point, point_rate, n, n_rate, gap, V, A):
    """Write a row of contact kinematics, for a force along ``sign n``; gap' = n.V."""
    put(row, AT, point)
    put(row, NORMAL, scale(sign, n))
    put(row, SLIP, V)
    put(row, NORMAL_RATE, n_rate)
    put(row, POINT_RATE, point_rate)
    row[GAP], row[GAP_RATE] = gap, dot(n, V)
    row[GAP_BIAS] = dot(n_rate, V) + dot(n, A)


@inlined
def contact_kinematics(kind, into_object, geometry, a, b, relative, out):
    """Write the kinematics of a tip on a plane, sphere or cylinder into ``out``.

    Parameters
    ----------
    kind : int
        ``PLANE``, ``SPHERE`` or ``CYLINDER``.
    into_object : float
        -1 when the surface is the object's (its outward normal then points out of the object).
    geometry : float64 (13,)
        One row of a :class:`~multiarm.contacts.records.ContactTable`.
    a, b : float64 (24,)
        Kinematics of the body with the point and of the body with the surface.
    relative : float64 (15,)
        From :func:`relative_motion` of the two.
    out : float64 (18,), written
        Contact point, normal into the object, slip velocity, rate of the outward normal, gap [m],
        gap rate [m/s], the gap's second derivative at zero accelerations [m/s^2], point's rate.
    """
    R_B = rotation(b, 0)
    d = rotate(rotation(a, 0), vec(geometry, POINT))
    V, A = motion_at(relative, d)
    # from a point of the surface's own geometry to P
    f = sub(add(vec(relative, R_0), d), rotate(R_B, vec(geometry, ORIGIN)))
    axis = rotate(R_B, vec(geometry, AXIS))
    if kind == PLANE:
        n, n_rate, gap = axis, ZERO, dot(axis, f)
    else:
        turning = V
        if kind == CYLINDER:
            f, turning = across(axis, f), across(axis, V)
        side, distance = geometry[SIDE], norm(f)
        # at the very centre there is no normal
        inverse = side / distance if distance > 0.0 else math.nan
        n = scale(inverse, f)
        # n turns with the part of V across the surface's curved directions
        n_rate = scale(inverse, across(n, turning))
        gap = side * (distance - geometry[RADIUS])
    point = add(vec(a, ORIGIN_AT), d)
    put_contact(out, into_object, point, V, n, n_rate, gap - geometry[TIP_RADIUS], V, A)
