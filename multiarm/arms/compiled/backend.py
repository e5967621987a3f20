"""The compiled backend: arms whose terms batched kernels compute, and where the terms are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.arms.compiled.coriolis import update_coriolis
from multiarm.arms.compiled.kernels import update_arms
from multiarm.arms.compiled.tables import (
    BIAS,
    ENERGY,
    GRAVITY_TORQUE,
    JACOBIAN,
    JOINTS,
    PLACES,
    POSES,
    TERMS,
    WIDTH,
    WITH_GRAVITY_TORQUE,
    WITH_POSES,
    ArmTables,
    make_arrays,
    make_terms,
)
from multiarm.arms.terms import (
    BIAS_AT,
    GRAVITY_AT,
    J_AT,
    M_AT,
    M_STRIDE,
    POINTER_WIDTH,
    ArmFunctions,
    ArmState,
    Coriolis,
    LinkTerms,
)
from multiarm.contacts.kernel import BODY_WIDTH
from multiarm.jit.pointers import CFUNC_PROTOTYPE, address_of
from multiarm.jit.simd import LANES
from multiarm.jit.structs import make_struct

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm


class CompiledBackend:
    """Arms of one system that compiled code takes four at a time.

    An :class:`multiarm.arms.backends.ArmBackend`.  Its ``pointers`` have no pose, twist and drift:
    the motion of the link that carries the tip is in ``Buffers.arms`` when the sweep ends.

    Parameters
    ----------
    tables : ArmTables
        Constants, which several systems may share.
    places : sequence of int
        The arms' numbers among all arms of the scene.
    arms : mapping of str to Arm
        All arms of the scene, against which the compiled ones are verified.
    """

    def __init__(self, tables: ArmTables, places: Sequence[int], arms: Mapping[str, Arm]) -> None:
        self.tables, self.places, self._arms = tables, tuple(places), arms
        self._terms, self._coriolis = make_terms(tables), make_terms(tables)
        self._world = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        self._lanes = [
            _Lane(tables, place, int(joints))
            for place, joints in zip(self.places, tables.joints, strict=True)
        ]
        self.pointers = np.array([self._pointers(lane) for lane in self._lanes])

    def copy(self) -> CompiledBackend:
        """The same arms with terms of their own: the tables are shared."""
        wanted = self.tables.wanted.copy()  # another system may want more
        return CompiledBackend(self.tables._replace(wanted=wanted), self.places, self._arms)

    def bind(self, angles: np.ndarray, rates: np.ndarray, bodies: np.ndarray) -> None:
        """Let the sweeps read positions and velocities of all joints, and write all bodies."""
        self._arrays = make_arrays(self.tables, self._terms, self._coriolis, angles, rates, bodies)
        self._struct = make_struct(self._arrays)

    def connect(self, state: ArmState, status: Any) -> ArmFunctions:
        """Compiled function that updates all terms, its struct and size; nothing enters Python."""
        self.bind(state.angles, state.rates, state.bodies)
        struct = self._struct
        addresses = {
            "arms": address_of(update_arms),
            "arms_struct": struct.ctypes.data,
            "arms_size": struct.size,
        }
        return ArmFunctions(addresses, {})

    def connect_coriolis(self, status: Any, found: Coriolis) -> None:
        """Write the places of the matrices, and the function that updates them with its struct.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        from multiarm.arms.compiled.verification import CORIOLIS, verify

        verify(self.tables, self.places, self._arms, CORIOLIS)
        at = self._coriolis.ctypes.data
        for lane in self._lanes:
            found.places[lane.place] = at + 8 * lane.square, lane.stride
        found.calls[1:] = address_of(update_coriolis), self._struct.ctypes.data, self._struct.size

    def want_gravity_torque(self) -> None:
        """Write gravity torques from now on."""
        self.tables.wanted[WITH_GRAVITY_TORQUE] = 1

    def pose_address(self, place: int, joint: int) -> int:
        """Where the pose of a joint is written from now on; joint 0 is the world."""
        if joint == 0:
            return self._world.ctypes.data
        self.tables.wanted[WITH_POSES] = 1
        return self._terms.ctypes.data + 8 * self._lanes[self.places.index(place)].pose(joint - 1)

    def potential_energy(self) -> float:
        """Potential energy of all links [J] at the last state, zero at the world's origin."""
        return float(np.sum(self._terms[self.tables.energies]))

    def update(self, with_coriolis: bool = False) -> None:
        """Compute all terms at the positions and velocities bound, from Python."""
        for entry in (update_arms, update_coriolis) if with_coriolis else (update_arms,):
            CFUNC_PROTOTYPE(address_of(entry))(
                self._struct.ctypes.data, self._struct.size, 0.0, 0.0
            )

    def terms(self, arm: int) -> LinkTerms:
        """The terms of arm number ``arm`` of these as they were computed last, as copies."""
        lane, terms = self._lanes[arm], self._terms
        n = lane.joints
        lower = np.tril(_square(terms, lane.square, lane.stride, n))
        jacobian = terms[lane.jacobian : lane.jacobian + 6 * n].reshape(n, 6)
        return LinkTerms(
            inertia=lower + np.tril(lower, -1).T,
            jacobian=jacobian.T.copy(),
            bias=terms[lane.bias : lane.bias + n].copy(),
            gravity_torque=terms[lane.gravity_torque : lane.gravity_torque + n].copy(),
            poses=terms[lane.pose(0) : lane.pose(n)].reshape(n, 12).copy(),
            body=self._arrays.bodies.reshape(-1, BODY_WIDTH)[lane.place].copy(),
            energy=terms[lane.energy : lane.energy + 1].copy(),
            coriolis=_square(self._coriolis, lane.square, lane.stride, n).T.copy(),
        )

    def _pointers(self, lane: _Lane) -> np.ndarray:
        places, at = np.zeros(POINTER_WIDTH, dtype=np.int64), self._terms.ctypes.data
        places[M_AT], places[M_STRIDE] = at + 8 * lane.square, lane.stride
        places[J_AT], places[BIAS_AT] = at + 8 * lane.jacobian, at + 8 * lane.bias
        places[GRAVITY_AT] = at + 8 * lane.gravity_torque
        return places


class _Lane:
    """Where the terms of one arm are among all: ``joints`` of its own, matrices of ``stride``."""

    def __init__(self, tables: ArmTables, place: int, joints: int) -> None:
        (k, lane), *_ = np.argwhere(tables.blocks[:, PLACES : PLACES + LANES] == place)
        block = tables.blocks[k]
        self.place, self.joints, self.stride = place, joints, int(block[JOINTS])
        before = self.stride - self.joints  # joints that stand in for missing ones
        at = int(block[TERMS] + lane * block[WIDTH])
        self.square = at + before * (self.stride + 1)
        self.jacobian = at + int(block[JACOBIAN]) + 6 * before
        self.bias = at + int(block[BIAS]) + before
        self.gravity_torque = at + int(block[GRAVITY_TORQUE]) + before
        self.energy = at + int(block[ENERGY])
        self._poses = at + int(block[POSES]) + 12 * before

    def pose(self, link: int) -> int:
        """Place of the pose of one of the arm's links, counted from 0."""
        return self._poses + 12 * link


def _square(numbers: np.ndarray, at: int, stride: int, size: int) -> np.ndarray:
    """View of the (size, size) matrix at one place, its rows so many numbers apart."""
    return np.lib.stride_tricks.as_strided(numbers[at:], (size, size), (8 * stride, 8))
