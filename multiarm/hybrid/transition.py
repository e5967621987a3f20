r"""What comes after an event: impacts, and then what each unit does from now on.

Both are complementarity problems (:mod:`multiarm.complementarity`) in the rows of the units that
touch.  With the rows that are always held kept, and no force on the others, a unit force on row k
gives row j the rate :math:`D_{jk}`, which the node algorithm supplies a column at a time.  Then

.. math:: y = D x + b

relates forces ``x`` to accelerations ``y`` (``b``: the accelerations without these forces), and
impulses to velocities after an impact.  There, a contact that closes with the rate :math:`v_n^-`
gets :math:`y_n = v_n^+ + e\,v_n^-` in place of its rate (Newton's law of restitution), and friction
is against the slip after the impact (J.J. Moreau, Unilateral contact and dry friction in finite
freedom dynamics, 1988).  Where Newton's law together with friction would add energy, restitution is
lessened until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from multiarm.candidates.units import DRY_JOINT, Unit
from multiarm.complementarity import (
    Bounded,
    Friction,
    Push,
    Sliding,
    Solution,
    Verdict,
    solve,
)
from multiarm.complementarity import Mode as Does
from multiarm.complementarity import Unit as Law
from multiarm.contacts.kernel import GAP, GAP_BIAS, GAP_RATE
from multiarm.equations import (
    OK,
    evaluate_buffers,
    solve_constrained,
    update_kinematics,
    update_rows,
)
from multiarm.errors import SolverError
from multiarm.hybrid.modes import (
    BACKWARD,
    FORWARD,
    OPEN,
    RESTING,
    SLIDING,
    STICKING,
    TOUCHING,
    Choice,
    Modes,
    set_dry_friction,
)
from multiarm.system import System

# Rates below this are rest [m/s, rad/s], times one plus the largest velocity.
REST_RATE = 1e-9
# Accelerations below this are roundings [m/s^2, rad/s^2].
NO_ACCELERATION = 1e-10
# Energy that an impact may add, as a part of what is there: roundings.
ADDED = 1e-12
# Halvings of restitution where it would add energy.
HALVINGS = 40

_STATES = {
    Does.OPEN: OPEN, Does.RESTING: RESTING, Does.CLOSED: TOUCHING, Does.STICKING: STICKING,
    Does.SLIDING: SLIDING, Does.LIMIT: SLIDING, Does.HOLDING: STICKING,
    Does.AT_LOWER: FORWARD, Does.AT_UPPER: BACKWARD,
}  # fmt: skip


@dataclass(frozen=True)
class Hit:
    """A unit that hit something.

    Attributes
    ----------
    unit : int
    before, after : float
        Rates of its gap [m/s, rad/s].
    impulse : float
        [N s, N m s]
    """

    unit: int
    before: float
    after: float
    impulse: float


@dataclass(frozen=True)
class Decision:
    """What comes next.

    Attributes
    ----------
    choice : Choice
    directions : dict
        Unit vectors of the slip of the units that slide, by their numbers.
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
    residual: float
    trouble: str = ""
    hits: tuple[Hit, ...] = ()
    energy: float = 0.0
    rested: tuple[int, ...] = field(default=())


