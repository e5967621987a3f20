r"""From contact records, poses and velocities to W, dW/dt, c and phi: one compiled kernel.

A contact joins a point ``P`` of body A with a surface of body B (arm and object, either way round).
Everything is in world axes, relative to an observer on B.  The motion of A relative to B is the
same for all contacts of a joint (:mod:`multiarm.contacts.motion`): its points move with ``V``
and ``A``.  A surface with outward unit normal ``n`` (a function of the point only, once B stands
still) has

.. math::
    \varphi = \text{gap}, \qquad \dot\varphi = n\cdot V, \qquad
    \ddot\varphi = \dot n\cdot V + n\cdot A .

The contact force acts along ``e``, the unit normal pointing *into the object*: ``e = -n`` when the
surface is the object's, ``e = n`` when it is the arm's.  Its wrench on the object, about the centre
of mass in world axes, is the row ``[e; (P - x_o) x e]``; the arm takes the opposite force at the
same point.  Hence with ``a_o`` the object's acceleration and ``a_j`` the joints',

.. math:: W_o^T a_o + W^T a_j = c, \qquad c = -\ddot\varphi\,|_{a_o = 0,\,a_j = 0}

which is the thesis's (4.9).  A spherical fingertip is the sharp point at its centre with the gap
reduced by its radius.  Planes, spheres and cylinders have closed forms.  All other surfaces are
known by their signed distance ``s`` (:mod:`multiarm.contacts.surfaces`), with
:math:`n = \nabla s` and :math:`H = \nabla^2 s`:

*A tip on a curved surface* has the gap :math:`\varphi = s_B(P) - \rho` at its centre ``P`` and

.. math:: \dot\varphi = n\cdot V, \qquad \ddot\varphi = n\cdot A + V\cdot H V, \qquad \dot n = H V .

*Two curved surfaces*: along their common normal the gradients of both distances are opposite and
the sum of the distances is stationary.  Hence the gap is the stationary value
:math:`\varphi = s_A(z) + s_B(z)`, and by the envelope theorem, with :math:`n = n_B`,

.. math::
    \dot\varphi = n\cdot V(z), \qquad (H_A + H_B)\, u = \Omega\times n + H_A V, \qquad
    \dot n = H_B u \\
    \ddot\varphi = n\cdot A(z) - 2\,n\cdot(\Omega\times V) + V\cdot H_A V
                 - u\cdot(\Omega\times n + H_A V)

where ``z`` is on B's surface and ``u`` is its velocity there.  This is the thesis's (3.12) to
(3.19) without the singular direction along the normal, and exact at any gap.  The 2 by 2 tangential
system is singular when the surfaces touch along a line.

*No slip* along a tangent ``t`` of B at the contact point ``c``, which moves with :math:`\dot c`:

.. math:: \psi = t\cdot V(c), \qquad
    \dot\psi = \dot t\cdot V + t\cdot\big(A(c) + \Omega\times(\dot c - V)\big).

There is no position function; the gap of such a row is zero (thesis, 3.9.2).

*Combined rows* are sums of the rows above.

Reference: S.Y. Ho, Analysis and Design of Multi-Arm Robotic Systems Manipulating Large Objects,
CUHK 1995, sections 3.7, 3.9 and Example 4.1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from multiarm.contacts.motion import motion_at, open_body, open_relative, relative_motion
from multiarm.contacts.surfaces import open_query, world_distance
from multiarm.contacts.table import (
    COMBINED,
    CURVED,
    JOINT,
    PAIR,
    TANGENT,
    open_code,
    open_geometry,
    open_tangent,
)
from multiarm.geometry.records import CYLINDER, PLANE, SURFACE_ON_OBJECT
from multiarm.jit.kernels import inlined, kernel, larger, plain
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.rows import Number, Rotation, Vector, row_of, width
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
    scale,
    solve,
    sub,
    times,
    vec,
)


class ContactRow(NamedTuple):
    """Kinematics of a row, world axes; those of a joint's row are its gap and gap rate alone."""

    point: Vector  # P [m]
    normal: Vector  # e, into the object
    couple: Vector  # of a combined row besides the force at P; else 0
    normal_rate: Vector  # of the surface's outward normal, seen from B [1/s]
    gap: Number  # [m]
    gap_rate: Number  # [m/s]
    gap_bias: Number  # second derivative of the gap at zero accelerations [m/s^2]
    point_rate: Vector  # of P, seen from B [m/s]


