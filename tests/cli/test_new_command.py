"""Claims about `multiarm new`: the scene explains itself, loads, compiles and runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import multiarm
from jsonschema import Draft202012Validator

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.problems.first_scene import SOLIDS, first_scene
from multiarm.scene import parse_scene
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.loading import parse_yaml


def new(*words: object):
    return multiarm("new", *words)


def made(path: Path, *words: object) -> ma.System:
    """The system of a new scene whose start is as it is written."""
    result = new(path, *words)
    assert result.exit_code == 0, result.output
    system = ma.compile_system(ma.load_scene(path))
    assert max(system.start_report.gaps.values()) < 1e-5  # [m], digits that are written
    return system


@pytest.mark.slow
@pytest.mark.parametrize("kind", BUILT_IN)
def test_a_scene_of_every_kind_of_joint_runs(kind, tmp_path):
    system = made(tmp_path / "scene.yaml", "--joint", kind)
    assert [joint.kind for joint in system.scene.joints] == [kind, kind]
    assert ma.simulate(system, 0.02, accuracy=1e-4).status == "completed"


@pytest.mark.parametrize(
    ("robots", "solid"),
    [(["panda"], "box"), (["ur5", "panda", "ur10"], "sphere"), (["textbook_6r"] * 4, "cylinder")],
)
def test_robots_on_the_floor_lift_any_object_and_set_it_down(robots, solid, tmp_path):
    words = [word for robot in robots for word in ("--robot", robot)]
    system = made(tmp_path / "scene.yaml", *words, "--object", solid)
    assert [arm.robot for arm in system.scene.arms.values()] == robots
    assert all(arm.base.xyz[2] == 0.0 for arm in system.scene.arms.values())
    run = ma.simulate(system, accuracy=1e-5, certificate=False)
    assert run.status == "completed"
    height = run.object_position[:, 2]
    top = system.scene.control.path[0].xyz[2]
    assert top > height[0] + 0.05 and height[0] > SOLIDS[solid].half_sizes[2]  # [m]
    assert abs(height.max() - top) < 1e-4 and abs(height[-1] - height[0]) < 1e-4


def test_robots_that_cannot_lift_an_object_hold_it_and_are_pushed(tmp_path):
    system = made(tmp_path / "scene.yaml", "--robot", "baxter", "--robot", "so101")
    assert system.scene.control.kind == "gravity_compensation"
    run = ma.simulate(system, 0.1)
    assert run.status == "completed"
    assert 1e-4 < np.abs(run.object_position - run.object_position[0]).max() < 0.01  # [m]


@pytest.mark.parametrize(
    ("robots", "title"),
    [
        (["ur5"] * 2, "Two ur5 arms lift a box and set it down again"),
        (["panda"], "One panda arm lifts a box and sets it down again"),
        (["ur5", "panda", "ur5"], "Two ur5 and one panda lift a box and set it down again"),
        (["slide"] * 2, "Two slide arms hold a box"),
    ],
)
def test_the_title_is_a_sentence(robots, title):
    assert parse_scene(first_scene(robots, "weld", "box")).name == title


def test_robots_that_cannot_hold_the_joint_are_named_as_the_user_wrote_them(tmp_path, monkeypatch):
    def refuse(scene):
        raise SceneError("$.arms.left.posture: none")

    monkeypatch.setattr("multiarm.problems.first_scene.load_robots", refuse)
    refused = new(tmp_path / "scene.yaml", "--robot", "ur5", "--joint", "ball")
    assert refused.exit_code == 2 and "$." not in refused.stderr
    assert "ur5" in refused.stderr and "'ball'" in refused.stderr


def test_joints_that_turn_without_end_are_nothing_to_warn_of(tmp_path):
    result = new(tmp_path / "scene.yaml", "--robot", "crossed_2r", "--robot", "crossed_2r")
    assert result.exit_code == 0 and "warning" not in result.output, result.output


@pytest.mark.slow
def test_every_line_is_explained_and_the_schema_comes_first(tmp_path):
    path = tmp_path / "scene.yaml"
    made(path)
    assert "tip:" not in path.read_text(encoding="utf-8")
    first, *lines = path.read_text(encoding="utf-8").splitlines()
    schema = tmp_path / first.removeprefix("# yaml-language-server: $schema=")
    found = json.loads(schema.read_text(encoding="utf-8"))
    assert not list(Draft202012Validator(found).iter_errors(parse_yaml(path.read_text())))
    assert all(line.partition("#")[2].strip() for line in lines if line)
    assert not [line for line in lines if line != line.rstrip()]


@pytest.mark.slow
def test_a_file_is_replaced_by_force_only(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("precious", encoding="utf-8")
    refused = new(path)
    assert refused.exit_code == 2 and "--force" in refused.stderr
    assert path.read_text(encoding="utf-8") == "precious"
    assert not (tmp_path / "scene.schema.json").exists()
    made(path, "--force")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--robot", "ur55"), "unknown robot 'ur55'; did you mean 'ur5'?"),
        (("--joint", "welt"), "unknown joint kind 'welt'; did you mean 'weld'?"),
        (("--object", "torus"), "'torus'"),
        (("--robot", "tiago_pro"), "nothing tells which link of robot 'tiago_pro' is its tip"),
    ],
)
def test_unknown_names_are_refused_with_similar_ones(words, message, tmp_path):
    refused = new(tmp_path / "scene.yaml", *words)
    assert refused.exit_code == 2 and message in refused.stderr
    assert not list(tmp_path.iterdir())
