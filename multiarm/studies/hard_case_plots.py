"""The course of a hard case in four small panels: loops, energy, residual, rank."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from multiarm.plots import INK, STYLE
from multiarm.studies.hard_cases import CaseResult

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
        figure.patch.set_alpha(0)
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
