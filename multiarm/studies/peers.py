"""Other programs behind one interface: their model of a system, one acceleration, one motion.

Each peer has its best settings: models are built and torques tabulated outside the measured time,
and no Python is in a loop that can do without.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.studies.observables import Sinusoid, inexpressible_effects, joint_damping
from multiarm.studies.time_series import TimeSeries

PEERS = {
    "MuJoCo": ("mujoco_peer", "MujocoPeer"),
    "MuJoCo as shipped": ("mujoco_peer", "MujocoAsShipped"),
    "Pinocchio": ("pinocchio_peer", "PinocchioTree"),
    "constraintDynamics as shipped": ("pinocchio_peer", "AsShipped"),
    "constraintDynamics": ("pinocchio_peer", "ConstraintDynamics"),
    "lcaba": ("pinocchio_peer", "Lcaba"),
    "Drake": ("drake_peer", "DrakePeer"),
}
"""Name -> module, which need not be importable here, and class of the peer."""
EXPRESSIBLE = ("weld", "ball", "revolute")
"""Kinds of joint that the peers have constraints for."""
BYTES_PER_CUBE = 64
"""Memory of Pinocchio's Data, as measured, grows with the cube of the number of joints."""
NOT_INSTALLED = "not installed: pip install multiarm[peers]"

Drive = Sinusoid | Callable[[float, State], np.ndarray]
"""Torques of the control, of time alone or of time and state."""


class Peer(ABC):
    """A program's model of a system; it adds the damping of the joints to all torques itself.

    Parameters
    ----------
    system : System
        Welds, balls and hinges only.

    Attributes
    ----------
    methods : mapping of str to str
        Integrator -> what sets its accuracy, ``step`` or ``tolerance``.

    Raises
    ------
    ModelError
        The program cannot express the system.
    ImportError
        It is not installed.
    """

    methods: ClassVar[Mapping[str, str]]

    def __init__(self, system: System):
        self.system, self.damping = system, joint_damping(system)

    @abstractmethod
    def follow(
        self, series: TimeSeries, start: State, method: str, value: float, drive: Drive
    ) -> None:
        """Record the motion from a state by a method and its step [s] or tolerance.

        Only the steps are on the clock of ``series``.  The motion ends early when the state is no
        longer finite.
        """


class Solver(Peer):
    """A peer that can be asked for its accelerations at one state.

    Attributes
    ----------
    best : tuple of str and float
        The method by which a short motion is followed, and its step [s] or tolerance.
    """

    best: ClassVar[tuple[str, float]]

    @abstractmethod
    def accelerations(self, state: State, torque: np.ndarray) -> np.ndarray:
        """The object's classical acceleration in world axes and the joints', shape (6 + n,)."""


def make_peers(system: System, names: Sequence[str]) -> tuple[dict[str, Peer], dict[str, str]]:
    """Of ``PEERS``, the programs that can run a system by name, and why the others cannot."""
    able: dict[str, Peer] = {}
    refusals: dict[str, str] = {}
    strange = inexpressible_effects(system)
    for name in names:
        module, kind = PEERS[name]
        try:
            if strange:
                refusals[name] = f"cannot express {', '.join(strange)}"
            else:
                able[name] = getattr(import_module(f"multiarm.studies.{module}"), kind)(system)
        except ModelError as error:
            refusals[name] = f"cannot express it: {error}"
        except ImportError:
            refusals[name] = NOT_INSTALLED
    return able, refusals


def memory_needed(joints: int) -> float:
    """About what Pinocchio's Data takes for a system of so many joints [bytes]."""
    return BYTES_PER_CUBE * (6.0 + joints) ** 3


@dataclass(frozen=True)
class Link:
    """A link of an arm, moved by one joint.

    Attributes
    ----------
    parent : int
        Number of the link before it; 0 is the world.
    placement : pinocchio.SE3
        Of the joint on the parent.
    inertia : pinocchio.Inertia
    turns : bool
        The joint turns about its axis; else it slides along it.
    axis : ndarray, shape (3,)
        In the link's axes.
    """

    parent: int
    placement: Any
    inertia: Any
    turns: bool
    axis: np.ndarray


def links(arm: Arm) -> Iterator[Link]:
    """The links of an arm, from its base on; their numbers begin with 1."""
    model = arm.model
    q = arm.configuration(np.zeros(arm.dof))
    for i in range(1, model.njoints):
        data = model.joints[i].createData()
        model.joints[i].calc(data, q)
        slide, turn = np.split(np.array(data.S).reshape(6), 2)
        turns = bool(np.any(turn))
        axis = turn if turns else slide
        yield Link(model.parents[i], model.jointPlacements[i], model.inertias[i], turns, axis)


def tip_frame(system: System, name: str) -> np.ndarray:
    """The frame of an arm's joint to the object on the link of its tip, shape (4, 4)."""
    arm, tip = system.arms[name], np.eye(4)
    tip[:3, :3], tip[:3, 3] = arm.tip_rotation, arm.tip_translation
    return tip @ system.frames[name].on_tip


def joint_ends(joint: Any, lacks: str) -> tuple[float, ...]:
    """Places on a joint's z axis where a program constrains it: a hinge is two balls on its axis.

    Raises
    ------
    ModelError
        For another kind of joint; the message begins with what the program ``lacks``.
    """
    if joint.kind not in EXPRESSIBLE:
        raise ModelError(f"{lacks} for {joint.kind}; only {', '.join(EXPRESSIBLE)}")
    return (-joint.size / 2.0, joint.size / 2.0) if joint.kind == "revolute" else (0.0,)


def moments(inertia: np.ndarray) -> list[float]:
    """``[xx, yy, zz, xy, xz, yz]`` of an inertia matrix."""
    xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
    return [xx, yy, zz, xy, xz, yz]
