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
    OMEGA,
    ORIGIN_AT,
    POINT_RATE,
    R_0,
    contact_kinematics,
    motion_at,
    put_contact,
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
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.vectors import (
    ZERO,
    across,
    add,
    add_cross,
    add_outer,
    add_scaled,
    add_symmetric,
    cross,
    dot,
    norm,
    put,
    rotate,
    rotate_back,
    rotation,
    scale,
    solve,
    sub,
    symmetric,
    times,
    vec,
)

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
def write_rows(first, count, arm, body, relative, codes, geometry, rows, struct, i, other):
    """Write ``count`` rows of arm ``i`` from ``first`` on; for the arguments see ``write_row``.

    Tips on planes, spheres and cylinders, which nearly all rows are, share the relative motion
    (``relative``, 15).  The entry at address ``other`` writes the others, see ``write_row``.
    """
    seen_from = -1
    for k in range(first, first + count):
        kind, surface_body = codes[k, KIND], codes[k, SURFACE_BODY]
        if kind > CYLINDER:
            call_cfunc(other, struct, float(k), float(i))
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


@kernel
def _curved(sign, geometry, a, b, shape, relative, query, calls, row):
    """A tip on a surface of any kind."""
    d = rotate(rotation(a, 0), vec(geometry, POINT))
    V, A = motion_at(relative, d)
    world_distance(shape, b, add(vec(relative, R_0), d), query, calls)
    n, n_rate = vec(query, GRADIENT), times(symmetric(query, SECOND), V)
    gap = query[DISTANCE] - geometry[TIP_RADIUS]
    put_contact(row, sign, add(vec(a, ORIGIN_AT), d), V, n, n_rate, gap, V, A)


@inlined
def _regular(H, n):
    """``H`` and its size; along ``n`` it gets a curvature of this size, to be well scaled."""
    k = abs(H[0]) + abs(H[3]) + abs(H[5])
    return add_outer(H, k, n), k


@kernel
def locate_pair(a, b, shapes, first, r, query, calls, place):
    r"""Newton's method for the common normal of two surfaces; returns whether it was found.

    Solves :math:`P(n_A + n_B) = 0, s_B = 0` with ``P`` across :math:`n_B`.  ``place`` (3,), in B's
    frame, holds the guess and then the point of B's surface on that normal; ``r`` is A's origin
    seen from B's, a tuple in world axes.
    """
    R = rotation(b, 0)
    z, step = rotate(R, vec(place, 0)), ZERO
    before, share, last = math.inf, 1.0, False
    for _ in range(_STEPS * _HALVINGS):
        trial = add(z, step)
        world_distance(shapes[first], b, trial, query, calls)
        s, n, H = query[DISTANCE], vec(query, GRADIENT), symmetric(query, SECOND)
        world_distance(shapes[first + 1], a, sub(trial, r), query, calls)
        g = add(vec(query, GRADIENT), n)
        along = dot(g, n)
        g = add_scaled(g, -along, n)
        # opposite normals: along = 0; equal ones (along = 2) are no contact
        angle = norm(g) + (along if along > 1.0 else 0.0)
        if not angle < math.inf:
            if before == math.inf:
                return False
            angle = math.inf
        if last and angle < math.inf:
            put(place, 0, rotate_back(R, trial))
            return True
        if angle > before and share > 1e-3:
            share *= 0.5
            step = scale(0.5, step)
            continue
        z, before, share = trial, angle, 1.0
        H, k = _regular(add_symmetric(H, symmetric(query, SECOND)), n)
        step = scale(-1.0, solve(H, add_scaled(g, k * s, n)))
        last = angle < _ALMOST and abs(s) * k < _ALMOST
    return False


@kernel
def _pair(sign, a, b, shapes, first, relative, query, calls, place, located, row):
    """Two curved surfaces, see the module's text."""
    put(located, 0, vec(place, 0))
    r, Omega = vec(relative, R_0), vec(relative, OMEGA)
    if not locate_pair(a, b, shapes, first, r, query, calls, located):
        for i in range(CONTACT_WIDTH):
            row[i] = math.nan
        return
    z = rotate(rotation(b, 0), vec(located, 0))
    d = sub(z, r)
    V, A = motion_at(relative, d)
    world_distance(shapes[first + 1], a, d, query, calls)
    gap, H_A = query[DISTANCE], symmetric(query, SECOND)
    world_distance(shapes[first], b, z, query, calls)
    gap += query[DISTANCE]
    n, H_B = vec(query, GRADIENT), symmetric(query, SECOND)
    H_A_V = times(H_A, V)
    g = add_cross(H_A_V, Omega, n)
    H, _ = _regular(add_symmetric(H_A, H_B), n)
    u = solve(H, g)
    put_contact(row, sign, add(vec(b, ORIGIN_AT), z), u, n, times(H_B, u), gap, V, A)
    row[GAP_BIAS] = dot(n, A) - 2.0 * dot(n, cross(Omega, V)) + dot(V, H_A_V) - dot(u, g)


@inlined
def _no_slip(k, normal, sign, a, b, codes, geometry, base, row, relative):
    """No slip along the tangent of row ``k`` at the contact whose normal row has this number."""
    n, n_rate = scale(sign, vec(base, NORMAL)), vec(base, NORMAL_RATE)
    # the contact point on B and its rate; a tip's centre is a radius and a gap away
    away = rate = 0.0
    if codes[normal, KIND] != PAIR:
        away, rate = base[GAP] + geometry[normal, TIP_RADIUS], base[GAP_RATE]
    c = add_scaled(vec(base, AT), -away, n)
    c_rate = add_scaled(add_scaled(vec(base, POINT_RATE), -rate, n), -away, n_rate)
    V, A = motion_at(relative, sub(c, vec(a, ORIGIN_AT)))
    # a direction of B across which the first tangent lies; near its pole, another one
    f = rotate(rotation(b, 0), vec(geometry[k], AXIS))
    t = cross(f, n)
    if not norm(t) > _NEAR_POLE:
        f = rotate(rotation(b, 0), vec(geometry[k], ORIGIN))
        t = cross(f, n)
    inverse = 1.0 / norm(t)
    t = scale(inverse, t)
    t_rate = across(t, scale(inverse, cross(f, n_rate)))
    if codes[k, LINK] == 2:  # n x t and its rate
        t, t_rate = cross(n, t), add_cross(cross(n_rate, t), n, t_rate)
    A = add_cross(A, vec(relative, OMEGA), sub(c_rate, V))
    put_contact(row, sign, c, c_rate, t, t_rate, 0.0, V, A)


@inlined
def _combine(weight, parts, at, count, row):
    """``weight`` times the first part, less the second: a wrench of force and couple."""
    first = parts[at]
    for i in range(CONTACT_WIDTH):
        row[i] = weight * first[i]
    put(row, AT, vec(first, AT))
    put(row, COUPLE, ZERO)
    if count == 1:
        return
    other = parts[at + 1]
    e = scale(-weight, vec(other, NORMAL))
    put(row, NORMAL, add(vec(row, NORMAL), e))
    put(row, COUPLE, cross(sub(vec(other, AT), vec(first, AT)), e))
    for i in (GAP, GAP_RATE, GAP_BIAS):
        row[i] -= weight * other[i]
