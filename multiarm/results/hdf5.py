"""HDF5 files as they are read: complete, still being written, or left by a killed writer.

While a file is written (:mod:`multiarm.results.trajectory_file`), a flag is set in its first 48
bytes, the superblock. HDF5 then refuses the file, or waits forever for incomplete entries. After a
kill the flag stays set. `_Unclosed` presents such a file with the flag cleared and its true length:
what the tool `h5clear` writes into a file, without changing it.

    superblock, version 3:   0 signature   8 version   11 flags   28 end of file   44 checksum

The checksum is lookup3 (B. Jenkins, 2006) of the bytes before it.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from multiarm.errors import TrajectoryError
from multiarm.results.files import resolved, target_fault

HDF5_ERRORS = (
    OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, MemoryError,
)  # fmt: skip
"""Exceptions of h5py for a damaged file."""
FORMAT, VERSION = "multiarm trajectory", 1
"""Attribute `format` of a file, and the newest `format_version` that this program reads."""
REMEDY = "copy it again or repeat the run"


class StoredFile:
    """A trajectory's file open for reading: complete, still being written, or left by a kill.

    What is in it, :meth:`load` reads.

    Raises
    ------
    TrajectoryError
        Missing, unreadable, cut short, not a trajectory, or written by a newer format.
    """

    file: h5py.File

    def __init__(self, path: Path):
        self.path = path
        self._size: int | None = None
        attempts = 4
        for attempt in range(1, attempts + 1):
            try:
                self._open()
                return
            except TrajectoryError:  # a file that is being written changes while it is read
                if attempt == attempts or not (path.is_file() and _is_unclosed(path)):
                    raise
                time.sleep(0.1)

    def load(self) -> None:
        """Read the contents of the open file, through the methods that check them."""
        raise NotImplementedError

    def broken(self, what: str) -> TrajectoryError:
        """The error that names the file and what in it cannot be used."""
        return TrajectoryError(f"'{self.path}' cannot be used: {what}; {REMEDY}")

    def attribute(
        self, name: str, sort: type | tuple[type, ...], of: h5py.Dataset | None = None
    ) -> Any:
        """An attribute of the file, or of a dataset; it is of this type."""
        value = (self.file if of is None else of).attrs.get(name)
        if not isinstance(value, sort):
            whose = "the file" if of is None else f"'{of.name[1:]}'"
            raise self.broken(f"attribute '{name}' of {whose} is missing, or of another type")
        return value

    def dataset(self, name: str, kinds: str, dimensions: int | None = None) -> h5py.Dataset:
        """A dataset with these kinds of numbers (as in NumPy) and dimensions, in this file itself.

        Without ``dimensions`` it has rows, of any shape.

        Links are not followed: they may lead to other files, or to themselves.
        """
        owner = self._part(name)
        shape = owner.shape if isinstance(owner, h5py.Dataset) else None
        fits = shape is not None and (len(shape) == dimensions or (dimensions is None and shape))
        if not fits or owner.dtype.kind not in kinds:
            raise self.broken(f"'{name}' does not hold what its name says")
        return owner

    def _part(self, name: str) -> Any:
        """A group or a dataset; groups are looked up once."""
        way, _, last = name.rpartition("/")
        if way and way not in self._groups:
            self._groups[way] = self._part(way)
        owner = self._groups[way] if way else self.file
        link = owner.get(last, getlink=True) if isinstance(owner, h5py.Group) else None
        if link is None:
            raise self.broken(f"'{name}' is missing")
        if not isinstance(link, h5py.HardLink):
            raise self.broken(f"'{name}' is a link, which is not followed")
        return owner[last]

    def text(self, name: str) -> str:
        """A dataset that is one text."""
        stored = self.dataset(name, "O", 0)
        if h5py.check_string_dtype(stored.dtype) is None:
            raise self.broken(f"'{name}' is not a text")
        return stored.asstr()[()]

    def table(self, text: str, what: str) -> dict[str, Any]:
        """A table from JSON, whose numbers are finite."""
        try:
            table = json.loads(text, parse_constant=_refused)
        except (ValueError, RecursionError):
            table = None
        if not isinstance(table, dict):
            raise self.broken(f"{what} is no table in JSON")
        return table

    def require(self, name: str, rows: int = 0) -> None:
        """Refuse a file that was cut short within the first `rows` rows of a dataset.

        HDF5 reads zeros past the end of a file that was not closed.
        """
        if self._size is not None and not _stored_within(self.file[name], rows, self._size):
            raise OSError("data beyond the end of the file")

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self.file.close()

    def _open(self) -> None:
        self.file, closed = opened(self.path)
        with reading(self.path):
            stored_format = self.file.attrs.get("format")
            if not isinstance(stored_format, str) or stored_format != FORMAT:
                raise TrajectoryError(
                    f"'{self.path}' is an HDF5 file, but not a trajectory of multiarm"
                )
            version = int(self.attribute("format_version", (int, np.integer)))
            if version < 1:
                raise self.broken(f"its format version is {version}")
            if version > VERSION:
                raise TrajectoryError(
                    f"'{self.path}' has format version {version}; this program reads up to "
                    f"{VERSION}: update multiarm"
                )
            self._groups: dict[str, Any] = {}
            self._size = None if closed else self.path.stat().st_size
            self.load()


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn exceptions of HDF5 while reading into messages."""
    try:
        yield
    except HDF5_ERRORS as error:
        raise TrajectoryError(
            f"'{path}' is damaged or was cut short ({reason(error)}); {REMEDY}"
        ) from error


