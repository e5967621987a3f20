"""A run and the time that the processor spent on it."""

from __future__ import annotations

import time
from typing import Any

from multiarm.dynamics.system import System
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.simulate import simulate


def clocked_run(system: System, **options: Any) -> tuple[Trajectory, float]:
    """Simulate, unchecked.

    Returns
    -------
    trajectory : Trajectory
    seconds : float
        Its wall time without that for which the processor did something else.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C, which ``simulate`` makes an end in good order, ends the whole benchmark.
    MultiarmError
        What ``simulate`` raises.
    """
    clocks: list[tuple[float, float]] = []

    def look(_: float) -> None:  # called before the first step and after the last
        clocks.append((time.perf_counter(), time.thread_time()))

    run = simulate(system, progress=look, certificate=False, **options)
    if run.status == "interrupted":
        raise KeyboardInterrupt
    if len(clocks) < 2:
        return run, run.statistics["wall_time_s"]
    (begin, begin_busy), (end, end_busy) = clocks[0], clocks[-1]
    waited = max(0.0, (end - begin) - (end_busy - begin_busy))
    return run, run.statistics["wall_time_s"] - waited
