"""From Pydantic's findings to sentences that a scene's author can act on.

Pydantic reports a location (``("joints", 1, "ball", "size")``, where ``"ball"`` is the branch of
a union, not a key) and a type of error. Here the location becomes ``$.joints[1].size`` and the
type a sentence with the offending value, the alternatives and the remedy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from multiarm.scene.words import listed, place, shown, unknown

__all__ = ["explain", "sentences"]

# How the keys of some tables are called, in the singular and the plural.
_KEY_NOUNS = {"EffectsSpec": ("effect", "effects"), "Shape": ("shape", "shapes")}
_KIND_NOUNS = {"joints": "joint kind", "control": "control kind"}


def explain(error: ValidationError, root: type[BaseModel], root_name: str = "$") -> list[str]:
    """Return every fault of ``error`` as one complete line.

    Parameters
    ----------
    error : ValidationError
        What Pydantic found in data for ``root``.
    root : type
        The model that was validated, from which known keys and kinds are told.
    root_name : str
        How the root is called in the places, ``$`` for a scene.

    Returns
    -------
    list of str
        In the order of the scene, without repetitions.
    """
    lines = [f"{place(parts, root_name)}: {text}" for parts, text, _ in sentences(error, root)]
    return list(dict.fromkeys(lines))


def sentences(
    error: ValidationError, root: type[BaseModel]
) -> list[tuple[list[str | int], str, Any]]:
    """Return place below ``root``, sentence and offending value of every fault."""
    found = []
    for details in error.errors(include_url=False):
        parts, owner, models = _walk(details["loc"], root)
        text = _sentence(details, parts, owner, models)
        tail = ["kind"] if details["type"] == "union_tag_invalid" else []
        found.append(([*parts, *tail], text, details["input"]))
    return found


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
        return unknown("value", value, _choices(owner, parts), "choices")
    if kind == "greater_than":
        return f"must be greater than {context['gt']:g}, got {shown(value)}"
    if kind == "greater_than_equal":
        return f"must be at least {context['ge']:g}, got {shown(value)}"
    return f"{_EXPECTED.get(kind, details['msg'])}, got {shown(value)}"


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


def _missing(part: str | int, owner: type[BaseModel]) -> str:
    if isinstance(part, int):
        return "is missing: the list is too short"
    field = owner.model_fields.get(part)
    meaning = f" ({field.description})" if field is not None and field.description else ""
    return f"is missing{meaning}"


def _walk(
    loc: Sequence[str | int], root: type[BaseModel]
) -> tuple[list[str | int], type[BaseModel], list[type[BaseModel]]]:
    """Return the location without union branches, the model of its last key, what may follow."""
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
            models = _models_in(annotation)
            inside_container = bool(models) and _has_container(annotation)
        parts.append(part)
    return parts, owner, models


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


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
    """Return the values allowed at ``parts``, the last named key of ``owner`` on the way."""
    names = [part for part in parts if isinstance(part, str) and part in owner.model_fields]
    return _literals(owner.model_fields[names[-1]].annotation) if names else []


def _literals(annotation: Any) -> list[str]:
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for part in get_args(annotation) for value in _literals(part)]
