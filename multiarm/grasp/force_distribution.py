r"""Contact forces that exert a given wrench: how hard each finger has to push.

The contacts exert the wrench :math:`w = [f; m]` on the body (force, and moment about the origin of
the frame) with the forces :math:`\lambda`, each of which can only push:

.. math::
    W \lambda = w, \qquad \lambda_{\min} \le \lambda \le \lambda_{\max} .

To carry a body of weight G, the contacts exert the wrench opposite to gravity's.  Among all such
forces, those are taken whose largest is smallest (a linear program; of these, the ones of least
norm), or those of least norm :math:`|\lambda|` at once.  With :math:`\lambda_0 = W^+ w` and a basis
:math:`A` of the internal forces, :math:`\lambda = \lambda_0 + A y`, both are small problems for y.

If no forces do, there is a twist v that proves it (Farkas): for all forces allowed

.. math::
    (W \lambda) \cdot v < w \cdot v ,

the contacts cannot do as much work on this motion of the body as the wrench has to.  Reference:
Bicchi (1994), Han, Trinkle and Li (2000), here without friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.balances import BAND
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.free_motions import about_origin, motion_in_words, twist_of
from multiarm.grasp.least_distance import LeastDistance, least_distance

OBJECTIVES = ("largest", "norm")
# Part of the forces at hand by which bounds and balance may be missed: rounding, not mechanics.
SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class ForceDistribution:
    """Forces that exert a wrench, or the proof that none do; its truth value is ``feasible``.

    Attributes
    ----------
    feasible : bool
    forces : ndarray, shape (N,), or None
        ``lam``, positive pushes [N].
    value : float
        The largest force, or the norm of the forces [N]; infinite when not feasible.
    sensitivity : ndarray, shape (6,) or (3,), or None
        How fast ``value`` grows with the wrench: per newton, per newton metre about the origin.
        Where it has a kink, one of the slopes.
    force_prices : ndarray, shape (N,), or None
        How fast ``value`` grows with the bound at which each force is: positive for a minimum that
        costs, negative for a limit that does.
    residual : float
        What is missing between the wrench of ``forces`` and the one asked for [N], moments over
        the spread of the contacts: rounding.
    motion : ndarray, shape (6,) or (3,), or None
        When not feasible, a twist [linear; angular] about the origin on which no forces allowed do
        as much work as the wrench; the fastest contact point has the speed 1.
    message : str
    """

    feasible: bool
    forces: np.ndarray | None
    value: float
    sensitivity: np.ndarray | None
    force_prices: np.ndarray | None
    residual: float
    motion: np.ndarray | None
    message: str

    def __bool__(self) -> bool:
        return self.feasible


@dataclass(frozen=True, eq=False)
class _Problem:
    """A force problem in scaled numbers: wrenches scaled, forces in units of ``unit``.

    All forces that exert the wrench are ``some + null y``; ``bounds`` are those given [N].
    """

    contacts: Contacts
    objective: str
    W: np.ndarray
    wrench: np.ndarray
    least: np.ndarray
    limit: np.ndarray
    unit: float
    some: np.ndarray
    null: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]


def distribute_forces(
    contacts: Contacts,
    wrench: Any,
    *,
    minimum: Any = 0.0,
    objective: str = "largest",
    limit: Any = None,
) -> ForceDistribution:
    """Forces with which the contacts exert a wrench on the body.

    Parameters
    ----------
    contacts : Contacts
    wrench : array-like, shape (6,); (3,) in the plane
        What the contacts exert on the body: force [N] and moment [N m] about the frame's origin.
    minimum : float or array-like, shape (N,)
        Least push of each contact, not negative [N].
    objective : str
        ``largest``: the largest force is as small as can be, and among such forces the norm.
        ``norm``: the norm of the forces is as small as can be.
    limit : float or array-like, shape (N,), optional
        Largest push of each contact [N]; none when left out.

    Raises
    ------
    GraspError
        Numbers of the wrong shape, not finite or contradictory; an unknown objective.
    """
    if objective not in OBJECTIVES:
        raise GraspError(f"unknown objective {objective!r}; objectives are {', '.join(OBJECTIVES)}")
    least, most = bounds_of(contacts, minimum, limit)
    target = wrench_of(contacts, wrench)
    W = contacts.scaled_wrenches
    U, s, Vt = np.linalg.svd(W)
    rank = int(np.count_nonzero(s > BAND * s[0]))
    some = Vt[:rank].T @ ((U[:, :rank].T @ target) / s[:rank])
    missing = target - W @ some
    if np.linalg.norm(missing) > SLACK * np.linalg.norm(target):
        return _refused(contacts, twist_of(contacts, missing))
    unit = max(float(np.abs(some).max()), float(least.max()))
    if unit == 0.0:
        zero = np.zeros(contacts.count)
        flat = np.zeros(contacts.freedoms)
        return ForceDistribution(
            True, zero, 0.0, flat, zero, 0.0, None, "no wrench takes no forces"
        )
    problem = _Problem(
        contacts=contacts,
        objective=objective,
        W=W,
        wrench=target / unit,
        least=least / unit,
        limit=most / unit,
        unit=unit,
        some=some / unit,
        null=Vt[rank:].T,
        bounds=(least, most),
    )
    return _largest(problem) if objective == "largest" else _least_norm(problem)


def bounds_of(contacts: Contacts, minimum: Any, limit: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (N,), (N,) of the forces; without a limit, infinite ones.

    Raises
    ------
    GraspError
        Numbers that are none, negative, or of which the first exceeds the second.
    """
    least = _each(contacts, minimum, "minimum")
    most = _each(contacts, np.inf if limit is None else limit, "limit")
    if not np.all(np.isfinite(least)):
        raise GraspError(f"the minimum of a force must be finite, not {minimum!r}")
    if np.any(least < 0.0):
        raise GraspError(f"contacts only push: the minimum of a force is not negative: {minimum!r}")
    crossed = np.flatnonzero(least > most)
    if crossed.size:
        j = int(crossed[0])
        raise GraspError(
            f"{contacts.names[j]} cannot push at least {least[j]:g} N and at most {most[j]:g} N"
        )
    return least, most


