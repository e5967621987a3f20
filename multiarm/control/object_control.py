r"""Control laws that move objects: inverse dynamics along a path, and an impedance.

Both command a wrench ``w`` on each object, distribute it over the contacts
(:mod:`multiarm.dynamics.forces.compiled`), and map the contact forces :math:`\lambda` to joint
torques.  The reference is a path of poses (:mod:`multiarm.control.object_path`).

* *Computed torque* commands the object's acceleration
  :math:`\dot v_o = a_r + D(v_r - v_o) + K e`, where ``e`` is the displacement and the rotation
  vector to the reference.  The wrench is :math:`w = I_o\dot v_o - f_o`, and

  .. math:: \tau_i = M_i\ddot q_i + b_i - W_i\lambda_i, \qquad
            W_i^T\ddot q_i = c_i - W_{oi}^T\dot v_o

  (thesis, 3.10 in joint space).  The rows are those of all connections of a robot, with the object,
  the world and between its links, and of its couplings; only the first have forces.  Of all joint
  accelerations that the object's motion and these rows allow, the law takes the nearest to
  :math:`-\delta\dot q_i` in the metric of :math:`M_i`, which damps free motions (a hinge that
  turns, an elbow that floats) at the rate :math:`\delta`.  Objects that are not commanded follow
  (:mod:`multiarm.control.followers`).

* *Object impedance* holds the object by a spring and a damper, without changing the inertia of
  object and robots: :math:`w = K e + D(v_r - v_o) - m g`, of other objects :math:`w = -m g`,
  :math:`\tau_i = g_i - W_i\lambda_i - \delta M_i P_i\dot q_i` with :math:`P_i` the projection on
  the robot's free motions.  The spring has the energy :math:`\tfrac12 e^T K e` also for large
  rotations and with a different stiffness about each axis, so that the law is passive while its
  reference rests: the rotation vector ``theta`` to the reference has the rate
  :math:`-J_r^{-1}(\theta)\,\omega`, hence the moment :math:`J_r^{-T}(\theta) K\theta`.

With a stiffness of the free motions the robots hold their poses on the object instead
(:mod:`multiarm.control.null_space`).

The internal forces of a squeeze come on top (:mod:`multiarm.control.squeeze`).  With passive joints
contact forces of least norm also satisfy :math:`(\tau_i)_p = 0`.  Where friction is counted
(:mod:`multiarm.control.grip`), contact forces are those in the middle of its cones, contacts that
only push stick as far as the law knows, and their slips die out at the rate :math:`\delta`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from multiarm.contacts.kernel import open_contact
from multiarm.control.command_derivatives import prepare_command_derivatives
from multiarm.control.followers import write_followers
from multiarm.control.gravity_compensation import add_weights, carry_undriven
from multiarm.control.grip import ANSWERS, Grip, grip_of
from multiarm.control.null_space import hold_poses, nearest_accelerations
from multiarm.control.object_derivatives import (
    differentiate_command,
    write_computed_torque_derivatives,
    write_object_impedance_derivatives,
)
from multiarm.control.object_law import ObjectCommand, ObjectLaw, open_command, open_object_law
from multiarm.control.object_path import (
    PosePath,
    PosePaths,
    path_of,
    pose_of,
    pose_path,
    reference_pose,
    route,
)
from multiarm.control.program import ControlContext, ControlProgram
from multiarm.control.squeeze import desired_forces
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import add_joint_forces
from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.control_laws import ControlLaw
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import distribute_wrench, static_forces
from multiarm.dynamics.forces.friction import distribute_within_friction
from multiarm.dynamics.momenta import times_block_inertia
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.status import OK
from multiarm.errors import ControlError
from multiarm.jit.kernels import Kernel, cfunc, clear, inlined, kernel
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import sub, vec
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl, Waypoint
from multiarm.spatial import rotation_between, write_chart_rate

ObjectControl = ComputedTorqueControl | ObjectImpedanceControl
# Paths of objects that would open a joint by less are rounded poses [m].
OPEN = 1e-3


@cfunc
def computed_torque(address, size, at, t):
    """Add the torques of computed torque."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    state, control, wrench = data.state, data.control, data.control.object_wrench
    desired, target = command.acceleration, command.target
    for p in range(law.objects.size):
        o = law.objects[p]
        write_object_acceleration(
            t, law, path_of(law, p), state.poses[o], state.twists[o], desired[6 * o : 6 * o + 6]
        )
    if law.objects.size < state.poses.shape[0]:
        write_followers(law, model, data, work, desired)
    for a in range(wrench.size):
        wrench[a] = -data.forces.f_o[a]
        for b in range(desired.size):
            wrench[a] += data.bodies.object_inertia[a, b] * desired[b]
    # the law carries the bias and what the joints do by themselves, which is all of f_j so far
    for j in range(control.torque.size):
        control.torque[j] -= data.forces.f_j[j]
    for k in range(target.size):
        target[k] = -open_contact(data.rows.kinematics[k]).gap_bias
        for a in range(desired.size):
            target[k] -= data.rows.W_o[k, a] * desired[a]
    stop_slips(law, command, data)
    add_motion_forces(law, command, True, model, data, work)
    status = write_contact_forces(law, model, data, work)
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, data.control.torque)
    return status


