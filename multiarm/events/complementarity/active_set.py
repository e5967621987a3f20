r"""The active set: which rows are kept at rate zero from now on, and their minimum-norm forces.

Between events the motion is that of equations: the rates of the active rows are zero, their forces
are those of minimum norm that achieve it, and nothing checks their signs. So rows are needed whose
minimum-norm forces obey the contact laws by themselves.

**Minimum-norm forces.** With the motion given, the forces v of the rows in contact obey linear
equations and bounds,

.. math:: \min |v|^2 \quad\text{with}\quad D B v = D (x^* - x_0), \qquad l \le v \le u ,

where :math:`x^*` is any solution, :math:`x_0` what is constant, and a column of B is a row, or a
normal row with its friction tied to it. With :math:`v_p` the smallest of all, whatever the signs,
and Q a basis of the forces that move nothing, :math:`v = v_p + Q q`, the bounds read
:math:`K q + k \ge 0`, and the multipliers u of the bounds solve a complementarity problem again:

.. math:: q = K^T u, \qquad 0 \le u \perp K K^T u + k \ge 0 .

:math:`|v|` is meant in the rows as they are: newtons for forces, newton metres for couples.

**Rows.** Without friction the minimum-norm forces *between their bounds* say which rows are active.
Leave out the rows that end at a bound: the forces of the rest are then the smallest of all forces
of these rows, whatever their signs, because no bound restricts them (the problem is convex, the
norm a sum over rows). Rows that end at zero rest.

Cones are not linear. Where the minimum-norm forces leave the cones of some contacts, their tangents
are left out: other contacts may keep them from slipping. If these cannot, friction is at its bound
somewhere. Then the forces go from a solution, which is inside of all cones, straight to those of
minimum norm, until the first cones are met; there friction is tied to the normal force, and the
search goes on from that point. Each step ties one contact at least, so that it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.factors import rank_of
from multiarm.events.complementarity.problem import (
    CONSISTENT,
    MARGIN,
    RANK,
    Bounded,
    Cone,
    ContactMode,
    Friction,
    Problem,
    Sliding,
    matrix_rank,
)
from multiarm.events.complementarity.solvers import solve_box

TIED = (ContactMode.SLIDING, ContactMode.AT_BOUND)
ACTIVE = (ContactMode.CLOSED, ContactMode.STICKING, ContactMode.HOLDING, *TIED)
# Choices of tangents to leave out that are tried: with a dozen contacts at the cone, a few each.
CHOICES = 64
UNDETERMINED = (
    "the rows in contact leave the motion undetermined: forces that squeeze without moving them "
    "change the friction"
)
NO_ROWS = "no rows can be held whose smallest forces obey the laws"


class LawMode(NamedTuple):
    """Mode of one law, and the unit vector of the slip that friction at its bound opposes."""

    mode: ContactMode
    direction: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class ActiveSet:
    """Forces, modes and active rows.

    Attributes
    ----------
    forces : ndarray, shape (m,)
        ``x``.
    modes : tuple of LawMode
        One for each law.
    rows : tuple of int
        Active rows, increasing.
    restricted : bool
        Whether bounds keep the forces from the minimum norm that the rows alone would give them.
    unique : bool
        Whether the rows in contact are independent.
    message : str
        Why no rows have minimum-norm forces that obey the laws; empty when some have.
    """

    forces: np.ndarray
    modes: tuple[LawMode, ...]
    rows: tuple[int, ...] = ()
    restricted: bool = False
    unique: bool = False
    message: str = ""


def active_set(problem: Problem, z: np.ndarray) -> ActiveSet:
    """Active rows and minimum-norm forces with the motion of a solution.

    Without any that obey the laws: all rows in contact, the forces as they are, and why.
    """
    search = _Search(problem, z)
    modes = law_modes(problem, z)
    active = search.without_limits(modes) or search.with_limits(modes, search.x)
    if active is None:
        rows = tuple(sorted(Unknowns(problem, modes).rows))
        message = UNDETERMINED if search.undetermined else NO_ROWS
        active = ActiveSet(search.x, modes, rows, message=message)
    return replace(active, unique=not search.dependent)


def law_modes(problem: Problem, z: np.ndarray) -> tuple[LawMode, ...]:
    """Modes by the motion alone: every row in contact is active."""
    w, zero = problem.G @ z + problem.g, MARGIN * problem.size(z)
    modes = []
    for law, k in zip(problem.laws, problem.columns, strict=True):
        if isinstance(law, Bounded):
            modes.append(LawMode(_bounded_mode(w[k], problem.upper[k] - problem.lower[k], zero)))
        elif w[k] > zero:
            modes.append(LawMode(ContactMode.OPEN))
        elif isinstance(law, Sliding):
            modes.append(LawMode(ContactMode.SLIDING, law.direction))
        elif isinstance(law, Friction):
            modes.append(_friction_mode(problem.cones[k], z, w, zero))
        else:
            modes.append(LawMode(ContactMode.CLOSED))
    return tuple(modes)


def _bounded_mode(rate: float, width: float, zero: float) -> ContactMode:
    if rate < -zero:
        return ContactMode.AT_UPPER
    at_lower = rate > zero or width <= 2.0 * zero
    return ContactMode.AT_LOWER if at_lower else ContactMode.HOLDING


def _friction_mode(cone: Cone, z: np.ndarray, w: np.ndarray, zero: float) -> LawMode:
    slip, friction = w[cone.tangents], -z[cone.tangents]
    if np.hypot(*slip) <= zero:
        return LawMode(ContactMode.CLOSED if cone.mu == 0.0 else ContactMode.STICKING)
    # the force gives the direction more accurately, where there is one
    vector = friction if np.hypot(*friction) > zero else slip
    return LawMode(ContactMode.SLIDING, _unit_vector(vector))


def _unit_vector(vector: np.ndarray) -> tuple[float, float]:
    length = np.hypot(*vector)
    return float(vector[0] / length), float(vector[1] / length)


class Unknowns:
    """The k unknown forces of a choice of modes.

    Attributes
    ----------
    B : ndarray, shape (m, k)
        All forces from the unknown ones.
    rows : list of int
        The active row of each.
    lower, upper : ndarray, shape (k,)
        Bounds [N] or [N m].
    fixed : ndarray, shape (m,)
        Forces that are constant at their bounds.
    """

    def __init__(self, problem: Problem, modes: tuple[LawMode, ...]) -> None:
        columns, lower, upper = [], [], []
        self.rows: list[int] = []
        self.fixed = np.zeros(problem.b.size)
        identity = np.eye(problem.b.size)
        for law, (mode, direction) in zip(problem.laws, modes, strict=True):
            if isinstance(law, Bounded) and mode in (ContactMode.AT_LOWER, ContactMode.AT_UPPER):
                self.fixed[law.row] = law.lower if mode == ContactMode.AT_LOWER else law.upper
            if mode not in ACTIVE:
                continue
            column = identity[law.row]
            if mode in TIED:
                assert isinstance(law, (Sliding, Friction))
                column[list(law.tangents)] = [-law.mu * s for s in direction]
            bounds = (law.lower, law.upper) if isinstance(law, Bounded) else (0.0, np.inf)
            new = [(column, law.row, bounds)]
            if mode == ContactMode.STICKING:
                assert isinstance(law, Friction)
                new += [(identity[row], row, (-np.inf, np.inf)) for row in law.tangents]
            for column, row, (low, high) in new:
                columns.append(column)
                self.rows.append(row)
                lower.append(low)
                upper.append(high)
        self.B = np.array(columns).reshape(len(columns), problem.b.size).T.copy()
        self.lower, self.upper = np.array(lower), np.array(upper)
        self.tied = any(mode in TIED for mode, _ in modes)


class _Search:
    """Looks for modes whose minimum-norm forces obey the laws.

    Attributes
    ----------
    x : ndarray, shape (m,)
        Forces of a solution: they give the motion.
    zero : float
        What counts as zero, scaled.
    tries : int
        Choices of tangents that may still be left out.
    dependent : bool
        Whether forces were found that move nothing.
    undetermined : bool
        Whether forces were found that leave the active rows at rest, but move others: sliding
        friction grows with forces that squeeze.
    """

    def __init__(self, problem: Problem, z: np.ndarray) -> None:
        self.problem, self.x = problem, problem.E @ z
        self.zero = MARGIN * problem.size(z)
        self.tries = CHOICES
        self.dependent = self.undetermined = False

    def without_limits(self, modes: tuple[LawMode, ...]) -> ActiveSet | None:
        """An active set with fewer rows, friction nowhere at its bound."""
        self.tries -= 1
        choice = self.least(modes) if self.tries >= 0 else None
        if choice is None:
            return None
        fewer = self._without_idle(choice)
        if fewer != modes and (active := self.without_limits(fewer)):
            return active
        outside = self._outside_of_cones(choice)
        if not outside:
            return None if choice.restricted else choice
        # all of them at once, which keeps what is symmetric so; then the worst
        worst = max(outside, key=lambda k: outside[k])
        for group in [outside, {worst}] if len(outside) > 1 else [outside]:
            closed = LawMode(ContactMode.CLOSED)
            fewer = tuple(closed if k in group else mode for k, mode in enumerate(modes))
            if active := self.without_limits(fewer):
                return active
        return None

    def with_limits(self, modes: tuple[LawMode, ...], x: np.ndarray) -> ActiveSet | None:
        """An active set with friction tied where it meets its bound on the way from forces x."""
        choice = self.least(modes)
        while choice is not None and (outside := self._outside_of_cones(choice)):
            parts = {k: self._part_to_cone(k, x, choice.forces) for k in outside}
            part = min(parts.values())
            x = x + part * (choice.forces - x)
            met = {k for k in parts if parts[k] <= part + MARGIN}
            modes = tuple(
                LawMode(ContactMode.AT_BOUND, self._slip_direction(k, x, choice.forces))
                if k in met
                else mode
                for k, mode in enumerate(modes)
            )
            choice = self.least(modes)
        if choice is None:
            return None
        fewer = self._without_idle(choice)
        if fewer != modes and (active := self.with_limits(fewer, choice.forces)):
            return active
        return None if choice.restricted else choice

    def least(self, modes: tuple[LawMode, ...]) -> ActiveSet | None:
        """Minimum-norm forces of these modes within their bounds, if these rows give the motion."""
        problem, s = self.problem, self.problem.scale
        unknowns = Unknowns(problem, modes)
        weights = s[unknowns.rows]
        response = s[:, None] * problem.D @ unknowns.B * weights
        # rates of zero in the active rows leave one motion, unless friction is tied
        if unknowns.tied and matrix_rank(response[unknowns.rows]) != matrix_rank(response):
            self.undetermined = True
            return None
        motion = s * (problem.D @ (self.x - unknowns.fixed))
        v, restricted = self._least_unknowns(response, motion, weights, unknowns)
        if v is None:
            return None
        forces = unknowns.fixed + unknowns.B @ v
        return ActiveSet(forces, modes, tuple(sorted(unknowns.rows)), restricted)

    def _least_unknowns(
        self, response: np.ndarray, motion: np.ndarray, s: np.ndarray, unknowns: Unknowns
    ) -> tuple[np.ndarray | None, bool]:
        """The unknown forces, and whether bounds restrict them."""
        if not unknowns.rows:
            return (np.zeros(0) if self._small(motion) else None), False
        left, values, right = np.linalg.svd(response, full_matrices=True)
        r = rank_of(values, RANK, 1.0)
        scaled = np.zeros(s.size)
        for _ in range(2):  # the second time for the rounding that small singular values enlarge
            rest = motion - response @ scaled
            scaled += right[:r].T @ ((left[:, :r].T @ rest) / values[:r])
        if not self._small(motion - response @ scaled):
            return None, False
        v: np.ndarray | None = s * scaled
        restricted = False
        if r < s.size:
            self.dependent = True
            Q = np.linalg.qr(s[:, None] * right[r:].T)[0]
            v, restricted = _between_bounds(s * scaled, Q, s, unknowns)
        if v is None:
            return None, restricted
        slack = s * self.zero
        inside = np.all(v >= unknowns.lower - slack) and np.all(v <= unknowns.upper + slack)
        return (v if inside else None), restricted

    def _small(self, rates: np.ndarray) -> bool:
        return bool(np.max(np.abs(rates), initial=0.0) <= self.zero * (CONSISTENT / MARGIN))

    def _without_idle(self, choice: ActiveSet) -> tuple[LawMode, ...]:
        """Modes without the rows whose force is zero, or at a bound."""
        problem, x, modes = self.problem, choice.forces, list(choice.modes)
        for k, law in enumerate(problem.laws):
            if modes[k].mode not in ACTIVE:
                continue
            zero = self.zero * problem.scale[law.row]
            if not isinstance(law, Bounded):
                if x[law.row] <= zero:
                    modes[k] = LawMode(ContactMode.RESTING)
            elif x[law.row] <= law.lower + zero:
                modes[k] = LawMode(ContactMode.AT_LOWER)
            elif x[law.row] >= law.upper - zero:
                modes[k] = LawMode(ContactMode.AT_UPPER)
        return tuple(modes)

    def _outside_of_cones(self, choice: ActiveSet) -> dict[int, float]:
        """Sticking contacts that are not inside their cones, and by how much (scaled)."""
        outside = {}
        for k, (law, (mode, _)) in enumerate(zip(self.problem.laws, choice.modes, strict=True)):
            if mode == ContactMode.STICKING and isinstance(law, Friction):
                tangents = choice.forces[list(law.tangents)]
                excess = np.hypot(*tangents) - law.mu * choice.forces[law.row]
                outside[k] = float(excess / self.problem.scale[law.tangents[0]])
        return {k: excess for k, excess in outside.items() if excess > -self.zero}

    def _part_to_cone(self, k: int, start: np.ndarray, end: np.ndarray) -> float:
        """The part of the way from start to end at which a contact meets its cone."""
        law = self.problem.laws[k]
        assert isinstance(law, Friction)
        rows = [*law.tangents, law.row]
        a, d = start[rows], end[rows] - start[rows]
        # |a_t + f d_t|^2 = mu^2 (a_n + f d_n)^2
        metric = np.array([1.0, 1.0, -(law.mu**2)])
        p, q, r = metric @ (d * d), metric @ (a * d), metric @ (a * a)
        if r >= 0.0:
            return 0.0
        root = q * q - p * r
        if root < 0.0:
            return 1.0
        # the stable form of the smallest positive root
        part = -r / (q + np.sqrt(root)) if q + np.sqrt(root) > 0.0 else 1.0
        return float(min(part, 1.0))

    def _slip_direction(self, k: int, x: np.ndarray, end: np.ndarray) -> tuple[float, float]:
        """Direction of slip that friction opposes; any, for a contact that bears nothing."""
        law = self.problem.laws[k]
        assert isinstance(law, Friction)
        zero = self.zero * self.problem.scale[law.tangents[0]]
        for forces in (x, end):
            tangents = forces[list(law.tangents)]
            if np.hypot(*tangents) > zero:
                return _unit_vector(-tangents)
        return (1.0, 0.0)


def _between_bounds(
    v: np.ndarray, Q: np.ndarray, s: np.ndarray, unknowns: Unknowns
) -> tuple[np.ndarray | None, bool]:
    """The smallest forces between their bounds, from the multipliers of the bounds."""
    v = v - Q @ (Q.T @ v)
    lower, upper = unknowns.lower, unknowns.upper
    low, high = np.isfinite(lower), np.isfinite(upper)
    K = np.vstack([(Q / s[:, None])[low], -(Q / s[:, None])[high]])
    k = np.concatenate([((v - lower) / s)[low], ((upper - v) / s)[high]])
    if np.all(k >= 0.0):
        return v, False
    size = np.sqrt(np.sum(K * K, axis=1))
    # forces that the motion determines: nothing to choose, and a row of rounding
    free = size > RANK * np.max(size)
    K, k = K[free] / size[free, None], k[free] / size[free]
    u, _ = solve_box(K @ K.T, k, np.zeros(k.size), np.full(k.size, np.inf))
    return (None if u is None else v + Q @ (K.T @ u)), True
