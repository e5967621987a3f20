"""Claims about derivatives of robots that are trees: those of differences of evaluations.

With effects, with springs for contacts, and with contacts that slide, also where an arm cannot be
solved on its own, constraints repeat others, or rows are zero but for roundings.  Differences of
order four along random displacements share no derivative with the code under test.
"""

from __future__ import annotations

import numpy as np
import pytest
from joint_equations import FINGERTIPS
from mechanics import difference
from random_trees import draw_trees
from steps import data_at, without_derivatives
from tree_models import constant_torques, read_tree_scene, start_of
from tree_oracle import evaluation_errors, solve_minimal
from tree_scenes import cart_scene, turned_gripper

import multiarm as ma
from multiarm.dynamics.force_derivatives import applied_derivatives
from multiarm.events.evaluation import enter_mode_at, evaluate_mode
from multiarm.gradients.variational_equation import displaced
from multiarm.scene import parse_scene

TIME = 0.3  # [s]
MOVES = ("x", "y", "yaw")
FAMILIES = (
    "several_tips", "moving_bases", "surroundings", "inner_loops", "mimic_joints", "floating_bases",
    "several_objects", "objects_alone",
)  # fmt: skip
# Roundings of evaluations over the displacement, 1e-14 / 1e-4, times the condition of constraints
# of which some repeat others or whose links are light.
BOUND = 1e-6


def answers(evaluation) -> np.ndarray:
    return np.concatenate([evaluation.accelerations, *evaluation.contact_forces.values()])


def assert_directions(derivatives, rng, evaluate, state, step=1e-4):
    """Along three displacements, of those that keep the joints closed where rows repeat others."""
    size = 2 * state.layout.nv
    motions = derivatives.motions
    allowed = np.eye(size) if motions.independent else motions.admissible()
    assert np.linalg.matrix_rank(allowed, 1e-6) > 0
    for _ in range(3):
        direction = allowed @ rng.standard_normal(size)
        expected = difference(lambda h, d=direction: evaluate(displaced(state, h * d)), step)
        rows = derivatives.matrix[: len(expected), :size]
        exact = np.isfinite(rows).all(axis=1)  # not of forces that are not unique
        assert exact[: state.layout.nv].all()
        scale = np.abs(rows).max(axis=1) + np.abs(expected) + 1.0
        wrong = np.abs(rows @ direction - expected) / scale
        assert wrong[exact].max() < BOUND


def with_effects(scene, rng):
    """The scene with effects of all joints, with base joints, and wrenches on links of branches."""
    system = ma.compile_system(parse_scene(scene))
    links = [
        f"{name}/{link}"
        for name, arm in system.arms.items()
        for link in rng.permutation([arm.model.frames[t.frame_id].name for t in arm.tips.values()])
    ]
    wrenches = [
        {"on": link, "at": rng.uniform(-0.2, 0.2, 3).tolist(), "axes": axes,
         "force": rng.uniform(-5, 5, 3).tolist(), "torque": rng.uniform(-1, 1, 3).tolist()}
        for link in links
        for axes in ("world", "body")
    ]  # fmt: skip
    effects = {
        "joint_damping": 0.7,
        "joint_friction": {"torque": 0.5, "model": "smooth", "speed": 0.5},
        "rotor_inertia": 0.2,
        "torque_limits": 2.0,
        "external_wrenches": wrenches,
    }
    return parse_scene({**scene, "effects": effects})


@pytest.mark.parametrize("arms", ["pinocchio", "compiled"])
@pytest.mark.parametrize("family", ["cart", "gripper", *FAMILIES])
def test_derivatives_with_effects_are_those_of_differences(family, arms, tmp_path):
    rng = np.random.default_rng(1)
    scenes = {"cart": cart_scene, "gripper": lambda: turned_gripper(MOVES)}
    table = scenes[family]() if family in scenes else draw_trees(family, rng, tmp_path).scene
    table = {**table, "run": {"arms": arms}}
    system = ma.compile_system(with_effects(table, rng))
    state = system.initial_state()
    derivatives = ma.derivatives(system, TIME, state)
    assert_directions(
        derivatives, rng, lambda moved: answers(ma.evaluate(system, TIME, moved)), state
    )


@pytest.mark.parametrize("moves", [(), MOVES])
def test_a_plane_linkage_moves_freely_across_its_plane(moves, rng):
    """Rows that are zero but for roundings hold nothing: the dense solver, coordinates, motions."""
    table = turned_gripper(moves)
    trees = read_tree_scene(table)
    state = start_of(table, trees)
    expected = solve_minimal(trees, state, constant_torques(table, trees))
    dense = ma.compile_system(parse_scene({**table, "run": {"solver": "dense"}}))
    evaluation = ma.evaluate(dense)
    about = {"gripper/left": state.object_position}
    assert evaluation_errors(expected, evaluation, about) < 1e-9
    assert evaluation.rank == expected.rank
    system = ma.compile_system(parse_scene(table))
    linear = ma.linearise(system)
    assert len(linear.A) == 2 * (1 + len(moves))
    start = system.initial_state()
    assert_directions(
        linear.derivatives, rng, lambda moved: answers(ma.evaluate(system, 0.0, moved)), start
    )


@pytest.mark.parametrize("family", ["cart", "gripper", *FAMILIES])
def test_springs_of_connections_have_the_derivatives_of_differences(family, tmp_path):
    rng = np.random.default_rng(2)
    scenes = {"cart": cart_scene, "gripper": lambda: turned_gripper(MOVES)}
    table = scenes[family]() if family in scenes else draw_trees(family, rng, tmp_path).scene
    springs = {"contact_compliance": {"stiffness": 2e4, "damping": 300.0}}
    system = ma.compile_system(parse_scene({**table, "effects": springs}))
    start = system.initial_state()
    state = displaced(start, 0.02 * rng.standard_normal(2 * start.layout.nv))
    stated, differences = (
        applied_derivatives(data_at(each, state), True)
        for each in (system, without_derivatives(system))
    )
    largest = np.abs(differences).max()
    np.testing.assert_allclose(stated, differences, rtol=0, atol=BOUND * largest)
    assert largest > 1e3


@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("several_tips", 0),  # constraints that repeat others
        ("moving_bases", 2),
        ("surroundings", 2),  # on the world
        ("inner_loops", 2),  # a robot with fewer joints than rows
        ("inner_loops", 3),
        ("mimic_joints", 1),
        ("floating_bases", 1),  # on the object
        ("floating_bases", 7),  # on the world
        ("several_objects", 1),  # between two objects
        ("objects_alone", 0),
    ],
)
def test_sliding_contacts_of_robots_are_differentiated_with_their_friction(family, seed, tmp_path):
    rng = np.random.default_rng(seed)
    table = draw_trees(family, rng, tmp_path).scene
    names = [
        joint.get("arm") or joint.get("name") or "-".join(joint["between"])
        for joint in table["joints"]
        if joint["kind"] in FINGERTIPS
    ]
    effects = {
        "contact_friction": {"mu": 0.3, "contacts": names},
        "unilateral_contacts": {"contacts": names},
    }
    system = ma.compile_system(parse_scene({**table, "effects": effects}))
    state = system.initial_state()
    derivatives = ma.derivatives(system, TIME, state)
    assert "sliding" in sum(derivatives.evaluation.contact_states.values(), ())
    with system.borrow() as data:
        modes = enter_mode_at(data, TIME, state)
        assert_directions(
            derivatives, rng, lambda moved: answers(evaluate_mode(modes, TIME, moved)), state, 1e-5
        )
