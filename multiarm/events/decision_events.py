"""The events of a decision: what contacts and joints begin to do, for the log of a run."""

from __future__ import annotations

from multiarm.contacts.table import JointRow
from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, LIMIT, Constraint
from multiarm.dynamics.contact_geometry import points_and_normals
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.objects_at_rest import STANDS_STILL
from multiarm.events.taking_hold import Switch
from multiarm.events.transition import Decision, Hit
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import RunEvent, Side


def decision_events(modes: Modes, t: float, decision: Decision, before: Mode) -> list[RunEvent]:
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


def switch_events(modes: Modes, t: float, switch: Switch, decision: Decision) -> list[RunEvent]:
    """Events of timed joints that take hold and let go; the loss is that of all at this instant."""
    names = [joint.connection for joint in modes.unilateral.timed]
    impulses, lost, events = {}, 0.0, []
    if switch.impact is not None:
        impulses = switch.impact.impulses(decision.impulses)
        lost = switch.impact.energy_lost - decision.energy
    for k in sorted(switch.taking):
        event = RunEvent(
            t,
            EventKind.ATTACHED,
            arm=names[k],
            where=modes.where(k),
            impulse=tuple(impulses[names[k]].tolist()),
            energy_loss=lost,
            at=modes.place_of(k),
        )
        events.append(event)
    for k in sorted(switch.letting):
        event = RunEvent(
            t,
            EventKind.DETACHED,
            arm=names[k],
            where=modes.where(k),
            impulse=(0.0,) * 6,
            energy_loss=0.0,
        )
        events.append(event)
    return events


def rest_event(modes: Modes, t: float, name: str, on: tuple[str, ...]) -> RunEvent:
    """The event of an object that rests from now on."""
    layout, state = modes.full.model.layout, modes.full.arrays.state
    where = layout.poses(state.configuration)[layout.objects.index(name), :3]
    words = " and ".join(f"the {body}" if body in STANDS_STILL else body for body in on)
    return RunEvent(
        t, EventKind.AT_REST, f"at rest on {words}", where=tuple(where.tolist()), object=name, on=on
    )


def _kind(
    constraint: Constraint, was: ContactState, now: ContactState, hit: Hit | None, rested: bool
) -> EventKind | None:
    """The kind of event of a constraint; None for none."""
    if constraint.kind == DRY_JOINT:
        if was.moves == now.moves:
            return None
        return EventKind.JOINT_SLIPS if now.moves else EventKind.JOINT_STICKS
    if hit is not None and now == ContactState.OPEN:
        return EventKind.BOUNCES
    if rested:
        return EventKind.COMES_TO_REST
    if (was == ContactState.OPEN) != (now == ContactState.OPEN):
        if constraint.kind == LIMIT:
            opens = now == ContactState.OPEN
            return EventKind.LEAVES_LIMIT if opens else EventKind.REACHES_LIMIT
        return EventKind.LETS_GO if now == ContactState.OPEN else EventKind.TOUCHES
    if hit is not None:
        return EventKind.TOUCHES
    was, now = was.recorded, now.recorded
    if {was, now} == {ContactState.SLIDING, ContactState.STICKING}:
        return EventKind.SLIDES if now == ContactState.SLIDING else EventKind.STICKS
    return None


def _event(
    modes: Modes,
    t: float,
    constraint: Constraint,
    kind: EventKind,
    was: ContactState,
    now: ContactState,
    hit: Hit | None,
) -> RunEvent:
    model, is_contact = modes.full.model, constraint.kind == CONTACT
    name = constraint.name if is_contact else model.joint_name(constraint.joint)
    where = None
    if is_contact:
        points, _ = points_and_normals(modes.full, slice(constraint.row, constraint.row + 1))
        where = tuple(points[0].tolist())
    before, after = Side(was), Side(now)
    if hit is not None:
        before, after = Side(was, hit.before), Side(now, hit.after, hit.impulse)
    return RunEvent(
        float(t),
        kind,
        _verb(modes, constraint, kind),
        constraint.owner,
        contact=name if is_contact else "",
        joint="" if is_contact else name,
        where=where,
        sides=(before, after),
        turns=not is_contact and model.joint_units[constraint.joint] == "rad",
    )


def _verb(modes: Modes, constraint: Constraint, kind: EventKind) -> str:
    """The event as a verb, of a joint limit with the end of the range; empty: that of its kind."""
    verbs = {EventKind.JOINT_SLIPS: "slips", EventKind.JOINT_STICKS: "sticks"}
    if constraint.kind == LIMIT:
        record = modes.full.model.records[constraint.row]
        assert isinstance(record, JointRow), "a limit is a joint's"
        end = "its lower limit" if record.side > 0.0 else "its upper limit"
        verbs = {
            EventKind.BOUNCES: f"bounces off {end}",
            EventKind.REACHES_LIMIT: f"reaches {end}",
            EventKind.LEAVES_LIMIT: f"leaves {end}",
        }
    return verbs.get(kind, "")
