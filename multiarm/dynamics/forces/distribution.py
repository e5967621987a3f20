r"""The best of all contact forces that exert a wrench: linear and quadratic programs.

With the forces :math:`\lambda_0 = W^+ w` of least norm and an orthonormal basis A of the internal
forces, all forces that exert the wrench are :math:`\lambda = \lambda_0 + A y`.  Small problems for
y choose among them:

**Smallest largest load.**  Loads are linear in the forces: the forces themselves, or torques over
the limits of the drives.  Among forces with :math:`C \lambda \le d`

.. math:: \min t \quad\text{with}\quad L \lambda + l \le t, \quad C \lambda \le d .

**Least norm between bounds**, :math:`\lambda_{\min} \le \lambda \le \lambda_{\max}`.  Since
:math:`|\lambda|^2 = |\lambda_0|^2 + |y|^2`, this is the shortest y within the bounds.

Prices say how the optimum changes with a bound.  If no forces are within the bounds, some weights
:math:`u \ge 0` of the bounds that internal forces do not change prove it; they are
:math:`-W^T v` of a twist v on which forces in their bounds do less work than the wrench (Farkas).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.programs import LeastDistance, LinearRows, least_distance, linear_program

# Part of the wrench, the forces, the prices at hand that counts as nothing: rounding.
SLACK = 1e-9
# Below this s, least distances are long (1e4) or none: a linear program decides.
COARSE = 1e-8


@dataclass(frozen=True, eq=False)
class ForceFamily:
    """All contact forces ``least_norm + internal y`` that exert a wrench.

    Attributes
    ----------
    least_norm : ndarray, shape (N,)
        ``W^+ w``.
    internal : ndarray, shape (N, N - rank)
        Columns with ``W internal = 0``.
    """

    least_norm: np.ndarray
    internal: np.ndarray


def forces_for(
    W: np.ndarray, wrench: np.ndarray, tolerance: float
) -> tuple[ForceFamily, np.ndarray]:
    """The forces with ``W forces = wrench`` or nearest to it, and what is missing of the wrench.

    Parameters
    ----------
    W : ndarray, shape (n, N)
        Its rows scaled to be comparable.
    wrench : ndarray, shape (n,)
    tolerance : float
        Singular values of W below this part of the largest count as zero.
    """
    U, s, Vt = np.linalg.svd(W)
    rank = int(np.count_nonzero(s > tolerance * s[0]))
    least_norm = Vt[:rank].T @ ((U[:, :rank].T @ wrench) / s[:rank])
    return ForceFamily(least_norm, Vt[rank:].T), wrench - W @ least_norm


# --- The smallest largest load --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SmallestLoad:
    """Forces whose largest load is as small as can be.

    Attributes
    ----------
    forces : ndarray, shape (N,), or None
        None where there are none in the bounds, or the program gave up.
    largest : float
        The largest load; NaN without forces.
    load_prices : ndarray, shape (K,)
        Shares of the loads in the largest, not negative, of sum 1.
    bound_prices : ndarray, shape (M,)
        How fast the largest load falls with each ``d``.
    infeasible : bool
        Proven: no forces are in the bounds.
    message : str
        The solver's.
    """

    forces: np.ndarray | None
    largest: float
    load_prices: np.ndarray
    bound_prices: np.ndarray
    infeasible: bool
    message: str


def smallest_load(
    family: ForceFamily, loads: LinearRows, bounds: LinearRows | None = None
) -> SmallestLoad:
    """Minimise the largest load ``L forces + l`` of forces with ``C forces <= d``.

    Parameters
    ----------
    family : ForceFamily
    loads : (array (K, N), array (K,))
        ``(L, l)``.
    bounds : (array (M, N), array (M,)), optional
        ``(C, d)``.
    """
    A, start = family.internal, family.least_norm
    L, l0 = loads
    C, d = (np.empty((0, len(start))), np.empty(0)) if bounds is None else bounds
    rows = np.vstack([C @ A, L @ A])
    column = np.r_[np.zeros(len(C)), -np.ones(len(L))]
    program = linear_program(
        np.append(np.zeros(A.shape[1]), 1.0),
        at_most=(np.column_stack([rows, column]), np.r_[d - C @ start, -l0 - L @ start]),
        signed=A.shape[1] + 1,
    )
    solved = program.x is not None
    return SmallestLoad(
        forces=start + A @ program.x[:-1] if program.x is not None else None,
        largest=float(program.x[-1]) if program.x is not None else np.nan,
        load_prices=program.prices[len(C) :] if solved else np.empty(0),
        bound_prices=program.prices[: len(C)] if solved else np.empty(0),
        infeasible=program.infeasible,
        message=program.message,
    )


def pressed(internal: np.ndarray) -> np.ndarray | None:
    """How far each contact can be pressed by internal forces that only push, shape (N,).

    The largest sum of ``min(force, 1)``: 0 for contacts that no such forces press.  None where the
    program gives up.

    Parameters
    ----------
    internal : ndarray, shape (N, k)
        Basis of the internal forces.
    """
    count, size = internal.shape
    program = linear_program(
        np.append(-np.ones(count), np.zeros(size)),
        at_most=(np.block([np.eye(count), -internal]), np.zeros(count)),
        bounds=(0.0, 1.0),
        signed=size,
    )
    return None if program.x is None else program.x[:count]


# --- Forces between bounds ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BoundedForces:
    """The forces between bounds that exert a wrench.

    Attributes
    ----------
    W : ndarray, shape (n, N)
        Scaled wrenches.
    family : ForceFamily
        Forces of the order of 1.
    least, limit : ndarray, shape (N,)
        The limit may be infinite.
    tolerance : float
        Singular values below this part of the largest count as zero.
    blur : float
        Rounding of a unit of internal forces.
    """

    W: np.ndarray
    family: ForceFamily
    least: np.ndarray
    limit: np.ndarray
    tolerance: float
    blur: float

    @property
    def room(self) -> float:
        """The tolerance of rounding in a bound of a force."""
        return min(self.blur, SLACK)

    @property
    def bounded(self) -> np.ndarray:
        """Which forces have a limit, shape (N,)."""
        return np.isfinite(self.limit)


@dataclass(frozen=True, eq=False)
class BestForces:
    """The best forces between bounds, or the proof that none are there.

    Attributes
    ----------
    forces : ndarray, shape (N,), or None
    value : float
        The largest force, or the norm.
    slope : ndarray, shape (n,)
        How fast the value grows with the scaled wrench; without forces, a twist on which no forces
        in their bounds do as much work as the wrench.
    prices : ndarray, shape (N,)
        How fast the value grows with the bound at which each force is: positive at a minimum,
        negative at a limit.
    optimal : bool
        False where rounding hides the least norm: forces are some in the bounds, their slope and
        prices mean nothing.
    """

    forces: np.ndarray | None
    value: float
    slope: np.ndarray
    prices: np.ndarray
    optimal: bool = True


def least_norm(problem: BoundedForces) -> BestForces:
    """The forces of least norm."""
    family, scale = problem.family, 1.0
    shortest = _shortest(problem)
    if shortest.s <= COARSE:
        program = _smallest_largest(problem)
        if program.forces is None:
            return _infeasible(problem, shortest.weights)
        forces = program.forces
        scale = float(forces.max())
        shortest = _shortest(problem, forces)
    prices, optimal = np.zeros(len(family.least_norm)), shortest.s > COARSE
    if optimal:
        forces = family.least_norm + scale * family.internal @ shortest.point
        prices = scale * _signed(problem, shortest.prices)
    norm = float(np.linalg.norm(forces))
    # forces = W^T slope + prices: the slope of |forces|^2 / 2
    slope = _dual(problem, forces - prices)
    return BestForces(forces, norm, slope / norm, prices / norm, optimal)


def smallest_largest(problem: BoundedForces) -> BestForces:
    """The forces whose largest is smallest; of these, those of least norm."""
    program = _smallest_largest(problem)
    if program.forces is None:
        return _infeasible(problem, _shortest(problem).weights)
    prices = _signed(problem, program.bound_prices)
    # the shares in the largest force are W^T slope + prices
    slope = _dual(problem, program.load_prices - prices)
    nothing = SLACK + problem.blur
    held = (np.abs(prices) > nothing) | (program.load_prices > nothing)
    forces = _of_less_norm(problem, program.forces, held)
    return BestForces(forces, float(forces.max()), slope, prices)


def _of_less_norm(problem: BoundedForces, forces: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The least norm among forces no larger than the largest, of which some are ``held``.

    A force with a price is the same in all optima; the others have room, which the least distance
    needs.
    """
    internal = problem.family.internal
    _, s, Vt = np.linalg.svd(internal[held])
    basis = internal @ Vt[int(np.count_nonzero(s > problem.tolerance + problem.blur)) :].T
    scale, free = float(forces.max()), ~held
    start = forces - basis @ (basis.T @ forces)
    least = np.minimum(problem.least, forces)
    most = np.minimum(np.maximum(problem.limit, forces), scale)
    G = np.vstack([basis[free], -basis[free]])
    h = np.concatenate([(least - start)[free], (start - most)[free]])
    shortest = least_distance(G, h / scale, problem.room)
    if shortest.s < COARSE:
        return forces
    calmer, room = start + scale * basis @ shortest.point, 2.0 * SLACK * scale
    return calmer if np.all((calmer >= least - room) & (calmer <= most + room)) else forces


