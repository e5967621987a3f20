"""Whether the parts of a scene fit together: robots and joints, control, effects, method.

Parts that are not valid by themselves are left out, so that one error has all faults.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from multiarm.errors import USER_FAULTS, Fault, ModelError
from multiarm.scene.arms import ArmSpec, examine_arm
from multiarm.scene.bodies import OBJECT_NAME
from multiarm.scene.code import located, nodes
from multiarm.scene.connections import WrittenJoint, connection_faults, idle_tips, links_of
from multiarm.scene.control import ControlKind, ControlSpec
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.faults import Parts, fault_at, listed, place
from multiarm.scene.joint_values import KnownRobot, KnownRobots
from multiarm.scene.joints import pushing_kinds
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.scene.joints.kind import Joint
from multiarm.scene.object import ObjectSpec
from multiarm.scene.registry import called
from multiarm.scene.resolution import Examination, resting_warning
from multiarm.scene.robot_spec import RobotSpec, examine_robot
from multiarm.scene.run import RunSpec
from multiarm.scene.spec import Spec
from multiarm.scene.timed_joints import idle_joints, touching_faults
from multiarm.scene.trunks import (
    ArmGroup,
    arm_groups,
    group_faults,
    group_warnings,
    one_robot_faults,
)
from multiarm.scene.values import floor_owner


@dataclass(frozen=True)
class ExaminedRobot:
    """An arm or robot as it was examined, with the links that joints name besides its tips."""

    spec: ArmSpec | RobotSpec
    links: tuple[str, ...]
    examination: Examination


Examined = dict[tuple[str, str], ExaminedRobot]
"""By 'arms' or 'robots', and the name."""
Context = dict[str, Any]
"""What validators know: where relative paths start, whether code may be named, user classes."""


@dataclass(frozen=True)
class ValidParts:
    """The parts of a scene that are valid by themselves; None, or missing, where they are not.

    Attributes
    ----------
    arm_names : list of str
        All arms that are written, valid or not.
    arms : dict
        The valid ones.
    robot_names, robots
        The same of robots with several tips.
    object_names : tuple of str or None
        All objects that are written, valid or not.
    objects : dict
        The valid ones, by their places.
    written_objects : tuple of str
        Which of 'object' and 'objects' are written.
    joints : list
        What they connect, as it is written, whatever that is; None where there is no list.
    pushes : bool
        Whether there may be contacts that only push.
    rubs : bool
        Whether a joint, or a contact that is listed, has friction of its own.
    timed : dict
        The valid joints that hold for some of the time, by their numbers.
    """

    arm_names: list[str] | None
    arms: dict[str, ArmSpec]
    robot_names: list[str] | None
    robots: dict[str, RobotSpec]
    object_names: tuple[str, ...] | None
    objects: dict[Parts, ObjectSpec]
    written_objects: tuple[str, ...]
    joints: list[WrittenJoint] | None
    pushes: bool
    rubs: bool
    timed: dict[int, Joint]
    control: ControlKind | None
    effects: EffectsSpec | None
    run: RunSpec | None

    @classmethod
    def of(cls, data: Mapping[str, Any], context: Context) -> ValidParts:
        """Find the valid parts of ``data``, which may hold instances or plain tables."""
        joints = data.get("joints")
        joints = joints if isinstance(joints, (list, tuple)) else None
        arm_names, arms = _named(ArmSpec, data.get("arms", {}), context)
        robot_names, robots = _named(RobotSpec, data.get("robots", {}), context)
        names = object_names(data)
        _, objects = _named(ObjectSpec, data.get("objects"), context)
        places: dict[Parts, Any] = {("objects", name): spec for name, spec in objects.items()}
        places[("object",)] = _valid(ObjectSpec, data.get("object"), context)
        return cls(
            arm_names=arm_names,
            arms=arms,
            robot_names=robot_names,
            robots=robots,
            object_names=names,
            objects={where: spec for where, spec in places.items() if spec is not None},
            written_objects=tuple(
                key for key in ("object", "objects") if data.get(key) is not None
            ),
            joints=None
            if joints is None
            else [WrittenJoint.of(joint, context["objects"]) for joint in joints],
            pushes=not joints or any(_pushes(joint) for joint in joints),
            rubs=any(_rubs(joint) for joint in joints or ()),
            timed={
                number: joint
                for number, joint in enumerate(joints or ())
                if isinstance(joint, Joint) and joint.intervals
            },
            control=_valid(ControlSpec, data.get("control"), context),
            effects=_valid(EffectsSpec, data.get("effects", {}), context),
            run=_valid(RunSpec, data.get("run"), context),
        )


def object_names(data: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Names of the objects that are written; None where they are not known."""
    if data.get("objects") is None:
        return None if data.get("object") is None else (OBJECT_NAME,)
    return tuple(map(str, data["objects"])) if isinstance(data["objects"], Mapping) else None


