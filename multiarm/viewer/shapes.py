"""From descriptions of shapes (a URDF's visual, a scene's object, a mesh file) to meshes.

What cannot be read is never fatal to a replay: a warning says what is missing, and a stand-in of
the right size takes its place.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import coal
import numpy as np

from multiarm.grasp.polyhedron import Polyhedron
from multiarm.viewer.mesh import Mesh, box, capsule, cone, cylinder, sphere
from multiarm.viewer.mesh_files import read_collada

if TYPE_CHECKING:
    import pinocchio as pin

    from multiarm.scene import ObjectSpec

SATURATION, DARKEST = 0.3, 0.36  # what an arm's own colours keep; black would swallow the tint
PLAIN = np.array([0.88, 0.89, 0.91])  # of a part without a colour of its own


def load_mesh(path: Path, scale: np.ndarray) -> Mesh:
    """Return the mesh of a file, scaled by `scale`, shape (3,).

    Raises
    ------
    ValueError
        The file is missing or of no known format.
    """
    colored = read_collada(path) if path.suffix.lower() == ".dae" else None
    if colored is not None:
        return colored.scaled(scale)
    return _mesh_of_bvh(coal.MeshLoader().load(str(path), np.asarray(scale, float)))


def geometry_mesh(item: pin.GeometryObject) -> Mesh:
    """Return the mesh of a visual of Pinocchio's, in the frame of the visual.

    Its colours are subdued: they tell the parts of an arm apart, the arm's tint tells the arms.
    """
    mesh = _visual_file(item) or _mesh_of_geometry(item.geometry)
    if item.overrideMaterial:
        mesh = mesh.painted(item.meshColor[:3])
    colors = PLAIN + 0 * mesh.triangles if mesh.colors is None else mesh.colors
    grey = colors @ np.array([[0.30], [0.59], [0.11]])  # perceived brightness
    subdued = grey + SATURATION * (colors - grey)
    return Mesh(mesh.vertices, mesh.triangles, DARKEST + (1 - DARKEST) * subdued)


def object_mesh(spec: ObjectSpec) -> Mesh:
    """Return the mesh of the common object, in the object frame."""
    shape = spec.shape
    if shape.box is not None:
        return box(shape.box)
    if shape.sphere is not None:
        return sphere(shape.sphere)
    if shape.cylinder is not None:
        return cylinder(shape.cylinder.radius, shape.cylinder.height)
    if shape.hull is not None:
        body = Polyhedron.hull(np.array(shape.hull))
        fans = [
            (loop[0], loop[k], loop[k + 1])
            for (loop,) in body.loops
            for k in range(1, len(loop) - 1)
        ]
        return Mesh(body.vertices, np.array(fans))
    assert shape.mesh is not None  # a scene's shape is one of these five
    try:
        return load_mesh(shape.mesh.file, np.array(shape.mesh.scale))
    except ValueError:
        warnings.warn(
            f"cannot read the object's mesh {shape.mesh.file}: the replay shows a box "
            "with the object's inertia instead",
            stacklevel=2,
        )
        return _inertia_box(spec.mass, spec.inertia_matrix())


def _visual_file(item: pin.GeometryObject) -> Mesh | None:
    path = Path(item.meshPath)
    colored = read_collada(path) if path.suffix.lower() == ".dae" else None
    return None if colored is None else colored.scaled(item.meshScale)


def _mesh_of_geometry(geometry: coal.CollisionGeometry) -> Mesh:
    match geometry:
        case coal.BVHModelBase():
            return _mesh_of_bvh(geometry)
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
    pose = np.eye(4)
    pose[:3, 3] = (low + high) / 2
    return box(high - low).moved(pose)


def _mesh_of_bvh(model: coal.BVHModelBase) -> Mesh:
    corners = (model.tri_indices(i) for i in range(model.num_tris))
    triangles = [(t[0], t[1], t[2]) for t in corners]
    return Mesh(np.array(model.vertices()), np.array(triangles, int).reshape(-1, 3))


def _inertia_box(mass: float, inertia: np.ndarray) -> Mesh:
    """Return the uniform box with the given `inertia` about its centre, shape (3, 3)."""
    moments, axes = np.linalg.eigh(inertia)
    squares = 6 / mass * (moments.sum() - 2 * moments)  # of the sides
    pose = np.eye(4)
    pose[:3, :3] = axes * np.sign(np.linalg.det(axes))
    longest = np.sqrt(squares.max())
    return box(np.sqrt(np.maximum(squares, (0.01 * longest) ** 2))).moved(pose)
