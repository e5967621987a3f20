"""``simulate``: the settings of a run become a task, which is carried out and certified."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, require_control, require_system
from multiarm.errors import SceneError, TrajectoryError
from multiarm.results.files import resolved
from multiarm.results.outcome import RunStatus
from multiarm.results.trajectory import Trajectory
from multiarm.scene import AccuracySpec
from multiarm.simulation.certified import Attempts
from multiarm.simulation.setup import Task, finite_time, increasing_times, run_spec
from multiarm.terminal.progress import RunProgress, RunWatcher, TimeWatcher, displayed


def simulate(
    system: System,
    duration: float | None = None,
    *,
    accuracy: float | Mapping[str, float] | AccuracySpec | None = None,
    integrator: str | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    stabilization: str | dict | None = None,
    output_step: float | None = None,
    output_times: Sequence[float] | np.ndarray | None = None,
    start_time: float = 0.0,
    max_step: float | None = None,
    solver: str | None = None,
    state: State | None = None,
    control: ControlFunction | None = None,
    sample_time: float | None = None,
    sample_delay: bool = False,
    out: str | os.PathLike | None = None,
    progress: bool | RunWatcher | Callable[[float], None] | None = None,
    certificate: bool = True,
) -> Trajectory:
    """Simulate a system.

    Whatever is left out is taken from the scene's ``run``; naming one of ``accuracy``,
    ``integrator``, ``step`` and ``tolerance`` replaces the scene's choice of all four.

    Parameters
    ----------
    system : System
    duration : float, optional
        [s]
    accuracy : float or dict, optional
        Largest error of the run at the worst output time [m, rad], or a table by quantity:
        ``{"position": [m], "rotation": [rad], "force": [N]}``. Chooses method, tolerances and step
        sizes; the run is then checked, see ``certificate``.
    integrator : str, optional
        One of :data:`multiarm.tableaus.METHODS`.  Methods of fixed step, such as "rk4", need
        ``step``; adaptive ones, such as "dop853" and, for stiff scenes, "rodas5p", take
        ``tolerance`` or ``accuracy``.
    step : float, optional
        Fixed step [s].
    tolerance : float, optional
        Error of one step of an adaptive method [m, rad; m/s, rad/s].
    stabilization : {"projection", "feedback", "none"} or dict, optional
        ``{"kind": "feedback", "alpha": ..., "beta": ...}`` sets the gains [1/s].
    output_step : float, optional
        Time between samples [s].
    output_times : sequence of float, optional
        Increasing times of the samples [s], in place of ``output_step``.  Without a ``duration``
        the run ends at the last one.
    start_time : float
        Time at which the run begins [s]: loads, paths and tables act as from there on.
    max_step : float, optional
        Longest step of an adaptive method [s].  By default unlimited; with user callbacks the time
        between samples, so that no sudden change of their values is stepped over.  A sampled
        control is none of them: steps end at its samples.
    solver : {"node", "dense"}, optional
    state : State, optional
        Initial state; the scene's start by default.  Actuators with lag begin as at any start.
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control.
    sample_time : float, optional
        ``control`` is called every ``sample_time`` [s] only, with the state at that time, and its
        torques are held in between.  By default it is called in every evaluation.
    sample_delay : bool
        The torques of ``control`` act one sample later; those of the start act until the second
        sample.
    out : path-like, optional
        HDF5 file that the samples are streamed to; memory then does not grow with the run.
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called with the simulated time now and then; it may raise ``KeyboardInterrupt`` to end the
        run.  While a run is checked, its method ``checking(time, number)`` is called with the
        simulated time and the number of the rerun, if it has one; else it is called with the end of
        the run.
    certificate : bool
        Check a run of some ``accuracy`` against a rerun with smaller tolerances, and repeat it if
        it is not accurate enough; ``trajectory.certificate`` tells the estimated errors. False:
        one run, unchecked. The reruns call user callbacks again from the start on: one that depends
        on earlier calls may return other values then, and should be run unchecked. Runs by ``step``
        or ``tolerance`` are never checked.

    Returns
    -------
    Trajectory
        Also when the run fails on the way: ``status``, ``message`` and all samples up to there.

    Raises
    ------
    ModelError
        When ``system`` is no system, or ``state`` none of its states.
    SceneError
        When the settings contradict each other, or output times are not within the run.
    SolverError, ControlError
        When the very first evaluation is impossible, ``sample_time`` cannot be used, or a recorded
        control ends before the run.
    TrajectoryError
        When ``out`` cannot be written.
    """
    system = require_system(system, "ma.simulate(system)")
    state = None if state is None else system.checked(state)
    start_time = finite_time(start_time, "start_time")
    if output_times is not None and output_step is not None:
        raise SceneError("'output_times' and 'output_step' exclude each other; keep one")
    times = None if output_times is None else increasing_times(output_times)
    if times is not None and duration is None:
        duration = times[-1] - start_time
        if not duration > 0.0:
            raise SceneError("the last of 'output_times' must be after 'start_time'")
    spec = run_spec(
        system.scene.run,
        {
            "duration": duration,
            "accuracy": accuracy,
            "integrator": integrator,
            "step": step,
            "tolerance": tolerance,
            "stabilization": stabilization,
            "output_step": output_step,
            "solver": solver,
        },
    )
    system = system.with_solver(spec.solver)
    require_control(control, sample_time, sample_delay)
    if control is not None:
        system = system.with_control(control, sample_time, sample_delay)
    if max_step is None:
        max_step = spec.output_step if system.model.calls_user else np.inf
    is_checked = certificate and spec.accuracy is not None
    with (
        displayed(progress, partial(RunProgress, spec.duration, begin=start_time)) as show,
        system.borrow() as data,
    ):
        if isinstance(show, RunProgress):
            show.checked = is_checked
        for callback in data.user_callbacks:
            callback.forget()
        task = Task(system, data, spec, state, max_step, start_time, times)
        path = None if out is None else resolved(out, TrajectoryError)
        watcher = show if isinstance(show, RunWatcher) else TimeWatcher(show, task.end)
        attempts = Attempts(task, path, watcher)
        trajectory = attempts.first()
        if is_checked and trajectory.status == RunStatus.COMPLETED:
            trajectory = attempts.certify()
    return trajectory.of(system.scene)
