"""The figure of a sweep: each quantity over each varied value, and over two of them as a map.

Dots are runs; curves show their median, the middle half and nine tenths of them.  Runs that did not
complete are red ticks at the bottom.  Dots are thinned out, so that a figure of very many runs
stays small.  Where few values were run, these are the ticks of the axis.

A varied value with few different values has levels, as on a grid.  One that is different in every
run is cut into parts with equally many runs, so that each has quantiles.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import matplotlib
import numpy as np
import pandas
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator

from multiarm.errors import SweepError
from multiarm.plots.style import BLUE, INK, RED, STYLE
from multiarm.results.outcome import RunStatus
from multiarm.sweeps.result import LEVELS

if TYPE_CHECKING:
    from multiarm.sweeps.result import Sweep

MOST_LEVELS = 24
"""Different values that are levels, at most; more are grouped into parts."""
PARTS = 12
"""Parts of a value without levels, at most, and the runs in each, at least."""
PART_RUNS = 8
WIDE_RATIO = 30.0
"""Ratio of largest and smallest from which an axis is logarithmic."""


@dataclass(frozen=True)
class Variable:
    """A varied value as the axis of a figure."""

    name: str
    at: np.ndarray  # where each run lies on the axis, shape (K,)
    levels: np.ndarray | None  # their places, ascending; None where there are too many
    labels: tuple[str, ...]  # of the levels, where they are no numbers
    log: bool

    @property
    def part(self) -> np.ndarray:
        """The level of each run, or the number of its part, shape (K,)."""
        if self.levels is not None:
            return self.at
        count = max(1, min(PARTS, len(self.at) // PART_RUNS))
        ranks = pandas.Series(self.at).rank(method="first")
        return pandas.qcut(ranks, count, labels=False).to_numpy()


def variable(name: str, values: np.ndarray) -> Variable | None:
    """A column of values as an axis; None of texts and lists that nearly all differ."""
    if values.dtype.kind in "if":
        at = values.astype(float)
        levels = np.unique(at)
        few = len(levels) <= MOST_LEVELS
        return Variable(name, at, levels if few else None, (), is_wide(at))
    texts = [_text(value) for value in values.tolist()]
    labels = tuple(dict.fromkeys(texts))
    if len(labels) > MOST_LEVELS:
        return None
    place = {label: float(k) for k, label in enumerate(labels)}
    at = np.array([place[text] for text in texts])
    return Variable(name, at, np.arange(len(labels), dtype=float), labels, False)


def bands(axis: Variable, values: np.ndarray) -> tuple[np.ndarray, pandas.DataFrame]:
    """Places on the axis, shape (L,), and the values' quantiles there: a column for each level."""
    runs = pandas.DataFrame({"at": axis.at, "value": _finite(values)}).groupby(axis.part)
    quantiles = runs["value"].quantile(LEVELS).unstack().dropna()
    return runs["at"].median()[quantiles.index].to_numpy(), quantiles


def cells(x: Variable, y: Variable, values: np.ndarray) -> np.ndarray | None:
    """Median of the values at every pair of levels, NaN where there is none, (levels of y, of x).

    None where one of the two has no levels.
    """
    if x.levels is None or y.levels is None:
        return None
    runs = pandas.DataFrame({"x": x.at, "y": y.at, "value": _finite(values)})
    medians = runs.pivot_table("value", index="y", columns="x", aggfunc="median")
    return medians.reindex(index=y.levels, columns=x.levels).to_numpy()


def _finite(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, np.nan)


