r"""Pushes that balance, or a motion that no contact resists: one of the two always exists.

For the wrenches ``W = [w_1 ... w_N]`` of the contacts, each of :math:`n` numbers, exactly one of

.. math::
    W \lambda = 0, \;\; \lambda > 0, \;\; \operatorname{rank} W = n
    \qquad\text{and}\qquad
    W^T v \ge 0, \;\; v \ne 0

has a solution (thesis, 2.1; the alternative is Stiemke's).  The pushes prove form closure, the
motion proves that there is none.  This module finds one or the other for scaled wrenches: about the
middle of the contacts, with moments over their spread.

Geometrically, closure says that the origin is inside the convex hull of the wrenches.  How far
inside is the ``distance``, the quality of Ferrari and Canny (1992) without friction: closure
survives every change of each wrench by less than it.

- ``N = n + 1``: the hull is a simplex.  With ``G`` the inverse of ``[W; 1 ... 1]``, the last column
  of ``G`` holds the pushes :math:`\lambda_j` (of sum 1) and the rest of row j is the normal
  :math:`g_j` of the facet opposite to wrench j; the origin is :math:`\lambda_j / |g_j|` from it.
  A negative :math:`\lambda_j` makes :math:`v = g_j` a motion away from all contacts.
- ``N > n + 1``: the pushes nearest to equal ones serve if they are positive.  Otherwise the
  non-negative least squares problem  min ``|W lam|`` over ``lam >= 1``  has either the residual 0,
  and ``lam`` are the pushes, or a residual ``r`` with ``W^T r >= 0``, and ``v = r``
  (Lawson and Hanson 1974).  The distance is then at least ``t sigma_n / sqrt(1 + (N - 1) t^2)``,
  with ``t`` the smallest push (of sum 1) and ``sigma_n`` the smallest singular value: a
  unit ``v`` has ``|W^T v| >= sigma_n``, and if no gap closes faster than s, the rates at which the
  others open have a sum of s / t at most, since the pushes do no work.  Only where that bound is in
  the band, the facets of the hull are enumerated (up to 30 wrenches).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.forces.distribution import ForceFamily, smallest_load
from multiarm.grasp.contacts import Contacts
from multiarm.programs import (
    EPS,
    ROUNDINGS,
    least_distance,
    nonnegative_least_squares,
)

# The origin must be farther inside the hull than this.  Computed normals and points are off by some
# 1e-16 to 1e-12, and a grasp that hangs on less than this is not reliable.  Singular values below
# this part of the largest count as zero, in all modules.
BAND = 1e-10
# Motions whose nearness to an axis differs by less than this are equally near: the first is taken.
EQUAL = 1e-6
# Lower bound of the margin: below it, pushes of sum 1 are differences of nearly equal numbers.
LEAST_MARGIN = -1.0 / BAND
# Batches compute no balance of sets whose inverse has an entry above this: it would be rounding.
STEEPEST = 1e12
# Facets of the hull of this many wrenches are enumerated within milliseconds.
ENUMERATED = 30


@dataclass(frozen=True, eq=False)
class Balance:
    """Outcome for scaled wrenches.

    Attributes
    ----------
    closed : bool
    pushes : ndarray, shape (N,), or None
        Of sum 1, all positive, with ``W pushes = 0``; when closed.
    direction : ndarray, shape (n,), or None
        ``v`` with ``W^T v >= 0``; when open.
    rank : int
    distance : float
        Of the origin from the hull's boundary, or less; 0 when open.
    borderline : bool
        Open, but a change of the wrenches by less than the tolerance may close them.
    """

    closed: bool
    pushes: np.ndarray | None
    direction: np.ndarray | None
    rank: int
    distance: float
    borderline: bool


@dataclass(frozen=True, eq=False)
class Evenest:
    """Pushes of sum 1 whose smallest is as large as can be.

    Attributes
    ----------
    smallest : float
        ``t*``, but no less than -1e10, which also stands for none: no pushes of sum 1 balance.
        Where the linear program gives up, that of the pushes nearest to equal ones: a lower bound.
    pushes : ndarray, shape (N,), or None
    direction : ndarray, shape (n,), or None
        Solution of the dual problem: ``W^T v >= -t*``, and the sum of ``W^T v`` is ``1 - N t*``.
        None with a bound only.
    """

    smallest: float
    pushes: np.ndarray | None
    direction: np.ndarray | None


def rounding(reach: Any, length: Any) -> Any:
    """The rounding of a scaled wrench: points are coarse far from the origin.

    ``reach`` is the largest coordinate, ``length`` the spread of the points [m].
    """
    return ROUNDINGS * EPS * (1.0 + reach / length)


def floor_of(contacts: Contacts) -> float:
    """The rounding of the scaled wrenches of some contacts."""
    return float(rounding(float(np.abs(contacts.points).max()), contacts.length))


def tolerance_of(contacts: Contacts) -> float:
    """Least difference of distinct scaled wrenches: ``BAND`` and their rounding."""
    return BAND + floor_of(contacts)


def rank_of(contacts: Contacts) -> int:
    """Rank of the wrenches: singular values of the scaled ones above `tolerance_of` the largest."""
    s = np.linalg.svd(contacts.scaled_wrenches, compute_uv=False)
    return int(np.count_nonzero(s > tolerance_of(contacts) * s[0]))


def balance(W: np.ndarray, floor: float) -> Balance:
    """Decide scaled wrenches, shape (n, N), whose entries may be off by ``floor``."""
    n, count = W.shape
    if count == n + 1:
        simplex = _simplex(W, BAND + floor)
        if simplex is not None:
            return simplex
    U, s, Vt = np.linalg.svd(W, full_matrices=count < n)
    tolerance = BAND + floor
    rank = int(np.count_nonzero(s > tolerance * s[0]))
    if rank < n:
        doubtful = count > n and bool(np.any((s > floor * s[0]) & (s <= tolerance * s[0])))
        return Balance(False, None, plainest(U[:, rank:]), rank, 0.0, doubtful)
    if count == n:
        return Balance(False, None, np.linalg.solve(W.T, np.ones(n)), n, 0.0, False)
    even = 1.0 - Vt.sum(axis=1) @ Vt
    bound = _inside(even, s[-1])
    if bound > tolerance and even.min() > tolerance:  # not what rounding leaves of zeros
        return Balance(True, even / even.sum(), None, n, bound, False)
    return _least_squares(W, Vt, s[-1], tolerance)


def plainest(directions: np.ndarray) -> np.ndarray:
    """A plain motion among those that the columns (orthonormal, shape (n, k)) span.

    A translation if there is one, and nearest to an axis of the frame.
    """
    d = 3 if len(directions) == 6 else 2
    _, s, Vt = np.linalg.svd(directions[d:])
    turns = int(np.count_nonzero(s > BAND))
    among = directions @ Vt[turns:].T if turns < Vt.shape[0] else directions
    projections = among @ among.T
    sizes = np.diag(projections)
    return projections[:, int(np.argmax(sizes > (1.0 - EQUAL) * sizes.max()))]


def evenest(W: np.ndarray, rank: int) -> Evenest:
    r"""Maximise ``t`` with ``W lam = 0``, ``sum lam = 1``, ``lam >= t`` (thesis, 2.1).

    With the part z of ``(1 ... 1)`` that balances, pushes of sum 1 are ``(z / |z| + N q) / |z|``,
    where the columns of N balance with the sum 0.  The program is solved for ``t |z|`` and q, whose
    sizes are about 1 however small z is.
    """
    count = W.shape[1]
    null = np.linalg.svd(W)[2][rank:].T
    sums = null.sum(axis=0)
    size = float(np.linalg.norm(sums))
    if size <= BAND * np.sqrt(count):
        return Evenest(LEAST_MARGIN, None, None)
    base = null @ (sums / size)
    best, shares = _highest(base, null @ np.linalg.svd(sums[None])[2][1:].T)
    smallest = float(best.min()) / size
    rates = None if shares is None else shares - smallest
    direction = None if rates is None else np.linalg.lstsq(W.T, rates, rcond=BAND)[0]
    return Evenest(max(smallest, LEAST_MARGIN), best / size, direction)


def _highest(base: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """``base + ways q`` whose smallest entry is as large as can be, and the prices of the entries.

    Without prices where the linear program gives up: then it is the base itself.
    """
    count, free = ways.shape
    if not free:
        return base, (np.arange(count) == np.argmin(base)).astype(float)
    entries = -np.eye(count), np.zeros(count)
    best = smallest_load(ForceFamily(base, ways), entries)
    return (base, None) if best.forces is None else (best.forces, best.load_prices)


def balance_inverses(W: np.ndarray) -> np.ndarray:
    """``G`` of M sets of ``n + 1`` wrenches in rows (M, n + 1, n): inverses of [W; 1 ... 1].

    Zero where there is none.  Otherwise the last column is the balance of sum 1.
    """
    sets, count, n = W.shape
    square = np.ones((sets, count, count))
    square[:, :n] = np.swapaxes(W, 1, 2)
    singular = np.linalg.det(square) == 0.0  # a pivot is zero: there is no inverse at all
    square[singular] = np.eye(count)
    G = np.linalg.inv(square)
    G[singular | ~(np.abs(G).max(axis=(1, 2), initial=0.0) < STEEPEST)] = 0.0
    return G


def simplices(W: np.ndarray, tolerances: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed form for M sets of ``n + 1`` wrenches, shape (M, n, n + 1).

    Returns the inverses ``G``, distances (M, n + 1) of the origin from the facets, inside positive,
    and which sets (M,) are too nearly dependent to say.
    """
    count = W.shape[2]
    G = balance_inverses(np.swapaxes(W, 1, 2))
    lengths = np.linalg.norm(G[..., :-1], axis=2)
    widest = lengths.max(axis=1)
    doubtful = (widest == 0.0) | (widest * tolerances * count >= 1.0)
    return G, G[..., -1] / np.maximum(lengths, 1e-300), doubtful


