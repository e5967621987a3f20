"""Contacts that give way: springs and dampers in place of constraints."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loose_scenes import ball_on_cart, cart_with_box, happened
from mechanics import ur5_pair
from scipy.optimize import brentq

import multiarm as ma

GRAVITY = 9.81


def run(data: dict, **how):
    return ma.simulate(ma.compile_system(ma.Scene(**data)), certificate=False, **how)


def soft(stiffness: float, damping: float = 0.0, **more) -> dict:
    return {"contact_compliance": {"stiffness": stiffness, "damping": damping, **more}}


def test_a_ball_bounces_on_a_contact_spring_as_in_closed_form(tmp_path):
    height, stiffness = 0.1, 1e4
    effects = soft(stiffness) | {"unilateral_contacts": {"start": "as_written"}}
    trajectory = run(ball_on_cart(tmp_path, effects, height=height), duration=0.3)
    touches, lets_go = happened(trajectory)[:2]
    speed, omega = math.sqrt(2 * GRAVITY * height), math.sqrt(stiffness)
    begin = math.sqrt(2 * height / GRAVITY)

    def gap(t):
        return GRAVITY / omega**2 * (math.cos(omega * t) - 1) - speed / omega * math.sin(omega * t)

    end = brentq(gap, 0.5 * math.pi / omega, 1.5 * math.pi / omega, xtol=1e-15)
    assert (touches["kind"], lets_go["kind"]) == ("touches", "lets go")
    assert touches["time"] == pytest.approx(begin, abs=1e-11)
    assert lets_go["time"] == pytest.approx(begin + end, abs=1e-9)
    pressed = (trajectory.time > begin) & (trajectory.time < begin + end)
    expected = [-stiffness * gap(t - begin) for t in trajectory.time[pressed]]
    force = trajectory.contact_forces["cart"][:, 0]
    np.testing.assert_allclose(force[pressed], expected, atol=1e-5)
    assert np.all(force[~pressed & (trajectory.time < begin + end + 0.1)] == 0.0)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-8


def test_a_damped_contact_lets_go_where_its_force_ends_and_not_where_it_is_relaxed(tmp_path):
    height, stiffness, damping = 0.1, 1e4, 60.0
    effects = soft(stiffness, damping) | {"unilateral_contacts": {"start": "as_written"}}
    trajectory = run(ball_on_cart(tmp_path, effects, height=height), duration=0.25)
    touches, lets_go = happened(trajectory)[:2]
    speed, decay = math.sqrt(2 * GRAVITY * height), damping / 2
    omega = math.sqrt(stiffness - decay**2)

    def motion(t):
        """Gap and rate of m x'' = -k x - d x' - m g, mass 1, from x = 0 with -speed."""
        rest = -GRAVITY / stiffness
        a, b = -rest, (-speed - rest * decay) / omega
        swing = math.exp(-decay * t)
        x = a * math.cos(omega * t) + b * math.sin(omega * t)
        rate = omega * (b * math.cos(omega * t) - a * math.sin(omega * t)) - decay * x
        return rest + swing * x, swing * rate

    def force(t):
        x, rate = motion(t)
        return -(stiffness * x + damping * rate)

    end = brentq(force, 0.3 * math.pi / omega, 1.2 * math.pi / omega, xtol=1e-15)
    assert motion(end)[0] < -1e-4  # still pressed in
    assert lets_go["time"] - touches["time"] == pytest.approx(end, abs=1e-9)
    assert np.min(trajectory.contact_forces["cart"]) >= 0.0
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-8


def test_a_pressed_contact_oscillates_and_decays(tmp_path):
    """A ball set down on its spring: never apart, about the static depth, with d / 2 m."""
    stiffness, damping = 2e3, 4.0
    trajectory = run(ball_on_cart(tmp_path, soft(stiffness, damping)), duration=0.8)
    assert happened(trajectory) == []
    depth, decay = GRAVITY / stiffness, damping / 2
    omega = math.sqrt(stiffness - decay**2)
    t = trajectory.time
    swing = np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    np.testing.assert_allclose(
        trajectory.object_position[:, 2] - 0.05, depth * (swing - 1), atol=1e-9
    )


def test_runs_of_one_system_do_not_press_the_springs_of_each_other(tmp_path):
    system = ma.compile_system(ma.Scene(**ball_on_cart(tmp_path, soft(2e3))))
    alone = ma.Stepper(system).advance(0.02)
    first, second = ma.Stepper(system), ma.Stepper(system)
    second.advance(0.01)
    after = first.advance(0.02)
    np.testing.assert_array_equal(after.position, alone.position)
    np.testing.assert_array_equal(after.velocity, alone.velocity)


def test_a_contact_that_pulls_away_at_the_start_opens_at_once(tmp_path):
    effects = soft(1e4) | {"unilateral_contacts": {"start": "as_written"}}
    data = ball_on_cart(tmp_path, effects, twist=(0, 0, 0.5, 0, 0, 0))
    trajectory = run(data, duration=0.05)
    height = 0.05 + 0.5 * trajectory.time - 0.5 * GRAVITY * trajectory.time**2
    np.testing.assert_allclose(trajectory.object_position[:, 2], height, atol=1e-9)


def tip(name: str, at: list[float], normal: list[float]) -> dict:
    """A fingertip that pushes a face of the object, with outward normal, at a point."""
    radius = 0.01
    centre = [p + radius * n for p, n in zip(at, normal, strict=True)]
    return {
        "arm": {"sphere": {"center": centre, "radius": radius}},
        "object": {"plane": {"point": at, "normal": normal}},
        "name": name,
    }


