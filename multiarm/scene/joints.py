"""The kinds of joint between an arm and the object, as they are written in a scene.

Every joint is, to the rest of the program, a set of frictionless point contacts (S.Y. Ho, "Analysis
and Design of Multi-Arm Robotic Systems Manipulating Large Objects", CUHK MPhil thesis, 1995,
section 3.9). Here stand only the names and numbers that a user chooses. The joint frame is given in
the object frame (``at``) and in the tip's frame (``at_tip``); both coincide at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault
from multiarm.scene.geometry import ContactSpec
from multiarm.scene.values import (
    Direction,
    NonNegative,
    Pose,
    Positive,
    Range,
    Spec,
    Vec3,
    Vec6,
)

_Z = (0.0, 0.0, 1.0)
# A wrench that stands out of the span of those before it by less than this fraction of itself is
# taken for a combination of them: as many digits as a person may write.
_SPAN_TOLERANCE = 1e-9
# Wrenches that take part in a combination with less than this weight are not named.
_NAMED_WEIGHT = 1e-6


def _around_the_start(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] <= 0.0 <= limits[1]:
        raise fault(
            f"limits are counted from where the joint's two frames coincide, as they do at the "
            f"start unless 'at' turns them, and must enclose 0, got [{limits[0]:g}, "
            f"{limits[1]:g}]"
        )
    return limits


Limits = Annotated[Range, AfterValidator(_around_the_start)]
Line = Annotated[
    Direction,
    Field(description="Direction of the line through the joint frame's origin, joint frame."),
]
Spread = Annotated[
    Positive,
    Field(
        description="How far the contacts are spread [m]; contact forces depend on it, motions do "
        "not."
    ),
]
TipRadius = Annotated[
    NonNegative,
    Field(description="Radius of the spherical fingertip [m]; 0 is a sharp point."),
]


class JointBase(Spec):
    """Keys of all joints.

    Attributes
    ----------
    arm : str
        The arm whose tip is joined to the object.
    name : str, optional
        A name for reports.
    at : Pose, optional
        Joint frame in the object frame. Absent: where the arm's joint frame is at the start; kind
        'contacts': the object's own frame.
    at_tip : Pose
        Joint frame in the frame of the arm's tip.
    """

    arm: str = Field(description="the name of the arm that this joint connects")
    name: str | None = None
    at: Pose | None = None
    at_tip: Pose = Pose()

    limited: ClassVar[dict[str, int]] = {}
    """Component of the relative motion that each attribute limits."""

    @property
    def free_limits(self) -> dict[int, tuple[float, float]]:
        """Limits by component of the relative motion.

        Components 0 to 2 are slides along [m], 3 to 5 turns about [rad] x, y, z of the joint frame
        once that is turned so that z is the joint's axis.
        """
        limits = {component: getattr(self, name) for name, component in self.limited.items()}
        return {component: ends for component, ends in limits.items() if ends is not None}


class WeldJoint(JointBase):
    """No relative motion: six contacts, 3-2-1, spread over ``size``."""

    kind: Literal["weld"] = "weld"
    size: Spread = 0.1


class BallJoint(JointBase):
    """Free rotation about the joint frame's origin: three contacts at that point.

    Attributes
    ----------
    size : float
        Diameter of the ball [m]; nothing depends on it.
    """

    kind: Literal["ball"] = "ball"
    size: Positive = 0.1


class RevoluteJoint(JointBase):
    """Rotation about ``axis`` only: five contacts spread over ``size``.

    Attributes
    ----------
    limits : 2 numbers, optional
        How far it may turn from the start [rad], such as [-1.5, 0]: drawn and reported, not
        enforced.
    """

    limited: ClassVar[dict[str, int]] = {"limits": 5}

    kind: Literal["revolute"] = "revolute"
    axis: Line = _Z
    size: Spread = 0.1
    limits: Limits | None = Field(None, description="how far it may turn from the start [rad]")


class PrismaticJoint(JointBase):
    """Sliding along ``axis`` only: five contacts spread over ``size``.

    Attributes
    ----------
    limits : 2 numbers, optional
        How far it may slide from the start [m]: drawn and reported, not enforced.
    """

    limited: ClassVar[dict[str, int]] = {"limits": 2}

    kind: Literal["prismatic"] = "prismatic"
    axis: Line = _Z
    size: Spread = 0.1
    limits: Limits | None = Field(None, description="how far it may slide from the start [m]")


class CylindricalJoint(JointBase):
    """Rotation about and sliding along ``axis``: four contacts.

    Attributes
    ----------
    turn_limits, slide_limits : 2 numbers, optional
        How far it may turn [rad] and slide [m] from the start: drawn and reported, not enforced.
    """

    limited: ClassVar[dict[str, int]] = {"slide_limits": 2, "turn_limits": 5}

    kind: Literal["cylindrical"] = "cylindrical"
    axis: Line = _Z
    size: Spread = 0.1
    turn_limits: Limits | None = Field(None, description="how far it may turn from the start [rad]")
    slide_limits: Limits | None = Field(None, description="how far it may slide from the start [m]")


class UniversalJoint(JointBase):
    """Rotation about the x axis fixed to the object and the y axis fixed to the arm."""

    kind: Literal["universal"] = "universal"
    size: Spread = 0.1


class PlanarJoint(JointBase):
    """Sliding in the plane across ``normal`` and turning about it.

    Attributes
    ----------
    normal : 3 numbers
        Normal of the plane, joint frame.
    """

    kind: Literal["planar"] = "planar"
    normal: Direction = _Z
    size: Spread = 0.1


class PointOnPlaneJoint(JointBase):
    """A fingertip on a flat face of the object.

    Attributes
    ----------
    normal : 3 numbers
        Outward normal of the object's face, joint frame.
    """

    kind: Literal["point_on_plane"] = "point_on_plane"
    normal: Direction = _Z
    tip_radius: TipRadius = 0.0


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
    """

    kind: Literal["point_on_cylinder"] = "point_on_cylinder"
    radius: Positive = Field(description="the radius of the cylinder in metres")
    axis: Direction = _Z
    inside: bool = False
    tip_radius: TipRadius = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        _check_tip_fits(self.inside, self.radius, self.tip_radius, "bore")
        return self


