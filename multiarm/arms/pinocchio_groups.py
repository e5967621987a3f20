"""Several arms in one Pinocchio model, and where it keeps their terms.

Two calls, ``crba`` in the world convention and ``nonLinearEffects``, fill in everything that all
arms of a group need, and the kernels read it where Pinocchio keeps it, through a table of
addresses.  Nothing is copied and no Python object is made inside a step.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from itertools import pairwise

import numpy as np
import pinocchio as pin

from multiarm.arms.arm import Arm, named_with_prefix
from multiarm.arms.terms import POINTER_WIDTH
from multiarm.errors import ModelError

# More arms a model mean fewer calls but a larger, mostly empty inertia matrix; fewer arms the
# opposite.  The cost per arm is flat around eight.
ARMS_PER_GROUP = 8


class ArmGroup:
    """Up to ``ARMS_PER_GROUP`` arms in one Pinocchio model, and where it keeps their terms.

    :meth:`bind` gives the function that updates the terms; ``pointers`` (arms, 8) says where the
    kernels find them, see :mod:`multiarm.arms.terms` for its columns.
    """

    def __init__(self, arms: list[Arm], gravity: np.ndarray, with_gravity_torque: bool):
        model = pin.Model()
        for arm in arms:
            model = pin.appendModel(model, named_with_prefix(arm), 0, pin.SE3.Identity())
        model.gravity.linear = gravity
        model.armature = np.concatenate([arm.model.armature for arm in arms])  # not appended
        self.model, self.data = model, model.createData()
        self.q = pin.neutral(model)
        self.v = np.zeros(model.nv)
        first_dof = np.cumsum([0] + [arm.dof for arm in arms])
        self.q_slots = np.array([j.idx_q for j in model.joints[1:]], dtype=np.int64)
        if not np.array_equal([j.idx_v for j in model.joints[1:]], np.arange(model.nv)):
            raise ModelError("Pinocchio did not number the joints of several arms in order")
        self.pointers = np.zeros((len(arms), POINTER_WIDTH), dtype=np.int64)
        self._first_dof = first_dof
        self._tips = [int(d) + arm.tip_joint for arm, d in zip(arms, first_dof, strict=False)]
        self._fill_pointers(first_dof[:-1], self._tips)
        self._with_gravity_torque = with_gravity_torque

    def copy(self) -> ArmGroup:
        """The same arms with terms of their own: the model is shared."""
        other = copy(self)
        other.data, other.pointers = self.model.createData(), np.zeros_like(self.pointers)
        other._fill_pointers(self._first_dof[:-1], self._tips)
        return other

    def bind(self, q: np.ndarray, v: np.ndarray) -> Callable[[], None]:
        """Function without arguments that updates all terms from the arrays ``q`` and ``v``."""
        model, data = self.model, self.data
        crba, bias, world = pin.crba, pin.nonLinearEffects, pin.Convention.WORLD
        gravity_torque = pin.computeGeneralizedGravity

        def update() -> None:
            crba(model, data, q, world)
            bias(model, data, q, v)

        def update_with_gravity_torque() -> None:
            # first, because it leaves its own numbers in data.a_gf, which nonLinearEffects owns
            gravity_torque(model, data, q)
            crba(model, data, q, world)
            bias(model, data, q, v)

        return update_with_gravity_torque if self._with_gravity_torque else update

    def bind_coriolis(self, q: np.ndarray, v: np.ndarray) -> tuple[Callable[[], None], np.ndarray]:
        """Function that updates the matrices of Coriolis forces, and where each arm's is.

        Addresses and strides, int64 (arms, 2); the matrices are those for which the rate of the
        inertia is ``C + C^T``.
        """
        model, data, n = self.model, self.model.createData(), self.model.nv
        run = pin.computeCoriolisMatrix

        def update() -> None:
            run(model, data, q, v)

        update()
        at = _address(data.C)
        _require_layout(sorted(data.C.strides) == [8, 8 * n] or n == 1, "C is not stored densely")
        first_dof = (self.pointers[:, 0] - self.pointers[0, 0]) // (8 * (n + 1))
        places = np.stack([at + 8 * (n + 1) * first_dof, np.full_like(first_dof, n)], axis=1)
        return update, places

    def pose_address(self, arm: int, joint: int) -> int:
        """Where the pose of a joint of the group's arm number ``arm`` is; see ``POSE_AT``."""
        return _address(self.data.oMi[int(self._first_dof[arm]) + joint].rotation)

    def potential_energy(self, q: np.ndarray) -> float:
        """Potential energy of all links [J], zero at the world's origin."""
        return pin.computePotentialEnergy(self.model, self.data, q)

    def _fill_pointers(self, first_dof: np.ndarray, tips: list[int]) -> None:
        """Read addresses once; check the memory layout that the kernels rely on."""
        data, n = self.data, self.model.nv
        pin.crba(self.model, data, self.q, pin.Convention.WORLD)
        pin.nonLinearEffects(self.model, data, self.q, self.v)
        pin.computeGeneralizedGravity(self.model, data, self.q)
        _require_layout(data.M.strides == (8, 8 * n) or n == 1, "M is not stored by columns")
        J = data.J
        _require_layout(J.size == 6 * n and J.strides[0] == 8, "J is not stored by columns")
        for row, (d, tip) in enumerate(zip(first_dof, tips, strict=True)):
            d = int(d)
            pose, twist, drift = data.oMi[tip], data.v[tip], data.a_gf[tip]
            at = _address(pose.rotation)
            _require_layout(_address(pose.translation) == at + 72, "SE3 is not [R, p]")
            for motion in (twist, drift):
                near = _address(motion.angular) == _address(motion.linear) + 24
                _require_layout(near, "Motion is not [linear, angular]")
            self.pointers[row] = (
                _address(data.M) + 8 * (d * n + d),
                n,
                _address(J) + 8 * 6 * d,
                _address(data.nle) + 8 * d,
                _address(data.g) + 8 * d,
                at,
                _address(twist.linear),
                _address(drift.linear),
            )


def group_arms(arms: list[Arm], gravity: np.ndarray, with_gravity_torque: bool) -> list[ArmGroup]:
    """Split the arms into groups of at most ``ARMS_PER_GROUP``, as even as possible."""
    count = -(-len(arms) // ARMS_PER_GROUP)
    bounds = np.linspace(0, len(arms), count + 1).round().astype(int)
    return [ArmGroup(arms[a:b], gravity, with_gravity_torque) for a, b in pairwise(bounds)]


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


class Ground:
    """The surroundings as an arm without joints: a body at rest at the world's origin.

    ``pointers`` (8,) are those of an :class:`ArmGroup`; valid while this lives.
    """

    def __init__(self, gravity: np.ndarray):
        pose = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        still, drift = np.zeros(6), np.concatenate([-gravity, np.zeros(3)])
        self._kept = pose, still, drift
        at = [array.ctypes.data for array in (still, pose, still, drift)]
        # inertia and its stride, Jacobian, bias, gravity: none; pose, twist, drift
        self.pointers = np.array([at[0], 1, at[0], at[0], at[0], *at[1:]], dtype=np.int64)


def _require_layout(condition: bool, what: str) -> None:
    if not condition:
        raise ModelError(
            f"this build of Pinocchio ({pin.__version__}) stores its data differently ({what}); "
            f"install pin 4.x from PyPI"
        )
