"""Claims about runs of robots with several tips, on fixed bases and on bases that move."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin
import pytest
from random_trees import FAMILIES, draw_moving_trees
from scipy.integrate import solve_ivp
from tree_models import read_tree_scene
from tree_motion import dense_motion, far_apart, momenta, tree_state
from tree_oracle import solve_minimal
from tree_scenes import cart_scene, gripper_scene

import multiarm as ma
from multiarm.errors import TrajectoryError
from multiarm.results.channels import contact_owners
from multiarm.scene import parse_scene

DURATION = 0.05  # [s]
METHODS = {
    "semi_implicit_euler": {"step": 2.5e-4},
    "rk4": {"step": 1e-3},
    "dopri5": {"tolerance": 1e-10},
    "dop853": {"tolerance": 1e-10},
}


def system_of(scene) -> ma.System:
    return ma.compile_system(parse_scene(scene))


# --- the motion ----------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_the_motion_is_that_of_the_dense_reference(family, tmp_path):
    scene, trees, state, torques = draw_moving_trees(family, np.random.default_rng(1), tmp_path)
    run = ma.simulate(system_of(scene), DURATION, integrator="dop853", tolerance=1e-11)
    assert run.status == "completed", run.message
    # errors of the reference, whose gaps are not closed again: its tolerance times the condition
    assert far_apart(tree_state(run, -1), dense_motion(trees, state, torques, DURATION)) < 2e-8


@pytest.mark.parametrize("method", METHODS)
def test_every_method_conserves_the_energy_to_its_order(method, tmp_path):
    for family in ("inner_loops", "mimic_joints", "surroundings"):
        scene = draw_moving_trees(family, np.random.default_rng(2), tmp_path).scene
        scene = {key: part for key, part in scene.items() if key != "control"}
        run = ma.simulate(system_of(scene), DURATION, integrator=method, **METHODS[method])
        assert run.status == "completed", run.message
        size = np.max(run.kinetic_energy) + np.ptp(run.potential_energy)
        bound = {"semi_implicit_euler": 2e-2, "rk4": 1e-6}.get(method, 1e-9)
        assert np.max(np.abs(run.energy_balance)) < bound * size, family
        assert np.max(run.position_drift) < 1e-12
        assert np.max(run.velocity_drift) < 1e-9
        assert np.max(run.work) == 0.0


def test_feedback_keeps_the_gaps_small(tmp_path):
    scene = draw_moving_trees("inner_loops", np.random.default_rng(2), tmp_path).scene
    run = ma.simulate(
        system_of(scene), DURATION, integrator="rk4", step=1e-3, stabilization="feedback"
    )
    assert run.status == "completed", run.message
    assert 0.0 < np.max(run.position_drift) < 1e-6


def test_a_cart_that_rolls_freely_keeps_its_momentum():
    """No drive acts on ``base_x`` and ``base_y``: the whole keeps its momentum along them."""
    scene = cart_scene()
    rng = np.random.default_rng(0)
    scene["robots"]["cart"]["velocity"] = rng.uniform(-0.5, 0.5, 16).tolist()
    torques = np.append(np.zeros(2), rng.uniform(-3.0, 3.0, 14))
    torques[3] = 320.0  # the torso carries both arms and the box
    scene["control"] = {"kind": "constant", "torques": {"cart": torques.tolist()}}
    run = ma.simulate(system_of(scene), 0.5, integrator="dop853", tolerance=1e-10)
    assert run.status == "completed", run.message
    trees = read_tree_scene(scene)
    linear = np.array([momenta(trees, tree_state(run, k)).linear for k in range(len(run))])
    assert np.max(np.abs(linear[0, :2])) > 1.0
    np.testing.assert_allclose(linear[:, :2], linear[0, :2][None].repeat(len(run), 0), atol=1e-8)
    assert np.max(np.abs(run.energy_balance)) < 1e-8


def test_a_cart_stops_at_the_end_of_its_rail():
    """Along the free ``base_y`` the impulse in the stop of ``base_x`` changes no momentum."""
    scene = cart_scene()
    scene["gravity"] = None
    scene["control"] = {"kind": "none"}
    scene["robots"]["cart"]["velocity"] = [0.5, 0.2, *[0.0] * 14]
    scene["object"]["twist"] = [0.5, 0.2, 0.0, 0.0, 0.0, 0.0]
    limits = {"range": {"cart": {"base_x": [-1.0, 0.1]}}, "restitution": 0.4}
    scene["effects"] = {"joint_limits": limits}
    system = system_of(scene)
    run = ma.simulate(system, 0.4, integrator="dop853", tolerance=1e-10)
    assert run.status == "completed", run.message
    (hit,) = [event for event in run.events if event["kind"] == "bounces"]
    assert (hit["arm"], hit["joint"]) == ("cart", "base_x")
    assert hit["time"] == pytest.approx(0.2, abs=1e-9)
    assert hit["before"]["gap_rate_m_s"] == pytest.approx(-0.5, abs=1e-9)
    assert hit["after"]["gap_rate_m_s"] == pytest.approx(0.2, abs=1e-9)
    trees = read_tree_scene(scene)
    linear = np.array([momenta(trees, tree_state(run, k)).linear for k in range(len(run))])
    np.testing.assert_allclose(linear[:, 1], linear[0, 1], rtol=1e-9)
    change = linear[-1, 0] - linear[0, 0]
    assert change == pytest.approx(-hit["after"]["impulse_N_s"], rel=1e-8)
    assert np.max(np.abs(run.energy_balance)) < 1e-8
    names = list(run.channels["arms/cart/contact_force"].labels)
    assert names == ["base_x at its lower limit", "base_x at its upper limit"]


def test_a_four_bar_gripper_is_a_crank_with_one_degree_of_freedom():
    """The fingers are parallelograms, so that all joints have the crank's angle."""
    scene = gripper_scene(0.2)
    weld = {"between": ["object", "world"], "kind": "weld", "at": scene["object"]["pose"]}
    scene["joints"] = [*scene["joints"][2:], weld]
    scene["control"] = {"kind": "constant", "torques": {"gripper": [0.04, *[0.0] * 5]}}
    trees = read_tree_scene(scene)
    run = ma.simulate(system_of(scene), 0.1, integrator="dop853", tolerance=1e-11)
    assert run.status == "completed", run.message
    model = trees.robots["gripper"].model
    data, ones = model.createData(), np.ones(6)

    def slope(_, y):
        inertia = pin.crba(model, data, y[0] * ones)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        bias = pin.nonLinearEffects(model, data, y[0] * ones, y[1] * ones)
        return [y[1], (0.04 - ones @ bias) / (ones @ inertia @ ones)]

    crank = solve_ivp(
        slope, (0.0, 0.1), [0.2, 0.0], t_eval=run.time, rtol=1e-11, atol=1e-12, method="DOP853"
    )
    angles = run.joint_positions["gripper"]
    assert np.ptp(crank.y[0]) > 0.05
    np.testing.assert_allclose(angles, crank.y[0][:, None].repeat(6, axis=1), atol=1e-9)


