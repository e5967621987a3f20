"""Sliding and sticking against closed forms and integrations of minimal coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import (
    AS_WRITTEN,
    GRAVITY,
    arm,
    ball,
    ball_on_plate,
    box,
    on_floor,
    run,
    scene,
    times,
)
from mechanics import G
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import multiarm as ma
from multiarm.scene import parse_scene

FLOOR_CONE = 1e-10  # how far friction may be outside of its cone, as a part of the force


def components(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal forces and sizes of friction of contacts with friction, (K, N) each."""
    return force[:, 0::3], np.hypot(force[:, 1::3], force[:, 2::3])


def obeys_coulomb(force: np.ndarray, mu: float) -> bool:
    normal, tangential = components(force)
    size = max(1.0, float(np.max(normal)))
    inside = np.max(tangential - mu * normal) <= FLOOR_CONE * size
    return bool(inside and np.min(normal) >= -FLOOR_CONE * size)


@pytest.mark.parametrize(("mu", "speed"), [(0.1, 1.0), (0.5, 3.0)])
def test_a_box_slides_to_rest_in_v_squared_over_two_mu_g(mu, speed):
    trajectory = run(on_floor(box(twist=[0, speed, 0, 0, 0, 0]), mu=mu), 1.2)
    stop = speed / (mu * GRAVITY)
    np.testing.assert_allclose(times(trajectory, "sticks"), stop, atol=1e-9)
    assert [e["kind"] for e in trajectory.events] == 4 * ["sticks"] + ["at rest"]
    t = np.minimum(trajectory.time, stop)
    path = speed * t - 0.5 * mu * GRAVITY * t**2
    np.testing.assert_allclose(trajectory.object_position[:, 1], path, atol=1e-8)
    force = trajectory.contact_forces["floor"]
    assert obeys_coulomb(force, mu)
    np.testing.assert_allclose(np.sum(components(force)[0], axis=1), 2.0 * GRAVITY, rtol=1e-9)
    work = trajectory.channel("effects/contact_friction/work")[-1]
    assert work == pytest.approx(-0.5 * 2.0 * speed**2, abs=1e-7)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-7


@pytest.mark.parametrize("turns", [1.0, -4.0])
def test_a_box_spins_to_rest_as_its_corners_drag(turns):
    sizes, mu, m = (0.4, 0.3, 0.2), 0.3, 2.0
    trajectory = run(on_floor(box(sizes, m, twist=[0, 0, 0, 0, 0, turns]), mu=mu), 1.0)
    corner, inertia = math.hypot(0.2, 0.15), m * (0.4**2 + 0.3**2) / 12
    deceleration = mu * m * GRAVITY * corner / inertia
    stop = abs(turns) / deceleration
    np.testing.assert_allclose(times(trajectory, "sticks"), stop, atol=1e-9)
    np.testing.assert_allclose(trajectory.object_position[-1], [0, 0, 0.1], atol=1e-9)
    z, w = trajectory.object_quaternion_xyzw[-1, 2:]
    turned = math.copysign(turns**2 / (2 * deceleration), turns)
    assert 2 * math.atan2(z, w) == pytest.approx(turned, abs=1e-8)


def test_a_ball_slides_until_it_rolls():
    mu, speed = 0.2, 2.0
    body = ball(twist=[speed, 0, 0, 0, 0, 0])
    trajectory = run(on_floor(body, mu=mu), 1.0)
    rolls = 2.0 * speed / (7.0 * mu * GRAVITY)
    assert times(trajectory) == pytest.approx([rolls], abs=1e-9)
    assert trajectory.object_twist[-1, 0] == pytest.approx(5.0 / 7.0 * speed, abs=1e-9)
    assert trajectory.object_twist[-1, 4] == pytest.approx(5.0 / 7.0 * speed / 0.05, abs=1e-7)
    work = trajectory.channel("effects/contact_friction/work")[-1]
    assert work == pytest.approx(-(speed**2) / 7.0, abs=1e-8)


def test_backspin_brings_a_ball_back():
    mu, speed, spin, r = 0.3, 0.5, -60.0, 0.05
    trajectory = run(on_floor(ball(twist=[speed, 0, 0, 0, spin, 0]), mu=mu), 1.5)
    rolls = (speed - r * spin) / (3.5 * mu * GRAVITY)
    after = speed - mu * GRAVITY * rolls
    assert after < 0.0
    assert times(trajectory) == pytest.approx([rolls], abs=1e-9)
    assert trajectory.object_twist[-1, 0] == pytest.approx(after, abs=1e-9)


