r"""Which rows to hold from now on.

Between events the motion is that of equations: the rates of the rows held are zero, their forces
are the smallest that achieve it, and nobody looks at signs. So rows are needed whose smallest
forces obey the laws by themselves.

Without friction the smallest forces *between their bounds* say which. Leave out the rows that end
at a bound: the forces of the rest are then the smallest of all forces of these rows, whatever
their signs, because no bound holds them back (the problem is convex, the norm a sum over rows).
Rows that end at zero rest.

Cones are not linear. Where the smallest forces leave the cones of some contacts, their tangents are
left out: other contacts may keep them from slipping. If these cannot, friction is at its bound
somewhere. Then the forces go from a solution, which is inside of all cones, straight to the
smallest, until the first cones are met; there friction is tied to the normal force, and the walk
goes on from that point. Each walk ties one contact at least, so that it ends.
"""

from __future__ import annotations

import numpy as np

from multiarm.events.complementarity.parts import (
    HELD,
    Part,
    Selection,
    columns_of,
    parts_of,
    unit_vector,
)
from multiarm.events.complementarity.problem import Problem
from multiarm.events.complementarity.smallest import Sharing
from multiarm.events.complementarity.tolerances import MARGIN
from multiarm.events.complementarity.units import Bounded, Friction, Mode

# Choices of tangents to leave out that are tried: with a dozen contacts at the cone, a few each.
CHOICES = 64


def select(problem: Problem, z: np.ndarray) -> tuple[Selection | None, Sharing]:
    """Smallest forces with the motion of a solution, and the rows to hold.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray, shape (r,)
        Independent forces of a solution.

    Returns
    -------
    selection : Selection or None
        Forces, modes and rows; None when no rows have smallest forces that obey the laws.
    sharing : Sharing
        Tells whether forces are dependent, and whether the motion was left undetermined.
    """
    x = problem.E @ z
    sharing = Sharing(problem, x, MARGIN * problem.size(z))
    search = _Search(sharing)
    parts = parts_of(problem, z)
    return search.untied(parts) or search.walked(parts, x), sharing


def everything(problem: Problem, z: np.ndarray) -> Selection:
    """All rows in contact with the forces as they are."""
    parts = parts_of(problem, z)
    rows = tuple(sorted(row for column in columns_of(problem, parts) for row in column.held))
    return Selection(problem.E @ z, parts, rows)


class _Search:
    """Looks for parts whose smallest forces obey the laws."""

    def __init__(self, sharing: Sharing) -> None:
        self.sharing, self.problem, self.zero = sharing, sharing.problem, sharing.zero
        self.tries = CHOICES

    def untied(self, parts: tuple[Part, ...]) -> Selection | None:
        """A selection with fewer rows, friction nowhere at its bound."""
        self.tries -= 1
        choice = self.sharing.least(parts) if self.tries >= 0 else None
        if choice is None:
            return None
        fewer = self._without_idle(choice)
        if fewer != parts and (selection := self.untied(fewer)):
            return selection
        outside = self._outside_of_cones(choice)
        if not outside:
            return None if choice.bound else choice
        # all of them at once, which keeps what is symmetric so; then the worst
        worst = max(outside, key=lambda k: outside[k])
        for group in [outside, {worst}] if len(outside) > 1 else [outside]:
            closed = [Part(Mode.CLOSED) if k in group else part for k, part in enumerate(parts)]
            if selection := self.untied(tuple(closed)):
                return selection
        return None

    def walked(self, parts: tuple[Part, ...], x: np.ndarray) -> Selection | None:
        """A selection with friction tied where it meets its bound on the way from forces x."""
        choice = self.sharing.least(parts)
        while choice is not None and (outside := self._outside_of_cones(choice)):
            way = {k: self._to_cone(k, x, choice.forces) for k in outside}
            far = min(way.values())
            x = x + far * (choice.forces - x)
            met = {k for k in way if way[k] <= far + MARGIN}
            parts = tuple(
                Part(Mode.LIMIT, self._against(k, x, choice.forces)) if k in met else part
                for k, part in enumerate(parts)
            )
            choice = self.sharing.least(parts)
        if choice is None:
            return None
        fewer = self._without_idle(choice)
        if fewer != parts and (selection := self.walked(fewer, choice.forces)):
            return selection
        return None if choice.bound else choice

    def _without_idle(self, choice: Selection) -> tuple[Part, ...]:
        """Parts without the rows whose force is zero, or at a bound."""
        problem, x, parts = self.problem, choice.forces, list(choice.parts)
        for k, unit in enumerate(problem.units):
            if parts[k].mode not in HELD:
                continue
            zero = self.zero * problem.scale[unit.row]
            if not isinstance(unit, Bounded):
                if x[unit.row] <= zero:
                    parts[k] = Part(Mode.RESTING)
            elif x[unit.row] <= unit.lower + zero:
                parts[k] = Part(Mode.AT_LOWER)
            elif x[unit.row] >= unit.upper - zero:
                parts[k] = Part(Mode.AT_UPPER)
        return tuple(parts)

    def _outside_of_cones(self, choice: Selection) -> dict[int, float]:
        """Sticking contacts that are not inside their cones, and by how much (scaled)."""
        outside = {}
        for k, (unit, part) in enumerate(zip(self.problem.units, choice.parts, strict=True)):
            if part.mode == Mode.STICKING and isinstance(unit, Friction):
                tangents = choice.forces[list(unit.tangents)]
                excess = np.hypot(*tangents) - unit.mu * choice.forces[unit.row]
                outside[k] = float(excess / self.problem.scale[unit.tangents[0]])
        return {k: excess for k, excess in outside.items() if excess > -self.zero}

    def _to_cone(self, k: int, start: np.ndarray, end: np.ndarray) -> float:
        """The part of the way from start to end at which a contact meets its cone."""
        unit = self.problem.units[k]
        assert isinstance(unit, Friction)
        rows = [*unit.tangents, unit.row]
        a, d = start[rows], end[rows] - start[rows]
        # |a_t + f d_t|^2 = mu^2 (a_n + f d_n)^2
        metric = np.array([1.0, 1.0, -(unit.mu**2)])
        p, q, r = metric @ (d * d), metric @ (a * d), metric @ (a * a)
        if r >= 0.0:
            return 0.0
        root = q * q - p * r
        if root < 0.0:
            return 1.0
        # the stable form of the smallest positive root
        far = -r / (q + np.sqrt(root)) if q + np.sqrt(root) > 0.0 else 1.0
        return float(min(far, 1.0))

    def _against(self, k: int, x: np.ndarray, end: np.ndarray) -> tuple[float, float]:
        """Direction of slip that friction opposes; any, for a contact that bears nothing."""
        unit = self.problem.units[k]
        assert isinstance(unit, Friction)
        zero = self.zero * self.problem.scale[unit.tangents[0]]
        for forces in (x, end):
            tangents = forces[list(unit.tangents)]
            if np.hypot(*tangents) > zero:
                return unit_vector(-tangents)
        return (1.0, 0.0)
