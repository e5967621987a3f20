r"""Two fixed grippers for bodies with three pairs of parallel faces (thesis, 2.2.3.2, Example 2.3).

Contacts 1, 2, 3 are a pattern at one corner (:mod:`multiarm.grasp.designs.corner_pattern`), about
the centre of the body as the origin; contacts 4, 5, 6 are their mirror images at the opposite
corner.  The moments of each pair balance, :math:`b_1 = m_3`, so that a last contact on the top
closes the grasp at

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

Blocks are the square case, with other offsets (:mod:`multiarm.grasp.designs.blocks`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import classify
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.assembling import length_of, size_of_gripper, sized
from multiarm.grasp.designs.corner_design import USUAL_STEPS, CornerDesign, usual_distance
from multiarm.grasp.designs.corner_pattern import (
    CornerPattern,
    Offsets,
    OpenCornerError,
    corner_pattern,
)
from multiarm.grasp.designs.grippers import Three, opposite_corner
from multiarm.grasp.grasp import Grasp

# By default: depth of the pattern below its faces as a part of the smallest distance of a face from
# the centre.
USUAL_DEPTH = 0.3


class ParallelDesign(CornerDesign):
    """Two fixed grippers for a body with three pairs of parallel faces.

    The pattern, of contacts 1, 2 and 3, is about the centre of the body.
    """

    @property
    def smallest_height(self) -> float:
        """The corner's height ``Lz`` must exceed this for the same grippers, Lx and Ly [m]."""
        p = self.pattern
        (st, ct), (sb, cb), (sg, cg) = p.sines
        (g1, g2), (_, (c, _)) = p.g, p.in_face_offsets
        numerator = abs((g1 - g2) * ct * cg * c)
        constant = p.e * st * cb * cg + p.f * (ct * sg - st * sb * cg)
        G2 = p.corner[2] - g2
        return float(G2 + (2.0 * numerator / self.distance + constant) / (ct * cb * cg))

    @property
    def notes(self) -> tuple[str, ...]:
        """Where contact 7 is, its bound, and which bodies the same grippers hold."""
        return (
            *super().notes,
            f"the same grippers hold bodies with these angles, Lx = {self.pattern.corner[0]:.6g} m "
            f"and Ly = {self.pattern.corner[1]:.6g} m whose corner is higher than "
            f"{max(self.smallest_height, 0.0):.6g} m over the centre, as long as the contacts stay "
            f"on their faces",
        )

    @property
    def _remedy(self) -> str:
        return (
            f"; more height (over {self.smallest_height:.6g} m) or a smaller G1 - G2 lowers the "
            f"bound"
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
    """The design with given faces and offsets E, F, G1, G2; contact 7 at twice its bound.

    Raises
    ------
    GraspError
        Faces that are not right-handed, or have no common corner; offsets that are no lengths.
    """
    pattern = _right_handed_corner(body, faces, opposite).stepped(*_four(offsets))
    length = np.nan if distance is None else length_of(distance, "the distance of contact 7")
    design = ParallelDesign(body, faces, opposite, pattern, length)
    return design if distance is not None else replace(design, distance=usual_distance(design))


def centred_corner(body: Polyhedron, faces: Three, opposite: Three) -> CornerPattern:
    """The corner of three faces about the point half way between them and the opposite ones."""
    n = body.normals[list(faces)]
    levels, beyond = ([body.faces[k].offset for k in three] for three in (faces, opposite))
    centre = np.linalg.solve(n, 0.5 * np.subtract(levels, beyond))
    return corner_pattern(n, np.array(levels), centre)


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
    corner = _right_handed_corner(body, faces, opposite)
    usual = USUAL_DEPTH * float(np.min(corner.normals @ corner.corner))

    def at_depth(depth: float) -> Grasp:
        even = corner.even_offsets(depth, step * depth)
        return parallel_design(body, faces, opposite, even, distance).grasp()

    return sized(at_depth, usual, gripper_size)


def _right_handed_corner(body: Polyhedron, faces: Three, opposite: Three) -> CornerPattern:
    if np.linalg.det(body.normals[list(faces)]) < 0.0:
        raise GraspError(
            "front, side and top in this order are not right-handed, seen from outside; exchange "
            "front and side"
        )
    return centred_corner(body, faces, opposite)


def _corners(body: Polyhedron, pairs: tuple[tuple[int, int], ...]) -> Iterator[Three]:
    """Faces of contacts 1, 2, 3 at each corner, in each order; of opposite corners one."""
    for second, third in product((0, 1), repeat=2):
        corner = (pairs[0][0], pairs[1][second], pairs[2][third])
        for k in range(3):
            yield right_handed(body, (corner[k - 2], corner[k - 1], corner[k]))


def right_handed(body: Polyhedron, faces: Three) -> Three:
    """Front, side and top, front and side exchanged if need be."""
    i, j, k = faces
    return faces if np.linalg.det(body.normals[[i, j, k]]) > 0.0 else (j, i, k)
