r"""Impacts without restitution: velocities that rows of W stop, and the impulses that do it.

Of all velocities with :math:`W^T v^+ = 0` those nearest to v in the metric of the inertia,

.. math:: v^+ = v + M^{-1} W p, \qquad W^T v^+ = 0 .

With :math:`M = L L^T`, :math:`L^{-1} W = V S U^T` and :math:`w = L^T v`, of rank r,

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
    inverse = np.linalg.inv(factor)
    V, s, Ut = np.linalg.svd(inverse @ rows.T, full_matrices=False)
    rank = np.count_nonzero(s > RANK * s[0]) if s.size else 0
    V, s, Ut = V[:, :rank], s[:rank], Ut[:rank]
    taken = V.T @ (factor.T @ velocity)
    change = -(V @ taken) @ inverse
    return Impact(change, -(taken / s) @ Ut, 0.5 * float(taken @ taken))
