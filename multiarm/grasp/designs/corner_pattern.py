r"""Three fingertips at a corner, and where a fourth on its top closes the grasp (thesis, 2.2.3).

Faces 1 (front), 2 (side) and 3 (top) meet at a corner.  The frame :math:`\Sigma_0` has its z axis
along the outward normal of the top, its y axis along the edge between top and front, and its origin
where the design wants it.  The outward normals are :math:`n_1 = R_1 \hat x`,
:math:`n_2 = R_2 \hat y`, :math:`n_3 = \hat z` with

.. math::
    R_1 = \begin{bmatrix} c_\theta & 0 & -s_\theta \\ 0 & 1 & 0 \\ s_\theta & 0 & c_\theta
    \end{bmatrix}, \qquad R_2 = R_z(-\beta) R_x(\gamma)

(thesis, 2.2.3.2).  Contacts 1, 2, 3 are the feet, on front, side and top, of three points,
each an offset away from the corner.  The designs choose these offsets:

- *parallel faces and the wider class*: :math:`(E, F, G_1), (E, F, G_2), (E, F, \cdot)`,
- *blocks*: the points are at the depths :math:`(A, A, A), (A, A, A), (E, A, A)` below the three
  faces.

If all three points were one, the three normal lines would meet in it.  In coordinates of the faces
:math:`p_1 = R_1 (l_x, a, b)`, :math:`p_2 = R_2 (c, l_y, d)` and :math:`p_3 = (e, f, L_z)`; with
the points :math:`(x_i, y_i, z_i)`

.. math::
    a = y_1, \quad b = -x_1 s_\theta + z_1 c_\theta, \quad c = x_2 c_\beta - y_2 s_\beta, \quad
    d = -(x_2 s_\beta + y_2 c_\beta) s_\gamma + z_2 c_\gamma, \quad (e, f) = (x_3, y_3) .

**The last contact.**  It is on the top as contact 3 is, and pushes along :math:`e_3 = -\hat z`.
Forces u and v of contacts 1 and 2 and their partners across the body give a moment along
:math:`u\, m_1 + v\, m_2`, which must be perpendicular to :math:`e_3`, as the moments of contacts 3
and 7 are.  Where :math:`m_1 \cdot e_3` and :math:`m_2 \cdot e_3` have opposite signs, this takes
:math:`u : v = |m_2 \cdot e_3| : |m_1 \cdot e_3|`, and the last contact closes the grasp at

.. math::
    (x, y)_7 = D_1 (e, f) + D_2 (p_x, p_y), \qquad
    p = e_3 \times (|m_2 \cdot e_3|\, m_1 + |m_1 \cdot e_3|\, m_2), \qquad D_2 < 0

and :math:`D_1 < -1` or :math:`D_1 < 0`, as the contacts across the body say.  In coordinates of
the faces

.. math::
    p_x &= -b c c_\gamma - a d c_\theta s_\beta + a c c_\theta c_\beta s_\gamma \\
    p_y &= a c c_\gamma s_\theta - a d c_\theta c_\beta - a c c_\theta s_\beta s_\gamma .

On the line :math:`y = f` through contact 3 the last contact is :math:`(1 - D_1) |Q|` away from it,

.. math::  Q = e - f p_x / p_y .

This needs :math:`a c > 0` and :math:`f p_y < 0`.  (The printed :math:`p_x` has
:math:`c_\theta` in its first term.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import DEPENDENT
from multiarm.grasp.body.face import frame_of

Offsets = tuple[float, float, float, float]
"""E, F, G1, G2 [m]."""

# A bound below this part of the corner's coordinates is none: the three normal lines meet.
SAME = 1e-12


class OpenCornerError(GraspError):
    """A corner at which no contact on the line y = f closes, with grippers of any size."""


@dataclass(frozen=True, eq=False)
class CornerPattern:
    """Contacts 1, 2, 3 at a corner.

    Attributes
    ----------
    frame : ndarray, shape (4, 4)
        Pose of Sigma_0 in the body's frame.
    theta, beta, gamma : float
        Angles of the front and of the side [rad].
    corner : ndarray, shape (3,)
        The corner (Lx, Ly, Lz) in Sigma_0 [m].
    offsets : ndarray, shape (3, 3)
        Row i leads from the point whose foot is contact i to the corner, in Sigma_0 [m].
    """

    frame: np.ndarray
    theta: float
    beta: float
    gamma: float
    corner: np.ndarray
    offsets: np.ndarray

    def stepped(self, E: float, F: float, G1: float, G2: float) -> CornerPattern:
        """Contacts below one point (E, F), of which the front's and the side's heights differ."""
        return replace(self, offsets=np.array([[E, F, G1], [E, F, G2], [E, F, G2]]))

    def at_depths(self, depths: Any) -> CornerPattern:
        """Contacts below points at depths (3, 3) below front, side and top [m], a row a point."""
        return replace(self, offsets=np.linalg.solve(self.normals, np.transpose(depths)).T)

    def even_offsets(self, depth: float, step: float) -> Offsets:
        """E, F, G1, G2 of points that are equally deep below the three faces.

        The feet of such a point are inside their faces at every corner: seen from a second face at
        the angle phi, the foot is ``depth tan(phi / 2)`` from the edge.  ``step`` is G1 - G2.
        """
        E, F, G = np.linalg.solve(self.normals, np.full(3, depth)).tolist()
        return E, F, G + step, G

    @cached_property
    def above(self) -> np.ndarray:
        """The points whose feet the contacts are, in Sigma_0, shape (3, 3) [m]."""
        return self.corner - self.offsets

    @property
    def e(self) -> float:
        """x of contact 3 in Sigma_0 [m]."""
        return float(self.above[2, 0])

    @property
    def f(self) -> float:
        """y of contact 3 in Sigma_0 [m]."""
        return float(self.above[2, 1])

    @property
    def g(self) -> tuple[float, float]:
        """Heights ``(g1, g2)`` of the points whose feet contacts 1 and 2 are [m]."""
        return float(self.above[0, 2]), float(self.above[1, 2])

    @cached_property
    def in_face_offsets(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """``((a, b), (c, d))``: contact 1 in the front and contact 2 in the side [m]."""
        (st, ct), (sb, cb), (sg, cg) = self.sines.tolist()
        (x1, y1, z1), (x2, y2, z2), _ = self.above.tolist()
        b = -x1 * st + z1 * ct
        return (y1, b), (x2 * cb - y2 * sb, -(x2 * sb + y2 * cb) * sg + z2 * cg)

    @cached_property
    def direction(self) -> np.ndarray:
        """``(p_x, p_y)``, the second generator of the region on the top, shape (2,) [m^3]."""
        m1, m2 = np.cross(self._in_frame, -self.normals)[:2]
        mixed = abs(m2[2]) * m1 + abs(m1[2]) * m2
        return np.array([mixed[1], -mixed[0]])  # e_3 x mixed, with e_3 = (0, 0, -1)

    @property
    def reach(self) -> float:
        """``Q`` with its sign [m]: from contact 3 the last contact is at ``x = e - (1 - D1) Q``."""
        px, py = self.direction
        return float(self.e - self.f * px / py) if py else np.inf

    @property
    def obstacle(self) -> str | None:
        """What keeps a contact on the line y = f from closing the grasp; None if it can."""
        (a, _), (c, _) = self.in_face_offsets
        if a * c != 0.0 and abs(self.reach) <= SAME * float(np.abs(self.corner).max()):
            return "the three normal lines meet in one point; choose G1 and G2 different"
        if not a * c > 0.0:
            return f"the offsets a = {a:.4g} and c = {c:.4g} m have different signs, or are zero"
        if not self.f * self.direction[1] < 0.0:
            return f"p_y = {self.direction[1]:.4g} and f = {self.f:.4g} do not have opposite signs"
        return None

    def require_reach(self) -> None:
        """Raise `OpenCornerError` when no contact on the line y = f of the top closes the grasp."""
        if self.obstacle is not None:
            raise OpenCornerError(
                f"no contact on the line y = f of the top closes the grasp: {self.obstacle}"
            )

    @cached_property
    def points(self) -> np.ndarray:
        """Contacts 1, 2, 3 in the body's frame, shape (3, 3) [m]."""
        return self.in_body(self._in_frame)

    @property
    def mirror_images(self) -> np.ndarray:
        """Images of the contacts in the origin of Sigma_0, in the body's frame, (3, 3) [m]."""
        return 2.0 * self.frame[:3, 3] - self.points

    @cached_property
    def _in_frame(self) -> np.ndarray:
        """Contacts 1, 2, 3 in Sigma_0, shape (3, 3) [m]."""
        drop = np.sum(self.normals * self.offsets, axis=1)
        return self.above + drop[:, None] * self.normals

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


def corner_pattern(normals: np.ndarray, levels: np.ndarray, origin: np.ndarray) -> CornerPattern:
    """The corner of three planes, all three contacts at the corner itself.

    Parameters
    ----------
    normals : ndarray, shape (3, 3)
        Outward unit normals of front, side and top.
    levels : ndarray, shape (3,)
        ``n . x`` on them [m].
    origin : ndarray, shape (3,)
        Origin of Sigma_0.

    Raises
    ------
    GraspError
        Normals that are dependent.
    """
    n1, n2, z = normals
    if not abs(np.linalg.det(normals)) > DEPENDENT:
        raise GraspError("front, side and top have no common corner: their normals are dependent")
    frame = frame_of(z, n1, origin)
    x, y = frame[:3, 0], frame[:3, 1]
    return CornerPattern(
        frame=frame,
        theta=float(np.arctan2(n1 @ z, n1 @ x)),
        beta=float(np.arctan2(n2 @ x, n2 @ y)),
        gamma=float(np.arcsin(np.clip(n2 @ z, -1.0, 1.0))),
        corner=np.linalg.solve(normals @ frame[:3, :3], levels - normals @ origin),
        offsets=np.zeros((3, 3)),
    )
