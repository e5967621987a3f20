"""Claims about the edges of what a scene may be: where its origin is, how its times fall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import (
    data_of,
    ur5_pair,
)
from refusals import refused

import multiarm as ma
from multiarm.assembly.linkage import projection_tolerance, scene_size
from multiarm.dynamics.forces.compiled import static_forces
from multiarm.dynamics.layout import Layout
from multiarm.errors import ControlError, ModelError
from multiarm.integration.step import coefficients, error_estimate, make_step
from multiarm.jit.kernels import greatest
from multiarm.problems import ring_of_arms
from multiarm.results.trajectory import load_trajectory
from multiarm.tableaus import DOP853, DOPRI5


def shifted(scene, by):
    """The same scene elsewhere in the world."""
    arms = {
        name: spec.model_copy(
            update={"base": move(spec.base, by)},
        )
        for name, spec in scene.arms.items()
    }
    body = scene.object.model_copy(update={"pose": move(scene.object.pose, by)})
    return scene.replace(arms=arms, object=body)


def move(pose, by):
    return pose.model_copy(update={"xyz": tuple(np.add(pose.xyz, by))})


def balls_on_a_line(control="gravity_compensation"):
    """Two ball joints and the centre of mass on one line: moments about it cannot be carried."""
    ends = [{"kind": "ball", "at": {"xyz": [x, 0, 0]}} for x in (-0.6, 0.6)]
    return ur5_pair(*ends, control={"kind": control})


def test_holding_torques_do_not_depend_on_where_the_scene_stands():
    here = ma.evaluate(ma.compile_system(balls_on_a_line()))
    there = ma.evaluate(ma.compile_system(shifted(balls_on_a_line(), (0.1, 0.2, 0.3))))
    for arm, torque in here.joint_torques.items():
        np.testing.assert_allclose(there.joint_torques[arm], torque, atol=1e-9)
    np.testing.assert_allclose(there.object_acceleration, 0.0, atol=1e-9)


def test_static_forces_ignore_lever_arms_at_rounding_level():
    """Three lines through the centre of mass, but for rounding: they carry forces, no moments."""
    rows = np.hstack([np.eye(3), 1e-17 * np.array([[0, 1, -1], [1, 0, 2], [-2, 1, 0.0]])])
    force = np.zeros(3)
    static_forces(rows, np.array([0, 0, 98.1, 0, 0, 0.0]), force)
    np.testing.assert_allclose(force, [0, 0, 98.1], atol=1e-10)


@pytest.mark.parametrize("by", [(0.0, 0.0, -0.5), (30.0, -20.0, 10.0)])
def test_a_scene_runs_wherever_its_origin_is(by):
    """With (0, 0, -0.5) the object's centre of mass is the world's origin."""
    scene = shifted(balls_on_a_line("none"), by)
    trajectory = ma.simulate(ma.compile_system(scene), duration=0.3, accuracy=1e-6)
    assert trajectory.status == "completed", trajectory.message
    assert np.max(trajectory.position_drift) < 1e-11


def test_tolerances_follow_the_size_of_the_arms_not_of_the_joint():
    """A ball at the centre of mass has no lever arm."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"})
    system = ma.compile_system(scene)
    assert 0.5 < scene_size(data_of(system)) < 5.0
    assert 1e-15 < projection_tolerance(data_of(system)) < 1e-12


@pytest.mark.parametrize("at", [0, 1, 2])
def test_the_largest_of_numbers_with_a_nan_is_nan(at):
    vector = np.array([1.0, -3.0, 2.0])
    assert greatest(vector) == 3.0
    vector[at] = math.nan
    assert math.isnan(greatest(vector))


@pytest.mark.parametrize("at", [0, 7, 15])
def test_a_step_with_a_nan_has_no_error_estimate(at):
    step = make_step(
        DOPRI5,
        Layout(("arm",), (0, 2), (0, 2), ("arm",), (0, 0), (0,)),
        np.zeros(0, dtype=np.int64),
    )
    step.k[:] = 1.0
    step.k[3, at] = math.nan
    # without its Python entry the kernel is tried as Python
    found = error_estimate.py_func(coefficients(DOPRI5, 0), step, 0.1, 0.0)
    assert math.isnan(found)


def test_errors_whose_squares_are_zero_are_small():
    """Of a locked mechanism, whose rates shrink by roundings: no error is 0 / 0."""
    layout = Layout(("arm",), (0, 2), (0, 2), ("arm",), (0, 0), (0,))
    step = make_step(DOP853, layout, np.zeros(0, dtype=np.int64))
    step.k[:] = 1e-200 * np.arange(step.k.size).reshape(step.k.shape)
    found = error_estimate.py_func(coefficients(DOP853, 0), step, 0.1, 1e-13)
    assert 0.0 < found < 1e-180