@cfunc
def object_impedance(address, size, at, t):
    """Add the torques of the object impedance."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    state, control, wrench = data.state, data.control, data.control.object_wrench
    clear(wrench)
    for p in range(law.objects.size):
        o = law.objects[p]
        write_spring_wrench(
            t, law, path_of(law, p), state.poses[o], state.twists[o], wrench[6 * o : 6 * o + 6]
        )
    add_weights(model, wrench)
    for j in range(control.torque.size):
        control.torque[j] += control.gravity_torque[j]
    clear(command.target)
    stop_slips(law, command, data)
    add_motion_forces(law, command, False, model, data, work)
    status = write_contact_forces(law, model, data, work)
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, data.control.torque)
    return status


@kernel
def write_object_acceleration(t, law, path, position, velocity, desired):
    """Write an object's acceleration that computed torque commands into ``desired`` (6,)."""
    place, quaternion, shift, turn, rate, second = reference_pose(t, path)
    ahead, turned = sub(place, vec(position, 0)), rotation_between(position[3:7], quaternion)
    for k in range(3):
        slower = rate * shift[k] - velocity[k]
        desired[k] = second * shift[k] + law.damping[k] * slower + law.stiffness[k] * ahead[k]
    for k in range(3):
        slower = rate * turn[k] - velocity[3 + k]
        spring = law.stiffness[3 + k] * turned[k]
        desired[3 + k] = second * turn[k] + law.damping[3 + k] * slower + spring


@kernel
def write_spring_wrench(t, law, path, position, velocity, wrench):
    """Write the wrench of the impedance's spring and damper on an object into ``wrench`` (6,)."""
    place, quaternion, shift, turn, rate, _ = reference_pose(t, path)
    ahead, turned = sub(place, vec(position, 0)), rotation_between(position[3:7], quaternion)
    pull = (
        law.stiffness[3] * turned[0],
        law.stiffness[4] * turned[1],
        law.stiffness[5] * turned[2],
    )
    write_chart_rate(turned, pull, wrench[3:6])
    for k in range(3):
        slower, spin = rate * shift[k] - velocity[k], rate * turn[k] - velocity[3 + k]
        wrench[k] = law.stiffness[k] * ahead[k] + law.damping[k] * slower
        wrench[3 + k] += law.damping[3 + k] * spin


