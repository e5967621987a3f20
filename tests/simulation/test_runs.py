"""Claims about whole runs: exactness, energy, samples, endings."""

from __future__ import annotations

import gc
import math
import signal
import threading
import tracemalloc

import numpy as np
import pytest
from mechanics import (
    panda_trio,
    plain_system,
    planar_pair,
    project_velocity,
    random_state,
    two_arm_block,
    ur5_pair,
)
from refusals import refused
from repository import SCENES, WORKED
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import ControlError, ModelError, SceneError, TrajectoryError
from multiarm.integration.methods import stepping_of
from multiarm.problems import ring_of_arms
from multiarm.tableaus import METHODS

# --- exactness -----------------------------------------------------------------------------------


def pose_error(first, second, k=-1):
    """Worst of object position [m], object angle [rad] and joint positions [rad] at sample k."""
    turn = Rotation.from_quat(first.object_quaternion_xyzw[k]).inv() * Rotation.from_quat(
        second.object_quaternion_xyzw[k]
    )
    joints = [
        np.max(np.abs(first.joint_positions[a][k] - second.joint_positions[a][k]))
        for a in first.arm_names
    ]
    shift = np.max(np.abs(first.object_position[k] - second.object_position[k]))
    return max(shift, turn.magnitude(), *joints)


def test_block_of_the_worked_example_is_where_it_was_computed_to_be(free_block_system):
    expected = WORKED["two_arm_block_system"]["expected"]["zero_torque_x_o_after_0p3s"]
    for run in (
        {"integrator": "rk4", "step": 5e-4, "stabilization": "none"},
        {"integrator": "rk4", "step": 5e-4, "stabilization": "projection"},
        {"accuracy": 1e-9},
    ):
        trajectory = ma.simulate(free_block_system, duration=0.3, **run)
        np.testing.assert_allclose(trajectory.object_position[-1], expected, atol=5e-9)


def test_energy_drift_of_the_worked_example_is_as_measured(free_block_system):
    """2.8e-7, 3.8e-8, 3.0e-9 J for three steps of RK4 without stabilisation."""
    found = []
    for h in (2e-3, 1e-3, 5e-4):
        run = {"integrator": "rk4", "step": h, "stabilization": "none"}
        energy = ma.simulate(free_block_system, duration=0.3, **run).energy
        found.append(abs(energy[-1] - energy[0]))
    np.testing.assert_allclose(found, [2.8e-7, 3.8e-8, 3.0e-9], rtol=0.03)


