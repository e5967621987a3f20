"""What a scene has in common with that of a system, so that it need not be made anew.

A part may be shared where it is written alike, and so is all that it is made from.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from multiarm.arms.arm import Arm
from multiarm.arms.backends import ArmBackends
from multiarm.assembly.joints import JointParts
from multiarm.assembly.system import System
from multiarm.control.laws import needs_gravity_torque
from multiarm.scene import ResolvedArm, Scene


def same_arms(scene: Scene, like: System | None) -> dict[str, tuple[ResolvedArm, Arm]]:
    """Arms of another system that this scene has too, as they were resolved and made."""
    if like is None or scene.effects.rotor_inertia != like.scene.effects.rotor_inertia:
        return {}
    theirs = like.scene.arms
    same = (name for name, spec in scene.arms.items() if theirs.get(name) == spec)
    return {name: (like.parts.arms[name], like.arms[name]) for name in same}


def same_joints(scene: Scene, known: Iterable[str], like: System | None) -> dict[str, JointParts]:
    """Joints of another system that this scene has too, on the arms ``known`` to be the same."""
    if like is None:
        return {}
    # without a place of its own a joint is where the tip meets the object
    moved = scene.object.pose != like.scene.object.pose
    theirs = {joint.arm: joint for joint in like.scene.joints}
    return shared(
        like.parts.joints,
        [
            joint.arm
            for joint in scene.joints
            if joint.arm in known
            and joint == theirs[joint.arm]
            and not (moved and joint.at is None)
        ],
    )


def same_backends(scene: Scene, known: Iterable[str], like: System | None) -> ArmBackends | None:
    """The backends of the arms, where they all are another system's."""
    if like is None or list(known) != list(like.arms) or list(known) != list(scene.arms):
        return None
    theirs = like.scene
    same = scene.gravity == theirs.gravity and scene.run.arms == theirs.run.arms
    if not same or needs_gravity_torque(scene) != needs_gravity_torque(theirs):
        return None
    return like._backends.twin()


def shared(joints: Mapping[str, JointParts], names: Iterable[str]) -> dict[str, JointParts]:
    """Joints that several systems can share: a surface of the user's remembers where it was."""
    return {name: joints[name] for name in names if not joints[name].remember}