def is_wide(values: np.ndarray) -> bool:
    """Whether positive values spread over so much that an axis must be logarithmic."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and finite.max() > WIDE_RATIO * finite.min())


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 28 else f"{text[:27]}…"


POINTS = 3000
"""Runs that are drawn one by one, at most."""
WIDTH, HEIGHT = 4.6, 2.7
"""Of a panel [in]."""
MOST_PATHS, MOST_QUANTITIES = 4, 8
"""Columns and rows of a figure, at most."""
COLOURS = "viridis"
MOST_TICKS, NARROWEST = 8, 0.08
"""Ticks at levels: how many at most, and the least distance of two as a part of the axis."""


def sweep_overview(sweep: Sweep) -> Figure:
    """The first quantities over the first varied values, and over two of these as maps.

    Raises
    ------
    SweepError
        There is no run, no quantity or no varied value to draw.
    """
    data = _Data(sweep)
    pairs = [] if len(data.axes) < 2 else [(data.axes[0], data.axes[1])]
    rows, columns = len(data.values), len(data.axes) + len(pairs)
    with matplotlib.rc_context(STYLE):
        size = (WIDTH * columns, HEIGHT * rows + 0.6)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        for row, (name, values) in zip(grid, data.values.items(), strict=True):
            for panel, axis in zip(row, data.axes, strict=False):
                _draw_curve(panel, axis, values, data.failed)
                panel.set_ylabel(data.labels[name], parse_math=False)
            for panel, (x, y) in zip(row[len(data.axes) :], pairs, strict=True):
                _draw_map(figure, panel, x, y, values, data.labels[name])
        keys = _keys(bool(data.failed.any()))
        figure.legend(handles=keys, loc="outside lower center", frameon=False, ncols=len(keys))
    return figure


class _Data:
    """Axes, quantities and failed runs of a figure."""

    def __init__(self, sweep: Sweep) -> None:
        numbers = {
            name: sweep.table[name].to_numpy(float, na_value=np.nan) for name in sweep.quantities
        }
        drawn = [name for name, values in numbers.items() if np.isfinite(values).any()]
        if not drawn:
            raise SweepError(f"'{sweep.path}' has no run with a number to draw")
        variables = [variable(path, sweep.table[path].to_numpy()) for path in sweep.paths]
        self.axes = [axis for axis in variables if axis is not None][:MOST_PATHS]
        if not self.axes:
            raise SweepError(
                f"'{sweep.path}': there is nothing to draw over: "
                f"{', '.join(sweep.paths) or 'no value'} varies as a number, or takes few values"
            )
        self.values = {name: numbers[name] for name in drawn[:MOST_QUANTITIES]}
        units = sweep.table.attrs["units"]
        self.labels = {n: f"{n} [{units[n]}]" if n in units else n for n in self.values}
        self.failed = (sweep.table["status"] != RunStatus.COMPLETED).to_numpy(bool)


_RUN: dict[str, Any] = {"color": INK, "marker": ".", "markersize": 2.5, "alpha": 0.35, "lw": 0}
_MEDIAN: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 3.5}
_NINE_TENTHS: dict[str, Any] = {"color": BLUE, "alpha": 0.15, "linewidth": 0}
_MIDDLE_HALF: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "linewidth": 0}
_LOST: dict[str, Any] = {"color": RED, "marker": "|", "markersize": 8, "lw": 0}


def _keys(with_lost: bool) -> list[Artist]:
    """The legend of all panels with curves."""
    keys: list[Artist] = [
        Line2D([], [], **_RUN, label="a run"),
        Line2D([], [], **_MEDIAN, label="median"),
        Patch(**_MIDDLE_HALF, label="middle half"),
        Patch(**_NINE_TENTHS, label="nine tenths"),
    ]
    return [*keys, Line2D([], [], **_LOST, label="did not complete")] if with_lost else keys


def _draw_curve(panel: Axes, axis: Variable, values: np.ndarray, failed: np.ndarray) -> None:
    finite = np.isfinite(values)
    if is_wide(values):
        panel.set_yscale("log")
    _dress(panel, axis, "x")
    places, quantiles = bands(axis, values)
    shown = _thinned(np.flatnonzero(finite))
    panel.plot(axis.at[shown], values[shown], **_RUN)
    if len(places):
        panel.fill_between(places, quantiles[0.05], quantiles[0.95], **_NINE_TENTHS)
        panel.fill_between(places, quantiles[0.25], quantiles[0.75], **_MIDDLE_HALF)
        panel.plot(places, quantiles[0.5], **_MEDIAN, label="median")
    lost = _thinned(np.flatnonzero(failed))
    if len(lost):
        panel.plot(
            axis.at[lost], np.full(len(lost), 0.025), **_LOST,
            transform=panel.get_xaxis_transform(), label="did not complete",
        )  # fmt: skip


def _draw_map(
    figure: Figure, panel: Axes, x: Variable, y: Variable, values: np.ndarray, label: str
) -> None:
    finite = np.isfinite(values)
    norm = LogNorm() if is_wide(values) else Normalize()
    _dress(panel, x, "x")
    _dress(panel, y, "y")
    table = cells(x, y, values)
    panel.grid(False)
    if table is not None:
        edges = _edges(x), _edges(y)
        drawn: Any = panel.pcolormesh(
            *edges, np.ma.masked_invalid(table), cmap=COLOURS, norm=norm, linewidth=0
        )
    else:
        shown = _thinned(np.flatnonzero(finite))
        drawn = panel.scatter(
            x.at[shown], y.at[shown], c=values[shown], s=9, cmap=COLOURS, norm=norm, linewidths=0
        )
    if finite.any():
        figure.colorbar(drawn, ax=panel).set_label(label, parse_math=False)


def _dress(panel: Axes, axis: Variable, which: Literal["x", "y"]) -> None:
    """Name, scale and levels of an axis."""
    line = panel.xaxis if which == "x" else panel.yaxis
    line.set_label_text(axis.name, parse_math=False)
    if axis.log:
        panel.set(**{f"{which}scale": "log"})
    if not axis.labels and _few(axis):
        assert axis.levels is not None, "levels are few"
        line.set_ticks(axis.levels, [f"{level:.4g}" for level in axis.levels])
        line.set_minor_locator(NullLocator())
    if axis.labels and axis.levels is not None:
        crowded = which == "x" and len(axis.labels) > 3
        turned: dict[str, Any] = {"rotation": 30, "ha": "right"} if crowded else {}
        line.set_ticks(axis.levels, axis.labels, parse_math=False, **turned)


def _few(axis: Variable) -> bool:
    """Whether an axis has few levels, so far apart that each can have its tick."""
    if axis.levels is None or len(axis.levels) > MOST_TICKS:
        return False
    levels = np.log(axis.levels) if axis.log else axis.levels
    apart = np.diff(levels)
    return not len(apart) or bool(apart.min() >= NARROWEST * (levels[-1] - levels[0]))


def _edges(axis: Variable) -> np.ndarray:
    """Borders of the cells around the levels; on a logarithmic axis by ratios."""
    assert axis.levels is not None, "the axis has levels"
    levels = np.log(axis.levels) if axis.log else axis.levels
    if len(levels) == 1:
        half = 0.5 * (abs(levels[0]) or 1.0)
        edges = np.array([levels[0] - half, levels[0] + half])
    else:
        middle = 0.5 * (levels[1:] + levels[:-1])
        edges = np.array([2 * levels[0] - middle[0], *middle, 2 * levels[-1] - middle[-1]])
    return np.exp(edges) if axis.log else edges


def _thinned(runs: np.ndarray) -> np.ndarray:
    """Some of the runs, evenly, when there are very many."""
    return runs[:: max(1, -(-len(runs) // POINTS))]
