"""Claims about objects without a pose: their joints place them.

The oracle: transforms by SciPy, from the frames that the scene writes.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import dump_scene, parse_scene

BEAM = {"xyz": [0.5, -0.2, 0.8], "rpy": [0.3, -0.4, 1.1]}
ON_BEAM = {"xyz": [0.1, 0.05, 0.05], "rpy": [0.2, 0.1, -0.7]}
ON_PLATE = {"xyz": [-0.05, 0.0, 0.02], "rpy": [-0.5, 0.6, 0.0]}
ON_PIN = {"xyz": [0.0, 0.0, 0.1]}
ROUNDING = 1e-14


def frame(pose) -> RigidTransform:
    turn = Rotation.from_euler("xyz", pose.get("rpy", [0.0, 0.0, 0.0]))
    return RigidTransform.from_components(pose["xyz"], turn)


def objects(**poses):
    """Boxes with these poses; None leaves the pose out."""
    box = {"shape": {"box": [0.3, 0.2, 0.1]}, "mass": 2.0}
    return {n: box | ({} if pose is None else {"pose": pose}) for n, pose in poses.items()}


def start(scene):
    return ma.compile_system(parse_scene(scene)).initial_state().objects


def assert_placed(motion, expected):
    turn = Rotation.from_quat(motion.quaternion_xyzw) * expected.rotation.inv()
    assert np.allclose(motion.position, expected.translation, rtol=0.0, atol=ROUNDING)
    assert turn.magnitude() < ROUNDING


def test_a_chain_of_objects_is_placed_from_the_one_with_a_pose():
    """In whatever order joints and bodies are written."""
    joints = [
        {"between": ["pin", "plate"], "kind": "weld", "at": ON_PIN, "at_first": ON_PIN},
        {"between": ["beam", "plate"], "kind": "revolute", "at": ON_PLATE, "at_first": ON_BEAM},
    ]
    placed = start({"objects": objects(pin=None, plate=None, beam=BEAM), "joints": joints})
    plate = frame(BEAM) * frame(ON_BEAM) * frame(ON_PLATE).inv()
    assert_placed(placed["beam"], frame(BEAM))
    assert_placed(placed["plate"], plate)
    assert_placed(placed["pin"], plate)


def test_the_world_and_a_hand_place_objects():
    posture = [0.1, -1.2, 1.4, 0.3, 0.4, 0.2]
    joints = [
        {"arm": "left", "object": "beam", "kind": "ball", "at": ON_BEAM},
        {"between": ["plate", "world"], "kind": "weld", "at": BEAM, "at_first": ON_PLATE},
    ]
    arms = {"left": {"robot": "ur5", "posture": posture}}
    scene = {"objects": objects(beam=None, plate=None), "joints": joints, "arms": arms}
    system = ma.compile_system(parse_scene(scene))
    tip = system.kinematics(system.initial_state()).tips["left"]
    turn = Rotation.from_matrix(tip.rotation)
    hand = RigidTransform.from_components(tip.position, turn)
    placed = system.initial_state().objects
    assert_placed(placed["beam"], hand * frame(ON_BEAM).inv())
    assert_placed(placed["plate"], frame(BEAM) * frame(ON_PLATE).inv())


def test_a_hand_that_is_to_be_found_reaches_for_a_placed_object():
    joints = [
        {"between": ["plate", "beam"], "kind": "weld", "at": {"xyz": [0.0, 0.0, 0.1]}},
        {"arm": "left", "object": "plate", "kind": "ball", "at": {"xyz": [0.0, 0.0, 0.05]}},
    ]
    arms = {"left": {"robot": "ur5", "posture": "solve"}}
    there = {"xyz": [0.5, 0.1, 0.3]}
    scene = {"objects": objects(beam=there, plate=None), "joints": joints, "arms": arms}
    assert_placed(start(scene)["plate"], frame({"xyz": [0.5, 0.1, 0.4]}))


def test_a_joint_without_at_is_where_its_bodies_are():
    joint = {"between": ["plate", "beam"], "kind": "weld"}
    placed = start({"objects": objects(plate=None, beam=BEAM), "joints": [joint]})
    assert_placed(placed["plate"], frame({"xyz": [0.0, 0.0, 0.0]}))


def test_two_objects_without_a_pose_do_not_place_each_other():
    joint = {"between": ["plate", "beam"], "kind": "weld", "at": {"xyz": [0.0, 0.0, 0.1]}}
    with pytest.raises(SceneError, match="plate-beam"):
        start({"objects": objects(plate=None, beam=None), "joints": [joint]})


def test_a_pose_at_the_origin_that_is_written_stays_written():
    """Beside a joint that would turn the object; also after the scene was stored."""
    turned = {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 1.0]}
    joint = {"between": ["plate", "world"], "kind": "ball", "at": turned}
    parts = objects(plate={"xyz": [0.0, 0.0, 0.0]}, beam=BEAM)
    scene = parse_scene({"objects": parts, "joints": [joint]})
    for again in (scene, parse_scene(dump_scene(scene))):
        plate = ma.compile_system(again).initial_state().objects["plate"]
        assert np.array_equal(plate.quaternion_xyzw, [0.0, 0.0, 0.0, 1.0])
    placed = parse_scene({"objects": objects(plate=None, beam=BEAM), "joints": [joint]})
    for again in (placed, parse_scene(dump_scene(placed))):
        assert_placed(ma.compile_system(again).initial_state().objects["plate"], frame(turned))


def test_an_object_that_nothing_places_is_told():
    joint = {"between": ["plate", "beam"], "kind": "ball", "at": ON_BEAM}
    scene = {"objects": objects(plate=None, beam=BEAM, pin=None), "joints": [joint]}
    (warning,) = ma.compile_system(parse_scene(scene)).start_warnings
    assert warning.startswith("$.objects.pin: no 'pose' is written, and")
