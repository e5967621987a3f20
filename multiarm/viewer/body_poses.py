"""Where the bodies of a scene are, at one state or at the samples of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multiarm.scene.bodies import OBJECT, BodyName
from multiarm.spatial import quaternion_to_matrix
from multiarm.viewer.animation import rotations

if TYPE_CHECKING:
    from multiarm.dynamics.state import State
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory


class BodyPoses:
    """Poses of bodies at K samples of a run.

    Attributes
    ----------
    rows : ndarray, shape (K,)
        The samples.
    angles : dict robot -> ndarray, shape (K, n)
        Joint positions [rad] or [m].
    """

    def __init__(self, system: System, trajectory: Trajectory, rows: np.ndarray) -> None:
        self._system, self.rows = system, rows
        positions = trajectory.joint_positions
        self.angles = {name: positions[name][rows] for name in system.arm_names}
        self._of_bodies = {OBJECT: np.tile(np.eye(4), (len(rows), 1, 1))}
        self._of_bodies[OBJECT][:, :3, :3] = rotations(trajectory.object_quaternion_xyzw[rows])
        self._of_bodies[OBJECT][:, :3, 3] = trajectory.object_position[rows]

    def of(self, body: BodyName) -> np.ndarray:
        """World poses of a body, of a link those of its tip, shape (K, 4, 4)."""
        if body not in self._of_bodies:
            self._of_bodies[body] = self._placed(body)
        return self._of_bodies[body]

    def _placed(self, body: BodyName) -> np.ndarray:
        if not body.is_link:
            return np.tile(np.eye(4), (len(self.rows), 1, 1))
        arm = self._system.arms[body.robot]
        return np.array([arm.tip_pose(row, body.tip) for row in self.angles[body.robot]])


def pose_at(system: System, state: State, body: BodyName) -> np.ndarray:
    """World pose of a body at a state, of a link that of its tip, shape (4, 4)."""
    if body.is_link:
        positions = state.joint_positions[body.robot]
        return system.arms[body.robot].tip_pose(positions, body.tip)
    pose = np.eye(4)
    if body == OBJECT:
        pose[:3, :3] = quaternion_to_matrix(state.object_quaternion_xyzw)
        pose[:3, 3] = state.object_position
    return pose
