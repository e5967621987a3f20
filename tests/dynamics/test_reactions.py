"""Claims about the solver for contact forces along other directions than the constraints.

Oracles: the dense system, worked examples, the equations themselves, and null vectors written down
by hand.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from matrix_systems import random_system, solve_by_node, stacked, worked_system
from mechanics import EPS
from repository import WORKED

from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND, PART_TOLERANCE
from multiarm.dynamics.solver.dense import SystemSolution, solve_dense
from multiarm.dynamics.solver.factors import decompose, factor_lu, solve_lu, solve_lu_transposed
from multiarm.dynamics.solver.reactions import (
    eliminate_with_reactions,
    make_reaction_work,
    solve_for_reactions,
)
from multiarm.dynamics.status import BLOCK_INERTIA, BLOCK_NOT_FINITE, OBJECT_INERTIA, OK


def solve_with_reactions(
    M_o: np.ndarray,
    f_o: np.ndarray,
    M: list[np.ndarray],
    f_j: list[np.ndarray],
    W_o: list[np.ndarray],
    W: list[np.ndarray],
    c: list[np.ndarray],
    reaction_o: list[np.ndarray] | None = None,
    reaction: list[np.ndarray] | None = None,
) -> SystemSolution:
    """Solve the constrained system by the node algorithm.

    Parameters and result are those of :func:`multiarm.dynamics.solver.dense.solve_dense`.

    Raises
    ------
    ValueError
        When an inertia matrix is not positive definite, or a number is not finite.
    """
    dofs, rows = [len(m) for m in M], [w.shape[1] for w in W]
    reaction = W if reaction is None else reaction
    work = make_reaction_work(dofs, rows)
    W_o = np.ascontiguousarray(np.hstack(W_o).T, dtype=float)
    Wr_o = W_o if reaction_o is None else np.ascontiguousarray(np.hstack(reaction_o).T, dtype=float)
    loads = np.array(f_o, float), np.concatenate(f_j).astype(float), np.concatenate(c).astype(float)
    a_o, q, force = np.zeros(6), np.zeros(sum(dofs)), np.zeros(sum(rows))
    for couple_all in (False, True):
        for i, (inertia, own, forces) in enumerate(zip(M, W, reaction, strict=True)):
            work.M[i, : dofs[i], : dofs[i]] = inertia
            work.W[i, : dofs[i], : rows[i]] = own
            work.Wr[i, : dofs[i], : rows[i]] = forces
        failure, arm = eliminate_with_reactions(work, W_o, Wr_o, np.array(M_o, float), couple_all)
        if failure != OK:
            part = (
                f"arm {arm + 1}" if failure in (BLOCK_INERTIA, BLOCK_NOT_FINITE) else "the object"
            )
            raise ValueError(
                f"{part}: the inertia matrix is not positive definite, or a number is not finite"
            )
        solve_for_reactions(work, W_o, Wr_o, *loads, a_o, q, force)
        left = np.abs(np.array(M_o) @ a_o - f_o - Wr_o.T @ force)
        if np.all(left <= IMBALANCE_BOUND * (np.abs(f_o) + np.abs(Wr_o).T @ np.abs(force))):
            break
    status, bounds = work.status, np.cumsum(rows)[:-1]
    free = work.null_force[: status.null_forces, : len(force)]
    return SystemSolution(
        object_acceleration=a_o,
        joint_accelerations=np.split(q, np.cumsum(dofs)[:-1]),
        contact_forces=np.split(force, bounds),
        unique=np.split(np.linalg.norm(free, axis=0) < PART_TOLERANCE, bounds),
        rank=len(force) - (status.contacts - status.rank),
        motion_unique=not status.motions,
        undetermined_blocks=tuple(np.flatnonzero(work.undetermined).tolist()),
    )


SOLVERS = [solve_with_reactions, solve_dense]

seeds = st.integers(0, 2**32 - 1)
frictions = st.sampled_from([0.0, 0.1, 0.5])
healthy = st.lists(
    st.integers(1, 9).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, min(n, 6)))),
    min_size=1,
    max_size=5,
)
deficient = st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=4)


def flat(solution):
    return SimpleNamespace(
        x=np.concatenate([solution.object_acceleration, *solution.joint_accelerations]),
        force=np.concatenate(solution.contact_forces),
        unique=np.concatenate(solution.unique).tolist(),
        rank=solution.rank,
        motion_unique=solution.motion_unique,
        undetermined_blocks=solution.undetermined_blocks,
    )


def orthonormal_system(rng, shapes, ratio=1.0):
    """Arms whose constraint directions are orthonormal: K is within the inertia's range."""
    system = random_system(rng, shapes, ratio)
    for W in system.W:
        W[:] = np.linalg.qr(W)[0]
    return system


