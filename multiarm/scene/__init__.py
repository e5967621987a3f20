"""The scene file: its schema, loading and checks, and the robots that it may name.

The names of :mod:`multiarm.scene.names` are imported when one of them is first used, so that a
module of this package, such as :mod:`multiarm.scene.faults`, is read without what reads geometry.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.scene.names import *  # noqa: F403


def __getattr__(name: str) -> Any:
    names = vars(import_module("multiarm.scene.names"))
    if name.startswith("_") or name not in names:
        raise AttributeError(f"module 'multiarm.scene' has no attribute {name!r}")
    globals()[name] = names[name]
    return names[name]
