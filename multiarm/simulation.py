"""Carry out a run: choose method and tolerances, drive the compiled loop, pour out the samples."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multiarm.assembly import projection_tolerance, scene_size
from multiarm.channels import trajectory_channels
from multiarm.dynamics import failure_text
from multiarm.equations import CALLBACK_FAILED, NOT_FINITE, OK
from multiarm.errors import MultiarmError, SolverError, TrajectoryError
from multiarm.integrators.stepper import (
    Method,
    Step,
    evaluate_slope,
    make_method,
    make_step,
    step_book,
    store,
)
from multiarm.integrators.tableaus import METHODS, Tableau
from multiarm.interrupts import deferred_interrupt
from multiarm.programs import ControlFunction
from multiarm.scene import RunSpec, dump_scene
from multiarm.scene.control import DEFAULT_ACCURACY
from multiarm.sinks import Hdf5Sink, MemorySink, Sink, provenance
from multiarm.state import State
from multiarm.system import System
from multiarm.time_loop import (
    BLOCK_FIRST,
    BLOCK_FULL,
    BUDGET_USED,
    DIVERGED,
    ERROR_SUM,
    EVALUATIONS,
    FEEDBACK,
    FINISHED,
    LARGEST,
    NONE,
    PROJECTION,
    PROJECTIONS,
    REJECTED,
    SAMPLE,
    SMALLEST,
    STEP_TOO_SMALL,
    STEPS,
    Clock,
    H,
    Settings,
    T,
    advance,
    gains,
    make_clock,
    sample_width,
)
from multiarm.trajectory import Trajectory

# Below this accuracy [m, rad] the method of order 8 is the cheaper one.
ORDER_8_BELOW = 3e-4
# Tolerance of one step as a fraction of the accuracy of the run: errors of many steps add up.
STEP_SHARE = 0.01
BLOCK_NUMBERS = 200_000
BUDGET = 4000  # evaluations between two looks at the clock, progress and Ctrl-C
# Gaps larger than this fraction of the scene's size mean that the run has diverged.
APART = 0.1
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time
STABILIZATIONS = {"none": NONE, "feedback": FEEDBACK, "projection": PROJECTION}

Progress = Callable[[float], None]


@dataclass(frozen=True)
class _Run:
    """Everything one run needs, and the samples' sink."""

    system: System
    tableau: Tableau
    method: Method
    step: Step
    settings: Settings
    clock: Clock
    sink: Sink
    block: np.ndarray


