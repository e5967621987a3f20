"""Poses, twists and Jacobians of the arms' tips at a state, for users."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from multiarm.arms.arm import Arm
from multiarm.arms.terms import TipKinematics
from multiarm.dynamics.layout import NAMED_ARMS
from multiarm.dynamics.state import State
from multiarm.errors import ModelError
from multiarm.public import public_names
from multiarm.scene.faults import counted


class _UnknownArmError(ModelError, KeyError):
    """A KeyError whose text is a sentence."""

    __str__ = ModelError.__str__


class _Tips(dict[str, TipKinematics]):
    """By arm, in the order of the scene."""

    def __missing__(self, arm: str) -> TipKinematics:
        known = ", ".join(map(repr, self))
        raise _UnknownArmError(f"tips: unknown arm {arm!r}; arms are {known}")


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Where the tips of the arms are at a state, and how they move.

    From :meth:`multiarm.System.kinematics`.

    Attributes
    ----------
    tips : dict arm -> TipKinematics
    """

    tips: dict[str, TipKinematics]

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Kinematics(tips of {counted(list(self.tips), NAMED_ARMS)})"


def kinematics_of(arms: Iterable[Arm], state: State) -> Kinematics:
    """The tips of some arms at a state."""
    tips, positions, velocities = _Tips(), state.joint_positions, state.joint_velocities
    for arm in arms:
        tips[arm.name] = arm.tip_kinematics(positions[arm.name], velocities[arm.name])
    return Kinematics(tips)
