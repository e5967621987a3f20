"""Control programs: the laws of a control, and the system for which they are built."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.arrays import COUPLED
from multiarm.dynamics.callbacks import PythonControl
from multiarm.dynamics.control_laws import ControlLaw
from multiarm.dynamics.data import Data
from multiarm.dynamics.held_control import Sampling
from multiarm.dynamics.model import ControlSpan
from multiarm.dynamics.state import State
from multiarm.robots.robot import Robot
from multiarm.scene import Scene, gain_vector


class JointPath(NamedTuple):
    """Joint positions along a path."""

    bounds: np.ndarray  # (S + 1,) times of the waypoints [s]
    coefficients: np.ndarray  # (S, n, width) Chebyshev series of every segment and joint [rad, m]


@dataclass(frozen=True)
class ControlContext:
    """The system for which a control is built, contacts closed of joints that hold at its start.

    Attributes
    ----------
    scene : Scene
    data : Data
        Of the model without control; its state may be changed.
    start : State
    joint_path : callable
        ``joint_path(paths)``: joint positions with which objects pass their waypoints.
    full : Data
        With all rows of the scene, closed or not.
    """

    scene: Scene
    data: Data
    start: State
    joint_path: Callable[..., JointPath]
    full: Data

    @property
    def arms(self) -> dict[str, Robot]:
        """The arms by name, in the order of the stacked vectors."""
        return self.data.model.robots

    @property
    def joint_names(self) -> list[str]:
        """``arm/joint`` of every joint, in the order of the stacked vectors."""
        return self.data.model.joint_names

    @property
    def start_angles(self) -> np.ndarray:
        """Joint positions at the start, shape (n,) [rad, m]."""
        return self.start.layout.joint_positions(self.start.position)

    @property
    def can_grip(self) -> bool:
        """Whether some contacts only push and have friction."""
        unilateral = self.full.model.unilateral
        return unilateral is not None and bool(unilateral.grips)

    def counting_friction(self) -> ControlContext:
        """The same with the tangents of contacts that only push among the rows."""
        full = self.full.view(self.full.model.counting_friction())
        return replace(self, data=full.of_laws, full=full)

    def stacked(self, values: Any) -> np.ndarray:
        """One number for every joint of all arms, from a scene's gain, table or list.

        Those of floating bases, which have no drives, are zero.
        """
        numbers, layout = np.zeros(self.data.model.layout.rate_count), self.data.model.layout
        for i, (name, arm) in enumerate(self.arms.items()):
            numbers[layout.tree_joints(i)] = gain_vector(values, name, arm.joint_names)
        return numbers


@dataclass(frozen=True)
class ControlProgram:
    """The control of a system.

    Attributes
    ----------
    laws : tuple of ControlLaw
        Compiled laws, called one after the other; each adds its torques.
    breakpoints : ndarray
        Times at which the torques are not smooth, so that steps end there [s].
    span : ControlSpan, optional
        Absent: the laws are defined at all times.
    python : PythonControl, optional
        In place of compiled laws.
    sampling : Sampling, optional
        Taken from the control's ``sample_time``.  Absent: they are evaluated all the time.
    reach : int
        What the torques of an arm depend on: the time (``OPEN_LOOP``), also the state of this arm
        (``LOCAL``), also the multipliers of the last law (``CARRYING``,
        :mod:`multiarm.dynamics.control_laws`), or anything (``COUPLED``).  Derivatives cost less
        where it is less, and are wrong where it is more than this says.
    counts_friction : bool
        The laws see the tangents of contacts that only push among the rows, see
        :meth:`ControlContext.counting_friction`.
    """

    laws: tuple[ControlLaw, ...] = ()
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    span: ControlSpan | None = None
    python: PythonControl | None = None
    sampling: Sampling | None = None
    reach: int = COUPLED
    counts_friction: bool = False


def needs_gravity_torque(scene: Scene) -> bool:
    """Whether some part of the control needs the arms' gravity forces at every evaluation."""
    return scene.gravity is not None and scene.control.compensates_gravity
