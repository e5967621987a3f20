"""Summary of a sweep: how its runs ended, and how each quantity spreads.

Rows are in the order of the runs, so that no number depends on the order in which they ended.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from multiarm.sweeps.store import StoredSweep
from multiarm.sweeps.table import Column

__all__ = ["LEVELS", "Failure", "Spread", "SweepSummary", "summarise"]

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
        count=stored.header["count"],
        done=len(table),
        statuses=status_counts(table),
        wall_time=math.fsum(table["wall_time"].to_pylist()),
        spreads=tuple(_spread(table, own) for own in stored.columns if own.group == "quantities"),
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
