"""From the joints of a scene to the hinges of a film: which have an axis, and where it is.

A joint's frame has the axis as its z axis (:class:`multiarm.contacts.joint.JointFrame`).  Turn and
slide are read off the poses of object and tip, so that they are what the picture shows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.contacts.joint import axis_travel, limits_of
from multiarm.viewer.film import Dial, HingeTracks, rotations

if TYPE_CHECKING:
    from multiarm.contacts.joint import JointFrame
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import JointSpec

# Kinds that are drawn as one thing on the object; a universal joint has two axles.
SHAPES = {"revolute": "axle", "prismatic": "rail", "cylindrical": "sleeve", "ball": "ball"}
CYCLE = np.eye(4)[[2, 0, 1, 3]]  # its columns are the axes y, z, x: F @ CYCLE has z along F's x
CENTRED = 0.05  # an axis that passes the object's centre nearer than this, of its distance


def hinges_of(
    system: System, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[HingeTracks]:
    """Return what is to be seen of all joints at some samples (`rows`) of a run."""
    object_poses = np.tile(np.eye(4), (len(rows), 1, 1))
    object_poses[:, :3, :3] = rotations(trajectory.object_quaternion_xyzw[rows])
    object_poses[:, :3, 3] = trajectory.object_position[rows]
    hinges = []
    for joint in system.scene.joints:
        if joint.kind not in SHAPES and joint.kind != "universal":
            continue
        arm, frame = system.arms[joint.arm], system.frames[joint.arm]
        angles = trajectory.joint_positions[joint.arm][rows]
        tip_poses = np.array([arm.tip_pose(row) for row in angles])
        hinges += _hinges(joint, frame, object_poses, tip_poses, colors[joint.arm])
    return hinges


def _hinges(
    joint: JointSpec,
    frame: JointFrame,
    object_poses: np.ndarray,
    tip_poses: np.ndarray,
    color: np.ndarray,
) -> list[HingeTracks]:
    on_object, on_tip = object_poses @ frame.on_object, tip_poses @ frame.on_tip  # (K, 4, 4)
    if joint.kind == "universal":  # about the object's x and the arm's y axis
        axles = (on_object @ CYCLE, on_tip @ CYCLE.T)
        return [
            HingeTracks(joint.arm, f"{joint.arm}/{k}", "axle", color, *_placed(axle))
            for k, axle in enumerate(axles, start=1)
        ]
    turn, slide = axis_travel(on_object, on_tip)
    dials = tuple(
        Dial(limit.turns, (limit.low, limit.high), turn if limit.turns else slide)
        for limit in limits_of(joint)
    )
    placed = _placed(on_object @ _turned_outwards(frame.on_object))
    return [HingeTracks(joint.arm, joint.arm, SHAPES[joint.kind], color, *placed, dials)]


def _turned_outwards(on_object: np.ndarray) -> np.ndarray:
    """Return the turn about z after which x points away from the object's centre, where a sector
    is seen best; none where the axis passes through the centre.
    """
    x, y, _ = on_object[:3, :3].T @ on_object[:3, 3]
    turn, away = np.eye(4), np.hypot(x, y)
    if away > CENTRED * np.linalg.norm(on_object[:3, 3]):
        turn[:2, :2] = np.array([[x, -y], [y, x]]) / away
    return turn


def _placed(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (K, 3) and quaternions (K, 4), scalar last, of poses (K, 4, 4)."""
    packed = np.array([pin.SE3ToXYZQUAT(pin.SE3(pose)) for pose in poses])
    return packed[:, :3], packed[:, 3:]
