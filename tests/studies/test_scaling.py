"""Claims about the scaling study: operations, agreeing solvers, what is measured and told."""

from __future__ import annotations

import json
import math

import commands
import numpy as np
import pytest
from mechanics import data_of
from page_reader import Page, brightness, shown, sticks_out

import multiarm as ma
from multiarm.dynamics.solver import batched
from multiarm.dynamics.solver.dense import solve_dense
from multiarm.dynamics.solver.node import ELIMINATED, FIRST_ARM, START, make_work
from multiarm.jit.kernels import Kernel
from multiarm.jit.simd import LANES
from multiarm.results.files import save_figure, save_page
from multiarm.studies import (
    evaluation_costs,
    scaling,
    solver_forms,
    solver_study,
    time_shares,
    timing,
)
from multiarm.studies.scaling import Plan, run_scaling
from multiarm.studies.scaling_page import disturbance, figure, render, tables
from multiarm.studies.solver_forms import Coefficients
from multiarm.studies.solver_study import (
    direct_operations,
    node_operations,
    order,
    ratio_as_written,
)
from multiarm.studies.timing import (
    fastest,
    fitted_slope,
    fitted_slopes,
    measure,
    median,
    upper_half,
)
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS

command = commands.command("scaling", 80)
TINY = Plan(kinds=("weld",), arms=(2, 3), thesis_arms=(2, 3, 5), share_arms=(2,), rounds=1)


@pytest.fixture(scope="module")
def told():
    """What a tiny study tells while it goes on."""
    return []


@pytest.fixture(scope="module")
def result(told):
    """All studies, tiny."""
    return run_scaling(TINY, lambda *news: told.append(news))


def all_tables(result):
    return [table for own in tables(result).values() for table in own]


def texts_of(result):
    """All texts of all tables."""
    return [
        text
        for table in all_tables(result)
        for text in (
            table.title,
            *table.notes,
            *(cell.text for row in table.written(False) for cell in row),
        )
    ]


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
        h_o=rng.normal(size=6),
        M=np.array([inertia(d) for _ in range(n)]),
        h=rng.normal(size=(n, d)),
        W_o=G.transpose(0, 2, 1) @ wrench,
        W=-J.transpose(0, 2, 1) @ wrench,
        c=rng.normal(size=(n, N)),
        J=J,
        wrench=wrench,
        G=G,
    )


def dense(s):
    """The independent reference on the same matrices."""
    found = solve_dense(s.M_o, s.h_o, list(s.M), list(s.h), list(s.W_o), list(s.W), list(s.c))
    return np.concatenate([found.object_acceleration, *found.joint_accelerations])


def stacked(solution):
    return np.concatenate([solution.q_o, solution.q.ravel()])


def put(array, at, value):
    array[at] = value


# What the instructions on lanes do to the first of them.
ONE_LANE = {
    "load_pack": lambda array, at: array[at],
    "store_pack": put,
    "broadcast": Counting,
    "gather_pack": lambda array, at, *_: np.ravel(array)[at],
    "min_positive": lambda a, b: (b if b < a else a) if b > 0.0 else 0.0,
    "minimum": lambda a, b: a if a < b else b,
    "sum_pack": lambda x: x + 0.0 + 0.0 + 0.0,
}


