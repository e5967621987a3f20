r"""The solution of a contact problem: forces, modes, active rows, and how many motions there are.

**What the response proves.** With sliding friction the response G of the independent forces is not
symmetric. The rates :math:`w = G z + g` of a solution are unique for all g exactly when G is
*column adequate*:

.. math:: z_i (G z)_i \le 0 \;\text{for all } i \quad\Rightarrow\quad G z = 0,

that is, no principal minor is negative, and where one is zero, the columns concerned are dependent
as a whole (Cottle, Pang, Stone, theorems 3.4.4 and 3.4.6). Contacts that share a load have such
zeros; they do no harm. Regular and adequate is a P-matrix, for which a solution always exists. A
sliding rod whose :math:`D_{nn} - \mu D_{nt} \cdot s` is negative breaks this (Painleve 1895): it
has no solution when the contact is being closed, and two when it is not.

A contact at zero slip may begin to slip in any direction. For two solutions, with differences dz
and dw = G dz, the laws give

.. math:: dz^T G\, dz \le \sum_k \mu_k |dz_{n,k}| \, |G_{t,k}\, dz|

(the friction disk has its radius from the normal force). So the motion is unique when the symmetric
part of G exceeds :math:`\sum_k (\mu_k/2) (\epsilon e_n e_n^T + G_t^T G_t/\epsilon)` for some
:math:`\epsilon`. This is sufficient only: contacts that share a load never satisfy it.

**Others.** Where the response leaves room for several solutions, or none was found, a few laws
without contacts at zero slip are decided by a complete search: every law in every mode, the linear
equations of the modes, the residual of their solution. The list is complete: forces that are not
determined by their modes can be moved to a bound, which is another choice of modes. So an empty
list proves that there is no solution. Otherwise, of up to three contacts, Newton's method begins
from contacts that push, all of them and each alone, as they would where friction jams: what it
finds are solutions, that there are no others is not proven.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations, product
from math import comb, prod
from typing import Any

import numpy as np

from multiarm.dynamics.solver.factors import rank_of
from multiarm.events.complementarity.active_set import ActiveSet, active_set, law_modes
from multiarm.events.complementarity.central import central_set
from multiarm.events.complementarity.impulses import BOUNDED, FRICTION, PUSH, solve_impulses
from multiarm.events.complementarity.problem import (
    CONSISTENT,
    MARGIN,
    RANK,
    RESOLVED,
    ROUNDED_RESIDUAL,
    Bounded,
    ContactLaw,
    ContactMode,
    Friction,
    Problem,
    Sliding,
    build,
    matrix_rank,
)
from multiarm.events.complementarity.solvers import iterate, iterate_compiled, solve_box

# Laws of a complete search, and choices of modes.
FEW_LAWS, FEW_MODES = 8, 300
# Contacts that are loaded to look for other solutions, and their forces as parts of the scale. More
# contacts share their load: they have families of motions, which say nothing about jamming.
LOADED_CONTACTS = 3
LOADS = (1.0, 10.0)


class Verdict(str, Enum):
    """How many motions there are."""

    UNIQUE = "unique"
    """One, proven: no friction, or an adequate response, or a complete search."""
    FOUND = "found"
    """At least one; others are neither excluded nor indicated."""
    SEVERAL = "not unique"
    """Several: the one with the smallest forces is given, the others are the alternatives."""
    NONE = "none"
    """None, proven; the result is the nearest to one."""
    NOT_FOUND = "not found"
    """None was found; the result is the nearest to one."""


NO_SOLUTION = (Verdict.NONE, Verdict.NOT_FOUND)


@dataclass(frozen=True)
class Alternative:
    """Another solution with another motion; attributes as in :class:`ComplementaritySolution`."""

    forces: np.ndarray
    rates: np.ndarray
    modes: tuple[ContactMode, ...]


@dataclass(frozen=True)
class ComplementaritySolution:
    """Forces and rates of all rows, and the mode of each law from now on.

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
        Why there is no unique motion or active set; empty otherwise.
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
    _problem: Problem
    _independent: np.ndarray  # forces of the problem
    _signs: np.ndarray | float = 1.0  # -1 for rows that are turned round

    def central(self) -> ComplementaritySolution | None:
        """The same motion with all rows in contact active, and forces away from all bounds.

        None where some forces are at their bounds in all solutions, or are all determined.
        """
        chosen = central_set(self._problem, self._independent)
        if chosen is None:
            return None
        facts = _by_forces(self._problem, chosen)
        return replace(self, alternatives=(), **facts)._signed(self._signs)

    def turned(self, signs: np.ndarray) -> ComplementaritySolution:
        """The solution of the problem in which the rows with the sign -1 are turned round."""
        return replace(self._signed(signs), _signs=signs)

    def _signed(self, signs: np.ndarray | float) -> ComplementaritySolution:
        alternatives = tuple(
            replace(motion, forces=signs * motion.forces, rates=signs * motion.rates)
            for motion in self.alternatives
        )
        return replace(
            self, forces=signs * self.forces, rates=signs * self.rates, alternatives=alternatives
        )


