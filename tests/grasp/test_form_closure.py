"""Form closure: decisions against exact enumeration, proofs, distances, second-order immobility."""

from __future__ import annotations

import json
import subprocess
import sys
from fractions import Fraction
from itertools import combinations
from math import lcm

import numpy as np
import pytest
from grasp_oracles import rational_rank
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import DATA, WORKED
from scipy.linalg import expm
from scipy.optimize import OptimizeResult, linprog
from scipy.spatial import ConvexHull

from multiarm.errors import GraspError
from multiarm.grasp.arguments import unit_vectors
from multiarm.grasp.closure.balances import BAND, LEAST_MARGIN, balance_inverses, evenest
from multiarm.grasp.closure.form_closure import closed_many, is_form_closure
from multiarm.grasp.contacts import Contacts, wrenches_of

# Seven contacts on a box: two of them 2e-10 m apart; normals that are off by 1e-7.
HARD = json.loads((DATA / "hard_contacts.json").read_text())
BLOCK = WORKED["example_2_1"]
# rounding of numbers of order 1 through one small factorisation
ROUNDING = 1e-12


def worked(name):
    inputs = WORKED[name]["inputs"]
    return Contacts(inputs["points"], inputs["normals"])


# --- the oracle: every plane through n - 1 of the wrenches, in whole numbers --------------------


def given_columns(contacts):
    """Wrenches of the directions as given, in fractions."""
    columns = []
    for p, e in zip(contacts.exact_points, contacts.exact_directions, strict=True):
        if len(p) == 2:
            turned = [p[0] * e[1] - p[1] * e[0]]
        else:
            turned = [p[i - 2] * e[i - 1] - p[i - 1] * e[i - 2] for i in range(3)]
        columns.append([*e, *turned])
    return columns


def exact_columns(contacts):
    """The same, each times a positive number that makes it whole."""
    columns = given_columns(contacts)
    scales = [lcm(*(x.denominator for x in column)) for column in columns]
    return [[int(x * s) for x in column] for s, column in zip(scales, columns, strict=True)]


def plane_normals(columns):
    """Normals (M, n) of the hyperplanes through all sets of n - 1 columns: their minors."""
    W = np.array(columns, dtype=object)  # (N, n)
    n = W.shape[1]
    chosen = np.array(list(combinations(range(len(W)), n - 1)))
    minors = {(): 1}
    for r in range(n - 1):
        row = W[chosen[:, r]]  # (M, n)
        minors = {
            picked: sum(
                (-1) ** (r + i) * row[:, c] * minors[picked[:i] + picked[i + 1 :]]
                for i, c in enumerate(picked)
            )
            for picked in combinations(range(n), r + 1)
        }
    everything = tuple(range(n))
    return np.array([(-1) ** c * minors[everything[:c] + everything[c + 1 :]] for c in range(n)]).T


def exactly_closed(contacts):
    """No hyperplane through n - 1 independent wrenches has all of them on one side.

    With full rank, the cone of motions ``W^T v >= 0`` has no line in it; if it is more than 0 it
    has an edge, and the edge is normal to n - 1 independent wrenches.
    """
    columns = exact_columns(contacts)
    normals = plane_normals(columns)
    rates = normals.dot(np.array(columns, dtype=object).T)
    one_sided = (rates >= 0).all(axis=1) | (rates <= 0).all(axis=1)
    independent = (normals != 0).any(axis=1)
    spanning = (rates != 0).any()
    return bool(spanning and not (one_sided & independent).any())


def assert_proven(contacts, found):
    """The result's own proof holds, whatever the verdict."""
    W = contacts.wrenches
    if found:
        assert np.all(found.coefficients > 0)
        assert found.coefficients.sum() == pytest.approx(1.0, abs=ROUNDING)
        assert np.abs(contacts.scaled_wrenches @ found.coefficients).max() < ROUNDING
        assert found.motion is None
        assert found.rank == contacts.freedoms
        return
    assert found.coefficients is None
    d = contacts.dimension
    rates, scaled = W.T @ found.motion, found.motion.copy()
    scaled[d:] *= contacts.length
    # the band about the scaled wrenches, times the motion's size in those coordinates
    size = 1.0 + np.abs(contacts.points).max() / contacts.length
    assert rates.min() >= -2e-9 * size * max(1.0, np.linalg.norm(scaled))
    assert set(np.flatnonzero(rates > 1e-6 * size)) <= set(found.leaving)
    speeds = np.linalg.norm(velocities(contacts.points, found.motion), axis=1)
    assert speeds.max() == pytest.approx(1.0, abs=1e-6) or speeds.max() < 1e-6


def velocities(points, motion):
    if points.shape[1] == 2:
        return motion[:2] + motion[2] * np.column_stack([-points[:, 1], points[:, 0]])
    return motion[:3] + np.cross(motion[3:], points)


# --- families of contacts -----------------------------------------------------------------------


def directions(rng, count, d):
    along = rng.integers(-2, 3, size=(count, d))
    along[~along.any(axis=1), 0] = 1
    return along


def random_set(rng, count, d):
    points = rng.normal(size=(count, d))
    return Contacts.along(points, -points + 0.6 * rng.normal(size=(count, d)))


