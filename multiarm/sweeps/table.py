"""The table of a sweep, read from its file in the order of the runs, a block at a time.

Rows lie in the file as runs ended; one whole number a run says where each lies.  Nothing else grows
with the number of runs, except what is asked for as a whole.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import SweepError
from multiarm.scene.faults import unknown
from multiarm.sweeps.packing import QUANTITIES, VALUES, unpack
from multiarm.sweeps.row import Row
from multiarm.sweeps.row_file import RowReader

__all__ = ["Column", "SweepTable", "cell", "collected"]

BLOCK = 1024
"""Rows in memory at once."""
FIXED = (
    ("run", "number of the run, from 1 on"),
    ("status", "how it ended"),
    ("message", "why it did not complete"),
)
MEASURED = (("wall_time", "s", "time that the run took"), ("worker", "", "who carried it out"))


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes
    ----------
    name : str
        In the table; that of a path or quantity, unless it is taken.
    group : str
        "fixed", "values", "quantities" or "measured": the last may differ when a run is repeated.
    key : str
        The path or the quantity.
    unit, words : str
    """

    name: str
    group: str
    key: str
    unit: str
    words: str


class SweepTable:
    """Rows of a sweep's file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    SweepError
        The file cannot be read, or is no sweep.

    Attributes
    ----------
    header : dict
        What the file says of itself.
    columns : tuple of Column
    runs : ndarray
        Numbers of the runs that have a row, ascending.
    """

    def __init__(self, path: Path):
        self._reader = RowReader(path)
        self.header = json.loads(self._reader.text("header"))
        self.columns = _columns(self.header["paths"], self.header["quantities"])
        self.runs, self._places = self._index()

    def __len__(self) -> int:
        return len(self.runs)

    def text(self, name: str) -> str:
        """``"scene"`` or ``"sweep"``, as YAML text."""
        return self._reader.text(name)

    def rows(self, start: int = 0, stop: int | None = None) -> Iterator[Row]:
        """Rows in the order of the runs, ``start`` to ``stop`` of them."""
        stop = len(self) if stop is None else min(stop, len(self))
        for low in range(start, stop, BLOCK):
            yield from unpack(self._reader.picked(self._places[low : min(low + BLOCK, stop)]))

    def row(self, run: int) -> Row | None:
        """The row of a run, None where it has none yet."""
        at = int(np.searchsorted(self.runs, run))
        if at == len(self) or self.runs[at] != run:
            return None
        return next(self.rows(at, at + 1))

    def blocks(self, columns: Sequence[Column], rows: int = BLOCK) -> Iterator[dict[str, list]]:
        """Some columns, by their names, a bounded number of rows at a time."""
        for low in range(0, len(self), rows):
            found = list(self.rows(low, low + rows))
            yield {column.name: [cell(row, column) for row in found] for column in columns}

    def numbers(self, column: Column, start: int = 0, stop: int | None = None) -> np.ndarray:
        """What of a column is numbers, in the order of the file; NaN for what is none.

        Raises
        ------
        SweepError
            The column has texts only.
        """
        stop = self._reader.count if stop is None else stop
        if column.group in (VALUES, QUANTITIES):
            return self._reader.field(column.group, start, stop)[column.key]
        if column.name in ("run", "wall_time"):
            return self._reader.field(column.name, start, stop).astype(float)
        raise SweepError(f"'{column.name}' is no number")

    def statuses(self, start: int, stop: int) -> np.ndarray:
        """Statuses in the order of the file, as bytes."""
        return self._reader.field("status", start, stop)

    def column(self, name: str) -> Column:
        """The column of a name.

        Raises
        ------
        SweepError
            There is none, with the alternatives.
        """
        found = {column.name: column for column in self.columns}
        if name not in found:
            raise SweepError(unknown("column", name, found))
        return found[name]

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._reader.close()

    def _index(self) -> tuple[np.ndarray, np.ndarray]:
        """Runs, ascending, and where their rows lie."""
        count = self._reader.count
        runs = np.empty(count, dtype=np.int64)
        for low in range(0, count, BLOCK):
            runs[low : low + BLOCK] = self._reader.field("run", low, low + BLOCK)
        return np.unique(runs, return_index=True)


def cell(row: Row, column: Column) -> Any:
    """What a row has in a column."""
    if column.group == VALUES:
        return row.values[column.key]
    if column.group == QUANTITIES:
        return row.quantities[column.key]
    return getattr(row, column.key)


def collected(column: Column, cells: list) -> np.ndarray:
    """A column as an array: whole numbers, floats with NaN for null, or objects."""
    kinds = {type(value) for value in cells}
    if column.group == QUANTITIES or kinds == {float}:
        return np.array([np.nan if value is None else value for value in cells], dtype=float)
    if kinds == {bool}:
        return np.array(cells, dtype=bool)
    if kinds == {int} and max(map(abs, cells)) < 2**63:
        return np.array(cells, dtype=np.int64)
    if kinds and kinds <= {float, int} and all(float(value) == value for value in cells):
        return np.array(cells, dtype=float)
    if kinds == {str}:
        return np.array(cells, dtype=np.str_)
    array = np.empty(len(cells), dtype=object)
    array[:] = cells
    return array


def _columns(paths: Sequence[str], quantities: Sequence[Mapping[str, str]]) -> tuple[Column, ...]:
    columns = [Column(name, "fixed", name, "", words) for name, words in FIXED]
    taken = {name for name, _ in FIXED} | {name for name, _, _ in MEASURED}
    for path in paths:
        name = f"$.{path}" if path in taken else path
        columns.append(Column(name, VALUES, path, "", "value in the scene"))
    taken |= {column.name for column in columns}
    for own in quantities:
        name = f"quantity {own['name']}" if own["name"] in taken else own["name"]
        columns.append(Column(name, QUANTITIES, own["name"], own["unit"], own["words"]))
    measured = [Column(name, "measured", name, unit, words) for name, unit, words in MEASURED]
    return (*columns, *measured)
