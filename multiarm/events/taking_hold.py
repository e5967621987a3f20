"""Taking hold: the impact without restitution at which a joint begins to hold.

Momentum passes through everything that holds at that instant (:mod:`multiarm.dynamics.impacts`);
contacts that only push take part afterwards (:mod:`multiarm.events.transition`), which is the same
impact: their impulses act on bodies that hold each other already.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.contact_forces import wrenches_of
from multiarm.dynamics.contact_geometry import block_inertias, force_directions
from multiarm.dynamics.equations import update_kinematics, update_rows
from multiarm.dynamics.evaluation import place_start
from multiarm.dynamics.failures import joint_of, require_ok
from multiarm.dynamics.impacts import inelastic_impact
from multiarm.dynamics.state import State
from multiarm.errors import SolverError
from multiarm.events.joint_places import frame_motions
from multiarm.events.mode_guards import MomentNumber
from multiarm.events.modes import Modes

# Largest gap across which a joint takes hold [m].
LARGEST_GAP = 1e-4
# Impacts in a row, of which the last ones stop roundings: below this part of the energy lost.
MOST_IMPACTS, ROUNDED = 3, 1e-30


class Grip(NamedTuple):
    """An impact at which joints take hold."""

    impulses: dict[int, np.ndarray]  # (6,) on the second body, by timed joint [N s, N m s]
    energy_lost: float  # [J]


def take_hold(modes: Modes, joints: Iterable[int]) -> Grip:
    """Stop the rates of all rows that are held from now on, in the state of the data.

    Parameters
    ----------
    modes : Modes
        With the timed joints that hold from now on, and the kinematics of all rows.
    joints : iterable of int
        The timed joints that have begun to.

    Returns
    -------
    Grip
        Wrenches of the impulses, those of least norm, as :attr:`multiarm.Trajectory.wrenches`
        has them of forces.
    """
    full, rows = modes.full, list(modes.bilateral_rows)
    velocity = full.arrays.state.velocity
    jacobian = force_directions(full)[:, rows].T
    inertias = [full.arrays.bodies.object_inertia, *block_inertias(full)]
    factor, first = np.zeros((velocity.size, velocity.size)), 0
    for inertia in inertias:
        end = first + len(inertia)
        factor[first:end, first:end], first = np.linalg.cholesky(inertia), end
    impulses, lost = np.zeros(full.model.layout.contacts), 0.0
    for _ in range(MOST_IMPACTS):
        impact = inelastic_impact(jacobian, factor, velocity)
        velocity += impact.change
        impulses[rows] += impact.impulses
        lost += impact.energy_lost
        if impact.energy_lost <= ROUNDED * lost:
            break
    require_ok(modes.bilateral, update_kinematics(modes.bilateral.struct))
    require_ok(full, update_rows(full.struct))
    owners, wrenches = full.model.layout.owners, wrenches_of(full, impulses)
    places = {k: owners.index(modes.unilateral.timed[k].connection) for k in joints}
    return Grip({k: wrenches[c] for k, c in places.items()}, lost)


def require_reach(modes: Modes, timed: int) -> None:
    """Refuse to let a joint take hold of bodies that are too far apart, or move too fast.

    At the kinematics of all rows.

    Raises
    ------
    SolverError
        How far, or how fast, with remedies.
    """
    joint, full = modes.unilateral.timed[timed], modes.full
    who = joint_of(full.model, joint.connection)
    on_first, on_second = frame_motions(full, full.model, joint.connection)
    speed = float(np.linalg.norm(on_first.velocity - on_second.velocity))
    if speed > joint.speed_limit:
        raise SolverError(
            f"{who} would take hold of bodies that move at {speed:.3g} m/s against each other, "
            f"more than its 'speed_limit' of {joint.speed_limit:g} m/s; bring them to rest before, "
            "or raise it"
        )
    if joint.located:
        return
    rows = [*joint.rows, *(modes.unilateral.constraints[u].row for u in joint.constraints)]
    gaps = full.contact_rows.gap[rows]
    # what only pushes may be open
    open_too = [modes.unilateral.constraints[u].bilateral for u in joint.constraints]
    closes = np.array([True] * len(joint.rows) + open_too)
    gap = float(np.max(np.where(closes, np.abs(gaps), -gaps), initial=0.0))
    if gap > LARGEST_GAP:
        raise SolverError(
            f"{who} would take hold across {gap:.3g} m, more than {LARGEST_GAP:g} m; bring its "
            "bodies together before, or leave 'at' out, so that it holds them where they are"
        )


def hold_at(
    modes: Modes,
    t: float,
    state: State,
    holding: frozenset[int],
    awaited: frozenset[MomentNumber] = frozenset(),
) -> None:
    """Let timed joints hold from a state on, without an impact.

    Those without a place of their own that have taken hold after the scene's start hold their
    bodies where they are.
    """
    timed = modes.unilateral.timed
    located = [k for k in holding if timed[k].located]
    if located:
        place_start(modes.bilateral, t, state)
        require_ok(modes.bilateral, update_kinematics(modes.bilateral.struct))
    for k in located:
        interval = timed[k].interval_at(t)
        begins = math.inf if interval is None else interval.begin
        modes.place(k, as_written=isinstance(begins, float) and begins <= 0.0)
    modes.hold(holding, awaited)
