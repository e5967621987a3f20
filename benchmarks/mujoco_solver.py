"""MuJoCo's accelerations at one state, hardened and as shipped."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np
from peer_solvers import Solver

from multiarm.dynamics.state import State
from multiarm.spatial import quaternion_to_matrix
from multiarm.studies.mujoco_peer import MujocoPeer, quiet


class Mujoco(MujocoPeer, Solver):
    """MuJoCo with hardened constraints."""

    def accelerations(self, state: State, torque: np.ndarray) -> np.ndarray:
        """As MuJoCo returns them, in the package's order and axes."""
        d, n = self.data, self.system.model.layout.rate_count
        self.place(state)
        d.qfrc_applied[:n] = torque
        with quiet():
            mujoco.mj_forward(self.model, d)
        # the free joint's: linear in world axes, angular in the object's own
        angular = quaternion_to_matrix(state.object_quaternion_xyzw) @ d.qacc[n + 3 :]
        return np.concatenate([d.qacc[n : n + 3], angular, d.qacc[:n]])


class AsShipped(Mujoco):
    """MuJoCo with its own settings."""

    hardened: ClassVar = False
