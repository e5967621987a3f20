r"""Closing the rates of the gaps with the least kinetic energy.

With :math:`M = L L^T` and :math:`A = W^T L^{-T}` the velocities :math:`w = L^T v` are projected on
the null space of ``A``, from its singular value decomposition:

.. math:: w^+ = w - V_r V_r^T w, \qquad
    \tfrac12 |w|^2 - \tfrac12 |w^+|^2 = \tfrac12 |V_r^T w|^2 .

Nothing is divided by a singular value, so that dependent rows and singular arms do no harm.
"""

from __future__ import annotations

import numpy as np

from multiarm.assembly.linkage import Linkage
from multiarm.contacts.kernel import GAP_RATE
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.diagnosis import failure_text
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.integration.projection import project_velocities

# Singular values of A below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-10
# Rates that are such a fraction of the terms that cancel in them are closed.
ROUNDING = 100 * np.finfo(float).eps
_PASSES = 3


def close_rates(data: Data, size: float | None = None) -> float:
    """Project the velocities in the data on the constraints; kinematics are fresh.

    Velocities whose gap rates are roundings are not touched.

    Parameters
    ----------
    data : Data
    size : float, optional
        The scene's, where it is known already [m].

    Returns
    -------
    energy_lost : float
        Kinetic energy that the velocities had more [J].

    Raises
    ------
    SolverError
        When the inertia of an arm is not positive definite.
    """
    b, joints = data.arrays, data.model.layout.joints
    free = np.full((joints, 2), [-np.inf, np.inf])
    linkage = Linkage(data, list(range(len(data.model.arm_names))), True, free, True, size)
    place, lost = linkage.here(), 0.0
    v = np.concatenate([b.twist, b.v]) / linkage.unit
    closed = ROUNDING * float(np.max(np.abs(place.rows) @ np.abs(v), initial=0.0))
    for _ in range(_PASSES):
        if not np.max(np.abs(b.contacts[:, GAP_RATE]), initial=0.0) > closed:
            break
        A = np.linalg.solve(place.factor, place.rows.T).T  # (N, 6 + n)
        _, s, Vt = np.linalg.svd(A, full_matrices=False)
        Vt = Vt[s > RANK_TOLERANCE * s[0]]
        taken = Vt @ (place.factor.T @ v)
        v -= np.linalg.solve(place.factor.T, Vt.T @ taken)
        lost += 0.5 * float(taken @ taken)
        b.twist[:], b.v[:] = np.split(linkage.unit * v, [6])
        if update_kinematics(data.struct) != OK:
            data.reraise()
    return lost


def project_velocity(system: System, state: State) -> State:
    """Project the velocities of a state on the constraints, in the inertia metric (thesis, 4.2).

    The correction is the one that loses the least kinetic energy: an inelastic impact that closes
    all gap rates.  Positions stay.
    """
    with system.borrow() as data:
        place_state(data, 0.0, state)
        status = update_kinematics(data.struct)
        if status == OK:
            status = project_velocities(data.struct)
        if status != OK:
            data.reraise()
            raise SolverError(failure_text(data, status))
        return data.get_state()
