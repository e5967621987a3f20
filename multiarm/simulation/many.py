"""`simulate_many`: many runs of one scene, from other starts or with other values, in threads.

The compiled time loop releases the GIL; Python code, around a run and wherever a run calls it, is
executed by one thread at a time.  Every run borrows its own Data of the system, so that it gives
the same numbers in whichever thread it runs.

The calling thread polls the progress of the runs and Ctrl-C.  After Ctrl-C the active runs end with
their samples, and no other run begins.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.state import State, require_same_joints
from multiarm.dynamics.system import System, require_control, require_state, require_system
from multiarm.errors import ModelError, MultiarmError, TrajectoryError
from multiarm.jit.ahead import processors
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.scene import STEPS_CHOSEN_BY, AccuracySpec, Scene, changed_scenes
from multiarm.scene.faults import shown
from multiarm.scene.values import is_integer
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.simulation.record import leave_undone
from multiarm.simulation.setup import positive, run_spec
from multiarm.simulation.simulate import simulate
from multiarm.terminal.progress import ManyRunsProgress, displayed

POLL = 0.05
"""[s] between two polls of progress and Ctrl-C."""

ManyProgress = Callable[[float, int], None]


def simulate_many(
    system: System,
    duration: float | None = None,
    *,
    states: Iterable[State] | None = None,
    parameters: Iterable[Mapping[str, Any]] | None = None,
    threads: int | None = None,
    progress: bool | ManyProgress | None = None,
    out: str | os.PathLike | None = None,
    accuracy: float | Mapping[str, float] | AccuracySpec | None = None,
    integrator: str | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    stabilization: str | dict | None = None,
    output_step: float | None = None,
    max_step: float | None = None,
    solver: str | None = None,
    control: ControlFunction | None = None,
    sample_time: float | None = None,
    sample_delay: bool = False,
    certificate: bool = True,
) -> list[Trajectory]:
    """Simulate a system many times in several threads: from other starts, with other values.

    Every run gives the same numbers as :func:`multiarm.simulate`, bit for bit, with any number of
    threads.

    Parameters
    ----------
    system : System
        Its own Data is not used, so that it may be evaluated meanwhile.
    duration : float, optional
        [s]
    states : list of State, optional
        Where the runs begin; by default the scene's start.
    parameters : list of dict, optional
        Changes of the scene for each run, by path: ``{"object.mass": 10.0,
        "arms.left.base.xyz[2]": 0.1, "joints[1].at.xyz": [0.6, 0, 0]}``.  Paths are written as in
        error messages.  Naming one of ``run.accuracy``, ``run.integrator``, ``run.step`` and
        ``run.tolerance`` replaces the scene's choice of all four.  If ``states`` is given too, both
        lists have one entry for each run.
    threads : int, optional
        Number of simultaneous runs.  By default the number of processors, or one if evaluations of
        ``system`` call Python: Pinocchio's arm terms, the dense solver, user-defined controllers,
        effects and surfaces.  Such threads only wait for each other, and so do runs whose loop
        takes less than half a millisecond.
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called repeatedly in the calling thread with the simulated time of all runs together [s] and
        the number of finished runs; it may raise ``KeyboardInterrupt`` to end them all.
    out : path-like, optional
        Samples are streamed to HDF5 files ``run_0001.h5`` and so on in this folder, or to files of
        a pattern such as ``"runs/box_{:03d}.h5"``.  Memory then does not grow with the runs.
    accuracy, integrator, step, tolerance, stabilization, output_step, max_step, solver, certificate
        As in :func:`multiarm.simulate`, for all runs.
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control.  One function serves all
        runs and is called from several threads: it must not keep state between calls.  The same
        holds for functions that a scene names; user-defined effects have one instance per thread.
    sample_time, sample_delay
        Of ``control``, as in :func:`multiarm.simulate`.

    Returns
    -------
    list of Trajectory
        In the order of the runs.  A run that fails or cannot begin (a start that violates the
        joints, an unusable robot) has status "failed".  After Ctrl-C, active runs have status
        "interrupted" and the samples so far, those that had not begun have no samples, and finished
        runs are complete.

    Raises
    ------
    SceneError
        When parameters are wrong (the message lists all faults of all runs), or settings contradict
        each other.
    ModelError
        When ``states`` are not states of this system, or ``threads`` is not a positive integer.
    TrajectoryError
        When ``out`` is neither a folder nor such a pattern, or cannot be written.
    """
    options = {
        "duration": duration,
        "accuracy": accuracy,
        "integrator": integrator,
        "step": step,
        "tolerance": tolerance,
        "stabilization": stabilization,
        "output_step": output_step,
        "max_step": max_step,
        "solver": solver,
        "control": control,
        "sample_time": sample_time,
        "sample_delay": sample_delay,
        "certificate": certificate,
    }
    system = require_system(system, "ma.simulate_many(system)")
    require_control(control, sample_time, sample_delay)
    threads = _threads(threads, system, control)
    cases = describe(system, states, parameters, out, options)
    ends = (case.scene.run.duration if duration is None else duration for case in cases)
    with displayed(progress, lambda: ManyRunsProgress(len(cases), sum(ends))) as show:
        return run_cases(cases, system, threads, show)


def _threads(threads: int | None, system: System, control: ControlFunction | None) -> int:
    if threads is None and (control is not None or system.model.calls_python):
        return 1
    if threads is None:
        return processors()
    if not is_integer(threads) or threads < 1:
        raise ModelError(f"threads: must be a number from 1 on, got {threads!r}")
    return threads


@dataclass(frozen=True)
class Case:
    """The description of one run, which any thread can carry out."""

    scene: Scene
    state: State | None  # None: the scene's start
    out: Path | None  # file of the samples; None: memory
    options: Mapping[str, Any]  # further keywords of `multiarm.simulate`


def describe(
    system: System,
    states: Iterable[State] | None,
    parameters: Iterable[Mapping[str, Any]] | None,
    out: str | os.PathLike | None,
    options: Mapping[str, Any],
) -> list[Case]:
    """The cases of a call of :func:`simulate_many`, all checked before the first one begins."""
    if states is None and parameters is None:
        raise ModelError("simulate_many needs `states`, `parameters`, or equally many of both")
    if isinstance(states, State):
        raise ModelError("states is one state; give a list of states, one for each run")
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
        Case(scenes[k], None if starts is None else starts[k], files[k], options)
        for k in range(count)
    ]


def run_case(case: Case, system: System, progress: Callable[[float], None] | None) -> Trajectory:
    """Carry out a case in this thread; ``system`` is of its scene, or of a similar one.

    A case that cannot begin gives a trajectory with status "failed" and no samples.
    """
    try:
        if case.scene is not system.scene:
            system = _compiled(case.scene, system)
        return simulate(
            system, state=case.state, out=case.out, progress=progress, **case.options
        ).close_between_reads()
    except MultiarmError as error:
        return empty_result(case, system, RunStatus.FAILED, f"the run could not begin: {error}")


def _compiled(scene: Scene, like: System) -> System:
    """The system of a similar scene, with a controller in Python that is not the scene's."""
    control, sampling = like.model.python_control, like.model.sampling
    if control is None or control.in_scene:
        return compile_system(scene, like=like)
    time, delay = (None, False) if sampling is None else (sampling.time, sampling.delay)
    return compile_system(scene, control.function, sample_time=time, sample_delay=delay, like=like)


