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

**Loads as users give them.**  A wrench is a force and a moment about the origin of the frame.
About the middle c of the contacts the moment is ``m - c cross f``; over the spread of the contacts
it compares with forces, as the scaled wrenches of the contacts do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.closure.balances import BAND, floor_of, rank_of
from multiarm.grasp.closure.motions import about_origin, motion_in_words, twist_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts, numbers_of
from multiarm.programs import LeastDistance, LinearSolution, least_distance, linear_program

OBJECTIVES = ("largest", "norm")
# Part of the wrench, the forces, the prices at hand that counts as nothing: rounding.
SLACK = 1e-9
# Below this s, least distances are long (1e4) or none: a linear program decides.
COARSE = 1e-8


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
        Difference between the wrench of ``forces`` and the requested one [N], moments over
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

    All forces that exert the wrench are ``some + null y``, but for the rounding ``blur`` of the
    entries of ``null``; ``bounds`` are those given [N].
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
    blur: float
    bounds: tuple[np.ndarray, np.ndarray]

    @property
    def room(self) -> float:
        """The tolerance of rounding in a bound of a force."""
        return min(self.blur, SLACK)


def distribute_forces(
    contacts: Contacts | HeldByContacts,
    wrench: Any,
    *,
    minimum: Any = 0.0,
    objective: str = "largest",
    limit: Any = None,
) -> ForceDistribution:
    """Forces with which the contacts exert a wrench on the body.

    Parameters
    ----------
    contacts : Contacts, or a grasp
    wrench : array-like, shape (6,); (3,) in the plane
        Wrench of the contacts on the body: force [N] and moment [N m] about the frame's origin.
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
    contacts = as_contacts(contacts)
    least, most = bounds_of(contacts, minimum, limit)
    target = wrench_of(contacts, wrench)
    some, null, missing = _any_forces(contacts, target)
    if missing is not None:
        return _refused(contacts, twist_of(contacts, missing))
    unit = max(float(np.abs(some).max()), float(least.max()))
    if unit == 0.0:
        none, flat = np.zeros(contacts.count), np.zeros(contacts.freedoms)
        words = "a wrench of zero takes no forces"
        return ForceDistribution(True, none, 0.0, flat, none, 0.0, None, words)
    problem = _Problem(
        contacts=contacts,
        objective=objective,
        W=contacts.scaled_wrenches,
        wrench=target / unit,
        least=least / unit,
        limit=most / unit,
        unit=unit,
        some=some / unit,
        null=null,
        blur=_blur(contacts),
        bounds=(least, most),
    )
    return _largest(problem) if objective == "largest" else _least_norm(problem)


def _any_forces(
    contacts: Contacts, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """``lam_0``, a basis of the internal forces, and the remainder of the wrench."""
    W = contacts.scaled_wrenches
    U, s, Vt = np.linalg.svd(W)
    floor = floor_of(contacts)
    rank = int(np.count_nonzero(s > (BAND + floor) * s[0]))
    some = Vt[:rank].T @ ((U[:, :rank].T @ target) / s[:rank])
    missing = target - W @ some
    rounded = floor * s[0] * np.linalg.norm(some)
    lost = np.linalg.norm(missing) > SLACK * np.linalg.norm(target) + rounded
    return some, Vt[rank:].T, missing if lost else None


def _blur(contacts: Contacts) -> float:
    """The rounding of a unit of internal forces: that of the wrenches over their least s.

    Rows of the basis that are smaller may be zero, and singular values of it too.
    """
    s = np.linalg.svd(contacts.scaled_wrenches, compute_uv=False)
    floor = floor_of(contacts)
    return float(floor * s[0] / s[rank_of(contacts) - 1])


def _least_norm(problem: _Problem) -> ForceDistribution:
    """``|lam|^2 = |some|^2 + |y|^2``: the shortest y within the bounds."""
    scale, solved = 1.0, _shortest(problem)
    if solved.s < COARSE:
        program = _program(problem)
        if program.x is None:
            return _infeasible(problem, solved.weights)
        lam = problem.some + problem.null @ program.x[:-1]
        scale = float(lam.max())
        solved = _shortest(problem, lam)
    prices = np.zeros(len(problem.some))
    if solved.s > COARSE:
        lam = problem.some + scale * problem.null @ solved.point
        prices = scale * _signed(problem, solved.prices)
    norm = float(np.linalg.norm(lam))
    # lam = W^T slope + prices: the slope of |lam|^2 / 2
    slope = np.linalg.lstsq(problem.W.T, lam - prices, rcond=BAND)[0]
    return _found(problem, lam, norm, slope / norm, prices / norm)


def _largest(problem: _Problem) -> ForceDistribution:
    """The linear program for the largest force, then the least norm with that as the limit."""
    program = _program(problem)
    if program.x is None:
        return _infeasible(problem, _shortest(problem).weights)
    bounded, paid, count = np.isfinite(problem.limit), program.prices, len(problem.some)
    shares, prices = paid[count : 2 * count], paid[:count].copy()
    prices[bounded] -= paid[2 * count :]
    # the shares in the largest force are W^T slope + prices
    slope = np.linalg.lstsq(problem.W.T, shares - prices, rcond=BAND)[0]
    lam = problem.some + problem.null @ program.x[:-1]
    nothing = SLACK + problem.blur
    lam = _calmed(problem, lam, (np.abs(prices) > nothing) | (shares > nothing))
    return _found(problem, lam, float(lam.max()), slope, prices)


def _calmed(problem: _Problem, lam: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The least norm among forces no larger than the largest, of which some are ``held``.

    A force with a price is the same in all optima; the others have room, which the least distance
    needs.
    """
    _, s, Vt = np.linalg.svd(problem.null[held])
    basis = problem.null @ Vt[int(np.count_nonzero(s > BAND + problem.blur)) :].T
    scale, rest = float(lam.max()), ~held
    shortest = lam - basis @ (basis.T @ lam)
    least, most = np.minimum(problem.least, lam), np.minimum(np.maximum(problem.limit, lam), scale)
    G = np.vstack([basis[rest], -basis[rest]])
    h = np.concatenate([(least - shortest)[rest], (shortest - most)[rest]])
    solved = least_distance(G, h / scale, problem.room)
    if solved.s < COARSE:
        return lam
    found, room = shortest + scale * basis @ solved.point, 2.0 * SLACK * scale
    return found if np.all((found >= least - room) & (found <= most + room)) else lam