def grid_set(rng, count, d):
    return Contacts.along(rng.integers(-2, 3, size=(count, d)), directions(rng, count, d))


def axis_set(rng, count, d):
    """Contacts on the faces of a box, on a coarse grid: rank-deficient and marginal sets abound."""
    axes, signs = rng.integers(0, d, size=count), rng.choice([-1, 1], size=count)
    points, along = rng.integers(-2, 3, size=(count, d)), np.zeros((count, d), dtype=int)
    points[np.arange(count), axes], along[np.arange(count), axes] = 3 * signs, -signs
    return Contacts.along(points, along)


def opposed_set(rng, count, d):
    """Opposed pairs on shared normal lines, then something else."""
    half = count // 2
    points, along = rng.integers(-3, 4, size=(half, d)), directions(rng, half, d)
    rest = grid_set(rng, count - 2 * half, d) if count % 2 else None
    pairs = Contacts.along(np.vstack([points, points + 2 * along]), np.vstack([along, -along]))
    return pairs if rest is None else pairs.joined(rest)


def balanced_set(rng, count, d):
    """The last wrench balances the others: exactly marginal when only some take part."""
    if d == 2:
        chosen = grid_set(rng, count - 1, d)
        taking = rng.integers(0, 2, size=count - 1)
        total = taking @ np.array(exact_columns(chosen))
        if not any(total[:2]):
            return chosen
        force = -total[:2]
        arm = np.array([-force[1], force[0]]) * Fraction(-total[2], force @ force)
        return Contacts.along([*chosen.written[0], tuple(arm)], [*chosen.written[1], tuple(force)])
    return concurrent_set(rng, count, d)


def concurrent_set(rng, count, d):
    """All but two normal lines meet at the origin."""
    along = directions(rng, count, d)
    points = along * rng.integers(-2, 3, size=(count, 1))
    points[:2] += directions(rng, 2, d)
    return Contacts.along(points, along)


def repeated_set(rng, count, d):
    """Few different contacts, again and again."""
    few = axis_set(rng, count, d)
    return few.subset(rng.integers(0, max(count - 2, 1), size=count))


FAMILIES = [
    random_set, grid_set, axis_set, opposed_set, balanced_set, concurrent_set, repeated_set,
]  # fmt: skip


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__)
@pytest.mark.parametrize(("d", "counts"), [(2, (3, 4, 5, 6, 8)), (3, (6, 7, 8, 9, 12))])
def test_both_decisions_are_those_of_exact_enumeration(family, d, counts, rng):
    verdicts = []
    for count in counts:
        for _ in range(10):
            contacts = family(rng, count, d)
            rounded, exact = is_form_closure(contacts), is_form_closure(contacts, exact=True)
            truth = exactly_closed(contacts)
            assert (bool(rounded), bool(exact)) == (truth, truth), contacts
            assert rounded.rank == exact.rank == rational_rank(exact_columns(contacts))
            assert_proven(contacts, rounded)
            assert_proven(contacts, exact)
            verdicts.append(truth)
    assert not all(verdicts)


def flat_set(rng, count, d):
    """Points of very different spread along the axes."""
    points = rng.normal(size=(count, d)) * 10.0 ** -rng.integers(0, 7, size=d)
    return Contacts.along(
        points, -points / np.abs(points).max(axis=0) + 0.5 * rng.normal(size=(count, d))
    )


def gripper_set(rng, count, d):
    """Two small clusters of points, any normals."""
    corners, size = rng.normal(size=(2, d)), 10.0 ** -rng.integers(1, 6)
    points = corners[rng.integers(0, 2, count)] + size * rng.normal(size=(count, d))
    return Contacts.along(points, rng.normal(size=(count, d)))


@pytest.mark.slow
@pytest.mark.parametrize("family", [flat_set, gripper_set], ids=lambda family: family.__name__)
def test_flat_and_clustered_contacts_are_decided_as_exactly(family, rng):
    closed = 0
    for number in range(120):
        contacts = family(rng, 7 + number % 4, 3)
        rounded, exact = is_form_closure(contacts), is_form_closure(contacts, exact=True)
        assert rounded.closed == exact.closed
        assert_proven(contacts, exact)
        closed += rounded.closed
    assert closed > 5


@pytest.mark.slow
def test_many_contacts_are_decided_as_exactly(rng):
    points = rng.normal(size=(300, 3))
    around = Contacts.along(points, -points + 0.5 * rng.normal(size=points.shape))
    points[:, 0] = np.abs(points[:, 0])
    one_side = Contacts.along(points, [-0.01, 0.0, 0.0] - points)
    for contacts, closed in ((around, True), (one_side, False)):
        found = is_form_closure(contacts)
        assert found.closed == is_form_closure(contacts, exact=True).closed == closed
        assert_proven(contacts, found)
        assert (found.margin > 0.0) == closed


def test_the_families_hold_closed_sets_too(rng):
    closed = [is_form_closure(family(rng, 12, 3)).closed for family in FAMILIES for _ in range(40)]
    assert 30 < sum(closed) < 250


