"""The kinds of joint between an arm and the object: ours, and users'."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, SerializeAsAny, ValidationInfo, WrapValidator

from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.scene.joints.fingertips import (
    CornerGripperJoint,
    PointOnCylinderJoint,
    PointOnPlaneJoint,
    PointOnSphereJoint,
)
from multiarm.scene.joints.kind import Joint, UnloadedJoint
from multiarm.scene.joints.pairs import (
    BallJoint,
    CylindricalJoint,
    PlanarJoint,
    PrismaticJoint,
    RevoluteJoint,
    UniversalJoint,
    WeldJoint,
)
from multiarm.scene.joints.wrenches import WrenchesJoint
from multiarm.scene.registry import AnyClass, Registry

_OURS = (
    WeldJoint,
    BallJoint,
    RevoluteJoint,
    PrismaticJoint,
    CylindricalJoint,
    UniversalJoint,
    PlanarJoint,
    PointOnPlaneJoint,
    PointOnCylinderJoint,
    PointOnSphereJoint,
    CornerGripperJoint,
    ContactsJoint,
    WrenchesJoint,
)
BUILT_IN: dict[str, type[Joint]] = {own.kind_name(): own for own in _OURS}
"""Our kinds by name."""
JOINTS: Registry[Joint] = Registry(
    sort="joint",
    noun="joint kind",
    plural="kinds",
    built_in=lambda: BUILT_IN,
    name_of=lambda own: own.kind_name(),
)
"""User kinds of joint."""


def register_joint(joint: AnyClass) -> AnyClass:
    """Let scenes name a user kind of joint, a subclass of :class:`multiarm.Joint`; a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        It lacks something, or another kind has its name.
    """
    return JOINTS.add(joint)


def pushing_kinds() -> list[str]:
    """Our kinds of joint with contacts that only push."""
    return sorted(kind for kind, own in BUILT_IN.items() if own.sample().pushes)


def _read(value: Any, handler: Callable[[Any], Any], info: ValidationInfo) -> Any:
    return JOINTS.read_kind(value, handler, info, UnloadedJoint)


if TYPE_CHECKING:
    JointSpec = Joint
else:
    JointSpec = Annotated[
        SerializeAsAny[Annotated[reduce(or_, _OURS), Field(discriminator="kind")]],
        WrapValidator(_read),
    ]
