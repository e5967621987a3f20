r"""The rows of W beyond a fingertip on a plane, a sphere or a cylinder.

All are seen by an observer on body B, which carries the guiding surface; body A moves with
:math:`V_0, \Omega, A_0, \Omega'` (:func:`multiarm.contacts.kernel.relative_motion`).  With the
signed distance ``s`` of a surface (:mod:`multiarm.contacts.surfaces`), its normal
:math:`n = \nabla s` and :math:`H = \nabla^2 s`:

*A tip on a curved surface* has the gap :math:`\varphi = s_B(P) - \rho` at its centre ``P`` and

.. math:: \dot\varphi = n\cdot V, \qquad \ddot\varphi = n\cdot A + V\cdot H V, \qquad \dot n = H V .

*Two curved surfaces*: along their common normal line the gradients of both distances are opposite
and the sum of the distances stands still.  Hence the gap is the stationary value
:math:`\varphi = s_A(z) + s_B(z)`, and by the theorem of the envelope, with :math:`n = n_B`,

.. math::
    \dot\varphi = n\cdot V(z), \qquad (H_A + H_B)\, u = \Omega\times n + H_A V, \qquad
    \dot n = H_B u \\
    \ddot\varphi = n\cdot A(z) - 2\,n\cdot(\Omega\times V) + V\cdot H_A V
                 - u\cdot(\Omega\times n + H_A V)

where ``z`` is taken on B's surface and ``u`` is its velocity there.  This is the thesis's (3.12) to
(3.19) without the singular direction along the normal, and exact at any gap.  The 2 by 2 tangential
system is singular when the surfaces touch along a line.

*No slip* along a tangent ``t`` of B at the contact point ``c``, which moves with :math:`\dot c`:

.. math:: \psi = t\cdot V(c), \qquad
    \dot\psi = \dot t\cdot V + t\cdot\big(A(c) + \Omega\times(\dot c - V)\big).

There is no position function; the gap of such a row is zero (thesis, 3.9.2).

*Combinations* are sums of the rows above.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import (
    AT,
    CONTACT_WIDTH,
    COUPLE,
    GAP,
    GAP_BIAS,
    GAP_RATE,
    NORMAL,
    NORMAL_RATE,
    ORIGIN_AT,
    POINT_RATE,
    SLIP,
    contact_kinematics,
    relative_motion,
)
from multiarm.contacts.records import (
    AXIS,
    COMBINED,
    COUNT,
    CURVED,
    CYLINDER,
    JOINT,
    KIND,
    LINK,
    ORIGIN,
    PAIR,
    POINT,
    SURFACE_BODY,
    SURFACE_ON_OBJECT,
    TANGENT,
    TIP_RADIUS,
    WEIGHT,
)
from multiarm.contacts.surfaces import DISTANCE, GRADIENT, SECOND, world_distance
from multiarm.lowlevel import call_entry, inlined, kernel

# Newton's method for the common normal of two surfaces.
_STEPS, _HALVINGS = 50, 12
# The normals are opposite to this angle before the last, quadratic, step [rad].
_ALMOST = 1e-9
# Smallest curvature across the contact, relative to the largest: below, two surfaces touch along a
# line and there is no contact point.
LINE_CONTACT = 1e-9
# Sine of the angle between normal and reference below which the other reference is taken.
_NEAR_POLE = 0.2


@inlined
def write_rows(first, count, arm, body, relative, codes, geometry, rows, book, i, other):
    """Write ``count`` rows of arm ``i`` from ``first`` on; for the arguments see ``write_row``.

    Tips on planes, spheres and cylinders, which nearly all rows are, share the relative motion
    (``relative``, 15).  The entry at address ``other`` writes the others, see ``write_row``.
    """
    seen_from = -1
    for k in range(first, first + count):
        kind, surface_body = codes[k, KIND], codes[k, SURFACE_BODY]
        if kind > CYLINDER:
            call_entry(other, book, float(k), float(i))
        elif surface_body == SURFACE_ON_OBJECT:
            if seen_from != surface_body:
                relative_motion(arm, body, relative)
                seen_from = surface_body
            contact_kinematics(kind, -1.0, geometry[k], arm, body, relative, rows[k])
        else:
            if seen_from != surface_body:
                relative_motion(body, arm, relative)
                seen_from = surface_body
            contact_kinematics(kind, 1.0, geometry[k], body, arm, relative, rows[k])


@kernel
def write_row(k, arm, body, codes, geometry, shapes, calls, rows, parts, scratch, places, located):
    """Write row ``k`` of an arm's contacts, of any kind, into ``rows[k]``.

    Parameters
    ----------
    k : int
    arm, body : (24,)
        Kinematics of the arm's link and of the object.
    codes, geometry, shapes
        The contact table, see :class:`multiarm.contacts.records.ContactTable`.
    calls : int
        Address of the callback that answers for the user's surfaces.
    rows, parts : (N, 18), (P, 18), written
        Contact kinematics of the rows, and of the parts of combined rows.
    scratch : (29,)
        Relative motion (15) and a query (14).
    places, located : (S, 3)
        Where the contacts of two surfaces were last time, in B's frame, and (written) are now.
    """
    kind = codes[k, KIND]
    if kind == TANGENT:
        normal, base = k - codes[k, LINK], rows[k - codes[k, LINK]]
        if codes[k, COUNT] > 0:  # it has its normal row among the parts
            normal, base = codes[k, COUNT], parts[codes[k, COUNT] - rows.shape[0]]
            write_contact(
                codes[normal], geometry[normal], arm, body, shapes, calls, base, scratch, places,
                located,
            )  # fmt: skip
        if codes[k, SURFACE_BODY] == SURFACE_ON_OBJECT:
            relative_motion(arm, body, scratch)
            _no_slip(k, normal, -1.0, arm, body, codes, geometry, base, rows[k], scratch)
        else:
            relative_motion(body, arm, scratch)
            _no_slip(k, normal, 1.0, body, arm, codes, geometry, base, rows[k], scratch)
        return
    if kind == JOINT:  # nothing of it belongs to a contact
        for i in range(CONTACT_WIDTH):
            rows[k, i] = 0.0
        return
    if kind != COMBINED:
        write_contact(
            codes[k], geometry[k], arm, body, shapes, calls, rows[k], scratch, places, located
        )
        return
    first, count = codes[k, LINK], codes[k, COUNT]
    at = first - rows.shape[0]
    for j in range(count):
        write_contact(
            codes[first + j], geometry[first + j], arm, body, shapes, calls, parts[at + j], scratch,
            places, located,
        )  # fmt: skip
    _combine(geometry[k, WEIGHT], parts, at, count, rows[k])


@kernel
def write_contact(code, geometry, arm, body, shapes, calls, row, scratch, places, located):
    """Kinematics of one contact of two surfaces, of whatever kind."""
    if code[SURFACE_BODY] == SURFACE_ON_OBJECT:
        a, b, sign = arm, body, -1.0
    else:
        a, b, sign = body, arm, 1.0
    relative = scratch[0:15]
    query = scratch[15:29]
    relative_motion(a, b, relative)
    kind, first = code[KIND], code[LINK]
    if kind == CURVED:
        _curved(sign, geometry, a, b, shapes[first], relative, query, calls, row)
    elif kind == PAIR:
        _pair(sign, a, b, shapes, first, relative, query, calls, places[first], located[first], row)
    else:
        contact_kinematics(kind, sign, geometry, a, b, relative, row)


@inlined
def _times(query, v0, v1, v2):
    """Second derivatives in a query times a vector."""
    i = SECOND
    return (
        query[i] * v0 + query[i + 1] * v1 + query[i + 2] * v2,
        query[i + 1] * v0 + query[i + 3] * v1 + query[i + 4] * v2,
        query[i + 2] * v0 + query[i + 4] * v1 + query[i + 5] * v2,
    )


@inlined
def _motion_at(relative, d0, d1, d2):
    """Velocity and acceleration, seen from B, of A's material point at ``d`` from A's origin."""
    w0, w1, w2 = relative[6], relative[7], relative[8]
    u0, u1, u2 = w1 * d2 - w2 * d1, w2 * d0 - w0 * d2, w0 * d1 - w1 * d0
    g0, g1, g2 = relative[12], relative[13], relative[14]
    return (
        relative[3] + u0,
        relative[4] + u1,
        relative[5] + u2,
        relative[9] + g1 * d2 - g2 * d1 + w1 * u2 - w2 * u1,
        relative[10] + g2 * d0 - g0 * d2 + w2 * u0 - w0 * u2,
        relative[11] + g0 * d1 - g1 * d0 + w0 * u1 - w1 * u0,
    )


@kernel
def _curved(sign, geometry, a, b, shape, relative, query, calls, row):
    """A tip on a surface of any kind."""
    p0, p1, p2 = geometry[POINT], geometry[POINT + 1], geometry[POINT + 2]
    d0 = a[0] * p0 + a[1] * p1 + a[2] * p2
    d1 = a[3] * p0 + a[4] * p1 + a[5] * p2
    d2 = a[6] * p0 + a[7] * p1 + a[8] * p2
    v0, v1, v2, s0, s1, s2 = _motion_at(relative, d0, d1, d2)
    world_distance(shape, b, relative[0] + d0, relative[1] + d1, relative[2] + d2, query, calls)
    n0, n1, n2 = query[GRADIENT], query[GRADIENT + 1], query[GRADIENT + 2]
    h0, h1, h2 = _times(query, v0, v1, v2)
    row[AT], row[AT + 1], row[AT + 2] = a[9] + d0, a[10] + d1, a[11] + d2
    row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = sign * n0, sign * n1, sign * n2
    row[SLIP], row[SLIP + 1], row[SLIP + 2] = v0, v1, v2
    row[NORMAL_RATE], row[NORMAL_RATE + 1], row[NORMAL_RATE + 2] = h0, h1, h2
    row[POINT_RATE], row[POINT_RATE + 1], row[POINT_RATE + 2] = v0, v1, v2
    row[GAP] = query[DISTANCE] - geometry[TIP_RADIUS]
    row[GAP_RATE] = n0 * v0 + n1 * v1 + n2 * v2
    row[GAP_BIAS] = h0 * v0 + h1 * v1 + h2 * v2 + n0 * s0 + n1 * s1 + n2 * s2


@inlined
def _solve_symmetric(m0, m1, m2, m3, m4, m5, b0, b1, b2):
    """Solution of a symmetric 3 by 3 system (xx, xy, xz, yy, yz, zz) by its adjugate."""
    c0, c1, c2 = m3 * m5 - m4 * m4, m2 * m4 - m1 * m5, m1 * m4 - m2 * m3
    inverse = 1.0 / (m0 * c0 + m1 * c1 + m2 * c2)
    c3, c4, c5 = m0 * m5 - m2 * m2, m1 * m2 - m0 * m4, m0 * m3 - m1 * m1
    return (
        inverse * (c0 * b0 + c1 * b1 + c2 * b2),
        inverse * (c1 * b0 + c3 * b1 + c4 * b2),
        inverse * (c2 * b0 + c4 * b1 + c5 * b2),
    )


@kernel
def locate_pair(a, b, shapes, first, r0, r1, r2, query, calls, place):
    r"""Newton's method for the common normal of two surfaces; returns whether it was found.

    Solves :math:`P(n_A + n_B) = 0, s_B = 0` with ``P`` across :math:`n_B`.  ``place`` (3,), in B's
    frame, holds the guess and then the point of B's surface on that normal; ``r`` is A's origin
    seen from B's, world axes.
    """
    z0 = b[0] * place[0] + b[1] * place[1] + b[2] * place[2]
    z1 = b[3] * place[0] + b[4] * place[1] + b[5] * place[2]
    z2 = b[6] * place[0] + b[7] * place[1] + b[8] * place[2]
    e0 = e1 = e2 = 0.0  # the step under trial
    before, share, last = math.inf, 1.0, False
    for _ in range(_STEPS * _HALVINGS):
        world_distance(shapes[first], b, z0 + e0, z1 + e1, z2 + e2, query, calls)
        s = query[DISTANCE]
        n0, n1, n2 = query[GRADIENT], query[GRADIENT + 1], query[GRADIENT + 2]
        m0, m1, m2 = query[SECOND], query[SECOND + 1], query[SECOND + 2]
        m3, m4, m5 = query[SECOND + 3], query[SECOND + 4], query[SECOND + 5]
        world_distance(shapes[first + 1], a, z0 + e0 - r0, z1 + e1 - r1, z2 + e2 - r2, query, calls)
        g0, g1, g2 = query[GRADIENT] + n0, query[GRADIENT + 1] + n1, query[GRADIENT + 2] + n2
        along = g0 * n0 + g1 * n1 + g2 * n2
        g0, g1, g2 = g0 - along * n0, g1 - along * n1, g2 - along * n2
        # opposite normals: along = 0; equal ones (along = 2) are no contact
        angle = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2) + (along if along > 1.0 else 0.0)
        if not angle < math.inf:
            if before == math.inf:
                return False
            angle = math.inf
        if last and angle < math.inf:
            place[0] = b[0] * (z0 + e0) + b[3] * (z1 + e1) + b[6] * (z2 + e2)
            place[1] = b[1] * (z0 + e0) + b[4] * (z1 + e1) + b[7] * (z2 + e2)
            place[2] = b[2] * (z0 + e0) + b[5] * (z1 + e1) + b[8] * (z2 + e2)
            return True
        if angle > before and share > 1e-3:
            share *= 0.5
            e0, e1, e2 = 0.5 * e0, 0.5 * e1, 0.5 * e2
            continue
        z0, z1, z2 = z0 + e0, z1 + e1, z2 + e2
        before, share = angle, 1.0
        m0, m1, m2 = m0 + query[SECOND], m1 + query[SECOND + 1], m2 + query[SECOND + 2]
        m3, m4, m5 = m3 + query[SECOND + 3], m4 + query[SECOND + 4], m5 + query[SECOND + 5]
        # the normal direction gets a curvature of the same size, so that the system is well scaled
        k = abs(m0) + abs(m3) + abs(m5)
        e0, e1, e2 = _solve_symmetric(
            m0 + k * n0 * n0, m1 + k * n0 * n1, m2 + k * n0 * n2, m3 + k * n1 * n1,
            m4 + k * n1 * n2, m5 + k * n2 * n2,
            -g0 - k * s * n0, -g1 - k * s * n1, -g2 - k * s * n2,
        )  # fmt: skip
        last = angle < _ALMOST and abs(s) * k < _ALMOST
    return False


@kernel
def _pair(sign, a, b, shapes, first, relative, query, calls, place, located, row):
    """Two curved surfaces, see the module's text."""
    for i in range(3):
        located[i] = place[i]
    r0, r1, r2 = relative[0], relative[1], relative[2]
    if not locate_pair(a, b, shapes, first, r0, r1, r2, query, calls, located):
        for i in range(CONTACT_WIDTH):
            row[i] = math.nan
        return
    z0 = b[0] * located[0] + b[1] * located[1] + b[2] * located[2]
    z1 = b[3] * located[0] + b[4] * located[1] + b[5] * located[2]
    z2 = b[6] * located[0] + b[7] * located[1] + b[8] * located[2]
    d0, d1, d2 = z0 - r0, z1 - r1, z2 - r2
    v0, v1, v2, s0, s1, s2 = _motion_at(relative, d0, d1, d2)
    world_distance(shapes[first + 1], a, d0, d1, d2, query, calls)
    gap = query[DISTANCE]
    f0, f1, f2 = _times(query, v0, v1, v2)  # H_A V
    m0, m1, m2 = query[SECOND], query[SECOND + 1], query[SECOND + 2]
    m3, m4, m5 = query[SECOND + 3], query[SECOND + 4], query[SECOND + 5]
    world_distance(shapes[first], b, z0, z1, z2, query, calls)
    gap += query[DISTANCE]
    n0, n1, n2 = query[GRADIENT], query[GRADIENT + 1], query[GRADIENT + 2]
    m0, m1, m2 = m0 + query[SECOND], m1 + query[SECOND + 1], m2 + query[SECOND + 2]
    m3, m4, m5 = m3 + query[SECOND + 3], m4 + query[SECOND + 4], m5 + query[SECOND + 5]
    k = abs(m0) + abs(m3) + abs(m5)
    w0, w1, w2 = relative[6], relative[7], relative[8]
    g0 = w1 * n2 - w2 * n1 + f0
    g1 = w2 * n0 - w0 * n2 + f1
    g2 = w0 * n1 - w1 * n0 + f2
    u0, u1, u2 = _solve_symmetric(
        m0 + k * n0 * n0, m1 + k * n0 * n1, m2 + k * n0 * n2, m3 + k * n1 * n1,
        m4 + k * n1 * n2, m5 + k * n2 * n2, g0, g1, g2,
    )  # fmt: skip
    h0, h1, h2 = _times(query, u0, u1, u2)
    turning = n0 * (w1 * v2 - w2 * v1) + n1 * (w2 * v0 - w0 * v2) + n2 * (w0 * v1 - w1 * v0)
    row[AT], row[AT + 1], row[AT + 2] = b[9] + z0, b[10] + z1, b[11] + z2
    row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = sign * n0, sign * n1, sign * n2
    row[SLIP], row[SLIP + 1], row[SLIP + 2] = v0, v1, v2
    row[NORMAL_RATE], row[NORMAL_RATE + 1], row[NORMAL_RATE + 2] = h0, h1, h2
    row[POINT_RATE], row[POINT_RATE + 1], row[POINT_RATE + 2] = u0, u1, u2
    row[GAP] = gap
    row[GAP_RATE] = n0 * v0 + n1 * v1 + n2 * v2
    row[GAP_BIAS] = (
        n0 * s0 + n1 * s1 + n2 * s2
        - 2.0 * turning
        + v0 * f0 + v1 * f1 + v2 * f2
        - (u0 * g0 + u1 * g1 + u2 * g2)
    )  # fmt: skip


