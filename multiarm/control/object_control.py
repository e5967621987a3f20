r"""Control laws that move the object: inverse dynamics along a path, and an impedance.

Both command a wrench ``w`` on the object, distribute it over the contacts
(:mod:`multiarm.dynamics.forces.compiled`), and map the contact forces :math:`\lambda` to joint
torques.

* *Computed torque* commands the object's acceleration
  :math:`\dot v_o = a_r + D(v_r - v_o) + K e`, where ``e`` is the displacement and the rotation
  vector to the reference.  The wrench is :math:`w = I_o\dot v_o + h_o`, and

  .. math:: \tau_i = M_i\ddot q_i + b_i - W_i\lambda_i, \qquad
            W_i^T\ddot q_i = c_i - W_{oi}^T\dot v_o

  (thesis, 3.10 in joint space).  Of all joint accelerations that the object's motion allows, the
  law takes the nearest to :math:`-\delta\dot q_i` in the metric of :math:`M_i`, which damps free
  motions (a hinge that turns, an elbow that floats) at the rate :math:`\delta`.

* *Object impedance* holds the object by a spring and a damper, without changing the inertia of
  object and arms: :math:`w = K e + D(v_r - v_o) - m g`,
  :math:`\tau_i = g_i - W_i\lambda_i - \delta M_i P_i\dot q_i` with :math:`P_i` the projection on
  the arm's free motions.  The spring has the energy :math:`\tfrac12 e^T K e` also for large
  rotations and with a different stiffness about each axis, so that the law is passive while its
  reference rests: the rotation vector ``theta`` to the reference has the rate
  :math:`-J_r^{-1}(\theta)\,\omega`, hence the moment :math:`J_r^{-T}(\theta) K\theta`.

With a stiffness of the free motions the arms hold their poses on the object instead
(:mod:`multiarm.control.null_space`).

A squeeze consists of internal forces.  Where all contacts are fingertips, which can only push, it
is a combination of pushing forces (thesis, 3.7.3) with the given mean.  Bilateral joints hold both
ways; there every arm presses towards the middle of all grips.

Numbers of a law, from ``at``: stiffness (6), damping (6), rate and stiffness of the free motions,
whether there are internal forces; if so, desired forces of all contacts and a desired wrench of
every arm on the object; then the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from multiarm.contacts.kernel import GAP_BIAS
from multiarm.control.null_space import hold_pose, nearest_accelerations
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import share_load, static_forces
from multiarm.dynamics.forces.internal_forces import decompose, internal_forces
from multiarm.dynamics.model import Data, Model
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.errors import ControlError, GraspError
from multiarm.geometry.screws import skew
from multiarm.jit.kernels import allocating, cfunc, kernel
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import add_scaled, scale, sub, vec
from multiarm.notation import count_of
from multiarm.scene import Pose
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl, Waypoint
from multiarm.spatial import (
    difference,
    matrix_to_quaternion,
    retracted,
    rotation_between,
    write_chart_rate,
)

ObjectControl = ComputedTorqueControl | ObjectImpedanceControl

# Offsets of the numbers of a law.
STIFFNESS, DAMPING, FREE_RATE, FREE_STIFFNESS, SQUEEZES, LAW_WIDTH = 0, 6, 12, 13, 14, 15
# Width of a segment of a path, see :func:`packed_path`.
SEGMENT_WIDTH = 13


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


def object_law(data: Data, start: State, control: ObjectControl) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of a law, and the times of its waypoints.

    Raises
    ------
    ControlError
        When the contacts cannot put every wrench on the object, or cannot have the internal forces
        of the scene.
    """
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    Wo = data.arrays.Wo.copy()
    _require_hold(Wo, control.kind)
    gains = [*control.stiffness.vector(), *control.damping.vector()]
    gains += [control.relative_damping, control.relative_stiffness]
    offsets, pressing = _desired_forces(data, control, Wo)
    squeezes = bool(np.any(offsets) or np.any(pressing))
    inner = [offsets, pressing.ravel()] if squeezes else []
    at_rest = Waypoint(time=1.0, **pose_of(start).model_dump())
    times, poses = route(start, control.path or (at_rest,))
    path = packed_path(times, poses)
    numbers = np.concatenate([gains, [float(squeezes)], *inner, path])
    return numbers, np.array(times) if control.path else np.zeros(0)


def packed_path(times: Sequence[float], poses: Sequence[np.ndarray]) -> np.ndarray:
    """Parameters of :func:`reference_pose` for poses (4, 4) at times [s].

    Number of segments, times, and for each segment first position, displacement, first quaternion,
    and rotation vector to the next pose (world axes).
    """
    quaternions = np.array([matrix_to_quaternion(pose[:3, :3]) for pose in poses])
    turns = np.array([difference(a, b) for a, b in pairwise(quaternions)])
    positions = np.array([pose[:3, 3] for pose in poses])
    table = np.hstack([positions[:-1], np.diff(positions, axis=0), quaternions[:-1], turns])
    return np.concatenate([[len(turns)], times, table.ravel()])


