"""User effects: found by the name under which a scene has them.

A name under ``effects`` that is none of ours is looked for among the classes that were handed to
:func:`multiarm.register_effect`, and then among the entry points ``multiarm.effects`` of the
installed packages,

.. code-block:: toml

    [project.entry-points."multiarm.effects"]
    magnet = "my_package.magnet:Magnet"

A package is imported only for scenes that name its effect: when one is made in Python, and when one
that was read from a file is compiled.  The class's ``Spec`` then validates the parameters, and
every fault has its place, as for our own effects.  What the class must offer says
:class:`multiarm.effects.effect.Effect`; here only its name and its ``Spec`` matter.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from importlib import metadata
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError, ValidationInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from multiarm.errors import USER_FAULTS, ModelError
from multiarm.scene.faults import fault, sentences, unknown
from multiarm.scene.values import Spec

_GROUP = "multiarm.effects"  # of the entry points
_REGISTERED: dict[str, type] = {}
_LOADED: dict[str, type] = {}  # of entry points


class OwnSpec(Spec):
    """Parameters of a user effect: keys that are not declared, NaN and infinity are refused."""

    model_config = ConfigDict(allow_inf_nan=False)


def add_effect(effect: type, reserved: Collection[str]) -> None:
    """Let scenes name a class of effect, by a name that is none of the reserved ones.

    Raises
    ------
    ModelError
        It lacks something, or another effect has its name.
    """
    _check(effect, "cannot be registered")
    name = effect.name  # type: ignore[attr-defined]
    if name in reserved:
        raise ModelError(f"effect {name!r}: multiarm itself has one of that name; choose another")
    taken = _REGISTERED.get(name)
    if taken is not None and _path(taken) != _path(effect):
        raise ModelError(f"effect {name!r}: {_path(taken)} is registered under that name already")
    for point in _entry_points(name):
        if point.value.replace(" ", "") != _path(effect):
            raise ModelError(
                f"effect {name!r}: {_offered(point)} has that name already; choose another one"
            )
    _REGISTERED[name] = effect


def known_effect(name: str) -> type | None:
    """The class of an effect that was registered or loaded before; None where none was."""
    return _REGISTERED.get(name) or _LOADED.get(name)


def offered_words(name: str) -> str:
    """Which installed packages offer an effect of a name; empty where none does."""
    return " and ".join(sorted({_offered(point) for point in _entry_points(name)}))


def find_effect(name: str) -> type | None:
    """The class of an effect; None where there is none of that name.

    Raises
    ------
    ModelError
        Its package is broken, or several have one.
    """
    known = known_effect(name)
    if known is not None:
        return known
    points = {point.value: point for point in _entry_points(name)}
    if not points:
        return None
    if len(points) > 1:
        offers = " and ".join(_offered(point) for point in points.values())
        raise ModelError(f"effect {name!r} is ambiguous: {offers} have that name; remove one")
    (point,) = points.values()
    try:
        effect = point.load()
    except USER_FAULTS as error:
        raise ModelError(
            f"effect {name!r}: {_offered(point)} cannot be loaded, {type(error).__name__}: {error}"
        ) from error
    _check(effect, f"of {_offered(point)} cannot be used", name)
    _LOADED[name] = effect
    return effect


def own_effect_names() -> list[str]:
    """Names of all user effects that are registered or installed."""
    return sorted({*_REGISTERED, *(point.name for point in metadata.entry_points(group=_GROUP))})


def registered_effects() -> tuple[type, ...]:
    """The classes that were registered in this process; another process has its own."""
    return tuple(_REGISTERED.values())


@dataclass(frozen=True)
class Named:
    """An entry under ``effects`` that is no field: its name, its value, the built-in names."""

    name: str
    value: Any
    ours: Collection[str]


def _read(entry: Any, info: ValidationInfo) -> Any:
    """The validated parameters of an effect; None where a scene leaves it out by ``name: null``.

    A scene that is read from a file loads no package, and a stored one does without it: the
    parameters stay as they are, see :mod:`multiarm.scene.loading`.
    """
    if not isinstance(entry, Named):
        return entry
    context = info.context or {}
    if not context.get("load", True) and not known_effect(entry.name) and offered_words(entry.name):
        return entry.value
    try:
        effect = find_effect(entry.name)
    except ModelError as error:
        raise fault(str(error)) from None
    if effect is None:
        if context.get("stored"):
            return entry.value
        text = unknown("effect", entry.name, [*entry.ours, *own_effect_names()], "effects")
        raise fault(f"{text}; effects of your own need multiarm.register_effect, or their package")
    return None if entry.value is None else _validated(effect, entry.value)


def _validated(effect: Any, value: Any) -> Any:
    """The scene's text read by an effect's ``Spec``, every fault at its place."""
    try:
        return TypeAdapter(effect.Spec).validate_python(value)
    except ValidationError as error:
        details = [
            InitErrorDetails(type=fault(text), loc=tuple(parts), input=given)
            for parts, text, given in sentences(error, effect.Spec)
        ]
        raise ValidationError.from_exception_data(effect.name, details) from None
    except PydanticCustomError:
        raise
    except USER_FAULTS as error:
        raise fault(
            f"the Spec of effect {effect.name!r} raised {type(error).__name__}: {error}"
        ) from None


OwnEffect = Annotated[Any, BeforeValidator(_read)]
"""An entry under ``effects`` that is no field; :class:`Named` before it is validated."""


def _check(effect: Any, trouble: str, name: str | None = None) -> None:
    """Raise unless this is an effect with the registered name."""
    lacks = getattr(effect, "lacks", None)
    if not isinstance(effect, type) or lacks is None:
        raise ModelError(f"{effect!r} {trouble}: it is no subclass of multiarm.Effect")
    reason = lacks()
    if not reason and name is not None and effect.name != name:  # type: ignore[attr-defined]
        reason = f"its name is {effect.name!r}, not {name!r}"  # type: ignore[attr-defined]
    if reason:
        raise ModelError(f"{_path(effect)} {trouble}: {reason}")


def _entry_points(name: str) -> list[metadata.EntryPoint]:
    return list(metadata.entry_points(group=_GROUP, name=name))


def _offered(point: metadata.EntryPoint) -> str:
    package = "an installed package" if point.dist is None else f"package {point.dist.name!r}"
    return f"{package} ({point.value})"


def _path(effect: type) -> str:
    return f"{effect.__module__}:{effect.__qualname__}"
