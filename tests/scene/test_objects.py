"""Claims about the objects of a scene: their names, joints, effects and control."""

from __future__ import annotations

import copy
import json
import pickle
from typing import Any, Literal

import numpy as np
import pandas
import pytest
from jsonschema import Draft202012Validator
from refusals import refused
from repository import SCENES
from user_classes import empty_registries

import multiarm as ma
from multiarm.assembly.robots import load_robots
from multiarm.errors import SceneError
from multiarm.scene import (
    WORLD,
    BallJoint,
    BodyName,
    Scene,
    WeldJoint,
    changed_scenes,
    dump_scene,
    load_scene,
    object_named,
    parse_scene,
    with_code,
)
from multiarm.scene.values import floor_owner
from multiarm.simulation.inspection import inspect_system

BEAM = {"shape": {"box": [1.2, 0.1, 0.1]}, "mass": 8.0, "pose": {"xyz": [0.0, 0.0, 0.6]}}
PLATE = {"shape": {"box": [0.4, 0.4, 0.02]}, "mass": 2.0, "pose": {"xyz": [0.0, 0.0, 0.7]}}
TWO: dict[str, Any] = {
    "name": "beam and plate",
    "gravity": [0.0, 0.0, -9.81],
    "objects": {"beam": BEAM, "plate": PLATE},
    "arms": {
        "left": {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [-0.9, 0, 0]}},
        "right": {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [0.9, 0, 0]}},
    },
    "joints": [
        {"arm": "left", "object": "beam", "kind": "weld", "at": {"xyz": [-0.6, 0, 0]}},
        {"arm": "right", "object": "plate", "kind": "ball", "at": {"xyz": [0.2, 0, 0]}},
        {"between": ["plate", "beam"], "kind": "revolute", "at": {"xyz": [0, 0, 0.05]}},
        {"between": ["beam", "world"], "kind": "planar", "name": "rail"},
    ],
}
PD = {"kind": "joint_pd", "stiffness": 10, "damping": 1}


def scene_with(**parts: Any) -> dict[str, Any]:
    """The scene of two objects with other parts; without those that are None."""
    data = {**copy.deepcopy(TWO), **parts}
    return {key: value for key, value in data.items() if value is not None}


def joint_with(**keys: Any) -> dict[str, Any]:
    """The scene with one more joint."""
    return scene_with(joints=[*TWO["joints"], {"kind": "ball", **keys}])


# --- what a scene of several objects is --------------------------------------------------------


def test_joints_of_a_scene_know_its_objects():
    scene = parse_scene(TWO)
    bodies = {joint.connection: (joint.first, joint.second) for joint in scene.joints}
    beam, plate = object_named("beam"), object_named("plate")
    assert bodies == {
        "left": (BodyName("left", ""), beam),
        "right": (BodyName("right", ""), plate),
        "plate-beam": (plate, beam),
        "rail": (beam, WORLD),
    }
    assert beam.is_object and not beam.is_link and not WORLD.is_object
    assert not BodyName("left", "").is_object


def test_objects_come_by_name_in_their_order_however_many_there_are():
    scene = parse_scene(TWO)
    assert list(scene.all_objects) == ["beam", "plate"]
    assert [body.mass for body in scene.all_objects.values()] == [8.0, 2.0]
    assert [scene.place_of_object(name) for name in scene.all_objects] == [
        "objects.beam", "objects.plate",
    ]  # fmt: skip
    alone = parse_scene(of_one(object=BEAM))
    assert list(alone.all_objects) == ["object"] == [alone.place_of_object("object")]
    assert alone.all_objects["object"] is alone.object is alone.one_object("this")


def of_one(**parts: Any) -> dict[str, Any]:
    """A scene of two arms at one object."""
    joints = [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "ball"}]
    return scene_with(objects=None, joints=joints, **parts)


def test_the_only_object_needs_no_name_in_joints():
    scene = parse_scene(of_one() | {"objects": {"beam": BEAM}})
    assert [joint.second for joint in scene.joints] == [object_named("beam")] * 2
    named = parse_scene(of_one(object=BEAM))
    assert [joint.second for joint in named.joints] == [object_named("object")] * 2


