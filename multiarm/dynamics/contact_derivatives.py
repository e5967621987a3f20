r"""Derivatives of the contact rows of a joint with respect to the relative motion of its bodies.

Seen from the object, and in its axes, an arm's link has the pose :math:`X`, the velocity
:math:`V = (v, \omega)` of its origin and the acceleration :math:`A = (a, \alpha)`.  All rows of the
joint depend on these only:

.. math::
    \ddot\varphi_k = g_k(X)\cdot A + Q_k(X, V), \qquad
    w = \sum_k \lambda_k \begin{bmatrix} e_k \\ P_k \times e_k \end{bmatrix}(X)

with :math:`Q_k` quadratic in V.  Both come from :func:`multiarm.contacts.kernel.write_row`, for any
kind of row.  So the derivatives by A and V are exact: a value, and a central difference.  Those by
the pose would need third derivatives of all surfaces; they are central differences of order four
of single rows, :math:`f' = (8 (f_1 - f_{-1}) - f_2 + f_{-2}) / 12 h`, whose errors are about 1e-11
of the row: truncation :math:`h^4 f^{(5)} / 30`, roundings :math:`\epsilon f / h`.

*Tips on planes of the object*, of which welds and balls consist, have closed forms.  With the
plane's normal n, and the tip at d from the link's origin,

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

from multiarm.arms.derivatives import DISPLACEMENT_WIDTH, Displacement, open_displacement
from multiarm.contacts.kernel import open_contact, write_row
from multiarm.contacts.motion import BODY_WIDTH, motion_relative_to, open_body
from multiarm.contacts.table import JOINT, ON_PLANE, open_code, open_geometry
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

# Displacement of a difference [m, rad]: a hundredth of the smallest radius that a finger has.
STEP = 1e-4
# Columns of a row's derivatives: a displacement of the seen motion; the pose again, for gap rates.
RATE_BY_POSE, SLOPES_WIDTH = DISPLACEMENT_WIDTH, DISPLACEMENT_WIDTH + TWIST
SHIFT, VELOCITY, ACCELERATION = (
    offset_of(Displacement, name) for name in ("shift", "velocity", "acceleration")
)
# Row of the wrenches with the value, after its derivatives by the pose that is seen.
VALUE = TWIST
# Rows of scratch: displacements of object and link, and of the link as the object sees it; its seen
# motion, as it is and displaced; the object's, at rest.
OF_BODY, OF_LINK, OF_SEEN, SEEN, MOVED, STILL, SCRATCH_ROWS = range(7)


@kernel
def differentiate_joint(model, data, first, last, columns, gaps, work):
    """Write what the equations of an arm take from its joint, rows ``first`` to ``last``.

    By the C coordinates of :class:`multiarm.dynamics.coordinates.ArmColumns`.  Written: ``gaps``
    (N_i, C), the derivatives of the second derivatives of the joint's gaps by time, and in ``work``
    (:class:`multiarm.dynamics.equation_derivatives.EquationWork`) ``rates``, those of the first
    ones, ``on_object`` and ``on_link``.
    """
    body, link, scratch, slopes = work.body, work.link, work.scratch, work.slopes
    seen, wrench = motion_relative_to(open_body(link), open_body(body)), work.wrench
    write_seen_motion(body, link, seen, scratch[SEEN])
    if are_flat(model, first, last):
        differentiate_flat_rows(model, first, last, work)
    else:
        differentiate_rows(model, data, first, last, work)
    of_body, by = scratch[OF_BODY], scratch[OF_SEEN]
    for c in range(columns.end):
        write_column_displacement(columns, c, seen, work)
        for k in range(first, last):
            total = rate = 0.0
            for j in range(DISPLACEMENT_WIDTH):
                total += slopes[k, j] * by[j]
            for j in range(TWIST):
                rate += slopes[k, RATE_BY_POSE + j] * by[j]
                rate += slopes[k, ACCELERATION + j] * by[VELOCITY + j]
            gaps[k - first, c], work.rates[k, c] = total, rate
        moves = 1.0 if c < columns.placement else 0.0
        turn = open_displacement(of_body).turn
        displace_wrenches(
            body, scratch[SEEN], wrench, turn, by, moves, work.on_object[c], work.on_link[c]
        )
    write_wrench_on_bodies(
        body, scratch[SEEN], wrench[VALUE], work.on_object[columns.end], work.on_link[columns.end]
    )


@kernel
def write_column_displacement(columns, c, seen, work):
    """Write how object and link, and the link as the object sees it, are displaced in a column."""
    of_body, of_link = work.scratch[OF_BODY], work.scratch[OF_LINK]
    clear(of_body)
    clear(of_link)
    if c < columns.positions:
        of_body[c] = 1.0
    elif c < columns.placement:
        for j in range(DISPLACEMENT_WIDTH):
            of_link[j] = work.moved[c - columns.positions, j]
    else:
        displace_contacts(work.link, c - columns.placement, of_link)
    write_seen_displacement(work.body, work.link, seen, of_body, of_link, work.scratch[OF_SEEN])


@kernel
def are_flat(model, first, last):
    """Whether all rows are tips on planes of the object, or belong to joints."""
    for k in range(first, last):
        code = open_code(model.contacts.codes[k])
        on_object = code.kind == ON_PLANE and code.surface_body == SURFACE_ON_OBJECT
        if not (on_object or code.kind == JOINT):
            return False
    return True


@kernel
def differentiate_flat_rows(model, first, last, work):
    """The results of :func:`differentiate_rows` for tips on planes of the object."""
    motion, slopes, wrench = work.scratch[SEEN], work.slopes, work.wrench
    seen = open_body(motion)
    R, x, w, w_rate = seen.rotation, seen.origin, seen.spin, seen.spin_rate
    for i in range(wrench.shape[0]):
        clear(wrench[i])
    for k in range(first, last):
        clear(slopes[k])
        if open_code(model.contacts.codes[k]).kind == JOINT:
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
    of its rate by the pose.  ``work.wrench`` is in the object's axes; its last row is the value.
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
    """Write the rows ``first`` to ``last`` of an arm for a motion seen from the object."""
    still, rows, parts = work.scratch[STILL], work.rows, work.parts
    for k in range(first, last):
        write_row(k, motion, still, model.contacts, rows, parts, data.search)


@kernel
def add_wrench(rows, first, last, force, weight, out):
    """Add the resultant of the forces on the object, times a weight."""
    for k in range(first, last):
        contact, share = open_contact(rows[k]), weight * force[k]
        e = contact.normal
        turn = add(cross(contact.point, e), contact.couple)
        put(out, 0, add_scaled(vec(out, 0), share, e))
        put(out, 3, add_scaled(vec(out, 3), share, turn))


@kernel
def displace(motion, axis, amount, moved):
    """Write a seen motion whose pose is displaced along or about an axis of the object."""
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
def displace_contacts(link, c, out):
    """Write the displacement of contacts that are moved against the link, world axes.

    Along or about one of the link's axes; it stays the same in these.
    """
    motion, displacement = open_body(link), open_displacement(out)
    axis, w = motion.rotation[c % 3], motion.spin
    if c >= 3:
        displacement.turn = axis
        return
    rate = cross(w, axis)
    displacement.shift, displacement.velocity = axis, rate
    displacement.acceleration = add_cross(cross(motion.spin_rate, axis), w, rate)


@kernel
def write_seen_motion(body, link, seen, out):
    """Write the link's motion as the object sees it, in its axes, for the contact rows."""
    R, motion, (d, V, spin, A, spin_rate) = open_body(body).rotation, open_body(out), seen
    x, y, z = open_body(link).rotation
    motion.rotation = rotate_back(R, x), rotate_back(R, y), rotate_back(R, z)
    motion.origin, motion.velocity, motion.spin = (
        rotate_back(R, d), rotate_back(R, V), rotate_back(R, spin)
    )  # fmt: skip
    motion.acceleration, motion.spin_rate = rotate_back(R, A), rotate_back(R, spin_rate)


