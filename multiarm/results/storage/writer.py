"""Write a run so that a kill at any moment leaves a file that can be read.

The file only grows, see `growing`. A checkpoint flushes the channels first and `progress` after
them. Whatever was appended behind the last `progress` is not read, so that all channels of an
interrupted run have the same length.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence

import h5py
import numpy as np

from multiarm.results.channels import Block, Channel
from multiarm.results.storage.amendment import create_amendment
from multiarm.results.storage.growing import GrowingFile
from multiarm.results.storage.layout import CHUNK_SAMPLES, FORMAT, FORMAT_VERSION, PIECE_BYTES
from multiarm.results.storage.reader import TRAJECTORY

SPARE_BYTES = 16384
"""Room asked for per channel beyond its data: descriptions and index."""


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
        self.path = TRAJECTORY.writable_target(path)
        self.samples, self._checkpointed = 0, 0
        self._sample_bytes = 8 * sum(math.prod(channel.shape) for channel in channels)
        self._grown = GrowingFile(
            self.path,
            lambda file: self._build(file, channels, metadata),
            CHUNK_SAMPLES * self._sample_bytes,
            SPARE_BYTES * (4 + len(channels)),
        )
        self._file = self._grown.file

    def append(self, block: Block) -> None:
        """Add checked samples; they count once `checkpoint` has returned."""
        end = self.samples + len(block["time"])
        chunks = end // CHUNK_SAMPLES - self._checkpointed // CHUNK_SAMPLES + 1
        self._grown.reserve(chunks * CHUNK_SAMPLES * self._sample_bytes)
        with self._grown.writing("append to"):
            for name, dataset in self._datasets.items():
                dataset.resize(end, axis=0)
                dataset[self.samples : end] = block[name]
        self.samples = end

    def checkpoint(self) -> None:
        """Make everything appended so far safe against a kill."""
        with self._grown.writing("write to"):
            self._file.flush()
            self._progress[0] = self._checkpointed = self.samples
            self._progress.flush()

    def finish(self, outcome: dict) -> None:
        """Store how the run ended and close the file."""
        text = json.dumps(outcome, allow_nan=False).encode("ascii")
        pieces = [text[i : i + PIECE_BYTES] for i in range(0, len(text), PIECE_BYTES)]
        self.checkpoint()
        try:
            self._grown.reserve(len(text))
            with self._grown.writing("write to"):
                self._outcome.resize(len(pieces), axis=0)
                self._outcome[:] = pieces
                self._file.flush()
                self._progress[1] = len(pieces)
                self._progress.flush()
        finally:
            self._grown.close()

    def _build(self, file: h5py.File, channels: Sequence[Channel], metadata: dict) -> None:
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
