"""One run: calls of the compiled loop until the end, samples to the sink, and the outcome.

The setup of a run is in :mod:`multiarm.simulation.setup`; :mod:`multiarm.simulation.certified`
judges its accuracy afterwards.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

from multiarm.dynamics.status import BLOCK_FULL, FINISHED
from multiarm.dynamics.system import System
from multiarm.errors import TrajectoryError
from multiarm.integration.samples import sample_columns
from multiarm.integration.step_control import STIFF_AFTER
from multiarm.jit.compilation import compile_time, running_time
from multiarm.notation import count_of
from multiarm.results.event_log import CLAUSE_SEPARATOR, EventLog
from multiarm.results.limit_use import LIMITS, limits_record
from multiarm.results.sinks import Sink, provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, dump_scene
from multiarm.simulation.driver import FOR_STIFF_SCENES, GOES_ON, Driver, failure_of, where_of
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.interrupts import Interrupt, deferred_interrupt
from multiarm.simulation.setup import (
    Run,
    Task,
    check_control_span,
    method_and_tolerance,
    prepare,
    span_notice,
)

BUDGET = 4000  # evaluations between two calls of progress, and checks of time and Ctrl-C
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time
# The pace of a run is judged over this many steps, including rejected ones.  A stop for an event,
# of which every event makes two, takes about as long as EVENT_STEPS.
JUDGED_STEPS, EVENT_STEPS = 5000, 5
# Steps longer than this part of those that the user set are not too short.
SHORT_SHARE = 0.01
MESSAGE_LENGTH = 600  # [characters], including the summary of events

TOO_MANY = "steps became so short that the run hardly got on"

Progress = Callable[[float], None]


class Carried(NamedTuple):
    """A task that was carried out.

    Attributes
    ----------
    trajectory : Trajectory
    stalled : bool
        It was ended because its steps became too short, or too many.
    """

    trajectory: Trajectory
    stalled: bool


class _Ended(NamedTuple):
    """How a run ended."""

    status: str
    message: str
    stalled: bool = False


def carry_out(
    task: Task,
    sink: Sink,
    progress: Progress | None = None,
    tighten: float = 1.0,
    most_evaluations: float = math.inf,
) -> Carried:
    """Run a task once.

    Parameters
    ----------
    task : Task
    sink : Sink
        Where the samples go.
    progress : callable, optional
        Called with the simulated time now and then; may raise ``KeyboardInterrupt`` to end the run.
    tighten : float
        Factor on the tolerances of an adaptive method.
    most_evaluations : float
        The run fails when it takes more: with tolerances near rounding, steps may become extremely
        short.

    Raises
    ------
    SolverError, ControlError
        When the very first evaluation is impossible.
    TrajectoryError
        When the sink cannot be opened.
    """
    system, spec, with_state = task.system, task.spec, task.state is not None
    compiled_before = compile_time()
    check_control_span(task.data.model, task.begin, task.end)
    driver = begin(task, sink, tighten)
    run, log = driver.run, driver.run.log
    log.add(span_notice(task.data.model, task.end))
    run.sink.open(system.channels, run_metadata(system, spec, with_state), sample_columns)
    interrupt = Interrupt()
    try:
        pace = Pace(run, spec)
        ended, wall = _drive(driver, progress, most_evaluations, pace, interrupt)
    except BaseException as error:
        # the error passes through, but the samples are kept
        with suppress(TrajectoryError):
            _flush(run)
        statistics = run_statistics(driver, task, 0.0, compile_time() - compiled_before)
        run.sink.finish("failed", f"{where_of(run)}: {error!r}", statistics, log.all())
        raise
    remarks = [*_stiffness_remarks(run), *_ambiguity_remarks(run)]
    length = len(CLAUSE_SEPARATOR.join([ended.message, *remarks]))
    remarks += log.remarks(MESSAGE_LENGTH - length)
    statistics = run_statistics(driver, task, wall, compile_time() - compiled_before)
    trajectory = run.sink.finish(
        ended.status, ended.message, statistics, log.all(), remarks=remarks
    )
    interrupt.deliver()
    return Carried(trajectory, ended.stalled)


def begin(task: Task, sink: Sink, tighten: float = 1.0) -> Driver:
    """Bring a task to its start: the initial mode of its contacts, the first evaluation and step.

    ``tighten`` as in :func:`carry_out`; the sink is not opened yet.

    Raises
    ------
    SolverError, ControlError
        When the very first evaluation is impossible.
    """
    spec, state, log, events = task.spec, task.state, EventLog(), None
    if task.data.model.unilateral is not None:
        events = EventHandler(task.data, method_and_tolerance(spec, tighten)[1], spec.step, log)
        start = task.system.initial_state() if state is None else state
        data, state = events.begin(task.begin, start, state is not None)
        task = replace(task, data=data, state=state)
    run = prepare(task, sink, log, tighten)
    if events is not None:
        events.arm(run)
    return Driver(run, events)


def leave_undone(
    system: System, with_state: bool, sink: Sink, status: str, message: str
) -> Trajectory:
    """The result of a run that did not begin: no samples, and the reason.

    Raises
    ------
    TrajectoryError
        When the sink cannot be opened.
    """
    sink.open(system.channels, run_metadata(system, system.scene.run, with_state), sample_columns)
    return sink.finish(status, message, {"simulated_s": 0.0, "wall_time_s": 0.0})


class Pace:
    """Steps of a run for a second of simulated time; a run whose steps get too short is ended."""

    def __init__(self, run: Run, spec: RunSpec) -> None:
        self._unit, self._most = min(1.0, spec.duration), spec.most_steps  # [s], see `most_steps`
        chosen = run.settings.longest_step if run.settings.adaptive else run.clock.step
        self._shortest = min(self._unit / self._most, SHORT_SHARE * chosen)
        self._steps, self._t = 0, run.settings.begin

    def judge(self, run: Run, event_stops: int) -> str:
        """Why the run is ended; empty while it advances fast enough.

        ``event_stops``: how often the loop has stopped for an event.
        """
        t, clock = run.clock.t, run.clock
        steps = clock.steps + clock.rejected + EVENT_STEPS * event_stops
        judged, advanced = steps - self._steps, t - self._t
        if judged < JUDGED_STEPS:
            return ""
        self._steps, self._t = steps, t
        if advanced >= judged * self._shortest:
            return ""
        loosen = "loosen `accuracy`, " if run.settings.adaptive else ""
        return (
            f"{TOO_MANY}: the last {judged:,} steps, rejected ones and events counted, advanced it "
            f"by {advanced:.2g} s, the next one is {run.clock.h:.2g} s long; a pace of more "
            f"than {self._most:.2g} steps (`run.most_steps`) for {self._unit:.3g} s; {loosen}look "
            f"for a control that jumps or oscillates, contacts that chatter or a singular posture "
            f"there, or raise `most_steps`"
        )


def _stiffness_remarks(run: Run) -> list[str]:
    """For the message of a stiff scene: what was done, or the remedy; else none."""
    clock = run.clock
    if run.stepping.tableau.name == FOR_STIFF_SCENES and run.may_switch:
        return [
            f"the scene is stiff: {FOR_STIFF_SCENES} took over at t = {clock.stiff_since:.3g} s"
        ]
    if run.may_switch or clock.stiff_steps < STIFF_AFTER:
        return []
    since = f"stiff from t = {clock.stiff_since:.3g} s"
    return [f"the scene is {since}: `integrator: {FOR_STIFF_SCENES}` takes longer steps there"]


def _ambiguity_remarks(run: Run) -> list[str]:
    """For the message of a run whose equations of motion have several solutions; else none."""
    steps = run.clock.ambiguous_steps
    if not steps:
        return []
    return [
        f"{count_of(steps, 'step')} ended where friction leaves the motion open: the equations "
        f"have several solutions there, and that of the least forces was taken; fewer contacts, or "
        f"`effects: contact_compliance`, make the forces unique"
    ]


def run_metadata(system: System, spec: RunSpec, with_state: bool) -> Callable[[], dict[str, Any]]:
    """Provenance, on access: writing the scene takes longer than a short run.

    ``with_state``: the start is a given state, not the scene's.
    """
    scene = system.scene  # a result must not keep its system alive
    controller = system.model.python_control
    python = controller is not None and not controller.in_scene
    control = "python function" if python else scene.control.kind
    sampling = system.model.sampling if python else None  # a scene has its own keys
    times = (
        {} if sampling is None else {"sample_time": sampling.time, "sample_delay": sampling.delay}
    )
    start, created = "given state" if with_state else "scene", time.time()
    limits = {
        name: limits_record(arm.effort_limits, arm.velocity_limits, arm.position_limits)
        for name, arm in system.arms.items()
    }

    def metadata() -> dict[str, Any]:
        text = dump_scene(scene.model_copy(update={"run": spec}))
        about = {"control": control, **times, "start": start, LIMITS: limits}
        return {**provenance(text, created), **about}

    return metadata


def _drive(
    driver: Driver,
    progress: Progress | None,
    most_evaluations: float,
    pace: Pace,
    interrupt: Interrupt,
) -> tuple[_Ended, float]:
    """Call the compiled loop until the end; returns how it ended, and its time [s] of running.

    A Ctrl-C that came too late to end the run is left in ``interrupt``.
    """
    run = driver.run
    reason, fault = driver.advance(0)  # the loop is loaded, which is no part of the run
    started, next_checkpoint = running_time(), time.perf_counter() + CHECKPOINT_INTERVAL
    with deferred_interrupt(interrupt):
        while True:
            try:
                if progress is not None:
                    progress(run.clock.t)
            except KeyboardInterrupt:  # the caller ends the run
                interrupt.pressed = reason != FINISHED
            ended = None
            if reason == FINISHED:
                ended = _Ended("completed", "the run reached its end")
            elif interrupt.pressed:
                interrupt.pressed = False
                ended = _Ended("interrupted", f"stopped by the user {where_of(run)}")
            elif reason not in GOES_ON:
                ended = _Ended(*failure_of(run, reason))
            elif fault:
                ended = _Ended("failed", f"{where_of(run)}: {fault}")
            else:
                too_many = run.clock.evaluations > most_evaluations
                if stalled := TOO_MANY if too_many else pace.judge(run, driver.event_stops):
                    ended = _Ended("failed", f"{where_of(run)}: {stalled}", stalled=True)
            due = time.perf_counter() >= next_checkpoint
            try:
                if ended or due or reason == BLOCK_FULL:
                    _flush(run)
                if due:
                    run.sink.checkpoint()
                    next_checkpoint = time.perf_counter() + CHECKPOINT_INTERVAL
            except TrajectoryError as error:
                ended = _Ended("failed", f"{where_of(run)}: {error}")
            if ended:
                return ended, running_time() - started
            reason, fault = driver.advance(BUDGET)


def _flush(run: Run) -> None:
    """Write the samples in the block to the sink and begin a new block."""
    clock = run.clock
    rows = clock.sample - clock.block_first
    if rows == 0:
        return
    clock.block_first = clock.sample
    run.sink.append(run.block[:rows])


def run_statistics(driver: Driver, task: Task, wall: float, compilation: float) -> dict:
    """What a run took, for its result.

    Parameters
    ----------
    driver : Driver
    task : Task
    wall : float
        [s] that it took without compilation.
    compilation : float
        [s] for which it waited for the compiler.
    """
    run, events, sampling = driver.run, driver.events, task.data.model.sampling
    clock, settings, spec = run.clock, run.settings, task.spec
    backends = task.data.model.backends
    simulated = clock.t - settings.begin
    return {
        "integrator": run.stepping.tableau.name,
        "solver": spec.solver,
        "arms": backends.by_arm,
        "not_compiled": backends.reasons,
        "stabilization": spec.stabilization.kind,
        "accuracy": None if spec.accuracy is None else spec.accuracy.written,
        "tolerance": settings.tolerance if settings.adaptive else None,
        "start_time_s": settings.begin,
        "simulated_s": simulated,
        "steps": clock.steps,
        "ambiguous_steps": clock.ambiguous_steps,
        "rejected_steps": clock.rejected,
        "evaluations": clock.evaluations,
        "projections": clock.projections,
        "smallest_step_s": clock.smallest_step if clock.steps else None,
        "largest_step_s": clock.largest_step if clock.steps else None,
        "error_estimate": clock.error_sum if settings.adaptive else None,
        "coupled_steps": clock.coupled_steps,
        "lowest_rank": clock.lowest_rank if clock.steps else None,
        "highest_rank": clock.highest_rank if clock.steps else None,
        "residual_max": clock.worst_residual,
        "correction_max": clock.worst_correction,
        **({} if events is None else events.statistics()),
        **({} if sampling is None else {"control_samples": clock.control_samples}),
        "wall_time_s": wall,
        "compile_time_s": compilation,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }
