"""Optional effects: each file one effect; a scene runs only those that it names.

``multiarm/effects/<name>.py`` holds what ``effects: {<name>: ...}`` of a scene adds to the model:
its equation, its compiled kernel, and ``build(spec, context)``, which returns the kernels that an
evaluation calls (:mod:`multiarm.dynamics.effect_kernels`).  An effect that a scene does not name is
not imported, has no array, and is not called.

Packages with user-defined effects build them from the names below.  They are imported at their
first use, so that defining an effect does not load the compiler.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    **dict.fromkeys(
        (
            "ACTUATOR",
            "APPLIED",
            "PASSIVE",
            "POWER",
            "STATE",
            "EffectKernel",
            "first_state",
            "keep_forces",
            "set_power",
            "view_of_effect",
        ),
        "dynamics.effect_kernels",
    ),
    "BuildContext": "effects.building",
    **dict.fromkeys(("chart_places", "force_columns"), "dynamics.coordinates"),
    **dict.fromkeys(("open_data", "open_system"), "dynamics.arrays"),
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm.effects' has no attribute {name!r}")
    return getattr(import_module(f"multiarm.{_HOMES[name]}"), name)