def one_arm_a_group(n, d, N):
    """Arrays for ``n`` equal arms, each of which has a group of its own."""
    work, one = make_work([d] * n, [N] * n), make_work([d], [N])
    arms, start = np.arange(n), one.groups[0, START]
    groups = np.repeat(one.groups, n, axis=0)
    groups[:, START] += arms * (one.packs.size - start)
    groups[:, FIRST_ARM:] = arms[:, None]
    size = start + n * (one.packs.size - start)
    shift = np.repeat([d, N], [LANES * d, LANES * N])
    return work._replace(
        groups=groups,
        places=one.places + arms[:, None] * shift,
        present=np.repeat(one.present, n, axis=0),
        stiffness=np.repeat(one.stiffness, n, axis=0),
        packs=np.zeros(size),
    )


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
    work = work._replace(
        **{name: counted(getattr(work, name)) for name in ("S", "packs", "present", "stiffness")}
    )
    work = work._replace(L=counted(s.M), Y=counted(s.W))
    Wo = counted(s.W_o.transpose(0, 2, 1).reshape(n * N, 6))
    q_o, q, force = (counted(np.zeros(size)) for size in (6, n * d, n * N))
    right = [counted(part) for part in (s.h_o, s.h.ravel(), s.c.ravel())]
    monkeypatch.setattr(Counting, "count", 0)
    status = batched.solve_batched(work, Wo, counted(s.M_o), *right, q_o, q, force)
    assert status == ELIMINATED
    assert Counting.count == node_operations(n, d, N)
    np.testing.assert_allclose(np.concatenate([numbers(q_o), numbers(q)]), dense(s), rtol=1e-9)


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
    system = ma.compile_system(solver_study.study_scene(arms))
    state = evaluation_costs.moving_state(system, seed=5)
    s = solver_forms.build(system, state)
    ours = ma.evaluate(system, 0.0, state)
    exact = np.concatenate([ours.object_acceleration, *ours.joint_accelerations.values()])
    force = np.concatenate(list(ours.contact_forces.values()))
    found = solver_study.solve_in_all_ways(s)
    assert {"LU", "LDL^T", "node, compiled", "node, loop", "Lilly-Orin", "McMillan"} <= set(found)
    for name, solution in found.items():
        assert np.max(np.abs(stacked(solution) - exact)) < 1e-9 * np.max(np.abs(exact)), name
        assert np.max(np.abs(solution.force.ravel() - force)) < 1e-9 * np.max(np.abs(force)), name
    assert max(solver_study.deviations(s).values()) < 1e-9


@pytest.mark.parametrize(("n", "d", "N"), [(1, 6, 1), (3, 6, 3), (4, 7, 4), (2, 5, 2)])
def test_all_solvers_solve_made_up_systems(rng, n, d, N):
    s = random_coefficients(rng, n, d, N)
    for name, solution in solver_study.solve_in_all_ways(s).items():
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
    system = ma.compile_system(solver_study.study_scene(3))
    state = evaluation_costs.moving_state(system, seed=1)
    assert np.max(np.abs(state.object_twist)) > 0.01, "terms in the velocities count"
    s = solver_forms.build(system, state)
    ma.evaluate(system, 0.0, state)
    buffers = data_of(system).arrays
    given = {"M_o": buffers.inertia, "h_o": buffers.h_o, "h": buffers.h, "c": buffers.c}
    for name, kernels in given.items():
        np.testing.assert_allclose(np.ravel(getattr(s, name)), kernels.ravel(), atol=1e-11)
    np.testing.assert_allclose(s.W_o[:, :, 0], buffers.Wo, atol=1e-12)
    np.testing.assert_allclose(s.W_o, s.G.transpose(0, 2, 1) @ s.wrench, atol=1e-14)
    np.testing.assert_allclose(s.W, -s.J.transpose(0, 2, 1) @ s.wrench, atol=1e-14)


def test_the_matrix_is_filled_alike_by_script_and_kernel(rng):
    from multiarm.studies.solver_study import _assemble_often

    s = random_coefficients(rng, 3, 5, 2)
    matrix, right = solver_forms.assemble(s)
    filled, side = np.ones(matrix.shape), np.ones(right.shape)
    _assemble_often(s.M_o, s.h_o, s.M, s.h, s.W_o, s.W, s.c, filled, side, 1)
    np.testing.assert_array_equal(filled, matrix)
    np.testing.assert_array_equal(side, right)
    np.testing.assert_array_equal(matrix, matrix.T)


# --- the thesis's table ---------------------------------------------------------------------------


