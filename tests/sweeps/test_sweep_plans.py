"""Claims about plans of many runs: which values run k has, from the plan and k alone."""

from __future__ import annotations

import itertools
import pickle
import random
from pathlib import Path

import numpy as np
import pytest
from mechanics import ur5_pair
from refusals import refused
from scipy import stats
from sweep_runs import jobs_of

from multiarm.errors import SceneError, SweepError
from multiarm.scene import Scene, value_at
from multiarm.sweeps.plan import SweepPlan, make_plan
from multiarm.sweeps.spec import parse_sweep

MASS, DAMPING = "object.mass", "effects.joint_damping"
LIFT = "arms.left.base.xyz[2]"


@pytest.fixture(scope="module")
def scene():
    return ur5_pair({"kind": "weld"}, {"kind": "weld"})


# --- the grid -----------------------------------------------------------------------------------


def test_a_product_goes_through_all_combinations_the_last_path_fastest(scene):
    over = {MASS: [1.0, 2.0], DAMPING: {"linspace": [0, 1, 3]}, "name": {"choice": ["a"]}}
    plan = make_plan(scene, over, repeat=2)
    expected = [
        {MASS: mass, DAMPING: damping, "name": "a"}
        for mass, damping, _ in itertools.product([1.0, 2.0], [0.0, 0.5, 1.0], range(2))
    ]
    assert plan.spec.count == 12
    assert [run for run, _ in jobs_of(plan)] == list(range(1, 13))
    assert [values for _, values in jobs_of(plan)] == expected
    assert plan.spec.paths == (MASS, DAMPING, "name")


def test_a_zip_goes_through_all_paths_together(scene):
    over = {MASS: [1.0, 2.0, 3.0], DAMPING: {"range": [4, 10, 2]}}
    plan = make_plan(scene, over, combine="zip")
    values = [values for _, values in jobs_of(plan)]
    assert values == [{MASS: float(k), DAMPING: 2 + 2 * k} for k in (1, 2, 3)]


def test_drawn_paths_do_not_count_in_a_zip(scene):
    over = {MASS: [1.0, 2.0], LIFT: {"uniform": [0, 1]}, DAMPING: [3, 4]}
    plan = make_plan(scene, over, combine="zip", repeat=5)
    assert plan.spec.count == 10
    assert [values[DAMPING] for _, values in jobs_of(plan)] == [3] * 5 + [4] * 5


def test_several_paths_move_together(scene):
    both = f"{LIFT}, arms.right.base.xyz[2]"
    pair = "object.pose.xyz[0], object.pose.xyz[1]"
    plan = make_plan(scene, {both: [0.0, 0.1], pair: {"rows": [[0, 1], [2, 3]]}})
    assert plan.spec.count == 4
    assert plan.spec.values(4) == {
        LIFT: 0.1, "arms.right.base.xyz[2]": 0.1, "object.pose.xyz[0]": 2, "object.pose.xyz[1]": 3,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ({"linspace": [5, 50, 10]}, np.linspace(5, 50, 10)),
        ({"linspace": [0.1, 0.7, 7]}, np.linspace(0.1, 0.7, 7)),
        ({"linspace": [3, -1, 1]}, [3.0]),
        ({"logspace": [-3, 2, 6]}, np.logspace(-3, 2, 6)),
        ({"geomspace": [0.1, 10, 3]}, np.geomspace(0.1, 10, 3)),
        ({"geomspace": [2, 7, 12]}, np.geomspace(2, 7, 12)),
        ({"range": [3]}, [0, 1, 2]),
        ({"range": [7, 1, -2]}, [7, 5, 3]),
    ],
)
def test_values_that_are_gone_through_are_those_of_numpy(written, expected):
    axis = parse_sweep({"over": {MASS: written}}).over[MASS]
    np.testing.assert_allclose(list(axis.values_in_turn), expected, rtol=4e-16, atol=0)
    assert list(axis.values_in_turn)[-1] == pytest.approx(expected[-1], rel=1e-15)


