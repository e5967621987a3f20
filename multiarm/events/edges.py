"""Contacts at the edge of a table top: over it, beside it, or below.

A contact that has left its patch is *beside* it and meets nothing, however low it is; what brings
it back over the patch or under it is an event that is not told.  One that is under the patch is
*below*: it meets nothing until it is beside it again, or has come up through it.
"""

from __future__ import annotations

from collections.abc import Set

from multiarm.contacts.kernel import GAP
from multiarm.dynamics.contact_geometry import patch_margin
from multiarm.events.modes import GAP_THRESHOLD, Choice, Modes

# Gaps that are below the patch and not closed [m].
BELOW = 1e-8


def beside_constraints(modes: Modes, before: Choice, crossed: Set[int]) -> frozenset[int]:
    """Units whose contacts are beside their patches from now on, at the state in the data.

    One that has just ``crossed`` an edge is on it: from now on it is on the other side.
    """
    found = set()
    for u, constraint in enumerate(modes.unilateral.constraints):
        margin = patch_margin(modes.full, constraint)
        beside = margin < 0.0
        if u in crossed or abs(margin) <= GAP_THRESHOLD:
            beside = (u in before.beside) != (u in crossed)
        if beside:
            found.add(u)
    return frozenset(found)


def below_constraints(modes: Modes, others: Set[int]) -> frozenset[int]:
    """Units whose contacts are below their patches; ``others`` are known not to be."""
    gaps = modes.full.arrays.contacts[:, GAP]
    return frozenset(
        u
        for u, constraint in enumerate(modes.unilateral.constraints)
        if u not in others
        and gaps[constraint.row] < -BELOW
        and patch_margin(modes.full, constraint) != float("inf")
    )
