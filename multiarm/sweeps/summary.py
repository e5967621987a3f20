"""What a sweep says as a whole: how its runs ended, and how each quantity spreads.

Everything is read from the file block by block.  Quantiles are exact (see `order_statistics`), sums
are rounded once, so that neither depends on the order in which runs ended.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.sweeps.order_statistics import quantiles
from multiarm.sweeps.table import BLOCK, Column, SweepTable

if TYPE_CHECKING:
    from multiarm.sweeps.result import Sweep

__all__ = ["LEVELS", "Failure", "Spread", "SweepSummary", "summarise"]

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of every quantity."""
FAILURES = 8
"""Different messages of runs that did not complete, kept at most."""
_NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Spread:
    """How a quantity spreads over the runs that have it.

    Attributes
    ----------
    name, unit, words : str
    count : int
        Runs that have it.
    smallest, largest, mean : float or None
        None where no run has it, or where it is infinite.
    smallest_run, largest_run : int or None
        The first runs that have these.
    quantiles : dict
        Level, 0 to 1 -> value.
    """

    name: str
    unit: str
    words: str
    count: int
    smallest: float | None
    smallest_run: int | None
    largest: float | None
    largest_run: int | None
    mean: float | None
    quantiles: dict[float, float | None]


@dataclass(frozen=True)
class Failure:
    """Runs that ended with one message, but for the numbers in it; that of the first of them."""

    status: str
    message: str
    runs: int
    first_run: int


@dataclass(frozen=True)
class SweepSummary:
    """A sweep as a whole.

    Attributes
    ----------
    count, done : int
        Runs that there are to be, and those that have ended.
    statuses : dict
        Status -> runs.
    wall_time : float
        [s] of all runs, one after the other.
    spreads : tuple of Spread
    failures : tuple of Failure
        The messages of the first runs that did not complete.
    """

    count: int
    done: int
    statuses: dict[str, int]
    wall_time: float
    spreads: tuple[Spread, ...]
    failures: tuple[Failure, ...]

    def figures(self) -> dict[str, Any]:
        """All of it, in what JSON knows."""
        data = asdict(self)
        for spread in data["spreads"]:
            spread["quantiles"] = {f"{level:g}": v for level, v in spread["quantiles"].items()}
        return data


def summarise(sweep: Sweep) -> SweepSummary:
    """Read a sweep through, in constant memory."""
    table = sweep.rows_table
    statuses = status_counts(table)
    shown = [column for column in table.columns if column.group == "quantities"]
    wall_time = math.fsum(_stream(table, table.column("wall_time")))
    return SweepSummary(
        count=sweep.count,
        done=len(table),
        statuses=statuses,
        wall_time=wall_time,
        spreads=tuple(_spread(table, column) for column in shown),
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
    count, extremes = 0, _Extremes()
    runs = table.column("run")
    for low in range(0, len(table), BLOCK):
        values = table.numbers(column, low, low + BLOCK)
        there = ~np.isnan(values)
        count += int(np.count_nonzero(there))
        extremes.see(values[there], table.numbers(runs, low, low + BLOCK)[there])
    levels = dict.fromkeys(LEVELS)
    if count:
        found = quantiles(lambda: _parts(table, column), count, LEVELS)
        levels = {level: _finite(value) for level, value in zip(LEVELS, found, strict=True)}
    mean = None
    if count and extremes.are_finite:
        try:
            mean = math.fsum(_stream(table, column)) / count
        except OverflowError:  # only their sum is beyond all numbers
            mean = math.fsum(value / count for value in _stream(table, column))
    return Spread(
        name=column.name,
        unit=column.unit,
        words=column.words,
        count=count,
        smallest=_finite(extremes.smallest[0]) if count else None,
        smallest_run=int(extremes.smallest[1]) if count else None,
        largest=_finite(-extremes.largest[0]) if count else None,
        largest_run=int(extremes.largest[1]) if count else None,
        mean=mean,
        quantiles=levels,
    )


class _Extremes:
    """The smallest and the largest number seen, and the first run that has it."""

    def __init__(self) -> None:
        self.smallest = self.largest = (math.inf, math.inf)

    @property
    def are_finite(self) -> bool:
        return math.isfinite(self.smallest[0]) and math.isfinite(self.largest[0])

    def see(self, values: np.ndarray, runs: np.ndarray) -> None:
        if len(values):
            self.smallest = min(self.smallest, _first(values, runs))
            self.largest = min(self.largest, _first(-values, runs))


def _first(values: np.ndarray, runs: np.ndarray) -> tuple[float, float]:
    lowest = values.min()
    return float(lowest), float(runs[values == lowest].min())


def _parts(table: SweepTable, column: Column) -> Iterator[np.ndarray]:
    for low in range(0, len(table), BLOCK):
        values = table.numbers(column, low, low + BLOCK)
        yield values[~np.isnan(values)]


def _stream(table: SweepTable, column: Column) -> Iterator[float]:
    for part in _parts(table, column):
        yield from part.tolist()


def _failures(table: SweepTable, statuses: dict[str, int]) -> tuple[Failure, ...]:
    """What runs that did not complete say; of more than a few things, the first ones."""
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
