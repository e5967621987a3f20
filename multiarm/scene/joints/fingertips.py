"""Fingertips on the object's faces: spheres, or sharp points, that can only push."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import model_validator
from typing_extensions import Self

from multiarm.geometry import Contact, cylinder, plane, sphere
from multiarm.geometry.records import Surface, basis
from multiarm.scene.faults import invalid
from multiarm.scene.joints.kind import ZERO, Joint, TipRadius, X
from multiarm.scene.values import Direction, NonNegative, Positive, Vec3

_Z = (0.0, 0.0, 1.0)


class PointOnPlaneJoint(Joint):
    """A fingertip on a flat face of the object."""

    picture = "a fingertip on a table: it slides and rolls any way, but stays on the flat face"
    example = """
    normal: [0, 0, 1]        # out of the object's face
    tip_radius: 0.01"""
    drawn_as = "surfaces"

    kind: Literal["point_on_plane"] = "point_on_plane"
    normal: Direction = _Z
    """Outward normal of the object's face, joint frame."""
    tip_radius: TipRadius = 0.0

    def records(self) -> list[Contact]:
        """One fingertip on the plane."""
        return _fingertip(self.tip_radius, plane(ZERO, self.normal))

    def offset(self) -> np.ndarray:
        """The tip's radius, against the normal."""
        return -self.tip_radius * basis(self.normal)[:, 2]


class PointOnCylinderJoint(Joint):
    """A fingertip on a cylindrical face of the object."""

    picture = "a fingertip on a pipe, or within one: it slides along and around it"
    example = """
    radius: 0.05
    axis: [0, 0, 1]
    tip_radius: 0.01"""
    drawn_as = "surfaces"

    kind: Literal["point_on_cylinder"] = "point_on_cylinder"
    radius: Positive
    """Radius of the cylinder [m] about the joint frame's origin."""
    axis: Direction = _Z
    """Axis of the cylinder, joint frame."""
    inside: bool = False
    """The fingertip is inside a bore."""
    tip_radius: TipRadius = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        _check_tip_fits(self.inside, self.radius, self.tip_radius, "bore")
        return self

    def records(self) -> list[Contact]:
        """One fingertip on the cylinder."""
        face = cylinder(ZERO, self.axis, self.radius, self.inside)
        return _fingertip(self.tip_radius, face)

    def offset(self) -> np.ndarray:
        """The distance of the tip's centre from the axis, along -X."""
        return -_distance(self.inside, self.radius, self.tip_radius) * basis(self.axis)[:, 0]


class PointOnSphereJoint(Joint):
    """A fingertip on (or inside) a sphere about the joint frame's origin."""

    picture = "a fingertip on a ball, or in a bowl: it slides anywhere on it"
    example = """
    radius: 0.05
    inside: true             # a bowl
    tip_radius: 0.01"""
    drawn_as = "surfaces"

    kind: Literal["point_on_sphere"] = "point_on_sphere"
    radius: Positive
    """Radius of the sphere [m]."""
    inside: bool = False
    """The fingertip is inside a hollow sphere."""
    tip_radius: TipRadius = 0.0

    @model_validator(mode="after")
    def _tip_fits(self) -> Self:
        _check_tip_fits(self.inside, self.radius, self.tip_radius, "hollow sphere")
        return self

    def records(self) -> list[Contact]:
        """One fingertip on the sphere."""
        return _fingertip(self.tip_radius, sphere(ZERO, self.radius, self.inside))

    def offset(self) -> np.ndarray:
        """The distance of the tip's centre from the sphere's, along -X."""
        return -_distance(self.inside, self.radius, self.tip_radius) * X


class CornerGripperJoint(Joint):
    """Four fingertips on the three faces at a corner of a block (thesis, Example 3.1)."""

    picture = (
        "four fingertips around the corner of a block: it can be pushed and tipped, not pulled off"
    )
    example = """
    tip_radius: 0.01
    at: {xyz: [-0.3, -0.25, 0.2], quaternion_xyzw: [1, 1, 0, 0]}   # the block's corner"""

    kind: Literal["corner_gripper"] = "corner_gripper"
    points: tuple[Vec3, ...] = (
        (0.04, 0.03, 0.0),
        (0.05, 0.0, 0.06),
        (0.09, 0.05, 0.0),
        (0.0, 0.07, 0.05),
    )
    """Contact points [m] on the block. The joint frame is the corner, its axes run along the
    block's edges into the block."""
    faces: tuple[Literal["x", "y", "z"], ...] = ("z", "y", "z", "x")
    """The face each point lies on: the one across that axis."""
    tip_radius: NonNegative = 0.0
    """Radius of the spherical fingertips [m]; 0 are sharp points."""

    @model_validator(mode="after")
    def _points_lie_on_their_faces(self) -> Self:
        if len(self.points) != 4 or len(self.faces) != 4:
            raise invalid(
                f"a corner gripper has 4 points and 4 faces, got {len(self.points)} and "
                f"{len(self.faces)}; other numbers of fingertips are written as 'kind: contacts'"
            )
        sites = zip(self.points, self.faces, strict=True)
        for number, (point, face) in enumerate(sites, start=1):
            if abs(point["xyz".index(face)]) > 1e-9:
                raise invalid(
                    f"point {number}, {list(point)}, is not on face {face!r}, where {face} = 0; "
                    "correct the point or name its face"
                )
        return self

    def records(self) -> list[Contact]:
        """Four fingertips, each on the plane of its face."""
        contacts = []
        for k, (at, face) in enumerate(zip(self.points, self.faces, strict=True)):
            into_block = np.eye(3)["xyz".index(face)]
            tip = sphere(np.array(at) - self.tip_radius * into_block, self.tip_radius)
            name = f"fingertip {k + 1} on face {face}"
            contacts.append(Contact(name, tip, plane(ZERO, -into_block), pushes_only=True))
        return contacts


def _fingertip(radius: float, face: Surface) -> list[Contact]:
    return [Contact("fingertip", sphere(ZERO, radius), face, pushes_only=True)]


def _distance(inside: bool, radius: float, tip_radius: float) -> float:
    return radius + (-tip_radius if inside else tip_radius)


def _check_tip_fits(inside: bool, radius: float, tip_radius: float, noun: str) -> None:
    if inside and tip_radius >= radius:
        raise invalid(
            f"a fingertip of radius {tip_radius:g} m does not fit into a {noun} of radius "
            f"{radius:g} m; make the tip smaller"
        )
