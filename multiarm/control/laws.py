"""The scene's control, turned into the program that the kernels run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from multiarm.assembly import follow_object
from multiarm.control.object_laws import object_law, pose_of, route
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
from multiarm.dynamics.arrays import Buffers
from multiarm.dynamics.equations import OK, update_kinematics
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.user_callback import Asked
from multiarm.errors import ControlError
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
    Waypoint,
)

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm
    from multiarm.assembly.system import System

ControlFunction = Callable[[float, State], Mapping[str, np.ndarray]]

NO_PROGRAM = np.zeros((0, 2), dtype=np.int64)

# Joint paths are interpolated in so many Chebyshev intervals a segment, doubled until the series
# has converged to PATH_TOLERANCE [rad, m].
PATH_INTERVALS = (16, 32, 64, 128)
PATH_TOLERANCE = 1e-8


class Program(NamedTuple):
    """Laws (address, offset), the numbers they refer to, and times where smoothness ends."""

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


def control_program(system: System) -> Program:
    """Program of the scene's control; its parameters follow those that the plant has already."""
    match system.scene.control:
        case ConstantControl() as control:
            program = _constant(system, control)
        case GravityCompensationControl():
            program = _gravity_compensation(system)
        case JointPDControl() as control:
            program = _joint_pd(system, control)
        case HarmonicControl() as control:
            program = _harmonic(system, control)
        case ComputedTorqueControl() as control:
            program = Program(_laws(computed_torque), *object_law(system, control))
        case ObjectImpedanceControl() as control:
            program = Program(_laws(object_impedance), *object_law(system, control))
        case NoControl():
            program = Program(NO_PROGRAM, np.zeros(0), np.zeros(0))
    laws = program.laws.copy()
    laws[:, 1] += system.plant.parameters.size
    return program._replace(laws=laws)


def control_call(function: ControlFunction, layout: Layout, buffers: Buffers) -> Asked:
    """Callback that writes the torques of a Python controller."""

    def read(torques: object) -> np.ndarray:
        return _read_torques(torques, layout, float(buffers.time[0]))

    return Asked(function, "the controller", read, buffers.torque, layout, buffers)


def _read_torques(torques: object, layout: Layout, t: float) -> np.ndarray:
    """Torques of all joints (n,) from those by arm; arms that are left out get none."""
    if not isinstance(torques, Mapping):
        raise ControlError(
            f"the controller returned {type(torques).__name__}; return a dict arm -> torques"
        )
    stacked = np.zeros(layout.joints)
    views = layout.split_joints(stacked)
    for arm, values in torques.items():
        if arm not in views:
            raise ControlError(
                f"the controller returned torques for an unknown arm {arm!r}; "
                f"arms are {', '.join(views)}"
            )
        try:
            vector = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise ControlError(
                f"the controller's torques for arm {arm!r} are not numbers: {values!r}"
            ) from None
        if vector.shape != views[arm].shape:
            raise ControlError(
                f"the controller returned shape {vector.shape} for arm {arm!r}, "
                f"expected {views[arm].shape}: one torque a joint"
            )
        if not np.all(np.isfinite(vector)):
            raise ControlError(
                f"the controller returned a torque that is not finite for arm {arm!r} at "
                f"t = {t:.6g} s: {vector.tolist()}"
            )
        views[arm][:] = vector
    return stacked


def _constant(system: System, control: ConstantControl) -> Program:
    torques = _stacked(control.torques, system.arms)
    zero = np.zeros_like(torques)
    return Program(_laws(harmonic), pack_harmonic(0.0, torques, zero, zero), np.zeros(0))


def _gravity_compensation(system: System) -> Program:
    laws = [gravity_compensation] if needs_gravity_torque(system.scene) else []
    return Program(_laws(*laws), np.zeros(0), np.zeros(0))


def _harmonic(system: System, control: HarmonicControl) -> Program:
    arms = system.arms
    hold = holding_torque(system) if control.hold else np.zeros(system.layout.joints)
    parameters = pack_harmonic(
        control.frequency, hold, _stacked(control.amplitude, arms), _stacked(control.phase, arms)
    )
    return Program(_laws(harmonic), parameters, np.zeros(0))


