r"""How the rows of a mode answer to forces at one instant.

With the rows of a system held, and no force on the others, a unit force on row k gives row j the
rate :math:`D_{jk}`; the node algorithm supplies a column at a time.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.kernel import GAP_BIAS, GAP_RATE
from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.equations import (
    evaluate_state,
    solve_constrained,
    update_kinematics,
    update_rows,
)
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.model import Data
from multiarm.errors import SolverError
from multiarm.events.complementarity import Bounded, ContactLaw, Friction, Push, Sliding
from multiarm.events.modes import Modes
from multiarm.spatial import retract

# Rates below this are rest [m/s, rad/s], times one plus the largest velocity.
REST_RATE = 1e-9
# A row that others are held beside is free when this part of its response is left.
FREE = 1e-6
# A row is held fast when this part is left of its response to a force with nothing held: roundings
# of what the others take away.
HELD_FAST = 1e-12
# Rows whose scaled response has smaller eigenvalues depend on each other or on others.
DEPENDENT = 1e-7


class Instant:
    """A system whose contacts come and go at the state in its arrays.

    Parameters
    ----------
    modes : Modes
    ahead : float
        Accelerations are those so much later [s].
    """

    def __init__(self, modes: Modes, ahead: float):
        self._modes, self._constraints, self._ahead = modes, modes.unilateral.constraints, ahead
        self._bare, self._full = modes.bare, modes.full
        self._residual = 0.0

    def _update(self) -> None:
        """Kinematics of all rows at the state in the data."""
        _require(update_kinematics(self._bare.struct), self._bare)
        update_rows(self._full.struct)

    def _rates(self) -> np.ndarray:
        return self._full.arrays.contacts[:, GAP_RATE]

    def _rest_rate(self) -> float:
        arrays = self._full.arrays
        fastest = max(np.max(np.abs(arrays.twist)), np.max(np.abs(arrays.v), initial=0.0))
        return REST_RATE * (1.0 + float(fastest))

    def _matrix(self, rows: list[int]) -> np.ndarray:
        """Rows of ``[W_o^T, W^T]``, shape (len(rows), 6 + n)."""
        full = self._full
        layout, matrix = full.model.layout, np.zeros((len(rows), 6 + full.model.layout.joints))
        for k, row in enumerate(rows):
            i = int(np.searchsorted(layout.rows, row, side="right")) - 1
            matrix[k, :6] = full.arrays.Wo[row]
            d0, d1 = layout.dofs[i], layout.dofs[i + 1]
            matrix[k, 6 + d0 : 6 + d1] = full.work.Y[i, : d1 - d0, row - layout.rows[i]]
        return matrix

    def _response(self, matrix: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """``D`` and what each unit force does, one a column, with the rows of ``data`` held.

        Rows that these hold fast have no response.
        """
        motions = [_answer(data, row) for row in matrix]
        moved = np.array(motions).T.reshape(matrix.shape[1], matrix.shape[0])
        response = matrix @ moved
        response = 0.5 * (response + response.T)
        fast = np.diag(response) <= HELD_FAST * self._mobility(matrix)
        response[fast] = response[:, fast] = 0.0
        return response, moved

    def _mobility(self, matrix: np.ndarray) -> np.ndarray:
        """Rates of rows to a unit force on each, with nothing held, shape (len(matrix),)."""
        full = self._full
        bodies = [full.arrays.inertia]
        for i, name in enumerate(full.model.arm_names):
            bodies.append(read_inertia(full.arrays.pointers[i], full.model.arms[name].dof))
        total, first = np.zeros(len(matrix)), 0
        for inertia in bodies:
            own = matrix[:, first : first + len(inertia)].T
            total += np.sum(own * np.linalg.solve(inertia, own), axis=0)
            first += len(inertia)
        return total

    def _free_accelerations(self, rows: list[int], data: Data) -> np.ndarray:
        """Accelerations of gaps with the rows of ``data`` held, and no force on others."""
        b, delay = data.arrays, self._ahead
        kept = b.time.now, b.position.copy(), b.angles.copy()
        if delay > 0.0:
            b.time.now += delay
            b.position[:3] += delay * b.twist[:3]
            b.position[3:] = retract(b.position[3:], delay * b.twist[3:])
            b.angles[:] += delay * b.v
        _require(evaluate_state(data.struct, 0.0, 0.0), data)
        motion = np.concatenate([b.q_o, b.qdd])
        update_rows(self._full.struct)
        free = self._matrix(rows) @ motion + self._full.arrays.contacts[rows, GAP_BIAS]
        if delay > 0.0:
            b.time.now, b.position[:], b.angles[:] = kept
            self._update()
        return free


def law_of(constraint: Constraint, at: dict[int, int], slip: np.ndarray | None) -> ContactLaw:
    """The law of a constraint in the rows of a problem; ``at`` says where its rows are there."""
    if constraint.kind == DRY_JOINT:
        return Bounded(at[constraint.row], -constraint.bound, constraint.bound)
    if not constraint.tangents:
        return Push(at[constraint.row])
    first, second = (at[t] for t in constraint.tangents)
    if slip is None:
        return Friction(at[constraint.row], (first, second), constraint.mu)
    return Sliding(
        at[constraint.row], (first, second), constraint.mu, (float(slip[0]), float(slip[1]))
    )


def is_free(response: np.ndarray, row: int, held: list[int]) -> bool:
    """Whether a row can move while others are held."""
    return _gives_way(response, np.eye(len(response))[row], held)


def can_slip(
    response: np.ndarray, tangents: list[int], direction: np.ndarray, held: list[int]
) -> bool:
    """Whether a contact can slip in a direction while rows are held."""
    along = np.zeros(len(response))
    along[tangents] = direction
    return _gives_way(response, along, held)


def _gives_way(response: np.ndarray, along: np.ndarray, held: list[int]) -> bool:
    """Whether the combination ``along`` of rows can move while others are held."""
    moved = response @ along
    own, across = along @ moved, moved[held]
    through = across @ np.linalg.lstsq(response[np.ix_(held, held)], across, rcond=1e-10)[0]
    return bool(own - through > FREE * own)


def leans_on_others(response: np.ndarray, matrix: np.ndarray) -> bool:
    """Whether some forces of the rows move nothing only because other rows hold against them."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(response), np.finfo(float).tiny))
    held_fast = np.diag(response) <= DEPENDENT**2 * np.max(np.diag(response), initial=0.0)
    if np.any(held_fast):
        return True
    values, vectors = np.linalg.eigh(scale[:, None] * response * scale)
    idle = scale[:, None] * vectors[:, values < DEPENDENT * values[-1]]
    left = np.abs(matrix.T @ idle)
    reach = np.abs(matrix.T) @ np.abs(idle)
    return bool(np.any(left > DEPENDENT * np.max(reach, initial=0.0)))


def _answer(data: Data, push: np.ndarray) -> np.ndarray:
    """Accelerations (velocities) of object and joints to forces (impulses), (6 + n,)."""
    b = data.arrays
    _require(update_kinematics(data.struct), data)
    b.h_o[:], b.h[:], b.c[:] = push[:6], push[6:], 0.0
    _require(solve_constrained(data.struct), data)
    return np.concatenate([b.q_o, b.qdd])


def _require(status: int, data: Data) -> None:
    if status != OK:
        data.reraise()
        raise SolverError(f"the motion at an event could not be evaluated (status {status})")
