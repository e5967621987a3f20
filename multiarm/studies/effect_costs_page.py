"""The ledger in words, as a table, as a figure and as one self-contained HTML page.

The summary has one sentence for each entry, and a verdict on all of at most three:
``Leave out drag: without it nothing changes beyond the noise. Keep joint_damping (3 % of the time,
the object's path by 41 mm).``  A time within its uncertainty is noise, and so is a change below the
requested accuracy, to which all runs are made.

The figure shows costs on the left and changes on the right, in units of the requested accuracy: an
effect left of the line at 1 can be left out.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import matplotlib
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.notation import NOTHING, count_of, number
from multiarm.plots.style import GRID, INK, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.studies.effect_costs import (
    CANDIDATE,
    CHANGE_QUANTITIES,
    FORCE,
    JOINTS,
    PATH,
    PRESENT,
    RECORDING,
    SETTING,
    SLIDES,
    TURN,
    Entry,
    Estimate,
    Ledger,
)
from multiarm.studies.tables import NUMBER, REMARK, TEXT, Column, TextTable, attribute, text_table


class Shown(NamedTuple):
    """How a changed quantity is shown."""

    head: str  # above a column
    unit: str
    factor: float  # to this unit


DEGREES = math.degrees(1.0)
SHOWN = {
    PATH: Shown("path", "mm", 1e3),
    TURN: Shown("turn", "deg", DEGREES),
    JOINTS: Shown("joints", "deg", DEGREES),
    SLIDES: Shown("slides", "mm", 1e3),
    FORCE: Shown("force", "N", 1.0),
}
NO_EFFECTS = "No effects: nothing is added, and nothing can be left out."
NOISE = "noise"


# --- words ----------------------------------------------------------------------------------------


def summary(ledger: Ledger) -> str:
    """What to leave out, what to keep, and what else is known, in a sentence each."""
    effects = [entry for entry in ledger.entries if entry.kind != SETTING]
    if not effects:
        return NO_EFFECTS
    go, keep, remainder = [], [], []
    for entry in effects:
        quantity = ledger.moves(entry)
        if entry.kind == CANDIDATE or entry.trouble:
            remainder.append(sentence(ledger, entry))
        elif ledger.can_go(entry):
            go.append(entry.name)
        elif quantity is not None:
            change = _change(ledger, entry, quantity)
            keep.append(f"{entry.name} ({_cost(entry)}, {change})")
        else:
            whose = "the scene's own" if entry.certified else "its"
            doubt = f"undecided, as {whose} run does not meet the requested accuracy"
            remainder.append(f"{entry.name} is {doubt}")
    them = "it" if len(go) == 1 else "them"
    sentences = (
        f"Leave out {_listed(go)}: without {them} nothing changes beyond the noise." if go else "",
        f"Keep {_listed(keep)}." if keep else "",
        f"{'; '.join(remainder)}." if remainder else "",
    )
    return " ".join(filter(None, sentences))


def _listed(names: list[str]) -> str:
    """``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(ledger: Ledger, entry: Entry) -> str:
    """What an entry costs and changes."""
    name = f"{entry.name} (added)" if entry.kind == CANDIDATE else entry.name
    if entry.trouble:
        return f"{name}: {trouble(entry)}"
    if not entry.changes:
        return f"{name}: {_cost(entry)}"
    would = "would change" if entry.kind == CANDIDATE else "changes"
    quantity = ledger.moves(entry)
    what = "nothing beyond the noise" if quantity is None else _change(ledger, entry, quantity)
    advice = ": leave it out" if ledger.can_go(entry) else ""
    return f"{name}: {_cost(entry)}, {would} {what}{advice}"


def trouble(entry: Entry) -> str:
    """What went wrong, beginning with what was done."""
    done = {PRESENT: "without it", CANDIDATE: "with it", SETTING: "so"}[entry.kind]
    text = " ".join(line.strip() for line in entry.trouble.splitlines())
    return f"the scene does not run {done}: {text}"


