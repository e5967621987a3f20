"""Six independent contacts: block inverse, necessary conditions, moments, special selections."""

from __future__ import annotations

import numpy as np
import pytest
from grasp_oracles import rational_rank
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import WORKED
from scipy.linalg import expm

from multiarm.errors import GraspError
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.six_contacts.independent_contacts import (
    block_inverse,
    independence,
    violated_conditions,
)
from multiarm.grasp.six_contacts.special_selections import case_I, case_II, case_III, three_moments


def worked(name):
    inputs = WORKED[name]["inputs"]
    return Contacts(inputs["points"], inputs["normals"])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def random_pose(rng, reach=1.0):
    X = np.eye(4)
    X[:3, :3] = expm(np.cross(np.eye(3), rng.normal(size=3)))
    X[:3, 3] = reach * rng.normal(size=3)
    return X


def numerical_rank(contacts):
    """Rank by a singular value decomposition of our own scaling."""
    s = np.linalg.svd(contacts.scaled_wrenches, compute_uv=False)
    return int(np.sum(s > 1e-9 * s[0]))


# --- block inverse ------------------------------------------------------------------------------


def test_block_inverse_has_the_worked_blocks():
    found, expected = block_inverse(worked("block_inverse")), WORKED["block_inverse"]["expected"]
    for name in ("T1", "a", "T2", "inverse"):
        assert getattr(found, name) == pytest.approx(np.array(expected[name]), abs=1e-9)
    assert found.order == (0, 1, 2, 3, 4, 5)


def test_block_inverse_is_the_inverse_and_its_blocks_are_those_of_the_equation(rng):
    for _ in range(50):
        contacts = Contacts.along(rng.normal(size=(6, 3)), rng.normal(size=(6, 3)))
        W = contacts.wrenches
        found = block_inverse(contacts)
        picked = list(found.order)
        tolerance = 1e-13 * np.linalg.cond(W) ** 2
        assert np.abs(found.inverse @ W - np.eye(6)).max() < tolerance
        assert found.determinant == pytest.approx(np.linalg.det(W), rel=tolerance)
        e, m = W[:3, picked], W[3:, picked]
        assert pytest.approx(-e[:, 3:], abs=tolerance) == e[:, :3] @ found.T1
        assert found.a == pytest.approx(m[:, :3] @ found.T1 + m[:, 3:], abs=tolerance)
        assert pytest.approx(-m[:, :3], abs=tolerance) == found.a @ found.T2


@pytest.mark.parametrize("which", [(0, 0, 1), (0, 1, 0), (1, 0, 0)])
def test_block_inverse_takes_other_contacts_first_when_the_first_normals_are_dependent(which, rng):
    signs = set()
    for _ in range(10):
        normals = np.vstack([np.eye(3)[list(which)], rng.normal(size=(3, 3))])
        contacts = Contacts.along(rng.normal(size=(6, 3)), normals)
        found = block_inverse(contacts)
        assert found.order[:3] != (0, 1, 2)
        assert sorted(found.order) == list(range(6))
        error = np.abs(found.inverse @ contacts.wrenches - np.eye(6)).max()
        assert error < 1e-13 * np.linalg.cond(contacts.wrenches) ** 2
        assert found.determinant == pytest.approx(np.linalg.det(contacts.wrenches), rel=1e-8)
        signs.add(round(np.linalg.det(np.eye(6)[list(found.order)])))
    assert signs == {-1, 1}


def test_the_block_a_and_the_determinant_are_the_same_about_every_origin(rng):
    contacts = Contacts.along(rng.normal(size=(6, 3)), rng.normal(size=(6, 3)))
    moved = Contacts(contacts.points + [1e5, -2e5, 1e5], contacts.normals)
    here, there = block_inverse(contacts), block_inverse(moved)
    # points are good for 1e5 eps, times the condition of the block
    tolerance = 1e-9
    assert there.a == pytest.approx(here.a, abs=tolerance)
    assert there.determinant == pytest.approx(here.determinant, rel=tolerance)


def test_dependent_contacts_have_no_inverse_and_are_named():
    with refused(GraspError, "rank 5): the wrenches of contact 3,", "no inverse"):
        block_inverse(worked("case_III_counterexample_B"))


@pytest.mark.parametrize("ask", [block_inverse, independence, violated_conditions])
def test_only_six_contacts_in_space_will_do(ask):
    with refused(GraspError, "6 contacts in space are needed here, not 5 in space"):
        ask(Contacts(np.eye(3)[[0, 1, 2, 0, 1]], np.eye(3)[[0, 1, 2, 0, 1]]))
    with refused(GraspError, "not 6 in the plane"):
        ask(Contacts(np.zeros((6, 2)), np.eye(2)[[0] * 6]))


