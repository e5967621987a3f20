"""Claims about contacts and friction whose answers mechanics knows in closed form."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from laws import box, frictions, held_motion, pushes, violation

from multiarm.events.complementarity import (
    Bounded,
    ContactMode,
    Friction,
    Push,
    Sliding,
    Verdict,
    solve,
)
from multiarm.events.transition import energy_added

G = 9.81  # [m/s^2]
EXACT = 1e-12


# one contact


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5, 4.0])
@pytest.mark.parametrize("mu", [0.2, 0.9])
@pytest.mark.parametrize("part", [0.0, 0.5, 0.999, 1.0 + 1e-7, 1.001, 3.0])
def test_a_block_sticks_below_the_bound_of_friction_and_slides_above(mu, part, angle):
    m = 3.0  # [kg]
    towards = np.array([np.cos(angle), np.sin(angle)])
    pull = part * mu * m * G
    solution = solve(np.eye(3) / m, [-G, *(pull / m * towards)], [Friction(0, (1, 2), mu)])
    assert solution.verdict in (Verdict.UNIQUE, Verdict.FOUND)
    friction = min(pull, mu * m * G)
    np.testing.assert_allclose(solution.forces, [m * G, *(-friction * towards)], atol=EXACT * m * G)
    if part < 1.0:
        assert solution.modes == (ContactMode.STICKING,) and solution.active_rows == (0, 1, 2)
        np.testing.assert_allclose(solution.rates, 0.0, atol=EXACT * G)
    else:
        assert solution.modes == (ContactMode.SLIDING,) and solution.active_rows == (0,)
        np.testing.assert_allclose(solution.directions[0], towards, atol=1e-10)
        slip = (pull - mu * m * G) / m
        np.testing.assert_allclose(solution.rates[1:], slip * towards, atol=EXACT * G)


def test_a_block_at_the_bound_of_friction_is_at_the_limit():
    """The event at which slip begins: the force is there, slip is not."""
    solution = solve(np.eye(3), [-10.0, 3.0, 4.0], [Friction(0, (1, 2), 0.5)])
    assert solution.modes == (ContactMode.AT_BOUND,) and solution.active_rows == (0,)
    np.testing.assert_allclose(solution.directions, [[0.6, 0.8]], atol=EXACT)
    np.testing.assert_allclose(solution.forces, [10.0, -3.0, -4.0], atol=1e-11)


@pytest.mark.parametrize("part", [0.5, 0.99, 1.01, 2.0])
def test_a_sphere_rolls_down_an_incline_up_to_seven_halves_mu(part):
    m, mu = 0.4, 0.3
    slope = np.arctan(part * 3.5 * mu)
    # spin 2/5 m r^2: the contact point gives way 1/m + r^2/I = 7/(2 m) along the plane
    D = np.diag([1.0, 3.5, 3.5]) / m
    b = np.array([-G * np.cos(slope), G * np.sin(slope), 0.0])
    solution = solve(D, b, [Friction(0, (1, 2), mu)])
    friction = min(2.0 / 7.0 * m * G * np.sin(slope), mu * m * G * np.cos(slope))
    np.testing.assert_allclose(solution.forces[1], -friction, rtol=1e-11)
    assert solution.modes == ((ContactMode.STICKING,) if part < 1.0 else (ContactMode.SLIDING,))
    downhill = G * np.sin(slope) - friction / m
    assert np.isclose(downhill, 5.0 / 7.0 * G * np.sin(slope)) == (part < 1.0)


@pytest.mark.parametrize("units", [[Push(0)], frictions(1, 0.5), [Sliding(0, (1, 2), 0.5, (1, 0))]])
def test_touching_without_force_is_resting(units):
    m = 1 if units == [Push(0)] else 3
    solution = solve(np.eye(m), np.zeros(m), units)
    assert solution.modes == (ContactMode.RESTING,) and solution.active_rows == ()
    assert solution.verdict is not Verdict.NONE and solution.residual == 0.0
    np.testing.assert_array_equal(solution.forces, 0.0)


# impacts


@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
def test_two_masses_rebound_as_newton_says(e):
    m1, m2, u1, u2 = 2.0, 5.0, 3.0, -1.0
    before = np.array([u2 - u1])
    solution = solve([[1 / m1 + 1 / m2]], (1 + e) * before, [Push(0)])
    impulse = (1 + e) * (u1 - u2) * m1 * m2 / (m1 + m2)
    np.testing.assert_allclose(solution.forces, impulse, rtol=EXACT)
    lost = 0.5 * (1 - e**2) * m1 * m2 / (m1 + m2) * (u1 - u2) ** 2
    after = before + solution.forces * (1 / m1 + 1 / m2)
    assert energy_added(solution.forces, before, after) == pytest.approx(-lost, abs=1e-12)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_three_balls_of_newtons_cradle_hit_at_once(e):
    """Balls that touch share the impulse: (1 + e) (2/3, 1/3); with e = 1 no energy is lost."""
    D, before = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.array([-1.0, 0.0])
    solution = solve(D, (1 + e) * before, pushes(2))
    np.testing.assert_allclose(solution.forces, (1 + e) * np.array([2.0, 1.0]) / 3.0, rtol=EXACT)
    p, q = solution.forces
    after = np.array([1.0 - p, p - q, q])
    added = energy_added(solution.forces, before, before + D @ solution.forces)
    assert added == pytest.approx(0.5 * (after @ after - 1.0), abs=1e-14)
    assert after @ after <= 1.0 + 1e-14 and np.isclose(after.sum(), 1.0)
    # together when plastic; the known answer of simultaneous impacts when elastic
    expected = {0.0: [1 / 3] * 3, 1.0: [-1 / 3, 2 / 3, 2 / 3]}
    if e in expected:
        np.testing.assert_allclose(after, expected[e], atol=1e-14)


def test_balls_apart_are_hit_one_after_the_other():
    """The limit of a small gap: one impact at a time passes the velocity on."""
    velocity = np.array([1.0, 0.0, 0.0])
    for k in (0, 1):
        before = velocity[k + 1 : k + 2] - velocity[k : k + 1]
        impulse = solve([[2.0]], 2.0 * before, [Push(0)]).forces[0]
        velocity[k : k + 2] += [-impulse, impulse]
    np.testing.assert_allclose(velocity, [0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("mu", [0.05, 0.5])
@pytest.mark.parametrize("e", [0.0, 0.8])
def test_a_ball_that_hits_obliquely_sticks_or_slides(mu, e):
    m, into, along = 0.2, 2.0, 3.0
    D = np.diag([1.0, 3.5, 3.5]) / m
    before = np.array([-into, 0.6 * along, 0.8 * along])
    free = before * [1 + e, 1.0, 1.0]
    solution = solve(D, free, [Friction(0, (1, 2), mu)])
    normal = (1 + e) * m * into
    friction = min(mu * normal, 2.0 / 7.0 * m * along)
    np.testing.assert_allclose(
        solution.forces, [normal, -0.6 * friction, -0.8 * friction], atol=1e-13
    )
    sticks = mu * normal > 2.0 / 7.0 * m * along
    assert solution.modes == ((ContactMode.STICKING,) if sticks else (ContactMode.SLIDING,))
    after = before + D @ solution.forces
    added = energy_added(solution.forces, before, after)
    assert added == pytest.approx(
        0.5 * (after @ np.linalg.solve(D, after) - before @ np.linalg.solve(D, before))
    )
    assert added < 0.0


def test_newtons_restitution_with_friction_can_add_energy():
    """A slanted rod whose slip reverses (after Kane): restitution is shifted in, friction helps."""
    s, c = np.sin(np.radians(55.0)), np.cos(np.radians(55.0))
    D = np.array(
        [[1 + 3 * c * c, 3 * s * c, 0.0], [3 * s * c, 1 + 3 * s * s, 0.0], [0.0, 0.0, 1.0]]
    )
    before = np.array([-1.0, -0.7, 0.0])
    grows = solve(D, before * [2.0, 1.0, 1.0], [Friction(0, (1, 2), 0.5)]).forces
    after = before + D @ grows
    added = 0.5 * (after @ np.linalg.solve(D, after) - before @ np.linalg.solve(D, before))
    assert added > 0.1
    assert energy_added(grows, before, after) == pytest.approx(added, rel=1e-10)
    loses = solve(D, before, [Friction(0, (1, 2), 0.5)]).forces
    assert energy_added(loses, before, before + D @ loses) < 0.0


# several contacts that share


def corner_forces(J, wrench):
    """Smallest forces that carry a wrench by pushing, by trying all sets of corners."""
    best = None
    for size in range(1, 5):
        for chosen in combinations(range(4), size):
            x = np.zeros(4)
            x[list(chosen)] = np.linalg.pinv(J[list(chosen)].T) @ -wrench
            carries = np.allclose(J.T @ x, -wrench, atol=1e-9) and np.min(x) > -1e-9
            if carries and (best is None or x @ x < best @ best - 1e-9):
                best = x
    return best


@pytest.mark.parametrize("at", [(0.0, 0.0), (0.2, 0.05), (0.3, 0.2), (0.45, 0.28), (-0.5, 0.0)])
def test_a_box_on_four_corners_shares_its_load_without_pulling(at):
    J, mobility = box(tangents=False)
    force = np.array([0.0, 0.0, -200.0])
    wrench = np.concatenate([force, np.cross([*at, 0.0], force)])
    D = J @ mobility @ J.T
    solution = solve(D, J @ mobility @ wrench, pushes(4))
    assert solution.verdict is Verdict.UNIQUE and not solution.forces_unique
    np.testing.assert_allclose(solution.forces, corner_forces(J, wrench), atol=1e-9)
    np.testing.assert_allclose(solution.rates, 0.0, atol=1e-12)
    resting = {k for k, mode in enumerate(solution.modes) if mode is ContactMode.RESTING}
    assert set(solution.active_rows) == {0, 1, 2, 3} - resting
    everything = -np.linalg.pinv(J.T) @ wrench
    assert bool(resting) == (np.min(everything) < 1e-9)


def test_a_box_loaded_beyond_its_edge_tips():
    J, mobility = box(tangents=False)
    wrench = np.array([0.0, 0.0, -200.0, 0.0, 120.0, 0.0])
    solution = solve(J @ mobility @ J.T, J @ mobility @ wrench, pushes(4))
    assert solution.modes == (ContactMode.CLOSED,) * 2 + (ContactMode.OPEN,) * 2
    assert solution.active_rows == (0, 1)


@pytest.mark.parametrize("push", [0.0, 40.0, 80.0, 90.0, 97.0, 98.1, 100.0, 150.0])
@pytest.mark.parametrize("mu", [0.5])
def test_a_pushed_box_sticks_up_to_mu_times_its_weight(push, mu):
    J, mobility = box(tangents=True)
    weight = 20.0 * G
    wrench = np.array([push, 0.0, -weight, 0.0, 0.1 * push, 0.0])
    D, b, units = J @ mobility @ J.T, J @ mobility @ wrench, frictions(4, mu)
    solution = solve(D, b, units)
    assert solution.message == "" and solution.residual < EXACT
    body = mobility @ (wrench + J.T @ solution.forces)
    speeds_up = max(push - mu * weight, 0.0) / 20.0
    np.testing.assert_allclose(body, [speeds_up, 0, 0, 0, 0, 0], atol=1e-10)
    assert violation(D, b, units, solution.forces) < EXACT
    np.testing.assert_allclose(held_motion(D, b, units, solution), solution.forces, atol=1e-8)
    sticking = [mode is ContactMode.STICKING for mode in solution.modes]
    assert any(sticking) == (push < mu * weight - 1e-6)
    if push == 90.0:
        # what the rear corners cannot hold the front ones do
        assert solution.modes == (ContactMode.STICKING,) * 2 + (ContactMode.AT_BOUND,) * 2


def test_a_light_corner_leaves_its_tangents_to_the_others():
    """The shared friction would be too much for the corner that bears little; three corners do."""
    J, mobility = box(tangents=True)
    force = np.array([30.0, 0.0, -200.0])
    wrench = np.concatenate([force, np.cross([0.2, 0.14, -0.2], force)])
    D, b, units = J @ mobility @ J.T, J @ mobility @ wrench, frictions(4, 0.5)
    solution = solve(D, b, units)
    assert solution.modes == (ContactMode.STICKING,) * 3 + (ContactMode.CLOSED,)
    assert 9 in solution.active_rows and not {10, 11} & set(solution.active_rows)
    np.testing.assert_allclose(held_motion(D, b, units, solution), solution.forces, atol=1e-9)


def test_rounding_of_the_response_does_not_change_what_a_box_does():
    """Matrices from a simulation carry rounding, so that dependent rows contradict a little."""
    rng = np.random.default_rng(3)
    J, mobility = box(tangents=True)
    wrench = np.array([60.0, 0.0, -20.0 * G, 0.0, 6.0, 0.0])
    D, b = J @ mobility @ J.T, J @ mobility @ wrench
    units = frictions(4, 0.5)
    exact = solve(D, b, units)
    for _ in range(50):
        noise = 1e-13 * rng.standard_normal((12, 12))
        near = solve(D + noise + noise.T, b * (1 + 1e-13 * rng.standard_normal(12)), units)
        assert near.modes == exact.modes and near.active_rows == exact.active_rows
        np.testing.assert_allclose(near.forces, exact.forces, atol=1e-7)


def grip(squeeze, torque, mu):
    """Two hands press four fingers each on the sides of a heavy box and carry its weight.

    Rows of eight contacts, mobility of the three bodies, forces without contacts.
    """
    mobility = np.diag([0.05] * 3 + [0.8, 0.5, 0.4] + ([1 / 3.0] * 3 + [20.0] * 3) * 2)
    rows = []
    for side, hand in ((-1.0, 6), (1.0, 12)):
        for y, z in [(-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)]:
            for axis in ([-side, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
                row = np.zeros(18)
                row[:6] = *axis, *np.cross([0.5 * side, y, z], axis)
                row[hand : hand + 6] = *np.negative(axis), *-np.cross([0.0, y, z], axis)
                rows.append(row)
    forces = np.zeros(18)
    forces[[2, 4, 6, 8, 12, 14]] = -20.0 * G, torque, squeeze, 10.0 * G, -squeeze, 10.0 * G
    J = np.array(rows)
    return J @ mobility @ J.T, J @ mobility @ forces, frictions(8, mu)


@pytest.mark.parametrize(("squeeze", "slips"), [(400.0, 0), (197.0, 0), (190.0, 8)])
def test_a_box_between_two_hands_is_held_while_friction_carries_its_weight(squeeze, slips):
    """Eight fingers of coefficient 1/2 carry what both hands press with: squeeze >= weight."""
    D, b, units = grip(squeeze, 0.0, 0.5)
    solution = solve(D, b, units)
    assert solution.modes == ((ContactMode.SLIDING,) if slips else (ContactMode.STICKING,)) * 8
    np.testing.assert_allclose(solution.forces[::3], squeeze / 4.0, rtol=1e-10)
    friction = min(20.0 * G / 8.0, 0.5 * squeeze / 4.0)
    np.testing.assert_allclose(solution.forces[2::3], friction, rtol=1e-10)


def test_a_box_between_two_hands_that_is_turned_slips_on_one_side_first():
    modes = {torque: solve(*grip(250.0, torque, 0.5)).modes for torque in (20.0, 60.0, 100.0)}
    assert set(modes[20.0]) == {ContactMode.STICKING}
    assert set(modes[60.0]) == {ContactMode.STICKING, ContactMode.AT_BOUND}
    assert modes[100.0] == (ContactMode.STICKING,) * 4 + (ContactMode.SLIDING,) * 4
    for torque in modes:
        D, b, units = grip(250.0, torque, 0.5)
        solution = solve(D, b, units)
        np.testing.assert_allclose(held_motion(D, b, units, solution), solution.forces, atol=1e-9)


# dry friction of joints at rest


@pytest.mark.parametrize("load", [0.5, 2.0, 4.5, 5.9, 6.1, -5.9])
def test_stuck_joints_of_a_closed_chain_share_a_load_up_to_the_sum_of_their_bounds(load):
    """One freedom, four joints with rates a: the load per freedom is held up to sum |a| bound.

    The smallest torques are in proportion to a, until one is at its bound.
    """
    a, bound = np.array([1.0, -2.0, 0.5, 1.0]), np.array([1.0, 1.0, 2.0, 2.0])
    units = [Bounded(k, -bound[k], bound[k]) for k in range(4)]
    solution = solve(np.outer(a, a), a * load, units)
    assert solution.verdict is Verdict.UNIQUE
    holds = abs(load) < np.abs(a) @ bound
    assert np.allclose(solution.rates, 0.0, atol=1e-12) == holds
    if not holds:
        assert set(solution.modes) <= {ContactMode.AT_LOWER, ContactMode.AT_UPPER}
        assert solution.active_rows == ()
        np.testing.assert_allclose(solution.forces, -np.sign(a * load) * bound)
        return
    # the level of water: torques -t a, cut at the bounds
    low, high = 0.0, 10.0
    for _ in range(200):
        level = (low + high) / 2.0
        carried = np.abs(a) @ np.minimum(level * np.abs(a), bound)
        low, high = (level, high) if carried < abs(load) else (low, level)
    expected = -np.sign(a * load) * np.minimum(level * np.abs(a), bound)
    np.testing.assert_allclose(solution.forces, expected, atol=1e-11)
    full = [k for k in range(4) if abs(expected[k]) > bound[k] - 1e-9]
    assert solution.active_rows == tuple(k for k in range(4) if k not in full)


def test_a_joint_without_bounds_is_held_and_one_without_friction_is_not():
    D = np.array([[2.0, 1.0], [1.0, 2.0]])
    units = [Bounded(0, -np.inf, np.inf), Bounded(1, 0.0, 0.0)]
    solution = solve(D, [-4.0, 1.0], units)
    np.testing.assert_allclose(solution.forces, [2.0, 0.0])
    np.testing.assert_allclose(solution.rates, [0.0, 3.0])
    assert solution.modes == (ContactMode.HOLDING, ContactMode.AT_LOWER)
    assert solution.active_rows == (0,)


def test_a_stop_takes_what_dry_friction_cannot():
    """One joint pushed against its limit: friction at its bound, the stop the rest."""
    solution = solve(np.ones((2, 2)), [-5.0, -5.0], [Push(0), Bounded(1, -1.0, 1.0)])
    np.testing.assert_allclose(solution.forces, [4.0, 1.0])
    assert solution.modes == (ContactMode.CLOSED, ContactMode.AT_UPPER)
    assert solution.active_rows == (0,)
