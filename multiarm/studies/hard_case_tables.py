"""The tables of other solvers on the hard cases: over all cases, and the answers to one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from multiarm.reports.pages import scientific
from multiarm.studies.hard_cases import CaseResult
from multiarm.studies.peer_trials import OURS, Answer
from multiarm.studies.tables import REMARK, TEXT, Cell, Column, Table

RIGHT = DOUBTFUL = 1e-6
"""Relative error of accelerations up to which they are right; above it they are doubtful."""
WRONG = 1e-2


def solver_table(cases: Sequence[CaseResult]) -> Table:
    """One row a solver, over all cases that were given to it."""
    columns = (
        Column("solver", TEXT),
        Column("cases", TEXT, about="those that it can express"),
        Column(
            "accelerations", TEXT, about="number of cases right to 1e-6 at the hardest instant, "
            "compared with a dense solution",
        ),
        Column(
            "short runs", TEXT, about="around that instant; too slow: more than one second on this "
            "machine",
        ),
        Column("gap", TEXT, "{:.0e}".format, scientific, "the largest [m] in finished runs"),
        Column("broke in", TEXT),
    )  # fmt: skip
    return Table("Other solvers", columns, tuple(_solver_rows(cases)))


def _solver_rows(cases: Sequence[CaseResult]) -> Iterator[tuple[Any, ...]]:
    given = [case for case in cases if case.answers]
    for number, solver in enumerate(answer.solver for answer in given[0].answers):
        found = [(case.name, case.answers[number]) for case in given]
        tried = [(name, answer) for name, answer in found if not answer.refusal]
        if not tried:
            yield solver, "0", None, None, None, found[0][1].refusal
            continue
        right = sum(_is_right(answer) for _, answer in tried)
        finished = [answer for _, answer in tried if not answer.ended]
        gaps = [answer.drift for answer in finished if answer.drift is not None]
        late = sum(answer.out_of_time for _, answer in tried)
        slow = f", {late} too slow" if late else ""
        broken = ", ".join(name for name, answer in tried if answer.broken) or None
        yield (
            solver, len(tried), f"{right} right", f"{len(finished)} finished{slow}",
            max(gaps, default=None), broken,
        )  # fmt: skip


def _is_right(answer: Answer) -> bool:
    errors = (answer.object_error, answer.joint_error)
    return all(error is not None and error <= RIGHT for error in errors)


def answer_table(case: CaseResult) -> Table:
    """The answers of all solvers to one case."""
    columns = (
        Column("", TEXT),
        Column(f"object's acceleration\noff, at {case.hardest_s:.4g} s", write=scientific),
        Column("joints' accelerations\noff", write=scientific),
        Column(f"loops apart [m]\nin {case.window_s:.3g} s around it", write=scientific),
        Column("energy error [J]", write=scientific),
        Column("", REMARK),
    )
    return Table("The same by others", columns, tuple(_answer_row(a) for a in case.answers))


def _answer_row(answer: Answer) -> tuple[Any, ...]:
    name = Cell(answer.solver, "strong" if answer.solver == OURS else "")
    if answer.refusal:
        return name, answer.refusal
    errors = (answer.object_error, answer.joint_error)
    remark = "; ".join(filter(None, (answer.accelerations, answer.ended)))
    return (
        name,
        *(Cell("none", "bad") if answer.accelerations else _error_cell(x) for x in errors),
        answer.drift,
        answer.energy_error,
        Cell(remark, "bad" if answer.broken else ""),
    )


def _error_cell(error: float | None) -> Cell:
    if error is None or error <= DOUBTFUL:
        return Cell(error)
    return Cell(error, "bad" if error > WRONG else "warn")
