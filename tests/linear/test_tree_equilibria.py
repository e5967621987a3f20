"""Claims about linear systems and equilibria of robots that are trees."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import difference
from tree_scenes import cart_scene, turned_gripper

import multiarm as ma
from multiarm.scene import parse_scene

SCENES = {"cart": cart_scene, "gripper": lambda: turned_gripper(("x", "y", "yaw"))}


def with_springs(system, stiffness, damping):
    """Each joint on a spring to its start, base joints too."""
    rest = {name: q.copy() for name, q in system.initial_state().joint_positions.items()}
    return system.with_control(
        lambda t, state: {
            name: stiffness * (q0 - state.joint_positions[name])
            - damping * state.joint_velocities[name]
            for name, q0 in rest.items()
        }
    )


@pytest.mark.parametrize("name", SCENES)
def test_equilibria_of_springs_are_at_rest_and_stable(name):
    stiffness = {"cart": 2000.0, "gripper": 50.0}[name]
    table = {k: v for k, v in SCENES[name]().items() if k != "control"}
    system = with_springs(ma.compile_system(parse_scene(table)), stiffness, 0.1 * stiffness)
    equilibrium = ma.find_equilibrium(system)
    assert equilibrium.stability == "stable"
    assert np.abs(ma.evaluate(system, 0.0, equilibrium.state).accelerations).max() < 1e-9
    sag = equilibrium.state.object_position - system.initial_state().object_position
    assert np.linalg.norm(sag) > 1e-4


@pytest.mark.parametrize("name", SCENES)
def test_accelerations_near_a_state_are_those_of_the_linear_system(name, rng):
    """On the joints, by names of robots and of their connections."""
    system = ma.compile_system(parse_scene({**SCENES[name](), "effects": {"joint_damping": 0.5}}))
    linear = ma.linearise(system)
    velocities, p = list(linear.coordinates.velocities), len(linear.coordinates.positions)
    y = rng.standard_normal(len(linear.A))

    def accelerations(h):
        state = linear.state_at(h * y)
        return ma.evaluate(system, 0.0, state).accelerations[velocities]

    expected = difference(accelerations, 1e-5)
    size = np.abs(expected).max()
    np.testing.assert_allclose((linear.A @ y)[p : p + len(velocities)], expected, atol=1e-6 * size)
    assert f"{name}/base_yaw/torque" in linear.input_names
    assert f"{name}/left/weld 1/force" in linear.output_names
