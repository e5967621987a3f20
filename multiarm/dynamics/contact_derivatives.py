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

A displacement of the pose is a twist :math:`u = (\delta, \theta)`: the origin moves by
:math:`\delta`, and the axes turn by :math:`\exp(\theta)` about it.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import (
    ACCELERATION,
    AT,
    BODY_WIDTH,
    COUPLE,
    GAP_BIAS,
    GAP_RATE,
    NORMAL,
    ORIGIN_AT,
    SPIN,
    SPIN_RATE,
    VELOCITY,
    write_row,
)
from multiarm.contacts.table import COMBINED, KIND
from multiarm.dynamics.arrays import CALLBACK_FAILED, OK, open_data, open_system
from multiarm.jit.kernels import INT, INTS, NUMBERS, TABLE, TRUTH, clear, kernel, plain
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.vectors import (
    ZERO,
    add,
    add_cross,
    add_scaled,
    cross,
    put,
    put_rotation,
    rotate,
    rotate_back,
    rotation,
    scale,
    sub,
    vec,
)
from multiarm.spatial import retract_into

# Displacement of a difference [m, rad]: a hundredth of the smallest radius that a finger has.
STEP = 1e-4
OFFSETS = (-2.0, -1.0, 1.0, 2.0)
# Parts of a motion and of its displacement.
PLACE, TURN, LINEAR, ANGULAR, LINEAR_RATE, ANGULAR_RATE, MOTION_WIDTH = range(0, 21, 3)
# Columns of a row's derivatives: a displacement of the seen motion; the pose again, for gap rates.
RATE_BY_POSE, SLOPES_WIDTH = MOTION_WIDTH, MOTION_WIDTH + 6
# A body: rotation (9, row by row), then its motion.
MOTION, BODY_SIZE = 9, 27
# Rows of scratch: the link's motion in world axes; displacements of object and link, and of the
# link as the object sees it; its seen motion, as it is and displaced; the object's, at rest.
WORLD, OF_BODY, OF_LINK, OF_SEEN, SEEN, MOVED, STILL, SCRATCH_ROWS = range(8)


@plain
def difference_weight(offset):
    """Weight of the value at an offset in a difference of order four [1/m, 1/rad]."""
    return (8.0 if abs(offset) < 1.5 else -2.0) / (12.0 * STEP * offset)


@kernel
def differentiate_forces(struct: INTS, closed_loop: TRUTH, found: TABLE):
    """Write derivatives of the right-hand sides, as functions of the state in the data.

    Those of ``h_o``, ``h`` and the rates of effects' states, (6 + n + e) columns, by displacements
    of the object's pose, its twist, joint positions, joint velocities and effects' states, a row
    each.  Without ``closed_loop`` the control's torques are left out of h.  At the end the data are
    as they were.  Returns a status.
    """
    data = open_data(struct)
    n = data.angles.size
    x, y, z, w = data.position[3], data.position[4], data.position[5], data.position[6]
    for column in range(found.shape[0]):
        row = found[column]
        clear(row)
        values, place = state_entry(data, column)
        before = values[place]
        for offset in OFFSETS:
            if 3 <= column < 6:
                h = offset * STEP
                about_x, about_y = h if column == 3 else 0.0, h if column == 4 else 0.0
                turn = (about_x, about_y, h - about_x - about_y)
                retract_into((x, y, z, w), turn, data.position[3:7])
            else:
                values[place] = before + offset * STEP
            status = update_forces(struct)
            if status != OK:
                return status
            weight = difference_weight(offset)
            for k in range(6):
                row[k] += weight * data.h_o[k]
            for k in range(n):
                torque = 0.0 if closed_loop else data.torque[k]
                row[6 + k] += weight * (data.h[k] - torque)
            for k in range(data.inner_rate.size):
                row[6 + n + k] += weight * data.inner_rate[k]
        values[place] = before
        data.position[3], data.position[4], data.position[5], data.position[6] = x, y, z, w
    return update_forces(struct)


