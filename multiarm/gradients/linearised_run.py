r"""A run with its variational equation, as a function of time.

The run is a function of time (:mod:`multiarm.gradients.run_series`), which is divided into
segments, without a time inside at which control or loads are not smooth.  The matrices of the
variational equation (:mod:`multiarm.gradients.variational_equation`) are evaluated at the nodes of
a segment, and are series between them (:mod:`multiarm.gradients.interpolation`): how many
evaluations that takes depends on how fast the posture changes, not on how fast motions die out.
Segments are planned from the series of the velocities.  The equation itself is solved over panels
of the segments (:mod:`multiarm.gradients.segments`).  Errors of both are carried along with the
result.  Segments that contribute too much get more nodes, or are divided.

*The run's own error* changes the derivatives, too, the more the faster motions separate.  The
equation is therefore solved once more along a comparison run
(:mod:`multiarm.gradients.run_series`), over the same segments, with matrices evaluated at few nodes
of each.  How much the result differs is added to the error.

*Memory.*  Series of the states stay in memory, and the matrices of one segment at a time; those of
all segments too, as long as they have at most ``MOST_KEPT`` numbers.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from itertools import chain
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from multiarm.dynamics.layout import Layout
from multiarm.dynamics.sensitivity import Derivatives
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SceneError, SolverError
from multiarm.events.derivatives import derivatives_while
from multiarm.gradients.course import first_phase
from multiarm.gradients.interpolation import DEGREES, Series, nodes
from multiarm.gradients.phase import Phase
from multiarm.gradients.run_series import ComparisonRun, RunSeries
from multiarm.gradients.segments import LESSENED, SHORTEST, Panel, Segment
from multiarm.gradients.switch_times import SwitchTime, is_switch_time
from multiarm.gradients.switches import Jump, Slope, Switched
from multiarm.gradients.variational_equation import (
    Parameter,
    VariationalEquation,
    gap_roundings,
    state_matrices,
)
from multiarm.results.trajectory import Trajectory
from multiarm.scene.changes import value_at
from multiarm.scene.run import DEFAULT_ACCURACY
from multiarm.simulation.setup import positive
from multiarm.terminal.progress import Report
from multiarm.threads import one_thread

# The smallest relative error that is aimed at: evaluations are differentiated to about 1e-10.
FINEST = 1e-8
# Numbers of all matrices that are kept, at nodes and of segments.
MOST_KEPT = 3e7
MOST_ROUNDS = 12
# Derivatives with a larger relative error are of no use.
USELESS = 1e-2
# The degree of a series of differences between the two runs: this part of the segment's, and least.
COARSER, LOWEST = 8, 2
# With fewer digits than the first a result says so, unless its error is the one that was asked for
# or not much larger.
FEW, EXPECTED = 3, 100.0
EPSILON = float(np.finfo(float).eps)
# How much larger the last terms of a series of the matrices are than those of the velocities.
ROUGHER = 100.0
# Series are refined at once when they alone may make an error of so many times the tolerance.
COARSE = 10.0

Done = Callable[[int], None]
Parameters = Sequence[str] | Mapping[str, float | None]


class Solution(Protocol):
    """A solution over all segments: of the variational equation, or of its adjoint."""

    @property
    def error(self) -> float:
        """Its estimated error, relative to its size."""
        ...

    @property
    def segment_errors(self) -> np.ndarray:
        """Of every segment's series, relative to the whole."""
        ...

    def difference(self: AnySolution, comparison: AnySolution) -> float:
        """How much it differs from that along the comparison run, relative to its size."""
        ...


class Linearisation(Protocol):
    """The run, or its comparison run, with its variational equation."""

    def segment(self, k: int) -> Segment:
        """A segment with its matrices."""
        ...

    def state(self, t: float) -> State:
        """The state at a bound, or at the ends of the run."""
        ...

    def jump(self, k: int) -> Jump | None:
        """How displacements jump from the end of a segment to the next one; None: they do not."""
        ...


AnySolution = TypeVar("AnySolution", bound=Solution)


class Quality(NamedTuple):
    """How exact the derivatives of a run are, see :class:`multiarm.gradients.gradient.Gradient`."""

    error: float
    digits: int
    message: str


