"""The floor of a scene: a slab below its plane, as large as what happens on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from multiarm.viewer.film import Body, rotations
from multiarm.viewer.mesh import box

if TYPE_CHECKING:
    from multiarm.trajectory import Trajectory

COLOR = np.array([0.62, 0.65, 0.69])
# Thickness of the slab over its shorter side, and its margin over the object's size.
THICKNESS, MARGIN = 0.02, 3.0


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


def lowest(body: Body) -> float:
    """Return the height of a resting body's lowest point [m]."""
    turned = body.mesh.vertices @ rotations(body.quaternion_xyzw[:1])[0].T
    return float(body.position[0, 2] + turned[:, 2].min())
