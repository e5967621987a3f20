r"""Two fixed grippers at corners of a body, with the last contact beside one of them (2.2.3).

One gripper has three contacts in the pattern of :mod:`multiarm.grasp.designs.corner_pattern`, on
front, side and top of a corner; the last contact is on the top, too, on the line :math:`y = f`
through the third of them.  The other gripper has three contacts at another corner.  They are

- the *mirror images* of the pattern in the origin of :math:`\Sigma_0`, for bodies with parallel
  faces and for blocks, their square case; or
- the *feet of the origin* on three other faces: their normal lines meet there (wider class).

The last contact closes the grasp when it is farther from the third one than

.. math::  D_x = (1 - D_1) \, |Q| ,

:math:`2 |Q|` where contacts are mirror images and :math:`|Q|` otherwise, toward the inside or the
edge as the sign of Q says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.assembling import assembled, crosses, proven
from multiarm.grasp.designs.corner_pattern import CornerPattern
from multiarm.grasp.designs.grippers import Three, feet, gripper_frame
from multiarm.grasp.grasp import Grasp

# By default: G1 - G2 as parts of the depth of the pattern, and the last contact at this multiple of
# its bound, or half way from the bound to the edge if that is nearer.
USUAL_STEPS, USUAL_DISTANCE = (0.5, -0.5), 2.0


@dataclass(frozen=True, eq=False)
class CornerDesign:
    """Two fixed grippers at corners.

    Attributes
    ----------
    body : Polyhedron
    faces : (int, int, int)
        Front, side and top: of the pattern's contacts; contact 7 is on the top.
    opposite : (int, int, int)
        Of the other three contacts.
    pattern : CornerPattern
        Contacts 1, 2, 3 where the others are their mirror images, else 4, 5, 6.
    distance : float
        Of contact 7 from the pattern's third contact [m].
    mirrored : bool
        Whether the other three are mirror images of the pattern, or feet of the origin.
    """

    body: Polyhedron
    faces: Three
    opposite: Three
    pattern: CornerPattern
    distance: float
    mirrored: bool = True

    @property
    def minimum_distance(self) -> float:
        """``D_x``, ``2 |Q|`` or ``|Q|``: the grasp is closed beyond it [m]."""
        return (2.0 if self.mirrored else 1.0) * abs(self.pattern.reach)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the grasp: where contact 7 is, and its bound."""
        return (f"{self._place}; the grasp is closed beyond {self._bound}",)

    def grasp(self) -> Grasp:
        """The grasp, verified: it opens where contact 7 comes nearer than its bound.

        Raises
        ------
        GraspError
            No contact on the line y = f closes; contacts outside their faces; a distance that is
            not beyond its bound; a grasp that hangs on rounding.
        """
        body, pattern = self.body, self.pattern
        pattern.require_reach()
        if not self.distance > self.minimum_distance:
            raise GraspError(
                f"{self._place}, but the grasp is closed only beyond {self._bound}{self._remedy}"
            )
        corners, split = [(self.faces, pattern.points)], [(0, 1, 2, 6), (3, 4, 5)]
        if self.mirrored:
            corners.append((self.opposite, pattern.mirror_images))
        else:
            origin = pattern.frame[:3, 3]
            corners.insert(0, (self.opposite, feet(body, self.opposite, origin)))
            split = [(0, 1, 2), (3, 4, 5, 6)]
        points = np.vstack([*(three for _, three in corners), pattern.last_point(self.distance)])
        faces = (*corners[0][0], *corners[1][0], self.faces[2])
        frames = [gripper_frame(body, on, three) for on, three in corners]
        grasp = assembled(body, points, faces, split, frames, self.notes)
        return proven(grasp, crosses(grasp, pattern.last_point, self.minimum_distance))

    @property
    def _place(self) -> str:
        return f"contact 7 is {self.distance:.6g} m from contact {3 if self.mirrored else 6}"

    @property
    def _bound(self) -> str:
        return f"{'2 ' if self.mirrored else ''}|Q| = {self.minimum_distance:.6g} m"

    @property
    def _remedy(self) -> str:
        return ""


def usual_distance(design: CornerDesign) -> float:
    """A distance of the last contact beyond its bound, with room before the edge [m]."""
    bound, pattern = design.minimum_distance, design.pattern
    if pattern.obstacle is not None:
        return USUAL_DISTANCE * bound
    direction = -np.sign(pattern.reach) * pattern.frame[:3, 0]
    top = design.body.faces[design.faces[2]]
    end = top.room_along(pattern.points[2], direction)
    if end <= bound:
        raise GraspError(
            f"the grippers are too large for the object: the last contact must be {bound:.4g} m "
            f"from the other on {top.name}, whose edge is only {end:.4g} m away; choose smaller "
            f"offsets"
        )
    return min(USUAL_DISTANCE * bound, 0.5 * (bound + end))
