"""``multiarm accuracy``: the cost of accuracy on a scene."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from enum import Enum
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import check_targets, scene_to_run
from multiarm.cli.options import (
    Arms,
    Duration,
    JsonFile,
    NoCode,
    OutputStep,
    SceneFile,
    chosen,
    file_option,
    option,
    plot_option,
    switch,
)
from multiarm.cli.studies import draw_files, rendered, write_files
from multiarm.terminal.console import output, print_error
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.studies.work_precision import Study

REWRITE, SHARE = 5.0, 0.1
"""Files of an unfinished study are written at most so often [s], and take such a share of the time
at most."""
VERDICT = "bold green"


class Quantity(str, Enum):
    """What an error is of."""

    motion = "motion"
    position = "position"
    rotation = "rotation"
    joints = "joints"
    force = "force"


def accuracy(
    scene: SceneFile,
    *,
    duration: Duration = None,
    output_step: OutputStep = None,
    arms: Arms = None,
    peers: Annotated[
        bool,
        switch(
            "--peers/--no-peers", "Run the scene in Pinocchio, and in MuJoCo if it is installed."
        ),
    ] = True,
    quick: Annotated[
        bool, switch("--quick", "Every second setting only, and fewer repeats.")
    ] = False,
    error: Annotated[
        Quantity,
        option(
            "What is ranked: position, rotation, joints, force, or motion, the worst of the first "
            "three.",
            "NAME",
        ),
    ] = Quantity.motion,
    every: Annotated[bool, switch("--all", "Print every point.")] = False,
    plot: Annotated[Path | None, plot_option("Draw the diagram")] = None,
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
    Ctrl-C ends the study: what is measured so far is printed and written.

    The JSON has the keys scene, machine, reference, refusals, wall_time_s, left_out, points,
    cheapest, recommendation. Numbers are finite, or null where there is none. left_out says whether
    settings were left out, by --quick or Ctrl-C.
    """
    check_targets({"--plot": plot, "--html": html, "--json": json}, source=scene)
    from multiarm.simulation.setup import run_spec

    settings = chosen(duration=duration, output_step=output_step, arms=arms)
    loaded = scene_to_run(scene, no_code)
    loaded = loaded.replace(run=run_spec(loaded.run, settings))
    from multiarm.studies import work_precision_page as page
    from multiarm.studies.work_precision import run_study

    study: Study | None = None
    due = -math.inf
    with Progress() as progress:
        try:
            for study in run_study(loaded, peers=peers, quick=quick, progress=progress):
                begin = time.monotonic()
                if study.finished or begin < due:
                    continue
                if due == -math.inf:
                    first = _shown(study, error.value), _verdicts(study, error.value)
                    progress.print("First results", *chain(*first))
                progress.note(page.recommendation(study, error.value))
                draw_files(page, study, error.value, plot=plot, html=html)
                now = time.monotonic()
                due = now + max(REWRITE, (now - begin) / SHARE)
        except KeyboardInterrupt:
            if study is None:
                raise
    assert study is not None, "a study yields, or raises"
    console = output()
    console.print(Text(study.scene["name"], "bold"))
    for item in _shown(study, error.value, every):
        console.print(item)
    for verdict in _verdicts(study, error.value):
        console.print(verdict, soft_wrap=True)
    write_files(page, study, error.value, plot=plot, html=html, json=json)
    if not study.finished:
        print_error(f"interrupted; {page.state_text(study)}")
        raise typer.Exit(1)


def _shown(study: Study, quantity: str, every: bool | None = None) -> Iterator[RenderableType]:
    """Reference and tables, of which the decades only without ``every``; and what is missing."""
    from multiarm.studies import work_precision_page as page

    yield Text(page.reference_text(study), "dim")
    yield from rendered(page.decade_table(study, quantity))
    if every is not None:
        yield from rendered(page.method_table(study, quantity))
    if every:
        yield from rendered(page.point_table(study))
    for solver, reason in study.refusals.items():
        yield Text(f"{solver}: {reason}", "dim")
    if not study.finished:
        yield Text(page.state_text(study), "dim")


def _verdicts(study: Study, quantity: str) -> Iterator[Text]:
    """What follows from the tables, a sentence each."""
    from multiarm.studies import work_precision_page as page

    return (Text(sentence, VERDICT) for sentence in page.sentences(study, quantity) if sentence)
