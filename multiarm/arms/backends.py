"""Arm-dynamics backends: what computes the terms of each arm of a system.

A backend reads positions and velocities of its arms from given arrays and leaves inertia, bias,
Jacobian and the motion of the tip's link at fixed addresses, where kernels find them through a
table (:mod:`multiarm.arms.terms`).  There are two: Pinocchio, called back in Python
(:mod:`multiarm.arms.pinocchio_backend`), and batched RNEA and CRBA in compiled code
(:mod:`multiarm.arms.compiled`).  A system may have arms of both.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from copy import copy
from typing import Any, Protocol

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.pinocchio_backend import PinocchioBackend
from multiarm.arms.terms import POINTER_WIDTH, ArmFunctions, ArmState, Coriolis
from multiarm.jit.pointers import PythonCallback


class ArmBackend(Protocol):
    """Computes the terms of some of a system's arms.

    Attributes
    ----------
    places : tuple of int
        Numbers of its arms among all arms of the scene.
    pointers : int64 ndarray, shape (its arms, 8)
        Where each arm's terms are, see :mod:`multiarm.arms.terms`; valid while the backend lives.
    """

    places: tuple[int, ...]
    pointers: np.ndarray

    def copy(self) -> ArmBackend:
        """The same arms with terms of their own: constants are shared."""
        ...

    def connect(self, state: ArmState, status: Any) -> ArmFunctions:
        """What updates the terms at a state; see :meth:`ArmBackends.connect`."""
        ...

    def connect_coriolis(self, status: Any, found: Coriolis) -> PythonCallback | None:
        """Write where the matrices of Coriolis forces are, and what updates them."""
        ...

    def pose_address(self, place: int, joint: int) -> int:
        """Where the pose of a joint of arm number ``place`` of the scene is: axes, origin."""
        ...

    def potential_energy(self) -> float:
        """Potential energy of its arms [J] at the state evaluated last, zero at the origin."""
        ...


class ArmBackends:
    """The arms of one system and the backends that compute their terms.

    Parameters
    ----------
    arms : mapping of str to Arm
    gravity : ndarray, shape (3,)
    with_gravity_torque : bool
        Whether the control needs the gravity torques.
    compiled : bool
        Whether arms that can be are compiled; they are then verified against Pinocchio's.

    Attributes
    ----------
    by_arm : dict of str to str
        ``"compiled"`` or ``"pinocchio"``.
    reasons : dict of str to str
        Why an arm stays with Pinocchio although compiled ones were wanted.
    pointers : int64 ndarray, shape (arms, 8)
        Where each arm's terms are, see :mod:`multiarm.arms.terms`; valid while this lives.
    q_slots : int64 ndarray, shape (joints,)
        Place of each joint in Pinocchio's configuration; -1 for those of compiled arms.
    configuration : int
        Numbers in that configuration.
    """

    def __init__(
        self,
        arms: Mapping[str, Arm],
        gravity: np.ndarray,
        with_gravity_torque: bool,
        compiled: bool = False,
    ) -> None:
        self._arms = dict(arms)
        self._backends: list[ArmBackend] = []
        self._coriolis: tuple[Coriolis, PythonCallback | None] | None = None
        self.reasons: dict[str, str] = {}
        self.by_arm = dict.fromkeys(arms, "pinocchio")
        if compiled:
            self._compile(gravity, with_gravity_torque)
        rest = {k: arms[name] for k, name in enumerate(arms) if self.by_arm[name] == "pinocchio"}
        first_joints = np.cumsum([0, *(arm.dof for arm in arms.values())])
        pinocchio = PinocchioBackend(rest, first_joints, gravity, with_gravity_torque)
        self._backends.append(pinocchio)
        self.q_slots, self.configuration = pinocchio.q_slots, pinocchio.configuration
        self.pointers = self._all_pointers()

    def _compile(self, gravity: np.ndarray, with_gravity_torque: bool) -> None:
        """Take the arms that can be compiled."""
        from multiarm.arms.compiled.verification import compile_arms

        backend, self.reasons = compile_arms(self._arms, gravity)
        for name, reason in self.reasons.items():
            warnings.warn(f"arm '{name}' stays with Pinocchio: {reason}", stacklevel=2)
        if backend is not None:
            names = list(self._arms)
            self.by_arm |= {names[place]: "compiled" for place in backend.places}
            if with_gravity_torque:
                backend.want_gravity_torque()
            self._backends.append(backend)

    def copy(self) -> ArmBackends:
        """The same arms with terms of their own: models and tables are shared."""
        other = copy(self)
        other._backends = [backend.copy() for backend in self._backends]
        other._coriolis = None
        other.pointers = other._all_pointers()
        return other

    def _all_pointers(self) -> np.ndarray:
        pointers = np.zeros((len(self._arms), POINTER_WIDTH), dtype=np.int64)
        for backend in self._backends:
            pointers[list(backend.places)] = backend.pointers
        return pointers

    def pose_address(self, arm: int, joint: int) -> int:
        """Where the pose of a joint of an arm is: rotation by columns, origin."""
        own = next(backend for backend in self._backends if arm in backend.places)
        return own.pose_address(arm, joint)

    def connect(
        self,
        angles: np.ndarray,
        rates: np.ndarray,
        q: np.ndarray,
        bodies: np.ndarray,
        status: Any,
    ) -> ArmFunctions:
        """Let all arms read positions and velocities, and write the motion of their last links.

        Parameters
        ----------
        angles, rates, q, bodies : ndarray
            See :class:`multiarm.arms.terms.ArmState`.
        status : Numbers
            ``failed`` is set when Pinocchio raises, ``potential_energy`` where that is wanted.
        """
        state, made = ArmState(angles, rates, q, bodies), ArmFunctions({}, {})
        for backend in self._backends:
            addresses, callbacks = backend.connect(state, status)
            made.addresses.update(addresses)
            made.callbacks.update(callbacks)
        return made

    def potential_energy(self) -> float:
        """Potential energy of all arms [J] at the state evaluated last, zero at the origin."""
        return sum(backend.potential_energy() for backend in self._backends)

    def coriolis(self, status: Any) -> tuple[Coriolis, PythonCallback | None]:
        """What updates the matrices of Coriolis forces, and where they are; the callback in it.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        if self._coriolis is None:
            count = len(self._arms)
            found = Coriolis(np.zeros(4, dtype=np.int64), np.zeros((count, 2), dtype=np.int64))
            calls = [backend.connect_coriolis(status, found) for backend in self._backends]
            self._coriolis = found, next((call for call in calls if call is not None), None)
        return self._coriolis


class Ground:
    """The surroundings as an arm without joints: a body at rest at the world's origin.

    ``pointers`` (8,) are as those of a backend; valid while this lives.
    """

    def __init__(self, gravity: np.ndarray):
        pose = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        still, drift = np.zeros(6), np.concatenate([-gravity, np.zeros(3)])
        self._kept = pose, still, drift
        at = [array.ctypes.data for array in (still, pose, still, drift)]
        # inertia and its stride, Jacobian, bias, gravity: none; pose, twist, drift
        self.pointers = np.array([at[0], 1, at[0], at[0], at[0], *at[1:]], dtype=np.int64)
