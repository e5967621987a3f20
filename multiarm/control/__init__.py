"""Control laws.

Packages with kinds of control of their own build compiled laws from the names below.  They are
imported at their first use, so that defining a control does not load the compiler.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    **dict.fromkeys(("ControlContext", "ControlProgram"), "control.program"),
    **dict.fromkeys(("ControlLaw", "view_of_law"), "dynamics.control_laws"),
    **dict.fromkeys(
        ("open_data", "open_system", "OPEN_LOOP", "LOCAL", "CARRYING", "COUPLED"), "dynamics.arrays"
    ),
    "force_columns": "dynamics.coordinates",
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm.control' has no attribute {name!r}")
    return getattr(import_module(f"multiarm.{_HOMES[name]}"), name)