@kernel
def state_entry(data, column):
    """The array and the place in it of a coordinate of the state; of a turn, any place."""
    n = data.angles.size
    if column < 6:
        return data.position, min(column, 2)
    if column < 12:
        return data.twist, column - 6
    if column < 12 + n:
        return data.angles, column - 12
    if column < 12 + 2 * n:
        return data.v, column - 12 - n
    return data.inner, column - 12 - 2 * n


@kernel
def update_forces(struct):
    """Kinematics and right-hand sides at the state in the data, not solved; returns a status."""
    functions = open_data(struct).functions
    status = call_cfunc(functions.kinematics, struct, 0.0, 0.0)
    return call_cfunc(functions.forces, struct, 0.0, 0.0) if status == OK else status


@kernel
def differentiate_joint(
    struct: INTS,
    arm: INT,
    body: NUMBERS,
    link: NUMBERS,
    tables: TABLE,
    force: NUMBERS,
    scratch: TABLE,
    rows: TABLE,
    parts: TABLE,
    slopes: TABLE,
    wrench: TABLE,
    gaps: TABLE,
    rates: TABLE,
    on_object: TABLE,
    on_link: TABLE,
):
    """Write what the equations of an arm take from its joint; returns a status.

    The C coordinates are pose, twist and acceleration of the object (6 each, world axes), then
    positions, velocities and accelerations of the arm's n joints, and last, if the tables have
    room for them, six of a displacement of the contacts against the link, in its axes.

    Parameters
    ----------
    struct : int64
        Of the system.
    arm : int
    body : (27,)
        The object's rotation and motion, world axes.
    link : (27,)
        The same of the link that carries the tip; its twist and spatial acceleration in its axes.
    tables : (4 n, 6)
        A row a joint, link axes: derivatives of the link's twist by the positions, of its spatial
        acceleration by positions and velocities, and the Jacobian.
    force : (N,)
        Contact forces [N] of all rows.
    scratch, rows, parts, slopes, wrench : (7, 27), (N, 18), (P, 18), (N, 24), (7, 6)
        Scratch; the last row of the first is that of the identity at rest.
    gaps, rates : (N_i, C), written
        Derivatives of the second and of the first time derivatives of the joint's gaps.
    on_object, on_link : (C + 1, 6), written
        Derivatives, and in the last row the values, of the contacts' wrench on the object, about
        its centre of mass in world axes, and of the opposite one on the link, about its origin in
        its axes.
    """
    model, data, work = open_system(struct)
    first, last = work.rows[arm], work.rows[arm + 1]
    write_link_motion(link, scratch[WORLD])
    write_seen_motion(body, link, scratch[WORLD], scratch[SEEN])
    differentiate_rows(model, data, first, last, force, scratch, rows, parts, slopes, wrench)
    n, by = tables.shape[0] // 4, scratch[OF_SEEN]
    coordinates = gaps.shape[1]
    for c in range(coordinates):
        clear(scratch[OF_BODY])
        clear(scratch[OF_LINK])
        if c < 18:
            scratch[OF_BODY, c] = 1.0
        elif c < 18 + 3 * n:
            displace_link(link, scratch[WORLD], tables, n, c - 18, scratch[OF_LINK])
        else:
            displace_contacts(link, scratch[WORLD], c - 18 - 3 * n, scratch[OF_LINK])
        write_seen_displacement(body, scratch[WORLD], scratch[OF_BODY], scratch[OF_LINK], by)
        for k in range(first, last):
            total = rate = 0.0
            for j in range(18):
                total += slopes[k, j] * by[j]
            for j in range(6):
                rate += slopes[k, RATE_BY_POSE + j] * by[j]
                rate += slopes[k, LINEAR_RATE + j] * by[LINEAR + j]
            gaps[k - first, c], rates[k - first, c] = total, rate
        turn = vec(scratch[OF_BODY], TURN)
        moves = 1.0 if c < 18 + 3 * n else 0.0
        displace_wrenches(body, scratch[SEEN], wrench, turn, by, moves, on_object[c], on_link[c])
    write_wrenches(body, scratch[SEEN], wrench[6], on_object[coordinates], on_link[coordinates])
    return CALLBACK_FAILED if data.status.failed else OK


