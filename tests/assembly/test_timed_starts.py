"""Claims about starts of scenes whose joints hold for some of the time."""

from __future__ import annotations

import numpy as np
import pytest
from box_between_arms import from_, two_arms
from event_scenes import arm
from refusals import refused

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import parse_scene
from multiarm.simulation.inspection import inspect_system

PLACE = {"xyz": [0.2, 0, 0]}
APART = [1.5, 0.1, 0.2, 1.0, 0.3, 0.4]


def compiled(data: dict) -> ma.System:
    return ma.compile_system(parse_scene(data))


def with_joint(times: dict, right: dict | None = None, **joint) -> dict:
    """The scene with another joint of the right arm."""
    data = two_arms(right=right, **times)
    data["joints"][1] |= joint
    return data


def test_a_joint_that_takes_hold_later_is_not_assembled():
    """Neither its gap nor the way round that it would be closed in counts at the start."""
    turned = [0.5, 0, 0, 3.0, 0, 0]
    system = compiled(with_joint(from_(1.0), arm("xyzXYZ", posture=turned), at=PLACE))
    assert system.initial_state().joint_positions["right"].tolist() == turned
    assert system.start_report.gaps["left"] == 0.0
    assert system.start_report.joint_change == 0.0
    with refused(SceneError, "right"):
        compiled(with_joint({}, arm("xyzXYZ", posture=turned), at=PLACE))


def test_a_joint_that_holds_until_later_is_assembled():
    near = arm("xyzXYZ", posture=[0.21, 0, 0.1, 0, 0, 0])
    system = compiled(with_joint({"until": 1.0}, near, at=PLACE))
    start = system.initial_state().joint_positions["right"]
    np.testing.assert_allclose(start[:3], [0.2, 0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "free"),
    [
        ({"kind": "corner_gripper"}, ("turn x", "turn z")),
        ({"kind": "point_on_plane"}, ("slide x", "slide y", "turn x", "turn y", "turn z")),
        ({"kind": "wrenches", "wrenches": np.eye(6)[:5].tolist()}, ("turn z",)),
        ({"kind": "revolute"}, ("turn z",)),
    ],
)
@pytest.mark.parametrize("at", [None, PLACE])
def test_free_motions_are_those_of_the_joint_where_it_holds(joint, free, at):
    """As of the same joint that holds all the time, wherever the bodies are at the start."""
    place = {} if at is None else {"at": at}
    right = arm("xyzXYZ", posture=APART)
    assert compiled(with_joint(from_(1.0), right, **joint, **place)).frames["right"].labels == free
    closed = compiled(with_joint({}, **joint))
    assert closed.frames["right"].labels == free


@pytest.mark.parametrize(
    "surface",
    [
        {"plane": {"point": [0.2, 0, 0], "normal": [1, 0, 0]}},
        {"ellipsoid": {"semi_axes": [0.2, 0.1, 0.1]}},
    ],
)
def test_contacts_that_are_apart_have_free_motions(surface):
    contact = {"arm": {"sphere": {"radius": 0.01}}, "object": surface}
    right = arm("xyzXYZ", posture=APART)
    system = compiled(with_joint(from_(1.0), right, kind="contacts", contacts=[contact]))
    assert len(system.frames["right"].labels) == 5


def test_weight_is_carried_by_the_joints_that_hold_at_the_start():
    data = two_arms(**from_(1.0))
    assert compiled(data).start_warnings == ()
    data["joints"][0]["from"] = 0.5
    (warning,) = compiled(data).start_warnings
    assert "at the start" in warning
    data["joints"][0]["from"] = 0.0
    assert compiled(data).start_warnings == ()


def test_an_object_that_lies_on_the_floor_needs_no_joint_at_the_start():
    data = two_arms(**from_(1.0))
    data["joints"][0]["from"] = 0.5
    data["effects"]["floor"] = {}  # on which the box stands
    assert compiled(data).start_warnings == ()
    data["effects"]["floor"] = {"at": {"xyz": [0, 0, -0.01]}}
    (warning,) = compiled(data).start_warnings
    assert "at the start" in warning


@pytest.mark.parametrize(("tilt", "falls"), [(0.0, False), (0.3, True)])
def test_an_object_on_one_edge_falls(tilt, falls):
    height = 0.1 * np.sin(tilt) + 0.05 * np.cos(tilt)
    pose = {"xyz": [0, 0, height], "rpy": [0, tilt, 0]}
    data = {
        "gravity": [0, 0, -9.81],
        "object": {"shape": {"box": [0.2, 0.2, 0.1]}, "mass": 1.0, "pose": pose},
        "arms": {"a": {"robot": "ur5", "base": {"xyz": [-0.7, 0, 0]}, "posture": [0.0] * 6}},
        "joints": [{"arm": "a", "kind": "weld", "from": 2.0}],
        "control": {"kind": "gravity_compensation"},
        "effects": {"floor": {}},
    }
    assert any("falls" in warning for warning in compiled(data).start_warnings) == falls


LEFT, RIGHT = ({"xyz": [x, 0, 0.05], "rpy": [np.pi, 0, 0]} for x in (-0.9, 0.9))


def beside_a_beam(joints: list[dict]) -> dict:
    """A UR5 whose base is to be found, and a beam that is longer than its reach."""
    return {
        "gravity": None,
        "object": {"shape": {"box": [2.0, 0.4, 0.1]}, "mass": 3.0, "pose": {"xyz": [0, 0, 0.4]}},
        "arms": {"a": {"robot": "ur5", "base": {"solve": ["x", "y"]}}},
        "joints": joints,
    }


