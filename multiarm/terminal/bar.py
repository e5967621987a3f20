"""A bar on a terminal, with what is being done and a sentence below it; and the pace of the work.

The pace is Rich's, on a clock that stands still during compilation: that of the latest half of the
time, of half a minute at least, so that parts of the work that take longer than those before show
soon.  There is none before the work has gone on twice in that time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text

from multiarm.jit.compilation import process_running_time

RECENT, SHARE = 30.0, 0.5
"""The pace is taken over so long [s] at least, and over such a share of the time so far."""


class Bar(Progress):
    """Words, a bar, an amount, the time so far; on terminals only, and removed at the end.

    Parameters
    ----------
    console : Console
    words, amount, elapsed : callable
        What is being done, how much of it is done, and how long it has taken, whenever the bar is
        drawn.
    hidden : bool

    Attributes
    ----------
    note : str
        A sentence; empty where there is nothing to say.
    """

    note = ""

    def __init__(
        self,
        console: Console,
        words: Callable[[], str],
        amount: Callable[[], str],
        elapsed: Callable[[], str],
        hidden: bool,
    ) -> None:
        super().__init__(
            _Spinner(),
            _TextNow(words),
            BarColumn(),
            _TextNow(amount, "cyan"),
            _TextNow(elapsed, "progress.elapsed"),
            console=console,
            transient=True,
            disable=hidden or not console.is_terminal,
            get_time=process_running_time,
        )
        self.add_task("", total=None)

    @property
    def _work(self) -> Task:
        return self.tasks[0]

    def show(self, done: float, total: float) -> None:
        """Show how much of how much is done; 0 of 0: not known."""
        if done < self._work.completed:  # another stage begins
            self.reset(self._work.id)
        self.speed_estimate_period = max(RECENT, SHARE * (self._work.elapsed or 0.0))
        self.update(self._work.id, completed=done, total=total or None)

    @property
    def pace(self) -> float | None:
        """How much is done in a second; None if not known."""
        return self._work.speed

    @property
    def left(self) -> float | None:
        """How long it will take at this pace [s]; None if that is not known."""
        return None if self._work.finished else self._work.time_remaining

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn: the bar, and the sentence."""
        yield from super().get_renderables()
        if self.note:
            yield Text(self.note, "green")


class _Spinner(SpinnerColumn):
    """A spinner that turns during compilation too."""

    def render(self, task: Task) -> RenderableType:
        """The spinner as it is now."""
        return self.spinner.render(time.monotonic())


class _TextNow(ProgressColumn):
    """A text that is made whenever the bar is drawn."""

    def __init__(self, text: Callable[[], str], style: str = "") -> None:
        super().__init__()
        self._text, self._style = text, style

    def render(self, task: Task) -> Text:
        """The text as it is now."""
        return Text(self._text(), self._style)