class PatchRow(NamedTuple):
    """A patch of a surface: ``rotation`` turns into its frame, where the corners of the box are."""

    rotation: Rotation
    origin: Vector  # [m]
    lower: Vector
    upper: Vector


CONTACT_WIDTH = width(ContactRow)
open_contact, open_patch = row_of(ContactRow), row_of(PatchRow)

# Two surfaces touch along a line, and have no contact point, where the smallest relative curvature
# across the contact is below this part of the largest.
LINE_CONTACT = 1e-9


@inlined
def put_contact(row, sign, point, point_rate, n, n_rate, gap, V, A):
    """Write a row of contact kinematics, for a force along ``sign n``; gap' = n.V."""
    contact = open_contact(row)
    contact.point, contact.point_rate = point, point_rate
    contact.normal, contact.normal_rate, contact.couple = scale(sign, n), n_rate, ZERO
    contact.gap, contact.gap_rate = gap, dot(n, V)
    contact.gap_bias = dot(n_rate, V) + dot(n, A)


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
        A :class:`~multiarm.contacts.table.ContactGeometry`.
    a, b : float64 (24,)
        Kinematics of the body with the point and of the body with the surface.
    relative : float64 (15,)
        From :func:`multiarm.contacts.motion.relative_motion` of the two.
    out : float64 (18,), written
        A :class:`ContactRow`.
    """
    R_B, contact = open_body(b).rotation, open_geometry(geometry)
    d = rotate(open_body(a).rotation, contact.tip)
    V, A = motion_at(relative, d)
    # from a point of the surface's own geometry to P
    f = sub(add(open_relative(relative).shift, d), rotate(R_B, contact.origin))
    axis = rotate(R_B, contact.axis)
    if kind == PLANE:
        n, n_rate, gap = axis, ZERO, dot(axis, f)
    else:
        turning = V
        if kind == CYLINDER:
            f, turning = across(axis, f), across(axis, V)
        side, distance = contact.side, norm(f)
        # at the very centre there is no normal
        inverse = side / distance if distance > 0.0 else math.nan
        n = scale(inverse, f)
        # n turns with the part of V across the surface's curved directions
        n_rate = scale(inverse, across(n, turning))
        gap = side * (distance - contact.radius)
    point = add(open_body(a).origin, d)
    put_contact(out, into_object, point, V, n, n_rate, gap - contact.tip_radius, V, A)


@inlined
def write_rows(first, count, arm, body, relative, codes, geometry, rows, struct, i, general):
    """Write ``count`` rows of arm ``i`` from ``first`` on; for the arguments see ``write_row``.

    Tips on planes, spheres and cylinders, which nearly all rows are, share the relative motion
    (``relative``, 15).  The function at address ``general`` calls ``write_row`` for the rest.
    """
    seen_from = -1
    for k in range(first, first + count):
        code = open_code(codes[k])
        kind, surface_body = code.kind, code.surface_body
        if kind > CYLINDER:
            call_cfunc(general, struct, float(k), float(i))
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
def write_row(
    k, arm, body, codes, geometry, shapes, calls, rows, parts, relative, query, places, located
):
    """Write row ``k`` of an arm's contacts, of any kind, into ``rows[k]``.

    Parameters
    ----------
    k : int
    arm, body : (24,)
        Kinematics of the arm's link and of the object.
    codes, geometry, shapes
        The contact table, see :class:`multiarm.contacts.table.ContactTable`.
    calls : int
        Address of the callback for user surfaces.
    rows, parts : (N, 18), (P, 18), written
        Contact kinematics of the rows, and of the parts of combined rows.
    relative : (15,), query : (14,), written
        A relative motion, and a query of a surface.
    places, located : (S, 3)
        Last contact points of two surfaces, in B's frame, and (written) those found now.
    """
    code = open_code(codes[k])
    kind = code.kind
    if kind == TANGENT:
        normal = k - code.tangent
        base = rows[normal]
        if code.normal_part > 0:  # it has its normal row among the parts
            normal = code.normal_part
            base = parts[normal - rows.shape[0]]
            write_contact(
                codes[normal], geometry[normal], arm, body, shapes, calls, base, relative, query,
                places, located,
            )  # fmt: skip
        if code.surface_body == SURFACE_ON_OBJECT:
            a, b, sign = arm, body, -1.0
        else:
            a, b, sign = body, arm, 1.0
        relative_motion(a, b, relative)
        _no_slip(k, normal, sign, a, b, codes, geometry, base, rows[k], relative)
        return
    if kind == JOINT:  # the row belongs to a joint of the arm and has no contact
        for i in range(CONTACT_WIDTH):
            rows[k, i] = 0.0
        return
    if kind != COMBINED:
        write_contact(
            codes[k], geometry[k], arm, body, shapes, calls, rows[k], relative, query, places,
            located,
        )  # fmt: skip
        return
    first, count = code.first_part, code.parts
    at = first - rows.shape[0]
    for j in range(count):
        write_contact(
            codes[first + j], geometry[first + j], arm, body, shapes, calls, parts[at + j],
            relative, query, places, located,
        )  # fmt: skip
    _combine(open_geometry(geometry[k]).weight, parts, at, count, rows[k])


@kernel
def write_contact(codes, geometry, arm, body, shapes, calls, row, relative, query, places, located):
    """Kinematics of one contact of two surfaces of any kinds."""
    code = open_code(codes)
    if code.surface_body == SURFACE_ON_OBJECT:
        a, b, sign = arm, body, -1.0
    else:
        a, b, sign = body, arm, 1.0
    relative_motion(a, b, relative)
    kind, first = code.kind, code.shape
    if kind == CURVED:
        _curved(sign, geometry, a, b, shapes[first], relative, query, calls, row)
    elif kind == PAIR:
        _pair(sign, a, b, shapes, first, relative, query, calls, places[first], located[first], row)
    else:
        contact_kinematics(kind, sign, geometry, a, b, relative, row)


@kernel
def _curved(sign, geometry, a, b, shape, relative, query, calls, row):
    """A tip on a surface of any kind."""
    contact, surface = open_geometry(geometry), open_query(query)
    d = rotate(open_body(a).rotation, contact.tip)
    V, A = motion_at(relative, d)
    world_distance(shape, b, add(open_relative(relative).shift, d), query, calls)
    n, n_rate = surface.gradient, times(surface.second, V)
    gap = surface.distance - contact.tip_radius
    put_contact(row, sign, add(open_body(a).origin, d), V, n, n_rate, gap, V, A)


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
    R, surface = open_body(b).rotation, open_query(query)
    z, step = rotate(R, vec(place, 0)), ZERO
    before, share, last = math.inf, 1.0, False
    for _ in range(600):  # at most 50 steps of 12 halvings
        trial = add(z, step)
        world_distance(shapes[first], b, trial, query, calls)
        s, n, H = surface.distance, surface.gradient, surface.second
        world_distance(shapes[first + 1], a, sub(trial, r), query, calls)
        g = add(surface.gradient, n)
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
        H, k = _regular(add_symmetric(H, surface.second), n)
        step = scale(-1.0, solve(H, add_scaled(g, k * s, n)))
        # one more step, which is quadratic, from 1e-9 rad between the normals
        last = angle < 1e-9 and abs(s) * k < 1e-9
    return False


@kernel
def _pair(sign, a, b, shapes, first, relative, query, calls, place, located, row):
    """Two curved surfaces."""
    put(located, 0, vec(place, 0))
    r, Omega = open_relative(relative).shift, open_relative(relative).spin
    surface = open_query(query)
    if not locate_pair(a, b, shapes, first, r, query, calls, located):
        for i in range(CONTACT_WIDTH):
            row[i] = math.nan
        return
    z = rotate(open_body(b).rotation, vec(located, 0))
    d = sub(z, r)
    V, A = motion_at(relative, d)
    world_distance(shapes[first + 1], a, d, query, calls)
    gap, H_A = surface.distance, surface.second
    world_distance(shapes[first], b, z, query, calls)
    gap += surface.distance
    n, H_B = surface.gradient, surface.second
    H_A_V = times(H_A, V)
    g = add_cross(H_A_V, Omega, n)
    H, _ = _regular(add_symmetric(H_A, H_B), n)
    u = solve(H, g)
    put_contact(row, sign, add(open_body(b).origin, z), u, n, times(H_B, u), gap, V, A)
    bias = dot(n, A) - 2.0 * dot(n, cross(Omega, V)) + dot(V, H_A_V) - dot(u, g)
    open_contact(row).gap_bias = bias


@inlined
def _no_slip(k, normal, sign, a, b, codes, geometry, base, row, relative):
    """No slip along the tangent of row ``k`` at the contact whose normal row has this number."""
    contact, directions = open_contact(base), open_tangent(geometry[k])
    n, n_rate = scale(sign, contact.normal), contact.normal_rate
    # the contact point on B and its rate; a tip's centre is a radius and a gap away
    away = rate = 0.0
    if open_code(codes[normal]).kind != PAIR:
        away = contact.gap + open_geometry(geometry[normal]).tip_radius
        rate = contact.gap_rate
    c = add_scaled(contact.point, -away, n)
    c_rate = add_scaled(add_scaled(contact.point_rate, -rate, n), -away, n_rate)
    V, A = motion_at(relative, sub(c, open_body(a).origin))
    # a direction of B across which the first tangent lies; near its pole, another one
    f = rotate(open_body(b).rotation, directions.first)
    t = cross(f, n)
    if not norm(t) > 0.2:  # sine of the angle between normal and direction
        f = rotate(open_body(b).rotation, directions.second)
        t = cross(f, n)
    inverse = 1.0 / norm(t)
    t = scale(inverse, t)
    t_rate = across(t, scale(inverse, cross(f, n_rate)))
    if open_code(codes[k]).tangent == 2:  # n x t and its rate
        t, t_rate = cross(n, t), add_cross(cross(n_rate, t), n, t_rate)
    A = add_cross(A, open_relative(relative).spin, sub(c_rate, V))
    put_contact(row, sign, c, c_rate, t, t_rate, 0.0, V, A)


@inlined
def _combine(weight, parts, at, count, row):
    """``weight`` times the difference of the parts: a wrench of force and couple."""
    for i in range(CONTACT_WIDTH):
        row[i] = weight * parts[at, i]
    contact, first = open_contact(row), open_contact(parts[at])
    contact.point, contact.couple = first.point, ZERO
    if count == 1:
        return
    second = open_contact(parts[at + 1])
    e = scale(-weight, second.normal)
    contact.normal = add(contact.normal, e)
    contact.couple = cross(sub(second.point, first.point), e)
    contact.gap -= weight * second.gap
    contact.gap_rate -= weight * second.gap_rate
    contact.gap_bias -= weight * second.gap_bias


@kernel
def greatest_gaps(rows):
    """Largest magnitudes of gaps and gap rates of rows (N, 18); NaN where any is."""
    gap = gap_rate = 0.0
    for k in range(rows.shape[0]):
        contact = open_contact(rows[k])
        gap, gap_rate = larger(gap, contact.gap), larger(gap_rate, contact.gap_rate)
    return gap, gap_rate


@inlined
def slip_of(rows, tangent):
    """Rates along the two tangents of a contact [m/s], whose first row is ``tangent``."""
    return open_contact(rows[tangent]).gap_rate, open_contact(rows[tangent + 1]).gap_rate


@plain
def tip_offset(kind, surface_body, tip_radius):
    """From a tip's centre to its contact point, along the normal into the object [m]."""
    if kind > CURVED:  # there is no tip
        return 0.0
    return tip_radius if surface_body == SURFACE_ON_OBJECT else -tip_radius


@inlined
def depth_in_patch(patch, point):
    """How far inside its patch (18,) a contact point is [m]; negative outside.

    The point is a tuple in the frame of the patch's body.
    """
    box = open_patch(patch)
    x = rotate(box.rotation, sub(point, box.origin))
    depth, above, below = math.inf, sub(x, box.lower), sub(box.upper, x)
    for j in range(3):
        depth = min(depth, above[j], below[j])
    return depth
