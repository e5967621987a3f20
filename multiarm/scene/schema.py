"""The scene: robots and objects that joints connect, control, effects and settings of the run.

A :class:`Scene` that exists is valid: its numbers are physical, its arms, frames and joints exist
and fit together.  Whether it comes from YAML or is built in Python, one SceneError names all
faults: how the parts fit together is checked for the parts that are valid by themselves, so that a
scene with a mistyped number *and* a mistyped arm has both reported at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import (
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from typing_extensions import Self

from multiarm.errors import Fault, SceneError
from multiarm.public import facts_html
from multiarm.scene.arms import ArmSpec
from multiarm.scene.bodies import OBJECT_NAME
from multiarm.scene.changes import with_changes
from multiarm.scene.code import located
from multiarm.scene.consistency import Examined, ValidParts, check, object_names
from multiarm.scene.control import ControlSpec, NoControl
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.faults import counted, explain, fault_at, listed, shown
from multiarm.scene.joints import JointSpec
from multiarm.scene.joints.kind import in_scene_of
from multiarm.scene.object import ObjectSpec
from multiarm.scene.registry import Classes
from multiarm.scene.robot_spec import RobotSpec
from multiarm.scene.run import RunSpec
from multiarm.scene.spec import Spec
from multiarm.scene.trunk_robots import parts_with_trunk_robots
from multiarm.scene.trunks import ArmGroup
from multiarm.scene.values import ArmName, ObjectName, RobotName, Vec3


def _or_left_out(schema: dict[str, Any]) -> None:
    """A file leaves out a key, and need not say that it is nothing."""
    table, _nothing = schema.pop("anyOf")
    schema |= table


class Scene(Spec):
    """Robots and objects that joints connect, with control, effects and settings of the run.

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
    object : ObjectSpec, optional
        The common object: shape, mass, pose. Absent where there are 'objects'.
    objects : table of ObjectSpec, optional
        In place of 'object', one or several: a table 'name: {shape: ..., mass: ..., pose: ...}'.
    arms : table of ArmSpec
        Robots with one tip: a table 'name: {robot: ..., tip: ...}'.
    robots : table of RobotSpec
        Robots with several tips, or on a base that moves: a table 'name: {robot: ..., tips: {tip:
        link}}', with or instead of 'arms'.
    joints : list of joints
        A list of {arm: ..., kind: ...} or {between: [..., ...], kind: ...}. One for each arm at
        least.
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

    model_config = ConfigDict(
        json_schema_extra={"oneOf": [{"required": ["object"]}, {"required": ["objects"]}]}
    )

    name: str = "unnamed scene"
    gravity: Vec3 | None = None
    object: ObjectSpec | None = Field(None, json_schema_extra=_or_left_out)
    objects: dict[ObjectName, ObjectSpec] | None = Field(None, json_schema_extra=_or_left_out)
    arms: dict[ArmName, ArmSpec] = Field(default_factory=dict)
    robots: dict[RobotName, RobotSpec] = Field(default_factory=dict)
    joints: tuple[JointSpec, ...]
    control: ControlSpec = NoControl()
    effects: EffectsSpec = EffectsSpec()
    run: RunSpec = Field(default_factory=RunSpec)

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _may_load_code: bool = PrivateAttr(default=True)
    _warnings: tuple[str, ...] = PrivateAttr(default=())
    _arm_groups: tuple[ArmGroup, ...] = PrivateAttr(default=())
    _examined: Examined = PrivateAttr(default_factory=dict)

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
    def all_objects(self) -> dict[str, ObjectSpec]:
        """The objects by name; the one of 'object' is named "object"."""
        return dict(self.objects or {} if self.object is None else {OBJECT_NAME: self.object})

    def one_object(self, what: str) -> ObjectSpec:
        """The only object.

        Raises
        ------
        SceneError
            The scene has several, and ``what`` is not known for them.
        """
        bodies = self.all_objects
        if len(bodies) > 1:
            raise SceneError(f"{what} is for scenes with one object; this one has {listed(bodies)}")
        return next(iter(bodies.values()))

    def place_of_object(self, name: str) -> str:
        """Where an object stands in the scene: ``object``, or ``objects.NAME``."""
        return OBJECT_NAME if self.objects is None else f"objects.{name}"

    @property
    def arm_groups(self) -> tuple[ArmGroup, ...]:
        """The arms, those of one file on one base together, such as the two on a trunk."""
        return self._arm_groups

    def group_of(self, arm: str) -> ArmGroup:
        """The group that an arm belongs to."""
        return next(group for group in self._arm_groups if arm in group.arms)

    def with_trunk_robots(self) -> Self:
        """The scene as it is simulated: arms on a trunk that moves are robots.

        Its warnings are those of the scene as it is written.
        """
        parts = parts_with_trunk_robots(self._arm_groups, self.arms, self.robots, self.joints)
        if not parts:
            return self
        scene = self.model_copy(update=parts)
        scene._warnings = self._warnings
        return scene

    def links_in_joints(self, robot: str) -> tuple[str, ...]:
        """The links of a robot that joints name besides its tips."""
        return self._examined["robots", robot].links

    def __repr__(self) -> str:
        facts = "; ".join(f"{name} {fact}" for name, fact in self._facts().items())
        return f"<Scene {self.name!r}: {facts}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return facts_html(self.name, self._facts())

    def _facts(self) -> dict[str, str]:
        """What it holds, in words."""
        objects = {name: _object_fact(body) for name, body in self.all_objects.items()}
        of_objects = [f"{name} ({fact})" for name, fact in objects.items()]
        kinds: dict[str, list[str]] = {name: [] for name in (*self.arms, *self.robots)}
        for joint in self.joints:
            for name in {joint.first.robot, joint.second.robot} & kinds.keys():
                kinds[name].append(joint.kind)
        texts = {
            name: ", ".join([robot.robot or str(robot.file and robot.file.name), *kinds[name]])
            for name, robot in (*self.arms.items(), *self.robots.items())
        }
        arms, robots = ([f"{name} ({texts[name]})" for name in t] for t in (self.arms, self.robots))
        effects = list(self.effects.named)
        return {
            **(objects if self.objects is None else {"objects": counted(of_objects, 8)}),
            **({"arms": counted(arms, 8)} if arms else {}),
            **({"robots": counted(robots, 8)} if robots else {}),
            "control": self.control.kind,
            "effects": counted(effects, 8) or "none",
            "run": f"{self.run.duration:g} s",
        }

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Scene) and self.model_dump() == other.model_dump()

    __hash__ = None  # type: ignore[assignment]

    @field_validator(
        "object", "objects", "arms", "robots", "joints", "control", "effects", mode="after"
    )
    @classmethod
    def _paths_are_absolute(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.context is not None, "a scene is read with its folder"
        return located(value, info.context["folder"])

    @field_validator("joints", mode="after")
    @classmethod
    def _joints_know_the_objects(
        cls, joints: tuple[JointSpec, ...], info: ValidationInfo
    ) -> tuple[JointSpec, ...]:
        assert info.context is not None, "a scene is read with the names of its objects"
        return tuple(in_scene_of(joint, info.context["objects"]) for joint in joints)

    def _fill(
        self,
        data: Mapping[str, Any],
        folder: Path | str | None,
        code: bool = True,
        classes: Classes | None = None,
        examined: Examined | None = None,
    ) -> None:
        if folder is not None and not isinstance(folder, (str, Path)):
            raise SceneError(
                f"folder: must be a path, got {shown(folder)}; parts of a scene are given by name: "
                "Scene(object=..., arms=..., joints=...)"
            )
        folder = Path(folder or ".").expanduser().resolve()
        context = {
            "folder": folder,
            "code": code,
            "classes": classes or {},
            "objects": object_names(data) or (OBJECT_NAME,),
        }
        faults: list[Fault] = []
        try:
            self.__pydantic_validator__.validate_python(data, self_instance=self, context=context)
            parts = ValidParts.of(self.__dict__, context)
        except ValidationError as error:
            faults = explain(error, type(self))
            parts = ValidParts.of(data, context)
        findings = check(parts, examined or {})
        if faults or findings.faults:
            raise SceneError([*faults, *findings.faults])
        self._folder, self._may_load_code = folder, code
        self._warnings, self._examined = tuple(findings.warnings), findings.examined
        self._arm_groups = findings.arm_groups


def _object_fact(body: ObjectSpec) -> str:
    shape = next((f"{name}, " for name, value in body.shape if value is not None), "")
    return f"{shape}{body.mass:g} kg"


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
