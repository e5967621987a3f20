"""Claims about the study of section 4.4: operations, solvers that agree, the thesis's table."""

from __future__ import annotations

import efficiency
import numpy as np
import pytest
import solver_forms
from efficiency import direct_operations, node_operations, order, ratio_as_written
from evaluations import moving_state
from mechanics import data_of
from solver_forms import Coefficients
from timing import fitted_slope

import multiarm as ma
from multiarm.dynamics.solver import batched
from multiarm.dynamics.solver.dense import solve_dense
from multiarm.dynamics.solver.node import BlockGroup, make_work
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import Kernel
from multiarm.jit.rows import fields_of
from multiarm.jit.simd import LANES


@pytest.fixture(scope="module")
def study():
    """The study of few arms, measured once."""
    return efficiency.solver_study((2, 3, 12), rounds=1).set_index("arms")


# --- counted operations ---------------------------------------------------------------------------


class Counting(float):
    """A number that counts what is done with it."""

    count = 0

    def __neg__(self):
        return Counting(-float(self))


def counting(operator):
    """The operator of numbers that counts itself."""

    def operate(self, other):
        Counting.count += 1
        return Counting(operator(self, float(other)))

    return operate


for sign in ("add", "sub", "mul", "truediv", "radd", "rsub", "rmul", "rtruediv"):
    setattr(Counting, f"__{sign}__", counting(getattr(float, f"__{sign}__")))


def counted(array):
    return np.frompyfunc(Counting, 1, 1)(np.asarray(array, dtype=float))


def numbers(array):
    return np.array([float(x) for x in np.ravel(array)])


def random_coefficients(rng, n, d, N):
    """A system of made-up matrices that fit each other."""

    def inertia(size):
        A = rng.normal(size=(size, size))
        return A @ A.T + size * np.eye(size)

    J, wrench = rng.normal(size=(n, 6, d)), rng.normal(size=(n, 6, N))
    G = np.eye(6) + 0.3 * rng.normal(size=(n, 6, 6))
    return Coefficients(
        M_o=inertia(6),
        f_o=rng.normal(size=6),
        M=np.array([inertia(d) for _ in range(n)]),
        f_j=rng.normal(size=(n, d)),
        W_o=G.transpose(0, 2, 1) @ wrench,
        W=-J.transpose(0, 2, 1) @ wrench,
        c=rng.normal(size=(n, N)),
        J=J,
        wrench=wrench,
        G=G,
    )


def dense(s):
    """The independent reference on the same matrices."""
    found = solve_dense(s.M_o, s.f_o, list(s.M), list(s.f_j), list(s.W_o), list(s.W), list(s.c))
    return np.concatenate([found.object_acceleration, *found.joint_accelerations])


def stacked(solution):
    return np.concatenate([solution.a_o, solution.q.ravel()])


class FirstLanes:
    """The packs of a vector, from one on, of which only the first lanes are read and set."""

    def __init__(self, array, first):
        self.array, self.first = array, first

    def __add__(self, k):
        return FirstLanes(self.array, self.first + k)

    def __getitem__(self, k):
        return self.array[LANES * (self.first + k)]

    def __setitem__(self, k, value):
        self.array[LANES * (self.first + k)] = value


# What the instructions on lanes do to the first of them.
ONE_LANE = {
    "packs_of": FirstLanes,
    "broadcast": Counting,
    "gather_pack": lambda array, at, *_: np.ravel(array)[at],
    "min_positive": lambda a, b: (b if b < a else a) if b > 0.0 else 0.0,
    "minimum": lambda a, b: a if a < b else b,
    "sum_pack": lambda x: x + 0.0 + 0.0 + 0.0,
}