def _cost(entry: Entry) -> str:
    assert entry.share is not None, "entries without trouble have times"
    share = entry.share
    if share.within_noise:
        return "time within the noise"
    size = f"{number(abs(100.0 * share.value), digits=2)} %"
    if share.value < 0.0:
        return f"{'would save' if entry.kind == CANDIDATE else 'saves'} {size} of the time"
    return f"{size} more time" if entry.kind == CANDIDATE else f"{size} of the time"


def _change(ledger: Ledger, entry: Entry, name: str) -> str:
    """``the object's path by 41 mm``."""
    arm, what = entry.changes[name].arm, CHANGE_QUANTITIES[name].what
    if arm:  # one of several objects
        what = {PATH: "path", TURN: "orientation"}.get(name, what)
    whose = f"{arm}'s" if arm else "the"
    end = " at the end" if entry.name == RECORDING and entry.kind == SETTING else ""
    return f"{whose} {what} by {size(ledger, entry, name)} {SHOWN[name].unit}{end}"


def size(ledger: Ledger, entry: Entry, name: str) -> str:
    """A change in the unit in which people read it; "noise" below the accuracy."""
    if name not in entry.changes:
        return NOTHING
    value = entry.changes[name].value
    if 0.0 < value <= ledger.asked[name]:
        return NOISE
    return number(SHOWN[name].factor * value, digits=2)


def percent(share: Estimate) -> str:
    """A share of the time with its uncertainty, such as ``3.1 ± 0.4``, or that it is noise."""
    value, spread = 100.0 * share.value, 100.0 * share.uncertainty
    digits = 0 if max(spread, abs(value) / 10.0) >= 1.0 else 1
    text = f"{value:.{digits}f}"
    if share.within_noise:
        return NOISE
    return text if not spread else f"{text} \N{PLUS-MINUS SIGN} {spread:.{digits}f}"


def accuracy_text(ledger: Ledger) -> str:
    """What changes are measured against, and how the scene itself ran."""
    run = ledger.run
    accuracies = ", ".join(
        f"{CHANGE_QUANTITIES[name].what} {ledger.asked[name]:.2g} {CHANGE_QUANTITIES[name].unit}"
        for name in (PATH, TURN, FORCE)
    )
    by = "requested" if ledger.asked_by_scene else "default, as the scene requests none"
    return (
        f"{ledger.scene['duration_s']:g} s by {run['integrator']}: {run['milliseconds']:.3g} ms of "
        f"time a simulated second, {run['evaluations']:,} evaluations. "
        f"Accuracy ({by}): {accuracies}. "
        f"Every run is made to it; times are medians of "
        f"{count_of(run['repeats'], 'round')} in turn."
    )


def figures(ledger: Ledger) -> dict[str, Any]:
    """All figures, under the keys that ``multiarm effects --help`` lists."""
    return {**ledger.as_dict(), "summary": summary(ledger)}


# --- table, figure and page -----------------------------------------------------------------------


COLOURS = {PRESENT: "#3b7dd8", CANDIDATE: "#d9822b", SETTING: "#8a96a3"}
MARKS = {PATH: "o", TURN: "s", JOINTS: "^", SLIDES: "v", FORCE: "D"}
LEAST = 1e-6
"""Changes are drawn down to this part of the accuracy."""


def table(ledger: Ledger) -> TextTable:
    """One line an entry: what it costs, what it changes and when it changes that most."""

    def at(entry: Entry) -> str:
        quantity = ledger.moves(entry)
        return NOTHING if quantity is None else f"{entry.changes[quantity].time:.3g}"

    shown = [
        name
        for name in CHANGE_QUANTITIES
        if name not in (JOINTS, SLIDES) or any(name in e.changes for e in ledger.entries)
    ]
    sizes = [
        Column(
            f"{SHOWN[name].head} {SHOWN[name].unit}",
            NUMBER,
            partial(size, ledger, name=name),
        )
        for name in shown
    ]
    columns = [
        Column("effect or setting", TEXT, _label),
        Column("ms/s", NUMBER, _milliseconds),
        Column("% time", NUMBER, attribute("share", percent)),
        Column("evals", NUMBER, attribute("evaluations", "{:,}".format)),
        *sizes,
        Column("at s", NUMBER, at),
        Column("", REMARK, _remark),
    ]
    title = "What each costs, and what it changes"
    return text_table(title, ledger.entries, columns)


