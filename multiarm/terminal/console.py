"""Output of all commands: messages on stderr, tables on stdout.

Texts from users (names, paths, messages) are never read as markup, and control characters are
escaped.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from multiarm.errors import shortened
from multiarm.notation import number
from multiarm.results.files import printable
from multiarm.results.outcome import RunStatus

if TYPE_CHECKING:
    from multiarm.scene import NamedCode

WHOLE = 28
"""Words of tables with so many letters at most are never broken: names of hard cases have 25."""
STATUS_STYLES: dict[str, str] = {
    RunStatus.COMPLETED: "bold green",
    RunStatus.INTERRUPTED: "bold yellow",
    RunStatus.FAILED: "bold red",
}


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
    for what in dict.fromkeys(code.what for code in named):
        console.print(Text.assemble(("loading ", "yellow"), what), soft_wrap=True)


def print_written(what: str, path: Path) -> None:
    """Say on stdout where something was written."""
    output().print(
        Text.assemble(f"{what} written to ", (printable(str(path)), "green")), soft_wrap=True
    )


def accuracy(requested: float | dict[str, float]) -> str:
    """``1e-06 m or rad``, or the named parts: ``position 1e-06 m, ...``."""
    if not isinstance(requested, dict):
        return f"{number(requested)} m or rad"
    units = {"position": "m", "rotation": "rad", "force": "N"}
    return ", ".join(f"{name} {number(value, units[name])}" for name, value in requested.items())


def facts(title: str, rows: dict[str, RenderableType]) -> Table:
    """A table of two columns, what and how much; texts are shown as they are."""
    table = Table(
        title=Text(printable(title), "bold"),
        box=box.SIMPLE_HEAD,
        show_header=False,
        title_justify="left",
    )
    table.add_column(style="cyan", overflow="fold")
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(*map(_as_text, (name, value)))
    return table


class _Columns(Table):
    """A table that is shown as several ones where the terminal is too narrow for its columns.

    Rich would cut them off or leave them out.  The first column, which names the rows, is in each.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Narrow the widest columns, down to their least widths, or render the table's halves."""
        unbounded = options.update(width=100_000)  # else nothing is wider than the terminal
        wanted, widths = [], [column.min_width or 1 for column in self.columns]
        for column in self.columns:
            column.width = None
            cells = (column.header, *column.cells)
            wanted.append(max(Measurement.get(console, unbounded, cell).maximum for cell in cells))
        between = console.measure(self, options=unbounded).maximum - sum(wanted)
        room = options.max_width - between
        if sum(widths) > room and len(wanted) > 2:
            yield from self._halves()
            return
        if sum(widths) > room:
            widths = [1] * len(wanted)
        while sum(widths) < min(room, sum(wanted)):
            narrow = [k for k, width in enumerate(widths) if width < wanted[k]]
            widths[min(narrow, key=widths.__getitem__)] += 1
        for column, width in zip(self.columns, widths, strict=True):
            column.width = width
        yield from super().__rich_console__(console, options)

    def _halves(self) -> Iterator[_Columns]:
        names, *values = self.columns
        half = len(self.columns) // 2
        for title, part in ((self.title, values[:half]), (None, values[half:])):
            shown = [names, *part]
            narrow = _Columns(
                *(column.copy() for column in shown), title=title, box=self.box,
                title_justify="left", padding=self.padding, pad_edge=self.pad_edge,
            )  # fmt: skip
            for row in zip(*(column.cells for column in shown), strict=True):
                narrow.add_row(*row)
            yield narrow


def columns(
    title: str,
    names: Sequence[str],
    rows: Iterable[Sequence[RenderableType]],
    numbers: Container[int] = (),
) -> Table:
    """A table with a heading for each column; texts are shown as they are, words stay whole.

    The columns ``numbers`` stand right and are never wrapped.
    """
    heading = Text(printable(title), "bold")
    table = _Columns(title=heading, box=box.SIMPLE_HEAD, title_justify="left")
    shown = [[_as_text(cell) for cell in row] for row in rows]
    for k, name in enumerate(names):
        cells = [_as_text(name), *(row[k] for row in shown if k < len(row))]
        texts = [cell.plain for cell in cells if isinstance(cell, Text)]
        if k in numbers:
            least = [cell_len(line) for text in texts for line in text.splitlines()]
        else:
            least = [min(cell_len(word), WHOLE) for text in texts for word in text.split()]
        table.add_column(
            cells[0], header_style="cyan", overflow="fold", min_width=max(least, default=1),
            justify="right" if k in numbers else "left",
        )  # fmt: skip
    for row in shown:
        table.add_row(*row)
    return table


def _as_text(value: RenderableType) -> RenderableType:
    """A text as it will be seen, so that columns are as wide as they have to be."""
    return Text(printable(value)) if isinstance(value, str) else value
