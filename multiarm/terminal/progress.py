"""Progress bars of long work: a run, many runs, a sweep, a study, a search."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from datetime import datetime, timedelta
from types import TracebackType

from rich.console import Console, RenderableType
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

from multiarm.tableaus import METHODS
from multiarm.terminal.console import messages

__all__ = [
    "ManyRunsProgress",
    "PartProgress",
    "RunProgress",
    "StudyProgress",
    "SweepProgress",
    "kernels_are_cached",
    "passing_bar",
]

# Where there is no terminal, a sweep prints a line so often [s].
LINES = 30.0

COMPILING = "compiling kernels (only the first time on this machine)"


def kernels_are_cached(integrator: str | None = None) -> bool:
    """Whether the compiled loop, and this method's step, are in Numba's cache and fresh."""
    from multiarm.integration.time_loop import advance
    from multiarm.simulation.setup import IMPLICIT_STEPS

    kernels = [advance]
    if integrator is not None and METHODS[integrator].kind in IMPLICIT_STEPS:
        kernels.append(IMPLICIT_STEPS[METHODS[integrator].kind])
    return all(kernel.is_cached() for kernel in kernels)


class _Bar(Progress):
    """A bar with a sentence below it.

    Attributes
    ----------
    note : str
        Empty where there is nothing to say.
    """

    note = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn: the bar, and the sentence."""
        yield from super().get_renderables()
        if self.note:
            yield Text(self.note, "green")


def passing_bar(console: Console, *columns: ProgressColumn, hidden: bool = False) -> _Bar:
    """A bar with a description and further columns, on terminals only; removed at the end."""
    return _Bar(
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
        The requested method.

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
    """A bar on a terminal: the fraction that is done, 0 to 1, and what is being done."""

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

    def note(self, text: str) -> None:
        """Show a sentence below the bar."""
        self._bar.note = text

    def print(self, *items: RenderableType) -> None:
        """Print on stderr, above the bar."""
        for item in items:
            self._bar.console.print(item)

    def report(self, text: str, done: float | None = None, total: float = 0.0) -> None:
        """Show what is being done, and how many parts are done of how many there may be.

        Without ``done``, what was shown before is done; a ``total`` of 0 says nothing new.
        """
        self._begun += 1
        completed = self._begun if done is None else done
        self._bar.update(self._task, description=text, completed=completed, total=total or None)


class SweepProgress:
    """A bar over the runs of a sweep on a terminal; elsewhere a line now and then.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._console, self._quiet = messages(), quiet
        done, left = TextColumn("{task.percentage:3.0f} %"), TextColumn("{task.fields[left]}")
        self._bar = passing_bar(self._console, done, left, hidden=quiet)
        self._task = self._bar.add_task("preparing", total=None, left="")
        self._begun: int | None = None
        self._first: tuple[int, float] | None = None
        self._printed = -math.inf

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int, failed: int = 0) -> None:
        """Show how many runs are done, and how many of them failed."""
        now = time.monotonic()
        if self._begun is None:
            self._begun = done
        if self._first is None and done > self._begun:
            self._first = done, now  # what came before was compiled and loaded meanwhile
        lost = f", {failed} failed" if failed else ""
        words, left = f"{done} of {total} runs{lost}", self._left(done, total, now)
        self._bar.update(self._task, description=words, completed=done, total=total, left=left)
        if self._bar.disable and not self._quiet and (now > self._printed + LINES or done == total):
            self._printed = now
            self._console.print(f"{words}{', ' if left else ''}{left}", soft_wrap=True)

    def _left(self, done: int, total: int, now: float) -> str:
        """How long it will take, at the pace so far, and when it ends."""
        first, since = self._first or (done, now)
        if done <= first or done >= total:
            return ""
        seconds = (total - done) * (now - since) / (done - first)
        ends = datetime.now() + timedelta(seconds=seconds)
        day = "%H:%M:%S" if seconds < 3600 else "%a %d %b %H:%M"
        return f"about {_span(seconds)} left, ends {ends.strftime(day)}"


class _SimulatedTime(ProgressColumn):
    """``3.20 of 5.00 s, 24 x real time``."""

    def render(self, task: Task) -> Text:
        """Return the text of one moment; empty until the run has begun."""
        if task.total is None:
            return Text()
        rate = task.fields.get("rate")
        pace = "" if rate is None else f", {rate:.3g} x real time"
        return Text(f"{task.completed:.4g} of {task.total:g} s{pace}", "cyan")


def _span(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
