"""One writer at a time: a lock that ends with its process, however that ends.

The lock is the operating system's (`flock`), on a small file beside: the file that it guards is
replaced on resuming, and a lock would stay with the old one.
"""

from __future__ import annotations

import errno
import json
import os
import platform
from pathlib import Path

from multiarm.errors import MultiarmError

try:
    import fcntl
except ImportError:  # no such locks here: nothing is refused
    fcntl = None  # type: ignore[assignment]

__all__ = ["WriterLock"]


class WriterLock:
    """Held from its making to :meth:`release`.

    Parameters
    ----------
    path : Path
        What is guarded.
    trouble : type
        Of the error.

    Raises
    ------
    MultiarmError
        Another process, or another part of this one, holds it.
    """

    def __init__(self, path: Path, trouble: type[MultiarmError]):
        self._path = path.with_name(f".{path.name}.lock")
        self._file: int | None = None
        while fcntl is not None and self._file is None:
            descriptor = self._open(trouble)
            if not _locked(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise trouble(
                    f"'{path}' is being written by another process{holder}; wait for it, end it, "
                    "or choose another file"
                )
            if self._is_at_its_place(descriptor):
                self._file = descriptor
            else:  # its last owner has just taken it away
                os.close(descriptor)
        self._sign()

    def release(self) -> None:
        """Let others write."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None

    def _open(self, trouble: type[MultiarmError]) -> int:
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise trouble(self._linked()) from None
            raise trouble(
                f"cannot write to '{self._path.parent}': {error.strerror}; "
                "choose a folder that you may write to"
            ) from None
        if os.fstat(descriptor).st_nlink > 1:  # what is written to it would be written elsewhere
            os.close(descriptor)
            raise trouble(self._linked())
        return descriptor

    def _linked(self) -> str:
        return (
            f"'{self._path}' is a link, which is not followed: remove it, or choose another folder"
        )

    def _is_at_its_place(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), os.stat(self._path))
        except FileNotFoundError:
            return False

    def _sign(self) -> None:
        if self._file is not None:
            os.ftruncate(self._file, 0)
            who = {"process": os.getpid(), "host": platform.node()}
            os.pwrite(self._file, json.dumps(who).encode(), 0)


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # a file system without locks
    return True


def _holder(descriptor: int) -> str:
    try:
        who = json.loads(os.pread(descriptor, 500, 0))
        return f" ({who['process']} on {who['host']})"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
