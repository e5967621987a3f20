"""How the benchmarks measure time: short interleaved bursts of calls, and slopes fitted to them.

The contestants take turns, one burst of each after the other (`multiarm.studies.timing`), so that
disturbances by other programs affect all alike. Everything runs on one thread, and the time is the
processor's. The figure of a contestant is its *fastest* burst, as others can only slow a burst
down, or the *median*.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import OK
from multiarm.dynamics.model import Data
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.studies.timing import (
    Burst,
    calls_a_burst,
    loop_burst,
    measure,
    one_thread,
    slope_burst,
)

__all__ = [
    "Burst",
    "call_burst",
    "calls_a_burst",
    "fastest",
    "fitted_slope",
    "fitted_slopes",
    "loop_burst",
    "measure",
    "median",
    "one_thread",
    "python_burst",
    "slope_burst",
    "terms_burst",
    "upper_half",
]


def fastest(times: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The fastest burst of each contestant, microseconds a call."""
    return {name: 1e6 * float(np.min(seconds)) for name, seconds in times.items()}


def median(times: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The median burst of each contestant, microseconds a call."""
    return {name: 1e6 * float(np.median(seconds)) for name, seconds in times.items()}


def python_burst(call: Callable[[], object]) -> Burst:
    """A burst of calls from Python."""

    def burst(count: int) -> None:
        for _ in range(count):
            call()

    return burst


def call_burst(data: Data, *parts: int) -> Burst:
    """Compiled parts of an evaluation, by their addresses, in turn."""
    bursts = [loop_burst(data, _call_often, address) for address in parts]
    return lambda count: [burst(count) for burst in bursts]


def terms_burst(data: Data) -> Burst:
    """Pinocchio's two calls alone."""
    address = data.arrays.functions.pinocchio
    return lambda count: _terms_often(address, count)


def fitted_slope(sizes: Sequence[float], costs: Sequence[float | None]) -> float | None:
    """Least-squares slope of log cost over log size; None with fewer than two costs."""
    known = [(n, cost) for n, cost in zip(sizes, costs, strict=True) if cost is not None]
    if len(known) < 2:
        return None
    n, cost = np.log(np.array(known)).T
    return float(np.polyfit(n, cost, 1)[0])


def fitted_slopes(
    sizes: Sequence[float], costs: Sequence[Mapping[str, float | None]]
) -> dict[str, float | None]:
    """The slope of each contestant, from all their costs at each size."""
    return {name: fitted_slope(sizes, [cost[name] for cost in costs]) for name in costs[0]}


def upper_half(sizes: Sequence[Any]) -> slice:
    """The larger half of increasing sizes, at least two of them where there are two."""
    return slice(len(sizes) // 2 if len(sizes) >= 4 else max(0, len(sizes) - 2), None)


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
