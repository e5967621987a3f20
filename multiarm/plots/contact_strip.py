"""What each contact does over time: one row a contact, a bar for each state.

The height of a bar tells its state as its colour does: a hair for an open contact, a low bar for
one that touches, a dotted one where it rests, a hatched one while it slides, a full one while it
sticks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from multiarm.plots.decimation import POINTS, decimate
from multiarm.plots.event_marks import LEGEND_ROW, EventMarks
from multiarm.plots.panels import sheet
from multiarm.plots.style import GRID, STYLE
from multiarm.results.channels import CONTACT_STATES, channels_of
from multiarm.results.event_log import STATE_COLOURS

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

ROW = 0.24
"""Height of a row [in]."""
MOST_ROWS = 64
"""Contacts in the figure; of more, the first are shown and the others counted."""
STRIP_POINTS = 12_000
"""Changes of all rows together."""
_HEIGHTS = (0.06, 0.35, 0.8, 0.8, 0.35)  # of a bar, by the code of its state, of a row
_HATCHES = ("", "", "////", "", "....")


def contact_states(trajectory: Trajectory) -> Figure | None:
    """A row for each contact that can open, slide or stick; None for a run without such contacts.

    Bars change at samples: what happens between two samples is seen by its events only.
    """
    named = channels_of(trajectory.channels, "contact_state")
    rows = [
        (channel, column, f"{bearer}: {label}")
        for bearer, channel in named.items()
        for column, label in enumerate(trajectory.channels[channel].labels)
    ]
    if not rows:
        return None
    shown, left_out = rows[:MOST_ROWS], len(rows) - MOST_ROWS
    marks = EventMarks(trajectory.events)
    with matplotlib.rc_context(STYLE):
        longest = max(len(name) for _, _, name in shown)
        figure = sheet(1, 1, ROW * len(shown) + LEGEND_ROW, longest, marks)
        (axes,) = figure.subplots(1, 1, squeeze=False).ravel()
        axes.set_title("Contact states", parse_math=False)
        used = _draw_rows(axes, trajectory, shown)
        _dress(axes, [name for _, _, name in shown], left_out)
        _add_legend(axes, used)
        if len(trajectory):
            marks.draw(axes)
    return figure


def _draw_rows(axes: Axes, trajectory: Trajectory, rows: list[tuple[str, int, str]]) -> set[int]:
    """Draw the bars; returns the codes that occur."""
    points = min(POINTS, max(200, STRIP_POINTS // len(rows)))
    used: set[int] = set()
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for place, (channel, column, _) in enumerate(rows):
        if channel not in columns:
            columns[channel] = decimate(trajectory, [channel], points=points)
        time, codes = columns[channel]
        if not len(time):
            continue
        begins, ends, states = spans(time, codes[:, column])
        for code in np.unique(states):
            used.add(int(code))
            of_it = states == code
            bars = np.column_stack([begins[of_it], (ends - begins)[of_it]])
            height = _HEIGHTS[code]
            low = place + 0.5 - height / 2
            axes.broken_barh([(b, w) for b, w in bars], (low, height), **_style(int(code)))
    return used


def spans(time: np.ndarray, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stretches of one state: begin, end (the next one's begin), code; of samples, shape (K,)."""
    states = np.round(codes).astype(int)
    first = np.flatnonzero(np.diff(states, prepend=-1))
    ends = np.append(time[first[1:]], time[-1])
    return time[first], ends, states[first]


def _dress(axes: Axes, names: list[str], left_out: int) -> None:
    axes.set_ylim(len(names), 0)
    axes.set_yticks([])
    axes.margins(x=0)
    axes.autoscale_view(scaley=False)
    axes.grid(False)
    axes.set_axisbelow(True)
    for place in range(1, len(names)):
        axes.axhline(place, color=GRID, linewidth=0.6, zorder=0.5)
    style: dict[str, Any] = {"va": "center", "fontsize": 8.5, "parse_math": False}
    for place, name in enumerate(names):
        axes.text(1.012, place + 0.5, name, transform=axes.get_yaxis_transform(), **style)
    more = f"; {left_out} more contacts are not shown" if left_out > 0 else ""
    axes.set_xlabel(f"time [s]{more}")


def _add_legend(axes: Axes, used: set[int]) -> None:
    keys = [Patch(**_style(code), label=CONTACT_STATES[code]) for code in sorted(used)]
    if keys:
        axes.legend(
            handles=keys, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(keys),
            frameon=False, fontsize=8.5, borderaxespad=0.2, handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip


def _style(code: int) -> dict[str, Any]:
    colour = STATE_COLOURS[code]
    hollow = bool(_HATCHES[code])
    return {
        "facecolor": "none" if hollow else colour,
        "edgecolor": colour,
        "hatch": _HATCHES[code],
        "linewidth": 0.6,
    }