def test_joints_made_in_python_learn_the_objects_from_their_scene():
    arm = WeldJoint(arm="left", object="beam")
    between = WeldJoint(between=["plate", "beam"])
    assert between.first == BodyName("plate", "")  # by itself it may be an arm
    joints = [arm, TWO["joints"][1], between]
    scene = Scene(**scene_with(joints=joints))
    assert scene.joints[2].first == object_named("plate")
    assert between.first == BodyName("plate", "")
    other = scene.replace({"joints[2].between": ["plate", "world"]})
    assert other.joints[2].second == WORLD and other.joints[2].first == object_named("plate")


class Clasp(ma.Joint):
    """Holds one point."""

    kind: Literal["clasp"] = "clasp"
    free = (3, 4, 5)

    def records(self):
        """Those of a ball."""
        return BallJoint(arm="left").records()


def test_joints_of_user_kinds_know_the_objects(monkeypatch):
    empty_registries(monkeypatch)
    ma.register_joint(Clasp)
    scene = with_code(parse_scene(joint_with(between=["beam", "world"], kind="clasp")))
    for same in (scene, pickle.loads(pickle.dumps(scene))):
        assert isinstance(same.joints[-1], Clasp)
        assert same.joints[-1].first == object_named("beam")


def test_a_scene_of_several_objects_survives_its_file():
    scene = parse_scene(TWO | {"effects": {"drag": {"linear": 1, "object": "plate"}}})
    again = parse_scene(dump_scene(scene))
    assert again == scene and dump_scene(again) == dump_scene(scene)
    assert list(again.all_objects) == ["beam", "plate"]
    assert Scene(**scene.model_dump()) == scene == Scene(**scene.model_dump(mode="json"))
    for twin in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert twin == scene and twin.joints[2].first == object_named("plate")


def test_a_scene_of_several_objects_shows_them_in_a_line():
    text = repr(parse_scene(TWO))
    assert "objects beam (box, 8 kg), plate (box, 2 kg);" in text


def test_values_of_objects_are_at_their_paths():
    scene = parse_scene(TWO)
    heavy = scene.replace({"objects.beam.mass": 3, "objects.plate.pose.xyz[2]": 0.9})
    assert heavy.objects["beam"].mass == 3.0 and heavy.objects["plate"].pose.xyz[2] == 0.9
    assert scene.objects["beam"].mass == 8.0
    assert heavy.joints[2].first == object_named("plate")
    masses = [{"objects.beam.mass": mass} for mass in (1.0, 2.0)]
    assert [s.objects["beam"].mass for s in changed_scenes(scene, masses)] == [1.0, 2.0]
    with refused(SceneError, "$.objects.bem"):
        scene.replace({"objects.bem.mass": 3})


def test_one_form_of_a_scene_becomes_the_other():
    scene = parse_scene(of_one(object=BEAM))
    named = scene.replace(object=None, objects={"beam": BEAM})
    assert [joint.second.tip for joint in named.joints] == ["beam", "beam"]
    assert named.replace(object=BEAM, objects=None) == scene


def test_meshes_of_objects_are_found_from_the_scene(tmp_path):
    mesh = {"shape": {"mesh": {"file": "part.stl"}}, "mass": 1.0, "inertia": [1, 1, 1]}
    scene = parse_scene(scene_with(objects={"beam": BEAM, "plate": mesh}), tmp_path)
    assert scene.objects["plate"].shape.mesh.file == tmp_path / "part.stl"
    (warning,) = (text for text in scene.warnings if "part.stl" in text)
    assert warning.startswith("$.objects.plate.shape.mesh.file: ")


# --- faults -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "places"),
    [
        ({"objects": None}, ["$.object"]),
        ({"object": BEAM}, ["$.objects"]),
        ({"objects": {}, "joints": []}, ["$.objects"]),
        ({"objects": [BEAM]}, ["$.objects"]),
        ({"objects": {**TWO["objects"], "left": BEAM}}, ["$.objects.left"]),
        ({"objects": {**TWO["objects"], "world": BEAM}}, ["$.objects.world"]),
        ({"objects": {**TWO["objects"], "floor": BEAM}}, ["$.objects.floor"]),
        ({"objects": {**TWO["objects"], "environment": BEAM}}, ["$.objects.environment"]),
        ({"objects": {**TWO["objects"], "a/b": BEAM}}, ["$.objects['a/b']"]),
        (
            {"objects": {"beam": BEAM, "plate": {**PLATE, "mass": -1}}, "run": {"accuracy": 0}},
            ["$.objects.plate.mass", "$.run.accuracy"],
        ),
    ],
    ids=[
        "neither", "both", "empty", "list", "arm", "world", "floor", "environment", "slash",
        "mass",
    ],
)  # fmt: skip
def test_faults_of_the_table_of_objects_are_told(parts, places):
    with refused(SceneError, *places):
        parse_scene(scene_with(**parts))


