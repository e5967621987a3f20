"""What commands print of robots with several tips."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from commands import multiarm
from repository import SCENES
from tree_scenes import gripper_scene

import multiarm as ma
from multiarm.scene import parse_scene

GRIPPER, TORSO = SCENES / "four_bar_gripper.yaml", SCENES / "torso_lifts_a_box.yaml"


SATELLITE = """
object: {{shape: {{box: [0.4, 0.3, 0.2]}}, mass: 5, pose: {{xyz: [1.0, 0.2, 1.1]}}}}
robots: {{sat: {{robot: ur5, {}tips: {{hand: tool0}}}}}}
joints: [{{arm: sat/hand, kind: ball, at: {{xyz: [-0.2, 0, 0]}}}}]
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """What ``multiarm check`` prints and writes of the gripper."""
    path = tmp_path_factory.mktemp("check") / "check.json"
    result = multiarm("check", GRIPPER, "--json", path)
    assert result.exit_code == 0, result.output
    return result.output, json.loads(path.read_text())


def test_check_counts_the_freedom_of_linkages(checked):
    _, facts = checked
    freedom = facts["freedom"]
    # 6 of the box and 7 joints; the linkages and the box between the pads leave the lift alone.
    # Rows: weld 6, planar 3, two hinges of 5, one coupling.
    assert freedom["degrees_of_freedom"] == 13 and freedom["constraints"] == 6 + 3 + 2 * 5 + 1
    assert freedom["mobility"] == 1 and freedom["rank"] == 12
    assert (freedom["couplings"], freedom["wheels"]) == (1, 0)
    assert freedom["constraints"] == sum(len(joint["rows"]) for joint in facts["joints"]) + 1


def test_check_names_the_rows_of_wheels_beside_those_of_connections(tmp_path):
    base = {"moves": "differential", "mass": 12, "inertia": [0.8, 0.8, 0.8]}
    robot = {"urdf": str(tmp_path / "cart.urdf"), "base": base, "tips": {"plate": "plate"}}
    (tmp_path / "cart.urdf").write_text(
        "<robot name='cart'><link name='base'/><link name='plate'/><joint name='mount' "
        "type='fixed'><parent link='base'/><child link='plate'/></joint></robot>"
    )
    scene = {
        "object": {"mass": 5, "shape": {"box": [0.2, 0.2, 0.2]}},
        "robots": {"cart": robot},
        "joints": [{"arm": "cart/plate", "kind": "weld"}],
    }
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    result = multiarm("check", path, "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    freedom = json.loads((tmp_path / "check.json").read_text())["freedom"]
    assert (freedom["constraints"], freedom["wheels"], freedom["couplings"]) == (7, 1, 0)
    words = " ".join(result.output.split())
    assert "7 (6 of connections, 1 of wheels), of which 7 are independent" in words


def test_check_shows_a_robot_with_its_tips_couplings_and_moving_base(checked):
    text, facts = checked
    (robot,) = facts["robots"].values()
    assert facts["arms"] == {} and list(facts["robots"]) == ["gripper"]
    assert robot["tips"] == {"left": "left_pad", "right": "right_pad"}
    assert robot["base_joints"] == ["base_z"] and next(iter(robot["joints"])) == "base_z"
    (mimic,) = robot["mimic"]
    assert (mimic["joint"], mimic["leader"]) == ("right_driver_joint", "left_driver_joint")
    assert robot["verdict"] == "dependent rows"
    for words in ("moves by base_z", "right_driver_joint = 1 left_driver_joint", "left_hinge"):
        assert words in text


def test_check_finds_what_connections_leave_free_wherever_the_links_have_their_frames(checked):
    _, facts = checked
    joints = {joint["connection"]: joint for joint in facts["joints"]}
    assert list(joints) == ["gripper/left", "gripper/right", "left_hinge", "right_hinge"]
    assert joints["gripper/left"]["free_motions"] == []
    for side in ("left", "right"):
        hinge = joints[f"{side}_hinge"]
        assert (hinge["first"], hinge["second"]) == (
            f"gripper/{side}_follower_end",
            f"gripper/{side}_coupler",
        )
        assert hinge["arm"] is None and hinge["rank"] == 5
        assert hinge["free_motions"] == ["turn about z"]


def test_pose_prints_all_joints_of_a_robot_whose_posture_is_sought():
    result = multiarm("pose", TORSO)
    assert result.exit_code == 0, result.output
    line = result.output.strip().splitlines()[-1]
    posture = yaml.safe_load(line)["tiago"]["posture"]
    start = ma.compile_system(ma.load_scene(TORSO)).initial_state().joint_positions["tiago"]
    np.testing.assert_allclose(posture, start, atol=1e-8)


def test_pose_says_that_robots_have_postures(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(gripper_scene()))
    result = multiarm("pose", path)
    assert result.exit_code == 2 and "every robot a posture" in result.output


def test_pose_prints_a_base_as_a_scene_needs_it(tmp_path):
    """What is printed, copied into the scene, is where the program found it; it still floats."""
    base = "{moves: free, mass: 40, inertia: [3, 3, 2], solve: [x, y], xyz: [0, 0, 0.5]}"
    path = tmp_path / "sat.yaml"
    path.write_text(SATELLITE.format(f"base: {base}, "))
    printed = multiarm("pose", path).stdout.strip()
    text = printed.removeprefix("sat: {").removesuffix("}")
    assert "moves: " in text and "solve" not in text
    system = ma.compile_system(ma.load_scene(path))
    again = ma.compile_system(parse_scene(SATELLITE.format(f"{text}, ")))
    for name in ("xyz", "rpy", "moves", "mass", "inertia"):
        found, copied = (getattr(s.scene.robots["sat"].base, name) for s in (system, again))
        assert copied == (pytest.approx(found, abs=1e-7) if name in ("xyz", "rpy") else found)


def test_a_summary_has_forces_by_connection(tmp_path):
    result = multiarm("run", GRIPPER, "--duration", 0.1, "--out", tmp_path / "run.h5")
    assert result.exit_code == 0, result.output
    words = " ".join(result.output.split())
    assert "largest forces, gripper/left" in words and "largest forces, left_hinge" in words
    assert "not recorded" not in words
