"""The folder of a sweep: its texts, and rows in Parquet parts that are written whole and renamed.

    x.sweep/
        scene.yaml, sweep.yaml      what was run
        about.json                  what else decides on its numbers: versions, files, functions
        parts/*.parquet             rows of finished runs, in the order in which they ended

The folder is made under a temporary name and renamed.  A writer appends to a part of its own by
writing it again, until it is long enough; a part is forced to the disk under a temporary name
before it replaces the earlier one, so that a kill or a power cut at any moment leaves either with
all its rows.
A row follows from the number of its run: one that is there twice counts once, so that several
writers do each other no harm.
"""

from __future__ import annotations

import difflib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pandas
import pyarrow as pa
from pandas.api.types import is_object_dtype
from pyarrow import parquet
from pydantic import BaseModel, ConfigDict, ValidationError

from multiarm.errors import SweepError
from multiarm.results.files import atomic_file, temporary_name
from multiarm.results.sinks import provenance
from multiarm.scene import dump_scene
from multiarm.scene.faults import counted, place
from multiarm.sweeps.plan import SweepPlan
from multiarm.sweeps.spec import FIRST, LAST, Column, SweepSpec

if TYPE_CHECKING:
    from multiarm.sweeps.run import Row

PART_ROWS = 1024
"""Rows of a part, at least, before its writer begins the next one."""
DIFFERENT_LINES = 6
"""Of a text, in a message, at most."""


class Header(BaseModel):
    """What decides on the numbers of the runs."""

    model_config = ConfigDict(frozen=True)

    scene: str  # its text, in scene.yaml
    sweep: str  # its text, in sweep.yaml
    format: Literal["multiarm sweep"] = "multiarm sweep"
    version: Literal[4] = 4
    folder: str  # where relative paths of the scene start
    files: dict[str, str]  # path -> SHA-256
    functions: list[str]  # SHA-256 of the functions of quantities
    provenance: dict[str, Any]

    @classmethod
    def of(cls, plan: SweepPlan) -> Header:
        """The header of a plan."""
        return cls(
            scene=dump_scene(plan.scene),
            sweep=plan.spec.text(),
            folder=str(plan.scene.folder),
            files=plan.files,
            functions=plan.functions,
            provenance={key: value for key, value in provenance("").items() if key != "scene"},
        )

    def differences(self, here: Header) -> list[str]:
        """Differences to another header that change the motion of the runs."""
        lines = [
            *_changed_lines("scene", self.scene, here.scene),
            *_changed_lines("sweep", self.sweep, here.sweep),
        ]
        begun_by = self.provenance.get("version", "of unknown version")
        if not lines and begun_by != here.provenance["version"]:
            lines = [f"it was begun by multiarm {begun_by}, this is {here.provenance['version']}"]
        changed = sorted({name for name, _ in self.files.items() ^ here.files.items()})
        return [*lines, *(f"the file '{name}' has changed, or is missing" for name in changed)]


