"""Events of a run as people want to read them: families of kinds, words for changes, groups.

An event of `Trajectory.events` is a dict with ``time`` [s], ``kind`` and ``text``, and, where they
apply, ``arm`` ("floor" for the object's own contacts), ``contact`` or ``joint``, ``where`` (world
[m]), ``before`` and ``after``: named numbers whose unit ends the name, as in ``gap_rate_m_s``, or
words. Kinds of one family look alike in figures and replays. A contact that bounces a hundred times
is told once: events of the same contact or joint whose kinds repeat are one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

Event = dict[str, Any]
START = "start"
"""Kind of the remarks on how a run was prepared; nothing happens then."""
GROUPED = 4
"""Events that repeat so often, or oftener, are told together."""
UNITS = {
    "m_s2": "m/s²", "rad_s2": "rad/s²", "N_m_s": "N m s", "m_s": "m/s", "rad_s": "rad/s",
    "N_s": "N s", "N_m": "N m", "1_s": "1/s", "m": "m", "rad": "rad", "N": "N", "J": "J", "W": "W",
    "kg": "kg", "s": "s",
}  # fmt: skip
"""What the end of a name says of a number's unit; longer ends go first."""
STATE_SIGNS = (
    "\N{DOTTED CIRCLE}",
    "\N{BLACK CIRCLE}",
    "\N{BULLSEYE}",
    "\N{BLACK SQUARE}",
    "\N{WHITE CIRCLE}",
)
"""Of contacts, by the codes of `channels.CONTACT_STATES`."""
STATE_COLOURS = ("#8a94a0", "#3b7dd8", "#d07c1e", "#8a5fc4", "#2f9e67")
"""Of contacts, by the codes of `channels.CONTACT_STATES`."""
ARROW = "\N{RIGHTWARDS ARROW}"


@dataclass(frozen=True)
class Family:
    """Kinds of events that mean the same to a reader.

    Attributes
    ----------
    name : str
    sign : str
        One character, so that colour is not the only difference.
    colour : str
        ``#rrggbb``, readable on light and on dark ground.
    kinds : tuple of str
    """

    name: str
    sign: str
    colour: str
    kinds: tuple[str, ...] = ()


MADE, LOST, SLIP, STICK, LIMIT, ACTUATOR, OTHER = FAMILIES = (
    Family(
        "contact made", "\N{BLACK DOWN-POINTING TRIANGLE}", "#1f9d57",
        ("touches", "bounces", "comes to rest", "pushes again", "is back on its patch"),
    ),
    Family(
        "contact lost", "\N{WHITE UP-POINTING TRIANGLE}", "#d1495b",
        ("lets go", "pulls", "leaves its patch"),
    ),
    Family("slip", "\N{WHITE DIAMOND}", "#d07c1e", ("slides", "joint slips")),
    Family("stick", "\N{BLACK DIAMOND}", "#8a5fc4", ("sticks", "joint sticks")),
    Family(
        "limit", "\N{BLACK SQUARE}", "#3b7dd8",
        ("reaches its limit", "leaves its limit", "passes its limit", "is back within its limit"),
    ),
    Family(
        "saturation", "\N{WHITE SQUARE}", "#14939c", ("saturates", "is no longer saturated"),
    ),
    Family("other", "+", "#7a8797"),
)  # fmt: skip


def family_of(kind: str) -> Family:
    """The family of a kind of event; "other" for one that is not known."""
    return _families().get(kind, OTHER)


def timed(events: Iterable[Event]) -> list[Event]:
    """Those of a run's events that happened at a time and are more than remarks on its start."""
    return [event for event in events if _is_told(event) and event["kind"] != START]


def who(event: Event) -> str:
    """Whose event it is: ``left: fingertip_2``, ``floor: corner_1``, an arm, or nothing."""
    part = event.get("contact", event.get("joint"))
    return ": ".join(str(name) for name in (event.get("arm"), part) if name is not None)


def what(event: Event) -> str:
    """What happened, without whom: the event's text as far as it says more than `who`."""
    text, whose = str(event["text"]), who(event)
    for opening in (f"{whose} ", f"{event.get('arm')}: "):
        if whose and text.startswith(opening) and len(text) > len(opening):
            return text[len(opening) :]
    return text


def change(event: Event) -> str:
    """Before and after in words: ``gap rate -0.31 → 0.22 m/s, impulse 1.2 N s``."""
    before, after = (_named(event.get(key)) for key in ("before", "after"))
    parts = []
    for key in dict.fromkeys([*before, *after]):
        name, unit = _name_and_unit(key)
        sides = [_value(side[key]) for side in (before, after) if key in side]
        if name == "state" and len(sides) == 2 and sides[0] == sides[1]:
            continue
        value = f" {ARROW} ".join(sides) + f" {unit}".rstrip()
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
    first: dict[str, Event] = {}
    number: dict[str, int] = {}
    for event in timed(events):
        first.setdefault(event["kind"], event)
        number[event["kind"]] = number.get(event["kind"], 0) + 1
    return [Count(kind, number[kind], event) for kind, event in first.items()]


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
    told = [event for event in events if _is_told(event)]
    by_whom: dict[str, list[int]] = {}
    for place, event in enumerate(told):
        # what happened to no one in particular is told one by one
        by_whom.setdefault(who(event) or f"\0{place}", []).append(place)
    groups = [part for places in by_whom.values() for part in _repeating(told, places)]
    return [Group(tuple(told[i] for i in places)) for places in sorted(groups)]


def _repeating(told: Sequence[Event], places: Sequence[int]) -> list[list[int]]:
    """The places of some events, cut into stretches of one kind, or of two that take turns.

    What is too short for a stretch stands alone.
    """
    kinds = [told[i]["kind"] for i in places]
    parts, begin = [], 0
    while begin < len(places):
        end = begin + 2
        while end < len(places) and kinds[end] == kinds[end - 2]:
            end += 1
        if min(end, len(places)) - begin < GROUPED:
            end = begin + 1
        parts.append(list(places[begin:end]))
        begin = end
    return parts


def _is_told(event: Event) -> bool:
    return {"time", "kind", "text"} <= event.keys() and isinstance(event["time"], int | float)


def _named(values: Any) -> Mapping[str, Any]:
    return values if isinstance(values, Mapping) else {} if values is None else {"state": values}


def _name_and_unit(key: str) -> tuple[str, str]:
    for end, unit in UNITS.items():
        if key.endswith(f"_{end}"):
            return key.removesuffix(f"_{end}").replace("_", " "), unit
    return key.replace("_", " "), ""


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float | int):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return "(" + ", ".join(_value(item) for item in value) + ")"
    return str(value)


@cache
def _families() -> dict[str, Family]:
    return {kind: family for family in FAMILIES for kind in family.kinds}
