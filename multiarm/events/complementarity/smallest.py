r"""The smallest forces that make a given motion, within their bounds.

With the motion given, the forces v of the rows in contact obey linear equations and bounds,

.. math:: \min |v|^2 \quad\text{with}\quad D B v = D (x^* - x_0), \qquad l \le v \le u ,

where :math:`x^*` is any solution, :math:`x_0` what is constant, and a column of B is a row, or a
normal row with its friction tied to it. With :math:`v_p` the smallest of all, whatever the signs,
and Q a basis of the forces that move nothing, :math:`v = v_p + Q q`, the bounds read
:math:`K q + k \ge 0`, and the multipliers u of the bounds solve a complementarity problem again:

.. math:: q = K^T u, \qquad 0 \le u \perp K K^T u + k \ge 0 .

|v| is meant in the rows as they are: newtons for forces, newton metres for couples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.events.complementarity.convex import solve_box
from multiarm.events.complementarity.parts import Column, Part, Selection, columns_of
from multiarm.events.complementarity.problem import Problem
from multiarm.events.complementarity.tolerances import CONSISTENT, MARGIN, RANK
from multiarm.events.complementarity.units import Bounded, Mode


@dataclass
class Sharing:
    """How the rows in contact share a motion: the smallest forces, part by part.

    Attributes
    ----------
    problem : Problem
        The problem.
    x : ndarray, shape (m,)
        Forces of a solution: they give the motion.
    zero : float
        What counts as zero, scaled.
    dependent : bool
        Whether forces were found that move nothing.
    undetermined : bool
        Whether forces were found that leave the rows held at rest, but move others: sliding
        friction grows with forces that squeeze.
    """

    problem: Problem
    x: np.ndarray
    zero: float
    dependent: bool = False
    undetermined: bool = False

    def least(self, parts: tuple[Part, ...]) -> Selection | None:
        """Smallest forces of these parts within their bounds, if these rows give the motion."""
        problem, s = self.problem, self.problem.scale
        columns, fixed = columns_of(problem, parts), _constants(problem, parts)
        B = np.zeros((s.size, len(columns)))
        for k, column in enumerate(columns):
            for row, entry in column.entries:
                B[row, k] = entry
        weights = np.array([s[column.held[0]] for column in columns])
        response = s[:, None] * problem.D @ B * weights
        if not _determines(response, columns):
            self.undetermined = True
            return None
        motion = s * (problem.D @ (self.x - fixed))
        v, bound = self._smallest(response, motion, weights, columns)
        if v is None:
            return None
        rows = tuple(sorted(row for column in columns for row in column.held))
        return Selection(fixed + B @ v, parts, rows, bound)

    def _smallest(
        self, response: np.ndarray, motion: np.ndarray, s: np.ndarray, columns: list[Column]
    ) -> tuple[np.ndarray | None, bool]:
        """The forces, and whether bounds hold them back."""
        if not columns:
            return (np.zeros(0) if self._small(motion) else None), False
        left, values, right = np.linalg.svd(response, full_matrices=True)
        rank = int(np.sum(values > RANK * max(values[0], 1.0)))
        scaled = np.zeros(len(columns))
        for _ in range(2):  # the second time for the rounding that small singular values enlarge
            rest = motion - response @ scaled
            scaled += right[:rank].T @ ((left[:, :rank].T @ rest) / values[:rank])
        if not self._small(motion - response @ scaled):
            return None, False
        v: np.ndarray | None = s * scaled
        bound = False
        if rank < len(columns):
            self.dependent = True
            Q = np.linalg.qr(s[:, None] * right[rank:].T)[0]
            v, bound = _between_bounds(s * scaled, Q, s, columns)
        return (v if v is not None and self._obeys(v, s, columns) else None), bound

    def _small(self, rates: np.ndarray) -> bool:
        return bool(np.max(np.abs(rates), initial=0.0) <= self.zero * (CONSISTENT / MARGIN))

    def _obeys(self, v: np.ndarray, s: np.ndarray, columns: list[Column]) -> bool:
        lower, upper = _bounds(columns)
        return bool(np.all(v >= lower - s * self.zero) and np.all(v <= upper + s * self.zero))


def _constants(problem: Problem, parts: tuple[Part, ...]) -> np.ndarray:
    """Forces at their bounds."""
    fixed = np.zeros(problem.b.size)
    for unit, part in zip(problem.units, parts, strict=True):
        if part.mode in (Mode.AT_LOWER, Mode.AT_UPPER):
            assert isinstance(unit, Bounded)
            fixed[unit.row] = unit.lower if part.mode == Mode.AT_LOWER else unit.upper
    return fixed


def _determines(response: np.ndarray, columns: list[Column]) -> bool:
    """Whether rates of zero in the rows held leave one motion; always, when nothing is tied."""
    if all(len(column.entries) == 1 for column in columns):
        return True
    held = [row for column in columns for row in column.held]
    return _rank(response[held]) == _rank(response)


def _rank(A: np.ndarray) -> int:
    values = np.linalg.svd(A, compute_uv=False)
    return int(np.sum(values > RANK * max(values[0], 1.0)))


def _bounds(columns: list[Column]) -> tuple[np.ndarray, np.ndarray]:
    lower = np.array([column.lower for column in columns])
    return lower, np.array([column.upper for column in columns])


def _between_bounds(
    v: np.ndarray, Q: np.ndarray, s: np.ndarray, columns: list[Column]
) -> tuple[np.ndarray | None, bool]:
    """The smallest forces between their bounds, from the multipliers of the bounds."""
    v = v - Q @ (Q.T @ v)
    lower, upper = _bounds(columns)
    low, high = np.isfinite(lower), np.isfinite(upper)
    K = np.vstack([(Q / s[:, None])[low], -(Q / s[:, None])[high]])
    k = np.concatenate([((v - lower) / s)[low], ((upper - v) / s)[high]])
    if np.all(k >= 0.0):
        return v, False
    size = np.sqrt(np.sum(K * K, axis=1))
    # forces that the motion determines: nothing to choose, and a row of rounding
    free = size > RANK * np.max(size)
    K, k = K[free] / size[free, None], k[free] / size[free]
    u, _ = solve_box(K @ K.T, k, np.zeros(k.size), np.full(k.size, np.inf))
    return (None if u is None else v + Q @ (K.T @ u)), True