def _changed_lines(what: str, there: str, here: str) -> list[str]:
    lines = difflib.unified_diff(there.splitlines(), here.splitlines(), n=0, lineterm="")
    lines = (line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---"))
    return counted([f"{what}: {line}" for line in lines], DIFFERENT_LINES, "\n").splitlines()


def is_sweep(path: Path) -> bool:
    """Whether a path is the folder of a sweep, of any version."""
    return (path / "about.json").is_file() and (path / "parts").is_dir()


def create(path: Path, plan: SweepPlan) -> None:
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
    header = Header.of(plan)
    texts = {
        "scene.yaml": header.scene,
        "sweep.yaml": header.sweep,
        "about.json": header.model_dump_json(indent=1, exclude={"scene", "sweep"}),
    }
    partial = temporary_name(path)
    with _on_disk(path):
        try:
            (partial / "parts").mkdir(parents=True)
            for name, text in texts.items():
                (partial / name).write_text(text, encoding="utf-8", errors="surrogateescape")
            if path.exists():
                shutil.rmtree(path)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def read_header(folder: Path) -> Header:
    """What the folder of a sweep says of it.

    Raises
    ------
    SweepError
        Missing, damaged, no sweep, or of another version.
    """
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
        scene, sweep, about = (
            (folder / name).read_text(encoding="utf-8", errors="surrogateescape")
            for name in ("scene.yaml", "sweep.yaml", "about.json")
        )
        return Header.model_validate({**json.loads(about), "scene": scene, "sweep": sweep})
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
        raise _damaged(folder, error) from error


_TYPES = {
    "run": pa.int64(), "status": pa.string(), "message": pa.string(),
    "wall_time": pa.float64(), "worker": pa.string(),
}  # fmt: skip
_NULLABLE = {
    pa.float64(): pandas.Float64Dtype(), pa.string(): pandas.StringDtype(),
    pa.int64(): pandas.Int64Dtype(),
}  # fmt: skip


def _field(column: Column, type_: pa.DataType | None = None) -> pa.Field:
    metadata = {"unit": column.unit, "description": column.words}
    return pa.field(column.name, type_ or _TYPES.get(column.name, pa.float64()), metadata=metadata)


def read_rows(folder: Path, spec: SweepSpec) -> pandas.DataFrame:
    """The rows of finished runs, in their order, without the values that vary.

    Index: run.  Columns: status, message, the quantities, wall_time, worker; a missing entry is
    ``pandas.NA``.

    Raises
    ------
    SweepError
        A part is damaged.
    """
    schema = pa.schema(map(_field, (*FIRST, *spec.quantities, *LAST)))
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
    if len(rows) and not 1 <= rows.index[0] <= rows.index[-1] <= spec.count:
        raise _damaged(folder, f"its runs are not among 1 to {spec.count}")
    return rows


class PartWriter:
    """Appends rows to the folder of a plan.

    The values of the runs are written beside the rows where Arrow has a type for them, so that
    other programs have them too.
    """

    def __init__(self, folder: Path, plan: SweepPlan) -> None:
        self._folder, self._prefix, self._number = folder, secrets.token_hex(4), 0
        self._values = pa.table(
            {path: _arrow(plan.spec.table[path].tolist()) for path in plan.spec.table}
        )
        types = dict(zip(self._values.column_names, self._values.schema.types, strict=True))
        self._schema = pa.schema(
            _field(column, types.get(column.name)) for column in plan.spec.columns
        )
        self._part = self._schema.empty_table()

    def append(self, rows: Sequence[Row]) -> None:
        """Append rows; they are then on the disk.

        Raises
        ------
        SweepError
            The disk is full, or the folder cannot be written.
        """
        values = self._values.take([row["run"] - 1 for row in rows]).to_pylist()
        whole = [{**row, **of_run} for row, of_run in zip(rows, values, strict=True)]
        part = pa.concat_tables([self._part, pa.Table.from_pylist(whole, schema=self._schema)])
        name = f"{self._prefix}-{self._number:06d}.parquet"
        with _on_disk(self._folder):
            _write_whole(self._folder / "parts" / name, part)
        self._part = part
        if len(part) >= PART_ROWS:
            self._number, self._part = self._number + 1, self._schema.empty_table()


def without_mixed_types(table: pandas.DataFrame) -> pandas.DataFrame:
    """The table with texts in columns for whose values Arrow has no type."""
    columns = {
        name: _arrow(table[name].tolist()).to_pylist()
        for name in table
        if is_object_dtype(table[name])
    }
    return table.assign(**columns)


def _arrow(values: list[Any]) -> pa.Array:
    """The values in the type that leaves them as they are; as texts where there is none."""
    try:
        array = pa.array(values)
        kind = array.type
        while pa.types.is_list(kind):
            kind = kind.value_type
        exact = pa.types.is_primitive(kind) or pa.types.is_string(kind)
        if exact and array.to_pylist() == values:
            return array
    except (pa.ArrowException, OverflowError):
        pass
    return pa.array(map(str, values))


def _write_whole(path: Path, table: pa.Table) -> None:
    """Write a part under a temporary name, force it to the disk, and replace the earlier part."""
    with atomic_file(path) as partial, partial.open("wb") as file:
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


def _damaged(path: Path, why: object) -> SweepError:
    return SweepError(
        f"'{path}' is damaged or was cut short ({_first_line(why)}): copy it again or repeat the "
        "sweep"
    )


def _first_line(error: object) -> str:
    return str(error).strip().partition("\n")[0]
