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
from multiarm.results.channels import Channel, arm_names
from multiarm.results.files import CLOSED, STATUSES, resolved
from multiarm.results.hdf5 import (
    HDF5_ERRORS,
    PIECE,
    GrowingFile,
    StoredFile,
    allocate,
    in_pieces,
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
        super().__init__(resolved(path, self.error))

    def load(self) -> None:
        """Read everything but the samples."""
        self.samples, pieces = self.counters("progress")
        names = self.attribute("channels", np.ndarray).tolist()
        if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
            raise self.broken("its list of channels is not one of different names")
        self.channels = {name: self._channel(name) for name in names}
        self.metadata = self.table(self.attribute("provenance", str), "'provenance'")
        self.metadata["scene"] = self.text("scene")
        self.require("progress")
        self._check_channels()
        self.amendment = None
        if "amended" in self.file:
            text = self.pieces("amendment", *self.counters("amended"))
            self.amendment = self.table(text or "{}", "'amendment'")
        self.outcome = None
        if pieces:
            outcome = self.table(self.pieces("outcome", 0, pieces), "'outcome'")
            self.outcome = outcome | (self.amendment or {})
            fault = outcome_fault(self.outcome)
            if fault:
                raise self.broken(f"its outcome cannot be read: {fault}")

    def _channel(self, name: str) -> Channel:
        """The description of a channel, whose samples are there."""
        stored = self.dataset(name, "f")
        width = math.prod(stored.shape[1:])
        here = stored.id.get_storage_size() // (stored.dtype.itemsize * max(width, 1))
        if min(len(stored), here if width else self.samples) < self.samples:
            raise self.broken(f"'{name}' has not all of its {self.samples:,} samples")
        self.require(name, self.samples)
        words = {key: self.attribute(key, str, stored) for key in ("unit", "frame", "description")}
        labels: tuple[Any, ...] = ()
        if "columns" in stored.attrs:
            labels = tuple(self.attribute("columns", np.ndarray, stored).tolist())
            if not all(isinstance(label, str) for label in labels) or len(labels) != width:
                raise self.broken(f"'{name}' has columns without names, or names of others")
        return Channel(name, stored.shape[1:], **words, labels=labels)

    def _check_channels(self) -> None:
        """Refuse channels of another shape, and times that do not go on."""
        if "time" not in self.channels:
            raise self.broken("channel 'time' is missing")
        for name, shape in _SHAPES.items():
            if name in self.channels and self.channels[name].shape != shape:
                raise self.broken(f"channel '{name}' has another shape")
        for arm in arm_names(self.channels):
            own = [f"arms/{arm}/joint_{name}" for name in ("position", "velocity", "torque")]
            if len({self.channels[name].shape for name in own if name in self.channels}) > 1:
                raise self.broken(f"channels of arm '{arm}' have different numbers of joints")
        times = self.file["time"][: self.samples]
        if not np.isfinite(times).all() or np.any(np.diff(times) < 0.0):
            raise self.broken("its times are not finite, or do not increase")

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        stop = self.samples if stop is None else min(stop, self.samples)
        if self._identity is None:
            if not self.file:  # closed
                raise TrajectoryError(CLOSED)
            with self.reading(self.path):
                return self._finite(name, self.file[name][start:stop])
        if _identity(self.path) != self._identity:
            raise TrajectoryError(
                f"'{self.path}' is not the file any more that this result was read from; load it "
                "again, or write other runs elsewhere"
            )
        with self.opened(self.path)[0] as file, self.reading(self.path):
            return self._finite(name, file[name][start:stop])

    def _finite(self, name: str, values: np.ndarray) -> np.ndarray:
        if not np.isfinite(values).all():
            raise self.broken(f"channel '{name}' has numbers that are not finite")
        return values

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


_XYZ: tuple[int, ...] = (3,)
_SHAPES = {
    "time": (), "object/position": _XYZ, "object/quaternion_xyzw": (4,), "object/twist": (6,),
    **dict.fromkeys(("energy/kinetic", "energy/potential", "energy/work"), ()),
    **dict.fromkeys(("drift/position", "drift/velocity"), ()),
}  # fmt: skip
"""Of a sample, of the channels that all runs have."""


def outcome_fault(outcome: Mapping[str, Any]) -> str:
    """Why a table is not the outcome of a run, see `Outcome`; empty where it is one."""
    sorts = {"status": str, "message": str, "statistics": dict, "events": list}
    allowed = {*sorts, "certificate"}
    wrong = [name for name, sort in sorts.items() if not isinstance(outcome.get(name), sort)]
    if wrong or not allowed.issuperset(outcome) or outcome["status"] not in STATUSES:
        return f"'{(wrong or ['status'])[0]}' is missing, or nothing that this program writes"
    certificate = outcome.get("certificate")
    if certificate is not None and not isinstance(certificate, dict):
        return "'certificate' is none"
    for event in outcome["events"]:
        own = event if isinstance(event, dict) else {}
        if not isinstance(own.get("time"), (int, float)) or not isinstance(own.get("kind"), str):
            return "an event has no time or no kind"
    return ""


def _identity(path: Path) -> tuple[int, ...]:
    """Identity of the file at a path; empty where there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size
