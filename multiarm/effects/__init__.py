"""Optional effects: each file one effect; a scene runs only those that it names.

``multiarm/effects/<name>.py`` holds what ``effects: {<name>: ...}`` of a scene adds to the model:
its equation, its compiled kernel, and ``build(spec, context)``, which returns the kernels that an
evaluation calls (:mod:`multiarm.dynamics.effect_kernels`).  An effect that a scene does not name is
not imported, has no array, and is not called.

Packages with effects of their own build them from the names below.
"""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import (
    ACTUATOR,
    APPLIED,
    PASSIVE,
    POWER,
    STATE,
    EffectKernel,
)
from multiarm.effects.building import BuildContext

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
