"""Read a trajectory file, a channel when it is asked for."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from multiarm.channels import CLOSED, Channel
from multiarm.errors import TrajectoryError
from multiarm.storage.layout import FORMAT, FORMAT_VERSION, reason
from multiarm.storage.recovery import Unclosed, is_unclosed

HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError)
"""What h5py raises for a file that is not what it should be."""
TRIES, PAUSE = 4, 0.1
"""To open a file that may be in the middle of being written; seconds in between."""


class Hdf5Store:
    """Read access to a file; a channel is read when it is asked for.

    The file stays open, so that one that is later replaced at the same place does not change
    what is read here; :meth:`rest` gives that up where very many files are read.

    Raises
    ------
    TrajectoryError
        Missing, unreadable, cut short, not a trajectory, or written by a newer format.
    """

    def __init__(self, path: str | os.PathLike):
        self.path, self._rests = Path(path).absolute(), False
        self._known: tuple[int, ...] = ()
        for tries_left in range(TRIES - 1, -1, -1):
            try:
                self._open()
                return
            except TrajectoryError:  # a file that is being written changes while it is read
                if not tries_left or not (self.path.is_file() and is_unclosed(self.path)):
                    raise
                time.sleep(PAUSE)

    def _open(self) -> None:
        self._file, intact = _open_for_reading(self.path)
        with self._reading():
            _check_format(self.path, self._file)
            self.samples, self._pieces = (int(n) for n in self._file["progress"][:])
            self.channels: dict[str, Channel] = {
                name: _channel(name, self._file[name]) for name in self._file.attrs["channels"]
            }
            self.metadata = json.loads(self._file.attrs["provenance"])
            self.metadata["scene"] = self._file["scene"].asstr()[()]
            if not intact:
                self._check_extent()
            self.amendment = self._read_amendment()
            self.outcome = self._read_outcome()

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        stop = self.samples if stop is None else min(stop, self.samples)
        if self._rests:
            if self._identity() != self._known:
                raise TrajectoryError(
                    f"'{self.path}' is not the file any more that this result was read from; load "
                    f"it anew, or write other runs elsewhere"
                )
            file = _open_for_reading(self.path)[0]
            with file, self._reading():
                return file[name][start:stop]
        if not self._file:  # h5py's word for closed
            raise TrajectoryError(CLOSED)
        with self._reading():
            return self._file[name][start:stop]

    def rest(self) -> None:
        """Close the file between two reads: it is opened anew for each."""
        self._rests = True
        self._file.close()
        self._known = self._identity()

    def _identity(self) -> tuple[int, ...]:
        """What tells a file from another one at its path; nothing where there is none."""
        try:
            found = self.path.stat()
        except OSError:
            return ()
        return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._rests = False
        self._file.close()

    def _read_outcome(self) -> dict | None:
        if self._pieces == 0:
            return None
        outcome = json.loads(b"".join(self._file["outcome"][: self._pieces]))
        return outcome | (self.amendment or {})

    def _read_amendment(self) -> dict | None:
        """What was said after the run; None for files of earlier programs, which take nothing."""
        if "amended" not in self._file:
            return None
        begin, end = (int(n) for n in self._file["amended"][:])
        return json.loads(b"".join(self._file["amendment"][begin:end])) if end else {}

    def _check_extent(self) -> None:
        """HDF5 reads zeros behind the end of a file that was not closed: look first."""
        size = self.path.stat().st_size
        parts = dict.fromkeys(self.channels, self.samples) | {"outcome": self._pieces}
        if "amended" in self._file:
            parts["amendment"] = int(self._file["amended"][1])
        progress = self._file["progress"].id
        inside = progress.get_offset() + progress.get_storage_size() <= size
        if not inside or not all(
            _stored_inside(self._file[name], rows, size) for name, rows in parts.items()
        ):
            raise OSError("data behind the end of the file")

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except HDF5_ERRORS as error:
            raise _damaged(self.path, error) from error


def is_trajectory(path: Path) -> bool:
    """Whether a file is one of ours, whatever its version and state."""
    try:
        with _open_for_reading(path)[0] as file:
            return file.attrs.get("format") == FORMAT
    except (TrajectoryError, *HDF5_ERRORS):
        return False


def _open_for_reading(path: Path) -> tuple[h5py.File, bool]:
    """The open file, and whether it was closed properly when it was written."""
    if not path.is_file():
        what = "it is a folder" if path.is_dir() else "there is no such file"
        raise TrajectoryError(f"cannot read '{path}': {what}")
    try:
        if not h5py.is_hdf5(path):
            raise TrajectoryError(
                f"'{path}' is not an HDF5 file; a trajectory is written by a run or by save()"
            )
        if is_unclosed(path):
            return h5py.File(Unclosed(path), "r"), False
        return h5py.File(path, "r", locking="best-effort"), True
    except HDF5_ERRORS as error:
        raise _damaged(path, error) from error


def _channel(name: str, dataset: h5py.Dataset) -> Channel:
    words = {key: str(dataset.attrs[key]) for key in ("unit", "frame", "description")}
    labels = tuple(str(label) for label in dataset.attrs.get("columns", ()))
    return Channel(name, dataset.shape[1:], **words, labels=labels)


def _check_format(path: Path, file: h5py.File) -> None:
    if file.attrs.get("format") != FORMAT:
        raise TrajectoryError(f"'{path}' is an HDF5 file, but not a trajectory of multiarm")
    version = int(file.attrs["format_version"])
    if version > FORMAT_VERSION:
        raise TrajectoryError(
            f"'{path}' has format version {version}; this program reads up to {FORMAT_VERSION}: "
            "update multiarm"
        )


def _stored_inside(dataset: h5py.Dataset, rows: int, size: int) -> bool:
    """Whether the chunks of the first `rows` rows exist and end before byte `size`."""
    if dataset.shape[0] < rows:
        return False
    if 0 in dataset.shape[1:]:
        return True
    ends: list[int] = []

    def collect(chunk) -> None:
        if chunk.chunk_offset[0] < rows:
            ends.append(chunk.byte_offset + chunk.size)

    dataset.id.chunk_iter(collect)
    return len(ends) == -(-rows // dataset.chunks[0]) and max(ends, default=0) <= size


def _damaged(path: Path, error: Exception) -> TrajectoryError:
    return TrajectoryError(
        f"'{path}' is damaged or was cut short ({reason(error)}); copy it again or repeat the run"
    )
