"""Claims about the complementarity problem on random matrices, against independent solvers."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import frictions, held_motion, pushes, random_rows, random_units, violation
from scipy.optimize import linprog, lsq_linear, minimize, nnls

from multiarm.events.complementarity import (
    Bounded,
    ContactMode,
    Friction,
    Push,
    Sliding,
    Verdict,
    solve,
)

seeds = st.integers(0, 2**32 - 1)
ALL = [Push, Bounded, Friction, Sliding]
# Scaled residuals of exact solutions: sums of forty terms, solved with conditions up to 1e3.
TOLERANCE = 1e-11
# Where a force was taken to be at its bound, or at zero, though it was not quite.
SNAPPED = 1e-8
# Motions of two algorithms, each of which solves with singular values down to a thousandth.
AGREE = 1e-8
PUSHING = {ContactMode.CLOSED, ContactMode.STICKING, ContactMode.SLIDING, ContactMode.AT_BOUND}


def problem(rng, kinds, most=6):
    units, rows = random_units(rng, kinds, int(rng.integers(1, most)))
    A, a = random_rows(rng, rows, int(rng.integers(1, rows + 3)))
    return A, a, units


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [[Push], [Bounded], [Friction], [Sliding], ALL])
@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=seeds)
def test_every_solution_obeys_the_laws(kinds, seed):
    A, a, units = problem(np.random.default_rng(seed), kinds)
    D, b = A @ A.T, A @ a
    solution = solve(D, b, units)
    if solution.verdict is Verdict.NONE:
        assert solution.message and solution.residual > 1e-9 and solution.active_rows == ()
        return
    snapped = {ContactMode.AT_BOUND, ContactMode.RESTING} & set(solution.modes)
    tolerance = SNAPPED if snapped else TOLERANCE
    assert violation(D, b, units, solution.forces) < tolerance
    assert solution.residual < tolerance
    np.testing.assert_allclose(solution.rates, D @ solution.forces + b)
    for other in solution.alternatives:
        assert violation(D, b, units, other.forces) < TOLERANCE
        assert np.max(np.abs(other.rates - solution.rates)) > 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [[Push], [Bounded], [Friction], [Sliding], ALL])
@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=seeds)
def test_holding_the_rows_gives_the_same_forces_with_a_margin(kinds, seed):
    A, a, units = problem(np.random.default_rng(seed), kinds)
    D, b = A @ A.T, A @ a
    solution = solve(D, b, units)
    if solution.verdict is Verdict.NONE or "undetermined" in solution.message:
        return
    if "no rows can be held" in solution.message:
        assert any(isinstance(unit, (Friction, Sliding)) for unit in units)
        return
    size = np.max(np.abs(solution.forces)) + np.max(np.abs(b)) / np.max(D)
    # a contact at its limit that bears almost nothing hardly knows its direction
    agree = 1e-6 if ContactMode.AT_BOUND in solution.modes else AGREE
    held = held_motion(D, b, units, solution)
    np.testing.assert_allclose(held, solution.forces, rtol=0, atol=agree * size)
    for unit, mode in zip(units, solution.modes, strict=True):
        force = solution.forces[unit.row]
        if mode in PUSHING:
            assert force > 0.0 and unit.row in solution.active_rows
        if mode is ContactMode.HOLDING:
            assert unit.lower < force < unit.upper and unit.row in solution.active_rows
        if mode in (ContactMode.OPEN, ContactMode.RESTING):
            assert abs(force) <= 1e-12 * size
        if mode is ContactMode.STICKING:
            tangents = solution.forces[list(unit.tangents)]
            assert np.hypot(*tangents) < unit.mu * force
            assert set(unit.tangents) <= set(solution.active_rows)


@pytest.mark.slow
def test_active_rows_are_found_for_all_but_one_in_a_hundred_random_contacts_with_friction():
    """Few freedoms, much friction, forces that only together are inside of all cones."""
    failed = 0
    for seed in range(300):
        A, a, units = problem(np.random.default_rng(seed), [Friction])
        failed += "no rows can be held" in solve(A @ A.T, A @ a, units).message
    assert failed <= 3


@pytest.mark.slow
@settings(max_examples=66, deadline=None, derandomize=True)
@given(seed=seeds, count=st.integers(1, 20))
def test_pushes_move_as_nonnegative_least_squares(seed, count):
    rng = np.random.default_rng(seed)
    A, a = random_rows(rng, count, int(rng.integers(1, count + 3)))
    solution = solve(A @ A.T, A @ a, pushes(count))
    expected = A @ (A.T @ nnls(A.T, -a, maxiter=1000)[0] + a)
    assert solution.verdict is Verdict.UNIQUE
    np.testing.assert_allclose(solution.rates, expected, atol=AGREE * np.max(np.abs(A @ a) + 1.0))


@pytest.mark.slow
@settings(max_examples=66, deadline=None, derandomize=True)
@given(seed=seeds, count=st.integers(1, 20))
def test_bounded_forces_move_as_bounded_least_squares(seed, count):
    rng = np.random.default_rng(seed)
    A, a = random_rows(rng, count, int(rng.integers(1, count + 3)))
    lower, upper = -rng.uniform(0.01, 1.0, count), rng.uniform(0.01, 1.0, count)
    units = [Bounded(k, lower[k], upper[k]) for k in range(count)]
    solution = solve(A @ A.T, A @ a, units)
    x = lsq_linear(A.T, -a, (lower, upper), method="bvls", tol=1e-14, max_iter=1000).x
    expected = A @ (A.T @ x + a)
    assert solution.verdict is Verdict.UNIQUE
    np.testing.assert_allclose(solution.rates, expected, atol=AGREE * np.max(np.abs(A @ a) + 1.0))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=seeds)
def test_shared_loads_are_the_smallest_that_push(seed):
    """Forces of a singular problem, against a general minimiser under the same constraints."""
    rng = np.random.default_rng(seed)
    A, a = rng.standard_normal((6, 3)), 3.0 * rng.standard_normal(3)
    D, b = A @ A.T, A @ a
    solution = solve(D, b, pushes(6))
    wrench = A.T @ solution.forces
    result = minimize(
        lambda x: x @ x,
        nnls(A.T, -a)[0],
        jac=lambda x: 2.0 * x,
        bounds=[(0.0, None)] * 6,
        constraints={"type": "eq", "fun": lambda x: A.T @ x - wrench, "jac": lambda x: A.T},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert result.x @ result.x >= solution.forces @ solution.forces * (1.0 - 1e-6)
    np.testing.assert_allclose(solution.forces, result.x, atol=1e-4 * (1.0 + np.max(result.x)))


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=seeds)
def test_there_is_no_solution_exactly_when_no_forces_part_the_rows(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 7))
    A = rng.standard_normal((count, int(rng.integers(1, count))))
    D, b = A @ A.T, rng.standard_normal(count)
    solution = solve(D, b, pushes(count))
    # the widest opening that pushes can reach; below zero when none parts all rows
    widest = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.hstack([-D, np.ones((count, 1))]),
        b_ub=b,
        bounds=[(0.0, None)] * count + [(None, 1.0)],
    ).x[-1]
    if abs(widest) < 1e-9:
        return
    assert (solution.verdict is Verdict.NONE) == (widest < 0.0)
    assert solution.message.startswith("no solution: the rows contradict") == (widest < 0.0)


def linear_solutions(G, g):
    """All w = G z + g with 0 <= z, w and z w = 0, by trying all regular sets."""
    found = []
    for closed in product([False, True], repeat=g.size):
        rows = np.flatnonzero(closed)
        z = np.zeros(g.size)
        z[rows] = np.linalg.solve(G[np.ix_(rows, rows)], -g[rows])
        w = G @ z + g
        if np.min(z) >= -1e-10 and np.min(np.delete(w, rows), initial=0.0) >= -1e-10:
            found.append(w)
    return found


@pytest.mark.slow
@settings(max_examples=100, deadline=None, derandomize=True)
@given(seed=seeds, count=st.integers(1, 4))
def test_sliding_contacts_have_as_many_solutions_as_there_are(seed, count):
    """Friction large enough for Painleve's cases: none, one and several all occur."""
    rng = np.random.default_rng(seed)
    A, a = rng.standard_normal((3 * count, 4 * count)), rng.standard_normal(4 * count)
    A[1::3] += rng.uniform(-2.0, 2.0) * A[::3]
    D, b = A @ A.T, A @ a
    units = [Sliding(3 * k, (3 * k + 1, 3 * k + 2), 0.8, (1.0, 0.0)) for k in range(count)]
    G = D[::3, ::3] - 0.8 * D[::3, 1::3]
    expected = linear_solutions(G, b[::3])
    solution = solve(D, b, units)
    verdicts = {0: Verdict.NONE, 1: Verdict.UNIQUE}
    assert solution.verdict is verdicts.get(len(expected), Verdict.SEVERAL)
    if expected:
        motions = [solution.rates, *(other.rates for other in solution.alternatives)]
        assert len(motions) == len(expected)
        apart = [min(np.max(np.abs(w - y[::3])) for y in motions) for w in expected]
        assert max(apart) < AGREE * max(1.0, np.max(np.abs(expected)))
    if solution.verdict is not Verdict.UNIQUE:
        assert "Painleve" in solution.message


def planar_motions(D, b, mu):
    """Rates of contacts without a second tangent: open, stuck, slipping to either side."""
    count, found = b.size // 2, []
    for modes in product(["open", "stuck", -1.0, 1.0], repeat=count):
        M, c = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        for k, mode in enumerate(modes):
            n, t = 2 * k, 2 * k + 1
            M[[n, t], [n, t]] = 1.0
            if mode != "open":
                M[n], c[n] = D[n], -b[n]
            if mode == "stuck":
                M[t], c[t] = D[t], -b[t]
            elif mode != "open":
                M[t, n] = mu * mode  # x_t = -mu x_n s
        x = np.linalg.lstsq(M, c, rcond=None)[0]
        y = D @ x + b
        n, t = x[::2], x[1::2]
        signs = [m if isinstance(m, float) else 0.0 for m in modes]
        right = np.max(np.abs(M @ x - c)) < 1e-10 and np.min(n) > -1e-10 and min(y[::2]) > -1e-10
        if right and np.all(np.abs(t) <= mu * n + 1e-10) and np.all(y[1::2] * signs > -1e-10):
            found.append(y)
    return found


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=seeds, count=st.integers(1, 3), mu=st.sampled_from([0.0, 0.2, 0.6]))
def test_friction_in_a_plane_moves_as_one_of_all_modes(seed, count, mu):
    rng = np.random.default_rng(seed)
    A, a = rng.standard_normal((2 * count, 2 * count + 1)), rng.standard_normal(2 * count + 1)
    D, b = A @ A.T, A @ a
    motions = planar_motions(D, b, mu)
    plane = np.array([row for row in range(3 * count) if row % 3 < 2])
    whole, free = np.zeros((3 * count, 3 * count)), np.zeros(3 * count)
    whole[np.ix_(plane, plane)], free[plane] = D, b
    solution = solve(whole, free, frictions(count, mu))
    assert (solution.verdict is Verdict.NONE) == (not motions)
    if not motions:
        return
    apart = [np.max(np.abs(solution.rates[plane] - y)) for y in motions]
    assert min(apart) < AGREE * (1.0 + np.max(np.abs(motions)))
    if solution.verdict is Verdict.UNIQUE:
        assert max(apart) < 1e-6 * (1.0 + np.max(np.abs(motions)))


def friction_problem(seed, count=3):
    rng = np.random.default_rng(seed)
    A, a = rng.standard_normal((3 * count, 3 * count + 2)), rng.standard_normal(3 * count + 2)
    A[::3] *= 2.0
    return rng, A, a


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds)
def test_friction_does_not_know_the_axes_of_its_tangents(seed):
    rng, A, a = friction_problem(seed)
    turn = np.eye(9)
    for k, angle in zip((1, 4, 7), rng.uniform(0.0, 2.0 * np.pi, 3), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        turn[k : k + 2, k : k + 2] = [[c, -s], [s, c]]
    units = frictions(3, 0.3)
    one = solve(A @ A.T, A @ a, units)
    other = solve(turn @ A @ A.T @ turn.T, turn @ A @ a, units)
    np.testing.assert_allclose(other.forces, turn @ one.forces, atol=1e-8)
    assert other.modes == one.modes


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds, mass=st.floats(1e-3, 1e3), lever=st.floats(1e-2, 1e2))
def test_units_of_mass_and_of_a_row_do_not_matter(seed, mass, lever):
    """One row measured as a moment over a lever, all masses multiplied."""
    _, A, a = friction_problem(seed)
    A = np.vstack([A, np.linspace(-1.0, 1.0, 11)])
    units = [*frictions(3, 0.3), Bounded(9, -0.2, 0.1)]
    row = np.ones(10)
    row[9] = lever
    one = solve(A @ A.T, A @ a, units)
    wide = [*units[:3], Bounded(9, -0.2 * mass / lever, 0.1 * mass / lever)]
    other = solve((row[:, None] * A) @ (row[:, None] * A).T / mass, row * (A @ a), wide)
    np.testing.assert_allclose(other.forces * row / mass, one.forces, atol=1e-8)
    assert other.modes == one.modes
    assert other.residual < TOLERANCE


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds)
def test_the_order_of_units_does_not_matter(seed):
    rng, A, a = friction_problem(seed)
    D, b, units = A @ A.T, A @ a, frictions(3, 0.3)
    one = solve(D, b, units)
    order = rng.permutation(3)
    other = solve(D, b, [units[k] for k in order])
    np.testing.assert_allclose(other.forces, one.forces, atol=1e-8)
    assert other.modes == tuple(one.modes[k] for k in order)


