"""``multiarm effects``: the cost of each effect of a scene, and the changes that it makes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from multiarm.cli.catalogue import show
from multiarm.cli.files import check_targets, scene_to_run, write_json
from multiarm.cli.joints import effect_section
from multiarm.cli.options import JsonFile, NoCode, file_option, option, with_settings
from multiarm.errors import MultiarmError
from multiarm.results.files import save_figure, save_page
from multiarm.terminal.console import columns, output, print_written
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.scene import Scene
    from multiarm.studies.effect_costs.entries import Entry, Ledger

__all__ = ["effects"]


@with_settings("duration", "arms")
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
    settings: dict[str, Any],
    listing: Annotated[
        bool,
        typer.Option("--list", help="List the effects with their parameters, or show one in full."),
    ] = False,
    candidates: Annotated[
        bool,
        typer.Option(
            "--candidates",
            help="Add each effect that the scene does not have too, with its usual parameters.",
        ),
    ] = False,
    rounds: Annotated[
        int, option("Timed runs of each, at most; more smooth out noise.", min=1)
    ] = 9,
    plot: Annotated[
        Path | None,
        file_option("Draw the ledger to a file; its ending (png, svg, pdf) is the format."),
    ] = None,
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
    their meaning and units are those of multiarm.studies.effect_costs.entries. Numbers are
    finite, or null where there is none. With --list it has the key effects: what is shown.
    """
    if listing:
        show("effects --list", {"effects": effect_section()}, str(scene) if scene else None, json)
        return
    if scene is None:
        raise MultiarmError("name a scene to measure, or '--list' to see what effects there are")
    check_targets({"--plot": plot, "--html": html, "--json": json}, source=scene)
    found = _measure(scene_to_run(scene, no_code), settings, candidates, rounds)
    _print(found)
    _write(found, plot, html, json)


def _measure(scene: Scene, changes: dict, candidates: bool, rounds: int) -> Ledger:
    from multiarm.simulation.setup import run_spec

    scene = scene.replace(run=run_spec(scene.run, changes, {}, None))
    with Progress() as progress:
        from multiarm.studies.effect_costs.study import ledger

        return ledger(scene, candidates=candidates, repeats=rounds, progress=progress)


def _print(found: Ledger) -> None:
    from multiarm.studies.effect_costs.words import accuracy_text, summary

    console = output()
    console.print(Text(found.scene["name"], "bold"))
    console.print(Text(accuracy_text(found), "dim"))
    console.print(_table(found))
    for entry in found.entries:
        text, style = _remark(entry)
        if text:
            console.print(Text(f"{entry.name}: {text}", style), soft_wrap=True)
    if found.run["certificate"].startswith("not met"):
        console.print(Text(f"The scene's own run: {found.run['certificate']}", "yellow"))
    console.print(Text(summary(found), "bold green"), soft_wrap=True)


def _table(found: Ledger) -> Table:
    """One line an entry: what it costs, and what it changes."""
    heads = ("", "ms/s", "% time", "evals", "path mm", "turn deg", "joints deg", "force N",
             "at s")  # fmt: skip
    rows = [_row(found, entry) for entry in found.entries]
    table = columns("What each costs, and what it changes", heads, rows)
    table.padding, table.pad_edge = 0, False
    for k in range(1, len(heads)):
        table.columns[k].justify = "right"
        table.columns[k].min_width = max(len(str(row[k])) for row in rows)
    return table


def _row(found: Ledger, entry: Entry) -> list[Text]:
    from multiarm.studies.effect_costs.entries import FORCE, JOINTS, PATH, SLIDES, TURN
    from multiarm.studies.effect_costs.variants import CANDIDATE
    from multiarm.studies.effect_costs.words import change_text, milliseconds, percent

    name = f"+ {entry.name}" if entry.kind == CANDIDATE else entry.name
    costs = [Text("-")] * 3
    if entry.milliseconds is not None and entry.share is not None:
        shown = (milliseconds(entry), percent(entry.share), f"{entry.evaluations:,}")
        costs = [*map(Text, shown)]
    slides = entry.value(JOINTS) is None and entry.value(SLIDES) is not None
    changed = [
        Text(change_text(found, entry, quantity, slides and quantity == SLIDES),
             "" if _above(found, entry, quantity) else "dim")
        for quantity in (PATH, TURN, SLIDES if slides else JOINTS, FORCE)
    ]  # fmt: skip
    most = found.moves(entry)
    at = Text("-" if most is None else f"{entry.changes[most].time:.3g}")
    return [Text(name, "green" if found.can_go(entry) else ""), *costs, *changed, at]


def _above(found: Ledger, entry: Entry, quantity: str) -> bool:
    value = entry.value(quantity)
    return value is not None and value > found.asked[quantity]


def _remark(entry: Entry) -> tuple[str, str]:
    """A remark on an entry's numbers, and its style."""
    from multiarm.studies.effect_costs.variants import PRESENT
    from multiarm.studies.effect_costs.words import trouble

    if entry.trouble:
        return trouble(entry), "yellow"
    doubt = "" if entry.certified else "its run does not meet the requested accuracy"
    about = "" if entry.kind == PRESENT else entry.about
    return ", ".join(filter(None, (about, doubt))), "dim"


def _write(found: Ledger, plot: Path | None, html: Path | None, json: Path | None) -> None:
    from multiarm.studies.effect_costs.words import figures

    if plot is not None:
        from multiarm.studies.effect_costs.page import ledger_figure

        save_figure(ledger_figure(found), plot)
        print_written("plot", plot)
    if html is not None:
        from multiarm.studies.effect_costs.page import render

        save_page(render(found), html)
        print_written("page", html)
    if json is not None:
        write_json(json, figures(found))
        print_written("figures", json)
