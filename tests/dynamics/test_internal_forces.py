"""Claims about internal forces: bases of what moves nothing, and forces split into two parts.

Oracles: the worked example; NumPy's pseudo-inverse; grasps with internal forces known beforehand.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mechanics import EPS, two_arm_block
from repository import WORKED
from scipy.optimize import nnls

import multiarm as ma
from multiarm.dynamics.forces.internal_forces import FORMS, decompose, distribute, internal_forces
from multiarm.errors import GraspError

BLOCK = WORKED["two_arm_block_system"]["expected"]
W_BLOCK = np.hstack([np.array(W) for W in BLOCK["Wo"]])
FORCES = np.array(BLOCK["mu_phys"])
WORKED_BASIS = [1.0, 0.8, 0.2, 0.4, 1.0, 0.8, 0.6]

grasps = st.builds(
    lambda seed, count: pressed_grasp(np.random.default_rng(seed), count),
    st.integers(0, 2**32 - 1),
    st.integers(7, 12),
)


def pushes(rng, count):
    """Wrenches of unit pushes at random points, (6, N)."""
    e, p = rng.standard_normal((count, 3)), rng.uniform(-0.5, 0.5, (count, 3))
    e /= np.linalg.norm(e, axis=1)[:, None]
    return np.hstack([e, np.cross(p, e)]).T


def pressed_grasp(rng, count):
    """A grasp and an internal force, between 0.2 and 1, that presses all of its contacts.

    The last row is made for that: it is a general wrench.
    """
    W, press = pushes(rng, count), rng.uniform(0.2, 1.0, count)
    W[:, -1] = -W[:, :-1] @ press[:-1] / press[-1]
    return W, press


def same_span(A, B, tol=1e-8):
    """Whether two matrices have one column space."""
    rank = [np.linalg.matrix_rank(M, tol) for M in (A, B, np.hstack([A, B]))]
    return A.shape == B.shape and rank[0] == rank[1] == rank[2] == A.shape[1]


# --- the worked example --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "rows"), [("nonnegative", None), ("echelon", None), ("echelon", (0,))]
)
def test_basis_of_the_worked_example(form, rows):
    internal = internal_forces(W_BLOCK, form, rows)
    np.testing.assert_allclose(internal.basis[:, 0], WORKED_BASIS, atol=1e-12)
    assert internal.rank == 6 and internal.count == 1
    assert internal.rows == ((0,) if form == "echelon" else ())


def test_internal_coordinate_of_the_worked_example():
    parts = decompose(W_BLOCK, FORCES, internal_forces(W_BLOCK, "echelon", (0,)))
    assert parts.coordinates == pytest.approx([BLOCK["mu_I"]], abs=1e-9)
    assert BLOCK["mu_I"] == pytest.approx(14.3719697090, abs=1e-9)
    np.testing.assert_allclose(parts.squeezing, BLOCK["mu_I"] * np.array(WORKED_BASIS), atol=1e-9)


def test_forces_of_the_worked_example_are_distributed_again():
    internal = internal_forces(W_BLOCK, "echelon", (0,))
    found = distribute(W_BLOCK, W_BLOCK @ FORCES, [BLOCK["mu_I"]], internal)
    np.testing.assert_allclose(found, FORCES, atol=1e-9)


# --- bases ---------------------------------------------------------------------------------------


@given(grasps, st.sampled_from(FORMS))
def test_every_form_spans_what_moves_nothing(grasp, form):
    W, _ = grasp
    internal = internal_forces(W, form)
    count = W.shape[1]
    assert internal.rank == 6 and internal.basis.shape == (count, count - 6)
    tol = 1e-10 * np.max(np.abs(W)) * np.max(np.abs(internal.basis))
    np.testing.assert_allclose(W @ internal.basis, 0.0, atol=tol)
    assert np.linalg.matrix_rank(internal.basis, 1e-9) == count - 6


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("places", [[(0.3, 0.3)] * 2, [(0.5, 0.2), (-0.5, -0.2)]])
def test_roundings_do_not_turn_the_basis(places, form, rng):
    # contacts at the same places of all six faces of a cube
    points = [np.roll([side, *at], axis) for axis in range(3) for side in (-1, 1) for at in places]
    normals = [
        np.roll([-side, 0, 0], axis) for axis in range(3) for side in (-1, 1) for _ in places
    ]
    W = np.hstack([normals, np.cross(points, normals)]).T
    expected = internal_forces(W, form)
    for _ in range(20):
        found = internal_forces(W + 4 * EPS * rng.uniform(-1, 1, W.shape), form)
        assert found.rows == expected.rows
        np.testing.assert_allclose(found.basis, expected.basis, atol=1e-12)


@given(grasps)
def test_orthonormal_form_keeps_lengths(grasp):
    A = internal_forces(grasp[0]).basis
    np.testing.assert_allclose(A.T @ A, np.eye(A.shape[1]), atol=1e-12)
    assert np.all(A.sum(axis=0) >= 0.0)


@given(grasps)
def test_nonnegative_form_has_no_negative_entry_and_a_column_that_presses_all(grasp):
    A = internal_forces(grasp[0], "nonnegative").basis
    assert np.min(A) >= 0.0
    assert np.min(A[:, 0]) > 1e-3
    np.testing.assert_allclose(np.max(A, axis=0), 1.0, atol=1e-14)
    # the other columns are as far from the first as the sign allows
    assert np.all(np.min(A[:, 1:], axis=0, initial=0.0) == 0.0)


def test_pressing_is_found_where_equal_forces_are_far_from_it(rng):
    """One contact with a force a thousandth of the others': the nearest to equal forces pulls."""
    found = 0
    for _ in range(200):
        W, press = pushes(rng, 9), rng.uniform(0.2, 1.0, 9)
        press[0] = 1e-3
        W[:, -1] = -W[:, :-1] @ press[:-1] / press[-1]
        null = np.linalg.svd(W)[2][6:].T
        found += np.min(null @ null.sum(axis=0)) < 0.0
        A = internal_forces(W, "nonnegative").basis
        assert np.min(A) >= 0.0 and np.min(A[:, 0]) > 1e-6
        np.testing.assert_allclose(W @ A, 0.0, atol=1e-9 * np.max(np.abs(W)))
    assert found > 20


