r"""The search over choices of faces: good placements by trying, a proven bound of each choice.

Placements are evolved for the most promising choices.  Then the choice with the highest bound is
bounded by its program, what it proposes is evolved, and so on.  A choice that was never looked at
has the quick bound of the twists learnt from others.  At any time the highest of all bounds, or the
largest margin, is a bound on everything.

**The margin.**  Seven wrenches have one balance :math:`W n = 0, \sum n_i = 1`; closure is n > 0.
The margin is the smallest :math:`n_i`, that is t* of form closure; at most 1/7.

**The bound of one choice of faces.** A contact in a region with corners :math:`c_v` and the force
:math:`n_i` is a combination of forces at the corners, :math:`n_i = \sum_v \mu_{iv}` and
:math:`n_i w_i(p_i) = \sum_v \mu_{iv} w_i(c_v)`, since the wrench is affine on a face.  So the best
margin over all placements is a linear program in :math:`\mu`, without any loss.

**Quick bounds from twists.** Any twist :math:`\xi` of the body bounds the margin t.  With
:math:`a_i = w_i \cdot \xi` the balance says :math:`\sum n_i a_i = 0`, and coefficients of sum 1
with the smallest t can add no more to it than

.. math:: t \sum_i a_i + (1 - 7 t) \max_i a_i \ge 0 .

Each contact is at its best corner.  The duals of the linear programs are the sharpest twists.

**Good placements by trying**: differential evolution that stays in the regions.  A trial goes from
a placement towards the best one and along the difference of two others, and stops where it would
leave a region. Nothing here is a proof; bounds come from elsewhere.

Reference: Storn, Price, "Differential evolution", Journal of Global Optimization 11, 1997.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.closure.balances import balance_inverses
from multiarm.grasp.closure.form_closure import scaled_wrenches_of
from multiarm.grasp.optimisation.placements import FaceChoices, SevenTouches, seven_touches
from multiarm.programs import linear_program

# Choices of faces that placements are drawn for at the start, and how many for each.
SAMPLED, DRAWN = 300, 40
# Of these the best are evolved, and the best of those for longer: how many, from how many
# placements, for how many generations.
ROUNDS = ((40, 24, 25), (5, 40, 250))
# Choices after which quick bounds are renewed and ``progress`` is called.
REPORTED = 20
# Choices that are bounded together: memory stays small.
CHUNK = 2000


@dataclass(frozen=True)
class Limits:
    """Constraints of placements, and the end of the search.

    Attributes
    ----------
    spacing : float
        Distance between contacts over the size of the body, at least.
    conditioning : float
        Smallest over largest singular value of the scaled wrenches, at least.
    gap : float
    nodes : int
    until : float or None
        Reading of the clock.
    """

    spacing: float
    conditioning: float
    gap: float
    nodes: int
    until: float | None


class Search:
    """State of one search; ``best`` is (touches, placement) or None."""

    def __init__(
        self,
        choices: FaceChoices,
        limits: Limits,
        middle: np.ndarray,
        size: float,
        rng: np.random.Generator,
        progress: Callable[[int, int, str], None],
    ) -> None:
        self.choices, self.limits = choices, limits
        self.middle, self.size, self.rng = middle, size, rng
        self.progress = progress
        self.touches: dict[int, SevenTouches] = {}
        self.learnt: list[np.ndarray] = []
        self.tops = np.full(len(choices), LARGEST_MARGIN)
        self.looked_at = np.zeros(len(choices), dtype=bool)
        self.promising: list[tuple[float, int, np.ndarray]] = []
        self.best: tuple[SevenTouches, np.ndarray] | None = None
        self.value = 0.0
        self.done = 0

    @property
    def bound(self) -> float:
        """No placement at all has a larger margin."""
        return max(float(self.tops.max(initial=0.0)), self.value)

    @property
    def gap(self) -> float:
        """How much of the bound the value falls short."""
        return 1.0 - self.value / self.bound if self.bound > 0.0 else 0.0

    @property
    def settled(self) -> bool:
        """Whether no choice but those already looked at can be better."""
        return not bool((self.tops[~self.looked_at] > self.value).any())

    def run(self) -> None:
        """Bound choices until the gap or the budget is reached, or none is left to look at."""
        self._first_grasps()
        self._sharpen()
        while self.done < self.limits.nodes and self.gap > self.limits.gap:
            if self.limits.until is not None and time.perf_counter() > self.limits.until:
                break
            if self.settled:
                break
            self._look(int(np.argmax(np.where(self.looked_at, -np.inf, self.tops))))
            if self.done % REPORTED == 0:
                self._sharpen()
                self._tell(f"value {self.value:.4g}, bound {self.bound:.4g}")
        if self.gap > self.limits.gap:
            self._grow_promising()
        if self.best is None:
            open_end = "" if self.settled else " within the budget; allow more nodes"
            raise GraspError(
                f"no grasp that closes and keeps the distances and the floor of the conditioning "
                f"was found{open_end}; larger grippers, smaller tips, other places or a lower "
                f"conditioning than {self.limits.conditioning:.3g} may help"
            )
        self._condition()
        self._tell("done")

    def scores(self, touches: SevenTouches, y: np.ndarray) -> np.ndarray:
        """Margins (M,), 0 for placements that do not keep to the limits."""
        value = margins(touches, y)
        allowed = value > 0.0
        if self.limits.spacing > 0.0:
            allowed &= nearest(touches, y) >= self.limits.spacing
        if self.limits.conditioning > 0.0 and allowed.any():
            allowed[allowed] = conditioning(touches, y[allowed]) >= self.limits.conditioning
        return np.where(allowed, value, 0.0)

    def _look(self, number: int) -> None:
        """Bound one choice, learn from it, and evolve what its program proposes."""
        self.done += 1
        touches = self._touches(number)
        _, population, generations = ROUNDS[0]
        drawn = touches.drawn(population, self.rng)
        bound = margin_bound(touches)
        self.tops[number] = min(self.tops[number], bound.top)
        self.looked_at[number] = True
        self.learnt.append(bound.twists)
        if bound.placement is not None and bound.top > self.value:
            starts = np.concatenate([touches.within(bound.placement[None]), drawn[:-1]])
            y, scores = self._evolved(touches, starts, generations)
            self._try(touches, y[:1])
            self.promising.append((-float(scores[0]), number, y[0]))

    def _grow_promising(self) -> None:
        """Evolve the best of the choices that were looked at for longer."""
        most, population, generations = ROUNDS[-1]
        for _, number, y in sorted(self.promising, key=lambda choice: choice[:2])[:most]:
            touches = self._touches(number)
            starts = np.concatenate([y[None], touches.drawn(population - 1, self.rng)])
            grown, _ = self._evolved(touches, starts, generations)
            self._try(touches, grown[:1])

    def _try(self, touches: SevenTouches, y: np.ndarray) -> None:
        """Take the best of some placements if it beats the best known."""
        scores = self.scores(touches, y)
        k = int(np.argmax(scores))
        if scores[k] > self.value * (1.0 + 1e-9):
            self.value, self.best = float(scores[k]), (touches, y[k])

    def _touches(self, number: int) -> SevenTouches:
        if number not in self.touches:
            self.touches[number] = seven_touches(self.choices[number], self.middle, self.size)
        return self.touches[number]

    def _first_grasps(self) -> None:
        """Draw placements for many choices, evolve the best."""
        step = max(1, len(self.choices) // SAMPLED)
        known: dict[int, np.ndarray] = {}
        order = []
        for number in range(0, len(self.choices), step):
            if number % (REPORTED * step) == 0:
                self._tell("looking for good grasps")
            y = self._touches(number).drawn(DRAWN, self.rng)
            scores = self.scores(self._touches(number), y)
            known[number] = y[int(np.argmax(scores))]
            order.append((-float(scores.max()), number))
        for most, population, generations in ROUNDS:
            chosen = [number for _, number in sorted(order)[:most]]
            order = []
            for number in chosen:
                self._tell("looking for good grasps")
                touches = self._touches(number)
                drawn = touches.drawn(population - 1, self.rng)
                y, scores = self._evolved(
                    touches, np.concatenate([known[number][None], drawn]), generations
                )
                known[number] = y[0]
                order.append((-float(scores[0]), number))
        for number in chosen:
            touches = self._touches(number)
            self._try(touches, known[number][None])
            self.learnt.append(margin_bound(touches).twists)

    def _evolved(
        self, touches: SevenTouches, starts: np.ndarray, generations: int
    ) -> tuple[np.ndarray, np.ndarray]:
        def scores(y: np.ndarray) -> np.ndarray:
            return self.scores(touches, y)

        return evolved(scores, touches, starts, self.rng, generations)

    def _sharpen(self) -> None:
        """Quick bounds of all choices from the twists learnt since the last time."""
        twists, self.learnt = np.concatenate([np.zeros((0, 6)), *self.learnt]), []
        largest = []
        for region in self.choices.regions:
            corners = (region.outer - self.middle) / self.size
            e = np.broadcast_to(region.normal, corners.shape)
            wrenches = np.concatenate([e, np.cross(corners, e)], axis=1)
            largest.append((wrenches @ twists.T).max(axis=0))
        work = np.array(largest)
        for part in np.array_split(np.arange(len(self.tops)), 1 + len(self.tops) // CHUNK):
            tops = quick_bounds(work[self.choices.numbers[part]])
            self.tops[part] = np.minimum(self.tops[part], tops)

    def _condition(self) -> None:
        """Among placements of the best choice whose margin is good enough, the best conditioned."""
        assert self.best is not None
        touches, y = self.best
        least = min(max(self.bound * (1.0 - self.limits.gap), 0.0), self.value)

        def scores(z: np.ndarray) -> np.ndarray:
            margin = self.scores(touches, z)
            good = np.where(margin >= least, 1.0 + conditioning(touches, z), 0.0)
            return good + np.minimum(margin / least, 1.0)

        starts = np.concatenate([y[None], touches.drawn(ROUNDS[-1][1] - 1, self.rng)])
        near = touches.towards(np.broadcast_to(y, starts.shape), 0.5 * (y + starts))
        grown, _ = evolved(scores, touches, near, self.rng, ROUNDS[-1][2])
        margin = float(self.scores(touches, grown[:1])[0])
        if margin >= least:
            self.value, self.best = margin, (touches, grown[0])

    def _tell(self, words: str) -> None:
        self.progress(self.done, self.limits.nodes, words)


# --- Good placements by evolution -----------------------------------------------------------------

# Weights of the way to the best placement and of the difference of two others, at most.
TO_BEST, DIFFERENCE = 1.5, 1.0
# Chance that a contact takes part in a trial.
TAKING_PART = 0.25


def evolved(
    scores: Callable[[np.ndarray], np.ndarray],
    touches: SevenTouches,
    starts: np.ndarray,
    rng: np.random.Generator,
    generations: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Placements (M, 7, 2) grown from ``starts`` (M, 7, 2) and their scores, best first."""
    y, value = starts.copy(), scores(starts)
    count = len(y)
    for _ in range(generations):
        best = y[rng.choice(np.argsort(-value)[: max(1, count // 10)], count)]
        a, b = y[rng.permutation(count)], y[rng.permutation(count)]
        pull = TO_BEST * rng.random((count, 1, 1)) * (best - y)
        spread = DIFFERENCE * rng.random((count, 1, 1)) * (a - b)
        chosen = rng.random((count, 7, 1)) < TAKING_PART
        trial = touches.towards(y, np.where(chosen, y + pull + spread, y))
        trial_scores = scores(trial)
        better = trial_scores > value
        y[better], value[better] = trial[better], trial_scores[better]
    order = np.argsort(-value, kind="stable")
    return y[order], value[order]


def nearest(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """Smallest distance between two contacts, scaled, shape (M,)."""
    p = touches.points(y)
    i, j = np.triu_indices(7, 1)
    return np.linalg.norm(p[:, i] - p[:, j], axis=2).min(axis=1)


def conditioning(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """Smallest over largest singular value of wrenches scaled by the contacts' spread, (M,)."""
    p = touches.points(y)
    W, _ = scaled_wrenches_of(p, np.broadcast_to(touches.normals, p.shape))
    s = np.linalg.svd(W, compute_uv=False)
    return s[:, -1] / s[:, 0]


# --- Margins and their bounds ---------------------------------------------------------------------

# No margin of seven contacts is larger.
LARGEST_MARGIN = 1.0 / 7.0


@dataclass(frozen=True, eq=False)
class MarginBound:
    """The largest margin of all placements on one choice of faces, or more.

    Attributes
    ----------
    top : float
        No placement has a larger margin.
    placement : ndarray, shape (7, 2), or None
        In the outer regions, with this margin; None where no placement closes.
    twists : ndarray, shape (C, 6)
        That bound other choices, too.
    """

    top: float
    placement: np.ndarray | None
    twists: np.ndarray


def margins(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """``t*`` of placements (M, 7, 2), shape (M,); 0 for what is no grasp."""
    return balance_inverses(touches.wrenches(y))[..., 6].min(axis=1).clip(0.0)


def margin_bound(touches: SevenTouches) -> MarginBound:
    """The bound over the outer regions, by a linear program."""
    owner = np.repeat(np.arange(7), [len(cell) for cell in touches.outer])
    places = np.concatenate(touches.outer)
    rates = touches.rates[owner]
    wrenches = touches.base[owner] + np.einsum("ca,caf->cf", places, rates)
    sums = (owner[None] == np.arange(7)[:, None]).astype(float)  # (7, V): forces of each contact
    count = len(places)
    solved = linear_program(
        np.r_[np.zeros(count), -1.0],
        at_most=(np.hstack([-sums, np.ones((7, 1))]), np.zeros(7)),
        equal=(
            np.vstack([np.c_[wrenches.T, np.zeros(6)], np.r_[np.ones(count), 0.0]]),
            np.r_[np.zeros(6), 1.0],
        ),
        signed=1,
    )
    if solved.x is None or not -solved.value > 0.0:
        none = solved.infeasible or solved.x is not None  # else nothing is concluded
        return MarginBound(0.0 if none else LARGEST_MARGIN, None, np.zeros((0, 6)))
    shares = sums * solved.x[:count]  # all contacts push: the margin is positive
    placement = shares @ places / shares.sum(axis=1, keepdims=True)
    twist = solved.duals[:6]
    return MarginBound(-solved.value, placement, np.array([twist, -twist]))


def quick_bounds(work: np.ndarray) -> np.ndarray:
    """Bounds (B,) of B choices of faces from twists, without a program.

    ``work`` (B, 7, C) is the largest w . xi over each region, for each of C twists.
    """
    most, total = work.max(axis=1), work.sum(axis=1)
    room = 7.0 * most - total  # 0 only when all are equal: then any t will do, if positive
    tops = np.where(room > 0.0, most / np.where(room > 0.0, room, 1.0), LARGEST_MARGIN)
    tops = np.where(most > 0.0, tops, 0.0)
    return tops.min(axis=1, initial=LARGEST_MARGIN)
