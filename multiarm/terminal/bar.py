"""A bar on a terminal, with what is being done and a sentence below it."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

__all__ = ["Bar"]


class Bar(Progress):
    """Words, a bar, an amount, the time so far; on terminals only, and removed at the end.

    Attributes
    ----------
    note : str
        A sentence; empty where there is nothing to say.
    """

    note = ""

    def __init__(self, console: Console, words: str, hidden: bool) -> None:
        super().__init__(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[amount]}", style="cyan", markup=False),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=hidden or not console.is_terminal,
        )
        self._only = self.add_task(words, total=None, amount="")

    def show(self, words: str, done: float, total: float, amount: str) -> None:
        """Show what is being done, how much of how much, and that in words."""
        self.update(
            self._only, description=words, completed=done, total=total or None, amount=amount
        )

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn: the bar, and the sentence."""
        yield from super().get_renderables()
        if self.note:
            yield Text(self.note, "green")