def with_friction(rng, system, size):
    """Reactions that lean away from the constraints by random amounts."""
    lean = lambda matrices: [w + size * rng.standard_normal(w.shape) for w in matrices]  # noqa: E731
    return {"reaction_o": lean(system.W_o), "reaction": lean(system.W)}


def stacked_reactions(system, reactions):
    swapped = {**vars(system), "W_o": reactions["reaction_o"], "W": reactions["reaction"]}
    return stacked(SimpleNamespace(**swapped))[2]


def condition(system, reactions):
    """Condition of the whole system in inertia coordinates."""
    M, _, W, _ = stacked(system)
    L = np.linalg.cholesky(M)
    Y, Yr = np.linalg.solve(L, W), np.linalg.solve(L, stacked_reactions(system, reactions))
    n, m = W.shape
    return np.linalg.cond(np.block([[np.eye(n), -Yr], [Y.T, np.zeros((m, m))]]))


def assert_same(found, expected, tol):
    scale = max(np.max(np.abs(expected.force)), 1e-6)
    np.testing.assert_allclose(found.x, expected.x, atol=tol * np.max(np.abs(expected.x)))
    np.testing.assert_allclose(found.force, expected.force, atol=tol * scale)
    for field in ("rank", "unique", "motion_unique", "undetermined_blocks"):
        assert getattr(found, field) == getattr(expected, field), field


def relative_residual(system, found):
    """Largest ``W^T x - c`` relative to ``c`` and accelerations without and by contact forces."""
    M, f_j, W, c = stacked(system)
    free, terms = np.linalg.solve(M, f_j), [c]
    for part in (slice(0, 6), slice(6, None)):  # object, arms
        terms += [W[part].T @ free[part], W[part].T @ (found.x - free)[part]]
    return np.max(np.abs(W.T @ found.x - c)) / max(np.max(np.abs(term)) for term in terms)


def assert_solves(found, system, reactions, tol=1e-10):
    """The equations of motion hold."""
    M, f_j, _, _ = stacked(system)
    push = stacked_reactions(system, reactions) @ found.force
    largest = max(np.max(np.abs(v)) for v in (f_j, push))
    np.testing.assert_allclose(M @ found.x - push, f_j, atol=tol * largest)


# --- worked examples -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["node_solver_friction", "node_solver_singular_arm"])
def test_worked_examples_with_friction_and_with_a_singular_arm(name):
    system, reactions, expected = worked_system(name)
    found = flat(solve_with_reactions(**vars(system), **reactions))
    np.testing.assert_allclose(found.x, expected["qo"] + expected["q"], atol=1e-13)
    np.testing.assert_allclose(-found.force, expected["mu"], atol=1e-12)
    assert found.motion_unique and all(found.unique) and found.rank == len(found.force)


@pytest.mark.slow
def test_the_singular_arm_of_the_worked_example_is_coupled_and_the_other_one_is_not():
    system, _, _ = worked_system("node_solver_singular_arm")
    assert coupled_rows(system) == system.W[0].shape[1]


