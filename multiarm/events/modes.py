"""Modes: a system with its active rows, sliding contacts and guards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, Constraint
from multiarm.dynamics.arrays import ModeStructs
from multiarm.dynamics.contact_geometry import patch_of
from multiarm.dynamics.guard_functions import (
    FrictionCone,
    JointSpeed,
    OpenGap,
    PatchDepth,
    Push,
    Slip,
    SlipOnset,
    SpringCompression,
    SpringExtension,
    StaticFriction,
    Touch,
)
from multiarm.dynamics.guards import Guard, Guards, make_guards
from multiarm.dynamics.model import Data
from multiarm.dynamics.row_selection import MOST_RECENT, Room, RowSelection
from multiarm.dynamics.solver.reactions import make_reaction_work, reaction_shapes
from multiarm.events.kernels import (
    ModeArrays,
    ModeNumbers,
    check_guards,
    mode_struct,
    reaction_sizes,
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
    """The mode that has been entered, until another one is.

    Attributes
    ----------
    choice : Choice
    data : Data
        With the held rows; its forces, guards and sliding contacts are those of the mode.
    arrays : ModeArrays
    slides : Slides
    watched : tuple of Guard
    guards : Guards
        Their table.
    """

    choice: Choice
    data: Data
    arrays: ModeArrays
    slides: Slides
    watched: tuple[Guard, ...]
    guards: Guards

    def set_prestress(self, forces: dict[int, float]) -> None:
        """Set the forces, by row, to which those of the mode are nearest."""
        self.arrays.prestress[:] = [forces.get(int(row), 0.0) for row in self.arrays.held]
        self.arrays.numbers.stressed = True


class Modes:
    """The modes of one Data.

    All of them have one Data, in which the rows of a mode are selected where it is entered.

    Attributes
    ----------
    full : Data
        With all rows: gaps, rates and directions of those that are not held, too.
    closed : Data
        With all contacts of the joints closed, as controllers assume them.
    bare : Data
        With the rows that are always held: how the bodies respond to forces in the others.
    data : Data
        With the held rows of the mode that was entered last.
    slow : float
        Speed below which the direction of slip is smoothed [m/s].
    """

    def __init__(self, full: Data, slow: float):
        unilateral = full.model.unilateral
        assert unilateral is not None, "a system with unilateral contacts"
        self.full, self.unilateral, self.slow = full, unilateral, slow
        self.closed = _view(full, unilateral.model)
        self.bare = self._always(unilateral.bilateral)
        tangents = any(constraint.tangents for constraint in unilateral.constraints)
        self._tangents = RowSelection(full) if tangents else None
        layout = full.model.layout
        sizes = np.diff(layout.dofs).tolist(), np.diff(layout.rows).tolist()
        structs = ModeStructs(active=True, closed=_address(self.closed), full=_address(full))
        self._held = RowSelection(full, modes=structs, shown=full.arrays.shown)
        self.data = self._held.data
        self.data.of_laws = self.closed
        self.data.arrays.functions.contact_forces = address_of(record_forces)
        self.data.arrays.functions.guards = address_of(check_guards)
        self._numbers = ModeNumbers(slow=slow, power=_power_of_friction(full))
        self._reactions = None
        if self._tangents is not None:
            structs.tangents = _address(self._tangents.data)
            self._reactions = _Reactions(self.data, *sizes)
        everything_open = Choice(
            tuple(
                ContactState.FORWARD if constraint.kind == DRY_JOINT else ContactState.OPEN
                for constraint in unilateral.constraints
            ),
            (),
        )
        self._prepared = lru_cache(MOST_RECENT)(self._prepare)
        mode = self._make(everything_open)
        reactions = None if self._reactions is None else self._reactions.work
        self._struct = mode_struct(mode.arrays, mode.slides, mode.guards, reactions)
        structs.mode = self._struct.ctypes.data
        self._select(everything_open)
        # another run may have left friction and active springs
        set_constraint_forces(full, Choice((ContactState.OPEN,) * len(unilateral.constraints), ()))

    @cached_property
    def loose(self) -> Data:
        """Without any row: how the bodies respond where redundant rows share their forces."""
        return self._always(())

    def _always(self, rows: Sequence[int]) -> Data:
        """Data with fixed rows, in which control and effects act as in all modes."""
        data = _view(self.full, rows)
        data.replace_arrays(modes=ModeStructs(active=True, closed=_address(self.closed)))
        data.of_laws = self.closed
        return data

    def enter(self, choice: Choice, directions: dict[int, np.ndarray]) -> Mode:
        """The mode of a choice, with directions of slip, at its beginning."""
        if choice != self._entered.choice:
            self._select(choice)
        mode = self._entered
        for s, u in enumerate(choice.sliding(self.unilateral.constraints)):
            mode.slides.direction[s] = directions[u]
        mode.guards.armed[:] = 0
        self._numbers.muted = self._numbers.stressed = False
        set_constraint_forces(self.full, choice)
        return mode

    def _select(self, choice: Choice) -> None:
        """Select the rows of a choice, and make its sliding contacts and guards."""
        self._entered, struct = self._prepared(choice)
        mode = self._entered
        self._held.select(mode.arrays.held)
        self._struct[: struct.size] = struct
        functions, solver = self.data.arrays.functions, self.data.dense_solver
        functions.solve, solver.reactions = address_of(solve_held), None
        self.data.arrays.modes.slides = mode.slides.row.size > 0
        if mode.slides.row.size:
            assert self._tangents is not None and self._reactions is not None
            self._tangents.select(np.concatenate([[t, t + 1] for t in mode.slides.tangent_of_all]))
            Wr = self._reactions.resize(self.data, self._struct)
            functions.solve, solver.reactions = address_of(solve_sliding), (mode.arrays.Wr, Wr)

    def _prepare(self, choice: Choice) -> tuple[Mode, np.ndarray]:
        """The mode of a choice, and its part of the struct."""
        mode = self._make(choice)
        return mode, mode_struct(mode.arrays, mode.slides, mode.guards)

    def _make(self, choice: Choice) -> Mode:
        rows = np.array(sorted([*self.unilateral.bilateral, *choice.rows]), dtype=np.int64)
        sliding = choice.sliding(self.unilateral.constraints)
        slides = self._slides(choice, rows, sliding)
        watched = self._guards(choice, rows, sliding, slides)
        arrays = self._arrays(choice, rows)
        return Mode(choice, self.data, arrays, slides, watched, make_guards(watched))

    def _arrays(self, choice: Choice, rows: np.ndarray) -> ModeArrays:
        constraints, full = self.unilateral.constraints, self.full
        springs = self.unilateral.compliant
        states = [
            state.recorded
            for state, constraint in zip(choice.states, constraints, strict=True)
            if constraint.kind == CONTACT
        ]
        return ModeArrays(
            numbers=self._numbers,
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
    ) -> tuple[Guard, ...]:
        place = {int(row): k for k, row in enumerate(rows)}
        ground = len(self.full.model.arm_names)
        guards: list[Guard] = []
        for u, constraint in enumerate(self.unilateral.constraints):
            if constraint.compliant:
                is_open = choice.states[u] == ContactState.OPEN
                length = SpringExtension if is_open else SpringCompression
                of_constraint = [Guard(length(constraint.row, constraint.lag), GAP_THRESHOLD)]
            else:
                patch = patch_of(self.full.model, constraint)
                of_constraint = _guards(u, constraint, choice, place, sliding, slides, self.slow)
                if patch is not None:
                    depth = PatchDepth(constraint.row, ground, patch)
                    of_constraint = _patch_guards(u, choice, of_constraint, depth)
            guards += [guard._replace(constraint=u) for guard in of_constraint]
        return tuple(guards)


class _Reactions:
    """The arrays of the node algorithm with friction; some are those of the mode's Data.

    Attributes
    ----------
    work : ReactionWork
        With room for all rows.
    """

    def __init__(self, data: Data, dofs: list[int], rows: list[int]) -> None:
        self._dofs, work = dofs, data.work
        own = make_reaction_work(dofs, rows)
        shapes = reaction_shapes(dofs, rows)
        self._room = Room({name: getattr(own, name) for name in shapes})
        self._prepared = lru_cache(MOST_RECENT)(self._prepare)
        self.work = own._replace(
            dofs=work.dofs,
            rows=work.rows,
            levers=work.levers,
            M=work.M,
            W=work.W,
            L=work.L,
            Y=work.Y,
            y=work.y,
        )

    def resize(self, data: Data, struct: np.ndarray) -> np.ndarray:
        """Write the sizes for the rows of the data into a mode's struct; the arms' reactions."""
        counts = tuple(np.diff(data.model.layout.rows).tolist())
        Wr, places, sizes = self._prepared(counts)
        struct[places] = sizes
        return Wr

    def _prepare(self, counts: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The arms' reactions for numbers of rows; places of sizes in the struct, and sizes."""
        arrays = self._room.arrays(reaction_shapes(self._dofs, list(counts)))
        return arrays["Wr"], *reaction_sizes(arrays)


