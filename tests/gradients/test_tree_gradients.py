"""Claims about derivatives of runs of robots that are trees: those of differences of runs."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import difference
from steps import state_of
from tree_scenes import DOWN, cart_scene, satellite_scene, turned_gripper

import multiarm as ma
from multiarm.gradients.variational_equation import displaced, displacement
from multiarm.scene import parse_scene
from multiarm.scene.changes import value_at

T = 0.1  # [s]
EFFECTS = {"joint_damping": 0.7, "rotor_inertia": 0.2}
SCENES = {
    "cart": parse_scene({**cart_scene(), "effects": EFFECTS}),
    "gripper": parse_scene({**turned_gripper(), "effects": EFFECTS}),
    "satellite": parse_scene({**satellite_scene(DOWN), "effects": EFFECTS}),
}


def end_of(system, state=None):
    method = {"integrator": "dop853", "tolerance": 1e-12, "certificate": False}
    return state_of(system, ma.simulate(system, T, state=state, output_step=T, **method), 1)


def height(_t, state) -> float:
    bases = state.bases.values()
    of_bases = sum(base.pose.sum() + base.twist[0] * base.twist[4] for base in bases)
    joints = sum(q.sum() for q in state.joint_positions.values())
    return state.object_position[2] + 0.3 * joints + of_bases


@pytest.mark.parametrize("name", SCENES)
def test_gradients_by_the_start_are_differences_of_runs(name, rng):
    """Along displacements that keep connections, loops and couplings closed."""
    system = ma.compile_system(SCENES[name])
    start = system.initial_state()
    gradient = ma.gradient(system, T, final=height, accuracy=1e-9, state=start)
    allowed = ma.derivatives(system, 0.0, start).motions.admissible()
    direction = allowed @ rng.standard_normal(len(allowed))
    direction /= np.abs(direction).max()
    expected = difference(
        lambda h: height(T, end_of(system, displaced(start, h * direction))), 2e-4
    )
    largest = np.abs(gradient.start.matrix).max()
    assert gradient.start.matrix @ direction == pytest.approx(expected, abs=1e-6 * largest)


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("cart", "robots.cart.base.mass"),
        ("cart", "joints[1].at.xyz[1]"),
        ("gripper", "object.mass"),
        ("gripper", "robots.gripper.base.rpy[0]"),
        ("satellite", "robots.sat.base.mass"),
        ("satellite", "robots.sat.base.rpy[1]"),
        ("satellite", "robots.sat.base.twist[3]"),
    ],
)
def test_sensitivities_by_numbers_of_robots_are_differences_of_runs(name, path):
    """Also by the place of a plane linkage, of which some rows are zero but for roundings."""
    scene = SCENES[name]
    system, value = ma.compile_system(scene), value_at(scene, path)
    size = max(abs(value), 0.3)
    found = ma.sensitivities(system, [0.0, T], parameters={path: size}, accuracy=1e-9)
    middle = end_of(system)

    def end(shift):
        return displacement(middle, end_of(ma.compile_system(scene.replace({path: value + shift}))))

    expected = difference(end, 1e-3 * size)
    np.testing.assert_allclose(
        found.matrix[-1, :, -1], expected, atol=1e-6 * np.abs(expected).max()
    )


def test_sensitivities_have_the_bases_apart_from_the_joints():
    system = ma.compile_system(SCENES["satellite"])
    found, layout = ma.sensitivities(system, [T], accuracy=1e-8), system.model.layout
    blocks = found.base_poses["sat"], found.joint_positions["sat"], found.base_twists["sat"]
    assert [len(block.d_object_pose[0]) for block in blocks] == [6, 6, 6]
    rows = np.vstack([block.matrix[0] for block in blocks])
    places = [*layout.displacement_columns[6:], *layout.velocity_columns[6:12]]
    np.testing.assert_array_equal(rows, found.matrix[0, places])
