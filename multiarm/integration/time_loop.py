"""The loop over time, compiled: steps, error control, stabilisation, samples.

There is one loop for all methods and scenes.  It lets go of Python's lock, so that loops of several
threads run side by side.  It enters Python only for what is there: Pinocchio's arms, the dense
solver, functions of the user's; and once for an entry that is compiled late.  It returns when the
block of samples is full, when its budget of evaluations is used up (progress, checkpoints and
Ctrl-C live in Python), or at the end.  Everything it must remember in between is in :class:`Clock`,
so that it goes on where it left off.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import GAP
from multiarm.dynamics.arrays import (
    CALLBACK_FAILED,
    CONTRADICTION,
    NOT_FINITE,
    OK,
    open_coupled,
    open_system,
)
from multiarm.dynamics.equations import finite, largest
from multiarm.dynamics.solver_monitor import believable, note_solution, watch_solver
from multiarm.integration.dense_output import interpolate, prepare_dense
from multiarm.integration.monitors import watch_step
from multiarm.integration.near_singular import evaluate_on_branch
from multiarm.integration.projection import FEEDBACK_RATIO, near_loss, project
from multiarm.integration.samples import follow_joints, write_sample
from multiarm.integration.stepper import (
    OWN_EVALUATIONS,
    error_estimate,
    evaluate_slope,
    load,
    open_step,
    run_stages,
    store,
    write_slope,
)
from multiarm.integration.tableaus import EXPLICIT, SEMI_IMPLICIT, VARIATIONAL
from multiarm.jit.kernels import clear, copy, kernel, unlocked
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import Flag, Float, Floats1, Int, Numbers, view

# Why the loop returned; values from -1 up to the number of arms are an evaluation's status.
FINISHED, BLOCK_FULL, BUDGET_USED = -10, -11, -12
STEP_TOO_SMALL, DIVERGED, SOLVER_CHANGED, LARGE_CORRECTION, STIFF = -13, -14, -15, -16, -17
# An event lies within the step just made, which was not accepted; the run came to its stop.
EVENT, STOPPED = -19, -20

# Step size control (Hairer, Norsett, Wanner, II.4 and IV.2).
SAFETY, SHRINK, GROW = 0.9, 0.2, 6.0

NONE, FEEDBACK, PROJECTION = 0, 1, 2

# Shortest step, relative to the time: a run that needs shorter ones does not get on.
SMALLEST_STEP = 1e-12
# A projection that changes the state by more than so many tolerances of a step makes it shorter, as
# long as that lessens the change, or as it is hopelessly large.
MOST_CORRECTED, LESSENED, HOPELESS = 30.0, 0.5, 1e4
# What roundings of gaps alone change: so much over the distance from a loss of rank in positions,
# over its square in velocities, and at most.
ROUNDED_GAP, MOST_ROUNDED_GAP = 1e-14, 1e-5
# Changes of positions and of velocities that are roundings, as multiples of the gap that counts as
# closed.
ROUNDED_SHIFT, ROUNDED_KICK = 10.0, 1e3
# Where constraints are near a loss of rank, steps fail that are not short; so many steps are then
# taken with projected stages, which may be long.
CAREFUL_STEPS = 3
# The errors of such steps are not judged by less than what roundings make of a motion that crosses
# another one [m, rad; m/s, rad/s]: so much over the cube of the distance from the loss, at most so.
ROUNDED, MOST_ROUNDED = 2e-15, 1e-9
# A scene counts as stiff when so many steps were as long as stability allows, with fewer than so
# many in a row that were not in between (Hairer and Wanner, IV.2).
STIFF_AFTER, SMOOTH_AFTER = 15, 6
# Times closer than this, relative to the run, are one.
CLOSE_IN_TIME = 1e-12


class Settings(NamedTuple):
    """How the run is carried out.

    begin, end, sample_step : float
        Times [s]; samples are taken every ``sample_step`` from ``begin``, and at ``end``.
    samples : int
        How many in all.
    adaptive : bool
    step : float
        The fixed step, or the first one of an adaptive method [s].
    longest_step : float
        Of an adaptive method [s].
    tolerance : float
        The smallest of ``Step.tolerance``.
    stabilization : int
    alpha, beta : float
        Gains of the feedback [1/s]; negative: ``FEEDBACK_RATIO / step``.
    closed : float
        Gap that counts as closed by projection [m]; negative: no projection.
    apart : float
        Gap at which the run is given up as diverged [m].
    breakpoints : ndarray
        Increasing times at which something is not smooth.  An adaptive method ends a step there; a
        step that ends there is evaluated just before, and the next one begins just after it.
    switch : bool
        Return when an explicit method turns out to be held up by stiffness.
    stop : float
        Time at which a step ends and the loop returns, before the end [s]; infinite: none.
    """

    begin: Float
    end: Float
    sample_step: Float
    samples: Int
    adaptive: Flag
    step: Float
    longest_step: Float
    tolerance: Float
    stabilization: Int
    alpha: Float
    beta: Float
    closed: Float
    apart: Float
    breakpoints: Floats1
    switch: Flag
    stop: Float


class Clock(Numbers):
    """What the loop remembers between calls.

    Attributes
    ----------
    t, h : float
        Time, and the next step [s].
    t_before, h_before, error_before : float
        Beginning, length and error of the last step [s, s, tolerances].
    error_sum : float
        Sum of the accepted steps' error estimates [m, rad].
    smallest_step, largest_step : float
        [s]
    correction : float
        For which the step was rejected last [tolerances].
    worst_residual, worst_correction : float
        Largest relative residual, and largest correction of an accepted step [m, rad; m/s, rad/s].
    stiff_since : float
        Time at which the scene turned out to be stiff [s].
    steps, rejected, evaluations, projections : int
    sample, block_first : int
        Next sample, and the first one of the block.
    breakpoint : int
        The next one.
    cause : int
        Why the last step was rejected.
    coupled_steps, lowest_rank, highest_rank : int
        Steps that ended with deficient arms; ranks of the constraints.
    solver_changes : int
        That Python has not looked at.
    retry_steps : int
        Steps to go with projected stages.
    stiff_steps, smooth_steps : int
        Steps limited by stiffness, and steps since that were not.
    """

    t: Float
    h: Float
    t_before: Float
    h_before: Float
    error_before: Float
    error_sum: Float
    smallest_step: Float
    largest_step: Float
    correction: Float
    worst_residual: Float
    worst_correction: Float
    stiff_since: Float
    steps: Int
    rejected: Int
    evaluations: Int
    projections: Int
    sample: Int
    block_first: Int
    breakpoint: Int
    cause: Int
    coupled_steps: Int
    lowest_rank: Int
    highest_rank: Int
    solver_changes: Int
    retry_steps: Int
    stiff_steps: Int
    smooth_steps: Int


_view_clock, _view_settings = view(Clock), view(Settings)


def make_clock(settings: Settings) -> Clock:
    """A clock at the beginning of a run."""
    return Clock(
        t=settings.begin,
        h=settings.step,
        error_before=1.0,
        smallest_step=math.inf,
        stiff_since=math.nan,
        cause=STEP_TOO_SMALL,
        lowest_rank=np.iinfo(np.int64).max,
    )


@kernel
def gains(settings, h):
    """Feedback gains of a step of length ``h``."""
    if settings.stabilization != FEEDBACK:
        return 0.0, 0.0
    alpha = settings.alpha if settings.alpha >= 0.0 else FEEDBACK_RATIO / h
    beta = settings.beta if settings.beta >= 0.0 else FEEDBACK_RATIO / h
    return alpha, beta


@kernel
def sample_time(settings, k):
    """Time of sample ``k``."""
    if k == settings.samples - 1:
        return settings.end
    return settings.begin + k * settings.sample_step


@kernel
def settle(struct, clock, settings, projected, t, alpha, beta):
    """Project the state in ``data``, unless it is ``projected``, and evaluate it; returns a
    status.
    """
    _, data, _ = open_system(struct)
    if settings.closed >= 0.0 and not projected:
        status = project(struct, settings.closed)
        clock.projections += 1
        clock.evaluations += 2
        if status != OK:
            return status
    data.time.now = t
    clock.evaluations += 1
    return evaluate_on_branch(struct, settings.closed, alpha, beta)


@kernel
def emit_samples(struct, method, step, clock, settings, block):
    """Write the samples that are due up to now; returns a status (``OK``: all written)."""
    _, data, _ = open_system(struct)
    t = clock.t
    rows = clock.sample - clock.block_first
    near = 1e-9 * max(clock.h_before, 1e-12)
    while clock.sample < settings.samples:
        due = sample_time(settings, clock.sample)
        if due > t + near:
            return OK
        if rows >= block.shape[0]:
            return BLOCK_FULL
        alpha, beta = gains(settings, max(clock.h_before, settings.step))
        projected = True
        if due >= t - near:
            load(step.z, step.base, data)
            works = step.z[step.tolerance.size :]
        else:
            projected = False
            interpolate(method, step, (due - clock.t_before) / clock.h_before, step.z_stage)
            load(step.z_stage, step.base_old, data)
            works = step.z_stage[step.tolerance.size :]
        status = settle(struct, clock, settings, projected, due, alpha, beta)
        if status != OK:
            return status
        note_solution(struct)
        write_sample(struct, due, works, block[rows])
        if data.status.failed:
            return CALLBACK_FAILED
        rows += 1
        clock.sample += 1
    return OK


@kernel
def watch_start(struct):
    """Note the joints' coordinates at the start of a run, and what is amiss there already."""
    model, data, _ = open_system(struct)
    follow_joints(model, data)
    watch_step(struct, 0.0, 0.0)
    note_solution(struct)
    watch_solver(struct)