@given(grasps)
def test_echelon_coordinates_are_the_deviations_of_chosen_contacts(grasp):
    """mu_I,j = lambda_j - (W_o^+ f_o)_j for the unit rows (3.7.3)."""
    W, press = grasp
    internal = internal_forces(W, "echelon")
    np.testing.assert_array_equal(internal.basis[list(internal.rows)], np.eye(internal.count))
    forces = press + np.arange(W.shape[1])
    parts = decompose(W, forces, internal)
    expected = (forces - np.linalg.pinv(W) @ W @ forces)[list(internal.rows)]
    np.testing.assert_allclose(parts.coordinates, expected, atol=1e-8)


def test_echelon_rows_are_chosen_by_number_or_name_in_their_order(rng):
    W, names = pushes(rng, 8), [f"tip {k}" for k in range(8)]
    internal = internal_forces(W, "echelon", ("tip 5", 2), names)
    assert internal.rows == (5, 2)
    np.testing.assert_array_equal(internal.basis[[5, 2]], np.eye(2))
    assert same_span(internal.basis, internal_forces(W).basis)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_bases_do_not_depend_on_the_size_of_the_grasp(size, rng):
    """Contacts a millimetre or a kilometre apart: the same forces move nothing."""
    W = pushes(rng, 9)
    scaled = np.repeat([1.0, size], 3)[:, None] * W
    for form in ("orthonormal", "echelon"):
        one, other = internal_forces(W, form), internal_forces(scaled, form)
        assert one.rank == other.rank == 6 and same_span(one.basis, other.basis)


def test_repeated_contacts_squeeze_each_other(rng):
    W = pushes(rng, 5)
    internal = internal_forces(np.hstack([W, -W[:, :1]]), "echelon", (5,))
    assert internal.rank == 5
    np.testing.assert_allclose(internal.basis[:, 0], [1, 0, 0, 0, 0, 1], atol=1e-12)


