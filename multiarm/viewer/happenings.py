"""What happened during a film: where it flashes, and what the page lists beside its time line.

A run may have thousands of events. The page gets a bounded number of ticks, each for all events of
a short stretch of time, and of rows, each for a group of events of one contact or joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.results.event_log import FAMILIES, Event, Group, family_of, grouped, timed, who
from multiarm.viewer.film import ContactTracks, Moment

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

MOST_TICKS = 160
MOST_ROWS = 300
NAMED = 3  # kinds in the words of a tick


def moments_of(
    trajectory: Trajectory, time: np.ndarray, contacts: Sequence[ContactTracks]
) -> list[Moment]:
    """Return the events of a run that have a place, or a contact that is shown.

    Parameters
    ----------
    trajectory : Trajectory
    time : array, shape (K,)
        Of the frames [s].
    contacts : sequence of ContactTracks
    """
    tracks = {c.arm: c for c in contacts}
    moments = []
    for event in timed(trajectory.events):
        where = _place(event, time, tracks)
        if where is not None:
            moments.append(Moment(float(event["time"]), family_of(event["kind"]), where))
    return moments


def time_line(events: Sequence[Event], time: np.ndarray, speed: float) -> dict[str, Any]:
    """Return what a page shows of a run's events: ticks, rows of a list, and what signs mean.

    Times are those of the viewer: seconds after the first frame, of the first frame that shows what
    has happened.

    Parameters
    ----------
    events : sequence of dict
        As in `Trajectory.events`.
    time : array, shape (K,)
        Of the frames [s].
    speed : float
        Seconds of the film per second of the viewer.
    """
    told = timed(events)
    shown = _frames(time, [event["time"] for event in told])
    groups = grouped(told)
    first = _frames(time, [group.first["time"] for group in groups[:MOST_ROWS]])
    return {
        "count": len(told),
        "families": [[f.name, f.sign, f.colour] for f in FAMILIES],
        "ticks": _ticks(told, (shown - time[0]) / speed, (time[-1] - time[0]) / speed),
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


def _ticks(told: Sequence[Event], at: np.ndarray, duration: float) -> list[dict[str, Any]]:
    part = np.minimum(at / duration * MOST_TICKS if duration else 0 * at, MOST_TICKS - 1).astype(
        int
    )
    ticks: list[dict[str, Any]] = []
    for stretch in np.unique(part):
        inside = [int(i) for i in np.flatnonzero(part == stretch)]
        kinds = list(dict.fromkeys(told[i]["kind"] for i in inside))
        more = f" and {len(kinds) - NAMED} more kinds" if len(kinds) > NAMED else ""
        number = f"{len(inside)} events: " if len(inside) > 1 else ""
        when = f"{told[inside[0]]['time']:.4g} s"
        ticks.append(
            {
                "at": float(at[inside[0]]),
                "families": sorted({_family(told[i]) for i in inside}),
                "words": f"{when}, {number}{', '.join(kinds[:NAMED])}{more}",
            }
        )
    return ticks


def _words(group: Group) -> list[str]:
    """Time, what and to whom, before and after."""
    first, last = group.first["time"], group.last["time"]
    span = f"{first:.4g} s" if len(group.events) == 1 else f"{first:.4g} \N{EN DASH} {last:.4g} s"
    whose = f"{who(group.first)} " if who(group.first) else ""
    return [span, f"{whose}{group.what()}", group.change()]


def _place(
    event: Event, time: np.ndarray, tracks: Mapping[str, ContactTracks]
) -> np.ndarray | None:
    where = event.get("where")
    if where is not None:
        point = np.array(where, dtype=float)
        return point if point.shape == (3,) and np.isfinite(point).all() else None
    track, contact = tracks.get(event.get("arm", "")), event.get("contact")
    if track is None or contact not in track.names:
        return None
    frame = int(np.abs(time - event["time"]).argmin())
    return track.point[frame, track.names.index(contact)]


def _frames(time: np.ndarray, times: Sequence[float]) -> np.ndarray:
    """Return the times of the first frames at or after some times, or of the last frame."""
    return time[np.minimum(np.searchsorted(time, np.array(times, float)), len(time) - 1)]


def _family(event: Event) -> int:
    return FAMILIES.index(family_of(event["kind"]))