@kernel
def planned_step(method, clock, settings):
    """Length of the next step and the time at which it ends."""
    t = clock.t
    breakpoints = settings.breakpoints
    near = CLOSE_IN_TIME * (1.0 + settings.end)
    while clock.breakpoint < breakpoints.size and breakpoints[clock.breakpoint] <= t + near:
        clock.breakpoint += 1
    if not settings.adaptive:
        past = math.floor((t - settings.begin) / settings.step + 1e-9)
        end = settings.begin + (past + 1) * settings.step
        last = min(settings.end, settings.stop)
        if end > last - 1e-9 * settings.step:
            end = last
        return end - t, end
    stop = min(settings.end, settings.stop)
    if clock.breakpoint < breakpoints.size and breakpoints[clock.breakpoint] < stop - near:
        stop = breakpoints[clock.breakpoint]
    h = min(clock.h, settings.longest_step)
    if t + 1.01 * h >= stop:
        return stop - t, stop
    if t + 2.0 * h > stop:
        h = 0.5 * (stop - t)  # two equal steps rather than a long and a tiny one
    return h, t + h


@kernel
def breakpoint_at(clock, settings, end):
    """The breakpoint at which a step ends; infinite when it ends at none."""
    k = clock.breakpoint
    near = CLOSE_IN_TIME * (1.0 + settings.end)
    if k < settings.breakpoints.size and abs(settings.breakpoints[k] - end) <= near:
        return settings.breakpoints[k]
    return math.inf


