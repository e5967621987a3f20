"""The joints of a scene: contact records, frames and limits, on the links that carry the tips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from multiarm.contacts.catalogue import FREE, joint_contacts, joint_frame, surface_offset
from multiarm.contacts.frames import JointFrame
from multiarm.contacts.records import Contact
from multiarm.errors import ModelError

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm
    from multiarm.scene import ResolvedArm, Scene


class JointParts(NamedTuple):
    """What a joint is made of.

    contacts : list of Contact
        The arm's geometry in the tip frame.
    frame : JointFrame
        Which motions it leaves free is left open where the catalogue does not say.
    limits : dict
        By component of the relative motion, see :attr:`multiarm.scene.JointBase.free_limits`.
    """

    contacts: list[Contact]
    frame: JointFrame
    limits: dict[int, tuple[float, float]]

    @property
    def remember(self) -> bool:
        """Whether a surface of the user's is among its contacts, which remembers where it was."""
        parts = [*self.contacts, *(c.minus for c in self.contacts if c.minus is not None)]
        return any(side.function is not None for part in parts for side in (part.arm, part.object))


@dataclass(frozen=True)
class Parts:
    """What a system was made of, by arm, so that others can be made of the same.

    Attributes
    ----------
    arms : mapping of str to ResolvedArm
    joints : mapping of str to JointParts
    """

    arms: Mapping[str, ResolvedArm]
    joints: Mapping[str, JointParts]


def make_joints(
    scene: Scene,
    arms: Mapping[str, Arm],
    resolved: Mapping[str, ResolvedArm],
    known: Mapping[str, JointParts],
) -> dict[str, JointParts]:
    """The joints of a scene by arm; those that are ``known`` are taken as they are.

    Raises
    ------
    ModelError
        Naming the joint that cannot be made.
    """
    specs = {joint.arm: joint for joint in scene.joints}
    return {
        name: known.get(name) or _joint(specs[name], scene, arm, resolved[name].posture)
        for name, arm in arms.items()
    }


def on_link(arm: Arm, contacts: list) -> list:
    """The contacts with the arm's geometry in the frame of the link that carries the tip."""
    return [contact.moved_on_arm(arm.tip_rotation, arm.tip_translation) for contact in contacts]


def _joint(joint: Any, scene: Scene, arm: Arm, posture: np.ndarray) -> JointParts:
    pose = _joint_pose(joint, scene, arm, posture)
    on_tip, on_object = joint_frame(joint, pose)
    frame = JointFrame(on_tip, on_object, FREE[joint.kind] or ())
    return JointParts(_contacts(joint, pose), frame, joint.free_limits)


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
