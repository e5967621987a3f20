"""A study of accuracy in words, as tables, as a figure and as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import matplotlib
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.notation import number, short
from multiarm.plots.style import GRID, INK, PALETTE, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.results.outcome import plain
from multiarm.studies.reference import QUANTITIES
from multiarm.studies.settings import BY_ACCURACY, OURS
from multiarm.studies.tables import (
    NUMBER,
    REMARK,
    TEXT,
    Column,
    TextTable,
    attribute,
    text_table,
    written,
)
from multiarm.studies.work_precision import COMPLETED, Study, decades

FARTHER = 1e-3
"""The second level of the recommendation, as a fraction of the first."""
CLAIMED = (1e-6, 1e-9)
"""The levels at which we are compared with the best peer."""
LEAST = 1e-17
"""The least digits that a figure shows [m, rad, N]."""
COMPARED = (1e-3, *CLAIMED)
"""The levels for which the methods are compared."""


# --- words ----------------------------------------------------------------------------------------


def recommendation(study: Study, quantity: str = "motion") -> str:
    """The study in a sentence: what to take, what it costs, and what more would cost."""
    target, duration = study.scene["accuracy"][quantity], study.scene["duration_s"]
    rows = decades(study, quantity).dropna(subset="wall_time_s")
    if rows.empty:
        return "No setting reached an error of 0.1: nothing can be recommended for this scene."
    first, apology = _at(rows, target), ""
    if first is None:
        first, apology = rows.iloc[-1], f"No setting reached {short(target)}. "
    unit = " N" if quantity == "force" else ""
    text = (
        f"{apology}For errors below {short(first.level)}{unit} take {first.advice}: "
        f"{1e3 * first.wall_time_s:.3g} ms for {duration:g} s of motion"
    )
    second = _at(rows, FARTHER * first.level)
    if second is None:
        second = rows.iloc[-1]
    if second.level >= first.level:
        return f"{text}."
    times = second.wall_time_s / first.wall_time_s
    return f"{text}; {short(second.level)} costs {times:.2g} times that."


def _at(rows: pandas.DataFrame, level: float) -> Any:
    """The coarsest decade that is at least as fine as a level; None without any."""
    fine = rows[rows["level"] <= level * (1.0 + 1e-9)]
    return None if fine.empty else fine.iloc[0]


def comparison(study: Study, quantity: str = "motion") -> str:
    """How the best peer fares at two levels, in a sentence; empty where there is none."""
    rows = decades(study, quantity).dropna(subset="peer_over_ours")
    parts = [
        f"{row.peer_over_ours:.2g} times our time to reach {short(row.level)} ({row.text_peer})"
        for row in rows[rows["level"].isin(CLAIMED)].itertuples()
    ]
    return f"The best peer takes {', and '.join(parts)}." if parts else ""


def sentences(study: Study, quantity: str) -> tuple[str, str]:
    """What the study says: the recommendation, and the comparison with peers if there is one."""
    return recommendation(study, quantity), comparison(study, quantity)


def reference_text(study: Study) -> str:
    """The reference and its digits, in words."""
    assert study.reference is not None, "a study begins with its reference"
    about, scene = study.reference.about, study.scene
    check = about["check"]
    known = ", ".join(
        f"{QUANTITIES[name].what} {value:.1g} {QUANTITIES[name].unit}"
        for name, value in study.reference.digits.items()
        if name != "motion"
    )
    times = f"{scene['duration_s']:g} s, looked at every {scene['output_step_s']:g} s. "
    if study.reference.first:
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


def state_text(study: Study) -> str:
    """How far the study is; empty when it is finished."""
    return "" if study.finished else f"{len(study.points)} of {study.planned} points measured."


def figures(study: Study, quantity: str = "motion") -> dict[str, Any]:
    """All figures of a study, under the keys that ``multiarm accuracy --help`` lists."""

    columns = {"level": "level", "key": "ours", "key_peer": "peer"}
    columns["peer_over_ours"] = "peer_over_ours"
    best = decades(study, quantity)[list(columns)].rename(columns=columns).to_dict("records")
    advice = recommendation(study, quantity)
    return {**study.as_dict(), "cheapest": plain(best), "recommendation": advice}


# --- tables ---------------------------------------------------------------------------------------


_seconds, _count, _error = partial(number, unit="s"), "{:,.0f}".format, "{:.0e}".format


def decade_table(study: Study, quantity: str) -> TextTable:
    """The cheapest setting for each power of ten, and the best peer's where there is one."""
    about, rows = QUANTITIES[quantity], decades(study, quantity)
    columns = [
        Column("below", TEXT, attribute("level", short)),
        Column("multiarm", TEXT, attribute("advice")),
        Column("time", NUMBER, attribute("wall_time_s", _seconds)),
        Column("evals", NUMBER, attribute("evaluations", _count)),
    ]
    if rows["key_peer"].notna().any():
        columns += [
            Column("best peer", TEXT, attribute("advice_peer")),
            Column("its time", NUMBER, attribute("wall_time_s_peer", _seconds)),
            Column("peer/ours", NUMBER, attribute("peer_over_ours", "{:.1f}".format)),
        ]
    title = f"Cheapest for an error below, {about.what} [{about.unit}]"
    return text_table(title, rows.itertuples(), columns)


