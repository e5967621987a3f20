"""Claims about ``multiarm grasp``, and about regions of fingertips in a replay."""

from __future__ import annotations

import re

import numpy as np
import pytest
from commands import command, figures
from mechanics import UR5_POSTURE, single_arm
from repository import SCENES
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import GraspError
from multiarm.grasp import Polyhedron
from multiarm.grasp.scenes.judging import judge_grasp, read_grasp
from multiarm.scene import parse_scene
from multiarm.spatial import quaternion_to_matrix
from multiarm.viewer.animate import animate, scene_grasp, sheet

CORNERS = SCENES / "corner_grippers_block.yaml"
WELDED = SCENES / "two_ur5_box.yaml"
HINGED = SCENES / "hinged_box.yaml"

grasp = command("grasp", 160)


def held_by(joint):
    """One UR5 that holds a box by a joint."""
    return single_arm("ur5", "tool0", UR5_POSTURE, joint)


def pose_of(X):
    quaternion = Rotation.from_matrix(X[:3, :3]).as_quat()
    return {"xyz": X[:3, 3].tolist(), "quaternion_xyzw": quaternion.tolist()}


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """A block's grasp as the command designs it: what it says, and the scene that it writes."""
    path = tmp_path_factory.mktemp("designed") / "block.yaml"
    result = grasp("design", "box:0.9,0.7,0.5", "--mass", "4", "--duration", "4", "--out", path)
    assert result.exit_code == 0, result.output
    return result, path


# --- design --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_designed_scene_runs_with_every_contact_pressing(designed):
    result, path = designed
    assert "7 contacts hold the body: form closure" in result.stderr
    assert "block" in result.stderr
    scene = ma.load_scene(path)
    assert (scene.object.mass, scene.run.duration) == (4.0, 4.0)
    assert [arm.robot for arm in scene.arms.values()] == ["panda", "panda"]
    assert scene.warnings == []
    run = ma.simulate(ma.compile_system(scene), certificate=False)
    assert run.status == "completed"
    assert min(forces.min() for forces in run.contact_forces.values()) > 0.5
    assert {event["kind"] for event in run.events} <= {"start"}


@pytest.mark.slow
def test_a_scene_goes_to_standard_output_and_nothing_else_does(designed):
    """So that ``> scene.yaml`` works: the facts go to standard error."""
    _, path = designed
    result = grasp("design", "box:0.9,0.7,0.5", "--mass", "4", "--duration", "4")
    assert result.exit_code == 0, result.output
    assert parse_scene(result.stdout) == ma.load_scene(path)
    command = "multiarm grasp design box:0.9,0.7,0.5 --mass 4 --duration 4"
    assert result.stdout.startswith(f"# {command}\n")


@pytest.mark.slow
def test_a_body_that_is_not_convex_gets_a_mesh_next_to_its_scene(tmp_path):
    ell = Polyhedron.prism([[0, 0], [0.8, 0], [0.8, 0.3], [0.3, 0.3], [0.3, 0.7], [0, 0.7]], 0.4)
    ell.save(tmp_path / "ell.stl")
    refused = grasp("design", tmp_path / "ell.stl")
    assert refused.exit_code == 2
    assert "name the scene with --out" in refused.stderr
    before = (tmp_path / "ell.stl").read_bytes()
    refused = grasp("design", tmp_path / "ell.stl", "--out", tmp_path / "ell.yaml")
    assert refused.exit_code == 2
    assert "would replace" in refused.stderr
    assert (tmp_path / "ell.stl").read_bytes() == before
    result = grasp("design", tmp_path / "ell.stl", "--out", tmp_path / "held.yaml")
    assert result.exit_code == 0, result.output
    scene = ma.load_scene(tmp_path / "held.yaml")
    assert scene.object.shape.mesh.file == tmp_path / "held.stl"
    inertia = ell.mass_properties(scene.object.mass).inertia
    np.testing.assert_allclose(scene.object.inertia_matrix(), inertia, rtol=1e-5, atol=1e-6)
    judged = judge_grasp(ma.compile_system(scene))
    assert judged.closed
    assert None not in [contact.face for contact in judged.contacts]
    run = ma.simulate(ma.compile_system(scene), duration=1.0, certificate=False)
    assert min(forces.min() for forces in run.contact_forces.values()) > 0.0


