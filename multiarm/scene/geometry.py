"""The two sides of one contact: a fingertip on one body, a surface on the other."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.values import Direction, Positive, Vec3, fault

__all__ = [
    "ContactSpec",
    "CylinderGeometry",
    "Geometry",
    "PlaneGeometry",
    "SphereGeometry",
    "check_tip_fits",
]

_Z = (0.0, 0.0, 1.0)


class SphereGeometry(Spec):
    """A sphere, solid or (``inside``) hollow: centre and radius [m]."""

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive
    inside: bool = False


class PlaneGeometry(Spec):
    """A flat face through ``point`` [m] with the outward ``normal`` of the body that has it."""

    point: Vec3 = (0.0, 0.0, 0.0)
    normal: Direction


class CylinderGeometry(Spec):
    """A cylinder, solid or (``inside``) a bore: a point of its axis, the axis, radius [m]."""

    point: Vec3 = (0.0, 0.0, 0.0)
    axis: Direction = _Z
    radius: Positive
    inside: bool = False


class Geometry(Spec):
    """One body's side of a contact: exactly one of point, sphere, plane and cylinder."""

    point: Vec3 | None = None
    sphere: SphereGeometry | None = None
    plane: PlaneGeometry | None = None
    cylinder: CylinderGeometry | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise fault(
                f"needs exactly one of 'point', 'sphere', 'plane', 'cylinder', got {given or 0}"
            )
        return self

    @property
    def shape(self) -> str:
        """Which one it is: ``point``, ``sphere``, ``plane`` or ``cylinder``."""
        return next(n for n in type(self).model_fields if getattr(self, n) is not None)

    @property
    def value(self) -> Any:
        """The point (3 numbers) or the geometry."""
        return getattr(self, self.shape)

    @property
    def is_tip(self) -> bool:
        """Whether it is a point or a solid sphere, which can touch any surface."""
        return self.point is not None or (self.sphere is not None and not self.sphere.inside)

    @property
    def is_surface(self) -> bool:
        """Whether it is something that a fingertip can slide on."""
        return self.point is None


class ContactSpec(Spec):
    """One frictionless contact: a fingertip on one body, a surface on the other.

    Attributes
    ----------
    arm : Geometry
        The arm's side, in the joint frame at the tip.
    object : Geometry
        The object's side, in the joint frame at the object.
    name : str, optional
        A name for reports.
    """

    arm: Geometry = Field(description="the arm's side of the contact")
    object: Geometry = Field(description="the object's side of the contact")
    name: str | None = None

    @model_validator(mode="after")
    def _a_tip_meets_a_surface(self) -> Self:
        a, b = self.arm, self.object
        if not ((a.is_tip and b.is_surface) or (b.is_tip and a.is_surface)):
            raise fault(
                f"a {a.shape} on the arm and a {b.shape} on the object make no point contact; "
                "give one body a point or a solid sphere and the other a plane, cylinder or sphere"
            )
        for tip, surface in ((a, b), (b, a)):
            radius = tip.sphere.radius if tip.is_tip and tip.sphere is not None else 0.0
            if surface.shape in ("sphere", "cylinder"):
                hollow = surface.value
                check_tip_fits(hollow.inside, hollow.radius, radius, f"hollow {surface.shape}")
        return self


def check_tip_fits(inside: bool, radius: float, tip_radius: float, noun: str) -> None:
    """Refuse a fingertip that is too large for the hollow surface that it is inside of."""
    if inside and tip_radius >= radius:
        raise fault(
            f"a fingertip of radius {tip_radius:g} m does not fit into a {noun} of radius "
            f"{radius:g} m; make the tip smaller"
        )
