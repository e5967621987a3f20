"""The result of a sweep: its table, read on demand, and the trajectory of any of its runs.

A run follows from the scene, the sweep and its number, so its trajectory is not stored: it is
simulated again when it is requested, and is the same bit for bit.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from multiarm.errors import SweepError
from multiarm.notation import count_of
from multiarm.public import public_names
from multiarm.results.files import resolved
from multiarm.scene.faults import unknown
from multiarm.sweeps.plan import Record, require_run
from multiarm.sweeps.store import StoredSweep, differences
from multiarm.sweeps.table import Column, numpy_column, records, write_csv, write_parquet

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import Scene
    from multiarm.sweeps.plan import SweepPlan

__all__ = ["Failure", "Spread", "Sweep", "SweepSummary", "load_sweep"]


class Sweep:
    """The rows of a sweep when its file was read; rows that are appended later are not seen.

    Parameters
    ----------
    path : path-like
    code : bool
        Whether :meth:`trajectory` may load the code that the scene names.

    Raises
    ------
    SweepError
        The file cannot be read, or is no sweep.
    """

    def __init__(self, path: str | os.PathLike, code: bool = False):
        self.path = resolved(path, SweepError)
        self._code = code
        self._stored = StoredSweep.read(self.path)

    __dir__ = public_names

    def __len__(self) -> int:
        return len(self._stored.table)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.status_counts.items())
        done = f"{len(self)} of {count_of(self.count, 'run')}"
        return f"Sweep({done}{': ' if counts else ''}{counts})"

    @property
    def count(self) -> int:
        """Number of planned runs."""
        return self._stored.header.count

    @property
    def complete(self) -> bool:
        """Whether every run has its row."""
        return len(self) == self.count

    @property
    def runs(self) -> np.ndarray:
        """Numbers of the runs that have a row, ascending."""
        return self._stored.table["run"].to_numpy().copy()

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the table: run, status, message, values, quantities, wall time, worker."""
        return self._stored.header.columns

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths in the scene that vary."""
        return self._keys("values")

    @property
    def quantities(self) -> tuple[str, ...]:
        """Outputs of each run."""
        return self._keys("quantities")

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Version, computer and time of the start."""
        return dict(self._stored.header.provenance)

    @cached_property
    def scene(self) -> Scene:
        """The scene that is varied."""
        from multiarm.scene import parse_scene

        text, folder = self._stored.texts["scene"], self._stored.header.folder
        return parse_scene(text, folder, self._code)

    @property
    def text(self) -> str:
        """The sweep as YAML."""
        return self._stored.texts["sweep"]

    @cached_property
    def plan(self) -> SweepPlan:
        """The plan: values of each run."""
        from multiarm.sweeps.plan import plan_of

        return plan_of(self.scene, self.text)

    @cached_property
    def status_counts(self) -> dict[str, int]:
        """Status -> runs, the most frequent first."""
        return status_counts(self._stored.table)

    @cached_property
    def table(self) -> dict[str, np.ndarray]:
        """All columns by name, in the order of the runs; missing numbers are NaN.

        ``pandas.DataFrame(sweep.table)`` makes a data frame of it.
        """
        return self.select()

    def select(
        self,
        columns: Iterable[str] | None = None,
        *,
        status: str | None = None,
        where: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """Some columns of some runs, in the order of the runs.

        Parameters
        ----------
        columns : iterable of str, optional
            Default: all.
        status : str, optional
            Select runs with this status.
        where : mapping, optional
            Select runs by name of a column -> value, or (lowest, highest) of a number.

        Raises
        ------
        SweepError
            There is no such column, with the alternatives.
        """
        stored = self._stored
        named = {column.name: column for column in stored.header.columns}
        wanted = list(named if columns is None else columns)
        conditions = dict(where or {}) | ({} if status is None else {"status": status})
        for name in (*wanted, *conditions):
            if name not in named:
                raise SweepError(unknown("column", name, named))
        fits = np.ones(len(self), dtype=bool)
        for name, condition in conditions.items():
            fits &= [_fits(value, condition) for value in named[name].values(stored.table)]
        table = stored.table.filter(fits)
        return {name: numpy_column(table, named[name]) for name in wanted}

    def rows(self) -> Iterator[Record]:
        """The records in the order of the runs."""
        return records(self._stored.table, self.columns)

    def row(self, run: int) -> Record:
        """The record of one run.

        Raises
        ------
        SweepError
            There is no such run, or it has no record yet.
        """
        require_run(run, self.count)
        place = np.flatnonzero(self.runs == run)
        if not len(place):
            raise SweepError(f"run {run} has not been made yet; resume the sweep")
        return next(records(self._stored.table.slice(place[0], 1), self.columns))

    def summary(self) -> SweepSummary:
        """How the runs ended and how each quantity spreads."""
        return summarise(self._stored)

    def values_of(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of one run, also of a run that has not been made.

        Raises
        ------
        SweepError
            There is no such run.
        """
        return self.plan.values(run)

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

        Warns when the version of the program, a file or a function that the sweep names has
        changed: the numbers may differ then.

        Raises
        ------
        SweepError
            There is no such run.
        SceneError
            Its scene names code, and :func:`load_sweep` was called without ``code``.
        """
        from multiarm.sweeps.worker import simulate_run

        require_run(run, self.count)
        differs = differences(self._stored, self.plan)
        if differs:
            warnings.warn(
                f"this run may give other numbers than its row has: {'; '.join(differs)}",
                stacklevel=2,
            )
        return simulate_run(self.plan, run)

    def to_csv(self, path: str | os.PathLike) -> Path:
        """Write the table as CSV.

        Raises
        ------
        MultiarmError
            The file cannot be written.
        """
        return write_csv(self._stored.table, self.columns, path)

    def to_parquet(self, path: str | os.PathLike) -> Path:
        """Write the table as Parquet.

        Raises
        ------
        MultiarmError
            The file cannot be written.
        """
        texts = {name: self._stored.texts[name] for name in ("scene", "sweep")}
        return write_parquet(self._stored.table, self.columns, path, texts)

    def close(self) -> None:
        """Release the rows; nothing more can be read."""
        del self._stored

    def _keys(self, group: str) -> tuple[str, ...]:
        return tuple(column.key for column in self.columns if column.group == group)


def load_sweep(path: str | os.PathLike, code: bool = False) -> Sweep:
    """Read the file of a sweep, complete or not, without loading the code that it names.

    Parameters
    ----------
    path : path-like
    code : bool
        Whether ``sweep.trajectory(run)``, which simulates a run again, may load the functions and
        effects of packages that the scene names; without, it raises if there are any.

    Raises
    ------
    SweepError
        The file cannot be read, or is no sweep.
    """
    return Sweep(path, code)


def _fits(value: Any, condition: Any) -> bool:
    if isinstance(condition, tuple):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and condition[0] <= value <= condition[1]
    return bool(value == condition)


# --- the summary ----------------------------------------------------------------------------------

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of every quantity."""
FAILURES = 8
"""Different messages of failed runs in a summary, at most."""
_NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Spread:
    """Statistics of a quantity over the runs that have it.

    Attributes
    ----------
    name, unit, words : str
    count : int
        Runs that have it.
    smallest, largest, mean : float or None
        None if no run has it, or it is beyond the range of floats.
    smallest_run, largest_run : int or None
        The first runs with these values.
    quantiles : dict
        Level, 0 to 1 -> value.
    """

    name: str
    unit: str
    words: str
    count: int
    smallest: float | None = None
    smallest_run: int | None = None
    largest: float | None = None
    largest_run: int | None = None
    mean: float | None = None
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
    """A summary of a sweep.

    Attributes
    ----------
    count, done : int
        Planned and finished runs.
    statuses : dict
        Status -> runs.
    wall_time : float
        [s] Sum over all runs.
    spreads : tuple of Spread
    failures : tuple of Failure
        Messages of runs that did not complete, at most 8 different ones.
    """

    count: int
    done: int
    statuses: dict[str, int]
    wall_time: float
    spreads: tuple[Spread, ...]
    failures: tuple[Failure, ...]

    def figures(self) -> dict[str, Any]:
        """The summary as JSON data."""
        data = asdict(self)
        for spread in data["spreads"]:
            spread["quantiles"] = {f"{level:g}": v for level, v in spread["quantiles"].items()}
        return data


def summarise(stored: StoredSweep) -> SweepSummary:
    """The summary of a stored sweep."""
    table = stored.table
    return SweepSummary(
        count=stored.header.count,
        done=len(table),
        statuses=status_counts(table),
        wall_time=math.fsum(table["wall_time"].to_pylist()),
        spreads=tuple(
            _spread(table, own) for own in stored.header.columns if own.group == "quantities"
        ),
        failures=_failures(table),
    )


def status_counts(table: pa.Table) -> dict[str, int]:
    """Status -> runs, the most frequent first."""
    found = {own["values"]: own["counts"] for own in table["status"].value_counts().to_pylist()}
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _spread(table: pa.Table, column: Column) -> Spread:
    there = table.select(["run", column.name]).drop_null()
    runs, values = (own.to_numpy() for own in there.columns)
    spread = Spread(column.name, column.unit, column.words, len(values))
    if not len(values):
        return spread
    values = values + 0.0  # -0.0 becomes 0.0
    first, last = int(np.argmin(values)), int(np.argmax(values))
    with np.errstate(invalid="ignore"):  # between infinite values
        quantiles = np.quantile(values, LEVELS).tolist()
    return replace(
        spread,
        smallest=_finite(values[first]),
        smallest_run=int(runs[first]),
        largest=_finite(values[last]),
        largest_run=int(runs[last]),
        mean=_mean(values),
        quantiles=dict(zip(LEVELS, map(_finite, quantiles), strict=True)),
    )


def _mean(values: np.ndarray) -> float | None:
    """The mean, from a sum that is rounded once; None if that exceeds the range of floats."""
    try:
        return _finite(math.fsum(values) / len(values))
    except (OverflowError, ValueError):  # too large; of infinite values with both signs
        return None


def _failures(table: pa.Table) -> tuple[Failure, ...]:
    """The different messages of runs that did not complete, the first few."""
    found: dict[tuple[str, str], Failure] = {}
    failed = table.filter(pc.not_equal(table["status"], "completed"))
    for row in failed.select(["run", "status", "message"]).to_pylist():
        key = row["status"], _NUMBER.sub("#", row["message"])
        if key not in found and len(found) == FAILURES:
            continue
        known = found.get(key, Failure(row["status"], row["message"], 0, row["run"]))
        found[key] = replace(known, runs=known.runs + 1)
    return tuple(found.values())


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
