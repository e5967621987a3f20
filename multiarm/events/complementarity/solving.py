"""From a response and laws to what happens: the steps in order, and what is told about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multiarm.events.complementarity.convex import solve_box
from multiarm.events.complementarity.enumeration import all_solutions, few
from multiarm.events.complementarity.newton import iterate
from multiarm.events.complementarity.parts import modes_of, nothing_held, parts_of
from multiarm.events.complementarity.problem import Problem, build, covers
from multiarm.events.complementarity.selection import everything, select
from multiarm.events.complementarity.solution import Alternative, Solution, Verdict
from multiarm.events.complementarity.tolerances import MARGIN, ROUNDING
from multiarm.events.complementarity.uniqueness import Motion, judge
from multiarm.events.complementarity.units import Unit

NO_ROWS = "no rows can be held whose smallest forces obey the laws"
UNDETERMINED = (
    "the rows in contact leave the motion undetermined: forces that squeeze without moving them "
    "change the friction"
)


def solve(
    response: np.ndarray,
    free: np.ndarray,
    units: Sequence[Unit],
    before: np.ndarray | None = None,
) -> Solution:
    """Which units push, slide, stick or let go.

    Parameters
    ----------
    response : ndarray, shape (m, m)
        ``D``: rates of all rows to unit forces, symmetric and positive semidefinite [1/kg],
        [1/(kg m^2)] or between.
    free : ndarray, shape (m,)
        ``b``: rates without these forces, accelerations; of an impact velocities, of normal rows
        ``v + e v`` with the restitution e, so that y is ``v_after + e v_before``.
    units : sequence of Push, Bounded, Friction or Sliding
        Laws; every row belongs to exactly one.
    before : ndarray, shape (m,), optional
        Velocities of the rows before an impact [m/s] or [rad/s]; gives ``gains``.

    Returns
    -------
    Solution
        Forces, rates, modes, the rows to hold, and how sure that is.
    """
    D, b = np.asarray(response, dtype=float), np.asarray(free, dtype=float)
    m = b.size
    assert D.shape == (m, m) and b.shape == (m,), "shapes of response and free rates"
    assert np.all(np.isfinite(D)) and np.all(np.isfinite(b)), "numbers are finite"
    assert np.allclose(D, D.T, rtol=0.0, atol=1e-9 * np.max(np.abs(D), initial=0.0)), "symmetric"
    assert covers(units, m), "every row belongs to one unit"
    problem = build((D + D.T) / 2.0, b, units)
    candidates, verdict, words = _candidates(problem)
    solution = _told(problem, candidates, verdict, words)
    return solution if before is None else replace(solution, gains=_gains(D, solution, before))


def _candidates(problem: Problem) -> tuple[list[np.ndarray], Verdict, str]:
    """Solutions (the one to take first; without any, the nearest), verdict and words."""
    if problem.convex:
        z, contradiction = solve_box(problem.G, problem.g, problem.lower, problem.upper)
        if z is not None and problem.residual(z) <= MARGIN:
            return [z], Verdict.UNIQUE, ""
        if contradiction:
            words = "no solution: the rows contradict each other, no forces keep all their rates"
            return [problem.without_force()], Verdict.NONE, words
    motion = judge(problem)
    z = iterate(problem)
    solved = problem.residual(z) <= ROUNDING
    if solved and motion != Motion.DOUBTFUL:
        return [z], Verdict.UNIQUE if motion == Motion.UNIQUE else Verdict.FOUND, ""
    if few(problem):
        return _all_tried(problem, z, solved)
    if solved:
        words = "friction is so strong that other solutions may exist (Painleve); too many to try"
        return [z], Verdict.FOUND, words
    words = f"no solution found (residual {problem.residual(z):.1e}); too many units to try all"
    return [z], Verdict.NONE, words


def _all_tried(
    problem: Problem, z: np.ndarray, solved: bool
) -> tuple[list[np.ndarray], Verdict, str]:
    solutions = all_solutions(problem, [z] if solved else [])
    if len(solutions) > 1:
        words = f"several solutions (Painleve): {len(solutions)} motions or more obey the laws"
        return solutions, Verdict.SEVERAL, words
    complete = not problem.cones
    if solutions:
        return solutions, Verdict.UNIQUE if complete else Verdict.FOUND, ""
    how = "in no mode do the forces obey the laws" if complete else "none was found in any mode"
    return [z], Verdict.NONE, f"no solution (Painleve): {how}"


def _told(problem: Problem, candidates: list[np.ndarray], verdict: Verdict, words: str) -> Solution:
    z = candidates[0]
    selection, unique = nothing_held(problem, z), False
    if verdict != Verdict.NONE:
        selected, sharing = select(problem, z)
        selection, unique = selected or everything(problem, z), not sharing.dependent
        if selected is None:
            trouble = UNDETERMINED if sharing.undetermined else NO_ROWS
            words = f"{words}; {trouble}" if words else trouble
    x = selection.forces
    return Solution(
        forces=x,
        rates=problem.D @ x + problem.b,
        modes=modes_of(selection.parts),
        directions=np.array([part.direction for part in selection.parts]).reshape(-1, 2),
        rows=selection.rows,
        forces_unique=unique,
        residual=problem.residual(problem.independent(x)),
        verdict=verdict,
        alternatives=tuple(_alternative(problem, other) for other in candidates[1:]),
        words=words,
        gains=None,
    )


def _alternative(problem: Problem, z: np.ndarray) -> Alternative:
    x = problem.E @ z
    return Alternative(x, problem.D @ x + problem.b, modes_of(parts_of(problem, z)))


def _gains(D: np.ndarray, solution: Solution, before: np.ndarray) -> float:
    """Work of impulses x at the mean of the velocities before and after, ``v + D x``."""
    x = solution.forces
    return float(x @ (np.asarray(before) + 0.5 * D @ x))
