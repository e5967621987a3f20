"""Taking hold: the impact without restitution at which a joint begins to hold.

Momentum passes through everything that holds at that instant (:mod:`multiarm.dynamics.impacts`);
contacts that only push take part afterwards (:mod:`multiarm.events.transition`), which is the same
impact: their impulses act on bodies that hold each other already.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.contact_forces import wrenches_of
from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics, update_rows, write_inertias
from multiarm.dynamics.evaluation import place_start
from multiarm.dynamics.failures import joint_of, require_ok
from multiarm.dynamics.impacts import Impact, inelastic_impact
from multiarm.dynamics.state import State
from multiarm.errors import SolverError
from multiarm.events.mode_guards import MomentNumber
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics

# Part of the terms of a rate that is rounding.
ROUNDING = 1e-14
# Largest gap across which a joint takes hold [m].
LARGEST_GAP = 1e-4


class TakingHold:
    """The impact at which timed joints take hold, at the state in the data.

    Parameters
    ----------
    modes : Modes
        With the timed joints that hold from now on, and the kinematics of all rows.

    Attributes
    ----------
    energy_lost : float
        By it, before contacts answer [J].
    """

    def __init__(self, modes: Modes) -> None:
        full = modes.full
        self._modes, self._rows = modes, list(modes.bilateral_rows)
        self._directions = force_directions(full)
        self._velocity = full.arrays.state.velocity.copy()
        self._factor = np.linalg.cholesky(_lower_inertia(full))
        self._alone = self._stopped(self._velocity)
        self.energy_lost = self._alone.energy_lost
        full.arrays.state.velocity[:] += self._alone.change
        RowDynamics(modes).update()

    def impulses(self, of_contacts: Mapping[int, float]) -> dict[str, np.ndarray]:
        """Impulses (6,) of all timed joints that hold, on their second bodies [N s, N m s].

        ``of_contacts`` are those of contacts and stops that have answered, by row.  They are of
        least norm, and as :attr:`multiarm.Trajectory.wrenches` has forces.
        """
        full = self._modes.full
        total = np.zeros(full.model.layout.contacts)
        impact = self._alone
        if of_contacts:
            total[list(of_contacts)] = list(of_contacts.values())
            pushed = np.linalg.solve(self._factor, self._directions @ total)
            pushed = np.linalg.solve(self._factor.T, pushed)
            impact = self._stopped(self._velocity + pushed)
        total[self._rows] += impact.impulses
        wrenches, owners = wrenches_of(full, total), full.model.layout.owners
        timed = self._modes.unilateral.timed
        names = [timed[k].connection for k in sorted(self._modes.holding)]
        return {name: wrenches[owners.index(name)] for name in names}

    def _stopped(self, velocity: np.ndarray) -> Impact:
        """The impact that stops the rates of all rows that are held, and then roundings of it."""
        rows = self._directions[:, self._rows].T
        impact = inelastic_impact(rows, self._factor, velocity)
        left = np.abs(rows @ (velocity + impact.change))
        if np.all(left <= ROUNDING * (np.abs(rows) @ np.abs(velocity))):
            return impact
        again = inelastic_impact(rows, self._factor, velocity + impact.change)
        return Impact(
            impact.change + again.change,
            impact.impulses + again.impulses,
            impact.energy_lost + again.energy_lost,
        )


def _lower_inertia(data: Data) -> np.ndarray:
    """The lower triangle of the inertia of objects and joints, (6 F + n, 6 F + n)."""
    layout, M = data.model.layout, data.work.M
    inertia = np.zeros((layout.nv, layout.nv))
    inertia[layout.of_frames, layout.of_frames] = data.arrays.bodies.object_inertia
    write_inertias(data.struct)
    for i in layout.blocks_of_robots:
        joints = layout.of_block(i)
        count = joints.stop - joints.start
        inertia[joints, joints] = M[i, :count, :count]
    return inertia


class Switch(NamedTuple):
    """What timed joints do at an instant."""

    impact: TakingHold | None  # of those that take hold
    taking: Set[int]
    letting: Set[int]


def switch_joints(
    modes: Modes, holding: frozenset[int], awaited: frozenset[MomentNumber]
) -> Switch:
    """Let timed joints take hold and let go, at the kinematics of all rows in the data.

    Parameters
    ----------
    modes : Modes
    holding, awaited : frozenset
        From now on, see :class:`~multiarm.events.modes.Modes`.

    Raises
    ------
    SolverError
        When bodies are too far apart, or move too fast, for one that takes hold.
    """
    for k in sorted(holding - modes.holding):
        require_reach(modes, k)
    return switch_without_limits(modes, holding, awaited)


def switch_without_limits(
    modes: Modes, holding: frozenset[int], awaited: frozenset[MomentNumber] = frozenset()
) -> Switch:
    """:func:`switch_joints`, however far apart the bodies are and however fast they move."""
    full, taking, letting = modes.full, holding - modes.holding, modes.holding - holding
    for k in sorted(taking):
        if modes.unilateral.timed[k].located:
            modes.place(k)
        # its coordinates are counted from the turn in which it takes hold
        owner = full.model.layout.owners.index(modes.unilateral.timed[k].connection)
        full.arrays.last_step.coordinates[owner] = np.nan
    modes.hold(holding, awaited)
    if not taking:
        return Switch(None, taking, letting)
    require_ok(full, update_rows(full.struct))  # where joints have been placed
    return Switch(TakingHold(modes), taking, letting)


def require_reach(modes: Modes, timed: int) -> None:
    """Refuse to let a joint take hold of bodies that are too far apart, or move too fast.

    At the kinematics of all rows.

    Raises
    ------
    SolverError
        How far, or how fast, with remedies.
    """
    joint, full = modes.unilateral.timed[timed], modes.full
    speed = _relative_speed(modes, timed)
    if speed > joint.speed_limit:
        raise SolverError(
            f"{_too_fast(modes, timed, speed)}; bring them to rest before, or raise it"
        )
    if joint.located:
        return
    rows, closes = _contacts_of(modes, timed)
    gaps = full.contact_rows.gap[rows]
    gap = float(np.max(np.where(closes, np.abs(gaps), -gaps), initial=0.0))
    if gap > LARGEST_GAP:
        who = joint_of(full.model, joint.connection)
        raise SolverError(
            f"{who} would take hold across {gap:.3g} m, more than {LARGEST_GAP:g} m; bring its "
            "bodies together before, or leave 'at' out, so that it holds them where they are"
        )


def require_slow_start(modes: Modes, t: float) -> None:
    """Refuse a start within times of joints whose bodies move too fast for them to have taken hold.

    At the kinematics of all rows.  It counts what a joint stops of their motion, and leaves out
    joints that hold at 0 s, too, which the scene's start is assembled with.

    Raises
    ------
    SolverError
        How fast, with remedies.
    """
    rates = modes.full.contact_rows.gap_rate
    for k in sorted(modes.holding):
        joint = modes.unilateral.timed[k]
        interval = joint.interval_at(t)
        if interval is None or interval.has(0.0):
            continue
        rows, closes = _contacts_of(modes, k)
        stopped = float(np.max(np.where(closes, np.abs(rates[rows]), -rates[rows]), initial=0.0))
        speed = _relative_speed(modes, k)
        if min(speed, stopped) > joint.speed_limit:
            raise SolverError(
                f"{_too_fast(modes, k, speed)}, at the start at {t:g} s; give a state in which "
                "they move together, begin before it takes hold, or raise the limit"
            )


def _contacts_of(modes: Modes, timed: int) -> tuple[list[int], np.ndarray]:
    """Rows of a joint's contacts, and which close both ways: what only pushes may be open."""
    joint = modes.unilateral.timed[timed]
    constraints = [modes.unilateral.constraints[u] for u in joint.constraints]
    rows = [*joint.rows, *(constraint.row for constraint in constraints)]
    both_ways = [True] * len(joint.rows) + [constraint.bilateral for constraint in constraints]
    return rows, np.array(both_ways)


