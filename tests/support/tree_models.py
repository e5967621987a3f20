"""Scenes whose robots are trees, as Pinocchio models: read from plain tables, not by the package.

A scene is a dictionary as its YAML file would be.  Each robot becomes one model: base joints, then
the joints on the way to its tips and to the links that connections name, in Pinocchio's order; all
others are locked.  Every joint has one coordinate: continuous joints turn as revolute ones.  Each
object is a model of its own, a free body.

Not read: control other than constant torques, effects, tools, joints without ``at``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from multiarm.scene import find_robot

OBJECT, WORLD = "object", "world"
MOVES = {
    "x": pin.JointModelPX, "y": pin.JointModelPY, "z": pin.JointModelPZ, "yaw": pin.JointModelRZ,
}  # fmt: skip
DIFFERENTIAL, ON_WHEELS = "differential", ("x", "y", "yaw")


class Mimic(NamedTuple):
    """position of ``joint`` = multiplier * (position of ``leader``) + offset"""

    joint: str
    leader: str
    multiplier: float
    offset: float


class BodyFrame(NamedTuple):
    """A frame on a body: the body, its joint in the body's model, and the pose there.

    ``body`` is the name of a robot or of an object, or ``world``.
    """

    body: str
    joint: int
    placement: pin.SE3

    def at(self, X: pin.SE3) -> BodyFrame:
        return self._replace(placement=self.placement * X)


class Connection(NamedTuple):
    """A joint of the scene: its name, its table, and its frames on both bodies."""

    name: str
    joint: dict[str, Any]
    first: BodyFrame
    second: BodyFrame


@dataclass(frozen=True)
class RobotModel:
    """A robot as a Pinocchio model with one coordinate a joint.

    Attributes
    ----------
    model : pinocchio.Model
    joints : tuple of str
        Base joints first, then as in the robot's file.
    floats : bool
        Whether the first joint is a free flyer, which is none of these.
    links : dict link -> BodyFrame
    tips : dict tip -> link
        Of an arm under ``arms:`` its tip under the key "".
    mimics : tuple of Mimic
        Between joints that move.
    """

    model: pin.Model
    joints: tuple[str, ...]
    links: dict[str, BodyFrame]
    tips: dict[str, str]
    mimics: tuple[Mimic, ...]
    floats: bool = False
    wheels: BodyFrame | None = None  # a frame whose origin does not slip along its y axis


@dataclass(frozen=True)
class TreeState:
    """A state; the fields are the arguments of ``system.state``.

    Of objects and of bases that float: ``position`` (3,), ``quaternion_xyzw`` (4,), ``twist`` (6,).
    """

    objects: dict[str, dict[str, np.ndarray]]
    joint_positions: dict[str, np.ndarray]
    joint_velocities: dict[str, np.ndarray] = field(default_factory=dict)
    bases: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)

    @property
    def object_position(self) -> np.ndarray:
        """Of the only object."""
        return only(self.objects)["position"]

    @property
    def object_quaternion_xyzw(self) -> np.ndarray:
        """Of the only object."""
        return only(self.objects)["quaternion_xyzw"]

    @property
    def object_twist(self) -> np.ndarray:
        """Of the only object."""
        return only(self.objects)["twist"]


@dataclass(frozen=True)
class TreeScene:
    """Robots, objects and connections of a scene."""

    gravity: np.ndarray
    objects: dict[str, pin.Model]
    robots: dict[str, RobotModel]
    connections: tuple[Connection, ...]


# --- small values --------------------------------------------------------------------------------


def only(things: dict[str, Any]) -> Any:
    """The value of a table with one entry."""
    (thing,) = things.values()
    return thing


def placement(pose: dict[str, Any] | None) -> pin.SE3:
    """A pose of a scene."""
    pose = pose or {}
    if pose.get("quaternion_xyzw") is not None:
        turn = Rotation.from_quat(pose["quaternion_xyzw"])
    else:
        turn = Rotation.from_euler("xyz", pose.get("rpy", [0.0, 0.0, 0.0]))
    return pin.SE3(turn.as_matrix(), np.array(pose.get("xyz", [0.0, 0.0, 0.0]), dtype=float))


def pose_of(X: pin.SE3) -> dict[str, Any]:
    """A pose as a scene has it."""
    turn = Rotation.from_matrix(X.rotation).as_quat()
    return {"xyz": X.translation.tolist(), "quaternion_xyzw": turn.tolist()}


def inertia_matrix(entries: Any) -> np.ndarray:
    """Three principal moments, six entries, or the matrix itself [kg m^2]."""
    entries = np.array(entries, dtype=float)
    if entries.shape == (3,):
        return np.diag(entries)
    if entries.shape == (6,):
        xx, xy, xz, yy, yz, zz = entries
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return entries


# --- robots --------------------------------------------------------------------------------------


def _file_of(spec: dict[str, Any]) -> Path:
    return Path(spec["urdf"]) if "urdf" in spec else find_robot(spec["robot"]).urdf


def _mimics(path: Path, spec: dict[str, Any]) -> dict[str, Mimic]:
    """Those of the URDF, and those of the scene, which replace them."""
    mimics = {}
    for joint in ElementTree.parse(path).getroot().iter("joint"):
        for entry in joint.findall("mimic"):
            mimics[joint.get("name")] = Mimic(
                joint.get("name"), entry.get("joint"),
                float(entry.get("multiplier", 1.0)), float(entry.get("offset", 0.0)),
            )  # fmt: skip
    for name, entry in spec.get("mimic", {}).items():
        mimics[name] = Mimic(
            name, entry["of"], entry.get("multiplier", 1.0), entry.get("offset", 0.0)
        )
    return mimics


def _moving(model: pin.Model, links: set[str], lock: dict, mimics: dict[str, Mimic]) -> list[str]:
    """Joints on the way to the links, but for locked ones and followers of what does not move."""
    on_way: set[int] = set()
    for link in links:
        on_way |= {i for i in model.supports[_link_frame(model, link).parentJoint] if i > 1}
    moving = [model.names[i] for i in sorted(on_way) if model.names[i] not in lock]
    while stuck := [j for j in moving if j in mimics and mimics[j].leader not in moving]:
        moving = [joint for joint in moving if joint not in stuck]
    return moving


def _link_frame(model: pin.Model, link: str) -> pin.Frame:
    if not model.existFrame(link, pin.FrameType.BODY):
        raise ValueError(f"no link {link!r}")
    return model.frames[model.getFrameId(link, pin.FrameType.BODY)]


def _locked_positions(
    model: pin.Model, lock: dict[str, float], mimics: dict[str, Mimic]
) -> np.ndarray:
    """Configuration at which joints are locked: as written, as they follow, else nearest to 0.

    ``mimics`` are those of locked joints.
    """
    q = pin.neutral(model)

    def position(name: str) -> float:
        if name in lock:
            return lock[name]
        if name in mimics:
            mimic = mimics[name]
            return mimic.multiplier * position(mimic.leader) + mimic.offset
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 2:
            return 0.0
        lower, upper = (limit[joint.idx_q] for limit in _position_limits(model))
        return float(min(max(0.0, lower), upper))

    for name, joint in zip(list(model.names)[2:], model.joints.tolist()[2:], strict=True):
        value = position(name)
        pair = [np.cos(value), np.sin(value)]
        q[joint.idx_q : joint.idx_q + joint.nq] = pair if joint.nq == 2 else value
    return q


def _position_limits(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    return model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()


def joint_motion(joint: pin.JointModel) -> tuple[bool, np.ndarray]:
    """Whether a joint with one degree of freedom slides, and its axis in its frame."""
    s = np.array(joint.createData().S, dtype=float).reshape(-1)
    return (True, s[:3]) if np.linalg.norm(s[:3]) > 0.5 else (False, s[3:])


def _add_joint(model: pin.Model, parent: int, tree: pin.Model, i: int, placed: pin.SE3) -> int:
    """Add joint ``i`` of another model, with one coordinate and its limits."""
    joint = tree.joints[i]
    if joint.nv != 1:
        raise ValueError(f"{tree.names[i]} has {joint.nv} degrees of freedom; lock it")
    slides, axis = joint_motion(joint)
    kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
    number = model.addJoint(parent, kind(axis), placed, tree.names[i])
    if joint.nq == 1:
        at = model.joints[number].idx_q
        lower, upper = _position_limits(model)
        from_lower, from_upper = _position_limits(tree)
        lower[at], upper[at] = from_lower[joint.idx_q], from_upper[joint.idx_q]
        model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    return number


def read_robot(name: str, spec: dict[str, Any], named_links: set[str]) -> RobotModel:
    """The robot of a scene's table.

    Parameters
    ----------
    named_links : set of str
        Links besides the tips to which joints move.
    """
    path = _file_of(spec)
    tips = dict(spec["tips"]) if "tips" in spec else ({"": spec["tip"]} if "tip" in spec else {})
    whole = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    lock, mimics = dict(spec.get("lock", {})), _mimics(path, spec)
    moving = _moving(whole, {*tips.values(), *named_links}, lock, mimics)
    fixed = [i for i in range(2, whole.njoints) if whole.names[i] not in moving]
    fixed_mimics = {follower: m for follower, m in mimics.items() if m.leader not in moving}
    tree = pin.buildReducedModel(whole, fixed, _locked_positions(whole, lock, fixed_mimics))
    model, carrier, root = _base(spec.get("base") or {})
    numbers = {1: carrier}
    model.appendBodyToJoint(carrier, tree.inertias[1], root)
    for i in range(2, tree.njoints):
        parent = tree.parents[i]
        placed = root * tree.jointPlacements[i] if parent == 1 else tree.jointPlacements[i]
        numbers[i] = _add_joint(model, numbers[parent], tree, i, placed)
        model.appendBodyToJoint(numbers[i], tree.inertias[i], pin.SE3.Identity())
    links = {}
    for frame in tree.frames:
        if frame.type == pin.FrameType.BODY:
            on_root = root if frame.parentJoint == 1 else pin.SE3.Identity()
            links[frame.name] = BodyFrame(
                name, numbers[frame.parentJoint], on_root * frame.placement
            )
    couplings = tuple(mimics[joint] for joint in moving if joint in mimics)
    floats = floats_free(spec)
    joints = tuple(list(model.names)[2 if floats else 1 :])
    on_wheels = (spec.get("base") or {}).get("moves") == DIFFERENTIAL
    wheels = BodyFrame(name, len(ON_WHEELS), pin.SE3.Identity()) if on_wheels else None
    return RobotModel(model, joints, links, tips, couplings, floats, wheels)


def floats_free(spec: dict[str, Any]) -> bool:
    """Whether the base of a robot's table floats."""
    return (spec.get("base") or {}).get("moves") == "free"


