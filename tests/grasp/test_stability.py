"""Claims about what displacements of contacts do to a grasp.

Oracles: the worked numbers; wrench matrices inverted; every corner of a product of squares decided
by linear programming on its own; nearest singular matrices by construction; SciPy's intervals.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from refusals import refused
from repository import WORKED
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from multiarm.errors import GraspError
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import closed_many, is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.blocks import design_block_grasp
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.stability.closure_radii import (
    Minor,
    _of_discs,
    closure_radius,
    independence_radius,
    tangents_of,
)
from multiarm.grasp.stability.configuration_stability import (
    configuration_stability,
    monte_carlo_stability,
    own_regions,
)

BLOCK = WORKED["example_2_1"]["inputs"]


def block_grasp(x=0.4, y=0.4):
    """The worked block with the seventh contact on top."""
    points = np.vstack([BLOCK["points"], [[x, y, 0.4]]])
    return Contacts(points, np.vstack([BLOCK["normals"], [[0.0, 0.0, -1.0]]]))


def random_grasp(rng, count=7):
    """Random contacts in form closure, on planes in general position."""
    while True:
        points, normals = rng.standard_normal((2, count, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        if closed_many(points[None], normals[None]).distances[0] > 1e-3:
            return Contacts(points, normals)


def wrenches(contacts, moves=0.0):
    """Column by column, written out."""
    points = contacts.points + moves
    return np.hstack([contacts.normals, np.cross(points, contacts.normals)]).T


def closes(contacts, moves):
    """By the null vector of seven wrenches, from an SVD."""
    null = np.linalg.svd(wrenches(contacts, moves))[2][-1]
    return bool(np.all(null > 0) or np.all(null < 0))


def closes_by_program(contacts, moves):
    """By linear programming: lambda >= 1 with W lambda = 0."""
    W = wrenches(contacts, moves)
    result = linprog(np.ones(W.shape[1]), A_eq=W, b_eq=np.zeros(6), bounds=(1.0, None))
    return result.status == 0


def in_discs(rng, contacts, r, count):
    """Displacements of length r in random directions in the faces, (count, N, 3)."""
    angle = rng.uniform(0, 2 * np.pi, (count, contacts.count, 1))
    t = tangents_of(contacts)
    return r * (np.cos(angle) * t[:, 0] + np.sin(angle) * t[:, 1])


# --- six independent contacts --------------------------------------------------------------------


def test_limit_of_independence_has_the_worked_numbers():
    expected = WORKED["independence_limit"]["expected"]
    found = configuration_stability(Contacts(BLOCK["points"], BLOCK["normals"]))
    np.testing.assert_allclose(found.a, expected["a"], atol=1e-12)
    assert found.r_star == pytest.approx(expected["r_star"], abs=1e-12)
    assert found.sigma_min == pytest.approx(expected["singular_values"][-1], abs=1e-12)
    assert found.delta_max == pytest.approx(expected["delta_max"], abs=1e-12)
    assert found.six == (0, 1, 2, 3, 4, 5) and found.measures is None


def test_block_inverse_of_random_contacts_has_the_worked_parts():
    given, expected = (WORKED["block_inverse"][key] for key in ("inputs", "expected"))
    found = configuration_stability(Contacts(given["points"], given["normals"]))
    np.testing.assert_allclose(found.T1, expected["T1"], atol=1e-9)
    np.testing.assert_allclose(found.a, expected["a"], atol=1e-9)


def test_r_star_is_the_distance_to_the_nearest_singular_matrix(rng):
    for _ in range(20):
        found = configuration_stability(random_grasp(rng))
        a, r = found.a, found.r_star
        # Taking off each column's part along u makes u a left null vector.
        solved = [np.linalg.solve(a.T, s) for s in product((-1.0, 1.0), repeat=3)]
        u = max(solved, key=np.linalg.norm)
        u /= np.linalg.norm(u)
        taken = np.outer(u, u @ a)
        assert np.linalg.norm(taken, axis=0).max() == pytest.approx(r, rel=1e-9)
        assert abs(np.linalg.det(a - taken)) < 1e-12 * np.abs(a).max() ** 3
        assert found.sigma_min / np.sqrt(3.0) <= r * (1 + 1e-9) <= found.sigma_min * (1 + 2e-9)
        changes = rng.standard_normal((500, 3, 3))
        changes *= 0.999 * r / np.linalg.norm(changes, axis=1, keepdims=True)
        assert np.all(np.sign(np.linalg.det(a + changes)) == np.sign(np.linalg.det(a)))


def test_delta_max_is_below_the_exact_radius_of_independence(rng):
    for contacts in (
        Contacts(BLOCK["points"], BLOCK["normals"]),
        random_grasp(rng).subset(range(6)),
    ):
        limit = configuration_stability(contacts).delta_max
        exact = independence_radius(contacts)
        assert 0.0 < limit <= exact.lower <= exact.upper <= 1.001 * exact.lower
        sign = np.sign(np.linalg.det(wrenches(contacts)))
        for moves in in_discs(rng, contacts, 0.9999 * exact.lower, 300):
            assert np.sign(np.linalg.det(wrenches(contacts, moves))) == sign
        broken = np.linalg.det(wrenches(contacts, exact.displacements))
        assert abs(broken) < 1e-9 * abs(np.linalg.det(wrenches(contacts)))


def test_delta_max_counts_what_displacements_do_to_each_column(rng):
    """Column j of a moves by its own contact and by those of T1's column j, all at their worst."""
    for _ in range(10):
        found = configuration_stability(random_grasp(rng).subset(range(6)))
        T1 = found.T1
        worst = max(1 + abs(T1[0, j]) + abs(T1[1, j]) + abs(T1[2, j]) for j in range(3))
        assert found.delta_max == pytest.approx(found.r_star / worst, rel=1e-12)


