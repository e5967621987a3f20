"""Claims about the command line: what is printed, what is written, how it ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

import pytest
import yaml
from commands import figures, multiarm, promised_keys
from mechanics import planar_pair
from repository import ROOT, SCENES
from rich.console import Console
from typer.main import get_command

import multiarm as ma
from multiarm.cli import app, check, run
from multiarm.errors import ControlError
from multiarm.jit.compilation import compiling
from multiarm.scene import RunSpec, StabilizationSpec, dump_scene
from multiarm.scene.settings import MEANINGS
from multiarm.simulation.interrupts import deferred_interrupt
from multiarm.terminal.progress import Progress, RunProgress

TWO_UR5 = SCENES / "two_ur5_box.yaml"
PATIENCE = 300.0  # [s] for another process, which may have to compile the kernels first
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def start(*words: object, **options) -> subprocess.Popen:
    """Start the program in a process of its own."""
    command = [sys.executable, "-m", "multiarm", *(str(word) for word in words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=ENVIRONMENT, **pipes, **options)


def scene_file(folder: Path, **changes: object) -> Path:
    """The scene of two UR5s with some entries (``a__b__0``) replaced, None removes one."""
    data = yaml.safe_load(TWO_UR5.read_text(encoding="utf-8"))
    for where, value in changes.items():
        *way, last = [int(part) if part.isdigit() else part for part in where.split("__")]
        table = data
        for part in way:
            table = table[part]
        if value is None:
            del table[last]
        else:
            table[last] = value
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def one_arm(folder: Path, kind: str, **changes: object) -> Path:
    """The left UR5 alone at the end of the box."""
    alone = {
        "arms__right": None,
        "joints": [{"arm": "left", "kind": kind}],
        "run": {"duration": 0.1},
    }
    return scene_file(folder, **alone, control={"kind": "gravity_compensation"}, **changes)


def assert_refused(result, *fragments: str) -> None:
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert "Traceback" not in result.output
    for fragment in fragments:
        assert fragment in result.stderr


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A completed run with all its files: (folder, result of the command)."""
    folder = tmp_path_factory.mktemp("run")
    result = multiarm(
        "run", TWO_UR5, "--duration", 0.2, "--out", folder / "run.h5",
        "--json", folder / "run.json", "--replay-html", folder / "replay.html",
        "--report-html", folder / "report.html",
    )  # fmt: skip
    return folder, result


# --- help ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_module_and_command_are_one_program():
    program = start("--version")
    out, _ = program.communicate(timeout=60)
    assert (program.returncode, out) == (0, multiarm("--version").stdout)
    assert out.strip() == f"multiarm {ma.__version__}"


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error_worth_a_message():
    """As in ``multiarm joints | head``."""
    program = start("joints")
    program.stdout.close()
    _, error = program.communicate(timeout=60)
    assert (program.returncode, error) == (1, "")


@pytest.mark.parametrize(
    "command",
    sorted(get_command(app).commands),
)
def test_every_command_has_help(command):
    result = multiarm(command, "--help")
    assert result.exit_code == 0
    assert f"multiarm {command}" in result.stdout


def literals(annotation) -> set:
    """The choices in a type, however deep they stand in it."""
    if get_origin(annotation) is Literal:
        return set(get_args(annotation))
    return set().union(*map(literals, get_args(annotation)))


def test_every_setting_of_a_run_is_an_option_with_its_choices():
    options = get_type_hints(run, include_extras=True)
    assert set(RunSpec.model_fields) == set(MEANINGS) < set(options)
    for name, field in RunSpec.model_fields.items():
        table = StabilizationSpec.model_fields["kind"] if name == "stabilization" else field
        value, option = get_args(options[name])
        assert literals(value) == literals(table.annotation), name
        assert option.help.startswith(MEANINGS[name]), name
    assert float in get_args(get_args(options["accuracy"])[0])


