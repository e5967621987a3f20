r"""Objects at rest: those whose velocity is zero, and stays zero as long as a mode lasts.

*Held.*  The closed rows between objects, and between them and the world,
:math:`W_o^T v_o = 0`, leave an object no velocity: those of contacts that stick, on the world or on
objects that rest themselves.  Such an object rests whatever forces act on it.

*In balance.*  Velocity and acceleration of an object are zero, no robot touches it, nor an object
that moves, and no load depends on the time: nothing changes then, as with a ball on a level floor,
or with a box on one without friction.

Only objects that lie on something, with contacts that can open or slide, are told to rest: of the
others the joints that hold them say enough.
"""

from __future__ import annotations

from collections.abc import Mapping, Set

import numpy as np

from multiarm.dynamics.layout import TWIST
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE, NO_ACCELERATION, UNMOVED
from multiarm.dynamics.solver.dense import null_space
from multiarm.events.mode_guards import rest_speed
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics
from multiarm.scene.bodies import WORLD
from multiarm.scene.values import SURROUNDINGS, of_surroundings

# What rows act on besides objects, which have their numbers.
AT_REST, ROBOT = -1, -2
# The effect that is local, but depends on the time.
WRENCHES = "external_wrenches"
# The names of what stands still.
STANDS_STILL = (SURROUNDINGS, str(WORLD))


class RestDetector:
    """Finds the objects that rest, at the evaluated state of a mode.

    Parameters
    ----------
    modes : Modes
    """

    def __init__(self, modes: Modes) -> None:
        self._modes, self._dynamics = modes, RowDynamics(modes)
        self._objects = modes.full.model.layout.objects
        self._bodies, self._floor = _bodies_of_rows(modes.full.model)
        self._slow = rest_speed(modes.slow)
        self._enforced = modes.unilateral.enforced
        effects = modes.full.model.effects.called
        self._steady = all(effect.local and effect.name != WRENCHES for effect in effects)

    def supports(self) -> dict[str, tuple[str, ...]]:
        """What each object at rest lies on: other objects, ``floor``, or ``world``."""
        data = self._modes.data
        if self._enforced.isdisjoint(self._modes.mode.rows):  # it lies on nothing that could open
            return {}
        velocity = data.arrays.state.velocity
        speeds = np.abs(self._modes.full.model.layout.twists(velocity)).max(axis=1)  # [m/s, rad/s]
        slow = speeds <= self._slow
        if not np.any(slow):
            return {}
        touching = np.any(self._bodies[data.rows] >= 0, axis=1)
        rows, bodies = data.rows[touching], self._bodies[data.rows[touching]]
        if not np.any(bodies == AT_REST):
            return {}
        rests = self._held(data.arrays.rows.W_o[touching], bodies)
        rests &= {*np.flatnonzero(slow).tolist()}
        if self._steady:
            rests |= self._in_balance(speeds, bodies, rests)
        return _below(self._objects, self._neighbours(rests, rows, bodies))

    def _held(self, W_o: np.ndarray, bodies: np.ndarray) -> set[int]:
        """Objects that the rows without a robot leave no velocity."""
        mobility = 1.0 / np.sqrt(np.diag(self._modes.data.arrays.bodies.object_inertia))
        directions = W_o[np.all(bodies > ROBOT, axis=1)] * mobility
        if len(directions) < TWIST:
            return set()
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        free = null_space(directions, COUPLED_RANK_TOLERANCE).basis
        moves = np.max(np.abs(free), axis=1, initial=0.0).reshape(-1, TWIST)
        return set(np.flatnonzero(np.all(moves < UNMOVED, axis=1)).tolist())

    def _in_balance(self, speeds: np.ndarray, bodies: np.ndarray, held: Set[int]) -> set[int]:
        """Further objects that neither move nor are accelerated, nor touch what may move."""
        arrays, layout = self._modes.data.arrays, self._modes.full.model.layout
        accelerations = np.abs(layout.twists(arrays.accelerations.a)).max(axis=1)
        still = (speeds <= self._dynamics.rest_rate) & (accelerations <= NO_ACCELERATION)
        rests = {o for o in np.flatnonzero(still).tolist() if o not in held and o in bodies}
        while moved := {
            o
            for o in rests
            for pair in bodies[np.any(bodies == o, axis=1)].tolist()
            if not {*pair} <= {AT_REST, *held, *rests}
        }:
            rests -= moved
        return rests

    def _neighbours(
        self, rests: Set[int], rows: np.ndarray, bodies: np.ndarray
    ) -> dict[int, dict[str, bool]]:
        """Of each object at rest, what touches it and rests, too; and whether it could open."""
        names: dict[int, dict[str, bool]] = {o: {} for o in sorted(rests)}
        for row, pair in zip(rows.tolist(), bodies.tolist(), strict=True):
            for o, other in (pair, reversed(pair)):
                if o not in rests or not (other in rests or other == AT_REST):
                    continue
                name = self._objects[other] if other >= 0 else str(WORLD)
                name = SURROUNDINGS if row in self._floor else name
                names[o][name] = names[o].get(name, False) or row in self._enforced
        return names


def _bodies_of_rows(model: Model) -> tuple[np.ndarray, frozenset[int]]:
    """The two bodies of each row, shape (N, 2), and the rows of contacts with the floor."""
    pairs, first, layout = model.constants.connections, len(model.backends.links), model.layout
    bodies, floor = np.full((layout.contacts, 2), AT_REST), set[int]()
    for c, owner in enumerate(layout.owners):
        rows = layout.contacts_of(c)
        for side, body in enumerate((int(pairs.first[c]), int(pairs.second[c]))):
            is_link, is_world = body < first, body == model.world_number
            number = ROBOT if is_link else AT_REST if is_world else body - first
            bodies[rows, side] = number
        if of_surroundings(owner):
            floor.update(range(rows.start, rows.stop))
    return bodies, frozenset(floor)


def _below(
    objects: tuple[str, ...], neighbours: Mapping[int, Mapping[str, bool]]
) -> dict[str, tuple[str, ...]]:
    """Of each object that lies on something, its neighbours that are nearer to the world."""
    nearer, below = {*STANDS_STILL}, {}
    while supported := {
        o
        for o, names in neighbours.items()
        if objects[o] not in nearer and not nearer.isdisjoint(names)
    }:
        for o in supported:
            opens = (name for name, can_open in neighbours[o].items() if can_open)
            below[objects[o]] = tuple(name for name in opens if name in nearer)
        nearer |= {objects[o] for o in supported}
    return {name: on for name, on in below.items() if on}
