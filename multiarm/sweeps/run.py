"""One run of a sweep, as any worker carries it out.

A run is a pure function of the scene and its values.  Every worker compiles the scene of the sweep
once and makes the system of each run from it, never from the system of the previous run, so that a
run gives the same numbers on every worker and in every order.
"""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any
from uuid import uuid4

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.errors import USER_FAULTS, MultiarmError, SweepError
from multiarm.results.files import printable
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import provenance
from multiarm.results.trajectory import Trajectory
from multiarm.scene import REGISTRIES, Scene, dump_scene, parse_scene, with_code
from multiarm.scene.code import CodeReference, is_reference, load_function
from multiarm.simulation.certificate import Reason
from multiarm.simulation.simulate import simulate
from multiarm.sweeps.plan import SweepPlan
from multiarm.sweeps.quantities import UserQuantity, measure
from multiarm.threads import one_thread

Row = dict[str, Any]
"""What a sweep stores of one run: column -> entry, without the values; what is missing is left out.

A run that was simulated is "failed" too if a quantity of the user's raised an error.
"""


@dataclass(frozen=True)
class Context:
    """What all runs of a sweep share; it is sent to the workers."""

    scene: str  # as YAML text
    folder: str  # where relative paths of the scene, and of values in it, start
    code: bool  # whether workers may load code that the scene, and values in it, name
    keep: tuple[str | UserQuantity, ...]
    quantities: tuple[str, ...]  # the columns of their numbers
    certificate: bool  # check runs of some accuracy
    version: str  # of multiarm: another one may give other numbers
    # user classes that were registered in the process that began the sweep, and where
    classes: tuple[tuple[str, type], ...]
    # a worker may still hold the scene of an earlier sweep, whose files may have changed since
    session: str = field(default_factory=lambda: uuid4().hex)

    @classmethod
    def of(cls, plan: SweepPlan) -> Context:
        """The context of a plan."""
        return cls(
            scene=dump_scene(plan.scene),
            folder=str(plan.scene.folder),
            code=plan.scene.may_load_code,
            keep=plan.spec.keep,
            quantities=tuple(column.name for column in plan.spec.quantities),
            certificate=plan.spec.certificate,
            version=program_version(),
            classes=tuple(_registered_classes(plan)),
        )


def _registered_classes(plan: SweepPlan) -> Iterator[tuple[str, type]]:
    """The registered classes that the scenes of a plan name, without those in files."""
    for registry in REGISTRIES:
        for name, kind in registry.registered.items():
            if name in plan.kinds and not is_reference(name):  # each worker reads files for itself
                yield registry.group, kind


def run(context: Context, number: int, values: Mapping[str, Any]) -> Row:
    """Carry out one run and return its row.

    Raises
    ------
    SweepError
        When this worker has another version of multiarm.
    KeyboardInterrupt
        When Ctrl-C was pressed: a part of a run is no result.
    """
    base = prepare(context)  # loads the libraries whose threads are limited below
    began = time.perf_counter()
    numbers: Row = {}
    try:
        with one_thread():  # workers share the processors already
            trajectory = _simulated(context, base, values)
        status, message = trajectory.status, trajectory.message
        if status == RunStatus.COMPLETED:
            measured, fault = measure(context.keep, trajectory, base.load)
            numbers = dict(zip(context.quantities, measured.values(), strict=True))
            status, message = (RunStatus.FAILED, fault) if fault else (status, message)
    except MultiarmError as error:
        status, message = RunStatus.FAILED, f"the run could not begin: {error}"
    except USER_FAULTS as error:  # user-defined functions and effects may raise anything
        status, message = RunStatus.FAILED, f"the run broke off: {type(error).__name__}: {error}"
    return {
        "run": number,
        "status": status,
        "message": printable(message),
        **numbers,
        "wall_time": time.perf_counter() - began,
        "worker": _worker(),
    }


def lost_run(number: int) -> Row:
    """The row of a run whose workers died every time."""
    message = (
        "its worker died every time: the process was ended, by lack of memory perhaps, or broke "
        "down in compiled code"
    )
    return {
        "run": number,
        "status": RunStatus.FAILED,
        "message": message,
        "wall_time": 0.0,
        "worker": "",
    }


def simulate_run(scene: Scene, certificate: bool) -> Trajectory:
    """Simulate the scene of a run as a worker does; returns all samples.

    Raises
    ------
    MultiarmError
        When it cannot begin.
    """
    system = compile_system(scene)
    with one_thread():
        return simulate(system, certificate=certificate)


@dataclass(frozen=True)
class Base:
    """What a worker makes its runs from."""

    session: str
    scene: Scene
    system: System | None  # None if it compiles only with a run's values
    load: Callable[[Any], Callable]  # of functions that are named, once each


# Clusters run several threads in a process, and the arrays of a system serve one thread.
_memory = threading.local()


def prepare(context: Context) -> Base:
    """Compile the scene of a sweep in this process and load the libraries of a run.

    Raises
    ------
    SceneError
        When the scene cannot be read here.
    SweepError
        When this worker has another version of multiarm.
    """
    base: Base | None = getattr(_memory, "base", None)
    if base is not None and base.session == context.session:
        return base
    here = program_version()
    if context.version != here:
        raise SweepError(
            f"worker {_worker()} has multiarm {here}, the sweep was begun by "
            f"{context.version}; install the same version everywhere: others may give other numbers"
        )
    registries = {registry.group: registry for registry in REGISTRIES}
    for group, kind in context.classes:
        registries[group].add(kind)
    scene = parse_scene(context.scene, context.folder, context.code)
    system: System | None = None
    try:
        scene = with_code(scene)  # once, not for every run
        system = compile_system(scene)
        # compiles or loads whatever the first use of it needs
        short = min(scene.run.duration, scene.run.output_step)
        _raise_interrupt(simulate(system, short, certificate=False))
    except USER_FAULTS:
        pass  # every run that has this fault reports it
    load = cache(load_function)

    def loaded(function: Callable | CodeReference) -> Callable:
        return load(function) if isinstance(function, CodeReference) else function

    _memory.base = Base(context.session, scene, system, loaded)
    return _memory.base


def _simulated(context: Context, base: Base, values: Mapping[str, Any]) -> Trajectory:
    system = compile_system(base.scene.replace(values), like=base.system)
    trajectory = simulate(system, certificate=context.certificate)
    _raise_interrupt(trajectory)
    by_accuracy = system.scene.run.accuracy is not None
    if context.certificate and by_accuracy and trajectory.status == RunStatus.COMPLETED:
        certificate = trajectory.certificate
        if certificate is None or certificate.get("reason") == Reason.INTERRUPTED:
            raise KeyboardInterrupt  # Ctrl-C ended the check of the run
    return trajectory


def _raise_interrupt(trajectory: Trajectory) -> None:
    """Raise if Ctrl-C ended the run: then there is no result."""
    if trajectory.status == RunStatus.INTERRUPTED:
        raise KeyboardInterrupt


def program_version() -> str:
    """The version of multiarm."""
    return provenance("")["version"]


def _worker() -> str:
    return f"{platform.node()}:{os.getpid()}"
