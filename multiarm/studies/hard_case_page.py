"""The hard cases as one self-contained HTML page: criteria, results, time series, other programs.

The page shows how many cases are within their criteria and on which machine; an overview of the
cases; then a card a case with its criteria, four panels over time (loops, energy, residual, rank),
its events and the peers' answers.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from multiarm.plots.style import INK, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.results.files import save_page
from multiarm.studies.hard_cases import (
    CaseResult,
    CriterionResult,
    SuiteResult,
    path_text,
    rank_text,
)
from multiarm.studies.peer_trials import OURS, Answer

DECADES = 6
"""Values further below the peak are drawn at this depth: 0 has no place on a logarithmic axis."""
SMALLEST = 1e-18
_BLUE, _GREEN, _PINK, _ORANGE = "#3b7dd8", "#2f9e67", "#c2417c", "#d9822b"
# Titles of panels -> series with colour and name, and the criterion whose bound is drawn.
_LOGARITHMIC = {
    "Loops: gaps [m] and their rates [m/s]": (
        (("gap", _BLUE, "gap"), ("gap_rate", _GREEN, "rate")),
        "position drift",
    ),
    "Energy balance [J]": ((("energy_balance", _PINK, ""),), ""),
    "Constraint residual, relative": ((("residual", _BLUE, ""),), "residual"),
}
_COUNTS = "Rank, and arms in the coupled system"


def case_figure(case: CaseResult) -> Figure | None:
    """Panels over time, events as dotted lines; None when nothing was recorded."""
    if not case.history:
        return None
    history = {key: np.array(values, dtype=float) for key, values in case.history.items()}
    panels = [
        (title, tuple(line for line in lines if line[0] in history), bound)
        for title, (lines, bound) in _LOGARITHMIC.items()
    ]
    bounds = {item.quantity: item.bound for item in case.criteria if item.bound > 0}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.9))
        figure.subplots_adjust(
            left=0.065, right=0.985, bottom=0.11, top=0.93, hspace=0.46, wspace=0.16
        )
        grid = figure.subplots(2, 2, sharex=True).ravel()
        for axes, (title, lines, bound) in zip(grid, panels, strict=False):
            _draw_logarithmic(axes, history, lines, bounds.get(bound))
            _finish(axes, title, case.events)
        _draw_counts(grid[3], history)
        _finish(grid[3], _COUNTS, case.events)
        for axes in grid[2:]:
            axes.set_xlabel("time [s]")
    return figure


def _draw_logarithmic(
    axes: Axes,
    history: dict[str, np.ndarray],
    lines: Sequence[tuple[str, str, str]],
    bound: float | None,
) -> None:
    if not lines:
        _say_nothing(axes)
        return
    peaks = [np.nanmax(np.abs(history[key]), initial=0.0) for key, _, _ in lines]
    peak = max(*peaks, SMALLEST)
    floor = max(SMALLEST, peak * 10.0**-DECADES)
    for key, colour, name in lines:
        values = np.maximum(np.abs(history[key]), floor)
        axes.plot(history["time"], values, color=colour, label=name)
    top = peak
    if bound is not None:
        axes.axhline(bound, color=INK, linewidth=0.9, dashes=(5, 3), label="bound of the gap")
        top = max(peak, bound)
    axes.set_yscale("log")
    # room for the legend above the lines
    axes.set_ylim(floor / 2, top * (500 if len(lines) > 1 else 5))
    axes.minorticks_off()
    if len(lines) > 1:
        _legend(axes)


def _draw_counts(axes: Axes, history: dict[str, np.ndarray]) -> None:
    if "rank" not in history:
        _say_nothing(axes)
        return
    time, rank, coupled = history["time"], history["rank"], history["coupled_arms"]
    axes.plot(time, rank, color=_ORANGE, label="rank", drawstyle="steps-post")
    axes.plot(time, coupled, color=_BLUE, label="arms coupled", drawstyle="steps-post")
    axes.set_ylim(-0.5, max(1.0, np.nanmax(rank)) * 1.35)
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    _legend(axes)


def _say_nothing(axes: Axes) -> None:
    axes.text(0.5, 0.5, "not recorded", transform=axes.transAxes, ha="center")


def _legend(axes: Axes) -> None:
    axes.legend(loc="upper right", ncols=3, fontsize=8, frameon=False, borderpad=0.1)


def _finish(axes: Axes, title: str, events: Sequence[dict]) -> None:
    axes.set_title(title, parse_math=False)
    axes.set_axisbelow(True)
    axes.margins(x=0)
    for event in events[:50]:
        if "time" in event:
            axes.axvline(event["time"], color=INK, linewidth=0.6, linestyle=":")


SHOWN_EVENTS = 12
DOUBTFUL, WRONG = 1e-6, 1e-2
"""Relative errors of accelerations above these are shown in yellow and in red."""
_METER_DECADES = 6


def write_page(suite: SuiteResult, path: str | os.PathLike) -> Path:
    """Write the page.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    target = Path(path).expanduser()
    save_page(render(suite), target)
    return target


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
        "answers": [_answer(answer) for answer in case.answers],
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
    wall = pages.quantity(case.wall_time_s, "s")
    return [
        f"{pages.quantity(counted['simulated_s'], 's')} simulated in {wall}",
        f"{counted['integrator']}, {counted['steps']:,} steps "
        f"({counted['rejected_steps']:,} rejected)",
        f"solver {counted['solver']}, {counted['stabilization']}",
        f"rank {rank_text(case)}",
        f"path {path_text(case)}",
    ]


def _answer(answer: Answer) -> dict[str, Any]:
    """A solver's answer with its errors as they are shown, and a remark."""
    errors = [
        ("none" if answer.accelerations else pages.scientific(error), _tone(error, answer))
        for error in (answer.object_error, answer.joint_error)
    ]
    return vars(answer) | {
        "ours": answer.solver == OURS,
        "errors": errors,
        "remark": "; ".join(filter(None, (answer.accelerations, answer.ended))),
        "broken": bool(answer.accelerations or (answer.ended and not answer.out_of_time)),
    }


def _tone(error: float | None, answer: Answer) -> str:
    if answer.accelerations or (error is not None and error > WRONG):
        return "bad"
    return "warn" if error is not None and error > DOUBTFUL else ""
