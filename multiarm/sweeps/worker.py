"""What a worker does: it simulates a job and returns its record.

A run is a pure function of (scene, values).  Every worker compiles the scene of the sweep once and
makes the system of each run from it, never from the system of the previous run, so that a run gives
the same numbers on every worker and in every order.
"""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.errors import USER_FAULTS, MultiarmError, SweepError
from multiarm.results.trajectory import Trajectory
from multiarm.scene import REGISTRIES, Scene, parse_scene
from multiarm.scene.code import is_reference
from multiarm.simulation.certified import INTERRUPTED, INTERRUPTED_WORDS
from multiarm.simulation.simulate import simulate
from multiarm.sweeps.plan import Job, Record, SweepPlan, program_version
from multiarm.sweeps.quantities import Quantity, measure

__all__ = ["JobContext", "run_job", "run_jobs", "simulate_run", "warm_up"]


@dataclass(frozen=True)
class JobContext:
    """What all jobs of a sweep share; it is sent to the workers."""

    scene: str  # as YAML text
    quantities: tuple[Quantity, ...]
    certificate: bool  # check runs of some accuracy
    version: str  # of multiarm: another one may give other numbers
    # user classes that were registered in the process that began the sweep, and where
    classes: tuple[tuple[str, type], ...] = ()
    folder: str | None = None  # where relative paths of the scene, and of values in it, start
    # unique to each call of `multiarm.sweep`: files that the scene names may have changed since an
    # earlier call, whose compiled scene a worker may still hold
    session: str = ""

    @classmethod
    def of(cls, plan: SweepPlan, session: str = "") -> JobContext:
        """The context of a plan."""
        return cls(
            scene=plan.scene_text,
            quantities=plan.quantities,
            certificate=plan.spec.certificate,
            version=program_version(),
            classes=tuple(
                (own.group, one)
                for own in REGISTRIES
                for name, one in own.registered.items()
                if name in plan.words and not is_reference(name)  # files are read by each worker
            ),
            folder=str(plan.scene.folder),
            session=session,
        )


def run_jobs(context: JobContext, jobs: Sequence[Job]) -> list[Record]:
    """Carry out some jobs, one after the other.

    Raises
    ------
    SweepError
        When this worker has another version of multiarm.
    KeyboardInterrupt
        When Ctrl-C was pressed: these jobs are lost and are repeated when the sweep is resumed.
    """
    here = program_version()
    if context.version != here:
        raise SweepError(
            f"worker {_worker()} has multiarm {here}, the sweep was begun by "
            f"{context.version}; install the same version everywhere: others may give other numbers"
        )
    warm_up(context)  # loads the libraries whose threads are limited below
    with threadpool_limits(1):  # workers share the processors already
        return [run_job(context, job) for job in jobs]


def warm_up(context: JobContext) -> None:
    """Compile the scene of a sweep in this process and load the libraries of a run.

    Raises
    ------
    SceneError
        When the scene cannot be read here.
    """
    _base(context)


def run_job(context: JobContext, job: Job) -> Record:
    """Carry out one job.

    Returns
    -------
    Record
        A run that fails gives one too.

    Raises
    ------
    KeyboardInterrupt
        When Ctrl-C was pressed: a part of a run is no result.
    """
    warm_up(context)
    began = time.perf_counter()
    numbers: dict[str, float | None] = dict.fromkeys([own.name for own in context.quantities])
    try:
        trajectory = _simulated(context, job.values)
        status, message = trajectory.status, trajectory.message
        _raise_interrupt(trajectory)
        if status == "completed":
            numbers, fault = measure(context.quantities, trajectory)
            status, message = ("failed", fault) if fault else (status, message)
    except MultiarmError as error:
        status, message = "failed", f"the run could not begin: {error}"
    except USER_FAULTS as error:  # user-defined functions and effects may raise anything
        status, message = "failed", f"the run broke off: {type(error).__name__}: {error}"
    wall = time.perf_counter() - began
    return Record(job.run, status, message, job.values, numbers, wall, _worker())


def simulate_run(plan: SweepPlan, run: int) -> Trajectory:
    """Simulate one run of a plan as a worker does; returns all samples.

    Raises
    ------
    MultiarmError
        When it cannot begin.
    """
    system = compile_system(plan.scene_of(run))  # not cached: files that it names may have changed
    with threadpool_limits(1):
        return simulate(system, certificate=plan.spec.certificate)


def _simulated(context: JobContext, values: Mapping[str, Any]) -> Trajectory:
    base = _base(context)
    system = compile_system(base.scene.replace(values), like=base.system)
    return simulate(system, certificate=context.certificate)


@dataclass(frozen=True)
class _Base:
    """The scene of a sweep and its system; None if it compiles only with a run's values."""

    scene: Scene
    system: System | None


# The scene that a worker compiled last.  Clusters run several threads in a process, and the arrays
# of a system serve one thread.
_memory = threading.local()


def _base(context: JobContext) -> _Base:
    """The compiled scene; a short run compiles or loads whatever the first use of it needs."""
    key = context.scene, context.session, context.classes
    if getattr(_memory, "key", None) == key:
        return _memory.base
    registries = {own.group: own for own in REGISTRIES}
    for group, one in context.classes:
        registries[group].add(one)
    scene = parse_scene(context.scene, context.folder)
    system: System | None = None
    try:
        system = compile_system(scene)
        short = min(scene.run.duration, scene.run.output_step)
        _raise_interrupt(simulate(system, short, certificate=False))
    except USER_FAULTS:
        pass  # every run that has this fault reports it
    _memory.key, _memory.base = key, _Base(scene, system)
    return _memory.base


def _raise_interrupt(trajectory: Trajectory) -> None:
    """Raise if Ctrl-C ended the run or its check: then there is no result."""
    reason = (trajectory.certificate or {}).get("reason")
    unchecked = trajectory.message.endswith(INTERRUPTED_WORDS)
    if unchecked or INTERRUPTED in (trajectory.status, reason):
        raise KeyboardInterrupt


def _worker() -> str:
    return f"{platform.node()}:{os.getpid()}"
