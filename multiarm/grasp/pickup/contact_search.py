r"""The search for seven contacts that hold a tilted body, six of which or fewer can tilt it.

Two grippers sit at corners of the body.  Choices of faces and places of contacts are those of
:mod:`multiarm.grasp.optimisation.placements`; some of the contacts are on the face that the body
lies on, where tilting frees it, all others where fingertips reach from the start.

**How good.**  Every contact that presses shall press with some part ``f`` of the weight at least.
The cost of a placement is the largest contact force, over the weight, that this takes in any phase.
Held by seven contacts in form closure, ``W n = 0`` with ``n > 0`` of sum 1, the forces that carry
a load w are

.. math:: \lambda = G \begin{bmatrix} w \\ \sigma \end{bmatrix}, \qquad
          G = \begin{bmatrix} W \\ 1 \cdots 1 \end{bmatrix}^{-1}, \qquad
          \sigma = \max_j \frac{f - (G_w w)_j}{n_j} ,

for many placements at once: a small margin costs a large force.  The best of these are judged in
the phases of tilting as well, and improved by moving contacts at random.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiarm.grasp.closure.balances import balance_inverses
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.optimisation.placements import FaceChoices, TouchRegion, seven_touches

# Choices of faces that are looked at, at most (some at random where there are more), and placements
# drawn for each, from so many places in every region.
MOST_CHOICES, DRAWN, PLACES = 1000, 128, 256
# The cheapest placements that are judged in all phases, of one choice at most; the best that are
# improved, and moves that are tried on each.
JUDGED, OF_ONE_CHOICE, IMPROVED, MOVES = 100, 4, 3, 100
# Moves make a placement cheaper by this factor at most, as a rule.
PROMISING = 2.0
# Parts of the size of the body by which contacts are moved at first, and at last.
FIRST_MOVE, LAST_MOVE = 0.1, 0.005
# Placements that are drawn together: memory stays small.
CHUNK = 20_000

Judge = Callable[[Contacts, tuple[int, ...], float], float]


@dataclass(frozen=True, eq=False)
class Placement:
    """Seven contacts on faces.

    Attributes
    ----------
    regions : tuple of TouchRegion
        In which they lie.
    points : ndarray, shape (7, 3)
        In the body's frame [m].
    cost : float
    """

    regions: tuple[TouchRegion, ...]
    points: np.ndarray
    cost: float

    @property
    def faces(self) -> tuple[int, ...]:
        """The faces of the contacts."""
        return tuple(region.face for region in self.regions)

    @property
    def contacts(self) -> Contacts:
        """The contacts."""
        return Contacts.along(self.points, [region.normal for region in self.regions])


def held_costs(
    points: np.ndarray, normals: np.ndarray, loads: Sequence[np.ndarray], least: float
) -> np.ndarray:
    """Largest force of each placement that carries loads, shape (K,); infinite where none do.

    Parameters
    ----------
    points, normals : ndarray, shape (K, 7, 3)
        Moments are about their origin.
    loads : sequence of ndarray, shape (6,)
        Wrenches of the contacts on the body, over its weight.
    least : float
        Of every force, over the weight.
    """
    W = np.concatenate([normals, np.cross(points, normals)], axis=-1)  # (K, 7, 6)
    G = balance_inverses(W)
    n = G[..., 6]
    closed = n.min(axis=1) > 0.0
    costs = np.where(closed, 0.0, np.inf)
    for load in loads:
        shares = G[..., :6] @ load
        total = np.max((least - shares) / np.where(n > 0.0, n, np.inf), axis=1)
        costs = np.maximum(costs, (shares + n * total[:, None]).max(axis=1))
    return np.where(closed, costs, np.inf)


class ContactSearch:
    """The search over choices of faces.

    Parameters
    ----------
    choices : FaceChoices
    middle : ndarray, shape (3,)
        The centre of mass.
    size : float
        Of the body [m].
    loads : sequence of ndarray, shape (6,)
        That the seven contacts carry, about the centre of mass, over the weight and ``size``.
    least : float
        Of every force, over the weight.
    spacing : float
        Between two contacts, at least [m].
    judge : callable
        Of contacts, their faces and a limit: the cost of all phases, or anything above the limit.
    most : float
        What a placement may cost.
    impossible : float
        Placements that cost more cannot be; the cost says by how much.
    rng : numpy.random.Generator
    """

    def __init__(
        self,
        choices: FaceChoices,
        middle: np.ndarray,
        size: float,
        loads: Sequence[np.ndarray],
        least: float,
        spacing: float,
        judge: Judge,
        most: float,
        impossible: float,
        rng: np.random.Generator,
    ) -> None:
        self.choices, self.middle, self.size = choices, middle, size
        self.loads, self.least, self.spacing = loads, least, spacing
        self.judge, self.most, self.impossible, self.rng = judge, most, impossible, rng
        # what can be improved enough; from what cannot be, anything may follow
        self.within = np.inf if most >= impossible else PROMISING * most

    def best(self) -> Placement | None:
        """The cheapest placement that was found."""
        judged: list[Placement] = []
        for drawn in self._cheapest():
            most = judged[IMPROVED - 1].cost if len(judged) >= IMPROVED else np.inf
            placement = self._judged(drawn, most) if drawn.cost < most else None
            if placement is not None:
                judged.append(placement)
                judged.sort(key=lambda placement: placement.cost)
        promising = [placement for placement in judged[:IMPROVED] if placement.cost < self.within]
        improved = [self._improved(placement) for placement in promising]
        best = min(improved, key=lambda placement: placement.cost, default=None)
        return best if best is not None and best.cost < self.most else None

    def _cheapest(self) -> list[Placement]:
        """Drawn placements that carry the loads with the least forces, at these costs."""
        regions = self.choices.regions
        places = np.array([self._drawn(region) for region in regions])  # (R, PLACES, 3)
        normals = np.array([region.normal for region in regions])
        rows = self.choices.numbers
        if len(rows) > MOST_CHOICES:
            rows = rows[np.sort(self.rng.choice(len(rows), MOST_CHOICES, replace=False))]
        cheapest: list[Placement] = []
        for part in np.array_split(rows, 1 + DRAWN * len(rows) // CHUNK):
            chosen = np.repeat(part, DRAWN, axis=0)  # (K, 7)
            points = places[chosen, self.rng.integers(PLACES, size=chosen.shape)]
            costs = self._held(points, normals[chosen]).reshape(len(part), DRAWN)
            for k, row in enumerate(part):
                for j in np.argsort(costs[k], kind="stable")[:OF_ONE_CHOICE]:
                    if costs[k, j] < self.most:
                        own = tuple(regions[r] for r in row)
                        cheapest.append(Placement(own, points[k * DRAWN + j], float(costs[k, j])))
        cheapest.sort(key=lambda placement: placement.cost)
        return cheapest[:JUDGED]

    def _drawn(self, region: TouchRegion) -> np.ndarray:
        """Places (PLACES, 3) in a region, more of them near its corners."""
        corners = region.inner
        return self.rng.dirichlet(np.full(len(corners), 0.5), PLACES) @ corners

    def _held(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Costs (K,) of the closed grasps with points (K, 7, 3); infinite: too close, or open."""
        scaled = (points - self.middle) / self.size
        costs = held_costs(scaled, normals, self.loads, self.least)
        apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
        apart[:, np.arange(7), np.arange(7)] = np.inf
        return np.where(apart.min(axis=(1, 2)) < self.spacing, np.inf, costs)

    def _judged(self, placement: Placement, most: float) -> Placement | None:
        """The placement with the cost of all phases, None where it is too much."""
        cost = self.judge(placement.contacts, placement.faces, most)
        return replace(placement, cost=cost) if cost < most else None

    def _improved(self, placement: Placement) -> Placement:
        """The placement after moves that make it cheaper."""
        touches = seven_touches(placement.regions, self.middle, self.size)
        from_middles = (placement.points - self.middle) / self.size - touches.middles
        y = np.einsum("ix,iax->ia", from_middles, touches.tangents)
        for step in np.geomspace(FIRST_MOVE, LAST_MOVE, MOVES):
            moved = touches.towards(y, y + step * self.rng.standard_normal(y.shape))
            points = touches.points(moved) * self.size + self.middle
            held = self._held(points[None], touches.normals[None])[0]
            if not held < min(placement.cost, self.impossible):
                continue
            better = self._judged(replace(placement, points=points), placement.cost)
            if better is not None:
                placement, y = better, moved
        return placement
