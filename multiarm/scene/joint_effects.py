"""Effects in the joints and their drives: the parameters that a scene gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.per_joint import (
    Faults,
    KnownArm,
    UrdfGain,
    gain_faults,
    urdf_faults,
    urdf_warnings,
)
from multiarm.scene.urdf import JointOutline
from multiarm.scene.values import Gain, Positive, fault

__all__ = [
    "ActuatorLag",
    "JointFriction",
    "damping_of",
    "effort_limit_of",
    "friction_of",
    "has_effort_limit",
]

FRICTION_SPEED = 0.01
"""Speed at which smooth friction is 76 % of the full one [rad/s] or [m/s]."""


def damping_of(joint: JointOutline) -> float:
    """Viscous friction that the robot's file gives a joint."""
    return joint.damping


def friction_of(joint: JointOutline) -> float:
    """Dry friction that the robot's file gives a joint."""
    return joint.friction


def has_effort_limit(joint: JointOutline) -> bool:
    """Whether the robot's file limits the torque of a joint; 0 means that it does not."""
    return 0.0 < joint.effort_limit < math.inf


def effort_limit_of(joint: JointOutline) -> float:
    """Largest torque that the robot's file allows a joint; infinite where it has none."""
    return joint.effort_limit if has_effort_limit(joint) else math.inf


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
        return FRICTION_SPEED if self.speed is None else self.speed

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What does not fit the arms."""
        found = gain_faults(self.torque, arms)
        found += urdf_faults(self.torque, arms, friction_of, "<dynamics friction>")
        return [(("torque", *below), text) for below, text in found]

    def warnings(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What is probably not meant."""
        given = urdf_warnings(self.torque, arms, friction_of, "<dynamics friction>")
        return [(("torque", *below), text) for below, text in given]


class ActuatorLag(Spec):
    """Drives whose torque follows the command with a delay: T torque' = command - torque.

    May be written as ``time_constant`` alone.  Acts on what ``torque_limits`` leave of the command.

    Attributes
    ----------
    time_constant : number or table 'arm: values'
        T [s]; joints that are not named, or have 0, follow at once.
    start : 'command' or 'zero'
        The torque at the start of a run: what is commanded there, or none.
    """

    has_states: ClassVar[bool] = True

    time_constant: Gain = Field(description="in s: a number, a list or a table by arm")
    start: Literal["command", "zero"] = "command"

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What does not fit the arms."""
        found = gain_faults(self.time_constant, arms)
        return [(("time_constant", *below), text) for below, text in found]


def _shorthand(key: str, kind: type[Spec]) -> BeforeValidator:
    """Let the value of one key stand for the whole table."""

    def whole(value: Any) -> Any:
        if value is None or isinstance(value, kind):
            return value
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return value
        return {key: value}

    return BeforeValidator(whole)


AnyJointFriction = Annotated[JointFriction | None, _shorthand("torque", JointFriction)]
AnyActuatorLag = Annotated[ActuatorLag | None, _shorthand("time_constant", ActuatorLag)]
