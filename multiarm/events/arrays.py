"""What a mode has beside the arrays of its system: rows that slide, guards, what is shown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.reactions import ReactionWork
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2, make_struct, view

# Columns of ModeArrays.slides: row held, its arm, first tangent in the aside rows, and among all.
HELD, ARM, TANGENT_AT, TANGENT_OF_ALL, SLIDE_WIDTH = range(5)

# Kinds of guards, and what their numbers a, b, c mean.  All are positive as long as the mode holds.
GAP_GUARD = 0  # gap of row a of all rows [m]
PUSH_GUARD = 1  # force of held row a [N]
CONE_GUARD = 2  # mu times force of held row a, less that along b, c (-1: not held) [N]
SLIP_GUARD = 3  # speed of slide a along its direction [m/s]
RATE_GUARD = 4  # speed of joint a times the parameter [rad/s, m/s]
HOLD_GUARD = 5  # parameter, less the size of the force of held row a [N m, N]
REST_GUARD = 6  # gap of row a of all rows, plus what counts as closed [m]
PATCH_GUARD = 7  # c times how far inside its patch the contact of row a of all rows is [m]
LIFT_GUARD = 8  # what still counts as closed, less the gap of row a of all rows [m]
ONSET_GUARD = 9  # what still counts as rest, less the speed along slide a [m/s]
SPRING_GUARD = 10  # c times the length of the spring in row a beyond rest, see spring_length [m]
# Columns of ModeArrays.guards and .levels.
GUARD_KIND, A, B, C, CONSTRAINT, GUARD_WIDTH = range(6)
PARAMETER, THRESHOLD, LEVEL_WIDTH = range(3)
# What a guard found in a step: nothing, that it changed its sign, that it may have done so twice.
QUIET, FIRED, DIPPED = range(3)


class ModeArrays(NamedTuple):
    """Arrays of one mode.

    held : int64 (m,)
        Row among all of each row held.
    slides : int64 (s, 4), slide_mu : (s,), direction, turning : (s, 2), speed : (s,)
        Contacts that slide: their rows, coefficients, direction of slip at the end of the last step
        and at the state evaluated last, and the speed along it [m/s].
    slow : (1,)
        Slip slower than this has hardly a direction of its own [m/s].
    slots : int64 (1,)
        Place of the power of sliding friction in ``Buffers.power``.
    states : (u,)
        What every contact does, as it is recorded.
    guards : int64 (g, 5), levels : (g, 2)
        What is guarded: kind, a, b, c, constraint; parameter, and the value above which a guard
        that was at zero when the mode began counts as positive.
    values, before, rates, least : (g,)
        Values at the state evaluated last and at the end of the last step, rate of a gap then,
        least value in the stages since.
    armed, found : int64 (g,)
        Whether it has been positive in this mode; what happened in the last step.
    muted : int64 (1,)
        1: the step at hand ends at an event that is known.
    span : (2,)
        Begin and end of the last step [s].
    patches : (g, 18)
        Of patch guards: frame of the patch (rotation row by row, origin) in its body, and corners.
    Wr : (m, 6)
        The object's rows of the reactions.
    prestress : (m,), stressed : int64 (1,)
        Forces from which those of the mode differ by the least norm, and whether there are any.
    springs : int64 (s,), spring_force : (s,)
        Compliant contacts: their rows among all, and their forces.
    """

    held: Ints1
    slides: Ints2
    slide_mu: Floats1
    direction: Floats2
    turning: Floats2
    speed: Floats1
    slow: Floats1
    slots: Ints1
    states: Floats1
    guards: Ints2
    levels: Floats2
    values: Floats1
    before: Floats1
    rates: Floats1
    least: Floats1
    armed: Ints1
    found: Ints1
    muted: Ints1
    span: Floats1
    patches: Floats2
    Wr: Floats2
    prestress: Floats1
    stressed: Ints1
    springs: Ints1
    spring_force: Floats1


def mode_struct(arrays: ModeArrays, reactions: ReactionWork | None) -> np.ndarray:
    """Struct of a mode; :func:`open_mode` and :func:`open_reactions` are its inverse."""
    return make_struct([*arrays, *(reactions or ())])


# Views of the arrays in a mode's struct: its own, and those of the node algorithm with friction.
open_mode, open_reactions = view(ModeArrays), view(ReactionWork, len(ModeArrays._fields))
