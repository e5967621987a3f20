"""The deepest point: closed forms, an independent search, and symmetry."""

import numpy as np
import pytest
import shapely
from scipy.spatial import ConvexHull

from multiarm.grasp.body.deepest import deepest_point, middle_of


def half_spaces(points):
    """Outward unit normals and levels of the hull of points."""
    equations = ConvexHull(points).equations
    return equations[:, :-1], -equations[:, -1]


def turned(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 2.6])
@pytest.mark.parametrize("size", [1e-5, 1.0, 300.0])
def test_between_parallel_edges_the_deepest_point_is_in_the_middle(angle, size):
    """All points (x, 0.5) with 0.5 <= x <= 2.5 are as deep; rounding must not choose."""
    corners = size * (np.array([[0, 0], [3, 0], [3, 1], [0, 1]]) + 7.0) @ turned(angle).T
    expected = size * (np.array([1.5, 0.5]) + 7.0) @ turned(angle).T
    middle = middle_of(shapely.Polygon(corners))
    np.testing.assert_allclose(middle, expected, atol=1e-10 * size)


def test_in_a_flat_box_the_deepest_point_is_the_centre():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 0.8) for z in (0, 0.2)])
    np.testing.assert_allclose(deepest_point(*half_spaces(corners)), [0.5, 0.4, 0.1], atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_of_a_body_without_parallel_sides_it_is_the_centre_of_the_largest_ball(seed):
    """Against a search by shapely in the plane: none of its cells is deeper."""
    points = np.random.default_rng(seed).normal(size=(9, 2))
    shape = shapely.MultiPoint(points).convex_hull
    size = float(np.ptp(points, axis=0).max())
    radius = shapely.maximum_inscribed_circle(shape, tolerance=1e-7 * size).length
    depth = shapely.distance(shape.boundary, shapely.Point(middle_of(shape)))
    assert depth == pytest.approx(radius, rel=2e-4) and depth <= radius + 1e-6 * size


@pytest.mark.parametrize("seed", range(4))
def test_it_moves_with_the_body(seed):
    rng = np.random.default_rng(seed)
    points, rotation = rng.normal(size=(12, 3)), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    expected = deepest_point(*half_spaces(0.2 * points)) @ rotation.T
    np.testing.assert_allclose(
        deepest_point(*half_spaces(0.2 * points @ rotation.T)), expected, atol=1e-9
    )


def test_a_shape_that_is_not_convex_has_its_deepest_point_inside():
    ell = shapely.Polygon([(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (0, 2)])
    point = shapely.Point(middle_of(ell))
    assert ell.contains(point)
    assert ell.boundary.distance(point) == pytest.approx(2.0 - np.sqrt(2.0), rel=1e-3)


def test_half_spaces_without_a_common_point_have_none():
    rows, levels = np.array([[1.0, 0.0], [-1.0, 0.0], [0, 1], [0, -1]]), -np.ones(4)
    assert deepest_point(rows, levels) is None
