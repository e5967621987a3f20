r"""Impacts without restitution: velocities that rows of W stop, and the impulses that do it.

Of all velocities with :math:`W^T v^+ = 0` those nearest to v in the metric of the inertia,

.. math:: v^+ = v + M^{-1} W p, \qquad W^T v^+ = 0 .

With :math:`M = L L^T`, :math:`A = W^T L^{-T} = U S V^T` and :math:`w = L^T v`, of rank r,

.. math:: w^+ = w - V_r V_r^T w, \qquad p = -U_r S_r^{-1} V_r^T w, \qquad
    \tfrac12 |w|^2 - \tfrac12 |w^+|^2 = \tfrac12 |V_r^T w|^2 .

Velocities are divided by no singular value: dependent rows and singular postures need no special
treatment there.  The impulses are those of least norm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Singular values below this part of the largest are rounding.
RANK = 1e-10


class Impact(NamedTuple):
    """An impact of n velocities against m rows."""

    change: np.ndarray  # (n,) of the velocities
    impulses: np.ndarray  # (m,) [N s, N m s]
    energy_lost: float  # [J]


def inelastic_impact(rows: np.ndarray, factor: np.ndarray, velocity: np.ndarray) -> Impact:
    """The impact that stops the rates of some rows.

    Parameters
    ----------
    rows : ndarray, shape (m, n)
        ``W^T``.
    factor : ndarray, shape (n, n)
        Lower triangular ``L`` with ``L L^T`` the inertia.
    velocity : ndarray, shape (n,)
    """
    A = np.linalg.solve(factor, rows.T).T
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    kept = s > RANK * s[0] if s.size else s > 0.0
    taken = Vt[kept] @ (factor.T @ velocity)
    change = -np.linalg.solve(factor.T, Vt[kept].T @ taken)
    return Impact(change, -U[:, kept] @ (taken / s[kept]), 0.5 * float(taken @ taken))