@kernel
def differentiate_rows(model, data, first, last, force, scratch, rows, parts, slopes, wrench):
    """Write the derivatives of the rows by the seen motion, and those of their wrench by its pose.

    Of a row, ``slopes`` has those of the gap's second derivative by a displacement, and those of
    its rate by the pose.  ``wrench`` is in the object's axes; its last row is the value.
    """
    motion, moved = scratch[SEEN], scratch[MOVED]
    for i in range(7):
        clear(wrench[i])
    write_rows_at(model, data, first, last, motion, scratch[STILL], rows, parts)
    for k in range(first, last):
        clear(slopes[k])
        e, couple = vec(rows[k], NORMAL), couple_of(model, rows, k)
        turn = add(cross(sub(vec(rows[k], AT), vec(motion, ORIGIN_AT)), e), couple)
        put(slopes[k], LINEAR_RATE, scale(-1.0, e))
        put(slopes[k], ANGULAR_RATE, scale(-1.0, turn))
    add_wrench(model, rows, first, last, force, 1.0, wrench[6])
    for axis in range(6):
        for offset in OFFSETS:
            displace(motion, axis, offset * STEP, moved)
            write_rows_at(model, data, first, last, moved, scratch[STILL], rows, parts)
            weight = difference_weight(offset)
            for k in range(first, last):
                slopes[k, PLACE + axis] += weight * rows[k, GAP_BIAS]
                slopes[k, RATE_BY_POSE + axis] += weight * rows[k, GAP_RATE]
            add_wrench(model, rows, first, last, force, weight, wrench[axis])
        for sign in (-1.0, 1.0):
            displace(motion, axis, 0.0, moved)
            moved[VELOCITY + axis] += sign  # the spin follows the velocity
            write_rows_at(model, data, first, last, moved, scratch[STILL], rows, parts)
            for k in range(first, last):
                slopes[k, LINEAR + axis] += 0.5 * sign * rows[k, GAP_BIAS]


@kernel
def write_rows_at(model, data, first, last, motion, still, rows, parts):
    """Write the rows ``first`` to ``last`` of an arm for a motion seen from the object."""
    for k in range(first, last):
        write_row(
            k, motion, still, model.codes, model.geometry, model.shapes, data.functions.surface,
            rows, parts, data.query, data.places, data.located,
        )  # fmt: skip


@kernel
def couple_of(model, rows, k):
    """The couple that a row has besides the force at its point."""
    return vec(rows[k], COUPLE) if model.codes[k, KIND] == COMBINED else ZERO


@kernel
def add_wrench(model, rows, first, last, force, weight, out):
    """Add the resultant of the forces on the object, times a weight."""
    for k in range(first, last):
        e, share = vec(rows[k], NORMAL), weight * force[k]
        turn = add(cross(vec(rows[k], AT), e), couple_of(model, rows, k))
        put(out, 0, add_scaled(vec(out, 0), share, e))
        put(out, 3, add_scaled(vec(out, 3), share, turn))


@kernel
def displace(motion, axis, amount, moved):
    """Write a seen motion whose pose is displaced along or about an axis of the object."""
    for j in range(BODY_WIDTH):
        moved[j] = motion[j]
    if axis < 3:
        moved[ORIGIN_AT + axis] += amount
        return
    c, s = math.cos(amount), math.sin(amount)
    y, z = (axis - 2) % 3, (axis - 1) % 3  # the axes across
    for j in range(3):
        a, b = motion[3 * y + j], motion[3 * z + j]
        moved[3 * y + j], moved[3 * z + j] = c * a - s * b, s * a + c * b


