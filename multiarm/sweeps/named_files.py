"""Files that a scene or a sweep names: with another text in them, runs give other numbers.

Robots by name belong to installed packages, whose versions are in the provenance of the file; what
is named by a path of its own is known by a digest of its text.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from multiarm.scene import Scene

__all__ = ["digests"]

# A function of the user's: the file before the colon.
_FUNCTION = re.compile(r"(.+\.py):\w+")
# Texts that stand for a file when there is one of this name.
_ENDINGS = (".urdf", ".stl", ".obj", ".dae", ".csv", ".py", ".yaml", ".yml")


def digests(scene: Scene, values: Iterable[Any]) -> dict[str, str]:
    """Path -> digest of every file that the scene names, or the values that take places in it.

    Parameters
    ----------
    scene : Scene
        Relative paths start at its folder.
    values : iterable
        Of the axes: whatever may stand in a scene.
    """
    found: dict[str, str] = {}
    for text in [*_texts(scene.model_dump(mode="json")), *_texts(list(values))]:
        function = _FUNCTION.fullmatch(text)
        name = function[1] if function else text
        if not name.lower().endswith(_ENDINGS):
            continue
        path = (scene.folder / Path(name).expanduser()).resolve()
        if str(path) not in found and path.is_file():
            found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return dict(sorted(found.items()))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _texts(item)
