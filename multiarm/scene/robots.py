"""Robots by name, and the links that are usually their tips.

``robot: ur5`` stands for the path of a URDF file.  Three collections are known, and the first wins
where a name is in two: the project's own robots in ``robots/<name>/<name>.urdf`` at the top of a
checkout, or in the folder ``robot_files`` of the installed package; those of the installed
distribution ``example-robot-data``, wherever it lives, by the names of their files; and those of
the package ``robot_descriptions``, where that is installed.

Each of the last is a module, such as ``iiwa14_description``, that says where its URDF is.  Its
import clones the repository of the robot where the cache has none.  Nothing is downloaded unasked:
git may fetch nothing during the import, and the cache is a folder of links to the clones, so that
no empty clone is left in the user's.  Robots are listed as usable where the cache has a folder of
their repository's name.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import io
import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from multiarm.errors import USER_FAULTS, ModelError, SceneError
from multiarm.scene.faults import unknown
from multiarm.scene.mjcf import read_mjcf
from multiarm.scene.urdf import RobotOutline, read_urdf

PROJECT = "this project"
_DISTRIBUTION = "example-robot-data"
_SHARE = "cmeel.prefix/share"
DESCRIPTIONS, SUFFIX = "robot_descriptions", "_description"
_TRANSPORTS = "GIT_ALLOW_PROTOCOL"  # those that git may use
_CACHE = "ROBOT_DESCRIPTIONS_CACHE"  # the folder of the clones

# Names of robots that are not those of their files.
_FILES = {
    "ur3": "ur3_robot",
    "ur3_limited": "ur3_joint_limited_robot",
    "ur5": "ur5_robot",
    "ur5_limited": "ur5_joint_limited_robot",
    "ur10": "ur10_robot",
    "ur10_limited": "ur10_joint_limited_robot",
    "asr_twodof": "TwoDofs",
    "talos": "talos_reduced",
    "talos_arm": "talos_left_arm",
}
# The links that people take as tips, where the chain does not end in one link that says so.
_TIPS = {
    "corner_gripper": ("corner",),
    "crank": ("tip",),
    "panda": ("panda_hand_tcp",),
    "kinova": ("j2s6s200_end_effector",),
    "z1": ("gripperStator",),
    "so100": ("gripper",),
    "so101": ("gripper_frame_link",),
    "talos_arm": ("gripper_left_base_link",),
    "tiago": ("hand_tool_link",),
    "baxter": ("left_gripper", "right_gripper"),
    "pr2": ("l_gripper_tool_frame", "r_gripper_tool_frame"),
    "talos": ("gripper_left_base_link", "gripper_right_base_link"),
    "tiago_dual": ("hand_left_tool_link", "hand_right_tool_link"),
    "four_bar_gripper": ("left_pad", "right_pad"),
}
# The frame of a flange, which ROS-Industrial prescribes for all arms.
_FLANGE = "tool0"


@dataclass(frozen=True)
class RobotEntry:
    """A robot that a scene may name.

    Attributes
    ----------
    name : str
    urdf : Path
        Its file; that of a robot without a name may be MuJoCo's, ``.xml``.
    source : str
        The collection that it is from.
    """

    name: str
    urdf: Path
    source: str

    @property
    def outline(self) -> RobotOutline:
        """Its links and joints."""
        return read_mjcf(self.urdf) if self.urdf.suffix == ".xml" else read_urdf(self.urdf)

    @property
    def tips(self) -> tuple[str, ...]:
        """The links usually taken as the tip: one for each arm; empty where they are not known."""
        return usual_tips(self.outline, self.name)

    @property
    def tip(self) -> str | None:
        """The tip of an arm that names none; None where there are several, or it is not known."""
        return self.tips[0] if len(self.tips) == 1 else None


def available_robots() -> dict[str, RobotEntry]:
    """All robots that can be used by name on this machine, the project's own first."""
    robots = _project_robots()
    for name, urdf in _example_files().items():
        robots.setdefault(name, RobotEntry(name, urdf, _DISTRIBUTION))
    for name in _cached_descriptions():
        if name not in robots:
            with suppress(SceneError):
                robots[name] = _described_robot(name)
    return {name: entry for name, entry in robots.items() if _is_usable(entry)}


