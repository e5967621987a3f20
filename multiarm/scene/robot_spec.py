"""A robot as a user writes it: a tree of links on a base, with several tips, and what moves it.

The base is fixed, floats freely, or moves in the frame in which it is written: by slides along x,
y and z, then by a turn about z, real joints ``base_x``, ``base_y``, ``base_z``, ``base_yaw`` before
the root link.  On wheels it has the joints along x, along y and about z, and does not slip
sideways.
Further joints move if they lie on the way from the root to a tip, or to a link that a joint of the
scene names; the others are held fixed.  A joint on the way that copies another moves by a number of
its own, and is coupled to its leader.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene.code import located
from multiarm.scene.faults import fault_at, invalid, listed, shown, unknown
from multiarm.scene.joint_values import SOLVE, Posture
from multiarm.scene.model_files import RobotModel
from multiarm.scene.object import Inertia
from multiarm.scene.resolution import (
    Examination,
    ResolvedRobot,
    check_kind,
    check_passive,
    couplings_of,
    locked_positions,
    mesh_folders,
    outline_of,
    start_of,
    way_to,
)
from multiarm.scene.spec import Spec
from multiarm.scene.urdf import JointOutline, Mimic, RobotOutline
from multiarm.scene.values import (
    BaseTurn,
    Number,
    Pose,
    Positive,
    Range,
    TipName,
    Vec6,
    roll_pitch_yaw,
)

Direction = Literal["x", "y", "z", "yaw"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}  # of the others: z
BASE_JOINTS = tuple(f"base_{direction}" for direction in DIRECTIONS)
"""Names of the joints that may move a base."""
FREE: Literal["free"] = "free"
"""How a base moves that floats."""
DIFFERENTIAL: Literal["differential"] = "differential"
"""How a base on wheels moves, forward and about z; :data:`ON_WHEELS` are its joints."""
ON_WHEELS: tuple[Direction, ...] = ("x", "y", "yaw")


def _moves(value: Any) -> Any:
    if value in (DIFFERENTIAL, FREE):
        return value
    if not isinstance(value, list | tuple):
        raise invalid(
            f"must be {DIFFERENTIAL!r}, {FREE!r} or a list of some of {', '.join(DIRECTIONS)}, "
            f"got {shown(value)}"
        )
    for direction in value:
        if direction not in DIRECTIONS:
            raise invalid(unknown("direction", direction, DIRECTIONS))
    return value


FLOATING_BASE = "the floating base"
"""In place of a joint, what carries the links next to the root of a robot that floats."""


def in_order(directions: Iterable[str]) -> list[str]:
    """Directions in the order of the joints of a base."""
    return [name for name in DIRECTIONS if name in directions]


class RobotBaseSpec(Pose):
    """Where a robot stands, and how its base moves from there."""

    rpy: BaseTurn = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw [rad], as of any pose; up to three turns."""
    moves: Annotated[
        tuple[Direction, ...] | Literal["differential", "free"], BeforeValidator(_moves)
    ] = ()
    """The directions in which the base moves, some of x, y, z, yaw in this order: along, and in the
    end about, the axes of the pose that is written. They are joints 'base_x', 'base_y', 'base_z',
    'base_yaw'. 'differential': it moves as by [x, y, yaw], on wheels below its origin that do not
    slip sideways, so that it drives along its own x axis and turns. 'free': it floats, from the
    pose that is written. Absent: it is fixed."""
    solve: tuple[Direction, ...] = ()
    """Of a base that is fixed or floats: the directions, of x, y, z, yaw, along and about the axes
    of the pose that is written, in which the program finds where it stands, together with the
    posture. A base that moves in directions starts where 'posture: solve' finds it."""
    limits: dict[Direction, Range] = Field(default_factory=dict)
    """Ends of the range [m] or [rad], a table by direction; others have none."""
    effort: dict[Direction, Positive] = Field(default_factory=dict)
    """Largest force [N] or torque [N m] of the drives, a table by direction; others have none."""
    twist: Vec6 | None = None
    """Of a 'free' base at the start: velocity of its origin [m/s], then angular velocity [rad/s],
    in world axes. Absent: it rests."""
    mass: Positive | None = None
    """Added to the root link, at the origin of the base [kg]."""
    inertia: Inertia | None = None
    """Added to the root link, about the origin of the base and in its axes [kg m^2]: principal
    moments, six entries or the matrix."""

    @model_validator(mode="after")
    def _fits_what_moves(self) -> Self:
        if self.solve and self.directions:
            raise invalid(
                "'solve' is of a base that is fixed or floats; one that moves has its place in its "
                "joints, which 'posture: solve' finds: remove 'solve'"
            )
        if len(set(self.solve)) < len(self.solve):
            raise invalid(f"'solve' names a direction twice: {listed(self.solve)}")
        if self.floats:
            if self.limits or self.effort:
                raise invalid(
                    "'limits' and 'effort' are of the joints of a base that moves in directions; a "
                    "'free' base has none, remove them"
                )
            return self
        if self.twist is not None:
            raise invalid(
                "'twist' is of a base that floats; write moves: free, or remove it: velocities of "
                "other bases are those of their joints, in 'velocity'"
            )
        moves = self.directions
        if list(moves) != in_order(moves):
            twice = len(set(moves)) < len(moves)
            why = (
                "each direction is named once"
                if twice
                else "the joints of a base are in the order x, y, z, yaw: it slides, then turns"
            )
            raise invalid(
                f"'moves': {why}; write [{', '.join(in_order(moves))}], got {shown(moves)}"
            )
        for key in ("limits", "effort"):
            idle = [name for name in getattr(self, key) if name not in moves]
            if idle:
                there = f"'moves' are {listed(moves)}" if moves else "add 'moves', or remove them"
                raise invalid(
                    f"{key!r} names {listed(idle)}, where the base does not move; {there}"
                )
        if not moves and (self.mass is not None or self.inertia is not None):
            raise invalid(
                "'mass' and 'inertia' count only where the base moves; add 'moves', such as "
                "moves: [x, y, yaw], or remove them"
            )
        return self

    def displaced(self, displacement: Mapping[str, float]) -> Self:
        """The same base, found at displacements [m, rad] in the directions of ``solve``."""
        moved = Pose(
            xyz=[displacement.get(direction, 0.0) for direction in "xyz"],
            rpy=[0.0, 0.0, displacement.get("yaw", 0.0)],
        )
        pose = self.matrix() @ moved.matrix()
        place = {"xyz": tuple(pose[:3, 3].tolist()), "rpy": roll_pitch_yaw(pose[:3, :3])}
        return self.model_copy(update={**place, "quaternion_xyzw": None, "solve": ()})

    @property
    def floats(self) -> bool:
        """Whether it moves freely."""
        return self.moves == FREE

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Those of its joints; none of a base that floats."""
        if self.moves == FREE:
            return ()
        return ON_WHEELS if self.moves == DIFFERENTIAL else self.moves

    def joints(self, root: str) -> tuple[JointOutline, ...]:
        """The joints that move the root link; none of a base that floats."""
        return tuple(self._joint(direction, root) for direction in self.directions)

    def _joint(self, direction: Direction, root: str) -> JointOutline:
        limits = self.limits.get(direction)
        turning = "continuous" if limits is None else "revolute"
        lower, upper = limits or (-math.inf, math.inf)
        return JointOutline(
            name=BASE_JOINTS[DIRECTIONS.index(direction)],
            kind=turning if direction == "yaw" else "prismatic",
            parent="",
            child=root,
            axis=_AXES.get(direction, (0.0, 0.0, 1.0)),
            lower=lower,
            upper=upper,
            velocity_limit=math.inf,
            effort_limit=self.effort.get(direction, math.inf),
        )


class MimicSpec(Spec):
    """A joint that copies another: position = multiplier * (position of the leader) + offset."""

    of: str
    """The joint that it copies, its leader."""
    multiplier: Number = 1.0
    """Its positions for one unit of the leader's."""
    offset: Number = 0.0
    """Its position [rad] or [m] where the leader's is 0."""


