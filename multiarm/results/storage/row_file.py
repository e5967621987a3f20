"""The file of many runs: one row each, appended as they end, in HDF5 that survives a kill.

Layout (format `multiarm sweep`, version 1)::

    /              attributes: format, format_version
    /<text>        what describes the rows: scene, sweep, header (JSON)
    /rows          one compound entry per row; its field `text` names pieces of /texts
    /texts         what of a row is no number: JSON in pieces
    /progress      [rows safely written]

A row counts when `progress` says so, which is written after everything that the row needs: a kill
at any moment leaves a number of whole rows.  Once a second the disk is made to take what it was
given, so that a power cut costs no more than the rows of that second.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np

from multiarm.errors import SweepError
from multiarm.results.storage.growing import GrowingFile
from multiarm.results.storage.layout import PIECE_BYTES
from multiarm.results.storage.opening import FileKind, stored_inside, unchunked_inside
from multiarm.results.storage.recovery import is_unclosed

SWEEP = FileKind(
    "multiarm sweep",
    1,
    noun="a sweep",
    origin="a sweep is written by multiarm sweep or ma.sweep()",
    remedy="copy it again or repeat the sweep",
    trouble=SweepError,
)
TEXT = "text"
"""Field of a row: first of its pieces of text, and the end of them."""
CHUNK_BYTES, CHUNK_PIECES = 32768, 256
SPARE_BYTES = 1 << 16
"""Room asked for beyond the rows: descriptions, and the index of both datasets."""
GAP = 32
"""Rows between two that are asked for, which are read with them."""
SYNC = 1.0
"""[s] between two times that the disk is waited for."""
TRIES, PAUSE = 4, 0.1
"""To open a file that may be in the middle of being written; seconds in between."""

Block = tuple[np.ndarray, list[str]]
"""Rows, and the text of each."""


class RowWriter:
    """A new file that grows by rows.

    Parameters
    ----------
    path : Path
        Its place; a file of ours there is replaced once the new one is whole.
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

    def __init__(
        self, path: Path, fields: np.dtype, texts: Mapping[str, str], earlier: Iterable[Block] = ()
    ):
        self._fields = fields
        described = sum(len(text.encode()) for text in texts.values())
        size = CHUNK_BYTES + CHUNK_PIECES * PIECE_BYTES

        def build(file: h5py.File) -> None:
            self._create(file, texts)
            for block in earlier:
                self._put(*block)
            self._progress[0] = self.count

        self.count = self._pieces = 0
        self._synced = -math.inf
        self._grown = GrowingFile(path, build, size, SPARE_BYTES + described, SweepError)

    def append(self, rows: np.ndarray, texts: Sequence[str]) -> None:
        """Add rows; they are safe when this returns."""
        pieces = sum(len(text) // PIECE_BYTES + 1 for text in texts)
        self._grown.reserve(rows.nbytes + CHUNK_BYTES + (pieces + CHUNK_PIECES) * PIECE_BYTES)
        with self._grown.writing("append to"):
            self._put(rows, texts)
            self._grown.file.flush()
            if time.monotonic() > self._synced + SYNC:
                os.fsync(self._grown.file.id.get_vfd_handle())
                self._synced = time.monotonic()
            self._progress[0] = self.count
            self._progress.flush()

    def close(self) -> None:
        """Close the file."""
        self._grown.close()

    def _create(self, file: h5py.File, texts: Mapping[str, str]) -> None:
        file.attrs["format"] = SWEEP.format
        file.attrs["format_version"] = SWEEP.version
        for name, text in texts.items():
            file.create_dataset(name, data=text, dtype=h5py.string_dtype())
        chunk = max(1, CHUNK_BYTES // self._fields.itemsize)
        self._rows = file.create_dataset(
            "rows", (0,), self._fields, maxshape=(None,), chunks=(chunk,)
        )
        self._rows.attrs["description"] = "one run each, in the order in which they ended"
        self._texts = file.create_dataset(
            "texts", (0,), f"S{PIECE_BYTES}", maxshape=(None,), chunks=(CHUNK_PIECES,)
        )
        self._texts.attrs["description"] = "of each row, what is no number: JSON, to be joined"
        self._progress = file.create_dataset("progress", data=np.zeros(1, dtype=np.int64))
        self._progress.attrs["description"] = "rows safely written"

    def _put(self, rows: np.ndarray, texts: Sequence[str]) -> None:
        if not len(rows):
            return
        cut = [_pieces(text) for text in texts]
        ends = self._pieces + np.cumsum([len(own) for own in cut])
        rows = rows.copy()
        rows[TEXT][:, 0] = [self._pieces, *ends[:-1]]
        rows[TEXT][:, 1] = ends
        self._texts.resize(int(ends[-1]), axis=0)
        self._texts[self._pieces :] = [piece for own in cut for piece in own]
        self._rows.resize(self.count + len(rows), axis=0)
        self._rows[self.count :] = rows
        self.count, self._pieces = self.count + len(rows), int(ends[-1])


class RowReader:
    """Read access to a file of rows, whole, growing, or left by a kill.

    Raises
    ------
    SweepError
        Missing, unreadable, cut short, no sweep, or written by a newer format.

    Attributes
    ----------
    count : int
        Rows that were safely written when the file was opened.
    """

    def __init__(self, path: Path):
        self.path = path
        for tries_left in range(TRIES - 1, -1, -1):
            try:
                self._open()
                return
            except SweepError:  # a file that is being written changes while it is read
                if not tries_left or not (path.is_file() and is_unclosed(path)):
                    raise
                time.sleep(PAUSE)

    @property
    def fields(self) -> np.dtype:
        """Of a row."""
        return self._file["rows"].dtype

    def text(self, name: str) -> str:
        """What describes the rows."""
        with SWEEP.reading(self.path):
            return self._file[name].asstr()[()]

    def field(self, name: str, start: int, stop: int) -> np.ndarray:
        """One field of some rows."""
        with SWEEP.reading(self.path):
            return self._file["rows"].fields(name)[start : min(stop, self.count)]

    def block(self, start: int, stop: int) -> Block:
        """Some rows, and their texts."""
        with SWEEP.reading(self.path):
            rows = self._file["rows"][start : min(stop, self.count)]
            return rows, self._texts_of(rows)

    def picked(self, places: np.ndarray) -> Block:
        """The rows at some places, in that order, and their texts."""
        order = np.argsort(places)
        spans = np.split(places[order], np.flatnonzero(np.diff(places[order]) > GAP) + 1)
        parts = [self._within(span) for span in spans if len(span)] or [self.block(0, 0)]
        rows = np.concatenate([rows for rows, _ in parts])
        texts = [text for _, own in parts for text in own]
        back = np.argsort(order)
        return rows[back], [texts[k] for k in back]

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._file.close()

    def _open(self) -> None:
        self._file, intact = SWEEP.open_for_reading(self.path)
        with SWEEP.reading(self.path):
            SWEEP.check(self.path, self._file)
            self.count = int(self._file["progress"][0])
            if not intact:
                self._check_extent()

    def _check_extent(self) -> None:
        size = self.path.stat().st_size
        rows, texts = self._file["rows"], self._file["texts"]
        inside = unchunked_inside(self._file["progress"], size)
        inside = inside and stored_inside(rows, self.count, size)
        pieces = int(rows[self.count - 1][TEXT][1]) if inside and self.count else 0
        if not (inside and stored_inside(texts, pieces, size)):
            raise OSError("data behind the end of the file")

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
        pieces = self._file["texts"][low : int(ends.max())]
        return [
            b"".join(pieces[begin - low : end - low]).decode("ascii")
            for begin, end in zip(begins, ends, strict=True)
        ]


def _pieces(text: str) -> list[bytes]:
    """ASCII text in pieces, at least one; none of them ends in NUL, which HDF5 would cut off."""
    data = text.encode("ascii")
    return [data[i : i + PIECE_BYTES] for i in range(0, len(data), PIECE_BYTES)] or [b""]
