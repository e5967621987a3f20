"""Robots by name: ``robot: ur5`` instead of the path of a URDF file.

Two collections are known. The project's own robots lie in ``robots/<name>/<name>.urdf`` (inside
the installed package, or at the top of a checkout). The fixed-base arms of ``example-robot-data``
are found through the metadata of that installed distribution, wherever it lives. A model of the
project wins over one of the same name elsewhere.
"""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from multiarm.errors import SceneError
from multiarm.scene.words import unknown

__all__ = [
    "RobotEntry",
    "available_robots",
    "find_robot",
    "resolve_mesh",
    "resolve_package_dirs",
]

_DISTRIBUTION = "example-robot-data"
_SHARE = "cmeel.prefix/share"

# name -> (file below example-robot-data/robots, usual tip, what it is)
_EXAMPLE_ARMS = {
    "ur3": ("ur_description/urdf/ur3_robot.urdf", "tool0", "Universal Robots UR3"),
    "ur3_gripper": ("ur_description/urdf/ur3_gripper.urdf", "tool0", "UR3 with gripper"),
    "ur3_limited": (
        "ur_description/urdf/ur3_joint_limited_robot.urdf",
        "tool0",
        "UR3, joints limited to half turns",
    ),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0", "Universal Robots UR5"),
    "ur5_gripper": ("ur_description/urdf/ur5_gripper.urdf", "tool0", "UR5 with gripper"),
    "ur5_limited": (
        "ur_description/urdf/ur5_joint_limited_robot.urdf",
        "tool0",
        "UR5, joints limited to half turns",
    ),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", "tool0", "Universal Robots UR10"),
    "ur10_limited": (
        "ur_description/urdf/ur10_joint_limited_robot.urdf",
        "tool0",
        "UR10, joints limited to half turns",
    ),
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", "Franka Emika Panda"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link_eef", "UFACTORY xArm 7"),
    "kinova": (
        "kinova_description/robots/kinova.urdf",
        "j2s6s200_end_effector",
        "Kinova Jaco 2, six joints",
    ),
    "z1": ("z1_description/urdf/z1.urdf", "gripperStator", "Unitree Z1"),
    "so100": ("so_arm_description/urdf/so100.urdf", "gripper", "SO-ARM 100"),
    "so101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", "SO-ARM 101"),
    "talos_arm": (
        "talos_data/robots/talos_left_arm.urdf",
        "gripper_left_base_link",
        "left arm of PAL Robotics TALOS",
    ),
    "asr_twodof": ("asr_twodof_description/urdf/TwoDofs.urdf", "Tip", "arm of two joints"),
    "double_pendulum": (
        "double_pendulum_description/urdf/double_pendulum.urdf",
        "link2",
        "double pendulum",
    ),
}

# name -> (usual tip, what it is)
_OWN_ROBOTS = {
    "planar_2r": ("tip", "two parallel hinges, moving in the x-y plane"),
    "planar_3r": ("tip", "three parallel hinges, moving in the x-y plane"),
    "textbook_6r": ("tool", "six hinges, three of them a wrist with offsets"),
    "corner_gripper": ("corner", "tool: four fingertips around a block's corner"),
}


@dataclass(frozen=True)
class RobotEntry:
    """A robot that a scene may name.

    Attributes
    ----------
    name : str
        What stands behind ``robot:``.
    urdf : Path
        Its URDF file.
    tip : str
        The link that is usually used as the tip.
    summary : str
        What it is.
    source : str
        The collection it comes from.
    """

    name: str
    urdf: Path
    tip: str
    summary: str
    source: str


def available_robots() -> dict[str, RobotEntry]:
    """Return all robots that can be used by name on this machine, the project's own first."""
    return {**_own_robots(), **{k: v for k, v in _example_arms().items() if k not in _OWN_ROBOTS}}


def find_robot(name: str) -> RobotEntry:
    """Return the robot called ``name``.

    Raises
    ------
    SceneError
        If there is none; the message names the alternatives.
    """
    robots = available_robots()
    if name in robots:
        return robots[name]
    message = unknown("robot", name, robots)
    if name in _EXAMPLE_ARMS and _share_folder() is None:
        message = f"robot {name!r} comes with {_DISTRIBUTION}; pip install {_DISTRIBUTION}"
    raise SceneError(f"{message}; or give the path of a file with 'urdf:'")


def resolve_package_dirs(urdf: Path, explicit: tuple[Path, ...] = ()) -> tuple[Path, ...]:
    """Return the folders in which ``package://name/...`` is looked for, in order.

    First the explicit folders (each may contain packages or be one), then the folders above the
    URDF, then those of ``ROS_PACKAGE_PATH``, then the installed example-robot-data.
    """
    folders = [folder for given in explicit for folder in (given, given.parent)]
    folders += list(urdf.resolve().parents)[:-1]
    folders += [Path(text) for text in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if text]
    share = _share_folder()
    if share is not None:
        folders += [share, share / "example-robot-data" / "robots"]
    return tuple(dict.fromkeys(folders))


def resolve_mesh(address: str, urdf: Path, package_dirs: tuple[Path, ...]) -> Path | None:
    """Return the file behind a mesh address of a URDF, or None if there is none.

    ``package://`` and ``model://`` are looked up in ``package_dirs``, ``file://`` and absolute
    paths taken as they are, other paths relative to the URDF's folder.
    """
    scheme, separator, rest = address.partition("://")
    if not separator:
        candidates = [urdf.parent / address]
    elif scheme == "file":
        candidates = [Path(rest)]
    else:
        candidates = [folder / rest.lstrip("/") for folder in package_dirs]
    return next((path for path in candidates if path.is_file()), None)


def _own_robots() -> dict[str, RobotEntry]:
    package = Path(__file__).resolve().parents[1]
    entries = {}
    for name, (tip, summary) in _OWN_ROBOTS.items():
        for folder in (package / "robots", package.parent / "robots"):
            urdf = folder / name / f"{name}.urdf"
            if urdf.is_file():
                entries[name] = RobotEntry(name, urdf, tip, summary, "multiarm")
                break
    return entries


def _example_arms() -> dict[str, RobotEntry]:
    share = _share_folder()
    if share is None:
        return {}
    robots = share / "example-robot-data" / "robots"
    return {
        name: RobotEntry(name, robots / file, tip, summary, _DISTRIBUTION)
        for name, (file, tip, summary) in _EXAMPLE_ARMS.items()
        if (robots / file).is_file()
    }


@lru_cache(maxsize=1)
def _share_folder() -> Path | None:
    try:
        distribution = importlib.metadata.distribution(_DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        return None
    share = Path(str(distribution.locate_file(_SHARE)))
    return share if share.is_dir() else None
