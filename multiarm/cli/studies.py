"""What the commands of the studies share: tables on the terminal, and files at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import write_json
from multiarm.results.files import save_figure, save_page
from multiarm.terminal.console import columns, output, print_written

if TYPE_CHECKING:
    from multiarm.studies.tables import Column, Table

__all__ = ["draw_files", "rendered", "write_files"]

TONES = {
    "": "", "strong": "bold", "good": "green", "warn": "yellow", "bad": "red", "pale": "dim",
}  # fmt: skip
CLOSE = 8


def rendered(table: Table) -> Iterator[RenderableType]:
    """A table for the terminal, and below it the remarks on its rows and its notes."""
    heads = [c for c in table.columns if c.kind != "e" and not c.wide]
    rows, remarks = [], []
    for name, *cells in table.written(on_page=False):
        shown = [cell for cell in cells if cell.kind != "e"]
        rows.append([Text(cell.text, TONES[cell.tone]) for cell in (name, *shown)])
        remarks += [
            Text(f"{name.text}: {cell.text}", TONES[cell.tone] or "dim")
            for cell in cells
            if cell.kind == "e" and cell.text
        ]
    yield Text(table.title, "bold")
    yield from _grids(heads, rows)
    yield from remarks
    yield from (Text(note, "dim") for note in table.notes)
    if table.notes:
        yield Text()


def _grids(heads: Sequence[Column], rows: Sequence[Sequence[Text]]) -> Iterator[RenderableType]:
    """The columns in one table, or in several where the terminal is too narrow for all."""
    grid = columns("", [column.head for column in heads], rows)
    grid.title = None  # it may be longer than the table is wide
    # many columns stand close together
    grid.padding = (0, int(len(heads) <= CLOSE), 0, 0)
    grid.pad_edge = False
    for shown, column in zip(grid.columns, heads, strict=True):
        if column.kind == "n":
            shown.justify, shown.no_wrap = "right", True
    console = output()
    unbounded = console.options.update(width=1000)  # else it is no wider than the terminal
    if len(heads) < 3 or console.measure(grid, options=unbounded).minimum <= console.width:
        yield grid
        return
    middle = 1 + len(heads) // 2
    for part in (slice(1, middle), slice(middle, None)):
        yield from _grids([heads[0], *heads[part]], [[row[0], *row[part]] for row in rows])


def draw_files(page: str, found: Any, *options: Any, plot: Path | None, html: Path | None) -> None:
    """Write what a study found as a figure and as a page, where they were asked for.

    ``page`` is the study's module with ``figure`` and ``render``, which take ``options`` too; it is
    loaded where one of them is needed.
    """
    if plot is not None:
        save_figure(import_module(page).figure(found, *options), plot)
    if html is not None:
        save_page(import_module(page).render(found, *options), html)


def write_files(
    page: str,
    found: Any,
    *options: Any,
    figures: Callable[[], Mapping[str, Any]],
    plot: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
) -> None:
    """Write the files that were asked for, ``figures`` as JSON among them, and print where."""
    draw_files(page, found, *options, plot=plot, html=html)
    if json is not None:
        write_json(json, figures())
    for what, path in (("plot", plot), ("page", html), ("figures", json)):
        if path is not None:
            print_written(what, path)
