r"""Control laws that move the object: inverse dynamics along a path, and an impedance.

Both command a wrench ``w`` on the object, distribute it over the contacts
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
  turns, an elbow that floats) at the rate :math:`\delta`.

* *Object impedance* holds the object by a spring and a damper, without changing the inertia of
  object and robots: :math:`w = K e + D(v_r - v_o) - m g`, of other objects :math:`w = -m g`,
  :math:`\tau_i = g_i - W_i\lambda_i - \delta M_i P_i\dot q_i` with :math:`P_i` the projection on
  the robot's free motions.  The spring has the energy :math:`\tfrac12 e^T K e` also for large
  rotations and with a different stiffness about each axis, so that the law is passive while its
  reference rests: the rotation vector ``theta`` to the reference has the rate
  :math:`-J_r^{-1}(\theta)\,\omega`, hence the moment :math:`J_r^{-T}(\theta) K\theta`.

With a stiffness of the free motions the robots hold their poses on the object instead
(:mod:`multiarm.control.null_space`).

The internal forces of a squeeze come on top (:mod:`multiarm.control.squeeze`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from multiarm.contacts.kernel import open_contact
from multiarm.control.command_derivatives import prepare_command_derivatives
from multiarm.control.gravity_compensation import add_weights
from multiarm.control.null_space import hold_poses, nearest_accelerations
from multiarm.control.object_derivatives import (
    differentiate_command,
    write_computed_torque_derivatives,
    write_object_impedance_derivatives,
)
from multiarm.control.object_law import ObjectCommand, ObjectLaw, open_command, open_object_law
from multiarm.control.object_path import pose_of, pose_path, reference_pose, route
from multiarm.control.program import ControlContext, ControlProgram
from multiarm.control.squeeze import desired_forces
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import add_joint_forces
from multiarm.dynamics.control_laws import ControlLaw
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import distribute_wrench, static_forces
from multiarm.dynamics.momenta import times_block_inertia
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.factored_trees import complete_inertias
from multiarm.errors import ControlError
from multiarm.jit.kernels import cfunc, clear, kernel
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import sub, vec
from multiarm.scene.control import ComputedTorqueControl, ObjectImpedanceControl, Waypoint
from multiarm.spatial import rotation_between, write_chart_rate

ObjectControl = ComputedTorqueControl | ObjectImpedanceControl


@cfunc
def computed_torque(address, size, at, t):
    """Add the torques of computed torque."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    state, control, wrench = data.state, data.control, data.control.object_wrench
    desired, target = command.acceleration, command.target
    write_object_acceleration(t, law, state.poses[0], state.twists[0], desired)
    for a in range(wrench.size):
        wrench[a] = -data.forces.f_o[a]
        for b in range(desired.size):
            wrench[a] += data.bodies.object_inertia[a, b] * desired[b]
    write_contact_forces(law, data)
    # the law carries the bias and what the joints do by themselves, which is all of f_j so far
    for j in range(control.torque.size):
        control.torque[j] -= data.forces.f_j[j]
    for k in range(target.size):
        target[k] = -open_contact(data.rows.kinematics[k]).gap_bias
        for a in range(desired.size):
            target[k] -= data.rows.W_o[k, a] * desired[a]
    add_motion_forces(law, command, True, model, data, work)
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, data.control.torque)
    return 0


@cfunc
def object_impedance(address, size, at, t):
    """Add the torques of the object impedance."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    law, command = open_object_law(struct, at), open_command(struct, at)
    state, control, wrench = data.state, data.control, data.control.object_wrench
    o = law.object
    clear(wrench)
    write_spring_wrench(t, law, state.poses[o], state.twists[o], wrench[6 * o : 6 * o + 6])
    add_weights(model, wrench)
    write_contact_forces(law, data)
    for j in range(control.torque.size):
        control.torque[j] += control.gravity_torque[j]
    add_motion_forces(law, command, False, model, data, work)
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, data.control.torque)
    return 0


@kernel
def write_object_acceleration(t, law, position, velocity, desired):
    """Write the object's acceleration that computed torque commands into ``desired`` (6,)."""
    place, quaternion, shift, turn, rate, second = reference_pose(t, law)
    ahead, turned = sub(place, vec(position, 0)), rotation_between(position[3:7], quaternion)
    for k in range(3):
        slower = rate * shift[k] - velocity[k]
        desired[k] = second * shift[k] + law.damping[k] * slower + law.stiffness[k] * ahead[k]
    for k in range(3):
        slower = rate * turn[k] - velocity[3 + k]
        spring = law.stiffness[3 + k] * turned[k]
        desired[3 + k] = second * turn[k] + law.damping[3 + k] * slower + spring


