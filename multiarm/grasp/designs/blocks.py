r"""Two small fixed grippers that hold rectangular blocks of any size (thesis, 2.2.3.1).

On a block with the half edges :math:`l_x, l_y, l_z`, contacts 1, 2, 3 near the corner
(+, +, +) and 4, 5, 6 at the mirrored places near the opposite corner are

.. math::
    p_1 = (l_x, l_y - A, l_z - A), \quad p_2 = (l_x - A, l_y, l_z - A), \quad
    p_3 = (l_x - E, l_y - A, l_z), \quad p_{j+3} = -p_j .

This is the square case of the design for parallel faces
(:mod:`multiarm.grasp.designs.parallel_bodies`): the contacts are the feet of points at the depths
(A, A, A), (A, A, A) and (E, A, A) below the faces, so that
:math:`p_x = -(l_x - A)(l_z - A)`, :math:`p_y = -(l_y - A)(l_z - A)` and :math:`Q = A - E`.  On the
line :math:`y = l_y - A` of the top the last contact closes the grasp when it is farther than

.. math::  D_x = 2 |A - E|

from contact 3: toward the inside when A > E, toward the edge when A < E.  Neither D_x nor any
offset depends on the block, so that the two patterns are rigid: gripper 1 carries contacts 1, 2, 3
and 7, gripper 2 contacts 4, 5 and 6.  They hold every block on whose faces all contacts find room.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import classify
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.assembling import length_of
from multiarm.grasp.designs.corner_design import USUAL_DISTANCE, CornerDesign
from multiarm.grasp.designs.corner_pattern import CornerPattern, corner_pattern
from multiarm.grasp.designs.grippers import Three, opposite_corner
from multiarm.grasp.designs.parallel_bodies import centred_corner
from multiarm.grasp.grasp import Grasp

# By default: A as a part of the shortest edge, E as a part of A.  Contact 7, at twice its bound, is
# then 2.5 A from the edge, less than half an edge.
USUAL_OFFSET, USUAL_SEVENTH = 0.15, 0.5


@dataclass(frozen=True)
class BlockDesign:
    """Two fixed grippers for blocks.

    Parameters
    ----------
    offset : float
        A: distance of the contacts from the edges [m].
    seventh_offset : float
        E: distance of contact 3 from the front edge, different from A [m].
    distance : float
        Of contact 7 from contact 3 [m].

    Raises
    ------
    GraspError
        Lengths that are not positive; A = E; a distance that is not beyond its bound, or that
        leads over the edge.
    """

    offset: float
    seventh_offset: float
    distance: float

    def __post_init__(self) -> None:
        what = {"offset": self.offset, "seventh offset": self.seventh_offset}
        what["distance"] = self.distance
        lengths = [length_of(value, f"the {name}") for name, value in what.items()]
        if min(lengths) <= 0.0:
            raise GraspError(f"offset, seventh offset and distance are positive, not {lengths}")
        A, E = self.offset, self.seventh_offset
        if self.minimum_distance <= 1e-9 * A:
            raise GraspError(
                f"offset and seventh offset are both {A:g} m: the normal lines at a corner would "
                f"meet in one point and the contacts be dependent; choose them different"
            )
        if self.distance <= self.minimum_distance:
            raise GraspError(
                f"contact 7 is {self.distance:g} m from contact 3, but the grasp is closed only "
                f"beyond 2 |A - E| = {self.minimum_distance:g} m"
            )
        if A < E <= self.distance:
            raise GraspError(
                f"with offset {A:g} < {E:g} = seventh offset contact 7 lies toward the edge, less "
                f"than {E:g} m away, and not {self.distance:g} m; its bound is 2 |A - E| = "
                f"{self.minimum_distance:g} m, so choose a seventh offset below 2 A"
            )

    @property
    def minimum_distance(self) -> float:
        """``D_x = 2 |Q| = 2 |A - E|``: the grasp is closed beyond it, whatever the block [m]."""
        return 2.0 * abs(self._pattern.reach)

    @cached_property
    def smallest(self) -> np.ndarray:
        """The edges (x, y, z) of a block must be longer than these, shape (3,) [m].

        There is no upper limit.  Coordinates a to f of the contacts are then positive, and
        contact 7 is on the top.
        """
        A, E = self.offset, self.seventh_offset
        inward = E + self.distance if A > E else 0.0
        return np.array([max(2.0 * A, 2.0 * E, inward), 2.0 * A, 2.0 * A])

    @property
    def gripper_size(self) -> float:
        """Largest distance between two contacts of gripper 1, the larger one [m]."""
        places = np.vstack([self._pattern.points, self._pattern.last_point(self.distance)])
        return float(np.linalg.norm(places[:, None] - places[None], axis=-1).max())

    def fits(self, lengths: Any) -> bool:
        """Whether the grippers hold a block with these edges (3,) [m]."""
        return bool(np.all(np.asarray(lengths, dtype=float) > self.smallest))

    def grasp(self, body: Any, faces: tuple[int, int, int] | None = None) -> Grasp:
        """The grasp of one block.

        Parameters
        ----------
        body : Polyhedron, or array-like, shape (3,)
            The block, anywhere, or the full lengths of its edges [m].
        faces : (int, int, int), optional
            Faces at one corner, for contacts 1, 2 and 3 (x, y and z above); usually +x, +y, +z, or
            the first face of each pair.

        Raises
        ------
        GraspError
            A body that is no block, faces that have no common corner, a block that is too small
            (with the edges that are, and by how much).
        """
        block = body if isinstance(body, Polyhedron) else Polyhedron.box(body)
        chosen, opposite = _faces(block, faces)
        pattern = self._at(centred_corner(block, chosen, opposite))
        self._check(2.0 * pattern.normals @ pattern.corner)
        grasp = CornerDesign(block, chosen, opposite, pattern, self.distance).grasp()
        return replace(grasp, notes=self._notes())

    @cached_property
    def _pattern(self) -> CornerPattern:
        """Contacts 1, 2, 3 at a square corner in the origin."""
        return self._at(corner_pattern(np.eye(3), np.zeros(3), np.zeros(3)))

    def _at(self, corner: CornerPattern) -> CornerPattern:
        """Contacts 1, 2, 3 at a corner."""
        A, E = self.offset, self.seventh_offset
        return corner.at_depths([[A, A, A], [A, A, A], [E, A, A]])

    def _check(self, lengths: np.ndarray) -> None:
        short = [
            f"edge {axis} is {length:.6g} m, more than {least:.6g} m are needed"
            for axis, length, least in zip("xyz", lengths, self.smallest, strict=True)
            if not length > least
        ]
        if short:
            raise GraspError(
                f"the grippers are too large for the block: {'; '.join(short)}.  Choose smaller "
                f"offsets, or exchange the faces"
            )

    def _notes(self) -> tuple[str, ...]:
        x, y, z = self.smallest
        return (
            f"contact 7 is {self.distance:.6g} m from contact 3; the grasp is closed beyond "
            f"2 |A - E| = {self.minimum_distance:.6g} m, whatever the size of the block",
            f"the same grippers hold every block with edges above {x:.6g} x {y:.6g} x {z:.6g} m",
        )


def design_block_grasp(
    body: Any,
    *,
    offset: float | None = None,
    seventh: float | None = None,
    distance: float | None = None,
    faces: tuple[int, int, int] | None = None,
) -> Grasp:
    """A form-closure grasp of a block by two small fixed grippers at opposite corners.

    Parameters
    ----------
    body : Polyhedron, or array-like, shape (3,)
        The block, anywhere, or the full lengths of its edges [m].
    offset : float, optional
        A: distance of the contacts from the edges [m]; 0.15 of the shortest edge otherwise.
    seventh : float, optional
        E: distance of contact 3 from the front edge [m]; A / 2 otherwise.
    distance : float, optional
        Of contact 7 from contact 3 [m]; twice the bound ``2 |A - E|`` otherwise.
    faces : (int, int, int), optional
        Faces at one corner, for contacts 1, 2 and 3.

    Returns
    -------
    Grasp
        Contacts 1 to 7; gripper 1 carries 1, 2, 3 and 7, gripper 2 carries 4, 5 and 6.

    Raises
    ------
    GraspError
        As `BlockDesign` and `BlockDesign.grasp`.

    See Also
    --------
    BlockDesign : the same grippers for many blocks, and which blocks these are.
    """
    block = body if isinstance(body, Polyhedron) else Polyhedron.box(body)
    chosen, opposite = _faces(block, faces)
    if offset is None:
        offset = usual_offset(block, zip(chosen, opposite, strict=True))
    return block_design(offset, seventh, distance).grasp(block, chosen)


def usual_offset(block: Polyhedron, pairs: Iterable[tuple[int, int]]) -> float:
    """A by default, for the pairs of faces of a block [m]."""
    return USUAL_OFFSET * min(block.faces[i].offset + block.faces[j].offset for i, j in pairs)


def block_design(
    offset: float, seventh: float | None = None, distance: float | None = None
) -> BlockDesign:
    """The two grippers for blocks, from A alone if need be: E = A / 2, and twice the bound."""
    A = length_of(offset, "the offset")
    E = USUAL_SEVENTH * A if seventh is None else length_of(seventh, "the seventh offset")
    if distance is None:
        bound = 2.0 * abs(A - E)
        distance = USUAL_DISTANCE * bound if A > E else 0.5 * (bound + E)
    return BlockDesign(A, E, length_of(distance, "the distance"))


def _faces(block: Polyhedron, faces: Three | None) -> tuple[Three, Three]:
    """Faces for contacts 1, 2, 3, and the opposite ones."""
    body_class = classify(block)
    if body_class.kind != "block":
        raise GraspError(
            f"the construction for blocks needs one; this body is {body_class.words}.  "
            f"design_grasp takes the construction that fits"
        )
    chosen = faces if faces is not None else tuple(i for i, _ in body_class.pairs)
    opposite = opposite_corner(body_class, block, chosen)
    return (chosen[0], chosen[1], chosen[2]), opposite
