"""The links of robots in an animation: their shapes, where the joints have them, in colours.

What one tip alone moves has the colour of the tip; what several tips share, such as a trunk or a
cart, has the colours of the robot's file.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from multiarm.geometry.poses import pose_matrix
from multiarm.geometry.triangle_mesh import TriangleMesh, merge
from multiarm.robots.robot import Robot
from multiarm.scene.faults import counted
from multiarm.viewer.animation import Body, along, rotations
from multiarm.viewer.shapes import PLAIN, geometry_mesh, is_mesh_file
from multiarm.viewer.solids import capsule

WHITE = np.ones(3)  # a tint that leaves colours as they are


def bodies_of_arms(
    arms: list[Robot],
    configurations: Mapping[str, np.ndarray],
    colors: Mapping[str, np.ndarray],
    shapes: Shapes,
) -> tuple[list[Body], list[Body]]:
    """Return the links of arms on one base in the colours of the arms, and their trunk.

    The trunk, of several arms only, are the links that no arm moves, in the robot's own colours.
    """
    first = arms[0]
    if len(arms) == 1:
        parts = shapes.parts(first, shapes.visuals(first))
        tints = [colors[first.name]] * len(parts)
        return _bodies(first, parts, configurations[first.name], tints), []
    bodies, visuals = [], {arm.name: shapes.visuals(arm) for arm in arms}
    carried = {item.name for arm in arms for item in visuals[arm.name] if item.parentJoint > 0}
    trunk = [item for item in visuals[first.name] if item.name not in carried]
    for arm in arms:
        parts = shapes.parts(arm, [item for item in visuals[arm.name] if item.parentJoint > 0])
        if trunk:  # else the bars from the base to the arms stand for it
            parts = [part for part in parts if part.joint > 0]
        tints = [colors[arm.name]] * len(parts)
        bodies += _bodies(arm, parts, configurations[arm.name], tints)
    fixed = shapes.seen(first, trunk, subdued=False)
    robot = "+".join(arm.name for arm in arms)
    tints = [WHITE] * len(fixed)
    return bodies, _bodies(first, fixed, configurations[first.name], tints, robot)


def bodies_of_robot(
    robot: Robot, configurations: np.ndarray, tip_colors: Mapping[str, np.ndarray], shapes: Shapes
) -> tuple[list[Body], list[Body]]:
    """Return the links of a robot with tips, and among them those of its base.

    Parameters
    ----------
    configurations : ndarray, shape (K, nq)
    tip_colors : mapping of str to ndarray
        By the names of tips.
    """
    tips = {name: set(robot.tips[name].chain.tolist()) for name in tip_colors}
    alone = {}  # joint, by Pinocchio's number -> the only tip that it moves
    for joint in range(robot.model.njoints):
        first = robot.model.joints[joint].idx_v
        moved = [name for name, chain in tips.items() if joint == 0 or first in chain]
        if len(moved) == 1:
            alone[joint] = moved[0]
    visuals = shapes.visuals(robot)
    shared = [item for item in visuals if item.parentJoint not in alone]
    parts = shapes.parts(robot, [item for item in visuals if item.parentJoint in alone], shared)
    tints = [tip_colors[alone[part.joint]] if part.joint in alone else WHITE for part in parts]
    bodies = _bodies(robot, parts, configurations, tints)
    root = 2 if robot.floats else len(robot.files.base_joints)  # a base slides, then turns
    return bodies, [b for b, part in zip(bodies, parts, strict=True) if part.joint <= root]


def _bodies(
    arm: Robot,
    parts: list[_Part],
    configurations: np.ndarray,
    tints: list[np.ndarray],
    name: str = "",
) -> list[Body]:
    """Return parts as bodies that move with a robot's joints, below ``arms/name``."""
    poses = np.empty((len(parts), len(configurations), 7))
    data = arm.model.createData()
    for k, q in enumerate(configurations):
        pin.forwardKinematics(arm.model, data, q)
        placed = [pin.SE3ToXYZQUAT(data.oMi[p.joint] * p.placement) for p in parts]
        poses[:, k] = np.reshape(placed, (-1, 7))
    names = _distinct([part.name.replace("/", "_") for part in parts])
    return [
        Body(f"arms/{name or arm.name}/{link}", part.mesh, pose[:, :3], pose[:, 3:], tint)
        for link, part, pose, tint in zip(names, parts, poses, tints, strict=True)
    ]


@dataclass(frozen=True)
class _Part:
    """A shape fixed to a joint's moving frame (joint 0: the world)."""

    name: str
    joint: int
    placement: pin.SE3
    mesh: TriangleMesh


