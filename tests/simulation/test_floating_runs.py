"""Claims about runs of robots whose base floats: momenta, free fall, energy, a dense reference."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from random_trees import draw_trees
from scipy.spatial.transform import Rotation
from tree_models import read_tree_scene
from tree_motion import dense_motion, far_apart, momenta, tree_state
from tree_scenes import DOWN, quadruped_scene, satellite_scene

import multiarm as ma
from multiarm.scene import parse_scene

METHODS = {
    "semi_implicit_euler": {"step": 2.5e-4},
    "rk4": {"step": 1e-3},
    "dopri5": {"tolerance": 1e-10},
    "dop853": {"tolerance": 1e-10},
}


def system_of(scene) -> ma.System:
    return ma.compile_system(parse_scene(scene))


def test_without_gravity_momenta_are_constant_while_the_arm_moves():
    scene = satellite_scene()
    trees, system = read_tree_scene(scene), system_of(scene)
    run = ma.simulate(system, 10.0, integrator="dop853", tolerance=1e-13, output_step=0.5)
    assert run.status == "completed", run.message
    assert np.max(np.ptp(run.joint_positions["sat"], axis=0)) > 1.0
    courses = np.array(
        [np.concatenate(momenta(trees, tree_state(run, k))[:2]) for k in range(len(run))]
    )
    assert np.max(np.abs(courses[0])) > 1.0
    # errors of the steps add up, at most as many as there are steps
    steps = run.statistics["steps"]
    np.testing.assert_allclose(courses, courses[:1].repeat(len(run), 0), atol=1e-13 * steps)
    assert np.max(run.position_drift) < 1e-13
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-11)


def test_the_centre_of_mass_falls_freely():
    scene = satellite_scene([1.0, 2.0, -9.0])
    trees = read_tree_scene(scene)
    run = ma.simulate(system_of(scene), 1.0, integrator="dop853", tolerance=1e-12)
    begin, end = (momenta(trees, tree_state(run, k)) for k in (0, -1))
    mass = sum(pin.computeTotalMass(robot.model) for robot in trees.robots.values()) + 2.0
    fallen = begin.centre + begin.linear / mass + 0.5 * np.array([1.0, 2.0, -9.0])
    np.testing.assert_allclose(end.centre, fallen, atol=1e-10)
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_agrees_with_the_finest(method):
    system = system_of(satellite_scene(DOWN))
    finest = ma.simulate(system, 0.2, integrator="dop853", tolerance=1e-13)
    run = ma.simulate(system, 0.2, integrator=method, **METHODS[method])
    assert run.status == "completed", run.message
    apart = np.max(np.abs(run.bases["sat"].position - finest.bases["sat"].position))
    turns = [Rotation.from_quat(r.bases["sat"].quaternion_xyzw) for r in (run, finest)]
    apart = max(apart, np.max((turns[0] * turns[1].inv()).magnitude()))
    # of order 1: half the step times acceleration and duration
    assert apart < (0.5 * 2.5e-4 * 10.0 * 0.2 if method == "semi_implicit_euler" else 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_motion_is_that_of_the_dense_reference(seed, tmp_path):
    rng = np.random.default_rng(seed)
    scene, trees, state, torques = draw_trees("floating_bases", rng, tmp_path)
    run = ma.simulate(system_of(scene), 0.05, integrator="dop853", tolerance=1e-11)
    assert run.status == "completed", run.message
    # errors of the reference, whose gaps are not closed again: its tolerance times the condition
    assert far_apart(tree_state(run, -1), dense_motion(trees, state, torques, 0.05)) < 2e-8


def test_a_stepper_and_a_file_have_the_bases(tmp_path):
    system = system_of(satellite_scene(DOWN))
    stepper = ma.Stepper(system, accuracy=1e-8)
    state = stepper.advance(0.02, torques={"sat": np.ones(6)})
    run = ma.simulate(
        system.with_control(lambda t, _: {"sat": np.ones(6)}), 0.02, accuracy=1e-8, output_step=0.01
    )
    base = run.bases["sat"]
    np.testing.assert_allclose(state.bases["sat"].position, base.position[-1], atol=1e-9)
    np.testing.assert_allclose(state.bases["sat"].twist, base.twist[-1], atol=1e-8)
    run.save(tmp_path / "run.h5")
    stored = ma.load_trajectory(tmp_path / "run.h5").bases["sat"]
    for part in ("position", "quaternion_xyzw", "twist"):
        np.testing.assert_array_equal(getattr(stored, part), getattr(base, part))


def test_a_law_that_writes_torques_of_all_joints_does_not_drive_the_base():
    scene = satellite_scene(control={"kind": "joint_pd", "stiffness": 50.0, "damping": 5.0})
    trees = read_tree_scene(scene)
    run = ma.simulate(system_of(scene), 0.5, integrator="dop853", tolerance=1e-12)
    begin, end = (np.concatenate(momenta(trees, tree_state(run, k))[:2]) for k in (0, -1))
    np.testing.assert_allclose(end, begin, atol=1e-11)


def test_joint_stops_and_friction_count_the_joints_after_the_base():
    ends = {"range": {"sat": {"elbow_joint": [1.19, 1.21]}}}
    friction = {"model": "set_valued", "torque": {"sat": {"wrist_3_joint": 50.0}}}
    effects = {"joint_limits": ends, "joint_friction": friction}
    scene = satellite_scene(effects=effects)
    trees = read_tree_scene(scene)
    run = ma.simulate(system_of(scene), 0.5, accuracy=1e-7)
    assert run.status == "completed", run.message
    q = run.joint_positions["sat"]
    assert np.max(q[:, 2]) < 1.21 + 1e-9 and np.min(q[:, 2]) > 1.19 - 1e-9
    assert any(event.get("joint") == "elbow_joint" for event in run.events)
    assert np.max(np.abs(np.diff(run.joint_positions["sat"][-10:, 5]))) < 1e-9  # it sticks
    begin, end = (np.concatenate(momenta(trees, tree_state(run, k))[:2]) for k in (0, -1))
    np.testing.assert_allclose(end, begin, atol=1e-6)


@pytest.mark.slow
def test_a_quadruped_lands_on_its_feet_and_stands():
    """It falls freely until all feet touch; standing, they carry its weight, within friction."""
    drop = 0.1  # [m]
    scene = quadruped_scene(drop)
    system = system_of(scene)
    run = ma.simulate(system, 1.0, accuracy=1e-6)
    assert run.status == "completed", run.message
    touches = [event for event in run.events if event["kind"] == "touches"]
    feet = {"solo/fl-world", "solo/fr-world", "solo/hl-world", "solo/hr-world"}
    assert {event["arm"] for event in touches} == feet
    assert touches[0]["time"] == pytest.approx(np.sqrt(2.0 * drop / 9.81), abs=1e-6)
    mass = pin.computeTotalMass(read_tree_scene(scene).robots["solo"].model) + 0.5
    assert np.max(np.abs(run.bases["solo"].twist[-1])) < 1e-3
    total = sum(run.wrenches[foot][-1, :3] for foot in feet)  # on the world
    np.testing.assert_allclose(total, [0.0, 0.0, -9.81 * mass], atol=1e-2 * mass)
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-6)
