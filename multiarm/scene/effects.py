"""The effects that a scene may name: their parameters.

What each one does to the model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

from typing import Any

from multiarm.scene.base import Spec
from multiarm.scene.values import Gain

__all__ = ["EffectsSpec"]


class EffectsSpec(Spec):
    """Optional physics; what is not named is not modelled and costs nothing.

    Attributes
    ----------
    joint_damping : number or table 'arm: values', optional
        Viscous damping of the arms' joints [N m s/rad] or [N s/m].
    """

    joint_damping: Gain | None = None

    @property
    def named(self) -> dict[str, Any]:
        """The effects that the scene names, with their parameters."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: value for name, value in values.items() if value is not None}
