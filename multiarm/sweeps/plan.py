"""The plan of a sweep: scene and sweep, checked against each other.

Some scenes are made before any run: with the first values of all axes, with the last ones, and with
each axis's values and the first ones of all other axes.  Their faults are reported at the place in
the sweep, and they show which code and which files the values name.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import os
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from multiarm.errors import Fault, MultiarmError, SceneError, SweepError
from multiarm.scene import (
    NamedCode,
    Scene,
    load_scene,
    named_code,
    parse_path,
    refuse_code,
    value_at,
)
from multiarm.scene.code import (
    CodeReference,
    function_references,
    function_text,
    load_function,
    nodes,
    reference_fault,
)
from multiarm.scene.faults import fault_at, place, shown
from multiarm.sweeps.axes import AxisSpec, paths_of
from multiarm.sweeps.quantities import OF_ONE_OBJECT, UserQuantity
from multiarm.sweeps.spec import SweepSpec, examined, read_sweep

MOST_RUNS = 1_000_000
"""A sweep has at most so many runs."""


@dataclass(frozen=True)
class SweepPlan:
    """Many runs of one scene."""

    scene: Scene  # with the sweep's entries of `run`
    spec: SweepSpec

    @cached_property
    def trials(self) -> Trials:
        """Some scenes of the sweep."""
        return _trials(self.scene, self.spec)

    @property
    def code(self) -> list[NamedCode]:
        """The code that the scene and the sweep name, and that is not loaded yet."""
        quantities = function_references(self.spec.keep)
        kept = [NamedCode.function(("keep", parts[0]), function) for parts, function in quantities]
        of_values = map(named_code, self.trials.scenes)
        return list(dict.fromkeys(itertools.chain(named_code(self.scene), kept, *of_values)))

    @cached_property
    def kinds(self) -> set[str]:
        """Names of the kinds and of the effects in the scenes, ours and users'."""
        models = [part for part in self._parts if isinstance(part, BaseModel)]
        kinds = (getattr(model, "kind", None) for model in models)
        return {
            *filter(None, kinds),
            *(name for model in models for name in model.model_extra or ()),
        }

    @cached_property
    def files(self) -> dict[str, str]:
        """Path -> SHA-256 of the files that the scene or values of the sweep name.

        Runs give other numbers when such a file changes.  Robots by name belong to installed
        packages, whose versions are in the provenance.
        """
        functions = (part for part in self._parts if callable(part))
        code = [function_text(part) for part in (*functions, *self.kinds)]
        code += [part for part in self._parts if isinstance(part, CodeReference)]
        paths = {part for part in self._parts if isinstance(part, Path)}
        paths |= {*filter(None, (CodeReference(name).file for name in code))}
        files = sorted(path.resolve() for path in paths if path.is_file())
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    @cached_property
    def _parts(self) -> list[Any]:
        """The parts of all scenes."""
        scenes = (self.scene, *self.trials.scenes)
        return [part for scene in scenes for _, part in nodes(scene)]

    @cached_property
    def functions(self) -> list[str]:
        """SHA-256 of the source text of each quantity's function; empty where there is none."""
        entries = (entry for entry in self.spec.keep if isinstance(entry, UserQuantity))
        return [_digest(entry.function) for entry in entries]

    def scene_of(self, run: int) -> Scene:
        """The scene of a run; raises a SceneError when its values make no valid scene."""
        return self.scene.replace(self.spec.values(run))


def _digest(function: Callable | CodeReference) -> str:
    try:
        if not isinstance(function, CodeReference):
            text = inspect.getsource(function)
        else:
            text = function.file.read_text(encoding="utf-8") if function.file else ""
    except (OSError, TypeError, ValueError):
        return ""  # typed in at a prompt, or made by other means
    return hashlib.sha256(text.encode()).hexdigest()


# --- checks ---------------------------------------------------------------------------------------