def test_times_implied_by_the_thesis_fit_its_columns():
    known = {2: (22.4, 15.9), 4: (40.8, 35.9), 6: (55.9, 68.2), 8: (74.5, 122.2), 10: (92.6, 197.2)}
    found = solver_study.thesis_columns()
    assert list(found) == list(range(2, 11))
    for arms, columns in found.items():
        t1, t2 = columns["t1"], columns["t2"]
        assert t2 / t1 == pytest.approx(columns["solving"])
        assert t2 - t1 == pytest.approx(columns["saved"])
        if arms in known:
            assert (t1, t2) == pytest.approx(known[arms], abs=0.06)
    arms = np.array(list(found))
    slope = np.polyfit(arms, [columns["t1"] for columns in found.values()], 1)[0]
    assert slope == pytest.approx(9.0, abs=0.3), "t1 grows by about 9 ms an arm"


@pytest.mark.slow
def test_columns_are_those_of_the_measured_times(result):
    for row in result["thesis"]["rows"]:
        for picture, columns in row["columns"].items():
            cost = row["microseconds"][picture]
            t, t1, t2 = cost["build"], cost["node"], cost["lu"]
            again = ((t2 + t) / (t1 + t), t2 / t1, t2 - t1, t1, t2)
            assert tuple(columns.values()) == pytest.approx(again)
        counts = row["operations"]
        assert counts["ratio"] == counts["direct"] / counts["node"]
        assert max(row["deviation"].values()) < 1e-9


def test_crossover_is_where_the_ratio_passes_one():
    assert solver_study.crossover([(2, 0.5), (4, 0.5), (16, 2.0)]) == pytest.approx(8.0)
    assert solver_study.crossover([(2, 1.5), (4, 3.0)]) == 2.0
    assert solver_study.crossover([(2, 0.1), (4, 0.9)]) is None
    assert 4.0 < solver_study.crossover(
        [(n, columns["solving"]) for n, columns in solver_study.thesis_columns().items()]
    ) < 5.0  # fmt: skip


# --- how time is measured -------------------------------------------------------------------------


def test_everyone_is_measured_in_turn_and_rare_ones_rarely(monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", math.inf)
    order_of_bursts = []

    def contestant(name):
        return lambda count: order_of_bursts.append(name)

    names = ("a", "b", "slow")
    found = measure({name: contestant(name) for name in names}, 7, rare=("slow",), rare_every=3)
    assert [len(found[name]) for name in names] == [7, 7, 3]
    measured = order_of_bursts[6:]  # two calls each say how many make a burst
    assert measured[:5] == ["a", "b", "slow", "a", "b"]


def test_who_takes_long_gets_few_bursts(monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", -1.0)
    found = measure({"a": lambda count: None}, 50)
    assert len(found["a"]) == timing.FEWEST


def test_fastest_and_median_are_microseconds_a_call():
    times = {"a": np.array([3e-6, 1e-6, 2.5e-6])}
    assert fastest(times)["a"] == pytest.approx(1.0)
    assert median(times)["a"] == pytest.approx(2.5)


def test_slopes_are_exponents_and_skip_what_was_not_measured():
    sizes = [2, 4, 8, 16]
    assert fitted_slope(sizes, [7.0 * n**1.5 for n in sizes]) == pytest.approx(1.5)
    assert fitted_slope(sizes, [1.0, 2.0, 4.0, None]) == pytest.approx(1.0)
    assert fitted_slope([2], [1.0]) is None
    costs = [{"node": 7.0 * n, "lu": n**3.0, "late": None} for n in sizes]
    assert fitted_slopes(sizes, costs) == pytest.approx({"node": 1.0, "lu": 3.0, "late": None})
    assert [2, 4, 8, 16, 32, 64][upper_half(range(6))] == [16, 32, 64]
    assert [2, 3, 5][upper_half(range(3))] == [3, 5]
    assert [2][upper_half(range(1))] == [2]


# --- shares ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_parts_and_what_they_leave_make_up_the_whole(result):
    parts = ["arm terms", "contacts", "forces", "node", "state", "between"]
    for row in result["shares"]["rows"]:
        assert list(row["evaluation"]) == parts
        assert list(row["step"]) == [*parts, "stabilisation", "recording", "arithmetic", "rest"]
        assert sum(row["evaluation"].values()) == pytest.approx(row["evaluation_microseconds"])
        assert sum(row["step"].values()) == pytest.approx(row["step_cost"]["microseconds"])


def test_a_step_is_taken_apart_by_what_happens_in_it():
    evaluation = {"node": 2.0, "between": 1.0}
    cost = {"projection": 5.0, "sample": 0.5, "arithmetic": 0.25}
    step = time_shares.StepCost(
        integrator="dop853", arms=2, steps=10, evaluations=9.0, projections=2.0, samples=0.5,
        microseconds=40.0, evaluation_microseconds=3.0, overhead=40.0 / 27.0 - 1.0,
    )  # fmt: skip
    parts = time_shares.step_parts(evaluation, cost, step)
    assert parts == {
        "node": 10.0,  # five of nine evaluations are not projections
        "between": 5.0,
        "stabilisation": 10.0,
        "recording": 0.25,
        "arithmetic": 0.25,
        "rest": 14.5,
    }


def test_every_integrator_has_its_overhead(result):
    costs = {cost["integrator"]: cost for cost in result["shares"]["overheads"]}
    assert list(costs) == [*FIXED_STEP_INTEGRATORS, *ADAPTIVE_INTEGRATORS]
    for name, cost in costs.items():
        product = cost["evaluations"] * cost["evaluation_microseconds"]
        assert cost["overhead"] == pytest.approx(cost["microseconds"] / product - 1.0)
        if name in FIXED_STEP_INTEGRATORS:
            assert cost["steps"] == time_shares.FIXED_STEPS


def test_evaluations_of_a_step_are_those_that_the_run_counts(result):
    found = {cost["integrator"]: cost for cost in result["shares"]["overheads"]}["rk4"]
    system = ma.compile_system(time_shares.ring_of_arms(2, time_shares.KIND))
    duration = time_shares.FIXED_STEPS * time_shares.STEP
    run = ma.simulate(system, duration, integrator="rk4", step=time_shares.STEP)
    assert found["evaluations"] == run.statistics["evaluations"] / run.statistics["steps"]
    assert found["projections"] == run.statistics["projections"] / run.statistics["steps"]


# --- evaluations ----------------------------------------------------------------------------------


def test_exponents_are_those_of_the_largest_two_sizes(result):
    found = result["thesis"]
    small, large = found["rows"][-2:]
    for picture, slopes in found["last_slopes"].items():
        before, after = small["microseconds"][picture], large["microseconds"][picture]
        for part, slope in slopes.items():
            grown = math.log(after[part] / before[part])
            assert slope == pytest.approx(grown / math.log(large["arms"] / small["arms"]))


def test_peers_and_ours_have_the_accelerations_of_the_dense_solution(result):
    for row in result["evaluations"]["rows"]:
        errors = row["relative_error"]
        assert errors["multiarm"] < 1e-11
        assert errors["compiled"] < 1e-11
        assert errors["constraintDynamics"] < 1e-10
        assert errors["tree"] < 1e-10
        assert errors["lcaba"] < 1e-6  # as regularised
        assert set(row["microseconds"]) == set(evaluation_costs.METHODS)


def test_ours_is_compared_with_the_cheapest_peer():
    cost = {
        "multiarm": 2.0, "compiled": 1.5, "constraintDynamics": 12.0, "tree": 9.0, "lcaba": 6.0,
        "terms": 1.0, "dense": 50.0,
    }  # fmt: skip
    assert evaluation_costs.ratio_to_best_peer(cost) == 3.0
    assert evaluation_costs.ratio_to_best_peer(cost, "compiled") == 4.0
    assert evaluation_costs.ratio_to_best_peer({**cost, "lcaba": None}) == 4.5


def test_hinges_are_measured_on_request():
    found = evaluation_costs.evaluation_costs((2,), ("revolute",), 1)
    assert found["rows"][0]["relative_error"]["constraintDynamics"] < 1e-6
    assert found["exponents"]["revolute"]["multiarm"] is None, "one point has no slope"
    assert found["growth"]["revolute"] is None


@pytest.mark.slow
def test_what_would_take_all_memory_is_left_out_with_a_word(monkeypatch, tmp_path):
    monkeypatch.setattr(evaluation_costs, "free_memory", lambda: 1e5)
    found = run_scaling(Plan(("evaluations",), ("ball",), arms=(2, 3), rounds=1))
    for row in found["evaluations"]["rows"]:
        assert row["microseconds"]["lcaba"] is None
        assert row["microseconds"]["multiarm"] > 0.0
        assert row["ratio_to_best_peer"] == {"multiarm": None, "compiled": None}
    texts = texts_of(found)
    assert (
        "constraintDynamics, tree, lcaba at n = 3: not run: Pinocchio's Data would take"
        in " ".join(texts)
    )
    assert "-" in texts
    save_figure(figure(found), tmp_path / "plot.png")
    assert "not run" in render(found)


def test_memory_is_asked_of_the_machine():
    assert evaluation_costs.free_memory() > 1e6
    assert evaluation_costs.too_large_for_pinocchio(12, 1e9) == ""
    assert evaluation_costs.too_large_for_pinocchio(384, 4e9).endswith("3.8 of 4.0 GB free")


# --- plan, tables, files --------------------------------------------------------------------------


def test_progress_is_told_as_often_as_planned(result, told):
    total = TINY.measurements
    assert [news[:2] for news in told] == [(k, total) for k in range(total)]
    assert told[0][2] == "one evaluation: weld, 2 arms"
    assert "section 4.4: 5 arms" in [words for _, _, words in told]


def test_only_what_was_asked_for_is_measured():
    found = run_scaling(Plan(("rows",), rounds=1))
    assert set(found) == {"machine", "rounds", "wall_time_s", "waited", "contact_rows"}
    assert 0.0 <= found["waited"] < 1.0
    assert list(tables(found)) == ["contact_rows"]


def test_a_quiet_machine_needs_no_word():
    assert disturbance({"waited": 0.01}) == ""


def test_every_table_is_rectangular_and_names_its_study(result):
    assert set(tables(result)) == {"evaluations", "thesis", "shares", "contact_rows"}
    for table in all_tables(result):
        assert all(len(row) == len(table.columns) for row in table.rows), table.title


def test_the_thesis_stands_beside_what_was_measured(result):
    table = next(t for t in all_tables(result) if "time saved" in t.title)
    heads = [column.head for column in table.columns]
    texts = ([cell.text for cell in row] for row in table.written(False))
    columns = dict(zip(heads, zip(*texts, strict=True), strict=True))
    assert columns["total\n1995"] == ("0.98", "0.99", "1.00")
    assert columns["t2/t1\n1995"] == ("0.71", "0.77", "1.03")
    assert columns["t2-t1\n1995"] == ("-6.50", "-7.20", "1.30")
    table = next(t for t in all_tables(result) if "times of 1995" in t.title)
    assert [cell.text for cell in table.written(False)[0]][:3] == ["2", "22.4", "15.9"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_plots_are_of_the_format_of_their_name(result, tmp_path, ending, magic):
    path = tmp_path / f"scaling.{ending}"
    save_figure(figure(result), path)
    assert path.read_bytes().startswith(magic)


def test_a_result_without_a_figure_can_be_plotted_and_shown(tmp_path):
    found = run_scaling(Plan(("rows",), rounds=1))
    save_figure(figure(found), tmp_path / "rows.svg")
    assert "nothing here has a figure" in (tmp_path / "rows.svg").read_text()
    assert "tip on plane" in render(found)


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_tables_and_writes_all_files(result, monkeypatch, tmp_path):
    plans = []

    def measured(plan, progress):
        plans.append(plan)
        progress(0, 24, "one evaluation: weld, 2 arms")
        return result

    monkeypatch.setattr(scaling, "run_scaling", measured)
    files = {name: tmp_path / f"s.{name}" for name in ("json", "html", "png")}
    done = command("--json", files["json"], "--html", files["html"], "--plot", files["png"])
    assert done.exit_code == 0, done.output
    assert plans == [Plan()]
    for table in all_tables(result):
        assert table.title[:60] in done.output
    assert all(path.stat().st_size > 1000 for path in files.values())
    again = json.loads(files["json"].read_text())
    assert set(again) == {
        "machine", "rounds", "wall_time_s", "waited", "evaluations", "thesis", "shares",
        "contact_rows",
    }  # fmt: skip
    assert again["thesis"]["rows"] == result["thesis"]["rows"]


@pytest.mark.parametrize(
    ("words", "plan"),
    [
        (("--study", "thesis"), Plan(("thesis",))),
        (("--kind", "revolute", "--arms", "8,2,8"), Plan(kinds=("revolute",), arms=(2, 8))),
        (("--quick",), scaling.quick()),
        (("--quick", "--rounds", "3", "--study", "rows"), Plan(**{
            **vars(scaling.quick(("rows",))), "rounds": 3,
        })),
    ],
)  # fmt: skip
def test_options_make_the_plan(monkeypatch, words, plan):
    plans = []

    def measured(plan, progress):
        plans.append(plan)
        return {"machine": {}, "waited": 0.3}

    monkeypatch.setattr(scaling, "run_scaling", measured)
    done = command(*words)
    assert done.exit_code == 0
    assert plans == [plan]
    assert "kept this one waiting for 30 % of the time" in " ".join(done.stderr.split())


def test_a_quick_plan_is_smaller_in_every_respect():
    quick, full = scaling.quick(), Plan()
    for name in ("arms", "thesis_arms", "share_arms"):
        assert set(getattr(quick, name)) < set(getattr(full, name))
    assert quick.rounds < full.rounds
    assert quick.measurements < full.measurements
    assert full.arms[0] == 2 and full.arms[-1] == 64
    assert full.thesis_arms[:9] == tuple(range(2, 11)) and full.thesis_arms[-1] == 100


def test_the_command_measures(tmp_path):
    path = tmp_path / "s.json"
    words = ("--study", "evaluations", "--arms", "2", "--kind", "ball", "--rounds", 1)
    done = command(*words, "--json", path)
    assert done.exit_code == 0, done.output
    rows = json.loads(path.read_text())["evaluations"]["rows"]
    assert [(row["kind"], row["arms"]) for row in rows] == [("ball", 2)]
    assert "One evaluation, ball joints, in microseconds" in done.output


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("--arms", "1,2"), ("--arms", "at least 2 arms")),
        (("--arms", "2,x"), ("--arms", "'2,x'")),
        (("--plot", "figure.docx"), ("--plot", ".png, .svg, .pdf")),
        (("--html", "nowhere/page.html"), ("--html", "no folder")),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is_measured(monkeypatch, words, parts):
    monkeypatch.setattr(scaling, "run_scaling", None)
    done = command(*words)
    refusal = str(done.exception) if done.exception else done.output
    assert done.exit_code != 0
    for part in parts:
        assert part in refusal + done.output


# --- the page -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_has_every_table_and_needs_no_other_file(result):
    page = render(result)
    found = Page(page)
    assert found.sources == []
    assert found.ids >= set(tables(result))
    assert page.count("<table ") == len(all_tables(result))
    assert page.count("<svg") == 3


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_shows_every_figure_in_light_and_in_the_dark(browser, result, tmp_path, scheme):
    path = tmp_path / "page.html"
    save_page(render(result), path)
    with shown(browser, path, scheme, width=1100) as page:
        ground = brightness(page, "body", "backgroundColor")
        assert (ground > 128) == (scheme == "light")
        assert abs(ground - brightness(page, "body", "color")) > 120
        assert page.locator("section").count() == 4
        assert sticks_out(page) <= 0
        for study in ("evaluations", "thesis", "shares"):
            assert page.locator(f"#{study} svg").first.bounding_box()["width"] > 600
