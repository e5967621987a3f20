r"""Control laws that move the object: inverse dynamics along a path, and an impedance.

Both decide on a wrench ``w`` on the object, let the contacts share it
(:mod:`multiarm.control.force_distribution`), and turn the contact forces :math:`\lambda` into joint
torques.

* *Computed torque* commands the object's acceleration
  :math:`\dot v_o = a_r + D(v_r - v_o) + K e`, where ``e`` is the shift and the shortest turn to the
  reference.  The wrench is :math:`w = I_o\dot v_o + h_o`, and

  .. math:: \tau_i = M_i\ddot q_i + b_i - W_i\lambda_i, \qquad
            W_i^T\ddot q_i = c_i - W_{oi}^T\dot v_o

  (thesis, 3.10 in joint space).  Of all joint accelerations that the object's motion allows, the
  nearest to :math:`-\delta\dot q_i` in the metric of :math:`M_i` is taken, which lets free motions
  (a hinge that turns, an elbow that floats) die out at the rate :math:`\delta`.

* *Object impedance* holds the object by a spring and a damper; what is moved is the inertia of
  object and arms together: :math:`w = K e + D(v_r - v_o) - m g`,
  :math:`\tau_i = g_i - W_i\lambda_i - \delta M_i P_i\dot q_i` with :math:`P_i` the projection on
  the arm's free motions.  The spring has the energy :math:`\tfrac12 e^T K e` also in large turns
  and with a stiffness of its own about each axis, so that the law is passive while its reference
  rests: the turn ``theta`` to the reference has the rate :math:`-J_r^{-1}(\theta)\,\omega`, hence
  the moment :math:`J_r^{-T}(\theta) K\theta`.

With a stiffness of the free motions the arms are held at their places on the object instead
(:mod:`multiarm.control.null_space`).

Numbers of a law, from ``at``: stiffness (6), damping (6), rate and stiffness of the free motions,
whether there are internal forces; if so, wanted forces of all contacts and a wanted wrench of every
arm on the object; then the path.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.kernel import GAP_BIAS
from multiarm.control.force_distribution import share_load, static_forces
from multiarm.control.null_space import keep_place, nearest_accelerations
from multiarm.jit.kernels import allocating, kernel
from multiarm.spatial import difference, retract_into, write_chart_rate

STIFFNESS, DAMPING, FREE_RATE, FREE_STIFFNESS, SQUEEZES, LAW_WIDTH = 0, 6, 12, 13, 14, 15
# Of a segment of a path: first position, displacement, first quaternion, turn.
SEGMENT_WIDTH = 13


def pack_object_path(
    bounds: np.ndarray, positions: np.ndarray, quaternions: np.ndarray, turns: np.ndarray
) -> np.ndarray:
    """Parameters of :func:`write_reference`.

    Parameters
    ----------
    bounds : ndarray, shape (S + 1,)
        Times of the waypoints [s].
    positions, quaternions : ndarray, shapes (S + 1, 3) and (S + 1, 4)
        Of the object at the waypoints.
    turns : ndarray, shape (S, 3)
        Rotation vectors from waypoint to waypoint, world axes [rad].
    """
    table = np.hstack([positions[:-1], np.diff(positions, axis=0), quaternions[:-1], turns])
    return np.concatenate([[len(turns)], bounds, table.ravel()])


@allocating
def write_reference(t, parameters, at, pose, twist, acceleration):
    """Write where the object should be at ``t``: pose (7,), twist (6,), acceleration (6,).

    From one waypoint to the next it moves along a line and about a fixed axis, from rest to rest,
    by the quintic law of time; before the first and after the last it rests.
    """
    segments = int(parameters[at])
    bounds = at + 1
    s = 0
    while s < segments - 1 and t >= parameters[bounds + s + 1]:
        s += 1
    begin, length = parameters[bounds + s], parameters[bounds + s + 1] - parameters[bounds + s]
    x = min(max((t - begin) / length, 0.0), 1.0)
    way = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    rate = 30.0 * (x * (1.0 - x)) ** 2 / length
    second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / length**2
    first = bounds + segments + 1 + SEGMENT_WIDTH * s
    shift, turn = parameters[first + 3 : first + 6], parameters[first + 10 : first + 13]
    for k in range(3):
        pose[k] = parameters[first + k] + way * shift[k]
        twist[k], twist[3 + k] = rate * shift[k], rate * turn[k]
        acceleration[k], acceleration[3 + k] = second * shift[k], second * turn[k]
    retract_into(parameters[first + 6 : first + 10], way * turn, pose[3:7])


@allocating
def write_object_acceleration(t, parameters, at, path, position, velocity, wanted):
    """Write the object's acceleration that computed torque commands into ``wanted`` (6,)."""
    pose, twist, error = np.empty(7), np.empty(6), np.empty(6)
    write_reference(t, parameters, path, pose, twist, wanted)
    error[:3] = pose[:3] - position[:3]
    error[3:] = difference(position[3:7], pose[3:7])
    for k in range(6):
        wanted[k] += parameters[at + DAMPING + k] * (twist[k] - velocity[k])
        wanted[k] += parameters[at + STIFFNESS + k] * error[k]


