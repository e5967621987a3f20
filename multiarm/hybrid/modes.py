"""A mode: the system with the rows that are held now, its sliding contacts and its guards."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from multiarm.candidates.plan import Plan
from multiarm.candidates.units import CONTACT, DRY_JOINT, Unit
from multiarm.contacts.records import SURFACE_ON_ARM, Contact, Patch
from multiarm.dense_call import dense_call
from multiarm.hybrid.arrays import (
    ASIDE,
    CONE_GUARD,
    FULL,
    GAP_GUARD,
    GUARD_WIDTH,
    HOLD_GUARD,
    LEVEL_WIDTH,
    LINKS,
    MODEL,
    OWN,
    PATCH_GUARD,
    PUSH_GUARD,
    RATE_GUARD,
    REST_GUARD,
    SLIDE_WIDTH,
    SLIP_GUARD,
    ModeArrays,
    mode_book,
)
from multiarm.hybrid.kernels import (
    check_guards,
    forces_by_model,
    show_forces,
    solve_held,
    solve_sliding,
)
from multiarm.hybrid.selection import select
from multiarm.lowlevel import CallBack, address_of
from multiarm.node.reactions import ReactionWork, make_reaction_work
from multiarm.plant import CALL_DENSE, CALL_FORCES, CALL_GUARDS, CALL_SHOW, CALL_SOLVE
from multiarm.system import System

# What a unit does, as it is recorded; a joint that moves against dry friction has its sign instead.
OPEN, TOUCHING, SLIDING, STICKING, RESTING = range(5)
FORWARD, BACKWARD = 5, 6
STATE_NAMES = {
    OPEN: "open", TOUCHING: "touching", SLIDING: "sliding", STICKING: "sticking",
    RESTING: "resting", FORWARD: "moving", BACKWARD: "moving",
}  # fmt: skip

# A guard that is at zero when a mode begins counts as positive above so much: gaps [m], speeds
# [m/s, rad/s], and forces as a part of the largest one.
GAP_THRESHOLD, SPEED_THRESHOLD, FORCE_THRESHOLD = 1e-10, 1e-8, 1e-9
# Contacts that touch without force may sink in by so much before they are looked at again [m].
REST = 1e-9


@dataclass(frozen=True)
class Choice:
    """Which units do what.

    Attributes
    ----------
    states : tuple of int
        By unit, ``OPEN`` to ``BACKWARD``.
    rows : tuple of int
        Rows of units that are held, increasing.
    """

    states: tuple[int, ...]
    rows: tuple[int, ...]

    def sliding(self, units: tuple[Unit, ...]) -> list[int]:
        """Numbers of the units that slide with their normal row held."""
        return [
            u
            for u, unit in enumerate(units)
            if self.states[u] == SLIDING and unit.row in self.rows and unit.tangents
        ]


@dataclass(frozen=True, eq=False)
class Mode:
    """One mode of a system.

    Attributes
    ----------
    choice : Choice
    system : System
        With the rows held now; its forces, guards and sliding are those of the mode.
    arrays : ModeArrays
    """

    choice: Choice
    system: System
    arrays: ModeArrays
    _kept: tuple[object, ...]  # arrays and systems that the kernels reach by their addresses

    def set_directions(self, directions: dict[int, np.ndarray], units: tuple[Unit, ...]) -> None:
        """Set the directions of slip, by number of the unit."""
        for s, u in enumerate(self.choice.sliding(units)):
            self.arrays.direction[s] = directions[u]


class Modes:
    """All modes of a system that a run has come to.

    Attributes
    ----------
    full : System
        With all rows.
    model, bare : System
        See :class:`multiarm.candidates.plan.Plan`; in ``bare`` every unit is open.
    """

    def __init__(self, full: System):
        assert full.plan is not None, "a system whose contacts come and go"
        self.full, self.plan = full, full.plan
        self.model = select(full, self.plan.model)
        self._nothing = select(full, [])
        self._made: dict[Choice, Mode] = {}
        everything_open = tuple(
            FORWARD if unit.kind == DRY_JOINT else OPEN for unit in self.plan.units
        )
        self.bare = self.mode(Choice(everything_open, ())).system

    def mode(self, choice: Choice) -> Mode:
        """The mode of a choice, made when it is first asked for."""
        if choice not in self._made:
            self._made[choice] = self._make(choice)
        return self._made[choice]

    def enter(self, choice: Choice, directions: dict[int, np.ndarray]) -> Mode:
        """The mode of a choice, ready to be simulated in."""
        mode = self.mode(choice)
        mode.set_directions(directions, self.plan.units)
        arrays = mode.arrays
        arrays.armed[:] = arrays.muted[:] = 0
        arrays.least[:] = np.inf
        set_dry_friction(self.plan, choice)
        return mode

    def _make(self, choice: Choice) -> Mode:
        full, units = self.full, self.plan.units
        rows = np.array(sorted([*self.plan.bare, *choice.rows]), dtype=np.int64)
        sliding = choice.sliding(units)
        held = select(full, rows)
        tangents = [t for u in sliding for t in units[u].tangents]
        aside = select(full, tangents) if sliding else self._nothing
        arrays = self._arrays(choice, rows, sliding)
        reactions = _reactions(held) if sliding else None
        book = mode_book(arrays, reactions)
        links, plant = np.zeros(LINKS, dtype=np.int64), held.plant
        others = {MODEL: self.model.book(), FULL: full.book(), ASIDE: aside.book(), OWN: book}
        for at, other in others.items():
            links[at : at + 2] = other.ctypes.data, other.size
        plant.calls[CALL_FORCES] = address_of(forces_by_model)
        plant.calls[CALL_SOLVE] = address_of(solve_sliding if sliding else solve_held)
        plant.calls[CALL_SHOW] = address_of(show_forces)
        plant.calls[CALL_GUARDS] = address_of(check_guards)
        buffers = held.buffers._replace(shown=self.plan.shown)
        calls = held.calls
        if reactions is not None:
            solve = dense_call(plant.pointers, buffers, held.work, (arrays.Wr, reactions.Yr))
            calls = {**calls, "dense": CallBack(solve, buffers.flag)}
            plant.calls[CALL_DENSE] = calls["dense"].address
        system = replace(
            held, plant=plant._replace(links=links), buffers=buffers, calls=calls, plan=None
        )
        return Mode(
            choice, system, arrays, (held, aside, book, reactions, others, self.model, full)
        )

    def _arrays(self, choice: Choice, rows: np.ndarray, sliding: list[int]) -> ModeArrays:
        units, full = self.plan.units, self.full
        place = {int(row): k for k, row in enumerate(rows)}
        slides = np.zeros((len(sliding), SLIDE_WIDTH), dtype=np.int64)
        for s, u in enumerate(sliding):
            arm = int(np.searchsorted(full.layout.rows, units[u].row, side="right")) - 1
            slides[s] = place[units[u].row], arm, 2 * s, units[u].tangents[0]
        guards, levels, patches = [], [], []
        for u, unit in enumerate(units):
            for kind, abc, parameter, threshold in _guards(u, unit, choice, place, sliding):
                guards.append([kind, *abc, u])
                levels.append([parameter, threshold])
                patches.append(np.zeros(18))
            patch = _patch(full, unit)
            if patch is not None and unit.row in place:
                guards.append([PATCH_GUARD, unit.row, -1, -1, u])
                levels.append([0.0, GAP_THRESHOLD])
                patches.append(patch)
        g = len(guards)
        states = [choice.states[u] for u, unit in enumerate(units) if unit.kind == CONTACT]
        return ModeArrays(
            held=rows,
            slides=slides,
            slide_mu=np.array([units[u].mu for u in sliding]),
            direction=np.zeros((len(sliding), 2)),
            turning=np.zeros((len(sliding), 2)),
            speed=np.zeros(len(sliding)),
            slots=np.array([_friction_slot(full)], dtype=np.int64),
            states=np.array(states, dtype=float),
            guards=np.array(guards, dtype=np.int64).reshape(-1, GUARD_WIDTH),
            levels=np.array(levels).reshape(-1, LEVEL_WIDTH),
            values=np.zeros(g),
            before=np.zeros(g),
            rates=np.zeros(g),
            least=np.full(g, np.inf),
            armed=np.zeros(g, dtype=np.int64),
            found=np.zeros(g, dtype=np.int64),
            muted=np.zeros(1, dtype=np.int64),
            span=np.zeros(2),
            patches=np.array(patches).reshape(-1, 18),
            Wr=np.zeros((len(rows), 6)),
        )


def _friction_slot(full: System) -> int:
    """Place of the power of sliding friction; without it one where nothing is ever noted."""
    has_it = "contact_friction" in full.pieces.works
    return full.pieces.slot("contact_friction" if has_it else "impacts")


def set_dry_friction(plan: Plan, choice: Choice) -> None:
    """Torques of dry friction of the joints that move, zero of those that are held."""
    plan.dry[:] = 0.0
    for unit, state in zip(plan.units, choice.states, strict=True):
        if unit.kind == DRY_JOINT and state in (FORWARD, BACKWARD):
            plan.dry[unit.joint] = -unit.bound if state == FORWARD else unit.bound


def _reactions(held: System) -> ReactionWork:
    """Arrays of the node algorithm with friction that share what others read with the system's."""
    layout, work = held.layout, held.work
    sizes = np.diff(layout.dofs).tolist(), np.diff(layout.rows).tolist()
    return make_reaction_work(*sizes)._replace(
        dofs=work.dofs, rows=work.rows, L=work.L, Y=work.Y, y=work.y
    )