class PointOnSphereJoint(JointBase):
    """A fingertip on (or inside) a sphere about the joint frame's origin.

    Attributes
    ----------
    radius : float
        Radius of the sphere [m].
    inside : bool
        The fingertip is inside a hollow sphere.
    """

    kind: Literal["point_on_sphere"] = "point_on_sphere"
    radius: Positive = Field(description="the radius of the sphere in metres")
    inside: bool = False
    tip_radius: TipRadius = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        _check_tip_fits(self.inside, self.radius, self.tip_radius, "hollow sphere")
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
                    "correct the point or name its face"
                )
        return self


class ContactsJoint(JointBase):
    """Any list of frictionless point contacts.

    A contact is bilateral: it holds the surfaces together. The report says where it pulls, which a
    real one could not.

    Attributes
    ----------
    at, at_tip : Pose
        Frames in which the object's and the arm's geometry are given; by default the object
        frame and the tip's frame themselves.
    contacts : list of ContactSpec
        The contacts, at least one; each is a table {arm: ..., object: ...}. The arm's geometry is
        given in the tip's frame (at_tip), the object's in the object's frame (at), patches too.
    """

    kind: Literal["contacts"] = "contacts"
    at: Pose = Pose()
    contacts: tuple[ContactSpec, ...] = Field(description="a list of {arm: ..., object: ...}")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if not self.contacts:
            raise fault("'contacts' is empty; list at least one contact {arm: ..., object: ...}")
        return self


class WrenchesJoint(JointBase):
    """The joint that transmits given wrenches, and leaves every motion on which they do no work.

    Each wrench is written as the difference of two point contacts (thesis, appendix C).

    Attributes
    ----------
    wrenches : list of 6 numbers each
        Force [N] and moment about the joint frame's origin [N m], joint frame, on the object, for
        one unit of the multiplier.
    carried_by : 'object' or 'arm'
        The body to which the directions are fixed.
    size : float
        Distance [m] of the two contacts that make a couple.
    """

    kind: Literal["wrenches"] = "wrenches"
    wrenches: tuple[Vec6, ...] = Field(description="a list of [fx, fy, fz, mx, my, mz]")
    carried_by: Literal["object", "arm"] = "object"
    size: Positive = 0.1

    @model_validator(mode="after")
    def _independent(self) -> Self:
        if not self.wrenches:
            raise fault("'wrenches' is empty; list at least one [fx, fy, fz, mx, my, mz]")
        found = _dependent_rows(self.wrenches, self.size)
        if found:
            texts = [
                f"wrench {row} is a combination of {_counted(others)}"
                if others
                else f"wrench {row} is zero"
                for row, others in found.items()
            ]
            raise fault(f"{'; '.join(texts)} (counted from 1); remove what adds nothing")
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
    | ContactsJoint
    | WrenchesJoint,
    Field(discriminator="kind"),
]


def _check_tip_fits(inside: bool, radius: float, tip_radius: float, noun: str) -> None:
    if inside and tip_radius >= radius:
        raise fault(
            f"a fingertip of radius {tip_radius:g} m does not fit into a {noun} of radius "
            f"{radius:g} m; make the tip smaller"
        )


def _dependent_rows(
    wrenches: Sequence[Sequence[float]], length: float
) -> dict[int, tuple[int, ...]]:
    """Wrenches, counted from 1, that are combinations of earlier ones, and which these are.

    None of them when the wrench is zero.  Moments count as forces at the lever arm ``length`` [m].
    """
    scaled = np.array(wrenches, dtype=float) / ([1.0] * 3 + [length] * 3)
    sizes = np.max(np.abs(scaled), axis=1)
    found: dict[int, tuple[int, ...]] = {}
    kept: list[int] = []
    for row, size in enumerate(sizes):
        if size == 0.0:
            found[row + 1] = ()
            continue
        own = scaled[row] / size
        basis = (scaled[kept] / sizes[kept, None]).T  # (6, K)
        weights = np.linalg.lstsq(basis, own, rcond=None)[0] if kept else np.zeros(0)
        if np.linalg.norm(own - basis @ weights) > _SPAN_TOLERANCE * np.linalg.norm(own):
            kept.append(row)
            continue
        parts = [k + 1 for k, w in zip(kept, weights, strict=True) if abs(w) > _NAMED_WEIGHT]
        found[row + 1] = tuple(parts)
    return found


def _counted(rows: tuple[int, ...]) -> str:
    *first, last = (str(row) for row in rows)
    return f"wrenches {', '.join(first)} and {last}" if first else f"wrench {last}"
