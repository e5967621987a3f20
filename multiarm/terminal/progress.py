"""Progress of long work: a run, many runs, a sweep, a study, a search.

On a terminal it is a bar that goes away at the end.  Elsewhere it is a plain line on stderr every
few seconds, so that work that takes less prints nothing.  Both say the same: what is being done,
how much of it is done, and how long it will take at the pace so far.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from typing_extensions import Self

from multiarm.errors import MultiarmError
from multiarm.tableaus import METHODS

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = [
    "ManyRunsProgress",
    "PartProgress",
    "Progress",
    "Report",
    "RunProgress",
    "SweepProgress",
    "displayed",
    "kernels_are_cached",
    "span",
]

Shown = AbstractContextManager[Callable[..., None]]
Report = Callable[[float, float, str], None]
"""Called with how much is done, of how much (0: not known), and what is being done."""

LINES, SLOWEST, SHARE = 5.0, 30.0, 0.1
"""Where there is no terminal, a line comes after so long [s] at least and at most; between the two
after such a share of the time so far."""
SETTLED = 1.0
"""The time left is estimated when the pace has been watched for so long [s]."""
CLOCK_TIMES = 90.0
"""Where more time is left [s], the end is given as a time of day too."""
PREPARING, COMPILING = "preparing", "compiling kernels (only the first time on this machine)"


def kernels_are_cached(integrator: str | None = None) -> bool:
    """Whether the compiled loop, and this method's step, are in Numba's cache and fresh."""
    from multiarm.integration.time_loop import IMPLICIT_STEPS, advance

    kernels = [advance]
    if integrator is not None and METHODS[integrator].kind in IMPLICIT_STEPS:
        kernels.append(IMPLICIT_STEPS[METHODS[integrator].kind])
    return all(kernel.is_cached() for kernel in kernels)


def displayed(progress: bool | Callable[..., None] | None, own: Callable[[], Shown]) -> Shown:
    """What long work calls as it goes on: the caller's function, or for True a display of ours.

    Raises
    ------
    MultiarmError
        When it is neither.
    """
    if progress is True:
        return own()
    if progress and not callable(progress):
        from multiarm.scene.faults import shown

        raise MultiarmError(f"progress: must be True or a function, got {shown(progress)}")
    return nullcontext(progress or _ignore)


def _ignore(*_: Any) -> None:
    """Show nothing."""


class _Display:
    """A bar, or lines; subclasses are called with what their kind of work counts.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    integrator : str, optional
        The method that runs use.

    Attributes
    ----------
    compiling : bool
        The kernels are not in the cache: the work begins by compiling them.
    """

    def __init__(self, quiet: bool = False, integrator: str | None = None) -> None:
        from multiarm.terminal.bar import Bar
        from multiarm.terminal.console import messages

        self._console = messages()
        self.compiling = not kernels_are_cached(integrator)
        self._words = COMPILING if self.compiling else PREPARING
        self._amount, self._pace = "", _Pace()
        self._bar = Bar(self._console, self._words, hidden=quiet)
        self._lines = not (quiet or self._console.is_terminal)
        self._ended = threading.Event()
        self._printer = threading.Thread(target=self._print_lines, daemon=True)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._lines:
            if self.compiling:
                self._console.print(f"{COMPILING} ...", soft_wrap=True)
            self._printer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the bar away; print no more lines."""
        self._bar.stop()
        self._ended.set()
        if self._printer.is_alive():
            self._printer.join()

    def note(self, text: str) -> None:
        """Show a sentence below the bar."""
        self._bar.note = text

    def print(self, *items: RenderableType) -> None:
        """Print on stderr, above the bar."""
        for item in items:
            self._bar.console.print(item)

    def _show(self, words: str, done: float, total: float, amount: str) -> None:
        self._pace.note(done, total)
        self._words, self._amount = words, amount
        self._bar.show(words, done, total, ", ".join(filter(None, (amount, self._pace.left()))))

    def _line(self) -> str:
        end = self._pace.left() or f"{span(self._pace.passed())} so far"
        return ", ".join(filter(None, (self._words, self._amount, end)))

    def _print_lines(self) -> None:
        pause = LINES
        while not self._ended.wait(pause):
            self._console.print(self._line(), soft_wrap=True)
            pause = min(max(LINES, SHARE * self._pace.passed()), SLOWEST)


