r"""Central forces: of all forces of one motion that obey the contact laws, some inside all bounds.

Where rows in contact depend on each other, forces of many sizes have the same motion, and those of
minimum norm may be at a bound that others are far from: a run that watches them would have an event
there without any change of the motion.  With v the unknown forces of the rows in contact
(:class:`~multiarm.events.complementarity.active_set.Unknowns`), :math:`v = v_0 + N q` those of the
given motion, :math:`\sigma` the size of the largest and :math:`m_k(v)` what is left to the bounds,
central forces are

.. math:: \min_q \; \tfrac12 |v|^2 - \sigma^2 \sum_k \log m_k(v) ,

with :math:`\mu^2 v_n^2 - |v_t|^2` for m of a cone.  Newton's method begins where all m are
positive; the same barriers find such forces first, by :math:`\max s` with :math:`m_k(v) \ge s`.

Source: S. Boyd, L. Vandenberghe, *Convex Optimization*, Cambridge 2004, 9.5 and 11.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.factors import rank_of
from multiarm.events.complementarity.active_set import ActiveSet, LawMode, Unknowns, law_modes
from multiarm.events.complementarity.problem import (
    CONSISTENT,
    RANK,
    Bounded,
    ContactMode,
    Friction,
    Problem,
    matrix_rank,
)

# Forces that leave less than this part of the largest to a bound are at the bound.
LEAST_MARGIN = 1e-6
NEWTON_STEPS = 60
# Newton's method ends where half the square of the decrement, in sigma squared, is below.
SETTLED, ROUGHLY_SETTLED = 1e-10, 0.1
# While forces inside of the bounds are looked for: weight of their size, and that of s for each of
# the logarithms; less would push the forces far away first.
SIZE_WEIGHT, FIRST_WEIGHT = 1e-3, 10.0


def central_set(problem: Problem, z: np.ndarray) -> ActiveSet | None:
    """All rows in contact, and central forces with the motion of a solution.

    None where the motion determines all forces, or some are at their bounds with all of them.
    """
    modes = law_modes(problem, z)
    unknowns = Unknowns(problem, modes)
    if not unknowns.rows:
        return None
    x, s = problem.E @ z, problem.scale
    weights = s[unknowns.rows]
    response = s[:, None] * problem.D @ unknowns.B * weights
    if unknowns.tied and matrix_rank(response[unknowns.rows]) != matrix_rank(response):
        return None
    left, values, right = np.linalg.svd(response, full_matrices=True)
    r = rank_of(values, RANK, 1.0)
    if r == weights.size:
        return None
    motion, v = s * (problem.D @ (x - unknowns.fixed)), x[unknowns.rows] / weights
    v = v - right[:r].T @ ((left[:, :r].T @ (response @ v - motion)) / values[:r])
    if np.max(np.abs(response @ v - motion)) > CONSISTENT * problem.size(z):
        return None
    central = _centre(_margins(problem, modes, unknowns, weights), v, right[r:].T)
    if central is None:
        return None
    forces = unknowns.fixed + unknowns.B @ (weights * central)
    return ActiveSet(forces, modes, tuple(sorted(unknowns.rows)))


class _Cone(NamedTuple):
    """Places of a contact's forces among the unknown ones, and its scaled coefficient."""

    normal: int
    tangents: tuple[int, int]
    mu: float