EXAMPLES = {
    "two_ur5_box": lambda: ma.load_scene(SCENES / "two_ur5_box.yaml"),
    "three_panda_plate": lambda: ma.load_scene(SCENES / "three_panda_plate.yaml"),
    "corner_grippers_block": lambda: ma.load_scene(SCENES / "corner_grippers_block.yaml"),
    "ring_of_arms": lambda: ring_of_arms(3, "ball"),
    "worked_example": lambda: two_arm_block(),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_run_is_as_accurate_as_asked(name):
    """Against a much tighter run, at every sample."""
    system = ma.compile_system(EXAMPLES[name]())
    run = {"duration": 0.5, "output_step": 0.05}
    tight = ma.simulate(system, integrator="dop853", tolerance=1e-12, **run)
    for accuracy in (1e-3, 1e-6, 1e-9):
        asked = ma.simulate(system, accuracy=accuracy, **run)
        assert asked.status == tight.status == "completed"
        assert max(pose_error(asked, tight, k) for k in range(len(asked))) <= accuracy


def test_harmonic_run_equals_scipys_dop853_on_the_evaluation():
    """An integrator that shares nothing with ours but multiarm.evaluate."""
    system = ma.compile_system(ring_of_arms(2, "weld", frequency=3.0))
    start = system.initial_state()
    base = Rotation.from_quat(start.object_quaternion_xyzw)

    def state_of(y):
        turn = Rotation.from_quat(y[3:7] / np.linalg.norm(y[3:7]))
        n = system.model.layout.rate_count
        split = system.model.layout.split_joints
        return system.state(
            y[:3], turn.as_quat(), split(y[7 : 7 + n]), y[7 + n : 13 + n], split(y[13 + n :]),
        )  # fmt: skip

    def rate(t, y):
        state = state_of(y)
        ev = ma.evaluate(system, t, state)
        x, w, spin = y[3:6], y[6], state.object_twist[3:]
        turn = 0.5 * np.concatenate([w * spin + np.cross(spin, x), [-x @ spin]])  # world axes
        a_j = np.concatenate(list(ev.joint_accelerations.values()))
        return np.concatenate(
            [state.object_twist[:3], turn, state.velocity[6:], ev.object_acceleration, a_j]
        )

    y0 = np.concatenate([start.position[:3], base.as_quat(), start.position[7:], start.velocity])
    exact = solve_ivp(rate, (0, 0.2), y0, "DOP853", rtol=1e-11, atol=1e-12)
    for stabilization in ("projection", "none"):
        found = ma.simulate(system, duration=0.2, accuracy=1e-9, stabilization=stabilization)
        end = state_of(exact.y[:, -1])
        np.testing.assert_allclose(found.object_position[-1], end.object_position, atol=1e-8)
        np.testing.assert_allclose(found.object_twist[-1], end.object_twist, atol=1e-8)
        for name in system.arm_names:
            np.testing.assert_allclose(
                found.joint_positions[name][-1], end.joint_positions[name], atol=1e-8
            )
            np.testing.assert_allclose(
                found.joint_velocities[name][-1], end.joint_velocities[name], atol=1e-8
            )


@pytest.mark.parametrize("name", EXAMPLES)
def test_energy_balances_with_the_work_of_control_and_damping(name):
    scene = EXAMPLES[name]().replace(effects={"joint_damping": 2.0})
    trajectory = ma.simulate(ma.compile_system(scene), duration=0.4, accuracy=1e-9)
    exchanged = np.ptp(trajectory.work) + np.ptp(trajectory.kinetic_energy)
    assert exchanged > 1e-3
    np.testing.assert_allclose(trajectory.energy_balance, 0.0, atol=1e-6 * max(1.0, exchanged))


def test_damping_takes_energy_out_and_nothing_else_does():
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    free = ma.simulate(ma.compile_system(scene), duration=0.5, accuracy=1e-8)
    np.testing.assert_allclose(free.energy, free.energy[0], atol=1e-5)
    np.testing.assert_array_equal(free.work, 0.0)
    damped = ma.simulate(
        ma.compile_system(scene.replace(effects={"joint_damping": 5.0})),
        duration=0.5,
        accuracy=1e-8,
    )
    assert np.all(np.diff(damped.energy) <= 1e-9) and damped.energy[-1] < damped.energy[0] - 0.1
    np.testing.assert_allclose(damped.work, damped.energy - damped.energy[0], atol=1e-5)


def test_energy_is_that_of_all_bodies(block_system, rng):
    """Kinetic energy against 1/2 v^T M v, potential energy against masses and heights."""
    state = project_velocity(block_system, random_state(block_system, rng, turn=0.0))
    trajectory = ma.simulate(block_system, duration=1e-3, integrator="rk4", step=1e-3, state=state)
    M, *_ = plain_system(block_system, state)
    kinetic = 0.5 * state.velocity @ M @ state.velocity
    assert trajectory.kinetic_energy[0] == pytest.approx(kinetic, rel=1e-10)
    # gravity's work on a displacement: the potential falls by h^T dq along it
    h = 1e-5
    moved = state.copy()
    moved.position[:3] += [0, 0, h]
    shifted = ma.simulate(
        block_system, 1e-3, integrator="rk4", step=1e-3, state=moved, stabilization="none"
    )
    gained = shifted.potential_energy[0] - trajectory.potential_energy[0]
    assert gained == pytest.approx(20.0 * 9.81 * h, rel=1e-6)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_solvers_move_the_scene_alike(free_block_system, solver):
    run = {"duration": 0.05, "integrator": "rk4", "step": 1e-3}
    expected = ma.simulate(free_block_system, **run)
    found = ma.simulate(free_block_system, solver=solver, **run)
    assert found.statistics["solver"] == solver
    np.testing.assert_allclose(found.object_position, expected.object_position, atol=1e-12)
    np.testing.assert_allclose(found.object_twist, expected.object_twist, atol=1e-10)


def test_arms_in_several_pinocchio_models_move_as_in_one():
    """Nine arms are two groups; a ring of arms is symmetric whatever the grouping."""
    system = ma.compile_system(
        ring_of_arms(9, "ball").replace(control={"kind": "gravity_compensation"})
    )
    trajectory = ma.simulate(system, duration=0.1, integrator="rk4", step=5e-3)
    np.testing.assert_allclose(trajectory.object_twist, 0.0, atol=1e-6)
    first = trajectory.joint_torques["arm0"][0]
    for name in system.arm_names:
        np.testing.assert_allclose(trajectory.joint_torques[name][0], first, atol=1e-6)


def test_symmetric_arms_move_symmetrically():
    trajectory = ma.simulate(
        ma.compile_system(panda_trio({"kind": "ball"}, object={
            "shape": {"cylinder": {"radius": 0.4, "height": 0.04}}, "mass": 6.0,
            "pose": {"xyz": [0, 0, 0.5]}})),
        duration=0.2, accuracy=1e-8,
    )  # fmt: skip
    np.testing.assert_allclose(trajectory.object_position[:, :2], 0.0, atol=1e-8)
    east = trajectory.joint_positions["east"]
    assert np.ptp(east) > 1e-3
    for name in trajectory.arm_names:
        np.testing.assert_allclose(trajectory.joint_positions[name], east, atol=1e-7)


# --- samples -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("duration", "step", "expected"),
    [
        (0.1, 0.02, [0, 0.02, 0.04, 0.06, 0.08, 0.1]),
        (0.1, 0.03, [0, 0.03, 0.06, 0.09, 0.1]),
        (0.05, 0.2, [0, 0.05]),
        (0.3, 0.1, [0, 0.1, 0.2, 0.3]),
    ],
)
@pytest.mark.parametrize("run", [{"accuracy": 1e-4}, {"integrator": "rk4", "step": 7e-3}])
def test_samples_come_at_the_output_step_and_at_the_end(
    free_block_system, run, duration, step, expected
):
    trajectory = ma.simulate(free_block_system, duration=duration, output_step=step, **run)
    np.testing.assert_allclose(trajectory.time, expected, atol=1e-15)
    assert trajectory.time[-1] == duration