def _relative_speed(modes: Modes, timed: int) -> float:
    """How fast a joint's frames on its two bodies move against each other [m/s]."""
    first, second = modes.frames[timed]
    return math.dist(first.velocity, second.velocity)


def _too_fast(modes: Modes, timed: int, speed: float) -> str:
    joint = modes.unilateral.timed[timed]
    return (
        f"{joint_of(modes.full.model, joint.connection)} would take hold of bodies that move at "
        f"{speed:.3g} m/s against each other, more than its 'speed_limit' of "
        f"{joint.speed_limit:g} m/s"
    )


class HeldJoints(NamedTuple):
    """Which timed joints hold, and where those are that have taken hold within a run."""

    joints: frozenset[int]
    places: Mapping[int, np.ndarray]  # poses (4, 4) on their second bodies


def hold_placed(modes: Modes, held: HeldJoints) -> None:
    """Let timed joints hold from now on, without an impact; those without a place as written."""
    poses = {
        k: held.places.get(k) for k, joint in enumerate(modes.unilateral.timed) if joint.located
    }
    elsewhere = {k: pose for k, pose in poses.items() if not modes.is_placed(k, pose)}
    if elsewhere:
        modes.hold(frozenset())  # rows are selected anew where they have been placed
    for k, pose in elsewhere.items():
        modes.place(k, as_written=pose is None, pose=pose)
    modes.hold(held.joints)


def hold_at(
    modes: Modes,
    t: float,
    state: State,
    holding: frozenset[int],
    awaited: frozenset[MomentNumber] = frozenset(),
) -> None:
    """Let timed joints hold from a state on, without an impact.

    Those without a place of their own that have taken hold after the scene's start hold their
    bodies where they are; all others are where the scene's start has them.
    """
    located = {k: joint for k, joint in enumerate(modes.unilateral.timed) if joint.located}
    if located:
        modes.hold(frozenset())  # rows are selected anew where they have been placed
        place_start(modes.bilateral, t, state)
        require_ok(modes.bilateral, update_kinematics(modes.bilateral.struct))
    for k, joint in located.items():
        interval = joint.interval_at(t)
        begins = math.inf if interval is None else interval.begin
        since_start = isinstance(begins, float) and begins <= 0.0
        modes.place(k, as_written=since_start or k not in holding)
    modes.hold(holding, awaited)