def test_normals_that_do_not_span_in_front_are_put_behind():
    """The first three contacts of this order have two parallel normals."""
    contacts = block_grasp().subset([0, 3, 1, 4, 2, 5, 6])
    found = configuration_stability(contacts)
    assert found.six[:3] == (0, 2, 4) and sorted(found.six) == list(range(6))
    plain = configuration_stability(block_grasp())
    assert found.r_star == pytest.approx(plain.r_star, rel=1e-9)


# --- measures of the seventh contact -------------------------------------------------------------


def test_measures_of_example_2_4_have_the_corrected_numbers():
    expected = WORKED["example_2_4"]["expected"]
    found = configuration_stability(block_grasp(0.4, 0.4))
    assert found.determinant == pytest.approx(expected["det_sum"], abs=1e-12)
    assert found.measures[0] == pytest.approx(expected["M1"], abs=1e-12)
    assert found.measures[2] == pytest.approx(expected["M2"], abs=1e-12)
    # In the order e_t, f_t, e_b, f_b; the bottom ones count from the mirrored axes.
    rates = np.r_[found.gradient[0, 2, :2], -found.gradient[0, 5, :2]]
    np.testing.assert_allclose(rates, expected["dM1_d_et_ft_eb_fb"], atol=1e-12)
    changes = np.abs(WORKED["example_2_4"]["inputs"]["contact_changes"])
    assert np.abs(rates) @ changes == pytest.approx(expected["corrected_bound"], abs=1e-12)
    signed = rates @ WORKED["example_2_4"]["inputs"]["contact_changes"]
    assert signed == pytest.approx(expected["true_change"], abs=1e-12)
    assert found.closed


def test_measures_over_the_determinant_are_the_coefficients_of_the_seventh_contact(rng):
    for _ in range(20):
        contacts = random_grasp(rng)
        found = configuration_stability(contacts)
        W = wrenches(contacts)
        seventh = next(j for j in range(7) if j not in found.six)
        coefficients = np.linalg.solve(W[:, list(found.six)], W[:, seventh])
        np.testing.assert_allclose(found.measures / found.determinant, coefficients, rtol=1e-9)
        assert found.closed == is_form_closure(contacts).closed
    opened = Contacts(contacts.points, contacts.normals * np.r_[np.ones(6), -1.0][:, None])
    assert not configuration_stability(opened).closed and configuration_stability(opened).poor


