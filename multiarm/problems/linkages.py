r"""Closed-form motions of linkages with one degree of freedom.

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

from dataclasses import dataclass

import numpy as np

from multiarm.problems.one_freedom import planar

Direction = tuple[complex, complex]


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
    poses = []
    for i in range(cranks):
        poses.append(planar(i * spacing + 0.5 * length * u[0], 0.5 * length * u[1], *u))
    middle = 0.5 * (cranks - 1) * spacing
    one = 1.0 + 0.0 * angle
    poses.append(planar(middle + length * u[0], length * u[1], one, 0.0 * angle))
    return poses


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
