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

from collections.abc import Mapping, Set
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
from multiarm.hybrid.edges import below_units
from multiarm.hybrid.modes import (
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
    set_unit_forces,
)
from multiarm.spatial import retract
from multiarm.system import System

# Rates below this are rest [m/s, rad/s], times one plus the largest velocity.
REST_RATE = 1e-9
# Accelerations below this are roundings [m/s^2, rad/s^2].
NO_ACCELERATION = 1e-10
# Of an impact, a residual below this is a solution: velocities are put on the contacts afterwards.
NEARLY = 1e-6
# Forces below this part of the largest have fallen to zero.
NO_FORCE = 1e-7
# A row that others are held beside is free when this part of its response is left.
FREE = 1e-6
# Rows whose scaled response has smaller eigenvalues depend on each other or on others.
DEPENDENT = 1e-7
# Accelerations that differ by less than this part of the largest are the same.
SAME = 1e-6
# Energy that an impact may add, as a part of what is there: roundings.
ADDED = 1e-12
# Halvings of restitution where it would add energy.
HALVINGS = 40

_STATES = {
    Does.OPEN: OPEN, Does.RESTING: RESTING, Does.CLOSED: TOUCHING, Does.STICKING: STICKING,
    Does.SLIDING: SLIDING, Does.LIMIT: AT_BOUND, Does.HOLDING: STICKING,
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


class Transition:
    """Decides at one instant; the state is in the buffers, and its velocities may be changed.

    Parameters
    ----------
    modes : Modes
    touching : set of int
        Units that touch: contacts and limits whose gaps are closed, compliant contacts that push.
    rest_height : float
        Bounces lower than this are no longer followed [m, rad].
    at_rest : mapping, optional
        Speeds up to which units whose slip has just come to rest count as such [m/s, rad/s].
    unloaded : set of int
        Units whose force has just fallen to zero: free to go, they go.
    beside : set of int
        Units whose contacts are beside their patch, see :mod:`multiarm.hybrid.edges`.
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
        self._modes, self._units, self._ahead = modes, modes.plan.units, ahead
        self._bare, self._full = modes.bare, modes.full
        pushing = {u for u in touching if self._units[u].soft}
        self._touching, self._pressed = sorted(touching - pushing - beside), pushing
        self._rest_height, self._at_rest = rest_height, at_rest or {}
        self._unloaded, self._beside = unloaded, frozenset(beside)
        self._residual = 0.0

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

    def _response(self, matrix: np.ndarray, system: System) -> tuple[np.ndarray, np.ndarray]:
        """``D`` and what each unit force does, one a column, with the rows of ``system`` held."""
        motions = [_answer(system, row) for row in matrix]
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
        response, moved = self._response(matrix, self._bare)
        before = rates[rows]
        hit = {u for u in involved if rates[units[u].row] < -rest}
        elastic = {u: units[u].restitution for u in hit}
        solution, after = self._collide(involved, rows, response, before, elastic, set())
        rested: set[int] = set()
        while low := self._too_low(involved, rows, before, after) - rested:
            rested |= low
            elastic = {u: e for u, e in elastic.items() if u not in rested}
            solution, after = self._collide(involved, rows, response, before, elastic, rested - hit)
        change = moved @ solution.forces
        buffers = self._full.buffers
        buffers.twist[:] += change[:6]
        buffers.v[:] += change[6:]
        hits = [
            Hit(u, float(rates[units[u].row]), float(after[k]), float(solution.forces[k]))
            for u, k in ((u, rows.index(units[u].row)) for u in hit)
        ]
        return hits, _added(solution.forces, before, after), sorted(rested & hit)

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
        laws: list[Law] = []
        for u in involved:
            unit = self._units[u]
            if u in resting:
                laws.append(Bounded(at[unit.row], -np.inf, np.inf))
                laws += [Bounded(at[t], 0.0, 0.0) for t in unit.tangents]
            else:
                laws.append(_law(unit, at, None))
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
        if solution.verdict is Verdict.NONE and not solution.residual < NEARLY:
            raise SolverError(f"no velocities follow the impact: {solution.words}")
        return solution, after

    def _too_low(
        self, involved: list[int], rows: list[int], before: np.ndarray, after: np.ndarray
    ) -> set[int]:
        """Units that would bounce too low to be followed, and those thrown up so by others."""
        rest = self._rest_rate()
        places = {u: rows.index(self._units[u].row) for u in involved}
        bouncing = [u for u, k in places.items() if before[k] <= rest < after[k]]
        if not bouncing:
            return set()
        rows_of_them = [self._units[u].row for u in bouncing]
        acceleration = self._free_accelerations(rows_of_them, self._bare)
        low = set()
        for u, back in zip(bouncing, acceleration, strict=True):
            if back < 0.0 and 0.5 * after[places[u]] ** 2 / -back < self._rest_height:
                low.add(u)
        return low

    # --- accelerations ----------------------------------------------------------------------------

    def _free_accelerations(self, rows: list[int], system: System) -> np.ndarray:
        """Accelerations of gaps with the rows of ``system`` held, and no force on others."""
        b, delay = system.buffers, self._ahead
        kept = [array.copy() for array in (b.time, b.position, b.angles)]
        if delay > 0.0:
            b.time[0] += delay
            b.position[:3] += delay * b.twist[:3]
            b.position[3:] = retract(b.position[3:], delay * b.twist[3:])
            b.angles[:] += delay * b.v
        _require(evaluate_buffers(system.book(), 0.0, 0.0), system)
        motion = np.concatenate([b.q_o, b.qdd])
        update_rows(self._full.book())
        free = self._matrix(rows) @ motion + self._full.buffers.contacts[rows, GAP_BIAS]
        if delay > 0.0:
            b.time[:], b.position[:], b.angles[:] = kept
            self._update()
        return free

    def _choose(self) -> tuple[Choice, dict[int, np.ndarray], dict[int, float], str]:
        """What each unit does from now on, directions of slip, forces, and what is the matter."""
        units, rates, rest = self._units, self._rates().copy(), self._rest_rate()
        states = [OPEN] * len(units)
        involved, slips = [], {}
        for u, unit in enumerate(units):
            still = max(rest, self._at_rest.get(u, 0.0))
            if unit.kind == DRY_JOINT:
                if abs(rates[unit.row]) <= still:
                    involved.append(u)
                states[u] = FORWARD if rates[unit.row] > 0.0 else BACKWARD
            elif unit.soft:
                states[u] = TOUCHING if u in self._pressed else OPEN
            elif u in self._touching and rates[unit.row] <= rest:
                involved.append(u)
                slip = rates[list(unit.tangents)]
                speed = float(np.linalg.norm(slip))
                if unit.tangents and speed > still:
                    slips[u] = slip / speed
        moving = tuple(OPEN if u in involved else state for u, state in enumerate(states))
        set_unit_forces(self._modes.plan, Choice(moving, ()))
        if not involved:
            return self._chosen(states, ()), {}, {}, ""
        rows = [row for u in involved for row in (units[u].row, *units[u].tangents)]
        solution, response = self._share(involved, rows, slips)
        at = {row: k for k, row in enumerate(rows)}
        self._residual = max(self._residual, solution.residual)
        directions = dict(slips)
        for k, u in enumerate(involved):
            states[u] = _STATES[solution.modes[k]]
            if states[u] in (SLIDING, AT_BOUND) and u not in directions:
                directions[u] = solution.directions[k]
        for u in involved:
            if states[u] == AT_BOUND and _can_slip(
                response, [at[t] for t in units[u].tangents], directions[u], list(solution.rows)
            ):
                states[u] = SLIDING
        dropped = self._drop_unloaded(involved, rows, states, solution, response)
        held = tuple(sorted(rows[k] for k in solution.rows if k < len(rows) and k not in dropped))
        normal = [at[units[u].row] for u in involved]
        every = [*rows, *self._modes.plan.bare]
        forces = {row: float(x) for row, x in zip(every, solution.forces, strict=False)}
        return self._chosen(states, held), directions, forces, _trouble(solution, normal)

    def _chosen(self, states: list[int], held: tuple[int, ...]) -> Choice:
        below = below_units(self._modes, self._beside.union(self._touching))
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
            if self._units[u].kind != DRY_JOINT
            and states[u] != OPEN
            and solution.forces[at[self._units[u].row]] <= none
        ]
        if not self._unloaded & set(gone):
            return dropped
        for u in gone:
            unit = self._units[u]
            dropped |= {at[row] for row in (unit.row, *unit.tangents)}
        for u in gone:
            rest = [k for k in solution.rows if k not in dropped]
            states[u] = OPEN if _is_free(response, at[self._units[u].row], rest) else RESTING
        return dropped

    def _share(
        self, involved: list[int], rows: list[int], slips: dict[int, np.ndarray]
    ) -> tuple[Solution, np.ndarray]:
        """Forces and modes of the units, and the response to all rows of the problem.

        Rows that are always held may follow those of the units.
        """
        units, at = self._units, {row: k for k, row in enumerate(rows)}
        laws = [_law(units[u], at, slips.get(u)) for u in involved]
        matrix = self._matrix(rows)
        free = self._free_accelerations(rows, self._bare)
        response, _ = self._response(matrix, self._bare)
        bare = self._modes.plan.bare
        if bare and _leans_on_others(response, matrix):
            # which forces are smallest depends on the rows that are always held too
            every = [*rows, *bare]
            laws += [Bounded(len(rows) + k, -np.inf, np.inf) for k in range(len(bare))]
            free = self._free_accelerations(every, self._modes.loose)
            response, _ = self._response(self._matrix(every), self._modes.loose)
        free[np.abs(free) < NO_ACCELERATION] = 0.0
        return solve(response, free, laws), response


def _is_free(response: np.ndarray, row: int, held: list[int]) -> bool:
    """Whether a row can move while others are held."""
    return _gives_way(response, np.eye(len(response))[row], held)


def _can_slip(
    response: np.ndarray, tangents: list[int], direction: np.ndarray, held: list[int]
) -> bool:
    """Whether a contact can slip in a direction while rows are held."""
    along = np.zeros(len(response))
    along[tangents] = direction
    return _gives_way(response, along, held)


def _gives_way(response: np.ndarray, along: np.ndarray, held: list[int]) -> bool:
    """Whether the combination ``along`` of rows can move while others are held."""
    moved = response @ along
    own, across = along @ moved, moved[held]
    through = across @ np.linalg.lstsq(response[np.ix_(held, held)], across, rcond=1e-10)[0]
    return bool(own - through > FREE * own)


def _answer(system: System, push: np.ndarray) -> np.ndarray:
    """Accelerations (velocities) of object and joints to forces (impulses), (6 + n,)."""
    b = system.buffers
    _require(update_kinematics(system.book()), system)
    b.h_o[:], b.h[:], b.c[:] = push[:6], push[6:], 0.0
    _require(solve_constrained(system.book()), system)
    return np.concatenate([b.q_o, b.qdd])


def _leans_on_others(response: np.ndarray, matrix: np.ndarray) -> bool:
    """Whether some forces of the rows move nothing only because other rows hold against them."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(response), np.finfo(float).tiny))
    held_fast = np.diag(response) <= DEPENDENT**2 * np.max(np.diag(response), initial=0.0)
    if np.any(held_fast):
        return True
    values, vectors = np.linalg.eigh(scale[:, None] * response * scale)
    idle = scale[:, None] * vectors[:, values < DEPENDENT * values[-1]]
    left = np.abs(matrix.T @ idle)
    reach = np.abs(matrix.T) @ np.abs(idle)
    return bool(np.any(left > DEPENDENT * np.max(reach, initial=0.0)))


def _trouble(solution: Solution, normal: list[int]) -> str:
    """Why there is no motion to go on with; empty: there is.

    Several motions that agree in the accelerations of all gaps differ in how contacts share the
    load; the one with the smallest forces is as good as any.  Where they do not, one contact opens
    in one of them and pushes in the other.
    """
    if solution.verdict is Verdict.NONE:
        return solution.words
    if solution.verdict is not Verdict.SEVERAL:
        return ""
    rates = solution.rates[normal]
    size = SAME * max(np.max(np.abs(solution.rates)), NO_ACCELERATION)
    for other in solution.alternatives:
        if np.max(np.abs(other.rates[normal] - rates), initial=0.0) > size:
            return solution.words
    return ""


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
        if unit.kind != DRY_JOINT and not unit.soft and abs(gaps[unit.row]) <= tolerance
    }
