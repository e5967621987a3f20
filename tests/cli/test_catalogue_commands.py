"""Claims about the lists of controls, effects and methods: complete, in full, as JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pinocchio as pin
import pytest
from commands import multiarm

import multiarm as ma
from multiarm.scene import (
    EFFECTS,
    EffectsSpec,
    Scene,
    Shape,
    available_robots,
    load_scene,
    parse_scene,
)
from multiarm.scene.faults import models_in
from multiarm.scene.loading import parse_yaml
from multiarm.scene.parameters import parameters_of
from multiarm.scene.run import StabilizationSpec
from multiarm.scene.settings import STABILIZATIONS
from multiarm.tableaus import METHODS

CONTROLS = {
    model.model_fields["kind"].default: model
    for model in models_in(Scene.model_fields["control"].annotation)
}
LISTS = {
    "controls": list(CONTROLS),
    "effects --list": list(EffectsSpec.model_fields),
    "methods": [*METHODS, *STABILIZATIONS],
    "joints": ["weld", "contacts", "plane"],
    "shapes": list(Shape.model_fields),
    "robots": list(available_robots()),
}


def shown(*words: object, columns: int = 100) -> str:
    result = multiarm(*words, columns=columns)
    assert result.exit_code == 0, result.output
    return result.stdout


def figures(path, *words) -> dict:
    shown(*words, "--json", path)
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("command", LISTS)
def test_every_name_is_listed_and_shown_in_full(command, tmp_path):
    words = command.split()
    path = tmp_path / "cards.json"
    listed = shown(*words, "--json", path)
    found = json.loads(path.read_text(encoding="utf-8"))
    cards = {name: card for section in found.values() for name, card in section.items()}
    assert set(LISTS[command]) <= set(cards)
    for name, card in cards.items():
        assert name in listed and card["picture"]
        full = shown(*words, name, "--json", path)
        one = json.loads(path.read_text(encoding="utf-8"))
        assert {key: list(section.values()) for key, section in one.items() if section} == {
            key: [section[name]] for key, section in found.items() if name in section
        }
        assert all(parameter["name"] in full for parameter in card["parameters"])
        assert all(parameter["meaning"] or parameter["unit"] for parameter in card["parameters"])


@pytest.mark.parametrize("command", LISTS)
def test_unknown_names_list_similar_ones(command):
    first = LISTS[command][0]
    result = multiarm(*command.split(), first + "x")
    assert result.exit_code == 2
    assert f"did you mean '{first}'?" in result.stderr
    assert f"'multiarm {command}' shows them all" in result.stderr


def test_a_robot_in_full_has_its_joints_with_limits_and_the_links_that_can_be_tips(tmp_path):
    card = figures(tmp_path / "a.json", "robots", "panda")["robots"]["panda"]
    model = pin.buildModelFromUrdf(card["urdf"])
    names = [joint["name"] for joint in card["joints"]]
    assert names == list(model.names[1:])
    np.testing.assert_array_equal([j["lower"] for j in card["joints"]], model.lowerPositionLimit)
    np.testing.assert_array_equal([j["upper"] for j in card["joints"]], model.upperPositionLimit)
    np.testing.assert_array_equal([j["effort_limit"] for j in card["joints"]], model.effortLimit)
    for number, joint in enumerate(card["joints"][:7], start=1):
        frames = [f for f in model.frames if f.type == pin.FrameType.BODY]
        assert joint["tips"] == [f.name for f in frames if f.parentJoint == number]
    assert (card["tip"], card["tips"]) == ("panda_hand_tcp", {"panda_hand_tcp": 7})
    full = shown("robots", "panda")
    assert all(name in full for name in names) and "-2.897 to 2.897 rad" in full


@pytest.mark.parametrize(("robot", "tip"), [("panda", "panda_hand_tcp"), ("kinova", None)])
def test_a_robot_in_full_says_how_its_tip_lies(robot, tip):
    """By the Jacobian in the tip's axes, and by the pose with all joints at 0."""
    entry = available_robots()[robot]
    tip = tip or entry.tip
    model = pin.buildModelFromUrdf(str(entry.urdf))
    data, q = model.createData(), pin.neutral(model)
    last = entry.outline.movable(tip)[-1].name
    J = pin.computeFrameJacobian(model, data, q, model.getFrameId(tip), pin.ReferenceFrame.LOCAL)
    axis = J[3:, model.joints[model.getJointId(last)].idx_v]
    pin.framesForwardKinematics(model, data, q)
    z = data.oMf[model.getFrameId(tip)].rotation[:, 2]

    def word(direction: np.ndarray) -> str:
        k = int(np.argmax(np.abs(direction)))
        assert abs(direction[k]) == pytest.approx(1.0, abs=1e-9)
        return ("-" if direction[k] < 0 else "") + "xyz"[k]

    text = " ".join(shown("robots", robot).split())
    assert f"{tip}: {last} turns about its {word(axis)}; with all joints at 0 its z" in text
    assert f"points along {word(z)} of the base" in text


