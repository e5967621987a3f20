"""Claims about ``multiarm sweep``, and about looking at one run of a sweep."""

from __future__ import annotations

import csv
import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from commands import multiarm
from repository import SCENES
from rich.console import Console

import multiarm as ma
from multiarm.cli.sweep import spread_table, trouble_lines
from multiarm.sweeps.quantities import measure
from multiarm.sweeps.result import Failure, SweepSummary, load_sweep
from multiarm.terminal.progress import SweepProgress

SCENE = SCENES / "two_ur5_box.yaml"
SWEEP = """
over:
  object.mass: {linspace: [5, 50, 3]}
  "arms.left.base.xyz[2]": {uniform: [-0.002, 0.002]}
repeat: 2
seed: 7
certificate: false
run: {duration: 0.02, accuracy: 1e-3, arms: compiled}
"""
KILLING = """
import os
import signal
from pathlib import Path

CALLS = Path(__file__).with_name("calls")

def killing(trajectory):
    with CALLS.open("a") as calls:
        calls.write("x")
    if CALLS.stat().st_size == 14:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0
"""
MEASURED = ("wall_time", "worker")


def same_table(folder: Path, expected: Path) -> bool:
    tables = (load_sweep(path).table.drop(columns=[*MEASURED]) for path in (folder, expected))
    return next(tables).equals(next(tables))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A sweep of six runs and everything that the command can write, and what it printed."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "masses.yaml").write_text(SWEEP)
    files = [f"--{kind}={folder / f'm.{kind}'}" for kind in ("csv", "parquet", "json")]
    called = multiarm(
        "sweep", SCENE, "--over", folder / "masses.yaml", "--workers", 1, *files,
        "--out", folder / "m.sweep", "--plot", folder / "m.svg",
    )  # fmt: skip
    assert called.exit_code == 0, called.output
    return folder, called.output


@pytest.mark.slow
def test_one_command_makes_all_runs_and_writes_all_files(made):
    folder, printed = made
    assert "6 of 6" in printed and "6 completed" in printed
    table = load_sweep(folder / "m.sweep").table
    with (folder / "m.csv").open() as file:
        rows = list(csv.DictReader(file))
    parquet = pandas.read_parquet(folder / "m.parquet")
    for name in ("object.mass", "arms.left.base.xyz[2]", "final_position_error"):
        assert [float(row[name]) for row in rows] == table[name].tolist()
        assert parquet[name].tolist() == table[name].tolist()
    assert table["object.mass"].tolist() == [5.0, 5.0, 27.5, 27.5, 50.0, 50.0]
    assert len(set(table["arms.left.base.xyz[2]"])) == 6
    assert (folder / "m.svg").read_text().startswith("<?xml")


@pytest.mark.slow
def test_the_json_has_the_figures_of_the_table(made):
    folder, _ = made

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in the JSON")

    data = json.loads((folder / "m.json").read_text(), parse_constant=refuse)
    assert (data["scene"], data["count"], data["done"]) == ("two UR5s carry a box", 6, 6)
    assert data["statuses"] == {"completed": 6}
    force = load_sweep(folder / "m.sweep").table["largest_contact_force"]
    own = next(one for one in data["spreads"] if one["name"] == "largest_contact_force")
    assert (own["unit"], own["largest"], own["largest_run"]) == (
        "N",
        force.max(),
        force.argmax() + 1,
    )
    assert own["quantiles"]["0.5"] == pytest.approx(np.median(force), rel=1e-14)
    written = {kind: str(folder / f"m.{kind}") for kind in ("csv", "parquet")}
    assert data["files"] == {
        "result": str(folder / "m.sweep"), "plot": str(folder / "m.svg"), **written
    }  # fmt: skip


def test_the_table_of_quantities_fits_a_terminal_of_usual_width(made):
    sweep = load_sweep(made[0] / "m.sweep")
    console = Console(width=80, file=io.StringIO())
    console.print(spread_table(sweep.summary()))
    text = console.file.getvalue()
    for own in sweep.summary().spreads:
        (line,) = [line for line in text.splitlines() if line.strip().startswith(own.name)]
        assert f"[{own.unit}]" in line and f"{own.largest:.3g}" in line


def test_the_same_command_finds_everything_done(made):
    folder, _ = made
    before = load_sweep(folder / "m.sweep").table["wall_time"]
    words = "sweep", SCENE, "--over", folder / "masses.yaml", "--out", folder / "m.sweep"
    assert multiarm(*words, "-q").output == ""
    assert load_sweep(folder / "m.sweep").table["wall_time"].tolist() == before.tolist()


