"""Claims about effects as they are written: every form, every fault, and the way back to YAML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mechanics import UR5_POSTURE, chain_urdf, scene_of, ur5_pair
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import EffectsSpec, ExternalWrench, dump_scene, parse_scene
from multiarm.scene.effects import BUILT_IN
from multiarm.scene.text import parse_yaml
from multiarm.simulation.inspection import active_effects

PACKAGE = Path(ma.__file__).parent
WELD = {"kind": "weld"}


def pair(effects: dict, **more):
    return ur5_pair(WELD, WELD, effects=effects, **more)


def faults_of(effects: dict, **more) -> list[str]:
    with pytest.raises(SceneError) as caught:
        pair(effects, **more)
    return caught.value.faults


PUSH = {"on": "object", "force": [1, 0, 0]}


def wrench(**changes) -> dict:
    return {"external_wrenches": [PUSH, {**PUSH, **changes}]}


FAULTS = {
    "unknown effect": (
        {"dragg": {"linear": 1.0}},
        "$.effects.dragg: unknown effect 'dragg'; did you mean 'drag'?",
    ),
    "negative damping": ({"joint_damping": -1.0}, "$.effects.joint_damping: must not be negative"),
    "neither number nor urdf": (
        {"joint_damping": "URDF"},
        "$.effects.joint_damping: must be a number, a list, a table or 'urdf', got 'URDF'",
    ),
    "unknown arm": (
        {"torque_limits": {"rigth": "urdf"}},
        "$.effects.torque_limits.rigth: unknown arm 'rigth'; did you mean 'right'?",
    ),
    "unknown joint": (
        {"rotor_inertia": {"left": {"elbow": 1.0}}},
        "$.effects.rotor_inertia.left.elbow: unknown joint 'elbow'; did you mean 'elbow_joint'?",
    ),
    "wrong number of joints": (
        {"joint_friction": {"torque": {"left": [1.0, 2.0]}}},
        "$.effects.joint_friction.torque.left: 2 values for 6 movable joints",
    ),
    "negative friction": (
        {"joint_friction": {"left": -0.1}},
        "$.effects.joint_friction.torque: must not be negative, got -0.1",
    ),
    "unknown model": (
        {"joint_friction": {"torque": 1.0, "model": "stick"}},
        "$.effects.joint_friction.model: unknown value 'stick'; choices are 'smooth', 'set_valued'",
    ),
    "speed of the other model": (
        {"joint_friction": {"torque": 1.0, "model": "set_valued", "speed": 0.1}},
        "$.effects.joint_friction: 'speed' belongs to model 'smooth'",
    ),
    "speed of zero": (
        {"joint_friction": {"torque": 1.0, "speed": 0}},
        "$.effects.joint_friction.speed: must be greater than 0, got 0",
    ),
    "rotors are not in a urdf": (
        {"rotor_inertia": "urdf"},
        "$.effects.rotor_inertia: must be a number, got 'urdf'",
    ),
    "unknown start": (
        {"actuator_lag": {"time_constant": 0.1, "start": "rest"}},
        "$.effects.actuator_lag.start: unknown value 'rest'; choices are 'command', 'zero'",
    ),
    "lag without a time": (
        {"actuator_lag": {"start": "zero"}},
        "$.effects.actuator_lag.time_constant: is missing (time constant T [s]",
    ),
    "drag of nothing": ({"drag": {"wind": [1, 0, 0]}}, "$.effects.drag: resists nothing; give"),
    "area alone": ({"drag": {"area": 1.0}}, "$.effects.drag: 'area' needs 'coefficient' too"),
    "coefficient alone": (
        {"drag": {"coefficient": 1.0, "linear": 1.0}},
        "$.effects.drag: 'coefficient' needs 'area' too",
    ),
    "two axes": (
        {"drag": {"linear": [1.0, 2.0]}},
        "$.effects.drag.linear: must be a number, or a list of 3 for the object's axes",
    ),
    "negative drag": (
        {"drag": {"quadratic": [1.0, -2.0, 0.0]}},
        "$.effects.drag.quadratic: must not be negative",
    ),
    "no wrenches": ({"external_wrenches": []}, "$.effects.external_wrenches: is empty; list"),
    "wrench without a force": (
        {"external_wrenches": [{"on": "object"}]},
        "$.effects.external_wrenches[0]: needs 'force', 'torque' or both",
    ),
    "wrench on nothing": (
        wrench(on="left"),
        "$.effects.external_wrenches[1].on: must be 'object' or 'arm/link', got 'left'",
    ),
    "wrench on an unknown arm": (
        wrench(on="middle/tool0"),
        "$.effects.external_wrenches[1].on: unknown arm 'middle'; arms are 'left', 'right'",
    ),
    "wrench on an unknown link": (
        wrench(on="left/forearm"),
        "$.effects.external_wrenches[1].on: unknown link 'forearm'; did you mean 'forearm_link'?",
    ),
    "wrench on the base": (
        wrench(on="left/base_link"),
        "$.effects.external_wrenches[1].on: link 'base_link' does not move; links that do are",
    ),
    "two courses": (
        wrench(sinusoid={"frequency": 1.0}, pulse={"begin": 0, "end": 1}),
        "$.effects.external_wrenches[1]: gives 'sinusoid' and 'pulse'; keep one of them",
    ),
    "pulse backwards": (
        wrench(pulse={"begin": 2, "end": 1}),
        "$.effects.external_wrenches[1].pulse: ends at 1 s, not after its beginning at 2 s",
    ),
    "function and force": (
        wrench(function="push.py:push"),
        "$.effects.external_wrenches[1]: the function gives force and torque; remove 'force'",
    ),
    "no function": (
        {"external_wrenches": [{"on": "object", "function": "push"}]},
        "$.effects.external_wrenches[0].function: must be a Python function, or name one as",
    ),
    "table of one row": (
        wrench(table={"times": [0.0], "values": [1.0]}),
        "$.effects.external_wrenches[1].table.times: a table needs at least 2 times, got 1",
    ),
    "table backwards": (
        wrench(table={"times": [0, 2, 1], "values": [1, 1, 1]}),
        "table.times: times must increase, but row 3 has 1 s after 2 s",
    ),
    "table of unequal columns": (
        wrench(table={"times": [0, 1], "values": [1, 1, 1]}),
        "$.effects.external_wrenches[1].table: has 2 times and 3 values",
    ),
    "half a table": (
        wrench(table={"times": [0, 1]}),
        "$.effects.external_wrenches[1].table: needs 'times' and 'values', or a 'file'",
    ),
    "table twice": (
        {"external_wrenches": [{"on": "object", "table": {"file": "a.csv", "times": [0, 1]}}]},
        "$.effects.external_wrenches[0].table: gives both 'file' and 'times' or 'values'",
    ),
    "values that are no numbers": (
        wrench(table={"times": [0, "x"], "values": [1, 1]}),
        "$.effects.external_wrenches[1].table.times[1]: must be a number, got 'x'",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_told_at_its_place_with_a_way_out(name):
    effects, expected = FAULTS[name]
    (found,) = faults_of(effects)
    assert expected in found


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "no file at "),
        ("t,fx,fy\n0,1,2\n", "line 1: has 3 columns; they are t, fx, fy, fz, mx, my, mz"),
        ("0,1,2,3,4,5,6\n1,1,2,x,4,5,6\n", "line 2: fz must be a finite number, got 'x'"),
        ("0,1,2,3,4,5,6\n1,1,2,inf,4,5,6\n", "line 2: fz must be a finite number, got 'inf'"),
        ("0,1,2,3,4,5,6\n0,1,2,3,4,5,6\n", "times must increase, but row 2 has 0 s after 0 s"),
        ("0,1,2,3,4,5,6\n", "a table needs at least 2 times, got 1"),
    ],
)
def test_a_bad_file_is_a_fault_of_the_scene(tmp_path, text, expected):
    path = tmp_path / "w.csv"
    if text is not None:
        path.write_text(text)
    (found,) = faults_of({"external_wrenches": [{"on": "object", "table": {"file": str(path)}}]})
    assert found.startswith("$.effects.external_wrenches[0].table.file: ")
    assert expected in found and str(path) in found


def test_faults_of_all_effects_are_told_at_once():
    effects = {"joint_damping": {"up": 1.0}, "torque_limits": -1.0, "drag": {"area": 1.0}}
    assert len(faults_of({**effects, "rotor_inertia": {"down": 2.0}})) >= 2
    assert len(faults_of({"joint_damping": {"up": 1.0}, "rotor_inertia": {"down": 2.0}})) == 2


EVERY = {
    "joint_damping": {"left": "urdf", "right": [1, 2, 3, 4, 5, 6]},
    "joint_friction": {"torque": {"left": {"elbow_joint": 1.0}}, "speed": 0.02},
    "rotor_inertia": 0.1,
    "torque_limits": "urdf",
    "actuator_lag": {"time_constant": {"left": 0.01}, "start": "zero"},
    "drag": {"area": [0.1, 0.2, 0.3], "coefficient": 1.1, "density": 1000.0},
    "external_wrenches": [
        {"on": "object", "at": [0, 0, 1], "axes": "body", "force": [1, 2, 3]},
        {**PUSH, "sinusoid": {"frequency": 2.0, "phase": 0.1}},
        {**PUSH, "pulse": {"begin": 0.1, "end": 0.2}},
        {**PUSH, "table": {"times": [0, 1], "values": [0, 1]}},
        {"on": "right/forearm_link", "function": "numpy:ones"},
    ],
}


def test_every_effect_survives_writing_and_reading(tmp_path):
    path = tmp_path / "w.csv"
    path.write_text("0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n")
    file = {"on": "object", "table": {"file": str(path)}}
    scene = pair({**EVERY, "external_wrenches": [*EVERY["external_wrenches"], file]})
    again = parse_scene(dump_scene(scene))
    assert again == scene
    assert set(active_effects(scene)) == {"gravity", *EVERY}
    assert active_effects(again) == active_effects(scene)


def test_relative_files_start_at_the_scene(tmp_path):
    (tmp_path / "w.csv").write_text("0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n")
    scene = ma.load_scene(SCENES / "two_ur5_box.yaml")
    data = scene.model_dump(exclude_unset=True)
    data["effects"] = {"external_wrenches": [{"on": "object", "table": {"file": "w.csv"}}]}
    table = ma.Scene(folder=tmp_path, **data).effects.external_wrenches[0].table
    assert table.file == tmp_path / "w.csv"


def test_on_is_a_word_and_true_is_a_truth_value():
    """In YAML 1.1 ``on`` would be true, as a key too."""
    text = dump_scene(pair({})) + "effects: {external_wrenches: [{on: object, force: [1, 0, 0]}]}\n"
    found = parse_scene(text).effects.external_wrenches
    assert found == (ExternalWrench(on="object", force=[1, 0, 0]),)
    control = "control: {kind: joint_pd, stiffness: 1, damping: 1, gravity_compensation: %s}\n"
    for word, meaning in (("true", True), ("no", False), ("False", False)):
        with_control = dump_scene(pair({})) + control % word
        assert parse_scene(with_control).control.gravity_compensation is meaning


def chain_of(tmp_path, dynamics: str):
    path = tmp_path / "chain.urdf"
    path.write_text(chain_urdf("zxyzxy").replace("</joint>", f"{dynamics}</joint>", 3))
    arm = {"urdf": str(path), "tip": "tip", "posture": 0.3 * np.ones(6)}
    body = {"shape": {"sphere": 0.1}, "mass": 1.0}
    return lambda **effects: scene_of(
        {"arm": arm}, [{"arm": "arm", **WELD}], object=body, effects=effects
    )


def test_numbers_of_a_urdf_are_those_of_its_joints(tmp_path):
    scene = chain_of(tmp_path, "<dynamics damping='2.5' friction='0.7'/>")
    system = ma.compile_system(scene(joint_damping="urdf", joint_friction={"arm": "urdf"}))
    damping, friction = (kernel.arrays[0] for kernel in system.model.effects.kernels)
    assert damping.tolist() == [2.5] * 3 + [0.0] * 3
    assert friction.tolist() == [0.7] * 3 + [0.0] * 3
    assert not system.scene.warnings


def test_a_urdf_that_says_nothing_is_a_warning():
    scene = pair({"joint_damping": {"left": "urdf"}, "joint_friction": "urdf"})
    told = [text for text in scene.warnings if text.startswith("$.effects")]
    assert [text.partition(":")[0] for text in told] == [
        "$.effects.joint_damping.left",
        "$.effects.joint_friction.torque",
        "$.effects.joint_friction.torque",
    ]
    assert "the URDF of arm 'left' gives no joint a <dynamics damping>" in told[0]
    assert not [text for text in pair({"torque_limits": "urdf"}).warnings if "effort" in text]


def test_negative_numbers_of_a_urdf_are_a_fault(tmp_path):
    scene = chain_of(tmp_path, "<dynamics damping='-1' friction='-2'/>")
    with refused(SceneError, "'joint_1'"):
        scene(joint_damping="urdf")
    with refused(SceneError, "joint_friction.torque"):
        scene(joint_friction="urdf")
    assert scene(joint_damping=1.0).effects.joint_damping == 1.0


def test_an_arm_that_is_unsound_does_not_hide_the_faults_of_effects():
    arms = {"left": {"robot": "ur55", "tip": "tool0"}, "right": {
        "robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}}  # fmt: skip
    joints = [{"arm": name, **WELD} for name in arms]
    effects = {
        "joint_damping": {"left": [1.0], "right": [1.0]},
        "external_wrenches": [{**PUSH, "on": "left/anything"}, {**PUSH, "on": "right/nothing"}],
    }
    with pytest.raises(SceneError) as caught:
        scene_of(arms, joints, effects=effects)
    places = {fault.partition(": ")[0] for fault in caught.value.faults}
    assert places == {
        "$.arms.left.robot",
        "$.effects.joint_damping.right",
        "$.effects.external_wrenches[1].on",
    }


@pytest.mark.parametrize("effect", ["joint_damping", "rotor_inertia", "torque_limits"])
def test_numbers_may_be_listed_joint_by_joint(effect):
    assert getattr(pair({effect: [1, 2, 3, 4, 5, 6]}).effects, effect) == (1, 2, 3, 4, 5, 6)
    fault, *_ = faults_of({effect: [1, 2]})
    assert fault.startswith(f"$.effects.{effect}") and "6" in fault


def test_a_shorthand_is_the_whole_table():
    assert EffectsSpec(joint_friction=2.0) == EffectsSpec(joint_friction={"torque": 2.0})
    by_arm = {"left": 2.0, "right": "urdf"}
    assert EffectsSpec(joint_friction=by_arm) == EffectsSpec(joint_friction={"torque": by_arm})
    assert EffectsSpec(actuator_lag=0.1).actuator_lag.start == "command"
    assert EffectsSpec(joint_friction=2.0).joint_friction.model == "smooth"


@pytest.mark.parametrize("name", BUILT_IN)
def test_an_effect_says_what_it_is_by_an_example_that_scenes_can_have(name):
    kind = BUILT_IN[name]
    scene = pair(parse_yaml(kind.example)["effects"])
    assert kind.picture and scene.effects.named.keys() == {name}
    assert parse_scene(dump_scene(scene)) == scene
    typical = kind.typical(scene.object)
    assert (typical is None) == (name in ("external_wrenches", "contact_compliance"))
    assert typical is None or pair({name: typical}).effects.named.keys() == {name}
    home = PACKAGE / "effects" / f"{name}.py"
    assert home.is_file() or scene.effects.with_events == (name,)