class RobotSpec(RobotModel):
    """A robot: a tree of links, with tips that joints of the scene connect."""

    base: RobotBaseSpec = RobotBaseSpec()
    """The root link in the world, and the directions in which it moves."""
    tips: dict[TipName, str] = Field(default_factory=dict)
    """A table 'name: link'. Joints of the scene name them as 'robot/name'. What lies on the way to
    a tip, or to a link that a joint of the scene names, moves. Where there is neither, every joint
    moves."""
    posture: Posture | None = None
    """Positions [rad] or [m] at the start, one number per moving joint: those of the base, then the
    tree's, depth first and by their names below a link. Joints that are not named are at 0, or at
    the limit nearest to 0; those that copy others follow. 'solve': found for the places of the
    tips' joints."""
    mimic: dict[str, MimicSpec] = Field(default_factory=dict)
    """Joints that copy others, with those of the file or in place of them: a table 'joint: {of:
    leader}'."""

    @property
    def open_base(self) -> tuple[Direction, ...]:
        """Directions in which the base is found."""
        return self.base.solve


def resolve_robot(
    spec: RobotSpec, links: Iterable[str] = (), folder: Path | str | None = None
) -> ResolvedRobot:
    """Files, moving joints and start of a robot.

    Parameters
    ----------
    spec : RobotSpec
    links : iterable of str
        Links that joints of the scene name besides the tips.
    folder : path, optional
        Where relative paths start; the current one by default.

    Raises
    ------
    SceneError
        Naming every fault.
    """
    examination = examine_robot(located(spec, Path(folder or ".").resolve()), links)
    if examination.faults or examination.resolved is None:
        raise SceneError([fault_at(where, text, "robot") for where, text in examination.faults])
    return examination.resolved


