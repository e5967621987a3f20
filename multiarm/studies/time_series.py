"""A motion at given output times, from any program, with its cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiarm.scene import RunSpec


class OutOfTime(Exception):
    """A run was ended by its time limit."""


@dataclass(frozen=True)
class Grid:
    """The times at which motions are compared: 0, interval, 2 interval, ...

    Attributes
    ----------
    interval : float
        [s]
    intervals : int
    """

    interval: float
    intervals: int

    @classmethod
    def of(cls, run: RunSpec) -> Grid:
        """The output times of a run, without its end where no whole output step leads to it."""
        interval = min(run.output_step, run.duration)
        return cls(interval, math.floor(run.duration / interval * (1 + 1e-12)))

    @property
    def times(self) -> np.ndarray:
        """Shape (intervals + 1,) [s]."""
        return self.interval * np.arange(self.intervals + 1)

    def steps(self, step: float) -> int:
        """How many steps of a length make an interval; the length must divide it."""
        count = round(self.interval / step)
        assert count >= 1 and abs(count * step - self.interval) < 1e-9 * self.interval
        return count


@dataclass
class TimeSeries:
    """A motion at the times of a grid, as it is recorded.

    Attributes
    ----------
    positions : list of ndarray, shape (7 + n,)
        Object's position, quaternion xyzw, joint positions.
    wall_time_s : float
        Of the steps alone: models are built, and torques that are known beforehand are tabulated,
        off the clock.
    steps, evaluations : int
    limit_s : float
        The run ends with :class:`OutOfTime` when it has taken longer, on the clock or off it.
    """

    limit_s: float = math.inf
    positions: list[np.ndarray] = field(default_factory=list)
    wall_time_s: float = 0.0
    steps: int = 0
    evaluations: int = 0
    _begin: float = 0.0
    _first: float | None = None

    def start(self) -> None:
        """Start the clock."""
        self._begin = time.perf_counter()
        if self._first is None:
            self._first = self._begin

    def off_the_clock(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose own time does not count."""

        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments)
            self.wall_time_s -= time.perf_counter() - begin
            return result

        return call

    def stop(self) -> None:
        """Stop the clock."""
        now = time.perf_counter()
        self.wall_time_s += now - self._begin
        if self._first is not None and now - self._first > self.limit_s:
            raise OutOfTime
