"""Where the bodies of a scene are, at one state or at the samples of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.geometry.frame_motion import FrameMotion
from multiarm.scene.bodies import BodyName, object_named
from multiarm.spatial import quaternion_to_matrix
from multiarm.viewer.animation import rotations

if TYPE_CHECKING:
    from multiarm.dynamics.state import State
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import FrameChannels, Trajectory


class BodyPoses:
    """Poses of bodies at K samples of a run.

    Attributes
    ----------
    rows : ndarray, shape (K,)
        The samples.
    configurations : dict robot -> ndarray, shape (K, nq)
        Pinocchio's, see :meth:`multiarm.robots.robot.Robot.configuration`.
    """

    def __init__(self, system: System, trajectory: Trajectory, rows: np.ndarray) -> None:
        self._system, self.rows = system, rows
        positions, bases = trajectory.joint_positions, trajectory.bases
        self._angles = {name: positions[name][rows] for name in system.arm_names}
        self._bases = {
            name: _base_motions(bases[name], rows) if name in bases else [None] * len(rows)
            for name in system.arm_names
        }
        self.configurations = {
            name: np.array([arm.configuration(*at) for at in self._states_of(name)])
            for name, arm in system.arms.items()
        }
        self._of_bodies = {
            object_named(name): _poses(motion, rows) for name, motion in trajectory.objects.items()
        }

    def of(self, body: BodyName) -> np.ndarray:
        """World poses of a body, of a link those of its tip, shape (K, 4, 4)."""
        if body not in self._of_bodies:
            self._of_bodies[body] = self._placed(body)
        return self._of_bodies[body]

    def _placed(self, body: BodyName) -> np.ndarray:
        if not body.is_link:
            return np.tile(np.eye(4), (len(self.rows), 1, 1))
        arm, states = self._system.arms[body.robot], self._states_of(body.robot)
        return np.array([arm.tip_pose(angles, body.tip, base) for angles, base in states])

    def _states_of(self, robot: str) -> Iterator[tuple[np.ndarray, FrameMotion | None]]:
        """Joint positions, and the motion of the base where it floats, sample by sample."""
        return zip(self._angles[robot], self._bases[robot], strict=True)


def _poses(motion: FrameChannels, rows: np.ndarray) -> np.ndarray:
    """Poses of a frame at some samples, shape (K, 4, 4)."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = rotations(motion.quaternion_xyzw[rows])
    poses[:, :3, 3] = motion.position[rows]
    return poses


def _base_motions(base: FrameChannels, rows: np.ndarray) -> list[FrameMotion | None]:
    poses = np.hstack([base.position[rows], base.quaternion_xyzw[rows]])
    return [FrameMotion(pose, twist) for pose, twist in zip(poses, base.twist[rows], strict=True)]


def positions_at(trajectory: Trajectory, row: int) -> dict[str, Any]:
    """Arguments of :meth:`multiarm.System.state` for the positions of a sample."""
    return {
        "objects": _placed(trajectory.objects, row),
        "joint_positions": {name: q[row] for name, q in trajectory.joint_positions.items()},
        "bases": _placed(trajectory.bases, row),
    }


def _placed(motions: Mapping[str, FrameChannels], row: int) -> dict[str, dict[str, np.ndarray]]:
    return {
        name: {"position": motion.position[row], "quaternion_xyzw": motion.quaternion_xyzw[row]}
        for name, motion in motions.items()
    }


def pose_at(system: System, state: State, body: BodyName) -> np.ndarray:
    """World pose of a body at a state, of a link that of its tip, shape (4, 4)."""
    if body.is_link:
        positions, base = state.joint_positions[body.robot], state.bases.get(body.robot)
        return system.arms[body.robot].tip_pose(positions, body.tip, base)
    pose = np.eye(4)
    if body.is_object:
        motion = state.objects[body.tip]
        pose[:3, :3] = quaternion_to_matrix(motion.quaternion_xyzw)
        pose[:3, 3] = motion.position
    return pose
