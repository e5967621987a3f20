"""The driver of a run: calls of the compiled loop, and what Python does between them.

It drives the runs of ``simulate``, whose end stays, and those of a ``Stepper``, whose end moves on.

The loop (:func:`multiarm.integration.time_loop.advance`) returns for contact events, which
:mod:`multiarm.simulation.event_handling` handles, for changes of the solver and events that guards
report, which are logged, and for stiffness.

*Stiffness switching.*  Damping, stiff springs or stiff gains make motions that die out at once but
keep the steps of an explicit method short.  The loop detects that
(:func:`multiarm.integration.step_control.limited_by_stability`).  If the user named no method, the
linearly implicit one then takes over, on trial: each of its steps takes many evaluations, and it
stays only if it advances further with each of them.  Where an object has been put down, the robots
may soon stand still, too: trials that failed are repeated then, each after twice as many steps as
the one before.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.coordinates import chart_places, floating_bases, read_chart
from multiarm.dynamics.failures import failure_text, lost_contact_text
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State
from multiarm.dynamics.status import (
    BLOCK_FULL,
    BUDGET_USED,
    CALLBACK_FAILED,
    DIVERGED,
    EVENT,
    FINISHED,
    GUARD_FIRED,
    LARGE_CORRECTION,
    NOT_CONVERGED,
    NOT_FINITE,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STIFF,
    STOPPED,
)
from multiarm.errors import USER_FAULTS, MultiarmError, TrajectoryError
from multiarm.integration.methods import stepping_of
from multiarm.integration.time_loop import advance, observe
from multiarm.jit.compilation import compile_time, running_time
from multiarm.jit.structs import struct_of
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import RunEvent
from multiarm.results.outcome import RunStatus
from multiarm.scene import RunSpec
from multiarm.scene.faults import listed
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.guard_log import log_reports
from multiarm.simulation.setup import Run, Task, control_end
from multiarm.tableaus import METHODS

FOR_STIFF_SCENES = "rodas5p"
# Steps after which a trial shows how long the steps of that method are.
TRIAL_STEPS = 16
# Steps after which the first trial that failed is repeated, while an object rests.
PAUSE_STEPS = 250
BUDGET = 4000  # evaluations between two calls of progress, and checks of time and Ctrl-C
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time
# The pace of a run is judged over this many steps, including rejected ones.  A stop for an event,
# of which every event makes two, takes about as long as EVENT_STEPS.
JUDGED_STEPS, EVENT_STEPS = 5000, 5
# Steps longer than this part of those that the user set are not too short.
SHORT_SHARE = 0.01
TOO_MANY = "steps became so short that the run hardly got on"
# Reasons to return after which the loop is called again.
GOES_ON = (BUDGET_USED, BLOCK_FULL, SOLVER_CHANGED, GUARD_FIRED, STIFF)


def never() -> bool:
    """Whether a run is to end that nobody interrupts: it is not."""
    return False


class End(Enum):
    """How the driving of a run ended."""

    COMPLETED = auto()
    INTERRUPTED = auto()
    FAILED = auto()  # a step, or the recording of samples
    STALLED = auto()  # the steps became too short, or too many
    UNDECIDED = auto()  # no mode follows an event: the run cannot be advanced any more

    @property
    def status(self) -> RunStatus:
        """The status of the result."""
        if self in (End.COMPLETED, End.INTERRUPTED):
            return RunStatus[self.name]
        return RunStatus.FAILED


class Ending(NamedTuple):
    """How a run ended, and the sentence that says so."""

    end: End
    message: str


class Return(NamedTuple):
    """Why the loop has returned.

    Attributes
    ----------
    reason : int
        A status, see :mod:`multiarm.dynamics.status`.
    event_fault : str
        Why the run cannot go on past the event at which it has returned; empty where it can.
    """

    reason: int
    event_fault: str = ""


class Driver:
    """Advances a run.

    Attributes
    ----------
    task : Task
    run : Run
    events : EventHandler or None
        Where contacts can open, close, slide or stick.
    switch : Switch
    event_stops : int
        How often the loop has stopped for an event.
    wall, compilation : float
        [s] for which the run was driven, without waiting for the compiler, and for which it waited.
    """

    def __init__(
        self, task: Task, run: Run, events: EventHandler | None, compilation: float
    ) -> None:
        self.task, self.run, self.events, self.event_stops = task, run, events, 0
        self.wall, self.compilation = 0.0, compilation
        self.switch, self._pace = Switch(), Pace(run, task.spec)
        self._settings = struct_of(run.settings)
        self._loaded: Return | None = None
        self._span = task.data.model.control_span  # None, too, after the control has ended

    def load(self) -> None:
        """Load the compiled loop and write the first sample, which is no part of ``wall``."""
        compiled_before = compile_time()
        self._loaded = self.advance(0)
        self.compilation += compile_time() - compiled_before

    def drive(
        self, interrupted: Callable[[], bool] = never, most_evaluations: float = math.inf
    ) -> Ending:
        """Call the loop until the run is at its end or cannot go on; all samples are in the sink.

        ``interrupted`` is called between two calls of the loop, and tells whether the run is to
        end.  It is stalled, too, when it has taken more than ``most_evaluations``.
        """
        started, compiled_before = running_time(), compile_time()
        next_checkpoint = time.perf_counter() + CHECKPOINT_INTERVAL
        try:
            returned = self._loaded or self.advance(BUDGET)
            self._loaded = None
            while True:
                ending = self._ending(returned, interrupted(), most_evaluations)
                due = time.perf_counter() >= next_checkpoint
                try:
                    if ending or due or returned.reason == BLOCK_FULL:
                        self.flush()
                    if due:
                        self.run.sink.checkpoint()
                        next_checkpoint = time.perf_counter() + CHECKPOINT_INTERVAL
                except TrajectoryError as error:
                    ending = Ending(End.FAILED, f"{where_of(self.run)}: {error}")
                if ending:
                    return ending
                returned = self.advance(BUDGET)
        finally:
            self.wall += running_time() - started
            self.compilation += compile_time() - compiled_before

    def flush(self) -> None:
        """Write the samples in the block to the sink and begin a new block.

        Raises
        ------
        TrajectoryError
            When the sink cannot take them.
        """
        run, clock = self.run, self.run.clock
        rows = clock.sample - clock.block_first
        clock.block_first = clock.sample
        if rows:
            run.sink.append(run.block[:rows])

    def write_sample(self, row: np.ndarray) -> None:
        """Make a row the next sample of the run."""
        clock, block = self.run.clock, self.run.block
        if clock.sample - clock.block_first == len(block):
            self.flush()
        block[clock.sample - clock.block_first] = row
        clock.sample += 1

    def advance(self, budget: int) -> Return:
        """Call the loop with a budget of evaluations, and act where it has returned."""
        run, events, event_fault = self.run, self.events, ""
        reason = advance(run.stepping.struct, run.clock.struct, self._settings, run.block, budget)
        if self._span is not None and run.clock.t > self._span.end:
            run.log.add(control_end(self._span))
            self._span = None
        if events is not None and reason in (EVENT, STOPPED):
            self.event_stops += 1
            event_fault = events.handle(run, reason == STOPPED)
            reason = BUDGET_USED
        if reason == STIFF:
            self.switch.begin_trial(run)
        elif reason == BUDGET_USED:  # all due samples are written
            self.switch.end_trial(run)
            if events is not None and events.resting:
                self.switch.repeat_trial(run)
        elif reason == SOLVER_CHANGED and events is not None:
            run.solver_log.reset(run.data)  # unilateral contacts have their own events
        elif reason == SOLVER_CHANGED:
            run.solver_log.collect(run.data, run.clock.t, state_of(run, run.data.model.layout))
        if reason in (SOLVER_CHANGED, GUARD_FIRED) and run.clock.reports:
            log_reports(run.data, run.stepping, run.clock, run.log)
            if run.data.arrays.status.failed:
                reason = CALLBACK_FAILED
        return Return(reason, event_fault)

    def observe(self, row: np.ndarray) -> int:
        """Evaluate where the run is, and write it as a row of samples; returns a status."""
        run = self.run
        return observe(run.stepping.struct, run.clock.struct, self._settings, row)

    def _ending(
        self, returned: Return, interrupted: bool, most_evaluations: float
    ) -> Ending | None:
        """How the run ends where the loop has returned; None where it goes on."""
        run, where = self.run, where_of(self.run)
        if returned.reason == FINISHED:
            return Ending(End.COMPLETED, "the run reached its end")
        if interrupted:
            return Ending(End.INTERRUPTED, f"stopped by the user {where}")
        if returned.reason not in GOES_ON:
            ending = failure_of(run, returned.reason)
            if returned.reason != STEP_TOO_SMALL:
                return ending
            return ending._replace(message=ending.message + self._lost_grips())
        if returned.event_fault:
            return Ending(End.UNDECIDED, f"{where}: {returned.event_fault}")
        if run.clock.evaluations > most_evaluations:
            return Ending(End.STALLED, f"{where}: {TOO_MANY}")
        if stall := self._pace.stall(run, self.event_stops):
            return Ending(End.STALLED, f"{where}: {stall.message}{self._lost_grips()}")
        return None

    def _lost_grips(self) -> str:
        """For messages on short steps: joints that the control counts on, with open contacts."""
        names = () if self.events is None else self.events.lost_grips
        if not names:
            return ""
        return (
            f"; the control carries the weight by {listed(names)}, all of whose contacts are open: "
            "let that joint let go (`until`), or leave the gravity compensation out"
        )


@dataclass(frozen=True)
class Stall:
    """A run whose steps have become too short.

    Attributes
    ----------
    steps : int
        Judged steps; rejected ones and events count.
    advanced : float
        By which they have advanced the run [s].
    next_step : float
        [s]
    most_steps : float
        That it may take for ``unit`` [s].
    unit : float
    adaptive : bool
        The method chooses the steps.
    """

    steps: int
    advanced: float
    next_step: float
    most_steps: float
    unit: float
    adaptive: bool

    @property
    def message(self) -> str:
        """The stall in a sentence, with remedies."""
        loosen = "loosen `accuracy`, " if self.adaptive else ""
        return (
            f"{TOO_MANY}: the last {self.steps:,} steps, rejected ones and events counted, "
            f"advanced it by {self.advanced:.2g} s, the next one is {self.next_step:.2g} s long; "
            f"a pace of more than {self.most_steps:.2g} steps (`run.most_steps`) for "
            f"{self.unit:.3g} s; {loosen}look for a control that jumps or oscillates, contacts "
            f"that chatter or a singular posture there, or raise `most_steps`"
        )


class Pace:
    """Steps of a run for a second of simulated time; a run whose steps get too short is ended."""

    def __init__(self, run: Run, spec: RunSpec) -> None:
        self._unit, self._most = min(1.0, spec.duration), spec.most_steps  # [s], see `most_steps`
        chosen = run.settings.longest_step if run.settings.adaptive else run.clock.step
        self._shortest = min(self._unit / self._most, SHORT_SHARE * chosen)
        self._steps, self._t = 0, run.settings.begin

    def stall(self, run: Run, event_stops: int) -> Stall | None:
        """Why the run is to end; None while it advances fast enough, or until it is judged again.

        ``event_stops``: how often the loop has stopped for an event.
        """
        t, clock = run.clock.t, run.clock
        steps = clock.steps + clock.rejected + EVENT_STEPS * event_stops
        judged, advanced = steps - self._steps, t - self._t
        if judged < JUDGED_STEPS:
            return None
        self._steps, self._t = steps, t
        if advanced >= judged * self._shortest:
            return None
        return Stall(judged, advanced, clock.h, self._most, self._unit, run.settings.adaptive)


class Switch:
    """Stiffness switching: which method a run continues with.

    Attributes
    ----------
    switched_at : float or None
        When the scene was found stiff [s] with which the method for stiff scenes goes on; None
        where it does not.
    """

    def __init__(self) -> None:
        self.switched_at: float | None = None
        self._explicit: str | None = None  # the method that a trial replaces
        self._pace = 0.0  # of this method [s an evaluation]
        self._until = self._spent = 0
        self._since = 0.0
        self._pause, self._repeat = PAUSE_STEPS, math.inf  # steps between trials; of the next one

    def begin_trial(self, run: Run) -> None:
        """Continue with the method for stiff scenes, on trial."""
        clock, tableau = run.clock, run.stepping.tableau
        self._explicit, self.switched_at = tableau.name, clock.stiff_since
        # there is no step before right after an event
        self._pace = (clock.h_before or clock.h) / clock.step_cost
        self._change(run, FOR_STIFF_SCENES, "the scene is stiff")

    def end_trial(self, run: Run) -> None:
        """At the end of a trial that failed, continue with the explicit method."""
        if self._explicit is not None and run.clock.steps >= self._until:
            explicit, self._explicit = self._explicit, None
            if not self._is_faster(run):
                self.switched_at = None
                self._change(run, explicit, f"steps of {FOR_STIFF_SCENES} are too costly here")
                self._repeat, self._pause = run.clock.steps + self._pause, 2 * self._pause

    def repeat_trial(self, run: Run) -> None:
        """Detect stiffness once more where it is time for another trial after one that failed."""
        if run.clock.steps >= self._repeat:
            run.clock.watch_stiffness()
            self._repeat = math.inf

    def _is_faster(self, run: Run) -> bool:
        """Whether the method on trial advances further with an evaluation."""
        advanced = run.clock.t - self._since
        return advanced > self._pace * (_step_evaluations(run) - self._spent)

    def _change(self, run: Run, name: str, why: str) -> None:
        """Change the method of a run, at its state."""
        run.continue_with(stepping_of(run.data, METHODS[name]))
        run.clock.switch = False
        self._until, self._spent = run.clock.steps + TRIAL_STEPS, _step_evaluations(run)
        self._since = run.clock.t
        text = f"{why}: the run goes on with {name}"
        run.log.add(RunEvent(run.clock.t, EventKind.METHOD_CHANGES, text))


def _step_evaluations(run: Run) -> int:
    """Evaluations without those of the samples, which take the same with any method."""
    return run.clock.evaluations - run.clock.sample_evaluations


def state_of(run: Run, layout: Layout) -> State:
    """The state at the beginning of the next step."""
    step, configuration = run.stepping.step, np.empty(layout.nq)
    places = chart_places(run.data.arrays)
    read_chart(layout.frames, floating_bases(layout), step.z, step.base, configuration)
    return State(configuration, step.z[places.velocity : places.states].copy(), layout)


def where_of(run: Run) -> str:
    """Time and step, for messages."""
    return f"at t = {run.clock.t:.9g} s (step {run.clock.steps})"


def failure_of(run: Run, reason: int) -> Ending:
    """How a run ends in which a step failed."""
    where = where_of(run)
    smaller = "a smaller `accuracy`" if run.settings.adaptive else "a smaller `step`"
    if reason == CALLBACK_FAILED:
        try:
            run.data.reraise()
        except KeyboardInterrupt:
            return Ending(End.INTERRUPTED, f"stopped by the user {where}")
        except MultiarmError as error:
            return Ending(End.FAILED, f"{where}: {error}")
        except USER_FAULTS as error:
            fault = f"a callback raised {type(error).__name__}: {error}"
            return Ending(End.FAILED, f"{where}: {fault}")
    if reason == STEP_TOO_SMALL and not run.settings.adaptive:
        fault = (
            f"steps of {run.clock.step:.2g} s are lost in the roundings of this time; take a "
            f"longer `step`, or an earlier `start_time`"
        )
    elif reason == STEP_TOO_SMALL:
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
    return Ending(End.FAILED, f"{where}: {fault}")
