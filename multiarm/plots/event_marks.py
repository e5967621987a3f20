"""Events in a figure: upright lines across all axes, one style for each family of kinds.

Events of a family that lie closer than a line is wide are one line, so that a figure has at most
some hundred of them, however many there were; the legend below the axes gives the true numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from multiarm.results.event_log import (
    ACTUATOR,
    FAMILIES,
    LIMIT,
    LOST,
    MADE,
    OTHER,
    SLIP,
    STICK,
    Event,
    Family,
    counts,
    family_of,
    timed,
)

DISTINCT = 150
"""Lines of one family over the width of the axes, at most."""
LEGEND_ROW = 0.22
"""Height of a row of the legend [in]."""
_DASHES: dict[Family, tuple[float, ...]] = {
    MADE: (),
    LOST: (7, 2.5),
    SLIP: (1, 1.6),
    STICK: (5, 2, 1, 2),
    LIMIT: (3, 1.5),
    ACTUATOR: (8, 2, 1, 2, 1, 2),
    OTHER: (1, 4),
}
_KEY, _LETTER = 0.6, 0.068  # width of a legend's line with its gaps, and of a letter [in]


class EventMarks:
    """The events of a run, ready to be drawn into axes over time.

    Parameters
    ----------
    events : iterable of dict
        As in `Trajectory.events`.
    """

    def __init__(self, events: Iterable[Event]):
        events = list(events)
        self._times: dict[Family, list[float]] = {}
        for event in timed(events):
            self._times.setdefault(family_of(event["kind"]), []).append(float(event["time"]))
        kinds: dict[Family, dict[str, int]] = {}
        for count in counts(events):
            kinds.setdefault(family_of(count.kind), {})[count.kind] = count.count
        self._labels = {
            family: f"{', '.join(kinds[family])} ({sum(kinds[family].values()):,})"
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
