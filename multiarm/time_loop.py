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

from multiarm.books import Flag, Float, Floats1, Int, Ints1, book_of, view
from multiarm.contacts.kernel import GAP
from multiarm.crossing import evaluate_on_branch
from multiarm.equations import (
    CALLBACK_FAILED,
    CONTRADICTION,
    NOT_FINITE,
    OK,
    finite,
    largest,
)
from multiarm.integrators.dense_output import interpolate, prepare_dense
from multiarm.integrators.stepper import (
    OWN_EVALUATIONS,
    error_estimate,
    evaluate_slope,
    load,
    open_step,
    run_stages,
    store,
    write_slope,
)
from multiarm.integrators.tableaus import EXPLICIT, SEMI_IMPLICIT, VARIATIONAL
from multiarm.lowlevel import call_entry, clear, copy, kernel, unlocked
from multiarm.plant import (
    CALL_GUARDS,
    COUPLED_ARMS,
    KICK,
    RANK_OF_ALL,
    RESIDUAL,
    SHIFT,
    open_book,
    open_coupled,
)
from multiarm.samples import follow_joints, write_sample
from multiarm.solver_watch import believable, note_solution, watch_solver
from multiarm.stabilization import FEEDBACK_RATIO, near_loss, project
from multiarm.watching import watch_step

# Why the loop returned; values from -1 up to the number of arms are an evaluation's status.
FINISHED, BLOCK_FULL, BUDGET_USED = -10, -11, -12
STEP_TOO_SMALL, DIVERGED, SOLVER_CHANGED, LARGE_CORRECTION, STIFF = -13, -14, -15, -16, -17
# An event lies within the step just made, which was not accepted; the run came to its stop.
EVENT, STOPPED = -19, -20

# Step size control (Hairer, Norsett, Wanner, II.4 and IV.2).
SAFETY, SHRINK, GROW = 0.9, 0.2, 6.0

# Entries of Clock.real and Clock.counts.
T, H, T_OLD, H_OLD, ERROR_OLD, ERROR_SUM, SMALLEST, LARGEST = range(8)
CORRECTION, WORST_RESIDUAL, WORST_CORRECTION, STIFF_SINCE, REAL_WIDTH = range(8, 13)
STEPS, REJECTED, EVALUATIONS, PROJECTIONS, SAMPLE, BLOCK_FIRST, BREAK, CAUSE = range(8)
COUPLED_STEPS, LOWEST_RANK, HIGHEST_RANK, CHANGES, CAREFUL = range(8, 13)
STIFF_STEPS, SMOOTH_STEPS, COUNT_WIDTH = range(13, 16)

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


class Clock(NamedTuple):
    """What the loop remembers between calls.

    real : (13,)
        Time, next step, beginning and length of the step before, its error, the sum of the accepted
        steps' error estimates [m, rad], smallest and largest step, correction for which the step
        was rejected last (in tolerances), largest relative residual, largest correction of an
        accepted step [m, rad; m/s, rad/s], time at which the scene turned out to be stiff.
    counts : int64 (16,)
        Steps, rejected steps, evaluations, projections, next sample, the block's first sample, next
        breakpoint, cause of the last rejection; steps that ended with deficient arms, lowest and
        highest rank, changes of the solver that nobody has looked at, steps to go with projected
        stages; steps held up by stiffness, and steps since that were not.
    """

    real: Floats1
    counts: Ints1


_open_clock, _open_settings = view(Clock), view(Settings, len(Clock._fields))


def run_book(clock: Clock, settings: Settings) -> np.ndarray:
    """Address book of a run's clock and settings, as :func:`advance` takes it."""
    return book_of(clock, settings)