@pytest.mark.slow
def test_a_sweep_killed_among_its_runs_and_resumed_ends_with_the_same_table(tmp_path):
    over, out, whole = (tmp_path / name for name in ("s.yaml", "killed.sweep", "whole.sweep"))
    over.write_text(SWEEP + "keep: [final_z, 'own.py:killing']\n")
    (tmp_path / "own.py").write_text(KILLING)
    words = ["sweep", SCENE, "--over", over, "--repeat", 8, "--workers", 1, "-q"]
    called = [sys.executable, "-m", "multiarm", *map(str, words), "--out", str(out)]
    assert subprocess.run(called).returncode == -signal.SIGKILL
    safe = load_sweep(out)
    assert 1 <= len(safe) < 14
    for target in (out, whole):
        assert multiarm(*words, "--out", target).exit_code == 0
    assert same_table(out, whole)
    found = load_sweep(out).table
    kept = found[found["run"].isin(safe.runs)]
    assert kept["wall_time"].tolist() == safe.table["wall_time"].tolist()
    assert len(set(found["worker"])) == 2


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(made, tmp_path, monkeypatch):
    folder, _ = made
    out = tmp_path / "m.sweep"
    words = ["sweep", SCENE, "--over", folder / "masses.yaml", "--out", out, "--workers", 1]

    def pressed(self, done: int, total: int, failed: int = 0) -> None:
        if done >= 1:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(SweepProgress, "__call__", pressed)
        called = multiarm(*words)
    assert called.exit_code == 1
    safe = len(load_sweep(out))
    assert 1 <= safe < 6
    told = f"interrupted: {safe} of 6 runs in '{out}'; the same command resumes from there"
    assert told in called.output
    assert multiarm(*words).exit_code == 0
    assert same_table(out, folder / "m.sweep")


@pytest.mark.slow
def test_a_run_that_fails_is_told_and_ends_nothing(tmp_path):
    over, out = tmp_path / "far.yaml", tmp_path / "far.sweep"
    over.write_text(
        "over: {arms.left.base.xyz: [[0.0, 9.0, 0.0], [-1.1, 0.0, 0.0]]}\n"
        "run: {duration: 0.02, accuracy: 1e-3, arms: compiled}\ncertificate: false\n"
    )
    called = multiarm("sweep", SCENE, "--over", over, "--out", out, "--workers", 1)
    sweep = load_sweep(out)
    assert (sweep.complete, called.exit_code) == (True, 0)
    assert sweep.status_counts == {"completed": 1, "failed": 1}
    (line,) = trouble_lines(sweep.summary())
    assert line.startswith("run 1 failed: the run could not begin: ")
    assert f"warning: {line.splitlines()[0]}" in called.output
    with pytest.raises(ma.MultiarmError, match="'left'"):
        sweep.trajectory(1)


def test_runs_that_fail_alike_are_one_line_and_of_very_many_kinds_the_first_are_told():
    spread = SweepSummary(
        count=9, done=9, statuses={"completed": 2, "failed": 7}, wall_time=0.0, spreads=(),
        failures=(Failure("failed", "too far", 4, 3), Failure("failed", "odd", 1, 5)),
    )  # fmt: skip
    assert trouble_lines(spread) == [
        "run 3 and 3 more failed: too far", "run 5 failed: odd", "and 2 more runs did not complete"
    ]  # fmt: skip


def test_a_sweep_of_which_no_run_completes_is_an_error(tmp_path):
    over, out = tmp_path / "far.yaml", tmp_path / "far.sweep"
    over.write_text("over: {arms.left.base.xyz: [[0.0, 9.0, 0.0]]}\n")
    called = multiarm("sweep", SCENE, "--over", over, "--out", out, "--workers", 1)
    assert called.exit_code == 1
    assert f"no run completed; the rows in '{out}' say why" in called.output


# One run of it