@pytest.mark.parametrize(("duration", "waypoint"), [(0.1 + 0.2, 0.3), (0.3, 1e-20), (0.3, 0.3)])
def test_waypoints_at_the_ends_of_a_run_are_no_obstacle(duration, waypoint):
    scene = ur5_pair(
        {"kind": "weld"},
        {"kind": "weld"},
        control={
            "kind": "joint_pd",
            "stiffness": 500,
            "damping": 50,
            "path": [{"time": waypoint, "xyz": [0, 0, 0.5]}, {"time": 1.0, "xyz": [0, 0, 0.51]}],
        },
    )
    trajectory = ma.simulate(ma.compile_system(scene), duration=duration)
    assert trajectory.status == "completed", trajectory.message
    assert trajectory.time[-1] == duration


def test_a_controller_may_evaluate_the_system_that_it_drives(free_block_system):
    """The two share nothing that is written."""

    def looks(t, state):
        ma.evaluate(free_block_system, 0.3, free_block_system.initial_state())
        return {}

    alone, looked_at = (
        ma.simulate(free_block_system, duration=0.01, control=control)
        for control in (lambda t, state: {}, looks)
    )
    np.testing.assert_array_equal(alone.object_position, looked_at.object_position)


def test_a_controller_may_not_evaluate_a_system_with_itself(free_block_system):
    holder = []

    def asks(t, state):
        ma.evaluate(holder[0], t, state)
        return {}

    holder.append(free_block_system.with_control(asks))
    with refused(ControlError, "the controller"):
        ma.simulate(holder[0], duration=0.01)


def test_a_controller_may_evaluate_a_second_system():
    scene = balls_on_a_line("none")
    model, driven = ma.compile_system(scene), ma.compile_system(scene)

    def same_as_none(t, state):
        here = model.state(
            state.object_position,
            state.object_quaternion_xyzw,
            state.joint_positions,
            state.object_twist,
            state.joint_velocities,
        )
        ma.evaluate(model, t, here)
        return {}

    run = {"duration": 0.05, "integrator": "rk4", "step": 1e-3}
    free = ma.simulate(driven, **run)
    watched = ma.simulate(driven, **run, control=same_as_none)
    np.testing.assert_array_equal(watched.object_position, free.object_position)


def test_a_short_pulse_of_a_controller_is_not_stepped_over():
    """The system rests until the pulse comes; no error estimate can announce it."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}, gravity=None)
    system = ma.compile_system(scene)

    def pulse(t, state):
        return {"left": np.full(6, 50.0 if 0.05 < t < 0.06 else 0.0)}

    adaptive = ma.simulate(system, duration=0.1, accuracy=1e-5, control=pulse)
    fixed = ma.simulate(system, duration=0.1, integrator="rk4", step=1e-4, control=pulse)
    moved = np.linalg.norm(fixed.object_position[-1] - fixed.object_position[0])
    apart = np.linalg.norm(adaptive.object_position[-1] - fixed.object_position[-1])
    assert moved > 1e-4
    assert apart < 0.02 * moved


@pytest.mark.parametrize("max_step", [0.0, -1.0, math.nan, pytest.param(10**400, id="10**400")])
def test_a_longest_step_is_positive(free_block_system, max_step):
    with refused(ma.MultiarmError, "max_step"):
        ma.simulate(free_block_system, duration=0.01, max_step=max_step)


@pytest.mark.parametrize("time", [math.nan, math.inf, pytest.param(10**400, id="10**400")])
def test_a_time_is_finite(free_block_system, time):
    with refused(ma.MultiarmError, "'start_time'"):
        ma.simulate(free_block_system, duration=0.01, start_time=time)
    with refused(ma.MultiarmError, "t: "):
        ma.evaluate(free_block_system, time, free_block_system.initial_state())


def test_a_controller_that_fails_after_the_start_makes_a_failed_run(free_block_system):
    def fails(t, state):
        if t > 0:
            raise RuntimeError("sensor lost")
        return {}

    trajectory = ma.simulate(free_block_system, duration=0.1, control=fails)
    assert trajectory.status == "failed"
    assert "the controller raised RuntimeError: sensor lost" in trajectory.message


def test_an_exception_from_outside_leaves_a_finished_file(free_block_system, tmp_path, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)

    def progress(t):
        if t > 0.02:
            raise ValueError("window closed")

    path = tmp_path / "run.h5"
    with pytest.raises(ValueError, match="window closed"):
        ma.simulate(free_block_system, duration=1.0, output_step=1e-3, out=path, progress=progress)
    kept = load_trajectory(path)
    assert kept.status == "failed" and "window closed" in kept.message
    assert kept.time[-1] > 0.015


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_a_run_uses_the_solver_of_its_system(solver):
    system = ma.compile_system(balls_on_a_line("none")).with_solver(solver)
    assert ma.simulate(system, duration=0.01).statistics["solver"] == solver


def test_a_ring_needs_two_arms():
    with refused(ModelError, "ring"):
        ring_of_arms(1)
