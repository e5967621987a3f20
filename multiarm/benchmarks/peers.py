"""Pinocchio's own closed-loop algorithms on the same system: an oracle for tests, peers for speed.

All arms and the object (a free-flyer) are one Pinocchio model, each joint of a scene one rigid
constraint between a tip and the object.  Only welds (6 rows) and balls (3 rows) can be written so.

Both algorithms need care: with a regularisation of zero they return NaN or unconverged numbers
without an exception, and ``lcaba`` keeps state in its ``Data`` between calls.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from multiarm.arm import named_with_prefix
from multiarm.errors import ModelError
from multiarm.state import State
from multiarm.system import System

_TYPES = {"weld": pin.ContactType.CONTACT_6D, "ball": pin.ContactType.CONTACT_3D}


class PinocchioForest:
    """The system as one Pinocchio model whose loops are closed by rigid constraints.

    Parameters
    ----------
    system : System
        Welds and balls only.

    Raises
    ------
    ModelError
        For a joint that Pinocchio has no rigid constraint for.
    """

    def __init__(self, system: System):
        self.system = system
        model = pin.Model()
        for arm in system.arms.values():
            model = pin.appendModel(model, named_with_prefix(arm), 0, pin.SE3.Identity())
        body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        plant = system.plant
        inertia = pin.Inertia(float(plant.object_mass[0]), np.zeros(3), plant.object_inertia)
        model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
        model.gravity.linear = plant.gravity
        self.model, self.data = model, model.createData()
        self.constraints = self._constraints(body)
        self.constraint_data = pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            self.constraint_data.append(constraint.createData())
        self.tight = pin.ProximalSettings(1e-14, 1e-14, 1e-10, 50)
        pin.initConstraintDynamics(model, self.data, self.constraints, self.constraint_data)

    def _constraints(self, body: int):
        start = self.system.initial_state()
        pose = _se3(start.position[:7])
        constraints = pin.StdVec_RigidConstraintModel()
        for joint in self.system.scene.joints:
            arm = self.system.arms[joint.arm]
            first = sum(
                self.system.arms[name].dof
                for name in self.system.arm_names[: self.system.arm_names.index(joint.arm)]
            )
            if joint.kind not in _TYPES:
                kinds = ", ".join(_TYPES)
                raise ModelError(
                    f"Pinocchio has no rigid constraint for {joint.kind}; only {kinds}"
                )
            on_tip = pin.SE3(arm.tip_rotation, arm.tip_translation) * pin.SE3(joint.at_tip.matrix())
            tip = pin.SE3(arm.tip_pose(start.joint_positions[joint.arm]))
            at = pose.inverse() * tip * pin.SE3(joint.at_tip.matrix())
            if joint.at is not None:
                at = pin.SE3(joint.at.matrix())
            constraints.append(
                pin.RigidConstraintModel(
                    _TYPES[joint.kind],
                    self.model,
                    first + arm.tip_joint,
                    on_tip,
                    body,
                    at,
                    pin.ReferenceFrame.LOCAL,
                )
            )
        return constraints

    def coordinates(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Pinocchio's configuration and velocity of a state."""
        q = [arm.configuration(state.joint_positions[n]) for n, arm in self.system.arms.items()]
        rotation = _se3(state.position[:7]).rotation
        twist = state.object_twist
        local = np.concatenate([rotation.T @ twist[:3], rotation.T @ twist[3:]])
        return (
            np.concatenate([*q, state.position[:7]]),
            np.concatenate([*state.joint_velocities.values(), local]),
        )

    def torques(self, torque: np.ndarray) -> np.ndarray:
        """Generalised forces of joint torques."""
        return np.concatenate([torque, np.zeros(6)])

    def accelerations(self, state: State, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object's classical acceleration in world axes (6,) and the joints' (n,), to full
        precision, by ``constraintDynamics``.
        """
        q, v = self.coordinates(state)
        a = pin.constraintDynamics(
            self.model, self.data, q, v, self.torques(torque), self.constraints,
            self.constraint_data, self.tight,
        )  # fmt: skip
        rotation, local = _se3(state.position[:7]).rotation, v[-6:]
        linear = rotation @ (a[-6:-3] + np.cross(local[3:], local[:3]))
        return np.concatenate([linear, rotation @ a[-3:]]), a[:-6].copy()

    def constraint_dynamics_call(self, state: State, torque: np.ndarray):
        """A function without arguments that runs ``constraintDynamics`` once."""
        q, v = self.coordinates(state)
        tau = self.torques(torque)
        settings = pin.ProximalSettings(1e-10, 1e-10, 1e-10, 10)
        run = pin.constraintDynamics
        model, data = self.model, self.data
        constraints, constraint_data = self.constraints, self.constraint_data

        def call():
            return run(model, data, q, v, tau, constraints, constraint_data, settings)

        return call

    def lcaba_call(self, state: State, torque: np.ndarray, mu: float = 1e-6):
        """A function without arguments that runs ``lcaba`` once."""
        q, v = self.coordinates(state)
        tau = self.torques(torque)
        settings = pin.ProximalSettings(1e-10, 1e-10, mu, 10)
        model, data = self.model, self.model.createData()
        constraints = self.constraints
        constraint_data = pin.StdVec_RigidConstraintData()
        for constraint in constraints:
            constraint_data.append(constraint.createData())
        pin.computeJointMinimalOrdering(model, data, constraints)
        run = pin.lcaba

        def call():
            return run(model, data, q, v, tau, constraints, constraint_data, settings)

        return call


def _se3(position: np.ndarray) -> pin.SE3:
    return pin.XYZQUATToSE3(np.asarray(position, dtype=float))
