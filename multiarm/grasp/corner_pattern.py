r"""Three fingertips at a corner, a fourth next to one of them, and where the fourth may be.

Faces 1 (front), 2 (side) and 3 (top) meet at a corner.  The frame :math:`\Sigma_0` has its z axis
along the outward normal of the top, its y axis along the edge between top and front, and its origin
where the design wants it.  The outward normals are :math:`n_1 = R_1 \hat x`,
:math:`n_2 = R_2 \hat y`, :math:`n_3 = \hat z` with

.. math::
    R_1 = \begin{bmatrix} c_\theta & 0 & -s_\theta \\ 0 & 1 & 0 \\ s_\theta & 0 & c_\theta
    \end{bmatrix}, \qquad R_2 = R_z(-\beta) R_x(\gamma)

(thesis, 2.2.3.2).  From the corner :math:`(L_x, L_y, L_z)` the offsets E, F, G_1, G_2 lead to
:math:`(e, f, g_1)` and :math:`(e, f, g_2)`, with :math:`e = L_x - E`, :math:`f = L_y - F`,
:math:`g_i = L_z - G_i`.  Contact 1 is the foot of the first on the front, contact 2 the foot of the
second on the side, contact 3 that of either on the top.  With :math:`g_1 = g_2` the three normal
lines would meet.  In coordinates of the faces, :math:`p_1 = R_1 (l_x, a, b)` and
:math:`p_2 = R_2 (c, l_y, d)` with

.. math::
    a = f, \quad b = -e s_\theta + g_1 c_\theta, \quad c = e c_\beta - f s_\beta, \quad
    d = -(e s_\beta + f c_\beta) s_\gamma + g_2 c_\gamma .

One more contact on the top, with three others that balance (see `parallel_bodies`,
`wide_design`), is at :math:`D_1 (e, f) + D_2 (p_x, p_y)`, :math:`D_2 < 0`, where

.. math::
    p_x &= -b c c_\gamma - a d c_\theta s_\beta + a c c_\theta c_\beta s_\gamma \\
    p_y &= a c c_\gamma s_\theta - a d c_\theta c_\beta - a c c_\theta s_\beta s_\gamma .

On the line :math:`y = f` through contact 3 it is :math:`(1 - D_1) |Q|` away from contact 3,

.. math::  Q = e - f p_x / p_y .

This needs :math:`a c > 0` and :math:`f p_y < 0`.  (The printed :math:`p_x` has
:math:`c_\theta` in its first term.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body_class import DEPENDENT
from multiarm.grasp.polyhedron import Polyhedron

# Offsets that differ by no more than this part of the corner's coordinates are the same.
SAME = 1e-12
MEETING = "the three normal lines meet in one point; choose G1 and G2 different"


@dataclass(frozen=True, eq=False)
class CornerPattern:
    """Contacts 1, 2, 3 at a corner, in the thesis's parameters.

    Attributes
    ----------
    frame : ndarray, shape (4, 4)
        Pose of Sigma_0 in the body's frame.
    theta, beta, gamma : float
        Angles of the front and of the side [rad].
    corner : ndarray, shape (3,)
        The corner (Lx, Ly, Lz) in Sigma_0 [m].
    E, F, G1, G2 : float
        Offsets from the corner [m].
    """

    frame: np.ndarray
    theta: float
    beta: float
    gamma: float
    corner: np.ndarray
    E: float
    F: float
    G1: float
    G2: float

    @property
    def e(self) -> float:
        """x of contact 3 in Sigma_0 [m]."""
        return float(self.corner[0] - self.E)

    @property
    def f(self) -> float:
        """y of contact 3 in Sigma_0 [m]."""
        return float(self.corner[1] - self.F)

    @property
    def g(self) -> tuple[float, float]:
        """Heights ``(g1, g2)`` of the points whose feet contacts 1 and 2 are [m]."""
        return float(self.corner[2] - self.G1), float(self.corner[2] - self.G2)

    @cached_property
    def in_face_offsets(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """``((a, b), (c, d))``: contact 1 in the front and contact 2 in the side [m]."""
        (st, ct), (sb, cb), (sg, cg) = self.sines
        (e, f), (g1, g2) = (self.e, self.f), self.g
        b = -e * st + g1 * ct
        return (f, b), (e * cb - f * sb, -(e * sb + f * cb) * sg + g2 * cg)

    @cached_property
    def direction(self) -> np.ndarray:
        """``(p_x, p_y)``, the second generator of the region on the top, shape (2,) [m^3]."""
        (st, ct), (sb, cb), (sg, cg) = self.sines
        (a, b), (c, d) = self.in_face_offsets
        px = -b * c * cg - a * d * ct * sb + a * c * ct * cb * sg
        py = a * c * cg * st - a * d * ct * cb - a * c * ct * sb * sg
        return np.array([px, py])

    @property
    def reach(self) -> float:
        """``Q`` with its sign [m]: from contact 3 the last contact is at ``x = e - (1 - D1) Q``."""
        px, py = self.direction
        return float(self.e - self.f * px / py) if py else np.inf

    @property
    def faulty(self) -> str:
        """The obstacle between the region and the line y = f; empty if there is none."""
        (a, _), (c, _) = self.in_face_offsets
        if abs(self.G1 - self.G2) <= SAME * float(np.abs(self.corner).max()):
            return MEETING
        if not a * c > 0.0:
            return f"the offsets a = {a:.4g} and c = {c:.4g} m have different signs, or are zero"
        if not self.f * self.direction[1] < 0.0:
            return f"p_y = {self.direction[1]:.4g} and f = {self.f:.4g} do not have opposite signs"
        return ""

    @cached_property
    def points(self) -> np.ndarray:
        """Contacts 1, 2, 3 in the body's frame, shape (3, 3) [m]."""
        g1, g2 = self.g
        above = np.array([[self.e, self.f, g1], [self.e, self.f, g2], [self.e, self.f, g2]])
        drop = np.sum(self.normals * (self.corner - above), axis=1)
        return self.in_body(above + drop[:, None] * self.normals)

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward normals of front, side and top in Sigma_0, shape (3, 3)."""
        (st, ct), (sb, cb), (sg, cg) = self.sines
        return np.array([[ct, 0.0, st], [sb * cg, cb * cg, sg], [0.0, 0.0, 1.0]])

    def last_point(self, distance: float) -> np.ndarray:
        """The point of the top at a distance from contact 3 along the line y = f, shape (3,)."""
        x = self.e - np.sign(self.reach) * distance
        return self.in_body(np.array([x, self.f, self.corner[2]]))

    def in_body(self, points: Any) -> np.ndarray:
        """Points (..., 3) from Sigma_0 to the body's frame."""
        return np.asarray(points) @ self.frame[:3, :3].T + self.frame[:3, 3]

    @property
    def sines(self) -> np.ndarray:
        """Rows (sine, cosine) of theta, beta and gamma, shape (3, 2)."""
        angles = np.array([self.theta, self.beta, self.gamma])
        return np.column_stack([np.sin(angles), np.cos(angles)])