def _joint_pd(system: System, control: JointPDControl) -> Program:
    arms = system.arms
    gains = np.concatenate([_stacked(control.stiffness, arms), _stacked(control.damping, arms)])
    bounds, coefficients = _reference(system, control.path)
    laws = [joint_pd]
    if needs_gravity_torque(system.scene):
        laws.append(gravity_compensation)
    parameters = np.concatenate([gains, pack_path(bounds, coefficients)])
    return Program(_laws(*laws), parameters, bounds if control.path else np.zeros(0))


def _reference(system: System, path: tuple[Waypoint, ...] | None) -> tuple[np.ndarray, np.ndarray]:
    """Segment bounds and Chebyshev coefficients of the joints' reference."""
    start = system.initial_state()
    if path is None:
        return np.array([0.0, 1.0]), start.position[None, 7:, None]
    times, poses = route(start, path)
    carrier = _rigidly_held(system)
    segments, state = [], carrier.initial_state()
    for k in range(len(times) - 1):
        series, state = _segment(carrier, state, poses[k], poses[k + 1], k + 1)
        segments.append(series)
    width = max(series.shape[1] for series in segments)
    padded = [np.pad(series, ((0, 0), (0, width - series.shape[1]))) for series in segments]
    return np.array(times), np.array(padded)


def _rigidly_held(system: System) -> System:
    """The system with every tip fixed to the object where it is at the start.

    Its motion is one that the joints allow, and it leaves nothing to chance: free motions of a
    joint stay at rest.  Arms with fewer than six joints cannot hold rigidly; they keep their own
    joints.
    """
    from multiarm.assembly.compilation import compile_system

    scene, start = system.scene, system.initial_state()
    if all(joint.kind == "weld" for joint in scene.joints):
        return system
    joints = []
    for joint in scene.joints:
        rigid = system.arms[joint.arm].dof >= 6
        joints.append({"arm": joint.arm, "kind": "weld"} if rigid else joint)
    arms = {
        name: spec.model_copy(update={"posture": tuple(start.joint_positions[name])})
        for name, spec in scene.arms.items()
    }
    body = scene.object.model_copy(update={"pose": pose_of(start), "twist": None})
    parts = {"joints": joints, "arms": arms, "object": body}
    return compile_system(scene.replace(**parts, control={"kind": "none"}, effects={}))


def _segment(
    system: System, start: State, begin: np.ndarray, end: np.ndarray, number: int
) -> tuple[np.ndarray, State]:
    """Chebyshev series (n, width) of the joints from one waypoint to the next, and the end state.

    The object follows the quintic law of time that begins and ends at rest.  The nodes include both
    ends, so that segments join without a jump.
    """
    for intervals in PATH_INTERVALS:
        x = -np.cos(np.pi * np.arange(intervals + 1) / intervals)
        s = 0.5 * (1.0 + x)
        law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        angles, state = follow_object(system, start, begin, end, law, number)
        series = np.polynomial.chebyshev.chebfit(x, angles, intervals).T
        if np.max(np.abs(series[:, -4:])) < PATH_TOLERANCE:
            return series, state
    worst = int(np.argmax(np.max(np.abs(series[:, -4:]), axis=1)))
    joint = [f"{arm}/{joint}" for arm, a in system.arms.items() for joint in a.joint_names][worst]
    raise ControlError(
        f"control.path: on the way to waypoint {number} the joints do not move smoothly "
        f"(worst: {joint}); an arm passes a singular posture there, choose another path or posture"
    )


def holding_torque(system: System) -> np.ndarray:
    """Constant joint torques that hold the whole system still at its start, shape (n,)."""
    plant, buffers = system.plant, system.buffers
    if not np.any(plant.gravity):
        return np.zeros(system.layout.joints)
    state = system.initial_state()
    state.velocity[:] = 0.0
    system.set_state(0.0, state)
    if update_kinematics(system.struct()) != OK:
        system.reraise()
    at = 0
    for arm, angles in state.joint_positions.items():
        torque = system.arms[arm].gravity_torque(angles, plant.gravity)
        buffers.gravity_torque[at : at + torque.size] = torque
        at += torque.size
    write_holding_torque(system.struct())
    return buffers.torque.copy()


def _stacked(values, arms: dict[str, Arm]) -> np.ndarray:
    """One number per joint of all arms from a scene's gain, table or list."""
    return np.concatenate(
        [gain_vector(values, name, arm.joint_names) for name, arm in arms.items()]
    )


def _laws(*laws: Kernel) -> np.ndarray:
    """Addresses of control laws, whose numbers begin at 0."""
    return np.array([(address_of(law), 0) for law in laws], dtype=np.int64).reshape(-1, 2)