def _base(base: dict[str, Any]) -> tuple[pin.Model, int, pin.SE3]:
    """A model of the base joints, the joint that carries the root link, and its pose there."""
    model, carrier, root = pin.Model(), 0, placement(base)
    moves = base.get("moves", [])
    if moves == "free":
        root = pin.SE3.Identity()
        carrier = model.addJoint(0, pin.JointModelFreeFlyer(), root, "free")
        moves = []
    for move in ON_WHEELS if moves == DIFFERENTIAL else moves:
        carrier = model.addJoint(carrier, MOVES[move](), root, f"base_{move}")
        root = pin.SE3.Identity()
    if base.get("mass") is not None or base.get("inertia") is not None:
        moments = inertia_matrix(base.get("inertia", [0.0, 0.0, 0.0]))
        body = pin.Inertia(float(base.get("mass", 0.0)), np.zeros(3), moments)
        model.appendBodyToJoint(carrier, body, root)
    return model, carrier, root


# --- scenes --------------------------------------------------------------------------------------


def connection_ends(joint: dict[str, Any], objects: Iterable[str]) -> tuple[str, str]:
    """The bodies FIRST and SECOND of a joint as they are written, in a scene of these objects."""
    if "between" in joint:
        first, second = joint["between"]
        return first, second
    if "object" in joint:
        return joint["arm"], joint["object"]
    (held,) = objects
    return joint["arm"], held


