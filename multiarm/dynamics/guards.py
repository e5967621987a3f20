"""Guards: signed functions that are positive as long as a mode holds, or a motion is in its range.

A guard that *stops* the run belongs to a mode of unilateral contacts: where it becomes negative,
the mode ends.  One that only *reports* watches what the model does not enforce: contacts that are
pulled or leave the patch of their surface, joints that pass their limits, drives at theirs.  It
turns round at every event, and so reports the end of what it has reported, too.

What a guard watches is a record of :mod:`multiarm.dynamics.guard_functions`; the table here has
what all guards have.  Guards are checked at the end of every step; those of forces and drives also
at its stages, and those with a rate by a cubic between its ends.  Where one has changed its sign,
the time of the event is found on the step's dense output
(:mod:`multiarm.integration.event_location`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.guard_functions import (
    KINDS,
    force_function,
    guard_function,
    is_force_function,
)
from multiarm.dynamics.solver.bounds import LEAST_ACCELERATION
from multiarm.jit.kernels import copy, greatest, inlined, kernel, larger, plain
from multiarm.jit.structs import WIDTH, Floats1, Ints1, struct_of, view

# Result of a guard for a step: no event, a sign change, perhaps two sign changes.
QUIET, FIRED, DIPPED = range(3)
# A minimum within a step below this part of both its ends may be zero: the cubic is a guess.
NEAR_ZERO = 0.05

# What a threshold is a part of, by its place in ``Guards.scales``: 1 in the unit of the value; the
# largest force of a contact and on the object since the run began [N]; that in a joint, too [N m].
# At one instant all forces may vanish.
UNIT, FORCES, JOINT_FORCES, SCALES = range(4)


class Guard(NamedTuple):
    """One guard: its sign times a function.

    Attributes
    ----------
    function : NamedTuple
        Of :data:`multiarm.dynamics.guard_functions.KINDS`.
    threshold : float
        Of one that stops: if it was at zero when the mode began, it counts as positive above this.
        One that reports changes its sign beyond this only.
    sign : int
        1 where the function falls through zero at the next event, -1 where it rises; 0: nothing is
        watched.
    stops : bool
        It ends a mode, and with it the step; or it only reports.
    scale : int
        What the threshold is a part of: ``UNIT``, ``FORCES`` or ``JOINT_FORCES``.
    constraint : int
        Of the scene's unilateral constraints; -1: one that reports.
    """

    function: Any
    threshold: float = 0.0
    sign: int = 1
    stops: bool = True
    scale: int = UNIT
    constraint: int = -1


class Guards(NamedTuple):
    """A table of g guards."""

    records: Ints1  # struct of what the functions depend on, one record after the other
    held: Ints1  # number of every row among the held ones; -1: not held
    slides: Ints1  # number of every constraint among those that slide
    # (SCALES,) what thresholds are parts of: of accepted steps, and with the state evaluated last
    scales: Floats1
    scales_now: Floats1
    kind: Ints1  # number of the function among all kinds
    place: Ints1  # of the guard's record among all
    sign: Ints1
    stops: Ints1
    threshold: Floats1
    scale: Ints1
    # value, course and rate (see multiarm.dynamics.guard_functions) at the state evaluated last;
    # value and rate at the end of the last step; the least value at the stages of this step
    value: Floats1
    course: Floats1
    rate: Floats1
    before: Floats1
    rate_before: Floats1
    least: Floats1
    level: Floats1  # the threshold in the unit of the value
    armed: Ints1  # whether it has been positive in this mode, or since the last event
    result: Ints1  # for the last step


SHARED = ("records", "held", "slides", "scales", "scales_now")
"""Those of a table's arrays that have no entry for every guard."""
open_guards = view(Guards)


