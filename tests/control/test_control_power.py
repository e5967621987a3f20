"""Claims about the power of the control on each arm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import over_floor, random_state, ur5_pair
from scipy.integrate import cumulative_simpson

import multiarm as ma

WELD_AND_BALL = {"kind": "weld"}, {"kind": "ball"}
SWING = {
    "kind": "harmonic",
    "frequency": 2.0,
    "amplitude": {"left": 30.0, "right": [5.0, 20.0, 10.0, 0.0, 3.0, 1.0]},
    "hold": False,
}
# the drives' limits and lag come between the control and the joints, and others do work, too
EFFECTS = {
    "torque_limits": {"left": 25.0},
    "actuator_lag": {"time_constant": 0.02},
    "joint_damping": 2.0,
    "drag": {"linear": 5.0},
}
RUN = {"duration": 0.5, "output_step": 1e-3, "accuracy": 1e-9, "certificate": False}


def power_of(torques: dict, velocities: dict) -> dict:
    return {arm: np.sum(torques[arm] * velocities[arm], axis=-1) for arm in torques}


@pytest.mark.parametrize("arms", ["compiled", "pinocchio"])
def test_the_integral_of_the_power_is_the_work_of_the_control(arms):
    """That work is what the energy balance counts beyond the works of the effects."""
    scene = ur5_pair(*WELD_AND_BALL, control=SWING, effects=EFFECTS)
    run = ma.simulate(ma.compile_system(scene, arms=arms), **RUN)
    work = run.work - sum(run.effect_works.values())
    assert np.max(np.abs(run.energy_balance)) < 1e-6 < 1.0 < np.max(np.abs(work))
    integral = cumulative_simpson(sum(run.control_power.values()), x=run.time, initial=0.0)
    # steps end at the kinks of a saturated drive, samples do not
    np.testing.assert_allclose(integral, work, atol=1e-4 * np.max(np.abs(work)))


def test_the_power_of_an_arm_is_that_of_its_own_drives():
    system = ma.compile_system(ur5_pair(*WELD_AND_BALL, control=SWING, effects=EFFECTS))
    run = ma.simulate(system, **{**RUN, "duration": 0.1})
    wanted = power_of(run.joint_torques, run.joint_velocities)
    assert list(run.control_power) == ["left", "right"]
    for arm, power in run.control_power.items():
        np.testing.assert_allclose(power, wanted[arm], rtol=1e-12, atol=1e-12)
        assert np.max(np.abs(power)) > 0.1


def test_an_evaluation_has_the_power_at_its_state():
    system = ma.compile_system(ur5_pair(*WELD_AND_BALL, control=SWING))
    state = random_state(system, np.random.default_rng(3))
    evaluation = ma.evaluate(system, 0.1, state)
    wanted = power_of(evaluation.joint_torques, state.joint_velocities)
    assert evaluation.control_power == pytest.approx(wanted, rel=1e-12)


def test_without_control_there_is_no_power(tmp_path):
    system = ma.compile_system(ur5_pair(*WELD_AND_BALL, effects={"joint_damping": 2.0}))
    assert ma.evaluate(system).control_power == {}
    run = ma.simulate(system, duration=0.01)
    assert run.control_power == {}
    assert not any("control_power" in name for name in run.channels)
    assert ma.load_trajectory(run.save(tmp_path / "run.h5")).control_power == {}


def test_open_contacts_and_stored_runs_have_it_too(tmp_path):
    scene = over_floor(0.01).scene.replace(control={"kind": "constant", "torques": {"arm": 1.0}})
    run = ma.simulate(ma.compile_system(scene), duration=0.1)
    stored = ma.load_trajectory(run.save(tmp_path / "run.h5"))
    wanted = power_of(stored.joint_torques, stored.joint_velocities)
    assert list(stored.control_power) == ["arm"]
    for arm, power in stored.control_power.items():
        np.testing.assert_allclose(power, wanted[arm], rtol=1e-12, atol=1e-12)
    assert np.max(np.abs(stored.energy_balance)) < 1e-5


def test_held_torques_of_a_stepper_have_their_power():
    system = ma.compile_system(ur5_pair(*WELD_AND_BALL))
    stepper = ma.Stepper(system, record=True)
    for k in range(20):
        stepper.advance(1e-3, torques={"left": np.full(6, 10.0 * math.sin(k))})
    run = stepper.trajectory()
    wanted = power_of(run.joint_torques, run.joint_velocities)
    for arm, power in run.control_power.items():
        np.testing.assert_allclose(power, wanted[arm], rtol=1e-12, atol=1e-12)
    assert np.max(np.abs(run.control_power["left"])) > 0.0