def test_gradients_are_differences_and_changes_bound_them(rng):
    contacts = random_grasp(rng)
    delta = rng.uniform(0.5, 1.5, 7) * 1e-5
    found = configuration_stability(contacts, displacement=delta)
    moves = in_discs(rng, contacts, 1.0, 200) * delta[:, None]
    values = np.r_[found.determinant, found.measures]
    rates = np.concatenate([found.determinant_gradient[None], found.gradient])
    for move in moves:
        moved = configuration_stability(Contacts(contacts.points + move, contacts.normals))
        change = np.r_[moved.determinant, moved.measures] - values
        np.testing.assert_allclose(change, np.einsum("kjx,jx->k", rates, move), atol=1e-8)
        assert np.all(np.abs(change) <= found.changes * (1 + 1e-3) + 1e-10)
    worst = rates[3] / np.linalg.norm(rates[3], axis=1, keepdims=True).clip(1e-300)
    assert np.sum(rates[3] * worst * delta[:, None]) == pytest.approx(found.changes[3], rel=1e-9)
    np.testing.assert_allclose(found.ratios, np.abs(values) / found.changes, rtol=1e-12)


def test_a_contact_near_the_edge_of_its_region_makes_a_poor_grasp():
    # The region's edge on y = 0.4 is at x = 0.45; M1 is 0.8 (x - 0.55) there.
    assert not configuration_stability(block_grasp(0.0, 0.3), displacement=1e-3).poor
    assert configuration_stability(block_grasp(0.449, 0.4), displacement=1e-3).poor


def test_own_radii_are_the_distances_at_which_single_contacts_lose_the_grasp(rng):
    for contacts in (block_grasp(0.0, 0.3), random_grasp(rng)):
        found = configuration_stability(contacts)
        t = tangents_of(contacts)
        angles = np.linspace(0.0, 2 * np.pi, 721)[:, None]
        circle = np.stack([np.cos(angles), np.sin(angles)])
        for j in range(7):
            moves = np.zeros((721, 7, 3))
            moves[:, j] = circle[0] * t[j, 0] + circle[1] * t[j, 1]
            inside, beyond = (
                closed_many(
                    contacts.points + part * found.own_radii[j] * moves,
                    np.broadcast_to(contacts.normals, moves.shape),
                ).closed
                for part in (0.999, 1.001)
            )
            assert inside.all() and not beyond.all()


def test_own_regions_hold_the_contacts_and_the_regions_of_the_seventh():
    body = Polyhedron.box(2 * np.array(BLOCK["half_size"]))
    contacts = block_grasp(0.0, 0.3)
    faces = tuple(
        next(k for k, face in enumerate(body.faces) if np.allclose(face.normal, -e))
        for e in contacts.normals
    )
    grippers = (Gripper("a", (0, 1, 2, 6), np.eye(4)), Gripper("b", (3, 4, 5), np.eye(4)))
    regions = own_regions(Grasp(body, contacts, faces, grippers))
    assert regions[6].area == pytest.approx(WORKED["example_2_1"]["expected"]["region_area"])
    for region, point in zip(regions, contacts.points, strict=True):
        assert region.contains(point[None]).all()
    six = Grasp(
        body, contacts.subset(range(6)), faces[:6],
        (Gripper("a", (0, 1, 2), np.eye(4)), Gripper("b", (3, 4, 5), np.eye(4))),
    )  # fmt: skip
    with refused(GraspError, "seven contacts"):
        own_regions(six)


