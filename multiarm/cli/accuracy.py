"""``multiarm accuracy``: the cost of accuracy on a scene."""

from __future__ import annotations

import math
import time
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from multiarm.cli.files import check_targets, scene_to_run
from multiarm.cli.options import (
    FILES,
    Arms,
    Duration,
    JsonFile,
    NoCode,
    OutputStep,
    chosen,
    file_option,
    option,
)
from multiarm.cli.studies import draw_files, lines_of, print_texts, write_files
from multiarm.errors import MultiarmError
from multiarm.terminal.console import print_error, print_written
from multiarm.terminal.progress import Progress, span

if TYPE_CHECKING:
    from multiarm.scene import Scene
    from multiarm.studies.work_precision.results import Results

__all__ = ["accuracy"]

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


def accuracy(
    scene: Annotated[
        Path | None,
        typer.Argument(help="The scene, a YAML file.", metavar="SCENE", show_default=False),
    ] = None,
    *,
    duration: Duration = None,
    output_step: OutputStep = None,
    arms: Arms = None,
    peers: Annotated[
        bool,
        typer.Option(
            "--peers/--no-peers",
            help="Run the scene in Pinocchio, and in MuJoCo if it is installed.",
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
        Quantity,
        option(
            "What is ranked: position, rotation, joints, force, or motion, the worst of the first "
            "three.",
            "NAME",
        ),
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
        from multiarm.studies.work_precision.results import read_results

        check_targets({"--plot": plot, "--html": html, "--json": json}, source=source)
        found = read_results(source)
    else:
        assert scene is not None, "one of the two is there"
        settings = chosen(duration=duration, output_step=output_step, arms=arms)
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
    from multiarm.studies.work_precision import page

    print_texts(page.texts(found, error.value, every))
    write_files(page, found, error.value, plot=plot, html=html, json=json)


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
    from multiarm.studies.work_precision.results import Results
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
        from multiarm.studies.work_precision import page

        if results.planned is None:  # finished, and about to be printed and written
            return
        self.progress.note(page.recommendation(results, self._quantity))
        if not self._printed:
            self._printed = True
            self.progress.print(
                "First results", *lines_of(page.first_texts(results, self._quantity))
            )
        checked = results.reference is not None and not results.reference.first
        if checked and not self._announced:
            self._announced = True
            left = (results.planned or 0) - len(results.points)
            self.progress.print(
                f"The reference is checked. About {span(results.expected_s)} more: {left} further "
                f"settings, and repetitions of the {len(results.points)} that are measured."
            )
        begin = time.monotonic()
        if begin >= self._due:
            draw_files(page, results, self._quantity, plot=self._plot, html=self._html)
            now = time.monotonic()
            self._due = now + max(REWRITE, (now - begin) / SHARE)


def _kept(target: Path, empty: Results, fresh: bool) -> Results:
    """The points in the file; an error if they belong to another scene or machine."""
    from multiarm.studies.work_precision.results import read_results

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