def test_samples_tell_the_forces_of_their_own_state(block_system):
    """Every sample's torques, contact forces and drift are those of an evaluation there."""
    run = {"duration": 0.1, "output_step": 0.013, "accuracy": 1e-6, "stabilization": "none"}
    trajectory = ma.simulate(block_system, **run)
    for k in (0, 3, len(trajectory) - 1):
        state = block_system.state(
            trajectory.object_position[k], trajectory.object_quaternion_xyzw[k],
            {a: trajectory.joint_positions[a][k] for a in block_system.arm_names},
            trajectory.object_twist[k],
            {a: trajectory.joint_velocities[a][k] for a in block_system.arm_names},
        )  # fmt: skip
        ev = ma.evaluate(block_system, trajectory.time[k], state)
        for a in block_system.arm_names:
            np.testing.assert_allclose(
                trajectory.contact_forces[a][k], ev.contact_forces[a], rtol=1e-9, atol=1e-9
            )
            np.testing.assert_array_equal(trajectory.joint_torques[a][k], ev.joint_torques[a])
        assert trajectory.position_drift[k] == pytest.approx(ev.position_residual, abs=1e-14)
        assert trajectory.velocity_drift[k] == pytest.approx(ev.velocity_residual, abs=1e-13)


def test_many_samples_are_one_run_whatever_the_blocks(free_block_system, monkeypatch):
    run = {"duration": 0.3, "accuracy": 1e-6, "output_step": 1e-3}
    whole = ma.simulate(free_block_system, **run)
    monkeypatch.setattr("multiarm.simulation.setup.BLOCK_NUMBERS", 1)  # blocks of sixteen samples
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 10)
    pieces = ma.simulate(free_block_system, **run)
    np.testing.assert_array_equal(pieces.time, whole.time)
    np.testing.assert_array_equal(pieces.object_position, whole.object_position)
    np.testing.assert_array_equal(pieces.contact_forces["one"], whole.contact_forces["one"])


