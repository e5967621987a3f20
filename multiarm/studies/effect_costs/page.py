"""The ledger as a figure and as one self-contained HTML page.

The figure shows costs on the left and changes on the right, in units of the requested accuracy: an
effect left of the line at 1 can be left out.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.plots import GRID, INK, STYLE
from multiarm.reports.parts import CSS, NOTHING, inline_svg, quantity
from multiarm.results.files import save_figure, save_page
from multiarm.studies.effect_costs.entries import (
    FORCE,
    JOINTS,
    PATH,
    QUANTITIES,
    SLIDES,
    TURN,
    Entry,
    Ledger,
)
from multiarm.studies.effect_costs.variants import CANDIDATE, PRESENT, SETTING
from multiarm.studies.effect_costs.words import (
    accuracy_text,
    change_text,
    percent,
    sentence,
    verdict,
)

COLOURS = {"present": "#3b7dd8", CANDIDATE: "#d9822b", SETTING: "#8a96a3"}
MARKS = {PATH: "o", TURN: "s", JOINTS: "^", SLIDES: "v", FORCE: "D"}
LABELS = {PATH: "path", TURN: "turn", JOINTS: "joints", SLIDES: "sliding joints", FORCE: "force"}
LEAST = 1e-6
"""Changes are drawn down to this part of the accuracy."""


def ledger_figure(found: Ledger, on_page: bool = False) -> Figure:
    """Time and changes of every entry that has both, so not of the certificate.

    On a page the figure has neither title nor background.
    """
    shown = [entry for entry in found.entries if entry.share is not None and entry.changes]
    with matplotlib.rc_context(STYLE):
        height = 1.6 + 0.36 * max(len(shown), 3)
        figure = Figure(figsize=(11.0, height), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, 1.35))
        _draw_costs(left, shown)
        _draw_changes(right, shown, found)
        figure.legend(handles=_legend(), loc="outside lower right", frameon=False, ncols=5)
        if on_page:
            figure.patch.set_alpha(0)
        else:
            figure.suptitle(found.scene["name"], fontsize=12, color=INK, parse_math=False)
    return figure


def write_plot(found: Ledger, path: Path) -> None:
    """Draw the figure to a file; its ending is the format."""
    save_figure(ledger_figure(found), path)


def _draw_costs(axes: Axes, shown: list[Entry]) -> None:
    shares = [entry.share for entry in shown if entry.share is not None]
    axes.barh(
        range(len(shown)),
        [100.0 * share.value for share in shares],
        xerr=[100.0 * share.uncertainty for share in shares],
        color=[COLOURS[entry.kind] for entry in shown],
        height=0.6,
        error_kw={"ecolor": INK, "elinewidth": 1.0},
    )
    axes.axvline(0.0, color=INK, linewidth=0.8)
    names = [f"+ {entry.name}" if entry.kind == CANDIDATE else entry.name for entry in shown]
    axes.set_yticks(range(len(shown)), names, parse_math=False)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlabel("% of the time of the scene's own run")
    axes.set_title("What it costs")
    axes.set_axisbelow(True)


def _draw_changes(axes: Axes, shown: list[Entry], found: Ledger) -> None:
    sizes = [
        (k, quantity, max(change.value / found.asked[quantity], LEAST), COLOURS[entry.kind])
        for k, entry in enumerate(shown)
        for quantity, change in entry.changes.items()
    ]
    axes.set_xscale("log")
    axes.set_xlim(LEAST, 3.0 * max([10.0, *(size for _, _, size, _ in sizes)]))
    axes.axvspan(LEAST, 1.0, color=GRID, alpha=0.5, linewidth=0)
    axes.axvline(1.0, color=INK, linewidth=0.8)
    for k, name, size, colour in sizes:
        axes.plot(
            size, k, MARKS[name], color=colour, markersize=6.5, clip_on=False, zorder=3,
            markerfacecolor="none" if name == FORCE else colour,
        )  # fmt: skip
    axes.set_xlabel("largest change, in units of the accuracy")
    axes.set_title("What it changes")
    axes.set_axisbelow(True)


def _legend() -> list[Line2D]:
    return [
        Line2D(
            [], [], marker=mark, color=INK, linestyle="none", label=LABELS[quantity],
            markerfacecolor="none" if quantity == FORCE else INK,
        )
        for quantity, mark in MARKS.items()
    ]  # fmt: skip


_CSS = """
main { max-width: 78rem; }
td, th { padding-right: 1.2rem; }
td:last-child, th:last-child { padding-right: 0; }
thead th { font-size: 0.8rem; font-weight: 500; vertical-align: bottom; }
thead th.n, td.n { text-align: right; white-space: nowrap; }
td.t { text-align: left; font-size: 0.85rem; }
td.noise { opacity: 0.55; }
td.small { opacity: 0.55; }
td.good { color: var(--good); } td.bad { color: var(--bad); }
td small { color: var(--soft); }
ul.said { list-style: none; padding: 0; margin: 0 0 0.6rem; max-width: 60rem; }
ul.said li { font-size: 1.08rem; line-height: 1.5; }
ul.said li.good { color: var(--good); } ul.said li.bad { color: var(--bad); }
.scroll { overflow-x: auto; }
"""
_HEADS = {
    PRESENT: "Effects of the scene: what each costs and changes",
    CANDIDATE: "Effects that it might have: what each would cost and change",
    SETTING: "How it is run",
}


def write_page(found: Ledger, path: Path) -> None:
    """Write the page, complete or not at all.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    save_page(render(found), path)