# --- necessary conditions -----------------------------------------------------------------------


def lines_through(rng, X, count):
    along = rng.normal(size=(count, 3))
    return X + rng.normal(size=(count, 1)) * along, along


def parallel_lines(rng, along, count):
    return rng.normal(size=(count, 3)), rng.choice([-1.0, 1.0], size=(count, 1)) * along


def lines_in_plane(rng, count, base, span):
    """Lines in the plane base + span (2, 3)."""
    return base + rng.normal(size=(count, 2)) @ span, rng.normal(size=(count, 2)) @ span


def stack(*sets):
    return [np.vstack(rows) for rows in zip(*sets, strict=True)]


def anything(rng, count):
    return rng.normal(size=(count, 3)), rng.normal(size=(count, 3))


def violation_of(kind, rng):
    """Six contacts that violate one condition, and the contacts concerned."""
    X, Y, along = rng.normal(size=(3, 3))
    span = rng.normal(size=(2, 3))
    in_plane = X + rng.normal(size=2) @ span
    if kind == "1":
        return stack(lines_through(rng, X, 4), anything(rng, 2)), (0, 1, 2, 3)
    if kind == "2":
        return stack(parallel_lines(rng, along, 4), anything(rng, 2)), (0, 1, 2, 3)
    if kind == "3":
        return stack(lines_in_plane(rng, 4, X, span), anything(rng, 2)), (0, 1, 2, 3)
    if kind == "4 ii":
        return stack(lines_through(rng, X, 3), lines_through(rng, Y, 3)), range(6)
    if kind == "4 iii":
        rest = anything(rng, 1)
        return stack(lines_through(rng, X, 3), lines_in_plane(rng, 2, X, span), rest), range(5)
    if kind == "4 iii at infinity":
        pair = lines_in_plane(rng, 2, X, np.array([along, Y]))
        return stack(parallel_lines(rng, along, 3), pair, anything(rng, 1)), range(5)
    if kind == "5":
        return stack(parallel_lines(rng, along, 3), lines_through(rng, X, 3)), range(6)
    if kind == "5 at infinity":
        return stack(parallel_lines(rng, along, 3), parallel_lines(rng, Y, 3)), range(6)
    pair = lines_through(rng, in_plane, 2)
    if kind == "6 at infinity":
        pair = parallel_lines(rng, rng.normal(size=2) @ span, 2)
    return stack(lines_in_plane(rng, 3, X, span), pair, anything(rng, 1)), range(5)


KINDS = ["1", "2", "3", "4 ii", "4 iii", "4 iii at infinity", "5", "5 at infinity"]
KINDS += ["6", "6 at infinity"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_violation_has_rank_five_or_less_and_is_named_with_its_contacts(kind, rng):
    for _ in range(12):
        (points, along), concerned = violation_of(kind, rng)
        order = rng.permutation(6)
        contacts = Contacts.along(points[order], along[order]).placed(random_pose(rng, 5.0))
        assert numerical_rank(contacts) <= 5
        where = sorted(np.flatnonzero(np.isin(order, list(concerned))).tolist())
        matching = [v for v in violated_conditions(contacts) if v.condition == int(kind[0])]
        assert where in [sorted(v.contacts) for v in matching]
        found = independence(contacts)
        assert not found
        assert found.rank <= 5
        assert matching[0].words in found.message
        for j in where:
            assert contacts.names[j] in found.message


def test_contacts_in_general_position_violate_nothing(rng):
    for _ in range(20):
        contacts = Contacts.along(*anything(rng, 6))
        assert violated_conditions(contacts) == ()
        found = independence(contacts)
        assert (found.independent, found.rank, found.dependent) == (True, 6, ())
        assert found.determinant == pytest.approx(np.linalg.det(contacts.wrenches), rel=1e-9)


def test_three_lines_through_a_point_and_three_others_may_be_independent(rng):
    for first in (lines_through(rng, np.ones(3), 3), parallel_lines(rng, np.ones(3), 3)):
        contacts = Contacts.along(*stack(first, anything(rng, 3)))
        assert numerical_rank(contacts) == 6
        assert violated_conditions(contacts) == ()


@pytest.mark.slow
def test_on_a_coarse_grid_a_violation_always_means_dependence(rng):
    violated, dependent = 0, 0
    for _ in range(300):
        points, along = rng.integers(-1, 2, size=(2, 6, 3))
        along[~along.any(axis=1), 0] = 1
        rank = rational_rank(np.hstack([along, np.cross(points, along)]))
        contacts = Contacts.along(points, along)
        found = independence(contacts)
        assert found.rank == rank
        assert (found.determinant == pytest.approx(0.0, abs=1e-9)) == (rank < 6)
        some = violated_conditions(contacts)
        assert rank <= 5 or not some
        violated, dependent = violated + bool(some), dependent + (rank < 6)
    assert 20 < violated < dependent  # the conditions are necessary, not sufficient


def test_the_dependent_contacts_are_those_of_the_dependency(rng):
    # three lines in a plane through a point: two would do; no condition speaks of them
    along = lines_in_plane(rng, 3, np.zeros(3), np.eye(3)[:2])[1]
    contacts = Contacts.along(*stack((np.zeros((3, 3)), along), anything(rng, 3)))
    found = independence(contacts)
    assert (found.rank, found.dependent) == (5, (0, 1, 2))


@pytest.mark.slow
@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-3, 1.0, 10.0]))
def test_conditions_do_not_depend_on_place_axes_or_size(seed, scale):
    rng = np.random.default_rng(seed)
    (points, along), _ = violation_of(KINDS[seed % len(KINDS)], rng)
    contacts = Contacts.along(points, along)
    moved = contacts.placed(random_pose(rng, 100.0))
    moved = Contacts(scale * moved.points, moved.normals)
    here, there = violated_conditions(contacts), violated_conditions(moved)
    assert [(v.condition, v.contacts) for v in here] == [(v.condition, v.contacts) for v in there]
    assert independence(moved).smallest_singular_value < 1e-11


