"""The floor: the points of the object that can touch it, as contacts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from multiarm.contacts.records import Contact, Patch, plane, sphere
from multiarm.errors import SceneError
from multiarm.scene import Mesh, Shape
from multiarm.scene.effects import FloorSpec

MOST_CORNERS = 64
"""A hull with more corners is no polyhedron but a rounded body; every corner is a contact."""
SHARP = 1e-6
"""Corners whose faces are as flat as this are none."""


def floor_contacts(spec: FloorSpec, shape: Shape) -> list[Contact]:
    """Contacts of an object of this shape with the floor.

    Raises
    ------
    SceneError
        When it is not known where the object can touch.
    """
    pose = spec.at.matrix()
    ground = plane(pose[:3, 3], pose[:3, 2])
    if spec.size is not None:
        half = 0.5 * np.array([*spec.size, np.inf])
        ground = replace(ground, patch=Patch(-half, half, pose))
    return [
        Contact(name, ground, sphere(point, radius), pushes_only=True)
        for name, point, radius in _touching_points(spec, shape)
    ]


def _touching_points(spec: FloorSpec, shape: Shape) -> list[tuple[str, np.ndarray, float]]:
    """Name, place in the object frame and radius of what can touch the floor."""
    if spec.points is not None:
        return [(f"point {k + 1}", np.array(point), 0.0) for k, point in enumerate(spec.points)]
    if shape.sphere is not None:
        return [("ball", np.zeros(3), float(shape.sphere))]
    if shape.box is not None:
        half = 0.5 * np.array(shape.box)
        corners = [np.array(signs) * half for signs in product((-1.0, 1.0), repeat=3)]
        return _named_corners(corners)
    if shape.hull is not None:
        return _named_corners(list(hull_corners(np.array(shape.hull))))
    if shape.mesh is not None:
        return _named_corners(list(_mesh_corners(shape.mesh)))
    raise _unknown_points("a cylinder has no corners", "such as eight or more around each rim")


def _named_corners(corners: list[np.ndarray]) -> list[tuple[str, np.ndarray, float]]:
    return [(f"corner {k + 1}", corner, 0.0) for k, corner in enumerate(corners)]


def _mesh_corners(mesh: Mesh) -> np.ndarray:
    """Corners of the convex hull of a mesh, object frame [m], shape (n, 3)."""
    import coal

    if not mesh.file.is_file():
        raise _unknown_points(f"there is no mesh at {mesh.file}", "or correct the path")
    try:
        loaded = coal.MeshLoader().load(str(mesh.file), np.asarray(mesh.scale, float))
        vertices = np.array(loaded.vertices(), dtype=float).reshape(-1, 3)
    except (ValueError, RuntimeError) as error:
        raise _unknown_points(
            f"{mesh.file} cannot be read ({error})", "or repair the file"
        ) from None
    corners = hull_corners(vertices)
    if len(corners) > MOST_CORNERS:
        raise _unknown_points(
            f"the hull of {mesh.file.name} has {len(corners)} corners, which is too many",
            f"at most {MOST_CORNERS}",
        )
    return corners


def hull_corners(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points, shape (n, 3); those on its faces and edges are none.

    Raises
    ------
    SceneError
        When the points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise _unknown_points("the mesh is flat", "on both of its sides") from None
    corners = []
    for vertex in hull.vertices:
        normals = hull.equations[np.any(hull.simplices == vertex, axis=1), :3]
        if np.linalg.svd(normals, compute_uv=False)[-1] > SHARP:  # three faces that differ
            corners.append(points[vertex])
    return np.array(corners)


def _unknown_points(reason: str, such: str) -> SceneError:
    return SceneError(
        [
            f"$.effects.floor: {reason}; name the points of the object that can touch the floor "
            f"with 'points: [[x, y, z], ...]' in the object frame, {such}"
        ]
    )
