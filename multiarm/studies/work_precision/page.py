"""A study as text, as tables, as a figure and as one self-contained HTML page.

The page shows the recommendation; the diagram, for any quantity and any choice of methods; the
cheapest setting of each decade with the best peer's; and all points.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.notation import number
from multiarm.plots.style import GRID, INK, PALETTE, STYLE
from multiarm.reports import pages
from multiarm.reports.pages import scientific
from multiarm.results.files import printable_texts
from multiarm.results.trajectory import plain
from multiarm.studies.tables import TEXT, Cell, Column, Line, Table
from multiarm.studies.work_precision.points import BY_ACCURACY, Point, short
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.results import (
    CLAIMED,
    Decade,
    Results,
    Series,
    all_series,
    cheapest,
    decades,
    digits_of,
    wall_time,
)

FARTHER = 1e-3
"""The second level of the recommendation, as a fraction of the first."""


def texts(results: Results, quantity: str, every: bool = False) -> Iterator[Table | Line]:
    """What the command prints; all points on demand."""
    yield Line(results.about["scene"]["name"], "strong")
    tables = [method_table(results, quantity), *([point_table(results)] if every else [])]
    yield from first_texts(results, quantity, *tables)


def first_texts(results: Results, quantity: str, *tables: Table) -> Iterator[Table | Line]:
    """Reference, decades, further tables, and what follows from them."""
    yield Line(reference_text(results), "pale")
    yield from (decade_table(results, quantity), *tables)
    for solver, reason in results.refusals.items():
        yield Line(f"{solver}: {reason}", "pale")
    if state_text(results):
        yield Line(state_text(results), "pale")
    for sentence in (recommendation(results, quantity), comparison(results, quantity)):
        if sentence:
            yield Line(sentence, "verdict")


def recommendation(results: Results, quantity: str = "motion") -> str:
    """The study in a sentence: what to take, what it costs, and what more would cost."""
    target = results.about["scene"]["accuracy"][quantity]
    found = decades(results, quantity)
    reached = [decade for decade in found if decade.ours is not None]
    if not reached:
        return "No setting reached an error of 0.1: nothing can be recommended for this scene."
    first = _at(reached, target)
    if first is None:
        first = reached[-1]
        apology = f"No setting reached {short(target)}. "
    else:
        apology = ""
    taken = first.ours
    assert taken is not None, "only levels that we reach are looked at"
    duration = results.about["scene"]["duration_s"]
    text = (
        f"{apology}For errors below {short(first.level)}{_of(quantity)} take {described(taken)}: "
        f"{1e3 * wall_time(taken):.3g} ms for {duration:g} s of motion"
    )
    second = _at(reached, FARTHER * first.level) or reached[-1]
    if second.level >= first.level or second.ours is None:
        return f"{text}."
    times = wall_time(second.ours) / wall_time(taken)
    return f"{text}; {short(second.level)} costs {times:.2g} times that."


def comparison(results: Results, quantity: str = "motion") -> str:
    """How the best peer fares at two levels, in a sentence; empty where there is none."""
    parts = [
        f"{decade.ratio:.2g} times our time to reach {short(decade.level)} "
        f"({decade.peer.setting.text})"
        for decade in decades(results, quantity)
        if decade.level in CLAIMED and decade.ratio is not None and decade.peer is not None
    ]
    return f"The best peer takes {', and '.join(parts)}." if parts else ""


def described(point: Point) -> str:
    """A setting as a piece of advice: ``accuracy 1e-5 (dop853, projection)``."""
    setting = point.setting
    if not setting.ours:
        return f"{setting.knob_text} ({setting.solver}, {setting.method})"
    chosen = setting.method == BY_ACCURACY
    kind = "projection" if chosen else setting.stabilization
    about = [point.used if chosen else setting.method]
    if kind:
        about.append("no stabilization" if kind == "none" else kind)
    return f"{setting.knob_text} ({', '.join(about)})"


def reference_text(results: Results) -> str:
    """The reference and its digits, in words."""
    assert results.reference is not None, "a study begins with its reference"
    about, digits = results.reference.about, results.reference.digits
    check, scene = about["check"], results.about["scene"]
    known = ", ".join(
        f"{QUANTITIES[name][0]} {value:.1g} {QUANTITIES[name][1].split(',')[0]}"
        for name, value in digits.items()
        if name != "motion"
    )
    times = f"{scene['duration_s']:g} s, looked at every {scene['output_step_s']:g} s. "
    if results.reference.first:
        return (
            f"{times}First reference: {about['integrator']} at accuracy {about['accuracy']:g}, "
            f"from which accuracy {check['accuracy']:g} differs by: {known}. Errors below that are "
            "not ranked. A checked reference will replace it."
        )
    return (
        f"{times}Reference: {about['integrator']} at {about['tolerance']:g}; checked by the "
        f"{check['solver']} solver with {check['integrator']} at {check['tolerance']:g}, which "
        f"differs by: {known}. Errors below that are not ranked."
    )


def state_text(results: Results) -> str:
    """How far the study is, and what it leaves out; empty when all is measured."""
    if results.planned is not None:
        return f"{len(results.points)} of {results.planned} points measured."
    return "Dominated settings are left out; --thorough measures them." if results.left_out else ""


def figures(results: Results, quantity: str = "motion") -> dict[str, Any]:
    """All figures of a study, under the keys that ``multiarm accuracy --help`` lists."""
    kept = {
        key: value for key, value in results.as_dict().items() if key not in ("format", "planned")
    }
    cheapest = [
        {
            "level": decade.level,
            "ours": None if decade.ours is None else decade.ours.setting.key,
            "peer": None if decade.peer is None else decade.peer.setting.key,
            "peer_over_ours": decade.ratio,
        }
        for decade in decades(results, quantity)
    ]
    advice = recommendation(results, quantity)
    return {**kept, "cheapest": cheapest, "recommendation": advice}


def _at(found: Sequence[Decade], level: float) -> Decade | None:
    """The coarsest decade that is at least as fine as a level."""
    fine = [decade for decade in found if decade.level <= level * (1.0 + 1e-9)]
    return fine[0] if fine else None


def _of(quantity: str) -> str:
    return " N" if quantity == "force" else ""


# --- tables ---------------------------------------------------------------------------------------


LEVELS = (1e-3, *CLAIMED)
"""The errors for which the methods are compared."""
_seconds = partial(number, unit="s")
_count = "{:,}".format


def decade_table(results: Results, quantity: str) -> Table:
    """The cheapest setting for each power of ten, and the best peer's where there is one."""
    what, unit = QUANTITIES[quantity]
    found = decades(results, quantity)
    columns = [
        Column("below", TEXT, short, scientific),
        Column("multiarm", TEXT, described),
        Column("time", write=_seconds),
        Column("evals", write=_count, wide=True),
    ]
    if any(decade.peer for decade in found):
        columns += [
            Column("best peer", TEXT, described),
            Column("time", write=_seconds),
            Column("peer/ours", write="{:.1f}".format),
        ]
    rows = [_decade_row(decade)[: len(columns)] for decade in found]
    return Table(f"Cheapest for an error below, {what} [{unit}]", tuple(columns), tuple(rows))


