r"""Order of immobility: a body that is not form-closed may be held to second order.

Along a motion with the twist :math:`[v; \omega]`, the gap between a point finger and the flat face
that it touches has, seen from the body,

.. math::
    \dot\varphi_j = e_j \cdot u_j, \qquad
    \ddot\varphi_j = w_j^T a + h_j, \qquad h_j = -e_j \cdot (\omega \times u_j),
    \qquad u_j = v + \omega \times p_j

with an acceleration a that is free.  Where a motion leaves the gaps as they are to first order,
pushes :math:`\lambda \ge 0` that balance, ``W lam = 0``, have
:math:`\lambda^T \ddot\varphi = \lambda^T h`: if that is negative, some gap becomes negative
whatever a is, and the motion is blocked (Rimon and Burdick 1998).  With balanced pushes, h depends
on the turn alone,

.. math::
    \lambda^T h = \omega^T \Big[\sum_j \lambda_j Q_j\Big] \omega, \qquad
    Q_j = (e_j \cdot p_j) I - \tfrac12 (e_j p_j^T + p_j e_j^T)

(in the plane :math:`Q_j = e_j \cdot p_j`), so no translation is ever blocked.  The body is immobile
to second order when every free motion has such pushes.  With one free motion that is a linear
program, and the verdict is exact.  With several, pushes are sought that block all of them at once:
finding them proves immobility, not finding them proves nothing, unless one of the motions tried is
blocked by no pushes at all.  The search is a linear program to which the turns that are blocked
worst are added one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.dynamics.forces.distribution import pressed
from multiarm.grasp.closure.balances import tolerance_of
from multiarm.grasp.contacts import Contacts
from multiarm.programs import LinearSolution, linear_program

# Parts of the largest push, of the unit form: below this, what a linear program returns is noise.
NOTHING = 1e-7
# Motions that may be added to the search; a form in three turns needs a dozen.
ROUNDS = 60


@dataclass(frozen=True, eq=False)
class Immobility:
    """How contacts with flat faces hold a body.

    Attributes
    ----------
    order : int
        1: form closure.  2: immobile, but only because turning presses the fingers into the
        faces, which may yield a little.  0: movable, or several free motions without a proof of
        immobility.
    proven : bool
        False when order 0 means only that the search found no proof of order 2, or that a linear
        program gave up, as it may where the rank hangs on normals that differ by 1e-7.
    pushes : ndarray, shape (N,), or None
        Balanced pushes of sum 1 that block every free motion; of order 2.
    """

    order: int
    proven: bool
    pushes: np.ndarray | None


def immobility(contacts: Contacts, closed: bool) -> Immobility:
    """Order of immobility of contacts whose form closure is known."""
    if closed:
        return Immobility(1, True, None)
    try:
        return _second_order(contacts)
    except _GaveUp:
        return Immobility(0, False, None)


class _GaveUp(Exception):
    """A linear program without an answer: nothing is proven by it."""


def _second_order(contacts: Contacts) -> Immobility:
    W = contacts.scaled_wrenches
    tolerance = tolerance_of(contacts)
    rows, internal = _spaces(W, tolerance)
    shares = pressed(internal.T)
    if shares is None:
        raise _GaveUp
    carrying = shares > NOTHING + tolerance
    if not carrying.any():
        return Immobility(0, True, None)
    free = _spaces(W[:, carrying].T, tolerance)[1]
    if len(free) == 0:  # closed, but for the tolerance
        return Immobility(0, False, None)
    turns = free[:, contacts.dimension :].T
    forms = np.einsum("ak,jab,bl->jkl", turns, _forms(contacts), turns)
    pushes, tried = _blocking(rows, forms)
    if pushes is not None:
        return Immobility(2, True, pushes)
    escapes = carrying.all() and any(_blocking(rows, _along(x, forms))[0] is None for x in tried)
    return Immobility(0, len(free) == 1 or bool(escapes), None)


def _forms(contacts: Contacts) -> np.ndarray:
    """``Q_j`` about the middle of the contacts, over their spread, shape (N, 3, 3) or (N, 1, 1)."""
    arms, e = (contacts.points - contacts.centre) / contacts.length, contacts.normals
    depths = np.sum(e * arms, axis=1)[:, None, None]
    if contacts.dimension == 2:
        return depths
    mixed = e[:, :, None] * arms[:, None, :]
    return depths * np.eye(3) - 0.5 * (mixed + np.swapaxes(mixed, 1, 2))


def _spaces(A: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal rows that span those of A, and rows that span what A takes to zero."""
    _, s, Vt = np.linalg.svd(A)
    rank = int(np.count_nonzero(s > tolerance * s[0]))
    return Vt[:rank], Vt[rank:]


def _blocking(rows: np.ndarray, forms: np.ndarray) -> tuple[np.ndarray | None, list[np.ndarray]]:
    """Pushes of sum 1 whose form is negative for every turn, or None; and the turns tried."""
    count = rows.shape[1]
    balance = np.column_stack([np.vstack([rows, np.ones(count)]), np.zeros(len(rows) + 1)])
    tried = list(np.eye(forms.shape[1]))
    for _ in range(ROUNDS):
        values = np.array([_along(x, forms)[:, 0, 0] for x in tried])
        program = linear_program(
            np.append(np.zeros(count), 1.0),
            at_most=(np.column_stack([values, -np.ones(len(tried))]), np.zeros(len(tried))),
            equal=(balance, np.append(np.zeros(len(rows)), 1.0)),
            signed=1,
        )
        solved = _answer(program)
        if solved[-1] >= -NOTHING:
            break
        pushes = solved[:-1] + 0.0  # no -0
        heights, axes = np.linalg.eigh(np.einsum("j,jkl->kl", pushes, forms))
        if heights[-1] < -NOTHING:
            return pushes, tried
        tried.append(axes[:, -1])
    return None, tried


def _along(x: np.ndarray, forms: np.ndarray) -> np.ndarray:
    """The forms for one turn: numbers, shape (N, 1, 1)."""
    return np.einsum("k,jkl,l->j", x, forms, x)[:, None, None]


def _answer(solved: LinearSolution) -> np.ndarray:
    if solved.x is None:
        raise _GaveUp
    return solved.x
