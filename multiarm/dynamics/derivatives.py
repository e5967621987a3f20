r"""Derivatives of accelerations and contact forces with respect to state and torques.

The equations of motion are :math:`F(x, y) = 0` for the unknowns :math:`y = (\dot v_o, \ddot q_i,
\lambda_i)` of an evaluation, with the state and the torques :math:`x`:

.. math::
    F_i &= M_i \ddot q_i - f_i - W_i \lambda_i, \qquad
    F_o = M_o \dot v_o - f_o - \sum_i W_{oi} \lambda_i \\
    F_{\varphi i} &= \ddot\varphi_i = W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i .

By the implicit function theorem :math:`dy = -K^{-1}\, \partial F`, where K has the matrices of the
evaluation itself.  Each block is solved on its own, and then the object:

.. math::
    \begin{bmatrix} M_i & -W_i \\ W_i^T & 0 \end{bmatrix}
    \begin{bmatrix} d\ddot q_i \\ d\lambda_i \end{bmatrix} =
    -\begin{bmatrix} \partial F_i \\ \partial F_{\varphi i} \end{bmatrix}
    - \begin{bmatrix} 0 \\ W_{oi}^T \end{bmatrix} d\dot v_o .

The right-hand sides at fixed y come from

* the inverse dynamics of each block under the wrench of its contacts, and the motion of the link
  that carries the tip (:mod:`multiarm.robots.derivatives`);
* the contact rows, as functions of the link's motion seen from the object
  (:mod:`multiarm.dynamics.contact_derivatives`).

*Control and effects* add forces :math:`f(x)`: torques on the joints, wrenches on the objects.  The
responses of ``y`` to these are columns of the same solution, so that
:math:`dy/dx = \partial y/\partial x + (\partial y/\partial f)\,(\partial f/\partial x)`, with
the last factor from :mod:`multiarm.dynamics.force_derivatives`.

*Parameters.*  A wrench on the object, its mass and its inertia enter :math:`F_o` alone.  Contacts
that are displaced against the block's link move like that link for the rows, while their wrench
still acts on the link where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import Code, rolls
from multiarm.dynamics.coordinates import block_columns, column_of_state, equation_columns
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import (
    equation_work,
    solve_by_blocks,
    stack_derivatives,
    stack_matrix,
    write_derivatives,
)
from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.force_derivatives import applied_derivatives
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import require_one_object
from multiarm.dynamics.sensitivity import Derivatives, Motions, columns_of, rows_of
from multiarm.dynamics.sliding import Slides, friction_of_unit_force
from multiarm.dynamics.sliding_derivatives import add_friction, friction_derivatives
from multiarm.dynamics.solver.bounds import SYSTEM_TOLERANCE
from multiarm.dynamics.solver.dense import reciprocal_lengths
from multiarm.dynamics.solver.factors import rank_of
from multiarm.dynamics.solver.solution import Elimination
from multiarm.dynamics.status import OK
from multiarm.errors import SolverError
from multiarm.jit.rows import fields_of

# Part of the right-hand sides that dependent constraints may contradict: roundings and differences.
CONSISTENT = 1e-7


def differentiate(
    data: Data, evaluation: Evaluation, closed_loop: bool, parameters: bool
) -> Derivatives:
    """The derivatives of an evaluation of the data, right after it.

    Raises
    ------
    SolverError
        When the accelerations are not differentiable at this state.
    """
    layout, states = data.model.layout, data.arrays.effects.states.size
    if parameters:
        require_one_object(data.model, "there are no derivatives by their parameters yet")
    rows, columns = rows_of(layout, states), columns_of(layout, states, parameters)
    equations = _Equations(data, parameters, columns)
    dependent, message = layout.contacts - evaluation.rank, ""
    independent = dependent == 0
    by_blocks = independent and _stand_alone(data)
    matrix = np.zeros((rows["effect_state_rates"].stop, equations.width))
    solved = matrix[: rows["effect_state_rates"].start]
    motions = equations.motions(independent)
    admissible = None if independent else motions().admissible()
    if not (by_blocks and equations.solve_by_blocks(solved)):
        solved[:] = equations.solve_whole(admissible)
    applied = applied_derivatives(data, closed_loop)  # control may solve equations of its own
    if applied is not None:
        of_state = np.r_[: columns["torques"].start, columns["effect_states"]]
        if admissible is not None:
            applied[:, : len(admissible)] = applied[:, : len(admissible)] @ admissible
        matrix[rows["effect_state_rates"], of_state] = applied[layout.nv :]
        by_force = np.hstack([solved[:, equations.wrench], solved[:, columns["torques"]]])
        solved[:, of_state] += by_force @ applied[: layout.nv]
    if not independent:
        unique = np.concatenate(list(evaluation.contact_forces_unique.values()))
        matrix[rows["contact_forces"]][~unique] = np.nan
        message = (
            f"constraints that repeat others: {dependent} of {layout.contacts}; "
            "displacements are projected on those that keep the joints closed, and forces that are "
            "not unique have no derivatives"
        )
        if parameters:
            message += "; placements that would contradict the others have none either"
    matrix = matrix[:, : max(part.stop for part in columns.values())]
    return Derivatives(evaluation, matrix, rows, columns, layout, message, motions)


def _stand_alone(data: Data) -> bool:
    """Whether the equations of every block, as in the last solution, are regular on their own.

    With friction blocks are coupled without being counted where all constraints are independent.
    """
    elimination = data.arrays.solution.elimination
    if elimination == Elimination.FRICTION:
        return not np.any(data.arrays.deficient.coupled)
    return bool(elimination == Elimination.WHOLE)


def differentiate_friction(data: Data, slides: Slides, derivatives: Derivatives) -> np.ndarray:
    """Derivatives of the friction of sliding contacts, (s, 2, C), along their two tangents.

    At the evaluation of the data, whose ``derivatives`` are given.
    """
    matrix, columns, layout = derivatives.matrix, derivatives.columns, derivatives.layout
    equations = _Equations(data, "placements" in columns, columns)
    states, of_all = columns["torques"].start, equation_columns(data.arrays)
    normal = matrix[derivatives.rows["contact_forces"]][slides.row]
    turns = np.zeros((len(slides.row), matrix.shape[1]))
    for turn, angle, i in zip(turns, equations.friction.angle, slides.block, strict=True):
        d0 = layout.first_joint_of_block[i]
        of_block = block_columns(layout.node, layout.joint_counts[i], 0)
        places = [column_of_state(of_all, of_block, d0, c) for c in range(of_block.end)]
        turn[places] = angle[: of_block.end]
        if "placements" in columns and i in layout.blocks_of_robots:
            owners = np.flatnonzero(np.equal(layout.block_of, i))
            first, size = columns["placements"].start + 6 * owners[0], 6 * len(owners)
            turn[first : first + size] = angle[of_block.end : of_block.end + size]
    if not derivatives.motions.independent:
        turns[:, :states] = turns[:, :states] @ derivatives.motions.admissible()
    friction = np.array([friction_of_unit_force(slides, s) for s in range(slides.row.size)])
    friction = friction.reshape(-1, 2)
    force = data.arrays.rows.force[slides.row, None] * friction
    across = force[:, ::-1] * [-1.0, 1.0]  # turned by a right angle
    return friction[:, :, None] * normal[:, None] + across[:, :, None] * turns[:, None]


class _Equations:
    """The derivatives of F at the solution in some data, and the solution for ``dy``.

    Attributes
    ----------
    wrench : slice
        Columns of wrenches on the objects, which may follow after those that are wanted.
    width : int
        Number of columns with these.
    friction : FrictionDerivatives
    """

    def __init__(self, data: Data, parameters: bool, columns: Mapping[str, slice]) -> None:
        self._data, self._parameters, self._columns = data, parameters, columns
        end = max(part.stop for part in columns.values())
        self.wrench = columns.get("object_wrench", slice(end, end + data.model.layout.node))
        self.width = max(end, self.wrench.stop)
        placements = columns["placements"].start if parameters else -1
        self._work, self._struct = equation_work(data, self.width, placements)
        self.friction, self._friction = friction_derivatives(data, self.width, placements)
        self._update()

    def solve_by_blocks(self, matrix: np.ndarray) -> bool:
        """Write ``dy``, shape (6 F + n + N, columns), block by block; False where that is singular.

        It takes the place of the derivatives of F, which are restored where it fails.
        """
        solved = solve_by_blocks(self._data.struct, self._struct, matrix) == OK
        if not solved:
            self._update()
        return solved

    def solve_whole(self, admissible: np.ndarray | None) -> np.ndarray:
        """``dy`` with blocks that cannot be solved on their own.

        By displacements of the state that are projected by a matrix on those that keep the joints
        closed, as dependent constraints are solvable for these only; None: by all.

        Raises
        ------
        SolverError
            When the rank of the constraints changes with these displacements.
        """
        layout, size = self._data.model.layout, self._data.model.layout.nv
        K, right = self._stacked()
        states = self._columns["torques"].start
        if admissible is not None:
            right[:, :states] = right[:, :states] @ admissible
        scale = np.concatenate([1.0 / np.sqrt(np.diag(K)[:size]), np.ones(layout.contacts)])
        lengths = np.linalg.norm(scale[:size, None] * K[:size, size:], axis=0)
        scale[size:] = reciprocal_lengths(lengths)
        u, singular, vt = np.linalg.svd(scale[:, None] * K * scale)
        rank = rank_of(singular, SYSTEM_TOLERANCE)
        right = u.T @ (scale[:, None] * right)
        left = np.abs(right[rank:]).max(axis=0, initial=0.0)
        contradictory = left > CONSISTENT * np.abs(right).max()
        if self._parameters:
            placements = np.zeros_like(contradictory)
            placements[self._columns["placements"]] = True
            right[:, contradictory & placements] = np.nan
            contradictory &= ~placements
        if contradictory.any():
            raise SolverError(
                "derivatives: the rank of the constraints changes at this state, so that "
                "accelerations are not differentiable there; take a state beside it"
            )
        return scale[:, None] * (vt[:rank].T @ (right[:rank] / singular[:rank, None]))

    def motions(self, independent: bool) -> Callable[[], Motions]:
        """What makes the inertia and the derivatives of the gaps, when they are needed."""
        b, work = self._data.arrays, self._work
        arrays = (
            part.copy()
            for part in (b.bodies.object_inertia, work.M, self._data.work.W, b.rows.W_o, work.rates)
        )
        table = self._data.model.constants.contacts
        codes = fields_of(Code, table.codes[: len(b.rows.W_o)])
        closed, layout = ~rolls(codes.kind), self._data.model.layout
        return partial(_motions, layout, closed, independent, *arrays)

    def _update(self) -> None:
        """Derivatives of the equations at the solution in the data."""
        data = self._data
        require_ok(data, write_derivatives(data.struct, self._struct))
        if data.arrays.modes.slides:
            require_ok(data, add_friction(data.struct, self._struct, self._friction))
        b, dF_o = self._data.arrays, self._work.dF_o
        dF_o[:, self.wrench] = -np.eye(len(dF_o))  # by wrenches on the objects
        if not self._parameters:
            return
        falling = b.accelerations.a_o[:3] - self._data.model.constants.gravity
        dF_o[:3, self._columns["object_mass"].start] = falling
        R = fields_of(BodyMotion, b.bodies.objects[0]).rotation
        first = self._columns["object_inertia"].start
        spin, turning = b.state.twists[0][3:], b.accelerations.a_o[3:]
        for k, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True)):
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = 1.0
            unit = R @ unit @ R.T
            dF_o[3:, first + k] = unit @ turning + np.cross(spin, unit @ spin)

    def _stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """The matrix of all equations, and the right-hand sides: minus their derivatives."""
        layout = self._data.model.layout
        size = layout.nv + layout.contacts
        K, right = np.zeros((size, size)), np.zeros((size, self._work.dF_o.shape[1]))
        stack_matrix(self._data.struct, self._struct, K)
        stack_derivatives(self._data.struct, self._struct, -1.0, right)
        return K, right


def _motions(
    layout: Layout,
    closed: np.ndarray,
    independent: bool,
    inertia_o: np.ndarray,
    M: np.ndarray,
    W: np.ndarray,
    W_o: np.ndarray,
    of_rates: np.ndarray,
) -> Motions:
    size, frames = layout.nv, layout.of_frames
    inertia, (rates, by_position) = np.zeros((size, size)), np.zeros((2, layout.contacts, size))
    inertia[frames, frames], rates[:, frames], by_position[:, frames] = (
        inertia_o, W_o, of_rates[:, frames],
    )  # fmt: skip
    for i in range(layout.block_count):
        rows, n, m = layout.contacts_of_block(i), layout.joint_counts[i], layout.contact_counts[i]
        at, first = layout.of_block(i), block_columns(layout.node, n, 0).positions
        inertia[at, at] = M[i, :n, :n]
        rates[rows, at], by_position[rows, at] = W[i, :n, :m].T, of_rates[rows, first : first + n]
    return Motions(layout, inertia, closed, rates, by_position, independent)
