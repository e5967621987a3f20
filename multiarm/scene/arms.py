"""An arm as a user writes it, and the chain of joints that moves it.

The chain runs from the robot's root through the mount and the tool's root to the tip. Its movable
joints, without the locked ones, carry the arm's coordinates: ONE number each. Joints off the chain
(fingers, say) are held fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator
from typing_extensions import Self

from multiarm.errors import ModelError, SceneError
from multiarm.notation import count_of
from multiarm.scene.code import located
from multiarm.scene.faults import Faults, fault_at, invalid, listed, unknown
from multiarm.scene.fingers import FingersSpec, urdf_text
from multiarm.scene.joint_values import (
    SOLVE,
    JointValues,
    KnownArm,
    Posture,
    joint_value_faults,
    joint_vector,
)
from multiarm.scene.meshes import resolve_mesh
from multiarm.scene.mjcf import read_mjcf
from multiarm.scene.robots import (
    arm_ends,
    find_robot,
    resolve_package_dirs,
    usual_tips,
)
from multiarm.scene.spec import FilePath, Spec
from multiarm.scene.urdf import (
    CHAIN_JOINTS,
    MOST_JOINTS,
    JointOutline,
    RobotOutline,
    outline_of_text,
    read_urdf,
)
from multiarm.scene.values import BaseTurn, Color, Number, Pose, angle_fault


class _FromUrdf(Spec):
    """A model by name (``robot``) or by file (``urdf``)."""

    robot: str | None = None
    """The name of a known model; or"""
    urdf: FilePath | None = None
    """a URDF file, instead of a name."""
    package_dirs: tuple[FilePath, ...] = ()
    """Where ``package://`` addresses are looked for first."""

    @model_validator(mode="after")
    def _exactly_one_source(self) -> Self:
        sources = self._sources()
        written = [name for name in sources if getattr(self, name) is not None]
        if len(written) != 1:
            wanted = " or ".join(f"'{name}' ({what})" for name, what in sources.items())
            got = "neither" if not written else "both" if len(written) == 2 else "all"
            raise invalid(f"needs either {wanted}, got {got}")
        return self

    def _sources(self) -> dict[str, str]:
        """The keys, of which exactly one gives the model, with their values."""
        return {"robot": "a name", "urdf": "a file"}

    def usual_tips(self, outline: RobotOutline) -> tuple[str, ...]:
        """The links usually taken as tips of the model with this outline."""
        return usual_tips(outline, self.robot)

    @property
    def file(self) -> Path | None:
        """The file, where one is given instead of a name."""
        return self.urdf

    @property
    def shown_by(self) -> str:
        """The command that shows all links and joints of the model."""
        return f"multiarm robots {self.robot or self.file}"


class ToolSpec(_FromUrdf):
    """A tool, from another URDF or made of fingers, fixed to a link of the robot."""

    mount: str
    """The link of the robot that carries the tool."""
    at: Pose = Pose()
    """The tool's root link in the frame of that link."""
    fingers: FingersSpec | None = None
    """Instead of a model: a hand of rigid fingers, whose frame ``corner`` is the tip."""

    def _sources(self) -> dict[str, str]:
        return {**super()._sources(), "fingers": "fingertips"}

    def usual_tips(self, outline: RobotOutline) -> tuple[str, ...]:
        """Of a hand its corner, else as of other models."""
        return super().usual_tips(outline) if self.fingers is None else ("corner",)


class BaseSpec(Pose):
    """Where an arm stands: as written, or found by the program."""

    rpy: BaseTurn = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw [rad], as of any pose; up to three turns, as where arms stand in a ring."""
    solve: tuple[Literal["x", "y", "z", "roll", "pitch", "yaw"], ...] = ()
    """What the program finds, of x, y, z, roll, pitch, yaw: the place from which the arm holds its
    joint's place on the object ('at') best. The rest is as written."""

    @model_validator(mode="after")
    def _can_be_found(self) -> Self:
        if len(set(self.solve)) < len(self.solve):
            raise invalid(f"'solve' names a component twice: {listed(self.solve)}")
        if self.quaternion_xyzw is not None and {"roll", "pitch", "yaw"}.intersection(self.solve):
            raise invalid("turns that are found need 'rpy' for the others, not 'quaternion_xyzw'")
        return self


def _as_base(value: Any) -> Any:
    plain = isinstance(value, Pose) and not isinstance(value, BaseSpec)
    return value.model_dump() if plain else value


