"""Figures of the scaling study: cost over the number of arms, section 4.4, shares of time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from multiarm.plots import INK, STYLE

_BLUE, _GREEN, _PINK, _ORANGE, _GREY = "#3b7dd8", "#2f9e67", "#c2417c", "#d9822b", "#8a94a0"
# method: name, colour, dashes
_METHODS = {
    "multiarm": ("multiarm", _BLUE, ()),
    "compiled": ("compiled arms", _PINK, ()),
    "terms": ("Pinocchio's arm terms", _BLUE, (2, 1.5)),
    "lcaba": ("lcaba", _GREEN, ()),
    "constraintDynamics": ("constraintDynamics", _ORANGE, ()),
    "tree": ("the same, object on one arm", _ORANGE, (2, 1.5)),
    "dense": ("dense KKT, NumPy", _GREY, ()),
}
# picture and part of the study of section 4.4: name, colour, dashes
_SOLVERS = {
    ("compiled", "node"): ("node, compiled", _BLUE, ()),
    ("interpreted", "node"): ("node, NumPy loop", _BLUE, (4, 2)),
    ("interpreted", "node at once"): ("node, NumPy at once", _BLUE, (1, 1.5)),
    ("compiled", "lu"): ("direct, LU", _ORANGE, ()),
}
_PARTS = {
    "arm terms": _BLUE, "contacts": "#6aa5ea", "forces": "#a9c9f2", "node": _GREEN,
    "state": "#8fd0af", "between": "#cfd6dd", "stabilisation": _ORANGE, "recording": "#ecb679",
    "arithmetic": _PINK, "rest": _GREY,
}  # fmt: skip
_PANEL = (5.0, 3.9)  # [in]


def plot_scaling(result: dict[str, Any], path: Path | str) -> None:
    """Draw all studies of a result that have a figure into one file."""
    draws = _panels(result)
    columns = min(2, max(1, len(draws)))
    rows = -(-max(1, len(draws)) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout="constrained")
        grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
        for axes, draw in zip(grid, draws, strict=False):
            draw(axes)
        for axes in grid[len(draws) :]:
            axes.set_axis_off()
            if not draws:
                axes.text(0.5, 0.5, "nothing here has a figure", ha="center")
        figure.savefig(path, dpi=150)


def study_figure(result: dict[str, Any], study: str) -> Figure:
    """The panels of one study, side by side, on a transparent ground."""
    draws = _panels({study: result[study]})
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.9), layout="constrained")
        figure.patch.set_alpha(0)
        for axes, draw in zip(figure.subplots(1, len(draws), squeeze=False)[0], draws, strict=True):
            draw(axes)
    return figure


def _panels(result: dict[str, Any]) -> list[Any]:
    """Functions that draw the panels of a result, in order."""
    draws: list[Any] = []
    if "evaluations" in result:
        found = result["evaluations"]
        for kind in found["exponents"]:
            draws.append(lambda axes, kind=kind: _draw_evaluations(axes, found, kind))
    if "thesis" in result:
        draws.append(lambda axes: _draw_solvers(axes, result["thesis"]))
        draws.append(lambda axes: _draw_speedups(axes, result["thesis"]))
    if "shares" in result:
        draws.append(lambda axes: _draw_shares(axes, result["shares"]))
    return draws


def _draw_evaluations(axes: Axes, found: dict[str, Any], kind: str) -> None:
    rows = [row for row in found["rows"] if row["kind"] == kind]
    for method, (name, colour, dashes) in _METHODS.items():
        known = [row for row in rows if row["microseconds"][method] is not None]
        _line(
            axes, [row["arms"] for row in known], [row["microseconds"][method] for row in known],
            f"{name}{_power(found['exponents'][kind][method])}", colour, dashes,
            1.2 if dashes or method == "dense" else 1.8,
        )  # fmt: skip
    _finish(axes, [row["arms"] for row in rows], f"One evaluation, {kind} joints")
    axes.set_ylabel("microseconds")


def _draw_solvers(axes: Axes, found: dict[str, Any]) -> None:
    rows = found["rows"]
    arms = [row["arms"] for row in rows]
    for (picture, part), (name, colour, dashes) in _SOLVERS.items():
        slope = found["upper_slopes" if part == "lu" else "slopes"][picture][part]
        costs = [row["microseconds"][picture][part] for row in rows]
        _line(axes, arms, costs, f"{name}{_power(slope)}", colour, dashes, 1.6)
    then = {int(n): values for n, values in found["thesis"].items()}
    for key, name, colour in (("t1", "node", _BLUE), ("t2", "direct", _ORANGE)):
        costs = [1e3 * values[key] for values in then.values()]
        axes.plot(
            list(then), costs, "o", color=colour, ms=4, mfc="none", mew=1.1,
            label=f"{name}, Matlab 1995",
        )  # fmt: skip
    _finish(axes, arms, "Section 4.4: solving for the accelerations", columns=2)
    axes.set_ylim(top=axes.get_ylim()[1] * 60)  # room for the legend
    axes.set_ylabel("microseconds")


def _draw_speedups(axes: Axes, found: dict[str, Any]) -> None:
    arms = [row["arms"] for row in found["rows"]]
    then = {int(n): values for n, values in found["thesis"].items()}
    for picture, name, colour in (
        ("compiled", "compiled", _BLUE),
        ("interpreted", "NumPy", _GREEN),
    ):
        for key, dashes, what in (("solving", (), "$t_2/t_1$"), ("total", (2, 1.5), "total")):
            values = [row["columns"][picture][key] for row in found["rows"]]
            _line(axes, arms, values, f"{what}, {name}", colour, dashes, 1.6)
    for key, marker, what in (("solving", "o", "$t_2/t_1$"), ("total", "s", "total")):
        values = [columns[key] for columns in then.values()]
        axes.plot(
            list(then), values, marker, color=_PINK, ms=4, mfc="none", mew=1.1,
            label=f"{what}, 1995",
        )  # fmt: skip
    axes.axhline(1.0, color=INK, linewidth=0.8)
    _finish(axes, arms, "Section 4.4: speed-up by the node algorithm")
    axes.set_ylabel("times")


def _draw_shares(axes: Axes, found: dict[str, Any]) -> None:
    """Stacked bars in percent; what is left negative by the error of measurement is not drawn."""
    bars = [
        (f"{what}, n = {row['arms']}", row[what]) for what in ("evaluation", "step")
        for row in found["rows"]
    ]  # fmt: skip
    places = np.arange(len(bars))[::-1].astype(float)
    places[: len(found["rows"])] += 0.4  # evaluations apart from steps
    left = np.zeros(len(bars))
    for part, colour in _PARTS.items():
        widths = np.array([_percent(shares, part) for _, shares in bars])
        axes.barh(places, widths, left=left, color=colour, height=0.72, label=part)
        for place, start, width in zip(places, left, widths, strict=True):
            if width >= 7:
                axes.text(
                    start + width / 2, place, f"{width:.0f}", ha="center", va="center",
                    color="white" if colour in (_BLUE, _GREEN, _ORANGE, _PINK, _GREY) else "black",
                    fontsize=8,
                )  # fmt: skip
        left += widths
    axes.set_yticks(places, [name for name, _ in bars])
    axes.set_xlim(0, 100)
    axes.set_xlabel("percent")
    axes.grid(False)
    axes.set_title(f"Where the time goes ({found['kind']} joints)")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=5, fontsize=7.5, frameon=False,
        handlelength=1.0, columnspacing=1.0,
    )  # fmt: skip


def _percent(shares: dict[str, float], part: str) -> float:
    drawn = sum(max(value, 0.0) for value in shares.values())
    return 100.0 * max(shares.get(part, 0.0), 0.0) / drawn


def _line(
    axes: Axes, x: Sequence[float], y: Sequence[float], label: str, colour: str,
    dashes: Sequence[float], width: float,
) -> None:  # fmt: skip
    style: dict[str, Any] = {"dashes": dashes} if dashes else {}
    axes.plot(x, y, "-", marker="o", color=colour, lw=width, ms=3, label=label, **style)


def _power(slope: float | None) -> str:
    return "" if slope is None else f"  $n^{{{slope:.2f}}}$"


def _finish(axes: Axes, arms: Sequence[int], title: str, columns: int = 1) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    shown: list[int] = []
    for n in reversed(arms):  # as many as there is room for
        if not shown or shown[-1] >= 1.24 * n:
            shown.append(n)
    axes.set_xticks(shown, [str(n) for n in shown])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("number of arms")
    axes.set_title(title)
    axes.legend(
        loc="upper left", fontsize=7.8, frameon=False, ncols=columns, handlelength=2.4,
        columnspacing=1.2, labelspacing=0.3,
    )  # fmt: skip
