r"""The configuration manifold, and the chart in which the integrator moves on it.

A configuration is F poses of floating frames and n numbers, the joint positions.  Displacements
:math:`u` are in the order of a velocity (:mod:`multiarm.dynamics.layout`), in world axes:

.. math::
    x_f \oplus u = x_f + \delta_f, \qquad R_f \oplus u = \exp(\theta_f) R_f, \qquad
    q \oplus u = q + \delta_q, \qquad u = (\delta_f, \theta_f, \ldots, \delta_q).

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
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.spatial import difference as rotation_difference
from multiarm.spatial import retract_into as retract_quaternion
from multiarm.spatial import rotation_between, write_chart_rate

# --- configurations ------------------------------------------------------------------------------


@plain
def retract_into(frames, start, step, displacement, configuration):
    """Write ``start (+) step * displacement`` into ``configuration``, which may be ``start``.

    Parameters
    ----------
    frames : int
        Number of floating frames, F.
    start, configuration : ndarray, shape (7 F + n,)
    step : float
    displacement : ndarray, shape (6 F + n,), or longer
    """
    for f in range(frames):
        at, by = 7 * f, 6 * f
        turn = (
            step * displacement[by + 3],
            step * displacement[by + 4],
            step * displacement[by + 5],
        )
        for k in range(3):
            configuration[at + k] = start[at + k] + step * displacement[by + k]
        retract_quaternion(start[at + 3 : at + 7], turn, configuration[at + 3 : at + 7])
    for j in range(configuration.size - 7 * frames):
        moved = step * displacement[6 * frames + j]
        configuration[7 * frames + j] = start[7 * frames + j] + moved


def retract(layout: Layout, start: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """``start (+) displacement``, a new configuration."""
    configuration = np.empty_like(start)
    retract_into(layout.frames, start, 1.0, displacement, configuration)
    return configuration


def difference(layout: Layout, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The displacement u with ``start (+) u = end``, each frame turned the shorter way round."""
    displacement = np.empty(layout.nv)
    poses, there = layout.poses(start), layout.poses(end)
    for twist, pose, other in zip(layout.twists(displacement), poses, there, strict=True):
        twist[:3], twist[3:] = other[:3] - pose[:3], rotation_difference(pose[3:], other[3:])
    joints = layout.joint_positions(end) - layout.joint_positions(start)
    displacement[layout.of_joints] = joints
    return displacement


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
    multipliers: int  # of a law, six, see multiarm.dynamics.control_laws
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
    return ForceColumns(twists, positions, rates, first_state, time, time + 1, time + 7)


class ArmColumns(NamedTuple):
    """First columns of what an arm's equations depend on: the object's state and the arm's own.

    Where they are wanted, also a displacement (6) of the contacts of each of its connections
    against their first body, in its axes.
    """

    twists: int  # of the object
    positions: int  # of the arm's joints
    rates: int
    placement: int
    end: int  # number of coordinates, C


@plain
def arm_columns(joints, placements):
    """The columns of an arm with numbers of joints, and of connections that are displaced."""
    twists, positions, rates, placement = columns_of_state(TWIST + joints, joints)
    end = placement + TWIST * placements
    return ArmColumns(twists, positions, rates, placement, end)


@inlined
def column_of_state(at, columns, d0, c):
    """Place among all columns ``at`` of one of an arm, whose joints begin at ``d0``.

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
def read_chart(frames, z, base, configuration):
    """Write the configuration of a chart's vector."""
    retract_into(frames, base, 1.0, z, configuration)


@plain
def load_chart(z, base, data):
    """Write the state of a chart into the data, without the works."""
    places = chart_places(data)
    read_chart(data.state.poses.shape[0], z, base, data.state.configuration)
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
    write_all_but_turns(data, z)


@inlined
def write_chart(data, base, z):
    """Write the state in the data as a vector of the chart with this base; the works stay."""
    for f in range(data.state.poses.shape[0]):
        turn = rotation_between(base[7 * f + 3 : 7 * f + 7], data.state.poses[f, 3:7])
        for k in range(3):
            z[6 * f + 3 + k] = turn[k]
    write_all_but_turns(data, z)


@plain
def write_all_but_turns(data, z):
    """Copy what the state and a chart's vector share: all but how the frames are turned."""
    places = chart_places(data)
    for f in range(data.state.poses.shape[0]):
        for k in range(3):
            z[6 * f + k] = data.state.poses[f, k]
    for j in range(data.state.joint_positions.size):
        z[places.joints + j] = data.state.joint_positions[j]
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
    for j in range(data.state.joint_rates.size):
        slope[places.joints + j] = data.state.joint_rates[j]
    for k in range(data.accelerations.a.size):
        slope[places.velocity + k] = data.accelerations.a[k]
    for k in range(data.effects.state_rates.size):
        slope[places.states + k] = data.effects.state_rates[k]
    for k in range(data.effects.power.size):
        slope[places.works + k] = data.effects.power[k]
