"""The plan of a sweep: how many runs there are, and what is other in the scene of each.

    run = 1 + point * repeat + repetition

A point of the grid is a number whose digits are the entries of the axes, the last one fastest.
Values of a run are computed when they are asked for, from its number alone: a plan of a million
runs takes no more memory than one of ten.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from multiarm.errors import SceneError, SweepError
from multiarm.scene import Scene, changed, dump_scene, load_scene
from multiarm.sweeps.axes import Axis
from multiarm.sweeps.checking import axis_faults, quantity_faults, value_faults
from multiarm.sweeps.draws import Draws
from multiarm.sweeps.named_files import digests
from multiarm.sweeps.quantities import Quantity
from multiarm.sweeps.spec import SweepSpec, examined, parse_sweep, read_sweep

__all__ = ["SweepPlan", "make_plan", "plan_of", "program_version"]


@dataclass(frozen=True)
class SweepPlan:
    """Many runs of one scene.

    Attributes
    ----------
    scene : Scene
        With the sweep's entries of ``run`` in it.
    spec : SweepSpec
    quantities : tuple of Quantity
        What is kept of every run, beside what is measured.
    """

    scene: Scene
    spec: SweepSpec
    quantities: tuple[Quantity, ...]

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """The axes, in the order in which they are written."""
        return self.spec.axes

    @cached_property
    def paths(self) -> tuple[str, ...]:
        """The paths that vary, as they are written."""
        return tuple(path for axis in self.axes for path in axis.paths)

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Entries of the axes that are gone through together: one number of a zip."""
        counts = [axis.count for axis in self.axes if not axis.drawn]
        if self.spec.combine == "zip":
            return tuple(counts[:1])
        return tuple(counts)

    @property
    def points(self) -> int:
        """Points of the grid."""
        return math.prod(self.sizes)

    @property
    def count(self) -> int:
        """How many runs there are."""
        return self.points * self.spec.repeat

    @property
    def seed(self) -> int:
        """Of all draws."""
        return self.spec.seed

    @cached_property
    def text(self) -> str:
        """The sweep as YAML that is the same for the same sweep."""
        return self.spec.text()

    @cached_property
    def scene_text(self) -> str:
        """The scene as YAML."""
        return dump_scene(self.scene)

    @cached_property
    def files(self) -> dict[str, str]:
        """Path -> digest of the files that the scene or its values name."""
        listed = (axis.spec.written() for axis in self.axes)
        return digests(self.scene, listed)

    @cached_property
    def fingerprint(self) -> str:
        """The same for plans whose runs give the same numbers.

        Scene, sweep, functions, the files that they name, and the version of the program.
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
        if not 1 <= run <= self.count:
            raise SweepError(f"there is no run {run}; runs are 1 to {self.count}")
        return self._values(run, self._draws())

    def runs(self, start: int = 1) -> Iterator[tuple[int, dict[str, Any]]]:
        """Numbers and values of all runs from one on, one after the other."""
        return self.among(range(start, self.count + 1))

    def among(self, runs: Iterable[int]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Numbers and values of some runs, one after the other."""
        draws = self._draws()
        for run in runs:
            yield run, self._values(run, draws)

    def scene_of(self, run: int) -> Scene:
        """The scene of a run.

        Raises
        ------
        SweepError
            When there is no such run.
        SceneError
            When its values make no valid scene.
        """
        return changed(self.scene, self.values(run))

    def _draws(self) -> Draws:
        drawn = sum(axis.drawn for axis in self.axes)
        return Draws(self.spec.sampling, self.spec.seed, drawn, self.spec.repeat)

    def _values(self, run: int, draws: Draws) -> dict[str, Any]:
        entries = iter(self._entries((run - 1) // self.spec.repeat))
        numbers = iter(draws.at(run))
        found: dict[str, Any] = {}
        for axis in self.axes:
            found |= axis.drawn_at(float(next(numbers))) if axis.drawn else axis.at(next(entries))
        return found

    def _entries(self, point: int) -> list[int]:
        """Which entry each axis that is gone through has at a point of the grid."""
        if self.spec.combine == "zip":
            return [point] * sum(not axis.drawn for axis in self.axes)
        entries = []
        for size in reversed(self.sizes):
            point, entry = divmod(point, size)
            entries.append(entry)
        return entries[::-1]


def make_plan(
    scene: Scene | str | os.PathLike,
    over: str | os.PathLike | Mapping[str, Any] | None,
    **changes: Any,
) -> SweepPlan:
    """Plan a sweep, and check it: all faults of the sweep's text, or of its paths and values.

    Parameters
    ----------
    scene : Scene or path
    over : path or mapping, optional
        A sweep file, a table such as it holds, or its ``over`` alone.
    **changes
        Keys of a sweep that take the place of those in ``over``.

    Raises
    ------
    SceneError
        When the scene cannot be read.
    SweepError
        Naming every fault.  Of axes with very many values some are tried, among them the first and
        the last, of drawn ones the middle and both tails: a run whose scene turns out to be wrong
        nevertheless has status "failed".
    """
    if not isinstance(scene, Scene):
        scene = load_scene(_path_of(scene))
    source = str(over) if isinstance(over, (str, os.PathLike)) else None
    data, folder = read_sweep(over, changes)
    spec, faults = examined(data, folder)
    if spec is not None:
        # what is given in Python may name any file of the user's
        within = None if source is None or "keep" in changes else folder
        faults += [*axis_faults(spec), *quantity_faults(spec, within)]
        try:  # the places of the sweep's `run` are those of the scene's
            scene = changed(scene, {f"run.{key}": value for key, value in spec.run.items()})
        except SceneError as error:
            faults += error.faults
        faults += value_faults(scene, spec)
    if spec is None or faults:
        raise SweepError(faults, source=source)
    return SweepPlan(scene, spec, spec.quantities())


def plan_of(scene: Scene, text: str) -> SweepPlan:
    """The plan of a stored sweep, from its scene and its text.

    It was checked when it was made; functions of the user's need not be there.

    Raises
    ------
    SweepError
        When the text is of another version, and cannot be read.
    """
    spec = parse_sweep(text)
    return SweepPlan(scene, spec, spec.quantities())


def program_version() -> str:
    """Of multiarm: another one may give other numbers."""
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
