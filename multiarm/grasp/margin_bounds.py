r"""The margin of placements of seven contacts, and its upper bound over all placements on faces.

Seven wrenches have one balance :math:`W n = 0, \sum n_i = 1`; closure is n > 0.  The margin is the
smallest :math:`n_i`, that is t* of form closure; at most 1/7.

**The bound of one choice of faces.** A contact in a region with corners :math:`c_v` and the force
:math:`n_i` is a combination of forces at the corners, :math:`n_i = \sum_v \mu_{iv}` and
:math:`n_i w_i(p_i) = \sum_v \mu_{iv} w_i(c_v)`, since the wrench is affine on a face.  So the best
margin over all placements is a linear program in :math:`\mu`, without any loss.

**Quick bounds from twists.** Any twist :math:`\xi` of the body bounds the margin t.  With
:math:`a_i = w_i \cdot \xi` the balance says :math:`\sum n_i a_i = 0`, and coefficients of sum 1
with the smallest t can add no more to it than

.. math:: t \sum_i a_i + (1 - 7 t) \max_i a_i \ge 0 .

Each contact is at its best corner.  The duals of the linear programs are the sharpest twists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.grasp.balances import balance_inverses
from multiarm.grasp.placements import SevenTouches
from multiarm.programs import linear_program

# No margin of seven contacts is larger.
LARGEST_MARGIN = 1.0 / 7.0


@dataclass(frozen=True, eq=False)
class MarginBound:
    """The largest margin of all placements on one choice of faces, or more.

    Attributes
    ----------
    top : float
        No placement has a larger margin.
    placement : ndarray, shape (7, 2), or None
        In the outer regions, with this margin; None where no placement closes.
    twists : ndarray, shape (C, 6)
        That bound other choices, too.
    """

    top: float
    placement: np.ndarray | None
    twists: np.ndarray


def margins(touches: SevenTouches, y: np.ndarray) -> np.ndarray:
    """``t*`` of placements (M, 7, 2), shape (M,); 0 for what is no grasp."""
    return balance_inverses(touches.wrenches(y))[..., 6].min(axis=1).clip(0.0)


def margin_bound(touches: SevenTouches) -> MarginBound:
    """The bound over the outer regions, by a linear program."""
    owner = np.repeat(np.arange(7), [len(cell) for cell in touches.outer])
    places = np.concatenate(touches.outer)
    rates = touches.rates[owner]
    wrenches = touches.base[owner] + np.einsum("ca,caf->cf", places, rates)
    sums = (owner[None] == np.arange(7)[:, None]).astype(float)  # (7, V): forces of each contact
    count = len(places)
    solved = linear_program(
        np.r_[np.zeros(count), -1.0],
        at_most=(np.hstack([-sums, np.ones((7, 1))]), np.zeros(7)),
        equal=(
            np.vstack([np.c_[wrenches.T, np.zeros(6)], np.r_[np.ones(count), 0.0]]),
            np.r_[np.zeros(6), 1.0],
        ),
        signed=1,
    )
    if solved.x is None or not -solved.value > 0.0:
        none = solved.infeasible or solved.x is not None  # else nothing is concluded
        return MarginBound(0.0 if none else LARGEST_MARGIN, None, np.zeros((0, 6)))
    shares = sums * solved.x[:count]  # all contacts push: the margin is positive
    placement = shares @ places / shares.sum(axis=1, keepdims=True)
    twist = solved.duals[:6]
    return MarginBound(-solved.value, placement, np.array([twist, -twist]))


def quick_bounds(work: np.ndarray) -> np.ndarray:
    """Bounds (B,) of B choices of faces from twists, without a program.

    ``work`` (B, 7, C) is the largest w . xi over each region, for each of C twists.
    """
    most, total = work.max(axis=1), work.sum(axis=1)
    room = 7.0 * most - total  # 0 only when all are equal: then any t will do, if positive
    tops = np.where(room > 0.0, most / np.where(room > 0.0, room, 1.0), LARGEST_MARGIN)
    tops = np.where(most > 0.0, tops, 0.0)
    return tops.min(axis=1, initial=LARGEST_MARGIN)
