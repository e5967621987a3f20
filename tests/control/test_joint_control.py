"""Claims about control laws and effects: their torques, their power, and what they refuse."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from mechanics import (
    first_difference,
    panda_trio,
    plain_gaps,
    random_state,
    stacked,
    two_arm_block,
    ur5_pair,
)
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.control.joint_pd import path_point
from multiarm.dynamics.forces.compiled import static_forces
from multiarm.errors import ControlError

WELDS = ({"kind": "weld"}, {"kind": "weld"})


def controlled(control, build=lambda: ur5_pair(*WELDS), **more):
    return ma.compile_system(build().replace(control=control, **more))


def torques(system, t=0.0, state=None):
    return np.concatenate(list(ma.evaluate(system, t, state).joint_torques.values()))


# --- torques -------------------------------------------------------------------------------------


def test_no_control_is_no_torque(welded_ur5_system):
    np.testing.assert_array_equal(torques(welded_ur5_system), 0.0)


def test_constant_torques_are_as_written():
    named = {"left": [1, 2, 3, 4, 5, 6], "right": {"elbow_joint": -7.0}}
    system = controlled({"kind": "constant", "torques": named})
    np.testing.assert_array_equal(torques(system, 3.3), [1, 2, 3, 4, 5, 6, 0, 0, -7, 0, 0, 0])


def test_harmonic_torques_follow_their_formula():
    control = {
        "kind": "harmonic", "frequency": 1.7, "hold": False,
        "amplitude": {"left": [1, 2, 3, 4, 5, 6], "right": 0.5},
        "phase": {"left": 0.3, "right": {"elbow_joint": -1.0}},
    }  # fmt: skip
    system = controlled(control)
    amplitude = np.array([1, 2, 3, 4, 5, 6] + [0.5] * 6)
    phase = np.array([0.3] * 6 + [0, 0, -1.0, 0, 0, 0])
    for t in (0.0, 0.123, 5.0):
        expected = amplitude * np.sin(2 * math.pi * 1.7 * t + phase)
        np.testing.assert_allclose(torques(system, t), expected, atol=1e-12)


def test_joint_pd_pulls_towards_the_start_joint_by_joint(rng):
    stiffness = {"left": [10, 20, 30, 40, 50, 60], "right": 5.0}
    control = {"kind": "joint_pd", "stiffness": stiffness, "damping": 2.0,
               "gravity_compensation": False}  # fmt: skip
    system = controlled(control)
    start, state = system.initial_state(), random_state(system, rng)
    gains = np.array([10, 20, 30, 40, 50, 60] + [5.0] * 6)
    expected = gains * (start.position[7:] - state.position[7:]) - 2.0 * state.velocity[6:]
    np.testing.assert_allclose(torques(system, 1.0, state), expected, atol=1e-11)


@pytest.mark.parametrize("build", [lambda: ur5_pair(*WELDS), lambda: panda_trio({"kind": "ball"})])
def test_gravity_compensation_holds_everything_still(build):
    """At rest nothing accelerates, whatever is held, and the object's weight is shared."""
    system = controlled("gravity_compensation", build)
    ev = ma.evaluate(system)
    q, _ = stacked(ev)
    np.testing.assert_allclose(q, 0.0, atol=1e-8)
    lift = sum(f @ ev.contact_normals[a] for a, f in ev.contact_forces.items())
    np.testing.assert_allclose(lift, [0, 0, 9.81 * system.scene.object.mass], atol=1e-8)


def test_gravity_compensation_adds_no_internal_force(welded_ur5_system):
    """Among all contact forces that carry the weight it asks for those of least norm."""
    system = controlled("gravity_compensation")
    ev = ma.evaluate(system)
    W_o = ev.W_o
    weight = np.array([0, 0, 9.81 * system.scene.object.mass, 0, 0, 0])
    np.testing.assert_allclose(stacked(ev)[1], np.linalg.pinv(W_o) @ weight, atol=1e-7)


