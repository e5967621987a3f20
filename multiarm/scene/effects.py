"""The effects that a scene may name: their parameters.

What each one does to the model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.contact_effects import (
    ContactComplianceSpec,
    ContactFrictionSpec,
    FloorSpec,
    JointLimitsSpec,
    UnilateralContactsSpec,
    from_word,
)
from multiarm.scene.joint_effects import (
    AnyActuatorLag,
    AnyJointFriction,
    damping_of,
    has_effort_limit,
)
from multiarm.scene.loads import Drag, ExternalWrench
from multiarm.scene.own_effects import Named, OwnEffect
from multiarm.scene.per_joint import (
    Faults,
    KnownArm,
    UrdfGain,
    gain_faults,
    urdf_faults,
    urdf_warnings,
)
from multiarm.scene.values import Gain, Parts, fault

__all__ = ["COME_AND_GO", "EffectsSpec"]


COME_AND_GO = (
    "unilateral_contacts",
    "contact_friction",
    "joint_limits",
    "floor",
    "contact_compliance",
)
"""Effects by which contacts and joints come and go, or give way."""


def _some(wrenches: tuple[ExternalWrench, ...] | None) -> tuple[ExternalWrench, ...] | None:
    if wrenches == ():
        raise fault("is empty; list wrenches, such as (on: object, force: [0, 0, -1])")
    return wrenches


class EffectsSpec(Spec):
    """Optional physics; what is not named is not modelled and costs nothing.

    A name that is none of the attributes below is an effect of one's own, see
    :mod:`multiarm.scene.own_effects`.

    Attributes
    ----------
    joint_damping : number, table 'arm: values' or 'urdf', optional
        Viscous damping of the arms' joints [N m s/rad] or [N s/m]. ``urdf``: the robot's
        <dynamics damping>, also for single arms of a table.
    joint_friction : JointFriction, or its torque, optional
        Dry friction of the arms' joints.
    rotor_inertia : number or table 'arm: values', optional
        Inertia of the drives as seen from the joint, that of the rotor times the gear ratio
        squared [kg m^2], of sliding joints [kg].
    torque_limits : number, table 'arm: values' or 'urdf', optional
        Largest torque of the drives [N m], of sliding joints force [N]: what the control commands
        beyond it is cut off. ``urdf``: the robot's <limit effort>. Joints that are not named, or
        have no limit in the URDF, are not limited.
    actuator_lag : ActuatorLag, or its time_constant, optional
        Drives that follow the command with a delay.
    drag : Drag, optional
        Resistance of the medium that the object moves through.
    external_wrenches : list of ExternalWrench, optional
        Forces and torques from outside, on the object or on links.
    unilateral_contacts : UnilateralContactsSpec, optional
        Contacts that only push let go, and close again with restitution.
    contact_friction : ContactFrictionSpec or its mu, optional
        Coulomb friction of contacts that only push.
    joint_limits : JointLimitsSpec or 'urdf', optional
        Joints stop at the ends of their range.
    floor : FloorSpec, optional
        A plane that the object can touch.
    contact_compliance : ContactComplianceSpec or its stiffness, optional
        Contacts that give way.
    """

    joint_damping: UrdfGain | None = None
    joint_friction: AnyJointFriction = None
    rotor_inertia: Gain | None = None
    torque_limits: UrdfGain | None = None
    actuator_lag: AnyActuatorLag = None
    drag: Drag | None = None
    external_wrenches: Annotated[tuple[ExternalWrench, ...] | None, AfterValidator(_some)] = None
    unilateral_contacts: UnilateralContactsSpec | None = None
    contact_friction: Annotated[ContactFrictionSpec, from_word("mu", (int, float))] | None = None
    joint_limits: Annotated[JointLimitsSpec, from_word("range", str)] | None = None
    floor: FloorSpec | None = None
    contact_compliance: (
        Annotated[ContactComplianceSpec, from_word("stiffness", (int, float))] | None
    ) = None

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, OwnEffect]

    @property
    def named(self) -> dict[str, Any]:
        """The effects that the scene names, with their parameters."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        values.update(self.model_extra or {})
        return {name: value for name, value in values.items() if value is not None}

    @property
    def with_events(self) -> tuple[str, ...]:
        """Names of those by which contacts and joints come and go, or give way."""
        dry = self.joint_friction is not None and self.joint_friction.model == "set_valued"
        return tuple(
            name for name in self.named if name in COME_AND_GO or (name == "joint_friction" and dry)
        )

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of those that have states of their own beside positions and velocities."""
        named = self.named.items()
        return tuple(name for name, spec in named if getattr(spec, "has_states", False))

    def located(self, folder: Path) -> Self:
        """Return these effects with file paths made absolute, relative ones below ``folder``."""
        if self.external_wrenches is None:
            return self
        wrenches = tuple(wrench.located(folder) for wrench in self.external_wrenches)
        return self.model_copy(update={"external_wrenches": wrenches})

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What does not fit the arms of the scene."""
        found = gain_faults(self.joint_damping, arms)
        found += urdf_faults(self.joint_damping, arms, damping_of, "<dynamics damping>")
        faults = _below("joint_damping", found)
        faults += _below("rotor_inertia", gain_faults(self.rotor_inertia, arms))
        faults += _below("torque_limits", gain_faults(self.torque_limits, arms))
        for place, spec in self._parts():
            faults += _below(place, spec.faults(arms) if hasattr(spec, "faults") else [])
        return faults

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What is probably not meant."""
        found = urdf_warnings(self.joint_damping, arms, damping_of, "<dynamics damping>")
        warnings = _below("joint_damping", found)
        found = urdf_warnings(self.torque_limits, arms, has_effort_limit, "<limit effort>")
        warnings += _below("torque_limits", found)
        for place, spec in self._parts():
            warnings += _below(place, spec.warnings(arms) if hasattr(spec, "warnings") else [])
        return warnings

    @model_validator(mode="before")
    @classmethod
    def _set_own_effects_apart(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        ours = cls.model_fields
        return {
            name: value if name in ours or not isinstance(name, str) else Named(name, value, ours)
            for name, value in data.items()
        }

    def _parts(self) -> Iterator[tuple[Parts, Any]]:
        """Place and parameters of each effect, of each of a list."""
        for name, spec in self.named.items():
            if isinstance(spec, tuple):
                yield from (((name, k), one) for k, one in enumerate(spec))
            else:
                yield (name,), spec


def _below(place: str | Parts, found: Faults) -> Faults:
    first = (place,) if isinstance(place, str) else place
    return [((*first, *where), text) for where, text in found]
