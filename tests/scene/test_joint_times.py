"""Claims about when joints hold: what scenes may say, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from box_between_arms import NEAR, from_, two_arms
from commands import multiarm as command
from refusals import refused

import multiarm as ma
from multiarm.assembly.compilation import compile_for_inspection
from multiarm.errors import ControlError, SceneError
from multiarm.geometry import Contact, plane, sphere
from multiarm.geometry.records import Patch
from multiarm.scene import dump_scene, load_scene, named_code, parse_scene
from multiarm.scene.joints.times import Touching
from multiarm.scene.timed_joints import times_in_words
from multiarm.simulation.inspection import inspect_system


def right_joint(**joint):
    return parse_scene(two_arms(**joint)).joints[1]


@pytest.mark.parametrize(
    ("times", "intervals", "words"),
    [
        ({"from": 2}, [(2.0, math.inf)], "from 2 s"),
        ({"until": 4}, [(-math.inf, 4.0)], "until 4 s"),
        ({"from": 2, "until": 4}, [(2.0, 4.0)], "from 2 s until 4 s"),
        ({"from": "never"}, [(math.inf, math.inf)], "by command"),
        ({"from": 1, "until": "never"}, [(1.0, math.inf)], "from 1 s"),
        (
            {"from": [[0, 2], [4, "never"]]},
            [(0.0, 2.0), (4.0, math.inf)],
            "from 0 s until 2 s, from 4 s",
        ),
    ],
)
def test_times_are_read_and_said(times, intervals, words):
    joint = right_joint(**times)
    assert [tuple(interval) for interval in joint.intervals] == intervals
    assert times_in_words(joint) == words


def test_a_joint_without_times_holds_all_the_time():
    joint = right_joint()
    assert joint.intervals == ()
    assert joint.holds_at(0.0)
    assert times_in_words(joint) == ""


def test_a_joint_holds_from_its_beginning_to_before_its_end():
    joint = right_joint(**{"from": [[1, 2], [4, 5]]})
    held = [t for t in (0.0, 1.0, 1.9, 2.0, 3.0, 4.0, 5.0) if joint.holds_at(t)]
    assert held == [1.0, 1.9, 4.0]


def test_times_are_written_and_read_again(tmp_path):
    scene = parse_scene(two_arms({"floor": {}}, **{"from": {"touching": "floor"}, "until": 0.5}))
    again = parse_scene(dump_scene(scene))
    assert again == scene
    assert again.joints[1].intervals[0].begin == Touching(touching="floor")


def test_times_are_changed_as_other_values():
    scene = parse_scene(two_arms(**from_(1.0)))
    changed = scene.replace({"joints[1].from": 2.0})
    assert changed.joints[1].intervals[0].begin == 2.0


@pytest.mark.parametrize(
    ("times", "place"),
    [
        ({"from": [1]}, "$.joints[1].from"),
        ({"from": [[1, 2, 3]]}, "$.joints[1].from"),
        ({"from": [[1, 2], [2, 3]]}, "$.joints[1].from"),
        ({"from": [["never", 2]]}, "$.joints[1].from"),
        ({"from": [[0, 1]], "until": 3}, "$.joints[1]"),
        ({"from": "soon"}, "$.joints[1].from"),
        ({"from": True}, "$.joints[1].from"),
        ({"from": {"when": 3}}, "$.joints[1].from"),
        ({"from": {"touching": ""}}, "$.joints[1].from"),
        ({"from": 2, "until": 1}, "$.joints[1]"),
        ({"from": "never", "until": 1}, "$.joints[1]"),
        ({"speed_limit": 0.1}, "$.joints[1]"),
    ],
)
def test_times_that_cannot_be_are_refused_with_their_place(times, place):
    with refused(SceneError, place):
        parse_scene(two_arms(**times))


@pytest.mark.parametrize(
    ("effects", "name"),
    [({}, "lef"), ({}, "floor"), ({"floor": {}}, "floo"), ({"floor": {}}, "right")],
)
def test_touching_names_a_joint_or_the_floor(effects, name):
    with refused(SceneError, "$.joints[1].from.touching"):
        parse_scene(two_arms(effects, **from_({"touching": name})))


def test_a_joint_may_let_go_when_its_own_contact_closes():
    times = {"from": 0, "until": {"touching": "right"}}
    assert parse_scene(two_arms(**times)).joints[1].intervals[0].end == Touching(touching="right")


@pytest.mark.parametrize(
    ("effects", "name"), [({}, "left"), ({"floor": {}}, "left"), ({"floor": {}}, "floor/corner 9")]
)
def test_touching_names_a_contact_that_can_open(effects, name):
    scene = parse_scene(two_arms(effects, **from_({"touching": name})))
    with refused(SceneError, "$.joints[1].from.touching"):
        ma.compile_system(scene)


@pytest.mark.parametrize("name", ["floor", "floor/corner 1"])
def test_touching_may_name_the_floor_or_one_contact(name):
    ma.compile_system(parse_scene(two_arms({"floor": {}}, **from_({"touching": name}))))


def test_functions_that_tell_times_are_code_of_the_scene(tmp_path):
    (tmp_path / "hands.py").write_text(NEAR)
    times = {"from": [[{"when": "hands.py:near"}, 0.08], [0.09, {"when": "hands.py:near"}]]}
    (tmp_path / "scene.yaml").write_text(dump_scene(parse_scene(two_arms(**times), tmp_path)))
    scene = load_scene(tmp_path / "scene.yaml")
    named = named_code(scene)
    assert [code.place for code in named] == [
        "$.joints[1].from[0][0].when",
        "$.joints[1].from[1][1].when",
    ]
    with refused(SceneError, "$.joints[1].from[0][0].when"):
        ma.compile_system(scene, code=False)
    assert times_in_words(scene.joints[1]) == (
        "from near() is 0 until 0.08 s, from 0.09 s until near() is 0"
    )
    run = ma.simulate(ma.compile_system(scene, code=True), 0.07, certificate=False)
    (event,) = run.events
    assert event["kind"] == "attached"
    assert event["time"] == pytest.approx(0.05, abs=1e-10)


@pytest.mark.parametrize(
    ("times", "left"),
    [
        ({"from": {"when": "hands.py:near"}}, "by command"),
        ({"until": {"when": "hands.py:near"}}, "from the start on"),
        ({"from": [[{"when": "hands.py:near"}, 0.4], [0.5, 1]]}, "from 0.5 s until 1 s"),
        ({"from": [[0.5, {"when": "hands.py:near"}]]}, "from 0.5 s"),
        ({"from": [[{"when": "hands.py:near"}, 0.4]]}, "by command"),
    ],
)
def test_a_check_leaves_out_what_functions_tell(tmp_path, times, left):
    (tmp_path / "hands.py").write_text("raise RuntimeError('not to be loaded')")
    system, code = compile_for_inspection(parse_scene(two_arms(**times), tmp_path))
    assert times_in_words(system.scene.joints[1]) == left
    inspection = inspect_system(system, code)
    assert inspection.start is not None  # contacts are known
    (line,) = inspection.not_looked_at
    assert line.startswith("$.joints[1].")
    assert line.endswith("it is left out")


def test_a_function_that_tells_times_is_not_loaded_by_the_command_check(tmp_path):
    (tmp_path / "hands.py").write_text("raise RuntimeError('not to be loaded')")
    scene = parse_scene(two_arms(**from_({"when": "hands.py:near"})), tmp_path)
    (tmp_path / "scene.yaml").write_text(dump_scene(scene))
    result = command("check", tmp_path / "scene.yaml", columns=200)
    assert result.exit_code == 0
    assert "$.joints[1].from.when" in result.stderr


@pytest.mark.parametrize("of_scene", [True, False])
def test_variational_steps_are_refused_as_with_other_events(of_scene):
    data = two_arms(**from_(0.1))
    run = {"duration": 1, "integrator": "variational", "step": 0.01}
    if of_scene:
        with refused(SceneError, "$.run.integrator"):
            parse_scene({**data, "run": run})
        return
    system = ma.compile_system(parse_scene(data))
    with refused(SceneError, "integrator"):
        ma.simulate(system, 0.1, integrator="variational", step=0.01)


def test_springs_in_place_of_contacts_are_refused():
    scene = parse_scene(two_arms({"contact_compliance": 1e4}, **from_(1.0)))
    with refused(SceneError, "$.effects.contact_compliance"):
        ma.compile_system(scene)


@pytest.mark.parametrize(
    ("times", "place"),
    [
        ({"until": 0}, "until"),
        ({"from": -2, "until": -1}, "until"),
        ({"from": [[-2, -1], [-0.5, 0]]}, "from[1][1]"),
        ({"from": {"touching": "floor"}, "until": 0}, "until"),
    ],
)
def test_a_joint_that_ends_before_the_run_is_warned_of(times, place):
    scene = parse_scene(two_arms({"floor": {}}, **times))
    assert any(line.startswith(f"$.joints[1].{place}: ") for line in scene.warnings)


def test_a_joint_that_holds_for_a_part_of_the_run_is_not_warned_of():
    for times in ({"until": 1e-3}, {"from": [[-2, 0], [3, "never"]]}, {"from": -1, "until": 1}):
        assert parse_scene(two_arms(**times)).warnings == []


def test_a_joint_that_begins_after_the_run_is_warned_of():
    late = parse_scene({**two_arms(**from_([[2, 3], [4, 5]])), "run": {"duration": 2}})
    assert any(line.startswith("$.joints[1].from: 2 s") for line in late.warnings)
    for data in (
        two_arms(**from_(2.0)),  # no duration is written
        {**two_arms(**from_(2.0)), "run": {"duration": 3}},
        {**two_arms(**from_("never")), "run": {"duration": 1}},
        {**two_arms({"floor": {}}, **from_({"touching": "floor"})), "run": {"duration": 1}},
    ):
        assert parse_scene(data).warnings == []


@pytest.mark.parametrize(
    "control",
    [
        {"kind": "computed_torque", "stiffness": 1, "damping": 1},
        {"kind": "object_impedance", "stiffness": {"translation": 1, "rotation": 1},
         "damping": {"translation": 1, "rotation": 1}},
        {"kind": "joint_pd", "stiffness": 1, "damping": 1, "path": [{"time": 1, "xyz": [0, 0, 1]}]},
        {"kind": "gravity_compensation", "friction_margin": 0.2},
    ],
)  # fmt: skip
def test_control_that_plans_with_all_hands_is_refused(control):
    effects = {"floor": {"mu": 0.3}}
    scene = parse_scene(two_arms(effects, control=control, **from_(1.0)))
    with refused(ControlError, "control"):
        ma.compile_system(scene)


@pytest.mark.parametrize(
    "control",
    [
        "none",
        "gravity_compensation",
        {"kind": "joint_pd", "stiffness": 10, "damping": 10},
        {"kind": "harmonic", "amplitude": {"left": 1}, "frequency": 1},
        {"kind": "constant", "torques": {}},
    ],
)
def test_control_of_the_joints_alone_goes_on(control):
    ma.compile_system(parse_scene(two_arms(control=control, **from_(1.0))))


class Tray(ma.Joint):
    """A fingertip on a small plate of the object."""

    kind: Literal["tray"] = "tray"

    def records(self):
        """One contact, on a bounded surface."""
        ground = plane([0, 0, 0], [0, 0, 1])
        half = np.array([0.1, 0.1, np.inf])
        bounded = replace(ground, patch=Patch(-half, half, np.eye(4)))
        return [Contact("tip", sphere([0, 0, 0.01], 0.01), bounded, pushes_only=True)]


@pytest.mark.parametrize("at", [None, {"xyz": [0, 0, 0]}])
def test_bounded_surfaces_are_not_placed_anew(at):
    data = two_arms(**from_(1.0))
    scene = parse_scene(data)
    joint = Tray(arm="right", at=at, **from_(1.0))
    scene = ma.Scene(**{**dict(scene), "joints": [scene.joints[0], joint]})
    if at is not None:
        ma.compile_system(scene)
        return
    with refused(SceneError, "$.joints[1]"):
        ma.compile_system(scene)
