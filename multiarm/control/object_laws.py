r"""Control laws of the object as the scene names them, turned into numbers for the kernels.

A squeeze is made of what the joints can do.  Where all contacts are fingertips, which can only
push, it is a combination of pushing forces alone (thesis, 3.7.3); its mean is what the user asks
for.  Idealised joints hold both ways; there every arm presses towards the middle of all grips.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from multiarm.contacts.internal_forces import internal_forces
from multiarm.control.object_control import pack_object_path
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.model import Data, Model
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.errors import ControlError, GraspError
from multiarm.scene import Pose
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl, Waypoint
from multiarm.spatial import difference, matrix_to_quaternion, skew

ObjectControl = ComputedTorqueControl | ObjectImpedanceControl

# Part of a squeeze that may be lost where a grip is not quite square to the line of the grips.
_SLIPS = 0.01
# A set of wanted forces that loses more than this part of its norm is not internal at all.
_LOST = 1.0 - 1e-6


def pose_of(state: State) -> Pose:
    """Pose of the object in a state."""
    return Pose(
        xyz=state.object_position.tolist(), quaternion_xyzw=state.object_quaternion_xyzw.tolist()
    )


def route(start: State, path: Sequence[Waypoint]) -> tuple[list[float], list[np.ndarray]]:
    """Times and poses (4, 4) of a path; one that does not begin at time 0 begins at the start."""
    times = [waypoint.time for waypoint in path]
    poses = [waypoint.matrix() for waypoint in path]
    if times[0] > 0.0:
        times.insert(0, 0.0)
        poses.insert(0, pose_of(start).matrix())
    return times, poses


def packed_path(times: Sequence[float], poses: Sequence[np.ndarray]) -> np.ndarray:
    """Numbers of ``object_control.write_reference`` for poses (4, 4) at times [s]."""
    quaternions = [matrix_to_quaternion(np.ascontiguousarray(pose[:3, :3])) for pose in poses]
    turns = [difference(a, b) for a, b in pairwise(quaternions)]
    positions = np.array([pose[:3, 3] for pose in poses])
    return pack_object_path(np.array(times), positions, np.array(quaternions), np.array(turns))


def object_law(data: Data, start: State, control: ObjectControl) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of a law of :mod:`multiarm.control.object_control`, and the times of its waypoints.

    Raises
    ------
    ControlError
        When the contacts cannot put every wrench on the object, or hold no internal force as the
        scene wants it.
    """
    data.set_state(0.0, start)
    if update_kinematics(data.struct) != OK:
        data.reraise()
    Wo = data.arrays.Wo.copy()
    _require_hold(Wo, control.kind)
    gains = [*control.stiffness.vector(), *control.damping.vector()]
    gains += [control.relative_damping, control.relative_stiffness]
    offsets, pressing = _wanted_forces(data, control, Wo)
    squeezes = bool(np.any(offsets) or np.any(pressing))
    inner = [offsets, pressing.ravel()] if squeezes else []
    at_rest = Waypoint(time=1.0, **pose_of(start).model_dump())
    times, poses = route(start, control.path or (at_rest,))
    path = packed_path(times, poses)
    numbers = np.concatenate([gains, [float(squeezes)], *inner, path])
    return numbers, np.array(times) if control.path else np.zeros(0)


def _require_hold(Wo: np.ndarray, kind: str) -> None:
    lever = max(float(np.max(np.linalg.norm(Wo[:, 3:], axis=1))), 1e-12)
    rank = null_space(Wo / np.array([1.0, 1.0, 1.0, lever, lever, lever])).rank
    if rank < 6:
        raise ControlError(
            f"control: {kind} needs contacts that can put every force and moment on the object, "
            f"but all {len(Wo)} together span only {rank} of 6 directions: the object can turn or "
            f"slide in them freely; add an arm, or join one with fewer free motions"
        )