def corner_pattern(
    normals: np.ndarray, offsets: np.ndarray, origin: np.ndarray, lengths: Any
) -> CornerPattern:
    """The pattern at the corner of three planes.

    Parameters
    ----------
    normals : ndarray, shape (3, 3)
        Outward unit normals of front, side and top, right-handed.
    offsets : ndarray, shape (3,)
        ``n . x`` on them [m].
    origin : ndarray, shape (3,)
        Origin of Sigma_0.
    lengths : (float, float, float, float)
        E, F, G1, G2 [m].

    Raises
    ------
    GraspError
        Normals that are left-handed or dependent.
    """
    n1, n2, z = normals
    if not np.linalg.det(normals) > DEPENDENT:
        raise GraspError(
            "front, side and top in this order are not right-handed, seen from outside; exchange "
            "front and side"
        )
    x = n1 - (n1 @ z) * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.column_stack([x, y, z]), origin
    corner = np.linalg.solve(normals @ frame[:3, :3], offsets - normals @ origin)
    theta = float(np.arctan2(n1 @ z, n1 @ x))
    beta = float(np.arctan2(n2 @ x, n2 @ y))
    gamma = float(np.arcsin(np.clip(n2 @ z, -1.0, 1.0)))
    return CornerPattern(frame, theta, beta, gamma, corner, *map(float, lengths))


def even_offsets(
    pattern: CornerPattern, depth: float, step: float
) -> tuple[float, float, float, float]:
    """E, F, G1, G2 of points that are equally deep below the three faces.

    The feet of such a point are inside their faces at every corner: seen from a second face at
    the angle phi, the foot is ``depth tan(phi / 2)`` from the edge.  ``step`` is G1 - G2.
    """
    inward = np.linalg.solve(pattern.normals, np.full(3, depth))
    E, F, G = inward.tolist()
    return E, F, G + step, G


def right_handed(body: Polyhedron, faces: tuple[int, int, int]) -> tuple[int, int, int]:
    """Front, side and top, front and side exchanged if need be."""
    i, j, k = faces
    return faces if np.linalg.det(body.normals[[i, j, k]]) > 0.0 else (j, i, k)
