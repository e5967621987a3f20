r"""The shortest vector that satisfies inequalities, or the proof that none does.

.. math::
    \min \tfrac12 |y|^2 \quad\text{with}\quad G y \ge h

is the least-distance problem of Lawson and Hanson (1974, chapter 23).  With
:math:`E = [G^T; h^T]` and f the last unit vector, non-negative least squares, min ``|E u - f|``
over ``u >= 0``, leave ``r = E u - f = [r_1; -s]`` over, and :math:`E^T r \ge 0` says

- for ``s > 0``: ``y = r_1 / s`` is the solution, with the prices ``u / s`` of the inequalities
  (``y = G^T prices``), and :math:`s = 1 / (1 + |y|^2)`;
- for ``s = 0``: ``G^T u = 0`` and ``h . u = 1``, so no y satisfies all inequalities.

An active-set method finds u in about as many steps as inequalities are tight, to the last digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.errors import GraspError

# Solutions longer than 1e6 (in the caller's units) count as none: s would be lost in rounding.
NONE = 1e-12


@dataclass(frozen=True, eq=False)
class LeastDistance:
    """Solution of a least-distance problem, or its refusal.

    Attributes
    ----------
    direction : ndarray, shape (k,)
        ``r_1``, along the solution.
    s : float
        Shrinks as the solution grows.
    weights : ndarray, shape (m,)
        ``u >= 0``.
    """

    direction: np.ndarray
    s: float
    weights: np.ndarray

    @property
    def solved(self) -> bool:
        """Whether there is a solution (shorter than 1e6)."""
        return self.s > NONE

    @property
    def point(self) -> np.ndarray:
        """The solution y, shape (k,)."""
        return self.direction / self.s

    @property
    def prices(self) -> np.ndarray:
        """How fast ``|y|^2 / 2`` grows with each ``h``, shape (m,); positive where it is tight."""
        return self.weights / self.s


def least_distance(G: np.ndarray, h: np.ndarray) -> LeastDistance:
    """Solve  min ``|y|``  with  ``G y >= h``; G has shape (m, k), h has shape (m,)."""
    from scipy.optimize import nnls

    E = np.vstack([G.T, h])
    target = np.append(np.zeros(G.shape[1]), 1.0)
    try:
        weights = nnls(E, target, maxiter=30 * max(E.shape))[0]
    except RuntimeError as error:
        raise GraspError(
            f"non-negative least squares over {len(h)} inequalities ran out of iterations; the "
            f"contacts may nearly coincide"
        ) from error
    left = E @ weights - target
    return LeastDistance(left[:-1], float(-left[-1]), weights)
