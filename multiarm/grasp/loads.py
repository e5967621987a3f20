r"""Loads and bounds of forces as users give them: checked, and in scaled coordinates.

A wrench is a force and a moment about the origin of the frame.  About the middle c of the contacts
the moment is ``m - c cross f``; over the spread of the contacts it compares with forces, as the
scaled wrenches of the contacts do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts


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
