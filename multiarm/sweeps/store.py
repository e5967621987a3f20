"""The rows of a sweep: shards that are written whole and renamed, in the end one HDF5 file.

    x.h5         scene, sweep and the rows of finished calls, in the order of the runs
    x.h5.rows/   shards: Parquet files with rows that are not in x.h5 yet

The youngest shard is written anew whenever runs end, until it is long enough.  A file is forced to
the disk under a temporary name before it replaces its elder, so that a kill or a power cut at any
moment leaves either with all its rows.  When a call of :func:`multiarm.sweep` ends, all rows move
to the HDF5 file and the folder disappears.  Readers take rows from both; one that is found twice
counts once, for a row follows from the number of its run.

The HDF5 file (format `multiarm sweep`, version 2)::

    /              attributes: format, format_version
    /<text>        scene, sweep (YAML), header (JSON)
    /columns/<x>   a column; attributes: unit, description, type (`json`: texts to be decoded)
"""

from __future__ import annotations

import difflib
import errno
import io
import json
import os
import platform
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import parquet
from pydantic import BaseModel, ConfigDict, Field, StrictInt, ValidationError
from typing_extensions import Self

from multiarm.errors import SweepError
from multiarm.notation import count_of
from multiarm.results.files import atomic_file
from multiarm.results.hdf5 import StoredFile, reason
from multiarm.results.sinks import provenance
from multiarm.scene.faults import place
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.sweeps.plan import Record, SweepPlan, program_version, require_run
from multiarm.sweeps.table import FIXED, MEASURED, TYPES, Column, columns_of, schema_of, table_of

try:
    import fcntl
except ImportError:  # this system has no such locks: nothing is refused
    fcntl = None  # type: ignore[assignment]

__all__ = ["StoredSweep", "SweepFile", "SweepReader", "WriterLock", "differences"]

SHARD_ROWS = 1024
"""Rows of a shard, at least, before the next one begins."""
FINGERPRINT = b"fingerprint"
"""Of the sweep, in the metadata of a shard."""


class Header(BaseModel):
    """What a file says of its sweep, besides the texts of scene and sweep."""

    model_config = ConfigDict(frozen=True)

    fingerprint: str
    count: Annotated[StrictInt, Field(ge=0)]
    columns: tuple[Column, ...]
    folder: str
    files: dict[str, str]
    provenance: dict[str, Any]


@dataclass(frozen=True)
class StoredSweep:
    """What is stored of a sweep."""

    texts: dict[str, str]  # "scene" and "sweep" as YAML, "header" as JSON
    header: Header
    table: pa.Table  # one row a run, in the order of the runs

    @classmethod
    def begun(cls, plan: SweepPlan) -> StoredSweep:
        """The sweep of a plan, without rows."""
        header = Header(
            fingerprint=plan.fingerprint,
            count=plan.count,
            columns=columns_of(plan),
            folder=str(plan.scene.folder),
            files=plan.files,
            provenance={key: value for key, value in provenance("").items() if key != "scene"},
        )
        text = json.dumps(header.model_dump())
        texts = {"scene": plan.scene_text, "sweep": plan.text, "header": text}
        return cls(texts, header, table_of([], header.columns))

    @classmethod
    def read(cls, path: Path) -> StoredSweep:
        """Read a sweep, complete or not, also while it is being written.

        Raises
        ------
        SweepError
            Missing, damaged, no sweep, or of another version.
        """
        shards = list(_shards(path))  # first: rows only move from there to the file
        reader = SweepReader(path)
        reader.close()
        mark = reader.header.fingerprint.encode()
        parts = [reader.table_of_rows]
        parts += [
            shard.replace_schema_metadata()
            for shard in shards
            if (shard.schema.metadata or {}).get(FINGERPRINT) == mark
        ]
        try:
            table = pa.concat_tables(parts).combine_chunks()
            runs = table["run"].to_numpy()
        except pa.ArrowException as error:
            raise reader.broken("the files beside it have other columns") from error
        if len(runs) and not 1 <= runs.min() <= runs.max() <= reader.header.count:
            raise reader.broken(f"its runs are not among 1 to {reader.header.count}")
        _, first = np.unique(runs, return_index=True)
        return cls(reader.texts, reader.header, table.take(first))


