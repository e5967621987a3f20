"""``multiarm stability``: the hard cases, each judged by its own criteria."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, write_json
from multiarm.cli.options import JsonFile, file_option
from multiarm.results.files import save_page
from multiarm.terminal.console import columns, number, output, print_error, print_written
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.problems import HardCase
    from multiarm.studies.hard_cases import CaseResult, CriterionResult, SuiteResult
    from multiarm.studies.peer_trials import Answer

__all__ = ["stability"]

RIGHT = 1e-6  # relative error of accelerations


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
    peers: Annotated[
        bool,
        typer.Option(
            "--peers/--no-peers",
            help="Solve the same systems by Pinocchio's own algorithms, and by MuJoCo if it is "
            "installed.",
        ),
    ] = True,
    html: Annotated[
        Path | None,
        file_option(
            "Write one HTML page with time series of every case and the peers' answers.",
            "FILE.html",
        ),
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
        output().print(_table("Hard cases", ("name", "case", "what is hard"), rows, chosen))
        return
    with Progress() as progress:
        suite = run_suite(names or (), peers=peers, progress=progress)
    console = output()
    for part in _parts(suite, peers):
        console.print(part)
    if json is not None:
        write_json(json, suite.as_dict())
        print_written("figures", json)
    if html is not None:
        from multiarm.studies.hard_case_page import render

        save_page(render(suite), html)
        print_written("page", html)
    for case in suite.cases:
        if not case.passed:
            print_error(f"{case.name}: {'; '.join(case.failures)}")
    if suite.passed < len(suite.cases):
        raise typer.Exit(1)


def _parts(suite: SuiteResult, peers: bool) -> list[RenderableType]:
    heads = ("case", "criteria: measured / bound", "run", "verdict")
    rows = [_row(case) for case in suite.cases]
    parts: list[RenderableType] = [_table("Hard cases", heads, rows, suite.cases)]
    if peers and any(case.answers for case in suite.cases):
        titles = ("solver", "cases", "accelerations", "short runs", "gap", "broke in")
        parts.append(columns("Other solvers", titles, _peer_rows(suite.cases)))
        parts.append(Text(_PEERS_NOTE, "dim"))
    passed, total = suite.passed, len(suite.cases)
    style = "bold green" if passed == total else "bold red"
    took = f" in {number(suite.wall_time_s, 's')}"
    parts.append(Text.assemble((f"{passed} of {total} within their criteria", style), took))
    return parts


_PEERS_NOTE = (
    "cases: those that it can express. accelerations: number of cases right to 1e-6 at the hardest "
    "instant, compared with a dense solution. short runs: around that instant; too slow: more than "
    "one second on this machine. gap: the largest [m] in finished runs. All answers are in the "
    "page and in the JSON."
)


def _table(
    title: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[RenderableType]],
    cases: Sequence[CaseResult | HardCase],
) -> Table:
    """A table whose first column never wraps the cases' names, so that they can be typed."""
    table = columns(title, heads, rows)
    table.columns[0].min_width = max((len(case.name) for case in cases), default=0)
    return table


def _row(case: CaseResult) -> tuple[RenderableType, ...]:
    from multiarm.studies.hard_cases import path_text, rank_text

    lines = [_criterion(item) for item in case.criteria]
    if case.status != "completed":
        lines.insert(0, Text(f"{case.status}: {case.message}", "red"))
    verdict = Text("pass", "bold green") if case.passed else Text("FAIL", "bold red")
    title = Group(Text(case.name, "bold"), Text(case.title, "dim"))
    steps, wall = case.statistics.get("steps"), number(case.wall_time_s, "s")
    course = [f"rank {rank_text(case)}", path_text(case), f"{number(steps)} steps, {wall}"]
    run = Text("" if steps is None else "\n".join(course), "dim")
    return title, Group(*lines, ""), run, verdict


def _criterion(item: CriterionResult) -> Text:
    unit = "" if item.unit == "1" else f" {item.unit}"
    found = item.message or f"{item.measured:.2g}"
    style = "" if item.passed else "red"
    return Text.assemble(
        (f"{item.quantity} ", "cyan"), (f"{found} / {item.bound:.2g}{unit}", style)
    )


def _peer_rows(cases: Sequence[CaseResult]) -> Iterator[tuple[str, ...]]:
    """One row a solver, over all cases that were given to it."""
    solvers = next(case.answers for case in cases if case.answers)
    for number_, solver in enumerate(answer.solver for answer in solvers):
        found = [(case.name, case.answers[number_]) for case in cases if case.answers]
        tried = [(name, answer) for name, answer in found if not answer.refusal]
        if not tried:
            yield solver, "0", "-", "-", "-", found[0][1].refusal
            continue
        right = sum(_is_right(answer) for _, answer in tried)
        finished = [answer for _, answer in tried if not answer.ended]
        gaps = [answer.drift for answer in finished if answer.drift is not None]
        late = sum(answer.out_of_time for _, answer in tried)
        slow = f", {late} too slow" if late else ""
        broken = [
            name
            for name, answer in tried
            if answer.accelerations or (answer.ended and not answer.out_of_time)
        ]
        yield (
            solver, str(len(tried)), f"{right} right", f"{len(finished)} finished{slow}",
            f"{max(gaps):.0e}" if gaps else "-", ", ".join(broken) or "-",
        )  # fmt: skip


def _is_right(answer: Answer) -> bool:
    errors = (answer.object_error, answer.joint_error)
    return all(error is not None and error <= RIGHT for error in errors)