class _Margins(NamedTuple):
    """What forces leave to their bounds: ``A v + c``, and of cones ``mu v_n - |v_t|``."""

    A: np.ndarray
    c: np.ndarray
    cones: list[_Cone]

    def least(self, v: np.ndarray) -> float:
        """The smallest."""
        of_bounds = np.min(self.A @ v + self.c, initial=np.inf)
        of_cones = [
            cone.mu * v[cone.normal] - np.hypot(*v[[*cone.tangents]]) for cone in self.cones
        ]
        return float(min([of_bounds, *of_cones]))

    def barrier(self, v: np.ndarray, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Hessian by (v, s) of the sum of logarithms of what is left above s."""
        count = v.size + 1
        m, rows = self.A @ v + self.c - s, np.hstack([self.A, -np.ones((self.c.size, 1))])
        gradient, hessian = rows.T @ (1.0 / m), -rows.T @ (rows / m[:, None] ** 2)
        for cone in self.cones:
            places = [cone.normal, *cone.tangents, count - 1]
            top, t = cone.mu * v[cone.normal] - s, v[[*cone.tangents]]
            q = top * top - t @ t
            by_top = np.array([cone.mu, 0.0, 0.0, -1.0])
            slope = 2.0 * (top * by_top - np.array([0.0, *t, 0.0]))
            curvature = 2.0 * (np.outer(by_top, by_top) - np.diag([0.0, 1.0, 1.0, 0.0]))
            gradient[places] += slope / q
            hessian[np.ix_(places, places)] += curvature / q - np.outer(slope, slope) / q**2
        return gradient, hessian


def _margins(
    problem: Problem, modes: tuple[LawMode, ...], unknowns: Unknowns, weights: np.ndarray
) -> _Margins:
    """The bounds of the unknown forces, in units of ``weights``."""
    place = {row: k for k, row in enumerate(unknowns.rows)}
    identity, A, c, cones = np.eye(len(place)), [], [], []
    for law, (mode, _) in zip(problem.laws, modes, strict=True):
        if law.row not in place:
            continue
        k = place[law.row]
        if mode == ContactMode.STICKING and isinstance(law, Friction):
            tangents = place[law.tangents[0]], place[law.tangents[1]]
            cones.append(_Cone(k, tangents, law.mu * weights[k] / weights[tangents[0]]))
            continue
        lower, upper = (law.lower, law.upper) if isinstance(law, Bounded) else (0.0, np.inf)
        for sign, bound in ((1.0, lower), (-1.0, upper)):
            if np.isfinite(bound):
                A.append(sign * identity[k])
                c.append(-sign * bound / weights[k])
    return _Margins(np.array(A).reshape(-1, len(place)), np.array(c), cones)


def _centre(margins: _Margins, v: np.ndarray, N: np.ndarray) -> np.ndarray | None:
    """The central forces among ``v + N q``; None where none are inside of all bounds."""
    sigma = float(np.max(np.abs(v), initial=0.0))
    if sigma == 0.0:
        return None
    inside: np.ndarray | None = v
    if margins.least(v) <= LEAST_MARGIN * sigma:
        inside = _inside(margins, v, N, sigma)
    if inside is None:
        return None
    v, count = inside, v.size
    for _ in range(NEWTON_STEPS):
        gradient, hessian = margins.barrier(v, 0.0)
        g = N.T @ (v / sigma**2 - gradient[:count])
        H = N.T @ (np.eye(count) / sigma**2 - hessian[:count, :count]) @ N
        dq = np.linalg.solve(H, -g)
        decrement = float(-g @ dq)
        v, _ = _step(margins, v, 0.0, N @ dq, 0.0, decrement)
        if decrement < SETTLED:
            break
    return v


def _inside(margins: _Margins, v: np.ndarray, N: np.ndarray, sigma: float) -> np.ndarray | None:
    """Forces inside of all bounds; None where there are none."""
    enough, count = LEAST_MARGIN * sigma, v.size
    logarithms = margins.c.size + 2 * len(margins.cones)
    s, weight = margins.least(v) - 0.1 * sigma, FIRST_WEIGHT * logarithms
    for _ in range(2 * NEWTON_STEPS):
        gradient, hessian = margins.barrier(v, s)
        size = SIZE_WEIGHT / sigma**2
        g = np.append(N.T @ (size * v - gradient[:count]), -weight / sigma - gradient[count])
        cross = -N.T @ hessian[:count, count]
        H = np.block(
            [
                [N.T @ (size * np.eye(count) - hessian[:count, :count]) @ N, cross[:, None]],
                [cross[None], -hessian[count:, count:]],
            ]
        )
        d = np.linalg.solve(H, -g)
        decrement = float(-g @ d)
        v, s = _step(margins, v, s, N @ d[:-1], float(d[-1]), decrement)
        if s > enough:
            return v
        if decrement < ROUGHLY_SETTLED:
            # the largest s is less than twice the gap of duality above this one
            if s + 2.0 * logarithms * sigma / weight < enough:
                return None
            weight *= 10.0
    return None


def _step(
    margins: _Margins, v: np.ndarray, s: float, dv: np.ndarray, ds: float, decrement: float
) -> tuple[np.ndarray, float]:
    """A damped step of Newton's method, which stays inside of the bounds."""
    part = 1.0
    if decrement > 0.0625 or not margins.least(v + dv) > s + ds:
        part = 1.0 / (1.0 + np.sqrt(max(decrement, 0.0)))
    while part > 1e-12 and not margins.least(v + part * dv) > s + part * ds:
        part *= 0.5
    return v + part * dv, s + part * ds
