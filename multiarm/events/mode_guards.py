"""The guards of modes: all that the modes of a system can have, and those of one of them.

A constraint needs few guards, whatever it does; they are made once.  Where a mode is entered, those
that it needs are copied into one table.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, Constraint
from multiarm.dynamics.contact_geometry import patch_of
from multiarm.dynamics.guards import (
    CONE_GUARD,
    GAP_GUARD,
    HOLD_GUARD,
    LIFT_GUARD,
    ONSET_GUARD,
    PATCH_GUARD,
    PUSH_GUARD,
    RATE_GUARD,
    REST_GUARD,
    SLIP_GUARD,
    SPRING_GUARD,
    Guard,
    Guards,
    make_guards,
)
from multiarm.dynamics.model import Model
from multiarm.events.mode import Mode
from multiarm.jit.structs import struct_of
from multiarm.results.channels import ContactState

# Thresholds above which a guard that was at zero when the mode began counts as positive: gaps [m],
# speeds [m/s, rad/s], and forces as a part of the largest one.
GAP_THRESHOLD, SPEED_THRESHOLD, FORCE_THRESHOLD = 1e-10, 2e-8, 1e-9
# Largest gap or penetration of contacts that touch without force [m].
REST = 1e-9

# Guards of a constraint by kind, and 1 or -1: the sign, of cones that of the normal force.
OfConstraint = dict[tuple[int, int], Guard]


class ModeGuards:
    """All guards that the modes of a system can have.

    They watch rows among all rows, and sliding constraints by their numbers.

    Attributes
    ----------
    struct : ndarray of int64
        Of all of them.
    table : Guards
        Room for those of a mode; its ``direction`` is that of the sliding contacts.
    """

    def __init__(self, model: Model, slow: float, direction: np.ndarray) -> None:
        assert model.unilateral is not None, "a system with unilateral contacts"
        self._constraints = model.unilateral.constraints
        # what a slip that has just come to rest may have left; faster contacts at the bound slip
        still = max(SPEED_THRESHOLD, 0.01 * slow)
        guards: list[Guard] = []
        self._numbers: list[dict[tuple[int, int], int]] = []
        for u, constraint in enumerate(self._constraints):
            of_constraint = _guards(u, constraint, still)
            patch = patch_of(model, constraint)
            if patch is not None and not constraint.compliant:
                of_constraint |= _at_edge(constraint, len(model.arm_names), patch)
            self._numbers.append({key: len(guards) + k for k, key in enumerate(of_constraint)})
            guards += [guard._replace(constraint=u) for guard in of_constraint.values()]
        self._all = make_guards(guards, direction)
        self.struct = struct_of(self._all)
        columns = (column.copy() for column in self._all)
        self.table = Guards(*columns)._replace(direction=direction)

    def numbers(self, mode: Mode, place: np.ndarray, sliding: list[int]) -> np.ndarray:
        """Numbers of the guards of a mode; ``place`` (N,) are those of the held rows, or -1."""
        held, numbers = (place >= 0).tolist(), []
        for u, (constraint, number) in enumerate(
            zip(self._constraints, self._numbers, strict=True)
        ):
            keys = _keys(u, constraint, mode, held, u in sliding)
            if (PATCH_GUARD, 1) in number:
                keys = _keys_at_edge(u, mode, keys)
            numbers += [number[key] for key in keys]
        return np.array(numbers, dtype=np.int64)


def _guards(u: int, constraint: Constraint, still: float) -> OfConstraint:
    """All guards that a constraint can have without a patch."""
    row, tangents = constraint.row, constraint.tangents
    if constraint.compliant:
        return {
            (SPRING_GUARD, sign): Guard(SPRING_GUARD, row, constraint.lag, GAP_THRESHOLD, sign=sign)
            for sign in (1, -1)
        }
    if constraint.kind == DRY_JOINT:
        limit = FORCE_THRESHOLD * constraint.bound
        return {
            (HOLD_GUARD, 1): Guard(HOLD_GUARD, row, constraint.bound, limit),
            **{
                (RATE_GUARD, sign): Guard(RATE_GUARD, constraint.joint, threshold=still, sign=sign)
                for sign in (1, -1)
            },
        }
    guards = {
        (GAP_GUARD, 1): Guard(GAP_GUARD, row, threshold=GAP_THRESHOLD),
        (REST_GUARD, 1): Guard(REST_GUARD, row, REST),
        (LIFT_GUARD, 1): Guard(LIFT_GUARD, row, REST),
        (PUSH_GUARD, 1): Guard(PUSH_GUARD, row, threshold=FORCE_THRESHOLD),
    }
    if tangents:
        pair = tangents[0], tangents[1]
        guards[ONSET_GUARD, 1] = Guard(ONSET_GUARD, tangents[0], still)
        guards[SLIP_GUARD, 1] = Guard(SLIP_GUARD, u, threshold=still, tangents=pair)
        for side in (1, -1) if constraint.bilateral else (1,):
            mu = side * constraint.mu
            guards[PUSH_GUARD, side] = Guard(PUSH_GUARD, row, threshold=FORCE_THRESHOLD, sign=side)
            guards[CONE_GUARD, side] = Guard(CONE_GUARD, row, mu, FORCE_THRESHOLD, pair)
    return guards


def _at_edge(constraint: Constraint, body: int, patch: np.ndarray) -> OfConstraint:
    """Further guards of a contact with a patch on a body."""
    # a spring without damping: its extension is the gap
    below = Guard(SPRING_GUARD, constraint.row, threshold=GAP_THRESHOLD, sign=-1)
    edge = Guard(PATCH_GUARD, constraint.row, threshold=GAP_THRESHOLD, body=body, patch=patch)
    return {
        (SPRING_GUARD, -1): below,
        **{(PATCH_GUARD, sign): edge._replace(sign=sign) for sign in (1, -1)},
    }


def _keys(
    u: int, constraint: Constraint, mode: Mode, held: list[bool], slides: bool
) -> list[tuple[int, int]]:
    """The guards of a constraint in a mode, without those of its patch."""
    state, closed = mode.states[u], held[constraint.row]
    if constraint.compliant:
        return [(SPRING_GUARD, 1 if state == ContactState.OPEN else -1)]
    if constraint.kind == DRY_JOINT:
        if state.moves:
            return [(RATE_GUARD, 1 if state == ContactState.FORWARD else -1)]
        return [(HOLD_GUARD, 1)] if closed else []
    if state == ContactState.OPEN:
        return [(GAP_GUARD, 1)]
    if not closed:
        return [(REST_GUARD, 1), (LIFT_GUARD, 1)]
    side, tangents = mode.side(u), [held[t] for t in constraint.tangents]
    keys = []
    if not constraint.bilateral or slides:
        keys.append((PUSH_GUARD, side))
    if state == ContactState.STICKING and any(tangents):
        keys.append((CONE_GUARD, side))
    resting = constraint.bilateral and not slides and not all(tangents)
    if state == ContactState.AT_BOUND or resting:
        keys.append((ONSET_GUARD, 1))
    elif slides:
        keys.append((SLIP_GUARD, 1))
    return keys


def _keys_at_edge(u: int, mode: Mode, keys: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The guards of a contact that is on its patch, over it, off it or below it."""
    if u in mode.off_patch:
        return [(PATCH_GUARD, -1)]
    if u in mode.below_patch:
        return [(PATCH_GUARD, 1), (SPRING_GUARD, -1)]
    return [*keys, (PATCH_GUARD, 1)]