class ArmSpec(_FromUrdf):
    """One arm: a serial chain of 1 to 16 joints from its base to its tip."""

    mjcf: FilePath | None = None
    """A MuJoCo file, instead of a name."""
    base: SerializeAsAny[Annotated[BaseSpec, BeforeValidator(_as_base)]] = BaseSpec()
    """The root link in the world. {solve: [x, y, yaw]}: the place is found, for the arm's joint on
    the object, and so is the posture."""
    tip: str | None = None
    """The link whose frame is joined to the object: of the tool if there is one. Absent: the usual
    tip of robot or tool, see 'multiarm robots'."""
    tool: ToolSpec | None = None
    """A tool on the robot."""
    posture: Posture | None = None
    """Positions [rad] or [m] at the start, one number per movable joint from base to tip. Joints
    that are not named are at 0, or at the limit nearest to 0. 'solve': found for the place of the
    arm's joint on the object (its 'at'); so too where there is no posture and the tip would be far
    from that place."""
    velocity: JointValues | None = None
    """Velocities [rad/s] or [m/s] at the start, 0 where not named."""
    lock: dict[str, Number] = Field(default_factory=dict)
    """Joints that are held fixed at a position [rad] or [m]."""
    color: Color | None = None
    """Red, green, blue, opacity from 0 to 1."""

    def _sources(self) -> dict[str, str]:
        return {**super()._sources(), "mjcf": "a MuJoCo file"}

    @property
    def file(self) -> Path | None:
        """The file, where one is given instead of a name."""
        return self.mjcf or self.urdf

    @property
    def open_base(self) -> tuple[str, ...]:
        """Components of the base that are found, in the order that is written."""
        return self.base.solve if isinstance(self.base, BaseSpec) else ()  # or a copy's Pose


