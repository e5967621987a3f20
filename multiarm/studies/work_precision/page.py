"""The study as a figure and as one self-contained HTML page.

The page shows the recommendation; the diagram, for any quantity and any choice of methods; the
cheapest setting of each decade with the best peer's; and all points.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multiarm.plots import GRID, INK, STYLE
from multiarm.reports.parts import CSS, NOTHING, quantity
from multiarm.results.files import printable_texts, save_figure, save_page
from multiarm.results.trajectory import plain
from multiarm.studies.hard_case_page import scientific
from multiarm.studies.work_precision.choice import Decade, Series, all_series, decades, digits_of
from multiarm.studies.work_precision.page_script import CSS as PAGE_CSS
from multiarm.studies.work_precision.page_script import SCRIPT
from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.settings import BY_ACCURACY
from multiarm.studies.work_precision.store import Results
from multiarm.studies.work_precision.words import (
    described,
    recommendation,
    reference_text,
    state_text,
)

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
    name = results.about["scene"]["name"]
    series = all_series(results)
    data = json.dumps(
        printable_texts(plain(_data(results, series))), ensure_ascii=False, allow_nan=False
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(name)} · multiarm accuracy</title>\n<style>{CSS}{PAGE_CSS}</style>\n"
        f"</head>\n<body>\n<main>\n{_header(results)}{_diagram()}{_cheapest(results)}"
        f"{_methods(series)}{_points(series)}{_refusals(results.refusals)}{_scene(results)}"
        f"{_footer(results)}</main>\n<div id='tip' role='status'></div>\n"
        f'<script type="application/json" id="data">{data.replace("<", _LESS)}</script>\n'
        f"<script>{SCRIPT}</script>\n</body>\n</html>\n"
    )


_LESS = "\\u003c"


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


def _header(results: Results) -> str:
    scene, machine = results.about["scene"], results.about["machine"]
    advice = "".join(
        f"<p class='said' data-quantity='{name}'>{_whole(recommendation(results, name))}</p>"
        for name in QUANTITIES
    )
    libraries = ", ".join(f"{key} {value}" for key, value in machine["dependencies"].items())
    return (
        "<header><p class='kicker'>multiarm · what accuracy costs in time</p>"
        f"<h1>{escape(scene['name'])}</h1>{advice}"
        f"<p class='message'>{_whole(reference_text(results))}\n{_state(results)}"
        f"{escape(str(machine['processor']))}, {escape(str(machine['platform']))}\n"
        f"multiarm {escape(machine['version'])}, Python {escape(machine['python'])}, "
        f"{escape(libraries)}</p></header>\n"
    )


def _state(results: Results) -> str:
    """How far the study is, as a line of its own."""
    text = state_text(results)
    return f"{escape(text)}\n" if text else ""


def _whole(text: str) -> str:
    """Escaped, with hyphens in numbers at which no line is broken."""
    return re.sub(r"(?<=\de)-(?=\d)", "\N{NON-BREAKING HYPHEN}", escape(text))


def _diagram() -> str:
    options = "".join(
        f"<option value='{name}'>{escape(what)} [{escape(unit)}]</option>"
        for name, (what, unit) in QUANTITIES.items()
    )
    return (
        "<section><div class='bar'><h2>Error over work</h2>"
        f"<label>error of <select id='quantity'>{options}</select></label>"
        "<button type='button' data-show='all'>all</button>"
        "<button type='button' data-show='ours'>ours</button>"
        "<button type='button' data-show='peers'>peers</button></div>"
        "<div class='panels'><figure id='over-time'><figcaption>Over wall time</figcaption>"
        "</figure><figure id='over-evaluations'><figcaption>Over evaluations</figcaption></figure>"
        "</div><div class='legend'></div>"
        "<figcaption>Circled: the cheapest setting of ours for a decade of accuracy. Point at a "
        "mark for its values; a click in the legend hides a method.</figcaption></section>\n"
    )


def _cheapest(results: Results) -> str:
    tables = "".join(
        f"<div data-quantity='{name}'>{_cheapest_table(decades(results, name), unit)}</div>"
        for name, (_, unit) in QUANTITIES.items()
    )
    return f"<section class='scroll'><h2>Cheapest for each accuracy</h2>{tables}</section>\n"


def _cheapest_table(found: Iterable[Decade], unit: str) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{scientific(decade.level)}</th>"
        f"{_choice(decade.ours, True)}{_choice(decade.peer, False)}"
        f"<td class='n'>{NOTHING if decade.ratio is None else f'{decade.ratio:.1f}'}</td></tr>"
        for decade in found
    )
    return (
        f"<table class='decades'><thead><tr><th>error below [{escape(unit)}]</th><th>multiarm</th>"
        "<th class='n'>wall time</th><th class='n'>evaluations</th><th>best peer</th>"
        "<th class='n'>wall time</th>"
        f"<th class='n'>peer / ours</th></tr></thead><tbody>{rows}</tbody></table>"
    )


def _choice(point: Point | None, ours: bool) -> str:
    if point is None:
        return f"<td class='t'>{NOTHING}</td>" + f"<td class='n'>{NOTHING}</td>" * (
            2 if ours else 1
        )
    text = escape(described(point))
    name = f"<td class='t'>{f'<strong>{text}</strong>' if ours else text}</td>"
    count = f"<td class='n'>{point.evaluations:,}</td>" if ours else ""
    return f"{name}<td class='n'>{quantity(point.wall_time_s, 's')}</td>{count}"


def _methods(series: list[Series]) -> str:
    rows = "".join(_method(item) for item in series)
    return (
        "<section class='scroll'><h2>Methods</h2><table><thead><tr><th>method</th>"
        "<th class='n'>settings</th><th class='n'>failed</th><th class='n'>least error</th>"
        "<th class='n'>its wall time</th><th class='n'>largest gap [m]</th>"
        "<th class='n'>energy error [J]</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></section>\n"
    )


def _method(item: Series) -> str:
    best = item.best("motion")
    if best is None:
        return (
            f"<tr><th scope='row'>{escape(item.name)}</th><td class='n'>{len(item.points)}</td>"
            f"<td class='n'>{len(item.failures)}</td><td class='e' colspan='4'>"
            f"{escape(item.points[-1].message)}</td></tr>"
        )
    return (
        f"<tr><th scope='row'>{escape(item.name)}</th><td class='n'>{len(item.points)}</td>"
        f"<td class='n'>{len(item.failures)}</td><td class='n'>{scientific(best.error('motion'))}"
        f"</td><td class='n'>{quantity(best.wall_time_s, 's')}</td>"
        f"<td class='n'>{scientific(best.gap_m)}</td><td class='n'>{scientific(best.energy_J)}"
        "</td></tr>"
    )


def _points(series: list[Series]) -> str:
    heads = (
        "setting", "wall time", "steps", "evaluations", "position [m]", "rotation [rad]", "joints",
        "force [N]", "gap [m]", "gap rate [m/s]", "energy [J]",
    )  # fmt: skip
    head = "".join(f"<th{'' if k == 0 else _RIGHT}>{text}</th>" for k, text in enumerate(heads))
    rows = "".join(_point(point, len(heads)) for item in series for point in item.points)
    count = sum(len(item.points) for item in series)
    return (
        f"<section class='scroll'><details><summary>All {count} points</summary><table>"
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></details></section>\n"
    )


_RIGHT = " class='n'"


def _point(point: Point, width: int) -> str:
    head = f"<tr><th scope='row'>{escape(point.setting.text)}</th>"
    if not point.completed:
        text = f"{point.status}: {point.message}"
        return f"{head}<td class='e bad' colspan='{width - 1}'>{escape(text)}</td></tr>"
    numbers = [point.errors.get(name) for name in ("position", "rotation", "joints", "force")]
    numbers += [point.gap_m, point.gap_rate_m_per_s, point.energy_J]
    cells = "".join(f"<td class='n'>{scientific(value)}</td>" for value in numbers)
    return (
        f"{head}<td class='n'>{quantity(point.wall_time_s, 's')}</td>"
        f"<td class='n'>{point.steps:,}</td><td class='n'>{point.evaluations:,}</td>{cells}</tr>"
    )


def _refusals(refusals: dict[str, str]) -> str:
    if not refusals:
        return ""
    rows = "".join(
        f"<tr><th scope='row'>{escape(name)}</th><td class='e'>{escape(reason)}</td></tr>"
        for name, reason in refusals.items()
    )
    return f"<section><h2>Not in the diagram</h2><table>{rows}</table></section>\n"


def _scene(results: Results) -> str:
    text = results.about["scene"]["text"]
    return (
        "<section><details><summary>The scene</summary>"
        f"<pre>{escape(text)}</pre></details></section>\n"
    )


def _footer(results: Results) -> str:
    when = escape(str(results.about["machine"]["created_utc"]))
    return (
        "<footer><h2>How to read it</h2><p>An error is the largest at an output time. Wall time "
        "is that of the fastest of several interleaved runs, one thread, from the first step to "
        "the last output, with everything compiled and built beforehand. A feedback controller "
        "that peers call back is ours, and off their clock. MuJoCo and Drake step; their steps "
        "divide the time between two outputs. Pinocchio's constraintDynamics is integrated in "
        "Python, the object hanging on one arm. <em>Gap</em> is how far the joints come apart."
        f"</p><p>Made {when}.</p></footer>\n"
    )
