r"""All modes tried: the last word on whether there is a solution, one, or several.

Where friction may leave no solution or several (:mod:`multiarm.events.complementarity.uniqueness`),
the answer for a handful of units is found by trying: every unit in every mode, the linear equations
of the modes, the verdict by the residual. Without contacts at zero slip the list is complete:
forces that are not determined by their modes can be moved to a bound, which is another choice of
modes.

A contact at zero slip may begin to slip in any direction. Its directions are started from a ring of
eight and finished by Newton's method: what is so found are solutions, that there are no others is
not proven.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from multiarm.events.complementarity.newton import newton
from multiarm.events.complementarity.problem import Problem
from multiarm.events.complementarity.tolerances import CONSISTENT, RANK, ROUNDING

# Units up to which all modes are tried, and starts up to which directions are.
FEW_UNITS = 8
FEW_STARTS = 300
RING = [np.array([np.cos(a), np.sin(a)]) for a in np.arange(8) * (np.pi / 4.0)]
CLOSED, STICKING = "closed", "sticking"


def few(problem: Problem) -> bool:
    """Whether all modes can be tried."""
    units = len(problem.units)
    return units <= FEW_UNITS and _starts(problem) <= FEW_STARTS


def all_solutions(problem: Problem, known: list[np.ndarray]) -> list[np.ndarray]:
    """Solutions found beside known ones, and these: one for each motion, smallest forces first."""
    found = list(known)
    for z in _candidates(problem):
        # where forces can grow without changing the rates of their own laws, there is a family
        for other in [z, *_along_family(problem, z)]:
            if problem.residual(other) <= 10.0 * ROUNDING and not any(
                same_motion(problem, other, one) for one in found
            ):
                found.append(other)
    return sorted(found, key=lambda z: float(z @ z))


def same_motion(problem: Problem, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two solutions have the same rates in all rows."""
    apart = problem.scale * (problem.D @ (problem.E @ (one - other)))
    size = max(problem.size(one), problem.size(other))
    return bool(np.max(np.abs(apart), initial=0.0) <= CONSISTENT * size)


def _starts(problem: Problem) -> int:
    count = 1
    for choice in _choices(problem):
        count *= len(choice)
    return count


def _choices(problem: Problem) -> list[list]:
    """Modes of each unit: a bound (a number), closed, sticking, or a direction of friction."""
    cones = {cone.normal: cone for cone in problem.cones}
    choices = []
    for k in problem.first:
        bounds = [v for v in (problem.lower[k], problem.upper[k]) if np.isfinite(v)]
        modes: list = [*bounds, CLOSED]
        if k in cones and cones[k].mu > 0.0:
            modes = [0.0, STICKING, *RING]
        choices.append(modes)
    return choices


def _candidates(problem: Problem) -> Iterator[np.ndarray]:
    for modes in product(*_choices(problem)):
        A, c = _equations(problem, modes)
        z = np.linalg.lstsq(A, c, rcond=RANK)[0]
        if any(isinstance(mode, np.ndarray) for mode in modes):
            z = newton(problem, z)
        yield z


def _equations(problem: Problem, modes: tuple) -> tuple[np.ndarray, np.ndarray]:
    """The linear equations of all units in the given modes."""
    n = problem.g.size
    A, c, identity = np.zeros((n, n)), np.zeros(n), np.eye(n)
    cones = {cone.normal: cone for cone in problem.cones}
    for k, mode in zip(problem.first, modes, strict=True):
        if isinstance(mode, float):
            A[k], c[k] = identity[k], mode
        else:
            A[k], c[k] = problem.G[k], -problem.g[k]
        if k not in cones:
            continue
        tangents = cones[k].tangents
        if isinstance(mode, np.ndarray):
            A[tangents] = identity[tangents] - cones[k].mu * np.outer(mode, identity[k])
        elif mode == STICKING:
            A[tangents], c[tangents] = problem.G[tangents], -problem.g[tangents]
        else:
            A[tangents] = identity[tangents]
    return A, c


def _null_space(A: np.ndarray) -> np.ndarray:
    _, values, right = np.linalg.svd(A)
    return right[int(np.sum(values > RANK * max(values[0], 1.0))) :].T


def _along_family(problem: Problem, z: np.ndarray) -> list[np.ndarray]:
    """Forces beside a solution that leave the rates of their own laws as they are."""
    size = problem.size(z)
    touching = np.flatnonzero(np.abs(problem.G @ z + problem.g) <= ROUNDING * size)
    if problem.cones or touching.size == 0:
        return []
    block = _null_space(problem.G[np.ix_(touching, touching)])
    null = np.zeros((z.size, block.shape[1]))
    null[touching] = block
    # with all rates zero, forces have no scale of their own
    step = 0.1 * size or 1.0
    return [z + sign * step * v for v in null.T for sign in (1.0, -1.0)]