def connection_name(joint: dict[str, Any]) -> str:
    return joint.get("name") or joint.get("arm") or "-".join(joint["between"])


def object_tables(scene: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of objects by name; ``object`` is the name of that below ``object:``."""
    return scene["objects"] if "objects" in scene else {OBJECT: scene["object"]}


def robot_tables(scene: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of arms, then those of robots, by name."""
    return {**scene.get("arms", {}), **scene.get("robots", {})}


def read_tree_scene(scene: dict[str, Any]) -> TreeScene:
    """The Pinocchio models of a scene, and its connections."""
    gravity = np.array(scene.get("gravity") or [0.0, 0.0, 0.0])
    objects = {name: _free_body(name, box) for name, box in object_tables(scene).items()}
    ends = [end for joint in scene["joints"] for end in connection_ends(joint, objects)]
    robots = {}
    for name, spec in robot_tables(scene).items():
        tips = set(spec.get("tips", {}))
        written = {end.partition("/")[2] for end in ends if end.startswith(f"{name}/")}
        robots[name] = read_robot(name, spec, written - tips)
    for model in (*objects.values(), *(robot.model for robot in robots.values())):
        model.gravity.linear = gravity
    trees = TreeScene(gravity, objects, robots, ())
    connections = [_read_connection(joint, trees) for joint in scene["joints"]]
    return replace(trees, connections=tuple(connections))


def _free_body(name: str, box: dict[str, Any]) -> pin.Model:
    free = pin.Model()
    free.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
    body = pin.Inertia(float(box["mass"]), np.zeros(3), inertia_matrix(box["inertia"]))
    free.appendBodyToJoint(1, body, pin.SE3.Identity())
    return free


def _read_connection(joint: dict[str, Any], trees: TreeScene) -> Connection:
    first, second = (body_frame(end, trees) for end in connection_ends(joint, trees.objects))
    on_first = joint.get("at_first", joint.get("at_tip"))
    return Connection(
        connection_name(joint), joint,
        first.at(placement(on_first)), second.at(placement(joint.get("at"))),
    )  # fmt: skip


def body_frame(end: str, trees: TreeScene) -> BodyFrame:
    """The frame of a body as a joint names it."""
    if end == WORLD:
        return BodyFrame(WORLD, 0, pin.SE3.Identity())
    if end in trees.objects:
        return BodyFrame(end, 1, pin.SE3.Identity())
    name, _, link = end.partition("/")
    robot = trees.robots[name]
    return robot.links[robot.tips.get(link, link)]


def start_of(scene: dict[str, Any], trees: TreeScene) -> TreeState:
    """The state that a scene writes: postures and velocities as lists, poses of the objects."""
    objects = {
        name: frame_state(placement(box.get("pose")), box.get("twist"))
        for name, box in object_tables(scene).items()
    }
    positions, velocities = {}, {}
    for name, spec in robot_tables(scene).items():
        n = len(trees.robots[name].joints)
        positions[name] = np.array(spec.get("posture", np.zeros(n)), dtype=float)
        velocities[name] = np.array(spec.get("velocity", np.zeros(n)), dtype=float)
    bases = {
        name: frame_state(placement(spec["base"]), spec["base"].get("twist"))
        for name, spec in robot_tables(scene).items()
        if trees.robots[name].floats
    }
    return TreeState(objects, positions, velocities, bases)


def frame_state(X: pin.SE3, twist: Any = None) -> dict[str, np.ndarray]:
    """A floating frame as a :class:`TreeState` has it; at rest where there is no twist."""
    return {
        "position": X.translation.copy(),
        "quaternion_xyzw": Rotation.from_matrix(X.rotation).as_quat(),
        "twist": np.zeros(6) if twist is None else np.array(twist, dtype=float),
    }


def constant_torques(scene: dict[str, Any], trees: TreeScene) -> dict[str, np.ndarray]:
    """Torques of the drives by robot; zero where a scene has no constant control."""
    control = scene.get("control") or {}
    torques = {name: np.zeros(len(robot.joints)) for name, robot in trees.robots.items()}
    if control.get("kind", "none") == "none":
        return torques
    if control["kind"] != "constant":
        raise ValueError(f"control {control['kind']!r} is not read here")
    return torques | {name: np.array(row, float) for name, row in control["torques"].items()}


def as_robots(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with its arms written as robots of one tip, called ``tip``.

    The connection ``left`` of an arm is then ``left/tip``; names of robots stay.
    """
    robots, joints = dict(scene.get("robots", {})), []
    for name, spec in scene["arms"].items():
        rest = {key: value for key, value in spec.items() if key != "tip"}
        robots[name] = {**rest, "tips": {"tip": spec["tip"]}}
    for joint in scene["joints"]:
        arm = joint.get("arm")
        joints.append({**joint, "arm": f"{arm}/tip"} if arm in scene["arms"] else joint)
    rest = {key: value for key, value in scene.items() if key != "arms"}
    return {**rest, "robots": robots, "joints": joints}
