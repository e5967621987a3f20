"""Claims about screws: wrenches as pairs of pushes, ranks and null spaces of sets of wrenches.

Oracle: what the contacts exert, added up by hand; SVDs of matrices with known null spaces.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mechanics import EPS
from repository import WORKED

from multiarm.errors import GraspError
from multiarm.geometry.screws import COUPLE_TOLERANCE, SHORTEST_LEVER, screw_system, zero_pitch

ZERO_PITCH = [name for name in WORKED if name.startswith("zero_pitch")]
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: math.hypot(*v) > 1e-2)
sizes = st.floats(-9, 6).map(lambda k: 10.0**k)


def push(e, p):
    """Wrench of a unit push, written out."""
    return np.array([
        *e,
        p[1] * e[2] - p[2] * e[1], p[2] * e[0] - p[0] * e[2], p[0] * e[1] - p[1] * e[0],
    ])  # fmt: skip


def exerted(pair):
    total = push(pair.e_1, pair.p_1)
    if pair.e_2 is not None:
        total = total - push(pair.e_2, pair.p_2)
    return pair.gamma * total


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


# --- a wrench as a difference of pushes ----------------------------------------------------------


@pytest.mark.parametrize("name", ZERO_PITCH)
def test_worked_wrenches_are_reproduced(name):
    wrench = np.array(WORKED[name]["inputs"]["wrench"], float)
    pair, expected = zero_pitch(wrench), WORKED[name]["expected"]
    np.testing.assert_allclose(exerted(pair), wrench, atol=1e-14)
    np.testing.assert_allclose(pair.wrench, wrench, atol=1e-14)
    assert pair.gamma == pytest.approx(expected["gamma"], rel=1e-12)
    assert (pair.e_2 is None) == (expected["e2"] is None)
    if pair.e_2 is None:
        np.testing.assert_allclose([pair.e_1, pair.p_1], [expected["e1"], expected["p1"]])


@given(directions, directions, sizes, sizes, sizes)
def test_every_wrench_is_reproduced_by_contacts_that_stay_near(f, m, force, moment, length):
    wrench = np.concatenate([force * unit(f), moment * unit(m)])
    pair = zero_pitch(wrench, length=length)
    off = exerted(pair) - wrench
    size = force + moment / length
    assert np.linalg.norm(off[:3]) + np.linalg.norm(off[3:]) / length <= 20 * EPS * size + (
        COUPLE_TOLERANCE * size
    )
    assert pair.gamma > 0.0
    for e, p in ((pair.e_1, pair.p_1), (pair.e_2, pair.p_2)):
        if e is not None:
            assert np.linalg.norm(e) == pytest.approx(1.0, abs=1e-14)
        if pair.e_2 is not None:
            assert np.linalg.norm(p) <= 2.0 * length


@given(directions, directions, sizes, sizes)
def test_a_push_through_a_point_is_one_contact_on_its_line(e, p, force, distance):
    """Also with the rounding errors of p x e, which look like a moment along e."""
    e, p = unit(e), distance * unit(p)
    pair = zero_pitch(force * push(e, p), length=max(distance, 1e-3))
    assert pair.e_2 is None
    np.testing.assert_allclose(pair.e_1, e, atol=1e-15)
    assert pair.gamma == pytest.approx(force, rel=1e-14)
    tol = 20 * EPS * distance
    np.testing.assert_allclose(np.cross(pair.p_1 - p, e), 0.0, atol=tol)
    assert pair.p_1 @ e == pytest.approx(0.0, abs=tol)


@given(directions, sizes, sizes)
def test_a_couple_is_two_opposite_pushes_a_length_apart(m, moment, length):
    pair = zero_pitch([0, 0, 0, *(moment * unit(m))], length=length)
    np.testing.assert_array_equal(pair.e_1, pair.e_2)
    np.testing.assert_array_equal(pair.p_1, -pair.p_2)
    assert np.linalg.norm(pair.p_1 - pair.p_2) == pytest.approx(length, rel=1e-13)
    assert pair.gamma == pytest.approx(moment / length, rel=1e-13)


def test_a_wrench_that_is_nearly_a_couple_has_nearly_parallel_normals():
    for force in (1e-3, 1e-6, 1e-9):
        pair = zero_pitch([force, 0.0, 0.0, 0.3, 0.2, 0.1])
        assert np.linalg.norm(pair.e_1 - pair.e_2) == pytest.approx(force / pair.gamma, rel=1e-5)
        assert pair.gamma == pytest.approx(np.linalg.norm([0.3, 0.2, 0.1]))


@pytest.mark.parametrize("psi", [0.2, math.pi / 6, 1.4])
def test_psi_is_half_the_angle_between_the_normals(psi):
    pair = zero_pitch([1.0, 2.0, -1.0, 0.03, 0.05, 0.02], psi=psi)
    assert math.acos(pair.e_1 @ pair.e_2) == pytest.approx(2 * psi, abs=1e-7)
    np.testing.assert_allclose(exerted(pair), [1.0, 2.0, -1.0, 0.03, 0.05, 0.02], atol=1e-14)


@given(sizes)
def test_a_multiple_of_a_wrench_has_the_same_contacts(factor):
    one = zero_pitch([1.0, 2.0, -1.0, 0.3, 0.5, 0.2])
    many = zero_pitch(factor * np.array([1.0, 2.0, -1.0, 0.3, 0.5, 0.2]))
    assert many.gamma == pytest.approx(factor * one.gamma, rel=1e-13)
    for name in ("e_1", "p_1", "e_2", "p_2"):
        np.testing.assert_allclose(getattr(many, name), getattr(one, name), atol=1e-13)


def test_tiny_and_huge_wrenches_neither_vanish_nor_overflow():
    for factor in (1e-300, 1e300):
        wrench = factor * np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.1])
        np.testing.assert_allclose(exerted(zero_pitch(wrench)) / factor, wrench / factor)


@pytest.mark.parametrize(
    ("wrench", "options", "message"),
    [
        ([0.0] * 6, {}, "the wrench is zero"),
        ([1.0, 0.0, 0.0], {}, "six finite numbers"),
        ([1.0, 0.0, 0.0, 0.0, 0.0, math.nan], {}, "six finite numbers"),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 1.0], {"psi": 0.0}, "0 < psi < pi / 2"),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 1.0], {"psi": 1.6}, "0 < psi < pi / 2"),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 1.0], {"length": 0.0}, "length > 0"),
    ],
)
def test_what_cannot_be_split_is_refused_in_words(wrench, options, message):
    with pytest.raises(GraspError, match=message):
        zero_pitch(wrench, **options)


# --- what wrenches span and leave free -----------------------------------------------------------


def with_rank(rng, rank, count):
    """Random pushes of which ``rank`` are independent: combinations of a few."""
    p, e = rng.uniform(-1, 1, (2, rank, 3))
    independent = np.array([push(unit(e_k), p_k) for e_k, p_k in zip(e, p, strict=True)]).T
    return np.hstack([independent, independent @ rng.standard_normal((rank, count - rank))])


@pytest.mark.parametrize("rank", range(1, 7))
def test_rank_and_null_spaces_of_dependent_wrenches(rank, rng):
    W = with_rank(rng, rank, 9)
    screws = screw_system(W)
    assert screws.rank == rank
    assert screws.reciprocal.shape == (6, 6 - rank) and screws.dependencies.shape == (9, 9 - rank)
    np.testing.assert_allclose(W.T @ screws.reciprocal, 0.0, atol=1e-13)
    np.testing.assert_allclose(W @ screws.dependencies, 0.0, atol=1e-13)
    gram = screws.dependencies.T @ screws.dependencies
    np.testing.assert_allclose(gram, np.eye(9 - rank), atol=1e-13)
    scaled = np.repeat([1.0, screws.length], 3)[:, None] * screws.reciprocal
    np.testing.assert_allclose(scaled.T @ scaled, np.eye(6 - rank), atol=1e-13)


@pytest.mark.parametrize("size", [1e-2, 1.0, 1e3])
def test_rank_does_not_depend_on_units_nor_on_the_weight_of_rows(size, rng):
    W = with_rank(rng, 5, 8)
    W[3:] *= size
    W *= 10.0 ** np.array([6, -6, -6, -5, -6, -6, 6, -6])
    screws = screw_system(W)
    assert screws.rank == 5
    tol = 1e-13 * np.max(np.abs(W)) * np.max(np.abs(screws.dependencies))
    np.testing.assert_allclose(W @ screws.dependencies, 0.0, atol=tol * size)


def test_rounding_of_moments_through_the_origin_is_no_rank(rng):
    """Five pushes through one point, which is the origin up to rounding."""
    e = rng.standard_normal((5, 3))
    W = np.array([push(unit(e_k), 1e-16 * rng.standard_normal(3)) for e_k in e]).T
    screws = screw_system(W)
    assert screws.rank == 3 and screws.length == SHORTEST_LEVER


def test_couples_alone_and_no_wrenches_at_all():
    couples = np.vstack([np.zeros((3, 2)), np.eye(3)[:, :2]])
    assert screw_system(couples).rank == 2
    np.testing.assert_allclose(couples.T @ screw_system(couples).reciprocal, 0.0, atol=1e-15)
    assert screw_system(np.zeros((6, 0))).rank == 0
    assert screw_system(np.zeros((6, 0))).reciprocal.shape == (6, 6)
    assert screw_system(np.zeros((6, 2))).rank == 0


@pytest.mark.parametrize("W", [np.zeros((5, 2)), np.zeros(6), [[math.nan]] * 6])
def test_matrices_that_are_not_wrenches_are_refused(W):
    with pytest.raises(GraspError, match="W"):
        screw_system(W)
