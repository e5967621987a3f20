"""What a result says about its run besides the samples: provenance and statistics."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from multiarm.dynamics.system import System
from multiarm.results.files import RunStatus
from multiarm.results.limit_use import LIMITS, limits_record
from multiarm.results.sinks import Sink, provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, dump_scene
from multiarm.simulation.driver import Driver


def open_sink(sink: Sink, system: System, spec: RunSpec, with_state: bool, **about: str) -> None:
    """Open a sink for the samples of a system.

    ``with_state``: the start is a given state, not the scene's; ``about`` replaces provenance.

    Raises
    ------
    TrajectoryError
        When it cannot be opened.
    """
    sink.open(system.channels, _metadata(system, spec, with_state, about))


def leave_undone(
    system: System, with_state: bool, sink: Sink, status: RunStatus, message: str
) -> Trajectory:
    """The result of a run that did not begin: no samples, and the reason.

    Raises
    ------
    TrajectoryError
        When the sink cannot be opened.
    """
    open_sink(sink, system, system.scene.run, with_state)
    return sink.finish(status, message, {"simulated_s": 0.0, "wall_time_s": 0.0})


def run_statistics(driver: Driver) -> dict[str, Any]:
    """What a run has taken so far, for its result."""
    task, run, events, wall = driver.task, driver.run, driver.events, driver.wall
    sampling = task.data.model.sampling
    clock, settings, spec = run.clock, run.settings, task.spec
    backends = task.data.model.backends
    simulated = clock.t - settings.begin
    return {
        "integrator": run.stepping.tableau.name,
        "solver": spec.solver,
        "arms": backends.by_arm,
        "not_compiled": backends.reasons,
        "stabilization": spec.stabilization.kind,
        "accuracy": None if spec.accuracy is None else spec.accuracy.written,
        "tolerance": settings.tolerance if settings.adaptive else None,
        "start_time_s": settings.begin,
        "simulated_s": simulated,
        "steps": clock.steps,
        "ambiguous_steps": clock.ambiguous_steps,
        "rejected_steps": clock.rejected,
        "evaluations": clock.evaluations,
        "projections": clock.projections,
        "smallest_step_s": clock.smallest_step if clock.steps else None,
        "largest_step_s": clock.largest_step if clock.steps else None,
        "error_estimate": clock.error_sum if settings.adaptive else None,
        "coupled_steps": clock.coupled_steps,
        "lowest_rank": clock.lowest_rank if clock.steps else None,
        "highest_rank": clock.highest_rank if clock.steps else None,
        "residual_max": clock.worst_residual,
        "correction_max": clock.worst_correction,
        **({} if events is None else events.statistics()),
        **({} if sampling is None else {"control_samples": clock.control_samples}),
        "wall_time_s": wall,
        "compile_time_s": driver.compilation,
        "realtime_factor": simulated / wall if wall > 0.0 else None,
    }


def _metadata(
    system: System, spec: RunSpec, with_state: bool, about: dict[str, str]
) -> Callable[[], dict[str, Any]]:
    """Provenance, on access: writing the scene takes longer than a short run."""
    scene = system.scene  # a result must not keep its system alive
    controller = system.model.python_control
    python = controller is not None and not controller.in_scene
    control = "python function" if python else scene.control.kind
    sampling = system.model.sampling if python else None  # a scene has its own keys
    times = (
        {} if sampling is None else {"sample_time": sampling.time, "sample_delay": sampling.delay}
    )
    start, created = "given state" if with_state else "scene", time.time()
    limits = {
        name: limits_record(arm.effort_limits, arm.velocity_limits, arm.position_limits)
        for name, arm in system.arms.items()
    }

    def metadata() -> dict[str, Any]:
        text = dump_scene(scene.model_copy(update={"run": spec}))
        of_run = {"control": control, **times, "start": start, LIMITS: limits}
        return {**provenance(text, created), **of_run, **about}

    return metadata
