"""How the floating base of a robot moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.public import public_names


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Pose and twist of a robot's floating base, the frame of its root link.

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
