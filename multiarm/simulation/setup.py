"""Before a run: the settings, the method, the first evaluation and the first step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from multiarm.assembly.linkage import projection_tolerance, scene_size
from multiarm.assembly.start import project_start
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.diagnosis import failure_text
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import StartReport, System
from multiarm.errors import SceneError, SolverError
from multiarm.integration.rosenbrock import make_rosenbrock, rosenbrock_step
from multiarm.integration.samples import sample_width
from multiarm.integration.stepper import (
    OWN_SIZE,
    OWN_STEP,
    OWN_STRUCT,
    Method,
    Step,
    begin_chart,
    evaluate_slope,
    make_method,
    make_step,
)
from multiarm.integration.tableaus import METHODS, ROSENBROCK, VARIATIONAL, Tableau
from multiarm.integration.time_loop import (
    FEEDBACK,
    NONE,
    PROJECTION,
    Clock,
    Settings,
    gains,
    make_clock,
    watch_start,
)
from multiarm.integration.variational import make_variational, variational_step
from multiarm.jit.pointers import address_of
from multiarm.jit.structs import make_struct
from multiarm.results.event_log import EventLog
from multiarm.results.sinks import Sink
from multiarm.scene import RunSpec
from multiarm.scene.run import DEFAULT_ACCURACY, AccuracySpec
from multiarm.scene.schema import method_fault
from multiarm.simulation.solver_log import SolverLog

if TYPE_CHECKING:
    from multiarm.simulation.event_handling import EventHandler

# Below this accuracy [m, rad] the method of order 8 is the cheaper one.
ORDER_8_BELOW = 1e-3
# Tolerance of one step as a fraction of the accuracy of the run: errors of many steps add up.  Of
# 50 random scenes nine in ten come out more accurate than was asked; the others are repeated.
STEP_SHARE = 0.1
# Length of the trial from which the second derivative is taken at the start [s].
TRIAL_STEP = 1e-5
# Below this tolerance, roundings are all that changes.
SMALLEST_TOLERANCE = 1e-14
# Gaps larger than this fraction of the scene's size mean that the run has diverged.
APART = 0.1
BLOCK_NUMBERS = 200_000
# Methods with steps of their own, compiled when they are first used.
OWN_STEPS = {"rodas5p": rosenbrock_step, "variational": variational_step}
STABILIZATIONS = {"none": NONE, "feedback": FEEDBACK, "projection": PROJECTION}


@dataclass(frozen=True)
class Stepping:
    """A method and its arrays.

    Attributes
    ----------
    tableau : Tableau
    method : Method
    step : Step
    own : tuple
        Arrays that a method with a step of its own reaches by their addresses.
    """

    tableau: Tableau
    method: Method
    step: Step
    own: tuple = ()


@dataclass(frozen=True)
class Tolerance:
    """Largest accepted error estimate of one step of an adaptive method.

    Attributes
    ----------
    position : float
        Of coordinates that are lengths [m], and of their rates [m/s].
    rotation : float
        Of coordinates that are angles [rad], and of their rates [rad/s].
    """

    position: float
    rotation: float

    @property
    def smallest(self) -> float:
        """The smaller of the two."""
        return min(self.position, self.rotation)


@dataclass
class Run:
    """Everything one run needs, the samples' sink, and what happened on the way.

    Attributes
    ----------
    data, stepping, settings, clock
        What the loop works on; the method may change on the way.
    sink, block
        Where samples go, and the rows that are not there yet.
    log, solver_log
        What happened, and what adds to it what the solver met.
    tolerance : Tolerance or None
        None: the step is fixed.
    may_switch : bool
        The method was not named, and may be exchanged.
    full : Data
        With all rows; ``data`` itself unless there are unilateral contacts.
    events : EventHandler or None
        Handles their events.
    """

    data: Data
    stepping: Stepping
    settings: Settings
    clock: Clock
    sink: Sink
    block: np.ndarray
    log: EventLog
    solver_log: SolverLog
    tolerance: Tolerance | None
    may_switch: bool
    full: Data
    events: EventHandler | None = None


def run_spec(written: RunSpec, changes: dict, choice: dict, solver: str | None) -> RunSpec:
    """The scene's run settings with the caller's in their place, validated together."""
    data = dict(written)
    data.update({key: value for key, value in changes.items() if value is not None})
    if any(value is not None for value in choice.values()):
        data.update(choice)
    if solver is not None:
        data["solver"] = solver
    return RunSpec(**data)


def method_and_tolerance(spec: RunSpec, tighten: float = 1.0) -> tuple[str, Tolerance | None]:
    """Name of the method that a run begins with, and its tolerances (None: fixed step).

    ``tighten`` multiplies the tolerances.
    """
    accuracy = spec.accuracy
    if accuracy is None:
        accuracy = AccuracySpec(position=DEFAULT_ACCURACY, rotation=DEFAULT_ACCURACY)
    name = spec.integrator or ("dop853" if accuracy.smallest < ORDER_8_BELOW else "dopri5")
    if METHODS[name].error_order == 0:
        return name, None
    if spec.tolerance is not None:
        return name, Tolerance(tighten * spec.tolerance, tighten * spec.tolerance)
    asked = [
        accuracy.smallest if value is None else value
        for value in (accuracy.position, accuracy.rotation)
    ]
    return name, Tolerance(*(tighten * max(STEP_SHARE * v, SMALLEST_TOLERANCE) for v in asked))


def make_stepping(data: Data, name: str, tolerance: Tolerance | None) -> Stepping:
    """A method and its arrays; compiles the method if it has a step of its own."""
    tableau = METHODS[name]
    pieces = data.model.effects
    method = make_method(tableau)
    step = make_step(tableau, data.model.layout.joints, pieces.states, 1 + len(pieces.works))
    if tolerance is not None:
        step.tolerance[:] = _tolerances(data, tolerance)
    if tableau.kind == ROSENBROCK:
        work = make_rosenbrock(tableau, method, step, data.model.layout.joints, data.struct)
        return _with_own_step(Stepping(tableau, method, step), work)
    if tableau.kind == VARIATIONAL:
        call, places = data.coriolis()
        shape, rows = data.work.Y.shape, data.model.layout.contacts
        momenta = make_variational(
            step, data.struct, data.model.layout.joints, shape, rows, call, places
        )
        return _with_own_step(Stepping(tableau, method, step), momenta)
    return Stepping(tableau, method, step)


def _with_own_step(stepping: Stepping, work: tuple) -> Stepping:
    """A method whose step works on the arrays ``work``."""
    struct, own = make_struct(work), stepping.step.own
    own[OWN_STEP] = address_of(OWN_STEPS[stepping.tableau.name])
    own[OWN_STRUCT], own[OWN_SIZE] = struct.ctypes.data, struct.size
    return replace(stepping, own=(work, struct))


def _tolerances(data: Data, tolerance: Tolerance) -> list[float]:
    """One tolerance an entry of the state, but for the works."""
    units = [unit for arm in data.model.arms.values() for unit in arm.joint_units.values()]
    of_unit = {"m": tolerance.position, "rad": tolerance.rotation}
    coordinates = [of_unit[unit] for unit in ["m"] * 3 + ["rad"] * 3 + units]
    return 2 * coordinates + [tolerance.smallest] * data.model.effects.states


def prepare(
    system: System,
    data: Data,
    spec: RunSpec,
    state: State | None,
    sink: Sink,
    max_step: float,
    log: EventLog,
    tighten: float = 1.0,
) -> Run:
    """Settings, arrays and the first evaluation; ``tighten`` multiplies the tolerances."""
    name, tolerance = method_and_tolerance(spec, tighten)
    if METHODS[name].kind == VARIATIONAL:
        own_states = data.model.effects.with_states
        fault = method_fault(name, own_states, system.scene.effects.with_events)
        if fault:
            raise SceneError(f"integrator: {fault}")
    adaptive = tolerance is not None
    stabilization = spec.stabilization
    samples = int(np.floor(spec.duration / spec.output_step * (1 + 1e-12))) + 1
    if spec.duration - (samples - 1) * spec.output_step > 1e-9 * spec.duration:
        samples += 1
    settings = Settings(
        begin=0.0,
        end=float(spec.duration),
        sample_step=float(spec.output_step),
        samples=samples,
        adaptive=adaptive,
        step=float(spec.step) if spec.step is not None else 1e-3,
        longest_step=positive("max_step", max_step),
        tolerance=1.0 if tolerance is None else tolerance.smallest,
        stabilization=STABILIZATIONS[stabilization.kind],
        alpha=-1.0 if stabilization.alpha is None else float(stabilization.alpha),
        beta=-1.0 if stabilization.beta is None else float(stabilization.beta),
        closed=0.0 if stabilization.kind == "projection" else -1.0,
        apart=np.inf,
        breakpoints=np.array(data.model.breakpoints, dtype=float),
        switch=adaptive and spec.integrator is None,
        stop=np.inf,
    )
    stepping = make_stepping(data, name, tolerance)
    method, step = stepping.method, stepping.step
    begin, report = system.initial_state(), system.start_report
    if state is not None:
        begin, report = state, StartReport()
        if stabilization.kind == "projection":
            begin, report = project_start(data, system.scene, state)
    place_state(data, 0.0, begin)
    begin_chart(data.struct, step.base, step.z)
    feedback = gains(settings, settings.step)
    _first_slope(data, step, feedback)
    if data.model.effects.states:
        first = 12 + 2 * data.model.layout.joints
        step.z[first : first + data.model.effects.states] = data.effect_states()
        _first_slope(data, step, feedback)
    size = scene_size(data)
    settings = settings._replace(
        closed=projection_tolerance(data, size) if settings.closed >= 0.0 else -1.0,
        apart=APART * size,
    )
    if settings.closed >= 0.0 and data.coupled.status.arms:
        # the start may be where two motions cross
        data.arrays.status.stage_gap = settings.closed
        _first_slope(data, step, feedback)
        data.arrays.status.stage_gap = -1.0
    watch_start(data.struct)
    log.add([{"time": 0.0, "kind": "start", "text": f"start: {x}"} for x in report.lines()])
    solver_log = SolverLog(data, log)
    solver_log.collect(data, 0.0, begin)
    if adaptive:
        first_step = _first_step(data, step, feedback, settings.end, method)
        settings = settings._replace(step=first_step)
    width = sample_width(
        data.model.layout.joints,
        data.arrays.shown.size,
        data.model.constants.free.shape[0],
        1 + len(data.model.effects.works),
    )
    rows = min(max(BLOCK_NUMBERS // width, 16), samples)
    return Run(
        data,
        stepping,
        settings,
        make_clock(settings),
        sink,
        np.zeros((rows, width)),
        log,
        solver_log,
        tolerance,
        settings.switch,
        data,
    )


def positive(name: str, value: float) -> float:
    """A setting that must be positive.

    Raises
    ------
    SolverError
    """
    if not value > 0.0:
        raise SolverError(f"{name}: must be greater than 0, got {value!r}")
    return float(value)


def _first_slope(data: Data, step: Step, feedback: tuple[float, float]) -> None:
    """Evaluate the beginning; what is impossible there is an error, not a result."""
    status = evaluate_slope(data.struct, 0.0, step.z, step.base, *feedback, step.slope)
    if status != OK:
        data.reraise()
        raise SolverError(failure_text(data, status))


def _first_step(
    data: Data, step: Step, feedback: tuple[float, float], end: float, method: Method
) -> float:
    """A first step whose error is about the tolerance (Hairer, Norsett, Wanner, II.4)."""
    scale, trial = step.tolerance, min(TRIAL_STEP, end)
    judged = scale.size
    first = (np.abs(step.slope[:judged]) / scale).max()
    other = np.zeros_like(step.slope)
    status = evaluate_slope(
        data.struct,
        trial,
        step.z + trial * step.slope,
        step.base,
        *feedback,
        other,
    )
    if status != OK:
        data.forgive()  # the run itself will meet the trouble, and say when
        return float(trial)
    second = (np.abs(other - step.slope)[:judged] / scale).max() / trial
    worst = max(first, second)
    if worst == 0.0:
        return min(1e-2, end)
    h = (0.01 / worst) ** (1.0 / (method.error_order + 1.0))
    return float(min(h, end))
