"""The result of a sweep: its table, and the trajectory of any of its runs.

A run follows from the scene, the sweep and its number, so its trajectory is not stored: it is
simulated again when it is requested, and is the same bit for bit.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas

from multiarm.errors import SweepError
from multiarm.notation import count_of
from multiarm.public import public_names
from multiarm.results.files import resolved
from multiarm.results.outcome import RunStatus
from multiarm.sweeps.folder import Header, read_header, read_rows
from multiarm.sweeps.plan import SweepPlan
from multiarm.sweeps.spec import Column, parse_sweep

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import Scene


class Sweep:
    """The rows of a sweep when its folder was read; rows that are appended later are not seen.

    Parameters
    ----------
    path : path-like
    code : bool
        Whether :meth:`trajectory` may load the code that the scene names.

    Raises
    ------
    SweepError
        The folder cannot be read, or is no sweep.
    """

    def __init__(self, path: str | os.PathLike, code: bool = False):
        self.path = resolved(path, SweepError)
        self._header, self._code = read_header(self.path), code
        try:
            self._spec = parse_sweep(self._header.sweep)
        except SweepError as error:
            raise SweepError(error.faults, source=str(self.path / "sweep.yaml")) from None
        self._rows = read_rows(self.path, self._spec)

    __dir__ = public_names

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.status_counts.items())
        done = f"{len(self)} of {count_of(self.count, 'run')}"
        return f"Sweep({done}{': ' if counts else ''}{counts})"

    @property
    def count(self) -> int:
        """Number of planned runs."""
        return self._spec.count

    @property
    def complete(self) -> bool:
        """Whether every run has its row."""
        return len(self) == self.count

    @property
    def runs(self) -> np.ndarray:
        """Numbers of the runs that have a row, ascending."""
        return self._rows.index.to_numpy(dtype=np.int64)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the table: run, status, message, values, quantities, wall time, worker."""
        return self._spec.columns

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths in the scene that vary: columns of the table."""
        return self._spec.paths

    @property
    def quantities(self) -> tuple[str, ...]:
        """Outputs of each run: columns of the table."""
        return tuple(column.name for column in self._spec.quantities)

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Version, computer and time of the start."""
        return dict(self._header.provenance)

    @cached_property
    def scene(self) -> Scene:
        """The scene that is varied."""
        from multiarm.scene import parse_scene

        return parse_scene(self._header.scene, self._header.folder, self._code)

    @property
    def text(self) -> str:
        """The sweep as YAML."""
        return self._header.sweep

    @cached_property
    def plan(self) -> SweepPlan:
        """The plan: the scene, and the values of each run."""
        return SweepPlan(self.scene, self._spec)

    @cached_property
    def status_counts(self) -> dict[str, int]:
        """Status -> runs, the most frequent first."""
        counts = self._rows["status"].value_counts()
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    @cached_property
    def table(self) -> pandas.DataFrame:
        """A row for each finished run, in their order; a missing entry is ``pandas.NA``.

        Columns: ``run``, ``status``, ``message``, the values that vary by their paths, the
        quantities, ``wall_time`` [s] and ``worker``.  ``attrs["units"]`` maps columns to units.
        """
        values = self._spec.table.loc[self._rows.index]
        complete = values.notna().all()  # else objects: None stays what the sweep gave
        values = values.astype(
            {path: values[path].infer_objects().dtype for path in values if complete[path]}
        )
        table = self._rows.join(values).reset_index()[[column.name for column in self.columns]]
        table.attrs["units"] = {column.name: column.unit for column in self.columns if column.unit}
        return table

    def summary(self) -> SweepSummary:
        """How the runs ended and how each quantity spreads."""
        return SweepSummary(
            count=self.count,
            done=len(self),
            statuses=self.status_counts,
            wall_time=math.fsum(self._rows["wall_time"].dropna()),
            spreads=tuple(
                _spread(self._rows[column.name], column) for column in self._spec.quantities
            ),
            failures=_failures(self._rows),
        )

    def values_of(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of one run, also of a run that has not been made.

        Raises
        ------
        SweepError
            There is no such run.
        """
        return self._spec.values(run)

    def scene_of(self, run: int) -> Scene:
        """The scene of one run.

        Raises
        ------
        SweepError
            There is no such run.
        """
        return self.plan.scene_of(run)

    def trajectory(self, run: int) -> Trajectory:
        """Simulate one run once more.

        Warns when the version of the program, or a file that the scene names, has changed: the
        numbers may differ then.

        Raises
        ------
        SweepError
            There is no such run.
        SceneError
            Its scene names code, and :func:`load_sweep` was called without ``code``.
        """
        from multiarm.sweeps.run import simulate_run

        scene = self.scene_of(run)
        differs = self._header.differences(Header.of(self.plan))
        if differs:
            warnings.warn(
                f"this run may give other numbers than its row has: {'; '.join(differs)}",
                stacklevel=2,
            )
        return simulate_run(scene, self.plan.spec.certificate)


def load_sweep(path: str | os.PathLike, code: bool = False) -> Sweep:
    """Read the folder of a sweep, complete or not, without loading the code that it names.

    Parameters
    ----------
    path : path-like
    code : bool
        Whether ``sweep.trajectory(run)``, which simulates a run again, may load the functions and
        effects of packages that the scene names; without, it raises if there are any.

    Raises
    ------
    SweepError
        The folder cannot be read, or is no sweep.
    """
    return Sweep(path, code)


# --- the summary ----------------------------------------------------------------------------------

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of every quantity."""
FAILURES = 8
"""Different messages of failed runs in a summary, at most."""
_NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Spread:
    """Statistics of a quantity over the runs that have it; None if no run has it.

    A number beyond the range of floats is None too.
    """

    name: str
    unit: str
    words: str
    count: int  # runs that have it
    smallest: float | None = None
    smallest_run: int | None = None  # the first run with this value
    largest: float | None = None
    largest_run: int | None = None
    mean: float | None = None
    # level, 0 to 1 -> value
    quantiles: dict[float, float | None] = field(default_factory=lambda: dict.fromkeys(LEVELS))


@dataclass(frozen=True)
class Failure:
    """Runs whose messages differ in numbers only; status, message and number of the first one."""

    status: str
    message: str
    runs: int
    first_run: int


@dataclass(frozen=True)
class SweepSummary:
    """How the runs of a sweep ended, and how each quantity spreads."""

    count: int  # planned runs
    done: int  # finished ones
    statuses: dict[str, int]  # status -> runs
    wall_time: float  # [s] of all runs together
    spreads: tuple[Spread, ...]
    failures: tuple[Failure, ...]  # the first few different messages of runs that did not complete

    def figures(self) -> dict[str, Any]:
        """The summary as JSON data."""
        data = asdict(self)
        for spread in data["spreads"]:
            spread["quantiles"] = {f"{level:g}": v for level, v in spread["quantiles"].items()}
        return data


def _spread(cells: pandas.Series, column: Column) -> Spread:
    numbers = cells.dropna().astype(float) + 0.0  # -0.0 becomes 0.0
    if numbers.empty:
        return Spread(*column, count=0)
    return Spread(
        *column,
        count=len(numbers),
        smallest=_finite(numbers.min()),
        smallest_run=int(numbers.idxmin()),
        largest=_finite(numbers.max()),
        largest_run=int(numbers.idxmax()),
        mean=_finite(numbers.mean()),
        quantiles={level: _finite(numbers.quantile(level)) for level in LEVELS},
    )


def _failures(rows: pandas.DataFrame) -> tuple[Failure, ...]:
    """The different messages of runs that did not complete, the first few."""
    failed = rows.loc[rows["status"] != RunStatus.COMPLETED, ["status", "message"]]
    alike = failed["message"].str.replace(_NUMBER, "#", regex=True).rename("alike")
    failures = [
        Failure(group["status"].iloc[0], group["message"].iloc[0], len(group), int(group.index[0]))
        for _, group in failed.groupby(["status", alike], sort=False)
    ]
    return tuple(failures[:FAILURES])


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
