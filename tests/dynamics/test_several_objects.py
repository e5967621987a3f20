"""Claims about evaluations of scenes with several objects.

Oracles: closed forms, and dense algebra in minimal and maximal coordinates (``tree_oracle``).
"""

from __future__ import annotations

import numpy as np
import pytest
from object_scenes import (
    GRAVITY,
    PENDULUM,
    PLATE,
    double_pendulum,
    hinged_plates,
    peg_acceleration,
    peg_in_socket,
    pendulum_accelerations,
)
from tree_models import read_tree_scene, start_of
from tree_oracle import TreeSolution, solve_minimal, worst_gap

ANGLES, RATES = [0.4, -0.9], [1.1, -0.6]
ROUNDING = 1e-12


def reference(scene) -> TreeSolution:
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    assert worst_gap(trees, state) < ROUNDING
    return solve_minimal(trees, state, {})


# --- closed forms --------------------------------------------------------------------------------


@pytest.mark.parametrize("solved", [reference])
def test_a_double_pendulum_of_objects_is_that_of_textbooks(solved):
    solution = solved(double_pendulum(ANGLES, RATES))
    expected = pendulum_accelerations(np.array(ANGLES), np.array(RATES))
    accelerations = solution.object_accelerations
    angular = [accelerations[name][4] for name in ("upper", "lower")]
    np.testing.assert_allclose(angular, expected, rtol=ROUNDING)
    # Newton's law of both objects together: the pin pulls the world with what holds them
    force = sum(
        m * (np.array([0.0, 0.0, -GRAVITY]) - accelerations[name][:3])
        for m, name in zip(PENDULUM["m"], ("upper", "lower"), strict=True)
    )
    np.testing.assert_allclose(solution.wrenches["pin"][:3], force, atol=ROUNDING * 100.0)


@pytest.mark.parametrize("solved", [reference])
def test_plates_on_a_hinge_beat_like_wings(solved):
    angle, rate = 0.3, 1.0
    accelerations = solved(hinged_plates(angle, rate)).object_accelerations
    m, I, a = PLATE.values()
    inertia = I + m * a**2 * np.cos(angle) ** 2
    expected = m * a**2 * np.cos(angle) * np.sin(angle) * rate**2 / inertia
    assert accelerations["left"][5] == pytest.approx(expected, rel=ROUNDING)
    np.testing.assert_allclose(
        accelerations["right"], [1, -1, 1, 1, 1, -1] * accelerations["left"], atol=ROUNDING
    )


@pytest.mark.parametrize("solved", [reference])
@pytest.mark.parametrize("kind", ["prismatic", "cylindrical"])
def test_a_peg_is_thrown_out_of_a_socket_that_turns(kind, solved):
    out, spin = 0.5, 1.5
    accelerations = solved(peg_in_socket(kind, out, 0.2, spin)).object_accelerations
    seen_at_rest = accelerations["peg"][0] - accelerations["socket"][0]
    outward, _ = peg_acceleration(out, spin, out)
    assert seen_at_rest + out * spin**2 == pytest.approx(outward, rel=ROUNDING)
