r"""Surfaces of contacts: parameters, checks, and the record that the contact kernel reads.

A surface is one class, ours as well as a user's (:func:`multiarm.register_surface`).  Principal
curvatures are positive where the body bulges and negative in a hollow.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.errors import ModelError
from multiarm.geometry import ParametricSurface, SignedDistanceSurface, records
from multiarm.scene.code import UserFunction
from multiarm.scene.faults import invalid, listed
from multiarm.scene.parameters import summary_of
from multiarm.scene.registry import AnyClass, ByName, Registry, UserSpec, called
from multiarm.scene.spec import OneOf, Spec
from multiarm.scene.values import (
    Direction,
    Number,
    Positive,
    Range,
    RollPitchYaw,
    Vec3,
    Vec4,
    list_of,
    one_orientation,
    rotation_matrix,
)

_Z = (0.0, 0.0, 1.0)
# A funnel is nowhere flat across its lines, but as flat as one likes far from the apex.
_NEARLY_FLAT = 1e-300

Bounds = Annotated[
    tuple[Number | None, Number | None, Number | None],
    list_of("must be a list of 3 numbers (null: no bound)", 3),
]


class PatchSpec(Spec):
    """The part of a surface that exists: a box [m] in the frame in which the surface is given."""

    min: Bounds = (None, None, None)
    """Lower corner of the box [m]; null where there is no bound."""
    max: Bounds = (None, None, None)
    """Upper corner of the box [m]; null where there is no bound."""

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for axis, low, high in zip("xyz", self.min, self.max, strict=True):
            if low is not None and high is not None and not low < high:
                raise invalid(f"along {axis} 'min' {low:g} must be less than 'max' {high:g}")
        return self

    def record(self) -> records.Patch:
        """The patch as guards read it."""
        lower = [-np.inf if bound is None else bound for bound in self.min]
        upper = [np.inf if bound is None else bound for bound in self.max]
        return records.Patch(np.array(lower), np.array(upper))


class Surface(UserSpec):
    """Base class of surfaces; define ``name``, fields and :meth:`Surface.record`.

    Attributes
    ----------
    name : str
        Key of the surface in scenes.
    picture : str
        An everyday example, for ``multiarm joints``.
    example : str
        One side of a contact in YAML.
    size : str
        What decides whether it fits, for messages, such as ``" of radius {radius:g} m"``.
    """

    class_sort: ClassVar[str] = "surface"
    name: ClassVar[str] = ""
    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""
    size: ClassVar[str] = ""

    patch: PatchSpec | None = Field(None, description="the part of it that exists: a box")

    def record(self) -> records.Surface:
        """The whole surface in the joint frame, made by a function of :mod:`multiarm.geometry`."""
        raise NotImplementedError

    def curvatures(self) -> tuple[float, float] | None:
        """Principal curvatures [1/m], the larger first, where it is easiest to touch.

        None where they are not known: whether it can touch another surface is then not checked.
        """
        return None

    @property
    def is_hollow(self) -> bool:
        """Whether it is the surface of a cavity, touched from within."""
        return bool(getattr(self, "inside", False))

    def described(self) -> str:
        """The surface in messages, such as ``a hollow sphere of radius 0.1 m``."""
        noun = f"hollow {self.name}" if self.is_hollow else self.name
        article = "an" if noun[0] in "aeiou" else "a"
        return f"{article} {noun}{self.size.format(**dict(self))}"

    @classmethod
    def definition_fault(cls) -> str:
        """Why the class cannot be a surface; empty when it can."""
        if not isinstance(cls.name, str) or not cls.name.isidentifier():
            return f"'name' must be a word that a scene can have as a key, it is {cls.name!r}"
        if cls.record is Surface.record:
            return "it does not define 'record'"
        return cls.field_fault()


class _Turned(Surface):
    """A surface with its own axes."""

    rpy: RollPitchYaw = (0.0, 0.0, 0.0)
    """Turn of its axes: roll, pitch, yaw [rad] about fixed axes."""
    quaternion_xyzw: Vec4 | None = None
    """The same as a quaternion, instead of ``rpy``."""

    _one_orientation = model_validator(mode="after")(one_orientation)

    def axes(self) -> np.ndarray:
        """Its axes, the columns of a rotation, shape (3, 3)."""
        return rotation_matrix(self.rpy, self.quaternion_xyzw)


class PointGeometry(Surface):
    """A sharp point, which a scene writes as 3 numbers [m]."""

    name = "point"
    picture = "a needle's tip: it touches any surface of the other body"
    example = "arm: {point: [0, 0, 0.1]}"

    at: Vec3

    def record(self) -> records.Surface:
        return records.point(self.at)

    def curvatures(self) -> tuple[float, float]:
        return math.inf, math.inf


class SphereGeometry(Surface):
    """A sphere, solid or (``inside``) hollow."""

    name = "sphere"
    size = " of radius {radius:g} m"
    picture = "a fingertip or a ball; inside: a socket or a bowl"
    example = "object: {sphere: {center: [0, 0, 0], radius: 0.05, inside: true}}"

    center: Vec3 = (0.0, 0.0, 0.0)
    """Its centre [m]."""
    radius: Positive
    """Its radius [m]."""
    inside: bool = False
    """The sphere is hollow, touched from within."""

    def record(self) -> records.Surface:
        return records.sphere(self.center, self.radius, self.inside)

    def curvatures(self) -> tuple[float, float]:
        bend = (-1.0 if self.inside else 1.0) / self.radius
        return bend, bend


class PlaneGeometry(Surface):
    """A flat face."""

    name = "plane"
    picture = "a table top; here with its edges, a patch"
    example = (
        "object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1], "
        "patch: {min: [-0.3, -0.2, null], max: [0.3, 0.2, null]}}}"
    )

    point: Vec3 = (0.0, 0.0, 0.0)
    """A point of it [m]."""
    normal: Direction
    """Direction out of the body that has the face."""

    def record(self) -> records.Surface:
        return records.plane(self.point, self.normal)

    def curvatures(self) -> tuple[float, float]:
        return 0.0, 0.0


class CylinderGeometry(Surface):
    """A cylinder, solid or (``inside``) a bore."""

    name = "cylinder"
    size = " of radius {radius:g} m"
    picture = "a pipe or a rail; inside: a bore"
    example = "object: {cylinder: {point: [0, 0, 0], axis: [0, 0, 1], radius: 0.05}}"

    point: Vec3 = (0.0, 0.0, 0.0)
    """A point of its axis [m]."""
    axis: Direction = _Z
    """Direction of the axis."""
    radius: Positive
    """Its radius [m]."""
    inside: bool = False
    """The cylinder is a bore, touched from within."""

    def record(self) -> records.Surface:
        return records.cylinder(self.point, self.axis, self.radius, self.inside)

    def curvatures(self) -> tuple[float, float]:
        bend = (-1.0 if self.inside else 1.0) / self.radius
        return max(0.0, bend), min(0.0, bend)


class ConeGeometry(Surface):
    """A cone, solid or (``inside``) a funnel."""

    name = "cone"
    picture = "a sharpened pencil; inside: a funnel"
    example = "object: {cone: {apex: [0, 0, 0], axis: [0, 0, 1], half_angle: 0.6, inside: true}}"

    apex: Vec3 = (0.0, 0.0, 0.0)
    """Its point [m]."""
    axis: Direction = _Z
    """From the apex into the opening."""
    half_angle: Positive
    """Between axis and face [rad], less than a quarter turn."""
    inside: bool = False
    """The cone is a funnel, touched from within."""

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.half_angle >= math.pi / 2:
            raise invalid(
                f"'half_angle' lies between 0 and pi / 2 rad, got {self.half_angle:g}; a flat face "
                f"is a 'plane', and {self.half_angle:g} degrees are "
                f"{math.radians(self.half_angle):.6g} rad"
            )
        return self

    def record(self) -> records.Surface:
        return records.cone(self.apex, self.axis, self.half_angle, self.inside)

    def curvatures(self) -> tuple[float, float]:
        return (0.0, -_NEARLY_FLAT) if self.inside else (math.inf, 0.0)


class TorusGeometry(Surface):
    """A tube about a circle."""

    name = "torus"
    size = " with a tube of radius {tube_radius:g} m"
    picture = "a ring or a doughnut; inside: a curved tube"
    example = (
        "object: {torus: {center: [0, 0, 0], axis: [0, 0, 1], circle_radius: 0.1, "
        "tube_radius: 0.02}}"
    )

    center: Vec3 = (0.0, 0.0, 0.0)
    """The circle's centre [m]."""
    axis: Direction = _Z
    """Direction across the circle's plane."""
    circle_radius: Positive
    """Radius of the circle [m]."""
    tube_radius: Positive
    """Radius of the tube [m]; the smaller one, so that the torus has a hole."""
    inside: bool = False
    """The tube is hollow, touched from within."""

    @model_validator(mode="after")
    def _has_a_hole(self) -> Self:
        if self.tube_radius >= self.circle_radius:
            raise invalid(
                f"a tube of radius {self.tube_radius:g} m about a circle of radius "
                f"{self.circle_radius:g} m closes itself; 'tube_radius' must be the smaller one"
            )
        return self

    def record(self) -> records.Surface:
        return records.torus(
            self.center, self.axis, self.circle_radius, self.tube_radius, self.inside
        )

    def curvatures(self) -> tuple[float, float]:
        circle, tube = self.circle_radius, self.tube_radius
        if self.inside:  # at the equator near the axis
            return 1.0 / (circle - tube), -1.0 / tube
        return 1.0 / tube, 1.0 / (circle + tube)


