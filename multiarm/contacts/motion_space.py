r"""Motion space of a joint: which motions it leaves free, and the coordinates of these motions.

The contacts of an arm bind the motion of the gripper relative to the object, in object axes and at
the gripper's origin: ``W^T v = 0`` with ``W = W_m^o``, columns ``[-e_o; e_o x (p_o - x)]``
(thesis, 3.21).  ``T`` spans what is left (3.20):

.. math:: v = T \alpha, \qquad W^T T = 0, \qquad S\, T = I .

*What the rates alpha mean is a choice*, made by a matrix ``S`` with ``alpha = S v``: rows of the
twist (``S`` has rows of the identity), or any of :mod:`multiarm.contacts.coordinates`.  From any
basis ``N`` of the null space, and any solution ``D`` of ``W^T D = -(dW/dt)^T T``,

.. math:: T = N (S N)^{-1}, \qquad \dot T = D - T (S D + \dot S\, T) .

The choice is a good one when ``S N`` is well conditioned, and impossible when it is singular:
along some free motion all of the chosen coordinates then stand still.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.contacts.coordinates import COORDINATE_TOLERANCE, ROW_NAMES, Selection
from multiarm.contacts.screws import (
    RANK_TOLERANCE,
    ScrewSystem,
    column_norms,
    pivots,
    row_scale,
    screw_system,
    wrench_matrix,
)
from multiarm.errors import GraspError


@dataclass(frozen=True)
class MotionSpace:
    """The free motions ``v = T alpha`` of a gripper relative to the object.

    Twists are of the gripper's frame relative to the object: velocity of the gripper's origin
    [m/s] and angular velocity [rad/s], both in object axes.

    Attributes
    ----------
    T : ndarray, shape (6, m)
        ``m = 6 - rank W``.
    T_dot : ndarray, shape (6, m), or None
        Its rate; None when the rate of ``W`` was not given.
    selection : Selection
        What ``alpha`` is.
    rows, others : tuple of int
        The rows of the twist that are ``alpha``, and the rest; both empty when ``alpha`` is not
        made of rows.
    rank : int
        Number of independent wrenches.
    condition : float
        Inverse of the smallest singular value of ``S`` on the free motions (lengths in lever arms
        of the contacts): 1 at best, the larger the nearer ``alpha`` is to failing.
    mismatch : float
        Largest entry of ``W^T T_dot + W_dot^T T``, scaled [1/s]: zero unless the rank of redundant
        wrenches is just changing, where ``T`` has no rate.  0 without ``T_dot``.
    """

    T: np.ndarray
    T_dot: np.ndarray | None
    selection: Selection
    rows: tuple[int, ...]
    others: tuple[int, ...]
    rank: int
    condition: float
    mismatch: float = 0.0

    def rates(self, twist: np.ndarray) -> np.ndarray:
        """``alpha = S v`` of a relative twist, shape (m,)."""
        return self.selection.matrix @ twist

    def twist(self, alpha: np.ndarray) -> np.ndarray:
        """Relative twist ``T alpha``, shape (6,)."""
        return self.T @ np.asarray(alpha, dtype=float)

    def acceleration(self, alpha: np.ndarray, alpha_dot: np.ndarray) -> np.ndarray:
        """Rate ``T alpha' + T' alpha`` of the components of the relative twist, shape (6,).

        Raises
        ------
        GraspError
            When ``T_dot`` was not asked for.
        """
        if self.T_dot is None:
            raise GraspError("the motion space has no rate: give it the rate of W (`W_dot`)")
        return self.T @ np.asarray(alpha_dot, float) + self.T_dot @ np.asarray(alpha, float)


def motion_space(
    W: np.ndarray,
    W_dot: np.ndarray | None = None,
    rows: Sequence[int | str] | None = None,
) -> MotionSpace:
    """Motion space with rows of the relative twist as rates alpha (thesis, 3.8).

    Parameters
    ----------
    W : ndarray, shape (6, N)
        ``W_m^o``: wrenches on the gripper about its origin, object axes.  They may be dependent.
    W_dot : ndarray, shape (6, N), optional
        Their rates, component by component.
    rows : sequence of int or str, optional
        Which components of the twist are ``alpha``: 0 to 5, or slide x, slide y,
        slide z, turn x, turn y, turn z.
        Left out: those that condition the choice best, found by pivoting.

    Raises
    ------
    GraspError
        When the rows cannot serve; the message lists rows that can.
    """
    W = wrench_matrix(W)
    screws = screw_system(W)
    chosen = pivots(_scaled_null(screws)) if rows is None else _row_numbers(rows)
    if rows is not None and len(chosen) != 6 - screws.rank:
        raise GraspError(
            f"the contacts leave {6 - screws.rank} motions free, which takes as many rows, not "
            f"{len(chosen)}{_alternatives(screws)}"
        )
    selection = Selection(
        np.eye(6)[list(chosen)],
        np.zeros((len(chosen), 6)),
        tuple(ROW_NAMES[row] for row in chosen),
    )
    others = tuple(row for row in range(6) if row not in chosen)
    return _space(W, W_dot, screws, selection, (chosen, others))


def motion_space_in_rates(
    W: np.ndarray, selection: Selection, W_dot: np.ndarray | None = None
) -> MotionSpace:
    """Motion space with any linear rates ``alpha = S v`` of the relative twist.

    Parameters are those of :func:`motion_space`; see
    :mod:`multiarm.contacts.coordinates` for choices of ``S``.

    Raises
    ------
    GraspError
        When the rates cannot serve; the message lists rows of the twist that can.
    """
    W = wrench_matrix(W)
    screws = screw_system(W)
    count = len(selection.matrix)
    if count != 6 - screws.rank:
        raise GraspError(
            f"the contacts leave {6 - screws.rank} motions free, which takes as many rates, not "
            f"{count} ({', '.join(selection.labels)}){_alternatives(screws)}"
        )
    return _space(W, W_dot, screws, selection, ((), ()))


def _space(
    W: np.ndarray,
    W_dot: np.ndarray | None,
    screws: ScrewSystem,
    selection: Selection,
    split: tuple[tuple[int, ...], tuple[int, ...]],
) -> MotionSpace:
    """``T``, ``T_dot`` for any choice of rates."""
    smallest = _smallest(selection.matrix, screws)
    if smallest < COORDINATE_TOLERANCE:
        raise GraspError(
            f"{', '.join(selection.labels)} cannot serve as coordinates of the relative motion: "
            f"they all stand still along a motion that the contacts leave free"
            f"{_alternatives(screws)}"
        )
    N, (rows, others) = screws.reciprocal, split
    T = N @ np.linalg.inv(selection.matrix @ N)
    if rows:
        T[list(rows)] = np.eye(len(rows))  # without rounding
    T_dot, mismatch = None, 0.0
    if W_dot is not None:
        T_dot, mismatch = _rate(W, wrench_matrix(W_dot, "W_dot"), T, selection, screws.length)
        T_dot[list(rows)] = 0.0
    return MotionSpace(T, T_dot, selection, rows, others, screws.rank, 1.0 / smallest, mismatch)


def _rate(
    W: np.ndarray, W_dot: np.ndarray, T: np.ndarray, selection: Selection, length: float
) -> tuple[np.ndarray, float]:
    """``T_dot`` and what it leaves over of ``W^T T_dot = -W_dot^T T`` (scaled)."""
    if W_dot.shape != W.shape:
        raise GraspError(f"W_dot has the shape {W_dot.shape}, W {W.shape}")
    scale, norms = row_scale(length), column_norms(W, length)
    left = (scale[:, None] * W / norms).T  # (N, 6)
    right = -(W_dot / norms).T @ T  # (N, m)
    particular = scale[:, None] * np.linalg.lstsq(left, right, rcond=RANK_TOLERANCE)[0]
    T_dot = particular - T @ (selection.matrix @ particular + selection.rate @ T)
    over = left @ (T_dot / scale[:, None]) - right
    return T_dot, float(np.max(np.abs(over), initial=0.0))


def _scaled_null(screws: ScrewSystem) -> np.ndarray:
    """Orthonormal free motions ``[v; length omega]`` as columns, (6, m)."""
    return screws.reciprocal / row_scale(screws.length)[:, None]


def _smallest(S: np.ndarray, screws: ScrewSystem) -> float:
    """Smallest singular value of the rates on the free motions, rates of unit size; 1 for none."""
    if not len(S):
        return 1.0
    scaled = S * row_scale(screws.length)
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    on_free = scaled / np.where(size > 0.0, size, 1.0) @ _scaled_null(screws)
    return float(np.linalg.svd(on_free, compute_uv=False)[-1])


def _row_numbers(rows: Sequence[int | str]) -> tuple[int, ...]:
    numbers = []
    for row in rows:
        number = ROW_NAMES.index(row) if row in ROW_NAMES else row
        if isinstance(number, str) or number not in range(6) or int(number) in numbers:
            raise GraspError(
                f"rows of a twist are {', '.join(ROW_NAMES)} or 0 to 5, each once; "
                f"not {', '.join(str(r) for r in rows)}"
            )
        numbers.append(int(number))
    return tuple(numbers)


def _alternatives(screws: ScrewSystem) -> str:
    """End of a message: rows that can serve, the best first."""
    free = 6 - screws.rank
    if free == 0:
        return "; none can: they leave nothing free"
    graded = [
        (_smallest(np.eye(6)[list(rows)], screws), rows)
        for rows in itertools.combinations(range(6), free)
    ]
    # sorted by rounded grade, so that equals stay in the order of the rows
    good = [g for g in sorted(graded, key=lambda g: -round(g[0], 6)) if g[0] > COORDINATE_TOLERANCE]
    texts = [" + ".join(ROW_NAMES[row] for row in rows) for _, rows in good]
    more = f" (and {len(texts) - 6} more)" if len(texts) > 6 else ""
    return f"; rows that can, the best first: {', '.join(texts[:6])}{more}"