def _require_hold(Wo: np.ndarray, kind: str) -> None:
    lever = max(float(np.max(np.linalg.norm(Wo[:, 3:], axis=1))), 1e-12)
    rank = null_space(Wo / np.array([1.0, 1.0, 1.0, lever, lever, lever])).rank
    if rank < 6:
        raise ControlError(
            f"control: {kind} needs contacts that can put every force and moment on the object, "
            f"but all {len(Wo)} together span only {rank} of 6 directions: the object can turn or "
            f"slide in them freely; add an arm, or join one with fewer free motions"
        )


def _desired_forces(
    data: Data, control: ObjectControl, Wo: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Desired forces of all contacts (N,), and a wrench of every arm (n, 6) in object axes."""
    model, offsets = data.model, np.zeros(len(Wo))
    pressing = np.zeros((len(model.arm_names), 6))
    by_arm = model.layout.split_contacts(offsets)
    for arm, forces in (control.internal_forces or {}).items():
        if len(forces) != by_arm[arm].size:
            names = ", ".join(contact.name for contact in model.contacts[arm])
            raise ControlError(
                f"control.internal_forces.{arm}: {count_of(len(forces), 'force')} for "
                f"{count_of(by_arm[arm].size, 'contact')}; give one each: {names}"
            )
        by_arm[arm][:] = forces
    lost = np.linalg.norm(decompose(Wo.T, offsets).moving)
    if np.any(offsets) and lost > (1.0 - 1e-6) * np.linalg.norm(offsets):
        raise ControlError(
            "control.internal_forces: these forces only move the object, nothing of them is "
            "internal; name contacts that press against each other, or use `squeeze`"
        )
    if control.squeeze:
        contacts = [(arm, contact) for arm, of_arm in model.contacts.items() for contact in of_arm]
        if all(contact.pushes_only for _, contact in contacts):
            labels = [f"{arm}: {contact.name}" for arm, contact in contacts]
            offsets += control.squeeze * _pushing(Wo, labels)
        else:
            pressing += control.squeeze * _towards_the_middle(model)
            _require_pressing(data, Wo, pressing)
    return offsets, pressing


def _require_pressing(data: Data, Wo: np.ndarray, pressing: np.ndarray) -> None:
    """Raise an error for a squeeze along a joint's free motion (more than 1 % of the force)."""
    model, R = data.model, data.arrays.body[:9].reshape(3, 3)
    rows = model.layout.rows
    for i, arm in enumerate(model.arm_names):
        of_arm = Wo[rows[i] : rows[i + 1]]
        desired = np.concatenate([R @ pressing[i, :3], R @ pressing[i, 3:]])
        reached = of_arm.T @ np.linalg.lstsq(of_arm.T, desired, rcond=None)[0]
        if np.linalg.norm((reached - desired)[:3]) > 0.01 * np.linalg.norm(desired[:3]):
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


# --- kernels -------------------------------------------------------------------------------------


@cfunc
def computed_torque(address, size, place, t):
    """Add the torques of computed torque; ``place`` is that of its numbers.

    Until the equations of motion are solved ``data.q_o, qdd, c`` hold the commanded values.
    """
    model, data, work = open_system(struct_at(address, size))
    parameters, at, torque = model.parameters, int(place), data.torque
    desired, wrench = data.q_o, data.weight
    path = path_offset(parameters, at, work)
    write_object_acceleration(t, parameters, at, path, data.position, data.twist, desired)
    for a in range(6):
        wrench[a] = -data.h_o[a]
        for b in range(6):
            wrench[a] += data.inertia[a, b] * desired[b]
    write_contact_forces(parameters, at, data, work)
    # the law carries the bias and what the joints do by themselves, which is all of h so far
    for j in range(torque.size):
        torque[j] -= data.h[j]
    for k in range(data.c.size):
        data.c[k] = -data.contacts[k, GAP_BIAS]
        for a in range(6):
            data.c[k] -= data.Wo[k, a] * desired[a]
    add_motion_forces(parameters, at, True, model, data, work, torque)
    take_contact_forces(data, work, torque)
    return 0


@cfunc
def object_impedance(address, size, place, t):
    """Add the torques of the object impedance; ``place`` is that of its numbers."""
    model, data, work = open_system(struct_at(address, size))
    parameters, at, torque = model.parameters, int(place), data.torque
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
    return 0


@kernel
def reference_pose(t, parameters, at):
    """Reference of the object at ``t``: position (3,), quaternion (4,), and the way it moves.

    From one waypoint to the next it moves along a line and about a fixed axis, from rest to rest,
    by the quintic law of time; before the first and after the last it rests.  The way: place of the
    segment's displacement and rotation vector among the parameters, rate [1/s] and second
    derivative [1/s^2] of the part of them that has been covered.
    """
    segments = int(parameters[at])
    bounds = at + 1
    s = 0
    while s < segments - 1 and t >= parameters[bounds + s + 1]:
        s += 1
    begin, length = parameters[bounds + s], parameters[bounds + s + 1] - parameters[bounds + s]
    x = min(max((t - begin) / length, 0.0), 1.0)
    part = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    rate = 30.0 * (x * (1.0 - x)) ** 2 / length
    second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / length**2
    first = bounds + segments + 1 + SEGMENT_WIDTH * s
    shift, turn = vec(parameters, first + 3), vec(parameters, first + 10)
    position = add_scaled(vec(parameters, first), part, shift)
    quaternion = retracted(parameters[first + 6 : first + 10], scale(part, turn))
    return position, quaternion, shift, turn, rate, second


def reference_motion(t: float, parameters: np.ndarray, at: int) -> tuple[np.ndarray, ...]:
    """Reference of the object at ``t``: quaternion xyzw (4,), twist (6,), acceleration (6,)."""
    _, quaternion, shift, turn, rate, second = reference_pose(t, parameters, at)
    way = np.array([*shift, *turn])
    return np.array(quaternion), rate * way, second * way


@kernel
def write_object_acceleration(t, parameters, at, path, position, velocity, desired):
    """Write the object's acceleration that computed torque commands into ``desired`` (6,)."""
    place, quaternion, shift, turn, rate, second = reference_pose(t, parameters, path)
    ahead, turned = sub(place, vec(position, 0)), rotation_between(position[3:7], quaternion)
    for k in range(3):
        stiffness, damping = parameters[at + STIFFNESS + k], parameters[at + DAMPING + k]
        slower = rate * shift[k] - velocity[k]
        desired[k] = second * shift[k] + damping * slower + stiffness * ahead[k]
    for k in range(3):
        stiffness, damping = parameters[at + STIFFNESS + 3 + k], parameters[at + DAMPING + 3 + k]
        slower = rate * turn[k] - velocity[3 + k]
        desired[3 + k] = second * turn[k] + damping * slower + stiffness * turned[k]


@kernel
def write_spring_wrench(t, parameters, at, path, position, velocity, wrench):
    """Write the wrench of the impedance's spring and damper on the object into ``wrench`` (6,)."""
    place, quaternion, shift, turn, rate, _ = reference_pose(t, parameters, path)
    ahead, turned = sub(place, vec(position, 0)), rotation_between(position[3:7], quaternion)
    pull = (
        parameters[at + STIFFNESS + 3] * turned[0],
        parameters[at + STIFFNESS + 4] * turned[1],
        parameters[at + STIFFNESS + 5] * turned[2],
    )
    write_chart_rate(turned, pull, wrench[3:6])
    for k in range(3):
        slower, spin = rate * shift[k] - velocity[k], rate * turn[k] - velocity[3 + k]
        wrench[k] = (
            parameters[at + STIFFNESS + k] * ahead[k] + parameters[at + DAMPING + k] * slower
        )
        wrench[3 + k] += parameters[at + DAMPING + 3 + k] * spin


@allocating
def add_arm_forces(inertia, W, preferred, target, torque):
    r"""Add :math:`M\ddot q` of the nearest joint accelerations that obey the joint to ``torque``.

    See :func:`multiarm.control.null_space.nearest_accelerations` for the arguments.
    """
    n = preferred.size
    accelerations = np.empty(n)
    nearest_accelerations(inertia, W, preferred, target, accelerations)
    for j in range(n):
        for k in range(n):
            torque[j] += (inertia[j, k] if k <= j else inertia[k, j]) * accelerations[k]


@kernel
def path_offset(parameters, at, work):
    """Offset of a law's path among its numbers."""
    if parameters[at + SQUEEZES] == 0.0:
        return at + LAW_WIDTH
    arms = work.rows.size - 1
    return at + LAW_WIDTH + work.rows[arms] + 6 * arms


@kernel
def write_contact_forces(parameters, at, data, work):
    """Distribute ``data.weight`` over the contacts; writes ``data.static_force``."""
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
    """Add ``M q''`` of all arms: targets in ``data.c``, free motions are damped or held.

    ``along`` as in :func:`multiarm.control.null_space.hold_pose`.
    """
    rate, stiffness = parameters[at + FREE_RATE], parameters[at + FREE_STIFFNESS]
    for j in range(data.v.size):
        data.qdd[j] = -rate * data.v[j]
    for i in range(work.rows.size - 1):
        d0, d1 = work.dofs[i], work.dofs[i + 1]
        r0, r1 = work.rows[i], work.rows[i + 1]
        if stiffness > 0.0:
            hold_pose(i, stiffness, rate, along, model, data, work, data.qdd[d0:d1])
        add_arm_forces(work.M[i], work.W[i], data.qdd[d0:d1], data.c[r0:r1], torque[d0:d1])


@kernel
def take_contact_forces(data, work, torque):
    """Subtract ``W lambda`` of the contact forces in ``data.static_force`` from the torques."""
    force = data.static_force
    for i in range(work.rows.size - 1):
        d0, r0 = work.dofs[i], work.rows[i]
        for j in range(work.dofs[i + 1] - d0):
            for a in range(work.rows[i + 1] - r0):
                torque[d0 + j] -= work.W[i, j, a] * force[r0 + a]
