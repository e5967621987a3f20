"""Tables of a recorded control: read from CSV, Parquet or HDF5, and checked cell by cell.

A table has a column of times [s], which increase, and one for each joint that it describes.  In
HDF5 a column is a data set of one axis, and its name is its path, such as ``left/elbow_joint``.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import SceneError
from multiarm.notation import count_of
from multiarm.scene.control import RecordedControl
from multiarm.scene.faults import listed, shown, unknown


@dataclass(frozen=True)
class Table:
    """Rows over time of some joints.

    Attributes
    ----------
    times : ndarray, shape (r,)
        [s], increasing.
    joints : list of str
        ``arm/joint`` of every column.
    values : ndarray, shape (r, number of joints)
    """

    times: np.ndarray
    joints: list[str]
    values: np.ndarray

    def stacked(self, names: Sequence[str], default: np.ndarray) -> np.ndarray:
        """Values of the joints ``names`` (n,), shape (r, n); ``default`` (n,) for the others."""
        rows = np.tile(default, (len(self.times), 1))
        for k, joint in enumerate(self.joints):
            rows[:, names.index(joint)] = self.values[:, k]
        return rows


def read_table(control: RecordedControl, joints: Sequence[str]) -> Table:
    """The table of a control, of which the scene has the ``joints`` (``arm/joint``).

    Raises
    ------
    SceneError
        Naming the file, and the column and row of the first fault in it.
    """
    path = control.file
    try:
        columns, row_name = _read(path)
    except _Unreadable as error:
        raise _table_error(str(error)) from None
    chosen = _columns_of(control, path, list(columns), joints)
    times = _numbers(path, control.time, columns[control.time], row_name)
    _check_times(path, control.time, times, row_name)
    values = [_numbers(path, name, columns[name], row_name) for name in chosen.values()]
    for name, column in zip(chosen.values(), values, strict=True):
        if len(column) != len(times):
            raise _table_error(
                f"{path}: column {name!r} has {count_of(len(column), 'row')}, "
                f"{control.time!r} has {len(times)}"
            )
    return Table(times, list(chosen), np.column_stack(values))


def _table_error(text: str) -> SceneError:
    return SceneError(f"$.control.file: {text}")


def _columns_of(
    control: RecordedControl, path: Path, names: list[str], joints: Sequence[str]
) -> dict[str, str]:
    """Joint -> its column."""
    if control.time not in names:
        raise _table_error(f"{path}: no column {control.time!r} with the times; columns are "
                     f"{listed(names, control.time)}; `time` names another")  # fmt: skip
    if control.columns is None:
        chosen = {name: name for name in names if name != control.time}
        for name in chosen:
            if name not in joints:
                text = unknown("joint", name, joints)
                raise _table_error(
                    f"{path}, column {name!r}: {text}; `columns` selects and maps columns"
                )
        if not chosen:
            raise _table_error(
                f"{path} has no column of numbers but {control.time!r}; add one named 'arm/joint'"
            )
        return chosen
    for joint, name in control.columns.items():
        if name not in names:
            raise SceneError(
                f"$.control.columns[{joint!r}]: {path}: {unknown('column', name, names)}"
            )
    return control.columns


def _numbers(
    path: Path, column: str, cells: Sequence, row_name: Callable[[int], str]
) -> np.ndarray:
    """The cells of a column as finite numbers."""
    try:
        numbers = np.asarray(cells, dtype=float)
    except (TypeError, ValueError):
        numbers = np.zeros(())
    if numbers.ndim != 1:  # cells that are no numbers, or lists of them
        numbers = np.array([_number_or_nan(cell) for cell in cells])
    wrong = np.flatnonzero(~np.isfinite(numbers))
    if wrong.size:
        k = int(wrong[0])
        raise _table_error(
            f"{path}, column {column!r}, {row_name(k)}: must be a finite number, got "
            f"{shown(cells[k])}"
        )
    return numbers


def _number_or_nan(cell: object) -> float:
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return float("nan")


def _check_times(
    path: Path, column: str, times: np.ndarray, row_name: Callable[[int], str]
) -> None:
    if len(times) < 2:
        raise _table_error(f"{path}: a table needs at least 2 rows, got {len(times)}")
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if wrong.size:
        k = int(wrong[0])
        raise _table_error(
            f"{path}, column {column!r}, {row_name(k + 1)}: times must increase, but "
            f"{times[k + 1]:.9g} s comes after {times[k]:.9g} s"
        )


# --- formats -------------------------------------------------------------------------------------

_Read = tuple[Mapping[str, Sequence], Callable[[int], str]]  # columns, and the name of a row


class _Unreadable(Exception):
    """A file is no table; the text says why."""


def _read(path: Path) -> _Read:
    readers = {
        ".csv": _read_csv, ".parquet": _read_parquet,
        ".h5": _read_hdf5, ".hdf5": _read_hdf5,
    }  # fmt: skip
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise _Unreadable(
            f"{path}: a table is a file {listed(readers)}, not {path.suffix or 'one without end'}"
        )
    if not path.is_file():
        raise _Unreadable(f"no file at {path}")
    try:
        return reader(path)
    except OSError as error:
        raise _Unreadable(f"cannot read {path}: {error.strerror or error}") from None


def _read_csv(path: Path) -> _Read:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, skipinitialspace=True)
            numbered = [(lines.line_num, line) for line in lines if any(map(str.strip, line))]
    except (UnicodeDecodeError, csv.Error):
        raise _Unreadable(f"{path} is not a text file of comma-separated values") from None
    if not numbered:
        raise _Unreadable(f"{path} is empty; its first line names the columns")
    (_, head), *rows = numbered
    names = [name.strip() for name in head]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise _Unreadable(f"{path}: two columns have the name {twice[0]!r}")
    for number, row in rows:
        if len(row) != len(names):
            raise _Unreadable(
                f"{path}, line {number}: has {count_of(len(row), 'column')}, the first line "
                f"{len(names)}"
            )
    columns = zip(*(row for _, row in rows), strict=True) if rows else [()] * len(names)
    return dict(zip(names, columns, strict=True)), lambda k: f"line {rows[k][0]}"


def _read_parquet(path: Path) -> _Read:
    from pyarrow import ArrowException, parquet

    try:
        columns = parquet.read_table(path).to_pydict()
    except ArrowException as error:
        raise _Unreadable(f"{path} is not a Parquet file: {error}") from None
    return columns, _row_number


def _read_hdf5(path: Path) -> _Read:
    import h5py

    columns: dict[str, Any] = {}

    def keep(name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset) and node.ndim == 1:
            columns[name] = node[()]

    if not h5py.is_hdf5(path):
        raise _Unreadable(f"{path} is not an HDF5 file")
    with h5py.File(path, "r") as file:
        file.visititems(keep)
    return columns, _row_number


def _row_number(k: int) -> str:
    return f"row {k + 1}"