def _view(full: Data, rows: Sequence[int]) -> Data:
    """Data with some of the rows of ``full``."""
    return full.view(replace(full.model.select(rows), unilateral=None))


def _address(data: Data) -> int:
    return data.struct.ctypes.data


def _power_of_friction(full: Data) -> int:
    """Place of the power of sliding friction; without the effect, of one that stays zero."""
    effects = full.model.effects
    return effects.slot("contact_friction" if "contact_friction" in effects.works else "impacts")


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


def _guards(
    u: int,
    constraint: Constraint,
    choice: Choice,
    place: dict[int, int],
    sliding: list[int],
    slides: Slides,
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
            return [Guard(JointSpeed(constraint.joint), still, sign)]
        friction = StaticFriction(row, constraint.bound)
        return [Guard(friction, FORCE_THRESHOLD * constraint.bound)] if row >= 0 else []
    if state == ContactState.OPEN:
        return [Guard(OpenGap(constraint.row), GAP_THRESHOLD)]
    if row < 0:
        return [Guard(Touch(constraint.row, REST))]
    side, guards = choice.side(u), []
    if not constraint.bilateral or u in sliding:
        guards.append(Guard(Push(row), FORCE_THRESHOLD, int(side)))
    if state == ContactState.STICKING:
        first, second = (place.get(t, -1) for t in constraint.tangents)
        if max(first, second) >= 0:
            cone = FrictionCone(row, side * constraint.mu, first, second)
            guards.append(Guard(cone, FORCE_THRESHOLD))
    resting = constraint.bilateral and u not in sliding
    if state == ContactState.AT_BOUND or (
        resting and not all(t in place for t in constraint.tangents)
    ):
        guards.append(Guard(SlipOnset(constraint.tangents[0], still)))
    elif u in sliding:
        slip = Slip(constraint.tangents[0], sliding.index(u), slides.direction)
        guards.append(Guard(slip, still))
    return guards


def _patch_guards(u: int, choice: Choice, guards: list[Guard], depth: PatchDepth) -> list[Guard]:
    """The guards of a contact that is on its patch on a body, over it, off it or below it."""
    off = u in choice.off_patch
    edge = Guard(depth, GAP_THRESHOLD, -1 if off else 1)
    if off:
        return [edge]
    if u in choice.below_patch:  # it comes up through the patch
        return [edge, Guard(SpringCompression(depth.row, 0.0), GAP_THRESHOLD)]
    return [*guards, edge]