@pytest.mark.slow
def test_an_optimised_grasp_tells_its_gap_and_is_drawn(tmp_path):
    picture, scene = tmp_path / "grasp.png", tmp_path / "grasp.yaml"
    result = grasp(
        "design", "box:0.9,0.7,0.5", "--optimise", "margin", "--gripper-size", 0.2, "--gap", 0.1,
        "--plot", picture, "--out", scene,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    value, bound = map(
        float, re.search(r"margin ([\d.]+), at most ([\d.]+)", result.stderr).groups()
    )
    assert 0.9 * bound - 1e-3 <= value <= bound
    judged = judge_grasp(ma.compile_system(ma.load_scene(scene)))
    assert judged.margin == pytest.approx(value, abs=2e-4)  # four digits are told
    assert picture.read_bytes().startswith(b"\x89PNG")
    command = "multiarm grasp design box:0.9,0.7,0.5 --optimise margin --gripper-size 0.2 --gap 0.1"
    assert scene.read_text(encoding="utf-8").startswith(f"# {command}\n")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "says"), [(0, ""), (3, "turned at the start"), (1, "by search")])
def test_random_convex_bodies_are_held_by_hands_that_reach_them(tmp_path, seed, says):
    """Eight faces in general position; of the last body arms do not reach the first grasp."""
    points = np.random.default_rng(seed).normal(size=(6, 3))
    points *= 0.7 / np.linalg.norm(points, axis=1, keepdims=True)
    Polyhedron.hull(points).save(tmp_path / "body.stl")
    target = tmp_path / "held.yaml"
    result = grasp("design", tmp_path / "body.stl", "--out", target)
    assert result.exit_code == 0, result.output
    assert says in result.stderr
    system = ma.compile_system(ma.load_scene(target))
    assert judge_grasp(system).closed
    run = ma.simulate(system, duration=0.5, certificate=False)
    assert min(forces.min() for forces in run.contact_forces.values()) > 0.0


@pytest.mark.slow
def test_a_grasp_of_a_scene_is_drawn_where_its_faces_are_known(designed, tmp_path):
    _, path = designed
    assert grasp("check", path, "--plot", tmp_path / "a.svg").exit_code == 0
    assert "<svg" in (tmp_path / "a.svg").read_text()
    refused = grasp("check", WELDED, "--plot", tmp_path / "b.svg")
    assert refused.exit_code == 2
    assert "no grasp of a polyhedron" in refused.stderr
    assert not (tmp_path / "b.svg").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["cube"], "'cube' is no body; write box:LX,LY,LZ, wedge:LX,LY,LZ[,TOP]"),
        (["box:1,2"], "'box:1,2' is no body"),
        (["box:1,2,nan"], "'box:1,2,nan' is no body"),
        (["prism:2,1,1"], "a polygon has 3 to 1000 sides, not 2"),
        (["box:1,-2,1"], "positive"),
        (["missing.stl"], "missing.stl"),
        (["box:1,1,1", "--arms", "pandas", "panda"], "unknown robot 'pandas'; did you mean"),
        (["box:0.3,0.2,0.1", "--gripper-size", "0.5"], "grippers are too large for the block"),
        (["prism:200,0.5,1.0"], "revolution"),
        (["prism:4,-1,1"], "radius of a polygon is greater than 0"),
        (["box:1,1,1", "--duration", "0"], "duration is greater than 0"),
        (["box:1,1,1", "--mass", "nan"], "mass is a finite number"),
        (["box:1,1,1", "--tip-radius", "-1"], "tip_radius is greater than 0"),
        (["box:0.01,0.01,0.01"], "fingertips of radius 0.01 m do not fit"),
        (["box:1,1,1", "--out", "no/such/folder/a.yaml"], "there is no folder"),
    ],
)
def test_a_bad_design_is_one_error_in_words(words, message):
    result = grasp("design", *words)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert message in result.stderr
    assert "Traceback" not in result.output


