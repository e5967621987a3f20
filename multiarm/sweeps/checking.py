"""Checks of a sweep against its scene: unknown paths, and values that make no valid scene.

Every fault is reported at its place in the sweep, with the scene's message.  Scenes are made from
the first values of all axes, from the last ones, and from each axis's values with the first ones of
all other axes; of long axes only some values are tried.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiarm.errors import Fault, MultiarmError, SceneError
from multiarm.scene import REGISTRIES, NamedCode, Scene, parse_path, value_at
from multiarm.scene.code import (
    CodeReference,
    function_references,
    load_function,
    located,
    reference_fault,
)
from multiarm.scene.faults import Parts, fault_at, place, shown
from multiarm.sweeps.axes import Axis

if TYPE_CHECKING:
    from multiarm.sweeps.spec import SweepSpec

__all__ = ["axis_faults", "axis_words", "quantity_faults", "sweep_code", "value_faults", "words"]

# A value that names a function; an address such as package:// has no name after the colon.
_FUNCTION = re.compile(r"[^:\s][^\n]*:[A-Za-z_][\w.]*")

TRIED = 24
"""Values of an axis that are tried, at most."""
TAILS = (0.5, 0.001, 0.999)
"""Quantiles of a drawn axis that are tried."""
MOST_RUNS = 1_000_000
"""Of one sweep."""


def axis_faults(spec: SweepSpec) -> list[Fault]:
    """Faults of the axes that do not depend on the scene."""
    faults = []
    for axis in spec.axes:
        faults += [fault_at(("over", axis.written), problem) for problem in _axis_problems(axis)]
    paths = [path for axis in spec.axes for path in axis.paths]
    for path in sorted({path for path in paths if paths.count(path) > 1}):
        faults.append(fault_at(("over", path), "stands twice in the sweep; keep one of the two"))
    steps = [axis for axis in spec.axes if not axis.drawn]
    if spec.combine == "zip" and len({axis.count for axis in steps}) > 1:
        counts = ", ".join(f"{axis.count} of {axis.written}" for axis in steps)
        problem = f"'zip' needs as many values of every path, there are {counts}"
        faults.append(fault_at(("combine",), problem))
    if spec.repeat > 1 and len(steps) == len(spec.axes):
        problem = (
            f"{spec.repeat} runs of each point would be the same run, for no path is drawn at "
            "random; leave it out, or draw one, such as (uniform: [0, 1])"
        )
        faults.append(fault_at(("repeat",), problem))
    elif spec.repeat == 1 and spec.sampling != "random":
        problem = (
            f"{spec.sampling!r} spreads the runs of one point of the grid, and there is one; set "
            "their number with 'repeat'"
        )
        faults.append(fault_at(("sampling",), problem))
    count = spec.repeat
    for axis in steps[:1] if spec.combine == "zip" else steps:
        count *= axis.count
    if count > MOST_RUNS:
        problem = f"makes {count:,} runs; at most {MOST_RUNS:,} are possible"
        faults.append(fault_at(("over",), problem))
    return faults


def quantity_faults(spec: SweepSpec, folder: Path | None = None) -> list[Fault]:
    """Faults of the quantities: missing functions, duplicate names.

    Functions are loaded.  Those of a sweep file lie in its ``folder``.
    """
    faults = []
    for _, function in function_references(spec.keep):
        reason = reference_fault(function, folder)
        try:
            if not reason:
                load_function(function)
        except MultiarmError as error:
            reason = str(error)
        if reason:
            faults.append(fault_at(("keep",), reason))
    names = [quantity.name for quantity in spec.quantities()]
    for name in sorted({name for name in names if names.count(name) > 1}):
        problem = f"{name!r} stands twice; give one of them another 'name'"
        faults.append(fault_at(("keep",), problem))
    return faults


def sweep_code(scene: Scene, spec: SweepSpec) -> list[NamedCode]:
    """The code that a sweep names: its quantities, and functions and user classes of its values."""
    named = function_references(spec.keep)
    code = [NamedCode.function(("keep", parts[0]), function) for parts, function in named]
    used = {*words(scene.model_dump(mode="json"))}
    classes = [(sort, name) for sort in REGISTRIES for name in sort.names() if name not in used]
    for axis in spec.axes:
        at = ("over", axis.written)
        texts = axis_words(axis)
        code += [NamedCode.user_class(at, sort, name) for sort, name in classes if name in texts]
        for text in sorted(texts):
            if _FUNCTION.fullmatch(text):
                function = located(CodeReference(text), scene.folder)
                code.append(NamedCode.function(at, function))
    return code


def words(value: Any) -> Iterator[str]:
    """All strings in values, including keys of tables."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        yield from words(list(value.items()))
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from words(item)


