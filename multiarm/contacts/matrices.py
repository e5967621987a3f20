r"""Contact matrices with their rates, for analysis, and the motion of a gripper.

.. math:: W = \begin{bmatrix} e \\ p\times e\end{bmatrix}, \qquad
   \dot W = \begin{bmatrix}\dot e\\ \dot p\times e + p\times\dot e\end{bmatrix}

component by component in each body's axes, about its own origin (thesis, 3.14 - 3.19).  The time
loop needs none of this: it works in world axes with ``c``, which holds what ``dW/dt`` would give.

*The gripper relative to the object* (thesis, 3.5 and 3.6).  With ``x`` the gripper's origin in
object axes, ``r = R_o x`` and the relative twist ``v = [x'; omega]`` in object axes, the gripper's
twist and acceleration in the world are

.. math::
    v_m &= \begin{bmatrix} \dot x_o + \omega_o \times r \\ \omega_o \end{bmatrix} + H_o v, \\
    \dot v_m &= \begin{bmatrix} \ddot x_o + \dot\omega_o \times r
          + \omega_o \times (\omega_o \times r) \\ \dot\omega_o \end{bmatrix} + H_o \dot v
          + \begin{bmatrix} 2\,\omega_o \times R_o \dot x \\ \omega_o \times R_o \omega
          \end{bmatrix},

``H_o`` turning object axes into world axes.  ``v'`` is the rate of the components of ``v``:
``T alpha' + T' alpha``.  Even a welded gripper has an acceleration bias, the centripetal one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import ContactRow
from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import COMBINED, Code, ContactGeometry, ContactTable
from multiarm.geometry.records import SURFACE_ON_OBJECT
from multiarm.jit.rows import fields_of


class ContactTerms(NamedTuple):
    r"""The contacts of one arm with the object at one state, one column (entry) a contact.

    W_m, W_o : (6, N)
        Wrenches on the gripper (about the tip frame's origin, its axes) and on the object (about
        the centre of mass, object axes) for unit pushes; ``W_o = -X W_m`` (thesis, 3.11).
    W_m_dot, W_o_dot : (6, N)
        Their rates, component by component in the same axes.
    c : (N,)
        Right-hand side of the acceleration constraint ``W_o^T a_o + W^T a_j = c``, no feedback.
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
    """The first four fields of :class:`ContactTerms`, for some rows of a table."""

    W_m: np.ndarray
    W_o: np.ndarray
    W_m_dot: np.ndarray
    W_o_dot: np.ndarray


def contact_matrices(
    table: ContactTable,
    rows: np.ndarray,
    wanted: np.ndarray,
    link: np.ndarray,
    body: np.ndarray,
    tip: np.ndarray,
) -> ContactMatrices:
    """Contact matrices of some rows of a contact table.

    Parameters
    ----------
    table : ContactTable
    rows : (N + P, 18)
        Kinematics of its rows, followed by those of the parts of combined rows.
    wanted : int (k,)
        Numbers of the rows.
    link, body : (24,)
        Kinematics of the link that carries the arm's geometry, and of the object.
    tip : (24,)
        Kinematics of the frame (fixed to the arm's last link) in which ``W_m`` is wanted.
    """
    code, weights = fields_of(Code, table.codes), fields_of(ContactGeometry, table.geometry).weight
    wrenches = np.empty((len(table.codes), 4, 6))
    for on_object, surface in ((True, body), (False, link)):
        mask = (code.surface_body == SURFACE_ON_OBJECT) == on_object
        wrenches[mask] = _uncombined(rows[mask], on_object, surface, body, tip)
    result = wrenches[wanted]
    for place, row in enumerate(wanted):
        if code.kind[row] == COMBINED:
            first, count = code.first_part[row], code.parts[row]
            signs = np.array([1.0, -1.0])[:count, None, None]
            parts = signs * wrenches[first : first + count]
            result[place] = weights[row] * parts.sum(axis=0)
    return ContactMatrices(*(np.ascontiguousarray(result[:, k].T) for k in range(4)))


