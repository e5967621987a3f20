"""What the commands of the studies share: tables on the terminal, and files at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import write_json
from multiarm.results.files import save_figure, save_page
from multiarm.terminal.console import columns, print_written

if TYPE_CHECKING:
    from multiarm.studies.tables import Table

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
    numbers = [k for k, column in enumerate(heads) if column.kind == "n"]
    grid = columns("", [column.head for column in heads], rows, numbers)
    # many columns stand close together
    grid.padding, grid.pad_edge = (0, int(len(heads) <= CLOSE), 0, 0), False
    yield grid
    yield from remarks
    yield from (Text(note, "dim") for note in table.notes)
    if table.notes:
        yield Text()


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
