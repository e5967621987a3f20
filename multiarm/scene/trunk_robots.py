"""Arms on a trunk that moves, as the robot that they are.

The tips have the names of the arms, and so have the connections: the forces of the joint that is
written with ``arm: left`` are those of ``left``.  Joints are those of the robot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from multiarm.scene.bodies import BodyName

if TYPE_CHECKING:
    from multiarm.scene.joints import JointSpec
    from multiarm.scene.schema import Scene


def with_trunk_robots(scene: Scene) -> Scene:
    """The scene in which arms on a trunk that moves are robots; itself where there are none."""
    groups = [group for group in scene.arm_groups if group.robot is not None]
    if not groups:
        return scene
    robot_of = {arm: group.name for group in groups for arm in group.arms}
    arms = {name: arm for name, arm in scene.arms.items() if name not in robot_of}
    robots = {group.name: group.robot for group in groups}
    joints = tuple(_of_robots(joint, robot_of) for joint in scene.joints)
    parts = {"arms": arms, "robots": {**robots, **scene.robots}, "joints": joints}
    return scene.model_copy(update=parts)


def _of_robots(joint: JointSpec, robot_of: dict[str, str]) -> JointSpec:
    """A joint whose tips are those of robots, under its name in results."""
    bodies = joint.first, joint.second
    if not robot_of.keys() & {body.robot for body in bodies}:
        return joint
    names = [
        BodyName(robot_of[body.robot], body.robot) if body.robot in robot_of else body
        for body in bodies
    ]
    between = tuple(map(str, names))
    return joint.model_copy(update={"arm": "", "between": between, "name": joint.connection})
