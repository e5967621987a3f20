"""Claims about the two solvers of the constrained system, on matrices alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrix_systems import random_system, seeds, solve_by_node, stacked, worked_system
from mechanics import EPS

from multiarm.dynamics.solver.batched import largest_free_rate, solve_batched
from multiarm.dynamics.solver.bounds import COUPLED_BELOW
from multiarm.dynamics.solver.dense import null_space, solve_dense
from multiarm.dynamics.solver.node import eliminate_blocks, make_work
from multiarm.dynamics.solver.singular import couple, make_coupled
from multiarm.dynamics.status import BLOCK_INERTIA, BLOCK_NOT_FINITE, DEFICIENT, OK

shapes = st.lists(
    st.integers(1, 16).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, min(n, 6)))),
    min_size=1,
    max_size=9,
)


def by_dense(system, **reactions):
    s = solve_dense(**vars(system), **reactions)
    return SimpleNamespace(
        x=np.concatenate([s.object_acceleration, *s.joint_accelerations]),
        force=np.concatenate(s.contact_forces),
        unique=np.concatenate(s.unique),
        rank=s.rank,
    )


def condition(system):
    """How much rounding can grow on the ways of the two solvers (inertia-scaled).

    The node algorithm squares the condition of each arm's constraint directions, and passes through
    the object's node matrix, which is large where an arm is stiff against the object.
    """
    M, _, W, _ = stacked(system)
    L, L_o = np.linalg.cholesky(M), np.linalg.cholesky(system.M_o)
    node, worst = np.eye(6), 1.0
    for inertia, rows, W_o in zip(system.M, system.W, system.W_o, strict=True):
        Y = np.linalg.solve(np.linalg.cholesky(inertia), rows)
        Z = np.linalg.solve(L_o, W_o)
        node += Z @ np.linalg.solve(Y.T @ Y, Z.T)
        worst = max(worst, np.linalg.cond(Y) ** 2)
    return worst * np.linalg.cond(node) * np.linalg.cond(L) * np.linalg.cond(np.linalg.solve(L, W))


@pytest.mark.slow
@settings(max_examples=30)
@given(seeds, shapes, st.sampled_from([1e-3, 1.0, 1e3]))
def test_node_algorithm_equals_the_dense_solution(seed, shapes, ratio):
    system = random_system(np.random.default_rng(seed), shapes, ratio)
    node = solve_by_node(system)
    dense = by_dense(system)
    tol = 100 * EPS * condition(system)
    scale_x, scale_f = np.max(np.abs(dense.x)), np.max(np.abs(dense.force))
    np.testing.assert_allclose(node.x, dense.x, atol=tol * scale_x)
    np.testing.assert_allclose(node.force, dense.force, atol=tol * scale_f)


@pytest.mark.slow
@settings(max_examples=30)
@given(seeds, shapes)
def test_node_solution_satisfies_all_three_equations(seed, shapes):
    """Well conditioned arms: what is put back leaves only rounding."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, shapes)
    for W in system.W:  # orthonormal constraint directions keep every K within the inertia's range
        W[:] = np.linalg.qr(W)[0]
    M, f_j, W, c = stacked(system)
    node = solve_by_node(system)
    assert node.failed == OK
    scale = max(np.max(np.abs(node.force)), np.max(np.abs(node.x)), 1.0)
    np.testing.assert_allclose(M @ node.x - W @ node.force, f_j, atol=1e-11 * scale)
    np.testing.assert_allclose(W.T @ node.x, c, atol=1e-11 * scale)


@pytest.mark.parametrize("name", ["node_solver_friction", "node_solver_singular_arm"])
def test_dense_solver_gives_the_worked_example(name):
    """Friction makes the reactions differ from the constraints; mu = -lambda."""
    system, reactions, expected = worked_system(name)
    dense = by_dense(system, **reactions)
    np.testing.assert_allclose(dense.x, expected["qo"] + expected["q"], atol=1e-9)
    np.testing.assert_allclose(-dense.force, expected["mu"], atol=1e-9)
    assert dense.unique.all()


