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
from functools import lru_cache
from pathlib import Path

from multiarm.errors import USER_FAULTS

PACKAGE, SUFFIX = "robot_descriptions", "_description"
_TRANSPORTS = "GIT_ALLOW_PROTOCOL"  # those that git may use


def described_robots() -> tuple[str, ...]:
    """The robots with a URDF, whether they are on this machine or not; none without the package."""
    return tuple(sorted(_sources()))


def local_urdf(name: str) -> Path | None:
    """The URDF of a robot; None if it has to be downloaded first."""
    cloned = re.search(r"clone_to_cache\(\s*[\"'](.+?)[\"']", _sources()[name])
    before = os.environ.get(_TRANSPORTS)
    try:
        known = importlib.import_module(f"{PACKAGE}._repositories").REPOSITORIES
        cache = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions"))
        if cloned is None or not (cache.expanduser() / known[cloned[1]].cache_path).is_dir():
            return None
        os.environ[_TRANSPORTS] = "none"
        path = Path(importlib.import_module(f"{PACKAGE}.{name}").URDF_PATH)
    except USER_FAULTS:  # something that it needs is not there; to pull it tells what
        return None
    finally:
        os.environ.pop(_TRANSPORTS, None)
        os.environ.update({} if before is None else {_TRANSPORTS: before})
    return path if path.is_file() else None


@lru_cache(maxsize=1)
def _sources() -> dict[str, str]:
    """The texts of all modules that name a URDF, by name."""
    spec = importlib.util.find_spec(PACKAGE)
    folders = [] if spec is None else spec.submodule_search_locations or []
    files = [file for folder in folders for file in Path(folder).glob(f"*{SUFFIX}.py")]
    texts = {file.stem: file.read_text(encoding="utf-8") for file in files}
    return {name: text for name, text in texts.items() if re.search(r"(?m)^URDF_PATH\b", text)}