def _program(problem: _Problem) -> LinearSolution:
    """Minimise the largest force t over ``[y; t]``: rows for minima, for t, and for limits."""
    null, some, bounded = problem.null, problem.some, np.isfinite(problem.limit)
    rows = [(-null, 0.0), (null, -1.0), (null[bounded], 0.0)]
    A = np.vstack([np.column_stack([a, np.full(len(a), b)]) for a, b in rows])
    b = np.concatenate([some - problem.least, -some, (problem.limit - some)[bounded]])
    cost = np.append(np.zeros(null.shape[1]), 1.0)
    return linear_program(cost, at_most=(A, b), signed=len(cost))


def _shortest(problem: _Problem, within: np.ndarray | None = None) -> LeastDistance:
    """The shortest y within the bounds; if forces are known that meet them, in their unit.

    These meet the bounds to the tolerance of a linear program, to which the bounds give way.
    """
    least, limit, scale = problem.least, problem.limit, 1.0
    if within is not None:
        least, limit = np.minimum(least, within), np.maximum(limit, within)
        scale = float(within.max())
    bounded = np.isfinite(limit)
    G = np.vstack([problem.null, -problem.null[bounded]])
    h = np.concatenate([least - problem.some, (problem.some - limit)[bounded]])
    return least_distance(G, h / scale, problem.room)


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


# --- Loads and bounds as users give them ----------------------------------------------------------


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
    d = contacts.dimension
    numbers = "three finite numbers [fx, fy, m]" if d == 2 else "six finite numbers"
    given = numbers_of(wrench, f"a wrench of these contacts is {numbers}", (contacts.freedoms,))
    force, c = given[:d], contacts.centre
    shift = np.cross(c, force) if d == 3 else c[0] * force[1] - c[1] * force[0]
    return np.concatenate([force, (given[d:] - shift) / contacts.length])


def _each(contacts: Contacts, values: Any, what: str) -> np.ndarray:
    count = contacts.count
    needed = f"the {what} of the forces is a number or {count} of them, one for each contact"
    numbers = numbers_of(values, needed, (), (1,), (count,), infinite=True)
    return np.broadcast_to(numbers, (count,)).copy()
