"""Claims about paths into a scene, and about scenes in which some values are changed."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from mechanics import ur5_pair
from pydantic import BaseModel
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import (
    RunSpec,
    changed_scenes,
    dump_scene,
    load_scene,
    parse_path,
    parse_scene,
    value_at,
)
from multiarm.scene.arms import examine_arm
from multiarm.scene.faults import place

EXAMPLES = sorted(SCENES.glob("*.yaml"))


@pytest.fixture(scope="module")
def scene():
    return ur5_pair(
        {"kind": "weld"},
        {"kind": "ball", "at": {"xyz": [0.6, 0, 0]}},
        control={"kind": "joint_pd", "stiffness": 100.0, "damping": {"left": 1.0, "right": 2.0}},
        effects={"joint_damping": 0.5, "contact_friction": 0.3, "drag": {"linear": 1.0}},
        run={"duration": 0.2, "accuracy": 1e-6},
    )


def paths_below(value, parts=()):
    """Paths of all values that a scene writes."""
    if parts:
        yield parts
    if isinstance(value, BaseModel):
        children = {name: getattr(value, name) for name in value.model_fields_set}
    elif isinstance(value, dict):
        children = value
    elif isinstance(value, tuple):
        children = dict(enumerate(value))
    else:
        return
    for key, child in children.items():
        yield from paths_below(child, (*parts, key))


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda path: path.stem)
def test_every_value_of_a_scene_is_at_the_path_that_messages_write(file):
    scene = load_scene(file)
    every = list(paths_below(scene))
    assert len(every) > 30
    for parts in every:
        path = place(parts)
        assert parse_path(path) == parts == parse_path(path[2:])
        expected = scene
        for part in parts:
            expected = (
                getattr(expected, part) if isinstance(expected, BaseModel) else expected[part]
            )
        assert value_at(scene, path) is expected


@pytest.mark.slow
@pytest.mark.parametrize("file", EXAMPLES, ids=lambda path: path.stem)
def test_a_value_put_where_it_is_already_changes_nothing(file):
    scene = load_scene(file)
    text = dump_scene(scene)
    # of entries of lists, which differ by their numbers only, the last ones
    keys = {tuple(k for k in parts if isinstance(k, str)): parts for parts in paths_below(scene)}
    for parts in keys.values():
        if parts[-1] != "kind":  # a kind alone is fine too, and is tried below
            path = place(parts)
            assert dump_scene(scene.replace({path: value_at(scene, path)})) == text, path


CHANGES = {
    "object.mass": 7.5,
    "object.shape.box": [1.0, 0.5, 0.3],
    "object.pose.xyz[2]": 0.51,
    "gravity[0]": 0.1,
    "arms.left.base.xyz": [-1.1, 0.01, 0],
    "arms['right'].posture[5]": 0.2,
    "joints[1].at.xyz[1]": 0.01,
    "control.stiffness": {"left": 50.0, "right": 60.0},
    "control.damping.left": 3.0,
    "effects.joint_damping": {"left": 1.0, "right": 0.0},
    "effects.contact_friction.mu": 0.4,
    "effects.drag.linear": 2.0,
    "run.duration": 0.3,
    "run.accuracy": 1e-4,
}


def put(data, parts, value) -> None:
    """A value into plain tables and lists, as an editor would write it there."""
    for part in parts[:-1]:
        data = data[part]
    data[parts[-1]] = value


@pytest.mark.parametrize("paths", [*([path] for path in CHANGES), list(CHANGES)], ids=str)
def test_a_changed_scene_is_the_scene_that_is_written_so(scene, paths):
    data = yaml.safe_load(dump_scene(scene))
    for path in paths:
        put(data, parse_path(path), CHANGES[path])
    before = dump_scene(scene)
    found = scene.replace({path: CHANGES[path] for path in paths})
    assert dump_scene(found) == dump_scene(parse_scene(data)) != before
    assert found.warnings == parse_scene(data).warnings
    assert dump_scene(scene) == before  # and stays what it is


def test_numbers_of_numpy_are_numbers(scene):
    found = scene.replace({"object.mass": np.float64(3.0), "gravity": np.array([0, 0, -1.6])})
    assert found.object.mass == 3.0 and found.gravity == (0, 0, -1.6)


def test_what_is_optional_and_missing_is_made(scene):
    found = scene.replace({"joints[0].at.xyz": [0.5, 0, 0], "effects.rotor_inertia": 0.1})
    assert found.joints[0].at.xyz == (0.5, 0, 0) and found.effects.rotor_inertia == 0.1
    by_name = ur5_pair({"kind": "weld"}, {"kind": "weld"}).replace({"effects.drag.linear": 1.0})
    assert by_name.effects.drag.linear == (1.0, 1.0, 1.0)
    assert value_at(scene, "joints[0].at") is None


def test_a_joint_becomes_one_of_another_kind_and_keeps_its_place(scene):
    found = scene.replace({"joints[1].kind": "weld"})
    assert found.joints[1].kind == "weld" and found.joints[1].at.xyz == (0.6, 0, 0)


def test_naming_one_setting_of_the_steps_replaces_the_choice_of_all(scene):
    run = scene.replace({"run.integrator": "rk4", "run.step": 1e-3}).run
    assert (run.integrator, run.step, run.accuracy, run.duration) == ("rk4", 1e-3, None, 0.2)
    fixed = scene.replace({"run.integrator": "rk4", "run.step": 1e-3})
    run = fixed.replace({"run.accuracy": 1e-3}).run
    assert (run.integrator, run.step, run.accuracy.position) == (None, None, 1e-3)
    assert scene.replace({"run": {"duration": 2.0}}).run == RunSpec(duration=2.0)


def test_parameters_of_own_effects_are_changed_and_checked(monkeypatch):
    monkeypatch.setattr("multiarm.scene.EFFECTS.registered", {})

    class Pull(ma.Effect):
        name = "pull"

        class Spec(ma.Effect.Spec):
            force: float

        def forces(self, t, state):
            return ma.Loads(object_wrench=[self.spec.force, 0, 0, 0, 0, 0])

    ma.register_effect(Pull)
    pulled = ur5_pair({"kind": "weld"}, {"kind": "weld"}, effects={"pull": {"force": 1.0}})
    assert value_at(pulled.replace({"effects.pull.force": 2.0}), "effects.pull.force") == 2.0
    with refused(SceneError, "$.effects.pull.forse"):
        pulled.replace({"effects.pull.forse": 2.0})


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"object.mas": 1}, "$.object.mas"),
        ({"objekt.mass": 1}, "$.objekt"),
        ({"arms.rigth.base.xyz": [0, 0, 0]}, "$.arms.rigth"),
        ({"arms.left.base.xy": [0, 0]}, "$.arms.left.base.xy"),
        ({"joints[2].at": None}, "$.joints[2]"),
        ({"joints.at": None}, "$.joints.at"),
        ({"object[0]": 1}, "$.object[0]"),
        ({"object.mass.value": 1}, "'object.mass'"),
        ({"joints[0].at[0]": 1}, "$.joints[0].at"),
        ({"object.mass": -1}, "$.object.mass"),
        ({"object.mass": "heavy"}, "$.object.mass"),
        ({"control.kp": 1}, "$.control.kp"),
        ({"effects.drug": 1}, "$.effects.drug"),
        ({"arms.left.robot": "ur55"}, "$.arms.left.robot"),
        ({"run.integrator": "rk4"}, "$.run"),
        ({"object..mass": 1}, "'object..mass'"),
        ({"": 1}, "''"),
        ({"arms['']": 1}, "arms['']"),
        ({"joints[x]": 1}, "'joints[x]'"),
        ({"object mass": 1}, "'object mass'"),
        ({7: 1}, "7"),
        ({"object": {}, "object.mass": 1}, "$.object.mass"),
        ({"object.mass": 1, "object": {}}, "$.object"),
        ({"object.mass": 1, "$.object.mass": 2}, "$.object.mass"),
    ],
    ids=str,
)  # fmt: skip
def test_a_wrong_path_or_value_is_told_with_its_place_and_the_alternatives(scene, change, place):
    with refused(SceneError, place):
        scene.replace(change)


def test_all_faults_of_all_runs_are_told_at_once(scene):
    changes = [
        {"object.mas": 1, "object.mass": 0},
        {"object.mass": 2.0},
        {"joints[9].arm": "left"},
        5,
    ]
    with pytest.raises(SceneError) as caught:
        changed_scenes(scene, changes)
    assert caught.value.source == "parameters"
    places = [fault.partition(": ")[2].partition(":")[0] for fault in caught.value.faults]
    runs = [fault.partition(":")[0] for fault in caught.value.faults]
    assert runs == ["run 1", "run 1", "run 3", "run 4"]
    assert places[:3] == ["$.object.mass", "$.object.mas", "$.joints[9]"]


def test_paths_and_parts_are_replaced_in_one_move(scene):
    moved = scene.replace(
        {"object.mass": 3.0, "joints[0]": {"arm": "left", "kind": "ball"}}, name="x"
    )
    assert (moved.object.mass, moved.joints[0].kind, moved.name) == (3.0, "ball", "x")
    with pytest.raises(SceneError) as caught:
        scene.replace({"object.mass": -3.0, "joints[0].at.xyz[1]": 0.0}, control={"kind": "pd"})
    places = [fault.partition(":")[0] for fault in caught.value.faults]
    assert sorted(places) == ["$.control.kind", "$.joints[0].at.xyz", "$.object.mass"]


@pytest.mark.parametrize(
    ("part", "update", "place"),
    [
        ("object", {"mass": -3}, "ObjectSpec.mass"),
        ("object", {"mas": 3}, "ObjectSpec.mas"),
        ("run", {"step": 1e-3}, "RunSpec"),
        (None, {"object": {"shape": {"box": [1, 1, 1]}, "mass": -3}}, "$.object.mass"),
        (None, {"arms": {}}, "$.arms"),
    ],
)
def test_a_copy_with_changes_is_checked_like_what_is_written(scene, part, update, place):
    copied = scene if part is None else getattr(scene, part)
    with pytest.raises(SceneError) as caught:
        copied.model_copy(update=update)
    assert any(fault.startswith(f"{place}: ") for fault in caught.value.faults)
    assert copied.model_copy() == copied


def test_a_scene_is_not_changed_in_place_and_says_how_it_is(scene):
    with refused(SceneError, "ObjectSpec.mass"):
        scene.object.mass = 3.0
    with refused(SceneError, "Scene.gravity"):
        scene.gravity = None


def test_robots_of_arms_that_stay_are_not_looked_at_again(scene, monkeypatch):
    looked = []

    def examine(spec):
        looked.append(spec.base.xyz)
        return examine_arm(spec)

    monkeypatch.setattr("multiarm.scene.consistency.examine_arm", examine)
    scene.replace({"object.mass": 3.0})
    assert looked == []
    scene.replace({"arms.left.base.xyz[1]": 0.01})
    assert looked == [(-1.1, 0.01, 0.0)]
