"""Faults of a scene as sentences: place, problem, alternatives, remedy.

A message about a name offers the names that exist, the most similar first, so that a typing error
is corrected without opening the manual.  Pydantic reports a location (``("joints", 1, "ball",
"size")``, where ``"ball"`` is the branch of a union, not a key) and a type of error.  Here the
location becomes ``$.joints[1].size`` and the type a sentence.
"""

from __future__ import annotations

import difflib
import math
import os
import reprlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from multiarm.errors import Fault
from multiarm.notation import count_of
from multiarm.scene.parameters import brief_description

Parts = tuple[str | int, ...]
"""Keys and list positions that lead to a value."""
Faults = list[tuple[Parts, str]]
"""Pairs of a place, relative to that of a value, and the fault there."""

_MAX_LISTED = 12
_SIMILAR = 0.6  # ratio of difflib above which two names count as one mistyped

_MAX_PATH, _MAX_NAME = 4095, 255  # bytes, of Linux
_MAX_FAULTS = 100  # of one text that are looked at
_MAX_KEY = 60  # characters of a key, or of a name that is listed


class _Repr(reprlib.Repr):
    """Short texts of values of any size."""

    def repr_int(self, value: int, level: int) -> str:
        """Python refuses to print very long integers."""
        digits = int(value.bit_length() * math.log10(2.0)) + 1
        return repr(value) if digits <= self.maxlong else f"an integer of {digits:,} digits"


_repr = _Repr()
_repr.maxstring = _repr.maxother = 60
_repr.maxlist = _repr.maxtuple = 8
_repr.maxlevel = 3


def invalid(message: str) -> PydanticCustomError:
    """The error that a validator raises; a user reads ``message`` as it is."""
    return PydanticCustomError("fault", "{message}", {"message": message})


def shown(value: object) -> str:
    """A short text of ``value`` for use inside a message."""
    if hasattr(value, "tolist"):  # an array, whose text may have many lines
        value = value.tolist()
    return _repr.repr(list(value) if isinstance(value, tuple) else value)


def listed(names: Iterable[str], similar_to: str | None = None) -> str:
    """``'a', 'b', 'c'``, most similar first, shortened when there are very many."""
    names = list(names)
    if not names:
        return "(none)"
    if similar_to is not None:
        names.sort(key=lambda name: -_similarity(name, similar_to))
    return counted([*map(shown, names)], _MAX_LISTED)


def counted(texts: Sequence[str], most: int, separator: str = ", ") -> str:
    """The first ``most`` texts, and how many more there are."""
    text = separator.join(texts[:most])
    return text if len(texts) <= most else f"{text} and {len(texts) - most} more"


# What lists the names of a sort, with what they mean.
_COMMANDS = {
    "robot": "multiarm robots",
    "joint kind": "multiarm joints",
    "surface": "multiarm joints surfaces",
    "shape": "multiarm shapes",
    "control kind": "multiarm controls",
    "effect": "multiarm effects --list",
    "method": "multiarm methods",
    "stabilization": "multiarm methods stabilizations",
    "command": "multiarm --help",
}


def unknown(
    noun: str,
    value: object,
    known: Iterable[str],
    plural: str | None = None,
    command: str | None = None,
) -> str:
    """``unknown arm 'rigth'; did you mean 'right'? arms are 'right', 'left'``.

    It ends with the command that lists them all, where there is one for the noun, or is given.
    """
    known = list(known)
    plural = plural or f"{noun}s"
    text = f"unknown {noun} {shown(value)}"
    if not known:
        return f"{text}; there are no {plural}"
    close = []
    if isinstance(value, str):
        value = value[:_MAX_KEY]
        close = difflib.get_close_matches(value, known, 1, _SIMILAR)
    hint = f"did you mean {close[0]!r}? " if close else ""
    text += f"; {hint}{plural} are {listed(known, similar_to=str(value) if close else None)}"
    command = command or _COMMANDS.get(noun)
    return f"{text}; '{command}' shows them all" if command else text


def path_fault(path: str | Path) -> str:
    """Why no file can have this path, with ``~`` for a home; empty where one can."""
    text = str(path)
    try:
        encoded = os.fsencode(Path(text).expanduser())
    except UnicodeEncodeError:
        return f"{shown(text)} cannot be the path of a file: it has characters that none has"
    except RuntimeError:
        return f"{shown(text)} cannot be the path of a file: there is no such home folder"
    if not text or "\0" in text:
        what = "it is empty" if not text else "it has a NUL"
        return f"{shown(text)} cannot be the path of a file: {what}"
    if len(encoded) > _MAX_PATH or any(len(part) > _MAX_NAME for part in encoded.split(b"/")):
        return (
            f"{shown(text)} cannot be the path of a file: names have at most {_MAX_NAME} bytes, "
            f"paths {_MAX_PATH:,}"
        )
    return ""


def place(parts: Iterable[str | int], root: str = "$") -> str:
    """A path such as ``$.joints[1].arm`` or ``$.arms['my arm'].tip``."""
    text = root
    for part in parts:
        named = isinstance(part, str) and part.isidentifier() and len(part) <= _MAX_KEY
        text += f".{part}" if named else f"[{shown(part)}]"
    return text


def fault_at(parts: Iterable[str | int], problem: str, root: str = "$") -> Fault:
    """A problem at the place to which keys and list positions lead from the root."""
    parts = tuple(parts)
    return Fault(problem, place(parts, root), parts)


