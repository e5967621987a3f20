"""Events of a run: the first ones are listed, the others counted; their text.

An event of `Trajectory.events` is a dict with ``time`` [s], ``kind``, ``text`` (and ``what``, the
text without arm, contact and joint), and, where they apply, ``arm`` ("floor" for the object's own
contacts), ``contact`` or ``joint``, ``where`` (world [m]), ``before`` and ``after``: named numbers
whose unit ends the name, as in ``gap_rate_m_s``, or words.  Where a joint takes hold or lets go,
``arm`` is its name, ``impulse`` (6,) what it exerts on its second body, as ``wrenches`` has forces
[N s, N m s], ``energy_loss`` the energy lost by it [J], ``where`` its place in the world, and
``at``, of one that holds its bodies where they are, its place on the second body: a pose as a scene
writes it, with ``xyz`` [m] and ``quaternion_xyzw``.  Where an object comes to rest, ``object`` is
its name, and ``on`` a list of what it rests on.

A run that chatters makes very many events: `EventLog` lists the first ones and counts the others
by kind, so that neither a result nor its message grows with them. Figures and replays show a
contact that bounces a hundred times as one group: events of the same contact or joint whose kinds
repeat.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

from multiarm.notation import count_of, number, value_text
from multiarm.results.contact_states import ContactState
from multiarm.results.event_kinds import EventKind

Event = dict[str, Any]
"""An event of a result, see above."""
ALWAYS_LISTED = (EventKind.ATTACHED, EventKind.DETACHED)
MOST_LISTED = 1000
"""Events listed in a result; more are counted."""
CLAUSE_SEPARATOR = "; "
"""Between the clauses of a result's message."""
# Kinds of events that the result's message mentions, and how.
_MEANINGS = {
    EventKind.PULLS: "contacts that can only push were pulled, where real ones would come apart",
    EventKind.LEAVES_PATCH: "contact points left the patch of their surface",
    EventKind.PASSES_LIMIT: "joints passed their limits, which are not enforced",
    EventKind.SATURATES: "drives came to their torque limits",
    EventKind.LOSES_DIRECTION: (
        "arms could not follow their joints in every direction, or their joints repeat each other"
    ),
    EventKind.PASSES_SINGULAR_POSTURE: "singular postures were passed",
    EventKind.RANK_FALLS: "the chains lost constraints on the way",
}
# The unit of a number, by the end of its name; longer ends first.
_UNITS = {
    "m_s2": "m/s²", "rad_s2": "rad/s²", "N_m_s": "N m s", "m_s": "m/s", "rad_s": "rad/s",
    "N_s": "N s", "N_m": "N m", "1_s": "1/s", "m": "m", "rad": "rad", "N": "N", "J": "J", "W": "W",
    "kg": "kg", "s": "s",
}  # fmt: skip


@dataclass(frozen=True)
class Side:
    """What a contact or a joint did before or after an event.

    Attributes
    ----------
    state : ContactState
    gap_rate : float or None
        At an impact [m/s]; of a joint that turns [rad/s].
    impulse : float or None
        [N s]; of a joint that turns [N m s]
    """

    state: ContactState
    gap_rate: float | None = None
    impulse: float | None = None


