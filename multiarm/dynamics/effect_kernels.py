r"""Kernels of effects, which an evaluation calls by address, one after the other.

An evaluation adds up the forces ``f_j`` of the joints and ``f_o`` of the object in this order:

1. ``f_j = -b``: the arms' bias forces; ``f_o``: weight and gyroscopic moment of the object;
2. *passive* kernels add passive forces of the joints (friction), which model-based controllers
   compensate;
3. the control writes ``torque``; *actuator* kernels change it (limits, lag); then it is added;
4. *applied* kernels add external loads (wrenches, drag), which controllers do not compensate.

A kernel reads and writes the arrays in the system's struct, at whose end are its own: numbers and
arrays of a ``NamedTuple``, which it opens by :func:`view_of_effect`.

.. code-block:: python

    class Spring(NamedTuple):
        stiffness: Floats1  # (n,) [N m/rad, N/m]

    open_spring = view_of_effect(Spring)

    @cfunc
    def pull(address, size, at, t):
        struct = struct_at(address, size)
        data, spring, power = open_data(struct), open_spring(struct, at), 0.0
        for j in range(data.forces.f_j.size):
            force = -spring.stiffness[j] * data.state.joint_positions[j]
            data.forces.f_j[j] += force
            power += force * data.state.joint_rates[j]
        set_power(struct, at, power)
        return 0

    EffectKernel("spring", pull, PASSIVE, Spring(stiffness))

*Its derivative*, where it states one, is a kernel of the same signature.  It adds to
``data.slopes.force``, which is zero before, the derivatives of the forces on the frames and joints
and, below these, of the rates of effects' states, by the columns of
:func:`multiarm.dynamics.coordinates.force_columns`; those by the time and by s are not asked for.

.. code-block:: python

    @cfunc
    def differentiate_pull(address, size, at, t):
        struct = struct_at(address, size)
        data, spring = open_data(struct), open_spring(struct, at)
        first, columns = chart_places(data).joints, force_columns(data)
        for j in range(data.forces.f_j.size):
            data.slopes.force[first + j, columns.positions + j] -= spring.stiffness[j]
        return 0

That of an actuator changes ``data.slopes.torque`` (n, columns), all columns of a joint alike, as
its kernel changes ``data.control.torque``, which is what comes to it.  Without a derivative,
integration and :func:`multiarm.derivatives` take differences, which cost further evaluations.

A scene without effects has an empty list of kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.arrays import EFFECTS, CalledFunction, open_data, table_of
from multiarm.errors import ModelError
from multiarm.jit.kernels import Kernel, cfunc, inlined
from multiarm.jit.pointers import GuardedCall, address_of
from multiarm.jit.structs import Numbers, ints1, make_struct, misfit, struct_of, view_at

PASSIVE, ACTUATOR, APPLIED = range(3)

# Entries of the array before a kernel's own ones: index of its power in ``EffectVariables.power``,
# and of its first state in ``EffectVariables.states``.
POWER, STATE = range(2)


def view_of_effect(holder: type) -> Callable[[Any, Any], Any]:
    """Function of kernels ``(struct, at) -> view`` of an effect's numbers and arrays."""
    open_view = view_at(holder)

    @inlined
    def open_effect(struct, at):
        return open_view(struct, int(at) + 1)

    return open_effect


@inlined
def set_power(struct, at, power):
    """Write the power [W] of the effect at this place."""
    open_data(struct).effects.power[ints1(struct, int(at))[POWER]] = power


@inlined
def first_state(struct, at):
    """Index of the first state of this effect in ``data.effects.states`` and ``state_rates``."""
    return ints1(struct, int(at))[STATE]


@cfunc
def keep_forces(_address, _size, _at, _t):
    """The derivative of an effect whose forces do not depend on the state."""
    return 0


class NoArrays(NamedTuple):
    """The arrays of a kernel that has none."""


