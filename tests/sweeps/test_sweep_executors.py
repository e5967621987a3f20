"""Claims about who carries out many runs: the same rows whoever it is, and none is lost."""

from __future__ import annotations

import inspect
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
import weakref
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas
import pytest
from joblib.externals.loky import process_executor
from mechanics import ur5_pair
from refusals import refused
from repository import SCENES
from sweep_runs import (
    FUNCTIONS,
    GRIP,
    KEEP,
    LIFT,
    MASS,
    MEASURED,
    OVER,
    RUN,
    jobs_of,
    repeatable,
    same,
    statuses,
)
from threadpoolctl import threadpool_info, threadpool_limits

import multiarm as ma
from multiarm.errors import SweepError
from multiarm.sweeps import executors
from multiarm.sweeps import run as runs
from multiarm.sweeps.executors import run_here, run_in_processes
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.run import Context, simulate_run
from multiarm.threads import one_thread

NOTES = """
from pathlib import Path

def noted(trajectory):
    with open(Path(__file__).parent / "notes", "a") as notes:
        notes.write("x")
    return 1.0
"""


@pytest.fixture(scope="module")
def scene():
    return ur5_pair({"kind": "weld"}, {"kind": "weld"})


@pytest.fixture(scope="module")
def plan(scene):
    return make_plan(scene, OVER, repeat=4, seed=7, keep=KEEP, run=RUN)


@pytest.fixture(scope="module")
def expected(plan):
    return repeatable(run_here(Context.of(plan), jobs_of(plan)))


# --- a run --------------------------------------------------------------------------------------


