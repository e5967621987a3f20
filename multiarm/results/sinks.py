"""Sinks: where a run puts its samples, block by block, until it ends as a `Trajectory`.

`MemorySink` keeps the samples, `Hdf5Sink` writes them to a file that survives a kill. Both refuse a
number that is not finite and keep everything before it, so that none gets into a result.

A run may take less than a millisecond, and most of its result may never be read. In memory, samples
stay the rows that the run produced; channels, provenance and the scene's text are made on access.
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
from multiarm.results.channels import Channel, Columns, first_fault, in_sequence
from multiarm.results.trajectory import CLOSED, Outcome, Trajectory, plain

Metadata = dict[str, Any] | Callable[[], dict[str, Any]]
"""Where samples come from, see :func:`provenance`, or a function that finds out on access."""
ColumnsOf = Callable[[Sequence[Channel]], Columns]

_DEPENDENCIES = ("pin", "numpy", "numba", "h5py", "pydantic")


class Sink:
    """Where the samples of a run go. The calls come in this order: one `open`, any number of
    `append` and `checkpoint`, one `finish`.
    """

    def open(
        self,
        channels: Sequence[Channel],
        metadata: Metadata,
        columns_of: ColumnsOf = in_sequence,
    ) -> None:
        """Prepare for samples of these channels.

        Parameters
        ----------
        channels : sequence of Channel
        metadata : dict, or callable that returns it
        columns_of : callable
            Channels -> where each is in a row; may be called later.

        Raises
        ------
        TrajectoryError
            Of a file: the folder is missing, the place cannot be written, or holds another file.
        """
        self._channels, self._metadata, self._columns_of = tuple(channels), metadata, columns_of
        self._width = sum(channel.width for channel in self._channels)
        self._begin()

    def append(self, rows: np.ndarray) -> None:
        """Take samples, shape (k, width).

        Raises
        ------
        TrajectoryError
            At the first number that is not finite; the samples before it are kept.
        """
        if rows.ndim != 2 or rows.shape[1] != self._width:
            raise TrajectoryError(
                f"a block of samples has shape {rows.shape}; expected (k, {self._width})"
            )
        if np.isfinite(rows).all():
            self._keep(rows)
            return
        end, fault = first_fault(self._channels, self._columns_of(self._channels), rows)
        self._keep(rows[:end])
        raise TrajectoryError(fault)

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process, as far as possible."""

    def finish(
        self,
        status: str,
        message: str,
        statistics: dict[str, Any],
        events: Iterable[dict[str, Any]] = (),
        certificate: dict[str, Any] | None = None,
    ) -> Trajectory:
        """Store how the run ended, see `Outcome`."""
        parts = plain([statistics, events, certificate])
        return self._trajectory(Outcome(status, message, *parts))

    def _begin(self) -> None:
        raise NotImplementedError

    def _keep(self, rows: np.ndarray) -> None:
        raise NotImplementedError

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        raise NotImplementedError


class MemorySink(Sink):
    """Keeps the samples in memory."""

    def _begin(self) -> None:
        self._blocks: list[np.ndarray] = []

    def _keep(self, rows: np.ndarray) -> None:
        self._blocks.append(rows.copy())

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        blocks = self._blocks
        if len(blocks) == 1:
            rows = blocks[0]
        else:
            rows, end = np.empty((sum(map(len, blocks)), self._width)), 0
            while blocks:  # each is released once it is copied: there is one copy at a time
                block = blocks.pop(0)
                rows[end : end + len(block)] = block
                end += len(block)
        store = MemoryStore(self._channels, rows, self._columns_of, self._metadata)
        return Trajectory(store, outcome)


class MemoryStore:
    """Samples in memory, read-only.

    Parameters
    ----------
    channels : sequence of Channel
    rows : ndarray, shape (K, width)
    columns_of, metadata
        See :meth:`Sink.open`.
    """

    def __init__(
        self,
        channels: Sequence[Channel],
        rows: np.ndarray,
        columns_of: ColumnsOf,
        metadata: Metadata,
    ):
        self.channels = {channel.name: channel for channel in channels}
        self.samples = len(rows)
        self._rows: np.ndarray | None = rows
        self._columns_of, self._metadata = columns_of, metadata
        rows.flags.writeable = False

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """Provenance, and the scene's text under `scene`."""
        return _found(self._metadata)

    @cached_property
    def _columns(self) -> Columns:
        return self._columns_of(tuple(self.channels.values()))

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


class Hdf5Sink(Sink):
    """Writes the samples to a file that can be loaded up to the last checkpoint, even if the
    process is killed.

    Parameters
    ----------
    path : path-like
        The file; one that multiarm wrote before is replaced when the run starts.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process."""
        self._writer.checkpoint()

    def _begin(self) -> None:
        from multiarm.results.trajectory_file import TrajectoryReader, TrajectoryWriter

        self._columns = self._columns_of(self._channels)
        target = TrajectoryReader.writable_target(self.path)
        self._writer = TrajectoryWriter(target, self._channels, _found(self._metadata))

    def _keep(self, rows: np.ndarray) -> None:
        block = {
            channel.name: rows[:, self._columns[channel.name]].reshape(len(rows), *channel.shape)
            for channel in self._channels
        }
        self._writer.append(block)

    def _trajectory(self, outcome: Outcome) -> Trajectory:
        """Close the file and open it for reading.

        A full disk fails the run: the trajectory says so, and holds what is in the file.
        """
        from multiarm.results.trajectory_file import TrajectoryReader

        try:
            self._writer.finish(asdict(outcome))
        except TrajectoryError as error:
            fault, first = str(error), outcome.message
            if outcome.status != "completed":  # what ended the run comes first, and stands once
                fault = first if fault in first else f"{first}; {fault}"
            outcome = replace(outcome, status="failed", message=fault)
        return Trajectory(TrajectoryReader(self._writer.path), outcome)


def provenance(scene_text: str, created: float | None = None) -> dict[str, Any]:
    """Where a result comes from: the scene's text, versions, platform and time.

    Parameters
    ----------
    scene_text : str
        YAML that `multiarm.scene.parse_scene` reads back, with absolute paths.
    created : float, optional
        `time.time()` of the run's start; now, when left out.
    """
    when = datetime.fromtimestamp(time.time() if created is None else created, timezone.utc)
    return {
        "program": "multiarm",
        "version": _version("multiarm"),
        "dependencies": {name: _version(name) for name in _DEPENDENCIES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "created_utc": when.isoformat(timespec="seconds"),
        "scene": scene_text,
    }


def _found(metadata: Metadata) -> dict[str, Any]:
    """Metadata in JSON's types."""
    return plain(metadata() if callable(metadata) else metadata)


@cache
def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
