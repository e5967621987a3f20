"""The parameters of a part of a scene, read off its schema: names, defaults, meanings, units.

A meaning is what the class documents of an attribute, or the field's own description; the unit is
the text in brackets therein, ``[m]``.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from typing import Any

__all__ = ["Parameter", "parameters_of"]

_ENTRY = re.compile(r"^(\w+(?:, \w+)*) : ", re.MULTILINE)
_UNIT = re.compile(r"\s*\[(m|rad|N|N m)\]")


@dataclass(frozen=True)
class Parameter:
    """A key that a scene may write: its default as it would be written, meaning and unit."""

    name: str
    default: str
    meaning: str
    unit: str


def parameters_of(model: Any) -> list[Parameter]:
    """The parameters of a model of :mod:`multiarm.scene`: its own, then those of its bases.

    The name of the kind is none of them.
    """
    documented = _documented(model)
    own = inspect.get_annotations(model)
    found = []
    for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in own):
        meaning, unit = _split(field.description or "")
        if not unit:
            meaning, unit = documented.get(name, (meaning, ""))
        if name != "kind":
            found.append(Parameter(name, _default(field), meaning, unit))
    return found


def _documented(model: Any) -> dict[str, tuple[str, str]]:
    """Meaning and unit of every attribute that a model or one of its bases documents."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(model.__mro__):
        _, _, section = inspect.cleandoc(base.__doc__ or "").partition("Attributes\n----------\n")
        _, *entries = _ENTRY.split(section)
        for names, text in zip(entries[::2], entries[1::2], strict=True):
            _, _, body = text.partition("\n")
            body = " ".join(body.split())
            # A unit within a text about several attributes need not be that of all.
            shared = "," in names and not body.startswith("[")
            for name in names.split(", "):
                found[name] = (body, "") if shared else _split(body)
    return found


def _split(text: str) -> tuple[str, str]:
    """Meaning and unit of a text with one unit in brackets; other texts stay as they are."""
    units = list(_UNIT.finditer(text))
    if len(units) != 1:
        return text, ""
    (unit,) = units
    return (text[: unit.start()] + text[unit.end() :]).lstrip("; "), unit[1]


def _default(field: Any) -> str:
    default = field.get_default(call_default_factory=True)
    return "required" if field.is_required() else _written(default)


def _written(value: Any) -> str:
    """A value as a scene would write it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_written(item) for item in value)}]"
    return "identity" if hasattr(value, "model_fields_set") else str(value)  # a pose, a word