def wrench_of(contacts: Contacts, wrench: Any) -> np.ndarray:
    """A wrench about the frame's origin in scaled coordinates, shape (6,) or (3,)."""
    try:
        given = np.asarray(wrench, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"a wrench is a list of numbers, not {wrench!r}") from error
    n, d = contacts.freedoms, contacts.dimension
    if given.shape != (n,) or not np.all(np.isfinite(given)):
        shape = "three finite numbers [fx, fy, m]" if d == 2 else "six finite numbers"
        raise GraspError(f"a wrench of these contacts is {shape}, not {wrench!r}")
    force, c = given[:d], contacts.centre
    shift = np.cross(c, force) if d == 3 else c[0] * force[1] - c[1] * force[0]
    return np.concatenate([force, (given[d:] - shift) / contacts.length])


def _each(contacts: Contacts, values: Any, what: str) -> np.ndarray:
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(
            f"the {what} of the forces is a number or {contacts.count} of them"
        ) from error
    if numbers.ndim > 1 or numbers.size not in (1, contacts.count) or np.isnan(numbers).any():
        raise GraspError(
            f"the {what} of the forces is a number or {contacts.count} of them, one for each "
            f"contact, not {values!r}"
        )
    return np.broadcast_to(numbers, (contacts.count,)).astype(float)


