r"""Evaluating where closed chains are about to lose a rank: flat linkages, crossing motions.

Where two motions of the chains cross, a singular value ``s`` of the constraints goes through zero.
The acceleration stays smooth along the motion that the state is on, but computing it there divides
roundings by ``s^3``: those of a gap by ``s`` give the distance from that motion, and so twice more
the error of the velocity and of the acceleration.  Within ``ZONE`` of the loss it is therefore
interpolated along that motion, from three states on either side which lie ``OFFSET`` apart,

.. math::
    f(0) \approx \tfrac34 (f_1 + f_{-1}) - \tfrac3{10} (f_2 + f_{-2}) + \tfrac1{20} (f_3 + f_{-3}),

an error of ``OFFSET^6 / 20`` times the sixth derivative, where the states are the one at hand moved
on along its velocity and projected.  That holds for motions that cross; where the constraints stay
as near to the loss, or the interpolated acceleration misses them, it is not used.  At rest there is
no such motion, and which way the chains go on is undetermined: then the constraints that are left
decide.  The contact forces are those of the state itself: they really grow like ``1/s`` there, as a
toggle's do.  Functions in Python (controllers, surfaces, wrenches) are asked about the state itself
only: with them nothing is interpolated.
"""

from __future__ import annotations

import math

from multiarm.dynamics.arrays import OK, open_coupled, open_system
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.solver_monitor import believable, constraint_residual
from multiarm.integration.projection import greatest, project
from multiarm.jit.kernels import cfunc, clear, copy, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_at
from multiarm.spatial import retract_into

# Singular value of the constraints below which accelerations are interpolated.
ZONE = 2e-2
# Distance of the states between which this is done [rad, m] of the fastest coordinate.
OFFSET = 0.017
# The states next to the one at hand must be further from losing rank by this factor.
FURTHER = 2.0
# Coordinates slower than this are at rest [rad/s, m/s].
AT_REST = 1e-8


@kernel
def evaluate_on_branch(struct, closed, alpha, beta):
    """:func:`multiarm.dynamics.equations.evaluate_state`, interpolated near a loss of rank.

    ``closed`` is the gap to which states are projected [m]; negative: nothing is interpolated.
    """
    status = evaluate_state(struct, alpha, beta)
    if status != OK or closed < 0.0 or open_coupled(struct).status.arms == 0:
        return status
    _, data, _ = open_system(struct)
    data.status.branch_gap = closed
    return call_cfunc(data.functions.near_singular, struct, alpha, beta)


@cfunc
def evaluate_near_singular(address, size, alpha, beta):
    """Continue an evaluation in which some arms are deficient, see :func:`evaluate_on_branch`."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    coupled, closed = open_coupled(struct), data.status.branch_gap
    # before a run nothing is known of the rank elsewhere: the state may be on the very crossing
    unknown = data.lost[data.lost.size - 1] == 0 and excess(coupled) > 0
    if not (coupled.status.margin < ZONE or unknown):
        return OK
    if model.calls_user:
        return OK
    rate = max(greatest(data.twist), greatest(data.v))
    if rate < AT_REST:
        return OK
    shift, kick = data.status.position_change, data.status.velocity_change
    keep_state(data, data.kept)
    crossing = mix_evaluations(struct, closed, alpha, beta, OFFSET / rate)
    restore_state(data.kept, data)
    data.status.position_change, data.status.velocity_change = shift, kick
    # everything but the accelerations belongs to the state itself
    status = evaluate_state(struct, alpha, beta)
    if status == OK and crossing:
        exchange_solution(data)
        if not believable(struct, constraint_residual(model, data, work)):
            exchange_solution(data)
    return status


@kernel
def excess(coupled):
    """How many of the unknown forces move nothing."""
    return coupled.status.unknowns - coupled.status.rank


@kernel
def mix_evaluations(struct, closed, alpha, beta, delay):
    """Accelerations from states ``delay`` [s] and its multiples before and behind.

    Returns whether ``data.mixed`` has them: not when a state cannot be reached, or when the
    constraints are no further from losing rank there.
    """
    _, data, _ = open_system(struct)
    coupled = open_coupled(struct)
    n, mixed = data.angles.size, data.mixed
    here, there, fewest = coupled.status.margin, 0.0, excess(coupled)
    more = fewest
    clear(mixed)
    for side in range(6):
        k = 1 + side // 2
        restore_state(data.kept, data)
        move_state(data, (k if side % 2 == 0 else -k) * delay)
        if project(struct, closed) != OK or evaluate_state(struct, alpha, beta) != OK:
            return False
        there = max(there, coupled.status.margin if coupled.status.arms > 0 else math.inf)
        fewest = min(fewest, excess(coupled) if coupled.status.arms > 0 else 0)
        if side == 1 and fewest == more and not (here < ZONE and there >= FURTHER * here):
            return False
        weight = 0.75 if k == 1 else (-0.3 if k == 2 else 0.05)
        for j in range(6):
            mixed[j] += weight * data.q_o[j]
        for j in range(n):
            mixed[6 + j] += weight * data.qdd[j]
    return True


@kernel
def exchange_solution(data):
    """Exchange the accelerations with those in ``data.mixed``."""
    mixed = data.mixed
    for j in range(mixed.size):
        other = mixed[j]
        if j < 6:
            mixed[j], data.q_o[j] = data.q_o[j], other
        else:
            mixed[j], data.qdd[j - 6] = data.qdd[j - 6], other


@kernel
def keep_state(data, kept):
    """Write the state in ``data`` to ``kept``."""
    n = data.angles.size
    copy(data.position, kept[:7])
    copy(data.twist, kept[7:13])
    copy(data.angles, kept[13 : 13 + n])
    copy(data.v, kept[13 + n :])


@kernel
def restore_state(kept, data):
    """Write a kept state into the data."""
    n = data.angles.size
    copy(kept[:7], data.position)
    copy(kept[7:13], data.twist)
    copy(kept[13 : 13 + n], data.angles)
    copy(kept[13 + n :], data.v)


@kernel
def move_state(data, delay):
    """Move the state in ``data`` along its velocity."""
    turn = data.q_o  # scratch: an evaluation follows
    for k in range(3):
        data.position[k] += delay * data.twist[k]
        turn[k] = delay * data.twist[3 + k]
    retract_into(data.position[3:7], turn[:3], data.position[3:7])
    for j in range(data.angles.size):
        data.angles[j] += delay * data.v[j]