def test_runs_repeat_to_the_last_bit(free_block_system):
    run = {"duration": 0.2, "accuracy": 1e-7}
    first, second = (ma.simulate(free_block_system, **run) for _ in range(2))
    np.testing.assert_array_equal(first.object_position, second.object_position)
    np.testing.assert_array_equal(first.energy, second.energy)


def at_sample(trajectory, system, k=-1):
    """The state of a sample."""
    return system.state(
        trajectory.object_position[k], trajectory.object_quaternion_xyzw[k],
        {a: trajectory.joint_positions[a][k] for a in trajectory.arm_names},
        trajectory.object_twist[k],
        {a: trajectory.joint_velocities[a][k] for a in trajectory.arm_names},
    )  # fmt: skip


UR5_JOINTS = {"kind": "weld"}, {"kind": "ball"}
PULSE = {"on": "object", "force": [40, 0, 10], "pulse": {"begin": 0.12, "end": 0.16}}
LIFT = {
    "kind": "joint_pd", "stiffness": 800, "damping": 80, "path": [{"time": 1, "xyz": [0, 0, 0.6]}],
}  # fmt: skip


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param({}, id="autonomous"),
        pytest.param({"effects": {"external_wrenches": [PULSE]}}, id="a load in time"),
        pytest.param({"control": LIFT}, id="a path"),
        pytest.param(
            {"control": {**LIFT, "damping": 5, "sample_time": 0.005}}, id="a sampled control"
        ),
    ],
)
def test_a_run_can_go_on_from_where_another_ended(scene):
    """What acts at a time acts at that time, whenever the run begins."""
    system = ma.compile_system(ur5_pair(*UR5_JOINTS, **scene))
    run = {"accuracy": 1e-9, "output_step": 0.05}
    whole = ma.simulate(system, duration=0.2, **run)
    half = ma.simulate(system, duration=0.1, **run)
    rest = ma.simulate(system, duration=0.1, start_time=0.1, state=at_sample(half, system), **run)
    np.testing.assert_allclose(rest.time, [0.1, 0.15, 0.2], rtol=1e-15)
    assert pose_error(rest, whole) < 1e-8
    assert np.max(np.abs(rest.object_twist[-1] - whole.object_twist[-1])) < 1e-7
    assert rest.certificate["met"] and np.max(np.abs(rest.energy_balance)) < 1e-6
    assert rest.statistics["simulated_s"] == pytest.approx(0.1, rel=1e-12)


def test_samples_come_at_the_times_that_are_given(tmp_path):
    """They are those of any other run; the energy balance counts from the first one."""
    system = ma.compile_system(ur5_pair(*UR5_JOINTS, control=LIFT))
    run = {"accuracy": 1e-7}
    even = ma.simulate(system, duration=0.2, output_step=0.01, **run)
    rows = [3, 4, 11, 19]
    times = even.time[rows]
    some = ma.simulate(system, 0.2, output_times=times, out=tmp_path / "run.h5", **run)
    np.testing.assert_array_equal(some.time, times)
    np.testing.assert_array_equal(some.object_position, even.object_position[rows])
    np.testing.assert_array_equal(some.contact_forces["left"], even.contact_forces["left"][rows])
    assert some.statistics["simulated_s"] == pytest.approx(0.2) and some.certificate["met"]
    assert np.max(np.abs(some.energy_balance)) < 1e-6 < abs(some.work[0])
    assert some.summary()["energy_balance_max_J"] < 1e-6
    shorter = ma.simulate(system, output_times=list(times), start_time=0.03, **run)
    assert shorter.statistics["simulated_s"] == pytest.approx(0.16)
    np.testing.assert_array_equal(shorter.time, times)


@pytest.mark.parametrize(("start", "step"), [(1024.0, 1e-4), (2e4, 1e-3), (1e5, 1e-3)])
def test_fixed_steps_go_on_at_times_whose_rounding_is_larger_than_that_of_a_step(
    free_block_system, start, step
):
    run = ma.simulate(
        free_block_system, 50.0 * step, integrator="rk4", step=step, start_time=start,
        output_step=10.0 * step,
    )  # fmt: skip
    assert run.status == "completed", run.message
    assert run.statistics["steps"] == 50
    np.testing.assert_allclose(run.time, start + 10.0 * step * np.arange(6), rtol=1e-12)


