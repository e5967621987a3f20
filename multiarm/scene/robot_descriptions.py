"""Robots of the package ``robot_descriptions``, where that is installed.

Each is a module, such as ``iiwa14_description``, that says where its URDF is.  Its import clones
the repository of the robot where the cache has none.  Nothing is downloaded unasked: a module is
imported only if its repository is in the cache, and git may fetch nothing meanwhile.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from multiarm.errors import USER_FAULTS

PACKAGE = "robot_descriptions"
SUFFIX = "_description"


def names() -> tuple[str, ...]:
    """The robots with a URDF, whether they are on this machine or not; none without the package."""
    return tuple(sorted(_sources()))


def local_urdf(name: str) -> Path | None:
    """The URDF of a robot; None if it would have to be downloaded first."""
    cloned = re.search(r"clone_to_cache\(\s*[\"'](.+?)[\"']", _sources()[name])
    try:
        known = importlib.import_module(f"{PACKAGE}._repositories").REPOSITORIES
        folder = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
        if cloned and not (Path(folder).expanduser() / known[cloned[1]].cache_path).is_dir():
            return None
        with _nothing_fetched():
            path = Path(importlib.import_module(f"{PACKAGE}.{name}").URDF_PATH)
    except USER_FAULTS:  # something that it needs is not there; to pull it tells what
        return None
    return path if path.is_file() else None


def remedy(name: str) -> str:
    """What a message says about a robot that is not on this machine."""
    return f"is not on this machine; fetch it: python -m {PACKAGE} pull {name}"


@contextmanager
def _nothing_fetched() -> Iterator[None]:
    """Forbid git to use any transport."""
    before = os.environ.get("GIT_ALLOW_PROTOCOL")
    os.environ["GIT_ALLOW_PROTOCOL"] = "none"
    try:
        yield
    finally:
        if before is None:
            del os.environ["GIT_ALLOW_PROTOCOL"]
        else:
            os.environ["GIT_ALLOW_PROTOCOL"] = before


@lru_cache(maxsize=1)
def _sources() -> dict[str, str]:
    """The texts of all modules that name a URDF, by name."""
    spec = importlib.util.find_spec(PACKAGE)
    folders = [] if spec is None else spec.submodule_search_locations or []
    texts = {
        path.stem: path.read_text(encoding="utf-8")
        for folder in folders
        for path in Path(folder).glob(f"*{SUFFIX}.py")
    }
    return {name: text for name, text in texts.items() if re.search(r"(?m)^URDF_PATH\b", text)}