# --- motions --------------------------------------------------------------------------------------


@kernel
def write_link_motion(link, out):
    """Write the link's motion in world axes; ``link`` has twist and acceleration in its own."""
    R, motion = rotation(link, 0), link[MOTION:]
    u, w = vec(motion, LINEAR), vec(motion, ANGULAR)
    put(out, PLACE, vec(motion, PLACE))
    put(out, LINEAR, rotate(R, u))
    put(out, ANGULAR, rotate(R, w))
    put(out, LINEAR_RATE, rotate(R, add_cross(vec(motion, LINEAR_RATE), w, u)))
    put(out, ANGULAR_RATE, rotate(R, vec(motion, ANGULAR_RATE)))


@kernel
def displace_link(link, world, tables, n, c, out):
    """Write the displacement of the link's motion, world axes, by one of 3 n coordinates."""
    R, motion = rotation(link, 0), link[MOTION:]
    u, w = vec(motion, LINEAR), vec(motion, ANGULAR)
    part, j = c // n, c % n
    J = tables[3 * n + j]
    turn, rate, rate_turn = ZERO, ZERO, ZERO
    if part == 0:  # a position
        turn = rotate(R, vec(J, 3))
        put(out, PLACE, rotate(R, vec(J, 0)))
        put(out, TURN, turn)
        rate, rate_turn, of_rate = vec(tables[j], 0), vec(tables[j], 3), tables[n + j]
    elif part == 1:  # a velocity
        rate, rate_turn, of_rate = vec(J, 0), vec(J, 3), tables[2 * n + j]
    else:
        of_rate = J
    classical = add_cross(add_cross(vec(of_rate, 0), w, rate), rate_turn, u)
    put(out, LINEAR, add_cross(rotate(R, rate), turn, vec(world, LINEAR)))
    put(out, ANGULAR, add_cross(rotate(R, rate_turn), turn, vec(world, ANGULAR)))
    put(out, LINEAR_RATE, add_cross(rotate(R, classical), turn, vec(world, LINEAR_RATE)))
    angular = rotate(R, vec(of_rate, 3))
    put(out, ANGULAR_RATE, add_cross(angular, turn, vec(world, ANGULAR_RATE)))


@kernel
def displace_contacts(link, world, c, out):
    """Write the displacement of contacts that are moved against the link, world axes.

    Along or about one of the link's axes; it stays the same in these.
    """
    axis = rotation(link, 0)[c % 3]
    if c >= 3:
        put(out, TURN, axis)
        return
    w, w_rate = vec(world, ANGULAR), vec(world, ANGULAR_RATE)
    rate = cross(w, axis)
    put(out, PLACE, axis)
    put(out, LINEAR, rate)
    put(out, LINEAR_RATE, add_cross(cross(w_rate, axis), w, rate))


@kernel
def seen_rates(body, world):
    """``d, V, Omega, A, Omega'`` of the link as the object sees it, in world axes."""
    motion = body[MOTION:]
    d = sub(vec(world, PLACE), vec(motion, PLACE))
    w, w_rate = vec(motion, ANGULAR), vec(motion, ANGULAR_RATE)
    c = cross(w, d)
    V = sub(sub(vec(world, LINEAR), vec(motion, LINEAR)), c)
    A = sub(sub(vec(world, LINEAR_RATE), vec(motion, LINEAR_RATE)), cross(w_rate, d))
    A = sub(A, cross(w, add_scaled(c, 2.0, V)))
    spin = sub(vec(world, ANGULAR), w)
    spin_rate = sub(sub(vec(world, ANGULAR_RATE), w_rate), cross(w, vec(world, ANGULAR)))
    return d, V, spin, A, spin_rate


