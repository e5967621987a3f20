"""Contact forces for a wrench, and maps of what can be carried: optimality, proofs, statics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import WORKED
from scipy.linalg import expm
from scipy.optimize import linprog

from multiarm.dynamics.forces import distribution
from multiarm.errors import GraspError
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.forces.force_distribution import distribute_forces
from multiarm.grasp.forces.load_maps import liftable, load_capacity, worst_force
from multiarm.programs import (
    LeastDistance,
    least_distance,
    linear_program,
    nonnegative_least_squares,
)

# slack of the bounds, and the linear programs' own tolerance, relative to the forces
TOLERANCE = 1e-7


@pytest.fixture
def five():
    """The worked planar five: a pinch along x at y = 0, one finger above, two below."""
    inputs = WORKED["form_closure_planar_five"]["inputs"]
    return Contacts(inputs["points"], inputs["normals"])


def random_contacts(rng, count, d=3, at=0.0):
    points = rng.normal(size=(count, d))
    return Contacts.along(points + at, -points + 0.4 * rng.normal(size=(count, d)))


def closed_contacts(rng, count, d=3):
    while True:
        contacts = random_contacts(rng, count, d)
        if is_form_closure(contacts).margin > 1e-3:
            return contacts


def largest_by_program(contacts, wrench, minimum, limit):
    """The smallest largest force by a linear program over the forces themselves; inf if none."""
    count = contacts.count
    most = [None] * count if limit is None else np.broadcast_to(limit, count)
    least = np.broadcast_to(minimum, count)
    solved = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.column_stack([np.eye(count), -np.ones(count)]),
        b_ub=np.zeros(count),
        A_eq=np.column_stack([contacts.wrenches, np.zeros(contacts.freedoms)]),
        b_eq=wrench,
        bounds=[*zip(least, most, strict=True), (None, None)],
    )
    return solved.fun if solved.success else np.inf


def problems(rng, count):
    """Contacts, wrench, minimum, limit: feasible ones and others, bounds of all kinds."""
    for number in range(count):
        contacts = random_contacts(rng, int(rng.integers(5, 13)), at=(0.0, 10.0)[number % 2])
        if number % 3:
            wrench = contacts.wrenches @ rng.uniform(0.0, 5.0, contacts.count)
        else:
            wrench = 10.0 * rng.normal(size=6)
        minimum = rng.uniform(0.0, 1.0, contacts.count) if number % 4 < 2 else 0.0
        limit = minimum + rng.uniform(2.0, 30.0, contacts.count) if number % 5 < 3 else None
        yield contacts, wrench, minimum, limit


def assert_within(contacts, wrench, minimum, limit, forces):
    size = np.abs(forces).max()
    assert np.abs(contacts.wrenches @ forces - wrench).max() < 20 * TOLERANCE * max(size, 1.0)
    assert np.all(forces >= np.asarray(minimum))
    assert limit is None or np.all(forces <= limit)


# --- distribution -------------------------------------------------------------------------------


def test_largest_force_is_that_of_the_linear_program_over_the_forces(rng):
    feasible = 0
    for contacts, wrench, minimum, limit in problems(rng, 80):
        found = distribute_forces(contacts, wrench, minimum=minimum, limit=limit)
        expected = largest_by_program(contacts, wrench, minimum, limit)
        assert found.feasible == np.isfinite(expected)
        assert found.value == pytest.approx(expected, rel=1e-6)
        if found:
            feasible += 1
            assert_within(contacts, wrench, minimum, limit, found.forces)
            assert found.forces.max() <= found.value * (1.0 + TOLERANCE)
            assert found.residual < TOLERANCE * found.value
    assert 20 < feasible < 70


def test_least_norm_meets_the_conditions_of_its_optimum(rng):
    for contacts, wrench, minimum, limit in problems(rng, 60):
        found = distribute_forces(contacts, wrench, minimum=minimum, limit=limit, objective="norm")
        assert found.feasible == np.isfinite(largest_by_program(contacts, wrench, minimum, limit))
        if not found:
            continue
        lam, norm = found.forces, found.value
        assert_within(contacts, wrench, minimum, limit, lam)
        assert norm == pytest.approx(np.linalg.norm(lam), rel=TOLERANCE)
        # gradient of the norm: wrench part, plus prices that have the sign of a tight bound
        prices = lam / norm - contacts.wrenches.T @ found.sensitivity
        assert prices == pytest.approx(found.force_prices, abs=1e-6)
        at_least = lam - minimum < TOLERANCE * norm
        at_most = np.zeros(len(lam), bool) if limit is None else limit - lam < TOLERANCE * norm
        assert np.all(np.abs(prices[~at_least & ~at_most]) < 1e-6)
        assert np.all(prices[at_least & ~at_most] > -1e-6)
        assert np.all(prices[at_most & ~at_least] < 1e-6)


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_bounds_of_a_program_may_be_any_sequence_of_pairs(kind):
    bounds = kind([(1.0, 5.0), (2.0, 6.0)])
    np.testing.assert_allclose(linear_program(np.ones(2), bounds=bounds).x, [1.0, 2.0])
    np.testing.assert_allclose(linear_program(np.ones(2), bounds=(1.0, None)).x, [1.0, 1.0])


def test_forces_are_not_called_the_least_norm_where_rounding_hides_it(five, monkeypatch):
    def hidden(G, h, room=0.0):
        return LeastDistance(np.zeros(G.shape[1]), 0.0, np.zeros(len(h)))

    wrench = (1.0, 2.0, 0.1)
    least = distribute_forces(five, wrench, minimum=1.0, objective="norm")
    monkeypatch.setattr(distribution, "least_distance", hidden)
    found = distribute_forces(five, wrench, minimum=1.0, objective="norm")
    assert_within(five, wrench, 1.0, None, found.forces)
    assert found and found.value > least.value * (1.0 + TOLERANCE)
    assert found.sensitivity is None and found.force_prices is None
    assert "rounding" in found.message and "rounding" not in least.message


def test_among_forces_with_the_smallest_largest_the_least_norm_is_taken(rng):
    for _ in range(15):
        contacts = closed_contacts(rng, 10)
        wrench = rng.normal(size=6)
        found = distribute_forces(contacts, wrench)
        limited = distribute_forces(
            contacts, wrench, objective="norm", limit=found.value * (1.0 + 1e-7)
        )
        assert found.forces == pytest.approx(limited.forces, abs=1e-4 * found.value)


@pytest.mark.parametrize("objective", ["largest", "norm"])
def test_sensitivities_support_the_value_which_is_convex(objective, rng):
    # a convex function lies above every one of its tangents, kinks included
    checked = 0
    for contacts, wrench, minimum, limit in problems(rng, 40):
        keywords = {"objective": objective, "minimum": minimum, "limit": limit}
        here = distribute_forces(contacts, wrench, **keywords)
        if not here:
            continue
        checked += 1
        for step in (1e-3, 0.1, 1.0):
            change = step * rng.normal(size=6)
            there = distribute_forces(contacts, wrench + change, **keywords)
            assert there.value >= here.value + here.sensitivity @ change - 1e-5 * here.value
        more = np.where(here.force_prices > 0.0, rng.uniform(0.0, 0.3, contacts.count), 0.0)
        less = np.where(here.force_prices < 0.0, rng.uniform(0.0, 0.3, contacts.count), 0.0)
        tight = {**keywords, "minimum": minimum + more}
        if limit is not None:
            tight["limit"] = limit - less
        there = distribute_forces(contacts, wrench, **tight)
        gain = here.force_prices @ (more + (0.0 if limit is None else -less))
        assert there.value >= here.value + gain - 1e-5 * here.value
    assert checked > 10


@pytest.mark.parametrize("objective", ["largest", "norm"])
def test_a_wrench_that_cannot_be_exerted_comes_with_a_motion_that_proves_it(objective, rng):
    refused = 0
    for contacts, wrench, minimum, limit in problems(rng, 60):
        found = distribute_forces(
            contacts, wrench, minimum=minimum, limit=limit, objective=objective
        )
        if found:
            assert found.motion is None
            continue
        refused += 1
        assert found.forces is None
        assert found.value == np.inf
        rates = contacts.wrenches.T @ found.motion
        most = np.where(rates > 1e-6, np.inf, 0.0) if limit is None else rates * limit
        work = np.sum(np.where(rates > 0.0, most, rates * minimum))
        assert work < wrench @ found.motion
        arms = contacts.points
        speeds = np.linalg.norm(found.motion[:3] + np.cross(found.motion[3:], arms), axis=1)
        assert speeds.max() == pytest.approx(1.0, rel=1e-6)
        assert "cannot exert the wrench" in found.message
    assert refused > 10


def test_form_closure_exerts_every_wrench_and_an_open_grasp_not_against_its_motion(rng):
    for _ in range(10):
        contacts = closed_contacts(rng, int(rng.integers(7, 12)))
        assert distribute_forces(contacts, rng.normal(size=6), minimum=0.1)
        few = random_contacts(rng, 6)
        motion = is_form_closure(few).motion
        assert not distribute_forces(few, -motion)


def test_worked_planar_grasp_has_the_forces_of_statics(five):
    # 10 N upward at the middle: half from each finger below
    up = distribute_forces(five, [0.0, 10.0, 0.0])
    assert up.forces == pytest.approx([0, 0, 0, 5, 5], abs=TOLERANCE)
    assert up.value == pytest.approx(5.0)
    assert up.sensitivity[1] == pytest.approx(0.5)
    # squeeze: the finger above balances both below
    squeezed = distribute_forces(five, [0, 0, 0], minimum=1.0)
    assert squeezed.forces == pytest.approx([1, 1, 2, 1, 1], abs=TOLERANCE)
    # a couple of 3 N m: one finger below at 1 m, the one above against it
    turned = distribute_forces(five, [0, 0, 3], objective="norm")
    assert turned.forces == pytest.approx([0, 0, 3, 0, 3], abs=TOLERANCE)
    assert turned.value == pytest.approx(np.sqrt(18.0))
    both = distribute_forces(five, [0, 0, 3], limit=[9, 9, 2, 9, 9])
    assert not both


FIVE = [[1, 0], [-1, 0], [0, -1], [0, 1], [0, 1]]


def lever_grasp(lever):
    return [[-1, 0], [1, 0], [0, 1], [-lever, -1], [lever, -1]]


@pytest.mark.parametrize("lever", [1e-2, 1e-4, 1e-6, 1e-8])
def test_short_levers_take_large_forces_and_exert_the_wrench_all_the_same(lever):
    # 1 N m from two fingers below at +- lever, and from the one above
    contacts = Contacts(lever_grasp(lever), FIVE)
    for objective, value in (("largest", 1 / lever), ("norm", np.sqrt(2) / lever)):
        found = distribute_forces(contacts, [0, 0, 1], objective=objective)
        assert found.value == pytest.approx(value, rel=1e-6)
        assert found.residual < TOLERANCE * value
        if lever > 1e-7:  # rounding hides more which forces can be spared
            assert found.forces * lever == pytest.approx([0, 0, 1, 0, 1], abs=TOLERANCE)
        assert distribute_forces(contacts, [0, 0, 1], objective=objective, limit=2 / lever)
        assert not distribute_forces(contacts, [0, 0, 1], objective=objective, limit=0.9 / lever)


def cube_grasp(places):
    """Contacts at the same places of all six faces of a cube."""
    points, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for place in places:
                points.append(np.roll([side, *place], axis))
                normals.append(np.roll([-side, 0.0, 0.0], axis))
    return points, normals


# two pinches along x, and one finger that alone can push upward
ALONE = [[-1, 0], [1, 0], [-1, 0.5], [1, 0.5], [0, -1]], [[1, 0], [-1, 0], [1, 0], [-1, 0], [0, 1]]
CORNERS = [(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
# Grasps some of whose forces have no room, no part in the internal forces, or the same wrench as
# others: in floating-point numbers, what decides about them is rounding.
UNDECIDED = {
    "short lever": (lever_grasp(1e-2), FIVE, [0, 0, 1], {}),
    "shorter lever": (lever_grasp(1e-4), FIVE, [0, 0, 1], {}),
    "shortest lever": (lever_grasp(1e-6), FIVE, [0, 0, 1], {}),
    "squeezed five": (lever_grasp(1.0), FIVE, [0, 0, 0], {"minimum": 1.0}),
    "alone at its limit": (*ALONE, [0, 5, 1], {"limit": [9, 9, 9, 9, 5]}),
    "alone above its limit by less than tolerance": (
        *ALONE,
        [3, 5, 0.2],
        {"limit": [9, 9, 9, 9, 5 - 1e-9]},
    ),
    "cube above its limit by less than tolerance": (
        *cube_grasp(CORNERS),
        [0, 0, 10, 0, 0, 0],
        {"limit": 2.5 - 1e-9},
    ),
    "alone between its bounds": (*ALONE, [0, 5, 1], {"minimum": [1, 0, 0, 0, 5], "limit": 5}),
    "cube": (*cube_grasp([(0.5, 0.5), (-0.5, -0.5)]), [1, 2, 3, 0, 0, 0], {"limit": 5.0}),
    "cube by its corners": (*cube_grasp(CORNERS), [0, 0, 10, 1, 0, 0], {}),
    "limited cube": (*cube_grasp(CORNERS), [0, 0, 10, 5, 0, 0], {"limit": 2.5}),
    "squeezed cube": (*cube_grasp(CORNERS), [0, 0, 10, 0, 0, 0], {"minimum": 1.0}),
}


@pytest.mark.parametrize("objective", ["largest", "norm"])
@pytest.mark.parametrize("grasp", UNDECIDED)
def test_roundings_and_the_order_of_the_contacts_do_not_decide_the_forces(grasp, objective, rng):
    points, normals, wrench, bounds = UNDECIDED[grasp]
    points, normals = np.array(points, float), np.array(normals, float)
    expected = distribute_forces(Contacts(points, normals), wrench, objective=objective, **bounds)
    few = 4 * np.finfo(float).eps
    for _ in range(30):
        order = rng.permutation(len(points))
        contacts = Contacts(
            (points + few * rng.uniform(-1, 1, points.shape))[order],
            (normals + few * rng.uniform(-1, 1, normals.shape))[order],
        )
        ordered = {
            name: np.broadcast_to(bound, len(order))[order] for name, bound in bounds.items()
        }
        found = distribute_forces(contacts, wrench, objective=objective, **ordered)
        assert found.value == pytest.approx(expected.value, rel=TOLERANCE)
        assert found.forces == pytest.approx(expected.forces[order], abs=TOLERANCE * expected.value)
        assert found.residual < 0.1 * TOLERANCE * found.value


@pytest.mark.parametrize("depth", [1e-2, 1e-5, 1e-8])
def test_a_grasp_that_hardly_closes_squeezes_until_its_weakest_contact_pushes(depth):
    # the block of Example 2.1, its seventh contact `depth` inside its region: one internal force
    inputs = WORKED["example_2_1"]["inputs"]
    contacts = Contacts(
        [*inputs["points"], [0.45 - depth, 0.4, 0.4]], [*inputs["normals"], inputs["e7"]]
    )
    wrench, minimum = np.array([0, 0, 10.0, 0, 0, 0]), 0.1
    inner = is_form_closure(contacts, exact=True).coefficients
    some = np.linalg.lstsq(contacts.wrenches, wrench, rcond=None)[0]
    expected = some + np.max((minimum - some) / inner) * inner
    for objective, value in (("largest", expected.max()), ("norm", np.linalg.norm(expected))):
        found = distribute_forces(contacts, wrench, minimum=minimum, objective=objective)
        # rounding of the points over the smallest of the inner forces
        assert found.value == pytest.approx(value, rel=1e-14 / depth + 1e-9)
        assert found.forces.min() >= minimum
        assert int(np.argmax(found.force_prices)) == int(np.argmin(found.forces)) == 2
        if objective == "norm":
            prices = expected / value - contacts.wrenches.T @ found.sensitivity
            size = found.force_prices.max()
            assert prices == pytest.approx(found.force_prices, abs=(1e-13 / depth + 1e-8) * size)


def test_no_wrench_takes_no_forces(five):
    for objective in ("largest", "norm"):
        found = distribute_forces(five, [0, 0, 0], objective=objective)
        assert found.feasible
        assert found.value == 0.0
        assert not found.forces.any()


def test_too_few_contacts_have_their_only_forces_or_a_reason(rng):
    contacts = random_contacts(rng, 4)
    forces = np.array([1.0, 2.0, 3.0, 4.0])
    for objective in ("largest", "norm"):
        found = distribute_forces(contacts, contacts.wrenches @ forces, objective=objective)
        assert found.forces == pytest.approx(forces)
        assert not distribute_forces(
            contacts, contacts.wrenches @ (forces - 2.0), objective=objective
        )
    beside = np.linalg.svd(contacts.wrenches)[0][:, -1]
    found = distribute_forces(contacts, beside)
    assert not found
    assert np.abs(contacts.wrenches.T @ found.motion).max() < 1e-12


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1e-3, 1.0, 10.0]),
    strength=st.sampled_from([1e-3, 1.0, 1e6]),
    objective=st.sampled_from(["largest", "norm"]),
)
def test_forces_do_not_depend_on_frame_size_or_units(seed, scale, strength, objective):
    rng = np.random.default_rng(seed)
    contacts, wrench = random_contacts(rng, 10), rng.normal(size=6)
    X = np.eye(4)
    X[:3, :3] = expm(np.cross(np.eye(3), rng.normal(size=3)))
    X[:3, 3] = 100.0 * rng.normal(size=3)
    moved = contacts.placed(X)
    moved = Contacts(scale * moved.points, moved.normals)
    force, moment = X[:3, :3] @ wrench[:3], X[:3, :3] @ wrench[3:]
    load = strength * np.concatenate([force, scale * (moment + np.cross(X[:3, 3], force))])
    here = distribute_forces(contacts, wrench, minimum=0.01, objective=objective)
    there = distribute_forces(moved, load, minimum=0.01 * strength, objective=objective)
    assert here.feasible == there.feasible
    if here:
        # the frame is 100 spreads away: 100 eps over the conditioning of the contacts
        assert there.value == pytest.approx(strength * here.value, rel=1e-6)
        assert there.forces == pytest.approx(
            strength * here.forces, abs=1e-5 * strength * here.value
        )


@pytest.mark.parametrize(
    ("keywords", "place"),
    [
        ({"objective": "least"}, "unknown objective 'least'; objectives are largest, norm"),
        ({"wrench": [0, 0]}, "three finite numbers [fx, fy, m], not [0.0, 0.0]"),
        ({"wrench": [0, np.nan, 0]}, "finite numbers"),
        ({"wrench": ["up", 0, 0]}, "'up'"),
        ({"minimum": -1.0}, "contacts only push"),
        ({"minimum": np.inf}, "must be finite"),
        ({"minimum": [1.0, 2.0]}, "a number or 5 of them, one for each contact"),
        ({"minimum": "much"}, "a number or 5 of them"),
        ({"limit": [np.nan] * 5}, "a number or 5 of them"),
        (
            {"minimum": 3.0, "limit": [9, 9, 2, 9, 9]},
            "contact 3 cannot push at least 3 N and at most 2 N",
        ),
    ],
)
def test_numbers_that_make_no_sense_are_refused(five, keywords, place):
    given = {"wrench": [0.0, 1.0, 0.0], **keywords}
    with refused(GraspError, place):
        distribute_forces(five, **given)


def test_a_wrench_in_space_has_six_numbers(rng):
    with refused(GraspError, "six finite numbers"):
        distribute_forces(random_contacts(rng, 7), [0, 0, 1])


# --- least distance -----------------------------------------------------------------------------


def test_least_distance_is_the_projection_onto_the_inequalities(rng):
    solved = 0
    for _ in range(60):
        G, h = rng.normal(size=(7, 3)), rng.normal(size=7)
        found = least_distance(G, h)
        feasible = linprog(np.zeros(3), A_ub=-G, b_ub=-h, bounds=(None, None)).success
        assert found.solved == feasible
        if feasible:
            solved += 1
            y, prices = found.point, found.prices
            assert np.all(G @ y >= h - 1e-9)
            assert G.T @ prices == pytest.approx(y, abs=1e-9)
            assert np.all(prices >= 0.0)
            assert np.abs(prices * (G @ y - h)).max() < 1e-10 * max(1.0, y @ y)
        else:
            assert np.abs(G.T @ found.weights).max() < 1e-9
            assert h @ found.weights > 0.5
    assert 10 < solved < 50


def test_least_squares_with_dependent_columns_are_at_their_minimum(rng):
    for number in range(300):
        A = (rng.integers(-1, 2, (6, 4)) @ rng.integers(-1, 2, (4, 30))).astype(float)
        A += 1e-15 * rng.normal(size=A.shape)
        b = rng.normal(size=6) if number else np.zeros(6)
        u = nonnegative_least_squares(A, b)
        gradient = A.T @ (A @ u - b)
        assert u.min() >= 0.0
        assert gradient.min() > -1e-8
        assert np.abs(gradient[u > 0.0]).max(initial=0.0) < 1e-8


# --- what can be carried ------------------------------------------------------------------------


def test_worst_load_is_worst_of_all_mixtures(rng):
    contacts = closed_contacts(rng, 9)
    loads = rng.normal(size=(5, 6))
    worst = worst_force(contacts, loads, minimum=0.1)
    values = [distribute_forces(contacts, w, minimum=0.1).value for w in loads]
    assert (worst.force, worst.load) == (max(values), int(np.argmax(values)))
    assert [found.value for found in worst.distributions] == values
    for shares in rng.dirichlet(np.ones(5), size=20):
        mixed = distribute_forces(contacts, shares @ loads, minimum=0.1)
        assert mixed.value <= worst.force * (1.0 + TOLERANCE)


def test_a_load_that_cannot_be_exerted_is_the_worst(five):
    worst = worst_force(five, [[0, 1, 0], [0, 100, 0], [0, 2, 0]], limit=10.0)
    assert (worst.force, worst.load) == (np.inf, 1)


def test_capacity_is_where_the_limited_forces_end(rng):
    contacts = closed_contacts(rng, 8)
    limit = rng.uniform(5.0, 20.0, 8)
    loads = rng.normal(size=(6, 6))
    found = load_capacity(contacts, loads, limit)
    assert found.weakest == int(np.argmin(found.multiples))
    for multiple, load in zip(found.multiples, loads, strict=True):
        assert multiple > 0.0
        assert distribute_forces(contacts, (1.0 - 1e-6) * multiple * load, limit=limit)
        assert not distribute_forces(contacts, (1.0 + 1e-6) * multiple * load, limit=limit)


def test_an_open_grasp_has_no_capacity_against_its_motion(rng):
    contacts = random_contacts(rng, 6)
    motion = is_form_closure(contacts).motion
    assert load_capacity(contacts, [-motion], 100.0).multiples == pytest.approx([0.0], abs=1e-6)


def test_maps_of_the_worked_planar_grasp_are_a_rectangle_and_a_hexagon(five):
    forces = liftable(five, 10.0, [0, 0, 0], [[1, 0, 0], [0, 1, 0]])
    assert corners(forces) == [(-10, -10), (-10, 20), (10, -10), (10, 20)]
    assert forces.area == pytest.approx(600.0)
    assert forces.margin == pytest.approx(10.0)
    assert forces.reach([0.0, 1.0]) == pytest.approx(20.0)
    assert forces.reach([3.0, 3.0]) == pytest.approx(10.0 / 3.0)
    # fy and m: the finger above takes 10 N, those below exert (1, -1) and (1, 1) each
    couples = liftable(five, 10.0, [0, 0, 0], [[0, 2, 0], [0, 0, 1]])
    assert corners(couples) == [(-5, 0), (0, -10), (0, 10), (5, -10), (5, 10), (10, 0)]
    assert couples.margin == pytest.approx(10.0 / np.sqrt(5.0))


def corners(found):
    return sorted(tuple(int(x) for x in np.round(v)) for v in found.vertices)


def test_map_is_convex_counter_clockwise_and_reaches_as_far_as_the_capacity(rng):
    contacts = closed_contacts(rng, 9)
    limit = rng.uniform(5.0, 20.0, 9)
    plane = rng.normal(size=(2, 6))
    found = liftable(contacts, limit, np.zeros(6), plane)
    before = found.vertices - np.roll(found.vertices, 1, axis=0)
    after = np.roll(before, -1, axis=0)
    assert np.all(before[:, 0] * after[:, 1] > before[:, 1] * after[:, 0])
    assert found.area > 0.0
    angles = rng.uniform(0.0, 2.0 * np.pi, 12)
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    multiples = load_capacity(contacts, ways @ plane, limit).multiples
    for way, multiple in zip(ways, multiples, strict=True):
        assert found.reach(way) == pytest.approx(multiple, rel=1e-6)
        assert found.contains(0.999 * multiple * way)
        assert not found.contains(1.001 * multiple * way)
    # the margin is the shortest way out, which the corners and edges contain
    assert 0.0 < found.margin <= min(found.reach(way) for way in ways)


def test_map_about_another_load_is_the_same_map_moved(rng):
    contacts = closed_contacts(rng, 8)
    plane = rng.normal(size=(2, 6))
    here = liftable(contacts, 10.0, np.zeros(6), plane)
    shift = 0.5 * here.vertices.mean(axis=0)
    there = liftable(contacts, 10.0, shift @ plane, plane)
    assert len(there.vertices) == len(here.vertices)
    assert there.area == pytest.approx(here.area, rel=1e-6)
    assert there.vertices + shift == pytest.approx(here.vertices, abs=1e-5 * here.area**0.5)
    outside = liftable(contacts, 10.0, 3.0 * here.vertices[0] @ plane, plane)
    assert outside.margin < 0.0
    assert outside.reach([1.0, 0.0]) == 0.0


def test_corners_of_a_map_exert_their_loads_and_no_more(rng):
    contacts = closed_contacts(rng, 8)
    plane = rng.normal(size=(2, 6))
    found = liftable(contacts, 10.0, np.zeros(6), plane, minimum=0.5)
    middle = found.vertices.mean(axis=0)
    for corner in found.vertices:
        inside, outside = (middle + (1.0 + s) * (corner - middle) for s in (-1e-5, 1e-5))
        assert distribute_forces(contacts, inside @ plane, minimum=0.5, limit=10.0)
        assert not distribute_forces(contacts, outside @ plane, minimum=0.5, limit=10.0)


@pytest.mark.parametrize("plane", [[[1, 0, 0], [0, 1, 0]], [[0, 1, 0], [1, 0, 0]]])
def test_a_map_may_be_a_segment_a_point_or_nothing(five, plane):
    pinch = five.subset([0, 1])
    segment = liftable(pinch, 10.0, [0, 0, 0], plane)
    assert len(segment.vertices) == 2
    assert (segment.area, segment.margin) == (0.0, 0.0)
    assert segment.contains(0.3 * segment.vertices[0])
    assert not segment.contains([1.0, 1.0])
    assert segment.reach([1.0, 1.0]) == 0.0
    point = liftable(five.subset([2]), 10.0, [0, 0, 0], [[1, 0, 0], [0, 0, 1]])
    assert point.vertices == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    nothing = liftable(pinch, 10.0, [0, 0, 1], plane)
    assert not nothing
    assert nothing.margin == -np.inf
    assert not nothing.contains([0.0, 0.0])


def test_places_in_a_map_that_are_none_are_refused(five):
    found = liftable(five, 10.0, [0, 0, 0], np.eye(3)[:2])
    nothing = liftable(five.subset([0, 1]), 10.0, [0, 0, 1], np.eye(3)[:2])
    with refused(GraspError, "(0, 0) leads nowhere"):
        found.reach((0.0, 0.0))
    for none in ((0, 0, 0), 1.0, "ab", (np.nan, 1.0), [[0, 1], [1, 0]]):
        for ask in (found.contains, found.reach, nothing.contains, nothing.reach):
            with refused(GraspError, "(x, y)"):
                ask(none)
    with refused(GraspError, "several wrenches are a list"):
        worst_force(five, 1.0)


@pytest.mark.parametrize(
    ("limit", "directions", "place"),
    [
        (None, [[1, 0, 0], [0, 1, 0]], "give a limit"),
        (np.inf, [[1, 0, 0], [0, 1, 0]], "give a limit"),
        (0.0, [[1, 0, 0], [0, 1, 0]], "give a positive limit"),
        (1.0, [[1, 0, 0]], "two directions of wrenches, not 1"),
        (1.0, [[1, 0, 0], [-2, 0, 0]], "parallel"),
        (1.0, [[1, 0, 0], [0, 0, 0]], "a direction of the map is zero"),
    ],
)
def test_maps_that_make_no_sense_are_refused(five, limit, directions, place):
    with refused(GraspError, place):
        liftable(five, limit, [0, 0, 0], directions)


def test_loads_that_make_no_sense_are_refused(five):
    with refused(GraspError, "worst of no loads"):
        worst_force(five, [])
    with refused(GraspError, "capacity for no loads"):
        load_capacity(five, [], 1.0)
    with refused(GraspError, "load 2 is zero"):
        load_capacity(five, [[0, 1, 0], [0, 0, 0]], 1.0)
