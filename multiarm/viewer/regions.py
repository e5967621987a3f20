"""Where fingertips may go: on each face the region in which a contact keeps the grasp closed.

The region of a contact is that of the start, with all other contacts where they are then; it is
shown for grasps in form closure by contacts that only push, on objects with plane faces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.scenes.reading import SceneGrasp, read_grasp
from multiarm.viewer.film import Body
from multiarm.viewer.mesh import Mesh

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.grasp.seventh_contact import ContactRegion
    from multiarm.results.trajectory import Trajectory

OPACITY = 0.35
# Height over the face in sizes of the object, so that both can be told apart; regions of several
# contacts on one face lie one over the other.
LIFT = 1e-3


def scene_grasp(system: System) -> SceneGrasp | None:
    """The grasp at the start, where there are regions to be shown; else None."""
    if not any(contact.pushes_only for own in system.contacts.values() for contact in own):
        return None
    try:
        grasp = read_grasp(system)
    except GraspError:
        return None
    return grasp if grasp.only_pushes and grasp.closure else None


def region_bodies(
    grasp: SceneGrasp, trajectory: Trajectory, rows: np.ndarray, colors: dict[str, np.ndarray]
) -> list[Body]:
    """The regions of all contacts at some samples (`rows`), as thin sheets on the object."""
    poses = trajectory.object_position[rows], trajectory.object_quaternion_xyzw[rows]
    bodies = []
    layers: dict[int | None, int] = {}
    for (arm, k), face, region in zip(grasp.rows, grasp.faces, grasp.regions, strict=True):
        if region is None or grasp.body is None:
            continue
        layers[face] = layers.get(face, 0) + 1
        mesh = sheet(region, layers[face] * LIFT * grasp.body.size)
        bodies.append(Body(f"regions/{arm}/{k + 1}", mesh, *poses, colors[arm], OPACITY))
    return bodies


def sheet(region: ContactRegion, lift: float) -> Mesh:
    """A region as triangles, lifted off its face by a distance [m]."""
    import shapely

    corners: list[np.ndarray] = []
    triangles = []
    for part in shapely.constrained_delaunay_triangles(region.shape).geoms:
        ring = np.array(part.exterior.coords)[:3]
        if np.cross(*np.pad(np.diff(ring, axis=0), ((0, 0), (0, 1))))[2] < 0.0:
            ring = ring[::-1]
        triangles.append(np.arange(3) + len(corners))
        corners.extend(region.face.at(ring) + lift * region.face.normal)
    return Mesh(np.array(corners), np.array(triangles))
