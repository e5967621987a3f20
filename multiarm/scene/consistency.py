"""Whether the parts of a scene fit together: arms and their joints, control, effects, method.

Parts that are not valid by themselves are left out, so that one error has all faults.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from multiarm.errors import USER_FAULTS, Fault, ModelError
from multiarm.scene.arms import ArmSpec, Examination, examine_arm
from multiarm.scene.code import located
from multiarm.scene.control import ControlKind, ControlSpec
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.faults import Parts, fault_at, listed, place, unknown
from multiarm.scene.joint_values import KnownArm
from multiarm.scene.joints import pushing_kinds
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.scene.joints.kind import Joint
from multiarm.scene.object import ObjectSpec
from multiarm.scene.registry import called
from multiarm.scene.run import RunSpec
from multiarm.scene.spec import Spec
from multiarm.scene.trunks import Robot, robot_faults, robot_warnings, robots_of

Examined = dict[str, tuple[ArmSpec, Examination]]
"""Arms by name, with their facts."""
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
    joints : list
        The arms that they name, as they are written, whatever that is; None where there is none.
    pushes : bool
        Whether there may be contacts that only push.
    rubs : bool
        Whether a joint, or a contact that is listed, has friction of its own.
    """

    arm_names: list[str] | None
    arms: dict[str, ArmSpec]
    joints: list[Any] | None
    pushes: bool
    rubs: bool
    object: ObjectSpec | None
    control: ControlKind | None
    effects: EffectsSpec | None
    run: RunSpec | None

    @classmethod
    def of(cls, data: Mapping[str, Any], context: Context) -> ValidParts:
        """Find the valid parts of ``data``, which may hold instances or plain tables."""
        arms, joints = data.get("arms"), data.get("joints")
        joints = joints if isinstance(joints, (list, tuple)) else None
        written = arms if isinstance(arms, Mapping) else {}
        valid = {str(name): _valid(ArmSpec, arm, context) for name, arm in written.items()}
        return cls(
            arm_names=[str(name) for name in arms] if isinstance(arms, Mapping) else None,
            arms={name: arm for name, arm in valid.items() if arm is not None},
            joints=None if joints is None else [_arm(joint) for joint in joints],
            pushes=not joints or any(_pushes(joint) for joint in joints),
            rubs=any(_rubs(joint) for joint in joints or ()),
            object=_valid(ObjectSpec, data.get("object"), context),
            control=_valid(ControlSpec, data.get("control"), context),
            effects=_valid(EffectsSpec, data.get("effects", {}), context),
            run=_valid(RunSpec, data.get("run"), context),
        )


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


def _arm(joint: Any) -> Any:
    return joint.get("arm") if isinstance(joint, Mapping) else getattr(joint, "arm", None)


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
    """Faults and warnings, complete lines; the arms as they were examined, the robots."""

    faults: list[Fault] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    examined: Examined = field(default_factory=dict)
    robots: tuple[Robot, ...] = ()

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
    if parts.arm_names is not None:
        _check_connections(parts.arm_names, parts.joints, findings)
    _check_arms(parts.arms, examined, findings)
    mesh = None if parts.object is None else parts.object.shape.mesh
    if mesh is not None and not mesh.file.is_file():
        findings.add_warning(
            ("object", "shape", "mesh", "file"),
            f"no file at {mesh.file}; the motion is not affected, the replay shows a stand-in",
        )
    if parts.arm_names is not None:
        examinations = {name: examination for name, (_, examination) in findings.examined.items()}
        arms = {name: examinations.get(name, KnownArm()) for name in parts.arm_names}
        _check_control(parts.control, arms, findings)
        _check_effects(parts, arms, findings)
    return findings


def _check_connections(names: list[str], connected: list[Any] | None, findings: Findings) -> None:
    if not names:
        findings.add_fault(("arms",), "a scene needs at least one arm, such as {left: {...}}")
        return
    for index, arm in enumerate(connected or ()):
        if arm is not None and not (isinstance(arm, str) and arm in names):
            findings.add_fault(("joints", index, "arm"), unknown("arm", arm, names))
    counts = Counter(arm for arm in connected or () if isinstance(arm, str))
    all_named = connected is not None and None not in connected
    for name in names:
        if counts[name] == 0 and all_named:
            findings.add_fault(
                ("joints",),
                f"arm {name!r} is connected by no joint; add one, such as "
                f"{{arm: {name}, kind: weld}}, or remove the arm",
            )
        if counts[name] > 1:
            findings.add_fault(
                ("joints",),
                f"arm {name!r} has {counts[name]} joints; one joint per arm is possible, list "
                "their contacts in one joint of kind 'contacts'",
            )


def _check_arms(arms: Mapping[str, ArmSpec], examined: Examined, findings: Findings) -> None:
    examinations = {}
    for name, spec in arms.items():
        before, known = examined.get(name, (None, None))
        examinations[name] = known if known is not None and before == spec else examine_arm(spec)
        findings.examined[name] = spec, examinations[name]
        for where, text in examinations[name].faults:
            findings.add_fault(("arms", name, *where), text)
    findings.robots = robots_of(arms, examinations)
    for robot in findings.robots:
        for where, text in robot_faults(robot, arms, examinations):
            findings.add_fault(where, text)
        for where, text in robot_warnings(robot, arms, examinations):
            findings.add_warning(where, text)


def _check_control(
    control: ControlKind | None, arms: Mapping[str, KnownArm], findings: Findings
) -> None:
    if control is None:
        return
    try:
        faults = called(lambda: control.faults(arms), f"control kind {control.kind!r}: faults()")
    except ModelError as error:
        faults = [((), str(error))]
    for where, text in faults:
        findings.add_fault(("control", *where), text)


def _check_effects(parts: ValidParts, arms: Mapping[str, KnownArm], findings: Findings) -> None:
    effects = parts.effects
    if effects is None:
        return
    for where, text in effects.faults(arms):
        findings.add_fault(("effects", *where), text)
    for where, text in effects.warnings(arms):
        findings.add_warning(("effects", *where), text)
    if parts.run is not None:
        with_events = causes_of_events(effects, parts.rubs)
        message = method_fault(parts.run.integrator, effects.with_states, with_events)
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
    integrator: str | None, with_states: Sequence[str], with_events: Sequence[str] = ()
) -> str:
    """Why a method cannot carry effects that have states or events; empty when it can."""
    if carries_all_effects(integrator):
        return ""
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
