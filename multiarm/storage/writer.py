"""Write a run so that a kill at any moment leaves a file that can be read.

Everything is created before the file enters HDF5's single-writer-multiple-readers mode; from
then on only datasets grow, and HDF5 writes what is pointed to before what points to it. Its index
never crosses a page of the file, so that the operating system cannot leave half of an entry. A
checkpoint flushes the channels first and `progress` after them. Whatever was appended behind
the last `progress` is not read, so that all channels of an interrupted run have the same length.

The file is built beside its final place under a temporary name and moved there once it is
complete and empty: an older file at that place survives until then, and those who still read it
keep their data.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np

from multiarm.channels import Block, Channel
from multiarm.errors import TrajectoryError
from multiarm.storage.amendment import create_amendment
from multiarm.storage.layout import (
    CACHE_BYTES,
    CHUNK_SAMPLES,
    FORMAT,
    FORMAT_VERSION,
    PAGE_BYTES,
    PIECE_BYTES,
    reason,
)
from multiarm.storage.reader import is_trajectory

SPARE_BYTES = 16384
"""Room asked for per channel beyond its data: descriptions and index."""
_UNCLOSABLE: list[Hdf5Writer] = []
"""Files with a failed write, kept to the end of the program: HDF5 crashes on closing one."""


class Hdf5Writer:
    """An open file that grows by blocks of samples.

    Parameters
    ----------
    path : path-like
        Where the file shall be; a file of ours at that place is replaced.
    channels : sequence of Channel
    metadata : dict
        Provenance; its entry `scene` is the YAML text of the scene.

    Raises
    ------
    TrajectoryError
        The folder is missing, the path cannot be written, or holds something not ours.
    """

    def __init__(self, path: str | os.PathLike, channels: Sequence[Channel], metadata: dict):
        self.path = writable_target(path)
        self.samples, self._checkpointed, self._fault = 0, 0, ""
        self._sample_bytes = 8 * sum(math.prod(channel.shape) for channel in channels)
        self._spare_bytes = SPARE_BYTES * (4 + len(channels))
        partial = temporary_beside(self.path)
        try:
            _probe(partial, CHUNK_SAMPLES * self._sample_bytes + self._spare_bytes)
            self._file = _create_file(partial)
            self._reserve(CHUNK_SAMPLES * self._sample_bytes)
            with self._writing("write"):
                self._build(channels, metadata)
                os.replace(partial, self.path)
        finally:
            partial.unlink(missing_ok=True)

    def append(self, block: Block) -> None:
        """Add checked samples; they count once `checkpoint` has returned."""
        end = self.samples + len(block["time"])
        chunks = end // CHUNK_SAMPLES - self._checkpointed // CHUNK_SAMPLES + 1
        self._reserve(chunks * CHUNK_SAMPLES * self._sample_bytes)
        with self._writing("append to"):
            for name, dataset in self._datasets.items():
                dataset.resize(end, axis=0)
                dataset[self.samples : end] = block[name]
        self.samples = end

    def checkpoint(self) -> None:
        """Make everything appended so far safe against a kill."""
        with self._writing("write to"):
            self._file.flush()
            self._progress[0] = self._checkpointed = self.samples
            self._progress.flush()

    def finish(self, outcome: dict) -> None:
        """Store how the run ended and close the file."""
        text = json.dumps(outcome, allow_nan=False).encode("ascii")
        pieces = [text[i : i + PIECE_BYTES] for i in range(0, len(text), PIECE_BYTES)]
        self.checkpoint()
        try:
            self._reserve(len(text))
            with self._writing("write to"):
                self._outcome.resize(len(pieces), axis=0)
                self._outcome[:] = pieces
                self._file.flush()
                self._progress[1] = len(pieces)
                self._progress.flush()
        finally:
            self._close()

    def _build(self, channels: Sequence[Channel], metadata: dict) -> None:
        file = self._file
        provenance = {key: value for key, value in metadata.items() if key != "scene"}
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        file.attrs["provenance"] = json.dumps(provenance, allow_nan=False)
        file.create_dataset("scene", data=metadata.get("scene", ""), dtype=h5py.string_dtype())
        self._datasets = {channel.name: _create(file, channel) for channel in channels}
        file.attrs["channels"] = [channel.name for channel in channels]
        self._outcome = file.create_dataset(
            "outcome", (0,), f"S{PIECE_BYTES}", maxshape=(None,), chunks=(64,)
        )
        self._outcome.attrs["description"] = "how the run ended: JSON, to be joined"
        create_amendment(file)
        self._progress = file.create_dataset("progress", data=np.zeros(2, dtype=np.int64))
        self._progress.attrs["description"] = "samples safely written; pieces of outcome"
        file.swmr_mode = True
        file.flush()

    def _reserve(self, size: int) -> None:
        """Ask the disk for room for `size` more bytes of data and what HDF5 adds to them.

        A full disk is then found while nothing is in flight: HDF5 copes badly with a write
        that fails. What was asked for in excess is given back when the file is closed.
        """
        if self._fault or not hasattr(os, "posix_fallocate"):
            return
        end = self._file.id.get_filesize() + size + self._spare_bytes
        descriptor = self._file.id.get_vfd_handle()
        try:
            if end > os.fstat(descriptor).st_size:
                os.posix_fallocate(descriptor, 0, end)
        except OSError as error:
            raise self._disk_error("write to", error) from error

    @contextmanager
    def _writing(self, action: str) -> Iterator[None]:
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
        if self._fault:
            return
        with suppress(OSError, RuntimeError):
            os.ftruncate(self._file.id.get_vfd_handle(), self._file.id.get_filesize())
            self._file.close()

    def _disk_error(self, action: str, error: Exception) -> TrajectoryError:
        return TrajectoryError(
            f"cannot {action} '{self.path}': {reason(error)}; "
            "free some space on the disk or choose another folder"
        )


def writable_target(path: str | os.PathLike) -> Path:
    """The resolved place of a new file, if it is free or holds a trajectory of ours.

    Raises
    ------
    TrajectoryError
        The folder is missing, or the place holds a folder, a device or somebody else's file.
    """
    target = Path(path).expanduser().resolve()
    if not target.parent.is_dir():
        raise TrajectoryError(
            f"cannot write '{path}': there is no folder '{target.parent}'; create it first"
        )
    if target.is_dir():
        raise TrajectoryError(f"cannot write '{path}': it is a folder; name a file in it")
    if target.exists() and not (is_trajectory(target) and os.access(target, os.W_OK)):
        raise TrajectoryError(
            f"'{path}' exists and is not a trajectory that may be replaced; "
            "move it away or choose another name"
        )
    return target


def temporary_beside(target: Path) -> Path:
    """A name in the same folder, so that the finished file can be moved in one step."""
    return target.with_name(f".{target.name}.part")


def _probe(path: Path, size: int) -> None:
    """Find out whether a file of this size can be made, before HDF5 tries."""
    try:
        with open(path, "wb") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        raise TrajectoryError(
            f"cannot write to '{path.parent}': {reason(error)}; "
            "choose a folder that you may write to and that has room"
        ) from error


def _create_file(path: Path) -> h5py.File:
    return h5py.File(
        path,
        "w",
        libver=("v110", "v110"),  # the oldest with the single-writer mode: widest readability
        locking="best-effort",
        fs_strategy="page",
        fs_page_size=PAGE_BYTES,
        # per channel; samples are written once and in order, and memory must not follow the run
        rdcc_nbytes=CACHE_BYTES,
    )


def _create(file: h5py.File, channel: Channel) -> h5py.Dataset:
    dataset = file.create_dataset(
        channel.name,
        (0, *channel.shape),
        "<f8",
        maxshape=(None, *(width or None for width in channel.shape)),
        chunks=(CHUNK_SAMPLES, *(width or 1 for width in channel.shape)),
        fillvalue=np.nan,  # a sample never written must not look like one that was
    )
    dataset.attrs["unit"] = channel.unit
    dataset.attrs["frame"] = channel.frame
    dataset.attrs["description"] = channel.description
    if channel.labels:
        dataset.attrs["columns"] = list(channel.labels)
    return dataset
