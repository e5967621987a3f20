r"""Effects as an evaluation sees them: kernels that are called by address, one after the other.

An evaluation forms the right-hand sides ``h`` of the arms and ``h_o`` of the object in this order:

1. ``h = -b``: the arms' bias forces; ``h_o``: weight and gyroscopic moment of the object;
2. *passive* kernels add what the joints do by themselves (friction): controllers that know the
   model find it in ``h`` and compensate it;
3. the control writes ``torque``; *actuator* kernels change it (limits, lag); then it is added;
4. *applied* kernels add external loads (wrenches, drag), which no controller knows.

A kernel reads and writes the arrays in the system's struct, its own after all others.  A scene that
names no effect has an empty list here, and nothing is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from multiarm.dynamics.arrays import OWN_ARRAYS
from multiarm.jit.pointers import GuardedCall, address_of

PASSIVE, ACTUATOR, APPLIED = range(3)

# Entries of a kernel's first array: place of its power in ``Variables.power``, and of its first
# state in ``Variables.inner``.
POWER, STATE = range(2)

Arrays = Sequence[np.ndarray]


@dataclass(frozen=True, eq=False)
class EffectKernel:
    """One kernel of an effect and its arrays.

    Attributes
    ----------
    name : str
        Of the effect, as in the scene.
    kernel : compiled function or None
        Decorated with :func:`multiarm.jit.kernels.cfunc`, called with address and size of the
        system's struct, the place ``at`` of its first array there (a float), and the time [s].
        That first array, int64 (2,), holds ``POWER`` and ``STATE``; ``arrays`` follow it.  None:
        something else does the work that is recorded under this name.
    phase : int
        ``PASSIVE``, ``ACTUATOR`` or ``APPLIED``.
    arrays : tuple of ndarray
        Contiguous float64 or int64: values at the start of a run.  Every
        :class:`multiarm.dynamics.data.Data` has its own copies.
    works : bool
        The kernel writes its power [W] to ``data.power[slots[POWER]]`` at every call.
    states : int
        How many states of its own it has: it reads ``data.inner`` from ``slots[STATE]`` on, and
        writes their rates to ``data.inner_rate``.
    start : callable, optional
        ``start(arrays) -> (states,)``: these states at the start of a run, which has been
        evaluated with these arrays.  Zero when left out.
    breakpoints : ndarray
        Times at which the effect is not smooth [s]; steps end there.
    connect : callable, optional
        ``connect(data, arrays) -> {name: callback}``, called once a Data exists: Python functions
        that the kernel calls; it writes their addresses into the arrays.
    calls_user : bool
        User functions are among these.
    unilateral : bool
        Belongs to unilateral contacts: not called where all contacts of the joints are closed.
    watched : tuple of (int, int)
        Which of ``arrays``, and which joint's entry there, is a margin: while it is positive, the
        joint's drive is saturated, and the result's events say from when to when.
    """

    name: str
    kernel: Any
    phase: int
    arrays: tuple[np.ndarray, ...] = ()
    works: bool = True
    states: int = 0
    start: Callable[[Arrays], np.ndarray] | None = None
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    connect: Callable[[Any, Arrays], Mapping[str, GuardedCall]] | None = None
    calls_user: bool = False
    unilateral: bool = False
    watched: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class EffectProgram:
    """The kernels of all effects of a scene, in the order in which they are called.

    Attributes
    ----------
    kernels : tuple of EffectKernel
    """

    kernels: tuple[EffectKernel, ...] = ()

    @classmethod
    def of(cls, kernels: Sequence[EffectKernel]) -> EffectProgram:
        """Put kernels in the order of their phases."""
        return cls(tuple(sorted(kernels, key=lambda own: own.phase)))

    def with_contacts_closed(self) -> EffectProgram:
        """The same arrays and works, without the kernels of unilateral contacts."""
        own = (replace(k, kernel=None) if k.unilateral else k for k in self.kernels)
        return EffectProgram(tuple(own))

    @property
    def works(self) -> tuple[str, ...]:
        """Names of those that do work, in the order of ``Variables.power``."""
        return tuple(own.name for own in self.kernels if own.works)

    def slot(self, name: str) -> int:
        """Place of an effect's power in ``Variables.power``, and of its work among the works."""
        return self.works.index(name)

    @property
    def states(self) -> int:
        """Number of states of their own."""
        return sum(own.states for own in self.kernels)

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of those that have states of their own."""
        return tuple(own.name for own in self.kernels if own.states)

    @property
    def breakpoints(self) -> np.ndarray:
        """Times at which one of them is not smooth, increasing."""
        return np.unique(np.concatenate([np.zeros(0), *(own.breakpoints for own in self.kernels)]))

    @property
    def calls_user(self) -> bool:
        """Whether some kernel calls user functions."""
        return any(own.calls_user for own in self.kernels)

    @property
    def watched(self) -> list[tuple[int, int]]:
        """Margins to monitor: place of the array in the struct, joint."""
        places = zip(self.kernels, self._places(), strict=True)
        return [(at + 1 + k, joint) for own, at in places for k, joint in own.watched]

    def make_arrays(self) -> list[tuple[np.ndarray, ...]]:
        """Copies of the arrays of every kernel, the slots first."""
        made, power, state = [], 0, 0
        for own in self.kernels:
            slots = np.array([power, state], dtype=np.int64)
            made.append((slots, *(array.copy() for array in own.arrays)))
            power, state = power + own.works, state + own.states
        return made

    def program(self) -> tuple[np.ndarray, list[int]]:
        """``Constants.effects``, and where each phase ends there."""
        called = [(own, at) for own, at in zip(self.kernels, self._places(), strict=True)]
        called = [(own, at) for own, at in called if own.kernel is not None]
        rows = [[address_of(own.kernel), at] for own, at in called]
        ends = [sum(own.phase <= phase for own, _ in called) for phase in range(3)]
        return np.array(rows, dtype=np.int64).reshape(-1, 2), ends

    def _places(self) -> list[int]:
        """Place of each kernel's first array in the system's struct."""
        sizes = [1 + len(own.arrays) for own in self.kernels]
        return [OWN_ARRAYS + sum(sizes[:k]) for k in range(len(sizes))]
