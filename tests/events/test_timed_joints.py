"""Claims about joints that take hold and let go, against closed forms.

Oracle: momentum, and the energy that an impact without restitution loses; constant accelerations of
carts on a rail; the motion of pendulums by SciPy's Runge-Kutta.
"""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import arm
from object_scenes import ASIDE
from refusals import refused
from scipy.integrate import solve_ivp
from timed_scenes import (
    ABOUT_PIVOT,
    AFTER,
    BOB,
    EXACT,
    FALL,
    LENGTH,
    at_event,
    carts,
    objects_on_rails,
    pendulum,
    simulate,
    switches,
)

import multiarm as ma
from multiarm.errors import ModelError, SolverError
from multiarm.scene import parse_scene

SAME, MOMENTUM, GAP = 1e-10, 1e-12, 1e-12


# --- carts that couple ----------------------------------------------------------------------------


def couple(masses, speeds):
    """Common speed, impulse on the second cart, energy lost (any textbook)."""
    reduced = masses[0] * masses[1] / sum(masses)
    along = speeds[0] - speeds[1]
    return np.dot(masses, speeds) / sum(masses), reduced * along, 0.5 * reduced * along**2


def test_arms_that_couple_lose_the_energy_of_their_reduced_mass():
    begin, end = 0.3, 0.6
    rails = {
        "one": {"mass": 2.0, "velocity": 1.1, "x": 0.0},
        "two": {"mass": 1.3, "velocity": -0.7, "x": 1.0, "joint": {"from": begin}},
    }
    trajectory = simulate(carts(1.1, rails), end, [0.2, *(begin + AFTER), end])
    masses, speeds = (5.0, 1.3), (1.1, -0.7)
    speed, impulse, lost = couple(masses, speeds)
    (event,) = switches(trajectory)
    assert (event["kind"], event["arm"], event["time"]) == ("attached", "two", begin)
    # of the second body, the object, along x
    np.testing.assert_allclose(event["impulse"], [-impulse, *[0.0] * 5], atol=SAME)
    np.testing.assert_allclose(event["energy_loss"], lost, rtol=SAME)
    for name in ("one", "two"):
        rates = trajectory.joint_velocities[name][:, 0]
        np.testing.assert_allclose(at_event(rates[1:4]), speed, rtol=SAME)
        np.testing.assert_allclose(rates[-1], speed, rtol=SAME)
    rates = {name: trajectory.joint_velocities[name][:, 0] for name in ("one", "two")}
    momentum = 3.0 * trajectory.object_twist[:, 0] + 2.0 * rates["one"] + 1.3 * rates["two"]
    np.testing.assert_allclose(momentum, np.dot(masses, speeds), rtol=MOMENTUM)
    np.testing.assert_allclose(trajectory.effect_works["impacts"][-1], -lost, rtol=SAME)
    places = trajectory.joint_positions["two"][:, 0]
    np.testing.assert_allclose(places[-1], -0.7 * begin + speed * (end - begin), atol=SAME)


def test_a_run_that_begins_while_a_joint_holds_begins_with_their_common_speed():
    """From the scene's start, which is that of the joints that hold at 0 s."""
    rails = {
        "one": {"mass": 2.0, "velocity": 1.1, "x": 0.0},
        "two": {"mass": 1.3, "velocity": -0.7, "x": 1.0, "joint": {"from": 0.1}},
    }
    system = ma.compile_system(parse_scene(carts(1.1, rails)))
    run = ma.simulate(system, 0.2, start_time=0.3, **EXACT)
    assert run.status == "completed", run.message
    speed, _, _ = couple((5.0, 1.3), (1.1, -0.7))
    for name in ("one", "two"):
        np.testing.assert_allclose(run.joint_velocities[name][[0, -1], 0], speed, rtol=SAME)
    assert not switches(run)
    rails["two"]["joint"]["at"] = {"xyz": [0.5, 0.0, 0.0]}  # half a metre off
    system = ma.compile_system(parse_scene(carts(1.1, rails)))
    with refused(ModelError, "joint of arm 'two'", "t = 0"):
        ma.simulate(system, 0.2, start_time=0.3, **EXACT)


