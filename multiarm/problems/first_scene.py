"""A commented scene to start from: arms around an object, each with its tip at the object.

The object starts at a height at which all arms reach its sides from the floor, and goes up and down
again; each arm stands where, of some distances, its tip reaches the object most dexterously at both
ends of the way.  The scene leaves the postures to the program (``posture: solve``), but those of
arms with too few joints to point as they are told.  Where an arm cannot lift the object, the scene
pushes it gently, and its arms carry only their weights; an arm that is too short stands on a
pedestal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from multiarm.assembly.inverse_kinematics import InverseKinematics
from multiarm.assembly.robots import load_robots, robot_files
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot
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
from multiarm.scene.values import roll_pitch_yaw

ABOVE_FLOOR = 0.05
"""Least distance of the object from the floor [m]."""
AHEAD, ABOVE = (0.35, 0.5, 0.65, 0.8), (0.3, 0.45, 0.15, 0.6, 0.0)
"""Places of the tip that are tried, before and above the base, as parts of the arm's length."""
RISE = 0.1
"""How far the object goes up, as a part of the shortest arm's length."""
STIFFNESS = 1500.0
"""Of joints that follow a path, of an arm that is 1 m long [N m/rad]."""
PUSH = 0.1
"""Velocity of an object that is not lifted [m/s]."""
TURNS = ((0.0, np.pi / 2), (0.0, 0.0), (np.pi, 0.0))
"""Its roll and pitch that are tried: z axis ahead, x axis ahead, z axis down."""


@dataclass(frozen=True)
class Solid:
    """A shape as it is written, in words, and half its sizes along x, y and z [m]."""

    written: str
    words: str
    half_sizes: tuple[float, float, float]


SOLIDS = {
    "box": Solid(
        "box: [0.6, 0.4, 0.3]", "lengths of its edges along x, y, z [m]", (0.3, 0.2, 0.15)
    ),
    "sphere": Solid("sphere: 0.25", "its radius [m]", (0.25, 0.25, 0.25)),
    "cylinder": Solid(
        "cylinder: {radius: 0.25, height: 0.3}", "upright; lengths in m", (0.25, 0.25, 0.15)
    ),
}