@pytest.mark.parametrize(
    ("times", "later"),
    [
        ({"until": 1.0}, from_(2.0)),
        (from_(1.0), from_(2.0)),
        (from_(1.0), from_("never")),
        ({}, from_({"when": lambda t, state: 1.0 - t})),
    ],
    ids=["holds at the start", "takes hold first", "by command", "when"],
)
@pytest.mark.parametrize("first", [True, False])
def test_a_base_is_found_for_the_joint_that_holds_first(times, later, first):
    """It is that of this joint alone, in whichever order both are written."""
    pair = {"between": ["a", "object"], "name": "pair"}
    begins = {"arm": "a", "kind": "weld", "at": LEFT, **times}
    follows = {**pair, "kind": "weld", "at": RIGHT, **later}
    alone = compiled(beside_a_beam([begins])).scene.arms["a"].base
    both = [begins, follows] if first else [follows, begins]
    system = compiled(beside_a_beam(both))
    assert system.scene.arms["a"].base == alone
    begins, follows = {**begins, **pair}, {**follows, "arm": "a"}
    del begins["arm"], follows["between"], follows["name"]
    system = compiled(beside_a_beam([begins, follows] if first else [follows, begins]))
    assert system.scene.arms["a"].base == alone


def test_a_base_is_not_found_without_the_place_of_the_joint_that_holds_first():
    joints = [
        {"arm": "a", "kind": "weld", "at": RIGHT, **from_(2.0)},
        {"between": ["a", "object"], "kind": "weld", "until": 1.0},
    ]
    with refused(SceneError, "$.arms.a.base.solve", "$.joints[1].at"):
        compiled(beside_a_beam(joints))
    with refused(SceneError, "$.arms.a.base.solve", "with an object"):
        compiled(beside_a_beam([{"between": ["a", "world"], "kind": "weld", "at": RIGHT}]))


def test_constant_torques_hold_the_start_with_the_joints_that_hold_there():
    """The left arm carries all of the box, and the right one itself alone."""
    control = {"kind": "harmonic", "amplitude": {}, "frequency": 1.0}
    system = compiled(two_arms(control=control, **from_(1.0)))
    torques = ma.evaluate(system).joint_torques
    weight = 9.81 * system.scene.object.mass
    own = 9.81 * 1.0  # of an arm
    np.testing.assert_allclose(torques["left"][2], weight + own, rtol=1e-12)
    np.testing.assert_allclose(torques["right"][2], own, rtol=1e-12)


def test_freedom_is_counted_with_the_joints_that_hold_at_the_start():
    inspection = inspect_system(compiled(two_arms(**from_(1.0))))
    assert inspection.freedom.constraints == 6
    assert inspection.freedom.mobility == 12
    assert [joint.times for joint in inspection.joints] == ["", "from 1 s"]
    assert inspection.carrying.possible


@pytest.mark.parametrize(("times", "possible"), [(from_(0.0), True), (from_(1.0), False)])
def test_what_is_carried_is_judged_with_the_joints_that_hold_at_the_start(times, possible):
    """A ball joint beside the middle of the box cannot carry it alone."""
    data = two_arms(**times)
    data["arms"]["left"]["posture"] = [-0.2, 0, 0.1, 0, 0, 0]
    data["joints"][0] = {"arm": "left", "kind": "ball"}
    assert inspect_system(compiled(data)).carrying.possible == possible


def test_the_posture_is_solved_for_where_the_arm_takes_hold():
    solve = {"posture": "solve"}
    system = compiled(with_joint(from_(1.0), solve, at=PLACE))
    tip = system.kinematics(system.initial_state()).tips["right"].position
    np.testing.assert_allclose(tip, [0.2, 0, 0.1], atol=1e-9)
    with refused(SceneError, "$.arms.right.posture", "$.joints[1].at"):
        compiled(with_joint(from_(1.0), solve))


def test_the_posture_is_solved_for_the_joint_that_takes_hold_first():
    data = with_joint(from_(2.0), {"posture": "solve"}, at=PLACE)
    earlier = {"xyz": [-0.2, 0, 0]}
    data["joints"].append(
        {
            "between": ["right", "object"],
            "name": "first",
            "kind": "weld",
            "at": earlier,
            "from": 1.0,
        }
    )
    tip = compiled(data).kinematics(compiled(data).initial_state()).tips["right"].position
    np.testing.assert_allclose(tip, [-0.2, 0, 0.1], atol=1e-9)


def test_a_posture_that_is_not_written_is_not_sought_for_later_joints():
    system = compiled(with_joint(from_(1.0), {"posture": None}, at=PLACE))
    assert system.initial_state().joint_positions["right"].tolist() == [0.0] * 6


def test_objects_are_placed_by_joints_that_hold_at_the_start():
    data = two_arms()
    plate = {"shape": {"box": [0.1, 0.1, 0.02]}, "mass": 1.0}
    data["objects"] = {"box": data.pop("object"), "plate": plate}
    for joint in data["joints"]:
        joint["object"] = "box"
    on_box = {"between": ["plate", "box"], "kind": "weld"}
    data["joints"] += [
        {**on_box, "name": "later", "at": {"xyz": [0, 0, 0.5]}, "from": 1.0},
        {**on_box, "name": "now", "at": {"xyz": [0, 0, 0.3]}, "until": 1.0},
    ]
    start = compiled(data).initial_state()
    np.testing.assert_allclose(start.objects["plate"].position, [0, 0, 0.4], atol=1e-12)


def test_summaries_say_when_joints_hold():
    system = compiled(two_arms(**from_([[1, 2], [4, "never"]])))
    assert "holds from 1 s until 2 s, from 4 s" in system._repr_html_()