def test_a_run_that_begins_while_a_joint_holds_keeps_its_speed_limit():
    """It counts what the joint stops: neither slides that it leaves free nor common speeds."""

    def begun(limit, state=None, **joint):
        rails = {
            "one": {"mass": 2.0, "velocity": 1.1, "x": 0.0},
            "two": {"mass": 1.3, "velocity": -0.7, "x": 1.0},
        }
        rails["two"]["joint"] = {"from": 0.1, "speed_limit": limit, **joint}
        system = ma.compile_system(parse_scene(carts(1.1, rails)))
        if state is not None:
            state = system.state(
                object_twist=[state, *[0.0] * 5],
                joint_velocities={"one": [state], "two": [state]},
            )
        return ma.simulate(system, 0.2, start_time=0.3, state=state, **EXACT)

    with refused(SolverError, "joint of arm 'two'", "1.8 m/s", "0.3 s"):
        begun(1.79)
    assert begun(1.81).status == "completed"
    assert begun(0.1, state=3.0).status == "completed"
    sliding = begun(0.1, kind="prismatic", axis=[1, 0, 0])
    np.testing.assert_allclose(sliding.joint_velocities["two"][-1], -0.7, rtol=SAME)


@pytest.mark.parametrize("kind", ["weld", "ball"])
def test_objects_that_couple_lose_the_energy_of_their_reduced_mass(kind):
    begin, end = 0.25, 0.5
    masses, speeds = [2.0, 3.5], [1.5, 0.2]
    table = objects_on_rails(masses, speeds, {"kind": kind, "from": begin})
    trajectory = simulate(table, end, [0.0, 0.2, *(begin + AFTER), end])
    speed, impulse, lost = couple(masses, speeds)
    (event,) = switches(trajectory)
    np.testing.assert_allclose(event["impulse"][:3], [impulse, 0.0, 0.0], atol=SAME)
    np.testing.assert_allclose(event["energy_loss"], lost, rtol=SAME)
    rates = np.array([trajectory.objects[f"cart{k}"].twist[:, 0] for k in (0, 1)])
    np.testing.assert_allclose(at_event(rates[:, 2:5].T), [speed, speed], rtol=SAME)
    np.testing.assert_allclose(masses @ rates, np.dot(masses, speeds), rtol=MOMENTUM)
    np.testing.assert_allclose(
        trajectory.objects["cart1"].position[-1, 0],
        1.0 + speeds[1] * begin + speed * (end - begin),
        rtol=SAME,
    )


# --- an object handed over ------------------------------------------------------------------------