def _decade_row(decade: Decade) -> tuple[Any, ...]:
    ours, peer = decade.ours, decade.peer
    return (
        decade.level,
        Cell(ours, "strong"),
        ours and ours.wall_time_s,
        ours and ours.evaluations,
        peer,
        peer and peer.wall_time_s,
        decade.ratio,
    )


def method_table(results: Results, quantity: str) -> Table:
    """One line a method: its time for some errors, and what it is at its most precise."""
    digits = digits_of(results, quantity)
    columns = (
        Column("method", TEXT),
        *(Column(short(level), write=_seconds) for level in LEVELS),
        *_errors("least", "gap m", "energy J"),
        Column("failed", about="of its settings"),
    )

    def rows() -> Iterator[tuple[Any, ...]]:
        for item in all_series(results):
            name = Cell(item.name, "" if item.ours else "pale")
            best = item.best(quantity)
            failed = f"{len(item.failures)}/{len(item.points)}"
            if best is None:
                yield name, Cell(item.points[-1].message)
                continue
            found = [cheapest(item.points, level, quantity, digits) for level in LEVELS]
            least = max(best.error(quantity) or 0.0, digits)
            times = (None if point is None else wall_time(point) for point in found)
            yield (name, *times, least, best.gap_m, best.energy_J, failed)

    title = "Methods: wall time to an error, and what they are at their most precise"
    return Table(title, columns, tuple(rows()))


def point_table(results: Results) -> Table:
    """Every point, in the order of the methods."""
    columns = (
        Column("setting", TEXT),
        Column("time", write=_seconds),
        Column("steps", write=_count, wide=True),
        Column("evals", write=_count),
        *_errors("pos.", "rot.", "joints", "force", "gap"),
        *_errors("gap rate", wide=True),
        *_errors("energy"),
    )

    def row(point: Point) -> tuple[Any, ...]:
        if not point.completed:
            return point.setting.text, Cell(f"{point.status}: {point.message}", "bad")
        errors = (point.errors.get(name) for name in ("position", "rotation", "joints", "force"))
        return (
            point.setting.text, point.wall_time_s, point.steps, point.evaluations, *errors,
            point.gap_m, point.gap_rate_m_per_s, point.energy_J,
        )  # fmt: skip

    title = "All points: errors [m, rad, rad, N], gap [m], its rate [m/s], energy [J]"
    points = (point for item in all_series(results) for point in item.points)
    return Table(title, columns, tuple(row(point) for point in points))


def _errors(*heads: str, wide: bool = False) -> Iterator[Column]:
    return (Column(head, write="{:.0e}".format, on_page=scientific, wide=wide) for head in heads)


# --- figure and page ------------------------------------------------------------------------------


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
        "digits": results.reference.digits,
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
