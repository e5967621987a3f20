r"""Newton's method on the exact laws: finds the modes, and the forces to the last digit.

The laws hold where the natural map is zero,

.. math:: \Phi(z) = z - P(z - w(z)), \qquad w = G z + g,

P the projection on bounds and on the disk :math:`|z_t| \le \mu p_n` of each contact. At a given z
the argument :math:`p = z - w` says in which mode every unit is, and the equation of that mode is
linear (open: z = bound; closed, sticking: w = 0) or, for a contact that begins to slip in a
direction not yet known, smooth:

.. math:: z_t = \mu p_n d, \qquad d = p_t / |p_t|, \qquad
          \delta d = \frac{1 - d d^T}{|p_t|} \, \delta p_t .

A step solves the equations of the present modes. Once the modes are right it is exact, or converges
quadratically (Alart and Curnier, CMAME 92, 1991). It may also run in circles: then sweeps of
Gauss-Seidel with projection, slow but steady, give another start. Whatever happens on the way, the
residual alone decides what is a solution.
"""

from __future__ import annotations

import numpy as np

from multiarm.events.complementarity.problem import Cone, Problem
from multiarm.events.complementarity.tolerances import RANK, ROUNDING

STEPS = 25
# Forces of this many times the scale are on their way to infinity.
BEYOND = 1e12
# Sweeps before each attempt, after the first from no force at all.
SWEEPS = (0, 10, 100, 1000)


def iterate(problem: Problem) -> np.ndarray:
    """Independent forces of a solution, or the best found; the residual tells which."""
    z = best = problem.without_force()
    for sweeps in SWEEPS:
        z = sweep(problem, z, sweeps)
        found = newton(problem, z)
        if problem.residual(found) < problem.residual(best):
            best = found
        if problem.residual(best) <= ROUNDING:
            break
    return best


def newton(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Steps from a start until the residual is zero but for rounding; the best point met."""
    best, least = z, problem.residual(z)
    for _ in range(STEPS):
        A, r = linearise(problem, z)
        z = z - np.linalg.lstsq(A, r, rcond=RANK)[0]
        residual = problem.residual(z)
        if not np.isfinite(residual):
            break
        settled = residual <= ROUNDING and residual >= 0.1 * least
        if residual < least:
            best, least = z, residual
        if settled or least == 0.0:
            break
    return best


def linearise(problem: Problem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and value of the equations of the present modes."""
    G, lower, upper = problem.G, problem.lower, problem.upper
    w = G @ z + problem.g
    p = z - w
    bounded = np.clip(p, lower, upper)
    at_bound = bounded != p
    identity = np.eye(z.size)
    A = np.where(at_bound[:, None], identity, G)
    r = np.where(at_bound, z - bounded, w)
    for cone in problem.cones:
        tangents = cone.tangents
        radius, length = cone.mu * max(p[cone.normal], 0.0), np.hypot(*p[tangents])
        if radius == 0.0:
            A[tangents], r[tangents] = identity[tangents], z[tangents]
        elif length > radius:
            A[tangents], r[tangents] = _slip(cone, G, z, p)
    return A, r


def _slip(cone: Cone, G: np.ndarray, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a contact that begins to slip, its direction among the unknowns."""
    tangents, length = cone.tangents, np.hypot(*p[cone.tangents])
    d, radius = p[tangents] / length, cone.mu * p[cone.normal]
    dp = np.eye(z.size) - G
    turn = (radius / length) * (np.eye(2) - np.outer(d, d))
    rows = np.eye(z.size)[tangents] - cone.mu * np.outer(d, dp[cone.normal]) - turn @ dp[tangents]
    return rows, z[tangents] - radius * d


def sweep(problem: Problem, z: np.ndarray, sweeps: int) -> np.ndarray:
    """Gauss-Seidel: one force after the other set to what its law asks, the others as they are."""
    G, g, lower, upper = problem.G, problem.g, problem.lower, problem.upper
    z = z.copy()
    in_cones = {k for cone in problem.cones for k in range(cone.normal + 1, cone.normal + 3)}
    single = [k for k in range(z.size) if k not in in_cones and G[k, k] > RANK]
    blocks = [(cone, _stiffest(G[cone.tangents, cone.tangents])) for cone in problem.cones]
    ceiling = BEYOND * problem.size(z)
    for _ in range(sweeps):
        if not np.max(np.abs(z), initial=0.0) <= ceiling:
            break  # friction feeds itself: Gauss-Seidel diverges
        for k in single:
            z[k] = min(max(z[k] - (G[k] @ z + g[k]) / G[k, k], lower[k]), upper[k])
        for cone, stiffest in blocks:
            tangents, radius = cone.tangents, cone.mu * z[cone.normal]
            p = z[tangents] - (G[tangents] @ z + g[tangents]) / stiffest
            z[tangents] = p * min(1.0, radius / max(np.hypot(*p), np.finfo(float).tiny))
    return z


def _stiffest(block: np.ndarray) -> float:
    """Largest eigenvalue of the response of two tangents; one where nothing responds."""
    return float(np.linalg.eigvalsh(block)[-1]) or 1.0
