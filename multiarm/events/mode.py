"""A mode: what all unilateral constraints of a system do from now on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from multiarm.contacts.unilateral import Constraint
from multiarm.results.contact_states import ContactState


@dataclass(frozen=True)
class Mode:
    """What all constraints do: which rows hold, push and slide, and where to.

    Modes are equal that differ in their directions only.

    Attributes
    ----------
    states : tuple of ContactState
        By constraint; none of them before a run has begun.
    rows : tuple of int
        Their held rows, increasing.
    pulling : frozenset of int
        Bilateral constraints with friction whose normal force pulls, as far as it matters: their
        friction is the coefficient times minus that force.
    off_patch, below_patch : frozenset of int
        Open constraints off their patch, or below it, see :mod:`multiarm.events.event_detection`.
    holding : frozenset of int
        Timed joints that hold.
    directions : mapping
        Unit vectors of the slip of sliding constraints, by their numbers.
    """

    states: tuple[ContactState, ...]
    rows: tuple[int, ...]
    pulling: frozenset[int] = frozenset()
    off_patch: frozenset[int] = frozenset()
    below_patch: frozenset[int] = frozenset()
    holding: frozenset[int] = frozenset()
    directions: Mapping[int, np.ndarray] = field(default_factory=dict, compare=False)

    def side(self, u: int) -> int:
        """Sign of the normal force of a closed constraint: 1 where it pushes, -1 where it pulls."""
        return -1 if u in self.pulling else 1

    def sliding(self, constraints: tuple[Constraint, ...]) -> list[int]:
        """Numbers of the sliding constraints with a held normal row."""
        return [
            u
            for u, state in enumerate(self.states)
            if state in (ContactState.SLIDING, ContactState.AT_BOUND)
            and constraints[u].row in self.rows
            and constraints[u].tangents
        ]
