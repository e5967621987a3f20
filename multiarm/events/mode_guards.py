"""The guards of modes: all that the modes of a system can have, and those of one of them.

A constraint needs few guards, whatever it does; they are made once.  Where a mode is entered, those
that it needs are copied into one table.
"""

from __future__ import annotations

import math
from collections.abc import Set
from functools import partial
from numbers import Real

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, LIMIT, Constraint
from multiarm.dynamics.callbacks import UserCallback
from multiarm.dynamics.contact_geometry import patch_of
from multiarm.dynamics.data import Data
from multiarm.dynamics.guard_functions import (
    FrictionCone,
    JointSpeed,
    OpenGap,
    PatchDepth,
    PushingForce,
    Slip,
    SlipOnset,
    SpringCompression,
    SpringExtension,
    StaticFriction,
    Touch,
    UserFunction,
)
from multiarm.dynamics.guards import FORCES, JOINT_FORCES, SHARED, Guard, Guards, make_guards
from multiarm.errors import ControlError
from multiarm.events.mode import Mode
from multiarm.jit.structs import struct_of
from multiarm.results.contact_states import ContactState
from multiarm.scene.faults import shown
from multiarm.scene.joints.times import When

# Thresholds above which a guard that was at zero when the mode began counts as positive: gaps [m],
# speeds [m/s, rad/s], and parts of the largest forces, those of dry friction of its bound.
GAP_THRESHOLD, SPEED_THRESHOLD, FORCE_THRESHOLD = 1e-10, 2e-8, 1e-9
# Largest gap or penetration of contacts that touch without force [m].
TOUCHING_GAP = 1e-9

# What a guard of a constraint watches, and 1 or -1: its sign, of cones that of the normal force.
Key = tuple[type, int]
# A timed joint, and which of its moments.
MomentNumber = tuple[int, int]


def rest_speed(slow: float) -> float:
    """What a slip that has just come to rest may have left [m/s], see ``slow`` of the modes."""
    return max(SPEED_THRESHOLD, 0.01 * slow)


class ModeGuards:
    """All guards that the modes of a system can have.

    Attributes
    ----------
    all : list of Guard
    struct : ndarray of int64
        Of their table.
    table : Guards
        Room for those of a mode.
    """

    def __init__(self, data: Data, slow: float, directions: np.ndarray) -> None:
        model = data.model
        assert model.unilateral is not None, "a system with unilateral contacts"
        self._unilateral = model.unilateral
        self._constraints = model.unilateral.constraints
        still = rest_speed(slow)  # faster contacts at the bound slip
        self.all: list[Guard] = []
        self._numbers: list[dict[Key, int]] = []
        for u, constraint in enumerate(self._constraints):
            of_constraint = _guards(u, constraint, still)
            if constraint.tangents:
                tangent = constraint.tangents[0]
                block = model.layout.block_of_contact(tangent)
                of_constraint[Slip, 1] = Guard(Slip(tangent, block, u, directions), still)
            patch = patch_of(model, constraint)
            if patch is not None and not constraint.compliant:
                depth = PatchDepth(constraint.row, model.world_number, patch)
                of_constraint |= _at_edge(depth)
            first = len(self.all)
            self._numbers.append({key: first + k for k, key in enumerate(of_constraint)})
            self.all += [guard._replace(constraint=u) for guard in of_constraint.values()]
        self.of_moments = self._guards_of_moments(data)
        rows, slides = [-1] * model.layout.contacts, [-1] * len(self._constraints)
        of_all = make_guards(self.all, rows, slides)
        shared = {name: getattr(of_all, name) for name in SHARED}
        self.table = Guards(*(column.copy() for column in of_all))._replace(**shared)
        self._of_all = of_all
        self.struct = struct_of(of_all)

    def _guards_of_moments(self, data: Data) -> dict[MomentNumber, int]:
        """Guards of the functions that begin and end the times of joints, by the moments."""
        numbers: dict[MomentNumber, int] = {}
        for k, joint in enumerate(self._unilateral.timed):
            for place, when in enumerate(joint.moments):
                if isinstance(when, When):
                    value, function = np.zeros(1), when.when
                    name = f"'when' of joint '{joint.connection}'"
                    callback = UserCallback(
                        function, name, partial(_number, name), value, data.model.layout,
                        data.arrays, function,
                    )  # fmt: skip
                    data.callbacks[f"{name}, {place}"] = callback
                    data.shared.calls.add(callback)
                    numbers[k, place] = len(self.all)
                    self.all.append(Guard(UserFunction(callback.address, value)))
        return numbers

    def place(self, rows: np.ndarray, sliding: list[int]) -> np.ndarray:
        """Write which rows are held and which constraints slide; returns the place of each row."""
        held, slides = self.table.held, self.table.slides
        held[:] = slides[:] = -1
        held[rows] = np.arange(rows.size)
        slides[sliding] = np.arange(len(sliding))
        return held

    def first(self, count: int) -> Guards:
        """The table of some guards, the first ones in the room for them."""
        columns = self.table._asdict()
        return self.table._replace(
            **{name: column[:count] for name, column in columns.items() if name not in SHARED}
        )

    def numbers(
        self, mode: Mode, rows: np.ndarray, sliding: list[int], awaited: Set[MomentNumber]
    ) -> np.ndarray:
        """Numbers of the guards of a mode with these held rows and sliding constraints.

        Those of the ``awaited`` moments that functions tell are last.
        """
        held, numbers = np.isin(np.arange(self.table.held.size), rows).tolist(), []
        idle = self._unilateral.idle_without(mode.holding)
        for u, (constraint, number) in enumerate(
            zip(self._constraints, self._numbers, strict=True)
        ):
            if u in idle:
                continue
            keys = _keys(u, constraint, mode, held, u in sliding)
            if (PatchDepth, 1) in number:
                keys = _keys_at_edge(u, mode, keys)
            numbers += [number[key] for key in keys]
        numbers += [guard for moment, guard in self.of_moments.items() if moment in awaited]
        return np.array(numbers, dtype=np.int64)