def test_no_object_is_named_as_a_robot():
    robots = {"beam": {"robot": "tiago_pro", "tips": {"left": "arm_left_7_link"}}}
    with refused(SceneError, "$.objects.beam"):
        parse_scene(scene_with(robots=robots))


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        ({"arm": "left"}, "$.joints[4]"),
        ({"arm": "left", "object": "bem"}, "$.joints[4].object"),
        ({"arm": "left", "object": "left"}, "$.joints[4].object"),
        ({"arm": "left", "object": 3}, "$.joints[4].object"),
        ({"arm": "left", "object": "plate"}, "$.joints"),
        ({"between": ["left", "plate"], "object": "plate"}, "$.joints[4]"),
        ({"between": ["left", "object"]}, "$.joints[4].between[1]"),
        ({"between": ["bem", "plate"]}, "$.joints[4].between[0]"),
        ({"between": ["plate", "plate"]}, "$.joints[4].between"),
        ({"between": ["plate", "left"]}, "$.joints[4].between"),
        ({"between": ["world", "plate"]}, "$.joints[4].between"),
        ({"between": ["plate", "beam"]}, "$.joints"),
        ({"between": ["plate", "beam"], "name": "floor/plate"}, "$.joints[4].name"),
    ],
    ids=lambda value: "" if isinstance(value, str) else "-".join(map(str, value.values())),
)
def test_faults_of_joints_between_objects_are_told(keys, place):
    with refused(SceneError, place):
        parse_scene(joint_with(**keys))


def test_the_only_object_is_named_right_where_it_is_named():
    joints = [{"arm": "left", "object": "bem", "kind": "weld"}, {"arm": "right", "kind": "ball"}]
    with refused(SceneError, "$.joints[0].object"):
        parse_scene(of_one(object=BEAM) | {"joints": joints})


def test_two_objects_are_joined_in_either_order():
    scene = parse_scene(joint_with(between=["beam", "plate"], at_first={"xyz": [0, 0, 0.1]}))
    joint = scene.joints[-1]
    assert (joint.first.tip, joint.second.tip) == ("beam", "plate")
    assert joint.on_first.xyz == (0.0, 0.0, 0.1) and joint.at is None


def test_an_object_that_nothing_holds_is_no_fault():
    scene = parse_scene(scene_with(objects={**TWO["objects"], "ball": BEAM}))
    assert list(scene.all_objects) == ["beam", "plate", "ball"]


# --- effects and control ------------------------------------------------------------------------


def test_effects_are_of_every_object_or_of_the_one_that_they_name():
    effects = {"drag": {"linear": 1}, "floor": {"object": "plate", "points": [[0, 0, 0]]}}
    scene = parse_scene(scene_with(effects=effects))
    of_objects = {
        name: [effect.is_of(name) for effect in (scene.effects.drag, scene.effects.floor)]
        for name in scene.all_objects
    }
    assert of_objects == {"beam": [True, False], "plate": [True, True]}


def test_wrenches_act_on_objects_by_name_or_on_links():
    push = {"force": [1.0, 0.0, 0.0]}
    names = ("beam", "plate", "left/link_6")
    wrenches = [{"on": name, **push} for name in names]
    scene = parse_scene(scene_with(effects={"external_wrenches": wrenches}))
    targets = [wrench.target for wrench in scene.effects.external_wrenches]
    assert targets == [object_named("beam"), object_named("plate"), BodyName("left", "link_6")]


