r"""Impacts: the velocities behind a blow.

A contact that closes with the rate :math:`v_n^-` gets :math:`y_n = v_n^+ + e\,v_n^-` in place of
its rate (Newton's law of restitution), and friction is against the slip after the impact (J.J.
Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988).  Where Newton's law
together with friction would add energy, restitution is lessened until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.errors import SolverError
from multiarm.events.complementarity import Bounded, ContactLaw, Solution, Verdict, solve
from multiarm.events.instant import Instant, law_of
from multiarm.events.modes import Modes

# Of an impact, a residual below this is a solution: velocities are put on the contacts afterwards.
NEARLY = 1e-6
# Energy that an impact may add, as a part of what is there: roundings.
ADDED = 1e-12
# Halvings of restitution where it would add energy.
HALVINGS = 40


@dataclass(frozen=True)
class Hit:
    """A constraint that hit something.

    Attributes
    ----------
    constraint : int
    before, after : float
        Rates of its gap [m/s, rad/s].
    impulse : float
        [N s, N m s]
    """

    constraint: int
    before: float
    after: float
    impulse: float


class Impact(Instant):
    """A blow at one instant; the state is in the data, and its velocities are changed.

    Parameters
    ----------
    modes : Modes
    touching : sequence of int
        Units that touch.
    rest_height : float
        Bounces lower than this are no longer followed [m, rad].
    ahead : float
        See :class:`multiarm.events.instant.Instant`.
    """

    def __init__(self, modes: Modes, touching: list[int], rest_height: float, ahead: float):
        super().__init__(modes, ahead)
        self._touching, self._rest_height = touching, rest_height

    def _impact(self) -> tuple[list[Hit], float, list[int]]:
        """Change the velocities where something hits; hits, energy added, contacts put to rest."""
        constraints, rates, rest = self._constraints, self._rates().copy(), self._rest_rate()
        involved = [u for u in self._touching if constraints[u].kind != DRY_JOINT]
        if not any(rates[constraints[u].row] < -rest for u in involved):
            return [], 0.0, []
        rows = [row for u in involved for row in (constraints[u].row, *constraints[u].tangents)]
        matrix = self._matrix(rows)
        response, moved = self._response(matrix, self._bare)
        before = rates[rows]
        hit = {u for u in involved if rates[constraints[u].row] < -rest}
        elastic = {u: constraints[u].restitution for u in hit}
        solution, after = self._collide(involved, rows, response, before, elastic, set())
        rested: set[int] = set()
        while low := self._too_low(involved, rows, before, after) - rested:
            rested |= low
            elastic = {u: e for u, e in elastic.items() if u not in rested}
            solution, after = self._collide(involved, rows, response, before, elastic, rested - hit)
        change = moved @ solution.forces
        arrays = self._full.arrays
        arrays.twist[:] += change[:6]
        arrays.v[:] += change[6:]
        hits = [
            Hit(u, float(rates[constraints[u].row]), float(after[k]), float(solution.forces[k]))
            for u, k in ((u, rows.index(constraints[u].row)) for u in hit)
        ]
        return hits, energy_added(solution.forces, before, after), sorted(rested & hit)

    def _collide(
        self,
        involved: list[int],
        rows: list[int],
        response: np.ndarray,
        before: np.ndarray,
        elastic: dict[int, float],
        resting: set[int],
    ) -> tuple[Solution, np.ndarray]:
        """Impulses and rates afterwards; restitution is lessened where it would add energy.

        Units that are ``resting`` are not thrown up by others.
        """
        at: dict[int, int] = {row: k for k, row in enumerate(rows)}
        laws: list[ContactLaw] = []
        for u in involved:
            constraint = self._constraints[u]
            if u in resting:
                laws.append(Bounded(at[constraint.row], -np.inf, np.inf))
                laws += [Bounded(at[t], 0.0, 0.0) for t in constraint.tangents]
            else:
                laws.append(law_of(constraint, at, None))
        share = 1.0
        for _ in range(HALVINGS):
            shifted = before.copy()
            for u, e in elastic.items():
                k = at[self._constraints[u].row]
                shifted[k] += share * e * before[k]
            solution = solve(response, shifted, laws)
            after = before + response @ solution.forces
            reached = 0.5 * abs(before) @ abs(solution.forces)
            if energy_added(solution.forces, before, after) <= ADDED * reached:
                break
            share *= 0.5
        self._residual = max(self._residual, solution.residual)
        if solution.verdict is Verdict.NONE and not solution.residual < NEARLY:
            raise SolverError(f"no velocities follow the impact: {solution.message}")
        return solution, after

    def _too_low(
        self, involved: list[int], rows: list[int], before: np.ndarray, after: np.ndarray
    ) -> set[int]:
        """Units that would bounce too low to be followed, and those thrown up so by others."""
        rest = self._rest_rate()
        places = {u: rows.index(self._constraints[u].row) for u in involved}
        bouncing = [u for u, k in places.items() if before[k] <= rest < after[k]]
        if not bouncing:
            return set()
        rows_of_them = [self._constraints[u].row for u in bouncing]
        acceleration = self._free_accelerations(rows_of_them, self._bare)
        low = set()
        for u, back in zip(bouncing, acceleration, strict=True):
            if back < 0.0 and 0.5 * after[places[u]] ** 2 / -back < self._rest_height:
                low.add(u)
        return low


def energy_added(impulse: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Kinetic energy that impulses add [J]: their mean rates times them."""
    return 0.5 * float(impulse @ (before + after))
