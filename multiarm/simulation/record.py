"""What a result says about its run besides the samples: provenance and statistics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from multiarm.dynamics.system import System
from multiarm.results.channels import NAMES_OF_OBJECTS
from multiarm.results.limit_use import LIMITS, limits_record
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import Sink, provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import RunSpec, dump_scene
from multiarm.simulation.driver import Driver


@dataclass(frozen=True)
class RunStatistics:
    """What a run has taken so far; the fields are the keys of `Trajectory.statistics`.

    None stands for what a run does not have: a tolerance of fixed steps, ranks before the first
    step.  The counts of control samples and contact events are left out where there can be none.
    """

    integrator: str  # with which it ended
    solver: str
    arms: Mapping[str, str]  # arm -> who computes its terms
    not_compiled: Mapping[str, str]  # arm -> why it is not compiled
    stabilization: str
    accuracy: float | Mapping[str, float] | None  # as it is written in the scene
    tolerance: float | None  # smallest of one step
    start_time_s: float
    simulated_s: float
    steps: int
    ambiguous_steps: int  # at whose end friction leaves the motion open
    rejected_steps: int
    evaluations: int
    projections: int
    smallest_step_s: float | None
    largest_step_s: float | None
    error_estimate: float | None  # sum over the steps [m, rad]
    coupled_steps: int  # at whose end some arms were not eliminated as a whole
    lowest_rank: int | None
    highest_rank: int | None
    residual_max: float
    correction_max: float
    contact_events: int | None
    complementarity_residual: float | None
    impulse_steps: int | None
    impulse_time_s: float | None
    control_samples: int | None
    wall_time_s: float  # without compilation
    compile_time_s: float
    realtime_factor: float | None

    def as_dict(self) -> dict[str, Any]:
        """The statistics as results have them."""
        optional = (
            "contact_events",
            "complementarity_residual",
            "impulse_steps",
            "impulse_time_s",
            "control_samples",
        )
        return {k: v for k, v in vars(self).items() if v is not None or k not in optional}


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


def run_statistics(driver: Driver) -> RunStatistics:
    """What a run has taken so far."""
    task, run, events, wall = driver.task, driver.run, driver.events, driver.wall
    sampling = task.data.model.sampling
    clock, settings, spec = run.clock, run.settings, task.spec
    backends = task.data.model.backends
    simulated = clock.t - settings.begin
    return RunStatistics(
        integrator=run.stepping.tableau.name,
        solver=spec.solver,
        arms=backends.by_robot,
        not_compiled=backends.reasons,
        stabilization=spec.stabilization.kind,
        accuracy=None if spec.accuracy is None else spec.accuracy.written,
        tolerance=settings.tolerance if settings.adaptive else None,
        start_time_s=settings.begin,
        simulated_s=simulated,
        steps=clock.steps,
        ambiguous_steps=clock.ambiguous_steps,
        rejected_steps=clock.rejected,
        evaluations=clock.evaluations,
        projections=clock.projections,
        smallest_step_s=clock.smallest_step if clock.steps else None,
        largest_step_s=clock.largest_step if clock.steps else None,
        error_estimate=clock.error_sum if settings.adaptive else None,
        coupled_steps=clock.coupled_steps,
        lowest_rank=clock.lowest_rank if clock.steps else None,
        highest_rank=clock.highest_rank if clock.steps else None,
        residual_max=clock.worst_residual,
        correction_max=clock.worst_correction,
        contact_events=None if events is None else events.count,
        complementarity_residual=None if events is None else events.residual,
        impulse_steps=None if events is None else events.impulse_steps,
        impulse_time_s=None if events is None else events.impulse_time,
        control_samples=None if sampling is None else clock.control_samples,
        wall_time_s=wall,
        compile_time_s=driver.compilation,
        realtime_factor=simulated / wall if wall > 0.0 else None,
    )


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
    objects = list(system.model.layout.objects)
    limits = {
        name: limits_record(arm.effort_limits, arm.velocity_limits, arm.position_limits)
        for name, arm in system.arms.items()
    }

    def metadata() -> dict[str, Any]:
        text = dump_scene(scene.model_copy(update={"run": spec}))
        of_run = {"control": control, **times, "start": start, LIMITS: limits}
        of_run |= {NAMES_OF_OBJECTS: objects}
        return {**provenance(text, created), **of_run, **about}

    return metadata