def make_clock(settings: Settings) -> Clock:
    """A clock at the beginning of a run."""
    real, count = np.zeros(REAL_WIDTH), np.zeros(COUNT_WIDTH, dtype=np.int64)
    real[T], real[H], real[ERROR_OLD] = settings.begin, settings.step, 1.0
    real[SMALLEST], real[STIFF_SINCE] = math.inf, math.nan
    count[CAUSE] = STEP_TOO_SMALL
    count[LOWEST_RANK] = np.iinfo(np.int64).max
    return Clock(real, count)


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
def settle(book, clock, settings, projected, t, alpha, beta):
    """Project the state in the buffers, unless it is ``projected``, and evaluate it; returns a
    status.
    """
    _, buffers, _ = open_book(book)
    if settings.closed >= 0.0 and not projected:
        status = project(book, settings.closed)
        clock.counts[PROJECTIONS] += 1
        clock.counts[EVALUATIONS] += 2
        if status != OK:
            return status
    buffers.time[0] = t
    clock.counts[EVALUATIONS] += 1
    return evaluate_on_branch(book, settings.closed, alpha, beta)


@kernel
def emit_samples(book, method, step, clock, settings, block):
    """Write the samples that are due up to now; returns a status (``OK``: all written)."""
    _, buffers, _ = open_book(book)
    real, count = clock.real, clock.counts
    t = real[T]
    rows = count[SAMPLE] - count[BLOCK_FIRST]
    near = 1e-9 * max(real[H_OLD], 1e-12)
    while count[SAMPLE] < settings.samples:
        due = sample_time(settings, count[SAMPLE])
        if due > t + near:
            return OK
        if rows >= block.shape[0]:
            return BLOCK_FULL
        alpha, beta = gains(settings, max(real[H_OLD], settings.step))
        projected = True
        if due >= t - near:
            load(step.z, step.base, buffers)
            works = step.z[step.tolerance.size :]
        else:
            projected = False
            interpolate(method, step, (due - real[T_OLD]) / real[H_OLD], step.z_stage)
            load(step.z_stage, step.base_old, buffers)
            works = step.z_stage[step.tolerance.size :]
        status = settle(book, clock, settings, projected, due, alpha, beta)
        if status != OK:
            return status
        note_solution(book)
        write_sample(book, due, works, block[rows])
        if buffers.flag[0] != 0:
            return CALLBACK_FAILED
        rows += 1
        count[SAMPLE] += 1
    return OK


@kernel
def watch_start(book):
    """Note the joints' coordinates at the start of a run, and what is amiss there already."""
    plant, buffers, _ = open_book(book)
    follow_joints(plant, buffers)
    watch_step(book, 0.0, 0.0)
    note_solution(book)
    watch_solver(book)


@kernel
def planned_step(method, clock, settings):
    """Length of the next step and the time at which it ends."""
    real, count = clock.real, clock.counts
    t = real[T]
    breakpoints = settings.breakpoints
    near = CLOSE_IN_TIME * (1.0 + settings.end)
    while count[BREAK] < breakpoints.size and breakpoints[count[BREAK]] <= t + near:
        count[BREAK] += 1
    if not settings.adaptive:
        past = math.floor((t - settings.begin) / settings.step + 1e-9)
        end = settings.begin + (past + 1) * settings.step
        last = min(settings.end, settings.stop)
        if end > last - 1e-9 * settings.step:
            end = last
        return end - t, end
    stop = min(settings.end, settings.stop)
    if count[BREAK] < breakpoints.size and breakpoints[count[BREAK]] < stop - near:
        stop = breakpoints[count[BREAK]]
    h = min(real[H], settings.longest_step)
    if t + 1.01 * h >= stop:
        return stop - t, stop
    if t + 2.0 * h > stop:
        h = 0.5 * (stop - t)  # two equal steps rather than a long and a tiny one
    return h, t + h


@kernel
def breakpoint_at(clock, settings, end):
    """The breakpoint at which a step ends; infinite when it ends at none."""
    k = clock.counts[BREAK]
    near = CLOSE_IN_TIME * (1.0 + settings.end)
    if k < settings.breakpoints.size and abs(settings.breakpoints[k] - end) <= near:
        return settings.breakpoints[k]
    return math.inf


