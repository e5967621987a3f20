"""``multiarm pose``: the joint positions that a scene leaves to the program."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING

from multiarm.cli.files import scene_to_run
from multiarm.cli.options import NoCode, SceneFile
from multiarm.errors import SceneError
from multiarm.terminal.console import output

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.scene import ArmSpec, RobotSpec
    from multiarm.scene.trunks import ArmGroup


def pose(scene: SceneFile, no_code: NoCode = False) -> None:
    """Find the postures that a scene leaves to the program, and the places to stand.

    Postures are found of arms and robots that have none, or `posture: solve`; places of those with
    `base: {solve: [x, y, yaw]}`. Printed are joint positions from base to tip, in rad, of sliding
    joints in m, and bases in m and rad, as a scene has them: copy them into it. Of a robot with
    tips the joints of a moving base come first, then those of its tree. It is an error if an arm
    cannot reach its place on the object; the message says how near it comes and where to move its
    base.
    """
    from multiarm.scene.joint_values import SOLVE

    loaded = scene_to_run(scene, no_code)
    robots: dict[str, ArmSpec | RobotSpec] = {**loaded.arms, **loaded.robots}
    open_ones = [name for name, robot in robots.items() if robot.posture in (None, SOLVE)]
    if not open_ones:
        noun = "robot" if loaded.robots else "arm"
        raise SceneError(
            f"'{scene}' gives every {noun} a posture; write 'posture: solve' to find one"
        )
    from multiarm.assembly.compilation import compile_system

    system = compile_system(loaded)
    positions = system.initial_state().joint_positions
    solved: dict[str, ArmSpec | RobotSpec] = {**system.scene.arms, **system.scene.robots}
    for name in open_ones:
        if name not in positions:  # an arm on a trunk that moves
            text = f"posture: {_written(_of_robot(system, loaded.group_of(name), name))}"
        else:
            base = _base(robots[name], solved[name])
            text = f"{base}posture: {_written(positions[name])}"
        output().print(f"{name}: {{{text}}}", markup=False, soft_wrap=True)


def _of_robot(system: System, group: ArmGroup, arm: str) -> list[float]:
    """Joint positions of an arm that is simulated as part of a robot, from base to tip."""
    names = system.arms[group.name].joint_names
    positions = system.initial_state().joint_positions[group.name]
    table = dict(zip(names, positions.tolist(), strict=True))
    return [table[joint] for joint in group.joints[arm]]


def _base(written: ArmSpec | RobotSpec, solved: ArmSpec | RobotSpec) -> str:
    """The base of a robot whose place was sought, as a scene has it; empty where it was written."""
    sought = {"xyz" if name in ("x", "y", "z") else "rpy" for name in written.open_base}
    keys = sought | written.base.model_fields_set
    if solved.base.quaternion_xyzw is None and "quaternion_xyzw" in keys:
        keys = {"xyz", "rpy"}
    entries = [
        f"{key}: {_written(getattr(solved.base, key))}"
        for key in ("xyz", "rpy", "quaternion_xyzw")
        if key in keys
    ]
    entries += [
        f"{key}: {json.dumps(value)}"
        for key, value in written.base.model_dump(mode="json", exclude_defaults=True).items()
        if key not in {"solve", "xyz", "rpy", "quaternion_xyzw"}
    ]
    return f"base: {{{', '.join(entries)}}}, " if sought else ""


def _written(numbers: Iterable[float]) -> str:
    """A list of numbers as YAML, to a hundredth of a microradian or nanometres."""
    return f"[{', '.join(f'{round(x, 8) + 0.0:.8f}'.rstrip('0').rstrip('.') for x in numbers)}]"
