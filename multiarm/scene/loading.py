"""Scene files: YAML text read with every fault at its place, written back, and their code.

A scene can name functions (surfaces, wrenches, control) and user classes (effects, joints,
surfaces, controls).  Reading it loads none of them.  :func:`with_code` loads them for a system that
is to run; :func:`without_code` gives what can be looked at without them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from multiarm.errors import Fault, ModelError, SceneError
from multiarm.scene.code import (
    CodeReference,
    LoadedFunction,
    is_reference,
    load_code,
    mapped,
    nodes,
    reference_fault,
)
from multiarm.scene.control import CONTROLS, ControlKind, UnloadedControl
from multiarm.scene.effects import EFFECTS
from multiarm.scene.faults import Parts, fault_at, place, shown
from multiarm.scene.joints import JOINTS
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.scene.joints.kind import Joint, UnloadedJoint
from multiarm.scene.joints.times import without_function
from multiarm.scene.registry import ByName, Registry
from multiarm.scene.schema import Scene
from multiarm.scene.spec import written
from multiarm.scene.surfaces import SURFACES
from multiarm.scene.text import parse_yaml, read_text, written_yaml

REGISTRIES: tuple[Registry[Any], ...] = (CONTROLS, EFFECTS, JOINTS, SURFACES)
"""The user classes of all sorts."""


def load_scene(path: Path | str, code: bool = True) -> Scene:
    """Read a scene file; nothing that it names is loaded or run.

    Parameters
    ----------
    path : path
        A YAML file. Relative paths in it start at its folder.
    code : bool
        Whether :func:`multiarm.compile_system` may load the functions and classes that it names;
        without, it refuses a scene that names any.

    Returns
    -------
    Scene
        Named after the file if it has no name.

    Raises
    ------
    SceneError
        If the file cannot be read, or naming every fault in it.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise SceneError(
            f"load_scene reads a file and needs its path, got {shown(path)}; a table is made a "
            "scene by ma.Scene(**table)"
        )
    text = read_text(path, "scene")
    path = Path(path).expanduser()
    try:
        data = parse_yaml(text)
        if isinstance(data, Mapping):
            data = {"name": path.stem.replace("_", " "), **data}
        scene = Scene.from_mapping(data, path.resolve().parent, code)
        faults = [
            fault_at(parts, reason)
            for parts, registry, name in _code_of(scene)
            if (reason := _location_fault(registry, name, scene.folder))
        ]
    except SceneError as error:
        faults = error.faults
    if faults:
        raise SceneError(faults, source=str(path))
    return scene


def parse_scene(
    source: str | Mapping[str, Any], folder: Path | str | None = None, code: bool = True
) -> Scene:
    """The scene that a YAML text or a table describes.

    Parameters
    ----------
    source : str or mapping
        The text, or its content.
    folder : path, optional
        Where relative paths start; the current folder by default.
    code : bool
        As of :func:`load_scene`.

    Raises
    ------
    SceneError
        Naming every fault.
    """
    data = parse_yaml(source) if isinstance(source, str) else source
    return Scene.from_mapping(data, folder, code)


def dump_scene(scene: Scene) -> str:
    """The scene as YAML text with absolute paths; it loads again to an equal scene."""
    data = scene.model_dump(mode="json", exclude_defaults=True)
    for name, body in (scene.objects or {}).items():
        if "pose" in body.model_fields_set:  # without it, an object is where its joints put it
            data["objects"][name].setdefault("pose", {"xyz": list(body.pose.xyz)})
    # A run without settings has the default accuracy: write it out.
    data["run"] = scene.run.model_dump(mode="json", exclude_defaults=True)
    return written_yaml(data)


# --- code that a scene names ----------------------------------------------------------------------


PARTS = ("joints", "control", "effects")
"""The parts of a scene that may name code."""