@pytest.mark.parametrize(("d", "count"), [(2, 4), (2, 6), (3, 7), (3, 10)])
def test_exact_proofs_hold_without_rounding(d, count, rng):
    for family in (axis_set, grid_set, opposed_set, random_set):
        for _ in range(20):
            contacts = family(rng, count, d)
            found, columns = is_form_closure(contacts, exact=True), given_columns(contacts)
            if found:
                pushes = found.exact_coefficients
                assert min(pushes) > 0
                assert sum(pushes) == 1
                for row in zip(*columns, strict=True):
                    assert sum(x * push for x, push in zip(row, pushes, strict=True)) == 0
            else:
                motion = found.exact_motion
                assert any(motion)
                for w in columns:
                    assert sum(x * v for x, v in zip(w, motion, strict=True)) >= 0


@pytest.mark.parametrize(("d", "count"), [(2, 4), (2, 7), (3, 7), (3, 11)])
def test_margin_is_proven_by_pushes_and_by_the_dual_solution(d, count, rng):
    for _ in range(25):
        contacts = (axis_set, random_set)[count % 2](rng, count, d)
        found, W = is_form_closure(contacts), contacts.scaled_wrenches
        best = evenest(W, found.rank)
        if best.pushes is None:
            assert found.margin == LEAST_MARGIN
            continue
        t, rates = best.smallest, W.T @ best.direction
        # feasibility tolerance of the linear program in floating point
        tolerance = 1e-8 * max(1.0, abs(t))
        assert np.abs(W @ best.pushes).max() < tolerance
        assert best.pushes.sum() == pytest.approx(1.0, abs=tolerance)
        assert best.pushes.min() == pytest.approx(t, abs=tolerance)
        # for any pushes of sum 1:  0 = lam . rates >= min(lam) sum(rates) - t (1 - N min(lam))
        assert rates.min() >= -t - tolerance
        assert rates.sum() + count * t == pytest.approx(1.0, abs=count * tolerance)
        assert found.margin == pytest.approx(t if found else min(t, 0.0), abs=tolerance)


def hard(name):
    return Contacts.along(HARD[name]["points"], HARD[name]["directions"])


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("name", HARD)
def test_contacts_that_are_hard_on_linear_programs_are_judged_in_words(name, exact):
    found = is_form_closure(hard(name), exact=exact)
    assert not found
    assert (found.order, found.immobility.pushes) == (0, None)
    assert "no form closure" in found.message == str(found)
    assert found.rank == 6


@pytest.mark.parametrize("name", HARD)
def test_the_margin_of_a_unique_balance_is_its_smallest_push_without_rounding(name):
    contacts = hard(name)
    rows = list(zip(*given_columns(contacts), strict=True))
    balance = plane_normals(rows)[0]  # orthogonal to the six rows of W: the null vector
    sizes = np.linalg.norm(np.array(contacts.written[1]), axis=1)
    pushes = [push * Fraction(size) for push, size in zip(balance, sizes, strict=True)]
    t = min(push / sum(pushes) for push in pushes)
    # the sum of a null vector of length 1 is known to some 1e-16
    tolerance = 1e-14 * max(1.0, abs(float(t)))
    assert is_form_closure(contacts).margin == pytest.approx(float(t), rel=tolerance, abs=1e-12)


def test_twins_and_normals_of_single_precision_never_cost_the_words(rng):
    for number in range(40):
        count = 7 + number % 5
        points = rng.uniform(-0.5, 0.5, size=(count, 3))
        axis, side = rng.integers(0, 3, count), rng.choice([-0.5, 0.5], count)
        points[np.arange(count), axis] = side
        directions = -2.0 * side[:, None] * np.eye(3)[axis]
        if number % 2:
            directions = directions + 1e-7 * rng.normal(size=directions.shape)
        else:
            points[1], directions[1] = points[0] + 10.0 ** -(3 + number % 10), directions[0]
        found = is_form_closure(Contacts.along(points, directions))
        assert np.isfinite(found.margin)
        assert (found.margin > 0.0) == found.closed
        assert found.message
        assert found.order in ((1,) if found else (0, 2))


def test_programs_that_give_up_cost_sharpness_and_not_the_verdict(monkeypatch, rng):
    contacts = [random_set(rng, 9, 3) for _ in range(12)]
    sure = [is_form_closure(one) for one in contacts]
    expected = [(bool(one), one.margin) for one in sure]

    def gives_up(*_, **__):
        return OptimizeResult(success=False, x=None, status=4, message="HiGHS Status 15")

    monkeypatch.setattr("scipy.optimize.linprog", gives_up)
    for one, (closed, margin) in zip(contacts, expected, strict=True):
        found = is_form_closure(one)
        assert found.closed == closed
        assert np.isfinite(found.margin)
        assert found.margin <= margin + 1e-9
        assert found.immobility.proven == closed
        assert found.message
    assert 0 < sum(map(bool, sure)) < 12


# --- worked examples ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["form_closure_planar_five", "form_closure_planar_six", "form_closure_spatial_twelve"]
)
def test_worked_marginal_grasps_close_with_all_their_contacts_and_the_worked_margin(name):
    contacts, expected = worked(name), WORKED[name]["expected"]
    for exact in (False, True):
        found = is_form_closure(contacts, exact=exact)
        assert found.closed is True
        assert found.margin == pytest.approx(expected["max_min_coefficient"], abs=1e-9)
        assert found.order == 1


