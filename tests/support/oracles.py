"""Two surfaces and the normal they share, from nothing but the equations F(p) = 0 of both.

Newton's method solves for a point on each surface and the gap: both points lie on their surfaces,
their difference is the gap times the object's outward normal, and the normals are opposite.  The
Jacobian is taken by complex steps, so that only F and its gradient enter: no curvature, no offset
surface, no closed form of any distance.  A start near the pair makes it follow that pair,
also into penetration and on hollow sides, where it is not the nearest one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from mechanics import body_twist, carried, first_difference, kernel_rows, pose, second_difference
from scipy.spatial.transform import Rotation

from multiarm.geometry.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    SURFACE_ON_OBJECT,
    TORUS,
    Contact,
    Surface,
    smooth,
    torus,
)
from multiarm.geometry.smooth_surfaces import ParametricSurface, SignedDistanceSurface

# How far from a pair of two surfaces the kernel has to begin to look for it [m].
NEAR = 0.01

# --- surfaces as equations -----------------------------------------------------------------------


@dataclass(frozen=True)
class Equation:
    """A surface in its own frame.

    Attributes
    ----------
    implicit : callable
        ``p -> F, gradient (3,)`` for real and complex ``p`` (3,); the solid is where F < 0.
    point : callable
        ``(u, v) -> p`` on the surface, where ``implicit`` vanishes.
    """

    implicit: Callable
    point: Callable


def equation(surface: Surface) -> Equation:
    """What the textbook has for a plane, a quadric or a torus."""
    a, b, c = surface.sizes
    if surface.kind == PLANE:
        return Equation(
            lambda p: (p[2], np.array([0.0, 0.0, 1.0])), lambda u, v: np.array([u, v, 0.0])
        )
    if surface.kind in (SPHERE, ELLIPSOID):
        semi = np.array([a, b, c] if surface.kind == ELLIPSOID else [a, a, a])
        return ellipsoid_equation(semi)
    if surface.kind == CYLINDER:
        return Equation(
            lambda p: (
                (p[0] ** 2 + p[1] ** 2 - a**2) / (2 * a),
                np.array([p[0], p[1], 0.0 * p[2]]) / a,
            ),
            lambda u, v: np.array([a * math.cos(u), a * math.sin(u), v]),
        )
    if surface.kind == CONE:
        return Equation(
            lambda p: (
                (b**2 * (p[0] ** 2 + p[1] ** 2) - a**2 * p[2] ** 2) / 2,
                np.array([b**2 * p[0], b**2 * p[1], -(a**2) * p[2]]),
            ),
            lambda u, v: v * np.array([a * math.cos(u), a * math.sin(u), b]),
        )
    assert surface.kind == TORUS
    return Equation(
        lambda p: _torus(p, a, b),
        lambda u, v: np.array(
            [
                (a + b * math.cos(v)) * math.cos(u),
                (a + b * math.cos(v)) * math.sin(u),
                b * math.sin(v),
            ]
        ),
    )


def ellipsoid_equation(semi: np.ndarray) -> Equation:
    """Sum of (p_i / a_i)^2 = 1."""
    size = float(np.min(semi))
    return Equation(
        lambda p: (size * (np.sum((p / semi) ** 2) - 1) / 2, size * p / semi**2),
        lambda u, v: (
            semi * np.array([math.cos(v) * math.cos(u), math.cos(v) * math.sin(u), math.sin(v)])
        ),
    )


def graph_equation(height: Callable, slope: Callable) -> Equation:
    """The ground below ``z = height(x, y)``; ``slope(x, y)`` are its two derivatives."""
    return Equation(
        lambda p: (
            p[2] - height(p[0], p[1]),
            np.array([*(-np.array(slope(p[0], p[1]))), 1.0 + 0.0 * p[2]]),
        ),
        lambda u, v: np.array([u, v, height(u, v)]),
    )


def _torus(p, circle: float, tube: float):
    g = p[0] ** 2 + p[1] ** 2 + p[2] ** 2 + circle**2 - tube**2
    scale = 8 * circle**2 * tube
    flat = np.array([p[0], p[1], 0.0 * p[2]])
    value = g**2 - 4 * circle**2 * (p[0] ** 2 + p[1] ** 2)
    return value / scale, (4 * g * p - 8 * circle**2 * flat) / scale


@dataclass(frozen=True)
class Side:
    """One body's surface as an equation in the body's frame; ``is_point`` has no normal."""

    surface: Surface
    equation: Equation

    @classmethod
    def of(cls, surface: Surface) -> Side:
        """A plane, quadric or torus."""
        return cls(surface, equation(surface))

    def moved(self, rng) -> Side:
        """The same surface somewhere else on its body."""
        turn = Rotation.random(random_state=rng).as_matrix()
        return replace(self, surface=self.surface.moved(turn, 0.5 * rng.standard_normal(3)))

    @property
    def is_point(self) -> bool:
        return self.surface.kind == SPHERE and self.surface.sizes[0] == 0.0

    def at(self, u: float, v: float) -> np.ndarray:
        """A point of the surface, body's frame (3,)."""
        if self.is_point:
            return self.surface.origin
        return self.surface.origin + self.surface.axes @ self.equation.point(u, v)

    def implicit(self, p: np.ndarray):
        """F and the outward unit normal of the body at a point of the body's frame."""
        axes = self.surface.axes
        value, gradient = self.equation.implicit(axes.T @ (p - self.surface.origin))
        normal = axes @ (gradient / np.sqrt(gradient @ gradient))
        return value, -normal if self.surface.inside else normal