def pushed_box(share: float, mu: float = 0.3, height: float = 0.1):
    """A smooth fingertip pushes a box of 2 kg with a share of its weight; the arm weighs 1 kg."""
    finger = arm("x", mass=1.0, base={"xyz": [-0.25, 0, height]})
    tip = {"sphere": {"radius": 0.05}}
    face = {"plane": {"point": [-0.2, 0, 0], "normal": [-1, 0, 0]}}
    effects = {"unilateral_contacts": AS_WRITTEN, "floor": {"mu": mu}}
    control = {"kind": "constant", "torques": {"finger": [share * 2.0 * GRAVITY]}}
    contacts = {"finger": [{"arm": tip, "object": face}]}
    return scene(box(), {"finger": finger}, contacts, effects, control=control)


@pytest.mark.parametrize("share", [0.05, 0.2999])
def test_a_box_stays_under_a_side_force_below_mu_m_g(share):
    trajectory = run(pushed_box(share), 0.5)
    np.testing.assert_allclose(trajectory.object_position, [[0, 0, 0.1]] * 51, atol=1e-10)
    np.testing.assert_allclose(trajectory.contact_forces["finger"], share * 2 * GRAVITY, rtol=1e-9)
    normal, drag = components(trajectory.contact_forces["floor"])
    assert obeys_coulomb(trajectory.contact_forces["floor"], 0.3)
    # the corners on the far side bear more: moments about the middle of the base
    lever = share * 2 * GRAVITY * 0.1
    x = np.array([-0.2, -0.2, -0.2, -0.2, 0.2, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(normal @ x, lever, atol=1e-9)
    np.testing.assert_allclose(np.sum(normal, axis=1), 2 * GRAVITY, rtol=1e-9)
    assert np.all(np.sum(drag, axis=1) >= share * 2 * GRAVITY - 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.3001, 0.4, 0.6])
def test_a_box_slides_under_a_side_force_above_mu_m_g(share):
    trajectory = run(pushed_box(share), 0.5)
    acceleration = (share - 0.3) * 2.0 * GRAVITY / 3.0
    path = 0.5 * acceleration * trajectory.time**2
    np.testing.assert_allclose(trajectory.object_position[:, 0], path, atol=3e-8)
    push = share * 2 * GRAVITY - 1.0 * acceleration
    np.testing.assert_allclose(trajectory.contact_forces["finger"], push, rtol=1e-8)
    assert obeys_coulomb(trajectory.contact_forces["floor"], 0.3)


def shaken_block(mu: float, strength: float):
    """A block on one foot, shaken along x with ``strength`` times what friction holds."""
    rod = arm("xz", mass=0.5, base={"xyz": [0, 0, 0.05]})
    block = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 1.0, "pose": {"xyz": [0, 0, 0.05]}}
    shake = {"rod": [strength * mu * 1.5 * GRAVITY, 0.0]}
    return parse_scene(
        {
            "gravity": G,
            "object": block,
            "arms": {"rod": rod},
            "joints": [{"arm": "rod", "kind": "weld"}],
            "effects": {"floor": {"mu": mu, "points": [[0, 0, -0.05]]}},
            "control": {"kind": "harmonic", "amplitude": shake, "frequency": 1.0, "hold": False},
        }
    )


def stick_slip_times(strength: float, mu: float, end: float) -> np.ndarray:
    """Begins and ends of slip of a block that sticks twice a cycle."""
    w, g, found = 2 * math.pi, mu * GRAVITY, []
    begin, sign, k = math.asin(1 / strength) / w, 1.0, 0
    while begin < end:

        def speed(t, begin=begin, sign=sign):
            pushed = strength * g / w * (math.cos(w * begin) - math.cos(w * t))
            return pushed - sign * g * (t - begin)

        later = begin + 0.01
        while sign * speed(later) > 0.0:
            later += 0.01
        found += [begin, brentq(speed, later - 0.01, later, xtol=1e-15)]
        k, sign = k + 1, -sign
        begin = (math.asin(1 / strength) + k * math.pi) / w
        assert begin > found[-1]  # it sticks in between
    return np.array([t for t in found if t < end])


@pytest.mark.parametrize("accuracy", [1e-5, 1e-7, 1e-9])
def test_a_shaken_block_sticks_and_slips_for_ten_cycles(accuracy):
    trajectory = run(shaken_block(0.4, 1.3), 10.1, accuracy)
    found = times(trajectory, "slides", "sticks")
    expected = stick_slip_times(1.3, 0.4, 10.1)
    assert len(expected) == 40
    np.testing.assert_allclose(found, expected, atol=5.0 * accuracy)
    assert obeys_coulomb(trajectory.contact_forces["floor"], 0.4)
    assert trajectory.statistics["evaluations"] < 20000


