"""``multiarm robots``: the robots that a scene may name, with their joints and tips."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from multiarm.cli.catalogue import Card, Section, show
from multiarm.cli.options import JsonFile
from multiarm.errors import ModelError
from multiarm.notation import count_of, number, numbers

if TYPE_CHECKING:
    import numpy as np

    from multiarm.scene import JointOutline, RobotEntry, RobotOutline

FILE = "a file"
ALIGNED = 1e-8  # of the cosine: directions within 0.01 degrees are an axis
_MOST_TIPS = 4  # in an example of a robot with several


def robots(
    name: Annotated[
        str | None,
        typer.Argument(
            help="One robot, or a URDF or MJCF file, shown in full.",
            show_default="all robots",
            metavar="[NAME]",
        ),
    ] = None,
    json: JsonFile = None,
) -> None:
    """List the robots that a scene may name: 'robot:' below an arm or a robot, with their tips.

    Where a robot has one tip, an arm need not name it. Where it has several, since it has several
    arms or no link is usual, 'tip:' names one of them, or another link that joints carry; 'tips:'
    of one robot names several. The number of joints is that from the base to a tip.

    The JSON has the key robots: a table by name, with what is shown here.
    """
    from multiarm.scene import RobotEntry, available_robots, find_robot
    from multiarm.scene.robots import DESCRIPTIONS, described_robots

    if name is None:
        known = available_robots()
    elif Path(name).suffix in (".urdf", ".xml"):
        known = {name: RobotEntry(Path(name).stem, Path(name), FILE)}
    else:
        known = {name: find_robot(name)}
    left = [] if name else [described for described in described_robots() if described not in known]
    section = Section(
        "Robots",
        "robot",
        "robots",
        {robot: _card(entry, with_axes=name is not None) for robot, entry in known.items()},
        heads=("robot", "joints", "where it is from"),
        note=f"To be fetched first (python -m {DESCRIPTIONS} pull NAME): {', '.join(left)}"
        if left
        else "",
    )
    show("robots", {"robots": section}, name, json)


def _card(entry: RobotEntry, with_axes: bool) -> Card:
    from multiarm.scene.robots import arm_ends

    outline = entry.outline
    ends = entry.tips or arm_ends(outline)
    counts = {tip: len(outline.movable(tip)) for tip in ends}
    chains = {outline.movable(tip): tip for tip in ends}
    sizes = sorted({*counts.values()}) or [0]
    movable = [joint for joint in outline.joints if joint.movable]
    links: dict[str, list[str]] = {joint.name: [] for joint in movable}
    for link in filter(outline.ends_an_arm, outline.links):
        links[outline.movable(link)[-1].name].append(link)
    twice = ", ".join(sorted({joint.name for joint in outline.joints} & {*outline.links}))
    trouble = {"cannot be used": f"joint and link are both named {twice}"} if twice else {}
    label = "tip" if len(ends) == 1 else "tips"
    axes = _tip_axes(entry, outline, ends) if with_axes and not twice else []
    return Card(
        entry.name,
        f"from {entry.source}",
        [],
        _snippet(entry, outline, ends) if ends else "",
        count=" to ".join(map(str, sizes[:1] + sizes[1:][-1:])),
        facts={
            "file": str(entry.urdf),
            label: ", ".join(f"{tip} ({count_of(n, 'joint')})" for tip, n in counts.items())
            or "none",
            **({f"axes of the {label}": "\n".join(axes)} if axes else {}),
            **trouble,
        },
        listed={label: " | ".join(chains.values()), **trouble},
        table=(
            "Joints",
            ("joint", "kind and limits", "links that it carries, which can be tips"),
            [(joint.name, _words(joint), ", ".join(links[joint.name])) for joint in movable],
        )
        if movable
        else None,
        further={
            "source": entry.source,
            "urdf": str(entry.urdf),
            "tip": entry.tip,
            "tips": counts,
            "joints": [{**asdict(joint), "tips": links[joint.name]} for joint in movable],
            "trouble": trouble.get("cannot be used"),
        },
    )


def _tip_axes(entry: RobotEntry, outline: RobotOutline, ends: tuple[str, ...]) -> list[str]:
    """How the frame of each tip lies; without those that are not at the end of an arm.

    The axis of the last joint in the axes of the tip, and the z axis of the tip in those of the
    root link with all joints at 0.
    """
    import numpy as np

    from multiarm.robots.robot import Robot, RobotFiles

    lines = []
    for tip in filter(outline.ends_an_arm, ends):
        chain = outline.movable(tip)
        held = {j.name: j.neutral for j in outline.joints if j.movable and j not in chain}
        mjcf = entry.urdf.suffix == ".xml"
        with suppress(ModelError):  # of files that Pinocchio cannot use
            robot = Robot(tip, RobotFiles(entry.urdf, (), np.eye(4), {"": tip}, held, mjcf=mjcf))
            axis = robot.tips[""].rotation.T @ robot.structure().axes[-1]
            z = robot.tip_pose(np.zeros(len(chain)))[:3, 2]
            motion = "slides along" if chain[-1].kind == "prismatic" else "turns about"
            lines.append(
                f"{tip}: {chain[-1].name} {motion} its {_direction(axis)}; with all joints at 0 "
                f"its z points along {_direction(z)} of the base"
            )
    return lines


def _direction(axis: np.ndarray) -> str:
    """An axis of a frame by its name, such as ``-y``; another direction by its components."""
    for k, name in enumerate("xyz"):
        if abs(axis[k]) > 1.0 - ALIGNED:
            return name if axis[k] > 0.0 else f"-{name}"
    return f"[{numbers(axis.round(4) + 0.0)}]"


def _snippet(entry: RobotEntry, outline: RobotOutline, ends: tuple[str, ...]) -> str:
    """An arm with the robot; with a tool, which moves nothing, on another robot."""
    lines = ["arms:", "  left:"]
    if not any(joint.movable for joint in outline.joints):
        return "\n".join([*lines, "    robot: ur5", f"    tool: {{{_named(entry)}, mount: tool0}}"])
    lines.append(f"    {_named(entry)}")
    if entry.tip is None:
        further_tips = f"  # or {', '.join(ends[1:])}" if ends[1:] else ""
        lines.append(f"    tip: {ends[0]}{further_tips}")
    lines.append("    base: {xyz: [0, 0, 0], rpy: [0, 0, 0]}")
    if ends[1:]:
        tips = ", ".join(f"tip_{k}: {end}" for k, end in enumerate(ends[:_MOST_TIPS], start=1))
        lines.append("# or one robot with several tips, whose trunk may move:")
        lines.append(f"# robots: {{{entry.name}: {{{_named(entry)}, tips: {{{tips}}}}}}}")
    return "\n".join(lines)


def _named(entry: RobotEntry) -> str:
    key = "mjcf" if entry.urdf.suffix == ".xml" else "urdf"
    return f"{key}: {entry.urdf}" if entry.source == FILE else f"robot: {entry.name}"


def _words(joint: JointOutline) -> str:
    """Kind and limits of a joint, those that there are."""
    unit, effort = ("m", "N") if joint.kind == "prismatic" else ("rad", "N m")
    words = [joint.kind if joint.mimic is None else f"{joint.kind}, copies {joint.mimic.joint}"]
    if math.isfinite(joint.lower):
        words.append(f"{number(joint.lower, digits=4)} to {number(joint.upper, unit, digits=4)}")
    if math.isfinite(joint.velocity_limit):
        words.append(number(joint.velocity_limit, f"{unit}/s", digits=4))
    if math.isfinite(joint.effort_limit):
        words.append(number(joint.effort_limit, effort, digits=4))
    return ", ".join(words)
