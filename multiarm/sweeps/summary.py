"""Summary of a sweep: how its runs ended, and how each quantity spreads.

One quantity is in memory at a time.  Sums are rounded once, so that no number depends on the order
in which runs ended.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from multiarm.sweeps.table import BLOCK, Column, SweepTable

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
        None if no run has it, or it is infinite.
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


def summarise(table: SweepTable) -> SweepSummary:
    """Read a sweep's table, one quantity at a time."""
    statuses = status_counts(table)
    quantities = [column for column in table.columns if column.group == "quantities"]
    return SweepSummary(
        count=table.header["count"],
        done=len(table),
        statuses=statuses,
        wall_time=math.fsum(_numbers(table, table.column("wall_time"))),
        spreads=tuple(_spread(table, column) for column in quantities),
        failures=_failures(table, statuses),
    )


def status_counts(table: SweepTable) -> dict[str, int]:
    """Status -> runs, the most frequent first."""
    found: Counter[str] = Counter()
    for low in range(0, len(table), BLOCK):
        names, counts = np.unique(table.statuses(low, low + BLOCK), return_counts=True)
        for name, count in zip(names.tolist(), counts.tolist(), strict=True):
            found[name.decode("ascii")] += count
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _spread(table: SweepTable, column: Column) -> Spread:
    values, runs = _numbers(table, column), _numbers(table, table.column("run"))
    present = ~np.isnan(values)
    values, runs = values[present], runs[present]
    unit = Spread(column.name, column.unit, column.words, len(values))
    if not len(values):
        return unit
    smallest, largest = values.min(), values.max()
    mean = None
    if math.isfinite(smallest) and math.isfinite(largest):
        try:
            mean = math.fsum(values) / len(values)
        except OverflowError:  # the sum exceeds the range of floats, the mean does not
            mean = math.fsum(value / len(values) for value in values)
    return replace(
        unit,
        smallest=_finite(smallest),
        smallest_run=int(runs[values == smallest].min()),
        largest=_finite(largest),
        largest_run=int(runs[values == largest].min()),
        mean=mean,
        quantiles=dict(zip(LEVELS, map(_finite, quantiles(values, LEVELS)), strict=True)),
    )


def quantiles(values: np.ndarray, levels: Sequence[float]) -> list[float]:
    """Quantiles, linear between neighbours as in ``numpy.quantile``, also next to infinite values.

    Parameters
    ----------
    values : ndarray
        At least one, none of them NaN.
    levels : sequence of float
        0 to 1.
    """
    ordered, found = np.sort(values), []
    for level in levels:
        place = level * (len(values) - 1)
        low, high = float(ordered[math.floor(place)]), float(ordered[math.ceil(place)])
        share = place - math.floor(place)
        found.append(low if low == high else low + share * (high - low))
    return found


def _numbers(table: SweepTable, column: Column) -> np.ndarray:
    """The numbers of a column in the order of the file, read in blocks; -0.0 becomes 0.0."""
    blocks = [table.numbers(column, low, low + BLOCK) for low in range(0, len(table), BLOCK)]
    return np.concatenate(blocks) + 0.0 if blocks else np.zeros(0)


def _failures(table: SweepTable, statuses: dict[str, int]) -> tuple[Failure, ...]:
    """The different messages of runs that did not complete, the first few."""
    found: dict[tuple[str, str], Failure] = {}
    if set(statuses) <= {"completed"}:
        return ()
    for row in table.rows():
        key = row.status, _NUMBER.sub("#", row.message)
        if row.status == "completed" or (key not in found and len(found) == FAILURES):
            continue
        known = found.get(key, Failure(row.status, row.message, 0, row.run))
        found[key] = replace(known, runs=known.runs + 1)
    return tuple(found.values())


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
