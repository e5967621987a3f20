"""Objects that are where their joints put them.

Of several objects, one without ``pose`` is placed by its first joint that says where: the joint has
``at`` and holds at the start, and its other body is the world, an object with a place, or a link of
a robot whose posture is written.  Both frames of the joint coincide then.  What no joint places is
at the world's origin.
"""

from __future__ import annotations

import numpy as np

from multiarm.assembly.postures import posture_of
from multiarm.assembly.robots import load_robot
from multiarm.robots.robot import Robot
from multiarm.scene import Pose, Scene
from multiarm.scene.bodies import BodyName
from multiarm.scene.joint_values import SOLVE
from multiarm.spatial import matrix_to_quaternion


def with_object_poses(scene: Scene) -> Scene:
    """The scene with the poses of the objects that it leaves to their joints."""
    bodies = scene.all_objects
    written = {name for name, body in bodies.items() if "pose" in body.model_fields_set}
    if len(bodies) < 2 or len(written) == len(bodies):
        return scene
    places = _Places(scene, {name: bodies[name].pose.matrix() for name in written})
    while (found := places.next_object()) is not None:
        places.objects |= found
    objects = {
        name: body.model_copy(update={"pose": _pose_spec(places.objects[name])})
        for name, body in bodies.items()
        if name in places.objects.keys() - written
    }
    return scene.model_copy(update={"objects": {**bodies, **objects}})


def _pose_spec(pose: np.ndarray) -> Pose:
    quaternion = matrix_to_quaternion(pose[:3, :3])
    return Pose(xyz=pose[:3, 3].tolist(), quaternion_xyzw=quaternion.tolist())


class _Places:
    """Where bodies are: ``objects`` has the poses (4, 4) of those that have a place."""

    def __init__(self, scene: Scene, objects: dict[str, np.ndarray]) -> None:
        self.objects, self._scene = objects, scene
        self._robots: dict[str, tuple[Robot, np.ndarray] | None] = {}

    def next_object(self) -> dict[str, np.ndarray] | None:
        """The first object without a place that a joint gives one, with its pose."""
        for joint in self._scene.joints:
            if joint.at is None or joint.as_listed or not joint.holds_at(0.0):
                continue
            first = joint.first, joint.on_first.matrix() @ joint.start_shift()
            second = joint.second, joint.at.matrix()
            for (body, frame), (other, place) in ((first, second), (second, first)):
                if not body.is_object or body.tip in self.objects:
                    continue
                pose = self._pose(other)
                if pose is not None:
                    return {body.tip: pose @ place @ np.linalg.inv(frame)}
        return None

    def _pose(self, body: BodyName) -> np.ndarray | None:
        if body.is_object:
            return self.objects.get(body.tip)
        if not body.is_link:
            return np.eye(4)
        if body.robot not in self._robots:
            self._robots[body.robot] = self._standing(body.robot)
        robot = self._robots[body.robot]
        return None if robot is None else robot[0].tip_pose(robot[1], body.tip)

    def _standing(self, name: str) -> tuple[Robot, np.ndarray] | None:
        """A robot with its posture; None where that is not written, nor then is a base."""
        if posture_of(self._scene, name)[1] in (None, SOLVE):
            return None
        resolved, robot = load_robot(self._scene, name)
        return robot, resolved.posture
