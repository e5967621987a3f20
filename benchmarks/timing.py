"""How the benchmarks measure time: short interleaved bursts of calls, and slopes fitted to them.

The contestants take turns, one burst of each after the other, so that other programs disturb all
alike. Everything runs on one thread, and the time is the processor's. The figure of a contestant is
its *fastest* burst, as others can only slow a burst down, or the *median*.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from multiarm.dynamics.coordinates import chart_places
from multiarm.dynamics.data import Data
from multiarm.dynamics.status import OK
from multiarm.errors import SolverError
from multiarm.integration.step import begin_chart, evaluate_slope, make_step
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.tableaus import RK4

BURST = 2e-3
"""Length of a burst [s], about; a single call that takes longer is a burst."""
MOST_CALLS = 2**14
"""In a burst."""
PATIENCE = 0.4
"""A contestant that has taken this long [s] is given no further burst, once it has had FEWEST."""
FEWEST = 3

Burst = Callable[[int], object]
"""Makes that many calls."""


def measure(bursts: Mapping[str, Burst], turns: int) -> dict[str, np.ndarray]:
    """Seconds a call in every burst of each contestant, of which all in turn have ``turns``."""
    calls = {name: calls_a_burst(burst) for name, burst in bursts.items()}
    seconds: dict[str, list[float]] = {name: [] for name in bursts}
    spent = dict.fromkeys(bursts, 0.0)
    for _ in range(turns):
        for name, burst in bursts.items():
            if spent[name] > PATIENCE and len(seconds[name]) >= FEWEST:
                continue
            begin = time.thread_time()
            burst(calls[name])
            took = time.thread_time() - begin
            spent[name] += took
            seconds[name].append(took / calls[name])
    return {name: np.array(times) for name, times in seconds.items()}


def calls_a_burst(burst: Burst) -> int:
    """How many calls make a burst of about the usual length.

    To enter a compiled loop takes as long as ten small evaluations: only the time of many calls in
    one burst is that of so many calls.
    """
    burst(1)  # warm-up
    calls = 1
    while calls < MOST_CALLS:
        begin = time.thread_time()
        burst(calls)
        took = time.thread_time() - begin
        if took > BURST / 2:
            return max(1, round(calls * BURST / took))
        calls *= 2
    return MOST_CALLS


def fastest(times: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The fastest burst of each contestant, microseconds a call."""
    return {name: 1e6 * float(np.min(seconds)) for name, seconds in times.items()}


def median(times: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The median burst of each contestant, microseconds a call."""
    return {name: 1e6 * float(np.median(seconds)) for name, seconds in times.items()}


def fitted_slope(sizes: Sequence[float], costs: Sequence[float | None]) -> float | None:
    """Least-squares slope of log cost over log size; None with fewer than two costs."""
    known = [(n, cost) for n, cost in zip(sizes, costs, strict=True) if cost is not None]
    if len(known) < 2:
        return None
    n, cost = np.log(np.array(known)).T
    return float(np.polyfit(n, cost, 1)[0])


def upper_half(sizes: Sequence[Any]) -> slice:
    """The larger half of increasing sizes, at least two of them where there are two."""
    return slice(len(sizes) // 2 if len(sizes) >= 4 else max(0, len(sizes) - 2), None)


def python_burst(call: Callable[[], object]) -> Burst:
    """A burst of calls from Python."""

    def burst(count: int) -> None:
        for _ in range(count):
            call()

    return burst


def slope_burst(data: Data) -> Burst:
    """Evaluations as the time loop performs them, at the state in the data."""
    effects, struct = data.model.effects, data.struct
    works = 1 + len(effects.works)
    step = make_step(RK4, data.model.layout, struct, effects.states, works)
    begin_chart(struct, step.base, step.z)
    places = chart_places(data.arrays)
    step.z[places.states : places.works] = data.effect_states()
    return _loop_burst(data, _evaluate_often, step.stage, step.z, step.base, step.slope)


def call_burst(data: Data, *parts: int) -> Burst:
    """Compiled parts of an evaluation, by their addresses, in turn."""
    bursts = [_loop_burst(data, _call_often, address) for address in parts]
    return lambda count: [burst(count) for burst in bursts]


def terms_burst(data: Data) -> Burst:
    """Pinocchio's two calls alone."""
    address = data.arrays.functions.pinocchio
    return lambda count: _terms_often(address, count)


def _loop_burst(data: Data, loop: Callable[..., int], *arguments: Any) -> Burst:
    """A compiled loop over a part of an evaluation.

    ``loop(struct, *arguments, count)`` returns the status of the last one.
    """

    def burst(count: int) -> None:
        if loop(data.struct, *arguments, count) != OK:
            data.reraise()
            raise SolverError("a part of an evaluation failed in the benchmark")

    return burst


@kernel
def _call_often(struct, address, count):
    status = OK
    for _ in range(count):
        status = call_cfunc(address, struct, 0.0, 0.0)
        if status != OK:
            return status
    return status


@kernel
def _terms_often(address, count):
    for _ in range(count):
        call_python(address)


@kernel
def _evaluate_often(struct, stage, z, base, slope, count):
    status = OK
    for i in range(count):
        status = evaluate_slope(struct, stage, 1e-4 * i, z, base, slope)
        if status != OK:
            return status
    return status
