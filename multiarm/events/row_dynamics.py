r"""Response of the rows of a mode to forces at one instant.

With some rows held, and no force on the others, a unit force on row k gives row j the rate
:math:`D_{jk}` (the Delassus operator :math:`J M^{-1} J^T`); the node algorithm supplies a column at
a time.  Forces ``x`` and accelerations ``y``, or impulses and velocities, are then related by

.. math:: y = D x + b .
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.contact_geometry import block_inertias, force_directions
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import (
    evaluate_state,
    solve_frictionless,
    update_kinematics,
    update_rows,
)
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.solver.bounds import DEPENDENT, HELD_RESPONSE, MOVABLE
from multiarm.events.complementarity.problem import RANK
from multiarm.events.modes import Modes

# Rates below this, relative to 1 and to the fastest coordinate, are rest [m/s, rad/s].
REST_RATE = 1e-9


class RowDynamics:
    """Rates and responses of all rows at the state in the data."""

    def __init__(self, modes: Modes) -> None:
        self.bilateral, self.full = modes.bilateral, modes.full

    def update(self) -> None:
        """Kinematics of all rows."""
        require_ok(self.bilateral, update_kinematics(self.bilateral.struct))
        require_ok(self.full, update_rows(self.full.struct))

    @property
    def gaps(self) -> np.ndarray:
        """All gaps [m, rad]."""
        return self.full.contact_rows.gap

    @property
    def rates(self) -> np.ndarray:
        """Rates of all gaps [m/s, rad/s]."""
        return self.full.contact_rows.gap_rate

    @property
    def rest_rate(self) -> float:
        """Rates below this are rest [m/s, rad/s]."""
        arrays = self.full.arrays
        fastest = np.max(np.abs(arrays.state.velocity))
        return REST_RATE * (1.0 + float(fastest))

    def jacobian(self, rows: list[int]) -> np.ndarray:
        """Rows of ``[W_o^T, W^T]``, shape (len(rows), 6 F + n)."""
        return force_directions(self.full)[:, rows].T.copy()

    def response(self, jacobian: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """``D`` with the rows of ``data`` held, and the motion due to each unit force, by columns.

        Rows that the held ones keep from moving have no response.
        """
        motions = [_motion_due_to(data, row) for row in jacobian]
        moved = np.array(motions).T.reshape(jacobian.shape[1], jacobian.shape[0])
        response = jacobian @ moved
        response = 0.5 * (response + response.T)
        # what the held rows leave of the mobility is rounding
        fixed = np.diag(response) <= HELD_RESPONSE * self.mobility(jacobian)
        response[fixed] = response[:, fixed] = 0.0
        return response, moved

    def mobility(self, jacobian: np.ndarray) -> np.ndarray:
        """Rate of each row due to a unit force on it without held rows, shape (len(jacobian),)."""
        full = self.full
        bodies = [full.arrays.bodies.object_inertia, *block_inertias(full)]
        total, first = np.zeros(len(jacobian)), 0
        for inertia in bodies:
            columns = jacobian[:, first : first + len(inertia)].T
            total += np.sum(columns * np.linalg.solve(inertia, columns), axis=0)
            first += len(inertia)
        return total

    def free_accelerations(self, rows: list[int], data: Data) -> np.ndarray:
        """Accelerations of gaps with the rows of ``data`` held, and no force on the other rows."""
        require_ok(data, evaluate_state(data.struct, 0.0, 0.0))
        require_ok(self.full, update_rows(self.full.struct))
        bias = self.full.contact_rows.gap_bias[rows]
        return self.jacobian(rows) @ data.arrays.accelerations.a + bias


def can_move(response: np.ndarray, along: np.ndarray, held: list[int]) -> bool:
    """Whether the combination ``along`` of rows can move while other rows are held."""
    moved = response @ along
    alone, across = along @ moved, moved[held]
    through = across @ np.linalg.lstsq(response[np.ix_(held, held)], across, rcond=RANK)[0]
    return bool(alone - through > MOVABLE * alone)


def depends_on_held_rows(response: np.ndarray, jacobian: np.ndarray) -> bool:
    """Whether some forces of the rows move nothing only because held rows resist them."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(response), np.finfo(float).tiny))
    fixed = np.diag(response) <= DEPENDENT**2 * np.max(np.diag(response), initial=0.0)
    if np.any(fixed):
        return True
    values, vectors = np.linalg.eigh(scale[:, None] * response * scale)
    idle = scale[:, None] * vectors[:, values < DEPENDENT * values[-1]]
    left = np.abs(jacobian.T @ idle)
    reach = np.abs(jacobian.T) @ np.abs(idle)
    return bool(np.any(left > DEPENDENT * np.max(reach, initial=0.0)))


def _motion_due_to(data: Data, force: np.ndarray) -> np.ndarray:
    """Accelerations (velocities) of objects and joints by forces (impulses), (6 F + n,)."""
    b = data.arrays
    require_ok(data, update_kinematics(data.struct))
    b.forces.f[:], b.rows.c[:] = force, 0.0
    require_ok(data, solve_frictionless(data.struct, 0.0))
    return b.accelerations.a.copy()
