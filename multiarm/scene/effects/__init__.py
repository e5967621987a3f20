"""The effects that a scene may name: their parameters, and whether these fit the arms.

Each is a class that says all about itself; the fields of :class:`EffectsSpec` derive from these
classes.  What an effect does to the model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar

from multiarm.scene.effects import contacts, drives, loads
from multiarm.scene.effects.kind import EffectKind
from multiarm.scene.faults import Faults, Parts, below
from multiarm.scene.joint_values import KnownRobots
from multiarm.scene.registry import AnyClass, ByName, Registry

_OURS: tuple[type[EffectKind], ...] = (
    drives.JointDamping,
    drives.JointFriction,
    drives.RotorInertia,
    drives.TorqueLimits,
    drives.ActuatorLag,
    loads.Drag,
    loads.ExternalWrench,
    contacts.UnilateralContactsSpec,
    contacts.ContactFrictionSpec,
    contacts.JointLimitsSpec,
    contacts.FloorSpec,
    contacts.ContactComplianceSpec,
)
BUILT_IN = {effect.name: effect for effect in _OURS}
"""Our effects by name."""
EFFECTS: Registry[Any] = Registry("effect", "effect", "effects", BUILT_IN)
"""User effects; what the class must offer says :class:`multiarm.effects.effect.Effect`."""


def register_effect(effect: AnyClass) -> AnyClass:
    """Let scenes name a user effect, a subclass of :class:`multiarm.Effect`; also a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        The class cannot be used, or another effect has its name.
    """
    return EFFECTS.add(effect)


class _Effects(ByName):
    """Optional physics; an effect that is not named is not modelled and costs nothing.

    It has a field for each of :data:`BUILT_IN`; a name that is none of these is a user effect, see
    :mod:`multiarm.scene.registry`.
    """

    registry: ClassVar[Registry] = EFFECTS

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
        """Names of those that act on all contacts that only push, and on nothing else."""
        return self._names_of(lambda spec: spec.of_pushing and not getattr(spec, "contacts", None))

    def faults(self, arms: KnownRobots) -> Faults:
        """Faults with respect to the arms of the scene."""
        return [fault for at, spec in self._parts() for fault in below(at, spec.faults(arms))]

    def warnings(self, arms: KnownRobots) -> Faults:
        """Warnings about probable mistakes."""
        return [fault for at, spec in self._parts() for fault in below(at, spec.warnings(arms))]

    def _names_of(self, chosen: Callable[[EffectKind], bool]) -> tuple[str, ...]:
        names = (str(name) for (name, *_), spec in self._parts() if chosen(spec))
        return tuple(dict.fromkeys(names))

    def _parts(self) -> Iterator[tuple[Parts, EffectKind]]:
        """Place and parameters of each effect of ours, of each of a list."""
        for name, kind in BUILT_IN.items():
            spec = getattr(self, name)
            if issubclass(kind, drives.JointNumbers) and spec is not None:
                yield (name,), kind.model_construct(values=spec)
            elif isinstance(spec, tuple):
                yield from (((name, k), part) for k, part in enumerate(spec))
            elif spec is not None:
                yield (name,), spec


if TYPE_CHECKING:

    class EffectsSpec(_Effects):
        """Their parameters, by name; None where a scene does not name an effect."""

        def __getattr__(self, name: str) -> Any: ...

else:
    EffectsSpec = _Effects.with_keys(
        "EffectsSpec",
        {name: (effect.entry(), effect.meaning()) for name, effect in BUILT_IN.items()},
    )
