"""Event handling: the events of a run with unilateral contacts.

The loop returns when a guard has changed its sign inside a step, before that step is accepted.  The
time of the event is found on the step's dense output, and the loop continues up to it.  There
:mod:`multiarm.events` decides the next mode, whose rows are selected in the run's Data, and the run
continues with the same step.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from multiarm.assembly.start import TOUCHING
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.dynamics.arrays import CARRYING
from multiarm.dynamics.callbacks import ControlCallback
from multiarm.dynamics.coordinates import chart_places
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics, update_rows
from multiarm.dynamics.failures import failure_text, require_ok
from multiarm.dynamics.guard_functions import JointSpeed, PatchDepth, PushingForce, Slip
from multiarm.dynamics.guards import Guard, remember_scales
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.errors import MultiarmError, SolverError
from multiarm.events.complementarity import Verdict
from multiarm.events.consistent_mode import enter_consistent_mode
from multiarm.events.decision_events import decision_events, rest_event, switch_events
from multiarm.events.event_detection import (
    closed_constraints,
    off_patch_constraints,
    pressed_constraints,
    touching_constraints,
)
from multiarm.events.impulse_steps import ImpulseStep, ImpulseStepper
from multiarm.events.kernels import start_guards, write_mode_guards
from multiarm.events.mode import Mode
from multiarm.events.mode_guards import GAP_THRESHOLD
from multiarm.events.modes import IMPACTS, Modes
from multiarm.events.objects_at_rest import RestDetector
from multiarm.events.row_dynamics import RowDynamics
from multiarm.events.taking_hold import (
    Switch,
    hold_at,
    require_reach,
    require_slow_start,
    switch_joints,
)
from multiarm.events.transition import Decision, Participants, Transition
from multiarm.integration.event_location import GuardValues, first_event, load_step
from multiarm.integration.methods import make_stepping
from multiarm.integration.projection import project, project_positions
from multiarm.integration.step import begin_chart, write_slope
from multiarm.integration.step_control import PROJECTION, gains, shortest_step
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import EventLog, RunEvent
from multiarm.simulation.guard_log import watch_joints
from multiarm.simulation.impulse_phase import (
    FIRST_SHARE,
    SHORTEST,
    ImpulsePhase,
    pause_of,
    point_of,
)
from multiarm.simulation.joint_schedule import JointSchedule
from multiarm.simulation.setup import Run, Tolerance

# Gaps of contacts that have just closed are as small as the step's errors, times this factor.
HIT_SHARE = 4.0
# Events accumulate where so many come within this part of the longest step before them.
ACCUMULATED, ACCUMULATION = 20, 1e-2
JAMS = "no accelerations obey the contact laws (Painleve): an impulse without a collision"
# Impulse steps in a row, before progress is shown.
IMPULSE_STEPS = 100
# Slips slower than so many tolerances, which are the accuracy, are smoothed: errors of velocities
# within a step, too, are as large.
SMOOTHED = 10.0
# Smallest speed of slip with a direction of its own [m/s].
SLOWEST = 1e-9
# Acceleration of slips by friction, roughly [m/s^2].
SLIP_ACCELERATION = 10.0
# The first step after an event is at least so many of the shortest steps of a run.
FIRST_STEP = 10.0


@dataclass
class Pending:
    """The next event, at which the run will stop: its time and its guards."""

    time: float
    guards: list[int]


class EventHandler:
    """Modes and events of one run.

    Attributes
    ----------
    residual : float
        Largest residual of the complementarity problems.
    count : int
        Events so far.
    impulse_steps : int
    impulse_time : float
        That the impulse steps took [s].
    resting : frozenset of str
        Objects at rest.
    """

    def __init__(
        self,
        data: Data,
        tolerance: Tolerance | None,
        step: float | None,
        latest: float,
        log: EventLog,
        stops_at_painleve: bool,
    ):
        if tolerance is None:
            assert step is not None, "steps are either fixed or chosen"
            slow = SLIP_ACCELERATION * step  # the slip that begins in one step [m/s]
        else:
            # at late times, steps cannot follow the directions of slower ones
            late = SLIP_ACCELERATION * FIRST_STEP * shortest_step(latest)
            slow = max(SMOOTHED * tolerance.position, late)
        self.modes = Modes(data, max(slow, SLOWEST))
        self.residual = 0.0
        self.count = self.impulse_steps = 0
        self.impulse_time = 0.0
        self._log, self._stops_at_painleve = log, stops_at_painleve
        self._size = 1.0
        self._tolerance = tolerance
        self._rest_height = 0.0
        self._pending: Pending | None = None
        self._last_length = self._usual_length = 0.0
        self._times: deque[float] = deque(maxlen=ACCUMULATED)
        self._last_times: dict[int, float] = {}  # of the events of each constraint
        self._schedule = JointSchedule(self.modes.unilateral, 0.0)
        self._watched: frozenset[int] | None = None  # joints whose ranges are watched
        self._rest, self.resting = RestDetector(self.modes), frozenset[str]()
        self._phase: ImpulsePhase | None = None
        # of the last one: its end, the length of its steps, and how long it was
        self._phase_end, self._phase_length, self._phase_time = -np.inf, np.inf, 0.0

    @property
    def lost_grips(self) -> tuple[str, ...]:
        """Joints all of whose contacts are open, which laws of control take for closed."""
        modes, model = self.modes, self.modes.full.model
        if model.constants.control_reach < CARRYING:
            return ()
        seen = {*modes.unilateral.rows_held_by(modes.holding, modes.unilateral.of_laws)}
        pairs = zip(modes.unilateral.constraints, modes.mode.states, strict=True)
        states: dict[str, set[ContactState]] = {}
        for constraint, state in pairs:
            if constraint.row in seen:
                states.setdefault(constraint.owner, set()).add(state)
        return tuple(name for name, of_joint in states.items() if of_joint == {ContactState.OPEN})

    # --- beginning --------------------------------------------------------------------------------

    def begin(self, time: float, start: State, given: bool) -> tuple[Data, State | None]:
        """Data of the mode in which a run begins at a time [s], and its state after an impact.

        ``given``: the start is not the scene's.  None: the scene's start as it is.
        """
        layout = self.modes.full.model.layout
        twists = zip(layout.objects, layout.twists(start.velocity), strict=True)
        # what lies still at the start does not come to rest there
        self.resting = frozenset(name for name, twist in twists if not twist.any())
        self._schedule = schedule = JointSchedule(self.modes.unilateral, time)
        control = self.modes.full.callbacks.get("control")
        if isinstance(control, ControlCallback):
            control.listen(lambda: None)  # another run may have left commands
        for holding in schedule.foreseen():
            self.modes.prepare(holding)
        hold_at(self.modes, time, start, schedule.holding, schedule.awaited)
        touching, off_patch, self._size = touching_constraints(self.modes, time, start)
        require_slow_start(self.modes, time)
        of_step = None if self._tolerance is None else self._tolerance.smallest
        # lower bounces are not followed: below the tolerance of a step, or too low for the guards
        height = 1e-9 * self._size if of_step is None else of_step
        self._rest_height = max(height, 4.0 * GAP_THRESHOLD)
        participants = Participants(touching, off_patch=off_patch)
        decision, _ = enter_consistent_mode(self.modes, self._decide(time, participants))
        jams = self._jams(decision)
        if jams:
            self._jam(time, participants)
            again, _ = enter_consistent_mode(self.modes, self._decide(time, participants))
            decision = replace(again, hits=decision.hits + again.hits)
        self._log_decision(time, decision, Mode((), ()))
        if decision.undecided:
            raise SolverError(f"at the start: {decision.undecided.message}")
        # the scene's start is that of the joints that hold at 0 s
        elsewhere = schedule.holding != self.modes.unilateral.holding_at(0.0)
        changed = decision.hits or given or jams or elsewhere
        return self.modes.data, self.modes.data.get_state() if changed else None

    def _jams(self, decision: Decision) -> bool:
        """Whether no accelerations obey the contact laws, and an impulse is to follow."""
        return (
            decision.undecided is not None
            and decision.undecided.verdict is Verdict.NONE
            and not self._stops_at_painleve
        )

    def _jam(self, time: float, participants: Participants) -> None:
        """Give the state in the data the velocity after an impulse without a collision."""
        data = self.modes.bilateral
        start = point_of(data, time, np.zeros(data.arrays.effects.power.size))
        stepper = ImpulseStepper(self.modes, participants.off_patch, participants.touching)
        stepper.put(replace(start, velocity=stepper.step(start, SHORTEST).end.velocity))
        self._log.add(RunEvent(time, EventKind.JAMS, JAMS))

    # --- events -----------------------------------------------------------------------------------

    def handle(self, run: Run, stopped: bool) -> str:
        """Locate an event, or decide the next mode where the run has ``stopped`` at one.

        Returns why the run cannot go on past it, with the remedy; empty where it goes on.
        """
        try:
            if self._phase is not None and self._schedule.joints_due(run.clock.t):
                self._end_phase(run, self._phase)
            if self._phase is not None:
                self._load(run)
                return self._make_impulse_steps(run, self._phase)
            if not stopped:
                return self.locate(run)
            if self._pending:
                return self.cross(run)
            self._load(run)
            return self._switch(run)
        except MultiarmError as error:
            return str(error)

    def locate(self, run: Run) -> str:
        """Locate the first event in the last step, and let the loop stop there."""
        numbers, guards, t = self.modes.numbers, self.modes.guards, run.clock.t
        begin, end = numbers.begin, numbers.end
        probe = GuardValues(
            run.data.struct, run.stepping.struct, write_mode_guards, guards, begin, end
        )
        theta, changed = first_event(probe, guards.result.copy(), guards.level.copy())
        numbers.muted = True
        if not changed:  # no root: the step is repeated and accepted
            return ""
        self._last_length = end - begin
        self._usual_length = max(self._usual_length, end - begin)
        time = begin + theta * (end - begin)
        self._pending = Pending(time, changed)
        if time - t <= max(1e-13, shortest_step(t)):
            return self.cross(run)
        run.clock.stop = time
        return ""

    def forget_pending(self, run: Run) -> None:
        """Forget the event that was located: the run does not come to it."""
        self._pending, self._phase, self.modes.numbers.muted = None, None, False
        self.stop_at_switch(run)

    def cross(self, run: Run) -> str:
        """Decide the next mode at the event where the run has stopped; returns why it must end."""
        assert self._pending is not None, "the run stops at an event"
        pending, self._pending = self._pending, None
        before = self.modes.mode
        come = [k for k, _ in self.modes.moments_of(pending.guards)]
        self._schedule.due.update(come)
        self._load(run)
        if len(come) == len(pending.guards):
            return self._switch(run)
        fired = [self.modes.watched[g] for g in pending.guards]
        participants = Participants(
            self._touching(fired),
            self._at_rest(fired),
            _constraints(fired, PushingForce),
            off_patch_constraints(self.modes, before, _constraints(fired, PatchDepth)),
        )
        return self._go_on(run, participants, before)

    def _go_on(
        self, run: Run, participants: Participants, before: Mode, switch: Switch | None = None
    ) -> str:
        """Decide the next mode at the state in the data; returns why the run must end."""
        t = run.clock.t
        decision = self._decide(t, participants)
        if switch is not None:
            self._log_events(switch_events(self.modes, t, switch, decision))
        self._add_work(run, decision.energy)
        ended = before if before.holding == self.modes.holding else None
        decision, holds = enter_consistent_mode(self.modes, decision, ended)
        if holds and not self._accumulate(t, _changed(decision, before)):
            self._log_decision(t, decision, before)
            self._continue(run)
            return ""
        if self._jams(decision):
            self._log.add(RunEvent(t, EventKind.JAMS, JAMS))
        elif decision.undecided and decision.undecided.verdict is Verdict.NONE:
            return decision.undecided.message
        if decision.hits and not decision.undecided:
            self._log_decision(t, decision, before)
            before = decision.mode
        length, least = FIRST_SHARE * self._usual_length, 0.0
        if t - self._phase_end < self._usual_length:  # the same chatter goes on
            length = min(length, 4.0 * self._phase_length)
            least = min(2.0 * self._phase_time, self._usual_length)
        stepper = ImpulseStepper(self.modes, participants.off_patch, participants.touching)
        self._phase = ImpulsePhase(stepper, length, before, t, least)
        return self._make_impulse_steps(run, self._phase)

    # --- timed joints -----------------------------------------------------------------------------

    def command(self, run: Run, joint: int) -> str:
        """Let a timed joint that holds let go, and one that does not take hold.

        Returns why the run cannot go on then; empty where it can.

        Raises
        ------
        SolverError
            Where the joint cannot take hold here; the run is as it was.
        """
        self._load(run)
        if joint not in self.modes.holding:
            require_reach(self.modes, joint)
        self._schedule.due.add(joint)
        try:
            return self._switch(run)
        except MultiarmError as error:
            return str(error)

    def _hear(self, run: Run, control: ControlCallback) -> None:
        """Take the commands of a controller; those that say what is so already change nothing."""
        names = [joint.connection for joint in self.modes.unilateral.timed]
        for name, holds in control.commands:
            k = names.index(name)
            if (k in self.modes.holding) == holds:
                self._schedule.due.discard(k)
            else:
                self._schedule.due.add(k)
        control.commands.clear()
        self.stop_at_switch(run)

    def _switch(self, run: Run) -> str:
        """Let the joints whose moment has come take hold, or let go, at the state in the data."""
        modes, t, before = self.modes, run.clock.t, self.modes.mode
        due = self._schedule.joints_due(t)
        for k in due:
            self._schedule.pass_moment(k, t)
        self._last_length = run.clock.h
        self._usual_length = max(self._usual_length, run.clock.h)
        switch = switch_joints(modes, self._schedule.holding, self._schedule.awaited)
        if switch.impact is not None:
            self._add_work(run, -switch.impact.energy_lost)
        off_patch = off_patch_constraints(modes, before, set())
        participants = Participants(self._touching([]), off_patch=off_patch, elastic=False)
        return self._go_on(run, participants, before, switch)

    def stop_at_switch(self, run: Run) -> None:
        """Let the loop stop where the next joint is switched, or at an event before.

        It does not get on by itself in impulse steps.
        """
        if self._phase is not None:
            run.clock.stop = run.clock.t
            return
        clock, due = run.clock, self._schedule.next_time(run.clock.t)
        for near in (clock.end, clock.t):  # no step would lead from one to the other
            if abs(due - near) <= 2.0 * shortest_step(near):
                due = near
        clock.stop = min(due, math.inf if self._pending is None else self._pending.time)

    # --- impulse steps ----------------------------------------------------------------------------

    def _make_impulse_steps(self, run: Run, phase: ImpulsePhase) -> str:
        """Go on in impulse steps until a mode holds, or the loop has something to do."""
        until, begin = min(pause_of(run), self._schedule.next_time(run.clock.t)), run.clock.t
        first = phase.steps
        while run.clock.t < until and phase.steps - first < IMPULSE_STEPS:
            start = point_of(run.data, run.clock.t, self._works(run))
            step = phase.step(run, start, until)
            self._take(run, step, phase.stepper.mode_after(step))
            lasts = phase.lasts(run.clock.t)
            # what is written at a pause needs a mode whose forces obey the laws
            if (run.clock.t >= until or not lasts) and self._hold(run, step) and not lasts:
                self._end_phase(run, phase)
                self._log_rest(run.clock.t)
                break
            run.clock.stop = run.clock.t  # there the loop returns when it has written what is due
        self.impulse_steps += phase.steps - first
        self.residual = max(self.residual, phase.residual)
        self.impulse_time += run.clock.t - begin
        return ""

    def _end_phase(self, run: Run, phase: ImpulsePhase) -> None:
        """Log what the constraints do after impulse steps; ``phase`` is over."""
        t = run.clock.t
        self._log_decision(t, Decision(self.modes.mode, {}, 0.0), phase.ended)
        if phase.steps > 1:  # one only told which mode follows
            self._log.add(phase.event(self.modes, t))
        self._phase, self._phase_end, self._phase_length = None, t, phase.length
        self._phase_time = t - phase.begin
        self.stop_at_switch(run)

    def _take(self, run: Run, step: ImpulseStep, mode: Mode) -> None:
        """Continue from the end of an impulse step in a mode."""
        run.clock.t = step.end.t
        self._works(run)[:] = step.end.works
        self._close_gaps(run, mode)
        self.modes.enter(mode)
        self._continue(run)

    def _hold(self, run: Run, step: ImpulseStep) -> bool:
        """Whether the mode after an impulse step holds, or another one that is entered for it."""
        if not self.modes.contradicted:
            return True
        self._load(run)
        mode = self.modes.mode
        participants = Participants(step.touching, off_patch=mode.off_patch)
        decision = self._decide(run.clock.t, participants)
        self._add_work(run, decision.energy)
        decision, holds = enter_consistent_mode(self.modes, decision)
        if decision.undecided:
            self.modes.enter(mode)
        self._continue(run)
        return holds

    def _close_gaps(self, run: Run, mode: Mode) -> None:
        """Let contacts that open begin where they are closed, not as deep as the step left them."""
        gaps, constraints = self.modes.full.contact_rows.gap, self.modes.unilateral.constraints
        deep = [
            constraint.row
            for u, constraint in enumerate(constraints)
            if mode.states[u] == ContactState.OPEN
            and not constraint.compliant
            and u not in mode.off_patch
            and -TOUCHING * self._size < gaps[constraint.row] < 0.0
        ]
        if deep and run.settings.stabilization == PROJECTION:
            self.modes.enter(replace(mode, rows=tuple(sorted([*mode.rows, *deep]))))
            gap = run.settings.gap_tolerance
            require_ok(run.data, project_positions(run.data.struct, gap, False, 0.5, 12))

    def _at_rest(self, fired: list[Guard]) -> dict[int, float]:
        """Speeds [m/s] of constraints whose slip has just come to rest, times ``HIT_SHARE``."""
        constraints = self.modes.unilateral.constraints
        rates, speeds = self.modes.full.contact_rows.gap_rate, {}
        of_step = SLOWEST if self._tolerance is None else self._tolerance.smallest
        for u in _constraints(fired, Slip, JointSpeed):
            constraint = constraints[u]
            speed = float(np.linalg.norm(rates[list(constraint.tangents or (constraint.row,))]))
            # faster slip has only turned around
            if speed <= 1e3 * max(of_step, SLOWEST) or self._tolerance is None:
                speeds[u] = HIT_SHARE * speed
        return speeds

    @staticmethod
    def _works(run: Run) -> np.ndarray:
        """The works at the beginning of the run's next step [J], to be read and written."""
        return run.stepping.step.z[chart_places(run.data.arrays).works :]

    def _load(self, run: Run) -> None:
        """Write the run's state into the modes' data, with the kinematics of all rows."""
        step, bilateral = run.stepping.step, self.modes.bilateral
        load_step(bilateral.struct, step.z, step.base)
        bilateral.arrays.time.now = run.clock.t
        require_ok(bilateral, update_kinematics(bilateral.struct))
        require_ok(self.modes.full, update_rows(self.modes.full.struct))

    def _touching(self, fired: list[Guard]) -> set[int]:
        """Constraints that touch at an event: those that were closed, and those that close."""
        constraints, mode = self.modes.unilateral.constraints, self.modes.mode
        closing = {g.constraint for g in fired if not isinstance(g.function, PatchDepth)}
        closed = {
            u
            for u, constraint in enumerate(constraints)
            if mode.states[u] != ContactState.OPEN
            and constraint.kind != DRY_JOINT
            and not constraint.compliant
        }
        pressed = pressed_constraints(self.modes, mode, closing)
        closing = {
            u for u in closing if constraints[u].kind != DRY_JOINT and not constraints[u].compliant
        }
        gaps = self.modes.full.contact_rows.gap
        depth = max((abs(float(gaps[constraints[u].row])) for u in closing - closed), default=0.0)
        near = closed_constraints(self.modes, max(TOUCHING * self._size, HIT_SHARE * depth))
        return near | closing | closed | pressed

    def _decide(self, t: float, participants: Participants) -> Decision:
        """Decide at the state in the data, whose velocity an impact changes."""
        self.modes.full.arrays.time.now = t
        decision = Transition(self.modes, participants, self._rest_height).decide()
        self.residual = max(self.residual, decision.residual)
        return decision

    def _add_work(self, run: Run, energy: float) -> None:
        """Count energy [J] among the works of impacts."""
        if energy:
            works = self._works(run)
            works[self.modes.full.model.effects.slot(IMPACTS)] += energy
            works[-1] += energy

    def _continue(self, run: Run) -> None:
        """Continue the run in the new mode, from the state in its data."""
        data, clock, settings = run.data, run.clock, run.settings
        if run.stepping.work:  # these arrays have entries for the rows of a mode
            run.continue_with(make_stepping(data, run.stepping.tableau))
        step = run.stepping.step
        projects = settings.stabilization == PROJECTION
        if projects and project(data.struct, settings.gap_tolerance) != OK:
            data.reraise()
            raise SolverError("the state could not be put on the contacts that closed")
        begin_chart(data.struct, step.base, step.z)
        length = max(0.5 * self._last_length, 1e-12)  # the motion may have changed
        if settings.adaptive:
            clock.h = length
        clock.begin_after_event()
        step.stage.begin()
        step.stage.alpha, step.stage.beta = gains(settings, clock.step)
        status = write_slope(run.stepping.struct, clock.t, step.z, step.slope)
        if status != OK:
            data.reraise()
            raise SolverError(f"the motion after the event: {failure_text(data, status)}")
        self.arm(run)

    def arm(self, run: Run) -> None:
        """Start the guards at the state in the data, which has been evaluated."""
        if run.settings.adaptive:
            shortest = FIRST_STEP * shortest_step(run.clock.t)
            run.clock.h = min(run.clock.h, max(self._first_step(), shortest))
        require_ok(run.data, start_guards(run.data.struct))
        remember_scales(self.modes.guards)
        run.solver_log.reset(run.data)
        control = run.data.callbacks.get("control")
        if isinstance(control, ControlCallback):
            self._hear(run, control)
            control.listen(partial(self._hear, run, control))
        if self._watched != self.modes.holding:
            self._watched, timed = self.modes.holding, self.modes.unilateral.timed
            idle = {j.connection for k, j in enumerate(timed) if k not in self._watched}
            watch_joints(run.data, self.modes.full.model, idle, run.clock.t, self._log)
        passed = np.flatnonzero(~(self.modes.guards.value > 0.0)).tolist()
        self._schedule.due.update(k for k, _ in self.modes.moments_of(passed))
        self.stop_at_switch(run)
        if self._phase is None:
            self._log_rest(run.clock.t)

    def _first_step(self) -> float:
        """Longest step from the evaluated state in the data that follows directions of slips [s].

        Velocities orthogonal to a slip s decay at the rate ``mu a_n / |s|``; where it is slow, a
        step that is much longer enlarges roundings of them to the size of the slip.
        """
        modes, slides, tangents = self.modes, self.modes.slides, self.modes.data.tangents
        if tangents is None or not slides.row.size:
            return math.inf
        rows, sliding = RowDynamics(modes), modes.mode.sliding(modes.unilateral.constraints)
        friction = np.abs(slides.mu * modes.data.arrays.rows.force[slides.row])
        mobility = rows.mobility(rows.jacobian([*tangents.rows])).reshape(-1, 2).max(axis=1)
        speeds = np.linalg.norm(tangents.contact_rows.gap_rate.reshape(-1, 2), axis=1)
        changes = friction * mobility
        # those at the bound of friction are held at rest by others
        slips = [modes.mode.states[u] == ContactState.SLIDING for u in sliding]
        turning = np.array(slips) & (changes > 0.0)
        steps = np.maximum(speeds[turning], modes.slow) / changes[turning]
        return float(np.min(steps, initial=math.inf))

    def _log_events(self, events: list[RunEvent]) -> None:
        self.count += len(events)
        self._log.add(*events)

    def _log_decision(self, t: float, decision: Decision, before: Mode) -> None:
        self._log_events(decision_events(self.modes, t, decision, before))
        was = before.states or (ContactState.OPEN,) * len(decision.mode.states)
        self._schedule.touched(
            u
            for u, now in enumerate(decision.mode.states)
            if was[u] == ContactState.OPEN != now or u in {hit.constraint for hit in decision.hits}
        )

    def _log_rest(self, t: float) -> None:
        """Log the objects that rest from now on, at the evaluated state in the data."""
        supports = self._rest.supports()
        new = supports.keys() - self.resting
        self.resting = frozenset(supports)
        self._log.add(
            *(rest_event(self.modes, t, name, on) for name, on in supports.items() if name in new)
        )

    def _accumulate(self, t: float, changed: set[int]) -> bool:
        """Count an event that has changed some constraints; whether the last ones would not end.

        They come fast, of the same constraints again and again.  So does one within an impulse step
        after the last of these.
        """
        window = ACCUMULATION * self._usual_length
        if not changed or any(t - self._last_times.get(u, -math.inf) < window for u in changed):
            self._times.append(t)
        self._last_times.update(dict.fromkeys(changed, t))
        if t - self._phase_end < self._phase_length < np.inf:
            return True
        return len(self._times) == ACCUMULATED and t - self._times[0] < window


def _changed(decision: Decision, before: Mode) -> set[int]:
    """Constraints that do something else than before, or have hit."""
    pairs = enumerate(zip(before.states, decision.mode.states, strict=False))
    return {u for u, (was, now) in pairs if was != now} | {hit.constraint for hit in decision.hits}


def _constraints(guards: list[Guard], *functions: type) -> set[int]:
    """Constraints whose guards have some of the functions."""
    return {guard.constraint for guard in guards if isinstance(guard.function, functions)}