@pytest.mark.parametrize("seed", range(6))
def test_contacts_that_can_rest_inside_their_cones_have_central_forces_that_do(seed):
    # forces inside all cones, which keep everything at rest, are given
    rng, contacts = np.random.default_rng(seed), 12
    A, laws = rng.normal(size=(3 * contacts, 18)), []
    given = np.zeros(3 * contacts)
    for row, mu in zip(range(0, given.size, 3), rng.uniform(0.1, 0.5, contacts), strict=True):
        laws.append(Friction(row, (row + 1, row + 2), mu))
        along = rng.normal(size=2)
        given[row] = rng.uniform(1.0, 30.0)
        given[row + 1 : row + 3] = 0.99 * mu * given[row] * along / np.linalg.norm(along)
    D = A @ A.T
    central = solve(D, -D @ given, laws).central()
    assert central is not None
    assert set(central.modes) == {ContactMode.STICKING}
    np.testing.assert_allclose(central.rates, 0.0, atol=1e-9 * np.max(np.abs(D @ given)))
    normal, tangents = central.forces[::3], central.forces.reshape(-1, 3)[:, 1:]
    inside = np.array([law.mu for law in laws]) * normal - np.hypot(*tangents.T)
    assert np.min(inside) > 1e-6 * np.max(normal)


@pytest.mark.parametrize("kind", [Friction, Sliding])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds)
def test_friction_of_coefficient_zero_is_a_push(kind, seed):
    _, A, a = friction_problem(seed)
    D, b = A @ A.T, A @ a
    extra = () if kind is Friction else ((0.6, 0.8),)
    solution = solve(D, b, [kind(3 * k, (3 * k + 1, 3 * k + 2), 0.0, *extra) for k in range(3)])
    smooth = solve(D[::3, ::3], b[::3], pushes(3))
    np.testing.assert_allclose(solution.forces[::3], smooth.forces, atol=1e-10)
    np.testing.assert_array_equal(np.delete(solution.forces, [0, 3, 6]), 0.0)
    assert [row // 3 for row in solution.active_rows] == list(smooth.active_rows)
