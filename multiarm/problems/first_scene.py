"""A commented scene to start from: arms around an object, each with its tip at the object.

Each arm stands where, of some distances, its tip reaches a side of the object most dexterously.
The scene leaves the postures to the program (``posture: solve``), but those of arms with too few
joints to point as they are told.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from multiarm.arms.arm import Arm
from multiarm.assembly.compilation import arm_files, load_robots
from multiarm.assembly.inverse_kinematics import InverseKinematics
from multiarm.errors import SceneError
from multiarm.scene import (
    JOINTS,
    ArmSpec,
    ContactSpec,
    Joint,
    Pose,
    find_robot,
    parse_scene,
    resolve_arm,
)
from multiarm.scene.faults import unknown
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.parameters import description_of, example_of, picture_of

HEIGHT = 0.5
"""Of the object, where the first arm holds it at the height of its base [m]."""
AHEAD, ABOVE = (0.35, 0.5, 0.65, 0.8), (0.3, 0.0)
"""Places of the tip that are tried, before and above the base, as parts of the arm's length."""
TURNS = ((0.0, np.pi / 2), (0.0, 0.0), (np.pi, 0.0))
"""Its roll and pitch that are tried: z axis ahead, x axis ahead, z axis down."""


@dataclass(frozen=True)
class Solid:
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

HOW_IT_MOVES = (
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
)
"""Lines at the end of a scene, each with its meaning."""


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
    kind = _joint_kind(joint)
    holds = {robot: _hold(robot, kind) for robot in kinds}
    height = max(holds[robots[0]].xyz[2], 0.0) or HEIGHT
    shape = SOLIDS[solid]
    arms, joints = [], []
    for k, (name, robot) in enumerate(zip(names, robots, strict=True)):
        hold, yaw = holds[robot], 2.0 * np.pi * k / len(robots)
        side = -_side(shape, solid == "box", yaw)
        base = [*side, height] - Pose(rpy=(0.0, 0.0, yaw)).rotation() @ hold.xyz
        arms += _arm_lines(name, robot, hold, _written(base, (0.0, 0.0, yaw)))
        roll, pitch, turn = hold.rpy
        at = _written([*side, 0.0], (roll, pitch, turn + yaw))
        joints += _joint_lines(
            joint, kind, name, None if hold.posture and not kind.as_listed else at
        )
    lines = [
        (f"name: {crew} hold a {solid}", "a title for reports"),
        *_object_lines(shape, height),
        ("arms:", "the robots; their names are yours"),
        *arms,
        ("", ""),
        ("joints:", "how the arms hold the object, one for each arm"),
        *joints,
        *HOW_IT_MOVES,
    ]
    body = (f"{line}  # {words}" if line else "" for line, words in lines)
    text = "\n".join([*body, ""])
    load_robots(parse_scene(text))  # finds the postures
    return f"# Every line has its meaning behind the sign '#'.\n\n{text}"


def _object_lines(shape: Solid, height: float) -> list[tuple[str, str]]:
    return [
        ("gravity: [0, 0, -9.81]", "m/s^2 along x, y, z of the world; without it there is none"),
        ("", ""),
        ("object:", "the body that all arms hold; its frame is at its centre of mass"),
        ("  shape:", "what it looks like; its inertia follows, or write 'inertia:'"),
        (f"    {shape.written}", shape.words),
        ("  mass: 5.0", "kg"),
        (f"  pose: {{xyz: [0, 0, {height:g}]}}", "where it is at the start [m]"),
        ("", ""),
    ]


def _arm_lines(name: str, robot: str, hold: _Hold, base: str) -> list[tuple[str, str]]:
    lines = [
        (f"  {name}:", "an arm, by its name"),
        (f"    robot: {robot}", "see multiarm robots; or write 'urdf:' and a file"),
        (f"    base: {base}", "where it stands [m], turned by roll, pitch, yaw [rad]"),
    ]
    if hold.tip is not None:
        lines.append((f"    tip: {hold.tip}", "the link that is joined to the object"))
    if hold.posture is None:
        return [*lines, ("    posture: solve", "its joints at the start are found; or a list")]
    words = "its joints at the start, from base to tip [rad, of sliding joints m]"
    return [*lines, (f"    posture: {hold.posture}", words)]


