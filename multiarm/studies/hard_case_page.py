"""The hard cases as tables, figures and one self-contained HTML page.

The page shows how many cases are within their criteria and on which machine; an overview of the
cases; then a card a case with its criteria, four panels over time (loops, energy, residual, rank)
and its events.
"""

from __future__ import annotations

import math
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from multiarm.notation import count_of, number
from multiarm.plots.panels import DECADES, Panel, draw
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK, inline_svg
from multiarm.reports import pages
from multiarm.studies.hard_cases import CaseResult, CriterionResult, SuiteResult


def figures(suite: SuiteResult) -> dict[str, Any]:
    """All figures, under the keys that ``multiarm stability --help`` lists."""
    return suite.as_dict()


def rank_text(case: CaseResult) -> str:
    """The rank, or its range, and how many events there were."""
    low, high = (case.statistics.get(key) for key in ("lowest_rank", "highest_rank"))
    text = "-" if low is None else f"{low}" if low == high else f"{low} to {high}"
    count = len(case.events)
    return text if not count else f"{text}, {count_of(count, 'event')}"


def path_text(case: CaseResult) -> str:
    """Which path of the solver the steps took."""
    steps, coupled = (case.statistics.get(key) for key in ("steps", "coupled_steps"))
    if steps is None or coupled is None:
        return "-"
    if not coupled:
        return "linear"
    return "coupled" if coupled >= steps else f"coupled in {coupled:,} of {count_of(steps, 'step')}"


# --- figure and page ------------------------------------------------------------------------------


SMALLEST = 1e-18
"""The least that is drawn on a logarithmic axis."""
SHOWN_EVENTS = 12
_METER_DECADES = 6


def case_figure(case: CaseResult) -> Figure | None:
    """Panels over time with the events; None when nothing was recorded."""
    if not case.history:
        return None
    bounds = {item.quantity: item.bound for item in case.criteria if item.bound > 0}
    panels = [
        _panel(
            case, "Loops", "gap [m], rate [m/s]", {"gap": BLUE, "gap_rate": GREEN},
            log=True, levels=(bounds.get("position drift"),),
        ),
        _panel(case, "Energy", "balance [J]", {"energy_balance": PINK}, log=True),
        _panel(
            case, "Constraints", "relative residual", {"residual": BLUE},
            log=True, levels=(bounds.get("residual"),),
        ),
        _panel(
            case, "Rank, and arms in the coupled system", "number",
            {"rank": ORANGE, "coupled_arms": BLUE},
        ),
    ]  # fmt: skip
    return draw(panels, events=case.events)


def _panel(
    case: CaseResult, title: str, quantity: str, lines: dict[str, str], **more: Any
) -> Panel:
    """One panel; ``lines`` are keys of the history with their colours."""
    if not lines.keys() <= case.history.keys():
        return Panel(f"{title}: not recorded", quantity, np.empty(0), np.empty((0, 0)), (), ())
    values = np.array([case.history[key] for key in lines], dtype=float).T
    if more.get("log"):
        values = np.abs(values)
        peak = max(np.nanmax(values, initial=0.0), SMALLEST)
        values = np.fmax(values, max(SMALLEST, peak * 10.0**-DECADES))
    elif np.array_equal(values, np.round(values)):
        values = values.astype(int)
    labels = tuple(key.replace("_", " ") for key in lines) if len(lines) > 1 else ("",)
    time = np.array(case.history["time"], dtype=float)
    return Panel(title, quantity, time, values, labels, tuple(lines.values()), **more)


def render(suite: SuiteResult) -> str:
    """The page as text."""
    return pages.render(
        "stability.html",
        suite=suite,
        cases=[_case(case, f"c{number}-") for number, case in enumerate(suite.cases)],
        simulated_s=sum(case.wall_time_s for case in suite.cases),
        shown_events=SHOWN_EVENTS,
    )


def _case(case: CaseResult, prefix: str) -> dict[str, Any]:
    """A case with what its card says besides; ids in its figure begin with ``prefix``."""
    figure = case_figure(case)
    nearest = min(case.criteria, key=lambda item: (item.passed, _decades(item)), default=None)
    return vars(case) | {
        "criteria": [_criterion(item) for item in case.criteria],
        "nearest": nearest and _criterion(nearest),
        "trouble": shorten(case.message, 90, placeholder=" …"),
        "wall_time_s": case.wall_time_s or None,
        "rank": rank_text(case),
        "path": path_text(case),
        "run": _run(case),
        "figure": "" if figure is None else inline_svg(figure, prefix),
    }


def _criterion(item: CriterionResult) -> dict[str, Any]:
    """A criterion with the room to its bound, in words and in percent of a bar."""
    width = max(3.0, 100.0 * min(1.0, abs(_decades(item)) / _METER_DECADES))
    unit = "" if item.unit == "1" else item.unit
    return vars(item) | {"room": _room(item), "width": width, "unit": unit}


def _decades(item: CriterionResult) -> float:
    """How many powers of ten a criterion is within its bound; negative: beyond."""
    if item.measured is None:
        return -math.inf
    if item.measured <= 0.0 or item.measured == item.bound:
        return 0.0 if item.measured == item.bound > 0.0 else math.inf
    return math.log10(item.bound / item.measured) if item.bound > 0.0 else -math.inf


def _room(item: CriterionResult) -> str:
    """The room to the bound in words."""
    if item.measured is None:
        return item.message
    room = _decades(item)
    if math.isinf(room):
        exact = item.measured == 0 and item.passed
        return "exactly" if exact else "within" if item.passed else "beyond"
    times = 10.0 ** abs(room)
    shown = f"{times:.2g}" if times < 100 else f"{times:.0f}"
    if times >= 1e3:
        shown = pages.power_of_ten(math.floor(abs(room)))
    return f"{shown} times {'within' if item.passed else 'beyond'}"


def _run(case: CaseResult) -> list[str]:
    """How it was run; empty if it was not."""
    counted = case.statistics
    if not counted:
        return []
    wall = number(case.wall_time_s, "s")
    return [
        f"{number(counted['simulated_s'], 's')} simulated in {wall}",
        f"{counted['integrator']}, {count_of(counted['steps'], 'step')} "
        f"({counted['rejected_steps']:,} rejected)",
        f"solver {counted['solver']}, {counted['stabilization']}",
        f"rank {rank_text(case)}",
        f"path {path_text(case)}",
    ]
