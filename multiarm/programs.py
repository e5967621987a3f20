r"""Linear programs with their prices, and the shortest vector that satisfies inequalities.

**The shortest vector that satisfies inequalities, or the proof that none does:**

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
from typing import Any

import numpy as np

# Rounding of a wrench or row, in machine precisions: normalising, products, differences.
ROUNDINGS = 64.0
EPS = float(np.finfo(float).eps)

LinearRows = tuple[np.ndarray, np.ndarray]
"""Rows and right-hand sides of inequalities or equations."""


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Outcome of a linear program.

    Attributes
    ----------
    x : ndarray, shape (n,), or None
        None where there is no optimum, or the solver gave up.
    value : float
        ``cost . x``; NaN without x.
    prices : ndarray, shape (m,)
        How fast the value falls with the right-hand side of each inequality; not negative.
    duals : ndarray, shape (k,)
        How fast the value grows with the right-hand side of each equation.
    infeasible, unbounded : bool
        Proven by the solver.  Neither, without x: nothing is concluded.
    message : str
        The solver's own.
    """

    x: np.ndarray | None
    value: float
    prices: np.ndarray
    duals: np.ndarray
    infeasible: bool
    unbounded: bool
    message: str


def linear_program(
    cost: np.ndarray,
    *,
    at_most: LinearRows | None = None,
    equal: LinearRows | None = None,
    bounds: Any = (0.0, None),
    signed: int = 0,
) -> LinearSolution:
    """Minimise ``cost . x`` with ``A x <= b``, ``C x = d`` and bounds, by SciPy's HiGHS.

    Parameters
    ----------
    cost : array-like, shape (n,)
    at_most, equal : (array (m, n), array (m,)), optional
        ``(A, b)`` and ``(C, d)``.
    bounds : pair, or sequence of pairs
        Of all variables, or of each but the last ``signed`` ones.
    signed : int
        So many variables at the end are free.
    """
    from scipy.optimize import linprog

    n = len(cost)
    limited = [bounds] * (n - signed) if np.ndim(bounds) == 1 else list(bounds)
    A, b = (None, None) if at_most is None else at_most
    C, d = (None, None) if equal is None else equal
    limits = [*limited, *[(None, None)] * signed]
    solved = linprog(cost, A_ub=A, b_ub=b, A_eq=C, b_eq=d, bounds=limits)
    return LinearSolution(
        x=solved.x if solved.success else None,
        value=float(solved.fun) if solved.success else np.nan,
        prices=-solved.ineqlin.marginals if solved.success else np.empty(0),
        duals=solved.eqlin.marginals if solved.success else np.empty(0),
        infeasible=solved.status == 2,
        unbounded=solved.status == 3,
        message=solved.message,
    )


# --- The shortest vector that satisfies inequalities ----------------------------------------------

# Solutions longer than 1e6 (in the caller's units) count as none: s would be lost in rounding.
NONE = 1e-12
# Gradients below this, relative to the data, are those of a minimum: between the rounding of an
# active-set method (1e-13) and where such a method stops on a wrong set (1e-4).
OPTIMAL = 1e-9


@dataclass(frozen=True, eq=False)
class LeastDistance:
    """Solution of a least-distance problem, or its refusal.

    Attributes
    ----------
    direction : ndarray, shape (k,)
        ``r_1``, along the solution.
    s : float
        Shrinks as the solution grows; 0 where rounding hides it.
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


def least_distance(G: np.ndarray, h: np.ndarray, room: float = 0.0) -> LeastDistance:
    """Solve  min ``|y|``  with  ``G y >= h``.

    Parameters
    ----------
    G : ndarray, shape (m, k)
    h : ndarray, shape (m,)
    room : float
        What counts as rounding of ``h`` and of a product with G.  Rounding would decide whether
        inequalities hold that leave no choice of y, or do not depend on it: all are relaxed by
        this.  Those that are tight then are solved as equations, without it.
    """
    E = np.vstack([G.T, h - room])
    target = np.append(np.zeros(G.shape[1]), 1.0)
    weights = nonnegative_least_squares(E, target)
    left = E @ weights - target
    terms = 1.0 + float(np.abs(E[-1]) @ weights)  # s is what is left of these
    s = float(-left[-1]) if -left[-1] > ROUNDINGS * EPS * terms else 0.0
    solution = LeastDistance(left[:-1], s, weights)
    return _sharpened(solution, G, h, room) if room > 0.0 and solution.solved else solution


def _sharpened(solution: LeastDistance, G: np.ndarray, h: np.ndarray, room: float) -> LeastDistance:
    """The solution for ``h`` itself; as found, if the other inequalities do not allow it."""
    tight, prices = solution.weights > 0.0, np.zeros(len(h))
    y = np.linalg.lstsq(G[tight], h[tight], rcond=None)[0]
    prices[tight] = np.maximum(np.linalg.lstsq(G[tight].T, y, rcond=None)[0], 0.0)
    if np.any(G @ y < h - room):
        return solution
    s = 1.0 / (1.0 + float(y @ y))
    return LeastDistance(s * y, s, s * prices)


def nonnegative_least_squares(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Minimise ``|A u - b|`` over ``u >= 0``, shape (m,); A has shape (n, m), b has shape (n,).

    SciPy's ``nnls`` stops short of the minimum when columns depend on one another, as those of
    symmetric contacts do, by roundings that change with the processor.  Its answer counts when the
    gradient shows it; otherwise a second method runs, and the better answer is taken.
    """
    from scipy.optimize import lsq_linear, nnls

    try:
        first = nnls(A, b, maxiter=30 * max(A.shape))[0]
        if _excess(A, b, first) <= OPTIMAL * np.linalg.norm(A) * np.linalg.norm(b):
            return first
    except RuntimeError:  # out of iterations
        first = np.zeros(A.shape[1])
    second = lsq_linear(A, b, bounds=(0.0, np.inf), method="bvls", tol=EPS).x
    return min(first, second, key=lambda u: _excess(A, b, u))


def _excess(A: np.ndarray, b: np.ndarray, u: np.ndarray) -> float:
    """The gradient that a minimum over ``u >= 0`` does not have: negative, or where ``u > 0``."""
    gradient = A.T @ (A @ u - b)
    return float(np.max(np.where(u > 0.0, np.abs(gradient), -gradient), initial=0.0))
