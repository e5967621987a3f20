"""Open a file for reading and see that it is what it is expected to be, whole or never closed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py

from multiarm.errors import MultiarmError
from multiarm.results.storage.layout import reason
from multiarm.results.storage.recovery import Unclosed, is_unclosed

HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError)
"""What h5py raises for a file that is not what it should be."""


@dataclass(frozen=True)
class FileKind:
    """What a file is expected to be, and the words for it.

    Attributes
    ----------
    format : str
        The attribute of that name.
    version : int
        The newest that this program reads.
    noun, origin, remedy : str
        What it is, where such files come from, what to do about a damaged one.
    trouble : type
        Of the errors that are raised.
    """

    format: str
    version: int
    noun: str
    origin: str
    remedy: str
    trouble: type[MultiarmError]

    def open_for_reading(self, path: Path) -> tuple[h5py.File, bool]:
        """The open file, and whether it was closed properly when it was written."""
        if not path.is_file():
            what = "it is a folder" if path.is_dir() else "there is no such file"
            raise self.trouble(f"cannot read '{path}': {what}")
        with self.reading(path):
            if not h5py.is_hdf5(path):
                raise self.trouble(f"'{path}' is not an HDF5 file; {self.origin}")
            if is_unclosed(path):
                return h5py.File(Unclosed(path), "r"), False
            return h5py.File(path, "r", locking="best-effort"), True

    def check(self, path: Path, file: h5py.File) -> None:
        """Refuse another format, or a version that is to come."""
        if file.attrs.get("format") != self.format:
            raise self.trouble(f"'{path}' is an HDF5 file, but not {self.noun} of multiarm")
        version = int(file.attrs["format_version"])
        if version > self.version:
            raise self.trouble(
                f"'{path}' has format version {version}; this program reads up to {self.version}: "
                "update multiarm"
            )

    def matches(self, path: Path) -> bool:
        """Whether a file is one of these, whatever its version and state."""
        try:
            with self.open_for_reading(path)[0] as file:
                return file.attrs.get("format") == self.format
        except (self.trouble, *HDF5_ERRORS):
            return False

    @contextmanager
    def reading(self, path: Path) -> Iterator[None]:
        """Around all reads: what HDF5 raises becomes a message."""
        try:
            yield
        except HDF5_ERRORS as error:
            raise self.trouble(
                f"'{path}' is damaged or was cut short ({reason(error)}); {self.remedy}"
            ) from error

    def writable_target(self, path: str | os.PathLike) -> Path:
        """The resolved place of a new file, if it is free or holds one of these.

        Raises
        ------
        MultiarmError
            The folder is missing, or the place holds a folder, a device or somebody else's file.
        """
        target = Path(path).expanduser().resolve()
        if not target.parent.is_dir():
            raise self.trouble(
                f"cannot write '{path}': there is no folder '{target.parent}'; create it first"
            )
        if target.is_dir():
            raise self.trouble(f"cannot write '{path}': it is a folder; name a file in it")
        if target.exists() and not (self.matches(target) and os.access(target, os.W_OK)):
            raise self.trouble(
                f"'{path}' exists and is not {self.noun} that may be replaced: it is something "
                "else, damaged or write-protected; move it away or choose another name"
            )
        return target


def stored_inside(dataset: h5py.Dataset, rows: int, size: int) -> bool:
    """Whether the chunks of the first `rows` rows exist and end before byte `size`.

    HDF5 reads zeros behind the end of a file that was not closed.
    """
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


def unchunked_inside(dataset: h5py.Dataset, size: int) -> bool:
    """Whether a dataset of fixed size ends before byte `size`."""
    return dataset.id.get_offset() + dataset.id.get_storage_size() <= size
