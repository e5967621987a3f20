r"""Hands that come to a body on the floor from above.

A hand comes along a unit vector d that clears all faces it touches, :math:`e_j \cdot d > 0` for
their inward normals, and goes down.  The vector of

.. math:: \min |y| \quad\text{with}\quad e_j \cdot y \ge 1, \quad -e_z \cdot y \ge s

clears them best for a descent s.
"""

from __future__ import annotations

import numpy as np

from multiarm.programs import least_distance

# How steeply hands come down at least, over their clearance of the faces that they touch.
DESCENTS = (0.3, 0.7, 1.5)


def approach_from_above(
    inward: np.ndarray, down: np.ndarray, descent: float = DESCENTS[0]
) -> np.ndarray | None:
    """The unit vector (3,) along which a hand comes to faces, None where it does not clear them.

    Parameters
    ----------
    inward : ndarray, shape (N, 3)
        Normals of the faces, into the body.
    down : ndarray, shape (3,)
        Unit vector, in the same axes.
    descent : float
    """
    from multiarm.grasp.scenes.hands import LEAST_CLEARANCE

    shortest = least_distance(np.vstack([inward, down]), np.append(np.ones(len(inward)), descent))
    if not shortest.solved:
        return None
    direction = shortest.point / np.linalg.norm(shortest.point)
    return direction if np.min(inward @ direction) >= LEAST_CLEARANCE else None
