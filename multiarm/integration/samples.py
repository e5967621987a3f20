"""A sample as one row of numbers: how wide it is, how the loop writes it, what its columns are.

The columns are time, object position, quaternion (xyzw), joint positions, object twist, joint
velocities, control torques, contact forces, free relative rates and coordinates of the joints,
kinetic and potential energy, work of each effect and of all together, largest gap and largest gap
rate; rank of the constraints, arms in the coupled system, relative residual.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate

import numpy as np

from multiarm.contacts.frames import SINGLE_TURN, write_relative
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import kinetic_energy, largest, potential_energy
from multiarm.dynamics.state import Layout
from multiarm.jit.kernels import copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc


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


def named_samples(
    layout: Layout,
    free_bounds: np.ndarray,
    works: Sequence[str],
    rows: np.ndarray,
    states: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, np.ndarray]:
    """The rows of a block of :func:`write_sample` as named channels.

    ``works`` are the names of the effects whose work is recorded; ``states`` those of the contacts
    of every owner that come and go.
    """
    n, m, f, w = layout.joints, layout.contacts, int(free_bounds[-1]), len(works)
    contacts = {owner: len(names) for owner, names in (states or {}).items()}
    sizes = [1, 3, 4, n, 6, n, n, m, sum(contacts.values()), f, f, 1, 1, w, 1, 1, 1, 1, 1, 1]
    ends = list(accumulate(sizes))
    columns = [rows[:, end - size : end] for size, end in zip(sizes, ends, strict=True)]
    t, x, quaternion, q, twist, v, torque, force, does, rates, places, *scalars = columns
    kinetic, potential, own, work, gap, rate, rank, coupled, residual = scalars
    block = {
        "time": t[:, 0],
        "object/position": x,
        "object/quaternion_xyzw": quaternion,
        "object/twist": twist,
        "energy/kinetic": kinetic[:, 0],
        "energy/potential": potential[:, 0],
        "energy/work": work[:, 0],
        "drift/position": gap[:, 0],
        "drift/velocity": rate[:, 0],
        "solver/rank": rank[:, 0],
        "solver/coupled_arms": coupled[:, 0],
        "solver/residual": residual[:, 0],
    }
    joints = {"joint_position": q, "joint_velocity": v, "joint_torque": torque}
    for name, values in joints.items():
        for arm, part in layout.split_joints(values).items():
            block[f"arms/{arm}/{name}"] = part
    for arm, part in layout.split_contacts(force).items():
        block[f"arms/{arm}/contact_force"] = part
    if layout.surroundings.start < layout.surroundings.stop:
        block["environment/contact_force"] = force[:, layout.surroundings]
    bounds = np.cumsum([0, *contacts.values()])
    for owner, first, last in zip(contacts, bounds[:-1], bounds[1:], strict=True):
        if first < last:
            place = f"arms/{owner}" if owner in layout.names else "environment"
            block[f"{place}/contact_state"] = does[:, first:last]
    for k, name in enumerate(works):
        block[f"effects/{name}/work"] = own[:, k]
    for arm, first, last in zip(layout.names, free_bounds[:-1], free_bounds[1:], strict=True):
        if first < last:
            block[f"arms/{arm}/relative_rate"] = rates[:, first:last]
            block[f"arms/{arm}/relative_position"] = places[:, first:last]
    return block
