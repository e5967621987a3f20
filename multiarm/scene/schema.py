"""The scene: arms joined to one common object, what drives them, how the run is carried out.

A :class:`Scene` that exists is valid: its numbers are physical, its arms, frames and joints exist.
Whether it comes from YAML or is built in Python, all faults are told together in one SceneError.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene.arm_spec import ArmSpec
from multiarm.scene.base import Spec
from multiarm.scene.check import Looked, SceneParts, check
from multiarm.scene.control import ControlSpec, NoControl, RunSpec
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.faults import explain
from multiarm.scene.functions import function_references
from multiarm.scene.joints import JointSpec
from multiarm.scene.object_spec import ObjectSpec
from multiarm.scene.user_code import reference_fault
from multiarm.scene.values import ArmName, Vec3
from multiarm.scene.words import place, shown

__all__ = ["Scene"]


class Scene(Spec):
    """Arms joined to one common object, what drives them, and how the run is carried out.

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
        The common object.
    arms : table of ArmSpec
        By name.
    joints : list of joints
        One for each arm.
    control, effects, run
        What drives the arms, which optional physics is modelled, how the run is carried out.

    Raises
    ------
    SceneError
        Naming every fault.
    """

    name: str = "unnamed scene"
    gravity: Vec3 | None = None
    object: ObjectSpec = Field(description="the common object: shape, mass, pose")
    arms: dict[ArmName, ArmSpec] = Field(description="a table 'name: {robot: ..., tip: ...}'")
    joints: tuple[JointSpec, ...] = Field(description="a list of {arm: ..., kind: ...}")
    control: ControlSpec = NoControl()
    effects: EffectsSpec = EffectsSpec()
    run: RunSpec = Field(default_factory=RunSpec)

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _from_file: bool = PrivateAttr(default=False)
    _may_load_code: bool = PrivateAttr(default=True)
    _warnings: tuple[str, ...] = PrivateAttr(default=())
    _looked: Looked = PrivateAttr(default_factory=dict)

    def __init__(self, /, folder: Path | str | None = None, **data: Any) -> None:
        self._fill(data, folder)

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def from_mapping(
        cls,
        data: Mapping[str, Any],
        folder: Path | str | None = None,
        stored: bool = False,
        like: Scene | None = None,
        from_file: bool = False,
        code: bool | None = None,
    ) -> Self:
        """Return the scene that ``data``, such as a parsed YAML file, describes.

        A ``stored`` one is that of a run: effects of one's own need not be there to look at it.
        Arms that are those of another scene, ``like`` it, are not looked at once more; it decides
        about code too.  What is ``from_file`` loads nothing now, and its functions lie in its
        folder; ``code`` tells whether a system may load them, by default unless it is stored.
        """
        if not isinstance(data, Mapping):
            keys = ", ".join(cls.model_fields)
            raise SceneError(f"$: a scene is a table with the keys {keys}; got {shown(data)}")
        scene = cls.__new__(cls)
        scene._fill(data, folder, stored, like, from_file)
        if like is not None:
            code = like.may_load_code
        scene._may_load_code = not stored if code is None else code
        return scene

    @classmethod
    def model_validate(cls, obj: Any, **_options: Any) -> Self:
        """Return ``obj`` if it is a scene, else the scene that the mapping describes."""
        return obj if isinstance(obj, cls) else cls.from_mapping(obj)

    def replace(self, **changes: Any) -> Self:
        """Return a scene with some attributes replaced, validated anew."""
        kept = {name: getattr(self, name) for name in type(self).model_fields}
        return self.from_mapping({**kept, **changes}, self.folder, like=self)

    @property
    def folder(self) -> Path:
        """The folder at which relative paths of this scene started."""
        return self._folder

    @property
    def is_from_file(self) -> bool:
        """Whether it was written in a scene file, or is that of such a file with other values."""
        return self._from_file

    @property
    def may_load_code(self) -> bool:
        """Whether the functions and effects that it names may be loaded when it is compiled."""
        return self._may_load_code

    @property
    def warnings(self) -> list[str]:
        """What is unusual but not wrong: locked joints, missing meshes, exceeded limits."""
        return list(self._warnings)

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Scene) and self.model_dump() == other.model_dump()

    __hash__ = None  # type: ignore[assignment]

    @field_validator("object", "arms", "joints", "effects", mode="after")
    @classmethod
    def _paths_are_absolute(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.context is not None, "a scene is read with its folder"
        folder = info.context["folder"]
        if isinstance(value, (ObjectSpec, EffectsSpec)):
            return value.located(folder)
        if isinstance(value, tuple):
            return tuple(joint.located(folder) for joint in value)
        return {name: arm.located(folder) for name, arm in value.items()}

    def _fill(
        self,
        data: Mapping[str, Any],
        folder: Path | str | None,
        stored: bool = False,
        like: Scene | None = None,
        from_file: bool = False,
    ) -> None:
        folder = Path(folder or ".").expanduser().resolve()
        faults: list[str] = []
        load = not (stored or from_file)
        try:
            self.__pydantic_validator__.validate_python(
                data, self_instance=self, context={"folder": folder, "stored": stored, "load": load}
            )
            parts = SceneParts.of(self.__dict__, folder)
            if from_file:
                faults = _function_faults(self, folder)
        except ValidationError as error:
            faults = explain(error, type(self))
            parts = SceneParts.of(data, folder, load)
        found = check(parts, None if like is None else like._looked)
        if faults or found.faults:
            raise SceneError([*faults, *found.faults])
        self._folder, self._warnings = folder, tuple(found.warnings)
        self._from_file = from_file
        self._looked = found.arms


def _function_faults(scene: Scene, folder: Path) -> list[str]:
    """Functions that a scene file may not name."""
    named = [
        *function_references(scene.joints, ("joints",)),
        *function_references(scene.effects, ("effects",)),
    ]
    found = ((parts, reference_fault(reference, folder)) for parts, reference in named)
    return [f"{place(parts)}: {reason}" for parts, reason in found if reason]
