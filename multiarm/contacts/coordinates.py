r"""Coordinates of a relative motion: what the rates alpha of a joint are.

The relative twist ``v`` of a gripper (velocity of its origin, angular velocity, both relative to
the object and in object axes) has six components; a joint leaves fewer free.  The rates that tell
its motion are a linear choice ``alpha = S v`` (thesis, 3.8.1).  Besides rows of the twist there are

* rates of Euler angles: ``omega = E theta'``, so that ``S`` has rows of ``[0, E^-1]``;
* components at the joint's own centre, along its own axes: the angle of a hinge, whatever the
  gripper's origin does meanwhile.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiarm.contacts.gripper import RelativeMotion
from multiarm.errors import GraspError

if TYPE_CHECKING:
    from multiarm.contacts.frames import JointFrame

# Rows of a twist: velocities of the origin along the axes, turns about them.
ROW_NAMES = ("slide x", "slide y", "slide z", "turn x", "turn y", "turn z")
# Coordinates whose smallest singular value on the free motions is below this cannot serve.
COORDINATE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Selection:
    """Which rates ``alpha = S v`` of a relative twist are meant.

    Attributes
    ----------
    matrix : ndarray, shape (m, 6)
        ``S``; ``v = [velocity of the gripper's origin; angular velocity]``, object axes.
    rate : ndarray, shape (m, 6)
        ``dS/dt``.
    labels : tuple of str
        What the rates are, for messages.
    """

    matrix: np.ndarray
    rate: np.ndarray
    labels: tuple[str, ...]


def euler_selection(
    angles: np.ndarray,
    rates: np.ndarray | None = None,
    sequence: str = "zxz",
    chosen: Sequence[int] = (0, 1),
) -> Selection:
    r"""Rates of Euler angles as ``alpha``.

    The gripper's orientation in the object is ``R = R_1(theta_1) R_2(theta_2) R_3(theta_3)`` about
    the axes of the sequence, so that ``omega = E theta'`` and ``theta' = E^{-1} omega``.

    Parameters
    ----------
    angles, rates : ndarray, shape (3,)
        ``theta`` [rad] and ``theta'`` [rad/s]; ``T_dot`` needs the latter.
    sequence : str
        Three letters of x, y, z, neighbours different.
    chosen : sequence of int
        Which of the three rates are ``alpha``.

    Raises
    ------
    GraspError
        At the singular orientation of the angles.
    """
    E, E_dot = euler_rates(angles, np.zeros(3) if rates is None else rates, sequence)
    if not np.linalg.cond(E) < 1.0 / COORDINATE_TOLERANCE:
        raise GraspError(
            f"the Euler angles {sequence} have no rates at {np.asarray(angles).tolist()} rad: two "
            f"of their axes coincide; take another sequence"
        )
    inverse = np.linalg.inv(E)
    matrix, rate = np.zeros((3, 6)), np.zeros((3, 6))
    matrix[:, 3:], rate[:, 3:] = inverse, -inverse @ E_dot @ inverse
    picked = list(chosen)
    labels = tuple(f"Euler angle {k + 1} of {sequence}" for k in picked)
    return Selection(matrix[picked], rate[picked], labels)


def euler_rates(
    angles: np.ndarray, rates: np.ndarray, sequence: str = "zxz"
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix ``E`` with ``omega = E theta'`` and its rate, both of shape (3, 3).

    Column k is the axis of turn k in the axes of the fixed body.
    """
    valid = len(sequence) == 3 and set(sequence) <= set("xyz")
    if not valid or any(a == b for a, b in itertools.pairwise(sequence)):
        raise GraspError(
            f"Euler angles turn about three of x, y, z, no two neighbours alike (zxz, zxy, ...), "
            f"not {sequence!r}"
        )
    E, E_dot = np.zeros((3, 3)), np.zeros((3, 3))
    turned, omega = np.eye(3), np.zeros(3)
    for k, (letter, angle, rate) in enumerate(zip(sequence, angles, rates, strict=True)):
        number = "xyz".index(letter)
        # this axis turns with the rotations before it
        E[:, k] = turned[:, number]
        E_dot[:, k] = np.cross(omega, E[:, k])
        omega = omega + rate * E[:, k]
        turned = turned @ _turn(number, angle)
    return E, E_dot


def joint_selection(frame: JointFrame, relative: RelativeMotion) -> Selection:
    r"""The free components of a joint, at its own origin and along its own axes, as ``alpha``.

    With ``r = R x_J`` the joint's origin on the gripper as seen from the gripper's origin, it moves
    with ``v + omega x r``; the joint's axes are fixed in the object.

    Parameters
    ----------
    frame : JointFrame
    relative : RelativeMotion
        Its rotation places ``r``, its angular velocity turns it.
    """
    axes = frame.on_object[:3, :3]
    arm = relative.rotation @ frame.on_tip[:3, 3]
    matrix, rate = np.zeros((6, 6)), np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = axes.T
    matrix[:3, 3:] = -axes.T @ _cross_matrix(arm)
    rate[:3, 3:] = -axes.T @ _cross_matrix(np.cross(relative.twist[3:], arm))
    free = list(frame.free)
    return Selection(matrix[free], rate[free], tuple(f"{k} of the joint" for k in frame.labels))


def _cross_matrix(a: np.ndarray) -> np.ndarray:
    """``S(a)`` with ``S(a) b = a x b``."""
    return np.cross(np.eye(3), a)


def _turn(axis: int, angle: float) -> np.ndarray:
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = c
    R[j, k], R[k, j] = -s, s
    return R