def test_static_forces_are_the_least_norm_solution(rng):
    for rows, rank in ((12, 6), (7, 6), (6, 5), (4, 4), (5, 3)):
        W_o = rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, 6))
        weight = W_o.T @ rng.standard_normal(rows)  # one that the contacts can carry
        force = np.full(rows, np.nan)
        static_forces(W_o, weight, force)
        np.testing.assert_allclose(force, np.linalg.pinv(W_o.T) @ weight, atol=1e-8)


def test_held_harmonic_torques_start_from_rest():
    """At a zero of all sines the held scene does not move."""
    control = {"kind": "harmonic", "frequency": 2.0, "amplitude": {"left": 3.0}, "hold": True}
    q, _ = stacked(ma.evaluate(controlled(control)))
    np.testing.assert_allclose(q, 0.0, atol=1e-8)


# --- paths ---------------------------------------------------------------------------------------


def path_system(stiffness, damping):
    """Two UR5s that lift and turn a box along the example's path, on joint springs alone."""
    scene = ma.load_scene(SCENES / "two_ur5_box.yaml")
    control = scene.control.model_copy(
        update={"stiffness": stiffness, "damping": damping, "gravity_compensation": False}
    )
    return ma.compile_system(scene.replace(control=control))


@pytest.fixture(scope="module")
def springs():
    return path_system(1.0, 0.0)


@pytest.fixture(scope="module")
def dampers():
    return path_system(0.0, 1.0)


def reference(springs, t):
    """Where the springs pull to: with unit stiffness the torque is reference minus position."""
    return springs.initial_state().position[7:] + torques(springs, t)


def quintic(s):
    return s**3 * (10 - 15 * s + 6 * s**2)


@pytest.mark.parametrize("t", [0.0, 0.4, 1.25, 2.3, 2.5, 2.6, 3.9, 5.0, 9.0])
def test_reference_of_a_path_closes_the_chains_all_the_way(springs, t):
    """The box is lifted by 0.15 m until 2.5 s, then turned by 0.3 rad until 5 s, then rests."""
    height = 0.5 + 0.15 * quintic(min(t, 2.5) / 2.5)
    yaw = 0.3 * quintic(np.clip(t / 2.5 - 1.0, 0.0, 1.0))
    state = springs.state(
        object_position=[0, 0, height],
        object_quaternion_xyzw=[0, 0, math.sin(yaw / 2), math.cos(yaw / 2)],
        joint_positions=springs.model.layout.split_joints(reference(springs, t)),
    )
    np.testing.assert_allclose(plain_gaps(springs, state), 0.0, atol=1e-7)


@pytest.mark.parametrize("t", [0.7, 2.4, 4.1])
def test_velocity_of_a_path_is_the_rate_of_its_reference(springs, dampers, t):
    rate = first_difference(lambda s: reference(springs, t + s), 1e-2)
    np.testing.assert_allclose(torques(dampers, t), rate, atol=1e-8)
    assert np.max(np.abs(rate)) > 1e-3


def test_a_path_rests_outside_its_times(dampers):
    for t in (0.0, 2.5, 5.0, 17.0):
        np.testing.assert_allclose(torques(dampers, t), 0.0, atol=1e-9)


def test_a_path_breaks_the_steps_at_its_waypoints(springs):
    assert springs.model.breakpoints.tolist() == [0.0, 2.5, 5.0]


def test_adaptive_steps_end_at_every_breakpoint(free_block_system):
    """No step reaches over one: they are as many and as short as the breakpoints ask."""
    model = dataclasses.replace(free_block_system.model, breakpoints=np.linspace(0.0, 0.1, 101))
    dense = dataclasses.replace(free_block_system, model=model)
    run = {"duration": 0.1, "integrator": "dop853", "tolerance": 1e-4}
    free = ma.simulate(free_block_system, **run).statistics
    broken = ma.simulate(dense, **run).statistics
    assert free["largest_step_s"] > 5e-3
    assert broken["largest_step_s"] <= 1.0001e-3 and broken["steps"] >= 100