class SweepReader(StoredFile):
    """The HDF5 file of a sweep, open for reading.

    Attributes
    ----------
    texts, header
        See :class:`StoredSweep`.
    table_of_rows : pyarrow.Table
        The rows in the file itself.
    """

    format, version = "multiarm sweep", 2
    noun = "a sweep"
    origin = "a sweep is written by multiarm sweep or ma.sweep()"
    remedy = "copy it again or repeat the sweep"
    error = SweepError

    def load(self) -> None:
        """Read everything."""
        if int(self.file.attrs["format_version"]) < self.version:
            raise SweepError(
                f"'{self.path}' was written by an earlier multiarm, in a format that this one does "
                "not read: make the sweep again in another file, or overwrite this one (--fresh, "
                "in Python resume=False)"
            )
        self.texts = {name: self.text(name) for name in ("scene", "sweep", "header")}
        try:
            self.header = Header.model_validate(self.table(self.texts["header"], "'header'"))
        except ValidationError as error:
            first = error.errors()[0]
            raise self.broken(f"{place(first['loc'], 'header')}: {first['msg']}") from None
        columns = self.header.columns
        names = [column.name for column in columns]
        fixed = {column.name for column in (*FIXED, *MEASURED)}
        if len(set(names)) < len(names) or not fixed.issubset(names):
            raise self.broken("its columns are not those of a sweep")
        schema = schema_of(columns)
        rows = [self._rows(column, kind) for column, kind in zip(columns, schema, strict=True)]
        if len(set(map(len, rows))) > 1:
            raise self.broken("its columns have different numbers of rows")
        self.table_of_rows = pa.table(rows, schema=schema)

    def _rows(self, column: Column, kind: pa.Field) -> pa.Array:
        """The rows of a column, of its type."""
        is_text = pa.types.is_string(kind.type)
        stored = self.dataset(_dataset(column.name), "O" if is_text else "biuf", 1)
        if stored.id.get_storage_size() < len(stored) * stored.dtype.itemsize:
            raise self.broken(f"column '{column.name}' has not all of its {len(stored):,} rows")
        values = stored.asstr()[()] if is_text else stored[()]
        try:
            if column.type == "json":
                for text in values:
                    json.loads(text)
            return pa.array(values, kind.type, from_pandas=True)
        except (pa.ArrowException, ValueError, RecursionError):
            raise self.broken(f"column '{column.name}' holds other values than it says") from None


def _dataset(name: str) -> str:
    """The dataset of a column; in HDF5 a slash would make a group, so that it is U+2215 there."""
    return f"columns/{name.replace('/', chr(0x2215))}"


def _write(path: Path, sweep: StoredSweep) -> None:
    """Write the HDF5 file of a sweep, in memory first: HDF5 does not survive a full disk."""
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs["format"], file.attrs["format_version"] = SweepReader.format, SweepReader.version
        for name, text in sweep.texts.items():
            file.create_dataset(name, data=text, dtype=h5py.string_dtype())
        for own in sweep.header.columns:
            is_text, cells = pa.types.is_string(TYPES[own.type]), sweep.table[own.name]
            stored = file.create_dataset(
                _dataset(own.name),
                data=cells.to_pylist() if is_text else cells.to_numpy(),
                dtype=h5py.string_dtype() if is_text else None,
            )
            stored.attrs.update({"unit": own.unit, "description": own.words, "type": own.type})
    _write_whole(path, lambda file: file.write(image.getbuffer()))


def _folder(path: Path) -> Path:
    return path.with_name(f"{path.name}.rows")


def _paths(path: Path) -> list[Path]:
    return sorted(_folder(path).glob("*.parquet"))