@inlined
def _no_slip(k, normal, sign, a, b, codes, geometry, base, row, relative):
    """No slip along the tangent of row ``k`` at the contact whose normal row has this number."""
    number = codes[k, LINK]
    n0, n1, n2 = sign * base[NORMAL], sign * base[NORMAL + 1], sign * base[NORMAL + 2]
    h0, h1, h2 = base[NORMAL_RATE], base[NORMAL_RATE + 1], base[NORMAL_RATE + 2]
    # the contact point on B and its rate; a tip's centre is a radius and a gap away
    away = 0.0
    if codes[normal, KIND] != PAIR:
        away = base[GAP] + geometry[normal, TIP_RADIUS]
    rate = base[GAP_RATE] if codes[normal, KIND] != PAIR else 0.0
    c0, c1, c2 = base[AT] - away * n0, base[AT + 1] - away * n1, base[AT + 2] - away * n2
    q0 = base[POINT_RATE] - rate * n0 - away * h0
    q1 = base[POINT_RATE + 1] - rate * n1 - away * h1
    q2 = base[POINT_RATE + 2] - rate * n2 - away * h2
    v0, v1, v2, s0, s1, s2 = _motion_at(
        relative, c0 - a[ORIGIN_AT], c1 - a[ORIGIN_AT + 1], c2 - a[ORIGIN_AT + 2]
    )
    # a direction of B across which the first tangent lies; near its pole, another one
    at = AXIS
    for _ in range(2):
        x0, x1, x2 = geometry[k, at], geometry[k, at + 1], geometry[k, at + 2]
        f0 = b[0] * x0 + b[1] * x1 + b[2] * x2
        f1 = b[3] * x0 + b[4] * x1 + b[5] * x2
        f2 = b[6] * x0 + b[7] * x1 + b[8] * x2
        t0, t1, t2 = f1 * n2 - f2 * n1, f2 * n0 - f0 * n2, f0 * n1 - f1 * n0
        sine = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if sine > _NEAR_POLE:
            break
        at = ORIGIN
    t0, t1, t2 = t0 / sine, t1 / sine, t2 / sine
    d0, d1, d2 = (f1 * h2 - f2 * h1) / sine, (f2 * h0 - f0 * h2) / sine, (f0 * h1 - f1 * h0) / sine
    along = t0 * d0 + t1 * d1 + t2 * d2
    d0, d1, d2 = d0 - along * t0, d1 - along * t1, d2 - along * t2
    if number == 2:
        # n x t and its rate
        y0, y1, y2 = n1 * t2 - n2 * t1, n2 * t0 - n0 * t2, n0 * t1 - n1 * t0
        e0 = h1 * t2 - h2 * t1 + n1 * d2 - n2 * d1
        e1 = h2 * t0 - h0 * t2 + n2 * d0 - n0 * d2
        e2 = h0 * t1 - h1 * t0 + n0 * d1 - n1 * d0
        t0, t1, t2, d0, d1, d2 = y0, y1, y2, e0, e1, e2
    w0, w1, w2 = relative[6], relative[7], relative[8]
    o0, o1, o2 = q0 - v0, q1 - v1, q2 - v2
    s0, s1, s2 = s0 + w1 * o2 - w2 * o1, s1 + w2 * o0 - w0 * o2, s2 + w0 * o1 - w1 * o0
    row[AT], row[AT + 1], row[AT + 2] = c0, c1, c2
    row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = sign * t0, sign * t1, sign * t2
    row[SLIP], row[SLIP + 1], row[SLIP + 2] = v0, v1, v2
    row[NORMAL_RATE], row[NORMAL_RATE + 1], row[NORMAL_RATE + 2] = d0, d1, d2
    row[POINT_RATE], row[POINT_RATE + 1], row[POINT_RATE + 2] = q0, q1, q2
    row[GAP] = 0.0
    row[GAP_RATE] = t0 * v0 + t1 * v1 + t2 * v2
    row[GAP_BIAS] = d0 * v0 + d1 * v1 + d2 * v2 + t0 * s0 + t1 * s1 + t2 * s2


@inlined
def _combine(weight, parts, at, count, row):
    """``weight`` times the first part, less the second: a wrench of force and couple."""
    first = parts[at]
    for i in range(CONTACT_WIDTH):
        row[i] = weight * first[i]
    for i in range(3):
        row[AT + i] = first[AT + i]
        row[COUPLE + i] = 0.0
    if count == 1:
        return
    other = parts[at + 1]
    x0, x1, x2 = other[AT] - first[AT], other[AT + 1] - first[AT + 1], other[AT + 2] - first[AT + 2]
    e0, e1, e2 = -weight * other[NORMAL], -weight * other[NORMAL + 1], -weight * other[NORMAL + 2]
    for i in range(3):
        row[NORMAL + i] -= weight * other[NORMAL + i]
    row[COUPLE] = x1 * e2 - x2 * e1
    row[COUPLE + 1] = x2 * e0 - x0 * e2
    row[COUPLE + 2] = x0 * e1 - x1 * e0
    for i in (GAP, GAP_RATE, GAP_BIAS):
        row[i] -= weight * other[i]
