r"""Mechanisms with one degree of freedom: the motion from the geometry alone, and linkages.

Where all bodies follow one coordinate s, with centres c_k(s) and orientations R_k(s),

.. math::
    A(s) = \sum_k m_k |c_k'|^2 + \mathrm{tr}(R_k' J_k R_k'^T), \qquad
    V(s) = -\sum_k m_k\, g^T c_k, \qquad
    A\, \ddot s + \tfrac12 A' \dot s^2 + V' = Q - D\, \dot s ,

with the second moments of mass :math:`J = \tfrac12 \mathrm{tr}(I) 1 - I`.  No constraint and no
multiplier appears, so that a position in which the constraints lose rank is no special one.  The
derivatives c' and R' come from complex steps (exact to rounding), A' and V' from a series of A and
V: of Fourier where the coordinate is periodic, else of Chebyshev.

The geometry of linkages is in closed form.

Planar four-bar: crank a at the origin, coupler b, rocker c at (d, 0).  With D the distance from the
crank's tip A to the rocker's pivot P and :math:`\delta` the angle at P between A and the other end
B of the coupler,

.. math:: \sin^2(\delta/2) = \frac{b^2 - (c - D)^2}{4 c D} .

A linkage with :math:`a + d = b + c` can lie flat (crank angle :math:`\pi`).  Two motions cross
there; each is smooth, which the root shows once its zero is taken out of it:

.. math:: \sin(\delta/2) = \cos(\theta/2) \sqrt{\frac{a d\,(b - c + D)}{c D\,(b + c + D)}} ,

of period :math:`4\pi`: the coupler passes from one side to the other at each passage.

Bricard's loop of six perpendicular hinges (R. Bricard, 1897): turns are equal on every second
hinge, and :math:`\cos(\alpha/2) \cos(\beta/2) = 1/2`, one smooth closed curve:

.. math:: \alpha = p + q, \quad \beta = p - q, \quad
    \sin(p/2) = \cos(s)/\sqrt2, \quad \sin(q/2) = \sin(s)/\sqrt2 .
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

_STEP = 1e-40

Direction = tuple[complex, complex]
Placement = tuple[np.ndarray, np.ndarray]
"""Centre of a body, shape (3,) [m], and its rotation matrix, shape (3, 3)."""


@dataclass(frozen=True)
class Body:
    """A rigid body: mass [kg] and inertia (3, 3) about its centre of mass, body axes [kg m^2]."""

    mass: float
    inertia: np.ndarray

    @property
    def second_moments(self) -> np.ndarray:
        """Integral of x x^T dm about the centre of mass, shape (3, 3) [kg m^2]."""
        inertia = np.asarray(self.inertia, dtype=float)
        return 0.5 * np.trace(inertia) * np.eye(3) - inertia


@dataclass(frozen=True)
class OneFreedom:
    """A mechanism that moves along one coordinate.

    Attributes
    ----------
    bodies : sequence of Body
    poses : callable
        Coordinate -> centre (3,) and rotation (3, 3) of every body; complex arithmetic goes
        through it.
    gravity : ndarray, shape (3,)
        [m/s^2]
    span : 2 floats
        The coordinates that are met; the period of ``poses`` if ``periodic``.
    periodic : bool
    degree : int
        Of the series.
    force, damping : callable, optional
        Coordinate -> generalised force Q and damping D.
    """

    bodies: Sequence[Body]
    poses: Callable[[complex], Sequence[Placement]]
    gravity: np.ndarray
    span: tuple[float, float]
    periodic: bool = False
    degree: int = 100
    force: Callable[[float], float] = lambda s: 0.0
    damping: Callable[[float], float] = lambda s: 0.0

    def inertia_and_potential(self, s: float) -> tuple[float, float]:
        """A [kg m^2] and V [J] at a coordinate."""
        inertia, potential = 0.0, 0.0
        for body, (c, R) in zip(self.bodies, self.poses(complex(s, _STEP)), strict=True):
            c_rate, R_rate = np.imag(c) / _STEP, np.imag(R) / _STEP
            inertia += float(body.mass * c_rate @ c_rate)
            inertia += float(np.trace(R_rate @ body.second_moments @ R_rate.T))
            potential -= float(body.mass * self.gravity @ np.real(c))
        return inertia, potential

    def motion(self, start: float, rate: float, times: np.ndarray) -> np.ndarray:
        """Coordinate at the given times, shape (K,), from a start at times[0].

        Solved to about 1e-11 by a stiff method where there is damping.
        """
        from scipy.integrate import solve_ivp

        damped = self.damping(start) != 0.0
        solution = solve_ivp(
            lambda t, y: [y[1], self._acceleration(*y)],
            (times[0], times[-1]),
            [start, rate],
            method="Radau" if damped else "DOP853",
            t_eval=times,
            rtol=1e-11 if damped else 1e-13,
            atol=1e-13,
        )
        return solution.y[0]

    def centres(self, body: int, coordinates: np.ndarray) -> np.ndarray:
        """Centre of one body at each coordinate, shape (K, 3) [m]."""
        return np.array([np.real(self.poses(complex(s))[body][0]) for s in coordinates])

    def series(self, s: float) -> np.ndarray:
        """A, A' and V' at a coordinate, from the series, shape (3,)."""
        low, high = self.span
        if self.periodic:
            waves = np.exp(2j * np.pi * (s - low) / (high - low) * np.arange(self.degree + 1))
            return np.real(self._coefficients @ waves)
        x = (2.0 * s - low - high) / (high - low)
        k = np.arange(self.degree + 1)
        return np.real(self._coefficients @ np.cos(k * np.arccos(np.clip(x, -1.0, 1.0))))

    def _acceleration(self, s: float, rate: float) -> float:
        A, A_s, V_s = self.series(s)
        return (self.force(s) - self.damping(s) * rate - 0.5 * A_s * rate**2 - V_s) / A

    @cached_property
    def _coefficients(self) -> np.ndarray:
        """Coefficients of A, A' and V', shape (3, degree + 1)."""
        return self._fourier() if self.periodic else self._chebyshev()

    def _fourier(self) -> np.ndarray:
        low, high = self.span
        count = 2 * self.degree + 1
        nodes = low + (high - low) * np.arange(count) / count
        values = np.array([self.inertia_and_potential(s) for s in nodes])
        A, V = np.fft.rfft(values, axis=0).T / count
        A[1:] *= 2.0
        V[1:] *= 2.0
        slope = 2j * np.pi / (high - low) * np.arange(self.degree + 1)
        return np.array([A, slope * A, slope * V])

    def _chebyshev(self) -> np.ndarray:
        from numpy.polynomial.chebyshev import chebder, chebfit, chebpts1

        low, high = self.span
        half = 0.5 * (high - low)
        nodes = chebpts1(self.degree + 1)
        values = [self.inertia_and_potential(low + half * (1.0 + x)) for x in nodes]
        series = chebfit(nodes, np.array(values), self.degree)  # shape (degree + 1, 2)
        slopes = np.pad(chebder(series, scl=1.0 / half), ((0, 1), (0, 0)))
        return np.column_stack([series[:, 0], slopes]).T


def planar(x: complex, y: complex, u: complex, v: complex) -> Placement:
    """Centre (x, y, 0) and rotation of a body whose own x axis points along the unit (u, v)."""
    return np.array([x, y, 0.0 * x]), np.array([[u, -v, 0.0], [v, u, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class FourBar:
    """A planar four-bar.

    Attributes
    ----------
    crank, coupler, rocker, ground : float
        Lengths [m].
    flat : bool
        It can lie flat, and passes through.
    side : int
        -1 or 1: the rocker is turned clockwise or counterclockwise from the line to the crank's
        tip (of a flat one: before its first passage).
    """

    crank: float
    coupler: float
    rocker: float
    ground: float
    flat: bool = False
    side: int = -1

    def directions(self, angle: complex) -> tuple[Direction, Direction, Direction]:
        """Unit vectors along crank, coupler and rocker (from its pivot) at a crank angle."""
        a, b, c, d = self.crank, self.coupler, self.rocker, self.ground
        u = (np.cos(angle), np.sin(angle))
        x, y = a * u[0] - d, a * u[1]
        D = np.sqrt(x * x + y * y)
        if self.flat:
            root = np.sqrt(a * d * (b - c + D) / (c * D * (b + c + D)))
            half = np.cos(0.5 * angle) * root
        else:
            half = np.sqrt((b * b - (c - D) ** 2) / (4.0 * c * D))
        cosine = 1.0 - 2.0 * half * half
        sine = self.side * 2.0 * half * np.sqrt(1.0 - half * half)
        w = ((cosine * x - sine * y) / D, (cosine * y + sine * x) / D)
        v = ((d + c * w[0] - a * u[0]) / b, (c * w[1] - a * u[1]) / b)
        return u, v, w

    def angles(self, angle: float) -> tuple[float, float]:
        """Angles of coupler and rocker [rad]."""
        _, v, w = self.directions(complex(angle))
        coupler, rocker = (float(np.arctan2(part[1].real, part[0].real)) for part in (v, w))
        return coupler, rocker

    def poses(self, angle: complex, at_crank: float, at_coupler: float, at_rocker: float):
        """Centres and rotations of crank, coupler and rocker; centres [m] along each link."""
        u, v, w = self.directions(angle)
        a, d = self.crank, self.ground
        return (
            planar(at_crank * u[0], at_crank * u[1], *u),
            planar(a * u[0] + at_coupler * v[0], a * u[1] + at_coupler * v[1], *v),
            planar(d + at_rocker * w[0], at_rocker * w[1], *w),
        )


def parallel_crank_poses(angle: complex, cranks: int, spacing: float, length: float):
    """Poses of parallel cranks, then of the coupler that joins their tips, about its middle."""
    u = np.cos(angle), np.sin(angle)
    middle = 0.5 * (cranks - 1) * spacing
    return [
        *(
            planar(i * spacing + 0.5 * length * u[0], 0.5 * length * u[1], *u)
            for i in range(cranks)
        ),
        planar(middle + length * u[0], length * u[1], 1.0 + 0.0 * angle, 0.0 * angle),
    ]


def bricard_turns(s: complex) -> tuple[complex, complex]:
    """Turns alpha and beta of the hinges on Bricard's curve [rad]; both are pi/2 at s = 0."""
    p = 2.0 * np.arcsin(np.cos(s) / np.sqrt(2.0))
    q = 2.0 * np.arcsin(np.sin(s) / np.sqrt(2.0))
    return p + q, p - q