def examine_robot(spec: RobotSpec, links: Iterable[str] = ()) -> Examination:
    """Look at a robot whose paths are absolute, and note all faults and warnings.

    ``links`` are those that joints of the scene name besides the tips; what is no link is left out.
    """
    examination = Examination(shown_by=spec.shown_by, tips=dict(spec.tips))
    outline = outline_of(spec, examination)
    if outline is None:
        return examination
    ends = {**spec.tips, **{link: link for link in links if link in outline.links}}
    ends = ends or {link: link for link in _last_links(spec, outline)}
    joints = _with_couplings(spec, outline, examination)
    on_way = _joints_on_the_way(spec, outline, ends, examination)
    if on_way is None:
        return examination
    examination.urdf, examination.links = outline.path, outline.links
    examination.robot_joints = {joint.name for joint in outline.joints}
    examination.way = tuple(joint.name for joint in on_way)
    free = [joints[joint.name] for joint in on_way if joint.name not in spec.lock]
    free = _moving(spec, free, joints, examination)
    base = spec.base.joints(outline.root)
    moving = (*base, *free)
    examination.joints = moving
    foot = base[-1].name if base else FLOATING_BASE if spec.base.floats else ""
    examination.carriers = _carriers(outline, foot, {joint.name for joint in free})
    examination.moving = tuple(examination.carriers)
    _check_that_it_moves(spec, outline, examination)
    check_passive(spec.passive, moving, examination)
    locked = locked_positions(spec.lock, joints, free, examination)
    _warn_of_held_followers(spec, on_way, joints, locked, examination)
    names = {joint.name for joint in moving}
    for end, link in ends.items():
        way = outline.movable(link)
        examination.ways[end] = tuple(joint.name for joint in way if joint.name in names)
    if spec.base.solve and spec.posture not in (None, SOLVE):
        text = "a base that is found has its posture with it; write 'posture: solve', or none"
        examination.add_fault("base", "solve", text=text)
    posture, velocity = start_of(spec, moving, examination)
    _warn_of_a_base_that_starts_elsewhere(spec, base, examination)
    package_dirs = mesh_folders(spec, outline, examination)
    if not examination.faults:
        examination.resolved = ResolvedRobot(
            urdf=outline.path,
            package_dirs=package_dirs,
            tool_urdf=None,
            tool_package_dirs=(),
            tips=ends,
            joints=moving,
            posture=posture,
            velocity=velocity,
            locked=locked,
            mjcf=spec.mjcf is not None,
            base_joints=base,
            base_floats=spec.base.floats,
            base_mass=spec.base.mass or 0.0,
            base_inertia=np.array(spec.base.inertia or np.zeros((3, 3))),
            mimic=couplings_of(moving),
            on_wheels=spec.base.moves == DIFFERENTIAL,
            passive=spec.passive,
        )
    return examination


