r"""Two fixed grippers for bodies with three pairs of parallel faces (thesis, 2.2.3.2, Example 2.3).

Contacts 1, 2, 3 are a pattern at one corner (see `corner_pattern`), about the centre of the body as
the origin; contacts 4, 5, 6 are their mirror images at the opposite corner.  The moments of each
pair balance, :math:`b_1 = m_3`, so that a last contact on the top closes the grasp at

.. math::  p_7 = D_1 (e, f) + D_2 (p_x, p_y), \qquad D_1 < -1, \; D_2 < 0 .

On the line :math:`y = f` it must be farther from contact 3 than

.. math::
    D_x = 2 |Q|, \qquad
    Q = \frac{(g_1 - g_2) c_\theta c_\gamma (e c_\beta - f s_\beta)}
             {e s_\theta c_\beta c_\gamma + f (c_\theta s_\gamma - s_\theta s_\beta c_\gamma)
              - g_2 c_\theta c_\beta c_\gamma}

toward the inside or the edge as the sign of Q says.  (The printed bound lacks the factor 2: it is
:math:`1 - D_1 > 2`.)  The denominator is linear in the height :math:`L_z`: the same grippers hold
every body with these angles and this :math:`L_x, L_y` that is higher than a certain limit.

**The pattern at a corner**, and where a fourth contact may be.  Faces 1 (front), 2 (side) and 3
(top) meet at a corner.  The frame :math:`\Sigma_0` has its z axis along the outward normal of the
top, its y axis along the edge between top and front, and its origin where the design wants it.  The
outward normals are :math:`n_1 = R_1 \hat x`, :math:`n_2 = R_2 \hat y`, :math:`n_3 = \hat z` with

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

One more contact on the top, with three others that balance (as here, and in `wide_design`), is at
:math:`D_1 (e, f) + D_2 (p_x, p_y)`, :math:`D_2 < 0`, where

.. math::
    p_x &= -b c c_\gamma - a d c_\theta s_\beta + a c c_\theta c_\beta s_\gamma \\
    p_y &= a c c_\gamma s_\theta - a d c_\theta c_\beta - a c c_\theta s_\beta s_\gamma .

On the line :math:`y = f` through contact 3 it is :math:`(1 - D_1) |Q|` away from contact 3,

.. math::  Q = e - f p_x / p_y .

This needs :math:`a c > 0` and :math:`f p_y < 0`.  (The printed :math:`p_x` has
:math:`c_\theta` in its first term.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.assembling import (
    Three,
    at_two_corners,
    crosses,
    length_of,
    opposite_corner,
    proven,
    size_of_gripper,
    sized,
)
from multiarm.grasp.body_class import DEPENDENT, classify
from multiarm.grasp.face import frame_of
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.polyhedron import Polyhedron

Offsets = tuple[float, float, float, float]

# Where nothing is said: depth of the pattern below its faces as a part of the smallest distance of
# a face from the centre, G1 - G2 as parts of the depth, and the last contact at this multiple of
# its bound, or half way from the bound to the edge if that is nearer.
USUAL_DEPTH, USUAL_STEPS, USUAL_DISTANCE = 0.3, (0.5, -0.5), 2.0


class OpenCornerError(GraspError):
    """A corner at which no contact on the line y = f closes, with grippers of any size."""


@dataclass(frozen=True, eq=False)
class ParallelDesign:
    """Two fixed grippers for a body with three pairs of parallel faces.

    Attributes
    ----------
    body : Polyhedron
    faces : (int, int, int)
        Front, side and top: of contacts 1, 2 and 3.
    opposite : (int, int, int)
        Of contacts 4, 5 and 6.
    pattern : CornerPattern
        About the centre of the body.
    distance : float
        Of contact 7 from contact 3 [m].
    """

    body: Polyhedron
    faces: Three
    opposite: Three
    pattern: CornerPattern
    distance: float

    @property
    def minimum_distance(self) -> float:
        """``D_x = 2 |Q|``: the grasp is closed beyond it [m]."""
        return 2.0 * abs(self.pattern.reach)

    @property
    def smallest_height(self) -> float:
        """The corner's height ``Lz`` must exceed this for the same grippers, Lx and Ly [m]."""
        p = self.pattern
        (st, ct), (sb, cb), (sg, cg) = p.sines
        (g1, g2), (_, (c, _)) = p.g, p.in_face_offsets
        numerator = abs((g1 - g2) * ct * cg * c)
        rest = p.e * st * cb * cg + p.f * (ct * sg - st * sb * cg)
        return float(p.G2 + (2.0 * numerator / self.distance + rest) / (ct * cb * cg))

    def grasp(self) -> Grasp:
        """The grasp, verified.

        Raises
        ------
        GraspError
            No contact on the line y = f closes; contacts outside their faces; a distance that is
            not beyond its bound.
        """
        p, body = self.pattern, self.body
        p.require_reach()
        if not self.distance > self.minimum_distance:
            raise GraspError(
                f"contact 7 is {self.distance:.6g} m from contact 3, but the grasp is closed only "
                f"beyond 2 |Q| = {self.minimum_distance:.6g} m; more height (over "
                f"{self.smallest_height:.6g} m) or a smaller G1 - G2 lowers the bound"
            )
        centre = p.frame[:3, 3]
        points = np.vstack([p.points, 2.0 * centre - p.points, p.last_point(self.distance)])
        top = self.faces[2]
        grasp = at_two_corners(body, self.faces, self.opposite, points, top, self._notes())
        return proven(grasp, crosses(grasp, p.last_point, self.minimum_distance))

    def _notes(self) -> tuple[str, ...]:
        return (
            f"contact 7 is {self.distance:.6g} m from contact 3; the grasp is closed beyond "
            f"2 |Q| = {self.minimum_distance:.6g} m",
            f"the same grippers hold bodies with these angles, Lx = {self.pattern.corner[0]:.6g} m "
            f"and Ly = {self.pattern.corner[1]:.6g} m whose corner is higher than "
            f"{max(self.smallest_height, 0.0):.6g} m over the centre, as long as the contacts stay "
            f"on their faces",
        )