@dataclass(frozen=True, eq=False)
class EffectKernel:
    """One kernel of an effect and its arrays.

    Attributes
    ----------
    name : str
        Of the effect, as in the scene.
    kernel : compiled function or None
        Decorated with :func:`multiarm.jit.kernels.cfunc`, called with address and size of the
        system's struct, the place ``at`` of its arrays there (a float), and the time [s].  None:
        another function writes the power that is recorded under this name.
    phase : int
        ``PASSIVE``, ``ACTUATOR`` or ``APPLIED``.
    arrays : NamedTuple
        Numbers, and contiguous arrays of float64 or int64: values at the start of a run.  Every
        :class:`multiarm.dynamics.data.Data` has its own copies.
    works : bool
        The kernel calls :func:`set_power` at every call, with the power of its forces: derivatives
        of powers are taken from those of forces.
    states : int
        Number of its states: it reads ``data.effects.states`` from :func:`first_state` on, and
        writes their rates to ``data.effects.state_rates``.
    start : callable, optional
        ``start(arrays) -> (states,)``: these states at the start of a run, which has been
        evaluated with these arrays.  Zero when left out.
    breakpoints : ndarray
        Times at which the effect is not smooth [s]; steps end there.
    connect : callable, optional
        ``connect(data, arrays) -> {name: callback}``, called for every Data: Python functions that
        the kernel calls; it writes their addresses into the arrays.
    calls_user : bool
        Whether these are user functions.
    knows_state_alone : bool
        Forces are functions of time and state, and of no term of the kinematics, which differences
        of them then leave as they are.
    unilateral : bool
        Belongs to unilateral contacts: not called where all contacts of the joints are closed.
    watched : tuple of tuple (str, int, float)
        Of each drive: an array among ``arrays``, a joint, and roundings.  This entry of the array
        is the excess of a command over its limit, positive while the joint's drive is saturated.
        The beginning and the end are events, once it is larger than its roundings.
    local : bool
        Forces and torques on the joints of an arm depend on the time and on the state of this arm
        only, those on the object on the time and the object's state only.  Derivatives of
        accelerations then cost less in :mod:`multiarm.integration.block_derivatives`, which are
        wrong where this does not hold.
    state_joints : tuple of int
        The joint, among all, to which each state of a local kernel belongs.
    derivative : compiled function, optional
        The derivatives of what the kernel does, see above; returns 0, any other answer ends the
        evaluation.  Absent: differences.
    """

    name: str
    kernel: Any
    phase: int
    arrays: Any = field(default_factory=NoArrays)
    works: bool = True
    states: int = 0
    start: Callable[[Any], np.ndarray] | None = None
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    connect: Callable[[Any, Any], Mapping[str, GuardedCall]] | None = None
    calls_user: bool = False
    knows_state_alone: bool = False
    unilateral: bool = False
    watched: tuple[tuple[str, int, float], ...] = ()
    local: bool = False
    state_joints: tuple[int, ...] = ()
    derivative: Any = None

    def __post_init__(self) -> None:
        if not hasattr(self.arrays, "_fields"):
            raise ModelError(
                f"the kernel of effect {self.name!r}: arrays must be a NamedTuple, got "
                f"{type(self.arrays).__name__}; give the one that `view_of_effect` opens"
            )

    def require_usable(self, who: str) -> None:
        """Raise a ``ModelError`` where a kernel could not be called, or read what is not there."""
        for kernel in filter(None, (self.kernel, self.derivative)):
            if not isinstance(kernel, Kernel) or not kernel.is_called_by_address:
                raise ModelError(f"{who} returned a kernel that is no `multiarm.jit.kernels.cfunc`")
        if self.phase not in (PASSIVE, ACTUATOR, APPLIED):
            raise ModelError(
                f"{who} returned a kernel of the phase {self.phase!r}; phases are PASSIVE, "
                f"ACTUATOR and APPLIED of multiarm.effects"
            )
        fault = misfit(self.arrays)
        if fault:
            raise ModelError(f"{who} returned a kernel with wrong arrays: {fault}")


class EffectData(NamedTuple):
    """What one kernel reads and writes: places of its power and states, its numbers and arrays."""

    slots: np.ndarray
    arrays: Any

    @property
    def struct(self) -> np.ndarray:
        """Its part of the system's struct."""
        return np.concatenate([make_struct([self.slots]), struct_of(self.arrays)])


def _copied(arrays: Any) -> Any:
    written = np.ndarray, Numbers  # kernels, or `connect`, write these
    return type(arrays)._make(part.copy() if isinstance(part, written) else part for part in arrays)


