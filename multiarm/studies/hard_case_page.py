"""The hard cases as one self-contained HTML page: criteria, results, time series, other programs.

The page shows how many cases are within their criteria and on which machine; an overview of the
cases; then a card a case with its criteria, four panels over time (loops, energy, residual, rank),
its events and the peers' answers.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from textwrap import shorten
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from multiarm.plots import INK, STYLE
from multiarm.reports.parts import CSS
from multiarm.reports.report import inline_svg, quantity
from multiarm.results.files import save_page
from multiarm.studies.hard_cases import (
    CaseResult,
    CriterionResult,
    SuiteResult,
    path_text,
    rank_text,
)
from multiarm.studies.peer_trials import OURS, Answer

DECADES = 6
"""Values further below the peak are drawn at this depth: 0 has no place on a logarithmic axis."""
SMALLEST = 1e-18
_BLUE, _GREEN, _PINK, _ORANGE = "#3b7dd8", "#2f9e67", "#c2417c", "#d9822b"
# Titles of panels -> series with colour and name, and the criterion whose bound is drawn.
_LOGARITHMIC = {
    "Loops: gaps [m] and their rates [m/s]": (
        (("gap", _BLUE, "gap"), ("gap_rate", _GREEN, "rate")),
        "position drift",
    ),
    "Energy balance [J]": ((("energy_balance", _PINK, ""),), ""),
    "Constraint residual, relative": ((("residual", _BLUE, ""),), "residual"),
}
_COUNTS = "Rank, and arms in the coupled system"


def case_figure(case: CaseResult) -> Figure | None:
    """Panels over time, events as dotted lines; None when nothing was recorded."""
    if not case.history:
        return None
    history = {key: np.array(values, dtype=float) for key, values in case.history.items()}
    panels = [
        (title, tuple(line for line in lines if line[0] in history), bound)
        for title, (lines, bound) in _LOGARITHMIC.items()
    ]
    bounds = {item.quantity: item.bound for item in case.criteria if item.bound > 0}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.9))
        figure.patch.set_alpha(0)
        figure.subplots_adjust(
            left=0.065, right=0.985, bottom=0.11, top=0.93, hspace=0.46, wspace=0.16
        )
        grid = figure.subplots(2, 2, sharex=True).ravel()
        for axes, (title, lines, bound) in zip(grid, panels, strict=False):
            _draw_logarithmic(axes, history, lines, bounds.get(bound))
            _finish(axes, title, case.events)
        _draw_counts(grid[3], history)
        _finish(grid[3], _COUNTS, case.events)
        for axes in grid[2:]:
            axes.set_xlabel("time [s]")
    return figure


def _draw_logarithmic(
    axes: Axes,
    history: dict[str, np.ndarray],
    lines: Sequence[tuple[str, str, str]],
    bound: float | None,
) -> None:
    if not lines:
        _say_nothing(axes)
        return
    peaks = [np.nanmax(np.abs(history[key]), initial=0.0) for key, _, _ in lines]
    peak = max(*peaks, SMALLEST)
    floor = max(SMALLEST, peak * 10.0**-DECADES)
    for key, colour, name in lines:
        values = np.maximum(np.abs(history[key]), floor)
        axes.plot(history["time"], values, color=colour, label=name)
    top = peak
    if bound is not None:
        axes.axhline(bound, color=INK, linewidth=0.9, dashes=(5, 3), label="bound of the gap")
        top = max(peak, bound)
    axes.set_yscale("log")
    # room for the legend above the lines
    axes.set_ylim(floor / 2, top * (500 if len(lines) > 1 else 5))
    axes.minorticks_off()
    if len(lines) > 1:
        _legend(axes)


def _draw_counts(axes: Axes, history: dict[str, np.ndarray]) -> None:
    if "rank" not in history:
        _say_nothing(axes)
        return
    time, rank, coupled = history["time"], history["rank"], history["coupled_arms"]
    axes.plot(time, rank, color=_ORANGE, label="rank", drawstyle="steps-post")
    axes.plot(time, coupled, color=_BLUE, label="arms coupled", drawstyle="steps-post")
    axes.set_ylim(-0.5, max(1.0, np.nanmax(rank)) * 1.35)
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    _legend(axes)


def _say_nothing(axes: Axes) -> None:
    axes.text(0.5, 0.5, "not recorded", transform=axes.transAxes, ha="center")


def _legend(axes: Axes) -> None:
    axes.legend(loc="upper right", ncols=3, fontsize=8, frameon=False, borderpad=0.1)


def _finish(axes: Axes, title: str, events: Sequence[dict]) -> None:
    axes.set_title(title, parse_math=False)
    axes.set_axisbelow(True)
    axes.margins(x=0)
    for event in events[:50]:
        if "time" in event:
            axes.axvline(event["time"], color=INK, linewidth=0.6, linestyle=":")


SHOWN_EVENTS = 12
NOTHING = "\N{EN DASH}"
# Relative errors of accelerations above these are shown in yellow and in red.
DOUBTFUL, WRONG = 1e-6, 1e-2

_CSS = """
header.mixed { --tone: var(--bad); }
td, th { padding-right: 1.2rem; }
td:last-child, th:last-child { padding-right: 0; }
thead th { font-size: 0.8rem; font-weight: 500; vertical-align: bottom; }
thead th.n, td.n { text-align: right; white-space: nowrap; }
td.t, td.e, td.w { text-align: left; }
td.w { white-space: nowrap; }
td.e { color: var(--soft); font-size: 0.85rem; }
td.good { color: var(--good); } td.warn { color: var(--warn); }
td.bad, p.bad { color: var(--bad); }
sup { font-size: 0.72em; line-height: 0; }
.glance a { color: inherit; text-decoration: none; font-weight: 600; }
.glance a:hover { text-decoration: underline; }
.glance td:first-child { min-width: 15rem; }
.glance td small { display: block; color: var(--soft); font-size: 0.85rem; }
.pill {
  display: inline-block; padding: 0.05rem 0.6rem; border-radius: 99px; font-size: 0.8rem;
  font-weight: 600; white-space: nowrap; border: 1px solid currentColor;
}
.pill.pass { color: var(--good); } .pill.fail { color: var(--bad); }
.case > h2 { display: flex; align-items: center; gap: 0.8rem; font-size: 1.2rem; margin: 0; }
.case > h2 code {
  margin-left: auto; white-space: nowrap; font: 0.8rem var(--mono); color: var(--soft);
}
.case h3 { margin: 1.5rem 0 0.3rem; font-size: 0.9rem; }
.difficulty { margin: 0.5rem 0 1rem; max-width: 50rem; }
.run { margin: 0.9rem 0 0; font-size: 0.85rem; color: var(--soft); }
.meter {
  display: inline-block; width: 7rem; height: 0.45rem; border-radius: 99px; background: var(--line);
  overflow: hidden; vertical-align: middle;
}
.meter i { display: block; height: 100%; background: var(--good); border-radius: 99px; }
.meter.over i { background: var(--bad); }
.case figure { margin-top: 1.2rem; }
tr.ours > * { font-weight: 600; color: var(--ink); }
"""
_METER_DECADES = 6


def write_page(suite: SuiteResult, path: str | os.PathLike) -> Path:
    """Write the page.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    target = Path(path).expanduser()
    save_page(render(suite), target)
    return target


