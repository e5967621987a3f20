"""Lower pairs and the universal joint: textbook joints as sets of contacts.

Points sit on the arm, surfaces on the object; both joint frames coincide in the reference position.
``X, Y, Z`` are the joint frame's axes, ``h = size / 2`` (thesis, 3.9.1, with two corrections: the
prismatic joint's second plane needs contacts apart along the slide, the universal joint's plane
must contain the sphere's centre).
"""

from __future__ import annotations

from typing import ClassVar, Literal

from multiarm.geometry import Contact, cylinder, plane, point, sphere
from multiarm.scene.joints.kind import (
    ZERO,
    Joint,
    Limits,
    Line,
    Spread,
    X,
    Y,
    Z,
    turned,
)
from multiarm.scene.values import Direction, Positive

_Z = (0.0, 0.0, 1.0)


class WeldJoint(Joint):
    """No relative motion: six contacts, 3-2-1, spread over ``size``."""

    picture = "glued or clamped: tip and object are one body"
    free = ()

    kind: Literal["weld"] = "weld"
    size: Spread = 0.1

    def records(self) -> list[Contact]:
        """Three contacts on a plane, two on a second, one on a third."""
        h = self.size / 2.0
        points = [(h, 0, 0), (-h, h, 0), (-h, -h, 0), (h, 0, 0), (-h, 0, 0), (0, 0, 0)]
        return _on_planes("weld", points, [Z, Z, Z, Y, Y, X])


class BallJoint(Joint):
    """Free rotation about the joint frame's origin: three contacts at that point."""

    picture = "a trailer hitch: the tip turns every way about one point of the object"
    example = """
    at: {xyz: [0.3, 0, 0]}   # that point, in the object frame"""
    free = (3, 4, 5)
    drawn_as = "ball"

    kind: Literal["ball"] = "ball"
    size: Positive = 0.1
    """Diameter of the ball [m]; nothing depends on it."""

    def records(self) -> list[Contact]:
        """Three planes through the centre, turning with the object.

        A sphere has the same wrenches there; these have them at every relative orientation.
        """
        return _on_planes("ball", [ZERO, ZERO, ZERO], [X, Y, Z])


class RevoluteJoint(Joint):
    """Rotation about ``axis`` only: five contacts spread over ``size``."""

    picture = "a door hinge: the tip turns about one line fixed in the object"
    example = """
    axis: [0, 0, 1]          # that line, in the joint frame
    limits: [-0.5, 1.2]      # from the start; drawn and reported"""
    free = (5,)
    limited: ClassVar[dict[str, int]] = {"limits": 5}
    drawn_as = "axle"

    kind: Literal["revolute"] = "revolute"
    axis: Line = _Z
    size: Spread = 0.1
    limits: Limits | None = None
    """How far it may turn from the start [rad], such as [-1.5, 0]: drawn and reported, not
    enforced."""

    def records(self) -> list[Contact]:
        """Four contacts on a cylinder about the axis, one on its end plane."""
        h = self.size / 2.0
        end = _on_planes("revolute end", [(0, 0, h)], [Z])
        return turned(_on_cylinder("revolute", h) + end, self.axis)


class PrismaticJoint(Joint):
    """Sliding along ``axis`` only: five contacts spread over ``size``."""

    picture = "a drawer: the tip slides along one line of the object and does not turn"
    example = """
    axis: [1, 0, 0]
    limits: [-0.05, 0.20]"""
    free = (2,)
    limited: ClassVar[dict[str, int]] = {"limits": 2}
    drawn_as = "rail"

    kind: Literal["prismatic"] = "prismatic"
    axis: Line = _Z
    size: Spread = 0.1
    limits: Limits | None = None
    """How far it may slide from the start [m]: drawn and reported, not enforced."""

    def records(self) -> list[Contact]:
        """Three contacts on the plane y = 0, two on x = 0."""
        h = self.size / 2.0
        points = [(h, 0, h), (-h, 0, h), (0, 0, -h), (0, 0, h), (0, 0, -h)]
        return turned(_on_planes("prismatic", points, [Y, Y, Y, X, X]), self.axis)


class CylindricalJoint(Joint):
    """Rotation about and sliding along ``axis``: four contacts."""

    picture = "a rod in a sleeve: the tip turns about one line of the object and slides along it"
    example = """
    axis: [0, 0, 1]"""
    free = (2, 5)
    limited: ClassVar[dict[str, int]] = {"slide_limits": 2, "turn_limits": 5}
    drawn_as = "sleeve"

    kind: Literal["cylindrical"] = "cylindrical"
    axis: Line = _Z
    size: Spread = 0.1
    turn_limits: Limits | None = None
    """How far it may turn from the start [rad]: drawn and reported, not enforced."""
    slide_limits: Limits | None = None
    """How far it may slide from the start [m]: drawn and reported, not enforced."""

    def records(self) -> list[Contact]:
        """Four contacts on a cylinder about the axis."""
        return turned(_on_cylinder("cylindrical", self.size / 2.0), self.axis)


class UniversalJoint(Joint):
    """Rotation about the x axis fixed to the object and the y axis fixed to the arm."""

    picture = (
        "the cross of a drive shaft: the tip turns about the object's x and about its own y axis"
    )
    free = (3, 4)
    drawn_as = "cross"

    kind: Literal["universal"] = "universal"
    size: Spread = 0.1

    def records(self) -> list[Contact]:
        """Three contacts on a sphere, one on the plane x = 0."""
        r = self.size / 2.0
        ball = [
            Contact(f"universal {k}", point(r * axis), sphere(ZERO, r))
            for k, axis in enumerate((X, Y, Z))
        ]
        return ball + _on_planes("universal cross", [r * Y], [X])


class PlanarJoint(Joint):
    """Sliding in the plane across ``normal`` and turning about it."""

    picture = (
        "a puck on ice: the tip slides over a flat face and turns on it, but never lifts or tilts"
    )
    example = """
    normal: [0, 0, 1]"""
    free = (0, 1, 5)

    kind: Literal["planar"] = "planar"
    normal: Direction = _Z
    """Normal of the plane, joint frame."""
    size: Spread = 0.1

    def records(self) -> list[Contact]:
        """Three contacts on a plane."""
        h = self.size / 2.0
        points = [(h, 0, 0), (-h, h, 0), (-h, -h, 0)]
        return turned(_on_planes("planar", points, [Z, Z, Z]), self.normal)


def _on_planes(name: str, points: list, normals: list) -> list[Contact]:
    """Points of the arm, each on a plane of the object through that point."""
    return [
        Contact(f"{name} {k + 1}", point(p), plane(p, n))
        for k, (p, n) in enumerate(zip(points, normals, strict=True))
    ]


def _on_cylinder(name: str, r: float) -> list[Contact]:
    points = [(r, 0, r), (0, r, r), (r, 0, -r), (0, r, -r)]
    return [
        Contact(f"{name} {k + 1}", point(p), cylinder(ZERO, Z, r)) for k, p in enumerate(points)
    ]
