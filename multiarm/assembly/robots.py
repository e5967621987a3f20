"""The robots of a scene: its arms on their bases, and what computes their dynamics.

Arms that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.arms.arm import Arm, ArmFiles
from multiarm.arms.backends import ArmBackends
from multiarm.assembly.bases import Standing, find_bases
from multiarm.assembly.postures import find_postures
from multiarm.control.program import needs_gravity_torque
from multiarm.dynamics.connections import Body
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, SceneError
from multiarm.geometry.records import Placement
from multiarm.scene import ArmSpec, ResolvedRobot, Scene, resolve_arm
from multiarm.scene.faults import fault_at
from multiarm.scene.joint_values import SOLVE


@dataclass(frozen=True)
class Robots:
    """The arms of a scene."""

    resolved: dict[str, ResolvedRobot]
    arms: dict[str, Arm]
    postures: dict[str, np.ndarray]  # (n,) [rad, m] at the start: found, or as written
    shared: tuple[str, ...]  # arms that another system has too

    def placement(self, body: Body) -> Placement | None:
        """Of a tip on the joint that carries it: rotation, translation; None of another body."""
        if not body.robot:
            return None
        tip = self.arms[body.robot].tips[body.tip]
        return tip.rotation, tip.translation


def with_bases(scene: Scene) -> Scene:
    """The scene with the bases that it leaves to the program; the postures there are to be found.

    Raises
    ------
    SceneError
        Naming every arm for which there is no place.
    """
    if not any(spec.open_base for spec in scene.arms.values()):
        return scene
    arms, standing = {}, {}
    for name, spec in scene.arms.items():
        resolved = resolve_arm(spec, scene.folder)
        arm = _make_arm(name, scene, resolved)
        if spec.open_base:
            arms[name] = arm
        elif spec.posture not in (None, SOLVE):
            standing[name] = Standing(arm, resolved.posture)
    specs = {
        name: scene.arms[name].model_copy(update={"base": base, "posture": SOLVE})
        for name, base in find_bases(scene, arms, standing).items()
    }
    return scene.model_copy(update={"arms": {**scene.arms, **specs}})


def load_robots(scene: Scene, like: System | None = None, seek: bool = True) -> Robots:
    """The arms of a scene; equal ones of ``like`` are shared, missing postures sought.

    Raises
    ------
    SceneError
        Where robots have several tips, or joints connect other bodies than arms and the object.
    """
    _refuse_what_is_not_simulated(scene)
    shared: tuple[str, ...] = ()
    if like is not None and scene.effects.rotor_inertia == like.scene.effects.rotor_inertia:
        arms_of_like = like.scene.arms
        shared = tuple(
            name
            for name, spec in scene.arms.items()
            if arms_of_like.get(name) == spec
            and like.scene.group_of(name).lock == scene.group_of(name).lock
        )
    resolved, arms = {}, {}
    for name, spec in scene.arms.items():
        if like is not None and name in shared:
            resolved[name], arms[name] = like.model.robots[name], like.arms[name]
        else:
            locked = spec.model_copy(update={"lock": scene.group_of(name).lock | spec.lock})
            resolved[name] = resolve_arm(locked, scene.folder)
            arms[name] = _make_arm(name, scene, resolved[name])
    postures = {name: arm.posture for name, arm in resolved.items()}
    if seek:
        postures |= find_postures(scene, arms, postures)
    return Robots(resolved, arms, postures, shared)


def _refuse_what_is_not_simulated(scene: Scene) -> None:
    wider: list[tuple[str | int, ...]] = [("robots", name) for name in scene.robots]
    wider += [("joints", k) for k, joint in enumerate(scene.joints) if joint.between is not None]
    if wider:
        remedy = "is not simulated yet; write arms, each with one joint to the object"
        raise SceneError([fault_at(where, remedy) for where in wider])


def arm_backends(scene: Scene, robots: Robots, like: System | None = None) -> ArmBackends:
    """Backends of the arm dynamics; shared where ``like`` has equal arms."""
    gravity, with_torque = gravity_of(scene), needs_gravity_torque(scene)
    if like is not None and list(robots.shared) == list(scene.arms) == list(like.scene.arms):
        same_gravity = scene.gravity == like.scene.gravity
        same_backends = scene.run.arms == like.scene.run.arms
        same_terms = with_torque == needs_gravity_torque(like.scene)
        if same_gravity and same_backends and same_terms:
            return like.model.backends
    return ArmBackends(robots.arms, gravity, with_torque, scene.run.arms == "compiled")


def arm_files(spec: ArmSpec, resolved: ResolvedRobot) -> ArmFiles:
    """Files and frames of an arm of a scene."""
    tool = spec.tool
    return ArmFiles(
        urdf=resolved.urdf,
        package_dirs=resolved.package_dirs,
        base=spec.base.matrix(),
        tips={"": resolved.tip},
        locked=resolved.locked,
        tool_urdf=resolved.tool_urdf,
        tool_package_dirs=resolved.tool_package_dirs,
        mount=tool.mount if tool is not None else None,
        tool_placement=tool.at.matrix() if tool is not None else None,
        mjcf=resolved.mjcf,
    )


def _make_arm(name: str, scene: Scene, resolved: ResolvedRobot) -> Arm:
    spec, rotors = scene.arms[name], scene.effects.rotor_inertia
    inertia = None
    if rotors is not None:
        from multiarm.effects.rotor_inertia import of_arm

        inertia = of_arm(rotors, name, resolved.joint_names)
    arm = Arm(name, arm_files(spec, resolved), spec.color, inertia)
    if arm.joint_names != resolved.joint_names:
        raise ModelError(
            f"arm '{name}': Pinocchio orders its joints {arm.joint_names}, the URDF's chain is "
            f"{resolved.joint_names}; give the chain's joints names in order"
        )
    return arm


def gravity_of(scene: Scene) -> np.ndarray:
    """Acceleration of free fall, world axes (3,) [m/s^2]; zero where the scene has no gravity."""
    return np.array(scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0))
