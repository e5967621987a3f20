"""Output of all commands: messages on stderr, tables on stdout, numbers in one style.

Texts from users (names, paths, messages) are never read as markup, and control characters are
escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from multiarm.errors import shortened
from multiarm.results.files import printable

if TYPE_CHECKING:
    from multiarm.scene import NamedCode

__all__ = [
    "STATUS_STYLES",
    "accuracy",
    "columns",
    "facts",
    "messages",
    "number",
    "output",
    "print_error",
    "print_loaded",
    "print_warnings",
    "print_written",
    "vector",
]

WHOLE = 24
"""Words of tables with so many letters at most are never broken."""
STATUS_STYLES = {"completed": "bold green", "interrupted": "bold yellow", "failed": "bold red"}


class _Terminal(Console):
    """A console that shows all texts as they are; only Rich itself sends codes to the terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render to segments; their texts become printable, codes of Rich's own stay."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def output() -> Console:
    """Where results go: stdout."""
    return _Terminal()


def messages() -> Console:
    """Where errors, warnings and progress go: stderr."""
    return _Terminal(stderr=True)


def print_error(text: str) -> None:
    """Print ``error: text`` in red on stderr; lines stay whole."""
    line = Text.assemble(("error: ", "bold red"), (printable(text), "red"))
    messages().print(line, soft_wrap=True)


def print_warnings(texts: Iterable[str]) -> None:
    """Print each text in yellow on stderr."""
    console = messages()
    for text in texts:
        line = Text.assemble(("warning: ", "bold yellow"), (shortened(printable(text)), "yellow"))
        console.print(line, soft_wrap=True)


def print_loaded(named: Iterable[NamedCode]) -> None:
    """Say on stderr which code is going to be loaded, a line each."""
    console = messages()
    for one in dict.fromkeys(code.what for code in named):
        console.print(Text.assemble(("loading ", "yellow"), one), soft_wrap=True)


def print_written(what: str, path: Path) -> None:
    """Say on stdout where something was written."""
    output().print(
        Text.assemble(f"{what} written to ", (printable(str(path)), "green")), soft_wrap=True
    )


def number(value: float | None, unit: str = "") -> str:
    """Three digits and the unit: ``number(2.5e-9, "m")`` is ``2.5e-09 m``; a dash for None."""
    if value is None:
        return "-"
    text = f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
    return f"{text} {unit}".rstrip()


def accuracy(requested: float | dict[str, float]) -> str:
    """``1e-06 m or rad``, or the named parts: ``position 1e-06 m, ...``."""
    if not isinstance(requested, dict):
        return f"{number(requested)} m or rad"
    units = {"position": "m", "rotation": "rad", "force": "N"}
    return ", ".join(f"{name} {number(value, units[name])}" for name, value in requested.items())


def vector(values: Sequence[float], unit: str = "", digits: int = 4) -> str:
    """Comma-separated numbers and the unit; roundings of zero are shown as 0."""
    largest = max((abs(value) for value in values), default=0.0)
    shown = [0.0 if abs(value) < 1e-12 * max(largest, 1.0) else value for value in values]
    return f"{', '.join(f'{value:.{digits}g}' for value in shown)} {unit}".rstrip()


def facts(title: str, rows: dict[str, RenderableType]) -> Table:
    """A table of two columns, what and how much; texts are shown as they are."""
    table = Table(
        title=Text(printable(title), "bold"),
        box=box.SIMPLE_HEAD,
        show_header=False,
        title_justify="left",
    )
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(*map(_as_text, (name, value)))
    return table


def columns(title: str, names: Sequence[str], rows: Iterable[Sequence[RenderableType]]) -> Table:
    """A table with a heading for each column; texts are shown as they are, words stay whole."""
    table = Table(title=Text(printable(title), "bold"), box=box.SIMPLE_HEAD, title_justify="left")
    shown = [[_as_text(cell) for cell in row] for row in rows]
    for k, name in enumerate(names):
        cells = [_as_text(name), *(row[k] for row in shown if k < len(row))]
        width = max(map(_longest_word, cells))
        # Rich narrows the widest columns first: not those that have nothing to wrap
        single = all(isinstance(cell, Text) and cell.cell_len <= width for cell in cells)
        table.add_column(
            cells[0], header_style="cyan", overflow="fold", min_width=width, no_wrap=single
        )
    for row in shown:
        table.add_row(*row)
    return table


def _longest_word(cell: RenderableType) -> int:
    """Letters of the longest word of a cell; of longer ones than ``WHOLE``, that many."""
    words = cell.plain.split() if isinstance(cell, Text) else []
    return min(max(map(len, words), default=0), WHOLE)


def _as_text(value: RenderableType) -> RenderableType:
    """A text as it will be seen, so that columns are as wide as they have to be."""
    return Text(printable(value)) if isinstance(value, str) else value