@dataclass(frozen=True)
class ResolvedArm:
    """Files, chain and start of one arm.

    Attributes
    ----------
    urdf : Path
        The robot's file: a URDF, or with ``mjcf`` a MuJoCo file.
    package_dirs : tuple of Path
        Where ``package://`` addresses of the robot are looked for, in order.
    tool_urdf : Path, str or None
        The tool's file, or the text of its URDF where the scene describes it.
    tool_package_dirs : tuple of Path
        The same for the tool.
    tip : str
        The link that is joined to the object.
    joints : tuple of JointOutline, length n
        The movable joints from base to tip.
    posture, velocity : ndarray, shape (n,)
        Start [rad] or [m], [rad/s] or [m/s].
    locked : dict of str to float
        Joints held fixed, of the robot and of the tool, with their positions.
    """

    urdf: Path
    package_dirs: tuple[Path, ...]
    tool_urdf: Path | str | None
    tool_package_dirs: tuple[Path, ...]
    tip: str
    joints: tuple[JointOutline, ...]
    posture: np.ndarray
    velocity: np.ndarray
    locked: dict[str, float]
    mjcf: bool = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints from base to tip."""
        return tuple(joint.name for joint in self.joints)


@dataclass
class Examination(KnownArm):
    """The facts of one arm.

    Attributes
    ----------
    arm : ResolvedArm or None
        None where there are faults.
    urdf : Path or None
        The robot's file.
    robot_joints : set of str
        All joints of the robot; its tool's are not among them.
    way : tuple of str
        Movable joints of the robot on the way to the tip, locked ones too.
    resting : dict of str to float
        Joints that are not on the way and that 'lock' does not name, with their positions.
    faults : list of (place within the arm, text)
    warnings : list of str
    """

    arm: ResolvedArm | None = None
    urdf: Path | None = None
    robot_joints: set[str] = field(default_factory=set)
    way: tuple[str, ...] = ()
    resting: dict[str, float] = field(default_factory=dict)
    faults: Faults = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add_fault(self, *where: str | int, text: str) -> None:
        """Note a fault."""
        self.faults.append((where, text))


def resolve_arm(spec: ArmSpec, folder: Path | str | None = None) -> ResolvedArm:
    """Files, chain and start of an arm; raises a SceneError that names every fault.

    Relative paths start at ``folder``, the current one by default.
    """
    examination = examine_arm(located(spec, Path(folder or ".").resolve()))
    if examination.faults or examination.arm is None:
        raise SceneError([fault_at(where, text, "arm") for where, text in examination.faults])
    return examination.arm


def examine_arm(spec: ArmSpec) -> Examination:
    """Look at an arm whose paths are absolute, and note all faults and warnings."""
    examination = Examination(shown_by=spec.shown_by if spec.tool is None else None)
    robot = _outline(spec, examination, ())
    tool = _outline(spec.tool, examination, ("tool",)) if spec.tool is not None else None
    tip = _usual_tip(spec, robot, tool, examination) if spec.tip is None else spec.tip
    chain = _chain(spec, tip, robot, tool, examination)
    if robot is None or (spec.tool is not None and tool is None):
        return examination
    joints = {joint.name: joint for outline in (robot, tool) if outline for joint in outline.joints}
    for name in spec.lock:
        if name not in joints or not joints[name].movable:
            movable = [joint.name for joint in joints.values() if joint.movable]
            examination.add_fault("lock", name, text=unknown("joint", name, movable))
    if tip is None or chain is None:
        return examination
    examination.urdf = robot.path
    examination.robot_joints = of_robot = {joint.name for joint in robot.joints}
    examination.way = tuple(j.name for j in chain if j.movable and j.name in of_robot)
    free = _free_joints(spec, tip, chain, examination)
    examination.joints = free
    names = {joint.name for joint in free}
    examination.links, examination.moving = robot.links, robot.carried_by(names)
    if tool is not None and spec.tool is not None:
        examination.links += tool.links
        moved = spec.tool.mount in examination.moving
        examination.moving += tool.links if moved else tool.carried_by(names)
    locked = _locked(spec, joints, free, examination)
    if spec.open_base and spec.posture not in (None, SOLVE):
        text = "a base that is found has its posture with it; write 'posture: solve', or none"
        examination.add_fault("base", "solve", text=text)
    posture, velocity = _start(spec, free, examination)
    package_dirs = _package_dirs(spec, robot, examination)
    tool_package_dirs = () if tool is None else _package_dirs(spec.tool, tool, examination)
    if not examination.faults:
        examination.arm = ResolvedArm(
            urdf=robot.path,
            package_dirs=package_dirs,
            tool_urdf=None if tool is None else tool.text or tool.path,
            tool_package_dirs=tool_package_dirs,
            tip=tip,
            joints=free,
            posture=posture,
            velocity=velocity,
            locked=locked,
            mjcf=spec.mjcf is not None,
        )
    return examination


def _outline(
    spec: ArmSpec | ToolSpec, examination: Examination, where: tuple[str, ...]
) -> RobotOutline | None:
    key = "robot" if spec.file is None else "urdf"
    try:
        if isinstance(spec, ToolSpec) and spec.fingers is not None:
            return outline_of_text(urdf_text(spec.fingers), "hand.urdf")
        if isinstance(spec, ArmSpec) and spec.mjcf is not None:
            key = "mjcf"
            return read_mjcf(spec.mjcf)
        path = find_robot(spec.robot).urdf if spec.robot is not None else spec.file
        assert path is not None, "a model has a name or a file"
        return read_urdf(path)
    except (SceneError, ModelError) as error:
        examination.add_fault(*where, key, text=str(error))
        return None


def _usual_tip(
    spec: ArmSpec, robot: RobotOutline | None, tool: RobotOutline | None, examination: Examination
) -> str | None:
    """The tip of an arm that names none; a fault where nothing tells which it is."""
    model, outline = (spec, robot) if spec.tool is None else (spec.tool, tool)
    if outline is None:
        return None
    usual = model.usual_tips(outline)
    if len(usual) == 1:
        return usual[0]
    links = listed(usual or arm_ends(outline))
    examination.add_fault(
        "tip",
        text=f"is missing (the link whose frame is joined to the object); of "
        f"{model.robot or outline.path.name} it may be {links}; '{model.shown_by}' shows all links",
    )
    return None


def _chain(
    spec: ArmSpec,
    tip: str | None,
    robot: RobotOutline | None,
    tool: RobotOutline | None,
    examination: Examination,
) -> list[JointOutline] | None:
    """All joints from the robot's root to the tip, None where the chain is not known."""
    if spec.tool is None:
        return _part(spec, robot, tip, examination, "tip")
    below = _part(spec, robot, spec.tool.mount, examination, "tool", "mount")
    above = _part(spec.tool, tool, tip, examination, "tip")
    if robot is None or tool is None:
        return None
    for noun, ours, theirs in (
        ("joint", [j.name for j in robot.joints], [j.name for j in tool.joints]),
        ("link", robot.links, tool.links),
    ):
        both = [name for name in theirs if name in ours]
        if both:
            text = f"tool and robot both have a {noun} named {listed(both)}; rename it in one URDF"
            examination.add_fault("tool", text=text)
    return None if below is None or above is None else below + above


def _part(
    model: ArmSpec | ToolSpec,
    outline: RobotOutline | None,
    link: str | None,
    examination: Examination,
    *where: str,
) -> list[JointOutline] | None:
    if outline is None or link is None:
        return None
    try:
        return list(outline.chain(link))
    except ModelError as error:
        shown = "" if outline.text else f"; '{model.shown_by}' shows them all"
        examination.add_fault(*where, text=f"{error}{shown}")
        return None


