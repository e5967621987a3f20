"""Axes over time, one above the other or in columns, with the run's events as vertical lines.

Left edges are at the same place in all figures of one column, so that times line up.  Each family
of events has its line style.  Events of a family that are closer than the width of a line are one
line, so that a figure has at most some hundred of them; the legend below the axes counts all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from multiarm.notation import count_of
from multiarm.plots.style import INK, STYLE
from multiarm.results.event_kinds import (
    ACTUATOR,
    AT_LIMIT,
    FAMILIES,
    LOST,
    MADE,
    OTHER,
    SLIP,
    STICK,
    Family,
    family_of,
)
from multiarm.results.event_log import Event, counts, timed

DISTINCT = 150
"""Lines of one family over the width of the axes, at most."""
LEGEND_ROW = 0.22
"""Height of a row of the legend [in]."""
_DASHES: dict[Family, tuple[float, ...]] = {
    MADE: (),
    LOST: (7, 2.5),
    SLIP: (1, 1.6),
    STICK: (5, 2, 1, 2),
    AT_LIMIT: (3, 1.5),
    ACTUATOR: (8, 2, 1, 2, 1, 2),
    OTHER: (1, 4),
}
_KEY, _LETTER = 0.6, 0.068  # width of a legend's line with its gaps, and of a letter [in]


class EventMarks:
    """The events of a run (`Trajectory.events`), ready to be drawn into axes over time."""

    def __init__(self, events: Iterable[Event]):
        events = list(events)
        self._times: dict[Family, list[float]] = {}
        for event in timed(events):
            self._times.setdefault(family_of(event["kind"]), []).append(float(event["time"]))
        kinds: dict[Family, dict[str, int]] = {}
        for count in counts(events):
            kinds.setdefault(family_of(count.kind), {})[count.kind] = count.count
        self._labels = {
            family: f"{', '.join(kinds[family])}: {count_of(sum(kinds[family].values()), 'event')}"
            for family in FAMILIES
            if family in kinds
        }

    def legend_height(self, width: float) -> float:
        """Height of the legend below axes of a figure of some width [in]."""
        if not self._labels:
            return 0.0
        return LEGEND_ROW * (-(-len(self._labels) // self._columns(width)) + 0.3)

    def draw(self, axes: Axes) -> None:
        """Draw the lines of the events that lie within the axes."""
        low, high = axes.get_xlim()
        for family, times in self._times.items():
            shown = _thinned(np.array(times), low, high)
            if not len(shown):
                continue
            ends = np.column_stack([np.repeat(shown, 2), np.tile([0.0, 1.0], len(shown))])
            codes = np.tile([Path.MOVETO, Path.LINETO], len(shown))
            lines = PathPatch(
                Path(ends, codes), transform=axes.get_xaxis_transform(), zorder=1.6,
                label=family.name, **_style(family), fill=False,
            )  # fmt: skip
            axes.add_artist(lines)

    def add_legend(self, figure: Figure, left: float) -> None:
        """Explain the lines at the foot of a figure; `left` is in fractions of its width."""
        if not self._labels:
            return
        keys = [Line2D([], [], **_style(family)) for family in self._labels]
        legend = figure.legend(
            keys, list(self._labels.values()), loc="lower left", bbox_to_anchor=(left, 0.0),
            ncols=self._columns(figure.get_figwidth()), frameon=False, fontsize=8.5,
            handlelength=3.2, borderaxespad=0.2, borderpad=0.0, columnspacing=1.6,
        )  # fmt: skip
        legend.set_gid("events")
        for text in legend.get_texts():
            text.set_parse_math(False)

    def _columns(self, width: float) -> int:
        longest = max(len(label) for label in self._labels.values())
        return min(len(self._labels), max(1, int(width / (_KEY + _LETTER * longest))))


def _thinned(times: np.ndarray, low: float, high: float) -> np.ndarray:
    """The first of the times in each of `DISTINCT` parts of the axes that has any."""
    inside = np.sort(times[(times >= low) & (times <= high)])
    part = np.floor((inside - low) / (high - low) * DISTINCT)
    return inside[np.unique(part, return_index=True)[1]]


def _style(family: Family) -> dict[str, Any]:
    return {
        "color": family.colour,
        "linewidth": 0.8,
        "linestyle": (0, _DASHES[family]) if _DASHES[family] else "solid",
        "alpha": 0.7,
    }


KEY = 0.32
"""Length of the piece of a line before its name, with a gap on both sides [in]."""
LABEL_HEIGHT = 0.155
"""Of a label at the end of a line [in]."""
SMALLEST_SPAN = 1e-3
"""A quantity that varies less, relative to its size, is drawn as a constant."""
DECADES = 6
"""Values further below their peak are drawn at this depth: 0 has no place on a logarithmic axis."""
LEFT = 0.8
"""Room left of the axes [in]."""
WIDTHS = {1: 9.6, 2: 12.0, 4: 16.0}
"""Of a figure, by the number of its columns [in]."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes: lines (columns of values) over time; dashed levels in their colours.

    Whole numbers are drawn with ticks at whole numbers.
    """

    title: str
    quantity: str
    time: np.ndarray
    values: np.ndarray
    labels: tuple[str, ...]
    colours: Sequence[str]
    dashes: Sequence[tuple[float, ...]] = ()  # of the lines; solid where there are none
    log: bool = False
    levels: tuple[float | None, ...] = ()

    def looks(self) -> list[dict[str, Any]]:
        """Colour and dashes of each line."""
        dashes = self.dashes or [()] * len(self.colours)
        pairs = zip(self.colours, dashes, strict=True)
        return [{"color": c, "linestyle": (0, dash) if dash else "solid"} for c, dash in pairs]


def draw(panels: list[Panel], zero_line: bool = False, events: Iterable[Event] = ()) -> Figure:
    """The panels in one figure, with the run's events (`Trajectory.events`) across all of them."""
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
    """An empty figure with room around rows and columns of axes, and the legend of the events.

    ``height`` is that of the axes [in], ``longest`` the number of letters of the longest label at
    the right end of a line.
    """
    left, right, top = LEFT, 0.2 + (KEY if longest else 0.0) + 0.067 * longest, 0.4
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
    if panel.values.dtype.kind == "i":
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    for values, look in zip(panel.values.T, panel.looks(), strict=True):
        axes.plot(panel.time, values, marker=marker, markersize=4, **look)
    for level, colour in zip(panel.levels, panel.colours, strict=False):
        if level is not None:
            axes.axhline(level, color=colour, linewidth=1.0, linestyle="--")
    axes.margins(x=0)
    low, high = panel.values.min(), panel.values.max()
    span = SMALLEST_SPAN * max(abs(low), abs(high))
    if panel.log:
        bottom, top = axes.get_ylim()
        if top < 10.0 * bottom:  # else there may be no tick
            axes.set_ylim(10.0 ** np.floor(np.log10(bottom)), 10.0 ** np.ceil(np.log10(top)))
    elif high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)
    if any(panel.labels):
        _label_ends(axes, panel, LABEL_HEIGHT / height)