@kernel
def try_step(book, joints, method, step, clock, settings, h):
    """Stages and error estimate of one step; returns (status, error in units of the tolerance)."""
    real, count = clock.real, clock.counts
    t = real[T]
    alpha, beta = gains(settings, h)
    copy(step.slope, step.k[0])
    if settings.stabilization == FEEDBACK and settings.adaptive:
        # the gains belong to this step's length, the slope at hand to another one's
        status = evaluate_slope(book, t, step.z, step.base, alpha, beta, step.k[0])
        count[EVALUATIONS] += 1
        if status != OK:
            return status, 0.0
    status = run_stages(book, joints, method, step, t, h, alpha, beta)
    _, buffers, _ = open_book(book)
    own = method.kind != EXPLICIT and method.kind != SEMI_IMPLICIT
    stages = step.own[OWN_EVALUATIONS] if own else method.stages - 1
    # a projection is counted as two evaluations
    projected = buffers.stage_gap[0] >= 0.0 and method.kind != VARIATIONAL
    count[EVALUATIONS] += 3 * stages if projected else stages
    if status != OK:
        return status, 0.0
    if not finite(step.z_new):
        return NOT_FINITE, 0.0
    if not settings.adaptive:
        return OK, 0.0
    if method.error[0, method.stages] != 0.0:
        status = evaluate_slope(
            book, t + h, step.z_new, step.base, alpha, beta, step.k[method.stages]
        )
        count[EVALUATIONS] += 1
        if status != OK:
            return status, 0.0
    error = error_estimate(method, step, h, rounding_floor(book, clock))
    return (OK, error) if math.isfinite(error) else (NOT_FINITE, 0.0)


@kernel
def judge_solution(book, buffers, clock, settings):
    """Whether the end of a step can be believed: ``CONTRADICTION``, ``LARGE_CORRECTION`` or ``OK``.

    What the projection changes is the part of a step's error that led off the joints, and must be
    within the tolerance as the estimate is.  Near a bifurcation a step may end between two
    branches, and the projection then takes the state far: a shorter step ends nearer to the branch
    that the motion is on.  There the change has other causes too, and may be larger.
    """
    if not believable(book, buffers.solved[RESIDUAL]):
        return CONTRADICTION
    if settings.adaptive and settings.closed >= 0.0:
        floor = max(settings.tolerance, rounding_floor(book, clock))
        margin, most = open_coupled(book).margin[1], 1.0
        moved, kicked = ROUNDED_SHIFT * settings.closed, ROUNDED_KICK * settings.closed
        if not math.isinf(margin):
            most = MOST_CORRECTED
            moved = min(MOST_ROUNDED_GAP, ROUNDED_GAP / margin) / most
            kicked = min(MOST_ROUNDED_GAP, ROUNDED_GAP / (margin * margin)) / most
        correction = max(
            buffers.solved[SHIFT] / max(floor, moved), buffers.solved[KICK] / max(floor, kicked)
        )
        before = clock.real[CORRECTION]
        lessened = before == 0.0 or correction < LESSENED * before or correction > HOPELESS
        if correction > most and lessened:
            clock.real[CORRECTION] = correction
            return LARGE_CORRECTION
    return OK


@kernel
def count_solution(book, buffers, clock):
    """Statistics of how the end of an accepted step was solved."""
    real, count, solved = clock.real, clock.counts, buffers.solved
    rank = int(solved[RANK_OF_ALL])
    count[LOWEST_RANK] = min(count[LOWEST_RANK], rank)
    count[HIGHEST_RANK] = max(count[HIGHEST_RANK], rank)
    if solved[COUPLED_ARMS] > 0.0:
        count[COUPLED_STEPS] += 1
    real[WORST_RESIDUAL] = max(real[WORST_RESIDUAL], solved[RESIDUAL])
    real[WORST_CORRECTION] = max(real[WORST_CORRECTION], solved[SHIFT], solved[KICK])
    count[CHANGES] += watch_solver(book)


