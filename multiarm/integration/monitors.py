"""Monitors of a run: contacts that pull or leave their patch, limits of joints and of drives.

The contacts of the model are bilateral and their surfaces are unbounded.  A real contact can only
push, on a bounded surface, and a real joint has limits.  Where the motion leaves this range, an
event of the result says so, with its time.  Another event is a drive at its limit, which is part of
the model.

The guard function of a monitor, its *margin*, is evaluated at the end of every step.  It is
negative within the allowed range.  The time of a sign change is interpolated linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from multiarm.contacts.joint import COMPONENTS
from multiarm.contacts.kernel import AT, NORMAL, depth_in_patch
from multiarm.contacts.table import SURFACE_BODY, TIP_RADIUS
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Data
from multiarm.geometry.records import SURFACE_ON_OBJECT, Contact, Patch
from multiarm.jit.kernels import kernel
from multiarm.jit.structs import floats1
from multiarm.jit.vectors import add_scaled, rotate_back, rotation, sub, vec
from multiarm.results.event_log import EventLog

# Columns of a monitor, of shape (20,).
# ROW: row of W; of a limit or a drive the arm.
# BODY: body that carries the patch (ON_OBJECT, else the arm), or FORCE, LIMIT, DRIVE.
# POSE: the patch's frame in that body (rotation row by row, origin); of a limit the component of
# the joint's motion; of a drive the place of its margins in the struct, and the joint.
# LOWER, UPPER: corners of the patch; bounds of the limit.
ROW, BODY, POSE, LOWER, UPPER, WIDTH = 0, 1, 2, 14, 17, 20
ON_OBJECT, FORCE, LIMIT, DRIVE = -1, -2, -3, -4

# Margins below this are roundings [m, rad].
ROUNDING = 1e-9


def make_monitors(
    contacts: dict[str, list[Contact]],
    limits: dict[str, dict[int, tuple[float, float]]],
    layout: Layout,
    drives: Sequence[tuple[int, int]] = (),
) -> np.ndarray:
    """One row for every force, patch, limit and drive, shape (w, 20).

    The contacts have the arms' geometry in the frame of the link that carries the tip; ``limits``
    are by arm and component of the joint's relative motion; ``drives`` are places of margins in the
    system's struct, and joints.
    """
    rows: list[np.ndarray] = []
    for i, (arm, own) in enumerate(contacts.items()):
        for k, contact in enumerate(own):
            rows += _contact_monitors(layout.rows[i] + k, i, contact)
        for component, (lower, upper) in limits[arm].items():
            monitor = _monitor(i, LIMIT)
            monitor[[POSE, LOWER, UPPER]] = component, lower, upper
            rows.append(monitor)
    for place, joint in drives:
        monitor = _monitor(int(np.searchsorted(layout.dofs, joint, side="right")) - 1, DRIVE)
        monitor[[POSE, POSE + 1]] = place, joint
        rows.append(monitor)
    return np.array(rows).reshape(-1, WIDTH)


def _contact_monitors(row: int, arm: int, contact: Contact) -> list[np.ndarray]:
    if contact.tangent:
        return []
    monitors = [_monitor(row, FORCE)] if contact.pushes_only else []
    for body, surface in ((arm, contact.arm), (ON_OBJECT, contact.object)):
        if surface.patch is not None:
            monitors.append(_monitor(row, body, surface.patch))
    return monitors


def _monitor(row: int, body: int, patch: Patch | None = None) -> np.ndarray:
    monitor = np.zeros(WIDTH)
    monitor[[ROW, BODY]] = row, body
    if patch is not None:
        monitor[POSE : POSE + 9] = patch.pose[:3, :3].ravel()
        monitor[POSE + 9 : POSE + 12] = patch.pose[:3, 3]
        monitor[LOWER : LOWER + 3] = patch.lower
        monitor[UPPER : UPPER + 3] = patch.upper
    return monitor


def contacts_off_patch(data: Data) -> list[tuple[str, str, float]]:
    """Contacts outside the patch of their surface: arm, name, distance [m].

    At the kinematics in ``data``.
    """
    found = []
    for k, monitor in enumerate(data.model.constants.monitors):
        if int(monitor[BODY]) >= ON_OBJECT and (excess := margin_at(data.struct, k)) > 0.0:
            arm, contact = data.model.owner(int(monitor[ROW]))
            found.append((arm, contact.name, excess))
    return found


def collect_events(data: Data, log: EventLog) -> None:
    """Move the events that the loop stored since the last call to the log."""
    arrays = data.arrays
    count, stored = int(arrays.event_count[0]), len(arrays.events)
    if not count:
        return
    log.add([_event(event, data) for event in arrays.events[: min(count, stored)]])
    if count > stored:
        log.drop(float(arrays.events[-1, 0]), "limits and contacts", count=count - stored)
    arrays.event_count[0] = 0


def _event(event: np.ndarray, data: Data) -> dict[str, Any]:
    """An event of the loop as an event of the result."""
    time, number, began = event
    monitor = data.model.constants.monitors[int(number)]
    row, body = int(monitor[ROW]), int(monitor[BODY])
    kinds = {
        FORCE: ("pulls", "pushes again"),
        LIMIT: ("passes its limit", "is back within its limit"),
        DRIVE: ("saturates", "is no longer saturated"),
    }.get(body, ("leaves its patch", "is back on its patch"))
    kind, where = kinds[0 if began else 1], ""
    if body == LIMIT:
        arm, name = data.model.arm_names[row], f"joint, {COMPONENTS[int(monitor[POSE])]}"
    elif body == DRIVE:
        arm = data.model.arm_names[row]
        joint = int(monitor[POSE + 1]) - data.model.layout.dofs[row]
        name = data.model.arms[arm].joint_names[joint]
    else:
        arm, contact = data.model.owner(row)
        name = contact.name
        where = " (on the object)" if body == ON_OBJECT else " (on the arm)" if body >= 0 else ""
    return {
        "time": float(time),
        "kind": kind,
        "arm": arm,
        "joint" if body in (LIMIT, DRIVE) else "contact": name,
        "text": f"{arm}: {name} {kind}{where}",
    }


@kernel
def margin_of(monitor, model, data):
    """Margin of a force [N] or a patch [m]; negative within the allowed range."""
    row, carrier = int(monitor[ROW]), int(monitor[BODY])
    if carrier == FORCE:
        largest = 1.0
        for k in range(data.force.size):
            largest = max(largest, abs(data.force[k]))
        return -data.force[row] - 1e-6 * largest  # smaller pulls are roundings
    contact = data.contacts[row]
    body = data.body if carrier == ON_OBJECT else data.arms[carrier]
    # the contact point lies a tip's radius from its centre, against the guide's outward normal
    away = model.geometry[row, TIP_RADIUS]
    if model.codes[row, SURFACE_BODY] == SURFACE_ON_OBJECT:
        away = -away
    touching = add_scaled(vec(contact, AT), -away, vec(contact, NORMAL))
    at = rotate_back(rotation(body, 0), sub(touching, vec(body, 9)))
    return -depth_in_patch(monitor[POSE:], at) - ROUNDING


@kernel
def margin_at(struct, k):
    """Margin of monitor ``k`` of the system with this struct; see :func:`margin_of`."""
    model, data, _ = open_system(struct)
    return margin_of(model.monitors[k], model, data)


@kernel
def update_monitors(struct, begin, end):
    """Evaluate the margins at the end of a step, and store an event for every sign change.

    ``data.margins`` holds those at the step's beginning (NaN at the start of a run),
    ``data.coordinates`` the joints' coordinates at its end.
    """
    model, data, _ = open_system(struct)
    for k in range(model.monitors.shape[0]):
        before, monitor = data.margins[k], model.monitors[k]
        if int(monitor[BODY]) == DRIVE:
            now = floats1(struct, int(monitor[POSE]))[int(monitor[POSE + 1])]
        elif int(monitor[BODY]) == LIMIT:
            x = data.coordinates[int(monitor[ROW]), int(monitor[POSE])]
            now = max(monitor[LOWER] - x, x - monitor[UPPER]) - ROUNDING
        else:
            now = margin_of(monitor, model, data)
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