def simulate(
    system: System,
    duration: float | None = None,
    *,
    accuracy: float | None = None,
    integrator: str | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    stabilization: str | dict | None = None,
    output_step: float | None = None,
    max_step: float | None = None,
    solver: str | None = None,
    state: State | None = None,
    control: ControlFunction | None = None,
    out: str | os.PathLike | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Simulate a system.

    Whatever is left out is taken from the scene's ``run``; naming one of ``accuracy``,
    ``integrator``, ``step`` and ``tolerance`` replaces the scene's choice of all four.

    Parameters
    ----------
    system : System
    duration : float, optional
        [s]
    accuracy : float, optional
        Error of the run to aim at [m, rad]; chooses method, tolerances and step sizes.
    integrator : {"semi_implicit_euler", "rk4", "dopri5", "dop853"}, optional
        The first two need ``step``; the others take ``tolerance`` or ``accuracy``.
    step : float, optional
        Fixed step [s].
    tolerance : float, optional
        Error of one step of an adaptive method [m, rad; m/s, rad/s].
    stabilization : {"projection", "feedback", "none"} or dict, optional
        ``{"kind": "feedback", "alpha": ..., "beta": ...}`` sets the gains [1/s].
    output_step : float, optional
        Time between samples [s].
    max_step : float, optional
        Longest step of an adaptive method [s].  With a Python controller it is the time between
        samples when left out, so that no sudden change of its torques is stepped over.
    solver : {"node", "dense"}, optional
    state : State, optional
        Where to begin; the scene's start when left out.
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control.
    out : path-like, optional
        HDF5 file that the samples are streamed to; memory then does not grow with the run.
    progress : callable, optional
        Called with the simulated time now and then; may raise ``KeyboardInterrupt`` to end the run.

    Returns
    -------
    Trajectory
        Also when the run fails on the way: ``status``, ``message`` and all samples up to there.

    Raises
    ------
    SceneError
        When the settings contradict each other.
    SolverError, ControlError
        When the very first evaluation is impossible.
    TrajectoryError
        When ``out`` cannot be written.
    """
    spec = _run_spec(
        system.scene.run,
        {"duration": duration, "stabilization": stabilization, "output_step": output_step},
        {"accuracy": accuracy, "integrator": integrator, "step": step, "tolerance": tolerance},
        solver,
    )
    system = system.with_solver(spec.solver)
    if control is not None:
        system = system.with_control(control)
    python_control = control is not None or "control" in system.calls
    if max_step is None:
        max_step = spec.output_step if python_control else np.inf
    sink = MemorySink() if out is None else Hdf5Sink(Path(out))
    run = _prepare(system, spec, state, sink, max_step)
    started = {
        "control": "python function" if python_control else system.scene.control.kind,
        "start": "scene" if state is None else "given state",
    }
    as_run = system.scene.model_copy(update={"run": spec})
    run.sink.open(_channels(system), {**provenance(dump_scene(as_run)), **started})
    try:
        status, message, wall = _drive(run, progress)
    except BaseException as error:
        # not ours to handle, but what was simulated is kept
        with suppress(TrajectoryError):
            _flush(run)
        run.sink.finish("failed", f"{_where(run)}: {error!r}", _statistics(run, spec, 0.0))
        raise
    return run.sink.finish(status, message, _statistics(run, spec, wall))


def _run_spec(written: RunSpec, changes: dict, choice: dict, solver: str | None) -> RunSpec:
    """The scene's run settings with the caller's in their place, validated together."""
    data = {name: getattr(written, name) for name in type(written).model_fields}
    data.update({key: value for key, value in changes.items() if value is not None})
    if any(value is not None for value in choice.values()):
        data.update(choice)
    if solver is not None:
        data["solver"] = solver
    return RunSpec(**data)


def _prepare(
    system: System, spec: RunSpec, state: State | None, sink: Sink, max_step: float
) -> _Run:
    """Settings, arrays and the first evaluation."""
    name, tolerance = method_and_tolerance(spec)
    tableau = METHODS[name]
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
        longest_step=_positive("max_step", max_step),
        position_tolerance=tolerance or 1.0,
        velocity_tolerance=tolerance or 1.0,
        stabilization=STABILIZATIONS[stabilization.kind],
        alpha=-1.0 if stabilization.alpha is None else float(stabilization.alpha),
        beta=-1.0 if stabilization.beta is None else float(stabilization.beta),
        closed=1e-12,
        apart=np.inf,
        breakpoints=np.array(system.breakpoints, dtype=float),
    )
    method, step = make_method(tableau), make_step(tableau, system.layout.joints)
    begin = system.initial_state() if state is None else state
    system.set_state(0.0, begin)
    store(system.buffers, step.base, step.z)
    _first_slope(system, step, settings)
    settings = settings._replace(
        closed=projection_tolerance(system), apart=APART * scene_size(system)
    )
    if adaptive:
        settings = settings._replace(step=_first_step(system, step, settings, method))
        # the estimate left another state's slope behind
        _first_slope(system, step, settings)
    width = sample_width(system.layout.joints, system.layout.contacts)
    rows = int(np.clip(BLOCK_NUMBERS // width, 16, samples))
    return _Run(
        system, tableau, method, step, settings, make_clock(settings), sink, np.zeros((rows, width))
    )


def _positive(name: str, value: float) -> float:
    if not value > 0.0:
        raise SolverError(f"{name}: must be greater than 0, got {value!r}")
    return float(value)


def method_and_tolerance(spec: RunSpec) -> tuple[str, float | None]:
    """Name of the method that a run uses, and its tolerance of one step (None: fixed step)."""
    accuracy = DEFAULT_ACCURACY if spec.accuracy is None else spec.accuracy
    name = spec.integrator or ("dop853" if accuracy < ORDER_8_BELOW else "dopri5")
    if METHODS[name].error_order == 0:
        return name, None
    return name, STEP_SHARE * accuracy if spec.tolerance is None else spec.tolerance


def _first_slope(system: System, step: Step, settings: Settings) -> None:
    """Evaluate the beginning; what is impossible there is an error, not a result."""
    alpha, beta = gains(settings, settings.step)
    status = evaluate_slope(system.book(), 0.0, step.z, step.base, alpha, beta, step.slope)
    if status != OK:
        system.reraise()
        raise SolverError(failure_text(system, status))


def _first_step(system: System, step: Step, settings: Settings, method: Method) -> float:
    """A first step whose error is about the tolerance (Hairer, Norsett, Wanner, II.4)."""
    scale = np.full(step.z.size - 1, settings.position_tolerance)
    first = np.max(np.abs(step.slope[:-1]) / scale)
    trial = min(1e-6, settings.end) if first == 0.0 else min(0.01 / first * 1e4, settings.end, 1e-3)
    other = np.zeros_like(step.slope)
    status = evaluate_slope(
        system.book(), trial, step.z + trial * step.slope, step.base, 0.0, 0.0, other
    )
    if status != OK:
        system.forgive()  # the run itself will meet the trouble, and tell when
        return float(trial)
    second = np.max(np.abs(other - step.slope)[:-1] / scale) / trial
    worst = max(first, second)
    if worst == 0.0:
        return min(1e-2, settings.end)
    h = (0.01 / worst) ** (1.0 / (method.error_order + 1.0))
    return float(min(100 * trial, h, settings.end))


def _drive(run: _Run, progress: Progress | None) -> tuple[str, str, float]:
    """Let the compiled loop run to its end; returns status, message and wall time [s]."""
    advance_by = _advancer(run)
    reason = advance_by(0)  # compiles the loop if need be, which is no part of the run's time
    started = time.perf_counter()
    next_checkpoint = started + CHECKPOINT_INTERVAL
    with deferred_interrupt() as interrupt:
        while True:
            ended = None
            try:
                if progress is not None:
                    progress(float(run.clock.real[T]))
            except KeyboardInterrupt:  # the caller's way to end the run in good order
                interrupt.pressed = True
            if reason == FINISHED:
                ended = "completed", "the run reached its end"
            elif interrupt.pressed:
                ended = "interrupted", f"stopped by the user {_where(run)}"
            elif reason not in (BUDGET_USED, BLOCK_FULL):
                ended = _trouble(run, reason)
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
            reason = advance_by(BUDGET)


def _advancer(run: _Run) -> Callable[[int], int]:
    """The compiled loop as a function of its budget of evaluations."""
    book, joints = run.system.book(), run.system.layout.joints
    arrays = step_book(run.method, run.step)

    def advance_by(budget: int) -> int:
        return advance(book, joints, arrays, run.method, run.clock, run.settings, run.block, budget)

    return advance_by


def _where(run: _Run) -> str:
    return f"at t = {run.clock.real[T]:.9g} s (step {run.clock.counts[STEPS]})"


def _trouble(run: _Run, reason: int) -> tuple[str, str]:
    """Status and message of a run that ended early."""
    where = _where(run)
    smaller = "a smaller `accuracy`" if run.settings.adaptive else "a smaller `step`"
    if reason == CALLBACK_FAILED:
        try:
            run.system.reraise()
        except KeyboardInterrupt:
            return "interrupted", f"stopped by the user {where}"
        except MultiarmError as error:
            return "failed", f"{where}: {error}"
        except Exception as error:
            return "failed", f"{where}: a callback raised {type(error).__name__}: {error}"
    if reason == STEP_TOO_SMALL:
        return "failed", (
            f"{where}: the step became too small ({run.clock.real[H]:.2g} s) for the asked "
            "accuracy; loosen `accuracy`, or look for a discontinuous controller or a singular "
            "posture there"
        )
    if reason == DIVERGED:
        return "failed", (
            f"{where}: the joints came apart by more than {run.settings.apart:.2g} m, the run has "
            f"diverged; take {smaller}, or `stabilization: projection`"
        )
    if reason == NOT_FINITE:
        return "failed", f"{where}: the state is no longer finite; take {smaller}"
    return "failed", f"{where}: {failure_text(run.system, reason)}"


def _flush(run: _Run) -> None:
    """Hand the samples in the block to the sink and begin a new one."""
    count = run.clock.counts
    rows = int(count[SAMPLE] - count[BLOCK_FIRST])
    if rows == 0:
        return
    count[BLOCK_FIRST] = count[SAMPLE]
    run.sink.append(_block(run.system, run.block[:rows]))


def _block(system: System, rows: np.ndarray) -> dict[str, np.ndarray]:
    """The rows of a block (:func:`multiarm.time_loop.write_sample`) as named channels."""
    layout = system.layout
    n, m = layout.joints, layout.contacts
    columns = np.split(rows, np.cumsum([1, 3, 4, n, 6, n, n, m, 1, 1, 1, 1]), axis=1)
    t, x, quaternion, q, twist, v, torque, force, kinetic, potential, work, gap, rate = columns
    block = {
        "time": t[:, 0],
        "object/position": x,
        "object/quaternion_xyzw": quaternion,
        "object/twist": twist,
        "energy/kinetic": kinetic[:, 0],
        "energy/potential": potential[:, 0],
        "energy/work": work[:, 0],
        "drift/position": gap[:, 0],
        "drift/velocity": rate[:, 0],
    }
    joints = {"joint_position": q, "joint_velocity": v, "joint_torque": torque}
    for name, values in joints.items():
        for arm, part in layout.split_joints(values).items():
            block[f"arms/{arm}/{name}"] = part
    for arm, part in layout.split_contacts(force).items():
        block[f"arms/{arm}/contact_force"] = part
    return block


def _channels(system: System):
    return trajectory_channels(
        {name: arm.joint_units for name, arm in system.arms.items()},
        {
            name: [contact.name for contact in contacts]
            for name, contacts in system.contacts.items()
        },
    )


def _statistics(run: _Run, spec: RunSpec, wall: float) -> dict:
    count, real, settings = run.clock.counts, run.clock.real, run.settings
    simulated = float(real[T])
    return {
        "integrator": run.tableau.name,
        "solver": spec.solver,
        "stabilization": spec.stabilization.kind,
        "accuracy": spec.accuracy,
        "tolerance": settings.position_tolerance if settings.adaptive else None,
        "simulated_s": simulated,
        "steps": int(count[STEPS]),
        "rejected_steps": int(count[REJECTED]),
        "evaluations": int(count[EVALUATIONS]),
        "projections": int(count[PROJECTIONS]),
        "smallest_step_s": float(real[SMALLEST]) if count[STEPS] else None,
        "largest_step_s": float(real[LARGEST]) if count[STEPS] else None,
        "error_estimate": float(real[ERROR_SUM]) if settings.adaptive else None,
        "wall_time_s": wall,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }
