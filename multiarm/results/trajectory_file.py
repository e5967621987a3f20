"""The file of a run: HDF5 that survives a kill at any moment and reads like documentation.

Layout (format `multiarm trajectory`, version 1)::

    /                        attributes: format, format_version, provenance (JSON)
    /scene                   the scene, YAML text
    /time, /object/... (of several /objects/<object>/...), /arms/<arm>/..., /energy/...
                             one resizable float64 dataset per channel, leading axis = samples,
                             attributes: unit, frame, description, columns
    /progress                [samples safely written, pieces of the outcome]
    /outcome                 entries of `Outcome`: JSON in pieces
    /amended, /amendment     entries of the outcome that were changed after the run, likewise

The writer creates all datasets first and then enters HDF5's single-writer-multiple-reader mode.
From then on datasets only grow, and HDF5 writes data before the index that points to them. The
index never crosses a page of the file, so that the operating system cannot leave half of an entry.
The file is created under a temporary name and moved to its place when it is ready to grow: an older
file there survives until then, and programs that still read it keep their data.

A checkpoint flushes the channels first and `progress` after them. Samples beyond `progress` are not
read, so that all channels of an interrupted run have the same length. An amendment is appended to
earlier ones; `amended` names the valid pieces and is written last.
"""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.notation import count_of
from multiarm.results.channels import (
    CLOSED,
    LARGEST,
    Channel,
    arm_channel,
    arm_names,
    base_channels,
    control_power_channel,
    environment_paths,
    object_paths,
    owner_names,
    recordable,
    tip_channels,
    trajectory_channels,
    width_of,
    wrench_channel,
)
from multiarm.results.files import atomic_file, resolved
from multiarm.results.hdf5 import FORMAT, HDF5_ERRORS, VERSION, StoredFile, opened, reading, reason
from multiarm.results.outcome import RunStatus
from multiarm.scene.run import LONGEST_RUN

CHUNK_SAMPLES = 512
"""A chunk of a scalar channel fills a page of the file."""
CHUNK_PIECES = 64
PIECE_BYTES = 120
PIECE = f"S{PIECE_BYTES}"
"""Type of a piece of text, a line in `h5dump`: HDF5 cannot append to one long text."""

_UNCLOSABLE: list[TrajectoryWriter] = []
"""Files with a failed write, kept until the program ends: HDF5 crashes on closing one."""


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

    def __init__(self, path: str | os.PathLike):
        self._identity: tuple[int, ...] | None = None
        super().__init__(resolved(path, TrajectoryError))

    def load(self) -> None:
        """Read everything but the samples."""
        self.samples, pieces = self._counters("progress")
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
            text = self._pieces("amendment", *self._counters("amended"))
            self.amendment = self.table(text or "{}", "'amendment'")
        self.outcome = None
        if pieces:
            outcome = self.table(self._pieces("outcome", 0, pieces), "'outcome'")
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
            raise self.broken(f"'{name}' has not all of its {count_of(self.samples, 'sample')}")
        self.require(name, self.samples)
        words = {key: self.attribute(key, str, stored) for key in ("unit", "frame", "description")}
        labels: tuple[Any, ...] = ()
        if "columns" in stored.attrs:
            labels = tuple(self.attribute("columns", np.ndarray, stored).tolist())
            if not all(isinstance(label, str) for label in labels) or len(labels) != width:
                raise self.broken(f"'{name}' has columns without names, or names of others")
        return Channel(name, stored.shape[1:], **words, labels=labels)

    def _counters(self, name: str) -> list[int]:
        """Two numbers of rows."""
        counters = self.dataset(name, "iu", 1)[:].tolist()
        if len(counters) != 2 or min(counters) < 0:
            raise self.broken(f"'{name}' is not two numbers of rows")
        return counters

    def _pieces(self, name: str, begin: int, end: int) -> str:
        """The text in some rows of a dataset, see :func:`_in_pieces`."""
        stored = self.dataset(name, "S", 1)
        if not begin <= end <= len(stored):
            raise self.broken(f"'{name}' has {len(stored)} pieces, none from {begin} to {end}")
        self.require(name, end)
        return b"".join(stored[begin:end]).decode("ascii")

    def _check_channels(self) -> None:
        """Refuse channels of another shape, and times that do not go on."""
        if "time" not in self.channels:
            raise self.broken("channel 'time' is missing")
        of_arms = [
            (
                *(wrench_channel(path), control_power_channel(path)),
                *(*tip_channels(path), *base_channels(path)),
            )
            for path in (f"arms/{owner}" for owner in owner_names(self.channels))
        ]
        around = [wrench_channel(path) for path in environment_paths(self.channels)]
        objects = tuple(object_paths(self.channels))
        # those that runs have, with a shape that does not depend on the scene
        of_run = trajectory_channels({}, {}, objects=objects)
        for channel in (*of_run, *itertools.chain(*of_arms), *around):
            if self.channels.get(channel.name, channel).shape != channel.shape:
                raise self.broken(f"channel '{channel.name}' has another shape")
        for arm in arm_names(self.channels):
            joints = [
                arm_channel(arm, f"joint_{name}") for name in ("position", "velocity", "torque")
            ]
            if len({self.channels[name].shape for name in joints if name in self.channels}) > 1:
                raise self.broken(f"channels of arm '{arm}' have different numbers of joints")
        times = self.file["time"][: self.samples]
        if not recordable(times).all() or np.any(np.diff(times) < 0.0):
            raise self.broken("its times are not finite, or do not increase")
        if len(times) and times[-1] - times[0] > LONGEST_RUN:
            raise self.broken(f"its times span more than {LONGEST_RUN:g} s")

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        start, stop, _ = slice(start, stop).indices(self.samples)
        if self._identity is None:
            if not self.file:  # closed
                raise TrajectoryError(CLOSED)
            with reading(self.path):
                return self._recordable(name, self.file[name][start:stop])
        if _identity(self.path) != self._identity:
            raise TrajectoryError(
                f"'{self.path}' is not the file any more that this result was read from; load it "
                "again, or write other runs elsewhere"
            )
        with opened(self.path)[0] as file, reading(self.path):
            return self._recordable(name, file[name][start:stop])

    def _recordable(self, name: str, values: np.ndarray) -> np.ndarray:
        if not recordable(values).all():
            raise self.broken(
                f"channel '{name}' has numbers that are not finite, or beyond {LARGEST:g}"
            )
        return values

    def close_between_reads(self) -> None:
        """Open the file for each read only."""
        self.file.close()
        self._identity = _identity(self.path)

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self._identity = None
        super().close()


class TrajectoryWriter:
    """A new file that grows by blocks of samples.

    ``path`` is one of :func:`writable_target`; the entry `scene` of the metadata is the
    YAML text of the scene.

    Raises
    ------
    TrajectoryError
        The folder cannot be written, or has no room.
    """

    def __init__(self, path: Path, channels: Sequence[Channel], metadata: dict[str, Any]):
        self.path, self._fault = path, ""
        self.samples, self._checkpointed = 0, 0
        self._chunk_bytes = 8 * CHUNK_SAMPLES * width_of(channels)
        # descriptions and index of a dataset take up to 16 KiB
        self._spare_bytes = 16384 * (4 + len(channels))
        # there is one writer at a time; with the same name the next one removes what a kill left
        partial = path.with_name(f".{path.name}.part")
        try:
            with atomic_file(path, partial):
                _allocate(partial, self._chunk_bytes + self._spare_bytes)
                self.file = h5py.File(
                    partial,
                    "w",
                    libver=("v110", "v110"),  # the oldest with this mode: widest readability
                    locking="best-effort",
                    fs_strategy="page",
                    fs_page_size=4096,
                    rdcc_nbytes=1 << 18,  # a few chunks of a dataset, independent of its length
                )
                self._reserve(self._chunk_bytes)
                with self._writing("write"):
                    self._create(channels, metadata)
                    self.file.swmr_mode = True
                    self.file.flush()
        except OSError as error:
            raise TrajectoryError(
                f"cannot write to '{path.parent}': {reason(error)}; "
                "choose a folder that you may write to and that has room"
            ) from error

    def _create(self, channels: Sequence[Channel], metadata: dict[str, Any]) -> None:
        """Create all datasets."""
        file = self.file
        file.attrs["format"], file.attrs["format_version"] = FORMAT, VERSION
        provenance = {key: value for key, value in metadata.items() if key != "scene"}
        file.attrs["provenance"] = json.dumps(provenance, allow_nan=False)
        file.create_dataset("scene", data=metadata.get("scene", ""), dtype=h5py.string_dtype())
        self._datasets = {channel.name: _create(file, channel) for channel in channels}
        file.attrs["channels"] = [channel.name for channel in channels]
        growing = {"shape": (0,), "dtype": PIECE, "maxshape": (None,), "chunks": (CHUNK_PIECES,)}
        words = {
            "outcome": "how the run ended: JSON, to be joined",
            "amendment": "what was found out after the run: JSON, to be joined",
            "amended": "first and end of the pieces of amendment that hold",
            "progress": "samples safely written; pieces of outcome",
        }
        for name, text in words.items():
            form = growing if name in ("outcome", "amendment") else {"data": np.zeros(2, np.int64)}
            file.create_dataset(name, **form).attrs["description"] = text
        self._outcome, self._progress = file["outcome"], file["progress"]

    def append(self, block: Mapping[str, np.ndarray]) -> None:
        """Add finite samples of all channels; they count once `checkpoint` has returned."""
        end = self.samples + len(block["time"])
        chunks = end // CHUNK_SAMPLES - self._checkpointed // CHUNK_SAMPLES + 1
        self._reserve(chunks * self._chunk_bytes)
        with self._writing("append to"):
            for name, dataset in self._datasets.items():
                dataset.resize(end, axis=0)
                dataset[self.samples : end] = block[name]
        self.samples = end

    def checkpoint(self) -> None:
        """Make everything appended so far safe against a kill."""
        with self._writing("write to"):
            self.file.flush()
            self._progress[0] = self._checkpointed = self.samples
            self._progress.flush()

    def finish(self, outcome: dict[str, Any]) -> None:
        """Store how the run ended and close the file."""
        pieces = _in_pieces(json.dumps(outcome, allow_nan=False))
        self.checkpoint()
        try:
            self._reserve(sum(map(len, pieces)))
            with self._writing("write to"):
                self._outcome.resize(len(pieces), axis=0)
                self._outcome[:] = pieces
                self.file.flush()
                self._progress[1] = len(pieces)
                self._progress.flush()
        finally:
            self._close()

    def _reserve(self, size: int) -> None:
        """Reserve disk space for `size` more bytes of data and HDF5's description of them.

        A full disk is then detected before anything is written: HDF5 does not recover from a failed
        write. Unused space is returned when the file is closed.
        """
        if self._fault or not hasattr(os, "posix_fallocate"):
            return
        end = self.file.id.get_filesize() + size + self._spare_bytes
        descriptor = self.file.id.get_vfd_handle()
        try:
            if end > os.fstat(descriptor).st_size:
                os.posix_fallocate(descriptor, 0, end)
        except OSError as error:
            raise self._disk_error("write to", error) from error

    @contextmanager
    def _writing(self, action: str) -> Iterator[None]:
        """Turn an error of HDF5 while writing into a message; it ends all writing."""
        if self._fault:
            raise TrajectoryError(self._fault)
        try:
            yield
        except (OSError, RuntimeError) as error:
            fault = self._disk_error(action, error)
            self._fault = str(fault)
            _UNCLOSABLE.append(self)
            raise fault from error

    def _close(self) -> None:
        """Close the file, and return unused disk space."""
        if self._fault or not self.file:
            return
        with suppress(OSError, RuntimeError):
            os.ftruncate(self.file.id.get_vfd_handle(), self.file.id.get_filesize())
            self.file.close()

    def _disk_error(self, action: str, error: Exception) -> TrajectoryError:
        return TrajectoryError(
            f"cannot {action} '{self.path}': {reason(error)}; "
            "free some space on the disk or choose another folder"
        )


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
    pieces = _in_pieces(json.dumps({**store.amendment, **changes}, allow_nan=False))
    try:
        _allocate(path, sum(map(len, pieces)) + 65536)
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


def _allocate(path: Path, size: int) -> None:
    """Let a file grow by `size` bytes, to detect a full disk before HDF5 writes."""
    if hasattr(os, "posix_fallocate"):
        with open(path, "r+b") as file:
            os.posix_fallocate(file.fileno(), os.path.getsize(path), size)


def _in_pieces(text: str) -> list[bytes]:
    """ASCII text in pieces, at least one; HDF5 would cut off a NUL at the end of one."""
    data = text.encode("ascii")
    return [data[i : i + PIECE_BYTES] for i in range(0, len(data), PIECE_BYTES)] or [b""]


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


def outcome_fault(outcome: Mapping[str, Any]) -> str:
    """Why a table is not the outcome of a run, see `Outcome`; empty where it is one."""
    sorts = {"status": str, "message": str, "statistics": dict, "events": list}
    allowed = {*sorts, "certificate", "remarks"}
    wrong = [name for name, sort in sorts.items() if not isinstance(outcome.get(name), sort)]
    if wrong or not allowed.issuperset(outcome) or outcome["status"] not in tuple(RunStatus):
        return f"'{(wrong or ['status'])[0]}' is missing, or nothing that this program writes"
    certificate = outcome.get("certificate")
    if certificate is not None and not isinstance(certificate, dict):
        return "'certificate' is none"
    remarks = outcome.get("remarks", [])
    if not isinstance(remarks, list) or not all(isinstance(text, str) for text in remarks):
        return "'remarks' are no texts"
    for event in outcome["events"]:
        entry = event if isinstance(event, dict) else {}
        time, kind = entry.get("time"), entry.get("kind")
        if not isinstance(time, (int, float)) or not isinstance(kind, str):
            return "an event has no time or no kind"
    return ""


def _identity(path: Path) -> tuple[int, ...]:
    """Identity of the file at a path; empty where there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size
