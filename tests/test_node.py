"""Claims about the two solvers of the constrained system, on matrices alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanics import EPS, WORKED

from multiarm.node.dense import solve_dense
from multiarm.node.regular import DEFICIENT, ELIMINATED, NO_INERTIA, eliminate, make_work, solve
from multiarm.node.singular import couple, make_coupled, solve_coupled

seeds = st.integers(0, 2**32 - 1)
shapes = st.lists(
    st.integers(1, 16).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, min(n, 6)))),
    min_size=1,
    max_size=5,
)


def solve_by_node(system):
    """The node algorithm on the same data as :func:`multiarm.node.dense.solve_dense`."""
    dofs, rows = [m.shape[0] for m in system.M], [w.shape[1] for w in system.W]
    work = make_work(dofs, rows)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.L[i, : dofs[i], : dofs[i]] = M
        work.Y[i, : dofs[i], : rows[i]] = W
    Wo = np.ascontiguousarray(np.hstack(system.W_o).T)
    failed = eliminate(work, Wo, system.M_o)
    q_o, q, force = np.zeros(6), np.zeros(sum(dofs)), np.zeros(sum(rows))
    h, c = np.concatenate(system.h), np.concatenate(system.c)
    if failed == ELIMINATED:
        solve(work, system.h_o, h, c, q_o, q, force)
    elif failed == DEFICIENT:
        coupled = make_coupled(dofs, rows)
        assert couple(work, coupled, Wo, system.M_o) > 0.0
        solve_coupled(work, coupled, system.h_o, h, c, q_o, q, force)
    return SimpleNamespace(failed=failed, pivot=work.pivot, x=np.concatenate([q_o, q]), force=force)


def by_dense(system, **reactions):
    s = solve_dense(**vars(system), **reactions)
    return SimpleNamespace(
        x=np.concatenate([s.object_acceleration, *s.joint_accelerations]),
        force=np.concatenate(s.contact_forces),
        unique=np.concatenate(s.unique),
        rank=s.rank,
    )


def spd(rng, n, scale):
    """A random inertia: eigenvalues over two decades."""
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = scale * (Q * 10.0 ** rng.uniform(-1, 1, n)) @ Q.T
    return (M + M.T) / 2


def random_system(rng, shapes, ratio=1.0):
    """Arms of the given (joints, contacts); the object is ``ratio`` times as heavy as an arm."""
    normal = rng.standard_normal
    return SimpleNamespace(
        M_o=spd(rng, 6, ratio),
        h_o=normal(6),
        M=[spd(rng, n, 1.0) for n, _ in shapes],
        h=[normal(n) for n, _ in shapes],
        W_o=[normal((6, m)) for _, m in shapes],
        W=[normal((n, m)) for n, m in shapes],
        c=[normal(m) for _, m in shapes],
    )


def stacked(system):
    """Inertia, right-hand side and constraints of the whole system."""
    from scipy.linalg import block_diag

    M, W = block_diag(system.M_o, *system.M), block_diag(*system.W)
    return (
        M,
        np.concatenate([system.h_o, *system.h]),
        np.vstack([np.hstack(system.W_o), W]),
        np.concatenate(system.c),
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


@settings(max_examples=60)
@given(seeds, shapes, st.sampled_from([1e-3, 1.0, 1e3]))
def test_node_algorithm_equals_the_dense_solution(seed, shapes, ratio):
    system = random_system(np.random.default_rng(seed), shapes, ratio)
    node = solve_by_node(system)
    dense = by_dense(system)
    tol = 100 * EPS * condition(system)
    scale_x, scale_f = np.max(np.abs(dense.x)), np.max(np.abs(dense.force))
    np.testing.assert_allclose(node.x, dense.x, atol=tol * scale_x)
    np.testing.assert_allclose(node.force, dense.force, atol=tol * scale_f)


@settings(max_examples=60)
@given(seeds, shapes)
def test_node_solution_satisfies_all_three_equations(seed, shapes):
    """Well conditioned arms: what is put back leaves only rounding."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, shapes)
    for W in system.W:  # orthonormal constraint directions keep every K within the inertia's range
        W[:] = np.linalg.qr(W)[0]
    M, h, W, c = stacked(system)
    node = solve_by_node(system)
    assert node.failed == -1
    scale = max(np.max(np.abs(node.force)), np.max(np.abs(node.x)), 1.0)
    np.testing.assert_allclose(M @ node.x - W @ node.force, h, atol=1e-11 * scale)
    np.testing.assert_allclose(W.T @ node.x, c, atol=1e-11 * scale)


def worked_system(name):
    data = WORKED[name]["inputs"]
    array = lambda key: [np.array(arm[key]) for arm in data["arms"]]  # noqa: E731
    system = SimpleNamespace(
        M_o=np.array(data["Mo"]), h_o=np.array(data["ho"]), M=array("M"), h=array("h"),
        W_o=array("Wo"), W=array("W"), c=array("c"),
    )  # fmt: skip
    return system, {"reaction_o": array("Wot"), "reaction": array("Wt")}, WORKED[name]["expected"]


@pytest.mark.parametrize("name", ["node_solver_friction", "node_solver_singular_arm"])
def test_dense_solver_gives_the_worked_example(name):
    """Friction makes the reactions differ from the constraints; mu = -lambda."""
    system, reactions, expected = worked_system(name)
    dense = by_dense(system, **reactions)
    np.testing.assert_allclose(dense.x, expected["qo"] + expected["q"], atol=1e-9)
    np.testing.assert_allclose(-dense.force, expected["mu"], atol=1e-9)
    assert dense.unique.all()


def test_node_algorithm_gives_the_worked_example_without_friction():
    """The arms of the friction example with reactions along the constraints."""
    system, _, _ = worked_system("node_solver_friction")
    node, dense = solve_by_node(system), by_dense(system)
    np.testing.assert_allclose(node.x, dense.x, atol=1e-13)
    np.testing.assert_allclose(node.force, dense.force, atol=1e-13)


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
        work.L[i, : len(M), : len(M)], work.Y[i, : len(W), : W.shape[1]] = M, W
    Wo = np.ascontiguousarray(np.hstack(system.W_o).T)
    failed = eliminate(work, Wo, system.M_o)
    if which == "M":
        assert failed == 1 and work.pivot[1] == NO_INERTIA
    else:
        assert failed == DEFICIENT
        assert not couple(work, coupled, Wo, system.M_o) > 0.0


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
    """Gauss: among all accelerations that satisfy W^T q = c the true one is nearest to M^-1 h."""
    rng = np.random.default_rng(8)
    system = random_system(rng, [(7, 4), (3, 1), (6, 6)])
    M, h, W, c = stacked(system)
    x = solve_by_node(system).x
    free = np.linalg.solve(M, h)
    gauss = lambda a: (a - free) @ M @ (a - free)  # noqa: E731
    _, _, vt = np.linalg.svd(W.T)
    for allowed in vt[c.size :]:
        np.testing.assert_allclose(W.T @ (x + allowed), c, atol=1e-11)
        assert gauss(x + 1e-3 * allowed) > gauss(x) and gauss(x - 1e-3 * allowed) > gauss(x)