@pytest.mark.parametrize(
    ("effects", "place"),
    [
        ({"drag": {"linear": 1, "object": "bem"}}, "$.effects.drag.object"),
        ({"floor": {"object": "object"}}, "$.effects.floor.object"),
        ({"floor": {"points": [[0, 0, 0]]}}, "$.effects.floor.points"),
        (
            {"external_wrenches": [{"on": "object", "force": [1, 0, 0]}]},
            "$.effects.external_wrenches[0].on",
        ),
        (
            {"external_wrenches": [{"on": "world", "force": [1, 0, 0]}]},
            "$.effects.external_wrenches[0].on",
        ),
        (
            {"external_wrenches": [{"on": "bem/link_6", "force": [1, 0, 0]}]},
            "$.effects.external_wrenches[0].on",
        ),
    ],
    ids=["drag", "floor", "points", "object", "world", "arm"],
)
def test_effects_that_name_no_object_are_refused(effects, place):
    with refused(SceneError, place):
        parse_scene(scene_with(effects=effects))


@pytest.mark.parametrize(
    "control",
    [
        "computed_torque",
        {
            "kind": "object_impedance",
            "stiffness": {"translation": 1, "rotation": 1},
            "damping": {"translation": 1, "rotation": 1},
        },
        {**PD, "path": [{"time": 1, "xyz": [0, 0, 1]}]},
    ],
    ids=["torque", "impedance", "path"],
)
def test_control_of_an_object_says_which_of_several_it_moves(control):
    with refused(SceneError, "$.control.object"):
        parse_scene(scene_with(control=control))
    parse_scene(of_one(object=BEAM, control=control))


@pytest.mark.parametrize(
    "control",
    [
        "none",
        {"kind": "constant", "torques": {"left": [1] * 6}},
        {**PD, "gravity_compensation": False},
        {"kind": "harmonic", "amplitude": {"left": 1}, "frequency": 1, "hold": False},
        {"kind": "recorded", "file": "a.csv"},
        {"function": "mine.py:hold"},
    ],
    ids=str,
)
def test_control_of_joints_is_for_any_number_of_objects(control):
    assert len(parse_scene(scene_with(control=control)).all_objects) == 2


def test_objects_alone_make_a_scene():
    half, mass, gravity = 0.5, 3.0, 9.81
    rod = {"shape": {"box": [0.1, 0.1, 2 * half]}, "mass": mass}
    level = {"xyz": [half, 0, -1.5], "rpy": [0, -np.pi / 2, 0]}
    joints = [
        {"between": ["post", "world"], "kind": "weld", "at_first": {"xyz": [0, 0, half]}},
        {"between": ["rod", "post"], "kind": "revolute", "axis": [0, 1, 0], "at": {
            "xyz": [0, 0, -1.0], "rpy": [0, -np.pi / 2, 0]}, "at_first": {"xyz": [0, 0, half]}},
    ]  # fmt: skip
    objects = {"post": {**rod, "pose": {"xyz": [0, 0, -half]}}, "rod": {**rod, "pose": level}}
    scene = parse_scene({"gravity": [0, 0, -gravity], "objects": objects, "joints": joints})
    system = ma.compile_system(scene)
    assert "2 objects" in repr(system)
    of_rod = ma.evaluate(system).object_accelerations["rod"]
    # a rod on a hinge at its end, let go where it is level: I a = m g l
    inertia = mass * (0.1**2 + (2 * half) ** 2) / 12.0 + mass * half**2
    spin = mass * gravity * half / inertia
    np.testing.assert_allclose(of_rod, [0, 0, -spin * half, 0, spin, 0], atol=1e-9)


@pytest.mark.parametrize("parts", [{"joints": []}, {"objects": None, "object": BEAM}])
def test_scenes_without_robots_need_objects_that_are_joined(parts):
    joints = [{"between": ["beam", "world"], "kind": "ball"}]
    with refused(SceneError):
        parse_scene(scene_with(**{"arms": None, "joints": joints, **parts}))


def test_what_is_for_one_object_says_so():
    with refused(SceneError, "a grasp"):
        parse_scene(TWO).one_object("a grasp")


# --- the schema ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "fits"),
    [
        (TWO, True),
        (of_one(object=BEAM), True),
        (of_one() | {"objects": {"beam": BEAM}}, True),
        (scene_with(object=BEAM), False),
        (scene_with(objects=None), False),
        (joint_with(between=["beam", "plate"], object="beam"), False),
        (joint_with(arm="left", object=3), False),
    ],
    ids=["two", "object", "one", "both", "neither", "between", "number"],
)
def test_the_schema_of_editors_knows_both_forms(data, fits):
    schema = json.loads((SCENES / "scene.schema.json").read_text(encoding="utf-8"))
    assert Draft202012Validator(schema).is_valid(data) == fits


