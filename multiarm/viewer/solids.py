"""Boxes and solids of revolution as meshes, the one form in which shapes reach the browser.

They are meshes like those read from a file, so that one piece of code shades, tints, measures and
sends them all. Solids of revolution share one generator: a profile (radius, height) turned about
the z axis gives the cylinder, cone, sphere, capsule and arrow. (That of trimesh leaves out
triangles below 1e-8 m^2, of which the marks of small objects consist.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from multiarm.geometry.triangle_mesh import UNIT_CUBE, TriangleMesh, without_slivers

SEGMENTS = 40  # around the axis of a solid of revolution
Z_TO_X = np.eye(4)[[2, 0, 1, 3]]  # turns z -> x -> y -> z


def box(lengths: ArrayLike) -> TriangleMesh:
    """Return a box with full side `lengths`, shape (3,) [m], centred at the origin."""
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh((UNIT_CUBE - 0.5) * np.asarray(lengths, float), np.array(triangles))


def cylinder(radius: float, height: float) -> TriangleMesh:
    """Return a cylinder along z, centred at the origin [m]."""
    h = height / 2
    return revolve([(0, -h), (radius, -h), (radius, h), (0, h)])


def cone(radius: float, height: float) -> TriangleMesh:
    """Return a cone along z: base at -height/2, apex at +height/2 [m]."""
    return revolve([(0, -height / 2), (radius, -height / 2), (0, height / 2)])


def capsule(radius: float, length: float) -> TriangleMesh:
    """Return a capsule along z, centred; `length` [m] is that of the cylinder between the caps."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 2 * (SEGMENTS // 4) + 2)
    shift = np.where(angle < 0, -length / 2, length / 2)
    return revolve(np.column_stack([radius * np.cos(angle), radius * np.sin(angle) + shift]))


def sphere(radius: float) -> TriangleMesh:
    """Return a sphere centred at the origin [m]."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS // 2 + 1)
    return revolve(radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def revolve(profile: ArrayLike) -> TriangleMesh:
    """Turn a profile of (radius, height) points, bottom to top, shape (P, 2) [m], about z."""
    points = np.asarray(profile, float)
    turn = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SEGMENTS)])
    rings = points[:, None, :1] * around + points[:, None, 1:] * [0, 0, 1]  # (P, S, 3)
    ring, step = np.meshgrid(np.arange(len(points) - 1), np.arange(SEGMENTS), indexing="ij")
    a = ring * SEGMENTS + step
    b = ring * SEGMENTS + (step + 1) % SEGMENTS
    c, d = a + SEGMENTS, b + SEGMENTS
    triangles = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    return without_slivers(TriangleMesh(rings.reshape(-1, 3), triangles))
