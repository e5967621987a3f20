"""What stands still: the floor of a scene, and columns under arms whose bases are above it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.viewer.film import Body, rotations
from multiarm.viewer.mesh import box, cylinder

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

COLOR = np.array([0.62, 0.65, 0.69])
# Thickness of the slab over its shorter side, and its margin over the object's size.
THICKNESS, MARGIN = 0.02, 3.0
# Radius of a column over its height, at least and at most [m]; lower ones are not drawn.
SLENDER, THINNEST, THICKEST, LOWEST = 0.2, 0.03, 0.1, 0.02


def ground_bodies(trajectory: Trajectory, rows: np.ndarray, size: float) -> list[Body]:
    """Return the floor at some samples (`rows`) as a body that rests; none where there is none.

    ``size`` is about half that of the object [m].  A floor without end reaches as far as the
    object goes over it, and a little further.
    """
    spec = trajectory.scene.effects.floor
    if spec is None:
        return []
    pose = spec.at.matrix()
    over = (trajectory.object_position - pose[:3, 3]) @ pose[:3, :3]
    middle, sides = np.zeros(3), np.zeros(3)
    if spec.size is None:
        low, high = over.min(axis=0), over.max(axis=0)
        middle[:2] = 0.5 * (low + high)[:2]
        sides[:2] = (high - low)[:2] + 2.0 * MARGIN * size
    else:
        sides[:2] = spec.size
    sides[2] = THICKNESS * sides[:2].min()
    middle[2] = -0.5 * sides[2]
    place = pin.SE3ToXYZQUAT(pin.SE3(pose) * pin.SE3(np.eye(3), middle))
    still = np.tile(place, (len(rows), 1))
    return [Body("floor", box(sides), still[:, :3], still[:, 3:], COLOR)]


def columns(bases: dict[str, np.ndarray], floor: float, frames: int) -> list[Body]:
    """Return a column for each upright base above the floor.

    Parameters
    ----------
    bases : table 'arm: pose (4, 4)'
        In the world.
    floor : float
        Height of the floor [m].
    frames : int
        Of the film.
    """
    bodies = []
    for name, base in bases.items():
        height = float(base[2, 3] - floor)
        if height < LOWEST or base[2, 2] < 0.99:
            continue
        mesh = cylinder(float(np.clip(SLENDER * height, THINNEST, THICKEST)), height)
        middle = np.array([*base[:2, 3], floor + 0.5 * height])
        still = np.tile(np.array([0.0, 0.0, 0.0, 1.0]), (frames, 1))
        bodies.append(Body(f"columns/{name}", mesh, np.tile(middle, (frames, 1)), still, COLOR))
    return bodies


def lowest(body: Body) -> float:
    """Return the height of a resting body's lowest point [m]."""
    turned = body.mesh.vertices @ rotations(body.quaternion_xyzw[:1])[0].T
    return float(body.position[0, 2] + turned[:, 2].min())
