"""Claims about derivatives of runs of several objects: those of differences of runs."""

from __future__ import annotations

import numpy as np
import pytest
from held_boxes import ON_HINGE, SLIDE, box_in_each_hand, two_boxes
from mechanics import difference
from object_scenes import double_pendulum

import multiarm as ma
from multiarm.gradients.variational_equation import displaced, displacement
from multiarm.scene import parse_scene
from multiarm.scene.changes import value_at

T = 0.1  # [s]
SERVO = {"kind": "joint_pd", "stiffness": 800.0, "damping": 60.0, "gravity_compensation": False}
SCENES = {
    "pendulum": parse_scene(double_pendulum([0.4, -0.9], [1.1, -0.6])),
    "hinge": parse_scene(two_boxes(ON_HINGE, control=SERVO)),
    "slide": parse_scene(box_in_each_hand(SLIDE, effects={"joint_damping": 0.7})),
}


def end_of(system, state=None):
    method = {"integrator": "dop853", "tolerance": 1e-12, "certificate": False}
    run = ma.simulate(system, T, state=state, output_step=T, **method)
    parts = "position", "quaternion_xyzw", "twist"
    return system.state(
        objects={
            name: {part: getattr(moving, part)[1] for part in parts}
            for name, moving in run.objects.items()
        },
        joint_positions={arm: q[1] for arm, q in run.joint_positions.items()},
        joint_velocities={arm: v[1] for arm, v in run.joint_velocities.items()},
    )


def mixed(_t, state) -> float:
    heights = [
        (1.0 + k) * moving.position[2] + moving.twist[4]
        for k, moving in enumerate(state.objects.values())
    ]
    return sum(heights) + 0.3 * sum(q.sum() for q in state.joint_positions.values())


@pytest.mark.parametrize("name", SCENES)
def test_gradients_by_the_start_are_differences_of_runs(name, rng):
    """Along displacements that keep the joints closed."""
    system = ma.compile_system(SCENES[name])
    start = system.initial_state()
    gradient = ma.gradient(system, T, final=mixed, accuracy=1e-9, state=start)
    allowed = ma.derivatives(system, 0.0, start).motions.admissible()
    direction = allowed @ rng.standard_normal(len(allowed))
    direction /= np.abs(direction).max()
    expected = difference(lambda h: mixed(T, end_of(system, displaced(start, h * direction))), 2e-4)
    largest = np.abs(gradient.start.matrix).max()
    assert gradient.value == pytest.approx(mixed(T, end_of(system)), abs=1e-8)
    assert gradient.start.matrix @ direction == pytest.approx(expected, abs=1e-6 * largest)


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("pendulum", "objects.lower.mass"),
        ("hinge", "objects.plate.mass"),
        ("slide", "objects.second.mass"),
    ],
)
def test_sensitivities_by_masses_are_differences_of_runs(name, path):
    scene = SCENES[name]
    system, value = ma.compile_system(scene), value_at(scene, path)
    found = ma.sensitivities(system, [0.0, T], parameters=[path], accuracy=1e-9)
    middle, frames = end_of(system), system.model.layout.node

    def end(shift):
        return displacement(middle, end_of(ma.compile_system(scene.replace({path: value + shift}))))

    expected = difference(end, 1e-3 * value)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found.matrix[-1, :, -1], expected, atol=1e-6 * largest)
    by_mass = found.object_pose.parameters[path][-1]
    np.testing.assert_allclose(by_mass, expected[:frames], atol=1e-6 * largest)
