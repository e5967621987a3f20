"""Commands to joints that hold for some of the time, by a Stepper or a control in Python."""

from __future__ import annotations

import numpy as np
import pytest

import multiarm as ma
from multiarm.errors import ControlError, ModelError, SolverError

GRAVITY = 9.81


def scene(**joint) -> ma.Scene:
    """A box that the world holds, and one that falls past it."""
    box = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 2.0}
    return ma.Scene(
        objects={
            "still": {**box, "pose": {"xyz": [0, 0, 1.0]}},
            "falling": {**box, "mass": 3.0, "pose": {"xyz": [0.3, 0, 1.2]}},
        },
        joints=[
            {"between": ["still", "world"], "kind": "weld", "at": {"xyz": [0, 0, 1.0]}},
            {"between": ["falling", "still"], "kind": "weld", "name": "grab", **joint},
        ],
        gravity=[0, 0, -GRAVITY],
        run={"duration": 0.5, "accuracy": 1e-8},
    )


def two_arms(**joint) -> ma.Scene:
    """Two arms of one slide each, of which the second one has a joint of this sort."""
    arms = {
        name: {"robot": "slide", "base": {"xyz": [0, y, 0]}, "posture": [0.0]}
        for name, y in (("one", 0.0), ("two", 0.5))
    }
    return ma.Scene(
        object={"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 2.0, "pose": {"xyz": [0, 0.2, 0]}},
        arms=arms,
        joints=[{"arm": "one", "kind": "weld"}, {"arm": "two", "kind": "weld", **joint}],
        run={"duration": 0.3, "accuracy": 1e-8},
    )


def test_a_stepper_that_attaches_and_detaches_moves_as_the_scene_with_these_times():
    stepper = ma.Stepper(ma.compile_system(scene(**{"from": "never"})), accuracy=1e-10)
    assert stepper.attached == ("still-world",)
    for change in (stepper.attach, stepper.detach):
        stepper.advance(0.1)
        change("grab")
    assert stepper.attached == ("still-world",)
    end = stepper.advance(0.1)
    run = ma.simulate(ma.compile_system(scene(**{"from": 0.1, "until": 0.2})), 0.3, accuracy=1e-10)
    for name, motion in end.objects.items():
        at_end = run.objects[name]
        np.testing.assert_allclose(motion.position, at_end.position[-1], atol=1e-13)
        np.testing.assert_allclose(motion.twist, at_end.twist[-1], atol=1e-12)
    # free fall, stopped, and free fall again
    assert end.objects["falling"].position[2] == pytest.approx(1.2 - GRAVITY * 0.1**2, abs=1e-12)
    attached, detached = stepper.events
    assert (attached["kind"], detached["kind"]) == ("attached", "detached")
    assert attached["energy_loss"] == pytest.approx(0.5 * 3.0 * (0.1 * GRAVITY) ** 2, rel=1e-12)
    assert attached["impulse"][2] == pytest.approx(-3.0 * 0.1 * GRAVITY, rel=1e-12)


def test_a_joint_that_holds_until_it_is_told_holds_from_the_start():
    stepper = ma.Stepper(ma.compile_system(scene(until="never")), accuracy=1e-8)
    assert stepper.attached == ("still-world", "grab")
    stepper.advance(0.1)
    stepper.detach("grab")
    state = stepper.advance(0.1)
    fallen = 0.5 * GRAVITY * 0.1**2
    assert state.objects["falling"].position[2] == pytest.approx(1.2 - fallen, abs=1e-10)
    stepper.reset()
    assert stepper.attached == ("still-world", "grab") and not stepper.events


@pytest.mark.parametrize(
    ("joint", "says"),
    [
        ("grab", "joint 'grab' is open"),
        ("still-world", "joint 'still-world' holds all the time; write `until: never`"),
        ("grip", "unknown joint 'grip'.*'grab'"),
    ],
)
def test_a_stepper_says_what_it_cannot_detach(joint, says):
    stepper = ma.Stepper(ma.compile_system(scene(**{"from": "never"})))
    with pytest.raises(ModelError, match=says):
        stepper.detach(joint)
    stepper.advance(0.01)  # nothing has happened


def test_a_grip_that_is_too_fast_is_refused_and_changes_nothing():
    stepper = ma.Stepper(ma.compile_system(scene(**{"from": "never", "speed_limit": 0.5})))
    stepper.advance(0.1)
    with pytest.raises(SolverError, match=r"0\.981 m/s against each other"):
        stepper.attach("grab")
    assert stepper.attached == ("still-world",) and not stepper.events
    fallen = stepper.advance(0.1).objects["falling"].position[2]
    assert fallen == pytest.approx(1.2 - 0.5 * GRAVITY * 0.2**2, abs=1e-10)
    stepper.reset()
    stepper.attach("grab")
    assert stepper.attached == ("still-world", "grab")


def test_a_joint_attached_at_the_start_holds_under_the_torques_of_the_first_advance():
    stepper = ma.Stepper(ma.compile_system(two_arms(**{"from": "never"})), accuracy=1e-8)
    stepper.attach("two")
    state = stepper.advance(0.1, {"one": [3.0]})
    assert stepper.attached == ("one", "two")
    one, two = (state.joint_velocities[name][0] for name in ("one", "two"))
    assert one == pytest.approx(two, abs=1e-12) and two > 0.01


def pushes(begin: float, end: float):
    """A control that pushes the first arm, and lets the second hold between two times."""

    def control(t, state):
        holds = begin - 1e-9 < t < end - 1e-9
        return {"one": [3.0], "attach" if holds else "detach": ["two"]}

    return control


def test_a_sampled_control_commands_joints_as_times_do():
    by_command = ma.compile_system(
        two_arms(**{"from": "never"}), pushes(0.1, 0.2), sample_time=0.01
    )
    run = ma.simulate(by_command)
    assert run.certificate["met"]
    times = [(e["kind"], e["time"]) for e in run.events if "energy_loss" in e]
    assert [kind for kind, _ in times] == ["attached", "detached"]
    np.testing.assert_allclose([time for _, time in times], [0.1, 0.2], atol=1e-12)
    by_time = ma.compile_system(
        two_arms(**{"from": 0.1, "until": 0.2}), lambda t, state: {"one": [3.0]}, sample_time=0.01
    )
    expected = ma.simulate(by_time)
    for name in ("one", "two"):
        np.testing.assert_allclose(
            run.joint_positions[name], expected.joint_positions[name], atol=1e-12
        )
        np.testing.assert_allclose(
            run.joint_velocities[name], expected.joint_velocities[name], atol=1e-11
        )
    assert abs(expected.joint_velocities["two"][-1]) > 0.01


@pytest.mark.parametrize(
    ("joint", "name", "sample_time", "says"),
    [
        ({"from": "never"}, "two", None, "at its samples only; give it a `sample_time`"),
        ({"from": "never"}, "three", 0.01, "attaches 'three'; joints .* are 'two'"),
        ({}, "two", 0.01, r"are \(none; write `from` or `until`\)"),
    ],
)
def test_commands_that_cannot_be_followed_are_told(joint, name, sample_time, says):
    system = ma.compile_system(
        two_arms(**joint), lambda t, state: {"attach": name}, sample_time=sample_time
    )
    with pytest.raises(ControlError, match=says):
        ma.simulate(system, 0.1)


def test_a_command_at_the_start_is_heard_in_every_run_of_a_system():
    system = ma.compile_system(two_arms(**{"from": "never"}), pushes(-1.0, 1.0), sample_time=0.01)
    for _ in range(2):
        run = ma.simulate(system, 0.1)
        assert [(e["kind"], e["time"]) for e in run.events if "energy_loss" in e] == [
            ("attached", 0.0)
        ]
    ma.evaluate(system)  # samples the control, too
    quiet = system.with_control(lambda t, state: {}, sample_time=0.01)
    assert not [e for e in ma.simulate(quiet, 0.1).events if "energy_loss" in e]


def test_a_control_with_a_memory_of_its_commands_is_not_certified():
    calls = []

    def control(t, state):
        calls.append(t)
        return {"one": [3.0], **({"attach": "two"} if len(calls) == 4 else {})}

    system = ma.compile_system(two_arms(**{"from": "never"}), control, sample_time=0.01)
    certificate = ma.simulate(system, 0.1).certificate
    assert not certificate["met"], certificate["text"]


@pytest.mark.parametrize("names", [None, 3])
def test_a_command_that_names_no_joint_is_told(names):
    system = ma.compile_system(
        two_arms(**{"from": "never"}), lambda t, state: {"attach": names}, sample_time=0.01
    )
    with pytest.raises(ControlError, match="'attach' with the name of a joint or a list of names"):
        ma.simulate(system, 0.1)
