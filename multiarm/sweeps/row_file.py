"""The file of many runs: one row each, appended as they end, in HDF5 that survives a kill.

Layout (format `multiarm sweep`, version 1)::

    /              attributes: format, format_version
    /<text>        what describes the rows: scene, sweep, header (JSON)
    /rows          one compound entry per row; its field `text` names pieces of /texts
    /texts         what of a row is not a number: JSON in pieces
    /progress      [rows safely written]

`progress` is written after everything that a row needs: a kill at any moment leaves a number of
complete rows. Data are forced to the disk once a second, so that a power cut costs no more than the
rows of that second.
"""

from __future__ import annotations

import errno
import json
import math
import os
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np

from multiarm.errors import MultiarmError, SweepError
from multiarm.results.hdf5 import (
    PIECE,
    PIECE_BYTES,
    GrowingFile,
    StoredFile,
    in_pieces,
    joined,
)

try:
    import fcntl
except ImportError:  # this system has no such locks: nothing is refused
    fcntl = None  # type: ignore[assignment]

TEXT = "text"
"""Field of a row: its first piece of text, and the end of its pieces."""
CHUNK_BYTES, CHUNK_PIECES = 32768, 256

SYNC = 1.0
"""Interval at which data are forced to the disk [s]."""

Block = tuple[np.ndarray, list[str]]
"""Rows, and the text of each."""


class RowReader(StoredFile):
    """Read access to a file of rows.

    Raises
    ------
    SweepError
        Missing, unreadable, cut short, no sweep, or written by a newer format.

    Attributes
    ----------
    count : int
        Rows that were safely written when the file was opened.
    """

    format, version = "multiarm sweep", 1
    noun = "a sweep"
    origin = "a sweep is written by multiarm sweep or ma.sweep()"
    remedy = "copy it again or repeat the sweep"
    error = SweepError

    def load(self) -> None:
        """Count the rows."""
        self.count = int(self.file["progress"][0])
        self.require("progress")
        self.require("rows", self.count)
        rows = self.file["rows"]
        self.require("texts", int(rows[self.count - 1][TEXT][1]) if self.count else 0)

    def text(self, name: str) -> str:
        """One of the texts that describe the rows."""
        with self.reading(self.path):
            return self.file[name].asstr()[()]

    def field(self, name: str, start: int, stop: int) -> np.ndarray:
        """One field of rows start..stop."""
        with self.reading(self.path):
            return self.file["rows"].fields(name)[start : min(stop, self.count)]

    def block(self, start: int, stop: int) -> Block:
        """Rows start..stop, and their texts."""
        with self.reading(self.path):
            rows = self.file["rows"][start : min(stop, self.count)]
            return rows, self._texts_of(rows)

    def picked(self, places: np.ndarray) -> Block:
        """The rows at some places, in that order, and their texts."""
        order, gap = np.argsort(places), 32  # closer rows are read at once
        spans = np.split(places[order], np.flatnonzero(np.diff(places[order]) > gap) + 1)
        parts = [self._within(span) for span in spans if len(span)] or [self.block(0, 0)]
        rows = np.concatenate([rows for rows, _ in parts])
        texts = [text for _, own in parts for text in own]
        back = np.argsort(order)
        return rows[back], [texts[k] for k in back]

    def _within(self, span: np.ndarray) -> Block:
        """The rows at some places that lie close together, in order."""
        low = int(span[0])
        rows, texts = self.block(low, int(span[-1]) + 1)
        return rows[span - low], [texts[k] for k in span - low]

    def _texts_of(self, rows: np.ndarray) -> list[str]:
        if not len(rows):
            return []
        begins, ends = rows[TEXT].T
        low = int(begins.min())
        pieces = self.file["texts"][low : int(ends.max())]
        return [
            joined(pieces[begin - low : end - low]) for begin, end in zip(begins, ends, strict=True)
        ]