@pytest.mark.parametrize(("off", "named"), [(1e-12, True), (1e-10, True), (1e-6, False)])
def test_lines_meet_within_the_stated_tolerance(off, named, rng):
    points, along = stack(lines_through(rng, np.zeros(3), 4), anything(rng, 2))
    points[0] += off * np.cross(along[0], rng.normal(size=3))
    found = violated_conditions(Contacts.along(points, along))
    assert [violation.condition for violation in found] == ([1] if named else [])


# --- three moments ------------------------------------------------------------------------------


def test_worked_contacts_on_parallel_planes_break_rule_3_and_have_determinant_zero():
    name = "three_moments_parallel_planes_gap"
    contacts, expected = worked(name), WORKED[name]["expected"]
    found = three_moments(contacts)
    assert not found
    assert found.moments == pytest.approx(np.array(expected["moments"]), abs=1e-9)
    assert found.determinant == pytest.approx(0.0, abs=1e-9)
    assert 3 in {violation.condition for violation in found.violations}


@pytest.mark.slow
def test_rules_are_equivalent_to_the_determinant_over_integer_triples(rng):
    verdicts, broken = [], set()
    for _ in range(1000):
        points, along = rng.integers(-2, 3, size=(2, 3, 3))
        if not along.any(axis=1).all():
            continue
        m = np.cross(points, along)
        exact = m[0] @ np.cross(m[1], m[2])
        found = three_moments(Contacts.along(points, along))
        assert bool(found) == (exact != 0) == (not found.violations)
        assert abs(found.determinant) > 1e-9 or exact == 0
        verdicts.append(exact != 0)
        broken |= {violation.condition for violation in found.violations}
    assert 250 < sum(verdicts) < len(verdicts) - 125
    assert broken == {1, 2, 3, 4, 5, 6}


@pytest.mark.parametrize(
    ("points", "normals", "rule"),
    [
        ([[0, 0, 1], [1, 2, 3], [3, 1, 1]], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], 1),
        ([[0, 1, 1], [0, 2, 3], [3, 1, 1]], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], 2),
        ([[1, 1, 1], [2, 2, 5], [3, 1, 1]], [[0, 0, 1], [0, 0, 1], [1, 0, 0]], 3),
        ([[1, 1, 9], [1, 9, 1], [9, 1, 1]], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], 4),
        ([[1, 0, 1], [0, 1, 1], [3, 1, 1]], [[0, 0, 1], [0, 0, 1], [0, 0, -1]], 5),
        # m1 = x, m2 = y: contact 3 on a face with its moment in their plane
        ([[0, 1, 0], [1, 0, 0], [1, 1, 5]], [[0, 0, 1], [0, 0, -1], [0, 0, 1]], 6),
    ],
)
def test_each_rule_is_named_where_it_is_broken(points, normals, rule):
    found = three_moments(Contacts(points, normals))
    assert not found
    assert rule in {violation.condition for violation in found.violations}


