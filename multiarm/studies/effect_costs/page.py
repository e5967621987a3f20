"""The ledger as a figure and as one self-contained HTML page.

The figure shows costs on the left and changes on the right, in units of the requested accuracy: an
effect left of the line at 1 can be left out.
"""

from __future__ import annotations

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.plots.style import GRID, INK, STYLE, inline_svg
from multiarm.reports import pages
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
    NO_EFFECTS,
    accuracy_text,
    sentence,
    table,
    tone,
)

COLOURS = {PRESENT: "#3b7dd8", CANDIDATE: "#d9822b", SETTING: "#8a96a3"}
MARKS = {PATH: "o", TURN: "s", JOINTS: "^", SLIDES: "v", FORCE: "D"}
TITLES = {
    PRESENT: "Effects of the scene: what each costs and changes",
    CANDIDATE: "Effects that it might have: what each would cost and change",
    SETTING: "How it is run",
}
LEAST = 1e-6
"""Changes are drawn down to this part of the accuracy."""


def figure(found: Ledger, with_title: bool = True) -> Figure:
    """Time and changes of every entry that has both, so not of the certificate."""
    shown = [entry for entry in found.entries if entry.share is not None and entry.changes]
    with matplotlib.rc_context(STYLE):
        height = 1.6 + 0.36 * max(len(shown), 3)
        drawn = Figure(figsize=(11.0, height), layout="constrained")
        left, right = drawn.subplots(1, 2, sharey=True, width_ratios=(1, 1.35))
        _draw_costs(left, shown)
        _draw_changes(right, shown, found)
        drawn.legend(handles=_legend(), loc="outside lower right", frameon=False, ncols=5)
        if with_title:
            drawn.suptitle(found.scene["name"], fontsize=12, color=INK, parse_math=False)
    return drawn


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
            [], [], marker=mark, color=INK, linestyle="none", label=QUANTITIES[quantity].head,
            markerfacecolor="none" if quantity == FORCE else INK,
        )
        for quantity, mark in MARKS.items()
    ]  # fmt: skip


def render(found: Ledger) -> str:
    """The page as text."""
    effects = [entry for entry in found.entries if entry.kind != SETTING]
    drawn = any(entry.share is not None and entry.changes for entry in found.entries)
    return pages.render(
        "effects.html",
        found=found,
        accuracy=accuracy_text(found),
        nothing=NO_EFFECTS,
        sentences=[(sentence(found, entry), tone(found, entry)) for entry in effects],
        tables=[
            table(found, entries, title)
            for kind, title in TITLES.items()
            if (entries := found.of_kind(kind))
        ],
        diagram=inline_svg(figure(found, with_title=False), "ledger-") if drawn else "",
    )
