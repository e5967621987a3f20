"""Claims about sampled control: torques are computed at the samples only, and held between them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import GRAVITY, arm, ball, ball_on_plate, times
from loose_scenes import cart_with_box
from mechanics import ur5_pair
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.control.joint_pd import joint_pd
from multiarm.dynamics.arrays import ADDRESS
from multiarm.errors import ControlError, SceneError, SolverError
from multiarm.jit.pointers import address_of
from multiarm.scene import parse_scene

MASS = 5.0  # of cart and box [kg]
STIFFNESS, DAMPING = 200.0, 5.0  # [N/m], [N s/m]
SLOW = 0.05  # [s], a sample time that the damping of the loop feels
PLATE, BALL, PUSH, FREQUENCY = 2.0, 0.5, 50.0, 2.0  # [kg], [kg], [N], [Hz]


def cart(tmp_path, control=None, **more):
    """A cart with 1 m/s, as a system."""
    control = {"kind": "none"} if control is None else control
    return ma.compile_system(
        parse_scene(cart_with_box(tmp_path, {}, velocity=1.0, control=control, **more))
    )


def spring(**more):
    gains = {"stiffness": STIFFNESS, "damping": DAMPING, "gravity_compensation": False}
    return {"kind": "joint_pd", **gains, **more}


def pull(t, state):
    """The force of ``spring`` in Python."""
    x, v = state.joint_positions["cart"], state.joint_velocities["cart"]
    return {"cart": -STIFFNESS * x - DAMPING * v}


def sampled_cart(T: float, count: int, delay: bool = False):
    """Exact positions and velocities of the cart at its samples: each force acts over one T."""
    x, v, rows, forces = 0.0, 1.0, [], []
    for k in range(count + 1):
        rows.append((x, v))
        forces.append(-STIFFNESS * x - DAMPING * v)
        force = forces[max(k - 1, 0)] if delay else forces[k]
        x, v = x + T * v + 0.5 * T * T * force / MASS, v + T * force / MASS
    return np.array(rows).T


# --- the discrete loop ---------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [False, True])
@pytest.mark.parametrize(
    "method",
    [
        {"accuracy": 1e-6},
        {"integrator": "dopri5", "tolerance": 1e-3, "max_step": 0.013},
        {"integrator": "rodas5p", "tolerance": 1e-6},
        {"integrator": "rk4", "step": 0.003},
        {"integrator": "variational", "step": 0.01},
        {"accuracy": 1e-6, "stabilization": "feedback"},
    ],
    ids=lambda method: "-".join(map(str, method.values())),
)
@pytest.mark.parametrize("in_python", [False, True])
def test_a_cart_follows_the_exact_discrete_solution(tmp_path, in_python, method, delay):
    """Also where the fixed step does not divide the sample time."""
    samples = {"sample_time": SLOW, "sample_delay": delay}
    system = cart(tmp_path, None if in_python else spring(**samples))
    given = {"control": pull, **samples} if in_python else {}
    run = ma.simulate(system, 1.0, output_step=SLOW, certificate=False, **method, **given)
    assert run.status == "completed"
    x, v = sampled_cart(SLOW, 20, delay)
    np.testing.assert_allclose(run.joint_positions["cart"][:, 0], x, atol=1e-9)
    np.testing.assert_allclose(run.joint_velocities["cart"][:, 0], v, atol=1e-9)
    assert np.ptp(x) > 0.1
    assert run.statistics["control_samples"] == 21


def test_torques_are_held_and_each_is_that_of_its_sample(tmp_path):
    run = ma.simulate(cart(tmp_path, spring(sample_time=SLOW)), 0.5, output_step=SLOW / 5)
    x, v = sampled_cart(SLOW, 10)
    expected = np.repeat(-STIFFNESS * x - DAMPING * v, 5)[: len(run.time)]
    np.testing.assert_allclose(run.joint_torques["cart"][:, 0], expected, atol=1e-7)
    assert run.certificate["met"]
    assert np.abs(run.energy_balance).max() < 1e-10


@pytest.mark.parametrize("delay", [False, True])
@pytest.mark.parametrize("in_python", [False, True])
def test_near_a_state_a_sampled_control_has_the_poles_of_the_continuous_one(
    tmp_path, in_python, delay
):
    """Also in a system that borrows the data of the first call again."""
    samples = {"sample_time": SLOW, "sample_delay": delay}
    system = cart(tmp_path, None if in_python else spring(**samples))
    if in_python:
        system = system.with_control(pull, **samples)
    expected = np.roots([MASS, DAMPING, STIFFNESS])
    for _ in range(2):
        found = np.linalg.eigvals(ma.linearise(system).A)
        np.testing.assert_allclose(np.sort(found), np.sort(expected), rtol=1e-8)
    held = np.linalg.eigvals(ma.linearise(system, closed_loop=False).A)
    np.testing.assert_allclose(held, 0.0, atol=1e-7)


@pytest.mark.parametrize("control", ["computed_torque", "gravity_compensation"])
def test_laws_of_the_scene_are_those_of_the_state_at_each_sample(control):
    """A chain of runs with constant torques, each evaluated where the one before has ended."""
    T, count = 2e-3, 6
    own = {"kind": control}
    if control == "computed_torque":
        own["path"] = [{"time": 0.05, "xyz": [0.01, 0.02, 0.55]}]
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=own)
    continuous = ma.compile_system(scene)
    sampled = ma.compile_system(scene.replace(control={**own, "sample_time": T}), like=continuous)
    asked = {"accuracy": 1e-9, "certificate": False, "output_step": T}
    # the chain begins with a moving box
    start = ma.simulate(
        ma.compile_system(scene.replace(control="none"), like=continuous), 0.02, **asked
    )
    state = continuous.state(
        start.object_position[-1],
        start.object_quaternion_xyzw[-1],
        {a: q[-1] for a, q in start.joint_positions.items()},
        start.object_twist[-1],
        {a: v[-1] for a, v in start.joint_velocities.items()},
    )
    run = ma.simulate(sampled, count * T, state=state, **asked)
    for k in range(count):
        held = ma.evaluate(continuous, k * T, state).joint_torques
        for a, torque in held.items():
            np.testing.assert_allclose(run.joint_torques[a][k], torque, atol=1e-5)
        piece = ma.simulate(
            continuous, T, state=state, control=lambda t, state, held=held: held, **asked
        )
        state = continuous.state(
            piece.object_position[-1],
            piece.object_quaternion_xyzw[-1],
            {a: q[-1] for a, q in piece.joint_positions.items()},
            piece.object_twist[-1],
            {a: v[-1] for a, v in piece.joint_velocities.items()},
        )
        np.testing.assert_allclose(run.object_position[k + 1], state.object_position, atol=1e-9)
        np.testing.assert_allclose(run.object_twist[k + 1], state.object_twist, atol=1e-7)


def test_a_delay_shifts_the_torques_by_one_sample(ur5_system):
    """Those of the start act twice, as if it had lasted."""
    T = 0.004

    def wave(t, _state):
        return {"left": 5.0 * np.sin(200.0 * t + np.arange(6.0))}

    def earlier(t, state):
        return wave(max(t - T, 0.0), state)

    asked = {"duration": 0.05, "sample_time": T, "certificate": False, "output_step": T}
    delayed = ma.simulate(ur5_system, control=wave, sample_delay=True, **asked)
    shifted = ma.simulate(ur5_system, control=earlier, **asked)
    # the times of some samples differ by a rounding
    np.testing.assert_allclose(delayed.object_twist, shifted.object_twist, atol=1e-12)
    prompt = ma.simulate(ur5_system, control=wave, **asked)
    assert np.abs(delayed.object_twist - prompt.object_twist).max() > 1e-3


# --- calls, steps, ends --------------------------------------------------------------------------


def test_python_is_asked_at_the_samples_only_and_steps_may_be_as_long(tmp_path):
    called = []

    def force(t, state):
        called.append(t)
        return pull(t, state)

    run = ma.simulate(
        cart(tmp_path), 1.0, control=force, sample_time=0.1, output_step=0.001, certificate=False
    )
    np.testing.assert_array_equal(np.unique(called), 0.1 * np.arange(11))
    assert called[-1] == 1.0 and len(called) <= 12
    # the output does not limit steps, as it does for a function that is called at any time
    assert run.statistics["steps"] < 60
    assert run.statistics["largest_step_s"] > 0.02


@pytest.mark.parametrize("method", [{"accuracy": 1e-6}, {"integrator": "rk4", "step": 0.01}])
@pytest.mark.parametrize(
    ("T", "duration"),
    # in floating point the last sample lies after the end, before it, well before it
    [(0.1, 0.3), (0.1, 0.7), (0.03, 0.33), (0.03, 0.9), (0.1, 0.65)],
)
def test_samples_that_meet_the_end_but_for_roundings_make_no_tiny_steps(
    tmp_path, T, duration, method
):
    system = cart(tmp_path, spring(sample_time=T))
    run = ma.simulate(system, duration, certificate=False, **method)
    assert run.status == "completed"
    assert run.statistics["smallest_step_s"] > 1e-4
    assert run.statistics["control_samples"] == math.floor(duration / T + 1e-9) + 1


def test_control_without_samples_calls_its_laws_and_nothing_else(tmp_path):
    free, held = cart(tmp_path, spring()), cart(tmp_path, spring(sample_time=SLOW))
    assert free.model.constants.control[:, ADDRESS].tolist() == [address_of(joint_pd)]
    assert free.model.constants.sampled.size == 0
    assert held.model.constants.sampled.tolist() == free.model.constants.control.tolist()
    assert held.model.breakpoints.size == 0


def test_an_evaluation_samples_where_it_is(tmp_path):
    """So torques of a single evaluation are those of its state, whatever was evaluated before."""
    system, free = cart(tmp_path, spring(sample_time=SLOW)), cart(tmp_path, spring())
    for x in (0.1, -0.3):
        state = system.state(joint_positions={"cart": [x]})
        found = ma.evaluate(system, 0.0, state).joint_torques["cart"]
        np.testing.assert_array_equal(found, ma.evaluate(free, 0.0, state).joint_torques["cart"])


# --- events and effects --------------------------------------------------------------------------


def shaken_by_samples(T: float, end: float):
    """Times at which the ball leaves and lands, with a push that is held over each T.

    Everything is a parabola between samples: nothing is integrated.
    """
    total, t, k = PLATE + BALL, 0.0, 0
    p = q = u = v = 0.0  # height and speed of plate and ball
    found, held = [], True
    while t < end - 1e-12:
        push, until = PUSH * math.sin(2 * math.pi * FREQUENCY * k * T), (k + 1) * T
        if held and GRAVITY + push / total < 0.0:
            found.append(t)
            held = False
        dt = until - t
        if held:
            of_plate = of_ball = push / total
        else:
            of_plate, of_ball = (push + BALL * GRAVITY) / PLATE, -GRAVITY
            a, b, c = 0.5 * (of_ball - of_plate), v - u, q - p
            roots = [r.real for r in np.roots([a, b, c]) if abs(r.imag) < 1e-12]
            hits = [r for r in roots if 1e-9 < r <= dt and 2 * a * r + b < 0.0]
            if hits:
                dt = min(hits)
        p, u = p + u * dt + 0.5 * of_plate * dt**2, u + of_plate * dt
        q, v = q + v * dt + 0.5 * of_ball * dt**2, v + of_ball * dt
        if not held and dt < until - t:
            u = v = (PLATE * u + BALL * v) / total
            found.append(t + dt)
            held = True
        t += dt
        k += int(t > until - 1e-12)
    return found, (p, q)


def shaken_plate(**control):
    shake = {"kind": "harmonic", "amplitude": {"plate": [PUSH]}, "frequency": FREQUENCY, **control}
    return ball_on_plate(arm("z", mass=PLATE), ball(mass=BALL), control=shake, name="shaken")


@pytest.mark.parametrize("method", [{"accuracy": 1e-9}, {"integrator": "rk4", "step": 0.003}])
def test_a_ball_leaves_a_shaken_plate_at_a_sample_and_lands_between_samples(method):
    T, end = 0.01, 1.4
    run = ma.simulate(
        ma.compile_system(shaken_plate(sample_time=T)), end, certificate=False, **method
    )
    assert run.status == "completed", run.message
    found, (plate, body) = shaken_by_samples(T, end)
    assert len(found) >= 4
    np.testing.assert_allclose(times(run, "lets go", "touches"), found, atol=1e-6)
    assert run.joint_positions["plate"][-1, 0] == pytest.approx(plate, abs=1e-6)
    assert run.object_position[-1, 2] - 0.05 == pytest.approx(body, abs=1e-6)


def test_a_drive_that_lags_and_saturates_gets_held_torques(tmp_path):
    """The balance of energy has the work of the torques that really act."""
    effects = {"torque_limits": {"cart": [40.0]}, "actuator_lag": 0.02, "joint_damping": 3.0}
    scene = cart_with_box(tmp_path, effects, velocity=1.0, control=spring(sample_time=SLOW))
    run = ma.simulate(ma.compile_system(parse_scene(scene)), 1.0, accuracy=1e-8)
    assert run.status == "completed" and run.certificate["met"]
    assert np.abs(run.energy_balance).max() < 1e-6


# --- many runs, files ----------------------------------------------------------------------------


def test_many_runs_give_the_same_bits(tmp_path):
    sampled = {"sample_time": SLOW, "certificate": False}
    system = cart(tmp_path)
    states = [system.state(joint_velocities={"cart": [v]}, object_twist=[v, 0, 0, 0, 0, 0])
              for v in (0.3, 0.7)]  # fmt: skip
    many = ma.simulate_many(system, 0.3, states=states, control=pull, threads=2, **sampled)
    for state, run in zip(states, many, strict=True):
        alone = ma.simulate(system, 0.3, state=state, control=pull, **sampled)
        np.testing.assert_array_equal(run.object_twist, alone.object_twist)
    driven = ma.compile_system(system.scene, pull, sample_time=SLOW, sample_delay=True)
    assert driven.model.calls_python  # so that one thread is the default
    (heavy,) = ma.simulate_many(driven, 0.3, parameters=[{"object.mass": 7.0}], certificate=False)
    assert heavy.statistics["control_samples"] == 7


def test_a_result_tells_how_its_control_was_sampled(tmp_path):
    own = cart(tmp_path, spring(sample_time=SLOW, sample_delay=True))
    run = ma.simulate(own, 0.1, certificate=False, out=tmp_path / "run.h5")
    stored = ma.load_trajectory(tmp_path / "run.h5").scene.control
    assert (stored.sample_time, stored.sample_delay) == (SLOW, True)
    run.close()
    other = ma.simulate(cart(tmp_path), 0.1, control=pull, sample_time=SLOW, certificate=False)
    assert other.provenance["sample_time"] == SLOW


# --- faults --------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.0, -1e-3, math.nan, math.inf, "1e-3", True])
def test_a_sample_time_is_a_positive_number(tmp_path, time):
    with refused(ControlError, "sample_time: "):
        ma.simulate(cart(tmp_path), 0.1, control=pull, sample_time=time)
    with refused(SceneError, "$.control.sample_time"):
        cart(tmp_path, spring(sample_time=time))


def test_samples_need_a_control_and_a_delay_needs_samples(tmp_path):
    system = cart(tmp_path)
    for call in (
        lambda **given: ma.simulate(system, 0.1, **given),
        lambda **given: ma.simulate_many(system, 0.1, states=[system.initial_state()], **given),
        lambda **given: ma.compile_system(system.scene, **given),
    ):
        with refused(ControlError, "sample_time: "):
            call(sample_time=1e-3)
    with refused(ControlError, "`sample_time`"):
        ma.simulate(system, 0.1, control=pull, sample_delay=True)
    with pytest.raises(ControlError, match="control: must be a function"):
        system.with_control("pull")
    with refused(SceneError, "'sample_delay'"):
        cart(tmp_path, spring(sample_delay=True))
    with refused(SceneError, "'sample_time'"):
        cart(tmp_path, {"kind": "constant", "torques": {}, "sample_time": 0.1})


def test_absurdly_many_samples_are_refused_with_their_number(tmp_path):
    with refused(SolverError, "sample_time: "):
        ma.simulate(cart(tmp_path, spring(sample_time=1e-9)), 2.0)


def test_a_controller_that_fails_at_a_sample_ends_the_run_there(tmp_path):
    def breaks(t, state):
        if t > 0.12:
            raise ValueError("no signal")
        return {}

    run = ma.simulate(cart(tmp_path), 1.0, control=breaks, sample_time=SLOW, certificate=False)
    assert run.status == "failed"
    assert "at t = 0.15 s" in run.message and "no signal" in run.message
    assert run.time[-1] == pytest.approx(0.14)


def test_the_box_of_the_example_follows_its_path_at_a_kilohertz():
    """Fast samples are the continuous control but for half a sample of delay."""
    scene = ma.load_scene(SCENES / "two_ur5_box.yaml")
    free = ma.compile_system(scene, arms="compiled")
    control = scene.control.model_copy(update={"sample_time": 1e-3})
    held = ma.compile_system(scene.replace(control=control), arms="compiled", like=free)
    runs = [ma.simulate(s, 0.5, certificate=False) for s in (free, held)]
    apart = np.abs(runs[0].object_position - runs[1].object_position).max()
    assert 0.0 < apart < 1e-4
