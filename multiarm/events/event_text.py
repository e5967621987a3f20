"""Text of events: which constraint changed its state, where, and from what to what."""

from __future__ import annotations

from typing import Any

from multiarm.contacts.records import (
    JointRow,
)
from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, LIMIT, Constraint
from multiarm.dynamics.contact_geometry import points_and_normals
from multiarm.events.modes import (
    AT_BOUND,
    BACKWARD,
    FORWARD,
    OPEN,
    SLIDING,
    STATE_NAMES,
    STICKING,
    Choice,
    Modes,
)
from multiarm.events.transition import Decision, Hit


def decision_events(
    modes: Modes, t: float, decision: Decision, before: Choice
) -> list[dict[str, Any]]:
    """Events of one decision.

    ``before`` has no states at the beginning of a run, of which only impacts are events.
    """
    hits, events = {hit.constraint: hit for hit in decision.hits}, []
    for u, constraint in enumerate(modes.unilateral.constraints):
        now = decision.choice.states[u]
        was = before.states[u] if before.states else now
        kind = _kind(constraint, was, now, hits.get(u), u in decision.rested)
        if kind:
            events.append(_event(modes, t, constraint, kind, was, now, hits.get(u)))
    return events


def _kind(constraint: Constraint, was: int, now: int, hit: Hit | None, rested: bool) -> str:
    """The kind of event of a constraint; empty for none."""
    if constraint.kind == DRY_JOINT:
        moved, moves = was in (FORWARD, BACKWARD), now in (FORWARD, BACKWARD)
        return "" if moved == moves else "joint slips" if moves else "joint sticks"
    if hit is not None and now == OPEN:
        return "bounces"
    if rested:
        return "comes to rest"
    if (was == OPEN) != (now == OPEN):
        if constraint.kind == LIMIT:
            return "leaves its limit" if now == OPEN else "reaches its limit"
        return "lets go" if now == OPEN else "touches"
    if hit is not None:
        return "touches"
    was, now = (STICKING if state == AT_BOUND else state for state in (was, now))
    if was in (SLIDING, STICKING) and now in (SLIDING, STICKING) and was != now:
        return "slides" if now == SLIDING else "sticks"
    return ""


def _event(
    modes: Modes, t: float, constraint: Constraint, kind: str, was: int, now: int, hit: Hit | None
) -> dict[str, Any]:
    what = (
        constraint.name
        if constraint.kind == CONTACT
        else modes.full.model.joint_name(constraint.joint)
    )
    event: dict[str, Any] = {
        "time": float(t),
        "kind": kind,
        "arm": constraint.arm,
        "contact" if constraint.kind == CONTACT else "joint": what,
        "before": {"state": STATE_NAMES[was]},
        "after": {"state": STATE_NAMES[now]},
        "text": f"{constraint.arm}: {what} {_verb(modes, constraint, kind)}",
    }
    if constraint.kind == CONTACT:
        points, _ = points_and_normals(modes.full, slice(constraint.row, constraint.row + 1))
        event["where"] = points[0].tolist()
    if hit is not None:
        turns = (
            constraint.kind != CONTACT and modes.full.model.joint_units[constraint.joint] == "rad"
        )
        unit_of_rate = "rad_s" if turns else "m_s"
        event["before"][f"gap_rate_{unit_of_rate}"] = hit.before
        event["after"][f"gap_rate_{unit_of_rate}"] = hit.after
        event["after"]["impulse"] = hit.impulse
    return event


def _verb(modes: Modes, constraint: Constraint, kind: str) -> str:
    """The event as a verb; of a joint limit with the end of the range."""
    if constraint.kind != LIMIT:
        return kind.removeprefix("joint ")
    record = modes.full.model.records[constraint.row]
    assert isinstance(record, JointRow), "a limit is a joint's"
    end = "its lower limit" if record.side > 0.0 else "its upper limit"
    return f"bounces off {end}" if kind == "bounces" else kind.replace("its limit", end)