class LinearisedRun:
    """A run with its variational equation.

    Parameters
    ----------
    system : System
    begin, end : float
        [s]
    accuracy : float or None
        Of the run; None: the scene's.
    start : State or None
        None: the scene's.
    parameters : sequence of str, or mapping str -> float or None
        Paths of numbers of the scene, with sizes.
    bounds : ndarray
        Times at which the solution is wanted [s].
    integrand : callable, optional
        ``f(t, state)`` and its derivatives.

    Attributes
    ----------
    tolerance, panel_tolerance : float
        Relative error of the derivatives; relative errors of all panels together.
    start_by_parameters : ndarray, shape (D, P)
        The derivatives of the start by the parameters.

    Raises
    ------
    SolverError
        When the run has no derivatives of this kind, or ends early.
    SceneError
        When a parameter cannot be used.
    """

    def __init__(
        self,
        system: System,
        begin: float,
        end: float,
        accuracy: float | None,
        start: State | None,
        parameters: Parameters,
        bounds: np.ndarray,
        integrand: Slope | None = None,
    ) -> None:
        _refuse(system)
        self.system, self.begin, self.end = system, begin, end
        self.bounds, self._integrand = bounds, integrand
        self._start = start
        written = system.scene.run.accuracy
        of_scene = DEFAULT_ACCURACY if written is None else written.smallest
        wanted = of_scene if accuracy is None else positive("accuracy", accuracy)
        self._accuracy, self.tolerance = wanted, max(wanted, FINEST)
        self.panel_tolerance = self.tolerance
        if isinstance(parameters, str):
            raise SceneError(f"parameters: expected a list of paths, such as [{parameters!r}]")
        sizes = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
        self.parameters = [
            _parameter(system, path, size, begin, end) for path, size in sizes.items()
        ]
        self._segments: list[tuple[Panel, int]] = []
        first = first_phase(system, begin)
        of_start = [parameter.of_start(begin, start, first) for parameter in self.parameters]
        self.start_by_parameters = np.reshape(of_start, (-1, self.size)).T
        self._values: dict[tuple[float, Phase], VariationalEquation] = {}
        self._built: dict[tuple[Panel, int], Segment] = {}
        # of segments: the defects of their series, and the errors that they alone may make
        self._segment_errors: dict[tuple[Panel, int], tuple[float, float]] = {}

    @cached_property
    def _run(self) -> RunSeries:
        return RunSeries(
            self.system, self.begin, self.end, self._accuracy, self._start, self.bounds
        )

    @property
    def trajectory(self) -> Trajectory:
        """The run, sampled at the bounds and where it is a series."""
        return self._run.trajectory

    @property
    def layout(self) -> Layout:
        """That of the system."""
        return self.system.model.layout

    @property
    def size(self) -> int:
        """Number of components of a displacement of the state."""
        return 2 * self.layout.nv

    @cached_property
    def whole_size(self) -> int:
        """The same with the components of places, see :mod:`multiarm.gradients.switches`."""
        return self.size + max(phase.size for phase in self._run.phases)

    @property
    def _shortest(self) -> float:
        """Panels are divided while they are longer [s]."""
        return SHORTEST * (self.end - self.begin)

    @property
    def paths(self) -> list[str]:
        """The parameters' paths in the scene."""
        return [parameter.path for parameter in self.parameters]

    @property
    def count(self) -> int:
        """Number of segments."""
        return len(self._segments)

    def state(self, t: float) -> State:
        """The state at a bound, or at the ends of the run."""
        return self._run.state(t)

    def segment(self, k: int) -> Segment:
        """A segment with its matrices."""
        panel, degree = key = self._segments[k]
        if key in self._built:
            return self._built[key]
        times = nodes(*panel, degree)
        pairs = zip(times, self._run.states(times), strict=True)
        phase = self._run.phases[self.phase_number(k)]
        segment = Segment(panel, [self._equation_at_node(t, state, phase) for t, state in pairs])
        self._segment_errors[key] = segment.defect, segment.error
        if len(self._built) * segment.numbers < MOST_KEPT:
            self._built[key] = segment
        return segment

    def phase_number(self, k: int) -> int:
        """The number of the phase in which a segment lies."""
        panel, _ = self._segments[k]
        begins = [phase.time for phase in self._run.phases]
        return bisect_right(begins, 0.5 * (panel.begin + panel.end)) - 1

    def jump(self, k: int) -> Jump | None:
        """How displacements jump from the end of a segment to the next one; None: they do not."""
        return self.jump_in(self._run.phases, k)

    def jump_in(self, phases: Sequence[Phase], k: int) -> Jump | None:
        """:meth:`jump`, in a run with these phases."""
        if k + 1 == self.count or self.phase_number(k) == self.phase_number(k + 1):
            return None
        phase = phases[self.phase_number(k + 1)]
        assert isinstance(phase, Switched), "only the first phase begins with the run"
        return phase.jump(self.parameters, self.whole_size, self._integrand)

    @cached_property
    def _accelerations(self) -> np.ndarray:
        """Which components of a displacement's rate are accelerations, (D,)."""
        which = np.zeros(self.size, bool)
        which[self.layout.velocity_columns] = True
        return which

    @cached_property
    def _gap_roundings(self) -> float:
        return gap_roundings(self.system)

    @cached_property
    def admissible(self) -> np.ndarray:
        """Projector (D, D) on displacements of the start that keep the joints closed."""
        start = self.state(self.begin)
        return self._derivatives(self.begin, start, self._run.phases[0]).motions.admissible()

    def to_accuracy(
        self, solve: Callable[[Linearisation, Done], AnySolution], show: Report
    ) -> tuple[AnySolution, Quality]:
        """The solution over segments that are short enough, or as short as helps.

        Returns
        -------
        solution : AnySolution
        quality : Quality
            With the error of the solution along the run, and what the run's own error adds.

        Raises
        ------
        SolverError
            When its error along the run is too large even so.
        """
        with one_thread():  # the matrices are too small for several
            self._plan()
            self._refine_coarse()
            solution = self._along_the_run(solve, show)
            words = "derivatives of the comparison run"
            comparison = solve(_ComparisonRun(self), partial(_show, show, self.count, words))
        error = solution.error + solution.difference(comparison)
        return solution, _assess(error, self.tolerance, self.end)

    def _along_the_run(
        self, solve: Callable[[Linearisation, Done], AnySolution], show: Report
    ) -> AnySolution:
        """The solution along the run, over segments that are short enough."""
        best: AnySolution | None = None
        for number in range(1, MOST_ROUNDS + 1):
            words = "derivatives of the run" + (f", round {number}" if number > 1 else "")
            solution = solve(self, partial(_show, show, self.count, words))
            if best is not None and solution.error > LESSENED * best.error:  # roundings are left
                break
            best, segments = solution, self._segments
            if best.error <= self.tolerance:
                break
            if best.segment_errors.sum() > 0.5 * self.tolerance:
                self._refine(best.segment_errors)
            else:
                self.panel_tolerance *= 0.1
        assert best is not None, "there is a first round"
        if best.error > USELESS:
            raise SolverError(
                f"the derivatives of the run have an error of {best.error:.1g} of their size, and "
                f"shorter pieces of time do not lessen it; look for a control that jumps, or for "
                f"motions that damping ends long before the end of the run"
            )
        self._segments = segments
        return best

    def comparison_run(self) -> tuple[ComparisonRun, list[list[float]]]:
        """The comparison run, and by segment the run's times at which matrices are wanted."""
        times = [nodes(*panel, max(LOWEST, degree // COARSER)) for panel, degree in self._segments]
        return self._run.comparison_run([*chain.from_iterable(times)]), times

    def _plan(self) -> None:
        """Choose segments over which the velocities of the run are series of low degree."""
        self._segments = []
        for panel in self._run.panels:
            series, first = self._run.series(panel.begin), self.layout.nq
            allowed = self.tolerance / ROUGHER
            self._segments += _planned_segments(panel, series, first, allowed, self._shortest)

    def _refine_coarse(self) -> None:
        """Refine segments whose series are clearly too coarse, before anything is solved."""
        allowed = COARSE * self.tolerance
        while True:
            for k, key in enumerate(self._segments):
                if key not in self._segment_errors:
                    self.segment(k)
            errors = np.array([self._segment_errors[key][1] for key in self._segments])
            long = np.array([panel.length > self._shortest for panel, _ in self._segments])
            coarse = (errors > allowed) & long
            if not coarse.any():
                return
            self._refine(np.where(coarse, errors, 0.0))

    def _refine(self, segment_errors: np.ndarray) -> None:
        """Give segments that contribute much to the error more nodes, or divide them."""
        large = min(0.5 * self.tolerance / self.count, segment_errors.max())
        segments = []
        for (panel, degree), segment_error in zip(self._segments, segment_errors, strict=True):
            defect, _ = self._segment_errors[panel, degree]
            if segment_error < large:
                segments.append((panel, degree))
            elif finer := [
                k
                for k in DEGREES
                if k > degree and segment_error * defect ** (k / degree - 1.0) < large
            ]:
                segments.append((panel, finer[0]))
            else:
                segments += [(half, DEGREES[0]) for half in panel.parts(2)]
        self._segments = segments

    def _equation_at_node(self, t: float, state: State, phase: Phase) -> VariationalEquation:
        """The equation at a node."""
        value = self._values.get((t, phase))
        if value is None:
            value = self.equation_at(t, state, phase)
            if len(self._values) * value.numbers < MOST_KEPT:
                self._values[t, phase] = value
        return value

    def equation_at(self, t: float, state: State, phase: Phase) -> VariationalEquation:
        """The equation at a state."""
        count, states, size = len(self.parameters), self.size, self.whole_size
        D = self._derivatives(t, state, phase)
        beta, offset = np.zeros((2, size, count))
        A, B, slope = (
            np.zeros((size, size)),
            np.zeros((size, self.layout.rate_count)),
            np.zeros(size),
        )
        A[:states, :states], B[:states] = state_matrices(D)
        for k, parameter in enumerate(self.parameters):
            along_joints, offset[:states, k] = parameter.at(t, state, D.motions, phase)
            at_state = along_joints - A[:states, :states] @ offset[:states, k]
            beta[:states, k] = np.where(self._accelerations, at_state, 0.0)
        by_place, place_offset = phase.responses(
            t, state, D.motions, A[:states, :states], self._gap_roundings
        )
        A[:states, states : states + phase.size] = np.where(
            self._accelerations[:, None], by_place, 0.0
        )
        rate = 0.0
        if self._integrand is not None:
            rate, slope[:states] = self._integrand(t, state)
        scale = np.zeros((size, count))
        scale[:states] = self._scale(D.evaluation.accelerations)
        return VariationalEquation(A, B, beta, D.motions, offset, slope, rate, scale, place_offset)

    def _scale(self, accelerations: np.ndarray) -> np.ndarray:
        """What the derivatives of the accelerations by parameters are as a rule, shape (D, P)."""
        largest = np.abs(np.append(accelerations, self.system.scene.gravity or 0.0)).max()
        typical = np.array([largest / parameter.size for parameter in self.parameters])
        return np.outer(self._accelerations, typical)

    def _derivatives(self, t: float, state: State, phase: Phase) -> Derivatives:
        try:
            return derivatives_while(phase.held(self.system), self.system, t, state)
        except SolverError as error:
            raise SolverError(f"at t = {t:.9g} s: {error}") from None


class _ComparisonRun:
    """The comparison run, over the same segments."""

    def __init__(self, linearised: LinearisedRun) -> None:
        self._linearised = linearised
        (self._states, self._phases), self._times = linearised.comparison_run()

    def segment(self, k: int) -> Segment:
        """A segment with its matrices."""
        phase = self._phases[self._linearised.phase_number(k)]
        values = [self._linearised.equation_at(*self._states[t], phase) for t in self._times[k]]
        return self._linearised.segment(k).of_comparison_run(values)

    def state(self, t: float) -> State:
        """The state at a bound, or at the ends of the run."""
        return self._states[t].state

    def jump(self, k: int) -> Jump | None:
        """How displacements jump from the end of a segment to the next one; None: they do not."""
        return self._linearised.jump_in(self._phases, k)


def _parameter(
    system: System, path: str, size: float | None, begin: float, end: float
) -> Parameter | SwitchTime:
    """A number of the scene by which runs are differentiated."""
    if is_switch_time(path) and isinstance(value_at(system.scene, path), float):
        return SwitchTime(system, path, size, begin, end)
    return Parameter(system, path, size)


def _assess(error: float, tolerance: float, end: float) -> Quality:
    right = max(0, math.floor(-math.log10(max(error, EPSILON))))
    if right >= FEW or (right > 0 and error <= EXPECTED * tolerance):
        return Quality(error, right, "")
    count = ("no digit is", "only one digit is", "only two digits are")[right]
    return Quality(
        error,
        right,
        f"{count} right: motions separate so fast until t = {end:.6g} s that the error of the run "
        f"itself changes its derivatives by {error:.1g} of their size; end the run earlier, add "
        "damping, or ask for a smaller `accuracy`",
    )


def _show(show: Report, total: int, words: str, done: int) -> None:
    show(done, total, words)


def _refuse(system: System) -> None:
    """Refuse systems whose runs have states that displacements do not contain."""
    if system.model.effects.states:
        raise SolverError(
            "derivatives of a run: an effect of this scene has states of its own, such as the "
            "torques of lagging drives, by which runs are not differentiated; leave it out"
        )
    if system.model.sampling is not None:
        raise SolverError(
            "derivatives of a run: the control is sampled, so that its torques are those of "
            "earlier states; leave `sample_time` out"
        )


def _planned_segments(
    panel: Panel,
    series: Series,
    first: int,
    allowed: float,
    shortest: float,
    before: float = math.inf,
) -> list[tuple[Panel, int]]:
    """Segments of a panel over which a series, from a component on, is one of lower degree.

    Panels that are not longer than ``shortest`` [s] are not divided.
    """
    for degree in DEGREES:
        values = series.at(nodes(*panel, degree))[0][:, first:]
        size = max(1.0, np.abs(values).max())
        defect = Series(*panel, values).defect.max() / size
        if defect <= allowed:
            return [(panel, degree)]
    if defect > LESSENED * before or panel.length < shortest:  # noise of the run, or a kink
        return [(panel, DEGREES[-1])]
    halves = (
        _planned_segments(half, series, first, allowed, shortest, defect) for half in panel.parts(2)
    )
    return list(chain.from_iterable(halves))