def test_no_proper_subset_of_the_planar_six_closes():
    contacts = worked("form_closure_planar_six")
    for size in range(1, 6):
        for chosen in combinations(range(6), size):
            assert not is_form_closure(contacts.subset(chosen))


def test_no_seven_and_no_eleven_of_the_spatial_twelve_close():
    contacts = worked("form_closure_spatial_twelve")
    for size in (7, 11):
        chosen = np.array(list(combinations(range(12), size)))
        found = closed_many(contacts.points[chosen], contacts.normals[chosen])
        assert len(found) == {7: 792, 11: 12}[size]
        assert not found.closed.any()


@pytest.mark.parametrize("sample", BLOCK["expected"]["samples"], ids=lambda s: str(s["xy"]))
def test_worked_block_closes_where_its_six_solve_the_seventh_with_negative_signs(sample):
    inputs = BLOCK["inputs"]
    contacts = Contacts(
        [*inputs["points"], [*sample["xy"], inputs["z7"]]], [*inputs["normals"], inputs["e7"]]
    )
    found = is_form_closure(contacts)
    assert found.closed is sample["form_closure"]
    if found:
        ratios = found.coefficients[:6] / found.coefficients[6]
        assert ratios == pytest.approx(-np.array(sample["W6inv_w7"]), rel=1e-9)


# --- distance, band -----------------------------------------------------------------------------


def hull_radius(W):
    """Distance of the origin from the facets of the convex hull, by qhull; negative outside."""
    return -float(np.max(ConvexHull(W.T).equations[:, -1]))


def test_distance_is_the_radius_of_the_ball_in_the_hull(rng):
    checked = 0
    for count in (7, 9, 12):
        for _ in range(60):
            contacts = random_set(rng, count, 3)
            found = is_form_closure(contacts)
            radius = hull_radius(contacts.scaled_wrenches)
            assert found.closed == (radius > 0)
            if not found:
                continue
            checked += 1
            assert 0.0 < found.distance <= radius * (1.0 + 1e-9)
            if count == 7:
                assert found.distance == pytest.approx(radius, rel=1e-9)
    assert checked > 30


def worked_block(x, y):
    """The block of Example 2.1 in fractions, the seventh contact at (x, y)."""
    p1, p2, p3 = (
        [Fraction(text) for text in row.split()]
        for row in ("0.6 0.4 0.3", "0.5 0.5 0.3", "0.55 0.4 0.4")
    )
    points = [p1, p2, p3, *([-c for c in p] for p in (p1, p2, p3)), [x, y, Fraction("0.4")]]
    eye = np.eye(3, dtype=int)
    return Contacts.along(points, [*-eye, *eye, -eye[2]])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("depth", [Fraction(1, 10**k) for k in range(2, 21, 2)])
def test_a_grasp_within_the_band_is_called_open_and_borderline_and_exactly_decided(depth, sign):
    # the seventh contact is `depth` from the boundary x = 0.45 of its region, inside or outside
    contacts = worked_block(Fraction("0.45") - sign * depth, Fraction("0.4"))
    exact, rounded = is_form_closure(contacts, exact=True), is_form_closure(contacts)
    assert exact.closed == exactly_closed(contacts) == (sign > 0)
    radius = depth_of_simplex(contacts)
    assert rounded.tolerance == pytest.approx(BAND, rel=1e-2)
    assert rounded.closed == (radius > BAND)
    assert rounded.borderline == (abs(radius) < BAND)
    assert exact.borderline == rounded.borderline
    assert_proven(contacts, rounded)
    assert_proven(contacts, exact)


def test_a_touching_contact_makes_an_open_grasp_borderline_and_a_clear_way_out_does_not():
    tray = worked("form_closure_planar_six").subset(range(5))
    assert is_form_closure(tray).borderline
    corner = Contacts.along(
        [[0, 1], [0, 2], [0, 3], [1, 0], [2, 0]], [[1, 0], [1, 0], [1, 0], [0, 1], [0, 1]]
    )
    found = is_form_closure(corner)
    assert (found.closed, found.rank, found.borderline) == (False, 3, False)


@pytest.mark.parametrize(
    ("points", "normals"),
    [
        ([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]], [[0, 0, 1]] * 4),
        ([[1, 0, 0], [-1, 0, 0]], [[-1, 0, 0], [1, 0, 0]]),
        ([[0, 1, 1], [1, 0, 1], [1, 1, 0]], np.eye(3)),
    ],
    ids=["tray", "pinch", "corner"],
)
def test_of_many_free_motions_roundings_and_order_choose_none(points, normals, rng):
    points, normals = np.array(points, float), np.array(normals, float)
    expected = is_form_closure(Contacts(points, normals)).motion
    few = 4 * np.finfo(float).eps
    for _ in range(20):
        order = rng.permutation(len(points))
        found = is_form_closure(
            Contacts(
                (points + few * rng.uniform(-1, 1, points.shape))[order],
                (normals + few * rng.uniform(-1, 1, normals.shape))[order],
            )
        )
        assert found.motion == pytest.approx(expected, abs=1e-12)