def test_contacts_without_internal_forces_have_an_empty_basis(rng):
    W = pushes(rng, 6)
    assert internal_forces(W).basis.shape == (6, 0)
    assert internal_forces(W, "echelon").rows == ()
    assert decompose(W, np.ones(6)).coordinates.shape == (0,)
    np.testing.assert_array_equal(decompose(W, np.ones(6)).moving, np.ones(6))
    with pytest.raises(GraspError, match=r"there are no internal forces .* add contacts"):
        internal_forces(W, "nonnegative")


# --- refusals ------------------------------------------------------------------------------------


def half_pressed():
    """Two pairs that press each other along x and y, and two contacts that both push along z."""
    e = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, 1]], float)
    return np.vstack([e.T, np.zeros((3, 6))])


def test_contacts_that_cannot_press_are_named():
    names = ["left", "right", "front", "back", "below", "under"]
    with pytest.raises(GraspError, match=r"at once: below, under would have to pull") as caught:
        internal_forces(half_pressed(), "nonnegative", names=names)
    assert "orthonormal or echelon" in str(caught.value)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_refusal_of_the_nonnegative_form_is_right(seed):
    """Against nonnegative least squares: a strictly positive null vector exists or not."""
    W = pushes(np.random.default_rng(seed), 8)
    # lambda = 1 + nu with nu >= 0 and W lambda = 0
    left_over = nnls(W, -W.sum(axis=1))[1]
    try:
        A = internal_forces(W, "nonnegative").basis
    except GraspError as error:
        assert left_over > 1e-9
        named = {int(j) for j in re.findall(r"contact (\d)", str(error))}
        assert named
        for j in named:  # one at least, the others not negative: impossible
            assert nnls(W, -W[:, j])[1] > 1e-9
        for j in set(range(8)) - named:
            assert nnls(W, -W[:, j])[1] < 1e-6
    else:
        assert left_over < 1e-6
        assert np.min(A) >= 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"form": "diagonal"}, "unknown form 'diagonal' .* orthonormal, nonnegative, echelon"),
        ({"rows": (0,)}, "echelon form only, not in the orthonormal"),
        ({"form": "echelon", "rows": (0, 1)}, "3 internal coordinates.*not 2; contact"),
        ({"form": "echelon", "rows": (0, 1, 1)}, "each once"),
        ({"form": "echelon", "rows": (0, 1, 9)}, "0 to 5"),
        ({"form": "echelon", "rows": (0, 1, 2)}, r"contact 0, contact 1, contact 2 cannot be"),
    ],
)
def test_a_wrong_choice_is_told_in_words(options, message):
    with pytest.raises(GraspError, match=message):
        internal_forces(half_pressed(), **options)


def test_rows_offered_instead_can_serve():
    with pytest.raises(GraspError) as caught:
        internal_forces(half_pressed(), "echelon", (0, 1, 2))
    offered = re.search(r"; (.*) can$", str(caught.value)).group(1)
    rows = [int(j) for j in re.findall(r"\d", offered)]
    assert internal_forces(half_pressed(), "echelon", rows).rows == tuple(rows)


def test_a_wrench_that_the_contacts_cannot_exert_is_refused_with_the_rest():
    with pytest.raises(GraspError, match=r"left over; their rank is 3 of 6") as caught:
        distribute(half_pressed(), [1.0, 2.0, 3.0, 0.0, 4.0, 0.0])
    assert "[0, 0, 0, 0, 4, 0]" in str(caught.value)


@pytest.mark.parametrize(
    ("wrench", "internal", "message"),
    [
        (np.zeros(5), None, "six finite numbers"),
        (np.full(6, np.nan), None, "six finite numbers"),
        (np.zeros(6), [1.0, 2.0], "3 internal coordinates; got 2"),
        (np.zeros(6), [1.0, np.nan, 2.0], "internal forces: a number is not finite"),
        (np.zeros(6), [[1.0, 2.0, 3.0]], r"internal forces: expected shape \(3,\)"),
    ],
)
def test_what_cannot_be_distributed_is_told_in_words(wrench, internal, message):
    with pytest.raises(GraspError, match=message):
        distribute(half_pressed(), wrench, internal)