def render(suite: SuiteResult) -> str:
    """The page as text."""
    cards = "".join(_case(case, number) for number, case in enumerate(suite.cases))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>multiarm · hard cases</title>\n<style>{CSS}{_CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{_header(suite)}{_glance(suite.cases)}{cards}{_footer(suite)}"
        "</main>\n</body>\n</html>\n"
    )


def scientific(value: float | None) -> str:
    """A number of two or three digits, powers of ten as such: ``2.3 x 10^-14`` in HTML."""
    if value is None:
        return NOTHING
    if value == 0 or 1e-2 <= abs(value) < 1e4:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    power = f"10<sup>{int(exponent)}</sup>".replace("-", "\N{MINUS SIGN}")
    mantissa = mantissa.removesuffix(".0")
    return power if mantissa == "1" else f"{mantissa}\N{MULTIPLICATION SIGN}{power}"


def _header(suite: SuiteResult) -> str:
    total, passed = len(suite.cases), suite.passed
    tone = "" if passed == total else " class='mixed'"
    about = suite.machine
    libraries = ", ".join(f"{name} {version}" for name, version in about["dependencies"].items())
    run = sum(case.wall_time_s for case in suite.cases)
    cores = f"{escape(str(about['processor']))}, {escape(str(about['platform']))}"
    return (
        f"<header{tone}><p class='kicker'>multiarm · systems on which solvers break</p>"
        f"<h1>Hard cases</h1><p class='status'><span>{passed} of {total} within their criteria"
        f"</span></p><p class='message'>{total} systems, simulated in {quantity(run, 's')}; with "
        f"compilation and peers {quantity(suite.wall_time_s, 's')}.\n{cores}\n"
        f"multiarm {escape(about['version'])}, Python {escape(about['python'])}, "
        f"{escape(libraries)}</p></header>\n"
    )


