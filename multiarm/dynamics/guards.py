"""Guards: functions that are positive as long as a mode holds.

They are checked at the end of every step; those of forces also at its stages, and those of gaps by
a cubic between its ends.  The values of a step's ends and stages are in :class:`Guards`, so that a
guard is one row of a table.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from multiarm.contacts.kernel import AT, GAP, GAP_RATE, depth_in_patch
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2, view
from multiarm.jit.vectors import vec

# Kinds of guards, with what they watch.
GAP_GUARD = 0  # the gap of a row of all rows [m]
PUSH_GUARD = 1  # parameter (1; -1 where it pulls) times the force of a held row [N]
CONE_GUARD = 2  # parameter (mu; -mu where it pulls) times the force of a held row, minus that of
# its tangents [N]
SLIP_GUARD = 3  # the speed of a slide along its direction [m/s]
RATE_GUARD = 4  # the speed of a joint times the parameter [rad/s, m/s]
HOLD_GUARD = 5  # parameter, minus the magnitude of the force of a held row [N m, N]
REST_GUARD = 6  # the gap of a row of all rows, plus the parameter (largest gap at contact) [m]
PATCH_GUARD = 7  # sign times the distance of a row's contact from the edge of its patch [m]
LIFT_GUARD = 8  # parameter (largest gap at contact), minus the gap of a row of all rows [m]
ONSET_GUARD = 9  # parameter (largest speed at rest), minus that of slip in a row and the next [m/s]
SPRING_GUARD = 10  # sign times the extension of the spring in a row, see spring_length [m]

# Result of a guard for a step: no event, a sign change, perhaps two sign changes.
QUIET, FIRED, DIPPED = range(3)


class Guards(NamedTuple):
    """The guards of a mode, g of them."""

    kind: Ints1
    watched: Ints1  # a row, a slide or a joint, see the kinds
    tangents: Ints2  # (g, 2) of a cone: held rows, -1 without
    sign: Ints1
    parameter: Floats1
    threshold: Floats1  # one that was at zero when the mode began counts as positive above it
    constraint: Ints1
    patch: Floats2  # (g, 18) frame (rotation row by row, origin) in its body, and corners
    # at the state evaluated last; at the end of the last step, with the rate of a gap; the least
    # at the stages of this step
    value: Floats1
    before: Floats1
    rate: Floats1
    least: Floats1
    armed: Ints1  # whether it has been positive in this mode
    result: Ints1  # for the last step


open_guards = view(Guards)


@inlined
def spring_length(gap, rate, lag):
    """Extension of a spring and damper that only push [m]; they push where it is negative.

    They push while they are compressed and their force ``-k (gap + lag rate)`` is positive, with
    ``lag`` the damping over the stiffness ``k`` [s].
    """
    return max(gap, gap + lag * rate)


@kernel
def is_force_guard(guards, g):
    """Whether the value of a guard depends on forces."""
    return guards.kind[g] in (PUSH_GUARD, HOLD_GUARD, CONE_GUARD)


@kernel
def is_gap_guard(guards, g):
    """Whether a guard is the gap of an open contact."""
    kind = guards.kind[g]
    return kind == GAP_GUARD or (kind == SPRING_GUARD and guards.sign[g] > 0)


@kernel
def force_guard(guards, g, force):
    """Value of a force guard for the forces of the held rows."""
    kind, row, parameter = guards.kind[g], guards.watched[g], guards.parameter[g]
    if kind == PUSH_GUARD:
        return parameter * force[row]
    if kind == HOLD_GUARD:
        return parameter - abs(force[row])
    square = 0.0
    for k in range(2):
        if guards.tangents[g, k] >= 0:
            square += force[guards.tangents[g, k]] ** 2
    return parameter * force[row] - math.sqrt(square)


@kernel
def guard_value(guards, g, slides, data, contacts):
    """Value of a guard at the state evaluated last; ``contacts`` are those of all rows."""
    kind, watched, parameter = guards.kind[g], guards.watched[g], guards.parameter[g]
    if kind == GAP_GUARD:
        return contacts[watched, GAP]
    if kind == REST_GUARD:
        return parameter + contacts[watched, GAP]
    if kind == LIFT_GUARD:
        return parameter - contacts[watched, GAP]
    if kind == SLIP_GUARD:
        t = slides.tangent_of_all[watched]
        first, second = contacts[t, GAP_RATE], contacts[t + 1, GAP_RATE]
        return first * slides.direction[watched, 0] + second * slides.direction[watched, 1]
    if kind == ONSET_GUARD:
        first, second = contacts[watched, GAP_RATE], contacts[watched + 1, GAP_RATE]
        return parameter - math.sqrt(first * first + second * second)
    if kind == RATE_GUARD:
        return parameter * data.v[watched]
    if kind == SPRING_GUARD:
        row = contacts[watched]
        return guards.sign[g] * spring_length(row[GAP], row[GAP_RATE], parameter)
    if kind == PATCH_GUARD:
        return guards.sign[g] * depth_in_patch(guards.patch[g], vec(contacts[watched], AT))
    return force_guard(guards, g, data.force)


@kernel
def begin_stages(guards):
    """Forget the stages of all steps before."""
    for g in range(guards.least.size):
        guards.least[g] = math.inf


@kernel
def follow_stage(guards, force):
    """Update the least values of force guards at a stage of the step."""
    for g in range(guards.kind.size):
        if is_force_guard(guards, g):
            guards.least[g] = min(guards.least[g], force_guard(guards, g, force))


@kernel
def judge_guard(guards, g, contacts, h):
    """Result of a guard for a step of length ``h``."""
    now, threshold = guards.value[g], guards.threshold[g]
    if now < (0.0 if guards.armed[g] != 0 else -threshold):
        return FIRED
    if is_force_guard(guards, g):
        return DIPPED if guards.least[g] < -threshold else QUIET
    if is_gap_guard(guards, g) and guards.armed[g] != 0:
        # a cubic through both ends and their rates has a minimum below zero
        end = contacts[guards.watched[g]]
        before, gap, rate = guards.before[g], end[GAP], end[GAP_RATE]
        if guards.rate[g] < 0.0 < rate and dips(before, guards.rate[g], gap, rate, h):
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
def accept_guards(guards, contacts):
    """Make the end of a step the beginning of the next one."""
    for g in range(guards.kind.size):
        guards.before[g] = guards.value[g]
        if is_gap_guard(guards, g):
            guards.rate[g] = contacts[guards.watched[g], GAP_RATE]
        if guards.value[g] > guards.threshold[g]:
            guards.armed[g] = 1
