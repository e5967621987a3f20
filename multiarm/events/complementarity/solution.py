"""From a response and contact laws to what happens: forces, modes, active rows, and how sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from multiarm.events.complementarity.active_set import ActiveSet, active_set, modes_of
from multiarm.events.complementarity.problem import (
    MARGIN,
    ROUNDING,
    ContactLaw,
    ContactMode,
    Problem,
    build,
)
from multiarm.events.complementarity.solvers import iterate, solve_box
from multiarm.events.complementarity.uniqueness import Motion, all_solutions, few, judge


class Verdict(str, Enum):
    """How many motions there are."""

    UNIQUE = "unique"
    """One, proven: there is no friction, or its response is adequate, or all modes were tried."""
    FOUND = "found"
    """At least one; that there is no other was neither proven nor is there a sign against it."""
    SEVERAL = "not unique"
    """Several: the one with the smallest forces is given, the others are the alternatives."""
    NONE = "none"
    """None, or none was found; what is given is the nearest to one, and the message says which."""


@dataclass(frozen=True)
class Alternative:
    """Another solution with another motion; attributes as in :class:`Solution`."""

    forces: np.ndarray
    rates: np.ndarray
    modes: tuple[ContactMode, ...]


@dataclass(frozen=True)
class Solution:
    """Forces and rates of all rows, and what each law does from now on.

    Attributes
    ----------
    forces : ndarray, shape (m,)
        ``x`` [N] or [N m], or impulses [N s] or [N m s]. Where they are not determined, those of
        minimum norm in these units, as they are, among those that obey the laws: over the rows of
        laws without friction at its bound, and over the normal rows of laws with it there.
    rates : ndarray, shape (m,)
        ``y = D x + b``: accelerations, or velocities after an impact.
    modes : tuple of ContactMode
        One for each law.
    directions : ndarray, shape (laws, 2)
        Unit vector of the slip of contacts that slide; zero for all others.
    active_rows : tuple of int
        Rows to keep at rate zero from now on, increasing. The minimum-norm forces that do so (with
        friction tied to the normal force of contacts that slide, and bounds as constants) are
        ``forces``: they obey the laws with a margin, and the motion is that of all rows.
    forces_unique : bool
        Whether the rows in contact are independent, so that the motion determines all forces.
    residual : float
        Largest violation of any law, as a part of the largest sum of absolute terms in any rate,
        both in rows scaled by the root of their response: dimensionless.
    verdict : Verdict
        How many motions there are.
    alternatives : tuple of Alternative
        Other motions, when there are several.
    message : str
        The name of the trouble, and where; empty when there is none.
    """

    forces: np.ndarray
    rates: np.ndarray
    modes: tuple[ContactMode, ...]
    directions: np.ndarray
    active_rows: tuple[int, ...]
    forces_unique: bool
    residual: float
    verdict: Verdict
    alternatives: tuple[Alternative, ...]
    message: str


def solve(response: np.ndarray, free: np.ndarray, laws: Sequence[ContactLaw]) -> Solution:
    """Which contacts push, slide, stick or open.

    Parameters
    ----------
    response : ndarray, shape (m, m)
        ``D``: rates of all rows to unit forces, symmetric and positive semidefinite [1/kg],
        [1/(kg m^2)] or between.
    free : ndarray, shape (m,)
        ``b``: rates without these forces, accelerations; of an impact velocities, of normal rows
        ``v + e v`` with the restitution e, so that y is ``v_after + e v_before``.
    laws : sequence of Push, Bounded, Friction or Sliding
        Contact laws; every row belongs to exactly one.

    Returns
    -------
    Solution
        Forces, rates, modes, active rows; its residual, verdict and message certify it.
    """
    D, b = np.asarray(response, dtype=float), np.asarray(free, dtype=float)
    m = b.size
    assert D.shape == (m, m) and b.shape == (m,), "shapes of response and free rates"
    assert np.all(np.isfinite(D)) and np.all(np.isfinite(b)), "numbers are finite"
    assert np.allclose(D, D.T, rtol=0.0, atol=1e-9 * np.max(np.abs(D), initial=0.0)), "symmetric"
    problem = build((D + D.T) / 2.0, b, laws)
    (z, *others), verdict, message = _solutions(problem)
    if verdict == Verdict.NONE:
        chosen = ActiveSet(problem.E @ z, modes_of(problem, z))
    else:
        chosen = active_set(problem, z)
    x = chosen.forces
    return Solution(
        forces=x,
        rates=problem.D @ x + problem.b,
        modes=tuple(mode for mode, _ in chosen.modes),
        directions=np.array([direction for _, direction in chosen.modes]).reshape(-1, 2),
        active_rows=chosen.rows,
        forces_unique=chosen.unique,
        residual=problem.residual((x / problem.scale)[problem.rows]),
        verdict=verdict,
        alternatives=tuple(_alternative(problem, other) for other in others),
        message="; ".join(part for part in (message, chosen.message) if part),
    )


def _solutions(problem: Problem) -> tuple[list[np.ndarray], Verdict, str]:
    """Solutions, the one to take first (without any, the nearest); verdict and message."""
    if problem.convex:
        found, contradiction = solve_box(problem.G, problem.g, problem.lower, problem.upper)
        if found is not None and problem.residual(found) <= MARGIN:
            return [found], Verdict.UNIQUE, ""
        if contradiction:
            message = "no solution: the rows contradict each other, no forces keep all their rates"
            return [problem.without_force()], Verdict.NONE, message
    motion = judge(problem)
    z = iterate(problem)
    solved = problem.residual(z) <= ROUNDING
    if solved and motion != Motion.DOUBTFUL:
        return [z], Verdict.UNIQUE if motion == Motion.UNIQUE else Verdict.FOUND, ""
    if few(problem):
        return _all_tried(problem, z, solved)
    if solved:
        message = "friction is so strong that other solutions may exist (Painleve); too many to try"
        return [z], Verdict.FOUND, message
    residual = problem.residual(z)
    message = f"no solution found (residual {residual:.1e}); too many contacts to try all modes"
    return [z], Verdict.NONE, message


def _all_tried(
    problem: Problem, z: np.ndarray, solved: bool
) -> tuple[list[np.ndarray], Verdict, str]:
    solutions = all_solutions(problem, [z] if solved else [])
    if len(solutions) > 1:
        message = f"several solutions (Painleve): {len(solutions)} motions or more obey the laws"
        return solutions, Verdict.SEVERAL, message
    complete = not problem.cones
    if solutions:
        return solutions, Verdict.UNIQUE if complete else Verdict.FOUND, ""
    how = "in no mode do the forces obey the laws" if complete else "none was found in any mode"
    return [z], Verdict.NONE, f"no solution (Painleve): {how}"


def _alternative(problem: Problem, z: np.ndarray) -> Alternative:
    x = problem.E @ z
    modes = tuple(mode for mode, _ in modes_of(problem, z))
    return Alternative(x, problem.D @ x + problem.b, modes)