def empty_result(
    case: Case, system: System, status: RunStatus, message: str, write: bool = True
) -> Trajectory:
    """The result of a case that did not begin; ``write`` it to its file if it has one."""
    system, with_state = replace(system, scene=case.scene), case.state is not None
    if case.out is not None and write:
        try:
            sink = Hdf5Sink(case.out)
            return leave_undone(system, with_state, sink, status, message).close_between_reads()
        except TrajectoryError:
            pass  # which may be why it could not begin
    return leave_undone(system, with_state, MemorySink(), status, message)


def _check_states(system: System, states: list[Any], same_arms: bool) -> None:
    faults = []
    for number, state in enumerate(states, start=1):
        try:
            require_state(state)
            if same_arms:
                require_same_joints(state, system.model.layout)
        except ModelError as error:
            faults.append(f"\n  run {number}: {error}")
    if faults:
        raise ModelError(f"states:{''.join(faults)}")


def _check_settings(scenes: list[Scene], options: Mapping[str, Any]) -> None:
    names = ("duration", "stabilization", "output_step", "solver", *STEPS_CHOSEN_BY)
    settings = {name: options.get(name) for name in names}
    for run in {id(scene.run): scene.run for scene in scenes}.values():
        run_spec(run, settings)
    if options.get("max_step") is not None:
        positive("max_step", options["max_step"], or_infinite=True)