def _valid(kind: Any, data: Any, context: Context) -> Any:
    if data is None:
        return None
    folder = context["folder"]
    if isinstance(data, Spec):  # an instance was validated when it was made
        return located(data, folder) if kind is ControlSpec or isinstance(data, kind) else None
    try:
        return located(TypeAdapter(kind).validate_python(data, context=context), folder)
    except ValidationError:
        return None


def _named(kind: Any, table: Any, context: Context) -> tuple[list[str] | None, dict[str, Any]]:
    """All names of a table, None where it is none, and its entries that are valid."""
    if not isinstance(table, Mapping):
        return None, {}
    parts = {str(name): _valid(kind, data, context) for name, data in table.items()}
    return list(parts), {name: part for name, part in parts.items() if part is not None}


def _pushes(joint: Any) -> bool:
    """Whether a joint may have contacts that only push; a user's records may raise anything."""
    try:
        return not isinstance(joint, Joint) or joint.pushes
    except USER_FAULTS:
        return True


def _rubs(joint: Any) -> bool:
    """Whether a joint that is valid has friction, as far as the scene says."""
    if isinstance(joint, ContactsJoint) and any(contact.mu for contact in joint.contacts):
        return True
    return isinstance(joint, Joint) and bool(joint.mu)


@dataclass
class Findings:
    """Faults and warnings, complete lines; robots as they were examined; groups of arms."""

    faults: list[Fault] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    examined: Examined = field(default_factory=dict)
    arm_groups: tuple[ArmGroup, ...] = ()

    def add_fault(self, parts: Parts, text: str) -> None:
        """A problem at a place."""
        self.faults.append(fault_at(parts, text))

    def add_warning(self, parts: Parts, text: str) -> None:
        """A warning about a place."""
        self.warnings.append(f"{place(parts)}: {text}")


def check(parts: ValidParts, examined: Examined) -> Findings:
    """All faults and warnings about how the parts fit together.

    Arms that were examined already, and are written as they were, are not examined again.
    """
    findings = Findings()
    _examine(parts, examined, findings)
    _check_objects(parts, findings)
    known = _known_robots(parts, findings)
    if known is not None:
        _check_connections(parts, known, findings)
    _report_robots(parts, findings)
    for where, body in parts.objects.items():
        mesh = body.shape.mesh
        if mesh is not None and not mesh.file.is_file():
            findings.add_warning(
                (*where, "shape", "mesh", "file"),
                f"no file at {mesh.file}; the motion is not affected, the replay shows a stand-in",
            )
    if known is not None:
        _check_times(parts, known, findings)
        _check_control(parts.control, known, findings)
        _check_effects(parts, known, findings)
    return findings


def _examine(parts: ValidParts, examined: Examined, findings: Findings) -> None:
    """Look at arms and robots, where they are not written as they were."""
    specs: dict[tuple[str, str], ArmSpec | RobotSpec] = {
        **{("arms", name): arm for name, arm in parts.arms.items()},
        **{("robots", name): robot for name, robot in parts.robots.items()},
    }
    for key, spec in specs.items():
        links: tuple[str, ...] = ()
        if isinstance(spec, RobotSpec):
            links = tuple(links_of(key[1], parts.joints or (), spec.tips))
        before = examined.get(key)
        if before is not None and (before.spec, before.links) == (spec, links):
            findings.examined[key] = before
            continue
        looked = examine_arm(spec) if isinstance(spec, ArmSpec) else examine_robot(spec, links)
        findings.examined[key] = ExaminedRobot(spec, links, looked)


