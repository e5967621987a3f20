r"""Minimal coordinates of the motions that the joints allow, near one state.

Displacements :math:`u = (\delta x, \theta, \delta q)` and changes of the velocities
:math:`\delta\nu` that keep the gaps and their rates closed satisfy, to first order,

.. math:: G u = 0, \qquad W^T \delta\nu + \dot G\, u = 0,

with the rows :math:`W^T` of all contacts, and G those of them that have a gap: rows that roll
constrain velocities only.  Coordinates are components of the displacement and of the velocities
themselves, chosen by matrices S of zeros and ones, so that they have names and units:

.. math:: \eta = S_p u, \quad \zeta = S_v\, \delta\nu, \qquad
    u = E_p \eta, \quad \delta\nu = E_v \zeta + K \eta,

with :math:`E = N (S N)^{-1}` from a basis N of the null space of G or :math:`W^T`, and K from any
solution of :math:`W^T K_0 = -\dot G E_p`, less its own part in :math:`\zeta`:
:math:`K = K_0 - E_v S_v K_0`.

*The choice.*  A QR decomposition with column pivoting picks the rows of N one after the other, each
the one that is most independent of those before it.  Rows are weighted by the square root of their
inertia, those of objects ten times more, so that their coordinates are preferred to joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from multiarm.dynamics.sensitivity import Motions
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE
from multiarm.dynamics.solver.dense import null_space, reciprocal_lengths

# Weight of objects' coordinates against joints.
PREFERENCE = 10.0


@dataclass(frozen=True)
class Coordinates:
    """Minimal coordinates near a state, see :mod:`multiarm.linear.coordinates`.

    Attributes
    ----------
    positions, velocities : tuple of int
        Which components of the displacement and of the velocities they are, p and m of ``6 F + n``.
    displacement : ndarray, shape (6 F + n, p)
        ``E_p``.
    velocity : ndarray, shape (6 F + n, m)
        ``E_v``.
    turning : ndarray, shape (6 F + n, p)
        ``K``: what displacements change of the velocities; zero at rest.
    """

    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    displacement: np.ndarray
    velocity: np.ndarray
    turning: np.ndarray


def minimal_coordinates(motions: Motions) -> Coordinates:
    """Choose coordinates of the motions that keep the joints closed."""
    L = np.linalg.cholesky(motions.inertia)
    free = _free(motions.rates, L)
    weight = np.linalg.norm(L, axis=1)  # the square root of the inertia's diagonal
    weight[motions.layout.of_frames] *= PREFERENCE
    velocities = _most_independent(free, weight)
    moving = _free(motions.gaps, L)
    # rows that roll leave more displacements than velocities
    further = moving @ null_space(moving[velocities]).basis if velocities else moving
    positions = velocities + _most_independent(further, weight)
    E_p = moving @ np.linalg.inv(moving[positions])
    E_v = free @ np.linalg.inv(free[velocities])
    K = _solved(motions.rates, -motions.rates_by_position @ E_p, L)
    K -= E_v @ K[velocities]
    return Coordinates(tuple(positions), tuple(velocities), E_p, E_v, K)


def _free(rows: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Basis of the velocities that rows leave free, orthonormal in the metric of the inertia."""
    if not rows.size:
        return np.linalg.inv(L).T
    _, scaled = _scaled(rows, L)
    return np.linalg.solve(L.T, null_space(scaled, COUPLED_RANK_TOLERANCE).basis)


def _scaled(rows: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of rows that give them length 1 in the metric of the inertia, and these rows."""
    scaled = np.linalg.solve(L, rows.T).T
    scale = reciprocal_lengths(np.linalg.norm(scaled, axis=1))[:, None]
    return scale, scale * scaled


def _solved(rows: np.ndarray, right: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Velocities of least kinetic energy with ``rows @ velocities = right``."""
    if not rows.size:
        return np.zeros((len(L), right.shape[1]))
    scale, scaled = _scaled(rows, L)
    least = np.linalg.lstsq(scaled, scale * right, rcond=COUPLED_RANK_TOLERANCE)[0]
    return np.linalg.solve(L.T, least)


def _most_independent(basis: np.ndarray, weight: np.ndarray) -> list[int]:
    """Places of the most independent weighted rows of a basis, one a column, in order."""
    if not basis.shape[1]:
        return []
    order = qr((weight[:, None] * basis).T, mode="r", pivoting=True)[1]
    return sorted(order[: basis.shape[1]].tolist())