def test_the_scene_of_a_run_has_its_values_and_the_run_of_the_sweep(scene):
    over = {"over": {MASS: [5.0, 7.0], "run.duration": [0.5]}, "run": {"accuracy": 1e-3}}
    plan = make_plan(scene, over, run={"output_step": 0.1})
    found = plan.scene_of(2)
    assert (value_at(found, MASS), found.run.duration, found.run.output_step) == (7.0, 0.5, 0.1)
    assert found == scene.replace(
        {MASS: 7.0, "run.duration": 0.5, "run.output_step": 0.1, "run.accuracy": 1e-3}
    )
    with refused(SweepError, "run 3"):
        plan.spec.values(3)
    # another choice of steps replaces the file's
    plan = make_plan(scene, over, run={"integrator": "rk4", "step": 1e-3})
    assert plan.scene.run.accuracy is None and plan.scene.run.step == 1e-3


# --- draws --------------------------------------------------------------------------------------

LAWS = [
    ({"uniform": [-1, 3]}, stats.uniform(-1, 4)),
    ({"normal": {"mean": 1.2, "deviation": 0.5}}, stats.norm(1.2, 0.5)),
    ({"lognormal": {"median": 20, "deviation": 0.3}}, stats.lognorm(0.3, scale=20)),
    ({"loguniform": [0.01, 100]}, stats.loguniform(0.01, 100)),
]


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
@pytest.mark.parametrize(("written", "law"), LAWS)
def test_draws_follow_their_law(written, law, sampling):
    """Kolmogorov and Smirnov would call one in 10^4 of such samples no sample of the law."""
    sweep = {"over": {MASS: written}, "repeat": 512, "seed": 3, "sampling": sampling}
    plan = SweepPlan(None, parse_sweep(sweep))
    sample = [values[MASS] for _, values in jobs_of(plan)]
    assert stats.kstest(sample, law.cdf).pvalue > 1e-4
    assert len(set(sample)) == 512


@pytest.mark.slow
def test_choices_and_whole_numbers_are_equally_likely():
    for written, values in [({"choice": ["a", [1], None]}, 3), ({"integers": [-1, 3]}, 5)]:
        plan = SweepPlan(None, parse_sweep({"over": {MASS: written}, "repeat": 3000}))
        found = [str(values[MASS]) for _, values in jobs_of(plan)]
        counts = [found.count(value) for value in sorted(set(found))]
        assert len(counts) == values
        assert stats.chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
def test_values_of_a_run_depend_on_seed_and_number_alone(scene, sampling):
    over = {MASS: [5.0, 6.0, 7.0], LIFT: {"uniform": [0, 1]}, DAMPING: {"uniform": [0, 1]}}
    plan = make_plan(scene, over, repeat=16, seed=7, sampling=sampling)
    expected = dict(jobs_of(plan))
    order = list(expected)
    random.Random(1).shuffle(order)
    elsewhere = pickle.loads(pickle.dumps(plan))
    assert {run: elsewhere.spec.values(run) for run in order} == expected
    assert dict(jobs_of(plan, range(30, 49))) == {run: expected[run] for run in range(30, 49)}
    assert dict(jobs_of(plan, [40, 3])) == {run: expected[run] for run in (40, 3)}
    # they are drawn anew at each point of the grid, and for another seed
    assert len({values[LIFT] for values in expected.values()}) == 48
    other = make_plan(scene, over, repeat=16, seed=8, sampling=sampling)
    assert all(other.spec.values(run)[LIFT] != expected[run][LIFT] for run in order)


def test_samples_belong_to_a_run_or_to_a_grid_point(scene):
    """Of the same runs: 4 of each of 2 points, 2 of each of 4."""

    def drawn(sampling, points, repeat):
        over = {MASS: {"linspace": [5, 10, points]}, LIFT: {"uniform": [0, 1]}}
        plan = make_plan(scene, over, repeat=repeat, sampling=sampling)
        return [values[LIFT] for _, values in jobs_of(plan)]

    assert drawn("random", 2, 4) == drawn("random", 4, 2)
    by_point = {sampling: drawn(sampling, 2, 4) for sampling in ("latin_hypercube", "sobol")}
    for sampling, samples in by_point.items():
        assert drawn(sampling, 3, 4)[:8] == samples
        assert drawn(sampling, 4, 2)[2:] != samples[2:]


def test_random_draws_of_neighbours_have_nothing_to_do_with_each_other():
    over = {MASS: {"normal": {"mean": 0, "deviation": 1}}, DAMPING: {"uniform": [0, 1]}}
    plan = SweepPlan(None, parse_sweep({"over": over, "repeat": 4000}))
    values = np.array([[v[MASS], v[DAMPING]] for _, v in jobs_of(plan)])
    table = np.column_stack([values[:-1], values[1:]])
    correlations = np.corrcoef(table.T)[np.triu_indices(4, 1)]
    assert np.abs(correlations).max() < 4 / np.sqrt(4000)  # four standard deviations


