r"""Control laws: from the control of a scene to compiled functions and their numbers.

A control program is a list of laws: the address of a compiled function that adds its torques to
``torque``, and the offset of its numbers among the parameters.  Only the laws that a scene names
are compiled; a scene without control has an empty program.

* *harmonic*: :math:`\tau_j = \tau_{0j} + A_j \sin(2\pi f t + \psi_j)`; constant torques have no A.
* *recorded*: torques or references from a table, see :mod:`multiarm.control.recorded`.
* *gravity compensation*: the torques that hold the whole system at rest,
  :math:`\tau_i = g_i(q_i) - W_i\lambda_i`, with the contact forces of least norm that carry the
  object, :math:`W_o\lambda = [-m g; 0]` (thesis, 3.4 and 3.10 at rest).
* *joint PD*: :math:`\tau = K_p (q_r(t) - q) + K_d (\dot q_r(t) - \dot q)`; the reference is a point
  or a path of Chebyshev segments, smooth inside each segment.
* *computed torque* and *object impedance* move the object, see
  :mod:`multiarm.control.object_control`.
* *Python*: a user function, see :mod:`multiarm.dynamics.callbacks`.

Any of them but constant torques can be sampled, see :mod:`multiarm.dynamics.held_control`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.control.force_distribution import static_forces
from multiarm.control.object_control import (
    computed_torque,
    object_impedance,
    object_law,
    take_contact_forces,
)
from multiarm.control.recorded import (
    pack_table,
    recorded_position,
    recorded_torque,
    rough_times,
)
from multiarm.control.tables import read_table
from multiarm.dynamics.arrays import OK, open_system
from multiarm.dynamics.callbacks import NO_CONTROL
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.held_control import Sampling
from multiarm.dynamics.model import ControlSpan, Data
from multiarm.dynamics.state import State
from multiarm.jit.kernels import INTS, Kernel, cfunc, clear, kernel
from multiarm.jit.pointers import address_of
from multiarm.jit.structs import struct_at
from multiarm.scene import Scene, gain_vector
from multiarm.scene.control import (
    ComputedTorqueControl,
    ConstantControl,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    NoControl,
    ObjectImpedanceControl,
    RecordedControl,
    SampledControl,
)


class JointPath(NamedTuple):
    """Joint positions along a path."""

    bounds: np.ndarray  # (S + 1,) times of the waypoints [s]
    coefficients: np.ndarray  # (S, n, width) Chebyshev series of every segment and joint [rad, m]


class ControlProgram(NamedTuple):
    """The control laws of a scene."""

    laws: np.ndarray  # ``Constants.control``
    parameters: np.ndarray  # ``Constants.parameters``
    breakpoints: np.ndarray  # times at which the torques are not smooth [s]
    sampling: Sampling | None = None  # None: evaluated all the time
    span: ControlSpan | None = None  # None: defined at all times


def needs_gravity_torque(scene: Scene) -> bool:
    """Whether some part of the control needs the arms' gravity forces at every evaluation."""
    control = scene.control
    if scene.gravity is None:
        return False
    if control.kind == "recorded":
        return control.compensates_gravity
    return control.kind in ("gravity_compensation", "object_impedance") or (
        control.kind == "joint_pd" and control.gravity_compensation
    )


def control_program(
    scene: Scene, data: Data, start: State, joint_path: Callable[..., JointPath]
) -> ControlProgram:
    """The laws of a scene's control, for a model whose contacts are all closed.

    Parameters
    ----------
    scene : Scene
    data : Data
        Of a model without control; its state is changed.
    start : State
    joint_path : callable
        ``joint_path(waypoints)``: joint positions with which the object passes them.

    Raises
    ------
    ControlError
        When the contacts cannot have the forces that the control commands.
    SceneError
        When a recorded table cannot be used.
    """
    program = _continuous_program(scene, data, start, joint_path)
    control = scene.control
    if not isinstance(control, SampledControl) or control.sample_time is None:
        return program
    sampling = Sampling(control.sample_time, control.sample_delay)
    # held torques change at samples only
    return program._replace(sampling=sampling, breakpoints=np.zeros(0))


def _continuous_program(
    scene: Scene, data: Data, start: State, joint_path: Callable[..., JointPath]
) -> ControlProgram:
    none = np.zeros(0)
    match scene.control:
        case ConstantControl() as control:
            torques = _stacked(control.torques, data.model.arms)
            zero = np.zeros_like(torques)
            return ControlProgram(_laws(harmonic), pack_harmonic(0.0, torques, zero, zero), none)
        case GravityCompensationControl():
            laws = [gravity_compensation] if needs_gravity_torque(scene) else []
            return ControlProgram(_laws(*laws), none, none)
        case JointPDControl() as control:
            return _joint_pd(scene, data, start, control, joint_path)
        case HarmonicControl() as control:
            return ControlProgram(_laws(harmonic), _harmonic(data, start, control), none)
        case ComputedTorqueControl() as control:
            return ControlProgram(_laws(computed_torque), *object_law(data, start, control))
        case ObjectImpedanceControl() as control:
            return ControlProgram(_laws(object_impedance), *object_law(data, start, control))
        case RecordedControl() as control:
            return _recorded(scene, data, start, control)
        case NoControl():
            return ControlProgram(NO_CONTROL, none, none)
    raise AssertionError(f"no control law for {scene.control!r}")


def _harmonic(data: Data, start: State, control: HarmonicControl) -> np.ndarray:
    arms = data.model.arms
    constant = _stacked(control.offset, arms)
    if control.hold:
        constant += holding_torque(data, start)
    return pack_harmonic(
        control.frequency,
        constant,
        _stacked(control.amplitude, arms),
        _stacked(control.phase, arms),
    )


