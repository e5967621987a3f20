"""Events in words: what changed for whom, where, and how it was before and after."""

from __future__ import annotations

from typing import Any

from multiarm.candidates.units import CONTACT, DRY_JOINT, LIMIT, Unit
from multiarm.contacts.kernel import AT
from multiarm.hybrid.modes import (
    BACKWARD,
    FORWARD,
    OPEN,
    SLIDING,
    STATE_NAMES,
    STICKING,
    Choice,
    Modes,
)
from multiarm.hybrid.transition import Decision, Hit


def decision_events(
    modes: Modes, t: float, decision: Decision, before: Choice
) -> list[dict[str, Any]]:
    """Events of one decision; nothing is told of what a run begins with but impacts.

    ``before`` has no states at the beginning of a run.
    """
    hits, events = {hit.unit: hit for hit in decision.hits}, []
    for u, unit in enumerate(modes.plan.units):
        now = decision.choice.states[u]
        was = before.states[u] if before.states else now
        kind = _kind(unit, was, now, hits.get(u), u in decision.rested)
        if kind:
            events.append(_event(modes, t, unit, kind, was, now, hits.get(u)))
    return events


def _kind(unit: Unit, was: int, now: int, hit: Hit | None, rested: bool) -> str:
    """What happened to a unit; empty: nothing."""
    if unit.kind == DRY_JOINT:
        moved, moves = was in (FORWARD, BACKWARD), now in (FORWARD, BACKWARD)
        return "" if moved == moves else "joint slips" if moves else "joint sticks"
    if hit is not None and now == OPEN:
        return "bounces"
    if rested:
        return "comes to rest"
    if (was == OPEN) != (now == OPEN):
        if unit.kind == LIMIT:
            return "leaves its limit" if now == OPEN else "reaches its limit"
        return "lets go" if now == OPEN else "touches"
    if hit is not None:
        return "touches"
    if was in (SLIDING, STICKING) and now in (SLIDING, STICKING) and was != now:
        return "slides" if now == SLIDING else "sticks"
    return ""


def _event(
    modes: Modes, t: float, unit: Unit, kind: str, was: int, now: int, hit: Hit | None
) -> dict[str, Any]:
    what = unit.name if unit.kind == CONTACT else modes.full.joint_name(unit.joint)
    event: dict[str, Any] = {
        "time": float(t),
        "kind": kind,
        "arm": unit.arm,
        "contact" if unit.kind == CONTACT else "joint": what,
        "before": {"state": STATE_NAMES[was]},
        "after": {"state": STATE_NAMES[now]},
        "text": f"{unit.arm}: {what} {_WORDS.get(kind, kind)}",
    }
    if unit.kind == CONTACT:
        event["where"] = [float(x) for x in modes.full.buffers.contacts[unit.row, AT : AT + 3]]
    if hit is not None:
        unit_of_rate = "m_s" if unit.kind == CONTACT else "1_s"
        event["before"][f"gap_rate_{unit_of_rate}"] = hit.before
        event["after"][f"gap_rate_{unit_of_rate}"] = hit.after
        event["after"]["impulse"] = hit.impulse
    return event


_WORDS = {"joint slips": "slips", "joint sticks": "sticks"}
