"""Claims about what interactive sessions see of public objects: a line or two, and public names."""

from __future__ import annotations

import pytest
from test_architecture import PUBLIC_ATTRIBUTES

import multiarm as ma


@pytest.fixture(scope="module")
def objects(welded_ur5_system):
    system = welded_ur5_system
    with system.borrow() as data:
        found = (
            system, system.model, data, system.initial_state(), ma.evaluate(system),
            ma.Stepper(system), ma.simulate(system, 0.01, certificate=False),
        )  # fmt: skip
    return {type(one).__name__: one for one in found}


@pytest.mark.parametrize(
    "name", ["System", "Model", "Data", "State", "Evaluation", "Stepper", "Trajectory"]
)
def test_an_object_shows_itself_in_a_line_or_two(objects, name):
    text = repr(objects[name])
    assert text.startswith(f"{name}(") and text.count("\n") <= 1
    assert all(len(line) <= 100 for line in text.splitlines())


@pytest.mark.parametrize("name", ["System", "State", "Evaluation", "Stepper", "Trajectory"])
def test_dir_has_the_promised_names_and_no_private_ones(objects, name):
    shown = dir(objects[name])
    assert set(PUBLIC_ATTRIBUTES[name].split()) <= set(shown)
    assert not [one for one in shown if one.startswith("_")]


def test_dir_of_a_scene_is_without_the_machinery_of_its_library(welded_ur5_system):
    shown = set(dir(welded_ur5_system.scene))
    assert set(PUBLIC_ATTRIBUTES["Scene"].split()) | {"replace"} <= shown
    assert not {one for one in shown if one.startswith(("model_", "_"))}


def test_dir_of_the_package_is_what_it_exports():
    assert set(dir(ma)) == {*ma.__all__, "__version__"}
    assert set(dir(ma.grasp)) == set(ma.grasp.__all__)
