r"""Derivatives of the contact rows between two bodies with respect to their relative motion.

Seen from the second body, and in its axes, the first one has the pose :math:`X`, the velocity
:math:`V = (v, \omega)` of its origin and the acceleration :math:`A = (a, \alpha)`.  All rows depend
on these only, and so does the wrench :math:`w` of their forces on the second body:

.. math::
    \ddot\varphi_k = g_k(X)\cdot A + Q_k(X, V), \qquad
    w = \sum_k \lambda_k \begin{bmatrix} e_k \\ P_k \times e_k \end{bmatrix}(X)

with :math:`Q_k` quadratic in V.  Both come from :func:`multiarm.contacts.kernel.write_row`, for any
kind of row.  So the derivatives by A and V are exact: a value, and a central difference.  Those by
the pose would need third derivatives of all surfaces; they are central differences of order four
of single rows, :math:`f' = (8 (f_1 - f_{-1}) - f_2 + f_{-2}) / 12 h`, whose errors are about 1e-11
of the row: truncation :math:`h^4 f^{(5)} / 30`, roundings :math:`\epsilon f / h`.

*Tips on planes of the second body*, of which welds and balls consist, have closed forms.  With the
plane's normal n, and the tip at d from the first body's origin,

.. math::
    \dot\varphi &= n\cdot(v + \omega\times d), \qquad
    \ddot\varphi = n\cdot(a + \alpha\times d + \omega\times(\omega\times d)), \qquad
    \delta d = \theta\times d, \\
    \delta\dot\varphi &= \theta\cdot(d\times(n\times\omega)) + \ldots, \qquad
    \delta\ddot\varphi = \theta\cdot\big(d\times(n\times\alpha
    + (n\times\omega)\times\omega)\big)
    + \delta\omega\cdot\big((\omega\times d)\times n + d\times(n\times\omega)\big) + \ldots

A displacement of the pose is a twist :math:`u = (\delta, \theta)`: the origin moves by
:math:`\delta`, and the axes turn by :math:`\exp(\theta)` about it.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import open_contact, write_row
from multiarm.contacts.motion import BODY_WIDTH, motion_relative_to, open_body
from multiarm.contacts.table import ON_PLANE, is_of_joints, open_code, open_geometry
from multiarm.dynamics.layout import TWIST
from multiarm.geometry.records import SURFACE_ON_OBJECT
from multiarm.geometry.stencils import CENTRAL_4
from multiarm.jit.kernels import clear, inlined, kernel
from multiarm.jit.rows import offset_of
from multiarm.jit.vectors import (
    AXES,
    ZERO,
    add,
    add_cross,
    add_scaled,
    cross,
    put,
    rotate,
    rotate_back,
    scale,
    sub,
    vec,
)
from multiarm.robots.derivatives import DISPLACEMENT_WIDTH, Displacement, open_displacement

# Displacement of a difference [m, rad]: a hundredth of the smallest radius that a finger has.
STEP = 1e-4
# Columns of a row's derivatives: a displacement of the seen motion; the pose again, for gap rates.
RATE_BY_POSE, SLOPES_WIDTH = DISPLACEMENT_WIDTH, DISPLACEMENT_WIDTH + TWIST
SHIFT, VELOCITY, ACCELERATION = (
    offset_of(Displacement, name) for name in ("shift", "velocity", "acceleration")
)
# Row of the wrenches with the value, after its derivatives by the pose that is seen.
VALUE = TWIST
# Rows of scratch: displacements of both bodies, and of the first as the second sees it; its seen
# motion, as it is and displaced; the second's, at rest.
OF_FIRST, OF_SECOND, OF_SEEN, SEEN, MOVED, STILL, SCRATCH_ROWS = range(7)
# Bodies that no joint of the block moves: the base, and with it the world; the first object, after
# which the others follow downwards.
BASE, FIRST_OBJECT = -1, -2


@kernel
def differentiate_connection(model, data, rows, bodies, placement, columns, gaps, work):
    """Write what the equations of a block take from rows between two bodies.

    By the C coordinates of :class:`multiarm.dynamics.coordinates.BlockColumns`.

    Parameters
    ----------
    rows : (int, int)
        First row and end.
    bodies : (int, int)
        First and second body as in :func:`write_body_displacement`, whose motions and displacements
        are in ``work`` (:class:`multiarm.dynamics.equation_derivatives.EquationWork`).
    placement : int
        First column of a displacement of these contacts.
    gaps : (N_i, C), written
        Derivatives of the second derivatives of the gaps by time; in ``work.rates`` are those of
        the first ones, and in ``on_first`` and ``on_second`` those of the wrenches.
    """
    first, last = rows
    scratch, slopes, wrench = work.scratch, work.slopes, work.wrench
    seen = motion_relative_to(open_body(work.first_body), open_body(work.second_body))
    write_seen_motion(work.first_body, work.second_body, seen, scratch[SEEN])
    if are_flat(model, first, last):
        differentiate_flat_rows(model, first, last, work)
    else:
        differentiate_rows(model, data, first, last, work)
    by = scratch[OF_SEEN]
    for c in range(columns.end):
        write_column_displacement(bodies, placement, columns, c, seen, work)
        for k in range(first, last):
            total = rate = 0.0
            for j in range(DISPLACEMENT_WIDTH):
                total += slopes[k, j] * by[j]
            for j in range(TWIST):
                rate += slopes[k, RATE_BY_POSE + j] * by[j]
                rate += slopes[k, ACCELERATION + j] * by[VELOCITY + j]
            gaps[k - first, c], work.rates[k, c] = total, rate
        moves = 1.0 if c < columns.placement else 0.0
        displace_wrenches(scratch[SEEN], wrench, by, moves, work.on_first[c], work.on_second[c])
    write_wrenches(
        scratch[SEEN], wrench[VALUE], work.on_first[columns.end], work.on_second[columns.end]
    )


@kernel
def write_column_displacement(bodies, placement, columns, c, seen, work):
    """Write how two bodies, and the first one as the second sees it, are displaced in a column.

    From column ``placement`` on, six are displacements of the contacts against the first one.
    """
    of_first, of_second = work.scratch[OF_FIRST], work.scratch[OF_SECOND]
    write_body_displacement(bodies[0], columns, c, work.first_moved, of_first)
    write_body_displacement(bodies[1], columns, c, work.second_moved, of_second)
    if placement <= c < placement + TWIST:
        displace_contacts(work.first_body, c - placement, of_first)
    write_seen_displacement(
        work.first_body, work.second_body, seen, of_first, of_second, work.scratch[OF_SEEN]
    )


@inlined
def write_body_displacement(body, columns, c, moved, out):
    """Write how a body is displaced in a column.

    ``body`` is the joint of the block that moves it, counted from 0, ``BASE``, or an object, see
    ``FIRST_OBJECT``; ``moved`` (2 n, 18) has the displacements by the block's joints.
    """
    clear(out)
    if c < columns.positions:
        of_object = TWIST * (FIRST_OBJECT - body)
        k = c - of_object if c < columns.twists else c - columns.twists - of_object
        if body <= FIRST_OBJECT and 0 <= k < TWIST:
            out[k if c < columns.twists else VELOCITY + k] = 1.0
    elif c < columns.placement and body >= 0:
        for j in range(DISPLACEMENT_WIDTH):
            out[j] = moved[c - columns.positions, j]


@kernel
def are_flat(model, first, last):
    """Whether all rows are tips on planes of the second body, or belong to joints."""
    for k in range(first, last):
        code = open_code(model.contacts.codes[k])
        on_object = code.kind == ON_PLANE and code.surface_body == SURFACE_ON_OBJECT
        if not (on_object or is_of_joints(code.kind)):
            return False
    return True


@kernel
def differentiate_flat_rows(model, first, last, work):
    """The results of :func:`differentiate_rows` for tips on planes of the second body."""
    motion, slopes, wrench = work.scratch[SEEN], work.slopes, work.wrench
    seen = open_body(motion)
    R, x, w, w_rate = seen.rotation, seen.origin, seen.spin, seen.spin_rate
    for i in range(wrench.shape[0]):
        clear(wrench[i])
    for k in range(first, last):
        clear(slopes[k])
        if is_of_joints(open_code(model.contacts.codes[k]).kind):
            continue
        contact = open_geometry(model.contacts.geometry[k])
        d, n = rotate(R, contact.tip), contact.axis
        across = cross(n, w)
        by = open_displacement(slopes[k])
        by.acceleration, by.spin_rate = n, cross(d, n)
        by.turn = cross(d, add_cross(cross(n, w_rate), across, w))
        by.spin = add_cross(cross(cross(w, d), n), d, across)
        put(slopes[k], RATE_BY_POSE + 3, cross(d, across))
        force = scale(-work.force[k], n)
        put(wrench[VALUE], 0, add(vec(wrench[VALUE], 0), force))
        put(wrench[VALUE], 3, add_cross(vec(wrench[VALUE], 3), add(x, d), force))
        for axis in range(3):
            e = AXES[axis]
            put(wrench[axis], 3, add_cross(vec(wrench[axis], 3), e, force))
            put(wrench[3 + axis], 3, add_cross(vec(wrench[3 + axis], 3), cross(e, d), force))


@kernel
def differentiate_rows(model, data, first, last, work):
    """Write the derivatives of the rows by the seen motion, and those of their wrench by its pose.

    Of a row, ``work.slopes`` has those of the gap's second derivative by a displacement, and those
    of its rate by the pose.  ``work.wrench`` is on the second body in its axes; its last row is the
    value.
    """
    slopes, wrench, rows = work.slopes, work.wrench, work.rows
    motion, moved = work.scratch[SEEN], work.scratch[MOVED]
    for i in range(wrench.shape[0]):
        clear(wrench[i])
    write_rows_at(model, data, first, last, motion, work)
    for k in range(first, last):
        clear(slopes[k])
        contact = open_contact(rows[k])
        e, lever = contact.normal, sub(contact.point, open_body(motion).origin)
        turn = add(cross(lever, e), contact.couple)
        by = open_displacement(slopes[k])
        by.acceleration, by.spin_rate = scale(-1.0, e), scale(-1.0, turn)
    add_wrench(rows, first, last, work.force, 1.0, wrench[VALUE])
    for axis in range(TWIST):
        for point in range(len(CENTRAL_4.offsets)):
            displace(motion, axis, CENTRAL_4.offsets[point] * STEP, moved)
            write_rows_at(model, data, first, last, moved, work)
            weight = CENTRAL_4.weights[point] / STEP
            for k in range(first, last):
                contact = open_contact(rows[k])
                slopes[k, SHIFT + axis] += weight * contact.gap_bias
                slopes[k, RATE_BY_POSE + axis] += weight * contact.gap_rate
            add_wrench(rows, first, last, work.force, weight, wrench[axis])
        for sign in (-1.0, 1.0):
            displace(motion, axis, 0.0, moved)
            twist = open_body(moved)
            if axis < 3:
                twist.velocity = add_scaled(twist.velocity, sign, AXES[axis])
            else:
                twist.spin = add_scaled(twist.spin, sign, AXES[axis - 3])
            write_rows_at(model, data, first, last, moved, work)
            for k in range(first, last):
                slopes[k, VELOCITY + axis] += 0.5 * sign * open_contact(rows[k]).gap_bias


@kernel
def write_rows_at(model, data, first, last, motion, work):
    """Write the rows ``first`` to ``last`` for a motion seen from the second body."""
    still, rows, parts = work.scratch[STILL], work.rows, work.parts
    for k in range(first, last):
        write_row(k, motion, still, model.contacts, rows, parts, data.search)


@kernel
def add_wrench(rows, first, last, force, weight, out):
    """Add the resultant of the forces on the second body, times a weight."""
    for k in range(first, last):
        contact, share = open_contact(rows[k]), weight * force[k]
        e = contact.normal
        turn = add(cross(contact.point, e), contact.couple)
        put(out, 0, add_scaled(vec(out, 0), share, e))
        put(out, 3, add_scaled(vec(out, 3), share, turn))


@kernel
def displace(motion, axis, amount, moved):
    """Write a seen motion whose pose is displaced along or about an axis of the second body."""
    for j in range(BODY_WIDTH):
        moved[j] = motion[j]
    body = open_body(moved)
    if axis < 3:
        body.origin = add_scaled(body.origin, amount, AXES[axis])
        return
    e, c, s = AXES[axis - 3], math.cos(amount), math.sin(amount)
    x, y, z = body.rotation
    body.rotation = turned(x, e, c, s), turned(y, e, c, s), turned(z, e, c, s)


@inlined
def turned(a, e, cosine, sine):
    """A vector turned about a unit vector ``e``."""
    b = cross(e, a)
    return add_scaled(add_scaled(a, sine, b), 1.0 - cosine, cross(e, b))


# --- motions --------------------------------------------------------------------------------------


@kernel
def displace_contacts(body, c, out):
    """Write the displacement of contacts that are moved against their body, world axes.

    Along or about one of the body's axes; it stays the same in these.
    """
    motion, displacement = open_body(body), open_displacement(out)
    axis, w = motion.rotation[c % 3], motion.spin
    if c >= 3:
        displacement.turn = axis
        return
    rate = cross(w, axis)
    displacement.shift, displacement.velocity = axis, rate
    displacement.acceleration = add_cross(cross(motion.spin_rate, axis), w, rate)


@kernel
def write_seen_motion(first_body, second_body, seen, out):
    """Write the first body's motion as the second sees it, in its axes, for the contact rows."""
    R, motion, (d, V, spin, A, spin_rate) = open_body(second_body).rotation, open_body(out), seen
    x, y, z = open_body(first_body).rotation
    motion.rotation = rotate_back(R, x), rotate_back(R, y), rotate_back(R, z)
    motion.origin, motion.velocity, motion.spin = (
        rotate_back(R, d), rotate_back(R, V), rotate_back(R, spin)
    )  # fmt: skip
    motion.acceleration, motion.spin_rate = rotate_back(R, A), rotate_back(R, spin_rate)


