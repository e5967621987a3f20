r"""Contact forces that exert a given wrench: how hard each finger has to push.

The contacts exert the wrench :math:`w = [f; m]` on the body (force, and moment about the origin of
the frame) with the forces :math:`\lambda`, each of which can only push:

.. math::
    W \lambda = w, \qquad \lambda_{\min} \le \lambda \le \lambda_{\max} .

To carry a body of weight G, the contacts exert the wrench opposite to gravity's.  Among all such
forces, those are taken whose largest is smallest (of these, the ones of least norm), or those of
least norm :math:`|\lambda|` at once (:mod:`multiarm.dynamics.forces.distribution`).

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

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiarm.dynamics.forces.distribution import (
    SLACK,
    BoundedForces,
    forces_for,
    least_norm,
    smallest_largest,
)
from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of
from multiarm.grasp.closure.balances import BAND, floor_of, rank_of
from multiarm.grasp.closure.motions import about_origin, motion_in_words, twist_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts

OBJECTIVES = {"largest": smallest_largest, "norm": least_norm}


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
        Where it has a kink, one of the slopes.  None where rounding hides the least norm.
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
    if objective not in tuple(OBJECTIVES):
        raise GraspError(f"unknown objective {objective!r}; objectives are {', '.join(OBJECTIVES)}")
    contacts = as_contacts(contacts)
    least, most = bounds_of(contacts, minimum, limit)
    target = wrench_of(contacts, wrench)
    W, floor = contacts.scaled_wrenches, floor_of(contacts)
    family, missing = forces_for(W, target, BAND + floor)
    size = np.linalg.norm(target), np.linalg.norm(family.least_norm)
    s = np.linalg.svd(W, compute_uv=False)
    if np.linalg.norm(missing) > SLACK * size[0] + floor * s[0] * size[1]:
        return _refused(contacts, missing)
    unit = max(float(np.abs(family.least_norm).max()), float(least.max()))
    if unit == 0.0:
        none, flat = np.zeros(contacts.count), np.zeros(contacts.freedoms)
        words = "a wrench of zero takes no forces"
        return ForceDistribution(True, none, 0.0, flat, none, 0.0, None, words)
    problem = BoundedForces(
        W=W,
        family=replace(family, least_norm=family.least_norm / unit),
        least=least / unit,
        limit=most / unit,
        tolerance=BAND,
        blur=float(floor * s[0] / s[rank_of(contacts) - 1]),
    )
    best = OBJECTIVES[objective](problem)
    if best.forces is None:
        return _refused(contacts, best.slope)
    forces = np.clip(unit * best.forces, least, most)
    value = unit * best.value
    quantity = "largest force" if objective == "largest" else "norm of the forces"
    hidden = "; rounding hides the least norm, and these are forces whose largest is smallest"
    rounded = "" if best.optimal else hidden
    return ForceDistribution(
        feasible=True,
        forces=forces,
        value=value,
        sensitivity=about_origin(contacts, best.slope) if best.optimal else None,
        force_prices=best.prices if best.optimal else None,
        residual=float(np.abs(W @ forces - target).max()),
        motion=None,
        message=f"the contacts exert the wrench; {quantity} {value:.4g} N{rounded}",
    )


def _refused(contacts: Contacts, direction: np.ndarray) -> ForceDistribution:
    motion = twist_of(contacts, direction)
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
        No numbers, negative ones, or a minimum above its limit.
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
    values = numbers_of(wrench, f"a wrench of these contacts is {numbers}", (contacts.freedoms,))
    force, c = values[:d], contacts.centre
    shift = np.cross(c, force) if d == 3 else c[0] * force[1] - c[1] * force[0]
    return np.concatenate([force, (values[d:] - shift) / contacts.length])


def _each(contacts: Contacts, values: Any, what: str) -> np.ndarray:
    count = contacts.count
    needed = f"the {what} of the forces is a number or {count} of them, one for each contact"
    numbers = numbers_of(values, needed, (), (1,), (count,), infinite=True)
    return np.broadcast_to(numbers, (count,)).copy()