# --- results -------------------------------------------------------------------------------------


def test_certificates_of_random_scenes_are_true(tmp_path):
    """Every accuracy that a certificate calls met is met, by a run with much smaller tolerances."""
    accuracy = 1e-6
    for seed in range(10):
        family = list(FAMILIES)[seed % len(FAMILIES)]
        scene = draw_moving_trees(family, np.random.default_rng(10 + seed), tmp_path).scene
        system = system_of(scene)
        run = ma.simulate(system, DURATION, accuracy=accuracy)
        finer = ma.simulate(system, DURATION, integrator="dop853", tolerance=1e-12)
        assert run.certificate["met"], run.certificate["text"]
        apart = [run.object_position - finer.object_position]
        apart += [q - finer.joint_positions[name] for name, q in run.joint_positions.items()]
        assert max(np.max(np.abs(gap)) for gap in apart) < accuracy, family


def test_results_are_by_robot_and_by_connection(tmp_path):
    scene = gripper_scene()
    system = system_of(scene)
    run = ma.simulate(system, 0.02, integrator="rk4", step=1e-3, out=tmp_path / "run.h5")
    for trajectory in (run, ma.load_trajectory(tmp_path / "run.h5")):
        assert trajectory.arm_names == ("gripper",)
        connections = ["gripper/left", "gripper/right", "left_loop", "right_loop"]
        assert list(contact_owners(trajectory.channels)) == connections
        assert list(trajectory.contact_forces) == [*connections, "gripper"]
        assert list(trajectory.wrenches) == list(trajectory.tip_positions) == connections
        assert trajectory.joint_positions["gripper"].shape == (len(run), 6)
        assert trajectory.relative_motion["left_loop"].shape == (len(run), 1)
        assert trajectory.relative_motion_labels["left_loop"] == ("turn z",)
        assert trajectory.contact_states["gripper/right"].shape == (len(run), 0)
        use = trajectory.limit_use
        assert use["joint"].tolist()[0] == "gripper/left_driver_joint"
        assert use["effort"].max() > 0.0
        frame = trajectory.to_pandas()
        assert "arms/gripper/left/tip_position/x" in frame.columns
        with pytest.raises(TrajectoryError, match="gripper/right"):
            trajectory.contact_forces["gripper/middle"]
        assert set(trajectory.summary()["wrench_max"]) == set(connections)
    first = ma.evaluate(system)
    for name, wrench in first.wrenches.items():
        np.testing.assert_allclose(run.wrenches[name][0], wrench, rtol=1e-9, atol=1e-9)
        place = system.kinematics().tips[
            {"left_loop": "gripper/left_follower_end", "right_loop": "gripper/right_follower_end"}
            .get(name, name)
        ]  # fmt: skip
        np.testing.assert_allclose(run.tip_positions[name][0], place.position, atol=1e-12)
    for name, forces in first.contact_forces.items():
        np.testing.assert_allclose(run.contact_forces[name][0], forces, rtol=1e-7, atol=1e-7)


