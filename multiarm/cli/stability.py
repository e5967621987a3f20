"""``multiarm stability``: the hard cases, each judged by its own criteria."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from multiarm.cli.files import check_targets, refuse_targets
from multiarm.cli.options import JsonFile, file_option, switch
from multiarm.cli.studies import rendered, write_files
from multiarm.notation import number
from multiarm.terminal.console import columns, output, print_error
from multiarm.terminal.progress import Progress


def stability(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names of cases; --list shows them.", show_default="all cases", metavar="[NAMES]"
        ),
    ] = None,
    listing: Annotated[
        bool, switch("--list", "Only list the cases and what is hard about them.")
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
    targets = {"--html": html, "--json": json}
    if listing:
        refuse_targets(targets, "--list runs no case; leave one of the two out")
    check_targets(targets)
    from multiarm.studies.hard_cases import choose_cases, run_suite

    chosen = choose_cases(names or ())
    if listing:
        rows = [(Text(case.name, "bold"), case.title, case.difficulty) for case in chosen]
        output().print(columns("Hard cases", ("name", "case", "what is hard"), rows))
        return
    with Progress() as progress:
        suite = run_suite(names or (), progress=progress)
    from multiarm.studies import hard_cases_page as page

    tables = [page.criterion_table(case) for case in suite.cases if case.criteria]
    console = output()
    for table in (*tables, page.case_table(suite)):
        for item in rendered(table):
            console.print(item)
    passed, total = suite.passed, len(suite.cases)
    style = "bold green" if passed == total else "bold red"
    took = f" in {number(suite.wall_time_s, 's')}"
    console.print(Text.assemble((f"{passed} of {total} within their criteria", style), took))
    write_files(page, suite, html=html, json=json)
    for case in suite.cases:
        if not case.passed:
            print_error(f"{case.name}: {'; '.join(case.failures)}")
    if passed < total:
        raise typer.Exit(1)