def _free_joints(
    spec: ArmSpec, tip: str, chain: list[JointOutline], examination: Examination
) -> tuple[JointOutline, ...]:
    free = tuple(joint for joint in chain if joint.movable and joint.name not in spec.lock)
    for joint in free:
        if joint.kind not in CHAIN_JOINTS:
            examination.add_fault(
                text=f"joint {joint.name!r} on the way to {tip!r} is {joint.kind}; arms move "
                f"by {listed(CHAIN_JOINTS)} joints (or lock it: lock: {{{joint.name}: 0.0}})"
            )
        if joint.mimic is not None:
            examination.add_fault(
                text=f"joint {joint.name!r} on the way to {tip!r} copies joint "
                f"{joint.mimic.joint!r}; coupled joints are not supported, lock it or choose "
                "another tip"
            )
    if not free:
        examination.add_fault("tip", text=f"no movable joint lies between the base and {tip!r}")
    if len(free) > MOST_JOINTS:
        examination.add_fault(
            "tip",
            text=f"{len(free)} movable joints lie between the base and {tip!r}, at most "
            f"{MOST_JOINTS} are possible; lock some",
        )
    return free


def _locked(
    spec: ArmSpec,
    joints: dict[str, JointOutline],
    free: tuple[JointOutline, ...],
    examination: Examination,
) -> dict[str, float]:
    """Position of every movable joint that is no coordinate of the arm."""
    for name, position in spec.lock.items():
        if name in joints:
            _check_angle(joints[name], position, ("lock", name), examination)
    names = {joint.name for joint in free}
    fixed = [joint for joint in joints.values() if joint.movable and joint.name not in names]
    locked = {joint.name: joint.neutral for joint in fixed} | {
        name: value for name, value in spec.lock.items() if name in joints
    }
    for joint in fixed:
        chain = [joint]  # each mimics the next
        while (mimic := chain[-1].mimic) and chain[-1].name not in spec.lock:
            if mimic.joint not in locked or joints[mimic.joint] in chain:
                break
            chain.append(joints[mimic.joint])
        for leader, follower in pairwise(reversed(chain)):
            assert follower.mimic is not None
            position = follower.mimic.multiplier * locked[leader.name] + follower.mimic.offset
            locked[follower.name] = position
        if chain[-1].name not in spec.lock:
            examination.resting[joint.name] = locked[joint.name]
    return locked


def _start(
    spec: ArmSpec, free: tuple[JointOutline, ...], examination: Examination
) -> tuple[np.ndarray, np.ndarray]:
    names = [joint.name for joint in free]
    neutral = np.array([joint.neutral for joint in free])
    vectors = []
    for key, default in (("posture", neutral), ("velocity", np.zeros(len(free)))):
        values = getattr(spec, key)
        if values == SOLVE:
            values = None
        faults = joint_value_faults(values, names)
        for where, text in faults:
            examination.add_fault(key, *where, text=text)
        vectors.append(default if faults else joint_vector(values, names, default))
    for k, (joint, position) in enumerate(zip(free, vectors[0], strict=True)):
        where = "posture", joint.name if isinstance(spec.posture, dict) else k
        outside = not joint.lower <= position <= joint.upper
        if _check_angle(joint, position, where, examination) and outside:
            examination.warnings.append(
                f"posture of {joint.name!r} is {position:g}, outside its limits "
                f"{joint.lower:g} to {joint.upper:g}"
            )
    return vectors[0], vectors[1]


def _check_angle(
    joint: JointOutline, position: float, where: tuple[str | int, ...], examination: Examination
) -> bool:
    """Whether a position is no angle beyond a turn; where limits allow turns, that is a warning."""
    text = angle_fault(position) if joint.kind in ("revolute", "continuous") else ""
    if text and joint.lower <= position <= joint.upper:
        examination.warnings.append(
            f"{where[0]} of {joint.name!r} is {position:g} rad, more than a turn; positions are in "
            "radians"
        )
    elif text:
        examination.add_fault(*where, text=text)
    return not text


def _package_dirs(
    spec: ArmSpec | ToolSpec | None, outline: RobotOutline, examination: Examination
) -> tuple[Path, ...]:
    """Where the meshes of a model are looked for; a warning if some are not there."""
    if spec is None or outline.text is not None:
        return ()
    folders = resolve_package_dirs(outline.path, spec.package_dirs)
    missing = [m for m in outline.meshes if resolve_mesh(m, outline.path, folders) is None]
    if missing:
        examination.warnings.append(
            f"missing of {outline.path.name}: {len(missing)} of "
            f"{count_of(len(outline.meshes), 'mesh', 'meshes')} (first: {missing[0]}); the motion "
            "is not affected, the replay shows stand-ins; 'package_dirs' says where to look"
        )
    return folders
