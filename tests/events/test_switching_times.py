"""Claims about when joints take hold and let go, and about letting go.

Oracle: the root of the function on the closed form of the motion; the same scene without the joint.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import arm, ball
from mechanics import UR5_POSTURE
from object_scenes import ASIDE
from scipy.integrate import solve_ivp
from timed_scenes import (
    ABOUT_PIVOT,
    AFTER,
    BOB,
    EXACT,
    FALL,
    LENGTH,
    carts,
    held_never,
    last_state,
    pendulum,
    simulate,
    switches,
)

import multiarm as ma
from multiarm.scene import parse_scene
from multiarm.simulation.driver import state_of
from multiarm.simulation.event_handling import EventHandler

TIME, ROUNDING = 1e-10, 2e-15


def kinds_and_times(trajectory):
    events = switches(trajectory)
    return [event["kind"] for event in events], [event["time"] for event in events]


def pushed(joint, force=4.0, speed=-0.3, **more):
    """A cart of 2 kg that carries the object of 3 kg, pushed along x, and a joint with the world.

    Where the cart is: speed * t + force / 10 * t^2.
    """
    rails = {"cart": {"mass": 2.0, "velocity": speed, "x": 0.0}}
    table = carts(speed, rails, control={"kind": "constant", "torques": {"cart": [force]}}, **more)
    stop = {"between": ["object", "world"], "name": "stop", "kind": "weld", **joint}
    return table | {"joints": [*table["joints"], stop]}


# --- functions ------------------------------------------------------------------------------------


def test_a_joint_takes_hold_at_the_root_of_its_function():
    """Of the place of the object, which first goes back: only the fall to zero counts."""

    def ahead(t, state):
        return 0.2 - state.object_position[0]

    trajectory = simulate(pushed({"from": {"when": ahead}}), 1.6)
    root = (0.3 + math.sqrt(0.09 + 4 * 0.4 * 0.2)) / 0.8
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["attached"]
    np.testing.assert_allclose(when, root, rtol=0.0, atol=TIME)
    np.testing.assert_allclose(trajectory.object_position[-1, 0], 0.2, atol=TIME)


def test_a_joint_lets_go_at_the_root_of_its_function():
    """Of the angle of a pendulum that a light arm turns with."""
    angle, rate, limit = 0.7, 0.3, -0.2

    def beyond(t, state):
        x, _, z = state.object_position
        return math.atan2(-x, -z) - limit

    arms = {"rider": arm("Y", velocity=[rate], mass=1.0, inertia=0.02)}
    joint = {"arm": "rider", "kind": "weld", "until": {"when": beyond}}
    trajectory = simulate(pendulum(angle, rate, arms, [joint]), 1.0)

    def reached(t, y):
        return y[0] - limit

    reached.terminal = True
    moment = ABOUT_PIVOT + 0.02
    solution = solve_ivp(
        lambda t, y: [y[1], -FALL * BOB * LENGTH / moment * np.sin(y[0])], (0.0, 1.0),
        [angle, rate], method="DOP853", rtol=3e-14, atol=1e-15, events=reached,
    )  # fmt: skip
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["detached"]
    np.testing.assert_allclose(when, solution.t_events[0], rtol=0.0, atol=TIME)


def test_functions_of_pairs_follow_one_another():
    """Take hold at one place, let go at a time, and take hold again at another place."""

    def at(place):
        return {"when": lambda t, state: place - state.object_position[0]}

    joint = {"from": [[at(0.1), 1.2], [at(0.3), "never"]]}
    trajectory = simulate(pushed(joint, speed=0.5, force=0.0), 2.5)
    # held by the world, the object rests: the cart with it, for good
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["attached", "detached"]
    np.testing.assert_allclose(when, [0.2, 1.2], rtol=0.0, atol=TIME)
    trajectory = simulate(pushed(joint, speed=0.5, force=4.0), 2.5)
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["attached", "detached", "attached"]
    first = (-0.5 + math.sqrt(0.25 + 4 * 0.4 * 0.1)) / 0.8
    np.testing.assert_allclose(when, [first, 1.2, 1.2 + math.sqrt(0.2 / 0.4)], rtol=0.0, atol=TIME)


# --- touching -------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("name", ["floor", "bench", "bench/top"])
def test_a_joint_takes_hold_when_a_contact_closes(name, restitution):
    """A falling ball is held where it touches, by the world."""
    height = 0.3
    effects = {"unilateral_contacts": {"start": "as_written", "restitution": restitution}}
    joints = [{"between": ["object", "world"], "name": "catch", "kind": "weld",
               "from": {"touching": name}}]  # fmt: skip
    if name == "floor":
        effects["floor"] = {"restitution": restitution}
    else:
        contact = {"arm": {"sphere": {"radius": 0.05}}, "object": {"plane": {"normal": [0, 0, 1]}},
                   "name": "top"}  # fmt: skip
        joints.append({"between": ["object", "world"], "name": "bench", "kind": "contacts",
                       "contacts": [contact]})  # fmt: skip
    table = {"gravity": [0, 0, -FALL], "object": ball(height=height), "robots": ASIDE,
             "joints": joints, "effects": effects}  # fmt: skip
    trajectory = simulate(table, 0.5)
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["attached"]
    np.testing.assert_allclose(when, math.sqrt(2 * height / FALL), rtol=0.0, atol=TIME)
    assert np.max(np.abs(trajectory.object_twist[-1])) < 1e-12
    np.testing.assert_allclose(trajectory.object_position[-1, 2], 0.05, atol=1e-10)


# --- times ----------------------------------------------------------------------------------------


def test_pairs_of_times_switch_when_they_say():
    pairs = [[0.1, 0.25], [0.4, 0.45], [0.7, "never"]]
    trajectory = simulate(pushed({"from": pairs}, speed=0.5), 0.9)
    kinds, when = kinds_and_times(trajectory)
    assert kinds == ["attached", "detached"] * 2 + ["attached"]
    assert when == [0.1, 0.25, 0.4, 0.45, 0.7]


def test_a_joint_from_never_changes_nothing():
    with_joint = simulate(pushed({"from": "never"}, speed=0.5), 0.9)
    table = pushed({}, speed=0.5)
    alone = simulate(table | {"joints": table["joints"][:1]}, 0.9)
    assert not switches(with_joint)
    np.testing.assert_allclose(with_joint.object_position, alone.object_position, atol=1e-12)


def test_an_interval_that_ends_before_its_beginning_is_left_out():
    """The function does not fall to zero before the end; the next interval begins all the same."""

    def far(t, state):
        return 100.0 - state.object_position[0]

    pairs = [[{"when": far}, 0.2], [0.5, 0.6]]
    kinds, when = kinds_and_times(simulate(pushed({"from": pairs}), 0.9))
    assert kinds == ["attached", "detached"]
    assert when == [0.5, 0.6]


def test_a_run_that_begins_within_an_interval_holds_from_its_start():
    table = pushed({"from": [[0.1, 0.3], [0.5, 0.6]]}, speed=0.0)
    kinds, when = kinds_and_times(simulate(table, 0.5, start_time=0.2))
    assert kinds == ["detached", "attached", "detached"]
    assert when == [0.3, 0.5, 0.6]


FLOOR_BELOW = {
    "unilateral_contacts": {"start": "as_written"}, "floor": {"at": {"xyz": [0, 0, -3.0]}},
}  # fmt: skip


@pytest.mark.parametrize("effects", [{}, FLOOR_BELOW], ids=["alone", "floor"])
def test_a_joint_that_holds_at_the_start_stops_its_bodies_there(effects):
    """Whatever the contacts do at the start."""
    trajectory = simulate(pushed({"until": 0.3}, force=5.0, effects=effects), 0.6)
    np.testing.assert_allclose(trajectory.object_twist[-1, 0], 0.3, atol=TIME)
    assert kinds_and_times(trajectory) == (["detached"], [0.3])


@pytest.mark.parametrize("begin", [0.25, 0.7])
def test_a_run_may_end_when_a_joint_is_switched(begin):
    table = pushed({"from": begin}, speed=0.5)
    trajectory = simulate(table, begin)
    assert trajectory.time[-1] == begin
    stepper = ma.Stepper(ma.compile_system(parse_scene(table)), accuracy=1e-8)
    stepper.advance(begin)
    stepper.advance(0.1)
    assert [e["kind"] for e in stepper.events if e["kind"] == "attached"] == ["attached"]
    assert np.max(np.abs(stepper.state.object_twist)) < 1e-12


def test_a_step_may_end_within_rounding_of_a_switch():
    """0.2 s and 0.1 s are 0.30000000000000004 s, after which no step leads from 0.3 s."""
    system = ma.compile_system(parse_scene(pushed({"from": 0.3}, speed=0.5)))
    for durations in ([0.2, 0.1, 0.1], [0.3 + 1e-15, 0.1], [0.3 - 1e-15, 0.1]):
        stepper = ma.Stepper(system, accuracy=1e-8)
        for duration in durations:
            stepper.advance(duration)
        (event,) = [e for e in stepper.events if e["kind"] == "attached"]
        np.testing.assert_allclose(event["time"], 0.3, rtol=0.0, atol=1e-14)
        assert np.max(np.abs(stepper.state.object_twist)) < 1e-12
    assert ma.simulate(system, 0.1 + 0.2, accuracy=1e-8).status == "completed"


def test_joints_may_be_switched_within_rounding():
    pairs = [[0.3, 0.3 + 1e-14], [0.3 + 2e-14, "never"]]
    trajectory = simulate(pushed({"from": pairs}, speed=0.5), 0.5)
    assert kinds_and_times(trajectory)[0] == ["attached", "detached", "attached"]


# --- letting go -----------------------------------------------------------------------------------


LEFT = 0.3
"""When a joint lets go [s]."""


def two_arms(until=LEFT, gravity=(0, 0, -FALL)):
    """Two UR5s hold a plate, which moves; the right one lets go."""
    arms = {
        "left": {"base": {"xyz": [-1.1, 0, 0]}},
        "right": {"base": {"xyz": [1.1, 0, 0], "rpy": [0, 0, math.pi]}},
    }
    arms = {name: {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE,
                   "velocity": [0.2, -0.1, 0.3, 0.1, -0.2, 0.3], **more}
            for name, more in arms.items()}  # fmt: skip
    joints = [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "weld", "until": until}]
    body = {"shape": {"box": [1.2, 0.4, 0.1]}, "mass": 4.0, "pose": {"xyz": [0, 0, 0.5]},
            "twist": [0.3, 0.2, -0.4, 0.3, 0.5, -0.2]}  # fmt: skip
    return {"gravity": list(gravity), "object": body, "arms": arms, "joints": joints,
            "effects": {"joint_damping": 2.0}}  # fmt: skip


def test_letting_go_keeps_positions_and_velocities(monkeypatch):
    states = []
    switch = EventHandler._switch

    def watched(self, run):
        layout = run.data.model.layout
        before = state_of(run, layout)
        fault = switch(self, run)
        states.append((before, state_of(run, layout)))
        return fault

    monkeypatch.setattr(EventHandler, "_switch", watched)
    simulate(two_arms(), LEFT + 0.01)
    ((before, after),) = states
    np.testing.assert_array_equal(after.object_position, before.object_position)
    # its length is made one again
    np.testing.assert_allclose(
        after.object_quaternion_xyzw, before.object_quaternion_xyzw, rtol=0.0, atol=ROUNDING
    )
    # those that remain held are projected once more
    np.testing.assert_allclose(after.object_twist, before.object_twist, rtol=0.0, atol=ROUNDING)
    for name in ("left", "right"):
        np.testing.assert_array_equal(after.joint_positions[name], before.joint_positions[name])
        np.testing.assert_allclose(
            after.joint_velocities[name], before.joint_velocities[name], rtol=0.0, atol=ROUNDING
        )


def test_forces_and_motion_after_letting_go_are_those_without_the_joint():
    end = LEFT + 0.3
    times = [*(LEFT + AFTER), *np.linspace(LEFT + 0.02, end, 15)]
    trajectory = simulate(two_arms(), end, times)
    held = ma.compile_system(parse_scene(two_arms(until="never")))
    there = last_state(held, ma.simulate(held, LEFT, **EXACT))
    # without the joint, from that state on
    loose = ma.compile_system(parse_scene(held_never(two_arms(), "right")))
    at_once = ma.evaluate(loose, LEFT, there)
    forces = trajectory.wrenches["left"]
    np.testing.assert_allclose(
        3 * forces[0] - 3 * forces[1] + forces[2], at_once.wrenches["left"], rtol=1e-9, atol=1e-8
    )
    assert not np.any(trajectory.wrenches["right"])
    alone = ma.simulate(loose, end - LEFT, start_time=LEFT, state=there, output_times=times,
                        **EXACT)  # fmt: skip
    for part in ("object_position", "object_quaternion_xyzw", "object_twist"):
        np.testing.assert_allclose(getattr(trajectory, part), getattr(alone, part), atol=1e-9)
    for name in ("left", "right"):
        np.testing.assert_allclose(
            trajectory.joint_positions[name], alone.joint_positions[name], atol=1e-9
        )
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9