def test_on_the_boundary_itself_nothing_closes_exactly():
    found = is_form_closure(worked_block(Fraction("0.45"), Fraction("0.4")), exact=True)
    assert (found.closed, found.borderline) == (False, True)


@pytest.mark.parametrize(("depth", "borderline"), [(1e-12, True), (1e-16, False)])
def test_a_rank_within_the_band_is_borderline_unless_rounding_explains_it(depth, borderline):
    turned = Fraction(depth)
    points, along = (
        [[-1, 0], [1, 0], [0, 1], [turned, -1]],
        [[1, 1], [-1, 1], [turned, -1], [0, -1]],
    )
    found = is_form_closure(Contacts.along(points, along))
    assert (found.closed, found.rank, found.borderline) == (False, 2, borderline)


def depth_of_simplex(contacts):
    """Signed distance of the origin inside the hull of n + 1 wrenches, facet by facet."""
    W = contacts.scaled_wrenches
    depths = []
    for j in range(W.shape[1]):
        others = np.delete(W, j, axis=1)
        edges = others[:, 1:] - others[:, :1]
        normal = np.linalg.svd(edges.T)[2][-1]
        side = np.sign(normal @ (W[:, j] - others[:, 0]))
        depths.append(-side * (normal @ others[:, 0]))
    return min(depths)


@pytest.mark.parametrize(("lever", "closed"), [(1e-5, True), (1e-8, True), (1e-12, False)])
def test_short_levers_close_until_the_band(lever, closed):
    points = [[-1, 0], [1, 0], [0, 1], [-lever, -1], [lever, -1]]
    contacts = Contacts(points, [[1, 0], [-1, 0], [0, -1], [0, 1], [0, 1]])
    found = is_form_closure(contacts)
    assert (found.closed, found.rank) == (closed, 3 if closed else 2)
    assert found.borderline == (not closed)
    assert is_form_closure(contacts, exact=True)


def test_on_the_edge_of_its_region_the_worked_block_is_immobile_to_second_order():
    contacts = worked_block(Fraction("0.45"), Fraction("0.4"))
    found = is_form_closure(contacts)
    assert found.leaving == (2,)
    staying = contacts.subset([0, 1, 3, 4, 5, 6])
    assert not movable_to_second_order(staying, found.motion)
    assert found.order == 2
    assert "It is borderline" in found.message


def test_points_far_from_the_origin_widen_the_band_and_no_more():
    near = worked("form_closure_planar_five")
    far = near.placed(np.array([[1, 0, 1e9], [0, 1, -1e9], [0, 0, 1]]))
    found = is_form_closure(far)
    assert found
    assert found.margin == pytest.approx(1 / 6, abs=1e-6)
    assert BAND < is_form_closure(near).tolerance < 1.01 * BAND
    # 1e9 is 2**30: points are good for 2**-22 of the unit
    assert 1e-7 < found.tolerance < 1e-4


# --- symmetry -----------------------------------------------------------------------------------


def pose(rng, d, reach):
    turn = expm(np.cross(np.eye(3), rng.normal(size=3))) if d == 3 else None
    if d == 2:
        c, s = np.cos(a := rng.uniform(0, 7)), np.sin(a)
        turn = np.array([[c, -s], [s, c]])
    X = np.eye(d + 1)
    X[:d, :d], X[:d, d] = turn, reach * rng.normal(size=d)
    return X


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    d=st.sampled_from([2, 3]),
    extra=st.integers(0, 5),
    scale=st.sampled_from([1e-6, 1e-3, 1.0, 10.0, 1e5]),
    reach=st.sampled_from([0.0, 1.0, 1e3]),
)
def test_neither_place_nor_axes_nor_size_nor_order_changes_the_verdict(
    seed, d, extra, scale, reach
):
    rng = np.random.default_rng(seed)
    count = 3 * (d - 1) + 1 + extra
    contacts = (random_set, axis_set)[seed % 2](rng, count, d)
    X, order = pose(rng, d, reach), rng.permutation(count)
    moved = contacts.placed(X)
    moved = Contacts.along(scale * moved.points, moved.normals).subset(order)
    here, there = is_form_closure(contacts), is_form_closure(moved)
    tolerance = 1e-9 * (1.0 + reach)
    assert (here.closed, here.rank, here.borderline) == (there.closed, there.rank, there.borderline)
    if count == contacts.freedoms + 1:
        assert there.distance == pytest.approx(here.distance, abs=tolerance)
    if here:
        assert there.margin == pytest.approx(here.margin, abs=tolerance)
    else:
        assert_proven(moved, there)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_another_contact_never_opens_a_closed_grasp(seed):
    rng = np.random.default_rng(seed)
    contacts = axis_set(rng, 10, 3)
    if is_form_closure(contacts):
        assert is_form_closure(contacts.joined(grid_set(rng, 1, 3)))