@kernel
def write_seen_displacement(body, link, seen, of_body, of_link, out):
    """Write the displacement of the seen motion by displacements of the two in world axes."""
    motion, (d, V, spin, A, spin_rate) = open_body(body), seen
    by_body, by_link, by = (
        open_displacement(of_body), open_displacement(of_link), open_displacement(out)
    )  # fmt: skip
    R, w, w_rate, turn = motion.rotation, motion.spin, motion.spin_rate, by_body.turn
    dw, dw_link = by_body.spin, by_link.spin
    dd = sub(by_link.shift, by_body.shift)
    dc = add_cross(cross(dw, d), w, dd)
    dV = sub(sub(by_link.velocity, by_body.velocity), dc)
    dA = sub(by_link.acceleration, by_body.acceleration)
    dA = sub(dA, add_cross(cross(by_body.spin_rate, d), w_rate, dd))
    dA = sub(dA, cross(dw, add_scaled(cross(w, d), 2.0, V)))
    dA = sub(dA, cross(w, add_scaled(dc, 2.0, dV)))
    rate = sub(by_link.spin_rate, by_body.spin_rate)
    rate = sub(rate, add_cross(cross(dw, open_body(link).spin), w, dw_link))
    # the object's axes turn
    by.shift = rotate_back(R, add_cross(dd, d, turn))
    by.turn = rotate_back(R, sub(by_link.turn, turn))
    by.velocity = rotate_back(R, add_cross(dV, V, turn))
    by.spin = rotate_back(R, add_cross(sub(dw_link, dw), spin, turn))
    by.acceleration = rotate_back(R, add_cross(dA, A, turn))
    by.spin_rate = rotate_back(R, add_cross(rate, spin_rate, turn))


