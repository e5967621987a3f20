"""The plan of a sweep: a table with the values of every run.

    run = 1 + point * repeat + repetition

The points of the grid go through the axes with the last one fastest.  A random value is the
quantile Q(u) of a number u in (0, 1), so that one sampler serves all kinds:

    random            u = Philox(seed, run), independent for every run
    latin_hypercube   the runs of one grid point fill `repeat` layers of every axis once
    sobol             the runs of one grid point are a scrambled Sobol sequence

The last two are SciPy's; every grid point has its own sample, keyed by the seed and the point.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from multiarm.errors import SceneError, SweepError
from multiarm.results.sinks import provenance
from multiarm.scene import Scene, load_scene, named_code, refuse_code
from multiarm.scene.code import CodeReference
from multiarm.sweeps.axes import is_integer
from multiarm.sweeps.checking import (
    plan_faults,
    quantity_faults,
    sweep_code,
    value_faults,
    words,
)
from multiarm.sweeps.quantities import UserQuantity
from multiarm.sweeps.spec import SweepSpec, examined, read_sweep

__all__ = ["SweepPlan", "make_plan", "planned_values", "program_version", "values_of_run"]


@dataclass(frozen=True)
class SweepPlan:
    """Many runs of one scene."""

    scene: Scene  # with the sweep's entries of `run`
    spec: SweepSpec

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths that vary."""
        return tuple(path for axis in self.spec.axes for path in axis.paths)

    @cached_property
    def table(self) -> pandas.DataFrame:
        """A row for each run, numbered from 1 on; a column for each path, of objects."""
        return planned_values(self.spec)

    @property
    def count(self) -> int:
        """Number of runs."""
        return self.spec.count

    @cached_property
    def words(self) -> frozenset[str]:
        """All strings in the scene, and in the paths and values of the sweep."""
        axes = [[axis.spec.written(), axis.parts] for axis in self.spec.axes]
        return frozenset(words([self.scene.model_dump(mode="json"), axes]))

    @cached_property
    def files(self) -> dict[str, str]:
        """Path -> SHA-256 of the files that the scene or values of the sweep name.

        Runs give other numbers when such a file changes.  Robots by name belong to installed
        packages, whose versions are in the provenance.
        """
        names = (os.path.expanduser(CodeReference(text).file or text) for text in self.words)
        places = (os.path.join(self.scene.folder, name) for name in names)
        paths = sorted({Path(place).resolve() for place in places if os.path.isfile(place)})
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}

    @cached_property
    def functions(self) -> list[str]:
        """SHA-256 of the source text of each quantity's function; empty where there is none."""
        entries = (entry for entry in self.spec.keep if isinstance(entry, UserQuantity))
        return [_digest(entry.function) for entry in entries]

    def values(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of a run; raises a SweepError when there is no such run."""
        return values_of_run(self.table, run)

    def scene_of(self, run: int) -> Scene:
        """The scene of a run; raises a SceneError when its values make no valid scene."""
        return self.scene.replace(self.values(run))


def _digest(function: Callable | CodeReference) -> str:
    try:
        if not isinstance(function, CodeReference):
            text = inspect.getsource(function)
        else:
            text = function.file.read_text(encoding="utf-8") if function.file else ""
    except (OSError, TypeError, ValueError):
        return ""  # typed in at a prompt, or made by other means
    return hashlib.sha256(text.encode()).hexdigest()


def planned_values(spec: SweepSpec) -> pandas.DataFrame:
    """The values of all runs: a row for each, a column for each path."""
    counts = [range(axis.count) for axis in spec.axes if not axis.drawn]
    zipped = spec.combine == "zip" and bool(counts)
    points = list(zip(*counts, strict=True) if zipped else itertools.product(*counts))
    grid = np.array(points, dtype=int).reshape(len(points), len(counts))
    in_turn = iter(np.repeat(grid, spec.repeat, axis=0).T.tolist())
    quantiles = iter(samples(spec, len(points)).T.tolist())
    columns: dict[str, list[Any]] = {}
    for axis in spec.axes:
        rows = [axis.at(place) for place in next(quantiles if axis.drawn else in_turn)]
        columns |= {path: [row[path] for row in rows] for path in axis.paths}
    runs = pandas.RangeIndex(1, len(points) * spec.repeat + 1, name="run")
    return pandas.DataFrame(columns, index=runs, dtype=object)


def values_of_run(table: pandas.DataFrame, run: int) -> dict[str, Any]:
    """Path -> value, from the :func:`planned_values`; raises a SweepError without such a run."""
    if not is_integer(run) or not 1 <= run <= len(table):
        raise SweepError(f"there is no run {run}; runs are 1 to {len(table)}")
    return table.loc[run].to_dict()


_SMALLEST = 2.0**-54
"""Distance of u from 0 and 1, where many quantiles are infinite."""


def samples(spec: SweepSpec, points: int) -> np.ndarray:
    """Numbers in (0, 1) for the drawn axes, shape (points * repeat, axes)."""
    from scipy.stats.qmc import LatinHypercube, Sobol

    axes, repeat = sum(axis.drawn for axis in spec.axes), spec.repeat

    def generator(key: int) -> np.random.Generator:
        return np.random.Generator(
            np.random.Philox(np.random.SeedSequence(spec.seed, spawn_key=(key,)))
        )

    if axes == 0:
        return np.zeros((points * repeat, 0))
    if spec.sampling == "random":
        u = np.array([generator(run).random(axes) for run in range(1, points * repeat + 1)])
    elif spec.sampling == "latin_hypercube":
        u = np.vstack(
            [LatinHypercube(axes, rng=generator(p)).random(repeat) for p in range(points)]
        )
    else:
        sequences = (Sobol(axes, rng=generator(point)) for point in range(points))
        u = np.vstack([sequence.random(1) for sequence in sequences for _ in range(repeat)])
    return np.clip(u, _SMALLEST, 1.0 - 2.0 * _SMALLEST)


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
    if spec is not None:
        if not scene.may_load_code:
            refuse_code([*named_code(scene), *sweep_code(scene, spec)])
        # a function that is named in Python may lie in any folder
        within = None if source is None or "keep" in changes else folder
        faults += [*plan_faults(spec), *quantity_faults(spec, within)]
        try:  # faults of `run` have the same place in the sweep as in the scene
            scene = scene.replace({f"run.{key}": value for key, value in spec.run.items()})
        except SceneError as error:
            faults += error.faults
        faults += value_faults(scene, spec)
    if spec is None or faults:
        raise SweepError(faults, source=source)
    return SweepPlan(scene, spec)


def program_version() -> str:
    """The version of multiarm."""
    return provenance("")["version"]
