r"""Contact laws of constraints, and contacts that hold both ways with friction.

*Contacts that hold both ways* and have friction obey Coulomb's law with the magnitude of their
normal force.  Each is taken for one that only pushes, or only pulls: on the side where it does not
open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.events.complementarity import (
    Bounded,
    ComplementaritySolution,
    ContactLaw,
    ContactMode,
    Friction,
    Push,
    Sliding,
    Verdict,
    describe,
    find_impulses,
    solve,
)

_Found = TypeVar("_Found")

NO_SIDES = (
    "contacts that hold both ways find no motion with their friction: wherever one pushes it would "
    "have to pull, and the other way round; lessen 'mu'"
)


def works_of(impulses: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Work of each impulse [J]: its product with the mean of the rates before and after."""
    return 0.5 * impulses * (before + after)


def energy_added(impulse: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Kinetic energy that impulses add [J]."""
    return float(np.sum(works_of(impulse, before, after)))


def law_of(constraint: Constraint, at: dict[int, int], slip: np.ndarray | None) -> ContactLaw:
    """The law of a constraint; ``at`` maps its rows to those of the problem."""
    if constraint.kind == DRY_JOINT:
        return Bounded(at[constraint.row], -constraint.bound, constraint.bound)
    if not constraint.tangents:
        return Push(at[constraint.row])
    if constraint.bilateral and constraint.tangents[0] not in at:
        return Bounded(at[constraint.row], -np.inf, np.inf)
    first, second = (at[t] for t in constraint.tangents)
    if slip is None:
        return Friction(at[constraint.row], (first, second), constraint.mu)
    return Sliding(
        at[constraint.row], (first, second), constraint.mu, (float(slip[0]), float(slip[1]))
    )


@dataclass(frozen=True)
class ContactProblem:
    """The rows of some constraints, and their laws.

    Attributes
    ----------
    constraints : sequence of Constraint
    response : ndarray, shape (m, m)
    rates : ndarray, shape (m,)
        Without their forces.
    laws : list of ContactLaw
        One for each constraint; then others.
    """

    constraints: Sequence[Constraint]
    response: np.ndarray
    rates: np.ndarray
    laws: list[ContactLaw]

    def solve(self) -> tuple[ComplementaritySolution, frozenset[int]]:
        """The solution, and which contacts that hold both ways pull."""

        def attempt(pulls: frozenset[int]) -> tuple[ComplementaritySolution, list[int]]:
            solution = solve(*self._turned(pulls), self.laws)
            return solution, [k for k in self._sided if solution.modes[k] is ContactMode.OPEN]

        solution, pulls, found = self._find_sides(attempt)
        if not found:
            solution = replace(solution, verdict=Verdict.NOT_FOUND, residual=1.0, message=NO_SIDES)
        return solution.turned(self._signs(pulls)), pulls

    def impulses(self, near: np.ndarray) -> tuple[np.ndarray, float, frozenset[int]]:
        """Impulses near to others, their residual, and which contacts that hold both ways pull."""

        def attempt(pulls: frozenset[int]) -> tuple[tuple[np.ndarray, float], list[int]]:
            response, rates = self._turned(pulls)
            forces, residual = find_impulses(response, rates, self.laws, self._signs(pulls) * near)
            after = rates + response @ forces
            wrong = [
                k
                for k, law in self._sided.items()
                if response[law.row, law.row] * forces[law.row] < after[law.row]
            ]
            return (forces, residual), wrong

        (forces, residual), pulls, found = self._find_sides(attempt)
        return self._signs(pulls) * forces, residual if found else 1.0, pulls

    def at(self, impulses: np.ndarray, pulls: frozenset[int]) -> ComplementaritySolution:
        """The solution that some impulses are."""
        signs = self._signs(pulls)
        solution = describe(*self._turned(pulls), self.laws, signs * impulses)
        return solution.turned(signs)

    @cached_property
    def _sided(self) -> dict[int, Friction | Sliding]:
        """Laws of the contacts that hold both ways and have friction."""
        return {
            k: law
            for k, (law, constraint) in enumerate(zip(self.laws, self.constraints, strict=False))
            if constraint.bilateral and isinstance(law, (Friction, Sliding))
        }

    def _signs(self, pulls: frozenset[int]) -> np.ndarray:
        signs = np.ones(self.rates.size)
        signs[[self._sided[k].row for k in pulls]] = -1.0
        return signs

    def _turned(self, pulls: frozenset[int]) -> tuple[np.ndarray, np.ndarray]:
        """Response and rates with the contacts that pull turned round."""
        if not pulls:
            return self.response, self.rates
        signs = self._signs(pulls)
        return signs[:, None] * self.response * signs, signs * self.rates

    def _find_sides(
        self, attempt: Callable[[frozenset[int]], tuple[_Found, list[int]]]
    ) -> tuple[_Found, frozenset[int], bool]:
        """What was found with the sides on which no contact opens; these; whether there are any.

        The first sides are those of the forces without friction in these contacts.  Whichever then
        opens changes its side: all of them at once, or one of them where that has led back.
        """
        pulls = self._pulls_without_friction() if self._sided else frozenset()
        tried: set[frozenset[int]] = set()
        while True:
            found, wrong = attempt(pulls)
            if not wrong or len(tried) > 8 * len(self._sided):
                break
            tried.add(pulls)
            changes = [frozenset(wrong), *(frozenset([k]) for k in wrong)]
            untried = [pulls ^ change for change in changes if pulls ^ change not in tried]
            if not untried:
                break
            pulls = untried[0]
        return found, pulls, not wrong

    def _pulls_without_friction(self) -> frozenset[int]:
        smooth = [law for k, law in enumerate(self.laws) if k not in self._sided]
        for law in self._sided.values():
            smooth.append(Bounded(law.row, -np.inf, np.inf))
            smooth += [Bounded(t, 0.0, 0.0) for t in law.tangents]
        forces = solve(self.response, self.rates, smooth).forces
        return frozenset(k for k, law in self._sided.items() if forces[law.row] < 0.0)
