"""The plan of a sweep: the number of runs and the values of each.

    run = 1 + point * repeat + repetition

A point of the grid is a number whose digits are the entries of the axes, the last axis fastest.
The values of a run are computed on demand from its number alone: a plan of a million runs takes no
more memory than one of ten.

A random value is the quantile Q(u) of a number u in (0, 1), so that one sampler serves all kinds:

    random            u = Philox(seed, run), independent for every run
    latin_hypercube   the runs of one grid point fill `repeat` layers of every axis once
    sobol             the runs of one grid point are a scrambled Sobol sequence

The last two are SciPy's; every grid point has its own sample, keyed by the seed and the point.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from multiarm.errors import SceneError, SweepError
from multiarm.scene import Scene, dump_scene, load_scene
from multiarm.scene.code import CodeReference
from multiarm.sweeps.axes import Axis
from multiarm.sweeps.checking import axis_faults, axis_words, quantity_faults, value_faults, words
from multiarm.sweeps.quantities import Quantity
from multiarm.sweeps.spec import SweepSpec, examined, parse_sweep, read_sweep

__all__ = [
    "Job",
    "Record",
    "SweepPlan",
    "make_plan",
    "plan_of",
    "program_version",
    "require_run",
]


class Job(NamedTuple):
    """One run: its number, and the values that it sets in the scene."""

    run: int
    values: dict[str, Any]


@dataclass(frozen=True)
class Record:
    """Inputs, status and outputs of one run of a sweep.

    All but ``wall_time`` and ``worker`` follow from the scene, the sweep and the run's number.

    Attributes
    ----------
    run : int
        From 1 on.
    status : {"completed", "failed"}
        Also "failed" if the run completed but a user-defined quantity raised an error; the other
        quantities are there.
    message : str
        How the run ended and, after a failure, the remedy.
    values : mapping
        Path in the scene -> value in this run.
    quantities : mapping
        Name -> number, in the quantity's unit; None if the run failed or the quantity is not
        defined for it.
    wall_time : float
        [s]
    worker : str
        Computer and process of the run.
    """

    run: int
    status: str
    message: str
    values: Mapping[str, Any]
    quantities: Mapping[str, float | None]
    wall_time: float
    worker: str


@dataclass(frozen=True)
class SweepPlan:
    """Many runs of one scene."""

    scene: Scene  # with the sweep's entries of `run`
    spec: SweepSpec
    quantities: tuple[Quantity, ...]  # outputs of every run, besides its wall time

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """The axes, in the order of the file."""
        return self.spec.axes

    @cached_property
    def paths(self) -> tuple[str, ...]:
        """The paths that vary."""
        return tuple(path for axis in self.axes for path in axis.paths)

    def examples(self, path: str) -> list[Any]:
        """Values of all types that a path takes."""
        return next(axis.examples(path) for axis in self.axes if path in axis.paths)

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Size of the grid along each enumerated axis; a zip has one size."""
        counts = [axis.count for axis in self.axes if not axis.drawn]
        if self.spec.combine == "zip":
            return tuple(counts[:1])
        return tuple(counts)

    @property
    def count(self) -> int:
        """Number of runs."""
        return math.prod(self.sizes) * self.spec.repeat

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
        return frozenset(named).union(*map(axis_words, self.axes))

    @cached_property
    def files(self) -> dict[str, str]:
        """Path -> SHA-256 of the files that the scene or values of the sweep name.

        Runs give other numbers when such a file changes.  Robots by name belong to installed
        packages, whose versions are in the file's provenance.
        """
        found: dict[str, str] = {}
        for text in self.words:
            name = CodeReference(text).file or Path(text)
            if name.suffix.lower() not in _SUFFIXES:
                continue
            path = (self.scene.folder / name.expanduser()).resolve()
            if str(path) not in found and path.is_file():
                found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
        return dict(sorted(found.items()))

    @cached_property
    def fingerprint(self) -> str:
        """Digest of all that decides on the numbers of the runs.

        Version of the program, scene, sweep, functions, and the files that they name.
        """
        parts = [
            program_version(),
            self.scene_text,
            self.text,
            *(one.digest for one in self.quantities),
            *(f"{path} {digest}" for path, digest in self.files.items()),
        ]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def values(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of a run.

        Parameters
        ----------
        run : int
            From 1 to the count.

        Raises
        ------
        SweepError
            When there is no such run.
        """
        require_run(run, self.count)
        return next(self.jobs([run])).values

    def jobs(self, runs: Iterable[int] | None = None) -> Iterator[Job]:
        """The jobs of all runs, or of some."""
        drawn = sum(axis.drawn for axis in self.axes)
        sampler = Sampler(self.spec.sampling, self.spec.seed, drawn, self.spec.repeat)
        for run in range(1, self.count + 1) if runs is None else runs:
            yield Job(run, self._values(run, sampler))

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

    def _values(self, run: int, sampler: Sampler) -> dict[str, Any]:
        entries = iter(self._entries((run - 1) // self.spec.repeat))
        numbers = iter(sampler.at(run).tolist())
        found: dict[str, Any] = {}
        for axis in self.axes:
            found |= axis.at(next(numbers if axis.drawn else entries))
        return found

    def _entries(self, point: int) -> list[int]:
        """Indices of the values of the enumerated axes at a point of the grid."""
        if self.spec.combine == "zip":
            return [point] * sum(not axis.drawn for axis in self.axes)
        return [int(entry) for entry in np.unravel_index(point, self.sizes)]


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
    whole = isinstance(run, (int, np.integer)) and not isinstance(run, bool)
    if not whole or not 1 <= run <= count:
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


_SMALLEST = 2.0**-54
"""Distance of u from 0 and 1, where many quantiles are infinite."""


@dataclass
class Sampler:
    """Numbers in (0, 1), one for each drawn axis, for any run."""

    sampling: str  # "random", "latin_hypercube" or "sobol"
    seed: int
    axes: int  # how many numbers a run needs
    repeat: int  # runs of one grid point
    # the sample of the last grid point: runs mostly come in order
    _point: int = field(default=-1, init=False)
    _sample: Any = field(default=None, init=False, repr=False)

    def at(self, run: int) -> np.ndarray:
        """The numbers of a run, counted from 1, shape (axes,)."""
        if self.axes == 0:
            return np.zeros(0)
        point, repetition = divmod(run - 1, self.repeat)
        if self.sampling == "random":
            u = self._generator(run).random(self.axes)
        elif self.sampling == "latin_hypercube":
            u = self._hypercube(point)[repetition]
        else:
            u = self._sobol(point, repetition)
        return np.clip(u, _SMALLEST, 1.0 - 2.0 * _SMALLEST)

    def _generator(self, key: int) -> np.random.Generator:
        own = np.random.SeedSequence(self.seed, spawn_key=(key,))
        return np.random.Generator(np.random.Philox(own))

    def _hypercube(self, point: int) -> np.ndarray:
        if point != self._point:
            from scipy.stats.qmc import LatinHypercube

            hypercube = LatinHypercube(self.axes, rng=self._generator(point))
            self._point, self._sample = point, hypercube.random(self.repeat)
        return self._sample

    def _sobol(self, point: int, repetition: int) -> np.ndarray:
        if point != self._point or repetition < self._sample.num_generated:
            from scipy.stats.qmc import Sobol

            self._point, self._sample = point, Sobol(self.axes, rng=self._generator(point))
        skipped = repetition - self._sample.num_generated
        if skipped:
            self._sample.fast_forward(skipped)
        return self._sample.random(1)[0]


# Of strings that may name a file.
_SUFFIXES = (".urdf", ".xml", ".stl", ".obj", ".dae", ".csv", ".py", ".yaml", ".yml")
