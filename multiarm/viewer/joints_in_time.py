"""When the joints of a run hold, and where they are on their second bodies, by the run's events."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multiarm.dynamics.data import Data
from multiarm.events.joint_places import JointPlace, with_own_places
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import Event, timed
from multiarm.scene import JointSpec, Pose

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

SWITCHES = (EventKind.ATTACHED.word, EventKind.DETACHED.word)


def holding(trajectory: Trajectory, joint: JointSpec, time: np.ndarray) -> np.ndarray | None:
    """Whether a joint holds at some times (K,) of a run; None: it always does."""
    if not joint.intervals:
        return None
    holds = np.full(len(time), joint.holds_at(float(trajectory.time[0])))
    for event in _switches(trajectory, joint.connection):
        holds[time >= event["time"]] = event["kind"] == EventKind.ATTACHED.word
    return holds


def places_on_second(
    trajectory: Trajectory, joint: JointSpec, written: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """The joint's frame on its second body at some times, (K, 4, 4), first as ``written``."""
    frames = np.tile(written, (len(time), 1, 1))
    for event in _switches(trajectory, joint.connection):
        if "at" in event:
            frames[time >= event["time"]] = joint.frames(_pose(event))[1]
    return frames


class PlacedJoints:
    """Data in which joints are where they have taken hold, for one time after the other.

    Parameters
    ----------
    system : System
    trajectory : Trajectory
    data : Data
        Of the system.
    """

    def __init__(self, system: System, trajectory: Trajectory, data: Data) -> None:
        unilateral = data.model.unilateral
        joints = () if unilateral is None else unilateral.timed
        located = {joint.connection: joint for joint in joints if joint.located}
        self._events = [
            event for name in located for event in _switches(trajectory, name) if "at" in event
        ]
        self._events.sort(key=lambda event: event["time"])
        self._data = own = with_own_places(data) if self._events else data
        self._places = {
            name: JointPlace(own, system.model, joint) for name, joint in located.items()
        }

    def at(self, time: float) -> Data:
        """The data for a time [s], later than those before."""
        while self._events and self._events[0]["time"] <= time:
            event = self._events.pop(0)
            self._places[event["arm"]].pose = _pose(event)
        return self._data


def _switches(trajectory: Trajectory, connection: str) -> list[Event]:
    events = timed(trajectory.events)
    return [e for e in events if e.get("arm") == connection and e["kind"] in SWITCHES]


def _pose(event: Event) -> np.ndarray:
    return Pose(**event["at"]).matrix()
