"""Corners of a body where a gripper can be, and the frame of the gripper there.

A gripper with three fingers reaches a corner where exactly three faces meet and each edge between
them is convex.  Its frame is tied to the corner and to one of the faces, so that a gripper has the
same coordinates of its fingertips on every body that has the same corner.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multiarm.grasp.face import PLANE_TOLERANCE
from multiarm.grasp.polyhedron import Polyhedron


def convex_corner(body: Polyhedron, vertex: int) -> bool:
    """Whether exactly three faces meet at a vertex, each edge between them convex.

    Three fingers of a gripper reach such a corner from outside.
    """
    meeting = body.corners[vertex]
    if len(meeting) != 3:
        return False
    tolerance = PLANE_TOLERANCE * body.size
    for number in meeting:
        loop = next((loop for loop in body.loops[number] if vertex in loop), ())
        at = loop.index(vertex)
        ends = body.vertices[[loop[at - 1], loop[(at + 1) % len(loop)]]] - body.vertices[vertex]
        if (ends @ body.normals[list(meeting)].T).max() > tolerance:
            return False
    return True


def shared_corner(body: Polyhedron, faces: Sequence[int]) -> int | None:
    """The convex corner where three faces meet, or None."""
    for vertex, meeting in enumerate(body.corners):
        if set(faces) == set(meeting) and convex_corner(body, vertex):
            return vertex
    return None


def nearest_corner_frame(body: Polyhedron, points: np.ndarray, seat: int) -> np.ndarray:
    """Frame of a gripper at the corner of a face that is nearest to its contacts."""
    ends = list(body.loops[seat][0])
    away = np.linalg.norm(body.vertices[ends] - points.mean(axis=0), axis=1)
    return corner_frame(body, ends[int(np.argmin(away))], seat)


def corner_frame(body: Polyhedron, vertex: int, seat: int) -> np.ndarray:
    """A gripper's frame at a corner, shape (4, 4): the same wherever the corner is the same.

    The origin is the corner, z points into the body along the normal of the face ``seat``, x runs
    along the edge of this face that arrives at the corner (counter-clockwise from outside), and
    y points into the face.
    """
    loop = next(loop for loop in body.loops[seat] if vertex in loop)
    at = loop.index(vertex)
    before = body.vertices[loop[at - 1]] - body.vertices[vertex]
    z = -body.faces[seat].normal
    x = before - (before @ z) * z
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = body.vertices[vertex]
    return pose + 0.0


def gripper_frame(body: Polyhedron, faces: tuple[int, int, int], points: np.ndarray) -> np.ndarray:
    """Frame of a gripper at the corner that three faces share, or else near its contacts."""
    corner = shared_corner(body, faces)
    if corner is None:
        return nearest_corner_frame(body, points, faces[2])
    return corner_frame(body, corner, faces[2])


def feet(body: Polyhedron, faces: tuple[int, int, int], point: np.ndarray) -> np.ndarray:
    """Feet of a point on the planes of faces, shape (3, 3): contacts whose lines meet in it."""
    n = body.normals[list(faces)]
    heights = np.array([body.faces[k].offset for k in faces]) - n @ point
    return point + heights[:, None] * n
