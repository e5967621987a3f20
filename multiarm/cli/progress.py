"""A run as it is watched: a bar in simulated time, which starts anew for every rerun."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text
from typing_extensions import Self

from multiarm.cli.terminal import messages
from multiarm.tableaus import METHODS

__all__ = [
    "ManyRunsProgress",
    "PartProgress",
    "RunProgress",
    "StudyProgress",
    "kernels_are_cached",
    "passing_bar",
]

COMPILING = "compiling kernels (only the first time on this machine)"


def kernels_are_cached(integrator: str | None = None) -> bool:
    """Whether the compiled loop, and this method's step, are in Numba's cache and fresh."""
    from multiarm.integration.time_loop import advance
    from multiarm.simulation.setup import IMPLICIT_STEPS

    kernels = [advance]
    if integrator is not None and METHODS[integrator].kind in IMPLICIT_STEPS:
        kernels.append(IMPLICIT_STEPS[METHODS[integrator].kind])
    return all(kernel.is_cached() for kernel in kernels)


def passing_bar(console: Console, *columns: ProgressColumn, hidden: bool = False) -> Progress:
    """A bar with words before it and columns behind it, on terminals only; gone in the end."""
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        *columns,
        console=console,
        transient=True,
        disable=hidden or not console.is_terminal,
    )


class RunProgress:
    """Shows how far a run is, on a terminal; elsewhere one line says when kernels are compiled.

    Parameters
    ----------
    console : Console
    duration : float
        [s] of simulated time.
    quiet : bool
        Show nothing.
    integrator : str, optional
        The method that is asked for.

    Attributes
    ----------
    compiling : bool
        The kernels are not in the cache: the run begins by compiling them.
    """

    def __init__(
        self, console: Console, duration: float, quiet: bool, integrator: str | None = None
    ) -> None:
        self._console, self._duration, self._quiet = console, duration, quiet
        self._bar = passing_bar(console, _SimulatedTime(), hidden=quiet)
        self._task = self._bar.add_task("preparing", total=None)
        self._began: float | None = None
        self.compiling = not kernels_are_cached(integrator)

    def __enter__(self) -> Self:
        self._bar.start()
        if self.compiling:
            self._bar.update(self._task, description=COMPILING)
            if self._bar.disable and not self._quiet:
                self._console.print(f"{COMPILING} ...", soft_wrap=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def __call__(self, t: float) -> None:
        """Show that the run has come to time ``t`` [s]; what ``simulate`` calls."""
        self.advance(t)

    def advance(self, t: float) -> None:
        """Show that the run has come to time ``t`` [s]."""
        now = time.perf_counter()
        if self._began is None:  # the first step has just been made: all kernels are compiled
            self._began = now
            self._bar.update(self._task, description="simulating", total=self._duration)
        rate = t / (now - self._began) if now > self._began else None
        self._bar.update(self._task, completed=t, rate=rate)

    def checking(self, t: float, number: int) -> None:
        """Show that a rerun has come to time ``t`` [s]: the second, third, ... run."""
        repeated = "" if number < 2 else f" (run {number + 1})"
        self._bar.update(
            self._task, description=f"checking the accuracy{repeated}", completed=t, rate=None
        )


class ManyRunsProgress:
    """A bar over many runs on a terminal: how much of their time is simulated, how many are done.

    Parameters
    ----------
    runs : int
    duration : float
        [s] of simulated time of all of them together.
    """

    def __init__(self, runs: int, duration: float) -> None:
        self._bar = passing_bar(messages(), _SimulatedTime(), TimeRemainingColumn())
        self._runs, self._began = runs, time.perf_counter()
        words = f"0 of {runs} runs" if kernels_are_cached() else COMPILING
        self._task = self._bar.add_task(words, total=duration)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, t: float, done: int) -> None:
        """Show that the runs have come to ``t`` seconds together, and that some are done."""
        if t == 0.0:  # the first one may still wait for its kernels
            self._began = time.perf_counter()
            return
        passed = time.perf_counter() - self._began
        words = f"{done} of {self._runs} runs"
        self._bar.update(self._task, description=words, completed=t, rate=t / max(passed, 1e-9))


class PartProgress:
    """A bar on a terminal, told the part that is done, 0 to 1, and what is being done."""

    def __init__(self) -> None:
        self._bar = passing_bar(messages(), TimeElapsedColumn())
        self._task = self._bar.add_task("preparing", total=1.0)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, part: float, what: str) -> None:
        """Show how far it is."""
        self._bar.update(self._task, description=what, completed=part)


class StudyProgress:
    """A bar over the parts of a study on a terminal; elsewhere a line when kernels are compiled.

    Parameters
    ----------
    total : float, optional
        How many parts there are, where that is known from the start.
    counted : bool
        Show how many of them are done.
    """

    def __init__(self, total: float | None = None, counted: bool = False) -> None:
        console = messages()
        count = [TextColumn("{task.completed:.0f} of {task.total:.0f}")] if counted else []
        self._bar = passing_bar(console, *count, TimeElapsedColumn())
        compiling = not kernels_are_cached()
        self._task = self._bar.add_task(COMPILING if compiling else "preparing", total=total)
        self._begun = -1
        if compiling and self._bar.disable:
            console.print(f"{COMPILING} ...", soft_wrap=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the bar away."""
        self._bar.stop()

    def tell(self, text: str, done: float | None = None, total: float = 0.0) -> None:
        """Show what is being done, and how many parts are done of how many there may be.

        Without ``done``, what was shown before is done; a ``total`` of 0 says nothing new.
        """
        self._begun += 1
        completed = self._begun if done is None else done
        self._bar.update(self._task, description=text, completed=completed, total=total or None)


class _SimulatedTime(ProgressColumn):
    """``3.20 of 5.00 s, 24 x real time``."""

    def render(self, task: Task) -> Text:
        """Return the text of one moment; empty until the run has begun."""
        if task.total is None:
            return Text()
        rate = task.fields.get("rate")
        pace = "" if rate is None else f", {rate:.3g} x real time"
        return Text(f"{task.completed:.4g} of {task.total:g} s{pace}", "cyan")
