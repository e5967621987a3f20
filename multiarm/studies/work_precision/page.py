"""The study as a figure and as one self-contained HTML page.

The page shows the recommendation; the diagram, for any quantity and any choice of methods; the
cheapest setting of each decade with the best peer's; and all points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multiarm.plots import GRID, INK, STYLE
from multiarm.reports import pages
from multiarm.results.files import printable_texts, save_figure, save_page
from multiarm.results.trajectory import plain
from multiarm.studies.work_precision.choice import Series, all_series, decades, digits_of
from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.settings import BY_ACCURACY
from multiarm.studies.work_precision.store import Results
from multiarm.studies.work_precision.words import described, recommendation, reference_text

PALETTE = (
    "#3b7dd8", "#d1495b", "#2f9e67", "#d9822b", "#8a5cc2", "#0f9aa8", "#c2417c", "#8c7a2b",
    "#5a6b7d", "#a0522d", "#5fa8d3", "#93b83a",
)  # fmt: skip
"""A colour for each method; dashes show the stabilisation."""
DASHES = {"projection": "", "feedback": "6 3", "none": "1.5 3", "": ""}
PEER_DASHES, PEER_MARKERS = "8 3 2 3", "^Ds"


class Looks(NamedTuple):
    """Series -> colour, and series -> marker."""

    colours: dict[str, str]
    markers: dict[str, str]


def is_main(item: Series) -> bool:
    """Whether it is what a user gets who names an accuracy only."""
    return item.ours and item.points[0].setting.method == BY_ACCURACY


def colour_of(series: Sequence[Series]) -> dict[str, str]:
    """Series -> colour: one for a method of ours, one for a peer."""
    names = list(dict.fromkeys(_family(item) for item in series))
    colours = {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(names)}
    return {item.name: colours[_family(item)] for item in series}


def markers_of(series: Sequence[Series]) -> dict[str, str]:
    """Series -> marker: circles are ours, each method of a peer has another one."""
    seen: dict[str, int] = {}
    markers = {}
    for item in series:
        number = seen.setdefault(_family(item), 0)
        seen[_family(item)] += 1
        markers[item.name] = "o" if item.ours else PEER_MARKERS[number % len(PEER_MARKERS)]
    return markers


def dashes_of(item: Series) -> str:
    """The dashes of a series' line, as SVG writes them."""
    setting = item.points[0].setting
    return DASHES.get(setting.stabilization, "") if setting.ours else PEER_DASHES


def _family(item: Series) -> str:
    setting = item.points[0].setting
    return setting.method if setting.ours else setting.solver


def diagram(results: Results, quantity: str = "motion") -> Figure:
    """Error over wall time and over evaluations; the cheapest of each decade is circled."""
    series = all_series(results)
    looks = Looks(colour_of(series), markers_of(series))
    digits = digits_of(results, quantity)
    best = {decade.ours.setting.key for decade in decades(results, quantity) if decade.ours}
    what, unit = QUANTITIES[quantity]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.0, 6.2), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, work in ((left, "wall_time_s"), (right, "evaluations")):
            for item in series:
                _draw(axes, item, looks, work, quantity, digits, best)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.axhspan(digits / 10.0, digits, color=GRID, alpha=0.6, linewidth=0)
            axes.set_axisbelow(True)
        left.set_ylim(bottom=digits / 10.0)
        left.set_xlabel("wall time [s]")
        right.set_xlabel("evaluations")
        left.set_ylabel(f"largest error: {what} [{unit}]")
        left.set_title("Error over wall time", parse_math=False)
        right.set_title("Error over evaluations", parse_math=False)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", frameon=False, fontsize=8)
        figure.suptitle(results.about["scene"]["name"], fontsize=12, color=INK, parse_math=False)
    return figure


def write_plot(results: Results, path: Path, quantity: str = "motion") -> None:
    """Draw the diagram to a file; its ending is the format."""
    save_figure(diagram(results, quantity), path)


def _draw(
    axes: Axes,
    item: Series,
    looks: Looks,
    work: str,
    quantity: str,
    digits: float,
    best: set[str],
) -> None:
    places = [(point, _place(point, work, quantity, digits)) for point in item.points]
    shown = [(point, place) for point, place in places if place is not None]
    if not shown:
        return
    x, y = zip(*(place for _, place in shown), strict=True)
    dashes = [float(part) for part in dashes_of(item).split()]
    style = (0, tuple(dashes)) if dashes else "solid"
    axes.plot(
        x, y, color=looks.colours[item.name], marker=looks.markers[item.name], markersize=3.5,
        linestyle=style, linewidth=2.4 if is_main(item) else 1.3, label=item.name,
    )  # fmt: skip
    for point, place in shown:
        if point.setting.key in best:
            axes.plot(*place, "o", markersize=10, markerfacecolor="none", color=INK, zorder=5)


def _place(point: Point, work: str, quantity: str, digits: float) -> tuple[float, float] | None:
    error, cost = point.error(quantity), getattr(point, work)
    if not point.completed or error is None or not cost:
        return None
    return cost, max(error, digits)


def write_page(results: Results, path: Path) -> None:
    """Write the page, complete or not at all.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    save_page(render(results), path)


def render(results: Results) -> str:
    """The page as text."""
    series = all_series(results)
    return pages.render(
        "accuracy.html",
        results=results,
        series=series,
        quantities=QUANTITIES,
        recommendations={name: recommendation(results, name) for name in QUANTITIES},
        reference=reference_text(results),
        decades={name: decades(results, name) for name in QUANTITIES},
        described=described,
        data=printable_texts(plain(_data(results, series))),
    )


def _data(results: Results, series: list[Series]) -> dict[str, Any]:
    """What the script draws from."""
    assert results.reference is not None, "a study begins with its reference"
    best: dict[str, dict[str, list[int]]] = {}
    for name in QUANTITIES:
        best[name] = {}
        for decade in decades(results, name):
            if decade.ours is not None:
                levels = best[name].setdefault(decade.ours.setting.key, [])
                levels.append(round(math.log10(decade.level)))
    colours, markers = colour_of(series), markers_of(series)
    return {
        "quantities": QUANTITIES,
        "digits": results.reference["digits"],
        "best": best,
        "series": [
            {
                "name": item.name,
                "ours": item.ours,
                "main": is_main(item),
                "colour": colours[item.name],
                "dashes": dashes_of(item),
                "marker": markers[item.name],
                "points": [_point_data(point) for point in item.points if point.completed],
            }
            for item in series
        ],
    }


def _point_data(point: Point) -> dict[str, Any]:
    return {
        "key": point.setting.key,
        "knob": point.setting.knob_text,
        "errors": {name: point.error(name) for name in QUANTITIES},
        "wall_time_s": point.wall_time_s,
        "evaluations": point.evaluations,
        "steps": point.steps,
        "gap_m": point.gap_m,
        "energy_J": point.energy_J,
    }
