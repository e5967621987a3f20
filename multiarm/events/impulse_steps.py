r"""Impulse steps: contact laws between the impulses of a short time and the velocities at its end.

Where events follow one another without end (contacts chatter, bounce ever faster, or stick and slip
in turns), or where no accelerations obey the contact laws (Painleve), a run goes on in steps of
Moreau and Jean.  With :math:`q_m` half a step ahead,

.. math:: q_m = q \oplus \tfrac h2 v, \qquad
          v^+ = v + h\,a(q_m, v) + M^{-1} J^T p, \qquad
          q^+ = q_m \oplus \tfrac h2 v^+ ,

where ``a`` are the accelerations without unilateral contacts, joint stops and dry friction at rest,
and the impulses ``p`` of these obey their laws with the rates :math:`y = J v^+` at the end.  A
contact that approaches and is closed at :math:`q_m`, or would close in the half step after it,
bounces with its restitution e as in an impact, :math:`0 \le p_n \perp y_n + e\,(J v)_n \ge 0`.
Without restitution, and where it first leaves, it gets the impulse with which it just closes,
:math:`0 \le p_n \perp y_n + \max(2\varphi(q_m)/h, (J v)_n) \ge 0`: no faster than it left, so that
normal impulses add no energy.  Friction opposes the slip at the end, and the impulse of dry
friction in a joint is bounded by ``h`` times its torque.  A solution exists where none of
accelerations does: an impulse without a collision.  The step is of the first order; its error is
estimated from two steps of half its length.

Impulses do the work of their product with the mean of the rates before and after.  That of normal
impulses counts as the work of impacts, that of tangential ones as friction's.

References: J.J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, CISM 302,
1988; M. Jean, "The non-smooth contact dynamics method", Comput. Methods Appl. Mech. Eng. 177, 1999;
V. Acary, B. Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, Springer 2008,
chapter 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.dynamics.coordinates import retract
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.failures import require_ok
from multiarm.events.complementarity import (
    Bounded,
    ComplementaritySolution,
    ContactLaw,
    ContactMode,
)
from multiarm.events.complementarity.problem import rows_of
from multiarm.events.contact_laws import ContactProblem, law_of, works_of
from multiarm.events.event_detection import (
    below_patch_constraints,
    off_patch_constraints,
    pressed_constraints,
)
from multiarm.events.mode import Mode
from multiarm.events.modes import (
    CONTACT_FRICTION,
    DRY_FRICTION,
    IMPACTS,
    Modes,
    set_constraint_forces,
)
from multiarm.events.row_dynamics import RowDynamics
from multiarm.events.states_by_forces import StatesByForces
from multiarm.results.contact_states import ContactState

_NO_MODE = Mode((), ())


@dataclass(frozen=True)
class Point:
    """Where a run is between two steps.

    Attributes
    ----------
    t : float
        [s]
    configuration, velocity, states, works : ndarray
        As in the data: (7 F + n,) and (6 F + n,) for F floating frames and n numbers; states of
        effects, works of all forces [J].
    """

    t: float
    configuration: np.ndarray
    velocity: np.ndarray
    states: np.ndarray
    works: np.ndarray


class Involved(NamedTuple):
    """The constraints that may have impulses in a step, and their rows in the middle of it.

    Attributes
    ----------
    constraints : dict
        By their numbers.
    at : dict
        Their rows, and the place of each in the arrays below.
    gaps, before : ndarray, shape (m,)
        Gaps [m, rad], and their rates with the velocity at the beginning [m/s, rad/s].
    jacobian, response, moved : ndarray, shapes (m, v), (m, m), (v, m)
        Rows of the v velocities, and what unit forces on these rows do, see
        :class:`multiarm.events.row_dynamics.RowDynamics`.
    off_patch : frozenset of int
        Constraints beyond the edge of their patch.
    """

    constraints: dict[int, Constraint]
    at: dict[int, int]
    gaps: np.ndarray
    before: np.ndarray
    jacobian: np.ndarray
    response: np.ndarray
    moved: np.ndarray
    off_patch: frozenset[int]


class SolvedImpulses(NamedTuple):
    """The impulses of a step, and what they tell of the mode after it.

    Attributes
    ----------
    involved : Involved
    problem : ContactProblem
    impulses : ndarray
        Of its rows.
    pulls : frozenset of int
        Which of its contacts hold both ways and pull.
    bouncing : set of int
        Which of its contacts have just bounced.
    pressed : set of int
        Compliant contacts that push.
    """

    involved: Involved
    problem: ContactProblem
    impulses: np.ndarray
    pulls: frozenset[int]
    bouncing: Set[int]
    pressed: Set[int]


@dataclass(frozen=True)
class ImpulseStep:
    """Result of a step.

    Attributes
    ----------
    end : Point
    residual : float
        Of the complementarity problem.
    impulses : dict
        Normal impulses of the contacts and stops that pushed in it [N s, N m s], by their numbers.
    touching : set of int
        These, contacts that hold both ways, and springs that push.
    solved : SolvedImpulses
    """

    end: Point
    residual: float
    impulses: Mapping[int, float]
    touching: Set[int]
    solved: SolvedImpulses


class _Rates(NamedTuple):
    """What changes velocities, states of effects and works, without unilateral constraints."""

    acceleration: np.ndarray
    of_states: np.ndarray
    powers: np.ndarray  # [W]


class ImpulseStepper:
    """Makes impulse steps of a system; they leave their end in its data.

    Parameters
    ----------
    modes : Modes
    off_patch : frozenset of int
        Constraints that were beyond the edge of their patch before: one that is on it stays there.
    above : set of int
        Constraints known not to be below their patch.
    """

    def __init__(self, modes: Modes, off_patch: frozenset[int], above: Set[int]) -> None:
        self._modes, self._rows = modes, RowDynamics(modes)
        self._constraints = modes.unilateral.constraints
        self._off_patch, self._above = off_patch, above
        # impulses of the step before over its length [N, N m], by row: where the next ones begin
        self._forces = np.zeros(len(self._rows.gaps))

    def step(self, start: Point, h: float) -> ImpulseStep:
        """A step from a point, of length ``h`` [s].

        Raises
        ------
        SolverError
            When a state in it cannot be evaluated.
        """
        layout, half = self._modes.full.model.layout, 0.5 * h
        middle = replace(
            start,
            t=start.t + half,
            configuration=retract(layout, start.configuration, half * start.velocity),
        )
        self.put(middle)
        pressed = pressed_constraints(self._modes, _NO_MODE, set())
        set_constraint_forces(self._modes.full, self._states_without(pressed))
        rates = self._evaluate()
        involved = self._involve(h)
        free = start.velocity + h * rates.acceleration
        problem, bouncing = self._problem(involved, involved.jacobian @ free, h)
        rows = list(involved.at)
        impulses, residual, pulls = problem.impulses(near=h * self._forces[rows])
        self._forces[:] = 0.0
        self._forces[rows] = impulses / h
        velocity = free + involved.moved @ impulses
        self.put(replace(middle, velocity=velocity))
        # powers of both velocities: their mean is what changes the kinetic energy
        works = start.works + half * (rates.powers + self._evaluate().powers)
        self._add_works(works, involved, impulses, involved.jacobian @ velocity)
        configuration = retract(layout, middle.configuration, half * velocity)
        states = start.states + h * rates.of_states
        end = Point(start.t + h, configuration, velocity, states, works)
        self.put(end)
        normal = {
            u: float(impulses[involved.at[constraint.row]])
            for u, constraint in involved.constraints.items()
            if constraint.kind != DRY_JOINT and not constraint.bilateral
        }
        pushing = {u: impulse for u, impulse in normal.items() if impulse > 0.0}
        bilateral = {u for u, constraint in involved.constraints.items() if constraint.bilateral}
        solved = SolvedImpulses(involved, problem, impulses, pulls, bouncing, pressed)
        return ImpulseStep(end, residual, pushing, pressed | pushing.keys() | bilateral, solved)

    def mode_after(self, step: ImpulseStep) -> Mode:
        """What the constraints do after a step, whose end is in the data."""
        involved, problem, impulses, pulls, bouncing, pressed = step.solved
        solution = _opened(problem.at(impulses, pulls), problem.laws, bouncing)
        by_impulses = StatesByForces(
            involved.constraints, involved.at, solution, involved.response, {}
        )
        by_impulses.keep_closed(frozenset())
        states, held = by_impulses.of_mode(self._states_without(pressed))
        off_patch, numbers = involved.off_patch, list(involved.constraints)
        above = off_patch.union(self._above, by_impulses.states)
        below = below_patch_constraints(self._modes.full, above)
        pulling = frozenset(numbers[k] for k in pulls)
        holding, directions = self._modes.holding, by_impulses.directions
        return Mode(tuple(states), held, pulling, off_patch, below, holding, directions)

    def put(self, point: Point) -> None:
        """Write a point into the data, with the kinematics of all rows."""
        arrays = self._modes.bilateral.arrays
        arrays.time.now = point.t
        arrays.state.configuration[:] = point.configuration
        arrays.state.velocity[:] = point.velocity
        arrays.effects.states[:] = point.states
        self._rows.update()

    def _evaluate(self) -> _Rates:
        """Without forces of unilateral constraints, at the point in the data."""
        data = self._modes.bilateral
        require_ok(data, evaluate_state(data.struct, 0.0, 0.0))
        effects = data.arrays.effects
        return _Rates(
            data.arrays.accelerations.a.copy(), effects.state_rates.copy(), effects.power.copy()
        )

    def _states_without(self, pressed: Set[int]) -> list[ContactState]:
        """States in which only compliant contacts that are ``pressed`` have forces."""
        return [
            ContactState.TOUCHING if u in pressed else ContactState.OPEN
            for u in range(len(self._constraints))
        ]

    def _involve(self, h: float) -> Involved:
        """The constraints whose gaps are closed at the point in the data, or may close soon."""
        full = self._modes.full
        off_patch = off_patch_constraints(
            self._modes, replace(_NO_MODE, off_patch=self._off_patch), set()
        )
        apart = off_patch | below_patch_constraints(full, off_patch | self._above)
        gaps, rates = self._rows.gaps, self._rows.rates
        reach = h * float(np.max(np.abs(full.arrays.state.velocity)))
        constraints = {
            u: constraint
            for u, constraint in enumerate(self._constraints)
            if not constraint.compliant
            and u not in apart
            and u not in self._modes.idle
            and (
                constraint.kind == DRY_JOINT
                or constraint.bilateral
                or gaps[constraint.row] + h * min(rates[constraint.row], 0.0) <= reach
            )
        }
        rows = [row for c in constraints.values() for row in (c.row, *c.tangents)]
        gaps, rates, jacobian = gaps[rows], rates[rows], self._rows.jacobian(rows)
        response, moved = self._rows.response(jacobian, self._modes.bilateral)
        at = {row: k for k, row in enumerate(rows)}
        return Involved(constraints, at, gaps, rates, jacobian, response, moved, off_patch)

    def _problem(
        self, involved: Involved, free: np.ndarray, h: float
    ) -> tuple[ContactProblem, Set[int]]:
        """Of impulses, with the rates ``free`` without them; and contacts that would bounce."""
        laws: list[ContactLaw] = []
        shifted = free.copy()
        bouncing, rest = set(), self._rows.rest_rate
        constraints = list(involved.constraints.values())
        for number, constraint in enumerate(constraints):
            law, k = law_of(constraint, involved.at, None), involved.at[constraint.row]
            if isinstance(law, Bounded):
                law = Bounded(k, h * law.lower, h * law.upper)
            elif not constraint.bilateral:
                gap, rate = involved.gaps[k], involved.before[k]
                closes = gap + 0.5 * h * free[k] < 0.0
                back = -constraint.restitution * min(rate, 0.0)
                hits = rate <= 0.0 and (gap <= 0.0 or (closes and back > 0.0))
                shifted[k] += -back if hits else max(2.0 * gap / h, rate)
                if hits and back > rest:
                    bouncing.add(number)
            laws.append(law)
        return ContactProblem(constraints, involved.response, shifted, laws), bouncing

    def _add_works(
        self, works: np.ndarray, involved: Involved, impulses: np.ndarray, after: np.ndarray
    ) -> None:
        """Add the works of impulses: of friction with its slip, of normal ones to the impacts."""
        slot, of_rows = (
            self._modes.full.model.effects.slot,
            works_of(impulses, involved.before, after),
        )
        for constraint in involved.constraints.values():
            k = involved.at[constraint.row]
            works[slot(DRY_FRICTION if constraint.kind == DRY_JOINT else IMPACTS)] += of_rows[k]
            if constraint.tangents:
                first, second = (involved.at[row] for row in constraint.tangents)
                works[slot(CONTACT_FRICTION)] += of_rows[first] + of_rows[second]
        works[-1] += np.sum(of_rows)


def _opened(
    solution: ComplementaritySolution, laws: list[ContactLaw], bouncing: Set[int]
) -> ComplementaritySolution:
    """A solution in which contacts that bounce are open: their rows are not held afterwards."""
    rows = {row for k in bouncing for row in rows_of(laws[k])}
    modes = [ContactMode.OPEN if k in bouncing else mode for k, mode in enumerate(solution.modes)]
    active = tuple(row for row in solution.active_rows if row not in rows)
    return replace(solution, modes=tuple(modes), active_rows=active)
