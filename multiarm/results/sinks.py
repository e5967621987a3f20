"""Sinks: they take the samples of a run block by block, and become its `Trajectory`.

`MemorySink` keeps the samples, `Hdf5Sink` writes them to a file that survives a kill. Both refuse a
number that is not finite and keep everything before it.

A run may take less than a millisecond, and most of its result may never be read: in memory, samples
stay the rows of the run, and channels, provenance and the scene's text are made on access.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import (
    CLOSED,
    Channel,
    Columns,
    first_fault,
    in_sequence,
    recordable,
    width_of,
)
from multiarm.results.outcome import Outcome, RunStatus, plain
from multiarm.results.trajectory import Trajectory

Metadata = dict[str, Any] | Callable[[], dict[str, Any]]
"""Provenance, see :func:`provenance`, or a function that returns it on access."""


class Sink:
    """Takes the samples of a run. Order of the calls: one `open`, any number of `append` and
    `checkpoint`, one `finish`.
    """

    def open(self, channels: Sequence[Channel], metadata: Metadata) -> None:
        """Prepare for samples of these channels, which follow each other in a row.

        Raises
        ------
        TrajectoryError
            The folder of a file is missing, or the path cannot be written or holds another file.
        """
        self._channels, self._metadata = tuple(channels), metadata
        self._width = width_of(self._channels)
        self._begin()

    def append(self, rows: np.ndarray) -> None:
        """Take samples, shape (k, width).

        Raises
        ------
        TrajectoryError
            At the first number that no result holds; the samples before it are kept.
        """
        if rows.ndim != 2 or rows.shape[1] != self._width:
            raise TrajectoryError(
                f"a block of samples has shape {rows.shape}; expected (k, {self._width})"
            )
        if recordable(rows).all():
            self._keep(rows)
            return
        end, fault = first_fault(self._channels, in_sequence(self._channels), rows)
        self._keep(rows[:end])
        raise TrajectoryError(fault)

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process, if they go to a file."""

    def finish(
        self,
        status: RunStatus,
        message: str,
        statistics: dict[str, Any],
        events: Iterable[dict[str, Any]] = (),
        certificate: dict[str, Any] | None = None,
        remarks: Iterable[str] = (),
    ) -> Trajectory:
        """Store how the run ended, see `Outcome`."""
        parts = plain([statistics, events, certificate, remarks])
        return self._trajectory(Outcome(status, message, *parts))

    def _begin(self) -> None:
        raise NotImplementedError

    def _keep(self, rows: np.ndarray) -> None:
        raise NotImplementedError

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        raise NotImplementedError


class MemorySink(Sink):
    """Keeps the samples in memory, as ``blocks`` (k, width)."""

    def _begin(self) -> None:
        self.blocks: list[np.ndarray] = []

    def _keep(self, rows: np.ndarray) -> None:
        self.blocks.append(rows.copy())

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        blocks = self.blocks
        if len(blocks) == 1:
            rows = blocks[0]
        else:
            rows, end = np.empty((sum(map(len, blocks)), self._width)), 0
            while blocks:  # each is released once it is copied: memory holds the samples once
                block = blocks.pop(0)
                rows[end : end + len(block)] = block
                end += len(block)
        store = MemoryStore(self._channels, rows, self._metadata)
        return Trajectory(store, outcome)


class MemoryStore:
    """Samples in memory, read-only: ``rows`` has shape (K, width); else see :meth:`Sink.open`."""

    path = None

    def __init__(
        self,
        channels: Sequence[Channel],
        rows: np.ndarray,
        metadata: Metadata,
    ):
        self.channels = {channel.name: channel for channel in channels}
        self.samples = len(rows)
        self._rows: np.ndarray | None = rows
        self._metadata = metadata
        rows.flags.writeable = False

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """Provenance, and the scene's text under `scene`."""
        return _evaluated(self._metadata)

    @cached_property
    def _columns(self) -> Columns:
        return in_sequence(self.channels.values())

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel, a view."""
        if self._rows is None:
            raise TrajectoryError(CLOSED)
        values = self._rows[start:stop, self._columns[name]]
        return values.reshape(len(values), *self.channels[name].shape)

    def close_between_reads(self) -> None:
        """Nothing to do: nothing is open."""

    def close(self) -> None:
        """Release the samples; nothing more can be read."""
        self._rows = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "metadata": self.metadata, "_metadata": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._rows is not None:
            self._rows.flags.writeable = False


class Hdf5Sink(Sink):
    """Writes the samples to a file that can be loaded up to the last checkpoint after a kill.

    A file at ``path`` that multiarm wrote before is replaced when the run starts.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process."""
        self._writer.checkpoint()

    def _begin(self) -> None:
        from multiarm.results.hdf5 import writable_target
        from multiarm.results.trajectory_file import TrajectoryWriter

        self._columns = in_sequence(self._channels)
        target = writable_target(self.path)
        self._writer = TrajectoryWriter(target, self._channels, _evaluated(self._metadata))

    def _keep(self, rows: np.ndarray) -> None:
        block = {
            channel.name: rows[:, self._columns[channel.name]].reshape(len(rows), *channel.shape)
            for channel in self._channels
        }
        self._writer.append(block)

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        """Close the file and open it for reading.

        A full disk fails the run: the trajectory has a message and the samples in the file.
        """
        from multiarm.results.trajectory_file import TrajectoryReader

        try:
            self._writer.finish(asdict(outcome))
        except TrajectoryError as error:
            fault, first = str(error), outcome.message
            if outcome.status != RunStatus.COMPLETED:  # the first fault comes first, and only once
                fault = first if fault in first else f"{first}; {fault}"
            outcome = replace(outcome, status=RunStatus.FAILED, message=fault)
        return Trajectory(TrajectoryReader(self._writer.path), outcome)


def provenance(scene_text: str, created: float | None = None) -> dict[str, Any]:
    """Origin of a result: the scene's text (YAML with absolute paths), versions, platform, time.

    ``created`` is `time.time()` at the run's start; now by default.
    """
    when = datetime.fromtimestamp(time.time() if created is None else created, timezone.utc)
    return {
        "program": "multiarm",
        "version": _version("multiarm"),
        "dependencies": {
            name: _version(name) for name in ("pin", "numpy", "numba", "h5py", "pydantic")
        },
        "python": platform.python_version(),
        "platform": platform.platform(),
        "created_utc": when.isoformat(timespec="seconds"),
        "scene": scene_text,
    }


def _evaluated(metadata: Metadata) -> dict[str, Any]:
    """Metadata in types of JSON."""
    return plain(metadata() if callable(metadata) else metadata)


@cache
def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