@kernel
def write_contact_forces(law, model, data, work):
    """Distribute the wrenches on objects over the contacts; writes ``data.rows.static_force``.

    After all other torques, which contact forces take over from passive joints.  Returns ``OK``,
    or as :func:`multiarm.dynamics.forces.friction.distribute_within_friction`.
    """
    wrench, rows = data.control.object_wrench, data.rows
    if law.pushing.size > 0:
        return distribute_within_friction(
            wrench, rows.W_o, law.pushing, law.friction, law.least, law.forces_of_contacts,
            rows.static_force,
        )  # fmt: skip
    if model.undriven.size > 0:
        carry_undriven(model, data, work, data.control.torque)
    elif law.squeezes:
        distribute_wrench(
            wrench, rows.W_o, rows.first, data.bodies.objects, law.pressed,
            law.forces_of_contacts, law.wrenches_of_connections, rows.static_force,
        )  # fmt: skip
    else:
        static_forces(rows.W_o, wrench, rows.static_force)
    return OK


@inlined
def stop_slips(law, command, data):
    """Let the slips of contacts that are to stick die out as free motions do."""
    for i in range(law.pushing.size):
        if law.friction[i] > 0.0:
            for k in range(law.pushing[i] + 1, law.pushing[i] + 3):
                slip = open_contact(data.rows.kinematics[k]).gap_rate
                command.target[k] -= law.free_rate * slip


@kernel
def add_motion_forces(law, command, feedforward, model, data, work):
    """Add ``M q''`` of all robots with the targets of the command; free motions are damped or held.

    ``feedforward`` as in :func:`multiarm.control.null_space.hold_poses`.
    """
    # there are no derivatives in closed form of the accelerations of followers, nor of forces that
    # take the place of drives
    followed = feedforward and law.objects.size < data.state.poses.shape[0]
    command.targets.independent = not (followed or model.undriven.size > 0)
    for j in range(data.state.joint_rates.size):
        command.preferred[j] = -law.free_rate * data.state.joint_rates[j]
    for i in range(work.first_joint.size - 1):
        d0, d1 = work.first_joint[i], work.first_joint[i + 1]
        if d0 == d1:  # the surroundings
            continue
        r0, r1 = work.first_contact[i], work.first_contact[i + 1]
        holds = law.free_stiffness == 0.0 or hold_poses(
            i, law, command, feedforward, model, data, work
        )
        independent = nearest_accelerations(
            work.M[i], work.W[i], command.preferred[d0:d1], command.target[r0:r1],
            command.a_j[d0:d1], command.multipliers[r0:r1],
        )  # fmt: skip
        if not (holds and independent):
            command.targets.independent = False
        for j in range(d1 - d0):
            data.control.torque[d0 + j] += times_block_inertia(i, j, work, command.a_j)


def computed_torque_program(
    control: ComputedTorqueControl, context: ControlContext
) -> ControlProgram:
    """The law of computed torque."""
    return _program(computed_torque, write_computed_torque_derivatives, control, context)


def object_impedance_program(
    control: ObjectImpedanceControl, context: ControlContext
) -> ControlProgram:
    """The law of the object impedance."""
    return _program(object_impedance, write_object_impedance_derivatives, control, context)


def _program(
    law: Kernel, derivatives: Kernel, control: ObjectControl, context: ControlContext
) -> ControlProgram:
    paths = _paths(control, context)
    grip = grip_of(control, context, list(paths))
    numbers = object_law(control, grip, paths)
    law_of_objects = ControlLaw(law, numbers, work=ObjectCommand, reads_inertias=True)
    if grip.counts_friction:
        law_of_objects = replace(law_of_objects, answers=ANSWERS)
    else:
        prepare = partial(prepare_command_derivatives, derivatives)
        law_of_objects = replace(law_of_objects, derivative=differentiate_command, prepare=prepare)
    written = control.paths(context.start.layout.objects)
    times = [path.times for name, path in paths.items() if written[name]]
    return ControlProgram(
        (law_of_objects,),
        np.unique(np.concatenate([np.zeros(0), *times])),
        counts_friction=grip.counts_friction,
    )


