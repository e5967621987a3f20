"""From descriptions of shapes (a URDF's visual, a scene's object, a mesh file) to meshes.

A shape that cannot be read never ends a replay: a warning names it, and a box of the right size
replaces it.

The colours of a robot's own files are subdued, so that its arms differ by their tints.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import coal
import numpy as np

from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.scene.meshes import read_mesh
from multiarm.scene.shapes import Box, Cylinder, Hull, Mesh, Sphere
from multiarm.viewer.solids import box, capsule, cone, cylinder, sphere

if TYPE_CHECKING:
    import pinocchio as pin

    from multiarm.scene import ObjectSpec


LONGEST = 1e9  # [m]: coordinates beyond are no lengths of robots
SATURATION, DARKEST = 0.3, 0.36  # what an arm's own colours keep; black would swallow the tint
PLAIN = np.array([0.88, 0.89, 0.91])  # of a part without a colour of its own


def usable(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh, if it has triangles of finite size.

    Raises
    ------
    ValueError
        It has not.
    """
    corners = mesh.vertices[np.ravel(mesh.triangles)]
    if not len(corners) or not np.abs(corners).max() < LONGEST or not np.ptp(corners, 0).any():
        raise ValueError("it has no size that can be shown")
    return mesh


def is_mesh_file(item: pin.GeometryObject) -> bool:
    """Whether a visual of Pinocchio's is a mesh; else it is a box or the like."""
    return isinstance(item.geometry, coal.BVHModelBase)


def geometry_mesh(item: pin.GeometryObject, subdued: bool = True) -> TriangleMesh:
    """Return the mesh of a visual of Pinocchio's, in the frame of the visual.

    Subdued colours distinguish the parts of an arm, whose tint distinguishes the arms.

    Raises
    ------
    ValueError
        Its file cannot be read, or it has no triangles of finite size; the message says why.
    """
    if is_mesh_file(item):
        mesh = usable(read_mesh(Path(item.meshPath), item.meshScale))
    else:
        mesh = usable(_mesh_of_solid(item.geometry))
    if item.overrideMaterial:
        mesh = mesh.painted(item.meshColor[:3])
    colors = PLAIN + 0 * mesh.triangles if mesh.colors is None else mesh.colors
    if subdued:
        grey = colors @ np.array([[0.30], [0.59], [0.11]])  # perceived brightness
        colors = DARKEST + (1 - DARKEST) * (grey + SATURATION * (colors - grey))
    return TriangleMesh(mesh.vertices, mesh.triangles, colors)


def object_mesh(spec: ObjectSpec) -> TriangleMesh:
    """Return the mesh of the common object, in the object frame."""
    match spec.shape.solid:
        case Box(edges):
            return box(edges)
        case Sphere(radius):
            return sphere(radius)
        case Cylinder(radius=radius, height=height):
            return cylinder(radius, height)
        case Hull(points):
            body = Polyhedron.hull(np.array(points))
            fans = [
                (loop[0], loop[k], loop[k + 1])
                for (loop,) in body.loops
                for k in range(1, len(loop) - 1)
            ]
            return TriangleMesh(body.vertices, np.array(fans))
        case Mesh(file=file, scale=scale):
            try:
                return usable(read_mesh(file, scale))
            except ValueError as error:
                warnings.warn(
                    f"cannot read the object's mesh {file} ({error}): the replay shows a box with "
                    "the object's inertia instead",
                    stacklevel=2,
                )
    return _inertia_box(spec.mass, spec.inertia_matrix())


def _mesh_of_solid(geometry: coal.CollisionGeometry) -> TriangleMesh:
    match geometry:
        case coal.Box():
            return box(2 * geometry.halfSide)
        case coal.Sphere():
            return sphere(geometry.radius)
        case coal.Cylinder():
            return cylinder(geometry.radius, 2 * geometry.halfLength)
        case coal.Capsule():
            return capsule(geometry.radius, 2 * geometry.halfLength)
        case coal.Cone():
            return cone(geometry.radius, 2 * geometry.halfLength)
    geometry.computeLocalAABB()
    low, high = geometry.aabb_local.min_, geometry.aabb_local.max_
    return box(high - low).shifted((low + high) / 2)


def _inertia_box(mass: float, inertia: np.ndarray) -> TriangleMesh:
    """Return the uniform box with the given `inertia` about its centre, shape (3, 3)."""
    moments, axes = np.linalg.eigh(inertia)
    squares = 6 / mass * (moments.sum() - 2 * moments)  # of the sides
    pose = np.eye(4)
    pose[:3, :3] = axes * np.sign(np.linalg.det(axes))
    longest = np.sqrt(squares.max())
    return box(np.sqrt(np.maximum(squares, (0.01 * longest) ** 2))).moved(pose)