# --- run ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_run_keeps_the_result_and_says_where(finished):
    folder, result = finished
    assert result.exit_code == 0, result.output
    trajectory = ma.load_trajectory(folder / "run.h5")
    assert trajectory.status == "completed"
    assert trajectory.time[-1] == pytest.approx(0.2)
    for text in (
        "completed",
        "position drift",
        "energy balance",
        "largest forces, right",
        "N at a contact",
        "written",
    ):
        assert text in result.stdout
    for page in ("replay.html", "report.html"):
        assert (folder / page).read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype")


@pytest.mark.slow
def test_json_of_a_run_is_what_the_help_promises(finished):
    folder, _ = finished
    data = figures(folder / "run.json")
    assert set(data) == promised_keys(run)
    summary = ma.load_trajectory(folder / "run.h5").summary()
    assert {key: data[key] for key in summary} == summary
    assert set(data["files"]) == {"result", "replay", "report"}


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_an_object_without_a_shape_goes_through_all_commands(tmp_path):
    """Mass and inertia are all that its motion needs."""
    body = {"mass": 20.0, "inertia": [0.9, 2.7, 3.0], "pose": {"xyz": [0, 0, 0.5]}}
    file = scene_file(tmp_path, object=body, run={"duration": 0.02})
    out, page = tmp_path / "run.h5", tmp_path / "page.html"
    for words in (
        ("check", file), ("grasp", "check", file),
        ("run", file, "--out", out, "--replay-html", page),
        ("report", out, "--html", page), ("effects", file, "--candidates", "--rounds", 1),
    ):  # fmt: skip
        result = multiarm(*words)
        assert result.exit_code == 0 and "Error" not in result.stderr, (words, result.stderr)


def test_result_is_named_after_the_scene_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = multiarm("run", TWO_UR5, "--duration", 0.02, "--quiet")
    assert (result.exit_code, result.stdout) == (0, "")
    assert ma.load_trajectory("two_ur5_box.h5").status == "completed"


def test_run_tells_what_a_completed_run_must_not_hide(tmp_path):
    """A start that was mended, a hinge that passes its limits, a tip that is pulled."""
    tip = {"point": [0, 0, 0.005]}
    hinge = {"arm": "left", "kind": "revolute", "axis": [0, 1, 0], "limits": [-1e-4, 1e-4]}
    face = {"plane": {"point": [0.6, 0, 0], "normal": [1, 0, 0]}}
    finger = {"arm": "right", "kind": "contacts", "contacts": [{"arm": tip, "object": face}]}
    path = scene_file(tmp_path, joints__0=hinge, joints__1=finger, control={"kind": "none"})
    result = multiarm("run", path, "--duration", 0.3, "--out", tmp_path / "run.h5")
    assert result.exit_code == 0, result.output
    told = " ".join(result.stderr.split())
    assert "the written start was 0.005 m off at arm 'right' and was assembled" in told
    assert "joints passed their limits, which are not enforced: left: joint, turn z" in told
    events = ma.load_trajectory(tmp_path / "run.h5").events
    assert {"passes its limit"} <= {event["kind"] for event in events}


def test_run_that_fails_keeps_its_data_and_names_a_remedy(tmp_path):
    out = tmp_path / "run.h5"
    result = multiarm(
        "run",
        TWO_UR5,
        "--integrator",
        "rk4",
        "--step",
        0.2,
        "--stabilization",
        "none",
        "--out",
        out,
    )
    assert result.exit_code == 1
    message = ma.load_trajectory(out).message
    assert f"error: the run failed: {message}" in result.stderr
    assert ma.load_trajectory(out).status == "failed"


@pytest.mark.slow
def test_ctrl_c_ends_a_run_in_good_order(tmp_path):
    out, summary = tmp_path / "run.h5", tmp_path / "run.json"
    program = start("run", TWO_UR5, "--duration", 1e5, "--out", out, "--json", summary)
    try:
        deadline = time.monotonic() + PATIENCE
        while not (out.exists() and len(ma.load_trajectory(out))):  # a checkpoint
            assert program.poll() is None and time.monotonic() < deadline
            time.sleep(0.2)
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=30)
    finally:
        program.kill()
    assert program.returncode == 1
    assert "error: the run was interrupted" in errors and "Traceback" not in errors
    trajectory = ma.load_trajectory(out)
    assert trajectory.status == "interrupted" and len(trajectory) > 0
    assert figures(summary)["samples"] == len(trajectory)