def opened(path: Path) -> tuple[h5py.File, bool]:
    """A file of any format, open for reading, and whether its writer closed it."""
    path = resolved(path, TrajectoryError)
    if not path.is_file():
        what = "it is a folder" if path.is_dir() else "there is no such file"
        what = "it is no ordinary file" if path.exists() and not path.is_dir() else what
        raise TrajectoryError(f"cannot read '{path}': {what}")
    with reading(path):
        if not h5py.is_hdf5(path):
            raise TrajectoryError(
                f"'{path}' is not an HDF5 file; a trajectory is written by a run or by save()"
            )
        if _is_unclosed(path):
            return h5py.File(_Unclosed(path), "r"), False
        return h5py.File(path, "r", locking="best-effort"), True


def is_trajectory(path: Path) -> bool:
    """Whether a file has this format, in any version and state."""
    try:
        with opened(path)[0] as file:
            return str(file.attrs.get("format")) == FORMAT
    except (TrajectoryError, *HDF5_ERRORS):
        return False


def writable_target(path: str | os.PathLike) -> Path:
    """The resolved path of a new file, if it is free or holds a file of this format.

    Raises
    ------
    TrajectoryError
        The folder is missing, or the path is a folder, a device or another kind of file.
    """
    target = resolved(path, TrajectoryError)
    if target.is_file() and not (is_trajectory(target) and os.access(target, os.W_OK)):
        raise TrajectoryError(
            f"'{path}' exists and is not a trajectory that may be replaced: it is something "
            "else, damaged or write-protected; move it away or choose another name"
        )
    fault = target_fault(target)
    if fault:
        raise TrajectoryError(f"cannot write '{path}': {fault}")
    return target


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def reason(error: Exception) -> str:
    """The operating system's message, else the first line of HDF5's."""
    text = str(error).strip()
    number = getattr(error, "errno", None) or next(iter(re.findall(r"errno = (\d+)", text)), None)
    return os.strerror(int(number)) if number else text.partition("\n")[0].strip("'\"")


def _stored_within(dataset: h5py.Dataset, rows: int, size: int) -> bool:
    """Whether the first `rows` rows of a dataset are stored, all before byte `size`."""
    if dataset.chunks is None:
        return dataset.id.get_offset() + dataset.id.get_storage_size() <= size
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


_SUPERBLOCK_BYTES, _FLAGS, _END, _CHECKSUM = 48, 11, 28, 44
_MASK = 0xFFFFFFFF


def _is_unclosed(path: Path) -> bool:
    """Whether a file of format `v110` is being written, or its writer was killed."""
    with open(path, "rb") as file:
        head = file.read(_SUPERBLOCK_BYTES)
    return len(head) == _SUPERBLOCK_BYTES and head[8] == 3 and head[_FLAGS] != 0


class _Unclosed(io.FileIO):
    """The bytes of an unclosed file, with a superblock as if it had been closed."""

    def __init__(self, path: Path):
        super().__init__(path, "rb")
        head = bytearray(super().read(_SUPERBLOCK_BYTES))
        head[_FLAGS] = 0
        struct.pack_into("<Q", head, _END, os.fstat(self.fileno()).st_size)
        struct.pack_into("<I", head, _CHECKSUM, lookup3(bytes(head[:_CHECKSUM])))
        self._head = bytes(head)
        self.seek(0)

    def __del__(self) -> None:
        self.close()  # HDF5 reads through this object, but does not close it

    def readinto(self, buffer) -> int:
        """Fill a buffer from the current position."""
        start = self.tell()
        size = super().readinto(buffer)
        head = self._head[start : start + size]
        memoryview(buffer).cast("B")[: len(head)] = head
        return size


def lookup3(data: bytes) -> int:
    """Jenkins's hash `lookup3` of some bytes, as HDF5 uses it: 32 bits, initial value 0."""
    a = b = c = (0xDEADBEEF + len(data)) & _MASK
    blocks = max(1, -(-len(data) // 12))
    words = struct.unpack(f"<{3 * blocks}I", data.ljust(12 * blocks, b"\0"))
    for i in range(0, 3 * (blocks - 1), 3):
        a, b, c = a + words[i], b + words[i + 1], c + words[i + 2]
        for shift in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & _MASK) ^ _rotated(c, shift)
            a, b, c = b, (c + b) & _MASK, a
    a, b, c = a + words[-3], b + words[-2], c + words[-1]
    for shift in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _rotated(b, shift)) & _MASK
        a, b, c = b, c, a
    return b


def _rotated(word: int, shift: int) -> int:
    word &= _MASK
    return ((word << shift) | (word >> (32 - shift))) & _MASK
