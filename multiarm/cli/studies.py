"""What the commands of the studies share: tables on the terminal, and files at the end.

How a study is shown says its page module: ``figure``, ``render`` (the HTML page) and ``figures``
(all numbers, for JSON), of the study and of options.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import write_json
from multiarm.results.files import printable, save_figure, write_text
from multiarm.terminal.console import columns, print_written

if TYPE_CHECKING:
    from multiarm.studies.tables import TextTable

CLOSE = 8


def rendered(table: TextTable) -> Iterator[RenderableType]:
    """A table for the terminal, and below it the remarks on its rows."""
    from multiarm.studies.tables import NUMBER, REMARK

    shown = [k for k, kind in enumerate(table.kinds) if kind != REMARK]
    rows = [[row[k] for k in shown] for row in table.rows]
    numbers = [place for place, k in enumerate(shown) if table.kinds[k] == NUMBER]
    grid = columns(table.title, [table.heads[k] for k in shown], rows, numbers)
    # many columns stand close together
    grid.padding, grid.pad_edge = (0, int(len(shown) <= CLOSE), 0, 0), False
    yield grid
    for name, *cells in table.rows:
        for kind, cell in zip(table.kinds[1:], cells, strict=True):
            if kind == REMARK and cell:
                yield Text(f"{name}: {cell}", "dim")


def draw_files(
    page: ModuleType, study: Any, *options: Any, plot: Path | None, html: Path | None
) -> None:
    """Write a study as a figure and as a page, where they were asked for."""
    if plot is not None:
        save_figure(page.figure(study, *options), plot)
    if html is not None:
        write_text(html, printable(page.render(study, *options)), "--html")


def write_files(
    page: ModuleType,
    study: Any,
    *options: Any,
    plot: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
) -> None:
    """Write the files that were asked for, all figures as JSON among them, and print where."""
    draw_files(page, study, *options, plot=plot, html=html)
    if json is not None:
        write_json(json, page.figures(study, *options))
    for what, path in (("plot", plot), ("page", html), ("figures", json)):
        if path is not None:
            print_written(what, path)