class _MethodRow(NamedTuple):
    """A method: its wall times [s] to some errors, and its most precise point."""

    series: str
    times: Mapping[float, float]  # level -> [s]; NaN where not reached, as below
    least: float
    gap_m: float
    energy_J: float
    failed: str
    message: str


def method_table(study: Study, quantity: str) -> TextTable:
    """One line a method: its time for some errors, and what it is at its most precise."""
    digits, points = study.digits(quantity), study.table
    rows = []
    for series, group in points.groupby("series", sort=False):
        errors = group[quantity]
        finest = group.loc[[errors.idxmin()]] if errors.notna().any() else group[:0]
        rows.append(
            _MethodRow(
                series=str(series),
                times={
                    level: group["wall_time_s"][errors + digits <= level].min()
                    for level in COMPARED
                },
                least=max(errors.min(), digits),
                gap_m=finest["gap_m"].min(),
                energy_J=finest["energy_J"].min(),
                failed=f"{(group['status'] != COMPLETED).sum()} of {len(group)}",
                message=group["message"].iloc[-1] if finest.empty else "",
            )
        )

    def time_to(level: float) -> Column:
        return Column(short(level), NUMBER, lambda row: written(row.times[level], _seconds))

    columns = [
        Column("method", TEXT, attribute("series")),
        *map(time_to, COMPARED),
        Column("least", NUMBER, attribute("least", _error)),
        Column("gap m", NUMBER, attribute("gap_m", _error)),
        Column("energy J", NUMBER, attribute("energy_J", _error)),
        Column("failed", NUMBER, attribute("failed")),
        Column("", REMARK, attribute("message")),
    ]
    title = "Methods: wall time to an error, and what they are at their most precise"
    return text_table(title, rows, columns)


def point_table(study: Study) -> TextTable:
    """Every point, in the order of the methods."""
    columns = [
        Column("setting", TEXT, attribute("text")),
        Column("time", NUMBER, attribute("wall_time_s", _seconds)),
        Column("steps", NUMBER, attribute("steps", _count)),
        Column("evals", NUMBER, attribute("evaluations", _count)),
        Column("pos.", NUMBER, attribute("position", _error)),
        Column("rot.", NUMBER, attribute("rotation", _error)),
        Column("joints", NUMBER, attribute("joints", _error)),
        Column("force", NUMBER, attribute("force", _error)),
        Column("gap", NUMBER, attribute("gap_m", _error)),
        Column("gap rate", NUMBER, attribute("gap_rate_m_per_s", _error)),
        Column("energy", NUMBER, attribute("energy_J", _error)),
        Column("", REMARK, lambda row: f"{row.status}: {row.message}" if row.message else ""),
    ]
    title = "All points: errors [m, rad, rad or m, N], gap [m], its rate [m/s], energy [J]"
    return text_table(title, study.table.itertuples(), columns)


