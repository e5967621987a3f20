"""Monitor of the solver: rank and residual at the end of every step, and their changes.

Three numbers are recorded: the rank of the constraints, the number of arms in the coupled system
(:mod:`multiarm.dynamics.solver.singular`), and the largest constraint residual relative to the
largest term of its equations.  Where the residual is above ``RESIDUAL_BOUND``, the equations are
solved again with every arm decomposed; if it stays too large, the step is rejected.  The object's
equation is treated likewise when it is solved (:func:`multiarm.dynamics.equations.imbalance`).

An arm that is not eliminated as a whole *loses a direction* when, for the same force, it moves
along it by less than ``LOST`` of the motion along its best one.  It regains the direction at a
larger ratio (hysteresis).  A step may also jump over a singular posture; then the determinant of
the arm's square ``W`` has changed its sign.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.dynamics.arrays import open_coupled, open_system
from multiarm.dynamics.equations import evaluate_state, largest, renew_kinematics, solve_again
from multiarm.dynamics.solver.batched import largest_free_rate
from multiarm.dynamics.solver.bounds import (
    AT_REST,
    COUPLED_BELOW,
    LOST,
    MOST_ROUNDED_RESIDUAL,
    REGAINED,
    RESIDUAL_BOUND,
)
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import INTS, NUMBERS, cfunc, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_at


@kernel
def evaluate_and_check(struct: INTS, found: NUMBERS):
    """Evaluate the state in ``data``, and insert the result into the equations.

    Writes into ``found`` (6,) the residuals of arms, object and constraints
    (:class:`multiarm.dynamics.evaluation.Residuals`), the largest gap [m] and gap rate [m/s], and
    whether the result is a solution.  The matrices in ``work`` are not factored afterwards.
    Returns the status of :func:`multiarm.dynamics.equations.evaluate_state`.
    """
    status = evaluate_state(struct, 0.0, 0.0)
    if status != OK:
        return status
    _, data, work = open_system(struct)
    call_cfunc(data.functions.record, struct, 0.0, 0.0)
    found[5] = 1.0 if believable(struct, data.status.residual) else 0.0
    if work.factored[0] != 0:
        status = renew_kinematics(struct)
    found[0], found[2] = arm_residuals(data, work)
    found[1] = object_residual(data)
    found[3], found[4] = largest(data.contacts, GAP), largest(data.contacts, GAP_RATE)
    return status


@kernel
def arm_residuals(data, work):
    """``M q'' - h - W force`` of all arms and ``W_o^T q_o + W^T q'' - c``, largest magnitudes."""
    of_arms = of_constraints = 0.0
    for i in range(work.dofs.size - 1):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        r0, r = work.rows[i], work.rows[i + 1] - work.rows[i]
        M, W = work.L[i], work.Y[i]
        for j in range(d):
            left = -data.h[d0 + j]
            for k in range(d):
                left += M[max(j, k), min(j, k)] * data.qdd[d0 + k]
            for a in range(r):
                left -= W[j, a] * data.force[r0 + a]
            of_arms = larger(of_arms, left)
        for a in range(r):
            left = -data.c[r0 + a]
            for k in range(6):
                left += data.Wo[r0 + a, k] * data.q_o[k]
            for j in range(d):
                left += W[j, a] * data.qdd[d0 + j]
            of_constraints = larger(of_constraints, left)
    return of_arms, of_constraints


@kernel
def object_residual(data):
    """``M_o q_o - h_o - W_o force``, largest magnitude."""
    worst = 0.0
    for k in range(6):
        left = -data.h_o[k]
        for j in range(6):
            left += data.inertia[k, j] * data.q_o[j]
        for a in range(data.force.size):
            left -= data.Wo[a, k] * data.force[a]
        worst = larger(worst, left)
    return worst


@inlined
def larger(worst, left):
    """The larger magnitude; NaN if either is."""
    return abs(left) if abs(left) > worst or left != left else worst


@cfunc
def record_solution(address, size, _a, _b):
    """Write rank, coupled arms and residual of the last solution into ``data.status``.

    Where the residual is too large, the equations are solved again with every arm decomposed.
    """
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    coupled = open_coupled(struct)
    status, arms = data.status, data.pointers.shape[0]
    status.residual = residual_of_all(model, data, work)
    solved = believable(struct, status.residual)
    # modes have solutions of their own
    repeatable = not (model.dense or data.modes.active)
    if not solved and repeatable and coupled.status.arms < arms:
        if solve_again(struct) != OK:
            status.imbalance = math.nan
        status.residual = residual_of_all(model, data, work)
    if not model.dense:
        status.coupled_arms = coupled.status.arms
        status.rank = data.force.size
        if coupled.status.arms > 0:
            status.rank += coupled.status.rank - coupled.status.unknowns
    return OK


@inlined
def residual_of_all(model, data, work):
    """The constraints' residual or the object's, whichever is larger; NaN if either is."""
    residual, other = constraint_residual(model, data, work), data.status.imbalance
    return residual if other <= residual or residual != residual else other


@kernel
def constraint_residual(model, data, work):
    """Largest ``|W_o^T q_o + W^T q - c|`` relative to the largest term in any of these rows.

    Terms are ``c``, the accelerations, and the accelerations without contact forces.  After
    an elimination arm by arm ``work.Y`` holds ``L^-1 W`` and ``work.L`` the factor, so that
    ``W^T q = Y^T (L^T q)``; else ``W`` is still in ``work.Y``.
    """
    factored = work.factored[0] != 0
    worst, scale, u = 0.0, max(AT_REST, free_acceleration(data)), data.residual
    if not factored and not model.dense:
        scale = max(scale, largest_free_rate(work))
    for i in range(work.dofs.size - 1):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        L, Y = work.L[i], work.Y[i]
        for j in range(d):
            u[j] = data.qdd[d0 + j]
            if factored:
                u[j] /= L[j, j]
                for k in range(j + 1, d):
                    u[j] += L[k, j] * data.qdd[d0 + k]
        for a in range(work.rows[i], work.rows[i + 1]):
            of_object = of_arm = free = 0.0
            for k in range(6):
                of_object += data.Wo[a, k] * data.q_o[k]
            for j in range(d):
                of_arm += Y[j, a - work.rows[i]] * u[j]
                if factored:
                    free += Y[j, a - work.rows[i]] * work.y[d0 + j]
            c = data.c[a]
            scale = max(scale, abs(of_object), abs(of_arm), abs(free), abs(c))
            left = abs(of_object + of_arm - c)
            if left != left:
                return left
            worst = max(worst, left)
    return worst / scale


@kernel
def believable(struct, residual):
    """Whether a relative residual is that of a solution.

    Near a loss of rank, rounding errors of the gaps are magnified by the square of the distance
    from it.
    """
    coupled = open_coupled(struct)
    if coupled.status.arms == 0:
        return residual <= RESIDUAL_BOUND
    margin = coupled.status.margin
    rounded = min(MOST_ROUNDED_RESIDUAL, 1e-13 / (margin * margin))
    return residual <= max(RESIDUAL_BOUND, rounded)


@kernel
def free_acceleration(data):
    """Acceleration of the object's centre of mass without contact forces [m/s^2]."""
    force = 0.0
    for k in range(3):
        force = max(force, abs(data.h_o[k]))
    return force / data.inertia[0, 0]