def _label_ends(axes: Axes, panel: Panel, gap: float) -> None:
    """Write each line's name beside its right end, after a piece of the line; moved apart."""
    axes.autoscale_view()
    ends = [(panel.time[-1], value) for value in panel.values[-1]]
    places = axes.transAxes.inverted().transform(axes.transData.transform(ends))[:, 1]
    spread = _moved_apart(places, gap)
    figure = axes.figure
    assert isinstance(figure, Figure), "panels are drawn into a figure"
    width = axes.get_position().width * figure.get_figwidth()
    begin, end, name = (1.0 + part * KEY / width for part in (0.2, 0.8, 0.95))
    for label, look, place in zip(panel.labels, panel.looks(), spread, strict=True):
        figure.add_artist(Line2D([begin, end], [place] * 2, transform=axes.transAxes, **look))
        axes.text(
            name, place, label, transform=axes.transAxes, color=look["color"], fontsize=8.5,
            va="center", parse_math=False,
        )  # fmt: skip


def _moved_apart(places: np.ndarray, gap: float) -> np.ndarray:
    """Places on [0, 1], in their order, at least `gap` apart: pushed up, then below the top."""
    order = np.argsort(places, kind="stable")
    steps = gap * np.arange(len(places))
    pushed_up = np.maximum.accumulate(np.clip(places[order], 0, 1) - steps) + steps
    moved = np.empty_like(places)
    moved[order] = np.minimum(pushed_up, max(1.0, steps[-1]) - steps[::-1])
    return moved
