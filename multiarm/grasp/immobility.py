r"""Order of immobility: a body that is not form-closed may be held by what turning does later.

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

from multiarm.errors import GraspError
from multiarm.grasp.balances import BAND
from multiarm.grasp.contacts import Contacts

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
        faces; the faces may give way a little.  0: movable, or with several free motions not
        proven to be immobile.
    proven : bool
        False when order 0 means only that no proof of order 2 was found.
    pushes : ndarray, shape (N,), or None
        Balanced pushes of sum 1 that block every free motion; of order 2.
    """

    order: int
    proven: bool
    pushes: np.ndarray | None


def immobility(contacts: Contacts, closed: bool) -> Immobility:
    """Order of immobility of contacts of which form closure is decided already."""
    if closed:
        return Immobility(1, True, None)
    W = contacts.scaled_wrenches
    null = _null_space(W)
    carrying = _carrying(null)
    if not carrying.any():
        return Immobility(0, True, None)
    free = _null_space(W[:, carrying].T)
    turns = free[contacts.dimension :]
    if np.linalg.svd(turns, compute_uv=False)[-1] <= BAND or turns.shape[1] > turns.shape[0]:
        # without other contacts than the carrying ones, the translation is a free motion indeed
        return Immobility(0, bool(carrying.all()) or free.shape[1] == 1, None)
    forms = np.einsum("ak,jab,bl->jkl", turns, _forms(contacts), turns)
    pushes, tried = _blocking(null, forms)
    if pushes is not None:
        return Immobility(2, True, pushes)
    escapes = carrying.all() and any(_blocking(null, _along(x, forms))[0] is None for x in tried)
    return Immobility(0, free.shape[1] == 1 or bool(escapes), None)


def _forms(contacts: Contacts) -> np.ndarray:
    """``Q_j`` about the middle of the contacts, over their spread, shape (N, 3, 3) or (N, 1, 1)."""
    arms, e = (contacts.points - contacts.centre) / contacts.length, contacts.normals
    depths = np.sum(e * arms, axis=1)[:, None, None]
    if contacts.dimension == 2:
        return depths
    mixed = e[:, :, None] * arms[:, None, :]
    return depths * np.eye(3) - 0.5 * (mixed + np.swapaxes(mixed, 1, 2))


def _null_space(A: np.ndarray) -> np.ndarray:
    """Orthonormal columns that A takes to zero."""
    _, s, Vt = np.linalg.svd(A)
    return Vt[int(np.count_nonzero(s > BAND * s[0])) :].T


def _carrying(null: np.ndarray) -> np.ndarray:
    """Which contacts can take part in balanced pushes: maximise the sum of ``min(lam_j, 1)``."""
    count, size = null.shape
    if size == 0:
        return np.zeros(count, dtype=bool)
    solved = _program(
        np.append(np.zeros(size), -np.ones(count)),
        np.block([-null, np.eye(count)]),
        None,
        [(None, None)] * size + [(0.0, 1.0)] * count,
    )
    return solved[size:] > NOTHING


def _blocking(null: np.ndarray, forms: np.ndarray) -> tuple[np.ndarray | None, list[np.ndarray]]:
    """Pushes of sum 1 whose form is negative for every turn, or None; and the turns tried."""
    count = len(null)
    tried = list(np.eye(forms.shape[1]))
    for _ in range(ROUNDS):
        values = np.array([_along(x, forms)[:, 0, 0] for x in tried])
        rows = np.column_stack([values @ null, -np.ones(len(tried))])
        positive = np.column_stack([-null, np.zeros(count)])
        solved = _program(
            np.append(np.zeros(null.shape[1]), 1.0),
            np.vstack([rows, positive]),
            np.append(null.sum(axis=0), 0.0)[None],
            [(None, None)] * (null.shape[1] + 1),
        )
        if solved[-1] >= -NOTHING:
            break
        pushes = null @ solved[:-1]
        heights, axes = np.linalg.eigh(np.einsum("j,jkl->kl", pushes, forms))
        if heights[-1] < -NOTHING:
            return np.maximum(pushes, 0.0), tried
        tried.append(axes[:, -1])
    return None, tried


def _along(x: np.ndarray, forms: np.ndarray) -> np.ndarray:
    """The forms for one turn: numbers, shape (N, 1, 1)."""
    return np.einsum("k,jkl,l->j", x, forms, x)[:, None, None]


def _program(
    cost: np.ndarray, upper: np.ndarray, total: np.ndarray | None, bounds: list
) -> np.ndarray:
    """Minimise ``cost @ x`` with ``upper @ x <= 0`` and, if given, ``total @ x = 1``."""
    from scipy.optimize import linprog

    solved = linprog(
        cost,
        A_ub=upper,
        b_ub=np.zeros(len(upper)),
        A_eq=total,
        b_eq=None if total is None else [1.0],
        bounds=bounds,
    )
    if not solved.success:
        raise GraspError(
            f"the linear program of second-order immobility ended with {solved.message!r}; the "
            f"verdict on form closure itself does not need it"
        )
    return solved.x
