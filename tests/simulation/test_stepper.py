"""Claims about `Stepper`: advanced from outside, it gives the numbers of a run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import GRAVITY, arm, ball, ball_on_plate, box, fall_time, on_floor
from loose_scenes import cart_with_box
from mechanics import ur5_pair
from refusals import refused

import multiarm as ma
from multiarm.errors import ControlError, ModelError, SceneError, SolverError
from multiarm.problems import ring_of_arms
from multiarm.scene import parse_scene
from multiarm.simulation.event_handling import EventHandler
from multiarm.spatial import quaternion_to_matrix

T, COUNT = 2e-3, 40
SPRUNG = {"kind": "joint_pd", "stiffness": 300.0, "damping": 20.0}


def servo(t, state):
    """Soft springs to zero, and a shake."""
    return {
        a: 20.0 * np.cos(30.0 * t) - 5.0 * q - 2.0 * state.joint_velocities[a]
        for a, q in state.joint_positions.items()
    }


def shaken(**more):
    """A ball on a plate that rides on a spring; the ball jumps off and lands."""
    return ball_on_plate(arm("z", mass=2.0), ball(mass=0.5), **more)


def shake(t, state):
    return {"plate": [50.0 * math.sin(4.0 * math.pi * t) + 2.5 * GRAVITY]}


def ur5s(**effects):
    return ur5_pair({"kind": "weld"}, {"kind": "ball"}, effects=effects)


LAGGING = {"torque_limits": "urdf", "actuator_lag": 0.01, "joint_damping": 2.0}


def assert_same(run, other, exactly=True):
    """The samples of two results."""
    assert len(run.time) == len(other.time)
    for name in ("time", "object_position", "object_quaternion_xyzw", "object_twist"):
        np.testing.assert_allclose(
            getattr(run, name), getattr(other, name), rtol=0.0, atol=0.0 if exactly else 1e-12
        )
    for a in run.arm_names:
        for name in (
            "joint_positions", "joint_torques", "contact_forces", "wrenches", "tip_positions",
            "tip_quaternions_xyzw", "tip_twists",
        ):  # fmt: skip
            found, expected = getattr(run, name)[a], getattr(other, name)[a]
            # a run samples its control at its end once more
            np.testing.assert_array_equal(found[:-1], expected[:-1])


# --- the numbers of a run ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("build", "control", "settings"),
    [
        (ur5s, servo, {"accuracy": 1e-6}),
        (ur5s, servo, {"integrator": "rk4", "step": 1.5e-3}),
        (ur5s, servo, {"integrator": "rodas5p", "tolerance": 1e-5}),
        (ur5s, servo, {"integrator": "variational", "step": 1e-3}),
        (ur5s, servo, {"accuracy": 1e-5, "stabilization": "feedback"}),
        (lambda: ur5s(**LAGGING), servo, {"accuracy": 1e-6}),
        (shaken, shake, {"accuracy": 1e-7}),
        (shaken, shake, {"integrator": "rk4", "step": 1e-3}),
    ],
    ids=["dop853", "rk4", "rodas5p", "variational", "feedback", "effects", "events", "events-rk4"],
)
def test_held_torques_give_the_run_of_a_sampled_control_bit_for_bit(build, control, settings):
    system = ma.compile_system(build())
    count = 400 if control is shake else COUNT
    run = ma.simulate(
        system, count * T, control=control, sample_time=T, certificate=False, output_step=T / 2,
        **settings,
    )  # fmt: skip
    assert run.status == "completed"
    stepper = ma.Stepper(system, record=True, output_step=T / 2, **settings)
    for k in range(count):
        assert stepper.time == k * T
        state = stepper.advance(T, control(stepper.time, stepper.state))
    found = stepper.trajectory()
    assert_same(found, run)
    np.testing.assert_array_equal(state.object_twist, run.object_twist[-1])
    assert [e["kind"] for e in stepper.events] == [e["kind"] for e in run.events]
    assert (control is not shake) or len(stepper.events) == 3
    assert found.status == "completed" and found.simulated_scene is system.scene
    assert found.scene.run.duration == count * T and "stepper" in found.provenance["control"]


@pytest.mark.parametrize("sample_time", [None, 3e-3])
def test_without_torques_the_scene_s_control_goes_on(sample_time):
    """All the time or at its samples, which need not be where the calls begin."""
    control = {**SPRUNG, "path": [{"time": 0.03, "xyz": [0.0, 0.01, 0.51]}]}
    if sample_time is not None:
        control["sample_time"] = sample_time
    system = ma.compile_system(ur5s().replace(control=control))
    run = ma.simulate(system, 0.05, certificate=False, output_step=0.05, max_step=0.005)
    stepper = ma.Stepper(system, max_step=0.005)
    for duration in (0.01, 0.02, 0.005, 0.015):
        state = stepper.advance(duration)
    np.testing.assert_allclose(stepper.time, 0.05, rtol=1e-15)
    np.testing.assert_allclose(state.object_position, run.object_position[-1], atol=1e-9)
    np.testing.assert_allclose(state.object_twist, run.object_twist[-1], atol=1e-7)


@pytest.mark.parametrize("sample_time", [None, 0.05])
def test_scene_s_control_and_given_torques_take_turns(tmp_path, sample_time):
    """A cart of 5 kg: closed forms of a spring that acts all the time, or of its first sample."""
    control = {"kind": "joint_pd", "stiffness": 500.0, "damping": 0.0,
               "gravity_compensation": False}  # fmt: skip
    if sample_time is not None:
        control["sample_time"] = sample_time
    scene = cart_with_box(tmp_path, {}, control=control, run={"accuracy": 1e-10})
    stepper = ma.Stepper(ma.compile_system(parse_scene(scene)))
    stepper.advance(0.13, {"cart": [50.0]})
    state = stepper.advance(0.02)
    x, v = 0.5 * 10.0 * 0.13**2, 10.0 * 0.13
    if sample_time is None:
        w = 10.0
        c, s = math.cos(w * 0.02), math.sin(w * 0.02)
        x, v = x * c + v / w * s, v * c - x * w * s
    else:  # sampled at 0.13 s, when it takes over, and next at 0.15 s
        a = -100.0 * x
        x, v = x + v * 0.02 + 0.5 * a * 0.02**2, v + a * 0.02
    assert state.joint_positions["cart"][0] == pytest.approx(x, abs=1e-9)
    assert state.joint_velocities["cart"][0] == pytest.approx(v, abs=1e-8)
    state = stepper.advance(0.01, {"cart": [0.0]})
    assert state.joint_velocities["cart"][0] == pytest.approx(v, abs=1e-8)


def test_arms_that_are_not_named_get_no_torque(ur5_system):
    left = {"left": np.arange(6.0)}
    one, other = ma.Stepper(ur5_system), ma.Stepper(ur5_system)
    for _ in range(3):  # not what the call before has given them, either
        one.advance(T, {"right": np.ones(6)})
        other.advance(T, {"left": np.zeros(6), "right": np.ones(6)})
        one.advance(T, left)
        other.advance(T, {**left, "right": np.zeros(6)})
    np.testing.assert_array_equal(one.state.velocity, other.state.velocity)


# --- what it shows -------------------------------------------------------------------------------


def test_contact_forces_are_those_of_the_last_torques(ur5_system):
    stepper = ma.Stepper(ur5_system)
    torques = {"left": np.full(6, 3.0), "right": np.full(6, -2.0)}
    state = stepper.advance(0.01, torques)
    driven = ur5_system.with_control(lambda t, state: torques)
    expected = ma.evaluate(driven, stepper.time, state).contact_forces
    for a, forces in stepper.contact_forces.items():
        np.testing.assert_allclose(forces, expected[a], atol=1e-8)
    before = stepper.state
    np.testing.assert_array_equal(stepper.advance(T, torques).velocity[:0], [])
    assert not np.array_equal(before.velocity, stepper.state.velocity)  # it was a copy


def test_wrenches_and_tips_are_those_of_the_present(ur5_system):
    stepper = ma.Stepper(ur5_system)
    torques = {"left": np.full(6, 3.0), "right": np.full(6, -2.0)}
    state = stepper.advance(0.01, torques)
    driven = ur5_system.with_control(lambda t, state: torques)
    expected = ma.evaluate(driven, stepper.time, state)
    wrenches, places = stepper.wrenches, stepper.tip_positions
    turns, twists = stepper.tip_quaternions_xyzw, stepper.tip_twists
    for a, tip in ur5_system.kinematics(state).tips.items():
        np.testing.assert_allclose(wrenches[a], expected.wrenches[a], atol=1e-8)
        np.testing.assert_allclose(places[a], tip.position, atol=1e-12)
        np.testing.assert_allclose(quaternion_to_matrix(turns[a]), tip.rotation, atol=1e-12)
        np.testing.assert_allclose(twists[a], tip.twist, atol=1e-12)
    before = wrenches["left"].copy()
    stepper.advance(T, {})
    np.testing.assert_array_equal(wrenches["left"], before)  # it was a copy
    assert not np.array_equal(stepper.wrenches["left"], before)


def test_the_floor_is_beside_the_arms():
    stepper = ma.Stepper(ma.compile_system(on_floor(box(mass=2.0))))
    stepper.advance(1e-3, {})
    assert list(stepper.wrenches) == list(stepper.contact_forces) == ["away", "floor"]
    assert list(stepper.tip_twists) == ["away"]
    np.testing.assert_allclose(stepper.wrenches["floor"][:3], [0, 0, 2.0 * GRAVITY], atol=1e-9)
    assert stepper.contact_forces["floor"].sum() == pytest.approx(2.0 * GRAVITY)


def test_times_of_equal_steps_do_not_drift(tmp_path):
    stepper = ma.Stepper(ma.compile_system(parse_scene(cart_with_box(tmp_path, {}))))
    for _ in range(1000):
        stepper.advance(1e-3, {})
    assert stepper.time == 1.0
    stepper.advance(0.25, {})
    assert stepper.time == 1.25


def test_reset_repeats_everything(ur5_system):
    stepper = ma.Stepper(ur5_system, record=True)

    def swing():
        return [stepper.advance(5e-3, servo(stepper.time, stepper.state)).velocity for _ in "abcd"]

    first = swing()
    stepper.reset()
    assert stepper.time == 0.0 and len(stepper.trajectory().time) == 1
    np.testing.assert_array_equal(swing(), first)
    other = stepper.state
    stepper.reset(other)
    np.testing.assert_allclose(stepper.state.velocity, other.velocity, atol=1e-12)
    swing()
    for wrong in (3, ma.compile_system(ring_of_arms(3)).initial_state()):
        with pytest.raises(ma.MultiarmError):
            stepper.reset(wrong)
    stepper.reset()  # to where it began last
    np.testing.assert_allclose(stepper.state.position, other.position, atol=1e-12)


def test_a_state_that_cannot_be_evaluated_is_not_where_it_began_last(ur5_system):
    stepper = ma.Stepper(ur5_system)
    start = stepper.state
    apart = ur5_system.state(object_position=start.object_position + 100.0)
    with pytest.raises(ma.MultiarmError):
        stepper.reset(apart)
    with refused(SolverError, "`reset`"):
        stepper.advance(T, {})
    stepper.reset()
    np.testing.assert_array_equal(stepper.state.position, start.position)


def test_a_trajectory_grows_and_can_be_stored(ur5_system, tmp_path, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.setup.BLOCK_NUMBERS", 1)  # 16 samples a block
    stepper = ma.Stepper(ur5_system, record=True, output_step=1e-3)
    lengths = []
    for _ in range(5):
        stepper.advance(0.0105, {})
        lengths.append(len(stepper.trajectory().time))
    assert lengths == [12, 22, 33, 43, 54]  # and the present, between two samples or at one
    run = stepper.trajectory()
    expected = np.append(1e-3 * np.arange(53), 5 * 0.0105)
    np.testing.assert_allclose(run.time, expected, atol=1e-12)
    run.save(tmp_path / "run.h5")
    loaded = ma.load_trajectory(tmp_path / "run.h5")
    np.testing.assert_array_equal(loaded.object_twist, run.object_twist)
    assert loaded.statistics["steps"] == run.statistics["steps"]


# --- faults --------------------------------------------------------------------------------------


def test_a_failed_step_leaves_the_last_good_state(tmp_path):
    """The place and a remedy are told; with other torques it goes on."""
    failing = [0.03]

    def wind(t, state):
        if t > failing[0]:
            raise ValueError("the wind tunnel is off")
        return np.zeros(6)

    effects = {"external_wrenches": [{"on": "object", "function": wind}]}
    scene = cart_with_box(tmp_path, effects, velocity=1.0)
    stepper = ma.Stepper(ma.compile_system(parse_scene(scene)), max_step=1e-3)
    stepper.advance(0.02, {"cart": [5.0]})
    with refused(SolverError, "external_wrenches[0]"):
        stepper.advance(0.02, {"cart": [5.0]})
    t = stepper.time
    assert 0.02 <= t <= 0.03
    assert stepper.state.joint_velocities["cart"][0] == pytest.approx(1.0 + t, abs=1e-9)
    failing[0] = math.inf
    state = stepper.advance(0.01, {"cart": [-5.0]})
    assert state.joint_velocities["cart"][0] == pytest.approx(1.0 + t - 0.01, abs=1e-9)


def test_an_event_is_located_again_after_the_step_to_it_failed(monkeypatch):
    """The load breaks off where an event has been located and the run has not come to it."""
    handle, located, failures = EventHandler.handle, [False], []

    def watched(self, run, stopped):
        fault = handle(self, run, stopped)
        located[0] = not stopped
        return fault

    def load(t, state):
        if located[0] and not failures:
            failures.append(t)
            raise ValueError("no load")
        return np.zeros(6)

    monkeypatch.setattr(EventHandler, "handle", watched)
    height, effects = 0.1, {"external_wrenches": [{"on": "object", "function": load}]}
    system = ma.compile_system(on_floor(ball(height=height), 0.5, effects=effects))
    stepper = ma.Stepper(system, integrator="rk4", step=0.01)
    with refused(SolverError, "external_wrenches[0]"):
        stepper.advance(0.2, {})
    assert failures and stepper.time < fall_time(height)
    stepper.advance(0.2, {})
    first, *_ = [event["time"] for event in stepper.events if event["kind"] == "bounces"]
    assert first == pytest.approx(fall_time(height), abs=1e-9)


def test_a_start_that_fails_under_torques_leaves_the_recording(tmp_path):
    failing = [False]

    def wind(t, state):
        if failing[0]:
            raise ValueError("the wind tunnel is off")
        return np.zeros(6)

    scene = cart_with_box(tmp_path, {"external_wrenches": [{"on": "object", "function": wind}]})
    stepper = ma.Stepper(ma.compile_system(parse_scene(scene)), record=True, output_step=1e-3)
    failing[0] = True
    with refused(ControlError, "external_wrenches[0]"):
        stepper.advance(0.01, {"cart": [5.0]})
    failing[0] = False
    state = stepper.advance(0.01)
    assert state.joint_velocities["cart"][0] == 0.0  # the torques are those of the system
    np.testing.assert_allclose(stepper.trajectory().time, 1e-3 * np.arange(11), atol=1e-15)


def test_a_recording_has_the_present_once_where_the_next_step_failed(tmp_path):
    def wind(t, state):
        if t > 0.02:
            raise ValueError("the wind tunnel is off")
        return np.zeros(6)

    scene = cart_with_box(tmp_path, {"external_wrenches": [{"on": "object", "function": wind}]})
    stepper = ma.Stepper(ma.compile_system(parse_scene(scene)), record=True, output_step=0.01)
    stepper.advance(0.02)
    with refused(SolverError, "external_wrenches[0]"):
        stepper.advance(0.02)
    np.testing.assert_allclose(stepper.trajectory().time, [0.0, 0.01, 0.02], atol=1e-15)


def test_a_run_that_hardly_gets_on_is_ended(ur5_system, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.driver.JUDGED_STEPS", 3)
    monkeypatch.setattr("multiarm.simulation.driver.SHORT_SHARE", 1.0)
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 20)
    scene = ur5_system.scene
    hasty = scene.replace(run=scene.run.model_copy(update={"most_steps": 10.0}))
    stepper = ma.Stepper(ma.compile_system(hasty, like=ur5_system), max_step=1e-3)
    with refused(SolverError, "most_steps"):
        stepper.advance(0.1, {})


def test_a_sampled_control_that_fails_is_asked_again_and_keeps_its_times(tmp_path):
    """The samples after the failure are still the multiples of the sample time."""
    asked, failing = [], [True]

    def flaky(t, state):
        asked.append(t)
        if failing[0] and t > 0.05:
            raise ValueError("no signal")
        return {"cart": [5.0]}

    scene = parse_scene(cart_with_box(tmp_path, {}))
    stepper = ma.Stepper(ma.compile_system(scene, flaky, sample_time=0.02))
    with refused(SolverError, "the controller"):
        stepper.advance(0.1)
    failing[0] = False
    state = stepper.advance(0.05)
    np.testing.assert_allclose(np.unique(asked), [0.0, 0.02, 0.04, 0.06, 0.08, 0.1], atol=1e-15)
    assert state.joint_velocities["cart"][0] == pytest.approx(0.11, abs=1e-12)
    assert state.layout == stepper.state.layout


@pytest.mark.parametrize(
    "duration", [0.0, -1.0, math.nan, math.inf, pytest.param(10**400, id="10**400")]
)
def test_a_duration_is_positive(ur5_system, duration):
    stepper = ma.Stepper(ur5_system)
    with refused(SolverError, "advance: "):
        stepper.advance(duration, {})
    assert stepper.time == 0.0


def test_a_duration_that_roundings_of_the_time_swallow_is_refused(ur5_system):
    stepper = ma.Stepper(ur5_system)
    stepper.advance(T, {})
    with refused(SolverError, "roundings"):
        stepper.advance(1e-17, {})
    stepper.advance(T, {})
    assert stepper.time == 2 * T


@pytest.mark.parametrize(
    "torques",
    [
        {"middle": [0.0] * 6},
        {"left": [0.0] * 5},
        {"left": [math.nan] * 6},
        [0.0] * 12,
    ],
)
def test_torques_that_do_not_fit_are_refused(ur5_system, torques):
    stepper = ma.Stepper(ur5_system)
    stepper.advance(T, {})
    before = stepper.state
    with refused(ControlError, "torques"):
        stepper.advance(T, torques)
    np.testing.assert_array_equal(stepper.state.velocity, before.velocity)
    assert stepper.advance(T, {}) is not None and stepper.time == 2 * T


def test_settings_and_states_are_checked_and_recording_is_on_request(ur5_system, block_system):
    with refused(SceneError, "'accuracy'"):
        ma.Stepper(ur5_system, accuracy=1e-6, step=1e-3)
    with refused(ModelError, "arms one, two"):
        ma.Stepper(ur5_system, block_system.initial_state())
    with refused(SolverError, "`Stepper(record=True)`"):
        ma.Stepper(ur5_system).trajectory()
