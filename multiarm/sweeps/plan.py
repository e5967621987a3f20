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
import importlib.metadata
import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from multiarm.errors import SceneError, SweepError
from multiarm.scene import Scene, dump_scene, load_scene
from multiarm.scene.code import CodeReference
from multiarm.sweeps.axes import is_integer
from multiarm.sweeps.checking import axis_faults, axis_words, quantity_faults, value_faults, words
from multiarm.sweeps.quantities import Quantity
from multiarm.sweeps.spec import SweepSpec, examined, parse_sweep, read_sweep

__all__ = ["SweepPlan", "make_plan", "plan_of", "program_version", "require_run"]


@dataclass(frozen=True)
class SweepPlan:
    """Many runs of one scene."""

    scene: Scene  # with the sweep's entries of `run`
    spec: SweepSpec
    quantities: tuple[Quantity, ...]  # outputs of every run, besides its wall time

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
        return len(self.table)

    @cached_property
    def text(self) -> str:
        """The sweep as canonical YAML."""
        return self.spec.text()

    @cached_property
    def scene_text(self) -> str:
        """The scene as YAML."""
        return dump_scene(self.scene)

    @cached_property
    def words(self) -> frozenset[str]:
        """All strings in the scene, and in the paths and values of the sweep."""
        named = words(self.scene.model_dump(mode="json"))
        return frozenset(named).union(*map(axis_words, self.spec.axes))

    @cached_property
    def files(self) -> dict[str, str]:
        """Path -> SHA-256 of the files that the scene or values of the sweep name.

        Runs give other numbers when such a file changes.  Robots by name belong to installed
        packages, whose versions are in the provenance.
        """
        digests: dict[str, str] = {}
        for text in self.words:
            name = os.path.expanduser(CodeReference(text).file or text)
            place = os.path.join(self.scene.folder, name)
            if os.path.isfile(place):
                path = Path(place).resolve()
                digests[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
        return dict(sorted(digests.items()))

    @cached_property
    def fingerprint(self) -> str:
        """Digest of all that decides on the numbers of the runs.

        Version of the program, scene, sweep, functions, and the files that they name.
        """
        parts = [
            program_version(),
            self.scene_text,
            self.text,
            *(quantity.digest for quantity in self.quantities),
            *(f"{path} {digest}" for path, digest in self.files.items()),
        ]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def values(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of a run.

        Raises
        ------
        SweepError
            When there is no such run.
        """
        require_run(run, self.count)
        return self.table.loc[run].to_dict()

    def scene_of(self, run: int) -> Scene:
        """The scene of a run.

        Raises
        ------
        SweepError
            When there is no such run.
        SceneError
            When its values make no valid scene.
        """
        return self.scene.replace(self.values(run))


def planned_values(spec: SweepSpec) -> pandas.DataFrame:
    """The values of all runs: a row for each, a column for each path."""
    in_turn = [axis for axis in spec.axes if not axis.drawn]
    places = [range(axis.count) for axis in in_turn]
    zipped = spec.combine == "zip" and bool(in_turn)
    points = list(zip(*places, strict=True)) if zipped else list(itertools.product(*places))
    quantiles = samples(spec, len(points))
    columns: dict[str, list[Any]] = {}
    for axis in spec.axes:
        if axis.drawn:
            u = quantiles[:, sum(earlier.drawn for earlier in spec.axes[: spec.axes.index(axis)])]
            rows = [axis.at(share) for share in u.tolist()]
        else:
            k = in_turn.index(axis)
            rows = [axis.at(point[k]) for point in points for _ in range(spec.repeat)]
        columns |= {path: [row[path] for row in rows] for path in axis.paths}
    runs = pandas.RangeIndex(1, len(points) * spec.repeat + 1, name="run")
    return pandas.DataFrame(columns, index=runs, dtype=object)


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
        When the scene cannot be read.
    SweepError
        Naming every fault.  Some values of every axis are tried, among them the first and the last
        of enumerated ones, and the median and both tails of drawn ones.  A run whose scene turns
        out to be invalid later has status "failed".
    """
    if not isinstance(scene, Scene):
        scene = load_scene(_path_of(scene))
    source = str(over) if isinstance(over, (str, os.PathLike)) else None
    data, folder = read_sweep(over, changes)
    spec, faults = examined(data, folder)
    if spec is not None:
        # a function that is named in Python may lie in any folder
        within = None if source is None or "keep" in changes else folder
        faults += [*axis_faults(spec), *quantity_faults(spec, within)]
        try:  # faults of `run` have the same place in the sweep as in the scene
            scene = scene.replace({f"run.{key}": value for key, value in spec.run.items()})
        except SceneError as error:
            faults += error.faults
        faults += value_faults(scene, spec)
    if spec is None or faults:
        raise SweepError(faults, source=source)
    return SweepPlan(scene, spec, spec.quantities())


def plan_of(scene: Scene, text: str) -> SweepPlan:
    """The plan of a stored sweep, from its scene and its text.

    It was checked when it was made; user-defined functions may be missing now.

    Raises
    ------
    SweepError
        When the text was written by another version and cannot be read.
    """
    spec = parse_sweep(text)
    return SweepPlan(scene, spec, spec.quantities())


def require_run(run: Any, count: int) -> None:
    """Raise a SweepError unless this is the number of one of so many runs."""
    if not is_integer(run) or not 1 <= run <= count:
        raise SweepError(f"there is no run {run}; runs are 1 to {count}")


def program_version() -> str:
    """The version of multiarm."""
    try:
        return importlib.metadata.version("multiarm")
    except importlib.metadata.PackageNotFoundError:  # a checkout that is not installed
        return "not installed"


def _path_of(scene: Any) -> Any:
    if isinstance(scene, (str, os.PathLike)):
        return scene
    raise SweepError(
        f"a sweep needs a scene, or the path of its file; got {type(scene).__name__} (a system has "
        "its scene as `system.scene`)"
    )
