"""Carry out one run: drive the compiled loop, pour out the samples, tell how it ended.

What a run is asked for is settled before (:mod:`multiarm.simulation.setup`), and whether it is
accurate enough is judged after (:mod:`multiarm.simulation.certified`): here it only takes place.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import CALLBACK_FAILED, NOT_FINITE
from multiarm.dynamics.diagnosis import failure_text, lost_contact_text
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import USER_FAULTS, MultiarmError, SolverError, TrajectoryError
from multiarm.integration.monitors import collect_events
from multiarm.integration.samples import sample_columns
from multiarm.integration.stepper import step_struct
from multiarm.integration.time_loop import (
    BLOCK_FULL,
    BUDGET_USED,
    DIVERGED,
    EVENT,
    FINISHED,
    LARGE_CORRECTION,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STIFF,
    STOPPED,
    advance,
)
from multiarm.integration.variational import NOT_CONVERGED
from multiarm.jit.structs import struct_of
from multiarm.results.event_log import EventLog
from multiarm.results.sinks import Sink, provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, dump_scene
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.interrupts import Interrupt, deferred_interrupt
from multiarm.simulation.setup import Run, method_and_tolerance, prepare
from multiarm.simulation.switching import Switch, stiffness_remark

BUDGET = 4000  # evaluations between two looks at the clock, progress and Ctrl-C
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time
# The pace of a run is judged over so many steps, rejected ones too.  A stop for an event, of which
# every event makes two, takes about as long as so many steps.
JUDGED_STEPS, EVENT_STEPS = 5000, 5
# The unit of time of `run.most_steps` [s]; of a shorter run its duration.
PACE_UNIT = 1.0
# Steps of this part of those that the settings ask for are no sign of trouble.
AS_ASKED = 0.01
# A message is not made longer than this by what happened on the way [characters].
MESSAGE_LENGTH = 600

TOO_MANY = "steps became so short that the run hardly got on"

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Task:
    """What is to be run: the same for all runs that differ in their tolerance alone.

    Attributes
    ----------
    system : System
    data : Data
        What the runs write.
    spec : RunSpec
    state : State or None
        Where to begin; None: the scene's start.
    longest_step : float
        [s]
    """

    system: System
    data: Data
    spec: RunSpec
    state: State | None
    longest_step: float


class Pace:
    """How many steps a run takes for a second; one that would go on for ever is given up.

    Attributes
    ----------
    event_stops : int
        How often the loop has stopped for an event.
    """

    def __init__(self, run: Run, spec: RunSpec) -> None:
        self.event_stops = 0
        self._unit, self._most = min(PACE_UNIT, spec.duration), spec.most_steps
        asked = run.settings.longest_step if run.settings.adaptive else run.settings.step
        self._shortest = min(self._unit / self._most, AS_ASKED * asked)
        self._steps, self._t = 0, run.settings.begin

    def judge(self, run: Run) -> str:
        """Why the run is given up; empty as long as it gets on."""
        t, clock = run.clock.t, run.clock
        steps = clock.steps + clock.rejected + EVENT_STEPS * self.event_stops
        made, got_on = steps - self._steps, t - self._t
        if made < JUDGED_STEPS:
            return ""
        self._steps, self._t = steps, t
        if got_on >= made * self._shortest:
            return ""
        loosen = "loosen `accuracy`, " if run.settings.adaptive else ""
        return (
            f"{TOO_MANY}: the last {made:,} steps, rejected ones and events counted, advanced it "
            f"by {got_on:.2g} s, the next one is {run.clock.h:.2g} s long; a pace of more "
            f"than {self._most:.2g} steps (`run.most_steps`) for {self._unit:.3g} s; {loosen}look "
            f"for a control that jumps or oscillates, contacts that chatter or a singular posture "
            f"there, or raise `most_steps`"
        )


def carry_out(
    task: Task,
    sink: Sink,
    progress: Progress | None = None,
    tighten: float = 1.0,
    most_evaluations: float = math.inf,
) -> Trajectory:
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
        The run fails when it takes more: with tolerances near rounding, steps may become so short
        that it would hardly get on.

    Raises
    ------
    SolverError, ControlError
        When the very first evaluation is impossible.
    TrajectoryError
        When the sink cannot be opened.
    """
    system, full, spec, state = task.system, task.data, task.spec, task.state
    log, data, events, given = EventLog(), full, None, state is not None
    if full.model.unilateral is not None:
        events = EventHandler(full, method_and_tolerance(spec, tighten)[1], spec.step, log)
        start = system.initial_state() if state is None else state
        data, state = events.begin(start, given)
    run = prepare(system, data, spec, state, sink, task.longest_step, log, tighten)
    if events is not None:
        events.arm(run)
    run.events, run.full = events, full
    run.sink.open(system.channels, _metadata(system, spec, given), sample_columns)
    interrupt = Interrupt()
    try:
        pace = Pace(run, spec)
        status, message, wall = _drive(run, progress, most_evaluations, pace, interrupt)
    except BaseException as error:
        # not ours to handle, but what was simulated is kept
        with suppress(TrajectoryError):
            _flush(run)
        statistics = _statistics(run, spec, 0.0)
        run.sink.finish("failed", f"{_where(run)}: {error!r}", statistics, log.all())
        raise
    message += stiffness_remark(run)
    message += log.summary(MESSAGE_LENGTH - len(message))
    trajectory = run.sink.finish(status, message, _statistics(run, spec, wall), log.all())
    interrupt.deliver()
    return trajectory


