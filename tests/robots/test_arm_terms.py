"""Claims about one arm: inertia, bias, Jacobian and tip motion, for every kind of joint."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from mechanics import (
    PANDA_FINGERS,
    G,
    chain_urdf,
    first_difference,
    plain_arm,
    second_difference,
    single_arm,
)
from refusals import refused
from repository import WORKED

import multiarm as ma
from multiarm.errors import ModelError
from multiarm.robots.robot import Robot, RobotFiles
from multiarm.scene import Pose, find_robot

BASE = Pose(xyz=(0.3, -0.4, 0.5), rpy=(0.2, -0.7, 1.9)).matrix()


def arm_of(urdf, tip, locked=None, **more):
    return Robot("arm", RobotFiles(urdf, (), BASE, {"": tip}, locked or {}, **more))


@pytest.fixture(
    params=["textbook_6r", "panda", "kinova", "slides", "one_hinge", "sixteen_joints"],
    scope="module",
)
def arm(request, tmp_path_factory):
    known = {
        "textbook_6r": ("tool", {}),
        "panda": ("panda_hand_tcp", PANDA_FINGERS),
        "kinova": ("j2s6s200_end_effector", {}),
    }
    if request.param in known:
        return arm_of(find_robot(request.param).urdf, *known[request.param])
    chains = {"slides": "uzYvxw", "one_hinge": "x", "sixteen_joints": "zxyuZxyzvyxzYxyz"}
    path = tmp_path_factory.mktemp("urdf") / "chain.urdf"
    path.write_text(chain_urdf(chains[request.param]))
    return arm_of(path, "tip")


@pytest.fixture
def moving(arm, rng):
    """The arm at random joint positions and velocities."""
    return arm, rng.uniform(-1, 1, arm.dof), rng.standard_normal(arm.dof)


def test_inertia_and_bias_agree_with_inverse_dynamics(moving):
    arm, q, v = moving
    terms = arm.terms(q, v)
    M, minus_bias = plain_arm(arm, q, v, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(terms.M, M, atol=1e-11)
    np.testing.assert_allclose(terms.M, terms.M.T, atol=0.0)
    np.testing.assert_allclose(terms.bias, -minus_bias, atol=1e-11)


def test_jacobian_and_twist_are_the_tips_rates(moving):
    arm, q, v = moving
    terms = arm.terms(q, v)
    velocity = first_difference(lambda t: arm.tip_pose(q + t * v)[:3, 3], 1e-2)
    spin = first_difference(lambda t: arm.tip_pose(q + t * v)[:3, :3], 1e-2) @ terms.tip_rotation.T
    expected = [*velocity, spin[2, 1], spin[0, 2], spin[1, 0]]
    np.testing.assert_allclose(terms.tip_twist, expected, atol=1e-9)
    np.testing.assert_allclose(terms.J @ v, expected, atol=1e-9)


def test_drift_is_the_tips_acceleration_without_joint_accelerations(moving):
    """Classical: the second derivative of the tip's origin; gravity has no part in it."""
    arm, q, v = moving
    drift = arm.terms(q, v).drift
    expected = second_difference(lambda t: arm.tip_pose(q + t * v)[:3, 3], 1.5e-2)
    np.testing.assert_allclose(drift[:3], expected, atol=1e-7)
    spin = lambda t: arm.terms(q + t * v, v).tip_twist[3:]  # noqa: E731
    np.testing.assert_allclose(drift[3:], first_difference(spin, 1e-2), atol=1e-8)


def test_base_placement_moves_the_whole_arm(moving):
    arm, q, _ = moving
    files = RobotFiles(arm.files.urdf, (), np.eye(4), arm.files.tips, arm.files.locked)
    at_origin = Robot("arm", files).tip_pose(q)
    np.testing.assert_allclose(arm.tip_pose(q), BASE @ at_origin, atol=1e-14)


def test_gravity_torque_holds_the_arm_still(moving):
    arm, q, _ = moving
    gravity = [1.0, -2.0, -9.0]
    holding = arm.gravity_torque(q, gravity)
    _, minus_bias = plain_arm(arm, q, np.zeros(arm.dof), gravity)
    np.testing.assert_allclose(holding, -minus_bias, atol=1e-12)


def test_worked_examples_arms_have_the_worked_inertia_and_bias():
    data, expected = (WORKED["two_arm_block_system"][key] for key in ("inputs", "expected"))
    for i in range(2):
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = data["base"][i]["R"], data["base"][i]["p"]
        files = RobotFiles(find_robot("textbook_6r").urdf, (), X, {"": "tool"}, {})
        terms = Robot("arm", files).terms(data["q"][i], data["qd"][i])
        np.testing.assert_allclose(terms.M, expected[f"M{i}"], atol=1e-9)
        np.testing.assert_allclose(terms.bias, expected["nle"][i], atol=1e-7)
        np.testing.assert_allclose(terms.drift, expected["Jdot_qdot_LWA_classical"][i], atol=1e-9)


def test_continuous_joints_take_any_number_of_turns():
    """One number a joint, though Pinocchio keeps cosine and sine."""
    arm = arm_of(find_robot("kinova").urdf, "j2s6s200_end_effector")
    assert arm.model.nq == 9 and arm.dof == 6
    assert arm.circular.tolist() == [True, False, False, True, False, True]
    q = np.array([0.4, 2.9, 1.3, -2.0, 1.4, 7.0])
    np.testing.assert_allclose(arm.configuration(q)[:2], [np.cos(0.4), np.sin(0.4)])
    wound = q + 2 * np.pi * np.array([3, 0, 0, -2, 0, 1])
    np.testing.assert_allclose(arm.tip_pose(wound), arm.tip_pose(q), atol=1e-13)
    own = pin.integrate(arm.model, pin.neutral(arm.model), q)
    np.testing.assert_allclose(arm.configuration(q), own, atol=1e-14)
    assert np.isinf(arm.position_limits[0]).all() and np.isfinite(arm.position_limits[1]).all()


