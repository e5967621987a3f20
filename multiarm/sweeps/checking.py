"""Checks of a sweep against its scene: unknown paths, and values that make no valid scene.

Every fault is reported at its place in the sweep, with the scene's message.  Scenes are made from
the first values of all axes, from the last ones, and from each axis's values with the first ones of
all other axes; of long axes only some values are tried.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

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
from multiarm.sweeps.spec import SweepSpec

__all__ = ["plan_faults", "quantity_faults", "sweep_code", "value_faults", "words"]

# A value that names a function; an address such as package:// has no name after the colon.
_FUNCTION = re.compile(r"[^:\s][^\n]*:[A-Za-z_][\w.]*")

TRIED = 24
"""Values of an axis that are tried, at most."""
TAILS = (0.5, 0.001, 0.999)
"""Quantiles of a drawn axis that are tried."""
MOST_RUNS = 1_000_000
"""Of one sweep."""


def plan_faults(spec: SweepSpec) -> list[Fault]:
    """Faults of the axes, and of their combination, that do not depend on the scene."""
    faults = [
        fault_at(("over", axis.written), problem)
        for axis in spec.axes
        for problem in _axis_problems(axis)
    ]
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
    if spec.count > MOST_RUNS:
        problem = f"makes {spec.count:,} runs; at most {MOST_RUNS:,} are possible"
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
    names = [column.key for column in spec.of_group("quantities")]
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
        at, texts = ("over", axis.written), {*words([axis.spec.written(), axis.parts])}
        code += [NamedCode.user_class(at, sort, name) for sort, name in classes if name in texts]
        for text in sorted(filter(_FUNCTION.fullmatch, texts)):
            code.append(NamedCode.function(at, located(CodeReference(text), scene.folder)))
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


def value_faults(scene: Scene, spec: SweepSpec) -> list[Fault]:
    """Faults of paths and values in a scene, without axes that are faulty whatever the scene.

    Of computed values only the first wrong one is reported.
    """
    axes = [axis for axis in spec.axes if not any(_axis_problems(axis))]
    faults: dict[Hashable, Fault] = {}
    for entries in _trials(axes, spec.combine == "zip"):
        trial = dict(zip(axes, entries, strict=True))
        values: dict[str, Any] = {}
        for axis, entry in trial.items():
            values |= axis.at(entry)
        try:
            scene.replace(values)
        except SceneError as error:
            for fault in error.faults:
                in_sweep = _in_sweep(scene, fault, trial, values)
                faults.setdefault((in_sweep.parts, fault.parts), in_sweep)
    return list(faults.values())


def _axis_problems(axis: Axis) -> Iterator[str]:
    for path in axis.paths:
        try:
            parse_path(path)
        except SceneError as error:
            yield from (fault.problem for fault in error.faults)
    width = len(axis.paths)
    for k, row in enumerate(axis.spec.rows or ()):
        if not isinstance(row, list) or len(row) != width:
            yield f"rows[{k}] must be a list of {width}, a value for each path, got {shown(row)}"


def _trials(axes: list[Axis], zipped: bool) -> Iterator[list[Any]]:
    """Entries of all axes: the first ones, the last ones, and those of each axis in turn."""
    shortest = min((axis.count for axis in axes if not axis.drawn), default=1)
    options: list[list[Any]] = [
        list(TAILS) if axis.drawn else _some(shortest if zipped else axis.count) for axis in axes
    ]
    first = [entries[0] for entries in options]
    yield first
    yield [entries[-1] for entries in options]
    for k, axis in enumerate(axes):
        together = [zipped and not (axis.drawn or second.drawn) for second in axes]
        if True in together[:k]:
            continue  # tried with an earlier axis
        for entry in options[k][1:]:
            yield [entry if j == k or together[j] else default for j, default in enumerate(first)]


def _some(count: int) -> list[int]:
    """Indices below the count, evenly spread, with the first and the last."""
    return np.linspace(0, count - 1, min(count, TRIED), dtype=int).tolist()


def _in_sweep(
    scene: Scene, fault: Fault, trial: Mapping[Axis, Any], values: Mapping[str, Any]
) -> Fault:
    """A fault of the scene at the place in the sweep that causes it."""
    where, problem = fault.parts, fault.problem
    causes = [
        (parts, axis, path)
        for axis in trial
        for path, parts in zip(axis.paths, axis.parts, strict=True)
        if parts[: len(where)] == where[: len(parts)]  # one place contains the other
    ]
    if not causes:
        tried = ", ".join(f"{path} = {shown(value)}" for path, value in values.items())
        return fault_at(("over",), f"no scene is made by {tried}: {fault}")
    parts, axis, path = max(causes, key=lambda cause: len(cause[0]))
    written: Parts = ("over", axis.written)
    below = where[len(parts) :]
    if not below and not _leads_somewhere(scene, path):
        return fault_at(written, problem)
    if below:
        problem = f"its {place(below, '').removeprefix('.')}: {problem}"
    if axis.spec.name == "values":
        return fault_at((*written, trial[axis]), problem)
    return fault_at((*written, axis.spec.name), f"the value {shown(values[path])}: {problem}")


def _leads_somewhere(scene: Scene, path: str) -> bool:
    """Whether a scene can have a value at a path."""
    try:
        value_at(scene, path)
    except SceneError:
        return False
    return True
