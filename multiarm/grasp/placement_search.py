"""Good placements of seven contacts by trying: differential evolution that stays in the regions.

A trial goes from a placement towards the best one and along the difference of two others, and stops
where it would leave a region. Nothing here is a proof; bounds come from elsewhere.

Reference: Storn, Price, "Differential evolution", Journal of Global Optimization 11, 1997.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multiarm.grasp.seven_touches import SevenTouches

# Weights of the way to the best placement and of the difference of two others, at most.
TO_BEST, DIFFERENCE = 1.5, 1.0
# Chance that a contact takes part in a trial.
TAKING_PART = 0.25


def evolved(
    scores: Callable[[np.ndarray], np.ndarray],
    touches: SevenTouches,
    starts: np.ndarray,
    rng: np.random.Generator,
    generations: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Placements (M, 7, 2) grown from ``starts`` (M, 7, 2) and their scores, best first."""
    y, value = starts.copy(), scores(starts)
    count = len(y)
    for _ in range(generations):
        best = y[rng.choice(np.argsort(-value)[: max(1, count // 10)], count)]
        a, b = y[rng.permutation(count)], y[rng.permutation(count)]
        pull = TO_BEST * rng.random((count, 1, 1)) * (best - y)
        spread = DIFFERENCE * rng.random((count, 1, 1)) * (a - b)
        chosen = rng.random((count, 7, 1)) < TAKING_PART
        trial = touches.towards(y, np.where(chosen, y + pull + spread, y))
        found = scores(trial)
        better = found > value
        y[better], value[better] = trial[better], found[better]
    order = np.argsort(-value, kind="stable")
    return y[order], value[order]


def nearest(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """Smallest distance between two contacts, scaled, shape (M,)."""
    p = touches.points(y)
    i, j = np.triu_indices(7, 1)
    return np.linalg.norm(p[:, i] - p[:, j], axis=2).min(axis=1)


def conditioning(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """Smallest over largest singular value of wrenches scaled by the contacts' spread, (M,)."""
    p = touches.points(y)
    arms = p - p.mean(axis=1, keepdims=True)
    length = np.sqrt(np.mean(np.sum(arms**2, axis=2), axis=1))
    e = np.broadcast_to(touches.normals, p.shape)
    W = np.concatenate([e, np.cross(arms, e) / length[:, None, None]], axis=2)
    s = np.linalg.svd(W, compute_uv=False)
    return s[:, -1] / s[:, 0]
