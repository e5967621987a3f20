"""Effects of the joints and their drives: friction, inertia, limits and lag."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, ClassVar, Literal

from pydantic import model_validator
from typing_extensions import Self

from multiarm.scene.effects.kind import EffectKind, or_only
from multiarm.scene.faults import Faults, below, invalid
from multiarm.scene.joint_values import (
    URDF,
    Gain,
    KnownRobots,
    UrdfGain,
    gain_faults,
    urdf_warnings,
)
from multiarm.scene.urdf import JointOutline
from multiarm.scene.values import Positive

_FRICTION_SPEED = 0.01
"""Speed at which smooth friction is 76 % of the full one [rad/s] or [m/s]."""

damping_of: Callable[[JointOutline], float] = attrgetter("damping")
"""Viscous friction that the robot's file gives a joint."""
friction_of: Callable[[JointOutline], float] = attrgetter("friction")
"""Dry friction that the robot's file gives a joint."""


def effort_limit_of(joint: JointOutline) -> float:
    """Largest torque that the robot's file allows a joint; infinite where it has none, or 0."""
    return joint.effort_limit if joint.effort_limit > 0.0 else math.inf


def _has_effort_limit(joint: JointOutline) -> bool:
    return math.isfinite(effort_limit_of(joint))


class JointNumbers(EffectKind):
    """Base class of effects that are the numbers of the joints alone, as a scene has them.

    Attributes
    ----------
    numbers : type
        Of the numbers.
    means : str
        What they are, with their units.
    """

    numbers: ClassVar[Any] = UrdfGain
    means: ClassVar[str] = ""

    values: Any

    @classmethod
    def entry(cls) -> Any:
        return cls.numbers

    @classmethod
    def meaning(cls) -> str:
        return cls.means

    def faults(self, arms: KnownRobots) -> Faults:
        return gain_faults(self.values, arms)


class JointDamping(JointNumbers):
    """Viscous friction of the arms' joints: a torque against the velocity."""

    name = "joint_damping"
    means = (
        "Viscous damping of the arms' joints [N m s/rad] or [N s/m]. urdf: the robot's <dynamics "
        "damping>, also for single arms of a table."
    )
    picture = "oil in the joints: the faster a joint turns, the more it is slowed down"
    example = "effects: {joint_damping: 0.5}  # [N m s/rad], or urdf: as the robot's file says"
    usual = URDF

    def faults(self, arms: KnownRobots) -> Faults:
        return gain_faults(self.values, arms, damping_of, "<dynamics damping>")

    def warnings(self, arms: KnownRobots) -> Faults:
        return urdf_warnings(self.values, arms, damping_of, "<dynamics damping>")


class JointFriction(EffectKind):
    """Dry (Coulomb) friction of the arms' joints.

    May be written as ``torque`` alone.
    """

    name = "joint_friction"
    reads = or_only("torque", UrdfGain, "model", "speed")
    picture = "dry bearings: a joint resists with the same torque at any speed, and may stick"
    example = "effects: {joint_friction: {torque: 2, model: set_valued}}  # [N m]"
    usual = URDF

    torque: UrdfGain
    """Friction torque [N m], of sliding joints force [N]: a number, a table by arm, or 'urdf', the
    robot's <dynamics friction>. Joints that are not named have none."""
    model: Literal["smooth", "set_valued"] = "smooth"
    """``smooth``: -torque tanh(velocity / speed), which creeps under load; ``set_valued``: a joint
    sticks until the load exceeds the friction torque."""
    speed: Positive | None = None
    """Of the smooth model [rad/s] or [m/s]; 0.01 when left out."""

    @model_validator(mode="after")
    def _speed_belongs_to_the_smooth_model(self) -> Self:
        if self.model == "set_valued" and self.speed is not None:
            raise invalid("'speed' belongs to model 'smooth'; remove it, or change 'model'")
        return self

    @property
    def smoothing_speed(self) -> float:
        """Speed of the smooth model, [rad/s] or [m/s]."""
        return _FRICTION_SPEED if self.speed is None else self.speed

    def faults(self, arms: KnownRobots) -> Faults:
        faults = gain_faults(self.torque, arms, friction_of, "<dynamics friction>")
        return below(("torque",), faults)

    def warnings(self, arms: KnownRobots) -> Faults:
        warnings = urdf_warnings(self.torque, arms, friction_of, "<dynamics friction>")
        return below(("torque",), warnings)

    @property
    def has_events(self) -> bool:
        """Where joints stick and slip."""
        return self.model == "set_valued"


class RotorInertia(JointNumbers):
    """Inertia of the drives as seen from the joints."""

    name = "rotor_inertia"
    numbers = Gain
    means = (
        "Inertia of the drives as seen from the joint, that of the rotor times the gear ratio "
        "squared [kg m^2], of sliding joints [kg]."
    )
    picture = "heavy motors: each joint has a flywheel that its gear makes heavier still"
    example = "effects: {rotor_inertia: 0.1}  # at the joint [kg m^2]"
    usual = 0.1  # at the joint [kg m^2, kg]


class TorqueLimits(JointNumbers):
    """Largest torque of the drives; what the control commands beyond it is cut off."""

    name = "torque_limits"
    means = (
        "Largest torque of the drives [N m], of sliding joints force [N]: what the control "
        "commands beyond it is cut off. urdf: the robot's <limit effort>. Joints that are not "
        "named, or have no limit in the URDF, are not limited."
    )
    picture = "motors that are not strong enough: what is asked of them beyond their limit is lost"
    example = "effects: {torque_limits: urdf}  # as the robot's file says, or 150 [N m]"
    usual = URDF

    def warnings(self, arms: KnownRobots) -> Faults:
        return urdf_warnings(self.values, arms, _has_effort_limit, "<limit effort>")


class ActuatorLag(EffectKind):
    """Drives whose torque follows the command with a delay: T torque' = command - torque.

    May be written as ``time_constant`` alone.  Acts on the command after ``torque_limits``.
    """

    name = "actuator_lag"
    reads = or_only("time_constant", Gain, "start")
    picture = "sluggish drives: the torque follows its command a moment later"
    example = "effects: {actuator_lag: 0.02}  # time constant [s]"
    usual = 0.01  # time constant of a drive [s]
    has_states = True

    time_constant: Gain
    """Time constant T [s]: a number, a list or a table by arm. Joints that are not named, or have
    0, follow at once."""
    start: Literal["command", "zero"] = "command"
    """The torque at the start of a run: the command, or zero."""

    def faults(self, arms: KnownRobots) -> Faults:
        return below(("time_constant",), gain_faults(self.time_constant, arms))
