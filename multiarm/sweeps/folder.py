"""The folder of a sweep: its texts, and rows in Parquet parts that are written whole and renamed.

    x.sweep/
        scene.yaml, sweep.yaml      what was run
        about.json                  fingerprint, number of runs, columns, versions, files
        parts/*.parquet             rows of finished runs, in the order in which they ended

The folder is made under a temporary name and renamed.  A writer appends to a part of its own by
writing it again, until it is long enough; a part is forced to the disk under a temporary name
before it replaces the earlier one, so that a kill or a power cut at any moment leaves either with
all its rows.
A row follows from the number of its run: one that is there twice counts once, so that several
writers do each other no harm.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pandas
import pyarrow as pa
from pandas.api.types import is_object_dtype
from pyarrow import parquet
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from multiarm.errors import SweepError
from multiarm.results.files import atomic_file, resolved
from multiarm.results.sinks import provenance
from multiarm.scene.faults import fault, place
from multiarm.sweeps.plan import SweepPlan

if TYPE_CHECKING:
    from multiarm.sweeps.run import Row

__all__ = ["About", "Column", "PartWriter", "create", "is_sweep", "read_about", "read_rows"]

ABANDONED = 3600.0
"""[s] An unfinished part that is older was left by a writer that was killed."""
PART_ROWS = 1024
"""Rows of a part, at least, before its writer begins the next one."""


class Column(BaseModel):
    """A column of a sweep's table.

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

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    group: Literal["fixed", "values", "quantities", "measured"]
    key: str
    unit: str = ""
    words: str


FIXED = (
    Column(name="run", group="fixed", key="run", words="number of the run, from 1 on"),
    Column(name="status", group="fixed", key="status", words="how it ended"),
    Column(name="message", group="fixed", key="message", words="why it did not complete"),
)
MEASURED = (
    Column(
        name="wall_time", group="measured", key="wall_time", unit="s", words="time that it took"
    ),
    Column(name="worker", group="measured", key="worker", words="computer and process that ran it"),
)
_TYPES = {
    "run": pa.int64(), "status": pa.string(), "message": pa.string(),
    "wall_time": pa.float64(), "worker": pa.string(),
}  # fmt: skip


