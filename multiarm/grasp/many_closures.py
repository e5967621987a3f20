r"""Form closure of many sets of contacts at once, for searches and for random changes.

The same decision as :func:`multiarm.grasp.form_closure.is_form_closure`, without the proofs: for
sets of seven contacts in space, or four in the plane, one batch of small inverses (see
:mod:`multiarm.grasp.balances`), microseconds for each set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.balances import BAND, Balance, balance, rounding
from multiarm.grasp.contacts import UNIT_TOLERANCE, wrenches_of

# Sets whose wrenches are assembled together: memory stays small.
CHUNK = 20_000


@dataclass(frozen=True, eq=False)
class ManyClosures:
    """Verdicts on M sets of contacts.

    Attributes
    ----------
    closed : ndarray of bool, shape (M,)
    distances : ndarray, shape (M,)
        Closure survives every change of each scaled wrench by less than this; 0 when open.
    borderline : ndarray of bool, shape (M,)
        Open, but within the tolerance of closure.
    """

    closed: np.ndarray
    distances: np.ndarray
    borderline: np.ndarray

    def __len__(self) -> int:
        return len(self.closed)


def closed_many(points: Any, normals: Any) -> ManyClosures:
    """Decide M sets of N contacts each.

    Parameters
    ----------
    points : array-like, shape (M, N, 3) or (M, N, 2)
        [m]
    normals : array-like, same shape
        Unit vectors into the body.

    Raises
    ------
    GraspError
        Shapes that do not match, numbers that are not finite, normals that are not of unit length.
    """
    p, e = _checked(points, normals)
    count, n = p.shape[1], 6 if p.shape[2] == 3 else 3
    closed, borderline = np.zeros(len(p), dtype=bool), np.zeros(len(p), dtype=bool)
    distances = np.zeros(len(p))
    for first in range(0, len(p), CHUNK):
        part = slice(first, first + CHUNK)
        W, floors = _scaled(p[part], e[part])
        if count == n + 1:
            inside, doubtful = _simplices(W, BAND + floors)
            closed[part] = inside > BAND + floors
            borderline[part] = np.abs(inside) <= BAND + floors
            distances[part] = np.where(closed[part], inside, 0.0)
        else:
            doubtful = np.arange(len(W))
        for j in doubtful:
            found: Balance = balance(W[j], float(floors[j]))
            closed[first + j], borderline[first + j] = found.closed, found.borderline
            distances[first + j] = found.distance
    return ManyClosures(closed, distances, borderline)


def _checked(points: Any, normals: Any) -> tuple[np.ndarray, np.ndarray]:
    try:
        p, e = np.asarray(points, dtype=float), np.asarray(normals, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError("points and normals are arrays (M, N, 3) or (M, N, 2)") from error
    if p.ndim != 3 or p.shape != e.shape or p.shape[1] == 0 or p.shape[2] not in (2, 3):
        raise GraspError(
            f"M sets of N contacts have points and normals of shape (M, N, 3) in space or "
            f"(M, N, 2) in the plane, not {p.shape} and {e.shape}"
        )
    lengths = np.linalg.norm(e, axis=2)
    wrong = ~(np.abs(lengths - 1.0) <= UNIT_TOLERANCE) | ~np.isfinite(p).all(axis=2)
    if wrong.any():
        m, j = np.argwhere(wrong)[0]
        raise GraspError(
            f"contact {j + 1} of set {m + 1}, at {p[m, j].tolist()} with the normal "
            f"{e[m, j].tolist()}: numbers must be finite and normals of length 1"
        )
    return p, e / lengths[..., None]


def _scaled(p: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (M, n, N) about the middle of each set, moments over its spread; their rounding."""
    arms = p - p.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.mean(np.sum(arms**2, axis=2), axis=1))
    length = np.where(spread > 0.0, spread, 1.0)
    W = np.moveaxis(wrenches_of(arms / length[:, None, None], e), 0, 1)
    reach = np.abs(p).max(axis=(1, 2))
    return W, rounding(reach, length)


def _simplices(W: np.ndarray, tolerances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances of the origin inside M simplices, and which of them are too flat to say."""
    sets, n, count = W.shape
    square = np.ones((sets, count, count))
    square[:, :n] = W
    flat = np.linalg.slogdet(square)[0] == 0.0
    square[flat] = np.eye(count)
    G = np.linalg.inv(square)
    lengths = np.linalg.norm(G[..., :n], axis=2)
    inside = np.min(G[..., n] / np.maximum(lengths, 1e-300), axis=1)
    flat |= lengths.max(axis=1) * tolerances * count >= 1.0
    return inside, np.flatnonzero(flat)
