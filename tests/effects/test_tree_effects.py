"""Claims about effects on robots with several tips: loads, drives, damping by joint.

Oracle: the same generalised forces, from Pinocchio, as torques of the dense reference.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from random_trees import draw_moving_trees, draw_trees
from tree_oracle import solve_minimal

import multiarm as ma
from multiarm.scene import parse_scene

BACKENDS = ("pinocchio", "compiled")


def accelerations_with(scene, effects, backend="pinocchio"):
    scene = {**scene, "effects": effects, "run": {"arms": backend}}
    return ma.evaluate(ma.compile_system(parse_scene(scene)))


def assert_accelerations(ev, solution) -> None:
    size = max(np.max(np.abs(a)) for a in solution.joint_accelerations.values())
    for name, expected in solution.joint_accelerations.items():
        np.testing.assert_allclose(ev.joint_accelerations[name], expected, atol=1e-9 * size)


def torques_of_wrench(trees, state, robot: str, link: str, point, wrench) -> np.ndarray:
    """``J^T w`` (n,) of a wrench at a point of a link, world axes."""
    of_robot, q = trees.robots[robot], state.joint_positions[robot]
    model = of_robot.model.copy()
    end = of_robot.links[link].at(pin.SE3(np.eye(3), np.array(point)))
    frame = pin.Frame("point", end.joint, end.placement, pin.FrameType.OP_FRAME)
    at, axes = model.addFrame(frame, False), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    return pin.computeFrameJacobian(model, model.createData(), q, at, axes).T @ wrench


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("family", ["several_tips", "moving_bases", "real_robots"])
def test_a_wrench_on_a_link_moves_the_joints_that_carry_it(family, backend, tmp_path):
    """Every link of a robot, also those on branches that carry no tip of their own."""
    rng = np.random.default_rng(4)
    drawn = draw_trees(family, rng, tmp_path)
    robot = list(drawn.trees.robots)[-1 if family == "moving_bases" else 0]
    for link in rng.choice(list(drawn.trees.robots[robot].links), 3, replace=False).tolist():
        wrench, point = rng.uniform(-5.0, 5.0, 6), rng.uniform(-0.2, 0.2, 3)
        load = {
            "on": f"{robot}/{link}", "force": wrench[:3].tolist(), "torque": wrench[3:].tolist(),
            "at": point.tolist(),
        }  # fmt: skip
        ev = accelerations_with(drawn.scene, {"external_wrenches": [load]}, backend)
        more = torques_of_wrench(drawn.trees, drawn.state, robot, link, point, wrench)
        torques = {**drawn.torques, robot: drawn.torques[robot] + more}
        assert_accelerations(ev, solve_minimal(drawn.trees, drawn.state, torques))


def test_damping_and_friction_act_on_every_joint_and_limits_on_every_drive(tmp_path):
    drawn = draw_trees("mimic_joints", np.random.default_rng(4), tmp_path)
    rates = drawn.state.joint_velocities
    damped = accelerations_with(drawn.scene, {"joint_damping": 0.7})
    torques = {name: drawn.torques[name] - 0.7 * rates[name] for name in rates}
    assert_accelerations(damped, solve_minimal(drawn.trees, drawn.state, torques))
    smooth = {"torque": {"helper": 0.5}, "model": "smooth", "speed": 0.1}
    rubbing = accelerations_with(drawn.scene, {"joint_friction": smooth})
    torques = dict(drawn.torques)
    torques["helper"] = torques["helper"] - 0.5 * np.tanh(rates["helper"] / 0.1)
    assert_accelerations(rubbing, solve_minimal(drawn.trees, drawn.state, torques))
    limited = accelerations_with(drawn.scene, {"torque_limits": 0.3})
    torques = {name: np.clip(row, -0.3, 0.3) for name, row in drawn.torques.items()}
    assert_accelerations(limited, solve_minimal(drawn.trees, drawn.state, torques))
    for name, row in torques.items():
        np.testing.assert_array_equal(limited.joint_torques[name], row)


def test_the_work_of_effects_closes_the_balance(tmp_path):
    drawn = draw_moving_trees("moving_bases", np.random.default_rng(8), tmp_path)
    robot = drawn.trees.robots["cart"]
    load = {
        "on": f"cart/{robot.tips['tip_0']}",
        "force": [30.0, -20.0, 10.0],
        "at": [0.1, 0.0, 0.0],
    }
    effects = {
        "external_wrenches": [{**load, "sinusoid": {"frequency": 4.0}}],
        "joint_damping": 0.4,
        "torque_limits": 1.0,
        "actuator_lag": {"time_constant": 0.02},
    }
    scene = {**drawn.scene, "effects": effects}
    run = ma.simulate(
        ma.compile_system(parse_scene(scene)), 0.05, integrator="dop853", tolerance=1e-11
    )
    assert run.status == "completed", run.message
    assert set(run.effect_works) == {"external_wrenches", "joint_damping"}
    assert all(np.ptp(work) > 1e-4 for work in run.effect_works.values())
    assert np.max(np.abs(run.energy_balance)) < 1e-9 * np.max(run.kinetic_energy)