def design_parallel_grasp(
    body: Polyhedron,
    *,
    offsets: Offsets | None = None,
    distance: float | None = None,
    faces: Three | None = None,
    gripper_size: float | None = None,
) -> Grasp:
    """A form-closure grasp of a parallelepiped by two fixed grippers at opposite corners.

    Parameters
    ----------
    body : Polyhedron
        Three pairs of parallel faces, a block too.
    offsets : (float, float, float, float), optional
        E, F, G1, G2: from the corner to the points whose feet are the contacts, along the axes of
        Sigma_0 [m]; see `corner_pattern`.  Points equally deep below the faces otherwise.
    distance : float, optional
        Of contact 7 from contact 3 [m]; twice its bound otherwise.
    faces : (int, int, int), optional
        Front, side and top of one corner, right-handed as seen from outside; the corner and the
        order with the firmest grasp otherwise.
    gripper_size : float, optional
        Largest distance between contacts of a gripper [m], instead of ``offsets``.

    Returns
    -------
    Grasp
        Contacts 1 to 7; gripper 1 carries 1, 2, 3 and 7, gripper 2 carries 4, 5 and 6.

    Raises
    ------
    GraspError
        Another class of body; a gripper that is too large; lengths with which no corner works.
    """
    body_class, gripper_size = classify(body), size_of_gripper(gripper_size)
    offsets = None if offsets is None else _four(offsets)
    if body_class.kind not in ("block", "three pairs of parallel faces"):
        raise GraspError(
            f"three pairs of parallel faces are needed; this body is {body_class.words}"
        )
    best: Grasp | None = None
    faults: list[GraspError] = []
    for three in [faces] if faces is not None else _corners(body, body_class.pairs):
        opposite = opposite_corner(body_class, body, three)
        for step in USUAL_STEPS[: 1 if offsets is not None else None]:
            try:
                grasp = _fitted(body, three, opposite, offsets, step, distance, gripper_size)
            except GraspError as error:
                faults.append(error)
                continue
            if best is None or grasp.closure.distance > best.closure.distance:
                best = grasp
    if best is None:
        reasons = [fault for fault in faults if not isinstance(fault, OpenCornerError)] or faults
        raise GraspError(f"no corner of the body takes these grippers; for one, {reasons[0]}")
    return best


