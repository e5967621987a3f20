"""How the studies measure time: runs on a clock."""

from __future__ import annotations

import math
import time
from typing import Any

from multiarm.dynamics.system import System
from multiarm.results.outcome import RunStatus
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.simulate import simulate


class OutOfTime(Exception):
    """A run was ended by its time limit."""


def clocked_run(
    system: System, limit_s: float = math.inf, **options: Any
) -> tuple[Trajectory, float]:
    """Simulate, unchecked, for so much wall time at most; compilation does not count.

    Returns
    -------
    trajectory : Trajectory
    seconds : float
        Its wall time without that for which the processor did something else.

    Raises
    ------
    OutOfTime
    KeyboardInterrupt
        Ctrl-C, which ``simulate`` makes an end in good order, ends the whole study.
    MultiarmError
        What ``simulate`` raises.
    """
    clocks: list[tuple[float, float]] = []
    late = False

    def look(_: float) -> None:  # called before the first step, now and then, and after the last
        nonlocal late
        clocks.append((time.perf_counter(), time.thread_time()))
        if clocks[-1][0] - clocks[0][0] >= limit_s:
            late = True
            raise KeyboardInterrupt  # the way to end a run

    run = simulate(system, progress=look, certificate=False, **options)
    if run.status == RunStatus.INTERRUPTED:
        raise OutOfTime if late else KeyboardInterrupt
    if len(clocks) < 2:
        return run, run.statistics["wall_time_s"]
    (begin, begin_busy), (end, end_busy) = clocks[0], clocks[-1]
    waited = max(0.0, (end - begin) - (end_busy - begin_busy))
    return run, run.statistics["wall_time_s"] - waited