def test_fixed_steps_that_roundings_of_the_time_swallow_are_told(free_block_system):
    run = ma.simulate(free_block_system, 0.1, integrator="rk4", step=1e-3, start_time=1e10)
    assert run.status == "failed" and "`start_time`" in run.message
    assert "`accuracy`" not in run.message  # a fixed step has none


def test_an_output_time_that_a_rounding_puts_after_the_end_is_taken_there(free_block_system):
    times = [0.0, 0.005, 0.01 + 5e-13]
    run = ma.simulate(free_block_system, 0.01, integrator="rk4", step=1e-4, output_times=times)
    assert run.status == "completed"
    np.testing.assert_array_equal(run.time, [0.0, 0.005, 0.01])


@pytest.mark.slow
def test_memory_does_not_grow_with_the_run_when_it_is_streamed(free_block_system, tmp_path):
    """Many more samples, the same peak; the samples themselves would be megabytes more."""

    def peak(duration):
        gc.collect()
        tracemalloc.start()
        trajectory = ma.simulate(
            free_block_system, duration=duration, integrator="rk4", step=1e-3, output_step=1e-3,
            stabilization="projection", out=tmp_path / f"run_{duration}.h5",
        )  # fmt: skip
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert trajectory.status == "completed"
        assert len(trajectory) == round(duration / 1e-3) + 1
        return top

    peak(0.1)
    block = 200_000 * 8
    short, long = peak(4.0), peak(14.0)
    assert long < short + block


def test_a_streamed_run_is_the_run(free_block_system, tmp_path):
    run = {"duration": 0.1, "accuracy": 1e-6}
    kept = ma.simulate(free_block_system, **run)
    streamed = ma.simulate(free_block_system, out=tmp_path / "run.h5", **run)
    loaded = ma.load_trajectory(tmp_path / "run.h5")
    for found in (streamed, loaded):
        assert found.status == "completed"
        np.testing.assert_array_equal(found.object_position, kept.object_position)
        np.testing.assert_array_equal(found.energy, kept.energy)


# --- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"accuracy": 1e-6, "step": 1e-3},
        {"step": 1e-3},
        {"integrator": "euler", "step": 1e-3},
        {"duration": -1.0},
        {"duration": math.nan},
        {"accuracy": 0.0},
        {"stabilization": "magic"},
        {"output_step": 0.0},
        {"solver": "sparse"},
        {"output_times": [0.0, 0.1], "output_step": 0.1},
        {"output_times": [0.0, 0.1, 0.05]},
        {"output_times": [0.0, math.nan]},
        {"output_times": "often"},
        {"output_times": [0.0, 0.5], "duration": 0.2},
        {"output_times": [0.1], "start_time": 0.2},
        {"start_time": math.inf},
        {"start_time": "0.1"},
        {"start_time": None, "output_times": [0.1]},
    ],
)
def test_contradicting_settings_are_refused(free_block_system, settings):
    with refused(SceneError, next(iter(settings))):
        ma.simulate(free_block_system, **settings)


def test_settings_left_out_are_the_scenes():
    run = {"duration": 0.05, "integrator": "rk4", "step": 5e-3, "output_step": 0.01,
           "stabilization": "none"}  # fmt: skip
    system = ma.compile_system(two_arm_block(run=run))
    trajectory = ma.simulate(system)
    s = trajectory.statistics
    assert (s["integrator"], s["stabilization"], s["steps"]) == ("rk4", "none", 10)
    assert len(trajectory) == 6
    changed = ma.simulate(system, accuracy=1e-5, duration=0.02)
    assert changed.statistics["accuracy"] == 1e-5 and changed.time[-1] == 0.02
    assert changed.statistics["stabilization"] == "none"


