r"""A body that lies on the floor, and the edges about which it can be tilted.

The floor is the plane z = 0 of the world.  The body lies on one face, its centre of mass above the
origin.  Turned about an edge of that face by an angle, a point of the face at the distance d from
the edge has the height

.. math:: z = d \sin\theta ,

and the lever of the weight about the edge, ``w`` to its side and ``h`` below the centre of mass, is
:math:`w \cos\theta - h \sin\theta`: beyond :math:`\tan\theta = w / h` the body falls over.

**What fingertips reach.**  A contact on a face can be reached where it is at least ``finger`` above
the floor, the room that a fingertip with its finger takes.  On a plane face that is a half-plane,

.. math:: e_z \cdot (X p) \ge f ,

for each pose X in which the contact is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from multiarm.errors import GraspError
from multiarm.geometry.poses import pose_matrix
from multiarm.geometry.screws import skew
from multiarm.grasp.body.face import clipped
from multiarm.grasp.body.polyhedron import Polyhedron

# A body is tilted no farther than this [rad].
STEEPEST = np.radians(80.0)
# Of the angle at which a body falls over, or comes to lie on the next face, so much is used.
SHORT_OF_FALLING = 0.9
DOWN = np.array([0.0, 0.0, -1.0])
# No motion.
STILL = np.eye(4)


@dataclass(frozen=True, eq=False)
class PivotEdge:
    """An edge of the face on which a body lies.

    Attributes
    ----------
    vertices : tuple of 2 ints
        Of the body; tilting turns by the right-hand rule about the way from one to the other.
    beside : int
        The other face at the edge.
    point, axis : ndarray, shape (3,)
        The first vertex, and the unit vector to the other, in the world.
    lever : float
        Distance of the centre of mass from it along the floor [m].
    limit : float
        How far the body may be tilted: short of falling over, and of lying on the next face [rad].
    name : str
    """

    vertices: tuple[int, int]
    beside: int
    point: np.ndarray
    axis: np.ndarray
    lever: float
    limit: float
    name: str

    def turned(self, angle: float) -> np.ndarray:
        """Motion (4, 4) in the world that tilts the body by an angle [rad]."""
        turn = rotation_about(self.axis, angle)
        return pose_matrix(turn, self.point - turn @ self.point)

    def twist(self, pose: np.ndarray) -> np.ndarray:
        """The twist (6,) of tilting a body at a pose (4, 4), in its frame about its origin."""
        R, axis = pose[:3, :3], pose[:3, :3].T @ self.axis
        return np.concatenate([np.cross(R.T @ (self.point - pose[:3, 3]), axis), axis])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance (...) of points (..., 3) from the edge along the floor, positive at the body."""
        return (points - self.point) @ np.cross(self.axis, DOWN)


