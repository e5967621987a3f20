"""Claims about what a scene may say without files: hands of fingers, objects that are hulls."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest
from mechanics import UR5_POSTURE, G
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import ObjectSpec, dump_scene, parse_scene
from multiarm.scene.fingers import FingersSpec, urdf_text

HAND = {
    "tips": [[0.1, 0.03, -0.01], [-0.01, 0.1, 0.08], [0.05, -0.01, 0.06]],
    "radius": 0.01,
    "corner": {"xyz": [0.02, -0.01, 0.2], "rpy": [0.3, -0.5, 1.2]},
    "mass": 0.7,
}
BLOCK = np.array([0.6, 0.4, 0.2])
CORNERS = (0.5 * BLOCK * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T).tolist()
WEDGE = [[0, 0, 0], [0.9, 0, 0], [0, 0.6, 0], [0, 0, 1.2]]


def one_arm(tool, **more):
    arm = {"robot": "ur5", "tip": "corner", "tool": {"mount": "tool0", **tool}}
    arm["posture"] = UR5_POSTURE
    table = {
        "gravity": G,
        "object": {"shape": {"box": [0.3, 0.2, 0.2]}, "mass": 2.0, "pose": {"xyz": [0.6, 0, 0.5]}},
        "arms": {"arm": arm},
        "joints": [{"arm": "arm", "kind": "weld"}],
    }
    return parse_scene({**table, **more})


# --- hands ---------------------------------------------------------------------------------------


def test_the_corner_and_the_fingertips_are_where_the_scene_says():
    model = pin.buildModelFromXML(urdf_text(FingersSpec(**HAND)))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    place = {frame.name: data.oMf[k] for k, frame in enumerate(model.frames)}
    turn = Rotation.from_euler("xyz", HAND["corner"]["rpy"]).as_matrix()
    np.testing.assert_allclose(place["corner"].rotation, turn, atol=1e-12)
    np.testing.assert_allclose(place["corner"].translation, HAND["corner"]["xyz"], atol=1e-15)
    for number, tip in enumerate(HAND["tips"], start=1):
        there = turn @ tip + HAND["corner"]["xyz"]
        np.testing.assert_allclose(place[f"fingertip_{number}"].translation, there, atol=1e-12)


def test_rods_lead_from_the_palm_to_the_fingertips():
    """Each steel cylinder of the URDF, placed by its own origin, ends at palm and fingertip."""
    spec = FingersSpec(**HAND)
    robot = ElementTree.fromstring(urdf_text(spec))
    corner = spec.corner.matrix()
    ends = []
    for visual in robot.findall("link[@name='palm']/visual"):
        if visual.find("material").get("name") != "steel":
            continue
        origin, shape = visual.find("origin"), visual.find("geometry/cylinder")
        xyz, rpy = (np.array(origin.get(key).split(), float) for key in ("xyz", "rpy"))
        half = 0.5 * float(shape.get("length")) * Rotation.from_euler("xyz", rpy).as_matrix()[:, 2]
        ends.append((xyz - half, xyz + half))
    assert len(ends) == 3
    for (palm, tip), wanted in zip(ends, HAND["tips"], strict=True):
        np.testing.assert_allclose(palm, ends[0][0], atol=1e-12)
        np.testing.assert_allclose(tip, corner[:3, :3] @ wanted + corner[:3, 3], atol=1e-12)


def test_a_hand_weighs_what_it_should_and_has_an_inertia_that_a_body_can_have():
    model = pin.buildModelFromXML(urdf_text(FingersSpec(**HAND)))
    (inertia,) = [i for i in model.inertias if i.mass > 0.0]
    assert inertia.mass == pytest.approx(0.7, rel=1e-12)
    moments = np.linalg.eigvalsh(inertia.inertia)
    assert moments[0] > 0.0
    assert moments[2] < moments[0] + moments[1]


def test_a_hand_of_one_finger_without_length_still_has_an_inertia():
    spec = FingersSpec(tips=[[0, 0, 0]], corner={"xyz": [0, 0, 0]})
    assert "nan" not in urdf_text(spec)


def test_a_scene_with_a_hand_runs_and_survives_its_own_text():
    scene = one_arm({"fingers": HAND})
    again = parse_scene(dump_scene(scene))
    assert again == scene
    system = ma.compile_system(again)
    model = system.arms["arm"].model
    mass = sum(inertia.mass for inertia in model.inertias)
    bare = ma.compile_system(one_arm({"fingers": {**HAND, "mass": 1e-6}})).arms["arm"].model
    assert mass - sum(inertia.mass for inertia in bare.inertias) == pytest.approx(0.7, abs=1e-5)
    assert ma.simulate(system, duration=0.01, certificate=False).status == "completed"


@pytest.mark.parametrize(
    "tool",
    [
        {"fingers": {**HAND, "tips": []}},
        {"fingers": {**HAND, "radius": 0.0}},
        {"fingers": HAND, "robot": "corner_gripper"},
        {},
    ],
)
def test_a_wrong_hand_is_refused_with_its_place(tool):
    with refused(SceneError, ".tool"):
        one_arm(tool)


# --- hulls ---------------------------------------------------------------------------------------


def test_the_hull_of_a_blocks_corners_is_the_block():
    hull = ObjectSpec(shape={"hull": CORNERS}, mass=3.0)
    box = ObjectSpec(shape={"box": BLOCK.tolist()}, mass=3.0)
    np.testing.assert_allclose(hull.inertia_matrix(), box.inertia_matrix(), atol=1e-15)


def test_a_hull_off_its_centre_of_mass_is_refused_with_the_shift():
    with refused(SceneError):
        ObjectSpec(shape={"hull": WEDGE}, mass=1.0)
    moved = (np.array(WEDGE) - [0.225, 0.15, 0.3]).tolist()
    inertia = ObjectSpec(shape={"hull": moved}, mass=1.0).inertia_matrix()
    # tetrahedron with three orthogonal edges a, b, c at a corner: I_xx = 3 m (b^2 + c^2) / 80
    assert inertia[0, 0] == pytest.approx(3.0 * (0.36 + 1.44) / 80.0, rel=1e-12)


@pytest.mark.parametrize(
    "hull",
    [
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1e-9]],
        [1, 2, 3, 4],
        [[0, 0, 0], [1, 0, "x"], [0, 1, 0], [0, 0, 1]],
        [[0, 0, 0], [1, 0], [0, 1, 0], [0, 0, 1]],
    ],
)
def test_a_hull_that_is_no_body_is_refused(hull):
    with refused(SceneError, "shape.hull"):
        ObjectSpec(shape={"hull": hull}, mass=1.0)


def test_a_hull_lands_on_the_floor_like_the_block_that_it_is():
    """Dropped flat from 0.1 m, on the same arm-free fall: the same landing, to the last digits."""
    runs = []
    for shape in ({"hull": CORNERS}, {"box": BLOCK.tolist()}):
        scene = one_arm(
            {"fingers": HAND},
            object={"shape": shape, "mass": 2.0, "pose": {"xyz": [0.6, 0, 0.5]}},
            effects={"floor": {"at": {"xyz": [0, 0, 0.3]}}},
        )
        runs.append(ma.simulate(ma.compile_system(scene), duration=0.4, certificate=False))
    hull, box = runs
    assert "touches" in [event["kind"] for event in hull.events]
    assert [event["kind"] for event in hull.events] == [event["kind"] for event in box.events]
    np.testing.assert_allclose(hull.object_position, box.object_position, atol=1e-7)
