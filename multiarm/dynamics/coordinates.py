r"""The configuration manifold, and the chart in which the integrator moves on it.

A configuration is F poses of floating frames, poses of the floating bases of robots, and n numbers,
the joint positions.  Displacements :math:`u` are in the order of a velocity
(:mod:`multiarm.dynamics.layout`), in world axes:

.. math::
    x_f \oplus u = x_f + \delta_f, \qquad R_f \oplus u = \exp(\theta_f) R_f, \qquad
    q \oplus u = q + \delta_q, \qquad u = (\delta_f, \theta_f, \ldots, \delta_q).

Of the n numbers, the first six of a robot with a floating base are the displacement from the pose
of this base, which is always zero: :math:`x \oplus u` moves the pose by them.  They stand in the
chart, so that positions, velocities and forces of robots have the same indices.

Within a step the orientations are :math:`R_f = \exp(\theta_f) R_{0f}` with those at the beginning
of the step.  The *base* of the chart is a configuration with these orientations and with positions
of zero: a chart is a displacement from it.  So the state is a plain vector,

.. code-block:: text

    z = [frames (6 F): position, rotation vector;  joint positions (n);  velocity (6 F + n);
         states of effects (e);  works (w)]

with :math:`\dot\theta` from :func:`multiarm.spatial.write_chart_rate`.  Runge-Kutta methods keep
their order and their dense output in it (H. Munthe-Kaas, BIT 38, 1998); after the step the rotation
goes into the full quaternion, and the next chart begins at :math:`\theta = 0`.  The works are
those of each effect, and of control and effects together: quadratures for the energy balance.

``data`` are the variables of an evaluation (:class:`multiarm.dynamics.variables.Variables`), as
arrays in Python and as their view in kernels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics import layout as parts
from multiarm.dynamics.layout import TWIST, Layout
from multiarm.jit.kernels import copy, inlined, kernel, plain
from multiarm.spatial import difference as rotation_difference
from multiarm.spatial import retract_into as retract_quaternion
from multiarm.spatial import rotation_between, write_chart_rate

# --- configurations ------------------------------------------------------------------------------


@plain
def retract_into(frames, bases, start, step, displacement, configuration):
    """Write ``start (+) step * displacement`` into ``configuration``, which may be ``start``.

    Parameters
    ----------
    frames : int
        Number of floating frames, F.
    bases : int64 ndarray, shape (B,)
        The first of the six numbers of each floating base, among the n.
    start, configuration : ndarray, shape (7 F + 7 B + n,)
    step : float
    displacement : ndarray, shape (6 F + n,), or longer
    """
    for f in range(frames):
        retract_pose(7 * f, 6 * f, start, step, displacement, configuration)
    retract_joints(frames, bases, start, step, displacement, configuration)


@plain
def retract_joints(frames, bases, start, step, displacement, configuration):
    """:func:`retract_into` for the robots alone: the other frames stay."""
    first = 7 * (frames + bases.size)
    for j in range(configuration.size - first):
        moved = step * displacement[6 * frames + j]
        configuration[first + j] = start[first + j] + moved
    for b in range(bases.size):
        by = 6 * frames + bases[b]
        retract_pose(7 * (frames + b), by, start, step, displacement, configuration)
        for k in range(6):
            configuration[first + bases[b] + k] = 0.0


@plain
def retract_pose(at, by, start, step, displacement, configuration):
    """Write the pose from ``at`` on, moved by the six numbers from ``by`` on."""
    turn = (
        step * displacement[by + 3],
        step * displacement[by + 4],
        step * displacement[by + 5],
    )
    for k in range(3):
        configuration[at + k] = start[at + k] + step * displacement[by + k]
    retract_quaternion(start[at + 3 : at + 7], turn, configuration[at + 3 : at + 7])


def retract(layout: Layout, start: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """``start (+) displacement``, a new configuration."""
    configuration = np.empty_like(start)
    retract_into(layout.frames, floating_bases(layout), start, 1.0, displacement, configuration)
    return configuration


def difference(layout: Layout, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The displacement u with ``start (+) u = end``, each frame turned the shorter way round."""
    displacement = np.empty(layout.nv)
    joints = layout.joint_positions(end) - layout.joint_positions(start)
    displacement[layout.of_joints] = joints
    twists = [*layout.twists(displacement), *layout.base_twists(displacement)]
    poses, there = ([*layout.poses(place), *layout.base_poses(place)] for place in (start, end))
    for twist, pose, other in zip(twists, poses, there, strict=True):
        twist[:3], twist[3:] = other[:3] - pose[:3], rotation_difference(pose[3:], other[3:])
    return displacement


