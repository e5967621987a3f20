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
from multiarm.lowlevel import inlined

# A row of body kinematics: rotation (9, row by row), origin, velocity of the origin, angular
# velocity, classical acceleration of the origin and angular acceleration; all in world axes.
ORIGIN_AT, VELOCITY, SPIN, ACCELERATION, SPIN_RATE = 9, 12, 15, 18, 21
BODY_WIDTH = 24

# A row of relative motion, A as seen from B, world axes: r_0, V_0, Omega, A_0, Omega'.
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
    r0, r1, r2 = a[9] - b[9], a[10] - b[10], a[11] - b[11]
    w0, w1, w2 = b[15], b[16], b[17]
    u0, u1, u2 = a[15], a[16], a[17]
    c0, c1, c2 = w1 * r2 - w2 * r1, w2 * r0 - w0 * r2, w0 * r1 - w1 * r0
    v0, v1, v2 = a[12] - b[12] - c0, a[13] - b[13] - c1, a[14] - b[14] - c2
    g0, g1, g2 = b[21], b[22], b[23]
    # w x (w x r) + 2 w x V = w x (c + 2 V)
    m0, m1, m2 = c0 + 2.0 * v0, c1 + 2.0 * v1, c2 + 2.0 * v2
    out[0], out[1], out[2] = r0, r1, r2
    out[3], out[4], out[5] = v0, v1, v2
    out[6], out[7], out[8] = u0 - w0, u1 - w1, u2 - w2
    out[9] = a[18] - b[18] - (g1 * r2 - g2 * r1) - (w1 * m2 - w2 * m1)
    out[10] = a[19] - b[19] - (g2 * r0 - g0 * r2) - (w2 * m0 - w0 * m2)
    out[11] = a[20] - b[20] - (g0 * r1 - g1 * r0) - (w0 * m1 - w1 * m0)
    out[12] = a[21] - g0 - (w1 * u2 - w2 * u1)
    out[13] = a[22] - g1 - (w2 * u0 - w0 * u2)
    out[14] = a[23] - g2 - (w0 * u1 - w1 * u0)


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
    p0, p1, p2 = geometry[POINT], geometry[POINT + 1], geometry[POINT + 2]
    d0 = a[0] * p0 + a[1] * p1 + a[2] * p2
    d1 = a[3] * p0 + a[4] * p1 + a[5] * p2
    d2 = a[6] * p0 + a[7] * p1 + a[8] * p2
    w0, w1, w2 = relative[6], relative[7], relative[8]
    u0, u1, u2 = w1 * d2 - w2 * d1, w2 * d0 - w0 * d2, w0 * d1 - w1 * d0
    v0, v1, v2 = relative[3] + u0, relative[4] + u1, relative[5] + u2
    g0, g1, g2 = relative[12], relative[13], relative[14]
    s0 = relative[9] + g1 * d2 - g2 * d1 + w1 * u2 - w2 * u1
    s1 = relative[10] + g2 * d0 - g0 * d2 + w2 * u0 - w0 * u2
    s2 = relative[11] + g0 * d1 - g1 * d0 + w0 * u1 - w1 * u0
    r0, r1, r2 = relative[0] + d0, relative[1] + d1, relative[2] + d2
    p0, p1, p2 = a[ORIGIN_AT] + d0, a[ORIGIN_AT + 1] + d1, a[ORIGIN_AT + 2] + d2

    # from a point of the surface's own geometry to P
    o0, o1, o2 = geometry[ORIGIN], geometry[ORIGIN + 1], geometry[ORIGIN + 2]
    f0 = r0 - (b[0] * o0 + b[1] * o1 + b[2] * o2)
    f1 = r1 - (b[3] * o0 + b[4] * o1 + b[5] * o2)
    f2 = r2 - (b[6] * o0 + b[7] * o1 + b[8] * o2)
    t0, t1, t2 = geometry[AXIS], geometry[AXIS + 1], geometry[AXIS + 2]
    x0 = b[0] * t0 + b[1] * t1 + b[2] * t2
    x1 = b[3] * t0 + b[4] * t1 + b[5] * t2
    x2 = b[6] * t0 + b[7] * t1 + b[8] * t2

    if kind == PLANE:
        n0, n1, n2 = x0, x1, x2
        h0 = h1 = h2 = 0.0
        gap = n0 * f0 + n1 * f1 + n2 * f2
    else:
        e0, e1, e2 = v0, v1, v2
        if kind == CYLINDER:
            along = x0 * f0 + x1 * f1 + x2 * f2
            f0, f1, f2 = f0 - along * x0, f1 - along * x1, f2 - along * x2
            along = x0 * v0 + x1 * v1 + x2 * v2
            e0, e1, e2 = v0 - along * x0, v1 - along * x1, v2 - along * x2
        side = geometry[SIDE]
        distance = math.sqrt(f0 * f0 + f1 * f1 + f2 * f2)
        # at the very centre there is no normal
        inverse = side / distance if distance > 0.0 else math.nan
        n0, n1, n2 = f0 * inverse, f1 * inverse, f2 * inverse
        along = n0 * e0 + n1 * e1 + n2 * e2
        # n turns with the part of V across the surface's curved directions
        h0 = (e0 - along * n0) * inverse
        h1 = (e1 - along * n1) * inverse
        h2 = (e2 - along * n2) * inverse
        gap = side * (distance - geometry[RADIUS])

    out[AT], out[AT + 1], out[AT + 2] = p0, p1, p2
    out[NORMAL] = into_object * n0
    out[NORMAL + 1] = into_object * n1
    out[NORMAL + 2] = into_object * n2
    out[SLIP], out[SLIP + 1], out[SLIP + 2] = v0, v1, v2
    out[NORMAL_RATE], out[NORMAL_RATE + 1], out[NORMAL_RATE + 2] = h0, h1, h2
    out[GAP] = gap - geometry[TIP_RADIUS]
    out[POINT_RATE], out[POINT_RATE + 1], out[POINT_RATE + 2] = v0, v1, v2
    out[GAP_RATE] = n0 * v0 + n1 * v1 + n2 * v2
    out[GAP_BIAS] = h0 * v0 + h1 * v1 + h2 * v2 + n0 * s0 + n1 * s1 + n2 * s2
