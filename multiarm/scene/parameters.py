"""The parameters of a part of a scene, as people read them: defaults, meanings and units.

They come from the part's model.  A meaning stands in one place: below the field or in the class's
documentation of its attributes, or in the field's description where a field is made of data.  The
unit is the text in brackets therein, ``[m]``.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from functools import cache
from textwrap import dedent
from typing import Any


@dataclass(frozen=True)
class Parameter:
    """A key that a scene may write: its default as it would be written, meaning and unit."""

    name: str
    default: str
    meaning: str
    unit: str


def parameters_of(model: Any) -> list[Parameter]:
    """The parameters of a part of a scene, without its kind.

    Those that the model itself declares come first, then those of its bases.
    """
    fields = inspect.get_annotations(model)
    parameters = []
    for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in fields):
        if name == "kind":
            continue
        default = field.get_default(call_default_factory=True)
        written = "required" if field.is_required() else written_value(default)
        parameters.append(Parameter(name, written, *_split(description_of(model, name))))
    return parameters


def description_of(model: Any, name: str) -> str:
    """The meaning of an attribute, with its unit; empty where there is none."""
    field = model.model_fields.get(name)
    described = None if field is None else field.description
    return described or _documented(model).get(name, "")


def brief_description(model: Any, name: str) -> str:
    """The first sentence of an attribute's meaning, as it stands within a message."""
    text = re.split(r"\.(?: |$)", description_of(model, name))[0]
    return text[:1].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text


def picture_of(model: Any) -> str:
    """A kind in everyday words: its ``picture``, or the first sentences of its documentation."""
    picture = getattr(model, "picture", "")
    return picture if isinstance(picture, str) and picture else summary_of(model)


def example_of(model: Any) -> str:
    """The lines of an example as a scene has them; empty where a kind gives none."""
    example_text = getattr(model, "example_text", None)
    if callable(example_text):
        return example_text()
    return dedent(getattr(model, "example", "")).strip("\n")


def summary_of(model: Any) -> str:
    """The first sentence or sentences of a class's own documentation."""
    return _plain(inspect.cleandoc(model.__doc__ or "").partition("\n\n")[0])


@cache
def _documented(model: Any) -> dict[str, str]:
    """The documentation of the attributes of a model and of its bases, by name."""
    from docstring_parser import parse_from_object

    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if inspect.get_annotations(base).keys() & model.model_fields.keys():
            for attribute in parse_from_object(base).params:
                names = attribute.arg_name.split(", ")
                texts.update(dict.fromkeys(names, _plain(attribute.description or "")))
    return texts


def _plain(text: str) -> str:
    """A text in one line without marks of reStructuredText."""
    return " ".join(re.sub(r":\w+:`~?([^`]*)`|``([^`]*)``", r"\1\2", text).split())


_UNIT = r"(?:(?:1|m|kg|rad|Hz|s|N)(?:[ /](?:m|s|rad)(?:\^\d)?|\^\d)*)"


def _split(text: str) -> tuple[str, str]:
    """Meaning and unit of a text with one unit in brackets; other texts stay as they are."""
    units = list(re.finditer(rf"\s*\[({_UNIT})\]", text))
    alone = re.fullmatch(rf"in ({_UNIT})", text)
    if alone is not None:
        return "", alone[1]
    if len(units) != 1:
        return text, ""
    (unit,) = units
    meaning = (text[: unit.start()] + text[unit.end() :]).lstrip(";,. ")
    return meaning, unit[1]


def written_value(value: Any) -> str:
    """A value as a scene would write it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(written_value(item) for item in value)}]"
    if hasattr(value, "model_fields_set"):  # a pose that turns and moves nothing; a table
        entries = {name: item for name, item in value if name in value.model_fields_set}
        return written_value(entries) if entries else "identity"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {written_value(item)}' for name, item in value.items())}}}"
    return str(value)
