r"""Forces that obey the contact laws: by pivoting without friction, by iterations with it.

**Pivoting.** With D symmetric and positive semidefinite the laws

.. math:: l \le x \le u, \qquad y = D x + b, \qquad
          y_i = 0 \;(l_i < x_i < u_i), \quad y_i \ge 0 \;(x_i = l_i), \quad y_i \le 0 \;(x_i = u_i)

are the conditions of a minimum of :math:`x^T D x/2 + b^T x` between the bounds. The method of
Dantzig and Cottle keeps a set of forces inside their bounds whose rates are zero, and brings in one
more row at a time: its force grows, the others follow so that their rates stay zero, until its own
rate is zero, or a force reaches a bound and leaves the set. Every step lowers the function, so that
no set comes twice. A row enters only when it is independent of the set: the matrices of the linear
equations are regular however singular D is. A force that grows without end, at a rate that stays
wrong, proves that there is no solution. (Cottle, Pang, Stone, chapter 4; for contacts Baraff, "Fast
contact force computation for nonpenetrating rigid bodies", 1994.)

**With friction** the problem is not one of minimisation. Newton's method solves the equations of
the present modes (:mod:`~multiarm.events.complementarity.semismooth`), here with steps of minimum
norm from singular values: where rows depend on each other the forces that it ends at depend on the
problem alone, not on rounding. The compiled one of
:mod:`~multiarm.events.complementarity.semismooth` is faster and ends at forces near to those where
it began: right for steps in time, not for the event of a run that must not depend on what was
before. Steps of minimum norm may lose digits or cycle; then compiled iterations of more sorts find
the modes (:mod:`~multiarm.events.complementarity.impulses`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.events.complementarity.impulses import ATTEMPTS, solve_laws
from multiarm.events.complementarity.problem import (
    CONSISTENT,
    RANK,
    ROUNDED_RESIDUAL,
    Problem,
)
from multiarm.events.complementarity.semismooth import NORMAL, SINGLE, TANGENT, Laws

# Pivots allowed for each row: a handful is usual, more means that rounding makes it cycle.
PIVOTS = 20
# Newton steps from one start.
STEPS = 25


def solve_box(
    D: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray | None, bool]:
    """Forces between bounds, by pivoting.

    Parameters
    ----------
    D : ndarray, shape (m, m)
        Symmetric, positive semidefinite; diagonal about one, or zero.
    b : ndarray, shape (m,)
        Free rates.
    lower, upper : ndarray, shape (m,)
        Bounds; may be infinite.

    Returns
    -------
    forces : ndarray, shape (m,), or None
        A solution; those inside their bounds have independent rows.
    contradiction : bool
        Whether it is proven that there is none.
    """
    x = np.clip(np.zeros(b.size), lower, upper)
    state = _Pivoting(D, b, lower, upper, x, D @ x + b, [], [], PIVOTS * (b.size + 2))
    while (row := state.worst_row()) is not None:
        state.bring_in(row)
        if state.contradiction or state.pivots <= 0:
            return None, state.contradiction
    return state.x, False


@dataclass
class _Pivoting:
    """Forces, rates, rows at rate zero, rows given up, and the pivots left."""

    D: np.ndarray
    b: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x: np.ndarray
    y: np.ndarray
    inside: list[int]
    skipped: list[int]
    pivots: int
    contradiction: bool = False

    def size(self) -> float:
        return float(np.max(np.abs(self.b) + np.abs(self.D) @ np.abs(self.x), initial=0.0))

    def worst_row(self) -> int | None:
        """The row whose rate violates its law most, if one does."""
        x, y = self.x, self.y
        wrong = np.maximum(np.where(x < self.upper, -y, 0.0), np.where(x > self.lower, y, 0.0))
        wrong[self.inside + self.skipped] = 0.0
        row = int(np.argmax(wrong)) if wrong.size else 0
        return row if wrong.size and wrong[row] > ROUNDED_RESIDUAL * self.size() else None

    def bring_in(self, row: int) -> None:
        """Let the force of one row grow until its rate is zero or a bound is met."""
        D, x, inside = self.D, self.x, self.inside
        sign = -np.sign(self.y[row])
        while self.pivots > 0:
            self.pivots -= 1
            d = np.zeros(x.size)
            d[row] = sign
            if inside:
                d[inside] = np.linalg.solve(D[np.ix_(inside, inside)], -sign * D[inside, row])
            curvature = sign * (D[row] @ d)
            regular = curvature > RANK * D[row, row]
            to_zero = abs(self.y[row]) / curvature if regular else np.inf
            to_bound, blocking = self._step_to_bound(d, [*inside, row])
            if min(to_zero, to_bound) == np.inf:
                # a contradiction, unless the rate is zero but for rounding
                self.contradiction |= bool(abs(self.y[row]) > CONSISTENT * self.size())
                self.skipped.append(row)
                return
            x += min(to_zero, to_bound) * d
            if to_zero <= to_bound:
                inside.append(row)
                self._refine()
                return
            x[blocking] = self.upper[blocking] if d[blocking] > 0.0 else self.lower[blocking]
            self.y = D @ x + self.b
            if blocking == row:
                return
            inside.remove(blocking)
            if sign * self.y[row] >= 0.0:
                return

    def _step_to_bound(self, d: np.ndarray, rows: list[int]) -> tuple[float, int]:
        """How far the forces can go along d, and which row ends it."""
        nearest, blocking = np.inf, rows[0]
        for row in rows:
            if abs(d[row]) <= ROUNDED_RESIDUAL:
                continue
            bound = self.upper[row] if d[row] > 0.0 else self.lower[row]
            step = max((bound - self.x[row]) / d[row], 0.0)
            if step < nearest:
                nearest, blocking = step, row
        return nearest, blocking

    def _refine(self) -> None:
        """Forces of the inner rows from their rates, free of the rounding of former steps."""
        inside = self.inside
        self.y = self.D @ self.x + self.b
        self.x[inside] -= np.linalg.solve(self.D[np.ix_(inside, inside)], self.y[inside])
        self.y = self.D @ self.x + self.b


def iterate(problem: Problem, start: np.ndarray | None = None) -> np.ndarray:
    """Independent forces of a solution near ``start``, or the best found; the residual says which.

    Newton's method goes first; where it is not exact, so do all attempts of the compiled iterations
    from the same start.
    """
    begin = problem.without_force() if start is None else start
    best = newton(problem, begin)
    least = problem.residual(best)
    if least <= ROUNDED_RESIDUAL:
        return best
    z = iterate_compiled(problem, begin)
    return z if problem.residual(z) < least else best


def iterate_compiled(
    problem: Problem, start: np.ndarray, attempts: int = len(ATTEMPTS)
) -> np.ndarray:
    """As :func:`iterate`; of ``ATTEMPTS`` so many are made at most, Newton's method the first."""
    n = problem.g.size
    kind, mu = np.full(n, SINGLE), np.zeros(n)
    for cone in problem.cones.values():
        kind[cone.normal], kind[cone.tangents], mu[cone.normal] = NORMAL, TANGENT, cone.mu
    G, terms = np.ascontiguousarray(problem.G), np.ascontiguousarray(problem.terms)
    z = start.copy()
    laws = Laws(G, terms, problem.g, problem.lower, problem.upper, kind, mu)
    solve_laws(laws, z, attempts)
    return z


