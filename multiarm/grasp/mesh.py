"""Polyhedra from mesh files, and back.

A mesh file holds triangles, often with separate corners and in single precision.  Corners that
coincide within that precision are merged; triangles in one plane are one face (see `solid`).  A
result that is not a closed surface with its normals outward is an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.bodies import Boundary, compacted
from multiarm.grasp.face import PLANE_TOLERANCE, Face
from multiarm.grasp.solid import check_one_solid, faces_of_triangles
from multiarm.scene.object import TOO_THIN

# Rounding of a coordinate in single precision, with room for one operation on it.
SINGLE = 2.0 * float(np.finfo(np.float32).eps)
REPAIR = "; repair the mesh (in Blender: 3D-Print Toolbox, Make Manifold) or rebuild the body"


def read_mesh(file: str | Path, scale: float) -> Boundary:
    """The boundary of the body in a mesh file; see `Polyhedron.mesh`."""
    if not (np.isfinite(scale) and scale > 0.0):
        raise GraspError(f"{file}: a mesh is scaled by a positive factor, not {scale!r}")
    points, triangles = _read(Path(file))
    size = float(np.ptp(points, axis=0).max())
    rounding = SINGLE * float(np.abs(points).max())
    vertices, triangles = _joined(points, triangles, max(rounding, 1e-9 * size))
    what = f"the mesh of {Path(file).name}"
    if not len(triangles):
        raise GraspError(f"{file}: {TOO_THIN}")
    check_one_solid(len(vertices), [[tri] for tri in triangles.tolist()], what, REPAIR)
    tolerance = max(4.0 * rounding, PLANE_TOLERANCE * 0.25 * size)
    a, b, c = np.moveaxis(vertices[triangles] - vertices.mean(axis=0), 1, 0)
    volume = float(np.sum(a * np.cross(b, c))) / 6.0
    surface = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2.0
    if abs(volume) <= 0.1 * tolerance * surface:
        raise GraspError(f"{file}: {TOO_THIN}")
    if volume < 0.0:
        raise GraspError(
            f"{what} is inside out: its triangles run clockwise as seen from outside; turn all of "
            f"them round (in Blender: Mesh, Normals, Recalculate Outside)"
        )
    faces = faces_of_triangles(vertices, triangles, tolerance)
    return compacted(vertices * scale, faces)


def write_mesh(vertices: np.ndarray, triangles: np.ndarray, path: str | Path) -> None:
    """Write triangles to a file; its ending is the format."""
    import trimesh

    solid = trimesh.Trimesh(vertices, triangles, process=False)
    try:
        solid.export(str(path))
    except (OSError, ValueError, KeyError) as error:
        raise GraspError(
            f"{path}: cannot be written ({error}); use a name that ends in .stl"
        ) from error


def triangles_of(
    faces: Sequence[Face], loops_of_faces: Sequence[Sequence[Sequence[int]]]
) -> np.ndarray:
    """Numbers of corners (T, 3) of triangles that make up a body's faces, normals outward."""
    made: list[list[int]] = []
    for face, loops in zip(faces, loops_of_faces, strict=True):
        numbers = [v for loop in loops for v in loop]
        made.extend([[numbers[k] for k in tri] for tri in face_triangles(face)])
    return np.array(made)


def face_triangles(face: Face) -> list[tuple[int, int, int]]:
    """Triangles of one face, numbers into its outer corners followed by those of its holes."""
    import shapely

    corners = np.vstack([face.outline, *(face.coordinates(hole) for hole in face.holes)])
    if len(corners) == 3:
        return [(0, 1, 2)]
    cut = shapely.constrained_delaunay_triangles(face.shape)
    made = []
    for piece in cut.geoms:
        ring = np.array(piece.exterior.coords)[:3]
        if not piece.exterior.is_ccw:
            ring = ring[::-1]
        a, b, c = (int(np.argmin(np.abs(corners - at).max(axis=1))) for at in ring)
        made.append((a, b, c))
    return made


def _read(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) and triangles (T, 3) of a file, as they stand there."""
    import trimesh

    if not file.is_file():
        raise GraspError(f"{file}: no such file")
    try:
        loaded: Any = trimesh.load_mesh(str(file), process=False)
        points, triangles = np.array(loaded.vertices, float), np.array(loaded.faces, int)
    except Exception as error:  # readers of the formats raise what they please
        raise GraspError(f"{file}: cannot be read as a mesh ({error}); use STL or OBJ") from error
    if not len(triangles) or not np.all(np.isfinite(points)):
        raise GraspError(f"{file}: a mesh needs triangles with finite coordinates")
    return points, triangles


def _joined(
    points: np.ndarray, triangles: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points that coincide become one; triangles that lose a corner by it are left out."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    distinct, at = np.unique(points, axis=0, return_inverse=True)
    pairs = cKDTree(distinct).query_pairs(tolerance, output_type="ndarray")
    n = len(distinct)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    vertices = np.empty((count, 3))
    vertices[label[::-1]] = distinct[::-1]  # the first of each cluster stands for it
    numbers = label[at.ravel()[triangles]]
    a, b, c = numbers.T
    return vertices, numbers[(a != b) & (b != c) & (c != a)]
