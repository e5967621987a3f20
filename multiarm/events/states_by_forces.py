"""What constraints do by the forces of their problem: states, directions of slip and held rows.

The solution of a complementarity problem (:mod:`multiarm.events.complementarity`) has a mode for
each of its laws.  A constraint does what this mode says, except where it cannot move: friction at
its bound is no slip where other rows hold the contact, a contact whose force has just become zero
opens only if others let it, and one that holds both ways stays closed without a force.
"""

from __future__ import annotations

from collections.abc import Sequence, Set

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.dynamics.solver.bounds import NO_ACCELERATION, UNLOADED
from multiarm.events.complementarity import ComplementaritySolution, ContactMode
from multiarm.events.row_dynamics import can_move
from multiarm.results.contact_states import ContactState

_STATES = {
    ContactMode.OPEN: ContactState.OPEN,
    ContactMode.RESTING: ContactState.RESTING,
    ContactMode.CLOSED: ContactState.TOUCHING,
    ContactMode.STICKING: ContactState.STICKING,
    ContactMode.SLIDING: ContactState.SLIDING,
    ContactMode.AT_BOUND: ContactState.AT_BOUND,
    ContactMode.HOLDING: ContactState.STICKING,
    ContactMode.AT_LOWER: ContactState.FORWARD,
    ContactMode.AT_UPPER: ContactState.BACKWARD,
}


class StatesByForces:
    """States of the constraints of a solved problem.

    Parameters
    ----------
    constraints : dict
        Those of the problem, by their numbers, in the order of its laws.
    at : dict
        Rows of these constraints -> rows of the problem; without tangents along which none can
        slip.
    solution : ComplementaritySolution
    response : ndarray
        Of the rows of the problem.
    slips : dict
        Unit vectors of the slip of constraints that slip already, by their numbers.

    Attributes
    ----------
    states : dict
        What each constraint does from now on.
    directions : dict
        Unit vectors of the slip of those that slide or are at the bound of friction.
    held : list of int
        Rows of the problem that are held from now on.
    at_bound : bool
        Whether some contacts slide from now on that the solution has at rest.
    """

    def __init__(
        self,
        constraints: dict[int, Constraint],
        at: dict[int, int],
        solution: ComplementaritySolution,
        response: np.ndarray,
        slips: dict[int, np.ndarray],
    ) -> None:
        self._constraints, self._at = constraints, at
        self._solution, self._response = solution, response
        self.states: dict[int, ContactState] = {}
        self.directions = dict(slips)
        for k, (u, constraint) in enumerate(constraints.items()):
            unable_to_slip = constraint.tangents and constraint.tangents[0] not in at
            state = ContactState.TOUCHING if unable_to_slip else _STATES[solution.modes[k]]
            self.states[u] = state
            if state in (ContactState.SLIDING, ContactState.AT_BOUND):
                self.directions.setdefault(u, solution.directions[k])
        self.held = list(solution.active_rows)
        self.at_bound = self._let_slip()

    def _let_slip(self) -> bool:
        """Let contacts at the bound of friction slide where the closed rows allow it: are any?"""
        closed = {self._at[c.row] for c in self._constraints.values() if c.bilateral}
        closed |= set(self.held)
        begin = False
        for u, state in self.states.items():
            if state == ContactState.AT_BOUND:
                slip = np.zeros(len(self._response))
                slip[self._tangents(u)] = self.directions[u]
                if can_move(self._response, slip, sorted(closed)):
                    self.states[u] = ContactState.SLIDING
                    begin = True
        return begin

    def release(self, unloaded: Set[int]) -> None:
        """Release all constraints without force, if one of them has just become ``unloaded``.

        Those that other rows do not keep closed are open.
        """
        forces = self._solution.forces
        none = UNLOADED * np.max(np.abs(forces), initial=0.0)
        released = {
            u: constraint
            for u, constraint in self._constraints.items()
            if constraint.kind != DRY_JOINT
            and not constraint.bilateral
            and self.states[u] != ContactState.OPEN
            and forces[self._at[constraint.row]] <= none
        }
        if not unloaded & released.keys():
            return
        dropped = {self._at[row] for c in released.values() for row in (c.row, *c.tangents)}
        self.held = [k for k in self.held if k not in dropped]
        for u, constraint in released.items():
            opens = self._can_open(constraint)
            self.states[u] = ContactState.OPEN if opens else ContactState.RESTING

    def keep_closed(self, without_friction: Set[int]) -> None:
        """Hold constraints that hold both ways and have no force, if no other rows do.

        Rows of the problem that are held in any mode keep contacts closed too; only its
        constraints' own rows stay in ``held``, and of these not those ``without_friction``.
        """
        for u, constraint in self._constraints.items():
            unloaded = self.states[u] in (ContactState.OPEN, ContactState.RESTING)
            if not (constraint.bilateral and unloaded and self._can_open(constraint)):
                continue
            self.held.append(self._at[constraint.row])
            slip = self._solution.rates[self._tangents(u)]
            size = float(np.linalg.norm(slip))
            if u not in self.directions and size > NO_ACCELERATION:
                self.directions[u] = slip / size
            slides = u in self.directions
            self.states[u] = ContactState.SLIDING if slides else ContactState.TOUCHING
        rows = list(self._at)
        self.held = [k for k in self.held if k < len(rows) and rows[k] not in without_friction]

    def of_mode(self, states: Sequence[ContactState]) -> tuple[list[ContactState], tuple[int, ...]]:
        """States of all constraints, ``states`` those of the others, and all held rows."""
        every, rows = list(states), list(self._at)
        for u, state in self.states.items():
            every[u] = state
        return every, tuple(sorted(rows[k] for k in self.held))

    def _can_open(self, constraint: Constraint) -> bool:
        """Whether the held rows let the gap of a constraint move."""
        normal = np.eye(len(self._response))[self._at[constraint.row]]
        return can_move(self._response, normal, self.held)

    def _tangents(self, u: int) -> list[int]:
        return [self._at[t] for t in self._constraints[u].tangents]
