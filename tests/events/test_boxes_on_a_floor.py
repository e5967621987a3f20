"""Boxes on a floor: they rest, slide and spin, tip, rock and tumble; what they bear."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import GRAVITY, ball, box, fall_time, on_floor, run, times
from scipy.integrate import solve_ivp

CORNERS = [(x, y) for x in (-1, 1) for y in (-1, 1)]


def lower_corners(sizes) -> np.ndarray:
    """Of a box, about its centre, shape (4, 3)."""
    half = np.array(sizes) / 2
    return np.array([(x * half[0], y * half[1], -half[2]) for x, y in CORNERS])


def held_shares(points: np.ndarray, weight: float, mu: float, ways: np.ndarray) -> np.ndarray:
    """Smallest loads of points with friction against ``ways`` that keep a body level."""
    drag = -mu * ways  # for a unit load, (N, 2)
    x, y, z = points.T
    moment_x = y * 1.0 - z * drag[:, 1]
    moment_y = z * drag[:, 0] - x * 1.0
    rows = np.array([np.ones(len(points)), moment_x, moment_y])
    return np.linalg.lstsq(rows, np.array([weight, 0.0, 0.0]), rcond=None)[0]


@pytest.mark.parametrize(
    ("size", "mass", "speed", "spin"),
    [(1.0, 2.0, 1.0, 5.0), (0.01, 1e-3, 0.1, 30.0), (10.0, 2e3, 3.0, 1.5)],
)
def test_a_box_that_slides_and_spins_follows_scipy(size, mass, speed, spin):
    """Four corners share the load as the smallest forces do, from grams to tonnes."""
    sizes, mu = size * np.array([0.4, 0.3, 0.2]), 0.3
    twist = [speed, 0.2 * speed, 0, 0, 0, spin]
    accuracy = 1e-8 * size
    slid = box(sizes.tolist(), mass, twist=twist)
    trajectory = run(on_floor(slid, mu=mu), 1.5, accuracy)
    inertia = mass * (sizes[0] ** 2 + sizes[1] ** 2) / 12
    corners = lower_corners(sizes)

    def motion(t, y):
        c, s = math.cos(y[2]), math.sin(y[2])
        arms = np.column_stack([corners[:, :2] @ [c, -s], corners[:, :2] @ [s, c], corners[:, 2]])
        slip = y[3:5] + y[5] * np.column_stack([-arms[:, 1], arms[:, 0]])
        ways = slip / np.linalg.norm(slip, axis=1)[:, None]
        load = held_shares(arms, mass * GRAVITY, mu, ways)
        drag = -mu * load[:, None] * ways
        turn = np.sum(arms[:, 0] * drag[:, 1] - arms[:, 1] * drag[:, 0])
        return [*y[3:], *(np.sum(drag, axis=0) / mass), turn / inertia]

    # the corners stop together; one that friction does not need may rest without a word
    stop = times(trajectory, "sticks")
    assert len(stop) >= 1 and np.ptp(stop) < 1e-6
    until = trajectory.time < 0.97 * stop[0]
    start = [0, 0, 0, speed, 0.2 * speed, spin]
    exact = solve_ivp(
        motion, (0, trajectory.time[until][-1]), start, "DOP853",
        t_eval=trajectory.time[until], rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(
        trajectory.object_position[until, :2], exact.y[:2].T, atol=3.0 * accuracy
    )
    z, w = trajectory.object_quaternion_xyzw[until, 2:].T
    np.testing.assert_allclose(2 * np.arctan2(z, w), exact.y[2], atol=max(1e-7, 3.0 * accuracy))
    friction = trajectory.channel("effects/contact_friction/work")[-1]
    energy = 0.5 * mass * 1.04 * speed**2 + 0.5 * inertia * spin**2
    assert friction == pytest.approx(-energy, rel=1e-7)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_box_that_falls_flat_hits_with_four_corners_at_once(restitution):
    trajectory = run(on_floor(box(height=0.3), restitution, 0.4), 2.0)
    hits = times(trajectory)
    assert np.ptp(hits[:4]) == 0.0
    assert hits[0] == pytest.approx(fall_time(0.3), abs=1e-9)
    share = 2.0 * (1 + restitution) * GRAVITY * fall_time(0.3) / 4
    for event in trajectory.events[:4]:
        assert event["after"]["impulse_N_s"] == pytest.approx(share, abs=1e-9)
    np.testing.assert_allclose(trajectory.object_position[-1], [0, 0, 0.1], atol=1e-9)
    np.testing.assert_allclose(trajectory.contact_forces["floor"][-1, 1::3], 0.0, atol=1e-9)


def leaning(tilt: float, sizes=(0.2, 0.3, 0.6), mass=3.0):
    """A box that stands on an edge along y, leaning by ``tilt`` towards x."""
    c, s = math.cos(tilt), math.sin(tilt)
    edge = np.array([[c, s], [-s, c]]) @ [sizes[0] / 2, -sizes[2] / 2]
    pose = {"xyz": [-edge[0], 0, -edge[1]], "rpy": [0, tilt, 0]}
    return {"shape": {"box": list(sizes)}, "mass": mass, "pose": pose}


def pendulum_time(start: float, end: float, rate2: float) -> float:
    """Of an inverted pendulum from rest at ``start`` [rad] to ``end``; rate2 is m g d / I."""
    swing = lambda t, y: [y[1], rate2 * math.sin(y[0])]  # noqa: E731
    arrive = lambda t, y: y[0] - end  # noqa: E731
    arrive.terminal = True
    result = solve_ivp(swing, (0, 9), [start, 0], "DOP853", events=arrive, rtol=1e-12, atol=1e-13)
    return float(result.t_events[0][0])


def test_a_box_that_leans_rocks_from_edge_to_edge_and_loses_what_it_must():
    """Each landing keeps the angular momentum about the new edge (Housner 1963)."""
    a, h, m, tilt = 0.1, 0.3, 3.0, 0.2
    distance, lean = math.hypot(a, h), math.atan2(a, h)
    about_centre = m * (0.2**2 + 0.6**2) / 12
    about_edge = about_centre + m * distance**2
    rate2 = m * GRAVITY * distance / about_edge
    trajectory = run(on_floor(leaning(tilt), mu=1.0), 1.2)
    landings = [event for event in trajectory.events if event["kind"] == "touches"]
    first = pendulum_time(tilt - lean, -lean, rate2)
    assert landings[0]["time"] == landings[1]["time"] == pytest.approx(first, abs=1e-8)
    rate = math.sqrt(2 * rate2 * (math.cos(tilt - lean) - math.cos(lean)))
    kept = 1.0 - 2.0 * m * a**2 / about_edge
    for k, landing in enumerate(landings[0:6:2]):
        closing = 2 * a * rate * kept**k
        assert landing["before"]["gap_rate_m_s"] == pytest.approx(-closing, abs=1e-7)
    lost = 0.5 * about_edge * rate**2 * (1 - kept**2)
    between = (trajectory.time > first) & (trajectory.time < landings[2]["time"])
    work = trajectory.channel("effects/impacts/work")[between]
    np.testing.assert_allclose(work, -lost, atol=1e-7)


def test_a_box_that_leans_too_far_tips_over_its_edge():
    """On a very rough floor it turns about its edge until it slips."""
    tilt, mu = 0.4, 1.0
    distance, lean = math.hypot(0.1, 0.3), math.atan2(0.1, 0.3)
    about_edge = 3.0 * (0.2**2 + 0.6**2) / 12 + 3.0 * distance**2
    rate2 = 3.0 * GRAVITY * distance / about_edge
    trajectory = run(on_floor(leaning(tilt), mu=mu), 0.9, 1e-6)

    def motion(t, y):
        return [y[1], rate2 * math.sin(y[0])]

    def cone(t, y):
        along = distance * (motion(t, y)[1] * math.cos(y[0]) - y[1] ** 2 * math.sin(y[0]))
        up = -distance * (motion(t, y)[1] * math.sin(y[0]) + y[1] ** 2 * math.cos(y[0]))
        return mu * (GRAVITY + up) - abs(along)

    cone.terminal = True
    exact = solve_ivp(motion, (0, 1), [tilt - lean, 0], "DOP853", events=cone, rtol=1e-12)
    slides = times(trajectory, "slides")
    assert slides[0] == pytest.approx(exact.t_events[0][0], abs=1e-6)
    # it falls on its side: the long face is down in the end
    np.testing.assert_allclose(trajectory.object_position[-1, 2], 0.1, atol=1e-6)


@pytest.mark.parametrize(("restitution", "mu"), [(0.0, 0.4), (0.0, 1.0), (0.6, None)])
def test_a_tumbling_box_breaks_no_law(restitution, mu):
    thrown = box(rpy=(0.6, 0.5, 0.1), height=0.8, twist=[2, 0.2, 0, 5, 2, 1])
    trajectory = run(on_floor(thrown, restitution, mu), 2.0, 1e-7, output_step=0.002)
    assert trajectory.status == "completed"
    force = trajectory.contact_forces["floor"]
    normal = force if mu is None else force[:, 0::3]
    assert np.min(normal) >= -1e-10
    if mu is not None:
        assert np.max(np.hypot(force[:, 1::3], force[:, 2::3]) - mu * normal) <= 1e-9
    gaps = corner_heights(trajectory, (0.4, 0.3, 0.2))
    assert np.min(gaps) > -1e-8
    assert np.max(np.abs(normal * gaps)) < 1e-6
    energy = trajectory.energy
    assert np.max(np.diff(energy)) < 1e-7
    assert energy[-1] < 0.9 * energy[0]
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-6
    assert np.max(trajectory.position_drift) < 1e-9


def corner_heights(trajectory, sizes) -> np.ndarray:
    """Heights of the eight corners, in the order of the floor's contacts, shape (K, 8)."""
    from itertools import product

    from scipy.spatial.transform import Rotation

    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * np.array(sizes)
    turn = Rotation.from_quat(trajectory.object_quaternion_xyzw).as_matrix()
    return trajectory.object_position[:, 2, None] + (turn @ corners.T)[:, 2]


