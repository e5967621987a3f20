r"""Whether friction leaves the motion unique: what can be said before any mode is tried.

With sliding friction the response G of the independent forces is not symmetric. The rates
:math:`w = G z + g` of a solution are unique for all g exactly when G is *column adequate*:

.. math:: z_i (G z)_i \le 0 \;\text{for all } i \quad\Rightarrow\quad G z = 0,

that is, no principal minor is negative, and where one is zero, the columns concerned are dependent
as a whole (Cottle, Pang, Stone, theorems 3.4.4 and 3.4.6). Contacts that share a load have such
zeros; they do no harm. Regular and adequate is a P-matrix, for which a solution always exists. A
sliding rod whose :math:`D_{nn} - \mu D_{nt} \cdot s` is negative breaks this (Painleve 1895): it
has no solution when the contact is being closed, and two when it is not.

A contact at zero slip may begin to slip in any direction. For two solutions, with differences dz
and dw = G dz, the laws give

.. math:: dz^T G\, dz \le \sum_k \mu_k |dz_{n,k}| \, |G_{t,k}\, dz|

(the disk of friction has its radius from the normal force). So the motion is unique when the
symmetric part of G exceeds :math:`\sum_k (\mu_k/2) (\epsilon e_n e_n^T + G_t^T G_t/\epsilon)` for
some :math:`\epsilon`. This is sufficient only: contacts that share a load never satisfy it.
"""

from __future__ import annotations

from enum import Enum
from itertools import combinations
from math import comb

import numpy as np

from multiarm.events.complementarity.problem import Problem
from multiarm.events.complementarity.tolerances import RANK

# Principal minors are looked at size by size, as long as a size has no more than these.
MINORS = 500


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
    for cone in problem.cones:
        tangents += [cone.normal + 1, cone.normal + 2]
        # slipping in its worst direction the contact would be pulled in by its own friction
        if G[cone.normal, cone.normal] <= cone.mu * np.hypot(*G[cone.normal, cone.tangents]) + RANK:
            return Motion.DOUBTFUL
    if len(problem.cones) < len(problem.units):
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
        if not all(_dependent(G[:, columns]) for columns in index[minors <= RANK]):
            return Motion.DOUBTFUL
    # rates of rows without a law of their own (tangents) must follow from those with one
    if problem is None or _rank(G) == _rank(problem.scale[:, None] * problem.D @ problem.E):
        return Motion.UNIQUE
    return Motion.DOUBTFUL


def _rank(A: np.ndarray) -> int:
    values = np.linalg.svd(A, compute_uv=False)
    return int(np.sum(values > RANK * max(values[0], 1.0)))


def _dependent(A: np.ndarray) -> bool:
    return _rank(A) < A.shape[1]


def _dominates_friction(problem: Problem) -> bool:
    G = problem.G
    for weight in (0.5, 1.0, 2.0):
        form = (G + G.T) / 2.0
        for cone in problem.cones:
            form[cone.normal, cone.normal] -= 0.5 * cone.mu * weight
            form -= (0.5 * cone.mu / weight) * G[cone.tangents].T @ G[cone.tangents]
        if np.linalg.eigvalsh(form)[0] > RANK:
            return True
    return False
