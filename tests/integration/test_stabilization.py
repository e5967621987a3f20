"""Claims about feedback and projection: limits, drift, and what they leave alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import data_of, plain_gaps, plain_system, project_velocity, random_state, ur5_pair
from repository import WORKED
from steps import state_of

import multiarm as ma
from multiarm.dynamics.equations import evaluate_projected, evaluate_state, keeps_factors
from multiarm.dynamics.status import OK
from multiarm.integration.projection import FEEDBACK_RATIO, project
from multiarm.problems import HARD_CASES

# Semi-implicit and explicit Euler and RK4 on phi'' + 2 a phi' + a^2 phi = 0 with step 1.
AMPLIFICATION = {
    "semi_implicit_euler": lambda a: np.array([[1 - a * a, 1 - 2 * a], [-a * a, 1 - 2 * a]]),
    "explicit_euler": lambda a: np.array([[1, 1], [-a * a, 1 - 2 * a]]),
    "rk4": lambda a: np.array([[1 - a + a**2 / 2 - a**3 / 6 + a**4 / 24]]),  # double root -a
}
# Largest a for which they stay bounded.
FEEDBACK_LIMITS = {
    "semi_implicit_euler": 2.0 * (math.sqrt(2.0) - 1.0),
    "explicit_euler": 2.0,
    "rk4": 2.785293563405282,
}


@pytest.mark.parametrize("method", FEEDBACK_LIMITS)
def test_feedback_limits_are_where_the_methods_become_unstable(method):
    expected = WORKED["baumgarte_limits"]["expected"][f"{method}_alpha_h"]
    limit = FEEDBACK_LIMITS[method]
    assert limit == pytest.approx(expected, abs=1e-9)
    radius = lambda a: np.max(np.abs(np.linalg.eigvals(AMPLIFICATION[method](a))))  # noqa: E731
    assert radius(0.999 * limit) < 1.0 < radius(1.001 * limit)
    assert 0.5 * limit > FEEDBACK_RATIO


# --- projection of velocities --------------------------------------------------------------------


@pytest.mark.slow
def test_velocity_projection_gives_the_worked_example(block_system):
    example = WORKED["velocity_projection"]
    raw, expected = np.array(example["inputs"]["raw_velocity"]), example["expected"]
    before = block_system.state(
        object_twist=raw[:6], joint_velocities={"one": raw[6:12], "two": raw[12:]}
    )
    after = project_velocity(block_system, before)
    np.testing.assert_allclose(after.velocity[:6], expected["v_o"], atol=1e-8)
    np.testing.assert_allclose(after.velocity[6:], expected["qdot"], atol=1e-8)
    np.testing.assert_array_equal(after.position, before.position)
    M, _, W, _ = plain_system(block_system, before)
    change = after.velocity - before.velocity
    energy = lambda v: 0.5 * v @ M @ v  # noqa: E731
    loss = energy(before.velocity) - energy(after.velocity)
    assert loss == pytest.approx(expected["kinetic_energy_loss"], abs=1e-8)
    assert loss == pytest.approx(energy(change), abs=1e-9)
    impulse = np.linalg.lstsq(W, M @ change, rcond=None)[0]
    np.testing.assert_allclose(-impulse, expected["impulse_mu"], atol=1e-8)


def test_projected_velocities_close_all_gap_rates_and_stay(ur5_system, rng):
    once = project_velocity(ur5_system, random_state(ur5_system, rng))
    assert ma.evaluate(ur5_system, 0.0, once).velocity_residual < 1e-13
    twice = project_velocity(ur5_system, once)
    np.testing.assert_allclose(twice.velocity, once.velocity, atol=1e-13)


@pytest.mark.parametrize("name", ["four_bar", "bricard", "two_joint_arms", "eight_welded"])
def test_an_evaluation_right_after_a_projection_is_that_of_the_state(name, rng):
    """Deficient arms keep the factors of the projection; the others are eliminated again."""
    system = ma.compile_system(HARD_CASES[name].scene())
    data, state = data_of(system), system.initial_state()
    state.velocity[:] += rng.uniform(-0.5, 0.5, state.velocity.size)
    data.set_state(0.0, state)
    assert project(data.struct, 1e-13) == OK
    assert keeps_factors(data.arrays) == (name != "eight_welded")
    results = []
    for evaluate in (evaluate_projected, evaluate_state):
        assert evaluate(data.struct, 0.0, 0.0) == OK
        results.append([*data.arrays.accelerations.a, *data.arrays.rows.force])
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("solver", ["node", "dense"])
@pytest.mark.parametrize("name", ["bricard", "eight_welded"])
def test_projection_of_a_state_beside_the_joints_leads_back_to_the_next_state_on_them(
    name, solver, rng
):
    """Newton's method in the metric of the inertia: from a distance d across the motion, it ends
    within d^2 of where it began.  Bricard's loop has a constraint that is independent of the others
    off the joints only; the direction that it binds there is that of the motion itself.
    """
    system = ma.compile_system(HARD_CASES[name].scene())
    data = data_of(system.with_solver(solver))
    on_joints = ma.simulate(system, 0.2, accuracy=1e-9, output_step=0.2, certificate=False)
    state = state_of(system, on_joints, 1)
    M, _, W, _ = plain_system(system, state)
    across = np.linalg.solve(M, W @ rng.standard_normal(W.shape[1]))
    across /= np.max(np.abs(across))
    distances, errors = np.array([1e-3, 3e-4, 1e-4]), []
    for d in distances:
        data.set_state(0.0, state.displaced(d * across))
        assert project(data.struct, 1e-13) == OK
        errors.append(np.max(np.abs(data.arrays.state.configuration - state.position)))
    assert np.all(errors < 10.0 * distances**2), errors


# --- drift ---------------------------------------------------------------------------------------


def final_drift(system, **run):
    return ma.simulate(system, duration=0.3, **run).position_drift[-1]


@pytest.mark.parametrize(
    ("feedback", "expected"),
    [(None, [4.4e-8, 2.8e-9, 1.8e-10]), (10.0, [1.3e-8, 8.4e-10, 5.3e-11])],
    ids=["none", "feedback"],
)
def test_drift_of_rk4_is_as_measured_for_the_worked_example(free_block_system, feedback, expected):
    """Two digits are given; the drift falls with order 4."""
    choice = (
        "none" if feedback is None else {"kind": "feedback", "alpha": feedback, "beta": feedback}
    )
    found = [
        final_drift(free_block_system, integrator="rk4", step=h, stabilization=choice)
        for h in (2e-3, 1e-3, 5e-4)
    ]
    np.testing.assert_allclose(found, expected, rtol=0.03)
    slopes = np.log2(np.array(found[:-1]) / found[1:])
    np.testing.assert_allclose(slopes, 4.0, atol=0.2)


@pytest.mark.parametrize(
    ("alpha", "beta", "expected"),
    [(0.0, 0.0, 4.0e-3), (5.0, 5.0, 1.2e-3), (50.0, 50.0, 8.4e-4), (500.0, 1000.0, 2.9e-5)],
)
def test_drift_of_semi_implicit_euler_is_as_measured(free_block_system, alpha, beta, expected):
    choice = {"kind": "feedback", "alpha": alpha, "beta": beta} if alpha else "none"
    found = final_drift(
        free_block_system, integrator="semi_implicit_euler", step=1e-3, stabilization=choice
    )
    assert found == pytest.approx(expected, rel=0.03)


def test_feedback_beyond_its_limit_drives_the_contacts_apart(free_block_system):
    beyond = {"kind": "feedback", "alpha": 1100.0, "beta": 1100.0}
    trajectory = ma.simulate(
        free_block_system, duration=0.3, integrator="semi_implicit_euler", step=1e-3,
        stabilization=beyond,
    )  # fmt: skip
    worst = np.max(trajectory.position_drift)
    assert trajectory.status == "failed" or worst > 1e-2
    assert np.all(np.isfinite(trajectory.object_position))


def test_feedback_closes_a_gap_critically_damped(free_block_system):
    """phi(t) = (1 + a t) exp(-a t) phi(0), gap by gap, for any motion of the arms."""
    a = 30.0
    start = free_block_system.initial_state()
    off = free_block_system.state(
        object_position=start.object_position + [1e-3, -2e-3, 1e-3], object_twist=np.zeros(6),
        joint_velocities={name: np.zeros(6) for name in start.joint_positions},
    )  # fmt: skip
    opened = plain_gaps(free_block_system, off)
    run = {
        "integrator": "dop853", "tolerance": 1e-11, "output_step": 0.02,
        "stabilization": {"kind": "feedback", "alpha": a, "beta": a},
    }  # fmt: skip
    trajectory = ma.simulate(free_block_system, duration=0.1, state=off, **run)
    t = trajectory.time
    expected = np.max(np.abs(opened)) * (1 + a * t) * np.exp(-a * t)
    np.testing.assert_allclose(trajectory.position_drift, expected, rtol=1e-6)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
def test_a_given_state_off_the_joints_is_put_on_them_and_kept_there(
    free_block_system, rng, integrator
):
    off = random_state(free_block_system, rng, turn=0.003, speed=0.2)
    trajectory = ma.simulate(
        free_block_system,
        duration=0.02,
        integrator=integrator,
        step=1e-3,
        output_step=1e-3,
        state=off,
    )
    assert np.max(np.abs(plain_gaps(free_block_system, off))) > 1e-4
    assert np.max(trajectory.position_drift) < 1e-12
    assert np.max(trajectory.velocity_drift) < 1e-12
    told = [event["text"] for event in trajectory.events if event["kind"] == "start"]
    assert any("joints moved" in text for text in told)
    assert any("velocities changed" in text and "J were lost" in text for text in told)


def test_projection_holds_the_joints_for_ten_seconds():
    """Damped, so that ten seconds are ten seconds of motion and not of chaos; between steps too."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}).replace(effects={"joint_damping": 3.0})
    trajectory = ma.simulate(
        ma.compile_system(scene), duration=10.0, accuracy=1e-4, output_step=0.0371
    )
    assert trajectory.status == "completed"
    assert np.max(trajectory.position_drift) < 1e-12
    assert np.max(trajectory.velocity_drift) < 1e-12
    assert np.ptp(trajectory.object_position[:, 2]) > 0.1  # it did move


def test_feedback_gains_are_chosen_from_the_step(free_block_system):
    h = 1e-3
    auto = ma.simulate(
        free_block_system, duration=0.05, integrator="rk4", step=h, stabilization="feedback"
    )
    gain = FEEDBACK_RATIO / h
    by_hand = ma.simulate(
        free_block_system, duration=0.05, integrator="rk4", step=h,
        stabilization={"kind": "feedback", "alpha": gain, "beta": gain},
    )  # fmt: skip
    np.testing.assert_array_equal(auto.object_position, by_hand.object_position)