@kernel
def write_seen_motion(body, link, world, out):
    """Write the link's motion as the object sees it, in its axes, for the contact rows."""
    R = rotation(body, 0)
    d, V, spin, A, spin_rate = seen_rates(body, world)
    x, y, z = rotation(link, 0)
    put_rotation(out, 0, (rotate_back(R, x), rotate_back(R, y), rotate_back(R, z)))
    put(out, ORIGIN_AT, rotate_back(R, d))
    put(out, VELOCITY, rotate_back(R, V))
    put(out, SPIN, rotate_back(R, spin))
    put(out, ACCELERATION, rotate_back(R, A))
    put(out, SPIN_RATE, rotate_back(R, spin_rate))


@kernel
def write_seen_displacement(body, world, of_body, of_link, out):
    """Write the displacement of the seen motion by displacements of the two in world axes."""
    R, motion = rotation(body, 0), body[MOTION:]
    d, V, spin, A, spin_rate = seen_rates(body, world)
    w, w_rate, turn = vec(motion, ANGULAR), vec(motion, ANGULAR_RATE), vec(of_body, TURN)
    dw, dw_link = vec(of_body, ANGULAR), vec(of_link, ANGULAR)
    dd = sub(vec(of_link, PLACE), vec(of_body, PLACE))
    dc = add_cross(cross(dw, d), w, dd)
    dV = sub(sub(vec(of_link, LINEAR), vec(of_body, LINEAR)), dc)
    dA = sub(vec(of_link, LINEAR_RATE), vec(of_body, LINEAR_RATE))
    dA = sub(dA, add_cross(cross(vec(of_body, ANGULAR_RATE), d), w_rate, dd))
    dA = sub(dA, cross(dw, add_scaled(cross(w, d), 2.0, V)))
    dA = sub(dA, cross(w, add_scaled(dc, 2.0, dV)))
    rate = sub(vec(of_link, ANGULAR_RATE), vec(of_body, ANGULAR_RATE))
    rate = sub(rate, add_cross(cross(dw, vec(world, ANGULAR)), w, dw_link))
    # the object's axes turn
    put(out, PLACE, rotate_back(R, add_cross(dd, d, turn)))
    put(out, TURN, rotate_back(R, sub(vec(of_link, TURN), turn)))
    put(out, LINEAR, rotate_back(R, add_cross(dV, V, turn)))
    put(out, ANGULAR, rotate_back(R, add_cross(sub(dw_link, dw), spin, turn)))
    put(out, LINEAR_RATE, rotate_back(R, add_cross(dA, A, turn)))
    put(out, ANGULAR_RATE, rotate_back(R, add_cross(rate, spin_rate, turn)))


@kernel
def write_wrenches(body, seen, wrench, on_object, on_link):
    """Write the contacts' wrench on the object, world axes, and the opposite one on the link."""
    R_o, R, r = rotation(body, 0), rotation(seen, 0), vec(seen, ORIGIN_AT)
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
    R_o, R, r = rotation(body, 0), rotation(seen, 0), vec(seen, ORIGIN_AT)
    force, moment = vec(wrench[6], 0), vec(wrench[6], 3)
    df, dm = ZERO, ZERO
    for axis in range(6):
        df = add_scaled(df, by[axis], vec(wrench[axis], 0))
        dm = add_scaled(dm, by[axis], vec(wrench[axis], 3))
    put(on_object, 0, add_cross(rotate(R_o, df), turn_o, rotate(R_o, force)))
    put(on_object, 3, add_cross(rotate(R_o, dm), turn_o, rotate(R_o, moment)))
    turn, shift = scale(moves, vec(by, TURN)), scale(moves, vec(by, PLACE))
    put(on_link, 0, scale(-1.0, rotate_back(R, add_cross(df, force, turn))))
    moment = sub(moment, cross(r, force))
    dm = sub(sub(dm, cross(shift, force)), cross(r, df))
    put(on_link, 3, scale(-1.0, rotate_back(R, add_cross(dm, moment, turn))))