def _least_norm(problem: _Problem) -> ForceDistribution:
    """``|lam|^2 = |some|^2 + |y|^2``: the shortest y within the bounds."""
    solved = _shortest(problem, problem.least, problem.limit)
    if not solved.solved:
        return _infeasible(problem, solved.weights)
    lam = problem.some + problem.null @ solved.point
    norm = float(np.linalg.norm(lam))
    prices = _signed(problem, solved.prices)
    # lam = W^T slope + prices: the slope of |lam|^2 / 2
    slope = np.linalg.lstsq(problem.W.T, lam - prices, rcond=BAND)[0]
    return _found(problem, lam, norm, slope / norm, prices / norm)


def _largest(problem: _Problem) -> ForceDistribution:
    """The linear program for the largest force, then the least norm with that as the limit."""
    from scipy.optimize import linprog

    null, some, count = problem.null, problem.some, problem.contacts.count
    finite = np.isfinite(problem.limit)
    low, none = np.column_stack([-null, np.zeros(count)]), np.zeros(finite.sum())
    solved = linprog(
        np.append(np.zeros(null.shape[1]), 1.0),
        A_ub=np.vstack(
            [low, np.column_stack([null, -np.ones(count)]), np.column_stack([null[finite], none])]
        ),
        b_ub=np.concatenate([some - problem.least, -some, (problem.limit - some)[finite]]),
        bounds=(None, None),
    )
    if not solved.success:
        return _infeasible(problem, _shortest(problem, problem.least, problem.limit).weights)
    lam = some + null @ solved.x[:-1]
    paid = -solved.ineqlin.marginals
    prices = paid[:count].copy()
    prices[finite] -= paid[2 * count :]
    # the shares in the largest force are W^T slope + prices
    slope = np.linalg.lstsq(problem.W.T, paid[count : 2 * count] - prices, rcond=BAND)[0]
    within = np.minimum(np.maximum(problem.limit, lam), float(lam.max()))
    shortest = _shortest(problem, np.minimum(problem.least, lam), within)
    if shortest.solved:
        lam = some + null @ shortest.point
    return _found(problem, lam, float(lam.max()), slope, prices)


def _shortest(problem: _Problem, least: np.ndarray, limit: np.ndarray) -> LeastDistance:
    finite = np.isfinite(limit)
    G = np.vstack([problem.null, -problem.null[finite]])
    h = np.concatenate([least - problem.some, (problem.some - limit)[finite]])
    return least_distance(G, h - SLACK)


def _signed(problem: _Problem, weights: np.ndarray) -> np.ndarray:
    """Prices of minimum and limit as one number for each contact."""
    count = problem.contacts.count
    prices = weights[:count].copy()
    prices[np.isfinite(problem.limit)] -= weights[count:]
    return prices


def _found(
    problem: _Problem, lam: np.ndarray, value: float, slope: np.ndarray, prices: np.ndarray
) -> ForceDistribution:
    forces = np.clip(problem.unit * lam, *problem.bounds)
    missing = np.abs(problem.W @ forces - problem.unit * problem.wrench).max()
    named = "largest force" if problem.objective == "largest" else "norm of the forces"
    return ForceDistribution(
        feasible=True,
        forces=forces,
        value=problem.unit * value,
        sensitivity=about_origin(problem.contacts, slope),
        force_prices=prices,
        residual=float(missing),
        motion=None,
        message=f"the contacts exert the wrench; {named} {problem.unit * value:.4g} N",
    )


def _infeasible(problem: _Problem, weights: np.ndarray) -> ForceDistribution:
    """Weights that internal forces do not change are ``-W^T v``: forces fall short on v."""
    v = -np.linalg.lstsq(problem.W.T, _signed(problem, weights), rcond=BAND)[0]
    return _refused(problem.contacts, twist_of(problem.contacts, v))


def _refused(contacts: Contacts, motion: np.ndarray) -> ForceDistribution:
    message = (
        f"the contacts cannot exert the wrench with forces in their bounds: they cannot do as much "
        f"work as it does when the body can {motion_in_words(contacts, motion)}"
    )
    return ForceDistribution(False, None, np.inf, None, None, 0.0, motion, message)
