r"""Derivatives of torques that put a wrench on the object and accelerate the arms.

A law commands the wrench :math:`w` on the object, and distributes it over the contacts by
:math:`\lambda = \lambda_s + W_o^T y` with :math:`A y = w - W_o\lambda_s`, :math:`A = W_o W_o^T`,
and desired forces :math:`\lambda_s` (:mod:`multiarm.dynamics.forces.compiled`).  Its torques are
those of the inverse dynamics,

.. math::
    \tau_i = M_i\ddot q_i + b_i - W_i\lambda_i, \qquad
    M_i(\ddot q_i - p_i) = W_i\kappa_i, \qquad W_i^T\ddot q_i = r_i

(:mod:`multiarm.control.null_space`); of gravity compensation with :math:`\ddot q_i = 0` and no
targets.  With :math:`\partial` for a derivative at fixed accelerations and forces,

.. math::
    A\,dy &= dw - \partial(W_o\lambda) - W_o\,(\partial(W_o^T y) + d\lambda_s), \qquad
    d\lambda = \partial(W_o^T y) + d\lambda_s + W_o^T dy, \\
    \begin{bmatrix} M_i & -W_i \\ W_i^T & 0 \end{bmatrix}
    \begin{bmatrix} d\ddot q_i \\ d\kappa_i \end{bmatrix} &= \begin{bmatrix}
    M_i\,dp_i - \partial\big(M_i(\ddot q_i - p_i) - W_i\kappa_i\big) \\
    dr_i - \partial(W_i^T\ddot q_i) \end{bmatrix}, \\
    d\tau_i &= \partial(M_i\ddot q_i + b_i - W_i\lambda_i) + M_i\,d\ddot q_i - W_i\,d\lambda_i .

All of these are derivatives of the equations of motion
(:mod:`multiarm.dynamics.equation_derivatives`) at the motion that is commanded, with its forces:
the *motion*, and at rest without weight the accelerations :math:`\ddot q_i - p_i` under
:math:`\kappa_i`, the *excess*.  :math:`\partial(W_o^T y)` is the derivative of the gaps' rates
while the object moves with the twist y and the arms rest.

There is no closed form where contacts cannot carry any wrench, or the targets of a robot depend on
each other, as those of a flat linkage do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.coordinates import block_columns, column_of_state, force_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import equation_work
from multiarm.dynamics.forces.compiled import factor_wrench_products, solve_wrench_products
from multiarm.dynamics.references import Reference, References
from multiarm.dynamics.solver.factors import factor_lu, solve_rows
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.jit.kernels import Kernel, clear, inlined, kernel
from multiarm.jit.pointers import address_of, call_cfunc
from multiarm.jit.structs import Floats1, Floats2, Int, Ints1, struct_at, struct_of, view


class CommandDerivatives(NamedTuple):
    """Results and scratch for d joints and m contacts of the largest arm, S columns of the state.

    An arm has C columns of its own (:class:`multiarm.dynamics.coordinates.BlockColumns`).
    """

    # structs of multiarm.dynamics.equation_derivatives
    motion: Ints1
    excess: Ints1
    twist: Floats1  # (6 F,) y
    wrench: Floats2  # (6 F, S) dw at fixed accelerations of object and arms; then dy
    acceleration: Floats2  # (6 F, 12 F) of the objects that are commanded, by poses and twists
    preferred: Floats2  # (d, C) dp of one arm
    desired: Floats2  # (N, S) of the forces with which arms press
    forces: Floats2  # (N, S) of the contacts
    motions: Floats2  # (d + m, C) of one arm: right-hand sides, then dq'' and the multipliers
    pivots: Ints1  # (d + m,)
    # W_o W_o^T
    products: Floats2  # (6 F, 6 F)
    scale: Floats1  # (6 F,)
    product_pivots: Ints1  # (6 F,)


class PreparedDerivatives(References):
    """What derivatives of a law need, once they are to be taken.

    Each law has its own, also where several have the same kernel.
    """

    function: Int  # address of the kernel that takes them; 0: they are not prepared
    work: Int  # address of the struct of :class:`CommandDerivatives`
    size: Int  # of this struct


_open_work = view(CommandDerivatives)


@inlined
def open_derivatives(prepared):
    """The view of the results and scratch of derivatives that are prepared."""
    return _open_work(struct_at(prepared.work, prepared.size))


@inlined
def call_derivatives(prepared, struct, at, t):
    """Call derivatives that are prepared; returns a status."""
    return call_cfunc(prepared.function, struct, at, t)


def prepare_command_derivatives(derivative: Kernel, data: Data, work: Any) -> None:
    """Prepare ``work.derivatives`` for a derivative.

    So it is compiled where derivatives are taken, and not for every run: the law's own derivative
    only calls it.
    """
    prepared: PreparedDerivatives = work.derivatives
    if prepared.function == 0:
        layout, states = data.model.layout, 2 * data.model.layout.nv
        d, m = max(layout.joint_counts), max(layout.contact_counts)
        node = layout.node
        width = block_columns(node, d, 0).end
        _, motion = equation_work(data, states)
        _, excess = equation_work(data, states, weights=False)
        arrays = CommandDerivatives(
            motion=motion,
            excess=excess,
            twist=np.zeros(node),
            wrench=np.zeros((node, states)),
            acceleration=np.zeros((node, 2 * node)),
            preferred=np.zeros((d, width)),
            desired=np.zeros((layout.contacts, states)),
            forces=np.zeros((layout.contacts, states)),
            motions=np.zeros((d + m, width)),
            pivots=np.zeros(d + m, dtype=np.int64),
            products=np.zeros((node, node)),
            scale=np.zeros(node),
            product_pivots=np.zeros(node, dtype=np.int64),
        )
        struct = struct_of(arrays)
        # the data own the work of the equations
        prepared.refer(work=Reference(struct, (arrays, data)))
        prepared.size = struct.size
        prepared.function = address_of(derivative)


@kernel
def begin_command(data, derivatives):
    """Write y of the wrench ``derivatives.twist``, and clear the results.

    Returns whether the contacts carry any wrench.
    """
    products, scale, pivots = derivatives.products, derivatives.scale, derivatives.product_pivots
    for l in range(derivatives.wrench.shape[0]):
        clear(derivatives.wrench[l])
        clear(derivatives.acceleration[l])
    if not factor_wrench_products(data.rows.W_o, products, scale, pivots):
        return False
    solve_wrench_products(products, scale, pivots, derivatives.twist)
    return True


@kernel
def differentiate_contact_forces(data, work, motion, rest, derivatives):
    """Write the derivatives of the contact forces, and subtract ``W d lambda`` from the torques.

    ``motion`` are the derivatives of the equations under the contact forces, ``rest`` those whose
    ``rates`` are of the twist y (:func:`write_derivatives_at_rest`).
    """
    columns, wrench, forces = force_columns(data), derivatives.wrench, derivatives.forces
    size, states = wrench.shape
    for i in range(work.first_joint.size - 1):
        d0, n = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        of_block = block_columns(size, n, 0)
        for k in range(work.first_contact[i], work.first_contact[i + 1]):
            clear(forces[k])
            for c in range(of_block.rates):
                if of_block.twists <= c < of_block.positions:
                    continue  # y is no velocity of the state
                rate, column = rest.rates[k, c], column_of_state(columns, of_block, d0, c)
                forces[k, column] = rate = rate + derivatives.desired[k, column]
                for l in range(size):
                    wrench[l, column] -= data.rows.W_o[k, l] * rate
    for l in range(size):
        for c in range(states):
            wrench[l, c] = derivatives.scale[l] * (wrench[l, c] + motion.dF_o[l, c])
    solve_rows(derivatives.products, size, derivatives.product_pivots, wrench)
    for k in range(data.rows.W_o.shape[0]):
        for l in range(size):
            weight = data.rows.W_o[k, l] * derivatives.scale[l]
            for c in range(states):
                forces[k, c] += weight * wrench[l, c]
    for i in range(work.first_joint.size - 1):
        d0, r0 = work.first_joint[i], work.first_contact[i]
        for j in range(work.first_joint[i + 1] - d0):
            slopes = data.slopes.torque[d0 + j]
            for k in range(work.first_contact[i + 1] - r0):
                weight, force = work.W[i, j, k], forces[r0 + k]
                for c in range(states):
                    slopes[c] -= weight * force[c]


@kernel
def add_inverse_dynamics(data, work, motion):
    """Add the derivatives of ``M q'' + b - W lambda`` at fixed accelerations and forces."""
    columns = force_columns(data)
    for i in range(work.first_joint.size - 1):
        d0, n = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        of_block = block_columns(motion.dF_o.shape[0], n, 0)
        for j in range(n):
            slopes = data.slopes.torque[d0 + j]
            for c in range(of_block.end):
                slopes[column_of_state(columns, of_block, d0, c)] += motion.dF[i, j, c]


@kernel
def add_motion_derivatives(data, work, i, motion, excess, derivatives):
    """Add ``M dq''`` of an arm to the torques, with ``derivatives.preferred``; returns a status."""
    d0, n, r0 = (
        work.first_joint[i],
        work.first_joint[i + 1] - work.first_joint[i],
        work.first_contact[i],
    )
    m, X = work.first_contact[i + 1] - r0, derivatives.motions
    of_block = block_columns(motion.dF_o.shape[0], n, 0)
    columns, M = force_columns(data), motion.M[i]
    for j in range(n):
        for c in range(of_block.end):
            X[j, c] = -excess.dF[i, j, c]
        for k in range(n):
            for c in range(of_block.end):
                X[j, c] += M[j, k] * derivatives.preferred[k, c]
    for k in range(m):
        for c in range(of_block.end):
            X[n + k, c] = -motion.dF[i, n + k, c]
        for l in range(derivatives.acceleration.shape[0]):
            for c in range(of_block.positions):
                X[n + k, c] -= data.rows.W_o[r0 + k, l] * derivatives.acceleration[l, c]
    if not factor_lu(motion.K[i], n + m, derivatives.pivots) > 0.0:
        return SINGULAR
    solve_rows(motion.K[i], n + m, derivatives.pivots, X)
    for j in range(n):
        slopes = data.slopes.torque[d0 + j]
        for k in range(n):
            inertia = M[j, k]
            for c in range(of_block.end):
                slopes[column_of_state(columns, of_block, d0, c)] += inertia * X[k, c]
    return OK


@inlined
def subtract_passive_slopes(data):
    """Subtract the derivatives of what passive effects do to the joints from the torques."""
    for j in range(data.slopes.passive.shape[0]):
        slopes, passive = data.slopes.torque[j], data.slopes.passive[j]
        for c in range(passive.size):
            slopes[c] -= passive[c]
