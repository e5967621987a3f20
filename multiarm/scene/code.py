"""The code that a scene names: told before it is loaded, loaded when allowed, left out of a look.

A scene can name functions (surfaces, wrenches) and effects of installed packages.  Reading it loads
none of them.  :func:`with_code` loads them for a system that is to run; :func:`without_code` gives
what can be looked at without them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from multiarm.errors import ModelError, SceneError
from multiarm.scene.functions import function_references, parts_of
from multiarm.scene.own_effects import known_effect, offered_words
from multiarm.scene.schema import Scene
from multiarm.scene.user_code import FunctionReference, LoadedFunction, load_function
from multiarm.scene.values import Parts
from multiarm.scene.words import place

__all__ = [
    "NamedCode",
    "loaded_functions",
    "named_code",
    "refuse_code",
    "with_code",
    "without_code",
]


@dataclass(frozen=True)
class NamedCode:
    """Code that is named somewhere.

    Attributes
    ----------
    place : str
        Where it is named, such as ``$.effects.external_wrenches[0].function``.
    what : str
        What it is: which function of which file or module, which effect of which package.
    arm : str or None
        Whose joint needs it.
    """

    place: str
    what: str
    arm: str | None = None

    @classmethod
    def function(cls, parts: Parts, reference: FunctionReference, arm: str | None = None):
        """A function that is named at a place."""
        return cls(place(parts), f"the function {reference.name!r} of {reference.home}", arm)

    @classmethod
    def effect(cls, parts: Parts, name: str) -> NamedCode:
        """An effect of an installed package that is named at a place."""
        return cls(place(parts), f"the effect {name!r} of {offered_words(name)}")


def named_code(scene: Scene) -> list[NamedCode]:
    """The code that a scene names and that is not loaded yet, in the order of the scene."""
    found = []
    for k, joint in enumerate(scene.joints):
        for parts, reference in function_references(joint, ("joints", k)):
            found.append(NamedCode.function(parts, reference, joint.arm))
    for parts, reference in function_references(scene.effects.external_wrenches, _WRENCHES):
        found.append(NamedCode.function(parts, reference))
    found += [
        NamedCode.effect(("effects", name), name)
        for name in _unread_effects(scene)
        if known_effect(name) is None
    ]
    return found


def refuse_code(named: Iterable[NamedCode]) -> None:
    """Refuse to load any code.

    Raises
    ------
    SceneError
        When some is named: each with its place, and how it is allowed.
    """
    faults = [
        f"{one.place}: {one.what} is not loaded, since code is not allowed; if you trust its "
        "author, allow it (`code=True` in Python, no `--no-code` on the command line)"
        for one in named
    ]
    if faults:
        raise SceneError(faults)


def with_code(scene: Scene, allowed: bool | None = None) -> Scene:
    """The scene with its functions loaded in place of their names, and its effects validated.

    Parameters
    ----------
    scene : Scene
    allowed : bool, optional
        Whether code may be loaded; as the scene was read, when left out.

    Raises
    ------
    SceneError
        When code is named and not allowed, or a package refuses the parameters of its effect.
    ModelError
        When a function cannot be loaded.
    """
    named, unread = named_code(scene), [*_unread_effects(scene)]
    if not (scene.may_load_code if allowed is None else allowed):
        refuse_code(named)
    if named:
        joints = tuple(loaded_functions(one, ("joints", k)) for k, one in enumerate(scene.joints))
        wrenches = loaded_functions(scene.effects.external_wrenches, _WRENCHES)
        effects = scene.effects.model_copy(update={"external_wrenches": wrenches})
        scene = scene.model_copy(update={"joints": joints, "effects": effects})
    # a scene made in Python, which this is like, loads the effects that it names
    return scene.replace(effects=scene.effects.named) if unread else scene


def without_code(scene: Scene) -> tuple[Scene, list[NamedCode]]:
    """The scene without what needs code that is not loaded, and that code.

    Left out are wrenches by functions and effects of packages, and of joints the contacts on
    surfaces by functions; the other contacts keep their names.
    """
    left = named_code(scene)
    unread = [name for name, value in _own_effects(scene) if _is_text(value)]
    if not left and not unread:
        return scene, left
    wrenches = scene.effects.external_wrenches or ()
    kept = tuple(wrench for wrench in wrenches if not any(function_references(wrench)))
    effects = scene.effects.model_copy(
        update={"external_wrenches": kept or None, **dict.fromkeys(unread)}
    )
    joints = tuple(_without_contacts(joint) for joint in scene.joints)
    return scene.model_copy(update={"joints": joints, "effects": effects}), left


def loaded_functions(value: Any, parts: Parts = ()) -> Any:
    """A part of a scene, which is at a place in it, with its functions loaded.

    Raises
    ------
    ModelError
        When one cannot be loaded.
    """
    if isinstance(value, FunctionReference):
        try:
            return LoadedFunction(value, load_function(value))
        except ModelError as error:
            raise ModelError(f"{place(parts)}: {error}") from error
    made: dict[Any, Any] = {
        key: loaded_functions(item, (*parts, key)) for key, item in parts_of(value)
    }
    if all(made[key] is item for key, item in parts_of(value)):
        return value
    return value.model_copy(update=made) if isinstance(value, BaseModel) else tuple(made.values())


_WRENCHES = ("effects", "external_wrenches")


def _own_effects(scene: Scene) -> Iterator[tuple[str, Any]]:
    yield from (scene.effects.model_extra or {}).items()


def _is_text(parameters: Any) -> bool:
    """Whether the parameters of an effect have not been validated by it."""
    return parameters is not None and not isinstance(parameters, BaseModel)


def _unread_effects(scene: Scene) -> Iterator[str]:
    """Effects that can be had, whose parameters have not been validated."""
    for name, parameters in _own_effects(scene):
        if _is_text(parameters) and (known_effect(name) or offered_words(name)):
            yield name


def _without_contacts(joint: Any) -> Any:
    """A joint without its contacts on surfaces that need functions."""
    if not any(function_references(joint)):
        return joint
    contacts = tuple(
        contact.model_copy(update={"name": contact.name or f"contact {k + 1}"})
        for k, contact in enumerate(joint.contacts)
        if not any(function_references(contact))
    )
    return joint.model_copy(update={"contacts": contacts})