# --- figure and page ------------------------------------------------------------------------------


# A method has a colour, a peer's method a marker; dashes show the stabilisation.
_DASHES: dict[str, Any] = {
    "projection": "-",
    "feedback": (0, (6, 3)),
    "none": (0, (1.5, 3)),
    "": "-",
}
_PEER_DASHES, _PEER_MARKERS = (0, (8, 3, 2, 3)), "^Ds"
_BEST: dict[str, Any] = {"marker": "o", "markersize": 10, "markerfacecolor": "none", "color": INK}


def figure(study: Study, quantity: str = "motion", with_title: bool = True) -> Figure:
    """Error over wall time and over evaluations; the cheapest of each decade is circled."""
    # where two runs agree to the last digit: a logarithmic axis has no zero
    digits, points = max(study.digits(quantity), LEAST), study.table
    points = points[points[quantity].notna()]
    best = set(decades(study, quantity)["key"].dropna())
    about = QUANTITIES[quantity]
    with matplotlib.rc_context(STYLE):
        drawing = Figure(figsize=(13.0, 6.2), layout="constrained")
        axes = drawing.subplots(1, 2, sharey=True)
        for panel, work in zip(axes, ("wall_time_s", "evaluations"), strict=True):
            _draw(panel, points, points[quantity].clip(lower=digits), work, best)
            panel.axhspan(digits / 10.0, digits, color=GRID, alpha=0.6, linewidth=0)
        axes[0].set(title="Error over wall time", xlabel="wall time [s]")
        axes[1].set(title="Error over evaluations", xlabel="evaluations")
        axes[0].set(
            ylabel=f"largest error: {about.what} [{about.unit}]", ylim=(digits / 10.0, None)
        )
        handles, labels = axes[0].get_legend_handles_labels()
        handles.append(Line2D([], [], linewidth=0, **_BEST))
        labels.append("cheapest of a decade")
        drawing.legend(handles, labels, loc="outside right center", frameon=False, fontsize=8)
        if with_title:
            drawing.suptitle(study.scene["name"], fontsize=12, color=INK, parse_math=False)
    return drawing


def _draw(
    axes: Axes, points: pandas.DataFrame, errors: pandas.Series, work: str, best: set[str]
) -> None:
    """A line for each method, ``best`` (keys of settings) circled."""
    families: dict[str, int] = {}  # methods of ours, and peers, with how many lines they have
    for series, group in points.groupby("series", sort=False):
        setting = group["setting"].iloc[0]
        ours = setting.solver == OURS
        family = setting.method if ours else setting.solver
        lines = families.setdefault(family, 0)
        families[family] += 1
        axes.plot(
            group[work], errors[group.index], label=series, markersize=3.5,
            color=PALETTE[list(families).index(family) % len(PALETTE)],
            marker="o" if ours else _PEER_MARKERS[lines % len(_PEER_MARKERS)],
            linestyle=_DASHES[setting.stabilization] if ours else _PEER_DASHES,
            linewidth=2.4 if setting.method == BY_ACCURACY else 1.3,
        )  # fmt: skip
    circled = points[points["key"].isin(best)]
    axes.plot(circled[work], errors[circled.index], linewidth=0, zorder=5, **_BEST)
    axes.set(xscale="log", yscale="log", axisbelow=True)


def render(study: Study, quantity: str = "motion") -> str:
    """The page as text: one quantity, and the others of a finished study folded away."""
    names = [quantity, *(name for name in QUANTITIES if study.finished and name != quantity)]
    return pages.render(
        "accuracy.html",
        study=study,
        reference=reference_text(study),
        state=state_text(study),
        quantities=[
            {
                "what": f"{QUANTITIES[name].what} [{QUANTITIES[name].unit}]",
                "sentences": sentences(study, name),
                "figure": inline_svg(figure(study, name, with_title=False), f"{name}-"),
                "decades": decade_table(study, name),
                "methods": method_table(study, name),
            }
            for name in names
        ],
        points=point_table(study),
    )
