"""Carry out a run: drive the compiled loop, pour out the samples, tell how it ended."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from multiarm.channels import trajectory_channels
from multiarm.contacts.frames import COMPONENTS, UNITS
from multiarm.dynamics import failure_text, lost_contact_text
from multiarm.equations import CALLBACK_FAILED, NOT_FINITE
from multiarm.errors import MultiarmError, SolverError, TrajectoryError
from multiarm.integrators.stepper import step_book
from multiarm.interrupts import deferred_interrupt
from multiarm.plant import BUSY
from multiarm.preparation import Run, prepare, run_spec
from multiarm.programs import ControlFunction
from multiarm.samples import named_samples
from multiarm.scene import RunSpec, dump_scene
from multiarm.sinks import Hdf5Sink, MemorySink, provenance
from multiarm.state import State
from multiarm.system import System
from multiarm.time_loop import (
    BLOCK_FIRST,
    BLOCK_FULL,
    BUDGET_USED,
    COUPLED_STEPS,
    DIVERGED,
    ERROR_SUM,
    EVALUATIONS,
    FINISHED,
    HIGHEST_RANK,
    LARGE_CORRECTION,
    LARGEST,
    LOWEST_RANK,
    PROJECTIONS,
    REJECTED,
    SAMPLE,
    SMALLEST,
    SOLVER_CHANGED,
    STEP_TOO_SMALL,
    STEPS,
    WORST_CORRECTION,
    WORST_RESIDUAL,
    H,
    T,
    advance,
)
from multiarm.trajectory import Trajectory

BUDGET = 4000  # evaluations between two looks at the clock, progress and Ctrl-C
CHECKPOINT_INTERVAL = 2.0  # [s] of wall time

Progress = Callable[[float], None]


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
    spec = run_spec(
        system.scene.run,
        {"duration": duration, "stabilization": stabilization, "output_step": output_step},
        {"accuracy": accuracy, "integrator": integrator, "step": step, "tolerance": tolerance},
        solver,
    )
    system = system.with_solver(spec.solver)
    if control is not None:
        system = system.with_control(control)
    python_control = "control" in system.calls
    if max_step is None:
        max_step = spec.output_step if python_control else np.inf
    sink = MemorySink() if out is None else Hdf5Sink(Path(out))
    run = prepare(system, spec, state, sink, max_step)
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
        statistics = _statistics(run, spec, 0.0)
        run.sink.finish("failed", f"{_where(run)}: {error!r}", statistics, _events(run))
        raise
    message += run.events.summary() + run.solver_log.summary()
    return run.sink.finish(status, message, _statistics(run, spec, wall), _events(run))


def _drive(run: Run, progress: Progress | None) -> tuple[str, str, float]:
    """Let the compiled loop run to its end; returns status, message and wall time [s]."""
    advance_by = _advancer(run)
    reason = advance_by(0)  # compiles the loop if need be, which is no part of the run's time
    started = time.perf_counter()
    next_checkpoint = started + CHECKPOINT_INTERVAL
    with deferred_interrupt() as interrupt:
        while True:
            ended = None
            run.events.collect(run.system)
            if reason == SOLVER_CHANGED:
                run.solver_log.collect(run.system, float(run.clock.real[T]), _state(run))
            try:
                if progress is not None:
                    run.system.buffers.flag[BUSY] = 1
                    progress(float(run.clock.real[T]))
            except KeyboardInterrupt:  # the caller's way to end the run in good order
                interrupt.pressed = True
            finally:
                run.system.buffers.flag[BUSY] = 0
            if reason == FINISHED:
                ended = "completed", "the run reached its end"
            elif interrupt.pressed:
                ended = "interrupted", f"stopped by the user {_where(run)}"
            elif reason not in (BUDGET_USED, BLOCK_FULL, SOLVER_CHANGED):
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


def _advancer(run: Run) -> Callable[[int], int]:
    """The compiled loop as a function of its budget of evaluations."""
    book, joints = run.system.book(), run.system.layout.joints
    arrays = step_book(run.method, run.step)

    def advance_by(budget: int) -> int:
        return advance(book, joints, arrays, run.method, run.clock, run.settings, run.block, budget)

    return advance_by


def _events(run: Run) -> list[dict]:
    """Everything that happened, in order of time."""
    return sorted([*run.events.told, *run.solver_log.told], key=lambda event: event["time"])


def _state(run: Run) -> State:
    """The state at the beginning of the next step."""
    n, z = run.system.layout.joints, run.step.z
    return State(
        np.concatenate([z[:3], run.step.base, z[6 : 6 + n]]),
        z[6 + n : -1].copy(),
        run.system.layout,
    )


def _where(run: Run) -> str:
    return f"at t = {run.clock.real[T]:.9g} s (step {run.clock.counts[STEPS]})"


def _trouble(run: Run, reason: int) -> tuple[str, str]:
    """Status and message of a run that ended early."""
    where = _where(run)
    smaller = "a smaller `accuracy`" if run.settings.adaptive else "a smaller `step`"
    if reason == CALLBACK_FAILED:
        try:
            run.system.reraise()
        except KeyboardInterrupt:
            return "interrupted", f"stopped by the user {where}"
        except SolverError as error:
            return "failed", f"{where}: {lost_contact_text(run.system) or error}"
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
    if reason == LARGE_CORRECTION:
        return "failed", (
            f"{where}: every step, however short, ends far from the joints; look for a motion that "
            f"they cannot follow, or start elsewhere"
        )
    if reason == NOT_FINITE:
        lost = lost_contact_text(run.system)
        return "failed", f"{where}: {lost or f'the state is no longer finite; take {smaller}'}"
    return "failed", f"{where}: {failure_text(run.system, reason)}"


def _flush(run: Run) -> None:
    """Hand the samples in the block to the sink and begin a new one."""
    count = run.clock.counts
    rows = int(count[SAMPLE] - count[BLOCK_FIRST])
    if rows == 0:
        return
    count[BLOCK_FIRST] = count[SAMPLE]
    run.sink.append(
        named_samples(run.system.layout, run.system.plant.free_bounds, run.block[:rows])
    )


def _channels(system: System):
    return trajectory_channels(
        {name: arm.joint_units for name, arm in system.arms.items()},
        {
            name: [contact.name for contact in contacts]
            for name, contacts in system.contacts.items()
        },
        {
            name: {COMPONENTS[k]: UNITS[k] for k in frame.free}
            for name, frame in system.frames.items()
        },
    )


def _statistics(run: Run, spec: RunSpec, wall: float) -> dict:
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
        "coupled_steps": int(count[COUPLED_STEPS]),
        "lowest_rank": int(count[LOWEST_RANK]) if count[STEPS] else None,
        "highest_rank": int(count[HIGHEST_RANK]) if count[STEPS] else None,
        "residual_max": float(real[WORST_RESIDUAL]),
        "correction_max": float(real[WORST_CORRECTION]),
        "wall_time_s": wall,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }
