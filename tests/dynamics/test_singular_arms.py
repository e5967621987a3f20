"""Claims about arms that cannot move along all of their constraints, in the linear node algorithm.

Oracle: the solution of least norm in decimal arithmetic of 60 digits, by Gaussian elimination and
the null space of ``W^T M^-1 W``.  It knows neither singular values nor a tolerance near the
solver's, and is exact where the solver has 16 digits.
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from matrix_systems import (
    exactly,
    random_system,
    seeds,
    solve_exactly,
    stacked,
    system_matrices,
    worked_system,
)
from mechanics import (
    EPS,
    UR5_POSTURE,
    UR5_WRIST_SINGULAR,
    chain_urdf,
    planar_pair,
    scene_of,
    single_arm,
    two_arm_block_twice,
    ur5_pair,
)
from mechanics import stacked as of_evaluation
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.bounds import COUPLED_BELOW
from multiarm.dynamics.solver.node import eliminate_blocks, make_work
from multiarm.dynamics.solver.singular import (
    couple,
    make_coupled,
    solve_coupled,
    undetermined_parts,
)
from multiarm.dynamics.status import BLOCK_INERTIA, DEFICIENT, OK
from multiarm.problems import HARD_CASES
from multiarm.problems.postures import STRETCHED

DIGITS = 60
# Elimination loses five of sixteen digits at the most (a pivot of 1e-5); inertias of a condition of
# a hundred and sums of some tens of terms take one more as a rule, and a second one in a thousand
# systems, which is why the systems of these tests are the same in every run.
ACCELERATION = 1e-10
# Forces are accelerations over mobilities, which are squares of what the arms move.
FORCE = 1e-8
# Fewer joints than rows, as many, more.
shapes = st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=3)


# --- the solver on matrices ----------------------------------------------------------------------


def eliminated(system):
    """The work of the elimination, room for the coupled system, status, and the solution."""
    dofs, rows = [m.shape[0] for m in system.M], [w.shape[1] for w in system.W]
    lever = getattr(system, "lever", 1.0)
    work = make_work(dofs, rows, [np.full(d, lever) for d in dofs])
    coupled = make_coupled(dofs, rows)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : dofs[i], : dofs[i]] = M
        work.W[i, : dofs[i], : rows[i]] = W
    f_j, c = np.concatenate(system.f_j), np.concatenate(system.c)
    found = np.zeros(6), np.zeros(f_j.size), np.zeros(c.size)
    status = solve_batched(work, object_rows(system), system.M_o, system.f_o, f_j, c, *found)
    if status == DEFICIENT:
        failure, _ = eliminate_blocks(work, object_rows(system))
        status = DEFICIENT if failure == OK else failure
    return work, coupled, status, found


def object_rows(system):
    return np.ascontiguousarray(np.hstack(system.W_o).T)


def solved(system, force_coupling=()):
    """Solution as the time loop finds it; ``solvable`` is what the kernels say of it.

    The arms ``force_coupling`` are declared deficient whatever their pivots are.
    """
    work, coupled, status, (a_o, q, force) = eliminated(system)
    f_j, c = np.concatenate(system.f_j), np.concatenate(system.c)
    rank, solvable = c.size, status == OK
    if force_coupling:
        eliminate_blocks(work, object_rows(system))
        work.pivot[list(force_coupling)] = 0.0
    if status == DEFICIENT or force_coupling:
        solvable = couple(work, coupled, object_rows(system), system.M_o, False) > 0.0
        rank += int(coupled.status.rank - coupled.status.unknowns)
        if solvable:
            solve_coupled(work, coupled, system.f_o, f_j, c, a_o, q, force)
    x = np.concatenate([a_o, q])
    return SimpleNamespace(
        x=x, force=force, rank=rank, solvable=solvable, work=work, coupled=coupled
    )


# --- the oracle ----------------------------------------------------------------------------------


def independent_columns(F):
    """Largest set of independent columns of a positive semidefinite F (pivoted Cholesky)."""
    F, order, left = F.copy(), [], list(range(len(F)))
    floor = Decimal("1e-35") * max(F[k, k] for k in left)
    while left:
        best = max(left, key=lambda k: F[k, k])
        if not F[best, best] > floor:
            break
        left.remove(best)
        order.append(best)
        F -= np.outer(F[:, best], F[best]) / F[best, best]
    return order, left


def least_norm(M, f_j, W, c):
    """Accelerations, contact forces of least norm, and rank, with consistent constraints."""
    with localcontext() as context:
        context.prec = DIGITS
        M, f_j, W, c = (exactly(a) for a in (M, f_j, W, c))
        mobility = solve_exactly(M, np.column_stack([W, f_j]))
        free = mobility[:, -1]
        F, d = W.T @ mobility[:, :-1], c - W.T @ free
        kept, others = independent_columns(F)
        force = np.array([Decimal(0)] * len(c), dtype=object)
        block = F[np.ix_(kept, kept)]
        force[kept] = solve_exactly(block, d[kept][:, None])[:, 0]
        if others:
            null = np.array([[Decimal(0)] * len(others)] * len(c), dtype=object)
            null[kept] = -solve_exactly(block, F[np.ix_(kept, others)])
            null[others, range(len(others))] = Decimal(1)
            part = solve_exactly(null.T @ null, (null.T @ force)[:, None])[:, 0]
            force = force - null @ part
        x = free + mobility[:, :-1] @ force
    return SimpleNamespace(x=x.astype(float), force=force.astype(float), rank=len(kept))


def make_consistent(system, rng):
    """Give the constraints a right-hand side that some acceleration serves."""
    for W, W_o, c in zip(system.W, system.W_o, system.c, strict=True):
        c[:] = W.T @ rng.standard_normal(len(W))
        c += W_o.T @ np.linspace(-1.0, 1.0, 6)


def singular_values(system):
    """Those of the whole W, rows and columns scaled to be comparable as the solver's are."""
    blocks = [W / np.max(np.linalg.norm(W, axis=0)) for W in system.W]
    return np.linalg.svd(np.vstack([np.hstack(system.W_o), block_diag(*blocks)]))[1]


