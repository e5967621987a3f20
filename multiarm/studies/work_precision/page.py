"""The study as a figure and as one self-contained HTML page.

The page shows the recommendation; the diagram, for any quantity and any choice of methods; the
cheapest setting of each decade with the best peer's; and all points.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.plots.style import GRID, INK, PALETTE, STYLE
from multiarm.reports import pages
from multiarm.results.files import printable_texts
from multiarm.results.trajectory import plain
from multiarm.studies.work_precision.choice import Series, all_series, decades, digits_of
from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.settings import BY_ACCURACY
from multiarm.studies.work_precision.store import Results
from multiarm.studies.work_precision.tables import decade_table, method_table, point_table
from multiarm.studies.work_precision.words import (
    comparison,
    recommendation,
    reference_text,
    state_text,
)

# A method has a colour; dashes show the stabilisation.
_DASHES = {"projection": "", "feedback": "6 3", "none": "1.5 3", "": ""}
_PEER_DASHES, _PEER_MARKERS = "8 3 2 3", "^Ds"


_BEST: dict[str, Any] = {"marker": "o", "markersize": 10, "markerfacecolor": "none", "color": INK}


class Look(NamedTuple):
    """How a series is drawn; dashes are as SVG writes them.

    ``main`` is what a user gets who names an accuracy only.
    """

    colour: str
    marker: str
    dashes: str
    main: bool


def looks_of(series: Sequence[Series]) -> dict[str, Look]:
    """Series -> look: a colour for a method of ours or a peer, a marker for a peer's method."""
    seen: Counter[str] = Counter()
    looks = {}
    for item in series:
        setting = item.points[0].setting
        family = setting.method if item.ours else setting.solver
        marker = "o" if item.ours else _PEER_MARKERS[seen[family] % len(_PEER_MARKERS)]
        seen[family] += 1
        colour = PALETTE[list(seen).index(family) % len(PALETTE)]
        dashes = _DASHES.get(setting.stabilization, "") if item.ours else _PEER_DASHES
        main = item.ours and setting.method == BY_ACCURACY
        looks[item.name] = Look(colour, marker, dashes, main)
    return looks


def figure(results: Results, quantity: str = "motion") -> Figure:
    """Error over wall time and over evaluations; the cheapest of each decade is circled."""
    series = all_series(results)
    looks = looks_of(series)
    digits = digits_of(results, quantity)
    best = {decade.ours.setting.key for decade in decades(results, quantity) if decade.ours}
    what, unit = QUANTITIES[quantity]
    with matplotlib.rc_context(STYLE):
        drawn = Figure(figsize=(13.0, 6.2), layout="constrained")
        left, right = drawn.subplots(1, 2, sharey=True)
        for axes, work, name in (
            (left, "wall_time_s", "wall time"),
            (right, "evaluations", "evaluations"),
        ):
            for item in series:
                places = {
                    point.setting.key: place
                    for point in item.points
                    if (place := _place(point, work, quantity, digits)) is not None
                }
                _draw(axes, item.name, looks[item.name], places, best)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.axhspan(digits / 10.0, digits, color=GRID, alpha=0.6, linewidth=0)
            axes.set_axisbelow(True)
            axes.set_title(f"Error over {name}", parse_math=False)
        left.set_ylim(bottom=digits / 10.0)
        left.set_xlabel("wall time [s]")
        right.set_xlabel("evaluations")
        left.set_ylabel(f"largest error: {what} [{unit}]")
        handles, labels = left.get_legend_handles_labels()
        handles.append(Line2D([], [], linewidth=0, **_BEST))
        labels.append("cheapest of a decade")
        drawn.legend(handles, labels, loc="outside right center", frameon=False, fontsize=8)
        drawn.suptitle(results.about["scene"]["name"], fontsize=12, color=INK, parse_math=False)
    return drawn


def _draw(
    axes: Axes, name: str, look: Look, places: dict[str, tuple[float, float]], best: set[str]
) -> None:
    """Draw a series; ``places`` and ``best`` are by the keys of settings."""
    if not places:
        return
    dashes = tuple(float(part) for part in look.dashes.split())
    axes.plot(
        *zip(*places.values(), strict=True), color=look.colour, marker=look.marker, markersize=3.5,
        linestyle=(0, dashes) if dashes else "solid", linewidth=2.4 if look.main else 1.3,
        label=name,
    )  # fmt: skip
    for place in (places[key] for key in places if key in best):
        axes.plot(*place, zorder=5, **_BEST)


def _place(point: Point, work: str, quantity: str, digits: float) -> tuple[float, float] | None:
    error, cost = point.error(quantity), getattr(point, work)
    if not point.completed or error is None or not cost:
        return None
    return cost, max(error, digits)


def render(results: Results, quantity: str = "motion") -> str:
    """The page as text; it shows errors of a quantity first."""
    series = all_series(results)
    return pages.render(
        "accuracy.html",
        results=results,
        quantities=QUANTITIES,
        quantity=quantity,
        sentences={
            name: [recommendation(results, name), *filter(None, [comparison(results, name)])]
            for name in QUANTITIES
        },
        reference=reference_text(results),
        state=state_text(results),
        decades={name: decade_table(results, name) for name in QUANTITIES},
        methods={name: method_table(results, name) for name in QUANTITIES},
        points=point_table(results),
        data=printable_texts(plain({**_data(results, series), "quantity": quantity})),
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
    looks = looks_of(series)
    return {
        "quantities": QUANTITIES,
        "digits": results.reference["digits"],
        "best": best,
        "series": [
            {
                "name": item.name,
                "ours": item.ours,
                **looks[item.name]._asdict(),
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
