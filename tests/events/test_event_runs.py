"""Runs with events as runs: accuracy, methods, certificates, times of events, files, Ctrl-C."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import (
    GRAVITY,
    arm,
    ball,
    ball_on_plate,
    box,
    fall_time,
    on_floor,
    response_of_rod,
    rod,
    run,
    times,
)
from scipy.integrate import solve_ivp

import multiarm as ma

PLATE, BALL, PUSH, FREQUENCY = 2.0, 0.5, 50.0, 2.0  # [kg], [kg], [N], [Hz]


def shaken_plate(restitution: float = 0.0, unit: float = 1.0):
    """A ball on a plate that shakes so much that the ball leaves it; ``unit`` of mass [kg]."""
    control = {"kind": "harmonic", "amplitude": {"plate": [PUSH * unit]}, "frequency": FREQUENCY}
    return ball_on_plate(
        arm("z", mass=PLATE * unit), ball(mass=BALL * unit), restitution, control=control,
        name="shaken",
    )  # fmt: skip


def shaken_events(end: float):
    """Times at which the ball leaves and lands without restitution, and the state at the end."""
    w, total = 2 * math.pi * FREQUENCY, PLATE + BALL
    shake = lambda t: PUSH * math.sin(w * t)  # noqa: E731

    def together(t, y):
        return [y[1], shake(t) / total, y[3], shake(t) / total]

    def apart(t, y):
        return [y[1], (shake(t) + BALL * GRAVITY) / PLATE, y[3], -GRAVITY]

    def press(t, y):
        return GRAVITY + shake(t) / total

    def gap(t, y):
        return y[2] - y[0]

    for event in (press, gap):
        event.terminal, event.direction = True, -1
    t, y, found, held = 0.0, np.zeros(4), [], True
    while True:
        piece = solve_ivp(
            together if held else apart, (t, end), y, "DOP853",
            events=press if held else gap, rtol=1e-12, atol=1e-14, max_step=0.01,
        )  # fmt: skip
        t, y = piece.t[-1], piece.y[:, -1]
        if piece.status != 1:
            return np.array(found), y
        found.append(t)
        if not held:
            y[1] = y[3] = (PLATE * y[1] + BALL * y[3]) / total
            y[2] = y[0]
        held = not held


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-8, 1e-10])
def test_a_ball_leaves_a_shaken_plate_and_lands_as_scipy_says(accuracy):
    trajectory = run(shaken_plate(), 1.0, accuracy)
    expected, end = shaken_events(1.0)
    assert [event["kind"] for event in trajectory.events] == ["lets go", "touches", "lets go"]
    np.testing.assert_allclose(times(trajectory), expected, atol=max(accuracy, 1e-9))
    assert trajectory.object_position[-1, 2] - 0.05 == pytest.approx(end[2], abs=2 * accuracy)
    force = trajectory.contact_forces["plate"][:, 0]
    gap = trajectory.object_position[:, 2] - 0.05 - trajectory.joint_positions["plate"][:, 0]
    assert np.min(force) >= -1e-10
    assert np.min(gap) >= -max(accuracy, 1e-9)
    assert np.max(force * np.abs(gap)) <= 1e-8
    apart = trajectory.contact_states["plate"][:, 0] == 0.0
    np.testing.assert_array_equal(apart, gap > 1e-7)


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_the_unit_of_mass_decides_no_event(unit):
    usual, scaled = (run(shaken_plate(unit=kilogram), 1.0) for kilogram in (1.0, unit))
    assert [event["kind"] for event in scaled.events] == [event["kind"] for event in usual.events]
    np.testing.assert_allclose(times(scaled), times(usual), atol=1e-8)


METHODS = [
    ({"integrator": "dopri5", "tolerance": 1e-9}, 1e-7),
    ({"integrator": "dop853", "tolerance": 1e-10}, 1e-8),
    ({"integrator": "rodas5p", "tolerance": 1e-8}, 1e-6),
    ({"integrator": "rk4", "step": 2e-3}, 1e-7),
    ({"integrator": "semi_implicit_euler", "step": 1e-4}, 1e-2),
]


@pytest.mark.parametrize(("method", "tolerance"), METHODS, ids=lambda m: str(m))
def test_every_method_finds_the_same_events(method, tolerance):
    system = ma.compile_system(shaken_plate())
    trajectory = ma.simulate(system, 1.0, **method)
    expected, end = shaken_events(1.0)
    assert trajectory.status == "completed"
    found = times(trajectory, "lets go", "touches", "bounces", "comes to rest")
    np.testing.assert_allclose(found, expected, atol=tolerance)
    assert trajectory.object_position[-1, 2] - 0.05 == pytest.approx(end[2], abs=tolerance)


@pytest.mark.parametrize(("method", "order"), [("semi_implicit_euler", 1.0), ("rk4", 4.0)])
def test_fixed_steps_keep_their_order_across_events(method, order):
    system = ma.compile_system(shaken_plate())
    _, end = shaken_events(0.8)
    steps = np.array([1 / 50, 1 / 100, 1 / 200]) / (20 if order == 1.0 else 1)
    errors = []
    for step in steps:
        trajectory = ma.simulate(system, 0.8, integrator=method, step=step)
        errors.append(abs(trajectory.object_position[-1, 2] - 0.05 - end[2]))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope > order - 0.4


def test_event_times_converge_with_the_accuracy():
    expected = shaken_events(1.0)[0]
    errors = [
        np.max(np.abs(times(run(shaken_plate(), 1.0, accuracy)) - expected))
        for accuracy in (1e-3, 1e-5, 1e-7)
    ]
    assert errors[1] < 1e-5 and errors[2] < 1e-8
    assert errors[2] <= errors[1] <= max(errors[0], 1e-7)


def test_a_certificate_is_met_across_events():
    thrown = on_floor(ball(height=0.3, twist=[1, 0, 0, 0, 20, 0]), 0.6, 0.3)
    trajectory = ma.simulate(ma.compile_system(thrown), 0.9, accuracy=1e-7)
    assert trajectory.status == "completed"
    assert trajectory.certificate["met"] is True
    assert trajectory.certificate["estimated_error"]["position_m"] <= 1e-7


def test_work_of_impacts_and_friction_closes_the_balance():
    thrown = on_floor(ball(height=0.3, twist=[1, 0, 0, 0, -30, 0]), 0.6, 0.3)
    trajectory = run(thrown, 1.5)
    works = [trajectory.channel(f"effects/{name}/work") for name in ("impacts", "contact_friction")]
    np.testing.assert_allclose(sum(works), trajectory.work, atol=1e-12)
    change = trajectory.energy - trajectory.energy[0]
    np.testing.assert_allclose(change, trajectory.work, atol=1e-8)
    assert works[0][-1] < -1.0 and np.all(np.diff(works[0]) <= 1e-12)


# --- when events happen --------------------------------------------------------------------------


def test_an_impact_exactly_at_a_sample_time_is_one_impact():
    step = fall_time(0.5) / 16.0
    trajectory = run(on_floor(ball(height=0.5), 0.5), 24 * step, output_step=step)
    assert len(times(trajectory)) == 1
    assert times(trajectory)[0] == pytest.approx(trajectory.time[16], abs=1e-12)
    assert abs(trajectory.object_twist[16, 2]) in (
        pytest.approx(GRAVITY * fall_time(0.5), abs=1e-9),
        pytest.approx(0.5 * GRAVITY * fall_time(0.5), abs=1e-9),
    )


@pytest.mark.parametrize("miss", [-1e-6, 0.0, 1e-6])
def test_a_run_may_end_at_an_impact(miss):
    trajectory = run(on_floor(ball(height=0.5), 0.5), fall_time(0.5) + miss)
    assert trajectory.status == "completed"
    if miss != 0.0:  # exactly there it may be either, to the last digit
        assert len(times(trajectory)) == (miss > 0.0)
    assert np.all(np.isfinite(trajectory.object_twist))


def test_a_run_may_begin_with_an_impact():
    trajectory = run(on_floor(ball(twist=[0, 0, -2.0, 0, 0, 0]), 0.5), 0.1)
    assert times(trajectory)[0] == 0.0
    t = trajectory.time[1:]
    np.testing.assert_allclose(
        trajectory.object_position[1:, 2], 0.05 + t - 0.5 * GRAVITY * t**2, atol=1e-9
    )
    assert trajectory.object_twist[0, 2] == pytest.approx(1.0, abs=1e-12)  # behind the impact
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9


def test_a_run_may_begin_at_rest_in_touch_or_in_the_air():
    resting = run(on_floor(ball(), 0.5), 0.2)
    assert not resting.events
    np.testing.assert_allclose(resting.contact_forces["floor"], GRAVITY, rtol=1e-12)
    flying = run(on_floor(ball(height=1.0), 0.5), 0.2)
    assert not flying.events
    np.testing.assert_array_equal(flying.contact_forces["floor"], 0.0)
    leaving = run(on_floor(ball(twist=[0, 0, 1.0, 0, 0, 0]), 0.5), 0.15)
    assert not leaving.events
    np.testing.assert_array_equal(leaving.contact_forces["floor"][1:], 0.0)


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7])
def test_a_grazing_flight_is_an_impact_where_it_reaches_the_plate(depth):
    """Without gravity a ball flies past a bump of the arm's sphere: it touches by ``depth``."""
    bump = {"arm": {"sphere": {"radius": 0.3}}, "object": {"sphere": {"radius": 0.05}}}
    scene = ma.Scene(
        object={
            "shape": {"sphere": 0.05}, "mass": 1.0, "twist": [2.0, 0, 0, 0, 0, 0],
            "pose": {"xyz": [-1.0, 0, 0.35 - depth]},
        },
        arms={"bump": arm("z", mass=1e6)},
        joints=[{"arm": "bump", "kind": "contacts", "contacts": [bump]}],
        effects={"unilateral_contacts": {"start": "as_written", "restitution": 1.0}},
    )  # fmt: skip
    trajectory = run(scene, 1.0, 1e-6)
    hit = (1.0 - math.sqrt(0.35**2 - (0.35 - depth) ** 2)) / 2.0
    assert len(times(trajectory)) == 1
    assert times(trajectory)[0] == pytest.approx(hit, abs=1e-7)
    missed = scene.replace(object=scene.object.model_dump() | {"pose": {"xyz": [-1, 0, 0.3501]}})
    assert not run(missed, 1.0, 1e-6).events


