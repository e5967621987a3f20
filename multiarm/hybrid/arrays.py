"""What a mode has beside the arrays of its system: rows that slide, guards, what is shown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.lowlevel import address_book, floats1, floats2, floats3, inner_inlined, ints1, ints2
from multiarm.node.reactions import ReactionWork

# Places of addresses and sizes of other books in ``Plant.links``.
MODEL, FULL, ASIDE, OWN, LINKS = 0, 2, 4, 6, 8

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
GUARD_KIND, A, B, C, UNIT, GUARD_WIDTH = range(6)
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
        What is guarded: kind, a, b, c, unit; parameter, and the value above which a guard that was
        at zero when the mode began counts as positive.
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

    held: np.ndarray
    slides: np.ndarray
    slide_mu: np.ndarray
    direction: np.ndarray
    turning: np.ndarray
    speed: np.ndarray
    slow: np.ndarray
    slots: np.ndarray
    states: np.ndarray
    guards: np.ndarray
    levels: np.ndarray
    values: np.ndarray
    before: np.ndarray
    rates: np.ndarray
    least: np.ndarray
    armed: np.ndarray
    found: np.ndarray
    muted: np.ndarray
    span: np.ndarray
    patches: np.ndarray
    Wr: np.ndarray
    prestress: np.ndarray
    stressed: np.ndarray
    springs: np.ndarray
    spring_force: np.ndarray


REACTIONS_AT = len(ModeArrays._fields)


def mode_book(arrays: ModeArrays, reactions: ReactionWork | None) -> np.ndarray:
    """Address book of a mode; :func:`open_mode` and :func:`open_reactions` are its inverse."""
    return address_book([*arrays, *(reactions or ())])


@inner_inlined
def open_mode(book):
    """Views of the arrays in a mode's book."""
    return ModeArrays(
        held=ints1(book, 0),
        slides=ints2(book, 1),
        slide_mu=floats1(book, 2),
        direction=floats2(book, 3),
        turning=floats2(book, 4),
        speed=floats1(book, 5),
        slow=floats1(book, 6),
        slots=ints1(book, 7),
        states=floats1(book, 8),
        guards=ints2(book, 9),
        levels=floats2(book, 10),
        values=floats1(book, 11),
        before=floats1(book, 12),
        rates=floats1(book, 13),
        least=floats1(book, 14),
        armed=ints1(book, 15),
        found=ints1(book, 16),
        muted=ints1(book, 17),
        span=floats1(book, 18),
        patches=floats2(book, 19),
        Wr=floats2(book, 20),
        prestress=floats1(book, 21),
        stressed=ints1(book, 22),
        springs=ints1(book, 23),
        spring_force=floats1(book, 24),
    )


@inner_inlined
def open_reactions(book):
    """Views of the arrays of the node algorithm with friction in a mode's book."""
    at = REACTIONS_AT
    return ReactionWork(
        dofs=ints1(book, at + 0),
        rows=ints1(book, at + 1),
        L=floats3(book, at + 2),
        Y=floats3(book, at + 3),
        Yr=floats3(book, at + 4),
        K=floats3(book, at + 5),
        K_pivots=ints2(book, at + 6),
        arm_scale=floats1(book, at + 7),
        arm_scale_r=floats1(book, at + 8),
        Lo=floats2(book, at + 9),
        Ls=floats2(book, at + 10),
        node=floats2(book, at + 11),
        node_pivots=ints1(book, at + 12),
        coupled=ints1(book, at + 13),
        loose=ints1(book, at + 14),
        pivot=floats1(book, at + 15),
        spread=floats2(book, at + 16),
        evenness=floats1(book, at + 17),
        counts=ints1(book, at + 18),
        place=ints1(book, at + 19),
        scale=floats1(book, at + 20),
        scale_r=floats1(book, at + 21),
        U=floats2(book, at + 22),
        Ur=floats2(book, at + 23),
        V=floats2(book, at + 24),
        Vr=floats2(book, at + 25),
        sigma=floats1(book, at + 26),
        sigma_r=floats1(book, at + 27),
        core=floats2(book, at + 28),
        core_V=floats2(book, at + 29),
        core_left=floats2(book, at + 30),
        core_left_V=floats2(book, at + 31),
        core_sigma=floats1(book, at + 32),
        free=floats2(book, at + 33),
        unserved=floats2(book, at + 34),
        y=floats1(book, at + 35),
        z=floats1(book, at + 36),
        left=floats1(book, at + 37),
        right=floats1(book, at + 38),
        unloaded=floats1(book, at + 39),
        six=floats1(book, at + 40),
        contacts=floats1(book, at + 41),
        six_columns=floats2(book, at + 42),
    )
