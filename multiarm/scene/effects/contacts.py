"""Effects of contacts and joint stops that open, close, slide or give way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, TypeAdapter

from multiarm.scene.effects.kind import EffectKind, OfObjects
from multiarm.scene.faults import Faults, listed, unknown
from multiarm.scene.joint_values import URDF, KnownRobots, unknown_connection, unknown_robot
from multiarm.scene.spec import shorthand
from multiarm.scene.values import Bound, NonNegative, Pose, Positive, UnitInterval, Vec3, list_of

if TYPE_CHECKING:
    from multiarm.scene.object import ObjectSpec


class SomeContacts(EffectKind):
    """An effect of some of the contacts of a scene."""

    can_open = True

    contacts: tuple[str, ...] | None = None
    """Joints by their names, or contacts as 'joint/contact', of joints with 'arm' the arm; absent:
    all that the effect can be of."""

    def faults(self, arms: KnownRobots) -> Faults:
        """Faults with respect to the arms; contacts are checked once they are known."""
        faults: Faults = [
            (("contacts", k), text)
            for k, name in enumerate(self.contacts or ())
            if (text := unknown_connection(name, arms, contacts=True))
        ]
        if self.contacts == ():
            faults.append((("contacts",), "is empty; name arms or contacts, or leave it out"))
        return faults


class UnilateralContactsSpec(SomeContacts):
    """Contacts that can only push open when they would pull, and may close again.

    Attributes
    ----------
    contacts
        Joints by their names, or contacts as 'joint/contact', of joints with 'arm' the arm; absent:
        every contact that only pushes.
    """

    name = "unilateral_contacts"
    picture = "fingertips that are not glued on: they let go, and come back with a bounce"
    example = "effects: {unilateral_contacts: {restitution: 0.3}}"
    of_pushing = True
    usual: ClassVar[Any] = {}

    restitution: UnitInterval = 0.0
    """Newton's coefficient, 0 (no bounce) to 1."""
    start: Literal["closed", "as_written"] = "closed"
    """Whether the start is assembled with these contacts closed, as that of a scene without this
    effect, or left as it is written, where they may be apart."""


class ContactFrictionSpec(SomeContacts):
    """Coulomb friction at contacts that can only push; these may then open as well.

    Attributes
    ----------
    contacts
        Joints by their names, or contacts as 'joint/contact', of joints with 'arm' the arm; absent:
        every contact that only pushes.
    """

    name = "contact_friction"
    reads = shorthand("mu", NonNegative, int, float)
    picture = "rubber fingertips: they grip the object by friction, until it slips"
    example = "effects: {contact_friction: 0.5}  # coefficient of friction"
    usual = 0.3  # Coulomb's coefficient of dry metal
    of_pushing = True

    mu: NonNegative
    """Coefficient of friction."""


class ContactComplianceSpec(SomeContacts):
    """Contacts that give way like a spring and a damper, and are no constraints.

    Those that can only push do so only while they are pressed in.

    Attributes
    ----------
    contacts : list of str, optional
        Joints by their names, or contacts as 'joint/contact', of joints with 'arm' the arm; absent:
        all contacts of all joints.
    """

    name = "contact_compliance"
    reads = shorthand("stiffness", Positive, int, float)
    picture = "soft fingertips: contacts give way a little, as rubber does"
    example = "effects: {contact_compliance: {stiffness: 1e+5, damping: 100}}  # [N/m], [N s/m]"

    stiffness: Positive
    """Of the spring [N/m]."""
    damping: NonNegative = 0.0
    """Of the damper [N s/m]."""


class FloorSpec(OfObjects):
    """A plane that objects can touch: a sphere anywhere, other shapes with their corners.

    A mesh touches with the corners of its convex hull.
    """

    name = "floor"
    picture = "a table or the ground: the object can fall on it, rest and slide"
    example = "effects: {floor: {at: {xyz: [0, 0, 0.3]}, mu: 0.5}}"
    can_open = True

    at: Pose = Pose()
    """Its frame: the z axis points out of the floor."""
    size: tuple[Positive, Positive] | None = None
    """A table top of so much along x and y of that frame [m]; absent: unbounded. Corners of the
    object leave it over its edges, which themselves touch nothing."""
    restitution: UnitInterval = 0.0
    """Newton's coefficient, 0 to 1."""
    mu: NonNegative | None = None
    """Coefficient of friction; absent: without friction."""
    points: tuple[Vec3, ...] | None = None
    """Points of the object that can touch it, object frame [m]; absent: the corners of its shape.
    """

    def faults(self, arms: KnownRobots) -> Faults:
        faults = super().faults(arms)
        if self.points == ():
            faults.append((("points",), "is empty; list points of the object, or leave it out"))
        elif self.points is not None and self.object is None and len(arms.objects) > 1:
            text = f"needs 'object', the one whose points these are: {listed(arms.objects)}"
            faults.append((("points",), text))
        return faults

    @classmethod
    def typical(cls, body: ObjectSpec) -> Mapping[str, Any] | None:
        """A floor that a box, a hull or a sphere just touches at its start."""
        solid, pose = body.shape.solid, body.pose.matrix()
        if solid is None or body.shape.cylinder is not None or body.shape.mesh is not None:
            return None
        points, radius = solid.corners()
        return {
            "at": {"xyz": [0.0, 0.0, float(pose[2, 3] + np.min(points @ pose[2, :3])) - radius]}
        }


_FromUrdf = Literal["urdf"]
_Ends = Annotated[
    tuple[Bound, Bound], list_of("must be a list of two numbers, the lower and the upper end", 2)
]
_Ranges = dict[str, dict[str, _Ends]]


def _read_range(value: Any) -> Any:
    """Faults are those of a word or of a table, and not of both."""
    kind: Any = _FromUrdf if isinstance(value, str) else _Ranges
    return TypeAdapter(kind).validate_python(value)


class JointLimitsSpec(EffectKind):
    """Joints stop at the ends of their range."""

    name = "joint_limits"
    reads = shorthand("range", Literal["urdf"], str)
    picture = "end stops: a joint that reaches the end of its range stops there, or bounces"
    example = "effects: {joint_limits: urdf}  # ranges as the robot's file says"
    can_open = True
    usual = URDF

    range: Annotated[_FromUrdf | _Ranges, BeforeValidator(_read_range)] = "urdf"
    """Ends [rad, m]; of the URDF, or as given."""
    restitution: UnitInterval = 0.0
    """Newton's coefficient, 0 to 1."""

    def faults(self, arms: KnownRobots) -> Faults:
        faults: Faults = []
        for arm, joints in {} if self.range == "urdf" else self.range.items():
            if arm not in arms:
                faults.append((("range", arm), unknown_robot(arm, arms)))
                continue
            known = arms[arm].joint_names
            for joint, (lower, upper) in joints.items():
                place = ("range", arm, joint)
                if known is not None and joint not in known:
                    faults.append((place, unknown("joint", joint, known)))
                if not lower < upper:
                    faults.append((place, f"the lower end {lower:g} is not below {upper:g}"))
        return faults

    def warnings(self, arms: KnownRobots) -> Faults:
        if self.range != "urdf":
            return []
        text = (
            "the URDF of arm {0!r} gives no joint a range; write '{0}: {{joint: [lower, upper]}}'"
        )
        return [
            (("range",), text.format(arm))
            for arm, known in arms.items()
            if known.joints is not None
            and not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in known.joints)
        ]