def test_an_object_is_handed_over_between_arms_on_rails():
    """Constant accelerations while one arm holds it, both, and the other."""
    taken, left, end = 0.35, 0.8, 1.2
    masses, forces = {"giver": 2.0, "taker": 1.4}, {"giver": 6.0, "taker": -3.0}
    rails = {
        "giver": {"mass": 2.0, "velocity": 0.9, "x": 0.0, "joint": {"until": left}},
        "taker": {"mass": 1.4, "velocity": -0.4, "x": 0.8, "joint": {"from": taken}},
    }
    control = {"kind": "constant", "torques": {name: [f] for name, f in forces.items()}}
    table = carts(0.9, rails, control=control)
    times = np.unique([0.0, *np.linspace(0.05, end, 24), *(taken + AFTER), *(left + AFTER)])
    trajectory = simulate(table, end, times)

    def moved(x, v, a, t):
        return x + v * t + 0.5 * a * t**2, v + a * t

    total = 3.0 + sum(masses.values())
    of_giver, alone = forces["giver"] / 5.0, forces["taker"] / masses["taker"]
    x_object, v_object = moved(0.0, 0.9, of_giver, taken)
    x_taker, v_taker = moved(0.0, -0.4, alone, taken)
    speed, impulse, lost = couple((5.0, 1.4), (v_object, v_taker))
    together = sum(forces.values()) / total
    x_left, v_left = moved(x_object, speed, together, left - taken)
    held_on = forces["taker"] / 4.4

    def object_at(t):
        if t <= taken:
            return moved(0.0, 0.9, of_giver, t)
        if t <= left:
            return moved(x_object, speed, together, t - taken)
        return moved(x_left, v_left, held_on, t - left)

    exact = np.array([object_at(t) for t in times])
    np.testing.assert_allclose(trajectory.object_position[:, 0], exact[:, 0], atol=SAME)
    np.testing.assert_allclose(trajectory.object_twist[:, 0], exact[:, 1], atol=SAME)
    x_giver = moved(x_left, v_left, forces["giver"] / masses["giver"], end - left)
    np.testing.assert_allclose(trajectory.joint_positions["giver"][-1, 0], x_giver[0], atol=SAME)
    np.testing.assert_allclose(
        trajectory.joint_positions["taker"][-1, 0], x_taker + exact[-1, 0] - x_object, atol=SAME
    )
    rates = {name: trajectory.joint_velocities[name][:, 0] for name in masses}
    momentum = 3.0 * trajectory.object_twist[:, 0] + sum(m * rates[k] for k, m in masses.items())
    begin = 5.0 * 0.9 - 1.4 * 0.4
    np.testing.assert_allclose(momentum, begin + sum(forces.values()) * times, rtol=MOMENTUM)
    attached, detached = switches(trajectory)
    assert (attached["kind"], attached["arm"], attached["time"]) == ("attached", "taker", taken)
    assert (detached["kind"], detached["arm"], detached["time"]) == ("detached", "giver", left)
    np.testing.assert_allclose(attached["impulse"][0], -impulse, rtol=SAME)
    np.testing.assert_allclose(attached["energy_loss"], lost, rtol=SAME)
    assert detached["energy_loss"] == 0.0
    assert np.max(np.abs(trajectory.energy_balance)) < SAME
    assert np.max(trajectory.position_drift) < GAP
    # the forces of both hands on the object, in each phase
    giver, taker = (trajectory.wrenches[name][:, 0] for name in masses)
    for name, wrench in (("giver", giver), ("taker", taker)):
        both = (times > taken) & (times <= left)
        np.testing.assert_allclose(wrench[both], forces[name] - masses[name] * together, atol=1e-9)
    np.testing.assert_allclose(giver[times <= taken], 3.0 * of_giver, atol=1e-9)
    np.testing.assert_allclose(taker[times > left], 3.0 * held_on, atol=1e-9)
    assert not np.any(giver[times > left]) and not np.any(taker[times <= taken])


# --- pendulums that are caught --------------------------------------------------------------------

CAUGHT, SWING_END = 0.4, 0.9


def swing(angle, rate, moment, weight, duration):
    """Angle and rate of a pendulum at the end, ``weight`` its static moment [kg m]."""
    solution = solve_ivp(
        lambda t, y: [y[1], -FALL * weight / moment * np.sin(y[0])], (0.0, duration), [angle, rate],
        method="DOP853", rtol=3e-14, atol=1e-15,
    )  # fmt: skip
    return solution.y[:, -1]


def angle_and_rate(trajectory, k):
    """Those of the object at sample ``k``."""
    x, _, z = trajectory.object_position[k]
    return np.arctan2(-x, -z), trajectory.object_twist[k, 4]


def test_a_pendulum_caught_by_another_keeps_the_angular_momentum_about_the_pivot():
    """An arm of one hinge about the same pivot takes hold of it."""
    angle, rate, own, arm_rate = 0.7, -0.4, 0.3, 1.5
    # all mass of the arm is in the pivot
    arms = {"catcher": arm("Y", velocity=[arm_rate], mass=1.0, inertia=own)}
    joint = {"arm": "catcher", "name": "grip", "kind": "weld", "from": CAUGHT}
    times = [*(CAUGHT + AFTER), SWING_END]
    trajectory = simulate(pendulum(angle, rate, arms, [joint]), SWING_END, times)
    theta, omega = swing(angle, rate, ABOUT_PIVOT, BOB * LENGTH, CAUGHT)
    after = (ABOUT_PIVOT * omega + own * arm_rate) / (ABOUT_PIVOT + own)
    reduced = ABOUT_PIVOT * own / (ABOUT_PIVOT + own)
    (event,) = switches(trajectory)
    lost = 0.5 * reduced * (omega - arm_rate) ** 2
    np.testing.assert_allclose(event["energy_loss"], lost, rtol=SAME)
    rates = trajectory.object_twist[:3, 4]
    np.testing.assert_allclose(at_event(rates), after, rtol=SAME)
    np.testing.assert_allclose(
        at_event(trajectory.joint_velocities["catcher"][:3, 0]), after, rtol=SAME
    )
    # the impulsive moment about the pivot, from that about the centre; forces may share otherwise
    centre = -LENGTH * np.array([np.sin(theta), 0.0, np.cos(theta)])
    moment = event["impulse"][3:] + np.cross(centre, event["impulse"][:3])
    np.testing.assert_allclose(moment[1], own * (arm_rate - after), rtol=SAME)
    last = swing(theta, after, ABOUT_PIVOT + own, BOB * LENGTH, SWING_END - CAUGHT)
    np.testing.assert_allclose(angle_and_rate(trajectory, -1), last, atol=SAME)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9


