"""``multiarm accuracy``: the cost of accuracy on a scene."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, scene_to_run, write_json
from multiarm.cli.options import (
    FILES,
    JsonFile,
    NoCode,
    file_option,
    option,
    with_settings,
)
from multiarm.errors import MultiarmError
from multiarm.results.files import save_figure, save_page
from multiarm.terminal.console import columns, number, output, print_error, print_written
from multiarm.terminal.progress import Progress, span

if TYPE_CHECKING:
    from multiarm.scene import Scene
    from multiarm.studies.work_precision.points import Point
    from multiarm.studies.work_precision.store import Results

__all__ = ["accuracy", "decade_table", "method_table", "point_table"]

REWRITE, SHARE = 5.0, 0.1
"""Files of an unfinished study are written at most so often [s], and take such a share of the time
at most."""


class Quantity(str, Enum):
    """What an error is of."""

    motion = "motion"
    position = "position"
    rotation = "rotation"
    joints = "joints"
    force = "force"


@with_settings("duration", "output_step", "arms")
def accuracy(
    scene: Annotated[
        Path | None,
        typer.Argument(help="The scene, a YAML file.", metavar="SCENE", show_default=False),
    ] = None,
    *,
    settings: dict[str, Any],
    peers: Annotated[
        bool,
        typer.Option(
            "--peers/--no-peers",
            help="Run the scene in Pinocchio, and in MuJoCo and Drake if they are installed.",
        ),
    ] = True,
    quick: Annotated[
        bool, typer.Option("--quick", help="Every second setting only, and fewer repeats.")
    ] = False,
    thorough: Annotated[
        bool,
        typer.Option("--thorough", help="Measure dominated settings too, as often as others."),
    ] = False,
    error: Annotated[
        Quantity, option("What is ranked; motion is the worst of position, rotation and joints.")
    ] = Quantity.motion,
    every: Annotated[bool, typer.Option("--all", help="Print every point.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File of the study; an interrupted study resumes from it.",
            show_default="SCENE's file name, --arms and .accuracy.json, in the current folder",
            metavar="FILE.json",
            rich_help_panel=FILES,
        ),
    ] = None,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Begin again, and overwrite the file.", rich_help_panel=FILES),
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Measure nothing: print and draw what is in a file of a study.",
            show_default="none",
            metavar="FILE.json",
            rich_help_panel=FILES,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        file_option("Draw the diagram to a file; its ending (png, svg, pdf) is the format."),
    ] = None,
    html: Annotated[
        Path | None,
        file_option("Write one HTML page: the diagram with values, and all points.", "FILE.html"),
    ] = None,
    json: JsonFile = None,
    no_code: NoCode = False,
) -> None:
    """Measure what accuracy costs on a scene: every method, compared with other programs.

    Every integrator runs the scene over its steps or tolerances, with each stabilisation. Errors
    are measured against a tight reference, which an independent solver and another method have
    checked; wall times are the fastest of several interleaved runs.

    First results come within half a minute. Their errors are measured against the tightest run that
    fits the time, and are computed again when the reference is there. The figures of --plot and
    --html are written at once, and again as points arrive; the page says how many are measured.

    A setting is dominated when another one, of the same or another method, takes less than two
    thirds of its time and has no larger error of position, rotation, joints or force; errors that
    the reference cannot resolve count as equal. A setting between two measured ones of its method
    takes at least the coarser one's time, and its errors are at least half of the finer one's. What
    is dominated even so is left out, unless --thorough. Peers dominate peers only.

    The file of the study stores every point when it is measured: after Ctrl-C the same command
    resumes. A file holds for one scene, one machine and one set of versions.

    The JSON has the keys scene, machine, reference, refusals, wall_time_s, left_out, points,
    cheapest, recommendation. Numbers are finite, or null where there is none.
    """
    if (scene is None) == (source is None):
        raise MultiarmError("name a scene to measure, or '--from FILE.json' to look at a study")
    if source is not None:
        from multiarm.studies.work_precision.store import read_results

        check_targets({"--plot": plot, "--html": html, "--json": json}, source=source)
        found = read_results(source)
    else:
        assert scene is not None, "one of the two is there"
        target = out if out is not None else _own_file(scene, settings)
        check_targets(
            {"--out": target, "--plot": plot, "--html": html, "--json": json}, source=scene
        )
        loaded = scene_to_run(scene, no_code)
        with Progress() as progress:
            shown = _Shown(progress, error.value, plot, html)
            found = _measure(loaded, target, settings, shown, fresh,
                             peers=peers, quick=quick, thorough=thorough)  # fmt: skip
        print_written("study", target)
    _print(found, error.value, every)
    _write(found, error.value, plot, html, json)


def _own_file(scene: Path, settings: dict[str, Any]) -> Path:
    """The default file of a study: one for each value of --arms."""
    kind = f".{settings['arms']}" if "arms" in settings else ""
    return Path(f"{scene.stem}{kind}.accuracy.json")


def _measure(
    scene: Scene, target: Path, changes: dict, shown: _Shown, fresh: bool, **options: bool
) -> Results:
    """Study a scene behind a progress bar; what was measured stays in the file."""
    from multiarm.simulation.setup import run_spec
    from multiarm.studies.records import machine
    from multiarm.studies.work_precision.store import Results
    from multiarm.studies.work_precision.study import run_study

    scene = scene.replace(run=run_spec(scene.run, changes, {}, None))
    kept = _kept(target, Results.of(scene, machine(), target), fresh)
    try:
        return run_study(scene, kept, progress=shown.progress, watch=shown, **options)
    except KeyboardInterrupt:
        shown.progress.stop()
        print_error(
            f"interrupted; {len(kept.points)} points are in '{target}', and the same command "
            "resumes from there"
        )
        raise typer.Exit(1) from None


class _Shown:
    """What is shown of a study while it goes on: first results, recommendation, files.

    Parameters
    ----------
    progress : Progress
    quantity : str
    plot, html : Path or None
        Files that are written again as points arrive.
    """

    def __init__(
        self, progress: Progress, quantity: str, plot: Path | None, html: Path | None
    ) -> None:
        self.progress = progress
        self._quantity, self._plot, self._html = quantity, plot, html
        self._printed, self._announced, self._due = False, False, -math.inf

    def __call__(self, results: Results) -> None:
        """Show results, of which there are more than at the last call."""
        from multiarm.studies.work_precision.words import recommendation

        if results.planned is None:  # finished, and about to be printed and written
            return
        self.progress.note(recommendation(results, self._quantity))
        if not self._printed:
            self._printed = True
            self.progress.print("First results", *_texts(results, self._quantity))
        if not self._announced and not (results.reference or {}).get("first"):
            self._announced = True
            left = (results.planned or 0) - len(results.points)
            self.progress.print(
                f"The reference is checked. About {span(results.expected_s)} more: {left} further "
                f"settings, and repetitions of the {len(results.points)} that are measured."
            )
        begin = time.monotonic()
        if begin >= self._due:
            _draw(results, self._quantity, self._plot, self._html)
            now = time.monotonic()
            self._due = now + max(REWRITE, (now - begin) / SHARE)


def _kept(target: Path, empty: Results, fresh: bool) -> Results:
    """The points in the file; an error if they belong to another scene or machine."""
    from multiarm.studies.work_precision.store import read_results

    if fresh or not target.exists():
        return empty
    old = read_results(target)
    reason = old.stale(empty)
    if reason:
        raise MultiarmError(
            f"--out: '{target}' holds another study ({reason}); name another file, or give "
            "--fresh to replace it"
        )
    return old


def _texts(results: Results, quantity: str, *tables: RenderableType) -> Iterator[RenderableType]:
    """A study as it is printed: reference, decades, further tables, and what follows from them."""
    from multiarm.studies.work_precision.words import (
        comparison,
        recommendation,
        reference_text,
        state_text,
    )

    yield Text(reference_text(results), "dim")
    yield decade_table(results, quantity)
    yield from tables
    for solver, reason in results.refusals.items():
        yield Text(f"{solver}: {reason}", "dim")
    if state_text(results):
        yield Text(state_text(results), "dim")
    for sentence in (recommendation(results, quantity), comparison(results, quantity)):
        if sentence:
            yield Text(sentence, "bold green")


def _print(results: Results, quantity: str, every: bool) -> None:
    console = output()
    console.print(Text(results.about["scene"]["name"], "bold"))
    tables = [method_table(results, quantity), *([point_table(results)] if every else [])]
    for text in _texts(results, quantity, *tables):
        console.print(text, soft_wrap=getattr(text, "style", "") == "bold green")


def _draw(results: Results, quantity: str, plot: Path | None, html: Path | None) -> None:
    """Write the diagram and the page."""
    from multiarm.studies.work_precision.page import diagram, render

    if plot is not None:
        save_figure(diagram(results, quantity), plot)
    if html is not None:
        save_page(render(results, quantity), html)


def _write(
    results: Results, quantity: str, plot: Path | None, html: Path | None, json: Path | None
) -> None:
    from multiarm.studies.work_precision.words import figures

    _draw(results, quantity, plot, html)
    if json is not None:
        write_json(json, figures(results, quantity))
    for what, path in (("plot", plot), ("page", html), ("figures", json)):
        if path is not None:
            print_written(what, path)


def decade_table(results: Results, quantity: str) -> Table:
    """The cheapest setting for each power of ten, and the best peer's."""
    from multiarm.studies.work_precision.choice import decades
    from multiarm.studies.work_precision.reference import QUANTITIES
    from multiarm.studies.work_precision.settings import short
    from multiarm.studies.work_precision.words import described

    what, unit = QUANTITIES[quantity]
    found = decades(results, quantity)
    with_peers = any(decade.peer for decade in found)
    heads = ["below", "cheapest setting", "ms"]
    heads += ["best peer", "ms", "peer/ours"] if with_peers else []
    rows: list[list[str]] = []
    for decade in found:
        row = [short(decade.level)]
        for point in (decade.ours, decade.peer)[: 2 if with_peers else 1]:
            row += ["-", "-"] if point is None else [described(point), _time(point)]
        if with_peers:
            row.append("-" if decade.ratio is None else f"{decade.ratio:.1f}")
        rows.append(row)
    table = columns(f"Cheapest for an error below, {what} [{unit}]", heads, rows)
    return _right(table, 2, 4, 5)