def test_a_path_out_of_reach_names_its_waypoint():
    scene = ma.load_scene(SCENES / "two_ur5_box.yaml")
    control = scene.control.model_dump(exclude_unset=True)
    control["path"] = [{"time": 1.0, "xyz": [0, 0, 0.6]}, {"time": 2.0, "xyz": [0, 0, 2.5]}]
    with refused(ControlError, "control.path"):
        ma.compile_system(scene.replace(control=control))


def test_clenshaw_sums_are_numpys(rng):
    """Value and slope of every segment, its ends included."""
    bounds, coefficients = np.array([0.5, 1.5, 3.0]), rng.standard_normal((2, 3, 6))
    for t, segment in ((0.7, 0), (1.4, 0), (1.6, 1), (2.9, 1)):
        begin, end = bounds[segment : segment + 2]
        x = 2 * (t - begin) / (end - begin) - 1
        for joint in range(3):
            series = np.polynomial.Chebyshev(coefficients[segment, joint])
            value, slope = path_point(t, bounds, coefficients, joint)
            assert value == pytest.approx(series(x), abs=1e-13)
            assert slope == pytest.approx(series.deriv()(x) * 2 / (end - begin), abs=1e-12)


# --- Python controllers --------------------------------------------------------------------------


def run_both(system, python, **run):
    """The built-in control and a Python function in its place."""
    run = {"duration": 0.1, "integrator": "rk4", "step": 1e-3, **run}
    return ma.simulate(system, **run), ma.simulate(system, control=python, **run)


def assert_same(first, second, atol=1e-12):
    np.testing.assert_allclose(second.object_position, first.object_position, atol=atol)
    np.testing.assert_allclose(second.work, first.work, atol=100 * atol)
    for name in first.arm_names:
        for channel in ("joint_positions", "joint_torques"):
            one, other = getattr(first, channel)[name], getattr(second, channel)[name]
            np.testing.assert_allclose(other, one, atol=atol * max(1.0, np.max(np.abs(one))))


def test_python_constant_torques_equal_the_built_in_ones(block_system):
    written = block_system.scene.control.torques
    both = run_both(block_system, lambda t, state: written)
    assert both[0].status == both[1].status == "completed"
    assert_same(*both)


def test_python_joint_pd_equals_the_built_in_one():
    control = {"kind": "joint_pd", "stiffness": 40.0, "damping": 3.0, "gravity_compensation": False}
    system = ma.compile_system(two_arm_block(torques=False).replace(control=control))
    start = system.initial_state()

    def pd(t, state):
        return {
            arm: 40.0 * (start.joint_positions[arm] - state.joint_positions[arm])
            - 3.0 * state.joint_velocities[arm]
            for arm in ("one", "two")
        }

    assert_same(*run_both(system, pd), atol=1e-11)


def test_python_controller_sees_time_and_the_whole_state(block_system):
    seen = []

    def watch(t, state):
        seen.append((t, state.copy()))
        return {}

    ma.simulate(block_system, duration=0.01, integrator="rk4", step=5e-3, control=watch)
    times = {round(t, 9) for t, _ in seen}
    assert times == {0.0, 0.0025, 0.005, 0.0075, 0.01}
    first = seen[0][1]
    np.testing.assert_array_equal(first.position, block_system.initial_state().position)
    np.testing.assert_array_equal(first.velocity, block_system.initial_state().velocity)


def test_a_controller_cannot_change_the_state_it_is_shown(free_block_system):
    def vandal(t, state):
        state.position[:] = 7.0
        state.velocity[:] = 7.0
        return {}

    both = run_both(free_block_system, vandal)
    assert_same(*both, atol=0.0)


