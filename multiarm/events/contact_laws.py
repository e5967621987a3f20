r"""Contact laws of constraints, and contacts that hold both ways with friction.

*Contacts that hold both ways* and have friction obey Coulomb's law with the magnitude of their
normal force.  Each is taken for one that only pushes, or only pulls: on the side where it does not
open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
    solve,
)

NO_SIDES = (
    "contacts that hold both ways find no motion with their friction: wherever one pushes it would "
    "have to pull, and the other way round; lessen 'mu'"
)


def energy_added(impulse: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Kinetic energy that impulses add [J]: their product with the mean rates."""
    return 0.5 * float(impulse @ (before + after))


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


def solve_sides(
    constraints: Sequence[Constraint],
    response: np.ndarray,
    rates: np.ndarray,
    laws: list[ContactLaw],
) -> tuple[ComplementaritySolution, frozenset[int]]:
    """Solve with bilateral contacts that push or pull; and which of them pull.

    The first sides are those of the forces without friction in these contacts.  Whichever then
    opens changes its side: all of them at once, or one of them where that has led back.
    """
    bilateral = {k for k, constraint in enumerate(constraints) if constraint.bilateral}
    sided = {
        k: law
        for k, law in enumerate(laws)
        if k in bilateral and isinstance(law, (Friction, Sliding))
    }
    if not sided:
        return solve(response, rates, laws), frozenset()
    smooth: list[ContactLaw] = [law for k, law in enumerate(laws) if k not in sided]
    for law in sided.values():
        smooth.append(Bounded(law.row, -np.inf, np.inf))
        smooth += [Bounded(t, 0.0, 0.0) for t in law.tangents]
    start = solve(response, rates, smooth).forces
    pulls = frozenset(k for k, law in sided.items() if start[law.row] < 0.0)
    tried: set[frozenset[int]] = set()
    while True:
        signs = np.ones(rates.size)
        signs[[sided[k].row for k in pulls]] = -1.0
        solution = solve(signs[:, None] * response * signs, signs * rates, laws)
        wrong = [k for k in sided if solution.modes[k] is ContactMode.OPEN]
        if not wrong or len(tried) > 8 * len(sided):
            break
        tried.add(pulls)
        changes = [frozenset(wrong), *(frozenset([k]) for k in wrong)]
        untried = [pulls ^ change for change in changes if pulls ^ change not in tried]
        if not untried:
            break
        pulls = untried[0]
    if wrong:
        solution = replace(solution, verdict=Verdict.NOT_FOUND, residual=1.0, message=NO_SIDES)
    return solution.turned(signs), pulls
