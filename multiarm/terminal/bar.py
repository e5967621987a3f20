"""A bar on a terminal, with what is being done and a sentence below it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TimeElapsedColumn,
)
from rich.text import Text

__all__ = ["Bar"]


class Bar(Progress):
    """Words, a bar, an amount, the time so far; on terminals only, and removed at the end.

    Parameters
    ----------
    console : Console
    words, amount : callable
        What is being done, and how much of it is done, whenever the bar is drawn.
    hidden : bool

    Attributes
    ----------
    note : str
        A sentence; empty where there is nothing to say.
    """

    note = ""

    def __init__(
        self, console: Console, words: Callable[[], str], amount: Callable[[], str], hidden: bool
    ) -> None:
        super().__init__(
            SpinnerColumn(),
            _TextNow(words),
            BarColumn(),
            _TextNow(amount, "cyan"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=hidden or not console.is_terminal,
        )
        self._work = self.add_task("", total=None)

    def show(self, done: float, total: float) -> None:
        """Show how much of how much is done; 0 of 0: not known."""
        self.update(self._work, completed=done, total=total or None)

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn: the bar, and the sentence."""
        yield from super().get_renderables()
        if self.note:
            yield Text(self.note, "green")


class _TextNow(ProgressColumn):
    """A text that is made whenever the bar is drawn."""

    def __init__(self, text: Callable[[], str], style: str = "") -> None:
        super().__init__()
        self._text, self._style = text, style

    def render(self, task: Task) -> Text:
        """The text as it is now."""
        return Text(self._text(), self._style)
