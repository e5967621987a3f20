"""Events of the guards that only report, in the log of a run.

The loop says that some have changed their sign in the step just made; the times are found on its
dense output.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from multiarm.contacts.joint import COMPONENTS
from multiarm.dynamics.data import Data
from multiarm.dynamics.failures import is_tip_of_arm, require_ok
from multiarm.dynamics.guard_functions import (
    DriveMargin,
    PatchDepth,
    PushingForce,
    RangeDepth,
)
from multiarm.dynamics.guards import FIRED, QUIET, turn_round
from multiarm.dynamics.model import Model
from multiarm.integration.event_location import GuardValues, sign_changes
from multiarm.integration.methods import Stepping
from multiarm.integration.reporting_guards import write_reports
from multiarm.integration.step_control import Clock
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import EventLog, RunEvent

# Kinds of the events at which a guard falls below zero, and is above it again.
GUARD_EVENTS = {
    PushingForce: (EventKind.PULLS, EventKind.PUSHES_AGAIN),
    RangeDepth: (EventKind.PASSES_LIMIT, EventKind.RETURNS_TO_RANGE),
    DriveMargin: (EventKind.SATURATES, EventKind.UNSATURATES),
    PatchDepth: (EventKind.LEAVES_PATCH, EventKind.RETURNS_TO_PATCH),
}


def log_start(data: Data, log: EventLog, begin: float) -> None:
    """Log what is out of its range at the start of a run, where the guards have been checked."""
    guards, events = data.guards, []
    for g in map(int, np.flatnonzero(guards.result == FIRED)):
        events.append(_event(data, g, begin))
        turn_round(guards, g)
    log.add(*events)


def watch_joints(data: Data, model: Model, idle: Set[str], time: float, log: EventLog) -> None:
    """Watch the ranges, patches and forces of joints that hold, and not those of ``idle`` ones.

    Of joints that have just taken hold, what is out of its range is logged.  ``model`` has all
    rows; at the state in the data, which has been evaluated.
    """
    guards, awake = data.guards, []
    for g, guard in enumerate(model.guards):
        if isinstance(guard.function, DriveMargin):
            continue
        if _owner(model, guard.function) in idle:
            guards.sign[g], guards.result[g] = 0, QUIET
        elif guards.sign[g] == 0:
            guards.sign[g] = 1
            awake.append(g)
    if not awake:
        return
    require_ok(data, write_reports(data.struct))
    for g in awake:
        guards.before[g], guards.rate_before[g] = guards.value[g], guards.rate[g]
        guards.armed[g] = guards.before[g] > guards.level[g]
        if guards.value[g] < -guards.level[g]:
            log.add(_event(data, g, time))
            turn_round(guards, g)


def _owner(model: Model, watched: RangeDepth | PatchDepth | PushingForce) -> str:
    """The connection of a guard, in a model with all rows."""
    if isinstance(watched, RangeDepth):
        return model.layout.owners[watched.connection]
    return model.owner(watched.row)[0]


def log_reports(data: Data, stepping: Stepping, clock: Clock, log: EventLog) -> None:
    """Log the events of the guards that report one in the step just made, in order of time."""
    guards, begin, length = data.guards, clock.t_before, clock.h_before
    results, levels, events = guards.result.copy(), guards.level.copy(), []
    values = GuardValues(data.struct, stepping.struct, write_reports, guards, begin, clock.t)
    for g in map(int, np.flatnonzero(results != QUIET)):
        for theta in sign_changes(values, g, results[g] == FIRED, float(levels[g])):
            events.append(_event(data, g, begin + theta * length))
            turn_round(guards, g)
    log.add(*sorted(events, key=lambda event: event.time))


def _event(data: Data, g: int, time: float) -> RunEvent:
    """The event at which a guard changes its sign."""
    model, watched = data.model, data.model.guards[g].function
    kind = GUARD_EVENTS[type(watched)][0 if data.guards.sign[g] > 0 else 1]
    time = float(time)
    if isinstance(watched, RangeDepth):
        joint = f"joint, {COMPONENTS[watched.component]}"
        owner = model.layout.owners[watched.connection]
        return RunEvent(time, kind, arm=owner, joint=joint)
    if isinstance(watched, DriveMargin):
        name = model.arm_names[model.layout.robot_of_joint(watched.joint)]
        return RunEvent(time, kind, arm=name, joint=model.joint_name(watched.joint))
    (owner, contact), body = model.owner(int(data.guards.held[watched.row])), ""
    if isinstance(watched, PatchDepth):
        pair = model.connections[owner]
        body = "arm" if is_tip_of_arm(pair) else str(pair.first)
        if watched.body == model.bodies_of(owner)[1]:
            body = str(pair.second)
    return RunEvent(time, kind, arm=owner, contact=contact.name, body=body)
