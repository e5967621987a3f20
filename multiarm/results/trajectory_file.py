"""The file of a run: HDF5 that survives a kill at any moment and reads like documentation.

Layout (format `multiarm trajectory`, version 1)::

    /                        attributes: format, format_version, provenance (JSON)
    /scene                   the scene, YAML text
    /time, /object/..., /arms/<arm>/..., /energy/..., /drift/...
                             one resizable float64 dataset per channel, leading axis = samples,
                             attributes: unit, frame, description, columns
    /progress                [samples safely written, pieces of the outcome]
    /outcome                 status, message, statistics, events, certificate: JSON in pieces
    /amended, /amendment     entries of the outcome that were changed after the run, likewise

A checkpoint flushes the channels first and `progress` after them. Samples beyond `progress` are not
read, so that all channels of an interrupted run have the same length. An amendment is appended to
earlier ones; `amended` names the valid pieces and is written last.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import Channel
from multiarm.results.files import CLOSED
from multiarm.results.hdf5 import (
    HDF5_ERRORS,
    PIECE,
    GrowingFile,
    StoredFile,
    allocate,
    in_pieces,
    joined,
    reason,
)

CHUNK_SAMPLES = 512
"""A chunk of a scalar channel fills a page of the file."""
CHUNK_PIECES = 64


class TrajectoryReader(StoredFile):
    """Samples in a file; a channel is read on access.

    The file stays open, so that a new file at the same path does not change what is read here.
    :meth:`close_between_reads` is for reading very many files.

    Raises
    ------
    TrajectoryError
        Missing, unreadable, cut short, not a trajectory, or written by a newer format.

    Attributes
    ----------
    outcome : dict or None
        None: the writer was killed, or is still at work.
    amendment : dict or None
        None: the file was written by an earlier program, and cannot be amended.
    """

    format, version = "multiarm trajectory", 1
    noun = "a trajectory"
    origin = "a trajectory is written by a run or by save()"
    remedy = "copy it again or repeat the run"
    error = TrajectoryError

    def __init__(self, path: str | os.PathLike):
        self._identity: tuple[int, ...] | None = None
        super().__init__(Path(path).absolute())

    def load(self) -> None:
        """Read everything but the samples."""
        file = self.file
        self.samples, pieces = (int(n) for n in file["progress"][:])
        self.channels = {name: _channel(name, file[name]) for name in file.attrs["channels"]}
        self.metadata = json.loads(file.attrs["provenance"])
        self.metadata["scene"] = file["scene"].asstr()[()]
        self.require("progress")
        for name in self.channels:
            self.require(name, self.samples)
        self.require("outcome", pieces)
        self.amendment = None
        if "amended" in file:
            begin, end = (int(n) for n in file["amended"][:])
            self.require("amendment", end)
            self.amendment = json.loads(joined(file["amendment"][begin:end]) or "{}")
        self.outcome = None
        if pieces:
            outcome = json.loads(joined(file["outcome"][:pieces]))
            self.outcome = outcome | (self.amendment or {})

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        stop = self.samples if stop is None else min(stop, self.samples)
        if self._identity is None:
            if not self.file:  # closed
                raise TrajectoryError(CLOSED)
            with self.reading(self.path):
                return self.file[name][start:stop]
        if _identity(self.path) != self._identity:
            raise TrajectoryError(
                f"'{self.path}' is not the file any more that this result was read from; load it "
                "again, or write other runs elsewhere"
            )
        with self.opened(self.path)[0] as file, self.reading(self.path):
            return file[name][start:stop]

    def close_between_reads(self) -> None:
        """Open the file for each read only."""
        self.file.close()
        self._identity = _identity(self.path)

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._identity = None
        super().close()


class TrajectoryWriter(GrowingFile):
    """A new file that grows by blocks of samples.

    ``path`` is one of :meth:`StoredFile.writable_target`; the entry `scene` of the metadata is the
    YAML text of the scene.

    Raises
    ------
    TrajectoryError
        The file cannot be written.
    """

    reader = TrajectoryReader

    def __init__(self, path: Path, channels: Sequence[Channel], metadata: dict[str, Any]):
        self.samples, self._checkpointed = 0, 0
        self._channels, self._metadata = channels, metadata
        self._chunk_bytes = 8 * CHUNK_SAMPLES * sum(channel.width for channel in channels)
        # descriptions and index of a dataset take up to 16 KiB
        super().__init__(path, self._chunk_bytes, 16384 * (4 + len(channels)))

    def create(self) -> None:
        """Create all datasets."""
        file, channels = self.file, self._channels
        provenance = {key: value for key, value in self._metadata.items() if key != "scene"}
        file.attrs["provenance"] = json.dumps(provenance, allow_nan=False)
        text = self._metadata.get("scene", "")
        file.create_dataset("scene", data=text, dtype=h5py.string_dtype())
        self._datasets = {channel.name: _create(file, channel) for channel in channels}
        file.attrs["channels"] = [channel.name for channel in channels]
        self._outcome = self.create_growing(
            "outcome", PIECE, CHUNK_PIECES, "how the run ended: JSON, to be joined"
        )
        self.create_growing(
            "amendment", PIECE, CHUNK_PIECES, "what was found out after the run: JSON, to be joined"
        )
        self.create_counters("amended", 2, "first and end of the pieces of amendment that hold")
        self._progress = self.create_counters(
            "progress", 2, "samples safely written; pieces of outcome"
        )

    def append(self, block: Mapping[str, np.ndarray]) -> None:
        """Add finite samples of all channels; they count once `checkpoint` has returned."""
        end = self.samples + len(block["time"])
        chunks = end // CHUNK_SAMPLES - self._checkpointed // CHUNK_SAMPLES + 1
        self.reserve(chunks * self._chunk_bytes)
        with self.writing("append to"):
            for name, dataset in self._datasets.items():
                dataset.resize(end, axis=0)
                dataset[self.samples : end] = block[name]
        self.samples = end

    def checkpoint(self) -> None:
        """Make everything appended so far safe against a kill."""
        with self.writing("write to"):
            self.file.flush()
            self._progress[0] = self._checkpointed = self.samples
            self._progress.flush()

    def finish(self, outcome: dict[str, Any]) -> None:
        """Store how the run ended and close the file."""
        pieces = in_pieces(json.dumps(outcome, allow_nan=False))
        self.checkpoint()
        try:
            self.reserve(sum(map(len, pieces)))
            with self.writing("write to"):
                self._outcome.resize(len(pieces), axis=0)
                self._outcome[:] = pieces
                self.file.flush()
                self._progress[1] = len(pieces)
                self._progress.flush()
        finally:
            self.close()


def amend(path: Path, changes: dict[str, Any]) -> None:
    """Change entries of the outcome of a complete file, given in types of JSON.

    No reader of the file may be open in this process.

    Raises
    ------
    TrajectoryError
        No complete run of this program version, or the disk is full.
    """
    store = TrajectoryReader(path)
    store.close()
    if store.outcome is None or store.amendment is None:
        raise TrajectoryError(f"'{path}' holds no complete run that could be amended; run it again")
    pieces = in_pieces(json.dumps({**store.amendment, **changes}, allow_nan=False))
    try:
        allocate(path, sum(map(len, pieces)) + 65536)
        with h5py.File(path, "r+", libver=("v110", "v110"), locking="best-effort") as file:
            file.swmr_mode = True
            begin = int(file["amended"][1])
            end = begin + len(pieces)
            file["amendment"].resize(end, axis=0)
            file["amendment"][begin:end] = pieces
            file.flush()
            file["amended"][:] = begin, end
            file["amended"].flush()
            size = file.id.get_filesize()
        os.truncate(path, size)
    except HDF5_ERRORS as error:
        raise TrajectoryError(
            f"cannot write to '{path}': {reason(error)}; free some space on the disk"
        ) from error


def _create(file: h5py.File, channel: Channel) -> h5py.Dataset:
    dataset = file.create_dataset(
        channel.name,
        (0, *channel.shape),
        "<f8",
        maxshape=(None, *(width or None for width in channel.shape)),
        chunks=(CHUNK_SAMPLES, *(width or 1 for width in channel.shape)),
        fillvalue=math.nan,  # a sample never written must not look like one that was
    )
    dataset.attrs["unit"] = channel.unit
    dataset.attrs["frame"] = channel.frame
    dataset.attrs["description"] = channel.description
    if channel.labels:
        dataset.attrs["columns"] = list(channel.labels)
    return dataset


def _channel(name: str, dataset: h5py.Dataset) -> Channel:
    words = {key: str(dataset.attrs[key]) for key in ("unit", "frame", "description")}
    labels = tuple(str(label) for label in dataset.attrs.get("columns", ()))
    return Channel(name, dataset.shape[1:], **words, labels=labels)


def _identity(path: Path) -> tuple[int, ...]:
    """Identity of the file at a path; empty where there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size