@kernel
def try_step(struct, joints, method, step, clock, settings, h):
    """Stages and error estimate of one step; returns (status, error in units of the tolerance)."""
    t = clock.t
    alpha, beta = gains(settings, h)
    copy(step.slope, step.k[0])
    if settings.stabilization == FEEDBACK and settings.adaptive:
        # the gains belong to this step's length, the slope at hand to another one's
        status = evaluate_slope(struct, t, step.z, step.base, alpha, beta, step.k[0])
        clock.evaluations += 1
        if status != OK:
            return status, 0.0
    status = run_stages(struct, joints, method, step, t, h, alpha, beta)
    _, data, _ = open_system(struct)
    own = method.kind != EXPLICIT and method.kind != SEMI_IMPLICIT
    stages = step.own[OWN_EVALUATIONS] if own else method.stages - 1
    # a projection is counted as two evaluations
    projected = data.status.stage_gap >= 0.0 and method.kind != VARIATIONAL
    clock.evaluations += 3 * stages if projected else stages
    if status != OK:
        return status, 0.0
    if not finite(step.z_new):
        return NOT_FINITE, 0.0
    if not settings.adaptive:
        return OK, 0.0
    if method.error[0, method.stages] != 0.0:
        status = evaluate_slope(
            struct, t + h, step.z_new, step.base, alpha, beta, step.k[method.stages]
        )
        clock.evaluations += 1
        if status != OK:
            return status, 0.0
    error = error_estimate(method, step, h, rounding_floor(struct, clock))
    return (OK, error) if math.isfinite(error) else (NOT_FINITE, 0.0)