def method_table(results: Results, quantity: str) -> Table:
    """One line a method."""
    from multiarm.studies.work_precision.choice import (
        CLAIMED,
        all_series,
        cheapest,
        digits_of,
    )
    from multiarm.studies.work_precision.settings import short

    digits = digits_of(results, quantity)
    levels = (1e-3, *CLAIMED)
    heads = ["method", *(short(level) for level in levels), "least", "gap m", "energy J", "failed"]

    def rows() -> Iterator[list[RenderableType]]:
        for item in all_series(results):
            found = [cheapest(item.points, level, quantity, digits) for level in levels]
            best = item.best(quantity)
            least = None if best is None else max(best.error(quantity) or 0.0, digits)
            yield [
                Text(item.name, "" if item.ours else "dim"),
                *("-" if point is None else _time(point) for point in found),
                _small(least),
                _small(None if best is None else best.gap_m),
                _small(None if best is None else best.energy_J),
                f"{len(item.failures)}/{len(item.points)}" if item.failures else "",
            ]

    title = "Methods: ms of wall time to an error, and what they are at their most precise"
    return _right(columns(title, heads, rows()), *range(1, 8))


def point_table(results: Results) -> Table:
    """Every point, in the order of the methods."""
    from multiarm.studies.work_precision.choice import all_series

    heads = ("setting", "ms", "evals", "pos.", "rot.", "joints", "force", "gap", "energy")

    def rows() -> Iterator[list[RenderableType]]:
        for item in all_series(results):
            for point in item.points:
                if not point.completed:
                    reason = (f"\n{point.status}: {point.message}", "red")
                    yield [Text.assemble(point.setting.text, reason)]
                    continue
                errors = (point.errors.get(k) for k in ("position", "rotation", "joints", "force"))
                yield [
                    point.setting.text,
                    _time(point),
                    number(point.evaluations),
                    *(_small(value) for value in (*errors, point.gap_m, point.energy_J)),
                ]

    return _right(
        columns("All points: errors [m, rad, rad, N], gap [m], energy [J]", heads, rows()),
        *range(1, len(heads)),
    )


def _right(table: Table, *numbers: int) -> Table:
    """The table with narrow padding, its columns of numbers right-aligned and not wrapped."""
    table.padding, table.pad_edge = (0, 1, 0, 0), False
    table.min_width = len(str(table.title))
    for k in numbers:
        if k < len(table.columns):
            table.columns[k].justify = "right"
            table.columns[k].no_wrap = True
    return table


def _time(point: Point) -> str:
    """Milliseconds."""
    value = 1e3 * (point.wall_time_s or 0.0)
    return f"{value:,.0f}" if value >= 1e3 else f"{value:.3g}"


def _small(value: float | None) -> str:
    return "-" if value is None else f"{value:.0e}"
