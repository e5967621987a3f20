"""Pinocchio's own closed-loop algorithms on the same system: an oracle for tests, peers for speed.

All arms and the object (a free-flyer) are one Pinocchio model, each joint of a scene one or two
rigid constraints between a tip and the object: a weld has 6 rows, a ball 3, and a hinge, for which
Pinocchio has none, is written as two balls on its axis (6 rows, one of them redundant).

Both algorithms need care: with a regularisation of zero, which is what ``constraintDynamics`` has
as shipped, they return NaN or unconverged numbers without an exception when rows are redundant, and
``lcaba`` keeps state in its ``Data`` between calls.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from multiarm.arms.arm import named_with_prefix
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError

EXPRESSIBLE = ("weld", "ball", "revolute")
"""Kinds of joint that can be written with Pinocchio's rigid constraints."""
_SETTINGS = {
    "constraintDynamics": (1e-14, 1e-14, 1e-10, 50),
    "constraintDynamics as shipped": (),
    "lcaba": (1e-12, 1e-12, 1e-3, 100),
}
# Accuracies, regularisation, iterations.  All but the shipped ones were chosen, among four, as the
# most precise on two welded UR5s, folded and straight; other systems may want others.
ALGORITHMS = tuple(_SETTINGS)


def rigid_parts(joint) -> list[tuple[pin.ContactType, pin.SE3]]:
    """The rigid constraints of a joint, placed in its frame, whose z axis is a hinge's axis."""
    if joint.kind == "weld":
        return [(pin.ContactType.CONTACT_6D, pin.SE3.Identity())]
    if joint.kind == "ball":
        return [(pin.ContactType.CONTACT_3D, pin.SE3.Identity())]
    if joint.kind == "revolute":
        ends = (np.array([0.0, 0.0, side * joint.size / 2.0]) for side in (-1.0, 1.0))
        return [(pin.ContactType.CONTACT_3D, pin.SE3(np.eye(3), end)) for end in ends]
    kinds = ", ".join(EXPRESSIBLE)
    raise ModelError(f"Pinocchio has no rigid constraint for {joint.kind}; only {kinds}")


class PinocchioForest:
    """The system as one Pinocchio model whose loops are closed by rigid constraints.

    Parameters
    ----------
    system : System
        Welds, balls and hinges only.

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
        plant = system.model.constants
        inertia = pin.Inertia(float(plant.object_mass), np.zeros(3), plant.object_inertia)
        model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
        model.gravity.linear = plant.gravity
        self.model, self.data = model, model.createData()
        self.constraints = self._constraints(body)
        self.constraint_data = self._constraint_data()
        pin.initConstraintDynamics(model, self.data, self.constraints, self.constraint_data)

    def _constraints(self, body: int):
        constraints = pin.StdVec_RigidConstraintModel()
        layout = self.system.model.layout
        for joint in self.system.scene.joints:
            arm, frame = self.system.arms[joint.arm], self.system.frames[joint.arm]
            first = layout.dofs[layout.names.index(joint.arm)]
            on_tip = pin.SE3(arm.tip_rotation, arm.tip_translation) * pin.SE3(frame.on_tip)
            at = pin.SE3(frame.on_object)
            for kind, place in rigid_parts(joint):
                constraints.append(
                    pin.RigidConstraintModel(
                        kind,
                        self.model,
                        first + arm.tip_joint,
                        on_tip * place,
                        body,
                        at * place,
                        pin.ReferenceFrame.LOCAL,
                    )
                )
        return constraints

    def _constraint_data(self):
        data = pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            data.append(constraint.createData())
        return data

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

    def accelerations(
        self, state: State, torque: np.ndarray, algorithm: str = "constraintDynamics"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Object's classical acceleration in world axes (6,) and the joints' (n,).

        ``algorithm`` is one of ``ALGORITHMS``.  What it returns is passed on as it is, NaN too.
        """
        q, v = self.coordinates(state)
        settings = pin.ProximalSettings(*_SETTINGS[algorithm])
        if algorithm == "lcaba":
            data, constraint_data = self.model.createData(), self._constraint_data()
            pin.computeJointMinimalOrdering(self.model, data, self.constraints)
            run = pin.lcaba
        else:
            data, constraint_data = self.data, self.constraint_data
            run = pin.constraintDynamics
        a = run(
            self.model, data, q, v, self.torques(torque), self.constraints, constraint_data,
            settings,
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
        constraints, constraint_data = self.constraints, self._constraint_data()
        pin.computeJointMinimalOrdering(model, data, constraints)
        run = pin.lcaba

        def call():
            return run(model, data, q, v, tau, constraints, constraint_data, settings)

        return call


def _se3(position: np.ndarray) -> pin.SE3:
    return pin.XYZQUATToSE3(np.asarray(position, dtype=float))