def test_points_share_the_weight_with_the_smallest_forces():
    """Five feet, none of them in the middle: statics and least squares."""
    feet = np.array([[0.2, 0.1, -0.1], [-0.2, 0.15, -0.1], [-0.15, -0.1, -0.1], [0.1, -0.15, -0.1]])
    feet = np.vstack([feet, [0.05, 0.12, -0.1]])
    trajectory = run(on_floor(box(), floor={"points": feet.tolist()}), 0.1)
    expected = held_shares(feet, 2.0 * GRAVITY, 0.0, np.zeros((5, 2)))
    assert np.all(expected > 0.0)
    force = trajectory.contact_forces["floor"]
    np.testing.assert_allclose(force, np.tile(expected, (len(force), 1)), atol=1e-9)


def test_a_foot_that_cannot_pull_lets_the_box_topple():
    """Feet on one side of the centre of mass only: it falls over them at once."""
    feet = [[0.2, 0.1, -0.1], [0.2, -0.1, -0.1], [0.05, 0.0, -0.1]]
    trajectory = run(on_floor(box(), floor={"points": feet}), 0.05)
    height, inertia = 0.05, 2.0 * (0.4**2 + 0.2**2) / 12
    force = 2.0 * GRAVITY / (1.0 + 2.0 * height**2 / inertia)
    np.testing.assert_allclose(trajectory.contact_forces["floor"][0], [0, 0, force], atol=1e-9)


