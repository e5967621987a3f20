r"""Solids between triangles: mass properties, convex hulls, nearest points.

Volume, centre and inertia of a solid are sums over the signed tetrahedra between a point inside and
the triangles :math:`(v_1, v_k, v_{k+1})` of the loops around its faces; those of dents and of
holes, whose loops run the other way round, are negative, so that no face has to be cut up.  With
corners a, b, c of a triangle about the point and :math:`s = a + b + c`

.. math::
    V = \sum \tfrac{1}{6} a \cdot (b \times c), \qquad
    \int x \, dV = \sum \tfrac{V_i}{4} s, \qquad
    \int x x^T dV = \sum \tfrac{V_i}{20} (a a^T + b b^T + c c^T + s s^T).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# A body thinner than this part of its size is flat: its corners may be given in single precision.
_FLAT = 1e-6
TOO_THIN = (
    "the body is thinner than its coordinates resolve, about a millionth of its size: give it "
    "more thickness"
)


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of a solid of constant density.

    Attributes
    ----------
    mass : float
        [kg]
    centre : ndarray, shape (3,)
        Centre of mass in the body's frame [m].
    inertia : ndarray, shape (3, 3)
        About the centre of mass, in the body's axes [kg m^2].
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Moments:
    """Moments of the volume of a solid.

    Attributes
    ----------
    volume : float
        [m^3]
    centre : ndarray, shape (3,)
        [m]
    second : ndarray, shape (3, 3)
        Integral of ``x x^T`` about the centre [m^5].
    """

    volume: float
    centre: np.ndarray
    second: np.ndarray

    def of_mass(self, mass: float) -> MassProperties:
        """Mass properties when a mass is spread evenly over the volume."""
        inertia = np.trace(self.second) * np.eye(3) - self.second
        return MassProperties(mass, self.centre, inertia * (mass / self.volume))


def moments(vertices: np.ndarray, loops: Sequence[Sequence[int]] | np.ndarray) -> Moments:
    """Moments of the solid that loops of corners (V, 3) bound."""
    middle = vertices.mean(axis=0)
    fans = [(loop[0], loop[k], loop[k + 1]) for loop in loops for k in range(1, len(loop) - 1)]
    corners = (vertices - middle)[np.array(fans)]  # (T, 3 corners, 3)
    volumes = np.linalg.det(corners) / 6.0
    sums = corners.sum(axis=1)
    volume = float(volumes.sum())
    centre = volumes @ sums / (4.0 * volume) if volume else np.zeros(3)
    about = np.einsum("t,tki,tkj->ij", volumes, corners, corners)
    about += np.einsum("t,ti,tj->ij", volumes, sums, sums)
    return Moments(volume, centre + middle, about / 20.0 - volume * np.outer(centre, centre))


def hull_triangles(points: np.ndarray) -> np.ndarray:
    """Triangles (T, 3), seen counter-clockwise from outside, of the convex hull of points (N, 3).

    Raises
    ------
    ValueError
        When the hull has no thickness.
    """
    from scipy.spatial import ConvexHull, QhullError

    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    size = float(np.ptp(points, axis=0).max())
    try:
        hull = ConvexHull((points - middle) / (size or 1.0))
    except QhullError as error:
        raise ValueError(
            "the points of a hull lie in a plane, or there are fewer than four of them: they "
            "enclose no volume"
        ) from error
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3:]
    depths = (normals @ hull.points.T + offsets).min(axis=1)  # below each face
    if depths.max() > -_FLAT:
        raise ValueError(TOO_THIN)
    triangles = hull.simplices.copy()
    a, b, c = np.moveaxis(hull.points[triangles], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * normals, axis=1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles


def hull_mass_properties(points: np.ndarray, mass: float) -> MassProperties:
    """Mass properties of the convex hull of points (N, 3) [m] of uniform density, ``mass`` [kg]."""
    return moments(points, hull_triangles(points)).of_mass(mass)


def nearest_in(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The point nearest to ``point`` (3,) of the solid inside triangles (T, 3), seen from outside.

    Inside the solid angles of the triangles add up to a full one: with corners a, b, c about the
    point, each is 2 atan2(a . (b x c), |a||b||c| + a.b |c| + b.c |a| + c.a |b|).
    """
    import trimesh

    corners = vertices[triangles]
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    ab, bc, ca = (np.sum(u * v, axis=1) for u, v in ((a, b), (b, c), (c, a)))
    volume = np.sum(a * np.cross(b, c), axis=1)
    angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum()
    if angle > 2.0 * np.pi:  # half of a full one
        return point
    near = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
    return near[np.argmin(np.sum((near - point) ** 2, axis=1))]


def hull_corners(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points, shape (n, 3), without those on its faces and edges.

    Raises
    ------
    ValueError
        When the points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError as error:
        raise ValueError("the points lie in a plane") from error
    corners = []
    for vertex in hull.vertices:
        normals = hull.equations[np.any(hull.simplices == vertex, axis=1), :3]
        if np.linalg.svd(normals, compute_uv=False)[-1] > 1e-6:  # three faces that differ
            corners.append(points[vertex])
    return np.array(corners)
