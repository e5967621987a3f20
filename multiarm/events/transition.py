r"""Transitions between modes: impacts, and then the contact mode of each constraint.

Both are complementarity problems (:mod:`multiarm.events.complementarity`) in the rows of the
constraints that touch, :math:`y = D x + b` (:mod:`multiarm.events.row_dynamics`): of forces and
accelerations, and at impacts of impulses and velocities.

*Impacts.*  A contact that closes with the rate :math:`v_n^-` gets :math:`y_n = v_n^+ + e\,v_n^-` in
place of its rate (Newton's law of restitution), and friction opposes the slip after the impact
(J.J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988).  Where Newton's
law together with friction would add energy, restitution is reduced until it does not.

The result is a :class:`Decision`, whose events :mod:`multiarm.events.decision_events` tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.dynamics.solver.bounds import (
    IMPACT_RESIDUAL,
    NO_ACCELERATION,
    ROUNDED_ENERGY,
    SAME_MOTION,
)
from multiarm.errors import SolverError
from multiarm.events.complementarity import (
    NO_SOLUTION,
    Bounded,
    ComplementaritySolution,
    ContactLaw,
    Verdict,
)
from multiarm.events.contact_laws import ContactProblem, energy_added, law_of
from multiarm.events.event_detection import below_patch_constraints
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes, set_constraint_forces
from multiarm.events.row_dynamics import RowDynamics, can_move, depends_on_held_rows
from multiarm.events.states_by_forces import StatesByForces
from multiarm.results.contact_states import ContactState


@dataclass(frozen=True)
class Hit:
    """An impact of one constraint.

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


@dataclass(frozen=True)
class Undecided:
    """Why a transition has no next mode.

    Attributes
    ----------
    verdict : Verdict
        ``NONE``: no motion obeys the contact laws; ``NOT_FOUND``: none was found that does;
        ``SEVERAL``: more than one does.
    message : str
        The same in a sentence, with the remedy.
    """

    verdict: Verdict
    message: str


@dataclass(frozen=True)
class Decision:
    """Result of a transition.

    Attributes
    ----------
    mode : Mode
        The next one.
    forces : dict
        Forces that obey the contact laws, by row [N, N m].
    residual : float
        Largest residual of the complementarity problems that were solved, dimensionless.
    undecided : Undecided or None
        Where there is no motion, or more than one.
    hits : tuple of Hit
    energy : float
        Kinetic energy that the impact added [J], positive by rounding only.
    rested : tuple of int
        Constraints whose bouncing was ended.
    impulses : dict
        Of all constraints at the impact, by row [N s, N m s].
    at_bound : bool
        Whether contacts slide from now on whose slip does not begin with these forces: with others
        of the same motion they may stick.
    """

    mode: Mode
    forces: dict[int, float]
    residual: float
    undecided: Undecided | None = None
    hits: tuple[Hit, ...] = ()
    energy: float = 0.0
    rested: tuple[int, ...] = ()
    impulses: dict[int, float] = field(default_factory=dict)
    at_bound: bool = False
    _central: Callable[[], _ByForces | None] = lambda: None

    def with_central_forces(self) -> Decision | None:
        """The same motion with all rows in contact held, and forces away from all bounds.

        None where there are no such forces, see :mod:`multiarm.events.complementarity.central`.
        """
        central = self._central()
        return None if central is None else replace(self, **central._asdict())


class _ByForces(NamedTuple):
    """What forces decide, as in :class:`Decision`."""

    mode: Mode
    forces: dict[int, float]
    at_bound: bool


@dataclass(frozen=True)
class Participants:
    """The constraints of an event.

    Attributes
    ----------
    touching : set of int
        Those that touch: contacts and limits with closed gaps, compliant contacts that push.
    at_rest : mapping
        By constraint whose slip has just come to rest: speeds up to which it is at rest
        [m/s, rad/s].
    unloaded : set of int
        Those whose force has just become zero: they open if they can.
    off_patch : frozenset of int
        Those beyond the edge of their patch, see
        :func:`~multiarm.events.event_detection.off_patch_constraints`.
    elastic : bool
        Contacts rebound from an impact.  They do not where a joint takes hold: they were at rest.
    """

    touching: Set[int]
    at_rest: Mapping[int, float] = field(default_factory=dict)
    unloaded: Set[int] = frozenset()
    off_patch: frozenset[int] = frozenset()
    elastic: bool = True


