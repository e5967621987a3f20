"""Claims about evaluations of robots with several connections, by connection.

Oracles: relative motion by Pinocchio (``tree_oracle``), differences along the motion, and the same
arms written as one robot.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from mechanics import ur5_pair
from merged_arms import ROBOT, as_one_robot
from random_trees import FAMILIES, OF_SEVERAL_OBJECTS, draw_moving_trees
from tree_models import BodyFrame, body_frame, connection_ends, read_tree_scene
from tree_oracle import Motions, solve_minimal
from tree_scenes import arm_joined_twice, cart_scene, coupled_hand

import multiarm as ma
from multiarm.errors import ModelError
from multiarm.scene import parse_scene

SURROUNDED = ("several_tips", "surroundings", "inner_loops", "moving_bases")


def relative_twist(motions: Motions, first: BodyFrame, second: BodyFrame) -> np.ndarray:
    """Twist (6,) of a frame seen from a body, at the frame's origin, in the body's axes."""
    F, S = motions.frame(first), motions.frame(second)
    velocity = F.twist[:3] - S.twist[:3] - np.cross(S.twist[3:], F.origin - S.origin)
    return np.concatenate([S.rotation.T @ velocity, S.rotation.T @ (F.twist[3:] - S.twist[3:])])


@pytest.mark.parametrize("family", (*SURROUNDED, *OF_SEVERAL_OBJECTS))
def test_free_motions_of_connections_are_those_of_their_bodies(family, tmp_path):
    drawn = draw_moving_trees(family, np.random.default_rng(5), tmp_path)
    trees, state = drawn.trees, drawn.state
    system = ma.compile_system(parse_scene(drawn.scene))
    ev, motions = ma.evaluate(system), Motions(trees, state)
    h, start = 1e-5, system.initial_state()
    moved = [
        ma.evaluate(system, 0.0, start.displaced(side * h * start.velocity)) for side in (1.0, -1.0)
    ]
    for connection, joint in zip(trees.connections, drawn.scene["joints"], strict=True):
        ends = [body_frame(end, trees) for end in connection_ends(joint, trees.objects)]
        twist = relative_twist(motions, *ends)
        space, rates = ev.motion_space(connection.name), ev.relative_rates(connection.name)
        np.testing.assert_allclose(space.T @ rates, twist, atol=1e-9)
        after, before = (result.motion_space(connection.name).T for result in moved)
        # differences of second order: h^2 and roundings over h
        np.testing.assert_allclose(space.T_dot, (after - before) / (2.0 * h), atol=1e-6)


@pytest.mark.parametrize("family", SURROUNDED)
def test_squeezing_does_not_move_the_object(family, tmp_path):
    """With the world's hold of the object, the resultant accelerates the object."""
    drawn = draw_moving_trees(family, np.random.default_rng(6), tmp_path)
    system = ma.compile_system(parse_scene(drawn.scene))
    ev = ma.evaluate(system)
    solution = solve_minimal(drawn.trees, drawn.state, drawn.torques)
    holding = [c.name for c in drawn.trees.connections if "object" in (c.first.body, c.second.body)]
    parts, internal = ev.force_decomposition(), ev.internal_forces()
    assert list(parts.moving) == sorted(holding, key=list(ev.contact_forces).index)
    stacked = [np.concatenate(list(p.values())) for p in (parts.moving, parts.squeezing)]
    forces = np.concatenate([ev.contact_forces[name] for name in parts.moving])
    size = max(np.max(np.abs(forces)), 1.0)
    np.testing.assert_allclose(sum(stacked), forces, atol=1e-10 * size)
    np.testing.assert_allclose(ev.W_o @ stacked[1], 0.0, atol=1e-10 * size)
    np.testing.assert_allclose(ev.W_o @ internal.basis, 0.0, atol=1e-12)
    mass, gravity = drawn.scene["object"]["mass"], drawn.trees.gravity
    on_object = BodyFrame("object", 1, pin.SE3.Identity())
    R = Motions(drawn.trees, drawn.state).frame(on_object).rotation
    force = mass * (solution.object_acceleration[:3] - gravity)
    np.testing.assert_allclose(R @ parts.wrench[:3], force, atol=1e-8 * size)