@kernel
def write_seen_displacement(first_body, second_body, seen, of_first, of_second, out):
    """Write the displacement of the seen motion by displacements of the two in world axes."""
    motion, (d, V, spin, A, spin_rate) = open_body(second_body), seen
    by_first, by_second, by = (
        open_displacement(of_first), open_displacement(of_second), open_displacement(out)
    )  # fmt: skip
    R, w, w_rate, turn = motion.rotation, motion.spin, motion.spin_rate, by_second.turn
    dw, dw_first = by_second.spin, by_first.spin
    dd = sub(by_first.shift, by_second.shift)
    dc = add_cross(cross(dw, d), w, dd)
    dV = sub(sub(by_first.velocity, by_second.velocity), dc)
    dA = sub(by_first.acceleration, by_second.acceleration)
    dA = sub(dA, add_cross(cross(by_second.spin_rate, d), w_rate, dd))
    dA = sub(dA, cross(dw, add_scaled(cross(w, d), 2.0, V)))
    dA = sub(dA, cross(w, add_scaled(dc, 2.0, dV)))
    rate = sub(by_first.spin_rate, by_second.spin_rate)
    rate = sub(rate, add_cross(cross(dw, open_body(first_body).spin), w, dw_first))
    # the second body's axes turn
    by.shift = rotate_back(R, add_cross(dd, d, turn))
    by.turn = rotate_back(R, sub(by_first.turn, turn))
    by.velocity = rotate_back(R, add_cross(dV, V, turn))
    by.spin = rotate_back(R, add_cross(sub(dw_first, dw), spin, turn))
    by.acceleration = rotate_back(R, add_cross(dA, A, turn))
    by.spin_rate = rotate_back(R, add_cross(rate, spin_rate, turn))