@allocating
def write_spring_wrench(t, parameters, at, path, position, velocity, wrench):
    """Write the wrench of the impedance's spring and damper on the object into ``wrench`` (6,)."""
    pose, twist, acceleration = np.empty(7), np.empty(6), np.empty(6)
    write_reference(t, parameters, path, pose, twist, acceleration)
    turn = difference(position[3:7], pose[3:7])
    for k in range(3):
        wrench[k] = parameters[at + STIFFNESS + k] * (pose[k] - position[k])
    pull = parameters[at + STIFFNESS + 3 : at + STIFFNESS + 6] * turn
    write_chart_rate(turn, pull, wrench[3:6])
    for k in range(6):
        wrench[k] += parameters[at + DAMPING + k] * (twist[k] - velocity[k])


@allocating
def add_arm_forces(inertia, W, preferred, target, torque):
    r"""Add :math:`M\ddot q` of the nearest joint accelerations that obey the joint to ``torque``.

    See :func:`multiarm.control.null_space.nearest_accelerations` for the arguments.
    """
    n = preferred.size
    found = np.empty(n)
    nearest_accelerations(inertia, W, preferred, target, found)
    for j in range(n):
        for k in range(n):
            torque[j] += (inertia[j, k] if k <= j else inertia[k, j]) * found[k]


@kernel
def path_offset(parameters, at, work):
    """Where a law's path begins among its numbers."""
    if parameters[at + SQUEEZES] == 0.0:
        return at + LAW_WIDTH
    arms = work.rows.size - 1
    return at + LAW_WIDTH + work.rows[arms] + 6 * arms


@kernel
def write_contact_forces(parameters, at, data, work):
    """Let the contacts share ``data.weight`` as the law wants; writes ``static_force``."""
    weight, Wo, force = data.weight, data.Wo, data.static_force
    if parameters[at + SQUEEZES] == 0.0:
        static_forces(Wo, weight, force)
        return
    offsets = at + LAW_WIDTH
    pressing = offsets + force.size
    share_load(
        weight, Wo, work.rows, data.body, parameters[offsets:pressing],
        parameters[pressing : pressing + 6 * (work.rows.size - 1)], force,
    )  # fmt: skip


@kernel
def add_motion_forces(parameters, at, along, model, data, work, torque):
    """Add ``M q''`` of all arms: targets in ``data.c``, free motions die out or are held.

    ``along`` as in :func:`multiarm.control.null_space.keep_place`.
    """
    rate, stiffness = parameters[at + FREE_RATE], parameters[at + FREE_STIFFNESS]
    for j in range(data.v.size):
        data.qdd[j] = -rate * data.v[j]
    for i in range(work.rows.size - 1):
        d0, d1 = work.dofs[i], work.dofs[i + 1]
        r0, r1 = work.rows[i], work.rows[i + 1]
        if stiffness > 0.0:
            keep_place(i, stiffness, rate, along, model, data, work, data.qdd[d0:d1])
        add_arm_forces(work.L[i], work.Y[i], data.qdd[d0:d1], data.c[r0:r1], torque[d0:d1])


@kernel
def take_contact_forces(data, work, torque):
    """Take ``W lambda`` of the contact forces in ``data.static_force`` off the torques."""
    force = data.static_force
    for i in range(work.rows.size - 1):
        d0, r0 = work.dofs[i], work.rows[i]
        for j in range(work.dofs[i + 1] - d0):
            for a in range(work.rows[i + 1] - r0):
                torque[d0 + j] -= work.Y[i, j, a] * force[r0 + a]


@kernel
def add_computed_torque(t, parameters, at, model, data, work, torque):
    """Add the torques of computed torque, see the module's text.

    Until the equations of motion are solved ``data.q_o, qdd, c`` hold what the law wants.
    """
    wanted, wrench = data.q_o, data.weight
    path = path_offset(parameters, at, work)
    write_object_acceleration(t, parameters, at, path, data.position, data.twist, wanted)
    for a in range(6):
        wrench[a] = -data.h_o[a]
        for b in range(6):
            wrench[a] += data.inertia[a, b] * wanted[b]
    write_contact_forces(parameters, at, data, work)
    # the law carries the bias and what the joints do by themselves, which is all of h so far
    for j in range(torque.size):
        torque[j] -= data.h[j]
    for k in range(data.c.size):
        data.c[k] = -data.contacts[k, GAP_BIAS]
        for a in range(6):
            data.c[k] -= data.Wo[k, a] * wanted[a]
    add_motion_forces(parameters, at, True, model, data, work, torque)
    take_contact_forces(data, work, torque)


@kernel
def add_object_impedance(t, parameters, at, model, data, work, torque):
    """Add the torques of the object impedance, see the module's text."""
    wrench = data.weight
    path = path_offset(parameters, at, work)
    write_spring_wrench(t, parameters, at, path, data.position, data.twist, wrench)
    for k in range(3):
        wrench[k] -= model.object_mass * model.gravity[k]
    write_contact_forces(parameters, at, data, work)
    for j in range(torque.size):
        torque[j] += data.gravity_torque[j]
    for k in range(data.c.size):
        data.c[k] = 0.0
    add_motion_forces(parameters, at, False, model, data, work, torque)
    take_contact_forces(data, work, torque)
