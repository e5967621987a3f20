r"""The kinds of joint as equations between two frames, from their textbook definitions.

Independent of the package's contacts: every kind is put together of two equations, with ``S`` the
joint frame on the second body, ``F`` that on the first, ``x`` their origins and ``w`` their angular
velocities, all in world axes.

* Displacement along an axis ``a`` of S: :math:`p = a \cdot d` with :math:`d = x_F - x_S`, and

  .. math::
      \dot p &= a \cdot (\dot x_F - \dot x_S) + w_S \cdot (a \times d) \\
      \ddot p &= a \cdot (\ddot x_F - \ddot x_S) + \dot w_S \cdot (a \times d)
      + (w_S \times (w_S \times a)) \cdot d + 2 (w_S \times a) \cdot (\dot x_F - \dot x_S)

* Cosine between an axis ``a`` of S and an axis ``b`` of F: :math:`k = a \cdot b`, and

  .. math::
      \dot k &= w_F \cdot (b \times a) + w_S \cdot (a \times b) \\
      \ddot k &= \dot w_F \cdot (b \times a) + \dot w_S \cdot (a \times b) \\
      &+ (w_S \times (w_S \times a)) \cdot b + (w_F \times (w_F \times b)) \cdot a
      + 2 (w_S \times a) \cdot (w_F \times b)

A distance is the norm of displacements.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

X, Y, Z = np.eye(3)


class FrameMotion(NamedTuple):
    """Where a frame is and how it moves, world axes.

    rotation : (3, 3)
    origin : (3,)
    twist : (6,), velocity of the origin and angular velocity
    jacobian : (6, n), twist by generalised velocities
    bias : (6,), classical acceleration of the origin and angular acceleration at generalised
        accelerations of zero
    """

    rotation: np.ndarray
    origin: np.ndarray
    twist: np.ndarray
    jacobian: np.ndarray
    bias: np.ndarray

    def placed(self, X: np.ndarray) -> FrameMotion:
        """The motion of a frame fixed to this one, at pose ``X`` (4, 4) in it."""
        arm = self.rotation @ X[:3, 3]
        w, shift = self.twist[3:], np.eye(6)
        shift[:3, 3:] = -skew(arm)
        centripetal = np.concatenate([np.cross(w, np.cross(w, arm)), np.zeros(3)])
        return FrameMotion(
            self.rotation @ X[:3, :3],
            self.origin + arm,
            shift @ self.twist,
            shift @ self.jacobian,
            shift @ self.bias + centripetal,
        )


class Equation(NamedTuple):
    """One equation of a joint: its value is to stay zero.

    value : float, [m] or a cosine
    by_first, by_second : (6,), rate by the twist of each frame
    bias : float, second derivative where both frames have no acceleration
    """

    value: float
    by_first: np.ndarray
    by_second: np.ndarray
    bias: float

    def rate(self, first: FrameMotion, second: FrameMotion) -> float:
        return float(self.by_first @ first.twist + self.by_second @ second.twist)


def skew(a: np.ndarray) -> np.ndarray:
    """S(a) b = a x b"""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def displacement(first: FrameMotion, second: FrameMotion, axis: np.ndarray) -> Equation:
    """Coordinate of F's origin along an axis of S."""
    a, d = second.rotation @ axis, first.origin - second.origin
    w, slip = second.twist[3:], first.twist[:3] - second.twist[:3]
    turning = np.cross(w, a)
    return Equation(
        value=float(a @ d),
        by_first=np.concatenate([a, np.zeros(3)]),
        by_second=np.concatenate([-a, np.cross(a, d)]),
        bias=float(np.cross(w, turning) @ d + 2.0 * turning @ slip),
    )


def cosine(
    first: FrameMotion, second: FrameMotion, on_second: np.ndarray, on_first: np.ndarray
) -> Equation:
    """Cosine between an axis of S and an axis of F."""
    a, b = second.rotation @ on_second, first.rotation @ on_first
    w_s, w_f = second.twist[3:], first.twist[3:]
    a_rate, b_rate = np.cross(w_s, a), np.cross(w_f, b)
    return Equation(
        value=float(a @ b),
        by_first=np.concatenate([np.zeros(3), np.cross(b, a)]),
        by_second=np.concatenate([np.zeros(3), np.cross(a, b)]),
        bias=float(np.cross(w_s, a_rate) @ b + np.cross(w_f, b_rate) @ a + 2.0 * a_rate @ b_rate),
    )


def distance(first: FrameMotion, second: FrameMotion, axes: np.ndarray, length: float) -> Equation:
    """Distance of F's origin from S's, measured along some axes of S, less ``length``."""
    parts = [displacement(first, second, axis) for axis in axes]
    values = np.array([part.value for part in parts])
    rates = np.array([part.rate(first, second) for part in parts])
    norm = float(np.linalg.norm(values))
    along = values / norm
    bias = along @ [part.bias for part in parts] + (rates @ rates - (along @ rates) ** 2) / norm
    return Equation(
        value=norm - length,
        by_first=along @ [part.by_first for part in parts],
        by_second=along @ [part.by_second for part in parts],
        bias=float(bias),
    )


def turned_to(axis: Any) -> np.ndarray:
    """A rotation (3, 3) whose third column is along ``axis``."""
    z = np.array(axis, dtype=float) / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def joint_axis(joint: dict[str, Any]) -> np.ndarray:
    """Direction of the joint's axis or normal in its frames, z where none is written."""
    return np.array(joint.get("axis", joint.get("normal", Z)), dtype=float)


def reach(joint: dict[str, Any]) -> float:
    """Distance of a fingertip's centre from the axis or the centre of its face [m]."""
    tip = joint.get("tip_radius", 0.0)
    return joint["radius"] - tip if joint.get("inside") else joint["radius"] + tip


_ALONG = {
    "weld": (X, Y, Z), "ball": (X, Y, Z), "revolute": (X, Y, Z), "prismatic": (X, Y),
    "cylindrical": (X, Y), "universal": (X, Y, Z), "planar": (Z,),
}  # fmt: skip
_ALIGNED, _LINE = ((X, Y), (Y, Z), (Z, X)), ((X, Z), (Y, Z))
# Axis of S and axis of F that stay perpendicular.
_PERPENDICULAR: dict[str, tuple] = {
    "weld": _ALIGNED, "ball": (), "revolute": _LINE, "prismatic": _ALIGNED,
    "cylindrical": _LINE, "universal": ((X, Y),), "planar": ((Z, X), (Z, Y)),
}  # fmt: skip
LOWER_PAIRS = tuple(_ALONG)
FINGERTIPS = ("point_on_plane", "point_on_cylinder", "point_on_sphere")


def joint_equations(
    joint: dict[str, Any], first: FrameMotion, second: FrameMotion
) -> list[Equation]:
    """The equations of a joint of a scene between its two frames."""
    kind, turn = joint["kind"], np.eye(4)
    turn[:3, :3] = turned_to(joint_axis(joint)) if kind != "universal" else np.eye(3)
    first, second = first.placed(turn), second.placed(turn)
    if kind == "point_on_plane":
        height = displacement(first, second, Z)
        return [height._replace(value=height.value - joint.get("tip_radius", 0.0))]
    if kind == "point_on_cylinder":
        return [distance(first, second, np.array([X, Y]), reach(joint))]
    if kind == "point_on_sphere":
        return [distance(first, second, np.eye(3), reach(joint))]
    return [displacement(first, second, axis) for axis in _ALONG[kind]] + [
        cosine(first, second, on_second, on_first) for on_second, on_first in _PERPENDICULAR[kind]
    ]
