"""The scaling study as one self-contained HTML page: figures, tables, what they say."""

from __future__ import annotations

import os
from collections.abc import Iterable
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from multiarm.reports.parts import CSS
from multiarm.reports.report import inline_svg, quantity
from multiarm.results.files import save_page
from multiarm.studies.scaling_plots import study_figure
from multiarm.studies.scaling_tables import Table, disturbance, exponent, micro, tables

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
