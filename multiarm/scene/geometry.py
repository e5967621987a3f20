r"""Contacts as they are written: the surfaces of both bodies, and whether they touch in a point.

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
from typing import Annotated, Any

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene.faults import fault, listed
from multiarm.scene.functions import UserFunction
from multiarm.scene.values import (
    Direction,
    Number,
    OneOf,
    Pose,
    Positive,
    Range,
    Spec,
    Vec3,
    Vec4,
    list_of,
)

_Z = (0.0, 0.0, 1.0)
# A funnel is nowhere flat across its lines, but as flat as one likes far from the apex.
_NEARLY_FLAT = 1e-300


Bounds = Annotated[
    tuple[Number | None, Number | None, Number | None],
    list_of("must be a list of 3 numbers (null: no bound)", 3),
]


class PatchSpec(Spec):
    """The part of a surface that exists: a box [m] in the frame in which the surface is given.

    Attributes
    ----------
    min, max : 3 numbers or null each
        Corners of the box; null where there is no bound.
    """

    min: Bounds = (None, None, None)
    max: Bounds = (None, None, None)

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for axis, low, high in zip("xyz", self.min, self.max, strict=True):
            if low is not None and high is not None and not low < high:
                raise fault(f"along {axis} 'min' {low:g} must be less than 'max' {high:g}")
        return self


class _SurfaceSpec(Spec):
    """Keys of all surfaces."""

    patch: PatchSpec | None = Field(None, description="the part of it that exists: a box")


class _Turned(_SurfaceSpec):
    """A surface with its own axes.

    Attributes
    ----------
    rpy : 3 numbers
        Turn of its axes: roll, pitch, yaw [rad] about fixed axes.
    quaternion_xyzw : 4 numbers, optional
        The same as a quaternion, instead of ``rpy``.
    """

    rpy: Vec3 = (0.0, 0.0, 0.0)
    quaternion_xyzw: Vec4 | None = None

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        try:
            self.orientation()
        except SceneError as error:
            raise fault(error.faults[0].partition(": ")[2]) from None
        return self

    def orientation(self) -> Pose:
        """The turn of its axes, as a pose without translation."""
        return Pose(rpy=self.rpy, quaternion_xyzw=self.quaternion_xyzw)


class SphereGeometry(_SurfaceSpec):
    """A sphere, solid or (``inside``) hollow.

    Attributes
    ----------
    center : 3 numbers
        Its centre [m].
    radius : float
        Its radius [m].
    inside : bool
        The sphere is hollow, touched from within.
    """

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive
    inside: bool = False


class PlaneGeometry(_SurfaceSpec):
    """A flat face.

    Attributes
    ----------
    point : 3 numbers
        A point of it [m].
    normal : 3 numbers
        Direction out of the body that has the face.
    """

    point: Vec3 = (0.0, 0.0, 0.0)
    normal: Direction


class CylinderGeometry(_SurfaceSpec):
    """A cylinder, solid or (``inside``) a bore.

    Attributes
    ----------
    point : 3 numbers
        A point of its axis [m].
    axis : 3 numbers
        Direction of the axis.
    radius : float
        Its radius [m].
    inside : bool
        The cylinder is a bore, touched from within.
    """

    point: Vec3 = (0.0, 0.0, 0.0)
    axis: Direction = _Z
    radius: Positive
    inside: bool = False


class ConeGeometry(_SurfaceSpec):
    """A cone, solid or (``inside``) a funnel.

    Attributes
    ----------
    apex : 3 numbers
        Its point [m].
    axis : 3 numbers
        From the apex into the opening.
    half_angle : float
        Between axis and face [rad], less than a quarter turn.
    inside : bool
        The cone is a funnel, touched from within.
    """

    apex: Vec3 = (0.0, 0.0, 0.0)
    axis: Direction = _Z
    half_angle: Positive
    inside: bool = False

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.half_angle >= math.pi / 2:
            raise fault(
                f"'half_angle' lies between 0 and pi / 2 rad, got {self.half_angle:g}; a flat face "
                "is a 'plane'"
            )
        return self


class TorusGeometry(_SurfaceSpec):
    """A tube about a circle.

    Attributes
    ----------
    center : 3 numbers
        The circle's centre [m].
    axis : 3 numbers
        Direction across the circle's plane.
    circle_radius : float
        Radius of the circle [m].
    tube_radius : float
        Radius of the tube [m]; the smaller one, so that the torus has a hole.
    inside : bool
        The tube is hollow, touched from within.
    """

    center: Vec3 = (0.0, 0.0, 0.0)
    axis: Direction = _Z
    circle_radius: Positive
    tube_radius: Positive
    inside: bool = False

    @model_validator(mode="after")
    def _has_a_hole(self) -> Self:
        if self.tube_radius >= self.circle_radius:
            raise fault(
                f"a tube of radius {self.tube_radius:g} m about a circle of radius "
                f"{self.circle_radius:g} m closes itself; 'tube_radius' must be the smaller one"
            )
        return self


class EllipsoidGeometry(_Turned):
    """An ellipsoid.

    Attributes
    ----------
    center : 3 numbers
        Its centre [m].
    semi_axes : 3 numbers
        Half its lengths [m] along its own x, y and z axes.
    inside : bool
        The ellipsoid is hollow, touched from within.
    """

    center: Vec3 = (0.0, 0.0, 0.0)
    semi_axes: tuple[Positive, Positive, Positive]
    inside: bool = False


class SurfaceGeometry(_Turned):
    """A smooth surface as Python functions: a signed distance or a parametrisation.

    Attributes
    ----------
    distance : function, f(p) -> [m]
        Signed distance of a point p (3,) from the surface, positive outside of the body.
    gradient, hessian : function, optional
        Its derivatives g(p) -> (3,), h(p) -> (3, 3); by differences where absent.
    parametrisation : function, x(u, v) -> (3,)
        The alternative: points of the surface [m]. dx/du x dx/dv points out of the body.
    derivatives : function, optional
        d(u, v) -> (5, 3): rows x_u, x_v, x_uu, x_uv, x_vv; by differences where absent.
    u, v : 2 numbers
        Ranges of the parameters. One that closes (a full turn) is recognised.
    flip : bool
        dx/du x dx/dv points into the body.
    length : float
        Scale [m] on which the surface bends; steps of differences are a fraction of it.
    origin : 3 numbers
        Origin [m] of the frame of the functions, turned by rpy or quaternion.
    inside : bool
        The surface is that of a cavity, touched from within.
    """

    distance: UserFunction | None = None
    gradient: UserFunction | None = None
    hessian: UserFunction | None = None
    parametrisation: UserFunction | None = None
    derivatives: UserFunction | None = None
    u: Range | None = None
    v: Range | None = None
    flip: bool = False
    length: Positive = 0.1
    origin: Vec3 = (0.0, 0.0, 0.0)
    inside: bool = False

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.distance is None) == (self.parametrisation is None):
            given = "neither" if self.distance is None else "both"
            raise fault(f"needs either 'distance' or 'parametrisation', got {given}")
        used = "parametrisation" if self.distance is None else "distance"
        of_the_other = {
            "distance": ("derivatives", "u", "v", "flip"),
            "parametrisation": ("gradient", "hessian"),
        }
        wrong = [name for name in of_the_other[used] if getattr(self, name)]
        if wrong:
            raise fault(f"{listed(wrong)} cannot be given with {used!r}; remove it")
        if used == "parametrisation" and (self.u is None or self.v is None):
            raise fault("a parametrisation needs the ranges 'u' and 'v', such as 'u: [-1, 1]'")
        return self


class Geometry(OneOf):
    """One body's side of a contact: exactly one of the attributes.

    Attributes
    ----------
    point : 3 numbers
        A sharp point [m].
    sphere, plane, cylinder, cone, torus, ellipsoid
        A surface of that form.
    surface
        A smooth surface as Python functions.
    """

    point: Vec3 | None = None
    sphere: SphereGeometry | None = None
    plane: PlaneGeometry | None = None
    cylinder: CylinderGeometry | None = None
    cone: ConeGeometry | None = None
    torus: TorusGeometry | None = None
    ellipsoid: EllipsoidGeometry | None = None
    surface: SurfaceGeometry | None = None

    @property
    def shape(self) -> str:
        """Which one it is, such as ``plane``."""
        return next(n for n in type(self).model_fields if getattr(self, n) is not None)

    @property
    def value(self) -> Any:
        """The point (3 numbers) or the surface."""
        return getattr(self, self.shape)

    @property
    def is_hollow(self) -> bool:
        """Whether it is the surface of a cavity, touched from within."""
        return self.point is None and getattr(self.value, "inside", False)


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


def _obstacle(a: Geometry, b: Geometry) -> str | None:
    """Why two geometries cannot touch in a point, with the remedy; None when they can."""
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
    """The name of a geometry in messages: with its radius where that decides."""
    noun = f"hollow {geometry.shape}" if geometry.is_hollow else geometry.shape
    article = "an" if noun[0] in "aeiou" else "a"
    if geometry.shape in ("sphere", "cylinder"):
        return f"{article} {noun} of radius {geometry.value.radius:g} m"
    if geometry.shape == "torus":
        return f"{article} {noun} with a tube of radius {geometry.value.tube_radius:g} m"
    return f"{article} {noun}"
