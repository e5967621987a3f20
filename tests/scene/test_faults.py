"""Faults as objects: a line of text that knows its place, its keys and its problem."""

import pickle

import pytest
import yaml
from repository import SCENES

from multiarm.errors import Fault, SceneError
from multiarm.scene import dump_scene, load_scene, parse_scene
from multiarm.scene.faults import fault_at, place


def faults_of(**changes):
    data = yaml.safe_load((SCENES / "hinged_box.yaml").read_text())
    with pytest.raises(SceneError) as caught:
        parse_scene({**data, **changes}, SCENES)
    return caught.value.faults


def test_a_fault_is_its_line_and_knows_its_parts():
    fault = fault_at(("arms", "my arm", 2), "is missing")
    assert fault == "$.arms['my arm'][2]: is missing"
    assert (fault.place, fault.problem) == ("$.arms['my arm'][2]", "is missing")
    assert fault.parts == ("arms", "my arm", 2)


def test_a_fault_without_a_place_is_its_problem():
    fault = SceneError("no scene file: here").faults[0]
    assert (fault, fault.place, fault.problem) == ("no scene file: here", "", "no scene file: here")


def test_a_fault_survives_pickling():
    fault = pickle.loads(pickle.dumps(fault_at(("run", "step"), "must be a number")))
    assert type(fault) is Fault
    assert (fault, fault.parts) == ("$.run.step: must be a number", ("run", "step"))


def test_every_fault_of_a_scene_has_the_keys_of_its_place():
    faults = faults_of(gravity=[1, 2], run={"step": "x"}, control={"kind": "nothing"}, colour=1)
    assert {fault.parts[0] for fault in faults} == {"gravity", "run", "control", "colour"}
    for fault in faults:
        assert fault.place == place(fault.parts)
        assert str(fault) == f"{fault.place}: {fault.problem}"


def test_a_written_scene_has_no_settings_that_are_defaults():
    scene = load_scene(SCENES / "hinged_box.yaml").replace(run={})
    text = dump_scene(scene)
    assert yaml.safe_load(text)["run"] == {"accuracy": 1e-6}
    assert parse_scene(text) == scene