def test_velocities_of_the_worked_example_are_projected_in_the_inertia_metric():
    """q = v after, f_j = M v before, c = 0: an inelastic impact."""
    data, impact = WORKED["two_arm_block_system"], WORKED["velocity_projection"]
    R, x = np.array(data["inputs"]["Ro"]), data["expected"]
    turn = np.kron(np.eye(2), R)
    M_o = np.zeros((6, 6))
    M_o[:3, :3] = data["inputs"]["mo"] * np.eye(3)
    M_o[3:, 3:] = R @ np.diag(data["inputs"]["Io"]) @ R.T
    M = [np.array(x["M0"]), np.array(x["M1"])]
    before = np.split(np.array(impact["inputs"]["raw_velocity"]), [6, 12])
    W = [np.array(w) for w in x["Woff"]]
    found = flat(
        solve_with_reactions(
            M_o, M_o @ before[0], M, [m @ v for m, v in zip(M, before[1:], strict=True)],
            [turn @ np.array(w) for w in x["Wo"]], W, [np.zeros(w.shape[1]) for w in W],
        )
    )  # fmt: skip
    expected = impact["expected"]
    np.testing.assert_allclose(found.x, expected["v_o"] + expected["qdot"], atol=1e-8)
    np.testing.assert_allclose(-found.force, expected["impulse_mu"], atol=1e-8)
    lost = 0.0
    for inertia, old, new in zip([M_o, *M], before, np.split(found.x, [6, 12]), strict=True):
        lost += 0.5 * (old @ inertia @ old - new @ inertia @ new)
    assert lost == pytest.approx(expected["kinetic_energy_loss"], abs=1e-9)


def test_forces_of_coplanar_contacts_that_nearly_balance_keep_equations_and_constraints():
    """Four corners of a box slide, each a little aside: the normal forces have one free number."""
    corners = np.array([[x, y, -0.1] for x in (-0.3, 0.2) for y in (-0.1, 0.15)])
    angles = 1e-4 * corners[:, 0] + 2e-6 * np.array([1.0, -1.0, -1.0, 1.0])
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    sideways = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])
    wrenches = lambda forces: np.hstack([forces, np.cross(corners, forces)]).T  # noqa: E731
    inertia = np.diag([2.0, 2.0, 2.0, 0.02, 0.05, 0.06])
    system = SimpleNamespace(
        M_o=inertia, f_o=np.array([0.3, 0.1, -19.6, 0.02, 0.1, 0.03]), M=[np.eye(1)],
        f_j=[np.zeros(1)], W_o=[wrenches(normals)], W=[np.zeros((1, 4))], c=[np.zeros(4)],
    )  # fmt: skip
    reactions = {"reaction_o": [wrenches(normals - 0.4 * sideways)], "reaction": system.W}
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert found.rank == 3 and not any(found.unique) and np.all(found.force > 0.0)
    assert_solves(found, system, reactions, 1e-14)
    assert relative_residual(system, found) < 1e-13


# --- against the dense system --------------------------------------------------------------------


@pytest.mark.slow
@settings(max_examples=30)
@given(seeds, healthy, frictions, st.sampled_from([1e-3, 1.0, 1e3]))
def test_healthy_arms_move_as_the_dense_system_says(seed, shapes, friction, ratio):
    rng = np.random.default_rng(seed)
    system = orthonormal_system(rng, shapes, ratio)
    reactions = with_friction(rng, system, friction)
    assume(condition(system, reactions) < 1e3)
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert_same(found, flat(solve_dense(**vars(system), **reactions)), 1e-10)
    assert found.motion_unique and all(found.unique) and relative_residual(system, found) < 1e-11


@pytest.mark.slow
@settings(max_examples=30)
@given(seeds, healthy)
def test_without_friction_it_is_the_node_algorithm(seed, shapes):
    system = orthonormal_system(np.random.default_rng(seed), shapes)
    none = {"reaction_o": system.W_o, "reaction": system.W}
    node = solve_by_node(system)
    assert node.failed == OK
    for reactions in ({}, none):
        found = flat(solve_with_reactions(**vars(system), **reactions))
        np.testing.assert_allclose(found.x, node.x, atol=1e-10 * np.max(np.abs(node.x)))
        np.testing.assert_allclose(found.force, node.force, atol=1e-10 * np.max(np.abs(node.force)))