@pytest.mark.parametrize("matrix", [np.zeros((3, 2)), np.zeros((3, 0)), np.zeros((0, 2))])
def test_a_matrix_without_rank_has_the_whole_space_for_null_space(matrix):
    space, size = null_space(matrix), matrix.shape[1]
    assert space.rank == 0 and space.basis.shape == (size, size)
    np.testing.assert_allclose(space.basis.T @ space.basis, np.eye(size))


def test_node_algorithm_gives_the_worked_example_without_friction():
    """The arms of the friction example with reactions along the constraints."""
    system, _, _ = worked_system("node_solver_friction")
    node, dense = solve_by_node(system), by_dense(system)
    np.testing.assert_allclose(node.x, dense.x, atol=1e-13)
    np.testing.assert_allclose(node.force, dense.force, atol=1e-13)


@pytest.mark.slow
def test_an_arm_that_cannot_follow_its_constraints_is_left_to_the_coupled_system():
    system, _, _ = worked_system("node_solver_singular_arm")
    node = solve_by_node(system)
    assert node.failed == DEFICIENT
    assert not node.pivot[0] > 1e-13


def test_dependent_rows_are_left_to_the_coupled_system():
    rng = np.random.default_rng(5)
    system = random_system(rng, [(6, 6), (3, 2), (6, 3)])
    system.W[1] = rng.standard_normal((3, 1)) @ rng.standard_normal((1, 2))
    node = solve_by_node(system)
    assert node.failed == DEFICIENT
    assert not node.pivot[1] > 1e-13 and min(node.pivot[0], node.pivot[2]) > 1e-5


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", ["M", "W", "M_o"])
def test_numbers_that_are_not_finite_never_count_as_solved(which, value):
    system = random_system(np.random.default_rng(6), [(4, 3), (5, 2)])
    matrix = system.M_o if which == "M_o" else getattr(system, which)[1]
    matrix[0, 0] = value
    work, coupled = make_work([4, 5], [3, 2]), make_coupled([4, 5], [3, 2])
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : len(M), : len(M)], work.W[i, : len(W), : W.shape[1]] = M, W
    W_o = np.ascontiguousarray(np.hstack(system.W_o).T)
    right = system.f_o, np.concatenate(system.f_j), np.concatenate(system.c)
    found = np.zeros(6), np.zeros(9), np.zeros(5)
    assert solve_batched(work, W_o, system.M_o, *right, *found) == DEFICIENT
    if which == "M":
        assert eliminate_blocks(work, W_o) == (BLOCK_NOT_FINITE, 1) and work.pivot[1] == 0.0
    else:
        assert eliminate_blocks(work, W_o) == (OK, 0)
        assert not couple(work, coupled, W_o, system.M_o, False) > 0.0


@pytest.mark.parametrize("lever", [1.0, 3.0, -0.2])
def test_forces_between_redundant_contacts_are_of_least_norm_and_marked(lever):
    """A contact repeated with another lever changes no motion: f_1 + lever f_2 = f, |f_i| least."""
    rng = np.random.default_rng(7)
    once = random_system(rng, [(6, 3), (5, 2)])
    twice = SimpleNamespace(**vars(once))
    for key in ("W_o", "W", "c"):
        first, second = getattr(once, key)
        setattr(twice, key, [np.append(first, lever * first[..., :1], axis=-1), second])
    expected, found = by_dense(once), by_dense(twice)
    assert found.rank == 5
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-10, atol=1e-12)
    shared = np.insert(expected.force, 3, 0.0)
    shared[[0, 3]] = expected.force[0] * np.array([1.0, lever]) / (1.0 + lever**2)
    np.testing.assert_allclose(found.force, shared, rtol=1e-9, atol=1e-11)
    assert found.unique.tolist() == [False, True, True, False, True, True]


