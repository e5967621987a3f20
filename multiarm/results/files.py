r"""Output files: atomic writing, and printable text.

A file appears when it is complete: it is written under a temporary name in the same folder, then
moved. Other users may write to that folder, so that no link at a temporary name is ever followed.

Names, messages and paths come from scenes and results of any origin. Characters that would control
a terminal, or hide text on a page, are escaped: ``\x1b``.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from multiarm.errors import MultiarmError

# Control characters other than tab and newline, marks and overrides of the writing direction, line
# and paragraph separators, and surrogates, which no encoding can write.
_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def resolved(path: Any, error: type[MultiarmError] = MultiarmError) -> Path:
    """The absolute path of a file that may be there or not, ``~`` being the home folder.

    Raises
    ------
    MultiarmError
        No file can have this path, a link in it leads to itself, or it is no path at all.
    """
    from multiarm.scene.faults import path_fault, shown

    if not isinstance(path, (str, os.PathLike)):
        raise error(f"the path of a file is needed, got {shown(path)}")
    fault = path_fault(os.fspath(path))
    if fault:
        raise error(fault)
    try:
        return Path(path).expanduser().resolve()
    except (OSError, RuntimeError):
        raise error(f"'{path}' cannot be used: a link in it leads to itself") from None


@contextmanager
def atomic_file(target: Path, partial: Path | None = None) -> Iterator[Path]:
    """A temporary file to write to, which then replaces ``target``.

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


def target_fault(target: Path) -> str:
    """Why a file cannot be written, with the remedy; empty where it can."""
    if not target.parent.is_dir():
        return f"there is no folder '{target.parent}'; create it first"
    if target.is_dir():
        return "it is a folder; name a file in it"
    if target.exists() and not target.is_file():
        return "it is not an ordinary file; name one"
    if target.exists() and not os.access(target, os.W_OK):
        return "the file is write-protected; choose another name"
    try:
        create_empty(temporary_name(target)).unlink()
    except OSError as error:
        return f"{error.strerror or error}; choose a folder that you may write to"
    return ""


@contextmanager
def atomic_output(
    path: str | os.PathLike, option: str = "", error: type[MultiarmError] = MultiarmError
) -> Iterator[Path]:
    """An :func:`atomic_file` for a path that a user named, on the command line by an ``option``.

    Raises
    ------
    MultiarmError
        Of the type ``error``: it cannot be written; the message names path and option.
    """
    try:
        with atomic_file(Path(path).expanduser()) as partial:
            yield partial
    except OSError as problem:
        where = f"{option}: " if option else ""
        raise error(
            f"{where}cannot write '{path}': {problem.strerror or problem}; name a file in a folder "
            "that exists and that you may write to"
        ) from problem


def temporary_name(target: Path) -> Path:
    """An unpredictable name in the folder of ``target``."""
    return target.with_name(f".{target.name}.{secrets.token_hex(8)}.part")


def create_empty(path: Path) -> Path:
    """Create an empty file; an existing file or link is replaced, not followed.

    Raises
    ------
    OSError
        It cannot be created.
    """
    path.unlink(missing_ok=True)
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return path


def write_text(
    path: str | os.PathLike, text: str, option: str = "", error: type[MultiarmError] = MultiarmError
) -> None:
    """Write a text file or a page, complete or not at all; raises as :func:`atomic_output`."""
    with atomic_output(path, option, error) as partial:
        partial.write_text(text, encoding="utf-8")


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
    r"""The text with characters that control a terminal or a page escaped: ``\x1b``."""
    return _CONTROL.sub(lambda match: ascii(match[0])[1:-1], text)


def printable_texts(value: Any) -> Any:
    """Tables and lists with all texts printable; keys stay."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: printable_texts(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [printable_texts(item) for item in value]
    return value
