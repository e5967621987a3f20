"""The robots of a scene: its arms on their bases, and what computes their dynamics.

Arms that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from multiarm.assembly.bases import DECIMALS, Standing, find_bases
from multiarm.assembly.blocks import robots_together
from multiarm.assembly.postures import find_postures, robots_in_joints
from multiarm.control.program import needs_gravity_torque
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, SceneError
from multiarm.geometry.records import Placement
from multiarm.robots.backends import Backends
from multiarm.robots.robot import Robot, RobotFiles
from multiarm.scene import (
    ArmSpec,
    ResolvedRobot,
    RobotSpec,
    Scene,
    resolve_arm,
    resolve_robot,
)
from multiarm.scene.bodies import BodyName
from multiarm.scene.faults import Parts, fault_at
from multiarm.scene.joint_values import SOLVE
from multiarm.scene.robot_spec import RobotBaseSpec, in_order


@dataclass(frozen=True)
class Robots:
    """The robots of a scene."""

    resolved: dict[str, ResolvedRobot]
    by_name: dict[str, Robot]
    postures: dict[str, np.ndarray]  # (n,) [rad, m] at the start: found, or as written
    shared: tuple[str, ...]  # robots that another system has too

    def pose(self, scene: Scene, body: BodyName) -> np.ndarray:
        """Pose of a body's frame at the start as written, of a link that of its tip, (4, 4)."""
        if body.is_object:
            return scene.all_objects[body.tip].pose.matrix()
        if not body.is_link:
            return np.eye(4)
        return self.by_name[body.robot].tip_pose(self.postures[body.robot], body.tip)

    def groups(self, connections: Iterable[Connection]) -> list[dict[str, Robot]]:
        """The robots in groups that are joined to each other; most are alone."""
        groups = robots_together(self.by_name, (pair.robots for pair in connections))
        return [{name: self.by_name[name] for name in group} for group in groups]

    def placement(self, body: BodyName) -> Placement | None:
        """Of a tip on the joint that carries it: rotation, translation; None of another body."""
        if not body.is_link:
            return None
        tip = self.by_name[body.robot].tips[body.tip]
        return tip.rotation, tip.translation


def with_bases(scene: Scene) -> Scene:
    """The scene with the bases that it leaves to the program; the postures there are to be found.

    Raises
    ------
    SceneError
        Naming every arm or robot for which there is no place.
    """
    if any(spec.open_base for spec in scene.arms.values()):
        scene = _with_bases_of_arms(scene)
    if any(spec.open_base for spec in scene.robots.values()):
        scene = _with_bases_of_robots(scene)
    return scene


def _with_bases_of_arms(scene: Scene) -> Scene:
    arms, standing = {}, {}
    for name, spec in scene.arms.items():
        resolved = resolve_arm(spec, scene.folder)
        arm = _make_robot(name, scene, resolved)
        if spec.open_base:
            arms[name] = arm
        elif spec.posture not in (None, SOLVE):
            standing[name] = Standing(arm, resolved.posture)
    specs = {
        name: scene.arms[name].model_copy(update={"base": base, "posture": SOLVE})
        for name, base in find_bases(scene, arms, standing).items()
    }
    return scene.model_copy(update={"arms": {**scene.arms, **specs}})


def _with_bases_of_robots(scene: Scene) -> Scene:
    """Bases of robots are found like those that move, with joints where they may vary."""
    open_ones = {name: spec for name, spec in scene.robots.items() if spec.open_base}
    in_joints = robots_in_joints(scene)
    idle = [name for name in open_ones if name not in in_joints]
    if idle:
        text = "no joint says where the robot is; add one that has 'at', or remove 'solve'"
        raise SceneError([fault_at(("robots", name, "base", "solve"), text) for name in idle])
    moving = {}
    for name, spec in open_ones.items():
        place = spec.base.model_dump(include={"xyz", "rpy", "quaternion_xyzw"})
        base = RobotBaseSpec(**place, moves=in_order(spec.open_base))
        moving[name] = spec.model_copy(update={"base": base, "posture": SOLVE})
    try:
        robots = load_robots(scene.model_copy(update={"robots": {**scene.robots, **moving}}))
    except SceneError as error:  # of bases that are found, nobody wrote a posture
        sought: dict[Parts, Parts] = {
            ("robots", name, "posture"): ("robots", name, "base", "solve") for name in moving
        }
        faults = [(sought.get(fault.parts, fault.parts), fault.problem) for fault in error.faults]
        raise SceneError([fault_at(*fault) for fault in faults]) from None
    found = {}
    for name, spec in open_ones.items():
        # the joints of the base are the first ones
        displacement = robots.postures[name].round(DECIMALS)[: len(spec.open_base)]
        base = spec.base.displaced(dict(zip(in_order(spec.open_base), displacement, strict=True)))
        found[name] = spec.model_copy(update={"base": base, "posture": SOLVE})
    return scene.model_copy(update={"robots": {**scene.robots, **found}})


