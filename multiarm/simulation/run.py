"""One run: its beginning, its driving, and the outcome.

The setup of a run is in :mod:`multiarm.simulation.setup`; :mod:`multiarm.simulation.certified`
judges its accuracy afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

from multiarm.errors import TrajectoryError
from multiarm.integration.step_control import STIFF_AFTER
from multiarm.jit.compilation import compile_time
from multiarm.notation import count_of
from multiarm.results.event_log import CLAUSE_SEPARATOR, EventLog
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import Sink
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.driver import FOR_STIFF_SCENES, Driver, End, where_of
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.guard_log import log_start
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.simulation.record import RunStatistics, open_sink, run_statistics
from multiarm.simulation.setup import (
    Run,
    Task,
    check_control_span,
    method_and_tolerance,
    prepare,
)

MESSAGE_LENGTH = 600  # [characters], including the summary of events


class FinishedRun(NamedTuple):
    """A run that has come to its end, or as far as it could.

    Attributes
    ----------
    trajectory : Trajectory
    end : End
    statistics : RunStatistics
    """

    trajectory: Trajectory
    end: End
    statistics: RunStatistics


def carry_out(
    task: Task,
    sink: Sink,
    progress: Callable[[float], None] | None = None,
    tighten: float = 1.0,
    most_evaluations: float = math.inf,
) -> FinishedRun:
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
    check_control_span(task.data.model, task.begin, task.end)
    driver = begin(task, sink, tighten)
    run, log = driver.run, driver.run.log
    open_sink(sink, system, spec, with_state)
    try:
        driver.load()
        with deferred_interrupt() as interrupt:

            def interrupted() -> bool:
                try:
                    if progress is not None:
                        progress(run.clock.t)
                except KeyboardInterrupt:
                    return True
                return interrupt.pressed

            end, message = driver.drive(interrupted, most_evaluations)
    except BaseException as error:
        # the error passes through, but the samples are kept
        with suppress(TrajectoryError):
            driver.flush()
        sink.finish(
            RunStatus.FAILED,
            f"{where_of(run)}: {error!r}",
            run_statistics(driver).as_dict(),
            log.entries(),
        )
        raise
    remarks = [*_stiffness_remarks(driver), *_ambiguity_remarks(run)]
    length = len(CLAUSE_SEPARATOR.join([message, *remarks]))
    remarks += log.remarks(MESSAGE_LENGTH - length)
    statistics = run_statistics(driver)
    trajectory = sink.finish(
        end.status, message, statistics.as_dict(), log.entries(), remarks=remarks
    )
    if end is not End.INTERRUPTED:
        interrupt.deliver()  # it came too late to end the run
    return FinishedRun(trajectory, end, statistics)


def begin(task: Task, sink: Sink, tighten: float = 1.0) -> Driver:
    """Bring a task to its start: the initial mode of its contacts, the first evaluation and step.

    ``tighten`` as in :func:`carry_out`; the sink is not opened yet.

    Raises
    ------
    SolverError, ControlError
        When the very first evaluation is impossible.
    """
    compiled_before = compile_time()
    spec, state, log, events, in_mode = task.spec, task.state, EventLog(), None, task
    if task.data.model.unilateral is not None:
        tolerance = method_and_tolerance(spec, tighten)[1]
        stops = spec.painleve == "stop"
        events = EventHandler(
            task.data, tolerance, spec.step, _latest(task), log, stops_at_painleve=stops
        )
        start = task.system.initial_state() if state is None else state
        data, state = events.begin(task.begin, start, state is not None)
        in_mode = replace(task, data=data, state=state)
    run = prepare(in_mode, sink, log, tighten)
    if events is not None:
        events.arm(run)
    log_start(run.data, log, task.begin)
    return Driver(task, run, events, compile_time() - compiled_before)


def _latest(task: Task) -> float:
    """The largest time that is known to come [s]."""
    return max((abs(t) for t in (task.begin, task.end) if math.isfinite(t)), default=0.0)


def _stiffness_remarks(driver: Driver) -> list[str]:
    """For the message of a stiff scene: what was done, or the remedy; else none."""
    clock, switched_at = driver.run.clock, driver.switch.switched_at
    if switched_at is not None:
        return [f"the scene is stiff: {FOR_STIFF_SCENES} took over at t = {switched_at:.3g} s"]
    if driver.task.spec.integrator is None or clock.stiff_steps < STIFF_AFTER:
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
