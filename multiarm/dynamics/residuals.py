r"""Residuals of the equations of motion: how well accelerations and contact forces solve them.

.. math::
    M_i \ddot q_i - f_i - W_i \lambda_i, \qquad
    M_o \dot v_o - f_o - \sum_i W_{oi} \lambda_i, \qquad
    W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i

of blocks, objects and constraints (:mod:`multiarm.dynamics.equations`), at the kinematics in the
data.
:func:`write_residuals` has all three, as a result states them; :func:`constraint_residual` and
:func:`imbalance` are relative to the largest term, and decide whether a solution is one.
"""

from __future__ import annotations

import math

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import add_contact_forces
from multiarm.dynamics.kinematics import rate_by_block, rate_by_object
from multiarm.dynamics.momenta import times_block_inertia, times_object_inertia
from multiarm.dynamics.solver.batched import largest_free_rate
from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND, LEAST_ACCELERATION
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.dynamics.solver.factors import norm
from multiarm.dynamics.solver.node import NODE
from multiarm.jit.kernels import INTS, NUMBERS, copy, inlined, kernel, larger
from multiarm.jit.simd import broadcast, load_pack, store_pack
from multiarm.jit.vectors import vec


@kernel
def write_residuals(
    struct: INTS,
    acceleration: NUMBERS,
    generalised_forces: NUMBERS,
    force: NUMBERS,
    c: NUMBERS,
):
    """Write the largest residuals of blocks, object and constraints into ``data.check``.

    Of accelerations (6 F + n,) and contact forces (N,), with the right-hand sides
    ``generalised_forces`` (6 F + n,) and ``c`` (N,).
    """
    _, data, work = open_system(struct)
    first = acceleration.size - data.state.joint_rates.size
    complete_inertias(work)
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
    """Largest acceleration of an object's centre of mass without contact forces [m/s^2]."""
    largest = 0.0
    for at in range(0, data.forces.f_o.size, 6):
        for k in range(at, at + 3):
            largest = max(largest, abs(data.forces.f_o[k]) / data.bodies.object_inertia[at, at])
    return largest


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

    The largest one of an object; ``W_o`` (N, 6 F) are the rows along which the forces act.  Moments
    are compared with moments, or with that force at the object's radius of gyration.  Every
    solution is checked so.  Hence the result is zero where a bound that takes no root and no norm
    of a row shows that it is less than ``IMBALANCE_BOUND``; it is NaN where the solution is not
    finite.
    """
    node, largest = data.forces.f_o.size, 0.0
    if node == NODE:  # constants, of which compiled code makes better use
        return imbalance_of_object(data, W_o, 0, NODE)
    for at in range(0, node, 6):
        largest = larger(largest, imbalance_of_object(data, W_o, at, node))
    return largest


@inlined
def imbalance_of_object(data, W_o, at, node):
    """:func:`imbalance` of the object whose numbers of the ``node`` begin at ``at``."""
    inertia, m = data.bodies.object_inertia, data.bodies.object_inertia[at, at]
    f_o, a_o, total = data.forces.f_o, data.accelerations.a_o, data.forces.total
    front, back = load_pack(f_o, at), load_pack(f_o, at + 2)  # six numbers, two of them twice
    place = at
    for a in range(data.rows.force.size):
        force = broadcast(data.rows.force[a])
        front = front + force * load_pack(W_o, place)
        back = back + force * load_pack(W_o, place + 2)
        place += node
    store_pack(total, at, front)
    store_pack(total, at + 2, back)
    u, v, w = at + 3, at + 4, at + 5
    f, a, p = vec(f_o, at), vec(a_o, at), vec(total, at)
    x, y, z = a_o[u], a_o[v], a_o[w]
    forces = abs(p[0] - m * a[0]) + abs(p[1] - m * a[1]) + abs(p[2] - m * a[2])
    moments = (
        abs(total[u] - inertia[u, u] * x - inertia[u, v] * y - inertia[u, w] * z)
        + abs(total[v] - inertia[v, u] * x - inertia[v, v] * y - inertia[v, w] * z)
        + abs(total[w] - inertia[w, u] * x - inertia[w, v] * y - inertia[w, w] * z)
    )
    largest = m * max(abs(a[0]), abs(a[1]), abs(a[2]))
    small = 0.5 * IMBALANCE_BOUND * max(largest, abs(f[0]), abs(f[1]), abs(f[2]))
    square = inertia[u, u] + inertia[v, v] + inertia[w, w]  # m times that of the radius of gyration
    if forces <= small and m * moments * moments <= small * small * square:
        return 0.0
    return relative_imbalance(data, W_o, at, forces, moments)


@kernel
def relative_imbalance(data, W_o, at, forces, moments):
    """Residuals of an object's forces [N] and moments [N m] relative to the largest terms."""
    inertia, u = data.bodies.object_inertia, at + 3
    radius = math.sqrt(
        (inertia[u, u] + inertia[u + 1, u + 1] + inertia[u + 2, u + 2]) / inertia[at, at]
    )
    acceleration = max(LEAST_ACCELERATION, norm(data.accelerations.a_o[at:u], 3))
    push = max(inertia[at, at] * acceleration, norm(data.forces.f_o[at:u], 3))
    turn = norm(data.forces.f_o[u : u + 3], 3)
    for a in range(data.rows.force.size):
        force = abs(data.rows.force[a])
        push = max(push, force * norm(W_o[a, at:u], 3))
        turn = max(turn, force * norm(W_o[a, u : u + 3], 3))
    # NaN stays NaN
    return forces / push + moments / max(turn, push * radius)
