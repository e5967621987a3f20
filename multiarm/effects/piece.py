r"""What an effect is to an evaluation: kernels that are called by address, one after the other.

An evaluation forms the right-hand sides ``h`` of the arms and ``h_o`` of the object in this order:

1. ``h = -b``: Pinocchio's bias forces; ``h_o``: weight and gyroscopic moment of the object;
2. *passive* pieces add what the joints do by themselves (friction): controllers that know the model
   find it in ``h`` and compensate it;
3. the control writes ``torque``; *actuator* pieces change it (limits, lag); then it is added;
4. *applied* pieces add what comes from outside (wrenches, drag), which no controller knows.

A kernel reads and writes the arrays of the system's address book, behind which its own stand.  A
scene that names no effect has an empty list here, and nothing is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.lowlevel import CallBack, address_of
from multiarm.plant import OWN_ARRAYS
from multiarm.scene import gain_vector

if TYPE_CHECKING:
    from multiarm.arm import Arm
    from multiarm.scene import Scene
    from multiarm.state import Layout
    from multiarm.system import System

PASSIVE, ACTUATOR, APPLIED = range(3)

# Entries of a piece's first array: place of its power in ``Buffers.power``, and of its first state
# in ``Buffers.inner``.
POWER, STATE, SLOTS = range(3)


@dataclass(frozen=True, eq=False)
class Piece:
    """One kernel of an effect and its arrays.

    Attributes
    ----------
    name : str
        Of the effect, as in the scene.
    kernel : entry or None
        None: something else does the work that is noted under this name.
        A function decorated with :func:`multiarm.lowlevel.entry`, called with address and size of
        the system's book, the place ``at`` of the piece's first array there (a float), and the time
        [s].  That first array, int64 (2,), holds ``POWER`` and ``STATE``; ``arrays`` follow it.
    phase : int
        ``PASSIVE``, ``ACTUATOR`` or ``APPLIED``.
    arrays : tuple of ndarray
        Contiguous float64 or int64.
    works : bool
        The kernel writes its power [W] to ``buffers.power[slots[POWER]]`` at every call.
    states : int
        How many states of its own it has: it reads ``buffers.inner`` from ``slots[STATE]`` on, and
        writes their rates to ``buffers.inner_rate``.
    start : callable, optional
        ``start(system) -> (states,)``: these states at the start of a run, whose evaluation is in
        the system's buffers.  Zero when left out.
    breakpoints : ndarray
        Times at which the effect is not smooth [s]; steps end there.
    calls : dict of str to CallBack
        Python functions that the kernel calls.
    """

    name: str
    kernel: Any
    phase: int
    arrays: tuple[np.ndarray, ...] = ()
    works: bool = True
    states: int = 0
    start: Callable[[System], np.ndarray] | None = None
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    calls: Mapping[str, CallBack] = field(default_factory=dict)


@dataclass(frozen=True)
class Site:
    """What an effect is built into.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Arm
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    """

    scene: Scene
    arms: dict[str, Arm]
    layout: Layout

    def stacked(self, values: Any) -> np.ndarray:
        """One number for every joint of all arms, from a scene's number, list or table."""
        return np.concatenate(
            [gain_vector(values, name, arm.joint_names) for name, arm in self.arms.items()]
        )


@dataclass(frozen=True)
class Pieces:
    """All pieces of a system, in the order in which they are called.

    Attributes
    ----------
    every : tuple of Piece
    """

    every: tuple[Piece, ...] = ()
    _slots: tuple[np.ndarray, ...] = ()

    @classmethod
    def of(cls, pieces: Sequence[Piece]) -> Pieces:
        """Put pieces in order and give each its places."""
        every = tuple(sorted(pieces, key=lambda piece: piece.phase))
        slots, power, state = [], 0, 0
        for piece in every:
            slots.append(np.array([power, state], dtype=np.int64))
            power, state = power + piece.works, state + piece.states
        return cls(every, tuple(slots))

    @property
    def works(self) -> tuple[str, ...]:
        """Names of those that do work, in the order of ``Buffers.power``."""
        return tuple(piece.name for piece in self.every if piece.works)

    def slot(self, name: str) -> int:
        """Place of an effect's power in ``Buffers.power``, and of its work among the works."""
        return self.works.index(name)

    @property
    def states(self) -> int:
        """Number of states of their own."""
        return sum(piece.states for piece in self.every)

    @property
    def breakpoints(self) -> np.ndarray:
        """Times at which one of them is not smooth."""
        return np.concatenate([np.zeros(0), *(piece.breakpoints for piece in self.every)])

    @property
    def calls(self) -> dict[str, CallBack]:
        """Python functions that they call."""
        return {name: call for piece in self.every for name, call in piece.calls.items()}

    @property
    def arrays(self) -> list[np.ndarray]:
        """What stands behind the system's own arrays in its address book."""
        return [
            array
            for piece, slots in zip(self.every, self._slots, strict=True)
            for array in (slots, *piece.arrays)
        ]

    def program(self) -> tuple[np.ndarray, np.ndarray]:
        """``Plant.effects`` and ``Plant.phases``."""
        rows, at = [], OWN_ARRAYS
        for piece in self.every:
            if piece.kernel is not None:
                rows.append([address_of(piece.kernel), at])
            at += 1 + len(piece.arrays)
        called = [piece.phase for piece in self.every if piece.kernel is not None]
        last = [sum(p <= phase for p in called) for phase in (PASSIVE, ACTUATOR, APPLIED)]
        return np.array(rows, dtype=np.int64).reshape(-1, 2), np.array(last, dtype=np.int64)

    def start(self, system: System) -> np.ndarray:
        """Their own states at the start of a run, once it has been evaluated there."""
        parts = [np.zeros(0)]
        for piece in self.every:
            own = piece.start(system) if piece.start is not None else np.zeros(piece.states)
            parts.append(own)
        return np.concatenate(parts)