def test_statistics_count_what_was_done(free_block_system):
    run = ma.simulate(free_block_system, duration=0.1, integrator="rk4", step=1e-3)
    s = run.statistics
    assert s["steps"] == 100 and s["rejected_steps"] == 0 and s["projections"] == 100
    assert s["smallest_step_s"] == pytest.approx(1e-3) == s["largest_step_s"]
    assert s["evaluations"] >= 400
    assert s["simulated_s"] == pytest.approx(0.1)
    assert s["realtime_factor"] == pytest.approx(0.1 / s["wall_time_s"])


# --- endings -------------------------------------------------------------------------------------


def assert_usable(trajectory):
    """All that is there is finite and in order."""
    assert np.all(np.diff(trajectory.time) > 0)
    for values in (trajectory.object_position, trajectory.object_twist, trajectory.energy):
        assert len(values) == len(trajectory) and np.all(np.isfinite(values))


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
@pytest.mark.parametrize("stabilization", ["none", "feedback", "projection"])
def test_a_step_far_too_large_fails_with_a_remedy_and_finite_data(
    welded_ur5_system, integrator, stabilization
):
    trajectory = ma.simulate(
        welded_ur5_system, duration=20.0, integrator=integrator, step=0.5, output_step=0.5,
        stabilization=stabilization,
    )  # fmt: skip
    assert trajectory.status == "failed"
    assert "step" in trajectory.message and "t = " in trajectory.message
    assert trajectory.time[-1] < 20.0
    assert_usable(trajectory)


FRAGILE = {
    "node": (lambda: ur5_pair({"kind": "weld"}, {"kind": "weld"}), "node"),
    "dense": (lambda: ur5_pair({"kind": "weld"}, {"kind": "weld"}), "dense"),
    "planar": (lambda: planar_pair("planar_3r", [0.7, -1.4, 0.5], {"kind": "weld"}), "dense"),
}


@pytest.mark.parametrize("name", FRAGILE)
def test_a_failed_run_leaves_nothing_behind(name):
    """Another run on the same system is the run it would have been."""
    build, solver = FRAGILE[name]
    system = ma.compile_system(build())
    run = {
        "duration": 0.05,
        "integrator": "rk4",
        "step": 5e-3,
        "stabilization": "none",
        "solver": solver,
    }
    before = ma.simulate(system, **run)
    failed = ma.simulate(system, **{**run, "duration": 20.0, "step": 0.4, "output_step": 0.4})
    assert failed.status == "failed" and "step" in failed.message
    assert "controller" not in failed.message  # there is none
    assert_usable(failed)
    after = ma.simulate(system, **run)
    assert after.status == "completed"
    np.testing.assert_array_equal(after.object_position, before.object_position)


@pytest.mark.parametrize("name", ["dop853", "rodas5p", "variational"])
def test_numbers_left_in_the_arrays_of_a_method_do_not_matter(free_block_system, name):
    run = {"duration": 0.02, "integrator": name}
    run |= {"tolerance": 1e-8} if METHODS[name].adaptive else {"step": 1e-3}
    before = ma.simulate(free_block_system, **run)
    with free_block_system.borrow() as data:
        stepping = stepping_of(data, METHODS[name])
        for array in (entry for part in (stepping.step, *stepping.work) for entry in part):
            if isinstance(array, np.ndarray) and array.dtype == float:
                array.fill(np.nan)
    after = ma.simulate(free_block_system, **run)
    np.testing.assert_array_equal(after.object_position, before.object_position)
    np.testing.assert_array_equal(after.energy_balance, before.energy_balance)