def test_a_mass_caught_at_the_end_of_a_pendulum_adds_its_angular_momentum():
    """An arm that slides in the plane takes hold of the centre by a ball, and hangs on from it."""
    angle, rate, mass = 0.5, 1.2, 0.8
    velocity = np.array([-0.6, 0.9])  # along x and z
    theta, omega = swing(angle, rate, ABOUT_PIVOT, BOB * LENGTH, CAUGHT)
    arms = {"catcher": arm("xz", velocity=velocity.tolist(), mass=mass,
                           base={"xyz": [0.3, 0.0, -0.2]})}  # fmt: skip
    # where the mass is then, it falls: the joint holds it where it is
    place = np.array([0.3, -0.2]) + velocity * CAUGHT - [0.0, 0.5 * FALL * CAUGHT**2]
    speed = velocity - [0.0, FALL * CAUGHT]
    joint = {"arm": "catcher", "name": "grip", "kind": "ball", "from": CAUGHT}
    times = [*(CAUGHT + AFTER), SWING_END]
    trajectory = simulate(pendulum(angle, rate, arms, [joint]), SWING_END, times)
    x, z = place
    added = mass * (x**2 + z**2)
    momentum = mass * (z * speed[0] - x * speed[1])  # about y
    after = (ABOUT_PIVOT * omega + momentum) / (ABOUT_PIVOT + added)
    before = 0.5 * (ABOUT_PIVOT * omega**2 + mass * speed @ speed)
    (event,) = switches(trajectory)
    lost = before - 0.5 * (ABOUT_PIVOT + added) * after**2
    np.testing.assert_allclose(event["energy_loss"], lost, rtol=SAME)
    np.testing.assert_allclose(at_event(trajectory.object_twist[:3, 4]), after, rtol=SAME)
    now = after * np.array([z, -x])
    np.testing.assert_allclose(np.array(event["impulse"])[[0, 2]], mass * (speed - now), rtol=SAME)
    # both weights together, along the pendulum and across it
    sin, cos = np.sin(theta), np.cos(theta)
    static = np.array([BOB * LENGTH - mass * (x * sin + z * cos), mass * (z * sin - x * cos)])
    moment, offset = ABOUT_PIVOT + added, np.arctan2(static[1], static[0])
    last = swing(theta + offset, after, moment, np.hypot(*static), SWING_END - CAUGHT)
    np.testing.assert_allclose(angle_and_rate(trajectory, -1), last - [offset, 0.0], atol=SAME)


def test_a_pendulum_that_the_world_catches_stops():
    angle, rate = 0.6, -0.8
    joint = {"between": ["object", "world"], "name": "stop", "kind": "weld", "from": CAUGHT}
    times = [*(CAUGHT + AFTER), SWING_END]
    table = pendulum(angle, rate, {}, [joint], robots=ASIDE)
    trajectory = simulate(table, SWING_END, times)
    theta, omega = swing(angle, rate, ABOUT_PIVOT, BOB * LENGTH, CAUGHT)
    (event,) = switches(trajectory)
    np.testing.assert_allclose(event["energy_loss"], 0.5 * ABOUT_PIVOT * omega**2, rtol=SAME)
    assert np.max(np.abs(trajectory.object_twist)) < 1e-12
    np.testing.assert_allclose(angle_and_rate(trajectory, -1)[0], theta, atol=SAME)