def test_forces_of_another_number_of_contacts_are_refused():
    with pytest.raises(GraspError, match="6 contacts"):
        decompose(half_pressed(), np.zeros(5))
    with pytest.raises(GraspError, match="forces: a number is not finite"):
        decompose(half_pressed(), np.full(6, np.nan))
    with pytest.raises(GraspError, match=r"shape \(5, 2\)"):
        internal_forces(np.zeros((5, 2)))


# --- forces --------------------------------------------------------------------------------------


@given(grasps, st.integers(0, 2**32 - 1), st.sampled_from(FORMS))
def test_distribution_is_the_pseudo_inverse_plus_internal_forces(grasp, seed, form):
    W, rng = grasp[0], np.random.default_rng(seed)
    wrench, internal = rng.standard_normal(6), internal_forces(W, form)
    mu_I = rng.standard_normal(internal.count)
    forces = distribute(W, wrench, mu_I, internal)
    tol = 1e-12 * np.linalg.cond(W) * np.max(np.abs(forces))
    np.testing.assert_allclose(forces, np.linalg.pinv(W) @ wrench + internal.basis @ mu_I, atol=tol)
    parts = decompose(W, forces, internal)
    np.testing.assert_allclose(parts.wrench, wrench, atol=100 * tol)
    np.testing.assert_allclose(parts.moving + parts.squeezing, forces, atol=tol)
    np.testing.assert_allclose(parts.moving, np.linalg.pinv(W) @ wrench, atol=tol)
    condition = np.linalg.cond(internal.basis)
    np.testing.assert_allclose(parts.coordinates, mu_I, atol=10 * condition * tol)


def test_with_a_length_forces_are_measured_in_newtons(rng):
    """A doubled push counts twice, a couple of 1 N m as much as a push of 2 N at 0.5 m."""
    W = pushes(rng, 9)
    W[:, 1] *= 2.0
    W[:3, 2] = 0.0
    newtons = np.ones(9)
    newtons[1], newtons[2] = 2.0, np.linalg.norm(W[3:, 2]) / 0.5
    wrench = rng.standard_normal(6)
    expected = np.linalg.pinv(W / newtons) @ wrench / newtons
    np.testing.assert_allclose(distribute(W, wrench, length=0.5), expected, atol=1e-12)
    with pytest.raises(GraspError, match="length: a lever arm"):
        distribute(W, wrench, length=0.0)
    parts = decompose(W, expected + internal_forces(W).basis[:, 0], length=0.5)
    np.testing.assert_allclose(parts.moving, expected, atol=1e-12)
    assert np.max(np.abs(expected - distribute(W, wrench))) > 0.01


def test_redundant_contacts_that_agree_still_carry_what_they_can(rng):
    W = np.hstack([pushes(rng, 4)] * 2)
    forces = rng.standard_normal(8)
    found = distribute(W, W @ forces)
    np.testing.assert_allclose(found, np.linalg.pinv(W) @ W @ forces, atol=1e-12)


# --- several objects -----------------------------------------------------------------------------


def bodies_in_a_row(count):
    """Pushes along x: from outside on both ends of a row of bodies, and between neighbours."""
    W = np.zeros((6 * count, count + 1))
    for body in range(count):
        W[6 * body, body], W[6 * body, body + 1] = 1.0, -1.0
    return W


@pytest.mark.parametrize("form", FORMS)
def test_what_presses_a_row_of_bodies_goes_through_all_of_them(form):
    internal = internal_forces(bodies_in_a_row(3), form)
    assert internal.rank == 3 and internal.count == 1
    np.testing.assert_allclose(internal.basis[:, 0] / internal.basis[0, 0], 1.0, atol=1e-12)


def test_forces_on_a_row_of_bodies_are_distributed_over_all_contacts():
    """The middle one is pushed alone: by least squares the contacts share 1, 1, -2, -2 by 1/4."""
    W, wrench = bodies_in_a_row(3), np.zeros(18)
    wrench[6], expected = 1.0, np.array([0.5, 0.5, -0.5, -0.5])
    for length in (None, 0.3):
        np.testing.assert_allclose(distribute(W, wrench, length=length), expected, atol=1e-12)
    np.testing.assert_allclose(distribute(W, wrench, [4.0]), expected + 2.0, atol=1e-12)
    parts = decompose(W, expected + 3.0)
    np.testing.assert_allclose(parts.moving, expected, atol=1e-12)
    np.testing.assert_allclose(parts.wrench, wrench, atol=1e-12)
    wrench[7] = 1.0
    with pytest.raises(GraspError, match="left over; their rank is 3 of 18"):
        distribute(W, wrench)