def make_plan(
    scene: Scene | str | os.PathLike,
    over: str | os.PathLike | Mapping[str, Any] | None,
    **changes: Any,
) -> SweepPlan:
    """Plan a sweep and check it: its text, and its paths and values in the scene.

    ``over`` is that of :func:`multiarm.sweep`; ``changes`` are keys that replace those in it.

    Raises
    ------
    SceneError
        When the scene cannot be read; when it was read without permission to load code, and it or
        the sweep names some.
    SweepError
        Naming every fault.  Some values of every axis are tried, among them the first and the last
        of enumerated ones, and the median and both tails of drawn ones.  A run whose scene turns
        out to be invalid later has status "failed".
    """
    if isinstance(scene, (str, os.PathLike)):
        scene = load_scene(os.fspath(scene))
    if not isinstance(scene, Scene):
        raise SweepError(
            f"a sweep needs a scene, or the path of its file; got {type(scene).__name__} (a system "
            "has its scene as `system.scene`)"
        )
    source = str(over) if isinstance(over, (str, os.PathLike)) else None
    data, folder = read_sweep(over, changes)
    spec, faults = examined(data, folder)
    if spec is None:
        raise SweepError(faults, source=source)
    in_run: list[Fault] = []
    try:  # faults of `run` have the same place in the sweep as in the scene
        scene = scene.replace({f"run.{key}": value for key, value in spec.run.items()})
    except SceneError as error:
        in_run = error.faults
    plan = SweepPlan(scene, spec)
    if not scene.may_load_code:
        refuse_code(plan.code)
    # a function that is named in Python may lie in any folder
    within = None if source is None or "keep" in changes else folder
    faults += [*_plan_faults(spec), *_quantity_faults(spec, within), *_object_faults(spec, scene)]
    faults += [*in_run, *plan.trials.faults]
    if faults:
        raise SweepError(faults, source=source)
    return plan


def _plan_faults(spec: SweepSpec) -> list[Fault]:
    """Faults of the axes, and of their combination, that do not depend on the scene."""
    faults = [
        fault_at(("over", key), problem)
        for key, axis in spec.over.items()
        for problem in axis.problems(key)
    ]
    faults += [
        fault_at(("over", path), "stands twice in the sweep; keep one of the two")
        for path in _repeated(path for key in spec.over for path in paths_of(key))
    ]
    steps = {key: axis.count for key, axis in spec.over.items() if not axis.drawn}
    if spec.combine == "zip" and len({*steps.values()}) > 1:
        counts = ", ".join(f"{count} of {key}" for key, count in steps.items())
        problem = f"'zip' needs as many values of every path, there are {counts}"
        faults.append(fault_at(("combine",), problem))
    if spec.repeat > 1 and len(steps) == len(spec.over):
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


def _quantity_faults(spec: SweepSpec, folder: Path | None) -> list[Fault]:
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
    for name in _repeated(column.name for column in spec.outputs):
        problem = f"{name!r} stands twice; give one of them another 'name'"
        faults.append(fault_at(("keep",), problem))
    return faults


def _object_faults(spec: SweepSpec, scene: Scene) -> list[Fault]:
    """Faults of quantities of the object, where there are several."""
    objects = list(scene.all_objects)
    return [
        fault_at(
            ("keep",),
            f"{name!r} is of scenes with one object, there are {', '.join(objects)}; keep a "
            f"function of the trajectory, which reads `objects[{objects[0]!r}].position`",
        )
        for name in spec.keep
        if name in OF_ONE_OBJECT and len(objects) > 1
    ]


def _repeated(names: Iterable[str]) -> list[str]:
    """The names that stand twice, in order."""
    counts = Counter(names)
    return sorted(name for name, count in counts.items() if count > 1)


@dataclass(frozen=True)
class Trials:
    """Scenes that some values of a sweep make, and the faults of values that make none."""

    scenes: tuple[Scene, ...]
    faults: tuple[Fault, ...]