@dataclass(frozen=True)
class _ModeProblem:
    """What decides the contact modes of an instant.

    Attributes
    ----------
    constraints : dict
        Those that forces decide, by their numbers.
    rows : list of int
        Their rows.
    states : list of ContactState
        Of all constraints, as the rates decide them.
    slips : dict
        Unit vectors of the slip of those that slip already.
    fixed : set of int
        Tangents along which none can slip.
    """

    constraints: dict[int, Constraint]
    rows: list[int]
    states: list[ContactState]
    slips: dict[int, np.ndarray]
    fixed: set[int]

    @cached_property
    def at(self) -> dict[int, int]:
        """Rows of the problem by rows of the constraints."""
        return {row: k for k, row in enumerate(self.rows)}


class _Impact(NamedTuple):
    """An impact, as its decision has it."""

    hits: tuple[Hit, ...]
    energy: float
    rested: tuple[int, ...]
    impulses: dict[int, float]


class Transition:
    """The transition at the kinematics of all rows in the data, whose velocities an impact changes.

    Parameters
    ----------
    modes : Modes
    participants : Participants
    rest_height : float
        Bounces lower than this are not simulated [m, rad].
    """

    def __init__(
        self,
        modes: Modes,
        participants: Participants,
        rest_height: float = 0.0,
    ) -> None:
        self._modes, self._constraints = modes, modes.unilateral.constraints
        self._rows = RowDynamics(modes)
        touching, self._off_patch = participants.touching, participants.off_patch
        self._pressed = {u for u in touching if self._constraints[u].compliant}
        self._touching = sorted(touching - self._pressed - self._off_patch - modes.idle)
        self._rest_height, self._at_rest = rest_height, participants.at_rest
        self._unloaded, self._elastic = participants.unloaded, participants.elastic
        self._residual = 0.0

    def decide(self, with_impacts: bool = True) -> Decision:
        """Impacts, unless they are left out, then the contact modes."""
        impact = self._impact() if with_impacts else None
        if impact is not None:
            self._rows.update()
        decision = self._contact_modes()
        if impact is not None:
            decision = replace(decision, **impact._asdict())
        return replace(decision, residual=max(self._residual, decision.residual))

    # --- impacts ----------------------------------------------------------------------------------

    def _impact(self) -> _Impact | None:
        """Change the velocities at an impact; None where nothing hits."""
        constraints, rates, rest = self._constraints, self._rows.rates.copy(), self._rows.rest_rate
        involved = [u for u in self._touching if constraints[u].kind != DRY_JOINT]
        closing = {u for u in involved if not constraints[u].bilateral}
        hit = {u for u in closing if rates[constraints[u].row] < -rest}
        # contacts that hold both ways are still, unless their joint has just taken hold
        caught = not self._elastic and any(
            abs(rates[constraints[u].row]) > rest for u in involved if constraints[u].bilateral
        )
        if not (hit or caught):
            return None
        rows = [row for u in involved for row in (constraints[u].row, *constraints[u].tangents)]
        response, moved = self._rows.response(self._rows.jacobian(rows), self._modes.bilateral)
        before = rates[rows]
        elastic = {u: constraints[u].restitution for u in hit if self._elastic}
        solution, after = self._collide(involved, rows, response, before, elastic, set())
        rested: set[int] = set()
        while low := self._too_low(involved, rows, before, after) - rested:
            rested |= low
            elastic = {u: e for u, e in elastic.items() if u not in rested}
            solution, after = self._collide(involved, rows, response, before, elastic, rested - hit)
        change = moved @ solution.forces
        self._modes.full.arrays.state.velocity[:] += change
        hits = [
            Hit(u, float(rates[constraints[u].row]), float(after[k]), float(solution.forces[k]))
            for u, k in ((u, rows.index(constraints[u].row)) for u in hit)
        ]
        return _Impact(
            hits=tuple(hits),
            energy=energy_added(solution.forces, before, after),
            rested=tuple(sorted(rested & hit)),
            impulses=dict(zip(rows, solution.forces.tolist(), strict=True)),
        )

    def _collide(
        self,
        involved: list[int],
        rows: list[int],
        response: np.ndarray,
        before: np.ndarray,
        elastic: dict[int, float],
        resting: set[int],
    ) -> tuple[ComplementaritySolution, np.ndarray]:
        """Impulses and rates afterwards; ``resting`` constraints do not open."""
        at: dict[int, int] = {row: k for k, row in enumerate(rows)}
        laws: list[ContactLaw] = []  # one for each constraint; then the tangents at rest
        at_rest: list[ContactLaw] = []
        for u in involved:
            constraint = self._constraints[u]
            if u in resting:
                laws.append(Bounded(at[constraint.row], -np.inf, np.inf))
                at_rest += [Bounded(at[t], 0.0, 0.0) for t in constraint.tangents]
            else:
                laws.append(law_of(constraint, at, None))
        laws += at_rest
        share = 1.0
        for _ in range(40):  # halvings of restitution while it would add energy
            shifted = before.copy()
            for u, e in elastic.items():
                k = at[self._constraints[u].row]
                shifted[k] += share * e * before[k]
            solution, _ = ContactProblem(self._of(involved), response, shifted, laws).solve()
            after = before + response @ solution.forces
            reached = 0.5 * abs(before) @ abs(solution.forces)
            if energy_added(solution.forces, before, after) <= ROUNDED_ENERGY * reached:
                break
            share *= 0.5
        self._residual = max(self._residual, solution.residual)
        # a small residual is a solution: velocities are projected on the contacts afterwards
        if solution.verdict in NO_SOLUTION and not solution.residual < IMPACT_RESIDUAL:
            raise SolverError(f"no velocities follow the impact: {solution.message}")
        return solution, after

    def _too_low(
        self, involved: list[int], rows: list[int], before: np.ndarray, after: np.ndarray
    ) -> set[int]:
        """Constraints whose bounce would be lower than ``rest_height``."""
        rest = self._rows.rest_rate
        places = {u: rows.index(self._constraints[u].row) for u in involved}
        bouncing = [u for u, k in places.items() if before[k] <= rest < after[k]]
        if not bouncing:
            return set()
        acceleration = self._free([self._constraints[u].row for u in bouncing])
        low = set()
        for u, back in zip(bouncing, acceleration, strict=True):
            if back < 0.0 and 0.5 * after[places[u]] ** 2 / -back < self._rest_height:
                low.add(u)
        return low

    # --- contact modes ----------------------------------------------------------------------------

    def _contact_modes(self) -> Decision:
        """The next mode, and its forces."""
        constraints = self._constraints
        states, involved, slips = self._states_by_rates()
        moving = tuple(
            ContactState.OPEN if u in involved else state for u, state in enumerate(states)
        )
        set_constraint_forces(self._modes.full, moving)
        if not involved:
            return Decision(self._mode(states, (), frozenset(), {}), {}, 0.0)
        fixed = self._directions_without_slip([u for u in involved if u not in slips])
        unable_to_slip = {u for u in involved if fixed.issuperset(constraints[u].tangents or {-1})}
        rows = [constraints[u].row for u in involved]
        rows += [t for u in involved if u not in unable_to_slip for t in constraints[u].tangents]
        problem = _ModeProblem({u: constraints[u] for u in involved}, rows, states, slips, fixed)
        solution, response, pulling = self._solve(involved, problem.at, slips, fixed)

        def central() -> _ByForces | None:
            forces = solution.central()
            return None if forces is None else self._by_forces(problem, forces, response, pulling)

        chosen = self._by_forces(problem, solution, response, pulling)
        normals = [problem.at[constraints[u].row] for u in involved]
        undecided = _undecided(solution, normals)
        return Decision(
            chosen.mode,
            chosen.forces,
            solution.residual,
            undecided,
            at_bound=chosen.at_bound,
            _central=central,
        )

    def _by_forces(
        self,
        problem: _ModeProblem,
        solution: ComplementaritySolution,
        response: np.ndarray,
        pulling: frozenset[int],
    ) -> _ByForces:
        """The mode and the forces of a solution."""
        by_forces = StatesByForces(
            problem.constraints, problem.at, solution, response, problem.slips
        )
        by_forces.release(self._unloaded)
        by_forces.keep_closed(problem.fixed)
        states, held = by_forces.of_mode(problem.states)
        every = [*problem.rows, *self._modes.bilateral_rows]
        forces = {row: float(x) for row, x in zip(every, solution.forces, strict=False)}
        mode = self._mode(states, held, pulling, by_forces.directions)
        return _ByForces(mode, forces, by_forces.at_bound)

    def _states_by_rates(self) -> tuple[list[ContactState], list[int], dict[int, np.ndarray]]:
        """What the rates decide: states, constraints that forces decide, and unit slips of these.

        Constraints that forces decide are open here, dry joints that they may hold move.
        """
        rates, rest = self._rows.rates.copy(), self._rows.rest_rate
        states = [ContactState.OPEN] * len(self._constraints)
        involved, slips = [], {}
        for u, constraint in enumerate(self._constraints):
            still = max(rest, self._at_rest.get(u, 0.0))
            if constraint.kind == DRY_JOINT:
                if abs(rates[constraint.row]) <= still:
                    involved.append(u)
                forward = rates[constraint.row] > 0.0
                states[u] = ContactState.FORWARD if forward else ContactState.BACKWARD
            elif constraint.compliant:
                states[u] = ContactState.TOUCHING if u in self._pressed else ContactState.OPEN
            elif u in self._modes.idle:
                continue
            elif constraint.bilateral or (u in self._touching and rates[constraint.row] <= rest):
                involved.append(u)
                slip = rates[list(constraint.tangents)]
                speed = float(np.linalg.norm(slip))
                if constraint.tangents and speed > still:
                    slips[u] = slip / speed
        return states, involved, slips

    def _mode(
        self,
        states: list[ContactState],
        held: tuple[int, ...],
        pulling: frozenset[int],
        directions: dict[int, np.ndarray],
    ) -> Mode:
        above = self._off_patch.union(self._touching)
        below = below_patch_constraints(self._modes.full, above)
        holding = self._modes.holding
        return Mode(tuple(states), held, pulling, self._off_patch, below, holding, directions)

    def _directions_without_slip(self, involved: list[int]) -> set[int]:
        """Tangents of bilateral contacts along which the normals of all of them allow no slip.

        Friction along them moves nothing, and is none until they can slip.
        """
        bilateral = [u for u in involved if self._constraints[u].bilateral]
        if not bilateral:
            return set()
        idle = self._modes.idle
        normals = [c.row for u, c in enumerate(self._constraints) if c.bilateral and u not in idle]
        tangents = [t for u in bilateral for t in self._constraints[u].tangents]
        jacobian = self._rows.jacobian([*normals, *tangents])
        response, _ = self._rows.response(jacobian, self._modes.bilateral)
        held, unit_slips = list(range(len(normals))), np.eye(len(response))[len(normals) :]
        return {
            row
            for row, slip in zip(tangents, unit_slips, strict=True)
            if not can_move(response, slip, held)
        }

    def _solve(
        self,
        involved: list[int],
        at: dict[int, int],
        slips: dict[int, np.ndarray],
        fixed: set[int],
    ) -> tuple[ComplementaritySolution, np.ndarray, frozenset[int]]:
        """Forces and modes, the response of the rows of the problem, and who pulls.

        There is no friction along the ``fixed`` tangents.  Where minimum-norm forces depend on the
        bilateral rows too, these follow the given rows.
        """
        constraints, rows = self._constraints, list(at)
        laws = [law_of(constraints[u], at, slips.get(u)) for u in involved]
        jacobian = self._rows.jacobian(rows)
        free = self._free(rows)
        response, _ = self._rows.response(jacobian, self._modes.bilateral)
        bilateral = self._modes.bilateral_rows
        if bilateral and depends_on_held_rows(response, jacobian):
            every, unconstrained = [*rows, *bilateral], self._modes.unconstrained
            laws += [Bounded(len(rows) + k, -np.inf, np.inf) for k in range(len(bilateral))]
            free = self._rows.free_accelerations(every, unconstrained)
            response, _ = self._rows.response(self._rows.jacobian(every), unconstrained)
        free[np.abs(free) < NO_ACCELERATION] = 0.0
        without = [at[row] for row in fixed.intersection(rows)]
        free[without] = response[without] = response[:, without] = 0.0
        solution, pulls = ContactProblem(self._of(involved), response, free, laws).solve()
        return solution, response, frozenset(involved[k] for k in pulls)

    def _of(self, numbers: list[int]) -> list[Constraint]:
        return [self._constraints[u] for u in numbers]

    def _free(self, rows: list[int]) -> np.ndarray:
        return self._rows.free_accelerations(rows, self._modes.bilateral)


def _undecided(solution: ComplementaritySolution, normals: list[int]) -> Undecided | None:
    """Why the motion cannot continue; None where it can.

    Several motions that agree in the accelerations of all gaps differ in how contacts share the
    load; the one with the smallest forces is taken.  Where they do not, one contact opens in one of
    them and pushes in the other.
    """
    if solution.verdict in NO_SOLUTION:
        return Undecided(solution.verdict, solution.message)
    if solution.verdict is not Verdict.SEVERAL:
        return None
    rates = solution.rates[normals]
    size = SAME_MOTION * max(np.max(np.abs(solution.rates)), NO_ACCELERATION)
    for motion in solution.alternatives:
        if np.max(np.abs(motion.rates[normals] - rates), initial=0.0) > size:
            return Undecided(Verdict.SEVERAL, solution.message)
    return None