def floating_bases(layout: Layout) -> np.ndarray:
    """The first number of each floating base, as kernels have them, int64 (B,)."""
    return np.array(layout.first_of_bases, dtype=np.int64)


# --- columns of derivatives -----------------------------------------------------------------------

columns_of_state, places_in_chart = plain(parts.columns_of_state), plain(parts.places_in_chart)
column_of_displacement = plain(parts.column_of_displacement)
column_of_velocity = plain(parts.column_of_velocity)


class EquationColumns(NamedTuple):
    """First columns of derivatives by the state, and by forces: torques, wrenches on the frames."""

    twists: int
    positions: int  # of joints
    rates: int
    torques: int
    wrench: int
    end: int


@plain
def equation_columns(data):
    """The columns for the sizes of these data."""
    velocities, joints = data.state.velocity.size, data.state.joint_positions.size
    twists, positions, rates, torques = columns_of_state(velocities, joints)
    wrench = torques + joints
    return EquationColumns(twists, positions, rates, torques, wrench, wrench + twists)


class ForceColumns(NamedTuple):
    """First columns of derivatives of forces: by the state, and what else they depend on."""

    twists: int
    positions: int  # of joints
    rates: int
    states: int  # of effects
    time: int
    multipliers: int  # of a law, six an object, see multiarm.dynamics.control_laws
    end: int


@plain
def force_columns(data):
    """The columns for the sizes of these data."""
    return columns_of_forces(
        data.state.velocity.size, data.state.joint_positions.size, data.effects.states.size
    )


@plain
def columns_of_forces(velocities, joints, states):
    """The columns for numbers of velocities, joints among them, and states of effects."""
    twists, positions, rates, first_state = columns_of_state(velocities, joints)
    time = first_state + states
    end = time + 1 + velocities - joints
    return ForceColumns(twists, positions, rates, first_state, time, time + 1, end)


class BlockColumns(NamedTuple):
    """First columns of what a block's equations depend on: the object's state and the block's own.

    Where they are wanted, also a displacement (6) of the contacts of each of its connections
    against their first body, in its axes.
    """

    twists: int  # of the object
    positions: int  # of the block's joints
    rates: int
    placement: int
    end: int  # number of coordinates, C


@plain
def block_columns(node, joints, placements):
    """The columns of a block with numbers of joints, and of connections that are displaced."""
    twists, positions, rates, placement = columns_of_state(node + joints, joints)
    end = placement + TWIST * placements
    return BlockColumns(twists, positions, rates, placement, end)


@inlined
def column_of_state(at, columns, d0, c):
    """Place among all columns ``at`` of one of a block, whose joints begin at ``d0``.

    The object is the first frame; columns of placements are no columns of the state.
    """
    if c < columns.twists:
        return c
    if c < columns.positions:
        return at.twists + c - columns.twists
    if c < columns.rates:
        return at.positions + d0 + c - columns.positions
    return at.rates + d0 + c - columns.rates


# --- the integrator's chart ----------------------------------------------------------------------


@plain
def chart_places(data):
    """The places for the sizes of these data."""
    return places_in_chart(
        data.state.velocity.size, data.state.joint_positions.size, data.effects.states.size
    )


