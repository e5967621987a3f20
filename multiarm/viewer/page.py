"""Write commands as one HTML file that needs no server and no network.

The page holds Meshcat's own viewer, a small player (the template ``replay.html``), the commands and
the facts that the player shows.  Typed arrays are stored in one block of bytes, to which the JSON
refers.  Equal arrays are stored once, so that arms of a kind share their meshes.  The block is
compressed; the browser unpacks it.

A run may have thousands of events.  The page gets a bounded number of ticks, each for all events of
a short interval, and of rows, each for a group of events of one contact or joint.
"""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import ReplayError
from multiarm.notation import count_of, number
from multiarm.reports import pages
from multiarm.results.contact_states import STATE_STYLES, ContactState
from multiarm.results.event_kinds import FAMILIES, family_of
from multiarm.results.event_log import Event, Group, grouped, timed, who
from multiarm.viewer.animation import Animation, ContactTracks, Dial, HingeTracks
from multiarm.viewer.commands import Command, array_type, hexadecimal, lowered
from multiarm.viewer.drawing import ASPECT

ALIGNMENT = 8  # [bytes] of the arrays in the block


def render(commands: list[Command], facts: dict[str, Any]) -> str:
    """Return the text of the page: the commands in order, and the facts of :func:`page_facts`."""
    block = _Block()
    shown = lowered({"facts": facts, "commands": commands}, block.place)
    text = json.dumps(shown, allow_nan=False)
    header = text.encode()
    payload = len(header).to_bytes(ALIGNMENT, "little") + header
    payload += b" " * (-len(payload) % ALIGNMENT) + bytes(block.data)
    return pages.render(
        "replay.html",
        title=facts["title"],
        viewer=_viewer_script(),
        payload=base64.b64encode(gzip.compress(payload, mtime=0)).decode(),
    )


def page_facts(animation: Animation, speed: float) -> dict[str, Any]:
    """Return what the player shows besides the commands.

    ``title``, ``note``, ``start`` [s], ``speed``, ``aspect``, ``legend`` (name and colour of each
    arm, and its largest force on the object in words, null where unknown), ``scale`` (what the
    longest arrow stands for, in words), ``times`` (K,) [s], ``states`` of contacts (name, sign,
    colour), ``events`` (see :func:`time_line`) and ``dials``: coordinates with limits, each a table
    of ``arm``, ``unit``, ``limits``, ``passed_at`` (values beyond which a limit is passed) and
    ``values`` (K,).
    """
    totals = [_largest_total(contacts) for contacts in animation.contacts]
    return {
        "title": animation.title,
        "note": animation.note,
        "start": float(animation.time[0]),
        "speed": speed,
        "aspect": ASPECT,
        "legend": [
            [c.arm, f"#{hexadecimal(c.color):06x}", total and _newtons(total)]
            for c, total in zip(animation.contacts, totals, strict=True)
        ],
        "scale": _scale(animation, totals),
        "times": animation.time - animation.time[0],
        "states": _states(animation),
        "events": time_line(animation.events, animation.time, speed),
        "dials": [_dial(hinge, dial) for hinge in animation.hinges for dial in hinge.dials],
    }


def _largest_total(contacts: ContactTracks) -> float | None:
    """Return the largest force of an arm on the object [N]."""
    if contacts.total is None:
        return None
    return float(np.linalg.norm(contacts.total, axis=1).max())


_newtons = partial(number, unit="N")


def _scale(animation: Animation, totals: Sequence[float | None]) -> str:
    """What the longest arrow stands for; empty without forces."""
    if not animation.force_scale > 0.0:
        return ""
    peak = animation.peak_force
    spike = f" (peak {_newtons(peak)})" if peak > animation.force_scale else ""
    text = f"longest arrow {_newtons(animation.force_scale)} at a contact{spike}"
    known = {c.arm: total for c, total in zip(animation.contacts, totals, strict=True) if total}
    if not known:
        return text
    arm = max(known, key=lambda name: known[name])
    return f"{text}; {arm} up to {_newtons(known[arm])} in all"


def _states(animation: Animation) -> list[list[str]]:
    """Return name, sign and colour of each state that a contact of the animation has."""
    codes = {
        int(code) for c in animation.contacts if c.state is not None for code in set(c.state.flat)
    }
    states = map(ContactState, sorted(codes))
    return [[s.word, STATE_STYLES[s].sign, STATE_STYLES[s].colour] for s in states]


