r"""Files that users name: written as a whole, by one writer at a time, with harmless text.

A file appears at its place when it is complete: it is written under a temporary name in the same
folder, then moved. Other users may write to that folder, so that no link at a temporary name is
ever followed.

Names, messages and paths come from scenes and results of any origin. Characters that would steer a
terminal, or hide text on a page, are escaped: ``\x1b``.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from multiarm.errors import MultiarmError

try:
    import fcntl
except ImportError:  # this system has no such locks: nothing is refused
    fcntl = None  # type: ignore[assignment]

# Control characters other than tab and newline, marks and overrides of the writing direction, line
# and paragraph separators, and surrogates, which no encoding can write.
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


@contextmanager
def atomic_file(target: Path, partial: Path | None = None) -> Iterator[Path]:
    """Give a temporary file to write to, which then takes the place of ``target``.

    Parameters
    ----------
    target : Path
    partial : Path, optional
        The temporary file, in the same folder; by default one of a random name.

    Raises
    ------
    OSError
        It cannot be written.
    """
    partial = create_empty(partial or temporary_name(target))
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def atomic_output(path: Path, option: str) -> Iterator[Path]:
    """An :func:`atomic_file` for the path that a command-line option named.

    Raises
    ------
    MultiarmError
        It cannot be written; the message names the ``option``.
    """
    try:
        with atomic_file(path.expanduser()) as partial:
            yield partial
    except OSError as error:
        raise MultiarmError(f"{option}: cannot write '{path}': {error.strerror}") from None


def temporary_name(target: Path) -> Path:
    """An unpredictable name in the folder of ``target``."""
    return target.with_name(f".{target.name}.{secrets.token_hex(8)}.part")


def create_empty(path: Path) -> Path:
    """Create an empty file in place of what is there; a link is replaced, not followed.

    Raises
    ------
    OSError
        It cannot be created.
    """
    path.unlink(missing_ok=True)
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return path


def save_page(page: str, path: Path, option: str = "--html") -> None:
    """Write an HTML page to the file that ``option`` names, with :func:`printable` text.

    Raises
    ------
    MultiarmError
        It cannot be written.
    """
    with atomic_output(path, option) as partial:
        partial.write_text(printable(page), encoding="utf-8")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib to the file that ``--plot`` names; its suffix is the format.

    Raises
    ------
    MultiarmError
        It cannot be written.
    """
    with atomic_output(path, "--plot") as partial:
        figure.savefig(partial, format=path.suffix.lower().lstrip("."), dpi=150)


def printable(text: str) -> str:
    r"""The text with characters that steer a terminal or a page escaped: ``\x1b``."""
    return _STEERING.sub(lambda found: ascii(found[0])[1:-1], text)


def printable_texts(value: Any) -> Any:
    """Tables and lists with all texts in them printable; names of entries stay."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: printable_texts(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [printable_texts(item) for item in value]
    return value


class WriterLock:
    """Exclusive right to write a file, until :meth:`release` or the end of the process.

    The lock is the operating system's (`flock`), on a small file next to the guarded one. The
    guarded file itself is replaced on resuming, and a lock would stay with the old one.

    Parameters
    ----------
    path : Path
        The guarded file.
    error : type
        Of the errors that are raised.

    Raises
    ------
    MultiarmError
        Another process, or another part of this one, holds the lock.
    """

    def __init__(self, path: Path, error: type[MultiarmError]):
        self._path = path.with_name(f".{path.name}.lock")
        self._descriptor: int | None = None
        while fcntl is not None and self._descriptor is None:
            descriptor = self._open(error)
            if not _locked(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise error(
                    f"'{path}' is being written by another process{holder}; wait for it, end it, "
                    "or choose another file"
                )
            if self._is_current(descriptor):
                self._descriptor = descriptor
                owner = {"process": os.getpid(), "host": platform.node()}
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps(owner).encode(), 0)
            else:  # its last owner has just removed it
                os.close(descriptor)

    def release(self) -> None:
        """Let others write."""
        if self._descriptor is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None

    def _open(self, error: type[MultiarmError]) -> int:
        linked = error(
            f"'{self._path}' is a link, which is not followed: remove it, or choose another folder"
        )
        try:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as fault:
            if fault.errno == errno.ELOOP:
                raise linked from None
            raise error(
                f"cannot write to '{self._path.parent}': {fault.strerror}; "
                "choose a folder that you may write to"
            ) from None
        if os.fstat(descriptor).st_nlink > 1:  # a hard link: writing would change another file
            os.close(descriptor)
            raise linked
        return descriptor

    def _is_current(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), os.stat(self._path))
        except FileNotFoundError:
            return False


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
        owner = json.loads(os.pread(descriptor, 500, 0))
        return f" ({owner['process']} on {owner['host']})"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