def leave_undone(system: System, given: bool, sink: Sink, status: str, message: str) -> Trajectory:
    """The result of a run that cannot begin, or shall not: no samples, and the reason.

    Raises
    ------
    TrajectoryError
        When the sink cannot be opened.
    """
    sink.open(system.channels, _metadata(system, system.scene.run, given), sample_columns)
    return sink.finish(status, message, {"simulated_s": 0.0, "wall_time_s": 0.0})


def _metadata(system: System, spec: RunSpec, given: bool) -> Callable[[], dict[str, Any]]:
    """Where the result comes from; writing the scene takes longer than many a run.

    ``given``: the start is not the scene's.
    """
    scene = system.scene  # a result must not keep its system alive
    python = system.model.python_control is not None
    control = "python function" if python else scene.control.kind
    start, created = "given state" if given else "scene", time.time()

    def metadata() -> dict[str, Any]:
        text = dump_scene(scene.model_copy(update={"run": spec}))
        return {**provenance(text, created), "control": control, "start": start}

    return metadata


def _drive(
    run: Run,
    progress: Progress | None,
    most_evaluations: float,
    pace: Pace,
    interrupt: Interrupt,
) -> tuple[str, str, float]:
    """Let the compiled loop run to its end; returns status, message and wall time [s].

    A Ctrl-C that came too late to end the run is left in ``interrupt``.
    """
    advance_by, switch = _advancer(run), Switch()
    reason = advance_by(0)  # compiles the loop if need be, which is no part of the run's time
    started = time.perf_counter()
    next_checkpoint = started + CHECKPOINT_INTERVAL
    with deferred_interrupt(interrupt):
        while True:
            ended = None
            collect_events(run.data, run.log)
            if run.events is not None and reason in (EVENT, STOPPED):
                pace.event_stops += 1
                trouble = run.events.happens(run, reason == STOPPED)
                ended = ("failed", f"{_where(run)}: {trouble}") if trouble else None
                advance_by = _advancer(run)
                reason = BUDGET_USED
            if reason == STIFF:
                switch.take_over(run)
                advance_by = _advancer(run)
            elif reason == BUDGET_USED and switch.judge(run):  # then no sample is due any more
                advance_by = _advancer(run)
            if reason == SOLVER_CHANGED and run.events is not None:
                run.solver_log.settle(run.data)  # unilateral contacts have their own events
            elif reason == SOLVER_CHANGED:
                run.solver_log.collect(run.data, run.clock.t, _state(run))
            try:
                if progress is not None:
                    progress(run.clock.t)
            except KeyboardInterrupt:  # the caller's way to end the run in good order
                interrupt.pressed = reason != FINISHED
            if reason == FINISHED:
                ended = "completed", "the run reached its end"
            elif interrupt.pressed:
                interrupt.pressed = False
                ended = "interrupted", f"stopped by the user {_where(run)}"
            elif reason not in (BUDGET_USED, BLOCK_FULL, SOLVER_CHANGED, STIFF) and not ended:
                ended = _trouble(run, reason)
            elif run.clock.evaluations > most_evaluations and not ended:
                ended = "failed", f"{_where(run)}: {TOO_MANY}"
            elif not ended:
                trouble = pace.judge(run)
                ended = ("failed", f"{_where(run)}: {trouble}") if trouble else None
            due = time.perf_counter() >= next_checkpoint
            try:
                if ended or due or reason == BLOCK_FULL:
                    _flush(run)
                if due:
                    run.sink.checkpoint()
                    next_checkpoint = time.perf_counter() + CHECKPOINT_INTERVAL
            except TrajectoryError as error:
                ended = "failed", f"{_where(run)}: {error}"
            if ended:
                return *ended, time.perf_counter() - started
            reason = advance_by(BUDGET)