def test_one_more_drawn_path_at_the_end_leaves_the_others_as_they_are(scene):
    few = {LIFT: {"uniform": [0, 1]}}
    more = {**few, DAMPING: {"uniform": [0, 1]}}
    pair = [make_plan(scene, over, repeat=9, seed=1) for over in (few, more)]
    for run in range(1, 10):
        assert pair[0].spec.values(run)[LIFT] == pair[1].spec.values(run)[LIFT]


def strata(plan, path, count):
    """Which of `count` layers of (0, 1) each draw of a grid point lies in."""
    return [int(values[path] * count) for _, values in jobs_of(plan)]


def test_a_latin_hypercube_fills_every_layer_of_every_path_once_at_each_point(scene):
    over = {MASS: [5.0, 6.0], LIFT: {"uniform": [0, 1]}, DAMPING: {"uniform": [0, 1]}}
    plan = make_plan(scene, over, repeat=20, sampling="latin_hypercube", seed=2)
    for path in (LIFT, DAMPING):
        layers = strata(plan, path, 20)
        assert sorted(layers[:20]) == sorted(layers[20:]) == list(range(20))
    assert strata(plan, LIFT, 20) != strata(plan, DAMPING, 20)


def test_sobol_points_are_a_net(scene):
    """Of 2^m points in two axes every box of volume 2^-m with dyadic sides holds exactly one."""
    over = {LIFT: {"uniform": [0, 1]}, DAMPING: {"uniform": [0, 1]}}
    plan = make_plan(scene, over, repeat=64, sampling="sobol", seed=5)
    points = np.array([[v[LIFT], v[DAMPING]] for _, v in jobs_of(plan)])
    for wide in range(7):
        boxes = (points * [2**wide, 2 ** (6 - wide)]).astype(int)
        assert len({tuple(box) for box in boxes}) == 64


# --- large plans --------------------------------------------------------------------------------


def test_a_plan_has_at_most_a_million_runs(scene):
    over = {MASS: {"linspace": [1, 2, 1000]}, LIFT: {"uniform": [0, 1]}}
    plan = make_plan(scene, over, repeat=2)
    assert plan.spec.count == len(plan.spec.table) == 2000
    assert plan.spec.values(2000)[MASS] == 2.0
    with refused(SweepError, "$.over"):
        make_plan(scene, over, repeat=1001)


def test_of_a_long_axis_some_values_are_tried_the_first_and_the_last_among_them(scene, monkeypatch):
    tried = []

    replace = Scene.replace

    def counted(scene, values):
        tried.append(values)
        return replace(scene, values)

    monkeypatch.setattr(Scene, "replace", counted)
    make_plan(scene, {MASS: {"linspace": [1, 2, 10_000]}, LIFT: {"uniform": [0, 1]}})
    assert len(tried) < 40
    masses = [values[MASS] for values in tried if MASS in values]
    assert min(masses) == 1.0 and max(masses) == 2.0
    with refused(SweepError, "$.over['object.mass'].linspace"):
        make_plan(scene, {MASS: {"linspace": [1, -1, 10_000]}})


def test_code_and_files_are_those_that_scenes_of_the_sweep_name_and_no_texts_like_them(
    scene, tmp_path
):
    for file in ("egg.py", "loads.py", "name.py"):
        (tmp_path / file).touch()
    egg = {"arm": "left", "kind": f"{tmp_path}/egg.py:Egg"}
    pushes = [[{"on": "object", "function": f"{tmp_path}/loads.py:push_{k}"}] for k in range(30)]
    names = [f"{tmp_path}/name.py:{k}" for k in range(30)]
    for combine, masses in (("product", [5.0]), ("zip", list(range(1, 31)))):
        over = {MASS: masses, "effects.external_wrenches": pushes, "name": names}
        over["joints[0]"] = [egg] * len(masses)
        plan = make_plan(scene, over, combine=combine)
        assert {code.what for code in plan.code} == {
            f"the joint kind 'Egg' of {tmp_path}/egg.py",
            *(f"the function 'push_{k}' of {tmp_path}/loads.py" for k in range(30)),
        }
        assert [*plan.files] == [str(tmp_path / file) for file in ("egg.py", "loads.py")]