def _glance(cases: Iterable[CaseResult]) -> str:
    rows = "".join(
        f"<tr><td class='t'><a href='#{escape(case.name)}'>{escape(case.title)}</a>"
        f"<small>{escape(case.name)}</small></td><td class='w'>{_pill(case)}</td>"
        f"<td class='t'>{_nearest(case)}</td><td class='w'>{escape(rank_text(case))}</td>"
        f"<td class='w'>{escape(path_text(case))}</td>"
        f"<td class='n'>{quantity(case.wall_time_s or None, 's')}</td></tr>"
        for case in cases
    )
    heads = ("case", "verdict", "criterion nearest to its bound", "rank", "path")
    head = "".join(f"<th>{name}</th>" for name in heads)
    return (
        f"<section class='glance'><h2>At a glance</h2><table><thead><tr>{head}"
        f"<th class='n'>wall time</th></tr></thead><tbody>{rows}</tbody></table></section>\n"
    )


def _nearest(case: CaseResult) -> str:
    """The failing criterion, or the one with the least room."""
    if not case.criteria:
        return escape(shorten(case.message, 90, placeholder=" …"))
    item = min(case.criteria, key=lambda item: (item.passed, _decades(item)))
    return f"{escape(item.quantity)}<small>{_meter(item)} {_room(item)}</small>"


def _decades(item: CriterionResult) -> float:
    """How many powers of ten a criterion is within its bound; negative: beyond."""
    if item.measured is None:
        return -math.inf
    if item.measured <= 0.0 or item.measured == item.bound:
        return 0.0 if item.measured == item.bound > 0.0 else math.inf
    return math.log10(item.bound / item.measured) if item.bound > 0.0 else -math.inf


def _meter(item: CriterionResult) -> str:
    """A bar: the room to the bound, in powers of ten."""
    room = abs(_decades(item))
    width = max(3.0, 100.0 * min(1.0, room / _METER_DECADES))
    over = "" if item.passed else " over"
    return f"<span class='meter{over}'><i style='width:{width:.0f}%'></i></span>"


def _room(item: CriterionResult) -> str:
    """The room to the bound in words."""
    if item.measured is None:
        return escape(item.message)
    room = _decades(item)
    if math.isinf(room):
        exact = item.measured == 0 and item.passed
        return "exactly" if exact else "within" if item.passed else "beyond"
    times = 10.0 ** abs(room)
    shown = f"{times:.2g}" if times < 100 else f"{times:.0f}" if times < 1e3 else _power(room)
    return f"{shown} times {'within' if item.passed else 'beyond'}"


def _power(room: float) -> str:
    return f"10<sup>{math.floor(abs(room))}</sup>"


def _pill(case: CaseResult) -> str:
    kind, text = ("pass", "pass") if case.passed else ("fail", "fail")
    return f"<span class='pill {kind}'>{text}</span>"


def _case(case: CaseResult, number: int) -> str:
    figure = case_figure(case)
    drawn = "" if figure is None else f"<figure>{inline_svg(figure, f'c{number}-')}</figure>"
    trouble = ""
    if case.status != "completed":
        trouble = f"<p class='bad'>{escape(case.status)}: {escape(case.message)}</p>"
    return (
        f"<section class='case' id='{escape(case.name)}'><h2>{escape(case.title)}{_pill(case)}"
        f"<code>multiarm stability {escape(case.name)}</code></h2>"
        f"<p class='difficulty'>{escape(case.difficulty)}</p>{trouble}{_criteria(case.criteria)}"
        f"<p class='run'>{_run(case)}</p>{drawn}{_events(case.events)}{_answers(case)}"
        f"{_scene(case.scene)}</section>\n"
    )