def _paths(control: ObjectControl, context: ControlContext) -> dict[str, PosePath]:
    """The paths of the objects that are moved; one that has none stays where it is."""
    paths = {}
    for name, waypoints in control.paths(context.start.layout.objects).items():
        pose = pose_of(context.start.objects[name])
        at_rest = Waypoint(time=1.0, **pose.model_dump())
        paths[name] = pose_path(*route(pose.matrix(), waypoints or (at_rest,)))
    return paths


def object_law(control: ObjectControl, grip: Grip, paths: Mapping[str, PosePath]) -> ObjectLaw:
    """Numbers of a law that moves objects along paths, with the grip at its start.

    Raises
    ------
    ControlError
        When the contacts cannot have the internal forces of the scene, or the paths would open a
        joint between objects.
    """
    data = grip.context.data
    if data.model.layout.passive_joints:
        _require_idle(data, control)
    squeezed = () if grip.counts_friction else list(paths)
    desired = desired_forces(data, control, squeezed, grip.tangents)
    if isinstance(control, ComputedTorqueControl):  # a spring may pull against a joint
        _require_closed(grip.context, paths)
    return ObjectLaw(
        np.array([data.model.layout.objects.index(name) for name in paths]),
        control.stiffness.vector(),
        control.damping.vector(),
        control.relative_damping,
        control.relative_stiffness,
        any(np.any(forces) for forces in desired[:2]),
        *grip.contacts,
        *desired,
        *PosePaths.of([*paths.values()]),
    )


def _require_closed(context: ControlContext, paths: Mapping[str, PosePath]) -> None:
    """Refuse paths of objects that would open a joint between these, or of one with the world."""
    data, layout = context.data, context.start.layout
    between = {
        name: layout.contacts_of(layout.owners.index(name))
        for name, pair in data.model.connections.items()
        if not pair.robots and set(pair.objects) <= set(paths)
    }
    records = data.model.records
    rows_of = {
        name: [k for k in range(rows.start, rows.stop) if not records[k].pushes_only]
        for name, rows in between.items()
    }
    state = context.start.copy()
    times = np.unique(np.concatenate([path.times for path in paths.values()]))
    for t in np.unique(np.linspace(times[:-1], times[1:], 5)) if rows_of else ():
        for name, path in paths.items():
            position, quaternion, *_ = reference_pose(t, path)
            state.objects[name].position[:] = position
            state.objects[name].quaternion_xyzw[:] = quaternion
        data.set_state(t, state)
        require_ok(data, update_kinematics(data.struct))
        for name, rows in rows_of.items():
            gap = float(np.max(np.abs(data.contact_rows.gap[rows]), initial=0.0))
            if gap > OPEN:
                bodies = data.model.connections[name].objects
                raise ControlError(
                    f"control: at {t:.3g} s the path of {' and '.join(map(repr, bodies))} would "
                    f"open the joint '{name}' by {gap:.3g} m; write poses that this joint allows, "
                    "or leave an object out, which then follows"
                )


def _require_idle(data: Data, control: ObjectControl) -> None:
    """Refuse passive joints whose torque contact forces cannot take over, whatever it is."""
    model, layout = data.model, data.model.layout
    if control.squeeze or control.internal_forces:
        key = "squeeze" if control.squeeze else "internal_forces"
        raise ControlError(
            f"control.{key}: the passive joint '{model.joint_names[layout.passive_joints[0]]}' "
            "leaves no choice of internal forces; leave it out"
        )
    joints = np.array(layout.passive_joints)
    places = np.append(np.arange(layout.node), layout.node + joints)
    directions = force_directions(data)[places].T
    sizes = np.linalg.norm(directions, axis=0)
    directions = directions / np.where(sizes > 0.0, sizes, 1.0)
    loose = null_space(directions).basis[layout.node :]
    for joint, row in zip(joints.tolist(), loose, strict=True):
        if np.max(np.abs(row), initial=0.0) > 1e-6:
            raise ControlError(
                f"control: {control.kind} cannot do without a torque of the passive joint "
                f"'{model.joint_names[joint]}': contact forces do not act on it, or the object's "
                "motion needs all of them; give it a drive, or add an arm"
            )