def _known_robots(parts: ValidParts, findings: Findings) -> KnownRobots | None:
    """All arms and robots that are written; None where their names are not known."""
    if parts.arm_names is None or parts.robot_names is None:
        return None
    known = {name: KnownRobot() for name in parts.arm_names}
    known |= {name: KnownRobot(tips={}) for name in parts.robot_names}
    known |= {name: entry.examination for (_, name), entry in findings.examined.items()}
    names = (joint.connection for joint in parts.joints or ())
    connections = [name for name in names if name is not None]
    return KnownRobots(known, connections, parts.object_names or (OBJECT_NAME,))


def _check_objects(parts: ValidParts, findings: Findings) -> None:
    """One object or several, with names of their own."""
    if not parts.written_objects:
        text = "is missing (the common object: shape, mass, pose); several stand below 'objects'"
        findings.add_fault(("object",), text)
        return
    if len(parts.written_objects) > 1:
        text = "is written beside 'object'; keep one of them: 'object', or all by name here"
        findings.add_fault(("objects",), text)
        return
    if parts.object_names == ():
        text = "is empty; list objects, such as {beam: {shape: {box: [1, 0.1, 0.1]}, mass: 5}}"
        findings.add_fault(("objects",), text)
    nouns = dict.fromkeys(parts.robot_names or (), "a robot")
    nouns |= dict.fromkeys(parts.arm_names or (), "an arm")
    names = parts.object_names or ()
    for name in names if "objects" in parts.written_objects else ():
        if name in nouns:
            text = f"{nouns[name]} is named {name!r} too; give the object another name"
            findings.add_fault(("objects", name), text)


def _check_connections(parts: ValidParts, known: KnownRobots, findings: Findings) -> None:
    if not known and parts.written_objects != ("objects",):
        text = "a scene needs at least one arm, such as {left: {...}}, or a robot, below 'robots'"
        findings.add_fault(("arms",), text)
        return
    if not known and parts.joints == []:
        text = "is empty; a scene without robots needs a joint between objects, or with the world"
        findings.add_fault(("joints",), text)
        return
    for name in parts.robot_names or ():
        if name in (parts.arm_names or ()):
            text = f"an arm is named {name!r} too; give the robot another name"
            findings.add_fault(("robots", name), text)
    for where, text in connection_faults(parts.joints, known, bool(parts.object_names)):
        findings.add_fault(where, text)


def _check_times(parts: ValidParts, known: KnownRobots, findings: Findings) -> None:
    """What joints that hold for some of the time name, and when they do."""
    floor = None if parts.effects is None else parts.effects.floor
    bodies = [name for name in known.objects if floor is not None and floor.is_of(name)]
    floors = [floor_owner(name, known.objects) for name in bodies]
    for where, text in touching_faults(parts.timed, known.connections, floors):
        findings.add_fault(where, text)
    duration = math.inf  # where none is written
    if parts.run is not None and "duration" in parts.run.model_fields_set:
        duration = parts.run.duration
    for where, text in idle_joints(parts.timed, duration):
        findings.add_warning(where, text)


