r"""How many motions obey the contact laws: what the response proves, and all modes tried.

**What the response proves.** With sliding friction the response G of the independent forces is not
symmetric. The rates :math:`w = G z + g` of a solution are unique for all g exactly when G is
*column adequate*:

.. math:: z_i (G z)_i \le 0 \;\text{for all } i \quad\Rightarrow\quad G z = 0,

that is, no principal minor is negative, and where one is zero, the columns concerned are dependent
as a whole (Cottle, Pang, Stone, theorems 3.4.4 and 3.4.6). Contacts that share a load have such
zeros; they do no harm. Regular and adequate is a P-matrix, for which a solution always exists. A
sliding rod whose :math:`D_{nn} - \mu D_{nt} \cdot s` is negative breaks this (Painleve 1895): it
has no solution when the contact is being closed, and two when it is not.

A contact at zero slip may begin to slip in any direction. For two solutions, with differences dz
and dw = G dz, the laws give

.. math:: dz^T G\, dz \le \sum_k \mu_k |dz_{n,k}| \, |G_{t,k}\, dz|

(the friction disk has its radius from the normal force). So the motion is unique when the symmetric
part of G exceeds :math:`\sum_k (\mu_k/2) (\epsilon e_n e_n^T + G_t^T G_t/\epsilon)` for some
:math:`\epsilon`. This is sufficient only: contacts that share a load never satisfy it.

**All modes tried.** Where friction may leave no solution or several, a handful of laws is decided
by enumeration: every law in every mode, the linear equations of the modes, the residual of their
solution. Without contacts at zero slip the list is complete: forces that are not determined by
their modes can be moved to a bound, which is another choice of modes. The directions in which a
contact at zero slip may begin to slip start from a ring of eight and are refined by Newton's
method: what is found so are solutions, that there are no others is not proven.
"""

from __future__ import annotations

from enum import Enum
from itertools import combinations, product
from math import comb, prod

import numpy as np

from multiarm.events.complementarity.problem import (
    CONSISTENT,
    RANK,
    ROUNDING,
    Problem,
    matrix_rank,
    rank_of,
)
from multiarm.events.complementarity.solvers import newton

# Principal minors are looked at size by size, as long as a size has no more than these.
MINORS = 500
# Laws up to which all modes are tried, and the most combinations of their modes.
FEW_LAWS = 8
FEW_STARTS = 300
RING = [np.array([np.cos(a), np.sin(a)]) for a in np.arange(8) * (np.pi / 4.0)]

LinearMode = tuple[np.ndarray, np.ndarray, bool]
"""Rows of ``A z = c`` of a law in one mode, and whether the direction of slip is a guess."""


class Motion(Enum):
    """What is known of the number of motions."""

    UNIQUE = "at most one"
    UNKNOWN = "nothing is known"
    DOUBTFUL = "none or several are possible for some free rates"


def judge(problem: Problem) -> Motion:
    """How many motions a problem can have, by its response alone."""
    if problem.convex:
        return Motion.UNIQUE
    if not problem.cones:
        return _judge_linear(problem.G, problem)
    G, tangents = problem.G, []
    for n, cone in problem.cones.items():
        tangents += [n + 1, n + 2]
        # slipping in its worst direction the contact would be pulled in by its own friction
        if G[n, n] <= cone.mu * np.hypot(*G[n, cone.tangents]) + RANK:
            return Motion.DOUBTFUL
    if len(problem.cones) < len(problem.laws):
        others = np.setdiff1d(np.arange(problem.g.size), tangents)
        if _judge_linear(G[np.ix_(others, others)]) == Motion.DOUBTFUL:
            return Motion.DOUBTFUL
    return Motion.UNIQUE if _dominates_friction(problem) else Motion.UNKNOWN


