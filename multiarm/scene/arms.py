"""An arm as a user writes it, and the chain of joints that moves it.

The chain runs from the robot's root through the mount and the tool's root to the tip. Its movable
joints, without the locked ones, carry the arm's coordinates: ONE number each. Joints off the chain
(fingers, say) are held fixed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, SerializeAsAny, model_validator
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene.code import located
from multiarm.scene.faults import fault_at, invalid, listed, unknown
from multiarm.scene.fingers import FingersSpec, urdf_text
from multiarm.scene.joint_values import SOLVE, Posture
from multiarm.scene.model_files import ModelSource, RobotModel
from multiarm.scene.resolution import (
    Examination,
    ResolvedRobot,
    check_kind,
    check_passive,
    locked_positions,
    mesh_folders,
    outline_of,
    start_of,
    way_to,
)
from multiarm.scene.robots import arm_ends
from multiarm.scene.urdf import MOST_JOINTS, JointOutline, RobotOutline, outline_of_text
from multiarm.scene.values import BaseTurn, Pose


class ToolSpec(ModelSource):
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

    def read(self) -> RobotOutline:
        """The outline of the model, or of the hand; raises as any model's."""
        if self.fingers is not None:
            return outline_of_text(urdf_text(self.fingers), "hand.urdf")
        return super().read()


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


class ArmSpec(RobotModel):
    """One arm: a serial chain of 1 to 16 joints from its base to its tip."""

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

    @property
    def open_base(self) -> tuple[str, ...]:
        """Components of the base that are found, in the order that is written."""
        return self.base.solve if isinstance(self.base, BaseSpec) else ()  # or a copy's Pose


def resolve_arm(spec: ArmSpec, folder: Path | str | None = None) -> ResolvedRobot:
    """Files, chain and start of an arm; raises a SceneError that names every fault.

    Relative paths start at ``folder``, the current one by default.
    """
    examination = examine_arm(located(spec, Path(folder or ".").resolve()))
    if examination.faults or examination.resolved is None:
        raise SceneError([fault_at(where, text, "arm") for where, text in examination.faults])
    return examination.resolved


def examine_arm(spec: ArmSpec) -> Examination:
    """Look at an arm whose paths are absolute, and note all faults and warnings."""
    examination = Examination(shown_by=spec.shown_by if spec.tool is None else None)
    robot = outline_of(spec, examination)
    tool = outline_of(spec.tool, examination, "tool") if spec.tool is not None else None
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
    check_passive(spec.passive, free, examination)
    locked = locked_positions(spec.lock, joints, free, examination)
    if spec.open_base and spec.posture not in (None, SOLVE):
        text = "a base that is found has its posture with it; write 'posture: solve', or none"
        examination.add_fault("base", "solve", text=text)
    posture, velocity = start_of(spec, free, examination)
    package_dirs = mesh_folders(spec, robot, examination)
    tool_package_dirs = () if tool is None else mesh_folders(spec.tool, tool, examination)
    if not examination.faults:
        examination.resolved = ResolvedRobot(
            urdf=robot.path,
            package_dirs=package_dirs,
            tool_urdf=None if tool is None else tool.text or tool.path,
            tool_package_dirs=tool_package_dirs,
            tips={"": tip},
            joints=free,
            posture=posture,
            velocity=velocity,
            locked=locked,
            mjcf=spec.mjcf is not None,
            passive=spec.passive,
        )
    return examination


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
        return way_to(spec, robot, tip, examination, "tip")
    below = way_to(spec, robot, spec.tool.mount, examination, "tool", "mount")
    above = way_to(spec.tool, tool, tip, examination, "tip")
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


def _free_joints(
    spec: ArmSpec, tip: str, chain: list[JointOutline], examination: Examination
) -> tuple[JointOutline, ...]:
    free = tuple(joint for joint in chain if joint.movable and joint.name not in spec.lock)
    for joint in free:
        check_kind(joint, tip, examination)
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
