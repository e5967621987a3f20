r"""The motion of a mechanism with one degree of freedom, from its geometry alone.

Where all bodies follow one coordinate s, with centres c_k(s) and orientations R_k(s),

.. math::
    A(s) = \sum_k m_k |c_k'|^2 + \mathrm{tr}(R_k' J_k R_k'^T), \qquad
    V(s) = -\sum_k m_k\, g^T c_k, \qquad
    A\, \ddot s + \tfrac12 A' \dot s^2 + V' = Q - D\, \dot s ,

with the second moments of mass :math:`J = \tfrac12 \mathrm{tr}(I) 1 - I`.  No constraint and no
multiplier appears, so that a position in which the constraints lose rank is no special one.  The
derivatives c' and R' come from complex steps (exact to rounding), A' and V' from a series of A and
V: of Fourier where the coordinate is periodic, else of Chebyshev.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

_STEP = 1e-40


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


Poses = Callable[[complex], Sequence[tuple[np.ndarray, np.ndarray]]]


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
    poses: Poses
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

    def rotations(self, body: int, coordinates: np.ndarray) -> np.ndarray:
        """Rotation matrix of one body at each coordinate, shape (K, 3, 3)."""
        return np.array([np.real(self.poses(complex(s))[body][1]) for s in coordinates])

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
        from numpy.polynomial import chebyshev

        low, high = self.span
        nodes = chebyshev.chebpts1(self.degree + 1)
        at_nodes = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        values = np.array([self.inertia_and_potential(s) for s in at_nodes])
        k = np.arange(self.degree + 1)
        weights = np.where(k == 0, 1.0, 2.0) / (self.degree + 1)
        cosines = np.cos(np.outer(k, np.arccos(nodes)))
        A, V = (weights[:, None] * (cosines @ values)).T
        scale = 2.0 / (high - low)
        slopes = [np.append(chebyshev.chebder(series) * scale, 0.0) for series in (A, V)]
        return np.array([A, *slopes])


def planar(x: complex, y: complex, u: complex, v: complex) -> tuple[np.ndarray, np.ndarray]:
    """Centre (x, y, 0) and rotation of a body whose own x axis points along the unit (u, v)."""
    return np.array([x, y, 0.0 * x]), np.array([[u, -v, 0.0], [v, u, 0.0], [0.0, 0.0, 1.0]])