def test_accelerations_minimise_gausss_constraint_function():
    """Gauss: among all accelerations that satisfy W^T q = c the true one is nearest to M^-1 f_j."""
    rng = np.random.default_rng(8)
    system = random_system(rng, [(7, 4), (3, 1), (6, 6)])
    M, f_j, W, c = stacked(system)
    x = solve_by_node(system).x
    free = np.linalg.solve(M, f_j)
    gauss = lambda a: (a - free) @ M @ (a - free)  # noqa: E731
    _, _, vt = np.linalg.svd(W.T)
    for allowed in vt[c.size :]:
        np.testing.assert_allclose(W.T @ (x + allowed), c, atol=1e-11)
        assert gauss(x + 1e-3 * allowed) > gauss(x) and gauss(x - 1e-3 * allowed) > gauss(x)


# --- four arms side by side ----------------------------------------------------------------------


def loaded(system):
    """Arrays of the node algorithm with the inertias and constraints of a system."""
    dofs, rows = [m.shape[0] for m in system.M], [w.shape[1] for w in system.W]
    work = make_work(dofs, rows)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : dofs[i], : dofs[i]], work.W[i, : dofs[i], : rows[i]] = M, W
    return work


def solve_in(work, system):
    """Status, and the arms' unknowns and forces, arm by arm."""
    a_o, q, force = np.zeros(6), np.zeros(work.first_joint[-1]), np.zeros(work.first_contact[-1])
    right = system.f_o, np.concatenate(system.f_j), np.concatenate(system.c)
    W_o = np.ascontiguousarray(np.hstack(system.W_o).T)
    status = solve_batched(work, W_o, system.M_o, *right, a_o, q, force)
    arms = zip(
        np.split(q, work.first_joint[1:-1]), np.split(force, work.first_contact[1:-1]), strict=True
    )
    return status, [np.concatenate(arm) for arm in arms]


def taken(system, order):
    """The system with the arms of these numbers."""
    arms = {
        name: [value[i] for i in order] if isinstance(value, list) else value
        for name, value in vars(system).items()
    }
    return SimpleNamespace(**arms)


def on_a_rock(system):
    """The system with an object that nothing moves."""
    system.M_o, system.f_o = 1e300 * np.eye(6), np.zeros(6)
    return system


SIZES = [(6, 6), (3, 1), (16, 5), (6, 3), (2, 2), (7, 6), (9, 0), (6, 6), (1, 1)]


def test_what_an_arm_does_depends_on_no_neighbour(rng):
    """To the last bit: alone, and beside arms of other sizes which it has to be filled up for."""
    system = on_a_rock(random_system(rng, SIZES))
    work = loaded(system)
    status, together = solve_in(work, system)
    assert status == OK
    for i in range(len(SIZES)):
        own = taken(system, [i])
        alone = loaded(own)
        np.testing.assert_array_equal(solve_in(alone, own)[1][0], together[i])
        assert alone.pivot[0] == work.pivot[i]


def test_the_place_of_an_arm_among_four_does_not_matter(rng):
    system = on_a_rock(random_system(rng, [(6, 5)] * 7))
    _, expected = solve_in(loaded(system), system)
    for shift in range(1, 7):
        order = np.roll(np.arange(7), shift)
        other = taken(system, order)
        for i, found in zip(order, solve_in(loaded(other), other)[1], strict=True):
            np.testing.assert_array_equal(found, expected[i])


@pytest.mark.parametrize("count", range(1, 10))
def test_every_number_of_arms_is_solved(rng, count):
    system = random_system(rng, SIZES[:count])
    node, dense = solve_by_node(system), by_dense(system)
    tol = 100 * EPS * condition(taken(system, [i for i in range(count) if SIZES[i][1]]))
    np.testing.assert_allclose(node.x, dense.x, atol=tol * np.max(np.abs(dense.x)))
    np.testing.assert_allclose(node.force, dense.force, atol=tol * np.max(np.abs(dense.force)))


def test_inertias_and_constraints_stay_as_they_are(rng):
    system = random_system(rng, SIZES)
    work, other = loaded(system), loaded(system)
    solve_in(work, system)
    np.testing.assert_array_equal(work.M, other.M)
    np.testing.assert_array_equal(work.W, other.W)