# --- surfaces as a user gives them, with their equations ---------------------------------------


def bowl_side(k: float) -> Side:
    """The ground below the paraboloid z = k (x^2 + y^2), given by its points."""
    equation = graph_equation(lambda x, y: k * (x * x + y * y), lambda x, y: (2 * k * x, 2 * k * y))
    return Side(smooth(ParametricSurface(equation.point, (-2, 2), (-2, 2), length=0.3)), equation)


def waves_side() -> Side:
    """A ground with waves 3 cm high, given by its points."""
    equation = graph_equation(
        lambda x, y: 0.03 * np.sin(4 * x) * np.cos(3 * y),
        lambda x, y: (
            0.12 * np.cos(4 * x) * np.cos(3 * y),
            -0.09 * np.sin(4 * x) * np.sin(3 * y),
        ),
    )
    return Side(smooth(ParametricSurface(equation.point, (-2, 2), (-2, 2), length=0.3)), equation)


def parametric_ellipsoid_side(semi: np.ndarray, inside: bool = False) -> Side:
    """An ellipsoid given by its points, without its poles."""

    def point(u, v):
        return semi * np.array([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)])

    shape = ParametricSurface(point, (-math.pi, math.pi), (-1.4, 1.4), length=0.3)
    return Side(smooth(shape, inside=inside), ellipsoid_equation(semi))


def distance_torus_side(circle: float, tube: float) -> Side:
    """A torus given by its signed distance."""

    def distance(p):
        return np.sqrt((np.sqrt(p[0] ** 2 + p[1] ** 2) - circle) ** 2 + p[2] ** 2) - tube

    return Side(
        smooth(SignedDistanceSurface(distance, length=0.2)),
        equation(torus((0, 0, 0), (0, 0, 1), circle, tube)),
    )


# --- the common normal ---------------------------------------------------------------------------


@dataclass(frozen=True)
class CommonNormal:
    """A pair of facing points: on the arm's surface (tip frame), on the object's (object frame).

    ``gap`` is positive when the bodies are apart; ``into_object`` is in object axes.
    """

    on_arm: np.ndarray
    on_object: np.ndarray
    gap: float
    into_object: np.ndarray


