"""The record of a run, and its lossless conversion to an entry of the sweep's file and back.

Every number has a field of its own.  Values that are no floats (integers, texts, lists, null) are
stored in the entry's text as JSON.  Numbers among them fill their field as well, so that other
programs can read them from the table.  A field without a number is NaN.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.sweeps.row_file import TEXT, Block

__all__ = ["fields_of", "pack", "unpack"]


@dataclass(frozen=True)
class Record:
    """Inputs, status and outputs of one run of a sweep.

    All but ``wall_time`` and ``worker`` follow from the scene, the sweep and the run's number.

    Attributes
    ----------
    run : int
        From 1 on.
    status : {"completed", "failed"}
        Also "failed" if the run completed but a user-defined quantity raised an error; the other
        quantities are there.
    message : str
        How the run ended and, after a failure, the remedy.
    values : mapping
        Path in the scene -> value in this run.
    quantities : mapping
        Name -> number, in the quantity's unit; None if the run failed or the quantity is not
        defined for it.
    wall_time : float
        [s]
    worker : str
        Computer and process of the run.
    """

    run: int
    status: str
    message: str
    values: Mapping[str, Any]
    quantities: Mapping[str, float | None]
    wall_time: float
    worker: str


VALUES, QUANTITIES = "values", "quantities"
STATUS_BYTES = 16


def fields_of(paths: Sequence[str], quantities: Sequence[str]) -> np.dtype:
    """Data type of an entry with these values and quantities."""
    given = {VALUES: paths, QUANTITIES: quantities}
    groups = [(group, [(name, "<f8") for name in names]) for group, names in given.items() if names]
    fixed = [("run", "<i8"), ("status", f"S{STATUS_BYTES}"), ("wall_time", "<f8")]
    return np.dtype([*fixed, *groups, (TEXT, "<i8", (2,))])


def pack(records: Sequence[Record], fields: np.dtype) -> Block:
    """Entries and texts of some records."""
    entries = np.zeros(len(records), fields)
    texts = []
    for k, record in enumerate(records):
        entries[k]["run"], entries[k]["wall_time"] = record.run, record.wall_time
        entries[k]["status"] = record.status.encode("ascii")
        for group, numbers in ((VALUES, record.values), (QUANTITIES, record.quantities)):
            for name in _names(fields, group):
                entries[group][name][k] = _number(numbers.get(name))
        rest = {path: value for path, value in record.values.items() if type(value) is not float}
        text = {"message": record.message, "worker": record.worker, VALUES: rest}
        texts.append(json.dumps({key: value for key, value in text.items() if value}))
    return entries, texts


def unpack(block: Block) -> list[Record]:
    """The records of packed entries."""
    entries, texts = block
    paths, names = (_names(entries.dtype, group) for group in (VALUES, QUANTITIES))
    values = [entries[VALUES][path].tolist() for path in paths]
    found = [entries[QUANTITIES][name].tolist() for name in names]
    records = []
    for k, text in enumerate(texts):
        others = json.loads(text) if text else {}
        rest = others.get(VALUES, {})
        records.append(
            Record(
                run=int(entries["run"][k]),
                status=entries["status"][k].decode("ascii"),
                message=others.get("message", ""),
                values={
                    path: rest[path] if path in rest else column[k]
                    for path, column in zip(paths, values, strict=True)
                },
                quantities={
                    name: None if math.isnan(column[k]) else column[k]
                    for name, column in zip(names, found, strict=True)
                },
                wall_time=float(entries["wall_time"][k]),
                worker=others.get("worker", ""),
            )
        )
    return records


def _names(fields: np.dtype, group: str) -> tuple[str, ...]:
    if group not in (fields.names or ()):
        return ()
    return fields[group].names or ()


def _number(value: Any) -> float:
    """The value as a float; NaN if it is none."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return math.nan
    return math.nan