@dataclass(frozen=True)
class RunEvent:
    """An event as a run logs it; results have its :meth:`entry`.

    Attributes
    ----------
    time : float
        [s]
    kind : EventKind
    words : str
        What happened, where the word of the kind does not say it all.
    arm : str
        Empty for none, as ``contact`` and ``joint``; "floor" for the object's own contacts.
    body : str
        Whose surface a contact has left, or come back to: "object", "arm", "world", or the link of
        a robot; else empty.
    where : tuple of float or None
        World [m].
    sides : tuple of Side or None
        Before and after.
    turns : bool
        The joint turns.
    impulse : tuple of 6 floats or None
        Of a joint that takes hold or lets go, on its second body, as its wrench [N s, N m s].
    energy_loss : float or None
        By all that happens at that instant [J].
    numbers : mapping
        Named numbers after an event without sides; units end their names.
    at : tuple of 7 floats or None
        Its pose on the second body, position [m] and quaternion xyzw.
    object : str
        That has come to rest; else empty.
    on : tuple of str
        What it rests on: other objects, "floor", or "world".
    """

    time: float
    kind: EventKind
    words: str = ""
    arm: str = ""
    contact: str = ""
    joint: str = ""
    body: str = ""
    where: tuple[float, ...] | None = None
    sides: tuple[Side, Side] | None = None
    turns: bool = False
    impulse: tuple[float, ...] | None = None
    energy_loss: float | None = None
    numbers: Mapping[str, float] | None = None
    at: tuple[float, ...] | None = None
    object: str = ""
    on: tuple[str, ...] = ()

    @property
    def who(self) -> str:
        """Arm, contact or joint: ``left: fingertip_2``, or an object; empty for none."""
        owner = self.arm or self.object
        return ": ".join(name for name in (owner, self.contact or self.joint) if name)

    @property
    def what(self) -> str:
        """What happened: ``leaves its patch (on the object)``."""
        return (self.words or self.kind.word) + self._on_body

    @property
    def text(self) -> str:
        """The event in words."""
        if not self.who:
            return self.what
        return f"{self.who}{' ' if self.contact or self.joint else ': '}{self.what}"

    @property
    def subject(self) -> str:
        """Whose event it is, for a clause that says what its kind means; or all its words."""
        if self.words:
            return self.text
        return self.who + self._on_body

    @property
    def _on_body(self) -> str:
        return f" (on the {self.body})" if self.body else ""

    def entry(self) -> Event:
        """The event as results have it."""
        names = {"arm": self.arm, "contact": self.contact, "joint": self.joint}
        names |= {"object": self.object}
        before, after = None, None if self.numbers is None else dict(self.numbers)
        if self.sides is not None:
            before, after = map(self._entry_of, self.sides)
        where = None if self.where is None else list(self.where)
        impulse = None if self.impulse is None else list(self.impulse)
        optional: dict[str, Any] = {"before": before, "after": after, "where": where}
        at = None if self.at is None else {"xyz": [*self.at[:3]], "quaternion_xyzw": [*self.at[3:]]}
        optional |= {"impulse": impulse, "energy_loss": self.energy_loss, "at": at}
        optional["on"] = list(self.on) or None
        return {
            "time": self.time,
            "kind": self.kind.word,
            "text": self.text,
            "what": self.what,
            **{key: name for key, name in names.items() if name},
            **{key: value for key, value in optional.items() if value is not None},
        }

    def _entry_of(self, side: Side) -> dict[str, Any]:
        of_rate, of_impulse = ("rad_s", "N_m_s") if self.turns else ("m_s", "N_s")
        numbers = {f"gap_rate_{of_rate}": side.gap_rate, f"impulse_{of_impulse}": side.impulse}
        known = {key: value for key, value in numbers.items() if value is not None}
        return {"state": side.state.word, **known}


class EventLog:
    """Events of one run.

    Attributes
    ----------
    listed : list of RunEvent
        The first ``MOST_LISTED``, and all that tell when joints hold and objects rest.
    dropped : Counter
        How many more there were, by kind and arm ("" for events of no arm).
    """

    def __init__(self) -> None:
        self.listed: list[RunEvent] = []
        self.dropped: Counter[tuple[EventKind, str]] = Counter()
        self._span = (0.0, 0.0)

    def add(self, *events: RunEvent) -> None:
        """Append events, in order of time."""
        for event in events:
            if len(self.listed) < MOST_LISTED or event.kind in ALWAYS_LISTED:
                self.listed.append(event)
                continue
            self._span = (self._span[0] if self.dropped else event.time, event.time)
            self.dropped[event.kind, event.arm] += 1

    def entries(self) -> list[Event]:
        """Events in order of time; the last one states how many more there were."""
        events = sorted(self.listed, key=lambda event: event.time)
        if self.dropped:
            events.append(RunEvent(self._span[1], EventKind.NOT_LISTED, self._not_listed()))
        return [event.entry() for event in events]

    def remarks(self, room: int) -> list[str]:
        """Clauses for the result's message; one that is cut where they exceed ``room`` characters.

        The separators count.
        """
        clauses = [self._not_listed()] if self.dropped else []
        for kind, meaning in _MEANINGS.items():
            first: dict[str, float] = {}
            for event in self.listed:
                if event.kind is kind:
                    first.setdefault(event.subject, event.time)
            if first:
                names = [f"{name} (from {t:.4g} s)" for name, t in first.items()]
                clauses.append(f"{meaning}: {_some(names)}")
        text, most = CLAUSE_SEPARATOR.join(clauses), max(room, 60) - len(CLAUSE_SEPARATOR)
        if len(text) <= most:
            return clauses
        return [shorten(text, most, placeholder=" ... (see `events`)")]

    def _not_listed(self) -> str:
        """The events that are not listed, in words."""
        begin, end = self._span
        names = [
            f"{count:,} times '{kind.word}'" + (f" ({arm})" if arm else "")
            for (kind, arm), count in self.dropped.most_common()
        ]
        return (
            f"not listed: {count_of(self.dropped.total(), 'event')} from t = {begin:.4g} s to "
            f"{end:.4g} s: {_some(names)}"
        )


def timed(events: Iterable[Event]) -> list[Event]:
    """The events of the motion: with a time, and no remarks on the start."""
    return [
        event for event in events if _is_complete(event) and event["kind"] != EventKind.START.word
    ]


