"""``multiarm new``: a commented scene to start from."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from multiarm.cli.files import check_targets, write_text
from multiarm.cli.options import FILES
from multiarm.cli.schema import schema_text
from multiarm.errors import MultiarmError
from multiarm.terminal.console import print_written

if TYPE_CHECKING:
    import numpy as np

__all__ = ["new"]

SCHEMA = "scene.schema.json"
TRIED = 300  # postures
HEIGHT = 0.5  # of the object, if the arms reach no other [m]


class Solid(str, Enum):
    """Shapes of the object."""

    box = "box"
    sphere = "sphere"
    cylinder = "cylinder"


# How the shape is written, in words, and half its size along x and y [m].
_SOLIDS = {
    Solid.box: ("box: [0.6, 0.4, 0.3]", "lengths of its edges along x, y, z [m]", (0.3, 0.2)),
    Solid.sphere: ("sphere: 0.25", "its radius [m]", None),
    Solid.cylinder: ("cylinder: {radius: 0.25, height: 0.3}", "upright; lengths in m", None),
}


def new(
    file: Annotated[
        Path, typer.Argument(help="The scene to be written, a YAML file.", metavar="[FILE]")
    ] = Path("scene.yaml"),
    robot: Annotated[
        list[str] | None,
        typer.Option(
            help="The robot of one arm; again for each further arm.",
            show_default="two ur5",
            metavar="NAME",
        ),
    ] = None,
    joint: Annotated[
        str,
        typer.Option(
            help="The joint between each arm and the object; multiarm joints shows all kinds.",
            metavar="KIND",
        ),
    ] = "weld",
    solid: Annotated[Solid, typer.Option("--object", help="The shape of the object.")] = Solid.box,
    force: Annotated[
        bool,
        typer.Option("--force", help="Replace an earlier file.", rich_help_panel=FILES),
    ] = False,
) -> None:
    """Write a scene to start from, every line explained, for robots that are installed.

    The arms stand around the object and touch it at the start. The schema of scenes is written
    beside it, by which editors complete and explain what is written there.
    """
    check_targets({"FILE": file})
    if file.exists() and not force:
        raise MultiarmError(f"'{file}' exists; name another file, or replace it with --force")
    text = _scene_text(robot or ["ur5", "ur5"], joint, solid, file)
    from multiarm.scene import parse_scene

    parse_scene(text, file.parent)
    write_text(file, text, "FILE")
    print_written("scene", file)
    schema = file.with_name(SCHEMA)
    if force or not schema.exists():
        write_text(schema, schema_text("scene")[0], "FILE")
        print_written("schema", schema)


def _scene_text(robots: list[str], joint: str, solid: Solid, file: Path) -> str:
    """The scene, with comments."""
    kinds = Counter(robots)
    crew = ", ".join(f"{count} {robot}" for robot, count in kinds.items())
    names = ["left", "right"] if len(robots) == 2 else [f"arm{k + 1}" for k in range(len(robots))]
    stands = _stands(robots, solid)
    shape, words, _ = _SOLIDS[solid]
    lines = [
        (f"name: {crew} hold a {solid.value}", "a title for reports"),
        ("gravity: [0, 0, -9.81]", "m/s^2 along x, y, z of the world; without it there is none"),
        ("", ""),
        ("object:", "the body that all arms hold; its frame is at its centre of mass"),
        ("  shape:", "what it looks like; its inertia follows, or write 'inertia:'"),
        (f"    {shape}", words),
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
    head = [
        f"yaml-language-server: $schema={SCHEMA}",
        f"Look at it: multiarm check {file.name}. Run it: multiarm run {file.name} --replay",
        "Every line has its meaning behind the sign '#'.",
    ]
    body = (f"{line}  # {words}" if line else "" for line, words in lines)
    return "\n".join([*(f"# {line}" for line in head), "", *body, ""])


def _joint_lines(kind: str, arm: str, stand: _Stand) -> list[tuple[str, str]]:
    """The lines of a joint: those of the example of its kind, explained by its parameters."""
    from multiarm.scene import JOINTS, ContactSpec
    from multiarm.scene.faults import unknown
    from multiarm.scene.joints import BUILT_IN
    from multiarm.scene.parameters import description_of, example_of, picture_of

    model = BUILT_IN.get(kind) or JOINTS.find(kind)
    if model is None:
        text = unknown("joint kind", kind, [*BUILT_IN, *JOINTS.names()], "kinds")
        raise MultiarmError(f"--joint: {text}; 'multiarm joints' shows them all")
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
        words = remark.strip() or description_of(model, key) or description_of(ContactSpec, key)
        lines.append((written.rstrip(), words or "as in the line above"))
    return lines


class _Stand:
    """Where an arm stands, so that its tip touches the object from one side."""

    def __init__(self, robot: str) -> None:
        from multiarm.arms.arm import Arm
        from multiarm.assembly.compilation import arm_files
        from multiarm.scene import ArmSpec, find_robot, resolve_arm

        self.tip = find_robot(robot).tip
        spec = ArmSpec(robot=robot, tip=self.tip)
        self.posture, self.pose = _dexterous(Arm(robot, arm_files(spec, resolve_arm(spec))))
        self.height = float(self.pose[2, 3]) if self.pose[2, 3] > 0.2 else HEIGHT

    def put(self, direction: float, distance: float, height: float) -> None:
        """Let the tip be at a distance from the object's centre, in a direction [rad] of it."""
        import numpy as np

        x, y, z = self.pose[:3, 3]
        self.yaw = float(np.angle(np.exp(1j * (direction + np.pi - np.arctan2(y, x)))))
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        turn = np.array([[cos, -sin], [sin, cos]])
        side = distance * np.array([np.cos(direction), np.sin(direction)])
        self.base = (*(side - turn @ [x, y] + 0.0), height - z)
        rotation = np.eye(3)
        rotation[:2, :2] = turn
        (a, *_), (c, *_), (e, f, g) = rotation @ self.pose[:3, :3]
        rpy = (np.arctan2(f, g), np.arctan2(-e, np.hypot(a, c)), np.arctan2(c, a))
        self.grip = ((*side, 0.0), rpy)


def _stands(robots: list[str], solid: Solid) -> list[_Stand]:
    """Where the arms stand: in equal angles around the object."""
    import numpy as np

    stands = [_Stand(robot) for robot in robots]
    for k, stand in enumerate(stands):
        direction = np.pi + 2.0 * np.pi * k / len(robots)
        half = _SOLIDS[solid][2]
        distance = 0.25
        if half is not None:
            along = np.abs([np.cos(direction), np.sin(direction)])
            distance = float(np.min(np.array(half) / np.maximum(along, 1e-9)))
        stand.put(direction, distance, stands[0].height)
    return stands


def _dexterous(arm: Any) -> tuple[np.ndarray, np.ndarray]:
    """A posture far from singular ones, of those that stretch the arm forward, and the tip's pose.

    Among random postures the one with the largest smallest singular value of the Jacobian,
    lengths over those of the arm.
    """
    import numpy as np

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
        if terms.tip_position[2] < 0.2:
            score *= 0.1
        if score > best:
            best, chosen = float(score), posture
    return chosen, arm.tip_pose(chosen)