def test_joint_units_tell_slides_from_hinges(tmp_path):
    path = tmp_path / "chain.urdf"
    path.write_text(chain_urdf("uzYv"))
    arm = arm_of(path, "tip")
    assert list(arm.joint_units.values()) == ["m", "rad", "rad", "m"]
    assert arm.joint_names == ("joint_1", "joint_2", "joint_3", "joint_4")


def test_a_slide_is_a_mass_on_a_rail(tmp_path):
    """Closed form: one slide along x carries 2.5 kg up its own axis against gravity."""
    path = tmp_path / "chain.urdf"
    path.write_text(chain_urdf("w"))
    arm = Robot("arm", RobotFiles(path, (), np.eye(4), {"": "tip"}, {}))
    terms = arm.terms([0.2], [3.0])
    tilt = Pose(rpy=(0.1, 0.2, -0.3)).rotation()[2, 2]  # cosine between the rail and the vertical
    np.testing.assert_allclose(terms.M, [[2.5]])
    np.testing.assert_allclose(terms.bias, [2.5 * 9.81 * tilt])
    assert terms.J.shape == (6, 1)


def test_locked_joints_are_part_of_their_links():
    """A locked joint at another angle gives another arm; its mass stays."""
    urdf = find_robot("panda").urdf
    q = np.array([0.1, -0.4, 0.2, -2.0, 0.3, 1.9])
    for angle in (0.0, 1.1):
        arm = arm_of(urdf, "panda_hand_tcp", {**PANDA_FINGERS, "panda_joint7": angle})
        free = arm_of(urdf, "panda_hand_tcp", PANDA_FINGERS)
        assert arm.dof == 6
        np.testing.assert_allclose(arm.tip_pose(q), free.tip_pose(np.append(q, angle)), atol=1e-14)
        full = free.terms(np.append(q, angle), np.zeros(7))
        np.testing.assert_allclose(arm.terms(q, np.zeros(6)).M, full.M[:6, :6], atol=1e-12)


def test_tool_is_carried_where_it_is_mounted():
    at = Pose(xyz=(0.01, 0.02, 0.05), rpy=(0.3, 0.0, 0.4))
    robot, tool = find_robot("textbook_6r").urdf, find_robot("corner_gripper").urdf
    bare = arm_of(robot, "tool")
    armed = arm_of(robot, "corner", tool_urdf=tool, mount="tool", tool_placement=at.matrix())
    q = np.array([0.3, -0.6, 1.1, 0.4, 0.7, -0.2])
    gripper = pin.buildModelFromUrdf(str(tool))
    data = gripper.createData()
    pin.framesForwardKinematics(gripper, data, pin.neutral(gripper))
    X_tool_corner = data.oMf[gripper.getFrameId("corner")].homogeneous
    expected = bare.tip_pose(q) @ at.matrix() @ X_tool_corner
    np.testing.assert_allclose(armed.tip_pose(q), expected, atol=1e-13)
    # the gripper is a root link alone: Pinocchio counts it as part of the universe
    added = pin.computeTotalMass(armed.model) - pin.computeTotalMass(bare.model)
    assert added == pytest.approx(gripper.inertias[0].mass) and added > 0.1


def test_unknown_tip_names_the_links():
    with refused(ModelError, "'arm'"):
        arm_of(find_robot("textbook_6r").urdf, "hand")


def test_an_unknown_link_names_the_links():
    arm = arm_of(find_robot("textbook_6r").urdf, "tool")
    with refused(ModelError, "'arm'", "'hand'"):
        arm.link("hand")


def test_results_are_copies_of_pinocchios_live_views():
    arm = arm_of(find_robot("textbook_6r").urdf, "tool")
    first = arm.terms(np.full(6, 0.3), np.full(6, 0.5))
    kept = [np.array(value) for value in first]
    arm.terms(np.full(6, -0.9), np.full(6, 2.0))
    for before, after in zip(kept, first, strict=True):
        np.testing.assert_array_equal(before, after)


def test_two_systems_do_not_share_an_arms_numbers():
    """Evaluating one system leaves the other's result as it was."""
    joint = {"kind": "ball"}
    one = ma.compile_system(
        single_arm("textbook_6r", "tool", [0.3, -0.6, 1.1, 0.4, 0.7, -0.2], joint)
    )
    two = ma.compile_system(
        single_arm("textbook_6r", "tool", [0.1, 0.4, 0.9, 0.0, 0.5, 0.0], joint)
    )
    first = ma.evaluate(one)
    kept = first.joint_accelerations["arm"].copy()
    ma.evaluate(two)
    np.testing.assert_array_equal(first.joint_accelerations["arm"], kept)
    np.testing.assert_array_equal(ma.evaluate(one).joint_accelerations["arm"], kept)
    assert one.scene.gravity == tuple(G)


def test_a_robot_that_pinocchio_cannot_put_together_is_named():
    files = RobotFiles(find_robot("z1").urdf, (), np.eye(4), {"": "link06"}, {})
    with refused(ModelError, "'a'"):
        Robot("a", files)  # a joint and a link of it have one name
