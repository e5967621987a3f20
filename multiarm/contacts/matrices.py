r"""The contact matrices W_m and W_o with their rates, for people: in the bodies' own axes.

.. math:: W = \begin{bmatrix} e \\ p\times e\end{bmatrix}, \qquad
   \dot W = \begin{bmatrix}\dot e\\ \dot p\times e + p\times\dot e\end{bmatrix}

component by component in each body's axes, about its own origin (thesis, 3.14 - 3.19).  The time
loop needs none of this: it works in world axes with ``c``, which holds what ``dW/dt`` would give.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import (
    AT,
    NORMAL,
    NORMAL_RATE,
    ORIGIN_AT,
    POINT_RATE,
    SPIN,
    VELOCITY,
)
from multiarm.contacts.records import (
    COMBINED,
    COUNT,
    KIND,
    LINK,
    SURFACE_BODY,
    SURFACE_ON_OBJECT,
    WEIGHT,
)


class ContactTerms(NamedTuple):
    r"""The contacts of one arm with the object at one state, one column (entry) a contact.

    W_m, W_o : (6, N)
        Wrenches on the gripper (about the tip frame's origin, its axes) and on the object (about
        the centre of mass, object axes) for unit pushes; ``W_o = -X W_m`` (thesis, 3.11).
    W_m_dot, W_o_dot : (6, N)
        Their rates, component by component in the same axes.
    c : (N,)
        Right-hand side of the acceleration constraint ``W_o^T q_o + W^T q = c``, no feedback.
    phi, phi_dot : (N,)
        Gaps [m] (positive = apart) and their rates ``W_m^T v_m + W_o^T v_o`` [m/s].
    points, normals : (N, 3)
        Contact points (on the surface's side of the fingertip) [m] and unit normals pointing into
        the object, world axes.
    """

    W_m: np.ndarray
    W_o: np.ndarray
    W_m_dot: np.ndarray
    W_o_dot: np.ndarray
    c: np.ndarray
    phi: np.ndarray
    phi_dot: np.ndarray
    points: np.ndarray
    normals: np.ndarray


class ContactMatrices(NamedTuple):
    """Columns of W and of its rate, one a row of the table, in the body's own axes.

    W_m, W_o : (6, N)
        Wrenches on the gripper (about its frame's origin) and on the object (about the centre of
        mass) for a unit push.
    W_m_dot, W_o_dot : (6, N)
        Their rates, component by component.
    """

    W_m: np.ndarray
    W_o: np.ndarray
    W_m_dot: np.ndarray
    W_o_dot: np.ndarray


def contact_matrices(
    codes: np.ndarray,
    geometry: np.ndarray,
    rows: np.ndarray,
    wanted: np.ndarray,
    link: np.ndarray,
    body: np.ndarray,
    tip: np.ndarray,
) -> ContactMatrices:
    """Contact matrices of some rows of a contact table.

    Parameters
    ----------
    codes : int64 (N + P, 4), geometry : (N + P, 13)
        The table, see :class:`multiarm.contacts.records.ContactTable`.
    rows : (N + P, 18)
        Kinematics of its rows and, behind them, of the parts of combined rows.
    wanted : int (k,)
    link, body : (24,)
        Kinematics of the link that carries the arm's geometry, and of the object.
    tip : (24,)
        Kinematics of the frame (fixed to the arm's last link) in which ``W_m`` is wanted.
    """
    wrenches = np.empty((len(codes), 4, 6))
    for on_object, surface in ((True, body), (False, link)):
        mine = (codes[:, SURFACE_BODY] == SURFACE_ON_OBJECT) == on_object
        wrenches[mine] = _simple(rows[mine], on_object, surface, body, tip)
    result = wrenches[wanted]
    for place, row in enumerate(wanted):
        if codes[row, KIND] == COMBINED:
            first, count = codes[row, LINK], codes[row, COUNT]
            signs = np.array([1.0, -1.0])[:count, None, None]
            parts = signs * wrenches[first : first + count]
            result[place] = geometry[row, WEIGHT] * parts.sum(axis=0)
    return ContactMatrices(*(np.ascontiguousarray(result[:, k].T) for k in range(4)))


def _simple(
    rows: np.ndarray, on_object: bool, surface: np.ndarray, body: np.ndarray, tip: np.ndarray
) -> np.ndarray:
    """W_m, W_o and their rates of rows that are no combinations, shape (k, 4, 6)."""
    point, e = rows[:, AT : AT + 3], rows[:, NORMAL : NORMAL + 3]
    # world rates of the normal and of the point, from those seen from the guiding surface's body
    spin, sign = surface[SPIN : SPIN + 3], -1.0 if on_object else 1.0
    e_rate = sign * rows[:, NORMAL_RATE : NORMAL_RATE + 3] + np.cross(spin, e)
    turning = np.cross(spin, point - surface[ORIGIN_AT : ORIGIN_AT + 3])
    point_rate = surface[VELOCITY : VELOCITY + 3] + turning + rows[:, POINT_RATE : POINT_RATE + 3]
    out = np.empty((len(rows), 4, 6))
    for column, frame, side in ((0, tip, -1.0), (1, body, 1.0)):
        R, spin = frame[:9].reshape(3, 3), frame[SPIN : SPIN + 3]
        at = point - frame[ORIGIN_AT : ORIGIN_AT + 3]
        at_rate = point_rate - frame[VELOCITY : VELOCITY + 3] - np.cross(spin, at)
        p, p_dot = at @ R, at_rate @ R
        f, f_dot = side * e @ R, side * (e_rate - np.cross(spin, e)) @ R
        out[:, column] = np.hstack([f, np.cross(p, f)])
        out[:, column + 2] = np.hstack([f_dot, np.cross(p_dot, f) + np.cross(p, f_dot)])
    return out
