"""Claims about classes that scenes name by their file or module, as they name functions."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import yaml
from mechanics import ur5_pair
from refusals import refused
from user_classes import empty_registries

import multiarm as ma
from multiarm.assembly.compilation import compile_for_inspection
from multiarm.errors import SceneError
from multiarm.scene import EFFECTS, dump_scene, load_scene, named_code, parse_scene, with_code

CLASSES = """
from __future__ import annotations
from typing import Literal
import multiarm as ma
from multiarm.geometry import Contact, plane, point, sphere

class Egg(ma.Surface):
    name = "egg"
    radius: float = 0.1

    def record(self):
        return sphere([0, 0, 0], self.radius)

class Hitch(ma.Joint):
    kind: Literal["hitch"] = "hitch"
    width: float = 0.1

    def records(self):
        at = [(0, 0, 0), (self.width, 0, 0), (0, self.width, 0)]
        return [Contact(f"row {k}", point(p), plane(p, [0, 0, 1])) for k, p in enumerate(at)]

class Pull(ma.Control):
    kind: Literal["pull"] = "pull"
    stiffness: float

    def torques(self, t, state):
        return {arm: -self.stiffness * v for arm, v in state.joint_velocities.items()}

class Magnet(ma.Effect):
    name = "magnet"

    class Spec(ma.Effect.Spec):
        strength: float = 1.0

    def forces(self, t, state):
        return ma.Loads(object_wrench=[self.spec.strength, 0, 0, 0, 0, 0])

def force(t, state):
    return [1.0, 0, 0, 0, 0, 0]
"""
TOUCH = {"sphere": {"center": [0, 0, 0.2], "radius": 0.1}}
# part of a scene that names a class of `parts.py` -> the place where it does, and its name
NAMED = {
    "joint": ({"joints[0]": {"arm": "left", "kind": "parts.py:Hitch", "width": 0.2}},
              "$.joints[0].kind", "Hitch"),
    "surface": ({"joints[0]": {"arm": "left", "kind": "contacts", "contacts": [
        {"arm": TOUCH, "object": {"parts.py:Egg": {"radius": 0.12}}}]}},
        "$.joints[0].contacts[0].object['", "Egg"),
    "control": ({"control": {"kind": "parts.py:Pull", "stiffness": 2.0}}, "$.control.kind", "Pull"),
    "effect": ({"effects": {"parts.py:Magnet": {"strength": 3.0}}},
               "$.effects['", "Magnet"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    empty_registries(monkeypatch)
    (tmp_path / "parts.py").write_text(CLASSES)
    return tmp_path


def scene_file(folder, changes: dict):
    """A scene file in the folder with some changes, as somebody would write it."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}, run={"duration": 0.02})
    data = yaml.safe_load(dump_scene(scene))
    for path, value in changes.items():
        if path == "joints[0]":
            data["joints"][0] = value
        else:
            data[path] = value
    (folder / "scene.yaml").write_text(yaml.safe_dump(data))
    return folder / "scene.yaml"


@pytest.mark.parametrize("sort", NAMED)
def test_a_class_of_a_file_is_loaded_when_the_scene_is_compiled(sort, folder):
    changes, place, name = NAMED[sort]
    scene = load_scene(scene_file(folder, changes))
    (code,) = named_code(scene)
    assert code.place.startswith(place)
    assert f"{name!r} of {folder}/parts.py" in code.what
    with pytest.raises(SceneError) as caught:
        ma.compile_system(load_scene(folder / "scene.yaml", code=False))
    assert caught.value.faults[0].startswith(f"{code.place}: ")
    loaded = ma.compile_system(scene, assemble=False).scene
    assert named_code(loaded) == []
    assert with_code(parse_scene(dump_scene(loaded))) == loaded
    assert dump_scene(loaded) == dump_scene(scene)


@pytest.mark.parametrize("sort", NAMED)
def test_a_look_at_a_scene_runs_no_file(sort, folder):
    path = scene_file(folder, NAMED[sort][0])
    (folder / "parts.py").write_text("raise RuntimeError('loaded')")
    for scene in (load_scene(path), load_scene(path, code=False)):
        system, (left,) = compile_for_inspection(scene, arms="compiled")
        assert NAMED[sort][2] in left.what and system.scene.arms.keys() == {"left", "right"}
        assert named_code(scene.model_copy(update={"name": "other"})) == named_code(scene)
    with refused(ma.MultiarmError, "parts.py:"):
        ma.compile_system(load_scene(path))


def test_classes_of_files_act_as_registered_ones_do(folder, monkeypatch):
    path = scene_file(folder, {**NAMED["effect"][0], **NAMED["control"][0]})
    run = ma.simulate(ma.compile_system(load_scene(path)), certificate=False)
    monkeypatch.syspath_prepend(folder)
    (folder / "registered_parts.py").write_text(CLASSES)
    parts = importlib.import_module("registered_parts")
    ma.register_effect(parts.Magnet)
    ma.register_control(parts.Pull)
    named = load_scene(
        scene_file(
            folder,
            {"effects": {"magnet": {"strength": 3.0}}, "control": {"kind": "pull", "stiffness": 2}},
        )
    )
    registered = ma.simulate(ma.compile_system(named), certificate=False)
    assert np.abs(run.channel("effects/magnet/work")).max() > 0.0
    np.testing.assert_array_equal(run.object_position, registered.object_position)


def test_a_stored_run_names_the_class_and_loads_nothing(folder):
    path = scene_file(folder, NAMED["effect"][0])
    ma.simulate(ma.compile_system(load_scene(path))).save(folder / "run.h5")
    (folder / "parts.py").write_text("raise RuntimeError('loaded')")
    run = ma.load_trajectory(folder / "run.h5")
    assert run.scene.effects.named == {f"{folder}/parts.py:Magnet": {"strength": 3.0}}
    ma.replay(run, folder / "run.html", meshes=False)
    with refused(SceneError, "parts.py:Magnet"):
        ma.compile_system(run.scene, code=True)


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"effects": {"parts.py:Magnet": {"strenght": 1}}}, "strenght"),
        ({"control": {"kind": "parts.py:Pull"}}, "$.control.stiffness"),
        ({"control": {"kind": "parts.py:Magnet"}}, "$.control.kind"),
        ({"control": {"kind": "parts.py:force"}}, "$.control.kind"),
        ({"control": {"kind": "parts.py:Push"}}, "$.control.kind"),
        ({"control": {"kind": "none.py:Pull"}}, "$.control.kind"),
        ({"control": {"kind": "../parts.py:Pull"}}, "$.control.kind"),
        ({"effects": {"/etc/parts.py:Magnet": {}}}, "$.effects['/etc/parts.py:"),
    ],
)
def test_what_is_wrong_with_a_class_of_a_file_is_told_at_its_place(folder, changes, place):
    with refused(ma.MultiarmError, place):
        ma.compile_system(load_scene(scene_file(folder, changes)))


def test_a_file_that_changed_is_read_again(folder):
    path = scene_file(folder, NAMED["effect"][0])
    ma.compile_system(load_scene(path))
    (folder / "parts.py").write_text(CLASSES.replace("strength: float", "force: float"))
    with refused(ma.MultiarmError, "'strength'"):
        ma.compile_system(load_scene(path))
    assert EFFECTS.names() == []  # files offer nothing to scenes that do not name them