def _smallest_largest(problem: BoundedForces) -> SmallestLoad:
    eye, bounded = np.eye(len(problem.least)), problem.bounded
    bounds = np.vstack([-eye, eye[bounded]]), np.r_[-problem.least, problem.limit[bounded]]
    return smallest_load(problem.family, (eye, np.zeros(len(eye))), bounds)


def _shortest(problem: BoundedForces, within: np.ndarray | None = None) -> LeastDistance:
    """The shortest y within the bounds; if forces are known that meet them, in their unit.

    These meet the bounds to the tolerance of a linear program, to which the bounds give way.
    """
    least, limit, scale = problem.least, problem.limit, 1.0
    if within is not None:
        least, limit = np.minimum(least, within), np.maximum(limit, within)
        scale = float(within.max())
    bounded, start, internal = problem.bounded, problem.family.least_norm, problem.family.internal
    G = np.vstack([internal, -internal[bounded]])
    h = np.concatenate([least - start, (start - limit)[bounded]])
    return least_distance(G, h / scale, problem.room)


def _signed(problem: BoundedForces, weights: np.ndarray) -> np.ndarray:
    """Prices of minimum and limit as one number for each contact."""
    count = len(problem.least)
    prices = weights[:count].copy()
    prices[problem.bounded] -= weights[count:]
    return prices


def _dual(problem: BoundedForces, forces: np.ndarray) -> np.ndarray:
    """``v`` with ``W^T v = forces``, by least squares."""
    return np.linalg.lstsq(problem.W.T, forces, rcond=problem.tolerance)[0]


def _infeasible(problem: BoundedForces, weights: np.ndarray) -> BestForces:
    signed = _signed(problem, weights)
    return BestForces(None, np.inf, -_dual(problem, signed), np.zeros(len(signed)))
