"""The scene's control, turned into the program that the kernels run."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.control.object_laws import object_law
from multiarm.control.torques import (
    computed_torque,
    gravity_compensation,
    harmonic,
    joint_pd,
    object_impedance,
    pack_harmonic,
    pack_path,
    write_holding_torque,
)
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.user_callback import NO_CONTROL
from multiarm.jit.kernels import Kernel
from multiarm.jit.pointers import address_of
from multiarm.scene import Scene, gain_vector
from multiarm.scene.control import (
    ComputedTorqueControl,
    ConstantControl,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    NoControl,
    ObjectImpedanceControl,
)


class JointPath(NamedTuple):
    """Joint positions along a path.

    bounds : (S + 1,)
        Times of the waypoints [s].
    coefficients : (S, n, width)
        Chebyshev series of every segment and joint [rad, m].
    """

    bounds: np.ndarray
    coefficients: np.ndarray


class ControlProgram(NamedTuple):
    """The control laws of a scene.

    laws : int64 (k, 2), parameters : float64
        See :class:`multiarm.dynamics.arrays.Constants`.
    breakpoints : float64
        Times at which the torques are not smooth [s].
    """

    laws: np.ndarray
    parameters: np.ndarray
    breakpoints: np.ndarray


def needs_gravity_torque(scene: Scene) -> bool:
    """Whether some part of the control needs the arms' gravity forces at every evaluation."""
    control = scene.control
    if scene.gravity is None:
        return False
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
        When the contacts cannot do what the control wants of them.
    """
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
        case NoControl():
            return ControlProgram(NO_CONTROL, none, none)
    raise AssertionError(f"no control law for {scene.control!r}")


def _harmonic(data: Data, start: State, control: HarmonicControl) -> np.ndarray:
    arms = data.model.arms
    hold = holding_torque(data, start) if control.hold else np.zeros(data.model.layout.joints)
    return pack_harmonic(
        control.frequency, hold, _stacked(control.amplitude, arms), _stacked(control.phase, arms)
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
    """Constant joint torques that hold the whole system still at its start, shape (n,)."""
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
