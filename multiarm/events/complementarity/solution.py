"""What the complementarity problem says will happen, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from multiarm.events.complementarity.units import Mode


class Verdict(str, Enum):
    """How many motions there are."""

    UNIQUE = "unique"
    """One, proven: there is no friction, or its response is adequate, or all modes were tried."""
    FOUND = "found"
    """At least one; that there is no other was neither proven nor is there a sign against it."""
    SEVERAL = "not unique"
    """Several: the one with the smallest forces is given, the others are the alternatives."""
    NONE = "none"
    """None, or none was found; what is given is the nearest to one, and the words say which."""


@dataclass(frozen=True)
class Alternative:
    """Another solution with another motion.

    Attributes
    ----------
    forces, rates : ndarray, shape (m,)
        As in :class:`Solution`.
    modes : tuple of Mode
        What each unit does.
    """

    forces: np.ndarray
    rates: np.ndarray
    modes: tuple[Mode, ...]


@dataclass(frozen=True)
class Solution:
    """Forces and rates of all rows, and what each unit does from now on.

    Attributes
    ----------
    forces : ndarray, shape (m,)
        ``x`` [N] or [N m], or impulses [N s] or [N m s]. Where they are not determined, those of
        least norm in these units, as they are, among those that obey the laws: over the rows of
        units without friction at its bound, and over the normal rows of units with it there.
    rates : ndarray, shape (m,)
        ``y = D x + b``: accelerations, or velocities after an impact.
    modes : tuple of Mode
        One for each unit.
    directions : ndarray, shape (units, 2)
        Unit vector of the slip of units that slide; zero for all others.
    rows : tuple of int
        Rows to hold from now on, increasing. The forces of least norm that keep their rates at zero
        (with friction tied to the normal force of units that slide, and bounds as constants) are
        ``forces``: they obey the laws with a margin, and the motion is that of all rows.
    forces_unique : bool
        Whether the rows in contact are independent, so that the motion determines all forces.
    residual : float
        Largest violation of any law, as a part of the largest sum of absolute terms in any rate,
        both in rows scaled by the root of their response: dimensionless.
    verdict : Verdict
        How many motions there are.
    alternatives : tuple of Alternative
        Other motions, when there are several.
    words : str
        What to tell: the name of the trouble, and where; empty when there is none.
    gains : float or None
        Of an impact whose velocities before were given: kinetic energy that the impulses add [J],
        negative when they take some. Newton's restitution with friction can add energy; the caller
        decides what to do about it.
    """

    forces: np.ndarray
    rates: np.ndarray
    modes: tuple[Mode, ...]
    directions: np.ndarray
    rows: tuple[int, ...]
    forces_unique: bool
    residual: float
    verdict: Verdict
    alternatives: tuple[Alternative, ...]
    words: str
    gains: float | None
