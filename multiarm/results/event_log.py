"""What happened in a run, in words: kept up to a number, counted beyond it.

A run that chatters makes events without end. A result lists the first of them, and says of the rest
how many there were of which kind, so that neither its events nor its message grow with them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from textwrap import shorten
from typing import Any

# Events listed in a result; more are counted.
MOST_LISTED = 1000
# Contacts, arms or kinds named in one part of a message.
NAMED = 3
# A message has at least so much room for what happened [characters].
LEAST_ROOM = 60
# What kinds of events mean for the run as a whole.
_MEANINGS = {
    "pulls": "contacts that can only push were pulled, where real ones would come apart",
    "leaves its patch": "contact points left the patch of their surface",
    "passes its limit": "joints passed their limits, which are not enforced",
    "saturates": "drives came to their torque limits",
    "loses a direction": "arms could not follow their joint in every direction",
    "passes a singular posture": "singular postures were passed",
    "rank falls": "the chains lost constraints on the way",
}


class EventLog:
    """Events of one run.

    Attributes
    ----------
    listed : list of dict
        ``time`` [s], ``kind``, ``text`` and more, see :mod:`multiarm.results.event_text`; the first
        ``MOST_LISTED``.
    dropped : Counter
        How many more there were, by kind and arm ("" for events of no arm).
    """

    def __init__(self) -> None:
        self.listed: list[dict[str, Any]] = []
        self.dropped: Counter[tuple[str, str]] = Counter()
        self._span = (0.0, 0.0)

    def add(self, events: Sequence[dict[str, Any]]) -> None:
        """Take over events, in order of time."""
        room = MOST_LISTED - len(self.listed)
        self.listed += events[:room]
        for event in events[room:]:
            self.drop(event["time"], event["kind"], event.get("arm", ""))

    def drop(self, time: float, kind: str, arm: str = "", count: int = 1) -> None:
        """Count events that are not listed."""
        self._span = (self._span[0] if self.dropped else time, time)
        self.dropped[kind, arm] += count

    def all(self) -> list[dict[str, Any]]:
        """Events in order of time, then one that says how many are not listed."""
        events = sorted(self.listed, key=lambda event: event["time"])
        if self.dropped:
            events.append({"time": self._span[1], "kind": "not listed", "text": self._rest()})
        return events

    def summary(self, room: int) -> str:
        """What the message of the result must say, in ``room`` characters; empty if nothing."""
        parts = [f"; {self._rest()}"] if self.dropped else []
        for kind, meaning in _MEANINGS.items():
            first: dict[str, float] = {}
            for event in self.listed:
                if event["kind"] == kind:
                    first.setdefault(event["text"].replace(f" {kind}", ""), event["time"])
            if first:
                names = [f"{name} (from {t:.4g} s)" for name, t in first.items()]
                parts.append(f"; {meaning}: {_some(names)}")
        if not parts:
            return ""
        return shorten("".join(parts), max(room, LEAST_ROOM), placeholder=" ... (see `events`)")

    def _rest(self) -> str:
        """The events that are not listed, in words."""
        begin, end = self._span
        names = [
            f"{count:,} times '{kind}'" + (f" ({arm})" if arm else "")
            for (kind, arm), count in self.dropped.most_common()
        ]
        return (
            f"{self.dropped.total():,} more events from t = {begin:.4g} s to {end:.4g} s are not "
            f"listed: {_some(names)}"
        )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"