class RowWriter(GrowingFile):
    """A new file that grows by rows.

    Parameters
    ----------
    path : Path
        See :meth:`StoredFile.writable_target`.
    fields : dtype
        Of a row: a compound with the field ``TEXT`` of two integers.
    texts : mapping
        What describes the rows, by name.
    earlier : iterable of Block
        Rows to begin with, in the file from its first moment on.

    Raises
    ------
    SweepError
        The file cannot be written.
    """

    reader = RowReader

    def __init__(
        self, path: Path, fields: np.dtype, texts: Mapping[str, str], earlier: Iterable[Block] = ()
    ):
        self._fields, self._described, self._earlier = fields, texts, earlier
        self.count = self._pieces = 0
        self._synced = -math.inf
        described = sum(len(text.encode()) for text in texts.values())
        super().__init__(path, CHUNK_BYTES + CHUNK_PIECES * PIECE_BYTES, (1 << 16) + described)

    def create(self) -> None:
        """Create all datasets, with the rows to begin with."""
        for name, text in self._described.items():
            self.file.create_dataset(name, data=text, dtype=h5py.string_dtype())
        self._rows = self.create_growing(
            "rows", self._fields, max(1, CHUNK_BYTES // self._fields.itemsize),
            "one run each, in the order in which they ended",
        )  # fmt: skip
        self._texts = self.create_growing(
            "texts", PIECE, CHUNK_PIECES, "of each row, what is no number: JSON, to be joined"
        )
        self._progress = self.create_counters("progress", 1, "rows safely written")
        for block in self._earlier:
            self._put(*block)
        self._progress[0] = self.count

    def append(self, rows: np.ndarray, texts: Sequence[str]) -> None:
        """Add rows; they are safe when this returns."""
        pieces = sum(len(text) // PIECE_BYTES + 1 for text in texts)
        self.reserve(rows.nbytes + CHUNK_BYTES + (pieces + CHUNK_PIECES) * PIECE_BYTES)
        with self.writing("append to"):
            self._put(rows, texts)
            self.file.flush()
            if time.monotonic() > self._synced + SYNC:
                os.fsync(self.file.id.get_vfd_handle())
                self._synced = time.monotonic()
            self._progress[0] = self.count
            self._progress.flush()

    def _put(self, rows: np.ndarray, texts: Sequence[str]) -> None:
        if not len(rows):
            return
        pieces = [in_pieces(text) for text in texts]
        ends = self._pieces + np.cumsum([len(own) for own in pieces])
        rows = rows.copy()
        rows[TEXT][:, 0] = [self._pieces, *ends[:-1]]
        rows[TEXT][:, 1] = ends
        self._texts.resize(int(ends[-1]), axis=0)
        self._texts[self._pieces :] = [piece for own in pieces for piece in own]
        self._rows.resize(self.count + len(rows), axis=0)
        self._rows[self.count :] = rows
        self.count, self._pieces = self.count + len(rows), int(ends[-1])


class WriterLock:
    """Exclusive right to write a file, until :meth:`release` or the end of the process.

    The lock is the operating system's (`flock`), on a small file next to the guarded one. The
    guarded file itself is replaced on resuming, and a lock would stay with the old one.

    Parameters
    ----------
    path : Path
        The guarded file.
    error : type
        Of the errors that are raised.

    Raises
    ------
    MultiarmError
        Another process, or another part of this one, holds the lock.
    """

    def __init__(self, path: Path, error: type[MultiarmError]):
        self._path = path.with_name(f".{path.name}.lock")
        self._descriptor: int | None = None
        while fcntl is not None and self._descriptor is None:
            descriptor = self._open(error)
            if not _locked(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise error(
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

    def _open(self, error: type[MultiarmError]) -> int:
        linked = error(
            f"'{self._path}' is a link, which is not followed: remove it, or choose another folder"
        )
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as fault:
            if fault.errno == errno.ELOOP:
                raise linked from None
            raise error(
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
