"""Sinks: where a run pours its samples, block by block, until it ends as a `Trajectory`.

`MemorySink` keeps the samples, `Hdf5Sink` writes them to a file that survives a kill. Both
refuse a number that is not finite and keep everything before it; both end the same way.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.channels import Block, Channel, finite_rows
from multiarm.results.outcome import Outcome, plain
from multiarm.results.sample_store import ArrayStore
from multiarm.results.trajectory import Trajectory

_DEPENDENCIES = ("pin", "numpy", "numba", "h5py", "pydantic")


class Sink(Protocol):
    """Where the samples of a run go. The calls come in this order: one `open`, any number of
    `append` and `checkpoint`, one `finish`.
    """

    def open(self, channels: Sequence[Channel], metadata: dict[str, Any]) -> None:
        """Get ready for blocks of these channels; `metadata` comes from `provenance`."""

    def append(self, block: Block) -> None:
        """Take samples (leading axis) of all channels.

        Raises TrajectoryError at the first number that is not finite; the samples before it
        are kept.
        """

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process."""

    def finish(
        self,
        status: str,
        message: str,
        statistics: dict[str, Any],
        events: Iterable[dict[str, Any]] = (),
        certificate: dict[str, Any] | None = None,
    ) -> Trajectory:
        """Store how the run ended."""


class MemorySink:
    """Keeps the samples in memory. See `Sink`."""

    def open(self, channels: Sequence[Channel], metadata: dict[str, Any]) -> None:
        """Get ready for blocks of these channels."""
        self._channels, self._metadata = tuple(channels), metadata
        self._blocks: list[Block] = []

    def append(self, block: Block) -> None:
        """Keep copies of the samples before the first number that is not finite."""
        rows, fault = finite_rows(self._channels, block)
        self._blocks.append(rows)
        if fault:
            raise TrajectoryError(fault)

    def checkpoint(self) -> None:
        """Nothing to do: memory does not outlive the process."""

    def finish(
        self,
        status: str,
        message: str,
        statistics: dict[str, Any],
        events: Iterable[dict[str, Any]] = (),
        certificate: dict[str, Any] | None = None,
    ) -> Trajectory:
        """Join the blocks to a trajectory."""
        outcome = _outcome(status, message, statistics, events, certificate)
        metadata, blocks = self._metadata, self._blocks
        if not blocks:
            blocks = [{channel.name: np.empty((0, *channel.shape)) for channel in self._channels}]
        arrays = blocks[0]
        if len(blocks) > 1:
            arrays = {
                channel.name: np.concatenate([block.pop(channel.name) for block in blocks])
                for channel in self._channels
            }
        return Trajectory(ArrayStore(self._channels, arrays, lambda: _told(metadata)), outcome)


class Hdf5Sink:
    """Writes the samples to a file that can be loaded up to the last checkpoint, even if the
    process is killed. See `Sink`.

    Parameters
    ----------
    path : path-like
        The file; one that multiarm wrote before is replaced when the run starts.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)

    def open(self, channels: Sequence[Channel], metadata: dict[str, Any]) -> None:
        """Make the file.

        Raises
        ------
        TrajectoryError
            The folder is missing, the place cannot be written, or holds somebody else's file.
        """
        from multiarm.results.storage import Hdf5Writer

        self._channels = tuple(channels)
        self._writer = Hdf5Writer(self.path, self._channels, _told(metadata))

    def append(self, block: Block) -> None:
        """Write the samples before the first number that is not finite."""
        rows, fault = finite_rows(self._channels, block)
        self._writer.append(rows)
        if fault:
            raise TrajectoryError(fault)

    def checkpoint(self) -> None:
        """Make all samples so far safe against a kill of the process."""
        self._writer.checkpoint()

    def finish(
        self,
        status: str,
        message: str,
        statistics: dict[str, Any],
        events: Iterable[dict[str, Any]] = (),
        certificate: dict[str, Any] | None = None,
    ) -> Trajectory:
        """Store how the run ended, close the file and open it for reading.

        A disk that takes no more fails the run: the trajectory returned says so, and holds what
        is in the file.
        """
        from multiarm.results.storage import Hdf5Store

        outcome = _outcome(status, message, statistics, events, certificate)
        try:
            self._writer.finish(asdict(outcome))
        except TrajectoryError as error:
            fault = str(error)
            if status != "completed":  # what ended the run comes first, and is said once
                fault = message if fault in message else f"{message}; {fault}"
            outcome = replace(outcome, status="failed", message=fault)
        return Trajectory(Hdf5Store(self._writer.path), outcome)


def provenance(scene_text: str | Callable[[], str]) -> dict[str, Any]:
    """Where a result comes from: the scene's text, versions, platform and the time now.

    Parameters
    ----------
    scene_text : str, or callable that returns it
        YAML that `multiarm.scene.parse_scene` reads back, with absolute paths. A callable is asked
        when somebody wants to know: writing a scene takes longer than many a run.
    """
    return {
        "program": "multiarm",
        "version": _version("multiarm"),
        "dependencies": {name: _version(name) for name in _DEPENDENCIES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "created_utc": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "scene": scene_text,
    }


def _told(metadata: dict[str, Any]) -> dict[str, Any]:
    """Metadata in what JSON knows, the scene written out."""
    return plain({key: value() if callable(value) else value for key, value in metadata.items()})


def _outcome(
    status: str,
    message: str,
    statistics: dict[str, Any],
    events: Iterable[dict[str, Any]],
    certificate: dict[str, Any] | None,
) -> Outcome:
    parts = plain([dict(statistics), list(events), certificate])
    return Outcome(status, message, *parts)


@cache
def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
