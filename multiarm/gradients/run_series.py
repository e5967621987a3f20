"""A run as a function of time: series of its states.

The run itself is :func:`multiarm.simulate`'s, which gives samples at any times without changing its
steps.  It is sampled at the nodes of series over panels (:mod:`multiarm.gradients.interpolation`).
Where a series of the highest degree is not the motion to the accuracy of the run, the panel is
divided, and the run repeated.

A run differs from the exact motion by an error that grows as motions separate.  A *comparison run*
starts from the same state, with a tenth of the tolerance: their difference is about the error of
the first as long as it is small, and as large as the motion itself where no digit is right.

Panels end where timed joints take hold or let go.  A run's sample there is that before the switch;
what follows it (:mod:`multiarm.gradients.switches`) takes the place of samples so shortly after it
that the loop over time counts them as before.  Where functions tell when joints switch, the
comparison run does so at slightly other times: its times are those of the run, stretched between
one switch and the next.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.gradients.course import phases, switch_events, unlike
from multiarm.gradients.interpolation import Series, nodes
from multiarm.gradients.phase import Phase
from multiarm.gradients.segments import SHORTEST, Panel
from multiarm.gradients.switches import SOON, Switched
from multiarm.gradients.variational_equation import displaced
from multiarm.results.outcome import RunStatus
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.setup import SMALLEST_TOLERANCE
from multiarm.simulation.simulate import simulate

# Longest panels [s], the degree of their series, and the number of parts of one that is divided.
LONGEST, DEGREE, PARTS = 0.5, 64, 4
# Where the parts of a panel do not have defects smaller by this factor, noise of the run is left.
SMOOTHER = 0.5
# Defects above this multiple of the accuracy are no noise, but a motion too sharp for the panel,
# which is divided again; with so many panels all of the run is rough.
SHARP, MOST_PANELS = 1e3, 500
# Accuracy of the comparison run, as part of the run's.  Runs with less than the second have the
# smallest tolerances already, and their comparison runs err ten times as much.
SHARPER, SHARPEST = 0.1, 100.0 * SMALLEST_TOLERANCE


class TimedState(NamedTuple):
    """A state at a time [s]."""

    time: float
    state: State


class ComparisonRun(NamedTuple):
    """Times and states of the comparison run, by the times of the run, and its phases."""

    states: dict[float, TimedState]
    phases: list[Phase]


class RunSeries:
    """A run.

    Parameters
    ----------
    system : System
    begin, end : float
        [s]
    accuracy : float
        Of the run, and of the series [m, rad].
    start : State or None
        None: the scene's.
    bounds : ndarray
        Further times at which states are wanted [s].

    Attributes
    ----------
    panels : list of Panel
        Without a time inside at which control or loads are not smooth.
    trajectory : Trajectory
        The run, sampled at the nodes of the panels and at the bounds.
    phases : list of Phase
        What timed joints do, between one switch and the next.

    Raises
    ------
    SolverError
        When the run ends early, or contacts open, close or slide in it.
    """

    trajectory: Trajectory
    phases: list[Phase]

    def __init__(
        self,
        system: System,
        begin: float,
        end: float,
        accuracy: float,
        start: State | None,
        bounds: np.ndarray,
    ) -> None:
        self._system, self._layout, self._accuracy = system, system.model.layout, accuracy
        self._start, self._begin, self._end = start, begin, end
        self._switches = self._switch_times(accuracy)
        self._bounds = {begin, end, *bounds.tolist(), *self._switches}
        rough = np.array([*system.model.breakpoints, *self._switches])
        inner = rough[(rough > begin) & (rough < end)]
        self.panels = _divided(np.unique([begin, end, *inner]))
        shortest, before = SHORTEST * (end - begin), dict.fromkeys(self.panels, math.inf)
        while True:
            self._run()
            panels: list[Panel] = []
            for panel, series in zip(self.panels, self._series, strict=True):
                defect = series.defect.max()
                smooth = defect <= accuracy or panel.length < shortest
                noisy = defect > SMOOTHER * before[panel]
                sharp = defect > SHARP * accuracy and len(self.panels) < MOST_PANELS
                if smooth or (noisy and not sharp):
                    panels.append(panel)
                else:
                    before |= dict.fromkeys(panel.parts(PARTS), defect)
                    panels += panel.parts(PARTS)
            if len(panels) == len(self.panels):
                break
            self.panels = panels
        self._begins = [panel.begin for panel in self.panels]

    def state(self, t: float) -> State:
        """The state at a bound, or at the ends of the run."""
        return self._at_bounds[t]

    def states(self, times: list[float]) -> list[State]:
        """The states at some times within one panel."""
        numbers, _ = self.series(times[0]).at(times)
        layout = self._layout
        for poses in (layout.poses(numbers), layout.base_poses(numbers)):
            poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
        return [self._state(row) for row in numbers]

    def series(self, t: float) -> Series:
        """Positions and velocities, one after the other, on the panel of a time."""
        return self._series[max(bisect_right(self._begins, t) - 1, 0)]

    def comparison_run(self, times: list[float]) -> ComparisonRun:
        """States of the comparison run at some times, and at the bounds and ends of the run."""
        sharper = SHARPER if self._accuracy > SHARPEST else 1.0 / SHARPER
        accuracy, wanted = sharper * self._accuracy, np.unique([*times, *self._bounds])
        switches = self._switch_times(accuracy)
        if len(switches) != len(self._switches):
            raise unlike()
        at = wanted
        if switches != self._switches:
            of_run, moved = ([self._begin, *ts, self._end] for ts in (self._switches, switches))
            at = np.interp(wanted, of_run, moved)
        _, numbers, course = self._simulated(accuracy, at.tolist(), self.phases)
        pairs = zip(wanted.tolist(), at.tolist(), strict=True)
        return ComparisonRun(
            {t: TimedState(moved, self._state(numbers[moved])) for t, moved in pairs}, course
        )

    def _run(self) -> None:
        """Run to all nodes."""
        at = [nodes(*panel, DEGREE) for panel in self.panels]
        times = [*self._bounds, *chain.from_iterable(at)]
        self.trajectory, numbers, self.phases = self._simulated(self._accuracy, times)
        self._at_bounds = {t: self._state(numbers[t]) for t in self._bounds}
        self._series = [
            Series(*panel, np.array([numbers[t] for t in times]))
            for panel, times in zip(self.panels, at, strict=True)
        ]

    def _switch_times(self, accuracy: float) -> list[float]:
        """When timed joints may take hold and let go within a run of some accuracy [s]."""
        unilateral = self._system.model.unilateral
        if unilateral is None or not unilateral.timed:
            return []
        moments = {m for joint in unilateral.timed for m in joint.moments if isinstance(m, float)}
        if unilateral.has_functions:
            run = self._trajectory(accuracy, [self._end])
            moments |= {event["time"] for event in switch_events(run)}
        return sorted(t for t in moments if self._begin < t < self._end)

    def _trajectory(self, accuracy: float, times: list[float]) -> Trajectory:
        """A run of some accuracy, sampled at some times."""
        run = simulate(
            self._system,
            self._end - self._begin,
            accuracy=accuracy,
            state=self._start,
            start_time=self._begin,
            output_times=np.unique(times),
            certificate=False,
        )
        if run.status != RunStatus.COMPLETED:
            raise SolverError(f"the run that is differentiated did not end well: {run.message}")
        _refuse_events(run)
        return run

    def _simulated(
        self, accuracy: float, times: list[float], like: Sequence[Phase] = ()
    ) -> tuple[Trajectory, dict[float, np.ndarray], list[Phase]]:
        """A run of some accuracy, with its phases; ``like`` are those of a run nearby.

        Its positions and velocities, one after the other, at some times, among them its switches.
        """
        run = self._trajectory(accuracy, times)
        at, numbers = np.unique(times), np.hstack(_states_of(run, self._layout))

        def before(t: float) -> State:
            return self._state(numbers[int(np.abs(at - t).argmin())])

        course = phases(self._system, run, self._begin, before, like)
        for phase in course:
            if not isinstance(phase, Switched):
                continue
            for k in np.flatnonzero((at > phase.time) & (at <= phase.time + SOON)):
                later = displaced(phase.after.state, (at[k] - phase.time) * phase.rate_after)
                numbers[k] = np.concatenate([later.position, later.velocity])
        return run, dict(zip(at.tolist(), numbers, strict=True)), course

    def _state(self, numbers: np.ndarray) -> State:
        nq = self._layout.nq
        return State(numbers[:nq], numbers[nq:], self._layout)


def _states_of(run: Trajectory, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and velocities at the samples of a run, (samples, nq) and (samples, nv)."""
    positions, velocities = np.zeros((len(run), layout.nq)), np.zeros((len(run), layout.nv))
    for o, moving in enumerate(run.objects.values()):
        layout.poses(positions)[:, o] = np.hstack([moving.position, moving.quaternion_xyzw])
        layout.twists(velocities)[:, o] = moving.twist
    for joints, by_robot in (
        (layout.joint_positions(positions), run.joint_positions),
        (layout.joint_rates(velocities), run.joint_velocities),
    ):
        for name, of_robot in layout.split_joints(joints).items():
            of_robot[:] = by_robot[name]
    twists = layout.split_bases(layout.joint_rates(velocities))
    for b, (name, twist) in enumerate(twists.items()):
        base = run.bases[name]
        layout.base_poses(positions)[:, b] = np.hstack([base.position, base.quaternion_xyzw])
        twist[:] = base.twist
    return positions, velocities


def _refuse_events(run: Trajectory) -> None:
    if run.statistics.get("contact_events", 0) > len(switch_events(run)):
        first = next(event for event in run.events if "before" in event)
        raise SolverError(
            f"derivatives of a run: contacts or joints open, close or slide in it, and the "
            f"motion beyond depends on when ({first['text']} at t = {first['time']:.6g} s); end "
            f"the run before, or keep them closed"
        )


def _divided(times: np.ndarray) -> list[Panel]:
    """Equal panels between each time and the next, none too long."""
    panels = []
    for begin, end in pairwise(times.tolist()):
        panels += Panel(begin, end).parts(max(1, math.ceil((end - begin) / LONGEST * (1 - 1e-9))))
    return panels
