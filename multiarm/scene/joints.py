"""The kinds of joint between an arm and the object, as they are written in a scene.

Every joint is, to the rest of the program, a set of frictionless point contacts (S.Y. Ho, "Analysis
and Design of Multi-Arm Robotic Systems Manipulating Large Objects", CUHK MPhil thesis, 1995,
section 3.9). Here stand only the names and numbers that a user chooses. The joint frame is given in
the object frame (``at``) and in the tip's frame (``at_tip``); both coincide at the start.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Pose, Spec
from multiarm.scene.geometry import ContactSpec, check_tip_fits
from multiarm.scene.values import Direction, NonNegative, Positive, Vec3, fault

__all__ = [
    "BallJoint",
    "ContactsJoint",
    "CornerGripperJoint",
    "CylindricalJoint",
    "JointBase",
    "JointSpec",
    "PlanarJoint",
    "PointOnCylinderJoint",
    "PointOnPlaneJoint",
    "PointOnSphereJoint",
    "PrismaticJoint",
    "RevoluteJoint",
    "UniversalJoint",
    "WeldJoint",
]

_Z = (0.0, 0.0, 1.0)


class JointBase(Spec):
    """What all joints share.

    Attributes
    ----------
    arm : str
        The arm whose tip is joined to the object.
    name : str, optional
        A name for reports.
    at : Pose, optional
        Joint frame in the object frame. Absent: where the arm's joint frame is at the start.
    at_tip : Pose
        Joint frame in the frame of the arm's tip.
    """

    arm: str = Field(description="the name of the arm that this joint connects")
    name: str | None = None
    at: Pose | None = None
    at_tip: Pose = Pose()


class WeldJoint(JointBase):
    """No relative motion: six contacts, 3-2-1, spread over ``size`` [m]."""

    kind: Literal["weld"] = "weld"
    size: Positive = 0.1


class BallJoint(JointBase):
    """Free rotation about the joint frame's origin: three contacts on a sphere of ``size`` [m]."""

    kind: Literal["ball"] = "ball"
    size: Positive = 0.1


class RevoluteJoint(JointBase):
    """Rotation about ``axis`` (joint frame) only: five contacts spread over ``size`` [m]."""

    kind: Literal["revolute"] = "revolute"
    axis: Direction = _Z
    size: Positive = 0.1


class PrismaticJoint(JointBase):
    """Sliding along ``axis`` (joint frame) only: five contacts spread over ``size`` [m]."""

    kind: Literal["prismatic"] = "prismatic"
    axis: Direction = _Z
    size: Positive = 0.1


class CylindricalJoint(JointBase):
    """Rotation about and sliding along ``axis`` (joint frame): four contacts."""

    kind: Literal["cylindrical"] = "cylindrical"
    axis: Direction = _Z
    size: Positive = 0.1


class UniversalJoint(JointBase):
    """Rotation about the x axis fixed to the object and the y axis fixed to the arm."""

    kind: Literal["universal"] = "universal"
    size: Positive = 0.1


class PlanarJoint(JointBase):
    """Sliding in the plane across ``normal`` (joint frame) and turning about it."""

    kind: Literal["planar"] = "planar"
    normal: Direction = _Z
    size: Positive = 0.1


class PointOnPlaneJoint(JointBase):
    """A fingertip on a flat face of the object.

    Attributes
    ----------
    normal : 3 numbers
        Outward normal of the object's face, joint frame.
    tip_radius : float
        Radius of the spherical fingertip [m]; 0 is a sharp point.
    """

    kind: Literal["point_on_plane"] = "point_on_plane"
    normal: Direction = _Z
    tip_radius: NonNegative = 0.0


class PointOnCylinderJoint(JointBase):
    """A fingertip on a cylindrical face of the object.

    Attributes
    ----------
    radius : float
        Radius of the cylinder [m] about the joint frame's origin.
    axis : 3 numbers
        Axis of the cylinder, joint frame.
    inside : bool
        The fingertip is inside a bore.
    tip_radius : float
        Radius of the spherical fingertip [m]; 0 is a sharp point.
    """

    kind: Literal["point_on_cylinder"] = "point_on_cylinder"
    radius: Positive = Field(description="the radius of the cylinder in metres")
    axis: Direction = _Z
    inside: bool = False
    tip_radius: NonNegative = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        check_tip_fits(self.inside, self.radius, self.tip_radius, "bore")
        return self


class PointOnSphereJoint(JointBase):
    """A fingertip on (or inside) a sphere about the joint frame's origin, ``radius`` in m."""

    kind: Literal["point_on_sphere"] = "point_on_sphere"
    radius: Positive = Field(description="the radius of the sphere in metres")
    inside: bool = False
    tip_radius: NonNegative = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        check_tip_fits(self.inside, self.radius, self.tip_radius, "hollow sphere")
        return self


class CornerGripperJoint(JointBase):
    """Four fingertips on the three faces at a corner of a block (thesis, Example 3.1).

    Attributes
    ----------
    points : 4 x 3 numbers
        Contact points [m] on the block. The joint frame is the corner, its axes run along the
        block's edges into the block.
    faces : 4 of 'x', 'y', 'z'
        The face each point lies on: the one across that axis.
    tip_radius : float
        Radius of the spherical fingertips [m]; 0 are sharp points.
    """

    kind: Literal["corner_gripper"] = "corner_gripper"
    points: tuple[Vec3, ...] = (
        (0.04, 0.03, 0.0),
        (0.05, 0.0, 0.06),
        (0.09, 0.05, 0.0),
        (0.0, 0.07, 0.05),
    )
    faces: tuple[Literal["x", "y", "z"], ...] = ("z", "y", "z", "x")
    tip_radius: NonNegative = 0.0

    @model_validator(mode="after")
    def _points_lie_on_their_faces(self) -> Self:
        if len(self.points) != 4 or len(self.faces) != 4:
            raise fault(
                f"a corner gripper has 4 points and 4 faces, got {len(self.points)} and "
                f"{len(self.faces)}; other numbers of fingertips are written as 'kind: contacts'"
            )
        for number, (point, face) in enumerate(zip(self.points, self.faces, strict=True)):
            if abs(point["xyz".index(face)]) > 1e-9:
                raise fault(
                    f"point {number}, {list(point)}, is not on face {face!r}, where {face} = 0; "
                    "mend the point or name its face"
                )
        return self


class ContactsJoint(JointBase):
    """Any list of frictionless point contacts.

    Attributes
    ----------
    at, at_tip : Pose
        Frames in which the object's and the arm's geometry are given; by default the object
        frame and the tip's frame themselves.
    contacts : list of ContactSpec
        At least one.
    """

    kind: Literal["contacts"] = "contacts"
    at: Pose = Pose()
    contacts: tuple[ContactSpec, ...] = Field(description="a list of {arm: ..., object: ...}")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if not self.contacts:
            raise fault("'contacts' is empty; list at least one contact {arm: ..., object: ...}")
        return self


JointSpec = Annotated[
    WeldJoint
    | BallJoint
    | RevoluteJoint
    | PrismaticJoint
    | CylindricalJoint
    | UniversalJoint
    | PlanarJoint
    | PointOnPlaneJoint
    | PointOnCylinderJoint
    | PointOnSphereJoint
    | CornerGripperJoint
    | ContactsJoint,
    Field(discriminator="kind"),
]
