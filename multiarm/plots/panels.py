"""Axes over time, one above the other or in columns, with the run's events as thin upright lines.

Left edges are at the same place in all figures of one column, so that times line up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multiarm.plots.event_marks import EventMarks
from multiarm.plots.style import INK, STYLE
from multiarm.results.event_log import Event

LABEL_HEIGHT = 0.155
"""Of a label at the end of a line [in]."""
SMALLEST_SPAN = 1e-3
"""A quantity that varies less, relative to its size, is drawn as what it is: constant."""
LEFT = 0.8
"""Room left of the axes [in]."""
WIDTHS = {1: 9.6, 2: 12.0, 4: 16.0}
"""Of a figure, by the number of its columns [in]."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes: lines (columns of values) over time; dashed levels in their colours."""

    title: str
    quantity: str
    time: np.ndarray
    values: np.ndarray
    labels: tuple[str, ...]
    colours: Sequence[str]
    log: bool = False
    levels: tuple[float | None, ...] = ()


def draw(panels: list[Panel], zero_line: bool = False, events: Iterable[Event] = ()) -> Figure:
    """The panels in one figure, with the run's events across all of them.

    Parameters
    ----------
    panels : list of Panel
    zero_line : bool
        Draw a line at 0.
    events : iterable of dict
        As in `Trajectory.events`.
    """
    columns = 1 if len(panels) <= 3 else 2 if len(panels) <= 12 else 4
    rows, marks = max(1, -(-len(panels) // columns)), EventMarks(events)
    longest = max((len(label) for panel in panels for label in panel.labels), default=0)
    most = max((len(panel.labels) for panel in panels), default=0)
    height = max(1.8, LABEL_HEIGHT * most)
    with matplotlib.rc_context(STYLE):
        figure = sheet(rows, columns, height, longest, marks)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
        for axes, panel in zip(grid, panels, strict=False):
            _draw_panel(axes, panel, height, zero_line)
            if len(panel.time):
                marks.draw(axes)
        for axes in grid[max(0, len(panels) - columns) : len(panels)]:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
    return figure


def sheet(rows: int, columns: int, height: float, longest: int, marks: EventMarks) -> Figure:
    """An empty figure with room around its axes, and the legend of the events.

    Parameters
    ----------
    rows, columns : int
        Of axes.
    height : float
        Of the axes [in].
    longest : int
        Letters of the longest label at the right end of a line.
    marks : EventMarks
    """
    left, right, top = LEFT, 0.2 + 0.067 * longest, 0.4
    bottom = 0.5 + marks.legend_height(WIDTHS[columns])
    width = WIDTHS[columns] / columns - left - right
    size = columns * (left + width + right), rows * (top + height) + bottom
    figure = Figure(figsize=size)
    figure.patch.set_alpha(0)
    figure.subplots_adjust(
        left=left / size[0],
        right=1 - right / size[0],
        bottom=bottom / size[1],
        top=1 - top / size[1],
        wspace=(left + right) / width,
        hspace=top / height,
    )
    marks.add_legend(figure, left / size[0])
    return figure


def _draw_panel(axes: Axes, panel: Panel, height: float, zero_line: bool) -> None:
    axes.set_title(panel.title, parse_math=False)
    axes.set_ylabel(panel.quantity)
    axes.set_axisbelow(True)
    if zero_line:
        axes.axhline(0, color=INK, linewidth=0.6)
    if not len(panel.time):
        axes.text(0.5, 0.5, "no samples", transform=axes.transAxes, ha="center")
        return
    marker = "o" if len(panel.time) == 1 else None
    if panel.log:
        axes.set_yscale("log")
        axes.minorticks_off()
    for values, colour in zip(panel.values.T, panel.colours, strict=True):
        axes.plot(panel.time, values, color=colour, marker=marker, markersize=4)
    for level, colour in zip(panel.levels, panel.colours, strict=False):
        if level is not None:
            axes.axhline(level, color=colour, linewidth=1.0, linestyle="--")
    axes.margins(x=0)
    low, high = panel.values.min(), panel.values.max()
    span = SMALLEST_SPAN * max(abs(low), abs(high))
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)
    if any(panel.labels):
        _label_ends(axes, panel, LABEL_HEIGHT / height)


def _label_ends(axes: Axes, panel: Panel, gap: float) -> None:
    """Write each line's name at its right end, moved apart where ends are close."""
    axes.autoscale_view()
    ends = [(panel.time[-1], value) for value in panel.values[-1]]
    places = axes.transAxes.inverted().transform(axes.transData.transform(ends))[:, 1]
    spread = _moved_apart(places, gap)
    for label, colour, place in zip(panel.labels, panel.colours, spread, strict=True):
        style: dict[str, Any] = {
            "color": colour,
            "fontsize": 8.5,
            "va": "center",
            "parse_math": False,
        }
        axes.text(1.012, place, label, transform=axes.transAxes, **style)


def _moved_apart(places: np.ndarray, gap: float) -> np.ndarray:
    """Places on [0, 1], in their order, at least `gap` apart: pushed up, then below the top."""
    order = np.argsort(places, kind="stable")
    steps = gap * np.arange(len(places))
    pushed_up = np.maximum.accumulate(np.clip(places[order], 0, 1) - steps) + steps
    moved = np.empty_like(places)
    moved[order] = np.minimum(pushed_up, max(1.0, steps[-1]) - steps[::-1])
    return moved
