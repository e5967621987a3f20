r"""Residuals of the equations of motion: how well accelerations and contact forces solve them.

.. math::
    M_i \ddot q_i - f_i - W_i \lambda_i, \qquad
    M_o \dot v_o - f_o - \sum_i W_{oi} \lambda_i, \qquad
    W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i

of blocks, object and constraints (:mod:`multiarm.dynamics.equations`), at the kinematics in the
data.
:func:`write_residuals` has all three, as a result states them; :func:`constraint_residual` and
:func:`imbalance` are relative to the largest term, and decide whether a solution is one.
"""

from __future__ import annotations

import math

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import add_contact_forces
from multiarm.dynamics.momenta import times_block_inertia, times_object_inertia
from multiarm.dynamics.solver.batched import largest_free_rate
from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND, LEAST_ACCELERATION
from multiarm.dynamics.solver.factors import norm
from multiarm.jit.kernels import INTS, NUMBERS, copy, inlined, kernel, larger
from multiarm.jit.simd import broadcast, load_pack, store_pack


@kernel
def write_residuals(
    struct: INTS,
    acceleration: NUMBERS,
    generalised_forces: NUMBERS,
    force: NUMBERS,
    c: NUMBERS,
):
    """Write the largest residuals of blocks, object and constraints into ``data.check``.

    Of accelerations (6 + n,) and contact forces (N,), with the right-hand sides
    ``generalised_forces`` (6 + n,) and ``c`` (N,).
    """
    _, data, work = open_system(struct)
    first = acceleration.size - data.state.joint_rates.size
    a_o, a, forces = acceleration[:first], acceleration[first:], data.forces.total
    copy(generalised_forces, forces)
    add_contact_forces(work, data.rows.W_o, work.W, force, forces[:first], forces[first:])
    check = data.check
    check.block = check.on_object = check.constraint = 0.0
    for k in range(first):
        residual = times_object_inertia(k, data, a_o) - forces[k]
        check.on_object = larger(check.on_object, residual)
    for i in range(work.first_joint.size - 1):
        for j in range(work.first_joint[i + 1] - work.first_joint[i]):
            residual = times_block_inertia(i, j, work, a) - forces[first + work.first_joint[i] + j]
            check.block = larger(check.block, residual)
        for row in range(work.first_contact[i], work.first_contact[i + 1]):
            residual = rate_by_object(row, data, a_o) + rate_by_block(i, row, work, a) - c[row]
            check.constraint = larger(check.constraint, residual)


@inlined
def rate_by_object(row, data, a_o):
    """``W_o^T a_o`` of a row."""
    rate = 0.0
    for k in range(a_o.size):
        rate += data.rows.W_o[row, k] * a_o[k]
    return rate


@inlined
def rate_by_block(i, row, work, a):
    """``W^T a`` of a row of block ``i``."""
    rate = 0.0
    for j in range(work.first_joint[i + 1] - work.first_joint[i]):
        rate += work.W[i, j, row - work.first_contact[i]] * a[work.first_joint[i] + j]
    return rate


# --- relative residuals of the last solution ------------------------------------------------------


@inlined
def residual_of_all(model, data, work):
    """The constraints' relative residual or the object's, the larger of them; NaN if either is."""
    constraint, of_object = constraint_residual(model, data, work), data.solution.imbalance
    return constraint if of_object <= constraint or constraint != constraint else of_object


@kernel
def constraint_residual(model, data, work):
    """Largest ``|W_o^T a_o + W^T a - c|`` relative to the largest term in any of these rows.

    Terms are ``c``, the accelerations, and the accelerations without contact forces.
    """
    worst, scale = 0.0, max(LEAST_ACCELERATION, free_acceleration(data))
    if not model.dense:
        scale = max(scale, free_rate(work))
    for i in range(work.first_joint.size - 1):
        for row in range(work.first_contact[i], work.first_contact[i + 1]):
            by_object = rate_by_object(row, data, data.accelerations.a_o)
            by_block, c = rate_by_block(i, row, work, data.accelerations.a_j), data.rows.c[row]
            residual = abs(by_object + by_block - c)
            if residual != residual:
                return residual
            worst = max(worst, residual)
            scale = max(scale, abs(by_object), abs(by_block), abs(c))
    return worst / scale


