"""The first event inside a step: where a guard changes its sign."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from multiarm.events.arrays import QUIET

# Fractions of the step at which guards are looked at before roots are refined.
GRID = np.linspace(0.0, 1.0, 9)
# Events this close together, as a fraction of the step, are one.
TOGETHER = 1e-9
ROOT_TOLERANCE = 1e-14


def first_event(
    values: Callable[[float], np.ndarray], found: np.ndarray, levels: np.ndarray
) -> tuple[float, list[int]]:
    """Fraction of the step at which the first guard changes its sign, and which guards do there.

    Parameters
    ----------
    values : callable
        All guards as a function of the fraction.
    found : ndarray of int
        What each guard found in the step, see :mod:`multiarm.events.arrays`.
    levels : ndarray
        Values of that size are zero: a guard may begin there, and grow before it falls.

    Returns
    -------
    theta : float
        1 when there is none.
    guards : list of int
    """
    course = np.array([values(theta) for theta in GRID])
    roots: dict[int, float] = {}
    for g in map(int, np.flatnonzero(found != QUIET)):
        root = _root(partial(_value, values, g), course[:, g], float(levels[g]))
        if root is not None:
            roots[g] = root
    if not roots:
        return 1.0, []
    theta = min(roots.values())
    return theta, [g for g, root in roots.items() if root <= theta + TOGETHER]


def _value(values: Callable[[float], np.ndarray], g: int, theta: float) -> float:
    return float(values(theta)[g])


def _root(value: Callable[[float], float], course: np.ndarray, level: float) -> float | None:
    """Where a guard falls through zero for the first time; 0 when it was never above."""
    from scipy.optimize import brentq, minimize_scalar

    above = np.flatnonzero(course > level)
    if not above.size:
        return 0.0 if course[-1] < -level else None
    below = np.flatnonzero(course[above[0] :] < 0.0) + above[0]
    if below.size:
        before = above[above < below[0]][-1]
        return float(brentq(value, GRID[before], GRID[below[0]], xtol=ROOT_TOLERANCE))
    lowest = above[0] + int(np.argmin(course[above[0] :]))
    left, right = GRID[max(lowest - 1, 0)], GRID[min(lowest + 1, len(GRID) - 1)]
    best = minimize_scalar(value, bounds=(left, right), method="bounded", options={"xatol": 1e-6})
    if best.fun < 0.0 < value(left):
        return float(brentq(value, left, float(best.x), xtol=ROOT_TOLERANCE))
    return None