def _trials(scene: Scene, spec: SweepSpec) -> Trials:
    """Trials of a sweep, without axes that are faulty whatever the scene.

    Of computed values only the first wrong one is reported.
    """
    over = {key: axis for key, axis in spec.over.items() if not any(axis.problems(key))}
    scenes, faults = [], dict[Hashable, Fault]()
    for places in _tried_places([*over.values()], spec.combine == "zip"):
        trial = dict(zip(over, places, strict=True))
        values: dict[str, Any] = {}
        for key, at in trial.items():
            paths = paths_of(key)
            values |= zip(paths, over[key].at(at, len(paths)), strict=True)
        try:
            scenes.append(scene.replace(values))
        except SceneError as error:
            for fault in error.faults:
                in_sweep = _in_sweep(scene, fault, over, trial, values)
                faults.setdefault((in_sweep.parts, fault.parts), in_sweep)
    return Trials(tuple(scenes), tuple(faults.values()))


TRIED, TRIED_NAMES = 24, 1000
"""Values of an axis that are tried, at most: of numbers, of texts and tables."""
TAILS = (0.5, 0.001, 0.999)
"""Quantiles of a drawn axis that are tried."""


def _tried_places(axes: list[AxisSpec], zipped: bool) -> list[list[Any]]:
    """Places of all axes: the first ones, the last ones, and those of each axis in turn.

    Enumerated axes that are zipped move together, as one.
    """
    groups = [-1 if zipped and not axis.drawn else k for k, axis in enumerate(axes)]
    counts: dict[int, int] = {}
    for group, axis in zip(groups, axes, strict=True):
        counts[group] = min(axis.count, counts.get(group, axis.count))
    options: dict[int, list[Any]] = {}
    for group, axis in zip(groups, axes, strict=True):
        places = _some_places(axis, counts[group])
        options[group] = max(options.get(group, []), places, key=len)
    first = {group: places[0] for group, places in options.items()}
    last = {group: places[-1] for group, places in options.items()}
    in_turn = [first | {group: at} for group, places in options.items() for at in places[1:]]
    return [[trial[group] for group in groups] for trial in (first, last, *in_turn)]


def _some_places(axis: AxisSpec, count: int) -> list[Any]:
    """Places of an axis that are tried; more of one whose values may name code or files."""
    if axis.drawn and axis.choice is None:
        return [*TAILS]
    values = axis.values_in_turn
    if axis.choice is not None:
        values, count = axis.choice, len(axis.choice)
    most = TRIED_NAMES if any(map(_names_something, values)) else TRIED
    numbers = np.linspace(0, count - 1, min(count, most), dtype=int).tolist()
    return numbers if axis.choice is None else [(number + 0.5) / count for number in numbers]


def _names_something(value: Any) -> bool:
    if isinstance(value, list):
        return any(map(_names_something, value))
    return isinstance(value, (str, dict))


def _in_sweep(
    scene: Scene,
    fault: Fault,
    over: Mapping[str, AxisSpec],
    trial: Mapping[str, Any],
    values: Mapping[str, Any],
) -> Fault:
    """A fault of the scene at the place in the sweep that causes it."""
    where, problem = fault.parts, fault.problem
    causes = [
        (parts, key, path)
        for key in trial
        for path in paths_of(key)
        for parts in [parse_path(path)]
        if parts[: len(where)] == where[: len(parts)]  # one place contains the other
    ]
    if not causes:
        tried = ", ".join(f"{path} = {shown(value)}" for path, value in values.items())
        return fault_at(("over",), f"no scene is made by {tried}: {fault}")
    parts, key, path = max(causes, key=lambda cause: len(cause[0]))
    below = where[len(parts) :]
    if not below and not _leads_somewhere(scene, path):
        return fault_at(("over", key), problem)
    if below:
        problem = f"its {place(below, '').removeprefix('.')}: {problem}"
    if over[key].values is not None:
        return fault_at(("over", key, trial[key]), problem)
    return fault_at(("over", key, over[key].name), f"the value {shown(values[path])}: {problem}")


def _leads_somewhere(scene: Scene, path: str) -> bool:
    """Whether a scene can have a value at a path."""
    try:
        value_at(scene, path)
    except SceneError:
        return False
    return True
