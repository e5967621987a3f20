"""Impulse steps of a run: their lengths, and where they pause.

The length of a step is controlled as that of any other: the same time is made in one step and in
two, and the difference must meet the tolerance of the run.  A phase ends where a mode holds.  Where
the next one begins soon, the mode was one of a chatter that goes on: this phase lasts twice as long
before a mode is sought.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, field, replace

import numpy as np

from multiarm.contacts.unilateral import LIMIT
from multiarm.dynamics.coordinates import chart_places, difference
from multiarm.dynamics.data import Data
from multiarm.dynamics.solver.bounds import IMPACT_RESIDUAL
from multiarm.errors import SolverError
from multiarm.events.impulse_steps import ImpulseStep, ImpulseStepper, Point
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.integration.step_control import shortest_step
from multiarm.integration.time_loop import sample_time
from multiarm.notation import count_of
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import RunEvent
from multiarm.simulation.setup import Run

# The first step, as a part of the longest one that has led to an event.
FIRST_SHARE = 1e-3
# A step this short is made whatever its error: velocities jump within it [s].
SHORTEST = 1e-11
# Errors of velocities may be so many tolerances: they do not add up over a phase as those of smooth
# steps do, for which a tolerance is a tenth of the accuracy.
OF_VELOCITIES = 10.0
# A step changes by factors between these, to an error that is this part of the tolerance.
SHRINKS, GROWS, WANTED_ERROR = 0.25, 2.0, 0.5


@dataclass
class ImpulsePhase:
    """A time in which a run makes impulse steps.

    Attributes
    ----------
    stepper : ImpulseStepper
    length : float
        Of the next step [s].
    ended : Mode
        The one before it.
    begin, least : float
        When it began [s], and how long it is at least [s]: modes that hold before are not sought.
    steps : int
        So far.
    residual : float
        The largest one of these.
    hits : int
        How often a contact or stop pushed that had not pushed in the half step before.
    largest : dict
        The largest normal impulse of such a hit [N s, N m s], by constraint.
    """

    stepper: ImpulseStepper
    length: float
    ended: Mode
    begin: float
    least: float = 0.0
    steps: int = 0
    residual: float = 0.0
    hits: int = 0
    largest: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        states = enumerate(self.ended.states)
        self._pushing: Set[int] = {u for u, state in states if state != ContactState.OPEN}

    def lasts(self, t: float) -> bool:
        """Whether it goes on at a time [s] in any case."""
        return t < self.begin + self.least

    def step(self, run: Run, start: Point, until: float) -> ImpulseStep:
        """Make a step that is accurate enough, at most until a time [s], and then just to it.

        Raises
        ------
        SolverError
            When no impulses obey the contact laws, however short the step.
        """
        longest = run.settings.longest_step if run.settings.adaptive else run.clock.step
        while True:
            left = until - start.t
            h = min(self.length, left)
            whole = self.stepper.step(start, h) if run.settings.adaptive else None
            middle = self.stepper.step(start, 0.5 * h)
            end = self.stepper.step(middle.end, 0.5 * h)
            run.clock.evaluations += 6 if run.settings.adaptive else 4
            error = 0.0 if whole is None else _error(run, whole.end, end.end)
            solved = max(middle.residual, end.residual) < IMPACT_RESIDUAL
            if (error <= 1.0 and solved) or h <= max(SHORTEST, 4.0 * shortest_step(start.t)):
                if not solved:
                    raise SolverError("no impulses of contacts and stops obey the contact laws")
                if h == self.length:
                    self.length = min(_growth(error) * h, longest)
                self.steps += 1
                self.residual = max(self.residual, middle.residual, end.residual)
                self._count_hits(middle)
                self._count_hits(end)
                # rounded times of two halves may end before a sample, which would be left out
                return end if h < left else replace(end, end=replace(end.end, t=until))
            self.length = h * (_growth(error) if solved else SHRINKS)

    def event(self, modes: Modes, t: float) -> RunEvent:
        """The phase as an event of a run, at the time of its end [s]."""
        constraints, joints = modes.unilateral.constraints, modes.full.model.joint_units
        numbers: dict[str, float] = {"hits": self.hits}
        for u, impulse in self.largest.items():
            turns = constraints[u].kind == LIMIT and joints[constraints[u].joint] == "rad"
            name = f"largest_impulse_{'N_m_s' if turns else 'N_s'}"
            numbers[name] = max(numbers.get(name, 0.0), impulse)
        steps, time = count_of(self.steps, "impulse step"), t - self.begin
        words = f"{steps} over {time:.2g} s"
        return RunEvent(t, EventKind.CHATTERS, words, numbers=numbers)

    def _count_hits(self, step: ImpulseStep) -> None:
        new = step.impulses.keys() - self._pushing
        self.hits += len(new)
        for u in new:
            self.largest[u] = max(self.largest.get(u, 0.0), step.impulses[u])
        self._pushing = step.impulses.keys()


def point_of(data: Data, t: float, works: np.ndarray) -> Point:
    """The state in the data, at a time [s] and with works that have been done [J]."""
    state, states = data.arrays.state, data.arrays.effects.states
    return Point(t, state.configuration.copy(), state.velocity.copy(), states.copy(), works.copy())


def pause_of(run: Run) -> float:
    """The next time at which the loop has something to do [s]: a sample, a jump of a force.

    The present, where the run is at its end.
    """
    clock, settings = run.clock, run.settings
    times = [clock.end, clock.control_due]
    if clock.sample < clock.samples:
        times.append(float(sample_time(clock, settings, clock.sample)))
    times += settings.breakpoints.tolist()
    now = clock.t + shortest_step(clock.t)
    return min((time for time in times if time > now), default=clock.t)


def _growth(error: float) -> float:
    """The factor between the lengths of two steps: errors of jumps are proportional to them."""
    return min(max(WANTED_ERROR / max(error, 1e-3), SHRINKS), GROWS)


def _error(run: Run, whole: Point, halves: Point) -> float:
    """The difference of two ends, in units of the tolerances."""
    tolerances = run.stepping.step.tolerance
    places = chart_places(run.data.arrays)
    apart = difference(run.data.model.layout, whole.configuration, halves.configuration)
    of_places = np.max(np.abs(apart) / tolerances[: places.velocity], initial=0.0)
    later = np.concatenate([whole.velocity - halves.velocity, whole.states - halves.states])
    count = halves.velocity.size
    later /= tolerances[places.velocity :]
    later[:count] /= OF_VELOCITIES
    return float(max(of_places, np.max(np.abs(later), initial=0.0)))