def below(where: Parts, faults: Faults) -> Faults:
    """Faults of a part, which is at the place ``where`` in its owner."""
    return [((*where, *further), text) for further, text in faults]


def explain(error: ValidationError, root: type[BaseModel], root_name: str = "$") -> list[Fault]:
    """All faults of data for the model ``root``, each once, in their order."""
    faults = [fault_at(parts, problem, root_name) for parts, problem, _ in sentences(error, root)]
    left_out = error.error_count() - _MAX_FAULTS
    if left_out > 0:
        faults.append(fault_at((), f"and {count_of(left_out, 'more fault')}", root_name))
    return list(dict.fromkeys(faults))


def sentences(
    error: ValidationError, root: type[BaseModel]
) -> list[tuple[list[str | int], str, Any]]:
    """Place below ``root``, sentence and offending value of every fault, of the first hundred."""
    faults = []
    for details in error.errors(include_url=False)[:_MAX_FAULTS]:
        parts, owner, models = _walk(details["loc"], root)
        text = _sentence(details, parts, owner, models)
        tail = ["kind"] if details["type"] == "union_tag_invalid" else []
        faults.append(([*parts, *tail], text, details["input"]))
    return faults


# Names of the keys of some tables, in the singular and the plural.
_KEY_NOUNS = {"EffectsSpec": ("effect", "effects"), "Shape": ("shape", "shapes")}
_KIND_NOUNS = {"joints": "joint kind", "control": "control kind"}
# What the values of some keys are called.
_CHOICE_NOUNS = {"integrator": "method", "stabilization": "stabilization"}
_EXPECTED = {
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "finite_number": "must be finite",
    "path_type": "must be a path",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "dict_type": "must be a table of 'name: value' lines",
    "model_type": "must be a table of 'key: value' lines",
    "model_attributes_type": "must be a table of 'key: value' lines",
}


def _sentence(
    details: ErrorDetails,
    parts: list[str | int],
    owner: type[BaseModel],
    models: list[type[BaseModel]],
) -> str:
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    if kind == "fault":
        return details["msg"]
    if kind == "missing":
        return _missing(parts[-1], owner)
    if kind == "extra_forbidden":
        noun, plural = _KEY_NOUNS.get(owner.__name__, ("key", "keys"))
        return unknown(noun, parts[-1], owner.model_fields, plural)
    if kind == "union_tag_not_found":
        return f"'kind' is missing; kinds are {listed(_kinds(models))}"
    if kind == "union_tag_invalid":
        group = next(part for part in reversed(parts) if isinstance(part, str))
        return unknown(_KIND_NOUNS.get(group, "kind"), context["tag"], _kinds(models), "kinds")
    if kind == "literal_error":
        key = next((part for part in reversed(parts) if part != "kind"), None)
        noun = _CHOICE_NOUNS.get(str(key), "value")
        return unknown(noun, value, _choices(owner, parts), "choices" if noun == "value" else None)
    if kind == "greater_than":
        return f"must be greater than {context['gt']:g}, got {shown(value)}"
    if kind == "greater_than_equal":
        return f"must be at least {context['ge']:g}, got {shown(value)}"
    if kind == "less_than_equal":
        return f"must be at most {context['le']:g}, got {shown(value)}"
    return f"{_EXPECTED.get(kind, details['msg'])}, got {shown(value)}"


def _missing(part: str | int, owner: type[BaseModel]) -> str:
    if isinstance(part, int):
        return "is missing: the list is too short"
    meaning = brief_description(owner, part)
    return f"is missing ({meaning})" if meaning else "is missing"


def _walk(
    loc: Sequence[str | int], root: type[BaseModel]
) -> tuple[list[str | int], type[BaseModel], list[type[BaseModel]]]:
    """The location without union branches, the model of its last key, and the models below it."""
    parts: list[str | int] = []
    owner, models, inside_container = root, [root], False
    for part in loc:
        if part == "[key]":
            continue
        if inside_container:
            inside_container = False
        elif len(models) > 1:  # a branch of a union: says which model, is no key
            models = [model for model in models if _kind_of(model) == part]
            continue
        elif models:
            owner = models[0]
            field = owner.model_fields.get(str(part))
            annotation = None if field is None else field.annotation
            models = models_in(annotation)
            inside_container = bool(models) and _has_container(annotation)
        parts.append(part)
    return parts, owner, models


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """The models that a field's annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_in(part)]


def _has_container(annotation: Any) -> bool:
    if get_origin(annotation) in (dict, list, tuple):
        return True
    return any(_has_container(part) for part in get_args(annotation))


def _kinds(models: list[type[BaseModel]]) -> list[str]:
    return [kind for kind in map(_kind_of, models) if kind is not None]


def _kind_of(model: type[BaseModel]) -> str | None:
    field = model.model_fields.get("kind")
    return None if field is None else field.default


def _choices(owner: type[BaseModel], parts: list[str | int]) -> list[str]:
    """The values allowed at ``parts``, the last named key of ``owner`` on the way."""
    names = [part for part in parts if isinstance(part, str) and part in owner.model_fields]
    return _literals(owner.model_fields[names[-1]].annotation) if names else []


def _literals(annotation: Any) -> list[str]:
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for part in get_args(annotation) for value in _literals(part)]


def _similarity(name: str, second: str) -> float:
    return difflib.SequenceMatcher(None, name.lower(), second.lower()).ratio()
