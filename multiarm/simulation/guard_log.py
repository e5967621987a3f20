"""Events of the guards that only report, in the log of a run.

The loop says that some have changed their sign in the step just made; the times are found on its
dense output.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.contacts.joint import COMPONENTS
from multiarm.dynamics.guard_functions import (
    ON_OBJECT,
    DriveMargin,
    PatchDepth,
    PushingForce,
    RangeDepth,
)
from multiarm.dynamics.guards import FIRED, QUIET, turn_round
from multiarm.dynamics.model import Data
from multiarm.integration.event_location import GuardValues, sign_changes
from multiarm.integration.methods import Stepping
from multiarm.integration.reporting_guards import write_reports
from multiarm.integration.step_control import Clock
from multiarm.results.event_log import EventLog

# Kinds of the events at which a guard falls below zero, and is above it again.
KINDS = {
    PushingForce: ("pulls", "pushes again"),
    RangeDepth: ("passes its limit", "is back within its limit"),
    DriveMargin: ("saturates", "is no longer saturated"),
    PatchDepth: ("leaves its patch", "is back on its patch"),
}


def log_start(data: Data, log: EventLog, begin: float) -> None:
    """Log what is out of its range at the start of a run, where the guards have been checked."""
    guards, events = data.guards, []
    for g in map(int, np.flatnonzero(guards.result == FIRED)):
        events.append(_event(data, g, begin))
        turn_round(guards, g)
    log.add(events)


def log_reports(data: Data, stepping: Stepping, clock: Clock, log: EventLog) -> None:
    """Log the events of the guards that report one in the step just made, in order of time."""
    guards, begin, length = data.guards, clock.t_before, clock.h_before
    results, levels, events = guards.result.copy(), guards.level.copy(), []
    values = GuardValues(data.struct, stepping.struct, write_reports, guards, begin, clock.t)
    for g in map(int, np.flatnonzero(results != QUIET)):
        for theta in sign_changes(values, g, results[g] == FIRED, float(levels[g])):
            events.append(_event(data, g, begin + theta * length))
            turn_round(guards, g)
    log.add(sorted(events, key=lambda event: event["time"]))


def _event(data: Data, g: int, time: float) -> dict[str, Any]:
    """The event at which a guard changes its sign."""
    model, watched = data.model, data.model.guards[g].function
    kind = KINDS[type(watched)][0 if data.guards.sign[g] > 0 else 1]
    part, where = "joint", ""
    if isinstance(watched, RangeDepth):
        arm, name = model.arm_names[watched.arm], f"joint, {COMPONENTS[watched.component]}"
    elif isinstance(watched, DriveMargin):
        joint = watched.joint
        arm = model.arm_names[int(np.searchsorted(model.layout.dofs, joint, side="right")) - 1]
        name = model.joint_name(joint)
    else:
        patch = isinstance(watched, PatchDepth)
        arm, contact = model.owner(watched.row)
        part, name = "contact", contact.name
        if patch:
            where = " (on the object)" if watched.body == ON_OBJECT else " (on the arm)"
    return {
        "time": float(time),
        "kind": kind,
        "arm": arm,
        part: name,
        "text": f"{arm}: {name} {kind}{where}",
    }