def axis_words(axis: Axis) -> set[str]:
    """All strings in the paths and values of an axis."""
    return {*words([axis.spec.written(), *map(parse_path, axis.paths)])}


def value_faults(scene: Scene, spec: SweepSpec) -> list[Fault]:
    """Faults of paths and values in a scene, without axes that are faulty whatever the scene.

    Of computed values only the first wrong one is reported.
    """
    axes = tuple(axis for axis in spec.axes if not any(_axis_problems(axis)))
    faults: dict[tuple[Hashable, ...], Fault] = {}
    for entries in _trials(axes, spec.combine == "zip"):
        values: dict[str, Any] = {}
        for axis, entry in zip(axes, entries, strict=True):
            values |= axis.at(entry)
        try:
            scene.replace(values)
        except SceneError as error:
            for fault in error.faults:
                faults.setdefault(*_at_its_axis(scene, fault, axes, entries))
    return list(faults.values())


def _axis_problems(axis: Axis) -> Iterator[str]:
    for path in axis.paths:
        try:
            parse_path(path)
        except SceneError as error:
            yield from (fault.problem for fault in error.faults)
    if axis.spec.rows is None:
        return
    width = len(axis.paths)
    for k, row in enumerate(axis.spec.rows):
        if not isinstance(row, list) or len(row) != width:
            yield f"rows[{k}] must be a list of {width}, a value for each path, got {shown(row)}"


def _trials(axes: tuple[Axis, ...], zipped: bool) -> Iterator[list[Any]]:
    """Entries of all axes: the first ones, the last ones, and those of each axis in turn."""
    steps = [k for k, axis in enumerate(axes) if not axis.drawn]
    shortest = min((axes[k].count for k in steps), default=1)
    options: list[list[Any]] = [
        list(TAILS) if axis.drawn else _some(shortest if zipped else axis.count) for axis in axes
    ]
    first = [entries[0] for entries in options]
    yield first
    yield [entries[-1] for entries in options]
    together = [steps] if zipped and steps else [[k] for k in steps]
    together += [[k] for k, axis in enumerate(axes) if axis.drawn]
    for group in together:
        for entry in options[group[0]][1:]:
            yield [entry if k in group else default for k, default in enumerate(first)]


def _some(count: int) -> list[int]:
    """Indices below the count, evenly spread, with the first and the last."""
    if count <= TRIED:
        return list(range(count))
    return sorted({round(k * (count - 1) / (TRIED - 1)) for k in range(TRIED)})


def _at_its_axis(
    scene: Scene, fault: Fault, axes: tuple[Axis, ...], entries: list[Any]
) -> tuple[tuple[Hashable, ...], Fault]:
    """The fault at the place in the sweep that causes a fault of the scene, and a key of it.

    Equal keys are one fault, which several values cause.
    """
    where, problem = fault.parts, fault.problem
    causes = [
        (parse_path(path), axis, entry, path)
        for axis, entry in zip(axes, entries, strict=True)
        for path in axis.paths
        if _meet(parse_path(path), where)
    ]
    if not causes:
        tried = ", ".join(
            f"{path} = {shown(value)}"
            for axis, entry in zip(axes, entries, strict=True)
            for path, value in axis.at(entry).items()
        )
        return (fault,), fault_at(("over",), f"no scene is made by {tried}: {fault}")
    at, axis, entry, path = max(causes, key=lambda cause: len(cause[0]))
    written = ("over", axis.written)
    if len(where) <= len(at) and not _leads_somewhere(scene, path):
        return (at, problem), fault_at(written, problem)
    if len(where) > len(at):
        problem = f"its {place(where[len(at) :], '').removeprefix('.')}: {problem}"
    if axis.spec.name == "values":
        return (at, where, entry), fault_at((*written, entry), problem)
    value = shown(axis.at(entry)[path])
    return (at, where), fault_at((*written, axis.spec.name), f"the value {value}: {problem}")


def _leads_somewhere(scene: Scene, path: str) -> bool:
    """Whether a scene can have a value at a path."""
    try:
        value_at(scene, path)
    except SceneError:
        return False
    return True


def _meet(path: Parts, where: Parts) -> bool:
    """Whether one place contains the other or equals it."""
    common = min(len(path), len(where))
    return path[:common] == where[:common]