def test_own_region_is_none_where_the_other_contacts_are_dependent():
    body = Polyhedron.box(2 * np.array(BLOCK["half_size"]))
    six = block_grasp(0.0, 0.3).subset(range(6))
    seven = six.subset([0, 1, 2, 3, 4, 4]).joined(six.subset([5]))
    faces = tuple(
        next(k for k, face in enumerate(body.faces) if np.allclose(face.normal, -e))
        for e in seven.normals
    )
    grippers = (Gripper("a", (0, 1, 2, 6), np.eye(4)), Gripper("b", (3, 4, 5), np.eye(4)))
    regions = own_regions(Grasp(body, seven, faces, grippers))
    assert [region is None for region in regions] == [True, True, True, True, False, False, True]


# --- the closure radius --------------------------------------------------------------------------


def every_corner(contacts, r):
    """Closure at each of the 4^7 corners of squares of half width r, each decided by itself."""
    t = tangents_of(contacts)
    signs = np.array(list(product((-1.0, 1.0), repeat=2)))
    each = r * np.einsum("cs,jsx->jcx", signs, t)  # (7, 4, 3)
    which = np.array(list(product(range(4), repeat=7)))
    points = contacts.points + each[np.arange(7), which]
    return closed_many(points, np.broadcast_to(contacts.normals, points.shape)).closed


@pytest.mark.slow
def test_radius_of_squares_is_where_the_first_of_all_corners_opens(rng):
    for contacts in (block_grasp(0.0, 0.3), random_grasp(rng), random_grasp(rng)):
        found = closure_radius(contacts, shape="square")
        assert found.lower == found.upper > 0.0
        assert every_corner(contacts, found.lower * (1 - 1e-6)).all()
        assert not every_corner(contacts, found.lower * (1 + 1e-6)).all()


@pytest.mark.slow
def test_no_displacement_within_the_radius_opens_the_grasp_and_one_at_it_does(rng):
    for contacts in (block_grasp(0.4, 0.4), random_grasp(rng), random_grasp(rng)):
        found = closure_radius(contacts)
        assert 0.0 < found.lower <= found.upper <= (1 + 1e-6) * found.lower
        for size in (0.999, 1.0 - 1e-6):
            moves = in_discs(rng, contacts, size * found.lower, 20000)
            normals = np.broadcast_to(contacts.normals, moves.shape)
            assert closed_many(contacts.points + moves, normals).closed.all()
        worst = found.displacements
        assert np.linalg.norm(worst, axis=1).max() == pytest.approx(found.upper, rel=1e-9)
        np.testing.assert_allclose(np.sum(worst * contacts.normals, axis=1), 0.0, atol=1e-12)
        assert closes(contacts, (1 - 1e-4) * worst) and not closes(contacts, (1 + 1e-4) * worst)
        assert not closes_by_program(contacts, 1.001 * worst)
        square = closure_radius(contacts, shape="square").lower
        assert square <= found.lower * (1 + 1e-9) <= np.sqrt(2.0) * square * (1 + 2e-9)


@pytest.mark.slow
def test_the_lower_bound_needs_no_luck_in_finding_the_worst_displacements(rng):
    """Directions that are not the worst, and a radius far too large, leave a bound that holds."""

    class Blind(Minor):
        def broken_by(self, start, r):
            turned = start + 0.7 * np.linalg.norm(start) * rng.standard_normal(start.shape)
            return 2.0 * r, turned / np.linalg.norm(turned, axis=1, keepdims=True)

    for _ in range(4):
        six = random_grasp(rng).subset(range(6))
        truth = independence_radius(six)
        lower, upper, _ = _of_discs(Blind(six, tangents_of(six), None))
        assert lower * six.length <= truth.upper * (1 + 1e-9) < upper * six.length
        assert lower * six.length > 0.85 * truth.lower


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-3, 10.0])
def test_radii_grow_with_the_body_and_move_with_it(rng, size):
    contacts = random_grasp(rng)
    R, shift = Rotation.random(rng=rng).as_matrix(), 100.0 * rng.standard_normal(3)
    moved = Contacts(size * (contacts.points + shift) @ R.T, contacts.normals @ R.T)
    renumbered = moved.subset(rng.permutation(7))
    for shape in ("disc", "square"):
        plain = closure_radius(contacts, shape=shape)
        for other in (moved, renumbered):
            found = closure_radius(other, shape=shape)
            assert found.lower == pytest.approx(size * plain.lower, rel=1e-6)
    a, b = configuration_stability(contacts), configuration_stability(moved)
    assert b.r_star == pytest.approx(size * a.r_star, rel=1e-8)
    assert b.delta_max == pytest.approx(size * a.delta_max, rel=1e-8)
    np.testing.assert_allclose(b.measures, size**3 * a.measures, rtol=1e-8)
    np.testing.assert_allclose(b.own_radii, size * a.own_radii, rtol=1e-8)
    np.testing.assert_allclose(b.ratios, a.ratios, rtol=1e-8)  # displacement by itself scales too


