"""The driver of a run: calls of the compiled loop, and what Python does between them.

The loop (:func:`multiarm.integration.time_loop.advance`) returns for contact events, which
:mod:`multiarm.simulation.event_handling` handles, for changes of the solver, which are logged, and
for stiffness.

*Stiffness switching.*  Damping, stiff springs or stiff gains make motions that die out at once but
keep the steps of an explicit method short.  The loop detects that
(:func:`multiarm.integration.step_control.detect_stiffness`).  If the user named no method, the
linearly implicit one then takes over, on trial: each of its steps takes many evaluations, and it
stays only if it advances further with each of them.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.coordinates import chart_places, read_chart
from multiarm.dynamics.failures import failure_text, lost_contact_text
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State
from multiarm.dynamics.status import (
    BLOCK_FULL,
    BUDGET_USED,
    CALLBACK_FAILED,
    DIVERGED,
    EVENT,
    GUARD_FIRED,
    LARGE_CORRECTION,
    NOT_CONVERGED,
    NOT_FINITE,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STIFF,
    STOPPED,
)
from multiarm.errors import USER_FAULTS, MultiarmError, SolverError
from multiarm.integration.methods import stepping_of
from multiarm.integration.time_loop import advance, observe
from multiarm.jit.structs import struct_of
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.guard_log import log_reports
from multiarm.simulation.setup import Run
from multiarm.tableaus import METHODS

FOR_STIFF_SCENES = "rodas5p"
# Steps after which a trial shows how long the steps of that method are.
TRIAL_STEPS = 16
# Reasons to return after which the loop is called again.
GOES_ON = (BUDGET_USED, BLOCK_FULL, SOLVER_CHANGED, GUARD_FIRED, STIFF)


class Driver:
    """Advances a run.

    Attributes
    ----------
    run : Run
    events : EventHandler or None
        Where contacts can open, close, slide or stick.
    event_stops : int
        How often the loop has stopped for an event.
    """

    def __init__(self, run: Run, events: EventHandler | None) -> None:
        self.run, self.events, self.event_stops = run, events, 0
        self._switch = Switch()
        self._settings = struct_of(run.settings)

    def advance(self, budget: int) -> tuple[int, str]:
        """Call the loop with a budget of evaluations.

        Returns why it stopped, and why the run cannot go on past an event there (else empty).
        """
        run, events, fault = self.run, self.events, ""
        reason = advance(run.stepping.struct, run.clock.struct, self._settings, run.block, budget)
        if events is not None and reason in (EVENT, STOPPED):
            self.event_stops += 1
            fault = events.handle(run, reason == STOPPED)
            reason = BUDGET_USED
        if reason == STIFF:
            self._switch.begin_trial(run)
        elif reason == BUDGET_USED:  # all due samples are written
            self._switch.end_trial(run)
        elif reason == SOLVER_CHANGED and events is not None:
            run.solver_log.reset(run.data)  # unilateral contacts have their own events
        elif reason == SOLVER_CHANGED:
            run.solver_log.collect(run.data, run.clock.t, state_of(run, run.data.model.layout))
        if reason in (SOLVER_CHANGED, GUARD_FIRED) and run.clock.reports:
            log_reports(run.data, run.stepping, run.clock, run.log)
            if run.data.arrays.status.failed:
                reason = CALLBACK_FAILED
        return reason, fault

    def observe(self, row: np.ndarray) -> int:
        """Evaluate where the run is, and write it as a row of samples; returns a status."""
        run = self.run
        return observe(run.stepping.struct, run.clock.struct, self._settings, row)


class Switch:
    """Stiffness switching: which method a run continues with."""

    def __init__(self) -> None:
        self._explicit: str | None = None  # the method that a trial replaces
        self._pace = 0.0  # of this method [s an evaluation]
        self._until = self._spent = 0
        self._since = 0.0

    def begin_trial(self, run: Run) -> None:
        """Continue with the method for stiff scenes, on trial."""
        clock, tableau = run.clock, run.stepping.tableau
        self._explicit = tableau.name
        # there is no step before right after an event
        self._pace = (clock.h_before or clock.h) / clock.step_cost
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
        return advanced > self._pace * (_step_evaluations(run) - self._spent)

    def _change(self, run: Run, name: str, why: str) -> None:
        """Change the method of a run, at its state."""
        run.continue_with(stepping_of(run.data, METHODS[name]))
        run.clock.switch = False
        self._until, self._spent = run.clock.steps + TRIAL_STEPS, _step_evaluations(run)
        self._since = run.clock.t
        text = f"{why}: the run goes on with {name}"
        run.log.add([{"time": run.clock.t, "kind": "method changes", "text": text}])


def _step_evaluations(run: Run) -> int:
    """Evaluations without those of the samples, which take the same with any method."""
    return run.clock.evaluations - run.clock.sample_evaluations


def state_of(run: Run, layout: Layout) -> State:
    """The state at the beginning of the next step."""
    step, configuration = run.stepping.step, np.empty(layout.nq)
    places = chart_places(run.data.arrays)
    read_chart(layout.frames, step.z, step.base, configuration)
    return State(configuration, step.z[places.velocity : places.states].copy(), layout)


def where_of(run: Run) -> str:
    """Time and step, for messages."""
    return f"at t = {run.clock.t:.9g} s (step {run.clock.steps})"


def failure_of(run: Run, reason: int) -> tuple[str, str]:
    """Status and message of a run that ended early."""
    where = where_of(run)
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