def who(event: Event) -> str:
    """Whose it is: ``left: fingertip_2``, ``floor: corner_1``, an arm, an object; or empty."""
    owner, part = event.get("arm", event.get("object")), event.get("contact", event.get("joint"))
    return ": ".join(str(name) for name in (owner, part) if name is not None)


def what(event: Event) -> str:
    """What happened, without what :func:`who` gives.

    Earlier versions stored both in one text: of their events it is the kind, if it is somebody's.
    """
    return str(event.get("what", event["kind"] if who(event) else event["text"]))


def change(event: Event) -> str:
    """Before and after as text: ``gap rate -0.31 → 0.22 m/s, impulse 1.2 N s``."""
    before, after = (_named(event.get(key)) for key in ("before", "after"))
    parts = []
    for key in dict.fromkeys([*before, *after]):
        name, unit = _name_and_unit(key)
        sides = [_value(side[key]) for side in (before, after) if key in side]
        if name == "state" and len(sides) == 2 and sides[0] == sides[1]:
            continue
        value = " \N{RIGHTWARDS ARROW} ".join(sides) + f" {unit}".rstrip()
        was = "was " if key not in after and after else ""
        parts.append(value if name == "state" else f"{name} {was}{value}")
    return ", ".join(parts)


@dataclass(frozen=True)
class Count:
    """How often a kind of event happened in a run, and the first of them."""

    kind: str
    count: int
    first: Event


def counts(events: Iterable[Event]) -> list[Count]:
    """The kinds of a run's events, in order of their first time."""
    by_kind: dict[str, list[Event]] = {}
    for event in timed(events):
        by_kind.setdefault(event["kind"], []).append(event)
    return [Count(kind, len(same_kind), same_kind[0]) for kind, same_kind in by_kind.items()]


@dataclass(frozen=True)
class Group:
    """One event, or a stretch of events of the same contact or joint whose kinds repeat."""

    events: tuple[Event, ...]

    @property
    def first(self) -> Event:
        """The first event of the group."""
        return self.events[0]

    @property
    def last(self) -> Event:
        """The last event of the group."""
        return self.events[-1]

    def what(self) -> str:
        """What happened: ``bounces, 57 times``; ``sticks and slides in turn, 30 events``."""
        if len(self.events) == 1:
            return what(self.first)
        first, second = (event["kind"] for event in self.events[:2])
        if first == second:
            return f"{first}, {len(self.events)} times"
        return f"{first} and {second} in turn, {len(self.events)} events"

    def change(self) -> str:
        """Before and after, of the first and the last event."""
        ends = [change(self.first), change(self.last)]
        if len(self.events) == 1 or ends[0] == ends[1]:
            return ends[0]
        named = zip(("first", "last"), ends, strict=True)
        return "; ".join(f"{name}: {words}" for name, words in named if words)


def grouped(events: Iterable[Event]) -> list[Group]:
    """Events with a time as groups, in order of the first time of each."""
    known = [event for event in events if _is_complete(event)]
    places_of: dict[str, list[int]] = {}
    for place, event in enumerate(known):
        # events of no contact, joint or arm each stand alone
        places_of.setdefault(who(event) or f"\0{place}", []).append(place)
    stretches = [part for places in places_of.values() for part in _repeating(known, places)]
    return [Group(tuple(known[i] for i in places)) for places in sorted(stretches)]


def _repeating(events: Sequence[Event], places: Sequence[int]) -> list[list[int]]:
    """Places of events, cut into stretches of one kind, or of two that alternate.

    Events of a stretch that is too short stand alone.
    """
    kinds = [events[i]["kind"] for i in places]
    parts, begin = [], 0
    while begin < len(places):
        end = begin + 2
        while end < len(places) and kinds[end] == kinds[end - 2]:
            end += 1
        if min(end, len(places)) - begin < 4:
            end = begin + 1
        parts.append(list(places[begin:end]))
        begin = end
    return parts


def _some(names: Sequence[str]) -> str:
    """The first three names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}"


def _is_complete(event: Event) -> bool:
    """Whether an event can be shown; files may have been written by other programs."""
    return {"time", "kind", "text"} <= event.keys() and isinstance(event["time"], int | float)


def _named(values: Any) -> Mapping[str, Any]:
    return values if isinstance(values, Mapping) else {} if values is None else {"state": values}


def _name_and_unit(key: str) -> tuple[str, str]:
    for end, unit in _UNITS.items():
        if key.endswith(f"_{end}"):
            return key.removesuffix(f"_{end}").replace("_", " "), unit
    return key.replace("_", " "), ""


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_value, value))})"
    return number(value) if isinstance(value, float) else value_text(value)