def _judge_linear(G: np.ndarray, problem: Problem | None = None) -> Motion:
    """The same for a response without contacts at zero slip."""
    n = G.shape[0]
    if np.linalg.eigvalsh(G + G.T)[0] > RANK:
        return Motion.UNIQUE
    for size in range(1, n + 1):
        if comb(n, size) > MINORS:
            return Motion.UNKNOWN
        index = np.array(list(combinations(range(n), size)))
        minors = np.linalg.det(G[index[:, :, None], index[:, None, :]])
        if any(matrix_rank(G[:, columns]) == size for columns in index[minors <= RANK]):
            return Motion.DOUBTFUL
    # rates of rows without a law of their own (tangents) must follow from those with one
    if problem is None or matrix_rank(G) == matrix_rank(
        problem.scale[:, None] * problem.D @ problem.E
    ):
        return Motion.UNIQUE
    return Motion.DOUBTFUL


def _dominates_friction(problem: Problem) -> bool:
    G = problem.G
    for weight in (0.5, 1.0, 2.0):
        form = (G + G.T) / 2.0
        for n, cone in problem.cones.items():
            form[n, n] -= 0.5 * cone.mu * weight
            form -= (0.5 * cone.mu / weight) * G[cone.tangents].T @ G[cone.tangents]
        if np.linalg.eigvalsh(form)[0] > RANK:
            return True
    return False


def few(problem: Problem) -> bool:
    """Whether all modes can be tried."""
    if len(problem.laws) > FEW_LAWS:
        return False
    return prod(len(_linear_modes(problem, k)) for k in problem.columns) <= FEW_STARTS


def all_solutions(problem: Problem, known: list[np.ndarray]) -> list[np.ndarray]:
    """Known solutions and those found: one for each motion, smallest forces first."""
    found = list(known)
    for modes in product(*(_linear_modes(problem, k) for k in problem.columns)):
        A, c = np.vstack([mode[0] for mode in modes]), np.concatenate([mode[1] for mode in modes])
        z = np.linalg.lstsq(A, c, rcond=RANK)[0]
        if any(guessed for _, _, guessed in modes):
            z = newton(problem, z)
        # where forces can grow without changing the rates of their own laws, there is a family
        for other in [z, *_along_family(problem, z)]:
            if problem.residual(other) <= 10.0 * ROUNDING and not any(
                _same_motion(problem, other, one) for one in found
            ):
                found.append(other)
    return sorted(found, key=lambda z: float(z @ z))


def _same_motion(problem: Problem, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two solutions have the same rates in all rows."""
    apart = problem.scale * (problem.D @ (problem.E @ (one - other)))
    size = max(problem.size(one), problem.size(other))
    return bool(np.max(np.abs(apart), initial=0.0) <= CONSISTENT * size)


def _linear_modes(problem: Problem, k: int) -> list[LinearMode]:
    """The equations of a law in each of its modes; k is its first column."""
    cone, identity = problem.cones.get(k), np.eye(problem.g.size)
    columns = [k] if cone is None else [k, k + 1, k + 2]
    none = np.zeros(len(columns) - 1)
    modes: list[LinearMode] = [
        (identity[columns], np.array([bound, *none]), False)
        for bound in (problem.lower[k], problem.upper[k])
        if np.isfinite(bound)
    ]
    if cone is None or cone.mu > 0.0:  # closed, sticking
        modes.append((problem.G[columns], -problem.g[columns], False))
    if cone is not None:
        for direction in RING if cone.mu > 0.0 else RING[:1]:
            tied = identity[cone.tangents] - cone.mu * np.outer(direction, identity[k])
            A = np.vstack([problem.G[k], tied])
            modes.append((A, np.array([-problem.g[k], *none]), cone.mu > 0.0))
    return modes


def _along_family(problem: Problem, z: np.ndarray) -> list[np.ndarray]:
    """Forces near a solution that leave the rates of their own laws as they are."""
    size = problem.size(z)
    touching = np.flatnonzero(np.abs(problem.G @ z + problem.g) <= ROUNDING * size)
    if problem.cones or touching.size == 0:
        return []
    _, values, right = np.linalg.svd(problem.G[np.ix_(touching, touching)])
    block = right[rank_of(values) :].T
    null = np.zeros((z.size, block.shape[1]))
    null[touching] = block
    # with all rates zero, forces have no scale of their own
    step = 0.1 * size or 1.0
    return [z + sign * step * v for v in null.T for sign in (1.0, -1.0)]