def find_robot(name: str) -> RobotEntry:
    """The robot called ``name``.

    Raises
    ------
    SceneError
        If there is none, or it has to be downloaded first; the message says what to do.
    """
    project, examples = _project_robots(), _example_files()
    if name in project:
        return project[name]
    if name in examples:
        return RobotEntry(name, examples[name], _DISTRIBUTION)
    described = described_robots()
    if name in described:
        return _described_robot(name)
    if name in {*_FILES, *_TIPS} and _share_folder() is None:
        message = f"robot {name!r} comes with {_DISTRIBUTION}; pip install {_DISTRIBUTION}"
    else:
        message = _unknown(name, described)
    if not described:
        message += f"; more come with {DESCRIPTIONS} (pip install {DESCRIPTIONS})"
    raise SceneError(f"{message}; or give the path of a file with 'urdf:'")


MISSPELT = 0.9
"""Similarity of two names from which on one is the other with a typing error."""


def _unknown(name: str, described: tuple[str, ...]) -> str:
    """The message that there is no such robot, with similar names: of arms, else of any robot."""
    robots = available_robots()
    arms = [robot for robot, entry in robots.items() if _is_arm(entry)]
    arms += [robot for robot in described if robot not in robots]
    not_arms = [robot for robot in robots if robot not in arms]
    misspelt = get_close_matches(name, not_arms, 1, MISSPELT)  # no arm, but hardly anything else
    near_arm = not misspelt and get_close_matches(name, arms, 1)
    return unknown("robot", name, arms if near_arm else [*arms, *not_arms])


def _is_arm(entry: RobotEntry) -> bool:
    """Whether its tip is known, and a joint moves it."""
    return any(entry.outline.movable(tip) for tip in entry.tips)


def described_robots() -> tuple[str, ...]:
    """The robots with a URDF, whether they are on this machine or not; none without the package."""
    return tuple(sorted(_descriptions()))


def _described_robot(name: str) -> RobotEntry:
    """A robot of ``robot_descriptions`` that is on this machine.

    Raises
    ------
    SceneError
        If it has to be downloaded first, or has no URDF file.
    """
    where = f"{DESCRIPTIONS}.{name}"
    imported = where in sys.modules
    with TemporaryDirectory() as folder:
        for clone in _cache().glob("*"):
            Path(folder, clone.name).symlink_to(clone)
        try:
            with _environment({_TRANSPORTS: "none", _CACHE: folder}), _silence():
                module = importlib.import_module(where)
        except USER_FAULTS:  # something that it needs is not there; to pull it tells what
            fetch = f"python -m {DESCRIPTIONS} pull {name}"
            message = f"robot {name!r} is not on this machine yet; fetch it: {fetch}"
            raise SceneError(message) from None
        path = Path(getattr(module, "URDF_PATH", "")).resolve()
    if not imported:  # its paths lead to the links, which are gone
        del sys.modules[where]
        delattr(sys.modules[DESCRIPTIONS], name)
    if not path.is_file():
        raise SceneError(
            f"{DESCRIPTIONS} has robot {name!r} as a xacro file; expand it (xacro), and give the "
            "path of the URDF with 'urdf:'"
        )
    return RobotEntry(name, path, DESCRIPTIONS)


def usual_tips(outline: RobotOutline, name: str | None = None) -> tuple[str, ...]:
    """The links usually taken as tips: one for each arm of a robot, or of a tool.

    Those that people take of the robot called ``name``, else the flange, else the only link in
    which a chain of joints ends, of a tool without joints the only link in which it ends.  Empty
    where several are possible.
    """
    known = tuple(tip for tip in _TIPS.get(name or "", ()) if tip in outline.links)
    if known:
        return known
    ends = arm_ends(outline)
    if _FLANGE in ends:
        return (_FLANGE,)
    return ends if len(ends) == 1 else ()


