"""HDF5 files that can be read after a kill of their writer at any moment, or on a full disk.

A writer creates all datasets first and then enters HDF5's single-writer-multiple-reader mode. From
then on datasets only grow, and HDF5 writes data before the index that points to them. The index
never crosses a page of the file, so that the operating system cannot leave half of an entry. What
counts is in a small dataset `progress`, which is written last.

A file is created under a temporary name and moved to its place when it is ready to grow: an older
file there survives until then, and programs that still read it keep their data.

While a file is written, a flag is set in its first 48 bytes, the superblock. HDF5 then refuses
the file, or waits forever for incomplete entries. After a kill the flag stays set. `_Unclosed`
presents such a file with the flag cleared and its true length: what the tool `h5clear` writes into
a file, without changing it.

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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np

from multiarm.errors import MultiarmError
from multiarm.results.files import atomic_file, resolved

HDF5_ERRORS = (
    OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, MemoryError,
)  # fmt: skip
"""Exceptions of h5py for a damaged file."""
PIECE_BYTES = 120
PIECE = f"S{PIECE_BYTES}"
"""Type of a piece of text, a line in `h5dump`: HDF5 cannot append to one long text."""

_UNCLOSABLE: list[GrowingFile] = []
"""Files with a failed write, kept until the program ends: HDF5 crashes on closing one."""


class StoredFile:
    """A file open for reading: complete, still being written, or left by a killed writer.

    Subclasses name their format and read their contents in :meth:`load`.

    Raises
    ------
    MultiarmError
        Missing, unreadable, cut short, of another format, or of a newer version.

    Attributes
    ----------
    format, version : str, int
        Attribute `format` of the file, and the newest `format_version` that this program reads.
    noun, origin, remedy : str
        For messages: the kind of file, where it comes from, what to do about a damaged one.
    error : type
        Of the errors that are raised.
    """

    format: ClassVar[str]
    version: ClassVar[int]
    noun: ClassVar[str]
    origin: ClassVar[str]
    remedy: ClassVar[str]
    error: ClassVar[type[MultiarmError]]
    file: h5py.File

    def __init__(self, path: Path):
        self.path = path
        self._size: int | None = None
        attempts = 4
        for attempt in range(1, attempts + 1):
            try:
                self._open()
                return
            except self.error:  # a file that is being written changes while it is read
                if attempt == attempts or not (path.is_file() and _is_unclosed(path)):
                    raise
                time.sleep(0.1)

    def load(self) -> None:
        """Read the contents of the open file, through the methods that check them."""
        raise NotImplementedError

    def broken(self, what: str) -> MultiarmError:
        """The error that names the file and what in it cannot be used."""
        return self.error(f"'{self.path}' cannot be used: {what}; {self.remedy}")

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
            found = json.loads(text, parse_constant=_refused)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise self.broken(f"{what} is no table in JSON")
        return found

    def counters(self, name: str) -> list[int]:
        """Two numbers of rows."""
        found = self.dataset(name, "iu", 1)[:].tolist()
        if len(found) != 2 or min(found) < 0:
            raise self.broken(f"'{name}' is not two numbers of rows")
        return found

    def pieces(self, name: str, begin: int, end: int) -> str:
        """The text in some rows of a dataset, see :func:`in_pieces`."""
        stored = self.dataset(name, "S", 1)
        if not begin <= end <= len(stored):
            raise self.broken(f"'{name}' has {len(stored)} pieces, none from {begin} to {end}")
        self.require(name, end)
        return joined(stored[begin:end])

    def require(self, name: str, rows: int = 0) -> None:
        """Refuse a file that was cut short within the first `rows` rows of a dataset.

        HDF5 reads zeros past the end of a file that was not closed.
        """
        if self._size is not None and not _stored_within(self.file[name], rows, self._size):
            raise OSError("data beyond the end of the file")

    @classmethod
    @contextmanager
    def reading(cls, path: Path) -> Iterator[None]:
        """Turn exceptions of HDF5 while reading into messages."""
        try:
            yield
        except HDF5_ERRORS as error:
            raise cls.error(
                f"'{path}' is damaged or was cut short ({reason(error)}); {cls.remedy}"
            ) from error

    def close(self) -> None:
        """Close the file; nothing more can be read."""
        self.file.close()

    @classmethod
    def opened(cls, path: Path) -> tuple[h5py.File, bool]:
        """A file of any format, open for reading, and whether its writer closed it."""
        path = resolved(path, cls.error)
        if not path.is_file():
            what = "it is a folder" if path.is_dir() else "there is no such file"
            what = "it is no ordinary file" if path.exists() and not path.is_dir() else what
            raise cls.error(f"cannot read '{path}': {what}")
        with cls.reading(path):
            if not h5py.is_hdf5(path):
                raise cls.error(f"'{path}' is not an HDF5 file; {cls.origin}")
            if _is_unclosed(path):
                return h5py.File(_Unclosed(path), "r"), False
            return h5py.File(path, "r", locking="best-effort"), True

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a file has this format, in any version and state."""
        try:
            with cls.opened(path)[0] as file:
                return str(file.attrs.get("format")) == cls.format
        except (cls.error, *HDF5_ERRORS):
            return False

    @classmethod
    def writable_target(cls, path: str | os.PathLike) -> Path:
        """The resolved path of a new file, if it is free or holds a file of this format.

        Raises
        ------
        MultiarmError
            The folder is missing, or the path is a folder, a device or another kind of file.
        """
        target = resolved(path, cls.error)
        if not target.parent.is_dir():
            raise cls.error(
                f"cannot write '{path}': there is no folder '{target.parent}'; create it first"
            )
        if target.is_dir():
            raise cls.error(f"cannot write '{path}': it is a folder; name a file in it")
        if target.exists() and not (cls.matches(target) and os.access(target, os.W_OK)):
            raise cls.error(
                f"'{path}' exists and is not {cls.noun} that may be replaced: it is something "
                "else, damaged or write-protected; move it away or choose another name"
            )
        return target

    def _open(self) -> None:
        self.file, closed = self.opened(self.path)
        with self.reading(self.path):
            found = self.file.attrs.get("format")
            if not isinstance(found, str) or found != self.format:
                raise self.error(f"'{self.path}' is an HDF5 file, but not {self.noun} of multiarm")
            version = int(self.attribute("format_version", (int, np.integer)))
            if version < 1:
                raise self.broken(f"its format version is {version}")
            if version > self.version:
                raise self.error(
                    f"'{self.path}' has format version {version}; this program reads up to "
                    f"{self.version}: update multiarm"
                )
            self._groups: dict[str, Any] = {}
            self._size = None if closed else self.path.stat().st_size
            self.load()


