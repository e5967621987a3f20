"""The surfaces that touch, drawn where the contacts of a joint have them.

A surface that goes on for ever is shown around the place where it is touched at the start, and of
one with a patch only the patch; a user's surface is shown when it is a parametrisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.contacts.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    TORUS,
    Contact,
    Surface,
)
from multiarm.contacts.smooth import ParametricSurface
from multiarm.dynamics.contact_geometry import contact_places
from multiarm.results.channels import OPEN
from multiarm.viewer.film import Body
from multiarm.viewer.mesh import Mesh
from multiarm.viewer.touching import row_states, rows_of

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

# Joints whose surfaces are things that one could touch, rather than ways to write a hinge.
SHOWN = ("contacts", "point_on_plane", "point_on_cylinder", "point_on_sphere")
OPACITY = 0.45
# Squares of a grid along each of its two directions.
CELLS = 40


def surface_bodies(
    system: System,
    trajectory: Trajectory,
    rows: np.ndarray,
    colors: dict[str, np.ndarray],
    faces: bool = True,
) -> list[Body]:
    """Return the contact surfaces of all joints of the ``SHOWN`` kinds at some samples (`rows`).

    Plane faces of the object only where ``faces`` asks for them.
    """
    on_object = trajectory.object_position[rows], trajectory.object_quaternion_xyzw[rows]
    extent = max(np.ptp(trajectory.object_position, axis=0).max(), object_size(system))
    bodies = []
    for joint in system.scene.joints:
        if joint.kind not in SHOWN:
            continue
        name, arm = joint.arm, system.arms[joint.arm]
        angles = trajectory.joint_positions[name][rows]
        tips = np.array([pin.SE3ToXYZQUAT(pin.SE3(arm.tip_pose(row))) for row in angles])
        poses = {"arm": (tips[:, :3], tips[:, 3:]), "object": on_object}
        records = [record for record in system.contacts[name] if isinstance(record, Contact)]
        touched = _touched(system, name)
        states = row_states(trajectory, name, records, rows)
        for (side, *_), of_it in _surfaces(records).items():
            k = of_it[0]
            if side == "object" and not faces and records[k].object.kind == PLANE:
                continue
            mesh = surface_mesh(getattr(records[k], side), touched[side][k], extent)
            if mesh is None:
                continue
            met = None if states is None else (states[:, of_it] != OPEN).any(axis=1)
            path = f"surfaces/{name}/{k + 1}_{side}"
            bodies.append(Body(path, mesh, *poses[side], colors[name], OPACITY, met))
    return bodies


def _surfaces(contacts: Sequence[Contact]) -> dict[tuple, list[int]]:
    """Return which contacts each surface has: the same surface may be touched at many points."""
    found: dict[tuple, list[int]] = {}
    for k, contact in enumerate(contacts):
        for side in ("arm", "object"):
            surface: Surface = getattr(contact, side)
            key = (side, surface.kind, surface.origin.tobytes(), surface.axes.tobytes())
            found.setdefault(key, []).append(k)
    return found


def surface_mesh(surface: Surface, touched: np.ndarray, extent: float) -> Mesh | None:
    """Return a surface as triangles in its body's frame; None where there is nothing to draw.

    Parameters
    ----------
    surface : Surface
    touched : array, shape (3,)
        Where it is touched at the start, in its body's frame [m].
    extent : float
        How far an endless surface is shown [m].
    """
    around = surface.axes.T @ (touched - surface.origin)
    points = _grid(surface, around, 0.5 * extent)
    if points is None:
        return None
    vertices = points.reshape(-1, 3) @ surface.axes.T + surface.origin
    triangles = _triangles()
    if surface.patch is not None:
        inside = np.array([surface.patch.excess(p) <= 0.0 for p in vertices])
        triangles = triangles[inside[triangles].all(axis=1)]
    if not len(triangles):
        return None
    return Mesh(vertices, triangles[:, ::-1] if surface.inside else triangles)


def _grid(surface: Surface, around: np.ndarray, reach: float) -> np.ndarray | None:
    """Return points of a surface in its own frame, shape (CELLS + 1, CELLS + 1, 3)."""
    a, b, c = surface.sizes
    line = np.linspace(-1.0, 1.0, CELLS + 1)
    turn, tilt = np.meshgrid(np.pi * line, 0.5 * np.pi * line, indexing="ij")
    _, along = np.meshgrid(line, line, indexing="ij")
    cosine, sine = np.cos(turn), np.sin(turn)
    if surface.kind == PLANE:
        x, y = np.meshgrid(line, line, indexing="ij")
        return np.stack([around[0] + reach * x, around[1] + reach * y, np.zeros_like(x)], -1)
    if surface.kind == CYLINDER:
        return np.stack([a * cosine, a * sine, around[2] + reach * along], -1)
    if surface.kind == CONE:
        way = 0.5 * (1.0 + along) * (np.linalg.norm(around) + reach)
        return np.stack([way * a * cosine, way * a * sine, way * b], -1)
    if surface.kind == TORUS:
        out = a + b * np.cos(2.0 * tilt)
        return np.stack([out * cosine, out * sine, b * np.sin(2.0 * tilt)], -1)
    if surface.kind in (SPHERE, ELLIPSOID):
        semi = (a, a, a) if surface.kind == SPHERE else (a, b, c)
        if not a > 0.0:
            return None  # a point: its contact has a mark of its own
        unit = np.stack([np.cos(tilt) * cosine, np.cos(tilt) * sine, np.sin(tilt)], -1)
        return unit * np.array(semi)
    if isinstance(surface.function, ParametricSurface):
        return surface.function.grid(CELLS)
    return None


def _triangles() -> np.ndarray:
    """Two triangles for each square of a grid."""
    i, j = np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij")
    a = i * (CELLS + 1) + j
    b, c, d = a + CELLS + 1, a + CELLS + 2, a + 1
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def _touched(system: System, name: str) -> dict[str, np.ndarray]:
    """Return the contact points of an arm at the start, by side, in that body's frame (N, 3)."""
    start = system.initial_state()
    rows = [k for k in rows_of(system, name) if isinstance(system.model.records[k], Contact)]
    with system.borrow() as data:
        points = contact_places(data, start)[0][rows]
    quaternion, position = pin.Quaternion(start.object_quaternion_xyzw), start.object_position
    tip = system.arms[name].tip_pose(start.joint_positions[name])
    return {
        "arm": (points - tip[:3, 3]) @ tip[:3, :3],
        "object": (points - position) @ quaternion.toRotationMatrix(),
    }


def object_size(system: System) -> float:
    """Return the radius of gyration of the object [m], about its half size."""
    spec = system.scene.object
    return float(np.sqrt(np.trace(spec.inertia_matrix()) / spec.mass))
