"""Step control: how long the next step is, and whether the last one is accepted.

*Length.*  The error of a step in units of the tolerance sets the length of the next one by a PI
controller (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.4, and II, IV.2).
Steps of adaptive methods end at breakpoints, where forces are discontinuous, and those of all
methods at the samples of a control that is sampled.

*Retries.*  Where the constraints are near a loss of rank, stages off the constraints make even
short steps fail.  Such a step is retried, and the next ones are made, with projected stages.

*Corrections.*  The change of the state by projection after a step is the part of its error that led
off the joints, and must meet the tolerance as the error estimate does.

*Stiffness* is detected by counting steps that are as long as stability allows.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.solver.bounds import (
    MOST_ROUNDED_CORRECTION,
    MOST_ROUNDED_STEP,
    ROUNDED_GAP,
    ROUNDED_STEP,
)
from multiarm.dynamics.solver_monitor import believable
from multiarm.dynamics.status import CONTRADICTION, LARGE_CORRECTION, OK, STEP_TOO_SMALL
from multiarm.integration.projection import near_loss
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.structs import Flag, Float, Floats1, Int, Numbers, view

# Kinds of stabilization.
NONE, FEEDBACK, PROJECTION = 0, 1, 2

# Step size control: safety factor, smallest and largest change of the length (Hairer and Wanner).
SAFETY, SHRINK, GROW = 0.9, 0.2, 6.0
# Times closer than this, relative to the end of the run, are equal; and relative to a step.
CLOSE_IN_TIME, CLOSE_IN_STEP = 1e-12, 1e-9
# Shorter steps [s] make no progress even at t = 0.
SHORTEST = 8e-3 * sys.float_info.epsilon
# A scene counts as stiff after this many steps limited by stability ...
STIFF_AFTER = 15
# ... unless this many steps in a row were not (Hairer and Wanner, IV.2).
SMOOTH_AFTER = 6


class Settings(NamedTuple):
    """Settings of a run, which stay as they are."""

    begin: Float  # [s]
    sample_step: Float  # [s]: samples are taken at its multiples from ``begin``, and at the end;
    sample_times: Floats1  # or, unless this is empty, at these times [s]
    adaptive: Flag
    longest_step: Float  # [s], of an adaptive method
    tolerance: Float  # the smallest of ``Step.tolerance``
    stabilization: Int
    # gains of the feedback [1/s], and their parts that grow with 1 / step
    alpha: Float
    beta: Float
    alpha_by_step: Float
    beta_by_step: Float
    gap_tolerance: Float  # [m], largest gap that projection leaves
    divergence_bound: Float  # [m], gap above which a run counts as diverged
    # Increasing times of discontinuities.  An adaptive method ends a step there; the end of that
    # step is evaluated just before the breakpoint, the next step begins just after it.
    breakpoints: Floats1


class Clock(Numbers):
    """State of the loop, which it keeps between calls, and what the driver asks it to do."""

    # set by the driver
    end: Float  # [s]
    stop: Float  # [s], where a step ends and the loop returns, before the end; infinite: none
    samples: Int  # number of samples until the end
    final_sample: Int  # the one that is taken at the end; negative: none
    control_step: Float  # [s] between samples of the control; infinite: it is not sampled
    switch: Flag  # return when stiffness limits the steps of an explicit method
    step: Float  # [s], the fixed step, or the first one of an adaptive method
    # kept by the loop
    t: Float
    h: Float  # the next step
    # beginning, length and error [tolerances] of the last step
    t_before: Float
    h_before: Float
    error_before: Float
    error_sum: Float  # of the accepted steps' estimates [m, rad]
    smallest_step: Float
    largest_step: Float
    correction: Float  # change by projection for which the step was last rejected [tolerances]
    worst_residual: Float
    worst_correction: Float  # of an accepted step [m, rad; m/s, rad/s]
    stiff_since: Float  # time at which stiffness was detected
    steps: Int
    rejected: Int
    evaluations: Int
    sample_evaluations: Int  # of them, what samples took
    step_cost: Int  # evaluations of the last step, without attempts that were rejected
    projections: Int
    sample: Int  # the next one
    block_first: Int  # first sample of the block
    breakpoint: Int  # the next one
    control_due: Float  # time of the next sample of the control [s]; infinite: there is none
    control_samples: Int  # number of the next one, from the beginning
    cause: Int  # why the last step was rejected
    coupled_steps: Int  # steps that ended with deficient blocks
    ambiguous_steps: Int  # steps at whose end friction left the motion open
    lowest_rank: Int
    highest_rank: Int
    solver_changes: Int  # of rank or of deficient blocks, that Python has not logged yet
    reports: Int  # guards that report an event in the last step, that Python has not logged yet
    retry_steps: Int  # steps still to be made with projected stages
    stiff_steps: Int  # steps limited by stiffness
    smooth_steps: Int  # later steps that were not

    def extend(self, end: float, samples: int) -> None:
        """Move the end on, at which no sample is taken; ``samples`` are taken before."""
        self.end, self.samples, self.final_sample = end, samples, -1

    def hold_control(self) -> None:
        """Take no samples of the control any more."""
        self.control_due = self.control_step = math.inf

    def sample_control(self, control_step: float = math.inf) -> None:
        """Take a sample of the control now, and others at the multiples of a time [s]."""
        self.control_due, self.control_step = self.t, control_step
        if control_step < math.inf:
            self.control_samples = math.floor(self.t / control_step * (1.0 + CLOSE_IN_STEP))

    def begin_after_event(self) -> None:
        """Go on from an event at the present time: there is no step before."""
        self.error_before, self.t_before, self.h_before = 1.0, self.t, 0.0
        self.stop = math.inf

    def begin_after_failure(self) -> None:
        """Go on from the end of the last step with one of the usual length."""
        self.stop, self.h, self.retry_steps = math.inf, self.step, 0

    def watch_stiffness(self) -> None:
        """Return where stiffness limits the steps from now on."""
        self.switch, self.stiff_steps, self.smooth_steps = True, 0, 0


view_clock, view_settings = view(Clock), view(Settings)


def make_clock(
    begin: float, end: float, samples: int, final_sample: int, control_step: float, switch: bool,
    step: float,
) -> Clock:  # fmt: skip
    """A clock at the beginning of a run."""
    return Clock(
        end=end,
        stop=math.inf,
        samples=samples,
        final_sample=final_sample,
        control_step=control_step,
        switch=switch,
        step=step,
        t=begin,
        h=step,
        control_due=begin + control_step,
        control_samples=1,  # that of the beginning has been taken
        error_before=1.0,
        smallest_step=math.inf,
        stiff_since=math.nan,
        cause=STEP_TOO_SMALL,
        lowest_rank=sys.maxsize,
    )


@plain
def shortest_step(t):
    """Steps that are not longer [s] make no progress at the time ``t`` [s]."""
    return max(CLOSE_IN_TIME * abs(t), SHORTEST)


@plain
def gains(settings, h):
    """Feedback gains of a step of length ``h``."""
    if settings.stabilization != FEEDBACK:
        return 0.0, 0.0
    return settings.alpha + settings.alpha_by_step / h, settings.beta + settings.beta_by_step / h


@inlined
def close_in_time(clock):
    """Times closer than this are equal [s]."""
    return CLOSE_IN_TIME * (1.0 + abs(clock.end))


@kernel
def planned_step(clock, settings):
    """Length of the next step, and the time at which it ends."""
    t = clock.t
    breakpoints = settings.breakpoints
    near = close_in_time(clock)
    while clock.breakpoint < breakpoints.size and breakpoints[clock.breakpoint] <= t + near:
        clock.breakpoint += 1
    stop = min(clock.end, clock.stop)
    if clock.control_due < stop - near:
        stop = clock.control_due
    if not settings.adaptive:
        rounding = min(max(CLOSE_IN_STEP, shortest_step(t) / clock.step), 0.5)  # in steps
        past = math.floor((t - settings.begin) / clock.step + rounding)
        end = settings.begin + (past + 1) * clock.step
        if end > stop - rounding * clock.step:
            end = stop
        return end - t, end
    if clock.breakpoint < breakpoints.size and breakpoints[clock.breakpoint] < stop - near:
        stop = breakpoints[clock.breakpoint]
    h = min(clock.h, settings.longest_step)
    if t + 1.01 * h >= stop:
        return stop - t, stop
    if t + 2.0 * h > stop:
        h = 0.5 * (stop - t)  # two equal steps rather than a long and a tiny one
    return h, t + h


@kernel
def control_is_due(clock):
    """Whether a sample of the control is to be taken now."""
    return clock.control_due <= clock.t + close_in_time(clock)


@kernel
def breakpoint_at(clock, settings, end):
    """The breakpoint at which a step ends; infinite when it ends at none."""
    k = clock.breakpoint
    if k < settings.breakpoints.size and abs(settings.breakpoints[k] - end) <= close_in_time(clock):
        return settings.breakpoints[k]
    return math.inf


@kernel
def stay_before_breakpoint(step, clock, settings, end):
    """Evaluate a step that ends at a breakpoint before the discontinuity only."""
    ahead = not math.isinf(breakpoint_at(clock, settings, end))
    step.stage.latest = end - close_in_time(clock) if ahead else math.inf


@kernel
def next_length(method, h, error, error_old):
    """PI controller for the next step from this step's error and the one before."""
    order = 1.0 / (method.error_order + 1.0)
    if error == 0.0:
        return GROW * h
    factor = SAFETY * error ** (-0.7 * order) * error_old ** (0.4 * order)
    return h * min(GROW, max(SHRINK, factor))