@pytest.mark.slow
@settings(max_examples=30)
@given(seeds, deficient, frictions)
def test_arms_with_too_few_joints_move_as_the_dense_system_says(seed, shapes, friction):
    rng = np.random.default_rng(seed)
    system = random_system(rng, shapes)
    reactions = with_friction(rng, system, friction)
    _, _, W, _ = stacked(system)
    singular = np.linalg.svd(W / np.linalg.norm(W, axis=0))[1]
    M, _, _, _ = stacked(system)
    core = np.linalg.svd(W.T @ np.linalg.solve(M, stacked_reactions(system, reactions)))[1]
    # ranks that are clear one way or the other
    assume(not np.any((singular > 1e-12) & (singular < 1e-2)))
    assume(not np.any((core > 1e-12) & (core < 1e-3)))
    c = W.T @ rng.standard_normal(len(W))  # some motion satisfies all constraints
    system.c = np.split(c, np.cumsum([m for _, m in shapes])[:-1])
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert_same(found, flat(solve_dense(**vars(system), **reactions)), 1e-9)
    assert_solves(found, system, reactions)


@pytest.mark.slow
@settings(max_examples=40)
@given(seeds, healthy, st.sampled_from([1.0, 3.0, -0.2]), st.booleans())
def test_a_contact_that_is_there_twice_changes_no_motion(seed, shapes, lever, on_first):
    """Constraint and reaction repeated with a lever: f_1 + lever f_2 = f, of least norm."""
    rng = np.random.default_rng(seed)
    once = orthonormal_system(rng, shapes)
    reactions = with_friction(rng, once, 0.1)
    assume(condition(once, reactions) < 1e3)
    twice, arm = SimpleNamespace(**vars(once)), 0 if on_first else len(shapes) - 1
    doubled = {key: repeated(value, arm, lever) for key, value in reactions.items()}
    for key in ("W_o", "W", "c"):
        setattr(twice, key, repeated(getattr(once, key), arm, lever))
    expected = flat(solve_with_reactions(**vars(once), **reactions))
    first = sum(m for _, m in shapes[:arm])
    last = first + shapes[arm][1]
    shared = np.insert(expected.force, last, 0.0)
    shared[[first, last]] = expected.force[first] * np.array([1.0, lever]) / (1.0 + lever**2)
    for solver in SOLVERS:
        found = flat(solver(**vars(twice), **doubled))
        np.testing.assert_allclose(found.x, expected.x, atol=1e-10 * np.max(np.abs(expected.x)))
        np.testing.assert_allclose(found.force, shared, atol=1e-10 * np.max(np.abs(shared)))
        assert found.rank == expected.rank and found.motion_unique
        assert relative_residual(twice, found) < 1e-11
        assert [k for k, unique in enumerate(found.unique) if not unique] == [first, last]


def repeated(matrices, arm, lever):
    """The arm's first column (or entry) once more, times ``lever``."""
    more = list(matrices)
    more[arm] = np.append(more[arm], lever * more[arm][..., :1], axis=-1)
    return more


@pytest.mark.parametrize("ratio", [1e-6, 1e6])
def test_very_light_and_very_heavy_objects_keep_their_digits(ratio, rng):
    """At mass ratios of a million all equations hold, and the rank is seen."""
    system = random_system(rng, [(6, 6), (5, 3), (2, 3)], ratio)
    system.f_o *= ratio
    reactions = with_friction(rng, system, 0.2)
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert relative_residual(system, found) < 1e-10 and found.rank == 12
    assert_solves(found, system, reactions)


def test_an_arm_far_stiffer_than_the_object_does_not_drown_its_inertia(rng):
    """A long gear: the contact hardly moves the joint, and the other directions stay exact."""
    system = random_system(rng, [(1, 1), (6, 2)])
    system.W[0][:] = 1e-6
    reactions = with_friction(rng, system, 0.0)
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert_same(found, flat(solve_dense(**vars(system), **reactions)), 1e-10)


def test_only_arms_that_cannot_follow_are_coupled(rng):
    system = random_system(rng, [(6, 3)] * 5 + [(2, 3)] + [(6, 3)] * 5)
    assert coupled_rows(system) == 3


@pytest.mark.parametrize(
    "matrix, value, failure",
    [("M", -1.0, BLOCK_INERTIA), ("M", np.nan, BLOCK_NOT_FINITE), ("W", np.nan, BLOCK_NOT_FINITE)],
)
def test_the_arm_that_fails_is_told_apart_from_its_failure(matrix, value, failure, rng):
    system = random_system(rng, [(6, 3)] * 3)
    getattr(system, matrix)[2][-1, -1] = value
    assert eliminated(system)[:2] == (failure, 2)


