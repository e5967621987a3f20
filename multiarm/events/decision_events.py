"""The events of a decision: what contacts and joints begin to do, for the log of a run."""

from __future__ import annotations

from typing import Any

from multiarm.contacts.table import JointRow
from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, LIMIT, Constraint
from multiarm.dynamics.contact_geometry import points_and_normals
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.transition import Decision, Hit
from multiarm.results.channels import ContactState


def decision_events(
    modes: Modes, t: float, decision: Decision, before: Mode
) -> list[dict[str, Any]]:
    """Events of one decision.

    ``before`` has no states at the beginning of a run, of which only impacts are events.
    """
    hits, events = {hit.constraint: hit for hit in decision.hits}, []
    for u, constraint in enumerate(modes.unilateral.constraints):
        now = decision.mode.states[u]
        was = before.states[u] if before.states else now
        kind = _kind(constraint, was, now, hits.get(u), u in decision.rested)
        if kind:
            events.append(_event(modes, t, constraint, kind, was, now, hits.get(u)))
    return events


def _kind(
    constraint: Constraint, was: ContactState, now: ContactState, hit: Hit | None, rested: bool
) -> str:
    """The kind of event of a constraint; empty for none."""
    if constraint.kind == DRY_JOINT:
        return "" if was.moves == now.moves else "joint slips" if now.moves else "joint sticks"
    if hit is not None and now == ContactState.OPEN:
        return "bounces"
    if rested:
        return "comes to rest"
    if (was == ContactState.OPEN) != (now == ContactState.OPEN):
        if constraint.kind == LIMIT:
            return "leaves its limit" if now == ContactState.OPEN else "reaches its limit"
        return "lets go" if now == ContactState.OPEN else "touches"
    if hit is not None:
        return "touches"
    was, now = was.recorded, now.recorded
    if {was, now} == {ContactState.SLIDING, ContactState.STICKING}:
        return "slides" if now == ContactState.SLIDING else "sticks"
    return ""


def _event(
    modes: Modes,
    t: float,
    constraint: Constraint,
    kind: str,
    was: ContactState,
    now: ContactState,
    hit: Hit | None,
) -> dict[str, Any]:
    name = (
        constraint.name
        if constraint.kind == CONTACT
        else modes.full.model.joint_name(constraint.joint)
    )
    event: dict[str, Any] = {
        "time": float(t),
        "kind": kind,
        "arm": constraint.arm,
        "contact" if constraint.kind == CONTACT else "joint": name,
        "before": {"state": was.word},
        "after": {"state": now.word},
        "text": f"{constraint.arm}: {name} {_verb(modes, constraint, kind)}",
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
    verbs = {"joint slips": "slips", "joint sticks": "sticks"}
    if constraint.kind == LIMIT:
        record = modes.full.model.records[constraint.row]
        assert isinstance(record, JointRow), "a limit is a joint's"
        end = "its lower limit" if record.side > 0.0 else "its upper limit"
        verbs = {
            "bounces": f"bounces off {end}",
            "reaches its limit": f"reaches {end}",
            "leaves its limit": f"leaves {end}",
        }
    return verbs.get(kind, kind)