@dataclass(frozen=True)
class EffectProgram:
    """The kernels of all effects of a scene, in the order in which they are called."""

    kernels: tuple[EffectKernel, ...] = ()

    @classmethod
    def of(cls, kernels: Sequence[EffectKernel]) -> EffectProgram:
        """Sort kernels by their phases."""
        return cls(tuple(sorted(kernels, key=lambda kernel: kernel.phase)))

    def with_contacts_closed(self) -> EffectProgram:
        """The same arrays and powers, without calling the kernels of unilateral contacts."""
        kernels = (replace(k, kernel=None) if k.unilateral else k for k in self.kernels)
        return EffectProgram(tuple(kernels))

    @property
    def works(self) -> tuple[str, ...]:
        """Names of the effects that do work, in the order of ``Variables.effects.power``."""
        return tuple(effect.name for effect in self.kernels if effect.works)

    @property
    def powers(self) -> np.ndarray:
        """Place of the power of each kernel that is called; -1 without."""
        places = np.cumsum([0, *(effect.works for effect in self.kernels)])
        powers = [
            int(place) if effect.works else -1
            for effect, place in zip(self.kernels, places, strict=False)
            if effect.kernel is not None
        ]
        return np.array(powers, dtype=np.int64)

    def slot(self, name: str) -> int:
        """Index of an effect in ``Variables.effects.power`` and ``works``."""
        return self.works.index(name)

    @property
    def states(self) -> int:
        """Number of states of all effects."""
        return sum(effect.states for effect in self.kernels)

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of the effects with states."""
        return tuple(effect.name for effect in self.kernels if effect.states)

    @property
    def breakpoints(self) -> np.ndarray:
        """Times at which an effect is not smooth, increasing."""
        return np.unique(
            np.concatenate([np.zeros(0), *(effect.breakpoints for effect in self.kernels)])
        )

    @property
    def calls_user(self) -> bool:
        """Whether a kernel calls user functions."""
        return any(effect.calls_user for effect in self.kernels)

    @property
    def called(self) -> list[EffectKernel]:
        """Those that are called, an entry for each row of ``Constants.effects``."""
        return [effect for effect in self.kernels if effect.kernel is not None]

    @property
    def local(self) -> bool:
        """Whether no kernel couples the arms with each other, or with the object."""
        return all(
            effect.local and len(effect.state_joints) == effect.states for effect in self.called
        )

    @property
    def state_joints(self) -> np.ndarray:
        """``Constants.state_joints``."""
        joints: list[int] = []
        for effect in self.kernels:
            joints += effect.state_joints or [-1] * effect.states
        return np.array(joints, dtype=np.int64)

    @property
    def watched(self) -> list[tuple[int, int, float]]:
        """Margins of drives: index of the array in the struct, joint, roundings."""
        places = zip(self.kernels, self._places(), strict=True)
        return [
            (at + 1 + kernel.arrays._fields.index(name), joint, roundings)
            for kernel, at in places
            for name, joint, roundings in kernel.watched
        ]

    def make_data(self) -> list[EffectData]:
        """What the kernels read and write, with copies of the arrays."""
        effects, power, state = [], 0, 0
        for kernel in self.kernels:
            slots = np.array([power, state], dtype=np.int64)
            effects.append(EffectData(slots, _copied(kernel.arrays)))
            power, state = power + kernel.works, state + kernel.states
        return effects

    def program(self) -> tuple[np.ndarray, list[int]]:
        """``Constants.effects``, and the end of each phase there."""
        rows = [
            CalledFunction(
                address=address_of(effect.kernel),
                numbers_at=at,
                state_alone=effect.knows_state_alone,
            )
            for effect, at in zip(self.kernels, self._places(), strict=True)
            if effect.kernel is not None
        ]
        ends = [sum(effect.phase <= phase for effect in self.called) for phase in range(3)]
        return table_of(rows), ends

    @property
    def end(self) -> int:
        """Index in the system's struct after the last array."""
        return EFFECTS + sum(1 + len(kernel.arrays) for kernel in self.kernels)

    def _places(self) -> list[int]:
        """Index of each kernel's first array in the system's struct."""
        sizes = [1 + len(effect.arrays) for effect in self.kernels]
        return [EFFECTS + sum(sizes[:k]) for k in range(len(sizes))]
