r"""Loop closure: moving onto the joints with the least motion.

*The method* is Levenberg and Marquardt's in the inertia metric.  With the gaps :math:`\varphi`,
their derivative J and the factor L of the inertia (:mod:`multiarm.assembly.linkage`) a step ``u``
solves

.. math:: \min_u\; |\varphi + J u|^2 + \mu\, |L^T u|^2
    \quad\text{within the joints' limits and } |u|_\infty \le \Delta

with the smallest :math:`\mu` that keeps it within the trust region.  As the gaps close
:math:`\mu` falls to a floor far below every singular value that matters, so that the step becomes
Newton's, of least kinetic energy: the method converges quadratically, and needs no decision about
rank where arms are singular or rows redundant (H. Yamashita, M. Fukushima, Computing Suppl. 15,
2001).  Steps are short and must reduce the gaps, so that the path leads from the start to the next
closed posture on its branch.

*Branches.*  A step that would leave an arm's branch is shortened; at the end of a branch it goes
along it.

*Buckling.*  Where no motion reduces the gaps to first order, a flat linkage may still buckle: then
the curvature :math:`\sum_k \varphi_k \nabla^2\varphi_k` on the null space of ``J`` has a negative
eigenvalue, and the path continues along its eigenvector.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from multiarm.assembly.linkage import Linkage, Posture

# Largest radius of the trust region [rad, fractions of the scene's size].
RADIUS = 0.1
# Largest motion of any part altogether [rad, fractions of the scene's size].
FARTHEST = 0.5
MOST_STEPS = 120


class Outcome(Enum):
    """How :func:`close_gaps` ended."""

    CLOSED = "the gaps are closed"
    STUCK = "no motion reduces the gaps"
    FAR = "a part moved too far"
    TOO_SLOW = "gaps were left after the last step"


@dataclass(frozen=True)
class Closing:
    """Result of :func:`close_gaps`; the kinematics at the end are in the data."""

    outcome: Outcome
    changes: np.ndarray  # (k,), magnitude of the displacement in the units of ``u``

    @property
    def closed(self) -> bool:
        """Whether the gaps are closed."""
        return self.outcome is Outcome.CLOSED

    @property
    def change(self) -> float:
        """Largest change [rad, fractions of the scene's size]."""
        return float(np.max(self.changes))


def close_gaps(linkage: Linkage, tolerance: float) -> Closing:
    """Close the gaps of a linkage, from the posture in the data (with its kinematics).

    Parameters
    ----------
    tolerance : float
        Largest gap that counts as closed [m].

    Raises
    ------
    SolverError
        When the inertia of an arm is not positive definite.
    """
    begin = posture = linkage.posture()
    radius, crossings, ranks = RADIUS, 0, linkage.branches(begin)
    guards = np.zeros((0, linkage.unit.size))
    outcome = Outcome.TOO_SLOW
    for _ in range(MOST_STEPS):
        if posture.worst <= tolerance:
            outcome = Outcome.CLOSED
            break
        if np.max(linkage.changes(begin, posture)) > FARTHEST:
            outcome = Outcome.FAR
            break
        u = _step(posture, guards, radius, *linkage.room(posture))
        promised = 1.0 - (np.linalg.norm(posture.gaps + posture.rows @ u) / posture.norm) ** 2
        if not promised > 1e-8:  # of the squared gaps
            out = None if guards.size else _buckled(linkage, posture)
            if out is None:
                outcome = Outcome.STUCK
                break
            posture, radius = out, RADIUS
            continue
        trial = linkage.moved(posture, u)
        progress = -1.0 if trial is None else (1.0 - (trial.norm / posture.norm) ** 2) / promised
        if trial is None or not (progress >= 0.1 or trial.worst <= tolerance):
            radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        ends = linkage.branch_ends(posture, trial, ranks)
        if ends:
            crossings += 1
            # three steps that would leave the branch are shortened, later ones led along its end
            if crossings > 3 and not guards.size:
                guards = np.array([linkage.guard(posture, k, ranks[k]) for k in ends])
            else:
                radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        posture, guards = trial, guards[:0]
        if progress > 0.5:
            radius = min(RADIUS, 2.0 * radius)
    linkage.place(posture)
    return Closing(outcome, linkage.changes(begin, posture))


def _step(
    posture: Posture, guards: np.ndarray, radius: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Levenberg and Marquardt's step (k,) within radius and bounds, normal to the ``guards``."""
    heavy = 1e3 * np.linalg.norm(posture.rows) * guards
    rows, gaps = np.vstack([posture.rows, heavy]), np.append(posture.gaps, np.zeros(len(guards)))
    U, s, Vt = np.linalg.svd(np.linalg.solve(posture.factor, rows.T).T, full_matrices=False)
    back = np.linalg.solve(posture.factor.T, Vt.T)  # (k, r)
    target, mu = -U.T @ gaps, (1e-9 * s[0]) ** 2
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


def _buckled(linkage: Linkage, posture: Posture) -> Posture | None:
    """A posture on the path along which a flat linkage buckles, if there is one.

    Both directions are equal; the one in which the farthest moving part grows is taken.
    """
    probe = 1e-4  # displacement over which the curvature is measured
    _, s, Vt = np.linalg.svd(posture.rows)
    null = Vt[int(np.sum(s > 1e-6 * s[0])) :]
    curvature = np.zeros((len(null), len(null)))
    for column, v in enumerate(null):
        sides = [linkage.moved(posture, h * v) for h in (probe, -probe)]
        if sides[0] is None or sides[1] is None:
            return None
        slope = (sides[0].rows - sides[1].rows).T @ posture.gaps / (2 * probe)
        curvature[:, column] = null @ slope
    if not len(null):
        return None
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    if not values[0] < -1e-6 * posture.norm * linkage.size:
        return None
    way = vectors[:, 0] @ null
    way *= np.sign(way[np.argmax(np.abs(way))]) / np.max(np.abs(way))
    length = min(RADIUS, 2.0 * posture.norm / np.sqrt(-values[0]))
    low, high = linkage.room(posture)
    for _ in range(40):
        for u in (length * way, -length * way):
            trial = linkage.moved(posture, u) if np.all((low <= u) & (u <= high)) else None
            if trial is not None and trial.norm < 0.9 * posture.norm:
                return trial
        length *= 0.7
    return None