def test_axes_of_the_squares_may_be_given(rng):
    contacts = random_grasp(rng)
    t = tangents_of(contacts)
    turned = np.stack([t[:, 0] + t[:, 1], t[:, 1] - t[:, 0]], axis=1) / np.sqrt(2.0)
    found = closure_radius(contacts, shape="square", axes=turned)
    assert found.lower != closure_radius(contacts, shape="square").lower
    along = np.abs(np.einsum("jx,jsx->js", found.displacements, turned)).max(axis=1)
    np.testing.assert_allclose(along[along > 0], found.upper, rtol=1e-9)
    with refused(GraspError, "orthonormal"):
        closure_radius(contacts, axes=t + 0.1)
    with refused(GraspError, "shape (7, 2, 3)"):
        closure_radius(contacts, axes=t[:3])


@pytest.mark.slow
def test_open_contacts_have_no_radius_and_eight_have_that_of_seven(rng):
    assert closure_radius(block_grasp(0.5, 0.4)).lower == 0.0
    eight = random_grasp(rng, 8)
    found = closure_radius(eight)
    seven = [closure_radius(eight.subset([j for j in range(8) if j != k])).lower for k in range(8)]
    assert found.lower == pytest.approx(max(seven), rel=1e-9) and found.upper == np.inf
    moves = in_discs(rng, eight, 0.999 * found.lower, 300)
    normals = np.broadcast_to(eight.normals, moves.shape)
    assert closed_many(eight.points + moves, normals).closed.all()


@pytest.mark.slow
def test_of_many_contacts_some_sets_of_seven_are_drawn(rng):
    """Thirty contacts have two million sets of seven, a gigabyte of points and normals."""
    seven = block_grasp()
    others = random_grasp(rng, 23)
    many = seven.joined(others)
    radius = closure_radius(many)
    assert radius.lower > 0.0 and radius.lower == closure_radius(many).lower
    for moves in in_discs(rng, many, 0.999 * radius.lower, 50):
        assert closes_by_program(many, moves)


def test_six_opposed_pairs_have_no_seven_that_hold_by_themselves():
    """Twelve contacts close, no seven of them do; the radius says that it does not know."""
    given = WORKED["form_closure_spatial_twelve"]["inputs"]
    contacts = Contacts(given["points"], given["normals"])
    assert is_form_closure(contacts)
    found = closure_radius(contacts)
    assert found.lower == 0.0 and found.upper == np.inf and "no seven" in found.message


# --- by lot --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_drawn_share_is_all_within_the_radius_and_falls_beyond(rng):
    contacts = block_grasp(0.4, 0.4)
    radius = closure_radius(contacts).lower
    assert monte_carlo_stability(contacts, 0.999 * radius, 2000, rng).fraction == 1.0
    shares = [monte_carlo_stability(contacts, k * radius, 4000, 3).fraction for k in (2, 4, 8)]
    assert 1.0 > shares[0] > shares[1] > shares[2] > 0.0