def make_guards(
    guards: Sequence[Guard], held: Sequence[int] = (), slides: Sequence[int] = ()
) -> Guards:
    """The table of some guards; arrays of their records must live as long as it does."""
    g = len(guards)
    records = [struct_of(guard.function) for guard in guards]
    first = np.cumsum([0, *(len(record) // WIDTH for record in records)])[:g]
    integers = ("sign", "stops", "scale")
    numbers = ("value", "course", "rate", "before", "rate_before", "level")
    return Guards(
        records=np.concatenate([np.zeros(0, dtype=np.int64), *records]),
        held=np.array(held, dtype=np.int64),
        slides=np.array(slides, dtype=np.int64),
        scales=np.eye(SCALES)[UNIT],
        scales_now=np.eye(SCALES)[UNIT],
        kind=np.array([KINDS.index(type(guard.function)) for guard in guards], dtype=np.int64),
        place=first.astype(np.int64),
        **{n: np.array([getattr(guard, n) for guard in guards], dtype=np.int64) for n in integers},
        threshold=np.array([guard.threshold for guard in guards], dtype=float),
        **{name: np.zeros(g) for name in numbers},
        least=np.full(g, np.inf),
        armed=np.zeros(g, dtype=np.int64),
        result=np.zeros(g, dtype=np.int64),
    )


def reset_guards(guards: Guards) -> None:
    """Begin a run inside of all ranges."""
    guards.sign[:], guards.armed[:] = 1, 0
    guards.before[:] = guards.rate_before[:] = np.nan
    forget_forces(guards)


def forget_forces(guards: Guards) -> None:
    """Let thresholds be parts of the forces from now on."""
    for scales in (guards.scales, guards.scales_now):
        scales[:] = 0.0
        scales[UNIT] = 1.0


def turn_round(guards: Guards, g: int) -> None:
    """Let a guard watch for the end of what it has reported, from the end of the last step on."""
    guards.sign[g] *= -1
    guards.before[g] *= -1.0
    guards.rate_before[g] *= -1.0
    guards.armed[g] = guards.before[g] > guards.level[g]


@inlined
def follow_scales(scales, now, data):
    """Write what the scales are with the forces at the state evaluated last.

    They are at least what gives any object the acceleration ``LEAST_ACCELERATION``.  Forces that
    are not finite, of a state that cannot be evaluated, have no part in them.  Those of modes that
    are only tried, and of steps that are not accepted, are forgotten: they may be of any size.
    """
    copy(scales, now)
    forces = greatest(data.rows.force)
    for at in range(0, data.forces.f_o.size, 6):
        forces = larger(forces, LEAST_ACCELERATION * data.bodies.object_inertia[at, at])
        forces = larger(forces, greatest(data.forces.f_o[at : at + 3]))
    if forces < math.inf:
        now[FORCES] = max(scales[FORCES], forces)
        now[JOINT_FORCES] = max(scales[JOINT_FORCES], forces, greatest(data.forces.f_j))


@kernel
def write_values(guards, struct, data, model, full, work):
    """Values of all guards at the state that the system ``struct`` has evaluated last in ``data``.

    ``model``, ``full`` and ``work`` are those of the system with all rows, with their kinematics.
    """
    follow_scales(guards.scales, guards.scales_now, data)
    for g in range(guards.kind.size):
        sign = guards.sign[g]
        value, course, rate = guard_function(guards, g, struct, data, model, full, work)
        guards.value[g], guards.course[g], guards.rate[g] = sign * value, sign * course, sign * rate
        guards.level[g] = guards.threshold[g] * guards.scales_now[guards.scale[g]]


# --- steps ----------------------------------------------------------------------------------------


@kernel
def begin_stages(guards):
    """Forget the stages of all steps before."""
    for g in range(guards.least.size):
        guards.least[g] = math.inf


@kernel
def follow_stage(guards, struct, force):
    """Update the least values of force guards at a stage of the step."""
    for g in range(guards.kind.size):
        if is_force_function(guards.kind[g]):
            value = guards.sign[g] * force_function(guards, g, struct, force)
            guards.least[g] = min(guards.least[g], value)


@kernel
def judge_guards(guards, h):
    """Write the results of all guards for a step of length ``h``."""
    for g in range(guards.kind.size):
        guards.result[g] = judge_guard(guards, g, h)


@kernel
def count_events(guards):
    """How many guards were not quiet in the last step."""
    events = 0
    for g in range(guards.kind.size):
        events += 1 if guards.result[g] != QUIET else 0
    return events


@kernel
def judge_guard(guards, g, h):
    """Result of a guard for a step of length ``h``."""
    now, rate, level, armed = guards.value[g], guards.rate[g], guards.level[g], guards.armed[g] != 0
    if now < (0.0 if armed and guards.stops[g] != 0 else -level):
        return FIRED
    if is_force_function(guards.kind[g]):
        return DIPPED if guards.least[g] < -level else QUIET
    rate_before = guards.rate_before[g]
    if not (armed and rate_before < 0.0 < rate):
        return QUIET
    # where it fell, the course was the value
    return DIPPED if dips(guards.before[g], rate_before, guards.course[g], rate, h) else QUIET


@kernel
def dips(p, m, q, n, h):
    """Whether the cubic from ``p`` with slope ``m`` to ``q`` with slope ``n`` gets near zero."""
    # its derivative is m + 2 b x + 3 a x^2 with x from 0 to 1
    m, n = m * h, n * h
    a, b = 2.0 * (p - q) + m + n, 3.0 * (q - p) - 2.0 * m - n
    square = b * b - 3.0 * a * m
    if square <= 0.0:
        return False
    x = -m / (b + math.sqrt(square))
    if not 0.0 < x < 1.0:
        return False
    lowest = p + x * (m + x * (b + x * a))
    return lowest < NEAR_ZERO * min(p, q)


@plain
def remember_scales(guards):
    """Remember the forces at the state evaluated last: a run has come there."""
    copy(guards.scales_now, guards.scales)


@kernel
def accept_guards(guards):
    """Make the end of a step the beginning of the next one."""
    for g in range(guards.kind.size):
        guards.before[g], guards.rate_before[g] = guards.value[g], guards.rate[g]
        if guards.value[g] > guards.level[g]:
            guards.armed[g] = 1
