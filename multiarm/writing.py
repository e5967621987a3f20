"""Files that appear when they are complete."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from multiarm.errors import MultiarmError

DOTS = 150
"""Of a picture, per inch."""


class Picture(Protocol):
    """What can be written to a file, such as a figure of matplotlib."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write it."""


@contextmanager
def in_one_step(path: Path, option: str) -> Iterator[Path]:
    """Give a temporary file beside ``path`` to write to, which then takes its place.

    Raises
    ------
    MultiarmError
        It cannot be written; ``option`` is what named it.
    """
    target = path.expanduser()
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield partial
        partial.replace(target)
    except OSError as error:
        raise MultiarmError(f"{option}: cannot write '{path}': {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)


def save_figure(figure: Picture, path: Path) -> None:
    """Write a figure to the file that ``--plot`` names; its ending is the format.

    Raises
    ------
    MultiarmError
        It cannot be written.
    """
    with in_one_step(path, "--plot") as partial:
        figure.savefig(partial, format=path.suffix.lower().lstrip("."), dpi=DOTS)