def _with_couplings(
    spec: RobotSpec, outline: RobotOutline, examination: Examination
) -> dict[str, JointOutline]:
    """All joints of the file by name, in the order of the model, with the scene's couplings."""
    joints = {joint.name: joint for joint in outline.in_model_order()}
    movable = [name for name, joint in joints.items() if joint.movable]
    for name in spec.lock:
        if name in BASE_JOINTS and name not in movable:
            examination.add_fault("lock", name, text=_base_fault(spec, name))
        elif name not in movable:
            examination.add_fault("lock", name, text=unknown("joint", name, movable))
    for joint in spec.base.joints(outline.root):
        if joint.name in joints:
            text = f"the robot has a joint {joint.name!r} of its own; rename it in its file"
            examination.add_fault("base", "moves", text=text)
    for name, coupling in spec.mimic.items():
        of_base = [joint for joint in (name, coupling.of) if joint in BASE_JOINTS]
        if of_base and of_base[0] not in movable:
            text = f"{of_base[0]!r} moves the base; joints of the base neither copy others nor are "
            text += "copied, couple joints of the robot's file"
            examination.add_fault("mimic", name, text=text)
        elif name not in movable:
            examination.add_fault("mimic", name, text=unknown("joint", name, movable))
        elif coupling.of not in movable:
            text = unknown("joint", coupling.of, movable)
            examination.add_fault("mimic", name, "of", text=text)
        elif name in spec.lock:
            text = f"'lock' holds {name!r}, which copies {coupling.of!r} here; keep one of them"
            examination.add_fault("mimic", name, text=text)
        else:
            mimic = Mimic(coupling.of, coupling.multiplier, coupling.offset)
            joints[name] = replace(joints[name], mimic=mimic)
    return joints


def _base_fault(spec: RobotSpec, name: str) -> str:
    """Why 'lock' cannot name a joint of the base, and what holds the base instead."""
    direction = name.removeprefix("base_")
    remaining = [other for other in spec.base.directions if other != direction]
    if spec.base.moves == DIFFERENTIAL:
        remedy = "a base on wheels needs all of its joints"
    elif direction in spec.base.directions:
        remedy = f"to hold it, write moves: [{', '.join(remaining)}]"
    else:
        remedy = "this base has no such joint"
    return f"{name!r} is a joint of the base, and 'lock' holds those of the robot's file; {remedy}"


def _check_that_it_moves(spec: RobotSpec, outline: RobotOutline, examination: Examination) -> None:
    """Note tips that rest, or that the whole robot does."""
    for name, link in spec.tips.items():
        if link in outline.links and link not in examination.carriers:
            examination.add_fault("tips", name, text=f"no joint that moves carries link {link!r}")
    if not (examination.carriers or spec.tips):
        held = "'lock' holds all of its joints" if spec.lock else "its file has no joint that moves"
        text = f"nothing of it moves: {held}; let one of them move, or the base, with 'moves'"
        examination.add_fault("lock" if spec.lock else "base", text=text)


def _last_links(spec: RobotSpec, outline: RobotOutline) -> tuple[str, ...]:
    """Of each joint that moves and has none after it, the last link; else the root link."""
    last: dict[str, str] = {}
    for link in (*spec.usual_tips(outline), *outline.leaves):
        for joint in outline.movable(link)[-1:]:
            last.setdefault(joint.name, link)
    before = {joint.name for link in last.values() for joint in outline.movable(link)[:-1]}
    ends = tuple(link for joint, link in last.items() if joint not in before)
    return ends or (outline.root,)


def _joints_on_the_way(
    spec: RobotSpec, outline: RobotOutline, ends: Mapping[str, str], examination: Examination
) -> list[JointOutline] | None:
    """Movable joints on the way to a tip, in the order of the model.

    None where one of them names no link.
    """
    on_way: dict[str, str] = {}
    missing = False
    for name, link in ends.items():
        where = ("tips", name) if name in spec.tips else ()
        way = way_to(spec, outline, link, examination, *where)
        missing = missing or way is None
        for joint in way or ():
            on_way.setdefault(joint.name, link)
        if name in spec.tips and name != link and name in outline.links:
            text = (
                f"is the name of another link, so that '{name}' could mean both; choose another "
                "name for the tip"
            )
            examination.add_fault("tips", name, text=text)
    if missing:
        return None  # it is not known which joints move
    joints = [j for j in outline.in_model_order() if j.movable and j.name in on_way]
    for joint in joints:
        if joint.name not in spec.lock:
            check_kind(joint, on_way[joint.name], examination)
    return joints


