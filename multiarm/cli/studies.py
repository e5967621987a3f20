"""What the commands of the studies share: texts on the terminal, and files at the end.

How a study is shown says its module ``page`` (:mod:`multiarm.studies.tables`), which takes what was
found, and options.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import write_json
from multiarm.results.files import save_figure, save_page
from multiarm.terminal.console import columns, output, print_written

if TYPE_CHECKING:
    from multiarm.studies.tables import Line, Table

__all__ = ["draw_files", "lines_of", "print_texts", "rendered", "write_files"]

TONES = {
    "": "", "strong": "bold", "good": "green", "warn": "yellow", "bad": "red", "pale": "dim",
    "verdict": "bold green",
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


def lines_of(texts: Iterable[Table | Line]) -> Iterator[RenderableType]:
    """Tables and lines for the terminal."""
    from multiarm.studies.tables import Line

    for item in texts:
        if isinstance(item, Line):
            yield Text(item.text, TONES[item.tone])
        else:
            yield from rendered(item)


def print_texts(texts: Iterable[Table | Line]) -> None:
    """Print tables and lines on stdout; a verdict is not broken into lines."""
    console = output()
    for item in lines_of(texts):
        console.print(item, soft_wrap=getattr(item, "style", "") == TONES["verdict"])


def draw_files(
    page: ModuleType, found: Any, *options: Any, plot: Path | None, html: Path | None
) -> None:
    """Write what a study found as a figure and as a page, where they were asked for."""
    if plot is not None:
        save_figure(page.figure(found, *options), plot)
    if html is not None:
        save_page(page.render(found, *options), html)


def write_files(
    page: ModuleType,
    found: Any,
    *options: Any,
    plot: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
) -> None:
    """Write the files that were asked for, all figures as JSON among them, and print where."""
    draw_files(page, found, *options, plot=plot, html=html)
    if json is not None:
        write_json(json, page.figures(found, *options))
    for what, path in (("plot", plot), ("page", html), ("figures", json)):
        if path is not None:
            print_written(what, path)