@kernel
def write_spring_wrench(t, law, position, velocity, wrench):
    """Write the wrench of the impedance's spring and damper on the object into ``wrench`` (6,)."""
    place, quaternion, shift, turn, rate, _ = reference_pose(t, law)
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
def write_contact_forces(law, data):
    """Distribute the wrench on the object over the contacts; writes ``data.rows.static_force``."""
    wrench, rows = data.control.object_wrench, data.rows
    if law.squeezes:
        distribute_wrench(
            wrench, rows.W_o, rows.first, data.bodies.objects[0], law.forces_of_contacts,
            law.wrenches_of_connections, rows.static_force,
        )  # fmt: skip
    else:
        static_forces(rows.W_o, wrench, rows.static_force)


@kernel
def add_motion_forces(law, command, feedforward, model, data, work):
    """Add ``M q''`` of all robots with the targets of the command; free motions are damped or held.

    ``feedforward`` as in :func:`multiarm.control.null_space.hold_poses`.
    """
    complete_inertias(work)
    command.targets.independent = True
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
    law = ControlLaw(
        computed_torque,
        object_law(control, context),
        differentiate_command,
        ObjectCommand,
        partial(prepare_command_derivatives, write_computed_torque_derivatives),
    )
    return ControlProgram((law,), _waypoint_times(control, law.numbers))


def object_impedance_program(
    control: ObjectImpedanceControl, context: ControlContext
) -> ControlProgram:
    """The law of the object impedance."""
    law = ControlLaw(
        object_impedance,
        object_law(control, context),
        differentiate_command,
        ObjectCommand,
        partial(prepare_command_derivatives, write_object_impedance_derivatives),
    )
    return ControlProgram((law,), _waypoint_times(control, law.numbers))


def _waypoint_times(control: ObjectControl, law: ObjectLaw) -> np.ndarray:
    return law.times if control.path else np.zeros(0)


def object_law(control: ObjectControl, context: ControlContext) -> ObjectLaw:
    """Numbers of a law.

    Raises
    ------
    ControlError
        When the contacts cannot put every wrench on the object, or cannot have the internal forces
        of the scene.
    """
    data, start = context.data, context.start
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    W_o, objects = data.arrays.rows.W_o.copy(), data.model.layout.objects
    name = getattr(control, "object", None) or objects[0]
    moved = objects.index(name)
    _require_hold(W_o, moved, control.kind)
    desired = desired_forces(data, control, W_o)
    pose = pose_of(start.objects[name])
    at_rest = Waypoint(time=1.0, **pose.model_dump())
    path = pose_path(*route(pose.matrix(), control.path or (at_rest,)))
    return ObjectLaw(
        moved,
        control.stiffness.vector(),
        control.damping.vector(),
        control.relative_damping,
        control.relative_stiffness,
        any(np.any(forces) for forces in desired),
        *desired,
        *path,
    )


def _require_hold(W_o: np.ndarray, moved: int, kind: str) -> None:
    """Refuse contacts that cannot put every wrench on the object that is ``moved``."""
    moments = W_o.reshape(len(W_o), -1, 6)[:, :, 3:]
    lever = max(float(np.max(np.linalg.norm(moments, axis=2), initial=0.0)), 1e-12)
    scale = np.tile([1.0, 1.0, 1.0, lever, lever, lever], W_o.shape[1] // 6)
    loose = null_space(W_o / scale).basis[6 * moved : 6 * moved + 6]
    rank = 6 - int(np.linalg.matrix_rank(loose, 1e-6)) if loose.size else 6
    if rank < 6:
        raise ControlError(
            f"control: {kind} needs contacts that can put every force and moment on the object, "
            f"but all {len(W_o)} together span only {rank} of 6 directions: the object can turn or "
            f"slide in them freely; add an arm, or join one with fewer free motions"
        )
