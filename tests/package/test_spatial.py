"""Claims about rotations, charts and wrenches; the oracle is SciPy's Rotation or a difference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mechanics import EPS, first_difference
from scipy.spatial.transform import Rotation

from multiarm.geometry.screws import skew
from multiarm.spatial import (
    difference,
    matrix_to_quaternion,
    quaternion_to_matrix,
    retract,
    write_chart_rate,
    write_chart_rate_slopes,
)

numbers = st.floats(-3.0, 3.0, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
quaternions = (
    st.tuples(numbers, numbers, numbers, numbers)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


def chart_rate(theta, omega):
    out = np.empty(3)
    write_chart_rate(np.asarray(theta, float), np.asarray(omega, float), out)
    return out


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.1, 0.499, 0.501, 1.5, 3.1])
def test_slopes_of_the_chart_rate_are_those_of_differences(angle):
    """Of order four: displacements of 1e-3 leave 1e-12 of the derivatives, roundings 1e-13."""
    theta, omega = angle * np.array([2.0, -1.0, 2.0]) / 3.0, np.array([1.0, 2.0, -3.0])
    slopes, h = np.empty((3, 3)), 1e-3
    write_chart_rate_slopes(theta, omega, slopes)
    for e, slope in zip(np.eye(3), slopes, strict=True):
        points = [chart_rate(theta + k * h * e, omega) for k in (-2, -1, 1, 2)]
        expected = (8.0 * (points[2] - points[1]) - (points[3] - points[0])) / (12.0 * h)
        np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-10)


@given(quaternions)
def test_matrix_of_a_quaternion_turns_body_into_world_components(q):
    np.testing.assert_allclose(
        quaternion_to_matrix(q), Rotation.from_quat(q).as_matrix(), atol=20 * EPS
    )


@pytest.mark.slow
@given(quaternions)
@example(np.array([1.0, 0.0, 0.0, 0.0]))
@example(np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0]))
@example(np.array([0.0, 0.0, -1.0, 1e-9]))
def test_quaternion_survives_the_way_through_a_matrix(q):
    back = matrix_to_quaternion(quaternion_to_matrix(q))
    assert back[3] >= 0.0
    sign = 1.0 if back @ q > 0 else -1.0
    np.testing.assert_allclose(sign * back, q, atol=20 * EPS)


@pytest.mark.slow
@given(quaternions, vectors)
@example(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
@example(np.array([0.5, 0.5, 0.5, 0.5]), np.array([1e-9, 0.0, -2e-9]))
@example(np.array([0.5, -0.5, 0.5, 0.5]), np.array([9.9e-3, 1e-4, 0.0]))
def test_retract_turns_from_the_left_in_world_axes(q, theta):
    expected = Rotation.from_rotvec(theta) * Rotation.from_quat(q)
    np.testing.assert_allclose(
        quaternion_to_matrix(retract(q, theta)), expected.as_matrix(), atol=40 * EPS
    )
    np.testing.assert_allclose(np.linalg.norm(retract(q, theta)), 1.0, atol=4 * EPS)


@given(quaternions, vectors.filter(lambda a: np.linalg.norm(a) < 3.14))
@example(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
@example(np.array([0.5, 0.5, 0.5, 0.5]), np.array([1e-12, 3e-12, 0.0]))
def test_difference_inverts_retract(q, theta):
    # digits are lost towards a half turn, where the quaternion's w vanishes: 1/cos(|theta|/2)
    tol = 40 * EPS / math.cos(np.linalg.norm(theta) / 2)
    np.testing.assert_allclose(difference(q, retract(q, theta)), theta, atol=tol)
    np.testing.assert_allclose(difference(q, -retract(q, theta)), theta, atol=tol)


@settings(max_examples=40)
@given(vectors, vectors)
@example(np.array([3e-3, -4e-3, 1e-3]), np.array([1.0, 2.0, 3.0]))
@example(np.array([1.01e-2, 0.0, 0.0]), np.array([1.0, 2.0, 3.0]))
@example(np.zeros(3), np.array([1.0, 2.0, 3.0]))
def test_chart_rate_keeps_the_body_turning_with_omega(theta, omega):
    """d/dt exp(theta(t)) = S(omega) exp(theta): differentiate exp along the rate returned."""
    rate = chart_rate(theta, omega)
    R = Rotation.from_rotvec(theta).as_matrix()
    R_dot = first_difference(lambda s: Rotation.from_rotvec(theta + s * rate).as_matrix(), 2e-3)
    # near a full turn the rate itself grows without bound
    tol = 1e-10 * max(1.0, np.linalg.norm(rate)) ** 2
    np.testing.assert_allclose(R_dot @ R.T, skew(omega), atol=tol)


@pytest.mark.parametrize("direction", np.eye(3))
def test_chart_rate_is_continuous_where_the_series_ends(direction):
    omega = np.array([0.3, -1.1, 0.7])
    below, above = (
        chart_rate(direction * 0.00999999, omega),
        chart_rate(direction * 0.01000001, omega),
    )
    np.testing.assert_allclose(below, above, atol=2e-8)