# --- text ---------------------------------------------------------------------------------------


def test_a_stored_plan_is_the_plan(scene):
    over = {
        MASS: np.linspace(5, 6, 3),
        (LIFT, "arms.right.base.xyz[2]"): {"uniform": (0, 1e-6)},
        "object.pose.xyz": [(0, 0, 0.5), np.array([0, 0.1, 0.5])],
        "name": ["on", "off"],
        "object.shape.box[0]": {"normal": {"mean": 1.2, "deviation": 1e-3}},
    }
    plan = make_plan(
        scene, over, repeat=2, seed=4, keep=["steps", "wall_time"], run={"duration": 2}
    )
    again = SweepPlan(plan.scene, parse_sweep(plan.spec.text()))
    assert again.spec.text() == plan.spec.text()
    assert dict(jobs_of(again)) == dict(jobs_of(plan))
    assert [column.name for column in again.spec.quantities] == ["steps"]


def test_a_file_is_read_as_the_table_in_it(scene, tmp_path):
    text = """
over:
  object.mass: {linspace: [5, 50, 10]}
  effects.joint_damping: [1e-1, 1, 10]
  "arms.left.base.xyz[2]": {uniform: [-1e-2, 0.01]}
repeat: 4
seed: 7
keep: [largest_contact_force, "quantities.py:wobble"]
run: {duration: 1.0}
"""
    (tmp_path / "sweep.yaml").write_text(text)
    (tmp_path / "quantities.py").write_text("def wobble(trajectory):\n    return 1.0\n")
    plan = make_plan(scene, tmp_path / "sweep.yaml", seed=8)
    assert (plan.spec.count, plan.spec.seed, plan.scene.run.duration) == (120, 8, 1.0)
    assert plan.spec.values(120)[DAMPING] == 10 and plan.spec.values(1)[DAMPING] == 0.1
    assert [column.name for column in plan.spec.quantities] == [
        "largest_contact_force",
        "wobble",
    ]
    assert str(tmp_path / "quantities.py:wobble") in plan.spec.text()


# --- what is wrong ------------------------------------------------------------------------------


def test_all_faults_are_told_at_once_each_at_its_place(scene, tmp_path):
    (tmp_path / "bad.yaml").write_text("""
over:
  object.mas: [1]
  object.mass: [5, -1, heavy]
  effects.joint_damping: {linspace: [-1, 1, 500]}
  "arms.rigth.base.xyz[2]": {uniform: [0, 1]}
  "arms.left.base.xyz[2]": {uniform: [1, 0]}
  gravity: {linspce: [1, 2, 3]}
  a..b: [1]
combine: zipp
seed: -1
keep: [drift, "nofile.py:f"]
run: {duraton: 1}
extra: 1
""")
    with pytest.raises(SweepError) as caught:
        make_plan(scene, tmp_path / "bad.yaml")
    lines = str(caught.value).splitlines()
    assert lines[0] == f"{tmp_path / 'bad.yaml'}: {len(lines) - 1} faults:"
    beginnings = [
        "$.over['object.mas']: unknown key 'mas'; did you mean 'mass'?",
        "$.over['object.mass'][1]: must be greater than 0, got -1",
        "$.over['object.mass'][2]: must be a number, got 'heavy'",
        "$.over['effects.joint_damping'].linspace: the value -1.0: must not be negative",
        "$.over['arms.rigth.base.xyz[2]']: unknown key 'rigth'; did you mean 'right'?",
        "$.over['arms.left.base.xyz[2]'].uniform: must run from a smaller to a larger number",
        "$.over.gravity.linspce: unknown key 'linspce'; did you mean 'linspace'?",
        "$.over['a..b']: 'a..b' is no path; write one as 'object.mass'",
        "$.combine: unknown value 'zipp'; did you mean 'zip'?",
        "$.seed: must be at least 0, got -1",
        "$.keep[0]: unknown quantity 'drift'; ",
        f"$.keep: cannot load the function '{tmp_path}/nofile.py:f': there is no file",
        "$.run.duraton: unknown key 'duraton'; did you mean 'duration'?",
        "$.extra: unknown key 'extra'; ",
    ]
    assert len(caught.value.faults) == len(beginnings)
    for beginning in beginnings:
        assert any(fault.startswith(beginning) for fault in caught.value.faults), beginning
    assert caught.value.source == str(tmp_path / "bad.yaml")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


