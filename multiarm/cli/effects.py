"""``multiarm effects``: the cost of each effect of a scene, and the changes that it makes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from multiarm.cli.catalogue import show
from multiarm.cli.files import check_targets, refuse_targets, scene_to_run
from multiarm.cli.joints import effect_section
from multiarm.cli.options import (
    Arms,
    Duration,
    JsonFile,
    NoCode,
    chosen,
    file_option,
    option,
    plot_option,
    switch,
)
from multiarm.cli.studies import rendered, write_files
from multiarm.errors import MultiarmError
from multiarm.terminal.console import output
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.scene import Scene
    from multiarm.studies.effect_costs import Ledger


def effects(
    scene: Annotated[
        Path | None,
        typer.Argument(
            help="The scene, a YAML file; with --list, the name of an effect.",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    *,
    duration: Duration = None,
    arms: Arms = None,
    listing: Annotated[
        bool,
        switch("--list", "List the effects with their parameters, or show one in full."),
    ] = False,
    candidates: Annotated[
        bool,
        switch(
            "--candidates",
            "Add each effect that the scene does not have too, with its usual parameters.",
        ),
    ] = False,
    rounds: Annotated[
        int, option("Timed runs of each, at most; more smooth out noise.", min=1)
    ] = 9,
    plot: Annotated[Path | None, plot_option("Draw the ledger")] = None,
    html: Annotated[
        Path | None,
        file_option("Write one HTML page: the ledger, drawn and in numbers.", "FILE.html"),
    ] = None,
    json: JsonFile = None,
    no_code: NoCode = False,
) -> None:
    """Measure what each effect of a scene costs, and what it changes.

    The scene is run once more without each of its effects, gravity included, to the requested
    accuracy. The table shows the time and the largest changes of the object's path and
    orientation, of the joints and of the contact forces; an effect whose changes all stay below
    the accuracy can be left out. Further lines show the costs of stabilization, recording and
    certificate.

    Runs are timed in turns. Times within their uncertainty are called noise, and so are changes
    below the accuracy to which all runs are made.

    The JSON has the keys scene, asked, asked_by_scene, run, entries, machine, wall_time_s, summary;
    their meaning and units are those of multiarm.studies.effect_costs. Numbers are
    finite, or null where there is none. With --list it has the key effects: what is shown.
    """
    if listing:
        pages = {"--plot": plot, "--html": html}
        refuse_targets(pages, "--list measures no scene; leave one of the two out")
        show("effects --list", {"effects": effect_section()}, str(scene) if scene else None, json)
        return
    if scene is None:
        raise MultiarmError("name a scene to measure, or '--list' to see what effects there are")
    check_targets({"--plot": plot, "--html": html, "--json": json}, source=scene)
    settings = chosen(duration=duration, arms=arms)
    study = _measure(scene_to_run(scene, no_code), settings, candidates, rounds)
    from multiarm.studies import effect_costs_page as page

    console = output()
    console.print(Text(study.scene["name"], "bold"))
    console.print(Text(page.accuracy_text(study), "dim"))
    for item in rendered(page.table(study)):
        console.print(item)
    if not study.run["certified"]:
        console.print(Text(f"The scene's own run: {study.run['certificate']}", "yellow"))
    console.print(Text(page.summary(study), "bold green"), soft_wrap=True)
    write_files(page, study, plot=plot, html=html, json=json)


def _measure(scene: Scene, changes: dict, candidates: bool, rounds: int) -> Ledger:
    from multiarm.simulation.setup import run_spec

    scene = scene.replace(run=run_spec(scene.run, changes))
    with Progress() as progress:
        from multiarm.studies.effect_costs import ledger

        return ledger(scene, candidates=candidates, repeats=rounds, progress=progress)
