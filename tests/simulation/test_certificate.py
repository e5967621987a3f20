"""Claims about certificates: what is compared, when a run is repeated, and that *met* is true."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
from certificate_calibration import run_trial
from commands import multiarm
from event_scenes import box, on_floor
from mechanics import SHORT, data_of, true_error, ur5_pair
from refusals import refused
from repository import ROOT
from sample_run import record, rows_of, samples
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import SceneError, TrajectoryError
from multiarm.problems import HARD_CASES, ring_of_arms
from multiarm.reports.report import render
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import amend_file
from multiarm.scene import AccuracySpec, RunSpec, dump_scene, parse_scene
from multiarm.simulation import certified as attempts
from multiarm.simulation.certificate import SAFETY, assess
from multiarm.simulation.certified import INTERRUPTED_WORDS
from multiarm.simulation.comparison import compare, growth_rate, rotation_apart
from multiarm.terminal.progress import RunProgress


@pytest.fixture(scope="module")
def ring():
    return ma.compile_system(ring_of_arms(2))


# --- what is asked -------------------------------------------------------------------------------


def test_a_number_asks_for_positions_and_rotations_alike():
    asked = RunSpec(accuracy=1e-6).accuracy
    assert (asked.position, asked.rotation, asked.force, asked.smallest) == (1e-6, 1e-6, None, 1e-6)
    assert asked == 1e-6 == AccuracySpec(position=1e-6, rotation=1e-6)
    assert hash(asked) == hash(1e-6)
    assert asked != 2e-6 and asked != AccuracySpec(position=1e-6)


@pytest.mark.parametrize(
    "written", [1e-6, {"position": 1e-6}, {"rotation": 1e-3, "force": 0.5}, {"force": 2.0}]
)
def test_an_accuracy_is_stored_as_it_was_written(written):
    scene = ring_of_arms(2).replace(run={"accuracy": written})
    text = dump_scene(scene)
    assert parse_scene(text) == scene
    assert parse_scene(text).run.accuracy.written == written
    assert json.loads(json.dumps(scene.model_dump(mode="json")))["run"]["accuracy"] == written


def test_a_table_asks_for_what_it_names_only():
    asked = RunSpec(accuracy={"rotation": 1e-4, "force": 0.1}).accuracy
    assert (asked.position, asked.rotation, asked.force, asked.smallest) == (None, 1e-4, 0.1, 1e-4)
    assert AccuracySpec(force=0.1).smallest == 1e-6


@pytest.mark.parametrize(
    "accuracy",
    [
        {},
        {"positon": 1e-6},
        {"position": 0, "force": -1},
        "fine",
        [1e-6],
        -1e-6,
        float("inf"),
    ],
)
def test_faults_of_an_accuracy_are_told_with_place_and_remedy(accuracy):
    with refused(SceneError, "$.run.accuracy", "$.gravity"):
        ring_of_arms(2).replace(run={"accuracy": accuracy}, gravity=[0, 0, "down"])


# --- what is compared ----------------------------------------------------------------------------


def shifted(name, change, sink=None):
    """The sample run with one channel changed."""
    block = samples()
    block[name] = block[name] + change
    return record(sink or MemorySink(), [block])


def column(width, k, size):
    return size * np.eye(width)[k]


CHANGES = {
    "object/position": ([3e-7, 0.0, -4e-7], {"object position": 5e-7}),
    "arms/left/joint_position": (column(6, 4, -2e-6), {"left: joints": 2e-6}),
    "arms/right/joint_position": (
        [1e-5, 3e-6, 2e-6],
        {"right: sliding joints": 1e-5, "right: joints": 3e-6},
    ),
    "arms/left/contact_force": (column(6, 2, 0.25), {"left: contact forces": 0.25}),
    "arms/right/contact_force": (column(3, 1, -0.5), {"right: contact forces": 0.5}),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_difference_is_found_in_its_own_output_only(name):
    change, expected = CHANGES[name]
    found = compare(record(MemorySink()), shifted(name, change)).outputs
    for output, difference in found.items():
        assert difference.worst == pytest.approx(expected.get(output, 0.0), rel=1e-6)
    assert set(expected) <= set(found)


def test_sliding_joints_count_as_positions_and_turning_ones_as_rotations():
    moved = shifted("arms/right/joint_position", [1e-5, 3e-6, 2e-6])
    found = compare(record(MemorySink()), moved)
    assert found.worst("position_m") == pytest.approx(1e-5)
    assert found.worst("rotation_rad") == pytest.approx(3e-6)
    assert found.worst("force_N") == 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-14, 1e-9, 1e-4, 1.0, 3.1])
def test_rotation_apart_is_the_angle_of_the_relative_rotation(angle, rng):
    first = Rotation.random(20, random_state=1)
    axes = rng.standard_normal((20, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    second = (Rotation.from_rotvec(angle * axes) * first).as_quat()
    second[::2] *= -1.0  # the same rotation
    np.testing.assert_allclose(
        rotation_apart(first.as_quat(), second), angle, atol=1e-15, rtol=1e-9
    )


def test_the_worst_moment_is_told_and_survives_thinning():
    block = samples(duration=60.0)
    peak = np.zeros(len(block["time"]))
    peak[4321] = 1e-3
    other = {**block, "object/position": block["object/position"] + peak[:, None] * [1, 0, 0]}
    found = compare(record(MemorySink(), [block]), record(MemorySink(), [other]))
    assert found.outputs["object position"].time == pytest.approx(block["time"][4321])
    assert len(found.time) <= 400
    assert found.course["position_m"].max() == pytest.approx(1e-3)


def test_forces_that_the_equations_leave_open_take_no_part_where_rank_is_lost():
    block = samples()
    block["solver/rank"] = np.where(block["time"] < 3.0, 9.0, 8.0)  # of 9 contacts
    other = {**block}
    late = (block["time"] >= 3.0)[:, None]
    other["arms/left/contact_force"] = block["arms/left/contact_force"] + late * column(6, 1, 7.0)
    runs = [record(MemorySink(), [part]) for part in (block, other)]
    lost = {"left": np.arange(6) == 1}
    assert compare(*runs).worst("force_N") == pytest.approx(7.0)
    found = compare(*runs, lost)
    assert found.worst("force_N") == 0.0
    assert found.outputs["left: contact forces"].left_out == int(late.sum())
    early = ~late * column(6, 1, 2.0)
    other["arms/left/contact_force"] = other["arms/left/contact_force"] + early
    assert compare(runs[0], record(MemorySink(), [other]), lost).worst("force_N") == pytest.approx(
        2.0
    )


@pytest.mark.parametrize("rate", [1.5, 4.6, 20.0])
def test_growth_rate_is_that_of_the_exponential(rate, rng):
    time = np.linspace(0.0, 30.0 / rate, 400)
    noise = np.exp(0.7 * rng.standard_normal(400))
    apart = np.minimum(1e-13 * noise * np.exp(rate * time), 1.3)
    apart[::17] *= 1e-3  # the difference may pass through zero
    assert growth_rate(time, apart) == pytest.approx(rate, rel=0.1)


def test_what_comes_after_runs_have_parted_is_no_growth():
    """They come near each other again and again, as any two swings do."""
    time = np.linspace(0.0, 20.0, 400)
    apart = np.where(time < 6.0, 1e-13 * np.exp(4.6 * time), 0.2 * np.exp(-0.4 * (time - 6.0)))
    assert growth_rate(time, apart) == pytest.approx(4.6, rel=0.1)


@pytest.mark.parametrize("power", [0, 1, 3])
def test_errors_that_only_add_up_have_no_growth_rate(power, rng):
    time = np.linspace(0.0, 5.0, 400)
    apart = 1e-9 * time**power * np.exp(0.5 * rng.standard_normal(400))
    assert growth_rate(time, apart) is None


# --- the verdict ---------------------------------------------------------------------------------


@pytest.mark.parametrize("accuracy", [1e-3, 1e-6, 1e-10])
def test_met_means_that_the_true_error_is_below_the_estimate(ring, accuracy):
    run = ma.simulate(ring, accuracy=accuracy, **SHORT)
    found = run.certificate
    assert found["met"] and found["text"].startswith("met: estimated error")
    estimated = max(found["estimated_error"][key] for key in ("position_m", "rotation_rad"))
    assert true_error(ring, run) <= estimated + 1e-12  # the reference's own
    assert estimated <= accuracy
    assert found["asked"] == {"position_m": accuracy, "rotation_rad": accuracy, "force_N": None}
    assert {"object position", "object rotation", "arm0: joints"} <= set(found["by_output"])
    assert all(check["passed"] for check in found["checks"].values())


def test_the_returned_run_is_the_one_whose_error_was_estimated(ring):
    run = ma.simulate(ring, accuracy=1e-5, **SHORT)
    returned = [row for row in run.certificate["attempts"] if row["returned"]]
    assert [row["tolerance"] for row in returned] == [run.statistics["tolerance"]]
    assert returned[0]["evaluations"] == run.statistics["evaluations"]
    assert returned[0]["rotation_rad"] == run.certificate["estimated_error"]["rotation_rad"]
    assert len(run.certificate["attempts"]) == 2


def test_a_certificate_does_not_change_the_run(ring):
    checked = ma.simulate(ring, accuracy=1e-5, **SHORT)
    alone = ma.simulate(ring, accuracy=1e-5, certificate=False, **SHORT)
    assert alone.certificate is None
    np.testing.assert_array_equal(checked.object_position, alone.object_position)


def loosened(monkeypatch, factor):
    """Let every run take tolerances that are larger by a factor; returns what was run."""
    made = []
    carry_out = attempts.carry_out

    def loose(task, sink, progress=None, tighten=1.0, *limit):
        carried = carry_out(task, sink, progress, factor * tighten, *limit)
        made.append(carried.trajectory)
        return carried

    monkeypatch.setattr(attempts, "carry_out", loose)
    return made


@pytest.mark.parametrize("factor", [1e5, 1e7])
def test_a_run_that_is_not_accurate_enough_is_repeated(ring, monkeypatch, factor):
    made = loosened(monkeypatch, factor)
    run = ma.simulate(ring, 0.5, accuracy=1e-8)
    found = run.certificate
    assert found["met"] and len(made) == len(found["attempts"]) > 2
    assert not found["attempts"][0]["returned"]
    assert found["attempts"][0]["rotation_rad"] > 1e-8
    assert run.statistics["tolerance"] == min(
        row["tolerance"] for row in found["attempts"] if row["rotation_rad"] is not None
    )
    monkeypatch.undo()
    assert true_error(ring, run) <= 1e-8


def test_a_rerun_that_goes_elsewhere_is_noticed(ring, monkeypatch):
    carry_out = attempts.carry_out

    def elsewhere(task, sink, progress=None, tighten=1.0, *limit):
        if tighten < 1.0:
            start = task.system.initial_state()
            start.velocity[2] += 1e-3 * tighten
            task = replace(task, state=start)
        return carry_out(task, sink, progress, tighten, *limit)

    monkeypatch.setattr(attempts, "carry_out", elsewhere)
    run = ma.simulate(ring, accuracy=1e-8, **SHORT)
    assert not run.certificate["met"] and run.certificate["text"].startswith("not met: ")
    assert run.certificate["estimated_error"]["position_m"] > 1e-8


@pytest.mark.slow
def test_a_chaotic_run_cannot_be_certified_and_says_how_errors_grow():
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    run = ma.simulate(ma.compile_system(scene), 20.0, accuracy=1e-10, output_step=0.05)
    found = run.certificate
    assert run.status == "completed" and not found["met"] and found["reason"] == "growth"
    assert 2.0 < found["growth_rate_per_s"] < 10.0  # about a hundredfold a second
    assert f"e^({found['growth_rate_per_s']:.2g} t)" in found["text"]
    assert all(word in found["text"] for word in ("shorter time", "less accuracy", "damping"))
    assert len(found["attempts"]) <= 3


def test_an_accuracy_below_rounding_is_not_promised(ring):
    run = ma.simulate(ring, accuracy=1e-15, **SHORT)
    assert not run.certificate["met"] and run.certificate["reason"] == "rounding"
    assert "rounding" in run.certificate["text"]
    assert min(row["tolerance"] for row in run.certificate["attempts"]) >= 1e-17


def test_forces_are_certified_when_they_are_asked_for(ring):
    loose = ma.simulate(ring, accuracy={"position": 1e-2, "rotation": 1e-2}, **SHORT)
    assert loose.certificate["estimated_error"]["force_N"] > 1e-9
    run = ma.simulate(ring, accuracy={"force": 1e-9}, **SHORT)
    found = run.certificate
    assert found["met"] and found["estimated_error"]["force_N"] <= 1e-9
    assert found["asked"] == {"position_m": None, "rotation_rad": None, "force_N": 1e-9}
    exact = ma.simulate(ring, integrator="dopri5", tolerance=1e-13, **SHORT)
    for arm in run.arm_names:
        np.testing.assert_allclose(run.contact_forces[arm], exact.contact_forces[arm], atol=1e-9)


def test_forces_that_are_not_unique_do_not_spoil_a_verdict():
    system = ma.compile_system(HARD_CASES["bricard"].scene())
    run = ma.simulate(system, 0.3, accuracy={"position": 1e-6, "force": 1e-2})
    assert run.certificate["met"]
    assert "that the equations leave open were not judged" in run.certificate["text"]
    left_out = [o["samples_left_out"] for o in run.certificate["by_output"].values()]
    assert max(left_out) > 0


# --- the run on its own --------------------------------------------------------------------------


def tampered(run, **channels):
    """The run with functions of time added to some channels."""
    sink, recorded = MemorySink(), tuple(run.channels.values())
    sink.open(recorded, run.provenance)
    block = {name: run.read(name) for name in run.channels}
    for name, change in channels.items():
        block[name] = block[name] + change(block["time"])
    sink.append(rows_of(recorded, block))
    return sink.finish(run.status, run.message, run.statistics)


def test_forces_of_the_floor_are_compared_and_count_where_rank_is_lost():
    run = ma.simulate(ma.compile_system(on_floor(box(), mu=0.3)), 0.002, certificate=False)
    floor, (arm,) = "environment/contact_force", run.arm_names
    pushed = tampered(run, **{floor: lambda t: np.full((t.size, 1), 7.0)})
    assert compare(run, pushed).outputs["floor: contact forces"].worst == pytest.approx(7.0)
    force = run.channels[f"arms/{arm}/contact_force"]
    contacts = force.width + run.channels[floor].width
    dependent = tampered(run, **{"solver/rank": lambda t: contacts - 1.0 - run.read("solver/rank")})
    pushed = tampered(dependent, **{force.name: lambda t: np.full((t.size, 1), 7.0)})
    found = compare(dependent, pushed, {arm: np.ones(force.width, dtype=bool)})
    assert found.outputs[f"{arm}: contact forces"].left_out == len(run)


@pytest.mark.parametrize(
    ("channel", "size", "check", "words"),
    [
        ("energy/work", 1e-2, "energy", "out of balance by 0.01 J"),
        ("solver/residual", 1e-4, "residual", "solved to 0.0001 only"),
        ("drift/position", 1e-4, "drift", "open by up to 0.0001 m"),
    ],
)
def test_a_fault_that_both_runs_share_is_found_in_the_run_itself(ring, channel, size, check, words):
    run, finer = (
        ma.simulate(ring, integrator="dop853", tolerance=tolerance, **SHORT)
        for tolerance in (1e-8, 3e-10)
    )
    good = assess(data_of(ring), run, finer, AccuracySpec(position=1e-6, rotation=1e-6))
    assert good.met and all(found.passed for found in good.checks.values())
    spoilt = [tampered(r, **{channel: lambda t: size * t / 0.2}) for r in (run, finer)]
    bad = assess(data_of(ring), *spoilt, AccuracySpec(position=1e-6, rotation=1e-6))
    assert bad.accurate and not bad.met
    assert [name for name, found in bad.checks.items() if not found.passed] == [check]
    assert words in bad.faults[0]


def test_the_energy_bound_follows_the_accuracy_asked(ring):
    run, finer = (
        ma.simulate(ring, integrator="dop853", tolerance=tolerance, **SHORT)
        for tolerance in (1e-8, 3e-10)
    )
    bounds = [
        assess(data_of(ring), run, finer, AccuracySpec(position=a, rotation=a))
        .checks["energy"]
        .bound
        for a in (1e-4, 1e-6)
    ]
    assert bounds[0] == pytest.approx(100 * bounds[1], rel=0.05)
    # weights of some 10 N to 200 N and lever arms of some decimetres, times the accuracy
    assert 1e-5 < bounds[1] < 1e-2


def test_drift_that_stabilisation_leaves_is_part_of_the_verdict(ring):
    run = ma.simulate(ring, accuracy=1e-6, stabilization="none", **SHORT)
    assert run.certificate["met"]
    assert run.certificate["checks"]["drift"]["value"] == run.position_drift.max()


# --- who has no certificate ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"integrator": "rk4", "step": 1e-2},
        {"integrator": "dop853", "tolerance": 1e-6},
        {"accuracy": 1e-6, "certificate": False},
    ],
)
def test_runs_that_are_not_checked_have_no_certificate(ring, settings):
    assert ma.simulate(ring, **SHORT, **settings).certificate is None


def test_a_failed_run_gets_no_rerun(ring):
    calls = []

    def control(t, state):
        calls.append(t)
        if t > 0.1:
            raise ValueError("out of order")
        return {}

    run = ma.simulate(ring, accuracy=1e-4, control=control, **SHORT)
    assert run.status == "failed" and run.certificate is None
    assert calls.count(0.0) <= 4  # the beginning of one run


def test_a_python_controller_is_called_again_from_the_start(ring):
    def times(**settings):
        called = []
        ma.simulate(
            ring,
            accuracy=1e-4,
            control=lambda t, state: called.append(t) or {},
            **SHORT,
            **settings,
        )
        return called

    alone, checked = times(certificate=False), times()
    assert checked[: len(alone)] == alone
    assert min(checked[len(alone) :]) == 0.0 and max(checked) == 0.2


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_a_rerun_that_fails_leaves_the_run_uncertified(ring):
    seen = []

    def control(t, state):
        seen.append(t)
        if seen.count(0.0) > 8 and t > 0.1:
            raise ValueError("only once")
        return {}

    starts = []
    ma.simulate(ring, accuracy=1e-4, control=lambda t, s: starts.append(t) or {}, certificate=False,
                **SHORT)  # fmt: skip
    first = starts.count(0.0)

    def once(t, state):
        seen.append(t)
        if seen.count(0.0) > first and t > 0.1:
            raise ValueError("only once")
        return {}

    seen.clear()
    run = ma.simulate(ring, accuracy=1e-4, control=once, **SHORT)
    assert run.status == "completed" and len(run) == 11
    assert not run.certificate["met"] and run.certificate["reason"] == "failed rerun"
    assert "only once" in run.certificate["text"]
    render(run)


# --- interruptions and progress ------------------------------------------------------------------


class Watcher:
    """Progress that does something while a rerun goes on."""

    def __init__(self, act=None):
        self.times, self.checked, self.act = [], [], act

    def __call__(self, t):
        self.times.append(t)

    def checking(self, t, number):
        self.checked.append((number, t))
        if self.act is not None:
            self.act()


def press():
    raise KeyboardInterrupt


@pytest.mark.parametrize("stored", [False, True])
def test_an_interrupted_check_leaves_the_run_as_it_is(ring, tmp_path, stored):
    out = tmp_path / "run.h5" if stored else None
    run = ma.simulate(ring, accuracy=1e-6, out=out, progress=Watcher(press), **SHORT)
    assert run.status == "completed" and run.time[-1] == 0.2
    assert run.certificate is None and INTERRUPTED_WORDS in run.message
    if stored:
        kept = ma.load_trajectory(out)
        assert kept.message == run.message and kept.certificate is None
        assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("number", [2, 3])
def test_an_interrupted_repetition_keeps_the_run_that_was_judged(
    ring, tmp_path, monkeypatch, number, stored
):
    loosened(monkeypatch, 1e7)
    out = tmp_path / "run.h5" if stored else None

    class Impatient(Watcher):
        def checking(self, t, running):
            if running == number:
                raise KeyboardInterrupt

    run = ma.simulate(ring, 0.5, accuracy=1e-8, out=out, progress=Impatient())
    found = run.certificate
    assert run.status == "completed" and not found["met"] and found["reason"] == "interrupted"
    assert found["estimated_error"]["rotation_rad"] > 1e-8 and found["attempts"][0]["returned"]
    assert len(run.object_position) == 51
    if stored:
        assert ma.load_trajectory(out).certificate == found
        assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_progress_tells_the_first_run_and_the_check_apart(ring, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)
    watcher, plain = Watcher(), []
    ma.simulate(ring, accuracy=1e-6, progress=watcher, **SHORT)
    assert watcher.times == sorted(watcher.times) and watcher.times[-1] == 0.2
    assert {number for number, _ in watcher.checked} == {1}
    assert watcher.checked == sorted(watcher.checked) and watcher.checked[-1] == (1, 0.2)
    ma.simulate(ring, accuracy=1e-6, progress=plain.append, **SHORT)
    assert plain == sorted(plain) and plain[: len(watcher.times)] == watcher.times


def test_the_bar_says_that_the_accuracy_is_checked(monkeypatch):
    from io import StringIO

    from rich.console import Console

    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=100, color_system=None)
    monkeypatch.setattr("multiarm.terminal.console.messages", lambda: console)
    with RunProgress(4.0) as progress:
        progress(4.0)
        progress.checking(1.0, 1)
        progress._bar.refresh()
        progress.checking(2.0, 3)
        progress._bar.refresh()
    assert "checking the accuracy" in screen.getvalue()
    assert "(run 4)" in screen.getvalue()


# --- files ---------------------------------------------------------------------------------------


def test_a_stored_run_holds_its_certificate(ring, tmp_path):
    out = tmp_path / "run.h5"
    stored = ma.simulate(ring, accuracy=1e-6, out=out, **SHORT)
    kept, in_memory = ma.load_trajectory(out), ma.simulate(ring, accuracy=1e-6, **SHORT)
    assert kept.certificate["text"] == in_memory.certificate["text"]
    assert kept.certificate == stored.certificate and kept.certificate["met"]
    np.testing.assert_array_equal(kept.object_position, in_memory.object_position)
    np.testing.assert_array_equal(stored.object_position, in_memory.object_position)
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]
    again = kept.save(tmp_path / "copy.h5")
    assert ma.load_trajectory(again).certificate == kept.certificate


def test_a_chosen_repetition_takes_the_place_of_the_file(ring, tmp_path, monkeypatch):
    made = loosened(monkeypatch, 1e7)
    out = tmp_path / "run.h5"
    (tmp_path / ".run.h5.check1").write_bytes(b"left by a killed run")
    ma.simulate(ring, 0.5, accuracy=1e-8, out=out)
    kept = ma.load_trajectory(out)
    assert len(made) > 2 and kept.certificate["met"]
    returned = next(row for row in kept.certificate["attempts"] if row["returned"])
    assert kept.statistics["tolerance"] == returned["tolerance"]
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_a_rerun_without_a_place_for_its_samples_leaves_the_run_uncertified(ring, tmp_path):
    (tmp_path / ".run.h5.check1").mkdir()
    run = ma.simulate(ring, accuracy=1e-6, out=tmp_path / "run.h5", **SHORT)
    assert run.status == "completed" and len(run) == 11
    assert run.certificate["reason"] == "failed rerun"
    assert ".run.h5.check1" in run.certificate["text"]


KILLED = """
import os, signal, sys, types
import multiarm as ma
from multiarm.problems import ring_of_arms
from multiarm.results import trajectory_file

def kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)

class Killer:
    def __call__(self, t):
        pass
    if sys.argv[2] == "rerun":
        checking = kill

if sys.argv[2] == "amendment":
    class File(trajectory_file.h5py.File):
        def __init__(self, name, mode, **options):
            super().__init__(name, mode, **options)
            self.is_amended = mode == "r+"  # the writer of a new run has "w"

        def flush(self):
            super().flush()
            if self.is_amended:
                kill()
    h5py = trajectory_file.h5py
    trajectory_file.h5py = types.SimpleNamespace(File=File, string_dtype=h5py.string_dtype)

system = ma.compile_system(ring_of_arms(2))
ma.simulate(system, 0.2, accuracy=1e-6, output_step=0.02, out=sys.argv[1], progress=Killer())
"""


@pytest.mark.slow
@pytest.mark.parametrize("when", ["rerun", "amendment"])
def test_a_kill_after_the_run_leaves_a_complete_result(ring, tmp_path, when):
    out = tmp_path / "run.h5"
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(out), when],
        env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, done.stderr
    kept = ma.load_trajectory(out)
    assert kept.status == "completed" and kept.time[-1] == 0.2
    assert kept.certificate is None
    kept.close()
    assert ma.simulate(ring, accuracy=1e-6, out=out, **SHORT).certificate["met"]
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_files_of_earlier_programs_load_and_take_no_amendment(tmp_path):
    record(Hdf5Sink(tmp_path / "old.h5")).close()
    with h5py.File(tmp_path / "old.h5", "r+") as file:
        del file["amendment"], file["amended"]
    old = ma.load_trajectory(tmp_path / "old.h5")
    assert old.status == "completed" and old.certificate is None
    old.close()
    with refused(TrajectoryError, "old.h5"):
        amend_file(tmp_path / "old.h5", {"certificate": {"met": True}})


def test_amendments_replace_each_other_and_leave_the_samples(tmp_path):
    record(Hdf5Sink(tmp_path / "run.h5")).close()
    for number in range(3):
        amend_file(tmp_path / "run.h5", {"certificate": {"number": number, "much": "x" * 5000}})
    amend_file(tmp_path / "run.h5", {"message": "said later"})
    run = ma.load_trajectory(tmp_path / "run.h5")
    assert (run.certificate["number"], run.message) == (2, "said later")
    np.testing.assert_array_equal(run.object_position, samples()["object/position"])


# --- how it is told ------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_line_shows_the_verdict(tmp_path):
    scene = tmp_path / "ring.yaml"
    scene.write_text(dump_scene(ring_of_arms(2, duration=0.1)))
    files = ["--out", str(tmp_path / "run.h5"), "--json", str(tmp_path / "run.json")]
    done = multiarm("run", scene, *files)
    assert done.exit_code == 0 and "met: estimated error" in " ".join(done.stdout.split())
    data = json.loads((tmp_path / "run.json").read_text())
    assert data["certificate"]["met"] and data["rank_lowest"] == data["rank_highest"] == 12
    assert data["events"] == [] and data["coupled_steps"] == 0
    done = multiarm("run", scene, "--no-certificate", *files)
    assert json.loads((tmp_path / "run.json").read_text())["certificate"] is None
    assert "not checked" in " ".join(done.stdout.split())


@pytest.mark.slow
def test_an_accuracy_that_is_not_met_is_a_warning_and_no_failure(tmp_path):
    scene = tmp_path / "ring.yaml"
    scene.write_text(dump_scene(ring_of_arms(2, duration=0.1, accuracy=1e-15)))
    done = multiarm("run", scene, "--out", tmp_path / "run.h5", "-q")
    assert done.exit_code == 0 and done.stdout == ""
    assert "warning: the accuracy is not met: " in done.stderr


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("accuracy", [{"position": 1e-6, "force": 1e-3}, 1e-15])
def test_the_report_shows_verdict_numbers_and_attempts(ring, accuracy):
    run = ma.simulate(ring, accuracy=accuracy, **SHORT)
    page = render(run)
    verdict = "Accuracy met" if run.certificate["met"] else "Accuracy not met"
    assert f"<span>{verdict}</span>" in page
    for text in ("arm1: contact forces", "Energy and work in balance", "(this result)", "Runs"):
        assert text in page
    assert ("not requested" in page) and ("Estimated error over time" in page)


# --- honesty -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 4, 6, 8, 11])
def test_a_random_scene_that_is_certified_is_as_accurate_as_asked(seed):
    trial = run_trial(seed)
    assert trial.status == "completed" and trial.met is not None
    assert trial.decided and not trial.false_positive
    # the estimate itself is above the true error wherever that is known
    assert all(ratio <= 1.0 for ratio in trial.ratios())
    assert SAFETY > 1.0
