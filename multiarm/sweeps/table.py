"""The table of a sweep, read from its file in blocks, in the order of the runs; CSV and Parquet.

The file holds rows in the order in which runs ended; an index of one integer a run finds them.
Nothing else grows with the number of runs, except columns that are requested as a whole.

A first pass finds the type of every column for the export: integers, numbers, truth values or
texts; mixed columns, lists and tables are written as JSON.  Null is an empty cell in CSV and a null
in Parquet, whose fields carry unit and description as metadata.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import SweepError
from multiarm.results.files import atomic_output
from multiarm.scene.faults import unknown
from multiarm.sweeps.records import QUANTITIES, VALUES, Record, unpack
from multiarm.sweeps.row_file import RowReader

__all__ = ["Column", "SweepTable", "cell", "collected", "kinds_of", "write_csv", "write_parquet"]


BLOCK = 1024
"""Rows in memory at once."""
FIXED = (
    ("run", "number of the run, from 1 on"),
    ("status", "how it ended"),
    ("message", "why it did not complete"),
)
MEASURED = (
    ("wall_time", "s", "time that the run took"),
    ("worker", "", "computer and process that carried it out"),
)


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes
    ----------
    name : str
        In the table; a path or quantity, prefixed if another column has this name.
    group : str
        "fixed", "values", "quantities" or "measured"; the last may differ when a run is repeated.
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
        Metadata of the file.
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

    def rows(self, start: int = 0, stop: int | None = None) -> Iterator[Record]:
        """Records ``start`` to ``stop`` in the order of the runs."""
        stop = len(self) if stop is None else min(stop, len(self))
        for low in range(start, stop, BLOCK):
            yield from unpack(self._reader.picked(self._places[low : min(low + BLOCK, stop)]))

    def row(self, run: int) -> Record | None:
        """The record of a run, None if it has none yet."""
        at = int(np.searchsorted(self.runs, run))
        if at == len(self) or self.runs[at] != run:
            return None
        return next(self.rows(at, at + 1))

    def blocks(self, columns: Sequence[Column], rows: int = BLOCK) -> Iterator[dict[str, list]]:
        """Some columns by name, in blocks of rows."""
        for low in range(0, len(self), rows):
            yield self._block(columns, low, low + rows)

    def numbers(self, column: Column, start: int = 0, stop: int | None = None) -> np.ndarray:
        """The numbers of a column in the order of the file; NaN for other values.

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
        """The column with this name.

        Raises
        ------
        SweepError
            There is none; the message lists the alternatives.
        """
        found = {column.name: column for column in self.columns}
        if name not in found:
            raise SweepError(unknown("column", name, found))
        return found[name]

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._reader.close()

    def _block(self, columns: Sequence[Column], start: int, stop: int) -> dict[str, list]:
        records = list(self.rows(start, stop))
        return {column.name: [cell(record, column) for record in records] for column in columns}

    def _index(self) -> tuple[np.ndarray, np.ndarray]:
        """Runs, ascending, and the indices of their rows in the file."""
        count = self._reader.count
        runs = np.empty(count, dtype=np.int64)
        for low in range(0, count, BLOCK):
            runs[low : low + BLOCK] = self._reader.field("run", low, low + BLOCK)
        return np.unique(runs, return_index=True)


def cell(row: Record, column: Column) -> Any:
    """The value of a record in a column."""
    if column.group == VALUES:
        return row.values[column.key]
    if column.group == QUANTITIES:
        return row.quantities[column.key]
    return getattr(row, column.key)


def collected(column: Column, cells: list) -> np.ndarray:
    """A column as an array: integers, floats with NaN for null, or objects."""
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


GROUP_ROWS = 8192
"""Rows of a group of a Parquet file."""
_KINDS: dict[str, tuple[type, ...]] = {
    "bool": (bool,),
    "int64": (int,),
    "float64": (float, int),
    "string": (str,),
}
JSON = "json"


def write_csv(table: SweepTable, path: str | os.PathLike) -> Path:
    """Write the table as CSV with a header; numbers are written without loss.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    kinds = kinds_of(table)
    with (
        atomic_output(Path(path), "CSV") as partial,
        partial.open("w", newline="", encoding="utf-8", errors="backslashreplace") as f,
    ):
        writer = csv.writer(f)
        writer.writerow([column.name for column in table.columns])
        for block in table.blocks(table.columns):
            written = [_written(block.pop(name), kind) for name, kind in kinds.items()]
            writer.writerows(zip(*written, strict=True))
            written.clear()  # before the next block is read: one of them is in memory at a time
    return Path(path)


def require_pyarrow() -> None:
    """Check that Parquet files can be written, before a long computation.

    Raises
    ------
    SweepError
        PyArrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise SweepError(
            "Parquet files need PyArrow, which is not installed: pip install pyarrow; or write CSV"
        ) from None


def write_parquet(table: SweepTable, path: str | os.PathLike) -> Path:
    """Write the table as Parquet, in row groups.

    Raises
    ------
    MultiarmError
        PyArrow is not installed, or the file cannot be written.
    """
    require_pyarrow()
    import pyarrow as arrow
    from pyarrow import parquet

    kinds = kinds_of(table)
    schema = arrow.schema([_field(arrow, column, kinds[column.name]) for column in table.columns])
    schema = schema.with_metadata({name: table.text(name) for name in ("scene", "sweep")})
    with (
        atomic_output(Path(path), "Parquet") as partial,
        parquet.ParquetWriter(partial, schema) as writer,
    ):
        for block in table.blocks(table.columns, GROUP_ROWS):
            cells = [_written(block[name], kind) for name, kind in kinds.items()]
            arrays = [
                arrow.array(own, field.type) for own, field in zip(cells, schema, strict=True)
            ]
            writer.write_table(arrow.table(arrays, schema=schema))
    return Path(path)


def kinds_of(table: SweepTable) -> dict[str, str]:
    """Name of a column -> its type: bool, int64, float64, string or json."""
    kinds = {column.name: _FIXED_KINDS.get(column.name, "float64") for column in table.columns}
    varied = [column for column in table.columns if column.group == VALUES]
    seen: dict[str, set[type]] = {column.name: set() for column in varied}
    small = dict.fromkeys(seen, True)
    for block in table.blocks(varied):
        for name, cells in block.items():
            seen[name] |= {type(value) for value in cells}
            small[name] &= all(abs(value) < 2**53 for value in cells if type(value) is int)
    return kinds | {name: _kind(own, small[name]) for name, own in seen.items()}


_FIXED_KINDS = {"run": "int64", "status": "string", "message": "string", "worker": "string"}


def _kind(types: set[type], small: bool) -> str:
    """The first type that holds all values, null included, without rounding integers."""
    types = types - {type(None)}
    fitting = (kind for kind, taken in _KINDS.items() if types and types <= set(taken))
    return next(fitting, JSON) if small else JSON


def _written(cells: Sequence[Any], kind: str) -> Sequence[Any]:
    if kind == JSON:
        return [None if value is None else json.dumps(value) for value in cells]
    return cells


def _field(arrow: Any, column: Column, kind: str) -> Any:
    types: dict[str, Callable[[], Any]] = {
        "bool": arrow.bool_, "int64": arrow.int64, "float64": arrow.float64,
        "string": arrow.string, JSON: arrow.string,
    }  # fmt: skip
    words = {"unit": column.unit, "description": column.words, "kind": column.group}
    return arrow.field(column.name, types[kind](), metadata=words)
