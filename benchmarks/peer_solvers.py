"""Closed-loop algorithms of other programs that tell their accelerations at one state.

Pinocchio's algorithms have the object as a free-flyer beside all arms. They need care: with a
regularisation of zero, which is what ``constraintDynamics`` has as shipped, they return NaN or
unconverged numbers without an exception when rows are redundant, and ``lcaba`` keeps state in its
``Data`` between calls.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import ClassVar

import numpy as np
import pinocchio as pin

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.spatial import quaternion_to_matrix
from multiarm.studies.peers import Peer
from multiarm.studies.pinocchio_peer import SETTINGS, PinocchioPeer

Settings = tuple[float, ...]
"""Absolute and relative accuracy, regularisation, iterations; empty: as shipped."""

BYTES_PER_CUBE = 64
"""Memory of Pinocchio's Data, as measured, grows with the cube of the number of joints."""


def memory_needed(joints: int) -> float:
    """About what Pinocchio's Data takes for a system of so many joints [bytes]."""
    return BYTES_PER_CUBE * (6.0 + joints) ** 3


class Solver(Peer):
    """A peer that can be asked for its accelerations at one state."""

    @abstractmethod
    def accelerations(self, state: State, torque: np.ndarray) -> np.ndarray:
        """The object's classical acceleration in world axes and the joints', shape (6 + n,)."""


class Tree(PinocchioPeer):
    """The algorithm with the object on the last arm, at one state."""

    fast: ClassVar[Settings] = SETTINGS
    """Where an algorithm is timed."""

    def evaluation(self, state: State, torque: np.ndarray) -> Callable[[], np.ndarray]:
        """A function without arguments, to be timed, that runs the algorithm once."""
        return self.call(*self.arguments(state, torque), self.fast)

    def arguments(
        self, state: State, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pinocchio's configuration, velocity and generalised forces."""
        n, nq, nv = torque.size, self.model.nq, self.model.nv
        y, tau = self.coordinates(state), np.zeros(nv)
        q, v = y[:nq].copy(), y[nq : nq + nv].copy()
        tau[:n] = torque - self.damping * v[:n]
        return q, v, tau

    def call(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, settings: Settings
    ) -> Callable[[], np.ndarray]:
        """A function without arguments that runs the algorithm once."""
        return partial(
            pin.constraintDynamics, self.model, self.data, q, v, tau, self.constraints,
            self.constraint_data, pin.ProximalSettings(*settings),
        )  # fmt: skip


class ConstraintDynamics(Tree, Solver):
    """``constraintDynamics`` on the forest of all arms and a free object.

    Its settings, like those of :class:`Lcaba`, were chosen among four as the most precise on two
    welded UR5s, folded and straight; other systems may want others.
    """

    precise: ClassVar[Settings] = (1e-14, 1e-14, 1e-10, 50)
    """For accelerations."""

    def __init__(self, system: System):
        super().__init__(system, holder="")

    def accelerations(self, state: State, torque: np.ndarray) -> np.ndarray:
        """The object's classical acceleration and the joints', as Pinocchio returns them."""
        q, v, tau = self.arguments(state, torque)
        a = self.call(q, v, tau, self.precise)()
        rotation, local = quaternion_to_matrix(state.object_quaternion_xyzw), v[-6:]
        linear = rotation @ (a[-6:-3] + np.cross(local[3:], local[:3]))
        return np.concatenate([linear, rotation @ a[-3:], a[:-6]])


class AsShipped(ConstraintDynamics):
    """``constraintDynamics`` with its own settings, which regularise nothing."""

    precise: ClassVar[Settings] = ()


class Lcaba(ConstraintDynamics):
    """``lcaba`` on the same forest."""

    precise: ClassVar = (1e-12, 1e-12, 1e-3, 100)
    fast: ClassVar = (1e-10, 1e-10, 1e-6, 10)

    def call(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, settings: Settings
    ) -> Callable[[], np.ndarray]:
        """The algorithm with a Data of its own, since it keeps state there."""
        data, constraint_data = self.model.createData(), self.new_constraint_data()
        pin.computeJointMinimalOrdering(self.model, data, self.constraints)
        return partial(
            pin.lcaba, self.model, data, q, v, tau, self.constraints, constraint_data,
            pin.ProximalSettings(*settings),
        )  # fmt: skip