# --- of a whole system ---------------------------------------------------------------------------


def test_evaluation_splits_the_worked_forces_by_arm(block_system):
    ev = ma.evaluate(block_system)
    internal = ev.internal_forces("echelon", ["one/contact 1"])
    np.testing.assert_allclose(internal.basis[:, 0], WORKED_BASIS, atol=1e-9)
    parts = ev.force_decomposition(internal)
    assert parts.coordinates == pytest.approx([BLOCK["mu_I"]], abs=1e-7)
    for name in ("one", "two"):
        total = parts.moving[name] + parts.squeezing[name]
        np.testing.assert_allclose(total, ev.contact_forces[name], atol=1e-10)
    squeezing = np.concatenate(list(parts.squeezing.values()))
    np.testing.assert_allclose(squeezing, BLOCK["mu_I"] * np.array(WORKED_BASIS), atol=1e-7)


def test_resultant_is_what_accelerates_the_object(block_system):
    """Newton and Euler about the centre of mass, in object axes."""
    ev = ma.evaluate(block_system)
    data = WORKED["two_arm_block_system"]["inputs"]
    R, omega = np.array(data["Ro"]), np.array(data["vo"][3:])
    force = data["mo"] * (ev.object_acceleration[:3] - [0.0, 0.0, -9.81])
    inertia = R @ np.diag(data["Io"]) @ R.T
    moment = inertia @ ev.object_acceleration[3:] + np.cross(omega, inertia @ omega)
    wrench = ev.force_decomposition().wrench
    np.testing.assert_allclose(wrench, np.concatenate([R.T @ force, R.T @ moment]), atol=1e-8)


def test_squeezing_moves_nothing_and_moving_is_smallest(block_system):
    ev = ma.evaluate(block_system)
    parts, forms = ev.force_decomposition(), [ev.internal_forces(form) for form in FORMS]
    W_o = ev.W_o
    squeezing, moving = (
        np.concatenate(list(part.values())) for part in (parts.squeezing, parts.moving)
    )
    tol = 100 * EPS * np.linalg.cond(W_o) * np.max(np.abs(FORCES))
    np.testing.assert_allclose(W_o @ squeezing, 0.0, atol=tol)
    for internal in forms:
        np.testing.assert_allclose(internal.basis.T @ moving, 0.0, atol=10 * tol)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_forces_between_arms_are_determined_although_they_squeeze(block_system, solver):
    """Seven contacts, six equations of the object: the arms' motion tells the rest."""
    ev = ma.evaluate(block_system.with_solver(solver))
    assert all(unique.all() for unique in ev.contact_forces_unique.values())
    assert ev.force_decomposition().coordinates.shape == (1,)


def test_forces_that_no_motion_tells_are_marked_and_still_split():
    """A fingertip written twice: how the two share their force is open, what they do is not."""
    scene = two_arm_block(run={"solver": "dense"})
    joints = [joint.model_dump(exclude_unset=True) for joint in scene.joints]
    joints[0]["contacts"] = [*joints[0]["contacts"], joints[0]["contacts"][0]]
    ev = ma.evaluate(ma.compile_system(scene.replace(joints=joints)))
    assert ev.contact_forces_unique["one"].tolist() == [False, True, True, True, False]
    assert ev.contact_forces_unique["two"].all()
    internal, parts = ev.internal_forces(), ev.force_decomposition()
    assert internal.count == 2
    forces = np.concatenate(list(ev.contact_forces.values()))
    assert forces[0] == pytest.approx(forces[4], abs=1e-8)
    np.testing.assert_allclose(
        np.concatenate(list(parts.moving.values())),
        np.linalg.pinv(ev.W_o) @ ev.W_o @ forces,
        atol=1e-8,
    )
