r"""Radau collocation of linear differential equations: three stages, order 5.

Over a panel from t to t + h, a solution of :math:`\dot\delta = A(t)\,\delta + b(t)` is replaced by
the polynomial of degree 3 that obeys the equation at the nodes :math:`t + c_i h`:

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

import math

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

_R = math.sqrt(6.0)
NODES = np.array([(4.0 - _R) / 10.0, (4.0 + _R) / 10.0, 1.0])
WEIGHTS = np.array([16.0 - _R, 16.0 + _R, 4.0]) / 36.0
STAGES = np.array(
    [
        [(88.0 - 7.0 * _R) / 360.0, (296.0 - 169.0 * _R) / 1800.0, (-2.0 + 3.0 * _R) / 225.0],
        [(296.0 + 169.0 * _R) / 1800.0, (88.0 + 7.0 * _R) / 360.0, (-2.0 - 3.0 * _R) / 225.0],
        WEIGHTS,
    ]
)
ORDER = 5


class Collocation:
    """One panel.

    Parameters
    ----------
    A : ndarray, shape (3, D, D)
        At the nodes.
    length : float
        h
    """

    def __init__(self, A: np.ndarray, length: float) -> None:
        self._A, self._h, size = A, length, A.shape[1]
        blocks = np.eye(3)[:, :, None, None] * np.eye(size) - length * STAGES[:, :, None, None] * A
        stages = blocks.transpose(0, 2, 1, 3).reshape(3 * size, 3 * size)
        # of the transposed matrix, which is in LAPACK's order
        self._factors, self._pivots, _ = dgetrf(stages.T, overwrite_a=True)

    def forward(self, start: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solutions at the end, and at the nodes, from those at the start.

        Shapes (D, k), (3, D, k); ``b`` (3, D, k).
        """
        h, size = self._h, len(start)
        right = start + h * np.einsum("ij,jdk->idk", STAGES, b)
        stages, _ = dgetrs(self._factors, self._pivots, right.reshape(3 * size, -1), trans=1)
        stages = stages.reshape(3, size, -1)
        rates = self._A @ stages + b
        return start + h * np.einsum("i,idk->dk", WEIGHTS, rates), stages

    def backward(self, end: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The transposed map.

        Parameters
        ----------
        end : ndarray, shape (D,)
            ``mu_1``
        slopes : ndarray, shape (3, D)
            Those of an integrand at the nodes.

        Returns
        -------
        start : ndarray, shape (D,)
            ``mu_0``
        stages : ndarray, shape (3, D)
            ``Lambda``
        """
        right = self._h * WEIGHTS[:, None] * (np.einsum("ide,d->ie", self._A, end) + slopes)
        y = dgetrs(self._factors, self._pivots, right.ravel())[0].reshape(right.shape)
        return end + y.sum(axis=0), end + (STAGES.T @ y) / WEIGHTS[:, None]
