"""The compiled loop over time: steps, projection, samples.

There is one loop for all methods and scenes.  It releases Python's lock, so that loops of several
threads run at the same time.  It calls Python only for Pinocchio's arms, the dense solver and user
callbacks, and once for each function that is compiled lazily.  It returns when the block of samples
is full, when its budget of evaluations is used up (progress, checkpoints and Ctrl-C are handled in
Python), where Python has to act or to log (at an event, a change of the solver, a guard's report,
or when the scene is stiff), at the end, or when a step fails.  :class:`Clock` holds its whole
state, so that the next call continues there.

``arrays`` is the struct of a method and its step
(:class:`multiarm.integration.methods.Stepping`), ``struct`` that of the system.
"""

from __future__ import annotations

import math

from multiarm.contacts.kernel import greatest_gaps
from multiarm.dynamics.arrays import guards_of_mode, open_data, open_reports, open_system
from multiarm.dynamics.coordinates import (
    chart_places,
    load_chart,
    write_chart,
    write_chart_slope,
    write_new_chart,
)
from multiarm.dynamics.equations import evaluate_state, finite
from multiarm.dynamics.guards import accept_guards, begin_stages, remember_scales
from multiarm.dynamics.solver_monitor import accept_solution
from multiarm.dynamics.status import (
    BLOCK_FULL,
    BUDGET_USED,
    CALLBACK_FAILED,
    DIVERGED,
    EVENT,
    FINISHED,
    GUARD_FIRED,
    NOT_FINITE,
    OK,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STIFF,
    STOPPED,
)
from multiarm.integration.dense_output import interpolate, prepare_dense
from multiarm.integration.near_singular import evaluate_on_branch
from multiarm.integration.projection import cost_of_projection, near_loss, project
from multiarm.integration.reporting_guards import count_reports
from multiarm.integration.samples import follow_joints, write_sample
from multiarm.integration.step import error_estimate, open_step, slope_at, stage_slope
from multiarm.integration.step_control import (
    CLOSE_IN_STEP,
    CLOSE_IN_TIME,
    FEEDBACK,
    PROJECTION,
    STIFF_AFTER,
    breakpoint_at,
    check_solution,
    choose_stage_projection,
    control_is_due,
    count_stiff_steps,
    gains,
    length_after_rejection,
    limited_by_stability,
    move_clock,
    planned_step,
    rounding_floor,
    shortest_step,
    stay_before_breakpoint,
    view_clock,
    view_settings,
)
from multiarm.jit.kernels import INT, INTS, TABLE, clear, copy, inlined, kernel, unlocked
from multiarm.jit.pointers import call_cfunc

# Near a loss of rank this many steps after a failed one are made with projected stages, which
# allows long steps.
RETRY_STEPS = 3


