"""``multiarm scaling``: cost over the number of arms, and shares of the time."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from multiarm.cli.files import check_targets
from multiarm.cli.options import JsonFile, file_option, option
from multiarm.cli.studies import print_texts, write_files
from multiarm.errors import MultiarmError
from multiarm.terminal.console import print_warnings
from multiarm.terminal.progress import Progress

__all__ = ["scaling"]


class Study(str, Enum):
    """What is measured."""

    evaluations = "evaluations"
    thesis = "thesis"
    shares = "shares"
    rows = "rows"
    all = "all"


class Kind(str, Enum):
    """Joints between the arms and the object; all: weld and ball."""

    weld = "weld"
    ball = "ball"
    revolute = "revolute"
    all = "all"


def scaling(
    study: Annotated[
        Study,
        option(
            "Cost of an evaluation compared with Pinocchio's algorithms; node algorithm "
            "against direct elimination (section 4.4 of the thesis); shares of the time; cost of "
            "a contact row."
        ),
    ] = Study.all,
    arms: Annotated[
        str | None,
        typer.Option(
            help="Numbers of arms of the evaluations, separated by commas.",
            show_default="2,4,8,16,32,64; to 16 with --quick",
            metavar="N,N,...",
        ),
    ] = None,
    kind: Annotated[
        Kind, option("Joint between each arm and the object; all: weld and ball.")
    ] = Kind.all,
    rounds: Annotated[
        int | None,
        option(
            "Repetitions of every measurement; more smooth out noise.",
            default="7; 2 with --quick",
            min=1,
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer arms and repetitions: a first look.")
    ] = False,
    plot: Annotated[
        Path | None,
        file_option("Draw the result to a file; its ending (png, svg, pdf) is the format."),
    ] = None,
    html: Annotated[
        Path | None, file_option("Write one HTML page with figures and tables.", "FILE.html")
    ] = None,
    json: JsonFile = None,
) -> None:
    """Measure how cost grows with the number of arms, and where the time goes.

    Takes about two minutes, a few seconds with --quick. The JSON holds what
    multiarm.studies.scaling.run_scaling returns.
    """
    counts = None if arms is None else _counts(arms)
    check_targets({"--plot": plot, "--html": html, "--json": json})
    from multiarm.studies import scaling as benchmark

    studies = benchmark.STUDIES if study is Study.all else (study.value,)
    kinds = benchmark.KINDS if kind is Kind.all else (kind.value,)
    plan = benchmark.quick(studies, kinds) if quick else benchmark.Plan(studies, kinds)
    plan = replace(plan, arms=counts or plan.arms, rounds=rounds or plan.rounds)
    with Progress() as progress:
        result = benchmark.run_scaling(plan, progress=progress)
    from multiarm.studies import scaling_page as page

    print_texts(page.texts(result))
    print_warnings(filter(None, [page.disturbance(result)]))
    write_files(page, result, plot=plot, html=html, json=json)


MOST_ARMS = 10_000


def _counts(text: str) -> tuple[int, ...]:
    """Increasing numbers of arms."""
    try:
        counts = tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        counts = ()
    if not counts or counts[0] < 1:
        raise MultiarmError(
            f"--arms: '{text}' is not a list of whole numbers from 1 up; write for example 2,4,8"
        )
    if counts[-1] > MOST_ARMS:
        raise MultiarmError(f"--arms: {counts[-1]:.3g} arms; at most {MOST_ARMS:,} are possible")
    if counts[0] == 1:
        raise MultiarmError(f"--arms: '{text}': the ring of the benchmark has at least 2 arms")
    return counts
