"""The table of a sweep: one row a run, with columns whose types follow from the sweep.

Columns are the run's number, status and message, the values that vary, the quantities, and what was
measured.  A missing number is null.  Values that have no type in common (texts and numbers, lists,
tables) are JSON.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import parquet
from pydantic import ConfigDict

from multiarm.results.files import atomic_output, printable
from multiarm.sweeps.plan import Record, SweepPlan

__all__ = [
    "TYPES",
    "Column",
    "columns_of",
    "numpy_column",
    "records",
    "schema_of",
    "table_of",
    "write_csv",
    "write_parquet",
]

Group = Literal["fixed", "values", "quantities", "measured"]
Type = Literal["bool", "int64", "float64", "string", "json"]
TYPES: dict[Type, pa.DataType] = {
    "bool": pa.bool_(),
    "int64": pa.int64(),
    "float64": pa.float64(),
    "string": pa.string(),
    "json": pa.string(),
}


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
    type : str
        "bool", "int64", "float64", "string", or "json": values of several types, lists, tables.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")  # of columns that a file describes

    name: str
    group: Group
    key: str
    unit: str
    words: str
    type: Type = "float64"

    def cell(self, record: Record) -> Any:
        """The entry of a record, as the table holds it."""
        if self.group in _OWN:
            value = getattr(record, self.key)
            return printable(value) if self.type == "string" else value
        value = getattr(record, self.group)[self.key]
        return json.dumps(value) if self.type == "json" else value

    def values(self, table: pa.Table) -> list[Any]:
        """The values in a table; null is None."""
        cells = table[self.name].to_pylist()
        return [json.loads(cell) for cell in cells] if self.type == "json" else cells


_OWN = ("fixed", "measured")
"""Groups whose columns are attributes of a record."""
FIXED = (
    Column("run", "fixed", "run", "", "number of the run, from 1 on", "int64"),
    Column("status", "fixed", "status", "", "how it ended", "string"),
    Column("message", "fixed", "message", "", "why it did not complete", "string"),
)
MEASURED = (
    Column("wall_time", "measured", "wall_time", "s", "time that the run took"),
    Column(
        "worker", "measured", "worker", "", "computer and process that carried it out", "string"
    ),
)


def columns_of(plan: SweepPlan) -> tuple[Column, ...]:
    """The columns of a sweep's table; their types follow from the sweep, not from its rows."""
    taken = {column.name for column in (*FIXED, *MEASURED)}
    values = [
        Column(
            f"$.{path}" if path in taken else path,
            "values", path, "", "value in the scene", type_of(plan.examples(path)),
        )
        for path in plan.paths
    ]  # fmt: skip
    taken |= {column.name for column in values}
    quantities = [
        Column(
            f"quantity {own.name}" if own.name in taken else own.name,
            "quantities", own.name, own.unit, own.words,
        )
        for own in plan.quantities
    ]  # fmt: skip
    return (*FIXED, *values, *quantities, *MEASURED)


def type_of(values: Iterable[Any]) -> Type:
    """The type of a column for these values: one that leaves them equal to what they are."""
    values = list(values)
    types = {type(value) for value in values}
    if types == {bool}:
        return "bool"
    if types == {str} and all(value == printable(value) for value in values):
        return "string"
    numbers, missing = types & {int, float}, types - {int, float}
    exact = all(abs(value) < 2**53 for value in values if type(value) is int)
    if numbers and exact and missing <= {type(None)}:
        return "int64" if types == {int} else "float64"
    return "json"


def table_of(rows: Sequence[Record], columns: Sequence[Column]) -> pa.Table:
    """Records as a table."""
    schema = schema_of(columns)
    arrays = [
        pa.array([column.cell(row) for row in rows], field.type)
        for column, field in zip(columns, schema, strict=True)
    ]
    return pa.table(arrays, schema=schema)


def schema_of(columns: Sequence[Column]) -> pa.Schema:
    """The columns for Arrow, with unit and description as metadata."""
    return pa.schema(
        pa.field(
            own.name,
            TYPES[own.type],
            metadata={"unit": own.unit, "description": own.words, "kind": own.group},
        )
        for own in columns
    )


def records(table: pa.Table, columns: Sequence[Column]) -> Iterator[Record]:
    """The records in a table, converted in blocks."""
    for block in table.to_batches(max_chunksize=1024):
        part = pa.table(block)
        entries = {own: own.values(part) for own in columns}
        for k in range(len(part)):
            row: dict[str, Any] = {"values": {}, "quantities": {}}
            for own, column in entries.items():
                (row if own.group in _OWN else row[own.group])[own.key] = column[k]
            yield Record(**row)


def numpy_column(table: pa.Table, column: Column) -> np.ndarray:
    """A column as an array: numbers, truth values or texts, else objects.

    A missing quantity is NaN; a missing value, which the sweep gave, is None.
    """
    entries = table[column.name]
    if column.type == "string":
        return np.array(entries.to_pylist(), dtype=np.str_)
    if column.type == "json" or (column.group == "values" and entries.null_count):
        array = np.empty(len(entries), dtype=object)
        array[:] = column.values(table)
        return array
    return entries.to_numpy()


def _exported(table: pa.Table, columns: Sequence[Column]) -> pa.Table:
    """The table for other programs: a null in JSON is a missing entry."""
    for k, column in enumerate(columns):
        if column.type == "json":
            cells = table[column.name]
            given = pc.if_else(pc.equal(cells, "null"), pa.scalar(None, pa.string()), cells)
            table = table.set_column(k, table.schema.field(k), given)
    return table


def write_csv(table: pa.Table, columns: Sequence[Column], path: str | os.PathLike) -> Path:
    """Write a table as CSV with a header; numbers are written without loss.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    with (
        atomic_output(Path(path), "CSV") as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(table.column_names)
        for block in _exported(table, columns).to_batches():
            writer.writerows(zip(*block.to_pydict().values(), strict=True))
    return Path(path)


def write_parquet(
    table: pa.Table, columns: Sequence[Column], path: str | os.PathLike, texts: Mapping[str, str]
) -> Path:
    """Write a table as Parquet, with ``texts`` as its metadata.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    with atomic_output(Path(path), "Parquet") as partial:
        described = _exported(table, columns).replace_schema_metadata(dict(texts))
        parquet.write_table(described, partial, row_group_size=8192)
    return Path(path)
