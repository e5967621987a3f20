"""An HDF5 file that only grows: a kill at any moment, or a full disk, leaves one that can be read.

Everything is created before the file enters HDF5's single-writer-multiple-readers mode; from
then on only datasets grow, and HDF5 writes what is pointed to before what points to it. Its index
never crosses a page of the file, so that the operating system cannot leave half of an entry.

The file is built beside its final place under a temporary name and moved there once it is
complete: an older file at that place survives until then, and those who still read it keep their
data.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py

from multiarm.errors import MultiarmError, TrajectoryError
from multiarm.results.files import complete
from multiarm.results.storage.layout import CACHE_BYTES, PAGE_BYTES, reason

_UNCLOSABLE: list[GrowingFile] = []
"""Files with a failed write, kept to the end of the program: HDF5 crashes on closing one."""


class GrowingFile:
    """A new file, at its place and ready to grow.

    Parameters
    ----------
    path : Path
        Where it shall be, see :func:`writable_target`.
    build : callable
        Creates everything in the open file that it is given.
    first_bytes : int
        Room to ask for at first.
    spare_bytes : int
        Room to ask for beyond data: descriptions and index.
    trouble : type
        Of the errors that are raised.

    Raises
    ------
    MultiarmError
        The folder cannot be written, or has no room.

    Attributes
    ----------
    file : h5py.File
    """

    def __init__(
        self,
        path: Path,
        build: Callable[[h5py.File], None],
        first_bytes: int,
        spare_bytes: int,
        trouble: type[MultiarmError] = TrajectoryError,
    ):
        self.path, self._spare_bytes, self._trouble, self._fault = path, spare_bytes, trouble, ""
        # one name for all: writers come one at a time, the next removes what a killed one left
        beside = path.with_name(f".{path.name}.part")
        with self._room(path.parent), complete(path, beside) as partial:
            _allocate(partial, first_bytes + spare_bytes)
            self.file = _create_file(partial)
            self.reserve(first_bytes)
            with self.writing("write"):
                build(self.file)
                self.file.swmr_mode = True
                self.file.flush()

    def reserve(self, size: int) -> None:
        """Ask the disk for room for `size` more bytes of data and what HDF5 adds to them.

        A full disk is then found while nothing is in flight: HDF5 copes badly with a write
        that fails. What was asked for in excess is given back when the file is closed.
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
    def writing(self, action: str) -> Iterator[None]:
        """Around all writes: an error becomes a message, and ends all writing."""
        if self._fault:
            raise self._trouble(self._fault)
        try:
            yield
        except (OSError, RuntimeError) as error:
            fault = self._disk_error(action, error)
            self._fault = str(fault)
            _UNCLOSABLE.append(self)
            raise fault from error

    def close(self) -> None:
        """Close the file, and give back the room that was not needed."""
        if self._fault or not self.file:
            return
        with suppress(OSError, RuntimeError):
            os.ftruncate(self.file.id.get_vfd_handle(), self.file.id.get_filesize())
            self.file.close()

    @contextmanager
    def _room(self, folder: Path) -> Iterator[None]:
        """Around the making of the file: an error becomes a message."""
        try:
            yield
        except OSError as error:
            raise self._trouble(
                f"cannot write to '{folder}': {reason(error)}; "
                "choose a folder that you may write to and that has room"
            ) from error

    def _disk_error(self, action: str, error: Exception) -> MultiarmError:
        return self._trouble(
            f"cannot {action} '{self.path}': {reason(error)}; "
            "free some space on the disk or choose another folder"
        )


def _allocate(path: Path, size: int) -> None:
    """Find out whether a file of this size can be made, before HDF5 tries."""
    if hasattr(os, "posix_fallocate"):
        with open(path, "r+b") as file:
            os.posix_fallocate(file.fileno(), 0, size)


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