def test_an_object_without_inertia_is_no_arm(rng):
    system = random_system(rng, [(6, 3)] * 3)
    system.M_o[-1, -1] = -1.0
    assert eliminated(system)[0] == OBJECT_INERTIA


def coupled_rows(system):
    status, _, work = eliminated(system)
    assert status == OK
    return work.status.contacts


def eliminated(system):
    """Status, the arm that failed, and the work, without friction."""
    dofs, rows = [len(m) for m in system.M], [w.shape[1] for w in system.W]
    work = make_reaction_work(dofs, rows)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : dofs[i], : dofs[i]] = M
        work.W[i, : dofs[i], : rows[i]] = work.Wr[i, : dofs[i], : rows[i]] = W
    W_o = np.ascontiguousarray(np.hstack(system.W_o).T)
    return *eliminate_with_reactions(work, W_o, W_o, system.M_o, False), work


# --- friction ------------------------------------------------------------------------------------


def sliding_contacts(rng, arms, contacts, friction):
    """Contacts that slide: ``W`` along normals, ``W~`` along the cone, at random points.

    The tangent is the direction in which the arm's point slides over the object; it drags the
    object along.  Returns the system at consistent velocities, its reactions, the velocities and
    the sliding speeds.
    """
    system = random_system(rng, [(6, contacts)] * arms)
    J = [
        rng.standard_normal((6, 6)) for _ in range(arms)
    ]  # of the arm's body at the world's origin
    wrench = lambda e, p: np.concatenate([e, np.cross(p, e)])  # noqa: E731
    points = rng.standard_normal((arms, contacts, 3))
    normals = rng.standard_normal((arms, contacts, 3))
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    for i in range(arms):
        columns = [wrench(e, p) for e, p in zip(normals[i], points[i], strict=True)]
        system.W_o[i] = np.array(columns).T
        system.W[i] = -J[i].T @ system.W_o[i]
    _, _, W, _ = stacked(system)
    free = np.linalg.svd(W)[0][:, W.shape[1] :]
    v = free @ rng.standard_normal(free.shape[1])  # no gap opens or closes
    reactions = {"reaction_o": [], "reaction": []}
    speeds = []
    for i in range(arms):
        twist = J[i] @ v[6 + 6 * i : 12 + 6 * i] - v[:6]
        leaning = []
        for e, p in zip(normals[i], points[i], strict=True):
            slip = twist[:3] + np.cross(twist[3:], p)
            speeds.append(np.linalg.norm(slip))
            leaning.append(wrench(e + friction * slip / speeds[-1], p))
        reactions["reaction_o"].append(np.array(leaning).T)
        reactions["reaction"].append(-J[i].T @ np.array(leaning).T)
    return system, reactions, v, np.array(speeds)


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
def test_friction_dissipates_k_times_sliding_speed_per_unit_of_normal_force(friction, rng):
    """v^T (M q'' - f_j) = -k sum |v_t| lambda."""
    for _ in range(20):
        system, reactions, v, speeds = sliding_contacts(rng, 2, 3, friction)
        found = flat(solve_with_reactions(**vars(system), **reactions))
        M, f_j, _, _ = stacked(system)
        power = v @ (M @ found.x - f_j)
        size = np.sum(np.abs(found.force)) * max(1.0, np.max(speeds))
        tol = 100 * EPS * condition(system, reactions)
        assert power == pytest.approx(-friction * speeds @ found.force, abs=tol * size)


