"""Where to stand so that everything is in the picture, all the time.

A point p is inside a picture of half-angle tangents (t_x, t_y), seen from distance d along the
unit direction f towards the target c, when

    |(p - c) . right| <= t_x (d + (p - c) . f),    |(p - c) . up| <= t_y (d + (p - c) . f),

which is linear in d: the smallest distance that holds every point is a maximum over the points.
The target starts at the middle of the points and is moved until the picture is centred.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FIELD_OF_VIEW = 26.0  # vertical [deg]; a long lens keeps parallels nearly parallel
ASPECT = 1.6  # width / height of the picture that is framed
MARGIN = 0.82  # of the picture that the scene may fill; the rest is for title and time bar
LIFT = 0.03  # of the picture's half height: the time bar is taller than the title
AZIMUTH, ELEVATION = np.deg2rad(-58.0), np.deg2rad(22.0)


@dataclass(frozen=True)
class Camera:
    """A camera that looks from `position` at `target`, shape (3,), world [m], z upwards."""

    position: np.ndarray
    target: np.ndarray

    @property
    def distance(self) -> float:
        """Distance from the camera to its target [m]."""
        return float(np.linalg.norm(self.position - self.target))


def frame(points: np.ndarray) -> Camera:
    """Return a three-quarter view, from the front right and above, that holds all `points`.

    Parameters
    ----------
    points : array, shape (P, 3)
        World positions [m].
    """
    towards, right, up = view_axes(AZIMUTH, ELEVATION)
    tan_y = np.tan(np.deg2rad(FIELD_OF_VIEW) / 2) * MARGIN
    tan_x = tan_y * ASPECT
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = 0.0
    for _ in range(8):
        x, y, depth = ((points - target) @ axis for axis in (right, up, towards))
        distance = max((np.abs(x) / tan_x - depth).max(), (np.abs(y) / tan_y - depth).max())
        x_seen, y_seen = x / (distance + depth), y / (distance + depth)
        target = (
            target
            + (x_seen.min() + x_seen.max()) / 2 * distance * right
            + (y_seen.min() + y_seen.max()) / 2 * distance * up
        )
    target = target - LIFT * tan_y * distance * up
    return Camera(target - distance * towards, target)


def view_axes(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit vectors (towards the scene, right, up) of a view with z upwards."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    towards = -np.array([ca * ce, sa * ce, se])
    right = np.array([-sa, ca, 0.0])
    return towards, right, np.cross(right, towards)