def test_a_file_is_shown_like_a_robot_and_says_if_it_has_no_arm(tmp_path):
    text = Path(available_robots()["planar_2r"].urdf).read_text(encoding="utf-8")
    path = tmp_path / "own.urdf"
    path.write_text(text, encoding="utf-8")
    pasted(snippet_of(shown("robots", path)), tmp_path)
    path.write_text(re.sub('type="(revolute|continuous)"', 'type="floating"', text), "utf-8")
    card = figures(tmp_path / "a.json", "robots", path)["robots"][str(path)]
    assert (card["tip"], card["tips"], card["example"]) == (None, {}, "")
    assert "none" in shown("robots", path)


def test_robots_that_pinocchio_refuses_say_why():
    assert "joint and link are both named gripper" in shown("robots", "so100")


def test_an_unknown_command_names_similar_ones():
    result = multiarm("robotz")
    assert result.exit_code == 2
    assert "unknown command 'robotz'; did you mean 'robots'?" in result.stderr
    assert "'multiarm --help' shows them all" in result.stderr


def test_parameters_of_control_are_those_of_the_schema(tmp_path):
    found = figures(tmp_path / "a.json", "controls")["controls"]
    for kind, model in CONTROLS.items():
        assert [p["name"] for p in found[kind]["parameters"]] == [
            p.name for p in parameters_of(model)
        ]
        required = {p["name"] for p in found[kind]["parameters"] if p["default"] == "required"}
        assert required == {k for k, f in model.model_fields.items() if f.is_required()}
    units = {p["name"]: p["unit"] for p in found["computed_torque"]["parameters"]}
    assert (units["squeeze"], units["stiffness"]) == ("N", "1/s^2")


def test_methods_are_those_of_the_tableaus_with_examples_that_load(tmp_path):
    found = figures(tmp_path / "a.json", "methods")
    assert set(found["stabilizations"]) == set(
        get_args(StabilizationSpec.model_fields["kind"].annotation)
    )
    scene = {
        "object": {"shape": {"box": [0.6, 0.5, 0.4]}, "mass": 5.0},
        "arms": {"left": {"robot": "textbook_6r", "tip": "tool"}},
        "joints": [{"arm": "left", "kind": "weld"}],
    }
    for name, method in METHODS.items():
        card = found["integrators"][name]
        assert (card["order"], card["adaptive"]) == (method.order, method.adaptive)
        run = parse_scene({**scene, **parse_yaml(card["example"])}).run
        assert run.integrator == name


# What snippets are pasted into.
SCENE = {
    "object": "object: {shape: {box: [0.6, 0.5, 0.4]}, mass: 5.0}",
    "arms": "arms: {left: {robot: ur5}}",
    "joints": "joints: [{arm: left, kind: weld}]",
}


def snippet_of(text: str) -> str:
    """The snippet that a command prints last: neither wrapped, nor filled up, nor coloured."""
    assert "\x1b" not in text
    _, _, printed = text.partition("In a scene\n\n")
    lines = printed.splitlines()
    assert [line for line in lines if line != line.rstrip()] == []
    return "".join(f"{line[2:]}\n" for line in lines)


def pasted(snippet: str, folder: Path) -> Scene:
    """A scene with the snippet in place of its own lines."""
    own = [line for key, line in SCENE.items() if not re.search(rf"(?m)^{key}:", snippet)]
    (folder / "scene.yaml").write_text("\n".join([*own, snippet]), encoding="utf-8")
    return load_scene(folder / "scene.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("command", LISTS)
def test_every_snippet_that_a_pipe_gets_is_part_of_a_scene(command, tmp_path):
    found = figures(tmp_path / "all.json", *command.split())
    for section in found.values():
        for name, card in section.items():
            snippet = snippet_of(shown(*command.split(), name, columns=60))
            assert snippet.rstrip("\n") == card["example"] != ""
            pasted(snippet, tmp_path)


def test_user_effects_are_listed(monkeypatch, tmp_path):
    class Breeze(ma.Effect):
        """A steady breeze along x."""

        name = "breeze"

        class Spec(ma.Effect.Spec):
            """Its parameters.

            Attributes
            ----------
            push : float
                How hard it blows [N].
            """

            push: float = 2.0

    monkeypatch.setitem(EFFECTS.registered, "breeze", Breeze)
    card = figures(tmp_path / "a.json", "effects", "--list", "breeze")["effects"]["breeze"]
    assert card["picture"] == "A steady breeze along x."
    assert card["parameters"] == [
        {"name": "push", "default": "2", "meaning": "How hard it blows.", "unit": "N"}
    ]


def test_effects_without_a_scene_name_the_list():
    result = multiarm("effects")
    assert result.exit_code == 2 and "--list" in result.stderr
