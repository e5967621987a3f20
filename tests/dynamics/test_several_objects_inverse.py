"""Claims about inverse dynamics of several objects: what is wanted happens, the others follow.

The forward solution under the torques knows nothing of the inverse one.
"""

from __future__ import annotations

import numpy as np
import pytest
from held_boxes import (
    ON_HINGE,
    SLIDE,
    TO_WORLD,
    WELD,
    box_in_each_hand,
    compiled,
    moving_state,
    two_boxes,
)
from random_trees import draw_trees
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import GraspError, ModelError, SolverError
from multiarm.scene import parse_scene

ROUNDING = 1e-9
CASES = {
    "welded, lower": (two_boxes(WELD), ["beam"]),
    "welded, upper": (two_boxes(WELD), ["plate"]),
    "hinged": (two_boxes(ON_HINGE), ["beam"]),
    "one flies": (two_boxes(), ["beam"]),
    "one each": (box_in_each_hand(), ["first", "second"]),
    "one of two": (box_in_each_hand(), ["second"]),
    "slide": (box_in_each_hand(SLIDE), ["first"]),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """A system, a state of it in motion, and wanted accelerations."""
    scene, names = CASES[request.param]
    system, rng = compiled(scene), np.random.default_rng(7)
    return system, moving_state(system, 5), {name: rng.standard_normal(6) for name in names}


def driven(system, torques, state):
    return ma.evaluate(system.with_control(lambda t, s: torques), 0.0, state)


def test_torques_give_each_object_its_wanted_acceleration(case):
    system, state, wanted = case
    answer = ma.inverse_dynamics(system, state, wanted)
    ev = driven(system, answer.torques, state)
    for name, acceleration in wanted.items():
        np.testing.assert_allclose(ev.object_accelerations[name], acceleration, atol=ROUNDING)
    for arm, rates in answer.joint_accelerations.items():
        np.testing.assert_allclose(ev.joint_accelerations[arm], rates, atol=10 * ROUNDING)
    for name, forces in answer.contact_forces.items():
        np.testing.assert_allclose(ev.contact_forces[name], forces, atol=100 * ROUNDING)
    assert max(vars(answer.residuals).values()) < ROUNDING * 100


def test_internal_forces_are_those_of_all_objects_together(case):
    system, state, wanted = case
    internal = ma.evaluate(system, 0.0, state).internal_forces()
    mu_I = 20.0 * np.random.default_rng(3).standard_normal(internal.count)
    answer = ma.inverse_dynamics(system, state, wanted, internal_forces=mu_I)
    ev = driven(system, answer.torques, state)
    np.testing.assert_allclose(ev.force_decomposition().coordinates, mu_I, atol=1e-7)
    for name, acceleration in wanted.items():
        np.testing.assert_allclose(ev.object_accelerations[name], acceleration, atol=ROUNDING)


def test_a_box_that_follows_accelerates_least():
    """Along what the slide leaves free nothing is wanted: there its momentum does not change."""
    system = compiled(box_in_each_hand(SLIDE))
    state, wanted = moving_state(system, 5), {"first": [0.3, 0.2, -0.1, 0.5, 0.1, -0.2]}
    answer = ma.inverse_dynamics(system, state, wanted)
    ev = driven(system, answer.torques, state)
    second = system.scene.objects["second"]
    free = null_space(ev.contact_terms["slide"].W_o.T)  # in the axes of the second box
    R = Rotation.from_quat(state.objects["second"].quaternion_xyzw).as_matrix()
    a = np.concatenate([R.T @ part for part in np.split(ev.object_accelerations["second"], 2)])
    inertia = np.diag([second.mass] * 3 + np.diag(second.inertia_matrix()).tolist())
    np.testing.assert_allclose(free.T @ inertia @ a, 0.0, atol=1e-8)
    assert free.shape == (6, 2) and np.abs(a).max() > 0.1


@pytest.mark.parametrize("seed", range(3))
def test_motions_of_random_scenes_are_made_again(seed, tmp_path):
    """Torques for the objects' accelerations and internal forces that some torques make."""
    drawn = draw_trees("several_objects", np.random.default_rng(100 + seed), tmp_path)
    system = ma.compile_system(parse_scene(drawn.scene))
    state = system.initial_state()
    made = ma.evaluate(system, 0.0, state)
    wanted, mu_I = made.object_accelerations, made.force_decomposition().coordinates
    free = {name: None for name, pair in system.model.connections.items() if pair.robots}
    answer = ma.inverse_dynamics(system, state, wanted, free, mu_I)
    ev = driven(system, answer.torques, state)
    size = max(1.0, max(np.abs(a).max() for a in wanted.values()))
    for name, acceleration in wanted.items():
        np.testing.assert_allclose(ev.object_accelerations[name], acceleration, atol=1e-7 * size)


@pytest.mark.parametrize(
    ("scene", "names", "error", "text"),
    [
        (two_boxes(WELD), ["beam", "plate"], SolverError, "the joint 'plate-beam' misses it"),
        (two_boxes(ON_HINGE), ["plate", "beam"], GraspError, "cannot exert"),
        (two_boxes(WELD, TO_WORLD), ["plate"], SolverError, "the joint '.*' misses it by"),
        (two_boxes(), ["plate"], GraspError, "cannot exert"),
        (two_boxes(WELD), ["plank"], ModelError, "unknown object 'plank'"),
    ],
)
def test_accelerations_that_cannot_be_are_refused(scene, names, error, text):
    system, rng = compiled(scene), np.random.default_rng(1)
    wanted = {name: rng.standard_normal(6) for name in names}
    with pytest.raises(error, match=text):
        ma.inverse_dynamics(system, system.initial_state(), wanted)


def test_one_acceleration_of_several_objects_is_refused():
    system = compiled(two_boxes(WELD))
    with pytest.raises(ModelError, match="2 objects, beam, plate"):
        ma.inverse_dynamics(system, system.initial_state(), np.zeros(6))