@dataclass(frozen=True)
class NamedCode:
    """Code that is named somewhere.

    Attributes
    ----------
    place : str
        Where it is named, such as ``$.effects.external_wrenches[0].function``.
    what : str
        The function or the class, with its file, module or package.
    arm : str or None
        The name of the joint whose contacts need it, of one with 'arm' the arm.
    missing : str
        Why there is no such class; empty where there is one.
    """

    place: str
    what: str
    arm: str | None = None
    missing: str = ""

    @classmethod
    def function(cls, parts: Parts, reference: CodeReference, arm: str | None = None):
        """A function that is named at a place."""
        return cls(place(parts), f"the function {reference.name!r} of {reference.home}", arm)

    @classmethod
    def user_class(
        cls, parts: Parts, registry: Registry, name: str, arm: str | None = None
    ) -> NamedCode:
        """A user class that is named at a place."""
        offer = registry.offers(name)
        missing = "" if offer or name in registry.registered else registry.unknown(name)
        shown_name = CodeReference(name).name if is_reference(name) else name
        owner = offer or "a package that is not installed"
        what = f"the {registry.noun} {shown_name!r} of {owner}"
        return cls(place(parts), what, arm, missing)


def named_code(scene: Scene) -> list[NamedCode]:
    """The code that a scene names and that is not loaded yet, in the order of the scene."""
    named = []
    for parts, registry, name in _code_of(scene):
        of_contacts = parts[0] == "joints" and parts[2] not in ("from", "until")
        arm = scene.joints[int(parts[1])].connection if of_contacts else None
        if registry is None:
            named.append(NamedCode.function(parts, CodeReference(name), arm))
        else:
            named.append(NamedCode.user_class(parts, registry, name, arm))
    return named


def refuse_code(named: Iterable[NamedCode]) -> None:
    """Refuse to load any code.

    Raises
    ------
    SceneError
        When some is named: each with its place, and how it is allowed.
    """
    remedy = (
        "is not loaded, since code is not allowed; if you trust its author, allow it (`code=True` "
        "in Python, no `--no-code` on the command line)"
    )
    faults = [Fault(code.missing or f"{code.what} {remedy}", code.place) for code in named]
    if faults:
        raise SceneError(faults)


def with_code(scene: Scene, allowed: bool | None = None) -> Scene:
    """The scene with its functions loaded in place of their names, and user classes validated.

    Parameters
    ----------
    scene : Scene
    allowed : bool, optional
        Whether code may be loaded; as the scene was read, when left out.

    Raises
    ------
    SceneError
        When code is named and not allowed, is not installed, or refuses its parameters.
    ModelError
        When a function cannot be loaded.
    """
    named = named_code(scene)
    if not named:
        return scene
    missing = [Fault(code.missing, code.place) for code in named if code.missing]
    if missing:
        raise SceneError(missing)
    if not (scene.may_load_code if allowed is None else allowed):
        refuse_code(named)
    scene = _with_classes(scene)
    return scene.replace({part: loaded_functions(getattr(scene, part), (part,)) for part in PARTS})


def without_code(scene: Scene) -> tuple[Scene, list[NamedCode]]:
    """The scene without what needs code that is not loaded, and that code.

    Left out are wrenches by functions, effects of packages, control that needs either, events of
    functions at which joints take hold or let go, and of joints the contacts that need functions or
    classes of packages; the others keep their names.
    """
    left = named_code(scene)
    if not left:
        return scene, left
    unloaded = {name for _, registry, name in code_in(scene.effects) if registry is not None}
    wrenches = scene.effects.external_wrenches or ()
    known = tuple(wrench for wrench in wrenches if not any(code_in(wrench)))
    effects = {**scene.effects.named, "external_wrenches": known or None}
    joints = tuple(_without_contacts(_without_functions(joint)) for joint in scene.joints)
    control = scene.control
    if any(code_in(control)):
        control = ControlKind(kind=control.kind)
    effects = {name: value for name, value in effects.items() if name not in unloaded}
    parts = {"joints": joints, "control": control, "effects": effects}
    return scene.revalidated({**dict(scene), **parts}, code=False), left


