"""The table of a sweep as CSV and Parquet, a block of rows at a time.

The type of a column is found in a first reading: whole numbers, numbers, truth values, texts; what
is mixed, or a list or a table, is written as JSON.  Null is an empty cell in CSV and a null in
Parquet, whose fields have unit and meaning beside them.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from multiarm.errors import SweepError
from multiarm.results.files import atomic_output
from multiarm.sweeps.packing import VALUES
from multiarm.sweeps.table import Column, SweepTable

__all__ = ["kinds_of", "write_csv", "write_parquet"]

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
    """Write the table as CSV with a line of names; numbers give back what they were.

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
            written = [_written(block[name], kind) for name, kind in kinds.items()]
            writer.writerows(zip(*written, strict=True))
    return Path(path)


def require_pyarrow() -> None:
    """See to it that Parquet files can be written, best before the long work.

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
    """Write the table as Parquet, by groups of rows.

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
    """What each column holds: bool, int64, float64, string or json."""
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
    """The first kind that takes all values, of null too; whole numbers must stay what they are."""
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
