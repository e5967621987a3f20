r"""Derivatives of accelerations and contact forces with respect to state and torques.

The equations of motion are :math:`F(x, y) = 0` for the unknowns :math:`y = (\dot v_o, \ddot q_i,
\lambda_i)` of an evaluation, with the state and the torques :math:`x`:

.. math::
    F_i &= M_i \ddot q_i - h_i - W_i \lambda_i, \qquad
    F_o = M_o \dot v_o - h_o - \sum_i W_{oi} \lambda_i \\
    F_{\varphi i} &= \ddot\varphi_i = W_{oi}^T \dot v_o + W_i^T \ddot q_i - c_i .

By the implicit function theorem :math:`dy = -K^{-1}\, \partial F`, where K has the matrices of the
evaluation itself.  Each arm is solved on its own, and then the object:

.. math::
    \begin{bmatrix} M_i & -W_i \\ W_i^T & 0 \end{bmatrix}
    \begin{bmatrix} d\ddot q_i \\ d\lambda_i \end{bmatrix} =
    -\begin{bmatrix} \partial F_i \\ \partial F_{\varphi i} \end{bmatrix}
    - \begin{bmatrix} 0 \\ W_{oi}^T \end{bmatrix} d\dot v_o .

The right-hand sides at fixed y come from

* Pinocchio's derivatives of the inverse dynamics of each arm under the wrench of its contacts, and
  of the motion of the link that carries the tip (:mod:`multiarm.arms.derivatives`);
* the contact rows, as functions of the link's motion seen from the object
  (:mod:`multiarm.dynamics.contact_derivatives`);
* differences of order four of effects, and of control that depends on the state, in scenes that
  have any.

*Parameters.*  A wrench on the object, its mass and its inertia enter :math:`F_o` alone.  Contacts
that are displaced against the arm's link move like that link for the rows, while their wrench still
acts on the link where it is.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from multiarm.arms.derivatives import ArmDerivatives
from multiarm.contacts.table import KIND, SIDE, TANGENT
from multiarm.dynamics.arrays import OK, OPEN_LOOP
from multiarm.dynamics.contact_derivatives import (
    BODY_SIZE,
    SCRATCH_ROWS,
    SLOPES_WIDTH,
    STILL,
    differentiate_forces,
    differentiate_joint,
)
from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.model import Data
from multiarm.dynamics.sensitivity import Derivatives, Motions, columns_of, rows_of
from multiarm.dynamics.solver.dense import SYSTEM_TOLERANCE
from multiarm.errors import SolverError
from multiarm.spatial import skew

# The world as the link of an arm without joints, see `differentiate_joint`.
GROUND = np.concatenate([np.eye(3).ravel(), np.zeros(BODY_SIZE - 9)])
# Part of the right-hand sides that dependent constraints may contradict: roundings and differences.
CONSISTENT = 1e-7


def differentiate(
    data: Data, found: Evaluation, closed_loop: bool, parameters: bool
) -> Derivatives:
    """The derivatives of an evaluation of the data, right after it.

    Raises
    ------
    SolverError
        When the accelerations are not differentiable at this state.
    """
    derivation, layout = _Derivation(data, closed_loop, parameters), data.model.layout
    independent, message = found.rank == layout.contacts, ""
    on_ground = layout.rows[-1] > layout.rows[len(layout.names)]
    if independent and not (found.coupled_arms or data.model.constants.dense or on_ground):
        matrix = derivation.solve()
    else:
        matrix = derivation.solve_whole(along_joints=not independent)
    if not independent:
        unique = np.concatenate(list(found.contact_forces_unique.values()))
        matrix[6 + layout.joints :][~unique] = np.nan
        message = (
            f"{layout.contacts - found.rank} of {layout.contacts} constraints repeat others: "
            "displacements are projected on those that keep the joints closed, and forces that are "
            "not unique have no derivatives"
        )
        if parameters:
            message += "; placements that would contradict the others have none either"
    matrix = np.vstack([matrix, derivation.effect_state_rates()])
    rows = rows_of(layout, data.arrays.inner.size)
    return Derivatives(found, matrix, rows, derivation.columns, layout, message, derivation.motions)


class _ArmEquations(NamedTuple):
    """The derivatives of one arm's equations, and their matrix."""

    dof: int
    columns: np.ndarray  # of the right-hand sides, among all
    matrix: np.ndarray  # (n_i + N_i, n_i + N_i): M_i, -W_i; W_i^T, 0
    of_object: np.ndarray  # (n_i + N_i, 6): 0; W_oi^T
    dF: np.ndarray  # (n_i + N_i, ...) of F_i and F_phi, by these columns
    rates: np.ndarray  # (N_i, 12 + 2 n_i) of the gap rates, by pose, twist, q and v

    @property
    def W_o(self) -> np.ndarray:
        """(6, N_i)"""
        return self.of_object[self.dof :].T


