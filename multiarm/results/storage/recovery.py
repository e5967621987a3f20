"""Open an HDF5 file whose writer was killed.

A writer in single-writer mode raises a flag in the file's first 48 bytes, the superblock, and
takes it down on closing. While it is up, HDF5 either refuses the file or waits, for ever, for
entries that are not whole to be completed. `Unclosed` shows the file with the flag down and its
true length filled in: what the tool `h5clear` does to a file, without touching it.

    superblock, version 3:   0 signature   8 version   11 flags   28 end of file   44 checksum

The checksum is lookup3 (B. Jenkins, 2006) of the bytes before it.
"""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path

SUPERBLOCK_BYTES = 48
_FLAGS, _END, _CHECKSUM = 11, 28, 44
_MASK = 0xFFFFFFFF


def is_unclosed(path: Path) -> bool:
    """Whether a file of format `v110` is being written, or its writer was killed."""
    with open(path, "rb") as file:
        head = file.read(SUPERBLOCK_BYTES)
    return len(head) == SUPERBLOCK_BYTES and head[8] == 3 and head[_FLAGS] != 0


class Unclosed(io.FileIO):
    """The bytes of a file for which `is_unclosed`, with a superblock as if it had been closed.

    Parameters
    ----------
    path : Path
        The HDF5 file.
    """

    def __init__(self, path: Path):
        super().__init__(path, "rb")
        head = super().read(SUPERBLOCK_BYTES)
        self._head = _closed(head, os.fstat(self.fileno()).st_size)
        self.seek(0)

    def __del__(self) -> None:
        self.close()  # HDF5 reads through this object, but does not close it

    def readinto(self, buffer) -> int:
        """Fill a buffer from the current position."""
        start = self.tell()
        size = super().readinto(buffer)
        fresh = self._head[start : start + size]
        memoryview(buffer).cast("B")[: len(fresh)] = fresh
        return size


def _closed(superblock: bytes, size: int) -> bytes:
    """The superblock without flags, with the file's size and a new checksum."""
    head = bytearray(superblock)
    head[_FLAGS] = 0
    struct.pack_into("<Q", head, _END, size)
    struct.pack_into("<I", head, _CHECKSUM, lookup3(bytes(head[:_CHECKSUM])))
    return bytes(head)


def lookup3(data: bytes) -> int:
    """Jenkins's hash `lookup3` of some bytes, as HDF5 uses it: 32 bits, initial value 0."""
    a = b = c = (0xDEADBEEF + len(data)) & _MASK
    blocks = max(1, -(-len(data) // 12))
    words = struct.unpack(f"<{3 * blocks}I", data.ljust(12 * blocks, b"\0"))
    for i in range(0, 3 * (blocks - 1), 3):
        a, b, c = _mix(a + words[i], b + words[i + 1], c + words[i + 2])
    return _final(a + words[-3], b + words[-2], c + words[-1])


def _mix(a: int, b: int, c: int) -> tuple[int, int, int]:
    for shift in (4, 6, 8, 16, 19, 4):
        a = ((a - c) & _MASK) ^ _rotated(c, shift)
        c += b
        a, b, c = b, c & _MASK, a
    return a, b, c


def _final(a: int, b: int, c: int) -> int:
    for shift in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _rotated(b, shift)) & _MASK
        a, b, c = b, c, a
    return b


def _rotated(word: int, shift: int) -> int:
    word &= _MASK
    return ((word << shift) | (word >> (32 - shift))) & _MASK
