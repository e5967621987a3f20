"""The effects that a scene may name: their parameters.

What each one does to the model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

from typing import Annotated, Any

from multiarm.scene.base import Spec
from multiarm.scene.contact_effects import (
    ContactFrictionSpec,
    FloorSpec,
    JointLimitsSpec,
    UnilateralContactsSpec,
    from_word,
)
from multiarm.scene.values import Gain

__all__ = ["EffectsSpec"]


class EffectsSpec(Spec):
    """Optional physics; what is not named is not modelled and costs nothing.

    Attributes
    ----------
    joint_damping : number or table 'arm: values', optional
        Viscous damping of the arms' joints [N m s/rad] or [N s/m].
    unilateral_contacts : UnilateralContactsSpec, optional
        Contacts that only push let go, and close again with restitution.
    contact_friction : ContactFrictionSpec or its mu, optional
        Coulomb friction of contacts that only push.
    joint_limits : JointLimitsSpec or 'urdf', optional
        Joints stop at the ends of their range.
    floor : FloorSpec, optional
        A plane that the object can touch.
    """

    joint_damping: Gain | None = None
    unilateral_contacts: UnilateralContactsSpec | None = None
    contact_friction: Annotated[ContactFrictionSpec, from_word("mu", (int, float))] | None = None
    joint_limits: Annotated[JointLimitsSpec, from_word("range", str)] | None = None
    floor: FloorSpec | None = None

    @property
    def named(self) -> dict[str, Any]:
        """The effects that the scene names, with their parameters."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: value for name, value in values.items() if value is not None}
