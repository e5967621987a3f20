r"""Objects at rest: those whose velocity is zero, and stays zero as long as a mode lasts.

*Held.*  The closed rows between objects, and between them and the world,
:math:`W_o^T v_o = 0`, leave an object no velocity: those of contacts that stick, on the world or on
objects that rest themselves.  Such an object rests whatever forces act on it.

*In balance.*  Velocity and acceleration of an object are zero, no robot touches it, nor an object
that moves, and no load depends on the time: nothing changes then, as with a ball on a level floor,
or with a box on one without friction.

An object that touches nothing rests on nothing, and is none of these.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Set

import numpy as np

from multiarm.dynamics.layout import TWIST
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE, NO_ACCELERATION, UNMOVED
from multiarm.dynamics.solver.dense import null_space
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics
from multiarm.scene.bodies import WORLD
from multiarm.scene.values import SURROUNDINGS, of_surroundings

# What rows act on besides objects, which have their numbers.
AT_REST, ROBOT = -1, -2
# The effect that acts on objects and depends on nothing but the state.
DRAG = "drag"
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
        effects = modes.full.model.effects.called
        self._steady = all(effect.local or effect.name == DRAG for effect in effects)

    def supports(self) -> dict[str, tuple[str, ...]]:
        """What each object at rest rests on: objects, ``floor``, ``world`` by another joint."""
        data = self._modes.data
        touching = np.any(self._bodies[data.rows] >= 0, axis=1)
        rows, bodies = data.rows[touching], self._bodies[data.rows[touching]]
        if not np.any(bodies == AT_REST):
            return {}
        rests = self._held(data.arrays.rows.W_o[touching], bodies)
        if self._steady:
            rests |= self._in_balance(bodies, rests)
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

    def _in_balance(self, bodies: np.ndarray, held: Set[int]) -> set[int]:
        """Further objects that neither move nor are accelerated, nor touch what may move."""
        arrays, layout = self._modes.data.arrays, self._modes.full.model.layout
        speeds = np.abs(layout.twists(arrays.state.velocity)).max(axis=1)
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
    ) -> dict[int, dict[str, None]]:
        """Of each object at rest, the names of what touches it and rests, too, in order of rows."""
        names: dict[int, dict[str, None]] = {o: {} for o in sorted(rests)}
        for row, pair in zip(rows.tolist(), bodies.tolist(), strict=True):
            for o, other in (pair, reversed(pair)):
                if o in rests and other in rests:
                    names[o][self._objects[other]] = None
                elif o in rests and other == AT_REST:
                    names[o][SURROUNDINGS if row in self._floor else str(WORLD)] = None
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
    objects: tuple[str, ...], neighbours: Mapping[int, Collection[str]]
) -> dict[str, tuple[str, ...]]:
    """Of each object that rests on something, its neighbours that are nearer to the floor."""
    below: dict[str, tuple[str, ...]] = {}
    nearer = {*STANDS_STILL}
    while supported := {
        objects[o]: tuple(name for name in names if name in nearer)
        for o, names in neighbours.items()
        if objects[o] not in below and not nearer.isdisjoint(names)
    }:
        below |= supported
        nearer |= supported.keys()
    return below