class Shapes:
    """The visuals of arms; a mesh file is read once."""

    def __init__(self, meshes: bool) -> None:
        self._meshes = meshes  # False leaves mesh files out
        self._of_files: dict[tuple, TriangleMesh] = {}

    def visuals(self, arm: Robot) -> list[pin.GeometryObject]:
        """Return all visuals of an arm's robot and tool."""
        items = arm.visual_model().geometryObjects
        return [item for item in items if self._meshes or not is_mesh_file(item)]

    def parts(
        self,
        arm: Robot,
        visuals: list[pin.GeometryObject],
        untinted: Sequence[pin.GeometryObject] = (),
    ) -> list[_Part]:
        """Return visuals of an arm as parts; bars replace links without a shape.

        Those that are ``untinted`` keep all of their colours.
        """
        parts = self.seen(arm, visuals) + self.seen(arm, untinted, subdued=False)
        return parts + _bars(arm, set(range(arm.model.njoints)) - {part.joint for part in parts})

    def seen(
        self, arm: Robot, visuals: Sequence[pin.GeometryObject], subdued: bool = True
    ) -> list[_Part]:
        """Return visuals as parts; a warning names those that cannot be shown."""
        parts: list[_Part] = []
        lost: dict[str, None] = {}  # each file once
        for item in visuals:
            try:
                mesh = self._mesh(item, subdued)
            except ValueError as error:
                shape = item.meshPath if is_mesh_file(item) else "a shape"
                lost[f"{shape} of link '{item.name.rpartition('_')[0]}' ({error})"] = None
                continue
            parts.append(_Part(item.name, item.parentJoint, item.placement, mesh))
        if lost:
            warnings.warn(
                f"{arm.files.urdf.name}: the replay leaves out {counted([*lost], 3)}; a joint with "
                "no shape left has a bar",
                stacklevel=2,
            )
        return parts

    def _mesh(self, item: pin.GeometryObject, subdued: bool) -> TriangleMesh:
        if not is_mesh_file(item):
            return geometry_mesh(item, subdued)
        color = (item.overrideMaterial, *item.meshColor)
        key = (item.meshPath, *item.meshScale, *color, subdued)
        if key not in self._of_files:
            self._of_files[key] = geometry_mesh(item, subdued)
        return self._of_files[key]


def _bars(arm: Robot, joints: set[int]) -> list[_Part]:
    """Return bars from each of the `joints` to the next joints and tips."""
    model = arm.model
    ends: dict[int, list[np.ndarray]] = {joint: [] for joint in range(model.njoints)}
    for child in range(1, model.njoints):
        ends[model.parents[child]].append(model.jointPlacements[child].translation)
    for tip in arm.tips.values():
        ends[tip.joint].append(tip.translation)
    starts = {joint: np.zeros(3) for joint in ends}
    starts[0] = arm.files.base[:3, 3]  # joint 0 is the world, where the arm begins at its base
    reach = _reach(arm, starts[0])
    parts = []
    for joint in joints:
        bars = [
            _bar(starts[joint], end, 0.03 * reach)
            for end in ends[joint]
            if np.linalg.norm(end - starts[joint]) > 1e-3 * reach
        ]
        if bars:
            shape = merge(bars).painted(PLAIN)
            parts.append(_Part(f"{model.names[joint]}_bar", joint, pin.SE3.Identity(), shape))
    return parts


def _reach(arm: Robot, base: np.ndarray) -> float:
    """Return the longest way from the base over the joints to a tip [m]."""
    model, ways = arm.model, [0.0]
    for k in range(1, model.njoints):
        start = base if model.parents[k] == 0 else 0.0
        step = np.linalg.norm(model.jointPlacements[k].translation - start)
        ways.append(ways[model.parents[k]] + float(step))
    ends = [ways[tip.joint] + float(np.linalg.norm(tip.translation)) for tip in arm.tips.values()]
    return max(ends)


def _bar(start: np.ndarray, end: np.ndarray, radius: float) -> TriangleMesh:
    span = end - start
    length = float(np.linalg.norm(span))
    turn = rotations(along(span[None, None] / length)[0])[0]
    return capsule(radius, length).moved(pose_matrix(turn, (start + end) / 2))


def _distinct(names: list[str]) -> list[str]:
    """Number the names that occur more than once: a node of the scene tree has one name."""
    counts = Counter(names)
    seen: Counter[str] = Counter()
    result = []
    for name in names:
        seen[name] += 1
        result.append(name if counts[name] == 1 else f"{name}_{seen[name]}")
    return result
