"""``multiarm accuracy``: what accuracy costs in time, on the user's own scene."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from multiarm.cli.accuracy_tables import decade_table, method_table, point_table
from multiarm.cli.files import check_plot, check_targets, scene_to_run, write_json
from multiarm.cli.options import ARMS, NO_CODE, Arms
from multiarm.errors import MultiarmError
from multiarm.terminal.console import (
    output,
    print_error,
    print_written,
)
from multiarm.terminal.progress import StudyProgress

if TYPE_CHECKING:
    from multiarm.scene import Scene
    from multiarm.studies.work_precision.store import Results

__all__ = ["accuracy"]

FILES = "Results"


class Quantity(str, Enum):
    """What an error is of."""

    motion = "motion"
    position = "position"
    rotation = "rotation"
    joints = "joints"
    force = "force"


def accuracy(
    scene: Annotated[
        Path | None,
        typer.Argument(help="The scene, a YAML file.", metavar="SCENE", show_default=False),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(help="Simulated time, in s.", show_default="the scene's", metavar="S"),
    ] = None,
    output_step: Annotated[
        float | None,
        typer.Option(
            help="Time between the outputs at which runs are compared, in s.",
            show_default="the scene's",
            metavar="S",
        ),
    ] = None,
    arms: Annotated[Arms | None, ARMS] = None,
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
    error: Annotated[
        Quantity,
        typer.Option(help="What is ranked; motion is the worst of position, rotation and joints."),
    ] = Quantity.motion,
    every: Annotated[bool, typer.Option("--all", help="Print every point.")] = False,
    results: Annotated[
        Path | None,
        typer.Option(
            help="File of the study; an interrupted one goes on from it.",
            show_default="SCENE's file name, --arms and .accuracy.json, in the current folder",
            metavar="FILE.json",
            rich_help_panel=FILES,
        ),
    ] = None,
    redo: Annotated[
        bool,
        typer.Option("--redo", help="Measure what is in that file anew.", rich_help_panel=FILES),
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
        typer.Option(
            help="Draw the diagram to a file; its ending (png, svg, pdf) is the format.",
            show_default="none",
            metavar="FILE",
            rich_help_panel=FILES,
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write one HTML page: the diagram with values, and all points.",
            show_default="none",
            metavar="FILE.html",
            rich_help_panel=FILES,
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(
            help="Write the figures as JSON.",
            show_default="none",
            metavar="FILE.json",
            rich_help_panel=FILES,
        ),
    ] = None,
    no_code: Annotated[bool, NO_CODE] = False,
) -> None:
    """Measure what accuracy costs on a scene: every method, beside other programs.

    Every integrator runs the scene over its steps or tolerances, with each stabilisation. Errors
    are those against a tight reference, which an independent solver and another method have
    checked; wall times are those of the fastest of several interleaved runs.

    The file of the study keeps every point as it comes in: after Ctrl-C the same command goes on
    where it was. It holds for one scene, on one machine, with one set of versions.

    The JSON has the keys scene, machine, reference, refusals, wall_time_s, points, cheapest,
    recommendation. Numbers are finite, or null where there is none.
    """
    check_plot(plot)
    if (scene is None) == (source is None):
        raise MultiarmError("name a scene to measure, or '--from FILE.json' to look at a study")
    if source is not None:
        from multiarm.studies.work_precision.store import read_results

        check_targets({"--plot": plot, "--html": html, "--json": json}, source=source)
        found = read_results(source)
    else:
        assert scene is not None, "one of the two is there"
        target = results if results is not None else _own_file(scene, arms)
        check_targets(
            {"--results": target, "--plot": plot, "--html": html, "--json": json}, source=scene
        )
        changes = {"duration": duration, "output_step": output_step, "arms": arms and arms.value}
        loaded = scene_to_run(scene, no_code)
        found = _measure(loaded, target, changes, peers, quick, redo)
        print_written("study", target)
    _print(found, error.value, every)
    _write(found, error.value, plot, html, json)


def _own_file(scene: Path, arms: Arms | None) -> Path:
    """Where a study goes that is given no file: one for each kind of arms that is asked for."""
    kind = "" if arms is None else f".{arms.value}"
    return Path(f"{scene.stem}{kind}.accuracy.json")


def _measure(
    scene: Scene, target: Path, changes: dict, peers: bool, quick: bool, redo: bool
) -> Results:
    """Study a scene behind a progress bar; what was measured stays in the file."""
    from multiarm.simulation.setup import run_spec

    scene = scene.replace(run=run_spec(scene.run, changes, {}, None))
    with StudyProgress() as watched:
        from multiarm.studies.hard_cases import machine
        from multiarm.studies.work_precision.store import Results
        from multiarm.studies.work_precision.study import run_study

        kept = _kept(target, Results.of(scene, machine(), target), redo)
        try:
            return run_study(scene, kept, peers=peers, quick=quick, progress=watched.tell)
        except KeyboardInterrupt:
            watched.stop()
            print_error(
                f"interrupted; {len(kept.points)} points are in '{target}', and the same command "
                "goes on from there"
            )
            raise typer.Exit(1) from None


def _kept(target: Path, empty: Results, redo: bool) -> Results:
    """What the file has of this scene and machine; nothing, with a word, where it is of another."""
    from multiarm.studies.work_precision.store import read_results

    if redo or not target.exists():
        return empty
    old = read_results(target)
    reason = old.stale(empty)
    if reason:
        raise MultiarmError(
            f"--results: '{target}' holds another study ({reason}); name another file, or give "
            "--redo to replace it"
        )
    return old


def _print(results: Results, quantity: str, every: bool) -> None:
    from multiarm.studies.work_precision.words import comparison, recommendation, reference_text

    console = output()
    console.print(Text(results.about["scene"]["name"], "bold"))
    console.print(Text(reference_text(results), "dim"))
    console.print(decade_table(results, quantity))
    console.print(method_table(results, quantity))
    if every:
        console.print(point_table(results))
    for solver, reason in results.refusals.items():
        console.print(Text(f"{solver}: {reason}", "dim"))
    for sentence in (comparison(results, quantity), recommendation(results, quantity)):
        if sentence:
            console.print(Text(sentence, "bold green"), soft_wrap=True)


def _write(
    results: Results, quantity: str, plot: Path | None, html: Path | None, json: Path | None
) -> None:
    from multiarm.studies.work_precision.words import figures

    if plot is not None:
        from multiarm.studies.work_precision.plots import write_plot

        write_plot(results, plot, quantity)
        print_written("plot", plot)
    if html is not None:
        from multiarm.studies.work_precision.page import write_page

        write_page(results, html)
        print_written("page", html)
    if json is not None:
        write_json(json, figures(results, quantity))
        print_written("figures", json)
