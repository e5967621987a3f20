r"""Gauss collocation of linear differential equations: three stages, order 6.

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

and :math:`\mu_1^T\delta_1 = \mu_0^T\delta_0 + h \sum_i w_i \Lambda_i^T b_i` to rounding.  The method
is A-stable, so that motions which strong damping makes fast do not ask for short panels.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lu_factor, lu_solve

_R = math.sqrt(15.0)
NODES = np.array([0.5 - _R / 10.0, 0.5, 0.5 + _R / 10.0])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
STAGES = np.array(
    [
        [5.0 / 36.0, 2.0 / 9.0 - _R / 15.0, 5.0 / 36.0 - _R / 30.0],
        [5.0 / 36.0 + _R / 24.0, 2.0 / 9.0, 5.0 / 36.0 - _R / 24.0],
        [5.0 / 36.0 + _R / 30.0, 2.0 / 9.0 + _R / 15.0, 5.0 / 36.0],
    ]
)
ORDER = 6


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
        self._factors = lu_factor(stages, overwrite_a=True, check_finite=False)

    def forward(self, start: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Solutions at the end from those at the start, shapes (D, k); ``b`` (3, D, k)."""
        h, size = self._h, len(start)
        right = start + h * np.einsum("ij,jdk->idk", STAGES, b)
        stages = lu_solve(self._factors, right.reshape(3 * size, -1), check_finite=False)
        rates = self._A @ stages.reshape(3, size, -1) + b
        return start + h * np.einsum("i,idk->dk", WEIGHTS, rates)

    def backward(
        self, end: np.ndarray, slopes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The transposed map.

        Parameters
        ----------
        end : ndarray, shape (D, k)
            ``mu_1``
        slopes : ndarray, shape (3, D), optional
            Those of an integrand at the nodes, for the first column.

        Returns
        -------
        start : ndarray, shape (D, k)
            ``mu_0``
        stages : ndarray, shape (3, D, k)
            ``Lambda``
        """
        right = np.einsum("ide,dk->iek", self._A, end)
        if slopes is not None:
            right[:, :, 0] += slopes
        right *= self._h * WEIGHTS[:, None, None]
        size, columns = end.shape
        y = lu_solve(self._factors, right.reshape(3 * size, -1), trans=1, check_finite=False)
        y = y.reshape(3, size, columns)
        stages = end + np.einsum("ji,jdk->idk", STAGES, y) / WEIGHTS[:, None, None]
        return end + y.sum(axis=0), stages
