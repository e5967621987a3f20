r"""Seven fingertips, each in its own convex region: placements, cells, affine wrenches.

A placement is seven pairs of face coordinates y, shape (7, 2), in units of the body's size from the
middle of each region. On a face the wrench is affine in them,

.. math:: w_i(y) = w_i^0 + \sum_a y_a w_i^a, \qquad w_i^a = \begin{bmatrix} 0 \\ t_a \times e_i
          \end{bmatrix},

moments about the middle of the body over its size. A cell is a convex polygon (V, 2) in a region; a
tree of cells covers all placements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from multiarm.grasp.contacts import wrenches_of
from multiarm.grasp.touch_regions import TouchRegion

# Points this part of the body's size outside a region still are in it.
ROUNDING = 1e-12
# Forces balance within this.
BALANCED = 1e-9


@dataclass(frozen=True, eq=False)
class SevenTouches:
    """Regions of seven fingertips, in scaled coordinates.

    Attributes
    ----------
    regions : tuple of TouchRegion
    normals : ndarray, shape (7, 3)
        Into the body.
    middles : ndarray, shape (7, 3)
        Origins of the face coordinates, from the middle of the body over its size.
    tangents : ndarray, shape (7, 2, 3)
    base, rates : ndarray, shape (7, 6) and (7, 2, 6)
        ``w_i^0`` and ``w_i^a``.
    cells : tuple of ndarray, shape (V, 2)
        The outer regions, which contain all that can be touched.
    inner : tuple of ndarray, shape (V, 2)
        The inner regions, in which placements lie.
    sides, limits : ndarray, shape (7, H, 2) and (7, H)
        The inner regions as ``sides @ y <= limits``; filled up with rows that always hold.
    """

    regions: tuple[TouchRegion, ...]
    normals: np.ndarray
    middles: np.ndarray
    tangents: np.ndarray
    base: np.ndarray
    rates: np.ndarray
    cells: tuple[np.ndarray, ...]
    inner: tuple[np.ndarray, ...]
    sides: np.ndarray
    limits: np.ndarray

    @cached_property
    def generators(self) -> np.ndarray:
        """Vertices of ``b >= 0, sum b_i e_i = 0, sum b_i = 1``: balances of forces, (B, 7)."""
        found: dict[tuple[float, ...], np.ndarray] = {}
        for size in (2, 3, 4):
            for chosen in combinations(range(7), size):
                rows = np.vstack([self.normals[list(chosen)].T, np.ones(size)])
                s = np.linalg.svd(rows, compute_uv=False)
                b, *_ = np.linalg.lstsq(rows, np.r_[np.zeros(3), 1.0], rcond=None)
                fits = np.abs(rows @ b - np.r_[np.zeros(3), 1.0]).max() < BALANCED
                if fits and s[-1] > BALANCED and b.min() > BALANCED:
                    full = np.zeros(7)
                    full[list(chosen)] = b
                    found[tuple(np.round(full, 9))] = full
        return np.array(list(found.values())).reshape(-1, 7)

    def points(self, y: np.ndarray) -> np.ndarray:
        """Scaled points (..., 7, 3) of placements (..., 7, 2)."""
        return self.middles + np.einsum("...ia,iax->...ix", y, self.tangents)

    def wrenches(self, y: np.ndarray) -> np.ndarray:
        """Wrenches (..., 7, 6), one in a row."""
        return self.base + np.einsum("...ia,iaf->...if", y, self.rates)

    def towards(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """``end``, or where the way to it from ``start`` (inside) leaves the inner regions."""
        way = end - start
        speed = np.einsum("iha,...ia->...ih", self.sides, way)
        room = (self.limits - np.einsum("iha,...ia->...ih", self.sides, start)).clip(0.0)
        part = np.where(speed > 1e-300, room / np.maximum(speed, 1e-300), np.inf)
        return start + part.min(axis=-1).clip(0.0, 1.0)[..., None] * way

    def within(self, y: np.ndarray) -> np.ndarray:
        """Placements (..., 7, 2) drawn into the inner regions along the line to their middles."""
        return self.towards(np.zeros_like(y), y)

    def drawn(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random placements (count, 7, 2), more of them near the corners of the regions."""
        each = [rng.dirichlet(np.full(len(c), 0.5), count) @ c for c in self.inner]
        return np.stack(each, axis=1)


def seven_touches(regions: Sequence[TouchRegion], middle: np.ndarray, size: float) -> SevenTouches:
    """Scaled coordinates of seven regions of a body with this middle and size."""
    normals = np.array([region.normal for region in regions])
    middles = np.array([(region.inner.mean(axis=0) - middle) / size for region in regions])
    tangents = np.array([_tangents(e) for e in normals])
    flat = [
        tuple(
            ((corners - middle) / size - origin) @ t.T
            for corners, origin, t in zip(sets, middles, tangents, strict=True)
        )
        for sets in ([r.outer for r in regions], [r.inner for r in regions])
    ]
    sides, limits = _half_planes(flat[1])
    moments = np.cross(tangents, normals[:, None])
    return SevenTouches(
        regions=tuple(regions),
        normals=normals,
        middles=middles,
        tangents=tangents,
        base=wrenches_of(middles, normals).T,
        rates=np.concatenate([np.zeros_like(moments), moments], axis=2),
        cells=flat[0],
        inner=flat[1],
        sides=sides,
        limits=limits,
    )


def halves(cell: np.ndarray, direction: np.ndarray, level: float) -> list[np.ndarray]:
    """The two parts of a convex polygon (V, 2) on either side of ``direction . y = level``."""
    parts = []
    height = cell @ direction - level
    after, next_height = np.roll(cell, -1, axis=0), np.roll(height, -1)
    for sign in (1.0, -1.0):
        corners = []
        for y, h, z, k in zip(cell, sign * height, after, sign * next_height, strict=True):
            if h <= 0.0:
                corners.append(y)
            if h * k < 0.0:
                corners.append(y + h / (h - k) * (z - y))
        if len(corners) >= 3:
            parts.append(np.array(corners))
    return parts


def sides_of(cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (H, 2) and levels (H,) of the sides of a counter-clockwise polygon."""
    along = np.roll(cell, -1, axis=0) - cell
    length = np.linalg.norm(along, axis=1)
    real = length > ROUNDING
    out = np.stack([along[real, 1], -along[real, 0]], axis=1) / length[real, None]
    return out, np.sum(out * cell[real], axis=1)


def _half_planes(polygons: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    rows = [sides_of(polygon) for polygon in polygons]
    most = max(len(levels) for _, levels in rows)
    sides, limits = np.zeros((7, most, 2)), np.ones((7, most))
    for i, (out, levels) in enumerate(rows):
        sides[i, : len(out)], limits[i, : len(out)] = out, levels
    return sides, limits


def _tangents(e: np.ndarray) -> np.ndarray:
    """Axes in the face, so that polygons counter-clockwise from outside stay so."""
    first = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(-e, first)])