def _advancer(run: Run) -> Callable[[int], int]:
    """The compiled loop as a function of its budget of evaluations."""
    struct, joints = run.data.struct, run.data.model.layout.joints
    arrays = step_struct(run.stepping.method, run.stepping.step)

    settings, fixed = run.settings, struct_of(run.settings)

    def advance_by(budget: int) -> int:
        nonlocal settings, fixed
        if run.settings is not settings:  # an event has changed them
            settings, fixed = run.settings, struct_of(run.settings)
        return advance(struct, joints, arrays, run.clock.struct, fixed, run.block, budget)

    return advance_by


def _state(run: Run) -> State:
    """The state at the beginning of the next step."""
    n, z = run.data.model.layout.joints, run.stepping.step.z
    return State(
        np.concatenate([z[:3], run.stepping.step.base, z[6 : 6 + n]]),
        z[6 + n : 12 + 2 * n].copy(),
        run.data.model.layout,
    )


def _where(run: Run) -> str:
    return f"at t = {run.clock.t:.9g} s (step {run.clock.steps})"


def _trouble(run: Run, reason: int) -> tuple[str, str]:
    """Status and message of a run that ended early."""
    where = _where(run)
    smaller = "a smaller `accuracy`" if run.settings.adaptive else "a smaller `step`"
    if reason == CALLBACK_FAILED:
        try:
            run.data.reraise()
        except KeyboardInterrupt:
            return "interrupted", f"stopped by the user {where}"
        except SolverError as error:
            return "failed", f"{where}: {lost_contact_text(run.data) or error}"
        except MultiarmError as error:
            return "failed", f"{where}: {error}"
        except USER_FAULTS as error:
            return "failed", f"{where}: a callback raised {type(error).__name__}: {error}"
    if reason == STEP_TOO_SMALL:
        return "failed", (
            f"{where}: the step became too small ({run.clock.h:.2g} s) for the asked "
            "accuracy; loosen `accuracy`, or look for a discontinuous controller or a singular "
            "posture there"
        )
    if reason == DIVERGED:
        return "failed", (
            f"{where}: the joints came apart by more than {run.settings.apart:.2g} m, the run has "
            f"diverged; take {smaller}, or `stabilization: projection`"
        )
    if reason == LARGE_CORRECTION:
        return "failed", (
            f"{where}: every step, however short, ends far from the joints; look for a motion that "
            f"they cannot follow, or start elsewhere"
        )
    if reason == NOT_CONVERGED:
        return "failed", (
            f"{where}: the equations of a variational step could not be solved; take a smaller "
            "`step`, or `integrator: dop853` where damping is strong or linkages lie flat"
        )
    if reason == NOT_FINITE:
        lost = lost_contact_text(run.data)
        return "failed", f"{where}: {lost or f'the state is no longer finite; take {smaller}'}"
    return "failed", f"{where}: {failure_text(run.data, reason)}"


def _flush(run: Run) -> None:
    """Hand the samples in the block to the sink and begin a new one."""
    clock = run.clock
    rows = clock.sample - clock.block_first
    if rows == 0:
        return
    clock.block_first = clock.sample
    run.sink.append(run.block[:rows])


def _statistics(run: Run, spec: RunSpec, wall: float) -> dict:
    clock, settings = run.clock, run.settings
    simulated = clock.t
    return {
        "integrator": run.stepping.tableau.name,
        "solver": spec.solver,
        "arms": run.full.model.backends.by_arm,
        "not_compiled": run.full.model.backends.reasons,
        "stabilization": spec.stabilization.kind,
        "accuracy": None if spec.accuracy is None else spec.accuracy.written,
        "tolerance": settings.tolerance if settings.adaptive else None,
        "simulated_s": simulated,
        "steps": clock.steps,
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
        **({} if run.events is None else run.events.statistics()),
        "wall_time_s": wall,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }
