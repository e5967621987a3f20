"""Derivatives of one arm: of the motion of the link that carries its tip, of its inverse dynamics.

Reference: J. Carpentier, N. Mansard, Analytical Derivatives of Rigid Body Dynamics Algorithms,
Robotics: Science and Systems 2018.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from multiarm.arms.arm import Arm


class ArmDerivatives:
    """Pinocchio's derivatives of one arm under a gravity (3,) [m/s^2]; for one thread at a time."""

    def __init__(self, arm: Arm, gravity: np.ndarray) -> None:
        self.arm, self.model = arm, arm.model.copy()
        self.model.gravity.linear = gravity
        self.data = self.model.createData()
        self._loads = pin.StdVec_Force()
        self._loads.extend([pin.Force.Zero()] * self.model.njoints)

    def link_motion(
        self, angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Motion of the link that carries the tip, and its derivatives.

        Returns
        -------
        link : ndarray, shape (27,)
            Rotation row by row and origin in the world [m], three zeros, and in the link's axes
            twist and spatial acceleration, without gravity.
        tables : ndarray, shape (4 n, 6)
            A row a joint, link axes: derivatives of the twist by the positions, of the spatial
            acceleration by positions and by velocities, and the Jacobian.
        """
        model, data, joint = self.model, self.data, self.arm.tip_joint
        q = self.arm.configuration(angles)
        pin.computeForwardKinematicsDerivatives(model, data, q, rates, accelerations)
        axes = pin.ReferenceFrame.LOCAL
        parts = pin.getJointAccelerationDerivatives(model, data, joint, axes)
        tables = np.empty((4 * model.nv, 6))
        for k, part in enumerate(parts):
            tables[k * model.nv : (k + 1) * model.nv] = np.reshape(part, (6, model.nv), "F").T
        pose, twist, spatial = data.oMi[joint], data.v[joint].vector, data.a[joint].vector
        link = [pose.rotation.ravel(), pose.translation, np.zeros(3), twist, spatial]
        return np.concatenate(link), tables

    def inverse_dynamics(
        self, angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, load: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of ``M q'' + b - J^T f`` by positions and velocities, and M, (n, n) each.

        ``load`` (6,) is the wrench f on the link that carries the tip, about its origin in its
        axes [N, N m], and stays constant in these.
        """
        self._loads[self.arm.tip_joint] = pin.Force(load)
        q = self.arm.configuration(angles)
        by_q, by_v, M = pin.computeRNEADerivatives(
            self.model, self.data, q, rates, accelerations, self._loads
        )
        return by_q, by_v, M