# --- wrenches -------------------------------------------------------------------------------------


@kernel
def write_wrenches(seen, wrench, on_first, on_second):
    """Write the rows' wrench on either body, about its origin in its axes.

    ``wrench`` is that on the second body.
    """
    motion, force, moment = open_body(seen), vec(wrench, 0), vec(wrench, 3)
    R, r = motion.rotation, motion.origin
    put(on_first, 0, scale(-1.0, rotate_back(R, force)))
    put(on_first, 3, rotate_back(R, sub(cross(r, force), moment)))
    put(on_second, 0, force)
    put(on_second, 3, moment)


@kernel
def displace_wrenches(seen, wrench, by, moves, on_first, on_second):
    """Write the derivatives of the two wrenches by a displacement of the seen motion.

    In the axes of either body.  ``wrench`` (7, 6) is that of the rows; ``moves`` is 1 where the
    first body moves with its contacts, and 0 where these alone are displaced.
    """
    motion = open_body(seen)
    R, r = motion.rotation, motion.origin
    force, moment = vec(wrench[VALUE], 0), vec(wrench[VALUE], 3)
    df, dm = ZERO, ZERO
    for axis in range(TWIST):
        df = add_scaled(df, by[axis], vec(wrench[axis], 0))
        dm = add_scaled(dm, by[axis], vec(wrench[axis], 3))
    put(on_second, 0, df)
    put(on_second, 3, dm)
    displacement = open_displacement(by)
    turn, shift = scale(moves, displacement.turn), scale(moves, displacement.shift)
    put(on_first, 0, scale(-1.0, rotate_back(R, add_cross(df, force, turn))))
    moment = sub(moment, cross(r, force))
    dm = sub(sub(dm, cross(shift, force)), cross(r, df))
    put(on_first, 3, scale(-1.0, rotate_back(R, add_cross(dm, moment, turn))))
