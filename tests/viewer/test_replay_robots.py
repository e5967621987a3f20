"""Replays of robots with several tips: trees on bases that move, joints between any two bodies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from tree_models import BodyFrame, read_tree_scene
from tree_scenes import cart_scene, gripper_scene

import multiarm as ma
from multiarm.viewer.animate import animate
from multiarm.viewer.animation import rotations

ROUNDING = 1e-12  # [m, 1] of products of a dozen poses within some metres


def run_of(scene: dict, duration: float) -> ma.Trajectory:
    system = ma.compile_system(ma.Scene(**scene))
    return ma.simulate(system, duration, integrator="dop853", tolerance=1e-6, output_step=0.01)


def animation_of(run: ma.Trajectory):
    return animate(run, fps=100, speed=1, meshes=False)


@pytest.fixture(scope="module")
def cart():
    return run_of(cart_scene(), 0.2)


def closing() -> dict:
    """A gripper whose right pad does not reach the box, so that both fingers move."""
    scene = gripper_scene()
    del scene["joints"][1]
    return scene


@pytest.fixture(scope="module")
def gripper():
    return run_of(closing(), 0.1)


def reference(scene: dict, robot: str, link: str, positions: np.ndarray) -> np.ndarray:
    """World poses (K, 4, 4) of a link, from a Pinocchio model that the package did not build."""
    model = read_tree_scene(scene).robots[robot]
    frame: BodyFrame = model.links[link]
    data, poses = model.model.createData(), []
    for q in positions:
        pin.forwardKinematics(model.model, data, q)
        poses.append((data.oMi[frame.joint] * frame.placement).homogeneous)
    return np.array(poses)


def poses_of(track) -> np.ndarray:
    """World poses (K, 4, 4) of a body or a hinge."""
    poses = np.tile(np.eye(4), (len(track.position), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations(track.quaternion_xyzw), track.position
    return poses


def motions(poses: np.ndarray) -> np.ndarray:
    """What moves a rigid body from its first pose to the others, world axes (K, 4, 4)."""
    return poses @ np.linalg.inv(poses[0])


def test_a_cart_drives_by_its_base_joints(cart):
    x, y, yaw = cart.joint_positions["cart"][:, :3].T
    moved = np.tile(np.eye(4), (len(x), 1, 1))
    moved[:, :3, :3] = Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0])).as_matrix()
    moved[:, 0, 3], moved[:, 1, 3] = x, y
    bodies = [b for b in animation_of(cart).bodies if b.name.startswith("arms/cart/base_")]
    assert bodies and np.ptp(x) > 1e-4 and np.ptp(yaw) > 1e-5
    for body in bodies:
        np.testing.assert_allclose(motions(poses_of(body)), motions(moved), atol=ROUNDING)


@pytest.mark.parametrize("link", ["torso", "left_forearm", "left_hand", "right_hand"])
def test_links_on_all_branches_move_as_pinocchio_has_them(cart, link):
    expected = motions(reference(cart_scene(), "cart", link, cart.joint_positions["cart"]))
    bodies = [b for b in animation_of(cart).bodies if b.name.startswith(f"arms/cart/{link}_")]
    assert bodies
    for body in bodies:
        np.testing.assert_allclose(motions(poses_of(body)), expected, atol=ROUNDING)


def test_tips_have_colours_and_what_they_share_has_its_own(cart):
    animation = animation_of(cart)
    tints = {
        side: {tuple(b.color) for b in animation.bodies if b.name.startswith(f"arms/cart/{side}")}
        for side in ("left", "right", "base", "torso")
    }
    assert all(len(tint) == 1 for tint in tints.values())
    assert len({*tints["left"], *tints["right"], *tints["base"]}) == 3
    assert tints["base"] == tints["torso"] == {(1.0, 1.0, 1.0)}
    contacts = {track.arm: tuple(track.color) for track in animation.contacts}
    assert {contacts["cart/left"]} == tints["left"] and {contacts["cart/right"]} == tints["right"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_hinges_of_linkages_are_on_both_links_that_they_join(gripper, side):
    (hinge,) = (h for h in animation_of(gripper).hinges if h.name == f"{side}_loop")
    assert np.ptp(hinge.position, axis=0).max() > 1e-3
    for link in (f"{side}_coupler", f"{side}_follower_end"):
        expected = reference(closing(), "gripper", link, gripper.joint_positions["gripper"])
        gaps = gripper.position_drift.max() + ROUNDING
        np.testing.assert_allclose(hinge.position, expected[:, :3, 3], atol=gaps)
        axis = rotations(hinge.quaternion_xyzw)[..., 2]
        np.testing.assert_allclose(axis, expected[:, :3, 2], atol=gaps / 0.01)


def test_what_the_world_holds_stays_where_it_is():
    scene = cart_scene()
    scene["joints"][0] = {"between": ["cart/left", "world"], "kind": "ball", "name": "rail"}
    run = run_of(scene, 0.1)
    assert np.ptp(run.joint_positions["cart"], axis=0).max() > 1e-4
    animation = animation_of(run)
    (hinge,) = animation.hinges
    tip = reference(scene, "cart", "left_tool", run.joint_positions["cart"])
    assert hinge.arm == "rail"
    np.testing.assert_allclose(hinge.position - hinge.position[0], 0.0, atol=ROUNDING)
    np.testing.assert_allclose(hinge.position, tip[:, :3, 3], atol=run.position_drift.max() + 1e-9)
    (track,) = (track for track in animation.contacts if track.arm == "rail")
    assert track.force.shape[1] == 3


def test_a_robot_that_drives_stands_on_no_column():
    scene = cart_scene()
    scene["robots"]["cart"]["base"] |= {"xyz": [0.0, 0.0, 0.3]}
    scene["object"]["pose"]["xyz"][2] += 0.3
    scene["arms"] = {"low": {"robot": "planar_2r", "base": {"xyz": [-2.0, 0.0, 0.0]}}}
    scene["joints"].append({"arm": "low", "kind": "wrenches", "wrenches": [[0, 0, 1, 0, 0, 0]]})
    animation = animation_of(run_of(scene, 0.02))
    assert animation.floor == pytest.approx(0.0)
    assert not [body for body in animation.bodies if body.name == "columns/cart"]