# --- many at once -------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "d"), [(7, 3), (4, 2), (9, 3), (6, 3), (3, 2)])
def test_many_decisions_are_the_single_ones(count, d, rng):
    sets = [family(rng, count, d) for family in FAMILIES[:4] for _ in range(25)]
    sets.append(Contacts.along(np.zeros((count, d)), np.eye(d)[np.zeros(count, dtype=int)]))
    many = closed_many([s.points for s in sets], [s.normals for s in sets])
    singles = [is_form_closure(s) for s in sets]
    assert many.closed.tolist() == [s.closed for s in singles]
    assert many.borderline.tolist() == [s.borderline for s in singles]
    assert many.distances == pytest.approx(np.array([s.distance for s in singles]), abs=ROUNDING)


def test_a_balance_does_not_depend_on_the_other_sets_of_its_batch(rng):
    """A small feature has small determinants; that another set is singular does not matter."""
    points = 1e-6 * rng.normal(size=(50, 7, 3))
    normals = rng.normal(size=(50, 7, 3))
    W = np.moveaxis(wrenches_of(points, normals), 0, 2)
    alone = balance_inverses(W)
    assert np.all(np.any(alone != 0.0, axis=(1, 2)))
    W = np.concatenate([W, np.repeat(W[:1, :1], 7, axis=1)])
    np.testing.assert_array_equal(balance_inverses(W)[:-1], alone)
    assert not balance_inverses(W)[-1].any()


def test_many_decisions_in_parts_are_those_of_the_whole(rng, monkeypatch):
    points = rng.normal(size=(50, 4, 2))
    normals = -points / np.linalg.norm(points, axis=2, keepdims=True)
    whole = closed_many(points, normals)
    monkeypatch.setattr("multiarm.grasp.closure.form_closure.CHUNK", 7)
    assert np.array_equal(closed_many(points, normals).closed, whole.closed)


# --- what cannot be held; words -----------------------------------------------------------------


def on_revolution(rng, count):
    """Contacts on a body of revolution about a random line, and that line."""
    height, radius = rng.uniform(-1, 1, count), rng.uniform(0.3, 1, count)
    slope, angle = rng.normal(size=count), rng.uniform(0, 2 * np.pi, count)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    axis = np.array([0.0, 0.0, 1.0])
    contacts = Contacts.along(
        radius[:, None] * out + height[:, None] * axis, slope[:, None] * axis - out
    )
    X = pose(rng, 3, 1.0)
    return contacts.placed(X), X[:3, 3], X[:3, 2]


def test_bodies_of_revolution_are_never_held_and_the_axis_is_named(rng):
    for _ in range(20):
        contacts, through, axis = on_revolution(rng, 12)
        found = is_form_closure(contacts)
        assert not found
        assert found.rank == 5
        assert "body of revolution" in found.message
        assert found.leaving == ()
        assert "turn about the line" in found.message
        assert np.abs(np.cross(found.motion[3:], axis)).max() < 1e-9
        assert np.abs(found.motion[:3] + np.cross(found.motion[3:], through)).max() < 1e-9


def test_concentric_normals_are_recognised(rng):
    along = rng.normal(size=(20, 3))
    found = is_form_closure(Contacts.along([1.0, 2.0, 3.0] - along, along))
    assert (found.closed, found.rank) == (False, 3)
    assert "All normal lines meet at (1, 2, 3)" in found.message
    assert "sphere" in found.message


@pytest.mark.parametrize(
    ("points", "normals", "words"),
    [
        ([[0, 0, 0]], [[0, 0, 1]], ["1 contact never closes in space, at least 7", "parallel"]),
        ([[0, 1], [0, -1]], [[0, -1], [0, 1]], ["2 contacts never close in the plane, at least 4"]),
        (
            [[-1, 1], [1, 1], [-1, -1], [1, -1]],
            [[1, 0], [-1, 0], [1, 0], [-1, 0]],
            ["rank 2 of 3", "slide along (0, 1)", "All normals are parallel"],
        ),
        (
            [[-1, 0], [1, 0], [0, 1], [-0.5, 1]],
            [[1, 0], [-1, 0], [0, -1], [0, -1]],
            ["no pushes of all 4 contacts balance", "away from contact 3."],
        ),
        (
            [[1, 0], [0, 1], [-1, 0], [0, -1]],
            [[0, 1], [-1, 0], [0, -1], [1, 0]],
            ["turn about the point (0, 0), away from every contact"],
        ),
    ],
)
def test_messages_say_what_is_missing_and_how_the_body_can_move(points, normals, words):
    message = is_form_closure(Contacts.along(points, normals)).message
    for word in words:
        assert word in message
    assert message.startswith("no form closure")


def test_the_centre_of_a_turn_is_named_where_it_is():
    contacts = Contacts.along([[5, 4], [2, 5], [0, 4], [3, 3]], [[-1, 0], [1, -1], [1, 0], [0, 1]])
    assert "turn about the point (3, 4), all contacts sliding" in is_form_closure(contacts).message


def test_contact_points_on_the_axis_of_the_only_motion_rest(rng):
    points = np.zeros((8, 3))
    points[:, 2] = rng.normal(size=8)
    contacts = Contacts.along(points, rng.normal(size=(8, 3)))
    found = is_form_closure(contacts)
    assert found.rank == 5
    assert found.motion == pytest.approx([0, 0, 0, 0, 0, 1 / contacts.length], abs=1e-9) or (
        found.motion == pytest.approx([0, 0, 0, 0, 0, -1 / contacts.length], abs=1e-9)
    )


