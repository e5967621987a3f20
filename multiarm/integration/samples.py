"""A sample as one row of numbers: how wide it is, how the loop writes it, what its columns are.

The columns are time, object position, quaternion (xyzw), joint positions, object twist, joint
velocities, control torques, contact forces, free relative rates and coordinates of the joints,
kinetic and potential energy, work of each effect and of all together, largest gap and largest gap
rate; rank of the constraints, arms in the coupled system, relative residual.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from multiarm.contacts.frames import SINGLE_TURN, write_relative
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.dynamics.arrays import (
    CALL_SHOW,
    COUPLED_ARMS,
    RANK_OF_ALL,
    RESIDUAL,
    open_system,
)
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
    plant, buffers, work = open_system(struct)
    n, m = buffers.angles.size, buffers.shown.size
    row[0] = t
    copy(buffers.position, row[1:8])
    copy(buffers.angles, row[8 : 8 + n])
    copy(buffers.twist, row[8 + n : 14 + n])
    copy(buffers.v, row[14 + n : 14 + 2 * n])
    copy(buffers.torque, row[14 + 2 * n : 14 + 3 * n])
    at = 14 + 3 * n
    if plant.calls[CALL_SHOW] != 0:
        call_cfunc(plant.calls[CALL_SHOW], struct, t, 0.0)
    copy(buffers.shown, row[at : at + m])
    at += m
    write_free(plant, buffers, row[at:])
    at += 2 * plant.free.shape[0]
    row[at] = kinetic_energy(plant, buffers, work)
    row[at + 1] = potential_energy(plant, buffers)
    at += 2
    copy(works, row[at : at + works.size])
    at += works.size
    row[at] = largest(buffers.contacts, GAP)
    row[at + 1] = largest(buffers.contacts, GAP_RATE)
    row[at + 2] = buffers.solved[RANK_OF_ALL]
    row[at + 3] = buffers.solved[COUPLED_ARMS]
    row[at + 4] = buffers.solved[RESIDUAL]


@kernel
def write_free(plant, buffers, out):
    """Free relative rates of all joints, then their coordinates."""
    rates, places = buffers.query[0:6], buffers.query[6:15]
    count = plant.free.shape[0]
    for i in range(plant.frames.shape[0]):
        first, last = plant.free_bounds[i], plant.free_bounds[i + 1]
        if first == last:
            continue
        write_relative(plant.frames[i], buffers.arms[i], buffers.body, rates, places)
        for k in range(first, last):
            out[k] = rates[plant.free[k, 0]]
            out[count + k] = going_on(plant, buffers, i, k, places)


@kernel
def follow_joints(plant, buffers):
    """Note the free coordinates of all joints at the end of a step, in ``buffers.coordinates``."""
    rates, places = buffers.query[0:6], buffers.query[6:15]
    for i in range(plant.frames.shape[0]):
        first, last = plant.free_bounds[i], plant.free_bounds[i + 1]
        if first == last:
            continue
        write_relative(plant.frames[i], buffers.arms[i], buffers.body, rates, places)
        for k in range(first, last):
            x = going_on(plant, buffers, i, k, places)
            buffers.coordinates[i, plant.free[k, 0]] = x


@inlined
def going_on(plant, buffers, i, k, places):
    """Coordinate ``k``, of arm ``i``; a single angle goes on from the last step's, past pi."""
    x, before = places[plant.free[k, 1]], buffers.coordinates[i, plant.free[k, 0]]
    if plant.free[k, 1] >= SINGLE_TURN and before == before:
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
