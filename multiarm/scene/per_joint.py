"""Values for the joints of all arms, checked against the arms that a scene has.

A value may be written as one number for all joints of all arms, as a list or a table for every arm
alike, or as a table ``arm: value``; where a robot's file has such numbers too, ``urdf`` stands for
these, for all arms or for one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator

from multiarm.scene.urdf import JointOutline
from multiarm.scene.values import Parts, fault, joint_value_faults, non_negative_gain
from multiarm.scene.words import listed, shown, unknown

__all__ = [
    "URDF",
    "Faults",
    "KnownArm",
    "UrdfGain",
    "gain_faults",
    "urdf_faults",
    "urdf_warnings",
]

URDF = "urdf"
"""What is written in place of numbers that are in the robot's file."""

Faults = list[tuple[Parts, str]]
"""Pairs of a place, below that of the value, and what is wrong there."""


@dataclass(frozen=True)
class KnownArm:
    """What is known of an arm when a scene is checked; None where it is unsound itself.

    Attributes
    ----------
    joints : tuple of JointOutline
        The movable ones from base to tip.
    links : tuple of str
        All links, of the robot and of its tool.
    moving : tuple of str
        Those that the movable joints carry.
    """

    joints: tuple[JointOutline, ...] | None
    links: tuple[str, ...] | None
    moving: tuple[str, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...] | None:
        """Names of the movable joints."""
        return None if self.joints is None else tuple(joint.name for joint in self.joints)


def gain_faults(value: Any, arms: Mapping[str, KnownArm]) -> Faults:
    """What does not fit the arms in a value for all of them, or in a table by arm."""
    if value is None:
        return []
    by_arm = value if isinstance(value, Mapping) else dict.fromkeys(arms, value)
    faults: Faults = []
    for arm, own in by_arm.items():
        below = (arm,) if isinstance(value, Mapping) else ()
        if arm not in arms:
            faults.append((below, unknown("arm", arm, arms)))
            continue
        names = arms[arm].joint_names
        if names is None or _from_urdf(own):
            continue
        subject = "" if isinstance(value, Mapping) else f"arm {arm!r}: "
        for further, text in joint_value_faults(own, names):
            faults.append(((*below, *further), f"{subject}{text}"))
    return faults


def arms_by_urdf(value: Any, arms: Iterable[str]) -> list[str]:
    """The arms whose numbers are those of their robots' files."""
    if isinstance(value, Mapping):
        return [arm for arm in arms if _from_urdf(value.get(arm))]
    return list(arms) if _from_urdf(value) else []


def urdf_faults(
    value: Any, arms: Mapping[str, KnownArm], number: Callable[[JointOutline], float], what: str
) -> Faults:
    """Numbers of the robots' files that cannot be meant: negative ones."""
    faults: Faults = []
    for arm in arms_by_urdf(value, arms):
        wrong = [j.name for j in arms[arm].joints or () if not number(j) >= 0.0]
        if wrong:
            below = (arm,) if isinstance(value, Mapping) else ()
            text = f"the URDF of arm {arm!r} gives {listed(wrong)} a {what} that is no number >= 0"
            faults.append((below, f"{text}; mend the file, or write numbers here"))
    return faults


def urdf_warnings(
    value: Any, arms: Mapping[str, KnownArm], given: Callable[[JointOutline], Any], what: str
) -> Faults:
    """Arms whose robots' files give no joint such a number."""
    return [
        (
            (arm,) if isinstance(value, Mapping) else (),
            f"the URDF of arm {arm!r} gives no joint a {what}; write numbers to give them some",
        )
        for arm in arms_by_urdf(value, arms)
        if not any(given(joint) for joint in arms[arm].joints or ())
    ]


def _urdf_or_gain(value: Any) -> Any:
    if _from_urdf(value):
        return value
    if isinstance(value, str):
        raise fault(f"must be a number, a list, a table or {URDF!r}, got {shown(value)}")
    if not isinstance(value, Mapping):
        return non_negative_gain(value)
    numbers = non_negative_gain({k: 0.0 if _from_urdf(own) else own for k, own in value.items()})
    assert isinstance(numbers, dict), "a table stays a table"
    return {arm: URDF if _from_urdf(value[arm]) else own for arm, own in numbers.items()}


def _from_urdf(value: Any) -> bool:
    return isinstance(value, str) and value == URDF


UrdfGain = Annotated[
    float | str | tuple[float, ...] | dict[str, float | str | tuple[float, ...] | dict[str, float]],
    BeforeValidator(_urdf_or_gain),
]
