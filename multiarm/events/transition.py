r"""What comes after an event: impacts, and then what each constraint does from now on.

Both are complementarity problems (:mod:`multiarm.events.complementarity`) in the rows of the
constraints that touch.  With the bilateral rows active, and no force on the others, a unit force on
row k gives row j the rate :math:`D_{jk}`, which the node algorithm supplies a column at a time.
Then

.. math:: y = D x + b

relates forces ``x`` to accelerations ``y`` (``b``: the accelerations without these forces), and
impulses to velocities after an impact (:mod:`multiarm.events.impact`).
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field

import numpy as np

from multiarm.contacts.kernel import GAP
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.events.complementarity import Bounded, ContactMode, Solution, Verdict, solve
from multiarm.events.edges import below_constraints
from multiarm.events.impact import Hit, Impact
from multiarm.events.instant import can_slip, is_free, law_of, leans_on_others
from multiarm.events.modes import (
    AT_BOUND,
    BACKWARD,
    FORWARD,
    OPEN,
    RESTING,
    SLIDING,
    STICKING,
    TOUCHING,
    Choice,
    Modes,
    set_constraint_forces,
)

# Accelerations below this are roundings [m/s^2, rad/s^2].
NO_ACCELERATION = 1e-10
# Forces below this part of the largest have fallen to zero.
NO_FORCE = 1e-7
# Accelerations that differ by less than this part of the largest are the same.
SAME = 1e-6

_STATES = {
    ContactMode.OPEN: OPEN,
    ContactMode.RESTING: RESTING,
    ContactMode.CLOSED: TOUCHING,
    ContactMode.STICKING: STICKING,
    ContactMode.SLIDING: SLIDING,
    ContactMode.LIMIT: AT_BOUND,
    ContactMode.HOLDING: STICKING,
    ContactMode.AT_LOWER: FORWARD,
    ContactMode.AT_UPPER: BACKWARD,
}


@dataclass(frozen=True)
class Decision:
    """What comes next.

    Attributes
    ----------
    choice : Choice
    directions : dict
        Constraint vectors of the slip of the constraints that slide, by their numbers.
    forces : dict
        Forces that obey the laws, by row [N, N m].
    residual : float
        Largest residual of the complementarity problems that were solved, dimensionless.
    trouble : str
        What is the matter when there is no motion, or more than one; else empty.
    hits : tuple of Hit
    energy : float
        Kinetic energy that the impact added [J], never positive beyond roundings.
    rested : tuple of int
        Units whose endless bouncing was ended.
    """

    choice: Choice
    directions: dict[int, np.ndarray]
    forces: dict[int, float]
    residual: float
    trouble: str = ""
    hits: tuple[Hit, ...] = ()
    energy: float = 0.0
    rested: tuple[int, ...] = field(default=())


class Transition(Impact):
    """Decides at one instant; the state is in the data, and its velocities may be changed.

    Parameters
    ----------
    modes : Modes
    touching : set of int
        Units that touch: contacts and limits whose gaps are closed, compliant contacts that push.
    rest_height : float
        Bounces lower than this are no longer followed [m, rad].
    at_rest : mapping, optional
        Speeds up to which constraints whose slip has just come to rest count as such [m/s, rad/s].
    unloaded : set of int
        Units whose force has just fallen to zero: free to go, they go.
    beside : set of int
        Units whose contacts are beside their patch, see :mod:`multiarm.events.edges`.
    ahead : float
        Accelerations are those so much later [s].  At the very instant at which a bound is reached
        both sides of it are solutions; a little later only one is.
    """

    def __init__(
        self,
        modes: Modes,
        touching: set[int],
        rest_height: float,
        at_rest: Mapping[int, float] | None = None,
        unloaded: Set[int] = frozenset(),
        beside: Set[int] = frozenset(),
        ahead: float = 0.0,
    ):
        pushing = {u for u in touching if modes.unilateral.constraints[u].compliant}
        super().__init__(modes, sorted(touching - pushing - beside), rest_height, ahead)
        self._pressed, self._at_rest = pushing, at_rest or {}
        self._unloaded, self._beside = unloaded, frozenset(beside)

    def decide(self) -> Decision:
        """Impacts, then the choice."""
        self._update()
        hits, energy, rested = self._impact()
        if hits:
            self._update()
        choice, directions, forces, trouble = self._choose()
        return Decision(
            choice, directions, forces, self._residual, trouble, tuple(hits), energy, tuple(rested)
        )

    def stay(self) -> Decision:
        """The choice alone: nothing bounces, whatever it hits."""
        self._update()
        choice, directions, forces, trouble = self._choose()
        return Decision(choice, directions, forces, self._residual, trouble)

    def _choose(self) -> tuple[Choice, dict[int, np.ndarray], dict[int, float], str]:
        """The mode of each constraint from now on, directions of slip, forces, and any trouble."""
        constraints, rates, rest = self._constraints, self._rates().copy(), self._rest_rate()
        states = [OPEN] * len(constraints)
        involved, slips = [], {}
        for u, constraint in enumerate(constraints):
            still = max(rest, self._at_rest.get(u, 0.0))
            if constraint.kind == DRY_JOINT:
                if abs(rates[constraint.row]) <= still:
                    involved.append(u)
                states[u] = FORWARD if rates[constraint.row] > 0.0 else BACKWARD
            elif constraint.compliant:
                states[u] = TOUCHING if u in self._pressed else OPEN
            elif u in self._touching and rates[constraint.row] <= rest:
                involved.append(u)
                slip = rates[list(constraint.tangents)]
                speed = float(np.linalg.norm(slip))
                if constraint.tangents and speed > still:
                    slips[u] = slip / speed
        moving = tuple(OPEN if u in involved else state for u, state in enumerate(states))
        set_constraint_forces(self._modes.full, Choice(moving, ()))
        if not involved:
            return self._chosen(states, ()), {}, {}, ""
        rows = [row for u in involved for row in (constraints[u].row, *constraints[u].tangents)]
        solution, response = self._share(involved, rows, slips)
        at = {row: k for k, row in enumerate(rows)}
        self._residual = max(self._residual, solution.residual)
        directions = dict(slips)
        for k, u in enumerate(involved):
            states[u] = _STATES[solution.modes[k]]
            if states[u] in (SLIDING, AT_BOUND) and u not in directions:
                directions[u] = solution.directions[k]
        active = list(solution.active_rows)
        for u in involved:
            tangents = [at[t] for t in constraints[u].tangents]
            if states[u] == AT_BOUND and can_slip(response, tangents, directions[u], active):
                states[u] = SLIDING
        dropped = self._drop_unloaded(involved, rows, states, solution, response)
        held = tuple(sorted(rows[k] for k in active if k < len(rows) and k not in dropped))
        normal = [at[constraints[u].row] for u in involved]
        every = [*rows, *self._modes.unilateral.bilateral]
        forces = {row: float(x) for row, x in zip(every, solution.forces, strict=False)}
        return self._chosen(states, held), directions, forces, _trouble(solution, normal)

    def _chosen(self, states: list[int], held: tuple[int, ...]) -> Choice:
        below = below_constraints(self._modes, self._beside.union(self._touching))
        return Choice(tuple(states), held, self._beside, below)

    def _drop_unloaded(
        self,
        involved: list[int],
        rows: list[int],
        states: list[int],
        solution: Solution,
        response: np.ndarray,
    ) -> set[int]:
        """Where a force has just fallen to zero, let go of all that bear none; their rows' numbers.

        Those that others do not keep where they are open at once.
        """
        at = {row: k for k, row in enumerate(rows)}
        dropped: set[int] = set()
        none = NO_FORCE * np.max(np.abs(solution.forces), initial=0.0)
        gone = [
            u
            for u in involved
            if self._constraints[u].kind != DRY_JOINT
            and states[u] != OPEN
            and solution.forces[at[self._constraints[u].row]] <= none
        ]
        if not self._unloaded & set(gone):
            return dropped
        for u in gone:
            constraint = self._constraints[u]
            dropped |= {at[row] for row in (constraint.row, *constraint.tangents)}
        for u in gone:
            rest = [k for k in solution.active_rows if k not in dropped]
            states[u] = OPEN if is_free(response, at[self._constraints[u].row], rest) else RESTING
        return dropped

    def _share(
        self, involved: list[int], rows: list[int], slips: dict[int, np.ndarray]
    ) -> tuple[Solution, np.ndarray]:
        """Forces and modes of the constraints, and the response to all rows of the problem.

        Rows that are always held may follow those of the constraints.
        """
        constraints, at = self._constraints, {row: k for k, row in enumerate(rows)}
        laws = [law_of(constraints[u], at, slips.get(u)) for u in involved]
        matrix = self._matrix(rows)
        free = self._free_accelerations(rows, self._bare)
        response, _ = self._response(matrix, self._bare)
        bare = self._modes.unilateral.bilateral
        if bare and leans_on_others(response, matrix):
            # which forces are smallest depends on the rows that are always held too
            every = [*rows, *bare]
            laws += [Bounded(len(rows) + k, -np.inf, np.inf) for k in range(len(bare))]
            free = self._free_accelerations(every, self._modes.loose)
            response, _ = self._response(self._matrix(every), self._modes.loose)
        free[np.abs(free) < NO_ACCELERATION] = 0.0
        return solve(response, free, laws), response


def _trouble(solution: Solution, normal: list[int]) -> str:
    """Why there is no motion to go on with; empty: there is.

    Several motions that agree in the accelerations of all gaps differ in how contacts share the
    load; the one with the smallest forces is as good as any.  Where they do not, one contact opens
    in one of them and pushes in the other.
    """
    if solution.verdict is Verdict.NONE:
        return solution.message
    if solution.verdict is not Verdict.SEVERAL:
        return ""
    rates = solution.rates[normal]
    size = SAME * max(np.max(np.abs(solution.rates)), NO_ACCELERATION)
    for other in solution.alternatives:
        if np.max(np.abs(other.rates[normal] - rates), initial=0.0) > size:
            return solution.message
    return ""


def closed_constraints(modes: Modes, tolerance: float) -> set[int]:
    """Contacts and limits whose gaps are closed at the state in the data."""
    gaps = modes.full.arrays.contacts[:, GAP]
    return {
        u
        for u, constraint in enumerate(modes.unilateral.constraints)
        if constraint.kind != DRY_JOINT
        and not constraint.compliant
        and abs(gaps[constraint.row]) <= tolerance
    }
