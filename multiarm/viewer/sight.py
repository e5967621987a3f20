"""From where a replay shows its objects best.

The camera looks from the front right, unless robots hide the objects there: then from the nearest
direction around the scene from which enough of them is seen.  Points on the objects, at some times,
are hidden where a part of a robot, or of what carries it, lies before them.  Both are points spread
over surfaces, and compared in the cells of a grid across the direction of sight.
"""

from __future__ import annotations

import numpy as np

from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.viewer.animation import Animation, Body, moving

AZIMUTH, ELEVATION = np.deg2rad(-58.0), np.deg2rad(22.0)
# Directions that are tried, from the usual one [rad], and the parts of what is seen best that will
# do: from the usual one, and from others.
TURNS = np.deg2rad([0, -30, 30, -60, 60, -90, 90, -120, 120, -150, 150, 180])
ENOUGH = np.array([0.8] + 11 * [0.97])
# Frames that are looked at, parts of the scene's size that points and cells are apart, and points
# on a body at most.
FRAMES, SPACING, CELL, MOST_POINTS = 6, 1.0 / 60.0, 1.0 / 30.0, 2000
# A smaller part is seen between the points of large links only: it is hidden.
LEAST_SEEN = 0.3


def clear_azimuth(animation: Animation) -> float:
    """The azimuth [rad] from which the objects of an animation are seen."""
    size, count = animation.size(), len(animation.time)
    frames = np.unique(np.linspace(0, count - 1, FRAMES).astype(int))
    objects = animation.bodies[: animation.objects]
    robots = [body for body in animation.bodies if body.name.startswith(("arms/", "columns/"))]
    if not objects or not robots:
        return AZIMUTH
    of_objects = _places(objects, frames, size)
    of_robots = _places(robots, frames, size)
    if not (of_objects.size and of_robots.size):
        return AZIMUTH
    shares = np.array([_seen(of_objects, of_robots, AZIMUTH + turn, size) for turn in TURNS])
    if shares.max() < LEAST_SEEN:  # hidden from everywhere
        return AZIMUTH
    return AZIMUTH + float(TURNS[np.argmax(shares >= ENOUGH * shares.max())])


def _places(bodies: list[Body], frames: np.ndarray, size: float) -> np.ndarray:
    """Points over the surfaces of bodies at some frames, (K, P, 3) [m]."""
    return np.concatenate(
        [
            moving(
                _spread(body.mesh, SPACING * size),
                body.position[frames],
                body.quaternion_xyzw[frames],
            )
            for body in bodies
        ],
        axis=1,
    )


def _spread(mesh: TriangleMesh, spacing: float) -> np.ndarray:
    """Points about so far apart all over a mesh, (P, 3) [m]."""
    if not len(mesh.triangles):
        return np.zeros((0, 3))
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    reach = np.cumsum(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
    count = int(np.clip(reach[-1] / spacing**2, 1, MOST_POINTS))
    at = np.searchsorted(reach, (np.arange(count) + 0.5) / count * reach[-1])
    u, v = np.random.default_rng(0).random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return a[at] + u * (b - a)[at] + v * (c - a)[at]


def _seen(objects: np.ndarray, robots: np.ndarray, azimuth: float, size: float) -> float:
    """The share of the objects' points that robots do not hide, points (K, P, 3)."""
    towards, right, up = view_axes(azimuth, ELEVATION)
    cell, hidden = CELL * size, 0
    low = np.minimum(objects.min(axis=(0, 1)), robots.min(axis=(0, 1)))
    high = np.maximum(objects.max(axis=(0, 1)), robots.max(axis=(0, 1)))
    corner, across = 0.5 * (low + high), float(np.linalg.norm(high - low))
    sides = 1 + int(across / cell)
    axes = np.array([right, up]).T / cell
    for points, links in zip(objects, robots, strict=True):
        nearest = np.full((sides + 1, sides + 1), np.inf)
        at = ((links - corner) @ axes + 0.5 * sides).astype(int)
        np.minimum.at(nearest, (at[:, 0], at[:, 1]), links @ towards)
        at = ((points - corner) @ axes + 0.5 * sides).astype(int)
        hidden += np.count_nonzero(nearest[at[:, 0], at[:, 1]] < points @ towards - cell)
    return 1.0 - hidden / objects[..., 0].size


def view_axes(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit vectors (towards the scene, right, up) of a view with z upwards."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    towards = -np.array([ca * ce, sa * ce, se])
    right = np.array([-sa, ca, 0.0])
    return towards, right, np.cross(right, towards)
