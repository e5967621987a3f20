r"""Control laws: from the control of a scene to compiled functions and their numbers.

Only the laws that a scene names are compiled; a scene without control has an empty program.  A kind
finds its laws by its class: :func:`program_of`.

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
from dataclasses import replace
from functools import singledispatch

import numpy as np

from multiarm.control.derivatives import differentiate_joint_pd, holding_derivatives
from multiarm.control.object_control import (
    computed_torque,
    object_impedance,
    object_law,
    take_contact_forces,
)
from multiarm.control.program import (
    ControlContext,
    ControlProgram,
    JointPath,
    needs_gravity_torque,
)
from multiarm.control.recorded import (
    pack_table,
    recorded_position,
    recorded_torque,
    rough_times,
)
from multiarm.control.tables import read_table
from multiarm.control.user_control import Control
from multiarm.dynamics.arrays import CARRYING, LOCAL, OPEN_LOOP, open_system
from multiarm.dynamics.callbacks import PythonControl
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import static_forces
from multiarm.dynamics.held_control import Sampling
from multiarm.dynamics.model import ControlSpan, Data
from multiarm.dynamics.state import State
from multiarm.errors import ModelError
from multiarm.jit.kernels import INTS, Kernel, cfunc, clear, kernel
from multiarm.jit.structs import struct_at
from multiarm.scene.control import (
    ComputedTorqueControl,
    ConstantControl,
    ControlKind,
    FunctionControl,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    ObjectImpedanceControl,
    RecordedControl,
    SampledControl,
)
from multiarm.scene.registry import called


def control_program(context: ControlContext) -> ControlProgram:
    """The control of a scene.

    Raises
    ------
    ControlError
        When the contacts cannot have the forces that the control commands.
    SceneError
        When a recorded table cannot be used.
    ModelError
        When a user class cannot be used.
    """
    control = context.scene.control
    program = program_of(control, context)
    if not isinstance(control, SampledControl) or control.sample_time is None:
        return program
    sampling = Sampling(control.sample_time, control.sample_delay)
    # held torques change at samples only
    return replace(program, sampling=sampling, breakpoints=np.zeros(0))


@singledispatch
def program_of(_control: ControlKind, _context: ControlContext) -> ControlProgram:
    """The laws of a kind of control, by its class; a class without an entry has none."""
    return ControlProgram()


@program_of.register
def _(control: Control, context: ControlContext) -> ControlProgram:
    who = f"control kind {control.kind!r}: build()"
    program = called(lambda: control.build(context), who)
    if not isinstance(program, ControlProgram):
        raise ModelError(
            f"{who} returned {type(program).__name__}; return a multiarm.control.ControlProgram"
        )
    numbers = np.asarray(program.parameters)
    if numbers.ndim != 1 or numbers.dtype != float or not np.all(np.isfinite(numbers)):
        raise ModelError(f"{who} returned parameters that are no vector of finite floats")
    if not all(isinstance(law, Kernel) for law in program.laws):
        raise ModelError(f"{who} returned a law that is no `multiarm.jit.kernels.cfunc`")
    return program


@program_of.register
def _(control: FunctionControl, _context: ControlContext) -> ControlProgram:
    return ControlProgram(python=PythonControl(control.function, in_scene=True))


@program_of.register
def _(control: ConstantControl, context: ControlContext) -> ControlProgram:
    torques = context.stacked(control.torques)
    zero = np.zeros_like(torques)
    return ControlProgram((harmonic,), pack_harmonic(0.0, torques, zero, zero), reach=OPEN_LOOP)


@program_of.register
def _(_control: GravityCompensationControl, context: ControlContext) -> ControlProgram:
    return ControlProgram(_carrying(context), reach=CARRYING, derivative=holding_derivatives)


@program_of.register
def _(control: HarmonicControl, context: ControlContext) -> ControlProgram:
    constant = context.stacked(control.offset)
    if control.hold:
        constant += holding_torque(context.data, context.start)
    amplitude, phase = context.stacked(control.amplitude), context.stacked(control.phase)
    numbers = pack_harmonic(control.frequency, constant, amplitude, phase)
    return ControlProgram((harmonic,), numbers, reach=OPEN_LOOP)


@program_of.register
def _(control: ComputedTorqueControl, context: ControlContext) -> ControlProgram:
    return ControlProgram((computed_torque,), *object_law(context.data, context.start, control))


@program_of.register
def _(control: ObjectImpedanceControl, context: ControlContext) -> ControlProgram:
    return ControlProgram((object_impedance,), *object_law(context.data, context.start, control))


@program_of.register
def _(control: RecordedControl, context: ControlContext) -> ControlProgram:
    names = [f"{name}/{joint}" for name, arm in context.arms.items() for joint in arm.joint_names]
    table = read_table(control, names)
    zero, gains = control.outside == "zero", np.zeros(0)
    laws: tuple[Kernel, ...] = (recorded_torque,)
    reach = OPEN_LOOP
    derivatives: tuple[Kernel | None, ...] = (None,)
    values = table.stacked(names, np.zeros(len(names)))
    if control.quantity == "position":
        values = table.stacked(names, start_angles(context))
        gains = _gains(control, context)
        carrying = _carrying(context)
        laws, reach = (recorded_position, *carrying), CARRYING if carrying else LOCAL
        derivatives = (differentiate_joint_pd, *[None] * len(carrying))
    shape = table.times, values, control.interpolation, zero
    span = ControlSpan(
        f"the table {control.file.name}",
        float(table.times[0]),
        float(table.times[-1]),
        control.where_no_rows_are,
    )
    numbers = np.concatenate([gains, pack_table(*shape)])
    rough = rough_times(*shape)
    return ControlProgram(
        laws,
        numbers,
        rough,
        span,
        reach=reach,
        derivative=holding_derivatives if reach == CARRYING else None,
        derivatives=derivatives,
    )


@program_of.register
def _(control: JointPDControl, context: ControlContext) -> ControlProgram:
    path = JointPath(np.array([0.0, 1.0]), start_angles(context)[None, :, None])
    if control.path is not None:
        path = context.joint_path(control.path)
    numbers = np.concatenate([_gains(control, context), pack_path(path.bounds, path.coefficients)])
    breakpoints = path.bounds if control.path else np.zeros(0)
    carrying = _carrying(context)
    return ControlProgram(
        (joint_pd, *carrying),
        numbers,
        breakpoints,
        reach=CARRYING if carrying else LOCAL,
        derivative=holding_derivatives if carrying else None,
        derivatives=(differentiate_joint_pd, *[None] * len(carrying)),
    )


def _gains(control: JointPDControl | RecordedControl, context: ControlContext) -> np.ndarray:
    """Stiffness and damping of every joint."""
    return np.concatenate([context.stacked(control.stiffness), context.stacked(control.damping)])


def _carrying(context: ControlContext) -> tuple[Kernel, ...]:
    """The law that carries the weight, where there is one and the control carries it."""
    return (gravity_compensation,) if needs_gravity_torque(context.scene) else ()


def start_angles(context: ControlContext) -> np.ndarray:
    """Joint positions at the start, shape (n,)."""
    return context.start.layout.joint_positions(context.start.position)


def holding_torque(data: Data, start: State) -> np.ndarray:
    """Constant joint torques that hold the system at rest at its start, shape (n,)."""
    gravity, b = data.model.constants.gravity, data.arrays
    if not np.any(gravity):
        return np.zeros(data.model.layout.joints)
    state = start.copy()
    state.velocity[:] = 0.0
    data.set_state(0.0, state)
    require_ok(data, update_kinematics(data.struct))
    b.gravity_torque[:] = np.concatenate(
        [
            data.model.arms[arm].gravity_torque(angles, gravity)
            for arm, angles in state.joint_positions.items()
        ]
    )
    write_holding_torque(data.struct)
    return b.torque.copy()


def pack_harmonic(
    frequency: float, constant: np.ndarray, amplitude: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Parameters of :func:`harmonic`."""
    columns = [constant, amplitude * np.cos(phase), amplitude * np.sin(phase)]
    return np.concatenate([[frequency], np.column_stack(columns).ravel()])


def unpack_harmonic(parameters: np.ndarray, n: int) -> tuple[float, np.ndarray]:
    """Frequency [Hz], and ``tau_0, A cos psi, A sin psi`` of every joint, shape (n, 3)."""
    return float(parameters[0]), parameters[1 : 1 + 3 * n].reshape(n, 3)


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
