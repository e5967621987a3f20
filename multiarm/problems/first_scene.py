"""A commented scene to start from: arms around an object, each with its tip at the object.

An arm takes, of random postures, the one in which it is most dexterous; its base is then put where
the tip touches the object from one side.  So the loops of the scene are closed as it is written.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.compilation import arm_files
from multiarm.errors import SceneError
from multiarm.scene import JOINTS, ArmSpec, ContactSpec, Pose, find_robot, parse_scene, resolve_arm
from multiarm.scene.faults import unknown
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.parameters import description_of, example_of, picture_of

TRIED = 300
"""Random postures of an arm."""
HEIGHT = 0.5
"""Of the object, where the arms reach no other [m]."""
LOWEST = 0.2
"""Of the tips, so that the object is above the floor on which the arms stand [m]."""


class Solid(NamedTuple):
    """A shape as it is written, in words, and half its sizes along x and y [m]."""

    written: str
    words: str
    half_sizes: tuple[float, float]


SOLIDS = {
    "box": Solid("box: [0.6, 0.4, 0.3]", "lengths of its edges along x, y, z [m]", (0.3, 0.2)),
    "sphere": Solid("sphere: 0.25", "its radius [m]", (0.25, 0.25)),
    "cylinder": Solid(
        "cylinder: {radius: 0.25, height: 0.3}", "upright; lengths in m", (0.25, 0.25)
    ),
}


def first_scene(robots: list[str], joint: str, solid: str) -> str:
    """A scene in which arms stand around an object that they touch, as YAML with comments.

    Parameters
    ----------
    robots : list of str
        The robot of each arm.
    joint : str
        The kind of joint between each arm and the object.
    solid : str
        The shape of the object, one of :data:`SOLIDS`.

    Raises
    ------
    SceneError
        When a robot, or what it makes of the scene, is not known or not possible.
    """
    kinds = Counter(robots)
    crew = ", ".join(f"{count} {robot}" for robot, count in kinds.items())
    names = ["left", "right"] if len(robots) == 2 else [f"arm{k + 1}" for k in range(len(robots))]
    stands = _stands(robots, solid)
    shape = SOLIDS[solid]
    lines = [
        (f"name: {crew} hold a {solid}", "a title for reports"),
        ("gravity: [0, 0, -9.81]", "m/s^2 along x, y, z of the world; without it there is none"),
        ("", ""),
        ("object:", "the body that all arms hold; its frame is at its centre of mass"),
        ("  shape:", "what it looks like; its inertia follows, or write 'inertia:'"),
        (f"    {shape.written}", shape.words),
        ("  mass: 5.0", "kg"),
        (f"  pose: {{xyz: [0, 0, {stands[0].height:.4f}]}}", "where it is at the start [m]"),
        ("", ""),
        ("arms:", "the robots; their names are yours"),
    ]
    for name, robot, stand in zip(names, robots, stands, strict=True):
        x, y, z = stand.base
        lines += [
            (f"  {name}:", "an arm, by its name"),
            (f"    robot: {robot}", "the name of a robot, or write 'urdf:' and a file"),
            (
                f"    base: {{xyz: [{x:.6f}, {y:.6f}, {z:.6f}], rpy: [0, 0, {stand.yaw:.6f}]}}",
                "where it stands [m], turned by roll, pitch, yaw [rad]",
            ),
            (f"    tip: {stand.tip}", "the link that is joined to the object"),
            (
                f"    posture: [{', '.join(f'{q:.4f}' for q in stand.posture)}]",
                "its joints at the start, from base to tip [rad, of sliding joints m]",
            ),
        ]
    lines += [("", ""), ("joints:", "how the arms hold the object, one for each arm")]
    for name, stand in zip(names, stands, strict=True):
        lines += _joint_lines(joint, name, stand)
    lines += [
        ("", ""),
        ("control: gravity_compensation", "the arms hold all still; others: multiarm controls"),
        ("", ""),
        ("effects:", "what is not ideal; others: multiarm effects --list"),
        ("  joint_damping: 1.0", "of all joints of the arms [N m s/rad, of sliding joints N s/m]"),
        ("", ""),
        ("run:", "how long and how exactly"),
        ("  duration: 2.0", "of the motion [s]"),
        ("  accuracy: 1e-6", "largest error [m and rad]; method and steps follow from it"),
        ("  output_step: 0.01", "time between two samples of the result [s]"),
    ]
    body = (f"{line}  # {words}" if line else "" for line, words in lines)
    text = "\n".join([*body, ""])
    parse_scene(text)
    return f"# Every line has its meaning behind the sign '#'.\n\n{text}"


def _joint_lines(kind: str, arm: str, stand: _Stand) -> list[tuple[str, str]]:
    """The lines of a joint: those of the example of its kind, explained by its parameters."""
    model = BUILT_IN.get(kind) or JOINTS.find(kind)
    if model is None:
        text = unknown("joint kind", kind, [*BUILT_IN, *JOINTS.names()], "kinds")
        raise SceneError(f"$.joints: {text}; 'multiarm joints' shows them all")
    lines = [
        (f"  - arm: {arm}", "the arm whose tip it holds"),
        (f"    kind: {kind}", picture_of(model)),
    ]
    if model.as_listed:
        xyz, rpy = (", ".join(f"{value:.6f}" for value in part) for part in stand.grip)
        place = "the frame of the joint on the object: where the tip is [m, rad]"
        lines.append((f"    at: {{xyz: [{xyz}], rpy: [{rpy}]}}", place))
    for line in example_of(model).splitlines()[3:]:
        written, _, remark = line.partition("#")
        key = written.strip().removeprefix("- ").partition(":")[0]
        if key == "at":  # the example's, on another object
            continue
        words = remark.strip() or description_of(model, key) or description_of(ContactSpec, key)
        lines.append((written.rstrip(), words or "as in the line above"))
    return lines


@dataclass(frozen=True)
class _Stand:
    """Where an arm stands, so that its tip touches the object from one side.

    Attributes
    ----------
    tip : str
    posture : ndarray, shape (n,)
    base, yaw
        Place of its base [m], and turn about the vertical [rad], in the world.
    grip : two lists of 3 numbers
        Place [m] and roll, pitch, yaw [rad] of the tip in the object frame.
    height : float
        Of the tip [m].
    """

    tip: str
    posture: np.ndarray
    base: list[float]
    yaw: float
    grip: tuple[list[float], list[float]]
    height: float


def _stands(robots: list[str], solid: str) -> list[_Stand]:
    """Where the arms stand: in equal angles around the object, the first one on the floor."""
    found: list[_Stand] = []
    for k, robot in enumerate(robots):
        direction = np.pi + 2.0 * np.pi * k / len(robots)
        found.append(_stand(robot, direction, solid, found[0].height if found else None))
    return found


def _stand(robot: str, direction: float, solid: str, height: float | None) -> _Stand:
    """Where an arm stands, seen from the object in a direction [rad]."""
    tip = find_robot(robot).tip
    spec = ArmSpec(robot=robot, tip=tip)
    posture, pose = _dexterous(Arm(robot, arm_files(spec, resolve_arm(spec))))
    x, y, z = pose[:3, 3]
    if height is None:
        height = round(float(z), 4) if z > LOWEST else HEIGHT  # digits that are written
    yaw = float(np.angle(np.exp(1j * (direction + np.pi - np.arctan2(y, x)))))
    R = Pose(rpy=(0.0, 0.0, yaw)).rotation()  # of the base
    across, along = SOLIDS[solid].half_sizes
    ahead = np.array([np.cos(direction), np.sin(direction), 0.0])
    side = ahead / np.hypot(ahead[0] / across, ahead[1] / along)
    if solid == "box":
        side = ahead / np.max(np.abs(ahead[:2]) / [across, along])
    base = side - R @ [x, y, 0.0] + [0.0, 0.0, height - z]
    (a, *_), (c, *_), (e, f, g) = R @ pose[:3, :3]
    rpy = [float(np.arctan2(f, g)), float(np.arctan2(-e, np.hypot(a, c))), float(np.arctan2(c, a))]
    rounded = (np.round(base, 6) + 0.0).tolist()  # no negative zeros
    return _Stand(tip, posture, rounded, yaw, ((np.round(side, 6) + 0.0).tolist(), rpy), height)


def _dexterous(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """A posture far from singular ones, of those that stretch the arm forward, and the tip's pose.

    Among random postures the one with the largest smallest singular value of the Jacobian,
    lengths over those of the arm.
    """
    rng = np.random.default_rng(0)
    low, high = np.clip(arm.position_limits, -2.5, 2.5).T
    middle, half = (low + high) / 2, 0.45 * (high - low)
    best, chosen = -1.0, middle
    for _ in range(TRIED):
        posture = np.round(middle + half * rng.uniform(-1.0, 1.0, arm.dof), 4)
        terms = arm.terms(posture, np.zeros(arm.dof))
        reach = float(np.max(arm.levers(np.zeros(3))))
        J = terms.J / np.array([[reach]] * 3 + [[1.0]] * 3)
        ahead = np.hypot(*terms.tip_position[:2]) / reach
        score = np.linalg.svd(J, compute_uv=False)[-1] * min(1.0, 2.0 * ahead)
        if terms.tip_position[2] < LOWEST:
            score *= 0.1
        if score > best:
            best, chosen = float(score), posture
    return chosen, arm.tip_pose(chosen)
