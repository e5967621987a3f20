"""``multiarm stability``: the hard cases, each judged by its own criteria."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from multiarm.cli.files import check_targets
from multiarm.cli.options import JsonFile, file_option
from multiarm.cli.studies import write_files
from multiarm.notation import count_of, number
from multiarm.terminal.console import columns, output, print_error
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.studies.hard_cases import CaseResult, CriterionResult, SuiteResult

__all__ = ["stability"]


def stability(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names of cases; --list shows them.", show_default="all cases", metavar="[NAMES]"
        ),
    ] = None,
    listing: Annotated[
        bool, typer.Option("--list", help="Only list the cases and what is hard about them.")
    ] = False,
    html: Annotated[
        Path | None,
        file_option("Write one HTML page with time series of every case.", "FILE.html"),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Run the hard cases, on which solvers break, and judge each by its own criteria.

    The exit code is 0 when every case is completed within its criteria, 1 when one is not, 2 for a
    name that is no case. A case that cannot be run fails; the others are run all the same.

    The JSON has the keys passed, total, wall_time_s, machine, cases; a case's keys are those of
    multiarm.studies.hard_cases.CaseResult. Numbers are finite, or null where there is none.
    """
    check_targets({"--html": html, "--json": json})
    from multiarm.studies.hard_cases import choose_cases, run_suite

    chosen = choose_cases(names or ())
    if listing:
        rows = [(Text(case.name, "bold"), case.title, case.difficulty) for case in chosen]
        output().print(columns("Hard cases", ("name", "case", "what is hard"), rows))
        return
    with Progress() as progress:
        suite = run_suite(names or (), progress=progress)
    console = output()
    for part in _parts(suite):
        console.print(part)
    from multiarm.studies import hard_case_page as page

    write_files(page, suite, html=html, json=json)
    for case in suite.cases:
        if not case.passed:
            print_error(f"{case.name}: {'; '.join(case.failures)}")
    if suite.passed < len(suite.cases):
        raise typer.Exit(1)


def _parts(suite: SuiteResult) -> list[RenderableType]:
    heads = ("case", "criteria: measured / bound", "run", "verdict")
    rows = [_row(case) for case in suite.cases]
    parts: list[RenderableType] = [columns("Hard cases", heads, rows)]
    passed, total = suite.passed, len(suite.cases)
    style = "bold green" if passed == total else "bold red"
    took = f" in {number(suite.wall_time_s, 's')}"
    parts.append(Text.assemble((f"{passed} of {total} within their criteria", style), took))
    return parts


def _row(case: CaseResult) -> tuple[RenderableType, ...]:
    from multiarm.studies.hard_case_page import path_text, rank_text

    lines = [_criterion(item) for item in case.criteria]
    if case.status != "completed":
        lines.insert(0, Text(f"{case.status}: {case.message}", "red"))
    verdict = Text("pass", "bold green") if case.passed else Text("FAIL", "bold red")
    title = Text.assemble((f"{case.name}\n", "bold"), (case.title, "dim"))
    steps, wall = case.statistics.get("steps"), number(case.wall_time_s, "s")
    course = [f"rank {rank_text(case)}", path_text(case), f"{count_of(steps or 0, 'step')}, {wall}"]
    run = Text("" if steps is None else "\n".join(course), "dim")
    return title, Group(*lines, ""), run, verdict


def _criterion(item: CriterionResult) -> Text:
    unit = "" if item.unit == "1" else f" {item.unit}"
    found = item.message or f"{item.measured:.2g}"
    style = "" if item.passed else "red"
    return Text.assemble(
        (f"{item.quantity} ", "cyan"), (f"{found} / {item.bound:.2g}{unit}", style)
    )
