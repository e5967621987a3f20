"""A compiled scene for its user: the scene, its Model, and the start.

An evaluation borrows a :class:`multiarm.dynamics.data.Data` of the
:class:`multiarm.dynamics.model.Model`, so that any number of threads can use one :class:`System`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.contacts.joint import COMPONENTS, UNITS, JointFrame
from multiarm.dynamics.callbacks import ControlFunction, PythonControl
from multiarm.dynamics.data import Data
from multiarm.dynamics.held_control import Sampling
from multiarm.dynamics.model import Model
from multiarm.dynamics.state import (
    State,
    checked_quaternion,
    checked_vector,
    fill_by_arm,
    fill_frames,
    require_same_joints,
)
from multiarm.dynamics.tips import Kinematics, kinematics_of
from multiarm.errors import ControlError, ModelError
from multiarm.geometry.records import Contact
from multiarm.notation import count_of
from multiarm.public import facts_html, public_names
from multiarm.results.channels import Channel, RowOwner, trajectory_channels
from multiarm.robots.robot import Robot
from multiarm.scene import Scene
from multiarm.scene.faults import shown
from multiarm.scene.timed_joints import times_in_words
from multiarm.scene.values import is_finite, of_surroundings


def require_system(system: Any, call: str) -> System:
    """The system itself.

    Raises
    ------
    ModelError
        When it is something else: ``call`` shows what is right.
    """
    if isinstance(system, System):
        return system
    given = "the scene" if isinstance(system, Scene) else "ma.load_scene('scene.yaml')"
    raise ModelError(
        f"a system is needed, got {shown(system) if not isinstance(system, Scene) else 'a scene'}; "
        f"compile the scene first: {call} with system = ma.compile_system({given})"
    )


def require_time(t: Any) -> float:
    """A finite time [s].

    Raises
    ------
    ModelError
        When it is something else; a state in its place comes after the time.
    """
    if isinstance(t, State):
        raise ModelError("t: a time [s] is needed, got a state; the order is system, t, state")
    if not is_finite(t):
        raise ModelError(f"t: a finite time [s] is needed, got {shown(t)}")
    return float(t)


def require_state(state: Any) -> None:
    """Refuse what is no state, and a state with a number that is not finite.

    Raises
    ------
    ModelError
    """
    if not isinstance(state, State):
        raise ModelError(f"state: {shown(state)} is no state; make one with system.state(...)")
    for name, numbers in (("position", state.position), ("velocity", state.velocity)):
        if not np.isfinite(numbers).all():
            raise ModelError(f"state: a number of its {name} is not finite: {shown(numbers)}")


def require_control(
    control: ControlFunction | None, sample_time: float | None, sample_delay: bool
) -> None:
    """Refuse the settings of samples where there is no controller in Python that they are for.

    Raises
    ------
    ControlError
    """
    if control is not None:
        require_function(control)
    elif sample_time is not None or sample_delay:
        raise ControlError(
            "sample_time: belongs to a `control` that is given with it; in a scene write "
            "`control: {kind: ..., sample_time: ...}`"
        )


def require_function(control: Any) -> None:
    """Refuse a controller that is no function.

    Raises
    ------
    ControlError
    """
    if not callable(control):
        raise ControlError(
            f"control: must be a function f(t, state) -> (arm: torques), got {shown(control)}; "
            "kinds of control by name belong into the scene"
        )


@dataclass(frozen=True)
class StartReport:
    """How the given start was corrected.

    Gaps are by arm or connection, changes by arm or robot; the joints are without floating bases.
    """

    assembled: bool = True  # False: it was left as written
    gaps: dict[str, float] = field(default_factory=dict)  # largest gap of the given start [m]
    gap_rates: dict[str, float] = field(default_factory=dict)  # largest gap rate [m/s]
    gaps_left: dict[str, float] = field(default_factory=dict)  # of the assembled start [m]
    joint_change: float = 0.0  # largest change of a joint [rad, m]
    joint_changes: dict[str, float] = field(default_factory=dict)  # the same by arm
    base_shifts: dict[str, float] = field(default_factory=dict)  # of floating bases [m]
    base_turns: dict[str, float] = field(default_factory=dict)  # the same, rotations [rad]
    object_held: bool = True  # whether the arms closed the gaps without moving the object
    object_shift: float = 0.0  # displacement of the object [m]
    object_turn: float = 0.0  # rotation of the object [rad]
    at_limit: tuple[str, ...] = ()  # joints (arm/joint) of the assembled start at a limit
    # those of them that assembly moved there -> position before [rad, m]
    pushed_to_limit: dict[str, float] = field(default_factory=dict)
    outside_limits: tuple[str, ...] = ()  # joints outside their limits, which are not enforced
    velocity_change: float = 0.0  # largest change of a velocity component [m/s, rad/s]
    object_velocity_change: float = 0.0  # of the centre of mass [m/s]
    object_spin_change: float = 0.0  # of the angular velocity [rad/s]
    joint_velocity_change: float = 0.0  # largest change of a joint's velocity [rad/s, m/s]
    # of floating bases, of the velocity of the origin [m/s] and of the angular velocity [rad/s]
    base_velocity_changes: dict[str, float] = field(default_factory=dict)
    base_spin_changes: dict[str, float] = field(default_factory=dict)
    energy_lost: float = 0.0  # decrease of the kinetic energy by the correction [J]

    def lines(self) -> list[str]:
        """The corrections, and joints at or outside limits, in words."""
        lines = []
        moved = [self.joint_change, *self.base_shifts.values(), *self.base_turns.values()]
        if max(moved) > 0.0 or not self.object_held:
            arms = ", ".join(f"{arm} {change:.3g}" for arm, change in self.joint_changes.items())
            parts = [f"joints moved by up to {arms} (rad or m)"] if arms else []
            for robot, shift in self.base_shifts.items():
                turn = self.base_turns[robot]
                parts.append(f"the base of {robot} moved by {shift:.3g} m and {turn:.3g} rad")
            body = "held"
            if not self.object_held:
                body = f"moved by {self.object_shift:.3g} m and {self.object_turn:.3g} rad"
            lines.append(", ".join([*parts, f"the object was {body}"]))
        if self.velocity_change > 0.0:
            bases = "".join(
                f"base of {robot} {change:.3g} m/s and {self.base_spin_changes[robot]:.3g} rad/s, "
                for robot, change in self.base_velocity_changes.items()
            )
            lines.append(
                f"velocities changed: object {self.object_velocity_change:.3g} m/s and "
                f"{self.object_spin_change:.3g} rad/s, {bases}joints up to "
                f"{self.joint_velocity_change:.3g} rad/s or m/s; {self.energy_lost:.3g} J were lost"
            )
        if self.at_limit:
            lines.append(f"at a limit: {', '.join(map(self._at_limit_in_words, self.at_limit))}")
        if self.outside_limits:
            lines.append(
                f"written outside its limits, and left there: {', '.join(self.outside_limits)}"
            )
        return lines

    def _at_limit_in_words(self, joint: str) -> str:
        """A joint at a limit, and where it was before it was moved there."""
        if joint not in self.pushed_to_limit:
            return joint
        return f"{joint} (moved there, from {self.pushed_to_limit[joint]:.4g})"


@dataclass(frozen=True, eq=False, repr=False)
class System:
    """A compiled scene.

    Attributes
    ----------
    scene : Scene
    model : Model
    start_report : StartReport
        How the scene's start violated the joints, and how it was corrected.
    """

    scene: Scene
    model: Model
    start_report: StartReport
    _start: State
    _find_start_warnings: Callable[[System], list[str]] | None = None
    _free_data: deque[Data] = field(default_factory=deque, init=False)

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"System({self.scene.name!r}: {self.model.layout})"

    def _repr_html_(self) -> str:
        facts = {
            name: f"{mass:g} kg"
            for name, mass in zip(
                self.model.layout.objects, self.model.constants.object_masses, strict=True
            )
        }
        joints = {joint.connection: joint for joint in self.scene.joints}
        for name in self.model.connections:
            noun, of_robot = "connection", ""
            if name in self.arms:
                noun = "arm"
                of_robot = f"{count_of(len(self.arms[name].joint_names), 'joint')}, joined by "
            facts[f"{noun} {name}"] = (
                f"{of_robot}{joints[name].kind}: {count_of(len(self.contacts[name]), 'contact')}, "
                f"free: {', '.join(self.frames[name].labels) or 'nothing'}"
                + (f"; holds {times}" if (times := times_in_words(joints[name])) else "")
            )
        facts |= {
            f"robot {name}": count_of(len(arm.joint_names), "joint")
            for name, arm in self.arms.items()
            if name not in self.model.connections
        }
        python = self.model.python_control
        of_scene = python is None or python.in_scene
        facts["control"] = self.scene.control.kind if of_scene else "a function in Python"
        facts["effects"] = ", ".join(self.scene.effects.named)
        facts["start"] = "; ".join(self.start_report.lines())
        facts["warnings"] = "; ".join(self.warnings)
        return facts_html(f"System: {self.scene.name}", facts)

    @contextmanager
    def borrow(self) -> Iterator[Data]:
        """A Data of the model for exclusive use, in an unspecified state."""
        try:
            data = self._free_data.pop()
        except IndexError:
            data = Data(self.model)
        try:
            yield data
        finally:
            self.keep(data)

    def keep(self, data: Data) -> None:
        """Accept an unused Data of the model, which can then be borrowed."""
        self._free_data.append(data)

    @property
    def arms(self) -> dict[str, Robot]:
        """The arms by their names, in the order of the stacked vectors."""
        return self.model.robots

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms in the order of the stacked vectors."""
        return self.model.layout.names

    @property
    def contacts(self) -> dict[str, list[Contact]]:
        """Contact records of each arm's joint; the arm's geometry in the tip frame."""
        return self.model.contacts

    @property
    def frames(self) -> dict[str, JointFrame]:
        """Each joint's frame on both bodies, and the motions that it leaves free."""
        return self.model.frames

    @property
    def constraint_count(self) -> int:
        """Number of contacts of all joints together."""
        return self.model.layout.contacts

    @property
    def arm_terms(self) -> dict[str, str]:
        """Backend of each arm's terms: ``"compiled"`` code or ``"pinocchio"``."""
        return self.model.backends.by_robot

    @property
    def not_compiled(self) -> dict[str, str]:
        """Why arms use Pinocchio although the scene selects compiled ones, by arm."""
        return self.model.backends.reasons

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """The recorded quantities of a run."""
        model, layout = self.model, self.model.layout
        around = {
            owner: [record.name for record in model.records[layout.contacts_of(c)]]
            for c, owner in enumerate(layout.owners)
            if of_surroundings(owner)
        }
        return trajectory_channels(
            {name: arm.joint_units for name, arm in model.robots.items()},
            {name: [contact.name for contact in own] for name, own in model.contacts.items()},
            {name: {COMPONENTS[k]: UNITS[k] for k in f.free} for name, f in model.frames.items()},
            model.effects.works,
            model.contacts_with_states,
            around,
            model.controlled,
            {name: self._row_owner(name) for name in model.contacts},
            [name for name, arm in model.robots.items() if arm.floats],
            layout.objects,
        )

    def _row_owner(self, name: str) -> RowOwner:
        """Whose rows an owner of rows has."""
        if name not in self.model.connections:
            return RowOwner(name, "", False, False)
        pair = self.model.connections[name]
        return RowOwner(pair.recorded_with, str(pair.second), pair.first.is_link, pair.on_object)

    @property
    def warnings(self) -> list[str]:
        """What is possible but probably not meant, in the scene and in its start.

        The lines that the command line shows of the scene.
        """
        return [*self.scene.warnings, *self.start_warnings]

    @cached_property
    def start_warnings(self) -> tuple[str, ...]:
        """Those of the start: weight that nothing carries, joints off the object, links in the way.

        Empty for a start that was not assembled.
        """
        find = self._find_start_warnings
        return () if find is None else tuple(find(self))

    def initial_state(self) -> State:
        """The scene's start, on the constraints, as a fresh copy."""
        return self._start.copy()

    def checked(self, state: Any) -> State:
        """A state of this system with finite numbers, a copy; the start where it is None.

        Raises
        ------
        ModelError
            When it is no state, one of other arms, or has a number that is not finite.
        """
        if state is None:
            return self.initial_state()
        require_state(state)
        require_same_joints(state, self.model.layout)
        return state.copy()

    def state(
        self,
        object_position=None,
        object_quaternion_xyzw=None,
        joint_positions: Mapping[str, np.ndarray] | None = None,
        object_twist=None,
        joint_velocities: Mapping[str, np.ndarray] | None = None,
        bases: Mapping[str, Mapping[str, Any]] | None = None,
        objects: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> State:
        """A state from plain arrays; those left out are taken from the start.

        The state is not projected and may violate the joints.  ``objects`` are
        ``{"beam": {"position": [m], "quaternion_xyzw": ..., "twist": ...}}``, some or all of the
        three; ``bases`` the same of robots with a floating base.

        Raises
        ------
        ModelError
            An unknown arm, object or base, a wrong shape, a number that is not finite, a zero
            quaternion; ``object_...`` where there are several objects.
        """
        state = self.initial_state()
        of_one = object_position, object_quaternion_xyzw, object_twist
        if len(state.objects) > 1 and any(given is not None for given in of_one):
            first = next(iter(state.objects))
            raise ModelError(
                f"there are {len(state.objects)} objects, {', '.join(state.objects)}; give them by "
                f"name, such as objects={{{first!r}: {{'position': 3 numbers [m]}}}}"
            )
        fill_frames("objects", state.objects, {} if objects is None else objects)
        if object_position is not None:
            state.object_position[:] = checked_vector("object_position", object_position, 3)
        if object_quaternion_xyzw is not None:
            quaternion = checked_quaternion("object_quaternion_xyzw", object_quaternion_xyzw)
            state.object_quaternion_xyzw[:] = quaternion
        if object_twist is not None:
            state.object_twist[:] = checked_vector("object_twist", object_twist, 6)
        layout = state.layout
        positions = layout.joint_positions(state.position)
        rates = layout.joint_rates(state.velocity)
        fill_by_arm("joint_positions", layout, positions, joint_positions or {})
        fill_by_arm("joint_velocities", layout, rates, joint_velocities or {})
        fill_frames("bases", state.bases, {} if bases is None else bases)
        return state

    def kinematics(self, state: State | None = None) -> Kinematics:
        """Poses, twists and Jacobians of the arms' tips, ``kinematics().tips["left"]``.

        Those of a robot with several tips are ``tips["cart/left"]``.

        Parameters
        ----------
        state : State, optional
            The start when left out.  It is taken as it is, without projection.

        Raises
        ------
        ModelError
            When ``state`` is none of this system; for a tip of an unknown arm.
        """
        return kinematics_of(self.arms.values(), self.checked(state))

    def with_control(
        self,
        control: ControlFunction,
        sample_time: float | None = None,
        sample_delay: bool = False,
    ) -> System:
        """The same system driven by a Python function ``f(t, state) -> {arm: torques}``.

        Arms that the function leaves out have no torque.  It may evaluate systems without this
        control, such as this one.  In :func:`multiarm.simulate_many` all threads call the same
        function.

        Parameters
        ----------
        control : callable
        sample_time : float, optional
            The function is called every ``sample_time`` [s] only, with the state at the end of a
            step, and its torques are held.  None: it is called in every evaluation.
        sample_delay : bool
            Torques act one sample later; those of the start act until the second sample.

        Raises
        ------
        ControlError
            When ``control`` is no function, ``sample_time`` is not a positive number, or missing
            although there is a delay.
        """
        require_function(control)
        if sample_time is None and sample_delay:
            raise ControlError("sample_delay: a delay of one sample needs `sample_time` [s]")
        sampling = None if sample_time is None else Sampling(sample_time, sample_delay)
        model = self.model.with_python_control(PythonControl(control), sampling)
        return replace(self, model=model)

    def with_solver(self, solver: str) -> System:
        """The same system solved by ``"node"`` or by the dense reference ``"dense"``."""
        if solver not in ("node", "dense"):
            raise ModelError(f"unknown solver {solver!r}; solvers are 'node', 'dense'")
        dense = solver == "dense"
        if solver == self.scene.run.solver and self.model.constants.dense == dense:
            return self
        run = self.scene.run.model_copy(update={"solver": solver})
        return replace(
            self,
            scene=self.scene.model_copy(update={"run": run}),
            model=self.model.with_constants(dense=dense),
        )
