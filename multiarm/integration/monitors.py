"""What to watch during a run: contacts that pull or leave their patch, limits of joints and drives.

The contacts of the model hold both ways and their surfaces go on for ever.  A contact that stands
for a real one can only push, on a surface that ends somewhere, and a real hinge has its limits:
where the model goes on and the real thing would not, an event of the result says so, with its time.
So does one where a drive comes to its limit, which is part of the model.

A *margin* is watched at the end of every step: it is negative as long as all is well.  The time at
which it changed its sign is found by a straight line between the ends of the step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from multiarm.contacts.joint import COMPONENTS
from multiarm.contacts.kernel import AT, NORMAL
from multiarm.contacts.records import SURFACE_BODY, SURFACE_ON_OBJECT, TIP_RADIUS, Contact, Patch
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import Layout
from multiarm.jit.kernels import kernel
from multiarm.jit.structs import floats1
from multiarm.results.event_log import EventLog

# Columns of a watch: row of W; body that carries the patch (``ON_OBJECT``, else the arm), or
# ``FORCE``, ``LIMIT``, ``DRIVE``; the patch's frame (rotation row by row, origin) in that body; its
# corners.  A limit has the arm in place of the row, then the component of the joint's motion, and
# its bounds.  A drive has the arm, then where its margin is: place of an array in the struct,
# and the joint's number, which is the entry there.
WATCH_ROW, WATCH_BODY, WATCH_POSE, WATCH_LOWER, WATCH_UPPER, WATCH_WIDTH = 0, 1, 2, 14, 17, 20
ON_OBJECT, FORCE, LIMIT, DRIVE = -1, -2, -3, -4

# A pull smaller than this fraction of the largest contact force [N], or of 1 N, is rounding.
NO_PULL = 1e-6
# An excess smaller than this [m, rad] is rounding.
NO_EXCESS = 1e-9


def make_watches(
    contacts: dict[str, list[Contact]],
    limits: dict[str, dict[int, tuple[float, float]]],
    layout: Layout,
    drives: Sequence[tuple[int, int]] = (),
) -> np.ndarray:
    """One row for every force, patch, limit and drive to watch, shape (w, 20).

    The contacts have the arms' geometry in the frame of the link that carries the tip; ``limits``
    are by arm and component of the joint's relative motion; ``drives`` are places of margins in the
    system's struct and joints.
    """
    rows: list[np.ndarray] = []
    for i, (arm, own) in enumerate(contacts.items()):
        for k, contact in enumerate(own):
            rows += _contact_watches(layout.rows[i] + k, i, contact)
        for component, (lower, upper) in limits[arm].items():
            watch = _watch(i, LIMIT)
            watch[[WATCH_POSE, WATCH_LOWER, WATCH_UPPER]] = component, lower, upper
            rows.append(watch)
    for place, joint in drives:
        watch = _watch(int(np.searchsorted(layout.dofs, joint, side="right")) - 1, DRIVE)
        watch[[WATCH_POSE, WATCH_POSE + 1]] = place, joint
        rows.append(watch)
    return np.array(rows).reshape(-1, WATCH_WIDTH)


def _contact_watches(row: int, arm: int, contact: Contact) -> list[np.ndarray]:
    if contact.tangent:
        return []
    watches = [_watch(row, FORCE)] if contact.pushes_only else []
    for body, surface in ((arm, contact.arm), (ON_OBJECT, contact.object)):
        if surface.patch is not None:
            watches.append(_watch(row, body, surface.patch))
    return watches


def _watch(row: int, body: int, patch: Patch | None = None) -> np.ndarray:
    watch = np.zeros(WATCH_WIDTH)
    watch[[WATCH_ROW, WATCH_BODY]] = row, body
    if patch is not None:
        watch[WATCH_POSE : WATCH_POSE + 9] = patch.pose[:3, :3].ravel()
        watch[WATCH_POSE + 9 : WATCH_POSE + 12] = patch.pose[:3, 3]
        watch[WATCH_LOWER : WATCH_LOWER + 3] = patch.lower
        watch[WATCH_UPPER : WATCH_UPPER + 3] = patch.upper
    return watch


def collect_events(data: Data, log: EventLog) -> None:
    """Take over the events that the loop has noted since the last call."""
    arrays = data.arrays
    count, noted = int(arrays.event_count[0]), len(arrays.events)
    if not count:
        return
    log.add([_named(event, data) for event in arrays.events[: min(count, noted)]])
    if count > noted:
        log.drop(float(arrays.events[-1, 0]), "limits and contacts", count=count - noted)
    arrays.event_count[0] = 0


_KINDS = {
    ON_OBJECT: ("leaves its patch", "is back on its patch"),
    FORCE: ("pulls", "pushes again"),
    LIMIT: ("passes its limit", "is back within its limit"),
    DRIVE: ("saturates", "is no longer saturated"),
}


def _named(event: np.ndarray, data: Data) -> dict[str, Any]:
    """An event as the result tells it."""
    time, number, began = event
    watch = data.model.constants.watches[int(number)]
    row, what = int(watch[WATCH_ROW]), int(watch[WATCH_BODY])
    if what == LIMIT:
        arm, name = data.model.arm_names[row], f"joint, {COMPONENTS[int(watch[WATCH_POSE])]}"
    elif what == DRIVE:
        arm = data.model.arm_names[row]
        joint = int(watch[WATCH_POSE + 1]) - data.model.layout.dofs[row]
        name = data.model.arms[arm].joint_names[joint]
    else:
        arm, contact = data.model.owner(row)
        name = contact.name
    kind = _KINDS.get(what, _KINDS[ON_OBJECT])[0 if began else 1]
    where = " (on the object)" if what == ON_OBJECT else " (on the arm)" if what >= 0 else ""
    return {
        "time": float(time),
        "kind": kind,
        "arm": arm,
        "joint" if what in (LIMIT, DRIVE) else "contact": name,
        "text": f"{arm}: {name} {kind}{where}",
    }


@kernel
def margin_of(watch, model, data):
    """Margin of one watch: of a force [N], of a patch [m]; negative as long as all is well."""
    row, carrier = int(watch[WATCH_ROW]), int(watch[WATCH_BODY])
    if carrier == FORCE:
        largest = 1.0
        for k in range(data.force.size):
            largest = max(largest, abs(data.force[k]))
        return -data.force[row] - NO_PULL * largest
    contact = data.contacts[row]
    body = data.body if carrier == ON_OBJECT else data.arms[carrier]
    # the contact point lies a tip's radius from its centre, against the guide's outward normal
    away = model.geometry[row, TIP_RADIUS]
    if model.codes[row, SURFACE_BODY] == SURFACE_ON_OBJECT:
        away = -away
    d0 = contact[AT] - away * contact[NORMAL] - body[9]
    d1 = contact[AT + 1] - away * contact[NORMAL + 1] - body[10]
    d2 = contact[AT + 2] - away * contact[NORMAL + 2] - body[11]
    at = WATCH_POSE
    p0 = body[0] * d0 + body[3] * d1 + body[6] * d2 - watch[at + 9]
    p1 = body[1] * d0 + body[4] * d1 + body[7] * d2 - watch[at + 10]
    p2 = body[2] * d0 + body[5] * d1 + body[8] * d2 - watch[at + 11]
    worst = -math.inf
    for j in range(3):
        p = watch[at + j] * p0 + watch[at + 3 + j] * p1 + watch[at + 6 + j] * p2
        worst = max(worst, watch[WATCH_LOWER + j] - p, p - watch[WATCH_UPPER + j])
    return worst - NO_EXCESS


@kernel
def margin_at(struct, k):
    """Margin of monitor ``k`` of the system with this struct; see :func:`margin_of`."""
    model, data, _ = open_system(struct)
    return margin_of(model.watches[k], model, data)


@kernel
def watch_step(struct, begin, end):
    """Note the margins at the end of a step, and every one that changed its sign in it.

    ``data.margins`` holds those of the step's beginning (NaN at the start of a run);
    ``data.coordinates`` the joints' coordinates at its end.
    """
    model, data, _ = open_system(struct)
    for k in range(model.watches.shape[0]):
        before, watch = data.margins[k], model.watches[k]
        if int(watch[WATCH_BODY]) == DRIVE:
            now = floats1(struct, int(watch[WATCH_POSE]))[int(watch[WATCH_POSE + 1])]
        elif int(watch[WATCH_BODY]) == LIMIT:
            x = data.coordinates[int(watch[WATCH_ROW]), int(watch[WATCH_POSE])]
            now = max(watch[WATCH_LOWER] - x, x - watch[WATCH_UPPER]) - NO_EXCESS
        else:
            now = margin_of(watch, model, data)
        data.margins[k] = now
        began = before <= 0.0 < now or (before != before and now > 0.0)
        if not (began or now <= 0.0 < before):
            continue
        count = data.event_count[0]
        if count < data.events.shape[0]:
            share = before / (before - now) if before == before else 0.0
            event = data.events[count]
            event[0], event[1] = begin + share * (end - begin), k
            event[2] = 1.0 if began else 0.0
        data.event_count[0] += 1