def test_a_system_is_solved_to_the_same_bits_after_one_that_was_none(rng):
    system = random_system(rng, SIZES)
    work = loaded(system)
    _, expected = solve_in(work, system)
    spoiled = taken(system, range(len(SIZES)))
    spoiled.c = [np.full_like(c, np.nan) for c in system.c]
    solve_in(work, spoiled)
    work.W[:] = np.nan
    assert solve_in(work, system)[0] == DEFICIENT
    work.W[:] = loaded(system).W
    for found, arm in zip(solve_in(work, system)[1], expected, strict=True):
        np.testing.assert_array_equal(found, arm)


@pytest.mark.parametrize("which", [0, 2, 4, 7])
def test_a_deficient_arm_among_regular_ones_is_found(rng, which):
    system = random_system(rng, [(6, 4)] * 8)
    system.W[which][:, 3] = system.W[which][:, 0] - 2.0 * system.W[which][:, 1]
    work = loaded(system)
    assert solve_in(work, system)[0] == DEFICIENT
    assert np.flatnonzero(~(work.pivot[:-1] > 1e-12)).tolist() == [which]
    node, dense = solve_by_node(system), by_dense(system)
    np.testing.assert_allclose(node.x, dense.x, atol=1e-9 * np.max(np.abs(dense.x)))


@pytest.mark.parametrize("which", [0, 3, 4, 8])
@pytest.mark.parametrize(
    "inertia, failure",
    [
        (0.0, BLOCK_INERTIA),
        (-1.0, BLOCK_INERTIA),
        (np.nan, BLOCK_NOT_FINITE),
        (np.inf, BLOCK_NOT_FINITE),
    ],
)
def test_an_arm_without_inertia_is_named(rng, which, inertia, failure):
    system = random_system(rng, SIZES)
    system.M[which][-1, -1] = inertia
    node_work = loaded(system)
    assert solve_in(node_work, system)[0] == DEFICIENT
    W_o = np.ascontiguousarray(np.hstack(system.W_o).T)
    assert eliminate_blocks(node_work, W_o) == (failure, which)
    assert node_work.pivot[which] == 0.0


def test_numbers_too_large_to_be_squared_are_no_pivots(rng):
    system = random_system(rng, [(6, 3), (6, 3)])
    system.W[1][:, 0] *= 1e200
    work = loaded(system)
    assert solve_in(work, system)[0] == DEFICIENT
    assert work.pivot[0] > COUPLED_BELOW and work.pivot[1] == 0.0


def test_pivots_are_those_of_the_scaled_cholesky_factor(rng):
    """The square of the least diagonal entry of the factor of K, scaled to a diagonal of ones."""
    system = random_system(rng, SIZES)
    work = loaded(system)
    solve_in(work, system)
    for M, W, pivot in zip(system.M, system.W, work.pivot, strict=False):
        K = W.T @ np.linalg.solve(M, W)
        scale = 1.0 / np.sqrt(np.diag(K))
        factor = np.linalg.cholesky(scale[:, None] * K * scale)
        expected = np.min(np.diag(factor) ** 2, initial=1.0)
        np.testing.assert_allclose(pivot, expected, rtol=1e-9)


def test_an_arm_that_holds_nothing_moves_freely_and_weighs_nothing(rng):
    system = random_system(rng, [(6, 3), (9, 0), (6, 5)])
    without = taken(system, [0, 2])
    found, expected = solve_by_node(system), solve_by_node(without)
    np.testing.assert_allclose(found.x[:6], expected.x[:6], rtol=1e-12)
    np.testing.assert_allclose(
        found.x[12:21], np.linalg.solve(system.M[1], system.f_j[1]), rtol=1e-9, atol=1e-12
    )


def test_the_largest_free_rate_is_that_of_the_contacts_without_forces(rng):
    system = random_system(rng, SIZES)
    work = loaded(system)
    solve_in(work, system)
    rates = [
        W.T @ np.linalg.solve(M, f_j)
        for M, W, f_j in zip(system.M, system.W, system.f_j, strict=True)
    ]
    expected = max(np.max(np.abs(rate), initial=0.0) for rate in rates)
    np.testing.assert_allclose(largest_free_rate(work), expected, rtol=1e-10)