# --- motions that the equations do not determine -------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS)
def test_forces_that_no_constraint_sees_but_that_move_the_system_are_told(solver, rng):
    """One contact twice, but of unlike friction: only the sum of their normal forces is known."""
    system = random_system(rng, [(6, 3), (6, 2), (5, 2)])
    reactions = with_friction(rng, system, 0.1)
    for key in ("W_o", "W", "c"):
        setattr(system, key, repeated(getattr(system, key), 1, 1.0))
    for key, value in reactions.items():
        reactions[key] = repeated(value, 1, 1.0)
        reactions[key][1][:, 2] += 0.2 * rng.standard_normal(len(reactions[key][1]))
    found = flat(solver(**vars(system), **reactions))
    assert not found.motion_unique
    assert 1 in found.undetermined_blocks
    assert found.rank == 7 and relative_residual(system, found) < 1e-12
    assert_solves(found, system, reactions)
    # another solution, with other accelerations, found without the solver
    M, f_j, W, c = stacked(system)
    pushes = stacked_reactions(system, reactions)
    F = W.T @ np.linalg.solve(M, pushes)
    other = found.force + np.linalg.svd(F)[2][-1]
    moved = np.linalg.solve(M, f_j + pushes @ other)
    np.testing.assert_allclose(W.T @ moved, c, atol=1e-12)
    assert np.max(np.abs(moved - found.x)) > 1e-2
    # of all these the one with the smallest forces is returned
    assert np.linalg.svd(F)[2][-1] @ found.force == pytest.approx(0.0, abs=1e-11)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("consistent", [True, False])
@pytest.mark.parametrize("first", [(3, 1), (2, 3)], ids=["healthy arm", "arm of two joints"])
def test_a_contact_whose_force_cannot_close_its_own_gap_is_told(solver, consistent, first, rng):
    """Painleve: W^T M^-1 W~ is singular, so that there are no solutions, or infinitely many."""
    system = random_system(rng, [first, (6, 4)])
    reactions = with_friction(rng, system, 0.2)
    count = first[1] + 4
    M, f_j, W, c = stacked(system)
    F = W.T @ np.linalg.solve(M, stacked_reactions(system, reactions))
    # the first contact's reaction on the object leans until F is singular; det F is linear in it
    lean = np.linalg.solve(system.M_o, np.hstack(system.W_o)).T @ np.ones(6)
    leant = F.copy()
    leant[:, 0] += lean
    amount = np.linalg.det(F) / (np.linalg.det(F) - np.linalg.det(leant))
    reactions["reaction_o"][0][:, 0] += amount
    F[:, 0] += amount * lean
    if consistent:
        c = F @ rng.standard_normal(count) + W.T @ np.linalg.solve(M, f_j)
        system.c = np.split(c, [first[1]])
    found = flat(solver(**vars(system), **reactions))
    assert not found.motion_unique
    assert 0 in found.undetermined_blocks
    assert found.rank == count  # the constraints themselves are independent
    assert_solves(found, system, reactions)
    if consistent:
        assert relative_residual(system, found) < 1e-9
        return
    # what is left over is the least that any forces leave
    pushed = np.linalg.solve(M, f_j + stacked_reactions(system, reactions) @ found.force)
    target = c - W.T @ np.linalg.solve(M, f_j)
    best = target - F @ np.linalg.lstsq(F, target, rcond=1e-9)[0]
    np.testing.assert_allclose(c - W.T @ pushed, best, atol=1e-9 * np.max(np.abs(target)))
    assert relative_residual(system, found) > 1e-3


@pytest.mark.parametrize("solver", SOLVERS)
def test_constraints_that_contradict_each_other_are_met_in_the_least_squares_sense(solver, rng):
    """The same contact twice, told to accelerate by a and by b: it does by their mean."""
    once = random_system(rng, [(6, 3), (4, 2)])
    reactions = with_friction(rng, once, 0.1)
    twice = SimpleNamespace(**vars(once))
    for key in ("W_o", "W", "c"):
        setattr(twice, key, repeated(getattr(once, key), 0, 1.0))
    doubled = {key: repeated(value, 0, 1.0) for key, value in reactions.items()}
    twice.c[0][[0, 3]] += [0.25, -0.25]
    expected = flat(solver(**vars(once), **reactions))
    found = flat(solver(**vars(twice), **doubled))
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-10, atol=1e-12)
    _, _, W, c = stacked(twice)
    left = np.zeros(6)
    left[[0, 3]] = [-0.25, 0.25]
    np.testing.assert_allclose(W.T @ found.x - c, left, atol=1e-12)
    assert found.motion_unique and 1e-3 < relative_residual(twice, found) < 1.0


