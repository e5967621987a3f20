"""Claims about robots: every name loads, chains are right, our own models are physical."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from commands import multiarm
from refusals import refused
from repository import ROOT, SCENES, WORKED

from multiarm.errors import ModelError, SceneError
from multiarm.scene import (
    ArmSpec,
    CornerGripperJoint,
    Pose,
    available_robots,
    dump_scene,
    find_robot,
    parse_scene,
    read_urdf,
    resolve_arm,
    resolve_mesh,
    resolve_package_dirs,
    robots,
)
from multiarm.scene.robots import arm_ends

OWN = tuple(sorted(folder.name for folder in (ROOT / "robots").iterdir() if folder.is_dir()))
ROBOTS = sorted(available_robots())


def arm(**changes: object) -> ArmSpec:
    return ArmSpec(**{"robot": "panda", "tip": "panda_hand_tcp", **changes})


def scene_of(spec: dict):
    return parse_scene(
        {
            "object": {"shape": {"sphere": 0.1}, "mass": 1},
            "arms": {"a": spec},
            "joints": [{"arm": "a", "kind": "weld"}],
        }
    )


def write_urdf(path: Path, body: str) -> Path:
    path.write_text(f"<robot name='r'>{body}</robot>")
    return path


def chain_text(kinds: list[str], extra: str = "") -> str:
    links = "".join(f"<link name='l{i}'/>" for i in range(len(kinds) + 1))
    joints = "".join(
        f"<joint name='j{i}' type='{kind}'><parent link='l{i}'/><child link='l{i + 1}'/>"
        f"<axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        for i, kind in enumerate(kinds)
    )
    return links + joints + extra


@pytest.mark.parametrize(
    "axis",
    ["0 0 0", "0 1", "x y z"],
)
def test_an_axis_that_is_no_direction_is_refused(axis, tmp_path):
    text = chain_text(["revolute"]).replace("0 0 1", axis)
    with refused(ModelError, "r.urdf"):
        read_urdf(write_urdf(tmp_path / "r.urdf", text))


# --- by name -----------------------------------------------------------------------------------


# The link that each of these had as its tip when the tip had to be written.
TIPS = {
    **dict.fromkeys(["ur3", "ur3_gripper", "ur3_limited", "ur5", "ur5_gripper"], "tool0"),
    **dict.fromkeys(["ur5_limited", "ur10", "ur10_limited"], "tool0"),
    "panda": "panda_hand_tcp",
    "xarm7": "link_eef",
    "kinova": "j2s6s200_end_effector",
    "z1": "gripperStator",
    "so100": "gripper",
    "so101": "gripper_frame_link",
    "talos_arm": "gripper_left_base_link",
    "asr_twodof": "Tip",
    "double_pendulum": "link2",
    "planar_2r": "tip",
    "planar_3r": "tip",
    "textbook_6r": "tool",
    "corner_gripper": "corner",
}


# A tool without joints, and a gripper of which one finger mimics the other.
NOT_ALL_ARMS = ("corner_gripper", "four_bar_gripper")


def test_own_robots_and_all_that_are_installed_are_available():
    """Every URDF file of example-robot-data in which Pinocchio finds a movable joint."""
    assert set(OWN) | set(TIPS) <= set(ROBOTS)
    files = {entry.urdf for entry in available_robots().values()}
    share = find_robot("ur5").urdf.parents[2]
    others = [path for path in share.rglob("*.urdf") if path not in files]
    for path in others:
        text = path.read_text(encoding="utf-8")
        joints = "<link" in text and pin.buildModelFromXML(text).njoints > 1
        assert not joints, path
    assert {"baxter", "talos", "tiago_dual", "pr2", "anymal_b_simple"} <= set(ROBOTS)


@pytest.mark.parametrize("name", TIPS)
def test_usual_tips_are_those_that_scenes_had_to_write(name):
    assert find_robot(name).tip == TIPS[name]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_loads_and_its_tips_end_the_same_chains_as_in_pinocchio(name):
    entry = find_robot(name)
    outline = read_urdf(entry.urdf)
    model = pin.buildModelFromUrdf(str(entry.urdf))
    tips = entry.tips or arm_ends(outline)
    assert tips
    for tip in tips:
        chain = [joint.name for joint in outline.movable(tip)]
        parent = model.frames[model.getFrameId(tip, pin.FrameType.BODY)].parentJoint
        assert chain == [model.names[i] for i in model.supports[parent] if i > 0]
        assert outline.ends_an_arm(tip) or name in NOT_ALL_ARMS
    limits = {joint.name: joint for joint in outline.joints}
    for joint, joint_name in zip(model.joints[1:], list(model.names)[1:], strict=True):
        if joint.nq == 1:
            assert limits[joint_name].lower == model.lowerPositionLimit[joint.idx_q]
            assert limits[joint_name].upper == model.upperPositionLimit[joint.idx_q]


@pytest.mark.parametrize("name", ROBOTS)
def test_meshes_of_every_robot_are_found(name):
    outline = read_urdf(find_robot(name).urdf)
    folders = resolve_package_dirs(outline.path)
    meshes = [m for m in outline.meshes if not m.startswith("file:")]  # on its author's machine
    assert [m for m in meshes if resolve_mesh(m, outline.path, folders) is None] == []


def test_unknown_robot_names_alternatives():
    with refused(SceneError, "'ur6'"):
        find_robot("ur6")


@pytest.mark.parametrize(
    ("name", "near"),
    [("tiago_no", "tiago"), ("ur5_griper", "ur5_gripper"), ("anymal_c_simpel", "anymal_c_simple")],
)
def test_near_names_are_those_of_arms_or_else_of_any_robot(name, near):
    with pytest.raises(SceneError) as caught:
        find_robot(name)
    (text,) = caught.value.faults
    assert f"did you mean '{near}'?" in text
    if name == "tiago_no":  # nearer is the name of a robot of which nothing tells the tip
        assert "'tiago_no_hand'" not in text and "pip install robot_descriptions" in text


def test_without_example_robot_data_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr("multiarm.scene.robots._share_folder", lambda: None)
    assert set(available_robots()) == set(OWN)
    with refused(SceneError, "pip install example-robot-data"):
        find_robot("ur5")


# --- the package robot_descriptions ---

PACKAGE = """
class Description:
    def __init__(self, repository, has_urdf=True):
        self.repository, self.has_urdf = repository, has_urdf