@kernel
def complete_step(book, method, step, clock, settings, h, end):
    """Stabilise the end of an accepted step, evaluate there, prepare its dense output."""
    plant, buffers, _ = open_book(book)
    count = clock.counts
    t = clock.real[T]
    alpha, beta = gains(settings, h)
    load(step.z_new, step.base, buffers)
    # the variational method keeps the joints closed itself
    closed = method.kind == VARIATIONAL
    status = settle(book, clock, settings, closed, min(end, buffers.time[1]), alpha, beta)
    if status != OK:
        return status
    note_solution(book)
    status = judge_solution(book, buffers, clock, settings)
    if status != OK:
        return status
    gap = largest(buffers.contacts, GAP)
    if not gap <= settings.apart:
        return DIVERGED if math.isfinite(gap) else NOT_FINITE
    # the slope of the next step, in this chart for the dense output and in the next one for it
    write_slope(step.z_new, buffers, step.k[method.stages])
    if plant.calls[CALL_GUARDS] != 0 and call_entry(plant.calls[CALL_GUARDS], book, t, end) != OK:
        status = prepare_dense(book, method, step, t, h, alpha, beta)
        return EVENT if status == OK else status
    if buffers.places.size > 0:
        for i in range(buffers.places.shape[0]):
            copy(buffers.located[i], buffers.places[i])
    follow_joints(plant, buffers)
    watch_step(book, t, end)
    count_solution(book, buffers, clock)
    if settings.adaptive and method.kind == EXPLICIT:
        note_stiffness(method, step, clock, h, end)
    if not math.isinf(buffers.time[1]):
        after = max(end, breakpoint_at(clock, settings, end))
        status = settle(book, clock, settings, True, after, alpha, beta)
        if status != OK:
            return status
    clear(step.z_stage)
    write_slope(step.z_stage, buffers, step.slope_next)
    due = sample_time(settings, count[SAMPLE]) if count[SAMPLE] < settings.samples else math.inf
    store(buffers, step.base_next, step.z_next)
    copy(step.z_new[step.tolerance.size :], step.z_next[step.tolerance.size :])
    if due < end - 1e-9 * h:
        status = prepare_dense(book, method, step, t, h, alpha, beta)
        count[EVALUATIONS] += max(0, method.A.shape[0] - method.stages - 1)
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
    count, last, end_of = clock.counts, method.stages - 1, method.stages
    rates = states = 0.0
    for i in range(step.tolerance.size):
        rates += (step.k[end_of, i] - step.k[last, i]) ** 2
        states += (step.z_new[i] - step.z_stage[i]) ** 2
    if states > 0.0 and h * h * rates > method.stability**2 * states:
        count[STIFF_STEPS] += 1
        count[SMOOTH_STEPS] = 0
        if count[STIFF_STEPS] == STIFF_AFTER:
            clock.real[STIFF_SINCE] = end
    elif count[STIFF_STEPS] < STIFF_AFTER:
        count[SMOOTH_STEPS] += 1
        if count[SMOOTH_STEPS] == SMOOTH_AFTER:
            count[STIFF_STEPS] = 0


@kernel
def rounding_floor(book, clock):
    """Smallest error that a step with projected stages can be asked for."""
    if clock.counts[CAREFUL] == 0:
        return 0.0
    margin = open_coupled(book).margin[1]
    return min(MOST_ROUNDED, ROUNDED / margin**3)


@kernel
def before_breakpoint(book, clock, settings, end):
    """See to it that a step that ends at a breakpoint does not see what comes after it."""
    _, buffers, _ = open_book(book)
    ahead = not math.isinf(breakpoint_at(clock, settings, end))
    buffers.time[1] = end - CLOSE_IN_TIME * (1.0 + settings.end) if ahead else math.inf


