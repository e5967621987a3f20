"""What a run watches without enforcing it: pulled contacts, patches, limits of joints and drives.

Contacts that no effect lets open are bilateral and their surfaces are unbounded.  A real contact
can only push, on a bounded surface, and a real joint has limits.  Where the motion leaves this
range, an event of the result says so, with its time.  Another event is a drive at its limit, which
is part of the model.  Each is a guard that only reports (:mod:`multiarm.dynamics.guards`); its
events go to the result in :mod:`multiarm.simulation.guard_log`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from multiarm.contacts.table import Record
from multiarm.dynamics.arrays import open_reports, open_system
from multiarm.dynamics.connections import Connections
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_rows
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.guard_functions import (
    DriveMargin,
    PatchDepth,
    PushingForce,
    RangeDepth,
    packed_patch,
)
from multiarm.dynamics.guards import FORCES, Guard, count_events, judge_guards, write_values
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.status import CALLBACK_FAILED, OK
from multiarm.geometry.records import Contact
from multiarm.jit.kernels import INTS, cfunc, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import referenced, struct_at

# Excesses below this are roundings [m, rad]; and pulls below this part of the largest force.
ROUNDED_EXCESS, SMALL_PULL = 1e-9, 1e-6


def reporting_guards(
    contacts: Mapping[str, list[Record]],
    limits: Mapping[str, Mapping[int, tuple[float, float]]],
    layout: Layout,
    connections: Connections,
    drives: Sequence[tuple[int, int, float]] = (),
    enforced: Set[int] = frozenset(),
) -> tuple[Guard, ...]:
    """A guard for every force that can only push, every patch, limit and drive.

    The contacts, by owner of rows, have the geometry on links in the frame of the joint that moves
    the link; ``limits`` are by connection and component of its relative motion; ``drives`` are
    places of excesses in the system's struct, joints, and roundings of the excess.  Rows that are
    ``enforced`` by unilateral constraints have guards that stop
    (:mod:`multiarm.events.mode_guards`).
    """
    guards: list[Guard] = []
    bodies = list(zip(connections.first.tolist(), connections.second.tolist(), strict=True))
    for c, (owner, records) in enumerate(contacts.items()):
        for k, contact in enumerate(records):
            if layout.first_contact[c] + k not in enforced:
                guards += _contact_guards(layout.first_contact[c] + k, bodies[c], contact)
        for component, (lower, upper) in limits.get(owner, {}).items():
            depth = RangeDepth(c, component, lower, upper)
            guards.append(Guard(depth, ROUNDED_EXCESS, stops=False))
    guards += [
        Guard(DriveMargin(joint, place), roundings, stops=False)
        for place, joint, roundings in drives
    ]
    return tuple(guards)


def _contact_guards(row: int, bodies: tuple[int, int], contact: Record) -> list[Guard]:
    if not isinstance(contact, Contact) or contact.tangent:
        return []
    guards = []
    if contact.pushes_only:
        guards.append(Guard(PushingForce(row), SMALL_PULL, scale=FORCES, stops=False))
    for body, surface in zip(bodies, (contact.arm, contact.object), strict=True):
        if surface.patch is not None:
            depth = PatchDepth(row, body, packed_patch(surface.patch))
            guards.append(Guard(depth, ROUNDED_EXCESS, stops=False))
    return guards


@kernel
def write_reports(struct: INTS):
    """Write the values of the guards that only report at the state evaluated last.

    They are numbered by all rows; in a mode these have kinematics of their own.  Returns ``OK`` or
    ``CALLBACK_FAILED``.
    """
    model, data, work = open_system(struct)
    if not data.modes.active:
        write_values(open_reports(struct), struct, data, model, data, work)
        return CALLBACK_FAILED if data.status.failed else OK
    rows = referenced(data.modes.full)
    status = update_rows(rows)
    model_of_all, full, work_of_all = open_system(rows)
    write_values(open_reports(struct), struct, data, model_of_all, full, work_of_all)
    return status


@cfunc
def check_reports(address, size, h, _b):
    """Check these guards at the end of a step of length ``h``; returns a status."""
    struct = struct_at(address, size)
    status = write_reports(struct)
    if status == OK:
        judge_guards(open_reports(struct), h)
    return status


@kernel
def count_reports(struct, functions, h):
    """Call :func:`check_reports` where there are such guards.

    Returns a status, and how many of them report an event.
    """
    if functions.reports == 0:
        return OK, 0
    status = call_cfunc(functions.reports, struct, h, 0.0)
    return status, count_events(open_reports(struct)) if status == OK else 0


def contacts_off_patch(data: Data) -> list[tuple[str, str, float]]:
    """Contacts outside the patch of their surface: owner, name, distance [m].

    At the kinematics in ``data``.
    """
    if not any(isinstance(guard.function, PatchDepth) for guard in data.model.guards):
        return []
    require_ok(data, write_reports(data.struct))
    off = []
    for guard, depth in zip(data.model.guards, data.guards.value.tolist(), strict=True):
        if isinstance(guard.function, PatchDepth) and depth < -guard.threshold:
            owner, contact = data.model.owner(guard.function.row)
            off.append((owner, contact.name, -depth))
    return off
