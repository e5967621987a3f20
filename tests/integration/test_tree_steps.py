"""Claims about steps of ``rodas5p`` and ``variational`` with robots that are trees."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from random_trees import draw_trees
from steps import CLOSED, Slope, derivatives_of, state_of, step_of_the_package
from tree_scenes import DOWN, cart_scene, satellite_scene, turned_gripper

import multiarm as ma
from multiarm.dynamics.coordinates import load_chart
from multiarm.dynamics.status import OK
from multiarm.integration.projection import project
from multiarm.scene import parse_scene

MOVES = ("x", "y", "yaw")
FAMILIES = (
    "several_tips",
    "moving_bases",
    "surroundings",
    "inner_loops",
    "mimic_joints",
    "floating_bases",
)
EFFECTS = {
    "joint_damping": 5.0,
    "joint_friction": {"torque": 0.5, "model": "smooth", "speed": 0.5},
    "rotor_inertia": 0.2,
}
# As in the tests of derivatives, with displacements of 1e-3, of 1e-6 where rows repeat others.
BOUND = 2e-5


def system_of(name, folder, **effects):
    scenes = {
        "cart": cart_scene,
        "gripper": lambda: turned_gripper(MOVES),
        "satellite": lambda: satellite_scene(DOWN),
    }
    rng = np.random.default_rng(1)
    table = scenes[name]() if name in scenes else draw_trees(name, rng, folder).scene
    return ma.compile_system(parse_scene({**table, "effects": {**EFFECTS, **effects}}))


def assert_columns(matrix, expected):
    scale = np.maximum(np.abs(expected).max(axis=0), 1.0)
    assert np.max(np.abs(matrix - expected) / scale) < BOUND


@pytest.mark.parametrize("gains", [(0.0, 0.0), (30.0, 50.0)])
@pytest.mark.parametrize("name", ["cart", "gripper", "satellite", *FAMILIES])
def test_derivatives_of_a_step_are_those_of_evaluations_and_cost_none(name, gains, tmp_path):
    """With lagging drives and feedback on the drift; couplings, loops, the world, moving bases."""
    system = system_of(name, tmp_path, actuator_lag=0.1)
    state = system.initial_state()
    slope = Slope(system, state, *gains)
    displacement = 1e-6 if slope.data.arrays.solution.dependent else 1e-3
    stepping = step_of_the_package(system, state, 1e-3, *gains)
    J = slope.jacobian(stepping.step.tolerance.size, displacement)[system.model.layout.nv :]
    assert_columns(np.hstack(derivatives_of(system, stepping)), J)
    assert stepping.step.stage.evaluations == 1 + 7


@pytest.mark.parametrize("name", ["cart", "gripper", "satellite", "inner_loops", "mimic_joints"])
def test_derivatives_of_projected_stages_are_those_of_projected_evaluations(name, tmp_path):
    system = system_of(name, tmp_path)
    state, n = system.initial_state(), system.model.layout.nv
    slope = Slope(system, state, projects=True)
    displacement = 1e-6 if slope.data.arrays.solution.dependent else 1e-3
    J = slope.jacobian(2 * n, displacement)
    full = step_of_the_package(system, state, 1e-3, projects=True).work[2]
    assert_columns(np.hstack([full.by_position, full.by_velocity[:, :n]]), J[n:])
    rates = full.projection[:n]
    assert_columns(np.hstack([rates[:, 2 * n :], rates[:, n : 2 * n]]), J[:n])


@pytest.mark.parametrize("name", ["cart", "gripper", "satellite"])
def test_steps_of_rodas5p_keep_their_order(name, tmp_path):
    """The error of one step is of order 6, with projected stages too."""
    system = system_of(name, tmp_path, joint_friction=None)
    start, lengths = system.initial_state(), (0.02, 0.01)
    closely = {"integrator": "dop853", "tolerance": 1e-13, "certificate": False}
    for projects in (False, True):
        errors = []
        for h in lengths:
            end = state_of(system, ma.simulate(system, h, output_step=h, state=start, **closely), 1)
            stepping = step_of_the_package(system, start, h, projects=projects)
            with system.borrow() as data:
                load_chart(stepping.step.z_new, stepping.step.base, data.arrays)
                if projects:
                    assert project(data.struct, CLOSED) == OK
                wrong = data.arrays.state.configuration - end.position
                faster = data.arrays.state.velocity - end.velocity
                errors.append(np.max(np.abs([*wrong, *faster])))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(6.0, abs=0.6), errors


def end_of(system, T, **method):
    """Configuration and velocity at the end of a run, whose joints are closed."""
    run = ma.simulate(system, T, output_step=T, certificate=False, **method)
    assert run.status == "completed" and np.max(np.abs(run.position_drift)) < 1e-10
    state = state_of(system, run, 1)
    return np.concatenate([state.position, state.velocity])


@pytest.mark.parametrize("name", ["satellite", "floating_bases"])
def test_runs_of_rodas5p_on_floating_bases_are_those_of_explicit_methods(name, tmp_path):
    system, T = system_of(name, tmp_path), 0.05
    reference = end_of(system, T, integrator="dop853", tolerance=1e-11)
    stiff = end_of(system, T, integrator="rodas5p", tolerance=1e-8)
    np.testing.assert_allclose(stiff, reference, atol=1e-8)


@pytest.mark.parametrize("name", ["cart", "gripper", "surroundings", "mimic_joints"])
def test_runs_of_all_kinds_of_methods_agree(name, tmp_path):
    """The variational method with order 2, at closed joints and with a balance of energy."""
    system, T = system_of(name, tmp_path), 0.05
    end = partial(end_of, system, T)
    reference = end(integrator="dop853", tolerance=1e-11)
    np.testing.assert_allclose(end(integrator="rodas5p", tolerance=1e-8), reference, atol=1e-8)
    errors = [
        np.max(np.abs(end(integrator="variational", step=step) - reference))
        for step in (2e-3, 1e-3)
    ]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2), errors