def solve(
    response: np.ndarray,
    free: np.ndarray,
    laws: Sequence[ContactLaw],
) -> ComplementaritySolution:
    """Solve a contact problem.

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
    ComplementaritySolution
        Forces, rates, modes, active rows; its residual, verdict and message certify it.
    """
    problem = _checked(response, free, laws)
    (z, *alternatives), verdict, message = _solutions(problem, problem.without_force())
    if verdict in NO_SOLUTION:
        chosen = ActiveSet(problem.E @ z, law_modes(problem, z))
    else:
        chosen = active_set(problem, z)
    return ComplementaritySolution(
        **_by_forces(problem, chosen),
        verdict=verdict,
        alternatives=tuple(_alternative(problem, further) for further in alternatives),
        message="; ".join(part for part in (message, chosen.message) if part),
        _problem=problem,
        _independent=z,
    )


def find_impulses(
    response: np.ndarray, free: np.ndarray, laws: Sequence[ContactLaw], near: np.ndarray
) -> tuple[np.ndarray, float]:
    """Impulses of a step in time that obey the laws, and their residual.

    Parameters and residual are those of :func:`solve`; there is no law ``Sliding``, and of several
    solutions it is one close to ``near``.  Nothing is said of others, and of modes:
    see :func:`describe`.
    """
    kinds, rows = np.full(len(laws), PUSH), np.zeros((len(laws), 3), dtype=np.int64)
    mu, lower, upper = np.zeros((3, len(laws)))
    for k, law in enumerate(laws):
        rows[k] = law.row
        assert not isinstance(law, Sliding), "impulses of friction have no given direction"
        if isinstance(law, Bounded):
            kinds[k], lower[k], upper[k] = BOUNDED, law.lower, law.upper
        if isinstance(law, Friction):
            kinds[k], mu[k], rows[k, 1:] = FRICTION, law.mu, law.tangents
    impulses = near.copy()
    residual, _ = solve_impulses(response, free, kinds, rows, mu, lower, upper, impulses)
    return impulses, residual


def describe(
    response: np.ndarray, free: np.ndarray, laws: Sequence[ContactLaw], forces: np.ndarray
) -> ComplementaritySolution:
    """The solution near to forces that obey the laws; nothing is said of others."""
    problem = _checked(response, free, laws)
    z = problem.independent(forces)
    if problem.residual(z) > ROUNDED_RESIDUAL:
        z = iterate(problem, z)
    chosen = active_set(problem, z)
    return ComplementaritySolution(
        **_by_forces(problem, chosen),
        verdict=Verdict.FOUND,
        alternatives=(),
        message=chosen.message,
        _problem=problem,
        _independent=z,
    )


def _checked(response: np.ndarray, free: np.ndarray, laws: Sequence[ContactLaw]) -> Problem:
    D, b = np.asarray(response, dtype=float), np.asarray(free, dtype=float)
    m = b.size
    assert D.shape == (m, m) and b.shape == (m,), "shapes of response and free rates"
    assert np.all(np.isfinite(D)) and np.all(np.isfinite(b)), "numbers are finite"
    assert np.allclose(D, D.T, rtol=0.0, atol=1e-9 * np.max(np.abs(D), initial=0.0)), "symmetric"
    return build((D + D.T) / 2.0, b, laws)


def _by_forces(problem: Problem, chosen: ActiveSet) -> dict[str, Any]:
    """What a solution says of its forces and modes."""
    x = chosen.forces
    return {
        "forces": x,
        "rates": problem.D @ x + problem.b,
        "modes": tuple(mode for mode, _ in chosen.modes),
        "directions": np.array([direction for _, direction in chosen.modes]).reshape(-1, 2),
        "active_rows": chosen.rows,
        "forces_unique": chosen.unique,
        "residual": problem.residual((x / problem.scale)[problem.rows]),
    }