def test_lost_motions_of_one_robot_are_those_of_its_arms(tmp_path):
    stretched = [0.2, -1.0, 0.0, -0.7, -1.3, 0.4]
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    postures = {f"arms.{arm}.posture": stretched for arm in scene.arms}
    system = ma.compile_system(scene.replace(postures))
    merged = ma.compile_system(parse_scene(as_one_robot(system, tmp_path)))
    of_arms, of_robot = (ma.evaluate(s).lost_motions for s in (system, merged))
    assert of_arms["left"] == ("no motion along its own reach",)
    words = [f"{ROBOT}/{arm}: {text}" for arm, texts in of_arms.items() for text in texts]
    assert list(of_robot[ROBOT]) == words


def test_what_two_hands_lose_together_is_counted():
    """Hands welded to each other over a box: a torso and 12 joints, and the rows of two welds."""
    scene = cart_scene()
    scene["robots"]["cart"]["base"] = {}
    scene["robots"]["cart"]["posture"] = scene["robots"]["cart"]["posture"][3:]
    scene["control"] = {"kind": "none"}
    scene["joints"].append({"between": ["cart/left", "cart/right"], "kind": "weld"})
    system = ma.compile_system(parse_scene(scene))
    ev = ma.evaluate(system)
    assert ev.rank == 12  # the third weld says nothing that the two do not
    assert ev.coupled_arms == ("cart",)
    assert ev.lost_motions["cart"] == (
        "6 directions that cart/left, cart/right, cart/left-cart/right lose together",
    )


def test_all_tips_have_kinematics():
    system = ma.compile_system(parse_scene(cart_scene()))
    tips = system.kinematics().tips
    trees = read_tree_scene(cart_scene())
    state = system.initial_state()
    for name in ("left", "right"):
        tip = tips[f"cart/{name}"]
        arm = system.arms["cart"]
        np.testing.assert_array_equal(
            tip.position, arm.tip_pose(state.joint_positions["cart"], name)[:3, 3]
        )
        assert tip.jacobian.shape == (6, 16)
    assert trees.robots["cart"].joints == system.arms["cart"].joint_names
    with pytest.raises(ModelError, match="tips are 'cart/left', 'cart/right'"):
        tips["cart"]
    with pytest.raises(ModelError, match="cart"):
        system.state(joint_positions={"cart/left": np.zeros(6)})
    with pytest.raises(ModelError, match="connections are cart/left, cart/right"):
        ma.evaluate(system).motion_space("cart")


@pytest.mark.parametrize("family", (*FAMILIES, *OF_SEVERAL_OBJECTS))
def test_everything_shows_itself(family, tmp_path):
    """Texts of systems, states and evaluations of all families can be made."""
    drawn = draw_moving_trees(family, np.random.default_rng(7), tmp_path)
    system = ma.compile_system(parse_scene(drawn.scene))
    ev = ma.evaluate(system)
    for thing in (system, system.initial_state(), ev, system.kinematics(), system.model):
        assert repr(thing)
    for thing in (system, ev):
        html = thing._repr_html_()
        assert all(connection.name in html for connection in drawn.trees.connections)
    assert ev.contact_forces_unique.keys() == ev.contact_forces.keys()
    assert set(ev.conditioning) == set(drawn.trees.robots)


def test_both_joints_of_an_arm_show_themselves():
    html = ma.compile_system(parse_scene(arm_joined_twice()))._repr_html_()
    assert "arm left" in html and "connection left-object" in html


def test_couplings_have_no_part_in_internal_forces(tmp_path):
    """Three points in general position, 9 forces, have the 3 that squeeze the sides between."""
    system = ma.compile_system(parse_scene(coupled_hand(tmp_path)))
    ev = ma.evaluate(system)
    assert ev.W_o.shape == (6, 9)
    assert ev.internal_forces().basis.shape == (9, 3)
    parts = ev.force_decomposition()
    for name, force in ev.normal_forces.items():
        np.testing.assert_allclose(parts.moving[name] + parts.squeezing[name], force, atol=1e-12)
