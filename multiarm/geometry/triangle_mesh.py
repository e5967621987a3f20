"""Meshes of triangles: moved, scaled, merged, and shaded for drawing.

Shading needs a normal per corner. Two faces around a vertex are smoothed together when the angle
between them is below the crease angle, so that a tube looks round and the edges of a box stay
sharp, whatever normals a file carries or lacks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

CREASE_ANGLE = np.deg2rad(40.0)  # [rad]
WELD_DIGITS = 7  # vertices closer than about 1e-7 of the mesh's size are one vertex
UNIT_CUBE = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
"""Corners of the cube from 0 to 1."""


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles in one frame."""

    vertices: np.ndarray  # corners [m], shape (V, 3)
    triangles: np.ndarray  # indices of corners, counter-clockwise seen from outside, shape (T, 3)
    colors: np.ndarray | None = None  # of each triangle, sRGB in 0..1, shape (T, 3); absent: white

    def bounds(self) -> np.ndarray:
        """Return the eight corners of the axis-aligned bounding box, shape (8, 3) [m]."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return np.where(UNIT_CUBE, high, low)

    def moved(self, pose: np.ndarray) -> TriangleMesh:
        """Return the mesh under a homogeneous transform `pose`, shape (4, 4)."""
        return TriangleMesh(
            self.vertices @ pose[:3, :3].T + pose[:3, 3], self.triangles, self.colors
        )

    def shifted(self, offset: ArrayLike) -> TriangleMesh:
        """Return the mesh moved by `offset`, shape (3,) [m]."""
        return TriangleMesh(self.vertices + np.asarray(offset, float), self.triangles, self.colors)

    def scaled(self, factors: ArrayLike) -> TriangleMesh:
        """Return the mesh scaled by `factors`, shape (3,); a mirror image keeps its outside."""
        factors = np.asarray(factors, float)
        triangles = self.triangles if np.prod(factors) > 0 else self.triangles[:, ::-1]
        return TriangleMesh(self.vertices * factors, triangles, self.colors)

    def painted(self, color: np.ndarray) -> TriangleMesh:
        """Return the mesh in one `color`, shape (3,), sRGB in 0..1."""
        return TriangleMesh(self.vertices, self.triangles, np.tile(color, (len(self.triangles), 1)))

    @cached_property
    def shaded(self) -> ShadedMesh:
        """The mesh with its normals, computed once: arms of a kind share meshes."""
        return shade(self)


def merge(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Return one mesh made of several; unpainted parts become white if any other is painted."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    painted = any(m.colors is not None for m in meshes)
    colors = [m.colors if m.colors is not None else np.ones(m.triangles.shape) for m in meshes]
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + start for m, start in zip(meshes, starts, strict=True)]),
        np.concatenate(colors) if painted else None,
    )


def without_slivers(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh without triangles of no area (they have no normal)."""
    area = np.linalg.norm(_face_vectors(mesh), axis=1)
    keep = area > 1e-12 * area.max(initial=0.0)
    colors = None if mesh.colors is None else mesh.colors[keep]
    return TriangleMesh(mesh.vertices, mesh.triangles[keep], colors)


def sharp_edges(mesh: TriangleMesh, crease_angle: float = CREASE_ANGLE) -> np.ndarray:
    """Return the edges at which the surface bends by more than `crease_angle` [rad], or ends.

    Returns
    -------
    array, shape (E, 2, 3)
        Both ends of each edge [m].
    """
    mesh = without_slivers(mesh)
    faces = _face_vectors(mesh)
    unit = faces / np.linalg.norm(faces, axis=1, keepdims=True)
    welded = _welded(mesh)[mesh.triangles]  # (T, 3)
    ends = np.stack([welded, np.roll(welded, -1, axis=1)], axis=-1).reshape(-1, 2)
    corners = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], -1).reshape(-1, 2)
    _, first, edge, count = np.unique(
        np.sort(ends, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    edge, owner = edge.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    total = np.stack([np.bincount(edge, unit[owner, k]) for k in range(3)], axis=1)
    # Two unit normals at an angle a add up to the length 2 cos(a / 2).
    sharp = (count != 2) | (np.linalg.norm(total, axis=1) < 2 * np.cos(crease_angle / 2))
    return mesh.vertices[corners[first[sharp]]]


@dataclass(frozen=True)
class ShadedMesh:
    """Vertices ready for drawing, each with one normal and one colour."""

    vertices: np.ndarray  # [m], shape (V, 3)
    normals: np.ndarray  # unit vectors, shape (V, 3)
    colors: np.ndarray  # sRGB in 0..1, shape (V, 3)
    triangles: np.ndarray  # shape (T, 3)


def shade(mesh: TriangleMesh, crease_angle: float = CREASE_ANGLE) -> ShadedMesh:
    """Give every corner its normal; corners that agree in all respects share a vertex.

    The normal of a corner is the area-weighted mean of the normals of the faces around its vertex
    which are inclined to the corner's own face by less than `crease_angle` [rad].
    """
    mesh = without_slivers(mesh)
    normals = _corner_normals(mesh, crease_angle)  # (3 T, 3)
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    colors = np.ones(mesh.triangles.shape) if mesh.colors is None else mesh.colors
    rows = np.hstack([corners, np.round(normals, 2), np.repeat(colors, 3, axis=0)])
    _, first, index = np.unique(
        rows.astype(np.float32), axis=0, return_index=True, return_inverse=True
    )
    # Numbering vertices by first use keeps neighbours together, which halves the compressed size.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    first = first[order]
    return ShadedMesh(
        corners[first],
        normals[first],
        np.repeat(colors, 3, axis=0)[first],
        rank[index.reshape(-1)].reshape(-1, 3),
    )


def _corner_normals(mesh: TriangleMesh, crease_angle: float) -> np.ndarray:
    faces = _face_vectors(mesh)  # (T, 3), twice the area times the normal
    unit = faces / np.linalg.norm(faces, axis=1, keepdims=True)
    vertex = _welded(mesh)[mesh.triangles].reshape(-1)  # (3 T,)
    # All pairs (corner, neighbour) around a vertex, by blocks of corners sorted by vertex.
    order = np.argsort(vertex, kind="stable")
    starts = np.flatnonzero(np.diff(vertex[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    count = np.repeat(counts, counts)  # of each sorted corner's vertex
    corner = np.repeat(order, count)
    offset = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
    neighbour = order[np.repeat(np.repeat(starts, counts), count) + offset]
    face, adjacent = corner // 3, neighbour // 3
    smooth = np.einsum("ij,ij->i", unit[face], unit[adjacent]) > np.cos(crease_angle)
    corner, adjacent = corner[smooth], adjacent[smooth]
    weighted = faces[adjacent]
    total = np.stack([np.bincount(corner, weighted[:, k], len(order)) for k in range(3)], axis=1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def _welded(mesh: TriangleMesh) -> np.ndarray:
    """Return a number for each vertex, shape (V,), equal for vertices at the same place."""
    places = np.round(mesh.vertices / np.ptp(mesh.vertices, axis=0).max(), WELD_DIGITS)
    return np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)


def _face_vectors(mesh: TriangleMesh) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
