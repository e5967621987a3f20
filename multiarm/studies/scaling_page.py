"""The scaling study as figures and as one self-contained HTML page."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from multiarm.plots import INK, STYLE
from multiarm.reports.parts import CSS
from multiarm.reports.report import inline_svg, quantity
from multiarm.results.files import save_page
from multiarm.studies.scaling_tables import Table, disturbance, exponent, micro, tables

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


_TITLES = {
    "evaluations": "The cost of one evaluation",
    "thesis": "Section 4.4 of the thesis, repeated",
    "shares": "Where the time goes",
    "contact_rows": "The cost of a contact row",
}
_CAPTIONS = {
    "evaluations": "UR5 arms around a disc, fastest bursts, one thread. Exponents are fitted over "
    "all numbers of arms.",
    "thesis": "Arms of 6 joints with one contact each, medians, one thread. Circles: the thesis's "
    "own figures, which were measured in Matlab on a workstation of 1995. The exponent of direct "
    "elimination is fitted over the larger half of the numbers of arms.",
    "shares": "Every part is measured by itself; between and rest are what the parts leave.",
}
_CSS = """
td, th { padding-right: 1.2rem; }
td:last-child, th:last-child { padding-right: 0; }
th { white-space: pre-line; }
thead th { font-size: 0.8rem; font-weight: 500; vertical-align: bottom; }
thead th.n, td.n { text-align: right; white-space: nowrap; }
tbody th { white-space: pre; }
.strong { font-weight: 600; color: var(--ink); }
td.good, th.good { color: var(--good); } td.bad { color: var(--bad); }
h3 { margin: 1.6rem 0 0.4rem; font-size: 0.9rem; }
tbody th, tbody td { padding-top: 0.2rem; padding-bottom: 0.2rem; }
.note { margin: 0.6rem 0 0; font-size: 0.85rem; color: var(--soft); }
"""


def write_page(result: dict[str, Any], path: str | os.PathLike) -> Path:
    """Write the page.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    target = Path(path).expanduser()
    save_page(render(result), target)
    return target


def render(result: dict[str, Any]) -> str:
    """The page as text."""
    sections = "".join(
        _section(result, study, list(found))
        for study, found in groupby(tables(result), key=lambda table: table.study)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>multiarm · scaling</title>\n<style>{CSS}{_CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{_header(result)}{_cards(result)}{sections}{_footer(result)}"
        "</main>\n</body>\n</html>\n"
    )


def _header(result: dict[str, Any]) -> str:
    about = result["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in about["dependencies"].items())
    return (
        "<header><p class='kicker'>multiarm · cost against the number of arms</p>"
        "<h1>Scaling</h1><p class='message'>"
        f"{escape(str(about['processor']))}, {escape(str(about['platform']))}, one thread\n"
        f"multiarm {escape(about['version'])}, Python {escape(about['python'])}, "
        f"{escape(libraries)}</p></header>\n"
    )


def _cards(result: dict[str, Any]) -> str:
    items = "".join(
        f"<li><h2>{escape(name)}</h2><p class='value'>{escape(value)}</p>"
        f"<p class='note'>{escape(note)}</p></li>"
        for name, value, note in _headlines(result)
    )
    return f"<ul class='cards'>{items}</ul>\n" if items else ""


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


def _section(result: dict[str, Any], study: str, found: list[Table]) -> str:
    figure = ""
    if study in _CAPTIONS:
        drawn = inline_svg(study_figure(result, study), f"{study}-")
        figure = f"<figure>{drawn}<figcaption>{_CAPTIONS[study]}</figcaption></figure>"
    body = "".join(_table(table) for table in found)
    return f"<section id='{study}'><h2>{_TITLES[study]}</h2>{figure}{body}</section>\n"


def _table(table: Table) -> str:
    head = "".join(
        f"<th{' class=n' if k else ''}>{escape(name)}</th>" for k, name in enumerate(table.heads)
    )
    rows = "".join(
        "<tr>"
        + "".join(
            f"<td class='n {cell.tone}'>{escape(cell.text)}</td>"
            if k
            else f"<th scope='row' class='{cell.tone}'>{escape(cell.text)}</th>"
            for k, cell in enumerate(row)
        )
        + "</tr>"
        for row in table.rows
    )
    notes = "".join(f"<p class='note'>{escape(note)}</p>" for note in table.notes)
    return (
        f"<h3>{escape(table.title)}</h3><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table>{notes}"
    )


def _footer(result: dict[str, Any]) -> str:
    when = escape(str(result["machine"]["created_utc"]))
    return (
        "<footer><h2>How to read it</h2><p>What is compared is measured in turn in short bursts, "
        "so that whatever else the machine does meets all alike: compare the ratios. Counted is "
        "the processor's time, which is the wall time when nothing else runs. Pinocchio's "
        "algorithms are called from Python, which adds about a microsecond. An error is relative "
        "to the largest acceleration, against a dense solution.</p>"
        f"<p>Measured in {quantity(result['wall_time_s'], 's')}, {when}. "
        f"{escape(disturbance(result))}</p></footer>\n"
    )
