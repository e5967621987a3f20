"""Claims about control of several objects: gravity is carried, one is moved on a spring.

The references are forces of least norm from NumPy's pseudo-inverse of all contacts, and
differences.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.dynamics.coordinates import retract
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.state import State
from multiarm.errors import SceneError
from multiarm.geometry.stencils import CENTRAL_4
from multiarm.scene import parse_scene

STEP = 1e-4  # of differences [m, rad; m/s, rad/s]: truncation 1e-12, roundings 1e-10
DIFFERENCES = 1e-7
AT_REST = 1e-10  # [m/s^2, rad/s^2]
SPRING = {
    "kind": "object_impedance",
    "object": "plate",
    "stiffness": {"translation": [900.0, 800.0, 700.0], "rotation": [20.0, 15.0, 10.0]},
    "damping": {"translation": 120.0, "rotation": 4.0},
    "relative_stiffness": 25.0,
}
WELD = {"between": ["plate", "beam"], "kind": "weld", "at": {"xyz": [0.1, 0.0, 0.06]}}
HINGE = {
    "between": ["beam", "world"],
    "kind": "revolute",
    "axis": [0, 1, 0],
    "at": {"xyz": [0, 0, 0.5]},
}


def two_boxes(*joints: dict[str, Any], **parts: Any) -> dict[str, Any]:
    """Two UR5s at a beam, a plate above it, and further joints."""
    return {
        "gravity": [0.0, 0.0, -9.81],
        "objects": {
            "beam": {
                "shape": {"box": [1.2, 0.1, 0.1]}, "mass": 8.0, "pose": {"xyz": [0, 0, 0.5]},
            },
            "plate": {
                "shape": {"box": [0.4, 0.3, 0.02]}, "mass": 2.0, "pose": {"xyz": [0.1, 0, 0.56]},
            },
        },
        "arms": {
            "left": {"robot": "ur5", "base": {"xyz": [-0.95, 0, 0]}, "posture": "solve"},
            "right": {
                "robot": "ur5", "base": {"xyz": [0.95, 0, 0], "rpy": [0, 0, np.pi]},
                "posture": "solve",
            },
        },
        "joints": [
            {
                "arm": "left", "object": "beam", "kind": "weld",
                "at": {"xyz": [-0.6, 0, 0], "rpy": [0, np.pi / 2, 0]},
            },
            {
                "arm": "right", "object": "beam", "kind": "weld",
                "at": {"xyz": [0.6, 0, 0], "rpy": [0, -np.pi / 2, 0]},
            },
            *joints,
        ],
        **parts,
    }  # fmt: skip


def compiled(*joints: dict[str, Any], **parts: Any) -> ma.System:
    return ma.compile_system(parse_scene(two_boxes(*joints, **parts)))


def moving_state(system: ma.System, seed: int) -> State:
    """A state off the start, with velocities that the joints allow."""
    rng, start = np.random.default_rng(seed), system.initial_state()
    layout = start.layout
    position = retract(layout, start.position, 0.004 * rng.standard_normal(layout.nv))
    state = State(position, 0.2 * rng.standard_normal(layout.nv), layout)
    with system.borrow() as data:
        return project_start(data, system.scene, state)[0]


@pytest.mark.parametrize("joints", [[WELD], [WELD, HINGE]], ids=["carried", "hinged to the world"])
def test_gravity_compensation_carries_all_objects_with_the_least_forces(joints):
    system = compiled(*joints, control="gravity_compensation")
    start = system.initial_state()
    evaluation = ma.evaluate(system, 0.0, start)
    assert np.abs(evaluation.accelerations).max() < AT_REST
    with system.borrow() as data:
        data.set_state(0.0, start)
        require_ok(data, evaluate_state(data.struct, 0.0, 0.0))
        W_o = data.arrays.rows.W_o.copy()
        forces = data.arrays.rows.static_force.copy()
    weight = np.zeros((2, 6))
    weight[:, 2] = [8.0 * 9.81, 2.0 * 9.81]
    np.testing.assert_allclose(forces, np.linalg.pinv(W_o.T) @ weight.ravel(), atol=1e-9)


def test_weight_that_no_contact_carries_is_left_to_its_object():
    system = compiled(control="gravity_compensation")
    evaluation = ma.evaluate(system, 0.0, system.initial_state())
    beam, plate = evaluation.uncarried_wrench.reshape(2, 6)
    np.testing.assert_allclose(beam, 0.0, atol=1e-9)
    np.testing.assert_allclose(plate, [0, 0, 2.0 * 9.81, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        evaluation.object_accelerations["plate"], [0, 0, -9.81, 0, 0, 0], atol=1e-9
    )
    np.testing.assert_allclose(evaluation.object_accelerations["beam"], 0.0, atol=1e-9)


@pytest.mark.parametrize("control", ["gravity_compensation", SPRING], ids=["gravity", "spring"])
def test_derivatives_of_control_are_those_of_differences(control):
    system = compiled(WELD, control=control)
    state = moving_state(system, 3)
    layout, derivatives = state.layout, ma.derivatives(system, 0.0, state)

    def accelerations(displacement, change):
        position = retract(layout, state.position, displacement)
        displaced = State(position, state.velocity + change, layout)
        return ma.evaluate(system, 0.0, displaced).accelerations

    zero, found = np.zeros(layout.nv), derivatives.matrix[: layout.nv]
    for columns, moves in ((layout.displacement_columns, True), (layout.velocity_columns, False)):
        for l, column in enumerate(columns):
            slope = np.zeros(layout.nv)
            for offset, weight in zip(CENTRAL_4.offsets, CENTRAL_4.weights, strict=True):
                step = np.zeros(layout.nv)
                step[l] = offset * STEP
                pair = (step, zero) if moves else (zero, step)
                slope += weight / STEP * accelerations(*pair)
            size = max(1.0, np.abs(slope).max())
            np.testing.assert_allclose(found[:, column], slope, atol=DIFFERENCES * size)


def test_the_spring_takes_the_object_that_it_names_to_the_end_of_its_path():
    goal = [0.1, 0.0, 0.62]
    path = [{"time": 0.5, "xyz": goal}]
    system = compiled(WELD, control={**SPRING, "path": path})
    run = ma.simulate(system, duration=3.0, accuracy=1e-5)
    assert run.status == "completed", run.message
    np.testing.assert_allclose(run.objects["plate"].position[-1], goal, atol=1e-4)
    apart = np.linalg.norm(run.objects["plate"].position - run.objects["beam"].position, axis=1)
    np.testing.assert_allclose(apart, np.hypot(0.1, 0.06), atol=1e-9)


@pytest.mark.parametrize(
    ("control", "place"),
    [
        ({**SPRING, "object": "plank"}, "$.control.object"),
        ({**SPRING, "squeeze": 20.0}, "$.control.squeeze"),
    ],
    ids=["unknown", "squeeze"],
)
def test_controls_that_do_not_say_which_object_are_refused(control, place):
    with refused(SceneError, place):
        parse_scene(two_boxes(WELD, control=control))