# --- runs as such --------------------------------------------------------------------------------


def test_a_run_with_events_is_the_same_twice():
    system = ma.compile_system(on_floor(box(rpy=(0.3, 0.2, 0.1), height=0.4), 0.3))
    one, other = (ma.simulate(system, 0.9, accuracy=1e-6, certificate=False) for _ in range(2))
    assert len(one.events) > 5
    assert one.events == other.events
    np.testing.assert_array_equal(one.object_position, other.object_position)
    np.testing.assert_array_equal(one.contact_forces["floor"], other.contact_forces["floor"])


def test_events_forces_and_states_survive_a_file(tmp_path):
    thrown = on_floor(ball(height=0.3, twist=[1, 0, 0, 0, 0, 0]), 0.6, 0.3)
    trajectory = run(thrown, 0.8)
    streamed = run(thrown, 0.8, out=tmp_path / "streamed.h5")
    trajectory.save(tmp_path / "saved.h5")
    for name in ("saved", "streamed"):
        loaded = ma.load_trajectory(tmp_path / f"{name}.h5")
        assert loaded.events == trajectory.events
        for channel in ("effects/impacts/work", "effects/contact_friction/work"):
            np.testing.assert_array_equal(loaded.channel(channel), trajectory.channel(channel))
        np.testing.assert_array_equal(
            loaded.contact_states["floor"], trajectory.contact_states["floor"]
        )
        np.testing.assert_array_equal(
            loaded.contact_forces["floor"], trajectory.contact_forces["floor"]
        )
    assert streamed.status == "completed"