@pytest.mark.parametrize(
    "written",
    [
        {"linspace": [1, 2, 1e30]},
        {"range": [1, 10**30]},
        {"range": [10**12]},
        {"integers": [1, 1e300]},
        {"lognormal": {"median": 1.0, "deviation": 1000}},
        {"normal": None},
        {"lognormal": None},
        {"linspace": [1, 2]},
        {"linspace": [1, 2, 2.5]},
        {"linspace": [1, 2, 0]},
        {"linspace": [1, "x", 3]},
        {"logspace": [1, 400, 3]},
        {"geomspace": [0, 1, 3]},
        {"loguniform": [0, 1]},
        {"range": [0.5, 2]},
        {"range": [2, 1]},
        {"integers": [0.5, 2]},
        {"normal": {"mean": 1}},
        {"normal": {"mean": 1, "deviation": 0}},
        {"uniform": [0, 1], "choice": [1]},
        {},
        [],
        5.0,
        [object()],
        {"rows": [[1, 2], [3]]},
    ],
)  # fmt: skip
def test_an_invalid_axis_is_reported_with_the_remedy(scene, written):
    with refused(SweepError, "$.over['object.mass']"):
        make_plan(scene, {MASS: written})


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"over": {}}, "$.over"),
        ({"over": {MASS: [1, 2], DAMPING: [1]}, "combine": "zip"},
         "$.combine"),
        ({"over": {MASS: [1]}, "repeat": 3}, "$.repeat"),
        ({"over": {MASS: {"linspace": [1, 2, 10**5]}, DAMPING: {"range": [10**5]}}},
         "$.over"),
        ({"over": {MASS: [1], f"{MASS},{DAMPING}": [1]}}, "$.over"),
        ({"over": {MASS: [1], "object": [{}]}}, "$.over"),
        ({"over": {MASS: [1]}, "keep": ["steps", "steps"]}, "$.keep"),
        ({"over": {MASS: [1]}, "keep": [{"function": "a.py:f", "name": "2 x"}]},
         "'2 x'"),
        ({"over": {MASS: [1]}, "keep": [3]}, "$.keep[0]"),
        ({"over": {MASS: [1]}, "run": {"step": 1e-3}}, "$.run"),
        ({"over": {MASS: [1]}, "run": 3}, "$.run"),
        ({"over": {MASS: {"uniform": [1, 2]}}, "sampling": "sobol"},
         "$.sampling"),
        # a robot without the tip that the scene names: the fault lies at the tip
        ({"over": {"arms.left.robot": ["ur5", "planar_3r"]}},
         "arms.left.robot"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_told(scene, changes, place):
    with refused(SweepError, place):
        make_plan(scene, changes)


def test_values_that_are_right_only_together_are_right(scene):
    over = {"run.integrator": ["rk4", "semi_implicit_euler"], "run.step": [1e-3]}
    assert make_plan(scene, over).scene_of(2).run.integrator == "semi_implicit_euler"
    with refused(SweepError, "$.over['run.integrator']"):
        make_plan(scene, {"run.integrator": ["rk4"]})


@pytest.mark.parametrize(
    "content",
    [
        None,
        b"\xff\xfe\x00",
        b"over: {a: [1, 2",
        b"over: {a: [1]}\nover: {b: [1]}",
        b"- 1",
        b"",
    ],
)
def test_a_file_that_is_no_sweep_is_told(scene, content, tmp_path):
    (tmp_path / "other.yaml").touch()
    if content is not None:
        (tmp_path / "sweep.yaml").write_bytes(content)
    with refused(SweepError, "sweep.yaml"):
        make_plan(scene, tmp_path / "sweep.yaml")


@pytest.mark.parametrize("over", [[1, 2], 3, ["object.mass"], False], ids=repr)
def test_what_is_neither_a_file_nor_a_table_is_refused(scene, over):
    with refused(SweepError, "$.over: "):
        make_plan(scene, over)


def test_a_sweep_needs_a_scene(scene, tmp_path):
    with refused(SweepError, "scene"):
        make_plan(3, {MASS: [1]})
    with refused(SceneError, "none.yaml"):
        make_plan(Path(tmp_path / "none.yaml"), {MASS: [1]})
    with refused(SweepError, "$.over"):
        make_plan(scene, None)
