"""The events of a run in a report: how many of each kind, and a table of when, what, where."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from multiarm.reports.parts import grid, number
from multiarm.results.event_log import Event, Group, counts, grouped, who

SHOWN_EVENTS = 200
HEADS = ("Time", "What", "Where", "Before \N{RIGHTWARDS ARROW} after")


def events_section(events: Sequence[Event]) -> str:
    """The section of a report; empty for a run without events."""
    if not events:
        return ""
    groups = grouped(events)
    rows = [_row(group) for group in groups[:SHOWN_EVENTS]]
    table = f"<div class='events'>{grid(HEADS, rows)}</div>" if rows else ""
    told = {id(event) for group in groups for event in group.events}
    others = _others([event for event in events if id(event) not in told])
    parts = [_counted(events), table, others, _rest(groups)]
    return f"<section><h2>Events</h2>{''.join(parts)}</section>\n"


def _row(group: Group) -> tuple[str, str, str, str]:
    first, last = group.first, group.last
    time = f"{number(first['time'])} s"
    if len(group.events) > 1:
        time = f"{number(first['time'])} to {number(last['time'])} s"
    return time, group.what(), _where(first), group.change()


def _where(event: Event) -> str:
    place = event.get("where")
    if not isinstance(place, list | tuple):
        return who(event)
    at = ", ".join(f"{value:.3g}" for value in place)
    return f"{who(event)} at ({at}) m".lstrip()


def _counted(events: Sequence[Event]) -> str:
    kinds = [f"{kind.kind}: {number(kind.count)}" for kind in counts(events)]
    return f"<p class='note'>{escape(', '.join(kinds))}</p>" if len(kinds) > 1 else ""


def _rest(groups: Sequence[Group]) -> str:
    more = sum(len(group.events) for group in groups[SHOWN_EVENTS:])
    if not more:
        return ""
    return f"<p class='note'>and {number(more)} more, in the trajectory's <code>events</code></p>"


def _others(events: Sequence[dict[str, Any]]) -> str:
    """What another program wrote as events, as it is."""
    if not events:
        return ""
    items = "".join(
        f"<li>{escape(', '.join(f'{name}: {number(value)}' for name, value in event.items()))}</li>"
        for event in events[:SHOWN_EVENTS]
    )
    return f"<ol>{items}</ol>"
