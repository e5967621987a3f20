"""The ledger as text: one sentence for each entry, and a verdict on all of at most three.

``Leave out drag: without it nothing changes beyond the noise. Keep joint_damping (3 % of the time,
the object's path by 41 mm).``

A time within its uncertainty is noise, and so is a change below the requested accuracy, to which
all runs are made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multiarm.studies.effect_costs.entries import (
    FORCE,
    JOINTS,
    PATH,
    QUANTITIES,
    SLIDES,
    TURN,
    Entry,
    Estimate,
    Ledger,
)
from multiarm.studies.effect_costs.variants import CANDIDATE, PRESENT, RECORDING, SETTING
from multiarm.studies.tables import REMARK, TEXT, Cell, Column, Table

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
    text = entry.trouble.splitlines()
    first = text[0] if len(text) == 1 else " ".join(line.strip() for line in text)
    if entry.kind == PRESENT:
        return f"the scene does not run without it: {first}"
    return f"the scene does not run {'with it' if entry.kind == CANDIDATE else 'so'}: {first}"


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
        f"Every run is made to it; times are medians of {run['repeats']} rounds in turn."
    )


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