@pytest.mark.slow
def test_drawn_share_of_one_contact_is_the_part_of_its_disc_that_closes():
    """Counted on a grid, by null vectors."""
    contacts, partly = block_grasp(0.1, 0.3), 0
    steps = np.linspace(-1.0, 1.0, 41)
    grid = np.array([(u, v) for u, v in product(steps, steps) if u * u + v * v < 1.0])
    for j, t in enumerate(tangents_of(contacts)):
        radius = np.zeros(contacts.count)
        radius[j] = 0.3
        one = radius[:, None]
        share = np.mean([closes(contacts, one * (place @ t)) for place in grid])
        found = monte_carlo_stability(contacts, radius, 20_000, j, confidence=0.9999)
        assert found.low - 0.01 < share < found.high + 0.01
        partly += 0.1 < share < 0.9
    assert partly > 2


def test_intervals_are_wilsons_and_draws_are_repeatable():
    contacts = block_grasp(0.4, 0.4)
    found = monte_carlo_stability(contacts, 0.02, 1000, np.random.default_rng(8), confidence=0.9)
    again = monte_carlo_stability(contacts, 0.02, 1000, 8, confidence=0.9)
    assert (found.kept, found.low, found.high) == (again.kept, again.low, again.high)
    interval = binomtest(found.kept, 1000).proportion_ci(0.9, method="wilson")
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high), rel=1e-12)
    assert found.low < found.fraction < found.high


def test_only_the_contacts_that_may_move_do():
    contacts = block_grasp(0.449, 0.4)  # a millimetre from the edge of its region
    still = np.r_[np.zeros(6), 9e-4 * 0.5]
    assert monte_carlo_stability(contacts, still, 500, 1).fraction == 1.0
    moved = monte_carlo_stability(contacts, np.r_[np.full(6, 0.01), 0.0], 500, 1)
    assert 0.2 < moved.fraction < 0.8


# --- what is refused -----------------------------------------------------------------------------


def test_unusable_questions_are_refused_by_name():
    flat = Contacts([[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]])
    contacts = block_grasp()
    with refused(GraspError, "6 contacts or more in space are needed here, not 2 in the plane"):
        configuration_stability(flat)
    with refused(GraspError, "rank"):
        configuration_stability(
            Contacts(0.5 * np.vstack([np.eye(3), -np.eye(3)]), np.vstack([-np.eye(3), np.eye(3)]))
        )
    with refused(GraspError, "displacement is one length or one for each of the 7"):
        configuration_stability(contacts, displacement=[1.0, 2.0])
    with refused(GraspError, "displacement"):
        configuration_stability(contacts, displacement=-1.0)
    with refused(GraspError, "displacement", "not 'far'"):
        configuration_stability(contacts, displacement="far")
    with refused(GraspError, "axes have shape", "not 'x and y'"):
        closure_radius(contacts, axes="x and y")
    with refused(GraspError, "7 contacts or more in space"):
        closure_radius(contacts.subset(range(6)))
    with refused(GraspError, "'disc' or 'square', not 'ball'"):
        closure_radius(contacts, shape="ball")
    with refused(GraspError, "plane"):
        closure_radius(flat)
    with refused(GraspError, "not 7"):
        independence_radius(contacts)
    for samples in (0, -1, 2.5, np.nan, np.inf, "many", None):
        with refused(GraspError, "samples is a positive whole number, not"):
            monte_carlo_stability(contacts, 0.1, samples)
    for confidence in (0.0, 1.0, np.nan, "high"):
        with refused(GraspError, "confidence is a number between 0 and 1, not"):
            monte_carlo_stability(contacts, 0.1, 10, confidence=confidence)
    assert monte_carlo_stability(contacts, 0.1, 2e2, 3).samples == 200
    same = [monte_carlo_stability(contacts, 0.1, 2000).fraction for _ in range(3)]
    assert same[0] == same[1] == same[2]
    with refused(GraspError, "plane"):
        monte_carlo_stability(flat, 0.1)


def test_without_displacement_nothing_changes_at_any_size():
    """Also for a body of ten metres, whose measures are large."""
    grasp = design_block_grasp([12.0, 8.0, 6.0])
    found = configuration_stability(grasp.contacts, displacement=0.0)
    assert np.all(np.isinf(found.ratios))
    assert not found.poor
