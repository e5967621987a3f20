"""The ledger as text, as a table, as a figure and as one self-contained HTML page.

The text has one sentence for each entry, and a verdict on all of at most three:
``Leave out drag: without it nothing changes beyond the noise. Keep joint_damping (3 % of the time,
the object's path by 41 mm).``  A time within its uncertainty is noise, and so is a change below the
requested accuracy, to which all runs are made.

The figure shows costs on the left and changes on the right, in units of the requested accuracy: an
effect left of the line at 1 can be left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multiarm.notation import count_of
from multiarm.plots.style import GRID, INK, STYLE, inline_svg
from multiarm.reports import pages
from multiarm.studies.effect_costs.entries import (
    CANDIDATE,
    FORCE,
    JOINTS,
    PATH,
    PRESENT,
    QUANTITIES,
    RECORDING,
    SETTING,
    SLIDES,
    TURN,
    Entry,
    Estimate,
    Ledger,
)
from multiarm.studies.tables import REMARK, TEXT, Cell, Column, Line, Table

NO_EFFECTS = "No effects: nothing is added, and nothing can be left out."
NOISE = "noise"


def summary(found: Ledger) -> str:
    """What to leave out, what to keep, and what else is known, in a sentence each."""
    present, more = found.of_kind(PRESENT), found.of_kind(CANDIDATE)
    if not present and not more:
        return NO_EFFECTS
    go = [entry.name for entry in present if found.can_go(entry)]
    keep = [_briefly(found, e) for e in present if not e.trouble and found.moves(e)]
    rest = [
        _rest(found, e) for e in present if e.trouble or not (found.can_go(e) or found.moves(e))
    ]
    rest += [_rest(found, entry) for entry in more]
    them = "it" if len(go) == 1 else "them"
    sentences = (
        f"Leave out {_listed(go)}: without {them} nothing changes beyond the noise." if go else "",
        f"Keep {_listed(keep)}." if keep else "",
        f"{'; '.join(rest)}." if rest else "",
    )
    return " ".join(filter(None, sentences))


def _briefly(found: Ledger, entry: Entry) -> str:
    """``joint_damping (3 % of the time, the object's path by 41 mm)``."""
    quantity = found.moves(entry)
    assert quantity is not None, "the entry changes something"
    return f"{entry.name} ({_cost(entry)}, {_change(found, entry, quantity)})"


def _rest(found: Ledger, entry: Entry) -> str:
    """An effect that was added, or of which it is not known whether it can go."""
    if entry.kind == PRESENT and not entry.trouble:
        return f"{entry.name} is undecided, as its run does not meet the requested accuracy"
    return sentence(found, entry)


def _listed(names: list[str]) -> str:
    """``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(found: Ledger, entry: Entry) -> str:
    """What an entry costs and changes."""
    name = f"{entry.name} (added)" if entry.kind == CANDIDATE else entry.name
    if entry.trouble:
        return f"{name}: {trouble(entry)}"
    would = "would change" if entry.kind == CANDIDATE else "changes"
    quantity = found.moves(entry)
    what = "nothing beyond the noise" if quantity is None else _change(found, entry, quantity)
    text = f"{name}: {_cost(entry)}, {would} {what}" if entry.changes else f"{name}: {_cost(entry)}"
    return f"{text}: leave it out" if found.can_go(entry) else text


def tone(found: Ledger, entry: Entry) -> str:
    """Of an entry's name: bad where it failed, good where it can go."""
    return "bad" if entry.trouble else "good" if found.can_go(entry) else ""


def remark(entry: Entry) -> str:
    """What is to be said of an entry beside its numbers."""
    if entry.trouble:
        return trouble(entry)
    doubt = "" if entry.certified else "its run does not meet the requested accuracy"
    about = "" if entry.kind == PRESENT else entry.about
    return ", ".join(filter(None, (about, doubt)))


def trouble(entry: Entry) -> str:
    """What went wrong, beginning with what was done."""
    done = {PRESENT: "without it", CANDIDATE: "with it", SETTING: "so"}[entry.kind]
    text = " ".join(line.strip() for line in entry.trouble.splitlines())
    return f"the scene does not run {done}: {text}"


def change_text(found: Ledger, entry: Entry, quantity: str, with_unit: bool = True) -> str:
    """A change in the unit in which people read it; "noise" below the accuracy."""
    value = entry.changes[quantity].value
    if 0.0 < value <= found.asked[quantity]:
        return NOISE
    read = QUANTITIES[quantity]
    text = _short(read.factor * value)
    return f"{text} {read.shown}" if with_unit else text


def _short(value: float) -> str:
    """Two digits: ``0.02``, ``41``, ``1250``; one where it is next to nothing."""
    if value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.2g}" if value >= 1e-4 or value == 0.0 else f"{value:.0e}"