def arm_ends(outline: RobotOutline) -> tuple[str, ...]:
    """The last link of each chain that can be an arm; of a tool without joints, all last links."""
    if any(joint.movable for joint in outline.joints):
        return tuple(link for link in outline.leaves if outline.ends_an_arm(link))
    return outline.leaves


def resolve_package_dirs(urdf: Path, explicit: tuple[Path, ...] = ()) -> tuple[Path, ...]:
    """The folders in which ``package://name/...`` is looked for, in order.

    First the explicit folders (each may contain packages or be one), then the folders above the
    URDF, then those of ``ROS_PACKAGE_PATH``, then the installed example-robot-data.
    """
    folders = [place for folder in explicit for place in (folder, folder.parent)]
    folders += list(urdf.resolve().parents)[:-1]
    folders += [Path(text) for text in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if text]
    share = _share_folder()
    if share is not None:
        folders += [share, share / "example-robot-data" / "robots"]
    return tuple(dict.fromkeys(folders))


def _project_robots() -> dict[str, RobotEntry]:
    """The project's robots: in the installed package, or at the top of a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "robot_files", package.parent / "robots"):
        if folder.is_dir():
            files = sorted(folder.glob("*/*.urdf"))
            return {path.stem: RobotEntry(path.stem, path, PROJECT) for path in files}
    return {}


def _example_files() -> dict[str, Path]:
    """The URDF files of example-robot-data by name."""
    share = _share_folder()
    return {} if share is None else _named_files(share / "example-robot-data" / "robots")


@lru_cache(maxsize=1)
def _named_files(folder: Path) -> dict[str, Path]:
    """The files of a collection by name; files of equal names by the names of their folders."""
    files = sorted(folder.glob("*/*/*.urdf"))
    names = {stem: name for name, stem in _FILES.items()}
    named_files = {names[path.stem]: path for path in files if path.stem in names}
    counts = Counter(path.stem for path in files)
    for path in files:
        if path.stem not in names:
            package = path.parents[1].name.removesuffix(SUFFIX)
            named_files.setdefault(path.stem if counts[path.stem] == 1 else package, path)
    return dict(sorted(named_files.items()))


def _descriptions() -> dict[str, Any]:
    """The package's descriptions of robots with a URDF, by name; none without the package."""
    try:
        package = importlib.import_module(DESCRIPTIONS)
    except ImportError:
        return {}
    return {name: about for name, about in package.DESCRIPTIONS.items() if about.has_urdf}


def _cached_descriptions() -> list[str]:
    """The robots whose repository has a folder of its name in the cache of the package."""
    folders = {_letters(folder.name) for folder in _cache().glob("*")}
    return [
        name
        for name, about in _descriptions().items()
        if _letters(about.repository or "") in folders
    ]


def _cache() -> Path:
    """The folder in which ``robot_descriptions`` keeps its clones."""
    return Path(os.environ.get(_CACHE, "~/.cache/robot_descriptions")).expanduser()


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables of the environment, and set them back."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ.update({} if value is None else {name: value})


@contextmanager
def _silence() -> Iterator[None]:
    """Hide what is printed, such as the progress of a clone."""
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        yield


def _letters(name: str) -> str:
    """A repository's name as its folder's may be: case, '-' and '_' differ."""
    return name.lower().replace("-", "_")


def _is_usable(entry: RobotEntry) -> bool:
    try:
        outline = entry.outline
    except ModelError:  # such as a piece that other files include
        return False
    return entry.source == PROJECT or any(map(outline.ends_an_arm, outline.leaves))


@lru_cache(maxsize=1)
def _share_folder() -> Path | None:
    try:
        distribution = importlib.metadata.distribution(_DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        return None
    share = Path(str(distribution.locate_file(_SHARE)))
    return share if share.is_dir() else None
