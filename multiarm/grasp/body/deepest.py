r"""The deepest point: the centre of the largest ball inside half-spaces, or circle in a polygon.

With outward unit normals in the rows :math:`n_k` it is a linear program,

.. math::
    \text{maximise } r \quad \text{subject to} \quad n_k \cdot x + r \le h_k .

Between parallel sides balls of the same size fit at many places, and rounding would choose one of
their centres.  The points that are nearly as deep are a polytope, small or as long as the parallel
sides are; its centroid is taken, which moves with the sides continuously.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multiarm.programs import LinearSolution, linear_program

if TYPE_CHECKING:
    from shapely.geometry import Polygon

# Depths that differ by this part count as equal.
NEARLY = 1e-4
# Coordinates of a body of size 1 about a point in its middle are below this.
BOUND = 2.0
# The largest circle of a shape that is not convex is known up to this part of the shape's size.
SEARCHED = 1e-4
# A shape is convex when its hull has no more area, but for this part.
CONVEX = 1e-9


def largest_ball(
    rows: np.ndarray, levels: np.ndarray, within: float | None = None
) -> LinearSolution:
    """Maximise r >= 0 with ``rows x + r <= levels``; ``x`` of the solution is [x; r].

    For outward unit normals in the rows, x is the centre of a largest ball inside.  ``within``
    bounds each coordinate, either way.
    """
    dimensions = rows.shape[1]
    bounds = [(None if within is None else -within, within)] * dimensions + [(0.0, None)]
    A = np.column_stack([rows, np.ones(len(rows))])
    cost = np.append(np.zeros(dimensions), -1.0)
    return linear_program(cost, at_most=(A, levels), bounds=bounds)


def deepest_point(rows: np.ndarray, levels: np.ndarray, least: float = 0.0) -> np.ndarray | None:
    """The deepest point inside half-spaces that bound a body, of size about 1.

    Parameters
    ----------
    rows : ndarray, shape (K, 2) or (K, 3)
        Outward unit normals.
    levels : ndarray, shape (K,)
    least : float
        Balls that are not larger count as none.

    Returns
    -------
    ndarray, shape (2,) or (3,), or None
        The middle of the centres of largest balls; None where there is no ball.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    ball = largest_ball(rows, levels, within=BOUND)
    if ball.x is None or not ball.x[-1] > least:
        return None
    inside, radius = ball.x[:-1], ball.x[-1]
    rooms = (levels - rows @ inside - (1.0 - NEARLY) * radius) / radius
    try:
        corners = HalfspaceIntersection(np.column_stack([rows, -rooms]), np.zeros(inside.size))
        hull = ConvexHull(corners.intersections)
    except QhullError:  # a ball so small that its surroundings are flat but for rounding
        return inside
    pyramids = hull.points[hull.simplices]  # with their tips at `inside`
    volumes = np.abs(np.linalg.det(pyramids))
    centroid = volumes @ pyramids.sum(axis=1) / (volumes.sum() * (inside.size + 1))
    return inside + radius * centroid


def middle_of(shape: Polygon) -> np.ndarray:
    """The deepest point (2,) of a plane shape [m]."""
    import shapely

    size = float(np.ptp(np.reshape(shape.bounds, (2, 2)), axis=0).max())
    if not shape.interiors and shape.convex_hull.area <= (1.0 + CONVEX) * shape.area:
        corners = np.array(
            shapely.remove_repeated_points(shapely.orient_polygons(shape)).exterior.coords
        )
        middle = corners[:-1].mean(axis=0)
        ends = (corners - middle) / size
        along = np.diff(ends, axis=0)
        normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
        deepest = deepest_point(normals, np.sum(normals * ends[:-1], axis=1))
        if deepest is not None:
            return middle + size * deepest
    circle = shapely.maximum_inscribed_circle(shape, tolerance=SEARCHED * size)
    return np.array(circle.coords[0])
