"""One run: calls of the compiled loop until the end, samples to the sink, and the outcome.

The setup of a run is in :mod:`multiarm.simulation.setup`; :mod:`multiarm.simulation.certified`
judges its accuracy afterwards.

*Stiffness switching.*  Damping, stiff springs or stiff gains make motions that die out at once but
keep the steps of an explicit method short.  The loop detects that
(:func:`multiarm.integration.step_control.detect_stiffness`).  If the user named no method, the
linearly implicit one then takes over, on trial: each of its steps takes many evaluations, and it
stays only if it advances further with each of them.
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
from multiarm.integration.step_control import (
    BLOCK_FULL,
    BUDGET_USED,
    DIVERGED,
    EVENT,
    FINISHED,
    LARGE_CORRECTION,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STIFF,
    STIFF_AFTER,
    STOPPED,
)
from multiarm.integration.time_loop import advance
from multiarm.integration.variational import NOT_CONVERGED
from multiarm.jit.structs import struct_of
from multiarm.results.event_log import EventLog
from multiarm.results.sinks import Sink, provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, dump_scene
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.interrupts import Interrupt, deferred_interrupt
from multiarm.simulation.setup import Run, make_stepping, method_and_tolerance, prepare
from multiarm.tableaus import EXPLICIT

BUDGET = 4000  # evaluations between two calls of progress, and checks of time and Ctrl-C
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time
# The pace of a run is judged over this many steps, including rejected ones.  A stop for an event,
# of which every event makes two, takes about as long as EVENT_STEPS.
JUDGED_STEPS, EVENT_STEPS = 5000, 5
# Steps longer than this part of those that the user set are not too short.
SHORT_SHARE = 0.01
MESSAGE_LENGTH = 600  # [characters], including the summary of events
FOR_STIFF_SCENES = "rodas5p"
# Steps after which a trial shows how long the steps of that method are.
TRIAL_STEPS = 16

TOO_MANY = "steps became so short that the run hardly got on"

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Task:
    """What is run: the same for all runs that differ in their tolerance only."""

    system: System
    data: Data
    spec: RunSpec
    state: State | None  # initial state; None: the scene's start
    longest_step: float  # [s]


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
        The run fails when it takes more: with tolerances near rounding, steps may become extremely
        short.

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
    run.sink.open(system.channels, _metadata(system, spec, given), sample_columns)
    interrupt = Interrupt()
    try:
        pace = Pace(run, spec)
        status, message, wall = _drive(run, events, progress, most_evaluations, pace, interrupt)
    except BaseException as error:
        # the error passes through, but the samples are kept
        with suppress(TrajectoryError):
            _flush(run)
        statistics = _statistics(run, events, task, 0.0)
        run.sink.finish("failed", f"{_where(run)}: {error!r}", statistics, log.all())
        raise
    message += _stiffness_remark(run)
    message += log.summary(MESSAGE_LENGTH - len(message))
    statistics = _statistics(run, events, task, wall)
    trajectory = run.sink.finish(status, message, statistics, log.all())
    interrupt.deliver()
    return trajectory


def leave_undone(system: System, given: bool, sink: Sink, status: str, message: str) -> Trajectory:
    """The result of a run that did not begin: no samples, and the reason.

    Raises
    ------
    TrajectoryError
        When the sink cannot be opened.
    """
    sink.open(system.channels, _metadata(system, system.scene.run, given), sample_columns)
    return sink.finish(status, message, {"simulated_s": 0.0, "wall_time_s": 0.0})


class Pace:
    """Steps of a run for a second of simulated time; a run whose steps get too short is ended.

    Attributes
    ----------
    event_stops : int
        How often the loop has stopped for an event.
    """

    def __init__(self, run: Run, spec: RunSpec) -> None:
        self.event_stops = 0
        self._unit, self._most = min(1.0, spec.duration), spec.most_steps  # [s], see `most_steps`
        chosen = run.settings.longest_step if run.settings.adaptive else run.settings.step
        self._shortest = min(self._unit / self._most, SHORT_SHARE * chosen)
        self._steps, self._t = 0, run.settings.begin

    def judge(self, run: Run) -> str:
        """Why the run is ended; empty while it advances fast enough."""
        t, clock = run.clock.t, run.clock
        steps = clock.steps + clock.rejected + EVENT_STEPS * self.event_stops
        made, advanced = steps - self._steps, t - self._t
        if made < JUDGED_STEPS:
            return ""
        self._steps, self._t = steps, t
        if advanced >= made * self._shortest:
            return ""
        loosen = "loosen `accuracy`, " if run.settings.adaptive else ""
        return (
            f"{TOO_MANY}: the last {made:,} steps, rejected ones and events counted, advanced it "
            f"by {advanced:.2g} s, the next one is {run.clock.h:.2g} s long; a pace of more "
            f"than {self._most:.2g} steps (`run.most_steps`) for {self._unit:.3g} s; {loosen}look "
            f"for a control that jumps or oscillates, contacts that chatter or a singular posture "
            f"there, or raise `most_steps`"
        )


class Switch:
    """Stiffness switching: which method a run continues with."""

    def __init__(self) -> None:
        self._explicit: str | None = None  # the method that a trial replaces
        self._explicit_pace = 0.0  # [s] an evaluation
        self._until = self._spent = 0
        self._since = 0.0

    def begin_trial(self, run: Run) -> None:
        """Continue with the method for stiff scenes, on trial."""
        method, clock = run.stepping.method, run.clock
        self._explicit = run.stepping.tableau.name
        # besides the stages, an explicit step takes three: two for projection, one at its end
        self._explicit_pace = clock.h_before / (method.stages + 2)
        self._change(run, FOR_STIFF_SCENES, "the scene is stiff")

    def end_trial(self, run: Run) -> None:
        """At the end of a trial that failed, continue with the explicit method."""
        if self._explicit is not None and run.clock.steps >= self._until:
            explicit, self._explicit = self._explicit, None
            if not self._is_faster(run):
                self._change(run, explicit, f"steps of {FOR_STIFF_SCENES} are too costly here")

    def _is_faster(self, run: Run) -> bool:
        """Whether the method on trial advances further with an evaluation."""
        advanced = run.clock.t - self._since
        return advanced > self._explicit_pace * (_step_evaluations(run) - self._spent)

    def _change(self, run: Run, name: str, why: str) -> None:
        """Change the method of a run, at its state."""
        old, run.stepping = run.stepping.step, make_stepping(run.data, name, run.tolerance)
        new = run.stepping.step
        new.z[:], new.base[:], new.slope[:] = old.z, old.base, old.slope
        run.settings = run.settings._replace(switch=False)
        self._until, self._spent = run.clock.steps + TRIAL_STEPS, _step_evaluations(run)
        self._since = run.clock.t
        text = f"{why}: the run goes on with {name}"
        run.log.add([{"time": run.clock.t, "kind": "method", "text": text}])


def _step_evaluations(run: Run) -> int:
    """Evaluations without those of the samples, which take the same with any method."""
    clock, projected = run.clock, run.settings.gap_tolerance >= 0.0
    return clock.evaluations - clock.sample * (3 if projected else 1)


def _stiffness_remark(run: Run) -> str:
    """For the message of a stiff scene: what was done, or the remedy; else empty."""
    clock = run.clock
    if run.stepping.tableau.name == FOR_STIFF_SCENES and run.may_switch:
        return (
            f"; the scene is stiff: {FOR_STIFF_SCENES} took over at t = {clock.stiff_since:.3g} s"
        )
    explicit = run.stepping.tableau.kind == EXPLICIT and not run.may_switch
    if not explicit or clock.stiff_steps < STIFF_AFTER:
        return ""
    since = f"stiff from t = {clock.stiff_since:.3g} s"
    return f"; the scene is {since}: `integrator: {FOR_STIFF_SCENES}` takes longer steps there"


def _metadata(system: System, spec: RunSpec, given: bool) -> Callable[[], dict[str, Any]]:
    """Provenance, on access: writing the scene takes longer than a short run.

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
    events: EventHandler | None,
    progress: Progress | None,
    most_evaluations: float,
    pace: Pace,
    interrupt: Interrupt,
) -> tuple[str, str, float]:
    """Call the compiled loop until the end; returns status, message and wall time [s].

    A Ctrl-C that came too late to end the run is left in ``interrupt``.
    """
    switch = Switch()
    reason = _advance(run, 0)  # may compile the loop, which does not count as time of the run
    started = time.perf_counter()
    next_checkpoint = started + CHECKPOINT_INTERVAL
    with deferred_interrupt(interrupt):
        while True:
            collect_events(run.data, run.log)
            fault = ""
            if events is not None and reason in (EVENT, STOPPED):
                pace.event_stops += 1
                fault = events.handle(run, reason == STOPPED)
                reason = BUDGET_USED
            if reason == STIFF:
                switch.begin_trial(run)
            elif reason == BUDGET_USED:  # all due samples are written
                switch.end_trial(run)
            elif reason == SOLVER_CHANGED and events is not None:
                run.solver_log.reset(run.data)  # unilateral contacts have their own events
            elif reason == SOLVER_CHANGED:
                run.solver_log.collect(run.data, run.clock.t, _state(run))
            try:
                if progress is not None:
                    progress(run.clock.t)
            except KeyboardInterrupt:  # the caller ends the run
                interrupt.pressed = reason != FINISHED
            ended = None
            if reason == FINISHED:
                ended = "completed", "the run reached its end"
            elif interrupt.pressed:
                interrupt.pressed = False
                ended = "interrupted", f"stopped by the user {_where(run)}"
            elif reason not in (BUDGET_USED, BLOCK_FULL, SOLVER_CHANGED, STIFF):
                ended = _failure(run, reason)
            else:
                if not fault:
                    too_many = run.clock.evaluations > most_evaluations
                    fault = TOO_MANY if too_many else pace.judge(run)
                if fault:
                    ended = "failed", f"{_where(run)}: {fault}"
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
            reason = _advance(run, BUDGET)


