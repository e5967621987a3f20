"""Claims about the recorded wrenches and tips: Newton and Euler, Pinocchio, finite differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from event_scenes import (
    AS_WRITTEN,
    AWAY,
    AWAY_HEIGHT,
    GRAVITY,
    arm,
    ball,
    ball_on_plate,
    box,
    on_floor,
    scene,
)
from mechanics import state_at, two_arm_block, ur5_pair
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.results.contact_states import ContactState

STEP = 5e-4  # [s] between samples
ACCURACY = 1e-10
PUSH = {"on": "object", "force": [3.0, -2.0, 5.0], "torque": [0.3, 0.2, -0.1], "axes": "world"}
# Weights of the derivative by five samples; its error is STEP**4 / 30 of the fifth derivative.
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0


def derivative(values):
    """Of samples 0, 1, ...: at all but the first and last two."""
    return sum(w * values[k : len(values) - 4 + k] for k, w in enumerate(_FIRST)) / STEP


def swinging(**more):
    return ur5_pair({"kind": "weld"}, {"kind": "ball"}, **more)


def sliding():
    return on_floor(box(twist=[1.0, 0.3, 0, 0, 0, 0.2]), mu=0.3)


def ball_on_a_spring():
    soft = {"contact_compliance": {"stiffness": 1e3, "damping": 3.0}}
    plate = arm("z", mass=2.0, velocity=[0.3])
    return ball_on_plate(plate, ball(mass=2.0), effects=soft)


RUNS = {
    "compiled": lambda: (swinging(), {"arms": "compiled"}),
    "pinocchio": lambda: (swinging(), {"arms": "pinocchio"}),
    "dense": lambda: (swinging(run={"solver": "dense"}), {}),
    "fingertips": lambda: (two_arm_block(), {}),
    "pushed": lambda: (swinging(effects={"external_wrenches": [PUSH]}), {}),
    "sliding": lambda: (sliding(), {}),
    "on a spring": lambda: (ball_on_a_spring(), {}),
}


@pytest.fixture(scope="module", params=RUNS)
def case(request):
    """Name, system, run of 40 steps."""
    written, options = RUNS[request.param]()
    system = ma.compile_system(written, **options)
    run = ma.simulate(system, 40 * STEP, accuracy=ACCURACY, certificate=False, output_step=STEP)
    assert run.status == "completed"
    return request.param, system, run


def test_wrenches_and_weight_are_the_rates_of_the_momenta(case):
    name, system, run = case
    body, R = system.scene.object, Rotation.from_quat(run.object_quaternion_xyzw)
    omega = R.inv().apply(run.object_twist[:, 3:].copy())
    spin = R.apply(omega @ body.inertia_matrix())
    momentum = np.hstack([body.mass * run.object_twist[:, :3], spin])
    total = sum(run.wrenches.values())
    total = total + np.append(body.mass * np.array(system.scene.gravity), np.zeros(3))
    if name == "pushed":
        total = total + [*PUSH["force"], *PUSH["torque"]]
    scale = max(np.abs(w).max() for w in run.wrenches.values())
    assert scale > 1.0
    np.testing.assert_allclose(derivative(momentum), total[2:-2], atol=1e-6 * scale, rtol=0.0)


def test_wrenches_are_those_of_evaluations(case):
    _, system, run = case
    for k in (0, 7, 40):
        ev = ma.evaluate(system, run.time[k], state_at(system, run, k))
        assert list(ev.wrenches) == list(run.wrenches)
        for owner, wrench in ev.wrenches.items():
            scale = max(1.0, np.abs(wrench).max())
            np.testing.assert_allclose(run.wrenches[owner][k], wrench, atol=1e-7 * scale)


def test_tips_are_those_of_pinocchio(case):
    _, system, run = case
    for arm_name, own in system.arms.items():
        model, data, tip = own.model, own.model.createData(), own.tip.frame_id
        for k in (0, 19, 40):
            q = own.configuration(run.joint_positions[arm_name][k])
            v = run.joint_velocities[arm_name][k].copy()
            pin.forwardKinematics(model, data, q, v)
            pose = pin.updateFramePlacement(model, data, tip)
            axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            twist = pin.getFrameVelocity(model, data, tip, axes).vector
            turned = Rotation.from_quat(run.tip_quaternions_xyzw[arm_name][k]).as_matrix()
            np.testing.assert_allclose(run.tip_positions[arm_name][k], pose.translation, atol=1e-12)
            np.testing.assert_allclose(turned, pose.rotation, atol=1e-12)
            np.testing.assert_allclose(run.tip_twists[arm_name][k], twist, atol=1e-11)


def test_tip_twists_are_the_rates_of_tip_poses(case):
    _, system, run = case
    for arm_name in system.arm_names:
        quaternion, twist = run.tip_quaternions_xyzw[arm_name], run.tip_twists[arm_name][2:-2]
        np.testing.assert_allclose(derivative(run.tip_positions[arm_name]), twist[:, :3], atol=1e-7)
        # q' = (omega, 0) q / 2, of quaternions without jumps of the sign
        omega_q = np.column_stack([twist[:, 3:], np.zeros(len(twist))])
        rate = 0.5 * np.array(
            [_product(a, b) for a, b in zip(omega_q, quaternion[2:-2], strict=True)]
        )
        np.testing.assert_allclose(derivative(quaternion), rate, atol=1e-7)


def _product(p, q):
    (a, d), (b, e) = (p[:3], p[3]), (q[:3], q[3])
    return np.append(d * b + e * a + np.cross(a, b), d * e - a @ b)


def test_a_sliding_box_is_carried_and_braked_by_the_floor():
    system = ma.compile_system(sliding())
    run = ma.simulate(system, 0.02, accuracy=1e-8, certificate=False)
    assert np.all((run.contact_states["floor"] == ContactState.SLIDING).sum(axis=1) == 4)
    weight = 2.0 * GRAVITY
    np.testing.assert_allclose(run.wrenches["floor"][:, 2], weight, rtol=1e-9)
    drag = np.linalg.norm(run.wrenches["floor"][:, :2], axis=1)
    assert np.all(drag < 0.3 * weight * (1 + 1e-9)) and np.all(drag > 0.29 * weight)
    np.testing.assert_array_equal(run.wrenches["away"], 0.0)


def test_the_wrench_jumps_where_a_ball_lands():
    system = ma.compile_system(on_floor(ball(height=0.01, mass=3.0)))
    run = ma.simulate(system, 0.1, accuracy=1e-8, certificate=False)
    (landing,) = (e["time"] for e in run.events if e["kind"] == "touches")
    before, after = run.time < landing, run.time > landing
    assert before.any() and after.any()
    np.testing.assert_array_equal(run.wrenches["floor"][before], 0.0)
    np.testing.assert_allclose(
        run.wrenches["floor"][after, :3], [[0.0, 0.0, 3.0 * GRAVITY]] * after.sum(), atol=1e-7
    )


def test_quaternions_of_a_turning_tip_do_not_jump():
    speed, count = 40.0, 450  # [rad/s], to 9 rad, where w < 0
    turning = arm("Z", velocity=[speed], base={"xyz": [0, 0, AWAY_HEIGHT]})
    floor = {"unilateral_contacts": AS_WRITTEN, "floor": {}}
    system = ma.compile_system(scene(box(), {"hand": turning}, {"hand": [AWAY]}, floor))
    settings = {"certificate": False, "output_step": STEP}
    run = ma.simulate(system, count * STEP, accuracy=1e-8, **settings)
    angle = speed * run.time
    expected = np.column_stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)])
    assert expected[:, 3].min() < -0.9
    np.testing.assert_allclose(run.tip_quaternions_xyzw["hand"], expected, atol=1e-7)
    again = ma.simulate(system, count * STEP, accuracy=1e-8, **settings)
    np.testing.assert_array_equal(
        again.tip_quaternions_xyzw["hand"], run.tip_quaternions_xyzw["hand"]
    )
