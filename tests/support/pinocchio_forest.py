"""All arms and the object in one Pinocchio model, with the joints as constraints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation


def forest(system):
    """All arms and the free-flying object in one Pinocchio model, and the object's joint."""
    model = pin.Model()
    for name, arm in system.arms.items():
        part = arm.model.copy()
        for i in range(1, part.njoints):
            part.names[i] = f"{name}/{part.names[i]}"
        for i in range(1, part.nframes):
            part.frames[i].name = f"{name}/{part.frames[i].name}"
        model = pin.appendModel(model, part, 0, pin.SE3.Identity())
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
    body = system.scene.object
    inertia = pin.Inertia(body.mass, np.zeros(3), body.inertia_matrix())
    model.appendBodyToJoint(at, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array(system.scene.gravity)
    return model, at


def constrained_forest(system, state, contact_type):
    """The model of :func:`forest`, its configuration at a state, and the joints as constraints.

    Rows of six or of three, at the tips, closed at the state.
    """
    model, at = forest(system)
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    X_WO = pin.SE3(R, state.object_position)
    q = [arm.configuration(state.joint_positions[name]) for name, arm in system.arms.items()]
    q = np.concatenate([*q, state.object_position, state.object_quaternion_xyzw])
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    joint = 0
    for name, arm in system.arms.items():
        X_OT = X_WO.inverse() * pin.SE3(arm.tip_pose(state.joint_positions[name]))
        models.append(
            pin.RigidConstraintModel(
                contact_type, model, joint + arm.tip.joint,
                pin.SE3(arm.tip.rotation, arm.tip.translation), at, X_OT, pin.ReferenceFrame.LOCAL,
            )
        )  # fmt: skip
        datas.append(models[-1].createData())
        joint += arm.dof
    return model, q, R, models, datas
