"""Progress of long work: a run, many runs, a sweep, a study, a search.

On a terminal it is a bar that goes away at the end.  Elsewhere it is a plain line on stderr every
few seconds, so that work that takes less prints nothing.  Both say the same: what is being done,
how much of it is done, and how long it will take at its recent pace.  While kernels are compiled,
both say so; that time is no part of any pace.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from typing_extensions import Self

from multiarm.errors import MultiarmError
from multiarm.jit.compilation import is_compiling
from multiarm.notation import count_of

if TYPE_CHECKING:
    from rich.console import RenderableType

Shown = AbstractContextManager[Callable[..., None]]
Report = Callable[[float, float, str], None]
"""Called with how much is done, of how much (0: not known), and what is being done."""


@runtime_checkable
class RunWatcher(Protocol):
    """What a run tells how far it is, as a function that knows of reruns does."""

    def __call__(self, t: float) -> None:
        """The run has come to ``t`` [s]."""

    def checking(self, t: float, number: int) -> None:
        """A rerun that checks its accuracy has come to ``t`` [s]: the second, third, ... run."""


class TimeWatcher:
    """A function of the simulated time as a watcher; while the run is checked, of its end [s]."""

    def __init__(self, function: Callable[[float], None], end: float) -> None:
        self._function, self._end = function, end

    def __call__(self, t: float) -> None:
        """See :class:`RunWatcher`."""
        self._function(t)

    def checking(self, t: float, number: int) -> None:
        """See :class:`RunWatcher`."""
        self._function(self._end)


LINES, SLOWEST, SHARE = 5.0, 30.0, 0.1
"""Where there is no terminal, a line comes after so long [s] at least and at most; between the two
after such a share of the time so far."""
CLOCK_TIMES, CALENDAR = 90.0, 365.0 * 86400.0
"""Where the time left [s] is between the two, the end is given as a time of day too."""
COMPILING = "compiling kernels (only the first time on this machine)"


def displayed(progress: bool | Callable[..., None] | None, default: Callable[[], Shown]) -> Shown:
    """What long work calls as it goes on: the caller's function, or for True a display of ours.

    Raises
    ------
    MultiarmError
        When it is neither.
    """
    if progress is True:
        return default()
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
    """

    def __init__(self, quiet: bool = False) -> None:
        from multiarm.terminal.bar import Bar
        from multiarm.terminal.console import messages

        self._console = messages()
        self._work, self._amount, self._began = "preparing", "", time.monotonic()
        columns = (self._words, self._amount_and_left, self._elapsed_on_the_bar)
        self._bar = Bar(self._console, *columns, hidden=quiet)
        self._lines = not (quiet or self._console.is_terminal)
        self._ended = threading.Event()
        self._printer = threading.Thread(target=self._print_lines, daemon=True)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._lines:
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
        self._work, self._amount = words, amount
        self._bar.show(done, total)

    def _show_simulated(self, words: str, t: float, duration: float) -> None:
        """Show what is being done until a simulated time [s], and the pace of that."""
        self._show(words, t, duration, f"{t:.4g} of {duration:g} s")
        if self._bar.pace:
            self._amount += f", {self._bar.pace:.3g} x real time"

    def _words(self) -> str:
        return COMPILING if is_compiling() else self._work

    def _amount_and_left(self) -> str:
        return ", ".join(filter(None, (self._amount, self._left())))

    def _left(self) -> str:
        """How long the work will take, and when it ends; empty if that is not known."""
        seconds = self._bar.left
        if seconds is None:
            return ""
        if not CLOCK_TIMES <= seconds <= CALENDAR:
            return f"about {span(seconds)} left"
        ends = datetime.now() + timedelta(seconds=seconds)
        return f"about {span(seconds)} left, ends {ends:{_clock(seconds)}}"

    def _elapsed(self) -> float:
        return time.monotonic() - self._began  # [s]

    def _elapsed_on_the_bar(self) -> str:
        return str(timedelta(seconds=int(self._elapsed())))

    def _line(self) -> str:
        end = self._left() or f"{span(self._elapsed())} so far"
        return ", ".join(filter(None, (self._words(), self._amount, end)))

    def _print_lines(self) -> None:
        pause = LINES
        while not self._ended.wait(pause):
            self._console.print(self._line(), soft_wrap=True)
            pause = min(max(LINES, SHARE * self._elapsed()), SLOWEST)


class Progress(_Display):
    """How far work is that counts its parts: ``progress(done, total, words)``."""

    def __call__(self, done: float, total: float, words: str) -> None:
        """Show what is being done, and how many parts of how many are done; 0 of 0: not known."""
        self._show(words, done, total, f"{done:.0f} of {total:.0f}" if total else "")


class RunProgress(_Display):
    """How far a run is, and a rerun that checks it; a :class:`RunWatcher`.

    Parameters
    ----------
    duration : float
        [s] of simulated time.
    quiet : bool
        As of every display.
    begin : float
        Time at which the run begins [s].

    Attributes
    ----------
    checked : bool
        The accuracy of the run will be checked, which takes about as long again.
    """

    def __init__(self, duration: float, quiet: bool = False, begin: float = 0.0) -> None:
        super().__init__(quiet)
        self._duration, self._begin = duration, begin
        self.checked = self._is_checking = False

    def __call__(self, t: float) -> None:
        """Show that the run has come to time ``t`` [s]; what ``simulate`` calls."""
        self._is_checking = False
        self._show_simulated("simulating", t - self._begin, self._duration)

    def checking(self, t: float, number: int) -> None:
        """Show that a rerun has come to time ``t`` [s]: the second, third, ... run."""
        self._is_checking = True
        repeated = "" if number < 2 else f" (run {number + 1})"
        words = f"checking the accuracy{repeated}"
        self._show_simulated(words, t - self._begin, self._duration)

    def _left(self) -> str:
        seconds = self._bar.left
        if seconds is None or self._is_checking or not self.checked:
            return super()._left()
        return f"about {span(seconds)} until its accuracy is checked"


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
        self._runs, self._duration = runs, duration

    def __call__(self, t: float, done: int) -> None:
        """Show that the runs have come to ``t`` seconds together, and that some are done."""
        if t > 0.0:  # before, the first one may still wait for its kernels
            self._show_simulated(f"{done:,} of {count_of(self._runs, 'run')}", t, self._duration)


class PartProgress(_Display):
    """How far work is whose parts are not counted: ``progress(fraction, words)``."""

    def __call__(self, part: float, words: str) -> None:
        """Show which fraction is done, 0 to 1."""
        self._show(words, part, 1.0, f"{100.0 * part:.0f} %")


class SweepProgress(_Display):
    """How far a sweep is: ``progress(done, count, failed)``, in runs."""

    def __call__(self, done: int, total: int, failed: int = 0) -> None:
        """Show how many runs are done, and how many of them failed."""
        words = f"{done:,} of {count_of(total, 'run')}{f', {failed} failed' if failed else ''}"
        self._show(words, done, total, f"{100 * done // max(total, 1)} %")


def span(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3 h 20 min``, ``1,200 days``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds > CALENDAR:
        return f"{seconds / 86400:,.0f} days"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def _clock(seconds: float) -> str:
    """Format of the time of day after so many seconds."""
    return "%H:%M:%S" if seconds < 3600 else "%a %d %b %H:%M"
