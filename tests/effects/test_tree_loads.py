"""Claims about wrenches on links of robots that are trees: they act through the link's chain."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from mechanics import data_of, random_state
from tree_scenes import cart_scene, gripper_scene

import multiarm as ma
from multiarm.scene import parse_scene

SCENES = {"cart": cart_scene, "gripper": gripper_scene}


def forces_of(table, wrenches, state, arms):
    """Generalised forces of wrenches, on the object and on the joints."""
    forces = []
    for effects in ({}, {"external_wrenches": wrenches}):
        scene = parse_scene({**table, "effects": effects, "run": {"arms": arms}})
        system = ma.compile_system(scene)
        ma.evaluate(system, 0.0, state)
        forces.append(data_of(system).arrays.forces.f.copy())
    return forces[1] - forces[0]


@pytest.mark.parametrize("arms", ["pinocchio", "compiled"])
@pytest.mark.parametrize("axes", ["world", "body"])
@pytest.mark.parametrize("name", SCENES)
def test_a_wrench_on_a_link_of_a_branch_is_that_of_its_jacobian(name, axes, arms, rng):
    """By Pinocchio's Jacobian of the link's frame; joints of other branches feel nothing."""
    table = SCENES[name]()
    system = ma.compile_system(parse_scene(table))
    state, robot = random_state(system, rng), system.arms[name]
    model, q = robot.model, robot.configuration(state.joint_positions[name])
    data, body = model.createData(), pin.FrameType.BODY
    ends = {f.parentJoint: f.name for f in model.frames if f.type == body and f.parentJoint > 0}
    for joint, link in ends.items():
        f, m, at = rng.standard_normal((3, 3))
        wrench = {"on": f"{name}/{link}", "at": at.tolist(), "axes": axes}
        wrench |= {"force": f.tolist(), "torque": m.tolist()}
        added = forces_of(table, [wrench], state, arms)
        frame = model.getFrameId(link, body)
        world_axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(model, data, q, frame, world_axes)
        R = pin.updateFramePlacement(model, data, frame).rotation
        f, m = (R @ f, R @ m) if axes == "body" else (f, m)
        expected = J.T @ np.concatenate([f, m + np.cross(R @ at, f)])
        np.testing.assert_allclose(added[6:], expected, atol=1e-10)
        chain = np.array(model.supports[joint].tolist()[1:]) - 1
        np.testing.assert_array_equal(np.delete(added[6:], chain), 0.0)
        np.testing.assert_array_equal(added[:6], 0.0)