REST = (
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
NUMERALS = ("One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


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
    names = ["left", "right"] if len(robots) == 2 else [f"arm{k + 1}" for k in range(len(robots))]
    kind, shape = _joint_kind(joint), SOLIDS[solid]
    loaded = [_Robot.named(robot) for robot in robots]
    height, rise, holds = _stands(loaded, kind, shape)
    arms, joints = [], []
    for k, (name, robot, hold) in enumerate(zip(names, robots, holds, strict=True)):
        yaw = 2.0 * np.pi * k / len(robots)
        side = -_side(shape, solid == "box", yaw)
        base = [*side, height] - Pose(rpy=(0.0, 0.0, yaw)).rotation() @ hold.xyz
        arms += _arm_lines(name, robot, hold, base, yaw)
        roll, pitch, turn = hold.rpy
        at = _written([*side, 0.0], (roll, pitch, turn + yaw))
        joints += _joint_lines(
            joint, kind, name, None if hold.posture and not kind.as_listed else at
        )
    lines = [
        (f"name: {_title(robots, solid, rise)}", "a title for reports"),
        *_object_lines(shape, height, rise),
        ("arms:", "the robots; their names are yours"),
        *arms,
        ("", ""),
        ("joints:", "how the arms hold the object, one for each arm"),
        *joints,
        *_control_lines(joint, height, rise, min(robot.length for robot in loaded)),
        *REST,
    ]
    body = (f"{line}  # {words}" if line else "" for line, words in lines)
    text = "\n".join([*body, ""])
    try:
        load_robots(parse_scene(text))  # finds the postures
    except SceneError as error:
        raise SceneError(
            f"no start was found at which {_crew(robots)} hold a {solid} by joints of kind "
            f"{joint!r}; take other robots (multiarm robots) or another joint (multiarm joints)"
        ) from error
    return f"# Every line has its meaning behind the sign '#'.\n\n{text}"


def _title(robots: list[str], solid: str, rise: float) -> str:
    ending = "s" if len(robots) == 1 else ""
    if rise:
        return f"{_crew(robots)} lift{ending} a {solid} and set{ending} it down again"
    return f"{_crew(robots)} hold{ending} a {solid}"


def _crew(robots: list[str]) -> str:
    """Such as "Two ur5 arms", or "One panda and two ur5"."""
    parts: list[str] = []
    for robot, count in Counter(robots).items():
        numeral = NUMERALS[count - 1] if count <= len(NUMERALS) else str(count)
        parts.append(f"{numeral.lower() if parts else numeral} {robot}")
    *first, last = parts
    if first:
        return f"{', '.join(first)} and {last}"
    return f"{last} arm{'s' if len(robots) > 1 else ''}"


def _control_lines(
    joint: str, height: float, rise: float, shortest: float
) -> list[tuple[str, str]]:
    if not rise:
        words = "the arms carry themselves and the object; others: multiarm controls"
        return [("", ""), ("control: gravity_compensation", words)]
    law = [("  kind: computed_torque", "an exact model drives the object along its path")]
    if joint != "weld":  # the object may move in ways that no arm can resist
        stiffness = _two_digits(STIFFNESS * shortest**2)
        law = [
            ("  kind: joint_pd", "springs and dampers in the joints, which follow the path"),
            (f"  stiffness: {stiffness:g}", "of each joint [N m/rad, of sliding joints N/m]"),
            (f"  damping: {0.1 * stiffness:g}", "[N m s/rad, of sliding joints N s/m]"),
        ]
    return [
        ("", ""),
        ("control:", "what drives the arms; others: multiarm controls"),
        *law,
        ("  path:", "poses of the object, which it passes at these times [s]"),
        (f"    - {{time: 1.0, xyz: [0, 0, {height + rise:g}]}}", "up [m]"),
        (f"    - {{time: 2.0, xyz: [0, 0, {height:g}]}}", "and down again"),
    ]


def _object_lines(shape: Solid, height: float, rise: float) -> list[tuple[str, str]]:
    push = (f"  twist: [0, 0, {PUSH:g}, 0, 0, 0]", "a push: its velocity at the start [m/s, rad/s]")
    return [
        ("gravity: [0, 0, -9.81]", "m/s^2 along x, y, z of the world; without it there is none"),
        ("", ""),
        ("object:", "the body that all arms hold; its frame is at its centre of mass"),
        ("  shape:", "what it looks like; its inertia follows, or write 'inertia:'"),
        (f"    {shape.written}", shape.words),
        ("  mass: 2.0", "kg"),
        (f"  pose: {{xyz: [0, 0, {height:g}]}}", "where it is at the start [m]"),
        *([] if rise else [push]),
        ("", ""),
    ]


def _arm_lines(
    name: str, robot: str, hold: _Hold, base: np.ndarray, yaw: float
) -> list[tuple[str, str]]:
    where = "where it stands [m], turned by roll, pitch, yaw [rad]"
    if base[2] > 0.0:
        where += "; on a pedestal, to reach the object"
    lines = [
        (f"  {name}:", "an arm, by its name"),
        (f"    robot: {robot}", "see multiarm robots; or write 'urdf:' and a file"),
        (f"    base: {_written(base, (0.0, 0.0, yaw))}", where),
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
    parts = np.abs(ray) / solid.half_sizes[:2]
    return ray / (np.max(parts) if edged else np.linalg.norm(parts))


def _written(xyz: Sequence[float] | np.ndarray, rpy: Sequence[float]) -> str:
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


@dataclass(frozen=True)
class _Robot:
    """A robot with the link that is its tip, and the length of its arm [m].

    ``tip`` is None where the scene need not name it.
    """

    arm: Robot
    tip: str | None
    length: float

    @classmethod
    def named(cls, name: str) -> _Robot:
        """The robot of this name.

        Raises
        ------
        SceneError
            It is not known, or nothing tells which link is its tip.
        """
        tips = find_robot(name).tips
        if not tips:
            raise SceneError(
                f"nothing tells which link of robot {name!r} is its tip; take another robot "
                f"(multiarm robots), or write a scene with 'tip:', one of the links that 'multiarm "
                f"robots {name}' shows"
            )
        tip = tips[0] if len(tips) > 1 else None
        spec = ArmSpec(robot=name, tip=tip)
        arm = Robot(name, robot_files(spec, resolve_arm(spec)))
        return cls(arm, tip, float(np.max(arm.levers(np.zeros(3)))))


@dataclass(frozen=True)
class _Grade:
    """A hold, its rank (0 is best), and its quality among those of one rank."""

    rank: int
    quality: float
    hold: _Hold


def _stands(
    robots: list[_Robot], kind: type[Joint], shape: Solid
) -> tuple[float, float, list[_Hold]]:
    """Height of the object [m], how far it goes up [m], and the hold of each arm.

    The height is, of those at which all arms reach the object from the floor, the one at which the
    worst arm holds it best.  Where there is none, the highest hold decides, and other arms stand on
    pedestals; where an arm cannot lift the object, nothing goes up.
    """
    shortest, lowest = min(robot.length for robot in robots), shape.half_sizes[2] + ABOVE_FLOOR
    rise = _two_digits(RISE * shortest)
    heights = sorted({max(_two_digits(part * shortest), lowest) for part in ABOVE})
    unlike = {robot.arm.name: robot for robot in robots}
    common = []
    for height in heights:
        grades: dict[str, _Grade] = {}
        for name, robot in unlike.items():
            grade = _graded_hold(robot, kind, height, rise)
            if grade is not None:
                grades[name] = grade
        if len(grades) == len(unlike):
            worst = max((grade.rank, -grade.quality) for grade in grades.values())
            common.append((worst, height, {name: grade.hold for name, grade in grades.items()}))
    if common:
        _, height, holds = min(common, key=lambda entry: entry[:2])
    else:
        holds, lifted = {}, True
        for name, robot in unlike.items():
            hold = _hold_anywhere(robot, kind, rise)
            holds[name], lifted = (
                hold or _hold_nearby(robot, kind, lowest),
                lifted and hold is not None,
            )
        rise = rise if lifted else 0.0
        height = max(lowest, *(hold.xyz[2] for hold in holds.values()))
    return height, rise, [holds[robot.arm.name] for robot in robots]


def _graded_hold(robot: _Robot, kind: type[Joint], height: float, rise: float) -> _Grade | None:
    """The best hold at a height above the base; None where there is none.

    The arm reaches it, and the same place higher by ``rise``.
    """
    for rank, (free, turn) in enumerate(_turns(kind)):
        search = InverseKinematics(robot.arm, free)
        grades: list[_Grade] = []
        for ahead in AHEAD:
            hold = _Hold(robot.tip, (_two_digits(ahead * robot.length), 0.0, height), (*turn, 0.0))
            lifted = hold.matrix
            lifted[2, 3] += rise
            reach = search.search([hold.matrix, lifted], np.random.default_rng(0))
            if reach is not None:
                if len(search.lower) < 6 - len(free):  # digits that are written decide
                    hold = _held(robot, reach.postures[0])
                grades.append(_Grade(rank, reach.quality, hold))
        if grades:
            return max(grades, key=lambda grade: grade.quality)
    return None


def _turns(kind: type[Joint]) -> list[tuple[tuple[int, ...], tuple[float, float]]]:
    """Components of the pose that are left free, and roll and pitch, the best first."""
    return [*product(dict.fromkeys([(), tuple(kind.free or ())]), TURNS)]


def _hold_anywhere(robot: _Robot, kind: type[Joint], rise: float) -> _Hold | None:
    heights = [_two_digits(above * robot.length) for above in ABOVE]
    grades = [_graded_hold(robot, kind, height, rise) for height in heights]
    reached = [grade for grade in grades if grade is not None]
    return min(reached, key=lambda grade: (grade.rank, -grade.quality)).hold if reached else None


def _hold_nearby(robot: _Robot, kind: type[Joint], lowest: float) -> _Hold:
    """Where an arm that reaches none of the places comes near one of them.

    The place is at a height above the base of ``lowest`` [m] or more, where the arm is long enough.
    """
    free, turn = _turns(kind)[-1]
    height = max(ABOVE[0] * robot.length, lowest)
    height = height if height < ABOVE[1] * robot.length else 0.0
    search = InverseKinematics(robot.arm, free)
    place = _Hold(robot.tip, (AHEAD[1] * robot.length, 0.0, height), (*turn, 0.0)).matrix
    return _held(robot, search.nearest(place, np.random.default_rng(0)).posture)


def _held(robot: _Robot, posture: np.ndarray) -> _Hold:
    """The hold of a posture, which is written: the place follows from its digits."""
    posture = np.round(posture, 4) + 0.0
    pose = robot.arm.tip_pose(posture)
    x, y, z = pose[:3, 3].tolist()
    return _Hold(robot.tip, (x, y, z), roll_pitch_yaw(pose[:3, :3]), posture.tolist())


def _two_digits(number: float) -> float:
    return float(f"{number:.2g}")