# --- check ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_tells_verdict_regions_and_stability(designed, tmp_path):
    _, path = designed
    target = tmp_path / "grasp.json"
    result = grasp("check", path, "--json", target)
    assert result.exit_code == 0, result.output
    assert "7 contacts hold the body: form closure" in result.stdout
    told = figures(target)
    assert told["closed"]
    assert told["only_pushes"]
    assert told["immobility_order"] == 1
    assert len(told["contacts"]) == 7
    assert sum(contact["coefficient"] for contact in told["contacts"]) == pytest.approx(1.0)
    assert min(contact["coefficient"] for contact in told["contacts"]) == pytest.approx(
        told["margin"]
    )
    for contact in told["contacts"]:
        assert contact["region_area"] > 0.0
        assert contact["room"] > told["stability"]["closure_radius"] > 0.0
    assert 1e-4 / 7**0.5 < told["frame_position"] < 1e-2
    assert told["carrying_force"] > 4.0 * 9.81 / 7


@pytest.mark.parametrize("name", ["grasped_block", "corner_grippers_block", "two_ur5_box"])
def test_the_largest_force_is_the_same_over_rows_of_joints_and_over_contacts(name):
    """Smallest largest forces: over the rows, of either sign or pushing, and over all pushes."""
    judged = judge_grasp(ma.compile_system(ma.load_scene(SCENES / f"{name}.yaml")))
    # tolerance of a linear program in units of the weight, ten times
    assert judged.carrying.largest_force == pytest.approx(judged.carrying_force, rel=1e-6)


def test_without_gravity_there_is_no_weight_to_carry():
    scene = ma.load_scene(CORNERS).replace({"gravity": [0.0, 0.0, 0.0]})
    assert judge_grasp(ma.compile_system(scene)).carrying_force is None


def test_the_weight_is_carried_in_the_pose_that_the_start_was_assembled_in():
    """An arm that can move one joint only: the object, written with a turn, has to turn back."""
    scene = held_by({"kind": "weld"})
    system = ma.compile_system(scene)
    frame, names = system.frames["arm"], system.arms["arm"].joint_names
    weld = {"kind": "weld", "arm": "arm"}
    weld |= {"at": pose_of(frame.on_object), "at_tip": pose_of(frame.on_tip)}
    R = Rotation.from_rotvec([0.02, 0.0, 0.0]).as_matrix()
    pose = scene.object.pose.matrix()
    pose[:3, :3] = R @ pose[:3, :3]
    turned = scene.replace(
        {
            "joints": [weld],
            "arms.arm.lock": dict(zip(names[:5], UR5_POSTURE[:5], strict=True)),
            "arms.arm.posture": [UR5_POSTURE[5]],
            "object.pose": pose_of(pose),
        }
    )
    system = ma.compile_system(turned)
    start = np.eye(4)
    start[:3, 3] = system.initial_state().object_position
    start[:3, :3] = quaternion_to_matrix(system.initial_state().object_quaternion_xyzw.copy())
    assert np.abs(start - pose).max() > 0.01
    as_assembled = ma.compile_system(turned.replace({"object.pose": pose_of(start)}))
    force = judge_grasp(system).carrying_force
    assert force == pytest.approx(judge_grasp(as_assembled).carrying_force, rel=1e-7)


