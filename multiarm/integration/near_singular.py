r"""Evaluation near a loss of rank: flat linkages, crossing motions.

Where two motions of the chains cross, a singular value ``s`` of the constraints passes through
zero.  The acceleration stays smooth along the current motion, but solving for it there multiplies
roundings by ``1/s^3``: a gap divided by ``s`` is the distance from that motion, and two more
divisions give the errors of the velocity and of the acceleration.  Near the loss of rank the
acceleration is therefore interpolated along the motion, from three states on either side at
distances :math:`\delta, 2\delta, 3\delta`,

.. math::
    f(0) \approx \tfrac34 (f_1 + f_{-1}) - \tfrac3{10} (f_2 + f_{-2}) + \tfrac1{20} (f_3 + f_{-3}),

with an error of :math:`\delta^6 / 20` times the sixth derivative.  The states are the current one,
displaced along its velocity and projected.  The interpolation is not used where the constraints
stay as near to the loss of rank, or where its result violates them.  At rest there is no motion to
follow, and the direction in which the chains move on is undetermined: the independent constraints
decide.  The contact forces are those of the state itself: they really grow like ``1/s``, as in a
toggle.  User callbacks are called for the state itself only: systems with any are not interpolated.
"""

from __future__ import annotations

from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.coordinates import retract_into
from multiarm.dynamics.equations import evaluate_projected, evaluate_state
from multiarm.dynamics.residuals import constraint_residual
from multiarm.dynamics.solver_monitor import believable
from multiarm.dynamics.status import OK
from multiarm.integration.projection import cost_of_projection, project
from multiarm.jit.kernels import cfunc, clear, copy, greatest, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import struct_at

# Singular value of the constraints below which accelerations are interpolated.
ZONE = 2e-2
# Distance between the states of the interpolation [rad, m], of the fastest coordinate.
OFFSET = 0.017
# A system whose fastest coordinate is slower [rad/s, m/s] has no motion to follow.
AT_REST = 1e-8


@kernel
def evaluate_on_branch(struct, gap_tolerance, projected, alpha, beta):
    """:func:`multiarm.dynamics.equations.evaluate_state`, interpolated near a loss of rank.

    ``gap_tolerance`` is the gap that projection leaves [m]; ``projected`` says that the velocities
    were projected right before.  What interpolation takes is in ``data.interpolation.numbers``.
    """
    if projected:
        status = evaluate_projected(struct, alpha, beta)
    else:
        status = evaluate_state(struct, alpha, beta)
    data = open_data(struct)
    data.interpolation.numbers.evaluations = 0
    if status != OK or data.solution.coupled_blocks == 0:
        return status
    data.interpolation.numbers.gap = gap_tolerance
    return call_cfunc(data.functions.near_singular, struct, alpha, beta)


@cfunc
def evaluate_near_singular(address, size, alpha, beta):
    """Continue an evaluation in which some blocks are deficient, see :func:`evaluate_on_branch`."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    if model.calls_user or not may_cross(data):
        return OK
    fastest = greatest(data.state.velocity)
    if fastest < AT_REST:
        return OK
    position_change, velocity_change = data.status.position_change, data.status.velocity_change
    save_state(data)
    interpolated = interpolate_accelerations(struct, alpha, beta, OFFSET / fastest)
    restore_state(data)
    data.status.position_change, data.status.velocity_change = position_change, velocity_change
    # everything but the accelerations belongs to the state itself
    data.interpolation.numbers.evaluations += 1
    status = evaluate_state(struct, alpha, beta)
    if status == OK and interpolated:
        exchange_solution(data)
        if not believable(data.solution, constraint_residual(model, data, work)):
            exchange_solution(data)
    return status


@inlined
def may_cross(data):
    """Whether motions may cross so near to the last solution that it is interpolated."""
    # before a run the rank elsewhere is unknown: the state may be exactly on the crossing
    unknown = not data.last_step.solution.known and data.solution.dependent > 0
    return data.solution.margin < ZONE or unknown


@kernel
def interpolate_accelerations(struct, alpha, beta, delay):
    """Interpolate the accelerations from states at multiples of ``delay`` [s].

    Returns whether it succeeded: not when a state cannot be reached, or when the constraints are
    not further from losing rank there.
    """
    data = open_data(struct)
    state, mixed, solution = data.state, data.interpolation.acceleration, data.solution
    here, there = solution.margin, 0.0
    redundant = fewest = solution.dependent
    clear(mixed)
    for side in range(6):
        k = 1 + side // 2
        restore_state(data)
        ahead, start = (k if side % 2 == 0 else -k) * delay, data.interpolation.configuration
        frames, bases = state.poses.shape[0], state.floating_bases
        retract_into(frames, bases, start, ahead, state.velocity, state.configuration)
        numbers = data.interpolation.numbers
        status = project(struct, numbers.gap)
        numbers.evaluations += cost_of_projection(data)
        if status != OK:
            return False
        numbers.evaluations += 1
        if evaluate_projected(struct, alpha, beta) != OK:
            return False
        there = max(there, solution.margin)
        fewest = min(fewest, solution.dependent)
        if side == 1 and fewest == redundant and not (here < ZONE and there >= 2.0 * here):
            return False
        weight = 0.75 if k == 1 else (-0.3 if k == 2 else 0.05)
        for j in range(mixed.size):
            mixed[j] += weight * data.accelerations.a[j]
    return True


@kernel
def exchange_solution(data):
    """Exchange the accelerations with those in ``data.interpolation``."""
    mixed, acceleration = data.interpolation.acceleration, data.accelerations.a
    for j in range(mixed.size):
        mixed[j], acceleration[j] = acceleration[j], mixed[j]


@kernel
def save_state(data):
    """Keep the state in ``data``."""
    copy(data.state.configuration, data.interpolation.configuration)
    copy(data.state.velocity, data.interpolation.velocity)


@kernel
def restore_state(data):
    """Return to the kept state."""
    copy(data.interpolation.configuration, data.state.configuration)
    copy(data.interpolation.velocity, data.state.velocity)