def test_a_run_does_not_depend_on_postures_of_the_scene_that_is_swept(tmp_path):
    """Postures that are open are found for each run alone, as for its trajectory."""
    scene = ma.Scene(
        gravity=[0, 0, -9.81],
        object={"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 2.0, "pose": {"xyz": [0, 0, 0.4]}},
        arms={"left": {"robot": "panda", "base": {"xyz": [0.5, 0.2, 0]}}},
        joints=[{"arm": "left", "kind": "ball", "at": {"xyz": [0, 0, 0.1], "rpy": [np.pi, 0, 0]}}],
    )
    asked = {"over": {"object.pose.xyz[0]": [0.01, 0.02]}, "certificate": False}
    asked["keep"] = ["final_x", "final_z"]
    sweep = ma.sweep(scene, asked, out=tmp_path / "s.sweep", workers=1, **RUN)
    again = [sweep.trajectory(run).object_position[-1, [0, 2]] for run in (1, 2)]
    np.testing.assert_array_equal(sweep.table[asked["keep"]], again)


@pytest.mark.slow
def test_a_row_has_the_numbers_of_the_run_of_a_scene_that_is_written_so(scene, plan, expected):
    for run in (1, 12):
        values = plan.spec.values(run)
        own = scene.replace(
            object={**vars(scene.object), "mass": values[MASS]},
            arms={
                **scene.arms,
                "left": {**vars(scene.arms["left"]), "base": {"xyz": [-1.1, 0, values[LIFT]]}},
            },
            run=RUN,
        )
        alone = ma.simulate(ma.compile_system(own))
        quantities = {
            "final_x": alone.object_position[-1, 0],
            "final_z": alone.object_position[-1, 2],
            "largest_contact_force": max(alone.summary()["contact_force_max_N"].values()),
            "energy_balance": np.abs(alone.energy_balance).max(),
            "estimated_error": alone.certificate["estimated_error"]["position_m"],
        }
        assert expected[run - 1] == {
            "run": run, "status": alone.status, "message": alone.message, **quantities,
            "wall_time": 0.0, "worker": "",
        }  # fmt: skip
        again = simulate_run(plan.scene_of(run), certificate=True)
        np.testing.assert_array_equal(again.read("object/position"), alone.object_position)
    heights = {row["final_z"] for row in expected}
    assert len(heights) == 12  # so that a mix-up would be seen


@pytest.mark.slow
def test_a_run_does_not_depend_on_those_before_it(scene, plan, expected):
    backwards = run_here(Context.of(plan), jobs_of(plan)[::-1])
    assert repeatable(backwards) == expected
    lighter = make_plan(scene.replace(gravity=None), OVER, repeat=4, seed=7, keep=KEEP, run=RUN)
    between = [job for pair in zip(jobs_of(plan), jobs_of(lighter), strict=True) for job in pair]
    contexts = Context.of(plan), Context.of(lighter)
    mixed = [runs.run(contexts[k % 2], *job) for k, job in enumerate(between)]
    assert [same(row) for row in mixed[::2]] == expected
    assert mixed[0]["final_z"] != mixed[1]["final_z"]
    alone = [runs.run(Context.of(plan), *job) for job in jobs_of(plan, [1, 2])]
    assert list(map(same, alone)) == expected[:2]


def test_threads_of_a_worker_do_not_disturb_each_other(plan, expected):
    shared, rows = Context.of(plan), []

    def carry_out(jobs):
        rows.extend(runs.run(shared, *job) for job in jobs)

    halves = jobs_of(plan, range(1, 7)), jobs_of(plan, range(7, 13))
    threads = [threading.Thread(target=carry_out, args=(half,)) for half in halves]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert repeatable(rows) == expected


def test_runs_at_the_same_time_leave_the_threads_of_linear_algebra_as_they_were():
    """The run that began first ends first: it must not take the limit of the second away."""

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with threadpool_limits(3, user_api="blas"):
        before = threads()
        first, second = one_thread(), one_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        during = threads()
        second.__exit__(None, None, None)
        assert (before, during, threads()) == ({3}, {1}, {3})


def test_a_run_that_fails_is_a_row_and_the_others_go_on(scene):
    def fussy(trajectory):
        return 1.0 / (trajectory.scene.object.mass - 10.0)

    over = {GRIP: [None, {"xyz": [-3.0, 0, 0]}], MASS: [5.0, 10.0, 20.0]}
    plan = make_plan(scene, over, keep=["steps", fussy], run=RUN)
    rows = list(run_here(Context.of(plan), jobs_of(plan)))
    assert [row["status"] for row in rows] == ["completed", "failed", "completed"] + ["failed"] * 3
    assert "quantity 'fussy' raised ZeroDivisionError: float division by zero" in rows[1]["message"]
    assert rows[1]["steps"] > 0 and rows[1]["fussy"] is None
    assert rows[3]["message"].startswith("the run could not begin: ")
    assert "steps" not in rows[3]


def test_quantities_may_have_the_names_of_other_columns(scene, tmp_path):
    def seven(trajectory):
        return 7.0

    names = ["run", "status", "message", "wall_time", "worker"]
    keep = [{"function": seven, "name": name} for name in names]
    made = ma.sweep(scene, {MASS: [5.0]}, keep=keep, out=tmp_path / "s.sweep", workers=1, **RUN)
    assert (made.table["run"].tolist(), made.status_counts) == ([1], {"completed": 1})
    assert made.table["worker"][0].endswith(f":{os.getpid()}") and made.table["wall_time"][0] != 7.0
    assert made.table[[f"quantity {name}" for name in names]].values.tolist() == [[7.0] * 5]
    assert [spread.largest for spread in made.summary().spreads] == [7.0] * 5


def test_a_scene_that_cannot_be_compiled_is_no_trouble_for_runs_that_can(scene):
    broken = scene.replace({GRIP: {"xyz": [-3.0, 0, 0]}})
    plan = make_plan(broken, {GRIP: [None, {"xyz": [-3.0, 0, 0]}]}, keep=["steps"], run=RUN)
    rows = list(run_here(Context.of(plan), jobs_of(plan)))
    assert [row["status"] for row in rows] == ["completed", "failed"]
    assert "does not satisfy the joint of arm 'left'" in rows[1]["message"]
    assert "steps" not in rows[1]


def test_another_version_of_the_program_is_refused(plan, monkeypatch):
    begun = Context.of(plan)
    monkeypatch.setattr(runs, "program_version", lambda: "0.0.1")
    with refused(SweepError, "worker "):
        runs.run(begun, *jobs_of(plan, [1])[0])


# --- processes ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_worker_that_ends_as_work_comes_is_no_error_where_warnings_are(plan):
    """It would end the thread of the library that hands out the work; the sweep waited for ever."""

    warning = "A worker stopped while some jobs were given to the "
    assert warning in inspect.getsource(process_executor)

    def warn() -> None:
        warnings.warn(warning, UserWarning, stacklevel=1)

    rows = run_in_processes(Context.of(plan), jobs_of(plan)[:4], 2)
    next(rows)
    warn()
    assert len(list(rows)) == 3
    with pytest.raises(UserWarning):
        warn()


@pytest.mark.slow
def test_runs_of_a_dead_worker_are_done_again_and_one_that_kills_every_worker_is_a_row(
    scene, tmp_path
):
    """One worker is asked for: its runs have a process of their own all the same."""
    (tmp_path / "own.py").write_text(FUNCTIONS)
    keep = [f"{tmp_path}/own.py:{name}" for name in ("once", "always")]
    plan = make_plan(scene, {MASS: [5.0, 10.0, 20.0, 30.0]}, keep=keep, run=RUN)
    ended = statuses(run_in_processes(Context.of(plan), jobs_of(plan), 1))
    assert (tmp_path / "died").exists()
    assert [ended[run][0] for run in (1, 2, 3, 4)] == ["completed", "failed"] + ["completed"] * 2
    assert ended[2][1].startswith("its worker died every time")


@pytest.mark.slow
def test_a_single_run_whose_worker_died_is_tried_once_more(scene, tmp_path):
    (tmp_path / "own.py").write_text(FUNCTIONS)
    plan = make_plan(scene, {MASS: [20.0]}, keep=[f"{tmp_path}/own.py:once"], run=RUN)
    ended = statuses(run_in_processes(Context.of(plan), jobs_of(plan), 1))
    assert (tmp_path / "died").exists()
    assert ended[1][0] == "completed"


@pytest.mark.parametrize(
    "deaths, lost", [({}, []), ({2: 2}, []), ({2: 9}, [2]), ({1: 9, 4: 2}, [1])]
)
def test_a_run_is_lost_when_its_worker_dies_twice_alone(plan, monkeypatch, deaths, lost):
    """The first death may be that of the processes in which it waited behind another run."""
    left = dict(deaths)

    def until_a_worker_dies(context, jobs, workers):
        under_way = [*jobs]
        for job in under_way:
            if left.get(job[0], 0):
                left[job[0]] -= 1
                return under_way[under_way.index(job) :]
            yield {"run": job[0], "status": "completed", "message": ""}
        return []

    monkeypatch.setattr(executors.advance, "is_cached", lambda: True)
    monkeypatch.setattr(executors, "_until_a_worker_dies", until_a_worker_dies)
    ended = statuses(run_in_processes(Context.of(plan), jobs_of(plan), 2))
    assert [run for run in sorted(ended) if ended[run][0] == "failed"] == lost
    assert set(ended) == {number for number, _ in jobs_of(plan)}


def test_a_function_that_leaves_the_program_is_a_row_that_says_so(scene, tmp_path):
    def leaving(trajectory):
        raise SystemExit(3)

    asked = {"over": {MASS: [5.0, 10.0]}, "certificate": False}
    found = ma.sweep(scene, asked, out=tmp_path / "s.sweep", keep=[leaving], workers=1, **RUN)
    assert found.status_counts == {"failed": 2}
    assert "SystemExit" in found.table["message"][1]


def test_a_cluster_that_does_not_answer_costs_no_rows(scene, tmp_path, monkeypatch):
    """Not even when the sweep shall begin anew."""

    def silent(dask):
        raise SweepError("the cluster does not answer")

    out = tmp_path / "s.sweep"
    asked = {"over": {MASS: [5.0, 10.0]}, "certificate": False}
    ma.sweep(scene, asked, out=out, workers=1, **RUN)
    monkeypatch.setattr("multiarm.sweeps.executors.connected", silent)
    with pytest.raises(SweepError):
        ma.sweep(scene, asked, out=out, dask="tcp://127.0.0.1:1", resume=False, **RUN)
    assert len(ma.load_sweep(out)) == 2


@pytest.fixture
def by_file(scene, tmp_path):
    """The scene with an arm from a file beside it, which is named by a relative path."""
    import shutil

    from multiarm.scene import dump_scene, find_robot, load_scene

    shutil.copy(find_robot("textbook_6r").urdf, tmp_path / "own.urdf")
    text = dump_scene(ma.load_scene(SCENES / "corner_grippers_block.yaml"))
    (tmp_path / "scene.yaml").write_text(text)
    return load_scene(tmp_path / "scene.yaml"), tmp_path / "own.urdf"


def own_arm(scene, urdf):
    """The left arm, from a file."""
    table = scene.arms["left"].model_dump(mode="json", exclude_defaults=True)
    del table["robot"]
    return {**table, "urdf": urdf}


@pytest.mark.slow
def test_named_files_start_at_the_scenes_folder_and_another_text_makes_another_sweep(
    by_file, tmp_path
):
    scene, urdf = by_file
    over = {"arms.left": [own_arm(scene, "own.urdf")], MASS: [14.0, 15.0]}
    asked = {"over": over, "certificate": False, "keep": ["final_z"]}
    out = tmp_path / "s.sweep"
    found = ma.sweep(scene, asked, out=out, workers=2, **RUN)
    assert found.status_counts == {"completed": 2}
    assert ma.sweep(scene, asked, out=out, workers=1, **RUN).complete  # nothing else changed
    urdf.write_text(urdf.read_text().replace("</robot>", "<!-- another -->\n</robot>"))
    with refused(SweepError, "own.urdf"):
        ma.sweep(scene, asked, out=out, workers=1, **RUN)
    with pytest.warns(UserWarning, match=r"may give other numbers than its row has: the file"):
        found.trajectory(1)


def test_a_run_is_simulated_again_without_a_word_when_only_functions_are_another_ones(
    scene, tmp_path
):
    """A trajectory does not depend on what is kept of it."""
    asked = {"over": {MASS: [5.0]}, "certificate": False}
    kept = [lambda trajectory: 1.0]
    found = ma.sweep(scene, asked, out=tmp_path / "s.sweep", keep=kept, workers=1, **RUN)
    assert ma.load_sweep(tmp_path / "s.sweep").trajectory(1).status == "completed"
    assert found.trajectory(1).status == "completed"


CALLER = """
from mechanics import ur5_pair
from sweep_runs import jobs_of
from multiarm.sweeps.executors import run_in_processes
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.run import Context
weld = {"kind": "weld"}
over, run = {"object.mass": {"linspace": [1, 9, 100000]}}, {"duration": 0.02, "arms": "compiled"}
plan = make_plan(ur5_pair(weld, weld), over, keep=["steps"], run=run)
for row in run_in_processes(Context.of(plan), jobs_of(plan), 2):
    print(row["worker"].rpartition(":")[2], flush=True)
"""


def alive(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.slow
def test_workers_end_when_their_caller_was_killed():
    here = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", CALLER]
    with subprocess.Popen(command, env=here, stdout=subprocess.PIPE, text=True) as caller:
        workers = {caller.stdout.readline().strip()}
        while len(workers) < 2:
            workers.add(caller.stdout.readline().strip())
        assert all(map(alive, workers))
        caller.kill()
    until = time.monotonic() + 60.0
    while any(map(alive, workers)) and time.monotonic() < until:
        time.sleep(0.1)
    assert not any(map(alive, workers))


def test_what_cannot_be_sent_to_workers_is_told(scene):
    lock = threading.Lock()
    plan = make_plan(scene, {MASS: [5.0]}, keep=[lambda trajectory: lock and 1.0], run=RUN)
    with pytest.raises(SweepError, match="PicklingError"):
        list(run_in_processes(Context.of(plan), jobs_of(plan), 2))


def test_a_quantity_that_workers_cannot_import_is_an_error_and_no_dead_worker(scene, monkeypatch):
    """Its module is in this process alone, as of a notebook's."""
    module = ModuleType("only_here")
    exec("def seven(trajectory):\n    return 7.0", vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    plan = make_plan(scene, {MASS: [5.0, 10.0]}, keep=[module.seven], run=RUN)
    with refused(SweepError, "a worker cannot do the work", "only_here"):
        list(run_in_processes(Context.of(plan), jobs_of(plan), 2))


@dataclass
class Scaled:
    """A quantity with a parameter; as it has an equality, it has no hash."""

    factor: float

    def __call__(self, trajectory):
        return self.factor * trajectory.scene.object.mass


def test_a_single_quantity_needs_no_list_nor_a_hash(scene, tmp_path):
    for keep in (Scaled(2.0), {"function": Scaled(2.0), "name": "Scaled_object"}):
        sweep = ma.sweep(
            scene, {MASS: [5.0, 10.0]}, keep=keep, out=tmp_path / "s.sweep", workers=1,
            resume=False, **RUN,
        )  # fmt: skip
        (name,) = sweep.quantities
        assert sweep.status_counts == {"completed": 2}
        assert sweep.table[name].tolist() == [10.0, 20.0]


# --- the whole ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_that_is_stopped_goes_on_where_it_was(scene, expected, tmp_path):
    told = []

    def stop(done, count, failed):
        told.append((done, count, failed))
        if done:
            raise KeyboardInterrupt

    (tmp_path / "own.py").write_text(NOTES)
    keep = [*KEEP, f"{tmp_path}/own.py:noted"]
    asked = {"repeat": 4, "seed": 7, "keep": keep, "out": tmp_path / "s.sweep", **RUN}
    part = ma.sweep(scene, OVER, workers=1, progress=stop, **asked)
    early = part.table
    assert told == [(0, 12, 0), (1, 12, 0)]
    assert len(part) == 1 and not part.complete
    whole = ma.sweep(scene, OVER, workers=2, **asked)
    for name in ("run", "status", "message", *KEEP):
        assert whole.table[name].tolist() == [row[name] for row in expected]
    workers = set(whole.table["worker"][1:])
    assert len(workers) == 2 and not any(name.endswith(f":{os.getpid()}") for name in workers)
    # what was done is not done again
    pandas.testing.assert_frame_equal(whole.table[:1], early)
    assert len((tmp_path / "notes").read_text()) == 12
    told.clear()
    ma.sweep(scene, OVER, workers=2, progress=lambda *done: told.append(done), **asked)
    assert told == [(12, 12, 0)]
    fresh = ma.sweep(scene, OVER, workers=1, resume=False, **asked)
    pandas.testing.assert_frame_equal(
        fresh.table.drop(columns=MEASURED), whole.table.drop(columns=MEASURED)
    )
    assert len((tmp_path / "notes").read_text()) == 24


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99], ids=["run", "check", "end of check"])
def test_a_run_that_ctrl_c_ended_is_no_row_nor_one_whose_check_it_ended(scene, share, monkeypatch):
    monkeypatch.setattr("multiarm.scene.EFFECTS.registered", {})
    calls, when = [], [None]

    class Press(ma.Effect):
        name = "press"

        def forces(self, t, state):
            calls.append(t)
            if len(calls) == when[0]:
                signal.raise_signal(signal.SIGINT)
            return ma.Loads()

    ma.register_effect(Press)
    plan = make_plan(scene, {"effects.press": [{}]}, keep=["estimated_error"], run=RUN)
    (job,), context = jobs_of(plan), Context.of(plan)
    runs.run(context, *job)
    calls.clear()
    whole = runs.run(context, *job)
    assert whole["estimated_error"] > 0.0
    when[0] = int(share * len(calls))
    calls.clear()
    with pytest.raises(KeyboardInterrupt):
        runs.run(context, *job)
    assert same(runs.run(context, *job)) == same(whole)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_ends_a_sweep_in_good_order(scene, workers, tmp_path):
    timer = threading.Timer(0.2, signal.raise_signal, [signal.SIGINT])

    def begun(done, count, failed):
        if done and timer.ident is None:
            timer.start()

    found = ma.sweep(
        scene, {MASS: {"linspace": [5, 6, 5000]}}, workers=workers, out=tmp_path / "s.sweep",
        progress=begun, keep=["final_z"], certificate=False, **RUN,
    )  # fmt: skip
    timer.join()
    assert 0 < len(found) < 5000
    assert set(found.table["status"]) == {"completed"}


def test_ctrl_c_ends_the_runs_even_where_python_would_lose_it(monkeypatch):
    def run(context, number, values):
        pressed = weakref.ref(mortal := Mortal(), lambda _: signal.raise_signal(signal.SIGINT))
        del mortal
        assert pressed() is None
        return {"run": number}

    monkeypatch.setattr(executors, "run", run)
    rows = run_here(None, [(1, {}), (2, {})])
    assert next(rows) == {"run": 1}
    with pytest.raises(KeyboardInterrupt):
        next(rows)


class Mortal:
    """An object that a weak reference can watch."""


@pytest.mark.parametrize(
    "asked",
    [
        {"workers": 0},
        {"workers": 2.5},
        pytest.param({"workers": 10**400}, id="huge"),
        {"keep": 3},
        {"workers": 2, "dask": "tcp://here:1"},
        {"duraton": 1.0},
    ],
)
def test_what_cannot_be_asked_is_refused_before_anything_is_written(scene, asked, tmp_path):
    with refused(SweepError, *asked):
        ma.sweep(scene, {MASS: [5.0]}, out=tmp_path / "s.sweep", **asked)
    assert list(tmp_path.iterdir()) == []
