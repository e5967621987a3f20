"""Claims about evaluations of scenes with several objects.

Oracles: closed forms.  That random scenes agree with dense algebra is among the claims of
``test_tree_oracle.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from object_scenes import (
    GRAVITY,
    PENDULUM,
    PLATE,
    SLED,
    double_pendulum,
    hinged_plates,
    load_on_sled,
    peg_acceleration,
    peg_in_socket,
    pendulum_accelerations,
)
from random_trees import OF_SEVERAL_OBJECTS, draw_trees
from tree_models import constant_torques, read_tree_scene, start_of
from tree_oracle import TreeSolution, solve_minimal, worst_gap

import multiarm as ma
from multiarm.errors import ModelError
from multiarm.scene import parse_scene

ROUNDING = 1e-12
PER_FAMILY = 4
ANGLES, RATES = [0.4, -0.9], [1.1, -0.6]


def system_of(scene: dict[str, Any]) -> ma.System:
    return ma.compile_system(parse_scene(scene))


def reference(scene: dict[str, Any]) -> TreeSolution:
    """The solution of dense algebra."""
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    assert worst_gap(trees, state) < ROUNDING
    return solve_minimal(trees, state, constant_torques(scene, trees))


def node(scene: dict[str, Any]) -> ma.Evaluation:
    return ma.evaluate(system_of(scene))


def dense(scene: dict[str, Any]) -> ma.Evaluation:
    return ma.evaluate(system_of({**scene, "run": {"solver": "dense"}}))


SOLVED = pytest.mark.parametrize("solved", [reference, node, dense])


# --- closed forms --------------------------------------------------------------------------------


@SOLVED
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


@SOLVED
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


@SOLVED
@pytest.mark.parametrize("kind", ["prismatic", "cylindrical"])
def test_a_peg_is_thrown_out_of_a_socket_that_turns(kind, solved):
    out, spin = 0.5, 1.5
    accelerations = solved(peg_in_socket(kind, out, 0.2, spin)).object_accelerations
    seen_at_rest = accelerations["peg"][0] - accelerations["socket"][0]
    outward, _ = peg_acceleration(out, spin, out)
    assert seen_at_rest + out * spin**2 == pytest.approx(outward, rel=ROUNDING)


@pytest.mark.parametrize("solved", [node, dense])
def test_friction_brakes_a_load_and_drives_the_sled_below_it(solved):
    """Coulomb's law: the load's weight, times mu, acts on both."""
    ev = solved(load_on_sled(1.0))
    (load, sled), mu = SLED.values()
    drag = mu * load * GRAVITY
    along = [ev.object_accelerations[name][0] for name in ("load", "sled")]
    np.testing.assert_allclose(along, [-drag / load, drag / sled], rtol=1e-10)
    assert set(ev.contact_states.values()) == {("sliding",)}
    feet = sum(ev.wrenches[f"foot_{k}"][:3] for k in range(3))
    np.testing.assert_allclose(feet, [drag, 0.0, -load * GRAVITY], atol=1e-9)
    # the rail carries both
    rail = ev.wrenches["rail"][:3]
    np.testing.assert_allclose(rail, [0.0, 0.0, -(load + sled) * GRAVITY], atol=1e-9)


# --- random scenes -------------------------------------------------------------------------------


@pytest.mark.parametrize("family", OF_SEVERAL_OBJECTS)
def test_evaluations_certify_themselves(family, tmp_path):
    for seed in range(PER_FAMILY):
        drawn = draw_trees(family, np.random.default_rng(seed), tmp_path)
        ev = ma.evaluate(system_of(drawn.scene))
        size = max(
            1.0, *(np.max(np.abs(force), initial=0.0) for force in ev.contact_forces.values())
        )
        assert ev.message == ""
        assert ev.residuals.object < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.arm < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.constraint < 1e-9, f"seed {seed}"


# --- states --------------------------------------------------------------------------------------


def test_states_have_their_objects_by_name():
    scene = double_pendulum(ANGLES, RATES)
    trees = read_tree_scene(scene)
    system, state = system_of(scene), start_of(scene, trees)
    again = system.state(objects=state.objects)
    for name, written in state.objects.items():
        for part, values in written.items():
            np.testing.assert_allclose(getattr(again.objects[name], part), values, atol=1e-15)
    np.testing.assert_allclose(again.velocity[:12], system.initial_state().velocity[:12])
    pose = system.state(objects={"lower": {"position": [1.0, 2.0, 3.0]}}).objects
    np.testing.assert_array_equal(pose["lower"].position, [1.0, 2.0, 3.0])
    with pytest.raises(ModelError, match="2 objects, upper, lower"):
        _ = again.object_position
    with pytest.raises(ModelError, match="2 objects"):
        _ = ma.evaluate(system).object_acceleration
    with pytest.raises(ModelError, match="uper"):
        system.state(objects={"uper": {"position": [0.0, 0.0, 0.0]}})
