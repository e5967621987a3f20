"""Claims about many runs from outside: progress, Ctrl-C, files, memory."""

from __future__ import annotations

import gc
import io
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from many_runs import assert_same_run, random_states
from refusals import refused
from repository import ROOT

import multiarm as ma
from multiarm.errors import TrajectoryError
from multiarm.simulation.many import run_files

RUN = {"duration": 0.1, "accuracy": 1e-4}
ENDLESS = {"integrator": "rk4", "step": 1e-3, "output_step": 0.1, "duration": 1e4}


def test_progress_tells_time_and_runs_done_in_the_calling_thread(welded_ur5_system, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.many.POLL", 1e-3)
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)
    told, seen = threading.Event(), []

    def control(t, state):
        if t > 0.05:
            told.wait(30.0)  # the runs cannot end before some of them is told to be under way
        return {}

    def progress(t, done):
        seen.append((t, done, threading.current_thread() is threading.main_thread()))
        ma.evaluate(welded_ur5_system, 0.0, welded_ur5_system.initial_state())  # it is free
        if 0.0 < t < 0.1:
            told.set()

    states = random_states(welded_ur5_system, 5)
    ma.simulate_many(
        welded_ur5_system, states=states, threads=2, progress=progress, control=control,
        integrator="rk4", step=1e-3, duration=0.1,
    )  # fmt: skip
    times, done, here = zip(*seen, strict=True)
    assert list(times) == sorted(times) and times[-1] == pytest.approx(0.5)
    assert list(done) == sorted(done) and done[-1] == 5 and set(here) == {True}
    assert any(0.0 < t < 0.1 and count == 0 for t, count, _ in seen)


def test_an_interrupt_that_comes_too_late_to_end_a_run_is_not_lost(welded_ur5_system):
    """Pressed as the last progress is told, when all runs are done."""

    def at_the_end(_t, done):
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ma.simulate_many(
            welded_ur5_system, states=random_states(welded_ur5_system, 2), progress=at_the_end,
            **RUN,
        )  # fmt: skip
    assert signal.getsignal(signal.SIGINT) is before


def test_an_interrupt_after_the_last_poll_is_not_lost(welded_ur5_system, monkeypatch):
    """Pressed while the pool of threads is closed."""

    def pressed(*_):
        signal.raise_signal(signal.SIGINT)
        return shut_down(*_)

    shut_down = ThreadPoolExecutor.__exit__
    monkeypatch.setattr(ThreadPoolExecutor, "__exit__", pressed)
    with pytest.raises(KeyboardInterrupt):
        ma.simulate_many(welded_ur5_system, states=random_states(welded_ur5_system, 1), **RUN)


def test_progress_may_end_them_all(welded_ur5_system):
    states = random_states(welded_ur5_system, 6)

    def until_under_way(t, done):
        if t > 0.0:
            raise KeyboardInterrupt

    found = ma.simulate_many(
        welded_ur5_system, states=states, threads=2, progress=until_under_way, **ENDLESS
    )
    assert [run.status for run in found] == ["interrupted"] * 6
    begun = [run for run in found if len(run)]
    assert len(begun) == 2 and found[:2] == begun
    for run in begun:
        assert "stopped by the user at t = " in run.message and run.statistics["simulated_s"] > 0.0
    for run in found[2:]:
        assert run.message == "stopped by the user before it began"
        assert run.arm_names == ("left", "right") and run.scene.name


def test_an_error_of_progress_ends_them_and_is_raised(welded_ur5_system):
    asked = []

    def broken(t, done):
        raise ZeroDivisionError

    def control(t, state):
        asked.append(t)
        return {}

    run = {**ENDLESS, "duration": 20.0, "control": control}
    with pytest.raises(ZeroDivisionError):
        ma.simulate_many(welded_ur5_system, parameters=[{}] * 3, progress=broken, **run)
    assert max(asked) < 20.0
    assert not [t for t in threading.enumerate() if t.name.startswith("multiarm")]


INTERRUPTED = """
import sys
import multiarm as ma
from multiarm.scene import load_scene

system = ma.compile_system(load_scene(sys.argv[1]))
short, endless = {"run.duration": 0.01}, {}
told = []

def progress(t, done):
    if done >= 2 and t > 20.0 and not told:  # both others are under way
        told.append(print("under way", flush=True))

found = ma.simulate_many(
    system, parameters=[short, short, endless, endless, endless], threads=2, out=sys.argv[2],
    progress=progress,
)
print([run.status for run in found], [len(run) > 0 for run in found])
print(len(ma.simulate_many(system, parameters=[short])))
"""
SCENE = """
gravity: [0, 0, -9.81]
object: {shape: {box: [1.2, 0.6, 0.4]}, mass: 20.0, pose: {xyz: [0, 0, 0.5]}}
arms:
  left: {robot: ur5, tip: tool0, base: {xyz: [-1.1, 0, 0]}, posture: &there
    [-0.264381, -1.509346, 1.788302, 2.862637, -1.306415, 0.0]}
  right: {robot: ur5, tip: tool0, base: {xyz: [1.1, 0, 0], rpy: [0, 0, 3.141592653589793]},
    posture: *there}
joints: [{arm: left, kind: weld}, {arm: right, kind: weld}]
control: {kind: joint_pd, stiffness: 100, damping: 20, gravity_compensation: true}
run: {duration: 10000, integrator: rk4, step: 0.001}
"""


