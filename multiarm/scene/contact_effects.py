"""Effects of contacts that come and go, or give way: their parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from multiarm.scene.base import Pose, Spec
from multiarm.scene.per_joint import Faults, KnownArm
from multiarm.scene.urdf import JointOutline
from multiarm.scene.values import NonNegative, Positive, Vec3
from multiarm.scene.words import unknown

__all__ = [
    "ContactComplianceSpec",
    "ContactFrictionSpec",
    "FloorSpec",
    "JointLimitsSpec",
    "Restitution",
    "UnilateralContactsSpec",
]

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
        """What does not fit the arms; contacts are looked for once they are known."""
        names = enumerate(self.contacts or ())
        found: Faults = [
            (("contacts", k), unknown("arm", name.partition("/")[0], arms))
            for k, name in names
            if name.partition("/")[0] not in arms
        ]
        if self.contacts == ():
            found.append((("contacts",), "is empty; name arms or contacts, or leave it out"))
        return found


class UnilateralContactsSpec(SomeContacts):
    """Contacts that can only push let go when they would pull, and may close again.

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
    """Coulomb friction at contacts that can only push; these then let go as well.

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
        A table top of so much along x and y of that frame [m]; absent: it goes on for ever. Corners
        of the object leave it over its edges, which themselves touch nothing.
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
        """What does not fit the arms."""
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
        """What does not fit the arms."""
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
        """What is probably not meant."""
        if self.range != "urdf":
            return []
        text = "the URDF of arm {!r} gives no joint a range; write a table 'joint: [lower, upper]'"
        return [
            (("range",), text.format(arm))
            for arm, known in arms.items()
            if known.joints is not None and not any(map(_has_range, known.joints))
        ]


def _has_range(joint: JointOutline) -> bool:
    return math.isfinite(joint.lower) or math.isfinite(joint.upper)


def from_word(key: str, word: type) -> Any:
    """Let a bare value stand for a table with one key."""

    def convert(value: Any) -> Any:
        return {key: value} if isinstance(value, word) and not isinstance(value, bool) else value

    return BeforeValidator(convert)
