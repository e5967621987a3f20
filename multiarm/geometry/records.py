r"""A joint is data: records of frictionless point contacts.

A contact is two surfaces, one on the arm and one on the object, that touch in a point.  A sharp
point is a sphere of radius 0, a fingertip one of positive radius.  Each surface is given in the
frame of the body that carries it: the arm's in the tip frame, the object's in the object frame.
Its normal is the outward normal of its body; a hollow surface (``inside``) is touched from within.

A *row* of W is one contact's normal force.  Two further kinds of row cover every joint:

* *combined rows*: a contact times a factor, or the difference of two contacts times a factor, which
  can be any wrench (thesis, appendix C);
* *tangents*: no slip at a contact along one of two directions of the tangent plane; such a row
  constrains velocities only, it has no position function (nonholonomic; thesis, 3.9.2).

Everything the dynamics need (W, dW/dt, c, phi) follows from the records in one kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

# Kinds of surface.
PLANE, SPHERE, CYLINDER, CONE, TORUS, ELLIPSOID, SMOOTH = range(7)
SURFACE_ON_OBJECT, SURFACE_ON_ARM = 0, 1

Vector = np.ndarray | tuple[float, float, float] | list[float]
Placement = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and translation (3,) [m]."""


class SmoothShape(Protocol):
    """A user-defined smooth surface, in its own frame."""

    def closest(self, point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Signed distance [m], its gradient (3,) and its second derivatives (3, 3) at a point."""
        ...

    def reset(self) -> None:
        """Forget the last contact point."""
        ...


@dataclass(frozen=True)
class Patch:
    """The part of a surface that exists: a box in the frame in which the surface was given.

    Attributes
    ----------
    lower, upper : ndarray, shape (3,)
        Corners of the box [m]; infinite where there is no bound.
    pose : ndarray, shape (4, 4)
        Frame of the box in the body's frame.
    """

    lower: np.ndarray
    upper: np.ndarray
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))

    def excess(self, point: np.ndarray) -> float:
        """Distance of a point (body's frame) outside of the box [m]; negative inside."""
        p = self.pose[:3, :3].T @ (point - self.pose[:3, 3])
        return float(np.max(np.maximum(self.lower - p, p - self.upper)))


@dataclass(frozen=True)
class Surface:
    """A smooth surface in the frame of the body that carries it.

    Attributes
    ----------
    kind : int
        ``PLANE``, ``SPHERE``, ``CYLINDER``, ``CONE``, ``TORUS``, ``ELLIPSOID`` or ``SMOOTH``.
    origin : ndarray, shape (3,)
        A point of the plane or of the cylinder's axis; the cone's apex; the centre [m].
    axes : ndarray, shape (3, 3)
        A rotation whose columns are the surface's own axes.  The third one is the plane's outward
        normal, the axis of cylinder and torus, and the cone's from the apex into its opening.
    sizes : tuple of 3 floats
        Sphere and cylinder: the radius; cone: sine and cosine of the half angle; torus: radius of
        the circle and of the tube; ellipsoid: semi-axes [m].
    inside : bool
        The surface is hollow and touched from inside.
    function : SmoothShape, optional
        Of a ``SMOOTH`` surface.
    patch : Patch, optional
        The part of it that exists.
    """

    kind: int
    origin: np.ndarray
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    sizes: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inside: bool = False
    function: SmoothShape | None = None
    patch: Patch | None = None

    @property
    def is_tip(self) -> bool:
        """Whether it is a point or a solid sphere, which can touch any surface."""
        return self.kind == SPHERE and not self.inside

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Surface:
        """The surface in another frame: ``p -> rotation p + translation``."""
        patch = self.patch
        if patch is not None:
            pose = np.eye(4)
            pose[:3, :3] = rotation @ patch.pose[:3, :3]
            pose[:3, 3] = rotation @ patch.pose[:3, 3] + translation
            patch = replace(patch, pose=pose)
        return replace(
            self,
            origin=rotation @ self.origin + translation,
            axes=rotation @ self.axes,
            patch=patch,
        )


def point(at: Vector) -> Surface:
    """A sharp point."""
    return sphere(at, 0.0)


def sphere(center: Vector, radius: float, inside: bool = False) -> Surface:
    """A sphere; solid, it is a fingertip."""
    return Surface(SPHERE, _array(center), sizes=(float(radius), 0.0, 0.0), inside=inside)


def plane(at: Vector, normal: Vector) -> Surface:
    """A plane through ``at`` with an outward normal."""
    return Surface(PLANE, _array(at), basis(normal))


def cylinder(at: Vector, axis: Vector, radius: float, inside: bool = False) -> Surface:
    """A cylinder about the line through ``at`` along ``axis``."""
    return Surface(CYLINDER, _array(at), basis(axis), (float(radius), 0.0, 0.0), inside)


def cone(apex: Vector, axis: Vector, half_angle: float, inside: bool = False) -> Surface:
    """A cone that opens from its apex along ``axis``; ``half_angle`` [rad]."""
    sizes = (float(np.sin(half_angle)), float(np.cos(half_angle)), 0.0)
    return Surface(CONE, _array(apex), basis(axis), sizes, inside)


def torus(
    center: Vector, axis: Vector, circle: float, tube: float, inside: bool = False
) -> Surface:
    """A torus: a tube about a circle across ``axis``; radii of circle and tube [m]."""
    return Surface(TORUS, _array(center), basis(axis), (float(circle), float(tube), 0.0), inside)


def ellipsoid(center: Vector, axes: np.ndarray, semi_axes: Vector, inside: bool = False) -> Surface:
    """An ellipsoid with semi-axes [m] along the columns of the rotation ``axes`` (3, 3)."""
    a, b, c = (float(size) for size in semi_axes)
    return Surface(ELLIPSOID, _array(center), np.array(axes, dtype=float), (a, b, c), inside)


def smooth(
    function: SmoothShape,
    origin: Vector = (0.0, 0.0, 0.0),
    axes: np.ndarray | None = None,
    inside: bool = False,
) -> Surface:
    """A user-defined surface, computed by ``function`` in its own frame."""
    axes = np.eye(3) if axes is None else np.array(axes, dtype=float)
    return Surface(SMOOTH, _array(origin), axes, inside=inside, function=function)


@dataclass(frozen=True)
class Contact:
    """One row of W: a frictionless, bilateral point contact, or a row derived from contacts.

    Attributes
    ----------
    name : str
        Shown in messages and results.
    arm, object : Surface
        The two surfaces that touch; at most one of them is not convex or flat there.
    tangent : int
        0: the row is the normal force.  1 or 2: no slip along the first or second tangent; an
        earlier row of the joint is the normal force of the same contact.
    weight : float
        Factor of the row.
    minus : Contact, optional
        A contact whose row is subtracted before the factor is applied.
    pushes_only : bool
        The real contact cannot pull; a pulling force is reported.
    mu : float, optional
        Its own coefficient of friction; absent: that of its joint or of the scene.
    parent : str
        Of a tangent: the name of the contact whose tangent it is; empty: the one before it.
    """

    name: str
    arm: Surface
    object: Surface
    tangent: int = 0
    weight: float = 1.0
    minus: Contact | None = None
    pushes_only: bool = False
    mu: float | None = None
    parent: str = ""

    def mapped(
        self, on_arm: Callable[[Surface], Surface], on_object: Callable[[Surface], Surface]
    ) -> Contact:
        """The same contact with a function applied to each surface."""
        minus = None if self.minus is None else self.minus.mapped(on_arm, on_object)
        return replace(self, arm=on_arm(self.arm), object=on_object(self.object), minus=minus)

    def moved_on_bodies(self, first: Placement | None, second: Placement | None) -> Contact:
        """The contact with its geometry in other frames, ``p -> rotation p + translation``.

        Used to store it in the frames of the joints that carry tips; None changes nothing.
        """
        return self.mapped(
            lambda surface: surface if first is None else surface.moved(*first),
            lambda surface: surface if second is None else surface.moved(*second),
        )

    def fault(self) -> str:
        """What is wrong with its fields, in words; empty when nothing is."""
        if not isinstance(self.name, str) or not self.name:
            return f"{self.name!r} as its name, which is no text"
        if self.mu is not None and not (np.isfinite(self.mu) and self.mu >= 0.0):
            return f"mu = {self.mu}; a coefficient of friction is not negative"
        for side in ("arm", "object"):
            surface = getattr(self, side)
            if not isinstance(surface, Surface):
                return f"{surface!r} as its surface on the {side}; make one by plane, sphere, ..."
            numbers = [*surface.origin, *surface.axes.flat, *surface.sizes, self.weight]
            if not np.all(np.isfinite(numbers)):
                return "a number that is not finite or a direction that is zero"
            if surface.kind in (SPHERE, CYLINDER, TORUS, ELLIPSOID) and min(surface.sizes) < 0.0:
                return f"a negative size of its surface on the {side}"
        if self.tangent and self.is_combined:
            return "a weight or a minus, which no row without slip has"
        return "" if self.minus is None else self.minus.fault()

    @property
    def is_combined(self) -> bool:
        """Whether the row is a multiple or a difference of contacts."""
        return self.minus is not None or self.weight != 1.0

    @property
    def surface_body(self) -> int:
        """The body whose surface guides the other's tip; of two surfaces, the object's."""
        on_arm = self.object.is_tip and not self.arm.is_tip
        return SURFACE_ON_ARM if on_arm else SURFACE_ON_OBJECT

    @property
    def guide(self) -> Surface:
        """The surface on ``surface_body``."""
        return self.object if self.surface_body == SURFACE_ON_OBJECT else self.arm

    @property
    def follower(self) -> Surface:
        """The other one: a tip, or the arm's surface in a contact of two surfaces."""
        return self.arm if self.surface_body == SURFACE_ON_OBJECT else self.object


def tangent_rows(records: Sequence[Contact | Any]) -> dict[int, list[int]]:
    """The tangents of contacts: number of a contact's normal row -> numbers of its tangents' rows.

    A contact without tangents is missing; rows that are no contacts have none.  Raises KeyError for
    a tangent whose ``parent`` names none of the rows before it.
    """
    latest: dict[str, int] = {}
    tangents: dict[int, list[int]] = {}
    for k, record in enumerate(records):
        if isinstance(record, Contact) and record.tangent:
            tangents.setdefault(latest[record.parent], []).append(k)
        else:
            latest[record.name] = latest[""] = k
    return tangents


def basis(axis: Vector) -> np.ndarray:
    """Rotation whose third column is along ``axis``; the identity for the z axis."""
    z = _array(axis) / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(z, helper)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])


def _array(vector: Vector) -> np.ndarray:
    return np.array(vector, dtype=float)
