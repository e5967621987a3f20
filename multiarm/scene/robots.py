"""Robots by name, and the outlines of their URDF files.

``robot: ur5`` stands for the path of a URDF file.  Two collections are known.  The project's own
robots lie in ``robots/<name>/<name>.urdf`` (inside the installed package, or at the top of a
checkout).  The fixed-base arms of ``example-robot-data`` are found through the metadata of that
installed distribution, wherever it lives.  A model of the project wins over one of the same name
elsewhere.

A scene can be checked, with every fault, from the names, types and limits of a URDF alone.  So the
reader here needs the standard library only, takes milliseconds, and leaves inertias and geometry to
the dynamics.
"""

from __future__ import annotations

import importlib.metadata
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from multiarm.errors import ModelError, SceneError
from multiarm.scene.faults import listed, shown, unknown

_MOST_BYTES, _MOST_PARTS = 20_000_000, 2000  # of a URDF; of its links, and of its joints
_MOST_MESH_BYTES = 1 << 30
CHAIN_JOINTS = ("revolute", "continuous", "prismatic")
_KNOWN_JOINTS = (*CHAIN_JOINTS, "fixed", "planar", "floating")

_DISTRIBUTION = "example-robot-data"
_SHARE = "cmeel.prefix/share"

# name -> (file below example-robot-data/robots, usual tip)
_EXAMPLE_ARMS = {
    "ur3": ("ur_description/urdf/ur3_robot.urdf", "tool0"),
    "ur3_gripper": ("ur_description/urdf/ur3_gripper.urdf", "tool0"),
    "ur3_limited": ("ur_description/urdf/ur3_joint_limited_robot.urdf", "tool0"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "ur5_gripper": ("ur_description/urdf/ur5_gripper.urdf", "tool0"),
    "ur5_limited": ("ur_description/urdf/ur5_joint_limited_robot.urdf", "tool0"),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "ur10_limited": ("ur_description/urdf/ur10_joint_limited_robot.urdf", "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "z1": ("z1_description/urdf/z1.urdf", "gripperStator"),
    "so100": ("so_arm_description/urdf/so100.urdf", "gripper"),
    "so101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
    "talos_arm": ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link"),
    "asr_twodof": ("asr_twodof_description/urdf/TwoDofs.urdf", "Tip"),
    "double_pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", "link2"),
}
# name -> usual tip
_OWN_ROBOTS = {
    "planar_2r": "tip",
    "planar_3r": "tip",
    "textbook_6r": "tool",
    "corner_gripper": "corner",
}


@dataclass(frozen=True)
class RobotEntry:
    """A robot that a scene may name: its name, URDF file, and the link usually used as the tip."""

    name: str
    urdf: Path
    tip: str


def available_robots() -> dict[str, RobotEntry]:
    """All robots that can be used by name on this machine, the project's own first."""
    return {**_own_robots(), **{k: v for k, v in _example_arms().items() if k not in _OWN_ROBOTS}}


def find_robot(name: str) -> RobotEntry:
    """The robot called ``name``.

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
    """The folders in which ``package://name/...`` is looked for, in order.

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
    """The file of a mesh address of a URDF, or None if there is none.

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


def mesh_fault(path: Path) -> str:
    """Why no reader of meshes should open a file; empty where one may.

    Readers trust the counts that a file declares, and compute with whatever numbers it has.
    """
    if not path.is_file():
        return "there is no such file"
    size = path.stat().st_size
    if size > _MOST_MESH_BYTES:
        return f"it has {size:,} bytes, more than {_MOST_MESH_BYTES:,}"
    content = path.read_bytes()
    ending = path.suffix.lower()
    if ending == ".stl" and not content.startswith(b"solid"):
        declared = int.from_bytes(content[80:84], "little")
        if not declared or size < 84 + 50 * declared:
            return f"it declares {declared:,} triangles, and has {max(size - 84, 0) // 50:,}"
        import numpy as np

        triangles = np.frombuffer(content, np.dtype("<12f4,u2"), declared, 84)
        return "" if np.isfinite(triangles["f0"]).all() else "a number is not finite"
    if ending == ".ply":
        declared = sum(map(int, re.findall(rb"^element \w+ (\d{1,18})", content[:4096], re.M)))
        return "" if 0 < declared <= size else f"it declares {declared:,} vertices and faces"
    if re.search(rb"(?i)(?<![\w#])[-+]?(nan|inf|infinity)(?!\w)", content):
        return "a number is not finite"
    return ""


def _own_robots() -> dict[str, RobotEntry]:
    package = Path(__file__).resolve().parents[1]
    entries = {}
    for name, tip in _OWN_ROBOTS.items():
        for folder in (package / "robots", package.parent / "robots"):
            urdf = folder / name / f"{name}.urdf"
            if urdf.is_file():
                entries[name] = RobotEntry(name, urdf, tip)
                break
    return entries


def _example_arms() -> dict[str, RobotEntry]:
    share = _share_folder()
    if share is None:
        return {}
    robots = share / "example-robot-data" / "robots"
    return {
        name: RobotEntry(name, robots / file, tip)
        for name, (file, tip) in _EXAMPLE_ARMS.items()
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


# --- outlines of URDF files -----------------------------------------------------------------------


@dataclass(frozen=True)
class Mimic:
    """position = multiplier * (position of ``joint``) + offset"""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointOutline:
    """A joint as its URDF names it.

    Attributes
    ----------
    name, parent, child : str
        The joint and the links it connects.
    kind : str
        revolute, continuous, prismatic, fixed, planar or floating.
    axis : tuple of 3 floats
        In the joint frame.
    lower, upper : float
        Position limits [rad] or [m]; infinite where there are none.
    velocity_limit, effort_limit : float
        [rad/s] or [m/s], [N m] or [N]; infinite where there are none.
    mimic : Mimic or None
        The joint it copies.
    damping, friction : float
        Of ``<dynamics>``: viscous [N m s/rad] or [N s/m] and dry friction [N m] or [N]; 0 where
        there are none.
    """

    name: str
    kind: str
    parent: str
    child: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    velocity_limit: float
    effort_limit: float
    mimic: Mimic | None = None
    damping: float = 0.0
    friction: float = 0.0

    @property
    def movable(self) -> bool:
        """Whether the joint moves at all."""
        return self.kind != "fixed"

    @property
    def neutral(self) -> float:
        """The position nearest to 0 within the limits."""
        return min(max(0.0, self.lower), self.upper)


@dataclass(frozen=True)
class UrdfOutline:
    """Names and structure of one URDF.

    Attributes
    ----------
    path : Path
        The file; if there is none, the name in messages.
    links : tuple of str
        All link names.
    joints : tuple of JointOutline
        All joints, in file order.
    meshes : tuple of str
        Addresses of the visual meshes as written in the file, each once.
    root : str
        The link that has no parent.
    text : str or None
        The URDF itself, where there is no file.
    """

    path: Path
    links: tuple[str, ...]
    joints: tuple[JointOutline, ...]
    meshes: tuple[str, ...]
    root: str
    text: str | None = None

    def chain(self, tip: str) -> tuple[JointOutline, ...]:
        """All joints, fixed ones too, from the root to link ``tip``.

        Raises
        ------
        ModelError
            If there is no such link.
        """
        if tip not in self.links:
            raise ModelError(f"{unknown('link', tip, self.links)} (of {self.path.name})")
        above = {joint.child: joint for joint in self.joints}
        chain = []
        while tip in above:
            chain.append(above[tip])
            tip = above[tip].parent
        return tuple(reversed(chain))

    def carried_by(self, joints: Collection[str]) -> tuple[str, ...]:
        """The links that some of these joints carry."""
        return tuple(
            link for link in self.links if any(joint.name in joints for joint in self.chain(link))
        )


def read_urdf(path: Path | str) -> UrdfOutline:
    """Read the outline of a URDF file.

    Raises
    ------
    ModelError
        If the file cannot be read or is not one tree of links and joints.
    """
    path = Path(path)
    try:
        stamp = path.stat().st_mtime_ns
    except OSError:
        raise ModelError(f"no URDF file at {path}") from None
    if path.is_dir():
        raise ModelError(f"{path} is a folder; name the URDF file in it")
    return _read(path, stamp)


@lru_cache(maxsize=128)
def outline_of_text(text: str, name: str) -> UrdfOutline:
    """The outline of a URDF that is no file; `name` is its name in messages."""
    return replace(_outline(ElementTree.fromstring(text), Path(name)), text=text)


@lru_cache(maxsize=128)
def _read(path: Path, _stamp: int) -> UrdfOutline:
    try:
        if not path.is_file():
            raise ModelError(f"{path} is no ordinary file; name the file of a URDF")
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise ModelError(f"{path} has {size:,} bytes; a URDF has at most {_MOST_BYTES:,}")
        text = path.read_bytes()
        if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise ModelError(f"{path} is text in UTF-16; save it as UTF-8")
        if b"<!DOCTYPE" in text:  # entities in it may expand to any length, or read other files
            raise ModelError(f"{path} has a document type '<!DOCTYPE'; a URDF has none: remove it")
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ModelError(f"{path} is not valid XML: {error}") from None
    except OSError as error:
        raise ModelError(f"cannot read {path}: {error.strerror}") from None
    return _outline(robot, path)


def _outline(robot: ElementTree.Element, path: Path) -> UrdfOutline:
    if robot.tag != "robot":
        raise ModelError(f"{path} is not a URDF file: its root element is <{robot.tag}>")
    if any("xacro" in str(element.tag) for element in robot.iter()):
        raise ModelError(f"{path} is a xacro file; expand it first: xacro {path.name} > robot.urdf")
    counts = {noun: len(robot.findall(noun)) for noun in ("link", "joint")}
    for noun, count in counts.items():
        if count > _MOST_PARTS:
            raise ModelError(f"{path} has {count:,} {noun}s; at most {_MOST_PARTS:,} are possible")
    for part in (*robot.findall("link"), *robot.findall("joint"), *robot.findall("material")):
        _check_numbers(part, f"{path}, {part.tag} {shown(part.get('name'))}")
    links = tuple(_required(link, "name", path) for link in robot.findall("link"))
    joints = tuple(_joint(joint, path) for joint in robot.findall("joint"))
    meshes = dict.fromkeys(
        mesh.get("filename", "") for mesh in robot.findall("link/visual/geometry/mesh")
    )
    return UrdfOutline(path, links, joints, tuple(meshes), _root(links, joints, path))


def _root(links: tuple[str, ...], joints: tuple[JointOutline, ...], path: Path) -> str:
    for names, noun in ((links, "link"), ([j.name for j in joints], "joint")):
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise ModelError(f"{path} has more than one {noun} named {listed(twice)}")
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise ModelError(f"{path}, joint {joint.name!r}: {unknown('link', link, links)}")
    children = [joint.child for joint in joints]
    if len(set(children)) < len(children):
        twice = sorted({child for child in children if children.count(child) > 1})
        raise ModelError(f"{path}: {listed(twice)} hang on more than one joint; a URDF is a tree")
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise ModelError(f"{path} must have exactly one root link, it has {listed(roots)}")
    below: dict[str, list[str]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint.child)
    reached = [roots[0]]
    for link in reached:  # grows meanwhile; every link but the root hangs on one joint
        reached += below.get(link, ())
    apart = [link for link in links if link not in set(reached)]
    if apart:
        raise ModelError(
            f"{path}: {listed(apart)} hang on each other in a circle; a URDF is a tree"
        )
    return roots[0]


def _joint(element: ElementTree.Element, path: Path) -> JointOutline:
    name, kind = _required(element, "name", path), _required(element, "type", path)
    where = f"{path}, joint {name!r}"
    if kind not in _KNOWN_JOINTS:
        raise ModelError(f"{where}: {unknown('type', kind, _KNOWN_JOINTS)}")
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ModelError(f"{where}: needs <parent link=.../> and <child link=.../>")
    limit = element.find("limit")
    bounded = limit is not None and kind in ("revolute", "prismatic")
    axis, dynamics = element.find("axis"), element.find("dynamics")
    text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
    if kind in ("revolute", "prismatic"):
        missing = [key for key in ("effort", "velocity") if limit is None or limit.get(key) is None]
        if missing:
            raise ModelError(f"{where}: needs <limit lower=.. upper=.. effort=.. velocity=../>")
    lower = _number(limit, "lower", 0.0, where) if bounded else -math.inf
    upper = _number(limit, "upper", 0.0, where) if bounded else math.inf
    if lower > upper:
        raise ModelError(f"{where}: its lower limit {lower:g} is above its upper limit {upper:g}")
    return JointOutline(
        name=name,
        kind=kind,
        parent=_required(parent, "link", path),
        child=_required(child, "link", path),
        axis=_axis(text, where, turns=kind != "fixed"),
        lower=lower,
        upper=upper,
        velocity_limit=_number(limit, "velocity", math.inf, where),
        effort_limit=_number(limit, "effort", math.inf, where),
        mimic=_mimic(element.find("mimic"), where, path),
        damping=_number(dynamics, "damping", 0.0, where),
        friction=_number(dynamics, "friction", 0.0, where),
    )


def _mimic(element: ElementTree.Element | None, where: str, path: Path) -> Mimic | None:
    if element is None:
        return None
    return Mimic(
        _required(element, "joint", path),
        _number(element, "multiplier", 1.0, where),
        _number(element, "offset", 0.0, where),
    )


def _required(element: ElementTree.Element, key: str, path: Path) -> str:
    value = element.get(key)
    if not value:
        raise ModelError(f"{path}: a <{element.tag}> has no {key!r}")
    return value


def _number(element: ElementTree.Element | None, key: str, default: float, where: str) -> float:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if math.isnan(number) or "_" in text:
        raise ModelError(f"{where}: {key} must be a number, got {shown(text)}")
    return number


def _three(text: str, what: str, where: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        raise ModelError(f"{where}: {what} must be three numbers, got {shown(text)}") from None
    return x, y, z


def _axis(text: str, where: str, turns: bool) -> tuple[float, float, float]:
    axis = _three(text, "axis", where)
    if turns and not math.hypot(*axis) > 0.0:
        raise ModelError(f"{where}: its axis has length zero; give it a direction, such as '0 0 1'")
    return axis


_INERTIAS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_COUNTS = {
    "origin": {"xyz": 3, "rpy": 3}, "axis": {"xyz": 3}, "box": {"size": 3}, "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1}, "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3}, "color": {"rgba": 4}, "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIAS, 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
}  # fmt: skip
"""Attributes of a URDF that are so many finite numbers; Pinocchio would leave out what has others.
"""


def _check_numbers(part: ElementTree.Element, where: str) -> None:
    """Refuse numbers that are none, and masses that no body has."""
    for element in part.iter():
        for key, count in _COUNTS.get(element.tag, {}).items():
            text = element.get(key)
            if text is not None and not _finite(text, count):
                several = f"{count} finite numbers" if count > 1 else "a finite number"
                raise ModelError(
                    f"{where}: {key} of <{element.tag}> must be {several}, got {shown(text)}"
                )
        if element.tag == "geometry" and not len(element):
            raise ModelError(f"{where}: a <geometry> has no shape in it")
    inertial = part.find("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or mass.get("value") is None:
        raise ModelError(f"{where}: its <inertial> has no <mass value=...>")
    if not float(mass.get("value", "")) >= 0.0:
        raise ModelError(f"{where}: its mass must not be negative, got {shown(mass.get('value'))}")
    for key in _INERTIAS:
        number = math.nan if inertia is None else _number(inertia, key, math.nan, where)
        if math.isnan(number) or (key[1] == key[2] and number < 0.0):
            raise ModelError(f"{where}: {key} of its inertia is missing, or negative")


def _finite(text: str, count: int) -> bool:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return False
    return len(numbers) == count and all(map(math.isfinite, numbers)) and "_" not in text
