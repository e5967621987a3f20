"""The hard cases as tables, figures and one self-contained HTML page.

The page shows how many cases are within their criteria and on which machine; an overview of the
cases; then a card a case with its criteria, four panels over time (loops, energy, residual, rank)
and its events.
"""

from __future__ import annotations

from functools import partial
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from multiarm.notation import NOTHING, count_of, number
from multiarm.plots.panels import DECADES, Panel, draw
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK, inline_svg
from multiarm.reports import pages
from multiarm.studies.hard_cases import HISTORY, CaseResult, SuiteResult
from multiarm.studies.tables import (
    NUMBER,
    REMARK,
    TEXT,
    Column,
    TextTable,
    attribute,
    text_table,
    written,
)

SMALLEST = 1e-18
"""The least that is drawn on a logarithmic axis."""
SHOWN_EVENTS = 12
_margin = partial(number, digits=2)


def figures(suite: SuiteResult) -> dict[str, Any]:
    """All figures, under the keys that ``multiarm stability --help`` lists."""
    return suite.as_dict()


# --- tables ---------------------------------------------------------------------------------------


def case_table(suite: SuiteResult) -> TextTable:
    """One line a case: the criterion nearest to its bound, and how the run went."""

    def steps(case: CaseResult) -> str:
        return written(case.statistics.get("steps"), "{:,}".format)

    def remark(case: CaseResult) -> str:
        return "" if case.criteria else shorten(case.message, 90, placeholder=" …")

    columns = [
        Column("case", TEXT, attribute("name")),
        Column("verdict", TEXT, lambda case: "pass" if case.passed else "FAIL"),
        Column("least bound / measured", TEXT, nearest),
        Column("rank", TEXT, rank_text),
        Column("path", TEXT, path_text),
        Column("steps", NUMBER, steps),
        Column("wall time", NUMBER, lambda case: number(case.wall_time_s or None, "s")),
        Column("", REMARK, remark),
    ]
    return text_table("Hard cases", suite.cases, columns)


def criterion_table(case: CaseResult) -> TextTable:
    """One line a criterion."""

    def bound(row: Any) -> str:
        return f"{row.bound:.2g} {'' if row.unit == '1' else row.unit}".rstrip()

    columns = [
        Column("criterion", TEXT, attribute("quantity")),
        Column("measured", NUMBER, attribute("measured", "{:.2g}".format)),
        Column("bound", NUMBER, bound),
        Column("bound / measured", NUMBER, attribute("margin", _margin)),
        Column("verdict", TEXT, lambda row: "within" if row.passed else "BEYOND"),
        Column("", REMARK, attribute("message")),
    ]
    return text_table(case.name, case.table.itertuples(), columns)


def nearest(case: CaseResult) -> str:
    """The criterion with the least margin, failed ones first."""
    if not case.criteria:
        return NOTHING
    row = case.table.sort_values(["passed", "margin"]).iloc[0]
    return f"{row['quantity']}: {written(row['margin'], _margin)}"


def rank_text(case: CaseResult) -> str:
    """The rank, or its range, and how many events there were."""
    low, high = (case.statistics.get(key) for key in ("lowest_rank", "highest_rank"))
    text = NOTHING if low is None else f"{low}" if low == high else f"{low} to {high}"
    count = len(case.events)
    return text if not count else f"{text}, {count_of(count, 'event')}"


def path_text(case: CaseResult) -> str:
    """Which path of the solver the steps took."""
    steps, coupled = (case.statistics.get(key) for key in ("steps", "coupled_steps"))
    if steps is None or coupled is None:
        return NOTHING
    if not coupled:
        return "linear"
    return "coupled" if coupled >= steps else f"coupled in {coupled:,} of {count_of(steps, 'step')}"


# --- figure and page ------------------------------------------------------------------------------


def figure(case: CaseResult) -> Figure | None:
    """Panels over time with the events; None when nothing was recorded."""
    if not case.history:
        return None
    bounds = {item.channel: item.bound for item in case.criteria if item.bound > 0}
    panel = partial(_panel, case)
    loops, energy = {"gap": BLUE, "gap_rate": GREEN}, {"energy_balance": PINK}
    residual, rank = {"residual": BLUE}, {"rank": ORANGE, "coupled_arms": BLUE}
    panels = [
        panel("Loops", "gap [m], rate [m/s]", loops, True, bounds.get(HISTORY["gap"])),
        panel("Energy", "balance [J]", energy, True),
        panel("Constraints", "relative residual", residual, True, bounds.get(HISTORY["residual"])),
        panel("Rank, and arms in the coupled system", "number", rank),
    ]
    return draw(panels, events=case.events)


def _panel(
    case: CaseResult,
    title: str,
    quantity: str,
    lines: dict[str, str],
    log: bool = False,
    level: float | None = None,
) -> Panel:
    """One panel; ``lines`` are keys of the history with their colours."""
    if not lines.keys() <= case.history.keys():
        return Panel(f"{title}: not recorded", quantity, np.empty(0), np.empty((0, 0)), (), ())
    values = np.array([case.history[key] for key in lines], dtype=float).T
    if log:
        values = np.abs(values)
        peak = max(np.nanmax(values, initial=0.0), SMALLEST)
        values = np.fmax(values, max(SMALLEST, peak * 10.0**-DECADES))
    elif np.array_equal(values, np.round(values)):
        values = values.astype(int)
    labels = tuple(key.replace("_", " ") for key in lines) if len(lines) > 1 else ("",)
    time = np.array(case.history["time"], dtype=float)
    colours = tuple(lines.values())
    return Panel(title, quantity, time, values, labels, colours, log=log, levels=(level,))


def render(suite: SuiteResult) -> str:
    """The page as text."""
    return pages.render(
        "stability.html",
        suite=suite,
        overview=case_table(suite),
        cases=[_card(case, f"c{number}-") for number, case in enumerate(suite.cases)],
        simulated_s=sum(case.wall_time_s for case in suite.cases),
        shown_events=SHOWN_EVENTS,
    )


def _card(case: CaseResult, prefix: str) -> dict[str, Any]:
    """A case with what its card says besides; ids in its figure begin with ``prefix``."""
    drawing = figure(case)
    return {
        "result": case,
        "criteria": criterion_table(case),
        "run": _run(case),
        "figure": "" if drawing is None else inline_svg(drawing, prefix),
    }


def _run(case: CaseResult) -> list[str]:
    """How it was run; empty if it was not."""
    statistics = case.statistics
    if not statistics:
        return []
    wall = number(case.wall_time_s, "s")
    return [
        f"{number(statistics['simulated_s'], 's')} simulated in {wall}",
        f"{statistics['integrator']}, {count_of(statistics['steps'], 'step')} "
        f"({statistics['rejected_steps']:,} rejected)",
        f"solver {statistics['solver']}, {statistics['stabilization']}",
        f"rank {rank_text(case)}",
        f"path {path_text(case)}",
    ]