def _label(entry: Any) -> str:
    return f"+ {entry.name}" if entry.kind == CANDIDATE else entry.name


def _milliseconds(entry: Entry) -> str:
    if entry.milliseconds is None or entry.share is None:
        return NOTHING
    return NOISE if entry.share.within_noise else f"{entry.milliseconds.value:.2g}"


def _remark(entry: Entry) -> str:
    if entry.trouble:
        return trouble(entry)
    doubt = "" if entry.certified else "its run does not meet the requested accuracy"
    about = "" if entry.kind == PRESENT else entry.about
    return ", ".join(filter(None, (about, doubt)))


def figure(ledger: Ledger, with_title: bool = True) -> Figure:
    """Time and changes of every entry that has both, so not of the certificate."""
    rows = ledger.table.dropna(subset="share").dropna(subset=list(CHANGE_QUANTITIES), how="all")
    with matplotlib.rc_context(STYLE):
        height = 1.6 + 0.36 * max(len(rows), 3)
        drawing = Figure(figsize=(11.0, height), layout="constrained")
        costs, changes = drawing.subplots(1, 2, sharey=True, width_ratios=(1, 1.35))
        _draw_costs(costs, rows)
        _draw_changes(changes, rows)
        keys = [
            Line2D([], [], **_mark(name, INK), linestyle="none", label=SHOWN[name].head)
            for name in MARKS
        ]
        drawing.legend(handles=keys, loc="outside lower right", frameon=False, ncols=5)
        if with_title:
            drawing.suptitle(ledger.scene["name"], fontsize=12, color=INK, parse_math=False)
    return drawing


def _draw_costs(axes: Axes, rows: pandas.DataFrame) -> None:
    axes.barh(
        range(len(rows)), 100.0 * rows["share"], xerr=100.0 * rows["uncertainty"], height=0.6,
        color=rows["kind"].map(COLOURS).tolist(), error_kw={"ecolor": INK, "elinewidth": 1.0},
    )  # fmt: skip
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(rows)), [_label(row) for row in rows.itertuples()], parse_math=False)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("% of the time of the scene's own run")
    axes.set_title("What it costs")
    axes.set_axisbelow(True)


def _draw_changes(axes: Axes, rows: pandas.DataFrame) -> None:
    axes.set_xscale("log")
    axes.set_xlim(LEAST, 3.0 * max(10.0, rows[list(CHANGE_QUANTITIES)].max(axis=None)))
    axes.axvspan(LEAST, 1.0, color=GRID, alpha=0.5, linewidth=0)
    axes.axvline(1.0, color=INK, linewidth=0.8)
    for place, (_, row) in enumerate(rows.iterrows()):
        for name, change in row[list(CHANGE_QUANTITIES)].dropna().items():
            mark = _mark(str(name), COLOURS[row["kind"]])
            axes.plot(max(change, LEAST), place, **mark, markersize=6.5, clip_on=False, zorder=3)
    axes.set_xlabel("largest change, in units of the accuracy")
    axes.set_title("What it changes")
    axes.set_axisbelow(True)


def _mark(quantity: str, colour: str) -> dict[str, Any]:
    face = "none" if quantity == FORCE else colour
    return {"marker": MARKS[quantity], "color": colour, "markerfacecolor": face}


def render(ledger: Ledger) -> str:
    """The page as text."""
    effects = [entry for entry in ledger.entries if entry.kind != SETTING]
    drawn = any(entry.share is not None and entry.changes for entry in ledger.entries)
    return pages.render(
        "effects.html",
        ledger=ledger,
        accuracy=accuracy_text(ledger),
        sentences=[sentence(ledger, entry) for entry in effects] or [NO_EFFECTS],
        table=table(ledger),
        diagram=inline_svg(figure(ledger, with_title=False), "ledger-") if drawn else "",
    )