@kernel
def write_wrench_on_bodies(body, seen, wrench, on_object, on_link):
    """Write the contacts' wrench on the object, world axes, and the opposite one on the link."""
    motion = open_body(seen)
    R_o, R, r = open_body(body).rotation, motion.rotation, motion.origin
    force, moment = vec(wrench, 0), vec(wrench, 3)
    put(on_object, 0, rotate(R_o, force))
    put(on_object, 3, rotate(R_o, moment))
    put(on_link, 0, scale(-1.0, rotate_back(R, force)))
    put(on_link, 3, rotate_back(R, sub(cross(r, force), moment)))


@kernel
def displace_wrenches(body, seen, wrench, turn_o, by, moves, on_object, on_link):
    """Write the derivatives of the two wrenches by a displacement of the seen motion.

    The object turns by ``turn_o``, world axes; ``wrench`` (7, 6) is that of the rows; ``moves`` is
    1 where the link moves with its contacts, and 0 where these alone are displaced.
    """
    motion = open_body(seen)
    R_o, R, r = open_body(body).rotation, motion.rotation, motion.origin
    force, moment = vec(wrench[VALUE], 0), vec(wrench[VALUE], 3)
    df, dm = ZERO, ZERO
    for axis in range(TWIST):
        df = add_scaled(df, by[axis], vec(wrench[axis], 0))
        dm = add_scaled(dm, by[axis], vec(wrench[axis], 3))
    put(on_object, 0, add_cross(rotate(R_o, df), turn_o, rotate(R_o, force)))
    put(on_object, 3, add_cross(rotate(R_o, dm), turn_o, rotate(R_o, moment)))
    displacement = open_displacement(by)
    turn, shift = scale(moves, displacement.turn), scale(moves, displacement.shift)
    put(on_link, 0, scale(-1.0, rotate_back(R, add_cross(df, force, turn))))
    moment = sub(moment, cross(r, force))
    dm = sub(sub(dm, cross(shift, force)), cross(r, df))
    put(on_link, 3, scale(-1.0, rotate_back(R, add_cross(dm, moment, turn))))
