"""Modes: a system with its active rows, sliding contacts and guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, Constraint
from multiarm.dynamics.arrays import ModeStructs
from multiarm.dynamics.contact_geometry import patch_of
from multiarm.dynamics.guards import (
    CONE_GUARD,
    GAP_GUARD,
    HOLD_GUARD,
    LIFT_GUARD,
    ONSET_GUARD,
    PATCH_GUARD,
    PUSH_GUARD,
    RATE_GUARD,
    REST_GUARD,
    SLIP_GUARD,
    SPRING_GUARD,
    Guard,
    Guards,
    make_guards,
)
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.reactions import ReactionWork, make_reaction_work
from multiarm.events.kernels import (
    ModeArrays,
    ModeNumbers,
    check_guards,
    mode_struct,
    record_forces,
    solve_held,
    solve_sliding,
)
from multiarm.events.sliding import Slides
from multiarm.jit.pointers import address_of
from multiarm.results.channels import ContactState

# Thresholds above which a guard that was at zero when the mode began counts as positive: gaps [m],
# speeds [m/s, rad/s], and forces as a part of the largest one.
GAP_THRESHOLD, SPEED_THRESHOLD, FORCE_THRESHOLD = 1e-10, 2e-8, 1e-9
# Largest gap or penetration of contacts that touch without force [m].
REST = 1e-9

# Effects whose arrays a mode writes.
DRY_FRICTION, COMPLIANCE = "joint_friction", "contact_compliance"


@dataclass(frozen=True)
class Choice:
    """The states of all constraints, which identify a mode.

    Attributes
    ----------
    states : tuple of ContactState
        By constraint.
    rows : tuple of int
        Their held rows, increasing.
    pulling : frozenset of int
        Bilateral constraints with friction whose normal force pulls, as far as it matters: their
        friction is the coefficient times minus that force.
    off_patch, below_patch : frozenset of int
        Open constraints off their patch, or below it, see :mod:`multiarm.events.event_detection`.
    """

    states: tuple[ContactState, ...]
    rows: tuple[int, ...]
    pulling: frozenset[int] = frozenset()
    off_patch: frozenset[int] = frozenset()
    below_patch: frozenset[int] = frozenset()

    def side(self, u: int) -> float:
        """Sign of the normal force of a closed constraint: 1 where it pushes, -1 where it pulls."""
        return -1.0 if u in self.pulling else 1.0

    def sliding(self, constraints: tuple[Constraint, ...]) -> list[int]:
        """Numbers of the sliding constraints with a held normal row."""
        return [
            u
            for u, constraint in enumerate(constraints)
            if self.states[u] in (ContactState.SLIDING, ContactState.AT_BOUND)
            and constraint.row in self.rows
            and constraint.tangents
        ]


@dataclass(frozen=True, eq=False)
class Mode:
    """One mode of a system.

    Attributes
    ----------
    choice : Choice
    data : Data
        With the held rows; its forces, guards and sliding contacts are those of the mode.
    arrays : ModeArrays
    slides : Slides
    guards : Guards
    """

    choice: Choice
    data: Data
    arrays: ModeArrays
    slides: Slides
    guards: Guards
    _kept: tuple[object, ...]  # objects that kernels access by address

    def set_prestress(self, forces: dict[int, float]) -> None:
        """Set the forces, by row, to which those of the mode are nearest."""
        self.arrays.prestress[:] = [forces.get(int(row), 0.0) for row in self.arrays.held]
        self.arrays.numbers.stressed = True


class Modes:
    """The modes of one Data, built on demand.

    Attributes
    ----------
    full : Data
        With all rows.
    slow : float
        Speed below which the direction of slip is smoothed [m/s].
    closed, bare : Data
        With all contacts of the joints closed; with every unilateral constraint open.
    """

    def __init__(self, full: Data, slow: float):
        assert full.model.unilateral is not None, "a system with unilateral contacts"
        self.full, self.unilateral, self.slow = full, full.model.unilateral, slow
        self.closed = _select(full, self.unilateral.model)
        self._nothing = _select(full, [])
        self._made: dict[Choice, Mode] = {}
        everything_open = tuple(
            ContactState.FORWARD if constraint.kind == DRY_JOINT else ContactState.OPEN
            for constraint in self.unilateral.constraints
        )
        self._open = Choice(everything_open, ())
        self.bare = self.mode(self._open).data

    @property
    def loose(self) -> Data:
        """The bodies without any contact."""
        return self._loose.data

    @cached_property
    def _loose(self) -> Mode:  # kept whole: kernels access its arrays by address
        return self._make(self._open, ())

    def mode(self, choice: Choice) -> Mode:
        """The mode of a choice."""
        if choice not in self._made:
            self._made[choice] = self._make(choice, self.unilateral.bilateral)
        return self._made[choice]

    def enter(self, choice: Choice, directions: dict[int, np.ndarray]) -> Mode:
        """The mode of a choice, with directions of slip, at its beginning."""
        mode = self.mode(choice)
        for s, u in enumerate(choice.sliding(self.unilateral.constraints)):
            mode.slides.direction[s] = directions[u]
        mode.guards.armed[:] = 0
        mode.arrays.numbers.muted = mode.arrays.numbers.stressed = False
        set_constraint_forces(self.full, choice)
        return mode

    def _make(self, choice: Choice, bare: tuple[int, ...]) -> Mode:
        full, constraints = self.full, self.unilateral.constraints
        rows = np.array(sorted([*bare, *choice.rows]), dtype=np.int64)
        sliding = choice.sliding(constraints)
        held = _select(full, rows)
        tangents = [t for u in sliding for t in constraints[u].tangents]
        sideways = _select(full, tangents) if sliding else self._nothing
        arrays, slides = self._arrays(choice, rows), self._slides(choice, rows, sliding)
        guards = self._guards(choice, rows, sliding, slides)
        reactions = _reactions(held) if sliding else None
        struct = mode_struct(arrays, slides, guards, reactions)
        structs = ModeStructs(
            active=True,
            closed=self.closed.struct.ctypes.data,
            full=full.struct.ctypes.data,
            tangents=sideways.struct.ctypes.data,
            mode=struct.ctypes.data,
            slides=bool(sliding),
        )
        held.replace_arrays(modes=structs, shown=full.arrays.shown)
        functions = held.arrays.functions
        functions.solve = address_of(solve_sliding if sliding else solve_held)
        functions.contact_forces = address_of(record_forces)
        functions.guards = address_of(check_guards)
        if reactions is not None:
            held.replace_dense_solver((arrays.Wr, reactions.Yr))
        by_address = sideways, struct, reactions, self.closed, full
        return Mode(choice, held, arrays, slides, guards, by_address)

    def _arrays(self, choice: Choice, rows: np.ndarray) -> ModeArrays:
        constraints, full = self.unilateral.constraints, self.full
        springs, effects = self.unilateral.compliant, full.model.effects
        # of sliding friction; without the effect, a power that stays zero
        slot = effects.slot(
            "contact_friction" if "contact_friction" in effects.works else "impacts"
        )
        states = [
            state.recorded
            for state, constraint in zip(choice.states, constraints, strict=True)
            if constraint.kind == CONTACT
        ]
        return ModeArrays(
            numbers=ModeNumbers(slow=self.slow, power=slot),
            held=rows,
            states=np.array(states, dtype=float),
            Wr=np.zeros((len(rows), 6)),
            prestress=np.zeros(len(rows)),
            springs=np.zeros(0, dtype=np.int64) if springs is None else springs.rows,
            spring_force=np.zeros(0) if springs is None else full.effect(COMPLIANCE).force,
        )

    def _slides(self, choice: Choice, rows: np.ndarray, sliding: list[int]) -> Slides:
        chosen, count = [self.unilateral.constraints[u] for u in sliding], len(sliding)
        normals = [constraint.row for constraint in chosen]
        bounds = self.full.model.layout.rows
        return Slides(
            row=np.searchsorted(rows, normals).astype(np.int64),
            arm=np.searchsorted(bounds, normals, side="right").astype(np.int64) - 1,
            tangent=2 * np.arange(count, dtype=np.int64),
            tangent_of_all=np.array([c.tangents[0] for c in chosen], dtype=np.int64),
            mu=np.array([choice.side(u) * self.unilateral.constraints[u].mu for u in sliding]),
            direction=np.zeros((count, 2)),
            turning=np.zeros((count, 2)),
            speed=np.zeros(count),
        )

    def _guards(
        self, choice: Choice, rows: np.ndarray, sliding: list[int], slides: Slides
    ) -> Guards:
        place = {int(row): k for k, row in enumerate(rows)}
        ground = len(self.full.model.arm_names)
        guards: list[Guard] = []
        for u, constraint in enumerate(self.unilateral.constraints):
            patch = patch_of(self.full.model, constraint)
            of_constraint = _guards(u, constraint, choice, place, sliding, self.slow)
            if constraint.compliant:
                sign = 1 if choice.states[u] == ContactState.OPEN else -1
                of_constraint = [
                    Guard(SPRING_GUARD, constraint.row, constraint.lag, GAP_THRESHOLD, sign=sign)
                ]
            elif patch is not None:
                of_constraint = _patch_guards(u, constraint, choice, of_constraint, ground, patch)
            guards += [guard._replace(constraint=u) for guard in of_constraint]
        return make_guards(guards, slides.direction)


def _select(full: Data, rows: Sequence[int] | np.ndarray) -> Data:
    """Data with some of the rows, at the contact points of two surfaces of ``full``."""
    chosen = np.array(rows, dtype=np.int64)
    model = replace(full.model.select(chosen), unilateral=None)
    data = full.view(model)
    for own, source in full.model.pairs(chosen, model.constants):
        data.arrays.places[own] = full.arrays.places[source]
    return data


def set_constraint_forces(full: Data, choice: Choice) -> None:
    """Set the dry friction of moving joints (zero of held ones), and which springs are active."""
    unilateral = full.model.unilateral
    assert unilateral is not None
    dry = [constraint for constraint in unilateral.constraints if constraint.kind == DRY_JOINT]
    if dry:
        full.effect(DRY_FRICTION).torque[:] = 0.0
    for constraint, state in zip(unilateral.constraints, choice.states, strict=True):
        if constraint.compliant:
            assert unilateral.compliant is not None, "a compliant contact is a spring"
            active = full.effect(COMPLIANCE).active
            active[unilateral.compliant.number(constraint.row)] = state != ContactState.OPEN
        if constraint.kind == DRY_JOINT and state.moves:
            torque = -constraint.bound if state == ContactState.FORWARD else constraint.bound
            full.effect(DRY_FRICTION).torque[constraint.joint] = torque


def _reactions(held: Data) -> ReactionWork:
    """Arrays of the node algorithm with friction, some of which are those of ``held``."""
    layout, work = held.model.layout, held.work
    sizes = np.diff(layout.dofs).tolist(), np.diff(layout.rows).tolist()
    return make_reaction_work(*sizes)._replace(
        dofs=work.dofs,
        rows=work.rows,
        levers=work.levers,
        M=work.M,
        W=work.W,
        L=work.L,
        Y=work.Y,
        y=work.y,
    )


def _guards(
    u: int,
    constraint: Constraint,
    choice: Choice,
    place: dict[int, int],
    sliding: list[int],
    slow: float,
) -> list[Guard]:
    """The guards of one constraint without a patch; ``place`` maps rows to held rows."""
    # what a slip that has just come to rest may have left; faster contacts at the bound slip
    still = max(SPEED_THRESHOLD, 0.01 * slow)
    state = choice.states[u]
    row = place.get(constraint.row, -1)
    if constraint.kind == DRY_JOINT:
        if state.moves:
            sign = 1 if state == ContactState.FORWARD else -1
            return [Guard(RATE_GUARD, constraint.joint, threshold=still, sign=sign)]
        limit = FORCE_THRESHOLD * constraint.bound
        return [Guard(HOLD_GUARD, row, constraint.bound, limit)] if row >= 0 else []
    if state == ContactState.OPEN:
        return [Guard(GAP_GUARD, constraint.row, threshold=GAP_THRESHOLD)]
    if row < 0:
        return [Guard(kind, constraint.row, REST) for kind in (REST_GUARD, LIFT_GUARD)]
    side, guards = choice.side(u), []
    if not constraint.bilateral or u in sliding:
        guards.append(Guard(PUSH_GUARD, row, threshold=FORCE_THRESHOLD, sign=int(side)))
    if state == ContactState.STICKING:
        tangents = [place.get(t, -1) for t in constraint.tangents]
        if max(tangents) >= 0:
            mu = side * constraint.mu
            guards.append(Guard(CONE_GUARD, row, mu, FORCE_THRESHOLD, (tangents[0], tangents[1])))
    resting = constraint.bilateral and u not in sliding
    if state == ContactState.AT_BOUND or (
        resting and not all(t in place for t in constraint.tangents)
    ):
        guards.append(Guard(ONSET_GUARD, constraint.tangents[0], still))
    elif u in sliding:
        s, t = sliding.index(u), constraint.tangents
        guards.append(Guard(SLIP_GUARD, s, threshold=still, tangents=(t[0], t[1])))
    return guards


def _patch_guards(
    u: int,
    constraint: Constraint,
    choice: Choice,
    guards: list[Guard],
    body: int,
    patch: np.ndarray,
) -> list[Guard]:
    """The guards of a contact that is on its patch on a body, over it, off it or below it."""
    off = u in choice.off_patch
    edge = Guard(
        PATCH_GUARD,
        constraint.row,
        threshold=GAP_THRESHOLD,
        sign=-1 if off else 1,
        body=body,
        patch=patch,
    )
    if off:
        return [edge]
    if u in choice.below_patch:  # a spring without damping: its extension is the gap
        return [edge, Guard(SPRING_GUARD, constraint.row, threshold=GAP_THRESHOLD, sign=-1)]
    return [*guards, edge]