@kernel
def judge_solution(struct, data, clock, settings):
    """Whether the end of a step can be believed: ``CONTRADICTION``, ``LARGE_CORRECTION`` or ``OK``.

    What the projection changes is the part of a step's error that led off the joints, and must be
    within the tolerance as the estimate is.  Near a bifurcation a step may end between two
    branches, and the projection then takes the state far: a shorter step ends nearer to the branch
    that the motion is on.  There the change has other causes too, and may be larger.
    """
    if not believable(struct, data.status.residual):
        return CONTRADICTION
    if settings.adaptive and settings.closed >= 0.0:
        floor = max(settings.tolerance, rounding_floor(struct, clock))
        margin, most = open_coupled(struct).status.least_margin, 1.0
        moved, kicked = ROUNDED_SHIFT * settings.closed, ROUNDED_KICK * settings.closed
        if not math.isinf(margin):
            most = MOST_CORRECTED
            moved = min(MOST_ROUNDED_GAP, ROUNDED_GAP / margin) / most
            kicked = min(MOST_ROUNDED_GAP, ROUNDED_GAP / (margin * margin)) / most
        correction = max(
            data.status.position_change / max(floor, moved),
            data.status.velocity_change / max(floor, kicked),
        )
        before = clock.correction
        lessened = before == 0.0 or correction < LESSENED * before or correction > HOPELESS
        if correction > most and lessened:
            clock.correction = correction
            return LARGE_CORRECTION
    return OK


@kernel
def count_solution(struct, data, clock):
    """Statistics of how the end of an accepted step was solved."""
    status = data.status
    rank = status.rank
    clock.lowest_rank = min(clock.lowest_rank, rank)
    clock.highest_rank = max(clock.highest_rank, rank)
    if status.coupled_arms > 0:
        clock.coupled_steps += 1
    clock.worst_residual = max(clock.worst_residual, status.residual)
    clock.worst_correction = max(
        clock.worst_correction, status.position_change, status.velocity_change
    )
    clock.solver_changes += watch_solver(struct)


@kernel
def complete_step(struct, method, step, clock, settings, h, end):
    """Stabilise the end of an accepted step, evaluate there, prepare its dense output."""
    model, data, _ = open_system(struct)
    t = clock.t
    alpha, beta = gains(settings, h)
    load(step.z_new, step.base, data)
    # the variational method keeps the joints closed itself
    closed = method.kind == VARIATIONAL
    status = settle(struct, clock, settings, closed, min(end, data.time.latest), alpha, beta)
    if status != OK:
        return status
    note_solution(struct)
    status = judge_solution(struct, data, clock, settings)
    if status != OK:
        return status
    gap = largest(data.contacts, GAP)
    if not gap <= settings.apart:
        return DIVERGED if math.isfinite(gap) else NOT_FINITE
    # the slope of the next step, in this chart for the dense output and in the next one for it
    write_slope(step.z_new, data, step.k[method.stages])
    if data.functions.guards != 0 and call_cfunc(data.functions.guards, struct, t, end) != OK:
        status = prepare_dense(struct, method, step, t, h, alpha, beta)
        return EVENT if status == OK else status
    if data.places.size > 0:
        for i in range(data.places.shape[0]):
            copy(data.located[i], data.places[i])
    follow_joints(model, data)
    watch_step(struct, t, end)
    count_solution(struct, data, clock)
    if settings.adaptive and method.kind == EXPLICIT:
        note_stiffness(method, step, clock, h, end)
    if not math.isinf(data.time.latest):
        after = max(end, breakpoint_at(clock, settings, end))
        status = settle(struct, clock, settings, True, after, alpha, beta)
        if status != OK:
            return status
    clear(step.z_stage)
    write_slope(step.z_stage, data, step.slope_next)
    due = sample_time(settings, clock.sample) if clock.sample < settings.samples else math.inf
    store(data, step.base_next, step.z_next)
    copy(step.z_new[step.tolerance.size :], step.z_next[step.tolerance.size :])
    if due < end - 1e-9 * h:
        status = prepare_dense(struct, method, step, t, h, alpha, beta)
        clock.evaluations += max(0, method.A.shape[0] - method.stages - 1)
        if status != OK:
            return status
    copy(step.z_next, step.z)
    copy(step.base_next, step.base)
    copy(step.slope_next, step.slope)
    return OK


@kernel
def note_stiffness(method, step, clock, h, end):
    r"""Count steps that are as long as stability allows.

    The last stage and the end of the step belong to one time; what separates them shows the largest
    eigenvalue, :math:`|\lambda| \approx \|f(z_1) - f(z_2)\| / \|z_1 - z_2\|`.
    """
    last, end_of = method.stages - 1, method.stages
    rates = states = 0.0
    for i in range(step.tolerance.size):
        rates += (step.k[end_of, i] - step.k[last, i]) ** 2
        states += (step.z_new[i] - step.z_stage[i]) ** 2
    if states > 0.0 and h * h * rates > method.stability**2 * states:
        clock.stiff_steps += 1
        clock.smooth_steps = 0
        if clock.stiff_steps == STIFF_AFTER:
            clock.stiff_since = end
    elif clock.stiff_steps < STIFF_AFTER:
        clock.smooth_steps += 1
        if clock.smooth_steps == SMOOTH_AFTER:
            clock.stiff_steps = 0