def _report_robots(parts: ValidParts, findings: Findings) -> None:
    """Faults and warnings of each arm, of arms on one trunk, and of each robot."""
    for key, entry in findings.examined.items():
        for where, text in entry.examination.faults:
            findings.add_fault((*key, *where), text)
    looked = {key: entry.examination for key, entry in findings.examined.items()}
    of_arms = {name: looked["arms", name] for name in parts.arms}
    findings.arm_groups = arm_groups(parts.arms, of_arms)
    for group in findings.arm_groups:
        for where, text in group_faults(group, parts.arms, of_arms):
            findings.add_fault(where, text)
        further = {"control": parts.control, "effects": parts.effects}
        for where, text in one_robot_faults(group, parts.arms, further):
            findings.add_fault(where, text)
        for where, text in group_warnings(group, parts.arms, of_arms):
            findings.add_warning(where, text)
    for name in parts.robots:
        examination = looked["robots", name]
        if examination.resting:
            text = resting_warning(examination.resting, "on the way to no tip")
            findings.add_warning(("robots", name), text)
        for text in examination.warnings:
            findings.add_warning(("robots", name), text)
        _warn_of_idle_tips(name, examination, parts, findings)


def _warn_of_idle_tips(name: str, robot: KnownRobot, parts: ValidParts, findings: Findings) -> None:
    """Warn of tips that neither a joint nor control or effects use."""
    joints = parts.joints
    if joints is None or any(joint.bodies is None for joint in joints):
        return
    named: set[str] = set()
    for part in (parts.control, parts.effects):
        for place_in_part, leaf in nodes(part):
            named.update(str(key) for key in place_in_part)
            named.update({leaf} if isinstance(leaf, str) else ())
    for tip, moved in idle_tips(name, robot, joints, named).items():
        text = "no joint of the scene names this tip; join it, or leave it out"
        if moved:
            text += f", which holds {listed(moved)}: they move for it alone"
        findings.add_warning(("robots", name, "tips", tip), text)


def _check_control(control: ControlKind | None, arms: KnownRobots, findings: Findings) -> None:
    if control is None:
        return
    try:
        faults = called(lambda: control.faults(arms), f"control kind {control.kind!r}: faults()")
    except ModelError as error:
        faults = [((), str(error))]
    faults = [*faults, *control.faults_of_object(tuple(arms.objects))]
    for where, text in faults:
        findings.add_fault(("control", *where), text)


def _check_effects(parts: ValidParts, arms: KnownRobots, findings: Findings) -> None:
    effects = parts.effects
    if effects is None:
        return
    for where, text in effects.faults(arms):
        findings.add_fault(("effects", *where), text)
    for where, text in effects.warnings(arms):
        findings.add_warning(("effects", *where), text)
    if parts.run is not None:
        with_events = causes_of_events(effects, parts.rubs)
        integrator, timed = parts.run.integrator, bool(parts.timed)
        message = method_fault(integrator, effects.with_states, with_events, timed)
        if message:
            findings.add_fault(("run", "integrator"), message)
    if parts.pushes:
        return
    for name in effects.of_pushing:
        findings.add_warning(
            ("effects", name),
            "adds nothing, since no joint has contacts that only push; such joints are "
            f"{listed(pushing_kinds())}",
        )


def causes_of_events(effects: EffectsSpec, has_friction: bool) -> tuple[str, ...]:
    """The effects that have events; where there is none, the friction of contacts has them."""
    if effects.with_events or not has_friction:
        return effects.with_events
    return ("mu",)


def carries_all_effects(integrator: str | None) -> bool:
    """Whether a method carries effects with states and with events."""
    return integrator != "variational"


def method_fault(
    integrator: str | None,
    with_states: Sequence[str],
    with_events: Sequence[str] = (),
    timed: bool = False,
) -> str:
    """Why a method cannot carry effects that have states or events; empty when it can.

    ``timed`` says whether joints hold for some of the time, which has events too.
    """
    if carries_all_effects(integrator):
        return ""
    if timed:
        return (
            "'variational' takes its steps as wholes and knows no events of joints that take hold "
            "or let go ('from', 'until'); use another method, such as 'dop853' or 'rk4'"
        )
    if with_events:
        return (
            f"'variational' takes its steps as wholes and knows no events of "
            f"{listed(with_events)}; use another method, such as 'dop853' or 'rk4', or leave the "
            f"effect out"
        )
    if not with_states:
        return ""
    return (
        f"'variational' knows positions and velocities only, no states of {listed(with_states)}; "
        f"use another method, such as 'dop853' or 'rk4', or leave the effect out"
    )