@kernel
def length_after_rejection(method, h, error):
    """Length of a step that replaces one whose error was too large."""
    return h * max(SHRINK, SAFETY * error ** (-1.0 / (method.error_order + 1.0)))


@kernel
def choose_stage_projection(step, clock, settings):
    """Decide whether the stages of the next step are projected."""
    data = open_data(step.system)
    data.solution.least_margin = math.inf
    step.stage.projects = clock.retry_steps > 0
    if not settings.adaptive and settings.stabilization == PROJECTION:
        # samples within the step are others
        step.stage.projects = near_loss(data.last_step.solution)
    step.stage.gap = settings.gap_tolerance


@kernel
def rounding_floor(struct, clock):
    """Smallest error that a step with projected stages can have [m, rad; m/s, rad/s].

    Where two motions cross, roundings give an error that grows with the inverse cube of the margin,
    the distance from the loss of rank.
    """
    if clock.retry_steps == 0:
        return 0.0
    margin = open_data(struct).solution.least_margin
    return min(MOST_ROUNDED_STEP, ROUNDED_STEP / margin**3)


@kernel
def check_solution(struct, clock, settings):
    """Whether the end of a step is a solution: ``CONTRADICTION``, ``LARGE_CORRECTION`` or ``OK``.

    Near a bifurcation a step may end between two branches, from where projection moves the state
    far: a shorter step ends nearer to the branch that the motion is on.  There the change has other
    causes too, and may be 30 tolerances.
    """
    data = open_data(struct)
    if not believable(data.solution, data.solution.residual):
        return CONTRADICTION
    if not settings.adaptive or settings.stabilization != PROJECTION:
        return OK
    floor = max(settings.tolerance, rounding_floor(struct, clock))
    margin, bound = data.solution.least_margin, 1.0
    # changes that are roundings, in gaps
    of_position, of_velocity = 10.0 * settings.gap_tolerance, 1e3 * settings.gap_tolerance
    if not math.isinf(margin):
        bound = 30.0
        # roundings of gaps [m] over the margin in positions, over its square in velocities
        of_position = min(MOST_ROUNDED_CORRECTION, ROUNDED_GAP / margin) / bound
        of_velocity = min(MOST_ROUNDED_CORRECTION, ROUNDED_GAP / (margin * margin)) / bound
    correction = max(
        data.status.position_change / max(floor, of_position),
        data.status.velocity_change / max(floor, of_velocity),
    )
    before = clock.correction
    # a shorter step must halve the correction, else it has another cause; 1e4 is never accepted
    smaller = before == 0.0 or correction < 0.5 * before or correction > 1e4
    if correction > bound and smaller:
        clock.correction = correction
        return LARGE_CORRECTION
    return OK