def _guards(u: int, constraint: Constraint, still: float) -> dict[Key, Guard]:
    """All guards that a constraint can have without a patch, but that of its slip."""
    row, tangents = constraint.row, constraint.tangents
    if constraint.compliant:
        return {
            (length, 1): Guard(length(row, constraint.lag), GAP_THRESHOLD)
            for length in (SpringExtension, SpringCompression)
        }
    if constraint.kind == DRY_JOINT:
        friction = StaticFriction(row, constraint.bound)
        speed = JointSpeed(constraint.joint)
        return {
            (StaticFriction, 1): Guard(friction, FORCE_THRESHOLD * constraint.bound),
            **{(JointSpeed, sign): Guard(speed, still, sign) for sign in (1, -1)},
        }
    scale = JOINT_FORCES if constraint.kind == LIMIT else FORCES
    guards = {
        (OpenGap, 1): Guard(OpenGap(row), GAP_THRESHOLD),
        (Touch, 1): Guard(Touch(row, TOUCHING_GAP)),
        (PushingForce, 1): Guard(PushingForce(row), FORCE_THRESHOLD, scale=scale),
    }
    if tangents:
        guards[SlipOnset, 1] = Guard(SlipOnset(tangents[0], still))
        for side in (1, -1) if constraint.bilateral else (1,):
            cone = FrictionCone(row, side * constraint.mu, *tangents)
            guards[PushingForce, side] = Guard(
                PushingForce(row), FORCE_THRESHOLD, side, scale=scale
            )
            guards[FrictionCone, side] = Guard(cone, FORCE_THRESHOLD, scale=scale)
    return guards


def _at_edge(depth: PatchDepth) -> dict[Key, Guard]:
    """Further guards of a contact with a patch on a body."""
    return {
        **{(PatchDepth, sign): Guard(depth, GAP_THRESHOLD, sign) for sign in (1, -1)},
        # it comes up through the patch
        (SpringCompression, 1): Guard(SpringCompression(depth.row, 0.0), GAP_THRESHOLD),
    }


def _keys(u: int, constraint: Constraint, mode: Mode, held: list[bool], slides: bool) -> list[Key]:
    """The guards of a constraint in a mode, without those of its patch."""
    state, closed = mode.states[u], held[constraint.row]
    if constraint.compliant:
        return [(SpringExtension if state == ContactState.OPEN else SpringCompression, 1)]
    if constraint.kind == DRY_JOINT:
        if state.moves:
            return [(JointSpeed, 1 if state == ContactState.FORWARD else -1)]
        return [(StaticFriction, 1)] if closed else []
    if state == ContactState.OPEN:
        return [(OpenGap, 1)]
    if not closed:
        return [(Touch, 1)]
    side, tangents = mode.side(u), [held[t] for t in constraint.tangents]
    keys: list[Key] = []
    if not constraint.bilateral or slides:
        keys.append((PushingForce, side))
    if state == ContactState.STICKING and any(tangents):
        keys.append((FrictionCone, side))
    resting = constraint.bilateral and not slides and not all(tangents)
    if state == ContactState.AT_BOUND or resting:
        keys.append((SlipOnset, 1))
    elif slides:
        keys.append((Slip, 1))
    return keys


def _keys_at_edge(u: int, mode: Mode, keys: list[Key]) -> list[Key]:
    """The guards of a contact that is on its patch, over it, off it or below it."""
    if u in mode.off_patch:
        return [(PatchDepth, -1)]
    if u in mode.below_patch:
        return [(PatchDepth, 1), (SpringCompression, 1)]
    return [*keys, (PatchDepth, 1)]


def _number(name: str, value: object) -> np.ndarray:
    """The value of a function that tells a moment, (1,)."""
    if isinstance(value, Real) and math.isfinite(value):
        return np.array([float(value)])
    raise ControlError(f"{name} must return a finite number, it returned {shown(value)}")
