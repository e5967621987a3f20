"""Robots can do what the scenes that we show do: no drive, speed or range is beyond its limit."""

from __future__ import annotations

import re
import shlex

import numpy as np
import pytest
from commands import multiarm
from repository import ROOT, SCENES

import multiarm as ma
from multiarm.problems.first_scene import first_scene
from multiarm.results.limit_use import joint_uses, limit_warnings, peaks
from multiarm.scene import parse_scene

SOLVED = sorted((ROOT / "examples" / "solved").glob("*.yaml"))
FIRST = {  # what ``multiarm new`` writes
    "one panda": (["panda"], "weld", "box"),
    "two ur5": (["ur5", "ur5"], "weld", "box"),
    "two panda": (["panda", "panda"], "ball", "sphere"),
    "ur5 and panda": (["ur5", "ur5", "panda"], "weld", "cylinder"),
}
TIE = 1e-6
"""Part by which the search tells postures apart; roundings move joints by less [rad]."""


def run_of(scene: ma.Scene) -> ma.Trajectory:
    return ma.simulate(ma.compile_system(scene), certificate=False)


def assert_within_limits(run: ma.Trajectory) -> None:
    largest = peaks(joint_uses(run))
    assert run.status == "completed"
    assert limit_warnings(largest) == []
    assert largest["speed"] is not None, "this scene has limits to keep"


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_scenes_that_are_shown_stay_within_the_limits_of_their_robots(path):
    assert_within_limits(run_of(ma.load_scene(path)))


@pytest.mark.parametrize("path", SOLVED, ids=lambda path: path.stem)
def test_scenes_that_break_elsewhere_run_within_the_limits_of_their_robots(path):
    run = ma.simulate(ma.compile_system(ma.load_scene(path)))
    assert_within_limits(run)
    assert run.certificate["met"]
    assert run.position_drift.max() < 1e-12 and abs(run.energy_balance).max() < 1e-6
    if path.stem == "effort_limits":
        assert sum(event["kind"] == "saturates" for event in run.events) > 5
        limits = [150.0, 150.0, 150.0, 28.0, 28.0, 28.0]  # of a UR5's file [N m]
        assert np.all(abs(run.joint_torques["left"]).max(axis=0) <= np.array(limits) + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIRST)
def test_scenes_to_start_from_stay_within_the_limits_of_their_robots(name):
    assert_within_limits(run_of(parse_scene(first_scene(*FIRST[name]))))


@pytest.mark.slow
def test_the_scene_of_the_readme_is_closed_and_stays_within_the_limits_of_its_robots():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(name:.*?)^```$", readme, re.M | re.S)
    scene = parse_scene(text)
    assert max(ma.compile_system(scene).start_report.gaps.values()) < 1e-6  # [m]
    assert_within_limits(run_of(scene))


@pytest.mark.slow
def test_the_grasped_block_is_what_the_command_of_its_header_and_of_the_docs_writes(tmp_path):
    path, again = SCENES / "grasped_block.yaml", tmp_path / "block.yaml"
    _, header = path.read_text(encoding="utf-8").splitlines()[:2]
    command = header.removeprefix("# ")
    for page in ("gallery.md", "how_to/grasps.md"):
        assert command in (ROOT / "docs" / page).read_text(encoding="utf-8"), page
    result = multiarm(*shlex.split(command)[1:], "--out", again)
    assert result.exit_code == 0, result.output
    assert again.read_text(encoding="utf-8").startswith(f"{header}\n")
    shown, written = ma.load_scene(path), ma.load_scene(again)
    for name, arm in shown.arms.items():
        posture = written.arms[name].posture
        np.testing.assert_allclose(posture, arm.posture, rtol=0.0, atol=TIE)
        assert arm.model_copy(update={"posture": posture}) == written.arms[name]
    assert written.replace(arms=shown.arms) == shown
