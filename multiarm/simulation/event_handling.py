"""Events of a run with unilateral contacts; between them it is like any other.

The loop returns when a guard has changed its sign inside a step, before that step is accepted.  The
time is found on the step's dense output, the loop goes on to stop exactly there, and what comes
next is decided (:mod:`multiarm.events`): the run then goes on in another mode, which is another
Data with the same state.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from multiarm.assembly.start import TOUCHING
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.equations import evaluate_state, update_kinematics, update_rows
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.errors import MultiarmError, SolverError
from multiarm.events.event_detection import (
    GuardValues,
    closed_constraints,
    first_event,
    off_patch_constraints,
    pressed_constraints,
    touching_constraints,
)
from multiarm.events.kernels import (
    CONSTRAINT,
    GUARD_KIND,
    PATCH_GUARD,
    PUSH_GUARD,
    RATE_GUARD,
    SLIP_GUARD,
    THRESHOLD,
    start_guards,
)
from multiarm.events.modes import GAP_THRESHOLD, Choice, Mode, Modes
from multiarm.events.transition import Decision, Transition, decision_events
from multiarm.integration.projection import project
from multiarm.integration.stepper import begin_chart, evaluate_slope, step_struct
from multiarm.integration.time_loop import gains
from multiarm.results.event_log import EventLog
from multiarm.simulation.setup import Run, Tolerance, make_stepping

# Gaps of those that have just hit are as small as the step's errors.
HIT_SHARE = 4.0
# Slip that has come to rest is as small as so many tolerances of a step; else it has only turned.
STILL_SHARE = 1e3
# Bounces are followed down to this part of the tolerance of a step; of a run with fixed steps to
# this part of the scene's size.
REST_SHARE, REST_SIZE = 1.0, 1e-9
# Of lower hops no guard would notice that they left the ground [m].
LOWEST_HOP = 4.0 * GAP_THRESHOLD
# Slip of so many tolerances of a step has hardly a direction of its own, of fixed steps what so
# large an acceleration [m/s^2] makes of it in one; at least so much [m/s].
SLOW, SLOW_OF_STEP, SLOWEST = 1000.0, 10.0, 1e-9
# So many events with no time between them end the run.
MOST_AT_ONCE, AT_ONCE = 60, 1e-11
# A decision that does not hold at once is made again with what comes later by so much of the
# longest step that led to an event.
AHEAD = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
# After an event the first step is this part of the last one.
SHORTER = 0.5


@dataclass
class Pending:
    """An event that was found: its time and its guards; the run is on its way there."""

    time: float
    guards: list[int]


@dataclass(frozen=True)
class _News:
    """What is known at an event: see :class:`multiarm.events.transition.Transition`."""

    touching: set[int]
    at_rest: dict[int, float] = field(default_factory=dict)
    unloaded: set[int] = field(default_factory=set)
    beside: frozenset[int] = frozenset()


class EventHandler:
    """Modes and events of one run.

    Attributes
    ----------
    residual : float
        Largest residual of the complementarity problems.
    """

    def __init__(self, data: Data, tolerance: Tolerance | None, step: float | None, log: EventLog):
        if tolerance is None:
            assert step is not None, "steps are either fixed or chosen"
            slow = SLOW_OF_STEP * step
        else:
            slow = SLOW * tolerance.position
        self.modes = Modes(data, max(slow, SLOWEST))
        self.residual = 0.0
        self.count = 0
        self._log = log
        self._size = 1.0
        self._tolerance = tolerance
        self._rest_height = 0.0
        self._pending: Pending | None = None
        self._trouble = ""
        self._last_length = self._usual_length = 0.0
        self._crowd, self._crowd_since = 0, -np.inf
        self.mode: Mode

    # --- beginning --------------------------------------------------------------------------------

    def begin(self, start: State, given: bool) -> tuple[Data, State | None]:
        """Data of the mode in which a run begins, and its state after an impact.

        ``given``: the start is not the scene's.  None: the scene's start as it is.
        """
        touching, beside, self._size = touching_constraints(self.modes, 0.0, start)
        of_step = None if self._tolerance is None else self._tolerance.smallest
        height = REST_SIZE * self._size if of_step is None else REST_SHARE * of_step
        self._rest_height = max(height, LOWEST_HOP)
        before = Choice((), ())
        decision = self._decide(0.0, _News(touching, beside=beside))
        self._tell(0.0, decision, before)
        if self._trouble:
            raise SolverError(f"at the start: {self._trouble}")
        self.mode = self.modes.enter(decision.choice, decision.directions)
        changed = decision.hits or given
        return self.mode.data, self.mode.data.get_state() if changed else None

    def statistics(self) -> dict[str, Any]:
        """How many events there were, and the largest residual of what was decided at them."""
        return {"contact_events": self.count, "complementarity_residual": self.residual}

    # --- events -----------------------------------------------------------------------------------

    def happens(self, run: Run, stopped: bool) -> str:
        """Deal with an event: find it, or decide what follows where the run has ``stopped``.

        Returns what ended the run, or nothing.
        """
        try:
            return self.cross(run) if stopped else self.locate(run)
        except MultiarmError as error:
            return str(error)

    def locate(self, run: Run) -> str:
        """Find the first event in the step just made, and let the loop stop there."""
        arrays, t = self.mode.arrays, run.clock.t
        begin, end = arrays.span
        struct, method = run.data.struct, run.stepping.method
        probe = GuardValues(struct, step_struct(method, run.stepping.step), self.mode, begin, end)
        theta, guards = first_event(probe, arrays.found.copy(), arrays.levels[:, THRESHOLD])
        arrays.least[:] = np.inf
        arrays.muted[0] = 1
        if not guards:  # what looked like an event is none: the step is made again, and accepted
            return ""
        self._last_length = end - begin
        self._usual_length = max(self._usual_length, end - begin)
        time = begin + theta * (end - begin)
        self._pending = Pending(time, guards)
        if time - t <= 1e-13 * max(1.0, t):
            return self.cross(run)
        run.settings = run.settings._replace(stop=time)
        return ""

    def cross(self, run: Run) -> str:
        """Decide what comes after the event at which the run has stopped; trouble or nothing."""
        assert self._pending is not None, "the run stops where an event was found"
        pending, self._pending = self._pending, None
        t, step = run.clock.t, run.stepping.step
        before = self.mode.choice
        self._load(run)
        guards = self.mode.arrays.guards[pending.guards]
        news = _News(
            self._touching(pending),
            self._at_rest(pending),
            {int(g[CONSTRAINT]) for g in guards if g[GUARD_KIND] == PUSH_GUARD},
            off_patch_constraints(
                self.modes,
                before,
                {int(g[CONSTRAINT]) for g in guards if g[GUARD_KIND] == PATCH_GUARD},
            ),
        )
        decision = self._settle(t, news)
        self._tell(t, decision, before)
        self._crowded(t)
        if self._trouble:
            return self._trouble
        self._go_on(run, decision, step)
        return ""

    def _at_rest(self, pending: Pending) -> dict[int, float]:
        """Speeds of constraints whose slip has just come to rest: as small as the step's errors."""
        constraints, guards = self.modes.unilateral.constraints, self.mode.arrays.guards
        rates, found = self.modes.full.arrays.contacts[:, GAP_RATE], {}
        of_step = SLOWEST if self._tolerance is None else self._tolerance.smallest
        for g in pending.guards:
            if guards[g, GUARD_KIND] in (SLIP_GUARD, RATE_GUARD):
                constraint = constraints[guards[g, CONSTRAINT]]
                speed = float(np.linalg.norm(rates[list(constraint.tangents or (constraint.row,))]))
                if speed <= STILL_SHARE * max(of_step, SLOWEST) or self._tolerance is None:
                    found[int(guards[g, CONSTRAINT])] = HIT_SHARE * speed
        return found

    def _settle(self, t: float, news: _News) -> Decision:
        """Decide, and enter a mode whose guards are not against it at once.

        Where a bound has just been reached, the decision is made with what comes a little later.
        """
        before = self.mode.choice
        decision = self._decide(t, news)
        made = [decision]
        for share in AHEAD:
            if self._trouble:
                return decision
            self.mode = self.modes.enter(made[-1].choice, made[-1].directions)
            # the same mode as before would come to the same event with the same forces
            if made[-1].choice != before and self._holds():
                return made[-1]
            later = self._decide(t, news, share * self._usual_length)
            made.append(
                replace(later, hits=decision.hits, energy=decision.energy, rested=decision.rested)
            )
        for later in reversed(made):  # whose least forces do not obey the laws, but others do
            self.mode = self.modes.enter(later.choice, later.directions)
            self.mode.set_prestress(later.forces)
            if self._holds():
                return later
        return made[-1]

    def _holds(self) -> bool:
        """Whether the mode agrees with the state in the buffers."""
        struct, arrays = self.mode.data.struct, self.mode.arrays
        if evaluate_state(struct, 0.0, 0.0) != OK:
            self.mode.data.reraise()
            return False
        start_guards(struct)
        return bool(np.all(arrays.values >= -arrays.levels[:, THRESHOLD]))

    def _load(self, run: Run) -> None:
        """Write the run's state into the buffers, with the kinematics of all rows."""
        step, bare = run.stepping.step, self.modes.bare
        b, n, z = bare.arrays, bare.model.layout.joints, step.z
        b.position[:3], b.position[3:] = z[:3], step.base  # a chart begins at every step
        b.angles[:], b.twist[:], b.v[:] = z[6 : 6 + n], z[6 + n : 12 + n], z[12 + n : 12 + 2 * n]
        b.inner[:] = z[12 + 2 * n :][: b.inner.size]
        b.time.now, b.time.latest = run.clock.t, np.inf
        if update_kinematics(bare.struct) != OK:
            bare.reraise()
        update_rows(self.modes.full.struct)

    def _touching(self, pending: Pending) -> set[int]:
        """Units that touch at an event: those that were held, and those that came."""
        constraints, choice = self.modes.unilateral.constraints, self.mode.choice
        guards = self.mode.arrays.guards[pending.guards]
        came = {int(g[CONSTRAINT]) for g in guards if g[GUARD_KIND] != PATCH_GUARD}
        held = {
            u
            for u, constraint in enumerate(constraints)
            if choice.states[u] != 0 and constraint.kind != DRY_JOINT and not constraint.compliant
        }
        pressed = pressed_constraints(self.modes, choice, came)
        came = {
            u for u in came if constraints[u].kind != DRY_JOINT and not constraints[u].compliant
        }
        gaps = self.modes.full.arrays.contacts[:, GAP]
        sunk = max((abs(float(gaps[constraints[u].row])) for u in came - held), default=0.0)
        near = closed_constraints(self.modes, max(TOUCHING * self._size, HIT_SHARE * sunk))
        return near | came | held | pressed

    def _decide(self, t: float, news: _News, ahead: float = 0.0) -> Decision:
        self.modes.full.arrays.time.now = t
        decision = Transition(
            self.modes, news.touching, self._rest_height, news.at_rest, news.unloaded,
            news.beside, ahead,
        ).decide()  # fmt: skip
        self.residual = max(self.residual, decision.residual)
        self._trouble = decision.trouble
        return decision

    def _go_on(self, run: Run, decision: Decision, step) -> None:
        """Let the run go on in the new mode from the state in the buffers."""
        data = self.mode.data
        joints = data.model.layout.joints
        run.data = data
        if run.settings.closed >= 0.0 and project(data.struct, run.settings.closed) != OK:
            raise SolverError("the state could not be put on the contacts that closed")
        run.stepping = make_stepping(data, run.stepping.tableau.name, run.tolerance)
        new = run.stepping.step
        new.z[:] = step.z
        begin_chart(data.struct, new.base, new.z)
        if decision.energy:
            works = new.z[12 + 2 * joints + data.model.effects.states :]
            works[data.model.effects.slot("impacts")] += decision.energy
            works[-1] += decision.energy
        clock = run.clock
        length = max(SHORTER * self._last_length, 1e-12)
        if run.settings.adaptive:
            clock.h = min(max(clock.h, length), length)
        clock.error_before, clock.t_before, clock.h_before = 1.0, clock.t, 0.0
        run.settings = run.settings._replace(stop=np.inf)
        alpha, beta = gains(run.settings, run.settings.step)
        t = clock.t
        status = evaluate_slope(data.struct, t, new.z, new.base, alpha, beta, new.slope)
        if status != OK:
            data.reraise()
            raise SolverError(f"the motion after the event could not be evaluated ({status})")
        self.arm(run)

    def arm(self, run: Run) -> None:
        """Let the guards begin at the state in the buffers, which has been evaluated."""
        start_guards(run.data.struct)
        run.solver_log.settle(run.data)

    def _tell(self, t: float, decision: Decision, before: Choice) -> None:
        events = decision_events(self.modes, t, decision, before)
        self.count += len(events)
        self._log.add(events)

    def _crowded(self, t: float) -> None:
        """Give up where events come without end at one time."""
        if t - self._crowd_since > AT_ONCE * max(1.0, t):
            self._crowd, self._crowd_since = 0, t
        self._crowd += 1
        if self._crowd > MOST_AT_ONCE and not self._trouble:
            self._trouble = (
                f"{self._crowd} events at one time: contacts open and close without the motion "
                f"getting on; lessen restitution or friction, or start elsewhere"
            )
