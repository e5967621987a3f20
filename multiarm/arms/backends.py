"""Who supplies the terms of each arm: Pinocchio, through a callback, or compiled copies.

Pinocchio's arms are taken in groups of neighbours
(:class:`multiarm.arms.pinocchio_groups.ArmGroup`); all compiled ones together
(:class:`multiarm.arms.compiled.group.CompiledArms`).  Whoever needs an arm's terms finds them
through ``pointers``, in the order of the scene.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.pinocchio_groups import ArmGroup, group_arms
from multiarm.arms.terms import POINTER_WIDTH
from multiarm.jit.pointers import PythonCallback

if TYPE_CHECKING:
    from multiarm.arms.compiled.group import CompiledArms


class ArmFunctions(NamedTuple):
    """What updates the terms of all arms.

    addresses : dict of str to int
        Fields of :class:`multiarm.dynamics.arrays.Functions`.
    callbacks : dict of str to PythonCallback
        Those that enter Python; empty where all arms are compiled.
    """

    addresses: dict[str, int]
    callbacks: dict[str, PythonCallback]


class Coriolis(NamedTuple):
    """Where the arms' matrices of Coriolis forces are, and what updates them.

    calls : int64 (4,)
        Address of a callback (0: none), and of an entry (0: none) with its struct and size.
    places : int64 (arms, 2)
        Addresses and strides.
    """

    calls: np.ndarray
    places: np.ndarray


class ArmSupply:
    """The arms of one system and who computes their terms.

    Parameters
    ----------
    arms : dict of str to Arm
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
        self._first = np.cumsum([0, *(arm.dof for arm in arms.values())])
        self.compiled, self.reasons = _compiled(arms, gravity) if compiled else (None, {})
        own = () if self.compiled is None else self.compiled.places
        every = list(arms.values())
        self.by_arm = {name: "compiled" if k in own else "pinocchio" for k, name in enumerate(arms)}
        self._groups: list[_Group] = []
        self._coriolis: tuple[Coriolis, PythonCallback | None] | None = None
        self.q_slots = np.full(self._first[-1], -1, dtype=np.int64)
        self.configuration = 0
        for places in _runs([k for k in range(len(every)) if k not in own]):
            for group in group_arms([every[k] for k in places], gravity, with_gravity_torque):
                self._add(group, places[0])
                places = places[len(group.pointers) :]
        if self.compiled is not None and with_gravity_torque:
            self.compiled.want_gravity_torque()
        self.pointers = self._all_pointers()

    def copy(self) -> ArmSupply:
        """The same arms with terms of their own: models and tables are shared."""
        other = copy(self)
        other._groups = [own._replace(group=own.group.copy()) for own in self._groups]
        if self.compiled is not None:
            other.compiled = self.compiled.copy()
        other.pointers, other._coriolis = other._all_pointers(), None
        return other

    def _add(self, group: ArmGroup, place: int) -> None:
        """Take a group whose first arm is this one."""
        own = _Group(group, place, int(self._first[place]), self.configuration)
        self._groups.append(own)
        self.q_slots[own.joints] = group.q_slots + own.first_number
        self.configuration += group.model.nq

    def _all_pointers(self) -> np.ndarray:
        pointers = np.zeros((len(self._arms), POINTER_WIDTH), dtype=np.int64)
        for own in self._groups:
            pointers[own.place : own.place + len(own.group.pointers)] = own.group.pointers
        if self.compiled is not None:
            pointers[list(self.compiled.places)] = self.compiled.pointers
        return pointers

    def pose_address(self, arm: int, joint: int) -> int:
        """Where the pose of a joint of an arm is: rotation by columns, origin."""
        if self.compiled is not None and arm in self.compiled.places:
            return self.compiled.pose_address(self.compiled.places.index(arm), joint)
        own = next(g for g in reversed(self._groups) if g.place <= arm)
        return own.group.pose_address(arm - own.place, joint)

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
        angles, rates : ndarray, shape (joints,)
        q : ndarray
            Pinocchio's configuration of its arms.
        bodies : ndarray, shape (arms, 24)
        status : Numbers
            ``failed`` is set when Pinocchio raises, ``potential_energy`` where that is wanted.
        """
        self._q, self._rates = q, rates
        addresses: dict[str, int] = {}
        callbacks: dict[str, PythonCallback] = {}
        if self.compiled is not None:
            self.compiled.connect(angles, rates, bodies)
            addresses |= self.compiled.addresses()
        if self._groups:
            updates = [g.group.bind(q[g.numbers], rates[g.joints]) for g in self._groups]
            callbacks["pinocchio"] = PythonCallback(_all_of(updates), status)
            if any(np.any(own.group.model.gravity.linear) for own in self._groups):
                energy = PythonCallback(self._energy_update(status), status)
                callbacks["pinocchio_energy"] = energy
        addresses |= {name: call.address for name, call in callbacks.items()}
        return ArmFunctions(addresses, callbacks)

    def potential_energy(self) -> float:
        """Potential energy of all arms [J] at the state evaluated last, zero at the origin."""
        energy = 0.0 if self.compiled is None else self.compiled.potential_energy()
        return energy + self._pinocchio_energy()

    def coriolis(self, status: Any) -> tuple[Coriolis, PythonCallback | None]:
        """What updates the matrices of Coriolis forces, and where they are; the callback in it.

        Raises
        ------
        ModelError
            When a compiled matrix is not Pinocchio's.
        """
        if self._coriolis is None:
            self._coriolis = self._make_coriolis(status)
        return self._coriolis

    def _make_coriolis(self, status: Any) -> tuple[Coriolis, PythonCallback | None]:
        places = np.zeros((len(self.pointers), 2), dtype=np.int64)
        calls = np.zeros(4, dtype=np.int64)
        updates, call = [], None
        for own in self._groups:
            update, at = own.group.bind_coriolis(self._q[own.numbers], self._rates[own.joints])
            updates.append(update)
            places[own.place : own.place + len(at)] = at
        if updates:
            call = PythonCallback(_all_of(updates), status)
            calls[0] = call.address
        if self.compiled is not None:
            from multiarm.arms.compiled.verification import CORIOLIS, verify

            verify(self.compiled.tables, self.compiled.places, self._arms, CORIOLIS)
            places[list(self.compiled.places)] = self.compiled.coriolis
            calls[1:] = self.compiled.coriolis_call()
        return Coriolis(calls, places), call

    def _pinocchio_energy(self) -> float:
        return sum(own.group.potential_energy(self._q[own.numbers]) for own in self._groups)

    def _energy_update(self, status: Any) -> Callable[[], None]:
        def update() -> None:
            status.potential_energy = self._pinocchio_energy()

        return update


def _compiled(
    arms: Mapping[str, Arm], gravity: np.ndarray
) -> tuple[CompiledArms | None, dict[str, str]]:
    """Those arms that can be compiled, and why others cannot."""
    from multiarm.arms.compiled.choice import compile_arms
    from multiarm.arms.compiled.group import CompiledArms

    found = compile_arms(arms, gravity)
    for name, reason in found.reasons.items():
        warnings.warn(f"arm '{name}' stays with Pinocchio: {reason}", stacklevel=2)
    if found.tables is None:
        return None, found.reasons
    return CompiledArms(found.tables, found.places), found.reasons


class _Group(NamedTuple):
    """A group of Pinocchio's, its first arm, joint and number in Pinocchio's configuration."""

    group: ArmGroup
    place: int
    first_joint: int
    first_number: int

    @property
    def joints(self) -> slice:
        return slice(self.first_joint, self.first_joint + self.group.model.nv)

    @property
    def numbers(self) -> slice:
        return slice(self.first_number, self.first_number + self.group.model.nq)


def _runs(places: list[int]) -> list[list[int]]:
    """Numbers that follow each other, together."""
    runs: list[list[int]] = []
    for place in places:
        if runs and runs[-1][-1] == place - 1:
            runs[-1].append(place)
        else:
            runs.append([place])
    return runs


def _all_of(updates: list[Callable[[], None]]) -> Callable[[], None]:
    """One function for several."""
    if len(updates) == 1:
        return updates[0]

    def update_all() -> None:
        for update in updates:
            update()

    return update_all