def bricard_poses(s: complex):
    """Poses of the five moving rods of 1 m, in the order of the loop, x axes along the rods.

    The first hinge is at the origin about y, the last at (0, 0, 1) about x; gravity is along -y in
    the benchmark.
    """
    alpha, beta = bricard_turns(s)
    first = _arm(np.zeros(3), BRICARD_BASES[0], 0.5 * np.pi - alpha, beta)
    last = _arm(np.array([0.0, 0.0, 1.0]), BRICARD_BASES[1], beta - 0.5 * np.pi, -alpha)
    (c_1, R_1), (c_2, R_2) = first
    (c_5, R_5), (c_4, R_4) = last
    begin, end = c_2 + 0.5 * R_2[:, 0], c_4 + 0.5 * R_4[:, 0]
    x = begin - end
    z = R_2[:, 2]
    R_3 = np.stack([x, np.cross(z, x), z], axis=1)
    return (c_1, R_1), (c_2, R_2), (0.5 * (begin + end), R_3), (c_4, R_4), (c_5, R_5)


# Columns: the base frames of the two arms, x along the first rod at the start, z along its hinge.
BRICARD_BASES = (
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
)


def _arm(origin: np.ndarray, base: np.ndarray, first: complex, second: complex):
    """Poses of the rods of a crossed_2r arm of 1 m rods, about their middles."""
    R_1 = base @ _about_z(first)
    R_2 = R_1 @ _about_y(second)
    elbow = origin + R_1[:, 0]
    return (origin + 0.5 * R_1[:, 0], R_1), (elbow + 0.5 * R_2[:, 0], R_2)


def _about_z(angle: complex) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_y(angle: complex) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