def test_contacts_of_a_weld_hold_both_ways():
    """Every row counts twice, with opposite normals and opposite forces."""
    found = read_grasp(ma.compile_system(ma.load_scene(WELDED)))
    assert found.contacts.count == 24
    assert found.pulls == (False, True) * 12
    normals = found.contacts.normals
    np.testing.assert_allclose(normals[1::2], -normals[0::2], atol=1e-15)
    np.testing.assert_array_equal(found.contacts.points[1::2], found.contacts.points[0::2])
    assert found.closure
    assert found.regions == (None,) * 24
    judged = judge_grasp(ma.compile_system(ma.load_scene(WELDED)))
    forces = np.array([contact.force for contact in judged.contacts])
    np.testing.assert_allclose(forces[1::2], -forces[0::2])
    assert judged.stability is None


def test_what_a_hinge_leaves_free_is_the_free_motion():
    """One arm by a hinge: open, and the motion that proves it turns about the hinge."""
    hinge = {"kind": "revolute", "at_tip": {"xyz": [0.01, 0.02, 0.0], "rpy": [0.3, 0.2, 0.1]}}
    system = ma.compile_system(held_by(hinge))
    judged = judge_grasp(system)
    assert not judged.closed
    motion = np.array(judged.motion)
    frame = system.frames[system.arm_names[0]].on_object
    axis, point = frame[:3, 2], frame[:3, 3]
    turn = motion[3:] / np.linalg.norm(motion[3:])
    assert abs(turn @ axis) == pytest.approx(1.0, abs=1e-7)
    # the velocity of a point of the axis is zero
    np.testing.assert_allclose(motion[:3] + np.cross(motion[3:], point), 0.0, atol=1e-7)


def test_check_of_a_hinged_scene_says_that_rows_hold_both_ways():
    result = grasp("check", HINGED)
    assert result.exit_code == 0, result.output
    assert "some hold both ways" in result.stdout


def test_too_few_fingertips_are_told_with_what_is_missing(tmp_path):
    scene = ma.load_scene(CORNERS)
    text = scene.model_dump(mode="json", exclude_defaults=True)
    del text["arms"]["right"]
    text["joints"] = [joint for joint in text["joints"] if joint["arm"] == "left"]
    text["control"] = {"kind": "none"}
    judged = judge_grasp(ma.compile_system(parse_scene(text)))
    assert not judged.closed
    assert "7" in judged.verdict
    assert "4 contacts" in judged.verdict
    assert judged.stability is None
    assert judged.motion is not None


def test_a_joint_without_points_of_contact_is_told():
    couple = {"kind": "wrenches", "wrenches": [[0, 0, 0, 0, 0, 1]]}
    system = ma.compile_system(held_by(couple))
    with pytest.raises(GraspError, match=r"no joint of this scene holds the object by contacts"):
        read_grasp(system)


def test_a_scene_that_does_not_exist_is_an_error():
    result = grasp("check", "nowhere.yaml")
    assert result.exit_code == 2
    assert "nowhere.yaml" in result.stderr


# --- the replay ----------------------------------------------------------------------------------


def test_sheets_cover_the_regions_and_face_outward():
    system = ma.compile_system(ma.load_scene(CORNERS))
    found = scene_grasp(system)
    assert found is not None
    for region in found.regions:
        mesh = sheet(region, 0.002)
        corners = mesh.vertices[mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.all(normals @ region.face.normal > 0.0)
        assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(region.area)
        np.testing.assert_allclose(
            mesh.vertices @ region.face.normal - region.face.offset, 0.002, atol=1e-12
        )


@pytest.mark.slow
def test_a_replay_shows_regions_only_of_closed_grasps_by_fingertips():
    for path, count in ((CORNERS, 8), (WELDED, 0)):
        system = ma.compile_system(ma.load_scene(path))
        run = ma.simulate(system, duration=0.02, certificate=False)
        animation = animate(run, fps=30.0, speed=1.0, meshes=False)
        regions = [body for body in animation.bodies if body.name.startswith("regions/")]
        assert len(regions) == count
        faces = [body for body in animation.bodies if body.name.endswith("_object")]
        assert faces == []  # those of a box are its own
        for region in regions:
            np.testing.assert_array_equal(region.position, animation.bodies[0].position)