def _advance(run: Run, budget: int) -> int:
    """Call the compiled loop with a budget of evaluations; returns why it stopped."""
    return advance(
        run.data.struct, run.stepping.struct, run.clock.struct, struct_of(run.settings),
        run.block, budget,
    )  # fmt: skip


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


def _failure(run: Run, reason: int) -> tuple[str, str]:
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
        fault = (
            f"the step became too small ({run.clock.h:.2g} s) for the required accuracy; loosen "
            f"`accuracy`, or look for a discontinuous controller or a singular posture there"
        )
    elif reason == DIVERGED:
        fault = (
            f"the joints came apart by more than {run.settings.divergence_bound:.2g} m, the run "
            f"has diverged; take {smaller}, or `stabilization: projection`"
        )
    elif reason == LARGE_CORRECTION:
        fault = (
            "every step, however short, ends far from the joints; look for a motion that they "
            "cannot follow, or start elsewhere"
        )
    elif reason == NOT_CONVERGED:
        fault = (
            "the equations of a variational step could not be solved; take a smaller `step`, or "
            "`integrator: dop853` where damping is strong or linkages lie flat"
        )
    elif reason == NOT_FINITE:
        lost = lost_contact_text(run.data)
        fault = lost or f"the state is no longer finite; take {smaller}"
    else:
        fault = failure_text(run.data, reason)
    return "failed", f"{where}: {fault}"


def _flush(run: Run) -> None:
    """Write the samples in the block to the sink and begin a new block."""
    clock = run.clock
    rows = clock.sample - clock.block_first
    if rows == 0:
        return
    clock.block_first = clock.sample
    run.sink.append(run.block[:rows])


def _statistics(run: Run, events: EventHandler | None, task: Task, wall: float) -> dict:
    clock, settings, spec = run.clock, run.settings, task.spec
    backends = task.data.model.backends
    simulated = clock.t
    return {
        "integrator": run.stepping.tableau.name,
        "solver": spec.solver,
        "arms": backends.by_arm,
        "not_compiled": backends.reasons,
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
        **({} if events is None else events.statistics()),
        "wall_time_s": wall,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }
