"""Claims about evaluations of robots that hold each other.

Oracles: dense algebra, the exchange of both bodies, the order of the robots.  That random scenes
agree with dense algebra is among the claims of ``test_tree_oracle.py``, that derivatives are those
of differences among those of ``test_tree_derivatives.py``.
"""

from __future__ import annotations

from copy import deepcopy
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from event_scenes import arm
from joined_robots import joined_scene, satellites, welded_arms, welded_motion
from random_trees import OF_ROBOTS_JOINED, draw_trees, in_motion
from tree_models import constant_torques, read_tree_scene, start_of
from tree_oracle import (
    TreeSolution,
    centres_of_seconds,
    evaluation_errors,
    solve_minimal,
    worst_gap,
)
from tree_scenes import DOWN, gripper_loops, gripper_scene, together

import multiarm as ma
from multiarm.problems.loops import WELDED_START
from multiarm.scene import parse_scene

AGREEMENT = 1e-9
SOLVERS = pytest.mark.parametrize(
    ("solver", "arms"),
    [("node", "pinocchio"), ("dense", "pinocchio"), ("node", "compiled"), ("dense", "compiled")],
)


def evaluated(
    scene: dict[str, Any], solver: str = "node", arms: str | None = None
) -> ma.Evaluation:
    scene = {**scene, "run": {"solver": solver}}
    return ma.evaluate(ma.compile_system(parse_scene(scene), arms=arms))


def assert_right(scene: dict[str, Any], solver: str, arms: str) -> ma.Evaluation:
    """The evaluation, which agrees with dense algebra in all that the equations determine."""
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    assert worst_gap(trees, state) < 1e-12
    solution: TreeSolution = solve_minimal(trees, state, constant_torques(scene, trees))
    ev = evaluated(scene, solver, arms)
    assert evaluation_errors(solution, ev, centres_of_seconds(trees, state)) < AGREEMENT
    assert ev.rank == solution.rank
    unique = {name: bool(np.all(ev.contact_forces_unique[name])) for name in solution.unique}
    assert unique == solution.unique
    return ev


# --- scenes --------------------------------------------------------------------------------------


def gripper_held_by_an_arm() -> dict[str, Any]:
    """A gripper with two inner loops, one of whose pads is welded to an arm."""
    scene = gripper_scene()
    scene["arms"] = {"arm": arm("xyzXYZ", base={"xyz": [0.3, 0.0, 0.3]})}
    scene["joints"] = [
        {"arm": "gripper/left", "kind": "weld"},
        {"between": ["arm", "gripper/right_pad"], "kind": "weld", "name": "held"},
        *gripper_loops("gripper"),
    ]
    return together(scene)


def three_arms(joints: list[tuple[str, str, str]], **more: Any) -> dict[str, Any]:
    """Arms ``a``, ``b``, ``c`` of six joints each, in motion, with joints among them.

    Their tips are the corners of a triangle.
    """
    arms = {
        name: arm("xyzXYZ", posture=[0.1 * k, 0.2, -0.1, 0.3, 0.2 - 0.1 * k, 0.4],
                  base={"xyz": [0.5 * k, 0.3 * (k == 1), 0.0]}, mass=1.0 + k)
        for k, name in enumerate("abc")
    }  # fmt: skip
    written = [
        {"between": [first, second], "kind": kind, "name": f"{first}{second}"}
        for first, second, kind in joints
    ]
    torques = {name: [1.0 + k, -2.0, 0.5, 0.3, -0.2 * k, 0.1] for k, name in enumerate("abc")}
    control = {"kind": "constant", "torques": torques}
    scene = joined_scene(written, arms=arms, gravity=DOWN, control=control, **more)
    in_motion(np.random.default_rng(3), scene, read_tree_scene(scene))
    return scene


FLOATS = {"moves": "free", "mass": 20.0, "inertia": [2.0, 2.0, 2.0]}
RING = [("a", "b", "ball"), ("b", "c", "revolute"), ("c", "a", "ball")]
CHAIN = [("a", "b", "revolute"), ("b", "c", "weld")]
SCENES = {
    "hands": lambda: satellites({"kind": "revolute"}, gravity=DOWN),
    "four_bar": welded_arms,
    "gripper": gripper_held_by_an_arm,
    "ring": lambda: three_arms(RING),
    "chain": lambda: three_arms(CHAIN),
    "past": lambda: three_arms([("a", "c", "weld"), ("b", "block", "ball")]),
    "welded_twice": lambda: three_arms(
        [("a", "b", "weld"), ("b", "a", "weld"), ("c", "block", "ball")]
    ),
    "all_at_one_object": lambda: three_arms(
        [("a", "b", "universal"), *[(name, "block", "ball") for name in "abc"]]
    ),
}


@SOLVERS
@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_joined_robots_are_those_of_dense_algebra(name, solver, arms):
    assert_right(SCENES[name](), solver, arms)


@SOLVERS
def test_welded_arms_start_as_their_closed_form(solver, arms):
    ev = evaluated(welded_arms(), solver, arms)
    motion = welded_motion()
    expected = motion._acceleration(WELDED_START, 0.0)
    assert ev.joint_accelerations["left"][0] == pytest.approx(expected, rel=1e-10)


# --- symmetries ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weld", "ball", "revolute", "planar"])
def test_bodies_may_be_exchanged(kind):
    """Forces act on SECOND: exchanged, they are opposite ones."""
    scene = satellites({"kind": kind}, gravity=DOWN)
    scene["robots"]["left"]["velocity"] = scene["robots"]["right"]["velocity"] = [0.0] * 6
    exchanged = deepcopy(scene)
    joint = exchanged["joints"][0]
    joint["between"].reverse()
    joint["at"], joint["at_first"] = joint["at_first"], joint["at"]
    ev, other = evaluated(scene), evaluated(exchanged)
    for name in ("left", "right"):
        for kind_of in ("joint_accelerations", "base_accelerations"):
            np.testing.assert_allclose(
                getattr(other, kind_of)[name], getattr(ev, kind_of)[name], atol=1e-9
            )
    # both frames are at one place
    np.testing.assert_allclose(other.wrenches["shake"], -ev.wrenches["shake"], atol=1e-8)


@pytest.mark.parametrize("joints", [RING, CHAIN, [("a", "c", "ball"), ("b", "block", "weld")]])
def test_the_order_of_robots_does_not_matter(joints):
    scene = three_arms(joints)
    ev = evaluated(scene)
    for order in permutations("abc"):
        again = evaluated({**scene, "arms": {name: scene["arms"][name] for name in order}})
        for name, acceleration in ev.joint_accelerations.items():
            np.testing.assert_allclose(again.joint_accelerations[name], acceleration, atol=1e-9)
        for name, wrench in ev.wrenches.items():
            np.testing.assert_allclose(again.wrenches[name], wrench, atol=1e-8)


# --- certificates of evaluations -----------------------------------------------------------------


@pytest.mark.parametrize("family", OF_ROBOTS_JOINED)
def test_evaluations_certify_themselves(family, tmp_path):
    for seed in range(6):
        drawn = draw_trees(family, np.random.default_rng(seed), tmp_path)
        ev = evaluated(drawn.scene)
        size = max(1.0, *(np.max(np.abs(f), initial=0.0) for f in ev.contact_forces.values()))
        assert ev.message == ""
        assert ev.residuals.object < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.arm < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.constraint < 1e-9, f"seed {seed}"


def test_inverse_dynamics_hold_a_robot_that_floats_and_another_holds():
    """One is welded to the world, the other to its hand; a box hangs on both."""
    posture = [0.3, -1.2, 1.4, 0.3, 0.4, 0.2]
    robots = {
        name: {"robot": "ur5", "base": base | FLOATS, "posture": posture, "tips": {"hand": "tool0"}}
        for name, base in (("f", {"xyz": [0.6, 0, 0.5]}), ("g", {"xyz": [0, 1, 0.5]}))
    }
    joints = [
        {"between": ["f/base_link", "world"], "kind": "weld", "name": "ground"},
        {"between": ["f/hand", "g/hand"], "kind": "weld"},
        {"arm": "f/hand", "kind": "weld"},
    ]
    box = {"shape": {"box": [0.3, 0.2, 0.1]}, "mass": 2.0, "pose": {"xyz": [0, 0.3, 0.6]}}
    scene = {"gravity": DOWN, "object": box, "robots": robots, "joints": joints}
    system = ma.compile_system(parse_scene(scene))
    state = system.initial_state()
    inverse = ma.inverse_dynamics(system, state=state, object_acceleration=np.zeros(6))
    driven = system.with_control(lambda t, state: dict(inverse.torques))
    for ev in (inverse, ma.evaluate(driven, state=state)):
        for accelerations in (ev.joint_accelerations, ev.base_accelerations):
            for values in accelerations.values():
                np.testing.assert_allclose(values, 0.0, atol=1e-8)