@plain
def place_in_chart(columns, places, column):
    """Place in a chart's vector of a column of the state."""
    if column < columns.twists:
        return column
    if column < columns.positions:
        return places.velocity + column - columns.twists
    if column < columns.rates:
        return places.joints + column - columns.positions
    return places.rates + column - columns.rates


@plain
def read_chart(frames, bases, z, base, configuration):
    """Write the configuration of a chart's vector."""
    retract_into(frames, bases, base, 1.0, z, configuration)


@plain
def load_chart(z, base, data):
    """Write the state of a chart into the data, without the works."""
    places = chart_places(data)
    state = data.state
    read_chart(state.poses.shape[0], state.floating_bases, z, base, state.configuration)
    for k in range(data.state.velocity.size):
        data.state.velocity[k] = z[places.velocity + k]
    for k in range(data.effects.states.size):
        data.effects.states[k] = z[places.states + k]


@inlined
def write_new_chart(data, base, z):
    """Begin a chart at the state in the data: ``theta = 0``; the works in ``z`` stay."""
    for f in range(data.state.poses.shape[0]):
        for k in range(3):
            z[6 * f + 3 + k] = 0.0
        for k in range(3, 7):
            base[7 * f + k] = data.state.poses[f, k]
    for b in range(data.state.floating_bases.size):
        for k in range(3, 7):
            base[7 * (data.state.poses.shape[0] + b) + k] = data.state.base_poses[b, k]
    write_all_but_turns(data, z)


@inlined
def write_chart(data, base, z):
    """Write the state in the data as a vector of the chart with this base; the works stay."""
    for f in range(data.state.poses.shape[0]):
        turn = rotation_between(base[7 * f + 3 : 7 * f + 7], data.state.poses[f, 3:7])
        for k in range(3):
            z[6 * f + 3 + k] = turn[k]
    write_all_but_turns(data, z)
    frames, places = data.state.poses.shape[0], chart_places(data)
    for b in range(data.state.floating_bases.size):
        before = base[7 * (frames + b) + 3 : 7 * (frames + b) + 7]
        turn = rotation_between(before, data.state.base_poses[b, 3:7])
        for k in range(3):
            z[places.joints + data.state.floating_bases[b] + 3 + k] = turn[k]


@plain
def write_all_but_turns(data, z):
    """Copy what the state and a chart's vector share: all but how the frames are turned.

    Bases are as at the beginning of a chart.
    """
    places = chart_places(data)
    for f in range(data.state.poses.shape[0]):
        for k in range(3):
            z[6 * f + k] = data.state.poses[f, k]
    for j in range(data.state.joint_positions.size):
        z[places.joints + j] = data.state.joint_positions[j]
    for b in range(data.state.floating_bases.size):
        for k in range(3):
            z[places.joints + data.state.floating_bases[b] + k] = data.state.base_poses[b, k]
    for k in range(data.state.velocity.size):
        z[places.velocity + k] = data.state.velocity[k]
    for k in range(data.effects.states.size):
        z[places.states + k] = data.effects.states[k]


@kernel
def write_chart_slope(z, data, slope):
    """Rate of ``z`` from velocity, accelerations, rates of effects' states, and powers."""
    places = chart_places(data)
    for f in range(data.state.poses.shape[0]):
        first = 6 * f
        for k in range(3):
            slope[first + k] = data.state.velocity[first + k]
        write_chart_rate(
            z[first + 3 : first + 6],
            data.state.velocity[first + 3 : first + 6],
            slope[first + 3 : first + 6],
        )
    copy(data.state.joint_rates, slope[places.joints : places.velocity])
    for b in range(data.state.floating_bases.size):
        first = data.state.floating_bases[b] + 3
        at = places.joints + first
        omega = data.state.joint_rates[first : first + 3]
        write_chart_rate(z[at : at + 3], omega, slope[at : at + 3])
    copy(data.accelerations.a, slope[places.velocity : places.states])
    copy(data.effects.state_rates, slope[places.states : places.works])
    copy(data.effects.power, slope[places.works :])