def clear_rank(system):
    """Nothing is nearly dependent: a rank has to be decided somewhere, the solver's is at 1e-6."""
    values = singular_values(system)
    return not np.any((values > 1e-12 * values[0]) & (values < 1e-5 * values[0]))


def deficient_system(seed, shapes, ratio):
    """Random arms, some with a repeated contact, some with a joint that hardly moves them."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, shapes, ratio)
    for W, W_o in zip(system.W, system.W_o, strict=True):
        if rng.random() < 0.4 and W.shape[1] > 1:
            W[:, -1], W_o[:, -1] = -2.0 * W[:, 0], -2.0 * W_o[:, 0]
        if rng.random() < 0.5 and len(W) > 1:
            W[0] *= 10.0 ** rng.uniform(-4.0, 0.0)
    make_consistent(system, rng)
    return system, rng


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.slow
@settings(max_examples=40, derandomize=True)
@given(seeds, shapes, st.floats(-3.0, 3.0))
def test_motion_and_forces_are_those_of_least_norm(seed, shapes, power):
    system, _ = deficient_system(seed, shapes, 10.0**power)
    assume(clear_rank(system))
    exact, node = least_norm(*stacked(system)), solved(system)
    assert node.solvable
    assert node.rank == exact.rank
    assert relative(node.x, exact.x) < ACCELERATION
    assert relative(node.force, exact.force) < FORCE


@settings(max_examples=40, derandomize=True)
@given(seeds, shapes, st.floats(-6.0, 6.0))
def test_objects_a_million_times_lighter_or_heavier_cost_digits_not_the_rank(seed, shapes, power):
    """The elimination takes what moves by a thousandth of what the object does, which costs six
    digits in the node matrix; the condition of the whole W costs its own."""
    system, _ = deficient_system(seed, shapes, 10.0**power)
    assume(clear_rank(system))
    M, f_j, W, c = stacked(system)
    exact, node = least_norm(M, f_j, W, c), solved(system)
    assert node.solvable and node.rank == exact.rank
    values = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(M), W))[1]
    tol = 100 * EPS * (1e6 + 1e3 * values[0] / values[exact.rank - 1])
    assert relative(node.x, exact.x) < tol
    assert relative(node.force, exact.force) < tol


@settings(max_examples=30)
@given(seeds, shapes)
def test_regular_systems_are_those_of_the_exact_solution_too(seed, shapes):
    """As many joints as contacts and more: the linear path alone."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, [(max(n, m), m) for n, m in shapes])
    for W in system.W:
        W[:] = np.linalg.qr(W)[0]
    work, _, status, _ = eliminated(system)
    assert status == OK and np.all(work.pivot > COUPLED_BELOW)
    M, f_j, W, c = stacked(system)
    exact, node = least_norm(M, f_j, W, c), solved(system)
    # forces are the difference of what the constraints and what the other forces ask for
    terms = max(np.max(np.abs(least_norm(M, f_j, W, 0.0 * c).force)), np.max(np.abs(exact.force)))
    assert relative(node.x, exact.x) < 1e-12
    assert np.max(np.abs(node.force - exact.force)) < 1e-12 * terms
    assert node.coupled.status.blocks == 0


