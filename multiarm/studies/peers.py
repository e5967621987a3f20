"""Other programs behind one interface: how they follow a motion, and what their models consist of.

Each peer has its best settings: models are built and torques tabulated outside the measured time,
and no Python is in a loop that can do without.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.studies.observables import Sinusoid
from multiarm.studies.time_series import Grid, TimeSeries

EXPRESSIBLE = ("weld", "ball", "revolute")
"""Kinds of joint that the peers have constraints for."""
NOT_INSTALLED = "not installed: pip install multiarm[peers]"

Drive = Sinusoid | Callable[[float, State], np.ndarray]
"""Torques, of time alone or of time and state."""


class Peer(Protocol):
    """A program's model of a system.

    Attributes
    ----------
    methods : mapping of str to str
        Integrator -> what sets its accuracy, ``step`` or ``tolerance``.
    """

    @property
    def methods(self) -> Mapping[str, str]:
        """Integrator -> what sets its accuracy."""

    def follow(
        self,
        series: TimeSeries,
        grid: Grid,
        start: State,
        method: str,
        value: float,
        drive: Drive,
    ) -> None:
        """Record the motion from a state by a method and its step [s] or tolerance.

        Only the steps are on the clock of ``series``.  The motion ends early when the state is no
        longer finite.
        """


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