def _joint_kind(kind: str) -> type[Joint]:
    model = BUILT_IN.get(kind) or JOINTS.find(kind)
    if model is None:
        text = unknown("joint kind", kind, [*BUILT_IN, *JOINTS.names()], "kinds")
        raise SceneError(f"$.joints: {text}")
    return model


def _joint_lines(kind: str, model: type[Joint], arm: str, at: str | None) -> list[tuple[str, str]]:
    """The lines of a joint: those of the example of its kind, explained by its parameters."""
    lines = [
        (f"  - arm: {arm}", "the arm whose tip it holds"),
        (f"    kind: {kind}", picture_of(model)),
    ]
    if at is not None:
        lines.append((f"    at: {at}", "the frame of the joint on the object [m, rad]"))
    for line in example_of(model).splitlines()[3:]:
        written, _, remark = line.partition("#")
        key = written.strip().removeprefix("- ").partition(":")[0]
        if key == "at":  # the example's, on another object
            continue
        words = remark.strip() or description_of(model, key) or description_of(ContactSpec, key)
        lines.append((written.rstrip(), words or "as in the line above"))
    return lines


def _side(solid: Solid, edged: bool, yaw: float) -> np.ndarray:
    """Where a horizontal ray from the middle leaves the object, shape (2,) [m]."""
    ray = np.array([np.cos(yaw), np.sin(yaw)])
    parts = np.abs(ray) / solid.half_sizes
    return ray / (np.max(parts) if edged else np.linalg.norm(parts))


def _written(xyz: Sequence[float], rpy: Sequence[float]) -> str:
    """A pose as a scene has it, without negative zeros."""
    parts = (", ".join(f"{round(value, 6) + 0.0:.7g}" for value in part) for part in (xyz, rpy))
    return "{{xyz: [{}], rpy: [{}]}}".format(*parts)


@dataclass(frozen=True)
class _Hold:
    """How an arm holds its tip.

    Attributes
    ----------
    tip : str or None
        The link, where the scene has to name it.
    xyz, rpy : tuple of 3 floats
        Its place [m], and its roll, pitch and yaw [rad], in the frame of the arm's base.
    posture : list of float or None
        Positions of the joints, where they are not left to the program.
    """

    tip: str | None
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    posture: list[float] | None = None

    @property
    def matrix(self) -> np.ndarray:
        """Pose of the tip, shape (4, 4)."""
        return Pose(xyz=self.xyz, rpy=self.rpy).matrix()


def _hold(robot: str, kind: type[Joint]) -> _Hold:
    """Of the places that are tried, the one that the arm reaches best; else where it comes near.

    Raises
    ------
    SceneError
        The robot is not known, or nothing tells which link is its tip.
    """
    tips = find_robot(robot).tips
    if not tips:
        raise SceneError(
            f"nothing tells which link of robot {robot!r} is its tip; take another robot (multiarm "
            f"robots), or write a scene with 'tip:', one of the links that 'multiarm robots "
            f"{robot}' shows"
        )
    tip = tips[0] if len(tips) > 1 else None
    spec = ArmSpec(robot=robot, tip=tip)
    arm = Arm(robot, arm_files(spec, resolve_arm(spec)))
    length = float(np.max(arm.levers(np.zeros(3))))
    for free, turn, above in product(dict.fromkeys([(), kind.free or ()]), TURNS, ABOVE):
        search = InverseKinematics(arm, free)
        places = [
            (_two_digits(ahead * length), 0.0, _two_digits(above * length)) for ahead in AHEAD
        ]
        holds = [_Hold(tip, xyz, (*turn, 0.0)) for xyz in places]
        found = [(hold, search.search([hold.matrix], np.random.default_rng(0))) for hold in holds]
        reached = [(reach.quality, hold) for hold, reach in found if reach is not None]
        if reached:
            return max(reached, key=lambda one: one[0])[1]
    miss = search.nearest(holds[1].matrix, np.random.default_rng(0))
    posture = np.round(miss.posture, 4) + 0.0
    pose = arm.tip_pose(posture)
    x, y, z = pose[:3, 3].tolist()
    roll, pitch, yaw = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz").tolist()
    return _Hold(tip, (x, y, z), (roll, pitch, yaw), posture.tolist())


def _two_digits(number: float) -> float:
    return float(f"{number:.2g}")