def test_a_node_matrix_that_fails_although_every_arm_is_healthy_couples_all_arms():
    """The second arm alone is Painleve's case; the first one, which cannot move, holds it."""
    rng = np.random.default_rng(11)
    system = random_system(rng, [(2, 3), (3, 1)])
    system.W[0][:] = 0.0
    reactions = {"reaction_o": list(system.W_o), "reaction": list(system.W)}
    w = system.W_o[1][:, 0]
    K = (system.W[1].T @ np.linalg.solve(system.M[1], system.W[1])).item()
    against = -K * w / (w @ np.linalg.solve(system.M_o, w))
    reactions["reaction_o"][1] = against[:, None]  # K + w^T M_o^-1 w~ = 0
    found = flat(solve_with_reactions(**vars(system), **reactions))
    assert found.motion_unique and relative_residual(system, found) < 1e-12
    assert_same(found, flat(solve_dense(**vars(system), **reactions)), 1e-10)
    assert_solves(found, system, reactions)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("what", "place"),
    [("M", "arm 2"), ("W", "arm 2"), ("M_o", "the object"), ("W_o", "the object")],
)
def test_numbers_that_are_not_finite_are_refused(value, what, place, rng):
    system = random_system(rng, [(4, 3), (5, 2)])
    matrix = getattr(system, what) if what == "M_o" else getattr(system, what)[1]
    matrix[0, 0] = value
    with pytest.raises(ValueError, match=place):
        solve_with_reactions(**vars(system))


# --- factors -------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(seeds, st.integers(1, 12), st.integers(1, 12), st.integers(0, 12))
def test_singular_values_and_vectors_are_those_of_lapack(seed, m, n, rank):
    rng = np.random.default_rng(seed)
    rank = min(m, n, rank)
    matrix = rng.standard_normal((m, rank)) @ rng.standard_normal((rank, n))
    A, V, singular = matrix.T.copy(), np.zeros((n, n)), np.zeros(n)
    assert decompose(A, n, m, V, singular)
    expected = np.zeros(n)
    expected[: min(m, n)] = np.linalg.svd(matrix, compute_uv=False)
    tol = 50 * EPS * max(1.0, expected[0])
    np.testing.assert_allclose(singular, expected, atol=tol)
    np.testing.assert_allclose(V @ V.T, np.eye(n), atol=1e-14 * n)
    np.testing.assert_allclose((A * singular[:, None]).T @ V, matrix, atol=tol)
    kept = A[singular > 1e-9 * max(singular[0], 1e-300)]
    np.testing.assert_allclose(kept @ kept.T, np.eye(len(kept)), atol=1e-12)


def test_small_singular_values_keep_their_digits(rng):
    """Orthogonal columns of very different sizes: each value is right relative to itself."""
    sizes = 10.0 ** -np.arange(0, 13, 3)
    matrix = np.linalg.qr(rng.standard_normal((8, 5)))[0] * sizes
    A, V, singular = matrix.T.copy(), np.zeros((5, 5)), np.zeros(5)
    assert decompose(A, 5, 8, V, singular)
    np.testing.assert_allclose(singular, sizes, rtol=1e-14)


@settings(max_examples=30)
@given(seeds, st.integers(1, 12))
def test_lu_factors_solve_both_ways_and_show_singular_matrices(seed, n):
    rng = np.random.default_rng(seed)
    matrix, b = rng.standard_normal((n, n)), rng.standard_normal(n)
    A, pivots = matrix.copy(), np.zeros(n, dtype=np.int64)
    assert factor_lu(A, n, pivots) > 0.0
    tol = 1e3 * EPS * np.linalg.cond(matrix)
    for solve, of in ((solve_lu, matrix), (solve_lu_transposed, matrix.T)):
        x = b.copy()
        solve(A, n, pivots, x)
        expected = np.linalg.solve(of, b)
        np.testing.assert_allclose(x, expected, atol=tol * np.max(np.abs(expected)))
    matrix[:, -1] = matrix[:, :-1].sum(axis=1)
    assert not factor_lu(matrix, n, pivots) > 1e-10
