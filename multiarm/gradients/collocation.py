r"""Radau collocation of linear differential equations: five stages, order 9.

Over a panel from t to t + h, a solution of :math:`\dot\delta = A(t)\,\delta + b(t)` is replaced by
the polynomial of degree 5 that obeys the equation at the nodes :math:`t + c_i h`:

.. math::
    \Delta_i = \delta_0 + h \sum_j a_{ij} (A_j \Delta_j + b_j), \qquad
    \delta_1 = \delta_0 + h \sum_i w_i (A_i \Delta_i + b_i)

(E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, IV.5).  With the matrix
:math:`N = I - h\,[a_{ij} A_j]` of all stages, the transposed map, which gradients follow backward,
is

.. math::
    y = N^{-T}\, [h w_i A_i^T \mu_1]_i, \qquad \mu_0 = \mu_1 + \sum_i y_i, \qquad
    \Lambda_i = \mu_1 + \tfrac{1}{w_i} \sum_j a_{ji}\, y_j ,

and :math:`\mu_1^T\delta_1 = \mu_0^T\delta_0 + h \sum_i w_i \Lambda_i^T b_i` to rounding.
With an integrand of slopes :math:`g_i`, :math:`y = N^{-T}[h w_i (A_i^T \mu_1 + g_i)]_i`.  The
method (Radau IIA) is L-stable: motions that strong damping makes fast ask for short panels only as
long as they last.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legroots
from scipy.linalg.lapack import dgetrf, dgetrs

COUNT = 5


def _radau(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and stages of Radau IIA: collocation at the roots of ``P_n - P_(n-1)`` on (0, 1]."""
    polynomial = np.zeros(count + 1)
    polynomial[-2:] = -1.0, 1.0
    nodes = 0.5 * (1.0 + np.sort(legroots(polynomial)))
    nodes[-1] = 1.0
    powers = np.arange(count)
    values, integrals = nodes[:, None] ** powers, nodes[:, None] ** (powers + 1) / (powers + 1)
    return nodes, np.linalg.solve(values.T, integrals.T).T


NODES, STAGES = _radau(COUNT)
WEIGHTS = STAGES[-1]


class Collocation:
    """One panel.

    Parameters
    ----------
    A : ndarray, shape (s, D, D)
        At the nodes.
    length : float
        h
    """

    def __init__(self, A: np.ndarray, length: float) -> None:
        self._A, self._h, size = A, length, A.shape[1]
        blocks = (
            np.eye(COUNT)[:, :, None, None] * np.eye(size) - length * STAGES[:, :, None, None] * A
        )
        stages = blocks.transpose(0, 2, 1, 3).reshape(COUNT * size, COUNT * size)
        # of the transposed matrix, which is in LAPACK's order
        self._factors, self._pivots, _ = dgetrf(stages.T, overwrite_a=True)

    def forward(self, start: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solutions at the end, and at the nodes, from those at the start.

        Shapes (D, k), (s, D, k); ``b`` (s, D, k).
        """
        h, size = self._h, len(start)
        right = start + h * np.einsum("ij,jdk->idk", STAGES, b)
        stages, _ = dgetrs(self._factors, self._pivots, right.reshape(COUNT * size, -1), trans=1)
        stages = stages.reshape(COUNT, size, -1)
        rates = self._A @ stages + b
        return start + h * np.einsum("i,idk->dk", WEIGHTS, rates), stages

    def backward(self, end: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The transposed map.

        Parameters
        ----------
        end : ndarray, shape (D,)
            ``mu_1``
        slopes : ndarray, shape (s, D)
            Those of an integrand at the nodes.

        Returns
        -------
        start : ndarray, shape (D,)
            ``mu_0``
        stages : ndarray, shape (s, D)
            ``Lambda``
        """
        right = self._h * WEIGHTS[:, None] * (np.einsum("ide,d->ie", self._A, end) + slopes)
        y = dgetrs(self._factors, self._pivots, right.ravel())[0].reshape(right.shape)
        return end + y.sum(axis=0), end + (STAGES.T @ y) / WEIGHTS[:, None]
