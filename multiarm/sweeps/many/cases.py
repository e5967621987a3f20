"""One of many runs: its description, which any thread or process can carry out, and its result."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, MultiarmError, TrajectoryError
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.scene import STEPS_CHOSEN_BY, RunSpec, Scene, changed_scenes
from multiarm.simulation.run import leave_undone
from multiarm.simulation.setup import positive, run_spec
from multiarm.simulation.simulate import simulate
from multiarm.sweeps.many.files import run_files


@dataclass(frozen=True)
class Case:
    """What is to be run.

    Attributes
    ----------
    number : int
        From 1 on.
    scene : Scene
    state : State or None
        Where to begin; None: the scene's start.
    out : Path or None
        File of the samples; None: they are kept in memory.
    options : mapping
        Further keywords of :func:`multiarm.simulate`.
    """

    number: int
    scene: Scene
    state: State | None
    out: Path | None
    options: Mapping[str, Any]


def describe(
    system: System,
    states: Iterable[State] | None,
    parameters: Iterable[Mapping[str, Any]] | None,
    out: str | os.PathLike | None,
    options: Mapping[str, Any],
) -> list[Case]:
    """The cases that :func:`multiarm.simulate_many` is asked for, checked before any begins.

    Raises
    ------
    SceneError
        Naming all faults of all parameters, or what contradicts itself in the settings.
    ModelError
        States that are none, or belong to another system; other numbers of states and parameters.
    TrajectoryError
        A result cannot be written.
    """
    if states is None and parameters is None:
        raise ModelError("simulate_many needs `states`, `parameters`, or as many of one as of both")
    if isinstance(parameters, Mapping):
        raise ModelError("parameters is one table; give a list of tables, one for each run")
    starts = None if states is None else list(states)
    tables = None if parameters is None else list(parameters)
    if starts is not None and tables is not None and len(starts) != len(tables):
        raise ModelError(
            f"there are {len(starts)} states and {len(tables)} sets of parameters; give one of "
            "each for every run, or leave one of the two out"
        )
    count = len(starts if starts is not None else tables or ())
    _check_states(system, starts or [], tables is None)
    scenes = [system.scene] * count if tables is None else changed_scenes(system.scene, tables)
    _check_settings(scenes if tables is not None else [system.scene], options)
    files = run_files(out, count)
    return [
        Case(k + 1, scenes[k], None if starts is None else starts[k], files[k], options)
        for k in range(count)
    ]


def run_case(case: Case, system: System, progress: Callable[[float], None] | None) -> Trajectory:
    """Carry out a case on a system that serves this thread alone.

    Parameters
    ----------
    case : Case
    system : System
        Of the case's scene, or of a similar one.
    progress : callable, optional
        As :func:`multiarm.simulate` calls it.

    Returns
    -------
    Trajectory
        One that cannot begin is failed, and has no samples.
    """
    try:
        if case.scene is not system.scene:
            system = compile_system(case.scene, _control_of(system), like=system)
        return simulate(
            system, state=case.state, out=case.out, progress=progress, **case.options
        ).close_between_reads()
    except MultiarmError as error:
        return undone(case, system, "failed", f"the run could not begin: {error}")


def _control_of(system: System) -> ControlFunction | None:
    control = system.model.python_control
    return None if control is None else control.function


def undone(case: Case, system: System, status: str, message: str, keep: bool = True) -> Trajectory:
    """The result of a case that did not begin; ``keep`` a file of it, where there is to be one."""
    own, given = replace(system, scene=case.scene), case.state is not None
    if case.out is not None and keep:
        try:
            sink = Hdf5Sink(case.out)
            return leave_undone(own, given, sink, status, message).close_between_reads()
        except TrajectoryError:
            pass  # which may be why it could not begin
    return leave_undone(own, given, MemorySink(), status, message)


def _check_states(system: System, states: list[Any], same_arms: bool) -> None:
    faults = []
    for number, state in enumerate(states, start=1):
        if not isinstance(state, State):
            faults.append(f"run {number}: {type(state).__name__} is no state")
        elif not (np.all(np.isfinite(state.position)) and np.all(np.isfinite(state.velocity))):
            faults.append(f"run {number}: the state is not finite")
        elif same_arms and not state.layout.same_joints(system.model.layout):
            arms = ", ".join(state.layout.names)
            faults.append(f"run {number}: the state belongs to a system with arms {arms}")
    if faults:
        lines = "\n".join(f"  {fault}" for fault in faults)
        raise ModelError(f"states: make them with `system.state(...)`:\n{lines}")


def _check_settings(scenes: list[Scene], options: Mapping[str, Any]) -> None:
    def given(*names: str) -> dict[str, Any]:
        return {name: options.get(name) for name in names}

    changes = given("duration", "stabilization", "output_step")
    choice = given(*STEPS_CHOSEN_BY)
    checked: list[RunSpec] = []
    for scene in scenes:
        if not any(scene.run is run for run in checked):
            run_spec(scene.run, changes, choice, options.get("solver"))
            checked.append(scene.run)
    if options.get("max_step") is not None:
        positive("max_step", options["max_step"])