@unlocked
def advance(arrays: INTS, clock: INTS, settings: INTS, block: TABLE, budget: INT):
    """Integrate until there is a reason to return, see above.

    ``clock`` and ``settings`` are those of the run.  ``block`` (samples, width) receives the
    samples from ``clock.block_first`` on.  Returns the reason, a status.
    """
    method, step = open_step(arrays)
    clock, settings, struct = view_clock(clock), view_settings(settings), step.system
    limit = clock.evaluations + budget
    step.stage.repeats = False  # forces may have changed since the last call
    while True:
        before = clock.evaluations
        status = emit_samples(struct, method, step, clock, settings, block)
        clock.sample_evaluations += clock.evaluations - before
        if status != OK:
            return status
        if clock.t >= clock.end:
            return FINISHED
        if clock.t >= clock.stop:
            return STOPPED
        if clock.switch and clock.stiff_steps >= STIFF_AFTER:
            return STIFF
        if clock.evaluations >= limit:
            return BUDGET_USED
        h, end = planned_step(clock, settings)
        if not h > shortest_step(clock.t):
            return clock.cause
        choose_stage_projection(step, clock, settings)
        stay_before_breakpoint(step, clock, settings, end)
        before = clock.evaluations
        status, error = try_step(arrays, clock, settings, h)
        if status == OK and error <= 1.0:
            status = complete_step(method, step, clock, settings, h, end)
            if status == OK:
                count_evaluations(step, clock)
                clock.step_cost, step.stage.repeats = clock.evaluations - before, False
                accept_step(method, step, clock, settings, h, end, error)
                if clock.solver_changes > 0:
                    clock.solver_changes = 0
                    return SOLVER_CHANGED
                if clock.reports > 0:
                    return GUARD_FIRED
                continue
        count_evaluations(step, clock)
        if status in (CALLBACK_FAILED, EVENT) or not settings.adaptive:
            return status
        clock.rejected += 1
        step.stage.repeats = True
        if near_loss(open_data(struct).solution) and settings.stabilization == PROJECTION:
            first_failure = clock.retry_steps == 0
            clock.retry_steps = RETRY_STEPS
            if first_failure:
                continue  # the same step, with projected stages
        if status == OK:
            clock.cause = STEP_TOO_SMALL
            clock.h = length_after_rejection(method, h, error)
        else:
            clock.cause = status
            clock.h = 0.25 * h


@kernel
def begin_run(struct: INTS):
    """Store joint coordinates, guards that report, and the solution at the start of a run.

    Returns a status.
    """
    model, data, _ = open_system(struct)
    status, _ = count_reports(struct, data.functions, 0.0)
    if status != OK:
        return status
    status = call_cfunc(data.functions.record, struct, 0.0, 0.0)
    write_step_end(struct, model, data)
    accept_step_end(struct, data)
    return CALLBACK_FAILED if data.status.failed else status


@kernel
def sample_time(clock, settings, k):
    """Time of sample ``k``."""
    if settings.sample_times.size > 0:
        return settings.sample_times[k]
    if k == clock.final_sample:
        return clock.end
    return settings.begin + k * settings.sample_step


@kernel
def project_and_evaluate(struct, clock, settings, on_joints, t, alpha, beta):
    """Project the state in ``data`` unless it is ``on_joints``, evaluate it; returns a status."""
    _, data, _ = open_system(struct)
    projects = settings.stabilization == PROJECTION
    if projects and not on_joints:
        status = project(struct, settings.gap_tolerance)
        clock.projections += 1
        clock.evaluations += cost_of_projection(data)
        if status != OK:
            return status
    data.time.now = t
    clock.evaluations += 1
    if projects:
        status = evaluate_on_branch(struct, settings.gap_tolerance, not on_joints, alpha, beta)
        clock.evaluations += data.interpolation.numbers.evaluations
        return status
    return evaluate_state(struct, alpha, beta)


@kernel
def sample_control(step, clock, settings):
    """Sample the control at the beginning of the next step, and evaluate it again from there.

    Returns a status.
    """
    struct = step.system
    _, data, _ = open_system(struct)
    alpha, beta = gains(settings, max(clock.h_before, clock.step))
    load_chart(step.z, step.base, data)
    data.control.sampling.due = data.control.sampling.mode
    status = project_and_evaluate(struct, clock, settings, True, clock.t, alpha, beta)
    if status == OK:
        write_chart_slope(step.z, data, step.slope)
        clock.control_samples += 1
        clock.control_due = settings.begin + clock.control_samples * clock.control_step
    return status


@unlocked
def observe(arrays, clock, settings, row):
    """Evaluate the beginning of the next step, and write it as a sample; returns a status."""
    _, step = open_step(arrays)
    clock, settings, struct = view_clock(clock), view_settings(settings), step.system
    _, data, _ = open_system(struct)
    if control_is_due(clock):
        status = sample_control(step, clock, settings)
        if status != OK:
            return status
    alpha, beta = gains(settings, max(clock.h_before, clock.step))
    load_chart(step.z, step.base, data)
    status = project_and_evaluate(struct, clock, settings, True, clock.t, alpha, beta)
    if status == OK:
        status = record_and_write(struct, clock.t, step.z[chart_places(data).works :], row)
    return CALLBACK_FAILED if data.status.failed else status