class EllipsoidGeometry(_Turned):
    """An ellipsoid."""

    name = "ellipsoid"
    picture = "an egg or a melon; inside: a dish"
    example = "object: {ellipsoid: {center: [0, 0, 0], semi_axes: [0.1, 0.07, 0.05]}}"

    center: Vec3 = (0.0, 0.0, 0.0)
    """Its centre [m]."""
    semi_axes: tuple[Positive, Positive, Positive]
    """Half its lengths [m] along its own x, y and z axes."""
    inside: bool = False
    """The ellipsoid is hollow, touched from within."""

    def record(self) -> records.Surface:
        return records.ellipsoid(self.center, self.axes(), self.semi_axes, self.inside)

    def curvatures(self) -> tuple[float, float]:
        short, middle, long = sorted(self.semi_axes)
        if self.inside:  # at the end of the short axis
            return -short / long**2, -short / middle**2
        return long / short**2, long / middle**2


class SurfaceGeometry(_Turned):
    """A smooth surface as Python functions: a signed distance or a parametrisation."""

    name = "surface"
    picture = (
        "any smooth shape of your own, a Python function: its signed distance or its "
        "parametrisation"
    )
    example = 'object: {surface: {distance: "shapes.py:bump"}}'

    distance: UserFunction | None = None
    """Signed distance of a point p (3,) from the surface, positive outside of the body."""
    gradient: UserFunction | None = None
    """First derivatives of the distance, g(p) -> (3,); by differences where absent."""
    hessian: UserFunction | None = None
    """Second derivatives of the distance [1/m], h(p) -> (3, 3); by differences where absent."""
    parametrisation: UserFunction | None = None
    """The alternative: points of the surface [m]. dx/du x dx/dv points out of the body."""
    derivatives: UserFunction | None = None
    """d(u, v) -> (5, 3): rows x_u, x_v, x_uu, x_uv, x_vv; by differences where absent."""
    u: Range | None = None
    """Range of the first parameter. One that closes (a full turn) is recognised."""
    v: Range | None = None
    """Range of the second parameter. One that closes (a full turn) is recognised."""
    flip: bool = False
    """dx/du x dx/dv points into the body."""
    length: Positive = 0.1
    """Scale [m] on which the surface bends; steps of differences are a fraction of it."""
    origin: Vec3 = (0.0, 0.0, 0.0)
    """Origin [m] of the frame of the functions, turned by rpy or quaternion."""
    inside: bool = False
    """The surface is that of a cavity, touched from within."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.distance is None) == (self.parametrisation is None):
            got = "neither" if self.distance is None else "both"
            raise invalid(f"needs either 'distance' or 'parametrisation', got {got}")
        used = "parametrisation" if self.distance is None else "distance"
        of_the_other = {
            "distance": ("derivatives", "u", "v", "flip"),
            "parametrisation": ("gradient", "hessian"),
        }
        wrong = [name for name in of_the_other[used] if getattr(self, name)]
        if wrong:
            raise invalid(f"{listed(wrong)} cannot be given with {used!r}; remove it")
        if used == "parametrisation" and (self.u is None or self.v is None):
            raise invalid("a parametrisation needs the ranges 'u' and 'v', such as 'u: [-1, 1]'")
        return self

    def record(self) -> records.Surface:
        shape: SignedDistanceSurface | ParametricSurface
        if self.distance is not None:
            shape = SignedDistanceSurface(self.distance, self.gradient, self.hessian, self.length)
        else:
            assert self.parametrisation and self.u and self.v, "checked above"
            shape = ParametricSurface(
                self.parametrisation, self.u, self.v, self.derivatives, self.flip, self.length
            )
        return records.smooth(shape, self.origin, self.axes(), self.inside)


# --- one side of a contact ------------------------------------------------------------------------

_OURS: tuple[type[Surface], ...] = (
    PointGeometry,
    SphereGeometry,
    PlaneGeometry,
    CylinderGeometry,
    ConeGeometry,
    TorusGeometry,
    EllipsoidGeometry,
    SurfaceGeometry,
)
BUILT_IN = {surface.name: surface for surface in _OURS}
"""Our surfaces by name."""
SURFACES: Registry[Surface] = Registry("surface", "surface", "surfaces", BUILT_IN)
"""User surfaces."""


def register_surface(surface: AnyClass) -> AnyClass:
    """Let contacts of scenes name a user surface, a subclass of :class:`multiarm.Surface`.

    Also a decorator.  Defined and registered once more, it replaces the former one.

    Raises
    ------
    ModelError
        The class cannot be used, or another surface has its name.
    """
    return SURFACES.add(surface)


class _Geometry(OneOf, ByName):
    """One body's side of a contact: exactly one of the attributes, or a user surface."""

    registry: ClassVar[Registry] = SURFACES

    point: Vec3 | None = None
    """A sharp point [m]."""

    @property
    def shape(self) -> str:
        """Which one it is, such as ``plane``."""
        return next(name for name, value in self if value is not None)

    @property
    def value(self) -> Surface | None:
        """The surface; None if it is a user's whose class is not loaded."""
        surface = dict(self)[self.shape]
        if self.point is not None:
            surface = PointGeometry(at=self.point)
        return surface if isinstance(surface, Surface) else None

    def record(self) -> records.Surface:
        """The part of the surface that exists, in the joint frame."""
        surface = self.value
        assert surface is not None, "compilation loads all classes"
        who = f"surface {self.shape!r}: record()"
        record = called(surface.record, who)
        if not isinstance(record, records.Surface):
            raise ModelError(
                f"{who} returned {type(record).__name__}; return a surface of multiarm.geometry, "
                "such as sphere(...)"
            )
        return record if surface.patch is None else replace(record, patch=surface.patch.record())


if TYPE_CHECKING:

    class Geometry(_Geometry):
        """One body's side of a contact, with a key for each surface."""

else:
    Geometry = _Geometry.with_keys(
        "Geometry",
        {
            name: (surface, summary_of(surface))
            for name, surface in BUILT_IN.items()
            if name != "point"
        },
    )
