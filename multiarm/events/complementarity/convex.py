r"""Forces between bounds, by pivoting: the convex problem, exact and finite.

With D symmetric and positive semidefinite the laws

.. math:: l \le x \le u, \qquad y = D x + b, \qquad
          y_i = 0 \;(l_i < x_i < u_i), \quad y_i \ge 0 \;(x_i = l_i), \quad y_i \le 0 \;(x_i = u_i)

are the conditions of a minimum of :math:`x^T D x/2 + b^T x` between the bounds. The method of
Dantzig and Cottle keeps a set of forces inside their bounds whose rates are zero, and brings in one
more row at a time: its force grows, the others follow so that their rates stay zero, until its own
rate is zero, or a force reaches a bound and leaves the set. Every step lowers the function, so that
no set comes twice. A row enters only when it is independent of the set: the matrices that are
solved with are regular however singular D is. (Cottle, Pang, Stone, chapter 4; for contacts Baraff,
"Fast contact force computation for nonpenetrating rigid bodies", 1994.)

A force that grows without end, at a rate that stays wrong, proves that there is no solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.events.complementarity.tolerances import CONSISTENT, RANK, ROUNDING

# Pivots allowed for each row: a handful is usual, more means that rounding runs in a circle.
PIVOTS = 20


@dataclass
class _Pivoting:
    """State: forces, rates, rows at rate zero, rows given up, and where it stands."""

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

    def worst(self) -> int | None:
        """The row whose rate is most wrong for its force, if one is."""
        x, y = self.x, self.y
        wrong = np.maximum(np.where(x < self.upper, -y, 0.0), np.where(x > self.lower, y, 0.0))
        wrong[self.inside + self.skipped] = 0.0
        row = int(np.argmax(wrong)) if wrong.size else 0
        return row if wrong.size and wrong[row] > ROUNDING * self.size() else None


def solve_box(
    D: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray | None, bool]:
    """Forces between bounds.

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
    while (row := state.worst()) is not None:
        _bring_in(state, row)
        if state.contradiction or state.pivots <= 0:
            return None, state.contradiction
    return state.x, False


def _bring_in(state: _Pivoting, row: int) -> None:
    """Let the force of one row grow until its rate is zero or a bound is met."""
    D, x = state.D, state.x
    sign = -np.sign(state.y[row])
    while state.pivots > 0:
        state.pivots -= 1
        inside = state.inside
        d = np.zeros(x.size)
        d[row] = sign
        if inside:
            d[inside] = np.linalg.solve(D[np.ix_(inside, inside)], -sign * D[inside, row])
        curvature = sign * (D[row] @ d)
        regular = curvature > RANK * D[row, row]
        to_zero = abs(state.y[row]) / curvature if regular else np.inf
        to_bound, blocking = _room(state, d, [*inside, row])
        if min(to_zero, to_bound) == np.inf:
            _give_up(state, row)
            return
        x += min(to_zero, to_bound) * d
        if to_zero <= to_bound:
            inside.append(row)
            _settle(state)
            return
        x[blocking] = state.upper[blocking] if d[blocking] > 0.0 else state.lower[blocking]
        state.y = D @ x + state.b
        if blocking == row:
            return
        inside.remove(blocking)
        if sign * state.y[row] >= 0.0:
            return


def _room(state: _Pivoting, d: np.ndarray, rows: list[int]) -> tuple[float, int]:
    """How far the forces can go along d, and which row ends it."""
    nearest, blocking = np.inf, rows[0]
    for row in rows:
        if abs(d[row]) <= ROUNDING:
            continue
        bound = state.upper[row] if d[row] > 0.0 else state.lower[row]
        room = max((bound - state.x[row]) / d[row], 0.0)
        if room < nearest:
            nearest, blocking = room, row
    return nearest, blocking


def _give_up(state: _Pivoting, row: int) -> None:
    """Nothing ends the growth: a contradiction, unless the rate is zero but for rounding."""
    if abs(state.y[row]) > CONSISTENT * state.size():
        state.contradiction = True
    state.skipped.append(row)


def _settle(state: _Pivoting) -> None:
    """Forces of the inner rows from their rates, free of the rounding of former steps."""
    inside = state.inside
    if inside:
        block = state.D[np.ix_(inside, inside)]
        state.y = state.D @ state.x + state.b
        state.x[inside] -= np.linalg.solve(block, state.y[inside])
    state.y = state.D @ state.x + state.b
