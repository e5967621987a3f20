r"""Gravity compensation: the torques that hold robots and objects at rest.

.. math::
    \tau_i = g_i(q_i) - W_i\lambda_i, \qquad \lambda = W_o^T y, \quad A y = w, \quad A = W_o W_o^T,

with the contact forces of least norm that carry the weight of the objects, :math:`w = [-m g; 0]`
(thesis, 3.4 and 3.10 at rest).  Those of a robot's connections with the world, of its inner loops
and couplings are zero: drives hold the robot.  Where contacts cannot carry all of the weight, as
those of a single hinge, they carry what is nearest in the sense of least squares; the rest is said
at the start (:func:`uncarried_weight`) and by every evaluation.  Their derivatives are

.. math::
    d\tau &= \big(dg - dW\,\lambda\big) - W\,d\lambda, \qquad
    d\lambda = dW_o^T y + W_o^T dy, \\
    A\,dy &= -\big(dW_o\,\lambda + W_o\,(dW_o^T y)\big)

(:mod:`multiarm.control.command_derivatives`): the first bracket is the derivative of the arms'
inverse dynamics at rest under these forces, :math:`dW_o\,\lambda` that of their wrench on the
object, and :math:`dW_o^T y` that of the rates of the gaps while the object moves with the twist y
and the arms rest.

*By friction*, where the scene has a ``friction_margin``, contacts carry the weight with the forces
of :mod:`multiarm.dynamics.forces.friction`; derivatives are differences then.

*Floating bases and passive joints* have no drives either: with the rows :math:`g_b, W_b` of their
wrenches and torques, the forces of least norm satisfy :math:`W_b\lambda = g_b` besides, so that
joints with the world, and the object where others hold it, carry these robots.  The derivatives are
differences then.

The twist y has the multipliers of the law (:mod:`multiarm.dynamics.control_laws`): at fixed y an
arm's torques :math:`g_i - W_i W_{oi}^T y` depend on its own state and the object's, and so does
:math:`r_i = W_{oi} W_{oi}^T y`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.control.command_derivatives import (
    PreparedDerivatives,
    add_inverse_dynamics,
    begin_command,
    call_derivatives,
    differentiate_contact_forces,
    open_derivatives,
    prepare_command_derivatives,
)
from multiarm.control.grip import ANSWERS, PushingContacts, grip_of
from multiarm.control.program import ControlContext, ControlProgram, needs_gravity_torque
from multiarm.dynamics.arrays import CARRYING, COUPLED, LOCAL, open_system
from multiarm.dynamics.contact_forces import add_joint_forces, uncarried_wrench
from multiarm.dynamics.control_laws import ControlLaw, view_of_law, view_of_work
from multiarm.dynamics.coordinates import block_columns, column_of_state, force_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import open_equations, write_derivatives_at_rest
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import static_forces
from multiarm.dynamics.forces.friction import distribute_within_friction
from multiarm.dynamics.state import State
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.jit.kernels import allocating, cfunc, clear, copy, inlined, kernel
from multiarm.jit.pointers import address_of, call_whole
from multiarm.jit.structs import struct_at
from multiarm.robots.terms import BASE_DOF
from multiarm.scene.control import GravityCompensationControl, JointPDControl


class CarryingWork(NamedTuple):
    """What the law has besides its torques."""

    derivatives: PreparedDerivatives
    at_fixed_multipliers: PreparedDerivatives

    @classmethod
    def of(cls, _data: Data) -> CarryingWork:
        """Allocate for some data."""
        return cls(PreparedDerivatives(), PreparedDerivatives())


open_carrying = view_of_work(CarryingWork)
open_contacts = view_of_law(PushingContacts)


@cfunc
def gravity_compensation(address, size, _at, _t):
    """Add the torques, which hold arms and object at rest, to ``data.control.torque``."""
    model, data, work = open_system(struct_at(address, size))
    torque, weight = data.control.torque, data.control.object_wrench
    clear(weight)
    add_weights(model, weight)
    if model.undriven.size > 0:
        carry_undriven(model, data, work, data.control.gravity_torque)
    else:
        static_forces(data.rows.W_o, weight, data.rows.static_force)
    for j in range(torque.size):
        torque[j] += data.control.gravity_torque[j]
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, torque)
    return OK


@cfunc
def gravity_compensation_by_friction(address, size, at, _t):
    """Add the torques with which contacts carry the objects within friction; returns an answer."""
    struct = struct_at(address, size)
    model, data, work = open_system(struct)
    torque, weight = data.control.torque, data.control.object_wrench
    clear(weight)
    add_weights(model, weight)
    answer = carry_by_friction(open_contacts(struct, at), weight, data.rows)
    for j in range(torque.size):
        torque[j] += data.control.gravity_torque[j]
    add_joint_forces(work, work.W, data.rows.static_force, -1.0, torque)
    return answer


@allocating
def carry_by_friction(law, weight, rows):
    """Write the contact forces within friction that carry the weight; returns an answer."""
    desired = np.zeros(rows.static_force.size)
    return distribute_within_friction(
        weight, rows.W_o, law.pushing, law.friction, law.least, desired, rows.static_force
    )


@inlined
def add_weights(model, wrench):
    """Add what carries the weight of each object to the wrenches on them (6 F,)."""
    for o in range(model.object_masses.size):
        for k in range(3):
            wrench[6 * o + k] -= model.object_masses[o] * model.gravity[k]


@allocating
def carry_undriven(model, data, work, torque):
    """Write the contact forces that put wrenches on the objects, and take joints without drives.

    These exert ``torque`` (n,) on the joints without drives in place of a drive.  They are the
    forces of least norm, in ``data.rows.static_force``.
    """
    wrench, W_o, undriven = data.control.object_wrench, data.rows.W_o, model.undriven
    node, bases = wrench.size, BASE_DOF * data.state.floating_bases.size
    # six directions a body; passive joints stand among moments, three a body
    passive = undriven.size - bases
    directions = np.zeros((W_o.shape[0], node + bases + 6 * ((passive + 2) // 3)))
    wrenches = np.zeros(directions.shape[1])
    copy(wrench, wrenches[:node])
    for k in range(W_o.shape[0]):
        copy(W_o[k], directions[k, :node])
    for u in range(undriven.size):
        at = node + u
        if u >= bases:
            at = node + bases + 6 * ((u - bases) // 3) + 3 + (u - bases) % 3
        i = 0
        while work.first_joint[i + 1] <= undriven[u]:
            i += 1
        j, first = undriven[u] - work.first_joint[i], work.first_contact[i]
        wrenches[at] = torque[undriven[u]]
        for k in range(first, work.first_contact[i + 1]):
            directions[k, at] = work.W[i, j, k - first]
    static_forces(directions, wrenches, data.rows.static_force)


@cfunc
def differentiate_gravity_compensation(address, size, at, t):
    """Call the derivative that has been prepared."""
    struct = struct_at(address, size)
    return call_derivatives(open_carrying(struct, at).derivatives, struct, at, t)


@cfunc
def write_gravity_compensation_derivatives(address, size, at, _t):
    """Add the derivatives of the torques; returns a status."""
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    derivatives = open_derivatives(open_carrying(struct, at).derivatives)
    status = differentiate_at_rest(struct, data, derivatives)
    if status == OK:
        motion = open_equations(derivatives.motion)
        differentiate_contact_forces(data, work, motion, motion, derivatives)
        add_inverse_dynamics(data, work, motion)
    return status


@kernel
def differentiate_at_rest(struct, data, derivatives):
    """Write y, and the derivatives of the equations at rest under the forces that carry the weight.

    Returns a status.
    """
    motion = open_equations(derivatives.motion)
    copy(data.control.object_wrench, derivatives.twist)
    if not begin_command(data, derivatives):
        return SINGULAR
    clear(motion.a_j)
    copy(data.rows.static_force, motion.force)
    return write_derivatives_at_rest(struct, derivatives.motion, derivatives.twist)


@cfunc
def differentiate_at_fixed_multipliers(address, size, at, t):
    """Call the derivative at fixed y that has been prepared."""
    struct = struct_at(address, size)
    return call_derivatives(open_carrying(struct, at).at_fixed_multipliers, struct, at, t)


@cfunc
def write_derivatives_at_fixed_multipliers(address, size, at, _t):
    """Add the derivatives of the torques at fixed y and by y, and those of the equations for y.

    Returns a status.
    """
    struct = struct_at(address, size)
    _, data, work = open_system(struct)
    derivatives = open_derivatives(open_carrying(struct, at).at_fixed_multipliers)
    status = differentiate_at_rest(struct, data, derivatives)
    if status != OK:
        return status
    motion, columns = open_equations(derivatives.motion), force_columns(data)
    balance = data.slopes.balance
    for l in range(balance.shape[0]):
        for c in range(motion.dF_o.shape[1]):
            balance[l, c] -= motion.dF_o[l, c]
    for i in range(work.first_joint.size - 1):
        d0, r0 = work.first_joint[i], work.first_contact[i]
        of_block = block_columns(balance.shape[0], work.first_joint[i + 1] - d0, 0)
        for k in range(r0, work.first_contact[i + 1]):
            for c in range(of_block.rates):
                if c < of_block.twists or c >= of_block.positions:  # y is no velocity of the state
                    column = column_of_state(columns, of_block, d0, c)
                    add_force_derivative(data, work, i, k, motion.rates[k, c], column)
            for l in range(balance.shape[0]):
                add_force_derivative(data, work, i, k, data.rows.W_o[k, l], columns.multipliers + l)
    add_inverse_dynamics(data, work, motion)
    return status


@inlined
def add_force_derivative(data, work, i, k, force, column):
    """Add the derivative of contact force k, of arm i, to those of its torques and of ``r_i``."""
    d0 = work.first_joint[i]
    for j in range(work.first_joint[i + 1] - d0):
        data.slopes.torque[d0 + j, column] -= work.W[i, j, k - work.first_contact[i]] * force
    for l in range(data.slopes.balance.shape[0]):
        data.slopes.balance[l, column] += data.rows.W_o[k, l] * force


def prepare_carrying(data: Data, work: CarryingWork) -> None:
    """Prepare both derivatives, with the same arrays."""
    prepare_command_derivatives(write_gravity_compensation_derivatives, data, work)
    whole, at_fixed_multipliers = work.derivatives, work.at_fixed_multipliers
    at_fixed_multipliers.function = address_of(write_derivatives_at_fixed_multipliers)
    at_fixed_multipliers.refer(work=whole.references["work"])
    at_fixed_multipliers.size = whole.size


def carrying_laws(context: ControlContext) -> tuple[ControlLaw, ...]:
    """The law that carries the weight, where there is one and the control carries it."""
    if not needs_gravity_torque(context.scene):
        return ()
    if context.start.layout.undriven_joints.size:
        return (ControlLaw(gravity_compensation),)
    law = ControlLaw(
        gravity_compensation,
        derivative=differentiate_gravity_compensation,
        work=CarryingWork,
        prepare=prepare_carrying,
        share_derivative=differentiate_at_fixed_multipliers,
    )
    return (law,)


def carrying_grip(
    control: GravityCompensationControl | JointPDControl, context: ControlContext
) -> tuple[tuple[ControlLaw, ...], bool]:
    """The law that carries the weight, where there is one, and whether it counts friction.

    Raises
    ------
    ControlError
        See :func:`multiarm.control.grip.grip_of`.
    """
    carries = control.compensates_gravity and control.friction_margin is not None
    grip = grip_of(control, context) if carries else None
    if grip is None:
        return carrying_laws(context), False
    law = ControlLaw(gravity_compensation_by_friction, grip.contacts, answers=ANSWERS)
    return (law,), True


def reach_with(carrying: tuple[ControlLaw, ...]) -> int:
    """What torques depend on, of which these laws and others of each robot alone are parts."""
    if not carrying:
        return LOCAL
    return COUPLED if carrying[-1].share_derivative is None else CARRYING


def gravity_compensation_program(
    control: GravityCompensationControl, context: ControlContext
) -> ControlProgram:
    """The law of gravity compensation; without gravity there is none but by friction."""
    carrying, counts_friction = carrying_grip(control, context)
    return ControlProgram(carrying, reach=reach_with(carrying), counts_friction=counts_friction)


def holding_torque(data: Data, start: State) -> np.ndarray:
    """Constant joint torques that hold the system at rest at its start, shape (n,).

    Of floating bases and passive joints what no contact carries.
    """
    gravity, b = data.model.constants.gravity, data.arrays
    if not np.any(gravity):
        return np.zeros(data.model.layout.rate_count)
    state = start.copy()
    state.velocity[:] = 0.0
    data.set_state(0.0, state)
    require_ok(data, update_kinematics(data.struct))
    b.control.gravity_torque[:] = np.concatenate(
        [
            data.model.robots[robot].gravity_torque(angles, gravity, state.bases.get(robot))
            for robot, angles in state.joint_positions.items()
        ]
    )
    b.control.torque[:] = 0.0
    call_whole(gravity_compensation, data.struct)
    return b.control.torque.copy()


def uncarried_weight(data: Data, start: State) -> np.ndarray:
    """What the contacts leave of the objects' weights at a start, wrenches (6 F,) [N, N m].

    About the centres of mass, world axes.
    """
    holding_torque(data, start)
    return uncarried_wrench(data)


def uncarried_bases(data: Data, start: State) -> dict[str, np.ndarray]:
    """What the contacts leave of the weight of robots whose base floats, wrenches (6,) [N, N m].

    About the origins of their bases, world axes.
    """
    return start.layout.split_bases(holding_torque(data, start))


def uncarried_joints(data: Data, start: State) -> dict[int, float]:
    """What the contacts leave of the gravity torques of passive joints, by the joint's number."""
    torque = holding_torque(data, start)
    return {joint: float(torque[joint]) for joint in start.layout.passive_joints}
