"""Monitor of the solver: rank and residual at the end of every step, and their changes.

Three numbers are recorded: the rank of the constraints, the number of blocks in the coupled system
(:mod:`multiarm.dynamics.solver.singular`), and the largest constraint residual relative to the
largest term of its equations.  Where the residual is above ``RESIDUAL_BOUND``, the equations are
solved again with every block decomposed; if it stays too large, the step is rejected.  The object's
equation is treated likewise when it is solved (:func:`multiarm.dynamics.residuals.imbalance`).

A block that is not eliminated as a whole *loses a direction* when, for the same force, it moves
along it by less than ``LOST`` of the motion along its best one.  It regains the direction at a
larger ratio (hysteresis).  A step may also jump over a singular posture; then the determinant of
the block's square ``W`` has changed its sign.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import greatest_gaps
from multiarm.dynamics.arrays import open_coupled, open_data, open_system
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.residuals import residual_of_all, write_residuals
from multiarm.dynamics.solver.bounds import (
    COUPLED_BELOW,
    LOST,
    MOST_ROUNDED_RESIDUAL,
    REGAINED,
    RESIDUAL_BOUND,
    ROUNDED_RESIDUAL,
)
from multiarm.dynamics.solver.factors import copy_block, factor_lu
from multiarm.dynamics.solver.node import contact_count, joint_count
from multiarm.dynamics.solver.solution import DENSE, SPLIT, WHOLE
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import INTS, cfunc, copy, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_at


@kernel
def evaluate_and_check(struct: INTS):
    """Evaluate the state in ``data``, and insert the result into the equations: ``data.check``.

    Returns the status of :func:`multiarm.dynamics.equations.evaluate_state`.
    """
    status = evaluate_state(struct, 0.0, 0.0)
    if status != OK:
        return status
    data = open_data(struct)
    status = call_cfunc(data.functions.record, struct, 0.0, 0.0)
    check = data.check
    check.solved = 1 if believable(data.solution, data.solution.residual) else 0
    write_residuals(struct, data.accelerations.a, data.forces.f, data.rows.force, data.rows.c)
    check.gap, check.gap_rate = greatest_gaps(data.rows.kinematics)
    return status


@cfunc
def record_solution(address, size, _a, _b):
    """Write the residual of the last solution into ``data.solution``.

    Where the residual is too large, the equations are solved again with every block decomposed.
    """
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    solution, blocks = data.solution, data.bodies.pointers.shape[0]
    solution.residual = residual_of_all(model, data, work)
    # modes have solutions of their own
    repeatable = solution.elimination != DENSE and not data.modes.active
    solved = believable(solution, solution.residual)
    if not solved and repeatable and solution.coupled_blocks < blocks:
        if call_cfunc(data.functions.decomposed, struct, 0.0, 0.0) != OK:
            solution.imbalance = math.nan
        solution.residual = residual_of_all(model, data, work)
    return OK


@kernel
def believable(solution, residual):
    """Whether a relative residual is that of a solution.

    Near a loss of rank, rounding errors of the gaps are magnified by the square of the distance
    from it.
    """
    rounded = min(MOST_ROUNDED_RESIDUAL, ROUNDED_RESIDUAL / (solution.margin * solution.margin))
    return residual <= max(RESIDUAL_BOUND, rounded)


@cfunc
def compare_solution(address, size, _a, _b):
    """Write the recorded solution into ``data.this_step``, compared with that of the last step."""
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    solution, step, before = data.this_step.solution, data.this_step, data.last_step
    solution.known, solution.rank, solution.margin = 1, data.solution.rank, data.solution.margin
    solution.coupled_blocks = data.solution.coupled_blocks
    solution.motion_unique = data.solution.motion_unique
    solution.residual = data.solution.residual
    solution.correction = max(data.status.position_change, data.status.velocity_change)
    changed = not before.solution.known or before.solution.rank != solution.rank
    solution.changes = 1 if changed else 0
    for i in range(step.sign_changes.size):
        step.sign_changes[i] = 0
        step.lost_directions[i] = before.lost_directions[i]
        step.determinant_signs[i] = before.determinant_signs[i]
    elimination = data.solution.elimination
    if elimination != WHOLE and elimination != SPLIT:  # no directions of blocks
        return OK
    coupled = open_coupled(struct)
    for i in range(step.lost_directions.size):
        lost = 0
        if not work.pivot[i] > COUPLED_BELOW:
            lost = count_lost(i, before.lost_directions[i], work, coupled)
        elif work.pivot[i] < REGAINED * REGAINED * COUPLED_BELOW:
            lost = before.lost_directions[i]
        elif joint_count(i, work) == contact_count(i, work):
            sign = determinant_sign(i, work, coupled)
            if sign * before.determinant_signs[i] < 0.0:
                step.sign_changes[i] = 1
                solution.changes += 1
            step.determinant_signs[i] = sign
        if lost != before.lost_directions[i]:
            step.lost_directions[i] = lost
            solution.changes += 1
    return OK


@kernel
def accept_solution(data):
    """Make the solution of this step that of the last one."""
    solution, last = data.this_step.solution, data.last_step.solution
    last.known, last.rank, last.margin = solution.known, solution.rank, solution.margin
    last.coupled_blocks, last.motion_unique = solution.coupled_blocks, solution.motion_unique
    last.residual, last.correction = solution.residual, solution.correction
    last.changes = solution.changes
    copy(data.this_step.lost_directions, data.last_step.lost_directions)
    copy(data.this_step.determinant_signs, data.last_step.determinant_signs)
    copy(data.this_step.sign_changes, data.last_step.sign_changes)


@kernel
def count_lost(i, before, work, coupled):
    """Number of lost directions of a deficient block, with hysteresis."""
    fewest = most = 0
    for a in range(work.first_contact[i], work.first_contact[i + 1]):
        share = coupled.sigma[a] / coupled.scale[i] if coupled.scale[i] > 0.0 else 0.0
        fewest += 1 if share < LOST else 0
        most += 1 if share < REGAINED * LOST else 0
    if fewest > before:
        return fewest
    return most if most < before else before


@kernel
def determinant_sign(i, work, coupled):
    """Sign of ``det(W)`` of a regular block with as many contacts as joints, from its LU factors.

    0 where it is not known.
    """
    n, A, pivots = joint_count(i, work), coupled.A[i], coupled.pivots
    copy_block(work.W[i], n, n, A)
    if not factor_lu(A, n, pivots) > 0.0:
        return 0.0
    sign = 1.0
    for k in range(n):
        if (A[k, k] < 0.0) != (pivots[k] != k):
            sign = -sign
    return sign
