r"""One contact of two bodies, and whether their surfaces can touch in a single point at all.

Two surfaces that touch share a tangent plane. They touch in that point only, and their common
normal moves smoothly with the bodies, when the sum of their curvatures is positive in every
direction of the plane (a curvature is positive where the body bulges, negative in a hollow). With
principal curvatures :math:`a_1 \ge a_2` and :math:`b_1 \ge b_2` there is a way of turning the two
such that this holds exactly if

.. math:: a_1 + b_2 > 0 \quad\text{and}\quad a_2 + b_1 > 0 .

So a plane meets no cylinder, a bore no cylinder, and a fingertip no narrower bore, but a ring fits
into a bore that is wider than its tube.
"""

from __future__ import annotations

import math
from pathlib import Path

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.geometry import Geometry
from multiarm.scene.values import fault

__all__ = ["ContactSpec", "check_tip_fits"]

# A funnel is nowhere flat across its lines, but as flat as one likes far from the apex.
_NEARLY_FLAT = 1e-300


class ContactSpec(Spec):
    """One frictionless contact: a surface of the arm and one of the object that touch.

    Attributes
    ----------
    arm : Geometry
        The arm's side, in the joint frame at the tip.
    object : Geometry
        The object's side, in the joint frame at the object.
    rolling : bool
        The surfaces do not slip where they touch: two rows more, for the velocities.
    name : str, optional
        A name for reports.
    """

    arm: Geometry = Field(description="the arm's side of the contact")
    object: Geometry = Field(description="the object's side of the contact")
    rolling: bool = False
    name: str | None = None

    @model_validator(mode="after")
    def _touch_in_a_point(self) -> Self:
        a, b = self.arm, self.object
        reason = _obstacle(a, b)
        if reason is not None:
            raise fault(
                f"{_named(a)} on the arm and {_named(b)} on the object make no point contact: "
                f"{reason}"
            )
        return self

    def located(self, folder: Path) -> Self:
        """Return this contact with file paths made absolute, relative ones below ``folder``."""
        sides = {"arm": self.arm.located(folder), "object": self.object.located(folder)}
        return self.model_copy(update=sides)


def check_tip_fits(inside: bool, radius: float, tip_radius: float, noun: str) -> None:
    """Refuse a fingertip that is too large for the hollow surface that it is inside of."""
    if inside and tip_radius >= radius:
        raise fault(
            f"a fingertip of radius {tip_radius:g} m does not fit into a {noun} of radius "
            f"{radius:g} m; make the tip smaller"
        )


def _obstacle(a: Geometry, b: Geometry) -> str | None:
    """Why two geometries cannot touch in a point, and what can be done; None when they can."""
    if a.shape == b.shape == "point":
        return "two points have no normal; give one body a surface"
    if a.is_hollow and b.is_hollow:
        return "both are touched from within; leave out 'inside' on one body"
    if "surface" in (a.shape, b.shape):
        return None
    (a_1, a_2), (b_1, b_2) = _curvatures(a), _curvatures(b)
    if a_1 + b_2 > 0.0 and a_2 + b_1 > 0.0:
        return None
    if a.is_hollow or b.is_hollow:
        inner = b if a.is_hollow else a
        if inner.shape in ("plane", "cylinder", "cone"):
            return f"a {inner.shape} is straight and cannot touch a hollow from within"
        return "it does not fit; make the inner surface smaller or the hollow one larger"
    return "they touch along a line or a face; use a sphere, a torus or an ellipsoid on one body"


def _curvatures(geometry: Geometry) -> tuple[float, float]:
    """Principal curvatures [1/m], the larger first, where the geometry is easiest to touch."""
    g, side = geometry.value, -1.0 if geometry.is_hollow else 1.0
    if geometry.shape == "point":
        return math.inf, math.inf
    if geometry.shape == "plane":
        return 0.0, 0.0
    if geometry.shape == "sphere":
        return side / g.radius, side / g.radius
    if geometry.shape == "cylinder":
        return max(0.0, side / g.radius), min(0.0, side / g.radius)
    if geometry.shape == "cone":
        return (0.0, -_NEARLY_FLAT) if geometry.is_hollow else (math.inf, 0.0)
    if geometry.shape == "torus":
        circle, tube = g.circle_radius, g.tube_radius
        if geometry.is_hollow:  # at the equator near the axis
            return 1.0 / (circle - tube), -1.0 / tube
        return 1.0 / tube, 1.0 / (circle + tube)
    short, middle, long = sorted(g.semi_axes)
    if geometry.is_hollow:  # at the end of the short axis
        return -short / long**2, -short / middle**2
    return long / short**2, long / middle**2


def _named(geometry: Geometry) -> str:
    """What a geometry is called: with its radius where that decides."""
    noun = f"hollow {geometry.shape}" if geometry.is_hollow else geometry.shape
    article = "an" if noun[0] in "aeiou" else "a"
    if geometry.shape in ("sphere", "cylinder"):
        return f"{article} {noun} of radius {geometry.value.radius:g} m"
    if geometry.shape == "torus":
        return f"{article} {noun} with a tube of radius {geometry.value.tube_radius:g} m"
    return f"{article} {noun}"
