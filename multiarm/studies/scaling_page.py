"""The scaling study as figures and as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from multiarm.plots.style import BLUE, GREEN, INK, ORANGE, PINK, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.studies.scaling_tables import disturbance, exponent, micro, tables

Drawing = Callable[[Axes], None]
GREY = "#8a94a0"
# method: name, colour, dashes
_METHODS = {
    "multiarm": ("multiarm", BLUE, ()),
    "compiled": ("compiled arms", PINK, ()),
    "terms": ("Pinocchio's arm terms", BLUE, (2, 1.5)),
    "lcaba": ("lcaba", GREEN, ()),
    "constraintDynamics": ("constraintDynamics", ORANGE, ()),
    "tree": ("the same, object on one arm", ORANGE, (2, 1.5)),
    "dense": ("dense KKT, NumPy", GREY, ()),
}
# picture and part of the study of section 4.4: name, colour, dashes
_SOLVERS = {
    ("compiled", "node"): ("node, compiled", BLUE, ()),
    ("interpreted", "node"): ("node, NumPy loop", BLUE, (4, 2)),
    ("interpreted", "node at once"): ("node, NumPy at once", BLUE, (1, 1.5)),
    ("compiled", "lu"): ("direct, LU", ORANGE, ()),
}
_PARTS = {
    "arm terms": BLUE, "contacts": "#6aa5ea", "forces": "#a9c9f2", "node": GREEN,
    "state": "#8fd0af", "between": "#cfd6dd", "stabilisation": ORANGE, "recording": "#ecb679",
    "arithmetic": PINK, "rest": GREY,
}  # fmt: skip
_DOTS: dict[str, Any] = {"marker": "o", "ms": 3}  # what was measured here
_RINGS: dict[str, Any] = {"ms": 4, "mfc": "none", "mew": 1.1}  # what the thesis gives
_PANEL = (5.0, 3.9)  # [in]
_LEGEND_ROW = 0.058  # height of a row of the legend, as a part of the axes


def figure(result: dict[str, Any]) -> Figure:
    """All studies of a result that have a figure, in one."""
    draws = [draw for own in _panels(result).values() for draw in own]
    columns = min(2, max(1, len(draws)))
    return _figure(draws or [_draw_nothing], columns, *_PANEL)


def _figure(draws: Sequence[Drawing], columns: int, width: float, height: float) -> Figure:
    """Panels of some width and height [in] in columns."""
    rows = -(-len(draws) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, draw in zip(grid, draws, strict=False):
            draw(axes)
        for axes in grid[len(draws) :]:
            axes.set_axis_off()
    return figure


def _draw_nothing(axes: Axes) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, "nothing here has a figure", ha="center")


def _panels(result: dict[str, Any]) -> dict[str, list[Drawing]]:
    """Study -> functions that draw its panels, of the studies that have a figure."""
    draws: dict[str, list[Drawing]] = {}
    if "evaluations" in result:
        found = result["evaluations"]
        draws["evaluations"] = [
            partial(_draw_evaluations, found=found, kind=kind) for kind in found["exponents"]
        ]
    if "thesis" in result:
        drawers = (_draw_solvers, _draw_speedups)
        draws["thesis"] = [partial(draw, found=result["thesis"]) for draw in drawers]
    if "shares" in result:
        draws["shares"] = [partial(_draw_shares, found=result["shares"])]
    return draws


def _draw_evaluations(axes: Axes, found: dict[str, Any], kind: str) -> None:
    rows = [row for row in found["rows"] if row["kind"] == kind]
    for method, (name, colour, dashes) in _METHODS.items():
        costs = {row["arms"]: row["microseconds"][method] for row in rows}
        known = {arms: cost for arms, cost in costs.items() if cost is not None}
        label = f"{name}{_power(found['exponents'][kind][method])}"
        width = 1.2 if dashes or method == "dense" else 1.8
        axes.plot(*_xy(known), label=label, color=colour, dashes=dashes, lw=width, **_DOTS)
    _finish(axes, [row["arms"] for row in rows], f"One evaluation, {kind} joints", "microseconds")


def _draw_solvers(axes: Axes, found: dict[str, Any]) -> None:
    for (picture, part), (name, colour, dashes) in _SOLVERS.items():
        slope = found["upper_slopes" if part == "lu" else "slopes"][picture][part]
        costs = {row["arms"]: row["microseconds"][picture][part] for row in found["rows"]}
        label = f"{name}{_power(slope)}"
        axes.plot(*_xy(costs), label=label, color=colour, dashes=dashes, lw=1.6, **_DOTS)
    for key, name, colour in (("t1", "node", BLUE), ("t2", "direct", ORANGE)):
        then = {int(n): 1e3 * values[key] for n, values in found["thesis"].items()}
        axes.plot(*_xy(then), "o", label=f"{name}, Matlab 1995", color=colour, **_RINGS)
    arms = [row["arms"] for row in found["rows"]]
    _finish(axes, arms, "Section 4.4: solving for the accelerations", "microseconds", columns=2)


def _draw_speedups(axes: Axes, found: dict[str, Any]) -> None:
    shown = (("solving", (), "o", "$t_2/t_1$"), ("total", (2, 1.5), "s", "total"))
    for picture, name, colour in (("compiled", "compiled", BLUE), ("interpreted", "NumPy", GREEN)):
        for key, dashes, _, what in shown:
            times = {row["arms"]: row["columns"][picture][key] for row in found["rows"]}
            label = f"{what}, {name}"
            axes.plot(*_xy(times), label=label, color=colour, dashes=dashes, lw=1.6, **_DOTS)
    for key, _, marker, what in shown:
        then = {int(n): values[key] for n, values in found["thesis"].items()}
        axes.plot(*_xy(then), marker, label=f"{what}, 1995", color=PINK, **_RINGS)
    axes.axhline(1.0, color=INK, linewidth=0.8)
    arms = [row["arms"] for row in found["rows"]]
    _finish(axes, arms, "Section 4.4: speed-up by the node algorithm", "times")


def _draw_shares(axes: Axes, found: dict[str, Any]) -> None:
    """Stacked bars in percent; what is left negative by the error of measurement is not drawn."""
    names, shares = [], []
    for what in ("evaluation", "step"):
        for row in found["rows"]:
            names.append(f"{what}, n = {row['arms']}")
            shares.append([max(row[what].get(part, 0.0), 0.0) for part in _PARTS])
    places = np.arange(len(names))[::-1].astype(float)
    places[: len(found["rows"])] += 0.4  # evaluations apart from steps
    percent = 100.0 * np.array(shares) / np.sum(shares, axis=1, keepdims=True)
    left = np.cumsum(percent, axis=1) - percent
    for part, (name, colour) in enumerate(_PARTS.items()):
        widths = percent[:, part]
        bars = axes.barh(places, widths, left=left[:, part], color=colour, height=0.72, label=name)
        ink = "white" if colour in (BLUE, GREEN, ORANGE, PINK, GREY) else "black"
        labels = [f"{width:.0f}" if width >= 7 else "" for width in widths]
        axes.bar_label(bars, labels, label_type="center", color=ink, fontsize=8)
    axes.set_yticks(places, names)
    axes.set_xlim(0, 100)
    axes.set_xlabel("percent")
    axes.grid(False)
    axes.set_title(f"Where the time goes ({found['kind']} joints)")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=5, fontsize=7.5, frameon=False,
        handlelength=1.0, columnspacing=1.0,
    )  # fmt: skip


def _xy(values: dict[int, float]) -> tuple[list[int], list[float]]:
    """Numbers of arms, and the values there."""
    return list(values), list(values.values())


def _power(slope: float | None) -> str:
    return "" if slope is None else f"  $n^{{{slope:.2f}}}$"


def _finish(axes: Axes, arms: Sequence[int], title: str, unit: str, columns: int = 1) -> None:
    """Logarithmic axes, a tick for as many numbers of arms as have room, and the legend on top."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    shown: list[int] = []
    for n in reversed(arms):
        if not shown or shown[-1] >= 1.24 * n:
            shown.append(n)
    axes.set_xticks(shown, [str(n) for n in shown])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("number of arms")
    axes.set_ylabel(unit)
    axes.set_title(title)
    legend = axes.legend(
        loc="upper left", fontsize=7.8, frameon=False, ncols=columns, handlelength=2.4,
        columnspacing=1.2, labelspacing=0.3,
    )  # fmt: skip
    room = 1.0 - _LEGEND_ROW * -(-len(legend.get_texts()) // columns)
    low, high = axes.get_ylim()
    axes.set_ylim(low, low * (high / low) ** (1.0 / room))


def render(result: dict[str, Any]) -> str:
    """The page as text."""
    return pages.render(
        "scaling.html",
        result=result,
        headlines=list(_headlines(result)),
        studies=tables(result),
        figures={
            study: inline_svg(_figure(draws, len(draws), 9.6 / len(draws), 3.9), f"{study}-")
            for study, draws in _panels(result).items()
        },
        disturbance=disturbance(result),
    )


def _headlines(result: dict[str, Any]) -> Iterable[tuple[str, str, str]]:
    """Name, value and remark of what matters most."""
    if "evaluations" in result:
        found = result["evaluations"]
        kind, row = next(iter(found["exponents"])), found["rows"][0]
        cost = f"{micro(row['microseconds']['multiarm'])} µs"
        yield f"One evaluation, {kind}", cost, f"{row['arms']} arms"
        grows = exponent(found["upper_exponents"][kind]["multiarm"])
        yield "Grows with the arms by", f"n^{grows}", "over the larger half"
    if "thesis" in result:
        last = result["thesis"]["rows"][-1]
        ratio = last["columns"]["compiled"]["solving"]
        yield "Node against direct", f"{ratio:.3g} times", f"faster at {last['arms']} arms"
    if "shares" in result:
        costs = result["shares"]["overheads"]
        most = max(costs, key=lambda cost: cost["overhead"])
        yield (
            "Most a step adds",
            f"{100 * most['overhead']:.0f} %",
            f"to its evaluations, {most['integrator']}, {most['arms']} arms",
        )
