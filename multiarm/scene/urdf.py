"""The outline of a URDF file: names, types and limits, and what hangs on what.

A scene can be checked, with every fault, from these alone.  Pinocchio, which reads the file for the
dynamics, leaves out what has faulty numbers, and of other faults it says only that the file is not
valid.  So the file is looked through here, with the standard library, in milliseconds.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from multiarm.errors import ModelError
from multiarm.scene.faults import listed, shown, unknown

CHAIN_JOINTS = ("revolute", "continuous", "prismatic")
"""Joints by which arms move."""
MOST_JOINTS = 16
"""Of one arm."""
_MOST_BYTES, _MOST_PARTS = 20_000_000, 2000  # of a URDF; of its links, and of its joints
_ROUNDING = 1e-12  # below zero, of a moment of inertia [kg m^2]
_KNOWN_JOINTS = (*CHAIN_JOINTS, "fixed", "planar", "floating")


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
class RobotOutline:
    """Names and structure of one robot, from a URDF or from an MJCF file.

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
    sorted_by_name : bool
        Whether Pinocchio takes the joints below a link by their names, as of a URDF; else in the
        order of the file.
    """

    path: Path
    links: tuple[str, ...]
    joints: tuple[JointOutline, ...]
    meshes: tuple[str, ...]
    root: str
    text: str | None = None
    sorted_by_name: bool = True

    def in_model_order(self) -> tuple[JointOutline, ...]:
        """All joints, fixed ones too, in the order of Pinocchio's model: depth first."""
        below: dict[str, list[JointOutline]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        if self.sorted_by_name:
            for joints in below.values():
                joints.sort(key=lambda joint: joint.name)
        ordered, ahead = [], below.get(self.root, [])[::-1]
        while ahead:
            ordered.append(ahead.pop())
            ahead += below.get(ordered[-1].child, [])[::-1]
        return tuple(ordered)

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

    @property
    def leaves(self) -> tuple[str, ...]:
        """The links that carry no other."""
        parents = {joint.parent for joint in self.joints}
        return tuple(link for link in self.links if link not in parents)

    def movable(self, tip: str) -> tuple[JointOutline, ...]:
        """The joints that move link ``tip``, from the root on."""
        return tuple(joint for joint in self.chain(tip) if joint.movable)

    def ends_an_arm(self, tip: str) -> bool:
        """Whether 1 to 16 joints that each move by one number lead to link ``tip``."""
        joints = self.movable(tip)
        return 1 <= len(joints) <= MOST_JOINTS and all(
            joint.kind in CHAIN_JOINTS and joint.mimic is None for joint in joints
        )

    def carried_by(self, joints: Collection[str]) -> tuple[str, ...]:
        """The links that at least one of these joints carries."""
        return tuple(
            link for link in self.links if any(joint.name in joints for joint in self.chain(link))
        )


def read_urdf(path: Path | str) -> RobotOutline:
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
def outline_of_text(text: str, name: str) -> RobotOutline:
    """The outline of a URDF that is no file; `name` is its name in messages."""
    return replace(_outline(ElementTree.fromstring(text), Path(name)), text=text)


@lru_cache(maxsize=128)
def _read(path: Path, _stamp: int) -> RobotOutline:
    return _outline(read_xml(path), path)


def read_xml(path: Path) -> ElementTree.Element:
    """The root element of the XML file of a robot.

    Raises
    ------
    ModelError
        If it is no ordinary file, larger than any robot's, or not plain XML.
    """
    try:
        if not path.is_file():
            raise ModelError(f"{path} is no ordinary file; name the file of a robot")
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise ModelError(f"{path} has {size:,} bytes; a robot has at most {_MOST_BYTES:,}")
        text = path.read_bytes()
        if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise ModelError(f"{path} is text in UTF-16; save it as UTF-8")
        if b"<!DOCTYPE" in text:  # entities in it may expand to any length, or read other files
            raise ModelError(f"{path} has a document type '<!DOCTYPE'; remove it, robots have none")
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ModelError(f"{path} is not valid XML: {error}") from None
    except OSError as error:
        raise ModelError(f"cannot read {path}: {error.strerror or error}") from None


def _outline(robot: ElementTree.Element, path: Path) -> RobotOutline:
    if robot.tag != "robot":
        remedy = "; name it with 'mjcf:'" if robot.tag == "mujoco" else ""
        raise ModelError(f"{path} is not a URDF file: its root element is <{robot.tag}>{remedy}")
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
    return RobotOutline(path, links, joints, tuple(meshes), root_link(links, joints, path))


def root_link(links: tuple[str, ...], joints: tuple[JointOutline, ...], path: Path) -> str:
    """The link that has no parent.

    Raises
    ------
    ModelError
        If these are not one tree, or two of them have one name.
    """
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
        raise ModelError(f"{path}: {listed(twice)} hang on more than one joint; a robot is a tree")
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
    axis, dynamics, mimic = map(element.find, ("axis", "dynamics", "mimic"))
    x, y, z = map(float, ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split())
    if kind != "fixed" and not math.hypot(x, y, z) > 0.0:
        raise ModelError(f"{where}: its axis has length zero; give it a direction, such as '0 0 1'")
    if kind in ("revolute", "prismatic"):
        missing = [key for key in ("effort", "velocity") if limit is None or limit.get(key) is None]
        if missing:
            raise ModelError(f"{where}: needs <limit lower=.. upper=.. effort=.. velocity=../>")
    lower = _number(limit, "lower", 0.0) if bounded else -math.inf
    upper = _number(limit, "upper", 0.0) if bounded else math.inf
    if lower > upper:
        raise ModelError(f"{where}: its lower limit {lower:g} is above its upper limit {upper:g}")
    return JointOutline(
        name=name,
        kind=kind,
        parent=_required(parent, "link", path),
        child=_required(child, "link", path),
        axis=(x, y, z),
        lower=lower,
        upper=upper,
        velocity_limit=_number(limit, "velocity", math.inf),
        effort_limit=_number(limit, "effort", math.inf),
        mimic=None if mimic is None else _mimic(mimic, path),
        damping=_number(dynamics, "damping", 0.0),
        friction=_number(dynamics, "friction", 0.0),
    )


def _mimic(element: ElementTree.Element, path: Path) -> Mimic:
    multiplier, offset = _number(element, "multiplier", 1.0), _number(element, "offset", 0.0)
    return Mimic(_required(element, "joint", path), multiplier, offset)


def _required(element: ElementTree.Element, key: str, path: Path) -> str:
    value = element.get(key)
    if not value:
        raise ModelError(f"{path}: a <{element.tag}> has no {key!r}")
    return value


def _number(element: ElementTree.Element | None, key: str, default: float) -> float:
    """An attribute that :func:`_check_numbers` has seen."""
    text = None if element is None else element.get(key)
    return default if text is None else float(text)


_INERTIAS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_COUNTS = {
    "origin": {"xyz": 3, "rpy": 3}, "axis": {"xyz": 3}, "box": {"size": 3}, "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1}, "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3}, "color": {"rgba": 4}, "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIAS, 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1}, "mimic": {"multiplier": 1, "offset": 1},
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
    if _number(mass, "value", 0.0) < 0.0:
        raise ModelError(f"{where}: its mass must not be negative, got {shown(mass.get('value'))}")
    for key in _INERTIAS:
        number = _number(inertia, key, math.nan)
        if math.isnan(number) or (key[1] == key[2] and number < -_ROUNDING):
            raise ModelError(f"{where}: {key} of its inertia is missing, or negative")


def _finite(text: str, count: int) -> bool:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return False
    return len(numbers) == count and all(map(math.isfinite, numbers)) and "_" not in text