@pytest.mark.slow
def test_what_cannot_be_drawn_costs_no_table(tmp_path):
    """Nothing is kept of the runs: the figures are written all the same, and the plot is told."""
    (tmp_path / "few.yaml").write_text(SWEEP + "keep: []\n")
    out, files = tmp_path / "few.sweep", {k: tmp_path / f"few.{k}" for k in ("png", "csv", "json")}
    result = multiarm(
        "sweep", SCENE, "--over", tmp_path / "few.yaml", "--out", out, "--workers", 1,
        "--plot", files["png"], "--csv", files["csv"], "--json", files["json"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "nothing was drawn" in " ".join(result.stderr.split())
    assert len(files["csv"].read_text().splitlines()) == 7
    assert json.loads(files["json"].read_text())["files"].keys() == {"result", "csv"}
    assert not files["png"].exists()


@pytest.mark.slow
def test_a_run_of_which_numbers_failed_says_so_when_it_is_looked_at(tmp_path):
    (tmp_path / "q.py").write_text("def f(trajectory):\n    raise ValueError('bad')\n")
    (tmp_path / "bad.yaml").write_text(SWEEP + "keep: ['q.py:f']\n")
    out = tmp_path / "bad.sweep"
    multiarm("sweep", SCENE, "--over", tmp_path / "bad.yaml", "--out", out, "--workers", 1)
    result = multiarm("replay", out, "--run", 2, "--html", tmp_path / "a.html")
    assert result.exit_code == 0, result.output
    assert "this run is a failed one of the sweep" in " ".join(result.stderr.split())


def test_a_run_made_once_more_is_the_run_that_was_made(made):
    sweep = load_sweep(made[0] / "m.sweep")
    for run in (2, 5):
        trajectory = sweep.trajectory(run)
        assert trajectory.status == "completed"
        row = sweep.table.loc[run - 1]
        assert measure(sweep.plan.spec.keep, trajectory)[0] == row[[*sweep.quantities]].to_dict()
        assert sweep.scene_of(run).object.mass == row["object.mass"]
        assert sweep.values_of(run) == row[[*sweep.paths]].to_dict()


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_a_run_is_replayed_and_reported_by_its_number(made, tmp_path):
    sweep, html = made[0] / "m.sweep", tmp_path / "r.html"
    called = multiarm("replay", sweep, "--run", 3, "--html", html)
    assert called.exit_code == 0, called.output
    assert "simulating run 3: object.mass = 27.5" in called.output
    assert html.stat().st_size > 100_000
    called = multiarm("report", sweep, "--run", 3, "--html", tmp_path / "report.html")
    assert called.exit_code == 0, called.output
    assert "27.5" in (tmp_path / "report.html").read_text()


def test_without_a_number_the_commands_say_what_to_do(made, tmp_path):
    sweep = made[0] / "m.sweep"
    for command in ("replay", "report"):
        called = multiarm(command, sweep)
        assert called.exit_code == 2
        assert f"'{sweep}' is a sweep of 6 runs; choose the one to show: --run 1" in called.output
        called = multiarm(command, sweep, "--run", 7)
        assert (called.exit_code, "there is no run 7; runs are 1 to 6" in called.output) == (
            2,
            True,
        )
    single = load_sweep(sweep).trajectory(1).save(tmp_path / "run.h5")
    called = multiarm("report", single, "--run", 1)
    assert called.exit_code == 2
    assert f"--run: '{single}' is the result of one run, not of a sweep" in called.output


# Refused


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--plot", "m.jpg"], "--plot: 'm.jpg' ends in none of .png, .svg, .pdf"),
        (["--csv", "{over}"], "--csv: '{over}' is the file that is read"),
        (["--csv", "none/m.csv"], "--csv: cannot write 'none/m.csv': there is no folder"),
        (["--out", "{scene}"], "'{scene}' exists and is not the folder of a sweep"),
        (["--out", "{made}", "--seed", "8"], "sweep: -seed: 7\n  sweep: +seed: 8"),
        (["--dask", "tcp://127.0.0.1:1", "--workers", "2"], "workers and dask exclude each other"),
    ],
)
def test_what_cannot_be_done_is_said_before_any_run(made, words, told):
    folder, _ = made
    places = {"over": folder / "masses.yaml", "scene": SCENE, "made": folder / "m.sweep"}
    before = load_sweep(folder / "m.sweep").table
    called = multiarm(
        "sweep", SCENE, "--over", places["over"], *(word.format(**places) for word in words)
    )
    assert called.exit_code == 2
    assert told.format(**places) in called.output
    assert load_sweep(folder / "m.sweep").table.equals(before)


def test_a_sweep_with_faults_is_one_message_with_all_of_them(tmp_path):
    over = tmp_path / "s.yaml"
    over.write_text("over: {object.mas: [1, 2], object.mass: [-1, 5]}\nseeed: 3\nkeep: [energ]\n")
    called = multiarm("sweep", SCENE, "--over", over, "--out", tmp_path / "s.sweep")
    assert called.exit_code == 2
    for told in (str(over), "$.over['object.mas']", "$.over['object.mass']", "seeed", "energ"):
        assert told in called.output
    assert called.output.count("error:") == 1
    assert not (tmp_path / "s.sweep").exists()


# Watched


def test_the_end_is_estimated_from_the_pace_of_the_runs_made_here(monkeypatch):
    clock, printed = [100.0], []
    monkeypatch.setattr("multiarm.terminal.progress.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("multiarm.terminal.bar.process_running_time", lambda: clock[0])
    bar = SweepProgress()
    for seconds, done in [(0, 500), (60, 510), (100, 610), (140, 710), (180, 1000)]:
        clock[0] = 100.0 + seconds
        bar(done, 1000, 3)
        printed.append(bar._line())
    # 200 runs in the 80 s after the first ten, which came with compiling: 290 take 116 s
    assert printed[0] == "500 of 1,000 runs, 3 failed, 50 %, 0 s so far"
    assert printed[3].startswith("710 of 1,000 runs, 3 failed, 71 %, about 2 min left, ends ")
    assert printed[4] == "1,000 of 1,000 runs, 3 failed, 100 %, 3 min so far"
    assert all(
        text.startswith(f"{n} of") for text, n in zip(printed, (500, 510, 610), strict=False)
    )


@pytest.mark.slow
def test_the_commands_result_is_what_python_gives(made, tmp_path):
    folder, _ = made
    sweep = ma.sweep(SCENE, folder / "masses.yaml", out=tmp_path / "p.sweep", workers=1)
    assert same_table(sweep.path, folder / "m.sweep")
