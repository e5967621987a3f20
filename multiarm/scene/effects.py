"""The effects that a scene may name: their parameters, and whether these fit the arms.

What each one does to the model stands in ``multiarm/effects/<name>.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator
from typing_extensions import Self

from multiarm.scene.faults import Parts, fault, unknown
from multiarm.scene.loads import Drag, ExternalWrench
from multiarm.scene.registry import AnyClass, Registry
from multiarm.scene.robots import JointOutline
from multiarm.scene.values import (
    Faults,
    Gain,
    KnownArm,
    NonNegative,
    Pose,
    Positive,
    Spec,
    UrdfGain,
    Vec3,
    below,
    gain_faults,
    shorthand,
    urdf_warnings,
)

WITH_EVENTS = (
    "unilateral_contacts",
    "contact_friction",
    "joint_limits",
    "floor",
    "contact_compliance",
)
"""Effects by which contacts and joints open, close, slide or stop, or are compliant."""
_FRICTION_SPEED = 0.01
"""Speed at which smooth friction is 76 % of the full one [rad/s] or [m/s]."""

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

damping_of: Callable[[JointOutline], float] = attrgetter("damping")
"""Viscous friction that the robot's file gives a joint."""
friction_of: Callable[[JointOutline], float] = attrgetter("friction")
"""Dry friction that the robot's file gives a joint."""


def effort_limit_of(joint: JointOutline) -> float:
    """Largest torque that the robot's file allows a joint; infinite where it has none, or 0."""
    return joint.effort_limit if joint.effort_limit > 0.0 else math.inf


def _has_effort_limit(joint: JointOutline) -> bool:
    return math.isfinite(effort_limit_of(joint))


def register_effect(effect: AnyClass) -> AnyClass:
    """Let scenes name a user effect, a subclass of :class:`multiarm.Effect`; also a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        It lacks something, or another effect has its name.
    """
    return EFFECTS.add(effect)


# --- joints and their drives ---------------------------------------------------------------------


class JointFriction(Spec):
    """Dry (Coulomb) friction of the arms' joints.

    May be written as ``torque`` alone.

    Attributes
    ----------
    torque : number, table 'arm: values' or 'urdf'
        Friction torque [N m], of sliding joints force [N]; joints that are not named have none.
        ``urdf``: the robot's <dynamics friction>.
    model : 'smooth' or 'set_valued'
        ``smooth``: -torque tanh(velocity / speed), which creeps under load; ``set_valued``: a joint
        sticks until the load exceeds the friction torque.
    speed : float, optional
        Of the smooth model [rad/s] or [m/s]; 0.01 when left out.
    """

    torque: UrdfGain = Field(description="N m: a number, a table by arm, or 'urdf'")
    model: Literal["smooth", "set_valued"] = "smooth"
    speed: Positive | None = None

    @model_validator(mode="after")
    def _speed_belongs_to_the_smooth_model(self) -> Self:
        if self.model == "set_valued" and self.speed is not None:
            raise fault("'speed' belongs to model 'smooth'; remove it, or change 'model'")
        return self

    @property
    def smoothing_speed(self) -> float:
        """Speed of the smooth model, [rad/s] or [m/s]."""
        return _FRICTION_SPEED if self.speed is None else self.speed

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms."""
        found = gain_faults(self.torque, arms, friction_of, "<dynamics friction>")
        return below(("torque",), found)

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Warnings about probable mistakes."""
        found = urdf_warnings(self.torque, arms, friction_of, "<dynamics friction>")
        return below(("torque",), found)


class ActuatorLag(Spec):
    """Drives whose torque follows the command with a delay: T torque' = command - torque.

    May be written as ``time_constant`` alone.  Acts on the command after ``torque_limits``.

    Attributes
    ----------
    time_constant : number or table 'arm: values'
        T [s]; joints that are not named, or have 0, follow at once.
    start : 'command' or 'zero'
        The torque at the start of a run: the command, or zero.
    """

    has_states: ClassVar[bool] = True

    time_constant: Gain = Field(description="in s: a number, a list or a table by arm")
    start: Literal["command", "zero"] = "command"

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms."""
        return below(("time_constant",), gain_faults(self.time_constant, arms))


def _or_only(key: str, kind: type[Spec]) -> BeforeValidator:
    """Let the value of one key, which may be a table itself, stand for the whole table."""

    def whole(value: Any) -> Any:
        if value is None or isinstance(value, kind):
            return value
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return value
        return {key: value}

    return BeforeValidator(whole)


# --- contacts and joint stops --------------------------------------------------------------------

Restitution = Annotated[float, Field(ge=0.0, le=1.0)]


class SomeContacts(Spec):
    """An effect of some of the contacts of a scene.

    Attributes
    ----------
    contacts : list of str, optional
        Arms, or contacts as 'arm/contact'; absent: all that the effect can be of.
    """

    contacts: tuple[str, ...] | None = None

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms; contacts are checked once they are known."""
        owners = [name.partition("/")[0] for name in self.contacts or ()]
        found: Faults = [
            (("contacts", k), unknown("arm", owner, arms))
            for k, owner in enumerate(owners)
            if owner not in arms
        ]
        if self.contacts == ():
            found.append((("contacts",), "is empty; name arms or contacts, or leave it out"))
        return found


class UnilateralContactsSpec(SomeContacts):
    """Contacts that can only push open when they would pull, and may close again.

    Attributes
    ----------
    restitution : float
        Newton's coefficient, 0 (no bounce) to 1.
    contacts : list of str, optional
        Arms, or contacts as 'arm/contact'; absent: every contact that only pushes.
    start : 'closed' or 'as_written'
        Whether the start is assembled with these contacts closed, as that of a scene without this
        effect, or left as it is written, where they may be apart.
    """

    restitution: Restitution = 0.0
    start: Literal["closed", "as_written"] = "closed"


class ContactFrictionSpec(SomeContacts):
    """Coulomb friction at contacts that can only push; these may then open as well.

    Attributes
    ----------
    mu : float
        Coefficient of friction.
    contacts : list of str, optional
        Arms, or contacts as 'arm/contact'; absent: every contact that only pushes.
    """

    mu: NonNegative = Field(description="the coefficient of friction")


class ContactComplianceSpec(SomeContacts):
    """Contacts that give way like a spring and a damper, and are no constraints.

    Those that can only push do so only while they are pressed in.

    Attributes
    ----------
    stiffness : float
        [N/m]
    damping : float
        [N s/m]
    contacts : list of str, optional
        Arms, or contacts as 'arm/contact'; absent: all contacts of all joints.
    """

    stiffness: Positive = Field(description="in N/m")
    damping: NonNegative = 0.0