def table(points: list[tuple[float, float]]) -> list[dict]:
    """Legs below the object's lower face, and pairs of tips that hold it sideways."""
    tips = [tip(f"leg {k + 1}", [x, y, 0], [0, 0, -1]) for k, (x, y) in enumerate(points)]
    for side in (-1, 1):
        for y in (-0.2, 0.2):
            tips.append(tip(f"end {side} at {y}", [0.4 * side, y, 0], [side, 0, 0]))
        tips.append(tip(f"flank {side}", [0, 0.3 * side, 0], [0, side, 0]))
    return tips


def test_a_redundant_grasp_shares_a_load_by_the_stiffness_of_its_contacts(tmp_path):
    """Four legs carry a weight off their middle: as a plate on equal springs does."""
    points = [(-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2)]
    x, y, mass, stiffness = 0.1, -0.05, 4.0, 1e5
    joint = {
        "arm": "cart",
        "kind": "contacts",
        "contacts": table(points),
        "at": {"xyz": [-x, -y, 0.0]},
        "at_tip": {"xyz": [0, 0, 0.3]},
    }
    data = cart_with_box(
        tmp_path,
        soft(stiffness, 400.0),
        joints=[joint],
        gravity=[0, 0, -GRAVITY],
        control={"kind": "constant", "torques": {"cart": 0.0}},
    )
    data["object"] = {
        "shape": {"box": [0.8, 0.6, 0.1]},
        "mass": mass,
        "pose": {"xyz": [x, y, 0.3]},
    }
    trajectory = run(data, duration=0.5, accuracy=1e-7)
    assert trajectory.status == "completed", trajectory.message
    force = trajectory.contact_forces["cart"][-1]
    lever = np.array(points)
    design = np.column_stack([np.ones(4), lever])  # depth of a stiff plate at each leg
    expected = design @ np.linalg.solve(design.T @ design, mass * GRAVITY * np.array([1, x, y]))
    # the tilt of half a milliradian shifts the load a little
    np.testing.assert_allclose(force[:4], expected, rtol=2e-3)
    assert np.sum(force[:4]) == pytest.approx(mass * GRAVITY, rel=1e-5)


def test_stiff_contacts_tend_to_the_rigid_scene(tmp_path):
    """A weld of springs between cart and box: the motion differs by the order of 1 / k."""
    control = {"kind": "harmonic", "amplitude": {"cart": 5.0}, "frequency": 1.0, "hold": False}
    rigid = run(cart_with_box(tmp_path, {}, control=control), duration=0.5)
    apart = []
    for stiffness in (1e5, 1e6):
        effects = soft(stiffness, 2 * math.sqrt(stiffness))
        trajectory = run(cart_with_box(tmp_path, effects, control=control), duration=0.5)
        assert trajectory.status == "completed", trajectory.message
        gap = trajectory.joint_positions["cart"] - rigid.joint_positions["cart"]
        apart.append(np.max(np.abs(gap)))
        assert np.max(np.abs(trajectory.energy_balance)) < 1e-8
    assert apart[0] < 1e-3
    assert apart[1] == pytest.approx(0.1 * apart[0], rel=0.2)


def test_a_very_stiff_scene_is_handed_to_the_stiff_method_and_certified(tmp_path):
    effects = soft(1e9, 1e6)
    data = ball_on_cart(tmp_path, effects, run={"duration": 0.5, "accuracy": 1e-6})
    trajectory = ma.simulate(ma.compile_system(ma.Scene(**data)))
    assert trajectory.status == "completed", trajectory.message
    assert trajectory.statistics["integrator"] == "rodas5p"
    assert trajectory.certificate["met"]


def test_compliant_grasps_of_two_robots_keep_their_balance_of_work():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}).replace(
        effects={"contact_compliance": {"stiffness": 2e5, "damping": 2e3}}
    )
    trajectory = ma.simulate(ma.compile_system(scene), duration=0.1, accuracy=1e-6)
    assert trajectory.status == "completed", trajectory.message
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-4
    evaluation = ma.evaluate(ma.compile_system(scene))
    assert all(np.all(unique) for unique in evaluation.contact_forces_unique.values())


def test_an_evaluation_has_the_forces_of_springs_as_they_are_pressed(tmp_path):
    system = ma.compile_system(ma.Scene(**ball_on_cart(tmp_path, soft(1e4, 30.0))))
    pressed = system.state(object_position=[0, 0, 0.049], object_twist=[0, 0, -0.1, 0, 0, 0])
    evaluation = ma.evaluate(system, 0.0, pressed)
    assert evaluation.contact_forces["cart"] == pytest.approx([1e4 * 1e-3 + 30.0 * 0.1])
    assert evaluation.contact_states == {"cart": ("touching",)}
    assert evaluation.object_acceleration[2] == pytest.approx(13.0 - GRAVITY)
    apart = system.state(object_position=[0, 0, 0.051])
    evaluation = ma.evaluate(system, 0.0, apart)
    assert evaluation.contact_forces["cart"] == pytest.approx([0.0])
    assert evaluation.contact_states == {"cart": ("open",)}


def test_inverse_dynamics_holds_compliant_contacts_and_leaves_their_springs_out():
    rigid = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    results = []
    for scene in (rigid, rigid.replace(effects=soft(1e5, 50.0))):
        system = ma.compile_system(scene)
        start = system.initial_state()
        moved = system.state(object_position=start.object_position + [2e-4, 0.0, 1e-4])
        results.append(ma.inverse_dynamics(system, moved, [0.1, 0, 0.2, 0, 0.1, 0]))
    for arm, torques in results[0].torques.items():
        np.testing.assert_allclose(results[1].torques[arm], torques, atol=1e-8)
        forces = [result.contact_forces[arm] for result in results]
        np.testing.assert_allclose(forces[1], forces[0], atol=1e-8)
