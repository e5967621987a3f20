r"""The gripper as seen from the object, and its motion in the world (thesis, 3.5 and 3.6).

With ``x`` the gripper's origin in object axes, ``r = R_o x`` and the relative twist
``v = [x'; omega]`` in object axes, the gripper's twist and acceleration in the world are

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

import numpy as np

from multiarm.contacts.matrices import ContactTerms


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

    Parameters
    ----------
    object_rotation : ndarray, shape (3, 3)
        Turns object axes into world axes.
    object_twist : ndarray, shape (6,)
        World axes.
    relative : RelativeMotion
        With the twist ``T alpha``.
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

    Parameters
    ----------
    object_rotation, object_twist, relative
        As for :func:`gripper_twist`.
    object_acceleration : ndarray, shape (6,)
        World axes, classical.
    relative_acceleration : ndarray, shape (6,)
        Rate of the components of the relative twist, ``T alpha' + T' alpha``.
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
