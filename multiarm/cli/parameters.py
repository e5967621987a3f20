"""The parameters of a part of a scene, as people read them: defaults, meanings and units.

They come from the part's model: a meaning is the class's documentation of an attribute, or the
field's description, and the unit is the text in brackets therein, ``[m]``.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Parameter:
    """A key that a scene may write: its default as it would be written, meaning and unit."""

    name: str
    default: str
    meaning: str
    unit: str


def parameters_of(model: Any) -> list[Parameter]:
    """The parameters of a model, such as a part of a scene, but its kind.

    Its own come first, then those of its bases.
    """
    documented = _documented(model)
    own = inspect.get_annotations(model)
    found = []
    for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in own):
        meaning, unit = _split(field.description or "")
        if not unit:
            meaning, unit = documented.get(name, (meaning, ""))
        if name != "kind":
            default = field.get_default(call_default_factory=True)
            written = "required" if field.is_required() else _written(default)
            found.append(Parameter(name, written, meaning, unit))
    return found


def _documented(model: Any) -> dict[str, tuple[str, str]]:
    """Meaning and unit of every attribute that a model or one of its bases documents."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(model.__mro__):
        _, _, section = inspect.cleandoc(base.__doc__ or "").partition("Attributes\n----------\n")
        _, *entries = re.split(r"(?m)^(\w+(?:, \w+)*) : ", section)
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
    units = list(re.finditer(r"\s*\[(m|rad|N|N m)\]", text))
    if len(units) != 1:
        return text, ""
    (unit,) = units
    return (text[: unit.start()] + text[unit.end() :]).lstrip("; "), unit[1]


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
