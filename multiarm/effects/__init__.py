"""Optional effects: each file one effect; a scene runs only those that it names.

``multiarm/effects/<name>.py`` holds what ``effects: {<name>: ...}`` of a scene adds to the model:
its equation, its compiled kernel, and ``build(spec, context)``, which returns the kernels that the
evaluation calls (:mod:`multiarm.dynamics.effect_kernels`).  What a scene does not name is not
imported, has no array, and is not called.

The names below are what effects in other packages are built from.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.dynamics.arrays import open_system
    from multiarm.dynamics.effect_kernels import (
        ACTUATOR,
        APPLIED,
        PASSIVE,
        POWER,
        STATE,
        EffectKernel,
    )
    from multiarm.effects.context import BuildContext

_HOMES = {
    **dict.fromkeys(
        ("ACTUATOR", "APPLIED", "PASSIVE", "POWER", "STATE", "EffectKernel"),
        "dynamics.effect_kernels",
    ),
    "BuildContext": "effects.context",
    "open_system": "dynamics.arrays",
}

__all__ = [
    "ACTUATOR",
    "APPLIED",
    "PASSIVE",
    "POWER",
    "STATE",
    "BuildContext",
    "EffectKernel",
    "open_system",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm.effects' has no attribute {name!r}")
    return getattr(import_module(f"multiarm.{_HOMES[name]}"), name)
