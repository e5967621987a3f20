"""A sample as one row of numbers: the kernel that writes it, in the order of the channels.

A quaternion of a tip has the sign with which it continues that of the sample before; the first has
``w >= 0``.
"""

from __future__ import annotations

from multiarm.contacts.joint import unwrapped
from multiarm.contacts.kernel import greatest_gaps
from multiarm.contacts.motion import open_body
from multiarm.dynamics.arrays import open_system, open_tip_frame
from multiarm.dynamics.contact_forces import write_wrenches
from multiarm.dynamics.equations import potential_energy
from multiarm.dynamics.kinematics import write_connection_motion
from multiarm.dynamics.momenta import kinetic_energy
from multiarm.dynamics.status import CALLBACK_FAILED, OK
from multiarm.dynamics.variables import open_tip
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.vectors import add, add_cross, compose, rotate
from multiarm.spatial import quaternion_of


@kernel
def write_sample(struct, t, works, row):
    """Write an evaluated state as a row, a channel of
    :func:`multiarm.results.channels.trajectory_channels` after the other.

    Returns a status.
    """
    model, data, work = open_system(struct)
    state, control, status = data.state, data.control, OK
    if data.functions.contact_forces != 0:
        status = call_cfunc(data.functions.contact_forces, struct, t, 0.0)
    else:
        write_wrenches(model, data, data.rows.force)
    write_tips(model, data)
    row[0] = t
    at = 1
    for o in range(state.poses.shape[0]):
        at = append(row, at, state.poses[o])
        at = append(row, at, state.twists[o])
    b, robots = 0, control.power.size
    for i in range(robots):
        first, last = model.first_joint[i], model.first_joint[i + 1]
        floats = b < state.floating_bases.size and model.floating_bases.robot[b] == i
        if floats:
            first += 6
        at = append(row, at, state.joint_positions[first:last])
        at = append(row, at, state.joint_rates[first:last])
        at = append(row, at, control.torque[first:last])
        if model.control.shape[0] > 0:
            at = append(row, at, control.power[i : i + 1])
        if floats:
            at = append(row, at, state.base_poses[b])
            at = append(row, at, state.joint_rates[first - 6 : first])
            b += 1
        at = append_owners(model, data, i, row, at)
    at = append_owners(model, data, robots, row, at)  # those of no robot
    last = works.size - 1
    at = append(row, at, works[:last])
    row[at], row[at + 1] = kinetic_energy(data, work), potential_energy(struct)
    row[at + 2] = works[last]
    row[at + 3], row[at + 4] = greatest_gaps(data.rows.kinematics)
    row[at + 5], row[at + 6] = data.solution.rank, data.solution.coupled_blocks
    row[at + 7] = data.solution.residual
    return CALLBACK_FAILED if data.status.failed else status


@inlined
def append(row, at, numbers):
    """Write numbers from ``at`` on; returns where they end."""
    for k in range(numbers.size):
        row[at + k] = numbers[k]
    return at + numbers.size


@kernel
def append_owners(model, data, robot, row, at):
    """Write what is recorded of the owners of rows of a robot; returns where that ends."""
    for c in range(model.connections.robot.size):
        if model.connections.robot[c] == robot:
            at = append_contacts(model, data, c, row, at)
    return at


@kernel
def append_contacts(model, data, c, row, at):
    """Write what is recorded of an owner of rows: its contacts, connection and tip.

    Returns where that ends.
    """
    sample, first, second = data.sample, model.connections.first[c], model.connections.second[c]
    at = append(row, at, sample.forces[sample.rows[c] : sample.rows[c + 1]])
    at = append(row, at, sample.forces[sample.states[c] : sample.states[c + 1]])
    at = append_free(model, data, c, row, at)
    if first != second:
        at = append(row, at, sample.wrenches[c])
    if first < data.bodies.links.shape[0]:
        at = append(row, at, sample.tips[c])
    return at


@kernel
def append_free(model, data, c, row, at):
    """Write free relative rates of a connection, then its coordinates; returns where they end."""
    rates, coordinates = data.joint_motion.rates, data.joint_motion.coordinates
    free, first, last = model.free, model.free.bounds[c], model.free.bounds[c + 1]
    if first == last:
        return at
    write_connection_motion(model, data, c, rates, coordinates)
    for k in range(first, last):
        row[at + k - first] = rates[free.component[k]]
        row[at + k - first + last - first] = continued(model, data, c, k, coordinates)
    return at + 2 * (last - first)


@kernel
def write_tips(model, data):
    """Origins, quaternions and twists of the tips, in world axes, into ``data.sample.tips``."""
    for c in range(data.sample.tips.shape[0]):
        body = model.connections.first[c]
        if body >= data.bodies.links.shape[0]:
            continue
        frame, link = open_tip_frame(model.tip_frames[c]), open_body(data.bodies.links[body])
        tip, lever = open_tip(data.sample.tips[c]), rotate(link.rotation, frame.origin)
        x, y, z, w = quaternion_of(*compose(link.rotation, frame.rotation))
        before = tip.quaternion_xyzw
        if x * before[0] + y * before[1] + z * before[2] + w * before[3] < 0.0:
            x, y, z, w = -x, -y, -z, -w
        tip.position, tip.quaternion_xyzw = add(link.origin, lever), (x, y, z, w)
        tip.twist = add_cross(link.velocity, link.spin, lever), link.spin


@kernel
def follow_joints(model, data):
    """Store the free coordinates of all connections at the end of a step in ``data.this_step``."""
    rates, coordinates = data.joint_motion.rates, data.joint_motion.coordinates
    for c in range(model.joint_frames.shape[0]):
        first, last = model.free.bounds[c], model.free.bounds[c + 1]
        if first == last:
            continue
        write_connection_motion(model, data, c, rates, coordinates)
        for k in range(first, last):
            component = model.free.component[k]
            data.this_step.coordinates[c, component] = continued(model, data, c, k, coordinates)


@inlined
def continued(model, data, c, k, coordinates):
    """Coordinate ``k``, of connection ``c``, as it continues that of the last step."""
    component, place = model.free.component[k], model.free.coordinate[k]
    return unwrapped(coordinates[place], data.last_step.coordinates[c, component], place)
