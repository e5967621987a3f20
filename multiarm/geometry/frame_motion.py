"""How a floating frame moves: an object, or the base of a robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.public import public_names


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Pose and twist of an object at its centre of mass, or of a robot's floating base.

    The frame of a base is that of the robot's root link.

    Attributes
    ----------
    pose : ndarray, shape (7,)
        ``position``, ``quaternion_xyzw``.
    twist : ndarray, shape (6,)
        Velocity of the frame's origin [m/s] and angular velocity [rad/s], world axes.
    """

    pose: np.ndarray
    twist: np.ndarray

    __dir__ = public_names

    @property
    def position(self) -> np.ndarray:
        """Origin of the frame in world axes, shape (3,) [m]."""
        return self.pose[:3]

    @property
    def quaternion_xyzw(self) -> np.ndarray:
        """Orientation of the frame, scalar last, shape (4,)."""
        return self.pose[3:]
