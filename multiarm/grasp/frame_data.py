"""Data for the pose of a body from its contacts: points, planes, polygons, noise.

Points are kept from their mean, planes from the point of the body that lies nearest to all of them:
a body far from the origin of its own frame, or far from that of the world, loses no digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.contacts import UNIT_TOLERANCE

# Normals span space when the third singular value is above this part of the first.
SPANNING = 1e-9
# A covariance is symmetric and not negative within this part of its largest entry.
COVARIANCE_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ContactData:
    """Contacts on faces of a body whose pose is sought.

    Attributes
    ----------
    points : ndarray, shape (N, 3)
        Contact points less ``centre``, world axes [m].
    normals : ndarray, shape (N, 3)
        Outward normals of the faces, object axes.
    offsets : ndarray, shape (N,)
        Offsets of the faces from ``origin`` [m].
    centre : ndarray, shape (3,)
        Mean of the points in the world [m].
    origin : ndarray, shape (3,)
        The point of the body, in its own frame, that offsets count from [m].
    length : float
        Root mean square distance of the points from their mean [m].
    polygons : tuple of ndarray, shape (K, 3), or None
        Corners of each contact's face less ``origin``.
    convex : bool
        Whether the body lies on the inner side of all its faces.
    covariance : ndarray, shape (N, 3, 3), or None
        Of the points, world axes [m^2].
    """

    points: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    centre: np.ndarray
    origin: np.ndarray
    length: float
    polygons: tuple[np.ndarray, ...] | None
    convex: bool
    covariance: np.ndarray | None

    @property
    def count(self) -> int:
        """Number N of contacts."""
        return len(self.points)

    @property
    def deviation(self) -> float:
        """Largest standard deviation of a point in any direction [m]; 0 if none is known."""
        if self.covariance is None:
            return 0.0
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[:, -1].max().clip(0.0)))

    def variances(self, R: np.ndarray) -> np.ndarray:
        """Variance of each residual, ``n^T Sigma n`` [m^2], shape (N,); 0 if not known."""
        if self.covariance is None:
            return np.zeros(self.count)
        n = self.normals @ R.T
        return np.einsum("ka,kab,kb->k", n, self.covariance, n).clip(0.0)

    def position(self, R: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Origin of the body's frame in the world, by weighted least squares, shape (3,)."""
        gaps = np.sum(self.normals * (self.points @ R), axis=1) - self.offsets
        rows = weights[:, None] * self.normals
        y = np.linalg.lstsq(rows, weights * gaps, rcond=None)[0]
        return self.centre + R @ (y - self.origin)

    def in_body(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Points in the body's frame, from ``origin``, shape (N, 3)."""
        return (self.points + (self.centre - x)) @ R - self.origin

    def residuals(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Distances from the planes, outside positive [m], shape (N,)."""
        return np.sum(self.normals * self.in_body(R, x), axis=1) - self.offsets

    def jacobian(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Rows ``-[n, (p - x) x n]`` in world axes, shape (N, 6)."""
        n = self.normals @ R.T
        return -np.hstack([n, np.cross(self.points + (self.centre - x), n)])


def contact_data(
    points: Any,
    normals: Any,
    offsets: Any,
    *,
    polygons: Sequence[Any] | None = None,
    convex: bool = True,
    point_covariance: Any = None,
) -> ContactData:
    """Check and centre the caller's data.

    Raises
    ------
    GraspError
        Shapes, numbers that are not finite, fewer than six contacts, normals that do not span.
    """
    p = table_of(points, "points")
    n = _unit_normals(table_of(normals, "normals"))
    h = np.asarray(offsets, dtype=float)
    if len(p) < 6:
        raise GraspError(f"six contacts at least fix a pose; {len(p)} were given")
    if n.shape != p.shape or h.shape != (len(p),) or not np.all(np.isfinite(h)):
        raise GraspError(
            f"{len(p)} points need as many normals and finite offsets; the shapes are {n.shape} "
            f"and {h.shape}"
        )
    singular = np.linalg.svd(n, compute_uv=False)
    if singular[2] <= SPANNING * singular[0]:
        raise GraspError(
            "the normals of the touched faces lie in one plane: the body can slide along the "
            "direction perpendicular to them; touch a face across it"
        )
    centre = p.mean(axis=0)
    p = p - centre
    length = float(np.sqrt(np.mean(np.sum(p * p, axis=1))))
    if length == 0.0:
        raise GraspError("all contact points coincide; contacts on different faces are needed")
    origin = np.linalg.lstsq(n, h, rcond=None)[0]
    return ContactData(
        points=p,
        normals=n,
        offsets=h - n @ origin,
        centre=centre,
        origin=origin,
        length=length,
        polygons=_polygons(polygons, len(p), origin),
        convex=convex,
        covariance=_covariances(point_covariance, len(p)),
    )


def outside(data: ContactData, R: np.ndarray, x: np.ndarray) -> float:
    """How far some contact lies outside the face that it is said to touch [m]; 0: none does."""
    at = data.in_body(R, x)
    worst = 0.0
    if data.convex:
        worst = max(worst, float((at @ data.normals.T - data.offsets).max()))
    if data.polygons is not None:
        for point, polygon, normal in zip(at, data.polygons, data.normals, strict=True):
            worst = max(worst, _beyond(point, polygon, normal))
    return worst


def table_of(values: Any, what: str) -> np.ndarray:
    """Finite vectors, shape (N, 3), own memory."""
    try:
        table = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{what} are a list of vectors of three numbers") from error
    if table.ndim != 2 or table.shape[1] != 3 or not np.all(np.isfinite(table)):
        raise GraspError(f"{what} have shape (N, 3) and are finite; given: shape {table.shape}")
    return table


def numbers_of(values: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    """A finite array of a given shape."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{what} consists of numbers, shape {shape}") from error
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise GraspError(f"{what} has shape {shape} and finite numbers, not shape {array.shape}")
    return array


def _beyond(point: np.ndarray, polygon: np.ndarray, normal: np.ndarray) -> float:
    """Distance of a point of a plane from a simple polygon in it; 0 inside."""
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u)
    flat = np.array([u, np.cross(normal, u)])
    a = (polygon - point) @ flat.T
    b = np.roll(a, -1, axis=0)
    # A ray along the first axis crosses the boundary an odd number of times from inside.
    crosses = (a[:, 1] > 0.0) != (b[:, 1] > 0.0)
    a_c, b_c = a[crosses], b[crosses]
    where = a_c[:, 0] - a_c[:, 1] * (b_c[:, 0] - a_c[:, 0]) / (b_c[:, 1] - a_c[:, 1])
    if np.count_nonzero(where > 0.0) % 2:
        return 0.0
    edge = b - a
    along = -np.sum(a * edge, axis=1) / np.sum(edge * edge, axis=1).clip(np.finfo(float).tiny)
    nearest = a + along.clip(0.0, 1.0)[:, None] * edge
    return float(np.linalg.norm(nearest, axis=1).min())


def _unit_normals(n: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(n, axis=1)
    wrong = np.flatnonzero(np.abs(lengths - 1.0) > UNIT_TOLERANCE)
    if wrong.size:
        k = int(wrong[0])
        raise GraspError(f"normal {k + 1}, {n[k].tolist()}, has length {lengths[k]:.6g}, not 1")
    return n / lengths[:, None]


def _polygons(
    polygons: Sequence[Any] | None, count: int, origin: np.ndarray
) -> tuple[np.ndarray, ...] | None:
    if polygons is None:
        return None
    if len(polygons) != count:
        raise GraspError(f"{count} contacts need as many polygons, not {len(polygons)}")
    return tuple(table_of(polygon, "corners of a face") - origin for polygon in polygons)


def _covariances(given: Any, count: int) -> np.ndarray | None:
    """Covariance of every point (N, 3, 3) from a deviation, one per point, or matrices."""
    if given is None:
        return None
    value = np.asarray(given, dtype=float)
    if value.shape in ((), (count,)):
        each = np.broadcast_to(value, (count,))
        matrices = each[:, None, None] ** 2 * np.eye(3)
    elif value.shape in ((3, 3), (count, 3, 3)):
        matrices = np.broadcast_to(value, (count, 3, 3)).copy()
    else:
        raise GraspError(
            f"point_covariance is one standard deviation, one for each of the {count} points, or "
            f"covariances of shape (3, 3) or ({count}, 3, 3), not of shape {value.shape}"
        )
    largest = float(np.abs(matrices).max())
    skewed = np.abs(matrices - matrices.transpose(0, 2, 1)).max()
    if not np.all(np.isfinite(matrices)) or skewed > COVARIANCE_ROUNDING * largest:
        raise GraspError("point_covariance must be finite and symmetric")
    if value.ndim < 2 and np.any(value < 0.0):
        raise GraspError("point_covariance: standard deviations are not negative")
    lowest = np.linalg.eigvalsh(matrices)[:, 0]
    if np.any(lowest < -COVARIANCE_ROUNDING * largest):
        raise GraspError("point_covariance has a negative eigenvalue: it is no covariance")
    return matrices
