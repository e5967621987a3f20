"""The modes of a system: the rows, sliding contacts and guards of one at a time.

All modes of a system have one Data and one set of arrays, with room for all rows, sliding contacts
and guards.  Where a mode is entered, its rows are selected (:mod:`multiarm.dynamics.row_selection`)
and the arrays are written anew; nothing is made that stays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from multiarm.contacts.table import records_of
from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, UnilateralConstraints
from multiarm.dynamics.callbacks import DenseSolver
from multiarm.dynamics.data import Data
from multiarm.dynamics.guards import Guard, Guards
from multiarm.dynamics.references import Reference
from multiarm.dynamics.row_selection import MOST_RECENT, RowSelection, beginnings
from multiarm.dynamics.sliding import FrictionNumbers, Slides
from multiarm.dynamics.solver.reactions import ReactionWork, make_reaction_work, reaction_shapes
from multiarm.dynamics.variables import ModeStructs
from multiarm.events.joint_places import JointFrame, JointPlace, with_own_places
from multiarm.events.kernels import (
    ModeArrays,
    ModeNumbers,
    accept_mode_step,
    check_guards,
    make_mode_struct,
    mode_sizes,
    record_forces,
    solve_held,
    solve_sliding,
    write_guards,
)
from multiarm.events.mode import Mode
from multiarm.events.mode_guards import ModeGuards, MomentNumber
from multiarm.integration.step import watch_stage
from multiarm.jit.pointers import PythonCallback, address_of
from multiarm.results.contact_states import ContactState
from multiarm.spatial import matrix_to_quaternion

# Effects whose arrays a mode writes.
DRY_FRICTION, COMPLIANCE = "joint_friction", "contact_compliance"
# Effects whose works are those of impulses and of sliding friction.
IMPACTS, CONTACT_FRICTION = "impacts", "contact_friction"
# How states are recorded.
_RECORDED = np.array([float(state.recorded) for state in ContactState])


class Modes:
    """The modes of one Data, of which one has been entered.

    Attributes
    ----------
    full : Data
        With all rows: gaps, rates and directions of those that are not held, too.
    closed : Data
        With all contacts of the joints closed.
    of_laws : Data
        The same for control laws, of joints that hold; with tangents where these count friction.
    bilateral : RowSelection
        With the rows that are held whatever contacts do: how the bodies respond to forces in the
        others.
    bilateral_rows : tuple of int
        These rows.
    holding : frozenset of int
        Timed joints that hold.
    idle : frozenset of int
        Constraints of those that do not.
    frames : list of tuple
        The frames of each timed joint on its first and on its second body.
    awaited : frozenset of (int, int)
        Moments of timed joints that are awaited and that functions tell: these have guards.
    data : RowSelection
        With the held rows of the mode.
    mode : Mode
    slides, guards : Slides, Guards
        Its sliding contacts, and the table of its guards.
    watched : list of Guard
        These guards.
    numbers : ModeNumbers
    arrays : ModeArrays
        With room for all rows.
    slow : float
        Speed below which the direction of slip is smoothed [m/s].
    """

    def __init__(self, full: Data, slow: float):
        unilateral = full.model.unilateral
        assert unilateral is not None, "a system with unilateral contacts"
        written, located = full.model, [k for k, j in enumerate(unilateral.timed) if j.located]
        if located:
            full = with_own_places(full)
        self._places = {k: JointPlace(full, written, unilateral.timed[k]) for k in located}
        self.frames = [
            (JointFrame(full, joint.connection, False), JointFrame(full, joint.connection, True))
            for joint in unilateral.timed
        ]
        self.full, self.unilateral, self.slow = full, unilateral, slow
        self.closed = full.closed
        # of each joint that is placed, the geometry that is also elsewhere
        self._copies = {k: [self._copied(self.closed, unilateral.model, k)] for k in located}
        self.holding: frozenset[int] = frozenset()
        self.idle = unilateral.idle_without(self.holding)
        everything = frozenset(range(len(unilateral.timed)))
        self._laws: dict[frozenset[int], Data] = {}
        self._remember(everything, full.of_laws)
        self.of_laws = self.prepare(self.holding)
        self._structs, self._without_contacts = ModeStructs(active=True), ModeStructs(active=True)
        self._structs.refer(of_laws=self.of_laws.reference, full=full.reference)
        self._without_contacts.refer(of_laws=self.of_laws.reference)
        self.bilateral = RowSelection(full, modes=self._without_contacts)
        self.bilateral_rows = unilateral.bilateral_with(self.holding)
        self.bilateral.select(np.array(self.bilateral_rows, dtype=np.int64))
        self.bilateral.of_laws = self.of_laws
        self.data = RowSelection(full, modes=self._structs, sample=full.arrays.sample)
        self.data.of_laws = self.of_laws
        self._functions = functions = self.data.arrays.functions
        functions.contact_forces = address_of(record_forces)
        functions.guards, functions.accept = address_of(check_guards), address_of(accept_mode_step)
        functions.watch = address_of(watch_stage)
        self._solve_held, self._solve_sliding = address_of(solve_held), 0
        self._reactions = None
        if any(constraint.tangents for constraint in unilateral.constraints):
            self._solve_sliding = address_of(solve_sliding)
            self.data.tangents = RowSelection(full)
            self._structs.refer(tangents=self.data.tangents.reference)
            self._reactions = _reactions(full, self.data)
            self._dense = DenseSolver(self.data)
            answer = PythonCallback(self._dense, self.data.arrays.status)
            self.data.add_callback("dense_with_friction", answer)
        self.numbers = ModeNumbers()
        self.arrays = self._room_for_rows()
        kinds = [constraint.kind for constraint in unilateral.constraints]
        self._contacts = np.array([kind == CONTACT for kind in kinds], dtype=bool)
        self._slides, self._of_slides = self._room_for_slides()
        self._guards = ModeGuards(full, slow, self._slides.direction)
        self.awaited: frozenset[MomentNumber] = frozenset()
        self._struct = make_mode_struct(
            self._guards.table, self._slides, self.arrays, self._reactions
        )
        owners = self._guards, self._slides, self.arrays, self._reactions
        self._structs.refer(mode=Reference(self._struct, owners))
        self._joints, self._node = full.model.layout.joint_counts, full.model.layout.node
        self._sizes = mode_sizes(
            reaction_shapes(self._joints, full.model.layout.contact_counts, self._node)
        )
        everything_open = [
            ContactState.FORWARD if kind == DRY_JOINT else ContactState.OPEN for kind in kinds
        ]
        self._tables = lru_cache(MOST_RECENT)(partial(_tables, unilateral, self._guards))
        self.mode = Mode(tuple(everything_open), (), holding=self.holding)
        self._stale = False
        self._select(self.mode)
        # another run may have left friction and active springs
        set_constraint_forces(full, (ContactState.OPEN,) * len(unilateral.constraints))

    # --- timed joints -----------------------------------------------------------------------------

    @cached_property
    def unconstrained(self) -> Data:
        """Without any row: how the bodies respond where redundant rows share their forces."""
        data = self.full.view(replace(self.full.model.select(()), unilateral=None))
        data.replace_arrays(modes=self._without_contacts)
        data.of_laws = self.of_laws
        return data

    def moments_of(self, guards: Iterable[int]) -> list[MomentNumber]:
        """The moments that some of the mode's guards watch."""
        numbers = {self._numbers_of_guards[g] for g in guards}
        return [moment for moment, g in self._guards.of_moments.items() if g in numbers]

    def hold(self, holding: frozenset[int], awaited: frozenset[MomentNumber] = frozenset()) -> None:
        """Let these timed joints hold, and no others, in modes that are entered from now on."""
        self._stale |= (holding, awaited) != (self.holding, self.awaited)
        self.awaited = awaited
        if holding == self.holding:
            return
        self.holding, self.idle = holding, self.unilateral.idle_without(holding)
        self.bilateral_rows = self.unilateral.bilateral_with(holding)
        self.bilateral.select(np.array(self.bilateral_rows, dtype=np.int64))
        self.of_laws = self.prepare(holding)
        for structs in (self._structs, self._without_contacts):
            structs.refer(of_laws=self.of_laws.reference)
        for data in (self.data, self.bilateral, self.unconstrained):
            data.of_laws = self.of_laws

    def prepare(self, holding: frozenset[int]) -> Data:
        """What laws see while these timed joints hold, made where it is not known yet."""
        if holding not in self._laws:
            self._remember(holding, self.full.view(self.full.model.of_laws(holding)))
        return self._laws[holding]

    def _remember(self, holding: frozenset[int], of_laws: Data) -> None:
        self._laws[holding] = of_laws
        rows = self.unilateral.rows_held_by(holding, self.unilateral.of_laws)
        for k in holding.intersection(self._places):
            self._copies[k].append(self._copied(of_laws, rows, k))

    def _copied(self, data: Data, rows: tuple[int, ...], timed: int) -> CopiedGeometry:
        """That of a joint in a table of some rows, which has the shapes of the whole one."""
        table, part = self.full.model.constants.contacts, data.model.constants.contacts
        moved = self.unilateral.rows_of(timed)
        at = [k for k, row in enumerate(rows) if row in moved]
        of_all = [rows[k] for k in at]
        return CopiedGeometry(part.geometry, records_of(part, at), records_of(table, of_all))

    def place(self, timed: int, as_written: bool = False, pose: np.ndarray | None = None) -> None:
        """Let a timed joint hold its bodies where they are now, or as the scene's start has them.

        With a ``pose`` (4, 4), as :meth:`pose_of` has it, there.  Only joints that are ``located``
        are placed; rows that have been selected stay as they were.
        """
        self._stale = True
        place = self._places[timed]
        if pose is not None:
            place.pose = pose
        elif as_written:
            place.return_to_scene()
        else:
            place.take_hold()
        geometry = self.full.model.constants.contacts.geometry
        for copied in self._copies[timed]:
            copied.geometry[copied.records] = geometry[copied.of_all]
        for selection in (self.data, self.data.tangents, self.bilateral):
            if selection is not None:
                selection.forget()

    def where(self, timed: int) -> tuple[float, ...]:
        """Where the frame of a timed joint is on its first body, world [m]."""
        first, _ = self.frames[timed]
        return tuple(first.origin.tolist())

    def is_placed(self, timed: int, pose: np.ndarray | None) -> bool:
        """Whether a joint that is ``located`` has been placed at a pose, or None: is as written.

        At this array, not at another one with the same numbers.
        """
        return self._places[timed].assigned is pose

    def pose_of(self, timed: int) -> np.ndarray:
        """Where a joint that is ``located`` is on its second body, (4, 4)."""
        return self._places[timed].pose

    def place_of(self, timed: int) -> tuple[float, ...] | None:
        """Where a joint that is ``located`` is on its second body: position, quaternion xyzw."""
        if timed not in self._places:
            return None
        pose = self.pose_of(timed)
        return (*pose[:3, 3].tolist(), *matrix_to_quaternion(pose[:3, :3]).tolist())

    # --- the mode that has been entered -----------------------------------------------------------

    @property
    def contradicted(self) -> bool:
        """Whether a guard is violated at the state at which the guards were started."""
        return bool(np.any(self._violated))

    @property
    def _violated(self) -> np.ndarray:
        # a moment whose function is not positive comes now
        return ~(self.guards.value >= -self.guards.level) & self._of_constraints

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Constraints whose guards are violated there, as ``arm/contact`` or ``arm/joint``."""
        numbers = (self.watched[g].constraint for g in np.flatnonzero(self._violated))
        constraints = [self.unilateral.constraints[u] for u in dict.fromkeys(numbers)]
        return tuple(
            self.full.model.joint_names[c.joint] if c.joint >= 0 else f"{c.owner}/{c.name}"
            for c in constraints
        )

    def set_prestress(self, forces: Mapping[int, float]) -> None:
        """Set the forces, by row, to which those of the mode are nearest."""
        rows = self.data.rows
        self.arrays.prestress[: rows.size] = [forces.get(row, 0.0) for row in rows.tolist()]
        self.numbers.stressed = True

    def enter(self, mode: Mode) -> None:
        """Enter a mode at its beginning."""
        assert mode.holding == self.holding, "joints take hold before"
        if mode != self.mode or self._stale:
            self._select(mode)
        self._stale = False
        self.mode = mode
        for s, u in enumerate(self._sliding_constraints):
            self.slides.direction[s] = mode.directions[u]
        self.guards.armed[:] = 0
        self.full.guards.held[:] = self._guards.table.held
        self.numbers.muted = self.numbers.stressed = False
        set_constraint_forces(self.full, mode.states)

    def _select(self, mode: Mode) -> None:
        """Select the rows of a mode, and write its sliding contacts and guards."""
        struct = self._struct
        rows, sliding, numbers, self.watched, self.guards = self._tables(mode, self.awaited)
        self._sliding_constraints, self._numbers_of_guards = sliding, numbers.tolist()
        self._of_constraints = np.array([guard.constraint >= 0 for guard in self.watched], bool)
        if self.data.tangents is not None:
            first = self._of_slides.tangent_of_all[sliding]
            self.data.tangents.select(np.add.outer(first, (0, 1)).ravel())
        self.data.select(rows)
        self.full.arrays.last_step.determinant_signs[:] = 0.0  # determinants of other rows
        struct[self._sizes.rows], struct[self._sizes.slides] = rows.size, len(sliding)
        self._write_rows(mode, rows)
        self._write_slides(mode, self._guards.place(rows, sliding))
        struct[self._sizes.guards] = numbers.size
        write_guards(struct, self._guards.struct, numbers)
        numbers_of_all, *columns = self._slides
        self.slides = Slides(numbers_of_all, *(column[: len(sliding)] for column in columns))
        self._choose_solver(sliding)

    def _write_rows(self, mode: Mode, rows: np.ndarray) -> None:
        arrays = self.arrays
        arrays.held[: rows.size] = rows
        arrays.Wr_o[: rows.size], arrays.prestress[: rows.size] = 0.0, 0.0
        arrays.states[:] = _RECORDED[np.array(mode.states, dtype=np.int64)[self._contacts]]

    def _write_slides(self, mode: Mode, held: np.ndarray) -> None:
        slides, of_all, sliding = self._slides, self._of_slides, self._sliding_constraints
        s = len(sliding)
        if not s:
            return
        slides.row[:s] = held[of_all.row[sliding]]
        slides.block[:s], slides.mu[:s] = of_all.block[sliding], of_all.mu[sliding]
        slides.mu[:s] *= [mode.side(u) for u in sliding]
        slides.tangent_of_all[:s] = of_all.tangent_of_all[sliding]
        slides.turning[:s], slides.speed[:s] = 0.0, 0.0

    def _choose_solver(self, sliding: list[int]) -> None:
        """Solve with friction where contacts slide."""
        self._functions.solve, self._structs.slides = self._solve_held, bool(sliding)
        if not sliding:
            return
        assert self._reactions is not None
        shapes = reaction_shapes(self._joints, self.data.counts, self._node)
        sizes = [size for shape in shapes.values() for size in shape]
        self._struct[self._sizes.reactions] = sizes
        self._functions.solve = self._solve_sliding
        Wr = beginnings(self._reactions, {"Wr": shapes["Wr"]}).Wr
        self._dense.reactions = self.arrays.Wr_o[: self.data.rows.size], Wr

    # --- arrays -----------------------------------------------------------------------------------

    def _room_for_rows(self) -> ModeArrays:
        count, springs = self.full.model.layout.contacts, self.unilateral.compliant
        return ModeArrays(
            numbers=self.numbers,
            held=np.zeros(count, dtype=np.int64),
            states=np.zeros(len(self.unilateral.contacts)),
            Wr_o=np.zeros((count, self.full.model.layout.node)),
            prestress=np.zeros(count),
            springs=np.zeros(0, dtype=np.int64) if springs is None else springs.rows,
            spring_force=np.zeros(0) if springs is None else self.full.effect(COMPLIANCE).force,
        )

    def _room_for_slides(self) -> tuple[Slides, Slides]:
        """Room for the sliding contacts of a mode, and what each constraint is when it slides."""
        constraints, layout = self.unilateral.constraints, self.full.model.layout
        count, rows = len(constraints), [constraint.row for constraint in constraints]
        tangents = [(*constraint.tangents, -1)[0] for constraint in constraints]
        of_all = Slides(
            numbers=FrictionNumbers(slow=self.slow, power=_power_of_friction(self.full)),
            row=np.array(rows, dtype=np.int64),
            block=np.array([layout.block_of_contact(row) for row in rows], dtype=np.int64),
            tangent=2 * np.arange(count, dtype=np.int64),
            tangent_of_all=np.array(tangents, dtype=np.int64),
            mu=np.array([constraint.mu for constraint in constraints]),
            direction=np.zeros((count, 2)),
            turning=np.zeros((count, 2)),
            at_end=np.zeros((count, 2)),
            speed=np.zeros(count),
        )
        return Slides(of_all.numbers, *(column.copy() for column in of_all[1:])), of_all


class CopiedGeometry(NamedTuple):
    """Geometry of some rows that a table has of the whole one."""

    geometry: np.ndarray
    records: np.ndarray
    of_all: np.ndarray  # the same records among all


class _Tables(NamedTuple):
    """What a mode selects: its held rows, sliding constraints and guards."""

    rows: np.ndarray
    sliding: list[int]
    numbers: np.ndarray  # of its guards
    watched: list[Guard]
    guards: Guards


def _tables(
    unilateral: UnilateralConstraints,
    guards: ModeGuards,
    mode: Mode,
    awaited: frozenset[MomentNumber],
) -> _Tables:
    rows = np.array(sorted([*unilateral.bilateral_with(mode.holding), *mode.rows]), dtype=np.int64)
    sliding = mode.sliding(unilateral.constraints)
    numbers = guards.numbers(mode, rows, sliding, awaited)
    watched = [guards.all[k] for k in numbers.tolist()]
    return _Tables(rows, sliding, numbers, watched, guards.first(numbers.size))


def _reactions(full: Data, data: Data) -> ReactionWork:
    """The arrays of the node algorithm with friction; some are those of the mode's Data."""
    work, layout = data.work, full.model.layout
    return make_reaction_work(layout.joint_counts, layout.contact_counts, layout.node)._replace(
        first_joint=work.first_joint,
        first_contact=work.first_contact,
        levers=work.levers,
        M=work.M,
        W=work.W,
        L=work.L,
        Y=work.Y,
        y=work.y,
    )


def _power_of_friction(full: Data) -> int:
    """Place of the power of sliding friction; without the effect, of one that stays zero."""
    effects = full.model.effects
    return effects.slot(CONTACT_FRICTION if CONTACT_FRICTION in effects.works else IMPACTS)


def set_constraint_forces(full: Data, states: Sequence[ContactState]) -> None:
    """Set the dry friction of moving joints (zero of held ones), and which springs are active."""
    unilateral = full.model.unilateral
    assert unilateral is not None
    if any(constraint.kind == DRY_JOINT for constraint in unilateral.constraints):
        full.effect(DRY_FRICTION).torque[:] = 0.0
    for constraint, state in zip(unilateral.constraints, states, strict=True):
        if constraint.compliant:
            assert unilateral.compliant is not None, "a compliant contact is a spring"
            active = full.effect(COMPLIANCE).active
            active[unilateral.compliant.number(constraint.row)] = state != ContactState.OPEN
        if constraint.kind == DRY_JOINT and state.moves:
            torque = -constraint.bound if state == ContactState.FORWARD else constraint.bound
            full.effect(DRY_FRICTION).torque[constraint.joint] = torque