def _moving(
    spec: RobotSpec,
    free: list[JointOutline],
    joints: Mapping[str, JointOutline],
    examination: Examination,
) -> list[JointOutline]:
    """Those of the free joints that move: not those that copy one which is held."""
    for joint in free:
        if joint.mimic is not None and joint.mimic.joint not in joints:
            examination.add_fault(
                text=f"joint {joint.name!r} copies {joint.mimic.joint!r}, which the robot does not "
                f"have; write a coupling in 'mimic', or lock it: lock: {{{joint.name}: 0.0}}"
            )
    _check_circles(spec, free, examination)
    while True:
        names = {joint.name for joint in free}
        moving = [joint for joint in free if joint.mimic is None or joint.mimic.joint in names]
        if len(moving) == len(free):
            return moving
        free = moving


def _check_circles(spec: RobotSpec, free: list[JointOutline], examination: Examination) -> None:
    """Note joints that copy each other in a circle, once."""
    leaders = {joint.name: joint.mimic.joint for joint in free if joint.mimic is not None}
    for name in leaders:
        circle = [name]
        while (leader := leaders.get(circle[-1])) is not None and leader not in circle:
            circle.append(leader)
        if leader == name == min(circle):
            where = ("mimic", name) if name in spec.mimic else ()
            text = f"joints {listed(circle)} copy each other in a circle; leave one coupling out"
            examination.add_fault(*where, text=text)


def _carriers(outline: RobotOutline, foot: str, moving: set[str]) -> dict[str, str]:
    """The last joint that moves each link, of the links that move; ``foot`` moves the root link."""
    carriers = {outline.root: foot} if foot else {}
    for joint in outline.in_model_order():
        if joint.name in moving:
            carriers[joint.child] = joint.name
        elif joint.parent in carriers:
            carriers[joint.child] = carriers[joint.parent]
    return {link: carriers[link] for link in outline.links if link in carriers}


def _warn_of_a_base_that_starts_elsewhere(
    spec: RobotSpec, base: tuple[JointOutline, ...], examination: Examination
) -> None:
    """Warn of limits without 0, which move a base away from its pose where no posture is given."""
    if not (spec.posture is None or isinstance(spec.posture, dict)):
        return
    for joint in base:
        if joint.neutral and joint.name not in (spec.posture or {}):
            unit = "rad" if joint.kind == "revolute" else "m"
            examination.warnings.append(
                f"the base does not start where its pose is written: the limits of {joint.name!r}, "
                f"{joint.lower:g} to {joint.upper:g} {unit}, are without 0, and it starts at "
                f"{joint.neutral:g} {unit}; move the pose there, or write its position in 'posture'"
            )


def _warn_of_held_followers(
    spec: RobotSpec,
    on_way: list[JointOutline],
    joints: Mapping[str, JointOutline],
    locked: Mapping[str, float],
    examination: Examination,
) -> None:
    """Say which joints on the way are held, and warn of couplings in the scene without effect."""
    ways = {joint.name for joint in on_way}
    for name in sorted(ways & examination.resting.keys()):
        mimic = joints[name].mimic
        assert mimic is not None, "a joint on the way rests only with its leader"
        del examination.resting[name]
        if mimic.joint in locked:
            examination.warnings.append(
                f"joint {name!r} copies {mimic.joint!r} and is held with it, at {locked[name]:g}: "
                f"{mimic.joint!r} is on the way to no tip; add a tip that it carries, or a "
                "coupling in 'mimic'"
            )
    idle = [name for name in spec.mimic if name in joints and name not in ways]
    if idle:
        examination.warnings.append(
            f"'mimic' has no effect on {listed(idle)}, on the way to no tip; add a tip that it "
            "carries"
        )
