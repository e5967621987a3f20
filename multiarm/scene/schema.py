"""The scene: arms joined to one common object, control, effects and settings of the run.

A :class:`Scene` that exists is valid: its numbers are physical, its arms, frames and joints exist
and fit together.  Whether it comes from YAML or is built in Python, one SceneError names all
faults: how the parts fit together is checked for the parts that are valid by themselves, so that a
scene with a mistyped number *and* a mistyped arm has both reported at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import (
    Field,
    PrivateAttr,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from typing_extensions import Self

from multiarm.errors import USER_FAULTS, Fault, ModelError, SceneError
from multiarm.public import facts_html
from multiarm.scene.arms import ArmSpec, Examination, examine_arm
from multiarm.scene.changes import with_changes
from multiarm.scene.code import located
from multiarm.scene.control import ControlKind, ControlSpec, NoControl
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.faults import (
    Parts,
    counted,
    explain,
    fault_at,
    listed,
    place,
    shown,
    unknown,
)
from multiarm.scene.joint_values import KnownArm
from multiarm.scene.joints import JointSpec, pushing_kinds
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.scene.joints.kind import Joint
from multiarm.scene.object import ObjectSpec
from multiarm.scene.registry import Classes, called
from multiarm.scene.run import RunSpec
from multiarm.scene.spec import Spec
from multiarm.scene.trunks import Robot, robot_faults, robot_warnings, robots_of
from multiarm.scene.values import ArmName, Vec3

_Examined = dict[str, tuple[ArmSpec, Examination]]
"""Arms by name, with their facts."""
_Context = dict[str, Any]
"""What validators know: where relative paths start, whether code may be named, user classes."""


class Scene(Spec):
    """Arms joined to one common object, with control, effects and settings of the run.

    Parameters
    ----------
    folder : path, optional
        Where relative paths start; the current folder by default.
    **data
        The attributes below, as instances or as plain tables and lists.

    Attributes
    ----------
    name : str
        A title.
    gravity : 3 numbers, optional
        [m/s^2], world axes. Absent: no gravity.
    object : ObjectSpec
        The common object: shape, mass, pose.
    arms : table of ArmSpec
        A table 'name: {robot: ..., tip: ...}'.
    joints : list of joints
        A list of {arm: ..., kind: ...}.  One for each arm.
    control : one of the kinds of control
        The joint torques; none by default.
    effects : table of effects
        Physics that a scene asks for, by name; what it does not name costs nothing.
    run : RunSpec
        How long, how exactly and by which method it is simulated.

    Raises
    ------
    SceneError
        Naming every fault.
    """

    name: str = "unnamed scene"
    gravity: Vec3 | None = None
    object: ObjectSpec
    arms: dict[ArmName, ArmSpec]
    joints: tuple[JointSpec, ...]
    control: ControlSpec = NoControl()
    effects: EffectsSpec = EffectsSpec()
    run: RunSpec = Field(default_factory=RunSpec)

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _may_load_code: bool = PrivateAttr(default=True)
    _warnings: tuple[str, ...] = PrivateAttr(default=())
    _robots: tuple[Robot, ...] = PrivateAttr(default=())
    _examined: _Examined = PrivateAttr(default_factory=dict)

    def __init__(self, /, folder: Path | str | None = None, **data: Any) -> None:
        self._fill(data, folder)

    @classmethod
    def from_mapping(
        cls,
        data: Mapping[str, Any],
        folder: Path | str | None = None,
        code: bool = True,
    ) -> Self:
        """The scene that ``data``, such as a parsed YAML file, describes.

        Parameters
        ----------
        data : mapping
        folder : path, optional
            Where relative paths start; the current folder by default.
        code : bool
            Whether the functions and classes that it names may be loaded when a system is compiled;
            without, the classes need not be installed.
        """
        if not isinstance(data, Mapping):
            keys = ", ".join(cls.model_fields)
            problem = f"a scene is a table with the keys {keys}; got {shown(data)}"
            raise SceneError([fault_at((), problem)])
        scene = cls.__new__(cls)
        scene._fill(data, folder, code)
        return scene

    @classmethod
    def model_validate(cls, obj: Any, **_options: Any) -> Self:
        """``obj`` itself if it is a scene, else the scene that the mapping describes."""
        return obj if isinstance(obj, cls) else cls.from_mapping(obj)

    def replace(self, changes: Mapping[str, Any] | None = None, /, **parts: Any) -> Self:
        """The scene with other values at some places, all parts validated together.

        Parameters
        ----------
        changes : mapping, optional
            Path -> value, such as ``{"object.mass": 20, "joints[0].at.xyz": [0, 0, 0.1]}``.
            Optional tables on the way are added.  Naming one of ``run.accuracy``,
            ``run.integrator``, ``run.step`` and ``run.tolerance`` replaces the scene's choice of
            all four.
        **parts
            Whole parts of the scene, such as ``control="none"``.

        Raises
        ------
        SceneError
            Naming every fault.
        """
        if changes is not None and not isinstance(changes, Mapping):
            raise SceneError(f"must be a table 'path: value', got {shown(changes)}")
        data, faults = with_changes(self, {**(changes or {}), **parts})
        try:
            scene = self.revalidated(data, self._may_load_code)
        except SceneError as error:
            faults += error.faults
        if faults:
            raise SceneError(faults)
        return scene

    def revalidated(
        self, data: Mapping[str, Any], code: bool, classes: Classes | None = None
    ) -> Self:
        """The scene with other data, whose user ``classes`` are those that were loaded for it.

        Arms that are as they were are not examined again.
        """
        scene = type(self).__new__(type(self))
        scene._fill(data, self.folder, code, classes, self._examined)
        return scene

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, with other parts, which are validated as by :meth:`replace`."""
        copy = super().model_copy(deep=deep)
        return copy.replace(update) if update else copy

    @property
    def folder(self) -> Path:
        """The folder at which relative paths of this scene started."""
        return self._folder

    @property
    def may_load_code(self) -> bool:
        """Whether the functions and classes that it names may be loaded when it is compiled."""
        return self._may_load_code

    @property
    def warnings(self) -> list[str]:
        """Warnings: locked joints, missing meshes, exceeded limits."""
        return list(self._warnings)

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robots; arms of one file on one base are one, such as the two on a trunk."""
        return self._robots

    def robot_of(self, arm: str) -> Robot:
        """The robot that an arm belongs to."""
        return next(robot for robot in self._robots if arm in robot.arms)

    def __repr__(self) -> str:
        facts = "; ".join(f"{name} {fact}" for name, fact in self._facts().items())
        return f"<Scene {self.name!r}: {facts}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return facts_html(self.name, self._facts())

    def _facts(self) -> dict[str, str]:
        """What it holds, in words."""
        shape = next((f"{name}, " for name, value in self.object.shape if value is not None), "")
        joints = {joint.arm: joint.kind for joint in self.joints}
        arms = []
        for name, arm in self.arms.items():
            model = arm.robot if arm.file is None else arm.file.name
            arms.append(f"{name} ({model}, {joints[name]})")
        effects = list(self.effects.named)
        return {
            "object": f"{shape}{self.object.mass:g} kg",
            "arms": counted(arms, 8),
            "control": self.control.kind,
            "effects": counted(effects, 8) or "none",
            "run": f"{self.run.duration:g} s",
        }

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Scene) and self.model_dump() == other.model_dump()

    __hash__ = None  # type: ignore[assignment]

    @field_validator("object", "arms", "joints", "control", "effects", mode="after")
    @classmethod
    def _paths_are_absolute(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.context is not None, "a scene is read with its folder"
        return located(value, info.context["folder"])

    def _fill(
        self,
        data: Mapping[str, Any],
        folder: Path | str | None,
        code: bool = True,
        classes: Classes | None = None,
        examined: _Examined | None = None,
    ) -> None:
        if folder is not None and not isinstance(folder, (str, Path)):
            raise SceneError(
                f"folder: must be a path, got {shown(folder)}; parts of a scene are given by name: "
                "Scene(object=..., arms=..., joints=...)"
            )
        folder = Path(folder or ".").expanduser().resolve()
        context = {"folder": folder, "code": code, "classes": classes or {}}
        faults: list[Fault] = []
        try:
            self.__pydantic_validator__.validate_python(data, self_instance=self, context=context)
            parts = _Parts.of(self.__dict__, context)
        except ValidationError as error:
            faults = explain(error, type(self))
            parts = _Parts.of(data, context)
        findings = _check(parts, examined or {})
        if faults or findings.faults:
            raise SceneError([*faults, *findings.faults])
        self._folder, self._may_load_code = folder, code
        self._warnings, self._examined = tuple(findings.warnings), findings.examined
        self._robots = findings.robots


def changed_scenes(scene: Scene, changes: Sequence[Mapping[str, Any]]) -> list[Scene]:
    """One scene for each table of changes, see :meth:`Scene.replace`.

    Raises
    ------
    SceneError
        Naming every fault of all, with the number of its run.
    """
    scenes, faults = [], []
    for number, table in enumerate(changes, start=1):
        try:
            scenes.append(scene.replace(table))
        except SceneError as error:
            faults += [Fault(fault, f"run {number}") for fault in error.faults]
    if faults:
        raise SceneError(faults, source="parameters")
    return scenes


# --- whether the parts fit together --------------------------------------------------------------


@dataclass(frozen=True)
class _Parts:
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
    def of(cls, data: Mapping[str, Any], context: _Context) -> _Parts:
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


def _valid(kind: Any, data: Any, context: _Context) -> Any:
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
class _Findings:
    """Faults and warnings, complete lines; the arms as they were examined, the robots."""

    faults: list[Fault] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    examined: _Examined = field(default_factory=dict)
    robots: tuple[Robot, ...] = ()

    def add_fault(self, parts: Parts, text: str) -> None:
        self.faults.append(fault_at(parts, text))

    def add_warning(self, parts: Parts, text: str) -> None:
        self.warnings.append(f"{place(parts)}: {text}")


def _check(parts: _Parts, examined: _Examined) -> _Findings:
    """All faults and warnings about how the parts fit together.

    Arms that were examined already, and are written as they were, are not examined again.
    """
    findings = _Findings()
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


def _check_connections(names: list[str], connected: list[Any] | None, findings: _Findings) -> None:
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


def _check_arms(arms: Mapping[str, ArmSpec], examined: _Examined, findings: _Findings) -> None:
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
    control: ControlKind | None, arms: Mapping[str, KnownArm], findings: _Findings
) -> None:
    if control is None:
        return
    try:
        faults = called(lambda: control.faults(arms), f"control kind {control.kind!r}: faults()")
    except ModelError as error:
        faults = [((), str(error))]
    for where, text in faults:
        findings.add_fault(("control", *where), text)


def _check_effects(parts: _Parts, arms: Mapping[str, KnownArm], findings: _Findings) -> None:
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
