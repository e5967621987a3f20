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

import numpy as np

from multiarm.dynamics.arrays import (
    CALL_CROSSING,
    CALLS,
    FLAG,
    KICK,
    SHIFT,
    asks_python,
    open_coupled,
    open_system,
)
from multiarm.dynamics.equations import CALLBACK_FAILED, OK, evaluate_buffers
from multiarm.dynamics.solver.singular import ARMS, RANK, UNKNOWNS
from multiarm.dynamics.solver_monitor import believable, constraint_residual
from multiarm.integration.projection import greatest, project
from multiarm.jit.kernels import cfunc, clear, copy, kernel
from multiarm.jit.lazy import LazyFunction
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
    """:func:`multiarm.dynamics.equations.evaluate_buffers`, interpolated near a loss of rank.

    ``closed`` is the gap to which states are projected [m]; negative: nothing is interpolated.
    """
    status = evaluate_buffers(struct, alpha, beta)
    if status != OK or closed < 0.0 or open_coupled(struct).counts[ARMS] == 0:
        return status
    plant, buffers, _ = open_system(struct)
    buffers.stage_gap[1] = closed
    return call_cfunc(plant.calls[CALL_CROSSING], struct, alpha, beta)


@cfunc
def _evaluate_near_crossing(address, size, alpha, beta):
    """Go on with an evaluation in which some arms are deficient; see the function above."""
    struct = struct_at(address, size)
    plant, buffers, work = open_system(struct)
    coupled, closed = open_coupled(struct), buffers.stage_gap[1]
    # before a run nothing is known of the rank elsewhere: the state may be on the very crossing
    unknown = buffers.lost[buffers.lost.size - 1] == 0 and excess(coupled) > 0
    if not (coupled.margin[0] < ZONE or unknown):
        return OK
    if asks_python(plant):
        return OK
    rate = max(greatest(buffers.twist), greatest(buffers.v))
    if rate < AT_REST:
        return OK
    shift, kick = buffers.solved[SHIFT], buffers.solved[KICK]
    keep_state(buffers, buffers.kept)
    crossing = mix_evaluations(struct, closed, alpha, beta, OFFSET / rate)
    restore_state(buffers.kept, buffers)
    buffers.solved[SHIFT], buffers.solved[KICK] = shift, kick
    # everything but the accelerations belongs to the state itself
    status = evaluate_buffers(struct, alpha, beta)
    if status == OK and crossing:
        exchange_solution(buffers)
        if not believable(struct, constraint_residual(plant, buffers, work)):
            exchange_solution(buffers)
    return status


def connect_crossing(calls: np.ndarray) -> dict[str, LazyFunction]:
    """Write the address of what follows near a loss of rank into ``Plant.calls``."""
    crossing = LazyFunction(_evaluate_near_crossing, CALLS, CALL_CROSSING, FLAG, CALLBACK_FAILED)
    calls[CALL_CROSSING] = crossing.address
    return {"crossing": crossing}


@kernel
def excess(coupled):
    """How many of the unknown forces move nothing."""
    return coupled.counts[UNKNOWNS] - coupled.counts[RANK]


@kernel
def mix_evaluations(struct, closed, alpha, beta, delay):
    """Accelerations from states ``delay`` [s] and its multiples before and behind.

    Returns whether ``buffers.mixed`` has them: not when a state cannot be reached, or when the
    constraints are no further from losing rank there.
    """
    _, buffers, _ = open_system(struct)
    coupled = open_coupled(struct)
    n, mixed = buffers.angles.size, buffers.mixed
    here, there, fewest = coupled.margin[0], 0.0, excess(coupled)
    more = fewest
    clear(mixed)
    for side in range(6):
        k = 1 + side // 2
        restore_state(buffers.kept, buffers)
        move_state(buffers, (k if side % 2 == 0 else -k) * delay)
        if project(struct, closed) != OK or evaluate_buffers(struct, alpha, beta) != OK:
            return False
        there = max(there, coupled.margin[0] if coupled.counts[ARMS] > 0 else math.inf)
        fewest = min(fewest, excess(coupled) if coupled.counts[ARMS] > 0 else 0)
        if side == 1 and fewest == more and not (here < ZONE and there >= FURTHER * here):
            return False
        weight = 0.75 if k == 1 else (-0.3 if k == 2 else 0.05)
        for j in range(6):
            mixed[j] += weight * buffers.q_o[j]
        for j in range(n):
            mixed[6 + j] += weight * buffers.qdd[j]
    return True


@kernel
def exchange_solution(buffers):
    """Exchange the accelerations with those in ``buffers.mixed``."""
    mixed = buffers.mixed
    for j in range(mixed.size):
        other = mixed[j]
        if j < 6:
            mixed[j], buffers.q_o[j] = buffers.q_o[j], other
        else:
            mixed[j], buffers.qdd[j - 6] = buffers.qdd[j - 6], other


@kernel
def keep_state(buffers, kept):
    """Write the state in the buffers to ``kept``."""
    n = buffers.angles.size
    copy(buffers.position, kept[:7])
    copy(buffers.twist, kept[7:13])
    copy(buffers.angles, kept[13 : 13 + n])
    copy(buffers.v, kept[13 + n :])


@kernel
def restore_state(kept, buffers):
    """Write a kept state into the buffers."""
    n = buffers.angles.size
    copy(kept[:7], buffers.position)
    copy(kept[7:13], buffers.twist)
    copy(kept[13 : 13 + n], buffers.angles)
    copy(kept[13 + n :], buffers.v)


@kernel
def move_state(buffers, delay):
    """Move the state in the buffers along its velocity."""
    turn = buffers.q_o  # scratch: an evaluation follows
    for k in range(3):
        buffers.position[k] += delay * buffers.twist[k]
        turn[k] = delay * buffers.twist[3 + k]
    retract_into(buffers.position[3:7], turn[:3], buffers.position[3:7])
    for j in range(buffers.angles.size):
        buffers.angles[j] += delay * buffers.v[j]