@kernel
def rounding_floor(struct, clock):
    """Smallest error that a step with projected stages can be asked for."""
    if clock.retry_steps == 0:
        return 0.0
    margin = open_coupled(struct).status.least_margin
    return min(MOST_ROUNDED, ROUNDED / margin**3)


@kernel
def before_breakpoint(struct, clock, settings, end):
    """See to it that a step that ends at a breakpoint does not see what comes after it."""
    _, data, _ = open_system(struct)
    ahead = not math.isinf(breakpoint_at(clock, settings, end))
    data.time.latest = end - CLOSE_IN_TIME * (1.0 + settings.end) if ahead else math.inf


@kernel
def project_stages(struct, clock, settings):
    """Decide whether the stages of the coming step are projected."""
    _, data, _ = open_system(struct)
    open_coupled(struct).status.least_margin = math.inf
    careful = clock.retry_steps > 0
    if not settings.adaptive and settings.closed >= 0.0:
        careful = near_loss(struct)
    data.status.stage_gap = settings.closed if careful else -1.0


@kernel
def next_length(method, h, error, error_old):
    """PI controller for the next step from this step's error and the one before."""
    order = 1.0 / (method.error_order + 1.0)
    if error == 0.0:
        return GROW * h
    factor = SAFETY * error ** (-0.7 * order) * error_old ** (0.4 * order)
    return h * min(GROW, max(SHRINK, factor))


@unlocked
def advance(struct, joints, arrays, clock, settings, block, budget):
    """Integrate until the end, a full block, the budget of evaluations, or trouble.

    ``struct`` is the system's, ``arrays`` that of the method and its step; ``clock`` and
    ``settings`` are those of the run.
    ``block`` (samples, width) receives the samples from ``clock.block_first`` on.  Returns
    the reason.
    """
    method, step = open_step(arrays)
    clock, settings = _view_clock(clock), _view_settings(settings)
    limit = clock.evaluations + budget
    while True:
        status = emit_samples(struct, method, step, clock, settings, block)
        if status != OK:
            return status
        if clock.t >= settings.end:
            return FINISHED
        if clock.t >= settings.stop:
            return STOPPED
        if settings.switch and clock.stiff_steps >= STIFF_AFTER:
            return STIFF
        if clock.evaluations >= limit:
            return BUDGET_USED
        h, end = planned_step(method, clock, settings)
        if not h > max(SMALLEST_STEP * clock.t, 8.0 * np.finfo(np.float64).eps * 1e-3):
            return clock.cause
        project_stages(struct, clock, settings)
        before_breakpoint(struct, clock, settings, end)
        status, error = try_step(struct, joints, method, step, clock, settings, h)
        if status == OK and error <= 1.0:
            status = complete_step(struct, method, step, clock, settings, h, end)
            if status == OK:
                accept(struct, method, clock, settings, h, end, error)
                if clock.solver_changes > 0:
                    clock.solver_changes = 0
                    return SOLVER_CHANGED
                continue
        if status in (CALLBACK_FAILED, EVENT) or not settings.adaptive:
            return status
        clock.rejected += 1
        if near_loss(struct) and settings.closed >= 0.0:
            if clock.retry_steps == 0:
                clock.retry_steps = CAREFUL_STEPS
                continue  # the same step, with projected stages
            clock.retry_steps = CAREFUL_STEPS
        if status == OK:
            clock.cause = STEP_TOO_SMALL
            clock.h = h * max(SHRINK, SAFETY * error ** (-1.0 / (method.error_order + 1.0)))
        else:
            clock.cause = status
            clock.h = 0.25 * h


@kernel
def accept(struct, method, clock, settings, h, end, error):
    """Move the clock to the end of an accepted step."""
    if settings.adaptive:
        proposal = next_length(method, h, error, clock.error_before)
        # a step cut short by a breakpoint or the end says little about the one planned
        clock.h = max(proposal, clock.h) if h < clock.h else proposal
        clock.error_before = max(error, 1e-4)
        clock.error_sum += error * max(settings.tolerance, rounding_floor(struct, clock))
    clock.t_before, clock.h_before, clock.t = clock.t, h, end
    clock.correction = 0.0
    clock.retry_steps = max(clock.retry_steps - 1, 0)
    clock.smallest_step = min(clock.smallest_step, h)
    clock.largest_step = max(clock.largest_step, h)
    clock.steps += 1