class GrowingFile:
    """A new file that grows. Subclasses create its datasets in :meth:`create`.

    Parameters
    ----------
    path : Path
        See :meth:`StoredFile.writable_target`.
    first_bytes, spare_bytes : int
        Disk space to reserve at first, and always beyond the data: descriptions and index.

    Raises
    ------
    MultiarmError
        The folder cannot be written, or has no room.
    """

    reader: ClassVar[type[StoredFile]]

    def __init__(self, path: Path, first_bytes: int, spare_bytes: int):
        self.path, self._spare_bytes, self._fault = path, spare_bytes, ""
        # there is one writer at a time; with the same name the next one removes what a kill left
        partial = path.with_name(f".{path.name}.part")
        try:
            with atomic_file(path, partial):
                allocate(partial, first_bytes + spare_bytes)
                self.file = h5py.File(
                    partial,
                    "w",
                    libver=("v110", "v110"),  # the oldest with this mode: widest readability
                    locking="best-effort",
                    fs_strategy="page",
                    fs_page_size=4096,
                    rdcc_nbytes=1 << 18,  # a few chunks of a dataset, independent of its length
                )
                self.reserve(first_bytes)
                with self.writing("write"):
                    self.file.attrs["format"] = self.reader.format
                    self.file.attrs["format_version"] = self.reader.version
                    self.create()
                    self.file.swmr_mode = True
                    self.file.flush()
        except OSError as error:
            raise self.reader.error(
                f"cannot write to '{path.parent}': {reason(error)}; "
                "choose a folder that you may write to and that has room"
            ) from error

    def create(self) -> None:
        """Create all datasets."""
        raise NotImplementedError

    def create_growing(self, name: str, dtype: Any, chunk: int, description: str) -> h5py.Dataset:
        """An empty dataset that grows by rows, stored in chunks of ``chunk`` rows."""
        dataset = self.file.create_dataset(name, (0,), dtype, maxshape=(None,), chunks=(chunk,))
        dataset.attrs["description"] = description
        return dataset

    def create_counters(self, name: str, count: int, description: str) -> h5py.Dataset:
        """A dataset of whole numbers, which begin at zero."""
        dataset = self.file.create_dataset(name, data=np.zeros(count, dtype=np.int64))
        dataset.attrs["description"] = description
        return dataset

    def reserve(self, size: int) -> None:
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
    def writing(self, action: str) -> Iterator[None]:
        """Turn an error of HDF5 while writing into a message; it ends all writing."""
        if self._fault:
            raise self.reader.error(self._fault)
        try:
            yield
        except (OSError, RuntimeError) as error:
            fault = self._disk_error(action, error)
            self._fault = str(fault)
            _UNCLOSABLE.append(self)
            raise fault from error

    def close(self) -> None:
        """Close the file, and return unused disk space."""
        if self._fault or not self.file:
            return
        with suppress(OSError, RuntimeError):
            os.ftruncate(self.file.id.get_vfd_handle(), self.file.id.get_filesize())
            self.file.close()

    def _disk_error(self, action: str, error: Exception) -> MultiarmError:
        return self.reader.error(
            f"cannot {action} '{self.path}': {reason(error)}; "
            "free some space on the disk or choose another folder"
        )


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def allocate(path: Path, size: int) -> None:
    """Let a file grow by `size` bytes, to detect a full disk before HDF5 writes."""
    if hasattr(os, "posix_fallocate"):
        with open(path, "r+b") as file:
            os.posix_fallocate(file.fileno(), os.path.getsize(path), size)


def in_pieces(text: str) -> list[bytes]:
    """ASCII text in pieces, at least one; HDF5 would cut off a NUL at the end of one."""
    data = text.encode("ascii")
    return [data[i : i + PIECE_BYTES] for i in range(0, len(data), PIECE_BYTES)] or [b""]


def joined(pieces: Sequence[bytes]) -> str:
    """The text of :func:`in_pieces`."""
    return b"".join(pieces).decode("ascii")


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
