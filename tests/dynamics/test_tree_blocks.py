"""Claims about blocks whose joints are trees that divide: they are solved as all others are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrix_systems import seeds, spd
from random_structures import random_parents
from scipy.linalg import block_diag
from tree_scenes import DOWN, humanoid_scene, satellite_scene

import multiarm as ma
from multiarm.dynamics.solver.batched import largest_free_rate, solve_batched
from multiarm.dynamics.solver.bounds import COUPLED_BELOW
from multiarm.dynamics.solver.node import make_work
from multiarm.dynamics.solver.tree_tables import FEWEST_JOINTS, pays_as_tree, ways_of
from multiarm.dynamics.status import DEFICIENT, OK
from multiarm.scene import parse_scene

AGREEMENT = 1e-9  # of systems whose condition is below 1e6


def tree_system(rng, trees, small=(), node=6):
    """Blocks with ``(parents, contacts)`` among small ones with ``(joints, contacts)``.

    A contact touches the joints on one way, or on two.
    """
    M, W, parents = [], [], {}
    for before, contacts in trees:
        ways, n = ways_of(np.array(before)), len(before)
        parents[len(M)] = np.array(before)
        inertia, rows = np.diag(rng.uniform(0.1, 1.0, n)), np.zeros((n, contacts))
        for way in ways:
            J = np.zeros((6, n))
            J[:, way] = rng.standard_normal((6, len(way)))
            inertia += J.T @ spd(rng, 6, 0.3) @ J
        for k in range(contacts):
            ends = rng.integers(n // 2, n, rng.integers(1, 3))
            on = sorted({joint for end in ends for joint in ways[end]})
            rows[on, k] = rng.standard_normal(len(on))
        M.append(inertia)
        W.append(rows)
    for joints, contacts in small:
        M.append(spd(rng, joints, 1.0))
        W.append(rng.standard_normal((joints, contacts)))
    return SimpleNamespace(
        M_o=spd(rng, node, 1.0),
        f_o=rng.standard_normal(node),
        M=M,
        W=W,
        W_o=rng.standard_normal((node, sum(w.shape[1] for w in W))),
        f_j=rng.standard_normal(sum(map(len, M))),
        c=rng.standard_normal(sum(w.shape[1] for w in W)),
        parents=parents,
    )


def loaded(system):
    dofs, rows = [len(M) for M in system.M], [W.shape[1] for W in system.W]
    work = make_work(dofs, rows, node=system.M_o.shape[0], parents=system.parents)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : dofs[i], : dofs[i]], work.W[i, : dofs[i], : rows[i]] = np.tril(M), W
    return work


def solve_in(work, system):
    """Status, unknowns of the objects and the joints, and contact forces."""
    node = system.M_o.shape[0]
    a_o, q, force = np.zeros(node), np.zeros(system.f_j.size), np.zeros(system.c.size)
    W_o = np.ascontiguousarray(system.W_o.T)
    status = solve_batched(
        work, W_o, system.M_o, system.f_o, system.f_j, system.c, a_o, q, force, node
    )
    return status, np.concatenate([a_o, q]), force


def solve_at_once(system):
    """The same by all equations at once."""
    M, W = block_diag(system.M_o, *system.M), np.vstack([system.W_o, block_diag(*system.W)])
    m = W.shape[1]
    kkt = np.block([[M, -W], [W.T, np.zeros((m, m))]])
    x = np.linalg.solve(kkt, np.concatenate([system.f_o, system.f_j, system.c]))
    return x[: len(M)], x[len(M) :], np.linalg.cond(kkt)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, count=st.integers(1, 3), small=st.integers(0, 5), node=st.sampled_from([6, 12]))
def test_trees_among_small_blocks_are_solved_as_all_equations_at_once(seed, count, small, node):
    """Also twice in the same arrays: nothing of the first solution is left in the second."""
    rng = np.random.default_rng(seed)
    trees = []
    for _ in range(count):
        joints = int(rng.integers(2, 30))
        trees.append((random_parents(rng, joints, rng.choice([0.1, 0.3, 0.6])), 0))
        trees[-1] = trees[-1][0], int(rng.integers(0, 1 + joints // 2))
    sizes = [(joints, int(rng.integers(0, joints + 1))) for joints in rng.integers(1, 8, small)]
    system = tree_system(rng, trees, sizes, node)
    work = loaded(system)
    expected, forces, condition = solve_at_once(system)
    if not condition < 1e6:
        return
    for _ in range(2):
        status, x, force = solve_in(work, system)
        if status == DEFICIENT:
            assert work.pivot.min() < 1e3 * COUPLED_BELOW  # of a block, or of the node
            return
        scale = max(np.abs(expected).max(), np.abs(forces).max(initial=0.0))
        np.testing.assert_allclose(x, expected, atol=AGREEMENT * scale)
        np.testing.assert_allclose(force, forces, atol=AGREEMENT * scale)
        solve_in(work, tree_system_with(system, np.random.default_rng(seed + 1)))


def tree_system_with(system, rng):
    """The system with other right-hand sides."""
    other = SimpleNamespace(**vars(system))
    other.f_j, other.c = rng.standard_normal(system.f_j.size), rng.standard_normal(system.c.size)
    return other


BRANCHED = [-1, *range(5), 5, 6, 7, 5, 9, 10, 5, 12, 13, 14]


def test_the_largest_free_rate_is_that_of_contacts_without_forces(rng):
    system = tree_system(rng, [(BRANCHED, 5), (BRANCHED, 3)])
    work = loaded(system)
    assert solve_in(work, system)[0] == OK
    M, W = block_diag(*system.M), block_diag(*system.W)
    expected = np.abs(W.T @ np.linalg.solve(M, system.f_j)).max()
    assert largest_free_rate(work) == pytest.approx(expected, rel=1e-10)


def test_dependent_contacts_of_a_tree_are_found(rng):
    """A contact that is there twice, and one on joints that it cannot move."""
    for spoil in ("twice", "immobile"):
        system = tree_system(rng, [(BRANCHED, 4)], [(3, 1)])
        assert solve_in(loaded(system), system)[0] == OK
        system.W[0][:, 3] = system.W[0][:, 2] if spoil == "twice" else 0.0
        work = loaded(system)
        assert solve_in(work, system)[0] == DEFICIENT
        assert not work.pivot[0] > COUPLED_BELOW


def test_an_inertia_that_is_not_positive_is_found(rng):
    system = tree_system(rng, [(BRANCHED, 4)], [(3, 1)])
    for number in (-1.0, np.nan):
        system.M[0][11, 11] = number
        work = loaded(system)
        assert solve_in(work, system)[0] == DEFICIENT and work.pivot[0] == 0.0


def test_more_contacts_than_joints_are_left_to_the_coupled_system(rng):
    system = tree_system(rng, [(BRANCHED, len(BRANCHED) + 1)], [(3, 1)])
    assert solve_in(loaded(system), system)[0] == DEFICIENT


def test_which_blocks_are_trees():
    """Large ones that divide, whose joints are numbered branch by branch."""
    assert pays_as_tree(np.array(BRANCHED))
    assert not pays_as_tree(np.arange(-1, 2 * FEWEST_JOINTS))
    assert not pays_as_tree(np.array([-1, 0, 0]))
    mixed = [-1, 0, 0, *range(1, 2 * FEWEST_JOINTS)]  # the numbers of two branches alternate
    assert not pays_as_tree(np.array(mixed))


def test_a_humanoid_is_a_tree_and_an_arm_that_floats_is_none():
    humanoid = ma.compile_system(parse_scene(humanoid_scene())).model
    assert list(humanoid.trees) == [0] and humanoid.trees[0].size == 35
    assert not ma.compile_system(parse_scene(satellite_scene(DOWN))).model.trees