class FloorSpec(Spec):
    """A plane that the object can touch: a sphere anywhere, other shapes with their corners.

    A mesh touches with the corners of its convex hull.

    Attributes
    ----------
    at : Pose
        Its frame: the z axis points out of the floor.
    size : 2 numbers, optional
        A table top of so much along x and y of that frame [m]; absent: unbounded. Corners of the
        object leave it over its edges, which themselves touch nothing.
    restitution : float
        Newton's coefficient, 0 to 1.
    mu : float, optional
        Coefficient of friction; absent: without friction.
    points : list of 3 numbers, optional
        Points of the object that can touch it, object frame [m]; absent: the corners of its shape.
    """

    at: Pose = Pose()
    size: tuple[Positive, Positive] | None = None
    restitution: Restitution = 0.0
    mu: NonNegative | None = None
    points: tuple[Vec3, ...] | None = None

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms."""
        if self.points == ():
            return [(("points",), "is empty; list points of the object, or leave it out")]
        if "floor" in arms:
            return [((), "an arm is called 'floor' as well; give it another name")]
        return []


class JointLimitsSpec(Spec):
    """Joints stop at the ends of their range.

    Attributes
    ----------
    range : 'urdf' or table 'arm: joint: [lower, upper]'
        Ends [rad, m]; of the URDF, or as given.
    restitution : float
        Newton's coefficient, 0 to 1.
    """

    range: Literal["urdf"] | dict[str, dict[str, tuple[float, float]]] = "urdf"
    restitution: Restitution = 0.0

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms."""
        found: Faults = []
        for arm, joints in {} if self.range == "urdf" else self.range.items():
            if arm not in arms:
                found.append((("range", arm), unknown("arm", arm, arms)))
                continue
            known = arms[arm].joint_names
            for joint, (lower, upper) in joints.items():
                place = ("range", arm, joint)
                if known is not None and joint not in known:
                    found.append((place, unknown("joint", joint, known)))
                if not lower < upper:
                    found.append((place, f"the lower end {lower:g} is not below {upper:g}"))
        return found

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Warnings about probable mistakes."""
        if self.range != "urdf":
            return []
        text = "the URDF of arm {!r} gives no joint a range; write a table 'joint: [lower, upper]'"
        return [
            (("range",), text.format(arm))
            for arm, known in arms.items()
            if known.joints is not None
            and not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in known.joints)
        ]


# --- all effects of a scene ----------------------------------------------------------------------


def _some(wrenches: tuple[ExternalWrench, ...] | None) -> tuple[ExternalWrench, ...] | None:
    if wrenches == ():
        raise fault("is empty; list wrenches, such as (on: object, force: [0, 0, -1])")
    return wrenches


class EffectsSpec(Spec):
    """Optional physics; an effect that is not named is not modelled and costs nothing.

    A name that is none of the attributes below is a user effect, see
    :mod:`multiarm.scene.registry`.

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
        Contacts that only push open, and close again with restitution.
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
    joint_friction: Annotated[JointFriction | None, _or_only("torque", JointFriction)] = None
    rotor_inertia: Gain | None = None
    torque_limits: UrdfGain | None = None
    actuator_lag: Annotated[ActuatorLag | None, _or_only("time_constant", ActuatorLag)] = None
    drag: Drag | None = None
    external_wrenches: Annotated[tuple[ExternalWrench, ...] | None, AfterValidator(_some)] = None
    unilateral_contacts: UnilateralContactsSpec | None = None
    contact_friction: Annotated[ContactFrictionSpec, shorthand("mu", int, float)] | None = None
    joint_limits: Annotated[JointLimitsSpec, shorthand("range", str)] | None = None
    floor: FloorSpec | None = None
    contact_compliance: (
        Annotated[ContactComplianceSpec, shorthand("stiffness", int, float)] | None
    ) = None

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
        """Names of those by which contacts and joints open, close, slide or stop."""
        dry = self.joint_friction is not None and self.joint_friction.model == "set_valued"
        return tuple(
            name for name in self.named if name in WITH_EVENTS or (name == "joint_friction" and dry)
        )

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of those that have states besides positions and velocities."""
        named = self.named.items()
        return tuple(name for name, spec in named if getattr(spec, "has_states", False))

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms of the scene."""
        found = gain_faults(self.joint_damping, arms, damping_of, "<dynamics damping>")
        faults = below(("joint_damping",), found)
        faults += below(("rotor_inertia",), gain_faults(self.rotor_inertia, arms))
        faults += below(("torque_limits",), gain_faults(self.torque_limits, arms))
        for where, spec in self._parts():
            faults += below(where, spec.faults(arms) if hasattr(spec, "faults") else [])
        return faults

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Warnings about probable mistakes."""
        found = urdf_warnings(self.joint_damping, arms, damping_of, "<dynamics damping>")
        warnings = below(("joint_damping",), found)
        found = urdf_warnings(self.torque_limits, arms, _has_effort_limit, "<limit effort>")
        warnings += below(("torque_limits",), found)
        for where, spec in self._parts():
            warnings += below(where, spec.warnings(arms) if hasattr(spec, "warnings") else [])
        return warnings

    def _parts(self) -> Iterator[tuple[Parts, Any]]:
        """Place and parameters of each effect of ours, of each of a list."""
        for name in type(self).model_fields:
            spec = getattr(self, name)
            if isinstance(spec, tuple):
                yield from (((name, k), one) for k, one in enumerate(spec))
            else:
                yield (name,), spec