def test_a_point_that_slides_in_two_directions_follows_scipy():
    """A bead on a rough plate that a harmonic force shakes along y while it slides along x."""
    mu, amplitude, w = 0.3, 6.0, 2 * math.pi * 1.5
    rod = arm("xyz", mass=0.5, velocity=[2.0, 0.0, 0.0], base={"xyz": [0, 0, 0.05]})
    data = {
        "gravity": G,
        "object": ball(twist=[2.0, 0, 0, 0, 0, 0]),
        "arms": {"rod": rod},
        "joints": [{"arm": "rod", "kind": "weld"}],
        "effects": {"floor": {"mu": mu}},
        "control": {
            "kind": "harmonic", "hold": False, "frequency": 1.5,
            "amplitude": {"rod": [0.0, amplitude, 0.0]},
        },
    }  # fmt: skip
    trajectory = run(parse_scene(data), 0.6, 1e-9)

    def motion(t, y):
        speed = np.hypot(y[2], y[3])
        drag = mu * GRAVITY / speed
        return [y[2], y[3], -drag * y[2], amplitude / 1.5 * math.sin(w * t) - drag * y[3]]

    exact = solve_ivp(
        motion, (0, 0.6), [0, 0, 2.0, 0], "DOP853", rtol=1e-12, atol=1e-12, t_eval=trajectory.time
    )
    assert exact.success
    np.testing.assert_allclose(trajectory.object_position[:, :2], exact.y[:2].T, atol=1e-8)
    normal, drag = components(trajectory.contact_forces["floor"])
    np.testing.assert_allclose(drag, mu * normal, rtol=1e-9)
    speed = np.hypot(*exact.y[2:])
    lost = np.trapezoid(-mu * 1.5 * GRAVITY * speed, exact.t)
    work = trajectory.channel("effects/contact_friction/work")[-1]
    assert work == pytest.approx(lost, rel=1e-4)


def test_a_ball_on_a_turning_plate_rolls_then_slides():
    """A plate turns slowly: a ball at its axis rolls as long as (2/7) tan(angle) is below mu."""
    mu, rate = 0.1, 0.8
    plate = arm("Y", mass=1.0, inertia=1e6, velocity=[rate])
    trajectory = run(ball_on_plate(plate, ball(), mu=mu), 0.6, 1e-8)
    slid = times(trajectory, "slides")
    r, m = 0.05, 1.0

    def motion(t, y):
        # place s of the ball along the plate: the plate turns at a steady rate
        return [y[1], 5 / 7 * GRAVITY * math.sin(rate * t) + 5 / 7 * rate**2 * y[0]]

    def limit(t, y):
        lifted = GRAVITY * math.cos(rate * t) - rate**2 * r - 2 * rate * y[1]
        acceleration = motion(t, y)[1]
        drag = GRAVITY * math.sin(rate * t) + rate**2 * y[0] - acceleration
        return mu * lifted - abs(drag)

    limit.terminal = True
    exact = solve_ivp(motion, (0, 0.6), [0, -rate * r], "DOP853", events=limit, rtol=1e-12)
    assert m > 0 and len(exact.t_events[0]) == 1
    assert slid[0] == pytest.approx(exact.t_events[0][0], abs=1e-8)


def test_late_in_a_long_run_a_box_rests_that_is_pulled_by_less_than_its_friction():
    pulled = on_floor(box(), mu=0.3, gravity=[0.9 * 0.3 * 10.0, 0.0, -10.0])
    trajectory = ma.simulate(ma.compile_system(pulled), 1.0, accuracy=1e-9, start_time=500.0)
    assert trajectory.status == "completed", trajectory.message
    assert trajectory.statistics["steps"] < 10 and np.abs(trajectory.object_twist).max() < 1e-12


@pytest.mark.slow
def test_late_in_a_long_run_a_slip_begins_as_it_does_early():
    """A pull that grows by 1 m/s^3 times the mass: the way is a sixth of the cube of the time."""
    mu, mass, begin = 0.3, 2.0, 1000.0

    def pull(t, state):
        return [mass * (10.0 * mu + t - begin - 0.1), 0.0, 0.0, 0.0, 0.0, 0.0]

    effects = {"external_wrenches": [{"on": "object", "function": pull}]}
    pulled = on_floor(box(mass=mass), mu=mu, gravity=[0.0, 0.0, -10.0], effects=effects)
    system = ma.compile_system(pulled)
    trajectory = ma.simulate(system, 0.3, accuracy=1e-8, start_time=begin, certificate=False)
    assert trajectory.status == "completed", trajectory.message
    assert trajectory.object_position[-1, 0] == pytest.approx(0.2**3 / 6.0, abs=1e-8)