def loaded_functions(value: Any, parts: Parts = ()) -> Any:
    """A part of a scene, which is at the place ``parts`` in it, with its functions loaded.

    Raises
    ------
    ModelError
        When one cannot be loaded.
    """

    def loaded(leaf: Any, where: Parts) -> Any:
        if not isinstance(leaf, CodeReference):
            return leaf
        try:
            return LoadedFunction(leaf, load_code(leaf))
        except ModelError as error:
            raise ModelError(f"{place(where)}: {error}") from error

    return mapped(value, loaded, parts)


def code_in(value: Any, parts: Parts = ()) -> Iterator[tuple[Parts, Registry | None, str]]:
    """What a part of a scene names and is not loaded: place, registry of a class, and name.

    A function has no registry; a class has not read its parameters.
    """
    for where, part in nodes(value, parts):
        if isinstance(part, CodeReference):
            yield where, None, part
        elif isinstance(part, UnloadedJoint):
            yield (*where, "kind"), JOINTS, part.kind
        elif isinstance(part, UnloadedControl):
            yield (*where, "kind"), CONTROLS, part.kind
        elif isinstance(part, ByName):
            for name, parameters in (part.model_extra or {}).items():
                if parameters is not None and not isinstance(parameters, BaseModel):
                    yield (*where, name), part.registry, name


def _code_of(scene: Scene) -> Iterator[tuple[Parts, Registry | None, str]]:
    return (code for part in PARTS for code in code_in(getattr(scene, part), (part,)))


def _location_fault(registry: Registry | None, name: str, folder: Path) -> str:
    """Why a file in a folder may not name this code; empty where it may."""
    if registry is None:
        return reference_fault(CodeReference(name), folder)
    return reference_fault(CodeReference(name), folder, "class") if is_reference(name) else ""


def _with_classes(scene: Scene) -> Scene:
    """The scene with its user classes loaded, which validate their parameters.

    Raises
    ------
    SceneError
        When some cannot be loaded, or refuse their parameters: each with its place.
    """
    classes: dict[tuple[str, str], type] = {}
    while unloaded := {
        (registry.sort, name): (parts, registry)
        for parts, registry, name in _code_of(scene)
        if registry is not None and (registry.sort, name) not in classes
    }:  # once more where parameters of a class name further ones
        faults = []
        for (sort, name), (parts, registry) in unloaded.items():
            try:
                classes[sort, name] = registry.load(name)
            except ModelError as error:
                faults.append(fault_at(parts, str(error)))
        if faults:
            raise SceneError(faults)
        tables = {part: _plain(getattr(scene, part)) for part in PARTS}
        scene = scene.revalidated({**dict(scene), **tables}, True, classes)
    return scene


def _plain(value: Any) -> Any:
    """A part of a scene as tables and lists, to be validated again."""
    if isinstance(value, BaseModel):
        return {key: _plain(item) for key, item in written(value).items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _without_functions(joint: Joint) -> Joint:
    """A joint without the events that functions tell: they do not come."""
    times = {key: getattr(joint, key) for key in ("from", "until")}
    known = {key: without_function(value) for key, value in times.items()}
    return joint if known == times else joint.model_copy(update=known)


def _without_contacts(joint: Joint) -> Joint:
    """A joint without its contacts that need code; nothing is left of a kind that needs it."""
    if not any(code_in(joint)):
        return joint
    contacts = tuple(
        contact.model_copy(update={"name": contact.name or f"contact {k + 1}"})
        for k, contact in enumerate(joint.contacts if isinstance(joint, ContactsJoint) else ())
        if not any(code_in(contact))
    )
    if contacts:
        return joint.model_copy(update={"contacts": contacts})
    frames = {name: value for name, value in written(joint).items() if name in Joint.model_fields}
    return UnloadedJoint(**frames)
