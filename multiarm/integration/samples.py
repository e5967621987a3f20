"""A sample as one row of numbers: how wide it is, how the loop writes it, what its columns are.

The columns are time, object position, quaternion (xyzw), joint positions, object twist, joint
velocities, control torques, contact forces, free relative rates and coordinates of the joints,
kinetic and potential energy, work of each effect and of all together, largest gap and largest gap
rate; rank of the constraints, arms in the coupled system, relative residual.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from multiarm.contacts.joint import SINGLE_TURN, write_relative
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import kinetic_energy, largest, potential_energy
from multiarm.jit.kernels import copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.results.channels import Channel, Columns, in_sequence


def sample_width(joints: int, contacts: int, free: int, works: int) -> int:
    """Numbers a sample: see :func:`write_sample`."""
    return 1 + 7 + joints + 6 + joints + joints + contacts + 2 * free + 7 + works


@kernel
def write_sample(struct, t, works, row):
    """One row of the block from an evaluated state: time, positions, velocities, torques, contact
    forces, relative rates and coordinates, kinetic and potential energy, works, largest gap and gap
    rate, rank, coupled arms and residual.
    """
    model, data, work = open_system(struct)
    n, m = data.angles.size, data.shown.size
    row[0] = t
    copy(data.position, row[1:8])
    copy(data.angles, row[8 : 8 + n])
    copy(data.twist, row[8 + n : 14 + n])
    copy(data.v, row[14 + n : 14 + 2 * n])
    copy(data.torque, row[14 + 2 * n : 14 + 3 * n])
    at = 14 + 3 * n
    if data.functions.contact_forces != 0:
        call_cfunc(data.functions.contact_forces, struct, t, 0.0)
    copy(data.shown, row[at : at + m])
    at += m
    write_free(model, data, row[at:])
    at += 2 * model.free.shape[0]
    row[at] = kinetic_energy(data, work)
    row[at + 1] = potential_energy(model, data)
    at += 2
    copy(works, row[at : at + works.size])
    at += works.size
    row[at] = largest(data.contacts, GAP)
    row[at + 1] = largest(data.contacts, GAP_RATE)
    row[at + 2] = data.status.rank
    row[at + 3] = data.status.coupled_arms
    row[at + 4] = data.status.residual


@kernel
def write_free(model, data, out):
    """Free relative rates of all joints, then their coordinates."""
    rates, places = data.query[0:6], data.query[6:15]
    count = model.free.shape[0]
    for i in range(model.frames.shape[0]):
        first, last = model.free_bounds[i], model.free_bounds[i + 1]
        if first == last:
            continue
        write_relative(model.frames[i], data.arms[i], data.body, rates, places)
        for k in range(first, last):
            out[k] = rates[model.free[k, 0]]
            out[count + k] = going_on(model, data, i, k, places)


@kernel
def follow_joints(model, data):
    """Note the free coordinates of all joints at the end of a step, in ``data.coordinates``."""
    rates, places = data.query[0:6], data.query[6:15]
    for i in range(model.frames.shape[0]):
        first, last = model.free_bounds[i], model.free_bounds[i + 1]
        if first == last:
            continue
        write_relative(model.frames[i], data.arms[i], data.body, rates, places)
        for k in range(first, last):
            x = going_on(model, data, i, k, places)
            data.coordinates[i, model.free[k, 0]] = x


@inlined
def going_on(model, data, i, k, places):
    """Coordinate ``k``, of arm ``i``; a single angle goes on from the last step's, past pi."""
    x, before = places[model.free[k, 1]], data.coordinates[i, model.free[k, 0]]
    if model.free[k, 1] >= SINGLE_TURN and before == before:
        x += 2.0 * math.pi * round((before - x) / (2.0 * math.pi))
    return x


def sample_columns(channels: Sequence[Channel]) -> Columns:
    """Where the channels of a run are in a row of :func:`write_sample`."""
    return in_sequence(sorted(channels, key=_place))


# Channels in the order of a row, or the last part of their names: those of all arms, of the floor
# and of all effects stand together, in the order of the channels.
_ORDER = (
    "time", "object/position", "object/quaternion_xyzw", "joint_position", "object/twist",
    "joint_velocity", "joint_torque", "contact_force", "contact_state", "relative_rate",
    "relative_position", "energy/kinetic", "energy/potential", "work", "energy/work",
    "drift/position", "drift/velocity", "solver/rank", "solver/coupled_arms", "solver/residual",
)  # fmt: skip


def _place(channel: Channel) -> int:
    name = channel.name
    return _ORDER.index(name if name in _ORDER else name.rpartition("/")[2])