def test_offset_and_moment_are_one_another_turned_in_the_face(rng):
    contacts = Contacts.along(*anything(rng, 3))
    o = rng.normal(size=3)
    found = three_moments(contacts, about=o)
    assert found.moments == pytest.approx(np.cross(contacts.points - o, contacts.normals))
    assert np.cross(contacts.normals, found.moments) == pytest.approx(found.offsets)
    for e, c, m in zip(contacts.normals, found.offsets, found.moments, strict=True):
        assert expm(-np.pi / 2 * np.cross(np.eye(3), e)) @ c == pytest.approx(m)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_three_moments_do_not_depend_on_size(scale, rng):
    points, along = anything(rng, 3)
    points[2] = 1e-6 * points[2]  # a short lever is a lever
    contacts = Contacts.along(scale * points, along)
    assert three_moments(contacts)
    assert three_moments(contacts).determinant == pytest.approx(
        scale**3 * three_moments(Contacts.along(points, along)).determinant
    )


def test_three_moments_refuse_other_numbers_of_contacts_and_points_that_are_none():
    with refused(GraspError, "3 contacts in space are needed here, not 2"):
        three_moments(Contacts(np.eye(3)[:2], np.eye(3)[:2]))
    with refused(GraspError, "three finite coordinates"):
        three_moments(Contacts(np.eye(3), np.eye(3)), about=[0, np.inf, 0])


# --- special selections -------------------------------------------------------------------------


def test_case_I_mirrors_three_contacts_and_has_the_blocks_of_the_thesis(rng):
    for _ in range(10):
        points, along = anything(rng, 3)
        centre = rng.normal(size=3)
        six = case_I(points, unit(along), centre)
        assert numerical_rank(six) == 6
        assert six.points[3:] + six.points[:3] == pytest.approx(np.tile(2 * centre, (3, 1)))
        assert six.normals[3:] == pytest.approx(-six.normals[:3])
        about = Contacts(six.points - centre, six.normals)
        found = block_inverse(about)
        if found.order == (0, 1, 2, 3, 4, 5):
            assert np.abs(found.T1 - np.eye(3)).max() < 1e-9
            assert found.a == pytest.approx(2 * about.wrenches[3:, :3], abs=1e-9)
            assert np.abs(found.T2 + np.eye(3) / 2).max() < 1e-9


def test_case_I_refuses_dependent_normals_and_dependent_moments(rng):
    points = rng.normal(size=(3, 3))
    with refused(GraspError, "Case I takes three faces", "lie in a plane"):
        case_I(points, unit(np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0]])))
    with refused(GraspError, "rule 4: the three normal lines meet"):
        case_I([[1, 1, 9], [1, 9, 1], [9, 1, 1]], np.eye(3)[::-1])
    with refused(GraspError, "3 contacts in space are needed here, not 2"):
        case_I(np.eye(3)[:2], np.eye(3)[:2])
    with refused(GraspError, "three finite coordinates"):
        case_I(points, np.eye(3), centre=[0, 0])
    with refused(GraspError, "three finite coordinates, not 'middle'"):
        case_I(points, np.eye(3), centre="middle")


def test_case_I_looks_at_the_moments_about_its_centre(rng):
    X = rng.normal(size=3)
    points, along = lines_through(rng, X, 3)
    along = unit(along)
    points[2] += np.cross(along[2], rng.normal(size=3))  # two lines through X, one beside it
    assert case_I(points, along).count == 6
    with refused(GraspError, "rule 1: the normal line of contact 1 passes through"):
        case_I(points, along, centre=X)


def test_case_II_has_rank_six_and_an_inverse_without_T2_about_the_meeting_point(rng):
    for _ in range(10):
        X = rng.normal(size=3)
        points, along = stack(lines_through(rng, X, 3), anything(rng, 3))
        six = case_II(points, unit(along))
        assert numerical_rank(six) == 6
        found = block_inverse(Contacts(six.points - X, six.normals))
        if found.order == (0, 1, 2, 3, 4, 5):
            assert np.abs(found.T2).max() < 1e-9