def parallel_design(
    body: Polyhedron,
    faces: Three,
    opposite: Three,
    offsets: Offsets,
    distance: float | None = None,
) -> ParallelDesign:
    """The design with given faces and offsets E, F, G1, G2; contact 7 at twice its bound."""
    pattern = _pattern(body, faces, opposite, _four(offsets))
    if distance is None:
        distance = usual_distance(body, faces[2], pattern, 2.0)
    length = length_of(distance, "the distance of contact 7")
    return ParallelDesign(body, faces, opposite, pattern, length)


def usual_distance(body: Polyhedron, top: int, pattern: CornerPattern, factor: float) -> float:
    """A distance of the last contact beyond the bound ``factor |Q|``, with room before the edge."""
    bound = factor * abs(pattern.reach)
    if pattern.faulty:
        return USUAL_DISTANCE * bound
    direction = -np.sign(pattern.reach) * pattern.frame[:3, 0]
    end = body.faces[top].room_along(pattern.points[2], direction)
    if end <= bound:
        raise GraspError(
            f"the grippers are too large for the object: the last contact must be {bound:.4g} m "
            f"from the other on {body.faces[top].name}, whose edge is only {end:.4g} m away; "
            f"choose smaller offsets"
        )
    return min(USUAL_DISTANCE * bound, 0.5 * (bound + end))


def _four(offsets: Any) -> Offsets:
    """E, F, G1 and G2 [m]."""
    if not isinstance(offsets, list | tuple | np.ndarray) or len(offsets) != 4:
        raise GraspError(f"offsets are the four lengths E, F, G1, G2 in metres, not {offsets!r}")
    E, F, G1, G2 = (length_of(value, "an offset from the corner") for value in offsets)
    return E, F, G1, G2


def _fitted(
    body: Polyhedron,
    faces: Three,
    opposite: Three,
    offsets: Offsets | None,
    step: float,
    distance: float | None,
    gripper_size: float | None,
) -> Grasp:
    """The grasp with given offsets, or with the even ones that make the wanted size."""
    if offsets is not None:
        return parallel_design(body, faces, opposite, offsets, distance).grasp()
    blank = _pattern(body, faces, opposite, (0.0, 0.0, 0.0, 0.0))
    usual = USUAL_DEPTH * float(np.min(blank.normals @ blank.corner))

    def at_depth(depth: float) -> Grasp:
        even = even_offsets(blank, depth, step * depth)
        return parallel_design(body, faces, opposite, even, distance).grasp()

    return sized(at_depth, usual, gripper_size)


def _pattern(body: Polyhedron, faces: Three, opposite: Three, offsets: Offsets) -> CornerPattern:
    n = body.normals[list(faces)]
    ends = np.array([[body.faces[k].offset for k in three] for three in (faces, opposite)])
    centre = np.linalg.solve(n, 0.5 * (ends[0] - ends[1]))
    return corner_pattern(n, ends[0], centre, offsets)


def _corners(body: Polyhedron, pairs: tuple[tuple[int, int], ...]) -> Iterator[Three]:
    """Faces of contacts 1, 2, 3 at each corner, in each order; of opposite corners one."""
    for second, third in product((0, 1), repeat=2):
        corner = (pairs[0][0], pairs[1][second], pairs[2][third])
        for k in range(3):
            yield right_handed(body, (corner[k - 2], corner[k - 1], corner[k]))


# --- Three fingertips at a corner -----------------------------------------------------------------

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

    def require_reach(self) -> None:
        """Raise `OpenCornerError` when no contact on the line y = f of the top closes the grasp."""
        if self.faulty:
            raise OpenCornerError(
                f"no contact on the line y = f of the top closes the grasp: {self.faulty}"
            )

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
    frame = frame_of(z, n1, origin)
    x, y = frame[:3, 0], frame[:3, 1]
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
