"""Files that appear when they are complete."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from multiarm.errors import MultiarmError
from multiarm.results.printable import printable

DOTS = 150
"""Of a picture, per inch."""


class Picture(Protocol):
    """What can be written to a file, such as a figure of matplotlib."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write it."""


def name_beside(target: Path) -> Path:
    """A name in the same folder, which others may write to too: nobody can foresee it."""
    return target.with_name(f".{target.name}.{secrets.token_hex(8)}.part")


def made_anew(path: Path) -> Path:
    """Make an empty file; what is at its place is removed, and a link there not followed.

    Raises
    ------
    OSError
        It cannot be made.
    """
    path.unlink(missing_ok=True)
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    return path


@contextmanager
def complete(target: Path, beside: Path | None = None) -> Iterator[Path]:
    """Give a temporary file to write to, which then takes the place of ``target``.

    Parameters
    ----------
    target : Path
    beside : Path, optional
        The temporary file, in the same folder; by default one of a new name.

    Raises
    ------
    OSError
        It cannot be written.
    """
    partial = made_anew(beside or name_beside(target))
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def in_one_step(path: Path, option: str) -> Iterator[Path]:
    """Give a temporary file beside ``path`` to write to, which then takes its place.

    Raises
    ------
    MultiarmError
        It cannot be written; ``option`` is what named it.
    """
    try:
        with complete(path.expanduser()) as partial:
            yield partial
    except OSError as error:
        raise MultiarmError(f"{option}: cannot write '{path}': {error.strerror}") from None


def save_page(page: str, path: Path, option: str = "--html") -> None:
    """Write an HTML page to the file that ``option`` names; all that it shows becomes printable.

    Raises
    ------
    MultiarmError
        It cannot be written.
    """
    with in_one_step(path, option) as partial:
        partial.write_text(printable(page), encoding="utf-8")


def save_figure(figure: Picture, path: Path) -> None:
    """Write a figure to the file that ``--plot`` names; its ending is the format.

    Raises
    ------
    MultiarmError
        It cannot be written.
    """
    with in_one_step(path, "--plot") as partial:
        figure.savefig(partial, format=path.suffix.lower().lstrip("."), dpi=DOTS)