@pytest.mark.slow
def test_ctrl_c_ends_all_in_good_order_and_keeps_what_is_done(tmp_path):
    (tmp_path / "pair.yaml").write_text(SCENE)
    words = [sys.executable, "-c", INTERRUPTED, str(tmp_path / "pair.yaml"), str(tmp_path / "runs")]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None and program.stderr is not None
        assert program.stdout.readline() == "under way\n", program.stderr.read()
        program.send_signal(signal.SIGINT)
        try:
            told, errors = program.communicate(timeout=60)
        finally:
            program.kill()
    expected = ["completed", "completed", "interrupted", "interrupted", "interrupted"]
    assert told.splitlines() == [f"{expected} {[True, True, True, True, False]}", "1"], errors
    assert program.returncode == 0
    stored = [ma.load_trajectory(path) for path in sorted((tmp_path / "runs").iterdir())]
    assert [run.status for run in stored] == expected[:4]
    assert all(np.isfinite(run.object_position).all() and len(run) > 1 for run in stored)


# --- files --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_files_hold_what_memory_would(welded_ur5_system, tmp_path):
    states = random_states(welded_ur5_system, 5)
    kept = ma.simulate_many(welded_ur5_system, states=states, **RUN)
    folder = tmp_path / "new" / "runs"
    found = ma.simulate_many(welded_ur5_system, states=states, threads=3, out=folder, **RUN)
    names = [f"run_000{number}.h5" for number in range(1, 6)]
    assert sorted(path.name for path in folder.iterdir()) == names
    for name, run, expected in zip(names, found, kept, strict=True):
        assert_same_run(run, expected)
        assert_same_run(ma.load_trajectory(folder / name), expected)
    again = ma.simulate_many(
        welded_ur5_system, states=states[:2], out=tmp_path / "new" / "box_{:d}.h5", **RUN
    )
    assert_same_run(ma.load_trajectory(tmp_path / "new" / "box_2.h5"), again[1])


@pytest.mark.slow
def test_results_keep_no_file_open(welded_ur5_system, tmp_path):
    found = ma.simulate_many(welded_ur5_system, 0.01, parameters=[{}] * 12, out=tmp_path)
    assert found[3].object_position.shape == (2, 3)
    opened = [os.readlink(entry) for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink()]
    assert not [path for path in opened if str(tmp_path) in path]
    found[5].close()
    with refused(TrajectoryError):
        found[5].read("time")


@pytest.mark.slow
def test_a_pattern_and_a_folder_name_files_in_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_files(None, 2) == [None, None]
    assert [p.name for p in run_files("deep/runs", 2)] == ["run_0001.h5", "run_0002.h5"]
    assert run_files("deep/a{:02d}.h5", 2) == [Path("deep/a01.h5"), Path("deep/a02.h5")]
    many = run_files("deep/runs", 10001)
    assert many[0].name == "run_00001.h5" and sorted(many) == many


@pytest.mark.parametrize("out", [True, 3, "run{[0]}.h5", "run{x}.h5"])
def test_what_names_no_files_is_refused(out):
    with refused(TrajectoryError, "'box_{:03d}.h5'"):
        run_files(out, 2)


def test_foreign_files_are_not_replaced(welded_ur5_system, tmp_path):
    (tmp_path / "run_0002.h5").write_text("a diary")
    with refused(TrajectoryError, "run_0002.h5"):
        ma.simulate_many(welded_ur5_system, parameters=[{}, {}], out=tmp_path)
    (tmp_path / "file").write_text("")
    with refused(TrajectoryError, str(tmp_path)):
        ma.simulate_many(welded_ur5_system, parameters=[{}], out=tmp_path / "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "run_0002.h5"]


# --- memory -------------------------------------------------------------------------------------


def resident() -> float:
    """Memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.slow
@pytest.mark.parametrize("what", ["states", "parameters"])
def test_memory_does_not_grow_with_the_runs(welded_ur5_system, tmp_path, what):
    """Beyond the results: a system that is not let go of has some 0.2 MB."""
    state = welded_ur5_system.initial_state()

    def runs(count):
        many = {"states": [state] * count, "parameters": [{"object.mass": 5.0}] * count}
        found = ma.simulate_many(
            welded_ur5_system, 0.01, **{what: many[what]}, threads=3, certificate=False
        )
        assert {run.status for run in found} == {"completed"}
        del found
        gc.collect()
        return resident()

    runs(20)
    before = runs(20)
    assert runs(100) - before < 12.0


# --- the bar ------------------------------------------------------------------------------------


def test_progress_true_is_a_bar_of_runs(welded_ur5_system, monkeypatch):
    from rich.console import Console

    console = Console(force_terminal=True, width=100, file=io.StringIO(), record=True)
    monkeypatch.setattr("multiarm.terminal.console.messages", lambda: console)
    monkeypatch.setattr("multiarm.simulation.many.POLL", 1e-3)
    found = ma.simulate_many(welded_ur5_system, parameters=[{}] * 4, progress=True, **RUN)
    assert len(found) == 4
    text = console.export_text()
    assert "4 of 4 runs" in text and "0.4 of 0.4 s" in text


def test_a_result_whose_file_another_run_has_replaced_says_so(welded_ur5_system, tmp_path):
    starts = random_states(welded_ur5_system, 2)
    first = ma.simulate_many(welded_ur5_system, states=starts[:1], out=tmp_path, **RUN)
    second = ma.simulate_many(welded_ur5_system, states=starts[1:], out=tmp_path, **RUN)
    assert second[0].object_position.shape[1] == 3
    with refused(TrajectoryError, "run_0001.h5"):
        _ = first[0].object_position