def _dial(hinge: HingeTracks, dial: Dial) -> dict[str, Any]:
    """Return a joint's coordinate in degrees or millimetres."""
    scale, unit = (180 / math.pi, "°") if dial.turns else (1000.0, " mm")
    return {
        "arm": hinge.arm,
        "unit": unit,
        "limits": [scale * limit for limit in dial.limits],
        "passed_at": [scale * limit for limit in dial.passed_at],
        "values": scale * dial.value,
    }


class _Block:
    """Bytes of all arrays, each content once."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.places: dict[tuple[str, bytes], int] = {}

    def place(self, values: np.ndarray) -> dict[str, Any]:
        """Store an array; returns what refers to it."""
        kind, content = array_type(values), values.tobytes()
        place = self.places.setdefault((kind, content), len(self.data))
        if place == len(self.data):
            self.data += content + bytes(-len(content) % ALIGNMENT)
        return {"typed": kind, "start": place, "length": values.size}


def _viewer_script() -> str:
    # Importing Meshcat would start ZeroMQ and print warnings: its file is all that is needed.
    package = importlib.util.find_spec("meshcat")
    if package is None or package.origin is None:
        raise ReplayError("a replay needs the package meshcat; install it: pip install meshcat")
    viewer = Path(package.origin).parent / "viewer" / "dist" / "main.min.js"
    return viewer.read_text("utf-8").replace("</script", "<\\/script")


MOST_TICKS = 160
MOST_ROWS = 300
NAMED = 3  # kinds in the words of a tick


def time_line(events: Sequence[Event], time: np.ndarray, speed: float) -> dict[str, Any]:
    """Return a run's events for the page: ticks, rows of a list, and the legend of signs.

    Times are those of the viewer, in seconds after the first frame, of the first frame at or after
    an event. ``time`` is that of the frames [s], ``speed`` its seconds per second of the viewer.
    """
    events = timed(events)
    shown = _frames(time, [event["time"] for event in events])
    groups = grouped(events)
    first = _frames(time, [group.first["time"] for group in groups[:MOST_ROWS]])
    return {
        "count": len(events),
        "families": [[f.name, f.sign, f.colour] for f in FAMILIES],
        "ticks": _ticks(events, (shown - time[0]) / speed, (time[-1] - time[0]) / speed),
        "rows": [
            {
                "at": (frame - time[0]) / speed,
                "family": _family(group.first),
                "words": _words(group),
            }
            for frame, group in zip(first, groups, strict=False)
        ],
        "unlisted": sum(len(group.events) for group in groups[MOST_ROWS:]),
    }


def _ticks(events: Sequence[Event], at: np.ndarray, duration: float) -> list[dict[str, Any]]:
    part = np.minimum(at / duration * MOST_TICKS if duration else 0 * at, MOST_TICKS - 1).astype(
        int
    )
    ticks: list[dict[str, Any]] = []
    for interval in np.unique(part):
        inside = [int(i) for i in np.flatnonzero(part == interval)]
        kinds = list(dict.fromkeys(events[i]["kind"] for i in inside))
        more = f" and {count_of(len(kinds) - NAMED, 'more kind')}" if len(kinds) > NAMED else ""
        count = f"{len(inside)} events: " if len(inside) > 1 else ""
        when = f"{events[inside[0]]['time']:.4g} s"
        ticks.append(
            {
                "at": float(at[inside[0]]),
                "families": sorted({_family(events[i]) for i in inside}),
                "words": f"{when}, {count}{', '.join(kinds[:NAMED])}{more}",
            }
        )
    return ticks


def _words(group: Group) -> list[str]:
    """Return interval, contact or joint with the kind of event, and the change."""
    first, last = group.first["time"], group.last["time"]
    span = f"{first:.4g} s" if len(group.events) == 1 else f"{first:.4g} \N{EN DASH} {last:.4g} s"
    whose = f"{who(group.first)} " if who(group.first) else ""
    return [span, f"{whose}{group.what()}", group.change()]


def _frames(time: np.ndarray, times: Sequence[float]) -> np.ndarray:
    """Return the times of the first frames at or after some times, or of the last frame."""
    return time[np.minimum(np.searchsorted(time, np.array(times, float)), len(time) - 1)]


def _family(event: Event) -> int:
    return FAMILIES.index(family_of(event["kind"]))