def test_case_II_refuses_what_is_not_one_and_says_which_rule(rng):
    X = rng.normal(size=3)
    first, last = lines_through(rng, X, 3), anything(rng, 3)
    points, along = stack(anything(rng, 3), last)
    with refused(GraspError, "lines that meet at a point; those of contact 1"):
        case_II(points, unit(along))
    points, along = stack(first, lines_through(rng, rng.normal(size=3), 3))
    with refused(GraspError, "Case II: the moments of contact 4", "rule 4"):
        case_II(points, unit(along))
    points, along = stack(first, lines_through(rng, X, 1), anything(rng, 2))
    with refused(GraspError, "rule 1: the normal line of contact 4 passes"):
        case_II(points, unit(along))
    flat = lines_in_plane(rng, 3, X, rng.normal(size=(2, 3)))
    points, along = stack(flat, last)
    with refused(GraspError, "first three normals that are independent"):
        case_II(points, unit(along))
    with refused(GraspError, "6 contacts in space are needed here, not 3"):
        case_II(np.eye(3), np.eye(3))


def third_case(rng):
    X, along = rng.normal(size=(2, 3))
    return stack(
        lines_through(rng, X, 2), parallel_lines(rng, along, 3), anything(rng, 1)
    ), X, along  # fmt: skip


def factors(six, X):
    """The three factors of the determinant of Case III, moments about X."""
    e, m = six.normals, np.cross(six.points - X, six.normals)
    along = e[2]
    s = np.sign(e @ along)
    t = s[:, None] * m
    return (
        np.linalg.det([e[0], e[1], along]),
        along @ np.cross(t[3] - t[2], t[4] - t[2]),
        along @ m[5],
    )


def test_case_III_determinant_is_the_product_of_its_three_factors(rng):
    for _ in range(20):
        (points, along), X, _ = third_case(rng)
        six = case_III(points, unit(along))
        size = abs(np.prod(factors(six, X)))
        assert abs(np.linalg.det(six.wrenches)) == pytest.approx(size, rel=1e-8)
        assert numerical_rank(six) == 6


@pytest.mark.parametrize(
    ("name", "letter"), [("case_III_counterexample_A", "a"), ("case_III_counterexample_B", "b")]
)
def test_worked_counterexamples_of_case_III_are_refused_with_the_condition(name, letter):
    six = worked(name)
    assert numerical_rank(six) == WORKED[name]["expected"]["rank"] == independence(six).rank
    with refused(GraspError, f"({letter})"):
        case_III(six.points, six.normals)


def test_worked_case_III_is_accepted_with_its_determinant():
    good = worked("case_III_good")
    six = case_III(good.points, good.normals)
    expected = WORKED["case_III_good"]["expected"]
    assert independence(six).determinant == pytest.approx(expected["det"], abs=1e-9)
    assert np.prod(factors(six, np.zeros(3))) == pytest.approx(expected["det_by_factors"], abs=1e-9)


def test_case_III_refuses_each_of_its_conditions_alone(rng):
    (points, along), X, common = third_case(rng)
    level = along.copy()
    level[1] = common + 0.3 * along[0]
    at = points.copy()
    at[1] = X + level[1]
    in_line, meeting = points.copy(), points.copy()
    in_line[4] = 2 * points[3] - points[2] + common
    meeting[5] = X + 0.7 * common + 0.2 * along[5]
    cases = {
        "(a)": (at, level),
        "(b) contact 3, contact 4 and contact 5": (in_line, along),
        "(c) the normal line of contact 6": (meeting, along),
    }
    for place, (p, e) in cases.items():
        contacts = Contacts.along(p, e)
        assert numerical_rank(contacts) == 5
        with refused(GraspError, place):
            case_III(p, unit(e))
    parallel = along.copy()
    parallel[5] = common
    with refused(GraspError, "dependent: (c)"):
        case_III(points, unit(parallel))


def test_case_III_refuses_what_is_not_one(rng):
    (points, along), _, _ = third_case(rng)
    with refused(GraspError, "two normal lines that meet at one point"):
        case_III(points + rng.normal(size=(6, 3)), unit(along))
    with refused(GraspError, "two normal lines that meet at one point"):
        case_III(points, unit(along[[0, 0, 2, 3, 4, 5]]))
    with refused(GraspError, "three parallel normals; those of contact 3"):
        case_III(points, unit(along[[0, 1, 2, 3, 5, 4]]))


def test_of_nested_sets_only_the_largest_is_reported(rng):
    contacts = Contacts.along(*stack(lines_through(rng, np.zeros(3), 5), anything(rng, 1)))
    found = violated_conditions(contacts)
    assert [(v.condition, v.contacts) for v in found] == [(1, (0, 1, 2, 3, 4))]