@dataclass(frozen=True)
class Meeting:
    """Two surfaces on two moving bodies, and where the contact is to be looked for first.

    Attributes
    ----------
    arm, object : Side
    X_WT, X_WO : ndarray, shape (4, 4)
        Poses of tip and object at t = 0.
    twist_T, twist_O : ndarray, shape (6,)
        Velocity of the origin [m/s] and angular velocity [rad/s], constant, world axes.
    first : CommonNormal
        A guess at t = 0.
    """

    arm: Side
    object: Side
    X_WT: np.ndarray
    X_WO: np.ndarray
    twist_T: np.ndarray
    twist_O: np.ndarray
    first: CommonNormal

    @property
    def contact(self) -> Contact:
        return Contact("contact", self.arm.surface, self.object.surface)

    def rows(self, t: float = 0.0, contacts: list[Contact] | None = None):
        """What the kernel makes of the contact (or of others in its place) after ``t``."""
        contacts = [self.contact] if contacts is None else contacts
        pair, on_object = self.at(0.0), self.contact.surface_body == SURFACE_ON_OBJECT
        near = np.tile(pair.on_object if on_object else pair.on_arm, (len(contacts), 1))
        return kernel_rows(contacts, *self.poses(t), self.twist_T, self.twist_O, near=near + NEAR)

    def poses(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Both poses after ``t`` without accelerations."""
        return carried(self.X_WT, self.twist_T, t), carried(self.X_WO, self.twist_O, t)

    def at(self, t: float) -> CommonNormal:
        """The common normal after ``t``, followed from the first in small steps."""
        steps, pair = 1 + math.floor(abs(t) / 0.04), self.first
        for k in range(1, steps + 1):
            pair = common_normal(self.arm, self.object, *self.poses(t * k / steps), pair)
        return pair

    def gap(self, t: float) -> float:
        return self.at(t).gap

    def matrices(self, t: float) -> np.ndarray:
        """``[W_m; W_o]`` (12,), each in its own body's axes, about its own origin."""
        X_WT, X_WO = self.poses(t)
        pair = self.at(t)
        on_arm = -X_WT[:3, :3].T @ X_WO[:3, :3] @ pair.into_object
        return np.concatenate(
            [
                on_arm,
                np.cross(pair.on_arm, on_arm),
                pair.into_object,
                np.cross(pair.on_object, pair.into_object),
            ]
        )

    def rates(self, step: float):
        """Gap rate, minus the gap's second derivative, and d/dt [W_m; W_o], by differences."""
        return (
            first_difference(self.gap, step),
            -second_difference(self.gap, 1.5 * step),
            first_difference(self.matrices, step),
        )


def common_normal(
    arm: Side, body: Side, X_WT: np.ndarray, X_WO: np.ndarray, guess: CommonNormal
) -> CommonNormal:
    """Points on both surfaces whose normals are opposite and on one line, by Newton's method.

    The gap is stationary there, so that it is exact even where the points are only nearly so.
    """
    X_OT = np.linalg.inv(X_WO) @ X_WT
    sides = _Facing(arm, body, X_OT[:3, :3], X_OT[:3, 3])
    y = np.concatenate([guess.on_arm, guess.on_object, [guess.gap]])
    for _ in range(60):
        free, residual = sides.equations(y)
        step = np.linalg.solve(_complex_step_jacobian(residual, y[free]), -residual(y[free]))
        y[free] += step
        if np.max(np.abs(step)) < 1e-14:
            break
    free, residual = sides.equations(y)
    worst = float(np.max(np.abs(residual(y[free]))))
    assert worst < 1e-14, f"no common normal found (residual {worst:.1e})"
    facing = sides.normals(y)
    assert facing is None or facing[0] @ facing[1] < 0.0, "the normals do not face each other"
    return CommonNormal(y[:3].copy(), y[3:6].copy(), float(y[6]), sides.into_object(y))


@dataclass(frozen=True)
class _Facing:
    """The equations of a pair in object axes; unknowns: point on arm, point on object, gap."""

    arm: Side
    object: Side
    R: np.ndarray
    x: np.ndarray

    def normals(self, y):
        """Outward normals of arm and object in object axes, or nothing where one is a point."""
        if self.arm.is_point or self.object.is_point:
            return None
        return self.R @ self.arm.implicit(y[:3])[1], self.object.implicit(y[3:6])[1]

    def into_object(self, y):
        if self.object.is_point:
            return self.R @ self.arm.implicit(y[:3])[1]
        return -self.object.implicit(y[3:6])[1]

    def equations(self, y):
        """Which of the unknowns are free, and the equations as a function of those."""
        whole = y.astype(complex)
        if self.arm.is_point:
            free = [3, 4, 5, 6]
        elif self.object.is_point:
            free = [0, 1, 2, 6]
        else:
            free = list(range(7))
        across = None if len(free) < 7 else np.linalg.svd(self.normals(y)[1][None])[2][1:]

        def residual(part):
            z = whole.copy()
            z[free] = part
            values = [self.R @ z[:3] + self.x - z[3:6] + z[6] * self.into_object(z)]
            if not self.arm.is_point:
                values.append([self.arm.implicit(z[:3])[0]])
            if not self.object.is_point:
                values.append([self.object.implicit(z[3:6])[0]])
            if across is not None:
                values.append(across @ _cross(*self.normals(z)))
            values = np.concatenate(values)
            return values if np.iscomplexobj(part) else values.real

        return free, residual


def _cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _complex_step_jacobian(function, y):
    h = 1e-40
    columns = [function(y.astype(complex) + 1j * h * e).imag / h for e in np.eye(y.size)]
    return np.column_stack(columns)


# --- meetings to test with -----------------------------------------------------------------------


def meeting(arm: Side, body: Side, at_arm, at_object, gap: float, rng, speed=0.5) -> Meeting:
    """Bodies in a random pose whose surfaces meet at given coordinates, with random velocities.

    Parameters
    ----------
    at_arm, at_object : pair of floats
        Coordinates (u, v) of the facing points on the two surfaces.
    gap : float
        Distance between them along their normals [m]; negative: penetration.
    """
    p, d = arm.at(*at_arm), body.at(*at_object)
    into_object = -body.implicit(d)[1] if not body.is_point else _unit(rng.standard_normal(3))
    out_of_arm = arm.implicit(p)[1] if not arm.is_point else _unit(rng.standard_normal(3))
    spin = Rotation.from_rotvec(rng.uniform(0, 2 * math.pi) * into_object).as_matrix()
    R = spin @ _rotation_between(out_of_arm, into_object)
    X_OT = pose(R, d - gap * into_object - R @ p)
    X_WO = pose(Rotation.random(random_state=rng).as_matrix(), rng.standard_normal(3))
    first = CommonNormal(p, d, gap, into_object)
    return Meeting(
        arm, body, X_WO @ X_OT, X_WO,
        speed * rng.standard_normal(6), speed * rng.standard_normal(6), first,
    )  # fmt: skip


def swapped(meeting: Meeting) -> Meeting:
    """The same two bodies with the arm's part and the object's exchanged."""
    first, X = meeting.first, np.linalg.inv(meeting.X_WT) @ meeting.X_WO
    return replace(
        meeting,
        arm=meeting.object, object=meeting.arm, X_WT=meeting.X_WO, X_WO=meeting.X_WT,
        twist_T=meeting.twist_O, twist_O=meeting.twist_T,
        first=CommonNormal(
            first.on_object, first.on_arm, first.gap, -X[:3, :3] @ first.into_object
        ),
    )  # fmt: skip


def _rotation_between(a, b):
    """A rotation that takes the unit vector ``a`` to ``b``."""
    axis = np.cross(a, b)
    if np.linalg.norm(axis) < 1e-12:
        axis = np.linalg.svd(a[None])[2][1]
    angle = math.acos(np.clip(a @ b, -1.0, 1.0))
    return Rotation.from_rotvec(angle * _unit(axis)).as_matrix()


def _unit(v):
    return v / np.linalg.norm(v)


# --- claims about a meeting, for tips and for pairs alike ----------------------------------------


def claim_gap_and_normal(met) -> None:
    """Gap, normal and both columns of W are those of the surfaces' equations."""
    rows, pair = met.rows(), met.at(0.0)
    assert rows.phi[0] == pytest.approx(pair.gap, abs=1e-10)
    np.testing.assert_allclose(
        rows.normals[0], met.X_WO[:3, :3] @ pair.into_object, rtol=0, atol=1e-10
    )
    W = np.concatenate([rows.W_m[:, 0], rows.W_o[:, 0]])
    np.testing.assert_allclose(W, met.matrices(0.0), rtol=0, atol=1e-10)


def claim_rates(met, step: float) -> None:
    """Gap rate, c and dW/dt are differences of what the equations give."""
    rows = met.rows()
    phi_dot, c, W_dot = met.rates(step)
    assert rows.phi_dot[0] == pytest.approx(phi_dot, rel=1e-8, abs=1e-9)
    assert rows.c[0] == pytest.approx(c, rel=1e-8, abs=1e-8)
    found = np.concatenate([rows.W_m_dot[:, 0], rows.W_o_dot[:, 0]])
    scale = float(np.max(np.abs(W_dot)))
    np.testing.assert_allclose(found, W_dot, rtol=0, atol=1e-8 * max(1.0, scale))


def claim_power(met) -> None:
    """W_m^T v_m + W_o^T v_o, each in its own axes, is the gap rate (3.26)."""
    rows = met.rows()
    power = rows.W_m.T @ body_twist(met.X_WT, met.twist_T)
    power += rows.W_o.T @ body_twist(met.X_WO, met.twist_O)
    np.testing.assert_allclose(power, rows.phi_dot, rtol=0, atol=1e-12)
