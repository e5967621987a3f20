"""Claims about `System.kinematics`: finite differences, Pinocchio's own model, copies, errors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from event_scenes import box, on_floor
from mechanics import first_difference, random_state, ur5_pair
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import ModelError
from multiarm.scene import find_robot

# What differences of order 8 with a step of 0.01 s leave of a speed of some m/s.
DIFFERENCE = 1e-10


@pytest.fixture(scope="module", params=["compiled", "pinocchio"])
def system(request):
    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}), arms=request.param)


def test_a_tip_moves_with_its_jacobian(system, rng):
    state = random_state(system, rng)
    tips = system.kinematics(state).tips
    assert list(tips) == list(system.arm_names)
    for arm, tip in tips.items():
        v = state.joint_velocities[arm]

        def place(t, arm=arm, v=v):
            q = state.joint_positions[arm] + t * v
            moved = system.kinematics(system.state(joint_positions={arm: q})).tips[arm]
            turn = Rotation.from_matrix(moved.rotation @ tips[arm].rotation.T).as_rotvec()
            return np.append(moved.position, turn)

        np.testing.assert_allclose(tip.jacobian @ v, tip.twist, atol=1e-13)
        np.testing.assert_allclose(first_difference(place, 1e-2), tip.twist, atol=DIFFERENCE)
        assert tip.jacobian.shape == (6, len(tip.joint_names))
        assert tip.joint_names == system.arms[arm].joint_names


def test_columns_of_a_jacobian_are_the_motions_of_its_joints(system):
    state = system.initial_state()
    for arm, tip in system.kinematics().tips.items():
        for k in range(len(tip.joint_names)):
            rates = {arm: np.eye(len(tip.joint_names))[k]}
            moving = system.state(joint_velocities=rates)
            twist = system.kinematics(moving).tips[arm].twist
            np.testing.assert_allclose(tip.jacobian[:, k], twist, atol=1e-14)
        np.testing.assert_array_equal(tip.position, system.kinematics(state).tips[arm].position)


def test_a_tip_is_that_of_the_robot_s_file(system, rng):
    """By Pinocchio's model of the file, with the base as a placement in front."""
    state = random_state(system, rng)
    model = pin.buildModelFromUrdf(str(find_robot("ur5").urdf))
    data, frame = model.createData(), model.getFrameId("tool0")
    for arm, tip in system.kinematics(state).tips.items():
        base = pin.SE3(system.scene.arms[arm].base.matrix())
        q, v = state.joint_positions[arm].copy(), state.joint_velocities[arm].copy()
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pose, turn = base * data.oMf[frame], np.kron(np.eye(2), base.rotation)
        twist = turn @ pin.getFrameVelocity(model, data, frame, axes).vector
        jacobian = turn @ pin.getFrameJacobian(model, data, frame, axes)
        np.testing.assert_allclose(tip.position, pose.translation, atol=1e-12)
        np.testing.assert_allclose(tip.rotation, pose.rotation, atol=1e-12)
        np.testing.assert_allclose(tip.twist, twist, atol=1e-12)
        np.testing.assert_allclose(tip.jacobian, jacobian, atol=1e-12)


def test_an_arm_of_one_slide_has_one_column():
    system = ma.compile_system(on_floor(box()))
    (tip,) = system.kinematics().tips.values()
    np.testing.assert_allclose(tip.jacobian, [[1.0], [0], [0], [0], [0], [0]], atol=1e-15)
    assert tip.joint_names == ("j1",)


def test_what_a_user_writes_into_a_result_changes_nothing(system):
    first = system.kinematics()
    tip = first.tips["left"]
    expected = [tip.position.copy(), tip.jacobian.copy(), system.initial_state().position]
    state = system.initial_state()
    here = system.kinematics(state).tips["left"]
    state.position[:] = np.nan
    for array in (here.position, here.rotation, here.twist, here.jacobian):
        array[:] = np.nan
    again = system.kinematics().tips["left"]
    np.testing.assert_array_equal(again.position, expected[0])
    np.testing.assert_array_equal(again.jacobian, expected[1])
    np.testing.assert_array_equal(tip.position, expected[0])
    np.testing.assert_array_equal(system.initial_state().position, expected[2])


def test_unknown_arms_and_foreign_states_are_refused(system):
    with pytest.raises(ModelError, match=r"'middle'.*'left', 'right'"):
        system.kinematics().tips["middle"]
    with pytest.raises(KeyError):
        system.kinematics().tips["middle"]
    assert system.kinematics().tips.get("middle") is None
    for wrong in (3, np.zeros(19)):
        with pytest.raises(ModelError):
            system.kinematics(wrong)


def test_a_result_tells_where_the_tips_are(system):
    text = repr(system.kinematics())
    assert all(arm in text for arm in system.arm_names) and "\n" not in text