@inlined
def record_and_write(struct, t, works, row):
    """Record the last solution, and write it as a sample; returns a status."""
    status = call_cfunc(open_data(struct).functions.record, struct, 0.0, 0.0)
    return write_sample(struct, t, works, row) if status == OK else status


@kernel
def emit_samples(struct, method, step, clock, settings, block):
    """Write the samples that are due up to now; returns a status (``OK``: all written).

    A sample of the control that is due now comes after those within the last step.
    """
    _, data, _ = open_system(struct)
    t = clock.t
    rows = clock.sample - clock.block_first
    near = CLOSE_IN_STEP * max(clock.h_before, CLOSE_IN_TIME)
    while True:
        due = math.inf
        if clock.sample < clock.samples:
            due = sample_time(clock, settings, clock.sample)
        if due >= t - near and control_is_due(clock):
            status = sample_control(step, clock, settings)
            if status != OK:
                return status
        if due > t + near:
            return OK
        if rows >= block.shape[0]:
            return BLOCK_FULL
        alpha, beta = gains(settings, max(clock.h_before, clock.step))
        on_joints = due >= t - near
        if on_joints:
            load_chart(step.z, step.base, data)
            works = step.z[chart_places(data).works :]
        else:
            interpolate(method, step, (due - clock.t_before) / clock.h_before, step.z_stage)
            load_chart(step.z_stage, step.base_old, data)
            works = step.z_stage[chart_places(data).works :]
        status = project_and_evaluate(struct, clock, settings, on_joints, due, alpha, beta)
        if status != OK:
            return status
        status = record_and_write(struct, due, works, block[rows])
        if status != OK:
            return status
        rows += 1
        clock.sample += 1


@kernel
def try_step(arrays, clock, settings, h):
    """Stages and error estimate of one step; returns (status, error in units of the tolerance)."""
    method, step = open_step(arrays)
    t, stage, data = clock.t, step.stage, open_data(step.system)
    begin_stages(open_reports(step.system))
    if data.functions.guards != 0:
        begin_stages(guards_of_mode(data))
    stage.alpha, stage.beta = gains(settings, h)
    copy(step.slope, step.k[0])
    if settings.stabilization == FEEDBACK and settings.adaptive:
        # the gains depend on this step's length, the known slope on that of the step before
        status = slope_at(step, t, step.z, step.k[0])
        if status != OK:
            return status, 0.0
    status = call_cfunc(method.step, arrays, t, h)
    if status != OK:
        return status, 0.0
    if not finite(step.z_new):
        return NOT_FINITE, 0.0
    if not settings.adaptive:
        return OK, 0.0
    if method.error[0, method.stages] != 0.0:
        status = stage_slope(step, t + h, step.z_new, step.k[method.stages])
        if status != OK:
            return status, 0.0
    error = error_estimate(method, step, h, rounding_floor(step.system, clock))
    return (OK, error) if math.isfinite(error) else (NOT_FINITE, 0.0)


@inlined
def count_evaluations(step, clock):
    """Add the evaluations of a step to those of the run."""
    clock.evaluations += step.stage.evaluations
    step.stage.evaluations = 0