class _Pace:
    """How fast work goes on, and how long it will take."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._done = self._total = 0.0
        self._start: float | None = None  # what is done before does not count
        self._first: tuple[float, float] | None = None

    def note(self, done: float, total: float) -> None:
        """Note how much is done."""
        if self._start is None or done < self._done:  # another stage begins
            self._start, self._first = done, None
        if self._first is None and done > self._start:
            self._first = done, time.monotonic()  # before that, code was compiled and loaded
        self._done, self._total = done, total

    def passed(self) -> float:
        """How long the work has taken [s]."""
        return time.monotonic() - self._began

    def left(self) -> str:
        """How long it will take at the pace so far, and when it ends; empty if not known."""
        if self._first is None or not self._first[0] < self._done < self._total:
            return ""
        first, since = self._first
        watched = time.monotonic() - since
        if watched < SETTLED:
            return ""
        seconds = (self._total - self._done) * watched / (self._done - first)
        if seconds < CLOCK_TIMES:
            return f"about {span(seconds)} left"
        ends = datetime.now() + timedelta(seconds=seconds)
        return f"about {span(seconds)} left, ends {ends:{_clock(seconds)}}"


class Progress(_Display):
    """How far work is that counts its parts: ``progress(done, total, words)``."""

    def __call__(self, done: float, total: float, words: str) -> None:
        """Show what is being done, and how many parts of how many are done; 0 of 0: not known."""
        self._show(words, done, total, f"{done:.0f} of {total:.0f}" if total else "")


class RunProgress(_Display):
    """How far a run is: ``progress(t)``, and ``progress.checking(t, number)`` of a rerun.

    Parameters
    ----------
    duration : float
        [s] of simulated time.
    quiet, integrator
        As of every display.
    begin : float
        Time at which the run begins [s].
    """

    def __init__(
        self,
        duration: float,
        quiet: bool = False,
        integrator: str | None = None,
        begin: float = 0.0,
    ) -> None:
        super().__init__(quiet, integrator)
        self._simulated, self._begin = _SimulatedTime(duration), begin

    def __call__(self, t: float) -> None:
        """Show that the run has come to time ``t`` [s]; what ``simulate`` calls."""
        t -= self._begin
        self._show("simulating", t, self._simulated.duration, self._simulated.text(t))

    def checking(self, t: float, number: int) -> None:
        """Show that a rerun has come to time ``t`` [s]: the second, third, ... run."""
        repeated = "" if number < 2 else f" (run {number + 1})"
        duration, t = self._simulated.duration, t - self._begin
        self._show(f"checking the accuracy{repeated}", t, duration, f"{t:.4g} of {duration:g} s")


class ManyRunsProgress(_Display):
    """How far many runs are: ``progress(t, done)``, t of all of them together [s].

    Parameters
    ----------
    runs : int
    duration : float
        [s] of simulated time of all of them together.
    """

    def __init__(self, runs: int, duration: float) -> None:
        super().__init__()
        self._runs, self._simulated = runs, _SimulatedTime(duration)

    def __call__(self, t: float, done: int) -> None:
        """Show that the runs have come to ``t`` seconds together, and that some are done."""
        if t > 0.0:  # before, the first one may still wait for its kernels
            words = f"{done} of {self._runs} runs"
            self._show(words, t, self._simulated.duration, self._simulated.text(t))


class PartProgress(_Display):
    """How far work is whose parts are not counted: ``progress(fraction, words)``."""

    def __call__(self, part: float, words: str) -> None:
        """Show which fraction is done, 0 to 1."""
        self._show(words, part, 1.0, f"{100.0 * part:.0f} %")


class SweepProgress(_Display):
    """How far a sweep is: ``progress(done, count, failed)``, in runs."""

    def __call__(self, done: int, total: int, failed: int = 0) -> None:
        """Show how many runs are done, and how many of them failed."""
        self._show(
            f"{done} of {total} runs{f', {failed} failed' if failed else ''}", done, total,
            f"{100 * done // max(total, 1)} %",
        )  # fmt: skip


class _SimulatedTime:
    """``3.20 of 5.00 s, 24 x real time``.

    Parameters
    ----------
    duration : float
        [s]
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self._first: tuple[float, float] | None = None

    def text(self, t: float) -> str:
        """The text at a time [s]; the pace counts from the first one on."""
        now = time.perf_counter()
        if self._first is None:  # a step has just been made: all kernels are compiled
            self._first = t, now
        first, since = self._first
        pace = f", {(t - first) / (now - since):.3g} x real time" if t > first else ""
        return f"{t:.4g} of {self.duration:g} s{pace}"


def span(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def _clock(seconds: float) -> str:
    """Format of the time of day after so many seconds."""
    return "%H:%M:%S" if seconds < 3600 else "%a %d %b %H:%M"
