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

import numpy as np

from multiarm.contacts.motion import (
    RELATIVE_WIDTH,
    motion_at,
    open_body,
    open_relative,
    write_relative_motion,
)
from multiarm.contacts.surfaces import QUERY_WIDTH, open_query, world_distance
from multiarm.contacts.table import (
    COMBINED,
    GEOMETRY_WIDTH,
    ON_CYLINDER,
    ON_PLANE,
    ON_SURFACE,
    PAIR,
    TANGENT,
    ContactGeometry,
    is_in_closed_form,
    is_of_joints,
    open_code,
    open_geometry,
    open_tangent,
)
from multiarm.geometry.records import SURFACE_ON_OBJECT
from multiarm.jit.kernels import inlined, kernel, larger, plain
from multiarm.jit.rows import Number, Rotation, Vector, lanes_of, offset_of, row_of, width
from multiarm.jit.simd import LANES, broadcast, gather_pack, transpose_four
from multiarm.jit.structs import Floats1, Floats2, Int, Numbers
from multiarm.jit.vectors import (
    ZERO,
    across,
    add,
    add_cross,
    add_outer,
    add_scaled,
    add_symmetric,
    broadcast_vector,
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


class UserSurfaces(Numbers):
    """The surfaces of users."""

    callback: Int  # address of the function that answers a query; 0: there are none


class ContactSearch(NamedTuple):
    """What rows need that are not in closed form; with S shapes of the table."""

    relative: Floats1  # (15,) scratch: :class:`~multiarm.contacts.motion.RelativeRow`
    query: Floats1  # (14,) scratch: :class:`~multiarm.contacts.surfaces.Query`
    user: UserSurfaces
    # (S, 3) contact points of two surfaces in the guiding body's frame, at the guide's shape: those
    # from which Newton's method starts, and (written) those to which it leads
    guesses: Floats2
    points: Floats2


def make_search(guesses: np.ndarray) -> ContactSearch:
    """Allocate for contacts of two surfaces that are searched from these points."""
    return ContactSearch(
        relative=np.zeros(RELATIVE_WIDTH),
        query=np.zeros(QUERY_WIDTH),
        user=UserSurfaces(),
        guesses=guesses,
        points=np.zeros_like(guesses),
    )


CONTACT_WIDTH = width(ContactRow)
ROW_LANES = LANES * CONTACT_WIDTH
open_contact, open_patch = row_of(ContactRow), row_of(PatchRow)
open_row_lanes = lanes_of(ContactRow)
TIP, ORIGIN, AXIS, TIP_RADIUS = (
    offset_of(ContactGeometry, name) for name in ("tip", "origin", "axis", "tip_radius")
)
FEWEST_IN_PACKS = 3
"""Rows that are written in less time four at a time than one by one."""

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
        ``ON_PLANE``, ``ON_SPHERE`` or ``ON_CYLINDER``.
    into_object : float
        -1 when the surface is the object's (its outward normal then points out of the object).
    geometry : float64 (13,)
        A :class:`~multiarm.contacts.table.ContactGeometry`.
    a, b : float64 (24,)
        Kinematics of the body with the point and of the body with the surface.
    relative : float64 (15,)
        From :func:`multiarm.contacts.motion.write_relative_motion` of the two.
    out : float64 (18,), written
        A :class:`ContactRow`.
    """
    R_B, contact = open_body(b).rotation, open_geometry(geometry)
    d = rotate(open_body(a).rotation, contact.tip)
    V, A = motion_at(relative, d)
    # from a point of the surface's own geometry to P
    f = sub(add(open_relative(relative).shift, d), rotate(R_B, contact.origin))
    axis = rotate(R_B, contact.axis)
    if kind == ON_PLANE:
        n, n_rate, gap = axis, ZERO, dot(axis, f)
    else:
        turning = V
        if kind == ON_CYLINDER:
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
def write_rows_in_closed_form(first, end, link, body, table, relative, packs, rows):
    """Write those rows of an arm, from ``first`` to ``end``, that are in closed form.

    Nearly all rows are; they share the relative motion ``relative`` (15,), written.  Those of tips
    on planes of one body are written four at a time, in ``packs`` (``ROW_LANES``,), written.  For
    the other arguments see :func:`write_row`, which writes the rest.  Returns whether there is
    none.
    """
    if are_planes(first, end, table.codes):
        if open_code(table.codes[first]).surface_body == SURFACE_ON_OBJECT:
            write_planes(first, end, -1.0, link, body, table, relative, packs, rows)
        else:
            write_planes(first, end, 1.0, body, link, table, relative, packs, rows)
        return True
    seen_from, complete = -1, True
    for k in range(first, end):
        code = open_code(table.codes[k])
        kind, surface_body = code.kind, code.surface_body
        if not is_in_closed_form(kind):
            complete = False
        elif surface_body == SURFACE_ON_OBJECT:
            if seen_from != surface_body:
                write_relative_motion(link, body, relative)
                seen_from = surface_body
            contact_kinematics(kind, -1.0, table.geometry[k], link, body, relative, rows[k])
        else:
            if seen_from != surface_body:
                write_relative_motion(body, link, relative)
                seen_from = surface_body
            contact_kinematics(kind, 1.0, table.geometry[k], body, link, relative, rows[k])
    return complete


@inlined
def are_planes(first, end, codes):
    """Whether all rows are of tips on planes of one body, and enough of them for packs."""
    if end - first < FEWEST_IN_PACKS:
        return False
    body = open_code(codes[first]).surface_body
    for k in range(first, end):
        code = open_code(codes[k])
        if code.kind != ON_PLANE or code.surface_body != body:
            return False
    return True


@kernel
def write_planes(first, end, into_object, a, b, table, relative, packs, rows):
    """:func:`contact_kinematics` of tips on planes, four rows at a time; the last one may recur."""
    write_relative_motion(a, b, relative)
    body, seen, zero = open_body(a), open_relative(relative), broadcast(0.0)
    (x, y, z), (u, v, w) = body.rotation, open_body(b).rotation
    R_A = broadcast_vector(x), broadcast_vector(y), broadcast_vector(z)
    R_B = broadcast_vector(u), broadcast_vector(v), broadcast_vector(w)
    shift, spin = broadcast_vector(seen.shift), broadcast_vector(seen.spin)
    velocity, acceleration = broadcast_vector(seen.velocity), broadcast_vector(seen.acceleration)
    spin_rate, origin = broadcast_vector(seen.spin_rate), broadcast_vector(body.origin)
    row, geometry = open_row_lanes(packs, 0), table.geometry
    row.couple, row.normal_rate = (zero, zero, zero), (zero, zero, zero)
    for k in range(first, end, LANES):
        r1, r2, r3 = min(k + 1, end - 1), min(k + 2, end - 1), min(k + 3, end - 1)
        g0, g1, g2, g3 = (
            GEOMETRY_WIDTH * k, GEOMETRY_WIDTH * r1, GEOMETRY_WIDTH * r2, GEOMETRY_WIDTH * r3
        )  # fmt: skip
        d = rotate(R_A, gather_vector(geometry, TIP, g0, g1, g2, g3))
        n = rotate(R_B, gather_vector(geometry, AXIS, g0, g1, g2, g3))
        of_plane = rotate(R_B, gather_vector(geometry, ORIGIN, g0, g1, g2, g3))
        radius = gather_pack(
            geometry, g0 + TIP_RADIUS, g1 + TIP_RADIUS, g2 + TIP_RADIUS, g3 + TIP_RADIUS
        )
        turning = cross(spin, d)
        V = add(velocity, turning)
        A = add_cross(add_cross(acceleration, spin_rate, d), spin, turning)
        row.point, row.point_rate = add(origin, d), V
        row.normal = scale(broadcast(into_object), n)
        row.gap, row.gap_rate = dot(n, sub(add(shift, d), of_plane)) - radius, dot(n, V)
        row.gap_bias = dot(n, A)
        for number in range(0, CONTACT_WIDTH, LANES):
            at = min(number, CONTACT_WIDTH - LANES)  # the last four may overlap those before
            transpose_four(
                packs, LANES * at, rows, CONTACT_WIDTH * k + at, CONTACT_WIDTH * r1 + at,
                CONTACT_WIDTH * r2 + at, CONTACT_WIDTH * r3 + at,
            )  # fmt: skip


@inlined
def gather_vector(numbers, at, g0, g1, g2, g3):
    """The vectors that begin at one place of four rows."""
    return (
        gather_pack(numbers, g0 + at, g1 + at, g2 + at, g3 + at),
        gather_pack(numbers, g0 + at + 1, g1 + at + 1, g2 + at + 1, g3 + at + 1),
        gather_pack(numbers, g0 + at + 2, g1 + at + 2, g2 + at + 2, g3 + at + 2),
    )


@kernel
def write_row(k, link, body, table, rows, parts, search):
    """Write row ``k`` of an arm's contacts, of any kind, into ``rows[k]``.

    Rows in closed form stand before those that follow from them.

    Parameters
    ----------
    k : int
    link, body : (24,)
        Kinematics of the arm's link and of the object.
    table : view of a ContactTable
    rows, parts : (N, 18), (P, 18), written
        Contact kinematics of the rows, and of the parts of combined rows.
    search : view of a ContactSearch
    """
    code = open_code(table.codes[k])
    if code.kind == TANGENT:
        _write_tangent(k, link, body, table, rows, parts, search)
    elif is_of_joints(code.kind):  # it belongs to joints of the arm and has no contact
        for i in range(CONTACT_WIDTH):
            rows[k, i] = 0.0
    elif code.kind == COMBINED:
        first = code.first_part
        at = first - rows.shape[0]
        for j in range(code.parts):
            write_contact(first + j, link, body, table, search, parts[at + j])
        _combine(open_geometry(table.geometry[k]).weight, parts, at, code.parts, rows[k])
    else:
        write_contact(k, link, body, table, search, rows[k])


@inlined
def bodies_of(code, link, body):
    """The body with the point, that with the guiding surface, and the sign of ``e`` along n."""
    if code.surface_body == SURFACE_ON_OBJECT:
        return link, body, -1.0
    return body, link, 1.0


@kernel
def write_contact(k, link, body, table, search, out):
    """Write the kinematics of the contact of two surfaces of any kinds, record ``k``."""
    code = open_code(table.codes[k])
    a, b, sign = bodies_of(code, link, body)
    write_relative_motion(a, b, search.relative)
    if code.kind == ON_SURFACE:
        _write_tip_on_surface(k, sign, a, b, table, search, out)
    elif code.kind == PAIR:
        _write_pair(code.shape, sign, a, b, table, search, out)
    else:
        contact_kinematics(code.kind, sign, table.geometry[k], a, b, search.relative, out)


@kernel
def _write_tip_on_surface(k, sign, a, b, table, search, out):
    """A tip on a surface of any kind."""
    contact, surface = open_geometry(table.geometry[k]), open_query(search.query)
    shape = table.shapes[open_code(table.codes[k]).shape]
    d = rotate(open_body(a).rotation, contact.tip)
    V, A = motion_at(search.relative, d)
    at = add(open_relative(search.relative).shift, d)
    world_distance(shape, b, at, search.query, search.user.callback)
    n, n_rate = surface.gradient, times(surface.second, V)
    gap = surface.distance - contact.tip_radius
    put_contact(out, sign, add(open_body(a).origin, d), V, n, n_rate, gap, V, A)


@inlined
def _regular(H, n):
    """``H`` and its size; along ``n`` it gets a curvature of this size, to be well scaled."""
    k = abs(H[0]) + abs(H[3]) + abs(H[5])
    return add_outer(H, k, n), k


@kernel
def locate_pair(shape, a, b, table, search, place):
    r"""Newton's method for the common normal of two surfaces; returns whether there is one.

    Solves :math:`P(n_A + n_B) = 0, s_B = 0` with ``P`` across :math:`n_B`.  ``shape`` is the number
    of B's surface, A's is the next one.  ``place`` (3,), in B's frame, holds the guess and then the
    point of B's surface on that normal; ``search.relative`` is the motion of A seen from B.
    """
    R, r = open_body(b).rotation, open_relative(search.relative).shift
    z, step = rotate(R, vec(place, 0)), ZERO
    before, share, last = math.inf, 1.0, False
    for _ in range(600):  # at most 50 steps of 12 halvings
        trial = add(z, step)
        s, n, H = distance_of(shape, b, trial, table, search)
        _, n_A, H_A = distance_of(shape + 1, a, sub(trial, r), table, search)
        g = add(n_A, n)
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
        H, k = _regular(add_symmetric(H, H_A), n)
        step = scale(-1.0, solve(H, add_scaled(g, k * s, n)))
        # one more step, which is quadratic, from 1e-9 rad between the normals
        last = angle < 1e-9 and abs(s) * k < 1e-9
    return False


@inlined
def distance_of(shape, body, d, table, search):
    """Signed distance of a point from a surface on a body, with gradient and second derivatives.

    ``d`` is the point relative to the body's origin, world axes.
    """
    surface = open_query(search.query)
    world_distance(table.shapes[shape], body, d, search.query, search.user.callback)
    return surface.distance, surface.gradient, surface.second


@kernel
def _write_pair(shape, sign, a, b, table, search, out):
    """Two curved surfaces, B's of this number."""
    place = search.points[shape]
    put(place, 0, vec(search.guesses[shape], 0))
    r, Omega = open_relative(search.relative).shift, open_relative(search.relative).spin
    if not locate_pair(shape, a, b, table, search, place):
        for i in range(CONTACT_WIDTH):
            out[i] = math.nan
        return
    z = rotate(open_body(b).rotation, vec(place, 0))
    d = sub(z, r)
    V, A = motion_at(search.relative, d)
    s_A, _, H_A = distance_of(shape + 1, a, d, table, search)
    s_B, n, H_B = distance_of(shape, b, z, table, search)
    H_A_V = times(H_A, V)
    g = add_cross(H_A_V, Omega, n)
    H, _ = _regular(add_symmetric(H_A, H_B), n)
    u = solve(H, g)
    n_rate = times(H_B, u)
    put_contact(out, sign, add(open_body(b).origin, z), u, n, n_rate, s_A + s_B, V, A)
    bias = dot(n, A) - 2.0 * dot(n, cross(Omega, V)) + dot(V, H_A_V) - dot(u, g)
    open_contact(out).gap_bias = bias


@kernel
def _write_tangent(k, link, body, table, rows, parts, search):
    """No slip along a tangent of a contact, whose normal row is written, or is among the parts."""
    code = open_code(table.codes[k])
    normal = k - code.tangent
    base = rows[normal]
    if code.normal_part > 0:
        normal = code.normal_part
        base = parts[normal - rows.shape[0]]
        write_contact(normal, link, body, table, search, base)
    a, b, sign = bodies_of(code, link, body)
    write_relative_motion(a, b, search.relative)
    contact, directions = open_contact(base), open_tangent(table.geometry[k])
    n, n_rate = scale(sign, contact.normal), contact.normal_rate
    # the contact point on B and its rate; a tip's centre is a radius and a gap away
    away = rate = 0.0
    if open_code(table.codes[normal]).kind != PAIR:
        away = contact.gap + open_geometry(table.geometry[normal]).tip_radius
        rate = contact.gap_rate
    c = add_scaled(contact.point, -away, n)
    c_rate = add_scaled(add_scaled(contact.point_rate, -rate, n), -away, n_rate)
    V, A = motion_at(search.relative, sub(c, open_body(a).origin))
    # a direction of B across which the first tangent lies; near its pole, another one
    f = rotate(open_body(b).rotation, directions.first)
    t = cross(f, n)
    if not norm(t) > 0.2:  # sine of the angle between normal and direction
        f = rotate(open_body(b).rotation, directions.second)
        t = cross(f, n)
    inverse = 1.0 / norm(t)
    t = scale(inverse, t)
    t_rate = across(t, scale(inverse, cross(f, n_rate)))
    if code.tangent == 2:  # n x t and its rate
        t, t_rate = cross(n, t), add_cross(cross(n_rate, t), n, t_rate)
    A = add_cross(A, open_relative(search.relative).spin, sub(c_rate, V))
    put_contact(rows[k], sign, c, c_rate, t, t_rate, 0.0, V, A)


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
    if not (is_in_closed_form(kind) or kind == ON_SURFACE):  # there is no tip
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