@kernel
def complete_step(method, step, clock, settings, h, end):
    """Project and evaluate the end of a step, check it, and prepare dense output and next step.

    Everything that can fail is here; what the run remembers of its steps stays as it was.
    """
    struct, t, latest = step.system, clock.t, step.stage.latest
    model, data, _ = open_system(struct)
    alpha, beta = gains(settings, h)
    load_chart(step.z_new, step.base, data)
    status = project_and_evaluate(
        struct, clock, settings, method.closes_gaps != 0, min(end, latest), alpha, beta
    )
    if status != OK:
        return status
    status = call_cfunc(data.functions.record, struct, 0.0, 0.0)
    if status == OK:
        status = check_solution(struct, clock, settings)
    if status != OK:
        return status
    gap, _ = greatest_gaps(data.rows.kinematics)
    if not gap <= settings.divergence_bound:
        return DIVERGED if math.isfinite(gap) else NOT_FINITE
    # the slope at the end, in this chart for the dense output and below in the next step's chart
    write_chart_slope(step.z_new, data, step.k[method.stages])
    if data.functions.guards != 0:
        status = call_cfunc(data.functions.guards, struct, t, end)
        if status != OK:
            return status
        if data.modes.event:
            status = prepare_dense(method, step, t, h)
            return EVENT if status == OK else status
    status, step.at_end.reports = count_reports(struct, data.functions, h)
    if status != OK:
        return status
    step.at_end.limited = False
    if settings.adaptive and math.isfinite(method.stability):
        write_chart(data, step.base, step.z_next)
        step.at_end.limited = limited_by_stability(method, step, step.z_next, h)
    write_step_end(struct, model, data)
    if not math.isinf(latest):
        after = max(end, breakpoint_at(clock, settings, end))
        status = project_and_evaluate(struct, clock, settings, True, after, alpha, beta)
        if status != OK:
            return status
    clear(step.z_stage)
    write_chart_slope(step.z_stage, data, step.slope_next)
    due = sample_time(clock, settings, clock.sample) if clock.sample < clock.samples else math.inf
    write_new_chart(data, step.base_next, step.z_next)
    works = chart_places(data).works
    copy(step.z_new[works:], step.z_next[works:])
    if due < end - CLOSE_IN_STEP * h or step.at_end.reports > 0:
        return prepare_dense(method, step, t, h)
    return OK


@kernel
def accept_step(method, step, clock, settings, h, end, error):
    """Make the end of a complete step the beginning of the next one; nothing here can fail."""
    struct, data = step.system, open_data(step.system)
    if data.functions.accept != 0:
        call_cfunc(data.functions.accept, struct, 0.0, 0.0)
    accept_step_end(struct, data)
    clock.reports = step.at_end.reports
    count_solution(data.last_step.solution, clock)
    if settings.adaptive and math.isfinite(method.stability):
        count_stiff_steps(clock, step.at_end.limited, end)
    copy(step.z_next, step.z)
    copy(step.base_next, step.base)
    copy(step.slope_next, step.slope)
    move_clock(struct, method, clock, settings, h, end, error)


@kernel
def write_step_end(struct, model, data):
    """Write what a run remembers of a step, whose end has been evaluated, into its own record."""
    for i in range(data.search.points.shape[0]):
        copy(data.search.points[i], data.this_step.points[i])
    follow_joints(model, data)
    call_cfunc(data.functions.compare, struct, 0.0, 0.0)


@kernel
def accept_step_end(struct, data):
    """Remember this step as the last one, and begin the guards that report at its end."""
    reports = open_reports(struct)
    remember_scales(reports)
    accept_guards(reports)
    accept_solution(data)
    for i in range(data.search.points.shape[0]):
        copy(data.this_step.points[i], data.last_step.points[i])
    for i in range(data.last_step.coordinates.shape[0]):
        copy(data.this_step.coordinates[i], data.last_step.coordinates[i])


@inlined
def count_solution(solution, clock):
    """Statistics of how the end of an accepted step was solved."""
    clock.lowest_rank = min(clock.lowest_rank, solution.rank)
    clock.highest_rank = max(clock.highest_rank, solution.rank)
    if solution.coupled_blocks > 0:
        clock.coupled_steps += 1
    if not solution.motion_unique:
        clock.ambiguous_steps += 1
    clock.worst_residual = max(clock.worst_residual, solution.residual)
    clock.worst_correction = max(clock.worst_correction, solution.correction)
    clock.solver_changes += solution.changes