def load_robots(scene: Scene, like: System | None = None, seek: bool = True) -> Robots:
    """The robots of a scene; equal ones of ``like`` are shared, missing postures sought."""
    shared: tuple[str, ...] = ()
    if like is not None and scene.effects.rotor_inertia == like.scene.effects.rotor_inertia:
        arms_of_like = like.scene.arms
        shared = tuple(
            name
            for name, spec in scene.arms.items()
            if arms_of_like.get(name) == spec
            and like.scene.group_of(name).lock == scene.group_of(name).lock
        )
        shared += tuple(
            name
            for name, spec in scene.robots.items()
            if like.scene.robots.get(name) == spec
            and like.scene.links_in_joints(name) == scene.links_in_joints(name)
        )
    resolved, robots = {}, {}
    for name in robots_in_order(scene):
        if like is not None and name in shared:
            resolved[name], robots[name] = like.model.resolved_robots[name], like.model.robots[name]
        else:
            resolved[name], robots[name] = load_robot(scene, name)
    postures = {name: robot.posture for name, robot in resolved.items()}
    if seek:
        postures |= find_postures(scene, robots, resolved)
    return Robots(resolved, robots, postures, shared)


def robots_in_order(scene: Scene) -> list[str]:
    """The robots in the order of the equations: as written, those joined to each other together."""
    bodies = ((joint.first, joint.second) for joint in scene.joints)
    pairs = ({body.robot for body in pair if body.is_link} for pair in bodies)
    groups = robots_together((*scene.arms, *scene.robots), pairs)
    return [name for group in groups for name in group]


def load_robot(scene: Scene, name: str) -> tuple[ResolvedRobot, Robot]:
    """An arm or a robot of the scene, with its files, joints and start as written."""
    resolved = _resolved(scene, name)
    return resolved, _make_robot(name, scene, resolved)


def _resolved(scene: Scene, name: str) -> ResolvedRobot:
    """Files, joints and start of an arm or a robot of the scene."""
    if name in scene.robots:
        return resolve_robot(scene.robots[name], scene.links_in_joints(name), scene.folder)
    spec = scene.arms[name]
    locked = spec.model_copy(update={"lock": scene.group_of(name).lock | spec.lock})
    return resolve_arm(locked, scene.folder)


def backends_of(scene: Scene, robots: Robots, like: System | None = None) -> Backends:
    """Backends of the dynamics; shared where ``like`` has equal robots."""
    gravity, with_torque = gravity_of(scene), needs_gravity_torque(scene)
    names = robots_in_order(scene)
    if like is not None and {*robots.shared} == {*names} and names == list(like.model.robots):
        same_gravity = scene.gravity == like.scene.gravity
        same_backends = scene.run.arms == like.scene.run.arms
        same_terms = with_torque == needs_gravity_torque(like.scene)
        if same_gravity and same_backends and same_terms:
            return like.model.backends
    return Backends(robots.by_name, gravity, with_torque, scene.run.arms == "compiled")


def robot_files(spec: ArmSpec | RobotSpec, resolved: ResolvedRobot) -> RobotFiles:
    """Files and frames of an arm or a robot of a scene."""
    tool = spec.tool if isinstance(spec, ArmSpec) else None
    return RobotFiles(
        urdf=resolved.urdf,
        package_dirs=resolved.package_dirs,
        base=spec.base.matrix(),
        tips=resolved.tips,
        base_joints=resolved.base_joints,
        base_floats=resolved.base_floats,
        base_mass=resolved.base_mass,
        base_inertia=resolved.base_inertia,
        locked=resolved.locked,
        tool_urdf=resolved.tool_urdf,
        tool_package_dirs=resolved.tool_package_dirs,
        mount=tool.mount if tool is not None else None,
        tool_placement=tool.at.matrix() if tool is not None else None,
        mjcf=resolved.mjcf,
    )


def _make_robot(name: str, scene: Scene, resolved: ResolvedRobot) -> Robot:
    spec = scene.robots[name] if name in scene.robots else scene.arms[name]
    rotors = scene.effects.rotor_inertia
    inertia = None
    if rotors is not None:
        from multiarm.effects.rotor_inertia import of_arm

        inertia = of_arm(rotors, name, resolved.joint_names)
    robot = Robot(name, robot_files(spec, resolved), spec.color, inertia)
    if robot.joint_names != resolved.joint_names:
        raise ModelError(
            f"{robot.text}: Pinocchio orders its joints {robot.joint_names}, the URDF's order is "
            f"{resolved.joint_names}; give them names in order"
        )
    return robot


def gravity_of(scene: Scene) -> np.ndarray:
    """Acceleration of free fall, world axes (3,) [m/s^2]; zero where the scene has no gravity."""
    return np.array(scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0))