def _of_a_table(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    names = [column.name for column in columns]
    if len(set(names)) < len(names) or not {*FIXED, *MEASURED}.issubset(columns):
        raise fault("must have run, status, message, wall_time and worker, and no name twice")
    return columns


class About(BaseModel):
    """What the folder says of its sweep, besides the texts of scene and sweep."""

    model_config = ConfigDict(frozen=True)

    format: Literal["multiarm sweep"] = "multiarm sweep"
    version: Literal[3] = 3
    fingerprint: str
    count: Annotated[int, Field(strict=True, ge=0)]
    columns: Annotated[tuple[Column, ...], AfterValidator(_of_a_table)]
    folder: str
    files: dict[str, str]
    provenance: dict[str, Any]

    def of_group(self, group: str) -> list[Column]:
        """The columns of a group."""
        return [column for column in self.columns if column.group == group]


def columns_of(plan: SweepPlan) -> tuple[Column, ...]:
    """The columns of a sweep's table."""
    taken = {column.name for column in (*FIXED, *MEASURED)}
    values = [
        Column(
            name=f"$.{path}" if path in taken else path,
            group="values", key=path, words="value in the scene",
        )
        for path in plan.paths
    ]  # fmt: skip
    taken |= {column.name for column in values}
    quantities = [
        Column(
            name=f"quantity {quantity.name}" if quantity.name in taken else quantity.name,
            group="quantities", key=quantity.name, unit=quantity.unit, words=quantity.words,
        )
        for quantity in plan.quantities
    ]  # fmt: skip
    return (*FIXED, *values, *quantities, *MEASURED)


def is_sweep(path: Path) -> bool:
    """Whether a path is the folder of a sweep, of any version."""
    return (path / "about.json").is_file() and (path / "parts").is_dir()


def create(path: Path, plan: SweepPlan) -> About:
    """Make the folder of a sweep, without rows; one that is there is replaced.

    Raises
    ------
    SweepError
        The place holds something else, or cannot be written.
    """
    if path.exists() and not is_sweep(path):
        raise SweepError(
            f"'{path}' exists and is not the folder of a sweep: choose another name, or remove it"
        )
    about = About(
        fingerprint=plan.fingerprint,
        count=plan.count,
        columns=columns_of(plan),
        folder=str(plan.scene.folder),
        files=plan.files,
        provenance={key: value for key, value in provenance("").items() if key != "scene"},
    )
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    with _on_disk(path):
        try:
            (partial / "parts").mkdir(parents=True)
            texts = {"scene.yaml": plan.scene_text, "sweep.yaml": plan.text}
            for name, text in {**texts, "about.json": about.model_dump_json(indent=1)}.items():
                (partial / name).write_text(text, encoding="utf-8", errors="surrogateescape")
            if path.exists():
                shutil.rmtree(path)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return about


def read_about(path: str | os.PathLike) -> tuple[Path, About, dict[str, str]]:
    """The folder of a sweep, what it says of it, and the texts of scene and sweep.

    Raises
    ------
    SweepError
        Missing, damaged, no sweep, or of another version.
    """
    folder = resolved(path, SweepError)
    if not folder.exists():
        raise SweepError(f"there is no sweep '{folder}'; multiarm sweep and ma.sweep() make one")
    if folder.is_file():
        raise SweepError(
            f"'{folder}' is a file; a sweep is a folder NAME.sweep, written by multiarm sweep or "
            "ma.sweep(). HDF5 files of earlier versions are not read: make the sweep again"
        )
    if not is_sweep(folder):
        raise SweepError(f"'{folder}' is not the folder of a sweep: it has no 'about.json'")
    try:
        texts = {
            name: (folder / f"{name}.yaml").read_text(encoding="utf-8", errors="surrogateescape")
            for name in ("scene", "sweep")
        }
        raw = (folder / "about.json").read_text(encoding="utf-8", errors="surrogateescape")
        about = About.model_validate(json.loads(raw))
    except ValidationError as error:
        first = error.errors()[0]
        if first["loc"] in (("format",), ("version",)):
            raise SweepError(
                f"'{folder}' was written by another version of multiarm, in a format that this one "
                "does not read: make the sweep again in another folder, or overwrite this one "
                "(--fresh, in Python resume=False)"
            ) from None
        raise _damaged(folder / "about.json", f"{place(first['loc'])}: {first['msg']}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise _damaged(folder, str(error)) from error
    return folder, about, texts


def read_rows(folder: Path, about: About) -> pandas.DataFrame:
    """The rows of finished runs, in their order, without the values that vary.

    Index: run.  Columns: status, message, the quantities, wall_time, worker; a missing entry is
    ``pandas.NA``.

    Raises
    ------
    SweepError
        A part is damaged.
    """
    schema = _schema(about, {})
    tables = [schema.empty_table()]
    for part in sorted((folder / "parts").glob("*.parquet")):
        try:
            tables.append(parquet.read_table(part, columns=schema.names).cast(schema))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise SweepError(
                f"'{part}' is damaged or was cut short ({_first_line(error)}); copy it again, or "
                "remove it and resume the sweep: its runs are made again"
            ) from error
    rows = pa.concat_tables(tables).to_pandas(types_mapper=_NULLABLE.get)
    rows = rows.drop_duplicates("run").set_index("run").sort_index()
    if len(rows) and not 1 <= rows.index[0] <= rows.index[-1] <= about.count:
        raise _damaged(folder, f"its runs are not among 1 to {about.count}")
    return rows


class PartWriter:
    """Appends rows to a sweep.

    Parameters
    ----------
    folder : Path
    about : About
    plan : SweepPlan
        Its values are written beside the rows where Arrow has a type for them, so that other
        programs have them too.
    """

    def __init__(self, folder: Path, about: About, plan: SweepPlan) -> None:
        self._folder, self._plan = folder, plan
        self._values = {column.key: column.name for column in about.of_group("values")}
        self._quantities = {column.key: column.name for column in about.of_group("quantities")}
        types = {self._values[path]: _arrow_type(plan.table[path].tolist()) for path in plan.paths}
        self._schema = _schema(about, types)
        self._writer, self._number = secrets.token_hex(4), 0
        self._part = self._schema.empty_table()

    def append(self, rows: Sequence[Row]) -> None:
        """Append rows; they are then on the disk.

        Raises
        ------
        SweepError
            The disk is full, or the folder cannot be written.
        """
        added = pa.Table.from_pylist([self._written(row) for row in rows], schema=self._schema)
        part = pa.concat_tables([self._part, added])
        name = f"{self._writer}-{self._number:06d}.parquet"
        with _on_disk(self._folder):
            _write_whole(self._folder / "parts" / name, part)
        self._part = part
        if len(part) >= PART_ROWS:
            self._number, self._part = self._number + 1, self._schema.empty_table()

    def _written(self, row: Row) -> dict[str, Any]:
        values = self._plan.table.loc[row.run]
        written = {column.name: getattr(row, column.key) for column in (*FIXED, *MEASURED)}
        written |= {name: row.quantities[key] for key, name in self._quantities.items()}
        for path, name in self._values.items():
            as_text = pa.types.is_string(self._schema.field(name).type)
            written[name] = str(values[path]) if as_text else values[path]
        return written


def without_mixed_types(table: pandas.DataFrame) -> pandas.DataFrame:
    """The table with texts in columns for whose values Arrow has no type."""
    mixed = {
        name: table[name].map(str)
        for name in table
        if is_object_dtype(table[name]) and pa.types.is_string(_arrow_type(table[name]))
    }
    return table.assign(**mixed)


def remove_unfinished(folder: Path) -> None:
    """Remove what killed writers have left of parts; live ones write theirs in a moment."""
    for partial in (folder / "parts").glob(".*.part"):
        with suppress(FileNotFoundError):
            if partial.stat().st_mtime < time.time() - ABANDONED:
                partial.unlink()


_NULLABLE = {
    pa.float64(): pandas.Float64Dtype(), pa.string(): pandas.StringDtype(),
    pa.int64(): pandas.Int64Dtype(),
}  # fmt: skip


def _schema(about: About, values: Mapping[str, pa.DataType]) -> pa.Schema:
    """The columns of a part, with unit and description; of the varied values those given."""
    return pa.schema(
        pa.field(
            column.name,
            _TYPES.get(column.name) or values.get(column.name, pa.float64()),
            metadata={"unit": column.unit, "description": column.words, "kind": column.group},
        )
        for column in about.columns
        if column.group != "values" or column.name in values
    )


def _arrow_type(values: Iterable[Any]) -> pa.DataType:
    """The type that leaves values as they are; text where there is none."""
    values = list(values)
    try:
        array = pa.array(values)
    except (pa.ArrowException, OverflowError):
        return pa.string()
    kind = array.type
    while pa.types.is_list(kind):
        kind = kind.value_type
    exact = pa.types.is_primitive(kind) or pa.types.is_string(kind)
    return array.type if exact and array.to_pylist() == values else pa.string()


def _write_whole(path: Path, table: pa.Table) -> None:
    """Write a part under a temporary name, force it to the disk, and replace the earlier part."""
    with (
        atomic_file(path, path.with_name(f".{path.name}.part")) as partial,
        partial.open("wb") as file,
    ):
        parquet.write_table(table, file)
        file.flush()
        os.fsync(file.fileno())
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


@contextmanager
def _on_disk(path: Path) -> Iterator[None]:
    """Turn an error of the operating system into a message."""
    try:
        yield
    except OSError as error:
        raise SweepError(
            f"cannot write to '{path}': {error.strerror or error}; free some space on the disk or "
            "choose another folder"
        ) from error


def _damaged(path: Path, why: str) -> SweepError:
    return SweepError(
        f"'{path}' is damaged or was cut short ({_first_line(why)}): copy it again or repeat the "
        "sweep"
    )


def _first_line(error: object) -> str:
    return str(error).strip().partition("\n")[0]