def test_far_from_the_origin_a_bounce_is_the_same():
    near = run(on_floor(ball(height=0.5), 0.5), 1.2)
    far_ball = ball(height=0.5)
    far_ball["pose"] = {"xyz": [300.0, -200.0, 100.55]}
    floor = {"at": {"xyz": [300.0, -200.0, 100.0]}}
    far = run(on_floor(far_ball, 0.5, floor=floor), 1.2)
    np.testing.assert_allclose(times(far)[:8], times(near)[:8], atol=1e-9)
    moved = far.object_position - [300.0, -200.0, 100.0]
    np.testing.assert_allclose(moved, near.object_position, atol=1e-8)


@pytest.mark.parametrize("mass", [1e-3, 1e3])
def test_masses_change_forces_and_no_motion(mass):
    thrown = {"rpy": (0.6, 0.5, 0.1), "height": 0.5, "twist": [1, 0.2, 0, 3, 2, 1]}
    light = run(on_floor(box(mass=1.0, **thrown), 0.3), 0.8)
    other = run(on_floor(box(mass=mass, **thrown), 0.3), 0.8)
    assert len(times(light)) == len(times(other)) > 3
    np.testing.assert_allclose(times(other), times(light), atol=1e-7)
    np.testing.assert_allclose(other.object_position, light.object_position, atol=1e-7)
