"""Impacts against closed forms: bounces, shared momentum, oblique hits, bouncing that ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import (
    GRAVITY,
    arm,
    ball,
    ball_on_plate,
    fall_time,
    on_floor,
    run,
    scene,
    times,
)
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import multiarm as ma
from multiarm.contacts.unilateral import CONTACT, Constraint
from multiarm.events.transition import Transition

HEIGHT = 0.5  # [m]
# A plate that gives way by nothing that could be seen: it slides across the fall.
FIXED = arm("x", mass=1e3)


def bounce_times(restitution: float, count: int) -> np.ndarray:
    """Of a ball that falls from HEIGHT on a plate at rest."""
    first = fall_time(HEIGHT)
    between = 2.0 * first * restitution ** np.arange(1, count)
    return first + np.concatenate([[0.0], np.cumsum(between)])


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9, 1.0])
def test_a_ball_bounces_when_a_textbook_says(restitution):
    trajectory = run(ball_on_plate(FIXED, ball(height=HEIGHT), restitution), 3.0)
    found = times(trajectory)
    count = 1 if restitution == 0.0 else 5
    assert len(found) >= count and (restitution > 0.0 or len(found) == 1)
    np.testing.assert_allclose(found[:count], bounce_times(restitution, count), atol=1e-9)
    for k, event in enumerate(trajectory.events[:count]):
        speed = GRAVITY * fall_time(HEIGHT) * restitution**k
        assert event["before"]["gap_rate_m_s"] == pytest.approx(-speed, abs=1e-8)
        assert event["after"]["gap_rate_m_s"] == pytest.approx(restitution * speed, abs=1e-8)
        assert event["after"]["impulse_N_s"] == pytest.approx((1 + restitution) * speed, abs=1e-8)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-8


@pytest.mark.slow
def test_a_perfect_bounce_keeps_the_energy_through_a_thousand_bounces():
    height = 1e-3
    trajectory = run(ball_on_plate(FIXED, ball(height=height), 1.0), 2000.0 * fall_time(height))
    found = times(trajectory)
    assert len(found) == 1000
    np.testing.assert_allclose(found, (1 + 2 * np.arange(1000)) * fall_time(height), atol=1e-6)
    energy = trajectory.energy
    assert np.ptp(energy) < 1e-8
    assert trajectory.channel("effects/impacts/work")[-1] == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("restitution", [0.3, 0.7])
def test_endless_bouncing_ends_and_the_ball_rests_with_its_weight(restitution):
    trajectory = run(ball_on_plate(FIXED, ball(height=HEIGHT), restitution), 3.0)
    end = fall_time(HEIGHT) * (1 + restitution) / (1 - restitution)
    last = trajectory.events[-1]
    assert last["kind"] == "comes to rest"
    # bounces lower than the accuracy are left out, and the time that they take
    lost = 2.0 * math.sqrt(2.0 * 1e-8 / GRAVITY) / (1.0 - restitution)
    assert end - lost < last["time"] <= end + 1e-9
    resting = trajectory.time > end
    force = trajectory.contact_forces["plate"]
    np.testing.assert_allclose(force[resting, 0], GRAVITY, rtol=1e-9)
    np.testing.assert_allclose(trajectory.object_position[resting, 2], 0.05, atol=1e-9)
    assert np.all(force[~resting & (trajectory.time < last["time"])] == 0.0)
    work = trajectory.channel("effects/impacts/work")[-1]
    assert work == pytest.approx(-GRAVITY * HEIGHT, abs=1e-7)


@pytest.mark.parametrize("plate_mass", [0.2, 1.0, 7.0])
@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_a_hit_shares_momentum_and_loses_the_energy_that_newton_says(plate_mass, restitution):
    plate, m = arm("z", mass=plate_mass, velocity=[0.3]), 0.5
    body = ball(height=0.2, mass=m, twist=[0, 0, -1.0, 0, 0, 0])
    trajectory = run(ball_on_plate(plate, body, restitution, gravity=None), 0.5)
    closing, M = 1.3, plate_mass
    assert times(trajectory)[0] == pytest.approx(0.2 / closing, abs=1e-9)
    mean = (M * 0.3 - m * 1.0) / (M + m)
    after = [mean + restitution * closing * M / (M + m), mean - restitution * closing * m / (M + m)]
    assert trajectory.object_twist[-1, 2] == pytest.approx(after[0], abs=1e-9)
    assert trajectory.joint_velocities["plate"][-1, 0] == pytest.approx(after[1], abs=1e-9)
    lost = 0.5 * M * m / (M + m) * closing**2 * (1.0 - restitution**2)
    assert trajectory.channel("effects/impacts/work")[-1] == pytest.approx(-lost, abs=1e-9)
    assert trajectory.work[-1] == pytest.approx(-lost, abs=1e-9)


def oblique(mu, spin, restitution=0.5, slide=2.0):
    """A solid ball that hits the floor at a slant; rates behind the first hit."""
    body = ball(height=HEIGHT, twist=[slide, 0, 0, 0, spin, 0])
    trajectory = run(on_floor(body, restitution, mu), fall_time(HEIGHT) + 0.1, output_step=0.001)
    assert len(times(trajectory)) == 1
    return trajectory


@pytest.mark.parametrize(("mu", "spin"), [(0.1, 0.0), (0.1, -30.0), (0.1, 100.0)])
def test_a_slanting_hit_that_slides_takes_mu_times_the_impulse(mu, spin):
    trajectory, r = oblique(mu, spin), 0.05
    impulse = 1.5 * GRAVITY * fall_time(HEIGHT)
    slip = 2.0 - r * spin
    sign = math.copysign(1.0, slip)
    assert abs(slip) > 3.5 * mu * impulse  # it slides to the end of the impact
    assert trajectory.object_twist[-1, 0] == pytest.approx(2.0 - sign * mu * impulse, abs=1e-9)
    gained = sign * mu * impulse * r / (0.4 * r * r)
    assert trajectory.object_twist[-1, 4] == pytest.approx(spin + gained, abs=1e-7)


@pytest.mark.parametrize("spin", [0.0, 60.0, -20.0])
def test_a_slanting_hit_that_sticks_leaves_rolling(spin):
    trajectory, r = oblique(2.0, spin), 0.05
    speed = (2.0 + 0.4 * r * spin) / 1.4  # angular momentum about the point of contact
    assert trajectory.object_twist[-1, 0] == pytest.approx(speed, abs=1e-9)
    assert trajectory.object_twist[-1, 4] == pytest.approx(speed / r, abs=1e-7)


def test_a_thrown_ball_comes_down_where_the_parabola_does():
    body = ball(height=0.3, twist=[1.5, -0.4, 2.0, 0, 0, 0])
    trajectory = run(on_floor(body, 0.8), 1.0)
    event = trajectory.events[0]
    fall = (2.0 + math.sqrt(4.0 + 2.0 * GRAVITY * 0.3)) / GRAVITY
    assert event["time"] == pytest.approx(fall, abs=1e-9)
    np.testing.assert_allclose(event["where"], [1.5 * fall, -0.4 * fall, 0.0], atol=1e-8)


def test_a_ball_on_a_plate_that_shakes_bounces_as_scipy_integrates_it():
    M, m, restitution, amplitude, frequency, end = 2.0, 0.5, 0.6, 30.0, 2.0, 1.5
    control = {"kind": "harmonic", "amplitude": {"plate": [amplitude]}, "frequency": frequency}
    shaken = ball_on_plate(arm("z", mass=M), ball(height=0.3, mass=m), restitution, control=control)
    trajectory = run(shaken, end, 1e-9)
    push = lambda t: (M + m) * GRAVITY + amplitude * math.sin(2 * math.pi * frequency * t)  # noqa: E731

    def motion(t, y):
        return [y[1], push(t) / M - GRAVITY, y[3], -GRAVITY]

    def gap(t, y):
        return y[2] - y[0]

    gap.terminal, gap.direction = True, -1
    t, y, hits = 0.0, np.array([0.0, 0.0, 0.3, 0.0]), []
    while t < end:
        piece = solve_ivp(
            motion, (t, end), y, "DOP853", events=gap, rtol=1e-12, atol=1e-13, max_step=0.02
        )
        t, y = piece.t[-1], piece.y[:, -1]
        if piece.status == 1:
            hits.append(t)
            mean, gone = (M * y[1] + m * y[3]) / (M + m), -restitution * (y[3] - y[1])
            y = np.array([y[0], mean - gone * m / (M + m), y[0], mean + gone * M / (M + m)])
    assert len(hits) >= 4
    np.testing.assert_allclose(times(trajectory), hits, atol=1e-8)
    assert trajectory.object_position[-1, 2] - 0.05 == pytest.approx(y[2], abs=1e-7)
    assert trajectory.joint_positions["plate"][-1, 0] == pytest.approx(y[0], abs=1e-7)


def limits(kinds, force, velocity=None, restitution=0.5, ends=None):
    """A bead at the tip of slides that stop at 0.5 m, pushed with constant forces."""
    data = arm(kinds, mass=1.0, velocity=velocity)
    ranges = ends or {f"j{k + 1}": [-1.0, 0.5] for k in range(len(kinds))}
    effects = {"joint_limits": {"range": {"arm": ranges}, "restitution": restitution}}
    bead = {"shape": {"sphere": 0.05}, "mass": 1.0}
    return ma.Scene(
        object=bead,
        arms={"arm": data},
        joints=[{"arm": "arm", "kind": "ball"}],
        effects=effects,
        control={"kind": "constant", "torques": {"arm": force}},
    )


def test_a_joint_bounces_off_the_end_of_its_range():
    trajectory = run(limits("x", [3.0]), 3.0)
    first = math.sqrt(2.0 * 0.5 / 1.5)
    hits = times(trajectory, "bounces")
    expected = first + np.concatenate([[0.0], np.cumsum(2.0 * first * 0.5 ** np.arange(1, 6))])
    np.testing.assert_allclose(hits[:6], expected, atol=1e-9)
    last = trajectory.events[-1]
    assert last["kind"] == "comes to rest"
    assert last["time"] == pytest.approx(3.0 * first, abs=1e-3)
    assert trajectory.joint_positions["arm"][-1, 0] == pytest.approx(0.5, abs=1e-9)


def test_a_joint_leaves_the_end_of_its_range_when_the_force_turns():
    pushed = limits("x", [3.0], restitution=0.0)
    control = {"kind": "harmonic", "amplitude": {"arm": [8.0]}, "frequency": 0.5, "hold": False}
    trajectory = run(pushed.replace(control=control), 2.0)
    # x = (A/mw) (t - sin(w t)/w) until 0.5, then at rest until the force turns at t = 1
    w, a = math.pi, 4.0
    reach = lambda t: a / w * (t - math.sin(w * t) / w) - 0.5  # noqa: E731
    reached, left = (times(trajectory, kind) for kind in ("reaches its limit", "leaves its limit"))
    expected = [[brentq(reach, 0.1, 1.0, xtol=1e-14)], [1.0]]
    np.testing.assert_allclose([reached, left], expected, atol=1e-8)
    back = 0.5 - a / w * (1.0 + math.sin(w * 2.0) / w)
    assert trajectory.joint_positions["arm"][-1, 0] == pytest.approx(back, abs=1e-8)


def test_two_joints_reach_their_limits_at_the_same_time():
    trajectory = run(limits("xy", [3.0, 3.0]), 1.5)
    first = [event for event in trajectory.events if event["kind"] == "bounces"][:2]
    assert [event["joint"] for event in first] == ["j1", "j2"]
    assert first[0]["time"] == first[1]["time"]
    np.testing.assert_array_equal(
        trajectory.joint_positions["arm"][:, 0], trajectory.joint_positions["arm"][:, 1]
    )


def test_two_balls_of_a_chain_hit_both_ends_of_a_box_at_once():
    """Two arms close in on a box from both sides; it stays where it is, by symmetry."""
    body = {"shape": {"box": [0.2, 0.2, 0.2]}, "mass": 2.0}
    contacts, arms = {}, {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        arms[name] = arm("x", mass=1.0, velocity=[-side * 0.5], base={"xyz": [side * 0.4, 0, 0]})
        tip = {"sphere": {"radius": 0.05}}
        face = {"plane": {"point": [side * 0.1, 0, 0], "normal": [side, 0, 0]}}
        contacts[name] = [{"arm": tip, "object": face}]
    effects = {"unilateral_contacts": {"start": "as_written", "restitution": 0.5}}
    trajectory = run(scene(body, arms, contacts, effects, gravity=None), 1.0)
    np.testing.assert_allclose(times(trajectory), [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(trajectory.object_twist, 0.0, atol=1e-12)
    assert trajectory.joint_velocities["left"][-1, 0] == pytest.approx(-0.25, abs=1e-9)
    assert trajectory.joint_velocities["right"][-1, 0] == pytest.approx(0.25, abs=1e-9)


def test_a_joint_that_holds_both_ways_holds_in_an_impact_in_which_another_contact_rests():
    """Rows of three contacts: a pad with friction, a joint with friction, and the one that hits."""
    pad = Constraint(CONTACT, "a", "pad", 0, tangents=(1, 2), mu=0.3)
    joint = Constraint(CONTACT, "b", "joint", 3, tangents=(4, 5), mu=0.3, bilateral=True)
    hit = Constraint(CONTACT, "a", "hit", 6)
    jacobian = np.zeros((7, 7))
    jacobian[[0, 1, 2, 4, 5], [2, 3, 4, 5, 6]] = 1.0
    jacobian[3, :2], jacobian[6, :2] = [1.0, 0.5], [1.0, 0.2]
    before = np.array([0.0] * 6 + [-1.0])  # [m/s]
    transition = Transition.__new__(Transition)  # without a system
    transition._constraints, transition._residual = (pad, joint, hit), 0.0
    for resting in (set(), {0}):
        _, after = transition._collide(
            [0, 1, 2], [*range(7)], jacobian @ jacobian.T, before, {}, resting
        )
        np.testing.assert_allclose(after[3:], 0.0, atol=1e-12)