class Motion(Enum):
    """How many motions are possible."""

    UNIQUE = "at most one"
    UNKNOWN = "nothing is known"
    DOUBTFUL = "none or several are possible for some free rates"


def uniqueness(problem: Problem) -> Motion:
    """How many motions a problem can have, by its response alone."""
    if problem.convex:
        return Motion.UNIQUE
    if not problem.cones:
        return _judge_linear(problem.G, problem)
    G, tangents = problem.G, []
    for n, cone in problem.cones.items():
        tangents += [n + 1, n + 2]
        # slipping in its worst direction the contact would be pulled in by its own friction
        if G[n, n] <= cone.mu * np.hypot(*G[n, cone.tangents]) + RANK:
            return Motion.DOUBTFUL
    if len(problem.cones) < len(problem.laws):
        normals = np.setdiff1d(np.arange(problem.g.size), tangents)
        if _judge_linear(G[np.ix_(normals, normals)]) == Motion.DOUBTFUL:
            return Motion.DOUBTFUL
    return Motion.UNIQUE if _dominates_friction(problem) else Motion.UNKNOWN


def all_solutions(problem: Problem, known: list[np.ndarray]) -> list[np.ndarray]:
    """Solutions of all modes of a problem without contacts at zero slip: known ones, one a motion.

    The number of modes grows exponentially with that of the laws.
    """
    solutions = list(known)
    for modes in product(*(_linear_modes(problem, k) for k in problem.columns)):
        A, c = np.array([mode[0] for mode in modes]), np.array([mode[1] for mode in modes])
        z = np.linalg.lstsq(A, c, rcond=RANK)[0]
        # where forces can grow without changing the rates of their own laws, there is a family
        for forces in [z, *_along_family(problem, z)]:
            _add_motion(problem, forces, solutions)
    return solutions


def _solutions(problem: Problem, start: np.ndarray) -> tuple[list[np.ndarray], Verdict, str]:
    """Solutions, the best one first (without any, the nearest point); verdict and message."""
    if problem.convex:
        forces, contradiction = solve_box(problem.G, problem.g, problem.lower, problem.upper)
        if forces is not None and problem.residual(forces) <= MARGIN:
            return [forces], Verdict.UNIQUE, ""
        if contradiction:
            message = "no solution: the rows contradict each other, no forces keep all their rates"
            return [problem.without_force()], Verdict.NONE, message
    motion = uniqueness(problem)
    z = iterate(problem, start)
    residual = problem.residual(z)
    if residual <= RESOLVED and motion != Motion.DOUBTFUL:
        return [z], Verdict.UNIQUE if motion == Motion.UNIQUE else Verdict.FOUND, ""
    known = [z] if residual <= RESOLVED else []
    complete = _few_modes(problem)
    solutions = all_solutions(problem, known) if complete else _from_loads(problem, known)
    solutions.sort(key=lambda z: float((z - start) @ (z - start)))
    if len(solutions) > 1:
        message = f"several solutions (Painleve): {len(solutions)} motions or more obey the laws"
        return solutions, Verdict.SEVERAL, message
    if solutions and complete:
        return solutions, Verdict.UNIQUE, ""
    if solutions:
        message = "friction is so strong that other solutions may exist (Painleve)"
        return solutions, Verdict.FOUND, message
    if complete:
        message = "no solution (Painleve): in no mode do the forces obey the laws"
        return [z], Verdict.NONE, message
    return [z], Verdict.NOT_FOUND, f"no solution found (residual {residual:.1e})"


def _from_loads(problem: Problem, known: list[np.ndarray]) -> list[np.ndarray]:
    """Known solutions, and those that Newton's method finds from contacts that push.

    They push with a load, or with what keeps them at rest. Of a family that contacts which share a
    load make one is listed.
    """
    solutions, size = list(known), problem.size(problem.without_force())
    contacts = [
        np.arange(k, k + (3 if k in problem.cones else 1))
        for k, law in zip(problem.columns, problem.laws, strict=True)
        if isinstance(law, (Friction, Sliding))
    ]
    if len(contacts) > LOADED_CONTACTS:
        return solutions
    choices = [np.concatenate(contacts), *contacts] if len(contacts) > 1 else contacts
    for columns in choices:
        among = np.ix_(columns, columns)
        starts = [problem.without_force() for _ in range(1 + len(LOADS))]
        starts[0][columns] = np.linalg.lstsq(problem.G[among], -problem.g[columns], rcond=RANK)[0]
        for start, load in zip(starts[1:], LOADS, strict=True):
            start[np.intersect1d(columns, problem.columns)] = load * size
        for start in starts:
            z = iterate_compiled(problem, start, attempts=1)
            # all forces between two of a family obey the laws: contacts share a load, none jams
            if all(problem.residual((z + one) / 2.0) > RESOLVED for one in solutions):
                _add_motion(problem, z, solutions)
    return solutions


