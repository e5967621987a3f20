"""Read a trajectory file, a channel when it is asked for."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import h5py
import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import CLOSED, Channel
from multiarm.results.storage.layout import FORMAT, FORMAT_VERSION
from multiarm.results.storage.opening import FileKind, stored_inside, unchunked_inside
from multiarm.results.storage.recovery import is_unclosed

TRAJECTORY = FileKind(
    FORMAT,
    FORMAT_VERSION,
    noun="a trajectory",
    origin="a trajectory is written by a run or by save()",
    remedy="copy it again or repeat the run",
    trouble=TrajectoryError,
)
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
        self._file, intact = TRAJECTORY.open_for_reading(self.path)
        with TRAJECTORY.reading(self.path):
            TRAJECTORY.check(self.path, self._file)
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
            file = TRAJECTORY.open_for_reading(self.path)[0]
            with file, TRAJECTORY.reading(self.path):
                return file[name][start:stop]
        if not self._file:  # h5py's word for closed
            raise TrajectoryError(CLOSED)
        with TRAJECTORY.reading(self.path):
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
        """What was not closed may end before its data."""
        size = self.path.stat().st_size
        parts = dict.fromkeys(self.channels, self.samples) | {"outcome": self._pieces}
        if "amended" in self._file:
            parts["amendment"] = int(self._file["amended"][1])
        inside = unchunked_inside(self._file["progress"], size)
        if not inside or not all(
            stored_inside(self._file[name], rows, size) for name, rows in parts.items()
        ):
            raise OSError("data behind the end of the file")


def _channel(name: str, dataset: h5py.Dataset) -> Channel:
    words = {key: str(dataset.attrs[key]) for key in ("unit", "frame", "description")}
    labels = tuple(str(label) for label in dataset.attrs.get("columns", ()))
    return Channel(name, dataset.shape[1:], **words, labels=labels)
