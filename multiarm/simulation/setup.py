"""The setup of a run: settings, method, first evaluation and first step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from multiarm.assembly.linkage import projection_tolerance, scene_size
from multiarm.assembly.start import project_start
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import place_start
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.model import ControlSpan, Model
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK
from multiarm.dynamics.system import StartReport, System
from multiarm.errors import Fault, SceneError, SolverError
from multiarm.integration.methods import Stepping, stepping_of
from multiarm.integration.projection import FEEDBACK_RATIO
from multiarm.integration.step import Step, begin_chart, write_slope
from multiarm.integration.step_control import (
    FEEDBACK,
    NONE,
    PROJECTION,
    Clock,
    Settings,
    gains,
    make_clock,
)
from multiarm.integration.time_loop import begin_run
from multiarm.results.channels import width_of
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import EventLog, RunEvent
from multiarm.results.sinks import Sink
from multiarm.scene import RunSpec
from multiarm.scene.consistency import carries_all_effects, causes_of_events, method_fault
from multiarm.scene.faults import place, shown
from multiarm.scene.run import DEFAULT_ACCURACY, STEPS_CHOSEN_BY, AccuracySpec
from multiarm.scene.values import is_finite
from multiarm.simulation.solver_log import SolverLog
from multiarm.tableaus import METHODS, VARIATIONAL

# Tolerances below this change roundings only.
SMALLEST_TOLERANCE = 1e-14
BLOCK_NUMBERS = 320_000
_DEFAULT_ACCURACY = AccuracySpec(position=DEFAULT_ACCURACY, rotation=DEFAULT_ACCURACY)


@dataclass(frozen=True)
class Task:
    """What is run: the same for all runs that differ in their tolerance only."""

    system: System
    data: Data
    spec: RunSpec
    state: State | None  # initial state; None: the scene's start
    longest_step: float  # [s]
    begin: float = 0.0  # [s]
    output_times: np.ndarray | None = None  # of the samples [s]; None: every ``spec.output_step``

    def __post_init__(self) -> None:
        times, rounding = self.output_times, 1e-12 * max(1.0, abs(self.end))
        report = self.system.start_report
        if self.state is None and not report.assembled:
            gaps = ", ".join(f"{arm}: {gap:.3g} m" for arm, gap in report.gaps.items())
            raise SceneError(
                f"the start does not satisfy the joints (gaps {gaps}), and the system was compiled "
                "with `assemble=False`: give a `state` that does, or compile it with assembly"
            )
        if times is not None and (times[0] < self.begin or times[-1] > self.end + rounding):
            raise SceneError(
                f"'output_times' are from {times[0]:.9g} to {times[-1]:.9g} s, the run from "
                f"{self.begin:.9g} to {self.end:.9g} s; change 'duration' or 'start_time'"
            )

    @property
    def end(self) -> float:
        """Time at which the run ends [s]."""
        return self.begin + self.spec.duration


@dataclass(frozen=True)
class Tolerance:
    """Largest accepted error estimate of one step of an adaptive method."""

    position: float  # of lengths [m] and their rates [m/s]
    rotation: float  # of angles [rad] and their rates [rad/s]

    @property
    def smallest(self) -> float:
        """The smaller of the two."""
        return min(self.position, self.rotation)


@dataclass
class Run:
    """Everything that one run needs."""

    # for the loop; the method may change during the run
    data: Data
    stepping: Stepping
    settings: Settings
    clock: Clock
    sink: Sink
    block: np.ndarray  # samples that are not in the sink yet
    log: EventLog
    solver_log: SolverLog
    tolerance: Tolerance | None  # None: the step is fixed

    def continue_with(self, stepping: Stepping) -> None:
        """Go on with another method or other arrays of it, from the state of those before."""
        before, self.stepping, new = self.stepping.step, stepping, stepping.step
        set_tolerance(new, self.data, self.tolerance)
        new.z[:], new.base[:], new.slope[:] = before.z, before.base, before.slope


def run_spec(written: RunSpec, settings: Mapping[str, Any]) -> RunSpec:
    """The scene's run settings with the caller's in their place, validated together.

    Settings that are None are the scene's; one of :data:`STEPS_CHOSEN_BY` replaces all of these.

    Raises
    ------
    SceneError
        Every fault with its setting, or ``run`` where it is of several settings.
    """
    changes = {key: value for key, value in settings.items() if value is not None}
    replaced = STEPS_CHOSEN_BY if changes.keys() & set(STEPS_CHOSEN_BY) else ()
    data = {**dict(written), **dict.fromkeys(replaced), **changes}
    try:
        return RunSpec(**data)
    except SceneError as error:
        faults = [
            Fault(
                fault.problem,
                place(fault.parts, "").removeprefix(".") or "run",
                ("run", *fault.parts),
            )
            for fault in error.faults
        ]
        raise SceneError(faults) from None


def finite_time(value: Any, name: str) -> float:
    """A time that a caller gives under a name [s].

    Raises
    ------
    SceneError
        When it is no finite number.
    """
    if not is_finite(value):
        raise SceneError(f"{name!r} must be a finite time [s], got {shown(value)}")
    return float(value)


def increasing_times(values: ArrayLike, name: str = "output_times") -> np.ndarray:
    """Times that a caller gives under a name, as an array (K,) [s].

    Raises
    ------
    SceneError
        When they are not finite numbers that increase.
    """
    try:
        times = np.array(values, dtype=float)
    except (TypeError, ValueError):
        times = np.empty(0)
    if times.ndim != 1 or not times.size or not np.all(np.isfinite(times)):
        raise SceneError(f"{name!r} must be a list of times [s], got {shown(values)}")
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        k = late[0]
        raise SceneError(
            f"{name!r} must increase; {times[k + 1]:.9g} s comes after {times[k]:.9g} s"
        )
    return times


def method_and_tolerance(spec: RunSpec, tighten: float = 1.0) -> tuple[str, Tolerance | None]:
    """Name of the method with which a run begins, and its tolerances (None: fixed step).

    ``tighten`` multiplies the tolerances.
    """
    accuracy = _DEFAULT_ACCURACY if spec.accuracy is None else spec.accuracy
    # the method of order 8 is the cheaper one below an accuracy of 1e-3
    name = spec.integrator or ("dop853" if accuracy.smallest < 1e-3 else "dopri5")
    if not METHODS[name].adaptive:
        return name, None
    if spec.tolerance is not None:
        return name, Tolerance(tighten * spec.tolerance, tighten * spec.tolerance)
    wanted = [
        accuracy.smallest if value is None else value
        for value in (accuracy.position, accuracy.rotation)
    ]
    # errors of many steps add up: with a tenth of the accuracy as tolerance of a step, nine in ten
    # of 50 random scenes met the accuracy; the others are repeated
    return name, Tolerance(*(tighten * max(0.1 * v, SMALLEST_TOLERANCE) for v in wanted))


def set_tolerance(step: Step, data: Data, tolerance: Tolerance | None) -> None:
    """Write the largest accepted error of each number of the state; a fixed step has none."""
    if tolerance is None:
        return
    of_unit = {"m": tolerance.position, "rad": tolerance.rotation}
    coordinates = [of_unit[unit] for unit in data.model.coordinate_units]
    step.tolerance[:] = 2 * coordinates + [tolerance.smallest] * data.model.effects.states


def prepare(task: Task, sink: Sink, log: EventLog, tighten: float = 1.0) -> Run:
    """Settings, arrays and the first evaluation; ``tighten`` multiplies the tolerances."""
    data, spec, begin = task.data, task.spec, task.begin
    name, tolerance = method_and_tolerance(spec, tighten)
    _check_samples(data.model, spec)
    _check_bases(data.model, name)
    if not carries_all_effects(name):
        _check_effects(task, name)
    stepping = stepping_of(data, METHODS[name])
    step = stepping.step
    set_tolerance(step, data, tolerance)
    state, report = _place_start(task, step)
    settings = _settings(task, tolerance)
    first_length = float(spec.step) if spec.step is not None else 1e-3  # [s]
    step.stage.alpha, step.stage.beta = gains(settings, first_length)
    _first_slope(task, stepping)
    if settings.stabilization == PROJECTION and data.arrays.solution.coupled_blocks:
        # two motions may cross at the start
        step.stage.projects, step.stage.gap = True, settings.gap_tolerance
        _first_slope(task, stepping)
        step.stage.projects = False
    require_ok(data, begin_run(data.struct))
    log.add(*(RunEvent(begin, EventKind.START, f"start: {line}") for line in report.lines()))
    solver_log = SolverLog(data, log)
    solver_log.collect(data, begin, state)
    if settings.adaptive:
        first_length = _first_length(task, stepping)
    step.stage.evaluations = 0  # statistics begin with the first step
    samples, final_sample = _samples(task)
    width = width_of(task.system.channels)
    clock = make_clock(
        begin,
        task.end,
        samples,
        final_sample,
        control_step=np.inf if data.model.sampling is None else float(data.model.sampling.time),
        switch=settings.adaptive and spec.integrator is None,
        step=first_length,
    )
    return Run(
        data=data,
        stepping=stepping,
        settings=settings,
        clock=clock,
        sink=sink,
        block=np.zeros((min(max(BLOCK_NUMBERS // width, 16), samples), width)),
        log=log,
        solver_log=solver_log,
        tolerance=tolerance,
    )


def _check_effects(task: Task, name: str) -> None:
    """Refuse effects that a method cannot carry."""
    unilateral, effects = task.system.model.unilateral, task.system.scene.effects
    with_events = causes_of_events(effects, unilateral is not None)
    timed = unilateral is not None and bool(unilateral.timed)
    if fault := method_fault(name, task.data.model.effects.with_states, with_events, timed):
        raise SceneError([Fault(fault, "integrator", ("run", "integrator"))])


def _check_bases(model: Model, name: str) -> None:
    """Refuse methods that need derivatives, where bases float."""
    floating = [robot for robot, arm in model.robots.items() if arm.floats]
    if floating and METHODS[name].kind == VARIATIONAL:
        text = (
            f"'{name}' is not there for floating bases, such as that of robot '{floating[0]}'; use "
            "another method, such as 'dop853' or 'rodas5p'"
        )
        raise SceneError([Fault(text, "integrator", ("run", "integrator"))])


def positive(name: str, value: float, *, or_infinite: bool = False) -> float:
    """A setting that must be positive and, unless it may be infinite, finite.

    Raises
    ------
    SolverError
    """
    if not isinstance(value, Real) or not value > 0.0:
        raise SolverError(f"{name}: must be greater than 0, got {shown(value)}")
    if not is_finite(value) and not (or_infinite and value == math.inf):
        raise SolverError(f"{name}: must be finite, got {shown(value)}")
    return float(value)


def _check_samples(model: Model, spec: RunSpec) -> None:
    """Refuse a control with absurdly many samples, each of which ends a step."""
    if model.sampling is None:
        return
    time, unit = model.sampling.time, min(1.0, spec.duration)
    if unit / time > spec.most_steps:
        raise SolverError(
            f"sample_time: {time:g} s is {unit / time:.3g} samples of the control in {unit:.3g} s, "
            f"each of which ends a step; more than {spec.most_steps:.2g} (`run.most_steps`) are "
            f"not made: give seconds, such as 0.001, or raise `most_steps`"
        )


def check_control_span(model: Model, begin: float, end: float) -> None:
    """Refuse a run between two times [s] with a control that is not defined all the time.

    Raises
    ------
    SolverError
    """
    span = model.control_span
    if span is None or span.outside != "error":
        return
    if span.begin > begin or end > span.end * (1.0 + 1e-12):
        raise SolverError(
            f"control: {span.what} is from {span.begin:.9g} s to {span.end:.9g} s, the run from "
            f"{begin:.9g} to {end:.9g} s; shorten the run, complete the table, or let "
            f"`outside: hold` or `outside: zero` say what the torques are there"
        )


def control_end(span: ControlSpan) -> RunEvent:
    """The event of a run that leaves the times at which its control is defined."""
    rest = "is zero" if span.outside == "zero" else "holds its last row"
    return RunEvent(span.end, EventKind.CONTROL_ENDS, f"{span.what} ends and {rest}")


def _samples(task: Task) -> tuple[int, int]:
    """Number of samples, and the one that is taken at the end of the run."""
    spec = task.spec
    samples = int(np.floor(spec.duration / spec.output_step * (1 + 1e-12))) + 1
    if spec.duration - (samples - 1) * spec.output_step > 1e-9 * spec.duration:
        samples += 1
    return samples if task.output_times is None else task.output_times.size, samples - 1


def _settings(task: Task, tolerance: Tolerance | None) -> Settings:
    """The settings of a run, with the kinematics of its start in the data."""
    data, spec, times = task.data, task.spec, task.output_times
    stabilization, size = spec.stabilization, scene_size(data)
    kinds = {"none": NONE, "feedback": FEEDBACK, "projection": PROJECTION}
    kind, alpha, beta = kinds[stabilization.kind], stabilization.alpha, stabilization.beta
    return Settings(
        begin=task.begin,
        sample_step=float(spec.output_step),
        sample_times=np.zeros(0) if times is None else np.minimum(times, task.end),
        adaptive=tolerance is not None,
        longest_step=positive("max_step", task.longest_step, or_infinite=True),
        tolerance=1.0 if tolerance is None else tolerance.smallest,
        stabilization=kind,
        alpha=0.0 if alpha is None else float(alpha),
        beta=0.0 if beta is None else float(beta),
        alpha_by_step=FEEDBACK_RATIO if alpha is None else 0.0,
        beta_by_step=FEEDBACK_RATIO if beta is None else 0.0,
        gap_tolerance=projection_tolerance(data, size) if kind == PROJECTION else 0.0,
        # gaps larger than a tenth of the scene mean that the run has diverged
        divergence_bound=0.1 * size,
        breakpoints=np.array(data.model.breakpoints, dtype=float),
    )


def _place_start(task: Task, step: Step) -> tuple[State, StartReport]:
    """The state at which the run begins, with its kinematics in the data, and its chart."""
    system, data = task.system, task.data
    begin, report = system.initial_state(), system.start_report
    if task.state is not None:
        begin, report = task.state, StartReport()
        if task.spec.stabilization.kind == "projection":
            begin, report = project_start(data, system.scene, task.state)
    place_start(data, task.begin, begin)
    require_ok(data, update_kinematics(data.struct))
    begin_chart(data.struct, step.base, step.z)
    return begin, report


def _first_slope(task: Task, stepping: Stepping) -> None:
    """Evaluate the beginning; a failure there is an error, not a result."""
    step = stepping.step
    require_ok(task.data, write_slope(stepping.struct, task.begin, step.z, step.slope))


def _first_length(task: Task, stepping: Stepping) -> float:
    """A first step whose error is about the tolerance (Hairer, Norsett, Wanner, II.4)."""
    data, step, duration = task.data, stepping.step, task.spec.duration
    trial = min(1e-5, duration)  # [s]: from its slopes the second derivative is taken
    scale = step.tolerance
    first = (np.abs(step.slope[: scale.size]) / scale).max()
    later = np.zeros_like(step.slope)
    z = step.z + trial * step.slope
    if write_slope(stepping.struct, task.begin + trial, z, later) != OK:
        data.forgive()  # the run itself will fail there, and report when
        return float(trial)
    second = (np.abs(later - step.slope)[: scale.size] / scale).max() / trial
    worst = max(first, second)
    if worst == 0.0:
        return min(1e-2, duration)
    h = (0.01 / worst) ** (1.0 / (stepping.tableau.error_order + 1.0))
    return float(min(h, duration))