def milliseconds(entry: Entry) -> str:
    """The time of an entry without a unit, or that it is noise."""
    assert entry.milliseconds is not None and entry.share is not None, "the entry has a time"
    return NOISE if entry.share.within_noise else f"{entry.milliseconds.value:.2g}"


def percent(share: Estimate) -> str:
    """A share of the time with its uncertainty, such as ``3.1 ± 0.4``, or that it is noise."""
    value, spread = 100.0 * share.value, 100.0 * share.uncertainty
    digits = 0 if max(spread, abs(value) / 10.0) >= 1.0 else 1
    text = f"{value:.{digits}f}"
    if share.within_noise:
        return NOISE
    return text if not spread else f"{text} \N{PLUS-MINUS SIGN} {spread:.{digits}f}"


def table(found: Ledger, entries: Sequence[Entry], title: str) -> Table:
    """One line an entry: what it costs, and what it changes; noise is pale."""
    shown = [
        quantity
        for quantity in QUANTITIES
        if quantity not in (JOINTS, SLIDES) or any(quantity in e.changes for e in entries)
    ]
    columns = (
        Column("", TEXT),
        Column("ms/s"),
        Column("% time"),
        Column("evals", write="{:,}".format),
        *(Column(f"{QUANTITIES[name].head} {QUANTITIES[name].shown}") for name in shown),
        Column("at s", write="{:.3g}".format),
        Column("", REMARK),
    )
    return Table(title, columns, tuple(_row(found, entry, shown) for entry in entries))


def _row(found: Ledger, entry: Entry, shown: Sequence[str]) -> tuple[Any, ...]:
    costs: tuple[Any, ...] = (None, None, None)
    if entry.share is not None:
        noise = "pale" if entry.share.within_noise else ""
        cost = (Cell(milliseconds(entry), noise), Cell(percent(entry.share), noise))
        costs = (*cost, entry.evaluations)
    most = found.moves(entry)
    return (
        Cell(f"+ {entry.name}" if entry.kind == CANDIDATE else entry.name, tone(found, entry)),
        *costs,
        *(_changed(found, entry, quantity) for quantity in shown),
        None if most is None else entry.changes[most].time,
        Cell(remark(entry), "bad" if entry.trouble else ""),
    )


def _changed(found: Ledger, entry: Entry, quantity: str) -> Cell:
    change = entry.changes.get(quantity)
    if change is None:
        return Cell(None, "pale")
    whose = f"{change.arm}, " if change.arm else ""
    pale = "pale" if change.value <= found.asked[quantity] else ""
    text = change_text(found, entry, quantity, with_unit=False)
    return Cell(text, pale, f"{whose}at {change.time:.3g} s")


def accuracy_text(found: Ledger) -> str:
    """What changes are measured against, and how the scene itself ran."""
    accuracies = ", ".join(
        f"{QUANTITIES[name].what} {value:.2g} {QUANTITIES[name].unit}"
        for name, value in found.asked.items()
        if name in (PATH, TURN, FORCE)
    )
    by = "requested" if found.asked_by_scene else "default, as the scene requests none"
    run = found.run
    return (
        f"{found.scene['duration_s']:g} s by {run['integrator']}: {run['milliseconds']:.3g} ms of "
        f"time a simulated second, {run['evaluations']:,} evaluations. "
        f"Accuracy ({by}): {accuracies}. "
        f"Every run is made to it; times are medians of "
        f"{count_of(run['repeats'], 'round')} in turn."
    )


def texts(found: Ledger) -> Iterator[Table | Line]:
    """What the command prints."""
    yield Line(found.scene["name"], "strong")
    yield Line(accuracy_text(found), "pale")
    yield table(found, found.entries, "What each costs, and what it changes")
    if found.run["certificate"].startswith("not met"):
        yield Line(f"The scene's own run: {found.run['certificate']}", "warn")
    yield Line(summary(found), "verdict")


def figures(found: Ledger) -> dict[str, Any]:
    """All figures, under the keys that ``multiarm effects --help`` lists."""
    return {**found.as_dict(), "summary": summary(found)}


def _cost(entry: Entry) -> str:
    assert entry.share is not None, "entries without trouble have times"
    share = entry.share
    if share.within_noise:
        return "time within the noise"
    size = f"{_short(abs(100.0 * share.value))} %"
    if share.value < 0.0:
        return f"{'would save' if entry.kind == CANDIDATE else 'saves'} {size} of the time"
    return f"{size} more time" if entry.kind == CANDIDATE else f"{size} of the time"


def _change(found: Ledger, entry: Entry, quantity: str) -> str:
    """``the object's path by 41 mm``."""
    arm = entry.changes[quantity].arm
    whose = f"{arm}'s " if arm else "the "
    text = f"{whose}{QUANTITIES[quantity].what} by {change_text(found, entry, quantity)}"
    end = " at the end" if entry.name == RECORDING and entry.kind == SETTING else ""
    return text + end


# --- figure and page ------------------------------------------------------------------------------


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