# --- constraints that contradict each other, forces that are not determined ----------------------


def null_vectors(W):
    """Orthonormal columns that span the null space of W."""
    values, vt = np.linalg.svd(W)[1:]
    return vt[np.sum(values > 1e-9 * values[0]) :].T


def redundant_system(seed):
    """Two arms of two joints and one of six: 17 contacts, of which 15 are independent."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, [(2, 6), (6, 5), (2, 6)])
    system.W_o[1][:, 4], system.W[1][:, 4] = 2.0 * system.W_o[1][:, 0], 2.0 * system.W[1][:, 0]
    make_consistent(system, rng)
    return system, rng


@settings(max_examples=30)
@given(seeds)
def test_constraints_that_contradict_each_other_are_met_in_least_squares(seed):
    """What is left over is no combination of what any motion can do: W r = 0."""
    system, rng = redundant_system(seed)
    agreed = solved(system)
    M, f_j, W, c = stacked(system)
    null = null_vectors(W)
    assert null.shape[1] >= 2 and agreed.rank == len(c) - null.shape[1]
    contradiction = null @ rng.standard_normal(null.shape[1])
    spoiled = c + contradiction
    system.c = np.split(spoiled, np.cumsum([len(part) for part in system.c])[:-1])
    node = solved(system)
    left = W.T @ node.x - spoiled
    scale = np.max(np.abs(node.x))
    np.testing.assert_allclose(left, -contradiction, atol=1e-9 * scale)
    np.testing.assert_allclose(W @ left, 0.0, atol=1e-10 * scale)
    np.testing.assert_allclose(
        M @ node.x - W @ node.force, f_j, atol=1e-9 * max(scale, np.max(np.abs(node.force)))
    )
    assert relative(node.x, agreed.x) < 1e-10


@settings(max_examples=30)
@given(seeds)
def test_forces_that_move_nothing_only_make_the_forces_longer(seed):
    """Least norm in newtons: the forces have no part in the null space of W."""
    system, rng = redundant_system(seed)
    node, W = solved(system), stacked(system)[2]
    null = null_vectors(W)
    length = np.linalg.norm(node.force)
    np.testing.assert_allclose(null.T @ node.force, 0.0, atol=1e-9 * length)
    for _ in range(5):
        added = null @ rng.standard_normal(null.shape[1])
        assert np.linalg.norm(node.force + added) > length


@settings(max_examples=30)
@given(seeds)
def test_undetermined_forces_are_those_with_a_part_in_the_null_space(seed):
    system, _ = redundant_system(seed)
    node, W = solved(system), stacked(system)[2]
    parts = np.linalg.norm(null_vectors(W), axis=1)
    np.testing.assert_allclose(undetermined_parts(node.work, node.coupled), parts, atol=1e-7)


def test_singular_arm_of_the_worked_example():
    """Two parallel constraints of one arm: the linear path stops, the coupled system goes on."""
    system, _, expected = worked_system("node_solver_singular_arm")
    work, _, status, _ = eliminated(system)
    assert status == DEFICIENT and not work.pivot[0] > 1e-13
    node = solved(system)
    assert node.solvable and node.coupled.deficient[0] == 1
    np.testing.assert_allclose(node.x, expected["qo"] + expected["q"], atol=1e-11)
    np.testing.assert_allclose(-node.force, expected["mu"], atol=1e-11)


# --- cost ----------------------------------------------------------------------------------------


def test_directions_that_no_joint_moves_add_unknowns_but_no_rows():
    """Two joints on six contacts: four directions bind the object alone."""
    system = random_system(np.random.default_rng(1), [(2, 6), (6, 6), (2, 5)])
    make_consistent(system, np.random.default_rng(2))
    node = solved(system)
    assert node.coupled.status.blocks == 2
    assert node.coupled.status.unknowns == 4 + 3
    assert node.coupled.status.movable == 0
    assert node.coupled.status.rank == 6


def test_sixty_four_arms_of_two_joints_meet_in_a_system_of_rank_six():
    """The coupled system is as wide as the arms are many, but no taller than the object."""
    system = random_system(np.random.default_rng(3), [(2, 6)] * 64)
    make_consistent(system, np.random.default_rng(4))
    node = solved(system)
    s = node.coupled.status
    assert (s.blocks, s.unknowns, s.movable, s.rank) == (64, 4 * 64, 0, 6)
    assert node.rank == 2 * 64 + 6
    M, f_j, W, c = stacked(system)
    assert relative(W.T @ node.x, c) < 1e-10
    assert relative(W @ node.force, M @ node.x - f_j) < 1e-10


def test_a_direction_that_a_joint_hardly_moves_keeps_its_row():
    system = random_system(np.random.default_rng(5), [(3, 3), (6, 4)])
    system.W[0][:] = np.diag([1.0, 1.0, 1e-4])
    node = solved(system)
    status = node.coupled.status
    assert (status.unknowns, status.movable, status.rank) == (1, 1, 1)
    assert sorted(node.coupled.sigma[:3])[0] < 1e-3 * max(node.coupled.sigma[:3])
    assert relative(node.x, least_norm(*stacked(system)).x) < ACCELERATION


# --- where the two paths meet --------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.3, 0.1, 0.03, 0.01, 4e-3])
def test_both_paths_give_one_solution_as_far_as_the_linear_one_goes(share):
    """An arm that moves along its worst direction by ``share`` of its best one."""
    rng = np.random.default_rng(6)
    system = random_system(rng, [(4, 3), (6, 6)])
    system.M[0][:] = np.eye(4)
    turn, _ = np.linalg.qr(rng.standard_normal((4, 3)))
    system.W[0][:] = turn * [1.0, 0.8, share]
    work, _, status, _ = eliminated(system)
    assert status == OK and work.pivot[0] > COUPLED_BELOW
    linear, coupled = solved(system), solved(system, force_coupling=[0])
    assert (linear.coupled.status.blocks, coupled.coupled.status.blocks) == (0, 1)
    assert coupled.coupled.status.unknowns == (1 if share < 1e-2 else 0)
    assert relative(coupled.x, linear.x) < 1e-11
    assert relative(coupled.force, linear.force) < 1e-11
    assert relative(coupled.x, least_norm(*stacked(system)).x) < 1e-12


@pytest.fixture(scope="module")
def leaning():
    """Two UR5s that hold a bar with straight elbows."""
    return ma.compile_system(HARD_CASES["straight_elbow"].scene())


def bent(system, bend):
    """The evaluation with the left elbow bent, and the right one bent by a third of a radian."""
    left, right = list(STRETCHED), list(STRETCHED)
    left[2], right[2] = bend, 1.0 / 3.0
    state = system.state(joint_positions={"left": left, "right": right})
    state.velocity[:] = np.linspace(-0.3, 0.4, state.velocity.size)
    return ma.evaluate(system, 0.0, state)


def test_accelerations_do_not_jump_where_the_solver_changes_its_path(leaning):
    """Either side of the threshold, carried on to it by its own parabola."""
    low, high = 1e-5, 0.3
    for _ in range(60):
        middle = math.sqrt(low * high)
        if bent(leaning, middle).coupled_arms:
            low = middle
        else:
            high = middle
    sides = []
    for way in (-1.0, 1.0):
        near = [bent(leaning, low * (1.0 + way * 1e-4 * (k + 0.1))) for k in range(3)]
        assert all(bool(one.coupled_arms) == (way < 0.0) for one in near)
        assert all(one.conditioning["left"] < 10.0 * COUPLED_BELOW for one in near)
        # parabola through k = 0.1, 1.1, 2.1 at 0
        values = np.array([np.concatenate(of_evaluation(one)) for one in near])
        sides.append(np.array([1.155, -0.21, 0.055]) @ values)
    n = leaning.model.layout.rate_count + 6
    assert relative(sides[0][:n], sides[1][:n]) < 1e-8
    assert relative(sides[0][n:], sides[1][n:]) < 1e-8


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
def test_accelerations_pass_smoothly_through_a_straight_elbow(leaning, step):
    """What lies on either side interpolates the singular posture to order 4."""
    f = {k: of_evaluation(bent(leaning, k * step))[0] for k in range(-2, 3)}
    between = (4.0 * (f[1] + f[-1]) - (f[2] + f[-2])) / 6.0
    assert relative(between, f[0]) < max(30.0 * step**4, 1e-9)
    assert relative(f[2], f[0]) > 1e-3 * step


# --- robots --------------------------------------------------------------------------------------


def chain_pair(folder):
    """Two arms of four joints, hinges and a slide, welded to one box."""
    path = folder / "four.urdf"
    path.write_text(chain_urdf("zyuy"))
    arms = {
        name: {
            "urdf": str(path), "tip": "tip", "posture": [0.3, 0.5, 0.1, -0.6],
            "base": {"xyz": [sign * 0.8, 0.1 * sign, 0.0], "rpy": [0.0, 0.0, turn]},
        }
        for name, sign, turn in (("left", -1.0, 0.2), ("right", 1.0, 2.7))
    }  # fmt: skip
    return scene_of(arms, [{"arm": name, "kind": "weld"} for name in arms])


ROBOTS = {
    "wrist of a UR5 aligned": lambda folder: ur5_pair({"kind": "weld"}, {"kind": "weld"}),
    "arms of four joints": chain_pair,
    "planar arms of two joints": lambda folder: planar_pair(
        "planar_2r", [0.7, -1.4], {"kind": "weld"}, "node"
    ),
    "elbow of a UR5 stretched": lambda folder: single_arm(
        "ur5", "tool0", [0.2, -1.0, 0.0, -0.7, -1.3, 0.4], {"kind": "weld"}
    ),
    "contacts that repeat": lambda folder: two_arm_block_twice(),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_move_as_the_whole_system_does(name, tmp_path):
    system = ma.compile_system(ROBOTS[name](tmp_path))
    state = system.initial_state()
    if name.startswith("wrist"):
        state = system.state(joint_positions={"left": UR5_WRIST_SINGULAR, "right": UR5_POSTURE})
    evaluation = ma.evaluate(system, 0.0, state)
    assert evaluation.coupled_arms
    M, f_j, W, c = system_matrices(system, evaluation)
    null = null_vectors(W)
    x, force = of_evaluation(evaluation)
    # W is exact to rounding only, so that the oracle is told which rows repeat others
    kept = null_vectors(null.T) if null.size else np.eye(len(c))
    exact = least_norm(M, f_j, W @ kept, kept.T @ c)
    assert relative(x, exact.x) < 1e-9
    assert relative(force, kept @ exact.force) < 1e-8
    assert evaluation.rank == len(c) - null.shape[1]
    unique = np.concatenate(list(evaluation.contact_forces_unique.values()))
    np.testing.assert_array_equal(unique, np.linalg.norm(null, axis=1) < 1e-7)
    assert np.linalg.norm(null.T @ force) < 1e-8 * np.linalg.norm(force)


# --- numbers that are none -----------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", ["M", "W", "M_o", "W_o"])
@pytest.mark.parametrize("joints", [6, 2], ids=["regular", "deficient"])
def test_numbers_that_are_not_finite_never_come_out_as_a_solution(value, which, joints):
    system = random_system(np.random.default_rng(6), [(joints, 4), (5, 2)])
    assert solved(system).solvable
    matrix = system.M_o if which == "M_o" else getattr(system, which)[0]
    matrix[0, 0] = value
    node = solved(system)
    assert not node.solvable or not np.all(np.isfinite(node.x))
    if which != "W_o":  # a wrench that is none may belong to a direction that is not eliminated
        assert not node.solvable


@pytest.mark.parametrize("joints", [6, 2], ids=["regular", "deficient"])
@pytest.mark.parametrize("which", [0, 1])
def test_inertias_that_are_not_positive_definite_are_refused(joints, which):
    system = random_system(np.random.default_rng(7), [(joints, 4), (5, 2)])
    system.M[which][-1, -1] = -1.0
    work, _, status, _ = eliminated(system)
    assert status == BLOCK_INERTIA
    assert eliminate_blocks(work, object_rows(system)) == (BLOCK_INERTIA, which)
    system = random_system(np.random.default_rng(7), [(joints, 4), (5, 2)])
    system.M_o[5, 5] = -100.0
    assert not solved(system, force_coupling=[0]).solvable


# --- symmetry ------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(seeds)
def test_the_order_of_the_arms_does_not_matter(seed):
    system, rng = redundant_system(seed)
    order = rng.permutation(3)
    other = SimpleNamespace(
        **{
            key: [value[i] for i in order] if isinstance(value, list) else value
            for key, value in vars(system).items()
        }
    )
    one, two = solved(system), solved(other)
    assert one.rank == two.rank
    joints, rows = [len(M) for M in system.M], [len(c) for c in system.c]
    assert relative(two.x[:6], one.x[:6]) < 1e-10
    for found, expected, sizes in ((two.x[6:], one.x[6:], joints), (two.force, one.force, rows)):
        parts = np.split(expected, np.cumsum(sizes)[:-1])
        assert relative(found, np.concatenate([parts[i] for i in order])) < 1e-9


@settings(max_examples=20)
@given(seeds)
def test_the_directions_of_the_axes_do_not_matter(seed):
    system, rng = redundant_system(seed)
    turn = np.kron(np.eye(2), Rotation.random(random_state=rng).as_matrix())
    other = SimpleNamespace(**vars(system))
    other.M_o, other.f_o = turn @ system.M_o @ turn.T, turn @ system.f_o
    other.W_o = [turn @ W_o for W_o in system.W_o]
    one, two = solved(system), solved(other)
    assert one.rank == two.rank
    assert relative(two.x[:6], turn @ one.x[:6]) < 1e-10
    assert relative(two.x[6:], one.x[6:]) < 1e-10
    assert relative(two.force, one.force) < 1e-9


@settings(max_examples=20)
@given(seeds, st.sampled_from([1e3, 1e-3, 1e-8]), st.sampled_from([1e3, 1e-3]))
def test_the_units_do_not_matter(seed, length, mass):
    """Millimetres and grams, kilometres and tonnes, and a machine of nanometres in metres: hinges,
    contacts with gaps in lengths."""
    system, _ = redundant_system(seed)
    object_units = np.repeat([1.0, length], 3)  # wrench of a unit force
    work = mass * length**2
    other = SimpleNamespace(
        M_o=system.M_o * mass * np.outer(object_units, object_units),
        f_o=system.f_o * mass * length * object_units,
        M=[M * work for M in system.M],
        f_j=[f_j * work for f_j in system.f_j],
        W_o=[W_o * object_units[:, None] for W_o in system.W_o],
        W=[W * length for W in system.W],
        c=[c * length for c in system.c],
        lever=length,
    )
    one, two = solved(system), solved(other)
    assert one.rank == two.rank
    assert one.coupled.status.rank == two.coupled.status.rank
    assert relative(two.x[:6] * object_units / length, one.x[:6]) < 1e-10
    assert relative(two.x[6:], one.x[6:]) < 1e-10
    assert relative(two.force / (mass * length), one.force) < 1e-9
