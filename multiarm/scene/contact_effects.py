"""Effects of contacts that come and go: their parameters."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from multiarm.scene.base import Pose, Spec
from multiarm.scene.values import NonNegative, Positive, Vec3

__all__ = [
    "ContactFrictionSpec",
    "FloorSpec",
    "JointLimitsSpec",
    "Restitution",
    "UnilateralContactsSpec",
]

Restitution = Annotated[float, Field(ge=0.0, le=1.0)]


class UnilateralContactsSpec(Spec):
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
    contacts: tuple[str, ...] | None = None
    start: Literal["closed", "as_written"] = "closed"


class ContactFrictionSpec(Spec):
    """Coulomb friction at contacts that can only push; these then let go as well.

    Attributes
    ----------
    mu : float
        Coefficient of friction.
    contacts : list of str, optional
        Arms, or contacts as 'arm/contact'; absent: every contact that only pushes.
    """

    mu: NonNegative
    contacts: tuple[str, ...] | None = None


class FloorSpec(Spec):
    """A plane that the object can touch with its corners.

    Attributes
    ----------
    at : Pose
        Its frame: the z axis points out of the floor.
    size : 2 numbers, optional
        A table top of so much along x and y of that frame [m]; absent: it goes on for ever.
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


def from_word(key: str, word: type) -> Any:
    """Let a bare value stand for a table with one key."""

    def convert(value: Any) -> Any:
        return {key: value} if isinstance(value, word) and not isinstance(value, bool) else value

    return BeforeValidator(convert)
