"""Rows of a sweep as entries of its file, and back, without a loss.

A number has a field of its own.  What is no float (whole numbers, texts, lists, null) stands in the
row's text, as JSON, which gives back what was put in; numbers among it fill their field as well, so
that a table read without this program has them.  A field without a number is NaN.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from multiarm.sweeps.row import Row
from multiarm.sweeps.row_file import TEXT, Block

__all__ = ["fields_of", "pack", "unpack"]

VALUES, QUANTITIES = "values", "quantities"
STATUS_BYTES = 16


def fields_of(paths: Sequence[str], quantities: Sequence[str]) -> np.dtype:
    """Type of an entry for rows with these values and quantities."""
    given = {VALUES: paths, QUANTITIES: quantities}
    groups = [(group, [(name, "<f8") for name in names]) for group, names in given.items() if names]
    fixed = [("run", "<i8"), ("status", f"S{STATUS_BYTES}"), ("wall_time", "<f8")]
    return np.dtype([*fixed, *groups, (TEXT, "<i8", (2,))])


def pack(rows: Sequence[Row], fields: np.dtype) -> Block:
    """Entries and texts of some rows."""
    entries = np.zeros(len(rows), fields)
    texts = []
    for k, row in enumerate(rows):
        entries[k]["run"], entries[k]["wall_time"] = row.run, row.wall_time
        entries[k]["status"] = row.status.encode("ascii")
        for group, numbers in ((VALUES, row.values), (QUANTITIES, row.quantities)):
            for name in _names(fields, group):
                entries[group][name][k] = _number(numbers.get(name))
        rest = {path: value for path, value in row.values.items() if type(value) is not float}
        said = {"message": row.message, "worker": row.worker, VALUES: rest}
        texts.append(json.dumps({key: value for key, value in said.items() if value}))
    return entries, texts


def unpack(block: Block) -> list[Row]:
    """The rows that were packed so."""
    entries, texts = block
    paths, names = (_names(entries.dtype, group) for group in (VALUES, QUANTITIES))
    values = [entries[VALUES][path].tolist() for path in paths]
    found = [entries[QUANTITIES][name].tolist() for name in names]
    rows = []
    for k, text in enumerate(texts):
        said = json.loads(text) if text else {}
        rest = said.get(VALUES, {})
        rows.append(
            Row(
                run=int(entries["run"][k]),
                status=entries["status"][k].decode("ascii"),
                message=said.get("message", ""),
                values={
                    path: rest[path] if path in rest else column[k]
                    for path, column in zip(paths, values, strict=True)
                },
                quantities={
                    name: None if math.isnan(column[k]) else column[k]
                    for name, column in zip(names, found, strict=True)
                },
                wall_time=float(entries["wall_time"][k]),
                worker=said.get("worker", ""),
            )
        )
    return rows


def _names(fields: np.dtype, group: str) -> tuple[str, ...]:
    if group not in (fields.names or ()):
        return ()
    return fields[group].names or ()


def _number(value: Any) -> float:
    """What the field of a value holds."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return math.nan
    return math.nan
