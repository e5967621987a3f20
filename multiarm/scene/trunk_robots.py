"""Arms on a trunk that moves, as the robot that they are.

The tips have the names of the arms, and so have the connections: the forces of the joint that is
written with ``arm: left`` are those of ``left``.  Joints are those of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from multiarm.scene.arms import ArmSpec
from multiarm.scene.bodies import BodyName
from multiarm.scene.joints import JointSpec
from multiarm.scene.robot_spec import RobotSpec
from multiarm.scene.trunks import ArmGroup


def parts_with_trunk_robots(
    groups: Sequence[ArmGroup],
    arms: Mapping[str, ArmSpec],
    robots: Mapping[str, RobotSpec],
    joints: Sequence[JointSpec],
) -> dict[str, Any]:
    """The parts of a scene that differ where arms are robots; empty where none are."""
    of_groups = {group.name: group.robot for group in groups if group.robot is not None}
    if not of_groups:
        return {}
    robot_of = {arm: group.name for group in groups if group.robot for arm in group.arms}
    return {
        "arms": {name: arm for name, arm in arms.items() if name not in robot_of},
        "robots": {**of_groups, **robots},
        "joints": tuple(_of_robots(joint, robot_of) for joint in joints),
    }


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
    written = {"arm": "", "object": None, "between": between, "name": joint.connection}
    return joint.model_copy(update=written)