class _Derivation:
    """The derivatives of F at the solution in the data, and the solution for ``dy``."""

    def __init__(self, data: Data, closed_loop: bool, parameters: bool) -> None:
        b, model, layout = data.arrays, data.model, data.model.layout
        self.data, self.layout = data, layout
        self.columns = columns_of(layout, b.inner.size, parameters)
        self.width = max(columns.stop for columns in self.columns.values())
        self.state, self.inertia, self.qdd = data.get_state(), b.inertia.copy(), b.qdd.copy()
        self.gravity, self.force = model.constants.gravity, b.force.copy()
        R, position, twist = b.body[:9], self.state.object_position, self.state.object_twist
        self.body = np.concatenate([R, position, np.zeros(3), twist, b.q_o])
        self._scratch = np.zeros((SCRATCH_ROWS, BODY_SIZE))
        self._scratch[STILL, :9] = np.eye(3).ravel()
        self._rows, self._parts = np.zeros_like(b.contacts), np.zeros_like(b.parts)
        self._slopes, self._wrench = np.zeros((layout.contacts, SLOPES_WIDTH)), np.zeros((7, 6))
        self._applied = None  # derivatives of h_o and h, where these are more than weight and bias
        constants = model.constants
        follows = len(constants.control) > 0 and constants.control_reach > OPEN_LOOP
        if (closed_loop and follows) or model.effects.kernels:
            self._applied = self._forces_by_differences(closed_loop)
            self.gravity = np.zeros(3)  # is in h
        self.dF_o = self._object_equation()
        self.arms = [self._arm(i) for i in range(len(layout.dofs) - 1)]

    def solve(self) -> np.ndarray:
        """``dy``, shape (6 + n + N, columns)."""
        inertia, right = self.inertia.copy(), -self.dF_o
        parts = []
        for own in self.arms:
            solved = np.linalg.solve(own.matrix, np.hstack([own.dF, own.of_object]))
            solved, by_object = solved[:, :-6], solved[:, -6:]
            inertia += own.W_o @ by_object[own.dof :]
            right[:, own.columns] -= own.W_o @ solved[own.dof :]
            parts.append((solved, by_object))
        da_o = np.linalg.solve(inertia, right)
        joints, forces = [], []
        for own, (solved, by_object) in zip(self.arms, parts, strict=True):
            found = -by_object @ da_o
            found[:, own.columns] -= solved
            joints.append(found[: own.dof])
            forces.append(found[own.dof :])
        return np.vstack([da_o, *joints, *forces])

    def solve_whole(self, along_joints: bool) -> np.ndarray:
        """``dy`` with arms that cannot be solved on their own.

        ``along_joints``: by displacements projected on those that keep the joints closed, as
        dependent constraints are solvable for these only.

        Raises
        ------
        SolverError
            When the rank of the constraints changes with these displacements.
        """
        layout, size = self.layout, 6 + self.layout.joints
        whole = size + layout.contacts
        K, dF = np.zeros((whole, whole)), np.zeros((whole, self.width))
        K[:6, :6], dF[:6] = self.inertia, self.dF_o
        for i, own in enumerate(self.arms):
            joints, rows = _range(layout.dofs, i), _range(layout.rows, i)
            at = np.r_[6 + joints.start : 6 + joints.stop, size + rows.start : size + rows.stop]
            K[np.ix_(at, at)], K[at, :6] = own.matrix, own.of_object
            K[:6, size + rows.start : size + rows.stop] = -own.W_o
            dF[np.ix_(at, own.columns)] = own.dF
        states = 12 + 2 * layout.joints
        if along_joints:
            dF[:, :states] = dF[:, :states] @ self.motions.admissible()
        scale = np.concatenate([1.0 / np.sqrt(np.diag(K)[:size]), np.ones(layout.contacts)])
        lengths = np.linalg.norm(scale[:size, None] * K[:size, size:], axis=0)
        scale[size:] = 1.0 / np.where(lengths > 0.0, lengths, 1.0)
        u, singular, vt = np.linalg.svd(scale[:, None] * K * scale)
        rank = int(np.sum(singular > SYSTEM_TOLERANCE * singular[0]))
        right = u.T @ (scale[:, None] * dF)
        left = np.abs(right[rank:]).max(axis=0, initial=0.0)
        contradictory = left > CONSISTENT * np.abs(right).max()
        if "placements" in self.columns:
            placements = np.zeros(self.width, dtype=bool)
            placements[self.columns["placements"]] = True
            right[:, contradictory & placements] = np.nan
            contradictory &= ~placements
        if contradictory.any():
            raise SolverError(
                "derivatives: the rank of the constraints changes at this state, so that "
                "accelerations are not differentiable there; take a state beside it"
            )
        return -scale[:, None] * (vt[:rank].T @ (right[:rank] / singular[:rank, None]))

    def effect_state_rates(self) -> np.ndarray:
        """Derivatives of the rates of the states of effects, shape (e, columns)."""
        found = np.zeros((self.data.arrays.inner.size, self.width))
        if self._applied is not None:
            found[:, self._applied_columns] = self._applied[6 + self.layout.joints :]
        return found

    @cached_property
    def motions(self) -> Motions:
        """Inertia, and the derivatives of the gaps."""
        layout, size = self.layout, 6 + self.layout.joints
        codes = self.data.model.constants.codes
        inertia, closed = np.zeros((size, size)), codes[:, KIND] != TANGENT
        rates, by_position = np.zeros((2, layout.contacts, size))
        inertia[:6, :6] = self.inertia
        for i, own in enumerate(self.arms):
            joints, rows, n = _range(layout.dofs, i), _range(layout.rows, i), own.dof
            at = slice(6 + joints.start, 6 + joints.stop)
            inertia[at, at] = own.matrix[:n, :n]
            rates[rows, :6], rates[rows, at] = own.W_o.T, own.matrix[n:, :n]
            by_position[rows, :6], by_position[rows, at] = (
                own.rates[:, :6],
                own.rates[:, 12 : 12 + n],
            )
        return Motions(inertia, rates[closed], rates, by_position)

    def _object_equation(self) -> np.ndarray:
        """Derivatives of ``M_o a_o - h_o``; those of the contacts' wrenches come from the arms."""
        found, I = np.zeros((6, self.width)), self.inertia[3:, 3:]  # noqa: E741
        omega, alpha = skew(self.state.object_twist[3:]), self.body[-3:]
        found[3:, 3:6] = I @ skew(alpha) - skew(I @ alpha)  # the inertia turns with the object
        if self._applied is None:  # h_o is the weight and -omega x I omega
            gyroscopic = I @ omega - skew(I @ self.state.object_twist[3:])
            found[3:, 3:6] += omega @ gyroscopic
            found[3:, 9:12] = omega @ I - skew(I @ self.state.object_twist[3:])
        else:
            found[:, self._applied_columns] -= self._applied[:6]
        if "object_wrench" in self.columns:
            found[:, self.columns["object_wrench"]] = -np.eye(6)
            falling = self.body[-6:-3] - self.data.model.constants.gravity
            found[:3, self.columns["object_mass"].start] = falling
            R, first = self.body[:9].reshape(3, 3), self.columns["object_inertia"].start
            for k, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True)):
                unit = np.zeros((3, 3))
                unit[i, j] = unit[j, i] = 1.0
                unit = R @ unit @ R.T
                spin = self.state.object_twist[3:]
                found[3:, first + k] = unit @ self.body[-3:] + np.cross(spin, unit @ spin)
        return found

    def _arm(self, i: int) -> _ArmEquations:
        """Equations of one arm; its wrench is taken from the object's equation."""
        layout, joints = self.layout, _range(self.layout.dofs, i)
        n, m = joints.stop - joints.start, layout.rows[i + 1] - layout.rows[i]
        at = self.state.position[7:][joints], self.state.velocity[6:][joints], self.qdd[joints]
        arm = self._arm_derivatives(layout.names[i]) if i < len(layout.names) else None
        link, tables = GROUND, np.zeros((0, 6))  # the surroundings are an arm without joints
        if arm is not None:
            link, tables = arm.link_motion(*at)
        placed = arm is not None and "placements" in self.columns
        width = 18 + 3 * n + 6 * placed
        gaps, rates = np.zeros((2, m, width))
        on_object, on_link = np.zeros((2, width + 1, 6))
        status = differentiate_joint(
            self.data.struct, i, self.body, link, tables, self.force, self._scratch, self._rows,
            self._parts, self._slopes, self._wrench, gaps, rates, on_object, on_link,
        )  # fmt: skip
        if status != OK:
            self.data.reraise()
        W = gaps[:, 18 + 2 * n : 18 + 3 * n].T
        self._add_joint_rows(i, W, rates[:, 18 + n : 18 + 2 * n])
        by_q, by_v, M = np.zeros((3, n, n))
        if arm is not None:
            angles, speeds, qdd = at
            if self._applied is not None:  # the bias is among the forces
                speeds = np.zeros(n)
            by_q, by_v, M = arm.inverse_dynamics(angles, speeds, qdd, on_link[-1])
        # by pose and twist of the object, q, v and torques of the arm, placement of its contacts
        of_q, of_v, of_torque = (slice(12 + k * n, 12 + (k + 1) * n) for k in range(3))
        dF, on_link = np.zeros((n + m, 12 + 3 * n + 6 * placed)), on_link @ tables[3 * n :].T
        dF[:n, :6] = -on_link[:6].T
        dF[:n, of_q] = by_q - on_link[18 : 18 + n].T
        dF[:n, of_torque] = -np.eye(n)
        dF[n:, :12], dF[n:, 12 : of_v.stop] = gaps[:, :12], gaps[:, 18 : 18 + 2 * n]
        columns = np.arange(12 + 3 * n)
        columns[12:] += np.repeat(np.arange(3) * (layout.joints - n) + joints.start, n)
        if placed:
            first = self.columns["placements"].start + 6 * i
            columns = np.r_[columns, first : first + 6]
            dF[:n, of_torque.stop :] = -on_link[18 + 3 * n : -1].T
            dF[n:, of_torque.stop :] = gaps[:, 18 + 3 * n :]
            self.dF_o[:, first : first + 6] -= on_object[18 + 3 * n : -1].T
        if self._applied is None:
            dF[:n, of_v] = by_v
        else:
            whole = np.zeros((n + m, self.width))
            whole[:, columns] = dF
            whole[:n, self._applied_columns] -= self._applied[6:][joints]
            columns, dF = np.arange(self.width), whole
        self.dF_o[:, :6] -= on_object[:6].T
        self.dF_o[:, 12 + joints.start : 12 + joints.stop] -= on_object[18 : 18 + n].T
        K, of_object = np.zeros((n + m, n + m)), np.zeros((n + m, 6))
        K[:n, :n], K[:n, n:], K[n:, :n], of_object[n:] = M, -W, W.T, gaps[:, 12:18]
        by_state = np.hstack([rates[:, :12], rates[:, 18 : 18 + 2 * n]])
        return _ArmEquations(n, columns, K, of_object, dF, by_state)

    def _arm_derivatives(self, name: str) -> ArmDerivatives:
        """Those of an arm, kept with the data; without gravity where that is among the forces."""
        key = ("derivatives", name, tuple(self.gravity.tolist()))
        if key not in self.data.cache:
            arm = self.data.model.arms[name]
            self.data.cache[key] = ArmDerivatives(arm, self.gravity)
        return self.data.cache[key]

    def _add_joint_rows(self, i: int, W: np.ndarray, rates_by_v: np.ndarray) -> None:
        """Columns of ``W`` that belong to joints of the arm, and the rates of their gaps."""
        layout, constants = self.layout, self.data.model.constants
        for arm, row, joint in constants.joint_rows:
            if arm == i:
                k, j = row - layout.rows[i], joint - layout.dofs[i]
                W[j, k] = rates_by_v[k, j] = constants.geometry[row, SIDE]

    @property
    def _applied_columns(self) -> np.ndarray:
        """Columns of the differences: positions, velocities and states of effects."""
        states = self.columns["effect_states"]
        return np.r_[: self.columns["torques"].start, states]

    def _forces_by_differences(self, closed_loop: bool) -> np.ndarray:
        """Derivatives of ``h_o``, ``h`` and the rates of effects' states, by all but torques."""
        n, e = self.layout.joints, self.data.arrays.inner.size
        found = np.zeros((12 + 2 * n + e, 6 + n + e))
        if differentiate_forces(self.data.struct, closed_loop, found) != OK:
            self.data.reraise()
        return found.T


def _range(bounds: tuple[int, ...], i: int) -> slice:
    return slice(bounds[i], bounds[i + 1])
