r"""Objectives of grasps with seven contacts, and their upper bounds.

Seven wrenches have one balance :math:`W n = 0, \sum n_i = 1`; closure is n > 0. With G the inverse
of :math:`[W; 1 \dots 1]`, whose last column is n and whose other columns are :math:`g_i`:

*margin*: the smallest :math:`n_i`, that is t* of form closure; at most 1/7.

*force*: a load F is balanced by :math:`\lambda = -G F + \tau n`, least when :math:`\tau` is the
least that makes it nonnegative. The score is the inverse of the largest force over all loads.

*stability*: the closure radius (:mod:`multiarm.grasp.closure_radii`).

**Twist cuts.** Any twist :math:`\xi = (v, \omega)` of the body bounds the score. By virtual work
:math:`F \cdot \xi = \sum_i \lambda_i (-w_i \cdot \xi)`, so

.. math:: \frac{1}{\lambda_{\max}} \le \sum_i [-w_i \cdot \xi]_+ \,/\, \max_k F_k \cdot \xi .

Contacts that slide by r change :math:`w_i \cdot \xi` by at most :math:`r |e_i \times \omega|`, and
the grasp is lost when all of them are brought to zero or below, so

.. math:: r \le \max_i \; w_i \cdot \xi \,/\, |e_i \times \omega| .

For the best twist both are equalities. As :math:`w_i` is affine in the place of contact i, over
cells :math:`[z]_+` has a chord above it, and with it each cut is affine in the whole placement: the
best that all cuts allow is a linear program (:mod:`multiarm.grasp.placement_bounds`).

**Chords.**  Over cells (a product of polygons) an affine :math:`z(y)` ranges over an interval [l,
h]. Its positive part is convex, so the chord from l to h is above it,

.. math:: [z]_+ \le \frac{h}{h - l} (z - l) \quad (l < 0 < h),

and it is z itself, or 0, when the interval lies on one side of 0. A sum of chords is affine in y.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiarm.grasp.balances import balance_inverses
from multiarm.grasp.closure_radii import closure_radius
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.placements import SevenTouches

# Steps of Newton's method towards the displacements that lose the grasp.
STEPS = 3
# A contact whose place a twist does not feel: it is never lost to it.
UNFELT = 1e-9
# A twist along which no load does this much work says nothing about forces.
LOADED = 1e-9
# Stands for a cut that says nothing.
VOID = 1e6


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
    def twists(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Twists (C, 6) of unit length whose cuts are sharp at a placement (7, 2)."""

    @abstractmethod
    def cuts(
        self, touches: SevenTouches, cells: list[np.ndarray], twists: np.ndarray, floor: float
    ) -> Cuts:
        """Cuts over cells, seven polygons (V, 2); of use for scores above ``floor`` only."""

    @abstractmethod
    def reaches(
        self, low: np.ndarray, high: np.ndarray, normals: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Contributions of R single regions to quick bounds from twists (C, 6), shape (R, C).

        ``low`` and ``high`` (R, C) are the extremes of w . xi over each; ``normals`` (R, 3).
        """

    @abstractmethod
    def quick_bounds(self, reaches: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """Bounds (B,) for B choices of seven regions, from their reaches (B, 7, C)."""


class Margin(Objective):
    """The smallest coefficient of the balance with sum 1; bounded by another program."""

    limit = 1.0 / 7.0

    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """``t*`` of each placement."""
        return balance_inverses(touches.wrenches(y))[..., 6].min(axis=1).clip(0.0)

    def twists(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """None are needed."""
        return np.zeros((0, 6))

    def cuts(
        self, touches: SevenTouches, cells: list[np.ndarray], twists: np.ndarray, floor: float
    ) -> Cuts:
        """None are needed."""
        none = np.zeros((0, 7))
        return Cuts(
            twists[:0], np.zeros((0, 7, 2)), none[:, 0], none, none, np.zeros((0, 7, 2)), none
        )

    def reaches(
        self, low: np.ndarray, high: np.ndarray, normals: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """The highest w . xi."""
        return high

    def quick_bounds(self, reaches: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """From ``sum n_i a_i = 0``, a = w . xi: ``t sum a_i + (1 - 7 t) max a_i >= 0``."""
        most, total = reaches.max(axis=1), reaches.sum(axis=1)
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
        forces = self._forces(np.where(closed[:, None, None], G, 1.0))
        worst = forces.max(axis=(1, 2))
        return np.where(closed, 1.0 / np.where(closed, worst, 1.0), 0.0)

    def _forces(self, G: np.ndarray) -> np.ndarray:
        """Least forces under each load, shape (M, K, 7)."""
        n = G[..., None, :, 6]
        plain = -np.einsum("mif,kf->mki", G[..., :6], self.loads)
        return plain + (-plain / n).max(axis=2, keepdims=True) * n

    def twists(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Under each load the twist that five of the contacts do not feel.

        The other two are the one with the largest force and one with none; for what is no grasp,
        any two of opposite signs in the balance.
        """
        G = balance_inverses(touches.wrenches(y)[None])
        n, g = G[0, :, 6], G[0, :, :6]
        if not n.any():
            return weakest(touches.wrenches(y))
        if n.min() > 0.0:
            forces = self._forces(G)[0]
            pairs = set(
                zip(forces.argmax(axis=1).tolist(), forces.argmin(axis=1).tolist(), strict=True)
            )
        else:
            pairs = {(j, i) for i in np.flatnonzero(n > 0.0) for j in np.flatnonzero(n < 0.0)}
            pairs |= {(i, j) for j, i in pairs}
        rows = [g[b] / n[b] - g[m] / n[m] for m, b in sorted(pairs) if m != b]
        return _unit(np.array(rows).reshape(-1, 6))

    def cuts(
        self, touches: SevenTouches, cells: list[np.ndarray], twists: np.ndarray, floor: float
    ) -> Cuts:
        """``sum_i [-w_i . xi]_+ / max_k F_k . xi`` with chords."""
        load = (twists @ self.loads.T).max(axis=1)
        kept = load > LOADED
        twists, load = twists[kept], load[kept, None]
        value = -(twists @ touches.base.T) / load
        slope = -np.einsum("cf,iaf->cia", twists, touches.rates) / load[..., None]
        terms = np.eye(7)[..., None] * slope[:, None]
        return with_chords(twists, value, terms, cells, np.zeros(len(value)))

    def reaches(
        self, low: np.ndarray, high: np.ndarray, normals: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Each contact at its best corner."""
        return (-low).clip(0.0)

    def quick_bounds(self, reaches: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """The cuts, every contact at its best."""
        load = (twists @ self.loads.T).max(axis=1)
        useful = load > LOADED
        tops = reaches[:, :, useful].sum(axis=1) / load[useful]
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
        reached = np.einsum("mif,mcf->mci", W, xi) / _felt(touches, xi)
        reached[~np.any(xi, axis=2)] = np.inf  # no twist was found: nothing is known
        least = reached.max(axis=2).min(axis=1, initial=VOID)
        radii[closed] = np.where(least < VOID, least, 0.0).clip(0.0)
        return radii

    def certain(self, touches: SevenTouches, y: np.ndarray) -> float:
        """The guaranteed closure radius."""
        return closure_radius(Contacts(touches.points(y), touches.normals)).lower

    def twists(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """The twist to which the grasp is lost when contact i opens first, for each i."""
        G = balance_inverses(touches.wrenches(y)[None])[0]
        n, g = G[:, 6], G[:, :6]
        if not n.any():
            return weakest(touches.wrenches(y))
        if n.min() > 0.0:
            return _unit(self._losing(touches, y[None])[0])
        pairs = [(i, j) for i in np.flatnonzero(n > 0.0) for j in np.flatnonzero(n < 0.0)]
        return _unit(np.array([g[j] / n[j] - g[i] / n[i] for i, j in pairs]).reshape(-1, 6))

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

    def cuts(
        self, touches: SevenTouches, cells: list[np.ndarray], twists: np.ndarray, floor: float
    ) -> Cuts:
        """``max_b M_b . omega / sum_i b_i |e_i x omega|``, as a level and what exceeds it."""
        B = touches.generators
        felt = (_felt(touches, twists) @ B.T).clip(UNFELT)  # (C, T)
        value = np.einsum("cf,if,ti->ct", twists[:, 3:], touches.base[:, 3:], B) / felt
        slope = np.einsum("cf,iaf,ti->ctia", twists[:, 3:], touches.rates[:, :, 3:], B)
        slope /= felt[..., None, None]
        low, _ = ranges(value, slope, cells)
        level = low.max(axis=1).clip(floor, VOID)
        return with_chords(twists, value - level[:, None], slope, cells, level)

    def reaches(
        self, low: np.ndarray, high: np.ndarray, normals: np.ndarray, twists: np.ndarray
    ) -> np.ndarray:
        """Each contact at its best corner."""
        turned = np.linalg.norm(np.cross(normals[:, None], twists[:, 3:]), axis=-1)
        return high / turned.clip(UNFELT)

    def quick_bounds(self, reaches: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """The cuts, every contact at its best."""
        return reaches.max(axis=1).clip(0.0).min(axis=1, initial=self.limit)


def weakest(W: np.ndarray) -> np.ndarray:
    """The twist, either way, that wrenches in rows (7, 6) feel least, shape (2, 6)."""
    least = np.linalg.svd(W)[2][-1]
    return np.array([least, -least])


def _felt(touches: SevenTouches, twists: np.ndarray) -> np.ndarray:
    """``|e_i x omega|`` for twists (..., 6), shape (..., 7); never 0."""
    turned = np.cross(touches.normals, twists[..., None, 3:])
    return np.linalg.norm(turned, axis=-1).clip(UNFELT)


def _unit(twists: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(twists, axis=1)
    good = np.isfinite(lengths) & (lengths > 0.0)
    return twists[good] / lengths[good, None]


# --- Chords over cells ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cuts:
    """Affine upper bounds ``constant + sum_i slope_i . y_i`` on the score, one for each twist.

    Attributes
    ----------
    twists : ndarray, shape (C, 6)
        Those that say something.
    slopes : ndarray, shape (C, 7, 2)
    constants : ndarray, shape (C,)
    term_slopes, term_values : ndarray, shape (C, T, 7, 2) and (C, T)
        The cut is a sum over terms z, affine in y; each stands as [z]_+ in the true bound.
    rises, bends : ndarray, shape (C, T)
        The chord of each term is ``rise * z + bend``.
    """

    twists: np.ndarray
    slopes: np.ndarray
    constants: np.ndarray
    term_slopes: np.ndarray
    term_values: np.ndarray
    rises: np.ndarray
    bends: np.ndarray


def with_chords(
    twists: np.ndarray,
    value: np.ndarray,
    slope: np.ndarray,
    cells: list[np.ndarray],
    level: np.ndarray,
) -> Cuts:
    """``level + sum_t [z_t]_+`` with z = value + slope . y over cells, each [.]_+ by its chord."""
    low, high = ranges(value, slope, cells)
    bent = (low < 0.0) & (high > 0.0)
    rise = np.where(bent, high / np.where(bent, high - low, 1.0), (low >= 0.0).astype(float))
    bend = np.where(bent, -rise * low, 0.0)
    return Cuts(
        twists=twists,
        slopes=np.einsum("ct,ctia->cia", rise, slope),
        constants=level + np.sum(rise * value + bend, axis=1),
        term_slopes=slope,
        term_values=value,
        rises=rise,
        bends=bend,
    )


def ranges(
    value: np.ndarray, slope: np.ndarray, cells: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest ``value + slope . y`` over cells."""
    spans = [slope[:, :, i] @ cell.T for i, cell in enumerate(cells)]
    low = value + np.sum([span.min(axis=2) for span in spans], axis=0)
    return low, value + np.sum([span.max(axis=2) for span in spans], axis=0)