def _wanted_forces(
    data: Data, control: ObjectControl, Wo: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Wanted forces of all contacts (N,), and a wrench of every arm (n, 6) in object axes."""
    model, offsets = data.model, np.zeros(len(Wo))
    pressing = np.zeros((len(model.arm_names), 6))
    own = model.layout.split_contacts(offsets)
    for arm, forces in (control.internal_forces or {}).items():
        if len(forces) != own[arm].size:
            names = ", ".join(contact.name for contact in model.contacts[arm])
            raise ControlError(
                f"control.internal_forces.{arm}: {len(forces)} forces for {own[arm].size} "
                f"contacts; give one each: {names}"
            )
        own[arm][:] = forces
    lost = np.linalg.norm(np.linalg.pinv(Wo.T) @ (Wo.T @ offsets))
    if np.any(offsets) and lost > _LOST * np.linalg.norm(offsets):
        raise ControlError(
            "control.internal_forces: these forces only move the object, nothing of them is "
            "internal; name contacts that press against each other, or use `squeeze`"
        )
    if control.squeeze:
        contacts = [(arm, contact) for arm, own in model.contacts.items() for contact in own]
        if all(contact.pushes_only for _, contact in contacts):
            labels = [f"{arm}: {contact.name}" for arm, contact in contacts]
            offsets += control.squeeze * _pushing(Wo, labels)
        else:
            pressing += control.squeeze * _towards_the_middle(model)
            _require_pressing(data, Wo, pressing)
    return offsets, pressing


def _require_pressing(data: Data, Wo: np.ndarray, pressing: np.ndarray) -> None:
    """Refuse a squeeze that slips away along a joint's free motion."""
    model, R = data.model, data.arrays.body[:9].reshape(3, 3)
    rows = model.layout.rows
    for i, arm in enumerate(model.arm_names):
        own = Wo[rows[i] : rows[i + 1]]
        wanted = np.concatenate([R @ pressing[i, :3], R @ pressing[i, 3:]])
        found = own.T @ np.linalg.lstsq(own.T, wanted, rcond=None)[0]
        if np.linalg.norm((found - wanted)[:3]) > _SLIPS * np.linalg.norm(wanted[:3]):
            raise ControlError(
                f"control.squeeze: the joint of arm '{arm}' cannot press towards the middle of all "
                f"grips, it gives way there; use `internal_forces` or a joint that holds"
            )


def _pushing(Wo: np.ndarray, names: list[str]) -> np.ndarray:
    """Internal forces of fingertips (N,): all push, as evenly as they can, 1 N in the mean."""
    try:
        forces = internal_forces(Wo.T, form="nonnegative", names=names).basis[:, 0]
    except GraspError as error:
        raise ControlError(f"control.squeeze: {error}") from None
    return forces / np.mean(forces)


def _towards_the_middle(model: Model) -> np.ndarray:
    """Wrenches (n, 6) of the arms on the object, object axes, that are in balance.

    Each is a force of 1 N (in the mean over the arms) at the origin of the arm's joint frame,
    towards the middle of all of them as nearly as the balance of forces and moments allows.
    """
    grips = np.array([frame.on_object[:3, 3] for frame in model.frames.values()])
    inward = np.mean(grips, axis=0) - grips
    distance = np.linalg.norm(inward, axis=1)
    if not np.all(distance > 1e-9):
        raise ControlError(
            "control.squeeze: the arms do not hold the object from different sides, so that they "
            "cannot press against each other; leave `squeeze` out or join them elsewhere"
        )
    inward /= distance[:, None]
    balance = np.zeros((6, 3 * len(grips)))
    for k, grip in enumerate(grips):
        balance[:3, 3 * k : 3 * k + 3] = np.eye(3)
        balance[3:, 3 * k : 3 * k + 3] = skew(grip)
    wish = inward.ravel()
    forces = (wish - np.linalg.pinv(balance) @ (balance @ wish)).reshape(-1, 3)
    mean = np.mean(np.sum(forces * inward, axis=1))
    if not mean > 1e-6:
        raise ControlError(
            "control.squeeze: forces towards the middle of all grips cannot be in balance; use "
            "`internal_forces`"
        )
    forces /= mean
    return np.hstack([forces, np.cross(grips, forces)])
