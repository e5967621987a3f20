"""Claims about linear systems and equilibria of robots that are trees."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import difference
from tree_models import read_tree_scene
from tree_motion import as_tree_state
from tree_oracle import solve_minimal
from tree_scenes import DOWN, cart_scene, hanging_scene, satellite_scene, turned_gripper

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


@pytest.mark.parametrize("name", [*SCENES, "satellite"])
def test_accelerations_near_a_state_are_those_of_the_linear_system(name, rng):
    """On the joints, by names of robots and of their connections."""
    table = satellite_scene(DOWN) if name == "satellite" else SCENES[name]()
    system = ma.compile_system(parse_scene({**table, "effects": {"joint_damping": 0.5}}))
    linear = ma.linearise(system)
    velocities, p = list(linear.coordinates.velocities), len(linear.coordinates.positions)
    y = rng.standard_normal(len(linear.A))

    def accelerations(h):
        state = linear.state_at(h * y)
        return ma.evaluate(system, 0.0, state).accelerations[velocities]

    expected = difference(accelerations, 1e-5)
    size = np.abs(expected).max()
    np.testing.assert_allclose((linear.A @ y)[p : p + len(velocities)], expected, atol=1e-6 * size)
    if name == "satellite":  # no drive moves the base
        joints = system.arms["sat"].joint_names
        assert linear.input_names == tuple(f"sat/{joint}/torque" for joint in joints)
        assert {"sat/base_x", "sat/base_turn_z'"} <= {*linear.output_names}
    else:
        assert f"{name}/base_yaw/torque" in linear.input_names
        assert f"{name}/left/weld 1/force" in linear.output_names


def test_a_robot_that_hangs_from_the_world_comes_to_rest_as_the_dense_reference_says():
    table = hanging_scene()
    system, trees = ma.compile_system(parse_scene(table)), read_tree_scene(table)
    found = ma.find_equilibrium(system)
    state = found.state
    turned = system.initial_state().displacement_to(state)[9:12]
    assert np.linalg.norm(turned) > 0.1
    reference = solve_minimal(trees, as_tree_state(state), dict(found.torques))
    for accelerations in (reference.base_accelerations, reference.joint_accelerations):
        assert np.abs(accelerations["sat"]).max() < 1e-9
    assert np.abs(reference.object_acceleration).max() < 1e-9
    # nothing drives it back about the vertical through the ball joint
    about_z = [mode for mode in found.linear.modes if mode.kind == "drifts"]
    assert about_z and about_z[0].moving[0] == "sat/base_turn_z"