def _uncombined(
    rows: np.ndarray, on_object: bool, surface: np.ndarray, body: np.ndarray, tip: np.ndarray
) -> np.ndarray:
    """W_m, W_o and their rates of rows that are no combinations, shape (k, 4, 6)."""
    contacts = fields_of(ContactRow, rows)
    point, e = contacts.point, contacts.normal
    # world rates of the normal and of the point, from those seen from the guiding surface's body
    guiding, sign = fields_of(BodyMotion, surface), -1.0 if on_object else 1.0
    e_rate = sign * contacts.normal_rate + np.cross(guiding.spin, e)
    turning = np.cross(guiding.spin, point - guiding.origin)
    point_rate = guiding.velocity + turning + contacts.point_rate
    out = np.empty((len(rows), 4, 6))
    for column, frame, side in ((0, tip, -1.0), (1, body, 1.0)):
        motion = fields_of(BodyMotion, frame)
        R, spin, at = motion.rotation, motion.spin, point - motion.origin
        at_rate = point_rate - motion.velocity - np.cross(spin, at)
        p, p_dot = at @ R, at_rate @ R
        f, f_dot = side * e @ R, side * (e_rate - np.cross(spin, e)) @ R
        out[:, column] = np.hstack([f, np.cross(p, f)])
        out[:, column + 2] = np.hstack([f_dot, np.cross(p_dot, f) + np.cross(p, f_dot)])
    return out


@dataclass(frozen=True)
class RelativeMotion:
    """Pose and twist of a gripper relative to the object, in object axes.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Turns components in gripper axes into object axes.
    translation : ndarray, shape (3,)
        The gripper's origin seen from the object's [m].
    twist : ndarray, shape (6,)
        Rate of ``translation`` [m/s] and relative angular velocity [rad/s].
    """

    rotation: np.ndarray
    translation: np.ndarray
    twist: np.ndarray


def seen_from_object(
    X_WO: np.ndarray, twist_O: np.ndarray, X_WT: np.ndarray, twist_T: np.ndarray
) -> RelativeMotion:
    """The gripper's motion relative to the object.

    Parameters
    ----------
    X_WO, X_WT : ndarray, shape (4, 4)
        Poses of object and gripper in the world.
    twist_O, twist_T : ndarray, shape (6,)
        Velocities of their origins and angular velocities, world axes.
    """
    R_WO = X_WO[:3, :3]
    r = X_WT[:3, 3] - X_WO[:3, 3]
    velocity = twist_T[:3] - twist_O[:3] - np.cross(twist_O[3:], r)
    omega = twist_T[3:] - twist_O[3:]
    return RelativeMotion(
        rotation=R_WO.T @ X_WT[:3, :3],
        translation=R_WO.T @ r,
        twist=np.concatenate([R_WO.T @ velocity, R_WO.T @ omega]),
    )


def relative_wrenches(
    terms: ContactTerms, relative: RelativeMotion
) -> tuple[np.ndarray, np.ndarray]:
    """``W_m^o`` and its rate, both (6, N): wrenches on the gripper about its origin, object axes.

    ``W_m^o = blkdiag(R, R) W_m``, columns ``[-e_o; e_o x (p_o - x)]`` for contacts.
    """
    R, omega = relative.rotation, relative.twist[3:]
    W = _turned(R, terms.W_m)
    spin = np.vstack([np.cross(omega, W[:3], axisb=0).T, np.cross(omega, W[3:], axisb=0).T])
    return W, _turned(R, terms.W_m_dot) + spin


def gripper_twist(
    object_rotation: np.ndarray, object_twist: np.ndarray, relative: RelativeMotion
) -> np.ndarray:
    """Twist of the gripper in world axes, shape (6,) (thesis, 3.5).

    ``object_rotation`` (3, 3) turns object axes into world axes; ``object_twist`` is in these.
    """
    arm = object_rotation @ relative.translation
    carried = object_twist.astype(float)
    carried[:3] += np.cross(object_twist[3:], arm)
    return carried + _turned(object_rotation, relative.twist)


def gripper_acceleration(
    object_rotation: np.ndarray,
    object_twist: np.ndarray,
    object_acceleration: np.ndarray,
    relative: RelativeMotion,
    relative_acceleration: np.ndarray,
) -> np.ndarray:
    """Acceleration of the gripper (classical, world axes), shape (6,) (thesis, 3.6).

    The object's acceleration is classical too, in world axes; ``relative_acceleration`` is the rate
    of the components of the relative twist, ``T alpha' + T' alpha``.
    """
    omega, alpha = object_twist[3:], object_acceleration[3:]
    arm = object_rotation @ relative.translation
    sliding = _turned(object_rotation, relative.twist)
    carried = object_acceleration.astype(float)
    carried[:3] += np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
    carried[:3] += 2.0 * np.cross(omega, sliding[:3])
    carried[3:] += np.cross(omega, sliding[3:])
    return carried + _turned(object_rotation, relative_acceleration)


def _turned(R: np.ndarray, screws: np.ndarray) -> np.ndarray:
    """Twists or wrenches (6, ...) in the axes that ``R`` turns to."""
    return np.concatenate([R @ screws[:3], R @ screws[3:]])