@kernel
def project_stages(book, clock, settings):
    """Decide whether the stages of the coming step are projected."""
    _, buffers, _ = open_book(book)
    open_coupled(book).margin[1] = math.inf
    careful = clock.counts[CAREFUL] > 0
    if not settings.adaptive and settings.closed >= 0.0:
        careful = near_loss(book)
    buffers.stage_gap[0] = settings.closed if careful else -1.0


@kernel
def next_length(method, h, error, error_old):
    """PI controller for the next step from this step's error and the one before."""
    order = 1.0 / (method.error_order + 1.0)
    if error == 0.0:
        return GROW * h
    factor = SAFETY * error ** (-0.7 * order) * error_old ** (0.4 * order)
    return h * min(GROW, max(SHRINK, factor))


@unlocked
def advance(book, joints, arrays, run, block, budget):
    """Integrate until the end, a full block, the budget of evaluations, or trouble.

    ``book`` is the system's address book, ``arrays`` that of the method and its step, ``run`` that
    of the clock and the settings.
    ``block`` (samples, width) receives the samples from ``clock.counts[BLOCK_FIRST]`` on.  Returns
    the reason.
    """
    method, step = open_step(arrays)
    clock, settings = _open_clock(run), _open_settings(run)
    real, count = clock.real, clock.counts
    limit = count[EVALUATIONS] + budget
    while True:
        status = emit_samples(book, method, step, clock, settings, block)
        if status != OK:
            return status
        if real[T] >= settings.end:
            return FINISHED
        if real[T] >= settings.stop:
            return STOPPED
        if settings.switch and count[STIFF_STEPS] >= STIFF_AFTER:
            return STIFF
        if count[EVALUATIONS] >= limit:
            return BUDGET_USED
        h, end = planned_step(method, clock, settings)
        if not h > max(SMALLEST_STEP * real[T], 8.0 * np.finfo(np.float64).eps * 1e-3):
            return count[CAUSE]
        project_stages(book, clock, settings)
        before_breakpoint(book, clock, settings, end)
        status, error = try_step(book, joints, method, step, clock, settings, h)
        if status == OK and error <= 1.0:
            status = complete_step(book, method, step, clock, settings, h, end)
            if status == OK:
                accept(book, method, clock, settings, h, end, error)
                if count[CHANGES] > 0:
                    count[CHANGES] = 0
                    return SOLVER_CHANGED
                continue
        if status in (CALLBACK_FAILED, EVENT) or not settings.adaptive:
            return status
        count[REJECTED] += 1
        if near_loss(book) and settings.closed >= 0.0:
            if count[CAREFUL] == 0:
                count[CAREFUL] = CAREFUL_STEPS
                continue  # the same step, with projected stages
            count[CAREFUL] = CAREFUL_STEPS
        if status == OK:
            count[CAUSE] = STEP_TOO_SMALL
            real[H] = h * max(SHRINK, SAFETY * error ** (-1.0 / (method.error_order + 1.0)))
        else:
            count[CAUSE] = status
            real[H] = 0.25 * h


@kernel
def accept(book, method, clock, settings, h, end, error):
    """Move the clock to the end of an accepted step."""
    real, count = clock.real, clock.counts
    if settings.adaptive:
        proposal = next_length(method, h, error, real[ERROR_OLD])
        # a step cut short by a breakpoint or the end says little about the one planned
        real[H] = max(proposal, real[H]) if h < real[H] else proposal
        real[ERROR_OLD] = max(error, 1e-4)
        real[ERROR_SUM] += error * max(settings.tolerance, rounding_floor(book, clock))
    real[T_OLD], real[H_OLD], real[T] = real[T], h, end
    real[CORRECTION] = 0.0
    count[CAREFUL] = max(count[CAREFUL] - 1, 0)
    real[SMALLEST] = min(real[SMALLEST], h)
    real[LARGEST] = max(real[LARGEST], h)
    count[STEPS] += 1