@cfunc
def compare_solution(address, size, _a, _b):
    """Compare the recorded solution with that of the previous step; returns the changes' number."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    changes = 0
    rank = data.status.rank
    last = data.lost.size - 1
    if data.lost[last] != rank:
        data.lost[last] = rank
        changes += 1
    if model.dense:
        return changes
    coupled = open_coupled(struct)
    for i in range(last):
        data.passed[i] = 0
        lost = 0
        if not work.pivot[i] > COUPLED_BELOW:
            lost = lost_directions(i, data.lost[i], work, coupled)
        elif work.pivot[i] < REGAINED * REGAINED * COUPLED_BELOW:
            lost = data.lost[i]
        elif work.dofs[i + 1] - work.dofs[i] == work.rows[i + 1] - work.rows[i]:
            sign = determinant_sign(i, work, coupled)
            if sign * data.signs[i] < 0.0:
                data.passed[i] = 1
                changes += 1
            data.signs[i] = sign
        if lost != data.lost[i]:
            data.lost[i] = lost
            changes += 1
    return changes


@kernel
def lost_directions(i, before, work, coupled):
    """Number of lost directions of a deficient arm, with hysteresis."""
    fewest = most = 0
    for a in range(work.rows[i], work.rows[i + 1]):
        share = coupled.sigma[a] / coupled.scale[i] if coupled.scale[i] > 0.0 else 0.0
        fewest += 1 if share < LOST else 0
        most += 1 if share < REGAINED * LOST else 0
    if fewest > before:
        return fewest
    return most if most < before else before


@kernel
def determinant_sign(i, work, coupled):
    """Sign of ``det(W)`` of an arm with as many contacts as joints (elimination by rows).

    That of ``L^-1 W`` is the same.
    """
    n = work.dofs[i + 1] - work.dofs[i]
    A, Y, sign = coupled.A[i], work.Y[i], 1.0
    for r in range(n):
        for k in range(n):
            A[r, k] = Y[r, k]
    for k in range(n):
        best = k
        for r in range(k + 1, n):
            if abs(A[r, k]) > abs(A[best, k]):
                best = r
        if best != k:
            sign = -sign
            for j in range(k, n):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        if A[k, k] == 0.0:
            return 0.0
        if A[k, k] < 0.0:
            sign = -sign
        for r in range(k + 1, n):
            factor = A[r, k] / A[k, k]
            for j in range(k + 1, n):
                A[r, j] -= factor * A[k, j]
    return sign
