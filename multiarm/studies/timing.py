"""How the studies measure time: short interleaved bursts of calls, and runs on a clock.

Contestants are measured in turns, one burst of each after the other, so that disturbances by other
programs affect all alike.  Everything runs on one thread; the time is the processor's time for it,
which is the wall time on a quiet machine, and not much more on a busy one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import OK
from multiarm.dynamics.model import Data
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.integration.step import begin_chart, evaluate_slope, make_step
from multiarm.jit.kernels import kernel
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.simulate import simulate
from multiarm.tableaus import RK4

BURST = 1e-3
"""Length of a burst [s], about; a single call that takes longer is a burst."""
PATIENCE = 0.4
"""A contestant that has taken this long [s] is given no further burst, once it has had FEWEST."""
FEWEST = 3

Burst = Callable[[int], object]
"""Makes that many calls."""


class OutOfTime(Exception):
    """A run was ended by its time limit."""


def measure(
    bursts: Mapping[str, Burst], turns: int, rare: Collection[str] = (), rare_every: int = 40
) -> dict[str, np.ndarray]:
    """Seconds a call in every burst, of all contestants in turn.

    Parameters
    ----------
    bursts : mapping of str to callable
        Contestant -> function that makes a number of calls.
    turns : int
        Bursts of each, at most.
    rare : collection of str
        Contestants that take part only in every ``rare_every``-th turn: slow ones whose figures
        need not be precise.

    Returns
    -------
    dict of str to ndarray, shape (bursts,)
    """
    calls = {name: calls_a_burst(burst) for name, burst in bursts.items()}
    seconds: dict[str, list[float]] = {name: [] for name in bursts}
    spent = dict.fromkeys(bursts, 0.0)
    for turn in range(turns):
        for name, burst in bursts.items():
            if name in rare and turn % rare_every:
                continue
            if spent[name] > PATIENCE and len(seconds[name]) >= FEWEST:
                continue
            begin = time.thread_time()
            burst(calls[name])
            took = time.thread_time() - begin
            spent[name] += took
            seconds[name].append(took / calls[name])
    return {name: np.array(times) for name, times in seconds.items()}


def calls_a_burst(burst: Burst) -> int:
    """How many calls make a burst of about the usual length."""
    burst(1)  # warm-up
    begin = time.thread_time()
    burst(2)
    return max(1, round(BURST / max((time.thread_time() - begin) / 2, 1e-7)))


def slope_burst(data: Data) -> Burst:
    """Evaluations as the time loop performs them, at the state in the data."""
    joints, effects, struct = data.model.layout.joints, data.model.effects, data.struct
    step = make_step(RK4, joints, effects.states, 1 + len(effects.works))
    begin_chart(struct, step.base, step.z)
    step.z[12 + 2 * joints :][: effects.states] = data.effect_states()
    return loop_burst(data, _evaluate_often, step.z, step.base, step.slope)


def loop_burst(data: Data, loop: Callable[..., int], *arguments: Any) -> Burst:
    """A compiled loop over a part of an evaluation.

    ``loop(struct, *arguments, count)`` returns the status of the last one.
    """

    def burst(count: int) -> None:
        if loop(data.struct, *arguments, count) != OK:
            data.reraise()
            raise SolverError("a part of an evaluation failed in the benchmark")

    return burst


@contextmanager
def one_thread() -> Iterator[None]:
    """Run linear algebra on one thread: everything else that is measured is single-threaded too."""
    import scipy.linalg  # noqa: F401 - loaded before the limit, which binds loaded libraries only
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        yield


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
    if run.status == "interrupted":
        raise OutOfTime if late else KeyboardInterrupt
    if len(clocks) < 2:
        return run, run.statistics["wall_time_s"]
    (begin, begin_busy), (end, end_busy) = clocks[0], clocks[-1]
    waited = max(0.0, (end - begin) - (end_busy - begin_busy))
    return run, run.statistics["wall_time_s"] - waited


@kernel
def _evaluate_often(struct, z, base, slope, count):
    status = OK
    for i in range(count):
        status = evaluate_slope(struct, 1e-4 * i, z, base, 0.0, 0.0, slope)
        if status != OK:
            return status
    return status
