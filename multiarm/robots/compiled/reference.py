"""Pinocchio's terms of a robot, with which its compiled copy is compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.geometry.frame_motion import FrameMotion
from multiarm.jit.rows import as_row
from multiarm.robots.robot import Robot
from multiarm.robots.terms import LinkPose, LinkTerms


def pinocchio_terms(
    robot: Robot,
    joints: Sequence[int],
    angles: np.ndarray,
    rates: np.ndarray,
    base_poses: np.ndarray,
    gravity: np.ndarray,
) -> list[LinkTerms]:
    """Pinocchio's terms at some states, as copies.

    Parameters
    ----------
    robot : Robot
    joints : sequence of int
        Pinocchio's numbers of the joints whose links are ``LinkTerms.bodies``; 0: the base.
    angles, rates : ndarray, shape (k, n)
        Joint positions [rad or m] and velocities, as of :class:`multiarm.robots.terms.RobotState`.
    base_poses : ndarray, shape (k, 7)
        Of the base where it floats, else of no use.
    gravity : ndarray, shape (3,)
    """
    model, near = robot.model.copy(), _near(robot.model)
    model.gravity.linear = np.array(gravity)
    data = model.createData(), near.createData()
    terms = []
    for angle, rate, pose in zip(angles, rates, base_poses, strict=True):
        if robot.floats:
            base = FrameMotion(pose, rate[: robot.base_dof])
            q, coriolis = (
                robot.configuration(angle[robot.base_dof :], base),
                np.zeros([robot.dof] * 2),
            )
        else:
            q = robot.configuration(angle)
            coriolis = pin.computeCoriolisMatrix(near, data[1], q, rate).copy()
        terms.append(_link_terms(robot, model, data[0], q, rate, joints, coriolis))
    return terms


def at_rest() -> np.ndarray:
    """The :class:`BodyMotion` of a base's link, whose frame is the world's, shape (24,)."""
    still = np.zeros(3)
    return as_row(BodyMotion(np.eye(3), still, still, still, still, still))


def _near(model: pin.Model) -> pin.Model:
    """The model with its first joint at the world's origin.

    Matrices of Coriolis forces are computed about that origin and lose digits far from it.
    """
    near = model.copy()
    base = model.jointPlacements[1].translation.copy()
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            near.jointPlacements[joint].translation = (
                model.jointPlacements[joint].translation - base
            )
    return near


def _link_terms(
    robot: Robot,
    model: pin.Model,
    data: pin.Data,
    q: np.ndarray,
    rate: np.ndarray,
    joints: Sequence[int],
    coriolis: np.ndarray,
) -> LinkTerms:
    turn = robot.turn(q)
    v = turn.T @ rate if robot.floats else rate
    inertia = np.triu(pin.crba(model, data, q, pin.Convention.LOCAL))
    gravity_torque = pin.computeGeneralizedGravity(model, data, q).copy()
    bias = pin.nonLinearEffects(model, data, q, v).copy()
    energy = pin.computePotentialEnergy(model, data, q)
    jacobian = pin.computeJointJacobians(model, data, q).reshape(6, model.nv).copy()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    links = data.oMi.tolist()[2 if robot.floats else 1 :]
    poses = [as_row(LinkPose(X.rotation, X.translation)) for X in links]
    bodies = [_motion(model, data, joint) if joint > 0 else at_rest() for joint in joints]
    inertia += np.triu(inertia, 1).T
    if robot.floats:
        inertia, jacobian = turn @ inertia @ turn.T, jacobian @ turn.T
        bias, gravity_torque = turn @ bias, turn @ gravity_torque
    return LinkTerms(
        inertia=inertia,
        jacobian=jacobian,
        bias=bias,
        gravity_torque=gravity_torque,
        poses=np.array(poses),
        bodies=np.array(bodies).reshape(-1, BODY_WIDTH),
        energy=np.array([energy]),
        factored=inertia,
        coriolis=coriolis,
    )


def _motion(model: pin.Model, data: pin.Data, joint: int) -> np.ndarray:
    """Motion of a joint's link, shape (24,)."""
    pose, twist = data.oMi[joint], data.v[joint]
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    drift = pin.getClassicalAcceleration(model, data, joint, axes)
    body = BodyMotion(
        rotation=pose.rotation,
        origin=pose.translation,
        velocity=pose.rotation @ twist.linear,
        spin=pose.rotation @ twist.angular,
        acceleration=drift.linear,
        spin_rate=drift.angular,
    )
    return as_row(body)