def _guards(
    u: int, unit: Unit, choice: Choice, place: dict[int, int], sliding: list[int]
) -> list[tuple[int, tuple[int, int, int], float, float]]:
    """Kind, (a, b, c), parameter and threshold of the guards of one unit."""
    state = choice.states[u]
    row = place.get(unit.row, -1)
    if unit.kind == DRY_JOINT:
        if state in (FORWARD, BACKWARD):
            sign = 1.0 if state == FORWARD else -1.0
            return [(RATE_GUARD, (unit.joint, -1, -1), sign, SPEED_THRESHOLD)]
        limit = FORCE_THRESHOLD * unit.bound
        return [(HOLD_GUARD, (row, -1, -1), unit.bound, limit)] if row >= 0 else []
    if state == OPEN:
        return [(GAP_GUARD, (unit.row, -1, -1), 0.0, GAP_THRESHOLD)]
    if row < 0:
        return [(REST_GUARD, (unit.row, -1, -1), REST, 0.0)]
    guards = [(PUSH_GUARD, (row, -1, -1), 0.0, FORCE_THRESHOLD)]
    if state == STICKING:
        tangents = [place.get(t, -1) for t in unit.tangents]
        if max(tangents) >= 0:
            guards.append((CONE_GUARD, (row, tangents[0], tangents[1]), unit.mu, FORCE_THRESHOLD))
    if u in sliding:
        guards.append((SLIP_GUARD, (sliding.index(u), -1, -1), 0.0, SPEED_THRESHOLD))
    return guards


def _patch(full: System, unit: Unit) -> np.ndarray | None:
    """Frame and corners of the patch of the surroundings that a contact must stay on."""
    record = full.records[unit.row]
    if unit.arm in full.arms or not isinstance(record, Contact):
        return None
    patch: Patch | None = record.arm.patch
    if patch is None or record.surface_body != SURFACE_ON_ARM:
        return None
    lower, upper = (np.clip(c, -1e300, 1e300) for c in (patch.lower, patch.upper))
    return np.concatenate([patch.pose[:3, :3].ravel(), patch.pose[:3, 3], lower, upper])