def newton(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Steps from a start until the residual is zero but for rounding; the best point met."""
    best, least = z, problem.residual(z)
    for _ in range(STEPS):
        A, r = _linearise(problem, z)
        z = z - np.linalg.lstsq(A, r, rcond=RANK)[0]
        residual = problem.residual(z)
        if not np.isfinite(residual):
            break
        settled = residual <= ROUNDED_RESIDUAL and residual >= 0.1 * least
        if residual < least:
            best, least = z, residual
        if settled or least == 0.0:
            break
    return best


def _linearise(problem: Problem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and value of the equations of the present modes."""
    G = problem.G
    w = G @ z + problem.g
    p = z - w
    bounded = np.clip(p, problem.lower, problem.upper)
    at_bound = bounded != p
    identity = np.eye(z.size)
    A = np.where(at_bound[:, None], identity, G)
    r = np.where(at_bound, z - bounded, w)
    if not problem.cones:
        return A, r
    normals = np.array(list(problem.cones))
    mu = np.array([cone.mu for cone in problem.cones.values()])
    tangents = normals[:, None] + (1, 2)
    radius, length = mu * np.maximum(p[normals], 0.0), np.hypot(*p[tangents].T)
    none = tangents[radius == 0.0]
    A[none], r[none] = identity[none], z[none]
    slips = (radius > 0.0) & (length > radius)
    if np.any(slips):
        normals, tangents, mu = normals[slips], tangents[slips], mu[slips]
        # the direction of slip is among the unknowns
        radius, length = radius[slips], length[slips]
        d, dp = p[tangents] / length[:, None], identity - G
        turn = (radius / length)[:, None, None] * (np.eye(2) - d[:, :, None] * d[:, None, :])
        tied = (mu[:, None] * d)[:, :, None] * dp[normals][:, None, :]
        A[tangents] = identity[tangents] - tied - turn @ dp[tangents]
        r[tangents] = z[tangents] - radius[:, None] * d
    return A, r