def test_channels_fill_a_row_exactly(tmp_path):
    """Objects held by the world have channels too, and the numbers after them are in place."""
    drawn = None
    rng = np.random.default_rng(0)
    while drawn is None or not any("object" in j.get("between", ()) for j in drawn.scene["joints"]):
        drawn = draw_moving_trees("surroundings", rng, tmp_path)
    scene = copy.deepcopy(drawn.scene)
    scene["object"]["shape"] = {"box": [0.1, 0.1, 0.1]}
    scene["effects"] = {"floor": {"at": {"xyz": [0.0, 0.0, -5.0]}}}
    run = ma.simulate(system_of(scene), 0.01, integrator="rk4", step=1e-3)
    assert run.status == "completed", run.message
    assert run.wrenches["object-world"].shape == (len(run), 6)
    assert run.rank[0] == solve_minimal(drawn.trees, drawn.state, drawn.torques).rank
    assert np.max(np.abs(run.energy_balance)) < 1e-6 * np.max(np.abs(run.kinetic_energy))


def test_runs_in_threads_are_those_of_one():
    system = system_of(gripper_scene())
    states = [
        system.state(joint_velocities={"gripper": speed * np.ones(6)}) for speed in (0.0, 0.1)
    ]
    alone = ma.simulate(system, 0.01, integrator="rk4", step=1e-3, state=states[1])
    many = ma.simulate_many(system, 0.01, states=states, integrator="rk4", step=1e-3)
    np.testing.assert_array_equal(
        list(many)[1].joint_positions["gripper"], alone.joint_positions["gripper"]
    )


def test_a_stepper_moves_a_robot_as_a_run_does():
    scene = gripper_scene()
    system = system_of(scene)
    run = ma.simulate(system, 0.01, integrator="rk4", step=1e-3)
    stepper = ma.Stepper(system, integrator="rk4", step=1e-3)
    torques = {"gripper": np.array(scene["control"]["torques"]["gripper"])}
    for _ in range(10):
        state = stepper.advance(1e-3, torques)
    np.testing.assert_allclose(
        state.joint_positions["gripper"], run.joint_positions["gripper"][-1], atol=1e-12
    )
    assert list(stepper.wrenches) == list(run.wrenches)
    for name, forces in stepper.contact_forces.items():
        size = max(np.max(np.abs(forces)), 1.0)
        np.testing.assert_allclose(forces, run.contact_forces[name][-1], atol=1e-8 * size)