DESCRIPTIONS = {
    "lathe_description": Description("here"), "crane_description": Description("away"),
    "hoist_mj_description": Description("here", has_urdf=False),
    "winch_description": Description("here"),
}
"""
MODULE = """
from os import path as _path
from ._cache import clone_to_cache as _clone_to_cache
REPOSITORY_PATH: str = _clone_to_cache(
    "{repository}",
)
URDF_PATH: str = _path.join(REPOSITORY_PATH, "arm.urdf")
"""
CACHE = """
import os
def clone_to_cache(name):
    assert os.environ["GIT_ALLOW_PROTOCOL"] == "none", "git may fetch"
    path = os.path.join(os.environ["ROBOT_DESCRIPTIONS_CACHE"], REPOSITORIES[name].cache_path)
    if not os.path.isdir(path):
        print("Cloning ...")
        raise OSError("git could not fetch")
    return path
from ._repositories import REPOSITORIES
"""
REPOSITORIES = """
class Repository:
    def __init__(self, cache_path): self.cache_path = cache_path
REPOSITORIES = {"here": Repository("here"), "away": Repository("away")}
"""


@pytest.fixture
def descriptions(tmp_path, monkeypatch):
    """A package like robot_descriptions with one robot in its cache and one that is not."""
    package = tmp_path / "site" / "robot_descriptions"
    package.mkdir(parents=True)
    for name, text in {
        "__init__": PACKAGE,
        "_cache": CACHE,
        "_repositories": REPOSITORIES,
        "lathe_description": MODULE.format(repository="here"),
        "crane_description": MODULE.format(repository="away"),
        "winch_description": MODULE.replace("URDF", "XACRO").format(repository="here"),
        "hoist_mj_description": MODULE.replace("URDF", "MJCF").format(repository="here"),
    }.items():
        (package / f"{name}.py").write_text(text)
    (tmp_path / "cache" / "here").mkdir(parents=True)
    write_urdf(tmp_path / "cache" / "here" / "arm.urdf", chain_text(["revolute", "fixed"]))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    yield tmp_path
    for module in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        del sys.modules[module]


def test_described_robots_are_used_if_they_are_there_and_never_fetched(descriptions):
    assert robots.described_robots() == (
        "crane_description", "lathe_description", "winch_description"
    )  # fmt: skip
    entry = available_robots()["lathe_description"]
    assert (entry.source, entry.tip) == ("robot_descriptions", "l2")
    assert entry.urdf == (descriptions / "cache" / "here" / "arm.urdf").resolve()
    assert "robot_descriptions.lathe_description" not in sys.modules
    assert resolve_arm(ArmSpec(robot="lathe_description")).joint_names == ("j0",)
    assert not {"crane_description", "winch_description"} & available_robots().keys()
    listed = multiarm("robots", columns=200).stdout
    assert "(python -m robot_descriptions pull NAME): crane_description" in listed
    with refused(SceneError, "python -m robot_descriptions pull crane_description"):
        find_robot("crane_description")
    with refused(SceneError, "'winch_description'"):
        find_robot("winch_description")
    with refused(SceneError, "'crane_description'"):
        find_robot("crans_description")
    assert not (descriptions / "cache" / "away").exists()
    assert "robot_descriptions.crane_description" not in sys.modules
    assert "GIT_ALLOW_PROTOCOL" not in os.environ


def test_without_robot_descriptions_the_message_says_what_to_install():
    with refused(SceneError, "pip install robot_descriptions"):
        find_robot("iiwa14_description")


# --- the tip that a scene leaves out ---


@pytest.mark.parametrize(
    ("spec", "tip"),
    [
        ({"robot": "ur5"}, "tool0"),
        ({"robot": "ur5", "tip": "wrist_3_link"}, "wrist_3_link"),
        ({"robot": "ur5", "tool": {"robot": "corner_gripper", "mount": "tool0"}}, "corner"),
        ({"robot": "ur5", "tool": {"fingers": {"tips": [[0, 0, 0]]}, "mount": "tool0"}}, "corner"),
    ],
)
def test_an_arm_without_a_tip_has_the_usual_one_of_robot_or_tool(spec, tip):
    scene = scene_of(spec)
    assert resolve_arm(scene.arms["a"]).tip == tip
    again = parse_scene(dump_scene(scene))
    assert again.arms["a"].tip == spec.get("tip") and again == scene


def test_the_only_end_of_a_file_is_its_tip_and_the_flange_before_others(tmp_path):
    path = write_urdf(tmp_path / "arm.urdf", chain_text(["revolute", "fixed"]))
    assert resolve_arm(ArmSpec(urdf=path)).tip == "l2"
    flange = "<link name='{0}'/><joint name='{0}_' type='fixed'><parent link='l1'/>"
    flange += "<child link='{0}'/></joint>"
    path.write_text(f"<robot name='r'>{chain_text(['revolute'], flange.format('tool0'))}</robot>")
    assert resolve_arm(ArmSpec(urdf=path)).tip == "tool0"
    both = flange.format("tool0") + flange.format("camera")
    path = write_urdf(tmp_path / "both.urdf", chain_text(["revolute"], both))
    assert resolve_arm(ArmSpec(urdf=path)).tip == "tool0"


@pytest.mark.parametrize(
    "spec",
    [
        {"robot": "baxter"},
        {"robot": "tiago_pro"},
        {"robot": "ur5", "tool": {"robot": "panda_collision", "mount": "tool0"}},
    ],
)
def test_a_tip_that_nothing_tells_is_asked_for_with_candidates(spec):
    with refused(SceneError, "$.arms.a.tip"):
        scene_of(spec)


# --- chains ------------------------------------------------------------------------------------


def test_fingers_beside_the_chain_are_locked_and_told():
    scene = scene_of({"robot": "panda", "tip": "panda_hand_tcp"})
    resolved = resolve_arm(scene.arms["a"])
    assert resolved.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert resolved.locked == {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
    (warning,) = scene.warnings
    assert warning.startswith("$.arms.a: ")
    assert "panda_finger_joint1" in warning


def test_lock_chooses_positions_and_mimics_follow():
    spec = {"robot": "panda", "tip": "panda_hand_tcp", "lock": {"panda_finger_joint1": 0.02}}
    scene = scene_of(spec)
    locked = resolve_arm(scene.arms["a"]).locked
    assert locked == {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    assert scene.warnings == []


def test_mimics_of_mimics_follow_in_whatever_order_a_file_has_them(tmp_path):
    finger = "<joint name='{0}' type='revolute'><parent link='l1'/><child link='{0}'/><mimic "
    finger += "joint='{1}' multiplier='2'/><limit lower='-9' upper='9' effort='1' velocity='1'/>"
    finger += "</joint><link name='{0}'/>"
    fingers = "".join(finger.format(*pair) for pair in (("c", "b"), ("b", "a"), ("a", "j1")))
    path = write_urdf(tmp_path / "hand.urdf", chain_text(["revolute"] * 2, fingers))
    resolved = resolve_arm(ArmSpec(urdf=path, tip="l1", lock={"j1": 0.25}))
    assert resolved.locked == {"j1": 0.25, "a": 0.5, "b": 1.0, "c": 2.0}


def test_a_locked_joint_of_the_chain_is_no_coordinate():
    resolved = resolve_arm(arm(lock={"panda_joint3": 0.3}, posture=[0, 1, -2, 0, 1, 0]))
    assert "panda_joint3" not in resolved.joint_names
    assert resolved.locked["panda_joint3"] == 0.3
    np.testing.assert_array_equal(resolved.posture, [0, 1, -2, 0, 1, 0])


def test_posture_defaults_to_the_position_nearest_to_zero_within_the_limits():
    resolved = resolve_arm(arm(posture={"panda_joint2": 0.4}))
    upper = resolved.joints[3].upper
    assert upper < 0
    np.testing.assert_array_equal(resolved.posture[:5], [0, 0.4, 0, upper, 0])
    np.testing.assert_array_equal(resolved.velocity, np.zeros(7))


def test_a_posture_outside_its_limits_is_a_warning():
    scene = scene_of({"robot": "ur5", "tip": "tool0", "posture": {"elbow_joint": 6.0}})
    assert any("'elbow_joint' is 6, outside its limits" in text for text in scene.warnings)


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_other_movable_joints_on_the_chain_are_refused(kind, tmp_path):
    path = write_urdf(tmp_path / "arm.urdf", chain_text(["revolute", kind]))
    with refused(SceneError, "'j1'"):
        resolve_arm(ArmSpec(urdf=path, tip="l2"))
    assert resolve_arm(ArmSpec(urdf=path, tip="l1")).joint_names == ("j0",)


@pytest.mark.parametrize(("count", "accepted"), [(0, False), (1, True), (16, True), (17, False)])
def test_chains_have_one_to_sixteen_joints(count, accepted, tmp_path):
    kinds = (["revolute", "continuous", "prismatic"] * 6)[:count]
    path = write_urdf(tmp_path / "arm.urdf", chain_text([*kinds, "fixed"]))
    spec = ArmSpec(urdf=path, tip=f"l{count + 1}")
    if accepted:
        assert len(resolve_arm(spec).joints) == count
    else:
        with refused(SceneError, "arm.tip"):
            resolve_arm(spec)


def test_continuous_joints_have_no_limits(tmp_path):
    path = write_urdf(tmp_path / "arm.urdf", chain_text(["continuous"]))
    (joint,) = resolve_arm(ArmSpec(urdf=path, tip="l1", posture=[9.0])).joints
    assert (joint.lower, joint.upper) == (-math.inf, math.inf)


def test_a_tool_continues_the_chain():
    spec = ArmSpec(
        robot="textbook_6r", tip="corner", tool={"robot": "corner_gripper", "mount": "tool"}
    )
    resolved = resolve_arm(spec)
    assert len(resolved.joints) == 6
    assert resolved.tool_urdf == find_robot("corner_gripper").urdf


@pytest.mark.parametrize(
    "changes",
    [
        {"mount": "tol"},
        {"robot": "corner_griper"},
        {"robot": "textbook_6r"},
    ],
)
def test_faults_of_tools_are_told(changes):
    tool = {"robot": "corner_gripper", "mount": "tool", **changes}
    with refused(SceneError, "arm.tool"):
        resolve_arm(ArmSpec(robot="textbook_6r", tip="corner", tool=tool))


# --- files -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "<robot",
        "<sdf/>",
        "<mujoco/>",
        "<robot xmlns:xacro='http://ros.org/xacro'><xacro:macro name='a'/></robot>",
        "<robot/>",
        "<robot><link name='a'/><link name='b'/></robot>",
        "<robot><link name='a'/><link name='a'/></robot>",
        "<robot><link name='a'/><joint name='j' type='hinge'><parent link='a'/>"
        "<child link='b'/></joint></robot>",
        "<robot><link name='a'/><joint name='j' type='fixed'><parent link='a'/>"
        "<child link='b'/></joint></robot>",
        "<robot><link/></robot>",
    ],
)
def test_broken_urdf_files_are_told(text, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with refused(ModelError, str(path)):
        read_urdf(path)


def test_a_missing_urdf_is_a_fault_of_the_scene(tmp_path):
    with refused(SceneError, "$.arms.a.urdf"):
        scene_of({"urdf": str(tmp_path / "none.urdf"), "tip": "x"})


def test_missing_meshes_are_a_warning(tmp_path):
    visual = "<visual><geometry><mesh filename='package://nowhere/a.stl'/></geometry></visual>"
    text = chain_text(["revolute"]).replace("<link name='l1'/>", f"<link name='l1'>{visual}</link>")
    path = write_urdf(tmp_path / "arm.urdf", text)
    scene = scene_of({"urdf": str(path), "tip": "l1"})
    (warning,) = scene.warnings
    assert "1 of 1 mesh " in warning
    assert "package://nowhere/a.stl" in warning


def test_packages_are_looked_for_in_the_promised_order(tmp_path, monkeypatch):
    explicit, ros = tmp_path / "explicit", tmp_path / "ros"
    urdf = tmp_path / "ws" / "pkg" / "urdf" / "arm.urdf"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(ros))
    address = "package://pkg/mesh.stl"
    wanted = [explicit / "pkg", tmp_path / "ws" / "pkg", ros / "pkg"]
    for folder in wanted:
        folder.mkdir(parents=True)
        (folder / "mesh.stl").write_text("solid")
    for folder in wanted:
        folders = resolve_package_dirs(urdf, (explicit,))
        assert resolve_mesh(address, urdf, folders) == folder / "mesh.stl"
        (folder / "mesh.stl").unlink()


def test_an_explicit_folder_may_be_the_package_itself(tmp_path):
    package = tmp_path / "elsewhere" / "pkg"
    package.mkdir(parents=True)
    (package / "mesh.stl").write_text("solid")
    urdf = tmp_path / "robots" / "arm.urdf"
    address = "package://pkg/mesh.stl"
    assert resolve_mesh(address, urdf, resolve_package_dirs(urdf)) is None
    assert resolve_mesh(address, urdf, resolve_package_dirs(urdf, (package,))) is not None


def test_packages_named_as_in_ros_are_found_in_example_robot_data(tmp_path):
    folders = resolve_package_dirs(tmp_path / "my_ur5.urdf")
    address = "package://ur_description/meshes/ur5/visual/base.dae"
    assert resolve_mesh(address, tmp_path / "my_ur5.urdf", folders) is not None


# --- the project's own models ------------------------------------------------------------------


@pytest.mark.parametrize("name", OWN)
def test_own_robots_are_physical_and_documented(name):
    entry = find_robot(name)
    assert (ROOT / "robots" / name / "SOURCE.md").read_text().count("BSD-3-Clause") == 1
    model = pin.buildModelFromUrdf(str(entry.urdf))
    bodies = [inertia for inertia in model.inertias if inertia.mass > 0]
    assert bodies
    for inertia in bodies:
        low, middle, high = np.linalg.eigvalsh(inertia.inertia)
        assert low > 0
        assert low + middle >= high * (1 - 1e-9)
    assert not read_urdf(entry.urdf).meshes


def test_planar_arms_stay_in_their_plane():
    for name, joints, reach in (("planar_2r", 2, 0.9), ("planar_3r", 3, 1.15)):
        model = pin.buildModelFromUrdf(str(find_robot(name).urdf))
        data = model.createData()
        tip = model.getFrameId("tip")
        pin.framesForwardKinematics(model, data, np.zeros(joints))
        np.testing.assert_allclose(data.oMf[tip].translation, [reach, 0, 0], atol=1e-15)
        pin.framesForwardKinematics(model, data, np.linspace(0.3, 1.0, joints))
        assert data.oMf[tip].translation[2] == 0.0


@pytest.mark.parametrize("position", [0.0, 0.25, 0.7])
def test_linkages_of_the_gripper_are_closed_where_all_joints_have_one_position(position):
    """Pads stay parallel, 71 mm apart where it is open, and meet where it is closed."""
    model = pin.buildModelFromUrdf(str(find_robot("four_bar_gripper").urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.full(6, position))
    poses = {frame.name: X for frame, X in zip(model.frames, data.oMf, strict=True)}
    for side in ("left", "right"):
        follower, coupler = poses[f"{side}_follower_end"], poses[f"{side}_coupler"]
        np.testing.assert_allclose(follower.translation, coupler.translation, atol=1e-15)
        np.testing.assert_allclose(follower.rotation[:, 2], coupler.rotation[:, 2], atol=1e-15)
    left, right = poses["left_pad"], poses["right_pad"]
    np.testing.assert_allclose(left.rotation[:, 2], [-1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(right.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
    opening = 2.0 * 0.055 * math.sin(0.7 - position)
    np.testing.assert_allclose(left.translation - right.translation, [opening, 0, 0], atol=1e-15)


def test_arms_of_the_cart_mirror_each_other():
    model = pin.buildModelFromUrdf(str(find_robot("dual_arm_cart").urdf))
    arm = [0.4, 0.7, -1.2, 0.5, 0.3, -0.9]
    q, data, mirror = np.array([0.1, *arm, *arm]), model.createData(), np.diag([1.0, -1.0, 1.0])
    pin.framesForwardKinematics(model, data, q)
    left, right = (data.oMf[model.getFrameId(f"{side}_tool")] for side in ("left", "right"))
    np.testing.assert_allclose(mirror @ right.translation, left.translation, atol=1e-14)
    np.testing.assert_allclose(mirror @ right.rotation[:, 2], left.rotation[:, 2], atol=1e-14)
    gravity = pin.computeGeneralizedGravity(model, data, q)
    # pan and roll turn about mirrored axes, so that equal positions and equal torques mirror
    np.testing.assert_allclose(gravity[1:7], gravity[7:], atol=1e-12)


@pytest.mark.parametrize("index", [0, 1])
def test_textbook_arm_has_the_inertia_and_bias_of_the_worked_example(index):
    example = WORKED["two_arm_block_system"]
    model = pin.buildModelFromUrdf(str(find_robot("textbook_6r").urdf))
    base = example["inputs"]["base"][index]
    X_WB = pin.SE3(np.array(base["R"]), np.array(base["p"]))
    model.jointPlacements[1] = X_WB * model.jointPlacements[1]
    data = model.createData()
    q, v = (np.array(example["inputs"][key][index]) for key in ("q", "qd"))
    M = np.triu(pin.crba(model, data, q))
    M = M + np.triu(M, 1).T
    np.testing.assert_allclose(M, example["expected"][f"M{index}"], rtol=0, atol=1e-12)
    nle = pin.nonLinearEffects(model, data, q, v)
    np.testing.assert_allclose(nle, example["expected"]["nle"][index], rtol=0, atol=1e-12)
    tool = model.frames[model.getFrameId("tool")].placement
    np.testing.assert_array_equal(tool.translation, example["inputs"]["tool"])


def test_corner_gripper_touches_the_corner_as_in_example_3_1():
    model = pin.buildModelFromUrdf(str(find_robot("corner_gripper").urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(0))
    X_corner = data.oMf[model.getFrameId("corner")]
    joint = CornerGripperJoint(arm="a")
    expected = WORKED["example_3_1"]["inputs"]
    np.testing.assert_array_equal(joint.points, expected["points_in_object_frame"])
    for number, (point, outward) in enumerate(
        zip(joint.points, expected["normals_on_gripper"], strict=True), start=1
    ):
        centre = X_corner.actInv(data.oMf[model.getFrameId(f"fingertip_{number}")].translation)
        np.testing.assert_allclose(centre, np.add(point, np.multiply(0.01, outward)), atol=1e-15)
    diagonal = X_corner.rotation @ np.ones(3) / np.sqrt(3)
    np.testing.assert_allclose(diagonal, [0, 0, 1], atol=1e-15)
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(0.5)


# --- the example scenes ------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted((SCENES).glob("*.yaml")), ids=lambda path: path.stem)
def test_example_scenes_start_closed(path):
    from multiarm.scene import load_scene

    scene = load_scene(path)
    assert scene.warnings == []
    for joint in scene.joints:
        if joint.at is None or joint.arm not in scene.arms:  # robots find theirs
            continue
        if scene.arms[joint.arm].posture == "solve" or joint.kind == "contacts":
            continue
        X_WT = tip_pose(scene.arms[joint.arm])
        X_OT = np.linalg.inv(scene.object.pose.matrix()) @ X_WT @ joint.at_tip.matrix()
        gap = X_OT - joint.at.matrix()
        if joint.kind == "ball":
            gap = gap[:3, 3]
        assert np.abs(gap).max() < 1e-9


def tip_pose(spec: ArmSpec) -> np.ndarray:
    resolved = resolve_arm(spec)
    model = pin.buildModelFromUrdf(str(resolved.urdf))
    if resolved.tool_urdf is not None:
        text = resolved.tool_urdf  # of a hand, which has no file
        if not isinstance(text, str):
            text = text.read_text(encoding="utf-8")
        tool = pin.buildModelFromXML(text)
        mount = model.getFrameId(spec.tool.mount)
        model = pin.appendModel(model, tool, mount, pin.SE3(spec.tool.at.matrix()))
    q = pin.neutral(model)
    start = dict(zip(resolved.joint_names, resolved.posture, strict=True))
    for name, position in {**resolved.locked, **start}.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return Pose.matrix(spec.base) @ data.oMf[model.getFrameId(spec.tip)].homogeneous
