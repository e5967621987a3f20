"""The effects that a scene may name: their parameters, and whether these fit the arms.

Each is a class that says all about itself and a field of :class:`EffectsSpec`; what it does to the
model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, model_validator

from multiarm.scene.effects.contacts import (
    ContactComplianceSpec,
    ContactFrictionSpec,
    FloorSpec,
    JointLimitsSpec,
    UnilateralContactsSpec,
)
from multiarm.scene.effects.drives import (
    ActuatorLag,
    JointDamping,
    JointFriction,
    JointNumbers,
    NumbersOf,
    RotorInertia,
    TorqueLimits,
)
from multiarm.scene.effects.kind import EffectKind
from multiarm.scene.effects.loads import Drag, ExternalWrench
from multiarm.scene.faults import Parts, fault, models_in
from multiarm.scene.registry import AnyClass, Registry
from multiarm.scene.values import (
    Faults,
    Gain,
    KnownArm,
    Spec,
    UrdfGain,
    below,
    shorthand,
)

EFFECTS: Registry[Any] = Registry(
    noun="effect",
    plural="effects",
    group="multiarm.effects",
    base="multiarm.Effect",
    register="multiarm.register_effect",
    built_in=lambda: EffectsSpec.model_fields,
    parameters_of=attrgetter("Spec"),
)
"""User effects; what the class must offer says :class:`multiarm.effects.effect.Effect`."""


def register_effect(effect: AnyClass) -> AnyClass:
    """Let scenes name a user effect, a subclass of :class:`multiarm.Effect`; also a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        It lacks something, or another effect has its name.
    """
    return EFFECTS.add(effect)


def _or_only(key: str, kind: type[Spec]) -> BeforeValidator:
    """Let the value of one key, which may be a table itself, stand for the whole table."""

    def whole(value: Any) -> Any:
        if value is None or isinstance(value, kind):
            return value
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return value
        return {key: value}

    return BeforeValidator(whole)


def _some(wrenches: tuple[ExternalWrench, ...] | None) -> tuple[ExternalWrench, ...] | None:
    if wrenches == ():
        raise fault("is empty; list wrenches, such as (on: object, force: [0, 0, -1])")
    return wrenches


class EffectsSpec(Spec):
    """Optional physics; an effect that is not named is not modelled and costs nothing.

    A name that is none of the attributes below is a user effect, see
    :mod:`multiarm.scene.registry`.
    """

    joint_damping: Annotated[UrdfGain | None, NumbersOf(JointDamping)] = None
    """Viscous damping of the arms' joints [N m s/rad] or [N s/m]. ``urdf``: the robot's <dynamics
    damping>, also for single arms of a table."""
    joint_friction: Annotated[JointFriction | None, _or_only("torque", JointFriction)] = None
    """Dry friction of the arms' joints."""
    rotor_inertia: Annotated[Gain | None, NumbersOf(RotorInertia)] = None
    """Inertia of the drives as seen from the joint, that of the rotor times the gear ratio squared
    [kg m^2], of sliding joints [kg]."""
    torque_limits: Annotated[UrdfGain | None, NumbersOf(TorqueLimits)] = None
    """Largest torque of the drives [N m], of sliding joints force [N]: what the control commands
    beyond it is cut off. ``urdf``: the robot's <limit effort>. Joints that are not named, or have
    no limit in the URDF, are not limited."""
    actuator_lag: Annotated[ActuatorLag | None, _or_only("time_constant", ActuatorLag)] = None
    """Drives that follow the command with a delay."""
    drag: Drag | None = None
    """Resistance of the medium that the object moves through."""
    external_wrenches: Annotated[tuple[ExternalWrench, ...] | None, AfterValidator(_some)] = None
    """Forces and torques from outside, on the object or on links."""
    unilateral_contacts: UnilateralContactsSpec | None = None
    """Contacts that only push open, and close again with restitution."""
    contact_friction: Annotated[ContactFrictionSpec, shorthand("mu", int, float)] | None = None
    """Coulomb friction of contacts that only push."""
    joint_limits: Annotated[JointLimitsSpec, shorthand("range", str)] | None = None
    """Joints stop at the ends of their range."""
    floor: FloorSpec | None = None
    """A plane that the object can touch."""
    contact_compliance: (
        Annotated[ContactComplianceSpec, shorthand("stiffness", int, float)] | None
    ) = None
    """Contacts that give way."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(EFFECTS.read)]]

    @model_validator(mode="before")
    @classmethod
    def _set_user_effects_apart(cls, data: Any) -> Any:
        return EFFECTS.set_apart(data)

    @property
    def named(self) -> dict[str, Any]:
        """The effects that the scene names, with their parameters."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        values.update(self.model_extra or {})
        return {name: value for name, value in values.items() if value is not None}

    @property
    def with_events(self) -> tuple[str, ...]:
        """Names of those by which contacts and joints open, close, slide, stop or give way."""
        return self._names_of(lambda spec: spec.has_events)

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of those that have states besides positions and velocities."""
        named = self.named.items()
        return tuple(name for name, spec in named if getattr(spec, "has_states", False))

    @property
    def of_pushing(self) -> tuple[str, ...]:
        """Names of those that act on contacts that only push, and on nothing else."""
        return self._names_of(lambda spec: spec.of_pushing)

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms of the scene."""
        return [one for at, spec in self._parts() for one in below(at, spec.faults(arms))]

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Warnings about probable mistakes."""
        return [one for at, spec in self._parts() for one in below(at, spec.warnings(arms))]

    def _names_of(self, chosen: Callable[[EffectKind], bool]) -> tuple[str, ...]:
        names = (str(name) for (name, *_), spec in self._parts() if chosen(spec))
        return tuple(dict.fromkeys(names))

    def _parts(self) -> Iterator[tuple[Parts, EffectKind]]:
        """Place and parameters of each effect of ours, of each of a list."""
        for name, kind in BUILT_IN.items():
            spec = getattr(self, name)
            if issubclass(kind, JointNumbers) and spec is not None:
                yield (name,), kind.model_construct(values=spec)
            elif isinstance(spec, tuple):
                yield from (((name, k), one) for k, one in enumerate(spec))
            elif spec is not None:
                yield (name,), spec


def _kind(name: str) -> type[EffectKind]:
    field = EffectsSpec.model_fields[name]
    marked = [mark.kind for mark in field.metadata if isinstance(mark, NumbersOf)]
    return next(
        one for one in [*marked, *models_in(field.annotation)] if issubclass(one, EffectKind)
    )


BUILT_IN: dict[str, type[EffectKind]] = {name: _kind(name) for name in EffectsSpec.model_fields}
"""The classes of our effects by name."""