@dataclass(frozen=True, eq=False)
class LyingBody:
    """A convex body that lies on one of its faces.

    Attributes
    ----------
    body : Polyhedron
    face : int
        The face that it lies on.
    pose : ndarray, shape (4, 4)
        Of the body in the world: the face is down at z = 0, the centre of mass above the origin.
    """

    body: Polyhedron
    face: int
    pose: np.ndarray

    @property
    def corners(self) -> tuple[int, ...]:
        """Vertices on the floor, counter-clockwise as seen from above."""
        return self.body.loops[self.face][0][::-1]

    def at(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the body, in the world."""
        return points @ self.pose[:3, :3].T + self.pose[:3, 3]

    def edges(self) -> list[PivotEdge]:
        """The edges of the face that it lies on."""
        body, corners = self.body, self.corners
        centre = self.at(body.centre)
        edges = []
        for u, v in zip(corners, (*corners[1:], corners[0]), strict=True):
            left, right = body.edges[min(u, v), max(u, v)]
            beside = right if left == self.face else left
            start, end = self.at(body.vertices[[u, v]])
            axis = (end - start) / np.linalg.norm(end - start)
            lever = float((centre - start) @ np.cross(axis, DOWN))
            falls = np.arctan2(lever, centre[2])
            lies = np.arccos(np.clip(body.normals[self.face] @ body.normals[beside], -1.0, 1.0))
            edges.append(
                PivotEdge(
                    vertices=(u, v),
                    beside=beside,
                    point=start,
                    axis=axis,
                    lever=lever,
                    limit=float(min(STEEPEST, SHORT_OF_FALLING * min(falls, lies))),
                    name=f"the edge of {body.names[self.face]} and {body.names[beside]}",
                )
            )
        return edges


def laid_on_face(body: Polyhedron, face: int | str | None = None) -> LyingBody:
    """A body on the floor, turned as little as can be so that one of its faces is down.

    Parameters
    ----------
    body : Polyhedron
    face : int or str, optional
        Its number or its name; left out: of those that it can lie on, the one that looks down most
        steeply.

    Raises
    ------
    GraspError
        A body that is not convex; no such face; a body that would fall over.
    """
    if not body.convex:
        raise GraspError(
            "the body is not convex; what is planned for its hull, Polyhedron.hull(body.vertices), "
            "may serve"
        )
    if face is not None:
        lies = _on_face(body, _face_number(body, face))
        over = _falls_over(lies)
        if over is not None:
            raise GraspError(
                f"the body does not lie on {body.names[lies.face]}: it falls over {over.name}; "
                "name another face"
            )
        return lies
    on_faces = [_on_face(body, int(k)) for k in np.argsort(body.normals[:, 2], kind="stable")]
    return next(lies for lies in on_faces if _falls_over(lies) is None)  # every body has one


def _on_face(body: Polyhedron, number: int) -> LyingBody:
    pose = np.eye(4)
    pose[:3, :3] = _least_turn(body.faces[number].normal, DOWN)
    pose[:2, 3] = -(pose[:3, :3] @ body.centre)[:2]
    pose[2, 3] = body.faces[number].offset  # the face looks down: its plane is at -offset
    return LyingBody(body, number, pose)


def _falls_over(lies: LyingBody) -> PivotEdge | None:
    return next((edge for edge in lies.edges() if edge.lever <= 0.0), None)


def _face_number(body: Polyhedron, face: int | str) -> int:
    if isinstance(face, str) and body.names.count(face) == 1:
        return body.names.index(face)
    if isinstance(face, Integral) and not isinstance(face, bool) and face in range(len(body.faces)):
        return int(face)
    raise GraspError(
        f"face is a number from 0 to {len(body.faces) - 1} or a name, not {face!r}; faces are "
        f"{', '.join(body.names)}"
    )


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation (3, 3) about a unit vector by an angle [rad]."""
    S = skew(axis)
    return np.eye(3) + np.sin(angle) * S + (1.0 - np.cos(angle)) * S @ S


def _least_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) by the least angle that turns one unit vector into another."""
    across, along = np.cross(start, end), float(start @ end)
    if np.linalg.norm(across) < 1e-12:
        return np.eye(3) if along > 0.0 else rotation_about(np.array([1.0, 0.0, 0.0]), np.pi)
    axis = across / np.linalg.norm(across)
    return rotation_about(axis, float(np.arctan2(np.linalg.norm(across), along)))


def reached_part(
    lies: LyingBody, number: int, motions: Sequence[np.ndarray], height: float
) -> np.ndarray | None:
    """The part of a face at least so high above the floor at every one of some poses.

    Parameters
    ----------
    lies : LyingBody
    number : int
        Of the face.
    motions : sequence of ndarray, shape (4, 4)
        Of the body in the world.
    height : float
        [m]

    Returns
    -------
    ndarray, shape (K, 3), or None
        Corners of the part, in the body's frame; None where there is none.
    """
    face = lies.body.faces[number]
    part = face.outline
    for motion in motions:
        X = motion @ lies.pose
        origin, axes = face.frame[:3, 3], face.frame[:3, :2]
        # height of the face's point y: e_z . (X (origin + axes y)) >= height
        slope = X[2, :3] @ axes
        level = X[2, :3] @ origin + X[2, 3] - height
        length = float(np.linalg.norm(slope))
        if length < 1e-12:
            if level < 0.0:
                return None
            continue
        part = clipped(part, np.append(-slope, level) / length)
        if len(part) < 3:
            return None
    return face.at(part)