def test_words_stay_right_far_from_the_origin(rng):
    contacts, _, _ = on_revolution(rng, 9)
    far = Contacts(contacts.points + [1e6, -2e6, 1e6], contacts.normals)
    found = is_form_closure(far)
    assert found.leaving == ()
    assert "turn about the line" in found.message
    assert "body of revolution" in found.message


def test_points_are_named_with_digits_of_the_grasp_and_not_of_its_distance(rng):
    """All normal lines meet in a point 512.3456 m away from the origin, 0.1 m from the contacts."""
    meeting = np.array([512.3456, -2.5, 33.125])
    e = rng.normal(size=(7, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    message = is_form_closure(Contacts(meeting - 0.1 * e, e)).message
    assert "(512.3456, -2.5, 33.125)" in message


def test_a_closed_grasp_says_so():
    found = is_form_closure(worked("form_closure_planar_five"))
    assert str(found) == "5 contacts hold the body: form closure"
    assert found.leaving == ()
    assert 0.0 < found.conditioning <= 1.0


def test_the_margin_of_contacts_without_any_balance_is_the_least_one():
    assert is_form_closure(Contacts([[0, 0, 0]], [[0, 0, 1]])).margin == LEAST_MARGIN == -1e10


# --- second order -------------------------------------------------------------------------------


def gap_accelerations(contacts, twist):
    """Second derivatives of the gaps along the screw motion of a twist, by central differences."""
    d, step = contacts.dimension, 1e-4
    generator = np.zeros((d + 1, d + 1))
    generator[:d, d] = twist[:d]
    w = twist[d:]
    generator[:d, :d] = (
        [[0, -w[0]], [w[0], 0]]
        if d == 2
        else [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    )
    fingers = np.column_stack([contacts.points, np.ones(len(contacts))])

    def gaps(s):
        seen = fingers @ np.linalg.inv(expm(s * generator)).T
        return -np.sum(contacts.normals * (seen[:, :d] - contacts.points), axis=1)

    return (gaps(step) + gaps(-step)) / step**2


def movable_to_second_order(contacts, twist):
    """Whether some acceleration keeps every gap from closing, for a twist that leaves them."""
    h = gap_accelerations(contacts, twist)
    W, n = contacts.wrenches, contacts.freedoms
    solved = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.column_stack([-W.T, np.ones(len(contacts))]),
        b_ub=h,
        bounds=[(None, None)] * n + [(None, 1.0)],
    )
    return solved.x[-1] > -1e-6


def three_lines(rng, outward=1.0):
    """Three planar fingers on lines through one point, positively balanced."""
    angles = np.array([0.0, 2.0, 4.2]) + rng.uniform(-0.3, 0.3, 3)
    out = np.column_stack([np.cos(angles), np.sin(angles)])
    return Contacts.along(rng.uniform(-1.2, 1.2, (3, 1)) * out, -outward * out).placed(
        pose(rng, 2, 1.0)
    )


def test_three_concurrent_fingers_are_immobile_to_second_order_when_turning_presses_them(rng):
    orders = []
    for _ in range(30):
        contacts = three_lines(rng)
        found = is_form_closure(contacts)
        assert found.rank == 2
        assert found.order == (0 if movable_to_second_order(contacts, found.motion) else 2)
        assert found.immobility.proven
        assert ("second order" in found.message) == (found.order == 2)
        orders.append(found.order)
    assert 5 < orders.count(2) < 25


@pytest.mark.slow
def test_one_free_motion_in_space_is_decided_as_by_differences_of_the_gaps(rng):
    orders = []
    for number in range(75):
        contacts = on_revolution(rng, 7 + number % 3)[0]
        found = is_form_closure(contacts)
        assert found.rank == 5
        assert found.order == (0 if movable_to_second_order(contacts, found.motion) else 2)
        assert found.immobility.proven
        orders.append(found.order)
    assert 5 < orders.count(2) < 40


@pytest.mark.parametrize(("sign", "order"), [(-1, 2), (1, 0)])
def test_a_tetrahedron_with_a_finger_on_each_face_is_immobile_and_its_inside_out_is_not(
    sign, order
):
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    found = is_form_closure(Contacts.along(corners, sign * corners))
    assert (found.rank, found.order, found.immobility.proven) == (3, order, True)
    if order == 2:
        pushes = found.immobility.pushes
        assert pushes == pytest.approx(np.full(4, 0.25))


@pytest.mark.slow
def test_concentric_fingers_are_decided_by_the_form_in_three_turns(rng):
    # pushes lam balance along unit directions e toward the centre, from depths r:
    # the form is  - sum lam r (I - e e^T)
    orders = []
    while len(orders) < 30:
        e = rng.normal(size=(4, 3))
        e /= np.linalg.norm(e, axis=1)[:, None]
        lam = np.linalg.svd(e.T)[2][-1]
        if abs(np.sign(lam).sum()) < 4:
            continue
        r = rng.uniform(-0.5, 1.0, 4)
        form = np.einsum("j,jkl->kl", abs(lam) * r, np.eye(3) - e[:, :, None] * e[:, None, :])
        found = is_form_closure(Contacts(-r[:, None] * e, e).placed(pose(rng, 3, 1.0)))
        assert found.order == (2 if np.linalg.eigvalsh(form)[0] > 0.0 else 0)
        assert found.immobility.proven
        orders.append(found.order)
    assert 5 < orders.count(2) < 25


@pytest.mark.slow
def test_what_is_called_immobile_has_no_motion_that_differences_leave_free(rng):
    orders = []
    for _ in range(20):
        e = rng.normal(size=(6, 3))
        e /= np.linalg.norm(e, axis=1)[:, None]
        contacts = Contacts(-rng.uniform(-0.6, 1.0, (6, 1)) * e, e)
        found = is_form_closure(contacts)
        orders.append(found.order)
        ways = np.hstack([np.zeros((6, 3)), rng.normal(size=(6, 3))])
        free = [movable_to_second_order(contacts, w / np.linalg.norm(w)) for w in ways]
        assert not (found.order == 2 and any(free))
    assert 3 < orders.count(2) < 17


def test_blocking_pushes_balance_and_block_every_free_motion(rng):
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    contacts = Contacts.along(corners, -corners).placed(pose(rng, 3, 1.0))
    pushes = is_form_closure(contacts).immobility.pushes
    assert np.abs(contacts.scaled_wrenches @ pushes).max() < 1e-9
    free = np.linalg.svd(contacts.wrenches.T)[2][3:]
    for weights in rng.normal(size=(20, 3)):
        twist = weights @ free
        assert pushes @ gap_accelerations(contacts, twist / np.linalg.norm(twist)) < -1e-3


def test_a_translation_is_never_blocked():
    pinch = Contacts([[-1, 0], [1, 0]], [[1, 0], [-1, 0]])
    found = is_form_closure(pinch)
    assert (found.order, found.immobility.proven) == (0, True)


def test_contacts_that_carry_nothing_make_a_search_over_several_motions_no_proof(rng):
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    inside_out = Contacts.along(corners, corners)
    beside = Contacts.along([[2.0, 0.3, 0.1]], [[1, 2, 3]])
    assert is_form_closure(inside_out).immobility.proven
    found = is_form_closure(inside_out.joined(beside)).immobility
    assert (found.order, found.proven) == (0, False)
    # with one free motion there is no search
    plane = Contacts.along([[1, 0], [-0.5, 0.8], [-0.5, -0.8]], [[1, 0], [-0.5, 0.8], [-0.5, -0.8]])
    found = is_form_closure(plane.joined(Contacts.along([[3, 1]], [[1, 0]]))).immobility
    assert (found.order, found.proven) == (0, True)


def test_what_the_band_calls_open_although_nothing_is_free_has_no_proven_order():
    points = [[-1, 0], [1, 0], [0, 1], [-1.5e-10, -1], [1.5e-10, -1]]
    found = is_form_closure(Contacts(points, [[1, 0], [-1, 0], [0, -1], [0, 1], [0, 1]]))
    assert (found.closed, found.rank, found.borderline) == (False, 3, True)
    assert (found.order, found.immobility.proven) == (0, False)


def test_contacts_that_never_balance_leave_the_body_movable(rng):
    assert is_form_closure(Contacts.along(rng.normal(size=(4, 3)), [[0, 0, 1]] * 4)).order == 0


# --- borders ------------------------------------------------------------------------------------


def test_a_single_normal_of_another_length_has_a_number():
    with refused(GraspError, "normal 1, [0.0, 0.0, 2.0], has length 2, not 1"):
        unit_vectors(np.array([0.0, 0.0, 2.0]))


def test_what_is_not_contacts_is_refused():
    with refused(GraspError, "not list"):
        is_form_closure([[0, 0, 1]])


@pytest.mark.parametrize(
    ("points", "normals", "place"),
    [
        (np.zeros((2, 7)), np.zeros((2, 7)), "(M, N, 3)"),
        (np.zeros((2, 7, 3)), np.zeros((2, 6, 3)), "not (2, 7, 3) and (2, 6, 3)"),
        (np.zeros((1, 2, 2)), [[[1, 0], [0, 0.5]]], "normal 2 of set 1"),
        ([[[0, np.nan]]], [[[1, 0]]], "number 1"),
        ([[["a", 0]]], [[[1, 0]]], "'a'"),
    ],
)
def test_many_sets_of_the_wrong_kind_are_refused(points, normals, place):
    with refused(GraspError, place):
        closed_many(points, normals)


@pytest.mark.slow
def test_seven_contacts_are_decided_without_scipy():
    code = (
        "import sys, numpy as np\n"
        "from multiarm.grasp.contacts import Contacts\n"
        "from multiarm.grasp.closure.form_closure import is_form_closure\n"
        "p = np.random.default_rng(0).normal(size=(7, 3))\n"
        "is_form_closure(Contacts.along(p, -p)).closed\n"
        "print('scipy' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_wrenches_of_many_sets_are_those_of_one(rng):
    p, e = rng.normal(size=(2, 5, 3)), rng.normal(size=(2, 5, 3))
    assert np.allclose(wrenches_of(p, e)[:, 1], wrenches_of(p[1], e[1]))