# --- one object with a name of its own ------------------------------------------------------------


def renamed(scene: Scene, name: str) -> Scene:
    """The scene with its object below ``objects``."""
    data = scene.model_dump(mode="json", exclude_defaults=True)
    data["objects"] = {name: data.pop("object")}
    for joint in data["joints"]:
        if "between" in joint:
            joint["between"] = [name if b == "object" else b for b in joint["between"]]
    for wrench in data.get("effects", {}).get("external_wrenches", []):
        wrench["on"] = name if wrench["on"] == "object" else wrench["on"]
    return parse_scene(data, scene.folder)


EFFECTS = {
    "drag": {"linear": 3.0},
    "floor": {"at": {"xyz": [0, 0, 0.2]}, "mu": 0.4},
    "external_wrenches": [{"on": "object", "force": [2, 0, 5]}],
    "joint_damping": 0.5,
}
TORQUE = {"kind": "computed_torque", "path": [{"time": 0.5, "xyz": [0.0, 0.0, 0.55]}]}
HINGES = [
    {"arm": "left", "kind": "weld"},
    {"between": ["right", "object"], "kind": "ball", "name": "grip"},
    {"between": ["object", "world"], "kind": "prismatic", "axis": [0, 0, 1], "name": "rail"},
]


@pytest.mark.parametrize(
    "parts",
    [{"control": TORQUE}, {"effects": EFFECTS}, {"joints": HINGES, "control": "none"}],
    ids=["torque", "effects", "world"],
)
def test_one_object_moves_as_it_does_without_a_name(parts):
    scene = load_scene(SCENES / "two_ur5_box.yaml").replace(**parts)
    runs, facts, starts = [], [], []
    for same in (scene, renamed(scene, "beam")):
        system = ma.compile_system(same)
        runs.append(ma.simulate(system, duration=0.05))
        facts.append(inspect_system(system))
        starts.append(system.start_report)
    pandas.testing.assert_frame_equal(*(run.to_pandas() for run in runs), check_exact=True)
    assert runs[0].status == runs[1].status and starts[0] == starts[1]
    of_object, of_beam = facts
    assert of_beam.object is None and of_beam.objects == {"beam": of_object.object}
    assert of_object.freedom == of_beam.freedom and of_object.warnings == of_beam.warnings


# --- postures -----------------------------------------------------------------------------------


def test_postures_are_found_at_the_objects_that_arms_hold():
    scene = load_scene(SCENES / "two_ur5_box.yaml")
    boxes = {
        name: {"shape": {"box": [0.3, 0.3, 0.3]}, "mass": 1.0, "pose": {"xyz": [x, 0, 0.5]}}
        for name, x in (("near_left", -0.4), ("near_right", 0.4))
    }
    data = scene.model_dump(mode="json", exclude_defaults=True)
    data |= {"objects": boxes, "control": "none"}
    data.pop("object")
    turns = {"left": [0.0, np.pi / 2, 0.0], "right": [0.0, -np.pi / 2, 0.0]}
    data["joints"] = [
        {
            "arm": arm,
            "object": f"near_{arm}",
            "kind": "weld",
            "at": {"xyz": [-0.15 if arm == "left" else 0.15, 0, 0], "rpy": turns[arm]},
        }
        for arm in ("left", "right")
    ]
    for arm in data["arms"].values():
        arm["posture"] = "solve"
    found = load_robots(parse_scene(data, scene.folder))
    for joint in parse_scene(data, scene.folder).joints:
        pose = np.eye(4)
        pose[:3, 3] = boxes[joint.second.tip]["pose"]["xyz"]
        tip = found.by_name[joint.arm].tip_pose(found.postures[joint.arm], "")
        np.testing.assert_allclose(tip, pose @ joint.at.matrix(), atol=1e-9)


def test_owners_of_floors_are_told_apart_by_objects():
    assert floor_owner("object", ["object"]) == "floor" == floor_owner("beam", ["beam"])
    assert floor_owner("beam", ["beam", "plate"]) == "floor/beam"
