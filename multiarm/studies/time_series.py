"""A motion at given output times, from any program, with its cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiarm.dynamics.state import State
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
    grid : Grid
    limit_s : float
        The run ends with :class:`OutOfTime` when it has taken longer, on the clock or off it.
    every_step : bool
        A method that chooses its steps records after each of them, not at the times of the grid.
    times : list of float
        [s]
    states : list of State
        At these times, as far as the motion goes and is finite.
    works : list of float
        What torques and damping have done since the start [J]; empty if the peer does not tell.
    wall_time_s : float
        Of the steps alone: models are built, and torques that are known beforehand are tabulated,
        off the clock.
    steps, evaluations : int
    """

    grid: Grid
    limit_s: float = math.inf
    every_step: bool = False
    times: list[float] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    works: list[float] = field(default_factory=list)
    wall_time_s: float = 0.0
    steps: int = 0
    evaluations: int = 0
    _begin: float = 0.0
    _first: float | None = None

    @property
    def reached(self) -> float:
        """How far the motion goes [s]."""
        return self.times[-1] if self.times else 0.0

    def record(self, state: State, time: float | None = None) -> bool:
        """Keep a state, by default at the next time of the grid; tells whether it is finite."""
        finite = bool(np.all(np.isfinite(state.position)) and np.all(np.isfinite(state.velocity)))
        if finite:
            self.times.append(self.grid.interval * len(self.states) if time is None else time)
            self.states.append(state)
        return finite

    def start(self) -> None:
        """Start the clock."""
        self._begin = time.perf_counter()
        if self._first is None:
            self._first = self._begin

    def stop(self, steps: int = 0, evaluations: int = 0) -> None:
        """Stop the clock after so many steps and evaluations."""
        now = time.perf_counter()
        self.wall_time_s += now - self._begin
        self.steps += steps
        self.evaluations += evaluations
        self.check()

    def check(self) -> None:
        """Raise :class:`OutOfTime` when the limit is over."""
        if self._first is not None and time.perf_counter() - self._first > self.limit_s:
            raise OutOfTime

    def off_the_clock(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose own time does not count."""

        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments)
            self.wall_time_s -= time.perf_counter() - begin
            return result

        return call