def _recorded(scene: Scene, data: Data, start: State, control: RecordedControl) -> ControlProgram:
    arms = data.model.arms
    names = [f"{name}/{joint}" for name, arm in arms.items() for joint in arm.joint_names]
    table = read_table(control, names)
    zero, laws, gains = control.outside == "zero", [recorded_torque], np.zeros(0)
    values = table.stacked(names, np.zeros(len(names)))
    if control.quantity == "position":
        values = table.stacked(names, start.position[7:])
        gains = np.concatenate([_stacked(control.stiffness, arms), _stacked(control.damping, arms)])
        laws = [recorded_position]
        if needs_gravity_torque(scene):
            laws.append(gravity_compensation)
    shape = table.times, values, control.interpolation, zero
    return ControlProgram(
        _laws(*laws),
        np.concatenate([gains, pack_table(*shape)]),
        rough_times(*shape),
        span=ControlSpan(
            f"the table {control.file.name}",
            float(table.times[0]),
            float(table.times[-1]),
            control.where_no_rows_are,
        ),
    )


def _joint_pd(
    scene: Scene,
    data: Data,
    start: State,
    control: JointPDControl,
    joint_path: Callable[..., JointPath],
) -> ControlProgram:
    arms = data.model.arms
    gains = np.concatenate([_stacked(control.stiffness, arms), _stacked(control.damping, arms)])
    path = JointPath(np.array([0.0, 1.0]), start.position[None, 7:, None])
    if control.path is not None:
        path = joint_path(control.path)
    laws = [joint_pd]
    if needs_gravity_torque(scene):
        laws.append(gravity_compensation)
    parameters = np.concatenate([gains, pack_path(path.bounds, path.coefficients)])
    return ControlProgram(_laws(*laws), parameters, path.bounds if control.path else np.zeros(0))


def holding_torque(data: Data, start: State) -> np.ndarray:
    """Constant joint torques that hold the system at rest at its start, shape (n,)."""
    gravity, b = data.model.constants.gravity, data.arrays
    if not np.any(gravity):
        return np.zeros(data.model.layout.joints)
    state = start.copy()
    state.velocity[:] = 0.0
    data.set_state(0.0, state)
    if update_kinematics(data.struct) != OK:
        data.reraise()
    b.gravity_torque[:] = np.concatenate(
        [
            data.model.arms[arm].gravity_torque(angles, gravity)
            for arm, angles in state.joint_positions.items()
        ]
    )
    write_holding_torque(data.struct)
    return b.torque.copy()


def _stacked(values, arms: dict[str, Arm]) -> np.ndarray:
    """One number per joint of all arms from a scene's gain, table or list."""
    return np.concatenate(
        [gain_vector(values, name, arm.joint_names) for name, arm in arms.items()]
    )


def _laws(*laws: Kernel) -> np.ndarray:
    """Addresses of control laws, whose numbers begin at 0."""
    return np.array([(address_of(law), 0) for law in laws], dtype=np.int64).reshape(-1, 2)


def pack_harmonic(
    frequency: float, constant: np.ndarray, amplitude: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Parameters of :func:`add_harmonic`."""
    columns = [constant, amplitude * np.cos(phase), amplitude * np.sin(phase)]
    return np.concatenate([[frequency], np.column_stack(columns).ravel()])


def pack_path(bounds: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Parameters of :func:`path_point` from ``bounds`` (S + 1,), ``coefficients`` (S, n, width)."""
    return np.concatenate(
        [[coefficients.shape[0], coefficients.shape[2]], bounds, coefficients.ravel()]
    )


# --- kernels -------------------------------------------------------------------------------------


@cfunc
def harmonic(address, size, place, t):
    """Numbers: frequency [Hz], then for every joint ``tau_0, A cos psi, A sin psi``."""
    model, data, _ = open_system(struct_at(address, size))
    parameters, at = model.parameters, int(place)
    angle = 2.0 * math.pi * parameters[at] * t
    sine, cosine = math.sin(angle), math.cos(angle)
    for j in range(data.torque.size):
        k = at + 1 + 3 * j
        data.torque[j] += parameters[k] + parameters[k + 1] * sine + parameters[k + 2] * cosine
    return 0


@cfunc
def joint_pd(address, size, place, t):
    """Numbers: stiffness and damping of every joint, then the path."""
    model, data, _ = open_system(struct_at(address, size))
    parameters, at, n = model.parameters, int(place), data.torque.size
    for j in range(n):
        reference, rate = path_point(t, parameters, at + 2 * n, n, j)
        data.torque[j] += parameters[at + j] * (reference - data.angles[j])
        data.torque[j] += parameters[at + n + j] * (rate - data.v[j])
    return 0


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


@cfunc
def gravity_compensation(address, size, _place, _t):
    """See :func:`add_gravity_compensation`."""
    model, data, work = open_system(struct_at(address, size))
    add_gravity_compensation(model, data, work, data.torque)
    return 0


@kernel
def add_gravity_compensation(model, data, work, torque):
    """Add the torques that hold arms and object at rest, see the module's text."""
    weight = data.weight
    for k in range(3):
        weight[k] = -model.object_mass * model.gravity[k]
        weight[3 + k] = 0.0
    static_forces(data.Wo, weight, data.static_force)
    for j in range(torque.size):
        torque[j] += data.gravity_torque[j]
    take_contact_forces(data, work, torque)


@kernel
def write_holding_torque(struct: INTS):
    """Write the torques that hold the configuration in ``data`` into ``data.torque``.

    Needs its kinematics and ``gravity_torque`` in ``data``.
    """
    model, data, work = open_system(struct)
    clear(data.torque)
    add_gravity_compensation(model, data, work, data.torque)