def test_arms_that_a_controller_leaves_out_get_no_torque(free_block_system):
    """Also when it named them a moment before."""

    def blinking(t, state):
        return {"one": np.ones(6), "two": np.ones(6)} if t < 0.5 else {"one": np.ones(6)}

    system = free_block_system.with_control(blinking)
    assert torques(system, 0.0).tolist() == [1.0] * 12
    assert torques(system, 1.0).tolist() == [1.0] * 6 + [0.0] * 6


BAD = {
    "a list": (lambda t, s: [1.0], "torques"),
    "nothing": (lambda t, s: None, "torques"),
    "unknown": (lambda t, s: {"three": np.zeros(6)}, "'three'"),
    "five": (lambda t, s: {"one": np.zeros(5)}, "torques['one']"),
    "a number": (lambda t, s: {"one": 3.0}, "torques['one']"),
    "not finite": (lambda t, s: {"two": [np.nan] * 6}, "torques['two']"),
    "words": (lambda t, s: {"one": ["a"] * 6}, "torques['one']"),
}


@pytest.mark.parametrize(("control", "place"), BAD.values(), ids=BAD)
def test_unusable_torques_are_a_control_error_at_the_first_evaluation(
    free_block_system, control, place
):
    for attempt in (
        lambda: ma.simulate(free_block_system, duration=0.1, control=control),
        lambda: ma.evaluate(free_block_system.with_control(control)),
    ):
        with refused(ControlError, place):
            attempt()
    # nothing of it is left behind
    assert ma.simulate(free_block_system, duration=0.01).status == "completed"


def test_an_exception_of_the_controller_is_not_swallowed_at_the_first_evaluation(free_block_system):
    def broken(t, state):
        raise LookupError("no gains today")

    with pytest.raises((ControlError, LookupError), match="no gains today"):
        ma.simulate(free_block_system, duration=0.1, control=broken)


@pytest.mark.parametrize("trouble", ["raises", "wrong shape", "nan"])
def test_trouble_of_the_controller_on_the_way_ends_the_run_with_what_there_is(
    free_block_system, trouble
):
    def late(t, state):
        if t < 0.05:
            return {}
        if trouble == "raises":
            raise LookupError("no gains any more")
        return {"one": np.zeros(5) if trouble == "wrong shape" else np.full(6, np.nan)}

    trajectory = ma.simulate(
        free_block_system, duration=0.1, integrator="rk4", step=1e-3, output_step=1e-3, control=late
    )
    assert trajectory.status == "failed"
    reason = {"raises": "LookupError: no gains any more", "wrong shape": "got (5,)",
              "nan": "not finite"}[trouble]  # fmt: skip
    assert reason in trajectory.message and "t = 0.04" in trajectory.message
    assert 0.045 < trajectory.time[-1] < 0.0501
    assert np.all(np.isfinite(trajectory.object_position))
    # the same system runs on
    assert ma.simulate(free_block_system, duration=0.01).status == "completed"


# --- effects -------------------------------------------------------------------------------------


def test_joint_damping_pushes_against_every_joints_velocity(rng):
    """The difference that damping makes is that of torques -d q'."""
    damping = {"left": [1, 2, 3, 4, 5, 6], "right": 0.5}
    plain = ma.compile_system(ur5_pair(*WELDS))
    damped = ma.compile_system(ur5_pair(*WELDS).replace(effects={"joint_damping": damping}))
    state = random_state(plain, rng)
    d = np.array([1, 2, 3, 4, 5, 6] + [0.5] * 6)
    by_hand = plain.with_control(lambda t, s: s.layout.split_joints(-d * s.velocity[6:]))
    expected, found = ma.evaluate(by_hand, 0.0, state), ma.evaluate(damped, 0.0, state)
    for one, other in zip(stacked(expected), stacked(found), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(torques(damped, 0.0, state), 0.0)  # not a torque of the control