def _simplex(W: np.ndarray, tolerance: float) -> Balance | None:
    """The closed form for one set; None when it does not say."""
    n = len(W)
    G, distances, doubtful = (one[0] for one in simplices(W[None], np.array([tolerance])))
    if doubtful:
        return None
    j = int(np.argmin(distances))
    if distances[j] > tolerance:
        return Balance(True, G[:, n], None, n, float(distances[j]), False)
    return Balance(False, None, G[j, :n], n, 0.0, bool(distances[j] >= -tolerance))


def _inside(pushes: np.ndarray, sigma: float) -> float:
    """Lower bound of the distance that positive pushes prove; 0 when one is not positive."""
    smallest = float(pushes.min())
    if smallest <= 0.0:
        return 0.0
    t = smallest / float(pushes.sum())
    return t * float(sigma) / float(np.sqrt(1.0 + (len(pushes) - 1) * t * t))


def _least_squares(W: np.ndarray, rows: np.ndarray, sigma: float, tolerance: float) -> Balance:
    """More than ``n + 1`` wrenches of full rank that nearly equal pushes do not balance.

    ``rows`` are orthonormal and span those of ``W``.
    """
    n = len(W)
    pushes = 1.0 + nonnegative_least_squares(W, -W.sum(axis=1))
    pushes /= pushes.sum()
    residual = W @ pushes
    left = float(np.linalg.norm(residual))
    balanced = pushes - (rows @ pushes) @ rows
    bound = _inside(balanced, sigma)
    if bound > tolerance and left <= tolerance:
        return Balance(True, balanced / balanced.sum(), None, n, bound, False)
    if left > tolerance and (residual @ W).min() >= -tolerance * left:
        return Balance(False, None, residual, n, 0.0, not _separated(W, tolerance))
    best = evenest(W, n)
    if best.pushes is not None and best.smallest > 0.0:
        bound = max(_inside(best.pushes, sigma), _hull_radius(W))
        if bound > tolerance:
            return Balance(True, best.pushes, None, n, bound, False)
    direction = residual if best.direction is None else best.direction
    gave_up = best.pushes is not None and best.direction is None
    return Balance(False, None, direction, n, 0.0, gave_up or not _separated(W, tolerance))


def _hull_radius(W: np.ndarray) -> float:
    """Distance of the origin from the facets of the hull, all enumerated; 0 for too many."""
    from scipy.spatial import ConvexHull, QhullError

    if W.shape[1] > ENUMERATED:
        return 0.0
    try:
        return -float(np.max(ConvexHull(W.T).equations[:, -1]))
    except QhullError:  # flat within its precision
        return 0.0


def _separated(W: np.ndarray, tolerance: float) -> bool:
    """Whether some motion leaves all contacts: the origin is clearly outside the hull."""
    away = least_distance(W.T, np.ones(W.shape[1])).direction
    return bool(np.min(away @ W) > tolerance * np.linalg.norm(away))
