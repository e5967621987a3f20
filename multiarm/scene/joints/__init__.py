"""The kinds of joint between an arm and the object: ours, and users'."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multiarm.scene.joints import contacts, fingertips, pairs, wrenches
from multiarm.scene.joints.kind import Joint, UnloadedJoint
from multiarm.scene.registry import AnyClass, Registry

_OURS: tuple[type[Joint], ...] = (
    pairs.WeldJoint,
    pairs.BallJoint,
    pairs.RevoluteJoint,
    pairs.PrismaticJoint,
    pairs.CylindricalJoint,
    pairs.UniversalJoint,
    pairs.PlanarJoint,
    fingertips.PointOnPlaneJoint,
    fingertips.PointOnCylinderJoint,
    fingertips.PointOnSphereJoint,
    fingertips.CornerGripperJoint,
    contacts.ContactsJoint,
    wrenches.WrenchesJoint,
)
BUILT_IN = {joint.kind_name(): joint for joint in _OURS}
"""Our kinds by name."""
JOINTS: Registry[Joint] = Registry("joint", "joint kind", "kinds", BUILT_IN, UnloadedJoint)
"""User kinds of joint."""


def register_joint(joint: AnyClass) -> AnyClass:
    """Let scenes name a user kind of joint, a subclass of :class:`multiarm.Joint`; a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        The class cannot be used, or another kind has its name.
    """
    return JOINTS.add(joint)


def pushing_kinds() -> list[str]:
    """Our kinds of joint with contacts that only push."""
    return sorted(kind for kind, joint in BUILT_IN.items() if joint.sample().pushes)


if TYPE_CHECKING:
    JointSpec = Joint
else:
    JointSpec = JOINTS.by_kind()
