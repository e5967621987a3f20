"""The joints of a scene: contact records, frames and limits, on the links that carry the tips."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.contacts.catalogue import CATALOGUE, joint_contacts, joint_frame, surface_offset
from multiarm.contacts.joint import Joint, JointFrame
from multiarm.contacts.records import Contact
from multiarm.errors import ModelError
from multiarm.scene import ResolvedArm, Scene


def make_joints(
    scene: Scene,
    arms: Mapping[str, Arm],
    resolved: Mapping[str, ResolvedArm],
    shared: Mapping[str, Joint],
) -> dict[str, Joint]:
    """The joints of a scene by arm; those that are ``shared`` are taken as they are.

    Raises
    ------
    ModelError
        Naming the joint that cannot be made.
    """
    specs = {joint.arm: joint for joint in scene.joints}
    return {
        name: shared.get(name) or _joint(specs[name], scene, arm, resolved[name].posture)
        for name, arm in arms.items()
    }


def on_link(arm: Arm, contacts: list) -> list:
    """The contacts with the arm's geometry in the frame of the link that carries the tip."""
    return [contact.moved_on_arm(arm.tip_rotation, arm.tip_translation) for contact in contacts]


def _joint(joint: Any, scene: Scene, arm: Arm, posture: np.ndarray) -> Joint:
    pose = _joint_pose(joint, scene, arm, posture)
    on_tip, on_object = joint_frame(joint, pose)
    frame = JointFrame(on_tip, on_object, CATALOGUE[joint.kind].free or ())
    return Joint(_contacts(joint, pose), frame, joint.free_limits)


def _contacts(joint: Any, pose: np.ndarray) -> list[Contact]:
    try:
        return joint_contacts(joint, pose)
    except ModelError as error:
        raise ModelError(f"joint of arm '{joint.arm}': {error}") from error


def _joint_pose(joint: Any, scene: Scene, arm: Arm, posture: np.ndarray) -> np.ndarray:
    """Joint frame in the object frame (4, 4); without ``at``, where the tip is at the start."""
    if joint.at is not None:
        return joint.at.matrix()
    offset = np.eye(4)
    offset[:3, 3] = surface_offset(joint)
    frame = arm.tip_pose(posture) @ joint.at_tip.matrix() @ offset
    return np.linalg.solve(scene.object.pose.matrix(), frame)
