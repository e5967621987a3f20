"""``multiarm sweep``: run a scene many times with other values; the rows survive a kill."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, write_json
from multiarm.cli.options import (
    FILES,
    Accuracy,
    Duration,
    JsonFile,
    NoCode,
    Quiet,
    SceneFile,
    chosen,
    file_option,
    option,
    plot_option,
    switch,
)
from multiarm.errors import SweepError
from multiarm.notation import count_of, number
from multiarm.results.files import atomic_output, save_figure
from multiarm.results.outcome import RunStatus
from multiarm.terminal.console import (
    STATUS_STYLES,
    columns,
    facts,
    messages,
    output,
    print_error,
    print_loaded,
    print_warnings,
    print_written,
)
from multiarm.terminal.progress import SweepProgress

if TYPE_CHECKING:
    from multiarm.sweeps.result import Sweep, SweepSummary


WORKERS = "Workers"
OF_SWEEP = "the sweep's"


def sweep(
    scene: SceneFile,
    over: Annotated[
        Path,
        option("The sweep, a YAML file: what varies, how, and what is kept.", "FILE.yaml"),
    ],
    duration: Duration = None,
    accuracy: Accuracy = None,
    repeat: Annotated[
        int | None, option("Runs of each point of the grid.", "N", default=OF_SWEEP, min=1)
    ] = None,
    seed: Annotated[
        int | None, option("Of all random values.", "N", default=OF_SWEEP, min=0)
    ] = None,
    workers: Annotated[
        int | None,
        option(
            "Processes on this computer; 1 works in this one.",
            "N",
            default="one for each core",
            panel=WORKERS,
            min=1,
        ),
    ] = None,
    dask: Annotated[
        str | None,
        option(
            "Scheduler of a Dask cluster, such as tcp://host:8786, whose workers take the "
            "runs; 'config' for the one that Dask's own configuration names.",
            "ADDRESS",
            default="none",
            panel=WORKERS,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        file_option(
            "Folder of the sweep; an existing one is resumed.",
            "NAME.sweep",
            default="the sweep's file name with .sweep, in the current folder",
        ),
    ] = None,
    fresh: Annotated[bool, switch("--fresh", "Begin again in the folder.", FILES)] = False,
    plot: Annotated[Path | None, plot_option("Draw the quantities over the varied values")] = None,
    csv: Annotated[Path | None, file_option("Write the table as CSV.", "FILE.csv")] = None,
    parquet: Annotated[
        Path | None, file_option("Write the table as Parquet.", "FILE.parquet")
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
    no_code: NoCode = False,
) -> None:
    """Run a scene many times with other values in it, and keep some numbers of every run.

    Rows are on the disk as soon as runs end. After Ctrl-C or a kill, the same command resumes the
    sweep. A run that fails has a row with the reason. Every run follows from scene, sweep and its
    number alone: **multiarm replay NAME.sweep --run 17** simulates and shows run 17.

    The exit code is 0 when all runs are made and some completed, 1 when the sweep was interrupted
    or no run completed, 2 for bad input.

    The JSON has the keys scene, over (paths), count, done, statuses, wall_time (of all runs, in s),
    spreads (name, unit, words, count, smallest, smallest_run, largest, largest_run, mean,
    quantiles), failures (status, message, runs, first_run) and files (result, plot, csv, parquet).
    Numbers are finite, or null where there is none.
    """
    target = out if out is not None else Path(f"{over.stem}.sweep")
    written = {"--plot": plot, "--csv": csv, "--parquet": parquet, "--json": json}
    for source in (scene, over):
        check_targets(written, source=source)
    from multiarm.scene import load_scene
    from multiarm.sweeps.plan import make_plan
    from multiarm.sweeps.sweep import run_plan

    loaded = load_scene(scene, code=not no_code)
    print_warnings(loaded.warnings)
    keys = {**chosen(repeat=repeat, seed=seed), "run": chosen(duration=duration, accuracy=accuracy)}
    plan = make_plan(loaded, over, **keys)
    print_loaded(plan.code)
    with SweepProgress(quiet) as progress:
        result = run_plan(
            plan,
            target,
            workers=workers,
            dask=True if dask == "config" else dask,
            progress=progress,
            resume=not fresh,
        )
    summary = result.summary()
    if not quiet:
        output().print(facts_table(result.scene.name, summary, result.paths))
        output().print(spread_table(summary))
        print_written("sweep", target)
    print_warnings(trouble_lines(summary))
    files = _write(result, {"csv": csv, "parquet": parquet, "plot": plot}, quiet)
    if json is not None:
        figures = {"scene": result.scene.name, "over": list(result.paths), **summary.figures()}
        write_json(json, {**figures, "files": {"result": str(target), **files}})
    _end(summary, target, quiet)


def _write(sweep: Sweep, files: dict[str, Path | None], quiet: bool) -> dict[str, str]:
    """Write the requested files; returns their paths."""
    csv, parquet, plot = files["csv"], files["parquet"], files["plot"]
    if csv is not None:
        with atomic_output(csv, "--csv") as partial_file:
            sweep.table.to_csv(partial_file, index=False)
    if parquet is not None:
        from multiarm.sweeps.folder import without_mixed_types

        with atomic_output(parquet, "--parquet") as partial_file:
            without_mixed_types(sweep.table).to_parquet(partial_file, index=False)
    if plot is not None:
        from multiarm.plots.sweep_figures import sweep_overview

        try:
            save_figure(sweep_overview(sweep), plot)
        except SweepError as error:
            print_warnings([f"nothing was drawn: {error}"])
            files = {**files, "plot": None}
    written = {what: path for what, path in files.items() if path is not None}
    if not quiet:
        for what, path in written.items():
            print_written(what, path)
    return {what: str(path) for what, path in written.items()}


def _end(summary: SweepSummary, target: Path, quiet: bool) -> None:
    """Print a hint; exit with 1 if runs are missing or none completed."""
    if summary.done < summary.count:
        print_error(
            f"the sweep was interrupted: {summary.done:,} of {count_of(summary.count, 'run')} in "
            f"'{target}'; the same command resumes from there"
        )
        raise typer.Exit(1)
    if not summary.statuses.get(RunStatus.COMPLETED):
        print_error(f"no run completed; the rows in '{target}' say why")
        raise typer.Exit(1)
    widest = next((spread for spread in summary.spreads if spread.largest_run is not None), None)
    if not quiet and widest is not None:
        hint = f"multiarm replay {target} --run {widest.largest_run}"
        line = Text.assemble(f"the run with the largest {widest.name}: ", (hint, "bold"))
        messages().print(line, soft_wrap=True)


SHOWN = {0.05: "5 %", 0.5: "median", 0.95: "95 %"}
"""Quantiles of the table, of those that a summary has."""


def facts_table(name: str, summary: SweepSummary, paths: tuple[str, ...]) -> Table:
    """How the runs of a scene, by its `name`, ended; `paths` are what is varied."""
    ended = Text(", ").join(
        Text(f"{count:,} {status}", STATUS_STYLES.get(status, ""))
        for status, count in summary.statuses.items()
    )
    rows: dict[str, RenderableType] = {
        "runs": f"{summary.done:,} of {summary.count:,}",
        "ended": ended if summary.done else "-",
        "over": ", ".join(paths),
        "time of all runs": number(summary.wall_time, "s"),
    }
    return facts(name, rows)


def spread_table(summary: SweepSummary) -> Table:
    """One line a quantity: its quantiles, and the run that has the largest."""
    heads = ("quantity", "smallest", *SHOWN.values(), "largest", "in run")
    rows = []
    for spread in summary.spreads:
        quantiles = (spread.quantiles[level] for level in SHOWN)
        numbers = [spread.smallest, *quantiles, spread.largest]
        name = f"{spread.name} [{spread.unit}]" if spread.unit else spread.name
        rows.append((name, *map(number, numbers), number(spread.largest_run)))
    table = columns("Quantities", heads, rows, range(1, len(heads)))
    table.padding, table.pad_edge = 0, False
    return table


def trouble_lines(summary: SweepSummary) -> list[str]:
    """Messages of runs that did not complete, with the first run of each."""
    lines = []
    for failure in summary.failures:
        more = "" if failure.runs == 1 else f" and {failure.runs - 1:,} more"
        lines.append(f"run {failure.first_run}{more} {failure.status}: {failure.message}")
    listed = sum(failure.runs for failure in summary.failures)
    unlisted = summary.done - summary.statuses.get(RunStatus.COMPLETED, 0) - listed
    return [*lines, f"and {count_of(unlisted, 'more run')} did not complete"] if unlisted else lines