@kernel
def free_acceleration(data):
    """Acceleration of the object's centre of mass without contact forces [m/s^2]."""
    force = 0.0
    for k in range(3):
        force = max(force, abs(data.forces.f_o[k]))
    return force / data.bodies.object_inertia[0, 0]


@inlined
def free_rate(work):
    """Largest ``|W^T M^-1 f_j|`` of the last solution: contact accelerations without forces."""
    if not work.status.block_by_block:
        return largest_free_rate(work)
    largest = 0.0
    for i in range(work.first_joint.size - 1):
        for a in range(work.first_contact[i + 1] - work.first_contact[i]):
            rate = 0.0
            for j in range(work.first_joint[i + 1] - work.first_joint[i]):
                rate += work.Y[i, j, a] * work.y[work.first_joint[i] + j]
            largest = max(largest, abs(rate))
    return largest


@inlined
def imbalance(data, W_o):
    """Residual of ``M_o a_o = f_o + W_o force``, relative to the largest force in it.

    ``W_o`` (N, 6) are the rows along which the forces act.  Moments are compared with moments, or
    with that force at the object's radius of gyration.  Every solution is checked so.  Hence the
    result is zero where a bound that takes no root and no norm of a row shows that it is less than
    ``IMBALANCE_BOUND``; it is NaN where the solution is not finite.
    """
    inertia, m = data.bodies.object_inertia, data.bodies.object_inertia[0, 0]
    f_o, a_o, total = data.forces.f_o, data.accelerations.a_o, data.forces.total
    front, back = load_pack(f_o, 0), load_pack(f_o, 2)  # six numbers, two of them twice
    for a in range(data.rows.force.size):
        force = broadcast(data.rows.force[a])
        front = front + force * load_pack(W_o, 6 * a)
        back = back + force * load_pack(W_o, 6 * a + 2)
    store_pack(total, 0, front)
    store_pack(total, 2, back)
    x, y, z = a_o[3], a_o[4], a_o[5]
    forces = abs(total[0] - m * a_o[0]) + abs(total[1] - m * a_o[1]) + abs(total[2] - m * a_o[2])
    moments = (
        abs(total[3] - inertia[3, 3] * x - inertia[3, 4] * y - inertia[3, 5] * z)
        + abs(total[4] - inertia[4, 3] * x - inertia[4, 4] * y - inertia[4, 5] * z)
        + abs(total[5] - inertia[5, 3] * x - inertia[5, 4] * y - inertia[5, 5] * z)
    )
    largest = m * max(abs(a_o[0]), abs(a_o[1]), abs(a_o[2]))
    small = 0.5 * IMBALANCE_BOUND * max(largest, abs(f_o[0]), abs(f_o[1]), abs(f_o[2]))
    square = inertia[3, 3] + inertia[4, 4] + inertia[5, 5]  # m times that of the radius of gyration
    if forces <= small and m * moments * moments <= small * small * square:
        return 0.0
    return relative_imbalance(data, W_o, forces, moments)


@kernel
def relative_imbalance(data, W_o, forces, moments):
    """Residuals of forces [N] and moments [N m] relative to the largest terms."""
    inertia = data.bodies.object_inertia
    radius = math.sqrt((inertia[3, 3] + inertia[4, 4] + inertia[5, 5]) / inertia[0, 0])
    acceleration = max(LEAST_ACCELERATION, norm(data.accelerations.a_o[:3], 3))
    push = max(inertia[0, 0] * acceleration, norm(data.forces.f_o[:3], 3))
    turn = norm(data.forces.f_o[3:6], 3)
    for a in range(data.rows.force.size):
        force = abs(data.rows.force[a])
        push = max(push, force * norm(W_o[a, :3], 3))
        turn = max(turn, force * norm(W_o[a, 3:6], 3))
    # NaN stays NaN
    return forces / push + moments / max(turn, push * radius)
