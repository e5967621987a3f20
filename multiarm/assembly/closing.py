r"""Closing gaps with the least motion: Levenberg and Marquardt's method in the inertia metric.

A step ``u`` of a :class:`multiarm.assembly.linkage.Linkage` solves

.. math:: \min_u\; |\varphi + J u|^2 + \mu\, |L^T u|^2
    \quad\text{within the joints' limits and } |u|_\infty \le \Delta

with the smallest :math:`\mu` that keeps it within the trust region.  As the gaps close
:math:`\mu` falls to a floor far below every singular value that matters, so that the step becomes
Newton's, of least kinetic energy: the method converges quadratically, and needs no decision about
rank where arms are singular or rows redundant (H. Yamashita, M. Fukushima, Computing Suppl. 15,
2001).  Steps are short and must lessen the gaps, so that the path leads from the start to the next
closed posture on its branch; at the end of a branch (see :mod:`multiarm.assembly.linkage`) a step
goes along it, not across.

Where the gaps that are left cannot be lessened to first order, a flat linkage may still buckle:
then the curvature :math:`\sum_k \varphi_k \nabla^2\varphi_k` on the null space of ``J`` has a
negative eigenvalue, along whose vector the path goes on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.assembly.linkage import Linkage, Posture

CLOSED, STUCK, FAR = "closed", "stuck", "far"

# Radius of the trust region [rad, fractions of the scene's size].
RADIUS = 0.1
# Nothing may move farther than this altogether [rad, fractions of the scene's size].
FARTHEST = 0.5
# Root of the smallest mu, relative to the largest singular value of the whitened J.
FLOOR = 1e-9
# Steps that promise less than this part of the squared gaps lead nowhere.
STATIONARY = 1e-8
# Of what a step promises it must keep this part.
KEPT = 0.1
# Relative singular values of J below this span the null space in which a flat linkage buckles.
FLAT = 1e-6
_CURVED = 1e-6  # negative curvature, relative to the gap and the scene's size
_PROBE = 1e-4  # displacement over which the curvature is measured
_TRIALS = 120
_CROSSINGS = (
    3  # so many steps that would leave the branch are shortened, later ones led along its end
)
_GUARD_WEIGHT = 1e3


@dataclass(frozen=True)
class Closing:
    """How it ended; the place is in the data.

    Attributes
    ----------
    status : str
        ``CLOSED``, ``STUCK`` where gaps cannot be lessened, or ``FAR``: something moved too far.
    posture : Posture
        The place that was reached.
    changes : ndarray, shape (k,)
        How far everything moved, in the units of ``u``.
    """

    status: str
    posture: Posture
    changes: np.ndarray

    @property
    def change(self) -> float:
        """Largest change [rad, fractions of the scene's size]."""
        return float(np.max(self.changes))


def close_gaps(linkage: Linkage, tolerance: float) -> Closing:
    """Close the gaps of a linkage, from the place in the data (kinematics included).

    Parameters
    ----------
    tolerance : float
        Largest gap that counts as closed [m].

    Raises
    ------
    SolverError
        When the inertia of an arm is not positive definite.
    """
    begin = here = linkage.here()
    radius, crossings, ranks = RADIUS, 0, linkage.branches(begin)
    guards = np.zeros((0, linkage.unit.size))
    status = STUCK
    for _ in range(_TRIALS):
        if here.worst <= tolerance:
            status = CLOSED
            break
        if np.max(linkage.changes(begin, here)) > FARTHEST:
            status = FAR
            break
        u = _step(here, guards, radius, *linkage.room(here))
        promised = 1.0 - (np.linalg.norm(here.gaps + here.rows @ u) / here.norm) ** 2
        if not promised > STATIONARY:
            out = None if guards.size else _buckled(linkage, here)
            if out is None:
                break
            here, radius = out, RADIUS
            continue
        there = linkage.moved(here, u)
        kept = -1.0 if there is None else (1.0 - (there.norm / here.norm) ** 2) / promised
        if there is None or not (kept >= KEPT or there.worst <= tolerance):
            radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        ends = linkage.branch_ends(here, there, ranks)
        if ends:
            crossings += 1
            if crossings > _CROSSINGS and not guards.size:
                guards = np.array([linkage.guard(here, k, ranks[k]) for k in ends])
            else:
                radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        here, guards = there, guards[:0]
        if kept > 0.5:
            radius = min(RADIUS, 2.0 * radius)
    linkage.place(here)
    return Closing(status, here, linkage.changes(begin, here))


def _step(
    posture: Posture, guards: np.ndarray, radius: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Levenberg and Marquardt's step (k,) within radius and room, across the ``guards``."""
    heavy = _GUARD_WEIGHT * np.linalg.norm(posture.rows) * guards
    rows, gaps = np.vstack([posture.rows, heavy]), np.append(posture.gaps, np.zeros(len(guards)))
    U, s, Vt = np.linalg.svd(np.linalg.solve(posture.factor, rows.T).T, full_matrices=False)
    back = np.linalg.solve(posture.factor.T, Vt.T)  # (k, r)
    target, mu = -U.T @ gaps, (FLOOR * s[0]) ** 2
    if not s[0] > 0.0:
        return np.zeros(low.size)
    u = back @ (s / (s * s + mu) * target)
    while np.max(np.abs(u)) > radius:
        mu *= 2.0
        u = back @ (s / (s * s + mu) * target)
    if np.all(u >= low) and np.all(u <= high):
        return u
    from scipy.optimize import lsq_linear

    bounds = np.maximum(low, -radius), np.minimum(high, radius)
    matrix = np.vstack([rows, np.sqrt(mu) * posture.factor.T])
    right = np.append(-gaps, np.zeros(low.size))
    return np.clip(lsq_linear(matrix, right, bounds, method="bvls").x, *bounds)


def _buckled(linkage: Linkage, here: Posture) -> Posture | None:
    """The posture a little further along the way on which a flat linkage buckles, if there is one.

    Both ways out are equal; the one on which the farthest moving part grows is taken.
    """
    _, s, Vt = np.linalg.svd(here.rows)
    null = Vt[int(np.sum(s > FLAT * s[0])) :]
    curvature = np.zeros((len(null), len(null)))
    for column, v in enumerate(null):
        sides = [linkage.moved(here, h * v) for h in (_PROBE, -_PROBE)]
        if sides[0] is None or sides[1] is None:
            return None
        slope = (sides[0].rows - sides[1].rows).T @ here.gaps / (2 * _PROBE)
        curvature[:, column] = null @ slope
    if not len(null):
        return None
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    if not values[0] < -_CURVED * here.norm * linkage.size:
        return None
    way = vectors[:, 0] @ null
    way *= np.sign(way[np.argmax(np.abs(way))]) / np.max(np.abs(way))
    length = min(RADIUS, 2.0 * here.norm / np.sqrt(-values[0]))
    low, high = linkage.room(here)
    for _ in range(40):
        for u in (length * way, -length * way):
            there = linkage.moved(here, u) if np.all((low <= u) & (u <= high)) else None
            if there is not None and there.norm < 0.9 * here.norm:
                return there
        length *= 0.7
    return None
