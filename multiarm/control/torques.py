r"""Control laws as compiled pieces: what the scene names becomes a short program over arrays.

A program is a list of laws: the address of a kernel that adds its torques to ``torque``, and where
its parameters begin.  Only the laws that a scene names are compiled; one without control has an
empty program.

* *harmonic*: :math:`\tau_j = \tau_{0j} + A_j \sin(2\pi f t + \psi_j)`; constant torques have no A.
* *gravity compensation*: the torques that hold the whole system still where it is,
  :math:`\tau_i = g_i(q_i) - W_i\lambda_i`, with the contact forces of least norm that carry the
  object, :math:`W_o\lambda = [-m g; 0]` (thesis, 3.4 and 3.10 at rest).
* *joint PD*: :math:`\tau = K_p (q_r(t) - q) + K_d (\dot q_r(t) - \dot q)`; the reference is a point
  or a path of Chebyshev segments, smooth inside each segment.
* *computed torque* and *object impedance* move the object, see
:mod:`multiarm.control.object_control`.
* *Python*: a user function, see :mod:`multiarm.dynamics.user_callback`.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.control.force_distribution import static_forces
from multiarm.control.object_control import (
    add_computed_torque,
    add_object_impedance,
    take_contact_forces,
)
from multiarm.dynamics.arrays import open_system
from multiarm.jit.kernels import cfunc, clear, kernel
from multiarm.jit.structs import struct_at


@kernel
def add_harmonic(t, parameters, at, torque):
    """``parameters[at:]``: frequency [Hz], then for every joint ``tau_0, A cos psi, A sin psi``."""
    angle = 2.0 * math.pi * parameters[at] * t
    sine, cosine = math.sin(angle), math.cos(angle)
    for j in range(torque.size):
        k = at + 1 + 3 * j
        torque[j] += parameters[k] + parameters[k + 1] * sine + parameters[k + 2] * cosine


def pack_harmonic(
    frequency: float, constant: np.ndarray, amplitude: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Parameters of :func:`add_harmonic`."""
    columns = [constant, amplitude * np.cos(phase), amplitude * np.sin(phase)]
    return np.concatenate([[frequency], np.column_stack(columns).ravel()])


@kernel
def path_point(t, parameters, at, joints, joint):
    """Reference of one joint and its rate at time ``t``; before and after the path it rests.

    ``parameters[at:]``: number of segments, coefficients a joint, the segments' bounds, then the
    Chebyshev coefficients [segment, joint, coefficient], summed by Clenshaw's recurrence.
    """
    segments, width = int(parameters[at]), int(parameters[at + 1])
    bounds = at + 2
    table = bounds + segments + 1
    s = 0
    while s < segments - 1 and t >= parameters[bounds + s + 1]:
        s += 1
    begin, end = parameters[bounds + s], parameters[bounds + s + 1]
    moving = begin <= t <= end
    x = 2.0 * (min(max(t, begin), end) - begin) / (end - begin) - 1.0
    first = table + (s * joints + joint) * width
    # Clenshaw for the value (b) and for its derivative with respect to x (d)
    b1 = b2 = d1 = d2 = 0.0
    for k in range(width - 1, 0, -1):
        d0 = 2.0 * b1 + 2.0 * x * d1 - d2
        b0 = parameters[first + k] + 2.0 * x * b1 - b2
        b2, b1, d2, d1 = b1, b0, d1, d0
    value = parameters[first] + x * b1 - b2
    slope = b1 + x * d1 - d2
    return value, slope * 2.0 / (end - begin) if moving else 0.0


def pack_path(bounds: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Parameters of :func:`path_point` from ``bounds`` (S + 1,), ``coefficients`` (S, n, width)."""
    return np.concatenate(
        [[coefficients.shape[0], coefficients.shape[2]], bounds, coefficients.ravel()]
    )


@kernel
def add_joint_pd(t, angles, velocity, parameters, at, torque):
    """``parameters[at:]``: stiffness and damping of every joint, then the path."""
    n = torque.size
    for j in range(n):
        reference, rate = path_point(t, parameters, at + 2 * n, n, j)
        torque[j] += parameters[at + j] * (reference - angles[j])
        torque[j] += parameters[at + n + j] * (rate - velocity[j])


@cfunc
def harmonic(address, size, at, t):
    """See :func:`add_harmonic`; constant torques have no amplitude."""
    model, data, _ = open_system(struct_at(address, size))
    add_harmonic(t, model.parameters, int(at), data.torque)
    return 0


@cfunc
def joint_pd(address, size, at, t):
    """See :func:`add_joint_pd`."""
    model, data, _ = open_system(struct_at(address, size))
    add_joint_pd(t, data.angles, data.v, model.parameters, int(at), data.torque)
    return 0


@cfunc
def gravity_compensation(address, size, _at, _t):
    """See :func:`add_gravity_compensation`."""
    model, data, work = open_system(struct_at(address, size))
    add_gravity_compensation(model, data, work, data.torque)
    return 0


@cfunc
def computed_torque(address, size, at, t):
    """See :func:`multiarm.control.object_control.add_computed_torque`."""
    model, data, work = open_system(struct_at(address, size))
    add_computed_torque(t, model.parameters, int(at), model, data, work, data.torque)
    return 0


@cfunc
def object_impedance(address, size, at, t):
    """See :func:`multiarm.control.object_control.add_object_impedance`."""
    model, data, work = open_system(struct_at(address, size))
    add_object_impedance(t, model.parameters, int(at), model, data, work, data.torque)
    return 0


@kernel
def write_holding_torque(struct):
    """Write the torques that hold the configuration in ``data`` into ``data.torque``.

    Needs its kinematics and ``gravity_torque`` in ``data``.
    """
    model, data, work = open_system(struct)
    clear(data.torque)
    add_gravity_compensation(model, data, work, data.torque)


@kernel
def add_gravity_compensation(model, data, work, torque):
    """Torques that hold arms and object still where they are, see the module's text."""
    weight = data.weight
    for k in range(3):
        weight[k] = -model.object_mass * model.gravity[k]
        weight[3 + k] = 0.0
    static_forces(data.Wo, weight, data.static_force)
    for j in range(torque.size):
        torque[j] += data.gravity_torque[j]
    take_contact_forces(data, work, torque)