@pytest.mark.slow
def test_arms_that_fall_into_a_singularity_are_reported():
    """A UR5 that drops a weight stretches its elbow sooner or later, or finishes: never NaN."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"})
    heavy = scene.replace(object=scene.object.model_copy(update={"mass": 500.0}))
    trajectory = ma.simulate(
        ma.compile_system(heavy), duration=3.0, accuracy=1e-4, certificate=False
    )
    assert trajectory.status in ("completed", "failed")
    if trajectory.status == "failed":
        assert "t = " in trajectory.message
    assert_usable(trajectory)


def test_a_start_far_from_the_joints_is_an_error_not_a_run(ur5_system):
    away = ur5_system.state(
        joint_positions={"left": [-0.264381, -1.509346, 1.788302, 2.862637, 0.0, 0.0]}
    )
    with refused(ModelError, "'left'"):
        ma.simulate(ur5_system, duration=0.1, state=away)


def test_a_start_that_cannot_be_evaluated_is_an_error_not_a_run(ur5_system):
    def controller(t, state):
        return {"left": np.full(6, np.nan)}

    with pytest.raises(ControlError):
        ma.simulate(ur5_system, duration=0.1, control=controller)


@pytest.mark.parametrize("source", ["controller", "progress"])
def test_an_interrupted_run_keeps_what_it_has(free_block_system, source, monkeypatch):
    """Ctrl-C while compiled code or Python runs."""
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)

    def controller(t, state):
        if source == "controller" and t >= 0.05:
            raise KeyboardInterrupt
        return {}

    def progress(t):
        if source == "progress" and t >= 0.05:
            raise KeyboardInterrupt

    trajectory = ma.simulate(
        free_block_system, duration=0.1, integrator="rk4", step=1e-3, output_step=1e-3,
        control=controller, progress=progress,
    )  # fmt: skip
    assert trajectory.status == "interrupted"
    assert "stopped by the user" in trajectory.message
    assert 0.045 < trajectory.time[-1] < 0.07
    assert_usable(trajectory)


def test_ctrl_c_always_ends_a_run(free_block_system):
    """Sent from outside at any moment, mostly while compiled code runs."""
    main = threading.main_thread().ident
    for k in range(8):
        timer = threading.Timer(0.003 * k, signal.pthread_kill, (main, signal.SIGINT))

        def send_soon(t, timer=timer):
            if timer.ident is None:  # the first word of progress: the run is under way
                timer.start()

        trajectory = ma.simulate(
            free_block_system,
            duration=60.0,
            integrator="rk4",
            step=1e-3,
            output_step=0.1,
            progress=send_soon,
        )
        timer.join()
        assert trajectory.status == "interrupted"
        assert "stopped by the user" in trajectory.message
        assert_usable(trajectory)


def test_progress_tells_the_simulated_time(free_block_system, monkeypatch):
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)
    seen = []
    ma.simulate(free_block_system, duration=0.1, accuracy=1e-5, progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 0.1 and len(seen) > 2


def test_a_file_that_cannot_be_written_is_refused_before_the_run(free_block_system, tmp_path):
    with pytest.raises(TrajectoryError):
        ma.simulate(free_block_system, duration=0.1, out=tmp_path / "nowhere" / "run.h5")


def test_a_trajectory_remembers_what_was_run(free_block_system):
    trajectory = ma.simulate(free_block_system, duration=0.01, integrator="rk4", step=1e-3)
    scene, run = trajectory.scene, trajectory.scene.run
    assert (run.duration, run.integrator, run.step, run.accuracy) == (0.01, "rk4", 1e-3, None)
    assert scene.replace(run=free_block_system.scene.run) == free_block_system.scene
    assert trajectory.arm_names == ("one", "two")
    driven = ma.simulate(free_block_system, duration=0.01, control=lambda t, state: {})
    assert trajectory.provenance["control"] == "none"
    assert driven.provenance["control"] == "python function"


@pytest.mark.parametrize(
    ("settings", "place"),
    [
        ({"duration": 0.0}, "duration"),
        ({"accuracy": 1e-6, "step": 0.1}, "run"),
        ({"stabilization": "springs"}, "stabilization.kind"),
    ],
)
def test_a_fault_of_a_setting_is_told_under_its_name(block_system, settings, place):
    with refused(ma.MultiarmError) as caught:
        ma.simulate(block_system, **settings)
    assert str(caught.value).startswith(f"{place}: ")


def test_a_run_with_a_sampled_control_may_end_before_time_zero():
    """Steps end at the samples exactly: times are compared by their magnitude."""
    sampled = {"control": {"kind": "gravity_compensation", "sample_time": 0.02}}
    system = ma.compile_system(ur5_pair(*UR5_JOINTS, **sampled))
    run = ma.simulate(system, 0.1, start_time=-10.0, accuracy=1e-6, certificate=False)
    assert run.status == "completed", run.message
    assert run.time[-1] == pytest.approx(-9.9)