def _shards(path: Path) -> Iterator[pa.Table]:
    """The shards beside a file, in the order in which they were written."""
    for shard in _paths(path):
        try:
            yield parquet.ParquetFile(shard).read()
        except FileNotFoundError:
            pass  # its rows have just moved to the file
        except (pa.ArrowException, OSError) as error:
            raise SweepError(
                f"'{shard}' is damaged or was cut short ({reason(error)}); copy it again, or "
                "remove it and resume the sweep: its runs are made again"
            ) from error


def _write_whole(path: Path, write: Callable[[Any], Any]) -> None:
    """Write a file under a temporary name, force it to the disk, and let it replace the old one."""
    # there is one writer at a time; with the same name the next one removes what a kill left
    with (
        atomic_file(path, path.with_name(f".{path.name}.part")) as partial,
        partial.open("wb") as f,
    ):
        write(f)
        f.flush()
        os.fsync(f.fileno())
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


class SweepFile:
    """The file of a sweep, open for writing: created, or resumed if it holds the same sweep.

    Parameters
    ----------
    path : path-like
    plan : SweepPlan
    fresh : bool
        Overwrite an existing file.

    Raises
    ------
    SweepError
        The file belongs to another sweep (the message lists the differences), is being written by
        another process, or cannot be written.

    Attributes
    ----------
    path : Path
    made : int
        Runs whose rows are on the disk.
    """

    def __init__(self, path: str | os.PathLike, plan: SweepPlan, *, fresh: bool = False):
        self.path = SweepReader.writable_target(path)
        if _folder(self.path).is_symlink():
            raise SweepError(
                f"'{_folder(self.path)}' is a link, which is not followed: remove it, or choose "
                "another folder"
            )
        self._shard: pa.Table
        self._lock = WriterLock(self.path)
        try:
            if fresh or not self.path.exists():
                # shards of a file that is not wanted any more
                shutil.rmtree(_folder(self.path), ignore_errors=True)
                with self._disk():
                    _write(self.path, StoredSweep.begun(plan))
            stored = StoredSweep.read(self.path)
            _check_same(self.path, stored, plan)
        except BaseException:
            self._lock.release()
            raise
        self._header, self.made = stored.header, len(stored.table)
        self._done = np.zeros(plan.count + 1, dtype=bool)  # by the number of the run
        self._done[stored.table["run"].to_numpy()] = True
        self._open_shard(1 + max((int(own.stem) for own in _paths(self.path)), default=0))

    def missing(self) -> Iterator[int]:
        """The runs that have no row, in order."""
        return (run for run in range(1, len(self._done)) if not self._done[run])

    def append(self, rows: Iterable[Record]) -> None:
        """Append records; they are on the disk when this returns.

        A record of a run that has a row already is dropped: it is the same.

        Raises
        ------
        SweepError
            The disk is full, or a record has no valid run number.
        """
        new: dict[int, Record] = {}
        for row in rows:
            require_run(row.run, self._header.count)
            if not self._done[row.run]:
                new.setdefault(row.run, row)
        if not new:
            return
        added = table_of(list(new.values()), self._header.columns)
        shard = pa.concat_tables([self._shard, added])
        mark = {FINGERPRINT: self._header.fingerprint}
        with self._disk():
            _folder(self.path).mkdir(exist_ok=True)
            _write_whole(
                _folder(self.path) / f"{self._number:06d}.parquet",
                lambda file: parquet.write_table(shard.replace_schema_metadata(mark), file),
            )
        self._shard = shard
        self._done[list(new)] = True
        self.made += len(new)
        if len(shard) >= SHARD_ROWS:
            self._open_shard(self._number + 1)

    def close(self) -> None:
        """Move all rows to the HDF5 file, and let others write.

        Raises
        ------
        SweepError
            The disk is full; the rows are safe in the shards.
        """
        try:
            if _folder(self.path).exists():
                with self._disk(), deferred_interrupt():
                    _write(self.path, StoredSweep.read(self.path))
                shutil.rmtree(_folder(self.path), ignore_errors=True)
        finally:
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open_shard(self, number: int) -> None:
        self._number, self._shard = number, table_of([], self._header.columns)

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turn an error of the operating system into a message."""
        try:
            yield
        except OSError as error:
            raise SweepError(
                f"cannot write to '{self.path}': {reason(error)}; free some space on the disk or "
                "choose another folder"
            ) from error


def differences(stored: StoredSweep, plan: SweepPlan) -> list[str]:
    """Differences between a file and a plan that change the numbers of runs, as text."""
    differs = [
        *_changed_lines("scene", stored.texts["scene"], plan.scene_text),
        *_changed_lines("sweep", stored.texts["sweep"], plan.text),
    ]
    there = stored.header.provenance.get("version", "of unknown version")
    here = program_version()
    if not differs and there != here:
        differs = [f"it was begun by multiarm {there}, this is {here}"]
    then = stored.header.files
    for name in sorted({*then, *plan.files}):
        if then.get(name) != plan.files.get(name):
            differs.append(f"the file '{name}' has changed, or is missing")
    return differs


def _check_same(path: Path, stored: StoredSweep, plan: SweepPlan) -> None:
    """Refuse the file of another sweep."""
    if stored.header.fingerprint == plan.fingerprint:
        return
    differs = differences(stored, plan) or ["the text of a function that gives a quantity"]
    lines = "\n".join(f"  {line}" for line in differs)
    raise SweepError(
        f"'{path}' holds another sweep; choose another file, or begin afresh and overwrite it. "
        f"Differences (- there, + here):\n{lines}"
    )


def _changed_lines(what: str, there: str, here: str) -> list[str]:
    lines = difflib.unified_diff(there.splitlines(), here.splitlines(), n=0, lineterm="")
    changed = [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---")]
    shown = [f"{what}: {line}" for line in changed[:6]]
    more = len(changed) - len(shown)
    return [*shown, f"{what}: and {count_of(more, 'more line')}"] if more > 0 else shown


class WriterLock:
    """Exclusive right to write a file, until :meth:`release` or the end of the process.

    The lock is the operating system's (`flock`), on a small file next to the guarded one. The
    guarded file itself is replaced on resuming, and a lock would stay with the old one.

    Parameters
    ----------
    path : Path
        The guarded file.

    Raises
    ------
    SweepError
        Another process, or another part of this one, holds the lock.
    """

    def __init__(self, path: Path):
        self._path = path.with_name(f".{path.name}.lock")
        self._descriptor: int | None = None
        while fcntl is not None and self._descriptor is None:
            descriptor = self._open()
            if not _locked(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise SweepError(
                    f"'{path}' is being written by another process{holder}; wait for it, end it, "
                    "or choose another file"
                )
            if self._is_current(descriptor):
                self._descriptor = descriptor
                owner = {"process": os.getpid(), "host": platform.node()}
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps(owner).encode(), 0)
            else:  # its last owner has just removed it
                os.close(descriptor)

    def release(self) -> None:
        """Let others write."""
        if self._descriptor is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None

    def _open(self) -> int:
        linked = SweepError(
            f"'{self._path}' is a link, which is not followed: remove it, or choose another folder"
        )
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as fault:
            if fault.errno == errno.ELOOP:
                raise linked from None
            raise SweepError(
                f"cannot write to '{self._path.parent}': {fault.strerror}; "
                "choose a folder that you may write to"
            ) from None
        if os.fstat(descriptor).st_nlink > 1:  # a hard link: writing would change another file
            os.close(descriptor)
            raise linked
        return descriptor

    def _is_current(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), os.stat(self._path))
        except FileNotFoundError:
            return False


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # a file system without locks
    return True


def _holder(descriptor: int) -> str:
    try:
        owner = json.loads(os.pread(descriptor, 500, 0))
        return f" ({owner['process']} on {owner['host']})"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
