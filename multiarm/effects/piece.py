r"""What an effect is to an evaluation: kernels that are called by address, one after the other.

An evaluation forms the right-hand sides ``h`` of the arms and ``h_o`` of the object in this order:

1. ``h = -b``: the arms' bias forces; ``h_o``: weight and gyroscopic moment of the object;
2. *passive* pieces add what the joints do by themselves (friction): controllers that know the model
   find it in ``h`` and compensate it;
3. the control writes ``torque``; *actuator* pieces change it (limits, lag); then it is added;
4. *applied* pieces add what comes from outside (wrenches, drag), which no controller knows.

A kernel reads and writes the arrays of the system's struct, behind which its own stand.  A
scene that names no effect has an empty list here, and nothing is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from multiarm.arms.terms import J_AT
from multiarm.dynamics.arrays import OWN_ARRAYS
from multiarm.jit.pointers import address_of
from multiarm.scene import joint_vector

if TYPE_CHECKING:
    from multiarm.arms.arm import Arm
    from multiarm.arms.backends import ArmBackends
    from multiarm.assembly.system import System
    from multiarm.dynamics.arrays import Buffers
    from multiarm.dynamics.state import Layout
    from multiarm.dynamics.user_callback import Asked
    from multiarm.scene import JointOutline, Scene

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
        A function decorated with :func:`multiarm.jit.kernels.cfunc`, called with address and size
        of the system's struct, the place ``at`` of the piece's first array there (a float), and the
        time
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
    connect : callable, optional
        ``connect(buffers) -> {name: Asked}``, called once the system's buffers exist: Python
        functions that the kernel calls, whose addresses are then in the piece's arrays.
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
    start: Callable[[System], np.ndarray] | None = None
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    connect: Callable[[Buffers], Mapping[str, Asked]] | None = None
    watched: tuple[tuple[int, int], ...] = ()


class Link(NamedTuple):
    """Where a link of an arm is, among the arm's terms, and what it is carried by.

    pose, jacobian : int
        Addresses of the pose of the joint that carries it (12 numbers: rotation by columns, origin)
        and of the arm's Jacobian (columns of 6, world axes, about the world's origin).
    first, joints : int
        The arm's first joint among all, and how many of them carry the link.
    rotation, translation : (3, 3), (3,)
        The link's frame in the frame of that joint.
    """

    pose: int
    jacobian: int
    first: int
    joints: int
    rotation: np.ndarray
    translation: np.ndarray


@dataclass(frozen=True)
class Site:
    """What an effect is built into.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Arm
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    outlines : dict of str to tuple of JointOutline
        Each arm's joints as its URDF has them.
    backends : ArmBackends
        Where the terms of the arms are.
    """

    scene: Scene
    arms: dict[str, Arm]
    layout: Layout
    outlines: dict[str, tuple[JointOutline, ...]]
    backends: ArmBackends

    def stacked(
        self,
        values: Any,
        from_urdf: Callable[[JointOutline], float] | None = None,
        default: float = 0.0,
    ) -> np.ndarray:
        """One number for every joint of all arms; see :func:`joint_numbers`."""
        return np.concatenate(
            list(joint_numbers(values, self.outlines, from_urdf, default).values())
        )

    def link(self, arm: str, name: str) -> Link:
        """Where a link is; from now on it is computed at every evaluation."""
        joint, rotation, translation = self.arms[arm].link(name)
        number = self.layout.names.index(arm)
        return Link(
            pose=self.backends.pose_address(number, joint),
            jacobian=int(self.backends.pointers[number, J_AT]),
            first=self.layout.dofs[number],
            joints=joint,
            rotation=rotation,
            translation=translation,
        )


def joint_numbers(
    values: Any,
    outlines: Mapping[str, Sequence[JointOutline]],
    from_urdf: Callable[[JointOutline], float] | None = None,
    default: float = 0.0,
) -> dict[str, np.ndarray]:
    """One number for every joint, by arm, from a scene's number, list or table.

    ``from_urdf`` finds the number where ``urdf`` stands for it; joints that are not named have
    the default.
    """
    found = {}
    for name, joints in outlines.items():
        own = values.get(name) if isinstance(values, Mapping) else values
        if isinstance(own, str):
            assert from_urdf is not None, "a text stands for the robot's own numbers"
            found[name] = np.array([from_urdf(joint) for joint in joints])
        else:
            found[name] = joint_vector(own, [joint.name for joint in joints], default)
    return found


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
        """Times at which one of them is not smooth, increasing."""
        times = [np.zeros(0), *(piece.breakpoints for piece in self.every)]
        return np.unique(np.concatenate(times))

    @property
    def with_states(self) -> tuple[str, ...]:
        """Names of those that have states of their own."""
        return tuple(piece.name for piece in self.every if piece.states)

    @property
    def watched(self) -> list[tuple[int, int]]:
        """Margins to watch: place of the array in the struct, joint."""
        places = zip(self.every, self._places(), strict=True)
        return [(at + 1 + k, joint) for piece, at in places for k, joint in piece.watched]

    def connect(self, buffers: Buffers) -> dict[str, Asked]:
        """Python functions that they call, once the system's buffers exist."""
        made = (piece.connect(buffers) for piece in self.every if piece.connect is not None)
        return {name: call for calls in made for name, call in calls.items()}

    @property
    def arrays(self) -> list[np.ndarray]:
        """What stands behind the system's own arrays in its struct."""
        return [
            array
            for piece, slots in zip(self.every, self._slots, strict=True)
            for array in (slots, *piece.arrays)
        ]

    def program(self) -> tuple[np.ndarray, np.ndarray]:
        """``Plant.effects`` and ``Plant.phases``."""
        called = [(p, at) for p, at in zip(self.every, self._places(), strict=True) if p.kernel]
        rows = [[address_of(piece.kernel), at] for piece, at in called]
        last = [sum(p.phase <= phase for p, _ in called) for phase in (PASSIVE, ACTUATOR, APPLIED)]
        return np.array(rows, dtype=np.int64).reshape(-1, 2), np.array(last, dtype=np.int64)

    def _places(self) -> list[int]:
        """Place of each piece's first array in the system's struct."""
        sizes = [1 + len(piece.arrays) for piece in self.every]
        return [OWN_ARRAYS + sum(sizes[:k]) for k in range(len(sizes))]

    def start(self, system: System) -> np.ndarray:
        """Their own states at the start of a run, once it has been evaluated there."""
        parts = [np.zeros(0)]
        for piece in self.every:
            own = piece.start(system) if piece.start is not None else np.zeros(piece.states)
            parts.append(own)
        return np.concatenate(parts)