class Transition:
    """Decides at one instant; the state is in the buffers, and its velocities may be changed.

    Parameters
    ----------
    modes : Modes
    touching : set of int
        Units that touch: contacts and limits whose gaps are closed.
    slips : mapping unit -> direction
        Directions of contacts whose slip has no speed of its own but is known.
    rest_height : float
        Bounces lower than this are no longer followed [m, rad].
    """

    def __init__(self, modes: Modes, touching: set[int], rest_height: float):
        self._modes, self._units = modes, modes.plan.units
        self._bare, self._full = modes.bare, modes.full
        self._touching = sorted(touching)
        self._rest_height = rest_height
        self._residual = 0.0

    def decide(self) -> Decision:
        """Impacts, then the choice."""
        self._update()
        hits, energy, rested = self._impact()
        if hits:
            self._update()
        choice, directions, trouble = self._choose()
        return Decision(
            choice, directions, self._residual, trouble, tuple(hits), energy, tuple(rested)
        )

    # --- what the rows do -------------------------------------------------------------------------

    def _update(self) -> None:
        """Kinematics of all rows at the state in the buffers."""
        _require(update_kinematics(self._bare.book()), self._bare)
        update_rows(self._full.book())

    def _rates(self) -> np.ndarray:
        return self._full.buffers.contacts[:, GAP_RATE]

    def _rest_rate(self) -> float:
        buffers = self._full.buffers
        fastest = max(np.max(np.abs(buffers.twist)), np.max(np.abs(buffers.v), initial=0.0))
        return REST_RATE * (1.0 + float(fastest))

    def _matrix(self, rows: list[int]) -> np.ndarray:
        """Rows of ``[W_o^T, W^T]``, shape (len(rows), 6 + n)."""
        full = self._full
        layout, matrix = full.layout, np.zeros((len(rows), 6 + full.layout.joints))
        for k, row in enumerate(rows):
            i = int(np.searchsorted(layout.rows, row, side="right")) - 1
            matrix[k, :6] = full.buffers.Wo[row]
            d0, d1 = layout.dofs[i], layout.dofs[i + 1]
            matrix[k, 6 + d0 : 6 + d1] = full.work.Y[i, : d1 - d0, row - layout.rows[i]]
        return matrix

    def _answer(self, push: np.ndarray) -> np.ndarray:
        """Accelerations (velocities) of object and joints to forces (impulses), (6 + n,)."""
        b = self._bare.buffers
        _require(update_kinematics(self._bare.book()), self._bare)
        b.h_o[:], b.h[:], b.c[:] = push[:6], push[6:], 0.0
        _require(solve_constrained(self._bare.book()), self._bare)
        return np.concatenate([b.q_o, b.qdd])

    def _response(self, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``D`` and what each unit force does, one a column."""
        motions = [self._answer(row) for row in matrix]
        moved = np.array(motions).T.reshape(matrix.shape[1], matrix.shape[0])
        response = matrix @ moved
        return 0.5 * (response + response.T), moved

    # --- impacts ----------------------------------------------------------------------------------

    def _impact(self) -> tuple[list[Hit], float, list[int]]:
        """Change the velocities where something hits; hits, energy added, units put to rest."""
        units, rates, rest = self._units, self._rates().copy(), self._rest_rate()
        involved = [u for u in self._touching if units[u].kind != DRY_JOINT]
        if not any(rates[units[u].row] < -rest for u in involved):
            return [], 0.0, []
        rows = [row for u in involved for row in (units[u].row, *units[u].tangents)]
        matrix = self._matrix(rows)
        response, moved = self._response(matrix)
        before = rates[rows]
        elastic = {u: units[u].restitution for u in involved if rates[units[u].row] < -rest}
        solution, after = self._collide(involved, rows, response, before, elastic)
        rested = self._too_low(involved, rows, after, elastic)
        if rested:
            elastic.update(dict.fromkeys(rested, 0.0))
            solution, after = self._collide(involved, rows, response, before, elastic)
        change = moved @ solution.forces
        buffers = self._full.buffers
        buffers.twist[:] += change[:6]
        buffers.v[:] += change[6:]
        hits = [
            Hit(u, float(rates[units[u].row]), float(after[k]), float(solution.forces[k]))
            for u, k in ((u, rows.index(units[u].row)) for u in elastic)
        ]
        return hits, _added(solution.forces, before, after), rested

    def _collide(
        self,
        involved: list[int],
        rows: list[int],
        response: np.ndarray,
        before: np.ndarray,
        elastic: dict[int, float],
    ) -> tuple[Solution, np.ndarray]:
        """Impulses and rates afterwards; restitution is lessened where it would add energy."""
        at = {row: k for k, row in enumerate(rows)}
        laws = [_law(self._units[u], at, None) for u in involved]
        share = 1.0
        for _ in range(HALVINGS):
            shifted = before.copy()
            for u, e in elastic.items():
                k = at[self._units[u].row]
                shifted[k] += share * e * before[k]
            solution = solve(response, shifted, laws)
            after = before + response @ solution.forces
            reached = 0.5 * abs(before) @ abs(solution.forces)
            if _added(solution.forces, before, after) <= ADDED * reached:
                break
            share *= 0.5
        self._residual = max(self._residual, solution.residual)
        if solution.verdict is Verdict.NONE:
            raise SolverError(f"no velocities follow the impact: {solution.words}")
        return solution, after

    def _too_low(
        self, involved: list[int], rows: list[int], after: np.ndarray, elastic: dict[int, float]
    ) -> list[int]:
        """Units that would bounce too low to be followed."""
        bouncing = [u for u in elastic if after[rows.index(self._units[u].row)] > 0.0]
        if not bouncing:
            return []
        acceleration = self._free_accelerations([self._units[u].row for u in bouncing])
        low = []
        for u, back in zip(bouncing, acceleration, strict=True):
            rate = after[rows.index(self._units[u].row)]
            if back < 0.0 and 0.5 * rate * rate / -back < self._rest_height:
                low.append(u)
        return low

    # --- accelerations ----------------------------------------------------------------------------

    def _free_accelerations(self, rows: list[int]) -> np.ndarray:
        """Accelerations of gaps without forces on the units that touch."""
        _require(evaluate_buffers(self._bare.book(), 0.0, 0.0), self._bare)
        b = self._bare.buffers
        motion = np.concatenate([b.q_o, b.qdd])
        update_rows(self._full.book())
        return self._matrix(rows) @ motion + self._full.buffers.contacts[rows, GAP_BIAS]

    def _choose(self) -> tuple[Choice, dict[int, np.ndarray], str]:
        """What each unit does from now on, directions of slip, and what is the matter."""
        units, rates, rest = self._units, self._rates().copy(), self._rest_rate()
        states = [OPEN] * len(units)
        involved, slips = [], {}
        for u, unit in enumerate(units):
            if unit.kind == DRY_JOINT:
                if abs(rates[unit.row]) <= rest:
                    involved.append(u)
                states[u] = FORWARD if rates[unit.row] > 0.0 else BACKWARD
            elif u in self._touching and rates[unit.row] <= rest:
                involved.append(u)
                slip = rates[list(unit.tangents)]
                speed = float(np.linalg.norm(slip))
                if unit.tangents and speed > rest:
                    slips[u] = slip / speed
        moving = tuple(OPEN if u in involved else state for u, state in enumerate(states))
        set_dry_friction(self._modes.plan, Choice(moving, ()))
        if not involved:
            return Choice(tuple(states), ()), {}, ""
        rows = [row for u in involved for row in (units[u].row, *units[u].tangents)]
        at = {row: k for k, row in enumerate(rows)}
        free = self._free_accelerations(rows)
        free[np.abs(free) < NO_ACCELERATION] = 0.0
        response, _ = self._response(self._matrix(rows))
        solution = solve(response, free, [_law(units[u], at, slips.get(u)) for u in involved])
        self._residual = max(self._residual, solution.residual)
        directions = dict(slips)
        for k, u in enumerate(involved):
            states[u] = _STATES[solution.modes[k]]
            if states[u] == SLIDING and u not in directions:
                directions[u] = solution.directions[k]
        held = tuple(sorted(rows[k] for k in solution.rows))
        several = solution.verdict in (Verdict.NONE, Verdict.SEVERAL)
        return Choice(tuple(states), held), directions, solution.words if several else ""


def _law(unit: Unit, at: dict[int, int], slip: np.ndarray | None) -> Law:
    """The law of a unit in the rows of a problem; ``at`` says where its rows are there."""
    if unit.kind == DRY_JOINT:
        return Bounded(at[unit.row], -unit.bound, unit.bound)
    if not unit.tangents:
        return Push(at[unit.row])
    first, second = (at[t] for t in unit.tangents)
    if slip is None:
        return Friction(at[unit.row], (first, second), unit.mu)
    return Sliding(at[unit.row], (first, second), unit.mu, (float(slip[0]), float(slip[1])))


def _added(impulse: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Kinetic energy that impulses add [J]: their mean rates times them."""
    return 0.5 * float(impulse @ (before + after))


def _require(status: int, system: System) -> None:
    if status != OK:
        system.reraise()
        raise SolverError(f"the motion at an event could not be evaluated (status {status})")


def closed_units(modes: Modes, tolerance: float) -> set[int]:
    """Contacts and limits whose gaps are closed at the state in the buffers."""
    gaps = modes.full.buffers.contacts[:, GAP]
    return {
        u
        for u, unit in enumerate(modes.plan.units)
        if unit.kind != DRY_JOINT and abs(gaps[unit.row]) <= tolerance
    }
