"""`simulate_many`: many runs of one scene, as simply as one."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.results.trajectory import Trajectory
from multiarm.scene import AccuracySpec
from multiarm.sweeps.many.cases import describe
from multiarm.sweeps.many.crew import ManyProgress, run_cases


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
    certificate: bool = True,
) -> list[Trajectory]:
    """Simulate a system many times, over several threads: from other starts, with other values.

    Every run gives the numbers that :func:`multiarm.simulate` gives, bit for bit, whatever the
    number of threads.

    Parameters
    ----------
    system : System
        Its arrays are not used, so that it may be evaluated meanwhile.
    duration : float, optional
        [s]
    states : list of State, optional
        Where the runs begin; the scene's start when left out.
    parameters : list of dict, optional
        What is other in the scene of each run, by its path: ``{"object.mass": 10.0,
        "arms.left.base.xyz[2]": 0.1, "joints[1].at.xyz": [0.6, 0, 0]}``.  Paths are written as in
        error messages.  Naming one of ``run.accuracy``, ``run.integrator``, ``run.step`` and
        ``run.tolerance`` replaces the scene's choice of all four.  With ``states`` too, there is
        one of each for every run.
    threads : int, optional
        How many runs go on at once.  When left out, as many as there are processors, or one where
        evaluations of ``system`` call Python: Pinocchio's arm terms, the dense solver, controllers,
        effects and surfaces of one's own.  There threads only wait for each other, as they do
        around runs whose loop takes less than half a millisecond.
    progress : bool or callable, optional
        True: a bar on the terminal.  A function is called now and then, in the calling thread, with
        the simulated time of all runs together [s] and the number of runs that are done; it may
        raise ``KeyboardInterrupt`` to end them all.
    out : path-like, optional
        Folder for HDF5 files ``run_0001.h5`` and so on, to which samples are streamed, or a pattern
        of files such as ``"runs/box_{:03d}.h5"``.  Memory then does not grow with the runs.
    accuracy, integrator, step, tolerance, stabilization, output_step, max_step, solver, certificate
        As in :func:`multiarm.simulate`, for all runs.
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control.  One function serves all
        runs and is called from several threads: it must not remember anything from call to call.
        The same holds of functions that a scene names; of an effect of one's own, every thread has
        an instance for itself.

    Returns
    -------
    list of Trajectory
        In the order of the runs.  A run that fails on the way, or that cannot begin (a start too
        far from the joints, a robot that cannot be used), is one with status "failed".  Ctrl-C ends
        them in good order: runs under way have status "interrupted" and what was simulated, those
        that had not begun have no samples, and those that were done are kept.

    Raises
    ------
    SceneError
        When parameters are wrong, naming all faults of all runs, or settings contradict each other.
    ModelError
        When ``states`` are no states of this system, or ``threads`` is no number of threads.
    TrajectoryError
        When ``out`` cannot be written.
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
        "certificate": certificate,
    }
    at_once = _threads(threads, system, control)
    cases = describe(system, states, parameters, out, options)
    if progress is not True:
        return run_cases(cases, system, at_once, progress or None)
    from multiarm.terminal.progress import ManyRunsProgress

    ends = (case.scene.run.duration if duration is None else duration for case in cases)
    with ManyRunsProgress(len(cases), sum(ends)) as bar:
        return run_cases(cases, system, at_once, bar)


def _threads(asked: int | None, system: System, control: ControlFunction | None) -> int:
    if asked is None and (control is not None or system.model.calls_python):
        return 1
    if asked is None:
        has_affinity = hasattr(os, "sched_getaffinity")
        return len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    if isinstance(asked, bool) or not isinstance(asked, int) or asked < 1:
        raise ModelError(f"threads: must be a number from 1 on, got {asked!r}")
    return asked
