"""Hands that hold by friction alone: two UR5s lift a box between their fingertips."""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import GRAVITY, MASS, SQUEEZE, held_box, lifting, times

import multiarm as ma
from multiarm.dynamics.contact_geometry import block_inertias
from multiarm.events.evaluation import enter_mode_at


def simulate(mu: float, rise: float = 0.0, duration: float = 0.4):
    system = ma.compile_system(held_box(mu))
    return ma.simulate(
        system, duration, accuracy=1e-6, certificate=False, control=lifting(rise),
        max_step=0.05, output_step=0.002,
    )  # fmt: skip


def upward(trajectory) -> np.ndarray:
    """Force of all pads on the box, along the world's z, from Newton's law: m (a + g)."""
    speed, t = trajectory.object_twist[:, 2], trajectory.time
    return MASS * (np.gradient(speed, t) + GRAVITY)


def in_cone(trajectory, mu: float) -> bool:
    for name in ("left", "right"):
        force = trajectory.contact_forces[name]
        normal, drag = force[:, 0::3], np.hypot(force[:, 1::3], force[:, 2::3])
        if np.min(normal) < -1e-9 or np.max(drag - mu * normal) > 1e-8:
            return False
    return True


def test_two_hands_hold_a_box_by_friction_alone():
    trajectory = simulate(0.6)
    assert trajectory.status == "completed" and in_cone(trajectory, 0.6)
    assert len(times(trajectory, "slides")) == 0
    start = trajectory.object_position[0]
    np.testing.assert_allclose(trajectory.object_position, [start] * 201, atol=1e-5)
    for name in ("left", "right"):
        normal = trajectory.contact_forces[name][:, 0::3]
        np.testing.assert_allclose(np.sum(normal, axis=1), SQUEEZE, atol=0.1)


def test_two_hands_lift_a_box_and_newton_agrees():
    trajectory = simulate(0.6, rise=6.0)
    assert trajectory.status == "completed" and in_cone(trajectory, 0.6)
    assert trajectory.object_position[-1, 2] > trajectory.object_position[0, 2] + 0.005
    drag = sum(
        np.sum(np.abs(trajectory.contact_forces[name][:, 1::3]), axis=1)
        for name in ("left", "right")
    )
    # friction is along the tangent that is upright, as long as the box does not turn
    inside = slice(5, -5)
    np.testing.assert_allclose(drag[inside], upward(trajectory)[inside], rtol=2e-3)
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-5


@pytest.mark.parametrize("mu", [0.1, 0.2])
def test_a_box_slips_out_of_hands_that_press_too_little(mu):
    """Friction holds at most 2 mu times the squeeze: 8 N or 16 N of the 19.6 N that it weighs."""
    trajectory = simulate(mu, duration=0.1)
    assert trajectory.status == "completed" and in_cone(trajectory, mu)
    assert trajectory.object_position[-1, 2] < trajectory.object_position[0, 2] - 1e-3
    most = np.array(
        [
            mu * np.sum(trajectory.contact_forces[name][:, 0::3], axis=1)
            for name in ("left", "right")
        ]
    )
    inside = slice(5, -5)
    assert np.all(upward(trajectory)[inside] <= np.sum(most, axis=0)[inside] * (1 + 1e-3))
    states = trajectory.contact_states["left"]
    assert np.any(states == 2.0)  # sliding


def test_conditioning_of_sliding_hands_is_that_of_the_held_contacts():
    """The smallest pivot of W^T M^-1 W, scaled to a diagonal of 1; none where contacts are more."""
    system = ma.compile_system(held_box(0.3)).with_control(lifting(0.0))
    state = system.state(object_twist=[0, 0, -0.1, 0, 0, 0])
    evaluation, least = ma.evaluate(system, 0.0, state), {}
    assert any("sliding" in states for states in evaluation.contact_states.values())
    with system.borrow() as data:
        held = enter_mode_at(data, 0.0, state).data
        for i, arm in enumerate(system.arm_names):
            joints, contacts = (
                np.diff(held.work.first_joint)[i],
                np.diff(held.work.first_contact)[i],
            )
            M = block_inertias(held)[i]
            W = held.work.W[i, :joints, :contacts]
            K = W.T @ np.linalg.solve(M, W)
            scale = np.sqrt(np.diag(K))
            pivots = np.diag(np.linalg.cholesky(K / np.outer(scale, scale))) ** 2
            least[arm] = np.min(pivots, initial=1.0)
    assert min(least.values()) < 0.9
    assert evaluation.conditioning == pytest.approx(least, rel=1e-9)
