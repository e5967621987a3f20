"""A sample as one row of numbers: its columns, and the kernel that writes it in their order.

A quaternion of a tip has the sign with which it continues that of the sample before; the first has
``w >= 0``.
"""

from __future__ import annotations

from collections.abc import Sequence

from multiarm.contacts.joint import unwrapped, write_relative
from multiarm.contacts.kernel import greatest_gaps
from multiarm.contacts.motion import open_body
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import write_wrenches
from multiarm.dynamics.equations import potential_energy
from multiarm.dynamics.momenta import kinetic_energy
from multiarm.dynamics.status import CALLBACK_FAILED, OK
from multiarm.dynamics.variables import TIP_WIDTH
from multiarm.jit.kernels import copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.vectors import add, add_cross, compose, put, rotate, rotation, vec
from multiarm.results.channels import Channel, Columns, in_sequence
from multiarm.spatial import quaternion_of


@kernel
def write_sample(struct, t, works, row):
    """Write an evaluated state as a row with the columns of :func:`sample_columns`.

    Returns a status.
    """
    model, data, work = open_system(struct)
    status = OK
    m, at = data.sample.forces.size, 1
    row[0] = t
    copy(data.state.configuration, row[at : at + data.state.configuration.size])
    at += data.state.configuration.size
    copy(data.state.velocity, row[at : at + data.state.velocity.size])
    at += data.state.velocity.size
    copy(data.control.torque, row[at : at + data.control.torque.size])
    at += data.control.torque.size
    if model.control.shape[0] > 0:
        copy(data.control.power, row[at : at + data.control.power.size])
        at += data.control.power.size
    if data.functions.contact_forces != 0:
        status = call_cfunc(data.functions.contact_forces, struct, t, 0.0)
    else:
        write_wrenches(data.rows.Wo, work.rows, data.rows.force, data.sample.wrenches)
    copy(data.sample.forces, row[at : at + m])
    at += m
    write_free(model, data, row[at:])
    at += 2 * model.free.component.size
    for i in range(data.sample.wrenches.shape[0]):
        copy(data.sample.wrenches[i], row[at : at + 6])
        at += 6
    write_tips(model, data)
    for i in range(data.sample.tips.shape[0]):
        copy(data.sample.tips[i], row[at : at + TIP_WIDTH])
        at += TIP_WIDTH
    row[at] = kinetic_energy(data, work)
    row[at + 1] = potential_energy(struct)
    at += 2
    copy(works, row[at : at + works.size])
    at += works.size
    row[at], row[at + 1] = greatest_gaps(data.rows.kinematics)
    row[at + 2] = data.solution.rank
    row[at + 3] = data.solution.coupled_arms
    row[at + 4] = data.solution.residual
    return CALLBACK_FAILED if data.status.failed else status


@kernel
def write_free(model, data, out):
    """Free relative rates of all joints, then their coordinates."""
    rates, coordinates = data.joint_motion.rates, data.joint_motion.coordinates
    free, count = model.free, model.free.component.size
    for i in range(model.joint_frames.shape[0]):
        first, last = model.free.bounds[i], model.free.bounds[i + 1]
        if first == last:
            continue
        write_relative(
            model.joint_frames[i], data.bodies.links[i], data.bodies.object, rates, coordinates
        )
        for k in range(first, last):
            out[k] = rates[free.component[k]]
            out[count + k] = continued(model, data, i, k, coordinates)


@kernel
def write_tips(model, data):
    """Origins, quaternions and twists of the tips, in world axes, into ``data.sample.tips``."""
    for i in range(data.sample.tips.shape[0]):
        frame, link, tip = model.tip_frames[i], open_body(data.bodies.links[i]), data.sample.tips[i]
        R, omega = link.rotation, link.spin
        lever = rotate(R, vec(frame, 9))
        x, y, z, w = quaternion_of(*compose(R, rotation(frame, 0)))
        if x * tip[3] + y * tip[4] + z * tip[5] + w * tip[6] < 0.0:
            x, y, z, w = -x, -y, -z, -w
        put(tip, 0, add(link.origin, lever))
        tip[3], tip[4], tip[5], tip[6] = x, y, z, w
        put(tip, 7, add_cross(link.velocity, omega, lever))
        put(tip, 10, omega)


@kernel
def follow_joints(model, data):
    """Store the free coordinates of all joints at the end of a step in ``data.last_step``."""
    rates, coordinates = data.joint_motion.rates, data.joint_motion.coordinates
    for i in range(model.joint_frames.shape[0]):
        first, last = model.free.bounds[i], model.free.bounds[i + 1]
        if first == last:
            continue
        write_relative(
            model.joint_frames[i], data.bodies.links[i], data.bodies.object, rates, coordinates
        )
        for k in range(first, last):
            component = model.free.component[k]
            data.last_step.coordinates[i, component] = continued(model, data, i, k, coordinates)


@inlined
def continued(model, data, i, k, coordinates):
    """Coordinate ``k``, of arm ``i``, as it continues that of the last step."""
    component, place = model.free.component[k], model.free.coordinate[k]
    return unwrapped(coordinates[place], data.last_step.coordinates[i, component], place)


def sample_columns(channels: Sequence[Channel]) -> Columns:
    """Where the channels of a run are in a row of :func:`write_sample`."""
    # names of channels, or their last parts: those of all arms, of the floor and of all effects
    # stand together, in the order of the channels; those of a tip stand together
    order = (
        "time", "object/position", "object/quaternion_xyzw", "joint_position", "object/twist",
        "joint_velocity", "joint_torque", "control_power", "contact_force", "contact_state",
        "relative_rate", "relative_position", "wrench", "tip", "energy/kinetic",
        "energy/potential", "work", "energy/work", "drift/position", "drift/velocity",
        "solver/rank", "solver/coupled_arms", "solver/residual",
    )  # fmt: skip

    def place(channel: Channel) -> int:
        name = channel.name
        last = name.rpartition("/")[2]
        return order.index(name if name in order else "tip" if last.startswith("tip_") else last)

    return in_sequence(sorted(channels, key=place))
