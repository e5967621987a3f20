"""A sweep as it is watched: how many runs are done, how many failed, and when it ends."""

from __future__ import annotations

import math
import time
from datetime import datetime, timedelta

from rich.progress import TextColumn
from typing_extensions import Self

from multiarm.cli.progress import passing_bar
from multiarm.cli.terminal import messages

__all__ = ["SweepProgress"]

LINES = 30.0
"""[s] between two lines where there is no terminal."""


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
        self._told = -math.inf

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
        if self._bar.disable and not self._quiet and (now > self._told + LINES or done == total):
            self._told = now
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


def _span(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