@kernel
def move_clock(struct, method, clock, settings, h, end, error):
    """Move the clock to the end of an accepted step, and choose the next length."""
    if settings.adaptive:
        proposal = next_length(method, h, error, clock.error_before)
        # the error of a step cut short by a breakpoint or the end says little about a longer one
        clock.h = max(proposal, clock.h) if h < clock.h else proposal
        clock.error_before = max(error, 1e-4)
        clock.error_sum += error * max(settings.tolerance, rounding_floor(struct, clock))
    clock.t_before, clock.h_before, clock.t = clock.t, h, end
    clock.correction, clock.cause = 0.0, STEP_TOO_SMALL
    clock.retry_steps = max(clock.retry_steps - 1, 0)
    clock.smallest_step = min(clock.smallest_step, h)
    clock.largest_step = max(clock.largest_step, h)
    clock.steps += 1


@kernel
def limited_by_stability(method, step, z_end, h):
    r"""Whether a step is as long as stability allows.

    The last stage and the end of the step belong to the same time; their difference estimates the
    largest eigenvalue, :math:`|\lambda| \approx \|f(z_1) - f(z_2)\| / \|z_1 - z_2\|`.  The slope at
    the end is that at ``z_end``, after projection, in the chart of the step.
    """
    last, end_slope = method.stages - 1, method.stages
    rates = states = 0.0
    for i in range(step.tolerance.size):
        rates += (step.k[end_slope, i] - step.k[last, i]) ** 2
        states += (z_end[i] - step.z_stage[i]) ** 2
    return states > 0.0 and h * h * rates > method.stability**2 * states


@inlined
def count_stiff_steps(clock, limited, end):
    """Count the accepted steps that stability has limited."""
    if limited:
        clock.stiff_steps += 1
        clock.smooth_steps = 0
        if clock.stiff_steps == STIFF_AFTER:
            clock.stiff_since = end
    elif clock.stiff_steps < STIFF_AFTER:
        clock.smooth_steps += 1
        if clock.smooth_steps == SMOOTH_AFTER:
            clock.stiff_steps = 0