def one_arm_a_group(n, d, N):
    """Arrays for ``n`` equal arms, each of which has a group of its own; their floats count."""
    work, one = make_work([d] * n, [N] * n), make_work([d], [N]).groups
    arms, lanes = np.arange(n), np.arange(n)[:, None]
    group = np.repeat(one.group, n, axis=0)
    fields_of(BlockGroup, group).first[:] = arms * (one.tables.size // LANES)
    groups = one._replace(
        group=group,
        blocks=np.repeat(lanes, LANES, axis=1),
        joint_index=one.joint_index + d * lanes,
        contact_index=one.contact_index + N * lanes,
        contact_present=np.repeat(one.contact_present, n, axis=0),
        block_present=np.repeat(one.block_present, n, axis=0),
        stiffness=np.repeat(one.stiffness, n, axis=0),
        tables=np.zeros(n * one.tables.size),
    )
    floats = {k: counted(v) for k, v in groups._asdict().items() if v.dtype == float}
    return work._replace(groups=groups._replace(**floats))


@pytest.mark.parametrize(("n", "d", "N"), [(1, 6, 1), (2, 6, 1), (4, 6, 1), (3, 4, 3), (2, 7, 6)])
def test_node_operations_are_those_that_the_time_loop_performs(monkeypatch, rng, n, d, N):
    """The very kernels, run as plain Python on numbers that count, in one lane."""
    for name, thing in list(vars(batched).items()):
        if isinstance(thing, Kernel):
            monkeypatch.setattr(batched, name, thing.py_func)
        if name in ONE_LANE:
            monkeypatch.setattr(batched, name, ONE_LANE[name])
    s = random_coefficients(rng, n, d, N)
    work = one_arm_a_group(n, d, N)
    work = work._replace(S=counted(work.S), M=counted(s.M), W=counted(s.W))
    W_o = counted(s.W_o.transpose(0, 2, 1).reshape(n * N, 6))
    a_o, q, force = (counted(np.zeros(size)) for size in (6, n * d, n * N))
    right = [counted(part) for part in (s.f_o, s.f_j.ravel(), s.c.ravel())]
    monkeypatch.setattr(Counting, "count", 0)
    status = batched.solve_batched(work, W_o, counted(s.M_o), *right, a_o, q, force)
    assert status == OK
    assert Counting.count == node_operations(n, d, N)
    np.testing.assert_allclose(np.concatenate([numbers(a_o), numbers(q)]), dense(s), rtol=1e-9)


@pytest.mark.parametrize(("n", "d", "N"), [(1, 1, 1), (2, 6, 1), (2, 3, 2)])
def test_direct_operations_are_those_of_gaussian_elimination(rng, monkeypatch, n, d, N):
    matrix, right = solver_forms.assemble(random_coefficients(rng, n, d, N))
    exact = np.linalg.solve(matrix, right)
    swap, A, x = pivoted(matrix), counted(matrix), counted(right)
    A, x = A[swap], x[swap]
    k = len(x)
    assert k == order(n, d, N)
    monkeypatch.setattr(Counting, "count", 0)
    for j in range(k):
        for i in range(j + 1, k):
            A[i, j] = A[i, j] / A[j, j]
            for m in range(j + 1, k):
                A[i, m] = A[i, m] - A[i, j] * A[j, m]
    for j in range(k):
        for i in range(j):
            x[j] = x[j] - A[j, i] * x[i]
    for j in reversed(range(k)):
        for i in range(j + 1, k):
            x[j] = x[j] - A[j, i] * x[i]
        x[j] = x[j] / A[j, j]
    assert Counting.count == direct_operations(n, d, N)
    np.testing.assert_allclose(numbers(x), exact, rtol=1e-8)


def pivoted(matrix):
    """The order of rows that partial pivoting chooses."""
    from scipy.linalg import lu

    return np.argmax(lu(matrix)[0], axis=0)


@pytest.mark.parametrize(
    ("arms", "ratio", "digit"),
    [(2, 6, 1), (4, 15, 1), (6, 28, 1), (8, 46, 1), (10, 68, 1), (20, 239, 1), (100, 5.4e3, 100)],
)
def test_operations_as_written_have_the_known_ratios(arms, ratio, digit):
    assert abs(ratio_as_written(arms) - ratio) < digit


def test_operations_grow_linearly_and_with_the_cube():
    arms = [200, 400, 800]
    assert fitted_slope(arms, [node_operations(n) for n in arms]) == pytest.approx(1.0, abs=1e-2)
    assert fitted_slope(arms, [direct_operations(n) for n in arms]) == pytest.approx(3.0, abs=1e-2)


# --- the solvers of section 4.4 -------------------------------------------------------------------


@pytest.mark.parametrize("arms", [2, 3, 7])
def test_all_solvers_give_equal_accelerations_and_forces(arms):
    system = ma.compile_system(efficiency.study_scene(arms))
    state = moving_state(system, seed=5)
    s = solver_forms.build(system, state)
    ours = ma.evaluate(system, 0.0, state)
    exact = np.concatenate([ours.object_acceleration, *ours.joint_accelerations.values()])
    force = np.concatenate(list(ours.contact_forces.values()))
    found = efficiency.solve_in_all_ways(s)
    assert {"LU", "LDL^T", "node, compiled", "node, loop", "Lilly-Orin", "McMillan"} <= set(found)
    for name, solution in found.items():
        assert np.max(np.abs(stacked(solution) - exact)) < 1e-9 * np.max(np.abs(exact)), name
        assert np.max(np.abs(solution.force.ravel() - force)) < 1e-9 * np.max(np.abs(force)), name
    assert max(efficiency.deviations(s).values()) < 1e-9


@pytest.mark.parametrize(("n", "d", "N"), [(1, 6, 1), (3, 6, 3), (4, 7, 4), (2, 5, 2)])
def test_all_solvers_solve_made_up_systems(rng, n, d, N):
    s = random_coefficients(rng, n, d, N)
    for name, solution in efficiency.solve_in_all_ways(s).items():
        np.testing.assert_allclose(stacked(solution), dense(s), rtol=1e-7, atol=1e-8, err_msg=name)


def test_an_arm_that_cannot_follow_is_no_obstacle_when_its_forces_are_solved_together(rng):
    s = random_coefficients(rng, 3, 6, 2)
    s.J[0], s.W[0] = 0.0, 0.0  # K = 0: this arm does not give way at all
    np.testing.assert_allclose(stacked(solver_forms.mcmillan(s, 1)), dense(s), atol=1e-8)
    with pytest.raises(np.linalg.LinAlgError):
        solver_forms.node_loop(s)


@pytest.mark.parametrize("together", [0, 1, 4])
def test_any_number_of_arms_may_be_solved_together(rng, together):
    s = random_coefficients(rng, 4, 6, 1)
    np.testing.assert_allclose(stacked(solver_forms.mcmillan(s, together)), dense(s), atol=1e-9)


def test_the_script_builds_the_same_coefficients_as_the_kernels():
    system = ma.compile_system(efficiency.study_scene(3))
    state = moving_state(system, seed=1)
    assert np.max(np.abs(state.object_twist)) > 0.01, "terms in the velocities count"
    s = solver_forms.build(system, state)
    ma.evaluate(system, 0.0, state)
    data = data_of(system).arrays
    given = {
        "M_o": data.bodies.object_inertia,
        "f_o": data.forces.f_o,
        "f_j": data.forces.f_j,
        "c": data.rows.c,
    }
    for name, kernels in given.items():
        np.testing.assert_allclose(np.ravel(getattr(s, name)), kernels.ravel(), atol=1e-11)
    np.testing.assert_allclose(s.W_o[:, :, 0], data.rows.W_o, atol=1e-12)
    np.testing.assert_allclose(s.W_o, s.G.transpose(0, 2, 1) @ s.wrench, atol=1e-14)
    np.testing.assert_allclose(s.W, -s.J.transpose(0, 2, 1) @ s.wrench, atol=1e-14)


# --- the thesis's table ---------------------------------------------------------------------------


def test_times_implied_by_the_thesis_fit_its_columns():
    """``t1 = saved / (solving - 1)``; both are rounded, near 5 arms to few digits."""
    thesis = efficiency.THESIS
    assert list(thesis.index) == list(range(2, 11))
    t1 = thesis["saved_1995_ms"] / (thesis["solving_1995"] - 1.0)
    known = [(2, 22.4, 15.9), (4, 40.8, 35.9), (6, 55.9, 68.2), (8, 74.5, 122.2), (10, 92.6, 197.2)]
    for arms, node, direct in known:
        assert t1[arms] == pytest.approx(node, abs=0.06)
        assert t1[arms] * thesis["solving_1995"][arms] == pytest.approx(direct, abs=0.06)
    slope = np.polyfit(t1.index, t1, 1)[0]
    assert slope == pytest.approx(9.0, abs=0.3), "t1 grows by about 9 ms an arm"


@pytest.mark.slow
def test_ratios_are_those_of_the_measured_times(study):
    for way in efficiency.WAYS:
        t, t1, t2 = study[f"build_{way}_us"], study[f"node_{way}_us"], study["lu_us"]
        np.testing.assert_allclose(study[f"solving_{way}"], t2 / t1)
        np.testing.assert_allclose(study[f"total_{way}"], (t2 + t) / (t1 + t))
    assert study["deviation"].max() < 1e-9


def test_crossover_is_where_the_ratio_passes_one():
    assert efficiency.crossover([2, 4, 16], [0.5, 0.5, 2.0]) == pytest.approx(8.0)
    assert efficiency.crossover([2, 4], [1.5, 3.0]) == pytest.approx(2.0)
    assert efficiency.crossover([2, 4], [0.1, 0.9]) is None
    thesis = efficiency.THESIS["solving_1995"]
    assert 4.0 < efficiency.crossover(thesis.index, thesis) < 5.0


@pytest.mark.slow
def test_the_table_has_the_thesis_beside_what_was_measured(study):
    assert study["total_1995"].tolist() == pytest.approx([0.98, 0.99, np.nan], nan_ok=True)
    assert study["solving_1995"].tolist() == pytest.approx([0.71, 0.77, np.nan], nan_ok=True)
    assert study["node_operations"].tolist() == [node_operations(n) for n in study.index]
