r"""Gravity compensation: the torques that hold arms and object at rest.

.. math::
    \tau_i = g_i(q_i) - W_i\lambda_i, \qquad \lambda = W_o^T y, \quad A y = w, \quad A = W_o W_o^T,

with the contact forces of least norm that carry the weight of the object, :math:`w = [-m g; 0]`
(thesis, 3.4 and 3.10 at rest).  Their derivatives are

.. math::
    d\tau &= \big(dg - dW\,\lambda\big) - W\,d\lambda, \qquad
    d\lambda = dW_o^T y + W_o^T dy, \\
    A\,dy &= -\big(dW_o\,\lambda + W_o\,(dW_o^T y)\big) .

The first bracket is the derivative of the arms' inverse dynamics at rest under these forces;
:math:`dW_o\,\lambda` that of their wrench on the object; and :math:`dW_o^T y` that of the rates of
the gaps while the object moves with the twist y and the arms rest.  All three are written by
:func:`multiarm.dynamics.equation_derivatives.differentiate_holding`.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from multiarm.control.program import ControlContext, ControlProgram, needs_gravity_torque
from multiarm.dynamics.arrays import CARRYING, open_system
from multiarm.dynamics.contact_derivatives import arm_columns
from multiarm.dynamics.control_laws import ControlLaw
from multiarm.dynamics.equation_derivatives import differentiate_holding, equation_work
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.compiled import static_forces, subtract_contact_forces
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.jit.kernels import INTS, cfunc, clear, kernel
from multiarm.jit.structs import struct_at
from multiarm.scene.control import GravityCompensationControl

# Contacts that carry wrenches in some direction so much worse than in others leave the forces of
# least norm to rounding.
ILL_CONDITIONED = 1e10


@cfunc
def gravity_compensation(address, size, _at, _t):
    """Add the torques."""
    model, data, work = open_system(struct_at(address, size))
    add_holding_torques(model, data, work)
    return 0


@kernel
def add_holding_torques(model, data, work):
    """Add the torques that hold arms and object at rest to ``data.torque``."""
    torque, weight = data.torque, data.weight
    for k in range(3):
        weight[k] = -model.object_mass * model.gravity[k]
        weight[3 + k] = 0.0
    static_forces(data.Wo, weight, data.static_force)
    for j in range(torque.size):
        torque[j] += data.gravity_torque[j]
    subtract_contact_forces(data, work)


def holding_derivatives(data: Data) -> np.ndarray | None:
    """Derivatives of gravity compensation, shape (n, 12 F + 2 n), right after an evaluation.

    By the columns of the state, see :mod:`multiarm.dynamics.layout`.  None where there is no closed
    form, as contacts cannot carry any wrench.
    """
    layout, b = data.model.layout, data.arrays
    n, W_o, pose = layout.joints, b.Wo, layout.columns["object_pose"]
    scale = np.ones(6)
    scale[3:] = 1.0 / max(np.linalg.norm(W_o[:, 3:], axis=1).max(initial=0.0), 1e-6)
    A = (scale[:, None] * W_o.T) @ (W_o * scale)
    eigenvalues = np.linalg.eigvalsh(A)
    if not eigenvalues[0] * ILL_CONDITIONED > eigenvalues[-1]:
        return None
    twist = scale * np.linalg.solve(A, scale * b.weight)
    work, differentiation = equation_work(data, 2 * layout.nv + n)
    differentiate_holding(data, differentiation, twist)
    torques, rates = np.zeros((n, 2 * layout.nv)), np.zeros((len(W_o), 2 * layout.nv))
    for i, (d0, d1) in enumerate(pairwise(layout.dofs)):
        rows, by_state = slice(*layout.rows[i : i + 2]), work.dF[i, : d1 - d0]
        columns = arm_columns(d1 - d0, False)
        of_arm = slice(columns.positions, columns.velocities)
        of_all = layout.columns["joint_positions"].start + np.arange(d0, d1)
        rates[rows, pose], torques[d0:d1, pose] = work.rates[rows, pose], by_state[:, pose]
        rates[rows, of_all] = work.rates[rows, of_arm]
        torques[d0:d1, of_all] = by_state[:, of_arm]
    of_wrench = -work.dF_o[:, : 2 * layout.nv]
    of_twist = -scale[:, None] * np.linalg.solve(A, scale[:, None] * (of_wrench + W_o.T @ rates))
    forces = rates + W_o @ of_twist
    for i, (d0, d1) in enumerate(pairwise(layout.dofs)):
        rows = slice(*layout.rows[i : i + 2])
        W = data.work.W[i, : d1 - d0, : rows.stop - rows.start]
        torques[d0:d1] -= W @ forces[rows]
    return torques


def carrying_laws(context: ControlContext) -> tuple[ControlLaw, ...]:
    """The law that carries the weight, where there is one and the control carries it."""
    return (ControlLaw(gravity_compensation),) if needs_gravity_torque(context.scene) else ()


def gravity_compensation_program(
    _control: GravityCompensationControl, context: ControlContext
) -> ControlProgram:
    """The law of gravity compensation; without gravity there is none."""
    return ControlProgram(carrying_laws(context), reach=CARRYING, derivative=holding_derivatives)


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


@kernel
def write_holding_torque(struct: INTS):
    """Write the torques that hold the configuration in ``data`` into ``data.torque``.

    Needs its kinematics and ``gravity_torque`` in ``data``.
    """
    model, data, work = open_system(struct)
    clear(data.torque)
    add_holding_torques(model, data, work)
