"""What a worker does: a run from its number and values to its row, and nothing besides.

A run is a pure function of (scene, values).  Every worker compiles the scene of the sweep once and
makes the system of each run from it, never from that of the run before, so that the same run gives
the same numbers in any company and in any order.
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
from multiarm.scene import Scene, changed, parse_path, parse_scene
from multiarm.scene.effects import register_effect
from multiarm.scene.registry import registered_effects
from multiarm.simulation.certified import INTERRUPTED, INTERRUPTED_WORDS
from multiarm.simulation.simulate import simulate
from multiarm.sweeps.plan import SweepPlan, program_version
from multiarm.sweeps.quantities import Quantity, measure
from multiarm.sweeps.row import Row

__all__ = ["Job", "Work", "perform", "perform_all", "simulate_run", "warm"]


@dataclass(frozen=True)
class Job:
    """One run: its number, and what is other in its scene."""

    run: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Work:
    """What all runs of a sweep have in common; made to be sent to workers.

    Attributes
    ----------
    scene : str
        As YAML text.
    quantities : tuple of Quantity
    certificate : bool
        Runs of some accuracy are checked.
    effects : tuple of type
        Effects of the user's that were registered where the sweep was begun.
    version : str
        Of multiarm: another one may give other numbers.
    folder : str
        Where relative paths of the scene, and of values in it, start.
    session : str
        A new one for each sweep that is begun: files that the scene names may have changed since
        the last one, which a worker may remember.
    """

    scene: str
    quantities: tuple[Quantity, ...]
    certificate: bool
    version: str
    effects: tuple[type, ...] = ()
    folder: str | None = None
    session: str = ""

    @classmethod
    def of(cls, plan: SweepPlan, session: str = "") -> Work:
        """The work of a plan."""
        named = {*(plan.scene.effects.model_extra or {})}
        for path in plan.paths:  # one may be named by the sweep alone
            named |= {part for part in parse_path(path) if isinstance(part, str)}
        return cls(
            scene=plan.scene_text,
            quantities=plan.quantities,
            certificate=plan.spec.certificate,
            version=program_version(),
            effects=tuple(one for one in registered_effects() if one.name in named),  # type: ignore[attr-defined]
            folder=str(plan.scene.folder),
            session=session,
        )


def perform_all(work: Work, jobs: Sequence[Job]) -> list[Row]:
    """Carry out some runs, one after the other.

    Raises
    ------
    SweepError
        When this worker has another version of multiarm.
    KeyboardInterrupt
        When Ctrl-C was pressed: what was done is lost, and is done again some day.
    """
    here = program_version()
    if work.version != here:
        raise SweepError(
            f"worker {_worker()} has multiarm {here}, the sweep was begun by "
            f"{work.version}; install the same version everywhere: others may give other numbers"
        )
    warm(work)  # which loads the libraries that are limited now
    with threadpool_limits(1):  # workers share the processors already
        return [perform(work, job) for job in jobs]


def warm(work: Work) -> None:
    """Compile the scene of a sweep in this process, and load what a run needs.

    Raises
    ------
    SceneError
        When the scene cannot be read here.
    """
    _base(work)


def perform(work: Work, job: Job) -> Row:
    """Carry out one run.

    Returns
    -------
    Row
        Of a run that fails too, whatever went wrong.

    Raises
    ------
    KeyboardInterrupt
        When Ctrl-C was pressed: a part of a run is no result.
    """
    warm(work)
    began = time.perf_counter()
    numbers: dict[str, float | None] = dict.fromkeys([own.name for own in work.quantities])
    try:
        trajectory = _simulated(work, job.values)
        status, message = trajectory.status, trajectory.message
        _raise_interrupt(trajectory)
        if status == "completed":
            numbers, fault = measure(work.quantities, trajectory)
            status, message = ("failed", fault) if fault else (status, message)
    except MultiarmError as error:
        status, message = "failed", f"the run could not begin: {error}"
    except USER_FAULTS as error:  # functions and effects of the user's may do anything
        status, message = "failed", f"the run broke off: {type(error).__name__}: {error}"
    wall = time.perf_counter() - began
    return Row(job.run, status, message, job.values, numbers, wall, _worker())


def simulate_run(plan: SweepPlan, run: int) -> Trajectory:
    """One run of a plan, as a worker carries it out, with all its samples.

    Raises
    ------
    MultiarmError
        When it cannot begin.
    """
    system = compile_system(plan.scene_of(run))  # files that it names may be others than before
    with threadpool_limits(1):
        return simulate(system, certificate=plan.spec.certificate)


def _simulated(work: Work, values: Mapping[str, Any]) -> Trajectory:
    base = _base(work)
    system = compile_system(changed(base.scene, values), like=base.system)
    return simulate(system, certificate=work.certificate)


@dataclass(frozen=True)
class _Base:
    """The scene of a sweep and its system; None where it cannot be compiled without changes."""

    scene: Scene
    system: System | None


# A worker's memory: the scene that it compiled last. Clusters run several threads in a process, and
# the arrays of a system are for one of them.
_memory = threading.local()


def _base(work: Work) -> _Base:
    """The compiled scene; a short run warms up what is compiled or loaded when it is first used."""
    key = work.scene, work.session, work.effects
    if getattr(_memory, "key", None) == key:
        return _memory.base
    for effect in work.effects:
        register_effect(effect)
    scene = parse_scene(work.scene, work.folder)
    system: System | None = None
    try:
        system = compile_system(scene)
        short = min(scene.run.duration, scene.run.output_step)
        _raise_interrupt(simulate(system, short, certificate=False))
    except USER_FAULTS:
        pass  # what is wrong is told by every run that meets it
    _memory.key, _memory.base = key, _Base(scene, system)
    return _memory.base


def _raise_interrupt(trajectory: Trajectory) -> None:
    """Let Ctrl-C act: a run that it ended, or whose check it ended, is no result."""
    reason = (trajectory.certificate or {}).get("reason")
    unchecked = trajectory.message.endswith(INTERRUPTED_WORDS)
    if unchecked or INTERRUPTED in (trajectory.status, reason):
        raise KeyboardInterrupt


def _worker() -> str:
    return f"{platform.node()}:{os.getpid()}"
