"""Poses as homogeneous transforms."""

from __future__ import annotations

import numpy as np


def pose_matrix(rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The pose (4, 4) of a frame whose axes are turned by (3, 3) and whose origin is at (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, origin
    return pose