def test_ctrl_c_is_noted_where_raising_would_lose_it():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt() as interrupt:
        assert not interrupt.pressed
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.pressed
        with pytest.raises(KeyboardInterrupt):  # the second one acts as ever
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_before_a_part_that_notes_it_too_is_noted_there():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt() as whole:
        os.kill(os.getpid(), signal.SIGINT)
        with deferred_interrupt() as part:
            assert part.pressed
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
        assert whole.pressed
    assert signal.getsignal(signal.SIGINT) is before


def test_a_handler_of_a_program_around_python_stays(monkeypatch):
    """It could not be put back."""
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(signal, "getsignal", lambda number: None)
    with deferred_interrupt() as interrupt:
        pass
    monkeypatch.undo()
    assert not interrupt.pressed and signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
def test_a_pipe_gets_a_plain_line_every_few_seconds(monkeypatch):
    pipe = StringIO()
    monkeypatch.setattr("multiarm.terminal.console.messages", lambda: Console(file=pipe, width=80))
    monkeypatch.setattr("multiarm.terminal.progress.LINES", 0.05)
    with Progress() as progress:
        progress(0, 4, "first")
        time.sleep(0.12)
        progress(1, 4, "second")
        time.sleep(0.2)
        progress(2, 4, "third")
        time.sleep(0.2)
    lines = pipe.getvalue().splitlines()
    time.sleep(0.1)
    assert lines == pipe.getvalue().splitlines(), "nothing comes after the end"
    assert re.fullmatch(r"first, 0 of 4, 0 s so far", lines[0])
    assert re.fullmatch(r"third, 2 of 4, about \d s left", lines[-1])
    assert 6 <= len(lines) <= 12 and "\x1b" not in pipe.getvalue()


