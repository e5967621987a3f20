r"""Derivatives of torques that control laws command, in closed form.

*Joint PD*, :math:`\tau = K_p (q_r - q) + K_d (\dot q_r - \dot q)`, has those of its gains.

*Gravity compensation*, :math:`\tau = g(q) - W\lambda`, with the forces of least norm
:math:`\lambda = W_o^T y`, :math:`A = W_o W_o^T`, :math:`A y = w`, that carry the weight w of the
object:

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

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_derivatives import arm_columns
from multiarm.dynamics.coordinates import force_columns
from multiarm.dynamics.equation_derivatives import differentiate_holding, equation_work
from multiarm.dynamics.model import Data
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import struct_at

# Contacts that carry wrenches in some direction so much worse than in others leave the forces of
# least norm to rounding.
ILL_CONDITIONED = 1e10


@cfunc
def differentiate_joint_pd(address, size, place, _t):
    """Add the derivatives of laws whose numbers begin with stiffness and damping of every joint."""
    model, data, _ = open_system(struct_at(address, size))
    gains, at, n, columns = model.parameters, int(place), data.torque.size, force_columns(data)
    for j in range(n):
        data.torque_slopes[j, columns.positions + j] -= gains[at + j]
        data.torque_slopes[j, columns.rates + j] -= gains[at + n + j]
    return 0


def holding_derivatives(data: Data) -> np.ndarray | None:
    """Derivatives of gravity compensation, shape (n, 12 + 2 n), right after an evaluation.

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
    for i, (d0, d1) in enumerate(zip(layout.dofs, layout.dofs[1:], strict=False)):
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
    for i, (d0, d1) in enumerate(zip(layout.dofs, layout.dofs[1:], strict=False)):
        rows = slice(*layout.rows[i : i + 2])
        W = data.work.W[i, : d1 - d0, : rows.stop - rows.start]
        torques[d0:d1] -= W @ forces[rows]
    return torques
