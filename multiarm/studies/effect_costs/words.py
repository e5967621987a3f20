"""The ledger as text: one sentence for each entry, and one line for all.

``joint_damping: 3 % of the time, changes the object's path by 41 mm; drag: 2 % of the time, changes
it by 0.02 mm, below the requested accuracy: leave it out``
"""

from __future__ import annotations

import math
from typing import Any

from multiarm.studies.effect_costs.entries import (
    FORCE,
    JOINTS,
    PATH,
    QUANTITIES,
    SLIDES,
    TURN,
    Change,
    Entry,
    Estimate,
    Ledger,
)
from multiarm.studies.effect_costs.variants import CANDIDATE, PRESENT, RECORDING, SETTING

SHOWN = {
    PATH: (1e3, "mm"),
    TURN: (math.degrees(1.0), "deg"),
    JOINTS: (math.degrees(1.0), "deg"),
    SLIDES: (1e3, "mm"),
    FORCE: (1.0, "N"),
}
"""Quantity -> factor and unit in which people read it."""
NO_EFFECTS = "No effects: nothing is added, and nothing can be left out."


def summary(found: Ledger) -> str:
    """All effects in one line; settings are in the table."""
    present = [sentence(found, entry, PATH) for entry in found.of_kind(PRESENT)]
    more = [sentence(found, entry, PATH) for entry in found.of_kind(CANDIDATE)]
    if not present and not more:
        return NO_EFFECTS
    return "; ".join([*present, *more]) + "."


def sentence(found: Ledger, entry: Entry, known: str = "") -> str:
    """What an entry costs and changes; ``known`` is a quantity that "it" stands for."""
    name = f"{entry.name} (added)" if entry.kind == CANDIDATE else entry.name
    if entry.trouble:
        return f"{name}: {trouble(entry)}"
    parts = [f"{name}: {_cost(entry)}", *_change(found, entry)]
    if not found.can_go(entry):
        return ", ".join(parts)
    if any(change.value for change in entry.changes.values()):
        parts.append("below the requested accuracy")
    return f"{', '.join(parts)}: leave it out"


def verdict(found: Ledger, entry: Entry) -> str:
    """What to do about an entry, in a few words."""
    if entry.trouble:
        return trouble(entry)
    if found.can_go(entry):
        return "leave it out"
    if entry.kind == SETTING:
        return entry.about
    quantity = found.moves(entry)
    if quantity is None:
        return ""
    doubt = "" if entry.certified else "; not certified"
    return f"changes the {QUANTITIES[quantity][0].removeprefix(_OBJECT)}{doubt}"


_OBJECT = "object's "


def trouble(entry: Entry) -> str:
    """What went wrong, beginning with what was done."""
    text = entry.trouble.splitlines()
    first = text[0] if len(text) == 1 else " ".join(line.strip() for line in text)
    if entry.kind == PRESENT:
        return f"the scene does not run without it: {first}"
    return f"the scene does not run {'with it' if entry.kind == CANDIDATE else 'so'}: {first}"


def change_text(change: Change | None, quantity: str, with_unit: bool = True) -> str:
    """A change in the unit in which people read it; a dash for None."""
    if change is None:
        return "-"
    factor, unit = SHOWN[quantity]
    text = _short(factor * change.value)
    return f"{text} {unit}" if with_unit else text


def _short(value: float) -> str:
    """Two digits: ``0.02``, ``41``, ``1250``; one where it is next to nothing."""
    if value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.2g}" if value >= 1e-4 or value == 0.0 else f"{value:.0e}"


def percent(share: Estimate) -> str:
    """A share of the time with its uncertainty, such as ``3.1 ± 0.4``."""
    value, spread = 100.0 * share.value, 100.0 * share.uncertainty
    digits = 0 if max(spread, abs(value) / 10.0) >= 1.0 else 1
    text = f"{value:.{digits}f}"
    return text if not spread else f"{text} \N{PLUS-MINUS SIGN} {spread:.{digits}f}"


def accuracy_text(found: Ledger) -> str:
    """What changes are measured against, and how the scene itself ran."""
    accuracies = ", ".join(
        f"{QUANTITIES[name][0]} {value:.2g} {QUANTITIES[name][1]}"
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
        return "no time that can be measured"
    size = f"{_short(abs(100.0 * share.value))} %"
    if share.value < 0.0:
        return f"{'would save' if entry.kind == CANDIDATE else 'saves'} {size} of the time"
    return f"{size} more time" if entry.kind == CANDIDATE else f"{size} of the time"


def _change(found: Ledger, entry: Entry) -> list[str]:
    """What an entry changes: the first quantity that is above the accuracy, else the path."""
    would = "would change" if entry.kind == CANDIDATE else "changes"
    if not entry.changes:
        return []
    quantity = found.moves(entry) or PATH
    change = entry.changes[quantity]
    if not any(one.value for one in entry.changes.values()):
        return [f"{would} nothing"]
    whose = f"{change.arm}'s " if change.arm else "the "
    text = f"{would} {whose}{QUANTITIES[quantity][0]} by {change_text(change, quantity)}"
    if entry.name == RECORDING and entry.kind == SETTING:
        text += " at the end"
    return [text]
