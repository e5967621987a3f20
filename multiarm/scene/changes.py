"""Values of a scene by their paths, and its tables with some of them changed.

A path is written as messages write it, with or without the ``$.`` that stands for the scene:

    object.mass    arms.left.base.xyz    joints[1].at.xyz[2]    arms['my arm'].posture

:meth:`multiarm.Scene.replace` validates what :func:`with_changes` makes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from multiarm.errors import Fault, SceneError
from multiarm.scene.faults import Parts, fault_at, listed, place, shown, unknown
from multiarm.scene.run import STEPS_CHOSEN_BY
from multiarm.scene.spec import written

# A key, a key in quotes, a number in a list.
_PART = re.compile(r"""\.?([^\s.\[\]'"]+)|\['([^']+)'\]|\["([^"]+)"\]|\[(\d+)\]""")


@dataclass(frozen=True)
class _New:
    """A value that takes the place of another."""

    value: Any


def parse_path(text: str) -> Parts:
    """The keys and numbers of a path; raises a SceneError when it is none."""
    if not isinstance(text, str):
        raise _error_at((), f"a path is text, such as 'object.mass', got {shown(text)}")
    keys = text.removeprefix("$").removeprefix(".") if text.startswith("$") else text
    parts: list[str | int] = []
    at = 0
    while at < len(keys):
        match = _PART.match(keys, at)
        if match is None or (match[1] and (match[0][0] == ".") != bool(parts)):
            break
        parts.append(int(match[4]) if match[4] else match[1] or match[2] or match[3])
        at = match.end()
    if at < len(keys) or not parts:
        raise _error_at(
            (), f"{text!r} is no path; write one as 'object.mass', 'joints[1].at.xyz', "
            "\"arms['my arm'].base\""
        )  # fmt: skip
    return tuple(parts)


def value_at(scene: BaseModel, path: str) -> Any:
    """The value at a path.

    Raises
    ------
    SceneError
        When there is none, with the alternatives.
    """
    value: Any = scene
    parts = parse_path(path)
    for k, part in enumerate(parts):
        value = _below(value, part, parts[:k])
    return value


def with_changes(
    scene: BaseModel, changes: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Fault]]:
    """The tables of a scene with other values at some paths, and the faults of the paths."""
    faults: list[Fault] = []
    tree = _tree(changes, faults)
    data = _applied(scene, tree, (), faults)
    if isinstance(tree.get("run"), dict) and isinstance(data.get("run"), dict):
        data["run"] = _one_choice(data["run"], tree["run"])
    return data, faults


def _tree(changes: Mapping[str, Any], faults: list[Fault]) -> dict[str | int, Any]:
    """The changes as nested tables, by the parts of their paths, with :class:`_New` at the ends."""
    tree: dict[str | int, Any] = {}
    for path, value in changes.items():
        try:
            *way, last = parts = parse_path(path)
            branch = tree
            for k, part in enumerate(way):
                branch = branch.setdefault(part, {})
                if isinstance(branch, _New):
                    raise _error_at(parts, f"lies in {place(parts[: k + 1])}, which is changed too")
            if last in branch:
                raise _error_at(
                    parts, "is changed twice, or a part of it is; keep one of the changes"
                )
            branch[last] = _New(value)
        except SceneError as error:
            faults += error.faults
    return tree


def _applied(value: Any, tree: Any, here: Parts, faults: list[Fault]) -> Any:
    """The value with some changes below it, as plain tables and lists where they lead through."""
    if isinstance(tree, _New):
        return tree.value
    entries = {}
    for part, branch in tree.items():
        try:
            leaf = isinstance(branch, _New)
            below = _applied(_below(value, part, here, leaf), branch, (*here, part), faults)
            if leaf or below is not None:  # nothing is made on the way of a path with a fault
                entries[part] = below
        except SceneError as error:
            faults += error.faults
    if isinstance(value, (tuple, list)):
        return [entries.get(k, old) for k, old in enumerate(value)]
    return {**written(value), **entries} if entries or value is not None else None


def _below(value: Any, part: str | int, here: Parts, leaf: bool = False) -> Any:
    """The value at a part of a path; None if an optional part is missing.

    A ``leaf`` is going to be replaced: a table may get a new entry, which the scene's own check
    judges.
    """
    if isinstance(value, (tuple, list)):
        if isinstance(part, int) and part < len(value):
            return value[part]
        raise _error_at((*here, part), f"{place(here)} is a list with {_entries(len(value))}")
    if value is None and isinstance(part, str):
        return None
    if not isinstance(value, (BaseModel, Mapping)):
        held = "is not given" if value is None else f"is {shown(value)}"
        raise _error_at(here, f"{held}: nothing is below it; give {place(here)[2:]!r} as a whole")
    keys = _keys(value)
    if isinstance(part, int):
        raise _error_at((*here, part), f"{place(here)} is no list; its keys are {listed(keys)}")
    if part not in keys and not leaf:
        raise _error_at((*here, part), unknown("key", part, keys))
    return getattr(value, part, None) if isinstance(value, BaseModel) else value.get(part)


def _keys(value: BaseModel | Mapping) -> list[str]:
    if isinstance(value, BaseModel):
        return [*type(value).model_fields, *(value.model_extra or {})]
    return list(value)


def _error_at(at: Parts, text: str) -> SceneError:
    return SceneError([fault_at(at, text)])


def _entries(count: int) -> str:
    return "no entries" if count == 0 else f"entries [0] to [{count - 1}]"


def _one_choice(run: dict[str, Any], named: Iterable[str | int]) -> dict[str, Any]:
    """Settings of a run; a change that chooses the steps replaces the scene's choice."""
    if not set(STEPS_CHOSEN_BY).intersection(named):
        return run
    return {key: v for key, v in run.items() if key not in STEPS_CHOSEN_BY or key in named}
