"""Guards: signed functions that are positive as long as a mode holds, or a motion is in its range.

A guard that *stops* the run belongs to a mode of unilateral contacts: where it becomes negative,
the mode ends.  One that only *reports* watches what the model does not enforce: contacts that are
pulled or leave the patch of their surface, joints that pass their limits, drives at theirs.  It
turns round at every event, and so reports the end of what it has reported, too.

Guards are checked at the end of every step; those of forces and drives also at its stages, and
those with a rate by a cubic between its ends.  Where one has changed its sign, the time of the
event is found on the step's dense output (:mod:`multiarm.integration.event_location`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.joint import unwrapped, write_relative
from multiarm.contacts.kernel import AT, GAP, GAP_RATE, NORMAL, depth_in_patch
from multiarm.contacts.table import SURFACE_BODY, TIP_RADIUS
from multiarm.geometry.records import SURFACE_ON_OBJECT, Patch
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2, floats1, view
from multiarm.jit.vectors import add_scaled, rotate_back, rotation, sub, vec

# Kinds of guards, with what they watch.
GAP_GUARD = 0  # the gap of a row of all rows [m]
PUSH_GUARD = 1  # the force of a held row [N]
CONE_GUARD = 2  # parameter (mu; -mu where it pulls) times the force of a held row, minus that of
# its tangents, held rows [N]
SLIP_GUARD = 3  # the speed of a slide in its tangents, of all rows, along its direction [m/s]
RATE_GUARD = 4  # the speed of a joint [rad/s, m/s]
HOLD_GUARD = 5  # parameter, minus the magnitude of the force of a held row [N m, N]
REST_GUARD = 6  # the gap of a row of all rows, plus the parameter (largest gap at contact) [m]
PATCH_GUARD = 7  # how far inside its patch on a body the contact of a row of all rows is [m]
LIFT_GUARD = 8  # parameter (largest gap at contact), minus the gap of a row of all rows [m]
ONSET_GUARD = 9  # parameter (largest speed at rest), minus that of slip in a row and the next [m/s]
SPRING_GUARD = 10  # the extension of the spring in a row, see spring_length [m]
LIMIT_GUARD = 11  # how far inside its range a component of the motion of an arm's joint is [m, rad]
DRIVE_GUARD = 12  # minus the margin of a joint's drive, see EffectKernel.watched [N m, N]

# Body of a patch or of a limit, if it is not the arm with this number.
ON_OBJECT = -1

# Result of a guard for a step: no event, a sign change, perhaps two sign changes.
QUIET, FIRED, DIPPED = range(3)


class Guard(NamedTuple):
    """One guard, as a row of :class:`Guards`."""

    kind: int
    watched: int
    parameter: float = 0.0
    threshold: float = 0.0
    tangents: tuple[int, int] = (-1, -1)
    sign: int = 1
    stops: bool = True
    relative: bool = False
    constraint: int = -1
    body: int = ON_OBJECT
    patch: np.ndarray = np.zeros(18)
    bounds: tuple[float, float] = (0.0, 0.0)
    margins: int = -1


class Guards(NamedTuple):
    """A table of g guards.

    The value of a guard is its sign times the function of its kind: 1 where that falls through zero
    at the next event, -1 where it rises.
    """

    kind: Ints1
    watched: Ints1  # a row, a slide, a joint or a component of motion, see the kinds
    tangents: Ints2  # (g, 2) of a cone or a slide, -1 without
    sign: Ints1
    stops: Ints1  # whether it ends a mode, and with it the step; or only reports
    parameter: Floats1
    # Of one that stops: if it was at zero when the mode began, it counts as positive above this.
    # One that reports changes its sign beyond this only.
    threshold: Floats1
    relative: Ints1  # whether the threshold is a part of the largest force (of at least 1 N)
    constraint: Ints1  # of the scene's unilateral constraints; -1: one that reports
    body: Ints1  # with the patch, or the arm with the limit
    patch: Floats2  # (g, 18) frame (rotation row by row, origin) in its body, and corners
    bounds: Floats2  # (g, 2) lower and upper end of a limit
    margins: Ints1  # place of the margins of drives in the system's struct
    direction: Floats2  # (s, 2) of the mode's slides, see multiarm.events.sliding
    # value, and rate of those for which it is known, at the state evaluated last and at the end of
    # the last step; the least value at the stages of this step
    value: Floats1
    rate: Floats1
    before: Floats1
    rate_before: Floats1
    least: Floats1
    level: Floats1  # the threshold in the unit of the value
    armed: Ints1  # whether it has been positive in this mode, or since the last event
    result: Ints1  # for the last step


open_guards = view(Guards)


def make_guards(guards: Sequence[Guard], direction: np.ndarray | None = None) -> Guards:
    """A table of guards; ``direction`` (s, 2) are the directions of the slides they watch."""
    g = len(guards)

    def column(name: str, kind: type, *shape: int) -> np.ndarray:
        return np.array([getattr(guard, name) for guard in guards], dtype=kind).reshape(g, *shape)

    integers = ("kind", "watched", "sign", "stops", "relative", "constraint", "body", "margins")
    return Guards(
        **{name: column(name, np.int64) for name in integers},
        parameter=column("parameter", float),
        threshold=column("threshold", float),
        tangents=column("tangents", np.int64, 2),
        patch=column("patch", float, 18),
        bounds=column("bounds", float, 2),
        direction=np.zeros((0, 2)) if direction is None else direction,
        value=np.zeros(g),
        rate=np.zeros(g),
        before=np.zeros(g),
        rate_before=np.zeros(g),
        least=np.full(g, np.inf),
        level=np.zeros(g),
        armed=np.zeros(g, dtype=np.int64),
        result=np.zeros(g, dtype=np.int64),
    )


def packed_patch(patch: Patch) -> np.ndarray:
    """Frame and corners of a patch, (18,)."""
    corners = (np.clip(corner, -1e300, 1e300) for corner in (patch.lower, patch.upper))
    return np.concatenate([patch.pose[:3, :3].ravel(), patch.pose[:3, 3], *corners])


def reset_guards(guards: Guards) -> None:
    """Begin a run inside of all ranges."""
    guards.sign[:], guards.armed[:] = 1, 0
    guards.before[:] = guards.rate_before[:] = np.nan


def turn_round(guards: Guards, g: int) -> None:
    """Let a guard watch for the end of what it has reported, from the end of the last step on."""
    guards.sign[g] *= -1
    guards.before[g] *= -1.0
    guards.rate_before[g] *= -1.0
    guards.armed[g] = guards.before[g] > guards.level[g]


# --- functions of the kinds -----------------------------------------------------------------------


@inlined
def spring_length(gap, rate, lag):
    """Extension of a spring and damper that only push [m]; they push where it is negative.

    They push while they are compressed and their force ``-k (gap + lag rate)`` is positive, with
    ``lag`` the damping over the stiffness ``k`` [s].
    """
    return max(gap, gap + lag * rate)


@kernel
def depth_on_body(patch, body, row, model, data):
    """How far inside its patch (18,) on a body the contact of a row is [m]."""
    contact = data.contacts[row]
    # the contact point lies a tip's radius from its centre, against the guide's outward normal
    away = model.geometry[row, TIP_RADIUS]
    if model.codes[row, SURFACE_BODY] == SURFACE_ON_OBJECT:
        away = -away
    touching = add_scaled(vec(contact, AT), -away, vec(contact, NORMAL))
    carrier = data.body if body == ON_OBJECT else data.arms[body]
    return depth_in_patch(patch, rotate_back(rotation(carrier, 0), sub(touching, vec(carrier, 9))))


@kernel
def depth_in_range(guards, g, model, data):
    """How far inside its range a component of a joint's motion is [m, rad], and the rate of that.

    NaN where the component is not free.
    """
    i, component = guards.body[g], guards.watched[g]
    rates, coordinates = data.query[0:6], data.query[6:15]
    for k in range(model.free_bounds[i], model.free_bounds[i + 1]):
        if model.free[k, 0] == component:
            write_relative(model.frames[i], data.arms[i], data.body, rates, coordinates)
            place, before = model.free[k, 1], data.coordinates[i, component]
            x = unwrapped(coordinates[place], before, place)
            above, below = x - guards.bounds[g, 0], guards.bounds[g, 1] - x
            return (above, rates[component]) if above < below else (below, -rates[component])
    return math.nan, math.nan


@kernel
def is_force_guard(guards, g):
    """Whether a guard depends on forces or on the commands of drives."""
    return guards.kind[g] in (PUSH_GUARD, HOLD_GUARD, CONE_GUARD, DRIVE_GUARD)


@kernel
def force_function(guards, g, struct, force):
    """The function of such a guard, for the forces of the held rows."""
    kind, row, parameter = guards.kind[g], guards.watched[g], guards.parameter[g]
    if kind == DRIVE_GUARD:
        return -floats1(struct, int(guards.margins[g]))[row]
    if kind == PUSH_GUARD:
        return force[row]
    if kind == HOLD_GUARD:
        return parameter - abs(force[row])
    square = 0.0
    for k in range(2):
        if guards.tangents[g, k] >= 0:
            square += force[guards.tangents[g, k]] ** 2
    return parameter * force[row] - math.sqrt(square)


@kernel
def write_value(guards, g, struct, data, model, full):
    """Value and rate of a guard at the state evaluated last; see :func:`write_values`."""
    kind, watched, parameter = guards.kind[g], guards.watched[g], guards.parameter[g]
    sign, rate = guards.sign[g], 0.0
    if kind == GAP_GUARD:
        value, rate = full.contacts[watched, GAP], full.contacts[watched, GAP_RATE]
    elif kind == REST_GUARD:
        value = parameter + full.contacts[watched, GAP]
    elif kind == LIFT_GUARD:
        value = parameter - full.contacts[watched, GAP]
    elif kind == SLIP_GUARD:
        value = 0.0
        for k in range(2):
            value += full.contacts[guards.tangents[g, k], GAP_RATE] * guards.direction[watched, k]
    elif kind == ONSET_GUARD:
        first, second = full.contacts[watched, GAP_RATE], full.contacts[watched + 1, GAP_RATE]
        value = parameter - math.sqrt(first * first + second * second)
    elif kind == RATE_GUARD:
        value = data.v[watched]
    elif kind == SPRING_GUARD:
        gap, gap_rate = full.contacts[watched, GAP], full.contacts[watched, GAP_RATE]
        value = spring_length(gap, gap_rate, parameter)
        rate = gap_rate if sign > 0 else 0.0
    elif kind == PATCH_GUARD:
        value = depth_on_body(guards.patch[g], guards.body[g], watched, model, full)
    elif kind == LIMIT_GUARD:
        value, rate = depth_in_range(guards, g, model, data)
    else:
        value = force_function(guards, g, struct, data.force)
    guards.value[g], guards.rate[g] = sign * value, sign * rate


@kernel
def write_values(guards, struct, data, model, full):
    """Values of all guards at the state that the system ``struct`` has evaluated last in ``data``.

    ``model`` and ``full`` are those of the system with all rows, with their kinematics.
    """
    largest = 1.0
    for k in range(data.force.size):
        largest = max(largest, abs(data.force[k]))
    for g in range(guards.kind.size):
        write_value(guards, g, struct, data, model, full)
        threshold = guards.threshold[g]
        guards.level[g] = threshold * largest if guards.relative[g] != 0 else threshold


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
        if is_force_guard(guards, g):
            value = guards.sign[g] * force_function(guards, g, struct, force)
            guards.least[g] = min(guards.least[g], value)


@kernel
def judge_guards(guards, h):
    """Results of all guards for a step of length ``h``; returns how many are not quiet."""
    events = 0
    for g in range(guards.kind.size):
        guards.result[g] = judge_guard(guards, g, h)
        events += 1 if guards.result[g] != QUIET else 0
    return events


@kernel
def judge_guard(guards, g, h):
    """Result of a guard for a step of length ``h``."""
    now, rate, level, armed = guards.value[g], guards.rate[g], guards.level[g], guards.armed[g] != 0
    if now < (0.0 if armed and guards.stops[g] != 0 else -level):
        return FIRED
    if is_force_guard(guards, g):
        return DIPPED if guards.least[g] < -level else QUIET
    if armed and guards.rate_before[g] < 0.0 < rate:
        # a cubic through both ends and their rates has a minimum below zero; a spring that grows
        # is longer than its gap by the parameter times the rate
        gap = now - guards.parameter[g] * rate
        if dips(guards.before[g], guards.rate_before[g], gap, rate, h):
            return DIPPED
    return QUIET


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
    return lowest < 0.05 * min(p, q)


@kernel
def accept_guards(guards):
    """Make the end of a step the beginning of the next one."""
    for g in range(guards.kind.size):
        guards.before[g], guards.rate_before[g] = guards.value[g], guards.rate[g]
        if guards.value[g] > guards.level[g]:
            guards.armed[g] = 1
