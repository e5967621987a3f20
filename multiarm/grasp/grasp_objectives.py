r"""Objectives of grasps with seven contacts, and their upper bounds.

Seven wrenches have one balance :math:`W n = 0, \sum n_i = 1`; closure is n > 0. With G the inverse
of :math:`[W; 1 \dots 1]`, whose last column is n and whose other columns are :math:`g_i`:

*margin*: the smallest :math:`n_i`, that is t* of form closure; at most 1/7.

*force*: a load F is balanced by :math:`\lambda = -G F + \tau n`, least when :math:`\tau` is the
least that makes it nonnegative. The score is the inverse of the largest force over all loads.

*stability*: the closure radius (:mod:`multiarm.grasp.closure_radii`).

**The bound of one choice of faces.** A contact in a region with corners :math:`c_v` and the force
:math:`\lambda_i` is a combination of forces at the corners,
:math:`\lambda_i = \sum_v \mu_{iv}` and :math:`\lambda_i w_i(p_i) = \sum_v \mu_{iv} w_i(c_v)`,
since the wrench is affine on a face. The best margin over all placements is a linear program in
:math:`\mu`, without any loss; so is the least worst force under one load, and the worst of the
loads bounds what one placement can do for all of them.

**Quick bounds from twists.** Any twist :math:`\xi = (v, \omega)` of the body bounds the score. By
virtual work :math:`F \cdot \xi = \sum_i \lambda_i (-w_i \cdot \xi)`, so

.. math:: \frac{1}{\lambda_{\max}} \le \sum_i [-w_i \cdot \xi]_+ \,/\, \max_k F_k \cdot \xi .

Contacts that slide by r change :math:`w_i \cdot \xi` by at most :math:`r |e_i \times \omega|`, and
the grasp is lost when all of them are brought to zero or below, so

.. math:: r \le \max_i \; w_i \cdot \xi \,/\, |e_i \times \omega| .

Each contact is at its best corner. The duals of the linear programs are the sharpest twists for
margin and force; stability, which is no linear program, is bounded by twists alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiarm.grasp.balances import balance_inverses
from multiarm.grasp.closure_radii import closure_radius
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.placements import SevenTouches
from multiarm.grasp.programs import LinearSolution, linear_program

# Steps of Newton's method towards the displacements that lose the grasp.
STEPS = 3
# A contact whose place a twist does not feel: it is never lost to it.
UNFELT = 1e-9
# A twist along which no load does this much work says nothing about forces.
LOADED = 1e-9
# Stands for no bound.
VOID = 1e6


@dataclass(frozen=True, eq=False)
class Bound:
    """A bound on the scores of one choice of faces.

    Attributes
    ----------
    top : float
        No placement has a higher score.
    placements : ndarray, shape (K, 7, 2)
        In the outer regions; they may be good.
    twists : ndarray, shape (C, 6)
        That bound other choices, too; the sharpest first.
    """

    top: float
    placements: np.ndarray
    twists: np.ndarray


class Objective(ABC):
    """A score of placements, higher is better, 0 for what is no grasp.

    Attributes
    ----------
    limit : float
        No score is higher, whatever the body.
    generations : int
        For how long placements are evolved; scores that cost more get fewer.
    """

    limit = VOID
    generations = 250

    @abstractmethod
    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Scores of M placements (M, 7, 2); estimates, never below the true ones."""

    def certain(self, touches: SevenTouches, y: np.ndarray) -> float:
        """The score of one placement (7, 2), certain."""
        return float(self.scores(touches, y[None])[0])

    @abstractmethod
    def bound(self, touches: SevenTouches, y: np.ndarray) -> Bound:
        """The bound over all placements; some (M, 7, 2) may help to find it."""

    @abstractmethod
    def quick_bounds(
        self, low: np.ndarray, high: np.ndarray, felt: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Bounds (B,) of B choices of faces from twists (C, 6), without a program.

        ``low`` and ``high`` (B, 7, C) are the extremes of w . xi over each region, ``felt`` of the
        same shape is |e x omega|.
        """


class Margin(Objective):
    """The smallest coefficient of the balance with sum 1."""

    limit = 1.0 / 7.0

    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """``t*`` of each placement."""
        return balance_inverses(touches.wrenches(y))[..., 6].min(axis=1).clip(0.0)

    def bound(self, touches: SevenTouches, y: np.ndarray) -> Bound:
        """Without loss over the outer regions."""
        corners = _Corners(touches)
        count = len(corners.places)
        solved = linear_program(
            np.r_[np.zeros(count), -1.0],
            at_most=(np.hstack([-corners.sums, np.ones((7, 1))]), np.zeros(7)),
            equal=(
                np.vstack([np.c_[corners.wrenches.T, np.zeros(6)], np.r_[np.ones(count), 0.0]]),
                np.r_[np.zeros(6), 1.0],
            ),
            signed=1,
        )
        if solved.x is None or not -solved.value > 0.0:
            none = solved.infeasible or solved.x is not None  # else nothing is concluded
            return Bound(0.0 if none else self.limit, np.zeros((0, 7, 2)), np.zeros((0, 6)))
        twist = solved.duals[:6]
        placement = corners.placement(solved.x[:count])
        return Bound(-solved.value, placement[None], np.array([twist, -twist]))

    def quick_bounds(
        self, low: np.ndarray, high: np.ndarray, felt: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """From ``sum n_i a_i = 0``, a = w . xi: ``t sum a_i + (1 - 7 t) max a_i >= 0``."""
        most, total = high.max(axis=1), high.sum(axis=1)
        room = 7.0 * most - total  # 0 only when all are equal: then any t will do, if positive
        tops = np.where(room > 0.0, most / np.where(room > 0.0, room, 1.0), VOID)
        tops = np.where(most > 0.0, tops, 0.0)
        return tops.min(axis=1, initial=self.limit)


class Force(Objective):
    """Inverse of the worst contact force over loads (K, 6): [force; moment over size]."""

    def __init__(self, loads: np.ndarray) -> None:
        self.loads = loads

    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Inverse worst force of each placement."""
        G = balance_inverses(touches.wrenches(y))
        closed = G[..., 6].min(axis=1) > 0.0
        worst = self._forces(np.where(closed[:, None, None], G, 1.0)).max(axis=(1, 2))
        return np.where(closed, 1.0 / np.where(closed, worst, 1.0), 0.0)

    def _forces(self, G: np.ndarray) -> np.ndarray:
        """Least forces under each load, shape (M, K, 7)."""
        n = G[..., None, :, 6]
        plain = -np.einsum("mif,kf->mki", G[..., :6], self.loads)
        return plain + (-plain / n).max(axis=2, keepdims=True) * n

    def bound(self, touches: SevenTouches, y: np.ndarray) -> Bound:
        """The worst of the loads, each with the placement that suits it best."""
        corners = _Corners(touches)
        solved = [self._least(corners, load) for load in self.loads]
        if any(one.infeasible for one in solved):
            return Bound(0.0, np.zeros((0, 7, 2)), np.zeros((0, 6)))
        known = sorted((one for one in solved if one.x is not None), key=lambda one: -one.value)
        placements = [corners.placement(one.x[:-1]) for one in known if one.x is not None]
        return Bound(
            top=1.0 / known[0].value if known else self.limit,
            placements=np.array(placements).reshape(-1, 7, 2),
            twists=_unit(np.array([-one.duals for one in known]).reshape(-1, 6)),
        )

    def _least(self, corners: _Corners, load: np.ndarray) -> LinearSolution:
        """The least worst force under one load, contacts anywhere in their regions."""
        return linear_program(
            np.r_[np.zeros(len(corners.places)), 1.0],
            at_most=(np.hstack([corners.sums, -np.ones((7, 1))]), np.zeros(7)),
            equal=(np.c_[corners.wrenches.T, np.zeros(6)], -load),
        )

    def quick_bounds(
        self, low: np.ndarray, high: np.ndarray, felt: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Every contact where it does most work against the twist."""
        work = (twists @ self.loads.T).max(axis=1)
        useful = work > LOADED
        tops = (-low[:, :, useful]).clip(0.0).sum(axis=1) / work[useful]
        return tops.min(axis=1, initial=self.limit)


class Stability(Objective):
    """Closure radius over the size of the body."""

    generations = 120

    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Radii along the twists found; upper bounds of the true ones."""
        radii = np.zeros(len(y))
        closed = np.flatnonzero(balance_inverses(touches.wrenches(y))[..., 6].min(axis=1) > 0.0)
        xi = self._losing(touches, y[closed])  # (M, 7, 6)
        W = touches.wrenches(y[closed])
        reached = np.einsum("mif,mcf->mci", W, xi) / felt_by(touches.normals, xi)
        reached[~np.any(xi, axis=2)] = np.inf  # no twist was found: nothing is known
        least = reached.max(axis=2).min(axis=1, initial=VOID)
        radii[closed] = np.where(least < VOID, least, 0.0).clip(0.0)
        return radii

    def certain(self, touches: SevenTouches, y: np.ndarray) -> float:
        """The guaranteed closure radius."""
        return closure_radius(Contacts(touches.points(y), touches.normals)).lower

    def bound(self, touches: SevenTouches, y: np.ndarray) -> Bound:
        """From the twists to which placements are lost; those of the firmest first."""
        closed = y[np.argsort(-self.scores(touches, y), kind="stable")]
        twists = _unit(np.concatenate([self._twists(touches, z) for z in closed]))
        corners = _Corners(touches)
        work = corners.wrenches @ twists.T
        low, high = (
            np.array([how(work[corners.owner == i], axis=0) for i in range(7)])[None]
            for how in (np.min, np.max)
        )
        tops = self.quick_bounds(low, high, felt_by(touches.normals, twists).T[None], twists)
        return Bound(float(tops[0]), closed[:1], twists)

    def _twists(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """The twist to which the grasp is lost when contact i opens first, for each i."""
        G = balance_inverses(touches.wrenches(y)[None])[0]
        n, g = G[:, 6], G[:, :6]
        if n.min() > 0.0:
            return self._losing(touches, y[None])[0]
        pairs = [(i, j) for i in np.flatnonzero(n > 0.0) for j in np.flatnonzero(n < 0.0)]
        return np.array([g[j] / n[j] - g[i] / n[i] for i, j in pairs]).reshape(-1, 6)

    def _losing(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Twists (M, 7, 6), by Newton's method on the displacements that bring n_i to zero."""
        W = touches.wrenches(y)[:, None]  # (M, 1, 7, 6)
        moved = np.broadcast_to(W, (len(y), 7, 7, 6))
        size = np.zeros((len(y), 7))
        own = np.arange(7)
        g = np.zeros((len(y), 7, 6))
        for _ in range(STEPS):
            G = balance_inverses(moved.reshape(-1, 7, 6)).reshape(len(y), 7, 7, 7)
            n, g = G[..., 6], G[:, own, own, :6]
            felt = np.einsum("jaf,mif->mija", touches.rates, g)
            norm = np.linalg.norm(felt, axis=-1)
            slope = np.sum(np.abs(n) * norm, axis=2)
            size = size + n[:, own, own] / np.maximum(slope, 1e-12)
            along = felt / np.maximum(norm, 1e-300)[..., None] * np.sign(n)[..., None]
            moved = W + size[..., None, None] * np.einsum("mija,jaf->mijf", along, touches.rates)
        return -g

    def quick_bounds(
        self, low: np.ndarray, high: np.ndarray, felt: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Every contact at its best corner."""
        return (high / felt).max(axis=1).clip(0.0).min(axis=1, initial=self.limit)


class _Corners:
    """Forces at the corners of seven regions in place of one force in each.

    Attributes
    ----------
    owner : ndarray, shape (V,)
        The contact of each corner.
    places, wrenches : ndarray, shape (V, 2) and (V, 6)
    sums : ndarray, shape (7, V)
        Adds up the forces of each contact.
    """

    def __init__(self, touches: SevenTouches) -> None:
        self.owner = np.repeat(np.arange(7), [len(cell) for cell in touches.outer])
        self.places = np.concatenate(touches.outer)
        rates = touches.rates[self.owner]
        self.wrenches = touches.base[self.owner] + np.einsum("ca,caf->cf", self.places, rates)
        self.sums = (self.owner[None] == np.arange(7)[:, None]).astype(float)

    def placement(self, forces: np.ndarray) -> np.ndarray:
        """Where single forces do what forces (V,) at the corners do, shape (7, 2).

        A contact without force is in the middle of its corners.
        """
        each = self.sums @ forces
        weights = np.where(each[:, None] > 0.0, self.sums * forces, self.sums)
        return weights @ self.places / weights.sum(axis=1, keepdims=True)


def felt_by(normals: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """``|e_i x omega|`` for normals (N, 3) and twists (..., 6), shape (..., N); never 0."""
    turned = np.cross(normals, twists[..., None, 3:])
    return np.linalg.norm(turned, axis=-1).clip(UNFELT)


def _unit(twists: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(twists, axis=1)
    good = np.isfinite(lengths) & (lengths > 0.0)
    return twists[good] / lengths[good, None]