def run_cases(
    cases: Sequence[Case], system: System, threads: int, progress: ManyProgress
) -> list[Trajectory]:
    """Carry out all cases, of the system's scene or of changes of it; results are in their order.

    An error of the program, not of a run, is raised after the other runs have ended.
    """
    waiting, stopped = enumerate(cases), threading.Event()
    results: list[Trajectory | None] = [None] * len(cases)
    times = [0.0] * len(cases)  # simulated time of each run [s]

    def work() -> None:
        for k, case in waiting:  # one iterator of all threads: each case is taken once
            if stopped.is_set():
                return
            try:
                results[k] = run_case(case, system, _Progress(times, k, stopped))
            except BaseException:
                stopped.set()
                raise

    def report() -> None:
        try:
            progress(sum(times), sum(result is not None for result in results))
        except KeyboardInterrupt:
            stopped.set()

    count = max(1, min(threads, len(cases)))
    with deferred_interrupt() as interrupt:
        with ThreadPoolExecutor(count, "multiarm") as pool:
            try:
                workers = [pool.submit(work) for _ in range(count)]
                while wait(workers, POLL).not_done:
                    if interrupt.pressed:
                        stopped.set()
                    report()
            finally:
                stopped.set()  # else the pool would wait for all remaining cases
        for worker in workers:
            worker.result()
        report()
    never = RunStatus.INTERRUPTED, "stopped by the user before it began"
    runs = [
        empty_result(case, system, *never, write=False) if result is None else result
        for case, result in zip(cases, results, strict=True)
    ]
    if all(run.status != RunStatus.INTERRUPTED for run in runs):
        interrupt.deliver()  # it came too late to end a run
    return runs


class _Progress:
    """The progress callback of one run: notes its time, and ends it when all runs are to end."""

    def __init__(self, times: list[float], number: int, stopped: threading.Event) -> None:
        self._times, self._number, self._stopped = times, number, stopped

    def __call__(self, t: float) -> None:
        self._times[self._number] = t
        self.checking(t, 0)

    def checking(self, _t: float, _number: int) -> None:
        """Called while the run's accuracy is checked."""
        if self._stopped.is_set():
            raise KeyboardInterrupt


def run_files(out: str | os.PathLike | None, count: int) -> list[Path | None]:
    """One file for each run, from ``out`` of :func:`simulate_many`; folders are created.

    Raises
    ------
    TrajectoryError
        ``out`` is no path, or a pattern that does not name a file for each run; a file cannot be
        written, or exists and was not written by multiarm.
    """
    if out is None:
        return [None] * count
    if not isinstance(out, (str, os.PathLike)):
        raise TrajectoryError(
            "out: must be a folder for the runs, or a pattern of files such as 'box_{:03d}.h5', "
            f"got {shown(out)}"
        )
    from multiarm.results.hdf5 import writable_target

    paths = _by_pattern(str(out), count) if "{" in str(out) else _in_folder(Path(out), count)
    for path in paths:
        writable_target(path)
    return [*paths]


def _in_folder(folder: Path, count: int) -> list[Path]:
    folder = folder.expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrajectoryError(
            f"cannot make the folder '{folder}' for the runs: {error.strerror or error}; name "
            "another, or a pattern of files such as 'box_{:03d}.h5'"
        ) from error
    digits = max(4, len(str(count)))  # sorted names are runs in order
    return [folder / f"run_{number:0{digits}d}.h5" for number in range(1, count + 1)]


def _by_pattern(pattern: str, count: int) -> list[Path]:
    try:
        names = [pattern.format(number) for number in range(1, count + 1)]
    except (ValueError, LookupError, AttributeError, TypeError) as error:
        raise TrajectoryError(
            f"'{pattern}' is no pattern of files ({error}); write the number's place as in "
            "'box_{:03d}.h5'"
        ) from None
    if len(set(names)) < count:
        raise TrajectoryError(
            f"'{pattern}' names one file for several runs; write the number's place as in "
            "'box_{:03d}.h5'"
        )
    return [Path(name) for name in names]