def _add_motion(problem: Problem, z: np.ndarray, solutions: list[np.ndarray]) -> None:
    """Add a solution whose motion none of the others has."""
    if problem.residual(z) <= 10.0 * ROUNDED_RESIDUAL and not any(
        _same_motion(problem, z, solution) for solution in solutions
    ):
        solutions.append(z)


def _alternative(problem: Problem, z: np.ndarray) -> Alternative:
    x = problem.E @ z
    modes = tuple(mode for mode, _ in law_modes(problem, z))
    return Alternative(x, problem.D @ x + problem.b, modes)


def _judge_linear(G: np.ndarray, problem: Problem | None = None) -> Motion:
    """:func:`uniqueness` for a response without contacts at zero slip."""
    n = G.shape[0]
    if np.linalg.eigvalsh(G + G.T)[0] > RANK:
        return Motion.UNIQUE
    for size in range(1, n + 1):
        if comb(n, size) > 500:
            return Motion.UNKNOWN
        index = np.array(list(combinations(range(n), size)))
        minors = np.linalg.det(G[index[:, :, None], index[:, None, :]])
        if any(matrix_rank(G[:, columns]) == size for columns in index[minors <= RANK]):
            return Motion.DOUBTFUL
    # rates of rows without a law of their own (tangents) must follow from those with one
    if problem is None or matrix_rank(G) == matrix_rank(
        problem.scale[:, None] * problem.D @ problem.E
    ):
        return Motion.UNIQUE
    return Motion.DOUBTFUL


def _dominates_friction(problem: Problem) -> bool:
    G = problem.G
    for weight in (0.5, 1.0, 2.0):
        form = (G + G.T) / 2.0
        for n, cone in problem.cones.items():
            form[n, n] -= 0.5 * cone.mu * weight
            form -= (0.5 * cone.mu / weight) * G[cone.tangents].T @ G[cone.tangents]
        if np.linalg.eigvalsh(form)[0] > RANK:
            return True
    return False


def _few_modes(problem: Problem) -> bool:
    """Whether a complete search is possible."""
    if problem.cones or len(problem.laws) > FEW_LAWS:
        return False
    return prod(len(_linear_modes(problem, k)) for k in problem.columns) <= FEW_MODES


def _same_motion(problem: Problem, first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two solutions have the same rates in all rows."""
    apart = problem.scale * (problem.D @ (problem.E @ (first - second)))
    size = max(problem.size(first), problem.size(second))
    return bool(np.max(np.abs(apart), initial=0.0) <= CONSISTENT * size)


def _linear_modes(problem: Problem, k: int) -> list[tuple[np.ndarray, float]]:
    """Equation ``a z = c`` of independent force k in each mode: at a bound, at rate zero."""
    at_bound = np.eye(problem.g.size)[k]
    bounds = [float(x) for x in (problem.lower[k], problem.upper[k]) if np.isfinite(x)]
    return [(at_bound, x) for x in bounds] + [(problem.G[k], -float(problem.g[k]))]


def _along_family(problem: Problem, z: np.ndarray) -> list[np.ndarray]:
    """Forces near a solution that leave the rates of their own laws as they are."""
    size = problem.size(z)
    touching = np.flatnonzero(np.abs(problem.G @ z + problem.g) <= ROUNDED_RESIDUAL * size)
    if touching.size == 0:
        return []
    _, values, right = np.linalg.svd(problem.G[np.ix_(touching, touching)])
    block = right[rank_of(values, RANK, 1.0) :].T
    null = np.zeros((z.size, block.shape[1]))
    null[touching] = block
    # with all rates zero, forces have no scale of their own
    step = 0.1 * size or 1.0
    return [z + sign * step * v for v in null.T for sign in (1.0, -1.0)]