def test_ctrl_c_between_bounces_keeps_what_there_is():
    calls = []

    def stop_after_half_a_second(t):
        calls.append(t)
        if t > 0.5:
            raise KeyboardInterrupt

    system = ma.compile_system(on_floor(ball(height=0.05), 0.9))
    trajectory = ma.simulate(
        system, 3.0, accuracy=1e-7, certificate=False, progress=stop_after_half_a_second
    )
    assert trajectory.status == "interrupted"
    assert 0.5 < trajectory.time[-1] < 1.0
    assert trajectory.events and trajectory.events[-1]["time"] <= trajectory.time[-1] + 0.05
    assert np.all(np.isfinite(trajectory.object_position))


# --- Painleve ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("angle", "mu", "speed"), [(1.0, 0.5, -3.0), (1.0, 2.0, 3.0)])
def test_a_rod_slides_outside_of_the_paradox(angle, mu, speed):
    assert response_of_rod(angle, math.copysign(mu, -speed)) > 0.0
    trajectory = run(rod(angle, mu, speed), 0.05)
    sign = -math.copysign(1.0, speed)

    def motion(t, y):
        s, c = math.sin(y[0]), math.cos(y[0])
        load = (GRAVITY - 0.5 * s * y[1] ** 2) / response_of_rod(y[0], -sign * mu * -1.0)
        drag = sign * mu * load
        spin = 12.0 * (-0.5 * c * load + 0.5 * s * drag)
        return [y[1], spin, y[3], drag]

    exact = solve_ivp(motion, (0, 0.05), [angle, 0, 0, speed], "DOP853", rtol=1e-11, atol=1e-12)
    moved = trajectory.object_position[-1, 0] - 0.5 * math.cos(angle)
    assert moved == pytest.approx(exact.y[2, -1], abs=1e-8)