@pytest.mark.slow
def test_simulate_shows_progress_on_request(welded_ur5_system, capsys, monkeypatch):
    monkeypatch.setattr("multiarm.terminal.progress.LINES", 0.02)
    ma.simulate(welded_ur5_system, 2.0, step=1e-4, integrator="rk4", progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert any(re.match(r"simulating, \S+ of 2 s, \S+ x real time", line) for line in lines)
    ma.simulate(welded_ur5_system, 0.1, progress=False)
    assert capsys.readouterr().err == ""


def test_progress_says_that_kernels_are_compiled_while_they_are(monkeypatch):
    pipe = StringIO()
    monkeypatch.setattr("multiarm.terminal.console.messages", lambda: Console(file=pipe, width=80))
    with RunProgress(3.0) as progress:
        progress(0.5)
        progress(1.0)
        before = progress._line()
        with compiling():
            time.sleep(0.05)
            during = progress._line()
        progress(1.5)
        after = progress._line()
    assert before.startswith("simulating, 1 of 3 s, ")
    assert during.startswith("compiling kernels (only the first time on this machine), 1 of 3 s")
    assert after.startswith("simulating, 1.5 of 3 s, ")
    (rate,) = re.findall(r"(\S+) x real time", after)
    assert float(rate) > 100.0, "1 s in some microseconds: the 50 ms of the compiler do not count"


def test_the_estimate_of_a_run_that_is_checked_afterwards_ends_with_the_check(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("multiarm.terminal.bar.process_running_time", lambda: clock[0])
    progress = RunProgress(40.0)
    progress.checked = True
    for step in range(4):
        progress(10.0 * step)
        clock[0] += 6.0
    assert progress._line().endswith(" x real time, about 6 s until its accuracy is checked")
    for step in range(4):
        progress.checking(10.0 * step, 1)
        clock[0] += 6.0
    assert progress._line().endswith(" x real time, about 6 s left")


def test_the_time_left_follows_parts_of_the_work_that_take_longer_than_those_before(monkeypatch):
    """Four parts of a minute each are left; by the average of all parts it would be 78 s."""
    clock, lines = [0.0], []
    monkeypatch.setattr("multiarm.terminal.progress.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("multiarm.terminal.bar.process_running_time", lambda: clock[0])
    progress = Progress()
    for done in range(13):  # the last parts take ten times as long
        progress(done, 16, "working")
        lines.append(progress._line())
        clock[0] += 60.0 if done > 8 else 6.0
    assert lines[8] == "working, 8 of 16, about 48 s left"
    assert lines[10] == "working, 10 of 16, 2 min so far", "parts of both kinds tell nothing"
    assert lines[12].startswith("working, 12 of 16, about 4 min left, ends ")


def test_work_that_crawls_ends_beyond_all_calendars(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("multiarm.terminal.bar.process_running_time", lambda: clock[0])
    progress = Progress()
    for done in range(4):
        progress(done, 1e12, "working")
        clock[0] += 60.0
    assert progress._line() == "working, 3 of 1000000000000, about 694,444,444 days left"


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_an_arm_with_too_few_joints_runs(tmp_path, solver):
    changes = {"arms": {"left": {"robot": "planar_2r", "tip": "tip", "posture": [0.3, 0.8]}}}
    changes |= {"joints": [{"arm": "left", "kind": "weld"}], "control": {"kind": "none"}}
    path = scene_file(tmp_path, **changes)
    options = ("run", path, "--duration", 0.1, "--out", tmp_path / "run.h5")
    result = multiarm(*options, "--solver", solver)
    assert result.exit_code == 0, result.output


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("check", SCENES / "grasped_block.yaml"),
        ("grasp", "check", SCENES / "corner_grippers_block.yaml"),
        ("stability", "--list"),
        ("controls",),
    ],
    ids=lambda words: words[0],
)
def test_tables_fit_eighty_columns_without_breaking_words(words, monkeypatch):
    printed = []
    for width in ("80", "1000"):
        monkeypatch.setenv("COLUMNS", width)
        result = multiarm(*words)
        assert result.exit_code == 0, result.output
        printed.append(result.stdout)
    assert max(len(line.rstrip()) for line in printed[0].splitlines()) <= 80
    narrow, wide = (set(re.findall(r"[^\W\d_][^\W\d]{2,}", text)) for text in printed)
    assert narrow <= wide


# --- check --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "freedom", "constraints"),
    [
        ("two_ur5_box", 6 + 2 * 6, 2 * 6),
        ("three_panda_plate", 6 + 3 * 7, 3 * 3),
        ("corner_grippers_block", 6 + 2 * 6, 2 * 4),
    ],
)
def test_check_counts_the_freedom_of_the_examples(scene, freedom, constraints, tmp_path):
    path = tmp_path / "check.json"
    result = multiarm("check", SCENES / f"{scene}.yaml", "--json", path)
    assert result.exit_code == 0, result.output
    data = figures(path)
    assert set(data) == promised_keys(check)
    found = data["freedom"]
    assert (found["degrees_of_freedom"], found["constraints"]) == (freedom, constraints)
    assert found["rank"] == constraints and found["redundant_rows"] == []
    assert found["mobility"] == freedom - constraints
    assert {arm["verdict"] for arm in data["arms"].values()} == {"good"}
    assert data["carrying"]["possible"] and data["carrying"]["control"]["largest"] < 1.0
    for joint in data["joints"]:
        assert joint["kind"] in result.stdout
    for arm in data["arms"].values():
        assert all(name in result.stdout.replace("\n", "") for name in arm["joints"])


def test_check_names_redundant_contacts(tmp_path):
    def on_top(x: float, y: float) -> dict:
        tip = {"point": [x, y, 0.0]}
        return {"arm": tip, "object": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}

    corners = [on_top(x, y) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    path = one_arm(tmp_path, "weld", run__solver="dense", object__pose={"xyz": [0.0, 0.0, 0.0]})
    data = yaml.safe_load(path.read_text())
    system = ma.compile_system(ma.Scene(**data))
    tip = system.arms["left"].tip_pose(system.initial_state().joint_positions["left"])
    data["object"]["pose"] = {"xyz": tip[:3, 3].tolist(), "quaternion_xyzw": [0, 0, 0, 1]}
    turn = {"rpy": _roll_pitch_yaw(tip[:3, :3].T)}
    data["joints"] = [{"arm": "left", "kind": "contacts", "at_tip": turn, "contacts": corners}]
    path.write_text(yaml.safe_dump(data))
    result = multiarm("check", path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    found = figures(tmp_path / "check.json")["freedom"]
    assert (found["constraints"], found["rank"], found["mobility"]) == (4, 3, 9)
    assert found["redundant_rows"] == [f"left: contact {k}" for k in (1, 2, 3, 4)]
    assert found["largest_dropped"] < 1e-12 < 1e-3 < found["smallest_kept"]
    assert "1 too many among" in result.stdout
    (joint,) = figures(tmp_path / "check.json")["joints"]
    assert joint["rank"] == 3
    assert joint["redundant_rows"] == [f"contact {k}" for k in (1, 2, 3, 4)]
    assert joint["free_motions"] == ["slide along x and y", "turn about z"]


def test_check_tells_what_each_joint_leaves_free_and_where_it_starts(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    hinge = {"arm": "left", "kind": "revolute", "axis": [1, 1, 0], "limits": [-0.3, 0.9]}
    path = scene_file(tmp_path, joints=[hinge, {"arm": "right", "kind": "universal"}])
    result = multiarm("check", path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    left, right = figures(tmp_path / "check.json")["joints"]
    assert (len(left["rows"]), left["rank"], left["redundant_rows"]) == (5, 5, [])
    assert (left["free_motions"], left["coordinates"]) == (["turn about z"], ["turn z"])
    assert (right["rank"], right["free_motions"]) == (4, ["turn about x and y"])
    (limit,) = left["limits"]
    assert (limit["coordinate"], limit["unit"]) == ("turn about z", "rad")
    assert (limit["low"], limit["high"]) == (-0.3, 0.9)
    assert abs(limit["start"]) < 1e-9 and right["limits"] == []
    assert "5, rank 5" in result.stdout and "4, rank 4" in result.stdout
    assert "turn about z: -0.3 to 0.9 rad, starts at 0" in result.stdout


def test_rows_that_only_the_closed_loop_makes_redundant_are_not_laid_to_a_joint(tmp_path):
    path = tmp_path / "planar.yaml"
    path.write_text(dump_scene(planar_pair("planar_3r", [0.3, 0.8, 0.2], {"kind": "weld"})))
    result = multiarm("check", path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    found = figures(tmp_path / "check.json")
    for joint in found["joints"]:
        assert (joint["rank"], joint["redundant_rows"], joint["free_motions"]) == (6, [], [])
    # twelve rows on 6 + 2 x 3 freedoms, of which motions in the plane leave 9 - 6
    freedom = found["freedom"]
    assert (freedom["constraints"], freedom["rank"], freedom["mobility"]) == (12, 9, 3)
    assert {name.split(":")[0] for name in freedom["redundant_rows"]} == {"left", "right"}
    assert "3 too many among" in result.stdout


def _roll_pitch_yaw(rotation) -> list[float]:
    from math import atan2, hypot

    pitch = atan2(-rotation[2, 0], hypot(rotation[0, 0], rotation[1, 0]))
    roll, yaw = atan2(rotation[2, 1], rotation[2, 2]), atan2(rotation[1, 0], rotation[0, 0])
    return [float(angle) for angle in (roll, pitch, yaw)]


def test_check_tells_whether_the_contacts_can_carry_the_object(tmp_path):
    path = tmp_path / "check.json"
    light = one_arm(tmp_path, "weld", object__mass=2.0)
    assert multiarm("check", light, "--json", path).exit_code == 0
    assert figures(path)["carrying"]["possible"]
    # 20 kg at its end, half a metre from the flange, are too much for a UR5
    result = multiarm("check", one_arm(tmp_path, "weld"), "--json", path)
    carrying = figures(path)["carrying"]
    assert carrying["verdict"] == "effort" and carrying["least"]["largest"] > 1.0
    assert carrying["least"]["joint"] in result.stdout
    assert "too weak" in result.stderr and carrying["least"]["joint"] in result.stderr
    # the centre of mass is beside the ball, which bears no moment
    result = multiarm("check", one_arm(tmp_path, "ball"), "--json", path)
    carrying = figures(path)["carrying"]
    assert not carrying["possible"]
    assert max(carrying["force_residual"], carrying["moment_residual"]) > 1.0
    assert "cannot be carried" in result.stdout


def test_check_sees_a_wrist_that_is_nearly_singular(tmp_path):
    path = one_arm(tmp_path, "weld", arms__left__posture__wrist_2_joint=1e-3)
    result = multiarm("check", path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    assert figures(tmp_path / "check.json")["arms"]["left"]["verdict"] == "near singular"
    assert "near singular" in result.stdout


@pytest.mark.parametrize(
    "settings",
    [
        {"duration": 0.1, "accuracy": 1e-2},
        {"duration": 0.1},
        {"duration": 0.1, "integrator": "dopri5", "tolerance": 1e-7, "stabilization": "none"},
        {"duration": 0.1, "integrator": "dop853"},
        {"duration": 0.1, "integrator": "rk4", "step": 1e-3, "stabilization": "feedback"},
    ],
)
def test_settings_that_check_resolves_are_those_of_the_run(settings, tmp_path):
    path = scene_file(tmp_path, run=settings)
    checked, ran = tmp_path / "check.json", tmp_path / "run.json"
    assert multiarm("check", path, "--json", checked).exit_code == 0
    options = ("--out", tmp_path / "run.h5", "--json", ran, "--quiet")
    assert multiarm("run", path, *options).exit_code == 0
    keys = ("integrator", "tolerance", "accuracy", "stabilization", "solver")
    facts, used = figures(checked)["run"], figures(ran)
    assert {key: facts[key] for key in keys} == {key: used[key] for key in keys}


def test_warnings_of_a_scene_are_shown(tmp_path):
    path = one_arm(tmp_path, "weld", arms__left__posture__elbow_joint=3.5)
    result = multiarm("check", path)
    assert "warning: " in result.stderr and "outside its limits" in result.stderr


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "fragments"),
    [
        ({"arms__left__robot": "ur55"}, ["$.arms.left.robot", "'ur55'", "'ur5'"]),
        ({"joints__1__arm": "rigth"}, ["$.joints[1].arm", "'rigth'", "'right'"]),
        ({"joints__0__at": {"xyz": [0.6, 0, 0]}}, ["'left'", "gap", "m is left"]),
        (
            {"object__mass": 0, "joints__0__arm": "lefft"},
            ["3 faults", "$.object.mass", "$.joints[0].arm", "arm 'left'"],
        ),
    ],
)
def test_faults_of_a_scene_are_named_with_place_and_remedy(changes, fragments, tmp_path):
    assert_refused(multiarm("check", scene_file(tmp_path, **changes)), *fragments)


def test_run_refuses_what_check_refuses(tmp_path):
    path = scene_file(tmp_path, joints__1__arm="rigth")
    refused = multiarm("run", path, "--out", tmp_path / "run.h5")
    assert_refused(refused, "$.joints[1].arm")
    assert refused.stderr == multiarm("check", path).stderr
    assert not (tmp_path / "run.h5").exists()


def test_scene_files_that_are_none_are_refused(tmp_path):
    assert_refused(multiarm("check", tmp_path / "none[red].yaml"), "none[red].yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("arms: {left: [\n")
    assert_refused(multiarm("check", broken), "line 2", "not YAML")
    assert_refused(multiarm("run", tmp_path), str(tmp_path))


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (["--duration", "-1"], ["--duration", "greater than 0"]),
        (["--accuracy", "nan"], ["--accuracy", "finite"]),
        (["--step", "1e-3"], ["'step' needs an integrator"]),
    ],
)
def test_settings_that_do_not_fit_are_refused(options, fragments, tmp_path):
    result = multiarm("run", TWO_UR5, "--out", tmp_path / "run.h5", *options)
    assert_refused(result, *fragments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["--out", "--json", "--replay-html", "--report-html"])
def test_places_that_cannot_be_written_are_found_before_the_work(option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "multiarm.assembly.compilation.compile_system", None
    )  # the work must not begin
    scene = scene_file(tmp_path)
    before = scene.read_bytes()
    for place, fragment in [
        (tmp_path / "nowhere" / "x", "there is no folder"),
        (tmp_path, "it is a folder"),
        (scene, "the file that is read"),
        (Path(os.devnull), "not an ordinary file"),
    ]:
        assert_refused(multiarm("run", scene, option, place), option, str(place), fragment)
    assert scene.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [scene.name]


def test_two_outputs_in_one_file_are_refused(tmp_path):
    same = tmp_path / ".." / tmp_path.name / "x"
    result = multiarm("run", TWO_UR5, "--out", tmp_path / "x", "--json", same)
    assert_refused(result, "--json", "already written by --out")


def test_a_foreign_file_is_not_replaced_by_a_result(tmp_path):
    foreign = tmp_path / "thesis.h5"
    foreign.write_text("precious")
    assert_refused(multiarm("run", TWO_UR5, "--out", foreign), "thesis.h5", "another name")
    assert foreign.read_text() == "precious"


def test_torques_of_wrong_shape_are_refused():
    system = ma.compile_system(ma.load_scene(TWO_UR5))
    with pytest.raises(ControlError, match=r"torques\['left'\]: expected shape \(6,\), got \(2,\)"):
        ma.simulate(system, duration=0.1, control=lambda t, state: {"left": [0.0, 0.0]})


def test_an_unexpected_exception_is_not_hidden(monkeypatch):
    def fail(*_):
        raise RuntimeError("a bug")

    monkeypatch.setattr("multiarm.simulation.inspection.inspect_system", fail)
    result = multiarm("check", TWO_UR5)
    assert isinstance(result.exception, RuntimeError)


# --- results ------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["replay", "report"])
def test_files_that_are_no_results_are_refused(command, finished, tmp_path):
    place = "--html"

    def tried(path):
        return multiarm(command, path, place, tmp_path / "page.html")

    folder, _ = finished
    assert_refused(tried(tmp_path / "none.h5"), "none.h5", "no such file")
    assert_refused(tried(TWO_UR5), "is a scene", "multiarm run")
    assert_refused(tried(folder / "run.json"), "not an HDF5 file")
    cut = tmp_path / "cut.h5"
    cut.write_bytes((folder / "run.h5").read_bytes()[:30_000])
    assert_refused(tried(cut), "cut.h5", "damaged or was cut short")
    assert_refused(multiarm(command, folder / "run.h5", place, tmp_path), "it is a folder")
    assert not (tmp_path / "page.html").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_pages_are_written_from_a_result(finished, tmp_path):
    folder, _ = finished
    page = tmp_path / "page.html"
    assert multiarm("replay", folder / "run.h5", "--html", page, "--fps", 20).exit_code == 0
    assert "<html" in page.read_text(encoding="utf-8")
    result = multiarm("report", folder / "run.h5", "--html", page)
    assert (result.exit_code, result.stdout.strip()) == (0, f"report written to {page}")


def test_replay_rejects_a_speed_that_is_none(finished, tmp_path):
    folder, _ = finished
    result = multiarm("replay", folder / "run.h5", "--html", tmp_path / "x.html", "--speed", 0)
    assert_refused(result, "speed", "from 1e-09")
