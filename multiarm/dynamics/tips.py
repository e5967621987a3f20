"""Poses, twists and Jacobians of the arms' tips at a state, for users."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from multiarm.dynamics.layout import NAMED_ARMS
from multiarm.dynamics.state import State
from multiarm.errors import ModelError
from multiarm.public import public_names
from multiarm.robots.robot import Robot
from multiarm.robots.terms import TipKinematics
from multiarm.scene.bodies import BodyName
from multiarm.scene.faults import counted


class _UnknownArmError(ModelError, KeyError):
    """A KeyError whose text is a sentence."""

    def __str__(self) -> str:
        return str(self.args[0])


class _Tips(dict[str, TipKinematics]):
    """By tip, in the order of the scene."""

    def __missing__(self, name: str) -> TipKinematics:
        known = ", ".join(map(repr, self))
        noun = "tip" if any("/" in tip for tip in self) else "arm"
        raise _UnknownArmError(f"tips: unknown {noun} {name!r}; {noun}s are {known}")


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Where the tips of the arms are at a state, and how they move.

    From :meth:`multiarm.System.kinematics`.

    Attributes
    ----------
    tips : dict tip -> TipKinematics
        ``"left"`` of an arm, ``"cart/left"`` of a robot with several tips; of these also the links
        that joints name besides its tips.
    """

    tips: dict[str, TipKinematics]

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Kinematics(tips of {counted(list(self.tips), NAMED_ARMS)})"


def kinematics_of(arms: Iterable[Robot], state: State) -> Kinematics:
    """The tips of some arms and robots at a state."""
    tips, positions, velocities = _Tips(), state.joint_positions, state.joint_velocities
    for arm in arms:
        angles, rates, base = positions[arm.name], velocities[arm.name], state.bases.get(arm.name)
        for tip in arm.tips:
            name = str(BodyName(arm.name, tip))
            tips[name] = arm.tip_kinematics(angles, rates, tip, base)
    return Kinematics(tips)