def render(found: Ledger) -> str:
    """The page as text."""
    name = escape(found.scene["name"])
    tables = "".join(_table(found, kind) for kind in _HEADS)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name} · multiarm effects</title>\n<style>{CSS}{_CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{_header(found)}{_diagram(found)}{tables}{_scene(found)}"
        f"{_footer(found)}</main>\n</body>\n</html>\n"
    )


def _header(found: Ledger) -> str:
    about = found.machine
    libraries = ", ".join(f"{key} {value}" for key, value in about["dependencies"].items())
    effects = [entry for entry in found.entries if entry.kind != SETTING]
    lines = "".join(
        f"<li class='{_tone(found, entry)}'>{escape(sentence(found, entry))}</li>"
        for entry in effects
    )
    items = lines or "<li>No effects: nothing is added, and nothing can be left out.</li>"
    return (
        "<header><p class='kicker'>multiarm · what effects cost and change</p>"
        f"<h1>{escape(found.scene['name'])}</h1><ul class='said'>{items}</ul>"
        f"<p class='message'>{escape(accuracy_text(found))}\n"
        f"{escape(found.run['certificate'])}\n"
        f"{escape(str(about['processor']))}, {escape(str(about['platform']))}\n"
        f"multiarm {escape(about['version'])}, Python {escape(about['python'])}, "
        f"{escape(libraries)}</p></header>\n"
    )


def _diagram(found: Ledger) -> str:
    if not any(entry.share is not None and entry.changes for entry in found.entries):
        return ""
    drawn = inline_svg(ledger_figure(found, on_page=True), "ledger-")
    return (
        f"<section><h2>Costs and changes</h2><figure>{drawn}<figcaption>Left: time, with its "
        "uncertainty. Right: the largest changes, in units of the requested accuracy; a "
        "change in the shaded part is not distinguishable from the errors of the "
        "runs.</figcaption></figure>"
        "</section>\n"
    )


def _table(found: Ledger, kind: str) -> str:
    entries = found.of_kind(kind)
    if not entries:
        return ""
    numbers = ("ms per s", "% of the time", "evaluations")
    heads = [*numbers, *(what for what, _ in QUANTITIES.values())]
    head = "".join(f"<th class='n'>{escape(text)}</th>" for text in heads)
    rows = "".join(_row(found, entry, len(heads)) for entry in entries)
    return (
        f"<section class='scroll'><h2>{_HEADS[kind]}</h2><table><thead><tr><th></th>{head}"
        f"<th></th></tr></thead><tbody>{rows}</tbody></table></section>\n"
    )


def _row(found: Ledger, entry: Entry, width: int) -> str:
    head = f"<tr><th scope='row'>{escape(entry.name)}</th>"
    last = f"<td class='t {_tone(found, entry)}'>{escape(verdict(found, entry))}"
    if entry.kind == CANDIDATE:
        last += f"<br><small>{escape(entry.about)}</small>"
    last += "</td></tr>"
    if entry.share is None or entry.milliseconds is None:
        return f"{head}{f'<td class=n>{NOTHING}</td>' * width}{last}"
    tone = " noise" if entry.share.within_noise else ""
    costs = (
        f"<td class='n{tone}'>{entry.milliseconds.value:.2g}</td>"
        f"<td class='n{tone}'>{percent(entry.share)}</td><td class='n'>{entry.evaluations:,}</td>"
    )
    return f"{head}{costs}{''.join(_change(found, entry, name) for name in QUANTITIES)}{last}"


def _change(found: Ledger, entry: Entry, name: str) -> str:
    change = entry.changes.get(name)
    if change is None:
        return f"<td class='n'>{NOTHING}</td>"
    tone = "" if change.value > found.asked[name] else " small"
    where = f"{change.arm}, " if change.arm else ""
    return (
        f"<td class='n{tone}'>{change_text(change, name)}<br><small>{escape(where)}"
        f"at {change.time:.3g} s</small></td>"
    )


def _tone(found: Ledger, entry: Entry) -> str:
    if entry.trouble:
        return "bad"
    return "good" if found.can_go(entry) else ""


def _scene(found: Ledger) -> str:
    return (
        "<section><details><summary>The scene</summary>"
        f"<pre>{escape(found.scene['text'])}</pre></details></section>\n"
    )


def _footer(found: Ledger) -> str:
    when = escape(str(found.machine["created_utc"]))
    return (
        "<footer><h2>How to read it</h2><p>The scene is run once more without each of its effects. "
        "All runs are made to the accuracy that the scene requests, and checked where it names "
        "one; a change is the largest difference of two such runs at an output time. Times are "
        "the processor's, of runs in turn on one thread; ± is twice the standard error, and what "
        "is pale lies within it. Leaving gravity out also leaves out what the control does about "
        "it.</p>"
        f"<p>Measured in {quantity(found.wall_time_s, 's')}, {when}.</p></footer>\n"
    )