def _criteria(criteria: Iterable[CriterionResult]) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{escape(item.quantity)}</th>"
        f"<td class='n {'good' if item.passed else 'bad'}'>{scientific(item.measured)}</td>"
        f"<td class='n'>{scientific(item.bound)} {escape(_unit(item.unit))}</td>"
        f"<td class='t'>{_meter(item)}</td><td class='e'>{_room(item)}</td></tr>"
        for item in criteria
    )
    if not rows:
        return ""
    return (
        "<table><thead><tr><th>criterion</th><th class='n'>measured</th><th class='n'>bound</th>"
        f"<th>room</th><th></th></tr></thead><tbody>{rows}</tbody></table>"
    )


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _run(case: CaseResult) -> str:
    """How it was run, in a line."""
    counted = case.statistics
    if not counted:
        return ""
    parts = [
        f"{quantity(counted['simulated_s'], 's')} simulated in {quantity(case.wall_time_s, 's')}",
        f"{counted['integrator']}, {counted['steps']:,} steps "
        f"({counted['rejected_steps']:,} rejected)",
        f"solver {counted['solver']}, {counted['stabilization']}",
        f"rank {rank_text(case)}",
        f"path {path_text(case)}",
    ]
    return " · ".join(escape(part) for part in parts)


def _events(events: tuple[dict[str, Any], ...]) -> str:
    if not events:
        return ""
    items = "".join(f"<li>{escape(_event(event))}</li>" for event in events[:SHOWN_EVENTS])
    more = len(events) - SHOWN_EVENTS
    rest = f"<p class='run'>… and {more} more.</p>" if more > 0 else ""
    return f"<h3>Events</h3><ol class='events'>{items}</ol>{rest}"


def _event(event: dict[str, Any]) -> str:
    return f"{event['time']:.6g} s: {event['text']}"


def _answers(case: CaseResult) -> str:
    if not case.answers:
        return ""
    rows = "".join(_answer(answer) for answer in case.answers)
    when = f"at {case.hardest_s:.4g} s"
    span = f"in {case.window_s:.3g} s around it"
    return (
        "<h3>The same by others</h3><table><thead><tr><th></th>"
        f"<th class='n'>object's acceleration<br>off, {when}</th>"
        "<th class='n'>joints' accelerations<br>off</th>"
        f"<th class='n'>loops apart [m]<br>{span}</th><th class='n'>energy error [J]</th><th></th>"
        f"</tr></thead><tbody>{rows}</tbody></table>"
    )


def _answer(answer: Answer) -> str:
    ours = " class='ours'" if answer.solver == OURS else ""
    head = f"<tr{ours}><th scope='row'>{escape(answer.solver)}</th>"
    if answer.refusal:
        return f"{head}<td class='e' colspan='5'>{escape(answer.refusal)}</td></tr>"
    errors = "".join(
        f"<td class='n {_tone(error, answer.accelerations)}'>"
        f"{scientific(error) if not answer.accelerations else 'none'}</td>"
        for error in (answer.object_error, answer.joint_error)
    )
    remarks = [text for text in (answer.accelerations, answer.ended) if text]
    broken = " bad" if answer.accelerations or (answer.ended and not answer.out_of_time) else ""
    return (
        f"{head}{errors}<td class='n'>{scientific(answer.drift)}</td>"
        f"<td class='n'>{scientific(answer.energy_error)}</td>"
        f"<td class='e{broken}'>{escape('; '.join(remarks))}</td></tr>"
    )


def _tone(error: float | None, trouble: str) -> str:
    if trouble or (error is not None and error > WRONG):
        return "bad"
    return "warn" if error is not None and error > DOUBTFUL else ""


def _scene(text: str) -> str:
    if not text:
        return ""
    return (
        "<details style='margin-top:1.2rem'><summary style='font-size:0.9rem'>The scene</summary>"
        f"<pre>{escape(text)}</pre></details>"
    )


def _footer(suite: SuiteResult) -> str:
    when = escape(str(suite.machine["created_utc"]))
    return (
        "<footer><h2>How to read it</h2><p>A case passes when its run is completed and every "
        "criterion is within its bound. The room is drawn in powers of ten. Dotted lines are "
        "events. "
        "Errors of accelerations are relative to the largest of them (or to 1 m/s², 1 rad/s²), "
        "against a dense solution of least norm at the same state. Pinocchio's algorithms are "
        "run as shipped and with settings chosen for precision on two healthy UR5s, and "
        "integrated by SciPy's DOP853 at 1e-9 without any correction of drift; MuJoCo as shipped, "
        "and with hardened constraints and Runge-Kutta steps of 0.5 ms. Who came only part of the "
        "way in a second of wall time was too slow here, which is no error. Energy that appears "
        "without work is error.</p>"
        f"<p>Made {when}.</p></footer>\n"
    )
